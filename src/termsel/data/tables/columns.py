"""Names of the columns of tables: what means what, and which names are free for others."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from termsel.core.errors import TermselError, unknown_name_error
from termsel.data.tables.unit_names import remark_in_brackets, without_unit

Aliases = Mapping[str, tuple[str, ...]]
"""Names that the column of each meaning may have."""

USE: dict[str, tuple[str, ...]] = {
    "id": ("id", "name"), "role": ("role",), "enabled": ("enabled", "enable")}
"""Columns of text by their meaning, with the names they may have; all others hold numbers."""

COORDINATES: dict[str, tuple[str, ...]] = {
    "line": ("line", "row", "y_px"),
    "sample": ("sample", "col", "column", "x_px", "pixel"),
    "x": ("x", "lon", "longitude", "easting"),
    "y": ("y", "lat", "latitude", "northing"),
    "z": ("z", "h", "height", "elev", "elevation", "alt", "altitude"),
}
POINTS = USE | COORDINATES | {
    "sigma_line": ("sigma_line", "sigma_px"), "sigma_sample": ("sigma_sample", "sigma_px")}
LINES: dict[str, tuple[str, ...]] = {**USE, "sigma": ("sigma", "sigma_px")}
for _end in "12":  # of a line
    for _meaning, _aliases in COORDINATES.items():
        LINES[f"{_meaning}{_end}"] = tuple(f"{alias}{_end}" for alias in _aliases)
CORNER: dict[str, tuple[str, ...]] = {"corner": ("corner", "vertex")}
OPTIONAL = frozenset({"id", "role", "enabled", "sigma_line", "sigma_sample", "sigma"})
"""Meanings that a table may have no column for."""

COMPUTED = ("computed_line", "computed_sample", "residual_line", "residual_sample",
            "residual1", "residual2", "dx", "dy", "residual", "geometry")
"""Columns that termsel, QGIS and GeoPandas add to measurements."""

TAKEN = frozenset(COMPUTED).union(*POINTS.values(), *LINES.values()) - {"sigma"}
"""Names, in lower case, that columns of attributes cannot have; of lines nor sigma."""

# Names in other languages and of other programs, without accents and signs. They count where no
# column has one of the names above, so that a table may keep them for attributes.
_FURTHER = {meaning: frozenset(names.split()) for meaning, names in {
    "id": "pt ptid ptno point points pointid pointname pointno pointnr pointnumber gcp gcpid gcpno "
          "gcpname gcplabel label nr no num number pkt pktnr punkt punktid punktnr punktnummer "
          "punktname passpunkt nummer numer numero nom nombre punto idpunto nome ponto punt "
          "puntnummer nazwa naam bod cislobodu pont pontszam nokta tunnus punctul točka točke "
          "точка точки номер номерточки назва σημείο 点番号 점 점번호 点 点号 點號 点名 编号 序号 "
          "名称 id号",
    "line": "lin lines rows pxy ypix ypixel pixely py imgy imagey yimg yimage lineno zeile "
            "yimagen yimagem imy imrow imgrow imagerow bildzeile bildy "
            "ligne rangee fila fil renglon linea riga linha wiersz rij regel "
            "riadok radek sor satır rivi rad rekke række rând redak vrstica "
            "строка yпикс ряд рядок γραμμή 행 行 行号 行数 行坐标 像素行 影像行 图像行 像素y 影像y "
            "图像y",
    "sample": "samples samp cols columns xpix xpixel pixelx pix px imgx imagex ximg ximage spalte "
              "ximagen ximagem imx imcol imgcol imagecol bildspalte bildx "
              "colonne columna muestra colonna campione coluna kolumna kolom "
              "pxx sloupec stlpec oszlop sütun sarake kolumn kolonne coloană stupac stolpec "
              "столбец xпикс колонка стовпець στήλη 열 列 列号 列数 列坐标 像素列 影像列 图像列 "
              "像素x 影像x 图像x",
    "x": "e east lng long easting pointx geox xmap utme utmx utmeast utmeasting "
         "lange laenge langengrad laengengrad rechtswert ostwert "
         "ost longitud longitudine este est leste xl93 dlugosc wschod lengte "
         "lengtegraad oost delka zemepisnadelka dlzka zemepisnadlzka hosszúság boylam itä "
         "longitud öst øst lengdegrad længdegrad longitudine долгота довгота γεωγραφικόμήκος "
         "восток восточная xместности xterreno "
         "経度 경도 经度 經度 东经 东坐标 东 东向",
    "y": "n north nord norte northing pointy lati geoy ymap utmn utmy utmnorth utmnorthing "
         "breite breitengrad hochwert nordwert latitud "
         "latitudine yl93 szerokosc polnoc breedte breedtegraad noord "
         "sirka zemepisnasirka szélesség enlem pohjoinen norr nord breddegrad широта "
         "γεωγραφικόπλάτος север северная yместности yterreno "
         "緯度 위도 纬度 北纬 北坐标 北 北向",
    "z": "geoz hohe hoehe hoheunn hoheunhn hauteur altura altitud altitudine altezza cota quota "
         "elevazione elevacion elevacao wysokosc hoogte pointz ellipsoidalheight ellheight "
         "vyska magasság yükseklik korkeus höjd høyde højde visina высота висота υψόμετρο "
         "標高 고도 표고 高程 高度 高 大地高 海拔"}.items()}
CHINESE = tuple(sorted(
    name for name in frozenset().union(*_FURTHER.values())
    if any("\u4e00" <= letter <= "\u9fff" for letter in name)))
"""Names that only one encoding of Chinese text gives."""

RUSSIAN = ("широта", "долгота", "север", "восток", "строка", "столбец", "высота")
"""Names that only one encoding of Russian text gives."""

JAPANESE = ("経度", "緯度", "標高", "点番号")
KOREAN = ("경도", "위도", "고도", "표고", "점번호")
TAIWANESE = ("經度", "緯度", "點號")
GREEK = ("γραμμή", "στήλη", "υψόμετρο", "σημείο")
TURKISH = ("satır",)
"""Names that tell the encoding of text from these countries."""

CENTRAL_EUROPEAN = ("wysokość", "długość", "szerokość", "północ")
"""Names, as they are written in Poland, that only one encoding of a text gives."""


def fold_name(name: str) -> str:
    """Return a name without accents, signs and capitals."""
    # The stroke of ł and the i without a dot are no accents to Unicode.
    letters = unicodedata.normalize("NFKD", name.casefold().replace("ł", "l").replace("ı", "i"))
    without_accents = "".join(sign for sign in letters if not unicodedata.combining(sign))
    return re.sub(r"[\W_]", "", without_accents)


_OF_COORDINATES = frozenset(
    fold_name(name) for meaning in ("line", "sample", "x", "y")
    for name in (*COORDINATES[meaning], *_FURTHER[meaning]))


@lru_cache(10_000)  # readers compare the names of a header with all that are known
def coordinate_in_brackets(name: str) -> str:
    """Return the name of a coordinate in brackets behind X or Y alone, folded; "" without one.

    "X (North)" gives "north": many countries call the northing X.
    """
    normal = unicodedata.normalize("NFKC", name.strip().casefold())
    remark = fold_name(remark_in_brackets(normal))
    is_letter = fold_name(without_unit(normal)) in ("x", "y")
    return remark if is_letter and remark in _OF_COORDINATES else ""


@lru_cache(10_000)  # readers compare the names of a header with all that are known
def _folded_forms(name: str) -> tuple[str, ...]:
    """Return a column's name folded with and without its unit, and then each of its alternatives.

    "Line (px)" gives "linepx" and "line"; "X/Longitude" gives "xlongitude" twice, "x" and
    "longitude". What brackets call a coordinate stands for X or Y in front of them.
    """
    normal = unicodedata.normalize("NFKC", name.strip().casefold())
    alternatives = normal.split("/") if "/" in normal else []
    bare = coordinate_in_brackets(name) or fold_name(without_unit(normal))
    return (fold_name(normal), bare, *map(fold_name, alternatives))


def _is_one_of(forms: tuple[str, ...], names: frozenset[str], all_names: frozenset[str]) -> bool:
    """Return whether a name, folded in its forms, is one of those of a meaning."""
    full, bare, *alternatives = forms
    return full in names or (bare in names and full not in all_names) or (
        bool(alternatives) and names.issuperset(alternatives))


@lru_cache(100)  # readers compare the names of a header with all that are known
def _folded_names_by_meaning(aliases: tuple[tuple[str, tuple[str, ...]], ...],
                      ) -> tuple[dict[str, tuple[frozenset[str], frozenset[str]]], frozenset[str]]:
    """Return the plain and the further names of each meaning, folded, and the set of all names.

    `aliases` are pairs of a meaning and its plain names.
    """
    names = {}
    for meaning, plain_names in aliases:
        base, end = _meaning_and_line_end(meaning)
        # Readers of other programs' tables use the same meanings with their own names, to which no
        # further ones are added.
        own = (POINTS | LINES).get(meaning)
        is_own = own is not None and plain_names[:len(own)] == own
        further = frozenset(f"{fold_name(name)}{end}" for name in _FURTHER.get(base, ()) if is_own)
        names[meaning] = (frozenset(map(fold_name, plain_names)), further)
    return names, frozenset().union(*chain.from_iterable(names.values()))


def columns_by_meaning(header: Sequence[str], aliases: Aliases) -> dict[str, list[int]]:
    """Return the columns that could hold each meaning, by their names.

    A meaning has plain names, such as line, and further ones of other programs and languages, which
    count only where no column has a plain name. Several columns of one meaning are all returned:
    whoever asks decides whether that is an error. A number in a header is no name, nor is a letter
    that counts the columns, as e does among a to g.
    """
    names_of, all_names = _folded_names_by_meaning(tuple(
        (meaning, tuple(names)) for meaning, names in aliases.items()))
    # Rows of numbers are asked about, too, to find the header: they end here.
    counting = _letters_that_count(header)
    forms = {i: folded for i, folded in enumerate(map(_folded_forms, header))
             if i not in counting and not all_names.isdisjoint(folded)}
    if not forms:
        return {meaning: [] for meaning in names_of}
    columns: dict[str, list[int]] = {}
    all_columns: dict[str, list[int]] = {}
    for meaning, (plain_names, further_names) in names_of.items():
        plain, further = ([i for i, folded in forms.items() if _is_one_of(folded, names, all_names)]
                          for names in (plain_names, further_names))
        columns[meaning] = plain or further
        all_columns[meaning] = [*plain, *(i for i in further if i not in plain)]
    if {"line", "sample", "x", "y"} <= columns.keys():
        columns |= _pixels_next_to_degrees(header, all_columns)
    # A column n without one of eastings, or next to other latitudes without an e, numbers the
    # points, and has no northings.
    has_other_pair = (len(columns.get("y", ())) > 1
                      and all(forms[i][0] != "e" for i in columns.get("x", ())))
    if columns.get("y") and (not columns.get("x") or has_other_pair):
        columns["y"] = [i for i in columns["y"] if forms[i][0] != "n"]
    return columns


_LETTERS_OF_A_RUN = 4
"""Single letters in the order of the alphabet that are no chance: x, y and z are three."""


def _letters_that_count(header: Sequence[str]) -> set[int]:
    """Return the columns whose names are letters that go on from column to column, as a to g do."""
    columns_of_start: dict[int, set[int]] = {}
    for i, name in enumerate(header):
        letter = name.strip().casefold()
        if len(letter) == 1 and "a" <= letter <= "w":
            # Columns of one run would have the same letter before the first column.
            columns_of_start.setdefault(ord(letter) - i, set()).add(i)
    runs = [columns for columns in columns_of_start.values() if len(columns) >= _LETTERS_OF_A_RUN]
    return set().union(*runs)


def _pixels_next_to_degrees(header: Sequence[str],
                            named: Mapping[str, list[int]]) -> dict[str, list[int]]:
    """Return the columns by meaning if x and y are pixels next to degrees, as MapWarper has them.

    They are if each of x and y has one column, each of lon and lat one or more, and no column is
    called line or sample. If not, no columns are returned.
    """
    plain = {axis: [i for i in named[axis] if header[i].strip().casefold() == axis]
             for axis in "xy"}
    ground = {axis: [i for i in named[axis] if i not in plain[axis]] for axis in "xy"}
    if named["line"] or named["sample"] or not all(ground.values()) or any(
            len(columns) != 1 for columns in plain.values()):
        return {}
    return {"sample": plain["x"], "line": plain["y"], "x": ground["x"], "y": ground["y"]}


def _meaning_and_line_end(meaning: str) -> tuple[str, str]:
    """Return a meaning without the end of a line that it is of, and that end."""
    return (meaning[:-1], meaning[-1]) if meaning[-1] in "12" else (meaning, "")


def columns_text(columns: str | Mapping[str, object]) -> str:
    """Return a mapping of meanings to columns as the text of --columns; text stays as it is."""
    return columns if isinstance(columns, str) else ",".join(
        f"{meaning}={column}" for meaning, column in columns.items())


_CALLED = {name: meaning for meaning, names in (LINES | COORDINATES).items() for name in names
           if meaning != "sigma"}
"""Meanings by what else they are called: a row is a line, lon2 the x2 of a line's end."""


def parse_columns(text: str) -> dict[str, str]:
    """Return the name or number of each declared column, by meaning.

    `text` has pairs such as "line=Zeile,sample=4". Meanings may be called as columns are, such as
    row, col, lon, lat and height.

    Raises TermselError for a pair without meaning or name, an unknown meaning, and one that is
    declared twice.
    """
    meanings = POINTS | LINES | CORNER
    columns: dict[str, str] = {}
    for pair in filter(None, map(str.strip, text.split(","))):
        # Only the first ":" or "=" separates meaning and name: a name may have more of them.
        meaning, sign, name = re.sub("[:=]", "\0", pair, count=1).partition("\0")
        meaning = meaning.strip().lower()
        meaning = _CALLED.get(meaning, meaning)
        name = name.strip()
        if not sign or not name:
            raise TermselError(f"{meaning!r} does not declare a column",
                               hint="Write meaning=name or meaning=number, such as "
                                    "--columns x=Rechtswert,line=4.")
        if meaning not in meanings:
            raise unknown_name_error("meaning of a column", meaning, meanings)
        if meaning in columns:
            raise TermselError(f"the column of {meaning} is declared twice",
                               hint="Declare it once.")
        columns[meaning] = name
    return columns


def find_declared_columns(header: Sequence[str], columns: Mapping[str, str]) -> dict[str, int]:
    """Return the indices of the columns that the user declares, by meaning.

    Columns are declared by name, or by number counted from 1. Those that the table does not have
    are left out.
    """
    names = [name.strip().casefold() for name in header]
    numbers = {}
    for meaning, name in columns.items():
        if name.casefold() in names:
            numbers[meaning] = names.index(name.casefold())
        elif name.isdecimal() and 1 <= int(name) <= len(header):
            numbers[meaning] = int(name) - 1
    return numbers


# Numbers as people write them: decimal commas, separators of thousands, degrees and minutes.

POINT, COMMA = ".", ","
_THREE = "three"
"""All cells have three digits after a point: decimals, unless other columns show otherwise."""
_PARTED = re.compile(r"(?<=\d)[\s'’](?=\d{3}(?!\d))")
_ONE_GROUP = {sign: re.compile(rf"[+-]?[1-9]\d{{0,2}}\{sign}\d{{3}}") for sign in (POINT, COMMA)}
_GROUPS = {sign: re.compile(rf"[+-]?\d{{1,3}}(\{sign}\d{{3}})+(\{other}\d*)?")
           for sign, other in ((POINT, COMMA), (COMMA, POINT))}
_SIGN_OF_SIDE = {"N": 1, "S": -1, "E": 1, "W": -1, "北": 1, "南": -1, "东": 1, "東": 1, "西": -1}
_LATITUDE = frozenset("NS北南")
_ANGLE = re.compile(
    r"([NSEWO北南东東西]?)[经經纬緯]?\s*([+-]?\d+(?:[.,]\d+)?)\s*[°º˚d:度\s-]?\s*"
    r"(?:(\d+(?:[.,]\d+)?)\s*['′’´m:分\s-]?\s*)?"
    r"(?:(\d+(?:[.,]\d+)?)\s*(?:[\"″”秒]|(?-i:s)|''|′′|’’)?)?\s*([NSEWO]?)", re.IGNORECASE)
_MARKS = re.compile("[°º˚d度'′’´m分:]", re.IGNORECASE)


class BadCell(ValueError):
    """A cell that is no number, in a row from 0, and a column where several are read."""

    def __init__(self, row: int, problem: str, hint: str, column: str = "") -> None:
        super().__init__(problem)
        self.row = row
        self.what = problem
        self.hint = hint
        self.column = column


def decimal_signs(columns: Mapping[str, Sequence[str]], stated: str = "", *,
                  points_only: bool = False) -> tuple[dict[str, str], list[str]]:
    """Return the decimal sign of each column of numbers, by the evidence of all its rows.

    1,234 alone may be one thousand or little more than one. A column that leaves this open takes
    the sign `stated`, or else the sign of the columns that show it, if they agree. If they do not,
    its sign is "", or a point if each row has a point with three digits. With `points_only` commas
    separate the columns, so that points without commas are decimal.

    The second value has the names of the open columns whose sign others, or the user, decided.
    Raises BadCell if cells of one column contradict each other.
    """
    # "." or "," where cells show it, "three" or "" where they leave it open, None without any sign.
    evidence = {name: _decimal_sign(name, cells, points_only) for name, cells in columns.items()}
    certain = {sign for sign in evidence.values() if sign in (POINT, COMMA)}
    sign_of_open = stated or (certain.pop() if len(certain) == 1 else "")
    signs: dict[str, str] = {}
    decided = []
    for name, sign in evidence.items():
        if sign is None:
            signs[name] = POINT
        elif sign == _THREE:
            signs[name] = sign_of_open or POINT
        else:
            signs[name] = sign or sign_of_open
        # A column of points with three digits is decided by others only if they are no decimals.
        if (sign_of_open and sign == "") or (sign_of_open == COMMA and sign == _THREE):
            decided.append(name)
    return signs, decided


def _decimal_sign(name: str, cells: Sequence[str], points_only: bool) -> str | None:
    """Return the decimal sign of a column's cells, or how open it is; None if no cell has a sign.

    POINT or COMMA is certain. "" is returned for commas or points that may separate thousands, and
    `_THREE` for points with three digits in every row, which are decimal unless other columns
    decide otherwise. With `points_only` a column without commas has decimal points. Raises BadCell,
    with the `name` of the column, if two cells disagree.
    """
    joined = "".join(cells)
    has_commas = COMMA in joined
    if not has_commas and (points_only or POINT not in joined):
        return POINT if POINT in joined else None
    first_row_with: dict[str, int] = {}  # by decimal sign
    has_whole_numbers = False
    for row, cell in enumerate(cells):
        text = _PARTED.sub("", cell.strip())
        # The sign further right is the decimal one, unless it occurs twice or is followed by three
        # digits alone.
        last_sign = max(COMMA, POINT, key=text.rfind)
        other_sign = POINT if last_sign == COMMA else COMMA
        if last_sign not in text:
            has_whole_numbers = has_whole_numbers or bool(text)
        elif text.count(last_sign) > 1:
            first_row_with.setdefault(other_sign, row)
        elif other_sign in text or not _ONE_GROUP[last_sign].fullmatch(text):
            first_row_with.setdefault(last_sign, row)
    if len(first_row_with) > 1:
        (_, _), (sign, row) = sorted(first_row_with.items(), key=lambda item: item[1])
        sign_word, other_word = ("comma", "point") if sign == COMMA else ("point", "comma")
        raise BadCell(row, f"{cells[row].strip()!r} has a decimal {sign_word}, other cells a "
                           f"decimal {other_word}", "Use one of them in the whole column.", name)
    if first_row_with:
        return next(iter(first_row_with))
    # If only some numbers have a point, it may separate the thousands of the larger ones.
    return "" if has_commas or has_whole_numbers else _THREE


def read_numbers(cells: Sequence[str], sign: str, *, may_be_blank: bool, angle: str = "",
                 ) -> NDArray[np.float64]:
    """Return cells as numbers (n,), NaN for blank ones if they `may_be_blank`.

    The decimal sign is `sign`; the other one of point and comma separates thousands. `angle` is "x"
    or "y" if cells may be longitudes or latitudes in degrees, minutes and seconds. Raises BadCell
    for the first cell that is no number.
    """
    # A whole column is read at once, which is fast; cell by cell only if that fails.
    joined = "".join(cells)
    if "_" not in joined and (sign == POINT or POINT not in joined):
        blank = np.array([may_be_blank and (not cell or cell.isspace()) for cell in cells])
        with_points = [cell.replace(COMMA, POINT) for cell in cells] if sign == COMMA else cells
        texts = ["nan" if is_blank else cell
                 for cell, is_blank in zip(with_points, blank, strict=True)]
        with suppress(ValueError):
            values = np.fromiter(map(float, texts), np.float64, len(cells))
            if np.isfinite(values[~blank]).all():
                return values
    return np.array([_read_number(row, cell, sign, may_be_blank, angle)
                     for row, cell in enumerate(cells)])


def _read_number(row: int, cell: str, sign: str, may_be_blank: bool, angle: str) -> float:
    """Return the number of a cell; NaN if it is blank and `may_be_blank`.

    The other parameters are those of `read_numbers`. Raises BadCell, with the row, if the cell has
    no plain, finite number.
    """
    text = cell.strip()
    if not text:
        if may_be_blank:
            return float("nan")
        raise BadCell(row, "the cell is blank, expected a number", "Fill it in or remove the row.")
    # Spaces and apostrophes may separate groups of three digits, and typography has its own minus.
    digits = _PARTED.sub("", cell).replace("−", "-")
    # The sign that is not decimal may part thousands, but only in groups of three.
    separator = COMMA if sign == POINT else POINT
    if separator in digits and _GROUPS[separator].fullmatch(digits.strip()):
        digits = digits.replace(separator, "")
    try:
        value = float(digits.replace(COMMA, POINT) if sign == COMMA else digits)
    except ValueError:
        if angle and (degrees := _parse_degrees(row, text, angle)) is not None:
            return degrees
        raise BadCell(row, f"{text!r} is not a number", _remedy_for_text(text)) from None
    if not math.isfinite(value):
        raise BadCell(row, f"{text!r} is not a finite number",
                      "Leave the cell blank if the value is unknown." if may_be_blank
                      else "Correct it or remove the row.")
    if "_" in text:
        raise BadCell(row, f"{text!r} is not a plain number", "Write it without underscores.")
    return value


_DATE = re.compile(r"\d{1,2}[. -]?(jan|feb|m[aä]r|apr|ma[iy]|jun|jul|aug|sep|o[ck]t|nov|de[cz])"
                   r"|(jan|feb|m[aä]r|apr|ma[iy]|jun|jul|aug|sep|o[ck]t|nov|de[cz])[a-z]*[. -]?\d"
                   r"|\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}$", re.IGNORECASE)
"""What a spreadsheet makes of 12.5 where it takes it for a date."""

_WITH_UNIT = re.compile(r"[-+]?[\d.,]+\s*(m|cm|mm|km|ft|px|deg|°)", re.IGNORECASE)
"""A number with its unit in the cell."""


def _remedy_for_text(text: str) -> str:
    """Return what to do about a cell that is no number, by what has probably made it so."""
    if text and not text.strip("#"):
        return ("A spreadsheet wrote # as the column was too narrow: widen it, and save the table "
                "again.")
    if _DATE.match(text):
        return ("A spreadsheet has made a date of it: format the column as numbers or text before "
                "the values are entered or imported, and save the table again.")
    if _WITH_UNIT.fullmatch(text):
        return "Write it without the unit, in this row and all others."
    return "Write a plain number such as 12.5."


_PARTS_OF_ANGLE = ("minutes", "seconds")
"""Parts of an angle after its degrees."""


def _parse_degrees(row: int, text: str, angle: str) -> float | None:
    """Return an angle such as 10°59'28.7"E in degrees; None if the text is no such angle.

    Degrees, minutes and seconds are separated by their marks or by spaces, with a hemisphere before
    or after, or a sign. `row` is that of the cell and `angle` its axis, "x" or "y", for errors.
    Raises BadCell for more than 60 minutes or seconds, a latitude among longitudes, a hemisphere
    that is ambiguous, and one next to a sign.
    """
    match = _ANGLE.fullmatch(text)
    if match is None:
        return None
    before, *numbers, after = (number or "" for number in match.groups())
    numbers = [number.replace(COMMA, POINT) for number in numbers if number]
    hemisphere = (before or after).upper()
    values = [abs(float(number)) for number in numbers]
    if ((before and after) or any(POINT in number for number in numbers[:-1]) or values[0] > 360
            or not (hemisphere or len(numbers) == 3 or _MARKS.search(text))):
        return None
    # 59.999" that a program rounded is 60.00", and as good as the next minute.
    parts = zip(values[1:], _PARTS_OF_ANGLE, strict=False)
    too_many = [f"{value:g} {part}" for value, part in parts if value > 60]
    if too_many:
        raise BadCell(row, f"{text!r} has {' and '.join(too_many)}: an angle has at most 60",
                      "Correct the angle; decimal degrees have no marks, such as 34.7969.")
    if hemisphere == "O":
        raise BadCell(row, f"the O in {text!r} is east in German and west in Romance languages",
                      "Write E or W.")
    if hemisphere and (hemisphere in _LATITUDE) != (angle == "y"):
        kind = "latitude" if hemisphere in _LATITUDE else "longitude"
        raise BadCell(row, f"{text!r} is a {kind} in the column of {angle}",
                      "x is the longitude and y the latitude: are the columns swapped?")
    if hemisphere and numbers[0][0] in "+-":
        raise BadCell(row, f"{text!r} has a sign and a hemisphere", "Give one of them.")
    # degrees + minutes / 60 + seconds / 3600.
    size = sum(value / 60.0**power for power, value in enumerate(values))
    return -size if numbers[0][0] == "-" else size * _SIGN_OF_SIDE.get(hemisphere, 1)
