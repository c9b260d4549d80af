"""Each point as the others predict it, averaged over the solutions that matter.

Without a point the sum of squares S of a solution becomes S - e^2 / l of both axes, with its error
e and 1 less its leverage l, and its evidence changes by the factor

    (l_line l_sample)^-1/2 (S / S')^h S,   S' = S - e^2 / l,   2 h = degrees of freedom without it.

Equations are two for each point and terms two for each monomial, so that h is a whole number: the
power takes some multiplications, and no logarithm. The chance of a larger F than the point's, with
2 and 2 h degrees of freedom, is (S' / S)^h, the same power once more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import partial
from typing import NamedTuple

import numpy as np

from termsel.adjustment.compiled import compiled, is_compiled
from termsel.data.features import FloatArray, IntArray

FEW = 100
"""Points up to which no kernel is called: it takes half as long, but numba longer to import."""

LEAST = -300.0
"""Powers are not taken below this natural logarithm, lest numbers lose precision and time."""

AT_ONCE, CELLS = 64, 8
"""Points and cells that are worked on together: what is read again stays in a cache."""

NUMBERS = 1 << 15
"""Points times cells that are worked on together without a kernel."""

# Nothing is allocated. Sums may be taken in any order. `max` would be compiled on its own.
_compiled = partial(compiled, _nrt=False, fastmath={"reassoc", "contract", "nsz", "nnan"})


@dataclass(frozen=True, eq=False)
class Prediction:
    """Each of m points as others predict it, averaged over the solutions that matter."""

    errors: FloatArray  # (m, 2): measured minus predicted, of line and sample
    chance: FloatArray  # (m,): of errors as large
    statistic: FloatArray  # (m,): mean square of the errors by their variances
    spread: FloatArray  # (m, 2): variance of the errors by that of the noise
    log: FloatArray  # (m,): logarithm of the evidence of the points that predict


def chance_of(statistic: FloatArray, freedom: int, pairs: int = 1) -> FloatArray:
    """Return the chance of a larger F with 2 `pairs` and `freedom` degrees: scipy's takes long."""
    part = 2 * pairs * statistic / freedom
    term = total = np.exp(-freedom / 2 * np.log1p(part))
    for i in range(pairs - 1):  # the incomplete beta function of a whole number
        term = term * (freedom / 2 + i) / (i + 1) * part / (1 + part)
        total = total + term
    return np.asarray(total)


class OfAxis(NamedTuple):
    """The u solutions of one axis, for n points."""

    left: FloatArray  # (u, n): 1 less the leverage of each point
    errors: FloatArray  # (u, n)
    cell: IntArray  # (c,): which solution each cell of the posterior has


class _Room(NamedTuple):
    """What some points are worked on in, m at once."""

    line: FloatArray  # (4, u, m): 1 / l, its root, e / l and e^2 / l of line
    sample: FloatArray  # (4, v, m): of sample
    grown: FloatArray  # (c, m): S / S' - 1
    share: FloatArray  # (CELLS m,)
    power: FloatArray  # (CELLS m,)
    sums: FloatArray  # (9, m)


def leave_each_out(line: OfAxis, sample: OfAxis, square: FloatArray, least: FloatArray,
                   share: FloatArray, log: float, half: int) -> Prediction:
    """Return each of some points as all others predict it.

    Line and sample have their solutions, and which occur together in the c cells. Of these come the
    sums of squares (c,), what remains of each at least (c,), and the probabilities with all points
    (c,). `log` is the logarithm of the evidence with all points, `half` half the degrees of freedom
    without one.
    """
    count = line.left.shape[1]
    if count <= FEW:
        step = max(1, NUMBERS // len(share))
        return together([_of_few(line, sample, slice(start, start + step), square, least,
                                 share * square, log, half) for start in range(0, count, step)])
    figures = np.empty((count, 7))
    for start in range(0, count, AT_ONCE):
        width = min(AT_ONCE, count - start)
        if start == 0 or width < AT_ONCE:  # the last points may be fewer
            room = _Room(np.empty((4, len(line.left), width)),
                         np.empty((4, len(sample.left), width)), np.empty((len(share), width)),
                         np.empty(CELLS * width), np.empty(CELLS * width), np.empty((9, width)))
        _leave_out(line, sample, square, least, share * square, half, np.exp(LEAST / half), start,
                   room, figures)
    return Prediction(figures[:, :2], figures[:, 2], figures[:, 3], figures[:, 4:6],
                      log + figures[:, 6])


def _of_few(line: OfAxis, sample: OfAxis, some: slice, square: FloatArray, least: FloatArray,
            weight: FloatArray, log: float, half: int) -> Prediction:
    """Return what `_leave_out` finds, with the same arguments, of some points."""
    axes = [(1.0 / one.left[:, some], one.errors[:, some], one.cell) for one in (line, sample)]
    left, more = ((own * error**2).take(cell, axis=0) for own, error, cell in axes)
    left += more
    left /= square[:, None]
    np.minimum(left, (1.0 - least / square)[:, None], out=left)
    np.subtract(1.0, left, out=left)  # S' / S, (c, m)
    root = np.sqrt(axes[0][0]).take(line.cell, axis=0)
    # Into the same memory each time; `out` is only quick without a check of the numbers.
    root *= np.take(np.sqrt(axes[1][0]), sample.cell, axis=0, out=more, mode="clip")
    share = np.log(left)
    least_log = share.min(axis=0)
    share -= least_log  # of the largest power, lest powers overflow
    share *= -half
    np.exp(share, out=share)
    share *= root
    share *= weight[:, None]
    ones = np.ones(len(share))  # sums of columns by BLAS, in an eighth of the time
    total = ones @ share
    errors, spread = (np.stack([np.einsum(
        "cm,cm->m", share, np.take(one, cell, axis=0, out=more, mode="clip"))
        for one, cell in each], axis=1) / total[:, None] for each in (
        [(own * error, cell) for own, error, cell in axes],
        [(own, cell) for own, _, cell in axes]))
    share /= left
    return Prediction(errors, weight @ root / total * np.exp(half * least_log),
                      half * (ones @ share / total - 1.0), spread,
                      log - half * least_log + np.log(total))


def together(parts: Sequence[Prediction]) -> Prediction:
    """Return the predictions of several parts of the points as one."""
    if len(parts) == 1:
        return parts[0]
    return Prediction(*(np.concatenate([getattr(part, field.name) for part in parts])
                        for field in fields(Prediction)))


def mean_chance(strain: tuple[FloatArray, FloatArray], cell: tuple[IntArray, IntArray],
                scale: FloatArray, share: FloatArray, half: int) -> FloatArray:
    """Return the mean of (1 + scale (strain of line + strain of sample))^-half, shape (m,).

    Strains are (u, m) and (v, m), under the solutions of line and sample; the cells, (c,) each,
    tell which of these occur together. Of each such pair come a factor, `scale` (c,), and its
    probability, `share` (c,). `half` is half the degrees of freedom.
    """
    power = strain[0].take(cell[0], axis=0)
    power += strain[1].take(cell[1], axis=0)
    power *= scale[:, None]
    np.log1p(power, out=power)
    power *= -half
    return np.asarray(share @ np.exp(power, out=power))


@_compiled
def _raise(power: FloatArray, exponent: int, count: int, share: FloatArray) -> None:
    """Multiply by powers, two binary digits of the exponent at a time; `power` is overwritten."""
    while True:
        if exponent & 3 == 3:
            for i in range(count):
                share[i] *= power[i] * power[i] * power[i]
        elif exponent & 2:
            for i in range(count):
                share[i] *= power[i] * power[i]
        elif exponent & 1:
            for i in range(count):
                share[i] *= power[i]
        exponent >>= 2
        if exponent == 0:
            break
        for i in range(count):
            power[i] = (power[i] * power[i]) * (power[i] * power[i])


@_compiled
def _of_solutions(one: OfAxis, start: int, m: int, of_axis: FloatArray) -> None:
    """Fill in 1 / l, its root, e / l and e^2 / l of m points."""
    for u in range(len(one.left)):
        for p in range(m):
            inverse = 1.0 / one.left[u, start + p]
            error = one.errors[u, start + p]
            of_axis[0, u, p] = inverse
            of_axis[1, u, p] = np.sqrt(inverse)
            of_axis[2, u, p] = error * inverse
            of_axis[3, u, p] = error * inverse * error


@_compiled
def _leave_out(line: OfAxis, sample: OfAxis, square: FloatArray, least: FloatArray,
               weight: FloatArray, half: int, lowest: float, start: int, room: _Room,
               figures: FloatArray) -> None:
    """Fill rows of `figures`: two errors, chance, statistic, two variances, logarithm."""
    of_line, of_sample, grown, share, power, sums = room
    m = of_line.shape[2]
    _of_solutions(line, start, m, of_line)
    _of_solutions(sample, start, m, of_sample)
    # Sums over the cells: 0 the largest S / S' - 1, 1 what is left of the factor without its power,
    # 2 and 3 probability with S / S' - 1 and alone, 4 and 5 of line with e / l and 1 / l, 6 and 7
    # of sample. Row 8 is 1 over the largest S / S'.
    for i in range(8):
        for p in range(m):
            sums[i, p] = 0.0
    for c in range(len(weight)):
        u = line.cell[c]
        v = sample.cell[c]
        for p in range(m):
            less = of_line[3, u, p] + of_sample[3, v, p]
            # S' is the sum of squares of the others: not below what counts as no noise.
            less = less if less < square[c] - least[c] else square[c] - least[c]
            grown[c, p] = less / (square[c] - less)
            sums[0, p] = grown[c, p] if grown[c, p] > sums[0, p] else sums[0, p]
    for p in range(m):
        sums[8, p] = 1.0 / (1.0 + sums[0, p])
    for first in range(0, len(weight), CELLS):
        last = min(first + CELLS, len(weight))
        for c in range(first, last):
            u = line.cell[c]
            v = sample.cell[c]
            at = (c - first) * m
            for p in range(m):
                share[at + p] = weight[c] * of_line[1, u, p] * of_sample[1, v, p]
                sums[1, p] += share[at + p]
                part = (1.0 + grown[c, p]) * sums[8, p]  # of the largest, lest powers overflow
                power[at + p] = part if part > lowest else lowest
        _raise(power, half, (last - first) * m, share)  # of the cells at once
        for c in range(first, last):
            u = line.cell[c]
            v = sample.cell[c]
            at = (c - first) * m
            for p in range(m):
                one = share[at + p]
                sums[2, p] += one * grown[c, p]
                sums[3, p] += one
                sums[4, p] += one * of_line[2, u, p]
                sums[5, p] += one * of_line[0, u, p]
                sums[6, p] += one * of_sample[2, v, p]
                sums[7, p] += one * of_sample[0, v, p]
    for p in range(m):
        # Powers are relative to the largest, which only the logarithm gets back.
        logarithm = half * np.log1p(sums[0, p])
        total = sums[3, p]
        figures[start + p, 0] = sums[4, p] / total
        figures[start + p, 1] = sums[6, p] / total
        figures[start + p, 2] = sums[1, p] / total * np.exp(-logarithm)
        figures[start + p, 3] = half * sums[2, p] / total
        figures[start + p, 4] = sums[5, p] / total
        figures[start + p, 5] = sums[7, p] / total
        figures[start + p, 6] = logarithm + np.log(total)


def needs_compilation(points: int) -> bool:
    """Return True if so many points will first spend some seconds on compilation."""
    return points > FEW and not is_compiled(_leave_out)
