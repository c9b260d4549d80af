"""The outlier test, one for every run: which features contradict all others.

Control and check features are judged before a run, which may do without blunders; independent
points once all is chosen, as they take no part in any choice.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace

import numpy as np
from msgspec.structs import replace as changed

from termsel.auto.auto import Auto
from termsel.auto.blunders import MOST, find_blunders, judge_others
from termsel.auto.contradictions import Division
from termsel.auto.rule import Choice, method_of
from termsel.data.exchanged import Exchange, errors_by_others, exchange_of
from termsel.data.features import FeatureSet, Points, select
from termsel.data.fit_data import MEASURED, FitData, off_plane
from termsel.data.record.base import Role
from termsel.data.record.chances import median
from termsel.data.record.figures import BlunderTest, Outlier
from termsel.data.roles import Observations, leave_out
from termsel.data.twins import with_twins
from termsel.fitting.figures import finite_or_none
from termsel.fitting.fit import Fit
from termsel.fitting.method import Suspects

UNSEEN = 0.1
"""Error in the image that nobody can see, so that it makes no feature a blunder [px]."""

FEW = 17
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
        return tuple(changed(one, excluded=one.id not in in_use) for one in self.outliers)


def judge_features(observations: Observations, auto: Auto,
                   tested: bool | None = None) -> Verdict:
    """Return the verdict on control and check features.

    It is an empty one if they were tested before, and of a lattice, whose points were computed.
    """
    if tested or observations.lattice is not None:
        return Verdict()
    roles: dict[str, Role] = dict.fromkeys(observations.together.ids, "control")
    roles.update(dict.fromkeys(observations.check.ids, "check"))
    points, carriers = observations.together.points, observations.carriers
    if auto.fewest(observations.pool) == 1:
        carriers = ()  # what is known of the image says what heights do
    high = with_twins(points, carriers).union(carriers)
    # Where no plane is determined without them, they are judged like others.
    if held := _held_against_others(observations, roles, high):
        observations = leave_out(observations, high)
    verdict = Verdict(held, high=high if held else frozenset())
    both, pool = observations.pool.features, observations.pool
    found = _that_can_be_seen(auto.suspects(pool) or find_blunders(pool, auto))
    limit = None if found is None else finite_or_none(float(median(found.limits)))
    verdict = replace(verdict, test=BlunderTest(
        len(both), limit, float(np.ptp(both.image_vertices(), axis=0).max())))
    if found is None or not (found.blunders | found.undecided).any():
        exchange = exchange_of(pool)
        if exchange is not None:
            return replace(verdict, outliers=(*held, *_unlike_any_view(pool, exchange, roles)),
                           notes=(_on_exchange(both, exchange),))
    if found is None:
        return verdict
    wrong = select(both.ids, found.blunders)
    return replace(verdict, outliers=(*held, *_outliers(both, roles, found)),
                   blunders=with_twins(points, wrong).union(wrong),
                   notes=tuple(_limits(both, found)))


def _that_can_be_seen(found: Suspects | None) -> Suspects | None:
    """Return suspects without those whose errors are too small to be measured."""
    if found is None:
        return None
    seen = found.errors > UNSEEN
    return replace(found, blunders=found.blunders & seen, probable=found.probable & seen,
                   undecided=found.undecided & seen)


def _unlike_any_view(pool: FitData, exchange: Exchange,
                     roles: dict[str, Role]) -> tuple[Outlier, ...]:
    """Return the points that reverse triangles, or are exchanged, as possible blunders."""
    errors = errors_by_others(pool)
    which, nothing = np.zeros(len(pool), dtype=bool), np.zeros(len(pool), dtype=bool)
    which[list(exchange.points)] = True
    return _outliers(pool.features, roles, Suspects(nothing, nothing, which, errors, errors))


def _on_exchange(both: FeatureSet, exchange: Exchange) -> str:
    """Return what tells that points are wrong, and which."""
    named = [both.ids[i] for i in exchange.points]
    said = "No view of a plane reverses some triangles of points and others not, as these do"
    if exchange.is_pair:
        return (f"{said}. {named[0]} and {named[1]} are likely exchanged: with the image place of "
                "each at the other one, all triangles agree. Exchange them, and run again.")
    if len(named) == 1:
        return f"{said}, but for {named[0]}: look at it in the image."
    return (f"{said}. At least one of {', '.join(named)} is wrong, or two are exchanged: look at "
            "them in the image.")


def _held_against_others(observations: Observations, roles: dict[str, Role],
                         high: frozenset[str]) -> tuple[Outlier, ...]:
    """Return features whose height alone is off a plane, as the others predict them."""
    both = observations.pool.features
    which = np.isin(both.ids, list(high))
    test = Division(observations.pool, ~which).test() if which.any() else None
    if test is None:
        return ()
    nothing = np.zeros_like(which)
    return _outliers(both, roles, Suspects(nothing, nothing, which, test.errors, test.errors))


def judge_independent(observations: Observations, choice: Choice | None,
                      auto: Auto) -> tuple[Verdict, Observations]:
    """Return the verdict on independent points, and the observations without its blunders.

    They stay in all figures, next to which those without them are given. `choice` is that of
    control and check without blunders, from a portfolio: where the chosen model knows the image
    beforehand, as a vendor's RPC does, it knows of a single point whether it is wrong.
    """
    points = observations.independent
    found = None
    if observations.lattice is not None:
        return Verdict(), observations
    known = None if choice is None else \
        _by_what_is_known(choice.chosen, points, observations.heights, auto)
    if known is not None:
        found = known
    elif choice is not None:
        if not choice.method.from_one:
            # Where nothing tells what a height does, it contradicts nothing.
            control = FitData.of(choice.chosen.control, observations.heights)
            points = points.take(off_plane(control, points.ground)[1] <= MEASURED)
        found = judge_others(choice.chosen, observations.heights, points, auto.memory)
    found = _that_can_be_seen(found)
    if found is None or not found.blunders.any():
        return Verdict(), observations
    if found.blunders.mean() > MOST and known is None:
        said = ("The independent check point contradicts" if len(points) == 1 else
                f"{int(found.blunders.sum())} of {len(points)} independent check points contradict")
        return Verdict(notes=(
            f"{said} control and check. Either {'it was' if len(points) == 1 else 'they were'} "
            "measured differently, or the model does not hold there.",)), observations
    wrong = frozenset(select(points.ids, found.blunders))
    decided = replace(found, undecided=np.zeros_like(found.undecided))
    outliers = _outliers(FeatureSet(points), dict.fromkeys(points.ids, "independent"), decided)
    rest = observations.independent
    return Verdict(outliers, wrong), replace(
        observations, independent=rest.take([name not in wrong for name in rest.ids]))


def _by_what_is_known(chosen: Fit, others: Points, heights: bool,
                      auto: Auto) -> Suspects | None:
    """Return which other points contradict what the chosen model knows of the image, if it does."""
    if not method_of(chosen).from_one or not len(others):
        return None
    control = chosen.control
    every = FitData.of(control.with_(points=control.points.join(others)), heights)
    found: Suspects | None = auto.ask(method_of(chosen), "suspects", every)
    if found is None:
        return None
    mine = slice(len(control.points), len(control.points) + len(others))
    return Suspects(found.blunders[mine], found.probable[mine], found.undecided[mine],
                    found.errors[mine], found.limits[mine])


def _outliers(features: FeatureSet, roles: dict[str, Role],
              found: Suspects) -> tuple[Outlier, ...]:
    """Return what is found of features, the worst first; nothing is excluded."""
    lines = frozenset(features.lines.features)
    which = found.blunders | found.undecided
    return tuple(
        Outlier(name, "line" if name in lines else "point", roles[name], float(found.errors[i]),
                "possible" if found.undecided[i] else
                "probable" if found.probable[i] else "certain", False)
        for i in np.argsort(-found.errors, kind="stable").tolist() if which[i]
        for name in (features.ids[i],))


def _limits(both: FeatureSet, found: Suspects) -> Iterator[str]:
    """Yield which errors cannot be found, where features are few."""
    if len(both) >= FEW:
        return
    worst, half = int(np.argmax(found.limits)), float(median(found.limits))
    extent = float(np.ptp(both.image_vertices(), axis=0).max())
    if half > extent:
        yield (f"With {len(both)} {both.word} no blunder can be found for certain: any may be "
               "one.")
        return
    at_worst = (f"{_size(found.limits[worst])} px at {both.ids[worst]}"
                if found.limits[worst] <= extent else
                f"at {both.ids[worst]} none can be found for certain")
    yield (f"With {len(both)} {both.word} an error must exceed {_size(half)} px to be found for "
           f"certain at half of them, and {at_worst}.")


def _size(error: float) -> str:
    return f"{error:.2g}" if error < 100 else f"{error:,.0f}"
