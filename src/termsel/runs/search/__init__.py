"""The search of a run: steps, blunders, recommendation."""
