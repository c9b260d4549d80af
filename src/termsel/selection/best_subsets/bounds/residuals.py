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

from termsel.adjustment.compiled import compile_lazily
from termsel.data.features import IntArray
from termsel.selection.best_subsets.bounds.poles import node_bound, order_columns
from termsel.selection.best_subsets.bounds.trees import (
    BOUND_ROUNDING,
    Tree,
    eliminate,
    squared_length,
    write,
)
from termsel.selection.best_subsets.columns.arrays import Limits, Records, Vectors, WalkPosition
from termsel.selection.best_subsets.columns.kernels import RSS, enumerate_subsets

_compiled = partial(compile_lazily, fastmath={"reassoc", "contract", "arcp", "nsz"})


@_compiled
def branch_residuals(tree: Tree, limits: Limits, records: Records, counts: IntArray,
                     enumerated_up_to: int, single: bool | None) -> int:
    """Decide all subsets of the columns at depth 0 that hold those in use there.

    The room of the limits is that of depth 0, without an offset; records have bits and guard of all
    columns; counts are as of `WalkPosition`, `single` is as for
    `columns.kernels.enumerate_subsets`. Nodes of at most `enumerated_up_to` subsets are enumerated.
    The best subsets are in `records` then. Return the number of subsets that no bound ruled out;
    those of a node whose columns depend on each other, which have no score, are among them.
    """
    max_size = limits.size + limits.room
    best = records.best
    depth = 0
    enumerated = 0
    entering = True
    while depth >= 0:
        n = tree.count[depth]
        p = tree.used[depth]
        if entering:
            entering = False
            largest = min(max_size, n)
            # Above the best of every size that is still possible the node is closed.
            limit = 0.0
            for size in range(p, largest + 1):
                limit = max(limit, best[size])
            bound = node_bound(tree, depth, limit * (1.0 + BOUND_ROUNDING) + limits.slack)
            if not bound < np.inf:  # columns in use depend on each other
                enumerated += counts[n - p, min(max_size - p, n - p)]
                depth -= 1
                continue
            # Larger subsets have lower residuals: the largest sizes are the first to be closed.
            bound = bound * (1.0 - BOUND_ROUNDING) - limits.slack
            while largest >= p and bound > best[largest]:
                largest -= 1
            if largest < p:
                depth -= 1
                continue
            if counts[n - p, largest - p] <= enumerated_up_to:
                _enumerate_node(tree, depth, n, room=largest - p, all_in_use=False, limits=limits,
                                records=records, counts=counts, single=single)
                enumerated += counts[n - p, largest - p]
                depth -= 1
                continue
            if largest == n:  # A itself; its proper subsets are below the children
                _enumerate_node(tree, depth, n, room=0, all_in_use=True, limits=limits,
                                records=records,
                                counts=counts, single=single)
                enumerated += 1
            order_columns(tree, depth, bound)
            # The largest score of interest of all sizes that the subsets of a child may have.
            limit = 0.0
            for size in range(min(largest, n - 1), p - 1, -1):
                limit = max(limit, best[size])
                tree.ceiling[depth, size] = limit
            tree.child[depth] = 0
            tree.largest[depth] = min(largest, n - 1)
        # Child i drops column i of the order, with the i columns before it in use for good.
        i = tree.child[depth]
        while (i < n - p and p + i <= tree.largest[depth]
               and tree.bound[depth, i] > tree.ceiling[depth, p + i]):
            i += 1
        if i >= n - p or p + i > tree.largest[depth]:
            depth -= 1
            continue
        tree.child[depth] = i + 1
        _drop_column(tree, depth, i)
        depth += 1
        entering = True
    return enumerated


@_compiled
def _drop_column(tree: Tree, d: int, position: int) -> None:
    """Write to depth d + 1 the child of a node without a column, by its position in the order.

    The columns before it in the order are fixed in the child: its subsets all have them. Taking a
    column out of R leaves one entry below the diagonal in each later column; Givens rotations of
    two rows bring it to zero, and Q'y with it. What ends in the row that became zero adds to the
    residual sum of squares.
    """
    n = tree.count[d]
    x = tree.order[d, position]
    child = d + 1
    r = tree.target.shape[1]
    # Rows above x keep their entries; column x leaves, and those after it move up.
    R = tree.triangle
    q = tree.target
    row = tree.b
    for i in range(n):
        if i != x:
            moved = i - (i > x)
            tree.column[child, moved] = tree.column[d, i]
            tree.fixed[child, moved] = tree.fixed[d, i]
            if i < x:
                for t in range(i, n):
                    if t != x:
                        R[child, i, t - (t > x)] = R[d, i, t]
                for j in range(r):
                    q[child, j, i] = q[d, j, i]
    for before in range(position):
        i = tree.order[d, before]
        tree.fixed[child, i - (i > x)] = True
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
            ours = row[t]
            theirs = R[d, i, t]
            R[child, i - 1, t - 1] = cosine * ours + sine * theirs
            row[t] = cosine * theirs - sine * ours
        for j in range(r):
            ours = tree.last[j]
            theirs = q[d, j, i]
            q[child, j, i - 1] = cosine * ours + sine * theirs
            tree.last[j] = cosine * theirs - sine * ours
    # What remains of Q'y in the row that became zero are residuals now.
    tree.rss[child] = tree.rss[d]
    for j in range(r):
        tree.rss[child] += tree.last[j] * tree.last[j]
    tree.count[child] = n - 1
    tree.used[child] = tree.used[d] + position
    # Guard points whose weight is 0 bound nothing; the child begins with the others.
    # -1, of dependent columns, gives none.
    m = 0
    for a in range(tree.weights[d]):
        if tree.weight[d, a] > 0.0:
            tree.point[child, m] = tree.point[d, a]
            tree.weight[child, m] = tree.weight[d, a]
            m += 1
    tree.weights[child] = m


@_compiled
def _enumerate_node(tree: Tree, d: int, n: int, room: int, all_in_use: bool, limits: Limits,
                    records: Records, counts: IntArray, single: bool | None) -> None:
    """Decide all subsets of a node one by one.

    The node is that at depth `d` of the tree, of `n` columns. Up to `room` columns are added to
    those in use; with `all_in_use` the n columns are the only subset. `counts` and `single` are as
    for `branch_residuals`. The best subsets are in `records` then; columns in use that depend on
    each other leave it as it is.
    """
    r = tree.target.shape[1]
    g = records.guard.shape[1]
    work = tree.work
    denominators = tree.eliminated
    p = n if all_in_use else tree.used[d]
    count = n - p
    depths = max(room, 1)
    bits = np.zeros(count + 1, dtype=np.uint64)
    used_mask = np.uint64(0)
    # Columns in use come first and are taken out of the others, and their guard with them.
    write(tree, d, all_in_use)
    for i in range(n):
        column = tree.column[d, tree.cursor[i]]
        for k in range(g):
            denominators[i, k] = records.guard[column, k]
        if i < p:
            used_mask |= records.bits[column]
        else:
            bits[i - p] = records.bits[column]
    for k in range(g):
        denominators[n, k] = records.guard[len(records.guard) - 1, k]
    # Columns in use one by one, by modified Gram-Schmidt; the denominators by the same shares.
    for i in range(p):
        length = squared_length(work, i, n)
        if length <= tree.floors[0, 0]:
            return  # no subset has a score
        eliminate(work, i, n + r, n, length)
        for j in range(i + 1, n + 1):
            for k in range(g):
                denominators[j, k] -= work[j, n] * denominators[i, k]
    # Column p + c of the eliminated rows is column c of the walk; targets follow.
    top = np.empty((depths, 1, count + r, n))
    for c in range(count + r):
        for t in range(n):
            top[0, 0, c, t] = work[p + c, t]
    squares = np.full((depths, 1, count + 1), np.inf)
    share = np.zeros((depths, 1, count + 1, r))
    for c in range(count):
        squares[0, 0, c] = squared_length(work, p + c, n)
        for j in range(r):
            product = 0.0
            for t in range(n):
                product += work[p + c, t] * work[n + j, t]
            share[0, 0, c, j] = product / squares[0, 0, c] if squares[0, 0, c] > 0.0 else 0.0
    empty = np.empty((depths, 0))
    # The columns not in use are walked as those of any other node.
    vectors = Vectors(top=top, extra=np.empty((depths, 1, count + r, 0)), square=squares,
                      share=share, floor=tree.floors[:, :count + 1].copy(), leverage=empty,
                      cross=empty)
    remaining_records = Records(best=records.best, masks=records.masks, bits=bits,
                                some_of=records.some_of, parents=records.parents,
                                guard=denominators[p:n + 1].copy(), x=records.x, sums=records.sums)
    remaining_limits = Limits(limits.margin, limits.tolerance, tree.rss[d], limits.slack, p, room)
    tree.mask[0] = used_mask
    position = WalkPosition(tree.cursor, tree.cursor, tree.mask, counts)
    enumerate_subsets(RSS, vectors, remaining_limits, records=remaining_records, position=position,
                      single=single, press=None)
