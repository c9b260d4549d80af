"""The open benchmark: all methods of `termsel bench` on its forty sets.

``python -m benchmarks.open_benchmark --write`` makes docs/evidence/benchmark.md, and the results in
plugins/termsel-bench. It needs rasterio, scikit-learn and Orthority, as a peer that is not
installed would lose its row. With ``--kept FILE`` the scores on fresh scenes are kept.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median

from benchmarks.kept import resumed
from benchmarks.sets import ROOT, put
from termsel_bench.methods.base import AUTO, PEERS, Method
from termsel_bench.protocol import Score, score_all, score_set
from termsel_bench.scenes.catalogue import SETS, simulate_from
from termsel_bench.submitted import texts_of
from termsel_bench.tables import LOSS_RATIO, losses, ratios_by_kind

METHODS = (AUTO, Method("solver", "ga"), *(Method("peer", name) for name in PEERS
                                           if name != "opencv"))  # no focal length is stated

RESULTS = ROOT / "plugins" / "termsel-bench" / "results"
"""Where the results of each method are kept."""

HEAD = """# The open benchmark

Made by `python -m benchmarks.open_benchmark --write`: forty simulated sets of nine kinds, with
1,000 independent check points each, without noise. The [datasheet](../reference/datasheet.md) has
the sets, and [Compare your own method](../how-to/benchmark.md) the protocol.

`auto` is what termsel does where nothing is asked; `solver ga` is the papers' search of terms with
selection points as fitness. `deap-script` and `pymoo-script` are such searches without termsel, of
20 terms per image coordinate. Where a set has few points they find no selection of fewer terms than
points, which is no result. `gdal-polynomial` has the order that GDAL takes; `ransac` and
`scikit-learn` are
polynomials of space. All but `auto` and `orthority` ignore the RPC. All but `auto` and `solver ga`
ignore lines.

The table has the median ratio of the RMSE to the least of each set, and the processor's seconds.
A dash says that a method has no result on half of the sets or more.
"""

LOOKED_INTO = 1.1
"""Ratio to the best method from which on a loss is looked into on fresh scenes."""

FRESH_SEEDS = range(9100, 9107)


def rows(columns: Sequence[str], lines: Sequence[Sequence[str]]) -> Iterator[str]:
    """Yield a table as Markdown."""
    yield "| " + " | ".join(columns) + " |"
    yield "|---|" + "---:|" * (len(columns) - 1)
    for line in lines:
        yield "| " + " | ".join(line) + " |"


def fresh_ratio(name: str, seed: int) -> tuple[float, str]:
    """Return auto's RMSE by that of the best rival, and its name, on a set with another seed."""
    bench_set = simulate_from(replace(SETS[name], seed=seed))
    scores = [score_set(method, bench_set) for method in METHODS]
    best = min(scores[1:], key=lambda score: score.rmse)
    return scores[0].rmse / best.rmse, best.method.title


def fresh_scenes(names: Sequence[str], kept: Path | None) -> Iterator[str]:
    """Yield how auto does on scenes that are drawn as some sets are, with other seeds."""
    jobs = [(name, seed) for name in names for seed in FRESH_SEEDS]
    done = dict(zip(jobs, resumed(fresh_ratio, jobs, 1, kept), strict=True))
    lines = []
    by_chance = []
    for name in names:
        ratios = [done[name, seed][0] for seed in FRESH_SEEDS]
        if median(ratios) <= LOSS_RATIO:
            by_chance.append(name)
        lines.append((name, f"{median(ratios):.2f}", f"{min(ratios):.2f} to {max(ratios):.2f}",
                      str(sum(ratio > LOSS_RATIO for ratio in ratios))))
    yield (f"\nWhether a loss of more than {100 * (LOOKED_INTO - 1):.0f} % is one of the kind, "
           f"{len(FRESH_SEEDS)} fresh scenes tell that are drawn as the set is. Next to `auto` is "
           "the rival that turned out best on each scene.\n")
    yield from rows(("set", "`auto` by the best rival, median", "range", "scenes lost"), lines)
    yield (f"\nThe median loses no more than {100 * (LOSS_RATIO - 1):.0f} % with "
           f"{', '.join(by_chance) or 'none'}: there the loss is chance of the set.")
    if of_kind := [name for name in names if name not in by_chance]:
        yield f"With {', '.join(of_kind)} it is one of the kind."


def page(found: Sequence[Score], kept: Path | None) -> str:
    """Return the page."""
    worse = losses(found, AUTO.title)
    looked_into = [mine.set_name for mine, other in worse if mine.rmse > LOOKED_INTO * other.rmse]
    lost = [(mine.set_name, str(mine.control), _with_interval(mine), other.method.title,
             _with_interval(other), f"{mine.rmse / other.rmse:.2f}") for mine, other in worse]
    return "\n".join([
        HEAD, *rows(*ratios_by_kind(found)),
        f"\n## Where auto loses\n\n`auto` loses on {len(worse)} of {len(SETS)} sets by more than "
        f"{100 * (LOSS_RATIO - 1):.0f} %. Intervals of 95 % are of the independent check points.\n",
        *rows(("set", "points", "auto [px]", "best method", "its RMSE [px]", "ratio"), lost),
        *fresh_scenes(looked_into, kept)]) + "\n"


def _with_interval(one: Score) -> str:
    return f"{one.rmse:.3f} ({one.low:.3f} to {one.high:.3f})"


def main() -> None:
    """Run all methods on all sets and print the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--kept", type=Path, help="file of scores on fresh scenes")
    parser.add_argument("--write", action="store_true")
    asked = parser.parse_args()
    found = []
    for one in score_all(METHODS, SETS):
        if "not installed" in one.why:
            sys.exit(f"{one.method.title} has no result: {one.why}")
        found.append(one)
        if one.method == METHODS[-1]:
            print(one.set_name, file=sys.stderr)
    put("benchmark", page(found, asked.kept), write=asked.write)
    if asked.write:
        for name, text in texts_of(found).items():
            (RESULTS / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
