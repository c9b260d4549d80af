"""Tables of scores: a row a method, and a row a set and method."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import chain
from statistics import median

from termsel.toolkit import csv_table
from termsel_bench.protocol import Score

TABLE_COLUMNS = ("set", "kind", "method", "points", "independent", "rmse", "low", "high", "ratio",
                 "seconds", "why")
"""Columns of table.csv."""

LOSS_RATIO = 1.02
"""A method loses on a set where its RMSE is above that of another by more than this."""


def least_error_by_set(scores: Sequence[Score]) -> dict[str, float]:
    """Return the least error of each set [px], by its name; infinite if no method has a result."""
    best: dict[str, float] = {}
    for score in scores:
        best[score.set_name] = min(best.get(score.set_name, math.inf), score.rmse)
    return best


def ratio_to_best(score: Score, best: dict[str, float]) -> float:
    """Return the ratio of a score to the best of its set; infinite without a result."""
    best_rmse = best[score.set_name]
    return score.rmse / best_rmse if math.isfinite(score.rmse) else math.inf


def csv_text(scores: Sequence[Score]) -> str:
    """Return the content of table.csv: a row for each score; figures are blank without a result."""
    best = least_error_by_set(scores)
    rows: list[Sequence[object]] = [TABLE_COLUMNS]
    for score in scores:
        figures = [f"{value:.4f}" if math.isfinite(value) else "" for value in (
            score.rmse, score.low, score.high, ratio_to_best(score, best))]
        rows.append([score.set_name, score.kind, score.method.title, score.control,
                     score.independent,
                     *figures, f"{score.seconds:.2f}", score.why])
    return csv_table(rows)


def ratios_by_kind(scores: Sequence[Score]) -> tuple[list[str], list[list[str]]]:
    """Return header and rows of median ratios to the least error of each set, best method first.

    Columns are the kinds of sets and all sets; then the number of sets on which a method is within
    `LOSS_RATIO` of the best, and on which it has no result, and the median time [s]. Without a
    result the ratio is infinite.
    """
    best = least_error_by_set(scores)
    kinds = list(dict.fromkeys(score.kind for score in scores))
    titles = dict.fromkeys(score.method.title for score in scores)
    rows = []
    for title in titles:
        # Errors themselves differ between sets by factors of ten.
        method_scores = [score for score in scores if score.method.title == title]
        ratios: dict[str, list[float]] = {kind: [] for kind in kinds}
        for score in method_scores:
            ratios[score.kind].append(ratio_to_best(score, best))
        all_ratios = list(chain.from_iterable(ratios.values()))
        rows.append((median(all_ratios),
                     [title, *(_ratio_in_words(median(values) if values else math.inf)
                               for values in ratios.values()),
                      _ratio_in_words(median(all_ratios)),
                      str(sum(value <= LOSS_RATIO for value in all_ratios)),
                      str(sum(math.isinf(value) for value in all_ratios)),
                      f"{median(score.seconds for score in method_scores):.2f}"]))
    header = ["method", *kinds, "all", f"within {100 * (LOSS_RATIO - 1):.0f} %", "no result",
              "seconds"]
    return header, [row for _, row in sorted(rows, key=lambda pair: pair[0])]


def losses(scores: Sequence[Score], title: str) -> list[tuple[Score, Score]]:
    """Return the score of a method and the best other one for each set on which it loses.

    It loses if its error is more than `LOSS_RATIO` times the best of the others. The sets are in
    the order of that ratio, the largest first.
    """
    lost = []
    for score in scores:
        rivals = [rival for rival in scores
                  if rival.set_name == score.set_name and rival.method.title != title]
        winner = min(rivals, key=lambda rival: rival.rmse, default=None)
        if (score.method.title == title and winner is not None
                and score.rmse > LOSS_RATIO * winner.rmse):
            lost.append((score, winner))
    return sorted(lost, key=lambda pair: -pair[0].rmse / pair[1].rmse)


def _ratio_in_words(value: float) -> str:
    """Return a ratio with two decimals; "-" of an infinite one."""
    return "-" if math.isinf(value) else f"{value:.2f}"
