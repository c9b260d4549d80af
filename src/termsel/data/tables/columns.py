"""Names of the columns of tables: what means what, and which names are free for others."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import chain

from termsel.core.errors import TermselError, unknown_name

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
          "puntnummer nazwa naam 点 点号 点名 编号 序号 名称 id号",
    "line": "lin lines rows ypix ypixel pixely py imgy imagey yimg yimage lineno zeile bildzeile "
            "bildy ligne rangee fila linea riga linha wiersz rij regel 行 行号 行数 行坐标",
    "sample": "samples samp cols columns xpix xpixel pixelx pix px imgx imagex ximg ximage spalte "
              "bildspalte bildx colonne columna muestra colonna campione coluna kolumna kolom "
              "列 列号 列数 列坐标",
    "x": "e east lng long easting pointx lange laenge langengrad laengengrad rechtswert ostwert "
         "ost longitud longitudine este est leste xl93 dlugosc wschod lengte "
         "lengtegraad oost 经度 东经 东坐标",
    "y": "n north nord norte northing pointy breite breitengrad hochwert nordwert latitud "
         "latitudine yl93 szerokosc polnoc breedte breedtegraad noord 纬度 北纬 北坐标",
    "z": "hohe hoehe hoheunn hoheunhn hauteur altura altitud altitudine altezza cota quota "
         "elevazione elevacion elevacao wysokosc hoogte pointz ellipsoidalheight ellheight "
         "高程 高度 高 大地高 海拔"}.items()}
FOREIGN = frozenset(name for name in frozenset().union(*_FURTHER.values()) if not name.isascii())
"""Names that only one encoding of Chinese text gives."""

CENTRAL_EUROPEAN = ("wysokość", "długość", "szerokość", "północ")
"""Names, as they are written in Poland, that only one encoding of a text gives."""

_UNIT = re.compile(r"\s*[\[({<【].*$|[\s_.-]+(px|pix|pixels?|m|deg|degrees?|dms|wgs84|utm)$")


def folded(name: str) -> str:
    """Return a name without accents, signs and capitals."""
    # The stroke of ł is no accent to Unicode.
    letters = unicodedata.normalize("NFKD", name.casefold().replace("ł", "l"))
    without_accents = "".join(sign for sign in letters if not unicodedata.combining(sign))
    return re.sub(r"[\W_]", "", without_accents)


@lru_cache(10_000)
def _forms(name: str) -> tuple[str, str]:
    """Return a name, and the same without its unit: X (px) may be x_px, and Line (px) is line."""
    normal = unicodedata.normalize("NFKC", name.strip().casefold())
    return folded(normal), folded(_UNIT.sub("", normal))


@lru_cache(100)
def _names(aliases: tuple[tuple[str, tuple[str, ...]], ...],
           ) -> tuple[dict[str, tuple[frozenset[str], frozenset[str]]], frozenset[str]]:
    """Return the plain and the further names of each meaning, and all of them."""
    names = {}
    for meaning, plain_names in aliases:
        base, end = _parted(meaning)
        # Readers of other programs' tables have meanings of these names, too, and no further names.
        is_own = plain_names == (POINTS | LINES).get(meaning)
        further = frozenset(f"{name}{end}" for name in _FURTHER.get(base, ()) if is_own)
        names[meaning] = (frozenset(map(folded, plain_names)), further)
    return names, frozenset().union(*chain.from_iterable(names.values()))


def matches(header: Sequence[str], aliases: Aliases) -> dict[str, list[int]]:
    """Return the columns that could hold each meaning, by their names."""
    names_of, all_names = _names(tuple(
        (meaning, tuple(names)) for meaning, names in aliases.items()))
    # Most rows that are asked about hold numbers, none of which is a name.
    forms = {i: pair for i, pair in enumerate(map(_forms, header))
             if not all_names.isdisjoint(pair)}
    columns: dict[str, list[int]] = {}
    all_columns: dict[str, list[int]] = {}
    for meaning, (plain_names, further_names) in names_of.items():
        plain, further = ([i for i, (full, bare) in forms.items()
                           if full in names or (bare in names and full not in all_names)]
                          for names in (plain_names, further_names))
        # Names in other languages count where no column has one of the plain names.
        columns[meaning] = plain or further
        all_columns[meaning] = [*plain, *(i for i in further if i not in plain)]
    if {"line", "sample", "x", "y"} <= columns.keys():
        columns |= _pixels_next_to_degrees(header, all_columns)
    if columns.get("y") and not columns.get("x"):  # n numbers points, unless e is next to it
        columns["y"] = [i for i in columns["y"] if forms[i][0] != "n"]
    return columns


def _pixels_next_to_degrees(header: Sequence[str],
                            named: Mapping[str, list[int]]) -> dict[str, list[int]]:
    """Return the columns of x, y, lon and lat where x and y are pixels, as MapWarper has them.

    That is where both stand in one header, and no column is called line or sample.
    """
    plain = {axis: [i for i in named[axis] if header[i].strip().casefold() == axis]
             for axis in "xy"}
    ground = {axis: [i for i in named[axis] if i not in plain[axis]] for axis in "xy"}
    if named["line"] or named["sample"] or any(
            len(columns) != 1 for part in (plain, ground) for columns in part.values()):
        return {}
    return {"sample": plain["x"], "line": plain["y"], "x": ground["x"], "y": ground["y"]}


def _parted(meaning: str) -> tuple[str, str]:
    """Return a meaning without the end of a line that it is of, and that end."""
    return (meaning[:-1], meaning[-1]) if meaning[-1] in "12" else (meaning, "")


def columns_text(columns: str | Mapping[str, object]) -> str:
    """Return the text of ``--columns`` for a mapping of the same meaning, or the text itself."""
    return columns if isinstance(columns, str) else ",".join(
        f"{meaning}={column}" for meaning, column in columns.items())


def parse_columns(text: str) -> dict[str, str]:
    """Return the name or number of a column by its meaning, of pairs "line=Zeile,sample=4"."""
    meanings = POINTS | LINES | CORNER
    columns: dict[str, str] = {}
    for pair in filter(None, map(str.strip, text.split(","))):
        # The first : or = parts meaning and name, so that a name may hold either.
        meaning, sign, name = re.sub("[:=]", "\0", pair, count=1).partition("\0")
        meaning = meaning.strip().lower()
        name = name.strip()
        if not sign or not name:
            raise TermselError(f"{meaning!r} does not declare a column",
                               hint="Write meaning=name or meaning=number, such as "
                                    "--columns x=Rechtswert,line=4.")
        if meaning not in meanings:
            raise unknown_name("meaning of a column", meaning, meanings)
        if meaning in columns:
            raise TermselError(f"the column of {meaning} is declared twice",
                               hint="Declare it once.")
        columns[meaning] = name
    return columns


def declared(header: Sequence[str], columns: Mapping[str, str]) -> dict[str, int]:
    """Return the columns that the user declares by name, or number from 1, and this table has."""
    names = [name.strip().casefold() for name in header]
    numbers = {}
    for meaning, name in columns.items():
        if name.casefold() in names:
            numbers[meaning] = names.index(name.casefold())
        elif name.isdecimal() and 1 <= int(name) <= len(header):
            numbers[meaning] = int(name) - 1
    return numbers
