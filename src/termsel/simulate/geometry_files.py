"""The geometry of a pushbroom scanner as a JSON file."""

from __future__ import annotations

import json
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from termsel.errors import TermselError
from termsel.io.atomic import write_text
from termsel.io.base import read_head, read_text
from termsel.simulate.pushbroom import Angle, Pushbroom

SCHEMA = "termsel-pushbroom-1"
_ANGLES = ("roll", "pitch", "yaw")


def write_geometry(sensor: Pushbroom, path: Path | str) -> None:
    """Write the geometry of a scanner as JSON: the fields of `Pushbroom`, in its units.

    Parameters
    ----------
    sensor : Pushbroom
    path : path-like
    """
    content = {"schema": SCHEMA, **asdict(sensor)}
    write_text(Path(path), json.dumps(content, indent=1) + "\n")


def read_geometry(path: Path | str) -> Pushbroom:
    """Return the scanner of a file that `write_geometry` made.

    Parameters
    ----------
    path : path-like

    Raises
    ------
    TermselError
        If the file cannot be read, is no such file, or lacks a field or has one amiss.
    """
    path = Path(path)
    expected = f"Expected JSON of the form {SCHEMA}, as termsel.simulate.write_geometry makes it."
    read_head(path, expected)
    try:
        content = json.loads(read_text(path))
    except json.JSONDecodeError as error:
        raise TermselError(f"this is not JSON: {error.msg}", file=path, line=error.lineno,
                           hint=expected) from error
    if not isinstance(content, dict) or content.pop("schema", None) != SCHEMA:
        raise TermselError("this is no geometry of a pushbroom scanner", file=path, hint=expected)
    names = [field.name for field in fields(Pushbroom)]
    for name in names:
        if name not in content:
            raise TermselError("the geometry lacks a field", file=path, column=name, hint=expected)
    try:
        return Pushbroom(**{name: _value(name, content[name]) for name in names})
    except (TypeError, ValueError, KeyError) as error:
        raise TermselError(f"a field of the geometry is amiss: {error}", file=path,
                           hint=expected) from error
    except TermselError as error:
        raise TermselError(error.what, file=path, hint=error.hint) from error


def _value(name: str, value: Any) -> Any:
    if name in _ANGLES:
        jitter = tuple((float(a), float(f), float(p)) for a, f, p in value["jitter"])
        return Angle(tuple(map(float, value["drift"])), jitter)
    if name == "offset":
        ahead, starboard, down = map(float, value)
        return ahead, starboard, down
    if name == "refraction":
        return bool(value)
    return int(value) if name.startswith("n_") else float(value)
