"""What every objective must do."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from termsel.core.isolation.arrays import difference_from_shape
from termsel.data.features import FloatArray, Points
from termsel.models.polynomial import Affine
from termsel.selection.criteria import CheckRmse
from termsel.selection.problems.base import ProblemData
from termsel.selection.problems.objectives import Objective, PopulationSelection
from termsel.selection.problems.selection import SelectionProblem
from termsel.testing.cases import (
    Case,
    Suite,
    declaration_check,
    require,
    require_unchanged,
    through_pickle,
)
from termsel.testing.scenes import imaged_features, random_coefficients, seeded_generator

ALONE = (slice(0, 1), slice(3, 4), slice(-1, None))
"""Individuals that are judged without the others."""


def figure_each(objective: Objective) -> None:
    """It gives one finite figure for each individual, also where none or all is selected."""
    for selected in _extreme_selections():
        fault = difference_from_shape(objective.score(selected), (len(selected.terms),))
        require(fault is None, f"score() of {len(selected.terms)} individuals {fault}")


def control_kinds(objective: Objective) -> None:
    """It gives figures of selections among lines, and among points and lines, too.

    One that cannot has this check among its expected failures.
    """
    for points, lines in ((0, 14), (10, 4)):
        for selected in _extreme_selections(points, lines):
            fault = difference_from_shape(objective.score(selected), (len(selected.terms),))
            require(fault is None, f"score() with {points} points and {lines} lines {fault}")


def deterministic(objective: Objective) -> None:
    """The same selections get the same figures, here and in another process."""
    for selected in _extreme_selections():
        first = objective.score(selected)
        for copy in (objective, through_pickle(objective)):
            require(np.array_equal(copy.score(selected), first),
                    "score() of the same selections differs from one call or process to the next")


def one_by_one(objective: Objective) -> None:
    """An individual's figure does not depend on the individuals judged with it."""
    for selected in _extreme_selections():
        joint = objective.score(selected)
        for individuals in ALONE:
            single = objective.score(replace(selected, terms=selected.terms[individuals],
                                             features=selected.features[individuals]))
            require(np.allclose(joint[individuals], single),
                    f"among others an individual gets {joint[individuals]}, alone {single}; a "
                    "search keeps figures and compares them later")


def inputs_unchanged(objective: Objective) -> None:
    """It does not change the selections it is given."""
    for selected in _extreme_selections():
        require_unchanged({"selected.terms": selected.terms, "selected.features": selected.features,
                           "selected.equations": selected.equations.A}, "score()",
                          partial(objective.score, selected))


def cases(objective: Objective) -> list[Case]:
    """Return an objective."""
    return [Case(objective.name, lambda: objective)]


SUITE = Suite((declaration_check("objectives"), figure_each, control_kinds, deterministic,
               one_by_one,
               inputs_unchanged), cases)


def _extreme_selections(points: int = 14, lines: int = 0) -> list[PopulationSelection]:
    """Return populations of selections of none, all and some, of terms and of features.

    Two problems make them, as an objective may look at terms or at features, and an objective that
    records them gets them out.
    """
    model = Affine()
    rng = seeded_generator()
    truth = random_coefficients(model, rng)
    control = imaged_features(model, truth, rng, points=points, lines=lines)
    check: Points = imaged_features(model, truth, rng, points=10).points
    recorded: list[PopulationSelection] = []

    def record(selected: PopulationSelection) -> FloatArray:
        recorded.append(selected)
        return np.zeros(len(selected.terms))

    recorder = Objective("recorder", "Records.", record)
    inputs = ProblemData(model, control, check, 1000.0, CheckRmse(), {}, objectives=(recorder,))
    # Selections of terms, then of features: nothing, everything, and six at random.
    for terms in (True, False):
        problem = SelectionProblem(inputs, terms=terms, features=not terms)
        size = problem.genome.size
        problem.evaluate(np.concatenate([np.zeros((1, size)), np.ones((1, size)),
                                         rng.random((6, size))]) > 0.5)
    return recorded
