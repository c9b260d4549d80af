"""Searches of terms as one would write them with DEAP and with pymoo, without termsel.

Each selects terms of a cubic polynomial, of the plane where there are no heights, for line and
sample: least squares at the control points, RMSE of the selection points as fitness. It is the
method of the papers (Valadan Zoej et al. 2002) in some lines. Where points have no roles,
every third one is a selection point.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np

from termsel import FeatureSet, TermselError
from termsel.toolkit import BoolArray, FloatArray, require_import

POPULATION, GENERATIONS = 60, 40

UNDETERMINED = 1e6
"""Fitness where there are as many terms as control points."""

Projection = Callable[[FloatArray], FloatArray]


class Cubic:
    """A choice of terms of a cubic polynomial for both axes, as a plain script would state it.

    It has columns of the control points, which coefficients are fitted to, and of the selection
    points, which judge. Without roles every third point is a selection point.
    """

    def __init__(self, features: FeatureSet) -> None:
        """Scale the points and divide them; TermselError for fewer than 3 control or no others."""
        points = features.points
        flat = np.isnan(points.ground).any()
        self.width = 2 if flat else 3
        ground = points.ground[:, :self.width]
        # From -1 to 1 over the points, so that powers are of one size.
        self.middle = ground.mean(axis=0)
        self.scale = np.ptp(ground, axis=0) / 2
        # All monomials to degree 3.
        self.powers = np.array([powers for powers in product(range(4), repeat=self.width)
                                if sum(powers) <= 3])
        if any(points.roles):
            control = np.array(points.roles) == "control"
        else:
            control = np.arange(len(points)) % 3 != 2
        self.control, self.check = (self.columns(points.ground[mask])
                                    for mask in (control, ~control))
        self.image = points.image[control]
        self.check_image = points.image[~control]
        if control.sum() < 3 or not len(self.check):
            raise TermselError(f"a search of terms requires more than {len(points)} points")

    @property
    def size(self) -> int:
        """Number of genes: a bit for each term of either axis."""
        return 2 * len(self.powers)

    def columns(self, ground: FloatArray) -> FloatArray:
        """Return the monomials (n, terms) at ground places (n, 3)."""
        at = (ground[:, :self.width] - self.middle) / self.scale
        return np.asarray(np.prod(at[:, None] ** self.powers, axis=2))

    def solved(self, genes: BoolArray) -> FloatArray:
        """Return coefficients (terms, 2) by least squares, 0 for terms that are off."""
        coefficients = np.zeros((len(self.powers), 2))
        for axis, is_on in enumerate(genes.reshape(2, -1)):
            coefficients[is_on, axis] = np.linalg.lstsq(
                self.control[:, is_on], self.image[:, axis], rcond=None)[0]
        return coefficients

    def fitness(self, genes: BoolArray) -> float:
        """Return the RMSE [px] at the selection points.

        It is `UNDETERMINED` if an axis has as many terms as there are control points, or more.
        """
        if (genes.reshape(2, -1).sum(axis=1) >= len(self.image)).any():
            return UNDETERMINED
        errors = self.check @ self.solved(genes) - self.check_image
        return float(np.sqrt((errors**2).sum(axis=1).mean()))

    def projection(self, genes: BoolArray) -> Projection:
        """Return the projection by the terms that genes (2 t,), those of line first, switch on.

        Raises TermselError if they are not fewer than the control points.
        """
        if self.fitness(genes) == UNDETERMINED:
            raise TermselError(f"the search found no selection of fewer terms than its "
                               f"{len(self.image)} control points")
        coefficients = self.solved(genes)
        return lambda ground: self.columns(ground) @ coefficients


def deap_projection(features: FeatureSet, seed: int) -> Projection:
    """Return the projection of the terms that `deap.algorithms.eaSimple` selects.

    Raises TermselError if there are too few points.
    """
    from deap import algorithms, base, tools

    problem = Cubic(features)

    # DEAP maximises weights times values, so that an error has the weight -1.
    class MinimisedError(base.Fitness):  # type: ignore[misc]
        weights = (-1.0,)

    class Chromosome(list):  # type: ignore[type-arg]
        def __init__(self, bits: Any) -> None:
            super().__init__(bits)
            self.fitness = MinimisedError()

    # DEAP draws from the generator of the module `random`, whose state is restored afterwards.
    state = random.getstate()
    random.seed(seed)
    try:
        box = base.Toolbox()
        box.register("chromosome", lambda: Chromosome(
            random.randint(0, 1) for _ in range(problem.size)))
        box.register("population", lambda n: [box.chromosome() for _ in range(n)])
        box.register(
            "evaluate", lambda chromosome: (problem.fitness(np.array(chromosome, dtype=bool)),)
        )
        box.register("mate", tools.cxUniform, indpb=0.5)
        box.register("mutate", tools.mutFlipBit, indpb=1 / problem.size)
        box.register("select", tools.selTournament, tournsize=3)
        best = tools.HallOfFame(1)
        algorithms.eaSimple(box.population(n=POPULATION), box, 0.9, 1.0, GENERATIONS,
                            halloffame=best, verbose=False)
    finally:
        random.setstate(state)
    return problem.projection(np.array(best[0], dtype=bool))


def pymoo_projection(features: FeatureSet, seed: int) -> Projection:
    """Return the projection of the terms that pymoo's GA with binary operators selects.

    Raises TermselError if there are too few points, or if pymoo is not installed.
    """
    with require_import("the peer requires", "pymoo", "pymoo"):
        from pymoo.algorithms.soo.nonconvex.ga import GA
        from pymoo.core.problem import ElementwiseProblem
        from pymoo.operators.crossover.ux import UniformCrossover
        from pymoo.operators.mutation.bitflip import BitflipMutation
        from pymoo.operators.sampling.rnd import BinaryRandomSampling
        from pymoo.optimize import minimize
    problem = Cubic(features)

    # pymoo minimises; it asks for one individual after the other.
    class Terms(ElementwiseProblem):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__(n_var=problem.size, n_obj=1, xl=0, xu=1, vtype=bool)

        def _evaluate(self, x: Any, values: dict[str, Any], *_: Any, **__: Any) -> None:
            """Set the objective `F` of one individual, as pymoo asks for it."""
            values["F"] = problem.fitness(np.asarray(x, dtype=bool))

    result = minimize(Terms(), GA(pop_size=POPULATION, sampling=BinaryRandomSampling(),
                                  crossover=UniformCrossover(), mutation=BitflipMutation(),
                                  eliminate_duplicates=True), ("n_gen", GENERATIONS), seed=seed,
                      verbose=False)
    return problem.projection(np.asarray(result.X, dtype=bool))
