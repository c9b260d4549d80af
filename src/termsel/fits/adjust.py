"""The least squares of distances in the image, by Gauss-Newton where equations are not exact."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from termsel.adjustment.equations import Equations
from termsel.adjustment.solve import Adjustment, solve
from termsel.fits.fittable import Fittable
from termsel.measurements.features import BoolArray, FeatureSet, FloatArray

ITERATIONS = 20
"""Most Gauss-Newton steps of a fit; two or three are usual."""

HALVINGS = tuple(0.5**i for i in range(8))
"""Shares of a Gauss-Newton step that are tried in turn."""


def adjust(model: Fittable, features: FeatureSet, terms: BoolArray,
           used: BoolArray) -> Adjustment:
    """Return the least squares of distances, by Gauss-Newton where equations are not exact.

    The model is prepared, the features are scaled; `terms` (k,) and `used` (features,) are in use.
    A step that does not lessen the sum of squared distances is halved, and where that does not help
    the search ends.
    """
    adjustment = solve(model.equations(features), terms, used)

    def left(equations: Equations, coefficients: FloatArray) -> FloatArray:
        """Return what the rows in use leave, pseudo-observations with them."""
        A, b = equations.take(used[equations.feature], np.ones_like(terms)).held()
        return np.asarray(b - A @ coefficients)

    equations = (model.linearised(features, adjustment.coefficients)
                 if adjustment.feasible else None)
    for _ in range(ITERATIONS):
        if equations is None:
            break
        v = left(equations, adjustment.coefficients)
        step = solve(equations, terms, used).coefficients - adjustment.coefficients
        for share in HALVINGS:
            coefficients = adjustment.coefficients + share * step
            nearer = model.linearised(features, coefficients)
            assert nearer is not None
            w = left(nearer, coefficients)
            if w @ w < (1 - 1e-10) * (v @ v):
                break
        else:
            break
        there = solve(nearer, terms, used)
        if not there.feasible:  # near a pole, where the equations say nothing of what is determined
            break
        equations = nearer
        adjustment = replace(there, coefficients=coefficients,
                             residuals=equations.b - equations.A @ coefficients)
    return adjustment
