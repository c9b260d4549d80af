"""The least squares of distances in the image, as an estimator and as a verb."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from termsel.adjustment.equations import Equations
from termsel.adjustment.iterated import HALVINGS, ITERATIONS
from termsel.adjustment.leave_out import IndependentPart, independent_parts, leave_one_out
from termsel.adjustment.solve import Adjustment, solve
from termsel.core.errors import TermselError, count_in_words
from termsel.core.isolation.faults import fault_of_method
from termsel.core.threads import one_blas_thread
from termsel.data.features import BoolArray, FeatureSet, FloatArray, empty_points
from termsel.data.scaling import Scaling, make_scaling
from termsel.fitting.fit import Estimator, Fit, HeldOut, Undetermined
from termsel.fitting.population import Fits
from termsel.models.base import SensorModel
from termsel.models.quotient import RationalModel

MAX_REFITTED_POINTS = 40
"""Points up to which distances are iterated again without each of them: of more, one step from the
solution is as good."""

CONVERGENCE_OFFSET = 1e-3
"""A fit has converged where a step would take away less than this share of the residuals: the
relative offset of D.M. Bates and D.G. Watts, Technometrics 23 (1981) 179-183."""

RESIDUAL_ROUNDING = 1e-12
"""Size of a residual, in the scaled image unit, that rounding makes: a step that takes away less of
each has converged as well."""

SMALLEST_DECREASE = 1e-10
"""Share of the sum of squares that a step must take away to count as one that lessens it."""


@dataclass(frozen=True)
class LeastSquares(Estimator):
    """The coefficients of the least squares of distances in the image.

    If `iterated`, it goes on from equations that hold to first order to the least squares of
    distances; else the fit is the one a search judges.

    Parameters
    ----------
    iterated : bool
        Whether to go on to the distances; otherwise the solution of the equations is the fit.

    Examples
    --------
    >>> import termsel
    >>> fitted = termsel.fit(termsel.simulate_scene("spot-isfahan"), "affine")
    >>> fitted.estimator
    LeastSquares(iterated=True)
    >>> fitted.estimator.held_out(fitted).squares.shape  # of each control point left out [px^2]
    (12,)
    """

    name = "least-squares"
    least_squares = True
    iterated: bool = True

    def fit(self, model: SensorModel, control: FeatureSet, scaling: Scaling, terms: BoolArray,
            used: BoolArray) -> Fit:
        """Return the fit (see `Estimator.fit`); `Fit.determined` says whether there is one."""
        model = model.prepared(scaling, control.crs)
        features = scaling.features(control)
        adjustment = (adjust(model, features, terms, used) if self.iterated
                      else solve(first_order_equations(model, features), terms, used))
        return Fit(model=model, scaling=scaling, control=control, terms=terms, used=used,
                   adjustment=adjustment, estimator=self)

    def held_out(self, fitted: Fit) -> HeldOut:
        """Return the errors of features in use, each under least squares without that feature.

        They have a closed form, by which the criterion press judges, too. Where equations are not
        exact, they are taken to first order throughout; of few points the distances are minimised
        again without each point instead.

        Raises
        ------
        Undetermined
            If some feature is indispensable, or a denominator is too small at its place.
        """
        squares = left_out_squares(fitted)
        if not np.isfinite(squares).all():
            raise Undetermined(
                "without one of its control features the fit is not determined, or has a pole "
                "there", hint="Measure more control, or choose a model with fewer terms.")
        return HeldOut(squares)

    def without_each(self, fitted: Fit) -> Iterator[Fit]:
        """Yield the fits without each feature in use, in closed form.

        Where equations are not exact, they are linearised about the solution: each fit is then one
        Gauss-Newton step away from it. A model that corrects its predictions by the control is
        fitted again, and so is one that is not determined without some feature.
        """
        model = fitted.model
        features = fitted.scaled_control
        equations = (model.linearised(features, fitted.adjustment.coefficients)
                     if self.iterated else None) or first_order_equations(model, features)
        solutions = None if model.corrects else solutions_without_each(
            independent_parts(equations, model.axis), fitted.terms, fitted.used)
        if solutions is None:
            yield from super().without_each(fitted)
            return
        for index in np.flatnonzero(fitted.used):
            used = fitted.used.copy()
            used[index] = False
            # Only the coefficients are those without the feature; the rest of the adjustment stays.
            yield replace(fitted, used=used, adjustment=replace(
                fitted.adjustment, coefficients=solutions[index]))


LEAST_SQUARES = LeastSquares()


def adjust(model: SensorModel, features: FeatureSet, terms: BoolArray,
           used: BoolArray) -> Adjustment:
    """Return the least squares of distances, by Gauss-Newton where equations are not exact.

    The model is prepared, the features are scaled; `terms` (k,) and `used` (features,) are in use.
    Steps begin at the model's own start, else at the solution of its equations. A step that does
    not lessen the sum of squared distances is halved, and where that does not help the search ends.
    Whether it has converged, and after how many steps, the adjustment says.
    """
    adjustment, x, equations = _start_of_steps(model, features, terms, used)
    if equations is None or not adjustment.feasible:
        return adjustment

    def residuals_of(equations: Equations, coefficients: FloatArray) -> FloatArray:
        """Return the residuals of the rows in use, (m,), then those of pseudo-observations."""
        in_use = equations.take(used[equations.feature], np.ones_like(terms))
        A, b = in_use.with_prior()
        return np.asarray(b - A @ coefficients)

    residuals = residuals_of(equations, x)
    if not np.isfinite(residuals).all():
        return replace(adjustment, steps=0, converged=False)
    solution = solve(equations, terms, used).coefficients
    steps = 0
    while True:
        # The share of the residuals that the tangent plane can still take away.
        gain = residuals - residuals_of(equations, solution)
        converged = bool(np.linalg.norm(gain) <= CONVERGENCE_OFFSET * np.linalg.norm(residuals)
                         + RESIDUAL_ROUNDING * len(residuals)**0.5)
        if steps == ITERATIONS:
            break
        # Halved until the sum of squares falls; where that never happens the search ends.
        for share in HALVINGS:
            candidate = x + share * (solution - x)
            candidate_equations = _linearised_equations(model, features, candidate)
            candidate_residuals = residuals_of(candidate_equations, candidate)
            if (candidate_residuals @ candidate_residuals
                    < (1 - SMALLEST_DECREASE) * (residuals @ residuals)):
                break
        else:
            break
        candidate_adjustment = solve(candidate_equations, terms, used)
        # Near a pole the equations say nothing of what is determined.
        if not candidate_adjustment.feasible:
            break
        x = candidate
        equations = candidate_equations
        residuals = candidate_residuals
        solution = candidate_adjustment.coefficients
        adjustment = replace(candidate_adjustment, coefficients=x)
        steps += 1
    return replace(adjustment, steps=steps, converged=converged)


def _start_of_steps(model: SensorModel, features: FeatureSet, terms: BoolArray, used: BoolArray,
                    ) -> tuple[Adjustment, FloatArray, Equations | None]:
    """Return the adjustment before any step, the solution x (k,) where steps begin, and equations.

    The equations are linearised about x; they are None where no step is needed, as those of the
    adjustment are exact, and where these do not determine the terms. Arguments are as for `adjust`.
    """
    start = model.start(features.take(used))
    if start is not None:
        x = np.where(terms, start, 0.0)
        equations = _linearised_equations(model, features, x)
        return replace(solve(equations, terms, used), coefficients=x), x, equations
    adjustment = solve(model.equations(features), terms, used)
    x = adjustment.coefficients
    # Some terms are better found last: steps then begin with the solution of the others.
    if model.first_terms is not None:
        x = solve(model.equations(features), terms & model.first_terms, used).coefficients
    return adjustment, x, model.linearised(features, x) if adjustment.feasible else None


def _linearised_equations(model: SensorModel, features: FeatureSet,
                          coefficients: FloatArray) -> Equations:
    """Return the equations about the coefficients (k,) of a solution; the model must have them.

    Raises PluginFault where the model returns none.
    """
    equations = model.linearised(features, coefficients)
    if equations is None:
        raise fault_of_method(model, "linearised",
                              "returned nothing; expected Equations, as it has a start")
    return equations


def first_order_equations(model: SensorModel, features: FeatureSet) -> Equations:
    """Return the equations by which a search judges selections, of scaled features.

    Those of a model with a start are linearised about the least squares of all terms.
    """
    if model.start(features) is None:
        return model.equations(features)
    every_term = np.ones(len(model.terms), dtype=bool)
    every_feature = np.ones(len(features), dtype=bool)
    solution = adjust(model, features, every_term, every_feature).coefficients
    return _linearised_equations(model, features, solution)


def solutions_without_each(parts: tuple[IndependentPart, ...], terms: BoolArray,
                           used: BoolArray) -> FloatArray | None:
    """Return the least-squares solutions without each of n features, in closed form, (n, k).

    The parts are those of the equations of all features; `terms` (k,) and `used` (n,) are in use.
    Returns None where the terms are not determined, or some feature is indispensable.
    """
    solutions = np.zeros((len(used), len(terms)))
    for part in parts:
        solutions_of_part, determined = leave_one_out(part.equations, terms[None, part.columns],
                                                      used[None])
        if not determined.all():
            return None
        solutions[:, part.columns] = solutions_of_part[:, 0]
    return solutions


def fit(model: SensorModel, control: FeatureSet, scaling: Scaling,
        terms: BoolArray | None = None, used: BoolArray | None = None, *,
        iterated: bool = True) -> Fit:
    """Fit a model to control features by least squares, whether or not they determine it.

    Features are in px and ground units. `terms` (k,) and `used`, a mask of the features, say what
    is in use, by default everything. `iterated` is as for `LeastSquares`.
    """
    terms = np.ones(len(model.terms), dtype=bool) if terms is None else terms
    used = np.ones(len(control), dtype=bool) if used is None else used
    return LeastSquares(iterated).fit(model, control, scaling, terms, used)


def left_out_squares(fitted: Fit) -> FloatArray:
    """Return the squared error of each control feature under the fit without it [px^2], (n,).

    The fits are those of `LeastSquares.held_out`. All errors are infinite where some feature is
    indispensable; a single one is where a denominator is too small at its feature.
    """
    model = fitted.model
    control = fitted.scaled_control
    is_weighted = isinstance(model, RationalModel) and model.weighted
    equations = model.linearised(control, fitted.adjustment.coefficients) if is_weighted else None
    parts = independent_parts(equations or first_order_equations(model, control), model.axis)
    solutions = solutions_without_each(parts, fitted.terms, fitted.used)
    if solutions is None:
        return np.full(len(control), np.inf)
    # Weights depend on the solution, which among few points changes with each that is left out.
    if is_weighted and len(control) <= MAX_REFITTED_POINTS and not len(control.lines):
        solutions = _refitted_without_each(fitted)
    fits = Fits(model=model, control=control.points, check=empty_points(),
                pixels=fitted.scaling.image_scale, terms=fitted.terms[None],
                coefficients=fitted.adjustment.coefficients[None], lines=control.lines,
                parts=parts)
    return np.asarray(fits.held_out_each(solutions[:, None])[0])


def _refitted_without_each(fitted: Fit) -> FloatArray:
    """Return the least squares of distances in the image of points without each, shape (n, k)."""
    model = fitted.model
    assert isinstance(model, RationalModel)
    control = fitted.scaled_control
    count = len(control)
    # One individual for each point, which uses all others.
    return model.least_distances(
        control.points, independent_parts(model.equations(control), model.axis),
        np.tile(fitted.terms, (count, 1)), ~np.eye(count, dtype=bool))


# The verb of the public API: from features with their roles to a fit, or to what is missing.

AS_CONTROL = ("control", "")
"""Roles of the points that a fit takes as control; "" is that of a point without a role."""


def control_of(features: FeatureSet) -> FeatureSet:
    """Return the features that a fit takes as control: lines, and points of `AS_CONTROL`.

    Raises TermselError if there are none.
    """
    points = features.points
    is_control = np.isin(np.array(points.roles, dtype=object), AS_CONTROL)
    if not is_control.any() and not len(features.lines):
        other_roles = ", ".join(sorted(set(points.roles)))
        raise TermselError(
            f"all {len(points)} points have other roles than control: {other_roles}" if other_roles
            else "there are no control features",
            hint="Give points the role control or none; a fit takes these and all lines.")
    if is_control.all():
        return features
    return features.take(
        np.concatenate([is_control, np.ones(len(features) - len(points), dtype=bool)]))


@one_blas_thread
def fit_all_terms(model: SensorModel, control: FeatureSet) -> Fit:
    """Fit all terms of a model by least squares to the features that `control_of` returns.

    Raises `Undetermined` if the control does not determine the terms.
    """
    terms = np.ones(len(model.terms), dtype=bool)
    used = np.ones(len(control), dtype=bool)
    return require_determined(
        LEAST_SQUARES.fit(model, control, make_scaling(control), terms, used))


def require_determined(fitted: Fit) -> Fit:
    """Return a fit that its features determine.

    Raises `Undetermined` for one that did not converge, has fewer equations than terms, or
    equations that depend on each other, each with what helps.
    """
    if fitted.determined:
        return fitted
    adjustment = fitted.adjustment
    name = fitted.model.name
    if not adjustment.converged:
        raise Undetermined(f"the fit of model {name!r} did not converge (it ended after "
                           f"{count_in_words(adjustment.steps or 0, 'step')})",
                           hint="Give more control, or choose a plainer model.")
    # Too few equations, or enough of them that say the same: more control helps the one, other
    # control the other.
    if adjustment.n_equations < adjustment.n_terms:
        raise Undetermined(
            f"{fitted.used.sum()} control features give {adjustment.n_equations} equations for the "
            f"{adjustment.n_terms} terms of model {name!r}",
            hint=f"Measure at least {-(-adjustment.n_terms // 2)}, or choose a model with fewer "
                 "terms.")
    raise Undetermined(
        f"the control determines only {adjustment.rank} of the {adjustment.n_terms} terms of "
        f"model {name!r}",
        hint="Spread the control over the area and its heights, or choose a model with fewer "
             "terms.")
