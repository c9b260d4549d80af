"""Independent parts of a system: line and sample, unless an equation contains both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from termsel.adjustment.equations import Equations, row_axes
from termsel.adjustment.kernels import solve_many
from termsel.measurements.features import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class IndependentPart:
    """Terms that are determined together, apart from all others."""

    columns: BoolArray  # (k,): terms of the part
    equations: Equations  # over these terms alone


def independent_parts(equations: Equations, axis: IntArray) -> tuple[IndependentPart, ...]:
    """Split a system by image axis, unless a row or a term belongs to both.

    Parameters
    ----------
    equations : Equations
    axis : ndarray of int, shape (k,)
        Image axis of each term: 0 line, 1 sample, 2 both.
    """
    # A control line has equations of both axes, and a shared denominator is a term of both.
    rows = row_axes(equations.A, axis)
    if (rows == 2).any() or (axis == 2).any():
        return (IndependentPart(np.ones(len(axis), dtype=bool), equations),)
    return tuple(IndependentPart(axis == side, equations.take(rows == side, axis == side))
                 for side in (0, 1))


def solve_parts(parts: tuple[IndependentPart, ...], terms: BoolArray, features: BoolArray | None,
                ) -> tuple[FloatArray, FloatArray]:
    """Solve a population part by part.

    Parameters
    ----------
    parts : tuple of IndependentPart
    terms : ndarray of bool, shape (p, k)
        Selected terms.
    features : ndarray of bool, shape (p, n_features), optional
        Selected features; all by default.

    Returns
    -------
    coefficients : ndarray, shape (p, k)
        0 where a term is not selected.
    violation : ndarray, shape (p,)
        Number of selected terms that are not determined.
    """
    coefficients, violation = np.zeros(terms.shape), np.zeros(len(terms))
    for part in parts:
        solution, lacking = solve_many(part.equations, terms[:, part.columns], features)
        coefficients[:, part.columns] = solution
        violation += lacking
    return coefficients, violation
