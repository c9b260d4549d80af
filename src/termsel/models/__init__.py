"""Sensor models: ground to image, as named terms."""

from termsel.models.base import SensorModel
from termsel.models.interpolating import Field, Field3D, ThinPlate
from termsel.models.polynomial import Affine, Helmert2D, Polynomial2D, Polynomial3D
from termsel.models.projective import DLT2D, DLT3D, Projective2D
from termsel.models.quotient import Blocks, RationalFunctions, RationalModel
from termsel.models.terms import Term

__all__ = [
    "DLT2D",
    "DLT3D",
    "Affine",
    "Blocks",
    "Field",
    "Field3D",
    "Helmert2D",
    "Polynomial2D",
    "Polynomial3D",
    "Projective2D",
    "RationalFunctions",
    "RationalModel",
    "SensorModel",
    "Term",
    "ThinPlate",
]
