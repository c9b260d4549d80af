"""The scene that a fit is for: places all over the image, and errors as they lie on the ground."""

from __future__ import annotations

import numpy as np

from termsel.fits.fit import Fit
from termsel.fits.residuals import Residuals
from termsel.measurements.features import FloatArray

INSET = 0.02
"""Part of the image's sides that a grid leaves out, where nothing can be measured."""


def scene_grid(fitted: Fit, side: int, neighbours: int = 1,
               box: tuple[float, float, float, float] | None = None,
               ) -> tuple[FloatArray, FloatArray]:
    """Return positions on a grid over the image, and what is seen there on the ground.

    Parameters
    ----------
    side : int
        Positions along either side of the image.
    neighbours : int
        Number of nearest control vertices whose heights a position has the mean of, with weights
        by inverse squares of their distances.
    box : tuple of float, optional
        First line, first sample, last line, last sample of the grid [px]; by default those of the
        image, or of the control where its size is not known.

    Returns
    -------
    image : ndarray, shape (side * side, 2)
        Line and sample [px], line by line.
    ground : ndarray, shape (side * side, 3)
        In the CRS of the control; NaN where the fit sees nothing.
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
    """Return residuals as vectors on the ground, at the height of each feature.

    Each leads from the feature to the place where the fit sees its measured image position.

    Returns
    -------
    ndarray, shape (n, 2)
        In the unit of the CRS; NaN where the fit sees nothing.
    """
    ground = np.array([(r.x, r.y, r.z) for r in residuals]).reshape(-1, 3)
    errors = np.array([(r.line, r.sample) for r in residuals]).reshape(-1, 2)
    seen = fitted.locate(fitted.project(ground) + errors, ground[:, 2])
    return np.asarray((seen - ground)[:, :2])
