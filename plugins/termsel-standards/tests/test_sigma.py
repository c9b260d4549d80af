"""The uncertainty as a raster: against the model at each pixel, and what is refused."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result

pytest.importorskip("termsel_standards", reason="termsel-standards is not installed: "
                    "pip install -e plugins/termsel-standards")

import termsel
from termsel import TermselError
from termsel.testing import invoke
from termsel_standards import write_sigma

rasterio, pyproj = pytest.importorskip("rasterio"), pytest.importorskip("pyproj")


def call(*words: object) -> Result:
    return invoke(*words)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory, example_files: Path) -> Path:
    folder = shutil.copytree(example_files, tmp_path_factory.mktemp("sigma") / "files")
    for name, *words in (("relief", "--points", folder / "gcps.csv"),
                         ("plain", "--points", folder / "points.csv")):
        assert call("run", *words, "--out", folder / name, "--quiet").exit_code == 0
    return folder


@pytest.mark.slow_cases("relief")
@pytest.mark.parametrize("name", ["relief", "plain"])
def test_each_pixel_is_what_the_model_says_there(files: Path, tmp_path: Path, name: str) -> None:
    result = termsel.read_result(files / name)
    dem = files / "dem.tif" if name == "relief" else None
    told = write_sigma(result, tmp_path / "s.tif", dem=dem, final=False)
    exported = result.as_exported(False)
    crs = result.features.crs
    with rasterio.open(tmp_path / "s.tif") as raster:
        bands, crs_of_map = raster.read(), raster.crs
        assert raster.descriptions == ("line", "sample", "east", "north", "outside")
        assert raster.units == ("px", "px", "m", "m", "1 or 0")
        rng = np.random.default_rng(8)
        row, column = (rng.integers(0, side, 500) for side in raster.shape)
        x, y = raster.xy(row, column)
    lon, lat = pyproj.Transformer.from_crs(crs_of_map, "EPSG:4979", always_xy=True).transform(x, y)
    ground = np.column_stack([lon, lat, np.full(500, exported.fit.ground_box()[0][2])])
    if dem is not None:
        with termsel.open_dem(dem, crs) as surface:
            ground[:, 2] = surface(ground[:, :2])
    expected = exported.sigma(ground)
    error = np.abs(bands[:2, row, column].T / expected - 1.0)
    # These are other places than those of which the error is told.
    assert np.nanmax(error) < 0.02
    assert np.nanquantile(error, 0.99) <= told < 0.01
    # On the ground: where the ray of a moved image point arrives, one axis at a time.
    image, moves = exported.project(ground), []
    for axis in (0, 1):
        moved = image.copy()
        moved[:, axis] += expected[:, axis]
        there = exported.locate(moved, ground[:, 2])
        metres = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:32639", always_xy=True)
        moves.append(np.subtract(*(np.column_stack(metres.transform(*one.T)[:2])
                                   for one in (there, ground))))
    grid = np.hypot(*moves)  # of the zone of UTM, turned against north by its convergence
    assert np.hypot(*bands[2:4, row, column]) == pytest.approx(np.hypot(*grid.T), rel=0.02)
    made = exported.fit.original or exported.fit
    inside = _is_inside(made.control.take(made.used).ground_vertices(), ground)
    assert ((bands[4, row, column] == 0) == inside).all()
    assert 0.05 < inside.mean() < 0.99


def _is_inside(control: np.ndarray, places: np.ndarray) -> np.ndarray:
    from shapely import MultiPoint, contains_xy

    hull = MultiPoint(control[:, :2]).convex_hull
    low, high = control[:, 2].min(), control[:, 2].max()
    return np.asarray(contains_xy(hull, *places[:, :2].T) & (low <= places[:, 2])
                      & (places[:, 2] <= high))


@pytest.mark.slow
def test_it_is_cloud_optimised_with_statistics(files: Path, tmp_path: Path) -> None:
    path = tmp_path / "s.tif"
    done = call("sigma", files / "plain", "-o", path, "--bounds", 268000, 3852000, 272000, 3855000,
                "--crs", "EPSG:32639", "--res", 5)
    assert done.exit_code == 0, done.output
    with rasterio.open(path) as raster:
        assert raster.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert (raster.shape, tuple(raster.bounds)) == ((600, 800), (268000, 3852000, 272000,
                                                                     3855000))
        assert "% of the model at 400 places" in raster.tags()["UNCERTAINTY"]
        for band in raster.indexes:
            pixels, tags = raster.read(band), raster.tags(band)
            assert float(tags["STATISTICS_MEAN"]) == pytest.approx(np.nanmean(pixels), rel=1e-5)
            assert float(tags["STATISTICS_MAXIMUM"]) == pytest.approx(np.nanmax(pixels), rel=1e-6)


@pytest.mark.slow
def test_rectify_writes_it_next_to_the_map_with_the_accuracy(files: Path, tmp_path: Path) -> None:
    done = call("rectify", files / "relief", files / "scene.tif", "--dem", files / "dem.tif",
                "-o", tmp_path / "map.tif", "--sigma", tmp_path / "s.tif", "--res", 40, "--quiet")
    assert done.exit_code == 0, done.output
    known = termsel.read_result(files / "relief").accuracy
    assert known is not None
    assert known.ground is not None
    with rasterio.open(tmp_path / "map.tif") as made, rasterio.open(tmp_path / "s.tif") as sigma:
        assert made.crs == sigma.crs
        assert tuple(sigma.bounds) == pytest.approx(tuple(made.bounds), abs=sigma.res[0])
        for tags in (made.tags(), sigma.tags()):
            assert float(tags["ACCURACY_RMSE_M"]) == pytest.approx(known.ground.total, rel=1e-3)
            assert float(tags["ACCURACY_CE90_M"]) == pytest.approx(known.ground.ce90, rel=1e-3)
            assert float(tags["ACCURACY_RMSE_PX"]) == pytest.approx(known.image.total, rel=1e-3)
            assert tags["ACCURACY_POINTS"] == str(known.image.n)
            assert tags["TIFFTAG_DATETIME"][:10].replace(":", "-") == tags["ACCURACY_DATE"]


def test_without_independent_points_the_metadata_say_so(files: Path, tmp_path: Path) -> None:
    table = (files / "points.csv").read_text().replace("independent", "control")
    (tmp_path / "p.csv").write_text(table)
    features = termsel.read(tmp_path / "p.csv")
    result = termsel.run("poly-terms", strategy="as-asked", model="affine", solver="all-terms",
                         features=features)
    write_sigma(result, tmp_path / "s.tif")
    with rasterio.open(tmp_path / "s.tif") as raster:
        assert raster.tags()["ACCURACY_STATED"].startswith(
            "no: the result has no independent check points")
        assert "ACCURACY_RMSE_M" not in raster.tags()


@pytest.mark.parametrize(("words", "said"), [
    (("--res", 1e-3), "Give a larger --res"),
    (("--bounds", 0, 0, 1, 1, "--crs", "EPSG:4326"), "far outside the control"),
    (("--bounds", 5, 5, 1, 9, "--crs", "EPSG:32639"), "--bounds 1 5 5 9 --crs EPSG:4326, as they "
     "look like degrees, and the raster is in EPSG:32639"),
    (("--bounds", 500, 5, 1, 900, "--crs", "EPSG:32639"), "--bounds 1 5 500 900."),
    (("--crs", "EPSG:4978"), "geocentric"),
    (("--map", "dem.tif", "--bounds", 1, 2, 3, 4), "--map and --bounds exclude each other"),
    (("--dem", "dem.tif", "--height", 4), "--dem and --height exclude each other"),
    (("--dem", "dem.tif", "--bounds", 0, 0, 9, 9, "--crs", "EPSG:4326"), "has none on this map"),
    (("--image", "scene.tif"), "points extend to"),
    (("--map", "points.csv"), "a file of text, not a raster"),
    (("-o", "sigma.png", "--res", 1e-3), "written as GeoTIFF, not as .png"),
    (("-o", "-"), "cannot write to stdout")])
def test_what_cannot_be_is_refused(files: Path, tmp_path: Path, words: tuple[object, ...],
                                   said: str) -> None:
    words = tuple(files / str(word) if str(word).endswith((".tif", ".csv")) else word
                  for word in words)
    out = () if "-o" in words else ("-o", tmp_path / "s.tif")
    done = call("sigma", files / "plain", *out, *words)
    assert done.exit_code == 2
    assert said in done.stderr.replace("\n", " ")
    assert not list(tmp_path.iterdir())


def test_it_replaces_nothing_that_it_reads_and_nothing_unasked(files: Path, tmp_path: Path) -> None:
    before = (files / "dem.tif").read_bytes()
    for words in (("sigma", files / "relief", "--dem", files / "dem.tif", "--overwrite"),
                  ("rectify", files / "relief", files / "scene.tif", "--dem", files / "dem.tif",
                   "-o", tmp_path / "map.tif", "--overwrite", "--sigma")):
        option = () if words[-1] == "--sigma" else ("-o",)
        done = call(*words, *option, files / "dem.tif")
        assert (done.exit_code, "reads this file" in done.stderr) == (2, True)
    assert (files / "dem.tif").read_bytes() == before
    (tmp_path / "s.tif").write_text("mine")
    with pytest.raises(TermselError, match="already exists"):
        write_sigma(termsel.read_result(files / "plain"), tmp_path / "s.tif")
    done = call("rectify", files / "relief", files / "scene.tif", "--height", 1800, "-o",
                tmp_path / "map.tif", "--sigma", tmp_path / "." / "map.tif")
    assert (done.exit_code, "name the same file" in done.stderr) == (2, True)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such limit")
def test_a_full_disk_leaves_no_half_file(files: Path, tmp_path: Path) -> None:
    code = ("import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); "
            "resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000)); "
            "import runpy; runpy.run_module('termsel', run_name='__main__')")
    done = subprocess.run([sys.executable, "-c", code, "sigma", files / "plain", "-o",
                           tmp_path / "s.tif"], capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.iterdir())


def test_bounds_in_degrees_are_answered_by_bounds_to_type(tmp_path: Path) -> None:
    result = termsel.run("poly-terms", evaluations=200, options={"degree": 2})
    target = tmp_path / "sigma.tif"
    with pytest.raises(TermselError) as caught:
        write_sigma(result, target, bounds=(48.49, 34.77, 48.53, 34.81))
    hint = str(caught.value.hint)
    assert "The raster is in EPSG:32639, and these bounds look like degrees" in hint
    assert "add --crs EPSG:4326" in hint
    bounds = [float(word) for word in hint.partition("--bounds ")[2].partition(",")[0].split()]
    assert len(bounds) == 4
    write_sigma(result, target, bounds=bounds)
    assert target.exists()
