"""Maps of the images of a batch: made where the verdict allows it, and counted where not."""

from __future__ import annotations

import csv
import os
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import termsel
from termsel import Points, TermselError
from termsel.formats.readers.csv_tables import write_points_csv
from termsel.studies.maps import (
    FAILED,
    KEPT,
    LEFT_OUT,
    PLANNED,
    _pictures_of,
    next_command,
    plan_maps,
)
from termsel.studies.study import Study

rasterio = pytest.importorskip("rasterio")
pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

Call = Callable[..., SimpleNamespace]
SIZE = (60, 80)
COUNTS = {"sheet_1": 12, "sheet_2": 14, "sheet_3": 3}
"""Points of each sheet; three say nothing of the accuracy, so that the verdict is doubtful."""


@pytest.fixture(scope="module")
def sheets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with points of three sheets, the result of their batch, and scans of two."""
    folder = tmp_path_factory.mktemp("sheets")
    (folder / "points").mkdir()
    (folder / "scans").mkdir()
    rng = np.random.default_rng(2)
    for name, count in COUNTS.items():
        image = rng.uniform(3, 57, (count, 2))
        east, north = 5e5 + 4.0 * image[:, 1], 5e6 - 4.0 * image[:, 0]
        image += rng.normal(0.0, 0.3, image.shape)
        ids = tuple(f"P{i}" for i in range(count))
        points = Points(ids, image, np.column_stack([east, north, np.full(count, np.nan)]))
        write_points_csv(points, folder / "points" / f"{name}.csv", crs="EPSG:32633")
    (folder / "points" / "sheet_4.csv").write_text("id,line,sample,x,y\nP1,1,2,abc,4\n")
    for name in ("Sheet_1.tif", "sheet_3.png"):
        with rasterio.open(folder / "scans" / name, "w", width=SIZE[1], height=SIZE[0], count=1,
                           dtype="uint8") as raster:
            raster.write(rng.integers(1, 255, (1, *SIZE)).astype("uint8"))
    termsel.compare(data=[{"points": str(folder / "points" / "*.csv"), "crs": "EPSG:32633"}],
                    methods=["affine"], out=folder / "batch")
    return folder


def states(sheets: Path, out: Path, **options: bool) -> dict[str, str]:
    maps = plan_maps(sheets / "batch", sheets / "scans", out,
                     **{"with_doubtful": False, "overwrite": False, **options})
    return {item.folder.name: item.state for item in maps}


def test_a_map_is_planned_for_what_is_fit_for_use_and_has_one_picture(
        sheets: Path, tmp_path: Path) -> None:
    planned = {"sheet_1": PLANNED, "sheet_2": FAILED, "sheet_3": LEFT_OUT, "sheet_4": LEFT_OUT}
    assert states(sheets, tmp_path) == planned
    assert states(sheets, tmp_path, with_doubtful=True) == planned | {"sheet_3": PLANNED}
    (tmp_path / "sheet_1.tif").touch()
    assert states(sheets, tmp_path) == planned | {"sheet_1": KEPT}
    assert states(sheets, tmp_path, overwrite=True) == planned


def test_several_pictures_of_one_name_are_not_chosen_from(sheets: Path, tmp_path: Path) -> None:
    for name in ("sheet_1.tif", "sheet_1.jpg", "sheet_1.csv", "sheet_2.csv.png"):
        (tmp_path / name).touch()
    maps = plan_maps(sheets / "batch", tmp_path, tmp_path / "maps", with_doubtful=False,
                     overwrite=False)
    assert "has several of this name: sheet_1.jpg, sheet_1.tif" in maps[0].why
    assert "has no image of the name sheet_2" in maps[1].why


def test_maps_of_a_batch_are_written_with_a_table(call: Call, sheets: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "maps"
    words = ("rectify", sheets / "batch", sheets / "scans", "--output", out)
    tried = call(*words, "--dry-run")
    assert not out.exists()
    assert "4 images: 1 planned, 2 left out, 1 failed" in tried.stdout
    done = call(*words)
    assert tried.exit_code == done.exit_code == 1
    assert "4 images: 1 written, 2 left out, 1 failed" in done.stdout
    assert "'abc' is not a number" in done.stdout
    with rasterio.open(out / "sheet_1.tif") as raster:
        assert raster.crs.to_epsg() == 32633
    with (out / "maps.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["state"] for row in rows] == ["written", "failed", "left out", "left out"]
    assert rows[0]["map"] == "sheet_1.tif"
    assert all(row["why"] for row in rows[1:])


@pytest.mark.parametrize(("options", "message"), [
    (["scans/sheet_3.png", "--output", "maps"], "this is not a folder of images"),
    (["scans", "--output", "scans"], "maps would have the names of the images"),
    (["scans", "--output", "maps", "--sigma", "s.tif"], "--sigma is for one image"),
    # What would fail for each image is said once, also before a dry run.
    (["scans", "--output", "maps", "--crs", "EPSG:99999", "--dry-run"], "EPSG:99999"),
    (["scans", "--output", "maps", "--resampling", "cubik"], "Did you mean 'cubic'?"),
    (["scans", "--output", "maps", "--dem", "nowhere.tif"], "this file does not exist")])
def test_what_a_batch_cannot_do_is_refused(call: Call, sheets: Path, options: list[str],
                                           message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(sheets)
    done = call("rectify", "batch", *options)
    assert done.exit_code == 2
    assert message in done.stderr
    assert not Path("maps").exists()
    one = call("rectify", "batch/images/sheet_1", "scans/Sheet_1.tif", "-o", "a.tif", "--dry-run")
    assert "--dry-run is for a batch" in one.stderr


def test_a_study_of_searches_has_no_maps(tmp_path: Path) -> None:
    termsel.compare(problems=["poly-terms"], solvers=["random"], seeds=1,
                    budget={"evaluations": 20}, out=tmp_path / "study")
    with pytest.raises(TermselError, match="a study of searches"):
        plan_maps(tmp_path / "study", tmp_path, tmp_path / "maps", with_doubtful=False,
                  overwrite=False)


def test_a_batch_ends_with_the_next_command(sheets: Path, tmp_path: Path,
                                            monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(sheets)
    study = termsel.read_study("batch")
    # Without pictures next to the points no map can be typed yet: the worst has a page.
    command, _, remark = next_command(study, Path("batch")).partition("   ")
    assert shlex.split(command) == ["Next:", "termsel", "report", "batch/images/sheet_3"]
    assert "(the least certain image)" in remark
    (sheets / "points" / "sheet_1.tif").touch()
    (sheets / "points" / "sheet_2.tif").touch()
    assert f"rectify batch {sheets}/points --output" in next_command(study, Path("batch"))
    rows = [row for row in study.rows if row["verdict"] != "plausible"]
    some = Study(study.spec, {row["cell"]: study.cells[row["cell"]] for row in rows},
                 study.records, study.folder)
    assert "Next: termsel plan batch/images/sheet_3 " in next_command(some, Path("batch"))


def test_heights_are_asked_for_before_the_first_map(call: Call, tmp_path: Path) -> None:
    scene = termsel.simulate_scene("ikonos-hamedan")
    write_points_csv(scene.points, tmp_path / "a.csv", crs=scene.crs)
    termsel.compare(data=[{"points": str(tmp_path / "a.csv"), "crs": scene.crs}],
                    methods=["affine"], out=tmp_path / "batch")
    (tmp_path / "a.tif").touch()
    study = termsel.read_study(tmp_path / "batch")
    # A raster of heights is not known, so that no map can be typed.
    assert "Next: termsel report" in next_command(study, tmp_path / "batch")
    done = call("rectify", tmp_path / "batch", tmp_path, "--output", tmp_path / "maps")
    assert done.exit_code == 2
    assert "depends on the height of the ground. Give --dem FILE or --height H." in done.stderr


def test_maps_of_an_earlier_result_are_named(call: Call, sheets: Path, tmp_path: Path) -> None:
    for name in ("sheet_1", "sheet_2", "sheet_3"):
        (tmp_path / f"{name}.tif").touch()
        os.utime(tmp_path / f"{name}.tif", (1e9, 1e9))
    done = call("rectify", sheets / "batch", sheets / "scans", "--output", tmp_path)
    assert "4 images: 2 outdated, 2 left out" in done.stdout
    assert "older than the result; --overwrite makes it again" in " ".join(done.stdout.split())
    with (tmp_path / "maps.csv").open(newline="") as file:
        rows = {row["state"]: row for row in reversed(list(csv.DictReader(file)))}
    assert rows["outdated"]["map"] == "sheet_1.tif"
    left_out = rows["left out"]
    assert left_out["why"].endswith(f"an earlier map is still there: {tmp_path / 'sheet_3.tif'}")
    assert not left_out["map"]


def test_one_picture_is_not_taken_for_two_files_of_points(sheets: Path, tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        shutil.copy(sheets / "points" / "sheet_1.csv", tmp_path / folder)
    termsel.compare(data=[{"points": str(tmp_path / "*" / "sheet_1.csv"), "crs": "EPSG:32633"}],
                    methods=["affine"], out=tmp_path / "batch")
    maps = plan_maps(tmp_path / "batch", sheets / "scans", tmp_path / "maps", with_doubtful=False,
                     overwrite=False)
    assert [item.state for item in maps] == [FAILED, FAILED]
    assert "Sheet_1.tif would be the image of 2 files of points" in maps[0].why


def test_an_image_of_several_in_a_file_is_found_by_its_whole_name() -> None:
    files = [Path(name) for name in ("IMG.1.tif", "IMG.2.tif", "IMG.tif", "a.jpg")]
    assert _pictures_of("gcps.csv#IMG.1", files) == [Path("IMG.1.tif")]
    assert _pictures_of("gcps.csv#scans/a.NEF", files) == [Path("a.jpg")]
    assert _pictures_of("IMG.points", files) == [Path("IMG.tif")]


@pytest.mark.parametrize(("file", "out", "message"), [
    ("file", "file", "this is a file, and a batch needs a folder for its maps"),
    ("file", "file/inside", "this folder cannot be made"),
    ("maps/maps.csv", "maps", "this is no table of maps that termsel wrote")])
def test_files_of_the_user_are_not_replaced(call: Call, sheets: Path, tmp_path: Path, file: str,
                                            out: str, message: str) -> None:
    (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / file).write_text("my own table\n")
    done = call("rectify", sheets / "batch", sheets / "scans", "--output", tmp_path / out)
    assert done.exit_code == 2
    assert message in " ".join(done.stderr.split())
    assert (tmp_path / file).read_text() == "my own table\n"
