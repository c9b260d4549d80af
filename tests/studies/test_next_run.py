"""After a study of searches: the page begins with a chart and ends with a command that works."""

from __future__ import annotations

import re
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import termsel
from termsel.cli.main import cli
from termsel_studies import report
from termsel_studies.next_run import next_command
from termsel_studies.report import first_chart


def words_of(line: str) -> list[str]:
    """Return what is typed of a line "Next: termsel ...   (why)"."""
    assert line.startswith("Next: termsel run ")
    return shlex.split(line.removeprefix("Next: ").partition("   (")[0])[1:]


@pytest.fixture(scope="module")
def study() -> termsel.Study:
    return termsel.compare(
        problems=[{"name": "poly-terms", "degree": 2}], seeds=2, budget={"evaluations": 60},
        solvers=["random", {"name": "ga", "population": 20}, "exact"])


def test_the_command_repeats_the_best_run(
        study: termsel.Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    exact = replace(study, cells={key: cell for key, cell in study.cells.items()
                                  if cell["solver"] == "exact"})
    line = next_command(exact)
    assert line.endswith("(exact, its best run)")
    # exact takes no budget of evaluations from the command line.
    done = CliRunner().invoke(cli, words_of(line))
    assert done.exit_code == 0, done.output
    best = min(row["fitness"] for row in study.rows)
    assert termsel.read_result(Path("best")).objectives["check-rmse"] == pytest.approx(best)


def test_options_seeds_and_budgets_are_those_of_the_method(study: termsel.Study) -> None:
    searches = replace(study, cells={key: cell for key, cell in study.cells.items()
                                     if str(cell["solver"]).startswith("ga")})
    words = words_of(next_command(searches))
    best = min(searches.rows, key=lambda row: row["fitness"])
    assert words == ["run", "--problem", "poly-terms", "--solver", "ga", "--set", "degree=2",
                     "--set", "population=20", "--seed", str(best["seed"]),
                     "--evaluations", "60", "--out", "best"]


def test_data_from_python_have_no_command() -> None:
    ground = np.random.default_rng(1).uniform(0, 4000, (30, 3))
    features = termsel.FeatureSet(termsel.Points(
        [f"P{i}" for i in range(30)], 0.5 * ground[:, :2], ground), crs="local")
    study = termsel.compare(problems=["poly-terms"], solvers=["random"], seeds=1,
                            data={"mine": features}, budget={"evaluations": 20})
    assert next_command(study) == ""


def test_the_page_begins_with_a_chart_and_ends_with_the_command(study: termsel.Study) -> None:
    pytest.importorskip("altair")
    pytest.importorskip("vl_convert")
    page = report(study)
    assert page.index('<figure id="convergence">') < page.index("<h2")
    assert page.count('<figure id="convergence">') == 1
    last = re.findall(r"<section.*?</section>", page, re.DOTALL)[-1]
    assert "termsel run --problem poly-terms" in last
    assert "best selection RMSE [px]" in page
    assert first_chart([]) is None
