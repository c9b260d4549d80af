"""What readers of several programs share: where pixels begin, UTM, XML, GCPs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from termsel import Points, TermselError
from termsel.toolkit import read_data
from termsel.toolkit.coordinates import normalise
from termsel.toolkit.files import decode_xml, error_in_file

CORNER = 0.5
"""From the centre of the first pixel to its outer corner, where GDAL and others count from."""


def utm_crs(zone: int, south: bool) -> str:
    """Return the CRS of a zone of UTM on WGS84; "" if there is no such zone."""
    if not 1 <= zone <= 60:
        return ""
    # EPSG:32601 to 32660 are the zones of the north, EPSG:32701 to 32760 those of the south.
    return f"EPSG:{(32700 if south else 32600) + zone}"


def xml_root(path: Path, hint: str) -> ElementTree.Element:
    """Return the root of an XML file.

    Raises
    ------
    TermselError
        With the file and `hint`, if it is no XML, or if it has a document type; with the file, if
        it is not in the encoding that it declares.
    """
    text = decode_xml(read_data(path), path)
    # Entities of a document type can make a text of any length of a short file.
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise TermselError("an XML file with a document type is not read", file=path, hint=hint)
    try:
        return ElementTree.fromstring(text.lstrip())
    except ElementTree.ParseError as error:
        raise TermselError(f"this is not XML: {error}", file=path, hint=hint) from error


def file_beside(path: Path, name: str) -> Path:
    """Return the path of a file that an option names, which may lie next to another file.

    If there is no file `name`, but one of its last part in the folder of `path`, it is that file;
    else `name` as it is.
    """
    beside = path.with_name(Path(name).name)
    return beside if not Path(name).is_file() and beside.is_file() else Path(name)


def crs_or_blank(crs: str) -> str:
    """Return a CRS in its normal form; "" if it cannot be read."""
    try:
        return normalise(crs)
    except TermselError:
        return ""


def what_lacks(error: KeyError | ValueError) -> str:
    """Return a clause for users on an error of reading attributes.

    It names the attribute that a KeyError lacks; of a ValueError it is the message.
    """
    return f"it has no {error.args[0]}" if isinstance(error, KeyError) else str(error)


def points_of(path: Path, ids: Sequence[str], rows: Sequence[Sequence[float]]) -> Points:
    """Return points of rows of line, sample, x, y and z (n, 5).

    Heights are unknown if all are 0 or NaN. If an id is blank or repeats, all points are called P1,
    P2 and so on. Raises TermselError, with the path, if a row is no point.
    """
    table = np.array(rows, dtype=np.float64)
    # Programs write 0 where they know no height.
    if not np.nan_to_num(table[:, 4]).any():
        table[:, 4] = np.nan
    names = [name.strip() for name in ids]
    # Ids must be unique here, which they need not be in the files of other programs.
    if len({*names} - {""}) < len(names):
        names = [f"P{i}" for i in range(1, len(names) + 1)]
    try:
        return Points(tuple(names), table[:, :2], table[:, 2:])
    except TermselError as error:
        raise error_in_file(error, path) from error
