"""What is rounding of a computation, so that no choice is made by it.

Residuals of points that a model fits exactly are rounding, and other processors round otherwise. A
choice by them would differ from machine to machine, and add terms without any meaning.
"""

from __future__ import annotations

import numpy as np

from termsel.data.features import FloatArray, IntArray

ROUNDING = 1e-9
"""Share of the size of data below which errors are rounding.

Double precision has 2e-16, columns that nearly depend on each other lose six digits of it, and
files hold hardly more digits than this. Of an image of 10,000 px it is 5e-6 px.
"""


def by_size(figures: FloatArray, floor: FloatArray | float, share: FloatArray) -> FloatArray:
    """Return figures of selections, in which those that are rounding are by the size alone.

    Figures up to `floor` become that times the selection's share of what may be selected, 0 to 1:
    they stay below all others, and the smaller selection is the better one.
    """
    return np.asarray(np.where(figures <= floor, floor * share, figures))


def largest(values: FloatArray) -> IntArray:
    """Return the index of the largest value of each row, of those equal but for rounding the first.

    Values are not negative, or mark by a negative number what cannot be taken.
    """
    maxima = values.max(axis=-1, keepdims=True)
    return np.asarray((values >= maxima - ROUNDING * np.abs(maxima)).argmax(axis=-1))


_SIGNIFICANT_BITS = 30
"""Binary digits of a figure that searches compare: 30 are a relative difference of 1e-9."""


def significant(figures: FloatArray | float) -> FloatArray:
    """Return figures to nine significant digits, so that processors agree which are equal.

    A figure is m 2^e with 0.5 <= m < 1; m is rounded to 30 binary digits. Selections whose figures
    differ by the rounding of their computation alone then compare as equal, and a search takes the
    first of them on every processor.

    Examples
    --------
    >>> 0.1 + 0.2 == 0.3, significant(0.1 + 0.2) == significant(0.3)
    (False, True)
    """
    mantissa, exponent = np.frexp(figures)
    scale = 2.0 ** _SIGNIFICANT_BITS
    return np.asarray(np.ldexp(np.rint(mantissa * scale) / scale, exponent))
