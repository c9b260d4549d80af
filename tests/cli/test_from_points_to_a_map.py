"""The whole way: measure, select, export, rectify; what was on the ground lands in its place."""

from __future__ import annotations

import importlib.util
import re
import shutil
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from click.testing import CliRunner

import termsel
from termsel.cli.main import cli

pytest.importorskip("rasterio")
pytest.importorskip("pyproj")
pytestmark = pytest.mark.filterwarnings("ignore:Dataset has no geotransform",
                                        "ignore::PendingDeprecationWarning")
FOLDER = Path(__file__).parents[2] / "docs" / "tutorial"


@pytest.fixture(scope="module")
def chain() -> ModuleType:
    sys.path.insert(0, str(FOLDER))
    spec = importlib.util.spec_from_file_location("rectified", FOLDER / "rectified.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["rectified"] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def folder(example_files: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return shutil.copytree(example_files, tmp_path_factory.mktemp("chain") / "files")


def _termsel(*arguments: str) -> str:
    done = CliRunner().invoke(cli, arguments, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.output


@pytest.fixture(scope="module")
def result(folder: Path) -> Path:
    out = folder / "result"
    _termsel("run", "--problem", "rfm-terms", "--points", str(folder / "gcps.csv"),
             "--generations", "30", "--out", str(out), "--export", "rpc-txt", "--quiet")
    return out


def _rectified(chain: ModuleType, folder: Path, result: Path, name: str) -> np.ndarray:
    target = folder / name
    _termsel("rectify", str(result), str(folder / "scene.tif"), "--dem", str(folder / "dem.tif"),
             "--output", str(target), "--crs", "EPSG:32639", "--res", "10", "--quiet")
    apart = chain.corners_found(target) - chain.corners_true(target)
    assert len(apart) > 150
    return np.asarray(apart)


def _require_in_place(apart: np.ndarray) -> None:
    assert np.linalg.norm(apart, axis=1).max() < 0.5
    # A half-pixel shift would be seen here, whatever the noise of the points.
    assert np.abs(apart.mean(axis=0)).max() < 0.1


def test_corners_land_in_their_places_by_rpc(chain: ModuleType, folder: Path, result: Path,
                                             ) -> None:
    _require_in_place(_rectified(chain, folder, result, "rpc.tif"))


@pytest.mark.slow
def test_corners_land_in_their_places_by_geolocation_array(
        chain: ModuleType, folder: Path, result: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("termsel.io.rectify.GOOD", -1.0)  # as if no RPC came near the model
    _require_in_place(_rectified(chain, folder, result, "array.tif"))


def test_map_is_cloud_optimised_and_empty_around(chain: ModuleType, folder: Path, result: Path,
                                                 ) -> None:
    import rasterio

    _rectified(chain, folder, result, "map.tif")
    with rasterio.open(folder / "map.tif") as raster:
        assert raster.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert raster.crs.to_epsg() == 32639
        assert raster.res == (10.0, 10.0)
        assert raster.nodata is None
        pixels, shown = raster.read(1), raster.dataset_mask() > 0
    assert not shown[0].any()
    assert not shown[:, -1].any()
    assert (pixels[~shown] == 0).all()
    assert shown.mean() > 0.5
    assert sorted(path.name for path in folder.glob("map.*")) == ["map.tif"]


def test_rectify_says_what_the_map_is_and_what_is_missing(
        folder: Path, result: Path, tmp_path: Path) -> None:
    import rasterio

    with rasterio.open(folder / "dem.tif") as dem:
        half = dem.read(1)[:, : dem.width // 2]
        profile = {**dem.profile, "width": half.shape[1]}
    with rasterio.open(tmp_path / "half.tif", "w", **profile) as part:
        part.write(half, 1)
    texts, shown = [], []
    for name in (folder / "dem.tif", tmp_path / "half.tif"):
        target = tmp_path / f"{name.stem}_map.tif"
        texts.append(_termsel("rectify", str(result), str(folder / "scene.tif"), "--dem", str(name),
                              "--output", str(target), "--crs", "EPSG:32639", "--res", "20"))
        with rasterio.open(target) as made:
            shown.append((made.read(1) > 0).sum())
            assert (f"Map: {made.width} x {made.height} px of 20 m in EPSG:32639, "
                    "with ") in texts[-1]
    assert "with all of the image." in texts[0]
    assert "Warning" not in texts[0]
    share = int(re.search(r"with about (\d+) % of the image", texts[1])[1])
    assert share == pytest.approx(100 * shown[1] / shown[0], abs=5)
    assert (f"Warning: about {100 - share} % of the image is not on the map, as "
            f"{tmp_path / 'half.tif'} has no heights there.") in texts[1]


def test_gdal_warps_the_exported_rpc_to_the_same_place(
        chain: ModuleType, folder: Path, result: Path) -> None:
    """What a user of gdalwarp -rpc -to RPC_DEM=dem.tif gets."""
    import rasterio
    from rasterio.warp import reproject

    _rectified(chain, folder, result, "ours.tif")
    (folder / "scene_RPC.TXT").write_bytes((result / "result_RPC.TXT").read_bytes())
    with rasterio.open(folder / "ours.tif") as ours:
        pixels = np.zeros(ours.shape, dtype=np.uint8)
        with rasterio.open(folder / "scene.tif") as scene:
            reproject(rasterio.band(scene, 1), pixels, dst_crs=ours.crs,
                      dst_transform=ours.transform, dst_nodata=0, rpcs=scene.rpcs,
                      resampling=rasterio.enums.Resampling.bilinear,
                      RPC_DEM=str(folder / "dem.tif"))
        assert np.array_equal(pixels, ours.read(1))
    (folder / "scene_RPC.TXT").unlink()


def test_what_cannot_be_rectified_is_refused(folder: Path, result: Path, tmp_path: Path) -> None:
    scene, dem, out = (str(path) for path in (folder / "scene.tif", folder / "dem.tif",
                                              tmp_path / "map.tif"))
    (tmp_path / "text.tif").write_text("not an image")
    (tmp_path / "there.tif").write_text("a map made before")
    for arguments, message in (
            ([scene, "-o", out], "depends on the height of the ground"),
            ([scene, "-o", out, "--dem", dem, "--height", "5"], "exclude each other"),
            ([scene, "-o", out, "--dem", dem, "--crs", "local"], "a map needs a CRS"),
            ([scene, "-o", out, "--dem", dem, "--crs", "EPSG:99"], "does not exist"),
            ([scene, "-o", out, "--dem", dem, "--res", "1e-9"], "Give --res in the units"),
            ([scene, "-o", out, "--dem", dem, "--resampling", "best"], "unknown resampling"),
            ([scene, "-o", str(tmp_path / "there.tif"), "--dem", dem], "this file already exists"),
            ([scene, "-o", str(tmp_path / "no" / "map.tif"), "--dem", dem],
             "no/map.tif: cannot write this file: there is no such folder"),
            ([scene, "-o", out, "--height", "nan"], "cannot be nan"),
            ([scene, "-o", str(tmp_path / "map.png"), "--dem", dem],
             "map.png: a map is written as GeoTIFF, not as .png. Name it map.tif"),
            ([scene, "-o", out, "--dem", dem, "--sigma", str(tmp_path / "s.jpg")],
             "s.jpg: a map is written as GeoTIFF, not as .jpg"),
            ([scene, "-o", out, "--dem", dem, "--res", "inf"], "cannot be inf"),
            ([scene, "-o", out, "--dem", dem, "--res", "10", "--crs", "EPSG:32639", "--nodata",
              "999"], "uint8 cannot have the value 999"),
            ([scene, "-o", out, "--dem", dem, "--res", "10", "--crs", "EPSG:32639", "--nodata",
              "nan"], "uint8 cannot have the value nan"),
            ([str(tmp_path / "text.tif"), "-o", out, "--dem", dem],
             "this is a file of text, not a raster"),
            ([scene, "-o", out, "--dem", str(tmp_path / "text.tif")],
             "this is a file of text, not a raster"),
            ([scene, "-o", out, "--dem", scene], "not georeferenced")):
        done = CliRunner().invoke(cli, ["rectify", str(result), *arguments])
        assert done.exit_code == 2, (arguments, done.output)
        assert message in done.output
        assert not (tmp_path / "map.tif").exists()
    assert (tmp_path / "there.tif").read_text() == "a map made before"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["text.tif", "there.tif"]


def test_python_refuses_a_map_without_the_heights_it_depends_on_as_the_command_does(
        folder: Path, result: Path, tmp_path: Path) -> None:
    with pytest.raises(termsel.TermselError, match=r"the ground\. .* dem=FILE or height=H"):
        termsel.rectify(termsel.read_result(result), folder / "scene.tif", tmp_path / "map.tif")
    assert not (tmp_path / "map.tif").exists()
