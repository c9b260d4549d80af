"""Tables of points and lines, reading whole feature sets, and atomic writing."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import termsel
from termsel.core.errors import TermselError
from termsel.data.features import FeatureSet
from termsel.formats.readers.advice import unknown_table_error
from termsel.formats.readers.csv_tables import (
    LinesCsv,
    PointsCsv,
)
from termsel.io.read import read_features
from tests.csv_texts import LINES, POINTS, READERS, A, L, put, read_file


def read(folder: Path, text: str | bytes) -> FeatureSet:
    return read_file(put(folder, text), READERS)


def refusal(folder: Path, text: str | bytes, format: str | None = None) -> TermselError:
    path = put(folder, text)
    with pytest.raises(TermselError) as caught:
        read_file(path, READERS, format)
    assert str(caught.value).startswith(str(path))
    return caught.value


# What is read


def test_points(tmp_path: Path) -> None:
    features = read(tmp_path, POINTS + A + "b,,3,4,6,45,\n")
    points = features.points
    assert features.crs == ""
    assert points.ids == ("a", "b")
    assert points.roles == ("control", "")
    assert points.sigma is None
    np.testing.assert_array_equal(points.image, [[1.5, 2.5], [3, 4]])
    np.testing.assert_array_equal(points.ground, [[5.25, 44.5, 300], [6, 45, np.nan]])


def test_lines(tmp_path: Path) -> None:
    lines = read(tmp_path, LINES + L).lines
    assert lines.ids == ("l",)
    np.testing.assert_array_equal(lines.image, [[[1, 2], [3, 4]]])
    np.testing.assert_array_equal(lines.ground, [[[5, 44, 10], [5.1, 44.1, 20]]])


@pytest.mark.parametrize("header", [
    "name,ROLE,row,col,lon,lat,h", "ID,role,y_px,x_px,Easting,Northing,Height",
    " id , role , Row , pixel , Longitude , Latitude , elevation "])
def test_aliases(tmp_path: Path, header: str) -> None:
    points = read(tmp_path, f"{header}\n{A}").points
    np.testing.assert_array_equal(points.ground, [[5.25, 44.5, 300]])
    np.testing.assert_array_equal(points.image, [[1.5, 2.5]])


def test_aliases_of_lines(tmp_path: Path) -> None:
    text = "name,row1,col1,row2,col2,lon1,lat1,h1,lon2,lat2,h2\n" + L
    assert read(tmp_path, text).lines.ids == ("l",)


@pytest.mark.parametrize("text", [
    "id;role;line;sample;x;y;z\na;control;1,5;2,5;5,25;44,5;300\n",
    "id\trole\tline\tsample\tx\ty\tz\na\tcontrol\t1,5\t2,5\t5,25\t44,5\t300\n",
    "id;role;line;sample;x;y;z\na;control;1.5;2.5;5.25;44.5;300\n",
    '"id","role","line","sample","x","y","z"\n"a","control","1.5","2.5","5.25","44.5","300"\n',
    "\ufeff" + POINTS + A,
    (POINTS + A).replace("\n", "\r\n"),
    (POINTS + A).replace("\n", "\r"),
    "# a note, with commas\n\n" + POINTS + "#\n" + A + "\n,,,,,,\n",
    "id,role,line,sample,x,y,z,remark,remark\na, Control , 1.5 ,2.5,5.25,44.5,3e2,u,v\n",
    (POINTS + A).rstrip(),
])
def test_ways_to_write_one_point(tmp_path: Path, text: str) -> None:
    points = read(tmp_path, text).points
    assert points.ids == ("a",)
    assert points.roles == ("control",)
    np.testing.assert_array_equal(points.image, [[1.5, 2.5]])
    np.testing.assert_array_equal(points.ground, [[5.25, 44.5, 300]])


def test_order_of_columns_is_free(tmp_path: Path) -> None:
    points = read(tmp_path, "z,y,x,sample,line,id\n300,44.5,5.25,2.5,1.5,a\n").points
    np.testing.assert_array_equal(points.image, [[1.5, 2.5]])
    np.testing.assert_array_equal(points.ground, [[5.25, 44.5, 300]])


def test_quoted_cells_keep_delimiters_and_line_ends(tmp_path: Path) -> None:
    text = "note," + POINTS + '"1\n2","a, ""b""",,1,2,3,4,5\n,c,,1,2,3,x,5\n'
    assert refusal(tmp_path, text).line == 4
    assert read(tmp_path, text.replace("3,x", "3,9")).points.ids == ('a, "b"', "c")


def test_sigma(tmp_path: Path) -> None:
    two = read(tmp_path, "id,line,sample,x,y,z,sigma_line,sigma_sample\na,1,2,3,4,5,.5,.25\n")
    one = read(tmp_path, "id,line,sample,x,y,z,sigma_px\na,1,2,3,4,5,.5\n")
    none = read(tmp_path, "id,line,sample,x,y,z,sigma_px\na,1,2,3,4,5,\n")
    np.testing.assert_array_equal(two.points.sigma, [[0.5, 0.25]])
    np.testing.assert_array_equal(one.points.sigma, [[0.5, 0.5]])
    assert none.points.sigma is None


def test_sigma_of_lines(tmp_path: Path) -> None:
    header, row = LINES.strip() + ",sigma\n", L.strip()
    lines = read(tmp_path, f"{header}{row},0.25\n").lines
    np.testing.assert_array_equal(lines.sigma, [0.25])
    assert read(tmp_path, f"{header}{row},\n").lines.sigma is None
    for cell, column, words in ((",", "sigma", "blank here but not in all rows"),
                                (",-1", None, "not positive")):
        error = refusal(tmp_path, f"{header}{row},1\nm,1,2,3,5,5,44,10,5.1,44.2,20{cell}\n")
        assert (error.line, error.column) == (3, column)
        assert words in str(error)


def test_disabled_points_are_off(tmp_path: Path) -> None:
    text = "id,line,sample,x,y,z,enabled\na,1,2,3,4,5,0\nb,1,2,3,5,5,\nc,1,2,3,6,5,TRUE\n"
    assert read(tmp_path, text).points.roles == ("off", "", "")


def test_lines_that_are_off_are_left_out(tmp_path: Path) -> None:
    text = LINES.replace("id", "id,role") + "k,off,0,0,3,4,5,6,7,8,9,0\n" + "l,control" + L[1:]
    assert read(tmp_path, text).lines.ids == ("l",)
    error = refusal(tmp_path, text.replace("control", "check"))
    assert (error.line, error.column) == (3, "role")


def test_columns_are_declared(tmp_path: Path) -> None:
    path = put(tmp_path, "Punkt,Zeile,Spalte,Rechtswert,Hochwert,h\na,1.5,2.5,5.25,44.5,300\n")
    columns = "id:Punkt, line:zeile,sample:Spalte,x:Rechtswert,y:Hochwert"
    features = read_file(path, READERS, options={"columns": columns})
    np.testing.assert_array_equal(features.points.ground, [[5.25, 44.5, 300]])
    np.testing.assert_array_equal(features.points.image, [[1.5, 2.5]])
    for wrong, words in [("Zeile", "'zeile' does not declare a column"),
                         ("line=Zeile,line=4", "the column of line is declared twice"),
                         ("line=Reihe", "there is no column 'Reihe' for line"),
                         ("lines:Zeile", "Did you mean 'line")]:
        with pytest.raises(TermselError, match=words):
            read_file(path, READERS, "points-csv", {"columns": wrong})
    error = refusal(tmp_path, b"who,where,up\na,1,2\n", "points-csv")
    assert (error.line, error.column) == (1, "line")


def test_rows_of_one_id_are_pieces_of_one_line(tmp_path: Path) -> None:
    lines = read(tmp_path, LINES + L + "m,1,2,3,5,6,7,8,9,10,11\n" + L.replace("44", "54")).lines
    assert lines.ids == ("l", "m", "l")
    assert lines.features == ("l", "m")


def test_declarations(tmp_path: Path) -> None:
    text = "# CRS: epsg:4979\n# units: degrees, metres\n" + POINTS + A
    assert read(tmp_path, text).crs == "EPSG:4979"


# What is refused, and where


@pytest.mark.parametrize(("text", "line", "column", "words"), [
    (POINTS + "a,,1,two,3,4,5\n", 2, "sample", "'two' is not a number"),
    (POINTS + A + "b,,1,2,3,nan,5\n", 3, "y", "not a finite number"),
    (POINTS + A + "b,,1,2,-inf,4,5\n", 3, "x", "not a finite number"),
    (POINTS + "a,,1,2,3,4,NaN\n", 2, "z", "Leave the cell blank"),
    (POINTS + "a,,1,2,3,4,1e999\n", 2, "z", "not a finite number"),
    (POINTS + A + "b,,1,2e50,3,4,5\n", 3, None, "'b' has image coordinates of 1e+50 or more"),
    (POINTS + A + "b,,1,2,-1e50,4,5\n", 3, None, "ground coordinates of 1e+50 or more"),
    (POINTS + A + "b,,1,2,3,4,1e200\n", 3, None, "a height of 1e+50 or more"),
    (POINTS + "a,,1,2_0,3,4,5\n", 2, "sample", "underscores"),
    (POINTS + "a,,1,2\x1c,3,4,5\n", 2, "sample", "not a number"),
    (POINTS + "a,,1,,3,4,5\n", 2, "sample", "blank"),
    (POINTS + "# note\n\n" + A + "b,,1, ,3,4,5\n", 5, "sample", "blank"),
    (POINTS + A + ",,1,2,3,4,5\n", 3, "id", "id is blank"),
    (POINTS + A + "b,,1,2,3,4\n", 3, None, "ends after 6 of 7 cells, before z"),
    (POINTS + A + "b,,1,2,3,4,5,6\n", 3, None, "8 cells, but the header has 7"),
    (POINTS + "a,,1,5,2,5,3,4,5\n", 2, None, "decimal commas, separate the columns by semicolons"),
    (POINTS + A + "b,,1,2,3,4,5\n" + A, 4, "id", "this row repeats line 2"),
    (POINTS + A + "b,chek,1,2,3,4,5\n", 3, "role", "unknown role 'chek'"),
    (POINTS, None, None, "a header and no row below it"),
    ("# crs: EPSG:4979\n" + POINTS, None, None, "a header and no row below it"),
    ("name;lat;row;col;z\n", 1, "x", "The columns here are: name, lat, row, col, z. "
                                    "Accepted names: x, lon, longitude"),
    ("id,line1,sample1,line2,sample2,x1,y1,z1,x2,y2\na,1,2,3,4,5,6,7,8,9\n", 1, "z2",
     "there is no column for z2"),
    ("id,line,sample,lon,z\na,1,2,3,4\n", 1, "y", "Accepted names: y, lat"),
    ("id,line,sample,x,y,x,y,z\n", 1, "x", "columns 'x' and 'x' both mean x"),
    ("id,line,Row,sample,x,y,z\n", 1, "Row", "columns 'line' and 'Row' both mean line"),
    ("id,line,sample,x,y,z,sigma_px,sigma_line\n", 1, "sigma_line", "both mean sigma_line"),
    ("id,line,sample,x,y,z,sigma_line\na,1,2,3,4,5,1\n", 1, "sigma_sample",
     "sigma_line needs the column sigma_sample beside it. Add sigma_sample, or remove sigma_line."),
    ("id,line,sample,x,y,z,sigma_px\na,1,2,3,4,5,1\nb,1,2,3,5,5,\n", 3, "sigma_px", "blank"),
    ("id,line,sample,x,y,z,sigma_px\na,1,2,3,4,5,1\nb,1,2,3,5,5,0\n", 3, None,
     "sigma_line 0, a standard deviation that is not positive"),
    ("id,line,sample,x,y,z,enabled\na,1,2,3,4,5,perhaps\n", 2, "enabled", "Write 1 or 0"),
    (POINTS + A + A.replace("a", "b", 1), 3, None, "same ground coordinates"),
    ("id;line;sample;x;y;z\na;1,5;2;3;4;5\nb;1.5;2;3;5;5\n", 3, "line", "decimal point"),
    ("id;line;sample;x;y;z\na;1.234;2,345;3;4;5\n", 2, "sample", "may be above one thousand"),
    ("id;line;sample;x;y;z\na;1;2;1.2345,5;4;5\n", 2, "x", "not a number"),
    ("id;line;sample;lon;lat;z\na;1;2;5;44°30'E;5\n", 2, "lat", "is a longitude"),
    (POINTS + 'a,,1,2,3,4,5\n"b,,1,2,3,4,5\nc,,1,2,3,4,5\n', 3, None, "quotation mark"),
    ("# crs: WGS85\n" + POINTS + A, 1, None, "unknown CRS 'WGS85'"),
    ("# crs: EPSG:4979\n# crs: EPSG:4326\n" + POINTS + A, 2, None,
     "but EPSG:4979 in an earlier comment"),
    ("#\n# units: feet\n" + POINTS + A, 2, None, "Convert the ground coordinates"),
    ((POINTS + "é").encode("latin-1") + b"\x81" + A[1:].encode(), 2, None, "UTF-8"),
    (LINES + "l,1,2,3,4,5,44,10,5.1,north,20\n", 2, "y2", "not a number"),
    (LINES + L + "m,1,2,1,2,5,44,10,5.1,44.2,20\n", 3, None, "zero length in the image"),
    (LINES + L + "m,1,2,3,5,5,44,10,5,44,20\n", 3, None, "zero length on the ground"),
    (LINES + L + L.replace("l", "m"), 3, None, "same ground vertices"),
    (LINES + L + L, None, None, "'l' and 'l' have the same ground vertices"),
    (LINES.replace("z2", "zz"), 1, "z2", "Accepted names: z2, h2"),
])
def test_bad_tables(tmp_path: Path, text: str | bytes, line: int | None, column: str | None,
                    words: str) -> None:
    error = refusal(tmp_path, text)
    assert (error.line, error.column) == (line, column)
    assert words in str(error)
    assert line is None or f"line {line}" in str(error)


@pytest.mark.parametrize(("content", "words"), [
    (b"", "is empty"),
    (b"\r\n  \n", "is empty"),
    (b"\x89PNG\0\0\0", "binary"),
    ((POINTS + A).encode("utf-16")[:-1], "UTF-16"),
    (b"1,2,3,4,5\n", "headed id,role,line,sample,x,y,z"),
    (b"# only a comment\n", "in no format that termsel knows"),
    (b'{"type": "FeatureCollection"}', "this is GeoJSON with no geometry"),
    (b'{"type": "FeatureCollection", "features": [{"geometry": {"type": "Polygon"}}]}',
     "this is GeoJSON with geometry of the type Polygon. termsel reads features of the type Point"),
    (b"<html><body>404 Not Found</body></html>", "this file is a web page, not data"),
    (b"\n<!DOCTYPE HTML>\n", "this file is a web page, not data"),
])
def test_not_a_table(tmp_path: Path, content: bytes, words: str) -> None:
    assert words in str(refusal(tmp_path, content))


@pytest.mark.parametrize("content", [
    b"\x89PNG\0\0\0", (POINTS + A).encode("utf-16")[:-1], b"1,2,3\n", b"# only a comment\n",
    b"x" * 300_000, b'"' + b"x" * 300_000])
def test_forced_format_is_read_or_refused(tmp_path: Path, content: bytes) -> None:
    refusal(tmp_path, content, "points-csv")


def test_missing_folder_and_unknown_format(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "none.csv", put(tmp_path, POINTS) / "below.csv"):
        with pytest.raises(TermselError) as caught:
            read_file(path, READERS)
        assert str(path) in str(caught.value)
    with pytest.raises(TermselError, match="Did you mean 'points-csv'"):
        read_file(tmp_path, READERS, "point-csv")


def test_file_that_may_not_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def denied(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    path = put(tmp_path, POINTS + A)
    monkeypatch.setattr(Path, "open", denied)
    with pytest.raises(TermselError, match=r"cannot read this file: Permission denied\. Give"):
        read_file(path, READERS)


def test_sniffing_tells_points_from_lines() -> None:
    points = b"id,role,enabled,line,sample,x,y,z\n"
    lines = b"id,role,enabled,line1,sample1,line2,sample2\n"
    here = Path("any")
    assert (PointsCsv().sniff(here, points), LinesCsv().sniff(here, points)) == (True, False)
    assert (PointsCsv().sniff(here, lines), LinesCsv().sniff(here, lines)) == (False, True)


@pytest.mark.parametrize(("rows", "place"), [
    ("# crs: EPSG:32639\nname;easting;northing;z;row;col\na;500000;4e6;1;2;3\nb;51;34;1;9;3\n"
     "c;500100;4e6;1;2;4\n", "line 4, column 'easting'"),
    ("# crs: EPSG:4979\nid,lat,lon,z,row,col\na,34,51,1,2,3\nb,34,451,1,2,4\n",
     "line 4, column 'lon'"),
    ("# crs: EPSG:4979\nid,lat,lon,z,row,col\na,34,51,1,2,3\nb,134,251,1,2,4\n",
     "line 4, column 'lat'"),
])
def test_a_row_with_coordinates_of_another_crs_is_named(rows: str, place: str, tmp_path: Path,
                                                        ) -> None:
    with pytest.raises(TermselError, match=f"p.csv, {place}: "):
        read_features(put(tmp_path, rows, "p.csv"), None, crs=None, readers=READERS)


@pytest.mark.parametrize(("text", "lines", "missing"), [
    ("id,line,sample,x,y\na,1,2,3,4\nb,2,3,4,5\n", False, "z"),
    ("id,line1,sample1,line2,sample2,x1,y1,x2,y2\na,1,2,3,4,5,6,8,9\n", True, "z1 and z2"),
])
def test_without_columns_of_heights_all_are_blank_with_a_note(
        text: str, lines: bool, missing: str, tmp_path: Path,
        caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", "termsel")
    path = put(tmp_path, text, "a.csv")
    features = read_features(None if lines else path, path if lines else None, crs="local",
                             readers=READERS)
    assert np.isnan(features.ground_vertices()[:, 2]).all()
    assert f"a.csv has no column for {missing}, so its heights are unknown." in caplog.text


@pytest.mark.parametrize(("first", "row", "line"), [
    ("id,line,sample,x,y,z", "a,1,2,3,4,5", 1), ("1.5;2.5", "1.5;2.5", 1),
    ("# crs: local\n\nid\tline\tsample\tx\ty", "a\t1\t2\t3\t4", 3), ("name", "a", 1)])
def test_a_table_of_very_many_columns_is_refused_at_once(tmp_path: Path, first: str, row: str,
                                                         line: int) -> None:
    sign = next((sign for sign in ",;\t" if sign in first), ",")
    more = sign.join(["", *(f"c{i}" for i in range(2_000))])
    path = tmp_path / "wide.csv"
    path.write_text(f"{first}{more}\n{row}{more}\n" * 2)
    with pytest.raises(TermselError, match=r"the first row has 2,00\d cells, more than 1,000"
                       ) as error:
        termsel.read(path, crs="local")
    assert error.value.line == line
    assert error.value.hint == "Give a table with a row per point."


@pytest.mark.parametrize("header", ["id,line,sample,x,y", "id,line,Nr,x,y"])
def test_a_table_without_heights_says_so_at_most_once(header, tmp_path, call) -> None:
    """Also where a column is missing, so that the table is tried with other columns."""
    path = tmp_path / "flat.csv"
    path.write_text("\n".join([header, *(f"p{i},{i * i},{10 * i},{500000 + 7 * i},{5300000 - i * i}"
                                         for i in range(12))]))
    for crs in ([], ["--crs", "EPSG:32632"]):
        done = call("run", "--points", path, *crs)
        assert (done.stdout + done.stderr).count("no column for z") <= 1


def test_a_void_of_a_raster_is_no_height(tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    file.write_text("id,line,sample,x,y,z\nA,1,2,3,4,100\nB,5,6,7,8,-9999\nC,9,6,7,8,-9999.0\n")
    with pytest.raises(TermselError, match="-9999 is no height, but what rasters have where there "
                                           "is none, as in 2 rows") as raised:
        termsel.read(file, crs="local")
    assert (raised.value.line, raised.value.column) == (3, "z")


def test_a_column_that_is_taken_for_another_meaning_is_named(tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    file.write_text("id,line,sample,x,y\nA,1,2,3,4\nB,5,6,7,8\nC,9,6,7,9\n")
    with pytest.raises(TermselError, match="takes column 'y' for x, so that none is left for y"):
        termsel.read(file, crs="local", columns="x=y")
    swapped = termsel.read(file, crs="local", columns="x=y,y=x")
    assert swapped.points.ground[0, :2].tolist() == [4.0, 3.0]


def test_columns_may_be_declared_by_other_names_of_their_meaning(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("a,b,c,d,e\n3,4,5,44,7\n8,9,6,45,7\n10,9,6,46,7\n")
    read = [termsel.read(tmp_path / "a.csv", crs="EPSG:4979", columns=columns) for columns in (
        "line=1,sample=2,x=3,y=4,z=5", "row=1,col=2,lon=3,lat=4,height=5",
        "Row=1,pixel=2,longitude=3,Latitude=4,elevation=e")]
    assert all((one.points.ground == read[0].points.ground).all() for one in read)
    assert all((one.points.image == read[0].points.image).all() for one in read)
    with pytest.raises(TermselError, match="the column of line is declared twice"):
        termsel.read(tmp_path / "a.csv", columns="line=1,row=2")


@pytest.mark.parametrize(("cells", "said", "remedy"), [
    (["control", "GCP", "CP", "GCP"], "unknown roles 'GCP' (2 rows), 'CP' (1 row)",
     "Write control for a ground control point (GCP, CoP). CP is written for a control point and"),
    (["GCP"] * 4, "unknown role 'GCP' in 4 rows", "Write control for a ground control point"),
    (["", "ICP", "GACP", "CoP"], "unknown roles 'ICP' (1 row), 'GACP' (1 row), 'CoP' (1 row)",
     "Write check for a point that chooses the model (GACP"),
    (["", "Check point", "", ""], "unknown role 'Check point'",
     "Write independent for a check point that tests the result"),
    (["", "tie", "", ""], "unknown role 'tie'", "A tie point has no ground coordinates"),
    (["", "good", "", ""], "unknown role 'good'", "A GCP is control;")])
def test_all_unknown_roles_are_named_at_once(cells: list[str], said: str, remedy: str,
                                             tmp_path: Path) -> None:
    rows = [f"{name},{cell},{i},{i * i},{i + 3},{44 + i * i},5"
            for i, (name, cell) in enumerate(zip("abcd", cells, strict=True))]
    file = tmp_path / "a.csv"
    file.write_text("\n".join(["id,role,line,sample,x,y,z", *rows]) + "\n")
    with pytest.raises(TermselError, match=re.escape(said)) as caught:
        termsel.read(file, crs="EPSG:4979")
    unknown = next(i for i, cell in enumerate(cells) if cell not in ("", "control"))
    assert (caught.value.line, caught.value.column) == (2 + unknown, "role")
    assert "Roles are control, check, independent, off, or blank. " in str(caught.value)
    assert remedy in str(caught.value)
    # What the command states of these points goes before their cells.
    wrong = [name for name, cell in zip("abcd", cells, strict=True)
             if cell not in ("", "control")]
    read = termsel.read(file, crs="EPSG:4979", off=wrong[0], role=",".join(
        f"{name}=check" for name in wrong[1:]))
    assert len(read.points) == 4


@pytest.mark.parametrize("names", ["X/Longitude,Y/Latitude,Z/Altitude",
                                   "X/Easting,Y/Northing,Z/Altitude"])
@pytest.mark.parametrize("above", ["", "#CoordinateSystem: WGS 84 (EPSG::4326)\n"])
def test_table_of_the_reference_pane_of_metashape(names: str, above: str, tmp_path: Path) -> None:
    file = tmp_path / "markers.csv"
    rows = "".join(f"g{i},{5 + i},{44 + i * i},{100 + i}\n" for i in range(5))
    file.write_text(f"{above}#Label,{names}\n{rows}")
    with pytest.raises(TermselError, match="ground coordinates alone: columns for line") as caught:
        termsel.read(file, crs="EPSG:4979")
    assert "Export Markers as XML: give that file instead" in str(caught.value)
    # With the places in the image its names are those of any table.
    rows = "".join(f"g{i},{5 + i},{44 + i * i},{100 + i},{i},{i * i}\n" for i in range(5))
    file.write_text(f"{above}#Label,{names},line,sample\n{rows}")
    assert termsel.read(file, crs="EPSG:4979").points.ground[2].tolist() == [7.0, 48.0, 102.0]


@pytest.mark.parametrize("sign", [" ", "\t", ","])
def test_list_of_opendronemap_names_the_package_that_reads_it(sign: str, tmp_path: Path) -> None:
    file = tmp_path / "gcp_list.txt"
    rows = [f"{272692.3 + 9 * i} {3851114.0 + i * i} {1563 + i} {507.8 + i} {484.2 - i * i} "
            f"a.JPG g{i}" for i in range(4)]
    file.write_text("\n".join(rows).replace(" ", sign) + "\n")
    error = unknown_table_error(file, "", "")
    assert error is not None
    assert "OpenDroneMap's gcp_list.txt" in error.what
    assert "termsel-formats" in str(error.hint)
    assert not error.guesses
    # In another order of columns it is no such list.
    file.write_text("\n".join(
        ",".join(row.split()[k] for k in (3, 4, 0, 1, 2, 5)) for row in rows) + "\n")
    error = unknown_table_error(file, "", "")
    assert error is not None
    assert "OpenDroneMap" not in error.what


@pytest.mark.parametrize(("columns", "remedy"), [
    ("line=Zeile", "columns='line1=NAME'"), ("z=Hoehe", "columns='z1=NAME'")])
def test_a_meaning_that_lines_do_not_have_is_refused(
        columns: str, remedy: str, tmp_path: Path) -> None:
    file = tmp_path / "lines.csv"
    file.write_text("# crs: EPSG:32639\nid,line1,sample1,line2,sample2,x1,y1,z1,x2,y2,z2\n"
                    "A,1,2,3,4,500000,4000000,1,500010,4000010,2\n")
    with pytest.raises(TermselError, match="which this table does not have") as error:
        termsel.read(file, columns=columns)
    assert remedy in (error.value.hint or "")
