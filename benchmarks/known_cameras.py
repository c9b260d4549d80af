"""Photos with a known camera and few poor points: is auto as good as a resection, and its RMSE so?

``python -m benchmarks.known_cameras --write`` makes docs/evidence/known-cameras.md: of the real
photos of `benchmarks.photo_resection`, and of a simulated camera of 4000 x 3000 px over hills. With
`--kept` a run resumes.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from benchmarks.kept import resumed
from benchmarks.photo_resection import (
    FOLDER,
    FOLDS,
    by_auto,
    figures_of_photo,
    folds,
    photo,
    photos,
    rmse,
)
from benchmarks.sets import put
from termsel.core.errors import TermselError
from termsel.core.threads import one_blas_thread
from termsel.data.features import FeatureSet, Points
from termsel.data.fit_data import FitData
from termsel.fitting.accuracy import predict_rmse_of_fit
from termsel_cameras.known.method import KNOWN_CAMERA

FloatArray = NDArray[np.float64]

SIZE = np.array([3000.0, 4000.0])
"""Lines and samples."""

HIGH = 1200.0
"""Of the camera above the mean ground [m]."""

FARTHEST = 12.0
"""Distance up to which points are measured, by that height."""

RELIEF = 60.0
"""Amplitude of hills along each axis [m]."""

DEPRESSIONS = (88, 50, 30, 15)
"""Of the view below the horizon [deg]."""

COUNTS = (4, 5, 6, 8, 12)

SIGMA = 5.0
"""Root mean square of the errors of lines, and of samples [px]."""

FREEDOM = 4.0
"""Degrees of freedom of the errors."""

FOCAL_ERROR = 0.003
"""Relative standard deviation of the focal length that is stated."""

TRUTH = 200

ORIGIN = np.array([500_000.0, 5_200_000.0, 400.0])


@dataclass(frozen=True)
class Setting:
    """What differs from a camera as it is stated: a row of the table of variations.

    Parameters
    ----------
    focal : float
        Factor of the focal length that is stated.
    middle : float
        Distance of the principal point from the middle of the image, along both axes [px].
    k1 : float
        Radial distortion.
    tells_lens : bool
        Whether it is stated.
    height : float
        Factor of the flying height that is stated; 0 where none is.
    heights : float
        Standard deviation of the heights of points [m].
    blunders : int
        Points that are 60 to 200 px off.
    """

    focal: float = 1.0
    middle: float = 0.0
    k1: float = 0.0
    tells_lens: bool = True
    height: float = 0.0
    heights: float = 0.0
    blunders: int = 0


SETTINGS = {
    "as stated, 8 points": (8, Setting()),
    "focal length 1 % off, 8 points": (8, Setting(focal=1.01)),
    "focal length 5 % off, 8 points": (8, Setting(focal=1.05)),
    "principal point 40 px off, not stated, 8 points": (8, Setting(middle=40.0)),
    "distortion k1 = -0.05, stated, 8 points": (8, Setting(k1=-0.05)),
    "distortion k1 = -0.05, not stated, 8 points": (8, Setting(k1=-0.05, tells_lens=False)),
    "heights of points to 10 m, 8 points": (8, Setting(heights=10.0)),
    "two blunders, 12 points": (12, Setting(blunders=2)),
    "4 points, flying height to 10 %": (4, Setting(height=1.05)),
    "3 points, flying height to 10 %": (3, Setting(height=1.05)),
}
"""Number of points and what differs, by the row of the page."""


@one_blas_thread
def figures_of_drawn(depression: int, count: int, seed: int,
                     name: str = "as stated, 8 points") -> dict[str, float]:
    """Return the RMSE at new points of a photo that is drawn, and the one predicted [px]."""
    setting = SETTINGS[name][1]
    features, focal = drawn(depression, count, seed, setting)
    is_control = np.array([role == "control" for role in features.points.roles])
    control = features.points.take(is_control)
    new_points = features.points.take(~is_control)
    resected = resection(control, focal, depression, seed)
    figures = {"resection": rmse(resected(new_points.ground), new_points.image),
               "auto": np.inf, "predicted": np.nan, "low": np.nan, "high": np.nan}
    if setting.blunders:
        return {**figures, **by_auto(features)}
    try:
        fitted = KNOWN_CAMERA.fit(FitData.of(features.with_(points=control)))
    except TermselError:
        return figures
    predicted = predict_rmse_of_fit(fitted, np.concatenate(fitted.errors_without_each[0]), 0)
    return {**figures, "auto": rmse(fitted.project(new_points.ground), new_points.image),
            "predicted": predicted.rmse, "low": predicted.low, "high": predicted.high}


def drawn(depression: int, count: int, seed: int, setting: Setting) -> tuple[FeatureSet, float]:
    """Return points of a photo, those to judge by with the role independent, and f stated [px]."""
    rng = np.random.default_rng([60, depression, count, seed])
    focal = rng.uniform(2800.0, 5000.0)
    axes = view_of(depression, seed)
    phases = rng.uniform(0.0, 2.0 * np.pi, 2)
    # Rays all over the image meet the mean ground; where they do, the hills are seen elsewhere.
    pixels = rng.uniform(0.03, 0.97, (8 * (count + TRUTH), 2)) * SIZE
    rays = np.column_stack([(pixels - SIZE / 2) / focal, np.ones(len(pixels))]) @ axes
    rays = rays[rays[:, 2] < -1.0 / FARTHEST]
    plan = (rays * (-HIGH / rays[:, 2:]))[:, :2]
    hills = RELIEF * (np.sin(plan[:, 0] / 400.0 + phases[0]) + np.cos(plan[:, 1] / 500 + phases[1]))
    ground = np.column_stack([plan, hills])
    seen = (ground - [0.0, 0.0, HIGH]) @ axes.T
    away = seen[:, :2] / seen[:, 2:]
    away *= 1.0 + setting.k1 * (away**2).sum(axis=1, keepdims=True)
    image = focal * away + (SIZE - 1.0) / 2.0 + setting.middle
    inside = (seen[:, 2] > 0) & (image > 0).all(axis=1) & (image < SIZE - 1.0).all(axis=1)
    image, ground = image[inside][:count + TRUTH], ground[inside][:count + TRUTH]
    scale = SIGMA * np.sqrt((FREEDOM - 2.0) / FREEDOM)
    image = image + scale * rng.standard_t(FREEDOM, image.shape)
    turned = rng.uniform(0.0, 2.0 * np.pi, setting.blunders)
    image[:setting.blunders] += rng.uniform(60.0, 200.0, (setting.blunders, 1)) \
        * np.column_stack([np.cos(turned), np.sin(turned)])
    ground[:count, 2] += setting.heights * rng.standard_normal(count)
    stated = focal * setting.focal * (1.0 + FOCAL_ERROR * rng.standard_normal())
    columns = {"camera_focal": f"{stated:.1f}"}
    if setting.height:
        columns["camera_height"] = f"{HIGH * setting.height:.0f}"
    if setting.k1 and setting.tells_lens:
        columns["camera_distortion"] = f"{setting.k1}"
    points = Points(
        tuple(f"P{i}" for i in range(len(image))), image, (ground + ORIGIN).round(3),
        roles=("control",) * count + ("independent",) * (len(image) - count),
        attributes={key: np.array([value] * len(image), dtype=object)
                    for key, value in columns.items()})
    return FeatureSet(points, crs="EPSG:32632", image_size=(int(SIZE[0]), int(SIZE[1]))), stated


def view_of(depression: int, seed: int) -> FloatArray:
    """Return the directions of lines, samples and the view, as rows."""
    angle = np.radians(depression)
    azimuth = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi)
    ahead = np.array([np.sin(azimuth), np.cos(azimuth), 0.0])
    right = np.array([np.cos(azimuth), -np.sin(azimuth), 0.0])
    view = np.cos(angle) * ahead - np.sin(angle) * np.array([0.0, 0.0, 1.0])
    return np.stack([np.cross(view, right), right, view])


def resection(control: Points, focal: float, depression: int,
              seed: int) -> Callable[[FloatArray], FloatArray]:
    """Return the projection of the stated focal length by a robust loss, from the true camera on.
    """
    axes = view_of(depression, seed)

    def project(values: FloatArray, ground: FloatArray) -> FloatArray:
        turned = axes @ Rotation.from_rotvec(values[:3]).as_matrix()
        position = np.array([0.0, 0.0, HIGH]) + 100.0 * values[3:]
        seen = (ground - ORIGIN - position) @ turned.T
        return np.asarray(focal * seen[:, :2] / seen[:, 2:] + (SIZE - 1.0) / 2.0)

    best = least_squares(
        lambda values: (project(values, control.ground) - control.image).ravel(), np.zeros(6),
        loss="soft_l1", f_scale=SIGMA, x_scale="jac")
    return lambda ground: project(best.x, ground)


def row(name: str, cases: Sequence[dict[str, float]]) -> str:
    """Return a row of a table."""
    auto = np.array([case["auto"] for case in cases])
    rival = np.array([case["resection"] for case in cases])
    ratios = auto / rival
    told = [case for case in cases if np.isfinite(case["predicted"])]
    holds = np.mean([case["low"] <= case["auto"] <= case["high"] for case in told])
    above = np.mean([case["auto"] > case["high"] for case in told])
    of_true = np.exp(np.mean([np.log(case["predicted"] / case["auto"]) for case in told]))
    width = np.exp(np.mean([np.log(case["high"] / case["low"]) for case in told]))
    return (f"| {name} | {len(cases)} | {np.median(auto):.2f} | {np.median(rival):.2f} | "
            f"{np.median(auto) / np.median(rival):.2f} | {np.exp(np.log(ratios).mean()):.2f} | "
            f"{of_true:.2f} | {100 * holds:.0f} | {100 * above:.0f} | {width:.1f} |")


HEAD = """| {} | fits | auto | resection | ratio | mean ratio | predicted | holds | above | width |
|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|
"""

PAGE = """# Photos with a known camera

The focal length of a photo is known, and few points are measured, poorly. Is `auto` as good as a
robust resection that takes the same focal length, and does the interval of the predicted RMSE hold?

Made by `python -m benchmarks.known_cameras --write`. Columns are medians of the RMSE at points that
took no part [px], their ratio, the geometric mean of the ratios of single fits, the predicted RMSE
by the true one (geometric mean), how often the interval of 90 % holds and how often the true RMSE
is above it [%], and the upper end of the interval by the lower one (geometric mean).

## Real photos

{photos} vertical photos of Switzerland of smapshot (BSD-3-Clause; the
[datasheet](../reference/datasheet.md#measured-sets) has the source), 6 to 14 points each by
volunteers, blunders among them. A third of the points is left out in turn ({repetitions} draw of
the thirds), so that 2 to 5 points judge a fit of 4 to 10. The resection is OpenCV's pose, alone and
by RANSAC, improved by a soft L1 loss of {sigma:g} px.

{real}
## Simulated photos

A camera of 4000 x 3000 px looks at hills, straight down or 15 to 50 degrees below the horizon. Its
focal length is stated to {focal_error:g} %. Points have Student's errors of {freedom:g}
degrees of freedom and {sigma:g} px, {truth} further ones likewise. The figures are those of auto's
candidate `known-camera` alone, without the choice and the search for blunders. The resection has a
soft L1 loss and begins at the true camera; it is given no lens and no flying height. Each cell has
{seeds} photos.

{simulated}
## What is stated may be wrong

A camera 50 or 88 degrees below the horizon, {seeds_varied} photos each. Those with
blunders are by all of auto.

{varied}
## What is missed

- With four points the interval is wide: two equations are left, and how well points of photos are
  usually measured (2 px, taken for two degrees of freedom) counts as much as they do.
- With three points the noise is known only by what is stated, and predictions are far too low.
- Heights of the points that are wrong by metres are errors on the ground, which the view turns into
  errors of unlike sizes: the interval holds less often.
- A wrong principal point and a distortion that is not stated are errors of the model, which few
  points cannot separate from errors of measurement.
"""


def computed(options: argparse.Namespace, work: Callable[..., Any],
             jobs: Sequence[tuple[Any, ...]], part: str) -> list[Any]:
    """Return the figures of jobs, of which those of earlier runs are kept in a file of the part."""
    kept = options.kept and options.kept.with_suffix(f".{part}.jsonl")
    return resumed(work, jobs, options.processes, kept)


def real_photos(options: argparse.Namespace) -> list[str]:
    """Return the names of the real photos that are computed; none where they are not installed."""
    return list(photos())[:options.photos] if FOLDER.is_dir() else []


def real_table(options: argparse.Namespace) -> str:
    """Return the table of real photos; none where they are not installed."""
    names = real_photos(options)
    jobs = [(name, repetition, fold) for repetition in range(options.repetitions)
            for name in names for fold in range(FOLDS)]
    if not jobs:
        return ""
    cases = computed(options, figures_of_photo, jobs, "real")
    counts = [len_of_fit(job) for job in jobs]
    groups = {"4 points": (4,), "5 points": (5,), "6 points": (6,), "7 to 10 points": range(7, 11)}
    rows = [row(name, [case for case, count in zip(cases, counts, strict=True) if count in group])
            for name, group in groups.items() if set(group) & set(counts)]
    return HEAD.format("control") + "\n".join([*rows, row("all", cases)]) + "\n"


def simulated_table(options: argparse.Namespace) -> str:
    """Return the table of photos that are drawn."""
    jobs = [(depression, count, seed) for depression in DEPRESSIONS for count in COUNTS
            for seed in range(options.seeds)]
    cases = computed(options, figures_of_drawn, jobs, "drawn")
    by_job = dict(zip(jobs, cases, strict=True))
    rows = [row(f"{depression} deg, {count} points",
                [by_job[depression, count, seed] for seed in range(options.seeds)])
            for depression in DEPRESSIONS for count in COUNTS]
    return HEAD.format("view below the horizon") + "\n".join([*rows, row("all", cases)]) + "\n"


def varied_table(options: argparse.Namespace) -> str:
    """Return the table of photos of which something else is stated, or wrong."""
    jobs = [(depression, count, 100 + seed, name) for name, (count, _) in SETTINGS.items()
            for depression in (88, 50) for seed in range(options.seeds)]
    cases = computed(options, figures_of_drawn, jobs, "varied")
    rows = [row(name, [case for case, job in zip(cases, jobs, strict=True) if job[3] == name])
            for name in SETTINGS]
    return HEAD.format("what differs") + "\n".join(rows) + "\n"


def len_of_fit(job: tuple[str, int, int]) -> int:
    """Return how many points of a real photo a fit has."""
    name, repetition, fold = job
    return int((folds(name, len(photo(name).points), repetition) != fold).sum())


def main() -> None:
    """Print or write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--repetitions", type=int, default=1)
    parser.add_argument("--photos", type=int, default=100)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--kept", type=Path, help="file of cases that are done")
    parser.add_argument("--write", action="store_true", help="renew the page in docs/evidence")
    options = parser.parse_args()
    put("known-cameras", PAGE.format(
        photos=len(real_photos(options)), repetitions=options.repetitions, sigma=SIGMA,
        freedom=FREEDOM, focal_error=100 * FOCAL_ERROR, truth=TRUTH, seeds=options.seeds,
        seeds_varied=2 * options.seeds, real=real_table(options),
        simulated=simulated_table(options), varied=varied_table(options)), write=options.write)


if __name__ == "__main__":
    main()
