"""A table of faults of plugins: which fault, where it is caught, and what is said.

Each is written as an author might write it, in a class that differs from a sound one in one way.
Faults of hooks and imports are in test_plugins.py, those that only the suites find in
test_conformance_broken.py and test_conformance_kinds.py.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import termsel
from termsel.criteria import CheckRmse
from termsel.errors import TermselError
from termsel.guard.faults import PluginFault
from termsel.io.export import export
from termsel.io.read import read_file
from termsel.measurements.datasets import DatasetSpec
from termsel.measurements.features import FeatureSet
from termsel.models.quotient import Blocks
from termsel.plugins.registry import Registry
from termsel.problems.base import Evaluation, Problem, Selection
from termsel.problems.genome import Genome
from termsel.problems.recipes import Recipe
from termsel.problems.segments import Bits
from termsel.results.result import Result
from termsel.runs.judgement.assess import fit_of
from termsel.runs.run import run
from termsel.runs.task.task import Task, prepare
from termsel.solvers.base import Generation, Solver
from termsel.solvers.heuristics.yardsticks import RandomSearch
from termsel.solvers.search import search

HERE = Path(__file__).name


def _raise(*_args: Any, **_given: Any) -> Any:
    raise ValueError("of the plugin")


def _leave(*_args: Any, **_given: Any) -> Any:
    sys.exit(3)


def _blocks(**changed: Any) -> Callable[..., Any]:
    def blocks(self: Any, ground: np.ndarray) -> Blocks:
        line = np.column_stack([np.ones(len(ground)), ground])
        return Blocks(**{"line": line, "sample": line,
                         **{name: change(line) for name, change in changed.items()}})
    return blocks


def _always(value: Any) -> Callable[..., Any]:
    return lambda *_args, **_given: value


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
    ("blocks", _raise, "failed in blocks(): ValueError: of the plugin"),
    ("blocks", _leave, "failed in blocks(): SystemExit: 3"),
    ("blocks", _always(None), "blocks() returned nothing; expected Blocks"),
    ("blocks", _always((1, 2)), "blocks() returned an object of type tuple; expected Blocks"),
    ("blocks", _blocks(line=lambda x: x.tolist()), "blocks() returned as line an object of type"),
    ("blocks", _blocks(line=lambda x: x[:, 0]), "returned as line an array of shape ("),
    ("blocks", _blocks(sample=lambda x: np.ones((len(x) + 1, 4))), "returned as sample an array"),
    ("blocks", _blocks(line=lambda x: x.astype(object)), "returned as line an array of object"),
    ("blocks", _blocks(line=lambda x: x + 1j), "returned as line an array of complex128"),
    ("blocks", _blocks(line=lambda x: x * np.nan), "returned as line 4 numbers that are not"),
    ("blocks", _blocks(sample=lambda x: None), "returned as sample an object of type NoneType"),
    ("blocks", _blocks(line_denominator=lambda x: x[:-1]), "returned as line_denominator an"),
    ("column_names", _raise, "failed in column_names(): ValueError"),
    ("column_names", _always(("a",)), "names 1 of 4 columns of 'line'"),
    ("column_names", _always(("a", "a", "b", "c")), "gives two columns of 'line' one name"),
]

# A model of its own kind, otherwise the affine one.
MODEL = [
    ("terms", property(_raise), "failed in terms(): ValueError"),
    ("terms", property(lambda _: ["line.num:1"]), "terms() returned ['line.num:1']; expected a"),
    ("terms", property(lambda _: ()), "terms() returned (); expected a tuple"),
    ("prepared", _always(None), "prepared() returned nothing; expected SensorModel"),
    ("equations", _raise, "failed in equations(): ValueError"),
    ("equations", _always((1, 2, 3)), "equations() returned an object of type tuple; expected"),
    ("equations", _equations(A=lambda a: a[:, 1:]), "equations() returned as A an array of shape"),
    ("equations", _equations(b=lambda b: b[1:]), "equations() returned as b an array of shape"),
    ("equations", _equations(A=_nan_first), "equations() returned as A 8 numbers that are not"),
    ("equations", _equations(feature=lambda f: f[1:]), "equations() returned as feature an"),
    ("project", _raise, "failed in project(): ValueError"),
    ("project", _of_base("project", lambda image: image[..., 0]), "project() returned an array"),
    ("project", _of_base("project", lambda image: image.tolist()), "project() returned an object"),
    ("predict", _of_base("predict", lambda image: image[..., :1]), "predict() returned an array"),
    ("axis", property(lambda _: "line"), "axis() returned an object of type str; expected an"),
    ("axis", property(lambda _: np.arange(8)), "axis() returned an array with other numbers than"),
    ("residual_weights", lambda self, control, ground: np.zeros((1, 1, 1)),
     "residual_weights() returned an array of shape (1, 1, 1)"),
    ("denominators", lambda self, coefficients, ground: np.ones(3), "denominators() returned an"),
    ("__init__", _raise, "failed in __init__(): ValueError"),
]


def _made(base: type, method: str, fault: Any, name: str = "faulty") -> Any:
    return type("Faulty", (base,), {"name": name, method: fault, "__module__": __name__,
                                    "__doc__": "Differs in one way."})


class SoundRational(termsel.RationalModel):
    """A sound model."""

    name = "sound"
    blocks = _blocks()


@pytest.fixture(scope="module")
def scene() -> FeatureSet:
    return termsel.simulate_scene("ikonos-hamedan")


def _said(fault: pytest.ExceptionInfo[TermselError], message: str, thing: str = "") -> None:
    assert message in str(fault.value)
    if isinstance(fault.value, PluginFault):
        assert thing in fault.value.what
        assert "of the module tests" in fault.value.what
        assert "tell its author" in str(fault.value.hint)


@pytest.mark.parametrize(("base", "method", "fault", "message"), [
    *((SoundRational, *row) for row in RATIONAL), *((termsel.Affine, *row) for row in MODEL)])
def test_faulty_model(base: type, method: str, fault: Any, message: str, scene: FeatureSet) -> None:
    model = _made(base, method, fault)
    with pytest.raises(TermselError) as caught:
        _use_model(model, scene)
    _said(caught, message, "model 'faulty'" if method != "__init__" else "model")


def _use_model(model: Any, scene: FeatureSet) -> None:
    task = prepare("rfm-terms", features=scene, model=model, solver="all-terms")
    search(task.problem, RandomSearch(population=3), generations=1)
    termsel.fit(scene, model).project(scene.points.ground)


CRITERION = [
    (_raise, "failed in score(): ValueError"),
    (_leave, "failed in score(): SystemExit: 3"),
    (_always(None), "score() returned an object of type NoneType; expected an array"),
    (_always(1.0), "score() returned an object of type float"),
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
    problem = task.problem.judged_by(_made(CheckRmse, "score", fault)())
    with pytest.raises(TermselError) as caught:
        search(problem, RandomSearch(population=4), generations=1)
    _said(caught, message, "criterion 'faulty'")


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
    return Generation(index, genes, found) if index < 2 else _raise()


SOLVER = [
    (_raise, "failed in generations(): ValueError"),
    (_leave, "failed in generations(): SystemExit: 3"),
    (_yields(_late), "failed in generations(): ValueError"),
    (_always(None), "failed in generations(): TypeError: 'NoneType' object is not iterable"),
    (_always([]), "evaluated nothing"),
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
    (_yields(lambda i, g, e: Generation(i, g, e, [1])), "yielded details that are no mapping"),
    (_asks(lambda g: g.astype(float)), "asks for an evaluation of"),
    (_asks(lambda g: g[:, :3]), "asks for an evaluation of"),
    (_asks(lambda g: g[0]), "asks for an evaluation of"),
    (_asks(lambda g: "all"), "asks for an evaluation of"),
]


@pytest.mark.parametrize(("fault", "message"), SOLVER)
def test_faulty_solver(fault: Any, message: str) -> None:
    with pytest.raises(TermselError) as caught:
        search(Sound(), _made(Solver, "generations", fault)(), generations=5)
    _said(caught, message, "solver 'faulty'")


def _evaluates(objectives: Callable[[np.ndarray], Any],
               violation: Callable[[int], Any] = np.zeros) -> Callable[..., Any]:
    return lambda self, genes: Evaluation(objectives(genes.sum(axis=1)[:, None] * 1.0),
                                          violation(len(genes)))


PROBLEM = [
    ("evaluate", _raise, "failed in evaluate(): ValueError"),
    ("evaluate", _leave, "failed in evaluate(): SystemExit: 3"),
    ("evaluate", _always(None), "evaluate() returned nothing; expected Evaluation"),
    ("evaluate", lambda self, genes: genes.sum(axis=1), "evaluate() returned an object of type"),
    ("evaluate", _evaluates(lambda x: x[:, 0]), "returned as objectives an array of shape (4,)"),
    ("evaluate", _evaluates(lambda x: x[1:]), "returned as objectives an array of shape (3, 1)"),
    ("evaluate", _evaluates(lambda x: x / 0), "numbers that are not finite; expected finite"),
    ("evaluate", _evaluates(lambda x: x, lambda n: 0.0), "returned as violation an object of"),
    ("evaluate", _evaluates(lambda x: x, lambda n: np.full(n, np.inf)), "violation 4 numbers"),
    ("decode", _raise, "failed in decode(): ValueError"),
    ("decode", _always(["a"]), "decode() returned an object of type list; expected Selection"),
    ("decode", _always(Selection(["a"], ())), "decode() returned as terms ['a']; expected a"),
    ("decode", _always(Selection((), (1, 2))), "decode() returned as features (1, 2); expected"),
    ("genome", None, "the genome of problem 'Faulty' is None, not a Genome"),
    ("genome", property(_raise), "failed in genome(): ValueError"),
    ("objectives", None, "are None, not a tuple of names"),
    ("objectives", "off", "are 'off', not a tuple of names"),
    ("objectives", (), "are (), not a tuple of names"),
]


@pytest.mark.parametrize(("method", "fault", "message"), PROBLEM)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_faulty_problem(method: str, fault: Any, message: str) -> None:
    problem = _made(Sound, method, fault)()
    with pytest.raises(TermselError) as caught:
        problem.decode(search(problem, RandomSearch(population=4), generations=1).genes)
    _said(caught, message, "problem")


@pytest.mark.parametrize(("method", "solver", "message"), [
    ("parts", "exact", "parts() returned [1]; expected a tuple of EnumerablePart"),
    ("design", "ga-correlation", "design() returned an object of type list; expected an array")])
def test_faulty_columns_of_a_problem(method: str, solver: str, message: str) -> None:
    made = _made(Sound, method, _always([1]))()
    with pytest.raises(PluginFault) as caught:
        search(made, termsel.get("solvers", solver)(), generations=1)
    _said(caught, message, "problem")


@pytest.mark.parametrize(("given", "message"), [
    ({"options": ({"name": "x"},)}, "recipe 'faulty' has the option {'name': 'x'}"),
    ({"control": "planes"}, "recipe 'faulty' has the control 'planes'")])
def test_recipe_that_cannot_be(given: dict[str, Any], message: str) -> None:
    with pytest.raises(TermselError, match=re.escape(message)):
        Recipe("faulty", "A recipe.", _raise, model="affine", dataset="ikonos-hamedan", **given)


def test_faulty_rpc(scene: FeatureSet) -> None:
    model = _made(termsel.Affine, "as_rpc", _always(5))
    with pytest.raises(PluginFault) as caught:
        run("poly-terms", features=scene, model=model, solver="all-terms").to_rpc()
    _said(caught, "as_rpc() returned an object of type int; expected Rpc", "model 'faulty'")


def test_a_selection_of_names_that_there_are_not(task: Task) -> None:
    with pytest.raises(TermselError, match=r"unknown term 'nobody'.*tell its author"):
        fit_of(task, Selection(("nobody",), task.observations.control.ids))


@pytest.mark.parametrize(("build", "message"), [
    (_raise, "_raise of the module tests failed in build(): ValueError"),
    (_leave, "failed in build(): SystemExit: 3"),
    (_always(None), "build() returned nothing; expected Problem")])
def test_faulty_recipe(build: Any, message: str) -> None:
    recipe = Recipe("faulty", "A recipe.", build, model="affine", dataset="ikonos-hamedan")
    with pytest.raises(PluginFault) as caught:
        prepare(recipe)
    _said(caught, message)


@pytest.mark.parametrize(("load", "message"), [
    (_raise, "_raise of the module tests failed in load(): ValueError"),
    (_leave, "failed in load(): SystemExit: 3"),
    (_always([1, 2]), "load() returned an object of type list; expected FeatureSet")])
def test_faulty_data_set(load: Any, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    get = Registry.get
    spec = DatasetSpec("faulty", "A data set.", load)
    monkeypatch.setattr(Registry, "get", lambda self, kind, name:
                        spec if kind == "datasets" else get(self, kind, name))
    with pytest.raises(PluginFault) as caught:
        prepare("poly-terms", dataset="faulty")
    _said(caught, message)


class Bars(termsel.Reader):
    """A sound reader."""

    name, summary = "bars", "points between bars"

    def sniff(self, path: Path, head: bytes) -> bool:
        return head.startswith(b"|")

    def read(self, path: Path) -> FeatureSet:
        return FeatureSet(termsel.Points(("a",), [[1.0, 2.0]], [[3.0, 4.0, 5.0]]))


def _readers(*readers: type[termsel.Reader]) -> list[type[termsel.Reader]]:
    return [*(entry.object for entry in Registry([]).entries("readers")), *readers]



# What a second reader does when it is asked about the file of the sound one; what is said.
SNIFF = [
    (_raise, "reader 'faulty' of the module tests failed in sniff(): ValueError"),
    (_leave, "failed in sniff(): SystemExit: 3"),
    (_always("yes"), "sniff() returned 'yes'; expected True or False"),
    (_always(None), "sniff() returned None; expected True or False"),
    (_always(True), "reader 'faulty' of the module tests recognises any file, so it is not used"),
]


@pytest.mark.parametrize(("fault", "message"), SNIFF)
def test_faulty_sniff_takes_no_file_of_another(
        fault: Any, message: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    file = tmp_path / "a.txt"
    file.write_text("|1|2|")
    faulty = _made(Bars, "sniff", fault)
    for readers in ([Bars, faulty], [faulty, Bars]):
        caplog.clear()
        assert read_file(file, _readers(*readers)).points.ids == ("a",)
        assert message in caplog.text


def test_two_readers_that_recognise_a_file(tmp_path: Path,
                                           caplog: pytest.LogCaptureFixture) -> None:
    file = tmp_path / "a.txt"
    file.write_text("|1|2|")
    other = _made(Bars, "extra", None, "other-bars")
    with pytest.raises(TermselError, match=r"several readers recognise this file: reader 'bars'"
                                           r".*--format bars or --format other-bars"):
        read_file(file, _readers(Bars, other))
    assert read_file(file, _readers(Bars, other), "other-bars").points.ids == ("a",)
    own = tmp_path / "b.csv"
    own.write_text("id,role,line,sample,x,y,z\np,,1,2,3,4,5\n")
    greedy = _made(Bars, "sniff", _always(True))
    assert read_file(own, _readers(greedy)).points.ids == ("p",)
    assert "reader 'faulty' of the module tests recognises b.csv too" in caplog.text


@pytest.mark.parametrize(("fault", "message"), [
    (_raise, "failed in read(): ValueError"), (_leave, "failed in read(): SystemExit: 3"),
    (_always(None), "read() returned nothing; expected FeatureSet"),
    (_always([1]), "read() returned an object of type list; expected FeatureSet"),
    (lambda self, path: FeatureSet(termsel.Points(("a", "a"), np.ones((2, 2)), np.ones((2, 3)))),
     "'a'")])
def test_faulty_read(fault: Any, message: str, tmp_path: Path) -> None:
    file = tmp_path / "a.txt"
    file.write_text("|1|2|")
    with pytest.raises(TermselError) as caught:
        read_file(file, _readers(_made(Bars, "read", fault)))
    _said(caught, message, "reader 'faulty'")


@pytest.mark.parametrize(("fault", "message"), [
    (_raise, "failed in placed(): ValueError"),
    (_always(None), "placed() returned nothing; expected TermselError")])
def test_faulty_place_of_an_error(fault: Any, message: str, tmp_path: Path,
                                  monkeypatch: pytest.MonkeyPatch) -> None:
    far = FeatureSet(termsel.Points(("a",), [[1.0, 2.0]], [[3.0, 400.0, 5.0]]), crs="EPSG:4979")
    reader = _made(_made(Bars, "read", _always(far)), "placed", fault)
    monkeypatch.setattr(Registry, "entries", lambda self, kind: [SimpleNamespace(object=reader)])
    (tmp_path / "a.txt").write_text("|")
    with pytest.raises(PluginFault) as caught:
        termsel.read(tmp_path / "a.txt")
    _said(caught, message, "reader 'faulty'")


def test_faulty_attribute_that_is_computed(scene: FeatureSet) -> None:
    solver = type("Faulty", (RandomSearch,), {
        "__module__": __name__, "name": "faulty", "uses_all": property(_raise)})
    with pytest.raises(PluginFault) as caught:
        prepare("poly-terms", features=scene, solver=solver)
    _said(caught, "failed in uses_all(): ValueError", "solver 'faulty'")


class Note(termsel.Writer):
    """A sound writer."""

    name, summary = "note", "a line of text"

    def accepts(self, result: Result) -> bool:
        return True

    def write(self, result: Result, path: Path) -> None:
        path.write_text("ok")


@pytest.fixture(scope="module")
def result(scene: FeatureSet) -> Result:
    return run("poly-terms", features=scene, solver="all-terms", options={"degree": 1})


@pytest.mark.parametrize(("method", "fault", "message"), [
    ("accepts", _raise, "failed in accepts(): ValueError"),
    ("accepts", _always(None), "accepts() returned None; expected True or False"),
    ("files", _always("a.txt"), "files() returned 'a.txt'; expected a tuple of paths"),
    ("files", _always(()), "files() returned (); expected a tuple of paths"),
    ("write", _raise, "failed in write(): ValueError"),
    ("write", _leave, "failed in write(): SystemExit: 3")])
def test_faulty_writer(method: str, fault: Any, message: str, result: Result, tmp_path: Path,
                       monkeypatch: pytest.MonkeyPatch) -> None:
    writer = _made(Note, method, fault)
    monkeypatch.setattr(Registry, "get", lambda self, kind, name: writer)
    with pytest.raises(PluginFault) as caught:
        export(result, "faulty", tmp_path / "a.txt")
    _said(caught, message, "writer 'faulty'")
    assert not list(tmp_path.iterdir())


def test_the_table_is_long_enough() -> None:
    rows = [*RATIONAL, *MODEL, *CRITERION, *SOLVER, *PROBLEM, *SNIFF]
    assert len(rows) >= 69


def test_a_fault_ends_the_command_with_exit_code_2(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        call: Callable[..., SimpleNamespace]) -> None:
    faulty = _made(termsel.Affine, "equations", _raise)
    get = Registry.get
    monkeypatch.setattr(Registry, "get", lambda self, kind, name:
                        faulty if kind == "models" else get(self, kind, name))
    done = call("run", "--problem", "rfm-terms", "--model", "x", "--out", tmp_path / "r")
    assert done.exit_code == 2
    assert f"{HERE}, line " in done.stderr
    assert "model 'faulty' of the module tests failed in equations(): ValueError" in done.stderr
    assert "Traceback" not in done.stderr
