"""The built-in methods that need no search: structures of terms, each with its estimator."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from termsel.adjustment.bayesian.field import GaussianProcess
from termsel.adjustment.bayesian.plane_average import PlaneAverage
from termsel.adjustment.control_views import view_of_control
from termsel.auto.physical import (
    PHOTO_MAX_POINTS,
    PHYSICAL_MAX_CHOSEN,
    PHYSICAL_MIN_POINTS,
    Physical,
    PinholeCamera,
    call_for_camera,
    camera_average_of,
    may_be_photo,
)
from termsel.auto.robust import Reweighted
from termsel.auto.selected import ForwardSelection
from termsel.auto.shrunken import (
    FIELD_CALLED_FOR,
    FIELD_EXCLUDED,
    Averaging,
    Interpolated,
    RidgeByOrder,
    interpolated,
    required_probability,
)
from termsel.data.fit_data import FitData, is_off_plane
from termsel.data.scaling import metres_of
from termsel.fitting.fit import Fit, Undetermined
from termsel.fitting.least_squares import LEAST_SQUARES, LeastSquares, require_determined
from termsel.fitting.method import Method
from termsel.models.base import SensorModel
from termsel.models.interpolating import Field, Field3D, ThinPlate
from termsel.models.polynomial import Affine, Helmert2D, Polynomial2D, Polynomial3D
from termsel.models.projective import DLT3D, Projective2D
from termsel.models.quotient import RationalFunctions


@dataclass(frozen=True, eq=False)
class Structure(Method):
    """A method with one model for features with heights and one for others.

    Parameters
    ----------
    name, title
        As for `Method`, whose other parameters follow by name.
    with_heights, without : SensorModel or None
        The model for features with heights that differ, and for others; None if there is none.

    Examples
    --------
    >>> import termsel
    >>> cubic = termsel.Structure("my-cubic", "a cubic polynomial", termsel.Polynomial3D(degree=3),
    ...                           termsel.Polynomial2D(degree=3))
    >>> cubic.title
    'a cubic polynomial'
    """

    with_heights: SensorModel | None
    without: SensorModel | None

    def declines(self, data: FitData) -> str | None:
        """Return why the structure cannot be fitted, None if it can.

        It needs a model for features with heights, or without, as those of `data` are.
        """
        if self.model(data.heights) is not None:
            return None
        return (f"{self.title} needs heights that are known and differ" if self.without is None
                else f"{self.title} is for features without heights")

    def tried(self, data: FitData) -> bool:
        """Return whether errors at held-out features can be known.

        They cannot for least squares without redundancy, which fit every feature exactly.
        """
        model = self.model(data.heights)
        # A point has two equations, and so has a line.
        return (model is None or not isinstance(self.estimator, LeastSquares)
                or 2 * len(data) > len(model.terms))

    def fit(self, data: FitData) -> Fit:
        """Return the fit of the model by the estimator, which is offered all its terms."""
        model = self.model(data.heights)
        assert model is not None
        terms = np.ones(len(model.terms), dtype=bool)
        used = np.ones(len(data), dtype=bool)
        return require_determined(
            self.estimator.fit(model, data.features, data.scaling, terms, used))

    def model(self, heights: bool) -> SensorModel | None:
        """Return the model for features with heights, or without; None if the structure has none.
        """
        return self.with_heights if heights else self.without

    def nearly(self, data: FitData) -> bool:
        """Return False: features that do not determine a structure do not in parts either."""
        return False

    def size(self, heights: bool) -> float:
        """Return the number of terms, or infinity where the estimator selects or shrinks them.

        A number of terms compares sizes only where all of them are in use.
        """
        model = self.model(heights)
        uses_all_terms = isinstance(self.estimator, LeastSquares | RidgeByOrder)
        return len(model.terms) if model is not None and uses_all_terms else np.inf


class _OfPlane(Structure):
    """A projective transformation, which needs a view where heights count."""

    def declines(self, data: FitData) -> str | None:
        """Return why it cannot be fitted; None if it can, as without heights or in an oblique view.
        """
        # Off a plane a projective transformation of the plane holds in an oblique view alone.
        if data.heights and view_of_control(data.scaled) is None:
            return f"{self.title} is for features without heights, or for oblique views"
        return super().declines(data)


class _OfCamera(Structure):
    """A projection that is a camera with few unknowns."""

    def declines(self, control: FitData) -> str | None:
        """Return why it cannot be used, as with lines or an unknown level; None if it can."""
        if len(control.features.lines):
            return f"{self.title} takes points alone, and there are lines"
        # A camera needs an up: geocentric coordinates have none.
        if metres_of(control.features, control.scaling) is None:
            return f"{self.title} needs to know which way is up, so no geocentric coordinates"
        return None

    def fit(self, control: FitData) -> Fit:
        """Fit the camera, where the points support one.

        Auto tries it for up to `PHOTO_MAX_POINTS` points; of more, it is fitted because it was
        asked for, and its residuals say how well it holds.

        Raises Undetermined where as few points do not show a photo by a camera without distortion.
        """
        is_tried_by_auto = len(control.features) <= PHOTO_MAX_POINTS
        if is_tried_by_auto and not call_for_camera(control.scaled, control.scaling):
            raise Undetermined("the points do not show a photo by a camera without distortion",
                               hint="Choose another model, such as dlt or projective.")
        # With heights wherever they differ: the camera knows what they do.
        heights_known = not control.features.without_height()
        return super().fit(
            replace(control, heights=heights_known and is_off_plane(control.scaled.points)))

    def refit(self, fitted: Fit, control: FitData) -> Fit:
        """Return the fit of a camera to other points, sought from the camera of a fit."""
        assert isinstance(self.estimator, PinholeCamera)
        return self.estimator.refit(fitted, control.features)

    def nearly(self, control: FitData) -> bool:
        """Return whether the points may be of a photo, so that parts of them may support a camera.
        """
        return may_be_photo(control.scaled, control.scaling)


class _Selected(Structure):
    """A structure whose terms are selected."""

    def refit(self, fitted: Fit, data: FitData) -> Fit:
        """Return the least-squares fit to other features of the terms that were selected."""
        # Selecting again among all points would be another model.
        return LEAST_SQUARES.fit(fitted.model, data.features, data.scaling, fitted.terms,
                                 np.ones(len(data), dtype=bool))


class _WithField(Structure):
    """A structure with a random field, which declines where the field is not likely."""

    def nearly(self, data: FitData) -> bool:
        """Return whether parts of the points may support the field: it is not all but excluded."""
        model = self.model(data.heights)
        assert model is not None
        process = interpolated(model, data.features, data.scaling)
        return isinstance(process, GaussianProcess) and process.probability > FIELD_EXCLUDED

    def describe(self, fitted: Fit) -> str:
        """Return a sentence on the probability of local deformation, and the least it must have."""
        process = fitted.interpolation
        if isinstance(process, PlaneAverage):
            return ("So few points cannot decide between a similarity, an affine image, "
                    f"polynomials and a spline. {self.label} stands for their average.")
        assert isinstance(process, GaussianProcess)
        if process.spline_weight > 0.0 and process.probability <= FIELD_CALLED_FOR:
            return ("So few points cannot decide between polynomials, local deformation, a spline "
                    f"and an affine image. {self.label} is their average; local deformation has "
                    f"a probability of {process.probability:.3g} in it.")
        # The requirement is stated where the field is a course of its own.
        requirement = ""
        if process.spline_weight == 0.0:
            requirement = f" (more than {required_probability(process):g} required)"
        return ("The points show local deformation, with a probability of "
                f"{process.probability:.3g}{requirement}.")


class _WithPhysics(Structure):
    """A structure with the prior of known cameras, which declines where that is not likely."""

    def refit(self, fitted: Fit, data: FitData) -> Fit:
        """Return the fit to more points, which may no longer support the prior."""
        try:
            return self.fit(data)
        except Undetermined:
            return named("regularised-cubic").fit(data)

    def describe(self, fitted: Fit) -> str:
        """Return a sentence on the kind of camera that is likeliest, and on the odds for it."""
        # The odds that `is_unlikely` asks for.
        odds = "three" if fitted.used.sum() <= PHYSICAL_MIN_POINTS else "twenty"
        return (
            f"{self.label} is used: a known kind of camera, most likely "
            f"{camera_average_of(fitted).kind}, is more than {odds} times as likely as an image of "
            "which nothing is known.")


def _polynomials(degree: int) -> tuple[SensorModel, SensorModel]:
    """Return the polynomials of a degree with heights and without, as `Structure` takes them."""
    return Polynomial3D(degree=degree), Polynomial2D(degree=degree)


_LIMITS = ("affine", "quadratic", "cubic")
_SIMILARITIES = ("similarity", "mirrored-similarity")
_SHRUNKEN = ("regularised-quadratic", "regularised-cubic")
_FAMILY = "the regularised polynomials"

ROBUST = (
    Structure("huber", "a quadratic polynomial by Huber's estimator", *_polynomials(2),
              estimator=Reweighted(biweight=False), short="quadratic, Huber", only_shown=True),
    Structure("tukey", "a quadratic polynomial by Tukey's biweight", *_polynomials(2),
              estimator=Reweighted(biweight=True), short="quadratic, Tukey", only_shown=True))
"""Those that give features that fit badly less weight."""

METHODS: tuple[Structure, ...] = (
    Structure("similarity", "a similarity", Helmert2D(), Helmert2D(), is_plain=True,
              for_few=True),
    Structure("mirrored-similarity", "a mirrored similarity", Helmert2D(mirrored=True),
              Helmert2D(mirrored=True), short="mirrored similarity", is_plain=True, for_few=True),
    Structure("plane-affine", "an affine polynomial without heights", Polynomial2D(degree=1), None,
              short="plane affine", is_plain=True, for_few=True),
    Structure("affine", "an affine polynomial", Affine(), Polynomial2D(degree=1), is_plain=True),
    Structure("dlt", "a direct linear transformation (DLT)", DLT3D(weighted=True), None,
              short="DLT", is_plain=True, central=True),
    _OfPlane("projective", "a projective transformation", Projective2D(weighted=True),
             Projective2D(weighted=True), is_plain=True, central=True),
    Structure("quadratic", "a quadratic polynomial", *_polynomials(2), is_plain=True),
    Structure("cubic", "a cubic polynomial", *_polynomials(3), is_plain=True),
    Structure("rfm-2", "a second-order rational function model", RationalFunctions(order=2), None,
              short="second-order RFM", is_plain=True),
    Structure("rfm-3", "a third-order rational function model", RationalFunctions(), None,
              short="full RFM"),
    Structure("ridge", "a third-order rational function model by ridge regression",
              RationalFunctions(), None, estimator=RidgeByOrder(), short="full RFM, ridge",
              only_shown=True),
    _Selected("selected", "a cubic polynomial of selected terms", *_polynomials(3),
              estimator=ForwardSelection(), short="selected cubic"),
    Structure("regularised-quadratic", "a regularised quadratic polynomial", *_polynomials(2),
              estimator=Averaging(), short="regularised quadratic", has_prior=True,
              contains=_LIMITS, family=_FAMILY),
    Structure("regularised-cubic", "a regularised cubic polynomial", *_polynomials(3),
              estimator=Averaging(), short="regularised cubic", has_prior=True, contains=_LIMITS,
              family=_FAMILY),
    _WithField("field", "a cubic polynomial with local deformation", Field3D(), Field(),
               estimator=Interpolated(), short="cubic, local deformation", has_prior=True,
               contains=(*_SIMILARITIES, *_LIMITS, *_SHRUNKEN), family=_FAMILY),
    Structure("tps", "a thin-plate spline", None, ThinPlate(), estimator=Interpolated(),
              short="thin-plate spline", needs=("field",)),
    _WithPhysics("physical-cubic",
                 "a cubic polynomial with the sensor-geometry prior",
                 *_polynomials(3), estimator=Physical(), short="cubic, sensor prior",
                 has_prior=True, contains=(*_LIMITS, *_SHRUNKEN, "field", "tps"), family=_FAMILY,
                 max_features=PHYSICAL_MAX_CHOSEN),
    _OfCamera("pinhole", "a pinhole camera", DLT3D(weighted=True), Projective2D(weighted=True),
              estimator=PinholeCamera(), short="pinhole camera", central=True,
              max_features=PHOTO_MAX_POINTS),
    *ROBUST,
)
"""All built-in methods, in the order of the tables that compare them."""


BY_NAME: dict[str, Structure] = {method.name: method for method in METHODS}
"""The built-in methods by name; the registry knows those of plugins, too."""


def named(name: str) -> Structure:
    """Return the built-in method of a name, such as "affine"; KeyError without one."""
    return BY_NAME[name]
