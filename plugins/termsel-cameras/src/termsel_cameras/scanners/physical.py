"""What cameras have in common: terms with priors, a robust fit in damped steps, and its errors."""

from __future__ import annotations

import pickle
from abc import abstractmethod
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from termsel import (
    Adjustment,
    Equations,
    Estimator,
    FeatureSet,
    Fit,
    FitData,
    HeldOut,
    Points,
    Scaling,
    SensorModel,
    Spread,
    TermselError,
    Undetermined,
    image_equations,
)

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

NOISE = 0.7
"""Standard deviation of a measurement, by which priors are weighed, where none is stated [px]."""

USUAL_SIGMA, EXPERIENCE, STATED = 0.55, 2.0, 20.0
"""Usual standard deviation of a measurement [px], the degrees of freedom that it counts as where
residuals are few, and those of one that is stated."""

INTERVAL = 0.95
"""Share of errors below the upper end of an interval of 90 %."""

MAX_LATTICE_RMS = 1.0
"""Distance of points from where metadata see them, up to which they are a lattice that was computed
from these [px]: lattices of radar images differ by up to half a pixel."""

DERIVATIVE_STEP = 1e-4
"""Change of a term by which image positions are differentiated."""

MAX_STEPS, CONVERGED_GAIN = 100, 1e-3
"""Most steps of a fit; it has converged where a step would gain less than this share."""

BEND_STEP, MAX_BEND = 0.1, 0.4
"""Part of a step by which its bend is told, and the most that the bend may be of the step."""

HUBER = 3.0
"""Residuals beyond so many standard deviations count by their size alone (Huber 1964)."""


def require_scaling(scaling: Scaling | None) -> Scaling:
    """Return the scaling of a prepared model; raises TermselError if it is None, not prepared."""
    if scaling is None:
        raise TermselError("the model is not prepared: its position on Earth is not known",
                           hint="Fit it, or call its method prepared first.")
    return scaling


@dataclass(frozen=True, eq=False)
class CameraSolution:
    """Where a fit ended."""

    values: FloatArray  # (k,)
    cost: float
    steps: int
    converged: bool


class Physical(SensorModel):
    """A camera whose terms have normal priors with the mean 0 and the standard deviation 1.

    The first `free` terms have none.
    """

    terms_: ClassVar[tuple[str, ...]]
    free: ClassVar[int] = 0

    @abstractmethod
    def starts(self, features: FeatureSet) -> FloatArray:
        """Return the values of terms (s, k) from which a fit to scaled features begins."""

    @abstractmethod
    def image_of(self, values: FloatArray, ground: FloatArray) -> FloatArray:
        """Return scaled image positions (p, n, 2) by values of terms (p, k)."""

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the terms."""
        return self.terms_

    def project(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        """Return scaled image positions (..., n, 2) of ground points; NaN where one is not seen."""
        values = np.reshape(coefficients, (-1, len(self.terms)))
        return self.image_of(values, ground).reshape(
            *np.shape(coefficients)[:-1], len(ground), 2)

    def slopes(self, values: FloatArray, ground: FloatArray) -> FloatArray:
        """Return derivatives (n, 2, k) of scaled image positions by the terms at `values` (k,)."""
        # Central differences of all terms, in one call.
        steps = DERIVATIVE_STEP * np.eye(len(values))
        images = self.image_of(np.concatenate([values + steps, values - steps]), ground)
        k = len(values)
        return np.moveaxis(images[:k] - images[k:], 0, -1) / (2 * DERIVATIVE_STEP)

    def prior(self) -> FloatArray:
        """Return the weights (k,) of the equations x = 0 of the terms, 0 for those without a prior.
        """
        # A term of 1, its standard deviation, counts as an error of the size of the noise.
        weights = np.full(len(self.terms), NOISE / require_scaling(self.scaling).image_scale)
        weights[:self.free] = 0.0
        return weights

    def start(self, features: FeatureSet) -> FloatArray:
        """Return the terms (k,) of the robust fit to points; raises TermselError without points."""
        if not len(features.points):
            raise TermselError(f"model {self.name!r} requires control points to start from",
                               hint="Measure points, or choose another model.")
        return self.solved(features).values

    def equations(self, features: FeatureSet) -> Equations:
        """Return the equations about the start."""
        return self.linearised(features, self.start(features))

    def linearised(self, features: FeatureSet, coefficients: FloatArray) -> Equations:
        """Return the equations of scaled points and lines about a solution (k,), and the priors."""
        rows = []
        for ground in (features.points.ground, features.lines.ground.reshape(-1, 3)):
            columns = self.slopes(coefficients, ground)
            # image(x) = image(x0) + J (x - x0): the constant part is image(x0) - J x0.
            rows += [columns, self.image_of(coefficients[None], ground)[0]
                     - columns @ coefficients]
        unweighted = image_equations(features, *rows[::2], *rows[1::2])
        return Equations(unweighted.A, unweighted.b, unweighted.feature, self.prior())

    def solved(self, features: FeatureSet) -> CameraSolution:
        """Return the best robust fit to scaled points from all starts.

        Raises Undetermined if from no start all points are seen.
        """
        # A run asks for the same solution many times. Neither models nor points can be keys of a
        # cache, but bytes can.
        try:
            pickled = pickle.dumps((self, features.points))
        except (AttributeError, TypeError, pickle.PicklingError):
            # The class is defined in a function, or an option is no plain value.
            return _best_solution(self, features.points)
        return _cached_best_solution(pickled)

    def cost(self, features: FeatureSet, values: FloatArray) -> tuple[float, FloatArray]:
        """Return Huber's loss of scaled points and priors, and the weighted residuals (n, 2).

        Both are divided by the noise. The loss is NaN if a point is not seen.
        """
        points = features.points
        unit = NOISE / require_scaling(self.scaling).image_scale
        residuals = ((points.image - self.image_of(values[None], points.ground)[0])
                     * _point_weights(features) / unit)
        lengths = np.linalg.norm(residuals, axis=1)
        # Quadratic near 0, linear beyond HUBER, and smooth where they meet.
        loss = np.where(lengths > HUBER, 2 * HUBER * lengths - HUBER**2, lengths**2)
        return float(loss.sum() + ((self.prior() / unit * values) ** 2).sum()), residuals

    def _distance_from_tangent(
            self, values: FloatArray, step: FloatArray, ground: FloatArray) -> FloatArray:
        """Return the offsets (n, 2) of image positions from the tangent at the end of a step.

        `values` (k,) are those where the step (k,) begins.
        """
        # Half the second derivative along the step, by a central difference.
        ends = values + BEND_STEP * np.array([[1.0], [0.0], [-1.0]]) * step
        ahead, middle, behind = self.image_of(ends, ground)
        return np.asarray((ahead - 2 * middle + behind) / (2 * BEND_STEP**2))

    def descend(self, features: FeatureSet, start: FloatArray) -> CameraSolution | None:
        """Return the solution of least cost that damped steps lead to from a start.

        The steps are those of Levenberg (1944) and Marquardt (1963), corrected to second order
        (Transtrum, Machta and Sethna 2011, Phys. Rev. E 83, 036701, section VIII). `start` (k,) are
        values of the terms, and `features` are scaled. None if not all points are seen at the
        start, or on the way. The solution has not converged if `MAX_STEPS` are not enough.
        """
        points = features.points
        prior = self.prior()
        unit = NOISE / require_scaling(self.scaling).image_scale
        weight = _point_weights(features)
        size = prior / unit
        damping = 1e-3
        converged = False
        steps = 0
        values = start
        # The free terms are shifts of line and sample: their best values are the mean residuals.
        if self.free:
            residuals = points.image - self.image_of(values[None], points.ground)[0]
            values = values.copy()
            values[:self.free] += residuals.mean(axis=0)[:self.free]
        least_cost, residuals = self.cost(features, values)
        if not np.isfinite(least_cost):
            return None
        while steps < MAX_STEPS and damping < 1e8:
            # Roots of the weights with which squares have the gradient of Huber's loss.
            distances = np.linalg.norm(residuals, axis=1)
            huber_weights = np.sqrt(HUBER / np.maximum(distances, HUBER))[:, None]
            slopes = self.slopes(values, points.ground)
            A = (slopes * (huber_weights * weight / unit)[..., None]).reshape(-1, len(values))
            if not np.isfinite(A).all():
                return None
            # (A' A + W + damping diag(A' A + W)) step = A' r - W x, with the squared weights W of
            # the priors. Damping in proportion to the diagonal makes units of terms irrelevant.
            right = A.T @ (huber_weights * residuals).ravel() - size**2 * values
            normal = A.T @ A + np.diag(size**2)
            inverse = np.linalg.pinv(normal + damping * np.diag(np.diag(normal) + 1e-12),
                                     hermitian=True)
            full_step = inverse @ right
            # The valley of the cost bends where altitude, pixel and period make up for each other.
            offsets = self._distance_from_tangent(values, full_step, points.ground)
            correction = inverse @ (A.T @ (huber_weights * weight / unit * offsets).ravel())
            largest_correction = MAX_BEND * np.linalg.norm(full_step)
            if np.isfinite(correction).all() and np.linalg.norm(correction) < largest_correction:
                full_step = full_step - correction
            # A step that does not lower the cost, or leads where a point is not seen and the cost
            # is NaN, is not taken: a shorter one is tried.
            next_cost, next_residuals = self.cost(features, values + full_step)
            steps += 1
            is_lower = next_cost < least_cost
            if not is_lower:
                damping *= 10.0
                continue
            converged = least_cost - next_cost < CONVERGED_GAIN * (1.0 + least_cost)
            values = values + full_step
            least_cost = next_cost
            residuals = next_residuals
            damping = damping / 10.0
            if converged:
                break
        # So large a damping means that no step lowers the cost any more.
        return CameraSolution(values, least_cost, steps, converged or damping >= 1e8)


@dataclass(frozen=True)
class RobustFit(Estimator):
    """The robust fit of a camera with priors."""

    name = "camera"

    def fit(self, model: Any, control: FeatureSet, scaling: Scaling, terms: BoolArray,
            used: BoolArray) -> Fit:
        """Fit a camera with all its terms to the points in use (see `Estimator.fit`).

        `used` (n,) marks the points in use; `terms` (k,) is not looked at. Errors of held-out
        points are those of the equations that are linear about the solution. Terms under a prior
        count by what the points determine of them, so that `effective` is no whole number. Raises
        Undetermined for lines, if from no start all points are seen, and if the fit does not
        converge.
        """
        ready = model.prepared(scaling, control.crs)
        used_features = control.take(used)
        if len(used_features.lines):
            raise Undetermined(f"model {model.name!r} takes control points alone here, and there "
                               "are control lines", hint="Leave the lines out.")
        scaled = scaling.features(used_features)
        solution = ready.solved(scaled)
        if not solution.converged:
            raise Undetermined(f"the fit of {model.name!r} did not converge in {solution.steps} "
                               "steps",
                               hint="Measure more control, or name the sensor.")
        equations = ready.linearised(scaled, solution.values)
        values = solution.values
        residuals, effective, errors = _without_each(equations, values, len(used_features.points))
        # An adjustment counts terms in whole numbers; the fit's trace is the effective number.
        n_terms = round(effective)
        # Standard deviations under a prior are not those of least squares.
        unknown = np.full(len(values), np.nan)
        freedom = max(len(residuals) - effective, 1.0)
        weight = _point_weights(scaled)
        adjustment = Adjustment(
            values, unknown, n_terms=n_terms, n_equations=len(residuals), rank=n_terms,
            condition=np.nan, sigma0=float(np.sqrt(residuals @ residuals / freedom)),
            steps=solution.steps, converged=True)
        return Fit(ready, scaling, control, terms=np.ones(len(values), dtype=bool), used=used,
                   adjustment=adjustment, estimator=self, trace=effective,
                   stored_held_out=HeldOut.of(errors / weight * scaling.image_scale, used_features))

    def spread(self, fitted: Fit, ground: FloatArray) -> Spread:
        """Return the mean square errors of image positions at scaled ground positions (m, 3).

        See `Estimator.spread`.
        """
        model = fitted.model
        values = fitted.adjustment.coefficients
        assert isinstance(model, Physical)
        equations = model.linearised(fitted.scaled_control.take(fitted.used), values)
        unit = NOISE / fitted.scaling.image_scale
        noise = self.noise(fitted)
        assert equations.prior is not None
        # The priors do not depend on the noise: N = A' A / noise^2 + diag(1 / prior sigma^2).
        normal = equations.A.T @ equations.A / noise**2 + np.diag((equations.prior / unit) ** 2)
        # With a root of the covariance of the terms, variances of positions are sums of squares.
        root = np.linalg.cholesky(np.linalg.pinv(normal, hermitian=True)
                                  + 1e-14 * np.eye(len(values)))
        factors = model.slopes(values, ground) @ root
        return Spread((factors**2).sum(axis=2), np.full(2, noise**2), factors)

    def noise(self, fitted: Fit) -> float:
        """Return the scaled standard deviation of a measurement, as the residuals show it.

        It is 0.3 of the usual noise at least.
        """
        # Residuals of few points may be small by chance.
        return max(fitted.adjustment.sigma0, 0.3 * NOISE / fitted.scaling.image_scale)


@dataclass(frozen=True)
class ShiftFit(RobustFit):
    """The robust fit of few shifts with priors, of one point already.

    What residuals show of the noise is joined with what is known of it: with one point they are
    nearly nothing, whatever its error. To points that were computed from the camera's own metadata
    nothing is fitted.
    """

    name = "shifts"

    def fit(self, model: Any, control: FeatureSet, scaling: Scaling, terms: BoolArray,
            used: BoolArray) -> Fit:
        """Fit the shifts (see `RobustFit.fit`); they are 0 if the points are the camera's lattice.

        Raises Undetermined as `RobustFit.fit` does.
        """
        ready = model.prepared(scaling, control.crs)
        used_features = control.take(used)
        # A lattice that was computed has no errors of measurement, so that nothing is fitted to it.
        errors = as_stated(ready, FitData(used_features, scaling, heights=True))
        if errors is None:
            return super().fit(model, control, scaling, terms, used)
        values = np.zeros(len(ready.terms))
        scaled = errors / scaling.image_scale
        adjustment = Adjustment(
            values, np.full(len(values), np.nan), n_terms=0, n_equations=errors.size, rank=0,
            condition=np.nan, sigma0=float(np.sqrt((scaled**2).mean())), converged=True)
        return Fit(ready, scaling, control, terms=np.ones(len(values), dtype=bool), used=used,
                   adjustment=adjustment, estimator=self, trace=0.0,
                   stored_held_out=HeldOut.of(errors, used_features))

    def spread(self, fitted: Fit, ground: FloatArray) -> Spread:
        """Return the mean square errors of image positions at scaled ground positions (m, 3).

        If the points are the camera's lattice, they are those of the residuals alone. See
        `Estimator.spread`.
        """
        # Nothing was fitted to a lattice, so that no term has an error.
        if fitted.effective > 0.0:
            return super().spread(fitted, ground)
        shape = len(ground), 2
        return Spread(np.zeros(shape), np.full(2, fitted.adjustment.sigma0**2),
                      np.zeros((*shape, len(fitted.model.terms))))

    def noise(self, fitted: Fit) -> float:
        """Return the scaled noise of measurements, widened so that normal intervals of 90 % hold.

        Before that its square is the mean of the squares that residuals show and that are usual, or
        stated, each weighed by its degrees of freedom.
        """
        from scipy.special import ndtri, stdtrit  # other models need not import it

        points = fitted.control.take(fitted.used).points
        usual = USUAL_SIGMA if points.sigma is None else float(np.median(points.sigma))
        usual /= fitted.scaling.image_scale
        experience = EXPERIENCE if points.sigma is None else STATED
        residual_freedom = max(2 * len(points) - fitted.effective, 0.0)
        freedom = experience + residual_freedom
        squares = experience * usual**2 + residual_freedom * fitted.adjustment.sigma0**2
        # Errors by a noise of few degrees of freedom have Student's distribution: the ratio of its
        # quantile to the normal one makes the normal interval as wide.
        widening = stdtrit(freedom, INTERVAL) / ndtri(INTERVAL)
        return float(np.sqrt(squares / freedom) * widening)


def as_stated(ready: Physical, control: FitData) -> FloatArray | None:
    """Return the offsets (n, 2) [px] of points from the image of a camera without corrections.

    `ready` is a prepared model. None unless the points are a lattice whose offsets have an RMS
    below `MAX_LATTICE_RMS`, and so was computed from the metadata of the camera.
    """
    if control.lattice is None:
        return None
    # With all terms 0 the camera is as its metadata state it.
    points = control.scaled.points
    stated_image = ready.image_of(np.zeros((1, len(ready.terms))), points.ground)[0]
    errors = (points.image - stated_image) * control.scaling.image_scale
    close = np.sqrt((errors**2).sum(axis=1).mean()) < MAX_LATTICE_RMS
    return np.asarray(errors) if close else None


@lru_cache(maxsize=8)  # a fit, its errors and its spread need it
def _cached_best_solution(pickled: bytes) -> CameraSolution:
    """Return the best solution of a model and scaled points, which are given as a pickled pair."""
    return _best_solution(*pickle.loads(pickled))


def _best_solution(model: Physical, points: Points) -> CameraSolution:
    """Return the solution of least cost from all starts of a model.

    Raises Undetermined if from none all points are seen.
    """
    features = FeatureSet(points)
    ends: list[CameraSolution] = [
        solution for start in model.starts(features)
        if (solution := model.descend(features, start))]
    if not ends:
        raise Undetermined(f"model {model.name!r} finds no camera that sees the control",
                           hint="Check the sensor, the track and the axes of the points.")
    return min(ends, key=lambda solution: solution.cost)


def _point_weights(features: FeatureSet) -> FloatArray:
    """Return weights (n, 2) by the standard deviations of points, 1 for the median; 1 without any.
    """
    sigma = features.points.sigma
    if sigma is None:
        return np.ones((len(features.points), 2))
    return np.asarray(np.median(sigma) / sigma)


def _without_each(equations: Equations, values: FloatArray, count: int,
                  ) -> tuple[FloatArray, float, FloatArray]:
    """Return residuals (2 n,), the number of effective parameters, and held-out errors (n, 2).

    `count` is the number n of points, `values` (k,) the solution about which the equations are
    linear. An error is measured minus predicted by all other points, to first order.
    """
    A = equations.A
    prior = equations.prior
    assert prior is not None
    residuals = equations.b - A @ values
    # The hat matrix, which turns measured into fitted values.
    hat = A @ np.linalg.pinv(A.T @ A + np.diag(prior**2), hermitian=True) @ A.T
    rows = np.arange(2 * count).reshape(count, 2)
    # (I - H_ii)^-1 r_i with the block H_ii (2, 2) of a point; the ridge is for points that alone
    # determine a term.
    redundancies = np.eye(2) - hat[rows[:, :, None], rows[:, None, :]]
    errors = np.linalg.solve(redundancies + 1e-9 * np.eye(2), residuals[rows][..., None])[..., 0]
    return residuals, float(np.trace(hat)), np.asarray(errors, dtype=np.float64)
