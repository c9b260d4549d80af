"""Tables of scores: a row a method, and a row a set and method."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import median

from termsel.toolkit import csv_table
from termsel_bench.protocol import Score

COLUMNS = ("set", "kind", "method", "points", "independent", "rmse", "low", "high", "ratio",
           "seconds", "why")
"""Columns of table.csv."""

NEAR = 1.02
"""A method loses on a set where its RMSE is above that of another by more than this."""


def best_of(scores: Sequence[Score]) -> dict[str, float]:
    """Return the least RMSE of each set."""
    best: dict[str, float] = {}
    for one in scores:
        best[one.set_name] = min(best.get(one.set_name, math.inf), one.rmse)
    return best


def ratio(one: Score, best: dict[str, float]) -> float:
    """Return the ratio to the least RMSE of the set; infinite without a result."""
    least = best[one.set_name]
    return one.rmse / least if math.isfinite(one.rmse) else math.inf


def csv_text(scores: Sequence[Score]) -> str:
    """Return table.csv."""
    best = best_of(scores)
    rows: list[Sequence[object]] = [COLUMNS]
    for one in scores:
        figures = [f"{value:.4f}" if math.isfinite(value) else "" for value in (
            one.rmse, one.low, one.high, ratio(one, best))]
        rows.append([one.set_name, one.kind, one.method.title, one.control, one.independent,
                         *figures, f"{one.seconds:.2f}", one.why])
    return csv_table(rows)


def by_kind(scores: Sequence[Score]) -> tuple[list[str], list[list[str]]]:
    """Return header and rows of the median ratio to the best of each set, best method first."""
    best = best_of(scores)
    kinds = list(dict.fromkeys(score.kind for score in scores))
    titles = dict.fromkeys(score.method.title for score in scores)
    rows = []
    for title in titles:
        mine = [score for score in scores if score.method.title == title]
        ratios = {kind: [ratio(one, best) for one in mine if one.kind == kind] for kind in kinds}
        every = [value for values in ratios.values() for value in values]
        rows.append((median(every), [title, *(_shown(median(values) if values else math.inf)
                                              for values in ratios.values()),
                                     _shown(median(every)),
                                     str(sum(value <= NEAR for value in every)),
                                     str(sum(math.isinf(value) for value in every)),
                                     f"{median(one.seconds for one in mine):.2f}"]))
    header = ["method", *kinds, "all", f"within {100 * (NEAR - 1):.0f} %", "no result", "seconds"]
    return header, [row for _, row in sorted(rows, key=lambda pair: pair[0])]


def losses(scores: Sequence[Score], title: str) -> list[tuple[Score, Score]]:
    """Return the sets on which a method loses: its score and the best, worst loss first."""
    found = []
    for mine in scores:
        rivals = [score for score in scores
                  if score.set_name == mine.set_name and score.method.title != title]
        winner = min(rivals, key=lambda one: one.rmse, default=None)
        if mine.method.title == title and winner is not None \
                and mine.rmse > NEAR * winner.rmse:
            found.append((mine, winner))
    return sorted(found, key=lambda pair: -pair[0].rmse / pair[1].rmse)


def _shown(value: float) -> str:
    return "-" if math.isinf(value) else f"{value:.2f}"
