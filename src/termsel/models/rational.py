"""The rational function model."""

from __future__ import annotations

from functools import cached_property

from termsel.features import FloatArray
from termsel.models.polynomial import Exponents, monomial_name, monomials
from termsel.models.quotient import Blocks, RationalModel
from termsel.options import Option

# X, Y, Z stand for longitude, latitude and height, or whatever the ground coordinates are.
RPC00B: Exponents = (
    (0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 0, 1), (0, 1, 1), (2, 0, 0),
    (0, 2, 0), (0, 0, 2), (1, 1, 1), (3, 0, 0), (1, 2, 0), (1, 0, 2), (2, 1, 0), (0, 3, 0),
    (0, 1, 2), (2, 0, 1), (0, 2, 1), (0, 0, 3))
"""Exponents of X, Y, Z of the 20 monomials in RPC00B order."""

_TERMS_OF_ORDER = {1: 4, 2: 10, 3: 20}


class RationalFunctions(RationalModel):
    """Rational function model: line and sample as quotients of space polynomials.

    The denominators' constants are fixed to 1, so that order 3 with separate denominators
    has 78 terms. The equations are linearised by multiplication with the denominator, as is
    usual in terrain-dependent RFM.

    References
    ----------
    Akhoundi Khezrabad et al. 2020, eq. 1; order of monomials: RPC00B.
    """

    name = "rfm"
    declared_options = (
        Option("order", 3, "Order of the polynomials: 4, 10 or 20 monomials each.", int, 1, 3),
        Option("denominators", "separate",
               "Whether line and sample have a denominator each, one together, or none.",
               choices=("separate", "shared", "none")),
    )

    @cached_property
    def exponents(self) -> Exponents:
        """Exponents of the numerators' monomials."""
        return RPC00B[:_TERMS_OF_ORDER[self.options["order"]]]

    def blocks(self, ground: FloatArray) -> Blocks:
        """Return the monomials as numerators, and without the constant as denominators."""
        above = monomials(ground, self.exponents)
        below = above[:, 1:]
        kind = self.options["denominators"]
        return Blocks(
            line=above, sample=above,
            line_denominator=below if kind == "separate" else None,
            sample_denominator=below if kind == "separate" else None,
            shared_denominator=below if kind == "shared" else None)

    def column_names(self, block: str) -> tuple[str, ...]:
        """Return the monomials' names."""
        names = tuple(monomial_name(e) for e in self.exponents)
        return names if block in ("line", "sample") else names[1:]
