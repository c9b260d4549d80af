"""Coordinate reference systems: names, kinds, transformations.

pyproj is optional. Without it only the form of a name and the well-known codes are checked.
In termsel x is always longitude or easting and y latitude or northing, whatever axis order
the authority gives.
"""

from __future__ import annotations

import logging
import os
import re
import unicodedata
from collections.abc import Callable, Mapping
from contextlib import closing
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable
from warnings import catch_warnings, simplefilter

import numpy as np

from termsel.core.errors import GIS, TermselError, require_import
from termsel.core.files.names import refuse_grids
from termsel.data.coordinates.wgs84 import ECCENTRICITY, SEMI_MAJOR, FloatArray

if TYPE_CHECKING:
    from pyproj import CRS, Transformer

log = logging.getLogger(__name__)

LOCAL = "local"
EXAMPLES = ("EPSG:4979 (longitude, latitude, ellipsoidal height), EPSG:32631 (UTM zone 31 north) "
            "or local (plane coordinates without a CRS)")

WGS84 = frozenset({"EPSG:4326", "EPSG:4979"})
"""WGS84 longitude and latitude; the second also says that heights are ellipsoidal."""

Transformation = Callable[[FloatArray], FloatArray]
"""From ground coordinates to others, shapes (n, 3)."""


@runtime_checkable
class _WithWkt(Protocol):
    """A CRS of pyproj, rasterio or geopandas."""

    def to_wkt(self) -> str:
        """Return the CRS as WKT."""


CrsLike = str | int | _WithWkt
"""A CRS as programs have it: text as of `normalise`, the number of EPSG, or an object of pyproj."""

_WRONG_CRS = "Check the ground coordinates and the CRS that is stated for them."
_NO_TRANSFORMATION = ("State another CRS, or transform the coordinates with another program; "
                      "heights to ellipsoidal ones, as in EPSG:4979.")
_GRIDS = 3  # that an error names
_OF_EARTH = 0.01  # share by which ellipsoids of the Earth differ at most
_QUOTED_NAME = re.compile(r'\w+\s*\[\s*"([^"]{1,80})"')
_PROJECTION_METHOD = re.compile(r'(?:PROJECTION|METHOD)\s*\[\s*"([^"]{1,80})"')
_UNKNOWN_DATUM = re.compile(r"(D_)?(unknown|not[ _]specified)", re.IGNORECASE)
_UNNAMED = re.compile(r"unknown|unnamed|", re.IGNORECASE)
IN_DEGREES = ", in degrees"
"""How the name ends of a CRS that is another one but for its unit."""

_CRS_LINE = re.compile(r"\s*(EPSG|ESRI\s*:|WGS ?84|ETRS ?89|UTM|PROJC|GEOG|\+\w+=)", re.IGNORECASE)
"""What a line begins with that is a CRS."""
_BODY = re.compile(r"(?:GCS_|D_)?([A-Za-z]+)")

_CODE = re.compile(r"(?:urn:ogc:def:crs:)?(EPSG|OGC):(?:[\d.]*:)?\s*(\w+)", re.IGNORECASE)
# As old programs of GDAL, WMS and people write codes.
_CODE_LIKE = re.compile(r"(?:https?://www\.opengis\.net/(?:def/crs/(EPSG|OGC)/[\d.]+/|"
                        r"gml/srs/(epsg)\.xml#)|\+init=(epsg):|(EPSG)[\s_-]+)(\w+)/?",
                        re.IGNORECASE)
_OTHER_CODE = re.compile(r"(IAU_\d{4}|ESRI):(\d{1,9})", re.IGNORECASE)
_COMPOUND = re.compile(r"EPSG:(\d{1,9})\+(\d{1,9})", re.IGNORECASE)
# x is longitude in termsel, so the OGC names say nothing more than the EPSG codes.
_OGC = {"CRS84": "EPSG:4326", "CRS84H": "EPSG:4979"}
UTM = re.compile(r"EPSG:32([67])(0[1-9]|[1-5]\d|60)")
_WKT = re.compile(r"(GEOG|GEOD|GEOC|PROJ|COMP|LOCAL_CS|ENG|BOUND|DERIVED)\w*\s*\[.*\]",
                  re.IGNORECASE | re.DOTALL)

# As people and OpenDroneMap write it: WGS84, WGS 84 / UTM zone 16N, WGS84 UTM 16 N, UTM 16N.
_WGS84_NAME = re.compile(r"(?:GCS[ _])?WGS[ _]?(?:19)?84", re.IGNORECASE)
_UTM_NAME = re.compile(r"(?:WGS[ _]?(?:19)?84[ _]*/?[ _]*)?UTM[ _]*(?:zone[ _]*)?"
                       r"(?P<zone>\d{1,2})[ _]*(?P<side>[NS]|north|south)", re.IGNORECASE)
_UTM_OF_DATUM = re.compile(r"(?P<datum>[A-Za-z][\w() -]{1,30}?)[ _]*/?[ _]*UTM[ _]*(?:zone[ _]*)?"
                           r"(?P<zone>\d{1,2})[ _]*(?P<side>[NS]|north|south)", re.IGNORECASE)
_UTM_WITHOUT_SIDE = re.compile(r"(?:WGS[ _]?(?:19)?84)?[ _/]*UTM[ _]*(?:zone[ _]*)?(\d{1,2})",
                               re.IGNORECASE)
_DEGREES = re.compile(r"\b(lat|lon|long|latlon|lonlat|longlat|latlong|latitude|longitude|deg|"
                      r"degrees?|geographic|crs ?84)\b", re.IGNORECASE)
_PROJ = re.compile(r"\+\w+(=\S+)?(\s+\+?\w+(=\S+)?)*")
_CRS_NAME = re.compile(r"[A-Za-z][\w /().,+'-]{3,99}")
# Chains of steps are no CRS; a file that a text from elsewhere names is not opened.
_NO_CRS = re.compile(r"\+?(proj=pipeline|init=|step\b)|grids=\S*[/\\]|\.\.", re.IGNORECASE)

# The code of the whole CRS is last, in WKT's outermost bracket.
_AUTHORITY = re.compile(r'(?:ID|AUTHORITY)\s*\[\s*"EPSG"\s*,\s*"?(\d{1,9})"?\s*\]\s*\]\s*$',
                        re.IGNORECASE)


def crs_text(crs: CrsLike) -> str:
    """Return a CRS as text: text as it is, "EPSG:n" for a number, the WKT of an object of pyproj.

    Raises TermselError for anything else. Whether there is such a CRS is not looked at.
    """
    if isinstance(crs, str):
        return crs
    if isinstance(crs, int | np.integer) and not isinstance(crs, bool):
        return f"EPSG:{crs}"
    if isinstance(crs, _WithWkt):
        return normalise(crs.to_wkt())
    of_proj = " Of parameters of PROJ: crs=pyproj.CRS(DICT)." if isinstance(crs, Mapping) else ""
    raise TermselError(f"crs={crs!r} is no CRS", hint=f"Examples: {EXAMPLES}.{of_proj}")


def normalise(crs: str) -> str:
    """Return the normal form of a CRS, in which names are compared.

    `crs` may be "EPSG:n", "EPSG:n+m" with heights of their own, "OGC:CRS84", the URN form of these,
    WKT, "local", "WGS84" or "WGS84 UTM 16N". With pyproj it may also be "ETRS89 UTM 33N", a string
    of PROJ, the name that EPSG or ESRI gives a CRS, "ESRI:n", and the code of another body than the
    Earth, "IAU_2015:n". The normal form is "EPSG:n" where the code is known, pyproj finds it or WKT
    ends with it.

    Raises TermselError for text in none of these forms. If pyproj is installed, also for a code
    that does not exist, WKT that cannot be read, or a CRS without horizontal coordinates.
    """
    text = crs.strip()
    if form := _normal_form(text):
        return form
    raise TermselError(f"unknown CRS {crs!r}",
                       hint=f"{_question_on_meaning(text)}Examples: {EXAMPLES}; WKT, or a "
                       "string of PROJ.")


def is_crs(text: str) -> bool:
    """Return whether a text is a CRS that `normalise` takes.

    Unlike the error of `normalise`, the answer needs no search for what else may have been meant.

    >>> is_crs("EPSG:32639"), is_crs("id,line,sample")
    (True, False)
    """
    try:
        return bool(_normal_form(text.strip()))
    except TermselError:
        return False


def _normal_form(text: str) -> str:
    """Return what `normalise` returns; "" for text in none of its forms.

    Raises TermselError for what is in one of these forms, but is wrong: see `normalise`. Without
    pyproj a code is taken as it is, with a note.
    """
    if text.lower() == LOCAL:
        return LOCAL
    if like_code := _CODE_LIKE.fullmatch(text):
        *authorities, number = like_code.groups()
        text = f"{''.join(filter(None, authorities))}:{number}"
    # From the cheapest to the dearest: codes by their form, WKT and compound ones by pyproj.
    code = _CODE.fullmatch(text)
    if code:
        authority = code[1].upper()
        number = code[2].upper()
        if authority == "OGC" and number in _OGC:
            return _OGC[number]
        if authority == "EPSG" and number.isdecimal() and len(number) < 10:
            # UTM and WGS84 are known to exist, so that common data need no pyproj.
            name = f"EPSG:{int(number)}"
            if name not in WGS84 and not UTM.fullmatch(name) and _with_pyproj(name) is None:
                _say_unchecked(name)
            return name
    elif other_code := _OTHER_CODE.fullmatch(text):
        name = f"{other_code[1].upper()}:{int(other_code[2])}"
        with require_import(f"the CRS {name} requires", "pyproj", GIS):
            import pyproj  # noqa: F401 - whether it is there
        _with_pyproj(name)
        return name
    elif (two := _COMPOUND.fullmatch(text)) or _WKT.fullmatch(text):
        text = f"EPSG:{int(two[1])}+{int(two[2])}" if two else text
        parsed = _with_pyproj(text)
        if parsed is None:
            epsg_code = _AUTHORITY.search(text)
            return f"EPSG:{int(epsg_code[1])}" if epsg_code else text
        return _code_or_text(text)
    else:
        return _crs_by_name(text)
    return ""


def _question_on_meaning(text: str) -> str:
    """Return a question on what an unknown CRS may mean, such as "Did you mean EPSG:4326 ...? ".

    It ends with a space. If the text resembles nothing that termsel knows, "" is returned.
    """
    if text.isdecimal():
        return f"Did you mean EPSG:{text}? "
    zone = _UTM_WITHOUT_SIDE.fullmatch(text)
    if zone and 1 <= int(zone[1]) <= 60:
        return (f"Did you mean EPSG:326{int(zone[1]):02d} (north) or EPSG:327{int(zone[1]):02d} "
                "(south of the equator)? ")
    if _DEGREES.search(text):
        return "Did you mean EPSG:4326 (WGS84 longitude and latitude)? "
    listed = _listed_by_words(text)
    return f"Did you mean {' or '.join(listed)}? " if listed else ""


_MOST_LISTED = 3
"""CRS that a message names."""


def _listed_by_words(text: str) -> list[str]:
    """Return up to three projected CRS of EPSG, with codes, whose names have all words of a text.
    """
    try:
        from pyproj.database import query_crs_info
        from pyproj.enums import PJType
    except ImportError:
        return []
    words = _words_of_name(text)
    if not any(len(word) > _LEAST_LETTERS for word in words):
        return []
    # The zone is the last number: that of "3-degree Gauss-Kruger zone 9" is 9.
    zone = re.findall(r"\d+", text)[-1:]
    found = [crs for crs in query_crs_info("EPSG", PJType.PROJECTED_CRS)
             if words <= _words_of_name(crs.name)
             and (not zone or zone == re.findall(r"\d+", crs.name)[-1:])]
    # The shortest names are those of the least special ones.
    found.sort(key=lambda crs: (len(crs.name), int(crs.code)))
    return [f"EPSG:{crs.code} ({crs.name})" for crs in found[:_MOST_LISTED]]


_LEAST_LETTERS = 3
"""Letters of a word beyond which it may name a CRS."""


def _words_of_name(name: str) -> set[str]:
    """Return the words of the name of a CRS in small letters, umlauts and accents as base letters.
    """
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode().lower()
    # Krüger is written Krueger, too.
    return set(re.findall(r"[a-z]+|\d+", plain.replace("ue", "u").replace("oe", "o")))


@lru_cache  # PROJ takes milliseconds, and each step of a run asks
def _crs_by_name(text: str) -> str:
    """Return the normal form of a CRS by name or as a string of PROJ; "" for any other text."""
    if _WGS84_NAME.fullmatch(text):
        return "EPSG:4326"
    utm_name = _UTM_NAME.fullmatch(text)
    if utm_name:
        zone = int(utm_name["zone"])
        # EPSG:326xx are the zones in the north, EPSG:327xx those in the south.
        series = 327 if utm_name["side"][0] in "sS" else 326
        return f"EPSG:{series}{zone:02d}" if 1 <= zone <= 60 else ""
    if text.startswith("+") and _PROJ.fullmatch(text):
        return _crs_of_proj_string(text)
    # A name that is listed as it stands is certain; "ED50 UTM 32N" is only read as one.
    crs = _crs_of_listed_name(text) if _CRS_NAME.fullmatch(text) else ""
    utm_of_datum = _UTM_OF_DATUM.fullmatch(text)
    if crs or not utm_of_datum:
        return crs
    return _crs_of_listed_name(
        f"{utm_of_datum['datum'].strip()} / UTM zone {int(utm_of_datum['zone'])}"
        f"{utm_of_datum['side'][0].upper()}")


def _crs_of_proj_string(text: str) -> str:
    """Return the normal form of a CRS given as a string of PROJ, such as "+proj=bonne ...".

    A string that describes no CRS gives "". Raises TermselError if pyproj is needed and not
    installed, or cannot read the string.
    """
    words = dict(re.findall(r"\+(\w+)(?:=(\S+))?", text))
    if words.get("datum") == "WGS84" and not {"axis", "pm", "vunits", "geoidgrids"} & words.keys():
        if words.get("proj") in ("longlat", "latlong"):
            return "EPSG:4326"
        zone = words.get("zone", "")
        if (words.get("proj") == "utm" and zone.isdecimal() and 1 <= int(zone) <= 60
                and words.get("units", "m") == "m"):
            return f"EPSG:32{7 if 'south' in words else 6}{int(zone):02d}"
    if "proj" not in words or _NO_CRS.search(text):
        return ""
    with require_import("a CRS as a string of PROJ requires", "pyproj", GIS):
        import pyproj  # noqa: F401 - whether it is there
    parsed = _with_pyproj(text if "+type=crs" in text else f"{text} +type=crs")
    assert parsed is not None  # pyproj is there
    # Other programs read WKT, whatever PROJ they have; a string of PROJ loses names.
    return _code_or_text(str(parsed.to_wkt()))


def _crs_of_listed_name(text: str) -> str:
    """Return the normal form of a CRS by the name that EPSG or ESRI gives it.

    Other names give "", and so do all without pyproj.
    """
    try:
        from pyproj import CRS
        from pyproj.exceptions import CRSError
    except ImportError:
        return ""
    if not _is_listed(text):
        return ""
    try:
        known = CRS.from_user_input(text)
        esri = _QUOTED_NAME.match(known.to_wkt("WKT1_ESRI"))
    except CRSError:
        return ""
    # PROJ takes a name that is near one for it: only the whole name counts.
    names = [known.name, esri[1] if esri else ""]
    if _letters_and_digits(text) not in map(_letters_and_digits, names):
        return _code_of_former_name(text)
    return normalise(_code_or_text(str(known.to_wkt())))


def _is_listed(text: str) -> bool:
    """Return whether PROJ's database has a CRS of a name; of a compound one, of its first part.

    Only letters and digits count. If the database cannot be opened, True is returned.
    """
    # PROJ looks for names that are near, and takes 0.2 s to find none, as of a table's header.
    name = _letters_and_digits(text.partition("+")[0])
    rows = _rows_of_database(
        "SELECT name FROM crs_view WHERE name LIKE ?1 AND length(name) >= ?2 UNION ALL "
        "SELECT alt_name FROM alias_name WHERE alt_name LIKE ?1 AND length(alt_name) >= ?2",
        (f"{name[0]}%", len(name)))
    return rows is None or any(name == _letters_and_digits(listed) for (listed,) in rows)


def _code_of_former_name(text: str) -> str:
    """Return the EPSG code of a CRS by another of its names, such as a former one.

    A name that EPSG does not list, or lists for several CRSs, gives ""; so does every name where
    PROJ's database cannot be opened.
    """
    # Programs keep names that EPSG has since changed: OSGB 1936 is OSGB36 now.
    rows = _rows_of_database(
        "SELECT code FROM alias_name WHERE lower(alt_name) = lower(?) AND auth_name = "
        "'EPSG' AND table_name IN ('projected_crs', 'geodetic_crs')", (text,))
    codes = {code for (code,) in rows or []}
    return normalise(f"EPSG:{codes.pop()}") if len(codes) == 1 else ""


def _rows_of_database(query: str, values: tuple[str | int, ...]) -> list[Any] | None:
    """Return what a query of PROJ's database finds; None if it cannot be opened."""
    import sqlite3

    from pyproj.datadir import get_data_dir

    database = Path(get_data_dir().split(os.pathsep)[0], "proj.db")
    try:
        with closing(sqlite3.connect(f"{database.as_uri()}?mode=ro", uri=True)) as names:
            return names.execute(query, values).fetchall()
    except (sqlite3.Error, ValueError):
        return None  # PROJ may have its database inside itself


def _letters_and_digits(name: str) -> str:
    """Return the letters and digits of a name: NAD83 / UTM zone 11N is NAD83_UTM_zone_11N."""
    return re.sub(r"[\W_]", "", name.casefold())


@lru_cache  # PROJ takes milliseconds, and each step of a run asks
def _code_or_text(text: str) -> str:
    """Return the EPSG code of a CRS that equals a listed one but for its name, else its text.

    Shapefiles call a CRS by other names than EPSG does. The search takes 10 ms.
    """
    parsed = _with_pyproj(text)
    # With a confidence of 25 pyproj also proposes codes of other names; equality decides.
    epsg = None if parsed is None else parsed.to_epsg(min_confidence=25)
    listed = None if epsg is None else _with_pyproj(f"EPSG:{epsg}")
    return f"EPSG:{epsg}" if parsed is not None and listed is not None and parsed.equals(
        listed, ignore_axis_order=True) else text


def is_geographic(crs: str) -> bool:
    """Return True if x and y are longitude and latitude; without pyproj only common CRS are known.
    """
    return kind_of(normalise(crs)) == "geographic"


def projection_method(crs: str) -> str:
    """Return the name of the projection's method, such as "Transverse Mercator".

    A CRS that is not projected gives "", and so does every CRS without pyproj.

    Examples
    --------
    >>> projection_method("EPSG:32633"), projection_method("EPSG:4326")
    ('Transverse Mercator', '')
    """
    parsed = _with_pyproj(horizontal_crs(normalise(crs)))
    if parsed is None or not parsed.is_projected or parsed.coordinate_operation is None:
        return ""
    return str(parsed.coordinate_operation.method_name)


@lru_cache  # PROJ takes milliseconds, and each step of a run asks
def longitudes_and_latitudes_of(crs: str) -> Callable[[FloatArray], FloatArray] | None:
    """Return a function from x and y (n, 2) of a projected CRS to angles on its ellipsoid [rad].

    Longitudes count from the prime meridian of the CRS. Both angles are infinite where the
    projection has no inverse. None is returned for a CRS that is not projected, and without pyproj.
    """
    parsed = _with_pyproj(horizontal_crs(normalise(crs)))
    if parsed is None or not parsed.is_projected:
        return None
    from pyproj import Transformer

    # To the CRS that the projection is of, so that no datum is changed.
    geodetic = parsed.geodetic_crs
    inverse = Transformer.from_crs(parsed, geodetic, always_xy=True)
    radians = geodetic.axis_info[0].unit_conversion_factor

    def angles_of(positions: FloatArray) -> FloatArray:
        return np.asarray(np.column_stack(inverse.transform(*positions.T)) * radians)

    return angles_of


@lru_cache  # PROJ takes milliseconds, and each step of a run asks
def axes_of_degrees(crs: str) -> tuple[float, str]:
    """Return how many degrees the unit of longitude and latitude is, and the CRS in degrees.

    Such a unit is the grad of old French maps, 0.9 degrees. For a CRS in degrees these are 1 and
    the same CRS; without pyproj every CRS is taken as one in degrees.
    """
    parsed = None if crs in WGS84 else _with_pyproj(crs)
    if parsed is None:
        return 1.0, crs
    # pyproj gives units of angles in radians.
    unit = float(np.degrees(parsed.axis_info[0].unit_conversion_factor))
    if np.isclose(unit, 1.0, rtol=1e-9):
        return 1.0, crs
    described = parsed.to_json_dict()
    described.pop("id", None)
    described["name"] = f"{parsed.name}{IN_DEGREES}"
    for axis in described["coordinate_system"]["axis"][:2]:
        axis["unit"] = "degree"
    return unit, str(type(parsed).from_json_dict(described).to_wkt())


@lru_cache  # PROJ takes milliseconds, and each step of a run asks
def prime_meridian_of(crs: str) -> float:
    """Return the longitude from Greenwich [deg] of the meridian from which a CRS counts."""
    parsed = None if crs in WGS84 else _with_pyproj(crs)
    if parsed is None or parsed.prime_meridian is None:
        return 0.0
    meridian = parsed.prime_meridian
    return float(np.degrees(meridian.longitude * meridian.unit_conversion_factor))


def metres_per_unit(crs: str) -> float | None:
    """Return the unit of x and y of a projected CRS [m]; None for others, or where nobody knows."""
    crs = normalise(crs)
    if UTM.fullmatch(crs):
        return 1.0
    parsed = None if crs == LOCAL or crs in WGS84 else _with_pyproj(crs)
    if parsed is not None and parsed.is_projected:
        return float(parsed.axis_info[0].unit_conversion_factor)
    return None


def metres_per_height(crs: str) -> float:
    """Return the unit of heights [m]: that of a vertical axis, 1 where the CRS has none."""
    unit = height_axis_unit(crs)
    return 1.0 if unit is None else unit


def height_axis_unit(crs: str) -> float | None:
    """Return the unit of the vertical axis of a CRS [m]; None if it has none."""
    crs = normalise(crs)
    # The usual CRSs need no pyproj, whose import takes long.
    if crs in (LOCAL, "", "EPSG:4326") or UTM.fullmatch(crs):
        return None
    if crs == "EPSG:4979":
        return 1.0
    parsed = _with_pyproj(crs)
    if parsed is None or len(parsed.axis_info) < 3:
        return None
    return float(parsed.axis_info[2].unit_conversion_factor)


def has_ellipsoidal_metres(crs: str) -> bool:
    """Return whether heights are ellipsoidal and in metres, or taken as such."""
    parsed = None if crs in WGS84 or UTM.fullmatch(crs) else _with_pyproj(crs)
    return metres_per_height(crs) == 1.0 and (
        parsed is None or not any(sub_crs.is_vertical for sub_crs in parsed.sub_crs_list))


def to_wgs84(crs: str) -> Transformation:
    """Return the `transformation_between` to WGS84 longitude, latitude and ellipsoidal height."""
    return transformation_between(crs, "EPSG:4979")


@lru_cache  # PROJ takes milliseconds, and each step of a run asks
def transformation_between(source: str, target: str, *, strict: bool = True,
                           for_fit: bool = False) -> Transformation:
    """Return a function that transforms ground coordinates (n, 3) from one CRS to another.

    If a CRS has no vertical datum, its heights are taken as ellipsoidal. Unknown heights are taken
    as 0; places whose x or y is unknown stay unknown. Coordinates that cannot be transformed raise
    TermselError if `strict`, else they become infinite. A CRS on an ellipsoid without a datum, as
    old maps have, is taken to be of the other's datum; a note says so unless `for_fit`, as a fitted
    model takes up what a shift between datums does.

    Raises TermselError for "local", for CRSs of different celestial bodies, if PROJ knows no
    transformation, and if pyproj is not installed, which is needed unless both CRSs are the same or
    of WGS84.
    """
    source = normalise(source)
    target = normalise(target)
    # EPSG:4326 and EPSG:4979 differ by what they say of heights, not by any number.
    if source == target or WGS84.issuperset((source, target)):
        return np.asarray
    into = "longitude and latitude" if target in WGS84 else short_crs_name(target)
    if LOCAL in (source, target):
        raise TermselError(f"plane coordinates without a CRS cannot be transformed to {into}",
                           hint="State the CRS of the ground coordinates.")
    with require_import(
            f"the transformation of {short_crs_name(source)} to {into} requires", "pyproj", GIS):
        from pyproj.exceptions import ProjError

    failure = f"coordinates in {short_crs_name(source)} cannot be transformed to {into}"
    parsed = [_with_pyproj(name) for name in (source, target)]
    source_body = body_of(source)
    target_body = body_of(target)
    if source_body != target_body:
        raise TermselError(f"{short_crs_name(source)} is on {source_body}, and "
                           f"{short_crs_name(target)} on "
                           f"{target_body}",
                           hint="Formats of WGS84, such as RPCs and GeoJSON, are for the Earth. "
                                "gcp-grid-vrt and geolocation-vrt keep the CRS.")
    # A CRS without heights gets ellipsoidal ones, so that shifts between datums apply to them, too.
    ends = [crs if len(crs.axis_info) > 2 else crs.to_3d() for crs in parsed if crs is not None]
    # PROJ calls transformations ballpark that leave heights or datums as they are, without a word.
    without_datum = next((name for name, crs in zip((source, target), parsed, strict=True)
                          if crs is not None and _has_no_datum(crs)), "")
    transformer = _transformer_without_ballpark(
        ends, failure, remedy="give ellipsoidal heights, as in EPSG:4979",
        without_datum=bool(without_datum))
    if without_datum and not for_fit:
        _warn_of_no_datum(without_datum)

    def convert(ground: FloatArray) -> FloatArray:
        """Return ground coordinates (n, 3) in the other CRS; TermselError where PROJ has none."""
        known_ground = np.nan_to_num(ground, nan=0.0)
        try:
            coordinates = transformer.transform(*known_ground.T, errcheck=strict)
        except ProjError as error:
            raise TermselError(f"{failure}: {error}", hint=_WRONG_CRS) from error
        positions = np.stack(coordinates, axis=1)
        # A place that is not known stays unknown: at 0 it would be in the ocean.
        positions[np.isnan(ground[:, :2]).any(axis=1)] = np.nan
        return positions

    return convert


def transformation_to_own_degrees(crs: str) -> Transformation:
    """Return a function from places (n, 3) in a CRS to longitudes and latitudes of its own datum.

    Longitudes count from Greenwich, and heights stay. Raises TermselError for "local" and other
    CRSs without longitudes and latitudes, and without pyproj.
    """
    name = normalise(crs)
    with require_import("longitudes and latitudes require", "pyproj", GIS):
        from pyproj import Transformer
        from pyproj.exceptions import ProjError

    parsed = None if name == LOCAL else _with_pyproj(name)
    missing = TermselError(f"{short_crs_name(name)} has no longitudes and latitudes",
                           hint="State the CRS of the ground coordinates.")
    if parsed is None or parsed.geodetic_crs is None:
        raise missing
    try:
        transformer = Transformer.from_crs(parsed.to_2d(), parsed.geodetic_crs.to_2d(),
                                           always_xy=True)
    except ProjError as error:
        raise missing from error
    meridian = prime_meridian_of(name)

    def convert(ground: FloatArray) -> FloatArray:
        """Return longitude, latitude and height (n, 3)."""
        lon, lat = transformer.transform(*ground[:, :2].T)
        return np.column_stack([lon + meridian, lat, ground[:, 2]])

    return convert


def plane_transformer(source: str | CRS, target: str | CRS) -> Transformer:
    """Return the transformer of x and y from one CRS to another, heights left as they are.

    Longitudes and latitudes of one datum are never copied to another, except from or to a CRS that
    states no datum, and on other bodies than the Earth. Where PROJ lacks the grid of the best
    operation, it is the best one that needs none.

    Raises
    ------
    TermselError
        If PROJ has no operation between the two; the message names the grid that is missing.

    Examples
    --------
    >>> x, y = plane_transformer("EPSG:28355", "EPSG:7855").transform(500000.0, 5800000.0)
    >>> round(x - 500000.0, 1), round(y - 5800000.0, 1)
    (0.5, 1.4)
    """
    from pyproj import CRS

    ends = [CRS.from_user_input(crs).to_2d() for crs in (source, target)]
    names = [short_crs_name(crs) if isinstance(crs, str) else crs.name for crs in (source, target)]
    # Datums of other bodies are frames that differ by their ellipsoids alone.
    on_earth = body_of(ends[0].to_wkt()) == EARTH
    return _transformer_without_ballpark(
        ends, f"coordinates in {names[0]} cannot be transformed to {names[1]}",
        remedy="choose a CRS of the same datum",
        without_datum=not on_earth or any(map(_has_no_datum, ends)))


def _transformer_without_ballpark(ends: list[CRS], failure: str, *, remedy: str,
                                  without_datum: bool) -> Transformer:
    """Return the transformer between two CRSs; ballpark ones only for a CRS without a datum.

    Raises TermselError if PROJ knows no transformation or lacks its grid. Its message begins with
    `failure`, its hint ends with `remedy`.
    """
    from pyproj import Transformer
    from pyproj.exceptions import ProjError

    try:
        return Transformer.from_crs(*ends, always_xy=True, allow_ballpark=without_datum)
    except ProjError as error:
        grids = _missing_grids(*ends)
        if not grids:
            raise TermselError(f"{failure}: PROJ knows no transformation between the two",
                               hint=_NO_TRANSFORMATION) from error
        further_grids = f" or one of {len(grids) - _GRIDS} others" if len(grids) > _GRIDS else ""
        raise TermselError(
            f"{failure}: PROJ does not have the grid {' or '.join(grids[:_GRIDS])}{further_grids}",
            hint=f"Get it with pyproj sync --file {grids[0]}, or set PROJ_NETWORK=ON. Or "
                 f"{remedy}.") from error


def _has_no_datum(crs: CRS) -> bool:
    """Return whether a CRS states an ellipsoid alone, as strings of PROJ of old maps do."""
    datum = "" if crs.is_bound or crs.geodetic_crs is None else str(crs.geodetic_crs.datum.name)
    return _UNKNOWN_DATUM.match(datum) is not None


@lru_cache  # so that each CRS is warned of once
def _warn_of_no_datum(name: str) -> None:
    """Log that a CRS states no datum, and that its coordinates are taken as those of WGS84."""
    short_name = short_crs_name(name)
    # PROJ calls a CRS without a name of its own "unknown", such as a string of PROJ.
    called = "" if _UNNAMED.fullmatch(short_name) else f" {short_name}"
    log.warning("Note: the CRS%s has an ellipsoid and no datum. Its longitudes and latitudes are "
                "taken as those of WGS84 where these are needed; they may be some hundred metres "
                "off.", called)


EARTH = "the Earth"


@lru_cache  # PROJ takes milliseconds, and each message asks
def body_of(crs: str) -> str:
    """Return the celestial body of a CRS as messages call it, such as "Mars".

    It is EARTH for a CRS without an ellipsoid, and for every CRS without pyproj.
    """
    ellipsoid = _ellipsoid_and_name(crs)
    if ellipsoid is None or abs(ellipsoid[0] / SEMI_MAJOR - 1.0) < _OF_EARTH:
        return EARTH
    body = _BODY.match(ellipsoid[2])
    name = body[1].capitalize() if body else ""
    return {"Moon": "the Moon", "": "another body", "Unknown": "another body"}.get(name, name)


@lru_cache  # PROJ takes milliseconds, and each step of a run asks
def ellipsoid_of(crs: str) -> tuple[float, float]:
    """Return semi-major axis [m] and square of the first eccentricity; those of WGS84 by default.
    """
    ellipsoid = _ellipsoid_and_name(crs)
    return (SEMI_MAJOR, ECCENTRICITY) if ellipsoid is None else ellipsoid[:2]


def geodetic_of(crs: str) -> str:
    """Return the CRS of longitude, latitude and height on the body of a CRS."""
    if body_of(crs) == EARTH:
        return "EPSG:4979"
    parsed = _with_pyproj(normalise(crs))
    assert parsed is not None  # without pyproj all are on the Earth
    return crs if parsed.is_geographic else str(parsed.geodetic_crs.to_wkt())


def _ellipsoid_and_name(crs: str) -> tuple[float, float, str] | None:
    """Return the semi-major axis [m], the squared eccentricity and the name of a CRS's ellipsoid.

    The name is that of the geodetic CRS, which says the body. None is returned for "local" and for
    WGS84, and if the ellipsoid is unknown.
    """
    name = normalise(crs) if crs else LOCAL
    parsed = None if name == LOCAL or name in WGS84 or UTM.fullmatch(name) else _with_pyproj(name)
    if parsed is None or parsed.ellipsoid is None:
        return None
    # The squared eccentricity is e^2 = 1 - (b / a)^2.
    major = parsed.ellipsoid.semi_major_metre
    minor = parsed.ellipsoid.semi_minor_metre
    body = parsed.geodetic_crs or parsed
    return float(major), float(1.0 - (minor / major) ** 2), str(body.name)


def area_of_use(crs: str) -> tuple[float, float, float, float] | None:
    """Return west, south, east and north [deg] of the area that a CRS is for; None if not known."""
    name = normalise(crs)
    parsed = None if name == LOCAL or name in WGS84 else _with_pyproj(name)
    area = None if parsed is None else parsed.area_of_use
    return None if area is None else tuple(area.bounds)


def is_geocentric(crs: str) -> bool:
    """Return True where coordinates are counted from the centre of the Earth."""
    return kind_of(normalise(crs)) == "geocentric"


def height_reference(crs: str) -> str:
    """Return the vertical datum of a CRS, in words, or that none is stated; "" for "local"."""
    name = normalise(crs)
    if name == LOCAL:
        return ""
    if name == "EPSG:4979":
        return "ellipsoidal (WGS 84)"
    is_without_heights = name in WGS84 or UTM.fullmatch(name)
    parsed = None if is_without_heights else _with_pyproj(name)
    stated = "" if parsed is None else vertical_datum(parsed)
    body = body_of(name)
    return stated or f"not stated by {short_crs_name(name)}; taken as ellipsoidal" + (
        "" if body == EARTH else f", above the sphere or ellipsoid of {body}")


def vertical_datum(crs: CRS) -> str:
    """Return the vertical datum of a CRS, "" if it has none."""
    if len(crs.axis_info) < 3:
        return ""
    # A compound CRS names its vertical one; a CRS with three axes has ellipsoidal heights.
    vertical = [sub_crs for sub_crs in crs.sub_crs_list if sub_crs.is_vertical]
    if vertical:
        return str(vertical[0].name)
    return f"ellipsoidal ({crs.name if crs.geodetic_crs is None else crs.geodetic_crs.name})"


def horizontal_crs(crs: str) -> str:
    """Return a CRS without its heights, as files of plane coordinates state it; "" for "local"."""
    name = normalise(crs)
    if name == LOCAL:
        return ""
    if name in WGS84:
        return "EPSG:4326"
    parsed = _with_pyproj(name)
    if parsed is None or len(parsed.axis_info) < 3:
        return name
    return normalise(parsed.to_2d().to_wkt())


def with_stated_heights(crs: str, stated: str) -> str:
    """Return another CRS if it is this one with heights, else this one: in feet, for example."""
    if height_axis_unit(crs) is None and horizontal_crs(stated) == horizontal_crs(crs):
        return normalise(stated)
    return normalise(crs)


@lru_cache  # transformers are cached, and failures are not: each would list the grids anew
def _missing_grids(source: CRS, target: CRS) -> tuple[str, ...]:
    """Return the file names of the grids that PROJ lacks for its operations between two CRSs."""
    from pyproj.transformer import TransformerGroup

    # Operations that need a grid are listed as unavailable until it is there.
    with catch_warnings():
        simplefilter("ignore")  # warnings of missing grids
        group = TransformerGroup(source, target, always_xy=True)
    grids = chain.from_iterable(operation.grids for operation in group.unavailable_operations)
    return tuple(dict.fromkeys(grid.short_name for grid in grids if not grid.available))


def short_crs_name(crs: str) -> str:
    """Return a CRS as messages name it: a code as it is, WKT by the name in it.

    A custom projection is often named "unknown"; it is called by its projection's method instead.
    Other text is cut after 40 characters.

    Examples
    --------
    >>> short_crs_name('PROJCS["unknown", GEOGCS["unknown"], PROJECTION["Bonne"]]')
    'custom Bonne'
    """
    # A bound CRS begins with the CRS that it transforms.
    name = _QUOTED_NAME.search(crs) if crs.startswith("BOUNDCRS") else _QUOTED_NAME.match(crs)
    if name is None:
        return crs if len(crs) <= 40 else f"{crs[:40]}..."
    projection = _PROJECTION_METHOD.search(crs)
    if projection and _UNNAMED.fullmatch(name[1]):
        return f"custom {projection[1].replace('_', ' ')}"
    return name[1]


def begins_as_crs(line: str) -> bool:
    """Return whether a line of a file begins as a CRS does, which `normalise` may still refuse.

    A number alone is none: it may count the points below.
    """
    return _CRS_LINE.match(line) is not None


def kind_of(crs: str) -> str:
    """Return "geographic", "projected" or "geocentric" for a CRS in its normal form; else ""."""
    if crs in WGS84:
        return "geographic"
    if UTM.fullmatch(crs):
        return "projected"
    parsed = None if crs == LOCAL else _with_pyproj(crs)
    if parsed is not None:
        if parsed.is_geographic:
            return "geographic"
        if parsed.is_projected:
            return "projected"
        return "geocentric" if parsed.is_geocentric else ""
    # Without pyproj WKT shows the kind: it begins with GEOGCS, PROJCRS and the like.
    kind_by_beginning = {"GEOG": "geographic", "PROJ": "projected", "GEOC": "geocentric"}
    return kind_by_beginning.get(crs.upper()[:4], "")


@lru_cache  # said once for each CRS
def _say_unchecked(name: str) -> None:
    """Say once that only the form of a CRS was checked."""
    log.warning("Note: pyproj is not installed, so nothing checks that %s exists. Install it: "
                'pip install "termsel[gis]".', name)


def _with_pyproj(crs: str) -> CRS | None:
    """Return the CRS, or None where pyproj is not installed."""
    try:
        import pyproj  # noqa: F401 - whether it is there
    except ImportError:
        return None
    return _parse_with_pyproj(crs)


@lru_cache  # PROJ takes 10 ms, and a run asks a hundred times
def _parse_with_pyproj(crs: str) -> CRS:
    """Return the CRS as pyproj reads it.

    Raises TermselError for a CRS that does not exist, that has no horizontal coordinates, or, on
    other bodies, whose longitudes count to the west.
    """
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    refuse_grids(crs)
    try:
        parsed = CRS.from_user_input(crs)
    except CRSError:
        raise TermselError(f"CRS {short_crs_name(crs)!r} does not exist or cannot be read",
                           hint=f"Examples: {EXAMPLES}.") from None
    if parsed.is_geographic or parsed.is_projected or parsed.is_geocentric or parsed.is_engineering:
        # pyproj's always_xy exchanges axes, but does not turn westings into eastings.
        if crs.startswith("IAU_") and "west" in [axis.direction for axis in parsed.axis_info]:
            raise TermselError(f"CRS {crs} ({parsed.name}) counts to the west, and termsel's x to "
                               "the east", hint="Transform the ground coordinates to a CRS whose "
                               f"longitudes grow to the east, such as {crs[:-2]}00.")
        return parsed
    raise TermselError(f"CRS {short_crs_name(crs)!r} ({parsed.name}) has no horizontal coordinates",
                       hint=f"Examples: {EXAMPLES}.")
