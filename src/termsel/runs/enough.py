"""Whether the features of a run are enough for its problem."""

from __future__ import annotations

import numpy as np

from termsel.core.errors import TermselError, counted
from termsel.data.features import FeatureSet
from termsel.data.roles import Observations
from termsel.fitting.diagnosis import orientation_spread
from termsel.models.base import SensorModel
from termsel.selection.criteria import Criterion
from termsel.selection.problems.recipes import Recipe

MIN_CHECK = 2

ALL_PARALLEL = 1e-4
"""Orientation spread below which control lines are taken for parallel: within half a degree."""


CORRECTED = (" Or leave the rest out: termsel run --points FILE --rpc FILE corrects a vendor's RPC "
             "by one point or more.")


def require_enough(observations: Observations, recipe: Recipe, criterion: Criterion,
                   model: SensorModel, fewest: int) -> None:
    """Refuse data for a problem: too few features, all in one place, or lines in one direction.

    `fewest` is the fewest control features.
    """
    control = observations.control
    check = observations.check
    if len(control) < fewest:
        others = _others(observations)
        raise TermselError(
            f"{_given(control)}{others}; {recipe.name} needs at least {fewest}",
            hint=("Measure more, or give more features the role control." if others
                  else "Measure more.")
                 + " Or choose by leave-one-out, without selection points: --criterion press."
                 * criterion.needs_check
                 + CORRECTED * ("rpc" in model.options))
    if criterion.needs_check and len(check) < MIN_CHECK:
        raise TermselError(
            f"{_number(len(check), 'selection point')} (role check); the criterion "
            f"{criterion.name} needs at least {MIN_CHECK}",
            hint="Give more points the role check: they choose among selections. Or choose by "
                 "leave-one-out, without selection points: --criterion press.")
    # The geometry of control matters where nothing else determines the model.
    if fewest == 1:
        return  # what is known of the image makes up for what they do not determine
    if not np.ptp(control.image_vertices(), axis=0).any():
        raise TermselError("all control features have the same place in the image",
                           hint="Check that the columns line and sample hold image coordinates.")
    if not np.ptp(control.ground_vertices()[:, :2], axis=0).any():
        raise TermselError(
            f"all {counted(len(control), 'control feature')} have the same place on the ground",
            hint="Check that the columns x and y hold the position of each feature.")
    # The singular values of centred plan coordinates: the second is 0 on one straight line.
    spread = np.linalg.svd(control.ground_vertices()[:, :2]
                           - control.ground_vertices()[:, :2].mean(axis=0), compute_uv=False)
    if len(control) > 2 and spread[1] < 1e-6 * spread[0]:
        raise TermselError("all control features lie on one straight line on the ground",
                           hint="Add control away from that line: a model needs an area.")
    # Lines measure across themselves alone.
    if not len(control.points) and orientation_spread(control.lines) < ALL_PARALLEL:
        raise TermselError(
            "all control lines are parallel in the image, so nothing is measured along them",
            hint="Add lines of another direction, or control points with --set mixed=true.")


def _given(control: FeatureSet) -> str:
    """Return how many control features there are, such as "1 control point"."""
    noun = control.word.removesuffix("s")
    return _number(len(control), f"control {noun}")


def _others(observations: Observations) -> str:
    """Return which points are not control, where some are, such as ", next to 1 selection point".
    """
    kinds = ((observations.check, "selection point"),
             (observations.independent, "independent check point"))
    others = [counted(len(features), noun) for features, noun in kinds if len(features)]
    if observations.off:
        others.append(f"{counted(len(observations.off), 'feature')} with the role off")
    return f", next to {' and '.join(others)}" if others else ""


def _number(number: int, noun: str) -> str:
    return f"only {counted(number, noun)}" if number else f"no {noun}s"
