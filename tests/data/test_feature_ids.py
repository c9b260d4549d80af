"""One rule for ids: whoever made a feature, its result is read back and its tables are safe."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import termsel
from termsel import FeatureSet, Lines, Points, TermselError
from termsel.core.files.texts import guard_cell, unguard_cell

REFUSED = {
    "line break and comment": "a\n#b", "line break and CRS": "a\n# crs: EPSG:32631",
    "carriage return": "a\rb", "tab": "a\tb", "NUL": "a\0b", "escape": "\x1b[31mX",
    "half of a character": "\ud800x", "byte order mark": "\ufeffa", "C1": "a\x9b31m",
    "to the left": "a\u202eb", "line separator": "a\u2028b", "long": "a" * 201}
KEPT = ["P 1", "日本P017", "می\u200cخواهم", "a\u00a0b", "#1", '"a"', "a,b;c", "-12", "+3.5", "'=x",
        "=1+1", "@SUM(A1)", "-x", "+x", "''=x", "'", "a" * 200]


def points(*names: str) -> Points:
    rng = np.random.default_rng(0)
    n = len(names)
    image = rng.uniform(0, 1000, (n, 2))
    return Points(names, image, np.column_stack([image[:, ::-1] * 2 + 5, rng.uniform(0, 9, n)]))


def geojson(path: Path, names: list[object]) -> Path:
    made = points(*(f"P{i}" for i in range(len(names))))
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [
        {"type": "Feature", "properties": {"id": name, "ji": image[::-1]},
         "geometry": {"type": "Point", "coordinates": ground}}
        for name, image, ground in zip(names, made.image.tolist(), (made.ground / 100).tolist(),
                                       strict=True)]}))
    return path


@pytest.mark.parametrize("name", REFUSED.values(), ids=REFUSED)
def test_ids_that_no_table_keeps_are_refused_at_the_door(name: str, tmp_path: Path) -> None:
    with pytest.raises(TermselError, match=r"id .* of a point") as from_python:
        points("A", name)
    assert str(from_python.value).isprintable()
    with pytest.raises(TermselError, match=r"id .* of a line"):
        Lines((name,), [[[0, 0], [1, 1]]], [[[0, 0, 0], [1, 1, 1]]])
    with pytest.raises(TermselError, match="id") as from_file:
        termsel.read(geojson(tmp_path / "a.geojson", ["A", name]))
    assert str(from_file.value).isprintable()
    if name.isprintable() or "\n" in name:
        (tmp_path / "a.csv").write_text(f'id,line,sample,x,y,z\n"{name}",1,2,3,4,5\n')
        with pytest.raises(TermselError, match=r"line 2, column 'id': the id has"):
            termsel.read(tmp_path / "a.csv", crs="local")


@pytest.mark.parametrize("name", [[1, [2]], {"a": 1}], ids=["list", "object"])
def test_an_id_is_text_or_a_number(name: object, tmp_path: Path) -> None:
    with pytest.raises(TermselError, match="feature 2: this property is a list or an object"):
        termsel.read(geojson(tmp_path / "a.geojson", [7, name]))
    assert termsel.read(geojson(tmp_path / "b.geojson", [7, "b"])).ids == ("7", "b")


def test_results_are_read_back_with_every_id_that_is_accepted(tmp_path: Path) -> None:
    features = FeatureSet(points(*KEPT))
    result = termsel.run("poly-terms", features=features, options={"degree": 1}, evaluations=20,
                         out=tmp_path / "r")
    assert sorted(termsel.read_result(tmp_path / "r").features.ids) == sorted(KEPT)
    # What people open in a spreadsheet has no formula, and numbers are numbers.
    for name in ("points.csv", "residuals.csv"):
        text = (tmp_path / "r" / name).read_text(encoding="utf-8").removeprefix("# crs: local\n")
        cells = [row["id"] for row in csv.DictReader(text.splitlines())]
        assert {"'=1+1", "'@SUM(A1)", "'-x", "'+x", "-12", "+3.5"} <= set(cells), name
    termsel.export(result, "points-csv", tmp_path / "p.csv")
    assert sorted(termsel.read(tmp_path / "p.csv").ids) == sorted(KEPT)


@settings(max_examples=300)
@given(st.text(alphabet="'=+-@1.x#\"", min_size=1, max_size=6))
def test_a_guarded_cell_gives_back_its_text(text: str) -> None:
    assert unguard_cell(guard_cell(text)) == text
    assert guard_cell(text)[0] not in "=@"


def test_comments_are_not_found_within_quotation_marks(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text('# crs: EPSG:4326\n#\nid,note,line,sample,x,y,z\nA,"two\n# crs: EPSG:32631\n#",'
                    '1,2,3,4,5\n# between\nB,,2,3,4,5,6\n"C",#,3,4,5,6,7\n')
    features = termsel.read(path)
    assert (features.crs, features.ids) == ("EPSG:4326", ("A", "B", "C"))
    path.write_text(path.read_text() + "D,,x,4,5,6,8\n")
    with pytest.raises(TermselError, match="line 10, column 'line'"):
        termsel.read(path)
