"""Monomials of ground coordinates, their names and their order in an RPC."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from termsel.data.arrays import FloatArray

KEPT_PLACES = 200
"""Most places whose monomials are kept for models to come."""

Exponent = tuple[int, int, int]
"""Powers of X, Y and Z in a monomial."""

Exponents = tuple[Exponent, ...]


def graded_exponents(degree: int, variables: int) -> Exponents:
    """Return the exponents of all monomials up to a total degree, of 2 variables, X and Y, or of 3.

    Lower degrees come first; within a degree X comes before Y before Z.

    Examples
    --------
    >>> [monomial_name(e) for e in graded_exponents(2, 2)]
    ['1', 'X', 'Y', 'X2', 'XY', 'Y2']
    """
    exponents: list[Exponent] = []
    for total in range(degree + 1):
        for i in range(total, -1, -1):
            for j in range(total - i, -1, -1):
                # Z has the degrees that X and Y leave; with two variables they must leave none.
                if variables == 3 or i + j == total:
                    exponents.append((i, j, total - i - j))
    return tuple(exponents)


def double_sum_exponents(degree: int) -> Exponents:
    """Return the exponents of all X^i Y^j with i and j up to a degree, (degree + 1)^2 of them.

    They are in the order of Valadan Zoej et al. 2002, eq. 6: by the higher of the two powers, then
    by the lower, and with the higher power of X first.

    Examples
    --------
    >>> [monomial_name(e) for e in double_sum_exponents(2)]
    ['1', 'X', 'Y', 'XY', 'X2', 'Y2', 'X2Y', 'XY2', 'X2Y2']
    """
    exponents: list[Exponent] = []
    for high in range(degree + 1):
        for low in range(high + 1):
            exponents.append((high, low, 0))
            if low < high:
                exponents.append((low, high, 0))
    return tuple(exponents)


def monomial_name(exponent: Exponent) -> str:
    """Return the name of a monomial, such as "X2Y"; "1" for the constant."""
    name = "".join(f"{letter}{power if power > 1 else ''}"
                   for letter, power in zip("XYZ", exponent, strict=True) if power)
    return name or "1"


def evaluate_monomials(ground: FloatArray, exponents: Exponents) -> FloatArray:
    """Return k monomials, by their exponents of X, Y, Z, at ground points (n, 3), shape (n, k).

    Callers must not write into the array: that of few places is kept, as many models are fitted to
    them.
    """
    if len(ground) > KEPT_PLACES:
        return _monomials(ground, exponents)
    return _cached_monomials(np.asarray(ground, dtype=np.float64).tobytes(), exponents)


@lru_cache(maxsize=64)  # each method asks for the terms of the same points
def _cached_monomials(ground: bytes, exponents: Exponents) -> FloatArray:
    """Return monomials of ground coordinates given as bytes, read-only as they are cached."""
    columns = _monomials(np.frombuffer(ground).reshape(-1, 3), exponents)
    columns.setflags(write=False)
    return columns


def _monomials(ground: FloatArray, exponents: Exponents) -> FloatArray:
    """Return X^i Y^j Z^k of ground (n, 3) for each triple of exponents, (n, terms)."""
    highest = max(max(e) for e in exponents)
    # powers[i] is ground^i, made by products: a power function is slower and rounds otherwise.
    powers = np.ones((highest + 1, *ground.shape))
    for i in range(1, highest + 1):
        powers[i] = powers[i - 1] * ground
    columns = np.ones((len(exponents), len(ground)))
    for column, exponent in zip(columns, exponents, strict=True):
        for variable, power in enumerate(exponent):
            if power:
                column *= powers[power, :, variable]
    return columns.T


# X, Y, Z stand for longitude, latitude and height, or whatever the ground coordinates are.
RPC00B: Exponents = (
    (0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 0, 1), (0, 1, 1), (2, 0, 0),
    (0, 2, 0), (0, 0, 2), (1, 1, 1), (3, 0, 0), (1, 2, 0), (1, 0, 2), (2, 1, 0), (0, 3, 0),
    (0, 1, 2), (2, 0, 1), (0, 2, 1), (0, 0, 3))
"""Exponents of X, Y, Z of the 20 monomials in RPC00B order."""
