"""Files of points as people have them: sixty kinds, each written here and read back."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import termsel
from termsel.errors import TermselError
from termsel.measurements.tables.numbers import BadCell, decimal_signs, read_numbers
from termsel.plugins.registry import registry
from termsel.testing import check

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


@pytest.mark.parametrize("kind", TEXTS)
def test_text_is_read_as_it_is(kind: str, tmp_path: Path) -> None:
    content, crs = TEXTS[kind]
    path = tmp_path / "points.txt"
    path.write_bytes(content)
    given = None if crs == "file" else crs if crs.startswith("EPSG") else "EPSG:4979"
    features = termsel.read(path, crs=given)
    agree(features, flat=crs.startswith("EPSG"), within=0.006 if crs == "rounded" else 0.0006)


@pytest.mark.parametrize("kind", DECLARED)
def test_declared_columns_are_read(kind: str, tmp_path: Path) -> None:
    content, columns = DECLARED[kind]
    path = tmp_path / "points.txt"
    path.write_bytes(content)
    agree(termsel.read(path, crs="EPSG:4979", columns=columns))
    agree(termsel.read(path, crs="EPSG:4979",
                       columns=dict(pair.split("=") for pair in columns.split(","))))


@pytest.mark.parametrize("kind", BINARY)
def test_files_of_other_programs_are_read(kind: str, tmp_path: Path) -> None:
    agree(termsel.read(BINARY[kind](tmp_path), crs="EPSG:4979"))


def test_there_are_sixty_kinds() -> None:
    assert len(TEXTS) + len(DECLARED) + len(BINARY) >= 60


# What cannot be understood is answered with a command


@pytest.mark.parametrize("kind", ["no header", "no header and commas",
                                  "no header, decimal commas"])
@pytest.mark.parametrize("order", ["ixyzls", "ixyzsl", "islxyz", "ilsxyz"])
def test_the_command_for_a_table_without_header_is_right(kind: str, order: str, tmp_path: Path,
                                                         ) -> None:
    more: dict[str, Any] = {"no header": {"delimiter": " "}, "no header and commas":
                            {"delimiter": ","}}.get(kind, {
                                "degrees": comma(8), "height": comma(2), "pixels": comma(3)})
    path = tmp_path / "points.txt"
    path.write_bytes(table("", order=order, **more))
    with pytest.raises(TermselError, match="no header that names its columns") as caught:
        termsel.read(path, crs="EPSG:4979")
    assert f"--columns {caught.value.options['--columns']!r}" in str(caught.value)
    agree(termsel.read(path, crs="EPSG:4979", columns=caught.value.options["--columns"]))


def test_two_signs_of_one_kind_separate_thousands() -> None:
    signs, _ = decimal_signs({"x": ["1,234,567", "234,567"], "y": ["1.234.567", "1"]})
    assert signs == {"x": ".", "y": ","}


@pytest.mark.parametrize(("text", "value"), [("12 30 36 E", 12.51), ("12°59'59.9\"W", -12.999972)])
def test_minutes_and_seconds_are_sixtieths(text: str, value: float) -> None:
    assert read_numbers([text], ".", may_be_blank=False, angle="x") == pytest.approx(value)
    for wrong in ("12 60 36 E", "12 30 60 E"):
        with pytest.raises(BadCell, match="60 or more minutes or seconds"):
            read_numbers([wrong], ".", may_be_blank=False, angle="x")


@pytest.mark.parametrize("numbered", [True, False])
def test_bare_numbers_without_heights_are_advised_on(numbered: bool, tmp_path: Path) -> None:
    path = tmp_path / "points.txt"
    columns = np.column_stack([*[np.arange(1, len(IDS) + 1)] * numbered, LON, LAT, LINE, SAMPLE])
    path.write_text("\n".join(" ".join(f"{value:.9g}" for value in row) for row in columns))
    with pytest.raises(TermselError, match="no header that names its columns") as caught:
        termsel.read(path, crs="EPSG:4979")
    points = termsel.read(path, crs="EPSG:4979", columns=caught.value.options["--columns"]).points
    np.testing.assert_allclose(points.image, np.column_stack([LINE, SAMPLE]), rtol=1e-8)
    assert points.ids[:2] == (("1", "2") if numbered else ("P1", "P2"))


def test_the_command_holds_what_was_recognised(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_bytes(table("Nr|Länge|Breite|Höhe|bild v|bild u"))
    with pytest.raises(TermselError) as caught:
        termsel.read(path, crs="EPSG:4979")
    for pair in ("id=Nr", "x=Länge", "y=Breite", "z=Höhe"):
        assert pair in caught.value.options["--columns"].split(",")


# Decimal signs: by evidence, or on request


def small(rows: list[str]) -> bytes:
    return ("id;x;y;z;line;sample\n" + "\n".join(rows)).encode()


OPEN = small(["a;10;47;5;1,234;2,345", "b;11;48;6;1,235;3,456", "c;12;47;8;4,234;5,345"])


@pytest.mark.parametrize(("decimal", "line"), [("comma", 1.234), ("point", 1234.0)])
def test_what_the_file_leaves_open_is_asked(tmp_path: Path, decimal: str, line: float) -> None:
    path = tmp_path / "p.csv"
    path.write_bytes(OPEN)
    with pytest.raises(TermselError, match="may be above one thousand or not") as caught:
        termsel.read(path, crs="local")
    assert (caught.value.line, caught.value.column) == (2, "line")
    assert "--set decimal=comma or decimal=point" in str(caught.value)
    assert termsel.read(path, crs="local", decimal=decimal).points.image[0, 0] == line


@pytest.mark.parametrize(("x", "line"), [("10,5", 1234.0), ("10.5", 1.234)])
def test_other_columns_decide_and_a_note_says_so(tmp_path: Path, x: str, line: float,
                                                 caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "p.csv"
    path.write_bytes(small([f"a;{x};47;5;1.234;2.345", f"b;1{x};48;6;1.235;3.456"]))
    with caplog.at_level("INFO", "termsel"):
        assert termsel.read(path, crs="local").points.image[0, 0] == line
    assert ("the other sign separates thousands in the columns line, sample" in caplog.text) \
        == (line > 1000)


def test_columns_without_numbers_have_no_decimal_sign_to_note(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "p.csv"
    path.write_bytes(small([f"{name};10.5;4{i}.25;;{i}.5;3.75" for i, name in enumerate("abc")]))
    with caplog.at_level("INFO", "termsel"):
        termsel.read(path, crs="local")
    assert "the other sign separates thousands" not in caplog.text


def test_ids_by_number_are_noted(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "p.csv"
    path.write_bytes(TEXTS["no ids"][0])
    with caplog.at_level("INFO", "termsel"):
        termsel.read(path, crs="EPSG:4979")
    assert "no column of ids, so its rows are called P1, P2" in caplog.text


# Tables in Python


def test_tables_of_python_are_read() -> None:
    pandas = pytest.importorskip("pandas")
    geopandas = pytest.importorskip("geopandas")
    columns = {"name": IDS, "Länge": LON, "lat": LAT, "h": HEIGHT, "row": LINE, "col": SAMPLE}
    frame = pandas.DataFrame(columns)
    for given in (frame, frame.set_index("name"), frame.to_dict("records"), columns):
        agree(termsel.read(given, crs="EPSG:4979"))
    places = geopandas.GeoDataFrame(frame[["name", "row", "col"]], crs="EPSG:4979",
                                    geometry=geopandas.points_from_xy(LON, LAT, HEIGHT))
    agree(termsel.read(places))
    agree(termsel.read(frame_of(("row", "col"), flat=True)))
    renamed = frame.rename(columns={"row": "v", "col": "u"})
    agree(termsel.read(renamed, crs="EPSG:4979", columns={"line": "v", "sample": "u"}))


def test_run_and_fit_take_files_and_tables(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_bytes(TEXTS["commas"][0])
    features = termsel.read(path, crs="EPSG:4979")
    expected = termsel.run(features=features)
    rows = [{"id": p, "lon": x, "lat": y, "h": z, "line": line, "sample": s} for p, x, y, z, line, s
            in zip(IDS, *features.points.ground.T, *features.points.image.T, strict=True)]
    for given in (path, str(path), rows):
        result = termsel.run(features=given, crs="EPSG:4979")
        assert result.rmse["control"] == expected.rmse["control"]
        fitted = termsel.fit(given, "affine", crs="EPSG:4979")
        assert fitted.rmse(features.points) == termsel.fit(features, "affine").rmse(features.points)
    assert termsel.run(features=path, crs="EPSG:4979").data.source == str(path)


@pytest.mark.parametrize("given", [5, [1, 2], b"x", {"a": 3}, np.zeros((3, 5))])
def test_other_types_are_refused_with_what_is_accepted(given: Any) -> None:
    for verb in (lambda: termsel.run(features=given, crs="local"),
                 lambda: termsel.fit(given, crs="local"), lambda: termsel.read(given, crs="local")):
        with pytest.raises(TermselError, match="a FeatureSet, the name of a file, a DataFrame"):
            verb()


def test_a_crs_for_features_that_have_one_is_refused() -> None:
    scene = termsel.simulate_scene("ikonos-hamedan")
    with pytest.raises(TermselError, match="have the CRS EPSG:4979 already"):
        termsel.run(features=scene, crs="EPSG:4979")


# Files that no one can read, and files that are not what they seem


def changed(row: int, column: int, text: str) -> bytes:
    """Return the points with one other cell; -1 stands for every row."""
    rows = [line.split(",") for line in TEXTS["commas"][0].decode().splitlines()]
    for i in range(1, N + 1):
        if row in (i, -1):
            rows[i][column] = text.replace("*", rows[i][column])
    return "\n".join(map(",".join, rows)).encode()


CLEAN = TEXTS["commas"][0]
HOSTILE: dict[str, tuple[bytes, str]] = {
    "empty": (b"", "the file is empty"),
    "blank": (b"\n \n", "the file is empty"),
    "binary": (bytes(range(256)) * 9, "this binary file is in no format"),
    "no spreadsheet": (b"PK\x03\x04" + bytes(99), "this binary file is in no format"),
    "half of UTF-16": (CLEAN.decode().encode("utf-16")[:301], "is not UTF-16"),
    "zero bytes": (CLEAN.replace(b"P7", b"P\0"), "binary"),
    "100,000 columns": (b",".join([b"c"] * 100_000) + b"\n", "the first row has 100,000 cells"),
    "prose": (b"This is a letter.\nIt has lines, and commas.\n", "in no format"),
    "header alone": (CLEAN.split(b"\n")[0], "line 1: there are no rows below the header"),
    "header again": (CLEAN + CLEAN, "line 16, column 'Row': 'Row' is not a number"),
    "two equal ids": (changed(5, 0, "P2"), "line 6, column 'Name': id 'P2' is already used on"),
    "sign and side": (changed(-1, 1, "-*E"), "line 2, column 'Lon': '-1"),
    "wrong side": (changed(-1, 1, "*N"), "is a latitude in the column of x"),
    "O": (changed(-1, 1, "*O"), "east in German and west in Romance languages"),
    "60 minutes": (changed(3, 1, "10°75'2\"E"), "has 60 or more minutes or seconds"),
    "NaN": (changed(3, 4, "NaN"), "line 4, column 'Row': 'NaN' is not a finite number"),
    "no answer": (changed(3, 3, "n/a"), "line 4, column 'Height': 'n/a' is not a number"),
    "an open quote": (changed(3, 0, '"P3'), "line 4: the row that begins here cannot be read"),
    "a foot": (CLEAN + b"Source: survey\n", "line 16: the row has 1 cells"),
    "a sum": (CLEAN + b"Sum,,,,1,2\n", "line 16, column 'Lon': the cell is blank"),
    "two signs": (changed(3, 3, "10.5").replace(b",", b";").replace(b"10.5", b"10,5"),
                  "line 4, column 'Height': '10,5' has a decimal comma"),
    "two places": (b"id,x,y,lon,lat,h\n1,2,3,4,5,6\n", "columns 'x' and 'lon' both mean x|line"),
    "JSON": (b'{"a": 1}', "in no format that termsel knows"),
    "GeoJSON without pixels": (geojson(lambda i: {"a": i}), "there is no column for line"),
    "cut database": (b"SQLite format 3\0" + bytes(52) + b"GP10" + bytes(99),
                     "cannot read|no geometry"),
    "unknown column": (CLEAN.replace(b"Row", b"Quux"), "--columns 'id=Name,line=Quux,"),
}


@pytest.mark.parametrize("kind", HOSTILE)
def test_a_hostile_file_gives_one_message(kind: str, tmp_path: Path) -> None:
    content, message = HOSTILE[kind]
    path = tmp_path / "points.csv"
    path.write_bytes(content)
    with pytest.raises(TermselError) as caught:
        termsel.read(path, crs="EPSG:4979")
    assert str(caught.value).startswith(str(path))
    assert any(part in str(caught.value) for part in message.split("|")), caught.value


@pytest.mark.parametrize(("make", "message"), [
    (lambda p: sheet(p, []), "no visible sheet has a table of points"),
    (lambda p: sheet(p, [*values(EN.split("|"))[:4], ["P9", None, 47.0, 1.0, 2.0, 3.0]]),
     "line 5, column 'Lon': the cell is blank"),
    (lambda p: sheet(p, [*values(EN.split("|")), ["P99", "=A1+1", 47.0, 1.0, 2.0, 3.0]]),
     "column 'Lon': the cell is blank"),
    (lambda p: p.write_bytes(b"PK\x03\x04"), "this spreadsheet cannot be read")])
def test_a_hostile_spreadsheet_gives_one_message(make: Callable[[Path], None], message: str,
                                                 tmp_path: Path) -> None:
    pytest.importorskip("python_calamine")
    make(tmp_path / "p.xlsx")
    with pytest.raises(TermselError, match=message):
        termsel.read(tmp_path / "p.xlsx", crs="EPSG:4979")


def test_degrees_and_decimals_may_stand_in_one_column(tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    path.write_bytes(changed(3, 1, QUOTES[0](LON[2])))
    agree(termsel.read(path, crs="EPSG:4979"))


def test_swapped_longitude_and_latitude_are_noted(tmp_path: Path, caplog: pytest.LogCaptureFixture,
                                                  ) -> None:
    path = tmp_path / "p.csv"
    path.write_bytes(table("id|x|y|z|line|sample", order="iyxzls"))
    termsel.read(path, crs="EPSG:4979")
    assert "Warning: x and y look swapped" in caplog.text
    caplog.clear()
    agree(termsel.read(path, crs="EPSG:4979", columns="x=y,y=x"))
    assert not caplog.text


def test_the_command_line_shows_a_command_that_runs(tmp_path: Path,
                                                    capsys: pytest.CaptureFixture[str]) -> None:
    import shlex

    from termsel.cli.main import cli

    path = tmp_path / "points.txt"
    path.write_bytes(DECLARED["no header"][0])
    asked = ["run", "--points", str(path), "--quiet"]
    with pytest.raises(SystemExit) as ended:
        cli.main(asked)
    assert ended.value.code == 2
    ready = capsys.readouterr().err.partition("Ready to run: termsel ")[2]
    with pytest.raises(SystemExit) as ended:
        cli.main(shlex.split(ready))
    assert not ended.value.code
    assert capsys.readouterr().out.startswith(f"Read: {path.name}: {N} points; EPSG:4979")


DEGREES = {"--crs": "EPSG:4979"}


@pytest.mark.parametrize(("content", "options"), [
    (table("id|x|y|z|line|sample"), DEGREES),
    (table("id|x|y|line|sample", order="ixyls"), {"--crs": "EPSG:4326"}),
    (table("id|x|y|z|line|sample", order="iyxzls"), {**DEGREES, "--columns": "x=y,y=x"}),
    (table("id|x|y|z|line|sample", degrees=(plain(8), lambda lat: f"{lat + 70:.8f}")),
     {**DEGREES, "--columns": "x=y,y=x"}),
    (table("", delimiter=","), {**DEGREES, "--columns": "id=1,line=5,sample=6,x=2,y=3,z=4"}),
    (table("id|x|y|z|line|sample", order="ienzls"), {}),
    # Metres of an own plane.
    (table("id|x|y|z|line|sample", degrees=(lambda lon: f"{lon - 11:.8f}",
                                            lambda lat: f"{lat - 47:.8f}")), {}),
    (table("id|x|y|z|line|sample", degrees=lambda value: f"{value % 1 * 1000:.3f}"), {})])
def test_a_file_without_crs_is_answered_with_one_command(content: bytes, options: dict[str, str],
                                                         tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_bytes(content)
    with pytest.raises(TermselError) as caught:
        termsel.read(path)
    assert caught.value.options == options
    if options:
        termsel.read(path, crs=options["--crs"], columns=options.get("--columns"))


@pytest.mark.parametrize("kind", ["sheet", "OpenDocument", "GeoPackage", "FlatGeobuf"])
def test_readers_of_binary_files_pass_the_suite(kind: str, tmp_path: Path) -> None:
    path = BINARY[kind](tmp_path)
    names = {entry.name: entry.object for entry in registry().entries("readers")}
    reader = names["vector-points" if path.suffix in (".gpkg", ".fgb") else "points-csv"]
    expected = reader().read(path)
    agree(replace(expected, crs="EPSG:4979"))
    check(reader(), content=path.read_bytes(), expected=expected, filename=path.name)
