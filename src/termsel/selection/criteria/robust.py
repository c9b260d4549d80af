"""Criteria that are robust against blunders in selection points."""

from __future__ import annotations

import numpy as np

from termsel.data.features import FloatArray
from termsel.fitting.losses import HUBER, MEDIAN, THRESHOLD, rmse_like_figure
from termsel.fitting.population import Fits
from termsel.selection.criteria.base import Criterion


def _robust_figure(fits: Fits, loss: str, threshold: float = THRESHOLD.default) -> FloatArray:
    """Return the figure of the distances sqrt(dl^2 + ds^2) of the selection points [px], (p,)."""
    # Beyond a pole errors may overflow; the figure then is infinite.
    with np.errstate(over="ignore", invalid="ignore"):
        distances = np.hypot(fits.check_errors[..., 0], fits.check_errors[..., 1])
    return rmse_like_figure(distances, np.ones_like(distances), loss, threshold)


class Median(Criterion):
    """Median distance of the selection points, as an RMSE [px].

    The median of sqrt(dl^2 + ds^2), times 1 / sqrt(ln 2), so that for normal errors it is the
    RMSE. Up to half of the selection points may be blunders. The figure ignores the size of the
    largest errors, also those of a poor model. The control is still adjusted by least squares: a
    criterion does not handle blunders in it.

    References
    ----------
    Rousseeuw 1984, J. Am. Stat. Assoc. 79(388), for the median of squared residuals.
    """

    name = "median"
    is_rmse = False
    in_px = True

    def score(self, fits: Fits) -> FloatArray:
        """Return the figure of each individual, (p,) [px]."""
        return _robust_figure(fits, MEDIAN)


class Huber(Criterion):
    """Huber's loss of the selection points, as an RMSE [px].

    sqrt(mean(rho(d))) over the distances d = sqrt(dl^2 + ds^2), where rho(d) is d^2 up to c and
    2 c d - c^2 beyond, and c is `threshold` times the median distance under the same model.
    Without blunders it is close to the RMSE; with them it grows with their number rather than
    with their size.

    References
    ----------
    Huber 1964, Ann. Math. Stat. 35(1); the scale from the median is termsel's own choice.
    """

    name = "huber"
    is_rmse = False
    in_px = True
    declared_options = (THRESHOLD,)

    def score(self, fits: Fits) -> FloatArray:
        """Return the figure of each individual, (p,) [px]."""
        return _robust_figure(fits, HUBER, self.options["threshold"])
