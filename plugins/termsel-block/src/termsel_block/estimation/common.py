"""The offset of all heights as an unknown: as one more image, which sees each tie's height."""

from __future__ import annotations

import numpy as np

from termsel_block.estimation.equations import TieRows
from termsel_block.geometry.frame import FloatArray
from termsel_block.geometry.heights import Heights


def height_equations(heights: Heights, ties: FloatArray,
                     ) -> tuple[TieRows, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return what heights add to the normal equations of a block of t ties.

    The heights count as an image, whose parameter is the offset. Returned are its tie rows; the
    matrix (2, 2) and right side (2,) of the offset's own equations; and what ties whose heights do
    not depend on the offset add to their own, (t, 3, 3) and (t, 3). The first image axis is the
    height; the second has rows of zeros, and a parameter that stays zero.
    """
    # The equation of a height is surface + offset - height = 0, weighted by the roughness.
    observed = heights.tie_observations(ties)
    count = len(ties)
    weight = np.where(observed.joint, observed.weight, 0.0)
    slopes = np.zeros((count, 2, 3))
    residual = np.zeros((count, 2))
    # The derivative of the height by the tie's position, in the row of the first axis.
    slopes[:, 0] = observed.row
    residual[:, 0] = observed.away
    normal, right = heights.offset_equation()
    # Ties without the offset (off the DEM) add to their own equations alone.
    own_weight = observed.weight - weight
    # A larger offset makes the residual smaller, so that its derivative is -1.
    return (TieRows(np.arange(count), np.tile(-np.eye(2), (count, 1, 1)), slopes, residual, weight),
            np.diag([normal, 1.0]), np.array([right, 0.0]),
            np.einsum("t,ti,tj->tij", own_weight, observed.row, observed.row),
            (own_weight * observed.away)[:, None] * observed.row)
