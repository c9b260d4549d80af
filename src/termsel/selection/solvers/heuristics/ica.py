"""Imperialist competitive algorithm."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from termsel.core.options import Option
from termsel.data.features import BoolArray, FloatArray, IntArray
from termsel.selection.problems.base import Evaluation, Problem
from termsel.selection.solvers.base import Generation, Solver


def finite_costs(evaluation: Evaluation) -> FloatArray:
    """Return one finite cost per country, shape (p,), in the order of `Evaluation.order`.

    A feasible country costs its first objective, an infeasible one more than every feasible one;
    the paper has none. Countries with the same violation and objective cost the same.
    """
    cost = evaluation.objectives[:, 0].copy()
    failed = evaluation.violation > 0
    feasible = cost[~failed] if not failed.all() else np.zeros(1)
    ranked = np.column_stack([evaluation.violation, cost])[failed]
    levels, rank = np.unique(ranked, axis=0, return_inverse=True)
    # The worst feasible cost and a penalty by rank, up to the spread of the feasible costs: in
    # proportion to the violation it would dominate these in equations (5), (8) and (9).
    worst = feasible.max()
    scale = max(worst - feasible.min(), 1e-3 * abs(worst)) or 1.0  # all 0, or none feasible
    cost[failed] = worst + scale * (rank.reshape(-1) + 1) / max(len(levels), 1)
    return cost


def normalise_cost(cost: FloatArray, worst: float) -> FloatArray:
    """Return how much better imperialists, cost (k,), are than the worst country, equation (5)."""
    return worst - cost


def normalised_powers(normalised: FloatArray) -> FloatArray:
    """Return the normalised power of e imperialists, (e,), equation (6).

    If all are as bad as the worst country, and the equation is 0/0, all are equal.
    """
    total = normalised.sum()
    return normalised / total if total > 0 else np.full(len(normalised), 1 / len(normalised))


def count_colonies(share: FloatArray, colonies: int) -> IntArray:
    """Return the numbers of colonies of imperialists, (e,), equation (7), from their power.

    Rounded by largest remainder: as in the paper wherever its rounded numbers add up to the
    number of colonies, which is not always so.
    """
    exact_sizes = share * colonies
    # Of the whole numbers below, each empire then is at most one colony short.
    size = np.floor(exact_sizes).astype(np.intp)
    # The largest remainders get one more each until all colonies are given.
    size[np.argsort(size - exact_sizes, kind="stable")[:colonies - size.sum()]] += 1
    return size


def assimilate(colonies: BoolArray, imperialists: BoolArray, rate: FloatArray | float,
               drawn: FloatArray) -> BoolArray:
    """Return colonies in which genes are replaced by those of the imperialist, figure 3.

    In each row, shape (n, g), stand a colony and the imperialist of its empire. A gene is replaced
    where the random number drawn for it, from (0, 1), is below the assimilation rate AR, one for
    all or (n, 1).
    """
    return np.where(drawn < rate, imperialists, colonies)


def revolt(colonies: BoolArray, rebels: BoolArray, redrawn: BoolArray,
           drawn: BoolArray) -> BoolArray:
    """Return the genes (n, g) of colonies after the revolt of some of them, figure 4.

    The colonies in the mask `rebels` (n,) get the values `drawn` (n, g) in the genes of the mask
    `redrawn` (n, g).
    """
    return np.where(rebels[:, None] & redrawn, drawn, colonies)


def total_power(cost: FloatArray, empire: IntArray, imperialists: IntArray,
                alpha: float) -> FloatArray:
    """Return the total power of empires (k,), equation (8); the smaller the more powerful.

    It is TC = cost(imperialist) + alpha mean cost(colonies). `cost` (p,) and `empire` (p,) are the
    cost and the number of the empire of each country, `imperialists` (k,) are countries. Where an
    empire has no colonies, the cost of its imperialist takes the place of their mean.
    """
    k = len(imperialists)
    imperialist_cost = cost[imperialists]
    count = np.bincount(empire, minlength=k) - 1
    total = np.bincount(empire, weights=cost, minlength=k) - imperialist_cost
    mean = np.where(count > 0, total / np.maximum(count, 1), imperialist_cost)
    return imperialist_cost + alpha * mean


def normalised_power(power: FloatArray) -> FloatArray:
    """Return the normalised power (k,) of empires, equation (9), from their total power (k,).

    The equation divides by the total power and assumes that it is positive, as for an RMSE. A power
    of zero counts as 10^-12 of the largest. If a power is negative, as with an information
    criterion, all are shifted until the least equals their spread.
    """
    lowest = power.min()
    highest = power.max()
    if lowest < 0:
        power = power - lowest + (highest - lowest)
        highest = 2 * (highest - lowest)
    if highest <= 0:  # all are 0, and so equal
        return np.ones(len(power))
    return np.asarray(highest / np.maximum(power, 1e-12 * highest))


def possession_probability(normalised: FloatArray) -> FloatArray:
    """Return the probability of each empire to possess the colony, (e,), equation (10)."""
    return np.asarray(normalised / normalised.sum())


@dataclass(frozen=True, eq=False)
class Empires:
    """The empires: which imperialist rules which countries."""

    empire: IntArray  # (p,): to which empire each country belongs, 0 to k - 1
    imperialists: IntArray  # (k,): the imperialist of each empire
    # (k,): the number each empire had at first, to follow it when others vanish.
    names: IntArray

    def crown(self, cost: FloatArray) -> Empires:
        """Return the empires after each best colony has taken over from a worse imperialist."""
        # In a tie the imperialist stays: colonies come after it.
        is_colony = np.ones(len(cost), dtype=bool)
        is_colony[self.imperialists] = False
        # By empire, then by cost: the first of each empire is its best country.
        order = np.lexsort((is_colony, cost, self.empire))
        starts = np.searchsorted(self.empire[order], np.arange(len(self.imperialists)))
        return Empires(self.empire, order[starts], self.names)

    def compete(self, cost: FloatArray, power: FloatArray, drawn: FloatArray) -> Empires:
        """Return the empires after the competition for the weakest colony.

        The weakest colony of the weakest empire that has any goes to the winner, the empire with
        the largest D = Pr - R, which may be the weakest itself. Empires left without colonies
        vanish; their imperialists become colonies of the winner. `cost` (p,) is that of each
        country, `power` (k,) the total power of each empire, equation (8); `drawn` (k,) are the R,
        random numbers from (0, 1).
        """
        k = len(self.imperialists)
        # D = Pr - R: chance decides where powers are about equal.
        winner = int(np.argmax(possession_probability(normalised_power(power)) - drawn))
        has_colonies = np.bincount(self.empire, minlength=k) > 1  # the imperialist is one of them
        weakest = int(np.argmax(np.where(has_colonies, power, -np.inf)))
        is_colony = self.empire == weakest
        is_colony[self.imperialists] = False
        empire = self.empire.copy()
        empire[np.argmax(np.where(is_colony, cost, -np.inf))] = winner
        # An empire that has lost its last colony vanishes: its imperialist is a colony now.
        alive = np.bincount(empire, minlength=k) > 1
        empire[~alive[empire]] = winner
        renumbered = np.cumsum(alive) - 1
        return Empires(renumbered[empire], self.imperialists[alive], self.names[alive])

    def unite(self, genes: BoolArray, cost: FloatArray, distance: float) -> Empires:
        """Return the empires after those that have met were united.

        Two empires have met if their imperialists differ in at most a share of their genes, the
        `distance`. The better imperialist rules both; the other becomes its colony. `genes`
        (p, size) and `cost` (p,) are those of all countries.
        """
        rulers = genes[self.imperialists]
        ruler_of = np.arange(len(rulers))  # who rules each empire now
        sovereign: list[int] = []
        # From the best imperialist on: a worse one that has met it gives way.
        for i in np.argsort(cost[self.imperialists], kind="stable"):
            has_met = (rulers[sovereign] != rulers[i]).mean(axis=1) <= distance
            if has_met.any():
                ruler_of[i] = sovereign[int(np.argmax(has_met))]
            else:
                sovereign.append(int(i))
        alive = ruler_of == np.arange(len(rulers))
        renumbered = np.cumsum(alive) - 1
        return Empires(renumbered[ruler_of[self.empire]], self.imperialists[alive],
                       self.names[alive])


def found_empires(cost: FloatArray, k: int, rng: np.random.Generator) -> Empires:
    """Return the first empires: the best k countries, N_imp, and colonies drawn for each."""
    order = np.argsort(cost, kind="stable")
    size = count_colonies(
        normalised_powers(normalise_cost(cost[order[:k]], cost.max())), len(cost) - k)
    # The best k found an empire each; the others are dealt out at random, in the numbers above.
    empire = np.empty(len(cost), dtype=np.intp)
    empire[order[:k]] = np.arange(k)
    empire[rng.permutation(order[k:])] = np.repeat(np.arange(k), size)
    return Empires(empire, order[:k], np.arange(k))


class ImperialistCompetition(Solver):
    """Imperialist competitive algorithm: empires of selections take each other's colonies.

    The discrete algorithm of Zakaryaie Nejad, Ezzatpanah and Ramezani 2015, equations (5) to
    (10), with the parameters of their tables and figure 3. In each generation colonies take
    over genes of their imperialist, and some revolt. A colony better than its imperialist takes
    its place, and the weakest colony of the weakest empire goes to the winner of a competition.
    The search ends when one empire is left, or with its budget.

    Our choices where the paper states nothing:

    - Costs of infeasible countries: see `finite_costs`. Ties and divisions by zero in equations
    (6),
      (8) and (9), and rounding in equation (7): see `normalised_powers`, `total_power`,
      `normalised_power` and `count_colonies`.
    - The share P of colonies that revolt: each colony with chance P, after assimilation and
      before its cost is taken. Figure 4 marks four of eight genes, two of which change: each
      gene is redrawn with chance 1/2 (option `redrawn`).
    - A moved colony keeps its genes whether better or worse, as in the paper's figure 3.
    - "Some (usually one)" of the weakest colonies is contested: one. Option `contested` sets
      more, each of them contested by itself.
    - The imperialist of an empire that vanishes becomes a colony of the winner, so that the
      number of countries stays. An imperialist never gives way to a worse one.
    - There are at least two imperialists, as a single one has no competitor.
    - D differs little from chance if empires are about equally powerful, so that the last of
      them exchange colonies for thousands of generations: 3 of 150 runs came to one empire within
      3,000 of them (docs/explanation/searching.md).
    - Atashpaz-Gargari and Lucas 2007, in whose published code empires that have met unite, are
      the source of option `uniting`. The paper does not unite empires: it is off by default.

    ``Generation.details`` holds what observers need to draw the empires: ``empire``, the empire
    of each country, int, shape (p,), numbered as at first; ``empires``, the countries of each of
    these, int, of those at first; ``imperialists``, the rows of the k
    imperialists, int, shape (k,); ``names``, the number at first of each empire left, int,
    shape (k,); ``power``, the total power of equation (8), shape (k,); and ``cost``, shape
    (p,). Rows of the population are the same countries throughout.
    """

    name = "ica"
    departures = (
        "The assimilation rate is the 0.5 of figure 3 for all colonies; section 3.3 computes it "
        "from the similarity of a colony and its imperialist (--set similarity=true, the default "
        "of zakaryaie-2015).",
        "A colony that revolts has each gene redrawn with chance 1/2 (--set redrawn); the paper "
        "only shows an example.",
        "Infeasible countries cost more than every feasible one; the paper has none.",
        "It ends with its budget; the paper waits until one empire is left, which is rare.")
    declared_options = (
        Option("population", 100, "Number of countries, N_pop.", int, 4, 100_000),
        Option("imperialists", 0.1, "Share of imperialists among the countries, PR.", float,
               0.0, 0.5),
        Option("assimilation", 0.5, "Chance that a gene of a colony is replaced by that of its "
               "imperialist, AR.", float, 0.0, 1.0),
        Option("similarity", False, "Take AR of each colony as the share of its genes that equal "
               "its imperialist's, after section 3.3, in place of `assimilation`.", bool),
        Option("revolution", 0.1, "Share of colonies that revolt, P.", float, 0.0, 1.0),
        Option("redrawn", 0.5, "Chance that a gene of a revolting colony is redrawn, after figure "
                               "4.", float, 0.0, 1.0),
        Option("alpha", 0.08, "Weight of the mean cost of the colonies in the power of an "
               "empire, alpha.", float, 0.0, 1.0),
        Option("contested", 1, "Number of weakest colonies contested in a generation.", int, 1,
               1_000_000),
        Option("uniting", None, "Unite empires whose imperialists differ in at most this share of "
               "their genes, such as 0.02; by default never.", float, 0.0, 1.0),
    )

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        """Yield generations until one empire is left, if ever (see `Solver.generations`)."""
        o = self.options
        genes = problem.genome.random(rng, o["population"])
        evaluation = problem.evaluate(genes)
        cost = finite_costs(evaluation)
        first_empires = min(max(2, round(o["imperialists"] * len(genes))), len(genes) // 2)
        world = found_empires(cost, first_empires, rng)
        yield self._generation_of_empires(0, genes, evaluation, cost, world, first_empires)
        index = 0
        while len(world.imperialists) > 1:
            index += 1
            genes, evaluation = self._move(problem, genes, evaluation, world, rng)
            cost = finite_costs(evaluation)
            world = world.crown(cost)
            if o["uniting"] is not None:
                world = world.unite(genes, cost, o["uniting"])
            # Each contest sees the empires that the one before has left.
            for _ in range(o["contested"]):
                if len(world.imperialists) == 1:
                    break
                power = total_power(cost, world.empire, world.imperialists, o["alpha"])
                world = world.compete(cost, power, rng.random(len(power))).crown(cost)
            yield self._generation_of_empires(index, genes, evaluation, cost, world, first_empires)

    def _move(self, problem: Problem, genes: BoolArray, evaluation: Evaluation, world: Empires,
              rng: np.random.Generator) -> tuple[BoolArray, Evaluation]:
        """Return genes (p, size) and evaluation of all countries after their colonies have changed.

        Colonies move towards their imperialist, some of them revolt, and all are repaired and
        evaluated again. Imperialists stay as they are.
        """
        o = self.options
        colonies = np.delete(np.arange(len(genes)), world.imperialists)
        shape = (len(colonies), genes.shape[1])
        colony_genes = genes[colonies]
        imperialist_genes = genes[world.imperialists[world.empire[colonies]]]
        rate: FloatArray | float = o["assimilation"]
        if o["similarity"]:  # of each colony
            rate = (colony_genes == imperialist_genes).mean(axis=1, keepdims=True)
        # All random numbers are drawn for all colonies, whether they are needed or not.
        moved = assimilate(colony_genes, imperialist_genes, rate, rng.random(shape))
        moved = revolt(moved, rng.random(len(colonies)) < o["revolution"],
                       rng.random(shape) < o["redrawn"], rng.random(shape) < 0.5)
        moved = problem.genome.repair(moved, rng)
        moved_evaluation = problem.evaluate(moved)
        genes = genes.copy()  # observers keep the generation before
        genes[colonies] = moved
        objectives = evaluation.objectives.copy()
        violation = evaluation.violation.copy()
        objectives[colonies] = moved_evaluation.objectives
        violation[colonies] = moved_evaluation.violation
        return genes, Evaluation(objectives, violation)

    def _generation_of_empires(self, index: int, genes: BoolArray, evaluation: Evaluation,
                               cost: FloatArray, world: Empires, first_empires: int) -> Generation:
        """Return a generation with the figures of the empires that its charts show.

        `genes` (p, size), `evaluation` and `cost` (p,) are those of all countries. At first there
        were `first_empires` empires; those that have vanished since have no country.
        """
        power = total_power(cost, world.empire, world.imperialists, self.options["alpha"])
        empire = world.names[world.empire]  # numbered as at first, whatever has vanished
        return Generation(index, genes, evaluation, {
            "empire": empire, "empires": np.bincount(empire, minlength=first_empires),
            "imperialists": world.imperialists,
            "names": world.names, "power": power, "cost": cost})
