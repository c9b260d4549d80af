"""What --columns could say of a table whose header does not show which column is which."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import product
from pathlib import Path

import numpy as np

from termsel.core.errors import TermselError
from termsel.core.files.endings import RASTERS, SPREADSHEETS
from termsel.core.isolation.parts import install_hint
from termsel.data.coordinates.crs import short_crs_name
from termsel.data.features import FloatArray
from termsel.data.tables.columns import (
    COMMA,
    COORDINATES,
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
from termsel.formats.encodings import BadText
from termsel.formats.readers.cells import WIDEST, counts_columns, read_cells

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
"""Rows of a table that are looked at: its columns show by then."""
_BELONGS = 0.9
"""Share of a column's variance that ground explains of an image, or an image of its ground."""

_REQUIRED = {"line", "sample", "x", "y"}
_DECLARE = " Declare the columns: --columns"
_SHEETS = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")
"""First bytes of .xlsx and .ods, and of .xls."""
_HIGHEST = 30_000.0
"""Height of the highest ground, in feet."""

_BEYOND_IMAGES = 1e5
"""Numbers above this are map coordinates: few images are as large."""
_WIDEST_SCENE = 10.0
"""Degrees that a scene spans less than; an image spans more pixels."""

_UNLIKE_SPANS = 1e3
"""Ratio of what two columns span that x and y of one scene do not reach."""

_FEWEST_OF_FLAGS = 2
"""Points of which no column that is named as a coordinate is taken for flags."""

_SMALL = 9.0
"""Numbers below this may be residuals or scores as well as heights."""

_X_AND_Y_DECLARED = re.compile(r"x=([^,]*),y=([^,]*)")
_X_AND_Y_SHOWN = re.compile(r"\bx ([^;]*), y ([^,;]*)")
"""Those of a guess, and of the point that it shows."""

_TINY = 1e-300
"""What takes the place of a zero that is divided by."""

_SCORES = frozenset((
    "score", "scores", "confidence", "conf", "mconf", "ncc", "cc", "corr", "correlation",
    "distance", "dist", "quality", "weight", "prob", "probability", "rms", "rmse", "residual",
    "residuals", "resid", "error", "err", "similarity", "ssim", "dx", "dy", "gsd"))
"""Names of columns that say how good a match or a point is."""
_NO_COORDINATE = re.compile(
    r"(n|no|nr|num|number|count|anzahl)[_ .](of[_ ])?[^\W\d]{3,}|(fid|oid|ogc_fid|objectid|count|"
    r"date|datum|fecha|data|day|time|timestamp|year|jahr|año|ano|epoch|дата|日期|日付)",
    re.IGNORECASE)
"""Names of columns that count or date: n_images, no of rays, fid, date."""
_WORDS_ACROSS = frozenset(("x", "col", "column", "cols", "列", "横"))
_WORDS_DOWN = frozenset(("y", "row", "rows", "行", "纵"))
"""Words in names of columns that say along which axis they run."""

_BETWEEN_WORDS = re.compile(r"[\W_\d]+|(?<=[\u2e80-\u9fff])|(?=[\u2e80-\u9fff])")
"""What separates words: signs, and the edges of a Chinese character, which is one by itself."""

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
    scores = [i for i, name in enumerate(header)
              if fold_name(name) in _SCORES or _NO_COORDINATE.fullmatch(name.strip())]
    numbers = _number_columns([row for row in rows[:_ROWS] if len(row) == len(header)])
    # Of one or two points a coordinate may well be 0 or 1.
    if len(rows) > _FEWEST_OF_FLAGS:
        known_columns = {
            meaning: i for meaning, i in known_columns.items()
            if meaning not in COORDINATES or i not in numbers or not _is_flag(numbers[i])}
    readings = []
    for meanings in _ways_to_take_names(header, known_columns):
        for reading in _possible_readings(rows, len(header), meanings, scores):
            readings.append({**reading, **meanings})
    readings = _by_axes_in_names(readings, header)
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
    # Without a header these are links of ArcGIS, or points of GRASS, which count from corners.
    corner = "-corner" if error.code == "header-missing" else ""
    if numeric and all(_counts_upwards(numbers[reading["line"]]) for reading in numeric):
        origin = f"image_origin=y-up{corner}"
        error.options["--set"] = origin
        error.hint = f"{error.hint or ''} Its lines count upwards: --set {origin}."
    elif (numeric and (upwards := _read_upwards(numeric[0], known_columns))
          and _by_axes_in_names([upwards], header) == [upwards]):
        columns = _columns_option(upwards, header, aliases, fixed)
        error.hint = (f"{error.hint or ''} If its lines count upwards from the lower edge: "
                      f"--columns {columns} --set image_origin=bottom-left{corner} "
                      "--image FILE.")
    if any(_are_two_images(numbers, reading) for reading in numeric):
        error.hint = (f"{error.hint or ''} If both pairs are pixels, the second those of a "
                      "georeferenced image, head them x1,y1,x2,y2.")
    return _with_readings(error, header, rows, complete or in_image or [dict(known_columns)],
                          known_columns, aliases, fixed)


def _by_axes_in_names(readings: Sequence[dict[str, int]], header: Sequence[str],
                      ) -> list[dict[str, int]]:
    """Return readings whose pairs run as the names of their columns say, such as kp_x and kp_y.

    Samples and x run across an image, lines and y down or up: a pair that is read the other way
    round is exchanged. Readings that become alike are one.
    """
    axes = [_axis_in_name(name) for name in header]
    distinct: list[dict[str, int]] = []
    for reading in readings:
        corrected = dict(reading)
        for across, down in (("sample", "line"), ("x", "y")):
            if {across, down} <= reading.keys() and (
                    axes[reading[across]], axes[reading[down]]) == ("down", "across"):
                corrected |= {across: reading[down], down: reading[across]}
        if corrected not in distinct:
            distinct.append(corrected)
    return distinct


def _ways_to_take_names(header: Sequence[str], known_columns: Mapping[str, int],
                        ) -> list[dict[str, int]]:
    """Return the ways to take the columns that are known by name, each as columns by meaning.

    The first is what the names say. A second has x and y as sample and line, where they are called
    just so and no column is named for the image: tables of viewers call columns and rows x and y.
    """
    ways = [dict(known_columns)]
    are_bare_letters = all(
        axis in known_columns and header[known_columns[axis]].strip().casefold() == axis
        for axis in ("x", "y"))
    if are_bare_letters and not {"line", "sample"} & known_columns.keys():
        without_x_y = {name: i for name, i in known_columns.items() if name not in ("x", "y")}
        ways.append({**without_x_y, "sample": known_columns["x"], "line": known_columns["y"]})
    return ways


def _is_in_an_image(numbers: Mapping[int, FloatArray], reading: Mapping[str, int]) -> bool:
    """Return whether line and sample of a reading hold no numbers that are beyond any image.

    A column that the reading lacks, or that holds no numbers, does not count.
    """
    columns = {name: numbers[reading[name]] for name in ("line", "sample")
               if reading.get(name) in numbers}
    # Lines alone may count upwards, and then are negative.
    if "sample" in columns and np.nanmax(columns["sample"]) < 0.0:
        return False
    return all(np.nanmax(np.abs(column)) <= LARGEST_IMAGE for column in columns.values())


def _shows_ground(numbers: Mapping[int, FloatArray], reading: Mapping[str, int]) -> bool:
    """Return whether x, y and z of a reading look like ground.

    Returns False for a reading without numbers for line, sample, x and y.
    """
    if not all(reading.get(name) in numbers for name in _REQUIRED):
        return False
    heights = numbers.get(reading.get("z", -1), np.zeros(1))
    return (_is_ground(numbers, (reading["x"], reading["y"]))
            and bool(np.nanmax(np.abs(heights)) <= _HIGHEST))


def _counts_upwards(lines: FloatArray) -> bool:
    """Return whether no line is above 0 and some are below, as in programs whose y points upwards.
    """
    return bool(np.nanmax(lines) <= 0.0 and np.nanmin(lines) < 0.0)


def _read_upwards(reading: Mapping[str, int], known_columns: Mapping[str, int],
                  ) -> dict[str, int] | None:
    """Return a guess with line and sample exchanged, which holds if lines count upwards.

    Sample before line, as x before y, is the usual order of columns. A guess departs from it where
    the image would else mirror the ground; but it would not if lines counted upwards. Returns None
    for a guess in that usual order, or with y before x, and where any of the four columns is known.
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
                          fitness: Callable[[str], int]) -> TermselError:
    """Return an error with the first of its guesses by which the file can be read best.

    Where it can be read by none, but with x and y exchanged, the guesses are exchanged; else the
    first guesses stay, as something else may be wrong. `fitness` takes a text of --columns, and is
    larger the better the file can be read so.
    """
    earlier_hint = (error.hint or "").partition(_DECLARE)[0]
    values = [fitness(guess) for guess in error.guesses]
    if max(values) == 0:
        exchanged = [_X_AND_Y_DECLARED.sub(r"x=\2,y=\1", guess) for guess in error.guesses]
        values_of_exchanged = [fitness(guess) for guess in exchanged]
        if max(values_of_exchanged) > 0:
            values = values_of_exchanged
            points = [_X_AND_Y_SHOWN.sub(r"x \2, y \1", point) for point in error.first_points]
            _put_guesses(error, earlier_hint, exchanged, points)
    readable = [i for i, value in enumerate(values) if value == max(values)]
    # Nobody would compare more of them.
    readable = readable[:MOST_GUESSES]
    if 0 < len(readable) < len(error.guesses):
        _put_guesses(error, earlier_hint, [error.guesses[i] for i in readable],
                     [error.first_points[i] for i in readable])
    return error


def with_both_readings(error: TermselError, header: Sequence[str], rows: Sequence[Sequence[str]],
                       by_name: Mapping[str, Sequence[int]], aliases: Aliases,
                       fixed: Collection[int] = ()) -> TermselError:
    """Return an error of a table with two columns of one meaning, with --columns for either.

    `by_name` are the columns of each meaning by their names. The first of each meaning make one
    reading and the second another, as x goes with y and lon with lat; a meaning with one column has
    it in both. Where a coordinate has no column by name, the others are guessed beside the first.
    """
    columns_of = {meaning: columns for meaning, columns in by_name.items() if columns}
    if not columns_of.keys() >= _REQUIRED:
        first_columns = {meaning: columns[0] for meaning, columns in columns_of.items()}
        return with_advice(error, header, rows, first_columns, aliases, fixed)
    by_first = {meaning: columns[0] for meaning, columns in columns_of.items()}
    by_second = {meaning: columns[:2][-1] for meaning, columns in columns_of.items()}
    numbers = _number_columns([row for row in rows[:_ROWS] if len(row) == len(header)])
    pairs = _pairs_of_the_ground(numbers, columns_of["x"], columns_of["y"])
    readings = []
    for k, (x, y) in enumerate(pairs):
        readings.append({**(by_second if k else by_first), "x": x, "y": y})
    if len(pairs) == 1 and by_second != by_first:
        readings.append({**by_second, "x": pairs[0][0], "y": pairs[0][1]})
    distinct = [reading for k, reading in enumerate(readings) if reading not in readings[:k]]
    return _with_readings(error, header, rows, distinct, {}, aliases, fixed)


def _pairs_of_the_ground(numbers: Mapping[int, FloatArray], xs: Sequence[int],
                         ys: Sequence[int]) -> list[tuple[int, int]]:
    """Return the columns of x and of y that belong together, of several that have these names.

    x and y of one scene span about as much; degrees next to metres differ by five powers of ten. Of
    pairs that are alike the first of x goes with the first of y, and a column is in one pair as far
    as others are left.
    """
    pairs = sorted(product(xs, ys), key=lambda pair: xs.index(pair[0]) != ys.index(pair[1]))
    alike = [pair for pair in pairs if _span_alike(numbers, *pair)] or pairs
    chosen = [alike[0]]
    for pair in alike[1:]:
        if not {i for other in chosen for i in other} & set(pair):
            chosen.append(pair)
    # Two columns of x and one of y leave the choice between two pairs.
    return chosen if len(chosen) > 1 or min(len(xs), len(ys)) > 1 else alike


def _span_alike(numbers: Mapping[int, FloatArray], x: int, y: int) -> bool:
    """Return whether two columns of numbers may be x and y of one scene, by what they span."""
    if x not in numbers or y not in numbers:
        return False
    smaller, larger = sorted(
        max(float(np.nanmax(numbers[i]) - np.nanmin(numbers[i])), _TINY) for i in (x, y))
    return larger < _UNLIKE_SPANS * smaller


def _with_readings(error: TermselError, header: Sequence[str], rows: Sequence[Sequence[str]],
                   readings: Sequence[dict[str, int]], known_columns: Mapping[str, int],
                   aliases: Aliases, fixed: Collection[int]) -> TermselError:
    """Return an error whose hint has readings as texts of --columns.

    A reading says which column has which meaning; those that give a column two meanings are left
    out. Columns that are known by name are certain. The others are guesses: the error then shows
    the first point as each reading takes it, as only the user can decide. Where fewer columns are
    left than are needed, the table lacks image coordinates, and the error says so.
    """
    readings = [reading for reading in readings
                if len(set(reading.values())) == len(reading.values())]
    if not readings:
        return error
    texts = [_columns_option(reading, header, aliases, fixed) for reading in readings]
    earlier_hint = error.hint or ""
    free = len(header) - len(set(readings[0].values()) | set(fixed))
    # Fewer columns are left than would have to be declared.
    if texts[0].count("=?") > free:
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
        error.hint = f"{earlier_hint}{_DECLARE} {texts[0]!r}. Put the column for each ?."
    elif readings[0].keys() - known_columns:
        first_row = next((row for row in rows if len(row) == len(header)), ())
        first_points = [_point_in_words(first_row, reading) for reading in readings]
        _put_guesses(error, earlier_hint, texts, first_points)
    else:
        error.options["--columns"] = texts[0]
        error.hint = f"{earlier_hint}{_DECLARE} {texts[0]!r}."
    return error


def _where_measured(header: Sequence[str]) -> str:
    """Return where the places in the image are found that a table lacks."""
    # Metashape alone heads its table X/Longitude or X/Easting.
    if any(name.strip().lower().startswith("x/") for name in header):
        return _OF_METASHAPE
    return TO_MEASURE


def _put_guesses(error: TermselError, earlier_hint: str, guesses: list[str],
                 first_points: list[str]) -> None:
    """Put guesses into an error, after the hint that it had before.

    `guesses` are texts of --columns, the likeliest first; `first_points` has for each of them the
    first point as it would be read.
    """
    error.guesses = guesses
    error.first_points = first_points
    error.options["--columns"] = guesses[0]
    error.hint = (f"{earlier_hint}{_DECLARE} {guesses[0]!r}. This mapping is a guess; check it. "
                  f"The first point would be {'; or '.join(first_points)}.")


def _columns_option(columns: Mapping[str, int], header: Sequence[str], aliases: Aliases,
                    fixed: Collection[int]) -> str:
    """Return the text of --columns for a reading, in the order of `aliases`.

    A required meaning without a column has a ? in place of one; columns that are `fixed` are left
    out. A column is named as in the header, or numbered from 1.
    """
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


def _point_in_words(row: Sequence[str], columns: Mapping[str, int]) -> str:
    """Return the coordinates of a row as a reading takes them, such as "line 12, sample 40"."""
    return ", ".join(f"{meaning} {row[columns[meaning]].strip()}"
                     for meaning in ("line", "sample", "x", "y", "z")
                     if meaning in columns and columns[meaning] < len(row))


def unknown_table_error(path: Path, expected: str, columns: str) -> TermselError | None:
    """Return the error for a file without a reader, None unless it is a table of numbers.

    `expected` are the formats that could be given, `columns` is what the option of this name says
    already. The table may have no header, one in unknown words, or one pair of coordinates alone.
    For each of these the user gets a text of --columns to type, and not a list of formats.
    """
    stated = parse_columns(columns)
    is_spreadsheet = path.suffix.lower() in SPREADSHEETS
    try:
        cells = read_cells(path, POINTS, stated)
    except TermselError as error:
        return error if isinstance(error, BadText) or is_spreadsheet else None
    rows = [row for row in cells.rows[:_ROWS] if len(row) == len(cells.rows[-1]) <= WIDEST
            and not counts_columns(row)]
    number_columns = _number_columns(rows[1:])
    if len(rows) >= 2 and rows[0]:
        pair_missing = _missing_pair_error(path, rows[0], list(number_columns), expected)
        if pair_missing is not None:
            return pair_missing
    # Two rows are no table of points, and a point has four coordinates.
    if len(rows) < 3 or len(number_columns) < len(_REQUIRED):
        return _no_points_in_sheets_error(path, expected) if is_spreadsheet else None
    # A header has no numbers above columns of numbers.
    is_bare = any(i in _number_columns(rows[:1]) for i in number_columns)
    if is_bare and all(map(_is_mark_of_opendronemap, rows)):
        return TermselError(
            "these look like the rows of OpenDroneMap's gcp_list.txt (x y z column row image), "
            "which the package termsel-formats reads", file=path, line=1,
            hint=install_hint("termsel-formats"))
    header = [str(i + 1) for i in range(len(rows[0]))] if is_bare else rows[0]
    by_name = {meaning: indices[0]
               for meaning, indices in columns_by_meaning(header, POINTS).items() if indices}
    if is_bare:
        message = "this table has no header that names its columns"
    else:
        names_in_words = ", ".join(map(str.strip, header))
        message = f"the header names too few columns that are known: {names_in_words}"
    unnamed = TermselError(message, file=path, hint=expected,
                           code="header-missing" if is_bare else "")
    # Some programs write the CRS into the first line, without a #.
    if crs := _crs_of(cells.comments):
        unnamed.what += f", and its first line is the CRS {crs}"
    return with_advice(unnamed, header, rows if is_bare else rows[1:],
                       {**by_name, **find_declared_columns(header, stated)}, POINTS,
                       names_may_mislead=not stated)


def _no_points_in_sheets_error(path: Path, expected: str) -> TermselError:
    """Return the error for a file that is called a spreadsheet and has no table of points."""
    if read_head(path, expected)[:4] in _SHEETS:
        what = "no visible sheet has a table of points"
    else:
        what = "this is text, not a spreadsheet, and has no table of points"
    return TermselError(what, file=path, hint=expected)


def _is_mark_of_opendronemap(row: Sequence[str]) -> bool:
    """Return whether a row has five numbers, the last within an image, and the name of its file."""
    numbers = _number_columns([row])
    return (len(row) > 5 and numbers.keys() >= set(range(5))
            and all(abs(numbers[i][0]) <= LARGEST_IMAGE for i in (3, 4))
            and _IMAGE_FILE.fullmatch(row[5].strip()) is not None)


def _missing_pair_error(path: Path, header: Sequence[str], numeric: Sequence[int],
                        expected: str) -> TermselError | None:
    """Return the error for a table that has image coordinates or ground coordinates alone.

    `numeric` are the columns that hold numbers. Returns None for other tables, and where two
    further columns hold numbers: these may be the other pair under names that are not known.
    """
    by_name = columns_by_meaning(header, POINTS)
    known_meanings = [meaning for meaning, columns in by_name.items()
                      if set(columns) & set(numeric)]
    if len(numeric) - len(known_meanings) >= 2:
        return None
    # One pair is complete, and nothing of the other is there: a table of one kind of coordinates.
    pairs = {"image": ("line", "sample"), "ground": ("x", "y")}
    for present, absent in (("image", "ground"), ("ground", "image")):
        if all(by_name[name] for name in pairs[present]) and not any(
                by_name[name] for name in pairs[absent]):
            names = " and ".join(pairs[absent])
            remedy = _where_measured(header) if absent == "image" else expected
            return TermselError(
                f"this table has {present} coordinates alone: columns for {names} are missing. Its "
                f"columns are {', '.join(map(str.strip, header))}", file=path,
                code=f"{present}-alone",
                hint=f"Add the {absent} coordinates of each point. {remedy}")
    return None


def _crs_of(comments: Mapping[int, str]) -> str:
    """Return the CRS in the comment that stands for the first line of a file, "" for none."""
    crs = comments.get(1, "").partition("# crs:")[2].strip()
    return short_crs_name(crs) if crs else ""


def _number_columns(rows: Sequence[Sequence[str]]) -> dict[int, FloatArray]:
    """Return the columns that hold numbers alone, (n,) each, by their index.

    A blank cell is NaN; a column of blanks is left out.
    """
    numbers: dict[int, FloatArray] = {}
    for i, cells in enumerate(zip(*rows, strict=True)):
        try:
            signs, _ = decimal_signs({"": cells})
            # Where the sign is open either will do: only the order of the numbers matters here.
            sign = signs[""] or (POINT if POINT in "".join(cells) else COMMA)
            column = read_numbers(cells, sign, may_be_blank=True, angle="x")
        except BadCell:
            continue
        if not np.isnan(column).all():
            numbers[i] = column
    return numbers


def _axis_in_name(name: str) -> str:
    """Return "across" or "down" for the way a column runs in an image by its name, else "".

    "x_px" runs across, "row" down; a name with words of both, or of neither, says nothing.
    """
    words = set(_BETWEEN_WORDS.split(name.casefold()))
    runs_across = bool(words & _WORDS_ACROSS)
    runs_down = bool(words & _WORDS_DOWN)
    if runs_across == runs_down:
        return ""
    return "across" if runs_across else "down"


def _possible_readings(rows: Sequence[Sequence[str]], width: int, known_columns: Mapping[str, int],
                       scores: Collection[int] = ()) -> list[dict[str, int]]:
    """Return the readings of the columns whose meaning is not known, the likeliest first.

    Each reading is columns by meaning, without those of `known_columns`; there is at least one,
    which may be empty. Rows of another `width` than the header's take no part. Columns of `scores`
    have no meaning. Flags and columns that hold one number are no coordinates; a column that counts
    the points, or of text, is their id. Of the others, pairs lie next to each other: sample and
    line, x and y.
    """
    rows = [row for row in rows[:_ROWS] if len(row) == width]
    numbers = {i: column for i, column in _number_columns(rows).items()
               if i not in known_columns.values() and i not in scores}
    extra = _id_and_flags(rows, numbers, known_columns, scores)
    free = {i: column for i, column in numbers.items() if i not in extra.values()
            and np.nanmin(column) < np.nanmax(column) and not _is_flag(column)}
    no_numbering = {i: column for i, column in free.items() if not _counts_rows(column)}
    if len(no_numbering) >= len(_REQUIRED - known_columns.keys()):
        free = no_numbering
    candidates = _without_scores(free)
    coordinates = known_columns.keys() & {"line", "sample", "x", "y", "z"}
    if not coordinates and len(candidates) in (4, 5):
        with_pairs = _readings_of_pairs(candidates)
        # A fifth column of small numbers may be residuals as well as heights.
        without_heights = [
            {name: i for name, i in reading.items() if name != "z"} for reading in with_pairs
            if "z" in reading and np.nanmax(np.abs(candidates[reading["z"]])) < _SMALL]
        return [extra | reading for reading in [*with_pairs, *without_heights]]
    with_one_pair = _readings_of_one_pair(_number_columns(rows), candidates, known_columns)
    if with_one_pair:
        return [extra | reading for reading in with_one_pair]
    missing = [name for name in ("x", "y", "z", "sample", "line") if name not in known_columns]
    for names in (missing, [name for name in missing if name != "z"]):
        # With more columns than meanings any reading would be a guess at random.
        if names and len(candidates) == len(names):
            readings = [reading for reading in _readings_with_missing(names, list(candidates))
                        if "z" not in reading or _may_be_heights(candidates[reading["z"]])]
            return [extra | reading for reading in readings] or [extra]
    return [extra]


def _without_scores(numbers: dict[int, FloatArray]) -> dict[int, FloatArray]:
    """Return columns of numbers (n,), by index, without scores from 0 to 1, residuals and the like.

    Four columns or fewer come back as they are: they may all be coordinates. Of more, those go that
    lie within 0 and 1, as no heights do, and that the others do not explain, unless fewer than four
    would remain. If more than five remain of which the others explain four, these four come back.
    """
    if len(numbers) <= len(_REQUIRED):
        return numbers
    explained = {i for i in numbers if _share_explained(numbers, i) > _BELONGS}
    no_scores = {i: column for i, column in numbers.items() if i in explained
                 or np.nanmin(column) < 0.0 or np.nanmax(column) > 1.0}
    if len(no_scores) > len(_REQUIRED) + 1 and len(explained) == len(_REQUIRED):
        return {i: numbers[i] for i in explained}
    return no_scores if len(no_scores) >= len(_REQUIRED) else numbers


def _id_and_flags(rows: Sequence[Sequence[str]], numbers: Mapping[int, FloatArray],
                  known_columns: Mapping[str, int], excluded: Collection[int],
                  ) -> dict[str, int]:
    """Return the columns of "id" and "enabled" that the cells show, as far as there are any.

    Ids are numbers that count the rows in the first column, or texts that are all different.
    Flags are numbers 0 and 1; of zeros alone no point would be left, so these are none. Columns
    among the `known_columns` or `excluded` have another meaning; nothing is looked for that the
    table has already.
    """
    fewest = len(_REQUIRED - known_columns.keys())
    excluded = {*known_columns.values(), *excluded}
    extra: dict[str, int] = {}
    texts = []
    for i, cells in enumerate(zip(*rows, strict=True)):
        # The same text twice is no id, nor is the name of an image.
        if (i not in numbers and i not in excluded and len(set(cells)) == len(cells)
                and not any(Path(cell).suffix.lower() in RASTERS for cell in cells)):
            texts.append(i)
    if "id" not in known_columns:
        first_numbers = next(iter(numbers), None)
        # Where as many columns are left as coordinates are missing, none can be spared.
        if first_numbers is not None and len(numbers) > fewest and _counts_rows(
                numbers[first_numbers]):
            extra["id"] = first_numbers
        elif texts:
            extra["id"] = texts[0]
    flags = [i for i, column in numbers.items() if _is_flag(column)]
    if flags and "enabled" not in known_columns:
        extra["enabled"] = flags[-1]
    return extra


def _is_flag(column: FloatArray) -> bool:
    """Return whether a column (n,) has numbers 0 and 1 alone, and not only zeros."""
    return bool(np.isin(column, (0.0, 1.0)).all() and column.any())


def _may_be_heights(column: FloatArray) -> bool:
    """Return whether numbers (n,) may be heights: within those of the Earth, and no numbering."""
    return bool(np.nanmax(np.abs(column)) <= _HIGHEST) and not _counts_rows(column)


def _counts_rows(column: FloatArray) -> bool:
    """Return whether the numbers of a column (n,) rise by one from row to row, as numbering does.
    """
    return np.array_equal(column - column[0], np.arange(len(column)))


def _readings_of_one_pair(numbers: Mapping[int, FloatArray], candidates: Collection[int],
                          known_columns: Mapping[str, int]) -> list[dict[str, int]]:
    """Return the two readings of a table in which one pair of coordinates is known by name.

    That is x and y, or sample and line; the other pair are the two columns among the `candidates`
    that the known pair explains. Each reading is the columns by meaning. The first has the order
    in which the image is no mirror image of the ground, the second the reverse. A candidate that
    remains alone is the height, if that is not known.

    The list is empty where not exactly one pair is known, or the known pair explains fewer or more
    than two columns. `numbers` are the columns of numbers (n,), by their index.
    """
    image, ground = ("sample", "line"), ("x", "y")
    ground_is_known = known_columns.keys() >= set(ground)
    known, missing = (ground, image) if ground_is_known else (image, ground)
    if not known_columns.keys() >= set(known) or known_columns.keys() & set(missing):
        return []
    known_pair = {known_columns[name]: numbers[known_columns[name]] for name in known
                  if known_columns[name] in numbers}
    if len(known_pair) < 2:  # a cell of a known column is no number
        return []
    explained = [i for i in candidates
                 if _share_explained({**known_pair, i: numbers[i]}, i) > _BELONGS]
    if len(explained) != 2:
        return []
    pairs = {known: list(known_pair), missing: explained}
    # Where the known pair is taken as it stands, this order of the other mirrors nothing.
    is_upright = _upright_columns(numbers, pairs[image], pairs[ground]) == image
    names = missing if is_upright else missing[::-1]
    unexplained = [i for i in candidates if i not in explained]
    has_height = (len(unexplained) == 1 and "z" not in known_columns
                  and _may_be_heights(numbers[unexplained[0]]))
    heights = {"z": unexplained[0]} if has_height else {}
    return [dict(zip(order, explained, strict=True)) | heights for order in (names, names[::-1])]


def _readings_with_missing(missing: Sequence[str], free: Sequence[int]) -> list[dict[str, int]]:
    """Return the ways to read the `free` columns of a table as the `missing` meanings.

    The likeliest comes first. A reading gives a column number to each meaning, such as "line" or
    "x"; there are as many columns as meanings. The first reading takes the columns in the order of
    the meanings. A further one exchanges sample and line if both are missing, and another exchanges
    x and y.
    """
    in_order = dict(zip(missing, free, strict=True))
    readings = [in_order]
    for across, down in (("sample", "line"), ("x", "y")):
        if across in in_order and down in in_order:
            readings.append({**in_order, across: in_order[down], down: in_order[across]})
    return readings


def _readings_of_pairs(numbers: Mapping[int, FloatArray]) -> list[dict[str, int]]:
    """Return readings of four or five columns: a pair of the image, a pair of the ground, heights.

    Seen from above, an image is no mirror image of the ground. With x to the east and y to the
    north, sample to the right and line downwards, the determinant of the affine map from (x, y) to
    (sample, line) is negative. So the order within one pair decides the order within the other.
    One to four readings come back, those with x before y first. `numbers` are the columns of
    numbers (n,), by their index.
    """
    by_ranges = _ground_by_ranges(numbers)
    divisions = ([_division_around(numbers, by_ranges)] if by_ranges
                 else _divisions_of_neighbours(numbers))
    readings = []
    for image, ground in divisions:
        names = _upright_columns(numbers, image, ground)
        mirrored = ("x", "y", "z"), ("y", "x", "z")
        for axes, order in zip(mirrored, (names, names[::-1]), strict=True):
            reading = dict(zip(axes, ground, strict=False)) | dict(zip(order, image, strict=True))
            # No latitude exceeds 90 degrees.
            if (np.nanmax(np.abs(numbers[reading["y"]])) <= 90.0
                    or not _are_degrees(numbers, ground[:2])):
                readings.append(reading)
    # Sample before line and x before y is how most programs write them.
    return sorted(readings, key=lambda reading: reading["x"] > reading["y"])


def _divisions_of_neighbours(numbers: Mapping[int, FloatArray],
                             ) -> list[tuple[list[int], list[int]]]:
    """Return the ways to divide four or five columns into the image and the ground with heights.

    Columns of a pair lie next to each other in them. The likeliest comes first.
    """
    free = list(numbers)
    height: list[int] = []
    if len(free) == 5:
        # Image and ground determine each other, a height is nearly free of both. Pairs lie next
        # to each other, so that it is the first, the middle or the last.
        low = [i for i in free[::2] if np.nanmax(np.abs(numbers[i])) <= _HIGHEST]
        height = [min(low or free[::2], key=lambda i: _share_explained(numbers, i))]
    in_pairs = [i for i in free if i not in height]
    # Columns of a pair are next to each other in every format that is known. Either division is
    # the columns of the image, then those of the ground.
    if_image_first = in_pairs[:2], [*in_pairs[2:], *height]
    if_ground_first = in_pairs[2:], [*in_pairs[:2], *height]
    first_is_ground = _is_ground(numbers, in_pairs[:2])
    last_is_ground = _is_ground(numbers, in_pairs[2:])
    if first_is_ground != last_is_ground:
        return [if_image_first if last_is_ground else if_ground_first]
    if height == free[2:3]:
        return [if_ground_first]
    if not height:
        # Either both pairs are pixels, of two images, or the ground has numbers as small as pixels.
        return [if_image_first, if_ground_first]
    if height == free[4:]:
        return [if_image_first]
    return [if_ground_first, if_image_first]


def _ground_by_ranges(numbers: Mapping[int, FloatArray]) -> list[int]:
    """Return the two columns that only the ground can be, by their ranges; else an empty list.

    They are beyond the pixels of images, or degrees within one place next to columns that span
    more. Three columns of small numbers leave it open unless one of them is free of the others.
    """
    beyond = [i for i, column in numbers.items() if np.nanmax(np.abs(column)) > _BEYOND_IMAGES]
    narrow = [i for i, column in numbers.items()
              if np.nanmax(np.abs(column)) <= 180.0 and np.ptp(column) < _WIDEST_SCENE]
    if len(narrow) > 2:
        narrow = [i for i in narrow if _share_explained(numbers, i) > _BELONGS]
    pairs = [pair for pair in (beyond, narrow) if len(pair) == 2]
    return pairs[0] if pairs and _is_ground(numbers, pairs[0]) else []


def _division_around(numbers: Mapping[int, FloatArray], ground: Sequence[int],
                     ) -> tuple[list[int], list[int]]:
    """Return the columns of the image, and those of the ground with heights; two are known.

    Of three others, a height is the one that the ground explains least.
    """
    others = [i for i in numbers if i not in ground]
    if len(others) == 2:
        return others, list(ground)
    low = [i for i in others if _may_be_heights(numbers[i])] or others
    height = min(low, key=lambda i: _share_explained({j: numbers[j] for j in (*ground, i)}, i))
    image = [i for i in others if i != height]
    return image, [*ground, *([height] if _may_be_heights(numbers[height]) else [])]


def _upright_columns(numbers: Mapping[int, FloatArray], image: Sequence[int],
                     ground: Sequence[int]) -> tuple[str, str]:
    """Return which of two columns of the image is "sample" and which "line", in their order.

    It is the order in which the image does not mirror the ground; "sample", "line" where a cell is
    blank, so that nothing can be told. `image` and `ground` are indices of columns, x before y;
    more than two of the ground are not read.
    """
    columns = [numbers[i] for i in (*ground[:2], *image)]
    if any(np.isnan(column).any() for column in columns):
        return "sample", "line"
    design = np.column_stack([column - column.mean() for column in columns[:2]])
    # Columns without a positive number count the other way, as y upwards from the upper edge.
    positive = [-column if column.max() <= 0.0 else column for column in columns[2:]]
    right_hand_sides = np.column_stack([column - column.mean() for column in positive])
    # The affine map from x, y to both, by least squares: its determinant is negative where the
    # first is the sample and the second the line.
    slopes = np.linalg.lstsq(design, right_hand_sides, rcond=None)[0]
    return ("line", "sample") if np.linalg.det(slopes) > 0.0 else ("sample", "line")


def _are_degrees(numbers: Mapping[int, FloatArray], pair: Sequence[int]) -> bool:
    """Return whether two columns can be longitude and latitude, in some order."""
    sizes = sorted(float(np.nanmax(np.abs(numbers[i]))) for i in pair)
    # Where both are below 90, their order stays open.
    return sizes[0] <= 90.0 < sizes[1] <= 180.0


def _is_ground(numbers: Mapping[int, FloatArray], pair: Sequence[int]) -> bool:
    """Return whether two columns look like degrees within a place, or like metres of a map."""
    largest = max(np.nanmax(np.abs(numbers[i])) for i in pair)
    if largest > _BEYOND_IMAGES:
        return True
    return bool(largest <= 180 and max(np.ptp(numbers[i]) for i in pair) < _WIDEST_SCENE)


def _share_explained(numbers: Mapping[int, FloatArray], i: int) -> float:
    """Return the share of the variance of column `i` that a linear function of the others explains.

    `numbers` are columns (n,) by their index. Rows with a blank take no part.
    """
    other_columns = np.column_stack([column for j, column in numbers.items() if j != i])
    is_complete = ~np.isnan(np.column_stack([other_columns, numbers[i]])).any(axis=1)
    # A function of as many coefficients as there are rows explains anything.
    if is_complete.sum() <= other_columns.shape[1] + 1:
        return 1.0
    b = numbers[i][is_complete] - numbers[i][is_complete].mean()
    A = other_columns[is_complete] - other_columns[is_complete].mean(axis=0)
    # Columns of degrees and of metres side by side would be near singular.
    A = A / np.maximum(np.abs(A).max(axis=0), _TINY)
    residuals = b - A @ np.linalg.lstsq(A, b, rcond=None)[0]
    return float(1 - residuals @ residuals / max(b @ b, _TINY))
