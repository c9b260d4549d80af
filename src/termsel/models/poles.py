"""Poles: places in the scene where a denominator is too small.

What an image cannot show, as it lies below or behind the camera, does not count: there even the
denominator of a right model of an oblique photograph is zero or less.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from termsel.data.coordinates.crs import is_geocentric
from termsel.data.coordinates.places import spatial_order
from termsel.data.features import FeatureSet, FloatArray, Points
from termsel.data.view import view_of
from termsel.models.base import SensorModel

POLE_MARGIN = 0.1
"""Least value of a denominator over the scene; vendor RPCs stay within some hundredths of 1."""

SHORTER = 0.25
"""Least value of a denominator, by the least one of an oblique view at a control point."""

LARGEST_SHORTFALL = 1e9
"""Largest shortfall of a denominator; finite, so that it can be compared."""

GUARDED = 100
"""Features at which denominators are tested, next to the grid. Polynomials of third order have
no room for a pole between so many."""

_GRID = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, n) for n in (5, 5, 3)]), -1).reshape(-1, 3)


def pole_margin(control: Points) -> float:
    """Return the least value that denominators must have, of models of scaled control points.

    It is POLE_MARGIN, or less where the points support an oblique view, whose nearest point is so
    much nearer to the camera than the middle.
    """
    view = view_of(control)
    return POLE_MARGIN if view is None else min(POLE_MARGIN, SHORTER * view.depth)


@lru_cache(maxsize=8)
def guard_points(control: FeatureSet, check: Points, wider: float = 1.0) -> FloatArray:
    """Return scaled ground points at which denominators must stay positive.

    They are a grid over the box around control and check features, without what no image of such a
    view shows, and the features themselves. The box is made `wider` about its middle.
    """
    vertices = np.concatenate([control.ground_vertices(), check.ground])
    axes = np.eye(3)
    # X, Y, Z are not along the ground: the box is turned to the features.
    if control.fit_crs and is_geocentric(control.fit_crs):
        axes = np.linalg.svd(vertices - vertices.mean(axis=0), full_matrices=False)[2].T
    # The grid spans the box around all features along these axes.
    low = (vertices @ axes).min(axis=0)
    high = (vertices @ axes).max(axis=0)
    if len(vertices) > GUARDED:  # an even choice over the scene
        even = np.linspace(0, len(vertices) - 1, GUARDED).astype(int)
        vertices = vertices[spatial_order(vertices[:, :2])[even]]
    grid = (low + high) / 2 + _GRID * (high - low) / 2
    # Back from the turned axes to X, Y, Z.
    guard = np.concatenate([vertices, grid @ axes.T])
    if wider != 1.0:
        middle = (guard.max(axis=0) + guard.min(axis=0)) / 2
        guard = middle + wider * (guard - middle)
    # Of an oblique view only what lies in front of the camera.
    view = view_of(control.points)
    if view is not None:
        guard = np.concatenate([vertices, guard[view.shows(guard)]])
    guard.setflags(write=False)  # all who ask for the same ones share them
    return guard


def pole_violation(model: SensorModel, coefficients: FloatArray, ground: FloatArray,
                   margin: float = POLE_MARGIN) -> FloatArray:
    """Return how far denominators are below a margin, shape (p,); 0 is safe."""
    below = model.denominators(coefficients, ground)
    if below is None:
        return np.zeros(len(coefficients))
    # A denominator that is not a number is as bad as can be.
    smallest = np.nan_to_num(below, nan=-LARGEST_SHORTFALL).min(axis=(1, 2))
    return np.asarray(np.clip(margin - smallest, 0.0, LARGEST_SHORTFALL))
