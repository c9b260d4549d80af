"""The adjustment: its start, its unknowns, its equations and its steps."""
