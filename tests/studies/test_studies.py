"""Studies: what a file or options ask for, what is refused, what comes out."""

from __future__ import annotations

import csv
import itertools
import logging
import re
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from threading import Event
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import termsel
from benchmarks import accuracy, solver_table
from termsel import TermselError
from termsel.formats.readers.csv_tables import write_points_csv
from termsel.selection.solvers.ledger import Progress
from termsel.studies import compare
from termsel.studies.cells import cell
from termsel.studies.cells.journal import CellRecord
from termsel.studies.cells.table import TIMES
from termsel.studies.execution import work
from termsel.studies.outputs import write_outputs
from termsel.studies.plan.places import places_of

Call = Callable[..., SimpleNamespace]

SMALL = """title = "Small"
problems = [{name = "poly-terms", degree = 2}]
solvers = ["random", "swap", "exact"]
seeds = 2
[budget]
evaluations = 60
"""


def _file(folder: Path, text: str = SMALL) -> Path:
    path = folder / "study.toml"
    path.write_text(text)
    return path


def rows_of(folder: Path) -> list[dict[str, str]]:
    """Return the rows of study.csv without what differs from run to run."""
    with (folder / "study.csv").open(newline="") as file:
        return [{key: value for key, value in row.items() if key not in TIMES}
                for row in csv.DictReader(file)]


def test_a_study_file_gives_a_row_a_cell(call: Call, tmp_path: Path) -> None:
    done = call("compare", _file(tmp_path), "--out", tmp_path / "out")
    assert done.exit_code == 0, done.stderr
    rows = rows_of(tmp_path / "out")
    # The solver without chance runs once.
    assert [(row["solver"], row["seed"]) for row in rows] == [
        ("random", "1"), ("random", "2"), ("swap", "1"), ("swap", "2"), ("exact", "1")]
    assert {row["state"] for row in rows} == {"done"}
    optimum = float(rows[-1]["fitness"])
    assert all(float(row["fitness"]) >= optimum * (1 - 1e-9) for row in rows)
    assert all(float(row["optimum"]) == pytest.approx(optimum) for row in rows)
    assert "proven optimum" in done.stdout
    page = (tmp_path / "out" / "summary.md").read_text()
    assert page.startswith("# Small\n")
    assert "What may be claimed" in page
    assert r"\toprule" in (tmp_path / "out" / "summary.tex").read_text()
    # The page is not replaced unless that is asked for.
    written = (tmp_path / "out" / "report.html").read_bytes()
    again = call("report", tmp_path / "out")
    assert again.exit_code == 0
    assert "There is a page already" in again.stdout
    assert (tmp_path / "out" / "report.html").read_bytes() == written


def test_a_cell_is_what_a_run_gives(tmp_path: Path) -> None:
    study = termsel.compare(problems=["rfm-terms"], solvers=["ga"], seeds=[3],
                            budget={"evaluations": 300}, options={"polish": False})
    result = termsel.run("rfm-terms", solver="ga", seed=3, evaluations=300,
                         options={"polish": False})
    row = study.rows[0]
    assert row["fitness"] == result.objectives["check-rmse"]
    independent = result.rmse["independent"]
    assert independent is not None
    assert row["independent"] == independent.total
    assert (row["n_terms"], row["evaluations"]) == (len(result.selection.terms), 300)
    trace = study.records[row["cell"]].trace
    assert trace[-1][1] == row["fitness"]
    assert all(a[0] <= b[0] and a[1] > b[1] for a, b in itertools.pairwise(trace))


def test_options_say_the_same_as_a_file(call: Call, tmp_path: Path) -> None:
    assert call("compare", _file(tmp_path), "--out", tmp_path / "a").exit_code == 0
    done = call("compare", "--problem", "poly-terms", "--solver", "random,swap,exact", "--seeds",
                2, "--evaluations", 60, "--set", "degree=2", "--out", tmp_path / "b")
    assert done.exit_code == 0, done.stderr
    names = ("solver", "seed", "fitness", "independent")
    a, b = ([[row[name] for name in names] for row in rows_of(tmp_path / one)] for one in "ab")
    assert a == b


def test_python_takes_objects_and_features() -> None:
    scene = termsel.prepare("poly-terms").features
    study = termsel.compare(
        problems=["poly-terms"], data={"mine": scene, "again": scene},
        models=[termsel.Polynomial2D(degree=1), "poly2d"], solvers=["random"],
        budget={"evaluations": 40})
    assert [row["model"] for row in study.rows] == ["poly2d, degree=1", "poly2d"] * 2
    assert [row["data"] for row in study.rows] == ["mine"] * 2 + ["again"] * 2
    class Mine(termsel.Polynomial2D):
        """A model that is not registered."""

        name = "mine"

    own = termsel.compare(problems=["poly-terms"], models=[Mine(degree=2), Mine],
                          solvers=["random"], budget={"evaluations": 40}, options={"degree": 3})
    assert [(row["model"], row["state"]) for row in own.rows] == [
        ("mine, degree=2", "done"), ("mine", "done")]
    assert own.rows[0]["n_terms"] <= 12 < own.rows[1]["n_terms"]
    table = study.to_pandas()
    assert list(table.columns) == list(study.columns)
    assert len(table) == 4
    with pytest.raises(TermselError, match=r"data 'file' is no feature set\. Read it"):
        termsel.compare(data={"mine": scene, "file": "points.csv"})


@pytest.mark.parametrize(("text", "place", "said"), [
    (SMALL.replace("solvers", "solver"), "line 3, column 1", "unknown key of a study 'solver'"),
    (SMALL.replace('"swap"', '"swop"'), "line 3, column 22", "unknown solver 'swop'"),
    (SMALL.replace("degree", "degre"), "line 2, column 35", "unknown option 'degre'"),
    (SMALL.replace('"swap"', '{name = "swap", popul = 3}'), "line 3, column 38",
     "unknown option 'popul'"),
    (SMALL.replace("evaluations = 60", "evaluation = 60"), "line 6, column 1",
     "unknown key of the budget 'evaluation'"),
    (SMALL.replace("= 60", "= -1"), "line 6, column 1", "not positive"),
    (SMALL.replace("seeds = 2", 'seeds = "two"'), "line 4, column 1", "neither a whole number"),
    (SMALL.replace("seeds = 2", "seeds = 0"), "line 4, column 1", "0 seeds"),
    (SMALL + "[options]\npopulaton = 3\n", "line 8, column 1", "no run of the study has"),
    (SMALL + '[[data]]\npoints = "none*.csv"\n', "line 8, column 1", "no file matches 'none*.csv'"),
    (SMALL.replace("seeds = 2", "seeds = = 2"), "line 4, column 9", "this is not TOML"),
    (SMALL.replace('"swap"', '"random"'), "line 3, column 22", "has 'random' twice"),
    (SMALL.replace('["random", "swap", "exact"]', '[{name = "ga", population = "many"}]'),
     "line 3, column 26", "does not accept 'many'"),
    (SMALL + 'measure = "speed"\n', "line 7, column 1", "unknown key of the budget 'measure'"),
    (SMALL.replace("seeds = 2", "splits = 3"), "line 4, column 1", "all splits are the same"),
    (SMALL.replace("seeds", 'strategies = ["auto"]\nseeds'), "line 3, column 1",
     "the strategy auto chooses the method itself"),
    (SMALL.replace('"swap"', '{name = "ga-correlation", scale = 2.0}'), "line 3, column 48",
     "requires preset=own"),
    (SMALL.replace('"swap"', '{name = "ga-correlation", preset = "own"}'), "line 3, column 22",
     "preset=own requires scale and offset"),
])
def test_what_is_wrong_is_told_with_its_place(
        text: str, place: str, said: str, call: Call, tmp_path: Path) -> None:
    done = call("compare", _file(tmp_path, text), "--out", tmp_path / "out")
    assert done.exit_code == 2
    assert f"study.toml, {place}: " in done.stderr
    assert said in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_solver_that_cannot_handle_the_objectives_is_refused_before_anything_runs(
        call: Call, tmp_path: Path) -> None:
    text = SMALL.replace("degree = 2", 'degree = 2, objectives = "n_terms"')
    done = call("compare", _file(tmp_path, text), "--out", tmp_path / "out")
    assert done.exit_code == 2
    assert "cannot handle 2 objectives" in done.stderr
    assert "line 3, column 12" in done.stderr


@pytest.mark.parametrize(("words", "said"), [
    ([], "there is nothing to compare"),
    (["--problem", "poly-terms"], "--out is missing"),
    (["--problem", "poly-term", "--out", "x"], "unknown problem 'poly-term'"),
    (["--problem", "poly-terms", "--crs", "local", "--out", "x"], "--crs requires"),
    (["--points", "no.csv", "--out", "x"], "no file matches 'no.csv'"),
    (["nothing.toml", "--out", "x"], "nothing.toml: this file does not exist. Check the name"),
    (["a.toml", "b.toml", "--out", "x"], "there are 2 study files"),
    (["a.toml", "--seeds", "3", "--out", "x"], "exclude each other"),
    (["--status", "."], "no study in this folder"),
    (["--problem", "poly-terms", "--solver", "ga", "--export", "gif", "--out", "x"], "'gif'"),
])
def test_options_that_cannot_be_are_refused(words: list[str], said: str, call: Call, tmp_path: Path,
                                            monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    done = call("compare", *words)
    assert done.exit_code == 2
    assert said in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_places_are_found_in_all_forms_of_toml() -> None:
    text = ('a = [1, [2, 3.5]] # "x = 1"\n"b c" = """\nd = 1\n"""\n[t.u]\nv.w = {x = 1, y = [\n'
            '  "z",\n]}\n[[l]]\nm = 1\n[[l]]\n  m = \'#\'\n[l.n]\no = 1\n')
    known = places_of(text, None).known
    assert known[("a", 1, 1)] == (1, 13)
    assert known[("b c",)] == (2, 1)
    assert ("d",) not in known
    assert known[("t", "u", "v", "w", "y")] == (6, 15)
    assert known[("t", "u", "v", "w", "y", 0)] == (7, 3)
    assert known[("l", 1, "m")] == (12, 3)
    assert known[("l", 1, "n", "o")] == (14, 1)


def test_a_dry_run_shows_cells_and_time(call: Call, tmp_path: Path) -> None:
    done = call("compare", _file(tmp_path), "--dry-run")
    assert done.exit_code == 0
    lines = done.stdout.splitlines()
    assert [line.split()[-2] for line in lines[1:4]] == ["2", "2", "1"]
    assert "5 runs; about" in lines[-1]


def test_the_time_of_a_cell_is_that_without_compilation(monkeypatch: pytest.MonkeyPatch) -> None:
    seconds = {"random": iter([8.0, 0.25]), "ga": iter([25.0, 1.0])}
    monkeypatch.setattr(compare, "needs_compilation", lambda: False)
    monkeypatch.setattr(compare, "do", lambda work, features: SimpleNamespace(record=CellRecord(
        "k", "done", "", {"seconds": next(seconds[work.call["solver"]])}, [], [])))
    kinds = list(compare.estimate(problems=["poly-terms"], solvers=["random", "ga"], seeds=7))
    # A cell that takes long is not run twice.
    assert [kind[1:3] for kind in kinds] == [(7, 0.25), (7, 25.0)]
    # What it loads is no time of a cell, but one of the batch.
    assert [kind.loading for kind in kinds] == [7.75, 0.0]


@pytest.mark.parametrize("option", ["--seeds", "--splits"])
def test_options_have_the_limits_of_the_study_file(option: str, call: Call, tmp_path: Path) -> None:
    done = call("compare", "--problem", "poly-terms", option, 100_001, "--dry-run")
    assert done.exit_code == 2
    assert "at most 100,000" in done.stderr


def test_options_of_every_search_may_stand_next_to_a_solver() -> None:
    study = termsel.compare(
        problems=[{"name": "poly-terms", "degree": 2}], budget={"evaluations": 200},
        solvers=["random", {"name": "random", "polish": True, "label": "refined"}])
    alone, refined = study.rows
    assert alone["refinement_evaluations"] == 0 < refined["refinement_evaluations"]
    assert alone["optimum"] == refined["optimum"] <= refined["fitness"] <= alone["fitness"]


@pytest.mark.parametrize("content", [
    "{}", "[]", '{"study": {"seed": 1}, "cells": {}}',
    *(f'{{"study": {{"title": {"[" * n}{"]" * n}}}, "cells": {{}}, "workers": 1}}'
      for n in (300, 950))])
def test_the_plan_of_something_else_is_told(content: str, call: Call, tmp_path: Path) -> None:
    (tmp_path / "plan.json").write_text(content)
    done = call("compare", "--status", tmp_path)
    assert done.exit_code == 2
    assert re.search("this is not the plan of a study|nested too deeply", done.stderr)


@pytest.mark.slow
def test_a_study_is_read_again_from_its_folder_alone(tmp_path: Path) -> None:
    scene = termsel.prepare("poly-terms").features
    file = tmp_path / "points.csv"
    write_points_csv(scene.points, file, crs="local")
    out, again = tmp_path / "out", tmp_path / "again"
    asked: dict[str, Any] = {
        "title": "Again", "problems": [{"name": "poly-terms", "degree": 2}],
        "data": [{"points": str(file), "crs": "local"}], "splits": [0, 4],
        "solvers": [{"name": "ga", "population": 20, "label": "G"}, "random"], "seeds": 2,
        "budget": {"evaluations": 40}, "options": {"roles": "random"}, "measure": "check"}
    study = termsel.compare(**asked, out=out)
    file.unlink()
    found = termsel.read_study(out)
    assert (found.rows, found.columns, found.complete) == (study.rows, study.columns, True)
    one, other = ({key: value for key, value in vars(study.spec).items() if key != "places"}
                  for study in (found, study))
    assert one == other
    for folder, told in ((out, study), (again, found)):
        folder.mkdir(exist_ok=True)
        write_outputs(told, folder)
    for name in ("study.csv", "summary.md", "summary.tex"):
        assert (again / name).read_bytes() == (out / name).read_bytes()
    # A study that has only begun is read as well.
    (out / "journal.jsonl").write_bytes(b"")
    begun = termsel.read_study(out)
    assert {row["state"] for row in begun.rows} == {"waiting"}
    assert not begun.complete
    write_outputs(begun, again)
    with pytest.raises(TermselError, match="no study in this folder"):
        termsel.read_study(tmp_path)


def test_paths_and_numbers_of_numpy_are_those_of_a_study_file(tmp_path: Path) -> None:
    points = termsel.simulate_scene("ikonos-hamedan", n_points=12, n_lines=0)
    termsel.write_points_csv(points.points, tmp_path / "p.csv", points.crs)
    given = {"problems": [{"name": "poly-terms", "degree": np.int64(1)}], "solvers": ["all-terms"],
             "data": [{"points": tmp_path / "p.csv", "crs": "EPSG:4979"}],
             "seeds": np.arange(1, 3), "budget": {"evaluations": np.int64(5),
                                                  "seconds": np.float64(9)}}
    study = termsel.compare(given, out=tmp_path / "out")
    assert [row["state"] for row in study.rows] == ["done"]
    spec = termsel.read_study(tmp_path / "out").spec
    assert (spec.seeds, spec.budget) == ((1, 2), {"evaluations": 5, "seconds": 9.0})
    assert spec.data[0].files["points"] == (str(tmp_path / "p.csv"),)


def test_a_failing_cell_is_a_row_with_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    def explode(*_: Any, **__: Any) -> Any:
        raise ValueError("a plugin's fault")

    from termsel.studies.execution import work

    monkeypatch.setattr(work, "search_without_blunders", explode)
    study = termsel.compare(problems=["poly-terms"], solvers=["random"],
                            budget={"evaluations": 40}, options={"degree": 2})
    assert study.complete
    assert [(row["state"], row["reason"]) for row in study.rows] == [
        ("failed", "ValueError: a plugin's fault")]


@pytest.mark.slow
def test_cpu_seconds_are_those_of_all_threads() -> None:
    asked: dict[str, Any] = {"problems": [{"name": "rfm-terms", "order": 2}],
                             "solvers": ["exact"], "criteria": ["kfold"]}
    termsel.compare(**asked)  # loads what is compiled
    before = time.process_time()
    study = termsel.compare(**asked)
    spent = time.process_time() - before
    # The walk through all selections has a thread of its own; the rest is next to nothing.
    assert 0.5 * spent < study.rows[0]["cpu_seconds"] <= spent


def test_a_trace_counts_the_evaluations_of_all_searches_of_a_cell() -> None:
    trace = work._Trace(None)
    for evaluations, best in ((10, 4.0), (20, 3.0), (5, 6.0), (9, 5.0), (2, 8.0)):
        trace(Progress(None, evaluations, None, best, 0.0, np.zeros(0)))
    assert [point[:2] for point in trace.points] == [[31, 8.0]]
    trace.end(SimpleNamespace(evaluations=2, gains=((1, 9.0), (2, 7.0))))
    assert [point[:2] for point in trace.points] == [[30, 9.0], [31, 7.0]]


def test_a_cell_out_of_time_fails() -> None:
    study = termsel.compare(problems=["poly-terms"], solvers=["ga"], seeds=1,
                            budget={"generations": 100_000, "timeout": 0.05})
    assert study.rows[0]["state"] == "failed"
    assert "out of time" in study.rows[0]["reason"]


def test_bad_calls_from_python_are_refused() -> None:
    with pytest.raises(TermselError, match="0 workers"):
        termsel.compare(problems=["poly-terms"], workers=0)
    with pytest.raises(TermselError, match="unknown key of a study 'solver'"):
        termsel.compare(problems=["poly-terms"], solver="ga")
    with pytest.raises(TermselError, match="neither data nor a problem"):
        termsel.compare(solvers=["ga"])


@pytest.mark.slow
def test_the_study_files_of_the_documentation_can_be_planned(tmp_path: Path) -> None:
    for name in solver_table.STUDIES:
        cells = compare.plan_cells(*compare.requested_study(solver_table.HERE / f"{name}.toml", {}))
        seeds = 1 if name == "solver-table-exact" else 10
        assert {cell.labels["seed"] for cell in cells} == set(range(1, seeds + 1))
    accuracy.draw(tmp_path, ["ikonos-hamedan"], [20], 1)
    for name in accuracy.STUDIES:
        shutil.copy(accuracy.HERE / f"{name}.toml", tmp_path)
        cells = compare.plan_cells(*compare.requested_study(tmp_path / f"{name}.toml", {}))
        assert {cell.labels["strategy"] for cell in cells} == {"auto", "as-asked"}
        assert {accuracy.parts_of(cell.data.label) for cell in cells} == {("ikonos-hamedan", 20, 0)}


@pytest.mark.parametrize(("given", "says"), [
    ({"seeds": 1000, "splits": 2000}, "has 2,000,000 runs, and can have 500,000"),
    ({"solvers": [{"name": "random", "label": f"r{i}"} for i in range(3000)]},
     "has 3,000 combinations of problems and methods, and can have 1,000")])
def test_a_study_that_is_too_large_is_refused_before_it_is_planned(
        given: dict[str, Any], says: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cell, "_Kinds", None)  # nothing is planned
    asked = {"problems": ["poly-terms"], "solvers": ["random"], **given}
    with pytest.raises(TermselError, match=says):
        termsel.compare(**asked)


def test_a_long_search_for_files_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    from termsel.studies.plan import data

    told = Event()
    said: list[str] = []
    handler = logging.Handler()

    def emit(record: logging.LogRecord) -> None:
        said.append(record.getMessage())
        told.set()

    handler.emit = emit  # type: ignore[method-assign]
    monkeypatch.setattr(data.glob, "glob", lambda *_, **__: [] if told.wait(60) else ["late"])
    monkeypatch.setattr(data, "SOON", 0.01)
    data.log.addHandler(handler)
    try:
        with pytest.raises(TermselError, match="no file matches"):
            termsel.compare(data=[{"points": "**/*.csv", "crs": "local"}])
    finally:
        data.log.removeHandler(handler)
    assert "looking for files that match **/*.csv" in said[0]
