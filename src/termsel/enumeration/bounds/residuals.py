"""The compiled branch and bound for residual sums of squares.

A node has columns A, of which those of I are in use for good: its subsets S hold I and are within
A. Columns are dropped one by one, with the triangular factor of A brought up to date by rotations.
The residuals of S are not below those of A (Furnival and Wilson 1974, Technometrics 16(4)), nor
below the bound of `bounds.poles`, so that sizes of which a better subset is known are left out.
Columns are dropped in order of what that costs, the dearest first; for each later one those before
it join I (preordering: Gatu and Kontoghiorghes 2006, Journal of Computational and Graphical
Statistics 15(1)). A column that no open size can do without thus joins I at once.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from termsel.adjustment.compiled import compiled
from termsel.enumeration.bounds.poles import node_bound, order_columns
from termsel.enumeration.bounds.trees import ROUNDING, Tree, eliminate, square, write
from termsel.enumeration.columns.arrays import Limits, Place, Records, Vectors
from termsel.enumeration.columns.kernels import RSS, walk
from termsel.measurements.features import IntArray

_compiled = partial(compiled, fastmath={"reassoc", "contract", "arcp", "nsz"})


@_compiled
def branch_residuals(tree: Tree, limits: Limits, records: Records, counts: IntArray, few: int,
                     single: bool | None) -> int:
    """Decide all subsets of the columns at depth 0 that hold those in use there.

    The room of the limits is that of depth 0, without an offset; records have bits and guard of all
    columns; counts are as of `Place`, `single` is as for `columns.kernels.walk`. Nodes of at most
    `few` subsets are enumerated. Return the number of subsets that no bound ruled out.
    """
    most, best, depth = limits.size + limits.room, records.best, 0
    enumerated = 0
    entering = True
    while depth >= 0:
        n, p = tree.count[depth], tree.used[depth]
        if entering:
            entering = False
            largest = min(most, n)
            limit = 0.0
            for size in range(p, largest + 1):
                limit = max(limit, best[size])
            bound = node_bound(tree, depth, limit * (1.0 + ROUNDING) + limits.slack)
            if not bound < np.inf:  # columns in use depend on each other
                enumerated += counts[n - p, min(most - p, n - p)]
                depth -= 1
                continue
            # Larger subsets have lower residuals: the largest sizes are the first to be closed.
            bound = bound * (1.0 - ROUNDING) - limits.slack
            while largest >= p and bound > best[largest]:
                largest -= 1
            if largest < p:
                depth -= 1
                continue
            if counts[n - p, largest - p] <= few:
                _enumerate(tree, depth, n, largest - p, False, limits, records, counts, single)
                enumerated += counts[n - p, largest - p]
                depth -= 1
                continue
            if largest == n:  # A itself; its proper subsets are below the children
                _enumerate(tree, depth, n, 0, True, limits, records, counts, single)
                enumerated += 1
            order_columns(tree, depth, bound)
            # The largest score of interest of all sizes that the subsets of a child may have.
            limit = 0.0
            for size in range(min(largest, n - 1), p - 1, -1):
                limit = max(limit, best[size])
                tree.ceiling[depth, size] = limit
            tree.child[depth], tree.largest[depth] = 0, min(largest, n - 1)
        # Child i drops column i of the order, with the i columns before it in use for good.
        i = tree.child[depth]
        while (i < n - p and p + i <= tree.largest[depth]
               and tree.bound[depth, i] > tree.ceiling[depth, p + i]):
            i += 1
        if i >= n - p or p + i > tree.largest[depth]:
            depth -= 1
            continue
        tree.child[depth] = i + 1
        _drop(tree, depth, i)
        depth += 1
        entering = True
    return enumerated


@_compiled
def _drop(tree: Tree, d: int, place: int) -> None:
    """Drop a column, those before it in the order joining the columns in use, to the next depth."""
    n, x, e, r = tree.count[d], tree.order[d, place], d + 1, tree.target.shape[1]
    # Rows above x keep their entries; column x leaves, and those after it move up.
    R, q, row = tree.triangle, tree.target, tree.b
    for i in range(n):
        if i != x:
            to = i - (i > x)
            tree.column[e, to], tree.fixed[e, to] = tree.column[d, i], tree.fixed[d, i]
            if i < x:
                for t in range(i, n):
                    if t != x:
                        R[e, i, t - (t > x)] = R[d, i, t]
                for j in range(r):
                    q[e, j, i] = q[d, j, i]
    for before in range(place):
        i = tree.order[d, before]
        tree.fixed[e, i - (i > x)] = True
    # Row x, without its diagonal, is rotated with each row below it in turn (Givens).
    # Loops, as code that copies slices is compiled with a message about shapes, which takes 2 s.
    for t in range(x + 1, n):
        row[t] = R[d, x, t]
    for j in range(r):
        tree.last[j] = q[d, j, x]
    for i in range(x + 1, n):
        length = np.sqrt(row[i] * row[i] + R[d, i, i] * R[d, i, i])
        cosine = row[i] / length if length > 0.0 else 1.0
        sine = R[d, i, i] / length if length > 0.0 else 0.0
        for t in range(i, n):
            ours, theirs = row[t], R[d, i, t]
            R[e, i - 1, t - 1] = cosine * ours + sine * theirs
            row[t] = cosine * theirs - sine * ours
        for j in range(r):
            ours, theirs = tree.last[j], q[d, j, i]
            q[e, j, i - 1] = cosine * ours + sine * theirs
            tree.last[j] = cosine * theirs - sine * ours
    # What is left of Q'y in the row that became zero are residuals now.
    tree.rss[e] = tree.rss[d]
    for j in range(r):
        tree.rss[e] += tree.last[j] * tree.last[j]
    tree.count[e], tree.used[e] = n - 1, tree.used[d] + place
    # -1, of dependent columns, gives none.
    m = 0
    for a in range(tree.weights[d]):
        if tree.weight[d, a] > 0.0:
            tree.point[e, m], tree.weight[e, m] = tree.point[d, a], tree.weight[d, a]
            m += 1
    tree.weights[e] = m


@_compiled
def _enumerate(tree: Tree, d: int, n: int, room: int, all_in_use: bool, limits: Limits,
               records: Records, counts: IntArray, single: bool | None) -> None:
    """Decide all subsets of a node one by one."""
    r, g, work, below = tree.target.shape[1], records.guard.shape[1], tree.work, tree.eliminated
    p = n if all_in_use else tree.used[d]
    count, depths = n - p, max(room, 1)
    bits, used = np.zeros(count + 1, dtype=np.uint64), np.uint64(0)
    # Columns in use come first and are taken out of the others, and their guard with them.
    write(tree, d, all_in_use)
    for i in range(n):
        column = tree.column[d, tree.cursor[i]]
        for k in range(g):
            below[i, k] = records.guard[column, k]
        if i < p:
            used |= records.bits[column]
        else:
            bits[i - p] = records.bits[column]
    for k in range(g):
        below[n, k] = records.guard[len(records.guard) - 1, k]
    for i in range(p):
        length = square(work, i, n)
        if length <= tree.floors[0, 0]:
            return  # no subset has a score
        eliminate(work, i, n + r, n, length)
        for j in range(i + 1, n + 1):
            for k in range(g):
                below[j, k] -= work[j, n] * below[i, k]
    top = np.empty((depths, 1, count + r, n))
    for c in range(count + r):
        for t in range(n):
            top[0, 0, c, t] = work[p + c, t]
    squares, share = np.full((depths, 1, count + 1), np.inf), np.zeros((depths, 1, count + 1, r))
    for c in range(count):
        squares[0, 0, c] = square(work, p + c, n)
        for j in range(r):
            product = 0.0
            for t in range(n):
                product += work[p + c, t] * work[n + j, t]
            share[0, 0, c, j] = product / squares[0, 0, c] if squares[0, 0, c] > 0.0 else 0.0
    empty = np.empty((depths, 0))
    # What is left is walked as any other piece.
    vectors = Vectors(top, np.empty((depths, 1, count + r, 0)), squares, share,
                      tree.floors[:, :count + 1].copy(), empty, empty)
    inside = Records(records.best, records.masks, bits, records.some_of, records.parents,
                     below[p:n + 1].copy(), records.x, records.sums)
    within = Limits(limits.margin, limits.tolerance, tree.rss[d], limits.slack, p, room)
    tree.mask[0] = used
    place = Place(tree.cursor, tree.cursor, tree.mask, counts)
    walk(RSS, vectors, within, inside, place, single, None)
