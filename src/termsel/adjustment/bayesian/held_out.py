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

from termsel.adjustment.compiled import compile_lazily, is_compiled
from termsel.data.features import FloatArray, IntArray

MIN_POINTS = 5
"""Points from which on each may be predicted by the others: of fewer these leave no freedom."""

MIN_LOG_POWER = -300.0
"""Powers are not taken below this natural logarithm, lest numbers lose precision and time."""

HELD_OUT_POINTS_AT_ONCE, CELLS_AT_ONCE = 64, 8
"""Points and cells that are worked on together: what is read again stays in a cache."""

# Nothing is allocated. Sums may be taken in any order. `max` would be compiled on its own.
_compiled = partial(compile_lazily, _nrt=False, fastmath={"reassoc", "contract", "nsz", "nnan"})
_inlined = partial(_compiled, forceinline=True)


@dataclass(frozen=True, eq=False)
class HeldOutPredictions:
    """Each of m points as the other points predict it, averaged over the solutions that matter."""

    errors: FloatArray  # (m, 2): measured minus predicted, of line and sample
    probability: FloatArray  # (m,): of errors as large
    statistic: FloatArray  # (m,): mean square of the errors by their variances
    spread: FloatArray  # (m, 2): variance of the errors by that of the noise
    log_evidence: FloatArray  # (m,): logarithm of the evidence of the points that predict


def chance_of(statistic: FloatArray, freedom: int, pairs: int = 1) -> FloatArray:
    """Return the chance that F is larger than each statistic, in the shape of `statistic`.

    F has 2 `pairs` and `freedom` degrees of freedom. SciPy's function takes longer.
    """
    ratio = 2 * pairs * statistic / freedom
    term = total = np.exp(-freedom / 2 * np.log1p(ratio))
    for i in range(pairs - 1):  # the incomplete beta function of a whole number
        term = term * (freedom / 2 + i) / (i + 1) * ratio / (1 + ratio)
        total = total + term
    return np.asarray(total)


class AxisErrors(NamedTuple):
    """What the u solutions of one axis leave at n points, in weighted image units."""

    redundancies: FloatArray  # (u, n): 1 less the leverage of each point
    errors: FloatArray  # (u, n)
    solution_of_cell: IntArray  # (c,): which solution each cell of the posterior has


@dataclass(frozen=True, eq=False)
class WeightedCells:
    """The c cells of a posterior: pairs of a solution of line and one of sample."""

    square: FloatArray  # (c,): sum of squares S of line and sample
    min_square: FloatArray  # (c,): what remains of each at least without a point
    share: FloatArray  # (c,): probability with all points
    log_evidence: float  # logarithm of the evidence with all points


class _Workspace(NamedTuple):
    """What some points are worked on in, m at once."""

    line: FloatArray  # (4, u, m): 1 / l, its root, e / l and e^2 / l of line
    sample: FloatArray  # (4, v, m): of sample
    excess: FloatArray  # (c, m): S / S' - 1
    share: FloatArray  # (CELLS_AT_ONCE m,)
    power: FloatArray  # (CELLS_AT_ONCE m,)
    sums: FloatArray  # (9, m)


def leave_each_point_out(line: AxisErrors, sample: AxisErrors, cells: WeightedCells,
                         half: int) -> HeldOutPredictions:
    """Return what is predicted of each of n points by all other points, averaged over the cells.

    `line` and `sample` have the errors of the points under the solutions of their axis. A cell is
    one solution of each with a probability. `half` is half the degrees of freedom without a point.
    """
    count = line.redundancies.shape[1]
    # The factor of a cell, (l_line l_sample)^-1/2 (S / S')^h S, begins with S and its probability.
    weight = cells.share * cells.square
    figures = np.empty((count, 7))
    for start in range(0, count, HELD_OUT_POINTS_AT_ONCE):
        width = min(HELD_OUT_POINTS_AT_ONCE, count - start)
        if start == 0 or width < HELD_OUT_POINTS_AT_ONCE:  # the last points may be fewer
            workspace = _Workspace(
                line=np.empty((4, len(line.redundancies), width)),
                sample=np.empty((4, len(sample.redundancies), width)),
                excess=np.empty((len(weight), width)), share=np.empty(CELLS_AT_ONCE * width),
                power=np.empty(CELLS_AT_ONCE * width), sums=np.empty((9, width)))
        _fill_held_out_figures(line, sample, square=cells.square, min_square=cells.min_square,
                               weight=weight,
                               half=half, lowest=np.exp(MIN_LOG_POWER / half), start=start,
                               workspace=workspace, figures=figures)
    return HeldOutPredictions(figures[:, :2], figures[:, 2], figures[:, 3], figures[:, 4:6],
                              cells.log_evidence + figures[:, 6])


def concatenate_batches(batches: Sequence[HeldOutPredictions]) -> HeldOutPredictions:
    """Return the predictions of several batches of points as one."""
    if len(batches) == 1:
        return batches[0]
    return HeldOutPredictions(
        *(np.concatenate([getattr(batch, field.name) for batch in batches])
          for field in fields(HeldOutPredictions)))


def mean_probability(strain: tuple[FloatArray, FloatArray],
                     solution_of_cell: tuple[IntArray, IntArray], scale: FloatArray,
                     share: FloatArray, half: int) -> FloatArray:
    """Return the mean of (1 + scale (strain of line + strain of sample))^-half, shape (m,).

    Strains are (u, m) and (v, m), under the solutions of line and sample; the cells, (c,) each,
    show which of these occur together. Of each such pair come a factor, `scale` (c,), and its
    probability, `share` (c,). `half` is half the degrees of freedom.
    """
    power = strain[0].take(solution_of_cell[0], axis=0)
    power += strain[1].take(solution_of_cell[1], axis=0)
    power *= scale[:, None]
    np.log1p(power, out=power)
    power *= -half
    return np.asarray(share @ np.exp(power, out=power))


@_compiled
def _multiply_by_power(power: FloatArray, exponent: int, count: int, share: FloatArray) -> None:
    """Multiply the first `count` numbers of `share` by the power of those of `power`, in place.

    Each is multiplied by the number of the same index in `power`, to the whole `exponent` >= 0.
    `power` is overwritten.
    """
    # Two binary digits of the exponent at a time: x^e = x^(e mod 4) (x^4)^(e div 4).
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
def _fill_axis_figures(axis: AxisErrors, start: int, m: int, of_axis: FloatArray) -> None:
    """Fill `of_axis` (4, u, m) with 1 / l, its root, e / l and e^2 / l.

    l and e are the redundancies and errors of `axis` under its u solutions, of the m points from
    `start` on.
    """
    for u in range(len(axis.redundancies)):
        for p in range(m):
            inverse = 1.0 / axis.redundancies[u, start + p]
            error = axis.errors[u, start + p]
            of_axis[0, u, p] = inverse
            of_axis[1, u, p] = np.sqrt(inverse)
            of_axis[2, u, p] = error * inverse
            of_axis[3, u, p] = error * inverse * error


# Loops over a few rows each, as only these become instructions for several numbers at once.


@_inlined
def _fill_excess(line_square: FloatArray, sample_square: FloatArray, square: float,
                 min_square: float, excess: FloatArray, largest: FloatArray) -> None:
    """Fill `excess` (m,) with S / S' - 1 of a cell, and raise `largest` (m,), that of all cells.

    S is `square`, and S' without a point: less e^2 / l of line and sample (m,), but at least
    `min_square`.
    """
    most = square - min_square
    for p in range(len(excess)):
        removed = line_square[p] + sample_square[p]
        # S' is the sum of squares of the others: not below what counts as no noise.
        removed = removed if removed < most else most
        excess[p] = removed / (square - removed)
    for p in range(len(excess)):
        largest[p] = excess[p] if excess[p] > largest[p] else largest[p]


@_inlined
def _fill_share(line_root: FloatArray, sample_root: FloatArray, weight: float, share: FloatArray,
                total: FloatArray) -> None:
    """Fill `share` (m,) with the factor of a cell without its power, and add it to `total` (m,).

    That is `weight` of the cell, S and its probability, times l^-1/2 of line and sample (m,).
    """
    for p in range(len(share)):
        share[p] = weight * line_root[p] * sample_root[p]
        total[p] += share[p]


@_inlined
def _fill_power(excess: FloatArray, scale: FloatArray, lowest: float, power: FloatArray) -> None:
    """Fill `power` (m,) with S / S' of a cell by the largest, lest its powers overflow.

    `excess` (m,) is S / S' - 1, `scale` (m,) 1 over the largest S / S', and `lowest` the least
    quotient, below which powers underflow.
    """
    for p in range(len(power)):
        relative = (1.0 + excess[p]) * scale[p]
        power[p] = relative if relative > lowest else lowest


@_inlined
def _add_products(x: FloatArray, y: FloatArray, total: FloatArray) -> None:
    """Add x y to the total, lane by lane."""
    for p in range(len(total)):
        total[p] += x[p] * y[p]


@_compiled
def _fill_held_out_figures(line: AxisErrors, sample: AxisErrors, square: FloatArray,
                           min_square: FloatArray, weight: FloatArray, half: int, lowest: float,
                           start: int, workspace: _Workspace, figures: FloatArray) -> None:
    """Fill rows of `figures` (n, 7), of the points from `start` on for which `workspace` has room.

    A row has the errors of line and sample, the chance of larger ones, their mean square by their
    variances, the variances of line and sample by that of the noise, and the logarithm of the
    evidence of the other points by that of all. `square` and `min_square` (c,) are S of the cells
    and the least S', `weight` (c,) is S times the probability of a cell, `half` the power h of
    S / S', and `lowest` what the quotients of S / S' are raised to at least, lest they underflow.
    """
    of_line, of_sample, excess, share, power, sums = workspace
    m = of_line.shape[2]
    _fill_axis_figures(line, start, m, of_line)
    _fill_axis_figures(sample, start, m, of_sample)
    # Sums over the cells: 0 the largest S / S' - 1, 1 what is left of the factor without its power,
    # 2 and 3 probability with S / S' - 1 and alone, 4 and 5 of line with e / l and 1 / l, 6 and 7
    # of sample. Row 8 is 1 over the largest S / S'.
    for i in range(8):
        for p in range(m):
            sums[i, p] = 0.0
    for c in range(len(weight)):
        u = line.solution_of_cell[c]
        v = sample.solution_of_cell[c]
        _fill_excess(of_line[3, u], of_sample[3, v], square[c], min_square[c], excess[c], sums[0])
    for p in range(m):
        sums[8, p] = 1.0 / (1.0 + sums[0, p])
    for first in range(0, len(weight), CELLS_AT_ONCE):
        last = min(first + CELLS_AT_ONCE, len(weight))
        for c in range(first, last):
            of_cell = slice((c - first) * m, (c - first + 1) * m)
            _fill_share(of_line[1, line.solution_of_cell[c]],
                        of_sample[1, sample.solution_of_cell[c]], weight[c], share[of_cell],
                        sums[1])
            _fill_power(excess[c], sums[8], lowest, power[of_cell])
        _multiply_by_power(power, half, (last - first) * m, share)  # of the cells at once
        for c in range(first, last):
            u = line.solution_of_cell[c]
            v = sample.solution_of_cell[c]
            probability = share[(c - first) * m:(c - first + 1) * m]
            for p in range(m):
                sums[3, p] += probability[p]
            _add_products(probability, excess[c], sums[2])
            _add_products(probability, of_line[2, u], sums[4])
            _add_products(probability, of_line[0, u], sums[5])
            _add_products(probability, of_sample[2, v], sums[6])
            _add_products(probability, of_sample[0, v], sums[7])
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
    """Return whether this number of points will first spend some seconds on compilation."""
    return points >= MIN_POINTS and not is_compiled(_fill_held_out_figures)
