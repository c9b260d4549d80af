"""Least squares without each feature, in closed form."""

from __future__ import annotations

import numpy as np

from termsel.adjustment.leave_out import leave_one_out
from termsel.adjustment.parts import IndependentPart
from termsel.measurements.features import BoolArray, FloatArray


def solutions_without_each(parts: tuple[IndependentPart, ...], terms: BoolArray,
                           used: BoolArray) -> FloatArray | None:
    """Return the least-squares solutions without each feature, in closed form.

    Parameters
    ----------
    parts : tuple of IndependentPart
        Of the equations of n features.
    terms : ndarray of bool, shape (k,)
    used : ndarray of bool, shape (n,)

    Returns
    -------
    ndarray, shape (n, k), or None
        None where the terms are not determined, or some feature is indispensable.
    """
    solutions = np.zeros((len(used), len(terms)))
    for part in parts:
        found, determined = leave_one_out(part.equations, terms[None, part.columns], used[None])
        if not determined.all():
            return None
        solutions[:, part.columns] = found[:, 0]
    return solutions
