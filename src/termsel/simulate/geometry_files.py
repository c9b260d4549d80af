"""The geometry of a pushbroom scanner as a JSON file."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import get_type_hints

from msgspec import ValidationError, convert

from termsel.core.errors import TermselError
from termsel.core.files.atomic import write_text
from termsel.formats.base import error_in_file, parse_json, read_head, read_text
from termsel.simulate.pushbroom import Pushbroom

GEOMETRY_SCHEMA = "termsel-pushbroom-1"
_EXPECTED = (f"Expected JSON with the schema {GEOMETRY_SCHEMA}, from "
             "termsel.simulate.write_geometry.")
_TYPES = {**get_type_hints(Pushbroom), "offset": tuple[float, float, float]}


def geometry_text(sensor: Pushbroom) -> str:
    """Return the geometry of a scanner as JSON: the fields of `Pushbroom`, in its units.

    Parameters
    ----------
    sensor : Pushbroom
        With one `offset` for the whole image.

    Returns
    -------
    str
        JSON with the schema ``termsel-pushbroom-1``.

    Examples
    --------
    >>> import json
    >>> from termsel.simulate import geometry_text, scene_truth
    >>> geometry = json.loads(geometry_text(scene_truth("ikonos-hamedan").sensor))
    >>> geometry["schema"]
    'termsel-pushbroom-1'
    """
    return json.dumps({"schema": GEOMETRY_SCHEMA, **asdict(sensor)}, indent=1) + "\n"


def geometry_from(text: str) -> Pushbroom:
    """Return the scanner of a text from `geometry_text`.

    Parameters
    ----------
    text : str
        JSON with the schema ``termsel-pushbroom-1``.

    Returns
    -------
    Pushbroom
        The same scanner, to the last digit.

    Raises
    ------
    TermselError
        If the text is not a geometry, or a field is missing or invalid.

    Examples
    --------
    >>> from termsel.simulate import geometry_from, geometry_text, scene_truth
    >>> sensor = scene_truth("ikonos-hamedan").sensor
    >>> copied = geometry_from(geometry_text(sensor))
    >>> copied == sensor, copied.n_lines
    (True, 7000)
    """
    content = parse_json(text, _EXPECTED)
    if not isinstance(content, dict) or content.get("schema") != GEOMETRY_SCHEMA:
        raise TermselError("this is not the geometry of a pushbroom scanner", hint=_EXPECTED)
    for name in _TYPES:
        if name not in content:
            raise TermselError("this field of the geometry is missing", column=name, hint=_EXPECTED)
    try:
        return Pushbroom(**{name: convert(content[name], kind) for name, kind in _TYPES.items()})
    except (ValidationError, OverflowError, UnicodeEncodeError) as error:
        raise TermselError(f"a field of the geometry is invalid: {error}",
                           hint=_EXPECTED) from error


def write_geometry(sensor: Pushbroom, path: Path | str) -> None:
    """Write the geometry of a scanner as JSON (see `geometry_text`).

    Parameters
    ----------
    sensor : Pushbroom
        With one `offset` for the whole image.
    path : path-like
        A file that is there is replaced.

    Raises
    ------
    TermselError
        If the file cannot be written.

    Examples
    --------
    >>> from termsel.simulate import scene_truth, write_geometry
    >>> write_geometry(scene_truth("ikonos-hamedan").sensor, "scanner.json")
    """
    write_text(Path(path), geometry_text(sensor))


def read_geometry(path: Path | str) -> Pushbroom:
    """Return the scanner of a file from `write_geometry`.

    Parameters
    ----------
    path : path-like
        JSON with the schema ``termsel-pushbroom-1``.

    Returns
    -------
    Pushbroom
        The same scanner, to the last digit.

    Raises
    ------
    TermselError
        If the file cannot be read, is not a geometry, or lacks a field or has an invalid one.

    Examples
    --------
    >>> from termsel.simulate import read_geometry, scene_truth, write_geometry
    >>> sensor = scene_truth("ikonos-hamedan").sensor
    >>> write_geometry(sensor, "scanner.json")
    >>> read_geometry("scanner.json") == sensor
    True
    """
    path = Path(path)
    read_head(path, _EXPECTED)
    text = read_text(path)
    try:
        return geometry_from(text)
    except TermselError as error:
        raise error_in_file(error, path) from error
