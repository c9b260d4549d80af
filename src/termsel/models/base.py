"""Public base class of sensor models."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from copy import copy
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from termsel.adjustment.equations import Equations
from termsel.adjustment.interpolation import Interpolation
from termsel.core.errors import TermselError, first_names_in_words
from termsel.core.isolation.arrays import difference_from_shape, difference_from_type, returns_type
from termsel.core.isolation.calls import Check
from termsel.core.options import Configurable
from termsel.core.remedies import Remedy
from termsel.data.coordinates.crs import to_wgs84
from termsel.data.extent import KnownImage
from termsel.data.features import BoolArray, FeatureSet, FloatArray, IntArray
from termsel.data.scaling import Scaling

if TYPE_CHECKING:
    from termsel.data.record.figures import SensorFigure
    from termsel.data.rpc import Rpc

LINE, SAMPLE, BOTH = 0, 1, 2
"""Image axis a term acts on."""


def _terms_fault(_model: SensorModel, value: Any) -> str | None:
    """Return how names of terms are at fault; None if they are not."""
    if (isinstance(value, tuple) and value and all(isinstance(name, str) for name in value)
            and len(set(value)) == len(value)):
        return None
    return f"returned {value!r:.200}; expected a tuple of different names"


def _equations_fault(model: SensorModel, value: Any, *_args: Any) -> str | None:
    """Return how equations are at fault, such as a wrong shape; None if they are not."""
    return _linearised_fault(model, value, finite=True)


def _linearised_fault(model: SensorModel, value: Any, *_args: Any, finite: bool = False,
                      ) -> str | None:
    """Return how equations about a solution are at fault; None if they are not."""
    return (difference_from_type(value, Equations)
            or difference_from_shape(
                value.A, (-1, len(model.terms)), finite=finite, verb="returned as A")
            or difference_from_shape(value.b, (len(value.A),), finite=finite, verb="returned as b")
            or difference_from_shape(value.feature, (len(value.A),), verb="returned as feature"))


def _start_fault(model: SensorModel, value: Any, *_args: Any) -> str | None:
    """Return how coefficients are at fault that should be one for each term; None if they are not.
    """
    return difference_from_shape(value, (len(model.terms),))


def _image_fault(_model: SensorModel, value: Any, coefficients: FloatArray, *args: Any,
                 ) -> str | None:
    """Return how image positions are at fault; None if they are not, as if infinite at a pole."""
    # `project` is called with coefficients and ground, `predict` with the control in between.
    ground = args[-1]
    return difference_from_shape(
        value, (*np.shape(coefficients)[:-1], len(ground), 2), finite=False)


def _weights_fault(_model: SensorModel, value: Any, control: FloatArray, ground: FloatArray,
                   ) -> str | None:
    """Return how weights, one for each place and control feature, (m, n), are at fault, or None."""
    return difference_from_shape(value, (len(ground), len(control)))


def _axis_fault(model: SensorModel, value: Any) -> str | None:
    """Return how the axis of each term, LINE, SAMPLE or BOTH, is at fault; None if it is not."""
    fault = difference_from_shape(value, (len(model.terms),))
    if fault is None and not np.isin(value, (LINE, SAMPLE, BOTH)).all():
        return "returned an array with other numbers than 0, 1 and 2"
    return fault


def _rpc_fault(_model: SensorModel, value: Any, *_args: Any) -> str | None:
    """Return how a value is at fault that should be an RPC; None if it is one."""
    from termsel.data.rpc import Rpc

    return difference_from_type(value, Rpc)


def _model_fault(_model: SensorModel, value: Any, *_args: Any) -> str | None:
    """Return how a value is at fault that should be a model; None if it is one."""
    return difference_from_type(value, SensorModel)


def _allow_none(check: Check) -> Check:
    """Return a check that also takes None."""
    return lambda model, value, *args: None if value is None else check(model, value, *args)


class SensorModel(Configurable, ABC):
    """A mapping from ground to image whose terms can be switched on and off.

    A model works in scaled coordinates: image and ground within about [-1, 1] (see
    `termsel.data.scaling`). A model that depends on its place on Earth finds it in
    `scaling` and `crs`, or calls `geographic`.

    Examples
    --------
    >>> import termsel
    >>> termsel.Polynomial3D(degree=1).terms[0]
    'line.num:1'
    """

    kind = "model"
    guards: ClassVar[Mapping[str, Check | None]] = {
        "terms": _terms_fault, "axis": _axis_fault, "prepared": _model_fault,
        "equations": _equations_fault, "linearised": _allow_none(_linearised_fault),
        "start": _allow_none(_start_fault),
        "project": _image_fault, "predict": _image_fault, "denominators": _allow_none(_image_fault),
        "residual_weights": _allow_none(_weights_fault), "as_rpc": _allow_none(_rpc_fault),
        "interpolation": _allow_none(returns_type(Interpolation)),
        "known_image": _allow_none(returns_type(KnownImage)),
        "polynomial_degree": _allow_none(returns_type(int))}

    uses_height: ClassVar[bool] = True
    """Whether it requires the heights of the features."""

    scaling: Scaling | None = None
    """How coordinates are scaled; None before the model is `prepared`."""

    crs: str = ""
    """Of the ground coordinates; empty before the model is `prepared`."""

    def prepared(self, scaling: Scaling, crs: str) -> Self:
        """Return the model for features with this scaling, as every fit calls it.

        Parameters
        ----------
        scaling : Scaling
        crs : str
            The CRS of the ground coordinates.

        Raises
        ------
        TermselError
            If the model is not valid at this place.
        """
        # The same object, so that what the model caches is kept.
        if (self.scaling, self.crs) == (scaling, crs):
            return self
        # A copy: the same model may be fitted to several images at once.
        ready = copy(self)
        ready.scaling = scaling
        ready.crs = crs
        return ready

    def with_parameters(self, parameters: Mapping[str, Any]) -> Self:
        """Return the model with parameters of a selection as values of its options.

        Parameters
        ----------
        parameters : mapping
            Values by name; names that are no option of the model are ignored.

        Raises
        ------
        TermselError
            For a value that the option does not accept.
        """
        option_names = {option.name for option in self.declared_options}
        values = {name: value for name, value in parameters.items() if name in option_names}
        if not values:
            return self
        # A new instance, which checks its options and keeps nothing of this one but its place.
        changed = type(self)(**{**self.options, **values})
        return changed if self.scaling is None else changed.prepared(self.scaling, self.crs)

    def geographic(self, ground: FloatArray) -> FloatArray:
        """Return WGS84 longitude, latitude [deg] and ellipsoidal height [m], shape (n, 3).

        Parameters
        ----------
        ground : ndarray, shape (n, 3)
            Scaled.

        Raises
        ------
        TermselError
            If the model is not prepared, or its CRS cannot be converted to WGS84.
        """
        if self.scaling is None:
            raise TermselError(f"model {self.name!r} is not prepared: its place is not known",
                               hint="Fit it, or call its method prepared first.")
        return to_wgs84(self.crs)(self.scaling.unscaled(ground))

    def as_rpc(self, coefficients: FloatArray) -> Rpc | None:
        """Return the RPC that projects as the model does; None, the default, if none is known.

        Rational functions and polynomials need not define it: termsel reads it from their terms.

        Parameters
        ----------
        coefficients : ndarray, shape (k,)
            Of all terms; 0 of those that are not selected.
        """
        return None

    def sensor_figures(self, coefficients: FloatArray) -> tuple[SensorFigure, ...]:
        """Return what the coefficients say of the sensor, such as the place and angles of a camera.

        Results show and record them. Empty, the default, where the terms stand for no sensor.

        Parameters
        ----------
        coefficients : ndarray, shape (k,)
            Of all terms; 0 of those that are not selected.
        """
        return ()

    def known_image(self) -> KnownImage | None:
        """Return size and area of the image where the model knows them before it is fitted.

        The metadata of a product may state them: then few points, and one already, are enough for
        all of the image. None, the default, leaves it to the features.
        """
        return None

    @property
    @abstractmethod
    def terms(self) -> tuple[str, ...]:
        """Names of the k terms, such as "line.num:X2Y" (see `termsel.Term`)."""

    @property
    def axis(self) -> IntArray:
        """Image axis of each term: 0 line, 1 sample, 2 both; shape (k,)."""
        # The careful default: a term of one axis alone may be solved for without the other.
        return np.full(len(self.terms), BOTH, dtype=np.intp)

    @abstractmethod
    def equations(self, features: FeatureSet) -> Equations:
        """Return the linear equations of control features, in scaled coordinates.

        Parameters
        ----------
        features : FeatureSet
            In scaled coordinates.

        Returns
        -------
        Equations
            Rows of the points first, then of the lines; all k columns.
        """

    def start(self, features: FeatureSet) -> FloatArray | None:
        """Return coefficients with which a fit begins, if positions are not linear in the terms.

        From there `linearised` is iterated in steps that never increase the sum of squares. A model
        that computes the solution by itself returns that: the fit then ends at once.

        Parameters
        ----------
        features : FeatureSet
            Those in use, in scaled coordinates.

        Returns
        -------
        ndarray, shape (k,), or None
            One for each term; those of terms that are not selected are set to 0. None, the default,
            where the fit begins with the solution of `equations`.
        """
        return None

    @property
    def first_terms(self) -> BoolArray | None:
        """Terms (k,) whose solution an iteration begins at; None, the default, for all."""
        return None

    def linearised(self, features: FeatureSet, coefficients: FloatArray) -> Equations | None:
        """Return the equations about a solution, where `equations` hold to first order only.

        With them a fit iterates to the least squares of distances in the image (Gauss-Newton). A
        step to where they are not finite is made shorter.

        Parameters
        ----------
        features : FeatureSet
            In scaled coordinates.
        coefficients : ndarray, shape (k,)
            The solution: A x = b holds for the coefficients themselves, not for their changes,
            and b - A x there are the distances.

        Returns
        -------
        Equations or None
            None where `equations` are exact, which is the default.
        """
        return None

    @abstractmethod
    def project(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        """Return image positions of ground points.

        Parameters
        ----------
        coefficients : ndarray, shape (..., k)
            One set or many.
        ground : ndarray, shape (n, 3)
            Scaled.

        Returns
        -------
        ndarray, shape (..., n, 2)
            Scaled line and sample.
        """

    def denominators(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray | None:
        """Return the denominators, shape (..., n, 2), or None where there are none.

        A denominator that changes sign inside the scene is a pole.
        """
        return None

    @property
    def polynomial_degree(self) -> int | None:
        """Total degree, if the model is a polynomial of the ground coordinates; else None."""
        return None

    def interpolation(self, control: FeatureSet) -> Interpolation | None:
        """Return the prediction by control points, of a model that predicts by them alone.

        Parameters
        ----------
        control : FeatureSet
            The control features in use, scaled.

        Returns
        -------
        Interpolation or None
            None for a model that does not predict so, which is the default, and where the points
            are too few or lie so that they determine no prediction.
        """
        return None

    @property
    def corrects(self) -> bool:
        """True if the control corrects predictions directly, not by the coefficients alone.

        A control feature then helps to predict itself. Its residual is too small, and zero where
        the model interpolates.
        """
        model_class = type(self)
        return (model_class.residual_weights is not SensorModel.residual_weights
                or model_class.predict is not SensorModel.predict)

    def predict(self, coefficients: FloatArray, control: FeatureSet,
                ground: FloatArray) -> FloatArray:
        """Return image positions, with the correction that the control gives, if any.

        By default the correction from `residual_weights` is added to `project`. A model with
        another second step overrides this.

        Parameters
        ----------
        coefficients : ndarray, shape (..., k)
            One set or many.
        control : FeatureSet
            The control features in use, scaled.
        ground : ndarray, shape (n, 3)
            Scaled.

        Returns
        -------
        ndarray, shape (..., n, 2)
            Scaled line and sample.
        """
        # p(g) + W(g) (l - p(g_control)): the residuals of the control, spread over other places.
        image = self.project(coefficients, ground)
        points = control.points
        weights = self.residual_weights(points.ground, ground) if len(points) else None
        if weights is not None:
            image = image + weights @ (points.image - self.project(coefficients, points.ground))
        return image

    def residual_weights(self, control: FloatArray, ground: FloatArray) -> FloatArray | None:
        """Return weights that spread control residuals over other places.

        An interpolating model corrects its prediction by W v, where v are the residuals
        of the control points.

        Parameters
        ----------
        control : ndarray, shape (n, 3)
            Scaled ground positions of the control points.
        ground : ndarray, shape (m, 3)
            Scaled ground positions to be corrected.

        Returns
        -------
        ndarray, shape (m, n), or None
            None for a model without such a correction.
        """
        return None


def require_heights(model: SensorModel, features: FeatureSet) -> None:
    """Raise TermselError for features without height if the model uses it; it names the first five.
    """
    missing = features.without_height()
    if model.uses_height and missing:
        raise TermselError(
            f"model {model.name!r} needs heights; they are unknown for {len(missing)} of the "
            f"{features.word}: {first_names_in_words(missing, 5)}",
            hint=f"Add heights, as by {Remedy('dem', 'FILE')}, or choose a plane model: "
                 f"{Remedy('model', 'poly2d')}.",
            ids=missing[:1])
