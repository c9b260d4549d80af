"""The page of a benchmark."""

from __future__ import annotations

import math
from collections.abc import Sequence

from termsel import TableBlock, __version__
from termsel.toolkit.charts import Document, Section
from termsel_bench.methods.base import AUTO
from termsel_bench.protocol import Score
from termsel_bench.scenes.croissant import VERSION
from termsel_bench.scenes.measured import MEASURED
from termsel_bench.tables import (
    LOSS_RATIO,
    least_error_by_set,
    losses,
    ratio_to_best,
    ratios_by_kind,
)

_PROTOCOL = (
    "A method sees control and selection points, lines, the image's size and the RPC of a set. "
    "Independent check points, which no method sees, judge it.")

_PROTOCOL_OF_MEASURED = (
    "The sets are measured. Each point is hidden once, and judges what a method makes of the "
    "points of the other folds; of matches a method sees one fold. The error of a set is the "
    "median distance of its hidden points.")


def scores_document(scores: Sequence[Score], judged: str = AUTO.title) -> Document:
    """Return the page of a benchmark.

    It shows which method is best on which kind of image; then, if the method with the title
    `judged` was run, the sets on which its error is more than `LOSS_RATIO` times that of the best
    other method; then all scores, folded. The protocol at its head is that of measured sets if any
    set is measured, else that of simulated and real ones.
    """
    sets = dict.fromkeys(score.set_name for score in scores)
    titles = dict.fromkeys(score.method.title for score in scores)
    is_measured = any(name.startswith(MEASURED) for name in sets)
    figure = "error" if is_measured else "RMSE"
    sections = [Section("Which method is best on which kind of image?",
                        (_ratios_table(scores, figure),))]
    if judged in titles:
        lost = losses(scores, judged)
        blocks: list[str | TableBlock] = [f"It loses on {len(lost)} of {len(sets)} sets."]
        if lost:
            blocks.append(_losses_table(lost, judged))
        sections.append(Section(f"Where does {judged} lose?", tuple(blocks)))
    sections.append(Section("All scores", (_scores_table(scores, figure),)))
    protocol = _PROTOCOL_OF_MEASURED if is_measured else _PROTOCOL
    return Document(
        "termsel-bench", f"sets of version {VERSION}, termsel {__version__}",
        (f"{len(titles)} methods on {len(sets)} sets. {protocol}",), tuple(sections))


def _ratios_table(scores: Sequence[Score], figure: str) -> TableBlock:
    """Return the table of median ratios by kind of image; `figure` is the word for an error."""
    header, rows = ratios_by_kind(scores)
    return TableBlock(
        f"Median ratio of the {figure} to the least of each set; - where the method has no result "
        "on half of the sets or more.", tuple(header), [tuple(row) for row in rows])


def _losses_table(lost: Sequence[tuple[Score, Score]], judged: str) -> TableBlock:
    """Return the table of sets on which a method loses, with the method that is best there.

    `lost` is what `losses` returns of the method with the title `judged`.
    """
    rows = []
    for loss, winner in lost:
        rows.append((loss.set_name, str(loss.control), _decimals(loss.rmse), _interval_text(loss),
                     winner.method.title, _decimals(winner.rmse), _interval_text(winner),
                     f"{loss.rmse / winner.rmse:.2f}"))
    return TableBlock(
        f"Sets where {judged} loses by more than {100 * (LOSS_RATIO - 1):.0f} %",
        ("set", "points", f"{judged} [px]", "95 %", "best method", "best [px]", "95 %", "ratio"),
        rows)


def _scores_table(scores: Sequence[Score], figure: str) -> TableBlock:
    """Return the folded table of all scores; `figure` is the word for an error."""
    least_errors = least_error_by_set(scores)
    rows = []
    for score in scores:
        rows.append((score.set_name, score.method.title, str(score.control), _decimals(score.rmse),
                     _interval_text(score), _decimals(ratio_to_best(score, least_errors)),
                     score.why))
    return TableBlock(
        "All scores",
        ("set", "method", "points", f"{figure} [px]", "95 %", "ratio", "why no result"),
        rows, folded=True)


def _decimals(value: float) -> str:
    """Return an error [px] or a ratio with three decimals; "-" of an infinite one."""
    return f"{value:.3f}" if math.isfinite(value) else "-"


def _interval_text(score: Score) -> str:
    """Return the ends of a score's interval [px]; "-" where the score is infinite."""
    return f"{score.low:.3f} to {score.high:.3f}" if math.isfinite(score.rmse) else "-"
