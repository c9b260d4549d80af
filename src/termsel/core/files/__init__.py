"""Files: found, opened, written whole or not at all; rasters; what is remote."""
