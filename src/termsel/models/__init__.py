"""Sensor models: ground to image, as named terms."""

from termsel.models.base import Blocks, RationalModel, SensorModel
from termsel.models.polynomial import Polynomial2D

__all__ = ["Blocks", "Polynomial2D", "RationalModel", "SensorModel"]
