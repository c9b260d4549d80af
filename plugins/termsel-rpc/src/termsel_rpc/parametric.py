"""Control lines in parametric form: each measured end lies on the projected ground line."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from termsel import FeatureSet

FloatArray = NDArray[np.float64]


def line_equations(features: FeatureSet, ends: FloatArray, columns: FloatArray,
                   ) -> tuple[FloatArray, FloatArray]:
    """Return rows (2 n_lines, k) and distances of the lines, one of each measured end.

    Ends (n, 2, 2) are the projected vertices P and Q of each line, columns (n, 2, 2, k) what terms
    move them by. A measured end is P + t (Q - P). Its two equations have the unknown t, in the
    direction of the projected line; across that line one is left. It stands where the line was
    measured, so no image line is extended to vertices beyond it. Between the vertices the projected
    line is taken to be straight, as in the vector form.
    """
    lines = features.lines
    # P + t (Q - P) is nearest to a measured end at t = (m - P) (Q - P) / |Q - P|^2.
    run = (ends[:, 1] - ends[:, 0])[:, None]
    # A line seen end on has no direction; the least length leaves its equations finite.
    square = np.maximum((run**2).sum(axis=2), np.finfo(float).tiny)
    t = (((lines.image - ends[:, :1]) * run).sum(axis=2) / square)[..., None]
    # The normal of the projected line: along it lies the unknown t, across it the equation.
    normal = np.stack([-run[..., 1], run[..., 0]], axis=2) / np.sqrt(square)[..., None]
    away = ((lines.image - ends[:, :1] - t * run) * normal).sum(axis=2)
    # A term moves the place by that of P and Q, as far as t says.
    moved = (1 - t)[..., None] * columns[:, :1] + t[..., None] * columns[:, 1:]
    rows = np.einsum("iea,ieak->iek", np.broadcast_to(normal, lines.image.shape), moved)
    weight = _line_weights(features)[:, None]
    return (rows * weight[..., None]).reshape(away.size, -1), (away * weight).ravel()


def _line_weights(features: FeatureSet) -> FloatArray:
    """Return the median standard deviation of all control over that of each line, shape (n,).

    Ones if lines have no standard deviations.
    """
    lines = features.lines
    if lines.sigma is None:
        return np.ones(len(lines))
    # By the median of points and lines together, weights are about 1: rows stay in the unit of the
    # image.
    stated = [sigma.ravel() for sigma in (features.points.sigma, lines.sigma) if sigma is not None]
    return np.asarray(np.median(np.concatenate(stated)) / lines.sigma)
