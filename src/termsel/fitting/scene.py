"""The scene that a fit is for: places all over the image, and errors as they lie on the ground."""

from __future__ import annotations

import numpy as np

from termsel.data.coordinates.nearest import nearest_points
from termsel.data.features import FloatArray
from termsel.fitting.fit import Fit
from termsel.fitting.residuals import Residuals

INSET = 0.02
"""Part of the image's sides that a grid leaves out, where nothing can be measured."""


def scene_grid(fitted: Fit, across: int, neighbours: int = 1,
               box: tuple[float, float, float, float] | None = None,
               ) -> tuple[FloatArray, FloatArray]:
    """Return a grid of `across` by `across` positions over the image, and their ground.

    Line and sample [px] (across^2, 2), line by line; and ground in the CRS of the control
    (across^2, 3), NaN where the fit sees nothing. A position has the mean height of the nearest
    control vertices (`neighbours`), weighted by inverse squares of their distances. The box is
    first line, first sample, last line and last sample [px]; by default that of `Fit.image_box`.
    """
    if box is None:
        (first_line, first_sample), (last_line, last_sample) = fitted.image_box()
    else:
        first_line, first_sample, last_line, last_sample = box
    lines = _inner_steps(first_line, last_line, across)
    samples = _inner_steps(first_sample, last_sample, across)
    image = np.stack(np.meshgrid(lines, samples, indexing="ij"), axis=-1).reshape(-1, 2)
    ground = fitted.control.ground_vertices()
    image_of_control = fitted.project(ground)
    # At a pole of the model even control is seen nowhere.
    is_seen = np.isfinite(image_of_control).all(axis=1)
    if not is_seen.any():
        return image, np.full((len(image), 3), np.nan)
    ground = ground[is_seen]
    count = min(neighbours, len(ground))
    # Weights 1 / d^2, of distances of at least a pixel.
    distance, nearest = nearest_points(image_of_control[is_seen], image, count)
    weights = 1.0 / np.maximum(distance, 1.0) ** 2
    heights = (weights * ground[nearest, 2]).sum(axis=1) / weights.sum(axis=1)
    if not fitted.model.uses_height:
        heights = np.nan_to_num(heights)
    return image, fitted.locate(image, heights)


def _inner_steps(low: float, high: float, count: int) -> FloatArray:
    """Return `count` equal steps over a range without its margins (INSET), (count,)."""
    margin = INSET * (high - low)
    return np.linspace(low + margin, high - margin, count)


def errors_on_ground(fitted: Fit, residuals: Residuals) -> FloatArray:
    """Return residuals as vectors on the ground (n, 2), at the height of each feature.

    Each leads from the feature to the place where the fit sees its measured image position, in the
    unit of the CRS; NaN where the fit sees nothing.
    """
    ground = residuals.ground
    errors = np.array([(r.line, r.sample) for r in residuals]).reshape(-1, 2)
    located = fitted.locate(fitted.project(ground) + errors, ground[:, 2])
    return np.asarray((located - ground)[:, :2])
