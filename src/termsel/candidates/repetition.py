"""The choice among candidates, repeated in folds."""

from __future__ import annotations

from functools import cache

import numpy as np

from termsel.adjustment.lines import row_weights
from termsel.candidates.portfolio import EXACT, Choice, Watch, choose, choose_features, shrinks
from termsel.candidates.relief import heights_hold
from termsel.fits.fit import Fit, Undetermined
from termsel.measurements.coordinates.places import ground_centres, spatial_order
from termsel.measurements.features import FeatureSet, FloatArray
from termsel.measurements.scaling import scaling_of

MAX_FOLDS, FOLDS_WITH_LINES = 20, 10
"""Most folds in which the whole choice is repeated; lines are many, and take longer."""


def folds_of(control: FeatureSet) -> int:
    """Return in how many folds the whole choice is repeated."""
    return min(FOLDS_WITH_LINES if len(control.lines) else MAX_FOLDS, len(control))


def repeated(control: FeatureSet, heights: bool,
             watch: Watch | None = None) -> FloatArray | None:
    """Return the errors of features under choices made without them.

    In each fold the choice is made again, so that its errors are not those that it was made by.

    Parameters
    ----------
    control : FeatureSet
        Folds are spread over the scene.
    heights : bool
    watch : callable, optional
        As for `choose`.

    Returns
    -------
    ndarray, shape (n_points + n_lines, 2), or None
        Measured minus predicted [px]: of a point its line and sample; of a line the distances of
        its two vertices, weighted by how well the image line is known there, so that they compare
        with two coordinates of a point. None if some fold leaves too little to choose by, or lines
        alone that are too few to shrink.
    """
    order, folds = spatial_order(ground_centres(control)), folds_of(control)
    count, owner = len(control.points), control.feature
    errors = np.empty((len(owner), 2))
    whole = cache(lambda: choose(control, heights, whole=False))
    for fold in range(folds):
        out = np.zeros(len(control), dtype=bool)
        out[order[fold::folds]] = True
        rest, held = control.take(~out), control.take(out)
        choice = None if len(rest) <= EXACT else choose_features(
            rest, heights and heights_hold(rest, most=1), watch, whole=False)
        fitted = choice.chosen.fit if choice else None
        if not choice or not shrinks(choice.judged):
            fitted = (_as_all(whole(), rest, heights) or fitted) if count else None
        if fitted is None:
            return None
        errors[:count][out[:count]] = fitted.errors(held.points)
        errors[count:][out[owner[count:]]] = np.linalg.norm(fitted.line_errors(held.lines), axis=2)
    if count < len(owner):
        scaling = scaling_of(control)
        errors[count:] *= row_weights(scaling.features(control), heights=heights)[
            2 * count:].reshape(-1, 2)
    return errors


def _as_all(choice: Choice | None, rest: FeatureSet, heights: bool) -> Fit | None:
    """Return what all features choose, fitted to some, which would choose by luck; or None."""
    try:
        if choice:
            return choice.chosen.candidate.fit_control(rest, heights, scaling_of(rest))
    except Undetermined:
        pass
    return None
