"""How far what another program makes of an exported file is from the fitted model."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping

import numpy as np

from termsel.data.coordinates.metres import offsets_in_metres
from termsel.data.features import FeatureSet, FloatArray, Points
from termsel.data.scaling import make_scaling
from termsel.fitting.fit import Fit
from termsel.fitting.least_squares import fit
from termsel.fitting.sky import ground_where_held, image_places, middle_height, sky_said
from termsel.models.polynomial import Polynomial2D

log = logging.getLogger(__name__)

MAX_SILENT_DEVIATION = 1.0
"""Deviation from the model [px] above which an export warns."""

_INVISIBLE = 0.001
"""Deviation [px, m] below which "at most 0.001" is said."""

Transformation = Callable[[FloatArray], FloatArray]
"""From ground places (n, 3), whose heights are not used, to line and sample (n, 2)."""

QGIS = {"similarity": "Helmert", "order 1": "Polynomial 1", "order 2": "Polynomial 2",
        "order 3": "Polynomial 3", "projective": "Projective", "spline": "Thin Plate Spline"}
"""What QGIS's georeferencer calls them."""

GDALWARP = {"order 1": "-order 1", "order 2": "-order 2", "order 3": "-order 3", "spline": "-tps"}
"""Options of gdalwarp that choose them."""

_ALIKE_PX = 0.01  # px
_SPLINED = 5000  # GCPs; a spline through more fills the memory, that of GDAL, too
_GRID_NODES_ACROSS = 15  # places along either side of the image at which files are compared


def places_of(fitted: Fit, heights: tuple[float, float] | None = None) -> FloatArray:
    """Return ground places (n, 3) over the image, at three heights, where the model holds.

    `heights` are the lowest and highest of the three, by default those of the control; a model
    without heights is asked at one alone.
    """
    middle, half_extent = fitted.ground_box()
    # At three heights, as a format may ignore heights, which one level would not show.
    low, high = heights or (middle[2] - half_extent[2], middle[2] + half_extent[2])
    if fitted.model.uses_height:
        levels: set[float] = {float(low + share * (high - low)) for share in (0.0, 0.5, 1.0)}
    else:
        levels = {middle_height(fitted)}
    image = image_places(fitted, _GRID_NODES_ACROSS)
    ground = np.concatenate([ground_where_held(fitted, image, level) for level in sorted(levels)])
    return np.asarray(ground[np.isfinite(ground[:, :2]).all(axis=1)])


def fit_splines(xy: FloatArray, image: FloatArray) -> Transformation:
    """Return a function from ground (m, 2 or 3) to image (m, 2): the thin plate spline of GDAL.

    It goes through the GCPs, whose places are `xy` and `image`, (n, 2) each.
    """
    from scipy.interpolate import RBFInterpolator

    # Scaled, as the kernel r^2 log r of coordinates in metres is ill-conditioned.
    middle = xy.mean(axis=0)
    unit = float(np.ptp(xy, axis=0).max())
    spline = RBFInterpolator((xy - middle) / unit, image, kernel="thin_plate_spline")
    return lambda ground: np.asarray(spline((ground[:, :2] - middle) / unit))


MAP = "map"
"""What the map of `termsel rectify` is called in messages."""


def say_deviation(name: str, fitted: Fit, ground: FloatArray, image: FloatArray,
                  ending: str = "") -> float:
    """Log the largest deviation of a format from the model, and return it [px]; 0 if none is known.

    It is a warning above MAX_SILENT_DEVIATION. `name` is that of the format, whose file puts the
    positions `ground` (n, 3) at `image` (n, 2); `ending` ends the sentence.
    """
    difference = image - fitted.project(ground)
    finite = np.isfinite(difference).all(axis=1)
    if not finite.any():
        return 0.0
    distance = np.hypot(*difference[finite].T)
    worst = int(np.argmax(distance))
    worst_ground = ground[finite][worst:worst + 1]
    # Where the model sees the pixel at which the file puts the worst position, at its height.
    moved = fitted.locate(image[finite][worst:worst + 1], worst_ground[:, 2])
    metres = offsets_in_metres(fitted.control.crs, worst_ground, (moved - worst_ground)[:, :2])
    if metres is None or not np.isfinite(metres).all():
        length = ""
    else:
        length = f" ({_length_in_words(float(np.hypot(*metres[0])))} m on the ground)"
    is_close = distance[worst] <= MAX_SILENT_DEVIATION
    level = logging.INFO if is_close else logging.WARNING
    beginning = "" if is_close else "Warning: "
    # The map of termsel rectify is the remedy for what a format cannot hold, but not for itself.
    remedy = "" if is_close or name == MAP else " A map by termsel rectify keeps to the model."
    log.log(level, "%s%s: at most %s px%s from the model%s.%s", beginning, name,
            _length_in_words(float(distance[worst])), length, ending, remedy)
    return float(distance[worst])


def _length_in_words(length: float) -> str:
    """Return a length with two digits; one that nobody can see is at most its bound."""
    length = max(length, _INVISIBLE)
    return f"{length:.2g}" if length < 100 else f"{length:,.0f}"


def say_measured(name: str) -> None:
    """Log that a format holds measurements and no model, so that nothing deviates."""
    log.info("%s contains the measurements and their residuals, not the model.", name)


def say_nearest_transformation(name: str, fitted: Fit, xy: FloatArray, image: FloatArray,
                               labels: Mapping[str, str], ending: str) -> str | None:
    """Log which transformation through measured GCPs is nearest to the model, and how near.

    `xy` and `image` (n, 2) are where the GCPs are on the ground and in the image [px]. Returns the
    key of the simplest one that is as near as the nearest; None if the GCPs determine none, or the
    model shows no ground. `labels` are what a program calls the transformations that it offers,
    such as `QGIS` and `GDALWARP`, the simplest first; `ending` is the rest of the sentence, with
    ``{}`` for the label.
    """
    sky = sky_said(fitted)
    if sky:
        log.warning("Warning: %s: %s, and whatever is fitted to these points gives it ground. "
                    "Rectify the image with termsel, or crop it below the horizon.", name, sky)
    ground = places_of(fitted)
    exact = fitted.project(ground)
    transformations: dict[str, Transformation] = {}
    for key in labels:
        by_gcps = _transformation_of_gcps(key, xy, image, fitted.control.crs)
        if by_gcps is not None:
            transformations[key] = by_gcps
    if len(np.unique(xy, axis=0)) < len(xy):
        log.warning("Warning: %s: no thin plate spline goes through these GCPs, as some are above "
                    "each other.", name)
    elif len(xy) > _SPLINED:
        log.info("%s: a thin plate spline through more than %s GCPs is not tried, as it would fill "
                 "the memory.", name, f"{_SPLINED:,}")
    if not transformations or not len(ground):
        return None
    positions = {key: transformation(ground) for key, transformation in transformations.items()}
    worst = {}
    for key, computed in positions.items():
        # A place without a position is infinitely far from the model.
        distances = np.nan_to_num(np.hypot(*(computed - exact).T), nan=np.inf)
        worst[key] = float(distances.max())
    # The simplest transformation that is as near as any: labels are in that order.
    nearest = next(key for key in labels
                   if worst.get(key, np.inf) <= min(worst.values()) + _ALIKE_PX)
    ignored = ", and ignores heights" if fitted.model.uses_height else ""
    say_deviation(name, fitted, ground, positions[nearest],
                  f", {ending.format(labels[nearest])}{ignored}")
    return nearest


def _transformation_of_gcps(key: str, xy: FloatArray, image: FloatArray,
                            crs: str) -> Transformation | None:
    """Return a function from ground to image by GCPs, or None if they do not determine it.

    `key` says of which kind, such as "similarity" or "polynomial2"; a spline is also None for GCPs
    above each other, and for more than _SPLINED. `xy` and `image` are (n, 2) each.
    """
    n = len(xy)
    # GCPs on one line, on the ground or in the image, determine no transformation.
    ranks = [np.linalg.matrix_rank(places - places.mean(axis=0)) for places in (xy, image) if n]
    if not n or min(ranks) < 2:
        return None
    if key == "spline":
        return fit_splines(xy, image) if len(np.unique(xy, axis=0)) == n <= _SPLINED else None
    if key == "similarity":
        return _fit_similarity(xy, image)
    if key == "projective":
        return _fit_projective(xy, image) if n >= 4 else None
    # Heights without a meaning make different places of GCPs above each other.
    points = Points(tuple(map(str, range(n))), image, np.column_stack([xy, np.arange(float(n))]))
    gcps = FeatureSet(points, crs=crs)
    fitted = fit(Polynomial2D(degree=int(key[-1])), gcps, make_scaling(gcps))
    return fitted.project if fitted.determined else None


def _fit_similarity(xy: FloatArray, image: FloatArray) -> Transformation:
    """Return the similarity from ground to image with the least squares on the ground, as in QGIS.

    `xy` (n, 2) are x and y of points, `image` (n, 2) their line and sample. The similarity maps
    ground positions, of which only x and y count, to (m, 2) lines and samples.
    """
    # A similarity is z -> a z + b of complex numbers. From image to ground, a = sum conj(p) g /
    # sum |p|^2 for positions p and g less their means fits best on the ground.
    plan = xy @ [1, 1j]
    pixel = image @ [-1j, 1]  # samples to the right, lines down
    centred = pixel - pixel.mean()
    a = np.vdot(centred, plan - plan.mean()) / np.vdot(centred, centred)

    def project(ground: FloatArray) -> FloatArray:
        position = pixel.mean() + (ground[:, :2] @ [1, 1j] - plan.mean()) / a
        return np.column_stack([-position.imag, position.real])

    return project


def _fit_projective(xy: FloatArray, image: FloatArray) -> Transformation:
    """Return the projective transformation by the direct linear transformation of QGIS.

    `xy` (n, 2) are ground and `image` (n, 2) image positions. The cross product of a place with its
    projection is 0, linear in the nine elements of H; both sets of coordinates are normalised
    before, as Hartley (1997) has it. QGIS minimises the same algebraic error, so that the deviation
    from its transformation can be told.
    """
    def normalise(points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return homogeneous points (n, 3) about 0, at a mean distance sqrt(2), and the matrix."""
        middle = points.mean(axis=0)
        unit = np.sqrt(2.0) / np.linalg.norm(points - middle, axis=1).mean()
        matrix = np.array([[unit, 0, -unit * middle[0]], [0, unit, -unit * middle[1]], [0, 0, 1]])
        return np.column_stack([points, np.ones(len(points))]) @ matrix.T, matrix

    source, of_image = normalise(image)
    target, of_ground = normalise(xy)
    # Each GCP crosses the ground place that is computed with the one that is known: 0.
    rows = [np.hstack([source, 0 * source, -target[:, :1] * source]),
            np.hstack([0 * source, source, -target[:, 1:2] * source])]
    # The triangle has the singular vectors of the rows, whose own U would fill the memory.
    triangle = np.linalg.qr(np.concatenate(rows), mode="r")
    # The right singular vector of the least singular value solves rows @ h = 0 with |h| = 1 best.
    to_ground = np.linalg.svd(triangle)[2][-1].reshape(3, 3)
    to_image = np.linalg.inv(of_image) @ np.linalg.inv(to_ground) @ of_ground

    def project(ground: FloatArray) -> FloatArray:
        homogeneous = np.column_stack([ground[:, :2], np.ones(len(ground))]) @ to_image.T
        return np.asarray(homogeneous[:, :2] / homogeneous[:, 2:])

    return project
