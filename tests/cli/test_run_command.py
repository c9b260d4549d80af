"""The command `termsel run` as a person types it, above all when the input is bad."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from termsel.core.errors import TermselError
from termsel.data.features import select
from termsel.formats.readers.csv_tables import write_lines_csv, write_points_csv
from termsel.plugins import registry as registries
from termsel.runs.run import run as termsel_run
from termsel.simulate import simulate_scene

QUICK = ["--generations", "3", "--set", "population=30", "--set", "polish=false"]


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


@pytest.mark.slow
def test_own_files_run_and_write_the_result(files: Path, tmp_path: Path, call: Call) -> None:
    out = tmp_path / "out"
    done = call("run", "--problem", "owdis-lines", "--points", files / "points.csv", "--lines",
                files / "lines.csv", "--crs", "EPSG:4979", "--out", out, "--verbose",
                *QUICK)
    assert done.exit_code == 0, done.stderr
    assert "RMSE [px], with 90 % intervals" in done.stdout
    assert done.stdout.startswith((out / "summary.txt").read_text())
    assert json.loads((out / "result.json").read_text())["data"]["counts"]["lines"] == 120


def test_json_is_alone_on_stdout_and_without_a_terminal_no_bar_is_drawn() -> None:
    done = termsel("run", "--problem", "poly-terms", "--json", *QUICK)
    assert done.returncode == 0
    assert done.stderr == ""
    result = json.loads(done.stdout)
    assert result["schema"] == "termsel-result-1"
    for key in ("problem", "model", "solver", "criterion", "seed", "options", "data", "selection",
                "rmse", "baselines", "front", "certificate", "evaluations", "generations",
                "seconds", "coefficients", "scaling", "versions"):
        assert key in result


@pytest.mark.slow
def test_the_same_command_gives_the_same_selection(call: Call) -> None:
    command = ["run", "--problem", "rfm-terms", "--seed", "3", "--json", *QUICK]
    first, second = (json.loads(run(*command).stdout) for run in (termsel, call))
    assert first["selection"] == second["selection"]
    assert first["coefficients"] == second["coefficients"]


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
         "--progress", "json", "--seconds", "600", "--out", str(out)], text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        # Tests in the background of a script ignore it, and what they start would too.
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL))
    assert process.stderr is not None
    assert any("best" in line for line in process.stderr)  # up to the first; the search goes on
    stdout, stderr = interrupted(process)
    assert process.returncode == 130
    assert "Interrupted: this is the best so far. The same command with " \
        "--overwrite repeats the whole run." in stderr
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
        lambda f, t: written(t, b"id,line,sample,x,z\nA,1,2,3,4\n"),
        "line 1, column 'y': there is no column for y. The columns here are: id, line, "),
    "text in a number": (
        lambda f, t: change(f, t, 5, cells(f, 5)[2], "12.5m"),
        "line 5, column 'line': '12.5m' is not a number. Write it without the unit, in this row "
        "and all others."),
    "a date": (
        lambda f, t: change(f, t, 5, cells(f, 5)[2], "12.May"),
        "'12.May' is not a number. A spreadsheet has made a date of it"),
    "a narrow column": (
        lambda f, t: change(f, t, 5, cells(f, 5)[2], "########"),
        "'########' is not a number. A spreadsheet wrote # as the column was too narrow"),
    "nan": (lambda f, t: change(f, t, 7, cells(f, 7)[4], "nan"),
            "line 7, column 'x': 'nan' is not a finite number. Correct it or remove the row."),
    "two points with one id": (
        lambda f, t: change(f, t, 9, cells(f, 9)[0] + ",", cells(f, 4)[0] + ","),
        "line 9, column 'id': id 'P003' is already used on line 4. Give every point a different "
        "id"),
    "three points for 39 terms": (
        lambda f, t: some_points(f, t, 3),
        "only 1 control point beside 1 selection point and 1 independent check point; "
        "at least 3 control points are needed."),
    "all points on one line": (
        straight_line, "all control points lie on one straight line on the ground. Add control "
        "away from that line: a model needs an area."),
    "unknown role": (lambda f, t: change(f, t, 3, cells(f, 3)[1], "tie"),
                     "line 3, column 'role': unknown role 'tie'. Roles are control, check, "
                     "independent, off, or blank."),
    "empty file": (lambda f, t: written(t, b""),
                   "bad.csv: the file is empty. Give a table headed id,role,line,sample,x,y,z"),
    "header alone": (lambda f, t: written(t, b"id,line,sample,x,y,z\n"),
                     "there is a header and no row below it. Add a row for each point or line."),
    "binary file": (lambda f, t: written(t, bytes(range(256)) * 20),
                    "bad.csv: this binary file is in no format that termsel knows. Give a "),
    "wrong encoding": (
        lambda f, t: written(t, "id,line,sample,x,y,z\nStra\x81e,1,2,3,4,5\n".encode("latin-1")),
        "line 2: the text of this file is not UTF-8. Save it with the encoding UTF-8."),
    "lon and lat swapped": (
        lambda f, t: written(t, b"id,line,sample,x,y,z\n" + b"".join(
            b"P%d,%d,%d,%f,%f,1\n" % (i, i, i * i, 35 + i / 99, 139.7 + i * i / 99)
            for i in range(20))),
        "line 2, column 'y': 'P0' with x = 35, y = 139.7 cannot be longitude and latitude "
        "in EPSG:4979. x and y look swapped: --set swapped=xy exchanges them."),
    "row too short": (
        lambda f, t: written(t, b"id,line,sample,x,y,z\nA,1,2,3\n"),
        "line 2: the row ends after 4 of 6 cells, before y, z. Complete it, or delete it."),
    "two points in one place": (
        lambda f, t: written(t, b"id,line,sample,x,y,z\nA,1,2,3,4,5\nB,9,9,3,4,5\n"),
        "line 3: points 'A' and 'B' have the same ground coordinates. Remove one of them"),
    "a folder": (lambda f, t: t, "this is a folder, expected a file. Give a table headed"),
    "no such file": (lambda f, t: t / "nowhere.csv",
                     "nowhere.csv: this file does not exist. Check the name and the folder."),
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
    "unknown problem": (["--problem", "rfm-term"],
                        "unknown problem 'rfm-term'. Did you mean 'rfm-terms'? Known: "),
    "strategy as problem": (["--problem", "auto"], "auto is a strategy: ask for --strategy auto"),
    "unknown option key": (
        ["--problem", "rfm-terms", "--set", "poulation=5"],
        "unknown option 'poulation'. Did you mean 'population'?"),
    "value out of range": (
        ["--problem", "rfm-terms", "--set", "order=7"],
        "option 'order' does not accept '7'. Accepted: whole number from 1 to 3."),
    "option of another model": (
        ["--problem", "rfm-terms", "--set", "degree=2"],
        "'degree' is an option of the model poly2d or poly3d"),
    "option of models with and without heights": (
        ["--problem", "rfm-terms", "--set", "degree=2"],
        "Choose --model poly3d, or poly2d for points without heights, or leave degree out."),
    "not KEY=VALUE": (["--problem", "rfm-terms", "--set", "order"],
                      "--set 'order' is not of the form KEY=VALUE. For example --set population="),
    "set twice": (["--problem", "rfm-terms", "--set", "order=1", "--set", "order=2"],
                  "--set order is given twice. Give it once."),
    "two files of points": (["--points", "a.csv", "--points=b.csv"],
                            "--points is given 2 times; it takes one value."),
    "unknown model": (["--problem", "rfm-terms", "--model", "xyz"],
                      "unknown model 'xyz'. Known: affine, dlt2d, "),
    "a method as a model": (["--problem", "rfm-terms", "--model", "pinhole"],
                            "pinhole is a method: --method pinhole."),
    "a model as a solver": (["--problem", "rfm-terms", "--solver", "affine"],
                            "affine is a model: --model affine."),
    "unknown solver": (["--problem", "rfm-terms", "--solver", "gaa"],
                       "unknown solver 'gaa'. Did you mean 'ga'? Known: "),
    "unknown data set": (["--problem", "rfm-terms", "--dataset", "hamedan"],
                         "'ikonos-hamedan'? Known: "),
    "negative seed": (["--problem", "rfm-terms", "--seed", "-1"],
                      "--seed is -1, expected a whole number of at least 0."),
    "no generations": (["--problem", "rfm-terms", "--generations", "0"],
                       "--generations is 0, expected a whole number of at least 1."),
    "nothing to run": ([], "there is nothing to run. Give --points FILE or --lines FILE, or "),
    "off without a feature": (["--problem", "poly-terms", "--off", "P001,P999"],
                              "--off names 'P999', an id that the files do not have."),
    "role of no feature": (["--problem", "poly-terms", "--role", "P999=check"],
                           "--role names 'P999', an id that the files do not have."),
    "no role": (["--problem", "poly-terms", "--role", "P001=best"],
                "unknown role 'best'. Known: check, control, independent, off. It stands in --role "
                "P001=best."),
    "role in the words of the field": (
        ["--problem", "poly-terms", "--role", "P001=GCP"],
        "It stands in --role P001=GCP. Write control for a ground control point (GCP, CoP)."),
    "role in capitals": (["--problem", "poly-terms", "--role", "P001=CHECK"],
                         "unknown role 'CHECK'. Did you mean 'check'? Known: check, control, "),
    "two roles": (["--problem", "poly-terms", "--role", "P001=check", "--off", "P001"],
                  "'P001' is given the roles off and check. Give it one role."),
    "role of a line": (["--problem", "owdis-lines", "--role", "L001=check"],
                       "'L001' is a line and cannot have the role check."),
    "role and other roles": (
        ["--problem", "poly-terms", "--role", "P001=check", "--set", "roles=random"],
        "the options role and roles=random exclude each other."),
    "crs without a file": (
        ["--problem", "rfm-terms", "--crs", "local"],
        "--crs requires --points or --lines. Give --points FILE, or leave --crs out."),
    "unwritable out": (["--problem", "rfm-terms", "--out", os.devnull],
                       f"{os.devnull} is a file, not a folder"),
    "no lines in the data": (
        ["--problem", "owdis-lines", "--dataset", "irs1c-mashad"],
        "the problem needs control lines and there are none. Give them with --lines FILE, or "),
}


@pytest.mark.parametrize("kind", BAD_WORDS)
def test_bad_words_give_one_message_and_code_2(kind: str, call: Call) -> None:
    words, message = BAD_WORDS[kind]
    done = call("run", *words)
    assert done.exit_code == 2, done.stdout + done.stderr
    assert done.stdout == ""
    assert message in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_a_result_is_replaced_only_where_that_is_asked_for(
        files: Path, tmp_path: Path, call: Call) -> None:
    words = ["run", "--problem", "rfm-terms", "--model", "affine", "--solver", "all-terms",
             "--criterion", "press", "--points", files / "points.csv", "--crs", "EPSG:4979",
             "--out", tmp_path, "--export", "geolocation-vrt"]
    first = call(*words)
    written = [line.removeprefix("Written: ") for line in first.stderr.splitlines()
               if line.startswith("Written: ")]
    assert written == [", ".join(str(tmp_path / f"result_geolocation{end}")
                                 for end in (".vrt", "_xy.tif"))]
    assert f"Saved     {tmp_path}" in first.stdout
    before = {file: file.read_bytes() for file in tmp_path.iterdir()}
    assert len(before) == 6
    again = call(*words)
    assert (again.exit_code, again.stdout) == (2, "")
    assert "add --overwrite" in again.stderr
    assert {file: file.read_bytes() for file in tmp_path.iterdir()} == before
    refused = call(*words[:-2])
    assert refused.exit_code == 2
    assert f"{tmp_path}: there is a result in this folder already." in refused.stderr
    with pytest.raises(TermselError, match="there is a result in this folder already"):
        termsel_run("rfm-terms", out=tmp_path)
    other = call(*words, "--overwrite", "--off", "P002")
    assert other.exit_code == 0
    assert (tmp_path / "result.json").read_bytes() != before[tmp_path / "result.json"]


@pytest.mark.slow
def test_points_and_lines_are_left_out_and_given_roles(files: Path, call: Call) -> None:
    words = ["run", "--problem", "owdis-lines", "--points", files / "points.csv", "--lines",
             files / "lines.csv", "--crs", "EPSG:4979", "--json", *QUICK]
    plain, named = (json.loads(call(*words, *more).stdout) for more in (
        [], ["--off", "P003,L027", "--off", "P005", "--role", "P001=check",
             "--role", "P002=independent"]))
    assert named["options"]["data"]["off"] == "P003,L027,P005"
    assert named["options"]["data"]["role"] == "P001=check,P002=independent"
    assert {"P003", "P005"} <= set(named["data"]["roles"]["off"])
    assert "P001" in named["data"]["roles"]["check"]
    assert "P002" in named["data"]["roles"]["independent"]
    assert set(plain["data"]["roles"]["control"]) - set(named["data"]["roles"]["control"]) == {
        "L027"}
    assert plain["options"]["data"]["off"] is None


def test_what_is_off_is_as_if_it_had_not_been_measured() -> None:
    features = simulate_scene("ikonos-hamedan")
    points = features.points
    gone = select(points.ids, np.array(points.roles) == "check")[:3]
    less = features.with_(points=points.take([name not in gone for name in points.ids]))
    named, without = (termsel_run(
        "poly-terms", features=one, generations=2, options=options).to_dict()
        for one, options in ((features, {"off": ",".join(gone)}), (less, {})))
    for key in ("selection", "coefficients", "rmse", "baselines"):
        assert named[key] == without[key]


def test_few_points_of_which_one_is_off_or_independent_are_all_control(call: Call,
                                                                       tmp_path: Path) -> None:
    points = simulate_scene("ikonos-hamedan", n_points=10, n_lines=0).points
    write_points_csv(replace(points, roles=()), tmp_path / "ten.csv")
    words = ["run", "--points", tmp_path / "ten.csv", "--crs", "EPSG:4979", "--json"]
    done = json.loads(call(*words, "--off", "P001", "--role", "P002=independent").stdout)
    counts = done["data"]["counts"]
    assert (counts["control"], counts["independent"], counts["off"]) == (8, 1, 1)


@pytest.mark.slow_cases("lines-True-owdis-lines")
@pytest.mark.parametrize(("given", "heights", "problem"), [
    ("points", True, "rfm-terms"), ("points", False, "poly-terms"),
    ("lines", True, "owdis-lines")])
def test_the_problem_follows_from_the_files(given: str, heights: bool, problem: str, files: Path,
                                            tmp_path: Path, call: Call) -> None:
    points = simulate_scene("ikonos-hamedan", n_points=30).points
    ground = points.ground if heights else points.ground * [1, 1, np.nan]
    write_points_csv(replace(points, ground=ground), tmp_path / "points.csv")
    more = ["--lines", files / "lines.csv"] if given == "lines" else []
    done = call("run", "--points", tmp_path / "points.csv", "--crs", "EPSG:4979", "--json",
                "--generations", "1", *more)
    assert json.loads(done.stdout)["problem"] == problem


def test_a_problem_follows_from_features_in_python() -> None:
    features = simulate_scene("ikonos-hamedan", n_points=30, n_lines=0)
    found = termsel_run(features=features)
    assert found.problem == "rfm-terms"
    assert found.strategy is not None
    with pytest.raises(TermselError, match="there is nothing to run"):
        termsel_run()


@pytest.mark.slow
def test_a_problem_follows_from_a_data_set(call: Call) -> None:
    done = call("run", "--dataset", "hamedan-candidates", "--generations", 1, "--quiet")
    assert done.stdout.startswith("hamedan-candidates (simulated): 240 points, ")


@pytest.mark.parametrize(("crs", "message"), [
    ("EPSG:32639", "the ground coordinates look like degrees, but EPSG:32639 is a projected CRS"),
    ("EPSG:99999999", "CRS 'EPSG:99999999' does not exist or cannot be read. Examples: EPSG:4979"),
    ("WGS 1984 9", "unknown CRS 'WGS 1984 9'. Examples: EPSG:4979 (longitude, latitude"),
    (None, "the CRS of the ground coordinates is unknown. State it with --crs: EPSG:4979 (")])
def test_a_wrong_crs_is_refused(crs: str | None, message: str, files: Path,
                                tmp_path: Path, call: Call) -> None:
    named = [] if crs is None else ["--crs", crs]
    plain = tmp_path / "plain.csv"  # the written file may declare its CRS
    plain.write_text("".join(row for row in (files / "points.csv").open()
                             if not row.startswith("#")))
    done = call("run", "--problem", "rfm-terms", "--points", plain, *named, *QUICK)
    assert done.exit_code == 2
    assert message in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("words", [
    BAD_WORDS["unknown problem"][0], ["--problem", "rfm-terms", "--points", "nowhere.csv"]])
def test_a_process_of_its_own_says_the_same(words: list[str], call: Call) -> None:
    done, here = termsel("run", *words), call("run", *words)
    assert (done.returncode, done.stdout, done.stderr) == (2, "", here.stderr)
    assert here.exit_code == 2


def test_an_rpc_that_no_package_corrects_is_refused(example_files: Path, call: Call,
                                                    monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registries, "registry", lambda: registries.Registry([]))
    refused = call("run", "--points", example_files / "gcps.csv", "--rpc",
                   example_files / "vendor.RPB")
    assert refused.exit_code == 2
    assert "vendor.RPB: no installed package corrects an RPC. It comes with the package " \
           "termsel-rpc" in refused.stderr
