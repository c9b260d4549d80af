"""Photos with a known camera and few poor points: is auto as good as a resection, and its RMSE so?

``python -m benchmarks.known_cameras`` prints a table. A camera of 4000 x 3000 px looks at hills,
straight down or 15 to 50 degrees below the horizon. Its focal length is stated to 0.3 %. Points are
measured as volunteers do, with Student's errors of 4 degrees of freedom and some 5 px. The truth
is as many further points as suffice, measured likewise. The rival is a resection of the stated
focal length by a robust loss, started at the true camera.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import termsel
from benchmarks.oblique import ALTITUDE, LINES, SAMPLES, Camera
from termsel.core.errors import TermselError
from termsel.core.threads import one_blas_thread
from termsel.data.features import FeatureSet, Points, no_lines

FloatArray = NDArray[np.float64]

DEPRESSIONS = (88, 50, 30, 15)
"""Of the view below the horizon [deg]."""

COUNTS = (4, 5, 6, 8, 10, 14)

SIGMA = 5.0
"""Root mean square of the errors of lines, and of samples [px]."""

FREEDOM = 4.0
"""Degrees of freedom of the errors."""

FOCAL_ERROR = 0.003
"""Relative standard deviation of the focal length that is stated."""

TRUTH = 300

ORIGIN = np.array([500_000.0, 5_200_000.0, 400.0])


@dataclass(frozen=True)
class Case:
    """Figures of one photo [px]; infinite where no model was determined."""

    chosen: str
    rmse: float
    resection: float
    predicted: float
    low: float
    high: float

    @property
    def holds(self) -> bool:
        """Whether the true RMSE is in the predicted interval."""
        return self.low <= self.rmse <= self.high


@one_blas_thread
def case_of(depression: float, count: int, seed: int, *, states_focal: bool = True) -> Case:
    """Return the figures of a photo that is drawn."""
    rng = np.random.default_rng([60, int(depression), count, seed])
    camera = Camera(depression, rng.uniform(0, 360), rng.uniform(2800, 5000), 100.0,
                    rng.uniform(0, 2 * np.pi, 4))
    image, ground = places_of(camera, count + TRUTH, rng)
    scale = SIGMA * np.sqrt((FREEDOM - 2) / FREEDOM)
    measured = image + scale * rng.standard_t(FREEDOM, image.shape)
    stated = camera.focal * (1.0 + FOCAL_ERROR * rng.standard_normal())
    columns = {"camera_focal": np.array([f"{stated:.1f}"] * count, dtype=object)}
    points = Points(tuple(f"P{i:02d}" for i in range(count)), measured[:count],
                    (ground[:count] + ORIGIN).round(3), attributes=columns if states_focal else {})
    features = FeatureSet(points, no_lines(), "EPSG:32632", (LINES, SAMPLES))
    resected = resection(camera, stated, ground[:count], measured[:count])
    resection_rmse = rmse(resected(ground[count:]), measured[count:])
    try:
        result = termsel.run(features=features)
    except TermselError as error:
        return Case(str(error), np.inf, resection_rmse, np.nan, np.nan, np.nan)
    predicted = result.predicted
    chosen = result.strategy.chosen if result.strategy else ""
    figures = (np.nan, np.nan, np.nan) if predicted is None \
        else (predicted.rmse, predicted.low, predicted.high)
    seen = result.project(ground[count:] + ORIGIN)
    return Case(chosen, rmse(seen, measured[count:]), resection_rmse, *figures)


def places_of(camera: Camera, count: int,
              rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return places all over the image (n, 2), and the ground that is seen there (n, 3)."""
    image = rng.uniform(0.03, 0.97, (3 * count, 2)) * [LINES, SAMPLES]
    ground = camera.ground(image)
    seen = np.isfinite(ground).all(axis=1)
    return image[seen][:count], ground[seen][:count]


def resection(camera: Camera, focal: float, ground: FloatArray,
              image: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """Return the projection of a camera of a focal length, by a robust loss."""
    def project(values: FloatArray, places: FloatArray) -> FloatArray:
        axes = camera.axes() @ Rotation.from_rotvec(values[:3]).as_matrix()
        position = np.array([0.0, 0.0, ALTITUDE]) + 100.0 * values[3:]
        seen = (places - position) @ axes.T
        return np.asarray(focal * seen[:, :2] / seen[:, 2:] + np.array([LINES, SAMPLES]) / 2)

    best = least_squares(lambda values: (project(values, ground) - image).ravel(), np.zeros(6),
                         loss="soft_l1", f_scale=SIGMA, x_scale="jac")
    return lambda places: project(best.x, places)


def rmse(one: FloatArray, other: FloatArray) -> float:
    """Return the root mean square distance [px]."""
    return float(np.sqrt(((one - other)**2).sum(axis=1).mean()))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--depressions", type=int, nargs="*", default=DEPRESSIONS)
    parser.add_argument("--counts", type=int, nargs="*", default=COUNTS)
    parser.add_argument("--verbose", action="store_true", help="print every photo")
    options = parser.parse_args()
    print("down  n   auto  resection ratio  pred  pred/true  holds  too low  chosen")
    for depression in options.depressions:
        for count in options.counts:
            cases = [case_of(depression, count, seed) for seed in range(options.seeds)]
            if options.verbose:
                for seed, case in enumerate(cases):
                    print("   ", seed, case)
            print(row(depression, count, cases), flush=True)


def row(depression: float, count: int, cases: list[Case]) -> str:
    """Return a row of the table: medians over photos, and how often intervals hold."""
    errors = np.array([case.rmse for case in cases])
    rivals = np.array([case.resection for case in cases])
    predicted = np.array([case.predicted for case in cases])
    known = np.isfinite(predicted)
    share = np.mean([case.holds for case in cases if np.isfinite(case.predicted)])
    above = np.mean([case.rmse > case.high for case in cases if np.isfinite(case.predicted)])
    ratio = np.exp(np.mean(np.log(predicted[known] / errors[known])))
    names = {case.chosen for case in cases}
    often = max(names, key=[case.chosen for case in cases].count)
    return (f"{depression:4.0f} {count:2d} {np.median(errors):7.2f} {np.median(rivals):7.2f} "
            f"{np.exp(np.median(np.log(errors / rivals))):6.2f} {np.median(predicted[known]):8.2f} "
            f"{ratio:6.2f} {100 * share:5.0f} % {100 * above:4.0f} %  "
            f"{often} {[case.chosen for case in cases].count(often)}/{len(cases)}")


if __name__ == "__main__":
    main()
