"""Sensor models: ground to image, as named terms."""

from termsel.models.base import Blocks, RationalModel, SensorModel

__all__ = ["Blocks", "RationalModel", "SensorModel"]
