"""How uncertain a fitted model is at any place.

The truth is believed to be a regularised cubic polynomial (see
`termsel.adjustment.bayesian.posterior`): its posterior, given the same control points, says how
likely each other course of the image is between and beyond them. The mean square error of any fit
at a place is the variance of that posterior there, and the square of the distance of the fit from
its mean. A model of a kind that the polynomial does not contain is judged by the propagation of the
noise through its own adjustment as well: with the chance w that it predicts left-out control better
than the polynomial, the mean square error is w times the one and 1 - w times the other. Of least
squares by lines or few points it is the propagated noise; other fits by lines have the posterior of
the polynomial by lines. All noise is unknown, so that errors have Student's
distribution with f degrees of freedom, whose variance is f / (f - 2). A spline or a random field
has a variance of its own, which is that of its own smoothness. From 20 points of a plane on they
and polynomials are judged by fields of all (`termsel.fitting.local_courses`), and so they are with
heights, from 20 to 200 points (`termsel.fitting.camera_courses`), and up to 400 by a share that
falls. To all others comes what the model does not fit (`termsel.fitting.misfit`). Where the control
does not show what a height does, the effect of views in general is added
(`termsel.fitting.extrapolation.variance_by_heights`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import erfc

import numpy as np

from termsel.adjustment.bayesian.field import GaussianProcess
from termsel.adjustment.bayesian.line_posterior import line_covariance
from termsel.adjustment.bayesian.plane_average import PlaneAverage
from termsel.adjustment.bayesian.posterior import Posterior, polynomial_posterior, predict_positions
from termsel.adjustment.equations import weights_of
from termsel.adjustment.solve import Adjustment
from termsel.data.features import BoolArray, FeatureSet, FloatArray, Points
from termsel.data.monomials import evaluate_monomials, graded_exponents
from termsel.models.base import SensorModel
from termsel.models.polynomial import Polynomial2D, Polynomial3D

BELIEF_DEGREE = 3
"""Degree of the polynomial that the truth is believed to be; that of the model, if higher."""

CLEARLY_WORSE = 0.023
"""Chance of being the better course where the errors are worse by two standard errors."""

FEW_RESIDUALS = 10.0
"""What mean squares grow by where residuals of a projection have one degree of freedom, by these.
"""

COEFFICIENT_STEP = 1e-6
"""Change of a coefficient, in scaled coordinates, by which a prediction is differentiated."""


@dataclass(frozen=True, eq=False)
class Spread:
    """Mean square errors of predictions, in scaled coordinates.

    Attributes
    ----------
    variance, noise : ndarray, shapes (m, 2) and (2,)
        Of line and sample: without the noise of a measurement, and of a measurement of unit weight
        at the place.
    factors : ndarray, shape (m, 2, d), or None
        Their products, where known, are the covariances of what is not known, at all places and of
        both axes: a measurement lessens it elsewhere too.
    offsets : ndarray, shape (m, 2), or None
        Prediction minus the mean of what is believed, where factors leave out its square.

    Examples
    --------
    >>> import termsel
    >>> fitted = termsel.fit(termsel.simulate_scene("spot-isfahan"), "affine")
    >>> places = fitted.scaling.ground(fitted.control.points.ground)
    >>> fitted.estimator.spread(fitted, places).variance.shape
    (12, 2)
    """

    variance: FloatArray
    noise: FloatArray
    factors: FloatArray | None = None
    offsets: FloatArray | None = None


@dataclass(frozen=True)
class Experience:
    """How well points are known before they are measured, as an estimator takes it into account.

    Parameters
    ----------
    freedom : float
        Degrees of freedom that it counts as next to residuals.
    unknowns : int
        Number of unknowns for which residuals are smaller.
    tails : float
        Degrees of freedom of Student's distribution of measurements, infinite of normal ones.

    Examples
    --------
    >>> import termsel
    >>> termsel.Experience(freedom=2.0, unknowns=6, tails=4.0).spread
    2.0
    """

    freedom: float
    unknowns: int
    tails: float = np.inf

    @property
    def spread(self) -> float:
        """Relative variance of a squared distance that shows the scale of measurements as well.

        Of normal errors it is 1. Of Student's with t degrees of freedom in two dimensions a
        measurement shows t / (t + 4) of what a normal one shows of the scale (Lange, Little and
        Taylor 1989).
        """
        return 1.0 + 4.0 / self.tails


def spread_of(model: SensorModel, control: FeatureSet, terms: BoolArray, adjustment: Adjustment,
              ground: FloatArray, image: FloatArray, *, least_squares: bool) -> Spread:
    """Return the mean square errors of a fit's predictions; NaN without redundancy.

    All is scaled: the prepared model, the features in use, ground (m, 3) and the image that the fit
    predicts there (m, 2). `terms` (k,) is a mask of those that were fitted. `least_squares` says
    whether the coefficients are its own.
    """
    interpolation = None if len(control.lines) else model.interpolation(control)
    if interpolation is not None:
        return Spread(*interpolation.spread(ground))
    with_heights = sees_heights(lambda positions: model.project(adjustment.coefficients, positions),
                                ground)
    belief = _Belief.of(model, control, heights=with_heights)
    # Too few points for a belief about the form: the noise alone, by the law of propagation.
    if belief is None and least_squares:
        return _propagated_noise(model, control, terms, adjustment, ground)[0]
    if belief is None and len(control.lines):
        return _spread_by_lines(model, control, ground, image, heights=with_heights)
    if belief is None:
        return _unknown_spread(len(ground))
    # What corrects residuals follows the noise of the control, which no coefficient has.
    if not least_squares or model.polynomial_degree is not None or model.corrects:
        return belief.spread(ground, image)
    # Either the model has the form of the image, and noise is all, or the belief holds.
    propagated, squares = _propagated_noise(model, control, terms, adjustment, ground)
    chance = _chance_of_model(adjustment.n_terms, squares, belief)
    return _mixed_squares(chance, propagated, belief.spread(ground, image))


def _spread_by_lines(model: SensorModel, control: FeatureSet, ground: FloatArray,
                     image: FloatArray, *, heights: bool) -> Spread:
    """Return the mean square errors of a fit that is not by least squares, by control with lines.

    As with points, the truth is believed to be a regularised polynomial, and its posterior is that
    of points and lines together. NaN is returned where these do not determine an affine one.
    """
    degree = max(BELIEF_DEGREE, model.polynomial_degree or 0)
    believed = Polynomial3D(degree=degree) if heights else Polynomial2D(degree=degree)
    posterior = line_covariance(believed.equations(control), believed.exponents)
    if posterior is None:
        return _unknown_spread(len(ground))
    mean, covariance, noise = posterior
    monomials = evaluate_monomials(ground, believed.exponents)
    # With C = F F' the covariance of the coefficients of line, then of sample, factors are P F.
    values, vectors = np.linalg.eigh(covariance)
    roots = (vectors * np.sqrt(np.maximum(values, 0.0))).reshape(2, monomials.shape[1], -1)
    factors = np.stack([monomials @ axis_roots for axis_roots in roots], axis=1)
    offsets = image - monomials @ mean.reshape(2, -1).T
    return Spread((factors**2).sum(axis=2) + offsets**2, np.full(2, noise**2), factors, offsets)


@dataclass(frozen=True, eq=False)
class Unexplained:
    """What one of the courses that the truth may take leaves of the control.

    Attributes
    ----------
    chance : float
        Probability of the course.
    residuals : ndarray, shape (n, 2)
        Measured minus computed, scaled.
    effective : float or None
        Parameters of both axes together, None where the residuals are not less for them.
    """

    chance: float
    residuals: FloatArray
    effective: float | None


def unexplained_by(model: SensorModel, control: FeatureSet, terms: BoolArray,
                   adjustment: Adjustment, own: Unexplained, *,
                   least_squares: bool) -> list[Unexplained]:
    """Return what each course that `spread_of` takes for possible leaves of the control.

    `terms` (k,) is a mask of those that were fitted. A course is what the truth may be: the fit
    itself, whose residuals are `own`, or the belief; of a model that interpolates there is one.
    What separates the fit from a course is part of its spread already, so that only what the course
    leaves is to be added to that.
    """
    points = control.points
    interpolation = model.interpolation(control)
    if interpolation is not None:
        # A local model has taken up what its points show: its errors of points held out, of the
        # size of the noise that it sees, show the rest.
        scatter = np.sqrt((interpolation.errors**2).mean())
        noise = np.sqrt(interpolation.spread(points.ground[:1])[1].mean())
        residuals = interpolation.errors * noise / max(scatter, np.finfo(float).tiny)
        return [Unexplained(1.0, residuals, None)]
    with_heights = sees_heights(lambda positions: model.project(adjustment.coefficients, positions),
                                points.ground)
    belief = _Belief.of(model, control, heights=with_heights)
    if belief is None:
        return [own]
    chance = 0.0
    if least_squares and model.polynomial_degree is None and not model.corrects:
        squares = _propagated_noise(model, control, terms, adjustment, points.ground[:1])[1]
        chance = _chance_of_model(adjustment.n_terms, squares, belief)
    left_by_belief = Unexplained(1.0 - chance, belief.residuals(points), belief.effective())
    return [replace(own, chance=chance), left_by_belief]


def _chance_of_model(terms: int, squares: FloatArray, belief: _Belief) -> float:
    """Return how likely it is that a model, and not the belief, is the course of the truth.

    That is judged by the squared held-out errors (n,) of both. A model with no more `terms` than an
    affine polynomial knows the rest from elsewhere, as from a vendor's RPC, and so more of what
    lies beyond the points than they can show: its chance is 1 unless it predicts them clearly
    worse, and 0 then.
    """
    chance = _chance_of_being_less(squares, belief.squares())
    if terms <= 2 * (belief.variables + 1):
        return float(chance >= CLEARLY_WORSE)
    return chance


def _chance_of_being_less(squares: FloatArray, other_squares: FloatArray) -> float:
    """Return how likely the first kind of error is the smaller one, from squares at n places.

    The mean difference of their logarithms, divided by its standard error, is normally distributed:
    of the squares themselves a few great ones would make everything uncertain. The chance is 0
    where a square is not finite.
    """
    # P(mean <= 0) = Phi(-mean / s) = erfc(mean / s / sqrt(2)) / 2, s being the standard error.
    tiny = np.finfo(float).tiny
    excess = np.log(np.maximum(squares, tiny)) - np.log(np.maximum(other_squares, tiny))
    if not np.isfinite(excess).all():
        return 0.0
    deviation = excess.std(ddof=1) / len(excess)**0.5
    if deviation == 0.0:
        return float(excess.mean() <= 0.0)
    return 0.5 * erfc(excess.mean() / deviation / 2**0.5)


def _mixed_squares(chance: float, propagated: Spread, believed: Spread) -> Spread:
    """Return the mean square errors where propagated noise holds with a chance, else the belief."""
    factors = None
    if propagated.factors is not None and believed.factors is not None:
        factors = np.concatenate([chance**0.5 * propagated.factors,
                                  (1.0 - chance)**0.5 * believed.factors], axis=2)
    # Propagated noise has no offset.
    offsets = None if believed.offsets is None else (1.0 - chance)**0.5 * believed.offsets
    return Spread(chance * propagated.variance + (1.0 - chance) * believed.variance,
                  chance * propagated.noise + (1.0 - chance) * believed.noise, factors, offsets)


def sees_heights(project: Callable[[FloatArray], FloatArray], ground: FloatArray) -> bool:
    """Return whether heights of places (m, 3) make a difference to where they are projected."""
    sample = ground[:3]
    return bool((project(sample) != project(sample + np.array([0.0, 0.0, 1.0]))).any())


def believed_spread(model: SensorModel, control: FeatureSet, ground: FloatArray,
                    image: FloatArray) -> Spread | None:
    """Return the mean square errors as the polynomial sees them (see `spread_of`), or None."""
    belief = _Belief.of(model, control)
    return None if belief is None else belief.spread(ground, image)


def shared_variance(model: SensorModel, control: FeatureSet) -> float | None:
    """Return the relative variance of the mean square error that all places have in common.

    Where few coefficients are uncertain, the mean square of errors all over the scene is so, too.
    Returns None with lines, and where points are too few for a posterior.
    """
    belief = _Belief.of(model, control)
    if belief is None:
        return None
    points = control.points
    local = model.interpolation(control)
    averaged = local if isinstance(local, GaussianProcess | PlaneAverage) else belief.posterior
    held_out_spread = averaged.held_out.spread
    weights = weights_of(points)
    # The sum of squares of normal errors with the covariance C has the mean tr C and the variance
    # 2 tr C^2. What places have in common, those of the control points, the posterior sees.
    factors = belief.spread(points.ground, points.image).factors
    assert factors is not None
    # A point that is left out is less certain, and correlated with the others about as much.
    enlargement = (np.sqrt((held_out_spread - 1.0) / weights**2)
                   / np.maximum(np.linalg.norm(factors, axis=2), np.finfo(float).tiny))
    enlarged = (factors * enlargement[..., None]).reshape(-1, factors.shape[2])
    trace_of_square = ((enlarged.T @ enlarged) ** 2).sum()
    trace = (held_out_spread / weights**2).sum()
    # To this comes how much the mean squares of its solutions differ.
    return 2 * float(trace_of_square / trace**2) + belief.contest(weights)


@dataclass(frozen=True, eq=False)
class _Belief:
    """A regularised polynomial of the control points, and where it can be looked up."""

    posterior: Posterior
    degree: int
    variables: int

    @classmethod
    def of(cls, model: SensorModel, control: FeatureSet,
           heights: bool | None = None) -> _Belief | None:
        """Return the belief by control points, by default with the heights that the model uses.

        Returns None with lines, or if points determine no affine model.
        """
        if len(control.lines):
            return None
        # A belief of a lower degree than the model could not have the model's truth in it.
        degree = max(BELIEF_DEGREE, model.polynomial_degree or 0)
        heights = model.uses_height if heights is None else heights
        points = control.points
        variables = 3 if heights else 2
        posterior = polynomial_posterior(points.ground, points.image,
                                         graded_exponents(degree, variables),
                                         None if points.sigma is None else weights_of(points))
        return None if posterior is None else cls(posterior, degree, variables)

    def spread(self, ground: FloatArray, image: FloatArray) -> Spread:
        """Return the mean square errors of predictions at places."""
        columns = _polynomial_columns(ground, self.degree, self.variables)
        predicted = predict_positions(self.posterior, columns[:, :self.variables + 1],
                                      columns[:, self.variables + 1:])
        offsets = image - predicted.image
        return Spread(predicted.variance + offsets**2, np.full(2, predicted.noise),
                      predicted.factors, offsets)

    def contest(self, weights: FloatArray) -> float:
        """Return the variance, over the solutions, of the logarithm of their mean square error."""
        posterior = self.posterior
        # Of each cell: the variances of held-out points by the noise, of line and sample, summed.
        sums = np.zeros(len(posterior.cells.share))
        for batch in posterior.batches:
            axes = posterior.errors_of(batch)
            for axis, axis_weights in zip(axes, weights[batch].T, strict=True):
                sums = sums + (1.0 / axis.redundancies / axis_weights**2).sum(axis=1)[
                    axis.solution_of_cell]
        logarithm = np.log(posterior.square * sums)  # up to what all solutions share
        share = posterior.cells.share
        return float(share @ (logarithm - share @ logarithm) ** 2)

    def residuals(self, points: Points) -> FloatArray:
        """Return measured minus believed of the control points, (n, 2)."""
        columns = _polynomial_columns(points.ground, self.degree, self.variables)
        free = self.variables + 1
        return points.image - predict_positions(self.posterior, columns[:, :free],
                                                columns[:, free:]).image

    def effective(self) -> float:
        """Return the effective parameters of both axes together."""
        return float(sum(self.posterior.mean(axis)[1] for axis in (0, 1)))

    def squares(self) -> FloatArray:
        """Return the squared errors of the points (n,), each predicted by the other points."""
        return np.asarray((self.posterior.held_out.errors**2).sum(axis=1))


def _polynomial_columns(ground: FloatArray, degree: int, variables: int) -> FloatArray:
    """Return the monomials of ground places up to a degree, (n, k)."""
    return evaluate_monomials(ground, graded_exponents(degree, variables))


def _unknown_spread(count: int) -> Spread:
    """Return the spread of `count` places of which nothing is known: NaN."""
    return Spread(np.full((count, 2), np.nan), np.full(2, np.nan))


def _propagated_noise(model: SensorModel, control: FeatureSet, terms: BoolArray,
                      adjustment: Adjustment,
                      ground: FloatArray) -> tuple[Spread, FloatArray]:
    """Return the noise propagated through an adjustment, and squared held-out errors, (n,).

    Of a model that corrects its predictions by the control, these are the figures of predictions
    without the correction, which are worse. Without redundancy neither is known: the noise is NaN,
    and the errors are infinite.
    """
    if not adjustment.feasible or not adjustment.redundancy > 0:
        return _unknown_spread(len(ground)), np.full(len(control), np.inf)
    x = adjustment.coefficients
    equations = model.linearised(control, x) or model.equations(control)
    columns, right = equations.take(np.ones(len(equations.b), dtype=bool), terms).with_prior()
    q, r = np.linalg.qr(columns)
    errors = (right - columns @ x[terms])[:len(equations.b)]
    redundancies = np.maximum(1.0 - (q[:len(errors)] ** 2).sum(axis=1), np.finfo(float).eps)
    # Central differences of the prediction by each coefficient.
    steps = COEFFICIENT_STEP * np.maximum(1.0, np.abs(x[terms]))
    moved = np.repeat(x[None], len(steps), axis=0)
    moved[:, terms] += np.diag(steps)
    moved_back = 2 * x - moved
    difference = model.project(moved, ground) - model.project(moved_back, ground)  # (k, m, 2)
    slopes = difference / (2 * steps[:, None, None])
    # The noise has a scaled inverse chi-square distribution, of which sigma0^2 is the scale.
    noise = adjustment.sigma0**2 * _mean_by_scale(adjustment.redundancy)
    # The covariance of coefficients is sigma^2 R^-1 R^-T: factors are sigma slopes' R^-1.
    whitened = np.linalg.solve(r.T, slopes.reshape(len(steps), -1))
    factors = noise**0.5 * whitened.T.reshape(len(ground), 2, len(steps))
    # A row held out has the error e / (1 - h); those of a feature are added up.
    held_out_squares = np.bincount(equations.feature, (errors / redundancies) ** 2, len(control))
    return (Spread((factors**2).sum(axis=2), np.full(2, noise), factors),
            held_out_squares.astype(np.float64))


def _mean_by_scale(redundancy: float) -> float:
    """Return the mean of a scaled inverse chi-square distribution by its scale: f / (f - 2).

    So Student's t, which errors have whose noise is not known, has the variance f / (f - 2). With
    two degrees of freedom or fewer there is none: then that of three is taken.
    """
    freedom = max(redundancy, 3.0)
    return freedom / (freedom - 2.0)


def widening_of_projections(freedom: float) -> float:
    """Return by what mean squares of projections are larger than few residuals show: 1 + 10 / f^3.

    With 5 points a camera takes up 7 to 9 of 10 measurements, and with them most of what a lens or
    a scanner adds to the noise. The factor is that of errors to their standard deviations in
    simulated photos, with 5 to 8 points: 11 with one degree of freedom, 1.4 with three, and
    1.03 with seven.
    """
    return 1.0 + FEW_RESIDUALS / max(freedom, 1.0)**3
