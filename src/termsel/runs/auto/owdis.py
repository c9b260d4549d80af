"""Lines that OWDIS selects, as a candidate of the strategy "auto".

`owdis-lines` selects lines by what they predict for the points. The portfolio is then fitted to the
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

from termsel.candidates.portfolio import CLEARLY, Choice, choose, gain_of
from termsel.candidates.repetition import FOLDS_WITH_LINES
from termsel.errors import TermselError
from termsel.measurements.coordinates.places import spatial_order
from termsel.measurements.features import FeatureSet, FloatArray, Points
from termsel.runs.search.blunders_out import search_without_blunders
from termsel.runs.task.task import prepare


def with_selected_lines(control: FeatureSet, heights: bool, choice: Choice,
                        seed: int) -> tuple[Choice, FloatArray | None]:
    """Return the choice from points and the lines that OWDIS selects, if it is clearly better.

    Parameters
    ----------
    control : FeatureSet
        Points and lines.
    heights : bool
    choice : Choice
        That of `choose_features`, which says in any case how OWDIS compares.
    seed : int
        Of the search.

    Returns
    -------
    choice : Choice
    errors : ndarray, shape (n_points, 2), or None
        Of the points under selections made without them [px], where OWDIS is chosen.
    """
    count = len(control.points)
    if count < FOLDS_WITH_LINES or not len(control.lines):
        return choice, None
    others = choice.chosen.squares[:count]
    selected = _selected(control, heights, seed)
    found = None if selected is None else choose(selected, heights)
    if selected is None or found is None:
        return choice, None
    gain = gain_of(found.chosen.squares[:count], others)
    said = (f"OWDIS selects {len(selected.lines)} of {len(control.lines)} lines. With these the "
            f"points are predicted {'better' if gain > 0 else 'worse'} by {abs(gain):.2g} standard "
            "errors")
    if gain <= CLEARLY:
        return replace(choice, reason=f"{choice.reason} {said}; it must be better by more than "
                                      f"{CLEARLY:g}."), None
    errors = _held_out(control, heights, seed)
    if errors is None:
        return choice, None
    squares = (errors**2).sum(axis=1)
    honest = gain_of(squares, others)
    said += (f", and {'better' if honest > 0 else 'worse'} by {abs(honest):.2g} where it selects "
             "without them")
    if honest <= CLEARLY or squares.sum() >= others.sum():
        return replace(choice, reason=f"{choice.reason} {said}; both must be more than "
                                      f"{CLEARLY:g}, and the RMSE smaller."), None
    return replace(found, reason=f"{found.reason} {said}, so these lines are used."), errors


def _selected(control: FeatureSet, heights: bool, seed: int) -> FeatureSet | None:
    """Return the points and the lines that OWDIS selects by them; None where it cannot."""
    points = control.points
    judging = Points(points.ids, points.image, points.ground, points.sigma,
                     ("check",) * len(points))
    try:
        task = prepare("owdis-lines", features=control.with_(points=judging),
                       model="poly3d" if heights else "poly2d", source="control and check")
    except TermselError:  # too few lines, or all parallel
        return None
    found = search_without_blunders(task, seed=seed, generations=task.recipe.generations,
                                    patience=task.recipe.patience)
    if found.interrupted:
        raise KeyboardInterrupt
    if found.violation:
        return None
    lines = set(task.problem.decode(found.genes).features)
    return control.take(np.array([True] * len(points)
                                 + [name in lines for name in control.lines.features]))


def _held_out(control: FeatureSet, heights: bool, seed: int) -> FloatArray | None:
    """Return the errors of points under selections made without them; None if a fold has none."""
    count = len(control.points)
    errors = np.empty((count, 2))
    order = spatial_order(control.points.ground[:, :2])
    for fold in range(FOLDS_WITH_LINES):
        out = np.isin(np.arange(len(control)), order[fold::FOLDS_WITH_LINES])
        selected = _selected(control.take(~out), heights, seed)
        found = None if selected is None else choose(selected, heights, whole=False)
        if found is None:
            return None
        errors[out[:count]] = found.chosen.fit.errors(control.points.take(out[:count]))
    return errors
