"""The page of a benchmark."""

from __future__ import annotations

import math
from collections.abc import Sequence

from termsel import __version__
from termsel.toolkit import Document, Section, TableBlock
from termsel_bench.methods.base import AUTO
from termsel_bench.protocol import Score
from termsel_bench.scenes.croissant import VERSION
from termsel_bench.tables import NEAR, best_of, by_kind, losses, ratio


def document(scores: Sequence[Score], title: str = AUTO.title) -> Document:
    """Return what is shown of scores; `title` is the method whose losses are listed."""
    header, rows = by_kind(scores)
    # Ratios are to the least RMSE of each set.
    best = best_of(scores)
    sets = dict.fromkeys(score.set_name for score in scores)
    worse = losses(scores, title)
    summary = TableBlock("Median ratio of the RMSE to the least of each set; - if the method has "
                         "no result on half of the sets or more.", tuple(header),
                         [tuple(row) for row in rows])
    lost = TableBlock(
        f"Sets where {title} loses by more than {100 * (NEAR - 1):.0f} %",
        ("set", "points", f"{title} [px]", "95 %", "best method", "best [px]", "95 %", "ratio"),
        [(loss.set_name, str(loss.control), _px(loss.rmse), _interval(loss), winner.method.title,
          _px(winner.rmse), _interval(winner), f"{loss.rmse / winner.rmse:.2f}")
         for loss, winner in worse])
    all_scores = TableBlock(
        "All scores", ("set", "method", "points", "RMSE [px]", "95 %", "ratio", "why no result"),
        [(score.set_name, score.method.title, str(score.control), _px(score.rmse), _interval(score),
          _px(ratio(score, best)), score.why) for score in scores], folded=True)
    named = any(score.method.title == title for score in scores)
    return Document(
        "termsel-bench", f"sets of version {VERSION}, termsel {__version__}",
        (f"{len(rows)} methods on {len(sets)} sets. A method sees control and selection points, "
         "lines, "
         "the image's size and the RPC of a set. Independent check points, which no method sees, "
         "judge it.",),
        (Section("Which method is best on which kind of image?", (summary,)),
         *([Section(f"Where does {title} lose?", (
             f"It loses on {len(worse)} of {len(sets)} sets.", *([lost] if worse else [])))]
           if named else []),
         Section("All scores", (all_scores,))))


def _px(value: float) -> str:
    return f"{value:.3f}" if math.isfinite(value) else "-"


def _interval(score: Score) -> str:
    return f"{score.low:.3f} to {score.high:.3f}" if math.isfinite(score.rmse) else "-"
