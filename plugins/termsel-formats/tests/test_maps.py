"""What a GIS shows of a result: its residuals as a GeoPackage, its control as GeoJSON."""

from __future__ import annotations

import json
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

pytest.importorskip("termsel_formats", reason="termsel-formats is not installed: "
                    "pip install -e plugins/termsel-formats")

import termsel
from termsel import FeatureSet, Points, Result, TermselError
from termsel.testing import Check, checks
from termsel_formats.maps.residuals import ResidualsGeopackage
from termsel_formats.points.orthority import OrthorityGeojson

pyproj = pytest.importorskip("pyproj")


@pytest.mark.parametrize("check", [
    pytest.param(one, id=f"{writer.name}-{one.name}")
    for writer in (ResidualsGeopackage(), OrthorityGeojson())
    for one in checks(writer, filename=f"scene{writer.suffix}")])
def test_conforms(check: Check) -> None:
    check.run()


@pytest.fixture(scope="module")
def selected() -> Result:
    """Return a result in UTM with 20 of 30 control points selected, one point off."""
    features = termsel.simulate_scene("irs1c-mashad", n_points=60)
    turn = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:32640", always_xy=True)
    lon, lat, height = features.points.ground.T
    roles = ("off", *("control", "check", "control", "independent") * 15)[:60]
    points = replace(features.points, roles=roles, ground=np.column_stack(
        [*turn.transform(lon, lat), height]))
    return termsel.run("owdis-points", features=replace(features, crs="EPSG:32640", points=points),
                       model="affine", generations=3, options={
                           "population": 30, "max_features": 20, "polish": False})


@pytest.fixture(scope="module")
def of_lines() -> Result:
    return termsel.run("owdis-lines", generations=2, options={"population": 30, "polish": False})


def test_orthority_geojson(selected: Result, tmp_path: Path) -> None:
    path = tmp_path / "gcps.geojson"
    OrthorityGeojson(image="/somewhere/scene.tif").write(selected, path)
    collection = json.loads(path.read_text())
    assert collection["type"] == "FeatureCollection"
    ids = [feature["properties"]["id"] for feature in collection["features"]]
    assert ids == list(selected.selection.features)
    original = termsel.simulate_scene("irs1c-mashad", n_points=60).points
    for feature in collection["features"]:
        i = original.ids.index(feature["properties"]["id"])
        assert feature["geometry"]["type"] == "Point"
        assert np.allclose(feature["geometry"]["coordinates"], original.ground[i], atol=1e-9)
        assert feature["properties"]["ji"] == original.image[i, ::-1].tolist()
        assert feature["properties"]["filename"] == "scene.tif"
        assert isinstance(feature["properties"]["info"], str)
        residual, = (one for one in selected.residuals
                     if one.id == feature["properties"]["id"])
        assert feature["properties"]["residual"] == pytest.approx([residual.sample, residual.line])


def test_geojson_of_orthority_is_read_back(selected: Result, tmp_path: Path) -> None:
    path = tmp_path / "scene.geojson"
    OrthorityGeojson().write(selected, path)
    points, chosen = selected.features.points, set(selected.selection.features)
    read = termsel.read(path)
    assert read.crs in ("EPSG:4326", "EPSG:4979")
    assert read.points.ids == selected.selection.features
    image = points.image[[name in chosen for name in points.ids]]
    assert np.allclose(read.points.image, image, rtol=0, atol=1e-9)


def test_without_heights_there_are_residuals_and_no_geojson(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    ground = np.column_stack([rng.uniform(0.0, 1000.0, (40, 2)), np.full(40, np.nan)])
    image = np.column_stack([500.0 - 0.5 * ground[:, 1], 0.5 * ground[:, 0]])
    image += rng.normal(0.0, 0.1, (40, 2))
    points = Points(tuple(f"p{i}" for i in range(40)), image, ground)
    result = termsel.run("poly-terms", features=FeatureSet(points, crs="EPSG:32640"),
                         solver="all-terms", model="poly2d", options={"degree": 2})
    ResidualsGeopackage().write(result, tmp_path / "scene.gpkg")
    with pytest.raises(TermselError, match="requires control points with heights and a CRS"):
        OrthorityGeojson().write(result, tmp_path / "scene.geojson")


def test_residuals_for_a_map(selected: Result, of_lines: Result, tmp_path: Path) -> None:
    pyogrio = pytest.importorskip("pyogrio")
    shapely = pytest.importorskip("shapely")
    path = tmp_path / "residuals.gpkg"
    ResidualsGeopackage(exaggeration=100).write(selected, path)
    assert [name for name, _ in pyogrio.list_layers(path)] == [
        "residuals", "vectors", "layer_styles"]
    with closing(sqlite3.connect(path)) as database:  # GDAL 3.6 warns of later versions
        assert database.execute("PRAGMA user_version").fetchone() == (10300,)
    meta, _, shapes, columns = pyogrio.raw.read(path, layer="vectors")
    assert "32640" in meta["crs"]
    table = dict(zip(meta["fields"], columns, strict=True))
    assert set(table["exaggeration"]) == {100.0}
    for i, shape in enumerate(shapely.from_wkb(shapes)):
        residual = selected.residuals[i]
        assert table["id"][i] == residual.id
        assert table["distance"][i] == residual.distance
        start, end = np.array(shape.coords)
        assert tuple(start) == (residual.x, residual.y)
        there = np.append(start + (end - start) / 100, residual.z)
        moved = selected.project(there[None])[0] - selected.project(
            np.array([[residual.x, residual.y, residual.z]]))[0]
        assert moved == pytest.approx((residual.line, residual.sample), abs=1e-3)
    ResidualsGeopackage().write(of_lines, path)
    assert pyogrio.read_info(path, layer="residuals")["features"] == 2 * 120 + 24 + 26


@pytest.mark.parametrize("heights", [True, False])
def test_points_of_the_residuals_are_read_as_they_were_measured(
        selected: Result, heights: bool, tmp_path: Path) -> None:
    pytest.importorskip("pyogrio")
    features = selected.features
    ground = features.points.ground.copy()
    if not heights:
        ground[:, 2] = np.nan
    result = termsel.run(features=FeatureSet(replace(features.points, ground=ground),
                                             crs=features.crs), method="affine")
    path = tmp_path / "residuals.gpkg"
    ResidualsGeopackage().write(result, path)
    points = termsel.read(path).points
    row = {name: i for i, name in enumerate(result.features.points.ids)}
    order = [row[name] for name in points.ids]
    assert len(order) == len(result.residuals)
    assert points.image == pytest.approx(result.features.points.image[order])
    assert points.ground == pytest.approx(result.features.points.ground[order], nan_ok=True)


def test_the_median_vector_has_three_percent_of_the_map(selected: Result, tmp_path: Path) -> None:
    pyogrio = pytest.importorskip("pyogrio")
    shapely = pytest.importorskip("shapely")
    ResidualsGeopackage().write(selected, tmp_path / "residuals.gpkg")
    shapes = pyogrio.raw.read(tmp_path / "residuals.gpkg", layer="vectors")[2]
    start, end = np.array([shape.coords for shape in shapely.from_wkb(shapes)]).swapaxes(0, 1)
    lengths = np.linalg.norm(end - start, axis=1)
    share = np.median(lengths) / np.ptp(start, axis=0).max()
    assert share == pytest.approx(0.03, rel=0.35)  # the exaggeration has one digit
    assert lengths.max() > 1.5 * np.median(lengths)


def test_a_gis_shows_residuals_by_role(of_lines: Result, tmp_path: Path) -> None:
    pytest.importorskip("pyogrio")
    path = tmp_path / "residuals.gpkg"
    ResidualsGeopackage().write(of_lines, path)
    with closing(sqlite3.connect(path)) as database:
        # The query of QGIS when it opens a layer (`loadStyle` of its OGR provider).
        found = {layer: database.execute(
            "SELECT useAsDefault, styleQML FROM layer_styles WHERE f_table_schema = '' AND "
            "f_table_name = ? AND f_geometry_column = ? ORDER BY CASE WHEN useAsDefault THEN 1 "
            "ELSE 2 END, update_time DESC LIMIT 1", (layer, column)).fetchone()
            for layer, column in database.execute(
                "SELECT table_name, column_name FROM gpkg_geometry_columns")}
        assert set(found) == {"residuals", "vectors"}
        for layer, kind in (("residuals", "SimpleMarker"), ("vectors", "ArrowLine")):
            default, qml = found[layer]
            assert default == 1
            renderer = ElementTree.fromstring(qml).find("renderer-v2[@type='categorizedSymbol']")
            assert renderer is not None
            labels = {one.attrib["value"]: renderer.find(
                f"symbols/symbol[@name='{one.attrib['symbol']}']/layer[@class='{kind}']")
                for one in renderer.iterfind("categories/category")}
            assert all(symbol is not None for symbol in labels.values())
            # The expression is SQL as well: every feature has a category, those left out their own.
            shown = dict(database.execute(
                f"SELECT {renderer.attrib['attr']}, count(*) FROM {layer} GROUP BY 1"))
            assert set(shown) == set(labels)
            lines = len(of_lines.selection.features)
            assert shown == {"control": 2 * lines, "left out": 2 * (120 - lines), "check": 24,
                             "independent": 26}
            colours = [next(one.attrib["v"] for one in symbol.iter("prop")
                            if one.attrib["k"] == "color")
                       for symbol in labels.values() if symbol is not None]
            assert colours[0] == "0,114,178,255"  # the blue of control in all charts, #0072b2
            assert len(set(colours)) == 4
