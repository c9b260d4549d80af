"""The conformance suites find out models, solvers and criteria that are broken on purpose."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from termsel.core.errors import TermselError
from termsel.core.options import Option
from termsel.data.features import FloatArray
from termsel.fitting.population import Fits
from termsel.models.polynomial import Affine
from termsel.models.quotient import Blocks, RationalFunctions, RationalModel
from termsel.selection.criteria import CheckRmse, Criterion
from termsel.selection.problems.base import Problem
from termsel.selection.solvers.base import Generation, Solver
from termsel.selection.solvers.genetic.ga import GeneticAlgorithm
from termsel.testing import Check, check, checks
from termsel.testing.problems import bounded_problem
from tests.broken_models import BROKEN_MODELS, NoLines, WrongLines, WrongProjection
from tests.broken_solvers import BROKEN_SOLVERS, Choosy, Drawn

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

    check(Forced, problem=bounded_problem, expected_failures={"any_problem": "needs forced genes"})


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


class Waves(RationalModel):
    """A polynomial with a wave across the scene: in another scaling it is another function."""

    name = "waves"

    def blocks(self, ground: FloatArray) -> Blocks:
        X, Y, Z = ground.T
        columns = np.column_stack([np.ones(len(ground)), X, Y, Z, np.sin(3 * X), np.cos(3 * Y)])
        return Blocks(line=columns, sample=columns)


class TwoWaves(Waves):
    """Equations of one wave, and positions of another."""

    name = "two-waves"

    def project(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        return super().project(coefficients, ground + np.array([0.01, 0.0, 0.0]))


def test_a_model_need_not_be_closed_under_rescaling() -> None:
    [suite_check] = [one for one in checks(Waves) if one.name.endswith("fit")]
    suite_check.run()
    [broken_check] = [one for one in checks(TwoWaves) if one.name.endswith("fit")]
    with pytest.raises(AssertionError, match=r"misses other points .*closed under rescaling"):
        broken_check.run()
