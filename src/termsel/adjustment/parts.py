"""Independent parts of a system: line and sample, unless an equation contains both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from termsel.adjustment.equations import Equations, row_axes
from termsel.adjustment.kernels import solve_many
from termsel.adjustment.nearby import solve_near
from termsel.data.features import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class IndependentPart:
    """Terms that are determined together, apart from all others."""

    columns: BoolArray  # (k,): terms of the part
    equations: Equations  # over these terms alone


def independent_parts(equations: Equations, axis: IntArray) -> tuple[IndependentPart, ...]:
    """Split a system by image axis, unless a row or a term belongs to both.

    The axis of each term (k,) is 0 line, 1 sample, 2 both.
    """
    # A control line has equations of both axes, and a shared denominator is a term of both.
    rows = row_axes(equations.A, axis)
    if (rows == 2).any() or (axis == 2).any():
        return (IndependentPart(np.ones(len(axis), dtype=bool), equations),)
    systems = []
    for image_axis in (0, 1):  # line, sample
        columns = axis == image_axis
        systems.append(IndependentPart(columns, equations.take(rows == image_axis, columns)))
    return tuple(systems)


def solve_parts(systems: tuple[IndependentPart, ...], terms: BoolArray, features: BoolArray | None,
                near: BoolArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Solve a population part by part, of selected terms (p, k) and features (p, n), None for all.

    With a selection of features (n,) that all are `near`, all terms must be selected. Return the
    coefficients (p, k), 0 where a term is not selected, and the number of selected terms that are
    not determined (p,).
    """
    coefficients = np.zeros(terms.shape)
    violation = np.zeros(len(terms))
    for system in systems:
        if near is None or features is None:
            solution, undetermined = solve_many(system.equations, terms[:, system.columns],
                                                features)
        else:
            solution, undetermined = solve_near(system.equations, near, features)
        coefficients[:, system.columns] = solution
        violation += undetermined
    return coefficients, violation
