"""A folder an image: the files of a result that the strategy auto made."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from termsel.core.errors import TermselError
from termsel.core.files.atomic import private_folder, put_in_place, sync

IMAGES = "images"


def folders_of(labels: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """Return the names of the folders of all images of auto, by the keys of their cells.

    A folder is named by its image, by its split where that is not the first, and by problem and
    method where several have the same data. Raises TermselError where two images would share a
    folder on a disk that ignores capitals.
    """
    labels = {key: cell for key, cell in labels.items() if cell["strategy"] == "auto"}
    # How many problems have the same data and split.
    labels_of_data: dict[tuple[str, int], list[Mapping[str, Any]]] = {}
    for cell in labels.values():
        labels_of_data.setdefault((cell["data"], cell["split"]), []).append(cell)
    names = {}
    owners = dict[str, str]()
    images = _images_of({str(cell["data"]) for cell in labels.values()})
    for key, cell in labels.items():
        # By its image, by its split if that is not the first, and by its problem and its method
        # where several have the same data.
        name = images[str(cell["data"])]
        if cell["split"]:
            name += f"-split-{cell['split']}"
        for part in ("problem", "solver"):
            if len({other.get(part) for other in labels_of_data[cell["data"], cell["split"]]}) > 1:
                name += f"-{file_word(str(cell[part]), 'image')}"
        # Capitals do not distinguish names on every disk.
        if name.casefold() in owners:
            raise TermselError(f"{owners[name.casefold()]} and {cell['data']} would have the same "
                               f"folder {IMAGES}/{name}", hint="Rename one of them.")
        names[key] = name
        owners[name.casefold()] = str(cell["data"])
    return names


def _images_of(data: Collection[str]) -> dict[str, str]:
    """Return the name of each data's image: that of its file, without folders and suffix.

    Where two would have the same name, it is the whole label of the data.
    """
    by_label = {label: file_word(label, "image") for label in data}
    by_stem = {label: file_word(stem_of(label), "image") for label in data}
    # Names that differ in capitals alone are one on some disks.
    count = Counter(name.casefold() for name in by_stem.values())
    return {label: by_stem[label] if count[by_stem[label].casefold()] == 1 else by_label[label]
            for label in data}


def stem_of(label: str) -> str:
    """Return the name of a file of points, or of its part, without folder and suffix."""
    files, _, part_name = label.partition("#")
    # "gcps/a.csv + lines/a.csv#IMG_1" is of the part, or of the first file.
    return PurePosixPath(part_name or files.partition(" + ")[0]).stem


def file_word(text: str, empty: str) -> str:
    """Return a text as part of a file name; `empty` if no character of it can be in one."""
    return re.sub(r"[^\w.+-]+", "_", text).strip("._") or empty


def write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write the files of a result into the folder of its image, each completely or not at all.

    Raises TermselError where the folder cannot be written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with private_folder(folder) as new:
            for name, content in files.items():
                # The name alone: a record from a worker must not lead out of the folder.
                (new / Path(name).name).write_bytes(content)
                sync(new / Path(name).name)
            for name in files:
                # Those of a cell that is repeated replace the earlier ones, which are the same.
                put_in_place(new / Path(name).name, folder / Path(name).name)
    except OSError as error:
        raise TermselError(f"cannot write the result: {error.strerror or error}", file=folder,
                           hint="Make space, then repeat the command to go on.") from error
