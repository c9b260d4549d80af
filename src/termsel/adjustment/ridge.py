"""Penalised least squares along the singular values of a design matrix."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from termsel.adjustment.solve import TOLERANCE
from termsel.data.features import FloatArray

EQUAL_FIGURES = 1e-6
"""Figures that differ relatively by less than this are taken as equal."""


@dataclass(frozen=True, eq=False)
class Spectrum:
    """A regression in terms of its singular values."""

    values: FloatArray  # (p,): singular values that are not rounding error, from the largest
    # (p,): length of the target, over all its right-hand sides, along each left singular vector.
    inner: FloatArray
    outside: float  # square of the target's part that no column reaches
    freedom: int  # rows less unpenalised columns

    def penalties(self, smallest: float) -> FloatArray:
        """Return penalties from the largest singular value down to `smallest` of it."""
        return np.asarray(self.values[0] * np.geomspace(1.0, smallest, 401))

    def _residual_share(self, penalty: FloatArray) -> FloatArray:
        """Return 1 - s^2 / (s^2 + penalty^2), shape (n, p)."""
        square = penalty[:, None] ** 2
        return np.asarray(square / (self.values**2 + square))

    def gcv(self, penalty: FloatArray) -> FloatArray:
        """Return the generalised cross-validation, up to a factor (Golub et al. 1979, eq. 1.4).

        For penalties of shape (n,).
        """
        residual_share = self._residual_share(penalty)
        square = ((residual_share * self.inner) ** 2).sum(axis=1) + self.outside
        freedom = residual_share.sum(axis=1) + (self.freedom - len(self.values))
        return np.asarray(square / freedom**2)

    def curvature(self, penalty: FloatArray) -> FloatArray:
        """Return the curvature of the L-curve, (log |residuals|, log |x|).

        With rho and eta, the squares of residuals and coefficients, it needs only the slope of
        eta, since d rho = -penalty^2 d eta (Hansen 2001, section 3). Positive in a corner.

        For penalties of shape (n,).
        """
        residual_share = self._residual_share(penalty)
        squares = ((1.0 - residual_share) * self.inner / self.values) ** 2
        eta = squares.sum(axis=1)
        rho = ((residual_share * self.inner) ** 2).sum(axis=1) + self.outside
        slope = -4.0 / penalty * (residual_share * squares).sum(axis=1)
        square = penalty**2
        return np.asarray(
            -2.0 * eta * rho / slope
            * (square * slope * rho + 2.0 * penalty * eta * rho + square**2 * eta * slope)
            / (square**2 * eta**2 + rho**2) ** 1.5)


def choose_penalty(spectrum: Spectrum, choice: str) -> float:
    """Return the penalty of the least GCV ("gcv"), or at the corner of the L-curve ("l-curve")."""
    if choice == "gcv":
        penalties = spectrum.penalties(TOLERANCE)
        gcv = spectrum.gcv(penalties)
        # GCV is often flat towards no penalty; the first of its least values is reproducible.
        return float(penalties[np.argmax(gcv <= gcv.min() * (1 + EQUAL_FIGURES))])
    # Below the least singular value the L-curve does not move (Hansen, O'Leary 1993).
    penalties = spectrum.penalties(spectrum.values[-1] / spectrum.values[0])
    curvature = spectrum.curvature(penalties)
    return float(penalties[curvature.argmax() if curvature.max() > 0.0 else -1])
