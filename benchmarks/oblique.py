"""Oblique photographs: does auto choose the projection, and how near is it to the best one?

``python -m benchmarks.oblique --write`` makes docs/evidence/oblique.md. A camera of 4000 x 3000 px
looks 10 to 40 degrees below the horizon at hills of a given height; bird's-eye views are drawn by
hand, and panoramas are cylinders. Control and truth are where the image shows ground; the truth is
what lies within the hull of the control. Rivals are the homography and the DLT of the least squares
of distances in the image, fitted to the same control. With `--kept` a run resumes.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial import Delaunay

import termsel
from benchmarks.kept import resumed
from benchmarks.sets import put
from benchmarks.unlike_maps import drawn_by_hand
from termsel.core.errors import TermselError
from termsel.core.threads import one_blas_thread
from termsel.data.features import FeatureSet, Points, empty_lines

FloatArray = NDArray[np.float64]

ANGLES = (10, 20, 30, 40)
RELIEFS = (0, 20, 100)
ANGLES_BY_HAND = (20, 40)
RELIEFS_BY_HAND = (0, 20)
"""Of bird's-eye views and panoramas, whose points have no heights."""
COUNTS = (5, 8, 14, 40)
SEEDS = 3
REQUIRED = 1.3
"""Most that the median ratio of a kind may be."""

LINES, SAMPLES = 3000, 4000
NOISE = 0.5
ALTITUDE = 600.0
"""Of the camera above the lowest ground [m]."""

LOWEST_RAY = np.radians(3.0)
"""Control is no nearer to the horizon than this."""

TRUTH = 600
MEASURED_BY_HAND = 4.0
"""Noise of points of bird's-eye views and panoramas [px]."""
DRAWN_BY_HAND = 12.0
"""Size of the smooth errors of drawing in a bird's-eye view [px]."""


@dataclass(frozen=True)
class Camera:
    """A frame camera above hills, in metres about the place below it."""

    depression: float  # degrees below the horizon
    azimuth: float  # degrees
    focal: float  # px
    relief: float  # height of the hills [m]
    phases: FloatArray  # of the hills, shape (4,)

    def heights(self, plan: FloatArray) -> FloatArray:
        """Return the heights of places (n, 2), shape (n,) [m]."""
        x, y = plan.T / 400.0
        a, b, c, d = self.phases
        waves = np.sin(x + a) * np.cos(y + b) + 0.6 * np.sin(1.7 * y - 0.8 * x + c) \
            + 0.4 * np.cos(2.3 * x + d)
        return np.asarray(self.relief * (waves + 2.0) / 4.0)

    def axes(self) -> FloatArray:
        """Return the directions of lines, samples and the view, rows of (3, 3)."""
        down, turn = np.radians([self.depression, self.azimuth])
        ahead = np.array([np.sin(turn), np.cos(turn), 0.0])
        view = np.cos(down) * ahead - np.sin(down) * np.array([0.0, 0.0, 1.0])
        right = np.array([np.cos(turn), -np.sin(turn), 0.0])
        return np.stack([np.cross(view, right), right, view])

    def rays(self, image: FloatArray) -> FloatArray:
        """Return the directions in which image places (n, 2) are seen, of any length, (n, 3)."""
        return np.asarray(np.column_stack([
            (image - np.array([LINES, SAMPLES]) / 2) / self.focal,
            np.ones(len(image))]) @ self.axes())

    def ground(self, image: FloatArray) -> FloatArray:
        """Return the first ground that image places (n, 2) show, shape (n, 3); NaN for the sky."""
        rays = self.rays(image)
        rays /= np.linalg.norm(rays[:, :2], axis=1)[:, None]
        reach = ALTITUDE / np.maximum(-rays[:, 2], np.tan(LOWEST_RAY))
        found = np.full((len(image), 3), np.nan)
        seen = np.flatnonzero(-rays[:, 2] > np.tan(LOWEST_RAY))
        low, high = np.empty(len(seen)), np.empty(len(seen))
        for k, i in enumerate(seen):
            steps = np.linspace(0.0, 1.001, 4001) * reach[i]
            # No ground is higher than the relief, so only the rest of the ray may be under it.
            steps = steps[max(np.argmax(steps * rays[i, 2] + ALTITUDE <= self.relief) - 1, 0):]
            places = steps[:, None] * rays[i] + [0.0, 0.0, ALTITUDE]
            under = np.argmax(places[:, 2] <= self.heights(places[:, :2]))
            low[k], high[k] = steps[max(under - 1, 0)], steps[under]
        for _ in range(40):
            middle = (low + high) / 2
            places = middle[:, None] * rays[seen] + [0.0, 0.0, ALTITUDE]
            is_under = places[:, 2] <= self.heights(places[:, :2])
            low, high = np.where(is_under, low, middle), np.where(is_under, middle, high)
        found[seen] = high[:, None] * rays[seen] + [0.0, 0.0, ALTITUDE]
        return found


@dataclass(frozen=True)
class Panorama(Camera):
    """A picture on an upright cylinder, its horizon as high as the depression of its middle."""

    def rays(self, image: FloatArray) -> FloatArray:
        """Return the directions in which image places (n, 2) are seen, of any length, (n, 3)."""
        line, sample = ((image - np.array([LINES, SAMPLES]) / 2) / self.focal).T
        turn = np.radians(self.azimuth) + sample
        below = np.tan(np.radians(self.depression)) + line
        return np.column_stack([np.sin(turn), np.cos(turn), -below])


@dataclass(frozen=True)
class Scene:
    """Control of an oblique photograph, and where other ground within its hull is seen."""

    features: FeatureSet
    ground: FloatArray
    image: FloatArray


def scene(depression: float, relief: float, count: int, seed: int, *, heights: bool = True,
          noise: float = NOISE) -> Scene:
    """Return the control and truth of a camera that is drawn."""
    rng = np.random.default_rng([56, int(depression), int(relief), count, seed])
    camera = Camera(depression, rng.uniform(0, 360), rng.uniform(2800, 5000), relief,
                    rng.uniform(0, 2 * np.pi, 4))
    return seen_by(camera, rng, count, heights=heights, noise=noise)


def birds_eye_view(depression: float, relief: float, count: int, seed: int) -> Scene:
    """Return the control and truth of a view that is drawn by hand, without heights."""
    rng = np.random.default_rng([57, int(depression), int(relief), count, seed])
    camera = Camera(depression, rng.uniform(0, 360), rng.uniform(2800, 5000), relief,
                    rng.uniform(0, 2 * np.pi, 4))
    return seen_by(camera, rng, count, heights=False, noise=MEASURED_BY_HAND, drawn=DRAWN_BY_HAND)


def panorama(depression: float, relief: float, count: int, seed: int) -> Scene:
    """Return the control and truth of a panorama of some 100 to 140 degrees, without heights."""
    rng = np.random.default_rng([58, int(depression), int(relief), count, seed])
    camera = Panorama(depression, rng.uniform(0, 360), rng.uniform(1600, 2300), relief,
                      rng.uniform(0, 2 * np.pi, 4))
    return seen_by(camera, rng, count, heights=False, noise=MEASURED_BY_HAND)


def seen_by(camera: Camera, rng: np.random.Generator, count: int, *, heights: bool, noise: float,
            drawn: float = 0.0) -> Scene:
    """Return control and truth of a camera, with errors of measuring and of drawing [px]."""
    places = rng.uniform(0.03, 0.97, (4 * TRUTH, 2)) * [LINES, SAMPLES]
    ground = camera.ground(places)
    seen = np.isfinite(ground).all(axis=1)
    ground, places = ground[seen], places[seen]
    control, truth = slice(0, count), slice(count, count + TRUTH)
    inside = Delaunay(places[control]).find_simplex(places[truth]) >= 0
    origin = np.array([500_000.0, 5_200_000.0, 400.0])
    given = (ground[control] + origin).round(3)
    if not heights:
        given[:, 2] = np.nan
    if drawn:
        places = places + drawn_by_hand(rng, places, drawn, 0.5, 2.5)
    points = Points(tuple(f"P{i:02d}" for i in range(count)),
                    places[control] + noise * rng.standard_normal((count, 2)), given)
    features = FeatureSet(points, empty_lines(), "EPSG:32632", (LINES, SAMPLES))
    return Scene(features, ground[truth][inside] + origin, places[truth][inside])


def rival(points: Points, ground: FloatArray, *, heights: bool) -> FloatArray | None:
    """Return where the projection of least distances of points sees places; None if undetermined.
    """
    axes = slice(0, 3 if heights else 2)
    middle = points.ground[:, axes].mean(axis=0)
    scale = np.ptp(points.ground[:, axes], axis=0).max()
    columns, others = (np.column_stack([np.ones(len(one)), (one[:, axes] - middle) / scale])
                       for one in (points.ground, ground))
    size, unit = columns.shape[1], 2000.0
    image = points.image / unit
    if 2 * len(image) < 3 * size - 1 or np.linalg.matrix_rank(columns, 1e-6) < size:
        return None
    zero = np.zeros_like(columns)
    system = np.concatenate([
        np.concatenate([columns, zero, -image[:, :1] * columns], axis=1),
        np.concatenate([zero, columns, -image[:, 1:] * columns], axis=1)])
    start = np.linalg.svd(system)[2][-1].reshape(3, size)

    def seen(values: FloatArray, of: FloatArray) -> FloatArray:
        line, sample, below = values.reshape(3, size) @ of.T
        return np.column_stack([line / below, sample / below])

    found = least_squares(lambda x: (seen(x, columns) - image).ravel(), start.ravel(),
                          method="trf", x_scale="jac", max_nfev=200)
    return unit * seen(found.x, others)


def rmse(one: FloatArray, other: FloatArray) -> float:
    """Return the root mean square distance [px]."""
    return float(np.sqrt(((one - other)**2).sum(axis=1).mean()))


VIEWS = {"photograph": scene, "bird's-eye view": birds_eye_view, "panorama": panorama}
KINDS = [
    *product(["photograph"], ANGLES, RELIEFS, COUNTS),
    *product(["bird's-eye view", "panorama"], ANGLES_BY_HAND, RELIEFS_BY_HAND, COUNTS)]


@dataclass(frozen=True)
class Case:
    """RMSE at the truth [px]."""

    auto: float
    homography: float
    dlt: float
    chosen: str
    predicted: float

    @property
    def ratio(self) -> float:
        """Of auto to the better rival."""
        return self.auto / min(self.homography, self.dlt)


def case_of(depression: float, relief: float, count: int, seed: int, *,
            heights: bool = True) -> Case:
    """Return the figures of a photograph."""
    return case_of_scene(scene(depression, relief, count, seed, heights=heights))


@one_blas_thread
def case_of_scene(drawn: Scene) -> Case:
    """Return the figures of a scene."""
    points = drawn.features.points
    rivals = []
    for with_heights in (False, True):
        seen = None if with_heights and np.isnan(points.ground).any() else rival(
            points, drawn.ground, heights=with_heights)
        rivals.append(np.inf if seen is None else rmse(seen, drawn.image))
    try:
        result = termsel.run(features=drawn.features)
    except TermselError as error:
        return Case(np.inf, rivals[0], rivals[1], str(error), np.nan)
    seen = result.project(drawn.ground)
    return Case(rmse(seen, drawn.image), rivals[0], rivals[1],
                result.strategy.chosen if result.strategy else "",
                result.predicted.rmse if result.predicted else np.nan)


def figures_of(view: str, depression: float, relief: float, count: int,
               seed: int) -> dict[str, float | str]:
    """Return the figures of a case as JSON has them."""
    return asdict(case_of_scene(VIEWS[view](depression, relief, count, seed)))


def row(view: str, depression: float, relief: float, count: int, cases: list[Case]) -> str:
    """Return a row of the table."""
    ratios = [case.ratio for case in cases]
    figures = (np.median([getattr(case, name) for case in cases])
               for name in ("auto", "homography", "dlt", "predicted"))
    chosen = [case.chosen for case in cases]
    names = ", ".join(f"{chosen.count(name)} {name}" for name in sorted(
        set(chosen), key=lambda name: (-chosen.count(name), name)))
    cells = " | ".join(f"{value:.2f}" if np.isfinite(value) else "-" for value in figures)
    return (f"| {view} | {depression:g} | {relief:g} | {count} | {cells} | "
            f"{np.median(ratios):.2f} | {max(ratios):.2f} | {names} |")


HEAD = """| view | degrees below the horizon | relief [m] | points | auto [px] | homography [px] | \
DLT [px] | predicted [px] | median ratio | greatest ratio | chosen |
|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---|"""

PAGE = """# Oblique photographs

A photograph that looks 10 to 40 degrees below the horizon shows ground that rational functions and
polynomials cannot follow. Does the strategy auto choose a central projection, and is it as good as
the better of a homography and a DLT, which nobody knows beforehand?

`python -m benchmarks.oblique --write` makes this page.

There are {seeds} scenes of each kind. Photographs have 4000 x 3000 px and a focal length of 2800 to
5000 px, 600 m above the lowest ground; points have heights and noise of 0.5 px. Bird's-eye views
are drawn by hand with smooth errors of {drawn:g} px, and panoramas are upright cylinders of 100 to
140 degrees; their points have no heights and noise of {measured:g} px. The truth has no noise and
lies within the hull of the control in the image; where points have no heights, no method has them.
The homography and the DLT are least squares of distances in the image; five points do not
determine a DLT. A ratio is that of the RMSE of auto to the better of the two, in one scene.

{table}

The median ratio is at most {required:g} in {held} of {kinds} kinds, in the worst of them
{worst:.2f}. Of {cases} single scenes {above} have a ratio above {required:g}:

{single}

A predicted RMSE is that of measured points. With the noise of a measurement, the RMSE is between
half and twice the predicted one in {near:.0%} of all scenes, in {near_photographs:.0%} of
photographs.

## What is missed

- Panoramas: a cylinder is no central projection of a plane, and with fewer than 40 points every
  method is wrong by 100 px or more; which of them is less wrong is chance.
- Few points: the projections have 7 to 11 unknowns, so that five to eight points leave little to
  distinguish them. The greatest ratios are there.
- All cameras are free of distortion, and no point is wrong; [Blunders](blunders.md) has others.
- Places outside the hull of the control are left out.
"""


def single_scenes(cases: dict[tuple[str, int, int, int, int], Case]) -> str:
    """Return the scenes whose ratio is above what is required of medians, as a table."""
    rows = ["| view | degrees | relief [m] | points | scene | auto [px] | predicted [px] | ratio "
            "| chosen |", "|---|---:|---:|---:|---:|---:|---:|---:|---|"]
    for job, case in sorted(cases.items(), key=lambda item: -item[1].ratio):
        if case.ratio > REQUIRED:
            rows.append("| " + " | ".join(map(str, job)) + f" | {case.auto:.2f} | "
                        f"{case.predicted:.2f} | {case.ratio:.2f} | {case.chosen} |")
    return "\n".join(rows) if len(rows) > 2 else "none."


def is_near_predicted(view: str, case: Case) -> bool:
    """Return whether the RMSE at measured points is between half and twice the predicted one."""
    noise = NOISE if view == "photograph" else MEASURED_BY_HAND
    # Both axes are measured, and the truth has no noise.
    return bool(0.5 < np.hypot(case.auto, np.sqrt(2.0) * noise) / case.predicted < 2.0)


def page(cases: dict[tuple[str, int, int, int, int], Case], seeds: int) -> str:
    """Return the page of cases by view, depression, relief, number of points and seed."""
    kinds: dict[tuple[str, int, int, int], list[Case]] = {}
    for (view, depression, relief, count, _), case in cases.items():
        kinds.setdefault((view, depression, relief, count), []).append(case)
    medians = [np.median([case.ratio for case in some]) for some in kinds.values()]
    is_near = {job: is_near_predicted(job[0], case) for job, case in cases.items()}
    return PAGE.format(
        seeds=seeds, drawn=DRAWN_BY_HAND, measured=MEASURED_BY_HAND, required=REQUIRED,
        table="\n".join([HEAD, *(row(*kind, some) for kind, some in kinds.items())]),
        held=sum(median <= REQUIRED for median in medians), kinds=len(kinds), worst=max(medians),
        cases=len(cases), above=sum(case.ratio > REQUIRED for case in cases.values()),
        single=single_scenes(cases),
        near=np.mean(list(is_near.values())),
        near_photographs=np.mean([near for job, near in is_near.items() if job[0] == "photograph"]))


def main() -> None:
    """Print or write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--kept", type=Path, help="file of cases that are done")
    parser.add_argument("--write", action="store_true", help="renew the page in docs/evidence")
    asked = parser.parse_args()
    jobs = [(*kind, seed) for kind in KINDS for seed in range(asked.seeds)]
    figures = resumed(figures_of, jobs, asked.processes, asked.kept)
    cases = {job: Case(**one) for job, one in zip(jobs, figures, strict=True)}
    put("oblique", page(cases, asked.seeds), write=asked.write)


if __name__ == "__main__":
    main()
