"""Blunders among the features of the strategy "auto": named, left out, and told in notes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from termsel.candidates.base import Judged
from termsel.candidates.blunders import MOST, find_blunders, judge_others
from termsel.candidates.contradictions import Division, Suspects
from termsel.candidates.portfolio import Portfolio
from termsel.measurements.control import MEASURED, Control, off_plane
from termsel.measurements.features import BoolArray, FeatureSet, Points, select
from termsel.measurements.roles import Observations, leave_out
from termsel.measurements.twins import with_twins
from termsel.record.base import Role
from termsel.record.figures import Outlier

FEW = 17
"""Number of points below which a note says what errors cannot be found."""


def without_blunders(observations: Observations, portfolio: Portfolio,
                     ) -> tuple[Observations, list[Outlier], list[str]]:
    """Return the observations without blunders, the outliers and what is to be said of them.

    Control and check points and lines are judged; independent points take no part. Features whose
    height alone is off a plane are no blunders, but what it does to them would spoil a plane model.
    """
    observations, high, of_heights = _without_carriers(observations)
    both = observations.pool.features
    found = find_blunders(observations.pool, portfolio)
    if found is None:
        return observations, high, of_heights
    outliers = [_outlier(both.ids[i], observations, float(found.errors[i]),
                         excluded=bool(found.blunders[i]))
                for i in _worst_first(found, found.blunders | found.undecided)]
    points = found.blunders[:len(both.points)]
    left = leave_out(observations, [
        *with_twins(observations.together.points, select(both.points.ids, points)),
        *select(both.lines.features, found.blunders[len(both.points):])])
    return left, [*high, *outliers], [*of_heights, *_notes(both, found)]


def _without_carriers(observations: Observations,
                      ) -> tuple[Observations, list[Outlier], list[str]]:
    """Return the observations without features that alone are off a plane, and what is said."""
    names = with_twins(observations.together.points, observations.carriers).union(
        observations.carriers)
    both = observations.pool.features
    used = ~np.isin(both.ids, list(names))
    test = None if used.all() else Division(observations.pool, used).test()
    if test is None:
        return observations, [], []
    found = [_outlier(both.ids[i], observations, float(test.errors[i]), excluded=True)
             for i in np.flatnonzero(~used)]
    listed = ", ".join(f"{one.id} ({one.error:.3g} px)" for one in found)
    return leave_out(observations, names), found, [
        f"Left out for {'its height' if len(found) == 1 else 'their heights'}: {listed}."]


def _outlier(name: str, observations: Observations, error: float, *, excluded: bool) -> Outlier:
    role: Role = "check" if name in observations.check.ids else "control"
    line = name in observations.control.lines.features
    return Outlier(name, "line" if line else "point", role, error, excluded)


def judged_independent(points: Points, heights: bool,
                       chosen: Judged) -> tuple[list[Outlier], list[str]]:
    """Return independent points that contradict all others, and what is to be said of them.

    They stay in every figure; the note gives the one without them. `chosen` is the choice for
    control and check without blunders.
    """
    # Where nothing tells what a height does, it contradicts nothing.
    points = points.take(off_plane(
        Control.of(chosen.fit.control, heights), points.ground)[1] <= MEASURED)
    found = judge_others(chosen, heights, points)
    if found is None or not found.blunders.any():
        return [], []
    if found.blunders.mean() > MOST:
        return [], [f"{int(found.blunders.sum())} of {len(points)} independent points contradict "
                    "control and check. Either they were measured differently, or the model does "
                    "not hold at their places."]
    outliers = [Outlier(points.ids[i], "point", "independent", float(found.errors[i]), False)
                for i in _worst_first(found, found.blunders)]
    others = chosen.fit.rmse(points.take(~found.blunders))
    assert others is not None  # they are at least as many
    return outliers, ["Independent points that contradict all others: "
                      f"{_named(points.ids, found, found.blunders)}; without them the independent "
                      f"RMSE is {others.total:.3g} px."]


def _worst_first(found: Suspects, which: BoolArray) -> list[int]:
    return [int(i) for i in np.argsort(-found.errors, kind="stable") if which[i]]


def _named(ids: tuple[str, ...], found: Suspects, which: BoolArray) -> str:
    return ", ".join(f"{ids[i]} ({found.errors[i]:.3g} px)"
                     for i in _worst_first(found, which))


def _notes(control: FeatureSet, found: Suspects) -> Iterator[str]:
    what = control.word
    brackets = f"In brackets: how far the other {what} predict them from where they were measured."
    certain = found.blunders & ~found.probable
    if certain.any():
        yield (f"Left out as blunders: {_named(control.ids, found, certain)}. {brackets}")
    if found.probable.any():
        yield (f"Left out as probable blunders: {_named(control.ids, found, found.probable)}. They "
               "are more likely wrong than right, but not for certain. Look at them in the image."
               f"{'' if certain.any() else f' {brackets}'}")
    if found.undecided.any():
        yield (f"Perhaps blunders, still in use: {_named(control.ids, found, found.undecided)}. "
               f"The other {what} are too few or too far to tell.")
    if len(control) < FEW:
        worst, half = int(np.argmax(found.limits)), float(np.median(found.limits))
        if half > np.ptp(control.image_vertices(), axis=0).max():
            yield f"With {len(control)} {what} no blunder can be found for certain: any may be one."
            return
        yield (f"With {len(control)} {what} an error must exceed {_size(half)} px to be found for "
               f"certain at half of them, and {_size(found.limits[worst])} px at "
               f"{control.ids[worst]}.")


def _size(error: float) -> str:
    return f"{error:.2g}" if error < 100 else f"{error:,.0f}"
