"""Binary particle swarm."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from termsel.core.options import COUNT, Option
from termsel.data.features import BoolArray, FloatArray, IntArray
from termsel.selection.problems.base import Evaluation, Problem
from termsel.selection.problems.segments import SEGMENTS, Genes
from termsel.selection.solvers.base import Generation, Solver
from termsel.selection.solvers.genetic.operators import from_keys, n_keys


def are_improved(evaluation: Evaluation, best: Evaluation) -> BoolArray:
    """Return which individuals, (p,), beat those in the same row of `best`, feasible ones first."""
    return np.asarray(
        (evaluation.violation < best.violation)
        | ((evaluation.violation == best.violation)
           & (evaluation.objectives[:, 0] < best.objectives[:, 0])))


def find_leaders(order: IntArray, reach: int) -> IntArray:
    """Return the best particle in the neighbourhood of each, shape (p,).

    The order (p,) is of particles from best to worst; `reach` counts neighbours on either side in a
    ring of particles, 0 for the whole swarm.
    """
    n = len(order)
    if reach == 0 or 2 * reach >= n:
        return np.full(n, order[0])
    rank = np.argsort(order)  # the inverse permutation: the place of each particle
    # Particles are in a ring by their number, not by their rank.
    ring_neighbours = (np.arange(n)[:, None] + np.arange(-reach, reach + 1)) % n
    return np.asarray(order[rank[ring_neighbours].min(axis=1)])


def chance_of_gene(velocity: FloatArray) -> FloatArray:
    """Return the chance that a gene is on, 1 / (1 + exp(-v)), of the shape of the velocity v."""
    return np.asarray(1.0 / (1.0 + np.exp(-velocity)))


class BinarySwarm(Solver):
    """Binary particle swarm: velocities are chances that genes are on.

    Plain binary particle swarm optimisation after Kennedy and Eberhart 1997. A particle's
    velocity is v <- w v + c1 r1 (own best - x) + c2 r2 (leader - x), within +-v_max. It gives
    each gene its chance of being on, 1 / (1 + exp(-v)). Yavari, Valadan Zoej, Mokhtarzade and
    Mohammadzadeh 2012 brought it to the terms of rational functions; their modification of it
    is not available to us and is not included.

    Our choices:

    - Leaders are sought among neighbours in a ring (Kennedy and Mendes 2002), as the swarm then
      settles later; ``neighbours=0`` gives the one leader of the original.
    - The inertia w stays 1, which is the original without inertia. A smaller or falling one, as
      is common in continuous spaces, has the opposite effect here: it draws velocities to 0,
      where each gene is on with chance 1/2, and the swarm never settles. To use it
      nevertheless, set ``inertia=0.9`` and ``inertia_last=0.4``.
    - Particles start with random speeds towards their own positions, so that the first small and
      large selections are explored.
    - Feasible selections rank before others, for own bests and for leaders. The velocity is not
      changed where forced genes or cardinality switch a gene.

    - Where genes are not bits, particles are random keys of them (Bean 1994) with the constriction
      of Clerc and Kennedy 2002.

    ``Generation.details`` holds the ``velocity`` that led to the genes: of each gene, or key.
    """

    name = "pso"
    departures = (
        "Kennedy and Eberhart 1997 without the modification of Yavari et al. 2012, which could "
        "not be consulted.",
        "Leaders are sought in a ring of neighbours (--set neighbours=0 gives the one leader).",
        "Particles start with random speeds towards their own positions.")
    segments = SEGMENTS
    declared_options = (
        Option("population", 50, "Number of particles.", int, 2, 100_000),
        Option("inertia", None, "Share of its velocity that a particle keeps at first, w; by "
               "default 1 with bits and 0.73 with other genes.", float, 0.0, 1.0),
        Option("inertia_last", None, "Share of its velocity that a particle keeps at the end, w; "
               "by default 1 with bits and 0.73 with other genes.", float, 0.0, 1.0),
        Option("iterations", 200, "Generations over which the inertia changes from first to last.",
               int, 1, COUNT),
        Option("cognition", None, "Pull of a particle's own best selection, c1; by default 2 with "
               "bits and 1.5 with other genes.", float, 0.0, 10.0),
        Option("society", None, "Pull of the leader's best selection, c2; by default 2 with bits "
               "and 1.5 with other genes.", float, 0.0, 10.0),
        Option("velocity", None, "Limit of velocities, v_max. By default 4 with bits, where a "
               "settled gene still flips once in 56 times; half of the range with other genes.",
               float, 0.0, 20.0),
        Option("neighbours", 3, "Neighbours on each side in the ring among which a leader is "
                                "sought; 0 for the whole swarm.", int, 0, COUNT),
    )

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        """Yield generations without end (see `Solver.generations`)."""
        genome = problem.genome
        bits = problem.genome.dtype == np.bool_
        parameters = {**(_FOR_BITS if bits else _FOR_KEYS),
                      **{name: value for name, value in self.options.items() if value is not None}}
        limit = parameters["velocity"]
        # Where a particle is: its bits, or the random keys of its genes.
        if bits:
            position = genes = genome.random(rng, parameters["population"])
            velocity = np.where(genes, limit, -limit) * rng.random(genes.shape)
        else:
            position = rng.random((parameters["population"], n_keys(genome)))
            velocity = (rng.random(position.shape) - position) * limit  # towards a random place
            genes = genome.repair(from_keys(position, genome), rng)
        evaluation = problem.evaluate(genes)
        best_position = position
        best_evaluation = evaluation
        yield Generation(0, genes, evaluation, {"velocity": velocity})
        for index in itertools.count(1):
            velocity = _next_velocities(parameters, index, velocity,
                                        position=position.astype(np.float64),
                                        best_position=best_position,
                                        best_evaluation=best_evaluation, rng=rng)
            if bits:
                # The velocity is the chance of a gene: the position itself is drawn from it.
                switched_on = rng.random(position.shape) < chance_of_gene(velocity)
                position = genes = genome.repair(switched_on, rng)
            else:
                # Keys are not those of repaired genes: the swarm moves on as if nothing was
                # repaired.
                position = np.clip(position + velocity, 0.0, 1.0)
                genes = genome.repair(from_keys(position, genome), rng)
            evaluation = problem.evaluate(genes)
            best_position, best_evaluation = _personal_best(
                best_position, best_evaluation, position, evaluation
            )
            yield Generation(index, genes, evaluation, {"velocity": velocity})


_FOR_BITS = {"inertia": 1.0, "inertia_last": 1.0, "cognition": 2.0, "society": 2.0,
             "velocity": 4.0}
_FOR_KEYS = {"inertia": 0.7298, "inertia_last": 0.7298, "cognition": 1.4962, "society": 1.4962,
             "velocity": 0.5}
"""Defaults; of keys the constriction of Clerc and Kennedy 2002, and half of their range."""


def _next_velocities(parameters: Mapping[str, Any], index: int, velocity: FloatArray,
                     position: FloatArray, best_position: Genes, best_evaluation: Evaluation,
                     rng: np.random.Generator) -> FloatArray:
    """Return the velocities of the next step, (p, size).

    `index` is the number of the step; `parameters` are the options of the solver. `velocity` and
    `position` are those of the particles now, `best_position` and `best_evaluation` the best that
    each has been at, all (p, size) but the evaluation.
    """
    share = min(index / parameters["iterations"], 1.0)
    # v <- w v + c1 r1 (own best - x) + c2 r2 (leader - x), with w from first to last.
    inertia = parameters["inertia"] + share * (parameters["inertia_last"] - parameters["inertia"])
    pull = parameters["cognition"] * rng.random(position.shape) * (best_position - position)
    leader = best_position[find_leaders(best_evaluation.order(), parameters["neighbours"])]
    pull += parameters["society"] * rng.random(position.shape) * (leader - position)
    limit = parameters["velocity"]
    return np.asarray(np.clip(inertia * velocity + pull, -limit, limit))


def _personal_best(best_position: Genes, best_evaluation: Evaluation, position: Genes,
                   evaluation: Evaluation) -> tuple[Genes, Evaluation]:
    """Return the best place of each particle so far, and its evaluation."""
    is_better = are_improved(evaluation, best_evaluation)
    return np.where(is_better[:, None], position, best_position), Evaluation(
        np.where(is_better[:, None], evaluation.objectives, best_evaluation.objectives),
        np.where(is_better, evaluation.violation, best_evaluation.violation))
