"""What columns of a table say of the CRS of its coordinates: a zone of UTM, or a code."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

from termsel.data.coordinates.crs import UTM, is_crs, normalise, short_crs_name
from termsel.data.features import FeatureSet
from termsel.data.tables.columns import fold_name

_NAMES_OF_ZONES = frozenset((
    "utm", "utmzone", "zone", "zoneutm", "zona", "zonautm", "fuso", "huso", "fuseau",
    "zonennummer"))
_NAMES_OF_CODES = frozenset((
    "epsg", "epsgcode", "srid", "crs", "srs", "crscode", "coordinatesystem"))
_ZONE = re.compile(r"(?:UTM)?\s*(?:zone)?\s*0?([1-9]|[1-5]\d|60)\s*([C-HJ-NP-X])?", re.IGNORECASE)
_MAX_CODES = 20
"""Different codes of a column, beyond which it is no column of CRSs."""


def crs_of_columns(features: FeatureSet) -> tuple[str, str]:
    """Return the name of a column that says one CRS for all points, and that CRS.

    Both are "" if there is no such column. Zones of UTM are taken in WGS 84; whether that is right
    the reader of a message has to judge.
    """
    for name, crs_of_cell in _crs_of_cells_by_column(features).items():
        stated = set(crs_of_cell.values())
        if len(stated) == 1 and (crs := stated.pop()):
            return name, crs
    return "", ""


def note_on_other_crs(features: FeatureSet) -> str:
    """Return a sentence on a column of zones or codes that contradicts the CRS or itself.

    Tables of surveyors have columns such as "zone" or "epsg". If such a column has several CRSs, or
    another one than is stated, coordinates are read in a wrong one. A zone, which says no datum, is
    compared by its number alone. If no column contradicts anything, "" is returned.
    """
    if not features.points.attributes:
        return ""
    utm = UTM.fullmatch(normalise(features.crs)) if features.crs else None
    for name, crs_of_cell in _crs_of_cells_by_column(features).items():
        cells = sorted(crs_of_cell)
        # A column with an unknown code or zone says nothing.
        if not all(crs_of_cell.values()):
            continue
        if len(set(crs_of_cell.values())) > 1:
            return (f"Column {name!r} says {' and '.join(cells[:3])}: coordinates of several CRSs "
                    "are read as of one. Transform them into one, and state its CRS.")
        crs = crs_of_cell[cells[0]]
        is_zone = _ZONE.fullmatch(cells[0]) is not None
        # A zone beside a CRS that is not UTM is no contradiction. EPSG codes of UTM end with it.
        if (is_zone and utm and crs[-2:] != features.crs[-2:]) or (
                not is_zone and crs != normalise(features.crs)):
            return (f"Column {name!r} says {cells[0]}, and the coordinates are read in "
                    f"{short_crs_name(features.crs)}. If the column is right: --crs {crs}.")
    return ""


def _crs_of_cells_by_column(features: FeatureSet) -> Mapping[str, Mapping[str, str]]:
    """Return columns of zones or codes, each with the CRS of its cells, "" for a cell without one.

    Columns of more than `_MAX_CODES` different cells are left out, as are empty ones.
    """
    crs_by_column: dict[str, dict[str, str]] = {}
    for name, texts in features.points.attributes.items():
        crs_of: Callable[[str], str] | None = {
            **dict.fromkeys(_NAMES_OF_ZONES, _crs_of_zone),
            **dict.fromkeys(_NAMES_OF_CODES, _crs_of_code)}.get(fold_name(name))
        cells = sorted({str(text) for text in texts} - {""})
        if crs_of is not None and 0 < len(cells) <= _MAX_CODES:
            crs_by_column[name] = {cell: crs_of(cell) for cell in cells}
    return crs_by_column


def _crs_of_zone(text: str) -> str:
    """Return the CRS of a zone of UTM in WGS 84, in the north unless a letter says south.

    Text that is no zone gives "".
    """
    match = _ZONE.fullmatch(text.strip())
    if match is None:
        return ""
    # As a band of MGRS, S is north of the equator; most people who write S mean the south.
    is_south = (match[2] or "N").upper() in "CDEFGHJKLMS"
    return f"EPSG:32{7 if is_south else 6}{int(match[1]):02}"


def _crs_of_code(text: str) -> str:
    """Return the CRS of a code or a name; or ""."""
    name = f"EPSG:{text}" if text.isdecimal() else text
    return normalise(name) if is_crs(name) else ""
