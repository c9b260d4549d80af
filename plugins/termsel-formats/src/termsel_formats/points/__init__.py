"""Control points in files of other programs."""
