"""Files that are written while a signal comes or the disk is full.

``python tests/core/test_interrupted_writing.py SCENARIO FOLDER`` does what the first test reads. A
child is forked for each point: before a file is opened for writing, synced, renamed or removed,
before a folder is made, and where a write goes beyond a number of bytes. There it is interrupted in
each of `WAYS`, or the change fails as on a full disk. A line is printed for each point: the way,
how the child ended, and what is found then.
"""

from __future__ import annotations

import errno
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from itertools import groupby
from pathlib import Path
from tempfile import TemporaryDirectory
from traceback import print_exc
from typing import Any

import numpy as np
import pytest

import termsel
from termsel.core.errors import TermselError
from termsel.core.files import atomic
from termsel.core.files.atomic import write_text
from termsel.data.rasters import tiff_bytes
from termsel.formats.writers.grids import GeolocationVrt
from termsel.io.result_folder import lock_output_folder, read_result, write_result
from termsel.testing import example_results
from termsel_formats.maps.residuals import ResidualsGeopackage

WAYS = {"SIGKILL": "-9", "SIGTERM": "-15", "SIGINT": "interrupted", "ENOSPC": "refused",
        "SIGXFSZ": "-25", "EFBIG": "refused"}
"""How a child is stopped, and how it must end. The last two limit the size of files."""

CHANGES = {"os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.chmod", "os.chown"}
UNREACHED, ENDINGS = 0, {10: "went on", 11: "refused", 12: "interrupted"}
STEP = 2999
"""Bytes from one limit to the next."""


@dataclass(frozen=True)
class Scenario:
    """What is written, and what may be found afterwards.

    Parameters
    ----------
    prepare : callable
        Fills a new folder.
    write : callable
        Takes the folder; what is interrupted.
    look : callable
        Returns what is there: "old", "new", or what is wrong.
    names : set of str
        Files that may be there after the next undisturbed write.
    count : int
        How many of them are there.
    """

    prepare: Callable[[Path], object]
    write: Callable[[Path], object]
    look: Callable[[Path], str]
    names: frozenset[str]
    count: int


def scenario_of(name: str) -> Scenario:
    """Return one scenario, as what the others write takes a second to make."""
    if name == "file":
        return Scenario(
            lambda folder: write_text(folder / "mine.txt", "old"),
            lambda folder: write_text(folder / "mine.txt", "new " * 5000),
            lambda folder: (folder / "mine.txt").read_text()[:3], frozenset({"mine.txt"}), 1)
    if name == "map":
        return Scenario(_first_map, partial(_map, 9.0), _map_in, frozenset({"map.tif"}), 1)
    if name == "grid":
        grids = [GeolocationVrt(step=step, height=0.0) for step in (2000, 1000)]
        return Scenario(lambda folder: grids[0].write(_flat(), folder / "s.vrt"),
                        lambda folder: grids[1].write(_flat(), folder / "s.vrt"), _grid_in,
                        frozenset({"s.vrt", "s_xy.tif", "s_xy_2.tif"}), 2)
    if name == "GeoPackage":
        tables = [ResidualsGeopackage(exaggeration=times) for times in (1, 2)]
        return Scenario(lambda folder: tables[0].write(_flat(), folder / "r.gpkg"),
                        lambda folder: tables[1].write(_flat(), folder / "r.gpkg"), _table_in,
                        frozenset({"r.gpkg"}), 1)
    old, new = _results()

    def run(result: Any, folder: Path) -> None:
        with lock_output_folder(folder, overwrite=True):
            write_result(result, folder)

    def result_in(folder: Path) -> str:
        known = {old.to_json(): "old", new.to_json(): "new"}
        try:
            return known[read_result(folder).to_json()]
        except TermselError as error:
            return "old" if "there is no result here" in str(error) else str(error)

    prepare = partial(run, old) if name == "next result" else (lambda folder: None)
    return Scenario(prepare, partial(run, new), result_in, frozenset(
        {"result.json", "residuals.csv", "summary.txt", "points.csv"}), 4)


@cache
def _results() -> tuple[termsel.Result, termsel.Result]:
    old, new = example_results()[:2]
    return old, new


@cache
def _flat() -> termsel.Result:
    """Return the result of a plane in no CRS."""
    xy = np.random.default_rng(1).uniform(0.0, 8000.0, (20, 2))
    return termsel.run("poly-terms", strategy="as-asked", model="affine", solver="all-terms",
                       features=termsel.FeatureSet(termsel.Points(
                           tuple(map(str, range(20))), xy, np.column_stack([xy, 0 * xy[:, 0]])),
                           crs="local", image_size=(8001, 8001)))


@cache
def _image() -> tuple[termsel.Result, bytes]:
    """Return the result of a small image in a CRS, and the image."""
    rng = np.random.default_rng(2)
    pixels = rng.integers(1, 255, (1, 100, 100)).astype(np.uint8)
    image = rng.uniform(0.0, 99.0, (20, 2))
    ground = np.column_stack([5e5 + 10 * image[:, 1], 4e6 - 10 * image[:, 0], 0 * image[:, 0]])
    features = termsel.FeatureSet(termsel.Points(tuple(map(str, range(20))), image, ground),
                                  crs="EPSG:32639", image_size=(100, 100))
    return termsel.run("poly-terms", strategy="as-asked", model="affine", solver="all-terms",
                       features=features), tiff_bytes(pixels)


def _first_map(folder: Path) -> None:
    folder.with_suffix(".tif").write_bytes(_image()[1])
    _map(6.0, folder)


def _map(resolution: float, folder: Path) -> None:
    termsel.rectify(_image()[0], folder.with_suffix(".tif"), folder / "map.tif",
                    height=0.0, resolution=resolution, overwrite=True)


def _map_in(folder: Path) -> str:
    """Return which map is there, if all of its pixels can be read."""
    import rasterio

    with rasterio.open(folder / "map.tif") as raster:
        if not raster.read(1).any():
            return "an empty map"
        return {6.0: "old", 9.0: "new"}[raster.res[0]]


def _table_in(folder: Path) -> str:
    """Return which GeoPackage is there, if it is whole."""
    from pyogrio.raw import read

    for layer in ("residuals", "vectors"):
        names, _, _, columns = read(str(folder / "r.gpkg"), layer=layer)
        if len(columns[0]) != 20:
            return f"{len(columns[0])} rows of {layer}"
    return {1.0: "old", 2.0: "new"}[columns[list(names["fields"]).index("exaggeration")][0]]


def _grid_in(folder: Path) -> str:
    """Return which grid GDAL finds by the VRT."""
    import rasterio

    with rasterio.open(folder / "s.vrt") as vrt:
        place = vrt.tags(ns="GEOLOCATION")
        step, width = int(place["PIXEL_STEP"]), vrt.width
    with rasterio.open(folder / place["X_DATASET"]) as grid:
        if grid.width != len(range(-step, width + 2 * step, step)):
            return f"a grid {grid.width} wide with a VRT of the step {step}"
    return {2000: "old", 1000: "new"}[step]


def _child(work: Callable[[], bool]) -> int:
    """Return how a child ends: its exit code, or minus the signal; `work` tells if it went on."""
    pid = os.fork()
    if pid:
        return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    code = 1
    try:
        code = 10 if work() else UNREACHED
    except TermselError:
        code = 11
    except KeyboardInterrupt:
        code = 12
    except BaseException:
        print_exc()
        raise
    finally:
        os._exit(code)


def at_point(write: Callable[[], object], point: int, way: str) -> bool:
    """Write, stopped before the n-th change."""
    count = 0

    def change() -> None:
        nonlocal count
        count += 1
        if count == point + 1:
            if way == "ENOSPC":
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            os.kill(os.getpid(), getattr(signal, way))

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if event in CHANGES or (event == "open" and arguments[1] not in (None, "r", "rb")):
            change()

    fsync = os.fsync

    def sync(fd: Any) -> None:
        change()
        fsync(fd)

    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.fsync = sync
    sys.addaudithook(hook)
    write()
    return count > point


def at_size(write: Callable[[], object], point: int, way: str) -> bool:
    """Write, stopped where a file grows beyond a size."""
    import resource  # not on Windows

    signal.signal(signal.SIGXFSZ, signal.SIG_DFL if way == "SIGXFSZ" else signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (point * STEP, resource.RLIM_INFINITY))
    write()
    return False


def main(name: str, top: Path) -> None:
    scenario = scenario_of(name)
    for way in WAYS:
        stopped = at_size if way in ("SIGXFSZ", "EFBIG") else at_point
        point, code = 0, -1
        while code != UNREACHED:
            folder = top / f"{way}-{point}"
            folder.mkdir()
            scenario.prepare(folder)
            code = _child(partial(stopped, partial(scenario.write, folder), point, way))
            ending = "ended" if code == UNREACHED else ENDINGS.get(code, code)
            print(f"{way}: {ending}: {scenario.look(folder)}")
            scenario.write(folder)
            left = {path.name for path in folder.iterdir()}
            if scenario.look(folder) != "new" or not left <= scenario.names or (
                    len(left) != scenario.count):
                print(f"{way}: the next one: {scenario.look(folder)}, {sorted(left)}")
            point += 1


POINTS = {"file": 8, "first result": 18, "next result": 26, "grid": 14, "GeoPackage": 9,
          "map": 9}
"""At how many points each scenario is at least interrupted by a signal."""

on_posix = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")


@pytest.mark.slow_cases("GeoPackage", "first result", "grid", "map", "next result")
@on_posix
@pytest.mark.parametrize("scenario", POINTS)
def test_an_interrupt_leaves_what_was_there_or_what_is_new(scenario: str) -> None:
    # In memory, as it is synced thousands of times.
    memory = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with TemporaryDirectory(dir=memory) as folder:
        done = subprocess.run(
            [sys.executable, "-W", "ignore", __file__, scenario, folder],
            capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    lines = [line.split(": ", 2) for line in done.stdout.splitlines()]
    for way, group in groupby(lines, key=lambda line: line[0]):
        endings, found = zip(*(line[1:] for line in group), strict=True)
        # A sync of a folder, and the removal of what is temporary, may fail without harm.
        harmless = {ENDINGS[10]} if way == "ENOSPC" else set()
        assert set(endings[:-1]) - harmless == {WAYS[way]}, (way, endings)
        assert endings[-1] == "ended"
        assert set(found) == {"old", "new"}, (way, found)
        if way != "ENOSPC":
            assert list(found) == sorted(found, reverse=True), (way, found)
        if way.startswith("SIG") and way != "SIGXFSZ":
            assert len(found) > POINTS[scenario], way
    assert {line[0] for line in lines} == set(WAYS)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of one megabyte."""
    words = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(tmp_path)]
    if not hasattr(os, "geteuid") or os.geteuid() or shutil.which("mount") is None \
            or subprocess.run(words, capture_output=True, check=False).returncode:
        pytest.skip("only root may mount a disk in memory")
    yield tmp_path
    subprocess.run(["umount", str(tmp_path)], check=True)


def _fill(disk: Path, left: int) -> Path:
    """Write a file until so many bytes are left on a disk."""
    filler = disk / "filler"
    with suppress(OSError), filler.open("wb", buffering=0) as file:
        while True:
            file.write(bytes(1024))
    os.truncate(filler, filler.stat().st_size - left)
    return filler


@pytest.mark.slow_cases("map")
@pytest.mark.parametrize("scenario", POINTS)
def test_a_full_disk_leaves_what_was_there(scenario: str, small_disk: Path,
                                           monkeypatch: pytest.MonkeyPatch) -> None:
    one = scenario_of(scenario)
    temporary = small_disk / "tmp"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    endings = []
    for number, pages in enumerate((0, 1, 2, 4, 9, 120)):
        folder = small_disk / str(number)
        folder.mkdir()
        one.prepare(folder)
        before = one.look(folder)
        filler = _fill(small_disk, 4096 * pages)
        try:
            one.write(folder)
        except TermselError:
            endings.append("refused")
            assert one.look(folder) == before
            assert {path.name for path in folder.iterdir()} <= one.names
        else:
            endings.append("new")
            assert one.look(folder) == "new"
        assert not list(temporary.iterdir())
        filler.unlink()
        one.write(folder)
        assert one.look(folder) == "new"
        shutil.rmtree(folder)
    assert endings == sorted(endings, reverse=True)
    assert {"refused", "new"} == set(endings)


def test_a_map_that_gdal_did_not_write_whole_is_refused(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import rasterio.shutil

    def loses(source: Path, target: Path, **how: Any) -> None:
        copied(source, target, **how)
        if how["driver"] != "COG":
            return
        with rasterio.open(target, "r+", IGNORE_COG_LAYOUT_BREAK="YES") as raster:
            raster.write(raster.read() // 2)

    copied = rasterio.shutil.copy
    folder = tmp_path / "folder"
    folder.mkdir()
    _first_map(folder)
    monkeypatch.setattr(rasterio.shutil, "copy", loses)
    with pytest.raises(TermselError, match="read back is not the one that was written"):
        _map(9.0, folder)
    assert _map_in(folder) == "old"


def test_a_result_that_cannot_be_encoded_leaves_the_earlier_one(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    old, new = example_results()[:2]
    write_result(old, tmp_path)

    def fails(self: termsel.Result) -> str:
        raise UnicodeEncodeError("utf-8", "x", 0, 1, "surrogates")

    monkeypatch.setattr(termsel.Result, "to_json", fails)
    with pytest.raises(UnicodeEncodeError):
        write_result(new, tmp_path)
    monkeypatch.undo()
    assert read_result(tmp_path).to_json() == old.to_json()
    assert not list(tmp_path.glob(".*"))


def test_a_sync_that_fails_keeps_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                              ) -> None:
    path = tmp_path / "mine.txt"
    path.write_text("old")

    def fails(descriptor: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(os, "fsync", fails)
    with pytest.raises(termsel.TermselError, match=r"mine\.txt: cannot write this file: Input"):
        write_text(path, "new")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


@on_posix
@pytest.mark.parametrize("mode", [0o600, 0o640, 0o777, 0o444])
def test_a_file_that_is_replaced_keeps_its_permissions(mode: int, tmp_path: Path) -> None:
    path = tmp_path / "mine.txt"
    path.write_text("old")
    path.chmod(mode)
    write_text(path, "new")
    assert path.read_text() == "new"
    assert path.stat().st_mode & 0o7777 == mode


@on_posix
def test_files_of_a_result_that_is_replaced_keep_their_permissions(tmp_path: Path) -> None:
    old, new = example_results()[:2]
    write_result(old, tmp_path)
    for path in tmp_path.iterdir():
        path.chmod(0o600)
    write_result(new, tmp_path)
    assert {path.stat().st_mode & 0o7777 for path in tmp_path.iterdir()} == {0o600}
    assert len(list(tmp_path.iterdir())) == 4


@on_posix
def test_a_new_file_has_the_permissions_of_any_other(tmp_path: Path) -> None:
    (tmp_path / "any").write_text("x")
    write_text(tmp_path / "new", "x")
    assert (tmp_path / "new").stat().st_mode == (tmp_path / "any").stat().st_mode


@on_posix
def test_what_a_killed_process_left_is_removed_at_the_next_write(tmp_path: Path) -> None:
    def left(process: int) -> Path:
        folder = tmp_path / f"{atomic._PREFIX}{atomic._machine_word()}-{process}-0123456789ab"
        folder.mkdir()
        (folder / "half.tif").write_text("half")
        return folder

    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    mine, of_another, gone = left(os.getpid()), left(os.getppid()), left(ended.pid)
    foreign = tmp_path / f"{atomic._PREFIX}ffffffff-{ended.pid}-0123456789ab"
    foreign.mkdir()
    write_text(tmp_path / "new", "x")
    assert set(tmp_path.iterdir()) == {tmp_path / "new", mine, of_another, foreign}
    assert not gone.exists()


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
