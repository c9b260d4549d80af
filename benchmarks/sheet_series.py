"""Sheets of few points: does the paper of their series help, on simulated and on real maps?

    python -m benchmarks.sheet_series [--few 4] [--series 5]

A simulated series has 12 sheets: of 4 of them 20 points are measured, of the others few. Paper is
stretched and sheared alike but for some 0.1 %, turned on the scanner, and deformed locally. Of the
real maps slv_maps, each in turn has few points, and all other maps are taken for its series, though
they are none: what they share is little, and nothing may get worse for it.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

import termsel
from benchmarks.sets import DATA
from termsel.core.threads import one_blas_thread
from termsel.data.features import FeatureSet, Points
from termsel_photos.sheets.paper import matrix_of
from termsel_photos.sheets.series_file import in_series, series_of

FloatArray = NDArray[np.float64]

SHEETS, WITH_MANY, MANY, TRUTH = 12, (1, 5, 6, 10), 20, 200
EXTENT = 15_000.0
"""Half extent of a sheet [m]."""
NOISE, LOCAL = 2.0, 3.0
"""Of measurements, and amplitude of the local deformation [px]."""
USUAL = np.array([0.001, 0.005, 0.004, 0.002])
"""Standard deviations of scale, turn, stretch and shear among series."""
AMONG_SHEETS = np.array([0.001, 0.005, 0.001, 0.0007])
REAL_CRS = "EPSG:3111"
"""Of the real maps: Vicgrid."""

Case = tuple[FeatureSet, FloatArray, FloatArray]


def simulated_sheet(count: int, series: int, number: int) -> Case:
    """Return the points of a sheet, and further places with where they are measured."""
    rng = np.random.default_rng([60, series, number])
    shared = np.random.default_rng([61, series]).normal(0.0, USUAL)
    values = shared + rng.normal(0.0, AMONG_SHEETS) + [np.log(0.1), 0.0, 0.0, 0.0]
    plan = rng.uniform(-EXTENT, EXTENT, (count + TRUTH, 2))
    image = plan @ matrix_of(values).T
    waves = 2.0 * np.pi * image / np.ptp(image, axis=0).max()
    phases = rng.uniform(0.0, 2.0 * np.pi, 4)
    local = np.column_stack([
        np.sin(waves[:, 0] + phases[0]) * np.cos(0.7 * waves[:, 1] + phases[1]),
        np.sin(waves[:, 1] + phases[2]) * np.cos(0.8 * waves[:, 0] + phases[3])])
    image = image + LOCAL * local + NOISE * rng.standard_normal(image.shape)
    measured = image[:, ::-1] * [-1.0, 1.0] + 2000.0
    corner = np.array([4e5 + 3e4 * (number % 4), 5e6 + 3e4 * (number // 4)])
    ground = np.column_stack([plan + corner, np.full(len(plan), np.nan)])
    points = Points(tuple(f"P{i}" for i in range(count)), measured[:count], ground[:count])
    return FeatureSet(points, crs="EPSG:32632"), ground[count:], measured[count:]


def simulated(few: int, series: int) -> Iterator[tuple[Case, FeatureSet]]:
    """Yield sheets of few points, and the same with what their series tells."""
    sheets = [simulated_sheet(MANY if number in WITH_MANY else few, series, number)
              for number in range(SHEETS)]
    shared = series_of([sheet[0] for sheet in sheets], "")
    for number in set(range(SHEETS)) - set(WITH_MANY):
        yield sheets[number], in_series(sheets[number][0], shared)


def real(few: int) -> Iterator[tuple[Case, FeatureSet]]:
    """Yield the real maps with few points, and the same with what all others tell."""
    maps = [termsel.read(file, crs="EPSG:4326")
            for file in sorted((DATA / "real" / "slv_maps").glob("*.csv"))]
    for number, features in enumerate(maps):
        order = np.random.default_rng(number).permutation(len(features.points))
        if len(order) < few + 4:
            continue
        control = replace(features, points=features.points.take(order[:few]), fit_crs=REAL_CRS)
        rest = features.points.take(order[few:])
        others = [other for i, other in enumerate(maps) if i != number]
        yield (control, rest.ground, rest.image), in_series(control, series_of(others, REAL_CRS))


@one_blas_thread
def figures(case: Case, sheet: FeatureSet) -> tuple[float, float, float, bool]:
    """Return the RMSE alone and in the series [px], the predicted one, and whether it holds."""
    features, ground, image = case
    errors = []
    for control in (features, sheet):
        try:
            result = termsel.run(features=control)
        except termsel.TermselError:
            errors.append(np.nan)
            continue
        seen = result.project(ground)
        errors.append(float(np.sqrt(((seen - image) ** 2).sum(axis=1).mean())))
    predicted = result.predicted
    assert predicted is not None
    return errors[0], errors[1], predicted.rmse, predicted.low <= errors[1] <= predicted.high


def row(name: str, cases: Iterator[tuple[Case, FeatureSet]]) -> str:
    """Return a row of the table."""
    table = np.array([figures(*case) for case in cases])
    table = table[np.isfinite(table).all(axis=1)]
    ratios = table[:, 1] / table[:, 0]
    return (f"{name:12s} {len(table):4d} {np.median(table[:, 0]):8.2f} "
            f"{np.median(table[:, 1]):8.2f} {np.exp(np.log(ratios).mean()):6.2f} "
            f"{np.mean(ratios > 1.05):6.0%} {np.mean(ratios < 1 / 1.05):6.0%} "
            f"{np.exp(np.log(table[:, 2] / table[:, 1]).mean()):9.2f} {table[:, 3].mean():6.0%}")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--few", type=int, nargs="*", default=(3, 4, 6, 8))
    parser.add_argument("--series", type=int, default=5)
    options = parser.parse_args()
    print("points        n    alone  series  ratio worse better pred/true  holds")
    for few in options.few:
        cases = (case for series in range(options.series) for case in simulated(few, series))
        print(row(f"simulated {few}", cases), flush=True)
        if (DATA / "real" / "slv_maps").is_dir():
            print(row(f"slv_maps {few}", real(few)), flush=True)


if __name__ == "__main__":
    main()
