"""Which transformation other programs take from a file."""
