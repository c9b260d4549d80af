"""Real photos of known focal length: auto next to a robust resection, at points left out.

The 100 vertical photos of smapshot have 6 to 14 points each, measured by volunteers. Points are
left out in three folds. The rival takes the same focal length, the principal point in the middle of
the image, and no distortion: OpenCV's pose, alone and by RANSAC, improved by a soft L1 loss.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import termsel
from benchmarks.sets import DATA
from termsel.core.errors import TermselError
from termsel.core.threads import one_blas_thread
from termsel.data.features import FeatureSet, Points

FloatArray = NDArray[np.float64]
Projection = Callable[[FloatArray], FloatArray]

FOLDER = DATA / "real" / "smapshot_nadir"
FOLDS = 3
SIGMA = 5.0
"""Of a measurement by a volunteer [px]; the loss of the resection bends there."""

LEFT_OUT = {"photo045": "P04"}
"""Points that are not read: this one is 18 km below the sea, which `termsel.read` refuses."""

RANSAC_PIXELS = 25.0

NO_FIGURES = (np.nan, np.nan, np.nan)


def photos() -> dict[str, dict[str, str]]:
    """Return what is stated of each photo by its name."""
    rows = csv.DictReader((FOLDER / "photos.csv").read_text("utf-8").splitlines())
    return {row["photo"]: row for row in rows}


def photo(name: str) -> FeatureSet:
    """Return the points of a photo with its focal length and size."""
    stated = photos()[name]
    features = termsel.read(FOLDER / f"{name}.csv", crs="EPSG:4979", off=LEFT_OUT.get(name),
                            camera_focal=stated["focal_px"])
    is_kept = np.array([point != LEFT_OUT.get(name) for point in features.points.ids])
    features = features.with_(points=features.points.take(is_kept))
    return replace(features, image_size=(int(stated["height"]), int(stated["width"])))


def folds(name: str, count: int, repetition: int) -> NDArray[np.intp]:
    """Return in which fold each point is."""
    rng = np.random.default_rng([2026, int(name.removeprefix("photo")), repetition])
    return rng.permutation(np.arange(count) % FOLDS)


@one_blas_thread
def figures_of_photo(name: str, repetition: int, fold: int) -> dict[str, float]:
    """Return the RMSE of points left out of a photo by both, and the one predicted [px]."""
    features = photo(name)
    hidden = folds(name, len(features.points), repetition) == fold
    roles = tuple("independent" if is_hidden else "control" for is_hidden in hidden)
    left_out = features.points.take(hidden)
    resected = resection(features, features.points.take(~hidden))
    features = features.with_(points=replace(features.points, roles=roles))
    return {"resection": rmse(resected(left_out.ground), left_out.image), **by_auto(features)}


def by_auto(features: FeatureSet) -> dict[str, float]:
    """Return the RMSE of auto at independent check points, and the predicted; infinite of no model.
    """
    try:
        result = termsel.run(features=features)
    except TermselError:
        return dict(zip(("auto", "predicted", "low", "high"), (np.inf, *NO_FIGURES), strict=True))
    predicted = result.predicted
    figures = NO_FIGURES if predicted is None else (predicted.rmse, predicted.low, predicted.high)
    # Of the fit without them: what is exported has the independent check points, too.
    independent = result.rmse["independent"]
    assert independent is not None
    return dict(zip(("auto", "predicted", "low", "high"), (independent.total, *figures),
                    strict=True))


def resection(features: FeatureSet, control: Points) -> Projection:
    """Return the projection of the robust resection of control points in degrees."""
    import cv2
    from pyproj import Transformer

    cv2.setNumThreads(1)
    geocentric = Transformer.from_crs(features.crs, "EPSG:4978", always_xy=True)
    origin = np.column_stack(geocentric.transform(*control.ground.T)).mean(axis=0)
    assert features.image_size is not None
    lines, samples = features.image_size
    focal = float(control.attributes["camera_focal"][0])
    camera = np.array([[focal, 0, (samples - 1) / 2], [0, focal, (lines - 1) / 2], [0, 0, 1.0]])

    def places(ground: FloatArray) -> FloatArray:
        return np.asarray(np.column_stack(geocentric.transform(*ground.T)) - origin)

    def project(values: FloatArray, ground: FloatArray) -> FloatArray:
        seen = Rotation.from_rotvec(values[:3]).apply(places(ground)) + values[3:]
        image = seen @ camera.T
        return np.asarray(image[:, 1::-1] / image[:, 2:])

    positions = places(control.ground)
    image = np.ascontiguousarray(control.image[:, ::-1])
    _, turn, shift = cv2.solvePnP(positions, image, camera, None, flags=cv2.SOLVEPNP_SQPNP)
    turn, shift = cv2.solvePnPRefineLM(positions, image, camera, None, turn, shift)
    starts = [np.concatenate([turn, shift]).ravel()]
    if len(control) > 4:
        found, turn, shift, _ = cv2.solvePnPRansac(
            positions, image, camera, None, iterationsCount=500, reprojectionError=RANSAC_PIXELS)
        if found:
            starts.append(np.concatenate([turn, shift]).ravel())
    scale = np.repeat([1.0, np.linalg.norm(starts[0][3:])], 3)
    solutions = [least_squares(
        lambda values: (project(values, control.ground) - control.image).ravel(), start,
        loss="soft_l1", f_scale=SIGMA, x_scale=scale) for start in starts]
    best = min(solutions, key=lambda solution: solution.cost)
    return lambda ground: project(best.x, ground)


def rmse(seen: FloatArray, measured: FloatArray) -> float:
    """Return the root mean square distance [px]."""
    return float(np.sqrt(((seen - measured)**2).sum(axis=1).mean()))
