"""Frames, masked arrays and CRSs as programs in Python hand them on."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import termsel
from termsel import FeatureSet, Points
from termsel.data.arrays import FloatArray

UTM = "EPSG:32631"


def columns(count: int = 24) -> dict[str, Any]:
    """Return a table of points of a plane image, whose heights count."""
    rng = np.random.default_rng(7)
    x, y, z = rng.uniform((500_000, 4_000_000, 100), (505_000, 4_005_000, 900), (count, 3)).T
    line = 3_000 - 0.5 * (y - 4_000_000) + 0.1 * z
    sample = 0.5 * (x - 500_000) + 0.05 * z
    return {"id": [f"P{i}" for i in range(count)], "line": line + rng.normal(0, 0.2, count),
            "sample": sample + rng.normal(0, 0.2, count), "x": x, "y": y, "z": z}


def points_of(table: dict[str, Any], z: FloatArray) -> Points:
    """Return the points of a table with other heights."""
    return Points(tuple(table["id"]), np.column_stack([table["line"], table["sample"]]),
                  np.ma.column_stack([table["x"], table["y"], z]))


@pytest.fixture(scope="module")
def result() -> termsel.Result:
    return termsel.run(features=columns(), crs=UTM)


def test_masked_values_are_not_known(result: termsel.Result) -> None:
    # As rasterio reads the hole of a DEM.
    points = result.features.points
    z = np.ma.masked_equal(np.where(np.arange(len(points)) == 3, -9999.0, points.ground[:, 2]),
                           -9999.0)
    places = np.ma.column_stack([points.ground[:, :2], z])
    unknown = np.arange(len(points)) == 3
    for found in (result.project(places), result.sigma(places)[:, None],
                  result.locate(points.image, z)[:, :2],
                  result.locate(points.image, lambda xy: np.ma.masked_greater(
                      np.full(len(xy), 500.0), 400.0) if len(xy) else np.empty(0))):
        assert np.isnan(found[3]).all()
    np.testing.assert_array_equal(np.isnan(result.project(places)).all(axis=1), unknown)
    np.testing.assert_array_equal(result.project(places)[~unknown],
                                  result.project(points.ground)[~unknown])


def test_a_masked_height_of_a_point_is_blank() -> None:
    table = columns()
    z = np.ma.masked_equal(np.where(np.arange(24) == 3, -9999.0, table["z"]), -9999.0)
    np.testing.assert_array_equal(np.isnan(points_of(table, z).ground[:, 2]), np.arange(24) == 3)
    with pytest.raises(termsel.TermselError, match="not finite"):
        Points(("A",), np.ma.masked_equal([[1.0, -9999.0]], -9999.0), [[1.0, 2.0, 3.0]])


def crs_objects() -> list[Any]:
    """Return one CRS in several forms of Python."""
    pyproj = pytest.importorskip("pyproj")
    crs = pytest.importorskip("rasterio.crs").CRS
    return [32631, np.int64(32631), pyproj.CRS(32631), crs.from_epsg(32631)]


def test_a_crs_is_a_number_or_an_object_as_well(result: termsel.Result) -> None:
    table = columns()
    for crs in crs_objects():
        assert termsel.read(table, crs=crs).crs == UTM
        assert termsel.prepare("poly-terms", features=table, crs=crs).observations.features.crs \
            == UTM
        assert replace(result.features, crs=crs).crs == UTM
        assert termsel.run(features=table, crs=crs).predicted == result.predicted


@pytest.mark.parametrize("crs", [True, 3.5, ["EPSG:32631"], 999_999])
def test_what_is_no_crs_is_refused(crs: Any) -> None:
    with pytest.raises(termsel.TermselError, match="CRS"):
        termsel.read(columns(), crs=crs)


def frame_of(shapes: list[Any]) -> Any:
    """Return a GeoDataFrame with geometries for the first points of a table."""
    geopandas = pytest.importorskip("geopandas")
    table = columns(len(shapes))
    return geopandas.GeoDataFrame({name: table[name] for name in ("id", "line", "sample")},
                                  geometry=shapes, crs=32631)


def test_a_multipoint_of_one_point_is_that_point() -> None:
    shapely = pytest.importorskip("shapely")
    ground = np.column_stack([columns(8)[axis] for axis in "xyz"])
    plain = termsel.read(frame_of([shapely.Point(place) for place in ground]))
    multi = termsel.read(frame_of([shapely.MultiPoint([place]) for place in ground]))
    np.testing.assert_array_equal(plain.points.ground, ground)
    np.testing.assert_array_equal(multi.points.ground, ground)
    assert isinstance(plain, FeatureSet)


@pytest.mark.parametrize(("wkt", "kind"), [
    (None, "no geometry"), ("POINT EMPTY", "no geometry"),
    ("MULTIPOINT (1 2, 3 4)", "a MultiPoint"), ("LINESTRING (1 2, 3 4)", "a LineString")])
def test_a_row_without_a_point_is_named(wkt: str | None, kind: str) -> None:
    shapely = pytest.importorskip("shapely")
    shapes = [shapely.Point(float(i), float(i * i), 0.0) for i in range(8)]
    shapes[5] = None if wkt is None else shapely.from_wkt(wkt)
    with pytest.raises(termsel.TermselError, match=f"row 6 has {kind}"):
        termsel.read(frame_of(shapes))


def test_a_column_that_is_there_twice_is_refused() -> None:
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame(columns())
    twice = pandas.concat([frame, frame[["line"]] + 5.0], axis=1)
    with pytest.raises(termsel.TermselError, match="several columns named 'line'"):
        termsel.read(twice, crs=UTM)
