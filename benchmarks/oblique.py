"""Oblique photographs: does auto choose the projection, and how near is it to the best one?

``python -m benchmarks.oblique`` prints a table. A camera of 4000 x 3000 px looks 10 to 40 degrees
below the horizon at hills of a given height. Control and truth are where the image shows ground;
the truth is what lies within the hull of the control. Rivals are the homography and the DLT of the
least squares of distances in the image, fitted to the same control.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial import Delaunay

import termsel
from termsel.core.errors import TermselError
from termsel.core.threads import one_blas_thread
from termsel.data.features import FeatureSet, Points, no_lines

FloatArray = NDArray[np.float64]

ANGLES = (10, 20, 30, 40)
RELIEFS = (0, 20, 100)
COUNTS = (8, 14, 20, 40)
SEEDS = 5

LINES, SAMPLES = 3000, 4000
NOISE = 0.5
ALTITUDE = 600.0
"""Of the camera above the lowest ground [m]."""

LOWEST_RAY = np.radians(3.0)
"""Control is no nearer to the horizon than this."""

TRUTH = 600


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

    def image(self, ground: FloatArray) -> FloatArray:
        """Return lines and samples of places (n, 3), shape (n, 2)."""
        places = (ground - [0.0, 0.0, ALTITUDE]) @ self.axes().T
        return np.asarray(self.focal * places[:, :2] / places[:, 2:]
                          + np.array([LINES, SAMPLES]) / 2)

    def ground(self, image: FloatArray) -> FloatArray:
        """Return the first ground that image places (n, 2) show, shape (n, 3); NaN for the sky."""
        rays = np.column_stack([(image - np.array([LINES, SAMPLES]) / 2) / self.focal,
                                np.ones(len(image))]) @ self.axes()
        rays /= np.linalg.norm(rays[:, :2], axis=1)[:, None]
        reach = ALTITUDE / np.maximum(-rays[:, 2], np.tan(LOWEST_RAY))
        found = np.full((len(image), 3), np.nan)
        for i in np.flatnonzero(-rays[:, 2] > np.tan(LOWEST_RAY)):
            steps = np.linspace(0.0, 1.001, 4001) * reach[i]
            places = steps[:, None] * rays[i] + [0.0, 0.0, ALTITUDE]
            under = np.flatnonzero(places[:, 2] <= self.heights(places[:, :2]))
            low, high = steps[max(under[0] - 1, 0)], steps[under[0]]
            for _ in range(40):
                middle = (low + high) / 2
                place = middle * rays[i] + [0.0, 0.0, ALTITUDE]
                if place[2] <= self.heights(place[None, :2])[0]:
                    high = middle
                else:
                    low = middle
            found[i] = high * rays[i] + [0.0, 0.0, ALTITUDE]
        return found


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
    points = Points(tuple(f"P{i:02d}" for i in range(count)),
                    places[control] + noise * rng.standard_normal((count, 2)), given)
    features = FeatureSet(points, no_lines(), "EPSG:32632", (LINES, SAMPLES))
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


@one_blas_thread
def case_of(depression: float, relief: float, count: int, seed: int, *,
            heights: bool = True) -> Case:
    """Return the figures of a scene."""
    drawn = scene(depression, relief, count, seed, heights=heights)
    rivals = []
    for with_heights in (False, True):
        seen = None if with_heights and not heights else rival(
            drawn.features.points, drawn.ground, heights=with_heights)
        rivals.append(np.inf if seen is None else rmse(seen, drawn.image))
    try:
        result = termsel.run(features=drawn.features)
    except TermselError as error:
        return Case(np.inf, rivals[0], rivals[1], str(error), np.nan)
    seen = result.project(drawn.ground)
    return Case(rmse(seen, drawn.image), rivals[0], rivals[1],
                result.strategy.chosen if result.strategy else "",
                result.predicted.rmse if result.predicted else np.nan)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--angles", type=int, nargs="*", default=ANGLES)
    parser.add_argument("--reliefs", type=int, nargs="*", default=RELIEFS)
    parser.add_argument("--counts", type=int, nargs="*", default=COUNTS)
    parser.add_argument("--each", action="store_true")
    given = parser.parse_args()
    for angle in given.angles:
        for relief in given.reliefs:
            for count in given.counts:
                cases = [case_of(angle, relief, count, seed) for seed in range(given.seeds)]
                ratios = [one.ratio for one in cases]
                print(f"{angle:3d} {relief:4d} {count:3d}  ratio {np.median(ratios):8.2f} "
                      f"(max {max(ratios):8.2f})  auto {np.median([c.auto for c in cases]):9.2f} "
                      f"H {np.median([c.homography for c in cases]):8.2f} "
                      f"DLT {np.median([c.dlt for c in cases]):8.2f} pred "
                      f"{np.median([c.predicted for c in cases]):8.2f} "
                      f"{' '.join(c.chosen for c in cases)}", flush=True)


if __name__ == "__main__":
    main()
