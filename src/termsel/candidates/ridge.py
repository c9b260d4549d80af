"""Shrinkage of a selection's coefficients, the more the higher the order of a term."""

from __future__ import annotations

import numpy as np
from scipy import linalg

from termsel.adjustment.parts import independent_parts
from termsel.adjustment.ridge import Spectrum, choose_penalty
from termsel.adjustment.solve import TOLERANCE
from termsel.measurements.features import BoolArray, FeatureSet, FloatArray
from termsel.models.base import SensorModel
from termsel.models.terms import Term


def shrunken_coefficients(model: SensorModel, control: FeatureSet, terms: BoolArray,
                          used: BoolArray) -> FloatArray:
    """Return ridge coefficients of a selection.

    Minimises |b - A x|^2 + penalty^2 sum (w_j x_j)^2 over the control, for each independent part
    with the penalty of the least generalised cross-validation. The weight of a numerator's term is
    its order less 1, so that affine terms are free, that of a denominator's its order.

    Parameters
    ----------
    model : SensorModel
    control : FeatureSet
        Scaled.
    terms : ndarray of bool, shape (k,)
    used : ndarray of bool, shape (len(control),)

    Returns
    -------
    ndarray, shape (k,)

    References
    ----------
    Hoerl and Kennard 1970; Golub, Heath, Wahba 1979 for the penalty. The weights are termsel's
    own choice.
    """
    coefficients = np.zeros(len(terms))
    weights = np.array([_weight(name) for name in model.terms])
    for part in independent_parts(model.equations(control), model.axis):
        rows, chosen = used[part.equations.feature], terms & part.columns
        columns = part.equations.A[rows][:, chosen[part.columns]]
        coefficients[chosen] = _ridge(columns, part.equations.b[rows], weights[chosen])
    return coefficients


def _weight(name: str) -> float:
    """Return the weight of a term by its name, such as "line.den:X2Y"."""
    term = Term.parse(name)
    return float(term.order if term.is_denominator else max(term.order - 1, 0))


def _ridge(columns: FloatArray, target: FloatArray, weights: FloatArray) -> FloatArray:
    free = weights == 0
    x = np.zeros(columns.shape[1])
    lead = columns[:, free]
    q = linalg.orth(lead) if lead.size else np.zeros((len(target), 0))
    rest = (columns[:, ~free] - q @ (q.T @ columns[:, ~free])) / weights[~free]
    y = target - q @ (q.T @ target)
    if rest.size:
        u, s, vt = np.linalg.svd(rest, full_matrices=False)
        live = s > TOLERANCE * s.max(initial=0.0)
        u, s, vt = u[:, live], s[live], vt[live]
        inner = u.T @ y
        if len(s):
            outside = max(float(y @ y - inner @ inner), 0.0)
            penalty = choose_penalty(
                Spectrum(s, np.abs(inner), outside, len(y) - q.shape[1]), "gcv")
            x[~free] = vt.T @ (s / (s**2 + penalty**2) * inner) / weights[~free]
    if lead.size:
        x[free] = np.linalg.lstsq(lead, target - columns @ x)[0]
    return x
