"""Names of files that are long, locked, circular, not UTF-8 or pipes; shapes without geometry."""

from __future__ import annotations

import ctypes
import json
import logging
import os
import shutil
import sqlite3
import stat
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from termsel.data.features import Points
from termsel.formats.readers.csv_tables import write_points_csv
from termsel.io.result_folder import write_result
from termsel.testing import example_results

rasterio = pytest.importorskip("rasterio")

pytestmark = pytest.mark.skipif(os.name == "nt", reason="needs names and pipes of POSIX")

Call = Callable[..., SimpleNamespace]

RUN = ("run --problem poly-terms --strategy as-asked --solver all-terms --set degree=1 "
       "--crs EPSG:4979")
ODD = os.fsdecode(b"stra\xdfe")
"""A name in Latin-1."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a result, tables, an image and a raster of heights."""
    top = tmp_path_factory.mktemp("names")
    (top / "r").mkdir()
    result = example_results()[0]
    write_result(result, top / "r")
    shutil.copy(top / "r" / "points.csv", top / "p.csv")
    assert result.features.image_size is not None
    lines, samples = result.features.image_size
    with rasterio.open(top / "s.tif", "w", driver="GTiff", width=samples, height=lines, count=1,
                       dtype="uint8", sparse_ok=True):
        pass
    with rasterio.open(top / "dem.tif", "w", driver="GTiff", width=4, height=4, count=1,
                       dtype="float32", crs="EPSG:4326",
                       transform=rasterio.transform.from_bounds(7, 46.8, 8, 47.4, 4, 4)) as dem:
        dem.write(np.full((1, 4, 4), 500.0, dtype=np.float32))
    return top


@pytest.fixture
def folder(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a copy of that folder, with odd names in it, as the working folder."""
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    Path("loop").symlink_to("loop")
    os.mkfifo("fifo")
    shutil.copytree("r", "piped")
    Path("piped/points.csv").unlink()
    os.mkfifo("piped/points.csv")
    return tmp_path


LONG = "x" * 300
NO_FILE = {
    "points": f"{RUN} --points NAME",
    "lines": "run --problem owdis-lines --lines NAME --crs EPSG:4979",
    "areas": "run --problem owdis-lines --areas NAME --crs EPSG:4979",
    "image lines": "run --problem owdis-lines --lines p.csv --format geojson-lines "
                   "--image-lines NAME --crs EPSG:4979",
    "heights": f"{RUN} --points p.csv --dem NAME",
    "raster": f"{RUN} --points p.csv --format qgis-points --raster NAME",
    "result of export": "export NAME --to rpb -o new",
    "image of export": "export r --to rpc-vrt -o new --image NAME",
    "heights of export": "export r --to geolocation-vrt -o new --dem NAME",
    "result of project": "project NAME --points p.csv",
    "table of project": "project r --points NAME",
    "result of rectify": "rectify NAME s.tif --height 500 -o new",
    "image of rectify": "rectify r NAME --height 500 -o new",
    "heights of rectify": "rectify r s.tif --dem NAME -o new",
    "points of stability": "stability --problem poly-terms --points NAME --crs EPSG:4979",
}
NOT_READ = {"long": (LONG, "File name too long"), "circular": ("loop", "Too many levels"),
            "pipe": ("fifo", ""), "device": ("/dev/zero", ""), "folder": ("r", "")}


@pytest.mark.parametrize("name", NOT_READ)
@pytest.mark.parametrize("command", NO_FILE.values(), ids=NO_FILE)
def test_what_cannot_be_read_is_named(command: str, name: str, folder: Path, call: Call) -> None:
    given, why = NOT_READ[name]
    if name == "folder" and command.split()[1] == "NAME":
        given = "piped"  # a result with a pipe among its files
    done = call(*(word.replace("NAME", given) for word in command.split()))
    assert done.exit_code == 2, done.stderr
    assert done.stderr.startswith("Error: ")
    assert why in done.stderr or "geojson-lines" in command or "qgis" in command
    assert not Path("new").exists()


@pytest.mark.parametrize(("make", "noun"), [(os.mkdir, "a folder"),
                                            (os.mkfifo, "a pipe or a device")])
def test_what_stands_for_a_file_of_a_result_is_called_what_it_is(
        make: Callable[[str], None], noun: str, folder: Path, call: Call) -> None:
    Path("r/result.json").unlink()
    make("r/result.json")
    done = call("report", "r")
    assert done.exit_code == 2
    assert f"r/result.json: this is {noun}, expected a file. " in done.stderr


WRITES = {
    "run": f"{RUN} --points p.csv --out NAME",
    "export": "export r --to points-csv -o NAME",
    "grid": "export r --to geolocation-vrt --set step=200 -o NAME",
    "project": "project r --points p.csv -o NAME",
    "rectify": "rectify r s.tif --height 500 -o NAME",
    "stability": "stability --problem poly-terms --points p.csv --crs EPSG:4979 --out NAME",
}


@pytest.mark.parametrize("name", [LONG, "loop", "p.csv/x", "fifo", "/dev/null"])
@pytest.mark.parametrize("command", WRITES.values(), ids=WRITES)
def test_what_cannot_be_written_is_named(command: str, name: str, folder: Path, call: Call,
                                         ) -> None:
    done = call(*(word.replace("NAME", name) for word in command.split()), *(
        ["--overwrite"] if "-o" in command.split() else []))
    assert done.exit_code == 2, done.stderr
    assert done.stderr.splitlines()[-1].startswith("Error: ")
    assert name[:40] in done.stderr
    assert Path("loop").is_symlink()
    assert stat.S_ISFIFO(Path("fifo").stat().st_mode)


@pytest.mark.parametrize("command", ["export r --to points-csv -o NAME",
                                     "rectify r s.tif --height 500 --res 500 -o NAME"])
def test_the_longest_name_can_be_written(command: str, folder: Path, call: Call) -> None:
    name = "y" * 251 + (".csv" if "points-csv" in command else ".tif")
    done = call(*(word.replace("NAME", name) for word in command.split()))
    assert done.exit_code == 0, done.stderr
    assert Path(name).is_file()


LOCKED = {
    **{f"{name}, read": command for name, command in NO_FILE.items()
       if name not in ("image lines", "raster")},
    **{f"{name}, written": command for name, command in WRITES.items()},
}

IN_TURN = """
import contextlib, io, json, sys
from termsel.cli.main import cli
for command in json.loads(sys.argv[1]):
    said = io.StringIO()
    with contextlib.redirect_stderr(said):
        try:
            cli.main(command.split(), prog_name="termsel")
        except SystemExit as stop:
            code = stop.code
        except BaseException as error:
            code = repr(error)
    print(json.dumps([command, code, said.getvalue()]))
"""


def _without_power() -> None:
    """Drop the capabilities by which the superuser passes permissions, from the next exec on."""
    bounding_set_drop, overrides = 24, (1, 2)  # linux/prctl.h, linux/capability.h
    for one in overrides:
        ctypes.CDLL(None).prctl(bounding_set_drop, one, 0, 0, 0)


@pytest.mark.slow
def test_a_folder_without_permission_is_named(folder: Path) -> None:
    if os.geteuid() == 0 and sys.platform != "linux":
        pytest.skip("only Linux can take from the superuser what passes permissions")
    shutil.copytree("r", "locked/in")
    Path("locked").chmod(0o600)
    commands = [command.replace("NAME", "locked/in") for command in LOCKED.values()]
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", IN_TURN, json.dumps(commands)],
                          capture_output=True, text=True, check=False, timeout=120,
                          preexec_fn=_without_power if os.geteuid() == 0 else None)
    Path("locked").chmod(0o700)
    assert done.returncode == 0, done.stderr
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert [row[0] for row in rows] == commands
    for command, code, said in rows:
        assert code == 2, (command, code)
        assert "locked/in" in said, command
        assert "ermission" in said, command


@pytest.mark.slow
def test_names_that_are_not_utf8_work(folder: Path, call: Call,
                                      monkeypatch: pytest.MonkeyPatch) -> None:
    # Reports of tests hold what is logged, and cannot be sent with such names in it.
    monkeypatch.setattr(logging.getLogger("termsel"), "propagate", False)
    for old, new in (("p.csv", f"{ODD}.csv"), ("s.tif", f"{ODD}.tif"), ("dem.tif", f"{ODD}-d.tif")):
        Path(old).rename(new)
    done = call(*RUN.split(), "--points", f"{ODD}.csv", "--out", f"{ODD}-r", "--export",
                "points-csv", "--export", "rpc-txt")
    assert done.exit_code == 0, done.stderr
    record = json.loads(Path(f"{ODD}-r/result.json").read_text(encoding="utf-8"))
    assert record["data"]["source"] == r"stra\udcdfe.csv"
    assert "stra" in Path(f"{ODD}-r/summary.txt").read_text(encoding="utf-8")
    for to in [writer["name"] for writer in json.loads(call("list", "writers", "--json").stdout)
               if writer["name"] not in ("lines-csv", "georeference-annotation")]:
        done = call("export", f"{ODD}-r", "--to", to, "-o", f"{ODD}.{to}", "--image", f"{ODD}.tif",
                    "--dem", f"{ODD}-d.tif", "--set", "step=1000")
        if to.endswith("-vrt"):
            assert done.exit_code == 2
            assert "not UTF-8, which no virtual raster can represent" in done.stderr
            assert not Path(f"{ODD}.{to}").exists()
        else:
            assert done.exit_code == 0, (to, done.stderr)
            assert Path(f"{ODD}.{to}").is_file()
    for ground in (("--height", "500"), ("--dem", f"{ODD}-d.tif")):
        done = call("rectify", "r", f"{ODD}.tif", *ground, "--res", "500", "-o", f"{ODD}-m.tif",
                    "--overwrite")
        assert done.exit_code == 0, done.stderr
    done = call("project", "r", "--points", f"{ODD}.csv", "-o", f"{ODD}-p.csv")
    assert done.exit_code == 0, done.stderr
    done = call("project", "r", "--points", f"{ODD}-none.csv")
    assert done.exit_code == 2
    assert "this file does not exist" in done.stderr
    assert not list(folder.glob(".termsel*"))


def many(path: Path) -> int:
    """Write a table that is larger than what readers look at first, and than a pipe holds."""
    n, rng = 1500, np.random.default_rng(5)
    ground = rng.uniform([7.4, 47.0, 400.0], [7.6, 47.2, 600.0], (n, 3))
    image = 4000.0 * (ground[:, 1::-1] - [47.1, 7.5]) / 0.1 + rng.normal(0, 0.3, (n, 2))
    write_points_csv(Points(tuple(f"a-long-name-{i}" for i in range(n)), image, ground), path)
    return n


PIPES = {
    "run": (f"{RUN} --json --points <(cat many.csv)", 0),
    "run, stdin": (f"{RUN} --json --points /dev/stdin < <(cat many.csv)", 0),
    "project": ("project r --points <(sleep 1; cat many.csv)", 2),
    "project, stdin of a file": ("project r --points /dev/stdin < many.csv", 2),
}
"""Commands, and the lines before the points that they print as a table; 0 where that is JSON."""


@pytest.mark.slow
@pytest.mark.parametrize(("command", "before"), PIPES.values(), ids=PIPES)
def test_a_pipe_is_read_once_and_whole(command: str, before: int, folder: Path) -> None:
    bash = shutil.which("bash")
    if bash is None:
        pytest.skip("needs bash")
    n = many(Path("many.csv"))
    done = subprocess.run([bash, "-c", f"'{sys.executable}' -m termsel {command}"],
                          capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    found = (len(done.stdout.splitlines()) - before if before
             else sum(json.loads(done.stdout)["data"]["counts"].values()))
    assert found == n


@pytest.mark.slow
def test_errors_of_a_pipe_name_the_pipe(folder: Path) -> None:
    done = subprocess.run([sys.executable, "-m", "termsel", *RUN.split(), "--points", "/dev/stdin"],
                          input="id,line,sample,x,y,z\na,1,2,3,4,z\n", capture_output=True,
                          text=True, check=False, timeout=120)
    assert done.returncode == 2
    assert "Error: /dev/stdin, line 2, column 'z': 'z' is not a number" in done.stderr


def test_a_geopackage_without_geometry_is_refused(tmp_path: Path, call: Call) -> None:
    pyogrio = pytest.importorskip("pyogrio")
    path = tmp_path / "table.gpkg"
    pyogrio.raw.write(str(path), None, [np.array(["a", "b"], dtype=object)], ["id"], layer="t",
                      driver="GPKG", geometry_type=None)
    with sqlite3.connect(path) as base:
        assert base.execute("SELECT data_type FROM gpkg_contents").fetchall() == [("attributes",)]
    done = call("run", "--problem", "owdis-lines", "--lines", path, "--crs", "EPSG:4979")
    assert done.exit_code == 2, done.stderr
    assert "has no geometry" in done.stderr
