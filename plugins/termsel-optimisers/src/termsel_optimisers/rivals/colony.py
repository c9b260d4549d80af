"""Ant colony over binary genes."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from termsel import Evaluation, Generation, Genome, Option, Problem, Solver
from termsel_optimisers.arrays import BoolArray, FloatArray


def deposit(ants: BoolArray) -> FloatArray:
    """Return the deposits (2, g) of ranked ants (n, g) on the states off and on of genes.

    Ants are in the order from best to worst, with weights from n down to 1. The deposits on the two
    states of a gene add up to 1.
    """
    # Weights are by rank, as objectives differ in scale.
    weights = np.arange(len(ants), 0, -1.0)
    deposit_on = weights @ ants / weights.sum()
    return np.stack([1.0 - deposit_on, deposit_on])


def renew(pheromone: FloatArray, deposited: FloatArray, evaporation: float, tau_min: float,
          tau_max: float) -> FloatArray:
    """Return the pheromone (2, g) after evaporation and deposit, from `tau_min` to `tau_max`.

    The share rho, `evaporation`, is replaced by the deposit.
    """
    # tau <- (1 - rho) tau + rho deposit.
    return np.clip((1.0 - evaporation) * pheromone + evaporation * deposited, tau_min, tau_max)


def graft_segments(stock: BoolArray, scion: BoolArray, genome: Genome) -> BoolArray:
    """Return copies of `stock` (g,), each with one segment of `scion`, shape (segments, g)."""
    grafted = np.repeat(stock[None], len(genome.segments), axis=0)
    for row, columns in zip(grafted, genome.slices().values(), strict=True):
        row[columns] = scion[columns]
    return grafted


def has_settled(chance: FloatArray, limit: float) -> bool:
    """Return whether the mean probability of the rarer states of free genes is below a limit.

    `chance` (f,) is the probability of each free gene to be on; False if no gene is free.
    """
    return len(chance) > 0 and bool(np.minimum(chance, 1.0 - chance).mean() < limit)


def _best_ants(n: int, ants_1: BoolArray, evaluation_1: Evaluation, ants_2: BoolArray,
               evaluation_2: Evaluation) -> tuple[BoolArray, Evaluation]:
    """Return the best n of two groups of ants, from best to worst, and their evaluation."""
    evaluation = Evaluation(np.concatenate([evaluation_1.objectives, evaluation_2.objectives]),
                            np.concatenate([evaluation_1.violation, evaluation_2.violation]))
    first = evaluation.order()[:n]
    return np.concatenate([ants_1, ants_2])[first], evaluation.take(first)


class AntColony(Solver):
    """Ant colony: pheromone on the states of each gene, laid by the best ants.

    Baghani 2012 (MSc thesis, K. N. Toosi University of Technology, as cited by Zakaryaie Nejad
    et al. 2015) chose the terms of rational functions by an ant colony. The thesis is not
    available to us, so this is termsel's own formulation. It follows the hyper-cube framework
    (Blum and Dorigo 2004), with deposits by rank (Bullnheimer, Hartl and Strauss 1999). Limits
    and restarts are those of the MAX-MIN ant system (Stuetzle and Hoos 2000).

    - Each gene, hence each term of each axis, has pheromone on its two states, off and on. An
      ant switches it on with chance tau_on / (tau_off + tau_on). There is no other desirability.
    - tau <- (1 - rho) tau + rho * deposit, within tau_min and tau_max. The best ant of this
      start and the best of this generation deposit, feasible ones first, with weights that
      fall from ``elite`` to 1 and are scaled to add up to 1.
    - When the mean chance of the rarer state of a gene is below ``restart``, the colony has
      settled: it restarts, with pheromone 1/2 everywhere.
    - The result of a start is then grafted, segment by segment, on the best of all earlier
      starts. Where the objective adds up over segments, as over line and sample with points,
      their best selections are combined even if no start found both.
    - The first ants are drawn by `Genome.random`, small and large selections alike; those of
      later starts follow the even pheromone, have half of the genes, and so search elsewhere.
      Forced genes and cardinality are kept by `Genome.repair`.

    ``Generation.details`` holds the ``pheromone`` the ants followed, shape (2, size): states off
    and on.
    """

    name = "aco"
    departures = (
        "termsel's own formulation: Baghani 2012 could not be consulted.",)
    declared_options = (
        Option("population", 50, "Number of ants.", int, 2, 100_000),
        Option("evaporation", 0.2, "Share of pheromone that evaporates in a generation, rho.",
               float, 0.0, 1.0),
        Option("elite", 5, "Number of ants that deposit, w.", int, 1, 1_000_000),
        Option("tau_min", 0.02, "Least pheromone of a state, tau_min.", float, 0.0, 0.5),
        Option("tau_max", 0.98, "Most pheromone of a state, tau_max.", float, 0.5, 1.0),
        Option("restart", 0.05, "Restart when the mean chance of the rarer states of genes is "
                                "below this; 0 never.", float, 0.0, 0.5),
    )

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        """Yield the generations of ants without end (see `Solver.generations`).

        Each has the pheromone (2, g) of the states off and on of each gene, from which its
        successor is drawn.
        """
        o = self.options
        ants = problem.genome.random(rng, o["population"])
        evaluation = problem.evaluate(ants)
        # The champion is the best of all earlier starts, of which there is none yet; `best` is that
        # of this start.
        champion = ants[:0]
        champion_evaluation = evaluation.take(np.arange(0))
        best = champion
        best_evaluation = champion_evaluation
        pheromone = np.full((2, problem.genome.size), 0.5)
        for index in itertools.count():
            yield Generation(index, ants, evaluation, {"pheromone": pheromone})
            ranked, ranked_evaluation = _best_ants(
                o["elite"], best, best_evaluation, ants, evaluation)
            best = ranked[:1]
            best_evaluation = ranked_evaluation.take(np.arange(1))
            pheromone = renew(pheromone, deposit(ranked), o["evaporation"], o["tau_min"],
                              o["tau_max"])
            # The limits may change the sum of both states.
            chance = pheromone[1] / pheromone.sum(axis=0)
            if has_settled(chance[problem.genome.free], o["restart"]):
                champion, champion_evaluation = _best_ants(
                    1, champion, champion_evaluation, best, best_evaluation)
                grafted = graft_segments(champion[0], best[0], problem.genome)
                champion, champion_evaluation = _best_ants(
                    1, champion, champion_evaluation, grafted, problem.evaluate(grafted)
                )
                # The next start knows nothing of this one; the champion is kept apart.
                best = best[:0]
                best_evaluation = best_evaluation.take(np.arange(0))
                pheromone = np.full((2, problem.genome.size), 0.5)
                chance = pheromone[1]
            ants = problem.genome.repair(rng.random(ants.shape) < chance, rng)
            evaluation = problem.evaluate(ants)
