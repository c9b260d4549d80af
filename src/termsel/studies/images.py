"""A folder an image: the files of a result that the strategy auto made."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from termsel.errors import TermselError
from termsel.files.atomic import private_folder, put_in_place, sync

IMAGES = "images"


def folder_of(labels: Mapping[str, Any]) -> str:
    """Return the name of an image's folder: that of its data, and of its split if not the first.

    Parameters
    ----------
    labels : mapping
        Of the cell.
    """
    name = re.sub(r"[^\w.+-]+", "_", str(labels["data"])).strip("._") or "image"
    return name if not labels["split"] else f"{name}-split-{labels['split']}"


def write_files(place: Path, labels: Mapping[str, Any], files: Mapping[str, bytes]) -> None:
    """Write the files of a result into the folder of its image.

    Each file is written completely or not at all; those of a cell that is repeated replace the
    earlier ones, which are the same.

    Parameters
    ----------
    place : pathlib.Path
        Folder of the study.
    labels : mapping
        Of the cell.
    files : mapping
        Content by name; without any, nothing is done.

    Raises
    ------
    TermselError
        If they cannot be written.
    """
    if not files:
        return
    folder = place / IMAGES / folder_of(labels)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with private_folder(folder) as new:
            for name, content in files.items():
                (new / Path(name).name).write_bytes(content)
                sync(new / Path(name).name)
            for name in files:
                put_in_place(new / Path(name).name, folder / Path(name).name)
    except OSError as error:
        raise TermselError(f"cannot write the result: {error.strerror or error}", file=folder,
                           hint="Make space, then repeat the command to go on.") from error
