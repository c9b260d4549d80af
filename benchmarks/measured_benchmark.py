"""The measured sets: all methods of `termsel bench --suite measured`.

``python -m benchmarks.measured_benchmark --write`` makes docs/evidence/measured.md. With
``--kept FILE`` scores are kept, and a repeated command goes on from there. Peers that are not
installed have no result. It takes a quarter of an hour.
"""

from __future__ import annotations

import argparse
import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

from benchmarks.sets import put
from termsel_bench.methods.base import AUTO, PEERS, Method
from termsel_bench.protocol import Score, Work, score_work
from termsel_bench.scenes.measured import measured_names
from termsel_bench.tables import least_error_by_set, losses, ratio_to_best, ratios_by_kind

METHODS = [AUTO, *(Method("peer", name) for name in PEERS if name != "orthority")]

NEAR, BOUND = 1.05, 1.35
"""Ratios to the best in hindsight that the page counts."""


def main() -> None:
    """Score all methods on all measured sets, then print or write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--kept", type=Path, help="file of scores, which are not made again")
    parser.add_argument("--sets", default="", help="only sets whose name contains this")
    parser.add_argument("--kept-only", action="store_true",
                        help="take the sets on which the file has all methods, and run nothing")
    parser.add_argument("--write", action="store_true", help="write docs/evidence/measured.md")
    asked = parser.parse_args()
    kept = read_kept(asked.kept)
    names = measured_names(asked.sets)
    if asked.kept_only:
        names = [name for name in names
                 if all((method.title, name) in kept for method in METHODS)]
    scored = list(kept_scores(names, kept, asked.kept))
    put("measured", page(scored), write=asked.write)


def read_kept(file: Path | None) -> dict[tuple[str, str], Score]:
    """Return the scores of a file by method and set."""
    kept = {}
    for line in file.read_text().splitlines() if file is not None and file.exists() else ():
        row = json.loads(line)
        of_method = Method(**row.pop("method"))
        kept[of_method.title, row["set_name"]] = Score(of_method, **row)
    return kept


def kept_scores(names: Sequence[str], kept: Mapping[tuple[str, str], Score],
                file: Path | None) -> Iterator[Score]:
    """Yield the scores of all methods, those that are kept and those that are added to a file."""
    for name in names:
        for method in METHODS:
            found = kept.get((method.title, name)) or score_work(Work(method, name))
            if file is not None and (method.title, name) not in kept:
                file.parent.mkdir(parents=True, exist_ok=True)
                with file.open("a") as stream:
                    stream.write(json.dumps(asdict(found)) + "\n")
            yield found


def page(scored: Sequence[Score]) -> str:
    """Return the page."""
    best = least_error_by_set(scored)
    header, rows = ratios_by_kind(scored)
    sets = list(dict.fromkeys(each.set_name for each in scored))
    counts = Counter(each.kind for each in scored if each.method == AUTO)
    lines = [HEAD, f"This page has {len(sets)} of the {len(measured_names())} sets: "
             + ", ".join(f"{count} of {kind}" for kind, count in counts.items()) + ".", "",
             *_losses(scored), "## All methods", "",
             "Median ratios to the least figure of each set.", "",
             _table(header, rows), "", "## How often each method is near the best", "",
             f"Sets on which a method is within 5 % of the best of all methods, and within "
             f"{BOUND}, of those that it has a result on.", "",
             _table(["method", "sets with a result", "within 5 %", f"within {BOUND}"],
                    [_near(scored, best, title) for title in dict.fromkeys(
                        each.method.title for each in scored)]), "", *_by_kind(scored, best), "",
             TWO_NEAR_THE_BEST, "", _highest_factor(scored, best)]
    return "\n".join(lines) + "\n"


def _losses(scored: Sequence[Score]) -> Iterator[str]:
    """Yield where auto loses: it comes first, as who made a method is its worst judge."""
    lost = losses(scored, AUTO.title)
    sets = len({each.set_name for each in scored})
    yield from ("## Where auto loses", "",
                f"`auto` loses by more than 2 % on {len(lost)} of {sets} sets; those with the "
                "largest ratios:", "",
                _table(["set", "points in a fit", "auto [px]", "best method", "best [px]", "ratio"],
                       [[loss.set_name, str(loss.control), f"{loss.rmse:.2f}", winner.method.title,
                         f"{winner.rmse:.2f}", f"{loss.rmse / winner.rmse:.2f}"]
                        for loss, winner in lost[:40]]), "")


TWO_NEAR_THE_BEST = """\
On photos `auto` and `opencv` adjust the same pose by the same focal length, so that most often
both are near the best. Where hidden points are as few and as rough as here, ties within 5 % are
common as well."""


def _highest_factor(scored: Sequence[Score], best: dict[str, float]) -> str:
    """Return what factor over the rivals a choice in hindsight has, and what three would take."""
    near = Counter(each.method.title for each in scored
                   if ratio_to_best(each, best) <= NEAR)
    del near[AUTO.title]
    rival, of_rival = near.most_common(1)[0]
    sets = len(best)
    most = sets // 3
    lines = [f"Choosing on each set the method that turned out best is near the best on all "
             f"{sets}, and leaves `{rival}` near it on {of_rival}.",
             "**So even in hindsight no choice among these methods has a factor above "
             f"{sets / of_rival:.2f} over every rival.**"]
    if of_rival > most:
        lines.append(
            f"A factor of three leaves a rival {most} sets at most. It takes a method that is more "
            f"than 5 % below the best of all here on {of_rival - most} of the {of_rival} where "
            f"`{rival}` is near it, and near the best on all others.")
    return "\n".join(lines)


def _by_kind(scored: Sequence[Score], best: dict[str, float]) -> Iterator[str]:
    """Yield how auto stands on each kind, next to the best of its rivals there."""
    for kind in dict.fromkeys(each.kind for each in scored):
        ratios: dict[str, list[float]] = {}
        for each in scored:
            if each.kind == kind:
                ratios.setdefault(each.method.title, []).append(ratio_to_best(each, best))
        near = {title: sum(value <= NEAR for value in values) for title, values in ratios.items()}
        of_auto = ratios.pop(AUTO.title)
        rival = max(ratios, key=lambda title: near[title])
        yield (f"- {kind}: `auto` is within 5 % of the best on {near[AUTO.title]} of "
               f"{len(of_auto)}, the rival that is so most often, `{rival}`, on {near[rival]}; "
               f"`auto` is within {BOUND} on {sum(value <= BOUND for value in of_auto)}.")


def _near(scored: Sequence[Score], best: dict[str, float], title: str) -> list[str]:
    ratios = [ratio_to_best(each, best) for each in scored if each.method.title == title]
    return [title, str(sum(math.isfinite(value) for value in ratios)),
            *(str(sum(value <= bound for value in ratios)) for bound in (NEAR, BOUND))]


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(row)} |" for row in [header, ["---"] * len(header), *rows])


HEAD = """# The measured sets

Made by `python -m benchmarks.measured_benchmark --write`: 32 old maps and 100 vertical photos with
points by volunteers, and 694 automatic matches of two images. All are real, and blunders are among
them. Each point is hidden once, in frozen folds, and judges what a method makes of the others; of
the matches a method sees an eighth. The figure of a set is the median distance of all hidden points
[px], as a median is not led astray by hidden blunders. Photos have 6 to 14 points, so that their
figures are rough. Their focal lengths are stated: `auto`, by termsel-cameras, and `opencv` read
them, and no other method can.
The [datasheet](../reference/datasheet.md#measured-sets) has the sources.
"""


if __name__ == "__main__":
    main()
