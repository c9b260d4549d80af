"""Points of a table that was pasted, read as `termsel.read` reads a file.

A file of control has both coordinates of each point; what is pasted may have either alone, as a
list of surveyed points whose places in the image are measured next.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import get_ident

import numpy as np

import termsel
from termsel import FeatureSet, Points, TermselError
from termsel.toolkit import private_folder, require_inside
from termsel.toolkit.coordinates import check_ground
from termsel.toolkit.files import (
    POINTS,
    columns_by_meaning,
    read_cells,
    read_table,
    refuse_other_units,
)
from termsel_app.control import Record, checked_record

_GROUND_COLUMNS = ("x", "y", "z")
_IMAGE_COLUMNS = ("line", "sample")
_WITHOUT_HEADER = {3: ("id", "x", "y"), 4: ("id", "x", "y", "z"),
                   5: ("id", "line", "sample", "x", "y"),
                   6: ("id", "line", "sample", "x", "y", "z")}
"""The columns of rows without a header, by their number, if the first column has ids."""

_NOTES_LEFT_OUT = ("has no column of ids", "its heights are unknown")
"""Words of notes that are not shown: the page gives ids itself, and takes heights from a DEM."""

_EXAMPLE = "id,role,line,sample,x,y,z"
_PASTED = "what was pasted"


def read_pasted(text: str, crs: str, size: tuple[int, int] | None,
                ) -> tuple[list[Record], list[str]]:
    """Return the points of a table that was pasted as records, and notes on how it was read.

    Columns are known by their names in a header, or else by their number if the first has ids.
    Points without an id have the id "". `crs` is that of the ground coordinates, `size` lines and
    samples of the image, if they are known. Raises TermselError in the words of the page for what
    `termsel run` would refuse, with row and column.
    """
    with private_folder() as folder, _collected_notes() as notes:
        path = folder / "pasted.csv"
        path.write_text(text, "utf-8", errors="replace")
        try:
            records = _records_of_table(path, crs, size)
        except TermselError as error:
            raise _error_for_page(error, path) from error
    kept = [note for note in notes if not any(words in note for words in _NOTES_LEFT_OUT)]
    return records, [note.replace(str(path), _PASTED) for note in kept]


def _records_of_table(path: Path, crs: str, size: tuple[int, int] | None) -> list[Record]:
    """Return the points of a file as records; see `read_pasted`.

    If the table has but one pair of coordinates, the records have `ground` or `image` alone, and
    None for the other, which is clicked on the page. Raises TermselError for what is no table of
    points, for a place outside the image of `size`, and for heights in another unit than the CRS's.
    """
    rows = read_cells(path, POINTS, {}).rows
    if not rows:
        raise TermselError("nothing was pasted")
    names = _columns_without_header(rows)
    if names:
        columns = {name: str(i) for i, name in enumerate(names, 1)}
    else:
        columns = {}
        named_columns = columns_by_meaning(rows[0], POINTS)
        names = tuple(name for name, indices in named_columns.items() if indices)
    if columns and "line" not in columns:
        return _ground_records(path, columns, names, crs)
    try:
        features = termsel.read(path, crs=crs, columns=columns or None)
    except TermselError as error:
        # The reader takes no tables with one pair of coordinates, but the page does.
        is_unknown = error.code == "format-unknown"
        if error.code == "ground-alone" or (is_unknown and {"x", "y"} <= set(names)):
            return _ground_records(path, columns, names, crs)
        if error.code == "image-alone" or (is_unknown and set(_IMAGE_COLUMNS) <= set(names)):
            return _image_records(path, names, size)
        raise
    if not len(features.points):
        raise TermselError("these are lines, not points", hint="Paste points alone.")
    # The CRS of the table may have heights in feet, and that of the session in metres.
    refuse_other_units(features.named_units, crs)
    require_inside(features, size, None)
    return _records_of_points(features.points, has_ids="id" in names, spaces=("image", "ground"))


def _columns_without_header(rows: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Return the names of the columns of rows without a header; () for other rows.

    Such rows have an id and numbers, as many as `_WITHOUT_HEADER` knows. The first column has ids
    if one of them is no number, or if there are three columns and all are whole numbers.
    """
    width = len(rows[0])
    if width not in _WITHOUT_HEADER or not all(map(_is_coordinate, rows[0][1:])):
        return ()
    first = [row[0].strip() for row in rows if row]
    # In three columns, whole numbers before x and y number the points. In more columns, they may be
    # lines of the image.
    first_has_ids = (not all(map(_is_coordinate, first))
                     or (width == 3 and all(map(str.isdigit, first))))
    return _WITHOUT_HEADER[width] if first_has_ids else ()


def _is_coordinate(cell: str) -> bool:
    """Return whether a cell is a number, with either decimal sign."""
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _ground_records(path: Path, columns: Mapping[str, str], names: Sequence[str], crs: str,
                    ) -> list[Record]:
    """Return the points of a table of ground coordinates alone, as records without `image`.

    Raises TermselError if the table states another CRS or unit than that of the session, or has
    coordinates that are none of the CRS.
    """
    coordinates = [name for name in _GROUND_COLUMNS if name in names]
    table = read_table(path, _aliases(coordinates), columns=_columns_option(columns))
    if table.crs not in ("", crs):
        raise TermselError(f"the table is in {table.crs}, and this session in {crs}",
                           hint=f"Transform the points to {crs}.")
    ground = np.full((len(table.lines), 3), np.nan)
    ground[:, :len(coordinates)] = table.stack(*coordinates)
    points = table.points(np.zeros((len(ground), 2)), ground, None, table.roles())
    refuse_other_units(table.named_units(), crs)
    check_ground(FeatureSet(points, crs=crs))
    return _records_of_points(points, has_ids="id" in names, spaces=("ground",))


def _image_records(path: Path, names: Sequence[str], size: tuple[int, int] | None) -> list[Record]:
    """Return the points of a table of lines and samples alone, as records without `ground`.

    Raises TermselError for points outside an image of this size.
    """
    table = read_table(path, _aliases(_IMAGE_COLUMNS))
    image = table.stack(*_IMAGE_COLUMNS)
    # `Points` refuses equal ground coordinates, so they get different ones, which are dropped.
    ground = np.zeros((len(image), 3))
    ground[:, 0] = np.arange(len(image))
    points = table.points(image, ground, None, table.roles())
    require_inside(FeatureSet(points, crs="local"), size, None)
    return _records_of_points(points, has_ids="id" in names, spaces=("image",))


def _aliases(coordinates: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return the names that columns may have, by meaning: ids, roles and these coordinates."""
    return {name: POINTS[name] for name in ("id", "role", "enabled", *coordinates)}


def _columns_option(columns: Mapping[str, str]) -> str:
    """Return columns by meaning as the text that the option --columns takes."""
    return ",".join(f"{name}={column}" for name, column in columns.items())


def _records_of_points(points: Points, *, has_ids: bool, spaces: Sequence[str]) -> list[Record]:
    """Return points as records with places in some of the spaces "image" and "ground".

    Without `has_ids`, the reader made up the ids, and the records have "" instead. An unknown
    height is None. Raises TermselError for points that are no valid records.
    """
    records = []
    for name, role, image, ground in zip(points.ids, points.roles, points.image.tolist(),
                                         points.ground.tolist(), strict=True):
        # JSON has no NaN: an unknown height is None.
        known_ground = [None if np.isnan(z) else z for z in ground]
        record = checked_record({
            "id": name, "kind": "point", "role": role,
            "image": image if "image" in spaces else None,
            "ground": known_ground if "ground" in spaces else None})
        # Ids that the reader made up may be those of other points.
        records.append(record if has_ids else {**record, "id": ""})
    return records


def _error_for_page(error: TermselError, path: Path) -> TermselError:
    """Return an error in the words of the page, which has rows instead of files and options.

    `path` is the file that the pasted rows were written to, which the words do not name.
    """
    place = ", ".join(f"{word} {value}" for word, value in (
        ("row", error.line), ("column", error.column)) if value)
    hint = error.hint or ""
    if error.guesses:
        readings = [f"{_header_of(guess)} (the first point would be {first})"
                    for guess, first in zip(error.guesses, error.first_points, strict=True)]
        hint = f"Put a line of names above the rows, if this is right: {'; or '.join(readings)}."
    elif error.code in ("format-unknown", "header-missing"):
        error.what = "the rows have no header that names their columns"
        hint = (f"Put one above them, such as {_EXAMPLE}. Rows without one begin with an id: "
                "A1, 512300.5, 5339520.1.")
    # Hints on options and commands are of no use on the page.
    elif "--" in hint or "termsel " in hint or hint.startswith("Give the image"):
        hint = "Correct the table, and paste it again."
    what = f"{error.what} ({place})" if place else error.what
    return TermselError(what.replace(str(path), _PASTED), hint=hint.replace(str(path), _PASTED),
                        ids=error.ids)


def _header_of(guess: str) -> str:
    """Return the header that a table needs for a value of --columns, such as line,sample,x,y.

    If the value names columns rather than counting them, it is which name to write for which.
    """
    column_of = dict(pair.split("=", 1) for pair in guess.split(","))
    if not all(map(str.isdigit, column_of.values())):
        return ", ".join(f"{name} for {column}" for name, column in column_of.items())
    name_of = {int(column): name for name, column in column_of.items()}
    # Columns without a meaning need names as well.
    return ",".join(name_of.get(i, f"column{i}") for i in range(1, max(name_of) + 1))


@contextmanager
def _collected_notes() -> Iterator[list[str]]:
    """Yield a list that gets the messages which termsel logs in this thread during the block."""
    notes: list[str] = []
    collector = _MessageCollector(notes)
    logger = logging.getLogger("termsel")
    logger.addHandler(collector)
    try:
        yield notes
    finally:
        logger.removeHandler(collector)


class _MessageCollector(logging.Handler):
    """Appends the messages of the thread that makes it to a list."""

    def __init__(self, notes: list[str]) -> None:
        super().__init__(logging.INFO)
        self._notes = notes
        self._thread = get_ident()

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a message, unless another thread logs it."""
        if record.thread == self._thread:
            self._notes.append(record.getMessage())
