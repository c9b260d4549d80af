"""A method fitted to features and held against them: what auto compares."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from termsel.data.features import FloatArray, no_points
from termsel.data.fit_data import FitData
from termsel.fitting.fit import Fit, Undetermined
from termsel.fitting.least_squares import left_out_squares
from termsel.fitting.method import Method
from termsel.models.poles import guard_points, pole_margin, pole_violation

POLE_BOX_FACTOR = 1.5
"""A denominator must be positive in a box this much wider than that of the points."""


def validated(method: Method, data: FitData) -> Fit | None:
    """Return a method fitted to features, with the errors of each held out.

    None where auto does not try it, the features do not determine it with redundancy, or it has a
    pole.
    """
    if not method.tried(data):
        return None
    try:
        fitted = replace(method.fit(data), method=method)
        if fitted.stored_held_out is None and (
                fitted.adjustment.redundancy < 1 or has_pole(fitted)):
            return None
        fitted.held_out()
    except Undetermined:
        return None
    return fitted


def has_pole(fitted: Fit) -> bool:
    """Return whether a denominator falls short of the margin in a box wider than the points'.

    What no image of such a view shows, as it lies behind the camera, does not count.
    """
    control = fitted.scaled_control
    return bool(pole_violation(
        fitted.model, fitted.adjustment.coefficients[None],
        guard_points(control, no_points(), POLE_BOX_FACTOR), pole_margin(control.points))[0])


def refusal(fitted: Fit) -> str:
    """Return why a fit by least squares, which is determined, is not judged; "" if it is."""
    if not fitted.estimator.least_squares:
        return ""
    if has_pole(fitted):
        return "a denominator is near zero or negative at or near the control (a pole)"
    if not np.isfinite(left_out_squares(fitted)).all():
        return ("without one of the features it is not determined, or has a denominator near "
                "zero or negative there (a pole)")
    return ""


def gain_of(squares: FloatArray, other_squares: FloatArray, rounding: float = 0.0) -> float:
    """Return by how many standard errors squared errors are smaller than others, in logarithms.

    The gain is the mean of g = log(others / squares) by its standard error. Errors up to `rounding`
    are none, and equal: of points that a model fits exactly, the logarithms of the residuals would
    differ by chance, and from processor to processor.
    """
    tiny = np.finfo(float).tiny
    smallest = max(rounding**2, tiny)
    gain = np.log(np.maximum(other_squares, smallest) / np.maximum(squares, smallest))
    return float(gain.mean() / max(gain.std(ddof=1) / np.sqrt(len(gain)), tiny))
