"""Polynomial models: line and sample as sums of monomials."""

from __future__ import annotations

from functools import cached_property
from typing import ClassVar

from termsel.core.options import Option
from termsel.data.monomials import Exponents, double_sum_exponents, graded_exponents
from termsel.models.quotient import MonomialModel


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
        # A model that also corrects by the control is more than its polynomial.
        return None if self.corrects else max(map(sum, self.exponents))


class Polynomial2D(Polynomial):
    """2-D polynomial: line and sample as polynomials of X and Y.

    References
    ----------
    Valadan Zoej et al. 2002, eqs. 1 and 2; Zakaryaie Nejad et al. 2015, eqs. 1 and 2. Both print
    double sums over all i, j up to n (`powers=each`). Zakaryaie Nejad et al. count 15 and 21 terms,
    those of total degree 4 and 5 (`powers=total`).

    Examples
    --------
    >>> import termsel
    >>> len(termsel.Polynomial2D(degree=3).terms)
    20
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
    """3-D polynomial: line and sample as polynomials of X, Y and Z.

    Examples
    --------
    >>> import termsel
    >>> len(termsel.Polynomial3D(degree=2).terms)
    20
    """

    name = "poly3d"
    declared_options = (
        Option("degree", 2, "Total degree; 2 gives 10 terms per axis, 3 gives 20.", int, 1, 5),)


class Affine(Polynomial):
    """3D affine model: line and sample linear in X, Y and Z, 8 terms.

    Examples
    --------
    >>> import termsel
    >>> termsel.Affine().terms[:4]
    ('line.num:1', 'line.num:X', 'line.num:Y', 'line.num:Z')
    """

    name = "affine"

    @cached_property
    def exponents(self) -> Exponents:
        """Exponents of 1, X, Y, Z."""
        return graded_exponents(1, 3)
