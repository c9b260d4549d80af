"""Subsets of rows: control features."""
