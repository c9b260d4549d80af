"""Control lines in parametric form: each measured end lies on the projected ground line."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from termsel import FeatureSet

FloatArray = NDArray[np.float64]


def line_equations(features: FeatureSet, ends: FloatArray, columns: FloatArray,
                   ) -> tuple[FloatArray, FloatArray]:
    """Return weighted rows (2 n, k) and right sides (2 n,) of n lines: an equation of each end.

    `ends` (n, 2, 2) are the projected vertices P and Q of each line, and `columns` (n, 2, 2, k)
    what terms of 1 add to them. A measured end m is P + t (Q - P) with an unknown t along the
    projected line, so that one of its two equations remains, across that line. The projected line
    is taken to be straight between its vertices.
    """
    lines = features.lines
    # P + t (Q - P) is nearest to a measured end m at t = (m - P) . (Q - P) / |Q - P|^2.
    direction = (ends[:, 1] - ends[:, 0])[:, None]
    # A line that is seen end on has no direction; with the least length its equations are finite.
    square = np.maximum((direction**2).sum(axis=2), np.finfo(float).tiny)
    t = (((lines.image - ends[:, :1]) * direction).sum(axis=2) / square)[..., None]
    normal = np.stack([-direction[..., 1], direction[..., 0]], axis=2) / np.sqrt(square)[..., None]
    distances = ((lines.image - ends[:, :1] - t * direction) * normal).sum(axis=2)
    # A term moves P + t (Q - P) by (1 - t) times what it adds to P, and t times that of Q.
    point_columns = (1 - t)[..., None] * columns[:, :1] + t[..., None] * columns[:, 1:]
    rows = np.einsum("iea,ieak->iek", np.broadcast_to(normal, lines.image.shape), point_columns)
    weight = _line_weights(features)[:, None]
    return (rows * weight[..., None]).reshape(distances.size, -1), (distances * weight).ravel()


def _line_weights(features: FeatureSet) -> FloatArray:
    """Return the median standard deviation of points and lines over that of each line, (n,).

    Ones if lines have no standard deviations.
    """
    lines = features.lines
    if lines.sigma is None:
        return np.ones(len(lines))
    # Relative to the median weights are about 1, so that rows keep the unit of the image.
    stated = [sigma.ravel() for sigma in (features.points.sigma, lines.sigma) if sigma is not None]
    return np.asarray(np.median(np.concatenate(stated)) / lines.sigma)
