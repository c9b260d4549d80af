"""The CRS that a user states as a file: WKT in ``.prj`` or ``.wkt``, a raster, or a layer."""

from __future__ import annotations

import logging
from pathlib import Path

from termsel.core.errors import TermselError
from termsel.core.files.names import is_there, no_such_file_error
from termsel.core.remedies import Remedy
from termsel.data.coordinates.crs import begins_as_crs, normalise, short_crs_name
from termsel.data.rasters import open_raster
from termsel.formats.base import error_in_file, read_head, read_text
from termsel.formats.readers.vector import is_vector, open_layer

log = logging.getLogger(__name__)

_TEXTS = (".prj", ".wkt", ".wkt2", ".txt", ".proj", ".proj4")
_OTHER_FILES = (".tif", ".tiff", ".vrt", ".gpkg", ".shp", ".fgb", ".geojson", ".json")
_NO_CRS = "Give a file of WKT, a raster or a layer that has a CRS, or its name, such as EPSG:32631."


def stated_crs(stated: str | None) -> str | None:
    """Return the normal form of a CRS that a user states, by name or by the file that has it.

    Returns None if `stated` is None. Raises TermselError where it is neither a CRS nor a file with
    one. It must not be asked about a CRS within a file, which must never name another file.
    """
    if stated is None:
        return None
    path = Path(stated.strip())
    # A text that is the name of a file is one; all else, such as "EPSG:25832", is a CRS. WKT is
    # longer than a name may be, and a string of PROJ may end in a name, "+geoidgrids=egm96.tif".
    may_be_file = (max(len(part.encode(errors="replace")) for part in path.parts or ("",)) < 256
                   and "\n" not in stated and bool(path.suffix) and "=" not in stated)
    if may_be_file and is_there(path) and path.is_file():
        return _crs_of_file(path)
    if may_be_file and path.suffix.lower() in (*_TEXTS, *_OTHER_FILES) and not is_there(path):
        raise no_such_file_error(path)
    return normalise(stated)


def crs_next_to(path: Path) -> str:
    """Return the CRS in the file of the same name that ends in .prj; "" without such a file.

    A note says that the CRS is from there. Raises TermselError for a file that holds no CRS.
    """
    prj = prj_next_to(path)
    if prj is None:
        return ""
    crs = _crs_of_text(prj)
    log.info("Note: the CRS is that of %s.", prj.name)
    return crs


def warn_of_other_crs(path: Path, stated: str) -> None:
    """Warn if the .prj next to a file has another CRS than the one that the user states for it.

    What the user states holds: a .prj that cannot be read is ignored.
    """
    prj = prj_next_to(path)
    if prj is None:
        return
    try:
        crs = _crs_of_text(prj)
    except TermselError:
        return
    if crs != stated:
        log.warning("Warning: %s has the CRS %s, but %s is used.", prj.name,
                    short_crs_name(crs), Remedy("crs", short_crs_name(stated)))


def prj_next_to(path: Path) -> Path | None:
    """Return the .prj file of a file, or its .qpj of QGIS, or its a.csv.prj; None without one."""
    candidates = (path.with_suffix(".prj"), path.with_suffix(".PRJ"),
                  path.with_name(f"{path.name}.prj"), path.with_suffix(".qpj"))
    return next((candidate for candidate in candidates
                 if candidate != path and is_there(candidate) and candidate.is_file()), None)


def _crs_of_file(path: Path) -> str:
    """Return the CRS that a text, a vector file or a raster states.

    Raises TermselError for a file without a CRS, and for one that cannot be read.
    """
    if path.suffix.lower() in _TEXTS:
        return _crs_of_text(path)
    head = read_head(path, _NO_CRS)
    if begins_as_crs(head[:80].decode("utf-8-sig", errors="replace")):
        return _crs_of_text(path)
    if is_vector(head) or path.suffix.lower() in (".geojson", ".json", ".gml", ".kml"):
        meta, _, _ = open_layer(path, None, (), [])
        text = str(meta.get("crs") or "")
    else:
        with open_raster(path) as raster:
            # Rasters with ground control points have their CRS with these.
            crs = raster.crs or raster.gcps[1]
            text = "" if crs is None else crs.to_wkt()
    if not text:
        raise TermselError("this file has no CRS", file=path, hint=_NO_CRS)
    return _normalise_crs(path, text)


def _crs_of_text(path: Path) -> str:
    """Return the CRS in a text file; raises TermselError if it is empty or no CRS."""
    # WKT may be written over many lines.
    text = " ".join(read_text(path).split())
    if not text:
        raise TermselError("this file is empty, expected a CRS", file=path, hint=_NO_CRS)
    return _normalise_crs(path, text)


def _normalise_crs(path: Path, text: str) -> str:
    """Return the normal form of a CRS; TermselError, with the file, for what is none."""
    try:
        return normalise(text)
    except TermselError as error:
        raise error_in_file(error, path) from error
