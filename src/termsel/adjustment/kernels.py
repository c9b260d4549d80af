"""Many masked adjustments at once."""

from __future__ import annotations

import numpy as np

from termsel.adjustment.equations import Equations
from termsel.adjustment.solve import solve
from termsel.features import BoolArray, FloatArray, IntArray


def solve_many(
    equations: Equations,
    terms: BoolArray | None,
    features: BoolArray | None,
) -> tuple[FloatArray, IntArray]:
    """Solve a population of masked least-squares systems.

    Parameters
    ----------
    equations : Equations
        m rows, k columns.
    terms : ndarray of bool, shape (p, k), optional
        Selected columns of each individual; all by default.
    features : ndarray of bool, shape (p, n_features), optional
        Selected features of each individual; all by default.

    Returns
    -------
    coefficients : ndarray, shape (p, k)
        0 where a term is not selected, and throughout where the mask has no unique solution.
    violation : ndarray of int, shape (p,)
        Selected terms minus rank; 0 is feasible.
    """
    p = len(terms) if terms is not None else len(features) if features is not None else 1
    coefficients = np.zeros((p, equations.A.shape[1]))
    violation = np.zeros(p, dtype=np.intp)
    for i in range(p):
        one = solve(equations, None if terms is None else terms[i],
                    None if features is None else features[i])
        violation[i] = one.violation
        if one.feasible:
            coefficients[i] = one.coefficients
    return coefficients, violation
