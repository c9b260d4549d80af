"""Blunders among control features, found by what the other features predict for each.

A point is a blunder where the regularised polynomial of the others (see
`termsel.auto.shrunken`) predicts it worse than chance allows, and a line where it predicts
its vertices off the image line. Under one solution on the grid the squared error of a prediction,
over its variance, is F distributed, with the noise as the other features leave it. Its tail is
averaged over the grid with the probabilities that the other features give. Blunders hide each
other, so the features that fit worst are first set aside, a third of all, and each is admitted
again once the features in use predict it. Where more than a third of many points are wrong, those
that a majority agrees on come first (see `termsel.auto.majority`).

A prediction far from the other features rests on the form of the model, and a blunder there looks
like a bend of the image. No test distinguishes them, and only an error that is large even against
the variance that its place gives is named by one. Of points, what is likelier is said all the same:
a blunder or a right point, under all polynomials and random fields that the others support.
Points that are likelier blunders are left out. Others with such an error stay in use, and are named
as undecided. What was left out is asked once more by a polynomial that bends more than a cubic one:
points that it makes likelier right than blunders are in use again.

References
----------
Baarda 1968 for data snooping; Atkinson, Riani and Cerioli 2004, Exploring Multivariate Data with
the Forward Search, for setting points aside and admitting them again; Croux and Haesbroeck 1999
for the scale of the closest points. The predictive test and the allowance for places far from
others are termsel's own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from termsel.adjustment.bayesian.field import GaussianProcess
from termsel.adjustment.bayesian.held_out import chance_of
from termsel.adjustment.bayesian.plane_average import PlaneAverage
from termsel.auto.auto import Auto
from termsel.auto.contradictions import (
    DOUBTFUL_STRAIN,
    FALSE_ALARM,
    MIN_STRAIN,
    Division,
    Test,
    polynomial_of,
)
from termsel.auto.likeliest_majority import likeliest_majority
from termsel.auto.majority import (
    ADDED_PART,
    MANY_POINTS,
    MAX_BLUNDER_SHARE,
    MIN_POINTS,
    NOISE_JUMP,
    Halves,
    find_majority,
    is_outvoted,
)
from termsel.auto.memory import Memory
from termsel.auto.misplaced import misplaced_points
from termsel.auto.robust import reweighted
from termsel.auto.shrunken import Averaging
from termsel.data.features import BoolArray, FeatureSet, FloatArray, Points
from termsel.data.fit_data import FitData
from termsel.data.record.chances import median_of
from termsel.fitting.fit import Fit
from termsel.fitting.method import Suspects

TestOfAll = Callable[[], Test | None]
"""The test by all features, which is made where one is asked for."""

TestOf = Callable[[Division], Test | None]
"""A test by the features in use."""

MIN_MINORITY = 1 / 4
MAX_MINORITY = 1 / 2
"""Least and largest share of blunders that a majority of points contradicts."""

STEP_SHARE = 0.34
"""Share of the points still to be set aside that one step takes."""

MIN_STEP_SHARE = 0.01
"""Share of all points that a step takes at least: of many, the last steps would hardly differ."""

CLEAR_RATIO = 1.5
"""Errors by the largest one of points in use, beyond which a point is a blunder under a model that
is no polynomial."""

OUT_OF_PLACE = 0.5
"""Error by the extent of the points in the image, beyond which a far point is not in its place."""

CLEARLY_WITHIN = 0.95
"""Part of MIN_STRAIN within which an error stays, whichever of many points are in use."""

MIN_PROBABLE_POINTS = 21
"""Points below which none is left out for being likelier a blunder. They are no more than the
coefficients of a cubic polynomial, and a right point that shows a bend may look like one."""


def find_blunders(control: FitData, auto: Auto | None = None) -> Suspects | None:
    """Return which control features are blunders; None where they are too few for a test.

    Parameters
    ----------
    control : FitData
        Points, or points and lines.
    auto : Auto, optional
        The choice among methods, by default the built-in ones. A suspected feature is no blunder
        where the method that is chosen without the suspected ones predicts it as well as the
        features that it was fitted to: the error was that of the polynomial that the test rests on.
    """
    choice = auto or Auto()
    suspects: Suspects | None = choice.recall("blunders", control,
                                              lambda: _suspects_of(control, choice))
    return suspects


@dataclass(frozen=True, eq=False)
class _Verdict:
    """What became of each control feature, as masks (n,), and the test by those in use."""

    used: BoolArray
    blunders: BoolArray
    probable: BoolArray
    undecided: BoolArray
    test: Test
    polynomial: Test | None  # by a polynomial of those in use, where a field has judged them

    def suspects(self, control: FitData) -> Suspects:
        """Return the findings, with the least error [px] that would be named at each feature."""
        everything = np.ones(len(control), dtype=bool)
        suspects = self.test.suspects(self.blunders, self.probable, self.undecided, everything)
        # A field predicts little without a point, but the polynomial judged all points before it.
        # In simulations half of the errors of 1 to 1.4 times the smaller of both limits are found.
        if self.polynomial is None:
            return suspects
        limits = self.polynomial.suspects(self.blunders, self.probable, self.undecided,
                                          everything).limits
        return replace(suspects, limits=np.minimum(suspects.limits, limits))


def _suspects_of(control: FitData, auto: Auto) -> Suspects | None:
    """Return blunders, probable ones and open cases among features; None if they are too few.

    Points that an image cannot show where they lie are blunders whatever the other features say of
    them. The other features are judged without these points, or where they are too few for that,
    with them. Points that an oblique view might show where they lie are judged like all features;
    if they are in use in the end, they are named as undecided.
    """
    misplaced, doubtful = _points_out_of_place(control, auto)
    verdict = _verdict_without(misplaced, control, auto) or _verdict_on(control, auto)
    if verdict is None:
        return None
    undecided = verdict.undecided | (doubtful & verdict.used)
    return replace(verdict, undecided=undecided).suspects(control)


def _verdict_without(misplaced: BoolArray, control: FitData, auto: Auto) -> _Verdict | None:
    """Return the verdict in which the points of the mask `misplaced` (n,) are blunders.

    The other features are judged without them. Returns None where no point is misplaced, and where
    the other features are too few for a test.
    """
    if not misplaced.any():
        return None
    others = _verdict_on(control.take(~misplaced), auto)
    if others is None:
        return None

    def of_all(mask_of_others: BoolArray, value_of_misplaced: bool) -> BoolArray:
        mask = np.full(len(control), value_of_misplaced)
        mask[~misplaced] = mask_of_others
        return mask

    # The test is of all features, so that misplaced points have their errors, too.
    used = of_all(others.used, False)
    division = Division(control, used)
    test = division.test()
    if test is None:
        return None
    return _Verdict(used, of_all(others.blunders, True), of_all(others.probable, False),
                    of_all(others.undecided, False), test,
                    division.shrunken_test() if test.by_field else None)


def _points_out_of_place(control: FitData, auto: Auto) -> tuple[BoolArray, BoolArray]:
    """Return which points lie where the image cannot show them, and where it hardly can, (n,).

    Such points are far from the other points on the ground and among them in the image, and the
    model of the other points puts them outside the image: an oblique view may show far ground over
    near summits.
    """
    points = control.features.points
    misplaced, doubtful = np.zeros((2, len(control)), dtype=bool)
    misplaced[:len(points)], doubtful[:len(points)] = misplaced_points(points)
    folded = misplaced | doubtful
    if not folded.any():
        return misplaced, doubtful
    choice = auto.choose(control.take(~folded), with_contained=False)
    if choice is None:
        return np.zeros_like(misplaced), doubtful
    errors = np.abs(choice.chosen.errors(points)).max(axis=1)
    extent = np.ptp(points.image[~folded[:len(points)]], axis=0).max()
    # Behind a camera there is no image of a place.
    folded[:len(points)] &= ~(errors <= OUT_OF_PLACE * extent)
    return misplaced & folded, doubtful & folded


def _verdict_on(control: FitData, auto: Auto) -> _Verdict | None:
    """Return what becomes of features whose places the image can show; None if they are too few.

    In five steps: a core without blunders, and all that it predicts; what another model predicts
    as well; features that are likelier blunders than right; points that a bend of the image
    explains, or a central projection; suspects that a camera model clears.
    """
    everything = np.ones(len(control), dtype=bool)
    test_of_all = cache(Division(control, everything).shrunken_test)
    by_majority = _majority_and_test(control) if len(control) >= MIN_POINTS else None
    if by_majority is not None:
        max_share = MAX_MINORITY
        used, test = by_majority
        # Half of the points may support a model so wrong that it predicts blunders, ever more.
        predictable = test.strain <= MIN_STRAIN
    else:
        max_share = MAX_BLUNDER_SHARE
        agreeing = _agreeing_features(control, test_of_all)
        if agreeing is None:
            return None
        used, test = _judge_by_field(control, *agreeing)
        predictable = everything
    if not test.by_field:
        used = _with_predicted_by_models(control, auto, used, predictable)
    suspected = ~used
    retained = _without_likely_blunders(control, used, max_share)
    if (retained != used).any():
        test = Division(control, retained).test() or test
    # A random field has followed any bend already.
    if not test.by_field:
        bent = predictable & _points_on_a_bend(control, retained)
        if bent.any():
            retained = retained | bent
            test = Division(control, retained).test() or test
    by_projection = None if by_majority else _judge_by_projection(control, auto, retained)
    if by_projection is not None:
        retained, test = by_projection
    doubtful = (np.zeros_like(retained) if by_majority or by_projection
                else _points_of_a_deformation(control, retained, suspected, test))
    if doubtful.any():
        retained = retained | doubtful
        test = Division(control, retained).test() or test
    far = test.beyond_chance(len(control))
    decided = test.beyond_form()
    # Beyond chance, but where the prediction is too weak to accuse it.
    undecided = (retained & far & ~decided) | doubtful
    # Who is suspected by a polynomial may be right by the geometry of the sensor.
    cleared = predictable & _points_a_model_explains(control, auto, ~retained | undecided)
    blunders = ~retained & ~cleared
    polynomial = None
    if test.by_field:
        polynomial = (test_of_all() if retained.all()
                      else Division(control, retained).shrunken_test())
    return _Verdict(retained, blunders, blunders & ~(far & decided), undecided & ~cleared, test,
                    polynomial)


def _agreeing_features(control: FitData,
                       test_of_all: TestOfAll) -> tuple[BoolArray, Test] | None:
    """Return a mask (n,) of features that agree, and their test; None if too few for a test."""
    if _all_agree(control, test_of_all):
        test = test_of_all()
        assert test is not None
        return np.ones(len(control), dtype=bool), test
    # A core without blunders first, then all that it predicts: one blunder may hide another.
    core = _agreeing_core(control, test_of_all)
    return None if core is None else _readmit_predicted(control, *core, test_of_all)


def _all_agree(control: FitData, test_of_all: TestOfAll) -> bool:
    """Return whether two tests show that no step of the search would find a blunder.

    The points are many. All of them contradict none, and the two thirds that fit best predict all
    others: a part, which sharpens with each point that it admits, would admit all.
    """
    n = len(control)
    if n < MANY_POINTS or len(control.features.lines):
        return False
    test = test_of_all()
    limit = CLEARLY_WITHIN * MIN_STRAIN
    if test is None or (test.strain > limit).any():
        return False
    core = np.ones(n, dtype=bool)
    core[np.argsort(-test.strain, kind="stable")[:int(MAX_BLUNDER_SHARE * n)]] = False
    test_of_core = Division(control, core).shrunken_test()
    return (test_of_core is not None
            and bool((_strain_by_all_noise(test_of_core, core) <= limit).all()))


def _with_predicted_by_models(control: FitData, auto: Auto, used: BoolArray,
                              predictable: BoolArray) -> BoolArray:
    """Return a mask (n,) of the features in use and of those that the model of these predicts.

    Another model, such as an RFM, may predict what the polynomial of the tests does not. The choice
    is repeated with what is taken in, until nothing more is. `used` (n,) is the mask to begin with;
    only what the mask `predictable` (n,) has is taken in.
    """
    while not used.all():
        choice = auto.choose(control.take(used), with_contained=False)
        if choice is None:
            break
        extended = used | (predictable & _features_predicted_by(choice.chosen, control.features))
        if (extended == used).all():
            break
        used = extended
    return used


def _without_likely_blunders(control: FitData, used: BoolArray, max_share: float) -> BoolArray:
    """Return a mask (n,) of the features in use, without points that are likelier blunders.

    The likeliest blunder goes first, and the remaining points are judged again: without the worst
    error the next may look innocent. `used` (n,) is the mask to begin with. None goes where that
    puts more than `max_share` of all features out of use, and none of few points or where there are
    lines.
    """
    # With few points a probable blunder may be half of what there is.
    if len(control) < MIN_PROBABLE_POINTS or len(control.features.lines):
        return used
    retained = used.copy()
    while (~retained).sum() < int(max_share * len(control)):
        worst = Division(control, retained.copy()).likeliest_blunder()
        if worst is None:
            break
        retained[worst] = False
    return retained


def _majority_and_test(control: FitData) -> tuple[BoolArray, Test] | None:
    """Return the points that agree, (n,), and their test, where more than a third are blunders.

    Returns None where no majority is clear, so that the usual search from a core will do.
    """
    halves = Halves.of(control)
    return likeliest_majority(control, _majority_of_polynomials(control, halves), halves)


def _majority_of_polynomials(control: FitData,
                             halves: Halves | None) -> tuple[BoolArray, Test] | None:
    """Return the points that agree with a polynomial, with all that they predict, and their test.

    The points are a mask (n,) of the control. Returns None where the points that agree are no clear
    majority: they are too few, or the points that disagree are no gross blunders.
    """
    agreeing = find_majority(control, halves)
    if agreeing is None:
        return None
    settled = _grow_majority(control, agreeing)
    if settled is None:
        return None
    used, test = settled
    # A field that few points leave free may follow blunders: then the polynomial has decided.
    by_field = _judge_by_field(control, used, test, MAX_MINORITY)
    for agreeing, test_of_agreeing in (by_field, settled):
        minority = ~agreeing
        if (MIN_MINORITY < minority.mean() <= MAX_MINORITY
                and is_outvoted(control, minority, test_of_agreeing)):
            return agreeing, test_of_agreeing
    return None


def _grow_majority(control: FitData, agreeing: BoolArray) -> tuple[BoolArray, Test] | None:
    """Return a mask (n,) of the points of a majority and those that it predicts, and their test.

    `agreeing` (n,) is the mask of the majority. The closest others are admitted bit by bit, until
    the noise jumps: among many admitted at once blunders hide each other. Points of the majority
    that it contradicts beyond chance are left out. Returns None where the majority itself is too
    small for a test.
    """
    n = len(control)
    used = agreeing
    settled = None
    least_noise = np.inf
    earlier_sets = set[bytes]()
    while used.tobytes() not in earlier_sets:
        earlier_sets.add(used.tobytes())
        test = Division(control, used).shrunken_test()
        # The majority has all that agree, not the closest ones: it shows the noise as it is.
        if test is None or test.noise > NOISE_JUMP * least_noise:
            break
        settled = used, test
        least_noise = min(least_noise, test.noise)
        far = test.beyond_chance(n)
        if (~far).sum() < n // 2:
            break
        closest = np.argsort(np.where(used | far, np.inf, test.strain), kind="stable")
        admitted = closest[:max(1, n // ADDED_PART)]
        next_used = used & ~far
        next_used[admitted[~(used | far)[admitted]]] = True
        used = next_used
    return settled


def agreement(control: FitData) -> BoolArray | None:
    """Return which of few points agree, (n,), where more than a third contradict the others.

    Returns None for MIN_POINTS points or more, which `find_blunders` decides about, and where no
    more than a third contradict.
    """
    # So few points may agree by chance: this warns, and nothing is left out for it.
    if len(control) >= MIN_POINTS:
        return None
    by_majority = _majority_and_test(control)
    return None if by_majority is None else by_majority[0]


def _judge_by_projection(control: FitData, auto: Auto,
                         used: BoolArray) -> tuple[BoolArray, Test] | None:
    """Return a mask of points in use (n,), and their test, by a projection or a known camera.

    Polynomials follow an oblique view so badly that their residuals hide blunders, and make sound
    points look like some. `used` (n,) is the mask to begin with. Returns None with lines, where the
    method chosen for the points in use is neither a central projection nor a known camera, and
    where it gives no test.
    """
    if len(control.features.lines):
        return None
    choice = auto.choose(control.take(used), with_contained=False)
    if choice is None:
        return None
    # A central projection is one only where its camera is found.
    has_camera = choice.method.central and choice.chosen.view is not None
    if not (has_camera or choice.method.judges_blunders):
        return None
    projection = choice.method

    def test_of(division: Division) -> Test | None:
        return division.test_by_projection(projection)

    everything = np.ones(len(control), dtype=bool)
    test_of_all = cache(lambda: test_of(Division(control, everything)))
    test = test_of_all()
    if test is not None and not _stands_out(test.errors):
        return everything, test
    core = _agreeing_core(control, test_of_all, test_of)
    return None if core is None else _readmit_predicted(control, *core, test_of_all, test_of)


def _stands_out(errors: FloatArray) -> bool:
    """Return whether the largest error is so far beyond the median that it may be a blunder."""
    # The median of the larger of two normal errors is 1.05 standard deviations.
    return bool(errors.max() > MIN_STRAIN * median_of(errors) / 1.05)


def _points_a_model_explains(control: FitData, auto: Auto, suspected: BoolArray) -> BoolArray:
    """Return a mask (n,) of the suspected points that a parametric model of all others predicts.

    `suspected` (n,) is a mask, too. With lines, and where the method chosen for the other points is
    not parametric, there are none.

    Polynomials and random fields follow an oblique view badly: what bends there is the image. A
    view that was fitted without the suspected points and predicts them shows that they are right.
    """
    cleared = np.zeros(len(control), dtype=bool)
    # Each cleared point helps the model, which may then clear further ones.
    while not len(control.features.lines) and (suspected & ~cleared).any():
        choice = auto.choose(control.take(~suspected | cleared), with_contained=False)
        if choice is None or not _is_parametric(choice.chosen):
            break
        further = suspected & ~cleared & _features_predicted_by(choice.chosen, control.features)
        if not further.any():
            break
        cleared |= further
    return cleared


def _is_parametric(fitted: Fit) -> bool:
    """Return whether a fit is by another model than the polynomials and fields of the tests."""
    return not (isinstance(fitted.estimator, Averaging)
                or isinstance(fitted.interpolation, GaussianProcess | PlaneAverage))


def _features_predicted_by(chosen: Fit, features: FeatureSet) -> BoolArray:
    """Return which features, (n,), a fit predicts as well as those that it was made with.

    With lines, an average of polynomials predicts no feature so: the test of the features was by
    the same average.
    """
    averaged = isinstance(chosen.estimator, Averaging)
    if len(features.lines) and averaged:  # the test was by the same polynomial
        return np.zeros(len(features), dtype=bool)
    # The sum of two squared normal variables of unit variance has the median 2 ln 2, so that the
    # standard deviation of the held-out errors is sqrt(median / (2 ln 2)).
    squares = chosen.held_out().squares
    bound = MIN_STRAIN * np.sqrt(median_of(squares) / (2 * np.log(2)))
    if _is_parametric(chosen):
        # The test was of another model than the chosen one.
        bound = max(bound, CLEAR_RATIO * np.sqrt(squares.max()))
    # The largest error of each feature: a blunder is mostly one of line or of sample alone.
    rows = np.abs(chosen.errors(features.points)).max(axis=1)
    if len(features.lines):
        # From each vertex straight to the computed line.
        vectors = chosen.line_errors(features.lines)
        rows = np.concatenate([rows, np.linalg.norm(vectors, axis=2).max(axis=1)])
    largest = np.zeros(len(features))
    np.maximum.at(largest, features.feature, rows)
    return np.asarray(largest <= bound)


def judge_others(chosen: Fit, heights: bool, other_points: Points,
                 memory: Memory) -> Suspects | None:
    """Return which points that took no part in a fit contradict its control and each other.

    Parameters
    ----------
    chosen : Fit
        The method that is chosen for control without blunders.
    heights : bool
        Whether heights of the control differ.
    other_points : Points
        Check and independent points.
    memory : Memory
        What was found before.

    Returns
    -------
    Suspects or None
        Of the other points alone; None without any, and if all are too few for a test.
    """
    control = chosen.control
    count = len(chosen.control.points)
    if not len(other_points):
        return None
    # One scaling for all, so that nobody is judged in another unit.
    all_features = FitData.of(control.with_(points=control.points.join(other_points)), heights)
    is_other = np.zeros(len(all_features), dtype=bool)
    is_other[count:count + len(other_points)] = True
    # Where control is scarce, the others show more than it does. They begin with those it predicts.
    used = ~is_other | _features_predicted_by(chosen, all_features.features)
    return memory.recall((is_other.tobytes(), used.tobytes()), all_features,
                         lambda: _contradicting_features(all_features, is_other, used))


def _contradicting_features(all_features: FitData, is_other: BoolArray,
                            used: BoolArray) -> Suspects | None:
    """Return which other features contradict the control, beginning with the features `used`.

    `is_other` (n,) marks the features that are not control. Returns None where even the core of all
    features is too small for a test.
    """
    test_of_all = cache(Division(all_features, ~np.zeros_like(is_other)).shrunken_test)
    # Where those in use are too few for a test, the core of all features is.
    test = Division(all_features, used).shrunken_test()
    core = _agreeing_core(all_features, test_of_all) if test is None else (used, test)
    if core is None:
        return None
    used, test = _judge_by_field(all_features,
                                 *_readmit_predicted(all_features, *core, test_of_all))
    blunders = is_other & ~used
    if not test.by_field:
        blunders &= ~_points_on_a_bend(all_features, used)
    decided = test.beyond_form()
    return test.suspects(blunders & decided, np.zeros_like(is_other), blunders & ~decided, is_other)


def _agreeing_core(control: FitData, test_of_all: TestOfAll,
                   test_of: TestOf = Division.shrunken_test) -> tuple[BoolArray, Test] | None:
    """Return a mask (n,) of features that agree, and their test; None if too few for a test.

    Of points, those with the largest strain are set aside in steps, and the others tested again
    after each, until MAX_BLUNDER_SHARE of all is gone or the others are too few for a test. With
    lines, which are many, those of `_agreeing_with_robust_fit` agree, found at once.
    """
    used = np.ones(len(control), dtype=bool)
    if len(control.features.lines):
        used = _agreeing_with_robust_fit(control, test_of_all)
        test = Division(control, used).shrunken_test() or test_of_all()
        return None if test is None else (used, test)
    test = test_of_all()
    if test is None:
        return None
    fewest_in_core = len(control) - int(MAX_BLUNDER_SHARE * len(control))
    while used.sum() > fewest_in_core:
        to_set_aside = int(used.sum()) - fewest_in_core
        # Large steps first, as the worst are clear; not too small ones last, as each costs a test.
        smallest_step = max(1, min(to_set_aside, int(MIN_STEP_SHARE * len(control))))
        count = max(smallest_step, int(STEP_SHARE * to_set_aside))
        worst = np.argsort(-np.where(used, test.strain, -1.0), kind="stable")[:count]
        fewer = used.copy()
        fewer[worst] = False
        test_of_fewer = test_of(Division(control, fewer))
        if test_of_fewer is None:
            break
        used = fewer
        test = test_of_fewer
    return used, test


def _agreeing_with_robust_fit(control: FitData, test_of_all: TestOfAll) -> BoolArray:
    """Return which features, a mask (n,), a robust quadratic polynomial keeps.

    Where it cannot be fitted, or rejects more than MAX_BLUNDER_SHARE of them, that share with the
    largest strain in the test of all is left out instead; all are kept if there is no such test.
    """
    is_rejected = _weightless(control)
    max_blunders = int(MAX_BLUNDER_SHARE * len(control))
    if is_rejected is not None and is_rejected.sum() <= max_blunders:
        return ~is_rejected
    # A robust fit fails if it finds more blunders than there may be: then the worst are taken.
    is_kept = np.ones(len(control), dtype=bool)
    test = test_of_all()
    if test is not None:
        is_kept[np.argsort(-test.strain, kind="stable")[:max_blunders]] = False
    return is_kept


def _weightless(control: FitData) -> BoolArray | None:
    """Return which features, (n,), have a row of weight 0 under a robust quadratic polynomial.

    Returns None if the features are too few for such a polynomial.
    """
    model = polynomial_of(control.heights, 2)
    equations = model.equations(control.scaled)
    # Without redundancy all residuals are 0, and so all weights 1.
    if len(equations.b) <= len(model.terms):
        return None
    # The biweight has weight 0 beyond its limit; others have only small ones.
    _, weights = reweighted(equations, biweight=True)
    weightless = np.zeros(len(control), dtype=bool)
    weightless[equations.feature[weights == 0]] = True
    return weightless


def _readmit_predicted(control: FitData, used: BoolArray, test: Test, test_of_all: TestOfAll,
                       test_of: TestOf = Division.shrunken_test) -> tuple[BoolArray, Test]:
    """Return a mask (n,) of the features in use, and their test, when no more come and go.

    Features that those in use predict are admitted again, those they no longer predict are left
    out. The mask `used` (n,) and its `test` are the start; `test_of_all` and `test_of` make the
    tests of all features and of others.
    """
    n = len(control)
    earlier_sets = set[bytes]()
    # A set of features that comes back would come back for ever.
    while used.tobytes() not in earlier_sets:
        earlier_sets.add(used.tobytes())
        still_out = ~used & test.beyond_chance(n) & test.beyond_form()
        if not used.all():
            strain = _strain_by_all_noise(test, used)
            chance = chance_of(strain**2, max(2 * int(used.sum()) - 8, 2))
            still_out &= (chance < FALSE_ALARM / n) & (strain > MIN_STRAIN)
        admissible = np.flatnonzero(~used & ~still_out)
        next_used = used.copy()
        if admissible.size:
            # Half of them at a time, the best first: they sharpen the next test.
            likeliest = admissible[np.argsort(test.strain[admissible], kind="stable")]
            next_used[likeliest[:max(1, admissible.size // 2, int(MIN_STEP_SHARE * n))]] = True
        else:
            # One at a time, the worst: it may be what makes the others look bad.
            blunders_in_use = np.flatnonzero(used & test.beyond_chance(n) & test.beyond_form())
            if blunders_in_use.size and (~used).sum() < int(MAX_BLUNDER_SHARE * n):
                next_used[blunders_in_use[np.argmax(test.strain[blunders_in_use])]] = False
        if (next_used == used).all():
            break
        next_test = test_of_all() if next_used.all() else test_of(Division(control, next_used))
        if next_test is None:
            break
        used = next_used
        test = next_test
    return used, test


def _strain_by_all_noise(test: Test, used: BoolArray) -> FloatArray:
    """Return the strain of each feature (n,) by the noise of all, of a test by a part of them.

    Those in use, the mask `used` (n,), are the ones that fit best.
    """
    # The closest features, a share p of all, understate the noise s. The squares X = r^2 / 2 s^2 of
    # their errors are exponential, and cut off at b = -log(1 - p), so that their mean is
    # E[X given X < b] = 1 - b (1 - p) / p instead of 1.
    p = used.sum() / len(used)
    bound = -np.log1p(-p)
    return np.asarray(test.strain * np.sqrt(1.0 - bound * (1.0 - p) / p))


def _points_on_a_bend(control: FitData, used: BoolArray) -> BoolArray:
    """Return a mask (n,) of the points out of use that a strong bend of the image explains.

    `used` (n,) is the mask of those in use. With lines there are none.

    A cubic polynomial is too stiff for a map of half the Earth: right points at its edge look like
    blunders. One that bends more, as far as the points in use support it, tells for each whether it
    is likelier right or a blunder. A point on a bend shows it to the next.
    """
    bent = np.zeros(len(control), dtype=bool)
    # One point after another: each that joins shows the bend farther out.
    is_open = not len(control.features.lines)
    while is_open and not (used | bent).all():
        division = Division(control, used | bent)
        point = next(filter(division.shows_bend_at, division.candidates_of_bend()), None)
        is_open = point is not None
        if point is not None:
            bent[point] = True
    return bent


def _points_of_a_deformation(control: FitData, used: BoolArray, suspected: BoolArray,
                             test: Test) -> BoolArray:
    """Return a mask (n,) of suspected points out of use that a deformation may explain.

    `used` and `suspected` (n,) are masks, too. With lines there are none.

    Nothing contradicts a point that lies alone but the form of the model: at the corner of a map
    that is distorted, a right point looks like a blunder. Neighbours that deviate alike show a
    deformation to each other. A field follows a deformation, so that the noise of the others
    remains; with a blunder in use it would grow, and hide further ones.
    """
    doubtful = np.zeros(len(control), dtype=bool)
    is_open = suspected & ~used & (test.strain < DOUBTFUL_STRAIN)
    if len(control.features.lines):
        return doubtful

    def may_return(point: int) -> bool:
        extended = used | doubtful
        if not Division(control, extended).may_show_deformation(point):
            return False
        extended[point] = True
        test_with_point = Division(control, extended).test()
        return test_with_point is not None and test_with_point.noise <= NOISE_JUMP * test.noise

    # A point that returns may help its neighbours.
    while is_open.any():
        likeliest = np.argsort(np.where(is_open, test.strain, np.inf), kind="stable")
        point = next(filter(may_return, likeliest[:int(is_open.sum())].tolist()), None)
        if point is None:
            break
        doubtful[point] = True
        is_open[point] = False
    return doubtful


def _judge_by_field(control: FitData, used: BoolArray, test: Test,
                    max_share: float = MAX_BLUNDER_SHARE) -> tuple[BoolArray, Test]:
    """Return a mask (n,) of the features in use, and their test, judged again by a random field.

    Under a field local deformation is no blunder, and an error may be one though a polynomial
    leaves as much elsewhere. `used` (n,) and `test` are those to begin with. Rounds end where a set
    comes again, the points support no field, or more than `max_share` of them are out of use; what
    the last round has found is returned, or both as given if there is none.
    """
    n = len(control)
    earlier_sets = set[bytes]()
    while used.tobytes() not in earlier_sets and (~used).sum() <= max_share * n:
        earlier_sets.add(used.tobytes())
        field_test = Division(control, used).local_test()
        if field_test is None:
            break
        test = field_test
        far = test.beyond_chance(n) & test.beyond_form()
        # The worst ones together, down to half of the largest strain.
        excluded = used & far & (test.strain
                                 >= np.max(test.strain, where=used & far, initial=0.0) / 2)
        used = (used & ~excluded) | (~used & ~far)
    return used, test
