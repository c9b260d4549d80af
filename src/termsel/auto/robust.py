"""M-estimators by iteratively reweighted least squares: rows that fit badly have less weight.

References
----------
Huber 1964, Ann. Math. Statist. 35(1); Beaton and Tukey 1974, Technometrics 16(2); Holland and
Welsch 1977, Commun. Statist. A6(9), for the iteration and the tuning constants.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from termsel.adjustment.equations import Equations
from termsel.data.features import BoolArray, FeatureSet, FloatArray
from termsel.data.record.chances import median_of
from termsel.data.scaling import Scaling
from termsel.fitting.figures import NORMAL_MEDIAN
from termsel.fitting.fit import Estimator, Fit
from termsel.fitting.least_squares import LeastSquares
from termsel.models.base import SensorModel

HUBER = 1.345
"""Standard deviations from which a row has less weight: 95 % efficient under normal errors."""

TUKEY = 4.685
"""Standard deviations from which a row has no weight: 95 % efficient under normal errors."""

MAX_ITERATIONS = 50
"""Most iterations of each estimator; ten are usual."""

CONVERGED_CHANGE = 1e-8
"""Change of the coefficients by their size, below which the iteration ends."""


@dataclass(frozen=True)
class Reweighted(Estimator):
    """Huber's estimator, or Tukey's biweight that begins with its solution."""

    name = "reweighted"
    biweight: bool

    def fit(self, model: SensorModel, control: FeatureSet, scaling: Scaling, terms: BoolArray,
            used: BoolArray) -> Fit:
        """Return the robust fit of the terms and features in use; see `Estimator.fit`.

        Of lines under denominators the first step of the iteration is fitted. A model that is not
        determined comes back as least squares fit it.
        """
        plain = LeastSquares(iterated=False).fit(model, control, scaling, terms, used)
        if not plain.determined:
            return plain
        equations = plain.model.equations(plain.scaled_control)
        coefficients = np.zeros(len(terms))
        coefficients[terms], _ = reweighted(
            equations.take(used[equations.feature], terms), self.biweight)
        return plain.with_coefficients(coefficients, self, float(terms.sum()))


def reweighted(equations: Equations, biweight: bool) -> tuple[FloatArray, FloatArray]:
    """Return the coefficients (k,) of an M-estimator, and the weights of its rows (m,), 0 to 1.

    It is Huber's estimator, or with `biweight` Tukey's, which begins with the solution of Huber's.
    The scale of the residuals is their median size in each iteration.
    """
    # Each step solves min sum w_i (b_i - a_i x)^2, with the weights w = psi(u) / u of the residuals
    # u by their scale: min(1, c / |u|) of Huber, the biweight of Tukey.
    A = equations.A
    b = equations.b
    x = np.linalg.lstsq(A, b)[0]
    weights = np.ones(len(b))
    for with_biweight in (False, True)[:1 + biweight]:
        for _ in range(MAX_ITERATIONS):
            residuals = np.abs(b - A @ x)
            scale = float(median_of(residuals)) / NORMAL_MEDIAN
            if scale <= np.finfo(float).eps * np.abs(b).max():  # half of the rows fit exactly
                break
            if with_biweight:
                weights = _biweight(residuals / scale)
            else:
                weights = HUBER / np.maximum(residuals / scale, HUBER)
            root = np.sqrt(weights)
            previous = x
            x = np.linalg.lstsq(A * root[:, None], b * root)[0]
            if np.linalg.norm(x - previous) <= CONVERGED_CHANGE * np.linalg.norm(x):
                break
    return np.asarray(x), weights


def _biweight(u: FloatArray) -> FloatArray:
    """Return Tukey's weights of residuals in standard deviations: (1 - (u / c)^2)^2, 0 beyond c."""
    return np.asarray(np.where(u < TUKEY, (1.0 - (u / TUKEY) ** 2) ** 2, 0.0))
