"""What the coefficients of a fit say of the sensor, and how certain that is."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from msgspec.structs import replace

from termsel.core.errors import TermselError
from termsel.data.features import FloatArray
from termsel.data.record.figures import SensorFigure
from termsel.fitting.fit import Fit

_PLACES = 5  # along each axis of a box
_COEFFICIENT_STEP = 1e-5  # of scaled coefficients
_TURN = 360.0


def sensor_of(fitted: Fit) -> tuple[SensorFigure, ...]:
    """Return the figures of the sensor with their standard deviations, where these are known.

    The estimator knows the covariance of what the fit sees of any places, as a product of factors
    F. Coefficients move places by slopes S, so that their errors are S^+ F, and figures have
    derivatives D by coefficients: the lengths of the rows of D S^+ F are standard deviations.
    """
    model = fitted.model
    coefficients = fitted.adjustment.coefficients
    figures = model.sensor_figures(coefficients)
    if not figures or not fitted.terms.all():
        return figures
    ground = _box_places()
    # A fit in roles has the coefficients of the one that it was made of, which knows their spread.
    original = fitted.original or fitted
    try:
        factors = original.estimator.spread(original, ground).factors
    except TermselError:  # of an estimator that knows no uncertainty
        return figures
    if factors is None:
        return figures
    slopes = _central_differences(
        lambda values: model.project(values, ground).ravel(), coefficients)
    errors_at_places = factors.reshape(len(slopes), -1)
    is_seen = np.isfinite(slopes).all(axis=1) & np.isfinite(errors_at_places).all(axis=1)
    # Coefficients differ by magnitudes in how far they move the image.
    lengths = np.linalg.norm(slopes[is_seen], axis=0)
    if not (lengths > 0.0).all():
        return figures
    errors = np.linalg.lstsq(slopes[is_seen] / lengths, errors_at_places[is_seen],
                             rcond=None)[0] / lengths[:, None]
    is_angle = np.array([figure.unit == "deg" for figure in figures])
    derivatives = _central_differences(
        lambda values: np.array([figure.value for figure in model.sensor_figures(values)]),
        coefficients, np.where(is_angle, _TURN, np.inf))
    deviations = np.linalg.norm(derivatives @ errors, axis=1).tolist()
    return tuple(replace(figure, standard_deviation=deviation if np.isfinite(deviation) else None)
                 for figure, deviation in zip(figures, deviations, strict=True))


def _box_places() -> FloatArray:
    """Return places all over the box of the control, scaled, (m, 3)."""
    steps = np.linspace(-1.0, 1.0, _PLACES)
    return np.stack([axis.ravel() for axis in np.meshgrid(steps, steps, steps)], axis=1)


def _central_differences(function: Callable[[FloatArray], FloatArray], values: FloatArray,
                         period: FloatArray | float = np.inf) -> FloatArray:
    """Return central differences (m, k) of a function of k values; angles may pass a full turn."""
    columns = []
    for step in _COEFFICIENT_STEP * np.eye(len(values)):
        difference = function(values + step) - function(values - step)
        turned = np.isfinite(period) & (np.abs(difference) > np.divide(period, 2.0))
        columns.append(np.where(turned, difference - np.sign(difference) * np.where(
            np.isfinite(period), period, 0.0), difference) / (2.0 * _COEFFICIENT_STEP))
    return np.stack(columns, axis=1)
