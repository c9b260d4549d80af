"""Independent parts of a system: line and sample, unless an equation contains both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from termsel.adjustment.equations import Equations, row_axes
from termsel.adjustment.kernels import solve_many
from termsel.measurements.features import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Part:
    """Terms that are determined together, apart from all others.

    Parameters
    ----------
    columns : ndarray of bool, shape (k,)
        Terms of the part.
    equations : Equations
        Over these terms alone.
    """

    columns: BoolArray
    equations: Equations


def independent_parts(equations: Equations, axis: IntArray) -> tuple[Part, ...]:
    """Split a system by image axis, unless a row or a term belongs to both.

    Parameters
    ----------
    equations : Equations
    axis : ndarray of int, shape (k,)
        Image axis of each term: 0 line, 1 sample, 2 both.
    """
    rows = row_axes(equations.A, axis)
    if (rows == 2).any() or (axis == 2).any():
        return (Part(np.ones(len(axis), dtype=bool), equations),)
    return tuple(Part(axis == side, equations.take(rows == side, axis == side))
                 for side in (0, 1))


def solve_parts(parts: tuple[Part, ...], terms: BoolArray, features: BoolArray | None,
                ) -> tuple[FloatArray, FloatArray]:
    """Solve a population part by part.

    Parameters
    ----------
    parts : tuple of Part
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
