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


def scores_document(scores: Sequence[Score], title: str = AUTO.title) -> Document:
    """Return the page of scores.

    It shows which method is best on which kind of image; then, if the method with this `title` was
    run, the sets on which its error is more than `LOSS_RATIO` times that of the best other method;
    then all scores, folded. It states the protocol, that of measured sets if there is one.
    """
    header, rows = ratios_by_kind(scores)
    # Ratios are to the least RMSE of each set.
    best = least_error_by_set(scores)
    sets = dict.fromkeys(score.set_name for score in scores)
    worse = losses(scores, title)
    figure = "RMSE"
    protocol = (
        "A method sees control and selection points, lines, the image's size and the RPC of a set. "
        "Independent check points, which no method sees, judge it.")
    if any(name.startswith(MEASURED) for name in sets):
        figure = "error"
        protocol = (
            "The sets are measured. Each point is hidden once, and judges what a method makes of "
            "the points of the other folds; of matches a method sees one fold. The error of a set "
            "is the median distance of its hidden points.")
    summary = TableBlock(
        f"Median ratio of the {figure} to the least of each set; - where the method has no result "
        "on half of the sets or more.", tuple(header), [tuple(row) for row in rows])
    lost = TableBlock(
        f"Sets where {title} loses by more than {100 * (LOSS_RATIO - 1):.0f} %",
        ("set", "points", f"{title} [px]", "95 %", "best method", "best [px]", "95 %", "ratio"),
        [(loss.set_name, str(loss.control), _px_text(loss.rmse), _interval_text(loss),
          winner.method.title,
          _px_text(winner.rmse), _interval_text(winner), f"{loss.rmse / winner.rmse:.2f}")
         for loss, winner in worse])
    all_scores = TableBlock(
        "All scores",
        ("set", "method", "points", f"{figure} [px]", "95 %", "ratio", "why no result"),
        [(score.set_name, score.method.title, str(score.control), _px_text(score.rmse),
          _interval_text(score),
          _px_text(ratio_to_best(score, best)), score.why) for score in scores], folded=True)
    sections = [Section("Which method is best on which kind of image?", (summary,))]
    if any(score.method.title == title for score in scores):
        blocks: list[str | TableBlock] = [f"It loses on {len(worse)} of {len(sets)} sets."]
        if worse:
            blocks.append(lost)
        sections.append(Section(f"Where does {title} lose?", tuple(blocks)))
    sections.append(Section("All scores", (all_scores,)))
    return Document(
        "termsel-bench", f"sets of version {VERSION}, termsel {__version__}",
        (f"{len(rows)} methods on {len(sets)} sets. {protocol}",), tuple(sections))


def _px_text(value: float) -> str:
    """Return an error [px] with three decimals; "-" of an infinite one."""
    return f"{value:.3f}" if math.isfinite(value) else "-"


def _interval_text(score: Score) -> str:
    """Return the ends of a score's interval [px]; "-" where the score is infinite."""
    return f"{score.low:.3f} to {score.high:.3f}" if math.isfinite(score.rmse) else "-"
