"""A bound that rules out many subsets at once, for the enumeration of all subsets.

Let I be the columns in use, and let all vectors have them removed: the columns T and the target r
in the control rows, V and e in the c rows of the score, d and D for the denominators there. A
subset that adds columns S of F to I has coefficients b, zero outside S, errors e - V b, and
denominators D + d b, none below the margin. Both are divided by t = 1 / (sum of D + d b), which
leaves the score as it is: let x = t b. Four facts hold for each such subset, whatever S is:

1. sum of t D + d x = 1, each of them is positive, and 0 < t <= 1 / (c margin).
2. T b is the projection of r on the columns S, so that |T b - r / 2| = |r| / 2: the projections
   of r on all subspaces lie on one sphere. Hence |T x - t r / 2|^2 = t^2 |r|^2 / 4.
3. If t <= tau, fact 2 gives |T x - t r / 2|^2 <= tau^2 |r|^2 / 4.
4. If the score is at most B, and no t D + d x is above U <= 1, then
   sum of ((t e - V x) / U)^2 <= B.

Hence, for positive weights that add up to 1, their mean q(t, x) of t^2 / tau^2, of
4 |T x - t r / 2|^2 / (tau |r|)^2 and of sum of ((t e - V x) / U)^2 / B is at most 1. It is a
quadratic form without linear part. Its minimum where t D + d x add up to 1 has a closed form. If
that is above 1, no subset of F scores B or less. Otherwise all points (t, x) with q <= 1 on that
plane lie in an ellipsoid, on which t and each t D + d x have largest values: new tau and U, to be
used in turn. If one is negative, no subset scores B or less. They hold for the subsets below, too.
The first tau and U of long proofs are those of `bounds.shares`, which know the guard points.

That all is divided by the sum of the denominators keeps it finite where columns are more than
rows: b itself may grow without limit there. Without denominators t = tau = U = 1, and q is least
squares with a constraint. termsel's own formulation; fact 2 is Thales'.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from termsel.adjustment.compiled import compile_lazily
from termsel.data.features import FloatArray
from termsel.selection.best_subsets.columns.arrays import BoundSpace

_compiled = partial(compile_lazily, _nrt=False, fastmath={"reassoc", "contract", "arcp", "nsz"})

_DUAL_STEPS = 8  # of tau and U; each costs as much as a test
_LIMIT_GAIN = 0.9  # a step that lowers no limit to this share is the last
_PIVOT = 1e-8  # least pivot of the quadratic, relative to its diagonal
_LIMIT_ROUNDING = 1e-6  # of what is 1 at the limit; errors are below 1e-14 / pivot
_SPHERE, _SCALE = 0.15, 0.1  # weights of facts 3 and 1; the rest is of fact 4


@_compiled
def first_closed_by_parts(top: FloatArray, extra: FloatArray, first: int, n: int, limit: float,
                          upper: FloatArray, rational: bool, space: BoundSpace) -> int:
    """Return a column j such that all subsets that add some of j, ..., n - 1 alone score too much.

    Too much is more than `limit`, the B of the module's text. The column is `first` if none of the
    columns F = first, ..., n - 1 need be looked at, and n if nothing is known.

    `top` (n + 1, rows) has the vectors T and r, `extra` (n + 1, c) the V and e, and (n + 1, 2 c)
    also d and D where there are denominators: they are one depth of `Vectors`, without the columns
    in use. `upper` (c + 1,), U and tau, is lowered in place if the score is `rational`, and is 1
    for scores without denominators. `space` is overwritten.
    """
    count = n - first + 1
    c = len(upper) - 1
    gram = space.gram
    triangle = space.triangle
    weight = space.x[0]
    h = space.x[1]
    y = space.x[2]
    # |r|^2: without a target in the control rows the sphere of fact 2 is a point.
    squared_r = 0.0
    for k in range(top.shape[1]):
        squared_r += top[n, k] * top[n, k]
    if not squared_r > 0.0:
        return n
    # The target is vector 0 and stands for -t; column n - i is vector i.
    for i in range(count):
        for j in range(i + 1):
            total = 0.0
            for k in range(top.shape[1]):
                total += top[n - i, k] * top[n - j, k]
            # Fact 2 halves the target, vector 0: 1/2 in products with it, 1/4 in its own.
            factor = 1.0
            if j == 0:
                factor = 0.5 if i > 0 else 0.25
            gram[i, j] = 4.0 / squared_r * total * factor
    closed = 0  # last columns of which no subset scores that little
    for _ in range(_DUAL_STEPS):
        tau = upper[c]
        sphere = _SPHERE / (tau * tau)
        scale = _SCALE / (tau * tau)
        if not rational:  # t is 1, so that fact 1 says nothing
            sphere, scale = 0.5, 0.0
        # Weights of facts 3 and 1, whose limits are 1 at t = tau; fact 4 has the rest of 1.
        for k in range(c):
            weight[k] = (1.0 - (sphere + scale) * tau * tau) / (limit * upper[k] * upper[k])
        # Cholesky's triangle L of the quadratic, vector by vector. With the sums s of the
        # denominators' columns its minimum is 1 / |L^-1 s|^2. After i steps that over the last i
        # columns alone is known, so one elimination tests every tail of F.
        squared_h = 0.0
        failed = False
        for i in range(count):
            for k in range(c):
                y[k] = weight[k] * extra[n - i, k]
            for j in range(i + 1):
                total = sphere * gram[i, j]
                for k in range(c):
                    total += y[k] * extra[n - j, k]
                triangle[i, j] = total
            # s_i, the sum of the denominators' column: the constraint is s'(-t, x) = 1.
            total = 0.0
            for k in range(c, extra.shape[1]):
                total += extra[n - i, k]
            if not rational:  # the constraint is t = 1
                total = 1.0 if i == 0 else 0.0
            if i == 0:
                triangle[0, 0] += scale  # fact 1: of t alone
            # Row i of L by the rows above it, and h = L^-1 s along with it.
            pivot = triangle[i, i]
            least_pivot = _PIVOT * pivot
            for j in range(i):
                ratio = triangle[i, j]
                for k in range(j):
                    ratio -= triangle[i, k] * triangle[j, k]
                ratio /= triangle[j, j]
                triangle[i, j] = ratio
                pivot -= ratio * ratio
                total -= ratio * h[j]
            if not pivot > least_pivot:
                failed = True  # the minimum has no digits left from here on
                break
            triangle[i, i] = np.sqrt(pivot)
            h[i] = total / triangle[i, i]
            squared_h += h[i] * h[i]
            if squared_h < 1.0 - _LIMIT_ROUNDING and i > closed:  # the minimum is above 1
                closed = i
        if failed or closed == count - 1 or not rational:
            return n - closed
        gain = _lower_limits(extra, n, count, upper, squared_h, space)
        if gain < 0:
            return first
        if gain == 0:
            return n - closed
    return n - closed


@_compiled
def _lower_limits(extra: FloatArray, n: int, count: int, upper: FloatArray, squared_h: float,
                  space: BoundSpace) -> int:
    """Lower the limits U and tau in `upper` (c + 1,) to their maxima on the ellipsoid q <= 1.

    `space` has the triangle L of the quadratic q of the target and the `count` - 1 columns before
    n; `squared_h` is |h|^2, one over the least q. `extra` (n + 1, 2 c) has the denominators in its
    last c columns. With z = L'(-t, x) and h = L^-1 s the ellipsoid is |z|^2 <= 1 on the plane
    h'z = 1. There a linear function a'z has the maximum
    a'h / |h|^2 + ((1 - 1 / |h|^2) (|a|^2 - (a'h)^2 / |h|^2))^1/2.

    Returns 1 if a limit is lower by some share, 0 if none is, -1 if one is negative.
    """
    c = len(upper) - 1
    triangle = space.triangle
    rows = space.rows
    along_h = space.x[0]
    h = space.x[1]
    squared_a = space.x[2]
    for k in range(c + 1):
        along_h[k] = squared_a[k] = 0.0
    for i in range(count):
        # Each denominator t D + d x is a function to maximise, and t itself: the target is -t.
        for k in range(c):
            rows[i, k] = extra[n - i, c + k]
        rows[i, c] = 0.0 if i > 0 else -1.0
        # a in the basis of L, by forward substitution; along with it a'h and |a|^2.
        for j in range(i):
            ratio = triangle[i, j]
            for k in range(c + 1):
                rows[i, k] -= ratio * rows[j, k]
        ratio = 1.0 / triangle[i, i]
        for k in range(c + 1):
            rows[i, k] *= ratio
            along_h[k] += rows[i, k] * h[i]
            squared_a[k] += rows[i, k] * rows[i, k]
    # Rounding may make either factor a little negative; limits are a little too high instead.
    squared_radius = max(0.0, 1.0 - 1.0 / squared_h) + _LIMIT_ROUNDING
    gain = 0
    for k in range(c + 1):
        squared_across_h = max(0.0, squared_a[k] - along_h[k] * along_h[k] / squared_h)
        squared_across_h += _LIMIT_ROUNDING * squared_a[k]
        largest = along_h[k] / squared_h + np.sqrt(squared_radius * squared_across_h)
        if largest < 0.0:
            return -1
        if largest < _LIMIT_GAIN * upper[k]:
            gain = 1
        upper[k] = min(upper[k], largest)
    return gain
