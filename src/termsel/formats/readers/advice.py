"""What --columns could say of a table whose header does not show which column is which."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path

import numpy as np

from termsel.core.errors import TermselError
from termsel.core.files.endings import RASTERS, SPREADSHEETS
from termsel.data.coordinates.crs import short_crs_name
from termsel.data.features import FloatArray
from termsel.data.tables.columns import (
    COMMA,
    POINT,
    POINTS,
    Aliases,
    BadCell,
    columns_by_meaning,
    decimal_signs,
    find_declared_columns,
    fold_name,
    parse_columns,
    read_numbers,
)
from termsel.formats.base import LARGEST_IMAGE, read_head
from termsel.formats.readers.cells import WIDEST, BadText, counts_columns, read_cells

EXPECTED = ("Give a table headed id,role,line,sample,x,y,z, or another format of "
            "termsel list readers.")
"""What a file of points should be."""

TO_MEASURE = ("termsel app IMAGE --map FILE shows such points as a layer, such as a GeoPackage, to "
              "measure them; with a result, termsel project DIR --points FILE computes them.")
"""How places in the image of points on the ground are found."""

_OF_METASHAPE = ("Metashape writes those of its markers with File > Export > Export Markers as "
                 "XML: give that file instead.")
"""Where the positions in the images are that a table of Metashape's reference pane lacks."""

MOST_GUESSES = 2
"""Readings of a table that a message shows."""

_ROWS = 200
_BELONGS = 0.9
"""Share of a column's variance that ground explains of an image, or an image of its ground."""

_REQUIRED = {"line", "sample", "x", "y"}
_DECLARE = " Declare the columns: --columns"
_SHEETS = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")
"""First bytes of .xlsx and .ods, and of .xls."""
_HIGHEST = 30_000.0
"""Height of the highest ground, in feet."""

_SMALL = 9.0
"""Numbers below this may be residuals or scores as well as heights."""

_SCORES = frozenset((
    "score", "scores", "confidence", "conf", "mconf", "ncc", "cc", "corr", "correlation",
    "distance", "dist", "quality", "weight", "prob", "probability", "rms", "rmse", "residual",
    "residuals", "resid", "error", "err", "similarity", "ssim"))
"""Names of columns that say how good a match or a point is."""
_NAMES_OF_SAMPLE = frozenset(("x", "col", "column", "cols"))
_DOWN = frozenset(("y", "row", "rows"))
"""Words in names of columns that say along which axis they run."""

_IMAGE_FILE = re.compile(r".+\.(jpe?g|tiff?|png|dng|jp2|bmp|arw|cr2|nef)", re.IGNORECASE)

def with_advice(error: TermselError, header: Sequence[str], rows: Sequence[Sequence[str]],
                known_columns: Mapping[str, int], aliases: Aliases,
                fixed: Collection[int] = (), *, names_may_mislead: bool = False) -> TermselError:
    """Return an error with the text of --columns that declares all columns, as far as it is known.

    `known_columns` is the column of each meaning that is known; the others are guessed, of points
    only, in all ways that fit. Nobody can declare the columns `fixed`, such as those of a geometry.
    Where names may mislead, as e does among columns a to e, and no columns look like ground
    coordinates with them, all columns are guessed.
    """
    # Readings are of points: a table of lines has too many ways.
    if "line" not in aliases or "x" not in aliases:
        return error
    scores = [i for i, name in enumerate(header) if fold_name(name) in _SCORES]
    readings = []
    for meanings in _ways_to_take_names(header, known_columns):
        for reading in _possible_readings(rows, len(header), meanings, scores):
            readings.append({**reading, **meanings})
    readings = _by_axes_in_names(readings, header)
    numbers = _number_columns([row for row in rows[:_ROWS] if len(row) == len(header)])
    in_image = [reading for reading in readings if _is_in_an_image(numbers, reading)]
    complete = [reading for reading in in_image if reading.keys() >= _REQUIRED]
    if names_may_mislead and not any(_shows_ground(numbers, reading) for reading in complete):
        by_numbers = [reading for reading in _possible_readings(rows, len(header), {}, scores)
                      if _is_in_an_image(numbers, reading) and _shows_ground(numbers, reading)]
        if by_numbers:
            complete = by_numbers
            known_columns = {}
    # A column that is known by its name may hold a cell that is no number.
    numeric = [reading for reading in complete
               if all(reading[name] in numbers for name in _REQUIRED)]
    if numeric and all(_counts_upwards(numbers[reading["line"]]) for reading in numeric):
        error.options["--set"] = "image_origin=y-up"
        error.hint = f"{error.hint or ''} Its lines count upwards: --set image_origin=y-up."
    elif numeric and (upwards := _read_upwards(numeric[0], known_columns)):
        columns = _columns_option(upwards, header, aliases, fixed)
        error.hint = (f"{error.hint or ''} If its lines count upwards from the lower edge: "
                      f"--columns {columns} --set image_origin=bottom-left --image FILE.")
    if any(_are_two_images(numbers, reading) for reading in numeric):
        error.hint = (f"{error.hint or ''} If both pairs are pixels, the second those of a "
                      "georeferenced image, head them x1,y1,x2,y2.")
    return _with_readings(error, header, rows, complete or in_image or [dict(known_columns)],
                          known_columns, aliases, fixed)


def _by_axes_in_names(readings: Sequence[dict[str, int]], header: Sequence[str],
                      ) -> list[dict[str, int]]:
    """Return readings in which pairs run as their names say, such as kp_x and kp_y; each once.

    Samples and x run across an image, lines and y down or up.
    """
    axes = [_axis_in_name(name) for name in header]
    result: list[dict[str, int]] = []
    for reading in readings:
        changed = dict(reading)
        for across, down in (("sample", "line"), ("x", "y")):
            if {across, down} <= reading.keys() and (
                    axes[reading[across]], axes[reading[down]]) == ("down", "across"):
                changed |= {across: reading[down], down: reading[across]}
        if changed not in result:
            result.append(changed)
    return result


def _ways_to_take_names(header: Sequence[str], known_columns: Mapping[str, int],
                        ) -> list[dict[str, int]]:
    """Return the columns that are known by their names, and with x and y as those of the image.

    Tables of viewers call columns and rows x and y; so these are on the ground only for sure where
    columns of the image have names of their own.
    """
    ways = [dict(known_columns)]
    are_plain = all(axis in known_columns and header[known_columns[axis]].strip().casefold() == axis
                    for axis in ("x", "y"))
    if are_plain and not {"line", "sample"} & known_columns.keys():
        others = {name: i for name, i in known_columns.items() if name not in ("x", "y")}
        ways.append({**others, "sample": known_columns["x"], "line": known_columns["y"]})
    return ways


def _is_in_an_image(numbers: Mapping[int, FloatArray], reading: Mapping[str, int]) -> bool:
    """Return whether the columns of the image hold no numbers that are beyond any image."""
    columns = {name: numbers[reading[name]] for name in ("line", "sample")
               if reading.get(name) in numbers}
    # Lines alone may count upwards, and then are negative.
    if "sample" in columns and np.nanmax(columns["sample"]) < 0.0:
        return False
    return all(np.nanmax(np.abs(column)) <= LARGEST_IMAGE for column in columns.values())


def _shows_ground(numbers: Mapping[int, FloatArray], reading: Mapping[str, int]) -> bool:
    """Return whether a reading has all coordinates, and those of the ground look like such."""
    if not all(reading.get(name) in numbers for name in _REQUIRED):
        return False
    heights = numbers.get(reading.get("z", -1), np.zeros(1))
    return (_is_ground(numbers, (reading["x"], reading["y"]))
            and bool(np.nanmax(np.abs(heights)) <= _HIGHEST))


def _counts_upwards(lines: FloatArray) -> bool:
    """Return whether lines are at most 0, as those of programs whose y points upwards."""
    return bool(np.nanmax(lines) <= 0.0 and np.nanmin(lines) < 0.0)


def _read_upwards(reading: Mapping[str, int], known_columns: Mapping[str, int],
                  ) -> dict[str, int] | None:
    """Return a guess with the usual order, sample before line, where it puts the line first.

    Image and ground are then no mirror images only if lines count downwards. None for others.
    """
    guessed = _REQUIRED - known_columns.keys()
    if guessed < _REQUIRED or reading["line"] > reading["sample"] or reading["x"] > reading["y"]:
        return None
    return {**reading, "line": reading["sample"], "sample": reading["line"]}


def _are_two_images(numbers: Mapping[int, FloatArray], reading: Mapping[str, int]) -> bool:
    """Return whether the ground coordinates of a reading may be pixels, too."""
    pair = reading["x"], reading["y"]
    return not _is_ground(numbers, pair) and all(bool(np.nanmin(numbers[i]) >= 0.0) for i in pair)


def keep_readable_guesses(error: TermselError,
                          can_be_read: Callable[[str], bool]) -> TermselError:
    """Return an error of the first guesses with which the file can be read.

    Where it can with none, the first ones stay, as something else may be wrong.
    """
    everything = range(len(error.guesses))
    readable = [i for i in everything if can_be_read(error.guesses[i])] or list(everything)
    # More than these nobody compares; all columns are declared by hand.
    readable = readable[:MOST_GUESSES]
    if 0 < len(readable) < len(error.guesses):
        before = (error.hint or "").partition(_DECLARE)[0]
        _guess(error, before, [error.guesses[i] for i in readable],
               [error.first_points[i] for i in readable])
    return error


def with_both_readings(error: TermselError, header: Sequence[str], rows: Sequence[Sequence[str]],
                       named: Mapping[str, Sequence[int]], aliases: Aliases,
                       fixed: Collection[int] = ()) -> TermselError:
    """Return an error of a table with two columns of one meaning, with --columns for either.

    `named` are the columns of each meaning by their names. What stands first goes with what stands
    first, as x with y and lon with lat.
    """
    if not {"line", "sample", "x", "y"} <= {meaning for meaning in named if named[meaning]}:
        first = {meaning: columns[0] for meaning, columns in named.items() if columns}
        return with_advice(error, header, rows, first, aliases, fixed)
    readings = [{meaning: columns[min(k, len(columns) - 1)]
                 for meaning, columns in named.items() if columns} for k in (0, 1)]
    return _with_readings(error, header, rows, readings, {}, aliases, fixed)


def _with_readings(error: TermselError, header: Sequence[str], rows: Sequence[Sequence[str]],
                   readings: Sequence[dict[str, int]], known_columns: Mapping[str, int],
                   aliases: Aliases, fixed: Collection[int]) -> TermselError:
    """Return an error with readings as texts of --columns; what is not known are guesses.

    A reading says which column has which meaning. Where all readings share columns that are named,
    they are certain; others are guesses, shown with the first point as each takes it, as only the
    user knows. Where too few columns are left, the table lacks the image coordinates, and the error
    says so.
    """
    # One column has one meaning.
    single = [reading for reading in readings
              if len(set(reading.values())) == len(reading.values())]
    if not single:
        return error
    readings = single
    texts = [_columns_option(reading, header, aliases, fixed) for reading in readings]
    before = error.hint or ""
    free = len(header) - len(set(readings[0].values()) | set(fixed))
    if texts[0].count("=?") > free:  # no column is left to be declared
        if texts[0].count("=?") == 2 and "line=?,sample=?" in texts[0]:
            error.what = ("this table has ground coordinates alone: columns for line and sample "
                          "are missing")
            error.code = "ground-alone"
            error.column = None
            error.hint = f"Add the image coordinates of each point. {_where_measured(header)}"
        return error
    # No reading has all columns; a point read so could not be shown.
    if "=?" in texts[0]:
        error.options["--columns"] = texts[0]
        error.hint = f"{before}{_DECLARE} {texts[0]!r}. Put the column for each ?."
    elif readings[0].keys() - known_columns:
        first = next((row for row in rows if len(row) == len(header)), ())
        _guess(error, before, texts, [_read_so(first, reading) for reading in readings])
    else:
        error.options["--columns"] = texts[0]
        error.hint = f"{before}{_DECLARE} {texts[0]!r}."
    return error


def _where_measured(header: Sequence[str]) -> str:
    """Return where the places in the image are found that a table lacks."""
    # Metashape alone heads its table X/Longitude or X/Easting.
    if any(name.strip().lower().startswith("x/") for name in header):
        return _OF_METASHAPE
    return TO_MEASURE


def _guess(error: TermselError, before: str, guesses: list[str], first_points: list[str]) -> None:
    """Put guesses into an error, after the hint that it had before."""
    error.guesses = guesses
    error.first_points = first_points
    error.options["--columns"] = guesses[0]
    error.hint = (f"{before}{_DECLARE} {guesses[0]!r}. This mapping is a guess; check it. The "
                  f"first point would be {'; or '.join(first_points)}.")


def _columns_option(columns: Mapping[str, int], header: Sequence[str], aliases: Aliases,
                    fixed: Collection[int]) -> str:
    """Return the text of --columns for a reading, with ? for a required column not known."""
    names = [name.strip() for name in header]
    folded_names = [name.casefold() for name in names]
    pairs = []
    for meaning in aliases:
        i = columns.get(meaning)
        if i is not None and i not in fixed:
            # A number where a name would be ambiguous, or end the list.
            is_unambiguous = (folded_names.count(folded_names[i]) == 1 and names[i]
                              and "," not in names[i] and not names[i].isdecimal())
            pairs.append(f"{meaning}={names[i] if is_unambiguous else i + 1}")
        elif i is None and meaning in ("line", "sample", "x", "y"):
            pairs.append(f"{meaning}=?")
    return ",".join(pairs)


def _read_so(row: Sequence[str], columns: Mapping[str, int]) -> str:
    """Return a row as a reading takes it, in words."""
    return ", ".join(f"{meaning} {row[columns[meaning]].strip()}"
                     for meaning in ("line", "sample", "x", "y", "z")
                     if meaning in columns and columns[meaning] < len(row))


def unknown_table_error(path: Path, expected: str, columns: str) -> TermselError | None:
    """Return the error for a file without a reader, None unless it is a table of numbers.

    `expected` are the formats that could be given, `columns` what the option says of columns
    already. A table without a header, with one in unknown words, or with one pair of coordinates
    alone is told apart here, so that the user gets a text of --columns to type and not a list of
    formats.
    """
    stated = parse_columns(columns)
    try:
        cells = read_cells(path, POINTS, stated)
    except TermselError as error:
        is_table = isinstance(error, BadText) or path.suffix.lower() in SPREADSHEETS
        return error if is_table else None
    rows = [row for row in cells.rows[:_ROWS] if len(row) == len(cells.rows[-1]) <= WIDEST
            and not counts_columns(row)]
    values = _number_columns(rows[1:])
    if len(rows) >= 2 and rows[0] and (
            missing := _missing_pair_error(path, rows[0], list(values), expected)):
        return missing
    if len(rows) < 3 or len(values) < 4:
        return None if path.suffix.lower() not in SPREADSHEETS else TermselError(
            "no visible sheet has a table of points"
            if read_head(path, expected)[:4] in _SHEETS else
            "this is text, not a spreadsheet, and has no table of points", file=path,
            hint=expected)
    # A header has no numbers above columns of numbers.
    bare = any(i in _number_columns(rows[:1]) for i in values)
    header = [str(i + 1) for i in range(len(rows[0]))] if bare else rows[0]
    by_name = {meaning: columns[0]
               for meaning, columns in columns_by_meaning(header, POINTS).items() if columns}
    if bare and all(map(_is_mark_of_opendronemap, rows)):
        images = list(dict.fromkeys(row[5].strip() for row in rows))
        choosing = ""
        if len(images) > 1:
            choosing = (f" Then choose one of its {len(images)} images, such as --set "
                        f"image_name={images[0]}.")
        return TermselError(
            "these look like the rows of OpenDroneMap's gcp_list.txt (x y z column row image), "
            "without the CRS of x and y that its first line has", file=path, line=1,
            hint=f"Write the CRS as the first line, such as EPSG:32639.{choosing}")
    if bare:
        message = "this table has no header that names its columns"
    else:
        names_in_words = ", ".join(map(str.strip, header))
        message = f"the header names too few columns that are known: {names_in_words}"
    unnamed = TermselError(message, file=path, hint=expected,
                           code="header-missing" if bare else "")
    # Some programs write the CRS into the first line, without a #.
    if crs := _crs_of(cells.comments):
        unnamed.what += f", and its first line is the CRS {crs}"
    return with_advice(unnamed, header, rows if bare else rows[1:],
                       {**by_name, **find_declared_columns(header, stated)}, POINTS,
                       names_may_mislead=not stated)


def _is_mark_of_opendronemap(row: Sequence[str]) -> bool:
    """Return whether a row has five numbers and the name of an image file."""
    numbers = _number_columns([row])
    return (len(row) > 5 and numbers.keys() >= set(range(5))
            and _IMAGE_FILE.fullmatch(row[5].strip()) is not None)


def _missing_pair_error(path: Path, header: Sequence[str], numeric: Sequence[int],
                        expected: str) -> TermselError | None:
    """Return the error for a table that has image coordinates or ground coordinates alone.

    None for other tables, and where two further columns hold numbers: these may be the other pair
    under names not known.
    """
    by_name = columns_by_meaning(header, POINTS)
    named = [meaning for meaning, columns in by_name.items() if set(columns) & set(numeric)]
    if len(numeric) - len(named) >= 2:
        return None
    pairs = {"image": ("line", "sample"), "ground": ("x", "y")}
    absent = {pair: [name for name in names if not by_name[name]] for pair, names in pairs.items()}
    for present, other in (("image", "ground"), ("ground", "image")):
        if not absent[present] and len(absent[other]) == 2:
            names = " and ".join(pairs[other])
            remedy = _where_measured(header) if other == "image" else expected
            return TermselError(
                f"this table has {present} coordinates alone: columns for {names} are missing. Its "
                f"columns are {', '.join(map(str.strip, header))}", file=path,
                code=f"{present}-alone",
                hint=f"Add the {other} coordinates of each point. {remedy}")
    return None


def _crs_of(comments: Mapping[int, str]) -> str:
    """Return the CRS in the comment that stands for the first line of a file, "" for none."""
    crs = comments.get(1, "").partition("# crs:")[2].strip()
    return short_crs_name(crs) if crs else ""


def _number_columns(rows: Sequence[Sequence[str]]) -> dict[int, FloatArray]:
    """Return the columns that hold numbers alone, (n,) each, by their index."""
    numbers: dict[int, FloatArray] = {}
    for i, cells in enumerate(zip(*rows, strict=True)):
        try:
            signs, _ = decimal_signs({"": cells})
            # Where the sign is open, either gives numbers in the same order, which is all that is
            # asked.
            sign = signs[""] or (POINT if POINT in "".join(cells) else COMMA)
            values = read_numbers(cells, sign, may_be_blank=True, angle="x")
        except BadCell:
            continue
        if not np.isnan(values).all():
            numbers[i] = values
    return numbers


def _axis_in_name(name: str) -> str:
    """Return whether a name says that its column runs across or down an image; "" if neither."""
    words = set(re.split(r"[\W_\d]+", name.casefold()))
    across = bool(words & _NAMES_OF_SAMPLE)
    down = bool(words & _DOWN)
    return "" if across == down else "across" if across else "down"


def _possible_readings(rows: Sequence[Sequence[str]], width: int, known_columns: Mapping[str, int],
                       scores: Collection[int] = ()) -> list[dict[str, int]]:
    """Return in which ways columns can be read whose meaning is not known, the likeliest first.

    Columns of `scores` have none. Flags and columns that hold one number are no coordinates; a
    column that counts the points, or of text, is their id. Of the others, pairs lie next to each
    other: sample and line, x and y.
    """
    rows = [row for row in rows[:_ROWS] if len(row) == width]
    numbers = {i: column for i, column in _number_columns(rows).items()
               if i not in known_columns.values() and i not in scores}
    extra = _id_and_flags(rows, numbers, {*known_columns.values(), *scores},
                          has_id="id" in known_columns, has_flag="enabled" in known_columns)
    # A constant column is no coordinate.
    taken_columns = extra.values()
    values = _without_scores({i: column for i, column in numbers.items() if i not in taken_columns
                              and np.nanmin(column) < np.nanmax(column)})
    coordinates = known_columns.keys() & {"line", "sample", "x", "y", "z"}
    if not coordinates and len(values) in (4, 5):
        of_pairs = _readings_of_pairs(values)
        # A fifth column of small numbers may be residuals as well as heights.
        without = [{name: i for name, i in reading.items() if name != "z"} for reading in of_pairs
                   if "z" in reading and np.nanmax(np.abs(values[reading["z"]])) < _SMALL]
        return [extra | reading for reading in [*of_pairs, *without]]
    of_pair = _readings_of_one_pair(_number_columns(rows), values, known_columns)
    if of_pair:
        return [extra | reading for reading in of_pair]
    missing = [name for name in ("x", "y", "z", "sample", "line") if name not in known_columns]
    for names in (missing, [name for name in missing if name != "z"]):
        # More columns than meanings: any assignment would be a guess at random.
        if names and len(values) == len(names):
            return [extra | reading for reading in _readings_with_missing(names, list(values))]
    return [extra]


def _without_scores(values: dict[int, FloatArray]) -> dict[int, FloatArray]:
    """Return columns without scores from 0 to 1, residuals and the like.

    Where more than four columns are left, one that the others do not explain and that is within 0
    and 1, as no heights are, goes; where more than five are left, each that they do not explain.
    """
    if len(values) <= len(_REQUIRED):
        return values
    explained = {i for i in values if _share_explained(values, i) > _BELONGS}
    no_scores = {i: column for i, column in values.items() if i in explained
                 or np.nanmin(column) < 0.0 or np.nanmax(column) > 1.0}
    if len(no_scores) > len(_REQUIRED) + 1 and len(explained) == len(_REQUIRED):
        return {i: values[i] for i in explained}
    return no_scores if len(no_scores) >= len(_REQUIRED) else values


def _id_and_flags(rows: Sequence[Sequence[str]], numbers: Mapping[int, FloatArray],
                  others: Collection[int], *, has_id: bool, has_flag: bool) -> dict[str, int]:
    """Return the column of ids, and of the flags 0 and 1 of points that are in use.

    A column of zeros alone is none: it would leave no point.
    """
    extra: dict[str, int] = {}
    texts = []
    for i, cells in enumerate(zip(*rows, strict=True)):
        # The same text twice is no id, nor is the name of an image.
        if (i not in numbers and i not in others and len(set(cells)) == len(cells)
                and not any(Path(cell).suffix.lower() in RASTERS for cell in cells)):
            texts.append(i)
    # Consecutive numbers in the first column are ids.
    first = next(iter(numbers), None)
    counts = first is not None and len(numbers) > 4 and np.array_equal(
        numbers[first] - numbers[first][0], np.arange(len(numbers[first])))
    if not has_id and counts and first is not None:
        extra["id"] = first
    elif not has_id and texts:
        extra["id"] = texts[0]
    flags = [i for i, column in numbers.items()
             if np.isin(column, (0.0, 1.0)).all() and column.any()]
    if flags and not has_flag:
        extra["enabled"] = flags[-1]
    return extra


def _readings_of_one_pair(numbers: Mapping[int, FloatArray], values: Mapping[int, FloatArray],
                          found: Mapping[str, int]) -> list[dict[str, int]]:
    """Return readings where the pair of the ground is known and that of the image not, or reverse.

    The other pair is what the known pair explains; none where fewer or more columns are explained.
    What remains alone next to it are the heights, if those are not known.
    """
    image, ground = ("sample", "line"), ("x", "y")
    known, missing = (ground, image) if found.keys() >= set(ground) else (image, ground)
    if not found.keys() >= set(known) or found.keys() & set(missing) or any(
            found[name] not in numbers for name in known):
        return []
    explained = [i for i in values if _share_explained(
        {found[name]: numbers[found[name]] for name in known} | {i: values[i]}, i) > _BELONGS]
    if len(explained) != 2:
        return []
    pairs = {known: [found[name] for name in known], missing: explained}
    upright = _upright_columns(numbers, pairs[image], pairs[ground])
    names = missing if upright == image else missing[::-1]
    unexplained = [i for i in values if i not in explained]
    heights = {"z": unexplained[0]} if len(unexplained) == 1 and "z" not in found else {}
    return [dict(zip(order, explained, strict=True)) | heights for order in (names, names[::-1])]


def _readings_with_missing(missing: Sequence[str], free: Sequence[int]) -> list[dict[str, int]]:
    """Return readings of columns in the order x, y, z, sample, line, and with a pair exchanged."""
    # In the order in which most tables have them.
    usual = dict(zip(missing, free, strict=True))
    readings = [usual]
    for first, second in (("sample", "line"), ("x", "y")):
        if first in usual and second in usual:
            readings.append({**usual, first: usual[second], second: usual[first]})
    return readings


def _readings_of_pairs(values: Mapping[int, FloatArray]) -> list[dict[str, int]]:
    """Return readings of four or five columns: a pair of the image, a pair of the ground, heights.

    Seen from above, an image is no mirror image of the ground. With x to the east and y to the
    north, sample to the right and line downwards, the determinant of the affine map from (x, y) to
    (sample, line) is negative. So the order within one pair decides that within the other.
    """
    free = list(values)
    z: list[int] = []
    if len(free) == 5:
        # Image and ground determine each other, a height is nearly free of both. Pairs lie next
        # to each other, so that it is the first, the middle or the last.
        low = [i for i in free[::2] if np.nanmax(np.abs(values[i])) <= _HIGHEST]
        z = [min(low or free[::2], key=lambda i: _share_explained(values, i))]
    pairs = [i for i in free if i not in z]
    # Columns of a pair are next to each other in every format that is known.
    image_first = pairs[:2], [*pairs[2:], *z]
    ground_first = pairs[2:], [*pairs[:2], *z]
    first_is_ground = _is_ground(values, pairs[:2])
    last_is_ground = _is_ground(values, pairs[2:])
    if first_is_ground != last_is_ground:
        divisions = [image_first if last_is_ground else ground_first]
    elif z == free[2:3]:
        divisions = [ground_first]
    elif not z:
        # Pixels of two images, or a place whose coordinates are as small as pixels.
        divisions = [image_first, ground_first]
    elif z == free[4:]:
        divisions = [image_first]
    else:
        divisions = [ground_first, image_first]
    readings = []
    for image, ground in divisions:
        names = _upright_columns(values, image, ground)
        mirrored = ("x", "y", "z"), ("y", "x", "z")
        for axes, order in zip(mirrored, (names, names[::-1]), strict=True):
            reading = dict(zip(axes, ground, strict=False)) | dict(zip(order, image, strict=True))
            # No latitude exceeds 90 degrees.
            if (np.nanmax(np.abs(values[reading["y"]])) <= 90.0
                    or not _are_degrees(values, ground[:2])):
                readings.append(reading)
    # Sample before line and x before y is how most programs write them.
    return sorted(readings, key=lambda reading: reading["x"] > reading["y"])


def _upright_columns(values: Mapping[int, FloatArray], image: Sequence[int],
                     ground: Sequence[int]) -> tuple[str, str]:
    """Return the names of the columns of the image for which x, y is no mirror image of it."""
    table = [values[i] for i in (*ground[:2], *image)]
    if any(np.isnan(column).any() for column in table):
        return "sample", "line"
    # The affine map (x, y) -> (first, second), by least squares: its determinant is negative for a
    # pair sample, line.
    # Numbers without a positive one count the other way, as y upwards from the upper edge.
    x, y, first, second = [*table[:2], *(-column if column.max() <= 0.0 else column
                                         for column in table[2:])]
    design = np.column_stack([x - x.mean(), y - y.mean()])
    slopes = np.linalg.lstsq(design, np.column_stack([first, second]) - [
        first.mean(), second.mean()], rcond=None)[0]
    return ("line", "sample") if np.linalg.det(slopes) > 0.0 else ("sample", "line")


def _are_degrees(values: Mapping[int, FloatArray], pair: Sequence[int]) -> bool:
    """Return whether two columns can be longitude and latitude, in some order."""
    sizes = sorted(float(np.nanmax(np.abs(values[i]))) for i in pair)
    # Where both are below 90, their order stays open.
    return sizes[0] <= 90.0 < sizes[1] <= 180.0


def _is_ground(values: Mapping[int, FloatArray], pair: Sequence[int]) -> bool:
    """Return whether two columns look like degrees within a place, or like metres of a map."""
    size = max(np.nanmax(np.abs(values[i])) for i in pair)
    # Map coordinates are beyond any image; degrees vary by less than an image does.
    return bool(size > 1e5 or (size <= 180 and max(np.ptp(values[i]) for i in pair) < 10))


def _share_explained(values: Mapping[int, FloatArray], i: int) -> float:
    """Return the share of a column's variance that a linear function of the others explains."""
    table = np.column_stack([column for j, column in values.items() if j != i])
    complete = ~np.isnan(np.column_stack([table, values[i]])).any(axis=1)
    # A function of as many coefficients as there are rows explains anything.
    if complete.sum() <= table.shape[1] + 1:
        return 1.0
    y = values[i][complete] - values[i][complete].mean()
    a = table[complete] - table[complete].mean(axis=0)
    # Columns of degrees and of metres side by side would be near singular.
    a = a / np.maximum(np.abs(a).max(axis=0), 1e-300)
    residual = y - a @ np.linalg.lstsq(a, y, rcond=None)[0]
    return float(1 - residual @ residual / max(y @ y, 1e-300))
