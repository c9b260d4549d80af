"""Heights from a raster: where they come from, and what is refused."""

from __future__ import annotations

import json
import logging
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import termsel
from termsel.core.errors import TermselError
from termsel.data.features import FeatureSet, FloatArray, Lines, Points
from termsel.formats import heights as module
from termsel.formats.heights import open_dem, say_difference, surface_of, with_heights
from termsel.formats.readers.csv_tables import write_lines_csv, write_points_csv
from termsel.simulate import simulate_scene

rasterio = pytest.importorskip("rasterio")
pytest.importorskip("pyproj")
from rasterio.transform import Affine, from_origin  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")
EAST, NORTH, STEP = 500000.0, 5000400.0, 10.0
NODATA = -9999.0


def dem(path: Path, values: FloatArray, crs: Any = "EPSG:32631", transform: Affine | None = None,
        **changed: Any) -> Path:
    """Write heights as a raster whose first corner is EAST, NORTH."""
    with rasterio.open(path, "w", driver="GTiff", width=values.shape[1], height=values.shape[0],
                       count=1, dtype="float32", crs=crs, nodata=NODATA,
                       transform=transform or from_origin(EAST, NORTH, STEP, STEP)) as raster:
        raster.write(values.astype(np.float32), 1)
        for name, value in changed.items():
            setattr(raster, name, value)
    return path


def plane(x: FloatArray, y: FloatArray) -> FloatArray:
    return 0.25 * (x - EAST) - 0.5 * (y - NORTH) + 100


def planar(rows: int, columns: int) -> FloatArray:
    """Return a plane at the centres of pixels."""
    row, column = np.mgrid[:rows, :columns] + 0.5
    return plane(EAST + STEP * column, NORTH - STEP * row)


def points(xy: Any, z: Any = np.nan, crs: str = "EPSG:32631") -> FeatureSet:
    xy = np.asarray(xy, dtype=float)
    ground = np.column_stack([xy, np.broadcast_to(z, len(xy))])
    return FeatureSet(Points(tuple(f"p{i}" for i in range(len(xy))), xy, ground), crs=crs)


@pytest.mark.parametrize("tile", [1024, 4])
def test_bilinear_heights_of_a_plane_are_exact(tmp_path: Path, tile: int,
                                               monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_TILE", tile)
    path = dem(tmp_path / "dem.tif", planar(30, 20))
    rng = np.random.default_rng(2)
    xy = np.column_stack([rng.uniform(EAST + 5, EAST + 195, 500),
                          rng.uniform(NORTH - 295, NORTH - 5, 500)])
    found = with_heights(points(xy), path)
    np.testing.assert_allclose(found.points.ground[:, 2], plane(*xy.T), atol=1e-3)


def test_heights_at_the_edge_and_beyond(tmp_path: Path) -> None:
    values = planar(30, 20)
    with open_dem(dem(tmp_path / "dem.tif", values), "EPSG:32631") as surface:
        x = EAST + np.array([0.0, 2, 200, 200.1, -0.1, 100])
        y = NORTH - np.array([0.0, 2, 300, 150, 150, 300.1])
        found = surface(np.column_stack([x, y]))
    np.testing.assert_allclose(found[:3], [values[0, 0], values[0, 0], values[-1, -1]], rtol=1e-6)
    assert np.isnan(found[3:]).all()


def test_the_same_as_gdal_warps(tmp_path: Path) -> None:
    """In another CRS, where GDAL's own bilinear resampling gives the same heights."""
    from rasterio.warp import Resampling, reproject

    rng = np.random.default_rng(4)
    values = 300 + 100 * rng.random((40, 40))
    path = dem(tmp_path / "dem.tif", values)
    target = from_origin(3.0012, 45.1569, 5e-5, 5e-5)
    warped = np.full((30, 40), np.nan, dtype=np.float64)
    reproject(values.astype(np.float64), warped, src_crs="EPSG:32631", dst_crs="EPSG:4326",
              src_transform=from_origin(EAST, NORTH, STEP, STEP), dst_transform=target,
              resampling=Resampling.bilinear, dst_nodata=np.nan, tolerance=0,
              warp_mem_limit=0)
    row, column = np.nonzero(np.isfinite(warped))
    assert len(row) > 500
    lonlat = np.column_stack([target.c + target.a * (column + 0.5),
                              target.f + target.e * (row + 0.5)])
    with open_dem(path, "EPSG:4326") as surface:
        found = surface(lonlat)
    # Of heights that differ by 100 m from pixel to pixel.
    np.testing.assert_allclose(found, warped[row, column], atol=0.01)


def test_known_heights_stay(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = dem(tmp_path / "dem.tif", planar(30, 20))
    features = points([[EAST + 50, NORTH - 50], [EAST + 60, NORTH - 70]], [7.0, np.nan])
    lines = Lines(("l",), [[[1, 2], [3, 4]]],
                  [[[EAST + 15, NORTH - 15, np.nan], [EAST + 95, NORTH - 15, 3]]])
    with caplog.at_level(logging.INFO, "termsel"):
        found = with_heights(features.with_(lines=lines), path)
    np.testing.assert_allclose(found.points.ground[:, 2], [7, 150], rtol=1e-6)
    np.testing.assert_allclose(found.lines.ground[0, :, 2], [111.25, 3], rtol=1e-6)
    assert found.heights == ("2 of 4 heights from dem.tif, bilinear; vertical datum: "
                             "not declared by the raster")
    assert found.heights in caplog.text


def test_a_dem_of_another_place_is_said_with_the_zone(tmp_path: Path,
                                                     caplog: pytest.LogCaptureFixture) -> None:
    path = dem(tmp_path / "dem.tif", planar(30, 20))
    xy = [[EAST + 50, NORTH - 50], [EAST + 60, NORTH - 70]]
    with_heights(points(xy, 7.0, "EPSG:32632"), path)
    assert "dem.tif covers none of the points, which are around 45.2 N, 9.0 E" in caplog.text
    meets = ("The raster is around 45.2 N, 3.0 E. In EPSG:32631 the points would be on it: is "
             "EPSG:32632 right?")
    assert meets in caplog.text
    with pytest.raises(TermselError, match="all points are outside") as caught:
        with_heights(points(xy, crs="EPSG:32632"), path)
    assert meets in str(caught.value)
    caplog.clear()
    with_heights(points([[EAST - 9e4, NORTH]], 7.0), path)
    assert "3.0 E: is it of another place?" in caplog.text


def test_scale_and_offset_are_applied(tmp_path: Path) -> None:
    path = dem(tmp_path / "dem.tif", planar(30, 20), scales=(0.5,), offsets=(10.0,))
    found = with_heights(points([[EAST + 50, NORTH - 50]]), path)
    np.testing.assert_allclose(found.points.ground[0, 2], 10 + 0.5 * 137.5)


def test_points_without_a_height_are_all_named(tmp_path: Path) -> None:
    values = planar(30, 20)
    values[10, 10] = NODATA
    path = dem(tmp_path / "dem.tif", values)
    hole = [EAST + 105, NORTH - 105]
    xy = [[EAST + 50, NORTH - 50], hole, [EAST - 1, NORTH - 1],
          [hole[0] + 9.9, hole[1]], [hole[0] + 10, hole[1]]]
    with pytest.raises(TermselError) as caught:
        with_heights(points(xy), path)
    assert caught.value.ids == ("p1", "p2", "p3")
    assert "3 of 5 points are outside the raster or in areas without data: p1, p2, p3." \
        in str(caught.value)
    assert str(path) in str(caught.value)
    assert "The raster covers x 500000 to 500200, y 5000100 to 5000400" in str(caught.value)
    assert "or leave them out: --off p1,...." in str(caught.value)


def test_a_small_raster_in_degrees_says_where_points_beside_it_are(tmp_path: Path) -> None:
    path = dem(tmp_path / "dem.tif", planar(20, 20), "EPSG:4326",
               from_origin(14.2, 47.2, 0.0001, 0.0001))
    beside = points([[14.2011, 47.1989], [14.20215, 47.1989]], crs="EPSG:4326")
    with pytest.raises(TermselError) as caught:
        with_heights(beside, path)
    assert "covers x 14.2 to 14.202, y 47.198 to 47.2; these are at x 14.20215, y 47.1989." \
        in str(caught.value)


@pytest.mark.parametrize("asked", [{}, {"off": "p9"}, {"role": "p9=off"}])
def test_a_point_outside_the_raster_is_left_out_as_the_message_says(
        asked: dict[str, str], tmp_path: Path) -> None:
    path = dem(tmp_path / "dem.tif", planar(30, 20))
    table = tmp_path / "points.csv"
    rows = [f"p{i},{10 * i},{7 * i},{EAST + 20 * i},{NORTH - 25 * i},"
            f"{'off' if not asked and i == 9 else ''}" for i in range(1, 10)]
    rows[-1] = rows[-1].replace(f"{EAST + 180}", f"{EAST + 900}")
    table.write_text("\n".join(["id,line,sample,x,y,role", *rows]), encoding="utf-8")
    if asked:
        with pytest.raises(TermselError, match="leave them out: off='p9'"):
            termsel.read(table, crs="EPSG:32631", dem=path)
    read = termsel.read(table, crs="EPSG:32631", dem=path, **asked)
    assert read.heights.startswith("8 of 9 heights from dem.tif")
    assert np.flatnonzero(np.isnan(read.points.ground[:, 2])).tolist() == [8]


@pytest.mark.parametrize(("raster", "ground", "datum"), [
    ("EPSG:32631", "EPSG:4979", "not declared by the raster"),
    ("EPSG:32631+3855", "EPSG:32631+3855", "EGM2008 height"),
    ("EPSG:4979", "EPSG:4979", "ellipsoidal (WGS 84)"),
    ("EPSG:4979", "EPSG:4326", "ellipsoidal (WGS 84)")])
def test_vertical_datum_is_stated(tmp_path: Path, raster: str, ground: str, datum: str) -> None:
    degrees = raster == "EPSG:4979"
    path = dem(tmp_path / "dem.tif", planar(30, 20), raster,
               from_origin(2.9, 45.2, 0.01, 0.01) if degrees else None)
    with open_dem(path, ground) as surface:
        assert surface.datum == datum


def test_datums_that_differ_are_refused(tmp_path: Path) -> None:
    path = dem(tmp_path / "dem.tif", planar(30, 20), "EPSG:32631+3855")
    with pytest.raises(TermselError, match=r"are EGM2008 height, those of the ground coordinates "
                                           r"are ellipsoidal \(WGS 84\)"), \
            open_dem(path, "EPSG:4979"):
        pass


def test_rasters_that_are_no_dem(tmp_path: Path) -> None:
    good = dem(tmp_path / "dem.tif", planar(5, 5))
    no_crs = dem(tmp_path / "nocrs.tif", planar(5, 5), None)
    fathoms = dem(tmp_path / "fathoms.tif", planar(5, 5), units=("fathom",))
    broken = tmp_path / "broken.tif"
    broken.write_bytes(good.read_bytes()[:60])
    for path, crs, words in [(no_crs, "EPSG:32631", "no CRS. State it: gdal_edit"),
                             (fathoms, "EPSG:32631", "is in fathom"),
                             (good, "local", "only to ground coordinates with a CRS"),
                             (broken, "EPSG:32631", "GDAL cannot read"),
                             (tmp_path / "none.tif", "EPSG:32631", "none.tif")]:
        with pytest.raises(TermselError, match=words), open_dem(path, crs):
            pass


@pytest.mark.slow
def test_run_with_a_dem_states_the_datum(tmp_path: Path) -> None:
    """On the command line: a plane stands for the relief of a scene without heights."""
    scene = simulate_scene("spot-isfahan")
    ground = scene.points.ground.copy()
    low, high = ground[:, :2].min(axis=0) - 0.01, ground[:, :2].max(axis=0) + 0.01
    size = np.ceil((high - low) / 0.001).astype(int)
    path = dem(tmp_path / "dem.tif", np.full((size[1], size[0]), 1600.0), "EPSG:4326",
               from_origin(low[0], high[1], 0.001, 0.001))
    ground[:, 2] = np.nan
    write_points_csv(Points(scene.points.ids, scene.points.image, ground, None,
                            scene.points.roles), tmp_path / "points.csv", "EPSG:4979")
    command = [sys.executable, "-m", "termsel", "run", "--problem", "poly-terms", "--points",
               str(tmp_path / "points.csv"), "--json", "--generations", "2", "--set",
               "population=20"]
    done = subprocess.run([*command, "--dem", str(path), "--out", str(tmp_path / "out")],
                          capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    statement = (f"{len(ground)} of {len(ground)} heights from dem.tif, bilinear; vertical datum: "
                 "not declared by the raster")
    assert json.loads(done.stdout)["data"]["heights"] == statement
    assert f"Heights: {statement}." in done.stderr
    dem(path, np.full((3, 3), 1600.0), "EPSG:4326", from_origin(low[0], high[1], 0.001, 0.001))
    done = subprocess.run([*command, "--dem", str(path)], capture_output=True, text=True,
                          check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert "all points are outside the raster" in done.stderr
    done = subprocess.run([sys.executable, "-m", "termsel", "run", "--problem", "poly-terms",
                           "--dem", str(path)], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "--dem requires --points or --lines" in done.stderr


def test_lines_take_heights_too(tmp_path: Path) -> None:
    path = dem(tmp_path / "dem.tif", planar(30, 20))
    vertices = [[[EAST + 15, NORTH - 15, np.nan], [EAST + 95, NORTH - 15, np.nan]]]
    write_lines_csv(Lines(("l",), [[[1, 2], [3, 4]]], vertices), tmp_path / "l.csv", "EPSG:32631")
    found = termsel.read(lines=tmp_path / "l.csv", dem=path)
    np.testing.assert_allclose(found.lines.ground[0, :, 2], [111.25, 131.25], rtol=1e-6)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_value_for_no_data_beyond_the_type_is_none(tmp_path: Path) -> None:
    path = tmp_path / "dem.vrt"
    path.write_text('<VRTDataset rasterXSize="4" rasterYSize="4"><SRS>EPSG:4326</SRS>'
                    "<GeoTransform>5, 1, 0, 45, 0, -1</GeoTransform><VRTRasterBand "
                    'dataType="Float32" band="1"><NoDataValue>1e308</NoDataValue>'
                    "</VRTRasterBand></VRTDataset>")
    with open_dem(path, "EPSG:4326") as surface:
        assert np.isnan(surface(np.array([[6.5, 43.5]])))


def test_a_height_far_from_the_control_is_said(tmp_path: Path,
                                               caplog: pytest.LogCaptureFixture) -> None:
    control = termsel.simulate_scene("ikonos-hamedan", n_lines=0)
    result = termsel.run(features=control, method="dlt")
    heights = control.points.ground[:, 2]
    for height, side in ((heights.max() + 5000.0, "above"), (heights.min() - 5000.0, "below")):
        caplog.clear()
        say_difference(result.features, result.project, float(height))
        assert f"5,000 m {side} the control" in caplog.text
    caplog.clear()
    say_difference(result.features, result.project, float(heights.mean()))
    assert not caplog.text


def test_heights_that_rasters_have_where_there_is_none_are_no_ground() -> None:
    with pytest.raises(TermselError, match="-9999 is no height"), \
            surface_of(None, "EPSG:4979", -9999.0):
        pass
