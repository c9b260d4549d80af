"""The open benchmark: all methods of `termsel bench` on its forty sets.

``python -m benchmarks.open_benchmark --write`` makes docs/evidence/benchmark.md, and the results in
plugins/termsel-bench. Peers that are not installed have no result: rasterio, scikit-learn and
Orthority are required for the page.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence

from benchmarks.sets import ROOT, put
from termsel_bench.methods.base import AUTO, PEERS, Method
from termsel_bench.protocol import Score, score_all
from termsel_bench.scenes.catalogue import SETS
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

FRESH_SCENES = """
The losses on five kinds were looked into on five fresh scenes each, drawn as the set is, next to
the best rival of the scene. The median of `auto` by that rival was 0.96 for panoramic-3, 1.07 for
old-map-1, 0.81 for agile-1, 0.16 for steady-2 and 0.24 for lines-2; single scenes had from 0.08 to
1.66. So these losses are chance of the set rather than of its kind, and nothing was changed for
them. panoramic-2 was not looked into."""


def rows(columns: Sequence[str], lines: Sequence[Sequence[str]]) -> Iterator[str]:
    """Yield a table as Markdown."""
    yield "| " + " | ".join(columns) + " |"
    yield "|---|" + "---:|" * (len(columns) - 1)
    for line in lines:
        yield "| " + " | ".join(line) + " |"


def page(found: Sequence[Score]) -> str:
    """Return the page."""
    worse = losses(found, AUTO.title)
    lost = [(mine.set_name, str(mine.control), _with_interval(mine), other.method.title,
             _with_interval(other), f"{mine.rmse / other.rmse:.2f}") for mine, other in worse]
    return "\n".join([
        HEAD, *rows(*ratios_by_kind(found)),
        f"\n## Where auto loses\n\n`auto` loses on {len(worse)} of {len(SETS)} sets by more than "
        f"{100 * (LOSS_RATIO - 1):.0f} %. Intervals of 95 % are of the independent check points.\n",
        *rows(("set", "points", "auto [px]", "best method", "its RMSE [px]", "ratio"), lost),
        FRESH_SCENES])


def _with_interval(one: Score) -> str:
    return f"{one.rmse:.3f} ({one.low:.3f} to {one.high:.3f})"


def main() -> None:
    """Run all methods on all sets and print the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--write", action="store_true")
    asked = parser.parse_args()
    found = []
    for one in score_all(METHODS, SETS):
        found.append(one)
        if one.method == METHODS[-1]:
            print(one.set_name, file=sys.stderr)
    put("benchmark", page(found), write=asked.write)
    if asked.write:
        for name, text in texts_of(found).items():
            (RESULTS / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
