"""The choice among candidates by leave-one-out.

Nothing here knows of roles: what it is given are features it may use.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from termsel.adjustment.parts import independent_parts
from termsel.candidates.candidate import CANDIDATES, Candidate, named
from termsel.candidates.local import LIKELY
from termsel.criteria import Fits
from termsel.fits.fit import Fit, Undetermined
from termsel.fits.leave_out import solutions_without_each
from termsel.measurements.features import FeatureSet, FloatArray, no_lines, no_points
from termsel.measurements.scaling import Scaling, scaling_of
from termsel.models.poles import guard_points, pole_violation
from termsel.priors.field import Collocation

BETTER, CLEARLY = 1.0, 3.0
"""Standard errors by which the logarithms of squared errors must be smaller: of the shrunken cubic
than of the quadratic, and of what neither contains."""

FIELD = "field"
"""Name of the candidate that takes the place of the shrunken polynomials where it is called for."""

LEAST = "It has the smallest leave-one-out RMSE."
"""Why a candidate is chosen where there are no shrunken polynomials."""

EXACT = 3
"""Number of points up to which a model fits them exactly, and none is chosen."""

WIDER = 1.5
"""A denominator must be positive in a box this much wider than that of the points."""


@dataclass(frozen=True, eq=False)
class Judged:
    """A candidate fitted to features, and what leave-one-out says of it.

    Parameters
    ----------
    candidate : Candidate
    fit : Fit
    squares : ndarray, shape (n,)
        Squared error of each feature under the same procedure without it [px^2]: of a point
        dl^2 + ds^2, of a line the sum over its vertices.
    """

    candidate: Candidate
    fit: Fit
    squares: FloatArray

    @property
    def name(self) -> str:
        """Name of the candidate."""
        return self.candidate.name

    @property
    def predicted(self) -> float:
        """RMSE by leave-one-out [px], over points and vertices of lines."""
        control = self.fit.control
        return float(np.sqrt(self.squares.sum()
                             / (len(control.points) + 2 * len(control.lines))))


@dataclass(frozen=True, eq=False)
class Choice:
    """A candidate chosen from a portfolio.

    Parameters
    ----------
    chosen : Judged
    judged : tuple of Judged
        All candidates the features determine with redundancy.
    reason : str
        Why this one, in sentences with the figures that decided.
    """

    chosen: Judged
    judged: tuple[Judged, ...]
    reason: str


def portfolio(heights: bool) -> tuple[Candidate, ...]:
    """Return the candidates to choose from, the plainest first.

    Parameters
    ----------
    heights : bool
        Whether heights are known and differ.
    """
    def size(one: Candidate) -> float:
        model = one.model(heights)
        return len(model.terms) if model and (one.is_plain or one.kind == "full") else np.inf

    return tuple(sorted((one for one in CANDIDATES if one.model(heights)
                         and one.kind not in ("ridge", "few", "robust")), key=size))


def _judged(candidate: Candidate, control: FeatureSet, heights: bool,
            scaling: Scaling) -> Judged | None:
    """Return a candidate fitted and judged; None without redundancy or with a pole."""
    try:
        fitted = candidate.fit_control(control, heights, scaling)
    except Undetermined:
        return None
    if fitted.held_out is not None:
        return Judged(candidate, fitted, fitted.held_out.squares)
    if fitted.adjustment.redundancy < 1 or has_pole(fitted):
        return None
    squares = left_out_squares(fitted)
    return Judged(candidate, fitted, squares) if np.isfinite(squares).all() else None


def has_pole(fitted: Fit) -> bool:
    """Return whether a denominator falls short of the margin in a box wider than the points'."""
    guard = guard_points(fitted.scaled_control, no_points())
    middle = (guard.max(axis=0) + guard.min(axis=0)) / 2
    return bool(pole_violation(fitted.model, fitted.adjustment.coefficients[None],
                               middle + WIDER * (guard - middle))[0] > 0)


def left_out_squares(fitted: Fit) -> FloatArray:
    """Return the squared error of each control feature under the fit without it, shape (n,).

    As the criterion press judges: with equations to first order where others are not exact, so
    that this is closed form throughout.

    Parameters
    ----------
    fitted : Fit
        By least squares.

    Returns
    -------
    ndarray, shape (n,)
        [px^2]; infinite throughout where some feature is indispensable, and where a denominator
        falls short.
    """
    model, control = fitted.model, fitted.scaled_control
    parts = independent_parts(model.equations(control), model.axis)
    solutions = solutions_without_each(parts, fitted.terms, fitted.used)
    if solutions is None:
        return np.full(len(control), np.inf)
    fits = Fits(model, control.points, no_points(), fitted.scaling.image_scale,
                fitted.terms[None], fitted.adjustment.coefficients[None], control.lines, parts)
    return np.asarray(fits.held_out_each(solutions[:, None])[0])


Watch = Callable[[Judged | None], None]
"""Called with each candidate as soon as it is judged; with None where it is not determined."""


def choose(control: FeatureSet, heights: bool, watch: Watch | None = None, *,
           whole: bool = True) -> Choice | None:
    """Fit the portfolio to features and choose by leave-one-out.

    A shrunken polynomial is averaged over all that lies between the plain ones, by a measure
    that needs no points to be left out. The quadratic one is taken unless the cubic one is better
    by BETTER standard errors (the rule of Breiman et al. 1984), and that one unless what it does
    not contain is better by CLEARLY standard errors, since the best of several is so partly by
    luck: projective and rational models, and few terms of their own. Where the points call for a
    random field, the shrunken polynomial with it takes the place of both. Logarithms of squared
    errors are compared, lest a few great errors make everything uncertain. Where features are too
    few for a shrunken polynomial, the smallest sum of squares decides: similarities and a plane
    affine polynomial are then candidates too.

    Parameters
    ----------
    control : FeatureSet
    heights : bool
    watch : callable, optional
    whole : bool
        Whether candidates that are not chosen next to others are judged all the same, to be shown:
        limits of the shrunken polynomials, and these next to a random field.

    Returns
    -------
    Choice or None
        None if the features do not determine any candidate with redundancy.
    """
    scaling = scaling_of(control)
    judged: list[Judged] = []
    candidates = portfolio(heights)
    for candidate in candidates if whole else sorted(candidates, key=lambda one: one.name != FIELD):
        called = _called_for(candidate, judged, whole)
        one = _judged(candidate, control, heights, scaling) if called else None
        judged += [one] if one else []
        if watch:
            watch(one)
    if not shrinks(judged):
        if not whole:
            return choose(control, heights)
        judged = [*_few(control, heights, scaling), *judged]
    return best_of(judged)


def _few(control: FeatureSet, heights: bool, scaling: Scaling) -> list[Judged]:
    """Return the candidates for few features that have redundancy."""
    found = (_judged(one, control, heights, scaling) for one in CANDIDATES
             if one.kind == "few" and one.model(heights))
    return [one for one in found if one]


def exact(control: FeatureSet) -> Choice:
    """Return what two or three features determine: a similarity, or an affine polynomial.

    Parameters
    ----------
    control : FeatureSet
        Two or three features.

    Raises
    ------
    Undetermined
        If three points lie on a line, or lines are parallel.
    """
    scaling, n = scaling_of(control), len(control)
    candidate = named("similarity" if n == 2 else "affine")
    assert candidate is not None
    chosen = Judged(candidate, candidate.fit_control(control, False, scaling), np.full(n, np.nan))
    return Choice(chosen, (*_few(control, False, scaling), chosen),
                  f"{n} {control.word} determine it exactly.")


def _called_for(candidate: Candidate, judged: Iterable[Judged], whole: bool) -> bool:
    """Return whether a candidate is worth its time: a spline is where a field is."""
    field = any(one.name == FIELD for one in judged)
    if candidate.kind == "local":
        return candidate.name == FIELD or field
    return whole or not (candidate.kind == "contained" or (candidate.kind == "shrunken" and field))


def shrinks(judged: Iterable[Judged]) -> bool:
    """Return whether a shrunken polynomial was judged, be it with a random field."""
    return any(one.candidate.kind == "shrunken" or one.name == FIELD for one in judged)


def best_of(candidates: Iterable[Judged]) -> Choice | None:
    """Return the choice among candidates by the rule of `choose`; None if there is none."""
    judged = tuple(candidates)
    if not judged:
        return None
    if not shrinks(judged):
        return Choice(min(judged, key=lambda one: one.predicted), judged, LEAST)
    shrunken = [one for one in judged if one.candidate.kind == "shrunken"]
    field = base = next((one for one in judged if one.name == FIELD), None)
    if base is None:
        base = shrunken[0]
        for one in shrunken[1:]:
            base = one if _gain(one, base) > BETTER else base
    others = [one for one in judged if one.candidate.kind not in ("contained", "shrunken")
              and one is not field]
    rivals = [base, *(one for one in others if _gain(one, base) > CLEARLY)]
    chosen = min(rivals, key=lambda one: one.predicted)
    return Choice(chosen, judged, _reason(chosen, base, shrunken, others, judged))


def choose_features(control: FeatureSet, heights: bool, watch: Watch | None = None, *,
                    whole: bool = True) -> Choice | None:
    """Choose as `choose`, and whether from points with lines, or from the points alone.

    Lines that add more error than redundancy are left out whole: where the points alone predict the
    points, each by the others, better by BETTER standard errors.

    Parameters
    ----------
    control : FeatureSet
    heights : bool
    watch : callable, optional
        As for `choose`, of which only the choice from all features tells.
    whole : bool
        As for `choose`.

    Returns
    -------
    Choice or None
        As `choose`. The control of the chosen fit has no lines where points alone are better.
    """
    choice, count = choose(control, heights, watch, whole=whole), len(control.points)
    if choice is None or not count or not len(control.lines):
        return choice
    alone = choose(control.with_(lines=no_lines()), heights, whole=whole)
    if alone is None:
        return choice
    gain = gain_of(alone.chosen.squares, choice.chosen.squares[:count])
    said = (f"Points alone predict the points {'better' if gain > 0 else 'worse'} than points with "
            f"lines do, by {_standard_errors(gain)}")
    if gain > BETTER:
        return replace(alone, reason=f"{alone.reason} {said}, so the lines are not used.")
    return replace(choice, reason=f"{choice.reason} {said}; to be used alone they must be better "
                                  f"by more than {BETTER:g}.")


def _reason(chosen: Judged, shrunk: Judged, shrunken: Sequence[Judged], others: Sequence[Judged],
            judged: Iterable[Judged]) -> str:
    """Return why a candidate is chosen where there are shrunken ones."""
    said = [f"{_compared(one, shrunken[0])}; it must be better by more than {BETTER:g}."
            for one in shrunken[1:]]
    found = shrunk.fit.interpolation
    if isinstance(found, Collocation):
        said = [f"{shrunk.candidate.label} is called for: the probability of local deformation is "
                f"{found.probability:.3g}; it must exceed {LIKELY:g}."]
    if others:
        nearest = chosen if chosen is not shrunk else max(
            others, key=lambda one: _gain(one, shrunk))
        smaller = (" and have a smaller RMSE"
                   if nearest is not chosen and _gain(nearest, shrunk) > CLEARLY else "")
        said.append(f"{_compared(nearest, shrunk)}; it must be better by more than "
                    f"{CLEARLY:g}{smaller}.")
    if said:
        said.append("Standard errors are those of logarithms of squared leave-one-out errors.")
    least = min(judged, key=lambda one: one.predicted)
    if least.candidate.kind == "contained":
        said.append(f"{least.candidate.label} is a limit of the shrunken polynomials, which find "
                    "it where the points call for it.")
    return " ".join(said) or LEAST


def _compared(one: Judged, other: Judged) -> str:
    """Return by how many standard errors a candidate is better or worse than another."""
    gain = _gain(one, other)
    return (f"{one.candidate.label} is {'better' if gain > 0 else 'worse'} than "
            f"{other.candidate.label} by {_standard_errors(gain)}")


def _standard_errors(gain: float) -> str:
    number = f"{abs(gain):.2g}"
    return f"{number} standard error{'s' * (number != '1')}"


def _gain(one: Judged, other: Judged) -> float:
    """Return by how many standard errors one's squared errors are smaller, in logarithms."""
    return gain_of(one.squares, other.squares)


def gain_of(one: FloatArray, other: FloatArray) -> float:
    """Return by how many standard errors one's squares are smaller, in logarithms."""
    tiny = np.finfo(float).tiny
    gain = np.log(np.maximum(other, tiny) / np.maximum(one, tiny))
    return float(gain.mean() / max(gain.std(ddof=1) / np.sqrt(len(gain)), tiny))
