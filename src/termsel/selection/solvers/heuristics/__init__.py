"""Heuristics other than genetic algorithms, and yardsticks."""
