"""Criteria that some wrong check points do not upset."""

from __future__ import annotations

import numpy as np

from termsel.criteria.base import Criterion, Fits
from termsel.features import FloatArray
from termsel.options import Option

MEDIAN = float(1.0 / np.sqrt(np.log(2.0)))
"""RMSE of points by the median of their distances, for normal errors: sqrt(2) by
sqrt(2 ln 2)."""


def _distances(fits: Fits) -> FloatArray:
    """Return sqrt(dl^2 + ds^2) of the check points [pixel], shape (p, n)."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.hypot(fits.check_errors[..., 0], fits.check_errors[..., 1]))


class Median(Criterion):
    """Median distance of the check points, as an RMSE [pixel].

    The median of sqrt(dl^2 + ds^2), times 1 / sqrt(ln 2), so that for normal errors it is the
    RMSE. Up to half of the check points may be wrong. It is blind for how large the largest
    errors are, also those of a poor model. The control is adjusted by least squares all the
    same: wrong points in it are not for a criterion.

    References
    ----------
    Rousseeuw 1984, J. Am. Stat. Assoc. 79(388), for the median of squared residuals.
    """

    name = "median"
    is_rmse = False

    def score(self, fits: Fits) -> FloatArray:
        """Return the figure [pixel]."""
        return np.asarray(MEDIAN * np.median(_distances(fits), axis=1))


class Huber(Criterion):
    """Huber's loss of the check points, as an RMSE [pixel].

    sqrt(mean(rho(d))) over the distances d = sqrt(dl^2 + ds^2), where rho(d) is d^2 up to c and
    2 c d - c^2 beyond, and c is `threshold` times the median distance under the same model.
    Without wrong points it is close to the RMSE, with them it grows with their number
    rather than with their size.

    References
    ----------
    Huber 1964, Ann. Math. Stat. 35(1); the scale from the median is termsel's own choice.
    """

    name = "huber"
    is_rmse = False
    declared_options = (
        Option("threshold", 2.0, "Distance from which on errors count linearly, by the median "
               "distance.", float, 0.1),)

    def score(self, fits: Fits) -> FloatArray:
        """Return the figure [pixel]."""
        d = _distances(fits)
        c = self.options["threshold"] * np.median(d, axis=1)[:, None]
        with np.errstate(over="ignore", invalid="ignore"):
            loss = np.where(d <= c, d**2, 2 * c * d - c**2)
            return np.asarray(np.sqrt(loss.mean(axis=1)))
