"""What a fit says about its terms and its lines."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from termsel.adjustment.equations import line_normals
from termsel.data.features import FloatArray, Lines, select
from termsel.data.record.chances import t_beyond
from termsel.data.record.figures import Significance
from termsel.fitting.fit import Fit

NORMAL_MEDIAN = 0.6745
"""Median absolute value of a standard normal variable."""

CORRELATED = 0.95
"""Absolute correlation of two coefficients from which on they are named."""

PARALLEL = 0.05
"""Orientation spread from which on lines fix both image axes; that of lines within 13 degrees."""


def significance(fit: Fit) -> dict[str, Significance]:
    """Return the significance of each term in use; empty without redundancy.

    It is that of the adjustment as if the terms had been given. After a search among many it
    is too favourable.
    """
    adjustment = fit.adjustment
    if not adjustment.feasible or adjustment.redundancy <= 0:
        return {}
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.abs(adjustment.coefficients) / adjustment.deviations
    return {name: Significance(float(t[i]), t_beyond(float(t[i]), adjustment.redundancy))
            for i, name in enumerate(fit.model.terms) if fit.terms[i] and np.isfinite(t[i])}


def correlations(fit: Fit) -> Iterator[tuple[str, str, float]]:
    """Yield pairs of terms whose coefficients correlate by CORRELATED or more, highest first."""
    matrix = fit.adjustment.correlations
    if matrix is None:
        return
    names = select(fit.model.terms, fit.terms)
    high = np.argwhere(np.triu(np.abs(matrix) >= CORRELATED, 1))
    for i, j in sorted(high.tolist(), key=lambda pair: -abs(matrix[pair[0], pair[1]])):
        yield names[i], names[j], float(matrix[i, j])


def orientation_spread(lines: Lines) -> float:
    """Return how widely the directions of image lines, at least one, spread.

    Twice the smaller eigenvalue of the mean of n n^T over the unit normals n: 1 where all
    directions occur alike, 0 where all lines are parallel and fix one image axis alone.
    """
    normal: FloatArray = line_normals(lines)[0]
    return float(max(0.0, 2.0 * np.linalg.eigvalsh(normal.T @ normal / len(normal))[0]))
