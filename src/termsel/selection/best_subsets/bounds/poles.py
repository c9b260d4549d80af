"""A lower bound of the residuals of many subsets, by what guard points ask of coefficients.

A node has columns A; its subsets are within A. Let T be the columns, y the target, and G b >= h
what the guard points ask of coefficients b: denominators above the margin. A feasible subset has
b, zero outside A, that meets it. For all weights u >= 0

    |y - T b|^2 >= |y - T b|^2 - 2 u'(G b - h) >= minimum of the right side over all b in A,

which is a bound of the subset (weak duality). With the factor R of T, q = Q'y and W = R^-T G' that
minimum is RSS(A) + 2 u'(h - W'q) - |W u|^2, attained at R b = q + W u. Weights are raised one by
one, for guard points that this b violates. With weights fixed, dropping column j raises the minimum
by b_j^2 / (row j of R^-1)^2.

With several targets there are no poles, and sums of squares add up. Where columns of A depend on
each other, the weights are left at zero. That guard points take part is termsel's own
formulation.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from termsel.adjustment.compiled import compile_lazily
from termsel.selection.best_subsets.bounds.trees import (
    BOUND_ROUNDING,
    DEPENDENT,
    Tree,
    eliminate,
    squared_length,
    write,
)

_compiled = partial(compile_lazily, fastmath={"reassoc", "contract", "arcp", "nsz"})

_GUARD_ROUNDS = 3  # of guard points added at a node, at most
_SWEEPS = 4  # over the weights after each
_BOUND_GAIN = 0.02  # a round that raises the bound by less than this share of the limit is the last


@_compiled
def node_bound(tree: Tree, d: int, limit: float) -> float:
    """Return a lower bound of the residual sums of squares of the subsets of a node at depth `d`.

    It is infinite where no subset has a score. The weights u of the guard points are raised until
    the bound is above the limit, hardly rises any more, or was raised `_GUARD_ROUNDS` times. They
    stay in `tree.weight`; `tree.shifted` becomes q + W u. If they help nothing, none is left, and
    u is 0. Where columns depend on each other `tree.weights[d]` becomes -1, and there are neither
    weights nor `tree.shifted`.
    """
    n = tree.count[d]
    m = tree.weights[d]
    R = tree.triangle
    guard = tree.guard
    q = tree.target
    W = tree.W
    weight = tree.weight
    # W and R^-1 have no digits left where columns depend on each other.
    for i in range(n):
        if not abs(R[d, i, i]) > DEPENDENT:
            tree.weights[d] = -1
            return float(_residuals_if_dependent(tree, d))
    # A child begins with its parent's weights u: shifted = q + sum of u_a w_a.
    for i in range(n):
        tree.shifted[i] = q[d, 0, i]
    for a in range(m):
        _solve_guard(tree, d, a, n)
        for i in range(n):
            tree.shifted[i] += weight[d, a] * W[a, i]
    bound = tree.rss[d]
    before = 0.0
    for step in range(_GUARD_ROUNDS):
        for _ in range(_SWEEPS):
            gained = 0.0
            for a in range(m):
                # Derivative of the bound by this weight, halved: h - G b.
                slope = tree.required[tree.point[d, a]]
                for i in range(n):
                    slope -= W[a, i] * tree.shifted[i]
                # The bound is quadratic in the weight, highest there; no weight is negative.
                change = max(slope / tree.square[a], -weight[d, a])
                weight[d, a] += change
                gained = max(gained, change * change * tree.square[a])
                for i in range(n):
                    tree.shifted[i] += change * W[a, i]
            if gained < 1e-3 * limit:
                break
        # RSS + 2 u'(h - W'q) - |W u|^2
        bound = tree.rss[d]
        for a in range(m):
            slope = tree.required[tree.point[d, a]]
            for i in range(n):
                slope -= W[a, i] * q[d, 0, i]
            bound += 2.0 * weight[d, a] * slope
        for i in range(n):
            shift = tree.shifted[i] - q[d, 0, i]
            bound -= shift * shift
        if (bound > limit or step == _GUARD_ROUNDS - 1 or len(tree.required) == 0
                or (step > 0 and bound < before + _BOUND_GAIN * limit)):
            break
        before = bound
        # The guard point that the minimum violates most is next to get a weight.
        _solve_coefficients(tree, d, n)
        for g in range(len(tree.required)):
            tree.below[g] = -tree.required[g]
        for i in range(n):
            for g in range(len(tree.required)):
                tree.below[g] += tree.b[i] * guard[tree.column[d, i], g]
        for a in range(m):
            tree.below[tree.point[d, a]] = 0.0  # has one already
        worst = 0
        for g in range(len(tree.required)):
            if tree.below[g] < tree.below[worst]:
                worst = g
        if not tree.below[worst] < 0.0:
            break
        slot = m
        for a in range(m):
            if weight[d, a] == 0.0:  # a point that has lost its weight gives way
                slot = a
        if slot == len(tree.square):
            break
        m = max(m, slot + 1)
        tree.point[d, slot] = worst
        weight[d, slot] = 0.0
        _solve_guard(tree, d, slot, n)
    if bound < tree.rss[d]:  # the parent's weights are too high; `_order` needs those of the bound
        bound = tree.rss[d]
        m = 0
        for i in range(n):
            tree.shifted[i] = q[d, 0, i]
    tree.weights[d] = m
    return float(bound)


@_compiled
def _solve_guard(tree: Tree, d: int, a: int, n: int) -> None:
    """Write row a of `tree.W`, which is column a of W = R^-T G', and its squared length.

    R is the triangle (n, n) of the columns at depth `d`, and row a of G their values at a guard
    point.
    """
    # Forward substitution in R' w = g.
    total = 0.0
    for i in range(n):
        value = tree.guard[tree.column[d, i], tree.point[d, a]]
        for t in range(i):
            value -= tree.triangle[d, t, i] * tree.W[a, t]
        # The diagonal is not 0 here: `node_bound` has looked.
        value /= tree.triangle[d, i, i]
        tree.W[a, i] = value
        total += value * value
    tree.square[a] = max(total, 1e-300)


@_compiled
def _solve_coefficients(tree: Tree, d: int, n: int) -> None:
    """Solve R b = q + W u for b, which is written to `tree.b`; R (n, n) is that of depth `d`."""
    # Back substitution, from the last row up.
    for i in range(n - 1, -1, -1):
        value = tree.shifted[i]
        for t in range(i + 1, n):
            value -= tree.triangle[d, i, t] * tree.b[t]
        tree.b[i] = value / tree.triangle[d, i, i]


@_compiled
def _residuals_if_dependent(tree: Tree, d: int) -> float:
    """Return the residual sum of squares of columns that depend on each other.

    It is infinite if those in use do, as no subset of the node has a score then.
    """
    # Modified Gram-Schmidt: a column that depends on those before it takes nothing off the target.
    n = tree.count[d]
    r = tree.target.shape[1]
    work = tree.work
    write(tree, d, False)
    for i in range(n):
        length = squared_length(work, i, n)
        if i < tree.used[d] and length <= tree.floors[0, 0]:
            return np.inf
        if length > 0.0:
            eliminate(work, i, n + r, n, length)
    total = float(tree.rss[d])
    for j in range(r):
        total += squared_length(work, n + j, n)
    return total


@_compiled
def order_columns(tree: Tree, d: int, bound: float) -> None:
    """Sort the columns not in use by the bound without each, the highest first.

    They are written to `tree.order` at depth `d`, and their bounds to `tree.bound`. Columns whose
    removal costs most are dropped first, so that the subtrees that follow are cut early. Without
    column i the residuals grow by b_i^2 over the squared length of row i of R^-1. `bound` is that
    of the node at depth `d`; with dependent columns it is all that is known of each.
    """
    n = tree.count[d]
    r = tree.target.shape[1]
    inverse = tree.inverse
    count = 0
    independent = tree.weights[d] >= 0
    if independent:
        # R^-1 from the last row up.
        for i in range(n - 1, -1, -1):
            for t in range(i, n):
                inverse[i, t] = 0.0
            for s in range(i + 1, n):
                ratio = tree.triangle[d, i, s] / tree.triangle[d, i, i]
                for t in range(s, n):
                    inverse[i, t] -= ratio * inverse[s, t]
            inverse[i, i] = 1.0 / tree.triangle[d, i, i]
    for i in range(n):
        if tree.fixed[d, i]:
            continue
        value = bound
        if independent:
            # Dropping column i costs b_i^2 over the squared length of its row of R^-1.
            length = gain = 0.0
            for t in range(i, n):
                length += inverse[i, t] * inverse[i, t]
            for j in range(r):
                b = 0.0
                for t in range(i, n):
                    b += inverse[i, t] * (tree.shifted[t] if j == 0 else tree.target[d, j, t])
                gain += b * b
            value += gain / length * (1.0 - BOUND_ROUNDING)
        x = count  # insertion into the sorted columns
        while x > 0 and tree.bound[d, x - 1] < value:
            tree.bound[d, x] = tree.bound[d, x - 1]
            tree.order[d, x] = tree.order[d, x - 1]
            x -= 1
        tree.bound[d, x] = value
        tree.order[d, x] = i
        count += 1
