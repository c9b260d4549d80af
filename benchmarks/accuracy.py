"""Accuracy of the strategy auto on unseen points, and of its own prediction.

``python -m benchmarks.accuracy`` prints the tables, ``--write`` makes
docs/evidence/honest-accuracy.md of them.
The sets are the embedded scenes, each split with new points and noise, and those of the folder
named by the environment variable TERMSEL_DATA, or ../shared/data, where it is there: sets derived
from a sensor model get Gaussian noise of 0.5 px on line and sample. A split draws so many
points at random as control and check together, and up to 300 of the others as independent.
``--splits N`` makes it shorter, names of sets and ``--counts`` choose among them.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from statistics import median

import numpy as np

from termsel.adjustment import posterior
from termsel.candidates import portfolio
from termsel.candidates.portfolio import choose, repeated
from termsel.io.read import read
from termsel.measurements.features import FeatureSet, FloatArray, Points
from termsel.runs.run import run
from termsel.simulate import simulate_scene
from termsel.simulate.catalogue import SCENES
from termsel.simulate.maps import NAME as OLD_MAP
from termsel.simulate.maps import simulate_map

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.get("TERMSEL_DATA", ROOT.parent / "shared" / "data"))
COUNTS = (12, 20, 40, 74, 150)
NOISE = 0.5
DERIVED = ("phr_grid_nice_a", "rpcfit_s1_test", "rpcfit_s1_train", "s1_grd_iw")
"""Sets without noise of their own."""
MEASURED = ("ikonos_lines", "ventoux_lines", "kastoria_1925", "maplat_fushimijo")
PLAIN = ("affine", "dlt", "projective", "quadratic", "cubic")
FEW = (12, 20)
GA_COUNTS, GA_SPLITS = (20, 40, 74), 1


@dataclass(frozen=True)
class Split:
    """One split: independent RMSE of auto and of plain structures, and RMSE predicted by auto."""

    auto: float
    predicted: float
    plain: dict[str, float]
    pole: bool
    seconds: float


def put(page: str, text: str, *, write: bool) -> None:
    """Print a page of docs/evidence, and renew it if asked to."""
    sys.stdout.write(text)
    if write:
        (ROOT / "docs" / "evidence" / f"{page}.md").write_text(text.rstrip() + "\n",
                                                               encoding="utf-8")


def names() -> list[str]:
    """Return the available sets."""
    return [*SCENES, OLD_MAP, *(name for name in (*DERIVED, *MEASURED) if (DATA / name).is_dir())]


@lru_cache(maxsize=4)
def _read(name: str) -> Points:
    return read(DATA / name / "points.csv", crs="local").points


def split(name: str, count: int, seed: int) -> tuple[Points, Points]:
    """Return control and check points together, and independent points."""
    rng = np.random.default_rng([count, seed])
    if name in SCENES:
        points = simulate_scene(name, seed=seed, n_points=count + 150).points
    elif name == OLD_MAP:
        points = simulate_map(seed=seed, n_points=count + 150).points
    else:
        points = _read(name)
    image = points.image + (NOISE * rng.standard_normal(points.image.shape)
                            if name in DERIVED else 0.0)
    points = Points(points.ids, image, points.ground)
    order = rng.permutation(len(points))
    return points.take(order[:count]), points.take(order[count:count + 300])


def measure(job: tuple[str, int, int]) -> Split | None:
    """Return one split; None if the set has not enough points."""
    name, count, seed = job
    mine, independent = split(name, count, seed)
    if len(independent) < 30:
        return None
    control, heights = FeatureSet(mine), heights_of(mine)
    start = time.perf_counter()
    choice, errors = choose(control, heights), repeated(control, heights)
    seconds = time.perf_counter() - start
    assert choice is not None
    chosen = choice.chosen.fit
    below = chosen.model.denominators(chosen.adjustment.coefficients,
                                      chosen.scaling.ground(independent.ground))
    return Split(
        rmse_of(chosen.errors(independent)), float("nan") if errors is None else rmse_of(errors),
        {one.name: rmse_of(one.fit.errors(independent)) for one in choice.judged
         if one.name in PLAIN}, below is not None and bool((below <= 0).any()), seconds)


def papers(job: tuple[str, int, int]) -> tuple[float, float]:
    """Return the independent RMSE of the GA on check RMSE, and of auto, on one split."""
    name, count, seed = job
    mine, independent = split(name, count, seed)
    roles = ["control", "check"] * count
    points = Points(mine.ids + independent.ids, np.concatenate([mine.image, independent.image]),
                    np.concatenate([mine.ground, independent.ground]), None,
                    (*roles[:count], *["independent"] * len(independent)))
    problem = "rfm-terms" if heights_of(mine) else "poly-terms"
    found = [run(problem, features=FeatureSet(points), solver=solver).rmse["independent"]
             for solver in ("ga", None)]
    return tuple(one.total if one else float("nan") for one in found)


def heights_of(points: Points) -> bool:
    """Return whether points have heights that differ."""
    z = points.ground[:, 2]
    return not np.isnan(z).any() and bool(np.ptp(z) > 0)


def rmse_of(errors: FloatArray) -> float:
    """Return the RMSE of errors, shape (n, 2)."""
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


@dataclass(frozen=True)
class Row:
    """All splits of one set and one number of points."""

    name: str
    count: int
    splits: tuple[Split, ...]

    @property
    def best(self) -> tuple[str, float]:
        """The plain structure with the least median, chosen with hindsight."""
        medians = {name: median(s.plain.get(name, float("inf")) for s in self.splits)
                   for name in PLAIN}
        best = min(medians, key=lambda name: medians[name])
        return best, medians[best]

    @property
    def ratio(self) -> float:
        """Ratio of the median of auto to that of the best plain structure."""
        return median(s.auto for s in self.splits) / self.best[1]

    @property
    def worst(self) -> float:
        """Greatest ratio to the best plain structure of the split."""
        return max(s.auto / min(s.plain.values()) for s in self.splits)

    @property
    def honesty(self) -> float:
        """Median of independent divided by predicted RMSE."""
        return median(s.auto / s.predicted for s in self.splits)


def rows(wanted: list[str], counts: list[int], splits: int, processes: int) -> Iterator[Row]:
    """Yield set after set."""
    with ProcessPoolExecutor(processes) as pool:
        for name in wanted:
            for count in counts:
                jobs = [(name, count, seed) for seed in range(splits)]
                done = [one for one in pool.map(measure, jobs) if one is not None]
                if done:
                    yield Row(name, count, tuple(done))


def table(found: list[Row]) -> str:
    """Return the figures of every set and number of points."""
    return "\n".join([
        "| set | points | best plain | px | auto px | ratio | worst split | "
        "independent / predicted | seconds |", "|---|---:|---|---:|---:|---:|---:|---:|---:|",
        *map(line, found)])


def line(row: Row) -> str:
    """Return a row of the table."""
    name, value = row.best
    return (f"| {row.name} | {row.count} | {name} | {value:.2f} | "
            f"{median(s.auto for s in row.splits):.2f} | {row.ratio:.2f} | {row.worst:.2f} | "
            f"{row.honesty:.2f} | {median(s.seconds for s in row.splits):.1f} |")


def verdict(found: list[Row]) -> str:
    """Return what was required next to what was measured."""
    few = [row.ratio for row in found if row.count in FEW]
    over = [row for row in found if row.ratio > 1.05]
    all_splits = [(row, s) for row in found for s in row.splits]
    bad = sum(s.auto > 1.5 * min(s.plain.values()) for _, s in all_splits)
    floors = [median(s.auto for s in row.splits) / (NOISE * np.sqrt(2 * (1 + 10 / row.count)))
              for row in found if row.name in SCENES and row.count >= 74]
    honest = median(s.auto / s.predicted for _, s in all_splits)
    named = ", ".join(f"{row.name} at {row.count} ({row.ratio:.2f})" for row in over) or "none"
    lines = [
        "| what | required | measured |", "|---|---|---|",
        f"| ratio to the best plain structure in hindsight, median over sets | at most 1.00 | "
        f"{median(row.ratio for row in found):.2f} |",
        f"| the same at {' and '.join(map(str, FEW))} points | at most 0.95 | "
        f"{f'{median(few):.2f}' if few else '-'} |",
        f"| the same on every set | at most 1.05 | above it: {named} |",
        f"| splits with a pole | 0 | {sum(s.pole for _, s in all_splits)} of {len(all_splits)} |",
        "| splits worse than 1.5 times the best plain structure of that split | 0 | "
        f"{bad} of {len(all_splits)}; worst {max(row.worst for row in found):.2f} |",
        "| scenes at 74 points and more: ratio to noise sqrt(1 + 10/n), worst | at most 1.10 | "
        f"{f'{max(floors):.2f}' if floors else '-'} |",
        "| independent divided by predicted RMSE, median over splits | 0.90 to 1.15 | "
        f"{honest:.2f} |",
        "| seconds, 74 points, median | less than 10 | "
        f"{_seconds(found)} |"]
    return "\n".join(lines)


def rules(found: list[Row]) -> str:
    """Return how often auto and each plain structure are much worse than the best of the split."""
    few = [s for row in found if row.count in FEW for s in row.splits]
    oracle = [s.plain.get(row.best[0], float("inf")) for row in found if row.count in FEW
              for s in row.splits]
    lines = ["| rule | splits worse than 1.5 times the best of the split, at "
             f"{' and '.join(map(str, FEW))} points | worst |", "|---|---:|---:|"]
    for name, errors in (("auto", [s.auto for s in few]), *(
            (name, [s.plain.get(name, float("inf")) for s in few])
            for name in ("affine", "quadratic", "cubic")),
            ("the best of the set in hindsight", oracle)):
        ratios = [error / min(s.plain.values()) for error, s in zip(errors, few, strict=True)]
        worst = f"{max(ratios):.1f}" if max(ratios) < float("inf") else "not determined"
        lines.append(f"| {name} | {sum(r > 1.5 for r in ratios)} of {len(ratios)} | {worst} |")
    return "\n".join(lines)


def _seconds(found: list[Row]) -> str:
    seconds = [s.seconds for row in found if row.count == 74 for s in row.splits]
    return f"{median(seconds):.1f}" if seconds else "-"


def against_papers(wanted: list[str], processes: int) -> str:
    """Return the comparison with the papers' GA."""
    ratios = {}
    with ProcessPoolExecutor(processes) as pool:
        for name in wanted:
            jobs = [(name, count, seed) for count in GA_COUNTS for seed in range(GA_SPLITS)]
            ratios[name] = median(auto / ga for ga, auto in pool.map(papers, jobs))
    lines = ["| set | independent RMSE of auto divided by that of the GA, median |", "|---|---:|"]
    lines += [f"| {name} | {ratio:.2f} |" for name, ratio in ratios.items()]
    return "\n".join([*lines, f"| median over sets (required: at most 0.75) | "
                              f"{median(ratios.values()):.2f} |"])


CONSTANTS = (
    *((posterior, name) for name in ("SIZES", "TYPICAL", "FALLS", "RELIEFS", "SPREAD", "DRAWS")),
    *((portfolio, name) for name in ("BETTER", "CLEARLY")))


def sensitivity(wanted: list[str], splits: int) -> str:
    """Return the ratio to the best plain structure with each constant halved and doubled."""
    jobs = [(name, count, seed) for name in wanted for count in (12, 20, 40)
            for seed in range(splits)]
    lines = ["| constant | halved | as it is | doubled |", "|---|---:|---:|---:|"]
    as_is = _ratio(jobs)
    for module, constant in CONSTANTS:
        value = getattr(module, constant)
        changed = []
        for factor in (0.5, 2.0):
            new = factor * np.asarray(value)
            setattr(module, constant, int(new) if isinstance(value, int) else new)
            changed.append(_ratio(jobs))
        setattr(module, constant, value)
        lines.append(f"| `{constant}` | {changed[0]:.3f} | {as_is:.3f} | {changed[1]:.3f} |")
    return "\n".join(lines)


def _ratio(jobs: list[tuple[str, int, int]]) -> float:
    """Return the median over splits of the ratio of auto's RMSE to the best plain one."""
    found = []
    for name, count, seed in jobs:
        mine, independent = split(name, count, seed)
        choice = choose(FeatureSet(mine), heights_of(mine))
        assert choice is not None
        found.append(rmse_of(choice.chosen.fit.errors(independent))
                     / min(rmse_of(one.fit.errors(independent)) for one in choice.judged
                           if one.name in PLAIN))
    return median(found)


def main() -> None:
    """Print or write the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="sets; by default all")
    parser.add_argument("--counts", type=int, nargs="+", default=list(COUNTS))
    parser.add_argument("--splits", type=int, default=20)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--write", action="store_true",
                        help="write docs/evidence/honest-accuracy.md")
    asked = parser.parse_args()
    wanted = asked.names or names()
    found = []
    for row in rows(wanted, asked.counts, asked.splits, asked.processes):
        found.append(row)
        sys.stderr.write(line(row) + "\n")
    sys.stderr.write(verdict(found) + "\n")
    papers_table = against_papers(wanted, asked.processes)
    sys.stderr.write(papers_table + "\n")
    constants = sensitivity(wanted, min(asked.splits, 2))
    text = f"""# Honest accuracy

Made by `python -m benchmarks.accuracy --write`: {asked.splits} splits of each set and number of
points. Points are those in control and check together; up to 300 others are independent. The
best plain structure (affine, DLT or projective, quadratic, cubic) is chosen with hindsight, by the
median of its independent RMSE over all splits. The embedded scenes are simulated. Sets derived
from sensor models have Gaussian noise of {NOISE} px. Seconds are those of one process on a busy
machine.

## Requirement and measurement

{verdict(found)}

The requirement is missed only with 12 points and with 20. So few points do not tell which structure
will be best on that very split, and the best of five in hindsight is partly best by luck. No rule
can promise it. Take the structure that is best for the set and the number of points, which nobody
knows beforehand: even that is sometimes much worse than the best of the split.

{rules(found)}

## Against the papers' GA

`rfm-terms` with `--solver ga` on check RMSE (`poly-terms` where there are no heights). Half of the
points are check points. {GA_SPLITS} of the splits at {', '.join(map(str, GA_COUNTS))} points each.

{papers_table}

## Constants

The median over splits of auto's independent RMSE divided by that of the best plain structure of
the split, at 12, 20 and 40 points. Each constant of `termsel.adjustment.posterior` and of
`termsel.candidates.portfolio` is halved and doubled.

{constants}

## All sets

{table(found)}
"""
    put("honest-accuracy", text, write=asked.write)


if __name__ == "__main__":
    main()
