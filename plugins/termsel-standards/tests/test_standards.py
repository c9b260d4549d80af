"""Accuracy by standards: worked examples, brute force, statements, and files that are wrong."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from math import hypot
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("termsel_standards", reason="termsel-standards is not installed: "
                    "pip install -e plugins/termsel-standards")

import termsel
from termsel import FeatureSet, Points, Result, TermselError, export, write_result
from termsel.testing import check, invoke
from termsel.toolkit.files import accuracy_tags
from termsel_standards import GroundErrors, errors_of, read_errors, statements_of
from termsel_standards.quality.report import quality_of
from termsel_standards.stac import StacItem
from termsel_standards.statement import ASPRS, class_of, distribution_of

# The example of the ASPRS standards' annex on computing accuracy: five check points.
EXAMPLE = """id,dx,dy,dz
GCP1,-0.140,-0.070,-0.071
GCP2,-0.100,-0.100,0.010
GCP3,0.017,-0.070,0.102
GCP4,-0.070,0.150,-0.100
GCP5,0.130,0.120,0.087
"""


def errors(values: np.ndarray, survey: float = np.nan, places: np.ndarray | None = None,
           ) -> GroundErrors:
    return GroundErrors(
        tuple(map(str, range(len(values)))), values, np.full(values.shape, survey),
        np.full((len(values), 2), np.nan) if places is None else places)


@pytest.fixture(scope="module")
def result() -> Result:
    features = termsel.simulate_scene("ikonos-hamedan", n_lines=0)
    points = features.points
    sigma = np.array([f"{0.3 + 0.01 * (i % 7):g}" for i in range(len(points))], dtype=object)
    return termsel.run(features=replace(features, points=replace(points, attributes={
        "sigma_x": sigma, "sigma_y": sigma})))


def _repeated(few: GroundErrors, times: int) -> GroundErrors:
    return replace(few, ids=few.ids * times, errors=np.tile(few.errors, (times, 1)),
                   survey=np.tile(few.survey, (times, 1)),
                   positions=np.tile(few.positions, (times, 1)))


def test_the_example_of_the_asprs_standards(tmp_path: Path) -> None:
    path = tmp_path / "example.csv"
    path.write_text(EXAMPLE)
    stated = statements_of(read_errors(path))
    assert [round(one.mean, 3) for one in stated.components] == [-0.033, 0.006, 0.006]
    assert [round(one.deviation or 0, 3) for one in stated.components] == [0.108, 0.119, 0.091]
    assert [round(one.rmse, 3) for one in stated.components] == [0.102, 0.106, 0.081]
    assert round(stated.horizontal, 3) == 0.147
    few = {one.standard: one for one in stated.statements}
    assert few["NSSDA horizontal"].value is None  # 5 points are too few
    assert few["ASPRS horizontal"].words == (
        "not stated: 5 check points; at least 20 are needed for a statement by a reduced number, "
        "and 30 for the full one")
    twenty = statements_of(_repeated(read_errors(path), 4))
    reduced = {one.standard: one for one in twenty.statements}
    assert reduced["ASPRS horizontal"].words == (
        f"This data set was tested as required by {ASPRS}. Although the Standards call for a "
        "minimum of thirty (30) checkpoints, this test was performed using ONLY 20 checkpoints. "
        "This data set was produced to meet a 15 cm RMSEH Horizontal Positional Accuracy Class. "
        "The tested horizontal positional accuracy was found to be RMSEH = 14.7 cm using the "
        "reduced number of checkpoints")
    # Repeated until there are enough, the points have the same RMSE, and the example's figures.
    stated = statements_of(_repeated(read_errors(path), 6))
    by_name = {one.standard: one for one in stated.statements}
    assert round(by_name["NSSDA horizontal"].value or 0, 3) == 0.255
    assert round(by_name["NSSDA vertical"].value or 0, 3) == 0.160
    assert by_name["NSSDA horizontal"].words == \
        "Tested 0.255 meters horizontal accuracy at 95% confidence level"
    assert round(by_name["ASPRS horizontal"].value or 0, 3) == 0.147
    assert by_name["ASPRS horizontal"].words == (
        f"This data set was tested to meet {ASPRS} for a 15 cm RMSEH Horizontal Positional "
        "Accuracy Class. The tested horizontal positional accuracy was found to be RMSEH = 14.7 cm")
    assert by_name["ASPRS vertical"].words.endswith(
        "for a 8.2 cm RMSEV Vertical Accuracy Class. The Non-Vegetated Vertical Accuracy (NVA) was "
        "found to be RMSEV = 8.14 cm")
    assert "RMSE3D Three-Dimensional Positional Accuracy Class. The tested three-dimensional " \
        "accuracy was found to be RMSE3D = 16.8 cm within the NVA tested area" in \
        by_name["ASPRS three-dimensional"].words
    assert "it is not known which check points are under vegetation" in \
        by_name["ASPRS vegetated vertical"].words


@given(st.floats(0.001, 50), st.floats(0, 50), st.floats(0, 50))
def test_the_error_of_the_survey_is_added_in_squares(size: float, plan: float, up: float) -> None:
    values = np.random.default_rng(1).normal(0, size, (30, 3))
    stated = statements_of(errors(values).surveyed(plan, up))
    horizontal, vertical, space, *_ = (one.value or 0.0 for one in stated.statements)
    tested = np.sqrt((values[:, :2] ** 2).sum(axis=1).mean())
    assert horizontal == pytest.approx(hypot(tested, plan * 2**0.5))
    assert vertical == pytest.approx(hypot(np.sqrt((values[:, 2] ** 2).mean()), up))
    assert space == pytest.approx(hypot(horizontal, vertical))
    assert stated.horizontal == pytest.approx(tested)


def test_a_survey_of_2_cm_and_a_fit_of_1_cm_are_2_24_cm() -> None:
    # Figures that are taught with edition 2: the root of the sum of the squares.
    flat = np.array([[0.01, 0.0], [-0.01, 0.0]] * 15)
    stated = statements_of(errors(flat).surveyed(0.02 / 2**0.5))
    assert stated.statements[0].value == pytest.approx(0.0223607)


def test_a_mean_error_above_a_quarter_of_the_class_is_named() -> None:
    values = np.tile([[0.3, 0.01], [0.24, -0.01]], (15, 1))
    notes = " ".join(statements_of(errors(values), 1.0).notes)
    assert "above 25% of the RMSE of the class" in notes
    assert "25%" not in " ".join(statements_of(errors(values), 1.1).notes)


def test_the_mean_error_is_held_against_the_class_that_is_stated_unasked() -> None:
    # RMSE 1.09 m, so that the statement has 110 cm; a quarter of it is 0.275 m.
    around = np.tile([[0.5, 0.9], [-0.5, -0.9]], (15, 1))
    east = np.array([1.0, 0.0])
    shifted = statements_of(errors(around + 0.35 * east))
    assert "110 cm RMSEH" in shifted.statements[0].words
    assert any("mean error east is above 25%" in note for note in shifted.notes)
    assert not any("25%" in note for note in statements_of(errors(around + 0.2 * east)).notes)
    # Nine points have no statement, and so no class.
    few = errors((around + 0.35 * east)[:9])
    assert not any("25%" in note for note in statements_of(few).notes)


def test_more_check_points_are_asked_for_a_large_area() -> None:
    places = np.random.default_rng(8).uniform(0, 60e3, (40, 2))
    stated = statements_of(errors(np.ones((40, 2)), places=places))
    assert "was tested to meet" in stated.statements[0].words
    assert "ASPRS asks for 60 check points" in " ".join(stated.notes)


@given(st.floats(1e-6, 1e5))
def test_the_class_is_the_least_of_two_digits_that_is_met(value: float) -> None:
    met = class_of(value)
    assert met >= value * (1 - 1e-9)
    assert met < value * 1.1 + 1e-12
    assert float(f"{met:.2g}") == pytest.approx(met)


def test_a_survey_of_its_own_goes_before_the_option() -> None:
    known = errors(np.ones((30, 2)), 0.5)
    assert known.surveyed(9.0).survey.max() == 0.5
    half = replace(known, survey=np.where(np.arange(30)[:, None] < 15, 0.5, np.nan))
    assert "not known" in " ".join(statements_of(half).notes)
    assert statements_of(half.surveyed(0.5)).survey_horizontal == pytest.approx(0.5**0.5)


@pytest.mark.parametrize(("side", "required"), [
    (1e3, 30), (31.6e3, 30), (32e3, 40), (60e3, 60), (96e3, 120), (500e3, 120)])
def test_as_many_check_points_as_the_area_asks_for(side: float, required: int) -> None:
    rng = np.random.default_rng(2)
    places = np.concatenate([[[0, 0], [side, side]], rng.uniform(0, side, (98, 2))])
    where = distribution_of(errors(np.ones((100, 2)), places=places))
    assert where.area == pytest.approx(side**2 / 1e6)
    assert where.required == required
    assert sum(where.quadrants or ()) == 100


def test_a_corner_without_points_is_named() -> None:
    x, y = np.meshgrid(np.arange(8.0), np.arange(8.0))
    places = 1000 * np.column_stack([x.ravel(), y.ravel()])
    spread = errors(np.ones((64, 2)), places=places)
    assert distribution_of(spread).faults == ()
    corner = ~((places[:, 0] < 3500) & (places[:, 1] < 3500))
    rest = errors(np.ones((int(corner.sum()), 2)), places=places[corner])
    assert "a quadrant" in " ".join(statements_of(rest).notes)


def test_a_shift_is_named_and_chance_is_not() -> None:
    noise = np.random.default_rng(3).normal(0, 1, (40, 2))
    assert "look for a shift" not in " ".join(statements_of(errors(noise)).notes)
    shifted = noise + np.array([2.0, 0.0])
    assert "error east is significant (Student's t of 40 check points" in " ".join(
        statements_of(errors(shifted)).notes)
    # Of a few points no mean is tested, however alike they are.
    few = np.array([[2.0, 0.0], [2.01, 0.3], [1.99, -0.2]])
    assert "look for a shift" not in " ".join(statements_of(errors(few)).notes)


def test_what_is_said_of_a_class_that_is_not_met() -> None:
    values = np.random.default_rng(4).normal(0, 1, (40, 2))
    words = statements_of(errors(values), 0.5).statements[0].words
    assert words.startswith("not stated, as 1")
    assert words.endswith("cm is above the 50 cm of the class")


def test_figures_of_a_result_are_those_of_its_record(result: Result) -> None:
    of_points = errors_of(result)
    assert result.accuracy is not None
    ground = result.accuracy.ground
    assert ground is not None
    stated = statements_of(of_points)
    assert stated.horizontal == pytest.approx(ground.total, rel=1e-12)
    assert stated.ce90 == pytest.approx(ground.ce90, rel=1e-12)
    assert [one.rmse for one in stated.components] == pytest.approx([ground.x, ground.y])
    assert stated.survey_horizontal == pytest.approx(0.33 * 2**0.5, rel=0.05)
    assert stated.distribution.area == pytest.approx(55.6, rel=0.02)


def test_a_fit_that_has_used_the_points_is_not_tested_by_them(result: Result) -> None:
    assert result.final is not None
    with pytest.raises(TermselError, match="has used the independent points"):
        errors_of(result.as_exported())


def test_the_command_states_and_prints_json(result: Result, tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    write_result(result, tmp_path / "run")
    shown = invoke("accuracy", tmp_path / "run")
    assert shown.exit_code == 0
    assert "NSSDA horizontal: Tested" in shown.output
    assert "was performed using ONLY 26" in shown.output.replace("\n    ", " ")
    as_json = invoke("accuracy", tmp_path / "run", "--json")
    assert json.loads(as_json.output)["horizontal"] == pytest.approx(
        statements_of(errors_of(result)).horizontal)


@pytest.mark.parametrize(("text", "said"), [
    ("", "the file is empty"),
    ("id,dx\nA,1\n", "it has no columns dx and dy. The columns here are: id, dx. "),
    ("id,dx,dy\nA,1,x\n", "line 2, column 'dy': 'x' is not a number"),
    ("id,dx,dy\nA,1,2\nB,,2\n", "line 3, column 'dx': this cell is blank"),
    ("id,dx,dy\nA,1,nan\n", "is not a number"),
    ("id,dx,dy,dz\nA,1,2,3\nB,1,2,\n", "line 3, column 'dz': this cell is blank"),
    ("id,dx,dy,x,y\nA,1,2,50,60\nB,1,2,50,61\nC,2,1,50,60\n",
     "line 4: 'A' of line 2 and 'C' are at the same x and y"),
    ("id,dx,dy,sigma_x\nA,1,2,-3\n", "sigma_x of A is -3"),
    ("id,dx,dy\nA,1,2\nB,1,2\nA,2,1\n", "line 4, column 'id': the id 'A' is that of line 2"),
    ("id,dx,dy\nA,1\n", "line 2, column 'dy': this cell is blank"),
    ("id,dx,dy\nA,1e999,2\n", "not a number")])
def test_a_bad_table_is_refused_with_its_place(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(TermselError) as fault:
        read_errors(path)
    assert said in str(fault.value)
    shown = invoke("accuracy", path)
    assert shown.exit_code == 2
    assert "Traceback" not in shown.output


def test_nobody_knows_what_the_points_of_a_table_took_part_in(tmp_path: Path) -> None:
    path = tmp_path / "example.csv"
    path.write_text(EXAMPLE)
    shown = invoke("accuracy", path).output
    assert "5 independent check points, which must have taken no part in any choice" in shown


def test_a_table_that_is_no_text(tmp_path: Path) -> None:
    path = tmp_path / "bad.csv"
    path.write_bytes(b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR")
    with pytest.raises(TermselError, match="binary"):
        read_errors(path)


def test_a_result_without_independent_points(result: Result) -> None:
    points = result.features.points
    roles = ["check" if role == "independent" else role for role in points.roles]
    none = result.with_(features=replace(result.features, points=replace(
        points, roles=tuple(roles))))
    with pytest.raises(TermselError, match="no independent points"):
        errors_of(none)


def test_the_writer_conforms() -> None:
    check(StacItem(), filename="item.json")


def test_a_stac_item_has_the_outline_and_the_accuracy(result: Result, tmp_path: Path) -> None:
    path = tmp_path / "item.json"
    export(result, "stac-item", path, href="scene.tif", date="2024-05-31")
    item = json.loads(path.read_text())
    stated = statements_of(errors_of(result))
    assert item["properties"]["accuracy:geometric_rmse"] == pytest.approx(stated.horizontal)
    assert item["properties"]["datetime"] == "2024-05-31T00:00:00Z"
    assert item["assets"]["image"]["href"] == "scene.tif"
    ring = np.array(item["geometry"]["coordinates"][0])
    assert (ring[0] == ring[-1]).all()
    x, y = ring[:-1].T
    assert x @ np.roll(y, -1) - y @ np.roll(x, -1) > 0  # counter-clockwise, as RFC 7946 has it
    assert item["bbox"] == [*ring.min(axis=0), *ring.max(axis=0)]
    inside = result.features.points.ground[:, :2]
    assert (inside >= item["bbox"][:2]).all()
    assert (inside <= item["bbox"][2:]).all()


def map_around(lon: float, lat: float, crs: str) -> Result:
    """Return an affine map of 1000 x 800 px, 2 km each, around a place in a projection."""
    from pyproj import Transformer

    to_plane = Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    east, north = to_plane.transform(lon, lat)
    image = np.random.default_rng(5).uniform(0.0, [799.0, 999.0], (12, 2))
    x, y = east + 2000.0 * (image[:, 1] - 500.0), north - 2000.0 * (image[:, 0] - 400.0)
    lonlat = np.column_stack(to_plane.transform(x, y, direction="INVERSE"))
    points = Points(tuple(map(str, range(12))), image,
                    np.column_stack([lonlat, np.full(12, np.nan)]))
    return termsel.run(features=FeatureSet(points, crs="EPSG:4326", image_size=(800, 1000)))


def test_an_outline_across_180_degrees_is_cut_there(tmp_path: Path) -> None:
    across = map_around(179.5, -18.0, "EPSG:3832")
    export(across, "stac-item", tmp_path / "item.json")
    item = json.loads((tmp_path / "item.json").read_text())
    west, south, east, north = item["bbox"]
    assert 168.0 < west < 171.0
    assert -172.0 < east < -169.0
    assert -26.0 < south < -24.0 < -12.0 < north < -10.0
    assert item["geometry"]["type"] == "MultiPolygon"
    rings = [np.array(polygon[0]) for polygon in item["geometry"]["coordinates"]]
    assert sorted(np.sign(ring[:, 0].mean()) for ring in rings) == [-1.0, 1.0]
    assert all(np.ptp(ring[:, 0]) < 12.0 for ring in rings)
    export(across, "fgdc-xml", tmp_path / "metadata.xml")
    text = (tmp_path / "metadata.xml").read_text()
    assert f"<westbc>{west:.9g}" in text or f"<westbc>{west}" in text
    assert "<eastbc>-1" in text


def test_an_outline_around_a_pole_has_the_pole(tmp_path: Path) -> None:
    export(map_around(0.0, 90.0, "EPSG:3413"), "stac-item", tmp_path / "item.json")
    item = json.loads((tmp_path / "item.json").read_text())
    assert item["bbox"][0::2] == [-180.0, 180.0]
    assert item["bbox"][3] == 90.0
    assert 76.0 < item["bbox"][1] < 84.0


@pytest.mark.parametrize("date", ["yesterday", "2024-13-01", "1e9"])
def test_a_date_that_is_none(date: str, result: Result, tmp_path: Path) -> None:
    with pytest.raises(TermselError, match="cannot be read"):
        export(result, "stac-item", tmp_path / "item.json", date=date)
    assert not list(tmp_path.iterdir())


def faults(schema: str, item: dict[str, Any]) -> list[str]:
    """What the schema of an extension finds wrong; schemas of others that it names are skipped."""
    jsonschema: Any = pytest.importorskip("jsonschema")
    referencing: Any = pytest.importorskip("referencing.jsonschema")

    def other(_uri: str) -> Any:
        return referencing.DRAFT7.create_resource({})

    text = (Path(__file__).with_name("schemas") / f"stac-{schema}.json").read_text()
    validator = jsonschema.Draft7Validator(
        json.loads(text), registry=pytest.importorskip("referencing").Registry(retrieve=other))
    return [error.message for error in validator.iter_errors(item)]


def test_a_stac_item_is_valid(result: Result, tmp_path: Path) -> None:
    pystac = pytest.importorskip("pystac")
    local = pytest.importorskip("pystac.validation.local_validator")
    path, image = tmp_path / "item.json", tmp_path / "scene.tif"
    image.write_bytes(b"pixels")
    export(result, "stac-item", path, image=image)
    item = json.loads(path.read_text())
    schema = f"https://schemas.stacspec.org/v{item['stac_version']}/item-spec/json-schema/item.json"
    valid = local.LocalValidator()
    assert valid._validate_from_local(schema, item) == []
    assert valid._validate_from_local(schema, {**item, "bbox": [1]}) != []
    read = pystac.Item.from_file(str(path))
    assert read.ext.proj.code == "EPSG:4326"
    asset = read.assets["image"]
    assert asset.href == "scene.tif"
    assert asset.ext.file.size == 6
    assert asset.ext.file.checksum == "1220" + hashlib.sha256(b"pixels").hexdigest()
    for name in ("file", "projection"):
        assert faults(name, item) == []
    assert faults("file", {**item, "assets": {"image": {"href": "a", "file:size": -1}}})
    wrong = {**item["properties"], "proj:code": 4326}
    assert faults("projection", {**item, "properties": wrong})


def test_the_fields_of_other_extensions_are_of_their_types(
        result: Result, tmp_path: Path) -> None:
    # Of processing 1.2 and accuracy 1.0 beta: names and types of their fields, from their texts.
    path = tmp_path / "item.json"
    export(result, "stac-item", path)
    item = json.loads(path.read_text())
    known = {name: value for name, value in item["properties"].items() if ":" in name}
    assert set(known) == {"proj:code", "processing:software", "processing:lineage",
                          "accuracy:geometric_rmse"}
    assert all(isinstance(value, str) for value in known["processing:software"].values())
    assert isinstance(known["processing:lineage"], str)
    assert known["accuracy:geometric_rmse"] > 0
    # An item declares the extensions that it has fields of, no others.
    assert [uri.split("/")[3] for uri in item["stac_extensions"]] == [
        "projection", "processing", "accuracy"]
    export(result.with_(accuracy=None), "stac-item", path, overwrite=True)
    bare = json.loads(path.read_text())
    assert [uri.split("/")[3] for uri in bare["stac_extensions"]] == ["projection", "processing"]


def test_without_independent_points_the_prediction_is_stated_and_called_one(
        tmp_path: Path) -> None:
    scene = termsel.simulate_scene("ikonos-hamedan", roles=(14, 0, 0))
    result = termsel.run(features=scene, out=tmp_path / "out")
    assert result.predicted is not None
    text = invoke("accuracy", tmp_path / "out").stdout
    assert "Predicted, not tested by independent check points: RMSE" in " ".join(text.split())
    assert "134 control features" in " ".join(text.split())
    assert "ASPRS: not stated, as no independent check points were measured" in text
    stated = json.loads(invoke("accuracy", tmp_path / "out", "--json").stdout)
    assert stated["rmse"] == result.predicted.rmse
    done = invoke("export", tmp_path / "out", "--to", "fgdc-xml", "-o", tmp_path / "quality.xml")
    assert done.exit_code == 0, done.stderr
    metadata = (tmp_path / "quality.xml").read_text("utf-8")
    # Two sentences, each with its own full stop.
    assert "predicted those. Predicted, not tested" in metadata
    assert ".." not in metadata
    assert stated["low_ground"] < stated["rmse_ground"] < stated["high_ground"]
    report = quality_of(result)
    assert {measure.unit for measure in report.measures} == {"px", "m"}
    assert all(measure.name.startswith("predicted") for measure in report.measures)
    assert "No test by independent points" in report.method
    tags = accuracy_tags(result)
    assert tags["ACCURACY_PREDICTED_BY"].endswith("not an independent test")
    assert "ACCURACY_RMSE_PX" not in tags
    # Of several results, one of unknown accuracy keeps no other from its statement.
    folder = tmp_path / "several"
    (folder / "images").mkdir(parents=True)
    (tmp_path / "out").rename(folder / "images" / "a")
    ground = scene.points.ground[:2] * [1.0, 1.0, np.nan]
    two = replace(scene.points.take([0, 1]), ground=ground)
    termsel.run(features=termsel.FeatureSet(two, crs=scene.crs), out=folder / "images" / "b")
    done = invoke("accuracy", folder, "--json")
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)[0]["rmse"] == result.predicted.rmse
    assert "not stated: the result has no independent points" in done.stderr


@pytest.mark.slow_cases("24-False")
@pytest.mark.parametrize(("independent", "is_stated"), [(3, True), (24, False)])
def test_few_check_points_leave_the_prediction_to_sign(
        independent: int, is_stated: bool, tmp_path: Path) -> None:
    scene = termsel.simulate_scene("ikonos-hamedan", roles=(20, 0, independent))
    termsel.run(features=scene, out=tmp_path / "out")
    text = invoke("accuracy", tmp_path / "out").stdout
    assert ("Predicted, not tested by independent check points" in text) == is_stated
    figure = ("the predicted RMSE above, as predicted: 3 check points are too few for a test"
              if is_stated else "the tested figures of ASPRS and NSSDA above")
    assert text.endswith(f"To sign: {figure}.\nDate:                Signed:\n")
    stated = json.loads(invoke("accuracy", tmp_path / "out", "--json").stdout)
    assert (stated["prediction"] is not None) == is_stated
    assert stated["distribution"]["points"] == independent


@pytest.mark.slow
def test_a_statement_repeats_that_an_rpc_seems_fitted_to_its_points(tmp_path: Path) -> None:
    pytest.importorskip("termsel_rpc")
    scene = termsel.simulate_scene("ikonos-hamedan")
    features = scene.take(np.arange(len(scene)) < 14)
    features = features.with_(points=replace(features.points, roles=()))
    rpc = termsel.rpc_of(termsel.fit(features, "affine")).rpc.as_delivered()
    result = termsel.run(features=replace(features, rpc=rpc), method="rpc")
    write_result(result, tmp_path)
    shown = invoke("accuracy", tmp_path)
    assert "Warning: " in shown.stderr
    assert "as if it had been fitted to them" in shown.stderr


@pytest.mark.parametrize(("header", "row", "words"), [
    ("id,dx (mm),dy (mm)", "A,4,1", "Convert them to metres, and name them without the unit."),
    ("Punkt;dE [mm];dN [mm]", "A;4;1", "The columns here are: Punkt, dE [mm], dN [mm]. Convert"),
    ("id;dx;dy", "A;0,4;0,1", "column 'dx': '0,4' is not a number. Give metres, with a decimal")])
def test_a_table_of_errors_in_other_words_takes_one_message(
        header: str, row: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "errors.csv").write_text(f"{header}\n{row}\n")
    assert words in invoke("accuracy", tmp_path / "errors.csv").stderr
    (tmp_path / "errors.csv").write_text("id;dx;dy\nA;0.4;0.1\nB;0.2;0.1\nC;0.1;0.3\n")
    assert invoke("accuracy", tmp_path / "errors.csv").exit_code == 0
