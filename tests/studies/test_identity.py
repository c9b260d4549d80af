"""A study never mixes what has one name and is not the same."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

import termsel
from termsel import Generation, Solver
from termsel.core.files.names import JOURNAL
from termsel.plugins.registry import registry
from termsel.studies.cells.identity import checksum_of_code
from termsel.studies.cells.journal import _checksum_of_text, _seal_record, read_journal

FEW: dict[str, Any] = {"seeds": 1, "budget": {"evaluations": 60}}


def _solver(size: int) -> type[Solver]:
    class Mine(Solver):
        name = "mine"

        def generations(self, problem: Any, rng: Any) -> Iterator[Generation]:
            genes = problem.genome.random(rng, size)
            yield Generation(0, genes, problem.evaluate(genes))

    return Mine


def test_a_recipe_whose_content_changed_runs_again(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    recipe = registry().get("problems", "poly-terms")
    for degree in (1, 1, 3):
        caplog.clear()
        problem = replace(recipe, model_options={"degree": degree})
        asked = termsel.compare(problems=[problem], solvers=["swap"], out=tmp_path, **FEW)
        fresh = termsel.compare(problems=[problem], solvers=["swap"], **FEW)
        assert asked.rows[0]["fitness"] == fresh.rows[0]["fitness"]
        assert ("1 finished run repeated" in caplog.text) == (degree == 3)
        assert ("keeps 1 finished run of other data" in caplog.text) == (degree == 3)


def test_a_class_made_anew_under_its_name_runs_again(tmp_path: Path) -> None:
    counts = [termsel.compare(problems=["poly-terms"], solvers=[_solver(size)], out=tmp_path,
                              options={"degree": 2, "polish": False}, **FEW).rows[0]["evaluations"]
              for size in (2, 20)]
    assert counts == [2, 20]


def test_an_optimum_is_that_of_its_own_model() -> None:
    both = {"problems": ["poly-terms"], "criteria": ["press"], "options": {"polish": False}, **FEW}
    models = [termsel.Polynomial2D(degree=2), termsel.Polynomial2D(degree=1)]
    together = termsel.compare(models=models, solvers=["random"], **both).rows
    proven = [termsel.compare(models=[one], solvers=["exact"], **both).rows[0]["optimum"]
              for one in models]
    assert [row["optimum"] for row in together] == pytest.approx(proven)
    assert proven[0] < proven[1]


def test_code_of_a_package_that_changed_is_not_the_same(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    sums = []
    for name, factor in (("first_try", 2), ("second_try", 2), ("second_try", 3)):
        (tmp_path / name).mkdir(exist_ok=True)
        (tmp_path / name / "__init__.py").write_text("class Mine:\n    name = 'mine'\n")
        (tmp_path / name / "helper.py").write_text(f"FACTOR = {factor}\n")
        termsel.studies.cells.identity._source_checksum.cache_clear()  # as in a new process
        monkeypatch.delitem(sys.modules, name, raising=False)
        sums.append(checksum_of_code(__import__(name).Mine))
    assert len(set(sums)) == 3


@pytest.mark.parametrize(("one", "other"), [
    (partial(max, default=1), partial(max, default=2)),
    (termsel.Polynomial2D(degree=1), termsel.Polynomial2D(degree=2)),
    (_solver(1), _solver(2)),
    ({"a": [1.0]}, {"a": [2.0]}),
    (lambda x: x + 1, lambda x: x + 2),
])
def test_what_differs_has_another_checksum_and_what_does_not_the_same(one: Any, other: Any) -> None:
    assert checksum_of_code(one) != checksum_of_code(other)
    assert checksum_of_code(one) == checksum_of_code(one)
    assert checksum_of_code(_solver(4)) == checksum_of_code(_solver(4))


@pytest.mark.parametrize("text", [
    'solvers = [{name = "swap", label = "a\\u001bb"}]', 'problems = ["a\\u0000b"]',
    f'solvers = [{{name = "swap", label = "{400 * "x"}"}}]', f"problems = {900 * '['}",
    f"seeds = {20_000 * '9'}", f"{50_000 * 'a.'}a = 1"])
def test_labels_and_files_that_no_study_has_are_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(text)
    with pytest.raises(termsel.TermselError, match=r"not a study file|control characters"):
        termsel.compare(tmp_path / "study.toml")


@pytest.mark.parametrize("forged", ['[1]', '"cell"', '{"schema":"termsel-study-1"}',
                                    '{"schema":"termsel-study-1","versions":[1]}'])
def test_a_forged_or_flipped_line_costs_itself_alone(forged: str, tmp_path: Path) -> None:
    asked: dict[str, Any] = {"problems": ["poly-terms"], "solvers": ["random"], "out": tmp_path,
                             **FEW}
    rows = termsel.compare(**asked).rows
    head, line = (tmp_path / JOURNAL).read_text().splitlines()
    text = f'{{"record":{forged},"sha256":"{_checksum_of_text(forged)}"}}'
    for lines in ([head, text, line], [head.replace("schema", "schemb"), line]):
        (tmp_path / JOURNAL).write_text("\n".join([*lines, ""]))
        assert "damaged in 1 line" in read_journal(tmp_path).remarks[0]
        assert termsel.compare(**asked).rows[0]["seconds"] == rows[0]["seconds"]


@pytest.mark.parametrize("forged", [
    {"figures": {"fitness": "good"}}, {"figures": {"notes": [1]}}, {"figures": {"mine": 1.0}},
    {"figures": {"seconds": None}}, {"trace": [[1.0]]}, {"front": [[]]}, {"state": "best"},
    {"front": [[1.0, 2.0], [1.0, 2.0, 3.0]]}, {"\ud800": 1}, {"figures": {"\ud800": 1}}])
def test_a_record_that_no_run_writes_is_refused(forged: dict[str, Any], tmp_path: Path) -> None:
    asked: dict[str, Any] = {"problems": ["poly-terms"], "solvers": ["random"], "out": tmp_path,
                             **FEW}
    first = termsel.compare(**asked).rows
    head, line = (tmp_path / JOURNAL).read_text().splitlines()
    record = json.loads(line)["record"]
    record = {**record, **forged,
              "figures": {**record["figures"], **forged.get("figures", {})}}
    (tmp_path / JOURNAL).write_text(head + "\n" + _seal_record(record).decode())
    assert "damaged in 1 line" in read_journal(tmp_path).remarks[0]
    again = termsel.compare(**asked).rows
    assert again[0]["fitness"] == first[0]["fitness"]
    assert again[0]["seconds"] != first[0]["seconds"]
