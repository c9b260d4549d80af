"""Rational functions in a basis of orthogonal polynomials."""

from __future__ import annotations

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray

from termsel import Blocks, RationalFunctions

FloatArray = NDArray[np.float64]


class RationalLegendre(RationalFunctions):
    """Rational function model of Legendre polynomials: products of those of X, Y and Z.

    The term X2Y stands for P2(X) P1(Y). Scaled coordinates of the control lie between -1 and 1,
    where Legendre polynomials are orthogonal: columns of many well-distributed points hardly
    correlate. All terms together are the same functions as those of `rfm`, as is any selection with
    a hierarchy. Others are not, and depend on the interval.

    References
    ----------
    Abramowitz and Stegun 1964, Handbook of Mathematical Functions, chapter 22. Their use here is
    termsel's own.
    """

    name = "rfm-legendre"

    def blocks(self, ground: FloatArray) -> Blocks:
        """Return the columns of line and sample at scaled places (n, 3).

        Numerators are the products of Legendre polynomials. Denominators are the same without the
        constant: one for each axis or one for both, as `divides` has it, or none.
        """
        # P_0 to P_n of each coordinate at all points.
        values_by_coordinate = legvander(ground.T, max(max(powers) for powers in self.exponents))
        products = []
        for powers in self.exponents:
            factors = [values_by_coordinate[variable, :, power]
                       for variable, power in enumerate(powers)]
            products.append(np.prod(factors, axis=0))
        above = np.stack(products, axis=1)
        separate, shared = (above[:, 1:] if self.divides == kind else None
                            for kind in ("separate", "shared"))
        return Blocks(above, above, separate, separate, shared)
