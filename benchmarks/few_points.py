"""Few points: auto next to the plain structure that is best in hindsight.

    python -m benchmarks.few_points [SET ...] [--counts 6 8 10 12] [--splits 12]

Sets are those of `benchmarks.sets`, the simulated maps of `benchmarks.old_maps`, and images that
are exactly affine or projective. A ratio is that of medians over splits; the table ends with its
median over sets.
"""

from __future__ import annotations

import argparse
import sys
from statistics import median

import numpy as np

from benchmarks.old_maps import MAPS, drawn
from benchmarks.sets import names, rmse_of
from termsel.candidates.portfolio import choose
from termsel.candidates.structures import named
from termsel.errors import TermselError
from termsel.measurements.control import Control
from termsel.measurements.features import FeatureSet, Points

PLAIN = ("affine", "projective", "dlt", "quadratic")
EXACT = ("affine, space", "affine, plane", "projective, plane")
NOISE = 0.5


def exact(kind: str, count: int, seed: int) -> Points:
    """Return points of an image of 4000 px that is of one kind, but for noise."""
    rng = np.random.default_rng([count, seed])
    at = rng.uniform(-1.0, 1.0, (count, 3))
    relief = 0.1 * at[:, 2:] * rng.normal(0, 0.4, 2) * ("space" in kind)
    image = 2000.0 * (at[:, :2] + relief)
    if kind.startswith("projective"):
        image /= 1.0 + at[:, :2] @ rng.normal(0, 0.05, (2, 1))
    ground = at * [20e3, 20e3, 2e3 if "space" in kind else np.nan]
    return Points(tuple(map(str, range(count))), image + rng.normal(0, NOISE, (count, 2)), ground)


def split(name: str, count: int, seed: int) -> tuple[Points, Points]:
    """Return control and independent points."""
    if name not in EXACT:
        return drawn(name, count, seed)
    points, first = exact(name, count + 150, seed), np.arange(count + 150) < count
    return points.take(first), points.take(~first)


def errors_of(name: str, count: int, seed: int) -> dict[str, float]:
    """Return the independent RMSE [px] of auto and of the plain structures."""
    mine, independent = split(name, count, seed)
    control = Control.of(FeatureSet(mine))
    choice, found = choose(control), dict.fromkeys(("auto", *PLAIN), float("inf"))
    if choice is not None:
        found["auto"] = rmse_of(choice.chosen.fit.errors(independent))
    for plain in PLAIN:
        candidate = named(plain)
        if candidate is not None and candidate.declines(control) is None:
            try:
                found[plain] = rmse_of(candidate.fit_control(control).errors(independent))
            except TermselError:  # not determined
                continue
    return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("names", nargs="*", help="sets; by default all")
    parser.add_argument("--counts", type=int, nargs="+", default=[6, 8, 10, 12])
    parser.add_argument("--splits", type=int, default=12)
    asked = parser.parse_args()
    ratios: dict[int, list[float]] = {count: [] for count in asked.counts}
    sys.stdout.write("| set | points | best | px | auto px | ratio |\n"
                     "|---|---:|---|---:|---:|---:|\n")
    for name in asked.names or dict.fromkeys((*names(), *MAPS, *EXACT)):
        for count in asked.counts:
            every = [errors_of(name, count, seed) for seed in range(asked.splits)]
            medians = {kind: median(one[kind] for one in every) for kind in every[0]}
            best = min(PLAIN, key=medians.__getitem__)
            ratios[count].append(medians["auto"] / medians[best])
            sys.stdout.write(f"| {name} | {count} | {best} | {medians[best]:.2f} | "
                             f"{medians['auto']:.2f} | {ratios[count][-1]:.2f} |\n")
    for count, found in ratios.items():
        sys.stdout.write(f"| median over sets | {count} | | | | {median(found):.2f} |\n")


if __name__ == "__main__":
    main()
