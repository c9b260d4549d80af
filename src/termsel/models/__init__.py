"""Sensor models: ground to image, as named terms."""

from termsel.models.base import SensorModel
from termsel.models.polynomial import Polynomial2D
from termsel.models.quotient import Blocks, RationalModel

__all__ = ["Blocks", "Polynomial2D", "RationalModel", "SensorModel"]
