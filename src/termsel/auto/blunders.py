"""Blunders among control features, found by what the other features predict for each.

A point is a blunder where the regularised polynomial of the others (see
`termsel.auto.shrunken`) predicts it worse than chance allows, and a line where it predicts
its vertices off the image line. Under one solution on the grid the squared error of a prediction,
over its variance, is F distributed, with the noise as the other features leave it. Its tail is
averaged over the grid with the probabilities that the other features give. Blunders hide each
other, so the features that fit worst are first set aside, a third of all, and each is admitted
again once the features in use predict it.

A prediction far from the other features rests on the form of the model, and a blunder there looks
like a bend of the image. No test tells them apart, and only an error that is large even against the
variance that its place gives is named by one. Of points, what is likelier is told all the same: as
a blunder or as a right point, under all polynomials and random fields that the others call for.
Points that are likelier blunders are left out. Others with such an error stay in use, and are named
as undecided.

References
----------
Baarda 1968 for data snooping; Atkinson, Riani and Cerioli 2004, Exploring Multivariate Data with
the Forward Search, for setting points aside and admitting them again; Croux and Haesbroeck 1999
for the scale of the closest points. The predictive test and the allowance for places far from
others are termsel's own.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from termsel.adjustment.bayesian.field import GaussianProcess
from termsel.adjustment.bayesian.held_out import chance_of
from termsel.auto.auto import Auto
from termsel.auto.contradictions import STRAIN, UNLIKELY, Division, Test, polynomial_of
from termsel.auto.memory import Memory
from termsel.auto.robust import reweighted
from termsel.auto.shrunken import Averaging
from termsel.data.features import BoolArray, FeatureSet, FloatArray, Points
from termsel.data.fit_data import FitData
from termsel.data.record.chances import median
from termsel.fitting.fit import Fit
from termsel.fitting.method import Suspects

Whole = Callable[[], Test | None]
"""The test by all features, which is made where one is asked for."""

Tested = Callable[[Division], Test | None]
"""A test by the features in use."""

MOST = 1 / 3
"""Largest share of blunders."""

STEP, LEAST_STEP = 0.34, 0.01
"""Share of the points still to be set aside that one step takes, and of all points that it takes at
least: of many points, the last steps would hardly differ."""

CLEAR = 1.5
"""Errors by the largest one of points in use, beyond which a point is a blunder under a model that
is no polynomial."""

LEAST = 21
"""Points below which none is left out for being likelier a blunder. They are no more than the
coefficients of a cubic polynomial, and a right point that shows a bend may look like one."""


def find_blunders(control: FitData, auto: Auto | None = None) -> Suspects | None:
    """Return which control features are blunders; None where they are too few for a test.

    What the regularised polynomial suspects is left out of the choice among all candidates, by
    default those that are built in. Features that the chosen one predicts within STRAIN are no
    blunders: their errors were the polynomial's.
    """
    choice = auto or Auto()
    suspects: Suspects | None = choice.recall("blunders", control, lambda: _found(control, choice))
    return suspects


def _found(control: FitData, auto: Auto) -> Suspects | None:
    everything = np.ones(len(control), dtype=bool)
    whole = cache(Division(control, everything).shrunken_test)
    core = _core(control, whole)
    if core is None:
        return None
    used, test = _settled(control, *_forward(control, *core, whole))
    while not (used.all() or test.local) and (
            choice := auto.choose(control.take(used), whole=False)):
        more = used | _predicted_by(choice.chosen, control.features)
        if (more == used).all():
            break
        used = more
    kept = used
    if len(control) >= LEAST and not len(control.features.lines):
        kept = _without_probable(control, used)
    if (kept != used).any():
        test = Division(control, kept).test() or test
    seen = _by_projection(control, auto, kept)
    if seen is not None:
        kept, test = seen
    far, decided = test.far(len(control)), test.decided()
    blunders, undecided = ~kept, kept & far & ~decided
    cleared = _explained(control, auto, blunders | undecided)
    return test.suspects(blunders & ~cleared, blunders & ~cleared & ~(far & decided),
                         undecided & ~cleared, everything)


def _by_projection(control: FitData, auto: Auto,
                   used: BoolArray) -> tuple[BoolArray, Test] | None:
    """Judge all points by a central projection, where those in use call for one; None else.

    Polynomials follow an oblique view so badly that what they leave hides blunders, and makes sound
    points look like some.
    """
    if len(control.features.lines):
        return None
    choice = auto.choose(control.take(used), whole=False)
    if choice is None or not choice.method.central or choice.chosen.view is None:
        return None
    projection = choice.method

    def tested(division: Division) -> Test | None:
        return division.test_by(projection)

    everything = np.ones(len(control), dtype=bool)
    whole = cache(lambda: tested(Division(control, everything)))
    test = whole()
    if test is not None and not _stands_out(test.errors):
        return everything, test
    core = _core(control, whole, tested)
    return None if core is None else _forward(control, *core, whole, tested)


def _stands_out(errors: FloatArray) -> bool:
    """Return whether some error is far beyond the median, as that of no blunder is."""
    # The median of the larger of two normal errors is 1.05 standard deviations.
    return bool(errors.max() > STRAIN * median(errors) / 1.05)


def _explained(control: FitData, auto: Auto, suspected: BoolArray) -> BoolArray:
    """Return which suspected points a parametric model of all other points predicts.

    Polynomials and random fields follow an oblique view badly: what bends there is the image. A
    view that was fitted without the suspected points and predicts them tells that they are right.
    """
    cleared = np.zeros(len(control), dtype=bool)
    while not len(control.features.lines) and (suspected & ~cleared).any():
        choice = auto.choose(control.take(~suspected | cleared), whole=False)
        if choice is None or not _is_parametric(choice.chosen):
            break
        further = suspected & ~cleared & _predicted_by(choice.chosen, control.features)
        if not further.any():
            break
        cleared |= further
    return cleared


def _is_parametric(fitted: Fit) -> bool:
    """Return whether a fit is by another model than the polynomials and fields of the tests."""
    return not (isinstance(fitted.estimator, Averaging)
                or isinstance(fitted.interpolation, GaussianProcess))


def _without_probable(control: FitData, used: BoolArray) -> BoolArray:
    """Leave out points that are likelier blunders than right, the likeliest one first each time."""
    kept = used.copy()
    while (~kept).sum() < int(MOST * len(control)):
        worst = Division(control, kept.copy()).likeliest_blunder()
        if worst is None:
            break
        kept[worst] = False
    return kept


def _predicted_by(chosen: Fit, features: FeatureSet) -> BoolArray:
    """Return the features that a fit predicts as it predicts those that it was made with."""
    averaged = isinstance(chosen.estimator, Averaging)
    if len(features.lines) and averaged:  # the test was by the same polynomial
        return np.zeros(len(features), dtype=bool)
    # The median of the sum of two squared normal variables is 2 ln 2.
    squares = chosen.held_out().squares
    bound = STRAIN * np.sqrt(median(squares) / (2 * np.log(2)))
    if _is_parametric(chosen):
        # The test was of another model than the chosen one.
        bound = max(bound, CLEAR * np.sqrt(squares.max()))
    return np.asarray(_errors(chosen, features) <= bound)


def _errors(fitted: Fit, features: FeatureSet) -> FloatArray:
    """Return the largest error of each feature in line or sample, or off its line [px]."""
    largest = np.zeros(len(features))
    rows = np.abs(fitted.errors(features.points)).max(axis=1)
    if len(features.lines):
        vectors = fitted.line_errors(features.lines)
        rows = np.concatenate([rows, np.linalg.norm(vectors, axis=2).max(axis=1)])
    np.maximum.at(largest, features.feature, rows)
    return largest


def judge_others(chosen: Fit, heights: bool, others: Points,
                 memory: Memory) -> Suspects | None:
    """Return which of other points, that took no part, contradict all others, control or not.

    The choice is that for control without blunders, with heights or not. None as for
    `find_blunders`, or without other points.
    """
    control, count = chosen.control, len(chosen.control.points)
    if not len(others):
        return None
    every = FitData.of(control.with_(points=control.points.join(others)), heights)
    there = np.zeros(len(every), dtype=bool)
    there[count:count + len(others)] = True
    # Where control is scarce, the others tell more than it does. They begin with those it predicts.
    used = ~there | _predicted_by(chosen, every.features)
    return memory.recall((there.tobytes(), used.tobytes()), every,
                         lambda: _contradicting(every, there, used))


def _contradicting(every: FitData, there: BoolArray, used: BoolArray) -> Suspects | None:
    """Return which of the features `there` contradict all others, beginning with those `used`."""
    whole = cache(Division(every, ~np.zeros_like(there)).shrunken_test)
    test = Division(every, used).shrunken_test()
    core = _core(every, whole) if test is None else (used, test)
    if core is None:
        return None
    used, test = _settled(every, *_forward(every, *core, whole))
    blunders, decided = there & ~used, test.decided()
    return test.suspects(blunders & decided, np.zeros_like(there), blunders & ~decided, there)


def _core(control: FitData, whole: Whole,
          tested: Tested = Division.shrunken_test) -> tuple[BoolArray, Test] | None:
    """Return the features that remain where those that fit worst are set aside, and their test.

    None where they are too few for a test.

    Of points step by step. With lines, which are many, those that have no weight under the biweight
    are; a whole third where these are more, or the features too few for a quadratic.
    """
    used = np.ones(len(control), dtype=bool)
    if len(control.features.lines):
        used = _weighty(control, whole)
        test = Division(control, used).shrunken_test() or whole()
        return None if test is None else (used, test)
    test = whole()
    if test is None:
        return None
    core = len(control) - int(MOST * len(control))
    while used.sum() > core:
        left = int(used.sum()) - core
        count = max(1, int(STEP * left), min(left, int(LEAST_STEP * len(control))))
        worst = np.argsort(-np.where(used, test.strain, -1.0), kind="stable")[:count]
        fewer = used.copy()
        fewer[worst] = False
        nearer = tested(Division(control, fewer))
        if nearer is None:
            break
        used, test = fewer, nearer
    return used, test


def _weighty(control: FitData, whole: Whole) -> BoolArray:
    """Return the features that have weight under a robust quadratic polynomial."""
    weightless, most = _weightless(control), int(MOST * len(control))
    if weightless is not None and weightless.sum() <= most:
        return ~weightless
    used, test = np.ones(len(control), dtype=bool), whole()
    if test is not None:
        used[np.argsort(-test.strain, kind="stable")[:most]] = False
    return used


def _weightless(control: FitData) -> BoolArray | None:
    """Return the features with a row of no weight; None if they are too few for a quadratic."""
    model = polynomial_of(control.heights, 2)
    equations = model.equations(control.scaled)
    if len(equations.b) <= len(model.terms):
        return None
    _, weights = reweighted(equations, biweight=True)
    weightless = np.zeros(len(control), dtype=bool)
    weightless[equations.feature[weights == 0]] = True
    return weightless


def _forward(control: FitData, used: BoolArray, test: Test, whole: Whole,
             tested: Tested = Division.shrunken_test) -> tuple[BoolArray, Test]:
    """Admit features again that those in use predict; leave out those they no longer do."""
    n, seen = len(control), set[bytes]()
    # A set of features that comes back would come back for ever.
    while used.tobytes() not in seen:
        seen.add(used.tobytes())
        out = ~used & test.far(n) & test.decided()
        if not used.all():
            # The closest features understate the noise.
            strain = test.strain * np.sqrt(_consistency(used.sum() / n))
            chance = chance_of(strain**2, max(2 * int(used.sum()) - 8, 2))
            out &= (chance < UNLIKELY / n) & (strain > STRAIN)
        back = np.flatnonzero(~used & ~out)
        now = used.copy()
        if back.size:
            likeliest = back[np.argsort(test.strain[back], kind="stable")]
            now[likeliest[:max(1, back.size // 2, int(LEAST_STEP * n))]] = True
        else:
            bad = np.flatnonzero(used & test.far(n) & test.decided())
            if bad.size and (~used).sum() < int(MOST * n):
                now[bad[np.argmax(test.strain[bad])]] = False
        if (now == used).all():
            break
        nearer = whole() if now.all() else tested(Division(control, now))
        if nearer is None:
            break
        used, test = now, nearer
    return used, test


def _settled(control: FitData, used: BoolArray, test: Test) -> tuple[BoolArray, Test]:
    """Judge again by a random field, where the points in use call for one.

    Local deformation is no blunder, and what is small next to the error of a polynomial may be
    one.
    """
    n, seen = len(control), set[bytes]()
    while used.tobytes() not in seen and (~used).sum() <= MOST * n:
        seen.add(used.tobytes())
        nearer = Division(control, used).local_test()
        if nearer is None:
            break
        test = nearer
        far = test.far(n) & test.decided()
        out = used & far & (test.strain >= np.max(test.strain, where=used & far, initial=0.0) / 2)
        used = (used & ~out) | (~used & ~far)
    return used, test


def _consistency(share: float) -> float:
    """Return the mean square of the closest share of normal errors in two coordinates, by that of
    all."""
    if share >= 1:
        return 1.0
    # Half of a chi-squared number is exponential; its mean up to a bound.
    bound = -np.log1p(-share)
    return float(1.0 - bound * (1.0 - share) / share)
