"""Lines of round coordinates: on the map, and through a fitted model in the image."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from termsel_app.maps import Box, box_of
from termsel_app.places import Places, transform_places, transformer_between

LINES = 6
"""At most so many lines there are either way, besides those at the ends."""
_VERTICES = 33
"""Vertices of a line."""


def round_step(width: float) -> float:
    """Return the least of 1, 2 or 5 times a power of ten that fits a width at most LINES times."""
    # A box without a width has no logarithm.
    rough = max(width, 1e-12) / LINES
    power = 10.0 ** math.floor(math.log10(rough))
    return next(factor * power for factor in (1, 2, 5, 10) if factor * power >= rough)


def graticule_lines(places: Places, box: Box) -> list[dict[str, Any]]:
    """Return lines of round ground coordinates within a box of the map.

    Each is a dictionary: "label" is the coordinate as text, "axis" the coordinate that is constant,
    "x" or "y", "ground" the vertices in ground x and y (n, 2), and "map" those on the map, without
    vertices that have no place there.
    """
    steps = np.linspace(0, 1, 9)
    mesh = np.stack(np.meshgrid(box[0] + steps * (box[2] - box[0]),
                                box[1] + steps * (box[3] - box[1])), axis=-1).reshape(-1, 2)
    west, south, east, north = box_of(
        transform_places(transformer_between(places.plane, places.shown), mesh, inverse=True)
    )
    # Lines of constant x from south to north, then lines of constant y from west to east.
    lines = []
    for axis, (low, high, first, last) in enumerate(((west, east, south, north),
                                                     (south, north, west, east))):
        step = round_step(high - low)
        # As many decimals as the step has.
        digits = max(-math.floor(math.log10(step)), 0)
        for number in range(math.ceil(low / step), math.floor(high / step) + 1):
            vertices = np.linspace(first, last, _VERTICES)
            fixed_coordinate = np.full(_VERTICES, number * step)
            columns = [fixed_coordinate, vertices]
            ground = np.column_stack(columns if axis == 0 else columns[::-1])
            lines.append({"label": f"{number * step:,.{digits}f}", "axis": "xy"[axis],
                          "ground": ground,
                          "map": [vertex for vertex in places.to_map(ground).tolist()
                                  if np.isfinite(vertex).all()]})
    return lines
