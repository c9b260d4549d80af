"""The choice among candidates by leave-one-out.

Nothing here knows of roles: what it is given are features it may use.
"""

from __future__ import annotations

import numbers
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from math import erf, sqrt
from typing import Any

import numpy as np

from termsel.auto.base import Candidate, Judged, Suspects, gain_of
from termsel.auto.structures import CANDIDATES, named
from termsel.core.errors import TermselError
from termsel.core.isolation.arrays import of_shape, of_type
from termsel.core.isolation.faults import HINT, PluginFault, blamed, is_own, wrong
from termsel.data.control import Control
from termsel.data.features import FeatureSet, no_lines
from termsel.data.record.chances import t_quantile
from termsel.fitting.fit import Fit, Undetermined
from termsel.models.base import SensorModel

BETTER, EXPECTED, CLEARLY = 1.0, 2.0, 3.0
"""Standard errors by which the logarithms of squared errors must be smaller: of a candidate with a
prior than of the one before it, of a central projection, and of any other that no prior contains.
"""

LEAST = "It has the smallest leave-one-out RMSE."
"""Why a candidate is chosen where none has a prior."""

CORNERS = 4
"""Number of points that a projective transformation fits exactly."""

OBLIQUE = 0.02
"""RMSE of an affine transformation of four points, by the half extent of the image, from which on
they show an oblique view."""

DEEP = 0.8
"""Distance of the nearest point by that of the middle, along the view, below which a view is
oblique: a map has none, and points of a photo from above are at about the same distance."""

EXACT = 3
"""Number of points up to which a model fits them exactly, and none is chosen."""


@dataclass(frozen=True, eq=False)
class Choice:
    """A candidate chosen from a portfolio."""

    chosen: Judged
    judged: tuple[Judged, ...]  # all candidates that the features determine with redundancy
    reason: str  # why this one, in sentences with the figures that decided


class Portfolio:
    """The candidates of one run. One of a plugin that fails is left out from then on.

    They are in the order of the tables that compare them; by default those that are built in.
    """

    def __init__(self, candidates: Iterable[Candidate] = CANDIDATES) -> None:
        self.candidates = tuple(candidates)
        self.faults: dict[str, TermselError] = {
            one.name: TermselError(f"candidate {one.name!r} has most={one.most!r:.40}, which is no "
                                   "number of features", hint=HINT)
            for one in self.candidates if not (isinstance(one.most, numbers.Real) and one.most > 0)}
        self._whole: FeatureSet | None = None
        self._hopeless: frozenset[str] = frozenset()

    def for_parts_of(self, control: Control, choice: Choice | None = None) -> Portfolio:
        """Return the portfolio for parts of features: of these all count for `Candidate.most`.

        With the choice from all of them, candidates that it came nowhere near are not fitted: those
        without a prior that predict no better than the one to be beaten, and those that all
        features do not determine, or do not call for, unless they say that parts may.
        """
        parts = Portfolio(self.candidates)
        parts.faults, parts._whole = self.faults, control.features
        priors = [one for one in choice.judged if one.candidate.has_prior] if choice else []
        if not (choice and priors):
            return parts
        base = _base_of(priors)[0]
        judged = {one.name: one.candidate.has_prior or _gain(one, base) > 0.0
                  for one in choice.judged}

        def hopeful(one: Candidate) -> bool:
            # What others contain, or what needs others, is fitted in parts only where these say so.
            if _contained(one, priors) or not judged.keys() >= set(one.needs):
                return True
            if one.name in judged:
                return judged[one.name]
            return bool(self.ask(one, "nearly", control))

        parts._hopeless = frozenset(
            one.name for one in self.offered(control) if not hopeful(one))
        return parts

    def _count(self, control: Control) -> int:
        """Return how many features there are, of all that these are a part of."""
        whole = self._whole or control.features
        return len(whole) if len(control.features.lines) else len(whole.points)

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on the candidates that are left out, with what their authors must know."""
        return tuple(f"Left out of the choice: {fault.what}. {fault.hint or HINT}"
                     for fault in self.faults.values())

    def offered(self, control: Control, *, for_few: bool = False) -> list[Candidate]:
        """Return the candidates to choose from for some features, the plainest first."""
        sizes = {one: self.ask(one, "size", control.heights) for one in self.candidates
                 if not one.only_shown and one.for_few == for_few and one.name not in self.faults
                 and self._count(control) <= one.most
                 and self.ask(one, "declines", control) is None}
        return sorted((one for one in sizes if one.name not in self.faults),
                      key=lambda one: sizes[one])

    def suspects(self, control: Control) -> Suspects | None:
        """Return which features contradict what some candidate knows; None if none tells."""
        return next((found for one in self.offered(control) if (
            found := self.ask(one, "suspects", control)) is not None), None)

    def settles(self, candidate: Candidate, control: Control) -> str | None:
        """Return why the features call for a candidate alone, if they do.

        Raises TermselError where the candidate says what the user must say first.
        """
        try:
            with blamed(candidate, "settles"):
                reason = candidate.settles(control)
            if reason is not None and (fault := of_type(reason, str)):
                raise wrong(candidate, "settles", fault)
        except PluginFault as fault:
            self.faults[candidate.name] = fault
            return None
        return reason

    def least(self, control: Control) -> int:
        """Return the fewest features to choose by."""
        return 1 if any(one.from_one for one in self.offered(control)) else EXACT + 1

    def judged(self, candidate: Candidate, control: Control) -> Judged | None:
        """Return a candidate fitted and judged; None if it is not determined, or fails."""
        found: Judged | None = None if candidate.name in self._hopeless else self.ask(
            candidate, "judge", control)
        if found is None:
            return None
        fault = of_type(found.fit, Fit) or of_shape(found.squares, (len(control),)) or (
            None if isinstance(getattr(found.fit.estimator, "name", None), str) else
            "returned a fit by an estimator without a name, by which a result is read again")
        if fault is not None and not is_own(candidate):
            self.faults[candidate.name] = wrong(candidate, "judge", fault)
            return None
        return found

    def ask(self, candidate: Candidate, method: str, *args: Any) -> Any:
        """Return what a method of a candidate returns.

        None where the features do not determine the candidate, and where it fails: then it is left
        out from now on, unless it is termsel's own.
        """
        if candidate.name in self.faults:
            return None
        try:
            with blamed(candidate, method):
                found = getattr(candidate, method)(*args)
            found = bool(found) if isinstance(found, np.bool_) else found
            fault = found is not None and of_type(found, _RETURNED[method])
            if fault:
                raise wrong(candidate, method, fault)
        except Undetermined:
            return None
        except TermselError as error:
            if is_own(candidate):
                raise
            self.faults[candidate.name] = error if isinstance(error, PluginFault) else \
                TermselError(f"candidate {candidate.name!r} says: {error.what}", hint=error.hint)
            return None
        return found


_RETURNED = {"declines": str, "describe": str, "fit_control": Fit, "judge": Judged,
             "model": SensorModel, "nearly": bool, "refit": Fit,
             "size": numbers.Real, "suspects": Suspects}
"""Types of what methods return, if it is not None."""

Watch = Callable[[Judged | None], None]
"""Called with each candidate as soon as it is judged; with None where it is not determined."""


def choose(control: Control, portfolio: Portfolio | None = None, watch: Watch | None = None, *,
           whole: bool = True) -> Choice | None:
    """Fit the portfolio to features and choose by leave-one-out; None if none is determined.

    A regularised polynomial is averaged over all that lies between the plain ones, by a measure
    that needs no points to be left out. The quadratic one is taken unless the cubic one is better
    by BETTER standard errors (the rule of Breiman et al. 1984), and likewise any further candidate
    with a prior of its own. What none of them contains is taken only if it is better by CLEARLY
    standard errors, since the best of several is so partly by luck: rational models, and few terms
    of their own. There is one central projection, for which EXPECTED is enough, and BETTER where
    the points call for an oblique view. Where the points
    call for a random field, the regularised polynomial with it takes the place of those without.
    Logarithms of squared errors are compared, lest a few great errors make everything uncertain.
    Where features are too few for any candidate with a prior, the smallest sum of squares decides:
    similarities and a plane affine polynomial are then candidates too. With `whole`, candidates
    that others contain are judged all the same, to be shown.
    """
    portfolio = portfolio or Portfolio()
    offered = portfolio.offered(control)
    if (settled := _settled(offered, control, portfolio)) is not None:
        return settled
    judged: dict[str, Judged] = {}
    # What contains others comes first where these need not be judged then.
    for candidate in offered if whole else sorted(offered, key=lambda one: -len(one.contains)):
        called = judged.keys() >= set(candidate.needs) and (
            whole or not _contained(candidate, judged.values()))
        one = portfolio.judged(candidate, control) if called else None
        if one:
            judged[candidate.name] = one
        if watch:
            watch(one)
    found = [judged[one.name] for one in offered if one.name in judged]
    if not any(one.candidate.has_prior for one in found):
        found = [*_few(control, portfolio), *found]
    return best_of(found, portfolio)


def _settled(offered: Iterable[Candidate], control: Control,
             portfolio: Portfolio) -> Choice | None:
    """Return the choice of the candidate that the features call for alone, if one says so."""
    for candidate in offered:
        reason = portfolio.settles(candidate, control)
        judged = portfolio.judged(candidate, control) if reason else None
        if judged is not None:
            return Choice(judged, (judged,), str(reason))
    return None


def _few(control: Control, portfolio: Portfolio) -> list[Judged]:
    """Return the candidates for few features that have redundancy."""
    found = (portfolio.judged(one, control) for one in portfolio.offered(control, for_few=True))
    return [one for one in found if one]


def _contained(candidate: Candidate, judged: Iterable[Judged]) -> bool:
    """Return whether some candidate with a prior has this one as a limit."""
    return any(one.candidate.has_prior and candidate.name in one.candidate.contains
               for one in judged)


def exact(control: Control) -> Choice:
    """Return what two or three features determine: a similarity, or an affine polynomial.

    Raises Undetermined if three points lie on a line, or lines are parallel.
    """
    plane, n = replace(control, heights=False), len(control)
    candidate = named("similarity" if n == 2 else "affine")
    assert candidate is not None
    chosen = Judged(candidate, candidate.fit_control(plane), np.full(n, np.nan))
    return Choice(chosen, (*_few(plane, Portfolio()), chosen),
                  f"{n} {control.features.word} determine it exactly.")


def exact_view(control: Control, choice: Choice, portfolio: Portfolio) -> Choice:
    """Return the projection that four points determine, where nothing else fits.

    An affine transformation of four points leaves what a map or a vertical photo may leave; where
    it leaves more, and no point would be behind the camera, they show an oblique view. It is that
    of a camera without distortion where there is one, and else a projective transformation of the
    plane. Otherwise the choice is returned.
    """
    plane = replace(control, heights=False)
    affine, projective, camera = named("affine"), named("projective"), named("pinhole")
    if len(control) != CORNERS or len(control.features.points) != CORNERS \
            or choice.chosen.candidate.from_one:
        return choice
    assert affine is not None
    assert projective is not None
    try:
        left = affine.fit_control(plane).control_rmse()
        fitted = projective.fit_control(plane)
    except Undetermined:
        return choice
    assert left is not None
    seen = portfolio.judged(camera, control) if camera in portfolio.offered(control) else None
    if seen is not None and left.total >= OBLIQUE * control.scaling.image_scale:
        return Choice(replace(seen, squares=np.full(CORNERS, np.nan)), choice.judged,
                      f"{CORNERS} points leave one equation of it. An affine polynomial leaves "
                      f"{left.total:.3g} px of them, more than a map or a vertical photo does.")
    below = fitted.model.denominators(fitted.adjustment.coefficients,
                                      fitted.scaled_control.points.ground)
    assert below is not None
    if left.total < OBLIQUE * control.scaling.image_scale or (below <= 0.0).any():
        return choice
    return Choice(Judged(projective, fitted, np.full(CORNERS, np.nan)), choice.judged,
                  f"{CORNERS} points determine it exactly. An affine polynomial leaves "
                  f"{left.total:.3g} px of them, more than a map or a vertical photo does.")


def best_of(candidates: Iterable[Judged], portfolio: Portfolio | None = None) -> Choice | None:
    """Return the choice among candidates by the rule of `choose`; None if there is none."""
    judged, portfolio = tuple(candidates), portfolio or Portfolio()
    priors = [one for one in judged if one.candidate.has_prior]
    if not priors:
        return Choice(min(judged, key=_beyond_rounding), judged, LEAST) if judged else None
    base, said = _base_of(priors)
    others = [one for one in judged
              if not (one.candidate.has_prior or _contained(one.candidate, priors))]
    rivals = [base, *(one for one in others if _gain(one, base) > _asked(one, base))]
    chosen = min(rivals, key=_beyond_rounding)
    said[:0] = [reason for one in dict.fromkeys((chosen, base))
                if (reason := portfolio.ask(one.candidate, "describe", one.fit))]
    return Choice(chosen, judged, _reason(chosen, base, said, others, judged))


def _base_of(priors: Sequence[Judged]) -> tuple[Judged, list[str]]:
    """Return which candidate with a prior is to be beaten, and what decided among them."""
    base, said = priors[0], list[str]()
    for one in priors[1:]:
        if base.name in one.candidate.contains:
            base, said = one, []
        elif one.name not in base.candidate.contains:
            # Leave-one-out says little of places beyond the points, where what is known holds, too.
            asked = _sure(base) if base.candidate.from_one > one.candidate.from_one else BETTER
            if asked < np.inf:
                said.append(f"{_compared(one, base)}; it must be better by more than {asked:.2g}.")
            base = one if _gain(one, base) > asked else base
    return base, said


def _asked(one: Judged, base: Judged) -> float:
    """Return by how many standard errors a candidate that no prior contains must be better."""
    if base.candidate.from_one > one.candidate.from_one:
        return _sure(base)
    if not one.candidate.central:
        return CLEARLY
    # Few points measured roughly, as in a drawn bird's-eye view, hardly tell standard errors apart;
    # that they call for an oblique view, is evidence of its own.
    view = one.fit.view
    return BETTER if view is not None and view.depth < DEEP else EXPECTED


def _sure(base: Judged) -> float:
    """Return by how many standard errors others must be better than one that knows more.

    It is CLEARLY where features are many. Few of them hardly tell the standard error, so that more
    of it is as sure (Student 1908). Two say nothing of it.
    """
    freedom = len(base.squares) - 1
    return t_quantile((1.0 + erf(CLEARLY / sqrt(2.0))) / 2.0, freedom) if freedom > 1 else np.inf


def choose_features(control: Control, portfolio: Portfolio | None = None,
                    watch: Watch | None = None, *, whole: bool = True) -> Choice | None:
    """Choose as `choose`, and whether from points with lines, or from the points alone.

    Lines that add more error than redundancy are left out whole: where the points alone predict the
    points, each by the others, better by BETTER standard errors. The control of the chosen fit then
    has no lines. `watch` is told of the choice from all features alone.
    """
    portfolio, count = portfolio or Portfolio(), len(control.features.points)
    choice = choose(control, portfolio, watch, whole=whole)
    if choice is None or not count or not len(control.features.lines):
        return choice
    points = Control.of(control.features.with_(lines=no_lines()), control.heights)
    alone = choose(points, portfolio, whole=whole)
    if alone is None:
        return choice
    gain = gain_of(alone.chosen.squares, choice.chosen.squares[:count], choice.chosen.rounding)
    said = (f"Points alone predict the points {'better' if gain > 0 else 'worse'} than points with "
            f"lines do, by {_standard_errors(gain)}")
    if gain > BETTER:
        return replace(alone, reason=f"{alone.reason} {said}, so the lines are not used.")
    return replace(choice, reason=f"{choice.reason} {said}; to be used alone they must be better "
                                  f"by more than {BETTER:g}.")


def _reason(chosen: Judged, base: Judged, said: Sequence[str], others: Sequence[Judged],
            judged: Iterable[Judged]) -> str:
    """Return why a candidate is chosen, after what is said of those with a prior."""
    said = list(said)
    if others:
        nearest = chosen if chosen is not base else max(others, key=lambda one: _gain(one, base))
        smaller = (" and have a smaller RMSE"
                   if nearest is not chosen and _gain(nearest, base) > _asked(nearest, base)
                   else "")
        said.append(f"{_compared(nearest, base)}; it must be better by more than "
                    f"{_asked(nearest, base):.2g}{smaller}.")
    if any("standard error" in one for one in said):
        said.append("Standard errors are those of logarithms of squared leave-one-out errors.")
    least = min(judged, key=_beyond_rounding).candidate
    whole = next((one.candidate for one in judged if one.candidate.has_prior
                  and least.name in one.candidate.contains and not least.has_prior), None)
    if whole is not None:
        said.append(f"{least.label} is a limit of {whole.family or f'{whole.title} and its like'}, "
                    "which find it where the points call for it.")
    return " ".join(said) or LEAST


def _compared(one: Judged, other: Judged) -> str:
    """Return by how many standard errors a candidate is better or worse than another."""
    gain = _gain(one, other)
    return (f"{one.candidate.label} is {'better' if gain > 0 else 'worse'} than "
            f"{other.candidate.label} by {_standard_errors(gain)}")


def _standard_errors(gain: float) -> str:
    number = f"{abs(gain):.2g}"
    return f"{number} standard error{'s' * (number != '1')}"


def _beyond_rounding(judged: Judged) -> float:
    """Return the predicted RMSE [px], all that are rounding being equal: then the first is taken.
    """
    return max(judged.predicted, judged.rounding)


def _gain(one: Judged, other: Judged) -> float:
    """Return by how many standard errors one's squared errors are smaller, in logarithms."""
    return gain_of(one.squares, other.squares, one.rounding)
