"""How far what another program makes of an exported file is from the fitted model."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping

import numpy as np

from termsel.data.coordinates.metres import in_metres
from termsel.data.features import FeatureSet, FloatArray, Points
from termsel.data.scaling import scaling_of
from termsel.fitting.fit import Fit
from termsel.fitting.least_squares import fit
from termsel.fitting.sky import ground_where_held, image_places, middle_height, sky_said
from termsel.models.polynomial import Polynomial2D

log = logging.getLogger(__name__)

CLOSE = 1.0
"""Deviation from the model [px] above which an export warns."""

Transformation = Callable[[FloatArray], FloatArray]
"""From ground places (n, 3), whose heights are not used, to line and sample (n, 2)."""

QGIS = {"similarity": "Helmert", "order 1": "Polynomial 1", "order 2": "Polynomial 2",
        "order 3": "Polynomial 3", "projective": "Projective", "spline": "Thin Plate Spline"}
"""What QGIS's georeferencer calls them."""

GDALWARP = {"order 1": "-order 1", "order 2": "-order 2", "order 3": "-order 3", "spline": "-tps"}
"""Options of gdalwarp that choose them."""

_ALIKE = 0.01  # px
_SPLINED = 5000  # GCPs; a spline through more fills the memory, that of GDAL, too
_ACROSS = 15  # places along either side of the image at which files are compared


def places_of(fitted: Fit, heights: tuple[float, float] | None = None) -> FloatArray:
    """Return ground places (n, 3) over the image, at three heights, where the model holds.

    By default at the lowest, middle and highest control.
    """
    middle, half = fitted.ground_box()
    low, high = heights or (middle[2] - half[2], middle[2] + half[2])
    levels: set[float] = {float(low + share * (high - low)) for share in (0.0, 0.5, 1.0)} \
        if fitted.model.uses_height else {middle_height(fitted)}
    image = image_places(fitted, _ACROSS)
    ground = np.concatenate([ground_where_held(fitted, image, level) for level in sorted(levels)])
    return np.asarray(ground[np.isfinite(ground[:, :2]).all(axis=1)])


def by_splines(xy: FloatArray, image: FloatArray) -> Transformation:
    """Return the thin plate spline from ground to image through GCPs (n, 2), as GDAL does."""
    from scipy.interpolate import RBFInterpolator

    middle = xy.mean(axis=0)
    unit = float(np.ptp(xy, axis=0).max())
    spline = RBFInterpolator((xy - middle) / unit, image, kernel="thin_plate_spline")
    return lambda ground: np.asarray(spline((ground[:, :2] - middle) / unit))


def say_deviation(name: str, fitted: Fit, ground: FloatArray, image: FloatArray,
                  where: str = "") -> None:
    """Log the largest deviation of a format from the model, as a warning above CLOSE.

    The file puts the places `ground` (n, 3) at `image` (n, 2); `where` ends the sentence.
    """
    apart = image - fitted.project(ground)
    known = np.isfinite(apart).all(axis=1)
    if not known.any():
        return
    distance = np.hypot(*apart[known].T)
    worst = int(np.argmax(distance))
    place = ground[known][worst:worst + 1]
    moved = fitted.locate(image[known][worst:worst + 1], place[:, 2])
    metres = in_metres(fitted.control.crs, place, (moved - place)[:, :2])
    length = "" if metres is None or not np.isfinite(metres).all() \
        else f" ({_size(float(np.hypot(*metres[0])))} m on the ground)"
    close = distance[worst] <= CLOSE
    log.log(logging.INFO if close else logging.WARNING,
            "%s%s: at most %s px%s from the model%s.", "" if close else "Warning: ", name,
            _size(float(distance[worst])), length, where)


def _size(length: float) -> str:
    return f"{length:.2g}" if length < 100 else f"{length:,.0f}"


def say_measured(name: str) -> None:
    """Log that a format holds measurements and no model, so that nothing deviates."""
    log.info("%s contains the measurements and their residuals, not the model.", name)


def say_nearest(name: str, fitted: Fit, xy: FloatArray, image: FloatArray,
                labels: Mapping[str, str], where: str) -> str | None:
    """Log which transformation through measured GCPs (n, 2) is nearest to the model, and how near.

    Returns its key, or None where there is none.

    `labels` are what the program calls the transformations that it offers, as `QGIS` and
    `GDALWARP`, the simplest first; `where` is the rest of the sentence, with ``{}`` for the label.
    """
    sky = sky_said(fitted)
    if sky:
        log.warning("Warning: %s: %s, and whatever is fitted to these points gives it ground. "
                    "Rectify the image with termsel, or crop it below the horizon.", name, sky)
    ground = places_of(fitted)
    exact = fitted.project(ground)
    made = {key: by_gcps for key in labels
            if (by_gcps := _by_gcps(key, xy, image, fitted.control.crs)) is not None}
    if len(np.unique(xy, axis=0)) < len(xy):
        log.warning("Warning: %s: no thin plate spline goes through these GCPs, as some are above "
                    "each other.", name)
    elif len(xy) > _SPLINED:
        log.info("%s: a thin plate spline through more than %s GCPs is not tried, as it would fill "
                 "the memory.", name, f"{_SPLINED:,}")
    if not made or not len(ground):
        return None
    places = {key: transformation(ground) for key, transformation in made.items()}
    worst = {key: float(np.nan_to_num(np.hypot(*(place - exact).T), nan=np.inf).max())
             for key, place in places.items()}
    # The simplest of those that are as near, which the order of the labels tells.
    nearest = next(key for key in labels if worst.get(key, np.inf) <= min(worst.values()) + _ALIKE)
    ignored = ", and ignores heights" * fitted.model.uses_height
    say_deviation(name, fitted, ground, places[nearest],
                  f", {where.format(labels[nearest])}{ignored}")
    return nearest


def _by_gcps(key: str, xy: FloatArray, image: FloatArray, crs: str) -> Transformation | None:
    """Return a transformation by least squares of GCPs, or None if they do not determine it."""
    n = len(xy)
    if not n or min(np.linalg.matrix_rank(at - at.mean(axis=0)) for at in (xy, image)) < 2:
        return None  # all on a line
    if key == "spline":
        return by_splines(xy, image) if len(np.unique(xy, axis=0)) == n <= _SPLINED else None
    if key == "similarity":
        return _similarity(xy, image)
    if key == "projective":
        return _projective(xy, image) if n >= 4 else None
    # Heights of no meaning: GCPs above each other are not the same place.
    points = Points(tuple(map(str, range(n))), image, np.column_stack([xy, np.arange(float(n))]))
    gcps = FeatureSet(points, crs=crs)
    fitted = fit(Polynomial2D(degree=int(key[-1])), gcps, scaling_of(gcps))
    return fitted.project if fitted.determined else None


def _similarity(xy: FloatArray, image: FloatArray) -> Transformation:
    """Return the similarity that fits the ground to the image best on the ground, as in QGIS."""
    place = xy @ [1, 1j]
    pixel = image @ [-1j, 1]  # samples to the right, lines down
    away = pixel - pixel.mean()
    turn = np.vdot(away, place - place.mean()) / np.vdot(away, away)

    def project(ground: FloatArray) -> FloatArray:
        at = pixel.mean() + (ground[:, :2] @ [1, 1j] - place.mean()) / turn
        return np.column_stack([-at.imag, at.real])

    return project


def _projective(xy: FloatArray, image: FloatArray) -> Transformation:
    """Return the projective transformation by the direct linear transformation of QGIS."""
    def normalised(places: FloatArray) -> tuple[FloatArray, FloatArray]:
        middle = places.mean(axis=0)
        unit = np.sqrt(2.0) / np.linalg.norm(places - middle, axis=1).mean()
        matrix = np.array([[unit, 0, -unit * middle[0]], [0, unit, -unit * middle[1]], [0, 0, 1]])
        return np.column_stack([places, np.ones(len(places))]) @ matrix.T, matrix

    (source, of_image), (target, of_ground) = normalised(image), normalised(xy)
    # Each GCP crosses the ground place that is computed with the one that is known: 0.
    rows = [np.hstack([source, 0 * source, -target[:, :1] * source]),
            np.hstack([0 * source, source, -target[:, 1:2] * source])]
    # Of the triangle: U of thousands of rows would fill the memory.
    triangle = np.linalg.qr(np.concatenate(rows), mode="r")
    to_ground = np.linalg.svd(triangle)[2][-1].reshape(3, 3)
    to_image = np.linalg.inv(of_image) @ np.linalg.inv(to_ground) @ of_ground

    def project(ground: FloatArray) -> FloatArray:
        above = np.column_stack([ground[:, :2], np.ones(len(ground))]) @ to_image.T
        return np.asarray(above[:, :2] / above[:, 2:])

    return project
