"""The rational function model."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from termsel.adjustment.equations import Equations
from termsel.core.options import Option
from termsel.data.features import FeatureSet, FloatArray
from termsel.data.monomials import RPC00B, Exponents
from termsel.models.quotient import MonomialModel
from termsel.models.terms import Term

_TERMS_OF_ORDER = {1: 4, 2: 10, 3: 20}


RIDGE = 0.01
"""Control lines hardly determine what numerators and denominators have in common, which then grows
to poles. With errors of 1 px in an image of 10 000 px this is a standard deviation of 0.002 for a
coefficient. Those of satellites are smaller. One of 0.3, as of a photograph, loses 0.0002 with
fifty equations. A DLT is determined by lines without it."""


class RationalFunctions(MonomialModel):
    """Rational function model: line and sample as quotients of 3-D polynomials.

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

    Examples
    --------
    >>> import termsel
    >>> model = termsel.RationalFunctions(order=3, denominators="separate")
    >>> len(model.terms)
    78
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
        Option("weighted", False, "Divide the equations by the denominators and iterate, to the "
               "least squares of distances in the image: each fit, and with control points each "
               "selection that a search judges by selection points.", bool),
    )

    @cached_property
    def exponents(self) -> Exponents:
        """Exponents of the numerators' monomials."""
        return RPC00B[:_TERMS_OF_ORDER[self.options["order"]]]

    @property
    def divides(self) -> str:
        """Whether line and sample have denominators, separate or shared."""
        return str(self.options["denominators"])

    @property
    def weighted(self) -> bool:
        """Whether adjustments are iterated, of points too."""
        return bool(self.options["weighted"]) and self.divides != "none"

    def equations(self, features: FeatureSet) -> Equations:
        """Return the equations of points and lines (see `RationalModel.equations`)."""
        return replace(super().equations(features), prior=self._prior(features))

    def linearised(self, features: FeatureSet, coefficients: FloatArray) -> Equations | None:
        """Return them about a solution (see `RationalModel.linearised`)."""
        equations = super().linearised(features, coefficients)
        return equations and replace(equations, prior=self._prior(features))

    def _prior(self, features: FeatureSet) -> FloatArray | None:
        """Return the weights that hold the terms of denominators near 0; None without any."""
        ridge = self.options["ridge"]
        if ridge is None:
            # A DLT has so few denominators that lines determine them.
            is_dlt = self.options["order"] == 1 and self.exact_for_lines
            ridge = RIDGE if len(features.lines) and not is_dlt else 0.0
        # Pseudo-observations sqrt(ridge) c = 0 add `ridge` to the diagonal of the normal equations.
        below = np.array([Term.parse(name).is_denominator for name in self.terms])
        return np.sqrt(ridge) * below if ridge and below.any() else None
