"""Monomials, and the polynomial models made of them."""

from __future__ import annotations

from functools import cached_property
from typing import ClassVar

import numpy as np

from termsel.features import FloatArray
from termsel.models.quotient import Blocks, RationalModel
from termsel.options import Option

Exponents = tuple[tuple[int, int, int], ...]


def graded_exponents(degree: int, variables: int) -> Exponents:
    """Return the exponents of all monomials up to a total degree.

    Lower degrees come first; within a degree X comes before Y before Z.

    Parameters
    ----------
    degree : int
    variables : {2, 3}
        2 for X and Y, 3 for X, Y and Z.

    Examples
    --------
    >>> [monomial_name(e) for e in graded_exponents(2, 2)]
    ['1', 'X', 'Y', 'X2', 'XY', 'Y2']
    """
    return tuple(
        (i, j, total - i - j)
        for total in range(degree + 1)
        for i in range(total, -1, -1)
        for j in range(total - i, -1, -1)
        if variables == 3 or i + j == total)


def monomial_name(exponent: tuple[int, int, int]) -> str:
    """Return the name of a monomial, such as "X2Y"; "1" for the constant."""
    name = "".join(f"{letter}{power if power > 1 else ''}"
                   for letter, power in zip("XYZ", exponent, strict=True) if power)
    return name or "1"


def monomials(ground: FloatArray, exponents: Exponents) -> FloatArray:
    """Return the monomials at ground points.

    Parameters
    ----------
    ground : ndarray, shape (n, 3)
    exponents : k exponents of X, Y, Z

    Returns
    -------
    ndarray, shape (n, k)
    """
    highest = max(max(e) for e in exponents)
    powers = np.ones((highest + 1, *ground.shape))
    for i in range(1, highest + 1):
        powers[i] = powers[i - 1] * ground
    columns = np.ones((len(exponents), len(ground)))
    for column, exponent in zip(columns, exponents, strict=True):
        for variable, power in enumerate(exponent):
            if power:
                column *= powers[power, :, variable]
    return columns.T


class Polynomial(RationalModel):
    """A polynomial with all monomials up to a total degree, the same for both axes."""

    variables: ClassVar[int] = 3

    @cached_property
    def exponents(self) -> Exponents:
        """Exponents of X, Y, Z of each column."""
        return graded_exponents(int(self.options["degree"]), self.variables)

    def blocks(self, ground: FloatArray) -> Blocks:
        """Return the monomials for both axes."""
        columns = monomials(ground, self.exponents)
        return Blocks(line=columns, sample=columns)

    def column_names(self, block: str) -> tuple[str, ...]:
        """Return the monomials' names."""
        return tuple(monomial_name(e) for e in self.exponents)


class Polynomial2D(Polynomial):
    """Plane polynomial: line and sample as polynomials of X and Y.

    References
    ----------
    Valadan Zoej et al. 2002, eqs. 1 and 2; Zakaryaie Nejad et al. 2015, eqs. 1 and 2. Their
    double sums run over all i, j up to n; their 15 and 21 terms are those of total degree
    4 and 5, which is what `degree` counts here.
    """

    name = "poly2d"
    variables = 2
    uses_height = False
    declared_options: ClassVar[tuple[Option, ...]] = (
        Option("degree", 4, "Total degree; 4 gives 15 terms an axis, 5 gives 21.", int, 1, 8),)


class Polynomial3D(Polynomial):
    """Space polynomial: line and sample as polynomials of X, Y and Z."""

    name = "poly3d"
    declared_options = (
        Option("degree", 2, "Total degree; 2 gives 10 terms an axis, 3 gives 20.", int, 1, 5),)


class Affine(Polynomial):
    """3D affine model: line and sample linear in X, Y and Z, 8 terms."""

    name = "affine"

    @cached_property
    def exponents(self) -> Exponents:
        """Exponents of 1, X, Y, Z."""
        return graded_exponents(1, 3)
