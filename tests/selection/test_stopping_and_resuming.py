"""Searches that an observer ends, and that go on from a checkpoint."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import termsel
from termsel.data.features import FeatureSet
from termsel.selection.solvers.search import SearchResult

SOLVERS = ("ga", "pso", "ica", "swap", "nsga2")


def stop(_progress: object) -> bool:
    return True


def stop_iteration(_progress: object) -> None:
    raise StopIteration


@pytest.fixture(scope="module")
def task() -> termsel.Task:
    return termsel.prepare("poly-terms", options={"degree": 2})


def found(task: termsel.Task, name: str = "ga", **how: Any) -> SearchResult:
    return termsel.search(task.problem, termsel.get("solvers", name)(),
                          **{"evaluations": 1200, **how})


def same(one: SearchResult, other: SearchResult) -> bool:
    return bool((one.genes == other.genes).all()) and one.history == other.history \
        and one.evaluations == other.evaluations and one.lookups == other.lookups


@pytest.mark.parametrize("observer", [stop, stop_iteration])
def test_an_observer_ends_a_search_and_keeps_its_result(task: termsel.Task, observer: Any) -> None:
    search = found(task, observers=[observer])
    assert search.generations == 0
    assert search.evaluations == 20
    assert search.ended_by_observer
    assert not search.interrupted
    assert "An observer ended the search." in search.notes


@pytest.mark.parametrize("answer", [None, False, 1, "True"])
def test_nothing_but_true_ends_a_search(task: termsel.Task, answer: Any) -> None:
    search = found(task, observers=[lambda _progress: answer])
    assert search.evaluations == 1200
    assert not search.ended_by_observer


def test_an_observer_ends_the_local_refinement(task: termsel.Task) -> None:
    search = found(task, polish=True, observers=[
        lambda progress: progress.what == "local refinement"])
    assert search.polish is not None
    assert search.ended_by_observer
    assert search.evaluations < 1200


def test_a_run_whose_search_an_observer_ended_has_a_result() -> None:
    result = termsel.run("poly-terms", solver="ga", options={"degree": 2}, observers=[stop])
    assert not result.interrupted
    assert "An observer ended the search." in result.notes
    assert result.selection.terms


@pytest.mark.parametrize("name", SOLVERS)
def test_a_stopped_search_goes_on_to_the_same_end(name: str, tmp_path: Path) -> None:
    objectives = {"objectives": "n_terms"} if name == "nsga2" else {}
    task = termsel.prepare("poly-terms", solver=name, options={"degree": 2, **objectives})
    file = tmp_path / "search.checkpoint"
    how: dict[str, Any] = {"name": name, "polish": True}
    uninterrupted = found(task, **how)
    stopped = found(task, checkpoint=file, **how, observers=[
        lambda progress: progress.evaluations >= 150])
    assert stopped.evaluations < uninterrupted.evaluations
    assert same(found(task, checkpoint=file, **how), uninterrupted)
    size = file.stat().st_size
    assert same(found(task, checkpoint=file, **how), uninterrupted)
    assert file.stat().st_size == size


def test_what_a_checkpoint_has_is_not_evaluated_again(tmp_path: Path) -> None:
    task = termsel.prepare("poly-terms", options={"degree": 2})
    found(task, checkpoint=tmp_path / "file")
    counted = []
    evaluate = task.problem.evaluate

    def counting(genes: Any) -> termsel.Evaluation:
        counted.append(len(genes))
        return evaluate(genes)

    task.problem.evaluate = counting  # type: ignore[method-assign]
    found(task, checkpoint=tmp_path / "file")
    assert counted == [20]  # one population: whether the data are the same


def test_a_budget_may_grow(task: termsel.Task, tmp_path: Path) -> None:
    solver = termsel.get("solvers", "ga")(population=40)
    for evaluations in (700, 900, 1100):
        resumed, uninterrupted = (
            termsel.search(task.problem, solver, evaluations=evaluations, checkpoint=file)
            for file in (tmp_path / "file", None))
        assert same(resumed, uninterrupted)


@pytest.mark.usefixtures("clock")  # a busy machine may delay what follows an evaluation
def test_a_budget_of_time_counts_all_processes(task: termsel.Task, tmp_path: Path) -> None:
    file = tmp_path / "file"
    first = found(task, checkpoint=file, evaluations=None, seconds=0.2)
    # What the first has spent is more than half: no further selection is evaluated.
    again = found(task, checkpoint=file, evaluations=None, seconds=0.1)
    assert again.evaluations == first.evaluations > 0
    assert again.history == first.history
    assert (again.genes == first.genes).all()
    longer = found(task, checkpoint=file, evaluations=None, seconds=1)
    assert longer.evaluations > first.evaluations


@pytest.mark.parametrize("steps", ["terms-first", "features-first"])
def test_a_search_in_two_steps_goes_on(steps: str, tmp_path: Path) -> None:
    how: dict[str, Any] = {"strategy": "as-asked", "evaluations": 600, "options": {
        "order": 1, "steps": steps, "polish": False}}
    calls = []

    def after_some(_progress: object) -> bool:
        calls.append(1)
        return len(calls) > 2

    whole = termsel.run("owdis-points-terms", **how)
    file = tmp_path / "file"
    termsel.run("owdis-points-terms", checkpoint=file, observers=[after_some], **how)
    resumed = termsel.run("owdis-points-terms", checkpoint=file, **how)
    assert (resumed.selection, resumed.history) == (whole.selection, whole.history)


def test_a_checkpoint_of_another_search_is_refused(task: termsel.Task, tmp_path: Path) -> None:
    file = tmp_path / "file"
    found(task, checkpoint=file)
    for how in ({"seed": 2}, {"name": "pso"}):
        with pytest.raises(termsel.TermselError,
                           match=r"differs .*from the one of the checkpoint"):
            found(task, checkpoint=file, **how)


def test_a_checkpoint_of_other_data_is_refused(task: termsel.Task, tmp_path: Path) -> None:
    file = tmp_path / "file"
    found(task, checkpoint=file)
    other = termsel.prepare("poly-terms", options={"degree": 2, "roles": "random", "split": 1})
    with pytest.raises(termsel.TermselError, match="of other data, or of another problem"):
        found(other, checkpoint=file)


@pytest.mark.slow_cases("check-1", "check-3", "control-1", "control-2", "control-3")
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("role", ["control", "check"])
def test_a_checkpoint_is_refused_once_one_reading_is_corrected(
        seed: int, role: str, tmp_path: Path) -> None:
    """The first selections of a search often have no solution, whatever the data are."""
    scene = termsel.simulate_scene("ikonos-hamedan", seed=seed, roles=(30, 15, 15), n_lines=0)
    points = scene.points
    image = points.image.copy()
    image[points.roles.index(role)] += [50.0, 0.0]
    misread = scene.with_(points=replace(points, image=image))

    def search(features: FeatureSet) -> termsel.Result:
        return termsel.run("rfm-terms", features=features, solver="ga", seed=seed, evaluations=300,
                           checkpoint=tmp_path / "file", options={"population": 60})

    search(misread)
    with pytest.raises(termsel.TermselError, match="of other data, or of another problem"):
        search(scene)


@pytest.mark.parametrize(("change", "is_same"), [
    (lambda points: replace(points, ids=tuple(f"other {name}" for name in points.ids)), False),
    (lambda points: replace(points, ground=points.ground * [1.0, 1.0, 1.01]), False),
    (lambda points: points.take(range(len(points) - 1, -1, -1)), True)],
    ids=["names", "heights", "order of rows"])
def test_a_checkpoint_without_a_solution_is_refused_by_its_data(
        change: Any, is_same: bool, tmp_path: Path) -> None:
    """Three selections of far too many terms are infinite with any data."""
    scene = termsel.simulate_scene("ikonos-hamedan", roles=(30, 15, 15), n_lines=0)

    def search(features: FeatureSet) -> termsel.Result:
        return termsel.run("rfm-terms", features=features, solver="random", evaluations=3,
                           checkpoint=tmp_path / "file")

    assert not search(scene).feasible
    changed = scene.with_(points=change(scene.points))
    if is_same:
        search(changed)
        return
    with pytest.raises(termsel.TermselError, match="of other data, or of another problem"):
        search(changed)
    moved = replace(scene, crs="EPSG:4326")
    with pytest.raises(termsel.TermselError, match="of other data, or of another problem"):
        search(moved)


def test_another_file_stays_as_it_is(task: termsel.Task, tmp_path: Path) -> None:
    file = tmp_path / "points.csv"
    file.write_text("id,line,sample\nP1,1,2")
    with pytest.raises(termsel.TermselError, match="no checkpoint of a search"):
        found(task, checkpoint=file)
    assert file.read_text() == "id,line,sample\nP1,1,2"


def test_an_incomplete_last_line_is_dropped(task: termsel.Task, tmp_path: Path) -> None:
    file = tmp_path / "file"
    whole = found(task, checkpoint=file)
    file.write_bytes(file.read_bytes()[:-20])
    assert same(found(task, checkpoint=file), whole)


def test_a_damaged_line_is_named(task: termsel.Task, tmp_path: Path) -> None:
    file = tmp_path / "file"
    found(task, checkpoint=file)
    lines = file.read_bytes().splitlines()
    file.write_bytes(b"\n".join([*lines[:2], b"{}", *lines[2:], b""]))
    with pytest.raises(termsel.TermselError, match="damaged") as error:
        found(task, checkpoint=file)
    assert error.value.line == 3


def test_a_proof_keeps_no_checkpoint(tmp_path: Path) -> None:
    with pytest.raises(termsel.TermselError, match="'exact' keeps no checkpoint"):
        termsel.run("poly-terms", solver="exact", checkpoint=tmp_path / "file")


def test_the_choice_keeps_no_checkpoint(tmp_path: Path) -> None:
    with pytest.raises(termsel.TermselError, match="a checkpoint cannot be given"):
        termsel.run("poly-terms", strategy="auto", checkpoint=tmp_path / "file")


@pytest.mark.slow
def test_a_killed_run_goes_on_in_another_process(tmp_path: Path) -> None:
    file = tmp_path / "file"
    command = [sys.executable, "-m", "termsel", "run", "--problem", "rfm-terms", "--solver", "ga",
               "--evaluations", "60000", "--json"]
    resumable = [*command, "--checkpoint", str(file)]
    with subprocess.Popen(resumable, stdout=subprocess.DEVNULL) as process:
        while not file.exists() or file.stat().st_size < 10_000:
            time.sleep(0.05)
        process.kill()
    results = [json.loads(subprocess.run(words, check=True, capture_output=True).stdout)
               for words in (resumable, command)]
    resumed, whole = ({key: result[key] for key in ("selection", "history", "evaluations")}
                      for result in results)
    assert resumed == whole
