"""Images that a simulated scanner takes of ground with a pattern on it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.ndimage import map_coordinates

from termsel.data.features import FloatArray
from termsel.simulate.pushbroom import Heights, Pushbroom

Pattern = Callable[[FloatArray], FloatArray]
"""Brightness, shape (n,), of longitude and latitude [deg], shape (n, 2)."""

_MESH = 4  # px; the ground between is interpolated by cubic splines
_MARGIN = 3  # meshes around the image, as splines are worst at the edge


def checkerboard_pattern(origin: tuple[float, float], field_size: tuple[float, float]) -> Pattern:
    """Return a pattern of dark and bright fields.

    `origin` is the longitude and latitude of a corner, `field_size` the width and height of a field
    [deg].
    """
    def brightness(position: FloatArray) -> FloatArray:
        column, row = np.floor((position - origin) / field_size).T
        return np.where((column + row) % 2 == 0, 60.0, 190.0)

    return brightness


def render(sensor: Pushbroom, terrain: Heights, pattern: Pattern, *, oversample: int = 4,
           ) -> FloatArray:
    """Return the image a scanner takes of a pattern on the terrain, shape (n_lines, n_samples).

    It is the brightness in the units of the pattern. Each pixel is the mean of oversample^2 rays,
    spread over its area; shading of the terrain is not modelled. The ground is computed at the
    nodes of a mesh of `_MESH` px, and interpolated between them by cubic splines.
    """
    lines, samples = (np.arange(-_MARGIN, -(-size // _MESH) + _MARGIN + 1) * _MESH
                      for size in (sensor.n_lines, sensor.n_samples))
    image = np.stack(np.meshgrid(lines, samples, indexing="ij"), axis=-1).astype(np.float64)
    middle = sensor.locate(np.array([sensor.centre]), 0.0)
    ground = sensor.on_terrain(terrain, image.reshape(-1, 2), float(terrain(middle)[0]))
    ground = ground.reshape(*image.shape[:2], 3)
    # From the centre of a pixel: the middles of its equal parts.
    offsets = (np.arange(oversample) + 0.5) / oversample - 0.5
    fine_line, fine_sample = (
        (np.arange(size)[:, None] + offsets).ravel() / _MESH + _MARGIN
        for size in (sensor.n_lines, sensor.n_samples))
    # In units of the mesh, which begins `_MARGIN` nodes before the image.
    mesh_position = np.meshgrid(fine_line, fine_sample, indexing="ij")
    position = np.stack([map_coordinates(ground[..., axis], mesh_position, order=3).ravel()
                         for axis in (0, 1)], axis=-1)
    # Axes: line, its part, sample, its part.
    by_part = pattern(position).reshape(sensor.n_lines, oversample, sensor.n_samples, oversample)
    return np.asarray(by_part.mean(axis=(1, 3)))
