"""Old maps: does a projection that the points choose help, and does the paper of a series?

``python -m benchmarks.sheet_series --write`` makes docs/evidence/map-series.md. A simulated series
has 12 sheets: of 4 of them 20 points are measured, of the others few. Paper is stretched and
sheared alike but for some 0.1 %, turned on the scanner, and deformed locally. Of the real maps
slv_maps, each in turn has few points, and all other maps, or those of like scale nearby, are taken
for its series, though they are none. With `--kept` a run resumes.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import Transformer

import termsel
from benchmarks.kept import resumed
from benchmarks.sets import DATA, put
from termsel.auto.auto import Auto
from termsel.core.errors import TermselError
from termsel.core.threads import one_blas_thread
from termsel.data.features import FeatureSet, Points
from termsel.data.fit_data import FitData
from termsel.fitting.accuracy import Predicted, predict_rmse_of_fit
from termsel_cameras.sheets.candidates import candidate_projections, candidates_of
from termsel_cameras.sheets.choosing import (
    as_probable_as_the_best,
    choose_by_points,
    rank_by_series,
)
from termsel_cameras.sheets.paper import matrix_of
from termsel_cameras.sheets.series import SHEET_OF_SERIES
from termsel_cameras.sheets.series_file import Series, series_of, with_series_columns

FloatArray = NDArray[np.float64]

MAPS = DATA / "real" / "slv_maps"
SHEETS, WITH_MANY, MANY, TRUTH = 12, (1, 5, 6, 10), 20, 200
FURTHER = range(100, 160)
"""Series whose intervals are counted, without the slower fits of sheets alone."""

EXTENT = 15_000.0
"""Half extent of a sheet [m]."""

NOISE, LOCAL = 2.0, 3.0
"""Of measurements, and amplitude of the local deformation [px]."""

USUAL = np.array([0.001, 0.005, 0.004, 0.002])
"""Standard deviations of scale, turn, stretch and shear among series."""

AMONG_SHEETS = np.array([0.001, 0.005, 0.001, 0.0007])
REAL_CRS = "EPSG:3111"
"""Of the real maps: Vicgrid."""

LIKE_SCALE, NEARBY = 2.0, 30_000.0
"""Ratio of scales, and distance of the middles [m], up to which maps may be sheets of a series."""

MAP_NOISE, MAP_LOCAL = 1.5, 2.0
"""Of points of a map that is drawn in a projection, and amplitude of its local deformation [px]."""

MAP_SIZES = ((0.6, 0.4), (3.0, 2.0), (12.0, 8.0))
"""Of maps that are drawn in a projection [deg]."""

MAP_WIDTH = 6000.0
"""Of their images [px]."""

PAPER_OF_MAP = np.array([0.0, 0.01, 0.006, 0.003])
"""Standard deviations of turn, stretch and shear of a map."""

MAP_COUNTS = (4, 6, 8, 12, 20)

DRAWN_SHEETS, DRAWN_MANY, DRAWN_FEW = 8, 18, 4
"""Sheets of a series that is drawn in a projection; points of three of them, and of the others."""

CANDIDATES = 8
"""Of the default list: the first of these, and the one of the simulated map."""

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


@lru_cache(maxsize=2)
def simulated_series(few: int, series: int) -> tuple[list[Case], Series]:
    """Return all sheets of a series, and what they tell of each other."""
    sheets = [simulated_sheet(MANY if number in WITH_MANY else few, series, number)
              for number in range(SHEETS)]
    return sheets, series_of([sheet[0] for sheet in sheets], "")


@one_blas_thread
def figures_of_sheet(few: int, series: int, number: int) -> dict[str, float]:
    """Return the RMSE [px] of a sheet of few points, alone and in its series."""
    sheets, shared = simulated_series(few, series)
    return figures(sheets[number], with_series_columns(sheets[number][0], shared))


@one_blas_thread
def figures_of_series(few: int, series: int) -> list[dict[str, float]]:
    """Return the figures of each sheet of few points by its series alone."""
    sheets, shared = simulated_series(few, series)
    return [of_series(with_series_columns(features, shared), ground, image)
            for number, (features, ground, image) in enumerate(sheets) if number not in WITH_MANY]


@lru_cache(maxsize=1)
def real_maps() -> list[FeatureSet]:
    """Return the real maps; none where they are not installed."""
    return [termsel.read(file, crs="EPSG:4326") for file in sorted(MAPS.glob("*.csv"))]


@one_blas_thread
def figures_of_map(few: int, number: int) -> dict[str, float]:
    """Return the RMSE [px] of a real map of few points, alone and with what all others tell."""
    maps = real_maps()
    points = maps[number].points
    order = np.random.default_rng(number).permutation(len(points))
    control = replace(maps[number], points=points.take(order[:few]), fit_crs=REAL_CRS)
    rest = points.take(order[few:])
    others = [other for i, other in enumerate(maps) if i != number]
    return figures((control, rest.ground, rest.image),
                   with_series_columns(control, series_of(others, REAL_CRS)))


@lru_cache(maxsize=1)
def scales_and_middles() -> tuple[FloatArray, FloatArray]:
    """Return the scale [px/m] and the middle [m] of each real map."""
    to_metres = Transformer.from_crs("EPSG:4326", REAL_CRS, always_xy=True)
    scales = []
    middles = []
    for features in real_maps():
        plan = np.column_stack(to_metres.transform(*features.points.ground[:, :2].T))
        middle = plan.mean(axis=0)
        image = features.points.image - features.points.image.mean(axis=0)
        slopes = np.linalg.lstsq(plan - middle, image, rcond=None)[0]
        scales.append(np.sqrt(abs(np.linalg.det(slopes))))
        middles.append(middle)
    return np.array(scales), np.array(middles)


def maps_like(number: int) -> list[int]:
    """Return the other real maps of like scale nearby, by their numbers."""
    scales, middles = scales_and_middles()
    ratios = np.abs(np.log(scales / scales[number]))
    distances = np.hypot(*(middles - middles[number]).T)
    is_like = (ratios <= np.log(LIKE_SCALE)) & (distances <= NEARBY)
    return [int(other) for other in np.flatnonzero(is_like) if other != number]


@one_blas_thread
def figures_of_like_map(few: int, number: int) -> dict[str, float]:
    """Return the RMSE [px] of a real map of few points: alone, with its like, and by auto of both.

    And the RMSE that auto predicts, and whether it takes the series. All are at points that are
    left out and no blunders.
    """
    maps = real_maps()
    points = maps[number].points
    order = np.random.default_rng(number).permutation(len(points))
    control = replace(maps[number], points=points.take(order[:few]), fit_crs=REAL_CRS)
    rest = points.take(order[few:])
    rest = rest.take(are_sound(number, rest))
    like = [maps[other] for other in maps_like(number)]
    sheet = with_series_columns(control, series_of(like, REAL_CRS))
    alone = termsel.run(features=control)
    result = termsel.run(features=sheet)
    # Four points of a projective model leave nothing to predict by.
    predicted = result.predicted or Predicted(np.nan, np.nan, np.nan)
    return {"alone": rmse(alone.project(rest.ground), rest.image),
            "series": of_series(sheet, rest.ground, rest.image)["series"],
            "auto": rmse(result.project(rest.ground), rest.image),
            "predicted": predicted.rmse, "low": predicted.low, "high": predicted.high,
            "borrows": float(result.strategy.chosen == SHEET_OF_SERIES.name)}


@lru_cache(maxsize=64)
def blunders_of_map(number: int) -> frozenset[str]:
    """Return the ids of the blunders that a run of all points of a real map finds."""
    return frozenset(outlier.id for outlier in termsel.run(features=real_maps()[number]).outliers)


def are_sound(number: int, points: Points) -> NDArray[np.bool_]:
    """Return which points of a real map are no blunders by a run of all its points."""
    blunders = blunders_of_map(number)
    return np.array([name not in blunders for name in points.ids])


@one_blas_thread
def figures_of_single_map(few: int, number: int) -> dict[str, float]:
    """Return the RMSE of auto at all points left out of a real map, and at those without blunders.

    Blunders are those that a run of all points finds. `few` points are fitted, or two thirds for 0.
    The RMSE predicted is that of auto [px].
    """
    features = real_maps()[number]
    points = features.points
    order = np.random.default_rng([64, number]).permutation(len(points))
    count = few or 2 * len(points) // 3
    rest = points.take(order[count:])
    result = termsel.run(features=features.with_(points=points.take(order[:count])))
    is_sound = are_sound(number, rest)
    predicted = result.predicted
    assert predicted is not None
    seen = result.project(rest.ground)
    return {"all": rmse(seen, rest.image), "sound": rmse(seen[is_sound], rest.image[is_sound]),
            "predicted": predicted.rmse, "low": predicted.low, "high": predicted.high}


def figures(case: Case, sheet: FeatureSet) -> dict[str, float]:
    """Return the RMSE of a sheet by auto alone and by its series, and the one predicted [px]."""
    features, ground, image = case
    try:
        alone = rmse(termsel.run(features=features).project(ground), image)
    except TermselError:
        alone = np.nan
    return {"alone": alone, **of_series(sheet, ground, image)}


def of_series(sheet: FeatureSet, ground: FloatArray, image: FloatArray) -> dict[str, float]:
    """Return the RMSE of a sheet by its series, and the one predicted [px]."""
    fitted = SHEET_OF_SERIES.fit(FitData.of(sheet))
    predicted = predict_rmse_of_fit(fitted, np.concatenate(fitted.errors_without_each[0]), 0)
    return {"series": rmse(fitted.project(ground), image), "predicted": predicted.rmse,
            "low": predicted.low, "high": predicted.high}


@one_blas_thread
def figures_of_projection(kind: str, count: int, number: int) -> dict[str, float]:
    """Return the RMSE at points left out [px] of the projection that `--crs auto` takes.

    And in degrees, as a run takes it by itself, of the least held-out error, of the best in
    hindsight; whether points show the projection, and the interval of the RMSE that is predicted.
    """
    features, left_out = (drawn_map if kind == "drawn" else left_out_of)(count, number)
    candidates = candidates_of([features], None, None)
    if kind == "real":
        candidates = candidates[:CANDIDATES]
    choice = choose_by_points([features], candidates)
    errors = {crs: rmse_in(features, crs, left_out)
              for crs in dict.fromkeys(["", *(tried.crs for tried in choice.ranked)])}
    plain = termsel.run(features=features)
    result = termsel.run(features=replace(features, fit_crs=choice.chosen.crs))
    predicted = result.predicted or Predicted(np.nan, np.nan, np.nan)
    least = min(choice.ranked, key=lambda tried: tried.rmse)
    # An interval is of new points that are measured as those fitted: those of real maps are.
    noise = MAP_NOISE * np.sqrt(2.0) if kind == "drawn" else 0.0
    return {"degrees": errors[""], "plain": rmse(plain.project(left_out.ground), left_out.image),
            "least": errors[least.crs], "chosen": errors[choice.chosen.crs],
            "hindsight": min(errors.values()), "told": float(len(choice.as_probable) == 1),
            "run": np.hypot(rmse(result.project(left_out.ground), left_out.image), noise),
            "low": predicted.low, "high": predicted.high}


def drawn_map(count: int, number: int) -> tuple[FeatureSet, Points]:
    """Return points of a map that is drawn in a projection, and further places without noise.

    Its meridian and parallels are not quite those of the middle of its points.
    """
    rng = np.random.default_rng([62, number])
    middle = np.array([rng.uniform(-10.0, 40.0), rng.uniform(35.0, 60.0)])
    size = np.array(MAP_SIZES[number % len(MAP_SIZES)])
    drawn_about = middle + rng.uniform(-0.5, 0.5, 2) * np.maximum(size, 1.0)
    projections = candidate_projections(drawn_about + np.array([[-0.5], [0.5]]) * size)
    true = projections[int(rng.integers(len(projections) - 1))]
    return drawn(true.crs, middle, size, rng.normal(0.0, PAPER_OF_MAP), count, rng)


def drawn(crs: str, middle: FloatArray, size: FloatArray, values: FloatArray, count: int,
          rng: np.random.Generator) -> tuple[FeatureSet, Points]:
    """Return points of a map in a projection, measured with noise, and further ones without.

    `size` is that of the map [deg]; `values` are those of its paper, for a width of `MAP_WIDTH`.
    The first four points are near its corners.
    """
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])
    shares = rng.uniform(-0.5, 0.5, (count + TRUTH, 2))
    shares[:4] = 0.44 * corners + rng.uniform(-0.05, 0.05, (4, 2))
    places = middle + shares * size
    to_plane = Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform
    plan = np.column_stack(to_plane(*places.T)) - np.array(to_plane(*middle))
    (left, _), (right, _) = (to_plane(middle[0] + side * size[0], middle[1])
                             for side in (-0.5, 0.5))
    upright = plan @ matrix_of(values).T * (MAP_WIDTH / abs(right - left))
    image = upright[:, ::-1] * [-1.0, 1.0] + MAP_WIDTH / 2.0
    phases = rng.uniform(0.0, 2.0 * np.pi, 2)
    image = image + MAP_LOCAL * np.sin(image[:, ::-1] / 900.0 + phases)
    image[:count] += MAP_NOISE * rng.standard_normal((count, 2))
    points = Points(tuple(f"P{i}" for i in range(len(places))), image,
                    np.column_stack([places, np.full(len(places), np.nan)]))
    is_measured = np.arange(len(places)) < count
    return FeatureSet(points.take(is_measured), crs="EPSG:4326"), points.take(~is_measured)


@one_blas_thread
def figures_of_drawn_series(number: int) -> list[dict[str, float]]:
    """Return the RMSE at further places [px] of the sheets of few points of a series.

    Alone as a run fits them, in the series whose projection all sheets choose, and in that of the
    right projection; the points show neither.
    """
    rng = np.random.default_rng([65, number])
    size = np.array(MAP_SIZES[0])
    corner = np.array([rng.uniform(-10.0, 40.0), rng.uniform(35.0, 60.0)])
    extent = np.array([corner, corner + size * [4.0, 2.0]])
    projections = candidate_projections(extent)
    true = projections[int(rng.integers(len(projections) - 1))]
    shared = rng.normal(0.0, PAPER_OF_MAP)
    sheets = []
    for sheet in range(DRAWN_SHEETS):
        values = shared + rng.normal(0.0, AMONG_SHEETS)
        middle = corner + size * [sheet % 4 + 0.5, sheet // 4 + 0.5]
        count = DRAWN_MANY if sheet < 3 else DRAWN_FEW
        sheets.append(drawn(true.crs, middle, size, values, count, rng))
    measured = [features for features, _ in sheets]
    candidates = candidates_of(measured, None, None)
    ranked = rank_by_series(measured, candidates)
    chosen = as_probable_as_the_best(ranked, candidates)[0]
    of_chosen, of_true = (series_of(measured, crs) for crs in (chosen.crs, true.crs))
    return [{"alone": rmse_of_run(features, places),
             "chosen": rmse_of_run(with_series_columns(features, of_chosen), places),
             "true": rmse_of_run(with_series_columns(features, of_true), places)}
            for features, places in sheets if len(features.points) == DRAWN_FEW]


def rmse_of_run(features: FeatureSet, places: Points) -> float:
    """Return the RMSE of a run of some features at further places [px]."""
    return rmse(termsel.run(features=features).project(places.ground), places.image)


def left_out_of(count: int, number: int) -> tuple[FeatureSet, Points]:
    """Return `count` points of a real map, two thirds for 0, and the rest without blunders."""
    features = real_maps()[number]
    order = np.random.default_rng([63, number]).permutation(len(features.points))
    fitted = count or 2 * len(order) // 3
    left_out = features.points.take(order[fitted:])
    return (features.with_(points=features.points.take(order[:fitted])),
            left_out.take(are_sound(number, left_out)))


def rmse_in(features: FeatureSet, crs: str, left_out: Points) -> float:
    """Return the RMSE of auto in a projection at points left out [px]; infinite of none."""
    try:
        choice = Auto().choose(FitData.of(replace(features, fit_crs=crs)))
    except TermselError:
        return np.inf
    return np.inf if choice is None else rmse(choice.chosen.project(left_out.ground),
                                              left_out.image)


def rmse(seen: FloatArray, measured: FloatArray) -> float:
    """Return the root mean square distance [px]."""
    return float(np.sqrt(((seen - measured)**2).sum(axis=1).mean()))


def series_row(name: str, cases: Sequence[dict[str, float]]) -> str:
    """Return a row of the table of series."""
    told = [case for case in cases if np.isfinite(case["alone"])]
    alone = np.array([case["alone"] for case in told])
    series = np.array([case["series"] for case in told])
    ratios = series / alone
    holds = np.mean([case["low"] <= case["series"] <= case["high"] for case in told])
    of_true = np.exp(np.mean([np.log(case["predicted"] / case["series"]) for case in told]))
    return (f"| {name} | {len(told)} | {np.median(alone):.2f} | {np.median(series):.2f} | "
            f"{np.exp(np.log(ratios).mean()):.2f} | {100 * np.mean(ratios > 1.05):.0f} | "
            f"{100 * np.mean(ratios < 1 / 1.05):.0f} | {of_true:.2f} | {100 * holds:.0f} |")


def interval_row(few: int, series: Sequence[Sequence[dict[str, float]]]) -> str:
    """Return a row of the table of intervals; sheets of a series count as one, being alike."""
    cases = [case for sheets in series for case in sheets]
    of_true = np.exp(np.mean([np.log(case["predicted"] / case["series"]) for case in cases]))
    shares = [np.mean([case["low"] <= case["series"] <= case["high"] for case in sheets])
              for sheets in series]
    error = np.std(shares, ddof=1) / np.sqrt(len(shares))
    return (f"| {few} points | {len(series)} | {len(cases)} | {of_true:.2f} | "
            f"{100 * np.mean(shares):.0f} | {100 * error:.1f} |")


def like_row(name: str, cases: Sequence[dict[str, float]]) -> str:
    """Return a row of the table of real maps with maps like them."""
    alone, series, auto = (np.array([case[key] for case in cases])
                           for key in ("alone", "series", "auto"))
    holds = np.mean([case["low"] <= case["auto"] <= case["high"] for case in cases
                     if np.isfinite(case["predicted"])])
    cells = [f"{np.median(column):.2f}" for column in (alone, series, auto)]
    cells += [f"{np.exp(np.log(column / alone).mean()):.2f}" for column in (series, auto)]
    cells += [f"{100 * np.mean(share):.0f}" for share in (
        [case["borrows"] for case in cases], auto > 1.05 * alone, auto < alone / 1.05, holds)]
    return f"| {name} | {len(cases)} | " + " | ".join(cells) + " |"


def single_row(name: str, cases: Sequence[dict[str, float]]) -> str:
    """Return a row of the table of real maps by themselves."""
    cells = []
    for key in ("all", "sound"):
        true = np.array([case[key] for case in cases])
        predicted = np.array([case["predicted"] for case in cases])
        holds = np.mean([case["low"] <= case[key] <= case["high"] for case in cases])
        above = np.mean([case[key] > case["high"] for case in cases])
        cells += [f"{np.median(true):.2f}", f"{np.exp(np.log(predicted / true).mean()):.2f}",
                  f"{100 * holds:.0f}", f"{100 * above:.0f}"]
    return f"| {name} | {len(cases)} | " + " | ".join(cells) + " |"


def projection_row(name: str, cases: Sequence[dict[str, float]]) -> str:
    """Return a row of the table of projections: medians, and mean ratios to hindsight."""
    # A projective model of four points may show some place at infinity: such maps are left out.
    cases = [case for case in cases if np.isfinite(case["plain"] + case["run"])]
    hindsight = np.array([case["hindsight"] for case in cases])
    cells = []
    for key in ("degrees", "plain", "least", "chosen"):
        column = np.array([case[key] for case in cases])
        ratio = np.exp(np.log(column / hindsight).mean())
        cells.append(f"{np.median(column):.2f} ({ratio:.2f})")
    predicted = [case for case in cases if np.isfinite(case["low"])]
    holds = np.mean([case["low"] <= case["run"] <= case["high"] for case in predicted])
    above = np.mean([case["run"] > case["high"] for case in predicted])
    told = np.mean([case["told"] for case in cases])
    cells.append(f"{np.median(hindsight):.2f}")
    cells += [f"{100 * share:.0f}" for share in (told, holds, above)]
    return f"| {name} | {len(cases)} | " + " | ".join(cells) + " |"


def drawn_series_row(series: Sequence[Sequence[dict[str, float]]]) -> str:
    """Return the row of the table of series that are drawn in a projection."""
    cases = [case for sheets in series for case in sheets]
    columns = {key: np.array([case[key] for case in cases]) for key in ("alone", "chosen", "true")}
    cells = [f"{np.median(column):.2f}" for column in columns.values()]
    ratios = columns["chosen"] / columns["alone"]
    of_true = columns["chosen"] / columns["true"]
    cells += [f"{np.exp(np.log(ratio).mean()):.2f}" for ratio in (ratios, of_true)]
    cells += [f"{100 * np.mean(share):.0f}" for share in (ratios > 1.05, ratios < 1 / 1.05)]
    return f"| {len(series)} | {len(cases)} | " + " | ".join(cells) + " |"


PAGE = """# Old maps: projections and series

Does it help that points choose the projection of a map, and that sheets of a series share what
their paper is like?

Made by `python -m benchmarks.sheet_series --write`. The real maps are 32 old maps of Victoria,
georeferenced by hand (CC0; the [datasheet](../reference/datasheet.md#measured-sets) has the
source).

## Paper that sheets share

A simulated series has {sheets} sheets; of {many_sheets} of them {many} points are measured, of the
others few. Paper is stretched and sheared alike but for some 0.1 %, turned on the scanner, and
deformed locally by {local:g} px; points are measured to {noise:g} px. The real maps are no series:
each in turn has few points, and all others are taken for its series. Columns are medians of the
RMSE at new points [px] of sheets by `auto` alone and by the method `series-sheet`, the geometric
mean of the ratio, sheets that are worse and better by more than 5 % [%], the predicted RMSE by the
true one (geometric mean), and how often its interval of 90 % holds [%].

| sheets | fits | alone | series | ratio | worse | better | predicted | holds |
|---|---:|---:|---:|---:|---:|---:|---:|---:|
{series}

Sheets of one series share what is known of their noise, so that few series say little of the
interval. These are of further series, by the method `series-sheet`; the last column is the standard
error of how often it holds [%], by series.

| sheets | series | fits | predicted | holds | error |
|---|---:|---:|---:|---:|---:|
{intervals}

### Maps of like scale, nearby

Who takes such maps for a series borrows from maps that have little in common. Of each real map the
others within a factor of {like_scale:g} of its scale, whose middle is within {nearby:g} km, are its
series; maps with two such others count. `auto` with `series=series.json` has the sheet alone
and the sheet of the series to choose from, and declines the latter where the scales of the other
sheets differ by more than a tenth, as those of one series never do. Columns are medians of the RMSE
[px] at points left out, but those that are blunders by a run of all points of the map: of the sheet
alone by `auto`, of the method `series-sheet`, and of `auto` with both; the geometric means of the
ratios of both to the first; how often `auto` borrows, is
worse and better than alone by more than 5 %, and how often its interval of 90 % holds [%].

| maps | fits | alone | series | auto | ratio | auto's | borrows | worse | better | holds |
|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|
{like}

## Single maps

Of each real map points are left out at random. Columns are medians of the RMSE [px], the
predicted RMSE by it (geometric mean), how often the interval of 90 % holds, and how often the RMSE
is above it [%]; first at all points left out, then at those that are no blunders by a run of all
points of the map.

| fitted | maps | all | predicted | holds | above | without blunders | predicted | holds | above |
|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|
{single}

## The projection that points choose

Maps of {sizes} degrees are drawn in one of the
projections of the default list, about other meridians and parallels than those of their points, on
stretched and sheared paper; points are measured to {map_noise:g} px, the first four near the
corners, and the map is deformed locally by {map_local:g} px. Of the real maps some points are
fitted and the first {candidates} of the list are tried; points left out count if they are no
blunders by a run of all points of the map. Columns are medians of the RMSE [px] at points left out,
with the geometric mean of the ratio to the best projection in hindsight: of fits in degrees, of a
plain run without `--crs auto`, of the projection of the least error of held-out points, and of the
one that `--crs auto` takes. Then how often points show which it is, how often the interval of 90 %
of a run in it holds for points measured alike, and how often their RMSE is above it [%].

| maps | fits | degrees | plain | least error | `--crs auto` | hindsight | shown | holds | above |
|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|
{projections}

## The projection that a series chooses

Series of {drawn_sheets} sheets of {sheet_size} degrees are drawn in one of the projections: of
three sheets {drawn_many} points are measured, of the others {drawn_few}, near the corners. The
projection is the one in which all points together are most probable. Columns are medians of the
RMSE [px] of the sheets of {drawn_few} points: by a run of each alone, with its series, and with its
series in the right projection; the geometric means of the ratios of the second to the first and to
the third; and how often the series makes a sheet worse and better by more than 5 % [%].

| series | sheets | alone | series | right projection | to alone | to right | worse | better |
|---:|---:|---:|---:|---:|---:|---:|---:|---:|
{drawn_series}

## What is missed

- With 8 points a fifth of the sheets is worse by their series than alone. `auto` takes the series
  where it predicts better.
- In a series that is none, of maps drawn to unlike accuracy, the interval holds less often.
- There is no series among the real maps: what a true series gains is seen on simulated ones alone.
- Points of the real maps that are left out include blunders of the volunteers who measured them,
  which the interval does not mean: it is of points that are measured rightly. That is one reason
  why it holds less often in the first table.
- Sheets of like scale that are none of one series would not be seen as such; what they lend is as
  wide as they differ.
- Few points do not show the projection of a map. `--crs auto` then takes one that is near all those
  that they do not tell apart, and says so. Real maps of few points, which are less accurate, hardly
  gain by any projection.
"""


def tables(options: argparse.Namespace) -> dict[str, str]:
    """Return the rows of the tables of the page by their names."""
    def computed(work: Callable[..., Any], jobs: Sequence[tuple[Any, ...]], part: str) -> list[Any]:
        kept = options.kept and options.kept.with_suffix(f".{part}.jsonl")
        return resumed(work, jobs, options.processes, kept)

    rows = []
    for few in options.few:
        jobs = [(few, series, number) for series in range(options.series)
                for number in range(SHEETS) if number not in WITH_MANY]
        rows.append(series_row(f"simulated, {few} points",
                               computed(figures_of_sheet, jobs, "sheets")))
    intervals = [interval_row(few, computed(
        figures_of_series, [(few, series) for series in FURTHER], "intervals"))
        for few in options.few]
    large = [number for number, features in enumerate(real_maps())
             if len(features.points) >= max(options.few) + 4]
    for few in options.few if large else ():
        maps = [(few, number) for number in large]
        rows.append(series_row(f"real maps, {few} points", computed(figures_of_map, maps, "maps")))
    like = []
    single = []
    for few in options.few if large else ():
        numbers = [number for number in large if len(maps_like(number)) > 1]
        like.append(like_row(f"real maps, {few} points", computed(
            figures_of_like_map, [(few, number) for number in numbers], "like")))
    for few in (0, 10) if large else ():
        numbers = [number for number in large if len(real_maps()[number].points) >= few + 4]
        single.append(single_row(f"{few} points" if few else "two thirds", computed(
            figures_of_single_map, [(few, number) for number in numbers], "single")))
    projections = []
    for count in MAP_COUNTS:
        jobs = [("drawn", count, number) for number in range(options.maps)]
        projections.append(projection_row(f"simulated, {count} points", computed(
            figures_of_projection, jobs, "projections")))
    for count in (4, 0) if large else ():
        jobs = [("real", count, number) for number in large[:options.real]]
        name = f"real, {count} points" if count else "real, two thirds"
        projections.append(projection_row(name, computed(
            figures_of_projection, jobs, "projections")))
    drawn_series = drawn_series_row(computed(
        figures_of_drawn_series, [(number,) for number in range(options.drawn)], "drawn"))
    return {"series": "\n".join(rows), "intervals": "\n".join(intervals),
            "like": "\n".join(like), "single": "\n".join(single),
            "projections": "\n".join(projections), "drawn_series": drawn_series}


def in_words(size: tuple[float, float]) -> str:
    """Return the width and height of a map as text."""
    return f"{size[0]:g} by {size[1]:g}"


def main() -> None:
    """Print or write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--few", type=int, nargs="*", default=(4, 8))
    parser.add_argument("--series", type=int, default=3)
    parser.add_argument("--maps", type=int, default=16, help="maps whose projection is chosen")
    parser.add_argument("--real", type=int, default=12, help="real maps whose projection is chosen")
    parser.add_argument("--drawn", type=int, default=12, help="series drawn in a projection")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--kept", type=Path, help="file of cases that are done")
    parser.add_argument("--write", action="store_true", help="renew the page in docs/evidence")
    options = parser.parse_args()
    put("map-series", PAGE.format(
        sheets=SHEETS, many_sheets=len(WITH_MANY), many=MANY, local=LOCAL, noise=NOISE,
        map_noise=MAP_NOISE, map_local=MAP_LOCAL, candidates=CANDIDATES, like_scale=LIKE_SCALE,
        nearby=NEARBY / 1000, drawn_sheets=DRAWN_SHEETS, drawn_many=DRAWN_MANY,
        drawn_few=DRAWN_FEW, sheet_size=in_words(MAP_SIZES[0]),
        sizes=", ".join(in_words(size) for size in MAP_SIZES), **tables(options)),
        write=options.write)


if __name__ == "__main__":
    main()
