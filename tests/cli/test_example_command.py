"""`termsel example` writes what the tutorial and the guides use, or nothing."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import termsel
from termsel.io.example import EXAMPLE_FILES, README
from termsel.simulate.example import EXAMPLE_NOISE, SENSOR, VENDOR
from termsel.simulate.sheets import GRID_SPACING

pytest.importorskip("rasterio")
pytest.importorskip("pyproj")


@pytest.fixture(scope="module")
def files(example_files: Path) -> Path:
    return example_files


def test_readme_names_every_file(files: Path) -> None:
    assert {one.name for one in files.iterdir()} == {*EXAMPLE_FILES, README}
    text = (files / README).read_text(encoding="utf-8")
    assert all(f"{name} " in text for name in EXAMPLE_FILES)


def test_points_are_where_the_scanner_sees_them(files: Path) -> None:
    control = termsel.read(files / "gcps.csv").points
    apart = control.image - SENSOR.project(control.ground)
    assert np.sqrt((apart**2).mean()) == pytest.approx(EXAMPLE_NOISE, rel=0.15)
    vendor = termsel.read_rpc(files / "vendor.RPB").project(control.ground)
    assert np.abs(vendor - SENSOR.project(control.ground) - VENDOR).max() < 0.05


def test_all_forms_of_the_points_say_the_same(files: Path) -> None:
    control = termsel.read(files / "gcps.csv").points
    plain = termsel.read(files / "noheader.txt", crs="EPSG:4979",
                         columns="id=1,x=2,y=3,z=4,sample=5,line=6").points
    assert np.array_equal(plain.image, control.image[:40])
    assert np.array_equal(plain.ground, control.ground[:40])
    qgis = termsel.read(files / "scene.points", dem=files / "dem.tif").points
    assert qgis.image == pytest.approx(control.image[:60], abs=1e-3)
    # The DEM has a height every 20 m.
    assert qgis.ground[:, 2] == pytest.approx(control.ground[:60, 2], abs=1.0)


def test_matches_of_three_programs_are_the_same(files: Path) -> None:
    pytest.importorskip("termsel_match")
    ortho = {"reference": str(files / "ortho.tif")}
    ours, asp = (termsel.read(files / name, **ortho).points
                 for name in ("matches.csv", "matches.txt"))
    arosics = termsel.read(files / "tiepoints.csv", crs="EPSG:32639").points
    for one in (asp, arosics):
        assert one.image == pytest.approx(ours.image, abs=2e-3)
        assert one.ground[:, :2] == pytest.approx(ours.ground[:, :2], abs=0.02)


def test_points_of_a_sheet_are_at_crossings_of_its_grid_in_the_scan(files: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    points = termsel.read(files / "maps" / "sheet-1.points").points
    with rasterio.open(files / "maps" / "sheet-1.tif") as scan:
        pixels = scan.read(1)
    assert np.all(points.ground[:, :2] % GRID_SPACING == 0)
    for line, sample in points.image.round().astype(int):
        around = pixels[max(line - 2, 0):line + 3, max(sample - 2, 0):sample + 3]
        assert around.min() == 60  # a printed line


def test_folder_that_exists_is_left_alone(files: Path, tmp_path: Path,
                                          call: Callable[..., SimpleNamespace]) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "file").write_text("mine")
    for name, what in (("mine", "this folder exists already"),
                       ("file", "a file of this name exists already"),
                       ("nowhere/files", "the folder above this one does not exist"),
                       ("file/files", "file is a file, not a folder")):
        done = call("example", tmp_path / name)
        assert done.exit_code == 2
        assert what in done.stderr
    assert not any((tmp_path / "mine").iterdir())
    assert sorted(os.listdir(tmp_path)) == ["file", "mine"]
    assert (tmp_path / "file").read_text() == "mine"
