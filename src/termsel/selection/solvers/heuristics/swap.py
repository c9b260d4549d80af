"""Local search by adding, dropping and swapping genes; also refines the result of others."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from termsel.data.features import BoolArray, IntArray, select
from termsel.selection.problems.base import Evaluation, Problem
from termsel.selection.problems.genome import Genome
from termsel.selection.problems.segments import SEGMENTS, AnySegment, Bits, Genes, Subset
from termsel.selection.solvers.base import Generation, Solver
from termsel.selection.solvers.genetic.operators import mutate_genes, neighbours_of_segment

BATCH = 2000
"""Most neighbours evaluated before a step: all of a small genome; all of a large one would not
fit into memory."""


def improving_moves(genes: Genes, problem: Problem) -> Iterator[Genes]:
    """Yield the moves that the problem itself offers, then all `neighbour_batches`."""
    yield from problem.moves(genes)
    yield from neighbour_batches(genes, problem.genome)


def neighbour_batches(genes: Genes, genome: Genome) -> Iterator[Genes]:
    """Yield all valid individuals one step away, in batches (n, size) of up to BATCH.

    In a genome of bits, selections with one gene more or less come first, then those in which a
    gene that is on is replaced by another of its segment. Forced genes stay, and the number of
    genes that are on stays within what each segment allows. The steps of other genes are those of
    `termsel.selection.solvers.genetic.operators.neighbours_of_segment`.
    """
    if genome.dtype == np.bool_:
        yield from _neighbours_of_bits(genes, genome)
        return
    for segment, columns in zip(genome.segments, genome.slices().values(), strict=True):
        for changed in _neighbours_in_segment(genes[columns], genome, segment):
            for start in range(0, len(changed), BATCH):
                batch = changed[start:start + BATCH]
                individuals = np.repeat(genes[None], len(batch), axis=0)
                individuals[:, columns] = batch
                yield individuals


def _neighbours_in_segment(genes: Genes, genome: Genome, segment: AnySegment) -> Iterator[Genes]:
    """Yield the genes one step away from the genes (size,) of a segment, in batches (b, size).

    Forced genes stay.
    """
    labels = genome.label_slices()[segment.name]
    if isinstance(segment, Bits):
        segment_genome = Genome([segment], on=select(segment.labels, genome.on[labels]),
                                off=select(segment.labels, genome.off[labels]))
        yield from _neighbours_of_bits(genes.astype(bool), segment_genome)
    else:
        for stepped in neighbours_of_segment(segment, genes):
            if isinstance(segment, Subset):
                # One member gives way to another: neither may be forced.
                moved = segment.mask(stepped) ^ segment.mask(genes[None])
                stepped = stepped[~(moved & ~genome.free[labels]).any(axis=1)]
            yield stepped


def _neighbours_of_bits(genes: BoolArray, genome: Genome) -> Iterator[BoolArray]:
    """Yield the neighbours of `genes` (size,), in a genome of bits alone, in batches (b, size).

    A neighbour has one bit more or less, or one bit moved to another place of its segment, within
    the numbers that the segment allows. There may be millions of moves, so that none is made before
    its batch is asked for.
    """
    flips: list[IntArray] = []  # genes that may be switched without leaving the cardinality
    # A move exchanges a gene that is on for one that is off. Of each segment these genes are kept:
    # their pairs may be very many, so that they are numbered, and made when their batch is.
    movable: list[tuple[IntArray, IntArray]] = []
    for segment, columns in zip(genome.segments, genome.slices().values(), strict=True):
        assert isinstance(segment, Bits)
        count = int(genes[columns].sum())
        free = np.flatnonzero(genome.free[columns]) + columns.start
        on = free[genes[free]]
        off = free[~genes[free]]
        flips += [off] if count < segment.most else []
        flips += [on] if count > segment.minimum else []
        movable.append((on, off))
    # Numbers 0 to ends[0] are flips, then come the moves of each segment.
    flippable = np.concatenate([*flips, np.empty(0, dtype=np.intp)])
    ends = np.cumsum([len(flippable), *(len(on) * len(off) for on, off in movable)])
    for start in range(0, int(ends[-1]), BATCH):
        number = np.arange(start, min(start + BATCH, int(ends[-1])))
        # The two genes that change; in a flip both are one gene.
        switched_off = np.empty(len(number), dtype=np.intp)
        switched_on = np.empty_like(switched_off)
        is_flip = number < ends[0]
        switched_off[is_flip] = switched_on[is_flip] = flippable[number[is_flip]]
        for (on, off), begin, end in zip(movable, ends[:-1], ends[1:], strict=True):
            in_segment = (number >= begin) & (number < end)
            # Move i of a segment has its gene i // |off| that is on, and i % |off| that is off.
            switched_off[in_segment] = on[(number[in_segment] - begin) // max(len(off), 1)]
            switched_on[in_segment] = off[(number[in_segment] - begin) % max(len(off), 1)]
        individuals = np.repeat(genes[None], len(number), axis=0)
        rows = np.arange(len(number))
        individuals[rows, switched_off] ^= True
        # Written from the genes themselves, so that a flip is not undone.
        individuals[rows, switched_on] = ~genes[switched_on]
        yield individuals


def descend(problem: Problem, genes: Genes, evaluation: Evaluation, index: int = 0,
            ) -> Iterator[Generation]:
    """Step to better neighbours while there are any; yield each selection, the start first.

    A step goes to the best of the first batch of `neighbour_batches` that has a better one; when
    the descent ends, no neighbour is better. If several segments of the genome have a better
    neighbour, the step combines the best of each, if that is better still: line and sample are
    often independent. The start, genes (1, size), comes with its evaluation and the number of the
    first generation.
    """
    # No selection is met twice: each step improves, so that the descent ends.
    better = True
    while better:
        yield Generation(index, genes, evaluation)
        index += 1
        better = False
        for around in improving_moves(genes[0], problem):
            neighbour_evaluation = problem.evaluate_near(around, genes[0])
            # The first batch with a better one is enough: further ones may be very many.
            best_neighbour = neighbour_evaluation.take(neighbour_evaluation.order()[:1])
            if _comparison_key(best_neighbour) < _comparison_key(evaluation):
                genes, evaluation = _combine_best_changes(
                    problem, genes, evaluation, around, neighbour_evaluation
                )
                better = True
                break


def climb(problem: Problem, genes: Genes, evaluation: Evaluation,
          rng: np.random.Generator) -> Iterator[list[Generation]]:
    """Descend from a selection (1, size), then repeatedly from others, without end.

    Yielded are the steps of one start at a time; the last is the best so far.

    Every second descent starts from a random selection, the others from the best with a random
    share of its genes changed, at most half. If segments of its end improve the best, they are
    copied to it, and a descent from there follows. termsel's own formulation: the first kind
    finds the optimum of small problems, the second improves large ones.
    """
    genome = problem.genome
    climbed = list(descend(problem, genes, evaluation))
    for start in itertools.count():
        best = climbed[-1]
        yield climbed
        # In turn from the neighbourhood of the best and from anywhere.
        if start % 2:
            elsewhere = genome.repair(_shake_genes(best.genes, genome, rng), rng)
        else:
            elsewhere = genome.random(rng, 1)
        climbed = list(descend(problem, elsewhere, problem.evaluate(elsewhere), best.index + 1))
        reached = climbed[-1]
        # A segment of its end may improve the best even if all of it does not.
        candidates = np.repeat(best.genes, len(genome.segments) + 1, axis=0)
        # Row i is the best with segment i of the end; the last row is the end itself.
        for i, columns in enumerate(genome.slices().values()):
            candidates[i, columns] = reached.genes[0, columns]
        candidates[-1] = reached.genes[0]
        combined, combined_evaluation = _combine_best_changes(
            problem, best.genes, best.evaluation, candidates, problem.evaluate(candidates)
        )
        climbed += descend(problem, combined, combined_evaluation, reached.index + 1)


def _shake_genes(genes: Genes, genome: Genome, rng: np.random.Generator) -> Genes:
    """Return genes, a random share of which is changed, at most half."""
    if genome.dtype == np.bool_:
        return genes ^ (rng.uniform(size=(1, genome.size)) < rng.uniform(0.0, 0.5))
    return mutate_genes(genes, genome, rng.uniform(0.0, 0.5), rng)


def _combine_best_changes(problem: Problem, genes: Genes, evaluation: Evaluation, around: Genes,
                          neighbour_evaluation: Evaluation) -> tuple[Genes, Evaluation]:
    """Return the best of a selection, its neighbours and a combination, with its evaluation.

    The combination takes from the neighbours `around` (n, size) the best change of each segment
    that improves the selection, genes (1, size).
    """
    order = neighbour_evaluation.order()
    best = _better_of_two(genes, evaluation, around[order[:1]],
                          neighbour_evaluation.take(order[:1]))
    # Changes of single segments are improvements alone; together they are so where these add up.
    joined = genes.copy()
    changes = 0
    for columns in problem.genome.slices().values():
        changed = order[(around[order, columns] != genes[0, columns]).any(axis=1)][:1]
        if not len(changed):
            continue
        key = _comparison_key(neighbour_evaluation.take(changed))
        if key < _comparison_key(evaluation):
            joined[0, columns] = around[changed[0], columns]
            changes += 1
    return _better_of_two(*best, joined, problem.evaluate(joined)) if changes > 1 else best


def _better_of_two(genes: Genes, evaluation: Evaluation, other_genes: Genes,
                   other_evaluation: Evaluation) -> tuple[Genes, Evaluation]:
    """Return the better of two individuals with its evaluation; the first of equals."""
    if _comparison_key(other_evaluation) < _comparison_key(evaluation):
        return other_genes, other_evaluation
    return genes, evaluation


def _comparison_key(evaluation: Evaluation) -> tuple[float, float]:
    """Return violation and objective of a single individual, in the order in which they compare."""
    return float(evaluation.violation[0]), float(evaluation.objectives[0, 0])


class Swap(Solver):
    """Add, drop and swap genes as long as that helps, from many starts.

    termsel's own formulation; see `climb`. The same local refinement follows heuristics.
    """

    name = "swap"
    segments = SEGMENTS

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        """Yield one generation per step of each descent, without end (see `Solver.generations`)."""
        genes = problem.genome.random(rng, 1)
        for climbed in climb(problem, genes, problem.evaluate(genes), rng):
            yield from climbed
