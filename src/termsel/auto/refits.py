"""Errors of features held out by a method that is fitted again without them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from termsel.auto.rule import fold_of_each, folds_of
from termsel.core.arguments import explains_arguments
from termsel.data.features import FeatureSet
from termsel.data.fit_data import FitData
from termsel.fitting.fit import Fit, HeldOut


@explains_arguments()
def held_out_by_refits(fit: Callable[[FitData], Fit], features: FeatureSet, *,
                       heights: bool | None = None) -> HeldOut:
    """Return the errors of features by fits without them, in folds spread over the scene.

    This is for the `Method.held_out` of methods that choose, or whose estimator has no closed form:
    the whole of `fit` is repeated, as many times as the strategy "auto" repeats its choice. Below
    40 points each feature is a fold.

    Parameters
    ----------
    fit : callable
        `Method.fit`.
    features : FeatureSet
        All that the method was fitted to.
    heights : bool, optional
        As for `FitData.of`.

    Returns
    -------
    HeldOut
        Of all features.

    Raises
    ------
    Undetermined
        If the features without those of some fold do not determine the method.

    Examples
    --------
    >>> import termsel
    >>> features = termsel.simulate_scene("ikonos-hamedan", n_lines=0)
    >>> held_out = termsel.held_out_by_refits(
    ...     lambda data: termsel.fit(data.features, "affine"), features)
    >>> round(float(held_out.squares.mean() ** 0.5), 2)  # RMSE [px]
    3.14
    """
    data = FitData.of(features, heights)
    feature_of_vertex = features.vertex_feature
    errors = np.empty((len(feature_of_vertex), 2))
    folds = folds_of(features)
    fold_of_feature = fold_of_each(features, folds)
    for fold in range(folds):
        in_fold = fold_of_feature == fold
        held_out = features.take(in_fold)
        fitted = fit(data.take(~in_fold))
        # Points have one vertex and lines two, in the order of `vertex_feature`.
        errors[in_fold[feature_of_vertex]] = np.concatenate([
            fitted.errors(held_out.points), fitted.line_errors(held_out.lines).reshape(-1, 2)])
    return HeldOut.of(errors, features)
