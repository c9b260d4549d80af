"""Tables as people have them: the same points in some sixty kinds of files."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import termsel

N = 14
RNG = np.random.default_rng(11)
LON, LAT = RNG.uniform(10.9, 11.1, N), RNG.uniform(47.3, 47.45, N)
HEIGHT = np.round(RNG.uniform(600, 1900, N), 2)
EAST, NORTH = np.round(690_000 + 70_000 * (LON - 11), 2), np.round(5_250_000 + 1e5 * LAT - 47e5, 2)
LINE = np.round(4000 - 48_000 * (LAT - 47.375) + HEIGHT / 5, 3)
SAMPLE = np.round(5000 + 45_000 * (LON - 11), 3)
IDS = [f"P{i + 1}" for i in range(N)]
Cell = Callable[[float], str]


def plain(digits: int) -> Cell:
    return lambda value: f"{value:.{digits}f}"


def comma(digits: int) -> Cell:
    return lambda value: f"{value:.{digits}f}".replace(".", ",")


def german(digits: int) -> Cell:
    """Return numbers such as 2.074,44."""
    return lambda value: f"{value:,.{digits}f}".translate(str.maketrans(",.", ".,"))


def grouped(digits: int, sign: str) -> Cell:
    return lambda value: f"{value:,.{digits}f}".replace(",", sign)


def dms(form: str, sides: str) -> Cell:
    """Return angles; the form takes degrees, minutes, seconds and the side."""
    def angle(value: float) -> str:
        seconds = round(abs(value) * 3600, 4)
        return form.format(d=int(seconds // 3600), m=int(seconds % 3600 // 60), s=seconds % 60,
                           side=sides[int(value < 0)], minutes=seconds % 3600 / 60)
    return angle


def table(header: str, *, delimiter: str = ";", degrees: Cell | tuple[Cell, Cell] = plain(8),
          height: Cell = plain(2), pixels: Cell = plain(3), order: str = "ixyzls",
          title: str = "", units: str = "", encoding: str = "utf-8") -> bytes:
    """Return a text of the points, with columns i, x, y, z, l, s in some order."""
    x_cell, y_cell = degrees if isinstance(degrees, tuple) else (degrees, degrees)
    made = {"i": IDS, "x": map(x_cell, LON), "y": map(y_cell, LAT), "z": map(height, HEIGHT),
            "l": map(pixels, LINE), "s": map(pixels, SAMPLE), "e": map(plain(2), EAST),
            "n": map(plain(2), NORTH), "-": ["road"] * N}
    text = io.StringIO()
    rows = csv.writer(text, delimiter=delimiter, lineterminator="\n")
    if header:
        rows.writerow(header.split("|"))
    if units:
        rows.writerow(units.split("|"))
    rows.writerows(zip(*(made[one] for one in order), strict=True))
    return (title + text.getvalue()).encode(encoding)


def sheet(path: Path, rows: list[list[Any]], *, title: bool = False, hidden: bool = False) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    pytest.importorskip("python_calamine")
    book = openpyxl.Workbook()
    page = book.active
    if hidden:
        page.append(["id", "line", "sample", "x", "y", "z"])
        page.append(["old", 1, 2, 3, 4, 5])
        page.sheet_state = "hidden"
        page = book.create_sheet("Punkte")
    if title:
        page.append(["Ground control of 2024"])
        page.merge_cells("A1:F1")
        page.append([])
    for row in rows:
        page.append(row)
    book.save(path)


def ods(path: Path, rows: list[list[Any]]) -> None:
    pytest.importorskip("odf")
    pytest.importorskip("python_calamine")
    from odf.opendocument import OpenDocumentSpreadsheet
    from odf.table import Table, TableCell, TableRow
    from odf.text import P

    book = OpenDocumentSpreadsheet()
    page = Table(name="points")
    for row in rows:
        line = TableRow()
        for value in row:
            number = isinstance(value, float)
            cell = TableCell(valuetype="float", value=value) if number else \
                TableCell(valuetype="string")
            cell.addElement(P(text=str(value)))
            line.addElement(cell)
        page.addElement(line)
    book.spreadsheet.addElement(page)
    book.save(path)


def values(header: list[str]) -> list[list[Any]]:
    return [header, *([name, *map(float, row)] for name, *row in
                      zip(IDS, LON, LAT, HEIGHT, LINE, SAMPLE, strict=True))]


def frame_of(names: tuple[str, str], *, flat: bool = False) -> Any:
    """Return a GeoDataFrame; if flat, heights are a column."""
    geopandas = pytest.importorskip("geopandas")
    heights = {"elev": HEIGHT} if flat else {}
    return geopandas.GeoDataFrame(
        {"id": IDS, names[0]: LINE, names[1]: SAMPLE, **heights},
        geometry=geopandas.points_from_xy(LON, LAT, None if flat else HEIGHT), crs="EPSG:4979")


def layer(path: Path, names: tuple[str, str], *, flat: bool = False, **more: Any) -> None:
    frame_of(names, flat=flat).to_file(path, **more)


def geojson(properties: Callable[[int], dict[str, Any]]) -> bytes:
    return json.dumps({"type": "FeatureCollection", "features": [
        {"type": "Feature", "properties": properties(i), "geometry": {
            "type": "Point", "coordinates": [LON[i], LAT[i], HEIGHT[i]]}}
        for i in range(N)]}).encode()


EN = "Name|Lon|Lat|Height|Row|Col"
QUOTES = (dms("{d}°{m:02d}'{s:07.4f}\"{side}", "EW"), dms("{d}°{m:02d}'{s:07.4f}\"{side}", "NS"))
HYPHENS = (dms("{side}{d}-{m:02d}-{s:07.4f}", "EW"), dms("{side}{d}-{m:02d}-{s:07.4f}", "NS"))
COMMAS = tuple(lambda value, one=one: one(value).replace(".", ",") for one in QUOTES)
SPACES = (dms("{d} {m:02d} {s:07.4f} {side}", "EW"), dms("{d} {m:02d} {s:07.4f} {side}", "NS"))
LETTERS = (dms("{side}{d}d{m:02d}'{s:07.4f}\"", "EW"), dms("{side}{d}d{m:02d}'{s:07.4f}\"", "NS"))
MINUTES = (dms("{d}° {minutes:.6f}' {side}", "EW"), dms("{d}° {minutes:.6f}' {side}", "NS"))
SIGNED = (dms("{d}:{m:02d}:{s:07.4f}", "  "),) * 2
NUMBERS = "id=1,x=2,y=3,z=4,line=5,sample=6"

TEXTS: dict[str, tuple[bytes, str]] = {
    "commas": (table(EN, delimiter=","), ""),
    "semicolons": (table(EN), ""),
    "tabs": (table(EN, delimiter="\t"), ""),
    "bars": (table(EN, delimiter="|"), ""),
    "spaces": (table("id|x|y|z|line|sample", delimiter=" "), ""),
    "several spaces": (table("id|x|y|z|line|sample", delimiter=" ").replace(b" ", b"   "), ""),
    "separator at the end": (table(EN).replace(b"\n", b";;\n").replace(b"Col;;", b"Col"), ""),
    "capitals": (table("ID|X|Y|Z|LINE|SAMPLE"), ""),
    "units in brackets": (table("Point ID|Longitude (deg)|Latitude (deg)|Height [m]|Line (px)|"
                                "Sample (px)", delimiter=","), ""),
    "x and y of pixels": (table("Point|Easting [m]|Northing [m]|h|Y (px)|X (px)",
                                order="ienzls"), "EPSG:32632"),
    "pixels next to eastings": (table("GCP|X Pixel|Y Pixel|Easting|Northing|Elev",
                                      order="islenz").replace(b";", b","), "EPSG:32632"),
    "units as endings": (table("pt_id|lon_deg|lat_deg|height_m|line_px|sample_px"), ""),
    "units in a row": (table(EN, units="[-]|[deg]|[deg]|[m]|[px]|[px]"), ""),
    "title": (table(EN, title="Ground control, survey of 2024\n\n"), ""),
    "title with separators": (table(EN, title="Survey;2024;;;;\n"), ""),
    "comment": (table(EN, title="# measured in 2024; see notes\n"), ""),
    "declared CRS": (table(EN, title="# crs: EPSG:4979\n", delimiter=","), "file"),
    "other columns": (table("Name|Lon|Lat|Height|Row|Col|Type", order="ixyzls-"), ""),
    "other order": (table("Col|Row|Height|Lat|Lon|Name", order="slzyxi"), ""),
    "accents": (table("Numéro|Longitude|Latitude|Altitude|Ligne|Colonne"), ""),
    "German": (table("Punkt-Nr.|Länge|Breite|Höhe|Zeile|Spalte", degrees=comma(8),
                     height=comma(2), pixels=comma(3)), ""),
    "German without umlauts": (table("Punkt|Laenge|Breite|Hoehe|Bildzeile|Bildspalte"), ""),
    "German map": (table("Nr|Rechtswert|Hochwert|Höhe|Zeile|Spalte", order="ienzls"),
                   "EPSG:25832"),
    "French": (table("Nom|Longitude|Latitude|Hauteur|Ligne|Colonne"), ""),
    "Spanish": (table("Nombre|Longitud|Latitud|Altitud|Fila|Columna"), ""),
    "Spanish map": (table("Punto|Este|Norte|Cota|Línea|Columna", order="ienzls"), "EPSG:25832"),
    "Italian": (table("Nome|Longitudine|Latitudine|Quota|Riga|Colonna"), ""),
    "Portuguese": (table("Ponto|Longitude|Latitude|Altitude|Linha|Coluna"), ""),
    "Chinese": (table("点号|经度|纬度|高程|行号|列号", delimiter=","), ""),
    "Chinese with units": (table("点名|经度（度）|纬度（度）|大地高（米）|行|列"), ""),
    "Chinese in GB 18030": (table("点号|经度|纬度|高程|行号|列号", encoding="gb18030"), ""),
    "east north height": (table("Pt|E|N|H|Row|Col", order="ienzls"), "EPSG:32632"),
    "Windows-1252": (table("Numéro|Longitude|Latitude|Altitude|Ligne|Colonne", degrees=comma(8),
                           height=comma(2), pixels=comma(3), encoding="cp1252"), ""),
    "degree signs in Windows-1252": (table("Nr|Länge|Breite|Höhe|Zeile|Spalte", degrees=QUOTES,
                                           encoding="cp1252"), ""),
    "UTF-8 with a mark": (table(EN, encoding="utf-8-sig"), ""),
    "UTF-16": (table(EN, delimiter="\t", encoding="utf-16"), ""),
    "UTF-16 without a mark": (table(EN, encoding="utf-16-le"), ""),
    "UTF-16, big end first": (table("\ufeff" + EN, encoding="utf-16-be"), ""),
    "line ends of old": (table(EN).replace(b"\n", b"\r"), ""),
    "decimal commas": (table(EN, degrees=comma(8), height=comma(2), pixels=comma(3)), ""),
    "points for thousands": (table(EN, degrees=comma(8), height=german(2), pixels=german(3)), ""),
    "commas for thousands": (table(EN, height=grouped(2, ","), pixels=grouped(3, ",")), ""),
    "quoted commas for thousands": (table(EN, delimiter=",", height=grouped(2, ","),
                                          pixels=grouped(3, ",")), ""),
    "spaces for thousands": (table(EN, degrees=comma(8), height=grouped(2, " "),
                                   pixels=grouped(3, " ")), ""),
    "narrow spaces for thousands": (table(EN, height=grouped(2, "\u202f"),
                                          pixels=grouped(3, "\u202f")), ""),
    "apostrophes for thousands": (table(EN, height=grouped(2, "'"), pixels=grouped(3, "’")), ""),
    "degrees, minutes, seconds": (table(EN, degrees=QUOTES, delimiter=","), ""),
    "the same with commas": (table("Punkt|Länge|Breite|Höhe|Zeile|Spalte", degrees=COMMAS,
                                   height=german(2), pixels=german(2)), "rounded"),
    "spaces between them": (table(EN, degrees=SPACES), ""),
    "letters between them": (table(EN, degrees=LETTERS), ""),
    "hyphens between them": (table(EN, degrees=HYPHENS), ""),
    "degrees and minutes": (table(EN, degrees=MINUTES), ""),
    "colons between them": (table(EN, degrees=SIGNED), ""),
    "no ids": (table("Lon|Lat|Height|Row|Col", order="xyzls"), ""),
    "GeoJSON": (geojson(lambda i: {"id": IDS[i], "line": LINE[i], "sample": SAMPLE[i]}), "file"),
    "GeoJSON of pixels": (geojson(lambda i: {"name": IDS[i], "pixel": SAMPLE[i],
                                             "y_pix": LINE[i]}), "file"),
    "GeoJSON with two names": (geojson(lambda i: {
        "id": IDS[i], "line": LINE[i], ("sample", "pixel")[i % 2]: SAMPLE[i]}), "file"),
    "GeoJSON of Orthority": (geojson(lambda i: {"id": IDS[i], "ji": [SAMPLE[i], LINE[i]]}), "file"),
}

DECLARED: dict[str, tuple[bytes, str]] = {
    "no header": (table("", delimiter=" "), NUMBERS),
    "no header and commas": (table("", delimiter=","), NUMBERS),
    "no header, decimal commas": (table("", degrees=comma(8), height=comma(2), pixels=comma(3)),
                                  NUMBERS),
    "unknown names": (table("a|b|c|d|e|f"), "id=a,x=b,y=c,z=d,line=e,sample=f"),
    "two places": (table("id|x|y|z|v|u"), "line=v,sample=6"),
    "GeoJSON": (geojson(lambda i: {"v": LINE[i], "u": SAMPLE[i]}), "line=v,sample=u"),
}

BINARY: dict[str, Callable[[Path], Path]] = {
    "sheet": lambda f: _made(f / "p.xlsx", lambda p: sheet(p, values(EN.split("|")))),
    "sheet with a title": lambda f: _made(
        f / "p.xlsx", lambda p: sheet(p, values(EN.split("|")), title=True)),
    "second sheet": lambda f: _made(
        f / "p.xlsx", lambda p: sheet(p, values(EN.split("|")), hidden=True)),
    "German sheet": lambda f: _made(
        f / "p.xlsx",
        lambda p: sheet(p, values(["Nr", "Länge", "Breite", "Höhe", "Zeile", "Spalte"]))),
    "OpenDocument": lambda f: _made(f / "p.ods", lambda p: ods(p, values(EN.split("|")))),
    "GeoPackage": lambda f: _made(f / "p.gpkg", lambda p: layer(p, ("line", "sample"))),
    "GeoPackage of pixels": lambda f: _made(f / "p.gpkg", lambda p: layer(p, ("y_pix", "x_pix"))),
    "GeoPackage with a column of heights": lambda f: _made(
        f / "p.gpkg", lambda p: layer(p, ("line", "sample"), flat=True)),
    "GeoJSON with a property of heights": lambda f: _made(
        f / "p.geojson", lambda p: layer(p, ("line", "sample"), flat=True)),
    "Shapefile": lambda f: _made(f / "p.shp", lambda p: layer(p, ("row", "col"))),
    "FlatGeobuf": lambda f: _made(
        f / "p.fgb", lambda p: layer(p, ("Zeile", "Spalte"), SPATIAL_INDEX="NO")),
}


def _made(path: Path, write: Callable[[Path], None]) -> Path:
    write(path)
    return path


def agree(features: termsel.FeatureSet, ids: list[str] | None = IDS, *, flat: bool = False,
          within: float = 0.0006) -> None:
    points = features.points
    assert list(points.ids) == (ids or [f"P{i + 1}" for i in range(N)])
    np.testing.assert_allclose(points.image, np.column_stack([LINE, SAMPLE]), atol=within, rtol=0)
    ground = (EAST, NORTH) if flat else (LON, LAT)
    np.testing.assert_allclose(points.ground[:, :2], np.column_stack(ground), atol=1e-7, rtol=0)
    np.testing.assert_allclose(points.ground[:, 2], HEIGHT, atol=1e-6, rtol=0)
