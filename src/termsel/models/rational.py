"""The rational function model."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from termsel.adjustment.equations import Equations
from termsel.adjustment.monomials import RPC00B, Exponents, monomial_name, monomials
from termsel.measurements.features import FeatureSet, FloatArray
from termsel.models.quotient import Blocks, RationalModel
from termsel.models.terms import Term
from termsel.options import Option

_TERMS_OF_ORDER = {1: 4, 2: 10, 3: 20}


RIDGE = 0.01
"""Control lines hardly determine what numerators and denominators have in common, which then grows
to poles. With errors of 1 px in an image of 10 000 px this is a standard deviation of 0.002 for a
coefficient. Those of satellites are smaller. One of 0.3, as of a photograph, loses 0.0002 with
fifty equations. A DLT is determined by lines without it."""


class RationalFunctions(RationalModel):
    """Rational function model: line and sample as quotients of space polynomials.

    The denominators' constants are fixed to 1, so that order 3 with separate denominators
    has 78 terms. The equations are linearised by multiplication with the denominator, as is
    usual in terrain-dependent RFM.

    Regularisation is that of Tao and Hu 2001: a constant on the diagonal of the normal equations.
    It applies to denominators alone. Numerators of satellite images have large coefficients, which
    it would bias. Its default is termsel's own.

    References
    ----------
    Akhoundi Khezrabad et al. 2020, eq. 1; order of monomials: RPC00B. Tao and Hu 2001,
    PE&RS 67(12), for regularisation.
    """

    name = "rfm"
    declared_options = (
        Option("order", 3, "Order of the polynomials: 4, 10 or 20 monomials each.", int, 1, 3),
        Option("denominators", "separate",
               "Whether line and sample have separate denominators, share one, or have none.",
               choices=("separate", "shared", "none")),
        Option("ridge", None, "Weight of pseudo-observations that the coefficients of denominators "
               f"are zero, in scaled coordinates; 0 for none. By default {RIDGE} with control "
               "lines, but none for a DLT (order 1, shared) or for points alone.",
               float, 0.0, 1e6),
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

    def equations(self, features: FeatureSet) -> Equations:
        """Return the equations of points and lines (see `RationalModel.equations`)."""
        return replace(super().equations(features), prior=self._prior(features))

    def linearised(self, features: FeatureSet, coefficients: FloatArray) -> Equations | None:
        """Return them about a solution (see `RationalModel.linearised`)."""
        equations = super().linearised(features, coefficients)
        return equations and replace(equations, prior=self._prior(features))

    def _prior(self, features: FeatureSet) -> FloatArray | None:
        ridge = self.options["ridge"]
        if ridge is None:
            is_dlt = self.options["order"] == 1 and self.exact_for_lines
            ridge = RIDGE if len(features.lines) and not is_dlt else 0.0
        below = np.array([Term.parse(name).is_denominator for name in self.terms])
        return np.sqrt(ridge) * below if ridge and below.any() else None

    def column_names(self, block: str) -> tuple[str, ...]:
        """Return the monomials' names."""
        names = tuple(monomial_name(e) for e in self.exponents)
        return names if block in ("line", "sample") else names[1:]
