"""Polynomial models: line and sample as sums of monomials."""

from __future__ import annotations

from functools import cached_property
from typing import ClassVar

from termsel.adjustment.monomials import (
    Exponents,
    double_sum_exponents,
    graded_exponents,
    monomial_name,
    monomials,
)
from termsel.measurements.features import FloatArray
from termsel.models.quotient import Blocks, MonomialModel, RationalModel
from termsel.options import Option


class Polynomial(MonomialModel):
    """A polynomial with all monomials up to a degree, the same for both axes."""

    variables: ClassVar[int] = 3
    """Ground coordinates that it is a polynomial of: X, Y and, if 3, Z."""

    @cached_property
    def exponents(self) -> Exponents:
        """Exponents of X, Y, Z of each column."""
        return graded_exponents(int(self.options["degree"]), self.variables)

    @property
    def polynomial_degree(self) -> int | None:
        """Greatest total power; None for a model that goes on from a polynomial."""
        return None if self.corrects else max(map(sum, self.exponents))


class Polynomial2D(Polynomial):
    """Plane polynomial: line and sample as polynomials of X and Y.

    References
    ----------
    Valadan Zoej et al. 2002, eqs. 1 and 2; Zakaryaie Nejad et al. 2015, eqs. 1 and 2. Both print
    double sums over all i, j up to n (`powers=each`). Zakaryaie Nejad et al. count 15 and 21 terms,
    those of total degree 4 and 5 (`powers=total`).
    """

    name = "poly2d"
    variables = 2
    uses_height = False
    declared_options: ClassVar[tuple[Option, ...]] = (
        Option("degree", 4, "Degree; a total degree of 4 gives 15 terms per axis, 5 gives 21.",
               int, 1, 8),
        Option("powers", "total", "Whether the degree limits the powers of X and Y together, or "
               "each of them, as in the papers' double sums; then 3 gives 16 terms per axis.",
               choices=("total", "each")))

    @cached_property
    def exponents(self) -> Exponents:
        """Exponents of X, Y, Z of each column."""
        if self.options.get("powers") == "each":
            return double_sum_exponents(int(self.options["degree"]))
        return super().exponents


class Polynomial3D(Polynomial):
    """Space polynomial: line and sample as polynomials of X, Y and Z."""

    name = "poly3d"
    declared_options = (
        Option("degree", 2, "Total degree; 2 gives 10 terms per axis, 3 gives 20.", int, 1, 5),)


class Affine(Polynomial):
    """3D affine model: line and sample linear in X, Y and Z, 8 terms."""

    name = "affine"

    @cached_property
    def exponents(self) -> Exponents:
        """Exponents of 1, X, Y, Z."""
        return graded_exponents(1, 3)


class PolynomialByAxis(RationalModel):
    """A polynomial with a highest power of each coordinate, for line and for sample."""

    coordinates: ClassVar[str] = "xyz"

    @cached_property
    def exponents(self) -> tuple[Exponents, Exponents]:
        """Exponents of X, Y, Z of each column, of line and of sample."""
        everything = graded_exponents(int(self.options["degree"]), len(self.coordinates))
        line, sample = (tuple(e for e in everything if all(
            power <= self.options[f"{axis}_{coordinate}"]
            for coordinate, power in zip(self.coordinates, e, strict=False)))
            for axis in ("line", "sample"))
        return line, sample

    @property
    def polynomial_degree(self) -> int | None:
        """Total degree."""
        return max(sum(e) for exponents in self.exponents for e in exponents)

    def blocks(self, ground: FloatArray) -> Blocks:
        """Return the monomials of each axis."""
        line, sample = self.exponents
        return Blocks(line=monomials(ground, line), sample=monomials(ground, sample))

    def column_names(self, block: str) -> tuple[str, ...]:
        """Return the monomials' names."""
        return tuple(monomial_name(e) for e in self.exponents[block == "sample"])


def _powers(coordinates: str, most: int) -> tuple[Option, ...]:
    return (Option("degree", most, "Highest total degree.", int, 1, most),
            *(Option(f"{axis}_{coordinate}", 2, f"Highest power of {coordinate.upper()} in the "
                     f"polynomial of {axis}.", int, 0, most)
              for axis in ("line", "sample") for coordinate in coordinates))


class Polynomial2DByAxis(PolynomialByAxis):
    """Plane polynomial with a degree of its own for line and sample, in X and in Y."""

    name = "poly2d-by-axis"
    coordinates = "xy"
    uses_height = False
    declared_options = _powers("xy", 5)


class Polynomial3DByAxis(PolynomialByAxis):
    """Space polynomial with a degree of its own for line and sample, in X, in Y and in Z."""

    name = "poly3d-by-axis"
    declared_options = _powers("xyz", 4)
