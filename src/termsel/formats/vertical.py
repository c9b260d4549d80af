"""What the heights of a raster refer to, by its CRS, its tags and the unit of its band."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from termsel.core.errors import TermselError
from termsel.data.coordinates.crs import (
    height_reference,
    short_crs_name,
    transformation_between,
    vertical_datum,
)
from termsel.data.coordinates.height_units import (
    METRE,
    UNITS,
    WORDS,
    unit_of_size,
    unit_of_word,
    with_height_unit,
)
from termsel.data.features import FloatArray

if TYPE_CHECKING:
    from pyproj import CRS

Heights = Callable[[FloatArray], FloatArray]
"""Heights [m], shape (n,), of places (n, 3) whose heights are in metres of a raster."""

UNDECLARED = "not declared by the raster"
"""What is said of heights whose vertical datum nobody states."""

_OF_HEIGHTS = re.compile(r"vert|alt|geoid|height|elev|(?:^|[\W_])z(?:$|[\W_])", re.IGNORECASE)
"""Names of tags that may say what heights refer to."""
_OF_DATUM = re.compile(r"datum|crs|srs|ref|geoid|system", re.IGNORECASE)
_NOTHING = frozenset({"", "unknown", "unspecified", "undefined", "none", "n a", "not declared"})
_ELLIPSOIDAL = frozenset({"ellipsoid", "ellipsoidal", "hae", "wgs84"})
_OTHER_NAMES = {"e96": "egm96", "northamericanverticaldatumof1988": "navd88",
                "nationalgeodeticverticaldatumof1929": "ngvd29",
                "earthgravitationalmodel1996": "egm96", "earthgravitationalmodel2008": "egm2008",
                "meansealevel": "msl"}
"""Names in tags of DTED and of FGDC's metadata, and those that EPSG has for them."""
_LONGEST_NAME = 7  # words
_EGM96_HEIGHT = 5773  # a code of EPSG


def metres_of_band(raster: Any, crs: CRS, path: Path) -> float:
    """Return the unit of a raster's heights [m]: that of its band, else of its vertical axis.

    It is 1 where neither is stated and x and y are not in feet. Raises TermselError for a unit that
    is no length, units that differ, and where x and y are in feet and nothing says whether heights
    are.
    """
    stated = (raster.units[0] or "").strip()
    of_band = unit_of_word(stated) if stated else None
    if stated and of_band is None:
        raise TermselError(f"this raster is in {stated}, expected one band of heights in metres "
                           "or feet", file=path,
                           hint="Convert it, for example with gdal_translate.")
    axes = crs.axis_info
    size = float(axes[2].unit_conversion_factor) if len(axes) > 2 else None
    if size is not None:
        of_axis = unit_of_size(size)
        if of_band is not None and of_band != of_axis:
            raise TermselError(
                f"the band of this raster is in {WORDS[of_band]}, and the heights of its CRS are "
                f"in {axes[2].unit_name}", file=path,
                hint="Correct one of them: gdal_edit.py -units states the unit of the band.")
        return size
    # Heights of a map in feet are as often in feet as in metres.
    plane_unit = unit_of_size(float(axes[0].unit_conversion_factor)) if crs.is_projected else METRE
    if of_band is None and plane_unit in WORDS and plane_unit != METRE:
        raise TermselError(
            "it is not stated whether the heights of this raster are in metres or, like x and "
            f"y, in {WORDS[plane_unit]}", file=path,
            hint="State the unit of its band: gdal_edit.py -units m, or -units us-ft.")
    return UNITS[of_band or METRE]


def with_declared_datum(raster: Any, crs: CRS, path: Path) -> CRS:
    """Return the CRS of a raster with the vertical datum that its tags state, if it has none.

    Raises TermselError if PROJ does not know that, or cannot be asked.
    """
    _require_database(path)
    # A third axis, or a compound CRS, says it by itself.
    if len(crs.axis_info) > 2:
        return crs
    vertical = _datum_by_tags(raster, path)
    if vertical is None:
        return crs
    if vertical == "ellipsoidal":
        return crs.to_3d()
    from pyproj import CRS
    from pyproj.crs import CompoundCRS

    vertical_crs = CRS.from_user_input(vertical)
    return CompoundCRS(f"{crs.name} + {vertical_crs.name}", [crs, vertical_crs])


def _require_database(path: Path) -> None:
    """Raise TermselError for a raster where GDAL cannot read PROJ's database.

    GDAL then drops the vertical part of the raster's CRS without an error.
    """
    from rasterio.crs import CRS as RasterCRS
    from rasterio.errors import CRSError

    try:
        RasterCRS.from_epsg(_EGM96_HEIGHT)
    except CRSError as error:
        named = [f"{name}={os.environ[name]}" for name in ("PROJ_DATA", "PROJ_LIB")
                 if os.environ.get(name)]
        raise TermselError(
            "rasterio cannot read PROJ's database, and so not what the heights of this raster "
            "refer to", file=path,
            hint=f"Unset {named[0]}, which names another PROJ." if named else
            "Install rasterio again.") from error


def to_datum_of(crs: str, raster_crs: CRS, path: Path) -> Heights | None:
    """Return a function from heights [m] of a raster's CRS to those of a CRS.

    Returns None if both have the same heights, or if `raster_crs` has no axis of heights: they are
    taken for those of `crs`. With such an axis and no vertical datum, heights are ellipsoidal.
    Raises TermselError where PROJ lacks the grid of a geoid.
    """
    from pyproj import CRS

    control = CRS.from_user_input(crs)
    datum = vertical_datum(raster_crs)
    if not datum or _surface_of_heights(raster_crs) == _surface_of_heights(control):
        return None
    try:
        convert = transformation_between(with_height_unit(raster_crs.to_wkt(), METRE),
                                         with_height_unit(crs, METRE), strict=False)
    except TermselError as error:
        reason = error.what.partition(": ")[2] or error.what
        raise TermselError(
            f"the heights of this raster are {datum}, those of the ground coordinates are "
            f"{_heights_in_words(crs)}, and {reason}", file=path,
            hint=f"{error.hint or 'Give a raster of the same heights.'}"
                 f"{_advice_if_same_heights(crs, raster_crs)}"
        ) from error

    def convert_heights(ground: FloatArray) -> FloatArray:
        """Return the heights (n,) at x, y and heights (n, 3); NaN where a grid has no value."""
        # PROJ gives infinity there.
        converted = convert(ground)[:, 2]
        return np.where(np.isfinite(ground).all(axis=1) & np.isfinite(converted), converted,
                        np.nan)

    return convert_heights


def require_grid(to_datum: Heights, middle: tuple[float, float], path: Path) -> None:
    """Raise TermselError where PROJ may fetch a grid of heights, and has no value at a place.

    `middle` is a place of the raster, x and y in its CRS. Where PROJ must not use the network it
    raises an error of its own if it lacks the grid.
    """
    from pyproj.network import is_network_enabled

    if is_network_enabled() and np.isnan(to_datum(np.array([[*middle, 0.0]]))).all():
        raise TermselError(
            "PROJ has no value to convert the heights of this raster in its middle: the grid of "
            "the geoid could not be fetched (PROJ_NETWORK=ON), or is of another place", file=path,
            hint="Get the grid where there is a network (without PROJ_NETWORK=ON termsel names "
                 "it), and copy it to the folder that "
                 "pyproj.datadir.get_user_data_dir() names; or give a raster of ellipsoidal "
                 "heights.")


def _heights_in_words(crs: str) -> str:
    """Return the surface that heights of ground coordinates refer to, in words."""
    reference = height_reference(crs)
    return "taken as ellipsoidal" if reference.startswith("not stated") else reference


def _advice_if_same_heights(crs: str, raster_crs: CRS) -> str:
    """Return advice to state the vertical CRS of the raster for the control, too.

    Returns "" if the control states one, or that of the raster has no code.
    """
    vertical_crs = _vertical_part(raster_crs)
    number = None if vertical_crs is None else vertical_crs.to_epsg()
    if not height_reference(crs).startswith("not stated") or number is None:
        return ""
    # A code can be written together with a second one; for any other CRS "EPSG:n" stands.
    plane = re.fullmatch(r"EPSG:(\d+)", crs)
    return (" If the control has the same heights as the raster, state it when you run termsel: "
            f"--crs {crs if plane else 'EPSG:n'}+{number}.")


def counts_from_ellipsoid(crs: str) -> bool:
    """Return whether heights of a CRS count from its ellipsoid, by what it states or for want of
    that.
    """
    from pyproj import CRS

    return _vertical_part(CRS.from_user_input(crs)) is None


def _vertical_part(crs: CRS) -> CRS | None:
    """Return the vertical part of a compound CRS; None of another."""
    return next((component for component in crs.sub_crs_list if component.is_vertical), None)


def _surface_of_heights(crs: CRS) -> tuple[str, str]:
    """Return the surface that heights are above: "geoid" or "ellipsoid", and the name of its datum.

    Two CRSs whose heights have one datum have one surface.
    """
    vertical = _vertical_part(crs)
    if vertical is not None:
        return "geoid", str(vertical.datum.name if vertical.datum else vertical.name)
    geodetic = crs.geodetic_crs
    return "ellipsoid", "" if geodetic is None else str(geodetic.datum.name if geodetic.datum
                                                        else geodetic.name)


def _datum_by_tags(raster: Any, path: Path) -> str | None:
    """Return the vertical datum by a raster's tags: a code of EPSG, or "ellipsoidal".

    Returns None without such a tag. Raises TermselError for a datum that PROJ does not have.
    """
    for name, value in {**raster.tags(), **raster.tags(1)}.items():
        # The name must be of heights and of a datum: "height" alone is a number.
        if not _OF_HEIGHTS.search(name) or not _OF_DATUM.search(name):
            continue
        words = tuple(re.findall(r"[a-z]+|\d+", value.lower()))
        if " ".join(words) in _NOTHING or _is_number(value):
            continue
        datum = _datum_of(words)
        if datum is None:
            raise TermselError(f"this raster states {name}={value}, which is no vertical datum "
                               "that PROJ knows", file=path,
                               hint="State it by the CRS, such as gdal_edit.py -a_srs "
                                    "EPSG:4326+5773 for heights above EGM96.")
        return datum
    return None


def _is_number(value: str) -> bool:
    """Return whether the value of a tag is a number, hence a height and no datum."""
    try:
        float(value)
    except ValueError:
        return False
    return True


def _datum_of(words: tuple[str, ...]) -> str | None:
    """Return the vertical datum that consecutive words name: a code of EPSG, or "ellipsoidal".

    Of several names the longest counts. Returns None if the words name no datum.
    """
    codes = _vertical_names()
    # The longest name first: "navd 88 height" before "navd".
    for count in range(min(len(words), _LONGEST_NAME), 0, -1):
        for name in _join_words(words, count):
            code = codes.get(_OTHER_NAMES.get(name, name))
            if code is not None:
                return code
    joined = {*_join_words(words, 1), *_join_words(words, 2)}
    return "ellipsoidal" if joined & _ELLIPSOIDAL else None


def _join_words(words: tuple[str, ...], count: int) -> Iterator[str]:
    """Yield each `count` words in a row as one word."""
    for first in range(len(words) - count + 1):
        yield "".join(words[first:first + count])


@lru_cache  # a list of PROJ's database, which takes a tenth of a second
def _vertical_names() -> dict[str, str]:
    """Return the codes of EPSG's vertical CRSs in metres, by names as tags have them."""
    from pyproj.database import query_crs_info
    from pyproj.enums import PJType

    codes: dict[str, str] = {}
    for info in query_crs_info(auth_name="EPSG", pj_types=PJType.VERTICAL_CRS):
        code = f"EPSG:{info.code}"
        # By its code as well, "EPSG:5773", as some tags have it.
        codes[f"epsg{info.code}"] = code
        name = info.name.removesuffix(" height")
        if name != info.name and not info.deprecated:
            codes.setdefault("".join(re.findall(r"[a-z]+|\d+", name.lower())), code)
    return codes


def datum_in_words(raster_crs: CRS, converted: bool, crs: str) -> str:
    """Return the vertical datum of a raster in words, and the one it was converted to."""
    datum = vertical_datum(raster_crs)
    if not datum:
        return UNDECLARED
    return f"{datum}, converted to that of {short_crs_name(crs)}" if converted else datum
