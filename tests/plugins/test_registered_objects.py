"""Classes, instances and recipes where names are; what is registered; optimisers of one's own."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import termsel
from termsel import (
    Criterion,
    Fits,
    Generation,
    Objective,
    Option,
    Polynomial2D,
    PopulationSelection,
    Problem,
    Recipe,
    Result,
    SelectionProblem,
    Solver,
    TermselError,
    read_result,
)
from termsel.data.record.figures import as_plain_data
from termsel.plugins.registry import Registry, registry
from termsel.results.result import Result as Record


class Crossed(Polynomial2D):
    """A polynomial of degree 2 without squares."""

    name = "crossed"
    declared_options = (Option("degree", 2, "Total degree.", int, 1, 8),
                        Option("squares", True, "Whether squares are among the terms.", bool))

    @property
    def exponents(self):  # type: ignore[no-untyped-def, override]
        own = Polynomial2D(degree=self.options["degree"]).exponents
        return tuple(e for e in own if self.options["squares"] or max(e) < 2)


class Worst(Criterion):
    """The largest check error [px]."""

    name = "worst"
    is_rmse = False

    def score(self, fits: Fits) -> np.ndarray:
        return np.asarray(np.linalg.norm(fits.check_errors, axis=-1).max(axis=-1))


class Hundred(Solver):
    """A hundred random selections."""

    name = "hundred"
    ends_by_itself = True

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        genes = problem.genome.random(rng, 100)
        yield Generation(0, genes, problem.evaluate(genes))


RECIPE = Recipe("crossed-terms", "Which terms of a polynomial without squares to use.",
                lambda inputs: SelectionProblem(inputs, terms=True, features=False),
                model="poly2d", dataset="ikonos-hamedan", model_options={"degree": 3})


@pytest.fixture
def fresh(monkeypatch: pytest.MonkeyPatch) -> Iterator[Registry]:
    """A registry of its own, so that nothing registered here is known to other tests."""
    registry.cache_clear()
    yield registry()
    registry.cache_clear()


def same(one: Record, other: Record) -> bool:
    return one.selection == other.selection and one.rmse == other.rmse


@pytest.mark.slow
def test_instances_classes_and_names_run_alike() -> None:
    by_name = termsel.run("poly-terms", model="poly2d", solver="random", criterion="press",
                          options={"degree": 2, "population": 30}, generations=1)
    names = registry()
    for model, solver, criterion, options in [
            (Polynomial2D, names.get("solvers", "random"), names.get("criteria", "press"),
             {"degree": 2, "population": 30}),
            (Polynomial2D(degree=2), names.get("solvers", "random")(population=30),
             names.get("criteria", "press")(), {})]:
        result = termsel.run(names.get("problems", "poly-terms"), model=model, solver=solver,
                             criterion=criterion, options=options, generations=1,
                             dataset=names.get("datasets", "ikonos-hamedan"))
        assert same(result, by_name)
        assert result.options == by_name.options
        assert not result.plugins


def test_what_no_plugin_provides_runs_and_its_record_says_so(
        fresh: Registry, tmp_path: Path) -> None:
    result = termsel.run(RECIPE, model=Crossed(degree=3, squares=False), solver=Hundred,
                         criterion=Worst(), out=tmp_path / "out")
    assert result.problem == "crossed-terms"
    assert "line.num:X2" not in result.fit.model.terms
    assert result.objectives["worst"] > 0
    assert as_plain_data(result.plugins["model"]) == {"name": "session:crossed", "version": "",
                                                      "class": f"{__name__}.Crossed"}
    assert set(result.plugins) == {"problem", "model", "solver", "criterion"}
    assert f"call termsel.register({__name__}.Crossed)" in " ".join(result.notes)

    with pytest.raises(TermselError, match=f"is the class {__name__}.Crossed, which no plugin "
                                           "provides") as error:
        read_result(tmp_path / "out")
    assert "termsel.register" in str(error.value.hint)
    termsel.register(Crossed)
    again = read_result(tmp_path / "out")
    ground = result.features.points.ground
    np.testing.assert_allclose(again.project(ground), result.project(ground), atol=1e-9)


def test_a_result_of_a_model_with_other_terms_is_refused(fresh: Registry, tmp_path: Path) -> None:
    termsel.register(Crossed)
    termsel.run("poly-terms", model="crossed", solver="all-terms", out=tmp_path)

    class Other(Crossed):
        """Other terms under the same name."""

        @property
        def terms(self) -> tuple[str, ...]:
            return tuple(f"{name}b" for name in super().terms)

    termsel.register(Other)
    with pytest.raises(TermselError, match=r"the installed model has no term '.*', which is in "
                                           "the record: the model is not the one of the run. "
                                           r"The run used the class .*\.Crossed as it was then"):
        read_result(tmp_path)


def test_a_name_that_is_registered_works_like_any(fresh: Registry) -> None:
    assert termsel.register(Crossed) is Crossed
    termsel.register(Hundred)
    termsel.register(RECIPE)
    named = termsel.run("crossed-terms", model="crossed", solver="hundred",
                        options={"degree": 3, "squares": False})
    assert same(named, termsel.run(RECIPE, model=Crossed(degree=3, squares=False),
                                   solver=Hundred()))
    assert termsel.fit(named.features, "crossed", degree=1).adjustment.n_terms == 6
    termsel.register(Crossed)  # the cell of a notebook is run again
    assert fresh.names("models").count("crossed") == 1


def test_a_registered_name_that_is_taken_has_the_session_before_it(fresh: Registry) -> None:
    class Affine(Polynomial2D):
        """Another affine."""

        name = "affine"

    termsel.register(Affine)
    termsel.register(Affine)
    assert fresh.get("models", "affine") is termsel.Affine
    assert fresh.get("models", "session:affine") is Affine
    assert fresh.names("models").count("session:affine") == 1


def test_fit_takes_what_run_takes() -> None:
    scene = termsel.simulate_scene("ikonos-hamedan")
    fitted = termsel.fit(scene, Crossed, squares=False)
    assert fitted.adjustment.n_terms == 8
    assert termsel.fit(scene, Crossed(squares=False)).adjustment.n_terms == 8


@pytest.mark.parametrize(("given", "said"), [
    ({"model": Hundred}, "is no model: the class Hundred, not a subclass of SensorModel"),
    ({"model": termsel.SensorModel}, "is no model: the class SensorModel, which lacks"),
    ({"solver": 3}, "solver is 3, expected a name, a class or a termsel.Solver"),
    ({"criterion": Crossed}, "is no criterion"),
    ({"dataset": Path()}, "expected a name or a termsel.DatasetSpec"),
    ({"problem": Crossed}, "expected a name or a termsel.Recipe"),
    ({"model": Crossed(), "options": {"degree": 3}},
     "option 'degree' is for the model 'crossed', which has its options already"),
])
def test_what_is_not_of_the_kind_is_refused(given: dict[str, object], said: str) -> None:
    with pytest.raises(TermselError) as error:
        termsel.prepare(**{"problem": "poly-terms", **given})  # type: ignore[arg-type]
    assert said in str(error.value)


def test_nothing_that_could_be_named_cannot_be_registered() -> None:
    with pytest.raises(TermselError, match="'x' is nothing that termsel has names for"):
        termsel.register("x")


def descended(task: termsel.Task) -> np.ndarray:
    """An optimiser of one's own: switch single genes while that helps."""
    genes = task.problem.genome.random(np.random.default_rng(3), 1)
    best = task.problem.evaluate(genes)
    for gene in [*range(task.problem.genome.size)] * 2:
        other = genes.copy()
        other[0, gene] ^= True
        judged = task.problem.evaluate(other)
        if (judged.violation[0], judged.objectives[0, 0]) < (best.violation[0],
                                                             best.objectives[0, 0]):
            genes, best = other, judged
    return np.asarray(genes[0])


def test_any_optimiser_gets_a_result() -> None:
    task = termsel.prepare("poly-terms", options={"degree": 2})
    genes = descended(task)
    result = termsel.assess(termsel.GivenGenes(genes), task)
    assert isinstance(result, Result)
    assert result.selection == task.problem.decode(genes).record()
    assert result.objectives["check-rmse"] == pytest.approx(result.rmse["check"].total)
    assert (result.solver, result.options.solver, result.evaluations) == ("given", {}, 1)
    assert "how they were found is not recorded" in " ".join(result.notes)
    assert "solver given" in result.summary(verbose=True)


@pytest.mark.parametrize("wrong", [lambda genes: genes.astype(int), lambda genes: genes[:-1],
                                   lambda genes: genes[None], lambda genes: list(genes)[:3]])
def test_assess_refuses_genes_of_another_kind(wrong) -> None:  # type: ignore[no-untyped-def]
    task = termsel.prepare("poly-terms", options={"degree": 2})
    genes = task.problem.genome.random(np.random.default_rng(1), 1)[0]
    with pytest.raises(TermselError, match="assess got genes of the type"):
        termsel.assess(termsel.GivenGenes(wrong(genes)), task)


def farthest_pair(selected: PopulationSelection) -> np.ndarray:
    """Number of features that are not the first, of each individual."""
    return np.asarray(selected.features[:, 1:].sum(axis=1), dtype=float)


def test_an_objective_that_is_registered_is_minimised(fresh: Registry) -> None:
    termsel.register(Objective("others", "Number of features but the first.", farthest_pair))
    result = termsel.run("owdis-points", solver="nsga2", generations=3,
                         options={"objectives": "others, n_features", "population": 20,
                                  "polish": False})
    assert list(result.objectives) == ["check-rmse", "others", "n_features"]
    first = result.features.points.ids[result.features.points.roles.index("control")]
    chosen = result.selection.features
    assert result.objectives["others"] == len(chosen) - (first in chosen)
    assert "others" in fresh.names("objectives")


@pytest.mark.parametrize("score", [lambda selected: np.zeros(1), lambda selected: None,
                                   lambda selected: np.full(len(selected.terms), np.nan)])
def test_figures_of_another_shape_are_refused(fresh: Registry, score) -> None:  # type: ignore[no-untyped-def]
    termsel.register(Objective("odd", "No figure for each.", score))
    with pytest.raises(TermselError, match=r"score\(\) returned"):
        termsel.run("poly-terms", solver="nsga2", options={"objectives": "odd"}, generations=1)


def test_an_unknown_objective_names_those_there_are() -> None:
    with pytest.raises(TermselError, match="unknown objective 'n_term'"):
        termsel.prepare("poly-terms", solver="nsga2", options={"objectives": "n_term"})


def test_options_of_terms_for_another_recipe() -> None:
    options = {option.name: option for option in termsel.term_options(max_share=0.5)}
    assert options["max_share"].default == 0.5
    assert "mask" in options
    with pytest.raises(TermselError, match="unknown option 'max_shore'"):
        termsel.term_options(max_shore=0.5)


@pytest.mark.usefixtures("fresh")
def test_a_second_step_by_a_solver_of_ones_own_is_recorded() -> None:
    @termsel.register
    class Again(type(termsel.prepare("poly-terms", solver="random").solver)):
        name = "random-again"

    result = termsel.run("owdis-lines-terms", evaluations=60, options={
        "steps": "features-first", "then": "random-again", "order": 1})
    assert result.plugins["then"].name == "session:random-again"
    assert "solver" not in result.plugins
