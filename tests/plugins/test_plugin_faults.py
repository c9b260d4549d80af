"""A table of faults of plugins: which fault, where it is caught, and what is said.

Each is written as an author might write it, in a class that differs from a sound one in one way.
Faults of hooks and imports are in test_plugins.py, those that only the suites find in
test_conformance_broken.py and test_conformance_kinds.py.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import termsel
from termsel.core.errors import TermselError
from termsel.core.isolation.faults import PluginFault
from termsel.data.datasets import DatasetSpec
from termsel.data.features import FeatureSet
from termsel.models.quotient import Blocks
from termsel.plugins.registry import Registry
from termsel.runs.run import run
from termsel.runs.searching import fit_of
from termsel.runs.task import Task, prepare
from termsel.selection.criteria import CheckRmse
from termsel.selection.problems.base import Evaluation, Problem, Selection
from termsel.selection.problems.genome import Genome
from termsel.selection.problems.recipes import Recipe
from termsel.selection.problems.segments import Bits
from termsel.selection.solvers.base import Generation, Solver
from termsel.selection.solvers.heuristics.yardsticks import RandomSearch
from termsel.selection.solvers.search import search
from tests.faulty import altered, always, leaving, raising, told_of


def _blocks(**changed: Any) -> Callable[..., Any]:
    def blocks(self: Any, ground: np.ndarray) -> Blocks:
        line = np.column_stack([np.ones(len(ground)), ground])
        return Blocks(**{"line": line, "sample": line,
                         **{name: change(line) for name, change in changed.items()}})
    return blocks


def _of_base(name: str, change: Callable[[Any], Any]) -> Callable[..., Any]:
    """Return a method that changes what termsel's own returns."""
    return lambda self, *args: change(getattr(termsel.Affine, name)(self, *args))


def _equations(**changed: Any) -> Callable[..., Any]:
    def change(found: termsel.Equations) -> termsel.Equations:
        parts = {name: getattr(found, name) for name in ("A", "b", "feature")}
        return termsel.Equations(**{name: changed.get(name, lambda part: part)(part)
                                    for name, part in parts.items()})
    return _of_base("equations", change)


def _nan_first(array: np.ndarray) -> np.ndarray:
    changed = array.copy()
    changed[0] = np.nan
    return changed


# A rational model: method, what is wrong with it, what is said.
RATIONAL = [
    ("blocks", raising, "failed in blocks(): ValueError: of the plugin"),
    ("blocks", leaving, "failed in blocks(): SystemExit: 3"),
    ("blocks", always(None), "blocks() returned nothing; expected Blocks"),
    ("blocks", always((1, 2)), "blocks() returned an object of type tuple; expected Blocks"),
    ("blocks", _blocks(line=lambda x: x.tolist()), "blocks() returned as line an object of type"),
    ("blocks", _blocks(line=lambda x: x[:, 0]), "returned as line an array of shape ("),
    ("blocks", _blocks(sample=lambda x: np.ones((len(x) + 1, 4))), "returned as sample an array"),
    ("blocks", _blocks(line=lambda x: x.astype(object)), "returned as line an array of object"),
    ("blocks", _blocks(line=lambda x: x + 1j), "returned as line an array of complex128"),
    ("blocks", _blocks(line=lambda x: x * np.nan), "returned as line 4 numbers that are not"),
    ("blocks", _blocks(sample=lambda x: None), "returned as sample an object of type NoneType"),
    ("blocks", _blocks(line_denominator=lambda x: x[:-1]), "returned as line_denominator an"),
    ("blocks", _blocks(line=lambda x: x[:, :1 + 3 * (len(x) > 1)]), "returned 4 columns of"),
    ("column_names", raising, "failed in column_names(): ValueError"),
    ("column_names", always("abcd"), "returned an object of type str; expected tuple"),
    ("column_names", always(7), "returned an object of type int; expected tuple"),
    ("column_names", always(("a", None, "b", "c")), "returned None as a name; expected text"),
    ("column_names", always(("a", "", "b", "c")), "returned '' as a name; expected text"),
    ("column_names", always(("a",)), "names 1 of 4 columns of 'line'"),
    ("column_names", always(("a", "a", "b", "c")), "gives two columns of 'line' one name"),
]

# A model of its own kind, otherwise the affine one.
MODEL = [
    ("terms", property(raising), "failed in terms(): ValueError"),
    ("terms", property(lambda _: ["line.num:1"]), "terms() returned ['line.num:1']; expected a"),
    ("terms", property(lambda _: ()), "terms() returned (); expected a tuple"),
    ("prepared", always(None), "prepared() returned nothing; expected SensorModel"),
    ("equations", raising, "failed in equations(): ValueError"),
    ("equations", always((1, 2, 3)), "equations() returned an object of type tuple; expected"),
    ("equations", _equations(A=lambda a: a[:, 1:]), "equations() returned as A an array of shape"),
    ("equations", _equations(b=lambda b: b[1:]), "equations() returned as b an array of shape"),
    ("equations", _equations(A=_nan_first), "equations() returned as A 8 numbers that are not"),
    ("equations", _equations(feature=lambda f: f[1:]), "equations() returned as feature an"),
    ("project", raising, "failed in project(): ValueError"),
    ("project", _of_base("project", lambda image: image[..., 0]), "project() returned an array"),
    ("project", _of_base("project", lambda image: image.tolist()), "project() returned an object"),
    ("predict", _of_base("predict", lambda image: image[..., :1]), "predict() returned an array"),
    ("axis", property(lambda _: "line"), "axis() returned an object of type str; expected an"),
    ("axis", property(lambda _: np.arange(8)), "axis() returned an array with other numbers than"),
    ("residual_weights", lambda self, control, ground: np.zeros((1, 1, 1)),
     "residual_weights() returned an array of shape (1, 1, 1)"),
    ("denominators", lambda self, coefficients, ground: np.ones(3), "denominators() returned an"),
    ("__init__", raising, "failed in __init__(): ValueError"),
]


class SoundRational(termsel.RationalModel):
    """A sound model."""

    name = "sound"
    blocks = _blocks()


@pytest.fixture(scope="module")
def scene() -> FeatureSet:
    return termsel.simulate_scene("ikonos-hamedan")


@pytest.mark.parametrize(("base", "method", "fault", "message"), [
    *((SoundRational, *row) for row in RATIONAL), *((termsel.Affine, *row) for row in MODEL)])
def test_faulty_model(base: type, method: str, fault: Any, message: str, scene: FeatureSet) -> None:
    model = altered(base, method, fault)
    with pytest.raises(TermselError) as caught:
        _use_model(model, scene)
    told_of(caught, message, "model 'faulty'" if method != "__init__" else "model")


def _use_model(model: Any, scene: FeatureSet) -> None:
    task = prepare("rfm-terms", features=scene, model=model, solver="all-terms")
    search(task.problem, RandomSearch(population=3), generations=1)
    termsel.fit(scene, model).project(scene.points.ground)


CRITERION = [
    (raising, "failed in score(): ValueError"),
    (leaving, "failed in score(): SystemExit: 3"),
    (always(None), "score() returned an object of type NoneType; expected an array"),
    (always(1.0), "score() returned an object of type float"),
    (lambda self, fits: np.ones(1)[:0], "score() returned an array of shape (0,)"),
    (lambda self, fits: np.ones((len(fits.terms), 1)), "score() returned an array of shape ("),
    (lambda self, fits: [1.0] * len(fits.terms), "score() returned an object of type list"),
    (lambda self, fits: np.full(len(fits.terms), "1"), "score() returned an array of <U1"),
    (lambda self, fits: np.full(len(fits.terms), 1j), "score() returned an array of complex128"),
]


@pytest.fixture(scope="module")
def task(scene: FeatureSet) -> Task:
    return prepare("poly-terms", features=scene, solver="random")


@pytest.mark.parametrize(("fault", "message"), CRITERION)
def test_faulty_criterion(fault: Any, message: str, task: Task) -> None:
    problem = task.problem.judged_by(altered(CheckRmse, "score", fault)())
    with pytest.raises(TermselError) as caught:
        search(problem, RandomSearch(population=4), generations=1)
    told_of(caught, message, "criterion 'faulty'")


@pytest.mark.parametrize("figure", [np.nan, np.inf, -np.inf])
def test_a_criterion_without_finite_figures_is_named_and_not_the_budget(
        figure: float, scene: FeatureSet) -> None:
    figures = altered(CheckRmse, "score", lambda self, fits: np.full(len(fits.terms), figure))
    result = run("rfm-terms", features=scene, model="affine", criterion=figures(),
                 solver="random", evaluations=200)
    screen = " ".join(result.summary().split())
    assert "do not use this fit: the criterion gives no finite figure for any selection" in screen
    assert "budget" not in screen
    assert "The criterion 'faulty' gives no finite figure" in result.judgement


@pytest.mark.parametrize(("score", "message"), [
    (raising, "failed in score(): ValueError"),
    (lambda selected: np.full(len(selected.terms), np.nan), "score() returned 4 numbers that are"),
    (always(None), "score() returned an object of type NoneType")])
def test_a_faulty_objective_is_called_by_its_name(score: Any, message: str, scene: FeatureSet,
                                                  monkeypatch: pytest.MonkeyPatch) -> None:
    get = Registry.get
    objective = termsel.Objective("spread-demo", "A figure.", score)
    monkeypatch.setattr(Registry, "get", lambda self, kind, name:
                        objective if kind == "objectives" else get(self, kind, name))
    task = prepare("poly-terms", features=scene, options={"objectives": "spread-demo"})
    with pytest.raises(PluginFault) as caught:
        task.problem.evaluate(task.problem.genome.random(np.random.default_rng(1), 4))
    told_of(caught, message, "objective 'spread-demo' of ")
    assert caught.value.file is not None
    assert caught.value.line is not None


class Sound(Problem):
    """As many genes on as possible."""

    objectives: Any = ("off",)
    genome = Genome([Bits("s", tuple("abcdef"))])

    def evaluate(self, genes: np.ndarray) -> Evaluation:
        return Evaluation((~genes).sum(axis=1)[:, None].astype(float), np.zeros(len(genes)))

    def decode(self, genes: np.ndarray) -> Selection:
        return Selection(tuple(np.array(list("abcdef"))[genes]), ())


def _yields(change: Callable[[int, np.ndarray, Evaluation], Any]) -> Callable[..., Any]:
    def generations(self: Any, problem: Problem, rng: np.random.Generator) -> Iterator[Any]:
        for index in range(3):
            genes = problem.genome.random(rng, 5)
            yield change(index, genes, problem.evaluate(genes))
    return generations


def _asks(change: Callable[[np.ndarray], Any]) -> Callable[..., Any]:
    def generations(self: Any, problem: Problem, rng: np.random.Generator) -> Iterator[Any]:
        genes = change(problem.genome.random(rng, 5))
        yield Generation(0, genes, problem.evaluate(genes))
    return generations


def _late(index: int, genes: np.ndarray, found: Evaluation) -> Generation:
    return Generation(index, genes, found) if index < 2 else raising()


SOLVER = [
    (raising, "failed in generations(): ValueError"),
    (leaving, "failed in generations(): SystemExit: 3"),
    (_yields(_late), "failed in generations(): ValueError"),
    (always(None), "failed in generations(): TypeError: 'NoneType' object is not iterable"),
    (always([]), "evaluated nothing"),
    (_yields(lambda i, g, e: None), "generations() yielded nothing; expected Generation"),
    (_yields(lambda i, g, e: (i, g, e)), "yielded an object of type tuple; expected Generation"),
    (_yields(lambda i, g, e: Generation(-1, g, e)), "yielded the index -1; expected a whole"),
    (_yields(lambda i, g, e: Generation("0", g, e)), "yielded the index '0'; expected a whole"),
    (_yields(lambda i, g, e: Generation(i, g[:, 1:], e)), "type bool and the shape (5, 5)"),
    (_yields(lambda i, g, e: Generation(i, g.tolist(), e)), "genes of the type list; expected"),
    (_yields(lambda i, g, e: Generation(i, g, e.objectives)), "type ndarray; expected Evaluation"),
    (_yields(lambda i, g, e: Generation(i, g, e.take(np.arange(2)))), "objectives an array of sh"),
    (_yields(lambda i, g, e: Generation(i, g, Evaluation(e.objectives * np.nan, e.violation))),
     "5 numbers that are not finite"),
    (_yields(lambda i, g, e: Generation(i, g[:0], e.take(np.arange(0)))), "of no individuals"),
    (_yields(lambda i, g, e: Generation(i, g, e, [1])), "yielded details that are no mapping"),
    (_asks(lambda g: g.astype(float)), "asks for an evaluation of"),
    (_asks(lambda g: g[:, :3]), "asks for an evaluation of"),
    (_asks(lambda g: g[0]), "asks for an evaluation of"),
    (_asks(lambda g: "all"), "asks for an evaluation of"),
]


@pytest.mark.parametrize(("fault", "message"), SOLVER)
def test_faulty_solver(fault: Any, message: str) -> None:
    with pytest.raises(TermselError) as caught:
        search(Sound(), altered(Solver, "generations", fault)(), generations=5)
    told_of(caught, message, "solver 'faulty'")


def _evaluates(objectives: Callable[[np.ndarray], Any],
               violation: Callable[[int], Any] = np.zeros) -> Callable[..., Any]:
    return lambda self, genes: Evaluation(objectives(genes.sum(axis=1)[:, None] * 1.0),
                                          violation(len(genes)))


PROBLEM = [
    ("evaluate", raising, "failed in evaluate(): ValueError"),
    ("evaluate", leaving, "failed in evaluate(): SystemExit: 3"),
    ("evaluate", always(None), "evaluate() returned nothing; expected Evaluation"),
    ("evaluate", lambda self, genes: genes.sum(axis=1), "evaluate() returned an object of type"),
    ("evaluate", _evaluates(lambda x: x[:, 0]), "returned as objectives an array of shape (4,)"),
    ("evaluate", _evaluates(lambda x: x[1:]), "returned as objectives an array of shape (3, 1)"),
    ("evaluate", _evaluates(lambda x: x / 0), "numbers that are not finite; expected finite"),
    ("evaluate", _evaluates(lambda x: x, lambda n: 0.0), "returned as violation an object of"),
    ("evaluate", _evaluates(lambda x: x, lambda n: np.full(n, np.inf)), "violation 4 numbers"),
    ("decode", raising, "failed in decode(): ValueError"),
    ("decode", always(["a"]), "decode() returned an object of type list; expected Selection"),
    ("decode", always(Selection(["a"], ())), "decode() returned as terms ['a']; expected a"),
    ("decode", always(Selection((), (1, 2))), "decode() returned as features (1, 2); expected"),
    ("genome", None, "the genome of problem 'Faulty' is None, not a Genome"),
    ("genome", property(raising), "failed in genome(): ValueError"),
    ("objectives", None, "are None, not a tuple of names"),
    ("objectives", "off", "are 'off', not a tuple of names"),
    ("objectives", (), "are (), not a tuple of names"),
]


@pytest.mark.parametrize(("method", "fault", "message"), PROBLEM)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_faulty_problem(method: str, fault: Any, message: str) -> None:
    problem = altered(Sound, method, fault)()
    with pytest.raises(TermselError) as caught:
        problem.decode(search(problem, RandomSearch(population=4), generations=1).genes)
    told_of(caught, message, "problem")


@pytest.mark.parametrize(("method", "solver", "message"), [
    ("parts", "exact", "parts() returned [1]; expected a tuple of EnumerablePart"),
    ("design", "ga-correlation", "design() returned an object of type list; expected an array")])
def test_faulty_columns_of_a_problem(method: str, solver: str, message: str) -> None:
    made = altered(Sound, method, always([1]))()
    with pytest.raises(PluginFault) as caught:
        search(made, termsel.get("solvers", solver)(), generations=1)
    told_of(caught, message, "problem")


@pytest.mark.parametrize(("given", "message"), [
    ({"options": ({"name": "x"},)}, "recipe 'faulty' has the option {'name': 'x'}"),
    ({"control": "planes"}, "recipe 'faulty' has the control 'planes'")])
def test_recipe_that_cannot_be(given: dict[str, Any], message: str) -> None:
    with pytest.raises(TermselError, match=re.escape(message)):
        Recipe("faulty", "A recipe.", raising, model="affine", dataset="ikonos-hamedan", **given)


def test_faulty_rpc(scene: FeatureSet) -> None:
    model = altered(termsel.Affine, "as_rpc", always(5))
    with pytest.raises(PluginFault) as caught:
        run("poly-terms", features=scene, model=model, solver="all-terms").to_rpc()
    told_of(caught, "as_rpc() returned an object of type int; expected Rpc", "model 'faulty'")


def test_a_selection_of_names_that_there_are_not(task: Task) -> None:
    with pytest.raises(TermselError, match=r"unknown term 'nobody'.*report it to its author"):
        fit_of(task, Selection(("nobody",), task.observations.control.ids))


@pytest.mark.parametrize(("build", "message"), [
    (raising, "raising of the module tests failed in build(): ValueError"),
    (leaving, "failed in build(): SystemExit: 3"),
    (always(None), "build() returned nothing; expected Problem")])
def test_faulty_recipe(build: Any, message: str) -> None:
    recipe = Recipe("faulty", "A recipe.", build, model="affine", dataset="ikonos-hamedan")
    with pytest.raises(PluginFault) as caught:
        prepare(recipe)
    told_of(caught, message)


@pytest.mark.parametrize(("load", "message"), [
    (raising, "raising of the module tests failed in load(): ValueError"),
    (leaving, "failed in load(): SystemExit: 3"),
    (always([1, 2]), "load() returned an object of type list; expected FeatureSet")])
def test_faulty_data_set(load: Any, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    get = Registry.get
    spec = DatasetSpec("faulty", "A data set.", load)
    monkeypatch.setattr(Registry, "get", lambda self, kind, name:
                        spec if kind == "datasets" else get(self, kind, name))
    with pytest.raises(PluginFault) as caught:
        prepare("poly-terms", dataset="faulty")
    told_of(caught, message)


def test_faulty_attribute_that_is_computed(scene: FeatureSet) -> None:
    solver = type("Faulty", (RandomSearch,), {
        "__module__": __name__, "name": "faulty", "uses_all": property(raising)})
    with pytest.raises(PluginFault) as caught:
        prepare("poly-terms", features=scene, solver=solver)
    told_of(caught, "failed in uses_all(): ValueError", "solver 'faulty'")


def test_the_table_is_long_enough() -> None:
    rows = [*RATIONAL, *MODEL, *CRITERION, *SOLVER, *PROBLEM]
    assert len(rows) >= 63


def test_a_fault_ends_the_command_with_exit_code_2(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        call: Callable[..., SimpleNamespace]) -> None:
    faulty = altered(termsel.Affine, "equations", raising)
    get = Registry.get
    monkeypatch.setattr(Registry, "get", lambda self, kind, name:
                        faulty if kind == "models" else get(self, kind, name))
    done = call("run", "--problem", "rfm-terms", "--model", "x", "--out", tmp_path / "r")
    assert done.exit_code == 2
    assert "faulty.py, line " in done.stderr
    assert "model 'faulty' of the module tests failed in equations(): ValueError" in done.stderr
    assert "Traceback" not in done.stderr
