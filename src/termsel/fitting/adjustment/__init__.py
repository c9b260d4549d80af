"""The masked adjustment: equations, one solution through LAPACK, many through kernels."""

from termsel.fitting.adjustment.equations import Equations, line_normals
from termsel.fitting.adjustment.lines import image_equations, row_weights
from termsel.fitting.adjustment.solve import Adjustment, solve

__all__ = ["Adjustment", "Equations", "image_equations", "line_normals",
           "row_weights", "solve"]
