"""What was measured: features, roles, coordinates, data sets."""
