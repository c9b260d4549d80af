"""Operators on populations of any genome: crossover, mutation, neighbours, random keys.

Solvers take what varies genes from here, whatever the segments. All operators act on valid genes
and return valid ones, but for forced genes and the number of bits that are on: these
`Genome.repair` restores.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from termsel.data.features import BoolArray, FloatArray, IntArray
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

SPREAD_OF_CHILDREN, SPREAD_OF_MUTANTS = 15.0, 20.0
"""Distribution indices of simulated binary crossover and polynomial mutation, as usual."""

HALVINGS = 20
"""Neighbours of a number are a half, a quarter, ... of its range away, this many times."""


def draw_evenly(genome: Genome, rng: np.random.Generator, n: int) -> Genes:
    """Return n individuals, shape (n, size), whose bits are on with chance 1/2; others as ever."""
    genes = genome.random(rng, n)
    for segment, columns in zip(genome.segments, genome.slices().values(), strict=True):
        if isinstance(segment, Bits):
            genes[:, columns] = rng.random((n, len(segment.labels))) < 0.5
    return genome.repair(genes, rng)


def cross_pairs(genes: Genes, genome: Genome, probability: float, rng: np.random.Generator,
                points: int = 0) -> Genes:
    """Return children (p, g) of pairs of parents (p, g): rows 0 and 1, 2 and 3, and so on.

    A pair mates with the given probability; else its children are the parents. Bits and categories
    are swapped with chance 1/2, or between two places of the segment if there are two `points`.
    Numbers are crossed by simulated binary crossover (Deb, Agrawal 1995), whole ones rounded;
    permutations by order crossover (Davis 1985). Subsets keep what both parents have.
    """
    if genome.dtype == np.bool_:
        mate = cross_at_two_points if points else uniform_crossover
        return mate(genes, probability, rng)
    # An odd individual at the end stays as it is.
    pairs = len(genes) // 2
    even_rows = slice(0, 2 * pairs, 2)
    odd_rows = slice(1, 2 * pairs, 2)
    mates = rng.random((pairs, 1)) < probability
    children = genes.copy()
    for segment, columns in zip(genome.segments, genome.slices().values(), strict=True):
        parents_1 = genes[even_rows, columns]
        parents_2 = genes[odd_rows, columns]
        children_1, children_2 = _cross_pairs(segment, parents_1, parents_2, rng, points)
        children[even_rows, columns] = np.where(mates, children_1, parents_1)
        children[odd_rows, columns] = np.where(mates, children_2, parents_2)
    return children


def mutate_genes(genes: Genes, genome: Genome, probability: float,
                 rng: np.random.Generator) -> Genes:
    """Return valid genes (p, g), each changed with the given chance.

    Bits flip. Categories become another one. Numbers change by polynomial mutation (Deb, Goyal
    1996), whole ones by 1 at least. A part of a permutation is reversed, and one member of a subset
    replaced, with the chance that one of its genes would change, at most 1.
    """
    if genome.dtype == np.bool_:
        return flip_bits(genes, probability, rng)
    mutants = genes.copy()
    for segment, columns in zip(genome.segments, genome.slices().values(), strict=True):
        mutants[:, columns] = _mutate_segment(segment, genes[:, columns], probability, rng)
    return mutants


def _cross_pairs(segment: AnySegment, parents_1: Genes, parents_2: Genes,
                 rng: np.random.Generator, points: int) -> tuple[Genes, Genes]:
    """Return two children of each pair of parents, each of the shape (p, size) of the parents.

    How they are crossed depends on the type of the segment. Where genes are swapped, they are those
    between two places if `points` is not 0, and else each gene with probability 1/2.
    """
    match segment:
        case Integers() | Reals():
            return _cross_numbers(segment, parents_1, parents_2, rng)
        case Permutation():
            return _cross_permutations(parents_1, parents_2, rng)
        case Subset():
            # Parents in turn, as `set_crossover` takes them; who mates is decided by its caller.
            pairs = np.stack([parents_1, parents_2], axis=1)
            parents = pairs.reshape(2 * len(parents_1), segment.m)
            children = set_crossover(parents, 1.0, rng)
            return children[::2], children[1::2]
        case CustomSegment():
            return segment.crossed(parents_1, parents_2, rng)
        case _:
            swap = (_are_between_two_places(parents_1, rng) if points
                    else rng.random(parents_1.shape) < 0.5)
            return np.where(swap, parents_2, parents_1), np.where(swap, parents_1, parents_2)


def _cross_numbers(segment: Integers | Reals, parents_1: Genes, parents_2: Genes,
                   rng: np.random.Generator) -> tuple[Genes, Genes]:
    """Return two children of each pair of parents by simulated binary crossover.

    Both are of the shape (p, size) of the parents, within the segment's bounds (Deb, Agrawal 1995).
    """
    from pymoo.operators.crossover.sbx import cross_sbx

    # The spread of each pair, the chance that a number is crossed, and that children change places.
    spreads = np.full((len(parents_1), 1), SPREAD_OF_CHILDREN)
    crossing = 0.5
    exchange = np.full((len(parents_1), 1), 0.5)
    children = cross_sbx(
        np.stack([parents_1, parents_2]).astype(np.float64),
        np.array(segment.low, dtype=np.float64), np.array(segment.high, dtype=np.float64),
        spreads, crossing, exchange, random_state=rng)
    return segment.repaired(children[0]), segment.repaired(children[1])


def _cross_permutations(parents_1: Genes, parents_2: Genes,
                        rng: np.random.Generator) -> tuple[Genes, Genes]:
    """Return two children (p, size) of each pair of permutations by order crossover (Davis 1985).

    A child keeps a part of one parent, and has the other members in the order of the other parent.
    """
    from pymoo.operators.crossover.ox import ox, random_sequence

    children = parents_1.copy(), parents_2.copy()
    if parents_1.shape[1] > 1:
        for i, (parent_1, parent_2) in enumerate(zip(parents_1, parents_2, strict=True)):
            ends = random_sequence(len(parent_1), random_state=rng)
            children[0][i] = ox(parent_1, parent_2, seq=ends)
            children[1][i] = ox(parent_2, parent_1, seq=ends)
    return children


def _mutate_segment(segment: AnySegment, genes: Genes, probability: float,
                    rng: np.random.Generator) -> Genes:
    """Return genes (p, size) of one segment, mutated in the way of its type.

    Each gene changes with this probability. A permutation or a subset changes as a whole, with the
    probability times its size, at most 1.
    """
    match segment:
        case Bits():
            return flip_bits(genes.astype(bool), probability, rng)
        case Categories():
            # Any other category is 1 to n - 1 places on, in a circle.
            n = len(segment.choices)
            categories = (genes + rng.integers(1, max(n, 2), genes.shape)) % n
            return np.where(rng.random(genes.shape) < probability, categories, genes)
        case Integers() | Reals():
            return _mutate_polynomially(segment, genes, probability, rng)
        case Permutation():
            return _reverse_parts(genes, min(probability * segment.size, 1.0), rng)
        case Subset():
            return replace_one(genes.astype(np.intp), len(segment.labels),
                               min(probability * segment.m, 1.0), rng)
        case CustomSegment():
            return segment.mutated(genes, probability, rng)


def _mutate_polynomially(segment: Integers | Reals, genes: Genes, probability: float,
                         rng: np.random.Generator) -> Genes:
    """Return numbers (p, size), each changed with a probability by polynomial mutation.

    They stay within the segment's bounds (Deb, Goyal 1996).
    """
    from pymoo.operators.mutation.pm import mut_pm

    p = len(genes)
    mutants = mut_pm(genes.astype(np.float64), np.array(segment.low, dtype=np.float64),
                     np.array(segment.high, dtype=np.float64), np.full(p, SPREAD_OF_MUTANTS),
                     np.full(p, probability), at_least_once=False, random_state=rng)
    if isinstance(segment, Integers):
        # A change that rounding would undo is one step in its direction.
        step = np.where(mutants > genes, 1, np.where(mutants < genes, -1, 0))
        rounded = np.rint(mutants)
        mutants = np.where(rounded == genes, genes + step, rounded)
    return segment.repaired(mutants)


def _reverse_parts(genes: Genes, probability: float, rng: np.random.Generator) -> Genes:
    """Return permutations (p, size), in some of which a random part is reversed.

    Each is changed with the given probability.
    """
    # Inversion: neighbours stay neighbours, but for the two ends of the part.
    mutants = genes.copy()
    n = genes.shape[1]
    if n > 1:
        for row in mutants[rng.random(len(genes)) < probability]:
            start, end = np.sort(rng.choice(n, 2, replace=False))
            row[start:end + 1] = row[start:end + 1][::-1].copy()
    return mutants


def uniform_crossover(genes: Genes, probability: float, rng: np.random.Generator) -> Genes:
    """Return children (p, g); each gene of a mating pair of parents is swapped with chance 1/2.

    Rows 0 and 1 are a pair, 2 and 3, and so on, which mates with the given probability.
    """
    parents_1, _ = _parents_in_pairs(genes)
    is_swapped = rng.random(parents_1.shape) < 0.5
    is_swapped &= rng.random((len(parents_1), 1)) < probability
    return _with_swapped_genes(genes, is_swapped)


def cross_at_two_points(genes: Genes, probability: float, rng: np.random.Generator) -> Genes:
    """Return children (p, g); a mating pair of parents swaps the genes between two places.

    Rows 0 and 1 are a pair, 2 and 3, and so on, which mates with the given probability.
    """
    parents_1, _ = _parents_in_pairs(genes)
    is_swapped = _are_between_two_places(parents_1, rng)
    is_swapped &= rng.random((len(parents_1), 1)) < probability
    return _with_swapped_genes(genes, is_swapped)


def _parents_in_pairs(genes: Genes) -> tuple[Genes, Genes]:
    """Return the even and the odd rows of genes (p, g), without an odd individual at the end."""
    pairs = len(genes) // 2
    return genes[0:2 * pairs:2], genes[1:2 * pairs:2]


def _with_swapped_genes(genes: Genes, is_swapped: BoolArray) -> Genes:
    """Return genes (p, g) in which the pairs of rows have exchanged some, (p // 2, g)."""
    parents_1, parents_2 = _parents_in_pairs(genes)
    children = genes.copy()
    children[0:2 * len(parents_1):2] = np.where(is_swapped, parents_2, parents_1)
    children[1:2 * len(parents_1):2] = np.where(is_swapped, parents_1, parents_2)
    return children


def _are_between_two_places(genes: Genes, rng: np.random.Generator) -> BoolArray:
    """Return which genes (n, size) lie between two places, random ones for each chromosome."""
    n, size = genes.shape
    places = np.sort(rng.integers(0, size + 1, (n, 2)), axis=1)
    number = np.arange(size)
    return (number >= places[:, :1]) & (number < places[:, 1:])


def flip_bits(genes: BoolArray, probability: float, rng: np.random.Generator) -> BoolArray:
    """Return genes (p, size), each flipped with the given chance."""
    return genes ^ (rng.random(genes.shape) < probability)


def set_crossover(tuples: IntArray, probability: float, rng: np.random.Generator) -> IntArray:
    """Return children (p, m) with the numbers that both parents have, and random others of theirs.

    Parents are tuples (p, m) of numbers without repetition, each row ascending, and so are their
    children. Rows 0 and 1 are a pair, 2 and 3, and so on, which mates with the given probability.
    """
    pairs = len(tuples) // 2
    m = tuples.shape[1]
    # Sorted, the numbers that both parents have stand twice, next to each other.
    numbers = np.sort(tuples[:2 * pairs].reshape(pairs, 2 * m), axis=1)
    is_repeated = np.zeros(numbers.shape, dtype=bool)
    is_repeated[:, 1:] = numbers[:, 1:] == numbers[:, :-1]
    mates = rng.random(pairs) < probability
    children = tuples.copy()
    for child in (0, 1):
        # Of a shared number one comes first and its twin last; numbers of one parent are shuffled
        # between them.
        sort_key = rng.random(numbers.shape)
        sort_key[is_repeated] = -1.0
        sort_key[:, :-1][is_repeated[:, 1:]] = 2.0
        members = np.take_along_axis(numbers, sort_key.argsort(axis=1)[:, :m], axis=1)
        children[child:2 * pairs:2][mates] = np.sort(members[mates], axis=1)
    return children


def replace_one(tuples: IntArray, n: int, probability: float, rng: np.random.Generator) -> IntArray:
    """Return tuples (p, m), in some of which one number is replaced by one they did not have.

    Tuples have numbers from 0 to n - 1, each row ascending. Each is changed with the given
    probability; none can be where they have all numbers, or none.
    """
    p, m = tuples.shape
    # Which tuples change is drawn even where none can: the stream of chance stays the same.
    mutants = np.flatnonzero(rng.random(p) < probability)
    if not m or m == n:
        return tuples
    dropped = rng.integers(0, m, len(mutants))
    # The r-th number that is not in a row: r moves up by one for each member before it.
    rank = rng.integers(0, n - m, len(mutants))
    smaller = tuples[mutants] - np.arange(m) <= rank[:, None]
    changed = tuples.copy()
    changed[mutants, dropped] = rank + smaller.sum(axis=1)
    return np.sort(changed, axis=1)


def neighbours_of_segment(segment: AnySegment, genes: Genes) -> Iterator[Genes]:
    """Yield the neighbours of genes (size,) of a segment that is not bits, in batches (n, size).

    Integers and real numbers move by a half, a quarter, ... of their range, or to a bound; a
    category becomes each other one; a permutation has two of its members exchanged; a subset has
    one member replaced. All these are valid and differ from the genes. Those of a custom segment
    are its own `steps`.

    Raises TypeError for bits, whose neighbours are those of `swap.neighbour_batches`.
    """
    n = segment.size
    match segment:
        case Integers() | Reals():
            low = np.array(segment.low)
            high = np.array(segment.high)
            for i in range(n):
                steps = (high[i] - low[i]) * 0.5 ** np.arange(1, HALVINGS + 1)
                if isinstance(segment, Integers):
                    steps = np.unique(np.maximum(np.rint(steps), 1))[::-1]
                values = np.clip(genes[i] + np.concatenate([steps, -steps]), low[i], high[i])
                # Several steps end at a bound: each value once, in the order of its step.
                values = values[np.sort(np.unique(values, return_index=True)[1])]
                yield _with_values_at(genes, i, values[values != genes[i]])
        case Categories():
            for i in range(n):
                values = np.arange(len(segment.choices))
                yield _with_values_at(genes, i, values[values != genes[i]])
        case Permutation():
            for i in range(n - 1):  # each pair once
                exchanged = np.repeat(genes[None], n - 1 - i, axis=0)
                exchanged[:, i] = genes[i + 1:]
                exchanged[np.arange(n - 1 - i), np.arange(i + 1, n)] = genes[i]
                yield exchanged
        case Subset():
            # Members stay sorted: a set has one chromosome.
            outsiders = np.setdiff1d(np.arange(len(segment.labels)), genes)
            for i in range(n):
                yield np.sort(_with_values_at(genes, i, outsiders), axis=1)
        case CustomSegment():
            yield from segment.steps(genes)
        case Bits():  # see `swap.neighbour_batches`
            raise TypeError("the neighbours of bits depend on their cardinality")


def _with_values_at(genes: Genes, i: int, values: Genes) -> Genes:
    """Return copies of genes with other values at one place."""
    copies = np.repeat(genes[None], len(values), axis=0)
    copies[:, i] = values
    return copies


def n_keys(genome: Genome) -> int:
    """Return how many random keys a chromosome of the genome has."""
    return sum(map(_keys_of, genome.segments))


def from_keys(keys: FloatArray, genome: Genome) -> Genes:
    """Return the genes that random keys stand for (Bean 1994), before their repair.

    Keys, shape (p, n_keys(genome)), from 0 to 1, are what a solver in a continuous space moves. A
    bit is on above one half; a number is at that share of its range; of categories the greatest key
    is taken; keys in their order are a permutation; the m greatest are a subset.
    """
    # A segment takes as many keys as it needs, which may be more than it has genes.
    genes = np.empty((len(keys), genome.size), dtype=genome.dtype)
    start = 0
    for segment, columns in zip(genome.segments, genome.slices().values(), strict=True):
        count = _keys_of(segment)
        genes[:, columns] = _genes_of_keys(segment, keys[:, start:start + count])
        start += count
    return genes


def _keys_of(segment: AnySegment) -> int:
    """Return how many random keys stand for the genes of a segment."""
    match segment:
        case Categories():
            return segment.size * len(segment.choices)
        case Subset():
            return len(segment.labels)
        case CustomSegment():
            return segment.keys
        case _:
            return segment.size


def _genes_of_keys(segment: AnySegment, keys: FloatArray) -> Genes:
    """Return the genes (p, size) of one segment that random keys (p, n), from 0 to 1, stand for.

    A gene has one key, a category one for each of its choices, of which the largest wins. The
    order of the keys gives a permutation; a subset has the members with the largest keys.
    """
    match segment:
        case Bits():
            return keys > 0.5
        case Reals():
            low = np.array(segment.low)
            high = np.array(segment.high)
            return segment.repaired(low + keys * (high - low))
        case Integers():
            low = np.array(segment.low)
            high = np.array(segment.high)
            # Each whole number has the same share of the keys.
            return segment.repaired(np.floor(low + keys * (high - low + 1)))
        case Categories():
            keys_of_genes = keys.reshape(len(keys), segment.size, -1)
            return np.asarray(keys_of_genes.argmax(axis=2))
        case Permutation():
            return keys.argsort(axis=1)
        case Subset():
            members: IntArray = np.argsort(-keys, axis=1)[:, :segment.m]
            return np.sort(members, axis=1)
        case CustomSegment():
            return segment.unlocked(keys)
