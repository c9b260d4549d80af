"""Ridge regression that shrinks a coefficient the more, the higher the order of its term."""

from __future__ import annotations

import numpy as np

from termsel.adjustment.parts import independent_parts
from termsel.adjustment.ridge import Spectrum, choose_penalty
from termsel.adjustment.solve import TOLERANCE
from termsel.data.features import BoolArray, FeatureSet, FloatArray
from termsel.data.scaling import Scaling
from termsel.fitting.fit import Estimator, Fit
from termsel.fitting.least_squares import LeastSquares
from termsel.models.base import SensorModel
from termsel.models.terms import Term


class RidgeByOrder(Estimator):
    """Ridge regression that shrinks a coefficient the more, the higher the order of its term.

    Minimises |b - A x|^2 + penalty^2 sum (w_j x_j)^2 over the control, for each independent part
    with the penalty of the least generalised cross-validation. The weight of a numerator's term is
    its order less 1, so that affine terms are not shrunk, that of a denominator's its order.
    Without a feature, the penalty is chosen again.

    References
    ----------
    Hoerl and Kennard 1970; Golub, Heath, Wahba 1979 for the penalty. The weights are termsel's
    own choice.
    """

    name = "ridge-by-order"

    def fit(self, model: SensorModel, control: FeatureSet, scaling: Scaling, terms: BoolArray,
            used: BoolArray) -> Fit:
        """Fit a model (see `Estimator.fit`); its adjustment is that of least squares."""
        plain = LeastSquares(iterated=False).fit(model, control, scaling, terms, used)
        coefficients = np.zeros(len(terms))
        trace = 0.0
        weights = np.array([_weight(name) for name in model.terms])
        for system in independent_parts(plain.model.equations(plain.scaled_control), model.axis):
            rows = used[system.equations.feature]
            selected = terms & system.columns
            columns = system.equations.A[rows][:, selected[system.columns]]
            coefficients[selected], effective = _ridge(columns, system.equations.b[rows],
                                                       weights[selected])
            trace += effective
        return plain.with_coefficients(coefficients, self, trace)


def _weight(name: str) -> float:
    """Return the weight of a term by its name, such as "line.den:X2Y"."""
    term = Term.parse(name)
    return float(term.order if term.is_denominator else max(term.order - 1, 0))


def _ridge(columns: FloatArray, target: FloatArray,
           weights: FloatArray) -> tuple[FloatArray, float]:
    """Return coefficients and their effective number."""
    free = weights == 0
    x = np.zeros(columns.shape[1])
    free_columns = columns[:, free]
    q, strength = np.linalg.svd(free_columns, full_matrices=False)[:2]
    q = q[:, strength > np.finfo(float).eps * max(free_columns.shape) * strength.max(initial=0.0)]
    penalised = (columns[:, ~free] - q @ (q.T @ columns[:, ~free])) / weights[~free]
    y = target - q @ (q.T @ target)
    effective = float(q.shape[1])
    if penalised.size:
        u, s, vt = np.linalg.svd(penalised, full_matrices=False)
        live = s > TOLERANCE * s.max(initial=0.0)
        u = u[:, live]
        s = s[live]
        vt = vt[live]
        inner = u.T @ y
        if len(s):
            outside = max(float(y @ y - inner @ inner), 0.0)
            penalty = choose_penalty(
                Spectrum(s, np.abs(inner), outside, len(y) - q.shape[1]), "gcv")
            x[~free] = vt.T @ (s / (s**2 + penalty**2) * inner) / weights[~free]
            effective += float((s**2 / (s**2 + penalty**2)).sum())
    if free_columns.size:
        x[free] = np.linalg.lstsq(free_columns, target - columns @ x)[0]
    return x, effective
