"""Heights that an RPC does not have, images given as rasters of heights, far control."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import termsel
from termsel.fitting.accuracy import pixel_on_ground

needs_rpc = pytest.mark.skipif(find_spec("termsel_rpc") is None, reason="corrects the RPC")

Call = Callable[..., SimpleNamespace]


@pytest.fixture(scope="module")
def files(example_files: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Path(shutil.copytree(example_files, tmp_path_factory.mktemp("heights") / "files"))


def _points(files: Path, name: str, every: int, change: Callable[[list[str]], list[str]]) -> Path:
    """Write every n-th control point of the example, each changed, and return the file."""
    comment, header, *rows = (files / "gcps.csv").read_text().splitlines()
    changed = [",".join(change(row.split(","))) for row in rows[::every]]
    path = files / name
    path.write_text("\n".join([comment, header, *changed]) + "\n")
    return path


@needs_rpc
@pytest.mark.slow_cases("10--500.0", "10-11000.0")
@pytest.mark.parametrize("height", [0.0, -500.0, 11000.0])
@pytest.mark.parametrize("every", [10, 40])
def test_heights_far_outside_those_of_the_rpc_are_named(
        files: Path, call: Call, height: float, every: int) -> None:
    points = _points(files, "far.csv", every, lambda row: [*row[:-1], f"{height}"])
    done = call("run", points, files / "vendor.RPB")
    assert done.exit_code == 0, done.stderr
    shown = " ".join(done.stdout.split())
    assert (f"he heights of the control, {height:,.0f} m (median), are outside those of the RPC, "
            "1,500 to 2,200 m: check their unit and sign") in shown
    # They move the points in the image; that looks like another part of it.
    assert "rpc_offset" not in shown
    assert "swapped" not in shown


@needs_rpc
def test_heights_of_the_rpc_get_no_word(files: Path, call: Call) -> None:
    points = _points(files, "usual.csv", 10, lambda row: row)
    assert "outside those" not in call("run", points, files / "vendor.RPB").stdout


@pytest.mark.parametrize(("bands", "exit_code", "words"), [
    (1, 0, "stores 8-bit values (0 to 255), as an image does"),
    (3, 2, "8-bit bands are those of an image: give a raster of heights (a DEM)")])
def test_an_image_given_as_raster_of_heights_is_named(
        files: Path, call: Call, bands: int, exit_code: int, words: str) -> None:
    rasterio = pytest.importorskip("rasterio")
    with rasterio.open(files / "dem.tif") as dem:
        profile = {**dem.profile, "dtype": "uint8", "count": bands}
        grey = (dem.read(1) % 250).astype(np.uint8)
    image = files / f"grey{bands}.tif"
    with rasterio.open(image, "w", **profile) as raster:
        raster.write(np.repeat(grey[None], bands, axis=0))
    points = _points(files, "no-heights.csv", 9, lambda row: [*row[:-1], ""])
    done = call("run", points, "--dem", image)
    assert done.exit_code == exit_code
    assert words in done.stderr
    # Where all heights are known, none is taken.
    assert bands > 1 or "8-bit" not in call("run", files / "gcps.csv", "--dem", image).stderr


@needs_rpc
@pytest.mark.parametrize(("shift", "is_known"), [(1.0, False), (0.0, True)])
def test_no_metres_stand_by_a_model_that_a_wrong_point_bends(files: Path, shift: float,
                                                             is_known: bool) -> None:
    def move(row: list[str]) -> list[str]:
        return [*row[:-2], str(float(row[-2]) + shift * (row[0] == "C27")), row[-1]]

    # A run would reject the point.
    bent = termsel.fit(termsel.read(_points(files, "moved.csv", 3, move)), "regularised-cubic")
    assert (pixel_on_ground(bent) is not None) == is_known


def _in_ed50(files: Path, kind: str) -> list[object]:
    """Write control of the example without heights in EPSG:2059, and return how a run reads it."""
    pyproj = pytest.importorskip("pyproj")
    to_ed50 = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:2059", always_xy=True)
    points = termsel.read(files / "gcps.csv").points.take(range(0, 60, 3))
    xy = np.column_stack(to_ed50.transform(*points.ground[:, :2].T))
    rows = np.column_stack([points.image, xy]).round(4).astype(str)
    if kind == "points":
        table = ["id,line,sample,x,y", *(f"p{i},{','.join(row)}" for i, row in enumerate(rows))]
    else:
        # A line through the points i and i + 1.
        table = ["id,line1,sample1,line2,sample2,x1,y1,x2,y2"]
        table += [f"l{i},{','.join([*a[:2], *b[:2], *a[2:], *b[2:]])}"
                  for i, (a, b) in enumerate(pairwise(rows))]
    path = files / f"ed50-{kind}.csv"
    path.write_text("\n".join(["# crs: EPSG:2059", *table]) + "\n")
    return [f"--{kind}", path]


@pytest.mark.slow_cases("points")
@needs_rpc
@pytest.mark.parametrize("kind", ["points", "lines"])
def test_heights_that_count_from_another_ellipsoid_are_named_with_what_they_do_to_an_rpc(
        files: Path, tmp_path: Path, call: Call, kind: str) -> None:
    rasterio = pytest.importorskip("rasterio")
    control = _in_ed50(files, kind)
    declared = tmp_path / "declared.tif"
    declared.write_bytes((files / "dem.tif").read_bytes())
    with rasterio.open(declared, "r+") as raster:
        raster.update_tags(VERTICAL_DATUM="ellipsoid")
    screens = {}
    for dem in (files / "dem.tif", declared):
        out = tmp_path / dem.stem
        done = call("run", *control, "--rpc", files / "vendor.RPB", "--dem", dem, "--out", out)
        assert done.exit_code == 0, done.stderr
        screens[dem.stem] = " ".join(done.stdout.split())
        exported = call("export", out, "--to", "rpc-txt", "-o", tmp_path / f"{dem.stem}_RPC.TXT")
        screens[dem.stem] += " ".join(exported.stderr.split())
    named = "count from the ellipsoid of EPSG:2059, 33"
    assert screens["dem"].count(named) == 2
    effect = " m above that of WGS84 here: if they are heights above the latter, an RPC is wrong "
    assert effect in screens["dem"]
    assert "geoid" not in screens["dem"].replace("for that geoid", "")
    assert "count from" not in screens["declared"]
