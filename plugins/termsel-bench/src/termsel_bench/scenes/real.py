"""Real sets: a folder each, with points that have roles, and a licence that lets others use them.

A folder has `set.json` and the files it names::

    {"title": "...", "kind": "map", "crs": "EPSG:2100", "points": "points.csv",
     "sha256": "...", "licence": "MIT", "licence_file": "LICENSE",
     "source": "https://...", "commit": "3acac23f..."}

A set without one of these is refused.
"""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import termsel
from termsel import Points, TermselError
from termsel.toolkit import read_data, read_text
from termsel_bench.scenes.base import BenchSet

DECLARATION = "set.json"
"""File of a folder that declares it a set."""

REQUIRED_FIELDS = (
    "title", "kind", "crs", "points", "sha256", "licence", "licence_file", "source", "commit"
)
"""Fields of the declaration, a text each."""
# Fewest characters of a licence: its name alone is no licence.
_MIN_LICENCE_LENGTH = 100


def real_folders(folder: Path) -> list[Path]:
    """Return the folders of sets in a folder, each of them checked.

    Raises
    ------
    TermselError
        If there is none, or one is refused.
    """
    folders = sorted(path.parent for path in folder.glob(f"*/{DECLARATION}"))
    if not folders:
        raise TermselError(f"{folder} has no folder with a file {DECLARATION}",
                           hint="Name the folder with one folder for each set.")
    for set_folder in folders:
        real_set(set_folder)
    return folders


def real_set(folder: Path) -> BenchSet:
    """Return the real set in a folder, which a file in it declares.

    Control and selection points are the features of the set; independent points judge.

    Raises
    ------
    TermselError
        If licence, source, commit or checksum are missing or wrong, and if there are fewer than
        two independent points, or no others.
    """
    file = folder / DECLARATION
    declared = _declaration_of(file)
    licence = _file_of_set(folder, declared["licence_file"], file)
    if len(licence.decode("utf-8", "replace").strip()) < _MIN_LICENCE_LENGTH:
        raise TermselError(f"{declared['licence_file']} is not the text of a licence",
                           file=str(file),
                           hint="Put the whole text of the licence into the folder.")
    if not re.fullmatch(r"https?://\S+", declared["source"]):
        raise TermselError(f"the source {declared['source']!r} is no address", file=str(file),
                           hint="State the source of the data, as https://...")
    # SHA-1 of git has 40 digits, SHA-256 has 64.
    if not re.fullmatch(r"[0-9a-f]{40}|[0-9a-f]{64}", declared["commit"]):
        raise TermselError(f"the commit {declared['commit']!r} is none", file=str(file),
                           hint="Give all 40 or 64 hexadecimal digits.")
    checksum = hashlib.sha256(_file_of_set(folder, declared["points"], file)).hexdigest()
    if checksum != declared["sha256"]:
        raise TermselError(f"the SHA-256 of {declared['points']} is {checksum}, not the declared "
                           "one",
                           file=str(file), hint="Take the file that was declared, or declare this.")
    features = termsel.read(folder / declared["points"], crs=declared["crs"])
    roles = np.array(features.points.roles)
    judging = roles == "independent"
    is_seen = (roles == "control") | (roles == "check")
    if judging.sum() < 2 or not is_seen.any():
        raise TermselError(f"{declared['points']} has {judging.sum()} independent check points and "
                           f"{is_seen.sum()} others", file=str(file),
                           hint="Give points the roles control, check and independent.")
    points: Points = features.points
    return BenchSet(folder.name, declared["kind"], replace(features, points=points.take(is_seen)),
                    points.take(judging), declared["licence"],
                    f"{declared['source']} {declared['commit']}")


def _declaration_of(file: Path) -> dict[str, str]:
    """Return the fields by which a JSON file declares a real set: licence, source and others.

    Raises TermselError if the file cannot be read, or a required field is missing or blank.
    """
    try:
        declared: Any = json.loads(read_text(file))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise TermselError(f"{file} cannot be read: {error}", hint="It has to be JSON.") from error
    for name in REQUIRED_FIELDS:
        if (
            not isinstance(declared, dict)
            or not isinstance(declared.get(name), str)
            or not declared[name]
        ):
            raise TermselError(f"the set {file.parent.name} does not say its {name}",
                               file=str(file), hint=f"State all of {', '.join(REQUIRED_FIELDS)}.")
    return declared  # type: ignore[no-any-return]


def _file_of_set(folder: Path, name: str, file: Path) -> bytes:
    """Return the content of a file of a set; raises TermselError if it is not in the set's folder.
    """
    path = folder / name
    # A declaration cannot name a file outside of its folder.
    if not path.resolve().is_relative_to(folder.resolve()) or not path.is_file():
        raise TermselError(f"there is no file {name} in the folder of the set", file=str(file),
                           hint="Put it there.")
    return read_data(path)
