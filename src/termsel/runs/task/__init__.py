"""What a run is asked for, and the problem that is built from it."""
