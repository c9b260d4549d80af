"""The typed record of a run: what result.json holds."""
