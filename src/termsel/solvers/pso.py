"""Binary particle swarm."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from termsel.measurements.features import BoolArray, FloatArray, IntArray
from termsel.options import COUNT, Option
from termsel.problems.base import Evaluation, Problem
from termsel.solvers.base import POLISH, Generation, Solver


def improved(found: Evaluation, own: Evaluation) -> BoolArray:
    """Return where individuals are better than those in the same row, feasible ones first."""
    return np.asarray(
        (found.violation < own.violation)
        | ((found.violation == own.violation)
           & (found.objectives[:, 0] < own.objectives[:, 0])))


def leaders(order: IntArray, reach: int) -> IntArray:
    """Return the best particle in the neighbourhood of each.

    Parameters
    ----------
    order : ndarray of int, shape (p,)
        Particles from best to worst.
    reach : int
        Neighbours on either side in a ring of particles; 0 for the whole swarm.

    Returns
    -------
    ndarray of int, shape (p,)
    """
    n = len(order)
    if reach == 0 or 2 * reach >= n:
        return np.full(n, order[0])
    rank = np.argsort(order)
    around = (np.arange(n)[:, None] + np.arange(-reach, reach + 1)) % n
    return np.asarray(order[rank[around].min(axis=1)])


def sigmoid(velocity: FloatArray) -> FloatArray:
    """Return the chance that a gene is on, the transfer function of the binary swarm."""
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

    ``Generation.details`` holds the ``velocity``, shape (p, size), that led to the genes.
    """

    name = "pso"
    as_published = True
    default_generations = 200
    declared_options = (
        Option("population", 50, "Number of particles.", int, 2, 100_000),
        Option("inertia", 1.0, "Share of its velocity that a particle keeps at first, w.", float,
               0.0, 1.0),
        Option("inertia_last", 1.0, "Share of its velocity that a particle keeps at the end, "
                                    "w.", float,
               0.0, 1.0),
        Option("iterations", 200, "Generations over which the inertia changes from first to last.",
               int, 1, COUNT),
        Option("cognition", 2.0, "Pull of a particle's own best selection, c1.", float, 0.0, 10.0),
        Option("society", 2.0, "Pull of the leader's best selection, c2.", float, 0.0, 10.0),
        Option("velocity", 4.0, "Limit of velocities, v_max; at 4 a settled gene still flips once "
               "in 56 times.", float, 0.0, 20.0),
        Option("neighbours", 3, "Neighbours on each side in the ring among which a leader is "
                                "sought; 0 for the whole swarm.", int, 0, COUNT),
        POLISH,
    )

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        """Yield generations without end (see `Solver.generations`)."""
        o = self.options
        limit = o["velocity"]
        genes = problem.genome.random(rng, o["population"])
        velocity = np.where(genes, limit, -limit) * rng.random(genes.shape)
        evaluation = problem.evaluate(genes)
        own, of_own = genes, evaluation
        yield Generation(0, genes, evaluation, {"velocity": velocity})
        index = 0
        while True:
            index += 1
            share = min(index / o["iterations"], 1.0)
            inertia = o["inertia"] + share * (o["inertia_last"] - o["inertia"])
            x = genes.astype(np.float64)
            pull = o["cognition"] * rng.random(x.shape) * (own - x)
            pull += (o["society"] * rng.random(x.shape)
                     * (own[leaders(of_own.order(), o["neighbours"])] - x))
            velocity = np.clip(inertia * velocity + pull, -limit, limit)
            genes = problem.genome.repair(rng.random(x.shape) < sigmoid(velocity), rng)
            evaluation = problem.evaluate(genes)
            gain = improved(evaluation, of_own)
            own = np.where(gain[:, None], genes, own)
            of_own = Evaluation(
                np.where(gain[:, None], evaluation.objectives, of_own.objectives),
                np.where(gain, evaluation.violation, of_own.violation))
            yield Generation(index, genes, evaluation, {"velocity": velocity})
