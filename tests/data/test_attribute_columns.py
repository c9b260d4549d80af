"""Further columns of files: kept with their features, used by objectives and problems."""

from __future__ import annotations

import copy
import json
import pickle
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import termsel
from termsel import FeatureSet, Lines, Objective, Option, Points, Recipe, SelectionProblem
from termsel.core.errors import TermselError
from termsel.data.roles import sorted_by_id, with_merged_twins
from termsel.data.scaling import make_scaling
from termsel.formats.readers.csv_tables import write_lines_csv, write_points_csv
from termsel.plugins.registry import registry
from termsel.results.result import checksum_of_features

SOURCES = ("gps", "map", "=1+1", 'a "b", c', "two\nlines", "", "007", "#7")


def points(n: int, prefix: str = "P", **attributes: Any) -> Points:
    """Points of an affine image, whose attribute `source` tells them apart."""
    rng = np.random.default_rng(n)
    ground = np.column_stack([rng.uniform(0, 1000, (n, 2)), rng.uniform(0, 50, n)])
    image = ground[:, :2] @ [[2.0, 0.4], [-0.3, 1.9]] + rng.normal(0, 0.3, (n, 2))
    ids = tuple(f"{prefix}{i}" for i in range(n))
    return Points(ids, image, ground, attributes={
        "source": [f"{SOURCES[i % len(SOURCES)]}" for i in range(n)], "of": ids, **attributes})


def lines() -> Lines:
    """Three lines, the first two pieces of one feature."""
    ground = np.arange(18.0).reshape(3, 2, 3) ** 2
    return Lines(("a", "a", "b"), ground[..., :2], ground,
                 attributes={"source": ["map", "gps", ""], "width": [3, 4.5, None]})


def aligned(part: Points) -> bool:
    """Return whether each point has its own attributes."""
    return part.attributes["of"].tolist() == list(part.ids)


def test_attributes_are_text_that_cannot_be_changed() -> None:
    pandas = pytest.importorskip("pandas")
    part = points(3, year=[2020, 2021.5, float("nan")], known=[True, None, "  x "],
                  day=[pandas.NA, pandas.NaT, "nan"])
    assert part.attributes["day"].tolist() == ["", "", "nan"]
    assert part.attributes["year"].tolist() == ["2020", "2021.5", ""]
    assert part.attributes["known"].tolist() == ["True", "", "x"]
    for one in (part, part.take([0, 2]), pickle.loads(pickle.dumps(part)), copy.deepcopy(part),
                FeatureSet(part).lines, part.join(points(1, "Q"))):
        with pytest.raises(TypeError, match="does not support item assignment"):
            one.attributes["width"] = ["a"] * len(one)  # type: ignore[index]
        for cells in one.attributes.values():
            with pytest.raises(ValueError, match="read-only"):
                cells[0] = "1"


@pytest.mark.parametrize(("attributes", "said"), [
    ({"Row": "abc"}, "cannot have the name 'Row'"),
    ({"": list("abc")}, "cannot have the name ''"),
    ({"a\nb": list("abc")}, "cannot have the name"),
    ({"residual_line": list("abc")}, "cannot have the name 'residual_line'"),
    ({"geometry": list("abc")}, "cannot have the name 'geometry'"),
    ({"date": list("abc"), "Date": list("abc")}, "two columns of attributes have the name 'Date'"),
    ({"date": list("ab")}, "the attributes 'date' have 2 values for 3 rows"),
    ({"date": "abc"}, "the attributes 'date' have 0 values for 3 rows"),
    ({"date": 5}, "the attributes 'date' have 0 values for 3 rows")])
def test_columns_that_cannot_be_are_refused(attributes: dict[str, Any], said: str) -> None:
    with pytest.raises(TermselError, match=said):
        points(3, **attributes)


def test_rows_stay_together() -> None:
    both = points(16)
    assert aligned(both.take([5, 2, 9]))
    assert aligned(both.take(np.arange(16) % 3 == 0))
    shuffled = FeatureSet(both.take(np.random.default_rng(0).permutation(16)))
    assert aligned(sorted_by_id(shuffled).points)
    scaled = make_scaling(shuffled).features(shuffled).points
    assert aligned(scaled)
    assert scaled.attributes["source"].tolist() == shuffled.points.attributes["source"].tolist()
    again = replace(both, ids=tuple(f"Q{i}" for i in range(16)), ground=both.ground + 1e-7)
    alone = with_merged_twins(FeatureSet(both.join(again)))
    assert len(alone) == 16
    assert aligned(alone.points)
    assert aligned(pickle.loads(pickle.dumps(both)))
    assert alone.take(np.arange(16) > 9).texts("of").tolist() == list(both.ids[10:])


def test_joined_tables_have_the_columns_of_both() -> None:
    one, other = points(2, date=["a", "b"]), points(3, "Q", person=["c", "d", "e"])
    both = one.join(other)
    assert both.attributes["date"].tolist() == ["a", "b", "", "", ""]
    assert both.attributes["person"].tolist() == ["", "", "c", "d", "e"]
    assert aligned(both)
    twice = lines().take([0]).join(lines().take([2]))
    assert twice.attributes["width"].tolist() == ["3", ""]
    capitals = one.join(points(1, "R", Date=["f"]))
    assert capitals.attributes["date"].tolist() == ["a", "b", "f"]


def test_parts_of_a_table_that_are_joined_again_are_the_table() -> None:
    whole = points(5, date=list("abcde"))
    again = whole.take([0, 1]).join_unchecked(whole.take([2, 3, 4]))
    assert vars(again).keys() == vars(whole).keys()
    for name, value in vars(whole).items():
        if name != "attributes":
            np.testing.assert_array_equal(getattr(again, name), value)
    assert {name: list(cells) for name, cells in again.attributes.items()} == {
        name: list(cells) for name, cells in whole.attributes.items()}
    for array in (again.image, again.ground, again.attributes["date"]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = array[1]
    assert whole.join_unchecked(whole.take([])) is whole


def test_columns_of_all_features() -> None:
    both = FeatureSet(points(2), lines())
    assert both.ids == ("P0", "P1", "a", "b")
    assert both.texts("source").tolist() == ["gps", "map", "map", ""]
    np.testing.assert_array_equal(both.numbers("width"), [np.nan, np.nan, 3.0, np.nan])
    capitals = FeatureSet(points(2), replace(lines(), attributes={"Source": ["x", "x", "y"]}))
    assert capitals.texts("source").tolist() == ["gps", "map", "x", "y"]
    assert capitals.texts("SOURCE").tolist() == ["gps", "map", "x", "y"]
    with pytest.raises(TermselError, match=r"'sourc'\. Did you mean 'source'\? Known: of, source"):
        both.texts("sourc")


@pytest.mark.parametrize("cell", ["x", "1_0", "inf", "nan", "1,5"])
def test_text_that_is_no_number_is_named(cell: str) -> None:
    with pytest.raises(TermselError, match=rf"column 'year': 'P1' has '{cell}' in this column"):
        FeatureSet(points(3, year=["2020", cell, ""])).numbers("year")


def test_tables_give_back_what_they_got(tmp_path: Path) -> None:
    part, pieces = points(16, **{"=name": ["@x"] * 16, "long": ["y" * 200_000] * 16}), lines()
    write_points_csv(part, tmp_path / "p.csv", crs="local")
    write_lines_csv(pieces, tmp_path / "l.csv", crs="local")
    read = termsel.read(tmp_path / "p.csv", tmp_path / "l.csv")
    for before, after in ((part, read.points), (pieces, read.lines)):
        assert list(before.attributes) == list(after.attributes)
        for name, cells in before.attributes.items():
            assert cells.tolist() == after.attributes[name].tolist()
    assert "'=1+1" in (tmp_path / "p.csv").read_text()  # no formula for a spreadsheet


def test_cells_of_a_table_with_decimal_commas(tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    path.write_text("id;line;sample;x;y;accuracy;note;;accuracy;lat\n"
                    "a;1,5;2;3;4;0,25;1,2,3;x;9;1\nb;5;6;7;9;;a,b;x;9;1\n")
    read = termsel.read(path, crs="local", columns="y:y")  # without it y and lat both are y
    assert {name: cells.tolist() for name, cells in read.points.attributes.items()} == {
        "accuracy": ["0.25", ""], "note": ["1,2,3", "a,b"]}


@pytest.mark.parametrize(("name", "near"), [
    ("sgima_line", "sigma_line"), ("sigma", "sigma_px"), ("rolle", "role"), ("roles", "role"),
    ("enabeld", "enabled"), ("source", None), ("rule", None)])
def test_nearly_the_name_of_a_measurement_is_warned_of(
        name: str, near: str | None, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "p.csv"
    path.write_text(f"id,line,sample,x,y,{name}\na,1,2,3,4,5\n")
    termsel.read(path, crs="local")
    warnings = [one.getMessage() for one in caplog.records if one.levelname == "WARNING"]
    assert warnings == ([] if near is None else [
        f"Warning: column {name!r} of {path} is not used. Did you mean {near}?"])


def test_properties_of_geojson_points(tmp_path: Path) -> None:
    features = [{"type": "Feature", "geometry": {"type": "Point", "coordinates": [i, 2, 3]},
                 "properties": {"id": f"p{i}", "ji": [i, 2], **more}} for i, more in enumerate((
                     {"source": "gps", "year": 2021, "name": "left out", "tags": ["x"]},
                     {"year": None, "ok": True, "note": "a\r\nb\u0000"}))]
    path = tmp_path / "p.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    read = termsel.read(path, crs="EPSG:4979").points
    assert {name: cells.tolist() for name, cells in read.attributes.items()} == {
        "source": ["gps", ""], "year": ["2021", ""], "ok": ["", "True"],
        "note": ["", "a\nb\\x00"]}


def test_ground_lines_have_what_their_parts_share(tmp_path: Path) -> None:
    def line(x: float, **properties: Any) -> dict[str, Any]:
        return {"type": "Feature", "properties": {"id": "road", **properties}, "geometry": {
            "type": "LineString", "coordinates": [[x, 0, 1], [x + 1, 1, 1]]}}

    path, image = tmp_path / "l.geojson", tmp_path / "i.csv"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [
        line(0, source="map", date="2020", SIGMA=1), line(5, source="map", date="2021")]}))
    image.write_text("id,line1,sample1,line2,sample2\nroad,1,2,3,4\n")
    read = termsel.read(lines=path, image_lines=image).lines
    assert read.attributes["source"].tolist() == ["map", "map"]
    assert read.attributes["date"].tolist() == ["", ""]


def test_columns_of_a_geopackage(tmp_path: Path) -> None:
    geopandas, shapely = pytest.importorskip("geopandas"), pytest.importorskip("shapely")
    path, image = tmp_path / "l.gpkg", tmp_path / "i.csv"
    geopandas.GeoDataFrame({"id": ["a"], "surveyed": ["2020-05-03"], "width": [4.0]}, geometry=[
        shapely.LineString([(0, 0, 1), (1, 1, 1)])], crs="EPSG:4326").to_file(path)
    image.write_text("id,line1,sample1,line2,sample2\na,1,2,3,4\n")
    read = termsel.read(lines=path, image_lines=image)
    assert read.texts("surveyed").tolist() == ["2020-05-03"]
    assert read.numbers("width").tolist() == [4.0]


@pytest.mark.parametrize("form", ["boundary", "centroid"])
def test_areas_have_what_their_corners_share(form: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("id,corner,line,sample,x,y,z,source,note,Sigma\na,1,0,0,5,44,10,map,1,1\n"
                    "a,2,0,4,9,44,10,map,2,1\na,3,3,4,9,47,40,map,3,1\n")
    read = termsel.read(areas=path, crs="local", areas_as=form)
    assert read.texts("source").tolist() == ["map"]
    assert read.texts("note").tolist() == [""]


def share_of_maps(selected: termsel.PopulationSelection) -> np.ndarray:
    """Return the share of features in use that are from maps."""
    count = np.maximum(selected.features.sum(axis=1), 1)
    return np.asarray((selected.features & (selected.control.texts("source") == "map")
                       ).sum(axis=1) / count)


def precise(inputs: termsel.ProblemData) -> SelectionProblem:
    """Select among the points whose accuracy is good enough."""
    known = inputs.control.numbers("accuracy") <= inputs.options["worst"]
    return SelectionProblem(replace(inputs, control=inputs.control.take(known)), terms=False,
                            features=True)


PRECISE = Recipe("precise", "Which of the precise points to use.", precise, model="affine",
                 dataset="ikonos-hamedan", options=(
                     *termsel.feature_options(), Option("worst", 1.0, "Worst accuracy.", float)))


@pytest.fixture
def scene() -> FeatureSet:
    """Points of two sources, every other one precise."""
    return FeatureSet(points(36, source=["map", "gps"] * 18, accuracy=["0.5", "2", ""] * 12),
                      crs="local")


@pytest.fixture
def _fresh() -> Iterator[None]:
    """A registry of its own, so that nothing registered here is known to other tests."""
    registry.cache_clear()
    yield
    registry.cache_clear()


@pytest.mark.usefixtures("_fresh")
def test_an_objective_takes_a_column(scene: FeatureSet) -> None:
    objective = Objective("share-of-maps", "Share of features from maps.", share_of_maps)
    termsel.register(objective)
    result = termsel.run("owdis-points", features=scene, model="affine", solver="nsga2",
                         generations=6, options={"objectives": "n_features,share-of-maps"})
    for member in result.front:
        used = np.isin(scene.ids, member.selection.features)
        sources = scene.texts("source")[used]
        assert member.objectives["share-of-maps"] == pytest.approx(np.mean(sources == "map"))
    assert min(one.objectives["share-of-maps"] for one in result.front) < 0.5


def test_a_problem_takes_a_column(scene: FeatureSet) -> None:
    result = termsel.run(PRECISE, features=scene, solver="ga", generations=3)
    used = np.isin(scene.ids, result.selection.features)
    assert used.any()
    assert (scene.numbers("accuracy")[used] == 0.5).all()
    with pytest.raises(TermselError, match="unknown column of attributes 'accuracy'"):
        termsel.run(PRECISE, features=FeatureSet(points(36), crs="local"), generations=3)


def test_results_keep_them(scene: FeatureSet, tmp_path: Path) -> None:
    folder = tmp_path / "r"
    result = termsel.run("owdis-points", features=scene, model="affine", solver="all-terms",
                         out=folder)
    again = termsel.read_result(folder)
    assert aligned(again.features.points)
    assert again.features.texts("source").tolist() == result.features.texts("source").tolist()
    # The checksum of features is of their measurements, not of further columns.
    sums = json.loads((folder / "result.json").read_text())["checksums"]
    bare = replace(again.features, points=replace(again.features.points, attributes={}))
    assert sums["features"] == checksum_of_features(bare) == checksum_of_features(again.features)
    table = folder / "points.csv"
    whole = table.read_text()
    for changed in (whole.replace(",gps,", ",GPS,", 1), whole.replace(",source,", ",sources,", 1)):
        table.write_text(changed)
        with pytest.raises(TermselError, match="this file was changed after the run wrote it"):
            termsel.read_result(folder)


def test_exports_have_them(scene: FeatureSet, tmp_path: Path) -> None:
    at = replace(scene.points, ground=scene.points.ground * [1e-5, 1e-5, 1] + [5, 44, 0])
    result = termsel.run("owdis-points", features=FeatureSet(at, crs="EPSG:4979"), model="affine",
                         solver="all-terms")
    termsel.export(result, "points-csv", tmp_path / "p.csv")
    read = termsel.read(tmp_path / "p.csv").points
    assert aligned(read)
    assert list(read.attributes) == ["source", "of", "accuracy"]  # and no residuals
    termsel.export(result, "orthority-geojson", tmp_path / "p.geojson")
    assert aligned(termsel.read(tmp_path / "p.geojson").points)
    geopandas = pytest.importorskip("geopandas")
    termsel.export(result, "residuals-gpkg", tmp_path / "r.gpkg")
    table = geopandas.read_file(tmp_path / "r.gpkg", layer="residuals")
    assert table["of"].tolist() == table["id"].tolist()
    # A GeoPackage takes no two columns whose names differ in case alone.
    more = replace(lines(), attributes={"Source": ["x", "x", "y"]})
    both = result.with_(features=FeatureSet(at, more, crs="EPSG:4979"))
    termsel.export(both, "residuals-gpkg", tmp_path / "both.gpkg")
    table = geopandas.read_file(tmp_path / "both.gpkg", layer="residuals")
    assert dict(zip(table["id"], table["source"], strict=True)) \
        == dict(zip(at.ids, at.attributes["source"], strict=True))
    assert "Source" not in table
    pandas = scene.points.to_pandas()
    assert pandas["of"].tolist() == pandas["id"].tolist()


@pytest.mark.usefixtures("_fresh")
def test_what_a_column_lacks_is_for_the_user_to_correct(
        tmp_path: Path, call: Callable[..., SimpleNamespace]) -> None:
    write_points_csv(points(36), tmp_path / "p.csv", crs="local")
    termsel.register(PRECISE)
    done = call("run", "--problem", "precise", "--points", tmp_path / "p.csv")
    assert done.exit_code == 2
    assert "unknown column of attributes 'accuracy'. Known: of, source" in done.stderr
