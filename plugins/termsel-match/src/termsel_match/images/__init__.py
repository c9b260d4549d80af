"""Rasters read by windows, rough starts, and references as the image would show them."""
