"""The conformance suites find out models, solvers and criteria that are broken on purpose."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from termsel.adjustment.equations import Equations
from termsel.criteria import CheckRmse, Criterion, Fits
from termsel.errors import TermselError
from termsel.measurements.features import BoolArray, FeatureSet, FloatArray, IntArray
from termsel.measurements.scaling import Scaling
from termsel.models.polynomial import Affine, Polynomial2D
from termsel.models.quotient import Blocks, RationalModel
from termsel.models.rational import RationalFunctions
from termsel.options import Option
from termsel.problems import segments
from termsel.problems.base import Evaluation, Problem
from termsel.solvers.base import Generation, Solver
from termsel.solvers.genetic.ga import GeneticAlgorithm
from termsel.solvers.heuristics.yardsticks import RandomSearch
from termsel.solvers.ledger import Ledger
from termsel.testing import Check, check, checks
from termsel.testing.problems import bound


class Dlt(RationalModel):
    """Direct linear transformation, as a plugin author writes it."""

    name = "dlt-demo"

    def blocks(self, ground: FloatArray) -> Blocks:
        one = np.column_stack([np.ones(len(ground)), ground])
        return Blocks(line=one, sample=one, shared_denominator=ground)


# Broken models


class Undocumented(Dlt):
    declared_options = (Option("shift", 0.0, "", float),)


class SameNames(Affine):
    """Two terms of one name."""

    @property
    def terms(self) -> tuple[str, ...]:
        return (super().terms[1], *super().terms[1:])


class OtherNames(Affine):
    """Names of the terms of this very object."""

    @property
    def terms(self) -> tuple[str, ...]:
        return tuple(f"{id(self)}:{name}" for name in super().terms)


class ShortAxis(Affine):
    """An axis for some terms."""

    @property
    def axis(self) -> IntArray:
        return super().axis[1:]


class WrongAxis(Affine):
    """Line and sample mixed up."""

    @property
    def axis(self) -> IntArray:
        return 1 - super().axis


class NoLines(Dlt):
    """Control from points alone."""

    def equations(self, features: FeatureSet) -> Equations:
        if len(features.lines):
            raise TermselError("model 'dlt-demo' does not take control lines")
        return super().equations(features)


class OneRow(Affine):
    """A row too few."""

    def equations(self, features: FeatureSet) -> Equations:
        found = super().equations(features)
        return Equations(found.A[:-1], found.b[:-1], found.feature[:-1])


class NotFinite(Affine):
    """A row that is not finite."""

    def equations(self, features: FeatureSet) -> Equations:
        found = super().equations(features)
        found.A[0] = np.nan
        return found


class LinesFirst(Affine):
    """Features in another order."""

    def equations(self, features: FeatureSet) -> Equations:
        found = super().equations(features)
        return Equations(found.A, found.b, found.feature[::-1].copy())


class Scribbler(Affine):
    """Writes to the ground points."""

    def project(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        ground *= 2.0
        return super().project(coefficients, ground / 2.0)


class ScribblesFeatures(Affine):
    """Writes to the features, which are read-only."""

    def equations(self, features: FeatureSet) -> Equations:
        features.points.ground[:] = 0.0
        return super().equations(features)


class NoSteps(Affine):
    """A start without equations about a solution."""

    def start(self, features: FeatureSet) -> FloatArray:
        return np.zeros(len(self.terms))


class WrongProjection(Affine):
    """Line and sample exchanged in the projection alone."""

    def project(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        return super().project(coefficients, ground)[..., ::-1]


class Mingled(Affine):
    """Rows weighted by their place among the others."""

    def equations(self, features: FeatureSet) -> Equations:
        found = super().equations(features)
        weights = np.where(np.arange(len(found.b)) % 4 < 2, 1.0, 30.0)
        return replace(found, A=found.A * weights[:, None], b=found.b * weights)


class WrongLines(RationalFunctions):
    """The offset of image lines with the wrong sign."""

    def equations(self, features: FeatureSet) -> Equations:
        equations = super().equations(features)
        of_lines = equations.feature >= len(features.points)
        return replace(equations, b=np.where(of_lines, -equations.b, equations.b))


class NoConstant(Dlt):
    """No constant terms."""

    def blocks(self, ground: FloatArray) -> Blocks:
        return Blocks(line=ground, sample=ground)


class OneAtATime(Affine):
    """One set of coefficients alone."""

    def project(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        return super().project(coefficients.reshape(-1, len(self.terms))[0], ground)


class Relative(Affine):
    """Image positions that depend on the other sets of coefficients."""

    def project(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        image = super().project(coefficients, ground)
        return image - image.mean() if image.ndim > 2 else image


class Dice(Affine):
    """Noise in the equations."""

    def equations(self, features: FeatureSet) -> Equations:
        found = super().equations(features)
        found.b[0] += np.random.default_rng().normal()
        return found


class Settles(Affine):
    """Moves to the place it is prepared for."""

    def prepared(self, scaling: Scaling, crs: str) -> Settles:
        self.scaling, self.crs = scaling, crs
        return self


class Lambda(Affine):
    """Keeps a function."""

    def __init__(self) -> None:
        super().__init__()
        self.hook: Callable[[], int] = lambda: 1


class NeedsTerms(Affine):
    """Refuses to have few terms."""

    def project(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        if (np.count_nonzero(coefficients, axis=-1) < 3).any():
            raise ValueError("too few terms")
        return super().project(coefficients, ground)


class NotFlat(Affine):
    """Says it needs no heights."""

    uses_height = False


class Flat(Polynomial2D):
    """Says it needs heights."""

    uses_height = True


class TurnedWeights(Affine):
    """Weights with rows and columns exchanged."""

    def residual_weights(self, control: FloatArray, ground: FloatArray) -> FloatArray:
        return np.zeros((len(control), len(ground)))


BROKEN_MODELS = [
    (Undocumented, "declaration", "docstring"),
    (SameNames, "term_names", r"several are called line.num:X"),
    (OtherNames, "term_names", "the same names"),
    (ShortAxis, "axis", r"shape \(8,\).* not \(7,\)"),
    (WrongAxis, "axis", "'line.num:1' does not act on the line"),
    (NoLines, "control_kinds", "lines alone: model 'dlt-demo' does not take"),
    (OneRow, "equations",
     r"A must have shape \(24, 8\), two rows per point or line, not \(23, 8\)"),
    (NotFinite, "equations", "finite"),
    (LinesFirst, "equations", "feature must number"),
    (Scribbler, "inputs_unchanged", "changes the ground points"),
    (ScribblesFeatures, "inputs_unchanged", "read-only"),
    (NoSteps, "linearisation", "a start and no equations about a solution"),
    (WrongProjection, "exact_recovery", r"equations\(\) and project\(\) do not say the same"),
    (WrongLines, "recovery_from_lines", "misses points"),
    (Mingled, "fit", "do the equations of a point depend on other points"),
    (NoConstant, "translation", "constant term"),
    (OneAtATime, "project_shapes", r"must have shape \(1, 0, 2\), not \(0, 2\)"),
    (Relative, "batch_project", "alone than among others"),
    (Dice, "deterministic", "differ from one call"),
    (Settles, "prepared", "changes the model itself"),
    (Lambda, "picklable", "another process"),
    (NeedsTerms, "masks_stay_finite", "ValueError was raised: too few terms"),
    (NotFlat, "height", "uses_height is False, but"),
    (Flat, "height", "uses_height is True, but"),
    (TurnedWeights, "residual_weights", r"must have shape \(0, 8\), not \(8, 0\)"),
]


# Broken solvers


class Drawn(Solver):
    """Draws populations with `draw`; the broken ones differ from it in one way."""

    name = "drawn"

    def draw(self, problem: Problem, rng: np.random.Generator) -> BoolArray:
        return problem.genome.random(rng, 20)

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        index = 0
        while True:
            genes = self.draw(problem, rng)
            yield Generation(index, genes, problem.evaluate(genes))
            index += 1


class WrongDefault(Drawn):
    """An option whose default it does not take."""

    declared_options = (Option("population", 0, "How many.", int, 1),)

    def __init__(self) -> None:
        super().__init__(population=1)


class GlobalNumpy(Drawn):
    """Draws from numpy's global state."""

    def draw(self, problem: Problem, rng: np.random.Generator) -> BoolArray:
        return problem.genome.repair(np.random.rand(20, problem.genome.size) < 0.5, rng)


class GlobalPython(Drawn):
    """Draws from Python's global state, and puts it back."""

    def draw(self, problem: Problem, rng: np.random.Generator) -> BoolArray:
        state = random.getstate()
        genes = np.array([[random.random() < 0.5] * problem.genome.size for _ in range(20)])
        random.setstate(state)
        return problem.genome.repair(genes, rng)


class Remembers(Drawn):
    """Goes on where the last search ended."""

    count = 0

    def draw(self, problem: Problem, rng: np.random.Generator) -> BoolArray:
        self.count += 1
        return super().draw(problem, np.random.default_rng(self.count))


class Choosy(Drawn):
    """Needs two segments."""

    def draw(self, problem: Problem, rng: np.random.Generator) -> BoolArray:
        if len(problem.genome.segments) != 2:
            raise TermselError("two segments are needed")
        return super().draw(problem, rng)


class Integers(Drawn):
    """Sends zeros and ones."""

    def draw(self, problem: Problem, rng: np.random.Generator) -> Any:
        return super().draw(problem, rng).astype(int)


class Overreaching(Drawn):
    """Says that it handles whole numbers, and does not keep to their bounds."""

    segments = (segments.Bits, segments.Integers)

    def draw(self, problem: Problem, rng: np.random.Generator) -> Any:
        genes = super().draw(problem, rng)
        return genes if genes.dtype == np.bool_ else genes + 1


class Unrepaired(Drawn):
    """Disregards forced genes and cardinality."""

    def draw(self, problem: Problem, rng: np.random.Generator) -> BoolArray:
        return rng.random((20, problem.genome.size)) < 0.5


class Cuts(Drawn):
    """Cuts chromosomes between the first gene and the last."""

    def draw(self, problem: Problem, rng: np.random.Generator) -> BoolArray:
        rng.integers(1, problem.genome.size)
        return super().draw(problem, rng)


class ZeroIndex(Drawn):
    """Does not count."""

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        for generation in super().generations(problem, rng):
            yield Generation(0, generation.genes, generation.evaluation)


class InPlace(Drawn):
    """Yields one array again and again."""

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        genes = problem.genome.random(rng, 20)
        for generation in super().generations(problem, rng):
            genes[:] = generation.genes
            yield Generation(generation.index, genes, generation.evaluation)


class Shuffled(Drawn):
    """Evaluations in another order than genes."""

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        for generation in super().generations(problem, rng):
            yield Generation(generation.index, generation.genes[::-1], generation.evaluation)


class Deserted(Drawn):
    """A generation of nobody after the first."""

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        first = next(super().generations(problem, rng))
        yield first
        yield Generation(1, first.genes[:0], first.evaluation.take(np.arange(0)))


class Bypass(Drawn):
    """Evaluates behind the run's back."""

    def draw(self, problem: Problem, rng: np.random.Generator) -> BoolArray:
        if isinstance(problem, Ledger):
            problem.inner.evaluate(problem.genome.random(rng, 500))
        return super().draw(problem, rng)


class GivesUp(Drawn):
    """Ends by itself after one generation and does not say so."""

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        yield next(super().generations(problem, rng))


class Swallows(Drawn):
    """Carries on whatever happens."""

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        index = 0
        while True:
            genes = self.draw(problem, rng)
            try:
                evaluation = problem.evaluate(genes)
            except Exception:  # noqa: BLE001 - the fault to be found
                continue
            yield Generation(index, genes, evaluation)
            index += 1


class Stops(Drawn):
    """Ends quietly whatever happens, Ctrl-C included."""

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        try:
            yield from super().generations(problem, rng)
        except (Exception, KeyboardInterrupt):  # noqa: BLE001 - the fault to be found
            return


class Listed(Drawn):
    """No generator."""

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        genes = self.draw(problem, rng)
        return iter([Generation(0, genes, problem.evaluate(genes))])


class Undying(Drawn):
    """Cannot be closed."""

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        for generation in super().generations(problem, rng):
            try:
                yield generation
            except GeneratorExit:
                yield generation


class Reckless(GeneticAlgorithm):
    """Ranks by objectives alone."""

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        class Blind(Problem):
            genome, objectives = problem.genome, problem.objectives

            def evaluate(self, genes: BoolArray) -> Evaluation:
                found = problem.evaluate(genes)
                return Evaluation(found.objectives, np.zeros_like(found.violation))

            decode = problem.decode

        yield from super().generations(Blind(), rng)


class Scales(Drawn):
    """Divides by the range of the objectives."""

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        for generation in super().generations(problem, rng):
            cost = generation.evaluation.objectives
            _ = cost / np.ptp(cost)
            yield generation


class Boasts(Drawn):
    """Declares two objectives and handles the first."""

    max_objectives = 2

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        for generation in super().generations(problem, rng):
            found = generation.evaluation
            yield Generation(generation.index, generation.genes,
                             Evaluation(found.objectives[:, :1], found.violation))


BROKEN_SOLVERS = [
    (WrongDefault, "declaration", "option 'population' does not accept 0"),
    (ZeroIndex, "generations_hold", "number 1 has the index 0"),
    (InPlace, "generations_hold", "changed after it was yielded"),
    (Shuffled, "generations_hold", "not that of its genes"),
    (Deserted, "generations_hold", "generation 1 has no individuals"),
    (GlobalNumpy, "chance_from_rng_alone", "draws from the global random state"),
    (GlobalPython, "chance_from_rng_alone", "same seed differ"),
    (Remembers, "chance_from_rng_alone", "same seed differ"),
    (Choosy, "any_problem", "refuses a problem: two segments are needed"),
    (Overreaching, "typed_genomes", r"those of 'integers' have 4 for 'i1', which is from -2 to 3|"
                                    r"those of 'integers' have 101 for 'i2'"),
    (Integers, "genome_kept", r"evaluate\(\) got genes of the type int64 and the shape \(20, 18\)"),
    (Unrepaired, "genome_kept", "forced ones are switched"),
    (Cuts, "narrow_genomes", "ValueError was raised"),
    (Bypass, "evaluation_budget", "given 1 evaluations it takes 501"),
    (GivesUp, "evaluation_budget", "ends by itself after 20"),
    (ZeroIndex, "generation_budget", "the index of generations must rise, and was 0, 0, 0"),
    (Swallows, "errors_pass", "hides the end of the budget"),
    (Stops, "errors_pass", "hides the end of the budget"),
    (Listed, "closes", "must be a generator"),
    (Undying, "closes", "cannot be closed"),
    (Stops, "interruptible", "catches KeyboardInterrupt"),
    (Bypass, "best_never_worse", "does not return the best"),
    (Reckless, "feasible_first", "rank by violation before objectives"),
    (Scales, "hopeless_survived", "RuntimeWarning was raised"),
    (RandomSearch, "optimum_found", "a solver that does not search"),
    (Boasts, "objectives_respected", r"shape \(individuals, 2\)"),
]


# Broken criteria


class Undescribed(CheckRmse):
    name = "un described"


class Column(CheckRmse):
    """A column."""

    def score(self, fits: Fits) -> FloatArray:
        return super().score(fits)[:, None]


class LogOfNothing(CheckRmse):
    """Not a number for small errors."""

    def score(self, fits: Fits) -> FloatArray:
        score = super().score(fits)
        return np.where(score < 1.0, np.inf, score)


class LargerIsBetter(CheckRmse):
    """The inverse."""

    def score(self, fits: Fits) -> FloatArray:
        return 1.0 / super().score(fits)


class Saturates(CheckRmse):
    """Models that fit badly get one figure, however badly they fit."""

    def score(self, fits: Fits) -> FloatArray:
        found = super().score(fits)
        return np.minimum(found, np.median(found))


class Counts(CheckRmse):
    """Another figure each time."""

    calls = 0

    def score(self, fits: Fits) -> FloatArray:
        self.calls += 1
        return super().score(fits) + self.calls


class Ranks(CheckRmse):
    """Places among the models."""

    def score(self, fits: Fits) -> FloatArray:
        return np.argsort(np.argsort(super().score(fits))).astype(float)


class Squares(CheckRmse):
    """Squares the errors where they are."""

    def score(self, fits: Fits) -> FloatArray:
        errors = fits.check_errors
        errors *= errors
        return np.asarray(np.sqrt(errors.sum(axis=2).mean(axis=1)))


class Clears(CheckRmse):
    """Clears the coefficients."""

    def score(self, fits: Fits) -> FloatArray:
        score = super().score(fits)
        fits.coefficients[:] = 0.0
        return score


class NotAdditive(CheckRmse):
    """Has figures that do not add up over line and sample."""

    def score(self, fits: Fits) -> FloatArray:
        return np.asarray(np.median(np.sqrt((fits.check_errors**2).sum(axis=2)), axis=1))


BROKEN_CRITERIA: list[tuple[type[Criterion], str, str]] = [
    (Undescribed, "declaration", "text without blanks"),
    (Column, "score_shape", r"array of 4 figures, not float64 of shape \(4, 1\)"),
    (LogOfNothing, "score_finite", "must be finite"),
    (LargerIsBetter, "smaller_is_better", "ever larger figures"),
    (Saturates, "smaller_is_better", "ever larger figures"),
    (Counts, "deterministic", "differs from one call"),
    (Ranks, "one_by_one", "one by one"),
    (Squares, "inputs_unchanged", "changes fits.check_errors"),
    (Clears, "inputs_unchanged", "changes fits.coefficients"),
    (NotAdditive, "subset_score_agrees", "another one has"),
]


# They are found out


def assert_found(checks: tuple[Check, ...], name: str, message: str) -> None:
    [check] = [check for check in checks if check.name == name]
    with pytest.raises(AssertionError, match=message) as caught:
        check.run()
    assert str(caught.value).startswith(f"{name}: ")


@pytest.mark.parametrize(("broken", "name", "message"), BROKEN_MODELS)
def test_broken_model(broken: Any, name: str, message: str) -> None:
    assert_found(checks(broken, options=[{}]), name, message)


def test_template_of_broken_solvers() -> None:
    no_search = dict.fromkeys(("feasible_first", "optimum_found"), "it does not search")
    check(Drawn, expected_failures=no_search)


def test_other_checks_of_a_solver_that_refuses_problems() -> None:
    check(Choosy, expected_failures=dict.fromkeys(
        ("any_problem", "feasible_first", "optimum_found"), "two segments, and no search"))


def test_problem_a_solver_is_made_for() -> None:
    class Forced(GeneticAlgorithm):
        """Needs forced genes."""

        def generations(self, problem: Problem,
                        rng: np.random.Generator) -> Iterator[Generation]:
            if not problem.genome.on.any():
                raise TermselError("forced genes are needed")
            yield from super().generations(problem, rng)

    check(Forced, problem=bound, expected_failures={"any_problem": "needs forced genes"})


@pytest.mark.parametrize(("broken", "name", "message"), BROKEN_SOLVERS)
def test_broken_solver(broken: type[Solver], name: str, message: str) -> None:
    assert_found(checks(broken), name, message)


@pytest.mark.parametrize(("broken", "name", "message"), BROKEN_CRITERIA)
def test_broken_criterion(broken: type[Criterion], name: str, message: str) -> None:
    assert_found(checks(broken()), name, message)


@pytest.mark.parametrize(("checks", "broken"), [
    (checks(Affine), BROKEN_MODELS), (checks(Drawn), BROKEN_SOLVERS),
    (checks(CheckRmse()), BROKEN_CRITERIA)])
def test_every_check_can_fail(checks: tuple[Check, ...], broken: list[Any]) -> None:
    assert {check.name for check in checks} == {name for _, name, _ in broken}


def test_all_failures_are_reported() -> None:
    with pytest.raises(AssertionError) as caught:
        check(WrongProjection)
    failed = [line.split(":")[0] for line in str(caught.value).splitlines()]
    assert {"axis", "exact_recovery", "recovery_from_lines"} <= set(failed)


def test_a_default_that_is_read_as_something_else_is_named() -> None:
    class Wordy(RationalFunctions):
        """Declares a number as text."""

        name = "wordy"
        declared_options = (*RationalFunctions.declared_options, Option("many", "3", "A.", int))

    assert_found(checks(Wordy), "declaration", "the default '3' of option 'many' is read as 3")


def test_options_are_named() -> None:
    assert_found(checks(WrongLines, options=[{"denominators": "shared"}]),
                 "recovery_from_lines", "rfm with denominators=shared: ")


def test_every_choice_is_checked() -> None:
    class WrongWhenShared(RationalFunctions):
        """Wrong with one of its choices."""

        def project(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
            image = super().project(coefficients, ground)
            return -image if self.options["denominators"] == "shared" else image

    assert_found(checks(WrongWhenShared), "exact_recovery", "rfm with denominators=shared: ")


def test_other_checks_of_a_model_without_lines() -> None:
    check(NoLines, expected_failures={"control_kinds": "made for points"})
