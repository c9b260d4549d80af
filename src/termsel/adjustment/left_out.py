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

import numpy as np

from termsel.adjustment.compiled import compiled
from termsel.measurements.features import FloatArray, IntArray

LEAST = -300.0
"""Powers are not taken below this natural logarithm, lest numbers lose precision and time."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """Each of m points as others predict it, averaged over the solutions that matter.

    Parameters
    ----------
    errors : ndarray, shape (m, 2)
        Measured minus predicted, of line and sample.
    chance : ndarray, shape (m,)
        Of errors as large.
    statistic : ndarray, shape (m,)
        Mean square of the errors by their variances.
    spread : ndarray, shape (m, 2)
        Variance of the errors by that of the noise.
    log : ndarray, shape (m,)
        Logarithm of the evidence of the points that predict.
    """

    errors: FloatArray
    chance: FloatArray
    statistic: FloatArray
    spread: FloatArray
    log: FloatArray


def chance_of(statistic: FloatArray, freedom: int) -> FloatArray:
    """Return the chance of a larger F with 2 and `freedom` degrees: scipy's takes far longer."""
    return np.asarray(np.exp(-freedom / 2 * np.log1p(2 * statistic / freedom)))


def leave_each_out(left: tuple[FloatArray, FloatArray], errors: tuple[FloatArray, FloatArray],
                   cell: tuple[IntArray, IntArray], square: FloatArray, least: FloatArray,
                   share: FloatArray, log: float, half: int) -> Prediction:
    """Return each point as all others predict it.

    Parameters
    ----------
    left, errors : tuple of ndarray, shape (n, u) and (n, v)
        1 less the leverage of each point, and its error, under the solutions of line and sample.
    cell : tuple of ndarray of int, shape (c,)
        Which solutions of line and of sample occur together.
    square, least : ndarray, shape (c,)
        Sums of squares, and what remains of each at least.
    share : ndarray, shape (c,)
        Probabilities with all points.
    log : float
        Logarithm of the evidence with all points.
    half : int
        Half the degrees of freedom without a point.
    """
    found = np.empty((len(left[0]), 7))
    _leave_out(*left, *errors, *cell, square, least, share * square, half, np.exp(LEAST / half),
               np.empty((3, len(left[0][0]))), np.empty((3, len(left[1][0]))),
               np.empty((3, len(share))), found)
    return Prediction(found[:, :2], found[:, 2], found[:, 3], found[:, 4:6], log + found[:, 6])


@partial(compiled, _nrt=False, fastmath={"reassoc", "contract", "nsz", "nnan"})
def _leave_out(line_left: FloatArray, sample_left: FloatArray, line_errors: FloatArray,
               sample_errors: FloatArray, line: IntArray, sample: IntArray, square: FloatArray,
               least: FloatArray, weight: FloatArray, half: int, lowest: float, of_line: FloatArray,
               of_sample: FloatArray, space: FloatArray, found: FloatArray) -> None:
    """Fill the rows of `found`: two errors, chance, statistic, two variances, logarithm."""
    count = len(line)
    for point in range(len(found)):
        for u in range(of_line.shape[1]):
            of_line[0, u] = line_errors[point, u] / line_left[point, u]
            of_line[1, u] = 1.0 / line_left[point, u]
            of_line[2, u] = np.sqrt(of_line[1, u])
        for u in range(of_sample.shape[1]):
            of_sample[0, u] = sample_errors[point, u] / sample_left[point, u]
            of_sample[1, u] = 1.0 / sample_left[point, u]
            of_sample[2, u] = np.sqrt(of_sample[1, u])
        highest = 0.0
        for c in range(count):
            one, other = line[c], sample[c]
            rest = square[c] - of_line[0, one] * line_errors[point, one] \
                - of_sample[0, other] * sample_errors[point, other]
            space[0, c] = square[c] / max(rest, least[c])
            highest = max(highest, space[0, c])
        plain = 0.0
        for c in range(count):
            space[2, c] = weight[c] * of_line[2, line[c]] * of_sample[2, sample[c]]
            plain += space[2, c]
            space[1, c] = max(space[0, c] / highest, lowest)
        left = half
        while True:
            if left & 1:
                for c in range(count):
                    space[2, c] *= space[1, c]
            left >>= 1
            if left == 0:
                break
            for c in range(count):
                space[1, c] *= space[1, c]
        total, statistic = 0.0, 0.0
        first, second, third, fourth = 0.0, 0.0, 0.0, 0.0
        for c in range(count):
            w = space[2, c]
            total += w
            statistic += w * (space[0, c] - 1.0)
            first += w * of_line[0, line[c]]
            second += w * of_sample[0, sample[c]]
            third += w * of_line[1, line[c]]
            fourth += w * of_sample[1, sample[c]]
        power = half * np.log(highest)
        found[point, 0] = first / total
        found[point, 1] = second / total
        found[point, 2] = plain / total * np.exp(-power)
        found[point, 3] = half * statistic / total
        found[point, 4] = third / total
        found[point, 5] = fourth / total
        found[point, 6] = power + np.log(total)
