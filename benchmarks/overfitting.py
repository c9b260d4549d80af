"""Is a lower selection RMSE a better model? Ten scenes of third order with 1,000 check points each.

``python -m benchmarks.overfitting --kept FILE`` prints the page; what FILE holds is not repeated,
and ``--write`` puts the page into docs/evidence. On each scene the GA and the local search by axis
minimise the selection RMSE of the RFM of 78 terms.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

import termsel
from benchmarks.sets import put, rmse_of
from termsel import FeatureSet, Task
from termsel.core.threads import one_blas_thread
from termsel.data.features import BoolArray, FloatArray
from termsel.simulate import simulate_scene

SCENES = tuple((name, seed) for name in (
    "ikonos-hamedan", "spot-isfahan", "irs1c-mashad", "geoeye-tehran", "cartosat-hyderabad")
    for seed in (901, 902))
ROLES = (24, 24, 1000)
RUNS, EVALUATIONS, LOCAL = 10, 20_000, 1_000_000
"""Runs of the GA, evaluations of each, and those of the local search."""
RESAMPLES = 2000


@dataclass(frozen=True)
class Row:
    """One scene: selection and independent RMSE [px] of the GA, of local search, of plain."""

    name: str
    ga: FloatArray  # (RUNS, 2)
    local: tuple[float, float]
    interval: tuple[float, float]  # of the independent RMSE of local search, by its points
    quadratic: float

    @property
    def correlation(self) -> float:
        """Rank correlation of selection and independent RMSE, of all runs."""
        return float(spearmanr(*np.vstack([self.ga, self.local]).T).statistic)


def measured(features: FeatureSet, task: Task, genes: BoolArray) -> FloatArray:
    """Return the squared errors of the independent check points [px^2], shape (n,)."""
    result = termsel.assess(termsel.GivenGenes(genes), task)
    judging = features.points.take(np.array(features.points.roles) == "independent")
    return np.asarray((result.fit.errors(judging) ** 2).sum(axis=1))


@one_blas_thread
def row(name: str, seed: int) -> Row:
    """Return what the searches find on a scene."""
    features = simulate_scene(name, seed=seed, roles=ROLES, n_lines=0)
    task = termsel.prepare("rfm-terms", features=features)
    ga = []
    for run in range(RUNS):
        found = termsel.search(task.problem, task.solver, seed=run + 1, evaluations=EVALUATIONS)
        ga.append((found.objectives[0],
                   np.sqrt(measured(features, task, found.genes).mean())))
    local = termsel.search(task.problem, termsel.prepare("rfm-terms", solver="swap").solver,
                           seed=seed, evaluations=LOCAL)
    squares = measured(features, task, local.genes)
    rng = np.random.default_rng(seed)
    means = [squares[rng.integers(len(squares), size=len(squares))].mean() for _ in range(400)]
    judging = np.array(features.points.roles) == "independent"
    known = replace(features.points.take(~judging), roles=())
    plain = termsel.fit(FeatureSet(known, crs=features.crs), "quadratic")
    quadratic = rmse_of(plain.errors(features.points.take(judging)))
    low, high = np.sqrt(np.quantile(means, [0.025, 0.975]))
    return Row(f"{name}, {seed}", np.array(ga),
               (float(local.objectives[0]), float(np.sqrt(squares.mean()))),
               (float(low), float(high)), quadratic)


def over_scenes(values: Sequence[float]) -> str:
    """Return the mean over scenes with its interval of 95 %, by resampling scenes."""
    rng, given = np.random.default_rng(0), np.array(values)
    means = given[rng.integers(len(given), size=(RESAMPLES, len(given)))].mean(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return f"{given.mean():.2f} ({low:.2f} to {high:.2f})"


def page(rows: Sequence[Row]) -> Iterator[str]:
    """Yield the lines of the page."""
    yield HEAD.format(runs=RUNS, evaluations=f"{EVALUATIONS:,}", local=f"{LOCAL:,}")
    yield ("| scene, seed | GA: check [px] | independent [px] | local search: check [px] | "
           "independent [px] | 95 % | quadratic: independent [px] | rank correlation |\n"
           "|---|---:|---:|---:|---:|---:|---:|---:|")
    for one in rows:
        check, independent = np.median(one.ga, axis=0)
        yield (f"| {one.name} | {check:.3f} | {independent:.3f} | {one.local[0]:.3f} | "
               f"{one.local[1]:.3f} | {one.interval[0]:.3f} to {one.interval[1]:.3f} | "
               f"{one.quadratic:.3f} | {one.correlation:.2f} |")
    medians = [np.median(one.ga, axis=0) for one in rows]
    check, ratio, plain, rank = (over_scenes(values) for values in (
        [one.local[0] / ga[0] for one, ga in zip(rows, medians, strict=True)],
        [one.local[1] / ga[1] for one, ga in zip(rows, medians, strict=True)],
        [one.local[1] / one.quadratic for one in rows], [one.correlation for one in rows]))
    yield TAIL.format(check=check, ratio=ratio, plain=plain, rank=rank)


def read(path: Path) -> dict[str, Row]:
    """Return the scenes that are done, by name."""
    said = json.loads(path.read_text())
    return {one["name"]: Row(**{**one, "ga": np.array(one["ga"]), "local": tuple(one["local"]),
                                "interval": tuple(one["interval"])}) for one in said}


def main() -> None:
    """Search, then print or write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--kept", type=Path, help="file of scenes that are done, to resume by")
    asked = parser.parse_args()
    kept = read(asked.kept) if asked.kept and asked.kept.is_file() else {}
    for name, seed in SCENES:
        if (key := f"{name}, {seed}") not in kept:
            kept[key] = row(name, seed)
            if asked.kept:
                asked.kept.write_text(json.dumps([
                    {**asdict(one), "ga": one.ga.tolist()} for one in kept.values()]))
        print(key, kept[key].local, file=sys.stderr)
    rows = list(kept.values())
    put("overfitting", "\n".join(page(rows)), write=asked.write)


HEAD = """# Is a lower selection RMSE a better model?

Made by `python -m benchmarks.overfitting --write`: ten simulated scenes of five sensors, each with
24 control, 24 check and **1,000 independent check points**. The RFM has all 78 terms to choose
from.

Two searches minimise the selection RMSE: the GA ({runs} runs of {evaluations} evaluations, without
local refinement; medians are shown) and a local search by axis, the solver `swap` with {local}
evaluations. Line and sample share no term, so it searches each axis by itself. The quadratic
polynomial is fitted to control and selection points. The rank correlation is that of check and
independent RMSE over all runs of a scene; intervals of 95 % are of the independent check points.
"""

TAIL = """
## Mixed over scenes

Means over the ten scenes, with intervals of 95 % by resampling scenes:

| what | mean |
|---|---:|
| selection RMSE of local search, to that of the GA | {check} |
| independent RMSE of local search, to that of the GA | {ratio} |
| independent RMSE of local search, to that of the quadratic polynomial | {plain} |
| rank correlation of selection and independent RMSE | {rank} |

What `swap` finds next to a proven optimum is on the page on
[the optimum of the RFM of 78 terms](gap-to-optimum.md).
"""


if __name__ == "__main__":
    main()
