"""What people type at first and do not mean is answered by what to type."""

from __future__ import annotations

import csv
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

rasterio = pytest.importorskip("rasterio")
Call = Callable[..., SimpleNamespace]
Rows = list[list[str]]


@pytest.fixture(scope="module")
def files(example_files: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Path(shutil.copytree(example_files, tmp_path_factory.mktemp("example") / "files"))


def changed(files: Path, path: Path, columns: dict[str, Callable[[float], float]],
            count: int = 40) -> Path:
    """Write the first control points of the example with some columns changed."""
    with (files / "gcps.csv").open() as file:
        declared, header, *rows = list(csv.reader(file))
    for row in rows:
        for name, change in columns.items():
            row[header.index(name)] = f"{change(float(row[header.index(name)])):.8f}"
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([declared, header, *rows[:count]])
    return path


@pytest.mark.parametrize(("image", "remedy"), [
    (True, "Multiply line by 500, and sample by 600."),
    (False, "Multiply line by the number of its lines, and sample by that of its samples.")])
def test_fractions_of_an_image_are_no_pixels(files: Path, tmp_path: Path, call: Call, image: bool,
                                             remedy: str) -> None:
    points = changed(files, tmp_path / "part.csv", {"line": lambda line: line / 500.0,
                                                    "sample": lambda sample: sample / 600.0})
    done = call("run", points, *[files / "scene.tif"] * image)
    assert done.exit_code == 2
    assert "all lines and samples are between 0 and 1" in done.stderr
    assert remedy in done.stderr


def as_digits(angle: float) -> float:
    """Return 48.3057 for 48 degrees, 30 minutes and 57 seconds."""
    minutes, seconds = divmod(angle % 1.0 * 3600.0, 60.0)
    return angle // 1.0 + minutes / 100.0 + seconds / 10_000.0


def test_seconds_typed_as_decimals_are_named_within_one_degree_too(files: Path, tmp_path: Path,
                                                                   call: Call) -> None:
    right = call("run", changed(files, tmp_path / "right.csv", {}))
    assert "typed as decimals" not in right.stdout + right.stderr
    done = call("run", changed(files, tmp_path / "wrong.csv", {"x": as_digits, "y": as_digits}))
    assert "look like degrees, minutes and seconds typed as decimals" in done.stderr
    assert "Next: correct the coordinates, then run again" in done.stdout


def test_the_folder_of_a_run_by_another_name(files: Path, call: Call) -> None:
    done = call("run", files / "gcps.csv", "-o", "result")
    assert done.stderr == ("Error: there is no option -o. Did you mean --out?\n"
                           "All options: termsel run --help-all\n")


def test_tables_of_points_in_place_of_studies(files: Path, call: Call) -> None:
    tables = sorted((files / "images").glob("*.csv"))
    done = call("compare", *tables, "--out", "batch")
    assert done.exit_code == 2
    assert f"{tables[0]}: this is no study file" in done.stderr
    assert f"termsel compare --points '{files / 'images'}/*.csv' --out DIR" in done.stderr


@pytest.fixture
def result(files: Path, tmp_path: Path, call: Call) -> Path:
    assert call("run", files / "gcps.csv", "--out", tmp_path / "result").exit_code == 0
    return tmp_path / "result"


def write_heights(path: Path, of: Path, factor: float = 1.0, size: int | None = None) -> Path:
    """Write a raster of heights times a factor, or its first lines and samples."""
    with rasterio.open(of) as raster:
        heights = raster.read(1).astype(np.float32)[:size, :size] * factor
        profile = {"driver": "GTiff", "crs": raster.crs, "transform": raster.transform, "count": 1,
                   "dtype": "float32", "height": heights.shape[0], "width": heights.shape[1]}
    with rasterio.open(path, "w", **profile) as raster:
        raster.write(heights, 1)
    return path


def test_which_of_dem_and_points_is_in_feet(files: Path, tmp_path: Path, result: Path,
                                            call: Call) -> None:
    feet = write_heights(tmp_path / "feet.tif", files / "dem.tif", 1.0 / 0.3048)
    done = call("rectify", result, files / "scene.tif", "--dem", feet, "-o", tmp_path / "map.tif")
    assert "is the DEM in feet? gdal_translate" in done.stderr
    assert "-scale 0 1 0 0.3048 feet.tif metres.tif" in done.stderr
    points = changed(files, tmp_path / "feet.csv", {"z": lambda z: z / 0.3048})
    done = call("run", points, "--dem", files / "dem.tif")
    assert "are the points in feet? Run again with --set z_unit=ft" in " ".join(
        done.stdout.split())
    done = call("run", points, "--dem", files / "dem.tif", "--set", "z_unit=ft")
    assert "in feet?" not in done.stdout + done.stderr


def test_a_raster_beside_the_points_is_a_neighbouring_tile(files: Path, tmp_path: Path,
                                                           result: Path, call: Call) -> None:
    tile = write_heights(tmp_path / "tile.tif", files / "dem.tif", size=60)
    for words in (("rectify", result, files / "scene.tif", "-o", tmp_path / "map.tif"),
                  ("run", files / "scene.points")):
        done = call(*words, "--dem", tile)
        assert done.exit_code == 2
        assert "The raster covers x " in done.stderr
        assert "is it a neighbouring tile?" in done.stderr
        assert "another place" not in done.stderr
        assert "--off" not in done.stderr  # of all points


def test_no_cross_validation_is_claimed_where_there_is_none(files: Path, tmp_path: Path,
                                                            call: Call) -> None:
    pytest.importorskip("termsel_rpc")
    one = changed(files, tmp_path / "one.csv", {}, count=1)
    done = call("run", one, "--rpc", files / "vendor.RPB")
    assert "in cross-validation" not in done.stdout
    assert "in leave-one-out" not in done.stdout
    assert "Compared  RPC as delivered: 16.7 px" in done.stdout
    three = changed(files, tmp_path / "three.csv", {}, count=3)
    assert "in cross-validation" not in call("run", three).stdout


def test_an_image_before_the_folder_of_its_result(files: Path, tmp_path: Path, result: Path,
                                                  call: Call) -> None:
    image, output = files / "scene.tif", tmp_path / "map.tif"
    done = call("rectify", image, result, "-o", output, "--height", 1800)
    assert done.exit_code == 2
    assert f"termsel rectify {result} {image} -o {output} --height 1800" in done.stderr
    assert not output.exists()


def test_a_folder_of_a_result_in_place_of_a_raster(result: Path, call: Call) -> None:
    pytest.importorskip("termsel_formats")
    done = call("check", result)
    assert done.exit_code == 2
    assert f"termsel report {result} shows the result" in done.stderr
    assert f"termsel check map.tif --result {result}" in done.stderr
    done = call("check", result / "certificate.json")
    assert "the run of this folder has kept no certificate. Run again with --solver exact" in (
        done.stderr)
