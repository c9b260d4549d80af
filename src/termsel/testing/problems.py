"""Small problems with known answers, which check how a solver uses them."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from termsel.data.features import BoolArray, FeatureSet, FloatArray, Points, select
from termsel.models.polynomial import Polynomial2D
from termsel.selection.criteria import CheckRmse
from termsel.selection.problems.base import (
    WORST,
    Evaluation,
    Problem,
    ProblemAround,
    ProblemData,
    Selection,
)
from termsel.selection.problems.genome import Genome
from termsel.selection.problems.segments import (
    AnySegment,
    Bits,
    Categories,
    CustomSegment,
    Genes,
    Integers,
    Permutation,
    Reals,
    Subset,
)
from termsel.selection.problems.selection import SelectionProblem
from termsel.testing.cases import require
from termsel.testing.scenes import imaged_features, numbered_names

__all__ = [
    "Counted",
    "Toy",
    "Watched",
    "bounded_problem",
    "hopeless_problem",
    "least_objective",
    "narrow_problem",
    "problem_of_twelve_terms",
    "problem_of_two_aims",
    "trap_problem",
    "typed_problem",
]

SIZE = 12
"""Genes of a problem, by default: as many as a 2-D polynomial of second degree has terms."""

Judge = Callable[[BoolArray], tuple[FloatArray, FloatArray]]


class Toy(Problem):
    """A problem that is quick to evaluate.

    The judge takes genes (p, size) and returns objectives (p, m) and violations (p,).
    """

    def __init__(self, genome: Genome, judge: Judge,
                 objectives: tuple[str, ...] = ("cost",)) -> None:
        self.genome = genome
        self.objectives = objectives
        self.judge = judge

    def evaluate(self, genes: BoolArray) -> Evaluation:
        """Return the evaluation by the judge."""
        return Evaluation(*self.judge(genes))

    def decode(self, genes: BoolArray) -> Selection:
        """Return the labels of the genes that are on, as terms."""
        return Selection(select(self.genome.labels, genes), ())


class Watched(ProblemAround):
    """A problem that refuses genes that no solver may send, and counts evaluations.

    `before` is called with the number of the call, from 1, before each evaluation; the solver must
    let its exceptions pass.
    """

    def __init__(self, inner: Problem, before: Callable[[int], None] | None = None) -> None:
        super().__init__(inner)
        self.before = before
        self.calls = 0
        self.evaluated = 0
        self.best: tuple[float, float] = (np.inf, np.inf)

    def evaluate(self, genes: BoolArray) -> Evaluation:
        """Return the evaluation of genes, whose type, shape and rules must be kept."""
        # Before the evaluation, which may fail in another way with such genes.
        require_genes(self.genome, genes, "evaluate() got")
        self.calls += 1
        if self.before is not None:
            self.before(self.calls)
        self.evaluated += len(genes)
        evaluation = self.inner.evaluate(genes)
        if len(genes):
            first = int(evaluation.order()[0])
            self.best = min(self.best, (float(evaluation.violation[first]),
                                        float(evaluation.objectives[first, 0])))
        return evaluation


class Counted(ProblemAround):
    """A problem with the number of genes that are on as its last objective."""

    def __init__(self, inner: Problem) -> None:
        super().__init__(inner)
        self.objectives = (*inner.objectives, "on")

    def evaluate(self, genes: BoolArray) -> Evaluation:
        """Return the evaluation of the inner problem, and the count."""
        evaluation = self.inner.evaluate(genes)
        sizes = genes.sum(axis=1)
        return Evaluation(np.column_stack([evaluation.objectives, sizes]), evaluation.violation)


def require_genes(genome: Genome, genes: object, who: str) -> None:
    """Require a population that keeps type, shape, forced genes and cardinality.

    `who` begins the message of the AssertionError, with a verb, such as "evaluate() got".
    """
    fault = genome.fault(genes)
    require(fault is None, f"{who} {fault}")
    assert isinstance(genes, np.ndarray)
    require(genome.keeps(genes).all(),
            f"{who} genes in which forced ones are switched, or too few or too many of a segment "
            "are on; send them through problem.genome.repair()")


def problem_of_twelve_terms() -> SelectionProblem:
    """Return the choice among the 12 terms of a 2-D polynomial of second degree.

    Half of the terms are needed, and noise makes the others harmful; `least_objective` enumerates
    all 4096 selections.
    """
    model = Polynomial2D(degree=2)
    # With this seed the best of all selections has just the needed terms.
    rng = np.random.default_rng(9)
    noise = 0.05
    is_needed = np.arange(SIZE) % 2 == 0
    # Six times the noise, so that a needed term shows.
    truth = rng.choice([-0.3, 0.3], SIZE) * is_needed
    n_points = 12
    control, check = (imaged_features(model, truth, rng, points=n_points).points for _ in range(2))
    noisy = Points(control.ids, control.image + rng.normal(0.0, noise, (n_points, 2)),
                   control.ground)
    # Any number would do: it only multiplies the objective.
    pixels_per_unit = 100.0
    data = ProblemData(model, FeatureSet(noisy), check, pixels_per_unit, CheckRmse())
    return SelectionProblem(data, terms=True, features=False)


def trap_problem(size: int = 2 * SIZE) -> Toy:
    """Return a problem whose cost leads away from the few selections that are feasible.

    The violation counts the genes that differ from an alternating pattern, but for two; the
    cost counts those that agree with it. One selection in fifty thousand is feasible.
    """
    pattern = np.arange(size) % 2 == 0

    def judge(genes: BoolArray) -> tuple[FloatArray, FloatArray]:
        different = (genes != pattern).sum(axis=1).astype(np.float64)
        return size - different[:, None], np.maximum(different - 2, 0.0)

    return Toy(_genome_of_halves(size), judge)


def hopeless_problem(size: int = SIZE) -> Toy:
    """Return a problem no individual of which is feasible; all cost the same."""
    return Toy(_genome_of_halves(size), lambda genes: (
        np.full((len(genes), 1), WORST), 1.0 + genes.sum(axis=1)))


def bounded_problem() -> Toy:
    """Return a problem with forced genes, and with bounds on how many are on.

    Of segment "a", 2 to 4 of 8 genes are on, a1 always and a2 never; of segment "b" exactly 3
    of 6; segment "c" is free but for c1, which is always on. The cost counts the genes that
    differ from a1, a5, a6, b4, b5, b6, c1 and c3: the optimum is 0.
    """
    segments = (Bits("a", numbered_names("a", 8), 2, 4), Bits("b", numbered_names("b", 6), 3, 3),
                Bits("c", numbered_names("c", 4)))
    genome = Genome(segments, on=("a1", "c1"), off=("a2",))
    # Within the bounds of all three segments, and not the first that a search would meet.
    best = np.isin(genome.labels, ("a1", "a5", "a6", "b4", "b5", "b6", "c1", "c3"))
    return Toy(genome, lambda genes: (
        (genes != best).sum(axis=1, keepdims=True).astype(np.float64), np.zeros(len(genes))))


def problem_of_two_aims(size: int = SIZE) -> Toy:
    """Return a problem of two objectives: genes off in the first half, and genes on at all."""
    return Toy(_genome_of_halves(size), lambda genes: (
        np.column_stack([_count_off(genes[:, :size // 2]), genes.sum(axis=1)]).astype(np.float64),
        np.zeros(len(genes))), ("off", "on"))


class Even(CustomSegment):
    """Even numbers from 0 to 8, as an example of genes of one's own."""

    @property
    def limits(self) -> tuple[int, int]:
        """Least and greatest number."""
        return 0, 8

    def repaired(self, genes: Genes) -> Genes:
        """Return the nearest even numbers."""
        return np.asarray(2 * np.clip(np.rint(genes / 2), 0, 4).astype(np.intp))


def typed_problem(types: Iterable[type[AnySegment]]) -> Toy:
    """Return a problem with a segment of each type, whose cost is the sum of squares of all genes.

    Of each `Bits` and `Subset` the first label is forced on and the second off.
    """
    genomes: dict[type[AnySegment], AnySegment] = {
        Bits: Bits("bits", numbered_names("b", 6), 2, 4),
        Integers: Integers("integers", numbered_names("i", 2), (-2, 0), (3, 100)),
        Reals: Reals("reals", numbered_names("r", 2), -1.5, 2.5),
        Categories: Categories("categories", numbered_names("c", 2), ("x", "y", "z")),
        Permutation: Permutation("permutation", numbered_names("p", 5)),
        Subset: Subset("subset", numbered_names("s", 8), 3),
        CustomSegment: Even("even", numbered_names("e", 3))}
    segments = [genomes[kind] for kind in types]
    switched = [segment for segment in segments if isinstance(segment, Bits | Subset)]
    genome = Genome(segments, on=[segment.labels[0] for segment in switched],
                    off=[segment.labels[1] for segment in switched])
    return Toy(genome, lambda genes: (
        (genes.astype(np.float64)**2).sum(axis=1, keepdims=True), np.zeros(len(genes))))


def narrow_problem(size: int, on: tuple[str, ...] = ()) -> Toy:
    """Return the problem of switching few genes on, some or all of them forced on."""
    return Toy(Genome([Bits("terms", numbered_names("g", size))], on=on),
               lambda genes: (_count_off(genes), np.zeros(len(genes))))


def least_objective(problem: Problem) -> float:
    """Return the least first objective of the feasible selections of a small problem."""
    genome = problem.genome
    # Row i has the binary digits of i, so that all selections are among the rows.
    selections = (np.arange(2**genome.size)[:, None] >> np.arange(genome.size)) & 1 > 0
    evaluation = problem.evaluate(selections[genome.keeps(selections)])
    return float(evaluation.objectives[evaluation.violation == 0, 0].min())


def _genome_of_halves(size: int) -> Genome:
    """Return a genome of two segments of bits, together of this size."""
    half = size // 2
    return Genome([Bits("terms.line", numbered_names("l", half)),
                   Bits("terms.sample", numbered_names("s", size - half))])


def _count_off(genes: BoolArray) -> FloatArray:
    """Return how many genes of individuals (p, n) are off, (p, 1)."""
    return np.asarray((~genes).sum(axis=1, keepdims=True), dtype=np.float64)
