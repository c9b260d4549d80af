"""How uncertain a fitted model is at any place.

The truth is believed to be a shrunken cubic polynomial (see
`termsel.adjustment.bayesian.posterior`): its posterior, given the same control points, says how
likely each other course of the image is between and beyond them. The mean square error of any fit
at a place is the variance of that posterior there, and the square of the distance of the fit from
its mean. A model of a kind that the polynomial does not contain, and that predicts left-out
control no worse than by a standard error, is judged by the propagation of the noise through its
own adjustment, as is one of lines or of few points. A spline
or a random field has a variance of its own. To all others comes what the model does not fit
(`termsel.fitting.misfit`). Where the control does not tell what a height does, the
effect of views in general is added (`termsel.fitting.extrapolation.by_heights`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from termsel.adjustment.bayesian.field import GaussianProcess
from termsel.adjustment.bayesian.posterior import Posterior, polynomial_posterior
from termsel.adjustment.bayesian.predicted_positions import predict_positions
from termsel.adjustment.equations import weights_of
from termsel.adjustment.solve import Adjustment
from termsel.data.features import BoolArray, FeatureSet, FloatArray
from termsel.data.monomials import graded_exponents, monomials
from termsel.models.base import SensorModel

BELIEF_DEGREE = 3
"""Degree of the polynomial that the truth is believed to be; that of the model, if higher."""

COEFFICIENT_STEP = 1e-6
"""Change of a coefficient, in scaled coordinates, by which a prediction is differentiated."""


@dataclass(frozen=True, eq=False)
class Spread:
    """Mean square errors of predictions, in scaled coordinates.

    Attributes
    ----------
    variance, noise : ndarray, shapes (m, 2) and (2,)
        Of line and sample without, and of, the noise of a measurement of unit weight at the place.
    factors : ndarray, shape (m, 2, d), or None
        Their products, where known, are the covariances of what is not known, at all places and of
        both axes: a measurement lessens it elsewhere too.
    """

    variance: FloatArray
    noise: FloatArray
    factors: FloatArray | None = None


def spread_of(model: SensorModel, control: FeatureSet, terms: BoolArray, adjustment: Adjustment,
              ground: FloatArray, image: FloatArray, *, least_squares: bool) -> Spread:
    """Return the mean square errors of what a fit predicts; NaN where there is no redundancy.

    All is scaled: the prepared model, the features in use, ground (m, 3) and the image that the fit
    predicts there (m, 2). `least_squares` says whether the coefficients are its own.
    """
    interpolation = None if len(control.lines) else model.interpolation(control)
    if interpolation is not None:
        return Spread(*interpolation.spread(ground))
    with_heights = sees_heights(lambda positions: model.project(adjustment.coefficients, positions),
                                ground)
    believed = _Belief.of(model, control, heights=with_heights)
    if believed is None:
        if not least_squares:
            return _unknown(len(ground))
        return _propagated(model, control, terms, adjustment, ground)[0]
    if least_squares and model.polynomial_degree is None:
        propagated, squares = _propagated(model, control, terms, adjustment, ground)
        excess = squares - believed.squares()
        # Within a standard error they predict alike, and the model knows more of what is beyond.
        if np.isfinite(excess).all() and excess.mean() <= excess.std() / len(excess)**0.5:
            return propagated
    return believed.spread(ground, image)


def sees_heights(project: Callable[[FloatArray], FloatArray], ground: FloatArray) -> bool:
    """Return whether heights of places (m, 3) make a difference to where they are projected."""
    sample = ground[:3]
    return bool((project(sample) != project(sample + np.array([0.0, 0.0, 1.0]))).any())


def believed_spread(model: SensorModel, control: FeatureSet, ground: FloatArray,
                    image: FloatArray) -> Spread | None:
    """Return the mean square errors as the polynomial sees them (see `spread_of`), or None."""
    believed = _Belief.of(model, control)
    return None if believed is None else believed.spread(ground, image)


def shared_variance(model: SensorModel, control: FeatureSet) -> float | None:
    """Return the relative variance of the mean square error that all places have in common.

    Where few coefficients are uncertain, the mean square of errors all over the scene is so, too.
    None with lines, and where points are too few for a posterior.
    """
    believed = _Belief.of(model, control)
    if believed is None:
        return None
    points = control.points
    local = model.interpolation(control)
    held_out = (local if isinstance(local, GaussianProcess) else believed.posterior).held_out
    weights = weights_of(points)
    # The sum of squares of normal errors with the covariance C has the mean tr C and the variance
    # 2 tr C^2. What places have in common, those of the control points, the posterior sees.
    factors = believed.spread(points.ground, points.image).factors
    assert factors is not None
    # A point that is left out is less certain, and about as much alike others.
    enlargement = np.sqrt((held_out.spread - 1.0) / weights**2) \
        / np.maximum(np.linalg.norm(factors, axis=2), np.finfo(float).tiny)
    enlarged = (factors * enlargement[..., None]).reshape(-1, factors.shape[2])
    trace_of_square = ((enlarged.T @ enlarged) ** 2).sum()
    trace = (held_out.spread / weights**2).sum()
    # To this comes how much the mean squares of its solutions differ.
    return 2 * float(trace_of_square / trace**2) + believed.contest(weights)


@dataclass(frozen=True, eq=False)
class _Belief:
    """A regularised polynomial of the control points, and where it can be looked up."""

    posterior: Posterior
    degree: int
    variables: int

    @classmethod
    def of(cls, model: SensorModel, control: FeatureSet,
           heights: bool | None = None) -> _Belief | None:
        """Return what is believed, by default with the heights that the model uses.

        None with lines, or if points determine no affine model.
        """
        if len(control.lines):
            return None
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
        columns = _columns(ground, self.degree, self.variables)
        predicted = predict_positions(self.posterior, columns[:, :self.variables + 1],
                                      columns[:, self.variables + 1:])
        return Spread(predicted.variance + (image - predicted.image) ** 2,
                      np.full(2, predicted.noise), predicted.factors)

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

    def squares(self) -> FloatArray:
        """Return the squared errors of the points (n,), each by the others."""
        return np.asarray((self.posterior.held_out.errors**2).sum(axis=1))


def _columns(ground: FloatArray, degree: int, variables: int) -> FloatArray:
    return monomials(ground, graded_exponents(degree, variables))


def _unknown(count: int) -> Spread:
    return Spread(np.full((count, 2), np.nan), np.full(2, np.nan))


def _propagated(model: SensorModel, control: FeatureSet, terms: BoolArray, adjustment: Adjustment,
                ground: FloatArray) -> tuple[Spread, FloatArray]:
    """Return the noise propagated through an adjustment, and squared held-out errors of features.

    Of a model that corrects predictions by its control it is that of the uncorrected ones, which
    are worse.
    """
    if not adjustment.feasible or not adjustment.redundancy > 0:
        return _unknown(len(ground)), np.full(len(control), np.inf)
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
    slopes = (model.project(moved, ground) - model.project(moved_back, ground)) \
        / (2 * steps[:, None, None])                                           # (k, m, 2)
    # The covariance of coefficients is sigma0^2 R^-1 R^-T: factors are sigma0 slopes' R^-1.
    whitened = np.linalg.solve(r.T, slopes.reshape(len(steps), -1))
    factors = adjustment.sigma0 * whitened.T.reshape(len(ground), 2, len(steps))
    # A row held out has the error e / (1 - h); those of a feature are added up.
    held_out_squares = np.bincount(equations.feature, (errors / redundancies) ** 2, len(control))
    return (Spread((factors**2).sum(axis=2), np.full(2, adjustment.sigma0**2), factors),
            held_out_squares.astype(np.float64))
