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
from termsel.auto.rule import (
    CLEAR_MARGIN,
    FOLDS_WITH_LINES,
    Choice,
    advantage_in_words,
    gain_of,
    requirement_in_words,
)
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

    Parameters
    ----------
    control : FitData
        Points and lines.
    choice : Choice
        The choice of `choose_features`, which is returned where OWDIS is not clearly better, its
        reason then saying how OWDIS compares with it.
    auto : Auto
    seed : int
        Of the search.

    Returns
    -------
    choice : Choice
    errors : ndarray, shape (n_points, 2), or None
        Errors of the points under selections of lines made without them [px], where the choice is
        with the lines of OWDIS; else None.
    """
    lines = control.features.lines
    n_points = len(control.features.points)
    if n_points < FOLDS_WITH_LINES or not len(lines):
        return choice, None
    # Both choices are compared by the points alone, as they do not have the same lines.
    squares_given = choice.chosen.held_out().squares[:n_points]
    selected_control = _select_features(control, seed)
    selected_choice = None if selected_control is None else auto.choose(selected_control)
    if selected_control is None or selected_choice is None:
        return choice, None
    gain = gain_of(selected_choice.chosen.held_out().squares[:n_points], squares_given)
    comparison = (
        f"OWDIS selects {len(selected_control.features.lines)} of {len(lines)} lines. With these "
        f"the points are predicted {advantage_in_words(gain, 'without the selection')}"
        f"{requirement_in_words(gain, CLEAR_MARGIN)}")
    if gain <= CLEAR_MARGIN:
        return replace(choice, reason=f"{choice.reason} {comparison}."), None
    # The points judged this selection: only a selection without them shows an honest gain.
    errors = _held_out_errors(control, auto, seed)
    if errors is None:
        return choice, None
    squares = (errors**2).sum(axis=1)
    honest_gain = gain_of(squares, squares_given)
    comparison += (". Where it selects without the points that are predicted, they are predicted "
                   f"{advantage_in_words(honest_gain, 'without the selection')}"
                   f"{requirement_in_words(honest_gain, CLEAR_MARGIN)}")
    if honest_gain <= CLEAR_MARGIN:
        return replace(choice, reason=f"{choice.reason} {comparison}."), None
    if squares.sum() >= squares_given.sum():
        return replace(choice, reason=f"{choice.reason} {comparison}, but not with a smaller "
                                      "RMSE, so all lines are used."), None
    reason = f"{selected_choice.reason} {comparison}, so these lines are used."
    return replace(selected_choice, reason=reason), errors


def _select_features(control: FitData, seed: int) -> FitData | None:
    """Return the points of `control` and the lines with which OWDIS predicts these points best.

    Returns None where OWDIS cannot select: there are too few lines, all are parallel, or no
    selection meets its constraints. Raises KeyboardInterrupt where its search was interrupted.
    """
    features = control.features
    points = features.points
    selection_points = Points(points.ids, points.image, points.ground, points.sigma,
                            ("check",) * len(points))
    try:
        task = prepare("owdis-lines", features=features.with_(points=selection_points),
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
    selected_lines = set(task.problem.decode(search.genes).features)
    are_selected = [name in selected_lines for name in features.lines.features]
    return control.take(np.array([True] * len(points) + are_selected))


def _held_out_errors(control: FitData, auto: Auto, seed: int) -> FloatArray | None:
    """Return the errors of the points [px], (n_points, 2), under choices made without them.

    For each of FOLDS_WITH_LINES folds of points, OWDIS selects lines and a model is chosen by the
    other points. Returns None if there is no choice without some fold.
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
        # Features are points, then lines; lines are in no fold.
        are_points_out = is_out[:len(points)]
        errors[are_points_out] = choice.chosen.errors(points.take(are_points_out))
    return errors
