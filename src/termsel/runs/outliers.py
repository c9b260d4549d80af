"""Blunders among the points of the strategy "auto": named, left out, and told in notes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from termsel.candidates.blunders import MOST, Suspects, find_blunders, judge_others
from termsel.candidates.portfolio import Judged
from termsel.measurements.features import BoolArray, Points, select
from termsel.measurements.roles import Observations, leave_out, together
from termsel.measurements.twins import merged, with_twins
from termsel.results.result import Outlier

FEW = 17
"""Number of points below which a note says what errors cannot be found."""


def without_blunders(observations: Observations,
                     heights: bool) -> tuple[Observations, list[Outlier], list[str]]:
    """Return the observations without blunders, the outliers and what is to be said of them.

    Control and check points are judged; independent points take no part.

    Parameters
    ----------
    observations : Observations
    heights : bool
        Whether heights are known and differ.
    """
    both = merged(together(observations))
    found = find_blunders(both, heights)
    if found is None:
        return observations, [], []
    role = dict.fromkeys(observations.control.points.ids, "control")
    outliers = [Outlier(both.points.ids[i], "point", role.get(both.points.ids[i], "check"),
                        float(found.errors[i]), bool(found.blunders[i]))
                for i in _worst_first(found, found.blunders | found.undecided)]
    left = leave_out(observations, with_twins(together(observations).points,
                                              select(both.points.ids, found.blunders)))
    return left, outliers, list(_notes(both.points, found))


def judged_independent(points: Points, heights: bool,
                       chosen: Judged) -> tuple[list[Outlier], list[str]]:
    """Return independent points that contradict all others, and what is to be said of them.

    They stay in every figure; the note gives the one without them.

    Parameters
    ----------
    points : Points
        The independent ones.
    heights : bool
    chosen : Judged
        The choice for control and check without blunders.
    """
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
                      f"{_named(points, found, found.blunders)}; without them the independent "
                      f"RMSE is {others.total:.3g} px."]


def _worst_first(found: Suspects, which: BoolArray) -> list[int]:
    return [int(i) for i in np.argsort(-found.errors, kind="stable") if which[i]]


def _named(points: Points, found: Suspects, which: BoolArray) -> str:
    return ", ".join(f"{points.ids[i]} ({found.errors[i]:.3g} px)"
                     for i in _worst_first(found, which))


def _notes(points: Points, found: Suspects) -> Iterator[str]:
    if found.blunders.any():
        yield (f"Left out as blunders: {_named(points, found, found.blunders)}. In brackets: how "
               "far the other points predict them from where they were measured.")
    if found.undecided.any():
        yield (f"Perhaps blunders, still in use: {_named(points, found, found.undecided)}. The "
               "other points are too few or too far to tell.")
    if len(points) < FEW:
        worst, half = int(np.argmax(found.limits)), float(np.median(found.limits))
        if half > np.ptp(points.image, axis=0).max():
            yield f"With {len(points)} points no blunder can be found: any of them may be one."
            return
        yield (f"With {len(points)} points an error must exceed {_size(half)} px to be found at "
               f"half of them, and {_size(found.limits[worst])} px at {points.ids[worst]}.")


def _size(error: float) -> str:
    return f"{error:.2g}" if error < 100 else f"{error:,.0f}"
