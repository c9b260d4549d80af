"""The compiled walk behind `termsel.enumeration.features.walk`.

Unknowns y are those in which the squared errors of the check points are a constant plus y'y. For a
selection with the normal matrix N, M = N^-1 and rows a that are not selected, the walk carries
h = a M a', q = a M M a', the misfit e = b - a y and g = a M y. With one more row, h, q, e, g and
y'y follow from these alone (Sherman and Morrison 1950), so that a selection costs some ten
operations whatever the number of terms. Rows only ever enter: nothing is taken out again, and
1 + h never vanishes. The first selection of a branch is solved by Cholesky; so is every one
on the way to it that determines too little or is badly conditioned.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from termsel.adjustment.compiled import compiled
from termsel.enumeration.features.arrays import Carried, EntrySpace, FeatureRows, Kept, Wanted
from termsel.measurements.features import FloatArray

_compiled = partial(compiled, _nrt=False)

OPEN, UNKNOWN, SCORED, CARRIED = 0, 1, 2, 3
"""Too few rows; too badly conditioned for a score; scored; scored, and carried along from here."""

TRUSTED = 1e9
"""Condition of the normal matrix up to which a score by Cholesky is used."""

CARRY = 1e5
"""Condition of the normal matrix up to which the walk carries products along."""

FAR = 1e6
"""Squared errors, relative to the least possible, up to which it does."""


@_compiled
def walk(rows: FeatureRows, carried: Carried, space: EntrySpace, first: int, size: int,
         wanted: Wanted, kept: Kept) -> int:
    """Decide a selection of some size and all with features from `first` on in addition.

    Return how many remain: so many first places of `kept` are filled.
    """
    n, mask, cursor, state = len(rows.bits), carried.mask, carried.cursor, carried.state
    least, most, limits = wanted.least, wanted.most, wanted.limits
    # With plain numbers everything below would be compiled for these constants too.
    depth, count, nothing = int(np.intp(0)), int(np.intp(0)), int(np.intp(-1))
    entering = size < most and first < n
    state[0] = _open(rows, carried, space, depth, first, entering, wanted.floor, limits[size])
    count = _keep(carried, depth, size, wanted, kept, count)
    cursor[0] = first
    while True:
        here = size + depth
        # A selection that is carried scores all with one more feature at once.
        if entering and state[depth] == CARRIED and here + 1 >= least:
            _scan(rows, carried, space, depth, nothing, cursor[depth])
            count = _keep_all(rows, space, cursor[depth], mask[depth], limits[here + 1], kept,
                              count)
        entering = False
        i = cursor[depth]
        if i >= n or here >= most or here + n - i < least:  # too few are left to reach the least
            if depth == 0:
                return count
            depth -= 1
            continue
        cursor[depth] = i + 1
        further = here + 1 < most and i + 1 < n
        for word in range(mask.shape[1]):
            mask[depth + 1, word] = mask[depth, word] | rows.bits[i, word]
        if state[depth] == CARRIED:
            if not further:  # `_scan` has scored it
                continue
            if here + 2 == most or i + 2 == n:  # nothing is below those with two more
                if here + 2 >= least:
                    _scan(rows, carried, space, depth, i, i + 1)
                    count = _keep_all(rows, space, i + 1, mask[depth + 1], limits[here + 2], kept,
                                      count)
                continue
            _carry(rows, carried, space, depth, i)
            state[depth + 1] = CARRIED
        else:
            _add(rows, carried, depth, i)
            state[depth + 1] = _open(rows, carried, space, depth + 1, i + 1, further,
                                     wanted.floor, limits[here + 1])
            count = _keep(carried, depth + 1, here + 1, wanted, kept, count)
        if further:
            depth += 1
            cursor[depth] = i + 1
            entering = True


@_compiled
def _keep(carried: Carried, depth: int, size: int, wanted: Wanted, kept: Kept, count: int) -> int:
    """Take down a selection that is within its limit, or has no score; return the number."""
    state = carried.state[depth]
    if state == OPEN or size < wanted.least:
        return count
    score = -np.inf
    if state != UNKNOWN:
        score = 0.0
        for p in range(carried.square.shape[1]):
            score += carried.square[depth, p]
        if score > wanted.limits[size]:
            return count
    for word in range(carried.mask.shape[1]):
        kept.masks[count, word] = carried.mask[depth, word]
    kept.scores[count] = score
    return count + 1


@_compiled
def _keep_all(rows: FeatureRows, space: EntrySpace, first: int, mask: Any, limit: float, kept: Kept,
              count: int) -> int:
    """Take down what is within its limit of a selection with each feature from `first` on."""
    for j in range(first, len(rows.bits)):
        if space.total[j] <= limit:
            for word in range(len(mask)):
                kept.masks[count, word] = mask[word] | rows.bits[j, word]
            kept.scores[count] = space.total[j]
            count += 1
    return count


@_compiled
def _add(rows: FeatureRows, carried: Carried, depth: int, i: int) -> None:
    """Add the rows of a feature to the normal equations."""
    for p in range(len(rows.columns)):
        k = rows.columns[p]
        normal, right = carried.normal[depth + 1, p], carried.right[depth + 1, p]
        for x in range(k):
            right[x] = carried.right[depth, p, x]
            for z in range(x + 1):
                normal[x, z] = carried.normal[depth, p, x, z]
        for t in range(rows.start[p, i], rows.start[p, i + 1]):
            a = rows.design[p, t]
            for x in range(k):
                right[x] += a[x] * rows.target[p, t]
                for z in range(x + 1):
                    normal[x, z] += a[x] * a[z]
        carried.equations[depth + 1, p] = (carried.equations[depth, p]
                                           + rows.start[p, i + 1] - rows.start[p, i])


@_compiled
def _open(rows: FeatureRows, carried: Carried, space: EntrySpace, depth: int, first: int,
          further: bool, floor: float, limit: float) -> int:
    """Solve the selection at a depth by Cholesky; return OPEN, UNKNOWN, SCORED or CARRIED."""
    worst, total, pivot = 0.0, 0.0, 1.0
    for p in range(len(rows.columns)):
        if carried.equations[depth, p] < rows.needed[p]:
            return OPEN
    for p in range(len(rows.columns)):
        k, y = rows.columns[p], space.y[p]
        pivot = min(pivot, _solve(carried.normal[depth, p], carried.right[depth, p], k,
                                  space.factor[p], y))
        if not pivot > 0.0:
            return UNKNOWN
        square = 0.0
        for x in range(k):
            square += y[x] * y[x]
        carried.square[depth, p] = square
        total += square
    if not further and pivot > 1e-6 and total > 4.0 * limit:
        return SCORED  # however wrong that is, it is not within the limit
    # The inverse tells the condition, and all that is carried is made of it.
    for p in range(len(rows.columns)):
        worst = max(worst, _invert(carried.normal[depth, p], rows.columns[p], space.factor[p],
                                   space.inverse[p]))
    if not worst <= TRUSTED:
        return UNKNOWN
    if not further or worst > CARRY or total > FAR * floor:
        return SCORED
    for p in range(len(rows.columns)):
        _products(rows, carried, space, depth, p, first)
    return CARRIED


@_compiled
def _solve(normal: FloatArray, right: FloatArray, k: int, factor: FloatArray,
           y: FloatArray) -> float:
    """Solve N y = r of k unknowns; return the least pivot relative to the trace, 0 if singular.

    `factor` becomes the lower Cholesky factor, with its diagonal inverted.
    """
    trace, least = 0.0, 1.0
    for x in range(k):
        trace += normal[x, x]
    for x in range(k):
        for z in range(x):
            value = normal[x, z]
            for c in range(z):
                value -= factor[x, c] * factor[z, c]
            factor[x, z] = value * factor[z, z]
        value, own = normal[x, x], right[x]
        for c in range(x):
            value -= factor[x, c] * factor[x, c]
            own -= factor[x, c] * y[c]
        # Pivots below this are rounding: the matrix counts as singular.
        least = min(least, value / trace)
        if not value > 1e-14 * trace:
            return 0.0
        factor[x, x] = 1.0 / np.sqrt(value)
        y[x] = own * factor[x, x]
    for x in range(k - 1, -1, -1):
        y[x] *= factor[x, x]  # backwards, column by column
        for z in range(x):
            y[z] -= factor[x, z] * y[x]
    return least


@_compiled
def _invert(normal: FloatArray, k: int, factor: FloatArray, inverse: FloatArray) -> float:
    """Invert a Cholesky factor; return tr(N) tr(N^-1), which is at least the condition of N."""
    trace, back = 0.0, 0.0
    for z in range(k):
        trace += normal[z, z]
        inverse[z, z] = factor[z, z]
        back += inverse[z, z] * inverse[z, z]
        for x in range(z + 1, k):
            value = 0.0
            for c in range(z, x):
                value -= factor[x, c] * inverse[c, z]
            inverse[x, z] = value * factor[x, x]
            back += inverse[x, z] * inverse[x, z]
    return float(trace * back)


@_compiled
def _products(rows: FeatureRows, carried: Carried, space: EntrySpace,
              depth: int, p: int, first: int) -> None:
    """Fill h, q, e and g of a part at a depth, for the rows of the features from `first` on."""
    k, inverse, y, w = rows.columns[p], space.inverse[p], space.y[p], space.w
    start, stop = rows.start[p, first], rows.start[p, len(rows.bits)]
    for t in range(start, stop):
        a = rows.design[p, t]
        for x in range(k):
            w[t, x] = 0.0
        for x in range(k):
            value = 0.0
            for z in range(x + 1):
                value += inverse[x, z] * a[z]
            for z in range(x + 1):
                w[t, z] += inverse[x, z] * value  # M a = L^-T L^-1 a
        e, g = rows.target[p, t], 0.0
        for x in range(k):
            e -= a[x] * y[x]
            g += w[t, x] * y[x]
        carried.e[depth, p, t], carried.g[depth, p, t] = e, g
    for t in range(start, stop):
        for u in range(t, stop):
            h, q = 0.0, 0.0  # a M a' and a M M a'
            for x in range(k):
                h += w[t, x] * rows.design[p, u, x]
                q += w[t, x] * w[u, x]
            carried.h[depth, p, t, u], carried.q[depth, p, t, u] = h, q
        carried.own_h[depth, p, t] = carried.h[depth, p, t, t]
        carried.own_q[depth, p, t] = carried.q[depth, p, t, t]


@_compiled
def _enter(rows: FeatureRows, carried: Carried, space: EntrySpace,
           depth: int, p: int, i: int) -> float:
    """Let the rows of feature i enter, one by one; return y'y.

    Fills `rows`, `share` and `half`, by which h becomes h - share' rows and q becomes q - share'
    half - half' share, and e and g.
    """
    start, middle, stop = rows.start[p, i], rows.start[p, i + 1], rows.start[p, len(rows.bits)]
    h, q, square = carried.h[depth, p], carried.q[depth, p], carried.square[depth, p]
    e, g = space.e, space.g
    for a in range(start, stop):
        e[a], g[a] = carried.e[depth, p, a], carried.g[depth, p, a]
    # Row t of the feature enters after those before it: what these change of its products is taken
    # off first, then Sherman and Morrison's formula applies to a single row.
    for t in range(start, middle):
        row, share, half = space.rows[t - start], space.share[t - start], space.half[t - start]
        for a in range(t, stop):
            row[a], half[a] = h[t, a], q[t, a]
        for s in range(t - start):
            own, own_half = space.share[s, t], space.half[s, t]
            for a in range(t, stop):
                row[a] -= own * space.rows[s, a]
                half[a] -= own * space.half[s, a] + own_half * space.share[s, a]
        d = 1.0 / (1.0 + row[t])  # h is not negative
        own_e, own_g, own_q = e[t], g[t], half[t]
        v = own_e * d
        square += v * (2.0 * own_g + v * own_q)
        for a in range(t, stop):
            u = row[a] * d
            e[a] -= u * own_e
            g[a] += v * half[a] - u * (own_g + own_q * v)
            share[a] = u
            half[a] -= 0.5 * u * own_q  # half of it in each of the two products that q loses
    return float(square)


@_compiled
def _carry(rows: FeatureRows, carried: Carried, space: EntrySpace, depth: int, i: int) -> None:
    """Carry everything to the next depth, with feature i."""
    for p in range(len(rows.columns)):
        carried.square[depth + 1, p] = _enter(rows, carried, space, depth, p, i)
        start, stop = rows.start[p, i + 1], rows.start[p, len(rows.bits)]
        for a in range(start, stop):
            carried.e[depth + 1, p, a], carried.g[depth + 1, p, a] = space.e[a], space.g[a]
            h, q = carried.h[depth + 1, p, a], carried.q[depth + 1, p, a]
            old_h, old_q = carried.h[depth, p, a], carried.q[depth, p, a]
            # The first row of the feature copies on its way; the others change in place.
            row, share, half = space.rows[0], space.share[0], space.half[0]
            u, c = share[a], half[a]
            for b in range(a, stop):
                h[b] = old_h[b] - u * row[b]
                q[b] = old_q[b] - u * half[b] - c * share[b]
            for t in range(1, start - rows.start[p, i]):
                row, share, half = space.rows[t], space.share[t], space.half[t]
                u, c = share[a], half[a]
                for b in range(a, stop):
                    h[b] -= u * row[b]
                    q[b] -= u * half[b] + c * share[b]
            carried.own_h[depth + 1, p, a], carried.own_q[depth + 1, p, a] = h[a], q[a]


@_compiled
def _scan(rows: FeatureRows, carried: Carried, space: EntrySpace,
          depth: int, i: int, first: int) -> None:
    """Score the selection at a depth, with feature i unless it is -1, with each one after."""
    n = len(rows.bits)
    for j in range(first, n):
        space.total[j] = 0.0
    for p in range(len(rows.columns)):
        if rows.single[p] and i >= 0:
            _scan_single(carried, depth, p, i, first, space.total)
            continue
        square, entered = carried.square[depth, p], 0
        e, g = carried.e[depth, p], carried.g[depth, p]
        if i >= 0:
            square, e, g = _enter(rows, carried, space, depth, p, i), space.e, space.g
            entered = rows.start[p, i + 1] - rows.start[p, i]
        for j in range(first, n):
            space.total[j] += _with_feature(rows.start[p, j], rows.start[p, j + 1], entered,
                                            carried.h[depth, p], carried.q[depth, p], e, g, square,
                                            space)


@_compiled
def _scan_single(carried: Carried, depth: int, p: int, i: int, first: int,
                 total: FloatArray) -> None:
    """Add y'y with feature i and each later one, all of one row: `_enter` and `_with_feature`."""
    row, products = carried.h[depth, p, i], carried.q[depth, p, i]
    own_h, own_q = carried.own_h[depth, p], carried.own_q[depth, p]
    e, g = carried.e[depth, p], carried.g[depth, p]
    d, own = 1.0 / (1.0 + row[i]), products[i]
    v = e[i] * d
    square = carried.square[depth, p] + v * (2.0 * g[i] + v * own)
    own_e, own_g = e[i], g[i] + own * v
    for a in range(first, len(total)):
        # What the row of feature i leaves of h, q, e and g of row a; then row a enters.
        u = row[a] * d
        half = products[a] - 0.5 * u * own
        w = (e[a] - u * own_e) / (1.0 + own_h[a] - u * row[a])
        total[a] += square + w * (2.0 * (g[a] + v * products[a] - u * own_g)
                                  + w * (own_q[a] - 2.0 * u * half))


@_compiled
def _with_feature(start: int, stop: int, entered: int, h: FloatArray, q: FloatArray,
                  e: FloatArray, g: FloatArray, square: float, space: EntrySpace) -> float:
    """Return y'y with the rows from start to stop, after `entered` rows of another feature."""
    small_h, small_q, m = space.small_h, space.small_q, stop - start
    own_e, own_g, share, half = space.small
    # h and q among its own rows, less what those of the other feature have changed.
    for x in range(m):
        own_e[x], own_g[x] = e[start + x], g[start + x]
        for z in range(x, m):
            value_h, value_q = h[start + x, start + z], q[start + x, start + z]
            for t in range(entered):
                u = space.share[t, start + x]
                value_h -= u * space.rows[t, start + z]
                value_q -= (u * space.half[t, start + z]
                            + space.half[t, start + x] * space.share[t, start + z])
            small_h[x, z], small_q[x, z] = value_h, value_q
    # They enter one by one, as in `_enter`; nothing but y'y is needed of the last.
    for x in range(m):
        d, own = 1.0 / (1.0 + small_h[x, x]), small_q[x, x]
        v = own_e[x] * d
        square += v * (2.0 * own_g[x] + v * own)
        for z in range(x + 1, m):
            u = small_h[x, z] * d
            share[z], half[z] = u, small_q[x, z] - 0.5 * u * own
            own_e[z] -= u * own_e[x]
            own_g[z] += v * small_q[x, z] - u * (own_g[x] + own * v)
        for z in range(x + 1, m):
            for c in range(z, m):
                small_h[z, c] -= share[z] * small_h[x, c]
                small_q[z, c] -= share[z] * half[c] + half[z] * share[c]
    return square
