"""Coordinate reference systems: names, kinds, and coordinates that cannot be in them.

pyproj is optional. Without it only the form of a name and the well-known codes are checked.
In termsel x is always longitude or easting and y latitude or northing, whatever axis order
the authority gives.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING
from warnings import catch_warnings, simplefilter

import numpy as np

from termsel.errors import TermselError, counted
from termsel.measurements.features import BoolArray, FeatureSet, FloatArray

if TYPE_CHECKING:
    from pyproj import CRS

LOCAL = "local"
EXAMPLES = ("EPSG:4979 (longitude, latitude, ellipsoidal height), EPSG:32631 (UTM zone 31 north) "
            "or local (plane coordinates without a CRS)")

WGS84 = frozenset({"EPSG:4326", "EPSG:4979"})
"""WGS84 longitude and latitude; the second also says that heights are ellipsoidal."""

Transformation = Callable[[FloatArray], FloatArray]
"""From ground coordinates to others, shapes (n, 3)."""

_CODE = re.compile(r"(?:urn:ogc:def:crs:)?(EPSG|OGC):(?:[\d.]*:)?(\w+)", re.IGNORECASE)
_COMPOUND = re.compile(r"EPSG:(\d{1,9})\+(\d{1,9})", re.IGNORECASE)
# x is longitude in termsel, so the OGC names say nothing more than the EPSG codes.
_OGC = {"CRS84": "EPSG:4326", "CRS84H": "EPSG:4979"}
_UTM = re.compile(r"EPSG:32([67])(0[1-9]|[1-5]\d|60)")
_WKT = re.compile(r"(GEOG|GEOD|GEOC|PROJ|COMP|LOCAL_CS|ENG|BOUND|DERIVED)\w*\s*\[.*\]",
                  re.IGNORECASE | re.DOTALL)

# The code of the whole CRS is last, in WKT's outermost bracket.
_AUTHORITY = re.compile(r'(?:ID|AUTHORITY)\s*\[\s*"EPSG"\s*,\s*"?(\d{1,9})"?\s*\]\s*\]\s*$',
                        re.IGNORECASE)

_NEAR = 1000.0  # metres from the origin of a CRS
_DEGREES = ((-180.0, -90.0), (360.0, 90.0))
# Generous: scenes reach into the next zone, and some producers keep northern zones with
# negative northings south of the equator.
_UTM_RANGE = {"6": ((0.0, -9.4e6), (1e6, 9.4e6)), "7": ((0.0, 0.0), (1e6, 10.5e6))}


def normalise(crs: str) -> str:
    """Return the normal form of a CRS, in which names are compared.

    Parameters
    ----------
    crs : str
        "EPSG:n", "EPSG:n+m" with heights of their own, "OGC:CRS84", their URN forms, WKT, or
        "local".

    Returns
    -------
    str
        "EPSG:n" where the code is known, pyproj finds it or WKT ends with it, else "EPSG:n+m" or
        the WKT, or "local".

    Raises
    ------
    TermselError
        For text in none of these forms. If pyproj is installed, also for a code that does not
        exist, WKT that cannot be read, or a CRS without horizontal coordinates.
    """
    text = crs.strip()
    if text.lower() == LOCAL:
        return LOCAL
    code = _CODE.fullmatch(text)
    if code:
        authority, number = code[1].upper(), code[2].upper()
        if authority == "OGC" and number in _OGC:
            return _OGC[number]
        if authority == "EPSG" and number.isdecimal() and len(number) < 10:
            name = f"EPSG:{int(number)}"
            if name not in WGS84 and not _UTM.fullmatch(name):
                _with_pyproj(name)
            return name
    elif (two := _COMPOUND.fullmatch(text)) or _WKT.fullmatch(text):
        text = f"EPSG:{int(two[1])}+{int(two[2])}" if two else text
        known = _with_pyproj(text)
        if known is None:
            own = _AUTHORITY.search(text)
            return f"EPSG:{int(own[1])}" if own else text
        epsg = known.to_epsg(min_confidence=100)
        return text if epsg is None else f"EPSG:{epsg}"
    guess = f"Did you mean EPSG:{text}? " if text.isdecimal() else ""
    raise TermselError(f"unknown CRS {crs!r}", hint=f"{guess}Examples: {EXAMPLES}; or WKT.")


def is_geographic(crs: str) -> bool:
    """Return True where x and y are longitude and latitude.

    Parameters
    ----------
    crs : str
        As for `normalise`.

    Returns
    -------
    bool
        Also False for a CRS whose kind only pyproj knows, if that is not installed.

    Raises
    ------
    TermselError
        For a CRS `normalise` refuses.
    """
    return _kind(normalise(crs)) == "geographic"


def metres_per_unit(crs: str) -> float | None:
    """Return the length of the unit of x and y of a projected CRS in metres.

    None for other kinds, and where only pyproj would know and is not installed.
    """
    crs = normalise(crs)
    if _UTM.fullmatch(crs):
        return 1.0
    known = None if crs == LOCAL else _with_pyproj(crs)
    return float(known.axis_info[0].unit_conversion_factor) \
        if known is not None and known.is_projected else None


def to_wgs84(crs: str) -> Transformation:
    """Return a function from ground coordinates to WGS84 longitude, latitude, ellipsoidal height.

    Parameters
    ----------
    crs : str
        Of the ground coordinates.

    Raises
    ------
    TermselError
        As `transformation`.
    """
    return transformation(crs, "EPSG:4979")


@lru_cache
def transformation(source: str, target: str, *, strict: bool = True) -> Transformation:
    """Return a function that transforms ground coordinates from one CRS to another.

    Parameters
    ----------
    source, target : str
        As for `normalise`; if a CRS has no vertical datum, heights are taken as
        ellipsoidal.
    strict : bool
        Whether coordinates that cannot be transformed are an error; else they become infinite.

    Returns
    -------
    callable
        From (n, 3) to (n, 3). Unknown heights are taken as 0.

    Raises
    ------
    TermselError
        For "local"; if pyproj, which is needed for all but WGS84 itself, is not installed or
        cannot transform the CRS.
    """
    source, target = normalise(source), normalise(target)
    if source == target or WGS84.issuperset((source, target)):
        return np.asarray
    into = "longitude and latitude" if target in WGS84 else _short(target)
    if LOCAL in (source, target):
        raise TermselError(f"plane coordinates without a CRS cannot be transformed to {into}",
                           hint="State the CRS of the ground coordinates.")
    try:
        from pyproj import Transformer
        from pyproj.exceptions import ProjError
    except ImportError:
        raise TermselError(f"the transformation of {_short(source)} to {into} requires the package "
                           "pyproj, which is not installed",
                           hint='Install it: pip install "termsel[gis]".') from None
    failure = f"coordinates in {_short(source)} cannot be transformed to {into}"
    known = [_with_pyproj(name) for name in (source, target)]
    ends = [one if len(one.axis_info) > 2 else one.to_3d() for one in known if one is not None]
    try:
        turn = Transformer.from_crs(*ends, always_xy=True, allow_ballpark=False)
    except ProjError as error:
        grids = _missing_grids(*ends)
        if not grids:
            raise TermselError(f"{failure}: {error}") from error
        raise TermselError(
            f"{failure}: PROJ does not have the grid {' or '.join(grids)}",
            hint=f"Get it with pyproj sync --file {grids[0]}, or set PROJ_NETWORK=ON. Or give "
                 "ellipsoidal heights, as in EPSG:4979.") from error

    def convert(ground: FloatArray) -> FloatArray:
        known_heights = np.nan_to_num(ground, nan=0.0)
        try:
            turned = turn.transform(*known_heights.T, errcheck=strict)
        except ProjError as error:
            raise TermselError(f"{failure}: {error}") from error
        return np.stack(turned, axis=1)

    return convert


def is_geocentric(crs: str) -> bool:
    """Return True where coordinates are counted from the centre of the Earth.

    Parameters
    ----------
    crs : str
        As for `normalise`.
    """
    return _kind(normalise(crs)) == "geocentric"


def height_reference(crs: str) -> str:
    """Return the vertical datum of a CRS, in words; "" for "local".

    Parameters
    ----------
    crs : str
        As for `normalise`.
    """
    name = normalise(crs)
    if name == LOCAL:
        return ""
    if name == "EPSG:4979":
        return "ellipsoidal (WGS 84)"
    plane = name in WGS84 or _UTM.fullmatch(name)
    known = None if plane else _with_pyproj(name)
    stated = "" if known is None else vertical_datum(known)
    return stated or f"not stated by {_short(name)}; taken as ellipsoidal"


def vertical_datum(crs: CRS) -> str:
    """Return the vertical datum of a CRS, "" if it has none.

    Parameters
    ----------
    crs : pyproj.CRS
    """
    if len(crs.axis_info) < 3:
        return ""
    vertical = [part for part in crs.sub_crs_list if part.is_vertical]
    if vertical:
        return str(vertical[0].name)
    return f"ellipsoidal ({crs.name if crs.geodetic_crs is None else crs.geodetic_crs.name})"


def horizontal(crs: str) -> str:
    """Return a CRS without its heights, as files of plane coordinates state it; "" for none.

    Parameters
    ----------
    crs : str
        As for `normalise`.
    """
    name = normalise(crs)
    if name == LOCAL:
        return ""
    if name in WGS84:
        return "EPSG:4326"
    known = _with_pyproj(name)
    return name if known is None or len(known.axis_info) < 3 else normalise(known.to_2d().to_wkt())


def check_ground(features: FeatureSet) -> None:
    """Refuse ground coordinates that cannot be in the CRS of the features.

    Parameters
    ----------
    features : FeatureSet
        With a CRS; "local" takes any coordinates.

    Raises
    ------
    TermselError
        For longitudes outside -180 to 360 or latitudes outside -90 to 90 degrees in a
        geographic CRS, coordinates that look like degrees in a projected one, and eastings
        or northings that no UTM zone has.
    """
    crs = normalise(features.crs)
    kind = _kind(crs)
    ids = features.points.ids + tuple(name for name in features.lines.ids for _ in range(2))
    xy = features.ground_vertices()[:, :2]
    if not ids:
        return
    if kind == "geographic":
        metres = (np.abs(xy) > 360).any(axis=1).mean() > 0.5
        hint = ("These look like metres: state the projected CRS with --crs." if metres else
                "x must be longitude and y latitude, in degrees.")
        _check_range(xy, ids, *_DEGREES, f"cannot be longitude and latitude in {crs}", hint)
    elif kind == "projected":
        _check_metres(xy, ids, crs)
        utm = _UTM.fullmatch(crs)
        if utm:
            _check_range(xy, ids, *_UTM_RANGE[utm[1]],
                         f"cannot be easting and northing in {crs} (UTM)",
                         "x must be easting and y northing, in metres; check the CRS of the file.")


def _check_metres(xy: FloatArray, ids: Sequence[str], crs: str) -> None:
    """Refuse features in degrees under a projected CRS: all of them, or some far from the rest."""
    degrees: BoolArray = np.all(np.abs(xy) <= (180, 90), axis=1)
    if not degrees.any():
        return
    rest = xy[~degrees]
    if len(rest):
        # Metres next to the origin of a CRS are as small.
        middle = np.median(rest, axis=0)
        spread = np.median(np.abs(rest - middle), axis=0).max()
        if np.hypot(*middle) <= max(_NEAR, 10 * spread):
            return
        n = len({name for name, one in zip(ids, degrees, strict=True) if one})
        what = f"{n} of {counted(len(set(ids)), 'feature')} look{'s' * (n == 1)} like degrees"
        hint = "Transform these features to the CRS of the others, or remove them."
    else:
        what = "the ground coordinates look like degrees"
        hint = ("State --crs EPSG:4979 for longitude, latitude and ellipsoidal height, or --crs "
                "local for plane coordinates without a CRS.")
    first = int(np.argmax(degrees))
    raise TermselError(f"{what}, but {_short(crs)} is a projected CRS: {_values(xy, ids, first)}",
                       ids=[ids[first]], hint=hint)


def _missing_grids(source: CRS, target: CRS) -> list[str]:
    """Return the names of grids with which PROJ could transform."""
    from pyproj.transformer import TransformerGroup

    with catch_warnings():
        simplefilter("ignore")  # warnings of missing grids
        group = TransformerGroup(source, target, always_xy=True)
    return list(dict.fromkeys(grid.short_name for operation in group.unavailable_operations
                              for grid in operation.grids if not grid.available))


def _check_range(xy: FloatArray, ids: Sequence[str], low: tuple[float, float],
                 high: tuple[float, float], what: str, hint: str) -> None:
    def outside(values: FloatArray) -> BoolArray:
        bad: BoolArray = np.any((values < low) | (values > high), axis=1)
        return bad

    bad = outside(xy)
    if not bad.any():
        return
    first = int(np.argmax(bad))
    if not outside(xy[:, ::-1]).any():
        hint = f"The columns look swapped. {hint}"
    elif not outside(xy[bad][:, ::-1]).any():
        hint = f"Perhaps x and y are swapped there. {hint}"
    raise TermselError(f"{_values(xy, ids, first)} {what}", hint=hint, ids=[ids[first]])


def _values(xy: FloatArray, ids: Sequence[str], i: int) -> str:
    return f"feature {ids[i]!r} with x = {xy[i, 0]:.10g}, y = {xy[i, 1]:.10g}"


def _short(crs: str) -> str:
    return crs if len(crs) <= 40 else f"{crs[:40]}..."


def _kind(crs: str) -> str:
    """Return "geographic", "projected", "geocentric", or "" where none of them or not known."""
    if crs in WGS84:
        return "geographic"
    if _UTM.fullmatch(crs):
        return "projected"
    known = None if crs == LOCAL else _with_pyproj(crs)
    if known is not None:
        return ("geographic" if known.is_geographic else
                "projected" if known.is_projected else
                "geocentric" if known.is_geocentric else "")
    return {"GEOG": "geographic", "PROJ": "projected", "GEOC": "geocentric"}.get(
        crs.upper()[:4], "")


def _with_pyproj(crs: str) -> CRS | None:
    """Return the CRS, or None where pyproj is not installed."""
    try:
        from pyproj import CRS
        from pyproj.exceptions import CRSError
    except ImportError:
        return None
    try:
        known = CRS.from_user_input(crs)
    except CRSError:
        raise TermselError(f"CRS {_short(crs)!r} does not exist or cannot be read",
                           hint=f"Examples: {EXAMPLES}.") from None
    if known.is_geographic or known.is_projected or known.is_geocentric or known.is_engineering:
        return known
    raise TermselError(f"CRS {_short(crs)!r} ({known.name}) has no horizontal coordinates",
                       hint=f"Examples: {EXAMPLES}.")
