"""How far a run is: what observers of the strategy auto see, Ctrl-C, and bars on a terminal."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from click.testing import CliRunner

import termsel
from termsel.cli.main import cli
from termsel.data.features import FeatureSet
from termsel.selection.solvers.ledger import Progress
from termsel.simulate import simulate_scene

FEATURES = simulate_scene("ikonos-hamedan", n_points=40, n_lines=0)


def run(observe: Callable[[Progress], None], features: FeatureSet = FEATURES) -> termsel.Result:
    return termsel.run("rfm-terms", features=features, observers=[observe])


def stop_at(count: int) -> Callable[[Progress], None]:
    """Press Ctrl-C when so many candidates are judged."""
    def observe(progress: Progress) -> None:
        if progress.evaluations == count:
            raise KeyboardInterrupt

    return observe


@pytest.fixture(scope="module")
def told() -> tuple[termsel.Result, list[Progress]]:
    seen: list[Progress] = []
    return run(seen.append), seen


def test_observers_of_auto_see_every_candidate_of_every_fold(
        told: tuple[termsel.Result, list[Progress]]) -> None:
    result, seen = told
    assert result.strategy is not None
    assert [one.what for one in seen[:2]] == ["blunders", "candidates"]
    assert seen[0].share is None
    shares = [one.share for one in seen[1:]]
    assert shares == sorted(shares)
    assert shares[0] > 0
    assert shares[-1] == pytest.approx(1)
    folds = result.strategy.folds
    assert len(set(shares)) == result.evaluations == seen[-1].evaluations
    assert {one.what for one in seen} == {
        "blunders", "candidates", *(f"fold {i + 1} of {folds}" for i in range(folds))}
    assert seen[-1].best == min(one.predicted for one in result.strategy.candidates)


def test_an_interrupted_choice_is_that_among_the_candidates_so_far(tmp_path: Path) -> None:
    result = run(stop_at(3))
    assert result.interrupted
    assert result.strategy is not None
    assert result.strategy.predicted is None
    assert 1 <= len(result.strategy.candidates) <= 3
    assert result.strategy.chosen in {one.name for one in result.strategy.candidates}
    assert result.notes[0].startswith("The run was interrupted when 3 of ")
    assert "predicts no accuracy" in result.summary(verbose=True)


def test_an_interrupted_fold_costs_the_predicted_rmse_alone(
        told: tuple[termsel.Result, list[Progress]]) -> None:
    full = told[0].to_dict()
    judged = next(one.evaluations for one in told[1] if one.what == "fold 1 of 20") + 5
    found = run(stop_at(judged)).to_dict()
    assert found["interrupted"]
    assert found["strategy"]["candidates"] == full["strategy"]["candidates"]
    for key in ("selection", "coefficients", "rmse", "baselines"):
        assert found[key] == full[key]


def test_before_the_first_candidate_there_is_nothing_to_keep() -> None:
    with pytest.raises(KeyboardInterrupt):
        run(stop_at(0))


def test_an_interrupted_command_writes_the_best_so_far(
        call: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    @contextmanager
    def bar(title: str, quiet: bool) -> Iterator[Callable[[Progress], None]]:
        yield stop_at(20)

    monkeypatch.setattr("termsel.cli.run.search_bar", bar)
    done = call("run", "--problem", "rfm-terms", "--out", tmp_path / "out")
    assert done.exit_code == 130
    assert "Interrupted: this is the best so far." in done.stderr
    assert json.loads((tmp_path / "out" / "result.json").read_text())["interrupted"]
    assert termsel.read_result(tmp_path / "out").interrupted


def on_terminal(*words: str, columns: int = 80) -> str:
    """Return what a command writes to a terminal as its stderr."""
    pty = pytest.importorskip("pty", reason="needs terminals of POSIX")
    ours, theirs = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": str(columns)}
    with subprocess.Popen([sys.executable, "-m", "termsel", *words], stdout=subprocess.DEVNULL,
                          stderr=theirs, env=environment) as process:
        os.close(theirs)
        written = b""
        while True:
            try:
                more = os.read(ours, 65536)
            except OSError:  # the other end is closed
                break
            if not more:
                break
            written += more
    os.close(ours)
    assert process.returncode == 0, written
    return written.decode()


CLEAR = "\x1b[2K"


@pytest.mark.slow
def test_messages_stand_on_lines_of_their_own_and_no_bar_stays() -> None:
    text = on_terminal("run", "--problem", "rfm-terms", "--model", "poly3d", "--set", "degree=2",
                       "--solver", "exact", "--json")
    before = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text.partition("exact: ")[0])
    assert before.endswith(("\r", "\n"))
    assert text.rpartition("rfm-terms")[2].rstrip("\r").endswith(CLEAR)


@pytest.mark.slow
def test_the_bar_of_auto_moves() -> None:
    words = ("run", "--problem", "poly-terms", "--json")  # a second of auto
    text = on_terminal(*words)
    percent = {int(found) for found in re.findall(r"(\d+)%", text)}
    assert len(percent - {0, 100}) >= 2  # it is drawn ten times a second
    assert "fold " in text
    assert on_terminal(*words, "--quiet") == ""


@pytest.mark.slow_cases("what0")
@pytest.mark.parametrize("what", [["--dataset", "old-map"],
                                  ["--problem", "poly-terms", "--evaluations", "500"]])
def test_programs_get_lines_of_json(what: list[str]) -> None:
    done = CliRunner().invoke(cli, ["run", *what, "--progress", "json"])
    assert done.exit_code == 0, done.output
    lines = [json.loads(line) for line in done.stderr.splitlines() if line.startswith("{")]
    shares = [line["progress"] for line in lines if line["progress"] is not None]
    assert shares
    assert shares == sorted(shares)
    assert 0 <= shares[0] <= shares[-1] <= 1
    assert all(line["what"] for line in lines)
    assert '"progress"' not in done.stdout
