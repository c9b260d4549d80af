"""The unit of z, where x and y are in feet and z may be in feet or in metres."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from termsel.core.errors import TermselError
from termsel.core.options import Option
from termsel.data.coordinates.crs import (
    LOCAL,
    height_axis_unit,
    is_geographic,
    metres_per_height,
    metres_per_unit,
    short_crs_name,
    to_wgs84,
)
from termsel.data.coordinates.height_units import (
    FOOT,
    METRE,
    UNITS,
    US_FOOT,
    WORDS,
    is_unit_open,
    unit_of_plane,
    unit_of_size,
    with_height_unit,
)
from termsel.data.features import FeatureSet, FloatArray
from termsel.data.rpc import Rpc
from termsel.data.tables.unit_names import ANGLES, LENGTHS, UNIT_WORDS
from termsel.formats.heights import open_dem

if TYPE_CHECKING:
    from collections.abc import Mapping

OF_PLANE = "crs"
Z_UNIT = Option(
    "z_unit", None, "Unit of z: metre, us-ft (US survey feet), ft, or crs, that of x and y. "
    "By default that of the CRS; if the CRS defines the unit of x and y only, and they are in "
    "feet, a DEM or an RPC may decide.", choices=(*UNITS, OF_PLANE))

_TELLING = 4  # heights from which on their scatter shows the unit
_CLEAR = 1 / 3  # of the scatter, or of the distance, in another unit
_MAX_GEOID_HEIGHT = 150.0  # metres by which no geoid is from an ellipsoid
_WITHIN = 1.2  # half-ranges of an RPC's heights
_MOST_HEIGHTS, _FEW_HEIGHTS = 0.9, 0.1  # shares of heights in them


def with_z_unit(features: FeatureSet, stated: str | None, dem: Path | None = None) -> FeatureSet:
    """Return features whose heights are in the unit of their CRS.

    The unit of z is the one `stated`, else the one that the CRS or the name of the column declares.
    Else a DEM or an RPC shows it, if one unit alone agrees with that; independent points are not
    used for it. Features without heights, or without a CRS, are returned as they are. Raises
    TermselError where z may be in feet or in metres and nothing shows which; for a unit that plane
    coordinates without a CRS cannot have; for kilometres where the CRS is in feet.
    """
    if stated is not None:
        return _convert_to_asked_unit(features, stated)
    heights = features.ground_vertices()[:, 2]
    if features.crs == LOCAL or not np.isfinite(heights).any():
        return features
    declared = height_axis_unit(features.crs)
    if declared is not None:
        unit = unit_of_size(declared)
        return features if unit in (None, METRE) else replace(features, z_unit=WORDS[str(unit)])
    named = features.named_units.get("z", "")
    if named in (FOOT, US_FOOT):
        return _heights_in_unit(features, named, "by the name of its column")
    # z equal to 0 is the same in every unit.
    if not is_unit_open(features.crs) or not np.nan_to_num(heights).any():
        return features
    if named in LENGTHS:
        return _heights_in_unit(features, METRE,
                                f"as its column is in {UNIT_WORDS[named]} by its name")
    in_feet = str(unit_of_plane(features.crs))
    units = (in_feet, METRE)
    if dem is not None and (unit := _unit_by_dem(features, units, dem)):
        return _heights_in_unit(features, unit, "as the DEM says")
    if features.rpc is not None and (unit := _unit_by_rpc(features, units, features.rpc)):
        return _heights_in_unit(features, unit, "as the RPC says")
    raise TermselError(
        f"z may be in {WORDS[in_feet]}, as x and y in {short_crs_name(features.crs)} are, or in "
        "metres",
        hint=f"State it: --set z_unit={in_feet} or --set z_unit={METRE}.")


def refuse_other_units(units: Mapping[str, str], crs: str, *,
                       are_heights_open: bool = False) -> None:
    """Raise TermselError for coordinates in another unit by their names than the CRS counts in.

    Parameters
    ----------
    units : mapping
        Units by axis, as `termsel.data.features.FeatureSet.named_units`.
    crs : str
        The CRS of the ground coordinates.
    are_heights_open : bool
        Whether the heights of a CRS without a vertical axis may be in any unit.
    """
    if crs == LOCAL:
        return
    for axis, unit in units.items():
        if axis == "z":
            size = height_axis_unit(crs)
            if size is None and are_heights_open:
                continue
            counted = unit_of_size(metres_per_height(crs) if size is None else size)
        elif is_geographic(crs):
            counted = "degrees"
        else:
            size = metres_per_unit(crs)
            # Where nobody knows the unit, nothing contradicts.
            counted = unit if size is None else unit_of_size(size)
        if not _agree(unit, counted):
            unit_of_crs = UNIT_WORDS.get(str(counted), str(counted or "another unit"))
            raise TermselError(
                f"{axis} is in {UNIT_WORDS[unit]} by the name of its column, and "
                f"{short_crs_name(crs)} is in {unit_of_crs}",
                hint="Give the coordinates in the unit of the CRS, or transform them to a CRS in "
                     f"{_CRS_OF_UNIT.get(unit, 'feet')}.")


_CRS_OF_UNIT = dict.fromkeys(LENGTHS, "metres") | dict.fromkeys(ANGLES, "degrees")
"""In what a CRS counts whose coordinates may be read in a unit, for messages."""


def _agree(named: str, counted: str | None) -> bool:
    """Return whether coordinates named in a unit may be those of a CRS that counts in one."""
    if named in ANGLES:
        return counted in ("degrees", named)
    if named in LENGTHS:
        return counted in (METRE, named)
    # "ft" is written for either foot.
    return counted in (FOOT, US_FOOT, named)


def crs_with_z_unit(crs: str, stated: str) -> str:
    """Return a CRS whose heights are in the unit that the option z_unit states.

    Raises TermselError for an unknown unit, and for coordinates without a CRS.
    """
    return with_height_unit(crs, _asked_unit(crs, stated))


def z_unit_in_words(crs: str) -> str:
    """Return the unit of the heights of a CRS, such as "US survey feet", where it must be said.

    It is "" where x, y and heights are in metres, in degrees and metres, or in a unit without name.
    """
    unit = unit_of_size(metres_per_height(crs))
    if unit is None or (unit == METRE and unit_of_plane(crs) is None):
        return ""
    return WORDS[unit]


def _asked_unit(crs: str, stated: str) -> str:
    """Return the unit of heights, as in `UNITS`, that the option z_unit states for a CRS.

    Raises TermselError for an unknown unit, and for coordinates without a CRS.
    """
    if stated not in Z_UNIT.choices:
        raise TermselError(f"option 'z_unit' does not take {stated!r}",
                           hint=f"It takes: {' | '.join(Z_UNIT.choices)}.")
    if crs == LOCAL:
        raise TermselError("plane coordinates without a CRS have z in their own unit",
                           hint="Leave z_unit out, or state the CRS of the ground coordinates.")
    return unit_of_plane(crs) or METRE if stated == OF_PLANE else stated


def _convert_to_asked_unit(features: FeatureSet, stated: str) -> FeatureSet:
    """Return features whose CRS has heights in the unit that the option z_unit states.

    Coordinates stay as they are. Raises TermselError for an unknown unit, for coordinates without a
    CRS, and where the name of the column states another unit.
    """
    unit = _asked_unit(features.crs, stated)
    named = features.named_units.get("z", "")
    if named and not _agree(named, unit):
        raise TermselError(
            f"z is in {UNIT_WORDS[named]} by the name of its column, and z_unit says {WORDS[unit]}",
            hint="Leave z_unit out, or correct the name.")
    return _heights_in_unit(features, unit, "as stated")


def _heights_in_unit(features: FeatureSet, unit: str, why: str) -> FeatureSet:
    """Return features whose CRS has heights in a unit, with the reason in words."""
    return replace(features, crs=with_height_unit(features.crs, unit),
                   z_unit=f"{WORDS[unit]}, {why}")


def _points_that_tell(features: FeatureSet) -> FeatureSet:
    """Return the points with a height, but those that are off or independent."""
    points = features.points
    # Of lines all vertices count; roles are of points alone.
    has_say = [role not in ("off", "independent") for role in points.roles] or [True] * len(points)
    return features.with_(points=points.take(np.isfinite(points.ground).all(axis=1)
                                             & np.array(has_say, dtype=bool)))


def _unit_by_dem(features: FeatureSet, units: tuple[str, ...], dem: Path) -> str | None:
    """Return the unit in which heights differ from a DEM by a shift, or agree with it.

    Returns None if the DEM does not decide between them.
    """
    ground = _points_that_tell(features).ground_vertices()
    ground = ground[np.isfinite(ground[:, 2])]
    with open_dem(dem, with_height_unit(features.crs, METRE)) as surface:
        surface_heights = surface(ground[:, :2])
    on_dem = np.isfinite(surface_heights)
    differences = {unit: ground[on_dem, 2] * UNITS[unit] - surface_heights[on_dem]
                   for unit in units}
    if not on_dem.any():
        return None
    # A wrong unit stretches the relief, so that the differences scatter; a datum shifts them.
    if on_dem.sum() >= _TELLING:
        return _clearly_smallest(
            {unit: _median_scatter(over) for unit, over in differences.items()})
    # Of few points only distances beyond that of any geoid show a unit.
    distance = {unit: float(np.median(np.abs(over))) for unit, over in differences.items()}
    return _clearly_smallest(distance) if max(distance.values()) > _MAX_GEOID_HEIGHT else None


def _unit_by_rpc(features: FeatureSet, units: tuple[str, ...], rpc: Rpc) -> str | None:
    """Return the unit of heights in which an RPC sees or covers the points, but for a shift.

    `units` are those to choose from. Returns None if more than one of them will do, or none.
    """
    points = _points_that_tell(features).points
    if not len(points):
        return None
    scatter: dict[str, float] = {}
    covered: dict[str, float] = {}
    for unit in units:
        ground = to_wgs84(with_height_unit(features.crs, unit))(points.ground)
        with np.errstate(all="ignore"):
            scatter[unit] = _median_scatter(rpc.project(ground) - points.image)
        # In wrong units most heights are outside of the range that the RPC was made for.
        above = np.abs(ground[:, 2] - rpc.ground_offset[2])
        covered[unit] = float((above <= _WITHIN * abs(rpc.ground_scale[2])).mean())
    clearly = _clearly_smallest(scatter) if len(points) >= _TELLING else None
    if clearly is not None:
        return clearly
    best, second = sorted(units, key=lambda unit: -covered[unit])
    return best if covered[best] >= _MOST_HEIGHTS and covered[second] <= _FEW_HEIGHTS else None


def _median_scatter(values: FloatArray) -> float:
    """Return the median distance from the median of values (n,) or of vectors (n, 2)."""
    away = values - np.median(values, axis=0)
    return float(np.median(np.abs(away) if away.ndim == 1 else np.linalg.norm(away, axis=1)))


def _clearly_smallest(sizes: Mapping[str, float]) -> str | None:
    """Return the unit of clearly the smallest size; None if none is."""
    # The best must be three times as near as the other, which noise is not.
    best, second = sorted(sizes, key=lambda unit: sizes[unit])
    return best if sizes[best] < _CLEAR * sizes[second] else None
