"""How often the interval of the predicted RMSE holds the independent RMSE.

``python -m benchmarks.coverage --write`` makes docs/evidence/coverage.md. Sets and splits are
those of `benchmarks.sets`, with up to 300 independent points. The interval has no constant to
choose; which sources of uncertainty it has was decided on other splits of the same sets.
"""

from __future__ import annotations

import argparse
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np

from benchmarks.sets import heights_of, names, put, rmse_of, split
from termsel.candidates.portfolio import choose
from termsel.candidates.repetition import repeated
from termsel.fits.accuracy import CONFIDENCE, Predicted, predicted_by, predicted_rmse
from termsel.measurements.control import Control
from termsel.measurements.features import FeatureSet, FloatArray
from termsel.simulate.catalogue import SCENES
from termsel.threads import one_blas_thread
from termsel_photos.maps import NAME as OLD_MAP

COUNTS = (6, 8, 12, 16, 20, 30, 40, 74)
FIRST_SPLIT = 100
"""Splits before it were those by which the sources were decided."""
FEWEST = 12
"""Control points from which on the interval is required to hold."""
FEW = 12
"""Independent points of the second table, as few as many a user has."""


@dataclass(frozen=True)
class Case:
    """One split: the independent RMSE, and that of a few independent points, with predictions.

    `alone` is the prediction without what all places have in common.
    """

    name: str
    count: int
    rmse: float
    predicted: Predicted
    rmse_of_few: float
    predicted_of_few: Predicted
    alone: Predicted

    @property
    def held(self) -> bool:
        """Whether the interval holds the RMSE."""
        return holds(self.predicted, self.rmse)

    @property
    def held_few(self) -> bool:
        """Whether that for few points holds theirs."""
        return holds(self.predicted_of_few, self.rmse_of_few)


def holds(predicted: Predicted, rmse: float) -> bool:
    """Return whether an interval holds an RMSE."""
    return predicted.low <= rmse <= predicted.high


def share(held: list[bool]) -> str:
    """Return a share in per cent with its standard error."""
    found = np.mean(held)
    return f"{100 * found:.0f} ± {100 * np.sqrt(found * (1 - found) / len(held)):.0f} %"


@one_blas_thread
def case(name: str, count: int, seed: int) -> Case | None:
    """Return one split; None if the set has too few points, or the choice cannot be repeated."""
    mine, independent = split(name, count, seed)
    if len(independent) < 20:
        return None
    control, heights = FeatureSet(mine), heights_of(mine)
    choice = choose(Control.of(control, heights))
    errors = None if choice is None else repeated(Control.of(control, heights))
    if choice is None or errors is None:
        return None
    fitted = choice.chosen.fit
    found: FloatArray = fitted.errors(independent)

    n = len(found)
    return Case(name, count, rmse_of(found), predicted_by(fitted, errors, n),
                rmse_of(found[:FEW]), predicted_by(fitted, errors, min(n, FEW)),
                predicted_rmse(errors, fitted.effective, n, 0.0))


def table(cases: list[Case], wanted: list[str], counts: list[int]) -> str:
    """Return the share of splits whose interval holds the RMSE, sets by numbers of points."""
    def cell(some: list[Case]) -> str:
        return f"{sum(c.held for c in some)} of {len(some)}" if some else "-"

    def line(title: str, some: list[Case]) -> str:
        return f"| {title} | " + " | ".join(
            cell([c for c in some if c.count == count]) for count in counts) + " |"

    rows = ["| set | " + " | ".join(f"{count} points" for count in counts) + " |",
            "|---|" + "---:|" * len(counts)]
    rows += [line(name, [c for c in cases if c.name == name]) for name in wanted]
    rows.append(line("simulated", [c for c in cases if c.name in (*SCENES, OLD_MAP)]))
    rows.append(line("others", [c for c in cases if c.name not in (*SCENES, OLD_MAP)]))
    for title, held in (("**all**", lambda c: c.held),
                        (f"all, {FEW} independent points", lambda c: c.held_few)):
        shares = [np.mean([held(c) for c in cases if c.count == count] or [np.nan])
                  for count in counts]
        rows.append(f"| {title} | " + " | ".join(f"{100 * share:.0f} %" for share in shares) + " |")
    for title, value in (("high / low, median", lambda c: c.predicted.high / c.predicted.low),
                         ("independent / predicted, 5 %", None),
                         ("independent / predicted, 95 %", None)):
        cells = []
        for count in counts:
            some = [c for c in cases if c.count == count]
            if not some:
                cells.append("-")
            elif value is not None:
                cells.append(f"{np.median([value(c) for c in some]):.1f}")
            else:
                at = 0.05 if " 5 %" in title else 0.95
                cells.append(f"{np.quantile([c.rmse / c.predicted.rmse for c in some], at):.2f}")
        rows.append(f"| {title} | " + " | ".join(cells) + " |")
    return "\n".join(rows)


def verdict(cases: list[Case], counts: list[int]) -> str:
    """Return what was required next to what was measured."""
    rows = []
    for count in [*(c for c in counts if c >= FEWEST), None]:
        some = [c for c in cases if c.count == count or (count is None and c.count >= FEWEST)]
        if not some:
            continue
        what = f"independent RMSE in the interval, {count} points" if count else \
            f"the same, {FEWEST} points and more together"
        below, above = (f"{np.mean(out):.0%}" for out in (
            [c.rmse < c.predicted.low for c in some], [c.rmse > c.predicted.high for c in some]))
        rows.append(f"| {what} | 85 to 95 % | {share([c.held for c in some])} of {len(some)} "
                    f"splits | {below} | {above} | "
                    f"{share([holds(c.alone, c.rmse) for c in some])} |")
    return "\n".join(["| what | required | measured | below it | above it | without what places "
                      "have in common |", "|---|---|---|---:|---:|---:|", *rows])


def main() -> None:
    """Print or write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="sets; by default all")
    parser.add_argument("--counts", type=int, nargs="+", default=list(COUNTS))
    parser.add_argument("--splits", type=int, default=24)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--write", action="store_true", help="write docs/evidence/coverage.md")
    asked = parser.parse_args()
    wanted, start = asked.names or names(), time.perf_counter()
    cases = []
    for count in asked.counts:
        jobs = [(name, count, seed) for name in wanted
                for seed in range(FIRST_SPLIT, FIRST_SPLIT + asked.splits)]
        with ProcessPoolExecutor(asked.processes) as pool:
            cases += [one for one in pool.map(case, *zip(*jobs, strict=True)) if one]
        sys.stderr.write(f"{count} points: {time.perf_counter() - start:.0f} s\n")
    text = f"""# The interval of the predicted RMSE

Made by `python -m benchmarks.coverage --write`: {asked.splits} splits of each set and number of
points, up to 300 independent points. A cell says in how many splits the interval
holds the RMSE of just these independent points with a chance of {100 * CONFIDENCE:.0f} %: it knows
their number, and what so few of them add is part of its width. The embedded scenes are simulated,
as `simulated` counts them together. Splits that leave fewer than 20 independent points are
left out, as are those with too few points to repeat the choice.

The interval has no constant that was fitted to any set. Its width has three sources: few squared
errors, coefficients that few points determine, and solutions that disagree
([how](../explanation/auto.md#its-interval)). Which sources it has was decided on other splits of
these sets. A standard error is that of a share; splits of a measured set have points in common,
so that it is rather larger.

## Requirement and measurement

{verdict(cases, asked.counts)}

## All sets

{table(cases, wanted, asked.counts)}

A cell is a count, not a share: of 24 splits that hold in 90 %, 19 to 24 usually hold.

"""
    put("coverage", text, write=asked.write)


if __name__ == "__main__":
    main()
