"""Whether points at planned places help more than others, by really adding them.

``python -m benchmarks.plan --write`` makes docs/evidence/plan.md. From a simulated scene some
points are drawn, anywhere or in one half of the image. Five more are added: those that
`termsel plan` ranks first, those in the largest gaps (each as far from all points as possible), or
any. The regularised cubic is fitted again, and compared with the true sensor all over the image.
"""

from __future__ import annotations

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from statistics import mean, median

import numpy as np

import termsel
from benchmarks.sets import put
from termsel.auto.methods import named
from termsel.core.threads import one_blas_thread
from termsel.data.features import FeatureSet, FloatArray, Points
from termsel.fitting.fit import Fit
from termsel.fitting.next_places import rank_places
from termsel.simulate import scene_truth, simulate_scene
from termsel.simulate.catalogue import SCENES

COUNTS = (8, 12, 20, 40)
ADDED, CANDIDATES, TRUTH = 5, 60, 300
RULES = ("planned", "largest gap", "any")
LAYOUTS = ("anywhere", "one half")


def fitted(points: Points) -> Fit:
    """Return the regularised cubic of points."""
    candidate = named("regularised-cubic")
    assert candidate is not None
    return termsel.fit(FeatureSet(replace(points, roles=())), candidate)


def gaps(mine: FloatArray, places: FloatArray) -> list[int]:
    """Return the places that are each farthest from all points and places before them."""
    chosen: list[int] = []
    for _ in range(ADDED):
        others = np.concatenate([mine, places[chosen]])
        away = np.linalg.norm(places[:, None] - others, axis=2).min(axis=1)
        chosen.append(int(np.argmax(away)))
    return chosen


@one_blas_thread
def errors(name: str, layout: str, count: int, seed: int) -> dict[str, float]:
    """Return the RMSE against the true sensor [px]: before, and after each rule's points."""
    points = simulate_scene(name, seed=seed, n_points=3 * count + CANDIDATES + TRUTH).points
    rng = np.random.default_rng([seed, count])
    order = rng.permutation(len(points))
    spare, truth = order[TRUTH:TRUTH + CANDIDATES], order[:TRUTH]
    rest = order[TRUTH + CANDIDATES:]
    if layout == "one half":
        rest = rest[points.image[rest, 1] < SCENES[name].image_size[1] / 2]
    mine = rest[:count]
    ground = points.ground[truth]
    image = scene_truth(name, seed=seed).sensor.project(ground)

    def rmse(which: FloatArray) -> float:
        wrong = fitted(points.take(which)).project(ground) - image
        return float(np.sqrt((wrong**2).sum(axis=1).mean()))

    first = fitted(points.take(mine))
    added = {"planned": rank_places(first, points.ground[spare], ground, ADDED).order,
             "largest gap": gaps(points.image[mine], points.image[spare]),
             "any": rng.permutation(CANDIDATES)[:ADDED]}
    return {"before": rmse(mine),
            **{rule: rmse(np.concatenate([mine, spare[which]])) for rule, which in added.items()}}


def rows(counts: list[int], splits: int,
         processes: int) -> tuple[list[str], dict[str, list[float]]]:
    """Return the rows of the table, and the gains of all splits by rule."""
    lines, ratios = [], {rule: [] for rule in RULES}
    for layout in LAYOUTS:
        for count in counts:
            jobs = [(name, layout, count, seed) for name in SCENES for seed in range(splits)]
            with ProcessPoolExecutor(processes) as pool:
                found = list(pool.map(errors, *zip(*jobs, strict=True)))
            cells = [f"{median(one[key] for one in found):.2f}" for key in ("before", *RULES)]
            against = [mean(one["planned"] < one[rule] for one in found) for rule in RULES[1:]]
            lines.append(f"| {layout} | {count} | " + " | ".join(cells) + " | "
                         + " | ".join(f"{100 * share:.0f} %" for share in against) + " |")
            sys.stderr.write(lines[-1] + "\n")
            for rule in RULES:
                ratios[rule] += [one[rule] / one["before"] for one in found]
    return lines, ratios


def main() -> None:
    """Print or write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--counts", type=int, nargs="+", default=list(COUNTS))
    parser.add_argument("--splits", type=int, default=12)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--write", action="store_true", help="write docs/evidence/plan.md")
    asked = parser.parse_args()
    lines, ratios = rows(asked.counts, asked.splits, asked.processes)
    table = "\n".join([
        "| points lie | points | before | planned | largest gap | any | planned better than gap | "
        "than any |", "|---|---:|---:|---:|---:|---:|---:|---:|", *lines])
    after = {rule: median(values) for rule, values in ratios.items()}
    verdict = "\n".join([
        "| what | required | measured |", "|---|---|---|",
        *(f"| RMSE after planned points by RMSE before, median over all splits | below that of "
          f"{rule} ({after[rule]:.3f}) | {after['planned']:.3f} |" for rule in RULES[1:])])
    text = f"""# Where to measure next

Made by `python -m benchmarks.plan --write`: {asked.splits} splits of each embedded scene, which
are simulated. {ADDED} of {CANDIDATES} possible places are measured in addition. The RMSE is that
against the true sensor at {TRUTH} places all over the image [px], medians over the splits. The
model is the regularised cubic.

## Requirement and measurement

{verdict}

## All numbers of points

{table}
"""
    put("plan", text, write=asked.write)


if __name__ == "__main__":
    main()
