"""The masked adjustment: equations, one solution through LAPACK, many through kernels."""

from termsel.adjustment.equations import Equations, image_equations, line_normals, row_weights
from termsel.adjustment.solve import Adjustment, solve

__all__ = ["Adjustment", "Equations", "image_equations", "line_normals",
           "row_weights", "solve"]
