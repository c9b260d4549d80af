"""The offset of all heights as an unknown: as one more image, which sees each tie's height."""

from __future__ import annotations

import numpy as np

from termsel_block.estimation.equations import Seen
from termsel_block.geometry.frame import FloatArray
from termsel_block.geometry.heights import Heights


def of_heights(heights: Heights, ties: FloatArray,
               ) -> tuple[Seen, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return what heights add: their rows, to the offset's equations, and to each tie's.

    Of the two image axes of `Seen` the first is the height. The second has rows of zeros, whose
    parameter stays zero.
    """
    seen = heights.observed(ties)
    count = len(ties)
    weight = np.where(seen.joint, seen.weight, 0.0)
    slopes = np.zeros((count, 2, 3))
    residual = np.zeros((count, 2))
    slopes[:, 0] = seen.row
    residual[:, 0] = seen.away
    normal, right = heights.of_offset()
    alone = seen.weight - weight
    return (Seen(np.arange(count), np.tile(-np.eye(2), (count, 1, 1)), slopes, residual, weight),
            np.diag([normal, 1.0]), np.array([right, 0.0]),
            np.einsum("t,ti,tj->tij", alone, seen.row, seen.row),
            (alone * seen.away)[:, None] * seen.row)
