"""Local deformation: auto next to conventional models and thin-plate splines.

    python -m benchmarks.old_maps [--splits N] [--write]

Simulated scans of old maps of several kinds, the two real old maps, and the satellite sets, which
must not change. The choice is that of the strategy auto, from points without blunders.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from statistics import median
from typing import Any

import numpy as np

import termsel
from benchmarks.sets import DATA, PLAIN, heights_of, put, rmse_of, split
from termsel.adjustment.bayesian import field
from termsel.auto import shrunken
from termsel.auto.auto import Auto
from termsel.auto.rule import best_of
from termsel.data.features import FeatureSet, Points
from termsel.data.fit_data import FitData
from termsel.simulate.catalogue import SCENES
from termsel_cameras import simulate_map

COUNTS = (20, 40, 74)
MAPS: dict[str, dict[str, Any]] = {
    "old-map": {},
    "one sheet": {"sheets": (1, 1)},
    "one sheet, strong": {"sheets": (1, 1), "local": 15.0},
    "six sheets": {"sheets": (2, 3), "local": 0.0, "joints": 10.0},
    "paper alone": {"sheets": (1, 1), "local": 0.0},
    "flat scan": {"sheets": (1, 1), "local": 0.0, "shrinkage": 0.0}}
REAL = {"kastoria_1925": 1.03, "maplat_fushimijo": 1.00}
"""Real maps, with what was required."""
MORE = 5
"""Splits of a real map by those of others: they differ in the points that are drawn alone."""
SATELLITES = (*SCENES, "phr_grid_nice_a", "rpcfit_s1_test", "rpcfit_s1_train", "s1_grd_iw",
              "ikonos_lines", "ventoux_lines")


@dataclass(frozen=True)
class Split:
    """Independent RMSE of auto, of auto without fields and splines, and of others by name."""

    auto: float
    without: float
    others: dict[str, float]
    covered: float
    called: bool
    seconds: float


def drawn(name: str, count: int, seed: int) -> tuple[Points, Points]:
    """Return control and selection points together, and independent check points."""
    if name not in MAPS:
        return split(name, count, seed)
    points = replace(simulate_map(seed=seed, n_points=count + 200, **MAPS[name]).points, roles=())
    order = np.random.default_rng([count, seed]).permutation(len(points))
    return points.take(order[:count]), points.take(order[count:])


def measure(name: str, count: int, seed: int) -> Split | None:
    """Return one split; None if the set has not enough points."""
    mine, independent = drawn(name, count, seed)
    if len(independent) < 30:
        return None
    control, start = FeatureSet(mine), time.process_time()
    choice = Auto().choose(FitData.of(control, heights_of(mine)))
    seconds = time.process_time() - start
    assert choice is not None
    without = best_of(one for one in choice.compared if one.method.kind != "local")
    assert without is not None
    others = {one.method.name: rmse_of(one.errors(independent)) for one in choice.compared
              if one.method.name in PLAIN}
    others |= {"tps": rmse_of(termsel.fit(control, "tps").errors(independent)),
               "tps, exact": rmse_of(termsel.fit(control, "tps",
                                                 smoothing=0.0).errors(independent))}
    fitted = choice.chosen
    errors = fitted.errors(independent)
    bound = 1.645 * fitted.sigma(independent.ground, measured=True)
    return Split(rmse_of(errors), rmse_of(without.chosen.errors(independent)), others,
                 float((np.abs(errors) <= bound).mean()),
                 choice.method.name in ("field", "tps"), seconds)


@dataclass(frozen=True)
class Row:
    """All splits of one set and one number of points."""

    name: str
    count: int
    splits: tuple[Split, ...]

    @property
    def best(self) -> tuple[str, float]:
        """The structure or spline with the least median, chosen with hindsight."""
        names = {name for one in self.splits for name in one.others}
        medians = {name: median(one.others.get(name, float("inf")) for one in self.splits)
                   for name in sorted(names)}
        name = min(medians, key=lambda one: medians[one])
        return name, medians[name]

    @property
    def ratio(self) -> float:
        """Ratio of the median of auto to that of the best."""
        return median(one.auto for one in self.splits) / self.best[1]

    @property
    def error(self) -> float:
        """Standard error of the ratio by the bootstrap, which chooses the best each time."""
        rng, count = np.random.default_rng(0), len(self.splits)
        return float(np.std([Row(self.name, self.count, tuple(
            self.splits[i] for i in rng.integers(0, count, count))).ratio for _ in range(200)]))

    @property
    def change(self) -> float:
        """Median ratio of auto to auto without fields and splines."""
        return median(one.auto / one.without for one in self.splits)

    def line(self) -> str:
        """Return a row of the table."""
        name, value = self.best
        return (f"| {self.name} | {self.count} | {name} | {value:.2f} | "
                f"{median(one.auto for one in self.splits):.2f} | "
                f"{self.ratio:.2f} ± {self.error:.2f} | "
                f"{self.change:.2f} | {np.mean([one.called for one in self.splits]):.0%} | "
                f"{np.mean([one.covered for one in self.splits]):.0%} | "
                f"{median(one.seconds for one in self.splits):.2f} |")


def rows(names: list[str], splits: int, processes: int) -> Iterator[Row]:
    """Yield set after set."""
    with ProcessPoolExecutor(processes) as pool:
        for name in names:
            for count in (*COUNTS, 120) if name == "s1_grd_iw" else COUNTS:
                done = [one for one in pool.map(measure, *zip(
                    *((name, count, seed) for seed in range(
                        splits * (MORE if name in REAL else 1))), strict=True)) if one]
                if done:
                    yield Row(name, count, tuple(done))


def verdict(found: list[Row]) -> str:
    """Return what was required next to what was measured."""
    def over(names: list[str], limit: float) -> str:
        ratios = [(row.ratio, f"{row.name} at {row.count} ({row.ratio:.3f} ± {row.error:.3f})")
                  for row in found if row.name in names]
        if not ratios:
            return "-"
        beyond = ", ".join(text for ratio, text in ratios if ratio > limit)
        return f"above it: {beyond}" if beyond else f"at most {max(ratios)[0]:.3f}"

    changes = [(row.change, f"{row.name} at {row.count} ({row.change:.3f})") for row in found
               if row.name in SATELLITES]
    worse = ", ".join(text for change, text in changes if change > 1.01) or "none"
    return "\n".join([
        "| what | required | measured |", "|---|---|---|",
        "| simulated maps: ratio to the best of conventional models and splines in hindsight | "
        f"at most 1.05 on each | {over(list(MAPS), 1.05)} |",
        *(f"| {name}: the same | at most {limit:.2f} | {over([name], limit)} |"
          for name, limit in REAL.items()),
        "| satellite sets: auto by auto without fields and splines, medians | at most 1.01 | "
        f"above it: {worse} |"])


CONSTANTS = ("FIELD_LENGTHS", "FIELD_RATIOS", "FIELD_FALLS", "FIELD_RELIEF", "FIELD_KNOTS",
             "COVARIANCE_JITTER")
ODDS = ((shrunken, "FIELD_CALLED_FOR"), (shrunken, "FIELD_EXCLUDED"))


def sensitivity(splits: int) -> str:
    """Return the ratio to the best with each constant halved and doubled."""
    jobs = [(name, count, seed) for name in (
        "old-map", "one sheet, strong", "paper alone", *(n for n in (*REAL, "s1_grd_iw")
                                                         if (DATA / n).is_dir()))
            for count in (20, 74) for seed in range(splits)]

    def ratio() -> float:
        field._cached_gaussian_process.cache_clear()
        found = []
        for name, count, seed in jobs:
            mine, independent = drawn(name, count, seed)
            choice = Auto().choose(FitData.of(FeatureSet(mine), heights_of(mine)))
            assert choice is not None
            best = min(rmse_of(one.errors(independent)) for one in choice.compared
                       if one.method.name in PLAIN)
            found.append(rmse_of(choice.chosen.errors(independent)) / best)
        return float(np.exp(np.mean(np.log(found))))

    as_is = ratio()
    lines = ["| constant | halved | as it is | doubled |", "|---|---:|---:|---:|"]
    for module, name in (*((field, name) for name in CONSTANTS), *ODDS):
        value, changed = getattr(module, name), []
        for factor in (0.5, 2.0):
            if (module, name) in ODDS:
                odds = factor * value / (1 - value)
                new: Any = odds / (1 + odds)
            elif name == "FIELD_KNOTS":
                new = int(factor * value)
            else:
                new = np.asarray(value) * factor
                new = tuple(map(tuple, new.tolist())) if name == "FIELD_LENGTHS" else new
            setattr(module, name, new)
            changed.append(ratio())
        setattr(module, name, value)
        lines.append(f"| `{name}` | {changed[0]:.3f} | {as_is:.3f} | {changed[1]:.3f} |")
    return "\n".join(lines)


def main() -> None:
    """Print or write the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="sets; by default all")
    parser.add_argument("--splits", type=int, default=20)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--write", action="store_true", help="write docs/evidence/old-maps.md")
    asked = parser.parse_args()
    wanted = asked.names or [name for name in (*MAPS, *REAL, *SATELLITES)
                             if name in MAPS or name in SCENES or (DATA / name).is_dir()]
    found = []
    for row in rows(wanted, asked.splits, asked.processes):
        found.append(row)
        sys.stderr.write(row.line() + "\n")
    text = f"""# Old maps

Made by `python -m benchmarks.old_maps --write`: {asked.splits} splits of each set and number of
points, {MORE * asked.splits} of the measured maps. The first {len(MAPS)} sets are
[simulated](../reference/simulated.md#old-map), each split with another seed; kastoria_1925 and
maplat_fushimijo are measured old maps; the others are
satellite scenes, simulated, derived from sensor models or measured. The best of conventional models
(affine, DLT or projective, quadratic, cubic) and thin-plate splines (smoothed by REML, and exact)
is chosen with hindsight, by the median of its independent RMSE over all splits. The standard
error of a ratio is that of the bootstrap over splits. *Without* is the
ratio to auto without fields and splines; *called for* is how often auto takes one of them;
*covered* is the share of independent check points within 1.645 `sigma`, of which 90 % are expected.
Seconds are those of one processor for one choice, which a run repeats up to 20 times.

## Requirement and measurement

{verdict(found)}

## Constants

The geometric mean, over splits, of auto's independent RMSE divided by that of the best conventional
model of the split; old-map, one sheet, strong, paper alone, the real maps and s1_grd_iw at 20
and 74 points. Of probabilities the odds are halved and doubled.

{sensitivity(min(asked.splits, 2))}

## All sets

| set | points | best | px | auto px | ratio | without | called for | covered | seconds |
|---|---:|---|---:|---:|---:|---:|---:|---:|---:|
""" + "\n".join(row.line() for row in found) + "\n"
    put("old-maps", text, write=asked.write)


if __name__ == "__main__":
    main()
