"""Messages that say the next step: what is typed as they say it leads on, and not in a circle."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from termsel.cli.main import cli

GROUND = [(0.01 * (i % 4) + 0.0007 * i, 0.01 * (i // 4) + 0.0003 * i * i, 300.0 + 7 * i * (i % 3))
          for i in range(12)]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a table of twelve points in degrees, and the result of a run of it."""
    monkeypatch.chdir(tmp_path)
    write_points("gcps.csv", "EPSG:4979")
    said("run", "gcps.csv", "--out", "result", code=0)
    return tmp_path


def write_points(name: str, crs: str, n: int = 12, without: str = "") -> None:
    columns = [column for column in ("line", "sample", "x", "y", "z") if column != without]
    rows = [f"# crs: {crs}", ",".join(["id", *columns])]
    for i, (x, y, z) in enumerate(GROUND[:n]):
        cells = {"line": 900 - 9000 * y, "sample": 9000 * x + 0.01 * z, "x": 11 + x, "y": 46 + y,
                 "z": z}
        rows.append(",".join([f"P{i}", *(f"{cells[column]:.6f}" for column in columns)]))
    Path(name).write_text("\n".join(rows) + "\n")


def said(*words: str, code: int = 2) -> str:
    done = CliRunner().invoke(cli, [*words], prog_name="termsel")
    assert done.exit_code == code, done.output
    return done.output


def test_degrees_under_a_projected_crs_are_read_with_the_option_that_is_named(
        folder: Path) -> None:
    write_points("wrong.csv", "EPSG:32632")
    assert "In place of EPSG:32632 state --crs EPSG:4979" in said("run", "wrong.csv")
    said("run", "wrong.csv", "--crs", "EPSG:4979", code=0)


@pytest.mark.parametrize("column", ["line", "sample", "x", "y"])
def test_a_column_that_nothing_can_be_is_to_be_added_or_named(folder: Path, column: str) -> None:
    write_points("less.csv", "EPSG:4979", without=column)
    message = said("run", "less.csv")
    assert f"Add it, or name what holds it: --columns {column}=NAME." in message


def test_one_point_is_sent_to_an_rpc_only_on_the_earth(folder: Path) -> None:
    write_points("one.csv", "EPSG:4979", n=1)
    write_points("plane.csv", "local", n=1)
    for settings in ([], ["--solver", "ga"], ["--model", "affine"]):
        message = said("run", "one.csv", *settings)
        # Together with a search or a model, one point does not correct it.
        assert "--rpc FILE, and no model, problem or solver" in message
        assert "--rpc" not in said("run", "plane.csv", *settings)


@pytest.mark.parametrize("words", [("plan", "result"), ("project", "result", "places.csv")])
def test_the_points_of_a_result_are_not_replaced_by_what_is_made_of_it(
        folder: Path, words: tuple[str, ...]) -> None:
    (folder / "places.csv").write_text("# crs: EPSG:4979\nid,x,y,z\nA,11.01,46.01,300\n")
    before = (folder / "gcps.csv").read_bytes()
    message = said(*words, "-o", "gcps.csv", "--overwrite")
    assert "the features of this result come from this file" in message
    assert (folder / "gcps.csv").read_bytes() == before
    assert "--output gcps-2.csv" in message
    said(*words, "-o", "gcps-2.csv", code=0)


def test_a_file_that_is_read_and_would_be_replaced_has_another_name_to_type(folder: Path) -> None:
    (folder / "places.csv").write_text("# crs: EPSG:4979\nid,x,y,z\nA,11.01,46.01,300\n")
    message = said("project", "result", "places.csv", "-o", "places.csv", "--overwrite")
    assert "Choose another name for the output: --output places-2.csv." in message
    # A run writes a folder.
    Path("points.csv").write_bytes(Path("gcps.csv").read_bytes())
    assert "Choose another folder: --out DIR." in said("run", "points.csv", "--out", ".",
                                                       "--overwrite")


def test_a_file_given_as_points_and_lines_is_to_be_given_once(folder: Path) -> None:
    message = said("run", "--points", "gcps.csv", "--lines", "gcps.csv")
    assert "leave --lines out" in message
    assert "give it with --points" not in message


@pytest.mark.parametrize("geometry", ["LineString", "Polygon"])
def test_lines_and_areas_in_place_of_points_lead_to_points(folder: Path, geometry: str) -> None:
    ring = [[11.0, 46.0], [11.01, 46.0], [11.01, 46.01], [11.0, 46.0]]
    coordinates = ring if geometry == "LineString" else [ring]
    Path("roads.geojson").write_text(
        '{"type": "FeatureCollection", "features": [{"type": "Feature", "properties": {}, '
        f'"geometry": {{"type": "{geometry}", "coordinates": {coordinates}}}}}]}}')
    message = said("plan", "result", "--candidates", "roads.geojson")
    assert "make points of these in a GIS" in message


def test_coordinates_in_seconds_of_arc_are_divided(folder: Path) -> None:
    rows = ["id,line,sample,x,y", *(f"P{i},{9 * i},{7 * i * i},{3600 * (48.5 + 0.01 * i)},"
                                    f"{3600 * (34.8 + 0.01 * i * i)}" for i in range(6))]
    Path("arc.csv").write_text("\n".join(rows) + "\n")
    message = said("run", "arc.csv", "--crs", "EPSG:4326")
    assert "If they are seconds of arc, divide by 3600: the first are then 48.5 and 34.8" in message


def test_a_model_and_a_method_exclude_each_other(folder: Path) -> None:
    message = said("run", "gcps.csv", "--model", "poly2d", "--method", "dlt")
    assert "Leave out --model, or --method." in message
    said("run", "gcps.csv", "--method", "dlt", code=0)
