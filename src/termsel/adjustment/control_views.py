"""The central projection that points and lines of control support together."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np

from termsel.adjustment.equations import line_normals, row_weights
from termsel.data.features import FeatureSet
from termsel.data.view import CentralView, Sightings, view_of, view_of_sightings

_VIEWS: WeakKeyDictionary[FeatureSet, CentralView | None] = WeakKeyDictionary()
"""Held by features with lines, as each method asks about the same ones, and gone with them."""


def view_of_control(features: FeatureSet) -> CentralView | None:
    """Return the central projection that scaled features support; None if they support none.

    It is a DLT, or a projective transformation of the plane where heights are not known or show
    nothing. Both vertices of a line have its distance in the image, with the weight that an
    adjustment gives it.

    Examples
    --------
    >>> import termsel
    >>> from termsel.adjustment.control_views import view_of_control
    >>> features = termsel.simulate_scene("ikonos-hamedan")
    >>> data = termsel.FitData.of(features)
    >>> view_of_control(data.scaled) is None  # seen from orbit
    True
    """
    if not len(features.lines):
        return view_of(features.points)
    if features not in _VIEWS:
        _VIEWS[features] = view_of_sightings(_sightings(features))
    return _VIEWS[features]


def _sightings(features: FeatureSet) -> Sightings:
    """Return lines and samples of the points, and distances of the vertices across their lines."""
    points = features.points
    lines = features.lines
    normals, offsets = line_normals(lines)
    heights = bool(np.isfinite(features.ground_vertices()).all())
    weights = row_weights(features, heights=heights)
    # Of a point line and sample follow each other, and so do the vertices of a line.
    place = np.concatenate([np.repeat(np.arange(len(points)), 2),
                            len(points) + np.arange(2 * len(lines))])
    all_normals = np.concatenate([np.tile(np.eye(2), (len(points), 1)),
                                  np.repeat(normals, 2, axis=0)])
    all_offsets = np.concatenate([points.image.ravel(), np.repeat(offsets, 2)])
    return Sightings(all_normals * weights[:, None], all_offsets * weights,
                     features.ground_vertices()[place], place)
