"""Units of heights: those of control, of rasters, and CRSs that state them."""

from __future__ import annotations

from typing import Any

import numpy as np

from termsel.core.errors import GIS, require_import
from termsel.data.coordinates.crs import (
    LOCAL,
    height_axis_unit,
    metres_per_unit,
    normalise,
)

METRE, US_FOOT, FOOT = "metre", "us-ft", "ft"
UNITS = {METRE: 1.0, US_FOOT: 1200 / 3937, FOOT: 0.3048}
"""Units of heights, as options name them [m]."""

WORDS = {METRE: "metres", US_FOOT: "US survey feet", FOOT: "feet"}
"""What messages call them."""

_OF_PROJ = {METRE: "metre", US_FOOT: "US survey foot", FOOT: "foot"}
_SAME = 1e-9  # relative difference of sizes of one unit; the two feet differ by 2e-6

_SPELLINGS = {
    METRE: "m metre metres meter meters",
    US_FOOT: "us-ft usft ftus us_survey_foot us_survey_feet ussurveyfoot foot_us sftus us_foot "
             "foot_survey_us us_ft",
    FOOT: "ft foot feet international_foot international_feet foot_international ft_int"}
_BY_SPELLING: dict[str, str] = {}
for _unit, _spellings in _SPELLINGS.items():
    _BY_SPELLING |= {"".join(filter(str.isalnum, spelling)): _unit
                     for spelling in _spellings.split()}


def unit_of_word(text: str) -> str | None:
    """Return the unit that a raster or a table states, as in `UNITS`; None for any other."""
    # Signs between letters are left out on both sides: "US survey foot" and "us_survey_foot".
    return _BY_SPELLING.get("".join(filter(str.isalnum, text.lower())))


def unit_of_size(metres: float) -> str | None:
    """Return the unit of a size [m], as in `UNITS`; None for any other."""
    return next((unit for unit, size in UNITS.items()
                 if np.isclose(metres, size, rtol=_SAME, atol=0.0)), None)


def unit_of_plane(crs: str) -> str | None:
    """Return the unit of x and y of a projected CRS if that is a foot; None for any other."""
    size = None if normalise(crs) == LOCAL else metres_per_unit(crs)
    unit = None if size is None else unit_of_size(size)
    return None if unit == METRE else unit


def is_unit_open(crs: str) -> bool:
    """Return whether z may be in feet or in metres: x and y are in feet, and z has no axis."""
    return unit_of_plane(crs) is not None and height_axis_unit(crs) is None


def with_height_unit(crs: str, unit: str) -> str:
    """Return a CRS whose heights are in a unit of `UNITS`, a name such as a user gives.

    If its heights are in this unit already, its normal form comes back. So does that of a CRS
    without a vertical axis for metres, in which such heights are taken; for other units it gets a
    vertical axis of ellipsoidal heights. A changed CRS is WKT. Raises TermselError if pyproj is
    needed and not installed.
    """
    name = normalise(crs)
    current = height_axis_unit(name)
    if np.isclose(UNITS[unit], 1.0 if current is None else current, rtol=_SAME, atol=0.0):
        return name
    with require_import("heights in feet require", "pyproj", GIS):
        from pyproj import CRS
    parsed = CRS.from_user_input(name)
    # pyproj has no function for this: the CRS is written as JSON, altered there and read again.
    described = (parsed if current is not None else parsed.to_3d()).to_json_dict()
    _set_unit(described, unit)
    return normalise(CRS.from_json_dict(described).to_wkt())


def _set_unit(described: dict[str, Any], unit: str) -> None:
    """Set the unit of the vertical axis in the PROJJSON of a CRS, in place.

    The identifier is removed, as the changed CRS is not the listed one.
    """
    described.pop("id", None)
    # A bound CRS has the vertical axis in its source, a compound one in its last component, and
    # any other CRS in itself.
    vertical_part = described.get("source_crs") or (described.get("components") or [None])[-1]
    if vertical_part is not None:
        _set_unit(vertical_part, unit)
        return
    described["coordinate_system"]["axis"][-1]["unit"] = {
        "type": "LinearUnit", "name": _OF_PROJ[unit], "conversion_factor": UNITS[unit]}
