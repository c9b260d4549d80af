"""The masked adjustment: equations, one solution through LAPACK, many through kernels."""

from termsel.adjustment.equations import Equations
from termsel.adjustment.solve import Adjustment, solve

__all__ = ["Adjustment", "Equations", "solve"]
