"""The set-up of Konugurthi et al. 2016: its fitness, and its problem."""

from __future__ import annotations

import numpy as np

from termsel import Criterion, Fits, Recipe, TermselError, feature_options, uncovered_share
from termsel_rpc.problem import JUDGED_BY, select_gcps
from termsel_rpc.refinement import FloatArray
from termsel_rpc.simulated import MATCHES


class E50PerArea(Criterion):
    """Median error by the area that the selected points cover, E50 / A [px].

    Konugurthi et al. 2016 maximise A / E50; termsel minimises its inverse. The fitness is named on
    pages 381 and 383; the page with its formula could not be consulted. Here A is the share of the
    image inside the hull of the selected points, and E50 the median distance over all
    selection points. Up to half of these may be blunders.
    """

    name = "e50-area"
    is_rmse = False
    needs_check = False

    def score(self, fits: Fits) -> FloatArray:
        """Return the value of each fit, (p,): its median error [px], divided by the share covered.

        The share is that of the image within the hull of the selected points. It is infinite for
        points on a straight line. Raises TermselError without selection points.
        """
        if not len(fits.check):
            raise TermselError("the criterion e50-area requires selection points, and there are "
                               "none", hint="Choose --set judged_by=all, or give selection points.")
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            errors = np.hypot(fits.check_errors[..., 0], fits.check_errors[..., 1])
            covered = 1.0 - uncovered_share(fits.control.image, fits.in_use[:, :len(fits.control)])
            return np.asarray(np.median(errors, axis=1) / covered)


RECIPE = Recipe(
    "konugurthi-2016", "Selection of 9 of 100 matched points, 30 of them wrong, for the refinement "
                       "of a rigorous model of Cartosat-1.",
    select_gcps, model="pushbroom-refine", model_options={"geometry": MATCHES}, dataset=MATCHES,
    criterion="e50-area", solver="ga-steady", second="uncovered",
    solver_options={"ga-steady": {"population": 10, "overlap": 0.5}}, generations=20,
    refined=False,
    options=(JUDGED_BY, *feature_options(min_features=9, max_features=9, blunders="keep")),
    source="Konugurthi et al. 2016, pages 380, 381 and 383")
