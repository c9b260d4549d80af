"""What a study keeps when it is killed, has no space, meets another one, or is changed."""

from __future__ import annotations

import csv
import os
import random
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from multiprocessing import parent_process
from pathlib import Path
from types import SimpleNamespace

import pytest

import termsel
from termsel import TermselError
from termsel.core.files.lock import lock_folder, lock_holder
from termsel.core.files.names import JOURNAL
from termsel.studies.cells.cell import Cell
from termsel.studies.cells.folder import PLAN
from termsel.studies.cells.journal import CellRecord, Journal, read_journal
from termsel.studies.cells.table import TIMES
from termsel.studies.execution.executors import DIED, run_in_processes, run_serially
from termsel.studies.plan.data import Data

Call = Callable[..., SimpleNamespace]

STUDY = """problems = [{name = "poly-terms", degree = 3}]
solvers = ["random", "ga"]
seeds = 8
[budget]
evaluations = 300
[options]
polish = false
"""
SHORT = STUDY.replace("seeds = 8", "seeds = 3")


@pytest.fixture
def study(tmp_path: Path) -> Path:
    path = tmp_path / "study.toml"
    path.write_text(SHORT)
    return path


def table_of(folder: Path) -> list[list[str]]:
    """Return study.csv without what differs from run to run."""
    with (folder / "study.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    return [[value for key, value in row.items() if key not in TIMES] for row in rows]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs signals of POSIX")
def test_a_study_that_is_killed_again_and_again_ends_as_if_it_were_not(
        study: Path, call: Call, tmp_path: Path) -> None:
    study.write_text(STUDY)
    assert call("compare", study, "--out", tmp_path / "whole").exit_code == 0
    command = [sys.executable, "-m", "termsel", "compare", str(study), "--out",
               str(tmp_path / "out"), "--workers", "2"]
    rng, kept = random.Random(5), 0
    for _ in range(4):
        running = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        until = time.monotonic() + 60
        most = kept + rng.randint(1, 3)
        while running.poll() is None and time.monotonic() < until:
            kept = len(read_journal(tmp_path / "out").records)
            if kept >= most:
                break
            time.sleep(0.01 * rng.random())
        running.kill()
        running.wait()
    assert kept
    last = subprocess.run(command, capture_output=True, check=True, text=True)
    assert "Written" in last.stderr
    assert table_of(tmp_path / "out") == table_of(tmp_path / "whole")


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs signals of POSIX")
def test_ctrl_c_finishes_the_cells_under_way_and_says_how_to_go_on(
        study: Path, tmp_path: Path) -> None:
    study.write_text(STUDY.replace("300", "20000").replace("seeds = 8", "seeds = 20"))
    command = [sys.executable, "-m", "termsel", "compare", str(study), "--out",
               str(tmp_path / "out"), "--workers", "2"]
    running = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    until = time.monotonic() + 60
    while len(read_journal(tmp_path / "out").records) < 2 and time.monotonic() < until:
        time.sleep(0.02)
    os.killpg(running.pid, signal.SIGINT)  # as a terminal does: the workers too
    _, said = running.communicate(timeout=60)
    assert running.returncode == 130
    assert "being finished" in said
    assert "The same command goes on" in said
    assert "Traceback" not in said
    records = read_journal(tmp_path / "out").records
    assert 2 <= len(records) < 40
    assert {record.state for record in records.values()} == {"done"}


@pytest.mark.slow
def test_a_torn_line_is_cut_off_and_told(study: Path, call: Call, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert call("compare", study, "--out", out).exit_code == 0
    whole, table = (out / JOURNAL).read_bytes(), table_of(out)
    (out / JOURNAL).write_bytes(whole[:-40])
    done = call("compare", study, "--out", out)
    assert done.exit_code == 0
    assert "was torn and is cut off" in done.stderr
    assert table_of(out) == table
    lines = (out / JOURNAL).read_bytes().splitlines(keepends=True)
    assert lines[:-1] == whole.splitlines(keepends=True)[:-1]
    again = call("compare", study, "--out", out)
    assert "is cut off" not in again.stderr


@pytest.mark.slow_cases("1", "60")
@pytest.mark.parametrize("kept", [0, 1, 7, 60, 200])
def test_a_journal_torn_in_its_first_line_begins_again(kept: int, study: Path, call: Call,
                                                       tmp_path: Path) -> None:
    out = tmp_path / "out"
    journal = Journal(tmp_path / JOURNAL)
    journal.open({"termsel": termsel.__version__})
    journal.close()
    out.mkdir()
    (out / JOURNAL).write_bytes((tmp_path / JOURNAL).read_bytes()[:kept][:-1])
    assert call("compare", study, "--out", out).exit_code == 0
    assert len(table_of(out)) == 6


@pytest.mark.slow
@pytest.mark.parametrize(("old", "new"), [
    (rb'"state":"done"', b'"state":"dome"'), (rb'"evaluations":\d', b'"evaluations":9')])
def test_a_damaged_line_runs_again(old: bytes, new: bytes, study: Path, call: Call,
                                   tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert call("compare", study, "--out", out).exit_code == 0
    table = table_of(out)
    lines = (out / JOURNAL).read_bytes().splitlines(keepends=True)
    lines[3] = re.sub(old, new, lines[3])
    (out / JOURNAL).write_bytes(b"".join(lines))
    done = call("compare", study, "--out", out)
    assert "damaged in 1 line, the first of them line 4" in done.stderr
    assert table_of(out) == table


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs limits of POSIX")
def test_a_full_disk_is_told_and_loses_nothing(study: Path, call: Call, tmp_path: Path) -> None:
    import resource

    out = tmp_path / "out"
    assert call("compare", study, "--out", tmp_path / "whole").exit_code == 0
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    # plan.json is smaller; the journal ends in the middle of a line.
    limit = max((tmp_path / "whole" / PLAN).stat().st_size + 100,
                (tmp_path / "whole" / JOURNAL).stat().st_size // 2)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        done = call("compare", study, "--out", out)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert done.exit_code == 2
    assert "cannot write the journal" in done.stderr
    assert "are kept" in done.stderr
    content = (out / JOURNAL).read_bytes()
    assert content.endswith(b"\n")
    assert 1 < len(content.splitlines()) < 17
    done = call("compare", study, "--out", out)
    assert done.exit_code == 0
    assert "is cut off" not in done.stderr
    assert table_of(out) == table_of(tmp_path / "whole")


def test_a_second_process_is_refused_with_the_name_of_the_first(
        study: Path, call: Call, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert call("compare", study, "--out", out).exit_code == 0
    assert lock_holder(out) is None
    with lock_folder(out):
        done = call("compare", study, "--out", out)
        status = call("compare", "--status", out)
    assert done.exit_code == 2
    assert f"process {os.getpid()} on " in done.stderr
    assert f"At work: process {os.getpid()} on " in status.stdout
    assert "6 of 6 runs: 6 done" in status.stdout
    assert re.search(r"Worst so far: (random|ga), seed \d: 3\.\d+ px", status.stdout)
    assert "Nobody is at work" in call("compare", "--status", out).stdout


@pytest.mark.slow
def test_cells_of_an_earlier_form_are_kept_aside(study: Path, call: Call, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert call("compare", study, "--out", out).exit_code == 0
    table = table_of(out)
    study.write_text(STUDY.replace("300", "200").replace("seeds = 8", "seeds = 2"))
    done = call("compare", study, "--out", out)
    assert "keeps 6 finished runs of other data, options or code" in done.stderr
    assert len(termsel.read_study(out).records) == 4
    assert len(table_of(out)) == 4
    study.write_text(SHORT)
    assert call("compare", study, "--out", out).exit_code == 0
    assert table_of(out) == table
    assert len(read_journal(out).records) == 10  # none was run a second time


def test_other_versions_are_refused(study: Path, call: Call, tmp_path: Path,
                                    monkeypatch: pytest.MonkeyPatch) -> None:
    from termsel.studies import compare

    out = tmp_path / "out"
    assert call("compare", study, "--out", out).exit_code == 0
    monkeypatch.setattr(compare, "package_versions", lambda: {"termsel": "99"})
    done = call("compare", study, "--out", out)
    assert done.exit_code == 2
    assert "(now 99)" in done.stderr


@pytest.mark.parametrize("content", [b"", b"hello\n", b'{"a": 1}\n', b"\xff\xfe\n", b"[1]\n"])
def test_what_is_no_journal_is_not_overwritten(content: bytes, tmp_path: Path) -> None:
    (tmp_path / JOURNAL).write_bytes(content)
    if not content:
        assert read_journal(tmp_path).records == {}
        return
    with pytest.raises(TermselError, match="not the journal of a study"):
        read_journal(tmp_path)
    assert (tmp_path / JOURNAL).read_bytes() == content


def _cell(key: str, **call: object) -> Cell:
    return Cell(key, {}, {"problem": "poly-terms", "model": None, "solver": "random",
                          "criterion": None, "strategy": "as-asked", "options": {}, "seed": 1,
                          "evaluations": 30, **call}, Data("test", "data", "test", None))


@pytest.mark.slow
def test_a_cell_that_ends_its_process_fails_alone() -> None:
    features = {"data": termsel.prepare("poly-terms").features}
    good = [_cell(f"good{i}", seed=i) for i in range(4)]
    bad = _cell("bad", options=_Deadly())
    found = {one.record.cell: one.record for one in run_in_processes(
        [*good[:2], bad, *good[2:]], features, lambda: False, 2)}
    assert set(found) == {"good0", "good1", "good2", "good3", "bad"}
    assert (found["bad"].state, found["bad"].reason) == ("failed", DIED)
    alone = {one.record.cell: one.record for one in run_serially(good, features, lambda: False)}
    for key, record in alone.items():
        assert found[key].figures["fitness"] == record.figures["fitness"]


class _Deadly(dict):  # type: ignore[type-arg]
    """Options that end the worker that reads them."""

    def __bool__(self) -> bool:
        if parent_process() is not None:
            os._exit(9)
        return False


def test_a_disk_that_takes_a_few_bytes_at_a_time_gets_all(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write = os.write
    monkeypatch.setattr(os, "write", lambda file, data: write(file, data[:7]))
    journal = Journal(tmp_path / JOURNAL)
    journal.open({"a": "1"})
    record = CellRecord("k", "done", "", {}, [], [])
    journal.append(record)
    journal.close()
    monkeypatch.undo()
    again = read_journal(tmp_path)
    assert not again.remarks
    assert again.records == {"k": record}


def test_a_record_survives_the_journal(tmp_path: Path) -> None:
    journal = Journal(tmp_path / JOURNAL)
    journal.open({"a": "1"})
    record = CellRecord("k", "infeasible", "ä\u2028\n\"", {"fitness": 0.1 + 0.2},
                        [[1.0, 2.5, 0.1]], [])
    journal.append(record)
    journal.close()
    assert read_journal(tmp_path).records["k"] == record


def test_a_study_is_not_written_over_a_run(tmp_path: Path) -> None:
    (tmp_path / "result.json").write_text("{}")
    with pytest.raises(TermselError, match=r"has result\.json, the result of a run"):
        termsel.compare(problems=["poly-terms"], solvers=["random"], seeds=1,
                        budget={"evaluations": 20}, out=tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == ["result.json"]
