"""Subsets of columns: the terms of a model."""
