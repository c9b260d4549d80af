"""Normal equations of many rows, from a block for every feature.

Where features have far more rows than there are terms, a QR factorisation of an individual's
rows costs most. With A = Q R of all rows, the rows of a feature enter the normal equations of Q by
a block that is computed once; those of an individual are a sum. G = Q_s'Q_s = L L' of its
rows gives k rows L'R, with the right-hand side L^-1 Q_s'b, which have the same solutions for any
selection of terms as all of its rows.

A itself is never squared, which for designs with conditions up to 3e7 would lose all digits. The
condition of G is that of a selection relative to all features, and near 1 for half of them. The
relative error of the fitted values is about k u cond(G), u = 1.1e-16 (Higham 2002, Accuracy and
Stability of Numerical Algorithms, section 20.4); individuals with a condition above
`SAFE_CONDITION` are left to the factorisation of their rows, so that it stays below 1e-10.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from termsel.adjustment.compiled import compile_lazily
from termsel.data.features import BoolArray, FloatArray, IntArray

SAFE_CONDITION = 1e4
"""Condition of the normal equations up to which they are used."""

BLOCK_COST, BLOCK_GAIN, SELECTED_BLOCK_GAIN = 0.7, 12, 8
"""Cost of a block by that of a row that is factored; rows less these, by terms, from which blocks
are faster: all rows, where half are selected, and the selected ones of an individual with terms of
its own, whose blocks cost as much as rows, as few may be read together. Measured with 38 and 39
terms."""

_BYTES = 1 << 28  # of all blocks
_MIN_COLUMN_REST = 1e-7  # least part of a column that those before it leave
_SUMMED = 64  # individuals whose sums are in memory at once
_CACHED = 32  # blocks that stay in the cache for all individuals


def blocks_of(source: FloatArray, feature: IntArray, triangle: FloatArray) -> FloatArray | None:
    """Return the block of each feature, (n + 1, w); None where blocks do not pay or are not safe.

    A block is the lower triangle of Q_i'Q_i row by row, each row followed by its entry of Q_i'b_i;
    the last block is that of the rows which are always in use. `source` (m, k + 2) is the design
    matrix, the right-hand side and a column of zeros; `feature` (m,) is the feature of each of its
    rows, from 0, or -1 if the row is always in use. `triangle` (k, k + 2) is R of all rows.
    """
    k = source.shape[1] - 2
    n = int(feature.max(initial=-1)) + 1
    width = k * (k + 3) // 2  # k (k + 1) / 2 products, and k with the right-hand side
    diagonal = np.abs(np.diag(triangle))[:k]
    lengths = np.linalg.norm(triangle[:, :k], axis=0)
    if (len(source) - BLOCK_COST * n < BLOCK_GAIN * k or 8 * (n + 1) * width > _BYTES
            or not len(diagonal) == k > 0 or (diagonal <= _MIN_COLUMN_REST * lengths).any()):
        return None
    # Q = A R^-1, column by column. Not by LAPACK, whose rounding varies from machine to machine.
    Q = source.T[:k].copy()
    for j in range(k):
        for i in range(j):
            Q[j] -= Q[i] * triangle[i, j]
        Q[j] /= triangle[j, j]
    blocks = np.zeros((n + 1, width))
    _fill_blocks(np.ascontiguousarray(Q.T), np.ascontiguousarray(source[:, k]),
                 np.where(feature < 0, n, feature), blocks)
    return blocks


@compile_lazily
def _fill_blocks(Q: FloatArray, b: FloatArray, feature: IntArray, blocks: FloatArray) -> None:
    """Add the rows of each feature i to its block in `blocks`: Q_i'Q_i with Q_i'b_i.

    Row r of `Q` (m, k) and `b` (m,) is of the feature number `feature[r]`. For the layout of
    `blocks` see `blocks_of`.
    """
    # Row x of the lower triangle of Q'Q, then its entry of Q'b: as `_triangularise_sum` reads them.
    for row in range(len(Q)):
        block = blocks[feature[row]]
        position = 0
        for x in range(Q.shape[1]):
            for z in range(x + 1):
                block[position] += Q[row, x] * Q[row, z]
                position += 1
            block[position] += Q[row, x] * b[row]
            position += 1


@compile_lazily
def _sum_blocks(blocks: FloatArray, features: BoolArray, total: FloatArray) -> None:
    """Add up the blocks of each individual, for the normal equations of a population.

    `blocks` (n + 1, w) are those of `blocks_of`; the last one counts for every individual.
    `features` (p, n) says which of the other blocks count. The sums are written to `total` (p, w).

    Features are taken in pieces that stay in the cache for all individuals. Each sum runs over the
    same pieces in the same order whatever other individuals select, so that an individual has the
    same fitness in every population.
    """
    n = len(blocks) - 1
    width = blocks.shape[1]
    selected = np.empty(_CACHED, dtype=np.intp)
    # Each sum begins with the block of the rows that are always in use.
    for individual in range(len(features)):
        for j in range(width):
            total[individual, j] = blocks[n, j]
    for start in range(0, n, _CACHED):
        for individual in range(len(features)):
            count = 0
            for i in range(start, min(start + _CACHED, n)):
                if features[individual, i]:
                    selected[count] = i
                    count += 1
            sums = total[individual]
            position = 0
            while position + 4 <= count:  # four at a time, as loads and stores cost more than sums
                block_1 = blocks[selected[position]]
                block_2 = blocks[selected[position + 1]]
                block_3 = blocks[selected[position + 2]]
                block_4 = blocks[selected[position + 3]]
                for j in range(width):
                    sums[j] += (block_1[j] + block_2[j]) + (block_3[j] + block_4[j])
                position += 4
            while position < count:
                block_1 = blocks[selected[position]]
                for j in range(width):
                    sums[j] += block_1[j]
                position += 1


@compile_lazily
def _triangularise_sum(total: FloatArray, triangle: FloatArray, lower: FloatArray,
                       source: FloatArray) -> float:
    """Turn the summed blocks of an individual into k rows with the same solutions.

    `total` (w,) is the sum, G = Q_s'Q_s packed with Q_s'b (see `blocks_of`), and `triangle` (k, k)
    is R of all rows. The rows are written to `source` (k, k + 2): L'R, with G = L L', and the
    right-hand side L^-1 Q_s'b in column k; column k + 1 stays. `lower` (k, k) is scratch for L.

    Returns the condition tr(G) tr(G^-1), which is at least that of G; infinite, with rows that are
    of no use, if G is not positive definite.
    """
    k = len(triangle)
    # Cholesky's triangle of G, row by row as the blocks are packed; L^-1 of the right-hand side.
    position = 0
    trace = 0.0
    inverse_trace = 0.0
    for x in range(k):
        for z in range(x):
            value = total[position + z]
            # l_xz = (g_xz - sum of l_xc l_zc) / l_zz
            for c in range(z):
                value -= lower[x, c] * lower[z, c]
            lower[x, z] = value / lower[z, z]
        value = total[position + x]
        right = total[position + x + 1]
        trace += value
        for c in range(x):
            value -= lower[x, c] * lower[x, c]
            right -= lower[x, c] * source[c, k]
        if not value > 0.0:  # fewer rows than terms, or rounding
            return np.inf
        lower[x, x] = np.sqrt(value)
        source[x, k] = right / lower[x, x]
        position += x + 2
    for z in range(k):  # the columns of L^-1, in the upper triangle of its transpose
        source[z, z] = 1.0 / lower[z, z]
        inverse_trace += source[z, z] * source[z, z]
        for x in range(z + 1, k):
            value = 0.0
            for c in range(z, x):
                value -= lower[x, c] * source[z, c]
            source[z, x] = value / lower[x, x]
            inverse_trace += source[z, x] * source[z, x]
    # L'R, which overwrites the inverse.
    for x in range(k):
        for j in range(k):
            value = 0.0
            for c in range(x, j + 1):
                value += lower[c, x] * triangle[c, j]
            source[x, j] = value
    return trace * inverse_trace


def where_blocks_pay(feature: IntArray, terms: BoolArray, features: BoolArray) -> BoolArray:
    """Return the individuals for which blocks are faster than factoring their rows, shape (p,).

    A row takes time in proportion to its selected terms, a block does not. The feature of each row
    (m,) is as for `blocks_of`, terms are (p, k), features (p, n) or (p, n + 1).
    """
    k = terms.shape[1]
    selected = np.count_nonzero(terms, axis=1)
    count = np.count_nonzero(features, axis=1)
    rows = count * len(feature) / max(features.shape[1], 1)  # as the mean feature has
    # Of all terms `blocks_of` has decided.
    return np.asarray((selected == k) | (rows * selected >= (count + SELECTED_BLOCK_GAIN * k) * k))


def reduced_rows(blocks: FloatArray, triangle: FloatArray, features: BoolArray, pays: BoolArray,
                 ) -> Iterator[tuple[slice, FloatArray | None]]:
    """Yield k rows for each individual, with the same solutions as all of its rows.

    Blocks (n + 1, w) are as `blocks_of` gives them, the triangle is (k, k), features are (p, n) or
    (p, n + 1), and `pays` (p,) says for which individuals blocks pay. With one individual come its
    triangle, right-hand side and a column of zeros, (k, k + 2), or None where that is not safe.
    With several comes None: blocks do not pay for them.
    """
    k = len(triangle)
    n = len(blocks) - 1
    lower = np.empty((k, k))
    system = np.zeros((k, k + 2))
    triangle = np.ascontiguousarray(triangle)
    # Neighbours for which blocks do not pay are given together, as a slice of the population.
    for equal_run in np.split(np.arange(len(features)), np.flatnonzero(np.diff(pays)) + 1):
        if equal_run.size and not pays[equal_run[0]]:
            yield slice(int(equal_run[0]), int(equal_run[-1]) + 1), None
    individuals = np.flatnonzero(pays)
    for start in range(0, len(individuals), _SUMMED):
        batch = individuals[start:start + _SUMMED]
        total = np.empty((len(batch), blocks.shape[1]))
        _sum_blocks(blocks, np.ascontiguousarray(features[batch, :n]), total)
        # One system serves all: each is used before the next is made.
        for individual, summed in zip(batch.tolist(), total, strict=True):
            safe = _triangularise_sum(summed, triangle, lower, system) <= SAFE_CONDITION
            yield slice(individual, individual + 1), system if safe else None
