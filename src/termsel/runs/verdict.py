"""The outlier test, one for every run: which features contradict all others.

Control and check features are judged before a run, which may do without blunders; independent
points once all is chosen, as they take no part in any choice.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np
from msgspec.structs import replace as changed

from termsel.auto.auto import Auto
from termsel.auto.blunders import agreement, find_blunders, judge_others
from termsel.auto.contradictions import Division
from termsel.auto.majority import MAX_BLUNDER_SHARE
from termsel.auto.rule import Choice, method_of
from termsel.data.features import FeatureSet, FloatArray, IntArray, Points, select
from termsel.data.fit_data import MEASURED, FitData, distance_off_plane
from termsel.data.record.cautions import CONTRADICT, EXCHANGED, UNLIKE_CONTROL
from termsel.data.record.chances import median_of
from termsel.data.record.figures import BlunderTest, Outlier, Role
from termsel.data.roles import Observations, leave_out, with_twins
from termsel.fitting.figures import finite_or_none
from termsel.fitting.fit import Fit
from termsel.fitting.method import Suspects

# Points that no view of a plane shows as they are: exchanged, or one of them wrong.
#
# Seen from above, a plane keeps the turning of all triangles of its points, or reverses all of them
# in a mirrored image; so does any view of it whose points lie in front of the camera. Few points
# show no blunder by their errors, but single triangles that are reversed do.

MIN_EXCHANGED_POINTS, MAX_EXCHANGED_POINTS = 4, 12
"""Numbers of points that are looked at: of more, errors show."""

THIN = 0.05
"""Height of a triangle, by the extent of all points, up to which it may be reversed by errors."""


@dataclass(frozen=True)
class Exchange:
    """Points that may be wrong, by their indices, and whether two are likely exchanged."""

    points: tuple[int, ...]
    is_pair: bool


def exchange_of(control: FitData) -> Exchange | None:
    """Return which points reverse single triangles of a plane; None if none does, or of hills.

    Seen from above, all triangles of a plane turn in one direction, or with a mirrored image in the
    other. Where single ones turn differently, two points are exchanged or one is wrong. Each
    exchange and each omission that makes all triangles agree is tried, and the one with the
    smallest residual of an affine fit is named; if there is none, all points are. With hills, or
    with many points, triangles show nothing.
    """
    count = len(control.features.points)
    if (control.heights or len(control.features.lines)
            or not MIN_EXCHANGED_POINTS <= count <= MAX_EXCHANGED_POINTS):
        return None
    points = control.scaled.points
    ground = points.ground[:, :2]
    image = points.image
    if not _are_mixed(_turning_products(ground, image)):
        return None
    # What would make the plane a view again: two points exchanged, or one left out; the affine
    # residual of the rest decides among several.
    repairs: list[tuple[float, Exchange]] = []
    for pair in combinations(range(count), 2):
        # The image coordinates of the two are exchanged.
        order = np.arange(count)
        order[list(pair)] = pair[::-1]
        turnings = _turning_products(ground, image[order])
        if not _are_mixed(turnings):
            # A mirrored image is rare.
            mirrored = 1e3 if (turnings > 0).any() else 1.0
            repairs.append((mirrored * _affine_residuals(ground, image[order]),
                            Exchange(pair, True)))
    for wrong in range(count) if count > MIN_EXCHANGED_POINTS else ():
        remaining = np.delete(np.arange(count), wrong)
        if not _are_mixed(_turning_products(ground[remaining], image[remaining])):
            repairs.append((_affine_residuals(ground[remaining], image[remaining]),
                            Exchange((wrong,), False)))
    if repairs:
        return min(repairs, key=lambda repair: repair[0])[1]
    return Exchange(tuple(range(count)), False)


def errors_by_others(control: FitData) -> FloatArray:
    """Return the error (n,) [px] of each point, as the affine fit of all others predicts it."""
    points = control.scaled.points
    columns = np.column_stack([np.ones(len(points)), points.ground[:, :2]])
    errors = np.empty(len(points))
    for i in range(len(points)):
        is_other = np.arange(len(points)) != i
        # Each point by a fit of its own, as few points leave little redundancy.
        affine = np.linalg.lstsq(columns[is_other], points.image[is_other])[0]
        errors[i] = np.linalg.norm(points.image[i] - columns[i] @ affine)
    return errors * control.scaling.image_scale


def _turning_products(ground: FloatArray, image: FloatArray) -> IntArray:
    """Return for all triangles (t,) of points the sense in the image times that on the ground.

    A sense is 1 (counter-clockwise) or -1, and 0 for a thin triangle. The image has x = sample and
    y = line. Lines count downwards, so that an image that is not mirrored has -1.
    """
    triangles = np.array(list(combinations(range(len(ground)), 3)))
    on_ground = _turning_sign(ground[triangles])
    in_image = _turning_sign(image[triangles][..., ::-1])
    return np.asarray(on_ground * in_image, dtype=np.intp)


def _turning_sign(corners: FloatArray) -> FloatArray:
    """Return by which sign triangles (n, 3, 2) turn; 0 of thin ones."""
    first = corners[:, 1] - corners[:, 0]
    second = corners[:, 2] - corners[:, 0]
    # Twice the signed area; by the longest side it is the height of the triangle.
    double = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    lengths = np.linalg.norm(np.stack([first, second, second - first]), axis=2)
    extent = np.ptp(corners.reshape(-1, 2), axis=0).max()
    thick = np.abs(double) > THIN * extent * lengths.max(axis=0)
    return np.where(thick, np.sign(double), 0.0)


def _are_mixed(turnings: IntArray) -> bool:
    """Return whether triangles turn in both directions."""
    return bool((turnings > 0).any() and (turnings < 0).any())


def _affine_residuals(ground: FloatArray, image: FloatArray) -> float:
    """Return the standard deviation of image places about an affine transformation."""
    columns = np.column_stack([np.ones(len(ground)), ground])
    residuals = image - columns @ np.linalg.lstsq(columns, image)[0]
    return float(np.sqrt((residuals**2).sum() / max(2 * len(ground) - 6, 1)))


UNSEEN = 0.1
"""Error in the image that nobody can see, so that it makes no feature a blunder [px]."""

UNLIKELY_DEVIATIONS = 2.3
"""Standard deviations by which blunders among independent points may be more than expected: with a
chance of a hundredth they are."""

MIN_TESTED_FEATURES = 17
"""Number of features below which a note says what errors cannot be found."""


@dataclass(frozen=True, eq=False)
class Verdict:
    """Features that contradict all others, the worst first, and what the test could not find.

    `blunders` are the ids of those that are certainly or probably wrong, with their twins; `high`
    of those whose height alone is off a plane, which are no blunders but would spoil a plane model;
    `test` what could be found, None where no test was made.
    """

    outliers: tuple[Outlier, ...] = ()
    blunders: frozenset[str] = frozenset()
    high: frozenset[str] = frozenset()
    notes: tuple[str, ...] = ()
    test: BlunderTest | None = None

    def without(self, in_use: Collection[str]) -> tuple[Outlier, ...]:
        """Return the outliers, as excluded those that are not in use."""
        return tuple(changed(outlier, excluded=outlier.id not in in_use)
                     for outlier in self.outliers)


def judge_features(observations: Observations, auto: Auto, tested: bool | None = None) -> Verdict:
    """Return the verdict on control and check features.

    It is an empty one if they were tested before, and of a lattice, whose points were computed.
    """
    # Points of a lattice are computed by a processor, and none of them is mistyped.
    if tested or observations.lattice is not None:
        return Verdict()
    roles: dict[str, Role] = dict.fromkeys(observations.together.ids, "control")
    roles.update(dict.fromkeys(observations.check.ids, "check"))
    points = observations.together.points
    carriers = observations.carriers
    if auto.fewest(observations.pool) == 1:
        carriers = ()  # what is known of the image says what heights do
    # Relief that rests on one or two features cannot be distinguished from their errors.
    high = with_twins(points, carriers).union(carriers)
    # Where no plane is determined without them, they are judged like others.
    if off_plane_outliers := _features_off_plane(observations, roles, high):
        observations = leave_out(observations, high)
    verdict = Verdict(off_plane_outliers, high=high if off_plane_outliers else frozenset())
    pool = observations.pool
    features = pool.features
    suspects = _visible_suspects(auto.suspects(pool) or find_blunders(pool, auto))
    # The median over features of the error that would be named, for the record.
    limit = None if suspects is None else finite_or_none(float(median_of(suspects.limits)))
    verdict = replace(verdict, test=BlunderTest(
        len(features), limit, float(np.ptp(features.image_vertices(), axis=0).max())))
    if suspects is None or not (suspects.blunders | suspects.undecided).any():
        # Few points determine so much that the test finds nothing; the orientation of their
        # triangles still shows two exchanged points.
        exchange = exchange_of(pool)
        if exchange is not None:
            unlike_any_view = _blunders_by_view(pool, exchange, roles)
            return replace(verdict, outliers=(*off_plane_outliers, *unlike_any_view),
                           notes=(_note_on_exchange(features, exchange),))
    if suspects is None:
        return verdict
    wrong = select(features.ids, suspects.blunders)
    return replace(verdict,
                   outliers=(*off_plane_outliers, *_sorted_outliers(features, roles, suspects)),
                   blunders=with_twins(points, wrong).union(wrong),
                   notes=(*_note_on_contradictions(pool, suspects),
                          *_limits_of_detection(features, suspects)))


def _note_on_contradictions(pool: FitData, suspects: Suspects) -> Iterator[str]:
    """Yield advice if about half of the points contradict the others, but all are too few."""
    agreeing = agreement(pool)
    if agreeing is None or (~agreeing <= suspects.blunders).all():
        return
    yield (f"The points{CONTRADICT}{int(agreeing.sum())} of {len(pool)} agree, and "
           "all are too few to show which are wrong. Look at "
           f"{', '.join(select(pool.features.ids, ~agreeing))} in the image.")


def _visible_suspects(suspects: Suspects | None) -> Suspects | None:
    """Return suspects without those whose errors are too small to be measured.

    Returns None if `suspects` is None.
    """
    if suspects is None:
        return None
    is_visible = suspects.errors > UNSEEN
    return replace(suspects, blunders=suspects.blunders & is_visible,
                   probable=suspects.probable & is_visible,
                   undecided=suspects.undecided & is_visible)


def _blunders_by_view(pool: FitData, exchange: Exchange,
                      roles: dict[str, Role]) -> tuple[Outlier, ...]:
    """Return the points that reverse triangles, or are exchanged, as possible blunders."""
    errors = errors_by_others(pool)
    is_wrong = np.zeros(len(pool), dtype=bool)
    is_named = is_wrong.copy()
    is_named[list(exchange.points)] = True
    return _sorted_outliers(pool.features, roles,
                            Suspects(is_wrong, is_wrong, is_named, errors, errors))


def _note_on_exchange(features: FeatureSet, exchange: Exchange) -> str:
    """Return a note on which points are wrong or exchanged, and the reason."""
    ids = [features.ids[i] for i in exchange.points]
    reason = f"{EXCHANGED} of points and others not, as these do"
    if exchange.is_pair:
        return (f"{ids[0]} and {ids[1]} are likely exchanged: {reason}. With the image place of "
                "each at the other one, all triangles agree. Exchange them, and run again.")
    if len(ids) == 1:
        return f"{ids[0]} is likely wrong: {reason}, but for it. Look at it in the image."
    return (f"At least one of {', '.join(ids)} is wrong, or two are exchanged: {reason}. Look at "
            "them in the image.")


def _features_off_plane(observations: Observations, roles: dict[str, Role],
                        high: frozenset[str]) -> tuple[Outlier, ...]:
    """Return features whose height alone is off a plane, as the others predict them."""
    features = observations.pool.features
    is_high = np.isin(features.ids, list(high))
    test = Division(observations.pool, ~is_high).test() if is_high.any() else None
    if test is None:
        return ()
    is_wrong = np.zeros_like(is_high)
    return _sorted_outliers(features, roles,
                            Suspects(is_wrong, is_wrong, is_high, test.errors, test.errors))


def judge_independent(observations: Observations, choice: Choice | None, auto: Auto,
                      of_others: Verdict | None = None) -> tuple[Verdict, Observations]:
    """Return the verdict on independent points, and the observations without its blunders.

    Blunders stay in all figures; figures without them are given next to these. `choice` is the
    choice of a method from control and check without blunders. Where the chosen model knows the
    image beforehand, as a vendor's RPC does, it knows of a single point whether it is wrong.
    `of_others` is the verdict on control and check: where more than a third of these are blunders,
    as many may be among the independent points.
    """
    points = observations.independent
    suspects = None
    if observations.lattice is not None:
        return Verdict(), observations
    if choice is None:
        by_geometry = None
    else:
        by_geometry = _contradicting_known_image(choice.chosen, points, observations.heights, auto)
    if by_geometry is not None:
        suspects = by_geometry
    elif choice is not None:
        if not choice.method.from_one:
            # Where nothing shows what a height does, it contradicts nothing.
            control = FitData.of(choice.chosen.control, observations.heights)
            points = points.take(distance_off_plane(control, points.ground)[1] <= MEASURED)
        suspects = judge_others(choice.chosen, observations.heights, points, auto.memory)
    suspects = _visible_suspects(suspects)
    if suspects is None or not suspects.blunders.any():
        return Verdict(), observations
    # Where most contradict the model it is the model, or their datum, that is in doubt.
    if suspects.blunders.sum() > _limit_of_blunders(len(points), of_others) and by_geometry is None:
        count = int(suspects.blunders.sum())
        subject = ("The independent check point contradicts" if len(points) == 1 else
                   f"{count} of {len(points)} independent check points contradict")
        return Verdict(notes=(
            f"{subject}{UNLIKE_CONTROL}{'it was' if len(points) == 1 else 'they were'} "
            "measured differently, or the model does not hold there.",)), observations
    wrong = frozenset(select(points.ids, suspects.blunders))
    # Independent points are blunders or not: nothing is chosen that would leave it open.
    decided = replace(suspects, undecided=np.zeros_like(suspects.undecided))
    outliers = _sorted_outliers(
        FeatureSet(points), dict.fromkeys(points.ids, "independent"), decided)
    independent = observations.independent
    return Verdict(outliers, wrong), replace(
        observations, independent=independent.take([name not in wrong for name in independent.ids]))


def _limit_of_blunders(count: int, of_others: Verdict | None) -> float:
    """Return how many of some points may be blunders, before the model is in doubt.

    That is a third of them, or as many as are likely where more than a third of the other points
    are blunders.
    """
    most = MAX_BLUNDER_SHARE * count
    if of_others is None or of_others.test is None:
        return most
    share = len(of_others.blunders) / of_others.test.features
    if share <= MAX_BLUNDER_SHARE:
        return most
    return count * share + UNLIKELY_DEVIATIONS * float(np.sqrt(count * share * (1.0 - share)))


def _contradicting_known_image(fitted: Fit, points: Points, heights: bool,
                               auto: Auto) -> Suspects | None:
    """Return the other points that contradict the known image of the chosen model.

    Returns None if the model has none, or there are no such points.
    """
    if not method_of(fitted).from_one or not len(points):
        return None
    control = fitted.control
    data = FitData.of(control.with_(points=control.points.join(points)), heights)
    suspects: Suspects | None = auto.ask(method_of(fitted), "suspects", data)
    if suspects is None:
        return None
    # Suspects of control come first; they had their verdict before the choice.
    of_points = slice(len(control.points), len(control.points) + len(points))
    return Suspects(suspects.blunders[of_points], suspects.probable[of_points],
                    suspects.undecided[of_points], suspects.errors[of_points],
                    suspects.limits[of_points])


def _sorted_outliers(features: FeatureSet, roles: dict[str, Role],
                     suspects: Suspects) -> tuple[Outlier, ...]:
    """Return the suspects among features as outliers of the record, the largest error first.

    `roles` gives the role of each feature by its id. No outlier is marked as excluded.
    """
    lines = frozenset(features.lines.features)
    is_outlier = suspects.blunders | suspects.undecided
    outliers = []
    for i in np.argsort(-suspects.errors, kind="stable").tolist():
        if not is_outlier[i]:
            continue
        name = features.ids[i]
        if suspects.undecided[i]:
            certainty: Literal["certain", "probable", "possible"] = "possible"
        elif suspects.probable[i]:
            certainty = "probable"
        else:
            certainty = "certain"
        outliers.append(Outlier(name, "line" if name in lines else "point", roles[name],
                                float(suspects.errors[i]), certainty, excluded=False))
    return tuple(outliers)


def _limits_of_detection(features: FeatureSet, suspects: Suspects) -> Iterator[str]:
    """Yield which errors cannot be found, where features are few."""
    # With many features the limits are a few noise levels: nothing to warn of.
    if len(features) >= MIN_TESTED_FEATURES:
        return
    index = int(np.argmax(suspects.limits))
    median_limit = float(median_of(suspects.limits))
    extent = float(np.ptp(features.image_vertices(), axis=0).max())
    if median_limit > extent:
        yield (f"With {len(features)} {features.word} no blunder can be found for certain: any "
               "may be one.")
        return
    at_worst = (f"{_size_text(suspects.limits[index])} px at {features.ids[index]}"
                if suspects.limits[index] <= extent else
                f"at {features.ids[index]} none can be found for certain")
    yield (f"With {len(features)} {features.word} an error must exceed {_size_text(median_limit)} "
           f"px to be found for certain at half of them, and {at_worst}.")


def _size_text(error: float) -> str:
    """Return an error to two digits, with commas from 100 on."""
    return f"{error:.2g}" if error < 100 else f"{error:,.0f}"
