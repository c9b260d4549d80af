"""Each point as the others predict it, averaged over the solutions that matter.

Without a point the sum of squares S of a solution becomes S - e^2 / l of both axes, with its error
e and 1 less its leverage l, and its evidence changes by the factor

    (l_line l_sample)^-1/2 (S / S')^h S,   S' = S - e^2 / l,   2 h = degrees of freedom without it.

Equations are two for each point and terms two for each monomial, so that h is a whole number: the
power takes some multiplications, and no logarithm. The chance of a larger F than the point's, with
2 and 2 h degrees of freedom, is (S' / S)^h, the same power once more.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from termsel.adjustment.compiled import compiled
from termsel.measurements.features import FloatArray, IntArray
from termsel.priors.shrinkage import Side

LEAST = -300.0
"""Powers are not taken below this natural logarithm, lest numbers lose precision and time."""

AT_ONCE, CELLS = 64, 8
"""Points and cells that are worked on together: what is read again stays in a cache."""

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


def chance_of(statistic: FloatArray, freedom: int) -> FloatArray:
    """Return the chance of a larger F with 2 and `freedom` degrees: scipy's takes far longer."""
    return np.asarray(np.exp(-freedom / 2 * np.log1p(2 * statistic / freedom)))


class _OfAxis(NamedTuple):
    """The u solutions of one axis, for n points."""

    left: FloatArray  # (u, n): 1 less the leverage of each point
    errors: FloatArray  # (u, n)
    cell: IntArray  # (c,): which solution each cell of the posterior has


class _Room(NamedTuple):
    """What some points are worked on in, m at once."""

    line: FloatArray  # (4, u, m): 1 / l, its root, e / l and e^2 / l of line
    sample: FloatArray  # (4, v, m): of sample; not the first two where leverages are those of line
    grown: FloatArray  # (c, m): S / S' - 1
    share: FloatArray  # (CELLS m,)
    power: FloatArray  # (CELLS m,)
    sums: FloatArray  # (10, m)


def leave_each_out(sides: tuple[Side, Side], square: FloatArray, least: FloatArray,
                   share: FloatArray, log: float, half: int, count: int) -> Prediction:
    """Return each of the first `count` points as all others predict it.

    The sides are the solutions of line and of sample, and which occur together in the c cells. Of
    these come the sums of squares (c,), what remains of each at least (c,), and the probabilities
    with all points (c,). `log` is the logarithm of the evidence with all points, `half` half the
    degrees of freedom without one.
    """
    line, sample = (_OfAxis(side.left, side.errors, side.cell) for side in sides)
    figures, alike = np.empty((count, 7)), line.left is sample.left
    for start in range(0, count, AT_ONCE):
        width = min(AT_ONCE, count - start)
        if start == 0 or width < AT_ONCE:  # the last points may be fewer
            room = _Room(np.empty((4, len(line.left), width)),
                         np.empty((4, len(sample.left), width)), np.empty((len(share), width)),
                         np.zeros(CELLS * width), np.zeros(CELLS * width), np.empty((10, width)))
        _leave_out(line, sample, square, least, share * square, half, np.exp(LEAST / half), alike,
                   start, room, figures)
    return Prediction(figures[:, :2], figures[:, 2], figures[:, 3], figures[:, 4:6],
                      log + figures[:, 6])


def mean_chance(strain: tuple[FloatArray, FloatArray], cell: tuple[IntArray, IntArray],
                scale: FloatArray, share: FloatArray, half: int) -> FloatArray:
    """Return the mean of (1 + scale (strain of line + strain of sample))^-half, shape (m,).

    Strains are (u, m) and (v, m), under the solutions of line and sample; the cells, (c,) each,
    tell which of these occur together. Of each such pair come a factor, `scale` (c,), and its
    probability, `share` (c,). `half` is half the degrees of freedom.
    """
    m = strain[0].shape[1]
    total = np.zeros(m)
    _mean_chance(*strain, *cell, scale, share, half, np.exp(LEAST / half), np.empty(m), np.empty(m),
                 total)
    return total


@_compiled
def _invert(left: FloatArray, inverse: FloatArray, root: FloatArray) -> None:
    for p in range(len(left)):
        inverse[p] = 1.0 / left[p]
        root[p] = np.sqrt(inverse[p])


@_compiled
def _divide(errors: FloatArray, inverse: FloatArray, ratio: FloatArray, part: FloatArray) -> None:
    """Fill in e / l and e^2 / l."""
    for p in range(len(errors)):
        ratio[p] = errors[p] * inverse[p]
        part[p] = ratio[p] * errors[p]


@_compiled
def _grow(line: FloatArray, sample: FloatArray, square: float, least: float, grown: FloatArray,
          highest: FloatArray) -> None:
    """Fill in S / S' - 1."""
    for p in range(len(grown)):
        less = line[p] + sample[p]
        # S' is the sum of squares of the others: not below what counts as no noise.
        less = less if less < square - least else square - least
        grown[p] = less / (square - less)
        highest[p] = grown[p] if grown[p] > highest[p] else highest[p]


@_compiled
def _weigh(line: FloatArray, sample: FloatArray, weight: float, grown: FloatArray,
           inverse: FloatArray, lowest: float, share: FloatArray, power: FloatArray,
           plain: FloatArray) -> None:
    """Fill in probabilities but for a power, and that of which it is one."""
    for p in range(len(share)):
        share[p] = weight * line[p] * sample[p]
        plain[p] += share[p]
        part = (1.0 + grown[p]) * inverse[p]  # of the largest, so that no power overflows
        power[p] = part if part > lowest else lowest


@_compiled
def _raise(power: FloatArray, exponent: int, share: FloatArray) -> None:
    """Multiply by powers, two binary digits of the exponent at a time; `power` is overwritten."""
    while True:
        if exponent & 3 == 3:
            for i in range(len(share)):
                share[i] *= power[i] * power[i] * power[i]
        elif exponent & 2:
            for i in range(len(share)):
                share[i] *= power[i] * power[i]
        elif exponent & 1:
            for i in range(len(share)):
                share[i] *= power[i]
        exponent >>= 2
        if exponent == 0:
            break
        for i in range(len(share)):
            power[i] = (power[i] * power[i]) * (power[i] * power[i])


@_compiled
def _add(share: FloatArray, one: FloatArray, other: FloatArray, sums: FloatArray,
         sums_of_other: FloatArray) -> None:
    for p in range(len(share)):
        sums[p] += share[p] * one[p]
        sums_of_other[p] += share[p] * other[p]


@_compiled
def _leave_out(line: _OfAxis, sample: _OfAxis, square: FloatArray, least: FloatArray,
               weight: FloatArray, half: int, lowest: float, alike: bool, start: int, room: _Room,
               figures: FloatArray) -> None:
    """Fill rows of `figures`: two errors, chance, statistic, two variances, logarithm."""
    of_line, of_sample, sums = room.line, room.sample, room.sums
    m, ones = of_line.shape[2], sums[9]
    inverses = of_line if alike else of_sample
    for u in range(len(line.left)):
        _invert(line.left[u, start:start + m], of_line[0, u], of_line[1, u])
        _divide(line.errors[u, start:start + m], of_line[0, u], of_line[2, u], of_line[3, u])
    for u in range(len(sample.left)):
        if not alike:
            _invert(sample.left[u, start:start + m], of_sample[0, u], of_sample[1, u])
        _divide(sample.errors[u, start:start + m], inverses[0, u], of_sample[2, u],
                of_sample[3, u])
    # Sums over the cells: 0 the largest S / S' - 1, 1 what is left of the factor without its power,
    # 2 and 3 probability with S / S' - 1 and alone, 4 and 5 of line with e / l and 1 / l, 6 and 7
    # of sample. Row 8 is 1 over the largest S / S', row 9 ones.
    sums[:9] = 0.0
    ones[:] = 1.0
    for c in range(len(weight)):
        _grow(of_line[3, line.cell[c]], of_sample[3, sample.cell[c]], square[c], least[c],
              room.grown[c], sums[0])
    for p in range(m):
        sums[8, p] = 1.0 / (1.0 + sums[0, p])
    for first in range(0, len(weight), CELLS):
        last = min(first + CELLS, len(weight))
        for c in range(first, last):
            some = slice((c - first) * m, (c - first + 1) * m)
            _weigh(of_line[1, line.cell[c]], inverses[1, sample.cell[c]], weight[c], room.grown[c],
                   sums[8], lowest, room.share[some], room.power[some], sums[1])
        # Of the cells at once: the places of others in the last round are not read.
        _raise(room.power, half, room.share)
        for c in range(first, last):
            one = room.share[(c - first) * m:(c - first + 1) * m]
            _add(one, room.grown[c], ones, sums[2], sums[3])
            _add(one, of_line[2, line.cell[c]], of_line[0, line.cell[c]], sums[4], sums[5])
            _add(one, of_sample[2, sample.cell[c]], inverses[0, sample.cell[c]], sums[6], sums[7])
    for p in range(m):
        # Powers are relative to the largest, which only the logarithm gets back.
        logarithm, total = half * np.log1p(sums[0, p]), sums[3, p]
        figures[start + p, 0] = sums[4, p] / total
        figures[start + p, 1] = sums[6, p] / total
        figures[start + p, 2] = sums[1, p] / total * np.exp(-logarithm)
        figures[start + p, 3] = half * sums[2, p] / total
        figures[start + p, 4] = sums[5, p] / total
        figures[start + p, 5] = sums[7, p] / total
        figures[start + p, 6] = logarithm + np.log(total)


@_compiled
def _mean_chance(line_strain: FloatArray, sample_strain: FloatArray, line: IntArray,
                 sample: IntArray, scale: FloatArray, weight: FloatArray, half: int,
                 lowest: float, share: FloatArray, power: FloatArray, total: FloatArray) -> None:
    """Add to `total`."""
    m = len(total)
    for c in range(len(weight)):
        one, other = line[c], sample[c]
        for p in range(m):
            share[p] = weight[c]
            strain = line_strain[one, p] + sample_strain[other, p]
            part = 1.0 / (1.0 + scale[c] * strain)
            power[p] = part if part > lowest else lowest
        _raise(power, half, share)
        for p in range(m):
            total[p] += share[p]
