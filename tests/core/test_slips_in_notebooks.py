"""What is at hand in a notebook and is none of what termsel takes: each is told how it becomes one.
"""

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import termsel

SCENE = termsel.simulate_scene("ikonos-hamedan", n_points=20, n_lines=0)
POINTS = SCENE.points
FIT = termsel.fit(SCENE, "affine")
TABLE = {"id": POINTS.ids, "line": POINTS.image[:, 0], "sample": POINTS.image[:, 1],
         "x": POINTS.ground[:, 0], "y": POINTS.ground[:, 1], "z": POINTS.ground[:, 2]}


class PointOfRasterio:
    """A ground control point as rasterio has it."""

    row, col = 1.0, 2.0


class Estimator:
    """A regressor as scikit-learn has it."""

    def fit(self) -> None:
        """Fit nothing."""

    def predict(self) -> None:
        """Predict nothing."""


class OpenRaster:
    """A raster that rasterio has opened."""

    name = "dem.tif"

    def close(self) -> None:
        """Close nothing."""


@pytest.mark.parametrize(("table", "words"), [
    ([[1.0, 2.0, 48.5, 34.8]], "the type list of list. Name the columns: pandas.DataFrame(ROWS,"),
    (np.ones((2, 5)), "the type ndarray. Name the columns"),
    (["a.csv", "b.csv"], "Read each file by itself"),
    ([PointOfRasterio()], "for p in GCPS], crs=CRS, image_origin='corner')"),
    (([PointOfRasterio()], "EPSG:4326"), "GCPS, CRS = DATASET.gcps, then read GCPS"),
    ({"line": 1.0, "sample": 2.0}, "Give each column a list, also of one row")])
def test_what_is_no_table_is_told_how_it_becomes_one(table: Any, words: str) -> None:
    with pytest.raises(termsel.TermselError, match=re.escape(words)):
        termsel.read(table, crs="EPSG:4979")


def test_the_call_that_is_told_for_points_of_rasterio_reads_them() -> None:
    control = pytest.importorskip("rasterio.control")
    points = [control.GroundControlPoint(row=line + 0.5, col=sample + 0.5, x=x, y=y, z=z, id=name)
              for name, (line, sample), (x, y, z) in zip(
                  POINTS.ids, POINTS.image.tolist(), POINTS.ground.tolist(), strict=True)]
    rows = [{"id": p.id, "line": p.row, "sample": p.col, "x": p.x, "y": p.y, "z": p.z}
            for p in points]
    features = termsel.read(rows, crs="EPSG:4979", image_origin="corner")
    np.testing.assert_allclose(features.points.image, POINTS.image, atol=1e-9)


@pytest.mark.parametrize(("shape", "words"), [
    ("Polygon", "has the geometry of a Polygon, expected points. Their centres are points"),
    ("LineString", "A table of lines has columns line1")])
def test_geometries_that_are_no_points_are_named(shape: str, words: str) -> None:
    geopandas = pytest.importorskip("geopandas")
    shapely = pytest.importorskip("shapely")
    places = [(48.0, 34.0), (48.1, 34.0), (48.1, 34.1)]
    table = geopandas.GeoDataFrame({"line": [1.0], "sample": [2.0]}, crs=4326,
                                   geometry=[getattr(shapely, shape)(places)])
    with pytest.raises(termsel.TermselError, match=re.escape(words)):
        termsel.read(table)


def test_points_of_shapely_in_a_plain_table_lead_to_a_geodataframe() -> None:
    pandas = pytest.importorskip("pandas")
    shapely = pytest.importorskip("shapely")
    table = pandas.DataFrame({"line": [1.0], "sample": [2.0], "place": [shapely.Point(48, 34)]})
    with pytest.raises(termsel.TermselError, match="GeoDataFrame\\(TABLE, geometry='place'"):
        termsel.read(table, crs="EPSG:4326")


def test_a_geometry_in_another_crs_and_columns_beside_it(caplog: pytest.LogCaptureFixture) -> None:
    geopandas = pytest.importorskip("geopandas")
    table = geopandas.GeoDataFrame(
        TABLE | {"x": TABLE["x"] + 7.0}, crs=4326,
        geometry=geopandas.points_from_xy(TABLE["x"], TABLE["y"]))
    with pytest.raises(termsel.TermselError, match=re.escape(
            "the geometry declares the CRS EPSG:4326, but crs says EPSG:32639. Leave crs out, or "
            "give TABLE.to_crs('EPSG:32639')")):
        termsel.read(table, crs=32639)
    features = termsel.read(table)
    np.testing.assert_array_equal(features.points.ground[:, 0], TABLE["x"])
    assert "the column 'x' of row 1 is" in caplog.text


def test_a_masked_cell_is_blank() -> None:
    masked = np.ma.masked_equal(np.where(np.arange(20) == 3, -1.0, TABLE["line"]), -1.0)
    with pytest.raises(termsel.TermselError, match="row 4: the cell is blank"):
        termsel.read(TABLE | {"line": masked}, crs="EPSG:4979")


def test_a_fit_takes_the_crs_as_programs_have_it() -> None:
    pyproj = pytest.importorskip("pyproj")
    for crs in (4979, pyproj.CRS(4979), "EPSG:4979"):
        assert termsel.fit(TABLE, "affine", crs=crs).control.crs == "EPSG:4979"


@pytest.mark.parametrize(("model", "words"), [
    (lambda ground: ground, "termsel.FunctionMethod(NAME, TITLE, function=FUNCTION)"),
    (Estimator(), "model=regressor_method(Estimator())"),
    (np.ones((20, 2)), "columns of one table"),
    (Estimator, "a subclass of termsel.SensorModel: of termsel.RationalModel it needs name and"),
    ("polynomial", "Did you mean 'poly2d' or 'poly3d'?"),
    ("homography", "Did you mean 'projective2d'?"),
    ("poly4", "Name it poly2d, or poly3d with heights, and degree=4")])
def test_what_is_no_model_is_told_what_is(model: Any, words: str) -> None:
    with pytest.raises(termsel.TermselError, match=re.escape(words)):
        termsel.fit(SCENE, model)


def test_an_rpc_that_lacks_is_given_where_points_are_read() -> None:
    pytest.importorskip("termsel_rpc")
    with pytest.raises(termsel.TermselError, match=re.escape("termsel.read(TABLE, rpc=FILE)")):
        termsel.fit(SCENE, "rpc")


def test_a_fault_of_a_class_of_the_session_is_no_bug_of_a_plugin() -> None:
    def blocks(_self: object, ground: Any) -> Any:
        """Return what is no value of `Blocks`."""
        return ground

    typed = type("Typed", (termsel.RationalModel,), {
        "__doc__": "Typed.", "__module__": "__main__", "name": "typed", "blocks": blocks})
    with pytest.raises(termsel.TermselError, match="It is defined in this session: correct") as it:
        termsel.fit(SCENE, typed)
    assert "bug in the plugin" not in str(it.value)


@pytest.mark.parametrize(("call", "words"), [
    (lambda: termsel.read("a.csv", dem=OpenRaster()), "open file: dem='dem.tif'"),
    (lambda: termsel.read("a.csv", image=np.ones((9, 9))), "Write the array to a file first"),
    (lambda: FIT.project(np.array([["48.5", "34.8", "high"]])), "'high' in row 0, column 2"),
    (lambda: FIT.project([[48.5, 34.8, 1j]]), "has 1j in row 0, column 2, expected numbers"),
    (lambda: termsel.FeatureSet(TABLE), "points is of the type dict, expected a termsel.Points"),
    (lambda: termsel.FeatureSet(POINTS, "EPSG:4979"), "lines is 'EPSG:4979', expected"),
    (lambda: termsel.Points("AB", np.ones((2, 2)), np.ones((2, 3))), "ids is 'AB', expected a"),
    (lambda: termsel.Points(("A",), np.ones((1, 2)), np.ones((1, 2))), "with NaN for a height"),
    (lambda: termsel.Points(("A",), np.ones((1, 2)), np.ones((1, 3)), np.ones(1)),
     "two values of each, of line and of sample"),
    (lambda: termsel.Points(("A",), np.ones((1, 2)), np.ones((1, 3)), roles=["off", "off"]),
     "Give each a role"),
    (lambda: termsel.Subset("points", ("A", "B"), m=5), "m is from 0 to the 2 labels"),
    (lambda: termsel.search(None, "ga"), "expected a termsel.Problem"),
    (lambda: termsel.read(TABLE, crs={"proj": "utm"}), "crs=pyproj.CRS(DICT)"),
    (lambda: termsel.read(TABLE, crs=4979, rpc_offset="left"), "rpc_offset='700,900'"),
    (lambda: FIT.project(SCENE), "ground=features.points.ground"),
    (lambda: FIT.project(POINTS), "ground=points.ground"),
    (lambda: FIT.project({"x": [1.0], "y": [2.0]}), "pandas.DataFrame(DICT)[['x', 'y', 'z']]"),
    (lambda: FIT.locate([10.0, 20.0], 5.0), "[[line, sample]]"),
    (lambda: termsel.fit(SCENE, "auto"), "termsel.run(features=FEATURES) chooses"),
    (lambda: termsel.prepare(SCENE), "Points and lines are features=FEATURES"),
    (lambda: termsel.assess("affine", SCENE), "termsel.get('methods', NAME)"),
    (lambda: termsel.Search("poly-terms", "ga"), "settings is 'ga', expected a dict"),
    (lambda: POINTS.take(["P001"]), "'P001' is no row"),
    (lambda: POINTS.take([True, False]), "the mask has shape (2,), expected (20,)"),
    (lambda: POINTS.take([99]), "there is no row 99"),
    (lambda: POINTS.take([1.5]), "1.5 is no row"),
    (lambda: SCENE.take([0, 1]), "features.points.take(ROWS)"),
    (lambda: termsel.register(len), "Register a class, such as a subclass of")])
def test_a_value_of_another_kind_is_told_what_to_give(
        call: Callable[[], object], words: str) -> None:
    with pytest.raises(termsel.TermselError, match=re.escape(words)):
        call()


@pytest.mark.parametrize(("get", "words"), [
    (lambda: POINTS.iloc, "points.to_pandas()"),
    (lambda: SCENE.head, "features.points.to_pandas()"),
    (lambda: SCENE.to_crs, "TABLE.to_crs(CRS)"),
    (lambda: termsel.TermSelector, "Write: from termsel_sklearn import TermSelector."),
    (lambda: termsel.rpc_of(FIT).project, "The RPC does it: .rpc.project(places)"),
    (lambda: termsel.rpc_of(FIT).rpc.LINE_OFF, "It is in rpc.image_offset"),
    (lambda: FIT.held_out().rmse, "held_out.squares.mean()"),
    (lambda: termsel.sklearn, "Write: import termsel_sklearn."),
    (lambda: setattr(SCENE, "crs", "EPSG:32639"), "dataclasses.replace(features, crs=VALUE)"),
    (lambda: setattr(POINTS, "image", 1), "dataclasses.replace(points, image=VALUE)")])
def test_an_attribute_that_is_not_there_or_does_not_change(
        get: Callable[[], object], words: str) -> None:
    with pytest.raises(AttributeError, match=re.escape(words)):
        get()


def test_a_class_of_the_kind_is_corrected_and_no_other_is_proposed() -> None:
    blank = type("Blank", (termsel.Polynomial2D,), {"__doc__": "Blank.", "name": "my model"})
    with pytest.raises(termsel.TermselError, match=r"blanks and colons\. Correct the class\."):
        termsel.fit(SCENE, blank)


def test_points_of_shapely_are_given_by_their_coordinates() -> None:
    shapely = pytest.importorskip("shapely")
    for shapes in (shapely.Point(48.5, 34.8), [shapely.Point(48.5, 34.8)]):
        with pytest.raises(termsel.TermselError, match=r"ground=shapely\.get_coordinates\(SHAPES"):
            FIT.project(shapes)


def test_options_by_position_are_told_by_name() -> None:
    with pytest.raises(TypeError, match=re.escape("Polynomial2D(degree=3)")):
        termsel.Polynomial2D(3)
    with pytest.raises(TypeError, match=re.escape("Affine takes no options: write Affine()")):
        termsel.Affine(3)


def test_places_far_outside_the_image_are_told(caplog: pytest.LogCaptureFixture) -> None:
    FIT.locate(POINTS.image[:2], 1800.0)
    assert not caplog.text
    FIT.locate([[1e6, 2e6]], 1800.0)
    assert "1 row is far outside the control" in caplog.text
