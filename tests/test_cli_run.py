"""The command `termsel run` as a person types it, above all when the input is bad."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from termsel.formats.readers.csv_tables import write_lines_csv, write_points_csv
from termsel.simulate import simulate_scene

QUICK = ["--generations", "3", "--set", "population=30"]


Call = Callable[..., SimpleNamespace]


def termsel(*words: object) -> subprocess.CompletedProcess[str]:
    """Run termsel in a process of its own."""
    return subprocess.run([sys.executable, "-m", "termsel", *map(str, words)], text=True,
                          capture_output=True, check=False)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("files")
    features = simulate_scene("ikonos-hamedan")
    write_points_csv(features.points, folder / "points.csv")
    write_lines_csv(features.lines, folder / "lines.csv")
    return folder


def test_own_files_run_and_write_the_result(files: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = termsel("run", "--problem", "owdis-lines", "--points", files / "points.csv", "--lines",
                   files / "lines.csv", "--crs", "EPSG:4979", "--out", out, *QUICK)
    assert done.returncode == 0, done.stderr
    assert "RMSE [px]" in done.stdout
    assert (out / "summary.txt").read_text() == done.stdout
    assert json.loads((out / "result.json").read_text())["data"]["counts"]["lines"] == 120


def test_json_is_alone_on_stdout() -> None:
    done = termsel("run", "--problem", "owdis-lines", "--json", *QUICK)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["schema"] == "termsel-result-1"
    for key in ("problem", "model", "solver", "criterion", "seed", "options", "data", "selection",
                "rmse", "baselines", "front", "certificate", "evaluations", "generations",
                "seconds", "coefficients", "scaling", "versions"):
        assert key in result


def test_the_same_command_gives_the_same_selection() -> None:
    command = ["run", "--problem", "rfm-terms", "--seed", "3", "--json", *QUICK]
    first, second = (json.loads(termsel(*command).stdout) for _ in range(2))
    assert first["selection"] == second["selection"]
    assert first["coefficients"] == second["coefficients"]


def test_without_a_terminal_no_bar_is_drawn() -> None:
    assert termsel("run", "--problem", "poly-terms", *QUICK).stderr == ""


def interrupted(process: subprocess.Popen[str]) -> tuple[str, str]:
    """Press Ctrl-C, and again where it is lost, as compilation may drop it."""
    for _ in range(5):
        process.send_signal(signal.SIGINT)
        try:
            return process.communicate(timeout=20)
        except subprocess.TimeoutExpired:
            continue
    process.kill()
    process.wait()
    raise AssertionError("Ctrl-C does not end the run")


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_ctrl_c_returns_the_best_so_far(tmp_path: Path) -> None:
    out = tmp_path / "out"
    process = subprocess.Popen(
        [sys.executable, "-m", "termsel", "run", "--problem", "owdis-lines-terms", "--json",
         "--seconds", "600", "--out", str(out)], text=True, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        # Tests in the background of a script ignore it, and what they start would too.
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL))
    deadline = time.monotonic() + 60
    while not out.is_dir() and time.monotonic() < deadline:
        time.sleep(0.05)
    time.sleep(6)  # the search begins when the folder is claimed; the first run compiles
    stdout, stderr = interrupted(process)
    assert process.returncode == 130
    assert "Interrupted" in stderr
    result = json.loads(stdout)
    assert result["interrupted"]
    assert result["rmse"]["independent"]["total"] > 0
    assert json.loads((out / "result.json").read_text())["interrupted"]


def change(files: Path, tmp_path: Path, line: int, old: str, new: str) -> Path:
    """Return a copy of points.csv in which one cell of one line is other."""
    rows = (files / "points.csv").read_text().splitlines()
    at = next(i for i, row in enumerate(rows) if not row.startswith("#")) + line - 1
    assert old in rows[at]
    rows[at] = rows[at].replace(old, new)
    path = tmp_path / "changed.csv"
    path.write_text("\n".join(rows) + "\n")
    return path


def cells(files: Path, line: int) -> list[str]:
    rows = [r for r in (files / "points.csv").read_text().splitlines() if not r.startswith("#")]
    return rows[line - 1].split(",")


def straight_line(files: Path, tmp_path: Path) -> Path:
    rows = ["id,role,line,sample,x,y,z"]
    rows += [f"P{i},,{i * 10},{i * 7},{48 + i / 1000},{34 + i / 1000},{1800 + i}"
             for i in range(30)]
    path = tmp_path / "straight.csv"
    path.write_text("\n".join(rows) + "\n")
    return path


def some_points(files: Path, tmp_path: Path, n: int) -> Path:
    rng = np.random.default_rng(0)
    rows = ["id,line,sample,x,y,z"]
    rows += [f"P{i},{rng.uniform(0, 999)},{rng.uniform(0, 999)},{rng.uniform(48, 49)},"
             f"{rng.uniform(34, 35)},{rng.uniform(0, 99)}" for i in range(n)]
    path = tmp_path / "some.csv"
    path.write_text("\n".join(rows) + "\n")
    return path


def written(tmp_path: Path, data: bytes) -> Path:
    path = tmp_path / "bad.csv"
    path.write_bytes(data)
    return path


BAD_FILES = {
    "missing column": (
        lambda f, t: written(t, b"id,line,sample,x,z\nA,1,2,3,4\n"), "y"),
    "text in a number": (
        lambda f, t: change(f, t, 5, cells(f, 5)[2], "12,5m".replace(",", ".")), "line 5"),
    "nan": (lambda f, t: change(f, t, 7, cells(f, 7)[4], "nan"), "line 7"),
    "two points with one id": (
        lambda f, t: change(f, t, 9, cells(f, 9)[0] + ",", cells(f, 4)[0] + ","), "line"),
    "three points for 39 terms": (
        lambda f, t: some_points(f, t, 3),
        "Of your 3 features 1 is control; rfm-terms needs at least 3."),
    "all points on one line": (straight_line, "one straight line"),
    "unknown role": (lambda f, t: change(f, t, 3, cells(f, 3)[1], "tie"), "tie"),
    "empty file": (lambda f, t: written(t, b""), "empty"),
    "header alone": (lambda f, t: written(t, b"id,line,sample,x,y,z\n"), "no"),
    "binary file": (lambda f, t: written(t, bytes(range(256)) * 20), "bad.csv"),
    "wrong encoding": (
        lambda f, t: written(t, "id,line,sample,x,y,z\nStraße,1,2,3,4,5\n".encode("latin-1")),
        "UTF-8"),
    "lon and lat swapped": (
        lambda f, t: written(t, b"id,line,sample,x,y,z\n" + b"".join(
            b"P%d,%d,%d,%f,%f,1\n" % (i, i, i * i, 35 + i / 99, 139.7 + i * i / 99)
            for i in range(20))), "swapped"),
    "row too short": (
        lambda f, t: written(t, b"id,line,sample,x,y,z\nA,1,2,3\n"), "line 2"),
    "two points in one place": (
        lambda f, t: written(t, b"id,line,sample,x,y,z\nA,1,2,3,4,5\nB,9,9,3,4,5\n"),
        "same ground"),
    "a folder": (lambda f, t: t, "folder"),
    "no such file": (lambda f, t: t / "nowhere.csv", "nowhere.csv"),
}


@pytest.mark.parametrize("kind", BAD_FILES)
def test_a_bad_file_gives_one_message_and_code_2(kind: str, files: Path, tmp_path: Path,
                                                 call: Call) -> None:
    make, message = BAD_FILES[kind]
    path = make(files, tmp_path)
    out = tmp_path / "out"
    done = call("run", "--problem", "rfm-terms", "--points", path, "--crs", "EPSG:4979",
                "--out", out, *QUICK)
    assert done.exit_code == 2, done.stdout + done.stderr
    assert done.stdout == ""
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert not out.exists()


BAD_WORDS = {
    "unknown problem": (["--problem", "rfm-term"], "Did you mean 'rfm-terms'"),
    "unknown option key": (["--problem", "rfm-terms", "--set", "poulation=5"], "population"),
    "value out of range": (["--problem", "rfm-terms", "--set", "order=7"], "1 to 3"),
    "not KEY=VALUE": (["--problem", "rfm-terms", "--set", "order"], "KEY=VALUE"),
    "set twice": (["--problem", "rfm-terms", "--set", "order=1", "--set", "order=2"], "twice"),
    "unknown model": (["--problem", "rfm-terms", "--model", "rpc"], "unknown model"),
    "unknown solver": (["--problem", "rfm-terms", "--solver", "gaa"], "Did you mean 'ga'"),
    "unknown data set": (["--problem", "rfm-terms", "--dataset", "hamedan"], "ikonos-hamedan"),
    "negative seed": (["--problem", "rfm-terms", "--seed", "-1"], "--seed"),
    "no generations": (["--problem", "rfm-terms", "--generations", "0"], "--generations"),
    "no problem": ([], "--problem"),
    "crs without a file": (["--problem", "rfm-terms", "--crs", "local"], "--crs"),
    "unwritable out": (["--problem", "rfm-terms", "--out", os.devnull], "--out"),
    "no lines in the data": (["--problem", "owdis-lines", "--dataset", "irs1c-mashad"], "lines"),
}


@pytest.mark.parametrize("kind", BAD_WORDS)
def test_bad_words_give_one_message_and_code_2(kind: str, call: Call) -> None:
    words, message = BAD_WORDS[kind]
    done = call("run", *words)
    assert done.exit_code == 2, done.stdout + done.stderr
    assert done.stdout == ""
    assert message in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(("crs", "message"), [
    ("EPSG:32639", "degrees"), ("EPSG:99999999", "EPSG"), ("WGS 84", "EPSG:4979"), (None, "--crs")])
def test_a_wrong_crs_is_refused(crs: str | None, message: str, files: Path,
                                tmp_path: Path, call: Call) -> None:
    named = [] if crs is None else ["--crs", crs]
    plain = tmp_path / "plain.csv"  # the written file may declare its CRS
    plain.write_text("".join(row for row in (files / "points.csv").open()
                             if not row.startswith("#")))
    done = call("run", "--problem", "rfm-terms", "--points", plain, *named, *QUICK)
    assert done.exit_code == 2
    assert message in done.stderr


@pytest.mark.parametrize("words", [
    BAD_WORDS["unknown problem"][0], ["--problem", "rfm-terms", "--points", "nowhere.csv"]])
def test_a_process_of_its_own_says_the_same(words: list[str], call: Call) -> None:
    done, here = termsel("run", *words), call("run", *words)
    assert (done.returncode, done.stdout, done.stderr) == (2, "", here.stderr)
    assert here.exit_code == 2
