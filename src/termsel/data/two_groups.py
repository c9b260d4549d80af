"""Points of two surveys in different datums: two groups that a constant shift on the ground parts.

An affine transformation of plan coordinates u (n, 2) in metres, and of heights where all are known,
predicts the image; g is 1 for points of the second group, else 0:

    image = A [1, u - g d, z] + noise,

which is linear in A and A d. Points are assigned in turn with that, beginning along the direction
in which the residuals without d scatter most. A split of normal errors in two takes them down to
0.6; so it takes a far smaller rest, in both groups, before anything is said.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from termsel.data.coordinates.crs import geodetic_of
from termsel.data.coordinates.metres import in_metres, plan_of
from termsel.data.features import BoolArray, FeatureSet, FloatArray

LEAST, LEAST_OF_GROUP = 12, 4
"""Points that can tell it, and those of the smaller group."""
_REST = 0.25
"""Largest part of the RMSE that is left with two groups."""
_APART = 6.0
"""Least distance of the groups [standard deviations within them]."""
_GROUPING_ROUNDS = 50
_FARTHEST = 2000.0
"""Longest shift [m]: datums of the Earth are less apart. Longer ones are of what an affine
transformation does not follow, such as an area of many degrees or an oblique view."""


_MODERN = re.compile(r"\(|ITRF|IGS|IGb|WGS 84|GTRF")
"""Names of realisations that are centimetres apart."""
_LIKE, _ABOUT = 0.25, 15.0
"""Part of a shift, and metres, by which that of a datum may differ: its grid may not be there."""


@dataclass(frozen=True)
class TwoGroups:
    """Two groups of points that are a constant shift on the ground apart.

    Parameters
    ----------
    first, second : tuple of str
        Ids; the first is the larger group.
    shift : tuple of float
        From the first to the second group, to the east and to the north [m].
    """

    first: tuple[str, ...]
    second: tuple[str, ...]
    shift: tuple[float, float]
    heights: bool
    """Whether heights are known: unknown ones may part points of two levels."""

    def sentence(self) -> str:
        """Return it as a sentence."""
        east, north = self.shift
        # Less than a metre along an axis is not worth a word.
        directions = []
        if abs(east) >= 1:
            directions.append(f"{abs(east):.0f} m {'east' if east > 0 else 'west'}")
        if abs(north) >= 1:
            directions.append(f"{abs(north):.0f} m {'north' if north > 0 else 'south'}")
        levels = "" if self.heights else ", or on two levels whose heights are not known"
        return (f"{len(self.second)} of {len(self.first) + len(self.second)} points lie "
                f"{' and '.join(directions)} of the positions that the others predict, as if "
                f"they were in another datum{levels}")


def datum_of(groups: TwoGroups, crs: str, position: tuple[float, float]) -> str:
    """Return the datum whose coordinates are so far from those of a CRS at longitude and latitude.

    "" where PROJ knows none that is in use there.
    """
    from pyproj import Transformer
    from pyproj.aoi import AreaOfInterest
    from pyproj.database import query_crs_info
    from pyproj.enums import PJType
    from pyproj.exceptions import ProjError

    lon, lat = position
    area = AreaOfInterest(lon - 0.01, lat - 0.01, lon + 0.01, lat + 0.01)
    offset = np.array(groups.shift)
    nearest = ("", max(_LIKE * float(np.linalg.norm(offset)), _ABOUT))
    for datum in query_crs_info("EPSG", PJType.GEOGRAPHIC_2D_CRS, area, contains=True):
        if _MODERN.search(datum.name):
            continue
        try:
            # The move of one place between the datums, to be compared with the shift of the groups.
            turn = Transformer.from_crs(geodetic_of(crs), f"EPSG:{datum.code}", always_xy=True,
                                        area_of_interest=area)
        except ProjError:
            continue
        x, y, *_ = turn.transform(lon, lat, 0.0)
        moved = in_metres("EPSG:4326", np.array([[lon, lat]]), np.array([[x - lon, y - lat]]))
        if moved is not None and np.isfinite(moved).all():
            distance = float(np.linalg.norm(moved[0] - offset))
            nearest = min(nearest, (datum.name, distance), key=lambda candidate: candidate[1])
    return nearest[0]


def two_groups(features: FeatureSet) -> TwoGroups | None:
    """Return the groups of points that lie as if by two datums, or None."""
    points = features.points
    plan = plan_of(features.crs, points.ground) if len(points) >= LEAST else None
    if plan is None or not np.isfinite(plan).all():
        return None
    # [1, u, z] of the docstring; z only where all heights are known.
    design = np.column_stack([np.ones(len(plan)), plan])
    if np.isfinite(points.ground[:, 2]).all():
        design = np.column_stack([design, points.ground[:, 2] - points.ground[:, 2].mean()])
    _, joint_residuals = _residuals(design, points.image)
    second = _split(joint_residuals)
    # Like k-means with two centres: fit with this split, then each point to the nearer group.
    for _ in range(_GROUPING_ROUNDS):
        if not LEAST_OF_GROUP <= second.sum() <= len(plan) - LEAST_OF_GROUP:
            return None
        coefficients, residuals = _residuals(np.column_stack([design, second]), points.image)
        move = coefficients[-1]
        from_first = residuals + np.outer(second, move)  # as if all were of the first group
        nearer = np.linalg.norm(from_first - move, axis=1) < np.linalg.norm(from_first, axis=1)
        if (nearer == second).all():
            break
        second = nearer
    # Two groups must leave far less than one, and lie far apart within their scatter.
    sigma = float(np.sqrt((residuals**2).sum() / (2 * (len(plan) - len(coefficients)))))
    if np.sqrt((residuals**2).sum()) > _REST * np.sqrt((joint_residuals**2).sum()) \
            or np.linalg.norm(move) < _APART * sigma:
        return None
    # Ground coordinates that are d too far to the east have the image of what is d to the west.
    shift = -np.linalg.solve(coefficients[1:3].T, move)
    if np.linalg.norm(shift) > _FARTHEST:
        return None
    if second.sum() > len(plan) / 2:
        second = ~second
        shift = -shift
    names = np.array(points.ids, dtype=object)
    return TwoGroups(tuple(names[~second]), tuple(names[second]),
                     (float(shift[0]), float(shift[1])), design.shape[1] > 3)


def _residuals(design: FloatArray, image: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the coefficients and the residuals of a least-squares fit."""
    coefficients = np.asarray(np.linalg.lstsq(design, image, rcond=None)[0], dtype=np.float64)
    return coefficients, image - design @ coefficients


def _split(residuals: FloatArray) -> BoolArray:
    """Return which residuals are beyond the largest gap near the middle of their main direction."""
    projected = residuals @ np.linalg.svd(residuals, full_matrices=False)[2][0]
    # Only gaps that leave enough points on either side count.
    order = np.sort(projected)
    gaps = np.diff(order)[LEAST_OF_GROUP - 1:len(order) - LEAST_OF_GROUP]
    at = LEAST_OF_GROUP - 1 + int(np.argmax(gaps))
    return np.asarray(projected > (order[at] + order[at + 1]) / 2)
