"""A simulated place with an exact camera."""
