"""Problems with the set-ups of papers: their data, rates and stopping rules; all can be set."""

from __future__ import annotations

import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

import termsel
from termsel.cli.main import cli
from termsel.plugins.registry import registry
from termsel.simulate import simulate_scene

ROOT = Path(__file__).parents[2]
NAMES = ("valadan-zoej-2002", "zakaryaie-2015", "yavari-2018", "akhoundi-2020")


def counts(task: termsel.Task) -> tuple[int, int, int]:
    seen = task.observations
    return len(seen.control), len(seen.check), len(seen.independent)


@pytest.mark.parametrize(("name", "sizes", "genes", "solver", "options"), [
    ("valadan-zoej-2002", (63, 31, 100), 2 * 16, "ga", {"parents": "two-best"}),
    ("zakaryaie-2015", (35, 39, 100), 21, "ica", {
        "population": 100, "imperialists": 0.1, "revolution": 0.1, "alpha": 0.08}),
    ("yavari-2018", (120, 24, 26), 120 + 78, "ga", {}),
    ("akhoundi-2020", (24, 24, 26), 78, "ga-correlation", {
        "population": 500, "mutation": 0.001, "preset": "case-3"})])
def test_a_paper_has_its_own_set_up(name: str, sizes: tuple[int, ...], genes: int, solver: str,
                                    options: dict[str, object]) -> None:
    task = termsel.prepare(name)
    assert counts(task) == sizes
    assert task.problem.genome.size == genes
    assert task.solver.name == solver
    assert options.items() <= task.solver.options.items()
    assert task.criterion.name == "check-rmse"
    assert task.options["problem"]["max_share"] == 1.0
    assert not task.options["search"]["polish"]


@pytest.mark.slow_cases("yavari-2018")
@pytest.mark.parametrize("name", NAMES)
def test_a_paper_just_runs(name: str) -> None:
    result = termsel.run(name, generations=2)
    assert result.polish is None
    assert set(result.rmse) == {"control", "check", "independent"}


@pytest.mark.slow
def test_a_paper_ends_by_its_stopping_rule() -> None:
    result = termsel.run("zakaryaie-2015", options={"degree": 4, "population": 40})
    best = [one.best for one in result.history]
    assert result.generations == len(best) - 1
    assert best[-1] == best[-51]
    assert best[-52] > best[-51]
    assert termsel.run("zakaryaie-2015", patience=5, options={"population": 40}).generations \
        < result.generations


def test_everything_of_a_paper_can_be_set() -> None:
    task = termsel.prepare("zakaryaie-2015", dataset="spot-isfahan-25-10", solver="ga",
                           criterion="press", options={"degree": 4, "mask": "per-axis",
                                                       "mutation": 0.02, "polish": True})
    assert task.problem.genome.size == 2 * 15
    # Population as its table 3 has it for the genetic algorithm.
    assert (task.solver.options["population"], task.solver.options["mutation"]) == (50, 0.02)
    assert task.options["search"]["polish"]
    assert len(task.observations.independent) == 100


def test_steps_of_a_paper_can_be_joined() -> None:
    usual = termsel.prepare("yavari-2018")
    assert usual.then is not None
    assert (usual.options["problem"]["steps"], usual.then.name) == ("features-first", "pso")
    joint = termsel.prepare("yavari-2018", options={"steps": "joint"})
    assert joint.then is None
    assert joint.options["problem"]["then"] is None


@pytest.mark.parametrize(("name", "sizes"), [
    ("ikonos-hamedan-63-31", (63, 31)), ("ikonos-hamedan-20-74", (20, 74)),
    ("irs1c-mashad-40-22", (40, 22)), ("ikonos-hamedan-27-47", (27, 47)),
    ("ikonos-hamedan-35-39", (35, 39)), ("spot-isfahan-18-17", (18, 17)),
    ("spot-isfahan-25-10", (25, 10))])
def test_data_sets_have_the_papers_numbers_of_points(name: str, sizes: tuple[int, int]) -> None:
    task = termsel.prepare("poly-terms", dataset=name)
    assert counts(task) == (*sizes, 100)
    assert task.source == f"{name} (simulated)"


def test_roles_of_a_scene_are_counted_out() -> None:
    points = simulate_scene("geoeye-tehran", roles=(5, 3, 2), n_lines=0).points
    assert [points.roles.count(role) for role in ("control", "check", "independent")] == [5, 3, 2]
    for wrong in ({"roles": (5, -1, 2)}, {"roles": (1, 1, 1), "n_points": 3}):
        with pytest.raises(termsel.TermselError, match="cannot be simulated"):
            simulate_scene("geoeye-tehran", **wrong)


def test_a_description_has_the_set_up() -> None:
    text = CliRunner().invoke(cli, ["describe", "zakaryaie-2015"]).output
    for part in ("--set population=100", "--set alpha=0.08", "With ga:", "--set population=50",
                 "50 generations without a gain", "poly2d --set degree=5",
                 "ikonos-hamedan-35-39"):
        assert part in text


def test_a_description_tells_no_default_that_is_none() -> None:
    options = {option.name: option for option in registry().get("problems", "yavari-2018").options}
    for name in ("max_share", "then"):
        assert options[name].default is not None
        assert "default" not in options[name].doc
    assert options["max_share"].doc.endswith("At least one degree of freedom is kept.")
    assert "By default" in options["objectives"].doc


@pytest.mark.slow
@pytest.mark.parametrize("name", ["valadan-zoej", "zakaryaie", "akhoundi", "yavari", "konugurthi"])
def test_the_tables_of_a_paper_are_made_by_one_command(name: str) -> None:
    made = subprocess.run([sys.executable, "-m", "benchmarks.paper_tables", name, "--runs", "1"],
                          cwd=ROOT, capture_output=True, text=True, check=True).stdout
    kept = (ROOT / "docs" / "evidence" / f"paper-{name}.md").read_text()
    headers = [line for line in kept.splitlines() if line.startswith(("#", "|--"))]
    assert [line for line in made.splitlines() if line.startswith(("#", "|--"))] \
        == [re.sub(r"\d+ runs on", "24 runs on", line) for line in headers]
    assert "nan" not in made


@pytest.mark.parametrize("wrong", [["yavary"], ["yavari", "--runs", "x"], ["--runs", "0"]])
def test_a_command_for_tables_that_cannot_be(wrong: list[str],
                                             monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT))
    monkeypatch.setattr(sys, "argv", ["paper_tables", *wrong])
    with pytest.raises(SystemExit, match="2"):
        runpy.run_module("benchmarks.paper_tables", run_name="__main__")
