"""Calls into the code of plugins: what they may not do, and whose fault it is when they fail."""
