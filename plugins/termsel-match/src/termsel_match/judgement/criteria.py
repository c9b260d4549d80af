"""A figure of merit for candidates many of which are wrong."""

from __future__ import annotations

import numpy as np

from termsel import Criterion, Fits, Option
from termsel_match.images.rasters import FloatArray


class Agreement(Criterion):
    """Part of the points that do not agree with the model, 0 to 1, with a soft limit.

    A point at the distance e counts e^2 / (e^2 + t^2), with the option `half_at` as t. Points far
    away count alike however far they are, so that most points may be wrong; near ones decide.

    References
    ----------
    Geman, McClure 1987: Statistical methods for tomographic image reconstruction. Bulletin of the
    International Statistical Institute 52, 5-21: the loss.
    """

    name = "agreement"
    is_rmse = False
    declared_options = (
        Option("half_at", 2.0, "Distance at which a point counts half [px].", float, 0.01, 1e4),)

    def score(self, fits: Fits) -> FloatArray:
        """Return the share of check features that do not agree with each fit, 0 to 1, (p,).

        It is smooth, by the loss of each, and 1 for an error that is not finite.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            squares = (np.asarray(fits.check_errors) ** 2).sum(axis=-1)
            # The loss of Geman and McClure: e^2 / (e^2 + t^2).
            disagreement = squares / (squares + self.options["half_at"] ** 2)
        return np.asarray(np.where(np.isfinite(disagreement), disagreement, 1.0).mean(axis=-1))
