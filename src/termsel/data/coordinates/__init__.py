"""Ground coordinates and their reference systems."""
