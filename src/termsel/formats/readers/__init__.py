"""Readers of ground control features."""
