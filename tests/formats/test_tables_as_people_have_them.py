"""Files of points as people have them: sixty kinds, each written here and read back."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import termsel
from termsel.core.errors import TermselError
from termsel.data.tables.columns import BadCell, decimal_signs, read_numbers
from termsel.plugins.registry import registry
from termsel.testing import check
from tests.kinds_of_tables import (
    BINARY,
    DECLARED,
    EN,
    HEIGHT,
    IDS,
    LAT,
    LINE,
    LON,
    QUOTES,
    SAMPLE,
    TEXTS,
    N,
    agree,
    comma,
    frame_of,
    geojson,
    plain,
    sheet,
    table,
    values,
)


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
    assert f"columns={caught.value.options['--columns']!r}" in str(caught.value)
    agree(termsel.read(path, crs="EPSG:4979", columns=caught.value.options["--columns"]))


def test_two_signs_of_one_kind_separate_thousands() -> None:
    signs, _ = decimal_signs({"x": ["1,234,567", "234,567"], "y": ["1.234.567", "1"]})
    assert signs == {"x": ".", "y": ","}


@pytest.mark.parametrize(("text", "value"), [
    ("12 30 36 E", 12.51), ("12 29 60.00 E", 12.5), ("12°59'59.9\"W", -12.999972)])
def test_minutes_and_seconds_are_sixtieths(text: str, value: float) -> None:
    assert read_numbers([text], ".", may_be_blank=False, angle="x") == pytest.approx(value)
    for wrong in ("12 75 36 E", "12 30 70 E"):
        with pytest.raises(BadCell, match=r"has 7[05] (minutes|seconds): an angle has at most 60"):
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
    assert "decimal='comma' or decimal='point'" in str(caught.value)
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
    for given, source in ((path, str(path)), (str(path), str(path)), (rows, expected.data.source)):
        result = termsel.run(features=given, crs="EPSG:4979")
        assert result.data.source == source
        assert result.rmse["control"] == expected.rmse["control"]
        fitted = termsel.fit(given, "affine", crs="EPSG:4979")
        assert fitted.rmse(features.points) == termsel.fit(features, "affine").rmse(features.points)


ACCEPTED = "a FeatureSet, the name of a file, a DataFrame"


@pytest.mark.parametrize(("given", "message"), [
    (5, ACCEPTED), ([1, 2], ACCEPTED), (b"x", ACCEPTED),
    ({"a": 3}, "Give each column a list"), (np.zeros((3, 5)), "Name the columns")])
def test_other_types_are_refused_with_what_is_accepted(given: Any, message: str) -> None:
    for verb in (lambda: termsel.run(features=given, crs="local"),
                 lambda: termsel.fit(given, crs="local"), lambda: termsel.read(given, crs="local")):
        with pytest.raises(TermselError, match=message):
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
    "header alone": (CLEAN.split(b"\n")[0], "there is a header and no row below it"),
    "header again": (CLEAN + CLEAN, "line 16, column 'Row': 'Row' is not a number"),
    "two equal ids": (changed(5, 0, "P2"), "line 6, column 'Name': id 'P2' is already used on"),
    "sign and side": (changed(-1, 1, "-*E"), "line 2, column 'Lon': '-1"),
    "wrong side": (changed(-1, 1, "*N"), "is a latitude in the column of x"),
    "O": (changed(-1, 1, "*O"), "east in German and west in Romance languages"),
    "60 minutes": (changed(3, 1, "10°75'2\"E"), "has 75 minutes: an angle has at most 60"),
    "NaN": (changed(3, 4, "NaN"), "line 4, column 'Row': 'NaN' is not a finite number"),
    "no answer": (changed(3, 3, "n/a"), "line 4, column 'Height': 'n/a' is not a number"),
    "an open quote": (changed(3, 0, '"P3'), "line 4: the row that begins here cannot be read"),
    "a foot": (CLEAN + b"Source: survey\n", "line 16: the row ends after 1 of 6 cells"),
    "a sum": (CLEAN + b"Sum,,,,1,2\n", "line 16, column 'Lon': the cell is blank"),
    "two signs": (changed(3, 3, "10.5").replace(b",", b";").replace(b"10.5", b"10,5"),
                  "line 4, column 'Height': '10,5' has a decimal comma"),
    "two places": (b"id,x,easting,lat,h,line\n1,2,3,4,5,6\n",
                   "columns 'x' and 'easting' both mean x|sample"),
    "JSON": (b'{"a": 1}', "this is JSON without control points that termsel reads"),
    "GeoJSON without pixels": (geojson(lambda i: {"a": i}), "has ground coordinates alone"),
    "cut database": (b"SQLite format 3\0" + bytes(52) + b"GP10" + bytes(99),
                     "cannot read|no geometry"),
    "unknown column": (CLEAN.replace(b"Row", b"Quux"), "columns='id=Name,line=Quux,"),
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
    (lambda p: p.write_bytes(b"PK\x03\x04" + b"x" * 99),
     "this spreadsheet cannot be read: it is damaged, or no spreadsheet")])
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
    agree(termsel.read(path, crs="EPSG:4979", swapped="xy"))
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
    shown = capsys.readouterr().err
    assert "Ready to run" not in shown
    ready = shown.partition("Guess 1 of 2, to check: termsel ")[2].partition("\n")[0]
    with pytest.raises(SystemExit) as ended:
        cli.main(shlex.split(ready))
    assert not ended.value.code
    assert capsys.readouterr().out.startswith(f"{path.name}: {N} points, EPSG:4979")


def test_a_command_that_is_shown_has_what_was_given_once(tmp_path: Path,
                                                       call: Callable[..., Any]) -> None:
    import shlex

    path = tmp_path / "points.csv"
    rows = [f"G{i},{7 * i % 90},{11 * i % 80},{500000 + 110 * i % 800},{4000000 - 70 * i % 900}"
            for i in range(20)]
    path.write_text("\n".join(["n,r,c,east,north", *rows]))
    asked = ["run", "--points", path, "--model", "poly2d", "--columns", "line=r", "--columns=id=n"]
    assert "--columns is given 2 times" in call(*asked).stderr
    shown = call(*asked[:-1]).stderr.partition("A guess, to check: termsel ")[2]
    assert shown.count("--columns") == 1
    assert "sample=c" in shown
    done = call(*shlex.split(shown), "--crs", "local", "--quiet")
    assert done.exit_code == 0, done.stderr


DEGREES = {"--crs": "EPSG:4979"}


@pytest.mark.parametrize(("content", "options"), [
    (table("id|x|y|z|line|sample"), DEGREES),
    (table("id|x|y|line|sample", order="ixyls"), {"--crs": "EPSG:4326"}),
    (table("id|x|y|z|line|sample", order="iyxzls"), {**DEGREES, "--set": "swapped=xy"}),
    (table("id|x|y|z|line|sample", degrees=(plain(8), lambda lat: f"{lat + 70:.8f}")),
     {**DEGREES, "--set": "swapped=xy"}),
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
        settings = dict([options["--set"].split("=")]) if "--set" in options else {}
        termsel.read(path, crs=options["--crs"], columns=options.get("--columns"), **settings)


@pytest.mark.parametrize("kind", ["sheet", "OpenDocument", "GeoPackage", "FlatGeobuf"])
def test_readers_of_binary_files_pass_the_suite(kind: str, tmp_path: Path) -> None:
    path = BINARY[kind](tmp_path)
    names = {entry.name: entry.object for entry in registry().entries("readers")}
    reader = names["vector-points" if path.suffix in (".gpkg", ".fgb") else "points-csv"]
    expected = reader().read(path)
    agree(replace(expected, crs="EPSG:4979"))
    check(reader(), content=path.read_bytes(), expected=expected, filename=path.name)


@pytest.mark.parametrize(("names", "ids"), [
    (["", "", ""], ("P1", "P2", "P3")), (["", "church", ""], ("P1", "church", "P3"))])
def test_names_may_be_blank(names: list[str], ids: tuple[str, ...], tmp_path: Path,
                            caplog: pytest.LogCaptureFixture) -> None:
    """In the table that MapWarper takes and gives, x,y,lon,lat,name, few points have a name."""
    places = [(1145, 825, -2.9085, 53.3825), (1028, 857, -2.9129, 53.3829),
              (905, 977, -2.9168, 53.3815)]
    path = tmp_path / "gcps.csv"
    path.write_text("x,y,lon,lat,name\n" + "".join(
        f"{','.join(map(str, place))},{name}\n" for place, name in zip(places, names, strict=True)))
    with caplog.at_level(logging.INFO, logger="termsel"):
        points = termsel.read(path, crs="EPSG:4326").points
    assert points.ids == ids
    np.testing.assert_array_equal(points.image, [place[1::-1] for place in places])
    assert "where column 'name' of" in caplog.text
