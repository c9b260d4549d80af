"""Tables of features one after another."""

from __future__ import annotations

import numpy as np

from termsel.measurements.features import FloatArray, Lines, Points
from termsel.measurements.tables.attributes import Attributes, joined


def join_points(first: Points, second: Points) -> Points:
    """Return the points of both; unknown standard deviations are the median of the known."""
    return Points(first.ids + second.ids, np.concatenate([first.image, second.image]),
                  np.concatenate([first.ground, second.ground]),
                  _join_sigma(first, second), first.roles + second.roles,
                  _join_attributes(first, second))


def join_lines(first: Lines, second: Lines) -> Lines:
    """Return the lines of both; unknown standard deviations are the median of the known."""
    return Lines(first.ids + second.ids, np.concatenate([first.image, second.image]),
                 np.concatenate([first.ground, second.ground]), _join_sigma(first, second),
                 _join_attributes(first, second))


def _join_attributes(first: Points | Lines, second: Points | Lines) -> Attributes:
    return joined(first.attributes, len(first), second.attributes, len(second))


def _join_sigma(first: Points | Lines, second: Points | Lines) -> FloatArray | None:
    given = [part.sigma for part in (first, second) if part.sigma is not None]
    if not given:
        return None
    # Features without a standard deviation have this weight in an adjustment.
    shape = given[0].shape[1:]
    return np.concatenate([
        np.full((len(part), *shape), np.median(given[0])) if part.sigma is None else part.sigma
        for part in (first, second)])
