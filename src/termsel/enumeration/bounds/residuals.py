"""The compiled branch and bound for residual sums of squares.

A node has columns A, of which those of I are in use for good: its subsets S hold I and are within
A. Columns are dropped one by one, with the triangular factor of A brought up to date by rotations.
The residuals of S are not below those of A (Furnival and Wilson 1974, Technometrics 16(4)), so that
sizes of which a better subset is known are left out. Columns are dropped in order of what that
costs, the dearest first; for each later one those before it join I (preordering: Gatu and
Kontoghiorghes 2006, Journal of Computational and Graphical Statistics 15(1)). A column that no open
size can do without thus joins I at once.

Poles. Let T be the columns, y the target, and G b >= h what the guard points ask of coefficients b:
denominators above the margin. A subset that is feasible has b, zero outside A, that meets it.
For all weights u >= 0

    |y - T b|^2 >= |y - T b|^2 - 2 u'(G b - h) >= minimum of the right side over all b in A,

which is a bound of S (weak duality). With the factor R of T, q = Q'y and W = R^-T G' that minimum
is RSS(A) + 2 u'(h - W'q) - |W u|^2, attained at R b = q + W u. Weights are raised one by one, for
guard points that this b violates. With weights fixed, dropping column j raises the minimum by
b_j^2 / (row j of R^-1)^2.

With several targets there are no poles, and sums of squares add up. Where columns of A depend on
each other, the weights are left at zero. That guard points take part is termsel's own
formulation.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from termsel.adjustment.compiled import compiled
from termsel.enumeration.bounds.trees import DEPENDENT, ROUNDING, Tree
from termsel.enumeration.columns.arrays import Levels, Limits, Records
from termsel.enumeration.columns.kernels import RSS, walk
from termsel.measurements.features import FloatArray, IntArray

_compiled = partial(compiled, fastmath={"reassoc", "contract", "arcp", "nsz"})

_ROUNDS = 3  # of them added at a node, at most
_SWEEPS = 4  # over the weights after each
_GAIN = 0.02  # a round that raises the bound by less than this share of the limit is the last


@_compiled
def branch_residuals(tree: Tree, limits: Limits, records: Records, counts: IntArray, few: int,
                     single: bool | None) -> tuple[int, int]:
    """Decide all subsets of the columns at depth 0 that hold those in use there.

    Parameters
    ----------
    tree : Tree
    limits : Limits
        Its room is that of depth 0; no offset.
    records : Records
        Bits and guard of all columns; its other arrays as for `subset_kernels.walk`.
    counts, single
        As for `subset_kernels.walk`.
    few : int
        Subsets that are enumerated at once.

    Returns
    -------
    infeasible, enumerated : int
        Number of subsets that were found to have no score, and of those not ruled out by a bound.
    """
    most, best, depth = limits.size + limits.room, records.best, 0
    infeasible = enumerated = 0
    state, entering = tree.state, True
    while depth >= 0:
        n, p = state[depth, 0], state[depth, 1]
        if entering:
            entering = False
            largest = min(most, n)
            limit = 0.0
            for size in range(p, largest + 1):
                limit = max(limit, best[size])
            bound = node_bound(tree, depth, limit * (1.0 + ROUNDING) + limits.slack)
            if not bound < np.inf:  # columns in use depend on each other
                lost = counts[n - p, min(most - p, n - p)]
                infeasible, enumerated = infeasible + lost, enumerated + lost
                depth -= 1
                continue
            bound = bound * (1.0 - ROUNDING) - limits.slack
            while largest >= p and bound > best[largest]:
                largest -= 1
            if largest < p:
                depth -= 1
                continue
            if counts[n - p, largest - p] <= few:
                infeasible += _enumerate(tree, depth, n, largest - p, False, limits, records,
                                         counts, single)
                enumerated += counts[n - p, largest - p]
                depth -= 1
                continue
            if largest == n:
                infeasible += _enumerate(tree, depth, n, 0, True, limits, records, counts, single)
                enumerated += 1
            _order(tree, depth, bound)
            # The largest score of interest of all sizes that the subsets of a child may have.
            limit = 0.0
            for size in range(min(largest, n - 1), p - 1, -1):
                limit = max(limit, best[size])
                tree.ceiling[depth, size] = limit
            state[depth, 2], state[depth, 3] = 0, min(largest, n - 1)
        i = state[depth, 2]
        while (i < n - p and p + i <= state[depth, 3]
               and tree.bound[depth, i] > tree.ceiling[depth, p + i]):
            i += 1
        if i >= n - p or p + i > state[depth, 3]:
            depth -= 1
            continue
        state[depth, 2] = i + 1
        _drop(tree, depth, i)
        depth += 1
        entering = True
    return infeasible, enumerated


@_compiled
def node_bound(tree: Tree, d: int, limit: float) -> float:
    """Return a lower bound of the residuals of the subsets of a node; infinite if none has any.

    Weights are raised until it is above the limit, and stay in `tree.weight`. `tree.shifted` is
    q + W u.
    """
    n, m = tree.state[d, 0], tree.state[d, 4]
    R, guard, q, W, weight = tree.triangle, tree.guard, tree.target, tree.W, tree.weight
    for i in range(n):
        if not abs(R[d, i, i]) > DEPENDENT:
            tree.state[d, 4] = -1
            return float(_dependent(tree, d))
    tree.shifted[:n] = q[d, 0, :n]
    for a in range(m):
        _solve_guard(tree, d, a, n)
        for i in range(n):
            tree.shifted[i] += weight[d, a] * W[a, i]
    bound, before = tree.rss[d], 0.0
    for step in range(_ROUNDS):
        for _ in range(_SWEEPS):
            gained = 0.0
            for a in range(m):
                # Derivative of the bound by this weight, halved: h - G b.
                slope = tree.least[tree.point[d, a]]
                for i in range(n):
                    slope -= W[a, i] * tree.shifted[i]
                change = max(slope / tree.square[a], -weight[d, a])
                weight[d, a] += change
                gained = max(gained, change * change * tree.square[a])
                for i in range(n):
                    tree.shifted[i] += change * W[a, i]
            if gained < 1e-3 * limit:
                break
        bound = tree.rss[d]
        for a in range(m):
            slope = tree.least[tree.point[d, a]]
            for i in range(n):
                slope -= W[a, i] * q[d, 0, i]
            bound += 2.0 * weight[d, a] * slope
        for i in range(n):
            shift = tree.shifted[i] - q[d, 0, i]
            bound -= shift * shift
        if (bound > limit or step == _ROUNDS - 1 or len(tree.least) == 0
                or (step > 0 and bound < before + _GAIN * limit)):
            break
        before = bound
        _coefficients(tree, d, n)
        for g in range(len(tree.least)):
            tree.below[g] = -tree.least[g]
        for i in range(n):
            for g in range(len(tree.least)):
                tree.below[g] += tree.b[i] * guard[tree.column[d, i], g]
        for a in range(m):
            tree.below[tree.point[d, a]] = 0.0
        worst = 0
        for g in range(len(tree.least)):
            if tree.below[g] < tree.below[worst]:
                worst = g
        if not tree.below[worst] < 0.0:
            break
        slot = m
        for a in range(m):
            if weight[d, a] == 0.0:
                slot = a
        if slot == len(tree.square):
            break
        m = max(m, slot + 1)
        tree.point[d, slot], weight[d, slot] = worst, 0.0
        _solve_guard(tree, d, slot, n)
    if bound < tree.rss[d]:  # the parent's weights are too high; `_order` needs those of the bound
        bound, m = tree.rss[d], 0
        tree.shifted[:n] = q[d, 0, :n]
    tree.state[d, 4] = m
    return float(bound)


@_compiled
def _solve_guard(tree: Tree, d: int, a: int, n: int) -> None:
    """Write a column of W = R^-T G', and its square."""
    total = 0.0
    for i in range(n):
        value = tree.guard[tree.column[d, i], tree.point[d, a]]
        for t in range(i):
            value -= tree.triangle[d, t, i] * tree.W[a, t]
        value /= tree.triangle[d, i, i]
        tree.W[a, i] = value
        total += value * value
    tree.square[a] = max(total, 1e-300)


@_compiled
def _coefficients(tree: Tree, d: int, n: int) -> None:
    """Solve R b = q + W u."""
    for i in range(n - 1, -1, -1):
        value = tree.shifted[i]
        for t in range(i + 1, n):
            value -= tree.triangle[d, i, t] * tree.b[t]
        tree.b[i] = value / tree.triangle[d, i, i]


@_compiled
def _write(tree: Tree, d: int, all_in_use: bool) -> None:
    """Write the columns to `tree.work`, those in use first, then targets; order in `cursor`."""
    n, place = tree.state[d, 0], 0
    for fixed in (True, False):
        for i in range(n):
            if (all_in_use or tree.fixed[d, i]) == fixed:
                for t in range(n):
                    tree.work[place, t] = tree.triangle[d, t, i] if t <= i else 0.0
                tree.cursor[place] = i
                place += 1
    for j in range(tree.target.shape[1]):
        tree.work[n + j, :n] = tree.target[d, j, :n]


@_compiled
def _eliminate(work: FloatArray, i: int, stop: int, n: int, square: float) -> None:
    """Remove row i from the rows below it, and write its share of each to column n there."""
    for j in range(i + 1, stop):
        ratio = 0.0
        for t in range(n):
            ratio += work[i, t] * work[j, t]
        ratio /= square
        for t in range(n):
            work[j, t] -= ratio * work[i, t]
        work[j, n] = ratio


@_compiled
def _square(work: FloatArray, i: int, n: int) -> float:
    total = 0.0
    for t in range(n):
        total += work[i, t] * work[i, t]
    return total


@_compiled
def _dependent(tree: Tree, d: int) -> float:
    """Return the residuals of dependent columns; infinity if those in use are dependent.

    Modified Gram-Schmidt; no other column is too small to count.
    """
    n, r, work = tree.state[d, 0], tree.target.shape[1], tree.work
    _write(tree, d, False)
    for i in range(n):
        square = _square(work, i, n)
        if i < tree.state[d, 1] and square <= tree.floor[0]:
            return np.inf
        if square > 0.0:
            _eliminate(work, i, n + r, n, square)
    total = float(tree.rss[d])
    for j in range(r):
        total += _square(work, n + j, n)
    return total


@_compiled
def _order(tree: Tree, d: int, bound: float) -> None:
    """Sort the columns not in use by the bound without each, the highest first."""
    n, r, inverse = tree.state[d, 0], tree.target.shape[1], tree.inverse
    count, independent = 0, tree.state[d, 4] >= 0
    if independent:
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
            length = gain = 0.0
            for t in range(i, n):
                length += inverse[i, t] * inverse[i, t]
            for j in range(r):
                b = 0.0
                for t in range(i, n):
                    b += inverse[i, t] * (tree.shifted[t] if j == 0 else tree.target[d, j, t])
                gain += b * b
            value += gain / length * (1.0 - ROUNDING)
        x = count
        while x > 0 and tree.bound[d, x - 1] < value:
            tree.bound[d, x], tree.order[d, x] = tree.bound[d, x - 1], tree.order[d, x - 1]
            x -= 1
        tree.bound[d, x], tree.order[d, x] = value, i
        count += 1


@_compiled
def _drop(tree: Tree, d: int, place: int) -> None:
    """Drop a column, those before it in the order joining the columns in use, to the next depth."""
    n, x, e, r = tree.state[d, 0], tree.order[d, place], d + 1, tree.target.shape[1]
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
    # Row x is rotated with each row below it in turn.
    row[x + 1:n] = R[d, x, x + 1:n]
    tree.last[:] = q[d, :, x]
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
    tree.rss[e] = tree.rss[d]
    for j in range(r):
        tree.rss[e] += tree.last[j] * tree.last[j]
    tree.state[e, 0], tree.state[e, 1] = n - 1, tree.state[d, 1] + place
    m = 0
    for a in range(tree.state[d, 4]):
        if tree.weight[d, a] > 0.0:
            tree.point[e, m], tree.weight[e, m] = tree.point[d, a], tree.weight[d, a]
            m += 1
    tree.state[e, 4] = m


@_compiled
def _enumerate(tree: Tree, d: int, n: int, room: int, all_in_use: bool, limits: Limits,
               records: Records, counts: IntArray, single: bool | None) -> int:
    """Decide all subsets of a node one by one; return how many have no score."""
    r, g, work, below = tree.target.shape[1], records.guard.shape[1], tree.work, tree.eliminated
    p = n if all_in_use else tree.state[d, 1]
    count, depths = n - p, max(room, 1)
    bits, used = np.zeros(count + 1, dtype=np.uint64), np.uint64(0)
    _write(tree, d, all_in_use)
    for i in range(n):
        column = tree.column[d, tree.cursor[i]]
        below[i] = records.guard[column]
        if i < p:
            used |= records.bits[column]
        else:
            bits[i - p] = records.bits[column]
    below[n] = records.guard[len(records.guard) - 1]
    for i in range(p):
        square = _square(work, i, n)
        if square <= tree.floor[0]:
            return int(counts[count, room])
        _eliminate(work, i, n + r, n, square)
        for j in range(i + 1, n + 1):
            for k in range(g):
                below[j, k] -= work[j, n] * below[i, k]
    top = np.empty((depths, 1, count + r, n))
    top[0, 0] = work[p:n + r, :n]
    squares, share = np.full((depths, 1, count + 1), np.inf), np.zeros((depths, 1, count + 1, r))
    for c in range(count):
        squares[0, 0, c] = _square(work, p + c, n)
        for j in range(r):
            product = 0.0
            for t in range(n):
                product += work[p + c, t] * work[n + j, t]
            share[0, 0, c, j] = product / squares[0, 0, c] if squares[0, 0, c] > 0.0 else 0.0
    empty = np.empty((depths, 0))
    levels = Levels(top, np.empty((depths, 1, count + r, 0)), squares, share,
                    tree.floors[:, :count + 1].copy(), empty, empty)
    inside = Records(records.best, records.masks, bits, records.some_of, records.parents,
                     below[p:n + 1].copy(), records.x, records.sums)
    within = Limits(limits.margin, limits.tolerance, tree.rss[d], limits.slack, p, room)
    return int(walk(RSS, levels, within, inside, used, counts, tree.cursor, tree.mask, single))
