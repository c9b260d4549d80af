"""Fits that predict from the control points themselves, for images with local deformation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from termsel.adjustment.bayesian.field import GaussianProcess
from termsel.adjustment.interpolation import Interpolation
from termsel.data.features import BoolArray, FeatureSet, Points
from termsel.data.scaling import Scaling
from termsel.fitting.fit import Estimator, Fit, HeldOut, Undetermined
from termsel.fitting.least_squares import LeastSquares
from termsel.models.base import SensorModel

FIELD_CALLED_FOR = 0.75
"""Probability of a random field beyond which points support it: odds of three to one, beyond
which the evidence is positive (Kass and Raftery 1995, J. Am. Stat. Assoc. 90)."""

FIELD_EXCLUDED = 0.05
"""Probability up to which parts of many points are not asked for a field either."""


def required_probability(process: GaussianProcess) -> float:
    """Return the probability of a random field beyond which points support it.

    Of few points without heights, up to `field.SURE`, any: they tell too little to choose by.
    """
    return FIELD_CALLED_FOR * (1.0 - process.spline_weight)


def interpolated(model: SensorModel, control: FeatureSet, scaling: Scaling) -> Interpolation | None:
    """Return what a model predicts from control points; None where they are too few."""
    return model.prepared(scaling, control.crs).interpolation(scaling.features(control))


class Interpolated(Estimator):
    """The interpolation of a model, where the points support it.

    Its terms are those of least squares, and have no influence. A random field is supported where
    its probability exceeds `required_probability`.
    """

    name = "interpolated"

    def fit(self, model: SensorModel, control: FeatureSet, scaling: Scaling, terms: BoolArray,
            used: BoolArray) -> Fit:
        """Fit a model (see `Estimator.fit`)."""
        points_alone(control, used, "an interpolation")
        interpolation = interpolated(model, control.take(used), scaling)
        if interpolation is None:
            raise Undetermined(f"{used.sum()} control points are too few to interpolate by",
                               hint="Measure more control, spread over the area.")
        if isinstance(interpolation, GaussianProcess
                      ) and interpolation.probability <= required_probability(interpolation):
            raise Undetermined("the points do not show local deformation: its probability is "
                               f"{interpolation.probability:.2g}", hint="Choose a polynomial.")
        plain = LeastSquares(iterated=False).fit(model, control, scaling, terms, used)
        errors = interpolation.errors * scaling.image_scale
        unknown = np.full(len(terms), np.nan)
        return replace(plain, estimator=self, trace=interpolation.effective,
                       stored_held_out=HeldOut.of(errors, control.take(used)),
                       adjustment=replace(plain.adjustment, deviations=unknown,
                                          correlations=None))


def points_alone(control: FeatureSet, used: BoolArray, taker: str) -> Points:
    """Return the points in use (n,), and refuse lines for what does not take them, in words."""
    if len(control.lines):
        raise Undetermined(f"{taker} takes control points alone, and there are control lines",
                           hint="Leave the lines out, or choose another model.")
    return control.points.take(used)
