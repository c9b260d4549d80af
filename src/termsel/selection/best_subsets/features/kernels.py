"""The compiled walk behind `termsel.selection.best_subsets.features.walk`.

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

from termsel.adjustment.compiled import compile_lazily
from termsel.data.features import FloatArray
from termsel.selection.best_subsets.features.arrays import (
    EntrySpace,
    FeatureRows,
    RemainingSelections,
    SelectionLimits,
    WalkState,
)

_compiled = partial(compile_lazily, _nrt=False)

OPEN, UNKNOWN, SCORED, CARRIED = 0, 1, 2, 3
"""Too few rows; too badly conditioned for a score; scored; scored, and carried along from here."""

TRUSTED = 1e9
"""Condition of the normal matrix up to which a score by Cholesky is used."""

CARRY = 1e5
"""Condition of the normal matrix up to which the walk carries products along."""

FAR = 1e6
"""Squared errors, relative to the least possible, up to which the walk carries products along."""

_ROUGH_PIVOT, _HOPELESS = 1e-6, 4.0
"""Pivot, relative to the trace, above which rounding does not make a score so many times too large
as the second number says: what is beyond the limit by more is so truly."""

_SINGULAR = 1e-14  # pivot, relative to the trace, up to which a normal matrix is rounding alone


@_compiled
def enumerate_selections(rows: FeatureRows, state: WalkState, space: EntrySpace, first: int,
                         size: int, limits: SelectionLimits, remaining: RemainingSelections) -> int:
    """Decide a selection of some size and all with features from `first` on in addition.

    `state` has the selection at depth 0, and space below. Return how many of at least
    `limits.min_size` features may be within the limits, or have no score that can be trusted: the
    first rows of `remaining` hold them.
    """
    n = len(rows.bits)
    mask = state.mask
    cursor = state.cursor
    status = state.status
    min_size = limits.min_size
    max_size = limits.max_size
    square_limits = limits.squares
    # With plain numbers everything below would be compiled for these constants too.
    depth = int(np.intp(0))
    count = int(np.intp(0))
    no_feature = int(np.intp(-1))
    entering = size < max_size and first < n
    status[0] = _solve_selection(
        rows, state, space, depth=depth, first=first, further=entering,
        floor=limits.floor, limit=square_limits[size])
    count = _keep_selection(state, depth, size, limits, remaining, count)
    cursor[0] = first
    while True:
        current_size = size + depth
        # A selection that is carried scores all with one more feature at once.
        if entering and status[depth] == CARRIED and current_size + 1 >= min_size:
            _score_extensions(rows, state, space, depth, no_feature, cursor[depth])
            count = _keep_extensions(rows, space, cursor[depth], mask=mask[depth],
                                     limit=square_limits[current_size + 1], remaining=remaining,
                                     count=count)
        entering = False
        i = cursor[depth]
        # Upwards where no feature follows, none has room, or too few follow to reach `min_size`.
        if i >= n or current_size >= max_size or current_size + n - i < min_size:
            if depth == 0:
                return count
            depth -= 1
            continue
        cursor[depth] = i + 1
        further = current_size + 1 < max_size and i + 1 < n
        for w in range(mask.shape[1]):
            mask[depth + 1, w] = mask[depth, w] | rows.bits[i, w]
        if status[depth] == CARRIED:
            if not further:  # `_score_extensions` has scored it
                continue
            if current_size + 2 == max_size or i + 2 == n:  # nothing is below those with two more
                if current_size + 2 >= min_size:
                    _score_extensions(rows, state, space, depth, i, i + 1)
                    count = _keep_extensions(
                        rows,
                        space,
                        i + 1,
                        mask=mask[depth + 1],
                        limit=square_limits[current_size + 2],
                        remaining=remaining,
                        count=count,
                    )
                continue
            _carry_to_next_depth(rows, state, space, depth, i)
            status[depth + 1] = CARRIED
        else:
            _add_feature_rows(rows, state, depth, i)
            status[depth + 1] = _solve_selection(
                rows, state, space, depth=depth + 1, first=i + 1, further=further,
                floor=limits.floor, limit=square_limits[current_size + 1])
            count = _keep_selection(state, depth + 1, current_size + 1, limits, remaining, count)
        if further:
            depth += 1
            cursor[depth] = i + 1
            entering = True


@_compiled
def _keep_selection(state: WalkState, depth: int, size: int, limits: SelectionLimits,
                    remaining: RemainingSelections, count: int) -> int:
    """Keep the selection of `size` features at a depth if it is within its limit or has no score.

    It is written to row `count` of `remaining`. Return the number of rows then in use.
    """
    status = state.status[depth]
    if status == OPEN or size < limits.min_size:
        return count
    # What has no trusted score may be the best: minus infinity keeps it, to be solved with care.
    score = -np.inf
    if status != UNKNOWN:
        score = 0.0
        for p in range(state.square.shape[1]):
            score += state.square[depth, p]
        if score > limits.squares[size]:
            return count
    for w in range(state.mask.shape[1]):
        remaining.masks[count, w] = state.mask[depth, w]
    remaining.scores[count] = score
    return count + 1


@_compiled
def _keep_extensions(rows: FeatureRows, space: EntrySpace, first: int, mask: Any, limit: float,
                     remaining: RemainingSelections, count: int) -> int:
    """Write to `remaining` each extension of a selection by a feature that is within its limit.

    Features count from `first` on. Return the number of rows of `remaining` then in use.
    """
    for j in range(first, len(rows.bits)):
        if space.totals[j] <= limit:
            for w in range(len(mask)):
                remaining.masks[count, w] = mask[w] | rows.bits[j, w]
            remaining.scores[count] = space.totals[j]
            count += 1
    return count


@_compiled
def _add_feature_rows(rows: FeatureRows, state: WalkState, depth: int, i: int) -> None:
    """Set the normal equations of the next depth: those of this one, and the rows of feature i.

    Of each part p they are N = A'A, as its lower triangle, and A'b.
    """
    for p in range(len(rows.columns)):
        k = rows.columns[p]
        normal = state.normal[depth + 1, p]
        right = state.right[depth + 1, p]
        # A copy of this depth's equations, to which each row a adds a'a and a'b.
        for x in range(k):
            right[x] = state.right[depth, p, x]
            for z in range(x + 1):
                normal[x, z] = state.normal[depth, p, x, z]
        for t in range(rows.start[p, i], rows.start[p, i + 1]):
            a = rows.design[p, t]
            for x in range(k):
                right[x] += a[x] * rows.target[p, t]
                for z in range(x + 1):
                    normal[x, z] += a[x] * a[z]
        state.equations[depth + 1, p] = (state.equations[depth, p]
                                           + rows.start[p, i + 1] - rows.start[p, i])


@_compiled
def _solve_selection(rows: FeatureRows, state: WalkState, space: EntrySpace, depth: int, first: int,
                     further: bool, floor: float, limit: float) -> int:
    """Solve the selection at a depth by Cholesky; return OPEN, UNKNOWN, SCORED or CARRIED.

    It fills in y'y in `state`, the factor, its inverse and y in `space`, and with CARRIED the
    products, too. `further` says whether features from `first` on may enter: only then are products
    filled in. `floor` are the squared errors that no selection is below, `limit` those up to which
    the selection would remain.
    """
    worst, total, pivot = 0.0, 0.0, 1.0
    # Each part of the unknowns needs its own equations.
    for p in range(len(rows.columns)):
        if state.equations[depth, p] < rows.min_equations[p]:
            return OPEN
    # The squared errors of the check points are y'y but for a constant; parts add up.
    for p in range(len(rows.columns)):
        k = rows.columns[p]
        y = space.y[p]
        pivot = min(pivot, _solve_normal(state.normal[depth, p], state.right[depth, p], k,
                                         space.factor[p], y))
        if not pivot > 0.0:
            return UNKNOWN
        square = 0.0
        for x in range(k):
            square += y[x] * y[x]
        state.square[depth, p] = square
        total += square
    if not further and pivot > _ROUGH_PIVOT and total > _HOPELESS * limit:
        return SCORED  # however wrong that is, it is not within the limit
    # The inverse shows the condition, and all that is carried is made of it.
    for p in range(len(rows.columns)):
        worst = max(worst, _invert(state.normal[depth, p], rows.columns[p], space.factor[p],
                                   space.inverse[p]))
    if not worst <= TRUSTED:
        return UNKNOWN
    if not further or worst > CARRY or total > FAR * floor:
        return SCORED
    for p in range(len(rows.columns)):
        _fill_products(rows, state, space, depth, p, first)
    return CARRIED


@_compiled
def _solve_normal(normal: FloatArray, right: FloatArray, k: int, factor: FloatArray,
                  y: FloatArray) -> float:
    """Solve N y = r of k unknowns; return the least pivot relative to the trace, 0 if singular.

    `normal` (., .) has N in its first k rows and columns, the lower triangle; `right` is r.
    `factor` becomes the lower Cholesky factor, with its diagonal inverted, and `y` the solution.
    """
    trace, least_pivot = 0.0, 1.0
    for i in range(k):
        trace += normal[i, i]
    # Row i of L in N = L L', and component i of L^-1 r along with it.
    for i in range(k):
        for j in range(i):
            value = normal[i, j]
            for m in range(j):
                value -= factor[i, m] * factor[j, m]
            factor[i, j] = value * factor[j, j]
        value = normal[i, i]
        component = right[i]
        for j in range(i):
            value -= factor[i, j] * factor[i, j]
            component -= factor[i, j] * y[j]
        least_pivot = min(least_pivot, value / trace)
        if not value > _SINGULAR * trace:
            return 0.0
        factor[i, i] = 1.0 / np.sqrt(value)
        y[i] = component * factor[i, i]
    # Backwards, column by column: L' y = L^-1 r.
    for i in range(k - 1, -1, -1):
        y[i] *= factor[i, i]
        for j in range(i):
            y[j] -= factor[i, j] * y[i]
    return least_pivot


@_compiled
def _invert(normal: FloatArray, k: int, factor: FloatArray, inverse: FloatArray) -> float:
    """Invert a Cholesky factor L of N; return tr(N) tr(N^-1), at least the condition of N.

    The diagonal of `factor` is inverted, as `_solve_normal` leaves it; `inverse` becomes L^-1.
    """
    trace, inverse_trace = 0.0, 0.0
    # tr(N^-1) is the sum of squares of L^-1, whose columns are made one by one.
    for j in range(k):
        trace += normal[j, j]
        inverse[j, j] = factor[j, j]
        inverse_trace += inverse[j, j] * inverse[j, j]
        for i in range(j + 1, k):
            value = 0.0
            for m in range(j, i):
                value -= factor[i, m] * inverse[m, j]
            inverse[i, j] = value * factor[i, i]
            inverse_trace += inverse[i, j] * inverse[i, j]
    return float(trace * inverse_trace)


@_compiled
def _fill_products(rows: FeatureRows, state: WalkState, space: EntrySpace,
                   depth: int, p: int, first: int) -> None:
    """Fill h, q, e and g of a part at a depth, for the rows of the features from `first` on.

    With M = (A'A)^-1 of the features in use, h = a M a' and q = a M M a' of the rows a to come say
    what entering them does, e = b - a y is their error, and g = a M y. `space` has the inverse
    factor L^-1 and the solution y of the part p.
    """
    k = rows.columns[p]
    inverse = space.inverse[p]
    y = space.y[p]
    w = space.w
    start = rows.start[p, first]
    stop = rows.start[p, len(rows.bits)]
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
        e = rows.target[p, t]
        g = 0.0
        for x in range(k):
            e -= a[x] * y[x]
            g += w[t, x] * y[x]
        state.e[depth, p, t] = e
        state.g[depth, p, t] = g
    for t in range(start, stop):
        for u in range(t, stop):
            h, q = 0.0, 0.0  # a M a' and a M M a'
            for x in range(k):
                h += w[t, x] * rows.design[p, u, x]
                q += w[t, x] * w[u, x]
            state.h[depth, p, t, u] = h
            state.q[depth, p, t, u] = q
        state.diagonal_h[depth, p, t] = state.h[depth, p, t, t]
        state.diagonal_q[depth, p, t] = state.q[depth, p, t, t]


@_compiled
def _enter_feature(rows: FeatureRows, state: WalkState, space: EntrySpace,
                   depth: int, p: int, i: int) -> float:
    """Let the rows of feature i enter part p of the selection at a depth; return y'y of the part.

    Rows are entered one by one. Filled in are the arrays `rows`, `share` and `half` of `space`, by
    which h becomes h - share' rows and q becomes q - share' half - half' share, and its e and g.
    """
    start = rows.start[p, i]
    middle = rows.start[p, i + 1]
    stop = rows.start[p, len(rows.bits)]
    h = state.h[depth, p]
    q = state.q[depth, p]
    square = state.square[depth, p]
    e = space.e
    g = space.g
    for a in range(start, stop):
        e[a] = state.e[depth, p, a]
        g[a] = state.g[depth, p, a]
    # Row t of the feature enters after those before it: what these change of its products is taken
    # off first, then Sherman and Morrison's formula applies to a single row.
    for t in range(start, middle):
        row = space.rows[t - start]
        share = space.share[t - start]
        half = space.half[t - start]
        for a in range(t, stop):
            row[a] = h[t, a]
            half[a] = q[t, a]
        for s in range(t - start):
            earlier_share = space.share[s, t]
            earlier_half = space.half[s, t]
            for a in range(t, stop):
                row[a] -= earlier_share * space.rows[s, a]
                half[a] -= earlier_share * space.half[s, a] + earlier_half * space.share[s, a]
        # Sherman and Morrison: M becomes M - M a'a M / (1 + h). With v = e / (1 + h) the solution y
        # moves by v M a', hence y'y by v (2 g + v q).
        d = 1.0 / (1.0 + row[t])  # h is not negative
        entering_e = e[t]
        entering_g = g[t]
        entering_q = half[t]
        v = entering_e * d
        square += v * (2.0 * entering_g + v * entering_q)
        # Of every later row a, with u = h_at / (1 + h): its misfit and its product g = a M y.
        for a in range(t, stop):
            u = row[a] * d
            e[a] -= u * entering_e
            g[a] += v * half[a] - u * (entering_g + entering_q * v)
            share[a] = u
            half[a] -= 0.5 * u * entering_q  # half of it in each of the two products that q loses
    return float(square)


@_compiled
def _carry_to_next_depth(rows: FeatureRows, state: WalkState, space: EntrySpace, depth: int,
                         i: int) -> None:
    """Set h, q, e, g and y'y of the next depth: those of this one after feature i has entered.

    Entering feature i changes M by a term of the rank of its rows (Woodbury's formula), so that h
    and q change by products of two vectors, which `_enter_feature` leaves in `space`. Rows of the
    feature are taken one after the other.
    """
    for p in range(len(rows.columns)):
        state.square[depth + 1, p] = _enter_feature(rows, state, space, depth, p, i)
        # Only features after i may still enter below.
        start = rows.start[p, i + 1]
        stop = rows.start[p, len(rows.bits)]
        for a in range(start, stop):
            state.e[depth + 1, p, a] = space.e[a]
            state.g[depth + 1, p, a] = space.g[a]
            h = state.h[depth + 1, p, a]
            q = state.q[depth + 1, p, a]
            old_h = state.h[depth, p, a]
            old_q = state.q[depth, p, a]
            # The first row of the feature copies on its way; the others change in place.
            row = space.rows[0]
            share = space.share[0]
            half = space.half[0]
            u = share[a]
            c = half[a]
            for b in range(a, stop):
                h[b] = old_h[b] - u * row[b]
                q[b] = old_q[b] - u * half[b] - c * share[b]
            for t in range(1, start - rows.start[p, i]):
                row = space.rows[t]
                share = space.share[t]
                half = space.half[t]
                u = share[a]
                c = half[a]
                for b in range(a, stop):
                    h[b] -= u * row[b]
                    q[b] -= u * half[b] + c * share[b]
            state.diagonal_h[depth + 1, p, a] = h[a]
            state.diagonal_q[depth + 1, p, a] = q[a]


@_compiled
def _score_extensions(rows: FeatureRows, state: WalkState, space: EntrySpace,
                      depth: int, i: int, first: int) -> None:
    """Fill `totals` of `space` with y'y of the extensions by each feature from `first` on.

    Extended is the selection at a depth with feature i, or as it is if i is -1.
    """
    n = len(rows.bits)
    for j in range(first, n):
        space.totals[j] = 0.0
    for p in range(len(rows.columns)):
        if rows.single[p] and i >= 0:
            _score_single_rows(state, depth, p, i, first, space.totals)
            continue
        square = state.square[depth, p]
        entered = 0
        e = state.e[depth, p]
        g = state.g[depth, p]
        if i >= 0:
            # Rows still to come change by the feature that enters; without one they stay.
            square = _enter_feature(rows, state, space, depth, p, i)
            e = space.e
            g = space.g
            entered = rows.start[p, i + 1] - rows.start[p, i]
        for j in range(first, n):
            space.totals[j] += _squares_with_feature(
                rows.start[p, j], rows.start[p, j + 1], entered, h=state.h[depth, p],
                q=state.q[depth, p], e=e, g=g, square=square, space=space)


@_compiled
def _score_single_rows(state: WalkState, depth: int, p: int, i: int, first: int,
                       total: FloatArray) -> None:
    """Add to `total` (n,) y'y of part p with feature i and each one from `first` on.

    All features have one row in the part. It is `_enter_feature` and `_squares_with_feature` in
    one.
    """
    row = state.h[depth, p, i]
    products = state.q[depth, p, i]
    diagonal_h = state.diagonal_h[depth, p]
    diagonal_q = state.diagonal_q[depth, p]
    e = state.e[depth, p]
    g = state.g[depth, p]
    d = 1.0 / (1.0 + row[i])
    entering_q = products[i]
    v = e[i] * d
    square = state.square[depth, p] + v * (2.0 * g[i] + v * entering_q)
    entering_e = e[i]
    entering_g = g[i] + entering_q * v
    for a in range(first, len(total)):
        # What the row of feature i leaves of h, q, e and g of row a; then row a enters.
        u = row[a] * d
        half = products[a] - 0.5 * u * entering_q
        w = (e[a] - u * entering_e) / (1.0 + diagonal_h[a] - u * row[a])
        total[a] += square + w * (2.0 * (g[a] + v * products[a] - u * entering_g)
                                  + w * (diagonal_q[a] - 2.0 * u * half))


@_compiled
def _squares_with_feature(start: int, stop: int, entered: int, h: FloatArray, q: FloatArray,
                          e: FloatArray, g: FloatArray, square: float, space: EntrySpace) -> float:
    """Return y'y with the rows from start to stop, after `entered` rows of another feature.

    `h` and `q` (rows, rows) are without that feature, whose changes `space` has; `e` and `g`
    (rows,) and `square`, which is y'y, are with it.
    """
    small_h = space.small_h
    small_q = space.small_q
    m = stop - start
    feature_e, feature_g, share, half = space.small
    # h and q among these rows, less what the rows of the other feature have changed.
    for x in range(m):
        feature_e[x] = e[start + x]
        feature_g[x] = g[start + x]
        for z in range(x, m):
            value_h = h[start + x, start + z]
            value_q = q[start + x, start + z]
            for t in range(entered):
                u = space.share[t, start + x]
                value_h -= u * space.rows[t, start + z]
                value_q -= (u * space.half[t, start + z]
                            + space.half[t, start + x] * space.share[t, start + z])
            small_h[x, z] = value_h
            small_q[x, z] = value_q
    # The rows enter one by one, as in `_enter_feature`; nothing but y'y is needed of the last.
    for x in range(m):
        d = 1.0 / (1.0 + small_h[x, x])
        entering_q = small_q[x, x]
        v = feature_e[x] * d
        square += v * (2.0 * feature_g[x] + v * entering_q)
        for z in range(x + 1, m):
            u = small_h[x, z] * d
            share[z] = u
            half[z] = small_q[x, z] - 0.5 * u * entering_q
            feature_e[z] -= u * feature_e[x]
            feature_g[z] += v * small_q[x, z] - u * (feature_g[x] + entering_q * v)
        for z in range(x + 1, m):
            for c in range(z, m):
                small_h[z, c] -= share[z] * small_h[x, c]
                small_q[z, c] -= share[z] * half[c] + half[z] * share[c]
    return square
