"""Candidates that are fitted to features, and the choice among them.

A candidate takes features and gives a fitted model with the error of each feature under the same
procedure without it. Nothing here knows of roles: what it is given are features it may use.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from termsel.adjustment.leave_out import leave_one_out
from termsel.adjustment.parts import independent_parts
from termsel.adjustment.solve import Adjustment
from termsel.candidates.selected import select_forward
from termsel.candidates.shrunken import average
from termsel.criteria import Fits
from termsel.fits.fit import Fit, fit
from termsel.measurements.features import FeatureSet, FloatArray, Points, no_points
from termsel.measurements.places import spatial_order
from termsel.measurements.scaling import Scaling, scaling_of
from termsel.models.base import SensorModel
from termsel.models.monomials import monomials
from termsel.models.poles import guard_points, pole_violation
from termsel.models.polynomial import Affine, Polynomial, Polynomial2D, Polynomial3D
from termsel.models.projective import DLT3D, Projective2D
from termsel.models.rational import RationalFunctions

SHRUNK = {2: "shrunken-quadratic", 3: "shrunken-cubic"}
"""Names by degree of the candidates of which one is taken, unless what they do not contain is
clearly better."""

CONTAINED = ("affine", "quadratic", "cubic")
"""Limits of the shrunken polynomials, which find them where the points call for them."""

BETTER, CLEARLY = 1.0, 3.0
"""Standard errors by which the logarithms of squared errors must be smaller: of the shrunken cubic
beside the quadratic, and of what neither contains."""

SELECTED = "selected"

MAX_FOLDS = 20
"""Folds in which the whole choice is repeated; with fewer points each is left out alone."""

WIDER = 1.5
"""A denominator must be positive in a box this much wider than that of the points."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """A candidate fitted to points.

    Parameters
    ----------
    name : str
    fit : Fit
    squares : ndarray, shape (n,)
        Squared error of each feature under the same procedure without it [pixel^2]: of a point
        dl^2 + ds^2, of a line the sum over its vertices.
    effective : float
        Terms that are free in effect.
    """

    name: str
    fit: Fit
    squares: FloatArray
    effective: float

    @property
    def predicted(self) -> float:
        """RMSE by leave-one-out [pixel], over points and vertices of lines."""
        control = self.fit.control
        return float(np.sqrt(self.squares.sum()
                             / (len(control.points) + 2 * len(control.lines))))


Candidate = Callable[[FeatureSet, Scaling], Fitted | None]


@dataclass(frozen=True, eq=False)
class Choice:
    """A candidate chosen from a portfolio.

    Parameters
    ----------
    chosen : Fitted
    fitted : tuple of Fitted
        All candidates the points determine.
    """

    chosen: Fitted
    fitted: tuple[Fitted, ...]


def plain(name: str, model: SensorModel) -> Candidate:
    """Return the candidate that fits all terms of a model by least squares."""
    def candidate(control: FeatureSet, scaling: Scaling) -> Fitted | None:
        fitted = fit(model, control, scaling)
        if not fitted.adjustment.feasible or fitted.adjustment.redundancy < 1 or _pole(fitted):
            return None
        squares = left_out_squares(fitted)
        return None if not np.isfinite(squares).all() else \
            Fitted(name, fitted, squares, float(fitted.adjustment.n_terms))
    return candidate


def _pole(fitted: Fit) -> bool:
    """Return whether a denominator falls short of the margin in a box wider than the points'."""
    guard = guard_points(fitted.scaling.features(fitted.control), no_points())
    middle = (guard.max(axis=0) + guard.min(axis=0)) / 2
    return bool(pole_violation(fitted.model, fitted.adjustment.coefficients[None],
                               middle + WIDER * (guard - middle))[0] > 0)


def left_out_squares(fitted: Fit) -> FloatArray:
    """Return the squared error of each control feature under the fit without it, shape (n,).

    Parameters
    ----------
    fitted : Fit
        By least squares.

    Returns
    -------
    ndarray, shape (n,)
        [pixel^2]; infinite throughout where some feature is indispensable.
    """
    model, control = fitted.model, fitted.scaling.features(fitted.control)
    parts = independent_parts(model.equations(control), model.axis)
    terms, used = fitted.terms[None], fitted.used[None]
    solutions = np.zeros((len(control), *terms.shape))
    for part in parts:
        solutions[..., part.columns], determined = leave_one_out(
            part.equations, terms[:, part.columns], used)
        if not determined.all():
            return np.full(len(control), np.inf)
    fits = Fits(model, control.points, no_points(), fitted.scaling.image_scale, terms,
                fitted.adjustment.coefficients[None], control.lines, parts)
    return np.asarray(fits.held_out_each(solutions)[0])


def shrunken(family: type[Polynomial], degree: int) -> Candidate:
    """Return the candidate that averages shrunken polynomials of a degree; for points alone."""
    def candidate(control: FeatureSet, scaling: Scaling) -> Fitted | None:
        if len(control.lines):
            return None
        model = family(degree=degree)
        points = scaling.points(control.points)
        found = average(points.ground, points.image, model.exponents,
                        None if points.sigma is None else _weights(points))
        if found is None:
            return None
        coefficients = found.coefficients.T.ravel()
        equations = model.equations(scaling.features(control))
        k = len(coefficients)
        residuals = equations.b - equations.A @ coefficients
        freedom = len(residuals) - found.effective
        sigma0 = float(np.sqrt(residuals @ residuals / freedom)) if freedom > 0.5 else np.nan
        fitted = Fit(model, scaling, control, np.ones(k, dtype=bool),
                     np.ones(len(control), dtype=bool),
                     Adjustment(coefficients, residuals, np.full(k, np.nan),
                                round(found.effective), len(residuals), round(found.effective),
                                float("nan"), sigma0))
        squares = (found.errors**2).sum(axis=1) * scaling.image_scale**2
        return Fitted(SHRUNK[degree], fitted, squares, found.effective)
    return candidate


def selected(family: type[Polynomial]) -> Candidate:
    """Return the candidate that selects terms of a cubic polynomial; for points alone."""
    def candidate(control: FeatureSet, scaling: Scaling) -> Fitted | None:
        if len(control.lines):
            return None
        model = family(degree=3)
        points, weights = scaling.points(control.points), _weights(control.points)
        columns = monomials(points.ground, model.exponents)
        affine = np.array(model.exponents).sum(axis=1) < 2
        sides = [select_forward(columns * w[:, None], image * w, affine)
                 for image, w in zip(points.image.T, weights.T, strict=True)]
        line, sample = sides
        if line is None or sample is None:
            return None
        errors = np.stack([line.errors, sample.errors], axis=1) / weights * scaling.image_scale
        fitted = fit(model, control, scaling, np.concatenate([line.terms, sample.terms]))
        return Fitted(SELECTED, fitted, (errors**2).sum(axis=1),
                      float(fitted.adjustment.n_terms))
    return candidate


def _weights(points: Points) -> FloatArray:
    """Return by what the equations of points are multiplied, shape (n, 2)."""
    return (np.ones_like(points.image) if points.sigma is None
            else np.asarray(np.median(points.sigma) / points.sigma))


def portfolio(heights: bool) -> tuple[Candidate, ...]:
    """Return the candidates, the plainest first.

    Parameters
    ----------
    heights : bool
        Whether heights are known and differ.
    """
    if not heights:
        return (plain("affine", Polynomial2D(degree=1)), plain("projective", Projective2D()),
                plain("quadratic", Polynomial2D(degree=2)),
                plain("cubic", Polynomial2D(degree=3)), selected(Polynomial2D),
                shrunken(Polynomial2D, 2), shrunken(Polynomial2D, 3))
    return (plain("affine", Affine()), plain("dlt", DLT3D()),
            plain("quadratic", Polynomial3D(degree=2)),
            plain("rfm-2", RationalFunctions(order=2)),
            plain("cubic", Polynomial3D(degree=3)), plain("rfm-3", RationalFunctions()),
            selected(Polynomial3D), shrunken(Polynomial3D, 2), shrunken(Polynomial3D, 3))


def choose(control: FeatureSet, heights: bool) -> Choice | None:
    """Fit the portfolio to features and choose by leave-one-out.

    A shrunken polynomial is averaged over all that lies between the plain ones, by a measure
    that needs no points to be left out. The quadratic one is taken unless the cubic one is better
    by BETTER standard errors (the rule of Breiman et al. 1984), and that one unless what it does
    not contain is better by CLEARLY standard errors, since the best of several is so partly by
    luck: projective and rational models, and few terms of their own. Logarithms of squared errors
    are compared, lest a few great errors make everything uncertain. With lines, for which there
    is no shrunken polynomial, the smallest sum of squares decides.

    Parameters
    ----------
    control : FeatureSet
    heights : bool

    Returns
    -------
    Choice or None
        None if the features do not determine any candidate with redundancy.
    """
    scaling = scaling_of(control)
    fitted = tuple(one for one in (make(control, scaling) for make in portfolio(heights)) if one)
    if not fitted:
        return None
    named = {one.name: one for one in fitted}
    quadratic, cubic = (named.get(name) for name in SHRUNK.values())
    shrunk = cubic or quadratic
    if cubic and quadratic and _gain(cubic, quadratic) <= BETTER:
        shrunk = quadratic
    rivals = [one for one in fitted if shrunk is None or one is shrunk or (
        one.name not in (*CONTAINED, *SHRUNK.values()) and _gain(one, shrunk) > CLEARLY)]
    return Choice(min(rivals, key=lambda one: one.predicted), fitted)


def _gain(one: Fitted, other: Fitted) -> float:
    """Return by how many standard errors one's squared errors are smaller, in logarithms."""
    tiny = np.finfo(float).tiny
    gain = np.log(np.maximum(other.squares, tiny) / np.maximum(one.squares, tiny))
    return float(gain.mean() / max(gain.std(ddof=1) / np.sqrt(len(gain)), tiny))


def repeated(control: FeatureSet, heights: bool) -> FloatArray | None:
    """Return the errors of points under choices made without them.

    In each fold the whole portfolio is fitted and chosen from anew, so that the errors are
    those of the choice and not of a model that was chosen by them.

    Parameters
    ----------
    control : FeatureSet
        Points. Folds are spread over the scene.
    heights : bool

    Returns
    -------
    ndarray, shape (n, 2), or None
        Measured minus predicted [pixel]; None if some fold leaves too little to choose by.
    """
    points = control.points
    order = spatial_order(points.ground[:, :2])
    folds = min(MAX_FOLDS, len(points))
    errors = np.empty((len(points), 2))
    for fold in range(folds):
        out = np.zeros(len(points), dtype=bool)
        out[order[fold::folds]] = True
        choice = choose(control.with_(points=points.take(~out)), heights)
        if choice is None:
            return None
        errors[out] = choice.chosen.fit.errors(points.take(out))
    return errors
