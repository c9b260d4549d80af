"""Tie points between raw images."""
