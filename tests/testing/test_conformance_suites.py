"""The conformance suites: models, solvers and criteria that are built in, and how they are used."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from termsel.core.errors import TermselError
from termsel.data.features import FeatureSet, FloatArray, Points
from termsel.fitting.losses import LOSS
from termsel.models.interpolating import Field, Field3D, ThinPlate
from termsel.models.polynomial import (
    Affine,
    Helmert2D,
    Polynomial2D,
    Polynomial3D,
)
from termsel.models.projective import DLT2D, DLT3D, Projective2D
from termsel.models.quotient import Blocks, RationalFunctions, RationalModel
from termsel.selection.criteria import CheckRmse, Ebic, Huber, KFold, Median, Press
from termsel.selection.problems.base import ProblemData
from termsel.selection.problems.selection import SelectionProblem
from termsel.selection.solvers.bridges.pareto import Nsga2
from termsel.selection.solvers.genetic.ga import GeneticAlgorithm
from termsel.selection.solvers.genetic.ga_steady import SteadyStateGA
from termsel.selection.solvers.heuristics.pso import BinarySwarm
from termsel.selection.solvers.heuristics.swap import Swap
from termsel.selection.solvers.heuristics.yardsticks import AllTerms, RandomSearch
from termsel.selection.solvers.proofs.exact import Exact
from termsel.selection.solvers.regression.ridge import Ridge
from termsel.testing import Check, check, checks

# What is built in

NO_SEARCH = {"feasible_first": "it does not search", "optimum_found": "it does not search"}
NEEDS_COLUMNS = {"any_problem": "it needs the columns of an adjustment",
                 "optimum_found": "it does not search"}


def six_of_twelve() -> SelectionProblem:
    """The choice of 6 of 12 control points, three of which are measured wrongly."""
    rng = np.random.default_rng(4)
    ground = rng.uniform(-1.0, 1.0, (2, 12, 3))
    image = 0.8 * ground[..., :2] + rng.normal(0.0, 0.01, (2, 12, 2))
    image[0, :3] += 0.2
    control, check = (Points(tuple(f"p{i}" for i in range(12)), *one)
                      for one in zip(image, ground, strict=True))
    return SelectionProblem(
        ProblemData(Affine(), FeatureSet(control), check, 100.0, CheckRmse(),
               {"min_features": 6, "max_features": 6}), terms=False, features=True)


# Held near zero, denominators are not exactly those of lines without noise.
ORDERS = [{"order": order, "denominators": kind, **({"ridge": 0.0} if kind == "shared" else {})}
          for order in (1, 2, 3) for kind in ("separate", "shared", "none")]
SUITES: dict[str, tuple[Check, ...]] = {
    "rfm": checks(RationalFunctions, options=ORDERS),
    "rfm-weighted": checks(RationalFunctions, options=[
        {"order": 2, "weighted": True},
        {"denominators": "shared", "ridge": 0.0, "weighted": True}]),
    "poly2d": checks(Polynomial2D, options=[{"degree": d} for d in (1, 4, 5, 8)]),
    "poly3d": checks(Polynomial3D, options=[{"degree": d} for d in (1, 2, 3, 5)]),
    "affine": checks(Affine),
    "projective2d": checks(Projective2D),
    "dlt2d": checks(DLT2D),
    "dlt3d": checks(DLT3D),
    "helmert2d": checks(Helmert2D),
    "tps": checks(ThinPlate, options=[{}, {"smoothing": 0.0}, {"chosen_by": "gcv"}]),
    "field": checks(Field),
    "field3d": checks(Field3D),
    "ga": checks(GeneticAlgorithm, options=[{}, {"population": 21, "elite": 1}]),
    "ga-steady": checks(
        SteadyStateGA, options=[{}, {"population": 21, "overlap": 1.0}], problem=six_of_twelve,
        expected_failures={"any_problem": "it needs features alone"}),
    "pso": checks(BinarySwarm, options=[{}, {"population": 21, "neighbours": 0}]),
    "swap": checks(Swap),
    "exact": checks(Exact, expected_failures={"any_problem": "it needs parts to walk"}),
    "nsga2": checks(Nsga2),
    "ridge": checks(Ridge, expected_failures=NEEDS_COLUMNS),
    "random": checks(RandomSearch, expected_failures=NO_SEARCH),
    "all-terms": checks(AllTerms, expected_failures=NO_SEARCH),
    "check-rmse": checks(CheckRmse),
    "median": checks(Median),
    "huber": checks(Huber),
    "ebic": checks(Ebic),
    **{f"press, {loss}": checks(Press(loss=loss)) for loss in LOSS.choices},
    **{f"kfold, {loss}": checks(KFold(loss=loss)) for loss in LOSS.choices},
    "kfold, random": checks(KFold(how="random", repeats=2))}


@pytest.mark.slow_cases(
    "ebic-subset_score_agrees", "ga-steady-optimum_found", "nsga2-narrow_genomes",
    "nsga2-typed_genomes")
@pytest.mark.parametrize("check", [
    pytest.param(check, id=f"{name}-{check.name}")
    for name, checks in SUITES.items() for check in checks])
def test_built_in(check: Check) -> None:
    check.run()


# How the suites are used


class Dlt(RationalModel):
    """Direct linear transformation, as a plugin author writes it."""

    name = "dlt-demo"

    def blocks(self, ground: FloatArray) -> Blocks:
        one = np.column_stack([np.ones(len(ground)), ground])
        return Blocks(line=one, sample=one, shared_denominator=ground)


def test_all_at_once() -> None:
    check(Dlt)
    check(CheckRmse())


def test_expected_failure_that_passes() -> None:
    with pytest.raises(AssertionError, match=r"axis: .* passes .*\(a reason\)"):
        check(Affine, expected_failures={"axis": "a reason"})


def test_expected_failure_of_no_check() -> None:
    with pytest.raises(TermselError, match=r"unknown check 'axes'.*Did you mean 'axis'"):
        checks(Affine, expected_failures={"axes": "a reason"})


@pytest.mark.slow
def test_pytest_is_not_imported() -> None:
    code = "import sys, termsel.testing; sys.exit('pytest' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
