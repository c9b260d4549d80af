"""Points and images of a series are paired by their names, and a map that is mirrored is named."""

from __future__ import annotations

import csv
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from termsel.toolkit.files import write_example

pytest.importorskip("rasterio")
Call = Callable[..., SimpleNamespace]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("example") / "files"
    write_example(folder)
    return folder


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
    # As the remedy says.
    done = call(*words, "--set", "image_origin=bottom-left", "--image", image, "--overwrite")
    assert "mirrored" not in done.stdout
    done = call("rectify", tmp_path / "result", image, "--height", 1800, "-o", tmp_path / "map.tif",
                "--overwrite")
    assert done.exit_code == 0
    assert "mirrored" not in done.stderr
