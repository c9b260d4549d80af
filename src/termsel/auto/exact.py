"""What so few features determine exactly, so that nothing can be chosen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from termsel.auto.auto import Auto
from termsel.auto.methods import named
from termsel.auto.rule import Choice
from termsel.data.fit_data import FitData
from termsel.fitting.fit import Fit, HeldOut, Undetermined
from termsel.fitting.method import Method

EXACT_PROJECTIVE_POINTS = 4
"""Number of points that a projective transformation fits exactly."""

OBLIQUE_RMSE = 0.02
"""RMSE of an affine transformation of four points, by the half extent of the image, from which on
they show an oblique view."""


def minimal_fit(data: FitData) -> Choice:
    """Return what two or three features determine: a similarity, or an affine polynomial.

    Raises Undetermined if three points lie on a line, or lines are parallel.
    """
    plane = replace(data, heights=False)
    count = len(data)
    method = named("similarity" if count == 2 else "affine")
    chosen = _without_redundancy(method, method.fit(plane))
    return Choice(chosen, (*Auto().few(plane), chosen),
                  f"{count} {data.features.word} determine it exactly.")


def minimal_view(data: FitData, choice: Choice, auto: Auto) -> Choice:
    """Return the projection that four points determine, where nothing else fits.

    An affine transformation of four points leaves what a map or a vertical photo may leave; where
    it leaves more, and no point would be behind the camera, they show an oblique view. It is that
    of a camera without distortion where there is one, and else a projective transformation of the
    plane. Otherwise the choice is returned.
    """
    if len(data) != EXACT_PROJECTIVE_POINTS or len(
            data.features.points) != EXACT_PROJECTIVE_POINTS or choice.method.from_one:
        return choice
    plane = replace(data, heights=False)
    projective = named("projective")
    try:
        residuals = named("affine").fit(plane).control_rmse()
        fitted = projective.fit(plane)
    except Undetermined:
        return choice
    assert residuals is not None
    shows_oblique_view = residuals.total >= OBLIQUE_RMSE * data.scaling.image_scale
    camera = named("pinhole")
    camera_fit = auto.validated(camera, data) if camera in auto.offered(data) else None
    if camera_fit is not None and shows_oblique_view:
        return Choice(
            _without_redundancy(camera, camera_fit), choice.compared,
            f"{EXACT_PROJECTIVE_POINTS} points leave one equation of it. An affine polynomial "
            f"leaves {residuals.total:.3g} px of them, more than a map or a vertical photo does.")
    denominators = fitted.model.denominators(fitted.adjustment.coefficients,
                                             fitted.scaled_control.points.ground)
    assert denominators is not None
    if not shows_oblique_view or (denominators <= 0.0).any():
        return choice
    return Choice(
        _without_redundancy(projective, fitted), choice.compared,
        f"{EXACT_PROJECTIVE_POINTS} points determine it exactly. An affine polynomial leaves "
        f"{residuals.total:.3g} px of them, more than a map or a vertical photo does.")


def _without_redundancy(method: Method, fitted: Fit) -> Fit:
    """Return the fit of a method, of whose errors nothing is known."""
    unknown = HeldOut(np.full(len(fitted.control), np.nan))
    return replace(fitted, method=method, stored_held_out=unknown)
