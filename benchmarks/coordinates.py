"""Effect of the coordinates in which a model is fitted, with few points and with many.

``python -m benchmarks.coordinates`` prints the tables, ``--write`` puts them into
docs/evidence/coordinates.md; ``--seeds N`` makes it shorter. Needs pyproj.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from statistics import median

from termsel.auto.auto import Auto
from termsel.data.features import FeatureSet, Points
from termsel.data.fit_data import FitData
from termsel.data.scaling import make_scaling
from termsel.fitting.least_squares import fit
from termsel.models.base import SensorModel
from termsel.models.polynomial import Affine, Polynomial3D
from termsel.models.projective import DLT3D
from termsel.runs.fit_crs import fit_crs_of
from termsel.simulate import simulate_scene
from termsel.simulate.catalogue import SCENES

SYSTEMS = ("geodetic", "projected", "geocentric")
COUNTS = (6, 8, 12, 16, 24, 40)
MODELS: dict[str, SensorModel] = {
    "affine": Affine(), "DLT": DLT3D(), "quadratic": Polynomial3D(degree=2)}
AUTO = "chosen by `auto`"
INDEPENDENT = 150
PAGE = Path(__file__).parents[1] / "docs" / "evidence" / "coordinates.md"


@lru_cache
def scene(name: str, seed: int, count: int) -> tuple[FeatureSet, Points]:
    """Return so many control points, and independent ones from another draw."""
    control = simulate_scene(name, seed=seed, n_points=count, n_lines=0)
    others = simulate_scene(name, seed=1000 + seed, n_points=INDEPENDENT, n_lines=0)
    return control, others.points


def errors(name: str, model: str, count: int, seed: int) -> dict[str, float] | None:
    """Return the independent RMSE [px] by system; None if the points are too few."""
    control, independent = scene(name, seed, count)
    found = {}
    for system in SYSTEMS:
        fit_crs = fit_crs_of(system, control)
        own = replace(control, fit_crs="" if fit_crs == control.crs else fit_crs)
        if model == AUTO:
            choice = Auto().choose(FitData.of(own, True))
            fitted = choice.chosen if choice else None
        else:
            fitted = fit(MODELS[model], own, make_scaling(own))
        if fitted is None or not fitted.adjustment.redundancy > 0:
            return None
        rmse = fitted.rmse(independent)
        assert rmse is not None
        found[system] = rmse.total
    return found


def rows(name: str, seeds: int) -> Iterator[str]:
    """Yield the rows of a scene's table."""
    for model in (*MODELS, AUTO):
        for count in COUNTS:
            each = [errors(name, model, count, seed) for seed in range(1, seeds + 1)]
            there = [one for one in each if one is not None]
            if len(there) < len(each):
                continue
            middle = [median(one[system] for one in there) for system in SYSTEMS]
            best = min(middle)
            cells = [f"**{value:.2f}**" if f"{value:.2f}" == f"{best:.2f}" else f"{value:.2f}"
                     for value in middle]
            wins = sum(one["geocentric"] < min(one["geodetic"], one["projected"])
                       for one in there)
            yield f"| {model} | {count} | " + " | ".join(cells) + f" | {wins} of {len(there)} |"


def page(seeds: int) -> str:
    """Return the tables."""
    parts = []
    for name in SCENES:
        print(f"{name} ...", file=sys.stderr)
        parts += [f"### {name}", "",
                  "| model | control points | geodetic | projected | geocentric | "
                  "geocentric best |",
                  "|---|---:|---:|---:|---:|---:|", *rows(name, seeds), ""]
    return "\n".join(parts)


def main() -> None:
    """Print the tables or put them between the marks of the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="renew docs/evidence/coordinates.md")
    parser.add_argument("--seeds", type=int, default=20, help="draws of points and noise")
    asked = parser.parse_args()
    tables = page(asked.seeds)
    if not asked.write:
        print(tables)
        return
    before, begin, rest = PAGE.read_text(encoding="utf-8").partition("<!-- tables -->\n")
    _, end, after = rest.partition("<!-- end of tables -->")
    PAGE.write_text(f"{before}{begin}\n{tables}\n{end}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
