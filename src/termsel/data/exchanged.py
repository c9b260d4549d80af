"""Points that no view of a plane shows as they are: exchanged, or one of them wrong.

Seen from above, a plane keeps the turning of all triangles of its points, or reverses all of them
in a mirrored image; so does any view of it whose points lie in front of the camera. Few points tell
no blunder by their errors, but single triangles that are reversed do.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from termsel.data.features import FloatArray, IntArray
from termsel.data.fit_data import FitData

MIN_EXCHANGED_POINTS, MAX_EXCHANGED_POINTS = 4, 12
"""Numbers of points that are looked at: of more, errors tell."""

THIN = 0.05
"""Height of a triangle, by the extent of all points, up to which it may be reversed by errors."""


@dataclass(frozen=True)
class Exchange:
    """Points that may be wrong, by their indices, and whether two are likely exchanged."""

    points: tuple[int, ...]
    is_pair: bool


def exchange_of(control: FitData) -> Exchange | None:
    """Return which points reverse single triangles of a plane; None if none does, or of hills."""
    count = len(control.features.points)
    if control.heights or len(control.features.lines) \
            or not MIN_EXCHANGED_POINTS <= count <= MAX_EXCHANGED_POINTS:
        return None
    points = control.scaled.points
    ground = points.ground[:, :2]
    image = points.image
    if not _mixed(_turnings(ground, image)):
        return None
    # What would make the plane a view again: two points exchanged, or one left out; the affine
    # residual of the rest decides among several.
    repairs: list[tuple[float, Exchange]] = []
    for pair in combinations(range(count), 2):
        # The image coordinates of the two are exchanged.
        order = np.arange(count)
        order[list(pair)] = pair[::-1]
        turnings = _turnings(ground, image[order])
        if not _mixed(turnings):
            # A mirrored image is rare.
            mirrored = 1e3 if (turnings > 0).any() else 1.0
            repairs.append((mirrored * _left(ground, image[order]), Exchange(pair, True)))
    for wrong in range(count) if count > MIN_EXCHANGED_POINTS else ():
        remaining = np.delete(np.arange(count), wrong)
        if not _mixed(_turnings(ground[remaining], image[remaining])):
            repairs.append((_left(ground[remaining], image[remaining]), Exchange((wrong,), False)))
    if repairs:
        return min(repairs, key=lambda repair: repair[0])[1]
    return Exchange(tuple(range(count)), False)


def errors_by_others(control: FitData) -> FloatArray:
    """Return how far each point is from where an affine transformation of the others sees it [px].
    """
    points = control.scaled.points
    columns = np.column_stack([np.ones(len(points)), points.ground[:, :2]])
    errors = np.empty(len(points))
    for i in range(len(points)):
        is_other = np.arange(len(points)) != i
        # Each point by a fit of its own, as few points leave little redundancy.
        affine = np.linalg.lstsq(columns[is_other], points.image[is_other])[0]
        errors[i] = np.linalg.norm(points.image[i] - columns[i] @ affine)
    return errors * control.scaling.image_scale


def _turnings(ground: FloatArray, image: FloatArray) -> IntArray:
    """Return the signs by which triangles turn in the image and on the ground, multiplied.

    0 of those that are thin. Lines count downwards, so that an image that is not mirrored has -1.
    """
    triangles = np.array(list(combinations(range(len(ground)), 3)))
    on_ground = _turning(ground[triangles])
    in_image = _turning(image[triangles][..., ::-1])
    return np.asarray(on_ground * in_image, dtype=np.intp)


def _turning(corners: FloatArray) -> FloatArray:
    """Return by which sign triangles (n, 3, 2) turn; 0 of thin ones."""
    first = corners[:, 1] - corners[:, 0]
    second = corners[:, 2] - corners[:, 0]
    # Twice the signed area; by the longest side it is the height of the triangle.
    double = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    lengths = np.linalg.norm(np.stack([first, second, second - first]), axis=2)
    extent = np.ptp(corners.reshape(-1, 2), axis=0).max()
    thick = np.abs(double) > THIN * extent * lengths.max(axis=0)
    return np.where(thick, np.sign(double), 0.0)


def _mixed(turnings: IntArray) -> bool:
    return bool((turnings > 0).any() and (turnings < 0).any())


def _left(ground: FloatArray, image: FloatArray) -> float:
    """Return what an affine transformation leaves of image places, by its freedom."""
    columns = np.column_stack([np.ones(len(ground)), ground])
    residuals = image - columns @ np.linalg.lstsq(columns, image)[0]
    return float(np.sqrt((residuals**2).sum() / max(2 * len(ground) - 6, 1)))
