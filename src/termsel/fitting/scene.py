"""The scene that a fit is for: places all over the image, and errors as they lie on the ground."""

from __future__ import annotations

import numpy as np

from termsel.data.features import FloatArray
from termsel.fitting.fit import Fit
from termsel.fitting.residuals import Residuals

INSET = 0.02
"""Part of the image's sides that a grid leaves out, where nothing can be measured."""


def scene_grid(fitted: Fit, side: int, neighbours: int = 1,
               box: tuple[float, float, float, float] | None = None,
               ) -> tuple[FloatArray, FloatArray]:
    """Return a grid of `side` by `side` positions over the image, and what is seen there.

    Line and sample [px] (side * side, 2), line by line; and ground in the CRS of the control (side
    * side, 3), NaN where the fit sees nothing. A position has the mean height of the nearest
    control vertices (`neighbours`), weighted by inverse squares of their distances. The box is
    first line, first sample, last line and last sample [px]; by default that of `Fit.image_box`.
    """
    from scipy.spatial import cKDTree

    if box is None:
        (top, left), (bottom, right) = fitted.image_box()
    else:
        top, left, bottom, right = box
    lines, samples = (np.linspace(low + INSET * (high - low), high - INSET * (high - low), side)
                      for low, high in ((top, bottom), (left, right)))
    image = np.stack(np.meshgrid(lines, samples, indexing="ij"), axis=-1).reshape(-1, 2)
    ground = fitted.control.ground_vertices()
    near = min(neighbours, len(ground))
    distance, nearest = cKDTree(fitted.project(ground)).query(image, k=[*range(1, near + 1)])
    weights = 1.0 / np.maximum(distance, 1.0) ** 2
    heights = (weights * ground[nearest, 2]).sum(axis=1) / weights.sum(axis=1)
    if not fitted.model.uses_height:
        heights = np.nan_to_num(heights)
    return image, fitted.locate(image, heights)


def errors_on_ground(fitted: Fit, residuals: Residuals) -> FloatArray:
    """Return residuals as vectors on the ground (n, 2), at the height of each feature.

    Each leads from the feature to the place where the fit sees its measured image position, in the
    unit of the CRS; NaN where the fit sees nothing.
    """
    ground = residuals.ground
    errors = np.array([(r.line, r.sample) for r in residuals]).reshape(-1, 2)
    seen = fitted.locate(fitted.project(ground) + errors, ground[:, 2])
    return np.asarray((seen - ground)[:, :2])
