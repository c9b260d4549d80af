"""The commands export and project, and --export of run."""

from __future__ import annotations

import json
import logging
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import termsel
from termsel.cli.main import cli
from termsel.io.plan import plan
from termsel.io.project import project_table
from termsel.io.result_folder import read_result, write_result
from termsel.results.result import checksum_of_record
from termsel.testing import example_results


def _termsel(*arguments: object) -> tuple[int, str, str]:
    done = CliRunner().invoke(cli, [str(argument) for argument in arguments])
    return done.exit_code, done.stdout, done.stderr


@pytest.fixture(scope="module")
def of_all_terms() -> termsel.Result:
    """A result in WGS84, of a plain model that is an RPC as it is."""
    return termsel.run("rfm-terms", model="poly3d", solver="all-terms", dataset="irs1c-mashad")


@pytest.fixture
def folder(of_all_terms: termsel.Result, tmp_path: Path) -> Path:
    """Its folder, which a test may change."""
    path = tmp_path / "result"
    path.mkdir()
    write_result(of_all_terms, path)
    return path


@pytest.fixture
def plane(tmp_path: Path) -> Path:
    path = tmp_path / "plane"
    path.mkdir()
    write_result(example_results()[1], path)
    return path


@pytest.mark.parametrize(("ending", "stated"), [("xlsx", ".xlsx"), ("gpkg", ".gpkg"),
                                                ("GEOJSON", ".geojson"), ("tsv", ".tsv")])
@pytest.mark.parametrize("words", [["plan", "nowhere"], ["export", "nowhere", "--to", "points-csv"],
                                   ["project", "nowhere", "--points", "ground.csv"]])
def test_tables_are_not_written_under_names_of_other_kinds(
        words: list[str], ending: str, stated: str, tmp_path: Path) -> None:
    code, _, err = _termsel(*words, "-o", tmp_path / f"next.{ending}")
    assert code == 2
    assert err.startswith(f"Error: {tmp_path / f'next.{ending}'}: this file is written as CSV, not "
                          f"as {stated}. Name it next.csv.")


@pytest.mark.parametrize("name", ["next", "next.CSV", "next.txt", "next.2024"])
def test_names_of_tables_that_say_no_other_kind_are_free(
        name: str, folder: Path, tmp_path: Path) -> None:
    assert _termsel("plan", folder, "-n", 1, "-o", tmp_path / name)[0] == 0
    assert (tmp_path / name).read_text().startswith("# crs:")


def test_export_writes_what_is_asked_for(folder: Path, tmp_path: Path) -> None:
    target = tmp_path / "scene_RPC.TXT"
    code, out, err = _termsel("export", folder, "--to", "rpc-txt", "--output", target)
    assert (code, out) == (0, "")
    assert err.endswith(f"Written: {target}\n")
    assert termsel.read_rpc(target) == read_result(folder).to_rpc()


@pytest.mark.parametrize("to", ["rpc-vrt", "gcp-vrt"])
def test_a_vrt_without_pixels_is_said(of_all_terms: termsel.Result, tmp_path: Path, to: str,
                                      caplog: pytest.LogCaptureFixture) -> None:
    termsel.export(of_all_terms, to, tmp_path / "scene.vrt")
    assert "scene.vrt has no pixels: give the image with image=FILE." in caplog.text
    assert "Source>" not in (tmp_path / "scene.vrt").read_text()


def test_export_in_python(folder: Path, tmp_path: Path) -> None:
    result = termsel.read_result(folder)
    termsel.export(result, "gcp-grid-vrt", tmp_path / "grid.vrt", height=1000.0, across=4)
    assert (tmp_path / "grid.vrt").read_text().count("<GCP ") == 25


def test_export_replaces_nothing_unasked(folder: Path, tmp_path: Path) -> None:
    vendor = tmp_path / "scene.RPB"
    vendor.write_text("what the vendor delivered")
    code, _, err = _termsel("export", folder, "--to", "rpb", "--output", vendor)
    assert code == 2
    assert "scene.RPB: this file already exists. Choose another name, or add --overwrite" in err
    assert vendor.read_text() == "what the vendor delivered"
    assert _termsel("export", folder, "--to", "rpb", "--output", vendor, "--overwrite")[0] == 0
    assert vendor.read_text().startswith("satId")


def test_export_replaces_no_array_next_to_a_vrt_unasked(folder: Path, tmp_path: Path) -> None:
    pytest.importorskip("rasterio")
    array, options = tmp_path / "scene_xy.tif", ("--set", "step=2000", "--set", "height=1100")
    array.write_text("another array")
    export = ("export", folder, "--to", "geolocation-vrt", "-o", tmp_path / "scene.vrt", *options)
    code, _, err = _termsel(*export)
    assert code == 2
    assert "scene_xy.tif: this file already exists" in err
    assert array.read_text() == "another array"
    assert not (tmp_path / "scene.vrt").exists()
    assert _termsel(*export, "--overwrite")[0] == 0


def test_grids_say_what_they_lack(folder: Path, tmp_path: Path,
                                  caplog: pytest.LogCaptureFixture) -> None:
    rasterio = pytest.importorskip("rasterio")
    from affine import Affine

    def dem(west: float) -> Path:
        path = tmp_path / "dem.tif"
        with rasterio.open(path, "w", driver="GTiff", width=20, height=20, count=1,
                           dtype="float32", crs="EPSG:4326",
                           transform=Affine(0.001, 0.0, west, 0.0, -0.001, 36.31)) as raster:
            raster.write(np.full((1, 20, 20), 1100.0, dtype=np.float32))
        return path

    target = tmp_path / "scene.vrt"
    export = ("export", folder, "--to", "geolocation-vrt", "-o", target, "--set", "step=100")
    code, _, err = _termsel(*export, "--dem", dem(10.0))
    assert code == 2
    # Nothing is said of how good a grid is that does not exist.
    assert err.startswith(f"Error: {tmp_path / 'dem.tif'}: fewer than three nodes")
    assert not target.exists()
    assert _termsel(*export, "--dem", dem(59.59))[0] == 0
    assert "nodes of the grid have no ground" in caplog.text
    assert "Warning: GDAL interpolates" not in caplog.text
    assert _termsel("export", folder, "--to", "gcp-grid-vrt", "-o", tmp_path / "g.vrt", "--set",
                    "across=1", "--set", "height=1100")[0] == 0
    assert "Warning: gcp-grid-vrt: at most 8.7 px" in caplog.text


@pytest.mark.filterwarnings("ignore:Dataset has no geotransform")
def test_image_the_points_were_not_measured_in(folder: Path, tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    path = folder / "result.json"
    record = json.loads(path.read_text())
    record["data"]["image_size"] = None
    record["checksums"]["record"] = checksum_of_record(record)
    path.write_text(json.dumps(record))
    image = tmp_path / "small.tif"
    with rasterio.open(image, "w", driver="GTiff", width=20, height=10, count=1,
                       dtype="uint8") as raster:
        raster.write(np.ones((1, 10, 20), dtype=np.uint8))
    code, _, err = _termsel("export", folder, "--to", "gcp-vrt", "-o", tmp_path / "x.vrt",
                            "--image", image)
    assert code == 2
    assert "small.tif: the image has 10 lines and 20 samples, but points extend to line" in err
    assert not (tmp_path / "x.vrt").exists()


@pytest.mark.parametrize(("arguments", "message"), [
    (["--to", "rpb"], "the format rpb cannot hold this result. It needs a model of ground "
                      "coordinates in a CRS"),
    (["--to", "geotiff"], "A rectified image is written by termsel rectify."),
    (["--to", "rbp"], "unknown format to write 'rbp'. Did you mean 'rpb'?"),
    (["--to", "qgis-points", "--set", "dam=x.tif"], "unknown option 'dam'"),
    (["--to", "gcp-grid-vrt", "--set", "across=many"], "option 'across' does not accept 'many'"),
    (["--to", "gcp-vrt", "--image", "none.tif"], "none.tif: this file does not exist"),
    (["--to", "gcp-vrt", "--image", "a", "--set", "image=b"], "image is given twice"),
    (["--to", "gcp-grid-vrt", "--dem", "none.tif"], "only to ground coordinates with a CRS")])
def test_export_refuses(arguments: list[str], message: str, plane: Path, tmp_path: Path) -> None:
    target = tmp_path / "target"
    code, _, err = _termsel("export", plane, *arguments, "--output", target)
    assert code == 2
    assert message in err
    assert "Traceback" not in err
    assert not target.exists()


def test_options_of_other_formats_are_ignored_with_a_note(
        folder: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "termsel")
    target = tmp_path / "scene.points"
    code, _, err = _termsel("export", folder, "--to", "qgis-points", "--image", "none.tif",
                            "--set", "across=5", "-o", target)
    assert code == 0, err
    assert target.exists()
    for key in ("image", "across"):
        assert caplog.text.count(
            f"the format qgis-points has no option {key}, which is ignored") == 1


def test_export_without_a_result(tmp_path: Path) -> None:
    code, _, err = _termsel("export", tmp_path, "--to", "rpb", "--output", tmp_path / "x.RPB")
    assert code == 2
    assert "result.json: there is no result here. Give the folder of a run" in err


def test_run_exports_into_its_folder(tmp_path: Path) -> None:
    run = ("run", "--problem", "rfm-terms", "--dataset", "irs1c-mashad", "--model", "poly3d",
           "--solver", "all-terms", "--export", "rpc-vrt", "--export", "qgis-points")
    code, _, err = _termsel(*run, "--out", tmp_path / "out")
    assert code == 0, err
    assert {"result_rpc.vrt", "result.points"} < {p.name for p in (tmp_path / "out").iterdir()}
    assert "Written" in err
    code, _, err = _termsel(*run)
    assert code == 2
    assert "--export requires --out. Give a folder: --out DIR" in err
    code, _, err = _termsel(*run, "--export", "rcp", "--out", tmp_path / "late")
    assert code == 2
    assert "unknown format to write 'rcp'" in err
    assert not (tmp_path / "late").exists()


def _table(text: str) -> np.ndarray:
    rows = [line.split(",") for line in text.splitlines() if not line.startswith("#")]
    assert rows[0][:6] == ["id", "line", "sample", "x", "y", "z"]
    return np.array([[float(cell or "nan") for cell in row[1:6]] for row in rows[1:]])


def test_project_there_and_back(folder: Path, tmp_path: Path) -> None:
    result = read_result(folder)
    code, out, _ = _termsel("project", folder, "--points", folder / "points.csv")
    assert code == 0
    assert out.startswith("# crs: EPSG:4979\nid,line,sample,x,y,z,")
    there = _table(out)
    assert np.array_equal(there[:, :2], result.project(result.features.points.ground))
    pixels, back = tmp_path / "pixels.csv", tmp_path / "ground.csv"
    pixels.write_text(out)
    code, _, err = _termsel("project", folder, "--points", pixels, "--inverse", "--height", "0",
                            "-o", pixels)
    assert code == 2
    assert "this command reads this file, and would replace it" in err
    assert pixels.read_text() == out
    code, out, err = _termsel("project", folder, "--points", pixels, "--inverse", "--height",
                              "1000", "-o", back)
    assert (code, out) == (0, "")
    assert f"Written: {back}" in err
    ground = _table(back.read_text())[:, 2:]
    assert (ground[:, 2] == 1000.0).all()
    assert np.abs(result.project(ground) - there[:, :2]).max() < 1e-6


def test_project_tells_how_uncertain_each_place_is(folder: Path) -> None:
    result = read_result(folder)
    code, out, _ = _termsel("project", folder, "--points", folder / "points.csv")
    assert code == 0
    header, first = out.splitlines()[1:3]
    assert header.split(",")[6:8] == ["uncertainty_line", "uncertainty_sample"]
    np.testing.assert_allclose([float(cell) for cell in first.split(",")[6:8]],
                               result.sigma(result.features.points.ground)[0])


def test_project_flags_places_outside_the_control(folder: Path, tmp_path: Path) -> None:
    features = read_result(folder).features
    middle = features.points.ground.mean(axis=0)
    span = np.ptp(features.points.ground, axis=0)
    shift = np.array([[0, 0, 0], [0, 0, 3.0], [0.7, 0, 0], [5, 5, 0], [-30, 9, 0]]) * span
    rows = [f"P{i},{x!r},{y!r},{z!r}" for i, (x, y, z) in enumerate((middle + shift).tolist())]
    places = tmp_path / "places.csv"
    places.write_text("id,x,y,z\n" + "\n".join(rows) + "\n")
    code, out, err = _termsel("project", folder, "--points", places, "-o", "-")
    assert code == 0
    assert not (tmp_path / "-").exists()
    assert "far outside the control, and the model is not valid there: P1, P3, P4\n" in err
    table = [line.split(",") for line in out.splitlines()[1:]]
    assert table[0][-1] == "outside"
    apart = [float(row[-1]) for row in table[1:]]
    assert apart[0] == 0
    assert 0 < apart[2] < 0.5 < min(apart[1], apart[3])
    assert apart[3] < apart[4]
    # And the other way, by the ground that is found.
    pixels = tmp_path / "pixels.csv"
    pixels.write_text(out)
    code, out, _ = _termsel("project", folder, "--points", pixels, "--inverse", "--height",
                            middle[2])
    found = [line.split(",")[-1] for line in out.splitlines()[2:]]
    assert float(found[0]) == 0
    assert float(found[2]) > 0
    assert found[4] == ""  # without a place


def test_what_writes_files_does_not_write_to_stdout(folder: Path) -> None:
    for words in (("export", folder, "--to", "rpb"), ("rectify", folder, "scene.tif")):
        code, _, err = _termsel(*words, "-o", "-")
        assert (code, err) == (
            2, "Error: this command cannot write to stdout. Give --output FILE.\n")


def test_project_says_which_rays_meet_no_ground(folder: Path, tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    from affine import Affine

    dem = tmp_path / "dem.tif"
    with rasterio.open(dem, "w", driver="GTiff", width=20, height=20, count=1, dtype="float32",
                       crs="EPSG:4326", nodata=-999, transform=Affine(
                           0.001, 0.0, 59.59, 0.0, -0.001, 36.31)) as raster:
        raster.write(np.full((1, 20, 20), 1100.0, dtype=np.float32))
    (tmp_path / "pixels.csv").write_text("id,line,sample\nmiddle,2000,2000\ncorner,10,10\n")
    code, out, err = _termsel("project", folder, "--points", tmp_path / "pixels.csv", "--inverse",
                              "--dem", dem)
    assert code == 0
    found = _table(out)
    assert found[0, 4] == pytest.approx(1100.0, abs=1e-3)
    assert np.isnan(found[1, 2:]).all()
    assert err == "Warning: no position was found for 1 point: corner\n"
    many = [f"corner{i},{i},10" for i in range(12)]
    (tmp_path / "pixels.csv").write_text("\n".join(["id,line,sample", *many]) + "\n")
    *_, err = _termsel("project", folder, "--points", tmp_path / "pixels.csv", "--inverse",
                       "--dem", dem)
    first = ", ".join(f"corner{i}" for i in range(10))
    assert err == f"Warning: no position was found for 12 points: {first} and 2 more\n"


def test_image_positions_with_heights_are_located_at_these(folder: Path, tmp_path: Path) -> None:
    points = read_result(folder).features.points.ground[::5]
    places, pixels = tmp_path / "places.csv", tmp_path / "pixels.csv"
    places.write_text("\n".join(["id,x,y,z", *(
        f"P{i},{x!r},{y!r},{z!r}" for i, (x, y, z) in enumerate(points.tolist()))]) + "\n")
    _, out, _ = _termsel("project", folder, "--points", places)
    pixels.write_text(out)
    code, out, err = _termsel("project", folder, "--points", pixels, "--inverse")
    assert (code, err) == (0, "")
    np.testing.assert_allclose(_table(out)[:, 2:], points, rtol=0, atol=1e-6)
    code, out, err = _termsel("project", folder, "--points", pixels, "--inverse", "--height", "900")
    assert code == 0
    assert "Note: the heights z of pixels.csv are not used, as --height is given." in err
    assert (_table(out)[:, 4] == 900.0).all()


def test_a_plane_model_locates_without_heights(tmp_path: Path) -> None:
    run = termsel.run("poly-terms", model="poly2d", solver="all-terms", criterion="press",
                      options={"degree": 1, "max_share": 1.0})
    (tmp_path / "pixels.csv").write_text("id,line,sample\na,2000,1000\n")
    text, _ = project_table(run, tmp_path / "pixels.csv", inverse=True)
    row = dict(zip(*(line.split(",") for line in text.splitlines()[-2:]), strict=True))
    assert row["z"] == ""
    place = np.array([[float(row["x"]), float(row["y"]), np.nan]])
    np.testing.assert_allclose(run.project(place), [[2000.0, 1000.0]], atol=1e-3)


def test_places_of_a_gis_are_projected_as_those_of_a_table(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "places.csv").write_text("id,x,y,z\na,59.1,36.2,1100\n")
    feature = {"type": "Feature", "properties": {"name": "a"},
               "geometry": {"type": "Point", "coordinates": [59.1, 36.2]}}
    (tmp_path / "places.geojson").write_text(json.dumps(
        {"type": "FeatureCollection", "features": [feature]}))
    _, of_table, _ = _termsel("project", folder, "--points", tmp_path / "places.csv")
    code, of_gis, _ = _termsel("project", folder, "--points", tmp_path / "places.geojson",
                               "--height", "1100")
    assert (code, of_gis) == (0, of_table)
    code, _, err = _termsel("project", folder, "--points", tmp_path / "places.geojson")
    assert (code, "Give heights by --dem FILE or --height H" in err) == (2, True)
    (tmp_path / "places.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [
        {**feature, "properties": {"name": "a", "z": 1100}}]}))
    assert _termsel("project", folder, "--points", tmp_path / "places.geojson")[1] == of_table
    (tmp_path / "places.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [
        {**feature, "geometry": {"type": "LineString", "coordinates": [[59, 36], [59.1, 36]]}}]}))
    _, _, err = _termsel("project", folder, "--points", tmp_path / "places.geojson")
    assert "its geometry is LineString, expected Point or MultiPoint" in err
    (tmp_path / "places.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [
        {**feature, "geometry": {"type": "MultiPoint", "coordinates": [[59, 36], [59.1, 36]]}}]}))
    code, out, err = _termsel("project", folder, "--points", tmp_path / "places.geojson")
    assert (code, out) == (2, "")
    assert "feature 1: it has several vertices, expected one point" in " ".join(err.split())


def test_heights_of_places_are_of_no_account_to_a_plane_model(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    places = np.array([[59.1, 36.2], [59.2, 36.4], [59.3, 36.1], [59.2, 36.2]])
    ground = np.column_stack([places, np.full(4, np.nan)])
    points = termsel.Points(tuple("abcd"), places * 1000.0, ground)
    result = termsel.run(features=termsel.FeatureSet(points, crs="EPSG:4326"), method="affine")
    # As a GIS saves places with heights.
    (tmp_path / "places.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [
        {"type": "Feature", "properties": {"name": "a"},
         "geometry": {"type": "Point", "coordinates": [59.1, 36.2, 1100.0]}}]}))
    text, _ = project_table(result, tmp_path / "places.geojson")
    row = dict(zip(*(line.split(",") for line in text.splitlines()[-2:]), strict=True))
    assert float(row["line"]) == pytest.approx(59_100.0, abs=1e-3)
    (tmp_path / "places.csv").write_text("id,x,y\na,59.1,36.2\n")
    without_heights, _ = project_table(result, tmp_path / "places.csv")
    (tmp_path / "candidates.csv").write_text("id,x,y\nnew,59.15,36.25\nold,59.1,36.2\n")
    caplog.set_level("WARNING")
    assert project_table(result, tmp_path / "places.csv", height=5.0)[0] == without_heights
    assert "does not use heights, so --height is not used" in caplog.text
    plan(result, 2, tmp_path / "candidates.csv")
    assert "the same place measured again: old." in caplog.text


def test_a_table_for_control_in_gons_is_said_to_be_read_as_degrees(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    pytest.importorskip("pyproj")
    rows = [f"{i},{100 * x},{100 * y},{2.5 + x / 100},{54 + y / 100}"
            for i, (x, y) in enumerate([(1, 1), (3, 1), (2, 4), (5, 3)])]
    (tmp_path / "control.csv").write_text("\n".join(["id,line,sample,x,y", *rows]) + "\n")
    result = termsel.run(features=termsel.read(tmp_path / "control.csv", crs="EPSG:4807"),
                         method="affine")
    lines = []
    for names, said in [("x,y", True), ("x_gon,y_gon", False)]:
        (tmp_path / "places.csv").write_text(f"id,{names}\na,2.52,54.02\n")
        caplog.clear()
        text, _ = project_table(result, tmp_path / "places.csv")
        lines.append(float(text.splitlines()[-1].split(",")[1]))
        assert ("the control was not in degrees" in caplog.text) == said
    assert lines[1] == pytest.approx(200.0, abs=1e-3)
    assert lines[0] != pytest.approx(200.0, abs=1.0)


def test_places_in_one_of_several_layers(folder: Path, tmp_path: Path) -> None:
    geopandas = pytest.importorskip("geopandas")
    control = read_result(folder).fit.control
    for name, rows in (("towns", slice(0, 1)), ("peaks", slice(1, 3))):
        ground = control.points.ground[rows]
        geopandas.GeoDataFrame({"name": control.points.ids[rows]}, crs=control.crs, geometry=(
            geopandas.points_from_xy(*ground.T))).to_file(tmp_path / "places.gpkg", layer=name)
    _, first, said = _termsel("project", folder, "--points", tmp_path / "places.gpkg")
    _, peaks, _ = _termsel("project", folder, "--points", tmp_path / "places.gpkg", "--layer",
                           "peaks")
    assert (len(first.splitlines()), len(peaks.splitlines())) == (3, 4)
    assert "layers towns, peaks; towns is read, and --layer NAME" in said


@pytest.mark.parametrize(("text", "arguments", "message"), [
    ("id,line,sample\na,1,2\n", [], "add --inverse"),
    ("id,x,y,z\na,59,36,\n", [], "line 2, column 'z': the height is blank"),
    ("id,x,y,z\na,59,36,\n", ["--dem", "d.tif"], "d.tif: this file does not exist"),
    ("id,x,y,z\na,59,36,1\n", ["--dem", "d.tif"], "d.tif: this file does not exist"),
    ("id,x,y,z\na,59,36,\n", ["--height", "-9999"], "-9999 is no height"),
    ("id,line,sample\na,1,2\n", ["--inverse"], "Give --dem FILE or --height H, or a column z."),
    ("id,line,sample,z\na,1,2,\n", ["--inverse"], "Give --dem FILE or --height H, or a column z."),
    ("id,line,sample,z\na,1,2,3\nb,1,2,\n", ["--inverse"], "line 3, column 'z': the height is "),
    ("# crs: EPSG:32640\nid,line,sample,z\na,1,2,3\n", ["--inverse"], "the CRS EPSG:32640"),
    ("id,line,sample,z_ft\na,1,2,3\n", ["--inverse"], "table.csv: z is in feet by the"),
    ("id,line,sample\na,1,2\n", ["--inverse", "--height", "nan"], "cannot be nan"),
    ("id,line,sample\na,1,2\n", ["--inverse", "--height", "1", "--dem", "d.tif"], "exclude"),
    ("id,line,sample\na,1,2\n", ["--inverse", "--dem", "no.tif"],
     "no.tif: this file does not exist"),
    ("# crs: EPSG:32640\nid,x,y,z\na,1,2,3\n", [], "declares the CRS EPSG:32640"),
    ("# crs: EPSG:32640\nid,mapX,mapY\na,270000,3854000\n", [],
     "but the control is in EPSG:4979; and there is no column for z, and the model requires "
     "heights. Transform the points to the CRS of the control: gdaltransform -s_srs EPSG:32640 "
     "-t_srs EPSG:4979 takes and prints lines of x y z, without a header. "
     "Give heights by --dem FILE or --height H"),
    ("id,lo,la\na,59,36\n", [], "there are no columns for x and y. The columns here are: id, lo, "
     "la. Accepted names: x, lon, longitude, easting; y, lat, latitude, northing, and others. Add "
     "them, or name what holds them: --columns x=NAME,y=NAME. Without z: --dem FILE or "
     "--height H."),
    ("id,lo,la\na,59,36\n", ["--columns", "x=lo,y=la"],
     "column 'z': there is no column for z, and the model requires heights. Give heights by --dem"),
    ("id,down,across\na,59,36\n", ["--inverse", "--height", "1"],
     "Add them, or name what holds them: --columns line=NAME,sample=NAME."),
    ("id,x,y,z\na,270000,3854000,3\n", [], "table.csv, column 'x': 'a' with x = 270000"),
    ('{"type": "Feature", "geometry": {"type": "Point", "coordinates": [59, 36]}}', [],
     "this is not a GeoJSON FeatureCollection"),
    ("id,x,y,z\na,1,x,3\n", [], "line 2, column 'y': 'x' is not a number"),
    ("", [], "the file has no table")])
def test_project_refuses(text: str, arguments: list[str], message: str, folder: Path,
                         tmp_path: Path) -> None:
    table = tmp_path / "table.csv"
    table.write_text(text)
    code, out, err = _termsel("project", folder, "--points", table, *arguments)
    assert (code, out) == (2, "")
    assert message in err


def test_places_of_one_id_are_not_said_to_be_of_another_crs(folder: Path, tmp_path: Path) -> None:
    table = tmp_path / "table.csv"
    table.write_text("id,x,y,z\na,59,36,1\na,59,36.1,1\n")
    code, _, err = _termsel("project", folder, "--points", table)
    assert (code, "used 2 times" in err, "CRS" in err) == (2, True, False)


@pytest.mark.parametrize(("place", "message"), [
    ("270000,3854000", "cannot be longitude and latitude in"),
    ("20,36", "the image shows none of the positions")])
def test_plan_takes_no_candidates_of_another_crs_or_place(place: str, message: str, folder: Path,
                                                          tmp_path: Path) -> None:
    table = tmp_path / "candidates.csv"
    table.write_text(f"id,x,y,z\na,{place},1100\n")
    code, out, err = _termsel("plan", folder, "--candidates", table)
    assert (code, out) == (2, "")
    assert message in err


@pytest.mark.parametrize(("table", "message"), [
    ("nr,rechts,hoch,hoehe\n1,59,36,1100\n", "Rename the columns in the file: id,x,y,z."),
    ("name,lat,lon\n1,36,59\n", "Give heights in the file, in a column named z."),
    ("id,x1,y1,z1,x2,y2,z2\n1,59,36,5,59.1,36,5\n",
     "These are lines, and points are needed: a table id,x,y,z."),
    ("id,line,sample\n1,5,7\n", "termsel project --inverse computes them.")])
def test_plan_names_no_option_that_it_lacks(table: str, message: str, folder: Path,
                                            tmp_path: Path) -> None:
    path = tmp_path / "candidates.csv"
    path.write_text(table)
    code, out, err = _termsel("plan", folder, "--candidates", path)
    assert (code, out) == (2, "")
    assert message in err
    assert "--columns" not in err


@pytest.mark.slow
def test_text_formats_need_no_packages_for_rasters(folder: Path, tmp_path: Path) -> None:
    """RPC text, .points and CSV are written without the extra `gis`; others name it."""
    code = (
        "import json, sys\n"
        "for name in ('rasterio', 'pyproj', 'pyogrio', 'shapely'): sys.modules[name] = None\n"
        "from click.testing import CliRunner\n"
        "from termsel.cli.main import cli\n"
        "runs = [CliRunner().invoke(cli, c) for c in json.loads(sys.argv[1])]\n"
        "print(json.dumps([(done.exit_code, done.stderr) for done in runs]))\n")
    written = ("rpb", "rpc-txt", "rpc-vrt", "qgis-points", "orthority-geojson", "gcp-vrt",
               "points-csv", "gcp-grid-vrt")
    commands = [("export", folder, "--to", to, "-o", tmp_path / f"x-{to}") for to in written]
    commands += [
        ("export", folder, "--to", "residuals-gpkg", "-o", tmp_path / "r.gpkg"),
        ("export", folder, "--to", "geolocation-vrt", "-o", tmp_path / "g.vrt"),
        ("rectify", folder, "scene.tif", "--height", 1, "-o", tmp_path / "m.tif")]
    texts = json.dumps([[str(argument) for argument in command] for command in commands])
    done = subprocess.run([sys.executable, "-c", code, texts], capture_output=True, text=True,
                          check=True)
    found = json.loads(done.stdout)
    assert [code for code, _ in found] == [0] * len(written) + [2] * 3, found
    assert "not by GDAL, as rasterio is not installed" in found[0][1]
    for _, err in found[len(written):]:
        assert 'pip install "termsel[gis]"' in err


def test_an_rpc_next_to_its_image_is_exported_again(folder: Path, tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    image = tmp_path / "scene.tif"
    with rasterio.open(image, "w", driver="GTiff", width=4000, height=4000, count=1, dtype="uint8",
                       sparse_ok=True):
        pass
    export = ("export", folder, "--to", "rpb", "-o", tmp_path / "scene.RPB", "--image", image)
    code, _, err = _termsel(*export)
    assert code == 0, err
    code, _, err = _termsel(*export)
    assert code == 2
    assert "this file already exists" in err
    code, _, err = _termsel(*export, "--overwrite")
    assert code == 0, err
    code, _, err = _termsel("export", folder, "--to", "rpb", "-o", image, "--image", image,
                            "--overwrite")
    assert code == 2
    assert "this command reads this file" in err
