"""Lines that OWDIS selects, as a choice of the method "auto".

`owdis-lines` selects lines by what they predict for the points. All methods are then fitted to the
points and these lines. As the points judged the selection, their errors are too small: only where
these are clearly smaller than those of the choice from all lines is the search worth repeating,
without some of the points each time, for errors that are not.

References
----------
Yavari, Valadan Zoej and Salehi 2018, ISPRS J. Photogramm. Remote Sens., for OWDIS. How it is held
against other candidates is termsel's own.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from termsel.auto.auto import Auto
from termsel.auto.rule import CLEAR_MARGIN, FOLDS_WITH_LINES, Choice, gain_of
from termsel.core.errors import TermselError
from termsel.data.coordinates.places import spatial_order
from termsel.data.features import FloatArray, Points
from termsel.data.fit_data import FitData
from termsel.runs.recommend import with_recommended_member
from termsel.runs.steps import search_in_steps
from termsel.runs.task import prepare


def with_selected_lines(control: FitData, choice: Choice, auto: Auto,
                        seed: int) -> tuple[Choice, FloatArray | None]:
    """Return the choice from points and the lines that OWDIS selects, if it is clearly better.

    The control has points and lines, the choice is that of `choose_features`; how OWDIS compares
    with it is added to its reason. With OWDIS come the errors of the points under selections made
    without them [px], (n_points, 2), else None. The seed is that of the search.
    """
    lines = control.features.lines
    count = len(control.features.points)
    if count < FOLDS_WITH_LINES or not len(lines):
        return choice, None
    # Only points are predicted by others alike, with the selected lines or with all.
    squares_alone = choice.chosen.held_out().squares[:count]
    selected = _select_features(control, seed)
    with_lines = None if selected is None else auto.choose(selected)
    if selected is None or with_lines is None:
        return choice, None
    gain = gain_of(with_lines.chosen.held_out().squares[:count], squares_alone)
    comparison = (
        f"OWDIS selects {len(selected.features.lines)} of {len(lines)} lines. With these the "
        f"points are predicted {'better' if gain > 0 else 'worse'} by {abs(gain):.2g} standard "
        "errors")
    if gain <= CLEAR_MARGIN:
        return replace(choice, reason=f"{choice.reason} {comparison}; it must be better by more "
                                      f"than {CLEAR_MARGIN:g}."), None
    errors = _held_out_errors(control, auto, seed)
    if errors is None:
        return choice, None
    squares = (errors**2).sum(axis=1)
    honest = gain_of(squares, squares_alone)
    comparison += (f", and {'better' if honest > 0 else 'worse'} by {abs(honest):.2g} where it "
                   "selects without them")
    if honest <= CLEAR_MARGIN or squares.sum() >= squares_alone.sum():
        return replace(choice, reason=f"{choice.reason} {comparison}; both must be more than "
                                      f"{CLEAR_MARGIN:g}, and the RMSE smaller."), None
    reason = f"{with_lines.reason} {comparison}, so these lines are used."
    return replace(with_lines, reason=reason), errors


def _select_features(control: FitData, seed: int) -> FitData | None:
    """Return the points and the lines that OWDIS selects by them; None where it cannot."""
    features = control.features
    points = features.points
    judging = Points(points.ids, points.image, points.ground, points.sigma,
                     ("check",) * len(points))
    try:
        task = prepare("owdis-lines", features=features.with_(points=judging),
                       model="poly3d" if control.heights else "poly2d", source="control and check")
    except TermselError:  # too few lines, or all parallel
        return None
    # The outlier test has been made.
    search = with_recommended_member(task, search_in_steps(
        task, seed=seed, generations=task.recipe.generations, patience=task.recipe.patience))
    if search.interrupted:
        raise KeyboardInterrupt
    if search.violation:
        return None
    lines = set(task.problem.decode(search.genes).features)
    return control.take(np.array([True] * len(points)
                                 + [name in lines for name in features.lines.features]))


def _held_out_errors(control: FitData, auto: Auto, seed: int) -> FloatArray | None:
    """Return the errors of points by selections without them [px], (n, 2).

    None if some fold leaves no choice.
    """
    points = control.features.points
    errors = np.empty((len(points), 2))
    # Folds spread over the scene, so that no fold leaves an area without points.
    order = spatial_order(points.ground[:, :2])
    for fold in range(FOLDS_WITH_LINES):
        is_out = np.isin(np.arange(len(control)), order[fold::FOLDS_WITH_LINES])
        selected = _select_features(control.take(~is_out), seed)
        choice = None if selected is None else auto.choose(selected, with_contained=False)
        if choice is None:
            return None
        errors[is_out[:len(points)]] = choice.chosen.errors(points.take(is_out[:len(points)]))
    return errors
