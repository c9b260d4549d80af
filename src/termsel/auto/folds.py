"""In how many folds features are held out, and which lines of a lattice are."""

from __future__ import annotations

import numpy as np

from termsel.data.features import FeatureSet
from termsel.data.lattices import MIN_LATTICE_LINES as FEWEST_LINES
from termsel.data.lattices import lattice_of

FOLDS_WITH_LINES = 10
"""Folds in which the whole choice is repeated where there are lines, which take longer."""

FOLDS = ((40, 20), (5000, 10), (50_000, 5), (np.inf, 2))
"""Folds for fewer points than a number: of many, nine tenths or four fifths predict all but as well
as all, and of very many a half."""

FOLDS_OF_LATTICE = 8
"""Folds of the lines of a lattice, and of its columns: of a radar image with ten, one each."""


def folds_of(features: FeatureSet) -> int:
    """Return in how many folds the whole choice is repeated."""
    if len(features.lines):
        return min(FOLDS_WITH_LINES, len(features))
    lattice = lattice_of(features.points)
    if lattice is not None:
        return folds_along(lattice.lines) + folds_along(lattice.columns)
    return next(min(folds, len(features)) for below, folds in FOLDS if len(features) < below)


def held_out_lines(count: int) -> tuple[int, int]:
    """Return the first and the last of so many lines that are left out."""
    edge = 2 if count > 2 * FEWEST_LINES else 1
    return edge, count - 1 - edge


def folds_along(count: int) -> int:
    """Return in how many folds so many lines are left out."""
    first, last = held_out_lines(count)
    return min(FOLDS_OF_LATTICE, last - first + 1)
