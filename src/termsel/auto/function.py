"""A plain function as a method: it takes features, and returns what projects places on the ground.

Such as a script of one's own or another package. It is fitted, held out and compared with all other
methods alike.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, replace
from typing import Any

import numpy as np

from termsel.auto.refits import held_out_by_refits
from termsel.core.errors import TermselError, first_names_in_words
from termsel.core.isolation.arrays import difference_from_shape
from termsel.core.isolation.faults import attribute_errors_to, fault_of_method
from termsel.data.arrays import numbers_or_nan
from termsel.data.features import BoolArray, FeatureSet, FloatArray
from termsel.data.fit_data import FitData
from termsel.data.scaling import Scaling
from termsel.fitting.fit import Estimator, Fit, HeldOut, Undetermined
from termsel.fitting.least_squares import LeastSquares, require_determined
from termsel.fitting.method import Method
from termsel.models.base import SensorModel
from termsel.models.polynomial import Affine, Polynomial, Polynomial2D

MAX_NAMED = 3
"""Features that a message names."""

Projection = Callable[[FloatArray], Any]
"""Line and sample [px], shape (n, 2), of ground places in the CRS of the features, shape (n, 3)."""


class _Projects(Polynomial):
    """What a function projects. Its terms are those of an affine polynomial, without influence."""

    projection: Projection | None = None
    """What the function returned."""

    def predict(self, coefficients: FloatArray, control: FeatureSet,
                ground: FloatArray) -> FloatArray:
        """Return the function's image positions, scaled, (..., n, 2), for ground (n, 3).

        The coefficients (..., k) only give the shape; the function has none.

        Raises PluginFault where the function returns no positions of the shape (n, 2).
        """
        scaling = self.scaling
        projection = self.projection
        assert scaling is not None
        assert projection is not None
        with attribute_errors_to(projection, "project"):
            positions = numbers_or_nan(projection(scaling.unscaled(ground)))
        if fault := difference_from_shape(positions, (len(ground), 2), finite=False):
            raise fault_of_method(projection, "project", fault)
        image = scaling.image(positions)
        return np.broadcast_to(image, (*coefficients.shape[:-1], *image.shape)).copy()


class OfFunction(_Projects, Affine):
    """What a function projects for places with heights."""

    name = "function"


class OfPlaneFunction(_Projects, Polynomial2D):
    """What a function projects for places without heights."""

    name = "plane-function"


class FunctionEstimator(Estimator):
    """What a function of one's own does, of which nothing else is known."""

    name = "function"
    repeatable = False

    def fit(self, model: SensorModel, control: FeatureSet, scaling: Scaling, terms: BoolArray,
            used: BoolArray) -> Fit:
        """Refuse, as the function is called with all features by its method alone."""
        raise TermselError("the estimator of this fit is a function of one's own",
                           hint="Fit the method again: termsel.fit(features, method).")


FUNCTION = FunctionEstimator()


@dataclass(frozen=True, eq=False)
class FunctionMethod(Method):
    """A method that is a plain function.

    Its errors held out are those of calling it again without some of the features.

    Parameters
    ----------
    name, title
        As for `Method`, whose other parameters follow by name.
    function : callable
        Takes a `FeatureSet`, and returns a function of ground places, shape (n, 3), in its CRS,
        that returns line and sample [px], shape (n, 2); or an object with such a method `project`.
        What it cannot be fitted to it refuses by raising `Undetermined`.

    Examples
    --------
    >>> import numpy as np
    >>> import termsel
    >>> def affine(features):
    ...     points = features.points
    ...     design = np.column_stack([np.ones(len(points)), points.ground])
    ...     solution = np.linalg.lstsq(design, points.image, rcond=None)[0]
    ...     return lambda ground: np.column_stack([np.ones(len(ground)), ground]) @ solution
    >>> scene = termsel.simulate_scene("ikonos-hamedan", n_lines=0)
    >>> fitted = termsel.fit(scene, termsel.FunctionMethod("mine", "a script", function=affine))
    >>> independent = scene.points.take([role == "independent" for role in scene.points.roles])
    >>> round(fitted.rmse(independent).total, 1)  # px
    2.9
    """

    _: KW_ONLY
    function: Callable[[FeatureSet], Any]
    on_request: bool = True
    estimator: Estimator = FUNCTION

    def fit(self, data: FitData) -> Fit:
        """Return the fit of the function, called again without each feature, or parts of many."""
        fitted = self._call_function(data)
        try:
            held_out = held_out_by_refits(self._call_function, data.features, heights=data.heights)
        except Undetermined:
            return fitted
        # Projected it can be where the function knows a position, but not judged: see `held_out`.
        if not np.isfinite(held_out.squares).all():
            return fitted
        # As much as errors grow where their features take no part, so many parameters there are:
        # PRESS = RSS / (1 - p / 2 n)^2, the generalised cross-validation of Craven and Wahba 1979.
        squares = fitted.control_errors(fitted.used)**2
        held_out_sum = max(held_out.squares.sum(), np.finfo(np.float64).tiny)
        share_fitted = np.sqrt(squares.sum() / held_out_sum)
        effective = squares.size * (1.0 - min(float(share_fitted), 1.0))
        return replace(fitted, trace=effective, stored_held_out=held_out)

    def held_out(self, fitted: Fit) -> HeldOut:
        """Return the errors of features where the function is called again without them.

        Raises PluginFault where it has no position for some of them, as what interpolates has none
        outside the others: nothing is known of its accuracy there.
        """
        held_out = fitted.stored_held_out or held_out_by_refits(
            self._call_function, fitted.control, heights=fitted.model.uses_height)
        missing = np.flatnonzero(~np.isfinite(held_out.squares))
        if missing.size:
            names = first_names_in_words([fitted.control.ids[i] for i in missing], MAX_NAMED)
            assert isinstance(fitted.model, _Projects)
            raise fault_of_method(
                fitted.model.projection, "project",
                f"returned no finite position for {missing.size} of {len(fitted.control)} features "
                f"that it was not fitted to ({names}), so that its accuracy is not known; expected "
                "one for every place, beyond the features, too")
        return held_out

    def _call_function(self, data: FitData) -> Fit:
        """Return the fit that projects by the user's function, with the terms of an affine model.

        Raises PluginFault where the function fails, or its value cannot project.
        """
        features = data.features
        with attribute_errors_to(self.function, "fit"):
            returned = self.function(features)
        # An object with a method `project`, or the function itself.
        projection = getattr(returned, "project", returned)
        if not callable(projection):
            raise fault_of_method(self.function, "fit",
                                  f"returned {type(returned).__name__}, which projects "
                                  "nothing")
        model: _Projects = OfFunction() if data.heights else OfPlaneFunction(degree=1)
        model.projection = projection
        terms = np.ones(len(model.terms), dtype=bool)
        used = np.ones(len(features), dtype=bool)
        plain = LeastSquares(iterated=False).fit(model, features, data.scaling, terms, used)
        require_determined(plain)
        unknown = np.full(len(terms), np.nan)
        return replace(plain, estimator=self.estimator, trace=np.nan, adjustment=replace(
            plain.adjustment, deviations=unknown, correlations=None))
