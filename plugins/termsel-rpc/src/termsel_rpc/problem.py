"""The selection of m of n control points for a refinement."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from termsel import (
    Criterion,
    Fits,
    Option,
    Points,
    Problem,
    ProblemData,
    Recipe,
    SelectionProblem,
    ce90,
    feature_options,
)
from termsel_rpc.refinement import FloatArray
from termsel_rpc.simulated import DATASET_NAME

JUDGED_BY = Option(
    "judged_by", "all", "Points of the criterion: all control candidates and selection points, as "
                        "in Konugurthi et al. 2016, or only the selection points.",
    choices=("all", "check"))


class Ce90(Criterion):
    """Circular error of nine in ten selection points [px]: the 90 % quantile of the distances.

    Blunders in up to a tenth of the points have no effect; with more blunders use the criterion
    `median`. The quantile is interpolated linearly between the distances; no distribution is
    assumed.
    """

    name = "ce90"
    is_rmse = False

    def score(self, fits: Fits) -> FloatArray:
        """Return the CE90 of the selection points by each fit, (p,) [px] (see `ce90`)."""
        with np.errstate(over="ignore", invalid="ignore"):
            return ce90(fits.check_errors)


def select_gcps(inputs: ProblemData) -> Problem:
    """Return the problem of selecting control points.

    Selections are judged by the selection points or, as the option `judged_by` says, by these and
    all control points, including those that are selected.
    """
    if inputs.options["judged_by"] == "all":
        control = inputs.control.points
        check = inputs.check
        inputs = replace(inputs, check=Points(
            control.ids + check.ids, np.concatenate([control.image, check.image]),
            np.concatenate([control.ground, check.ground])))
    # A chromosome has the numbers of m features, as in the paper.
    return SelectionProblem(inputs, terms=False, features=True, subset=True)


RECIPE = Recipe(
    "rpc-gcps", "Selection of m of n control points for the refinement of a vendor's RPC or a "
                "rigorous model.",
    select_gcps, model="rpc-drift", model_options={"rpc": DATASET_NAME}, dataset=DATASET_NAME,
    criterion="check-rmse", solver="ga-steady", second="uncovered",
    options=(JUDGED_BY, *feature_options(min_features=6, max_features=6, max_uncovered=0.5)),
    source="Konugurthi et al. 2016")
