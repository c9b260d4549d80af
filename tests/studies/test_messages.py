"""What a study says while it runs names the image it is about."""

from __future__ import annotations

import logging
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio

from termsel.core.isolation.parts import missing_package_error
from termsel.formats.readers.csv_tables import write_points_csv
from termsel.simulate import simulate_scene
from termsel.studies import outputs
from termsel.studies.plan.spec import Spec
from termsel.studies.study import Study
from termsel.testing import invoke


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_messages_of_many_images_name_the_image(
        workers: int, tmp_path: Path) -> None:
    for seed, name in ((1, "100 %d"), (2, "b")):  # a name that looks like a format
        scene = simulate_scene("ikonos-hamedan", seed=seed, n_points=24, n_lines=0)
        write_points_csv(scene.points, tmp_path / f"{name}.csv", crs=scene.crs)
    done = subprocess.run(
        [sys.executable, "-m", "termsel", "compare", "--points", "*.csv", "--crs", "EPSG:4979",
         "--out", "out", "--quiet", "--workers", str(workers), "--export", "qgis-points"],
        cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    warnings = sorted(line for line in done.stderr.splitlines() if "qgis-points: at most" in line)
    assert [line.partition(": qgis-points")[0] for line in warnings] == [
        "Warning: 100 %d.csv", "Warning: b.csv"]


POINTS = tuple(f"{line},{sample},{500_000 + sample},{5_200_000 - line}" for line, sample in (
    (1, 2), (5, 600), (700, 8), (800, 950), (400, 500), (900, 300)))
"""Line and sample, then x and y, of points of a simulated plane."""


def write_tables(folder: Path, names: str, header: str, point: str = "{2},{3},{1},{0}") -> None:
    """Write tables of the same points, which lie by their `names`, under a header."""
    rows = [f"P{n}," + point.format(*row.split(",")) for n, row in enumerate(POINTS)]
    for name in names:
        (folder / f"{name}.csv").write_text("\n".join((header, *rows)) + "\n")


def notes_of_batch(folder: Path, *options: object, files: str = "*.csv") -> list[str]:
    """Return the notes that a batch of the tables of a folder prints before its table."""
    done = invoke("compare", "--points", folder / files, "--crs", "EPSG:32633", "--method",
                  "affine", "--out", folder / "out", "--quiet", *options)
    assert done.exit_code == 0, done.stderr
    return [line for line in done.stderr.splitlines() if line.startswith("Note: ")]


@pytest.fixture
def dem(tmp_path: Path) -> Path:
    """A raster of heights that covers the points."""
    from rasterio.transform import from_origin

    path = tmp_path / "dem.tif"
    with rasterio.open(path, "w", driver="GTiff", width=20, height=20, count=1, dtype="float32",
                       crs="EPSG:32633",
                       transform=from_origin(499_500, 5_200_500, 100, 100)) as raster:
        raster.write(np.full((20, 20), 7.0, np.float32), 1)
    return path


@pytest.mark.parametrize("with_heights", [True, False])
def test_no_note_refers_to_one_that_is_not_printed(
        with_heights: bool, tmp_path: Path, dem: Path) -> None:
    # That files lack heights and names is told by the table, if at all.
    write_tables(tmp_path, "abc", "name,line,sample,x,y", "{0},{1},{2},{3}")
    assert notes_of_batch(tmp_path, *(("--dem", dem) if with_heights else ())) == []


def test_a_note_of_many_images_is_said_once(tmp_path: Path) -> None:
    write_tables(tmp_path, "abc", "id,E,N,x,y")
    assert notes_of_batch(tmp_path) == [
        f"Note: {tmp_path}/a.csv: x and y are read as sample and line, next to E and N on the "
        "ground.",
        f"Note: as in {tmp_path}/a.csv, so in 2 further images: x and y are read as sample and "
        "line, next to E and N on ..."]


def test_unlike_notes_are_all_said(tmp_path: Path) -> None:
    units = ",m,m,px,px"
    write_tables(tmp_path, "ab", f"id,E,N,x,y\n{units}")
    write_tables(tmp_path, "c", "id,East,North,x,y")
    write_tables(tmp_path, "d", f"id,line,sample,x,y\n{units}", "{0},{1},{2},{3}")
    notes = notes_of_batch(tmp_path)
    firsts = [note for note in notes if "so in" not in note]
    others = [note for note in notes if "so in" in note]
    assert [note[:len(f"Note: {tmp_path}/a")][-1] for note in firsts] == ["a", "a", "c"]
    assert len(others) == 2
    assert "so in 2 further images: line 2 of " in others[0]
    assert "so in 1 further image: x and y are read" in others[1]


def test_images_of_one_table_are_counted_as_images(tmp_path: Path) -> None:
    rows = [f"{image}{n},{image},{row}" for image in "abc" for n, row in enumerate(POINTS)]
    (tmp_path / "gcps.csv").write_text("\n".join(("id,image,x,y,E,N", *rows)))
    first, others = notes_of_batch(tmp_path, files="gcps.csv")
    assert first.startswith(f"Note: {tmp_path}/gcps.csv#a: x and y are read")
    assert others.startswith(f"Note: as in {tmp_path}/gcps.csv#a, so in 2 further images: x and y")


def test_tables_of_one_name_in_several_folders_are_counted(tmp_path: Path) -> None:
    for name in ("north", "south"):
        (tmp_path / name).mkdir()
        write_tables(tmp_path / name, "a", "id,E,N,x,y")
    first, others = notes_of_batch(tmp_path, files="*/a.csv")
    assert first.startswith(f"Note: {tmp_path}/north/a.csv: x and y are read")
    assert "so in 1 further image: x and y" in others


def test_warnings_of_many_images_are_all_said(tmp_path: Path) -> None:
    write_tables(tmp_path, "ab", "id,line,sample,x,y,rolle", "{0},{1},{2},{3},control")
    done = invoke("compare", "--points", tmp_path / "*.csv", "--crs", "EPSG:32633", "--method",
                  "affine", "--out", tmp_path / "out", "--quiet")
    warned = [line for line in done.stderr.splitlines() if line.startswith("Warning: ")]
    assert [f"/{name}.csv: column 'rolle' of" in warning
            for name, warning in zip("ab", warned, strict=True)] == [True, True]


def test_messages_outside_a_study_stay_as_they_are(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("INFO", logger="termsel"):
        logging.getLogger("termsel.io.export").warning("Warning: %d px", 3)
    assert caplog.messages == ["Warning: 3 px"]


@pytest.mark.parametrize(("page", "says_which_package"), [
    (None, True), (lambda study: "<html>", False)])
def test_the_text_of_images_is_their_own(
        monkeypatch: pytest.MonkeyPatch, page: Callable[[Study], str] | None,
        says_which_package: bool) -> None:
    def of_searches(study: Study) -> str:
        raise AssertionError("images are no searches")

    output = outputs.StudyOutput((), lambda study, out: (), of_searches, page)
    monkeypatch.setattr(outputs, "values_of_slot", lambda slot: [output])
    text = outputs.study_summary(Study(Spec(strategies=("auto",)), {}, {}, None))
    assert ("A page of all images comes with the package termsel-studies, which " in text) \
        == says_which_package


def test_a_package_that_cannot_be_loaded_is_not_called_missing(
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("termsel.core.isolation.parts.distribution", lambda name: name)
    error = missing_package_error("study", "the page of a study requires")
    assert "termsel-studies, which is installed, but cannot be loaded" in str(error)
    assert "termsel plugins says why" in str(error)
