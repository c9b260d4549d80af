"""Maps of the images of a batch: which of them are made, where, and why the others are not."""

from __future__ import annotations

from codecs import BOM_UTF8
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from shlex import join, quote

from termsel.core.errors import TermselError, count_in_words, first_names_in_words
from termsel.core.files.endings import RASTERS
from termsel.core.files.names import JOURNAL, RECORD, free_name, is_there
from termsel.core.files.texts import csv_table
from termsel.io.result_folder import read_result
from termsel.results.result import Result
from termsel.studies.cells.folder import read_study
from termsel.studies.cells.images import IMAGES, folders_of, stem_of
from termsel.studies.cells.table import Row
from termsel.studies.cells.verdicts import DOUBTFUL, UNFIT, USABLE
from termsel.studies.execution.naming import name_image_in_log
from termsel.studies.study import Study

PLANNED, WRITTEN, KEPT, OUTDATED, LEFT_OUT, FAILED = (
    "planned", "written", "kept", "outdated", "left out", "failed")
"""What comes of the map of an image; `KEPT` is one that was there before, and `OUTDATED` one that
is older than the result of its image."""

TABLE = "maps.csv"
"""The table in the folder of the maps: what was written, what not or with doubt, and why."""
_HEADER = ("image", "verdict", "state", "map", "why")


@dataclass(frozen=True)
class ImageMap:
    """The map of one image: the folder of its result, its picture, and what comes of the map."""

    image: str
    verdict: str
    folder: Path
    output: Path
    state: str = PLANNED
    why: str = ""
    picture: Path | None = None


def is_batch(folder: Path) -> bool:
    """Return whether a folder is that of a study, and not that of one result."""
    return is_there(folder / JOURNAL) and not is_there(folder / RECORD)


def plan_maps(folder: Path, pictures: Path, out: Path, *, with_doubtful: bool, overwrite: bool,
              ) -> list[ImageMap]:
    """Return what is to be done for each image of a batch, in the order of its files.

    Parameters
    ----------
    folder : path
        Of the batch.
    pictures : path
        Folder of the images, each named like its file of points.
    out : path
        Folder of the maps.
    with_doubtful : bool
        Whether doubtful images get a map, too; those that are unfit never do.
    overwrite : bool
        Whether maps that are there are made again.

    Raises
    ------
    TermselError
        If the study has no images, `pictures` is no folder or that of the maps, or `out` is a file
        or has a table of this name that is another one.
    """
    study = read_study(folder)
    # A study of solvers has many results on one image, none of which is the map.
    if study.noun != "image":
        raise TermselError("this is a study of searches, of which no map can be made", file=folder,
                           hint="Give the folder of one result, or of a batch of images.")
    if not pictures.is_dir():
        raise TermselError(f"{folder} is a batch of {count_in_words(len(study.cells), 'image')}, "
                           "and this is not a folder of images", file=pictures,
                           hint="Give the folder in which the images are, or one result: "
                                f"{folder / IMAGES}/NAME.")
    if out.resolve() == pictures.resolve():
        raise TermselError("maps would have the names of the images in this folder", file=out,
                           hint="Give another folder: --output DIR.")
    _require_folder_of_maps(out, overwrite)
    rows = {str(row["cell"]): row for row in study.rows}
    names = folders_of(study.cells)
    files = _pictures_in(pictures)
    pictures_of = {label: _pictures_of(label, files)
                   for label in {str(labels["data"]) for labels in study.cells.values()}}
    verdicts = (*USABLE, DOUBTFUL) if with_doubtful else USABLE
    maps = []
    for key, labels in study.cells.items():
        row = rows[key]
        planned = ImageMap(str(labels["data"]), str(row["verdict"]), folder / IMAGES / names[key],
                           out / f"{names[key]}.tif",
                           why=str(row["why"]) if row["verdict"] == DOUBTFUL else "")
        if row["verdict"] in verdicts:
            planned = _with_picture(planned, pictures, pictures_of, overwrite)
        else:
            planned = _image_without_map(planned, row)
        maps.append(_with_earlier_map(planned))
    return maps


def _require_folder_of_maps(out: Path, overwrite: bool) -> None:
    """Raise TermselError for a file, and for a folder whose table is not one of maps."""
    if out.is_file():
        raise TermselError("this is a file, and a batch needs a folder for its maps", file=out,
                           hint="Choose another --output.")
    table = out / TABLE
    if not is_there(table) or overwrite:
        return
    # A table of an earlier call gives way: the same command goes on after an interruption.
    header = ",".join(_HEADER).encode()
    if not table.is_file() or not table.read_bytes().removeprefix(BOM_UTF8).startswith(header):
        raise TermselError("this is no table of maps that termsel wrote, and would be replaced",
                           file=table, hint="Choose another --output, or use --overwrite.")


def _image_without_map(planned: ImageMap, row: Row) -> ImageMap:
    """Return an image whose verdict allows no map, with the reason."""
    if not planned.verdict:
        return replace(planned, state=LEFT_OUT, why="not finished: repeat the command of the batch")
    return replace(planned, state=LEFT_OUT, why=str(row["why"]))


def _with_picture(planned: ImageMap, folder: Path, pictures_of: Mapping[str, Sequence[Path]],
                  overwrite: bool) -> ImageMap:
    """Return an image with its picture in a folder; failed without one of its own, or with several.

    `pictures_of` has the pictures of each file of points by their names.
    """
    if is_there(planned.output) and not overwrite:
        if _is_older_than_result(planned):
            return replace(planned, state=OUTDATED,
                           why="the map is older than the result; --overwrite makes it again")
        return replace(planned, state=KEPT, why="it was there; --overwrite makes it again")
    files = pictures_of[planned.image]
    if len(files) != 1:
        if files:
            why = f"{folder} has several of this name: {', '.join(file.name for file in files)}"
        else:
            why = f"{folder} has no image of the name {stem_of(planned.image)}"
        return replace(planned, state=FAILED, why=why)
    # Two files of points of one name, in two folders, are of two images.
    owners = sorted(label for label, others in pictures_of.items() if files[0] in others)
    if len(owners) > 1:
        return replace(planned, state=FAILED, why=(
            f"{files[0].name} would be the image of {count_in_words(len(owners), 'file')} of "
            f"points: {first_names_in_words(owners)}. Give each its own name"))
    return replace(planned, picture=files[0])


def _pictures_in(folder: Path) -> list[Path]:
    """Return the pictures in a folder, in the order of their names."""
    return sorted(file for file in folder.iterdir() if file.suffix.lower() in RASTERS)


def _pictures_of(label: str, files: Sequence[Path]) -> list[Path]:
    """Return the pictures that are named like a file of points."""
    # An image of several in one file may be IMG.1, of which .1 is no ending.
    names = [PurePosixPath(label.partition("#")[2]).name, stem_of(label)]
    pictures: list[Path] = []
    for name in filter(None, names):
        # The points of map.jpg may be in map.points or in map.jpg.points.
        pictures = [file for file in files
                    if name.casefold() in (file.stem.casefold(), file.name.casefold())]
        if pictures:
            break
    return pictures


def _is_older_than_result(planned: ImageMap) -> bool:
    """Return whether the map of an image was written before the result of the image."""
    record = planned.folder / RECORD
    return is_there(record) and planned.output.stat().st_mtime < record.stat().st_mtime


def _with_earlier_map(item: ImageMap) -> ImageMap:
    """Return an image of which no map was made, saying so where an earlier map of it is there.

    An image in any other state is returned as it is.
    """
    if item.state not in (LEFT_OUT, FAILED) or not is_there(item.output):
        return item
    return replace(item, why=f"{item.why}; an earlier map is still there: {item.output}")


def first_map_needing_heights(maps: Iterable[ImageMap]) -> ImageMap | None:
    """Return the first planned map whose model needs the heights of the ground; None if none does.
    """
    return next((planned for planned in maps if planned.state == PLANNED
                 and read_result(planned.folder).fit.model.uses_height), None)


def dem_of_batch(folder: Path) -> str | None:
    """Return the raster from which a batch took heights; None without one."""
    rasters = [source.reading.get("dem") for source in read_study(folder).spec.data]
    return next((str(raster) for raster in rasters if raster), None)


def write_maps(maps: Sequence[ImageMap], write: Callable[[Result, Path, Path], None],
               ) -> Iterator[ImageMap]:
    """Yield each image after its map was written; one that fails stops no other.

    `write` takes a result, its picture, and the file of the map.
    """
    for planned in maps:
        if planned.state != PLANNED or planned.picture is None:
            yield planned
            continue
        try:
            with name_image_in_log(planned.image):
                write(read_result(planned.folder), planned.picture, planned.output)
        except TermselError as error:
            yield _with_earlier_map(replace(planned, state=FAILED, why=str(error)))
        else:
            yield replace(planned, state=WRITTEN)


def table_of_maps(maps: Iterable[ImageMap]) -> str:
    """Return the table of maps as CSV: image, verdict, state, map, why none or doubtful."""
    rows = [(item.image, item.verdict, item.state,
             item.output.name if item.state in (WRITTEN, KEPT, OUTDATED) else "", item.why)
            for item in maps]
    return csv_table([_HEADER, *rows])


def count_of_maps(maps: Sequence[ImageMap]) -> str:
    """Return a clause on how many images there are, and what came of their maps."""
    states = Counter(item.state for item in maps)
    counts = [f"{states[state]} {state}" for state in (
        PLANNED, WRITTEN, KEPT, OUTDATED, LEFT_OUT, FAILED) if states[state]]
    return f"{count_in_words(len(maps), 'image')}: {', '.join(counts)}"


def next_command(study: Study, folder: Path) -> str:
    """Return the next step after a batch as a command: maps, or where to measure more points.

    It begins with "Next: " and can be typed. Where an image or a DEM that the maps need is not
    known, it is the page of the least certain image instead. Returns "" where nothing is left to
    do.
    """
    rows = [row for row in study.rows if row["state"] == "done"]
    names = folders_of(study.cells)
    usable = [row for row in rows if row["verdict"] in USABLE]
    if usable:
        first_usable = usable[0]
        # What a row calls its data begins with the file of points: FILE, FILE#PART, FILE + FILE.
        points_file = Path(str(first_usable["data"]).partition("#")[0].partition(" + ")[0])
        pictures_folder = points_file.parent
        has_picture = (pictures_folder.is_dir() and len(_pictures_of(
            str(first_usable["data"]), _pictures_in(pictures_folder))) == 1)
        dem = dem_of_batch(folder)
        uses_heights = read_result(
            folder / IMAGES / names[first_usable["cell"]]).fit.model.uses_height
        if has_picture and (dem or not uses_heights):
            maps_folder = free_name(folder.with_name(f"{folder.name}-maps"))
            words = ["termsel", "rectify", str(folder), str(pictures_folder), "--output",
                     maps_folder, *(["--dem", dem] if uses_heights and dem else [])]
            return f"Next: {join(words)}   (maps of the usable images)"
        # What is not known cannot be typed: the page of the worst can, until it is.
        worst_page = quote(str(folder / IMAGES / names[rows[0]["cell"]]))
        return f"Next: termsel report {worst_page}   (the least certain image)"
    # Rows begin with the worst.
    doubtful_rows = [row for row in rows if row["verdict"] in (UNFIT, DOUBTFUL)]
    if not doubtful_rows:
        return ""
    worst_result = quote(str(folder / IMAGES / names[doubtful_rows[0]["cell"]]))
    return f"Next: termsel plan {worst_result}   (best positions for further points)"
