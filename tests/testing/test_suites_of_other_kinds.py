"""Suites for problems, data sets, objectives, commands and plugins, on sound and broken ones."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest

import termsel
from termsel.cli.list import list_
from termsel.core.errors import TermselError
from termsel.data.datasets import DatasetSpec
from termsel.data.features import FeatureSet, Points
from termsel.formats.readers.csv_tables import PointsCsv
from termsel.models.polynomial import Affine
from termsel.selection.criteria import CheckRmse
from termsel.selection.problems.base import Evaluation, Problem, Selection
from termsel.selection.problems.genome import Genome
from termsel.selection.problems.objectives import (
    OBJECTIVES,
    Objective,
    PopulationSelection,
    n_terms,
)
from termsel.selection.problems.recipes import RECIPES, Recipe
from termsel.selection.problems.segments import Bits
from termsel.selection.solvers.heuristics.yardsticks import RandomSearch
from termsel.simulate.scenes import DATASETS
from termsel.testing import Check, cases, check, checks

SOME = [recipe for recipe in RECIPES if recipe.name in ("poly-terms", "owdis-points")]


@pytest.mark.slow
@pytest.mark.parametrize("recipe", SOME, ids=lambda recipe: recipe.name)
def test_built_in_problems(recipe: Recipe) -> None:
    check(recipe)


@pytest.mark.parametrize("check", [*checks(DATASETS[0]),
                                   *checks(termsel.get("datasets", "old-map")),
                                   *checks(list_, words=["models"]),
                                   *checks(list_, words=["nothing"])],
                         ids=lambda check: check.name)
def test_built_in_data_sets_and_commands(check: Check) -> None:
    check.run()


class Sound(Problem):
    """As many genes on as possible."""

    objectives: Any = ("off",)
    genome = Genome([Bits("s", tuple("abcdef"))])

    def evaluate(self, genes: np.ndarray) -> Evaluation:
        return Evaluation((~genes).sum(axis=1)[:, None].astype(float), np.zeros(len(genes)))

    def decode(self, genes: np.ndarray) -> Selection:
        return Selection(tuple(np.array(self.genome.labels)[genes].tolist()), ())


class Letters(Sound):
    objectives = "off"


class Flat(Sound):
    def evaluate(self, genes: np.ndarray) -> Evaluation:
        return Evaluation((~genes).sum(axis=1).astype(float), np.zeros(len(genes)))


class Negative(Sound):
    def evaluate(self, genes: np.ndarray) -> Evaluation:
        return replace(super().evaluate(genes), violation=np.full(len(genes), -1.0))


class Counting(Sound):
    calls = 0

    def evaluate(self, genes: np.ndarray) -> Evaluation:
        Counting.calls += 1
        found = super().evaluate(genes)
        return replace(found, objectives=found.objectives + Counting.calls)


class Ranking(Sound):
    def evaluate(self, genes: np.ndarray) -> Evaluation:
        found = super().evaluate(genes)
        return replace(found, objectives=found.objectives - found.objectives.mean())


class Guessing(Sound):
    def evaluate_near(self, genes: np.ndarray, near: np.ndarray) -> Evaluation:
        return self.evaluate(np.repeat(near[None], len(genes), axis=0))


class Scribbling(Sound):
    def evaluate(self, genes: np.ndarray) -> Evaluation:
        genes[:, 0] = ~genes[:, 0]
        return super().evaluate(genes)


class Unclear(Sound):
    def decode(self, genes: np.ndarray) -> Any:
        return ["a"]


class Twice(Sound):
    def decode(self, genes: np.ndarray) -> Selection:
        return Selection(("a", "a"), ())


class Impossible(Sound):
    def evaluate(self, genes: np.ndarray) -> Evaluation:
        return replace(super().evaluate(genes), violation=np.ones(len(genes)))


class Closed(Sound):
    def __init__(self) -> None:
        self.file = open(__file__)  # noqa: SIM115


@pytest.mark.parametrize(("broken", "name", "message"), [
    (Letters, "declaration", "objectives must be a tuple of different names, not 'off'"),
    (Flat, "evaluation_holds", r"returned as objectives an array of shape \(12,\); expected"),
    (Negative, "evaluation_holds", "violations must be 0 or above"),
    (Counting, "deterministic", "differs from one call or process to the next"),
    (Ranking, "one_by_one", "otherwise alone than among others"),
    (Guessing, "neighbours_alike", "evaluate_near.. differs from evaluate"),
    (Scribbling, "inputs_unchanged", "changes the genes; work on a copy"),
    (Unclear, "decodes", "must return a Selection, not list"),
    (Twice, "decodes", "names one of the terms twice"),
    (Impossible, "searched", "no individual of 300 random ones is feasible"),
    (Closed, "deterministic", "cannot be sent to another process")])
def test_broken_problem(broken: Callable[[], Problem], name: str, message: str) -> None:
    _require_found(checks(broken), name, message)
    (sound,) = [check for check in checks(Sound) if check.name == name]
    sound.run()


def _require_found(found: tuple[Check, ...], name: str, message: str) -> None:
    (check,) = [check for check in found if check.name == name]
    with pytest.raises(AssertionError, match=message):
        check.run()


def _five(crs: str = "local", ids: str = "abcde", seed: int | None = 1) -> FeatureSet:
    ground = np.random.default_rng(seed).uniform(0, 1000, (len(ids), 3))
    return FeatureSet(Points(tuple(ids), ground[:, :2] / 2, ground), crs=crs)


@pytest.mark.parametrize(("load", "name", "message"), [
    (lambda: None, "loads_features", "must return a FeatureSet, not NoneType"),
    (FeatureSet, "loads_features", "no points and no lines"),
    (lambda: _five(crs=""), "ground_in_crs", "states no crs"),
    (lambda: _five(crs="EPSG:999999"), "ground_in_crs", "EPSG:999999"),
    (lambda: _five(seed=None), "alike_each_time", "two calls of load.. differ"),
    (lambda: _five(ids="abc"), "enough_of_them", "it has 3 features"),
    (lambda: 1 / 0, "loads_features", "ZeroDivisionError was raised")])
def test_broken_data_set(load: Callable[[], Any], name: str, message: str) -> None:
    _require_found(checks(DatasetSpec("d", "A data set.", load)), name, message)
    (sound,) = [check for check in checks(DatasetSpec("d", "A data set.", _five))
                if check.name == name]
    sound.run()


def _command(**given: Any) -> click.Command:
    return click.Command("c", **{"help": "Do a thing.", "callback": lambda: None, **given})


def _raise(error: BaseException) -> None:
    raise error


@pytest.mark.parametrize(("command", "name", "message"), [
    (click.Command(None), "declaration", "no name"),
    (click.Command("c"), "declaration", "says nothing of itself"),
    (_command(params=[click.Option(["--x"])]), "help_page", "the option --x has no help"),
    (_command(context_settings={"ignore_unknown_options": True, "allow_extra_args": True}),
     "unknown_option", "ends with exit code 0, not 2"),
    (_command(callback=lambda: 1 / 0), "runs", "raises ZeroDivisionError"),
    (_command(callback=lambda: _raise(SystemExit(7))), "runs", "exit code 7, not 0 or 2")])
def test_broken_command(command: Any, name: str, message: str) -> None:
    _require_found(checks(command), name, message)


@pytest.mark.parametrize("objective", OBJECTIVES, ids=lambda objective: objective.name)
def test_built_in_objectives(objective: Objective) -> None:
    check(objective)


def _column(selected: PopulationSelection) -> np.ndarray:
    return n_terms(selected)[:, None]


def _infinite_for_nothing(selected: PopulationSelection) -> np.ndarray:
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / n_terms(selected))


def _of_points(selected: PopulationSelection) -> np.ndarray:
    return np.asarray(selected.features @ selected.control.points.image[:, 0])


def _random(selected: PopulationSelection) -> np.ndarray:
    return n_terms(selected) + np.random.default_rng().random()


def _ranks(selected: PopulationSelection) -> np.ndarray:
    return np.argsort(np.argsort(selected.features.sum(axis=1))).astype(float)


def _clears(selected: PopulationSelection) -> np.ndarray:
    found = n_terms(selected)
    selected.terms[:] = False
    return found


@pytest.mark.parametrize(("objective", "name", "message"), [
    (Objective("many words", "Terms.", n_terms), "declaration", "with the name 'many words'"),
    (Objective("n", " ", n_terms), "declaration", "it says nothing of itself"),
    (Objective("n", "N.", _column), "figure_each", r"an array of shape \(8, 1\); expected"),
    (Objective("n", "N.", _infinite_for_nothing), "figure_each", "numbers that are not finite"),
    (Objective("n", "N.", _of_points), "control_kinds", "ValueError was raised"),
    (Objective("n", "N.", _random), "deterministic", "differs from one call or process"),
    (Objective("n", "N.", lambda s: n_terms(s)), "deterministic", "cannot be sent to another"),
    (Objective("n", "N.", _ranks), "one_by_one", "among others an individual gets"),
    (Objective("n", "N.", _clears), "inputs_unchanged", "changes selected.terms; work on a copy")])
def test_broken_objective(objective: Objective, name: str, message: str) -> None:
    _require_found(checks(objective), name, message)
    (sound,) = [one for one in checks(OBJECTIVES[0]) if one.name == name]
    sound.run()


@pytest.mark.parametrize(("thing", "name"), [
    (Affine, "recovery_from_lines"), (Affine(), "recovery_from_lines"),
    (RandomSearch, "interruptible"), (RandomSearch(), "interruptible"),
    (CheckRmse, "smaller_is_better"), (CheckRmse(), "smaller_is_better"),
    (RECIPES[0], "decodes"), (Sound, "decodes"), (Sound(), "decodes"),
    (DATASETS[0], "ground_in_crs"), (OBJECTIVES[0], "figure_each"), (list_, "unknown_option"),
    ("termsel-demo", "modest_import")])
def test_the_suite_of_a_thing_is_recognised(thing: Any, name: str) -> None:
    assert name in [one.name for one in checks(thing)]


def test_what_checks_cannot_take() -> None:
    with pytest.raises(TermselError, match="there are no checks of 3"):
        checks(3)
    with pytest.raises(TermselError, match=r"the checks of models: .*'content'"):
        checks(Affine, content=b"")
    with pytest.raises(TermselError, match=r"the checks of readers: missing .*'content'"):
        checks(PointsCsv)


def test_a_check_has_a_limit_of_time(monkeypatch: pytest.MonkeyPatch) -> None:
    went_on = []

    class Slow(CheckRmse):
        name = "slow"

        def score(self, fits: Any) -> np.ndarray:
            time.sleep(60)
            went_on.append(True)
            return super().score(fits)

    monkeypatch.setattr(cases, "LIMIT", 0.3)
    _require_found(checks(Slow), "score_shape", "score_shape: slow: it takes more than 0")
    assert not went_on


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Return a function that installs the package "checked" with this code."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))

    def install(code: str) -> None:
        monkeypatch.delitem(sys.modules, "checked", raising=False)
        (tmp_path / "checked.py").write_text(code)
        info = tmp_path / "checked-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: checked\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text("[termsel]\nchecked = checked\n")

    return install


SOUND = """
from termsel import Affine, hookimpl
class Mine(Affine):
    '''An affine model.'''
    name = 'mine'
@hookimpl
def termsel_models(): return [Mine]
"""


@pytest.mark.slow_cases(
    "code4-modest_import-prints .'hi'.", "code5-modest_import-changes .'the working folder'.",
    "code6-modest_import-numpy's random numbers", "code7-modest_import-of warnings")
@pytest.mark.parametrize(("code", "name", "message"), [
    (f"import no_such{SOUND}", "loads", "cannot be imported"),
    (SOUND.replace("'mine'", "'rfm'"), "loads", "a name that termsel has too"),
    (SOUND.replace("[Mine]", "[Mine()]"), "loads", "return the class"),
    (SOUND.replace("'''An affine model.'''", ""), "provides", "it says nothing of itself"),
    (f"print('hi'){SOUND}", "modest_import", "prints .'hi'."),
    (f"import os; os.chdir('/'){SOUND}", "modest_import", "changes .'the working folder'."),
    (f"import numpy; numpy.random.seed(1){SOUND}", "modest_import", "numpy's random numbers"),
    (f"import warnings; warnings.simplefilter('error'){SOUND}", "modest_import", "of warnings")])
def test_broken_plugin(package: Callable[[str], None], code: str, name: str, message: str) -> None:
    package(code)
    _require_found(checks("checked"), name, message)


@pytest.mark.slow
def test_sound_plugin_and_one_that_is_not_there(package: Callable[[str], None]) -> None:
    package(SOUND)
    check("checked")
    _require_found(checks("no-such"), "installed", "no-such is not installed")
    _require_found(checks("numpy"), "installed", "no entry point in the group 'termsel'")


def test_the_first_of_two_copies_of_a_plugin_counts(
        package: Callable[[str], None], tmp_path: Path) -> None:
    package(SOUND)
    # As a virtual environment has it that sees the packages of the system.
    shutil.copytree(tmp_path / "checked-1.0.dist-info", tmp_path / "checked-0.9.dist-info")
    (loads,) = [check for check in checks("checked") if check.name == "loads"]
    loads.run()
