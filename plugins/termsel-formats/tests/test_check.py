"""What programs take from a file: known transformations, put into files here."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path
from shlex import split
from typing import Any

import numpy as np
import pytest
from click.testing import Result

pytest.importorskip("termsel_formats", reason="termsel-formats is not installed: "
                    "pip install -e plugins/termsel-formats")

import termsel
from termsel import FeatureSet, Points, TermselError, write_result
from termsel.testing import Check, checks, invoke
from termsel_formats import compare_programs
from termsel_formats.check.command import _warn_of_deviation
from termsel_formats.check.comparison import Apart, Deviation

rasterio = pytest.importorskip("rasterio")
pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

SIZE = (400, 500)
WITH_GDAL = shutil.which("gdaltransform") is not None
WITH_QGIS = WITH_GDAL and shutil.which("qgis_process") is not None


@pytest.mark.slow_cases("modest_import")
@pytest.mark.parametrize("check", checks("termsel-formats"), ids=lambda check: check.name)
def test_conforms(check: Check) -> None:
    check.run()


@pytest.fixture(scope="module")
def result() -> termsel.Result:
    """Return an image that is affine: 2 m a pixel, turned by 30 degrees."""
    rng = np.random.default_rng(2)
    image = rng.uniform(0, 1, (40, 2)) * SIZE
    turn = 2.0 * np.array([[np.sin(0.5), np.cos(0.5)], [-np.cos(0.5), np.sin(0.5)]])
    ground = np.column_stack([image @ turn + [500000.0, 5000000.0], np.full(40, np.nan)])
    points = Points(tuple(f"P{i}" for i in range(40)), image, ground, None,
                    ("control", "check") * 20)
    return termsel.run("poly-terms", features=FeatureSet(points, crs="EPSG:32631",
                                                         image_size=SIZE),
                       model="poly2d", solver="all-terms", options={"degree": 1})


def raster(path: Path, transform: object = None, gcps: object = (), crs: str = "EPSG:32631",
           size: tuple[int, int] = SIZE) -> Path:
    given = {"gcps": gcps, "crs": crs} if gcps else \
        {"transform": transform, "crs": crs} if transform else {}
    with rasterio.open(path, "w", driver="GTiff", height=size[0], width=size[1], count=1,
                       dtype="uint8", **given):
        pass
    return path


def exact(result: termsel.Result, moved: float = 0.0) -> Any:
    """Return the geotransform of the model, moved to the east."""
    from affine import Affine

    corner, right, down = result.locate([[-0.5, -0.5], [-0.5, 0.5], [0.5, -0.5]], 0.0)[:, :2]
    return Affine(right[0] - corner[0], down[0] - corner[0], corner[0] + moved,
                  right[1] - corner[1], down[1] - corner[1], corner[1])


@pytest.mark.slow
@pytest.mark.parametrize("moved", [0.0, 20.0])
def test_an_affine_transformation_is_as_far_off_as_it_was_moved(
        result: termsel.Result, tmp_path: Path, moved: float) -> None:
    found, answers = compare_programs(raster(tmp_path / "a.tif", exact(result, moved)), result)
    asked = [one for one in found if one.by_default and one.over_image is not None]
    assert asked[0].program.startswith("rasterio")
    assert len(asked) >= 1 + WITH_GDAL
    for one in asked:
        assert one.over_image is not None
        assert one.at_points is not None
        assert one.transformation in ("affine transformation", "origin and spacing")
        for apart in (one.over_image, one.at_points):
            assert apart.metres == pytest.approx(moved, abs=1e-4)
            assert apart.largest == pytest.approx(moved / 2, abs=1e-4)
            assert apart.rms <= apart.largest + 1e-9
            assert apart.lacking == 0
    assert not answers.failed


def test_a_geotransform_hides_gcps_from_nobody(result: termsel.Result, tmp_path: Path) -> None:
    from rasterio.control import GroundControlPoint

    image = np.array([[0.0, 0.0], [0.0, 499.0], [399.0, 0.0], [399.0, 499.0], [200.0, 250.0]])
    ground = result.locate(image, 0.0)
    gcps = [GroundControlPoint(row=line + 0.5, col=sample + 0.5, x=x, y=y, z=0.0)
            for (line, sample), (x, y) in zip(image, ground[:, :2], strict=True)]
    found, _ = compare_programs(raster(tmp_path / "g.tif", gcps=gcps), result)
    for one in found:
        if one.over_image is not None and "spline" not in one.transformation:
            assert one.over_image.largest < 0.01, one


@pytest.mark.slow
def test_a_raster_without_place_has_no_transformation(result: termsel.Result, tmp_path: Path,
                                                      ) -> None:
    found, _ = compare_programs(raster(tmp_path / "plain.tif"), result)
    assert all(one.over_image is None for one in found)
    assert found[0].transformation == "none: no georeferencing"
    (tmp_path / "r").mkdir()
    write_result(result, tmp_path / "r")
    said = invoke("check", tmp_path / "plain.tif", "--result", tmp_path / "r").output
    assert said.count("Warning") == 1
    assert "is georeferenced for none of these programs" in said
    export = said.partition("written by: termsel ")[2].splitlines()[0]
    assert invoke(*split(export)).exit_code == 0


@pytest.mark.slow
@pytest.mark.skipif(not WITH_QGIS, reason="qgis_process is not installed")
@pytest.mark.parametrize("held", [None, b"<PAMDataset><Metadata/></PAMDataset>"])
def test_a_check_writes_nothing_next_to_the_raster(held: bytes | None, tmp_path: Path) -> None:
    path, sidecar = tmp_path / "plain.tif", tmp_path / "plain.tif.aux.xml"
    with rasterio.open(path, "w", driver="GTiff", height=40, width=50, count=1,
                       dtype="uint8") as file:
        file.write(np.arange(2000, dtype="uint8").reshape(1, 40, 50))
    if held is not None:
        sidecar.write_bytes(held)
    found, _ = compare_programs(path, None)
    assert any(one.program.startswith("QGIS") for one in found)
    assert (sidecar.read_bytes() if sidecar.exists() else None) == held


@pytest.mark.slow
@pytest.mark.parametrize("beside", [True, False])
def test_a_world_file_is_read_with_or_without_its_image(result: termsel.Result, tmp_path: Path,
                                                        beside: bool) -> None:
    t = exact(result)
    x, y = t.c + (t.a + t.b) / 2, t.f + (t.d + t.e) / 2
    world = tmp_path / "scene.tfw"
    world.write_text("".join(f"{value!r}\n" for value in (
        t.a, t.d, t.b, t.e, x, y)))
    if beside:
        raster(tmp_path / "scene.tif")
    before = sorted(tmp_path.iterdir())
    found, _ = compare_programs(world, result)
    assert found[0].over_image is not None
    assert found[0].over_image.largest < 1e-4
    assert found[0].crs == ""
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.slow
def test_an_rpc_is_told_apart_from_one_at_the_height_0(tmp_path: Path) -> None:
    scene = termsel.simulate_scene("ikonos-hamedan", n_lines=0)
    own = termsel.run("rfm-terms", features=scene, solver="all-terms", options={"order": 2})
    termsel.export(own, "rpc-txt", tmp_path / "scene_RPC.TXT")
    found, _ = compare_programs(tmp_path / "scene_RPC.TXT", own)
    by_name = {one.transformation.partition(" (")[0]: one for one in found}
    flat = by_name["RPC at the height 0"].over_image
    assert flat is not None
    assert flat.largest > 50.0
    if WITH_GDAL:
        high = by_name["RPC at the heights of the ground"].over_image
        assert high is not None
        assert high.largest < 0.2  # GDAL ends its own iteration at 0.1 px
    if WITH_QGIS:  # From 3.14 on QGIS takes the height offset of the RPC, as GDAL does not.
        name, middle = next((one.transformation, one.over_image) for one in found
                            if one.program.startswith("QGIS"))
        assert name.startswith("RPC at its height offset, ")
        assert middle is not None
        assert middle.largest < flat.largest / 2


def call(*words: object) -> Result:
    return invoke(*words)


@pytest.mark.skipif(not WITH_GDAL, reason="requires gdaltransform")
def test_gcps_hide_an_rpc_that_gdal_takes_by_its_option(example_files: Path,
                                                        tmp_path: Path) -> None:
    points = termsel.simulate_scene("spot-isfahan").points
    gcps = [rasterio.control.GroundControlPoint(line, sample, *ground) for (line, sample), ground
            in zip(points.image.tolist(), points.ground.tolist(), strict=True)]
    path = raster(tmp_path / "both.tif", gcps=gcps[:8], crs="EPSG:4326", size=(6000, 6000))
    rpc = termsel.read_rpc(example_files / "vendor.RPB")
    termsel.write_rpc(rpc, tmp_path / "both.RPB")
    taken = {row.program: row.transformation for row in compare_programs(path)[0]}
    [by_default] = [program for program in taken if program.startswith("GDAL")]
    assert "GCPs" in taken[by_default]
    assert taken["  with -rpc"] == "RPC at the height 0"


@pytest.mark.slow
def test_the_command_warns_and_prints_json(result: termsel.Result, tmp_path: Path) -> None:
    (tmp_path / "r").mkdir()
    write_result(result, tmp_path / "r")
    path = raster(tmp_path / "a.tif", exact(result, 2000.0))
    done = call("check", path, "--result", tmp_path / "r")
    assert done.exit_code == 0, done.output
    assert "is up to 1,000 px (2" in done.output.replace("\n", " ")
    said = json.loads(call("check", path, "--result", tmp_path / "r", "--json").output)
    assert said["programs"][0]["over_image"]["metres"] == pytest.approx(2000.0, abs=1e-3)
    alone = call("check", path)
    assert "affine transformation" in alone.output
    assert "Give --result DIR" in alone.output


def test_the_note_counts_places_of_points_and_of_the_image(
        capsys: pytest.CaptureFixture[str]) -> None:
    """Those that a program has no ground position for, whichever distance is the larger one."""
    near = Apart(0.1, 0.2, None, 1.0, 2.0, 3)
    far = Apart(0.3, 0.4, None, 1.0, 2.0, 4)
    for at_points, over_image, lacking in ((near, far, 7), (far, near, 7), (None, near, 3)):
        _warn_of_deviation(Deviation("GDAL", "affine", "", True, at_points, over_image))
        assert f"GDAL has no place for {lacking} of the places" in capsys.readouterr().out


@pytest.mark.parametrize(("name", "said"), [
    ("none.tif", "there is no such file"), ("lost.tfw", "an image such as lost.tif, which is not"),
    ("text.tif", ""), ("", "this is a folder, expected a file")])
def test_what_cannot_be_checked(name: str, said: str, tmp_path: Path) -> None:
    if name not in ("none.tif", ""):
        (tmp_path / name).write_text("no raster")
    done = call("check", tmp_path / name)
    assert done.exit_code == 2, done.output
    assert said in done.output.replace("\n", " ")
    assert "Traceback" not in done.output


@pytest.mark.slow
def test_another_image_is_refused(result: termsel.Result, tmp_path: Path) -> None:
    other = raster(tmp_path / "map.tif", exact(result), size=(410, 500))
    with pytest.raises(TermselError, match="410 lines and 500 samples, and the image of the"):
        compare_programs(other, result)


def test_a_map_that_was_made_is_no_image_to_compare(result: termsel.Result,
                                                    tmp_path: Path) -> None:
    without_size = result.with_(features=replace(result.features, image_size=None))
    image = raster(tmp_path / "image.tif")
    termsel.rectify(without_size, image, tmp_path / "map.tif")
    with pytest.raises(TermselError, match="a map that termsel made"):
        compare_programs(tmp_path / "map.tif", without_size)
    assert not compare_programs(image, without_size)[0][0].transformation.startswith("affine")


def test_a_world_file_that_lacks_a_number_is_named(tmp_path: Path) -> None:
    (tmp_path / "scene.tif").touch()
    world = tmp_path / "scene.tfw"
    world.write_text("10\n0\n0\n-10\n500000\n")
    with pytest.raises(TermselError, match="6 numbers, a line each, and this one has 5"):
        compare_programs(world)


@pytest.mark.skipif(os.name == "nt", reason="programs of the shell")
def test_otb_that_answers_without_a_position_has_no_rpc(
        result: termsel.Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    programs = tmp_path / "programs"
    programs.mkdir()
    for name, said in (("otbcli_ReadImageInfo", "originx: 0.5\noriginy: 0.5\nspacingx: 1\n"
                                                "spacingy: 1"),
                       ("otbcli_ConvertSensorToGeoPoint", "nothing: known")):
        program = programs / name
        program.write_text(f"#!/bin/sh\necho '{said}'\n")
        program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{programs}{os.pathsep}{os.environ['PATH']}")
    found, answers = compare_programs(raster(tmp_path / "scene.tif", exact(result)), result)
    (of_otb,) = (one for one in found if one.program == "OTB")
    assert of_otb.transformation == "not reported by its applications"
    assert not answers.failed


def test_a_file_without_a_crs_is_said_to_have_none(result: termsel.Result, tmp_path: Path) -> None:
    """Its coordinates are compared as those of the result, and no program would do so."""
    folder = tmp_path / "result"
    folder.mkdir()
    write_result(result, folder)
    placed = exact(result)
    for crs, is_said in (("EPSG:32631", False), ("", True)):
        file = raster(tmp_path / f"placed{crs[5:]}.tif", placed, crs=crs)
        said = invoke("check", file, "--result", folder).output
        assert ("states no CRS" in said) is is_said
        assert ("ones of EPSG:32631" in said) is is_said


@pytest.mark.parametrize(("moved", "is_said"), [((0.5, 0.5), True), ((-0.5, 0.5), True),
                                                ((0.0, 0.0), False), ((0.3, 0.3), False)])
def test_half_a_pixel_is_told_as_such(result: termsel.Result, tmp_path: Path,
                                      moved: tuple[float, float], is_said: bool) -> None:
    folder = tmp_path / "result"
    folder.mkdir()
    write_result(result, folder)
    placed = exact(result) * exact(result).translation(*moved)
    said = invoke("check", raster(tmp_path / "moved.tif", placed), "--result", folder).output
    assert ("is half a pixel in line and in sample off" in said) is is_said
