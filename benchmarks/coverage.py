"""How often the interval of the predicted RMSE holds the independent RMSE.

``python -m benchmarks.coverage --write`` makes docs/evidence/coverage.md. Sets and splits are
those of `benchmarks.sets`, with up to 300 independent points. The constant of the interval was
chosen on other splits of the same sets; the embedded scenes alone lead to the same value.
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
from termsel.fits import accuracy
from termsel.fits.accuracy import LEVEL, Predicted, predicted_rmse
from termsel.measurements.features import FeatureSet, FloatArray
from termsel.simulate.catalogue import SCENES
from termsel.simulate.maps import NAME as OLD_MAP
from termsel.threads import one_blas_thread

COUNTS = (6, 8, 12, 16, 20, 30, 40, 74)
FIRST_SPLIT = 100
"""Splits before it were those by which the constant was chosen."""
FEWEST = 12
"""Control points from which on the interval is required to hold."""
FEW = 12
"""Independent points of the second table, as few as many a user has."""


@dataclass(frozen=True)
class Case:
    """One split: the independent RMSE, and that of a few independent points, with predictions.

    `other` are the predictions with the constant of the interval halved and doubled.
    """

    name: str
    count: int
    rmse: float
    predicted: Predicted
    rmse_of_few: float
    predicted_of_few: Predicted
    other: tuple[Predicted, Predicted]

    @property
    def held(self) -> bool:
        """Whether the interval holds the RMSE."""
        return self.predicted.low <= self.rmse <= self.predicted.high

    @property
    def held_few(self) -> bool:
        """Whether that for few points holds theirs."""
        return self.predicted_of_few.low <= self.rmse_of_few <= self.predicted_of_few.high


@one_blas_thread
def case(name: str, count: int, seed: int) -> Case | None:
    """Return one split; None if the set has too few points, or the choice cannot be repeated."""
    mine, independent = split(name, count, seed)
    if len(independent) < 20:
        return None
    control, heights = FeatureSet(mine), heights_of(mine)
    choice = choose(control, heights)
    errors = None if choice is None else repeated(control, heights)
    if choice is None or errors is None:
        return None
    fitted = choice.chosen.fit
    found: FloatArray = fitted.errors(independent)

    def predicted(points: int, factor: float = 1.0) -> Predicted:
        accuracy.LENT, value = factor * accuracy.LENT, accuracy.LENT
        try:
            return predicted_rmse(errors, fitted.effective, points)
        finally:
            accuracy.LENT = value

    n = len(found)
    return Case(name, count, rmse_of(found), predicted(n), rmse_of(found[:FEW]), predicted(FEW),
                (predicted(n, 0.5), predicted(n, 2.0)))


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
    def share(count: int | None) -> str:
        some = [c.held for c in cases if c.count == count or (count is None and c.count >= FEWEST)]
        return f"{100 * np.mean(some):.0f} % of {len(some)} splits" if some else "-"

    rows = [(f"independent RMSE in the interval, {count} points", share(count))
            for count in counts if count >= FEWEST]
    rows.append((f"the same, {FEWEST} points and more together", share(None)))
    return "\n".join(["| what | required | measured |", "|---|---|---|",
                      *(f"| {what} | 85 to 95 % | {found} |" for what, found in rows)])


def sensitivity(cases: list[Case]) -> str:
    """Return the shares of splits whose interval holds, with the constant halved and doubled."""
    some = [c for c in cases if c.count >= FEWEST]
    cells = [f"{100 * np.mean([one(c).low <= c.rmse <= one(c).high for c in some]):.0f} %"
             if some else "-" for one in (
                 lambda c: c.other[0], lambda c: c.predicted, lambda c: c.other[1])]
    return "\n".join(["| constant | halved | as it is | doubled |", "|---|---:|---:|---:|",
                      f"| `LENT` | {' | '.join(cells)} |"])


def main() -> None:
    """Print or write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="sets; by default all")
    parser.add_argument("--counts", type=int, nargs="+", default=list(COUNTS))
    parser.add_argument("--splits", type=int, default=6)
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
points, up to 300 independent points. A cell says in how many splits the
{100 * LEVEL:.0f} % interval holds the independent RMSE. The embedded scenes are simulated, as
`simulated` counts them together. The constant of the interval was chosen on other splits of these
sets; the embedded scenes alone lead to the same value. Splits that leave fewer than 20 independent
points are left out, as are those with too few points to repeat the choice.

## Requirement and measurement

{verdict(cases, asked.counts)}

## The constant

The share of splits with {FEWEST} points and more whose interval holds the independent RMSE.

{sensitivity(cases)}

## All sets

{table(cases, wanted, asked.counts)}

A cell of few splits is a count, not a share: of 60 splits that hold in 90 %, 50 to 58 usually hold.

"""
    put("coverage", text, write=asked.write)


if __name__ == "__main__":
    main()
