"""Points and images of a series are paired by their names, and a map that is mirrored is named."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from termsel.data import image_files

pytest.importorskip("rasterio")
Call = Callable[..., SimpleNamespace]


@pytest.fixture(scope="module")
def files(example_files: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Path(shutil.copytree(example_files, tmp_path_factory.mktemp("example") / "files"))


@pytest.mark.slow_cases("scan.tif-False", "sheet-1.tif-True", "sheet-four.tif-False")
@pytest.mark.parametrize(("image", "is_doubted"), [
    ("sheet-4.tif", False), ("sheet-1.tif", True), ("Sheet-04.tif", True), ("scan.tif", False),
    ("sheet-four.tif", False)])
def test_an_image_of_another_number_is_doubted(files: Path, tmp_path: Path, call: Call, image: str,
                                               is_doubted: bool) -> None:
    shutil.copy(files / "maps" / "sheet-4.tif", tmp_path / image)
    points = files / "maps" / "sheet-4.points"
    doubt = f"the points are of sheet-4.points, and the image is {image}."
    done = call("run", points, tmp_path / image, "--out", tmp_path / "result")
    assert done.exit_code == 0
    assert (doubt in done.stderr) == is_doubted
    done = call("rectify", tmp_path / "result", tmp_path / image, "-o", tmp_path / "map.tif")
    assert done.exit_code == 0
    assert (doubt in done.stderr) == is_doubted


def test_another_image_than_that_of_the_run_is_doubted(files: Path, tmp_path: Path,
                                                       call: Call) -> None:
    """Whatever it is called: of the same size in px, so that nothing else shows it."""
    scan = tmp_path / "scan.tif"
    shutil.copy(files / "maps" / "sheet-4.tif", scan)
    other = tmp_path / "elsewhere" / "scan.tif"
    other.parent.mkdir()
    shutil.copy(files / "maps" / "sheet-1.tif", other)
    moved = tmp_path / "moved.tif"
    shutil.copy(scan, moved)
    with_image, without = tmp_path / "with", tmp_path / "without"
    points = files / "maps" / "sheet-4.points"
    assert call("run", points, "--image", scan, "--out", with_image).exit_code == 0
    assert call("run", points, "--out", without).exit_code == 0
    for result, image, doubt in (
            (with_image, scan, ""), (with_image, moved, ""),
            (with_image, other, "scan.tif is another file than the image of the run"),
            (without, other, "")):
        done = [call("rectify", result, image, "-o", tmp_path / "map.tif", "--overwrite"),
                call("export", result, "--to", "gcp-vrt", "--image", image, "-o",
                     tmp_path / "map.vrt", "--overwrite")]
        for command in done:
            assert command.exit_code == 0, command.stderr
            assert ("is another file" in command.stderr) == bool(doubt)
            assert doubt in command.stderr
    record = json.loads((with_image / "result.json").read_text("utf-8"))
    assert record["data"]["read"]["image"]["size"] == scan.stat().st_size


def test_the_ends_of_a_large_image_are_recognised(tmp_path: Path,
                                                  monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(image_files, "WHOLE", 100)
    monkeypatch.setattr(image_files, "AT_EACH_END", 40)
    path = tmp_path / "a.tif"
    digests = []
    for content in (bytes(300), b"a" + bytes(299), bytes(299) + b"a", bytes(301)):
        path.write_bytes(content)
        digests.append(image_files.image_file_of(path))
    assert len({(one.size, one.digest) for one in digests if one}) == len(digests)
    assert image_files.image_file_of(tmp_path) is None


def test_lines_from_the_lower_edge_are_named_with_a_remedy_that_helps(
        files: Path, tmp_path: Path, call: Call) -> None:
    with (files / "gcps.csv").open() as file:
        declared, header, *rows = list(csv.reader(file))
    line = header.index("line")
    for row in rows:
        row[line] = str(499 - float(row[line]))
    with (tmp_path / "bottom.csv").open("w", newline="") as file:
        csv.writer(file).writerows([declared, header, *rows[:40]])
    image = files / "scene.tif"
    words = ("run", tmp_path / "bottom.csv", "--out", tmp_path / "result")
    done = call(*words)
    assert done.exit_code == 0
    screen = " ".join(done.stdout.split())
    assert "Caution Line numbers grow to the north, so that a map would be mirrored" in screen
    assert "add --set image_origin=bottom-left --image FILE" in screen
    done = call("rectify", tmp_path / "result", image, "--height", 1800, "-o", tmp_path / "map.tif")
    assert "a map would be mirrored" in done.stderr
    done = call("export", tmp_path / "result", "--to", "gcp-vrt", "-o", tmp_path / "map.vrt")
    assert "a map would be mirrored" in done.stderr
    # As the remedy says.
    done = call(*words, "--set", "image_origin=bottom-left", "--image", image, "--overwrite")
    assert "mirrored" not in done.stdout
    done = call("rectify", tmp_path / "result", image, "--height", 1800, "-o", tmp_path / "map.tif",
                "--overwrite")
    assert done.exit_code == 0
    assert "mirrored" not in done.stderr
