"""Mutated files of every format and hostile options: exit code 0 or 2, no file lost, in time."""
