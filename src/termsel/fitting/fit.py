"""One fitted model: its adjustment, its residuals, its RMSE, and itself without each feature."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, suppress
from dataclasses import asdict, dataclass, is_dataclass, replace
from functools import cached_property
from os import PathLike
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import ArrayLike

from termsel.adjustment.control_views import view_of_control
from termsel.adjustment.equations import has_unlike_weights, line_normals, weights_of
from termsel.adjustment.interpolation import Interpolation
from termsel.adjustment.solve import ROUNDING, Adjustment
from termsel.core.arguments import CALLED_LOCATE, CALLED_PROJECT, Explained, explains_arguments
from termsel.core.display import Glance
from termsel.core.errors import TermselError, shown_value
from termsel.core.threads import one_blas_thread
from termsel.data.arrays import numbers_or_nan
from termsel.data.coordinates.crs import is_geocentric
from termsel.data.extent import image_extent, reach
from termsel.data.features import BoolArray, FeatureSet, FloatArray, Lines, Points
from termsel.data.locate import Surface, locate
from termsel.data.record.figures import Rmse, Settings
from termsel.data.relief import unmasked, visible_ground
from termsel.data.scaling import Scaling, make_scaling, to_fit_crs
from termsel.data.view import CentralView
from termsel.fitting.camera_courses import CameraCourses, camera_courses, share_of_courses
from termsel.fitting.extrapolation import far_rows_in_words, variance_by_heights
from termsel.fitting.local_courses import LocalCourses, local_courses
from termsel.fitting.misfit import MISFIT_BATCH, Misfit, NoisePrior, misfit_of, mixed_misfit
from termsel.fitting.residuals import Residuals, control_residuals, rmse_of
from termsel.fitting.uncertainty import (
    Experience,
    Spread,
    Unexplained,
    spread_of,
    unexplained_by,
)
from termsel.models.base import SensorModel

UNDECIDED_POINTS, UNDECIDED = 20, 0.1
"""Below so many points, a probability of local deformation between this and one less this is said
to be undecided."""


class Undetermined(TermselError):
    """The control does not determine the terms of a model.

    Examples
    --------
    >>> import termsel
    >>> points = termsel.simulate_scene("spot-isfahan").points.take([0, 1])
    >>> try:
    ...     termsel.fit(termsel.FeatureSet(points=points, crs="EPSG:4979"), "affine")
    ... except termsel.TermselError as error:
    ...     print(type(error).__name__)
    Undetermined
    """


class Estimator(ABC):
    """How terms and coefficients are found from control: by least squares, by shrinkage ...

    Examples
    --------
    >>> import termsel
    >>> fitted = termsel.fit(termsel.simulate_scene("spot-isfahan"), "affine")
    >>> type(fitted.estimator).__name__
    'LeastSquares'
    >>> fitted.estimator.held_out(fitted).squares.shape  # of each control point left out [px^2]
    (12,)
    """

    name: ClassVar[str]
    """Name in the record of a run."""

    least_squares: ClassVar[bool] = False
    """Whether the coefficients are those of least squares, which the adjustment describes; others
    are determined whatever the adjustment says of the terms."""

    repeatable: ClassVar[bool] = True
    """Whether the estimator can be applied again, such as without a feature."""

    @property
    def options(self) -> Settings:
        """The estimator's own options and their values, by name; {} if it has none."""
        # A result stores them, so that the same estimator can be made again.
        return asdict(self) if is_dataclass(self) and not isinstance(self, type) else {}

    @abstractmethod
    def fit(self, model: SensorModel, control: FeatureSet, scaling: Scaling, terms: BoolArray,
            used: BoolArray) -> Fit:
        """Fit a model to control features.

        Parameters
        ----------
        model : SensorModel
        control : FeatureSet
            In px and ground units.
        scaling : Scaling
        terms : ndarray of bool, shape (k,)
            Terms in use; an estimator that selects terms offers itself all of them.
        used : ndarray of bool, shape (len(control),)
            Features in use.

        Returns
        -------
        Fit
            The solution, with the terms and features that it used.

        Raises
        ------
        Undetermined
            By an estimator that finds no solution.
        """

    def spread(self, fitted: Fit, ground: FloatArray) -> Spread:
        """Return the mean square errors of a fit at scaled places, shape (m, 3).

        See `termsel.fitting.uncertainty`, which judges any coefficients.
        """
        # Only the features in use show how well the coefficients are known.
        used = fitted.scaled_control.take(fitted.used)
        image = fitted.model.predict(fitted.adjustment.coefficients, used, ground)
        return spread_of(fitted.model, used, fitted.terms, fitted.adjustment, ground, image,
                         least_squares=self.least_squares)

    def unexplained(self, fitted: Fit, residuals: FloatArray) -> list[Unexplained]:
        """Return what each course that `spread` takes for possible leaves of the control.

        For an estimator with a spread of its own the only course is the fit itself, whose scaled
        residuals (n, 2) are given.
        """
        # Of coefficients from elsewhere nobody knows how many parameters they are worth.
        effective = fitted.effective if np.isfinite(fitted.effective) else None
        own = Unexplained(1.0, residuals, effective)
        if type(self).spread is not Estimator.spread:
            return [own]
        return unexplained_by(fitted.model, fitted.scaled_control.take(fitted.used), fitted.terms,
                              fitted.adjustment, own, least_squares=self.least_squares)

    def view(self, features: FeatureSet, scaling: Scaling) -> CentralView | None:
        """Return the central projection that scaled features in use support, or None."""
        return view_of_control(features)

    def held_out(self, fitted: Fit) -> HeldOut:
        """Return the errors of features in use, each under this estimator without that feature.

        By default the fit is repeated without each feature.

        Raises
        ------
        Undetermined
            If the control without some feature does not determine the terms.
        """
        # The closed form where there is one, else refits without each feature.
        errors, determined = fitted.errors_without_each
        if not determined:
            raise Undetermined("without one of its control features the fit is not determined",
                               hint="Measure more control, or choose a model with fewer terms.")
        return HeldOut.of(np.concatenate(errors), fitted.control.take(fitted.used))

    def experience(self, fitted: Fit) -> Experience | None:
        """Return what is known of the errors besides held-out errors; by default nothing: None."""
        return None

    def without_each(self, fitted: Fit) -> Iterator[Fit]:
        """Yield a fit of this estimator without each feature in use, by repeating it."""
        # A copy each time: the mask of the fit itself must stay.
        for index in np.flatnonzero(fitted.used):
            used = fitted.used.copy()
            used[index] = False
            yield self.fit(fitted.model, fitted.control, fitted.scaling, fitted.terms, used)


class FixedCoefficients(Estimator):
    """Coefficients from elsewhere: a solver's own, those of a record or of more features."""

    name = "given"
    repeatable = False

    def fit(self, model: SensorModel, control: FeatureSet, scaling: Scaling, terms: BoolArray,
            used: BoolArray) -> Fit:
        """Raise TermselError: nobody knows how the given coefficients were found."""
        raise TermselError("this fit has given coefficients, so no feature can be held out",
                           hint="Fit the model with termsel.fit to leave features out.")


FIXED_COEFFICIENTS = FixedCoefficients()


@dataclass(frozen=True, eq=False)
class HeldOut(Explained):
    """Errors of control features in use under the same procedure without them.

    Parameters
    ----------
    squares : ndarray, shape (n,)
        Squared error of each feature [px^2]: of a point dl^2 + ds^2, of a line the sum over its
        vertices.
    errors : ndarray, shape (m, 2), optional
        Measured minus predicted [px], as of `FeatureSet.ground_vertices`; None where an estimator
        finds their squares alone.

    Examples
    --------
    >>> import termsel
    >>> fitted = termsel.fit(termsel.simulate_scene("spot-isfahan"), "affine")
    >>> round(float(fitted.held_out().squares.mean()**0.5), 1)  # RMSE of left-out points [px]
    14.9
    """

    elsewhere: ClassVar[Mapping[str, str]] = {
        "rmse": "It is numpy.sqrt(held_out.squares.mean()).",
        "[]": "Of each feature: held_out.squares; of each point or vertex: held_out.errors."}

    squares: FloatArray
    errors: FloatArray | None = None

    @classmethod
    def of(cls, errors: FloatArray, features: FeatureSet) -> HeldOut:
        """Return the errors of features in use, with the sums of their squares."""
        # A feature of several vertices has the sum of their squares.
        squares = np.bincount(features.vertex_feature, weights=(errors**2).sum(axis=1))
        return cls(np.asarray(squares, dtype=np.float64), errors)


class Maker(Protocol):
    """What made a fit: a `termsel.Method`, which stands above fits."""

    @property
    def name(self) -> str:
        """Its name."""

    def held_out(self, fitted: Fit) -> HeldOut:
        """Return the errors of features of a fit, each under the same procedure without it."""


@dataclass(frozen=True, eq=False, repr=False)
class Fit(Glance):
    """A model fitted to control features.

    Parameters
    ----------
    model : SensorModel
    scaling : Scaling
    control : FeatureSet
        All control features on offer [px, ground units].
    terms : ndarray of bool, shape (k,)
        Terms in use.
    used : ndarray of bool, shape (len(control),)
        Features in the adjustment, points before lines.
    adjustment : Adjustment
        In scaled coordinates.
    estimator : Estimator
        How the coefficients were found.
    trace : float, optional
        Trace of the matrix that turns measurements into fitted values, where coefficients are
        shrunk.
    stored_held_out : HeldOut, optional
        Errors without each feature, where the estimator finds them on its way.
    original : Fit, optional
        The fit as it was made, where `control` is only a part of what it was fitted to.
    method : Method, optional
        What made the fit, if it is more than an estimator.

    Examples
    --------
    >>> import termsel
    >>> fit = termsel.fit(termsel.simulate_scene("ikonos-hamedan"), "poly3d")
    >>> fit.project([[48.5, 34.8, 1850.0]]).shape  # line and sample [px]
    (1, 2)
    >>> len(fit.control.points)
    24
    """

    elsewhere: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(CALLED_PROJECT, "Image positions are fit.project(ground)."),
        **dict.fromkeys(CALLED_LOCATE, "Ground positions are fit.locate(image, heights)."),
        "score": "The RMSE of points is fit.rmse(points).",
        "coef_": "They are fit.coefficients.", "intercept_": "It is in fit.coefficients.",
        "crs": "It is fit.control.crs.",
        "summary": "print(fit) says the most; termsel.run returns a result, which has a summary.",
        "plot": "termsel.run returns a result, which has plots.",
        "report": "termsel.run returns a result, which has a report.",
        "export": "termsel.run returns a result, which termsel.export writes.",
        "save": "termsel.run returns a result, which termsel.write_result writes.",
        "accuracy": "termsel.run returns a result, which has it.",
        "[]": "Coefficients are fit.coefficients, by name; image positions fit.project(ground)."}

    model: SensorModel
    scaling: Scaling
    control: FeatureSet
    terms: BoolArray
    used: BoolArray
    adjustment: Adjustment
    estimator: Estimator
    trace: float | None = None
    stored_held_out: HeldOut | None = None
    original: Fit | None = None
    method: Maker | None = None

    def _glance(self) -> tuple[str, Mapping[str, str]]:
        # What is shown must be quick: no refits, no uncertainty.
        rmse = self.control_rmse()
        return f"Fit of {self.model.name}: {self.terms.sum()} terms, {self.used.sum()} features", {
            "RMSE of control": "-" if rmse is None else f"{rmse.total:.3g} px",
            "effective parameters": f"{self.effective:.1f}", "CRS": self.control.crs}

    @property
    def scaled_control(self) -> FeatureSet:
        """The control features on offer in scaled coordinates."""
        return self.scaling.features(self.control)

    @cached_property
    def _scaled_used(self) -> FeatureSet:
        """The features in use, scaled; of a fit to all points, those of the fit it came from."""
        # A fit to all points shows the features of the selection it came from.
        original = self.original or self
        return self.scaling.features(original.control.take(original.used))

    @property
    def interpolation(self) -> Interpolation | None:
        """The prediction by control points, of a model that predicts by them alone, or None.
        """
        used = self._scaled_used
        # Points alone interpolate; a line has no single place to be met at.
        return None if len(used.lines) else self.model.interpolation(used)

    @property
    def determined(self) -> bool:
        """True if the control determines the coefficients, and an iteration to them converged."""
        # Shrunken coefficients are determined by their prior, whatever the rank.
        return (self.adjustment.feasible and self.adjustment.converged
                ) or not self.estimator.least_squares

    @property
    def effective(self) -> float:
        """Effective parameters: the number of terms, or the trace where they are shrunk."""
        return float(self.adjustment.n_terms) if self.trace is None else self.trace

    @property
    def coefficients(self) -> dict[str, float]:
        """Coefficients of the terms in use by name, in scaled coordinates."""
        values = self.adjustment.coefficients
        return {str(self.model.terms[i]): float(values[i]) for i in np.flatnonzero(self.terms)}

    @property
    def standard_deviations(self) -> dict[str, float]:
        """Standard deviations of the coefficients by name, in scaled coordinates.

        Returns NaN without redundancy and for coefficients that are not those of least squares.
        """
        values = self.adjustment.deviations
        return {str(self.model.terms[i]): float(values[i]) for i in np.flatnonzero(self.terms)}

    def with_coefficients(self, coefficients: FloatArray, estimator: Estimator = FIXED_COEFFICIENTS,
                          trace: float = np.nan) -> Fit:
        """Return the fit with other coefficients (k,), which are not those of least squares.

        `estimator` has found them, and `trace` is the effective number of parameters, NaN if it is
        not known.
        """
        # Deviations and correlations are those of least squares, and say nothing of others.
        unknown = np.full(len(coefficients), np.nan)
        adjustment = replace(self.adjustment, coefficients=coefficients, sigma0=np.nan,
                             correlations=None, deviations=unknown, steps=None, converged=True)
        return replace(self, estimator=estimator, trace=trace, stored_held_out=None,
                       adjustment=adjustment)

    @explains_arguments(remark=lambda given, _image: given["self"].remark_on(given["ground"]))
    def project(self, ground: ArrayLike) -> FloatArray:
        """Return where the image shows ground points.

        Parameters
        ----------
        ground : array_like, shape (n, 3), of a plane model also (n, 2)
            In the CRS of the control; NaN for heights a plane model does without.

        Returns
        -------
        ndarray, shape (n, 2)
            Line and sample [px]; NaN where a coordinate that the model uses is not finite, and at
            places that no image shows (see `unseen`).

        Raises
        ------
        TermselError
            If the array has another shape.
        """
        points = self._ground_points(ground)
        image = self._compute_positions(points)
        # Behind the camera the formula gives a place as well, mirrored.
        image[self.unseen(points)] = np.nan
        return image

    def remark_on(self, ground: ArrayLike) -> str:
        """Return a clause on places far outside the control; "" if all are near.

        Parameters
        ----------
        ground : array_like
            As for `project`.
        """
        return far_rows_in_words(self.control_ground(), self._ground_points(ground),
                                 self.control)

    def control_ground(self) -> FloatArray:
        """Return the ground coordinates (v, 3) of the control that was used for the fit."""
        original = self.original or self
        return original.control.take(original.used).ground_vertices()

    def _compute_positions(self, ground: FloatArray) -> FloatArray:
        """Return image positions (n, 2) [px] of places (n, 3), be they behind the camera or not.
        """
        # In scaled coordinates throughout; pixels are made of the result alone.
        scaled = self.model.predict(self.adjustment.coefficients, self._scaled_used,
                                    self.scaling.ground(ground))
        return self._nan_where_unknown(self.scaling.pixels(scaled), ground)

    @explains_arguments()
    def unseen(self, ground: ArrayLike) -> BoolArray:
        """Return whether ground points lie behind the camera or beyond the horizon, (n,).

        There a denominator is zero, or has another sign than at the control; the quotient would
        be the mirrored place of a ray that leads away from the ground. The model has no place for
        it, so `project` has none either. Nor has it of places in lines that the model is not of,
        such as those of another burst.

        Parameters
        ----------
        ground : array_like
            As for `project`.

        Raises
        ------
        TermselError
            If the array has another shape.
        """
        points = self._ground_points(ground)
        behind = self._is_behind_camera(points)
        known = self.model.known_image()
        if known is not None and known.lines is not None:
            behind |= known.is_beyond(self._compute_positions(points))
        return behind

    def _is_behind_camera(self, points: FloatArray) -> BoolArray:
        """Return whether ground points (n, 3) lie behind the camera or beyond the horizon, (n,)."""
        coefficients = self.adjustment.coefficients
        # A place is in front of the camera if its denominators have the sign of those of the
        # control.
        denominators = self.model.denominators(coefficients, self.scaling.ground(points))
        if denominators is None:
            return np.zeros(len(points), dtype=bool)
        return np.asarray(~(denominators * self._denominator_signs > 0.0).all(axis=1))

    def _project_to_any_line(self, ground: FloatArray) -> FloatArray:
        """Return image positions (n, 2) as `project`, also in lines that the model is not of."""
        points = self._ground_points(ground)
        image = self._compute_positions(points)
        image[self._is_behind_camera(points)] = np.nan
        return image

    @explains_arguments()
    def above_horizon(self, image: ArrayLike) -> BoolArray:
        """Return whether image points lie above the horizon of the view, (n,).

        The horizon is where the distances of places on the level of the control grow without end.
        Nothing is above it where the control supports no view.

        Parameters
        ----------
        image : array_like, shape (n, 2)
            Line and sample [px].
        """
        scaled = self.scaling.image(image)
        if self.view is None:
            return np.zeros(len(scaled), dtype=bool)
        return self.view.above_horizon(scaled)

    @explains_arguments()
    def holds(self, ground: ArrayLike) -> BoolArray:
        """Return whether a map may show ground points, (n,).

        An image of a central view is of no use much nearer to the camera than the control, or much
        farther away. Where the control supports no such view, only places that are `unseen`, or
        have no coordinates, may not be shown.

        Parameters
        ----------
        ground : array_like
            As for `project`.
        """
        points = self._ground_points(ground)
        # What has no ground, such as the sky, has no coordinates.
        visible = np.asarray(~self.unseen(points) & np.isfinite(points[:, :2]).all(axis=1))
        # In front of the camera, and not so near the horizon that a pixel has no end on the ground.
        if self.view is None:
            return visible
        return visible & self.view.holds(self.scaling.ground(points))

    @cached_property
    def _denominator_signs(self) -> FloatArray:
        """Signs of the denominators at most of the control, shape (2,)."""
        denominators = self.model.denominators(self.adjustment.coefficients,
                                               self._scaled_used.ground_vertices())
        assert denominators is not None
        # The median, as some control may lie behind a pole of a poor model.
        return np.where(np.median(denominators, axis=0) < 0.0, -1.0, 1.0)

    @cached_property
    def view(self) -> CentralView | None:
        """The central projection that the points in use support, of scaled places, or None."""
        return (self.original or self).estimator.view(self._scaled_used, self.scaling)

    @explains_arguments()
    def sigma(self, ground: ArrayLike, *, measured: bool = False) -> FloatArray:
        """Return the standard deviation of the error of `project`.

        Errors of the control's ground coordinates, which no residual shows, are no part of it. For
        control points it includes that other models may be true, what the points do not show of
        heights, and what the model does not fit: see `termsel.fitting.uncertainty` and
        `termsel.fitting.misfit`. For lines alone or with few points the model's form is taken for
        true, but in regularised polynomials.

        Parameters
        ----------
        ground : array_like
            As for `project`.
        measured : bool
            Whether to add the noise of a measurement at the place, taken to be the control's.

        Returns
        -------
        ndarray, shape (n, 2)
            Of line and sample [px]; NaN as for `project`, and without redundancy of the control.

        Raises
        ------
        TermselError
            If the array has another shape.
        """
        original = self.original or self
        points = self._ground_points(ground)
        squares, noise = original.mean_square_errors(points)
        variance = (squares + noise * measured) * self.scaling.image_scale ** 2
        # Errors of the heights of the control are errors of the model, too.
        variance += variance_by_heights(
            original.control.take(original.used), original.scaling, original.project, points)
        sigma = self._nan_where_unknown(np.sqrt(variance), points)
        sigma[self.unseen(points)] = np.nan
        return sigma

    def mean_square_errors(self, ground: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the mean square errors of places (m, 3) and of a measurement.

        `ground` is in the CRS of the fit, mean squares are in scaled image coordinates. Where
        `local_courses` follow the error between control points, the mean squares are theirs. Else
        they are the estimator's variance plus what the model misses. With camera courses they are a
        mean of both, weighted by `share_of_courses`.

        Returns
        -------
        squares : ndarray, shape (m, 2)
            Of the positions of the places, by line and sample.
        noise : ndarray, shape (2,)
            Of a measurement.
        """
        scaled_ground = self.scaling.ground(ground)
        courses = self.local_courses
        share_by_courses = 0.0 if courses is None else 1.0
        if isinstance(courses, CameraCourses):
            share_by_courses = share_of_courses(len(self._scaled_used.points))
        squares = np.zeros((len(ground), 2))
        noise = np.zeros(2)
        if courses is not None:
            image = self.scaling.image(self._compute_positions(ground))
            squares += share_by_courses * courses.squares(scaled_ground, image)
            noise += share_by_courses * courses.noise
        if share_by_courses < 1.0:
            spread = self.estimator.spread(self, scaled_ground)
            # Variances add: of the coefficients, and of what the model does not fit.
            squares += (1.0 - share_by_courses) * (spread.variance + self.missed_at(ground))
            noise += (1.0 - share_by_courses) * spread.noise
        return squares, noise

    @cached_property
    def local_courses(self) -> LocalCourses | CameraCourses | None:
        """The error of the model between control points, as they show it, or None.

        Returns None with lines or too few points, with heights of very many points, and for a
        projection of a view: it is no field about a polynomial, and is judged by its residuals.
        """
        # What corrects a polynomial by its residuals has the errors of points between them, too.
        is_polynomial = self.model.polynomial_degree is not None or (
            self.model.corrects and self.estimator.least_squares)
        if len(self._scaled_used.lines) or not (is_polynomial or self.interpolation is not None):
            return None
        courses_of = camera_courses if self.model.uses_height else local_courses
        return courses_of(self._scaled_used.points, 1.0 / self.scaling.image_scale)

    def missed_at(self, ground: FloatArray) -> FloatArray:
        """Return the mean square of the model's own error at places (m, 3), scaled, (m, 2).

        It is 0 where the residuals do not show it (see `misfit`), NaN where a place has no image
        position.
        """
        if self.misfit is None:
            return np.zeros((len(ground), 2))
        image = self.scaling.image(self._compute_positions(ground))
        finite = np.isfinite(image).all(axis=1)
        squares = np.full(image.shape, np.nan)
        # In batches, as covariances between all places would fill the memory.
        for batch in np.array_split(np.flatnonzero(finite), len(ground) // MISFIT_BATCH + 1):
            squares[batch] = self.misfit.squares(image[batch])
        return squares

    @cached_property
    def misfit(self) -> Misfit | None:
        """The error that the model itself has, as the residuals of control points show it, or None.

        Returns None with lines, which show too little of it, and without redundancy.
        """
        control = self._scaled_used
        # Lines have no residual along themselves; without redundancy all are zero.
        if len(control.lines) or self.adjustment.redundancy <= 0:
            return None
        points = control.points
        image = self.scaling.image(self._compute_positions(
            self.control.take(self.used).points.ground))
        noise = NoisePrior.of(1.0 / self.scaling.image_scale, points.sigma,
                              with_heights=self.model.uses_height)
        misfits = []
        for course in self.estimator.unexplained(self, points.image - image):
            misfit = misfit_of(image, course.residuals, noise, course.effective)
            if misfit is not None:
                misfits.append((course.chance, misfit))
        return mixed_misfit(misfits)

    @property
    def uncertainty_caveat(self) -> str:
        """A sentence on noise that the control does not show; "" where it shows it.

        Few residuals of unknown noise are noise or local deformation, and `sigma` is a mean of
        both.
        """
        original = self.original or self
        points = original.control.take(original.used).points
        misfit = original.misfit
        # Stated standard deviations say what is noise; many points show it by themselves.
        if (misfit is None or points.sigma is not None or len(points) >= UNDECIDED_POINTS
                or not UNDECIDED < misfit.probability < 1.0 - UNDECIDED):
            return ""
        return (f"{len(points)} control points cannot distinguish noise from local deformation: "
                "with noise alone the standard deviation is smaller, with local deformation "
                "larger. More points, or columns sigma_line and sigma_sample, would decide.")

    def _ground_points(self, ground: ArrayLike) -> FloatArray:
        """Return ground points (n, 3); a plane model also takes them without heights.

        Raises TermselError for another shape.
        """
        points = numbers_or_nan(ground)
        if points.shape[1:] == (2,) and not self.model.uses_height:
            # A plane model does not look at heights, so that they may be missing.
            return np.pad(points, ((0, 0), (0, 1)), constant_values=np.nan)
        if points.shape[1:] != (3,):
            if self.model.uses_height:
                hint = "This model uses heights: give x, y and z of each place, [[x, y, z]]."
            else:
                hint = "Give x and y of each place, [[x, y]], or x, y and z."
            raise TermselError(f"ground points have shape {points.shape}, expected (n, 3)",
                               hint=hint)
        return points

    def _nan_where_unknown(self, image: FloatArray, ground: FloatArray) -> FloatArray:
        """Return image positions (n, 2), changed to NaN where the ground (n, 3) is not known.

        A height counts only where the model uses it.
        """
        coordinates = ground if self.model.uses_height else ground[:, :2]
        image[~np.isfinite(coordinates).all(axis=1)] = np.nan
        return image

    @explains_arguments(checked_within=("heights",),
                        remark=lambda given, ground: given["self"].remark_on(ground))
    def locate(self, image: ArrayLike, heights: ArrayLike | Surface) -> FloatArray:
        """Return the ground points seen at image points.

        Of several places at which a ray meets a surface it is the first, which hides the others.

        Parameters
        ----------
        image : array_like, shape (n, 2)
            Line and sample [px].
        heights : array_like, shape (n,), a number, or callable
            Heights, or what gives them for x and y, shape (n, 2), such as a DEM.

        Returns
        -------
        ndarray, shape (n, 3)
            In the CRS of the control; NaN where there is none.

        Raises
        ------
        TermselError
            If an array has another shape, and for a file that is not opened.
        """
        image = numbers_or_nan(image)
        surface = _surface_of(heights, self.control.crs)
        ground = self._where_rays_meet(image, surface)
        known = self.model.known_image()
        if known is not None:
            ground[known.is_beyond(image)] = np.nan
        # A plane model sees all heights at one place, so that nothing hides anything.
        if callable(surface) and self.model.uses_height:
            ground = visible_ground(self.project, self.holds, image, ground, surface,
                                    self.ground_box())
        return ground

    def _where_rays_meet(self, image: FloatArray, surface: FloatArray | Surface) -> FloatArray:
        """Return a ground place (n, 3) on the ray of each image point, whether it is hidden or not.

        `image` is (n, 2), `surface` heights (n,) or what gives them.
        """
        centre, scale = self.ground_box()
        fit_crs = self.scaling.fit_crs
        if fit_crs and not is_geocentric(fit_crs):
            # In the plane of the fit: around a pole no search in degrees finds its way.
            def to_control(places: FloatArray) -> FloatArray:
                plan = to_fit_crs(places * [1.0, 1.0, 0.0], fit_crs, self.control.crs)
                return np.column_stack([plan[:, :2], places[:, 2]])

            centre[:2] = self.scaling.ground_offset[:2]
            scale[:2] = self.scaling.ground_scale[:2]
            return to_control(locate(
                lambda places: self._project_to_any_line(to_control(places)), image,
                _surface_in_plane(surface, to_control) if callable(surface) else surface,
                centre=centre, scale=scale))
        # At least as far as the image reaches, so that the search for a place begins with the right
        # size.
        scale = np.maximum(scale, reach(
            self.control, self.model.options, self.model.known_image()))
        # Steps of the search may lead beyond the lines that the model is of.
        return locate(self._project_to_any_line, image, surface, centre=centre, scale=scale)

    def ground_box(self) -> tuple[FloatArray, FloatArray]:
        """Return middle and half-range of the control, shapes (3,), in its own CRS."""
        scaling = self.scaling
        # In the CRS of the coordinates, not in the one that the fit works in.
        box = make_scaling(replace(self.control, fit_crs="")) if scaling.fit_crs else scaling
        return np.array(box.ground_offset), np.array(box.ground_scale)

    def image_box(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return first and last line and sample [px]: of the image, its RPC or the control."""
        return image_extent(self.control, self.model.options, self.model.known_image())

    @explains_arguments()
    def errors(self, points: Points) -> FloatArray:
        """Return measured minus computed line and sample [px], shape (n, 2)."""
        return points.image - self._compute_positions(points.ground)

    @explains_arguments()
    def line_errors(self, lines: Lines | None = None) -> FloatArray:
        """Return the vectors from projected ground vertices of lines to their image lines [px].

        They are along the normal of the image line, shape (n, 2, 2): by line, vertex, and line and
        sample. The lines are by default those of the control.
        """
        lines = self.control.lines if lines is None else lines
        if not len(lines):  # what projects them may take long to find
            return np.empty((0, 2, 2))
        # The line n . x = rho: its distance from a vertex along the unit normal n.
        normal, rho = line_normals(lines)
        image = self._compute_positions(lines.ground.reshape(-1, 3)).reshape(-1, 2, 2)
        distance = rho[:, None] - np.einsum("ia,iva->iv", normal, image)
        return np.asarray(distance[..., None] * normal[:, None, :])

    @property
    def residuals(self) -> Residuals:
        """Measured minus computed of all control features on offer, as a table."""
        return control_residuals(self.control, self.used, self.errors(self.control.points),
                                 self.line_errors())

    @property
    def leave_one_out(self) -> Residuals:
        """Measured minus predicted of each control feature by the same procedure without it.

        Least squares have a closed form, which for lines under separate denominators holds to first
        order about the solution. Other fits are repeated, as is that of a model which corrects its
        predictions by the control. A feature on offer that is not in use has its residual.

        Raises
        ------
        TermselError
            If the control without some feature does not determine the terms, or the
            coefficients were given.
        """
        errors_each, determined = self.errors_without_each
        if not determined:
            raise Undetermined("without one of its control features the fit is not determined",
                               hint="Measure more control, or choose a model with fewer terms.")
        n = len(self.control.points)
        # Errors of features that are not in use stay those of the fit.
        points = self.errors(self.control.points)
        lines = self.line_errors()
        for index, errors in zip(np.flatnonzero(self.used), errors_each, strict=True):
            if index < n:
                points[index] = errors[0]
            else:
                lines[self.control.lines.feature == index - n] = errors.reshape(-1, 2, 2)
        return control_residuals(self.control, self.used, points, lines)

    def held_out(self) -> HeldOut:
        """Return the errors of features in use, each under the same procedure without it.

        An estimator may have found them on its way. Else they come from the method that made the
        fit, which has a closed form or repeats itself, or without a method from the estimator.

        Raises
        ------
        Undetermined
            If the features do not determine the fit once some one of them is left out.
        """
        return self._held_out

    @cached_property
    def _held_out(self) -> HeldOut:
        """The held-out errors, as stored or by the method, else by the estimator."""
        if self.stored_held_out is not None:
            # A result that was read has them, as the fit itself may not be repeatable.
            return self.stored_held_out
        return (self.estimator if self.method is None else self.method).held_out(self)

    @cached_property
    def held_out_rmse(self) -> float:
        """RMSE of features in use, each held out [px], over points and vertices of lines.

        Where points state unlike standard deviations, they count by the inverse squares of these.
        """
        n_positions = len(self.control.points) + 2 * len(self.control.lines)
        squares = self.held_out().squares
        points = self.control.take(self.used).points
        # Weights with the mean 1, so that the RMSE stays one in px.
        if has_unlike_weights(points):
            precisions = weights_of(points)**2
            relative_weights = np.ones(len(squares))
            relative_weights[:len(points)] = (precisions / precisions.mean(axis=0)).mean(axis=1)
            squares = squares * relative_weights
        return float(np.sqrt(squares.sum() / n_positions))

    @property
    def rounding(self) -> float:
        """Errors up to which they are rounding [px]."""
        return ROUNDING * self.scaling.image_scale

    def leave_one_out_rmse(self) -> Rmse | None:
        """Return the RMSE of the control features in use, each under the fit without it.

        Where the features without one of them do not determine the terms, the least-norm solution
        counts. Returns None without features in use.
        """
        errors_each, _ = self.errors_without_each
        return rmse_of(np.concatenate(errors_each), len(errors_each))

    @cached_property
    def errors_without_each(self) -> tuple[tuple[FloatArray, ...], bool]:
        """Errors of each feature in use by the fit without it, (rows, 2) each [px]; and a flag.

        The flag says whether the features without any one of them determine the fit.
        """
        if self.stored_held_out is not None and self.stored_held_out.errors is not None:
            errors = self.stored_held_out.errors
            feature_of_row = self.control.take(self.used).vertex_feature
            return tuple(errors[feature_of_row == i] for i in range(feature_of_row.max() + 1)), True
        interpolation = self.interpolation if self.estimator.repeatable else None
        if interpolation is None:
            return _errors_by_refitting(self)
        return tuple(interpolation.errors[:, None] * self.scaling.image_scale), True

    def control_rmse(self) -> Rmse | None:
        """Return the RMSE of the control features in use; None if there are none."""
        return rmse_of(self.control_errors(self.used), int(self.used.sum()))

    def control_errors(self, which: BoolArray) -> FloatArray:
        """Return errors (m, 2) [px] of control: a row for each point, then one for each vertex.

        `which` is a mask (n,) of the control features, points first. An error is as `errors` and
        `line_errors` give it: a line has two rows, and several pieces of one feature two each.
        """
        selected = self.control.take(which)
        errors = [self.errors(selected.points)]
        if len(selected.lines):
            # Which lines belong to selected features: several may be pieces of one.
            selected_lines = which[len(self.control.points):][self.control.lines.feature]
            errors.append(self.line_errors()[selected_lines].reshape(-1, 2))
        return np.concatenate(errors)

    @explains_arguments()
    def rmse(self, points: Points) -> Rmse | None:
        """Return the RMSE of points that took no part in the adjustment; None without points."""
        return rmse_of(self.errors(points), len(points))


@one_blas_thread
def _errors_by_refitting(fitted: Fit) -> tuple[tuple[FloatArray, ...], bool]:
    """Return the errors of each feature in use by a refit without it, as `errors_without_each`."""
    # One thread: systems are small, and threads of the linear algebra would wait for each other.
    refits = list(fitted.estimator.without_each(fitted))
    return (tuple(refit.control_errors(fitted.used & ~refit.used) for refit in refits),
            all(refit.determined for refit in refits))


def _surface_in_plane(surface: Surface, to_control: Callable[[FloatArray], FloatArray]) -> Surface:
    """Return a surface that takes the coordinates of a fit, which become those of the control."""
    return lambda plan: surface(to_control(np.pad(plan, ((0, 0), (0, 1))))[:, :2])


def _surface_of(heights: ArrayLike | Surface, crs: str) -> FloatArray | Surface:
    """Return heights as an array, or as the function that they are.

    Raises TermselError for the name of a raster, for one that is not opened, and for what has no
    heights; the remedy opens a raster for ground coordinates in `crs`.
    """
    # What opens a file may be called, too, as a decorator is.
    if not isinstance(heights, AbstractContextManager) and callable(heights):
        return unmasked(heights)
    problem = "expected numbers, or a function such as an open DEM"
    if not isinstance(heights, AbstractContextManager | str | PathLike):
        with suppress(TypeError, ValueError):
            return numbers_or_nan(heights)
        raise TermselError(f"the heights are {shown_value(heights)}, {problem}")
    if isinstance(heights, AbstractContextManager):
        given, file = "not open yet", "FILE"
    else:
        given, file = shown_value(heights), repr(str(heights))
    raise TermselError(f"the heights are {given}, {problem}",
                       hint=f"Open it: with termsel.open_dem({file}, {crs!r}) as dem: "
                            "result.locate(image, dem)")
