"""Select sensor-model terms and ground control features for georeferencing images."""

__version__ = "0.1.0"
