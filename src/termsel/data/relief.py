"""Ground that hides other ground: what an oblique view shows is what its rays meet first."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Protocol, runtime_checkable

import numpy as np

from termsel.core.errors import count_in_words
from termsel.data.arrays import BoolArray, FloatArray, numbers_or_nan
from termsel.data.locate import Projection, Surface, visible_places

log = logging.getLogger(__name__)

_SAMPLED = 200
"""Places along a side of an area at which a surface is asked that is a function alone."""


@runtime_checkable
class Relief(Protocol):
    """A surface of heights that states how high it is and how close its heights are, as a DEM."""

    def __call__(self, xy: FloatArray) -> FloatArray:
        """Return heights (n,) of plane ground coordinates (n, 2); NaN where there are none."""

    def highest(self, corners: FloatArray) -> float:
        """Return the greatest height in the box around places (n, 2); NaN where there is none."""

    def spacing(self) -> float:
        """Return the distance of neighbouring heights, in the unit of the ground coordinates."""


@dataclass(frozen=True)
class _Sampled:
    """A function of heights, asked at places that are spread over the box around `corners` (n, 2).
    """

    surface: Surface
    corners: FloatArray

    def highest(self, corners: FloatArray) -> float:
        """Return the greatest height found in the box around `corners`; minus infinity if none is.
        """
        grid = np.stack(np.meshgrid(*_sides_of(corners)), axis=-1).reshape(-1, 2)
        heights = self.surface(grid)
        return float(np.max(heights, initial=-np.inf, where=np.isfinite(heights)))

    def spacing(self) -> float:
        """Return the lesser distance of neighbouring places."""
        return float(min(side[1] - side[0] for side in _sides_of(self.corners)))


def _sides_of(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return x and y of places along both sides of the box around `corners`, (_SAMPLED,) each."""
    low = corners.min(axis=0)
    high = corners.max(axis=0)
    return np.linspace(low[0], high[0], _SAMPLED), np.linspace(low[1], high[1], _SAMPLED)


def unmasked(surface: Surface) -> Surface:
    """Return a surface whose heights are NaN where it returns a masked array of numpy."""
    if isinstance(surface, Relief):  # which states its holes as NaN
        return surface
    return lambda places: numbers_or_nan(surface(places))


def visible_ground(project: Projection, holds: Callable[[FloatArray], BoolArray],
                   image: FloatArray, ground: FloatArray, surface: Surface,
                   box: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Return ground places (n, 3), each hidden one replaced by the place that hides it from view.

    A ray may meet a surface more than once; the camera sees the first place. A hidden one stays
    where the model does not hold at the place that hides it. How many are replaced is logged.

    Parameters
    ----------
    project : callable
        Returns line and sample [px] (n, 2) of ground points (n, 3).
    holds : callable
        Returns a mask (m,) of places (m, 3) at which the model holds. Behind a camera it does not:
        a model sees mirrored places there.
    image : ndarray, shape (n, 2)
        Line and sample [px].
    ground : ndarray, shape (n, 3)
        Where rays meet the surface, as `termsel.data.locate.locate` returns it.
    surface : Relief or callable
        Returns heights (n,) of places (n, 2). The highest place of one that is no `Relief` is found
        by asking for heights all over the area.
    box : tuple of 2 ndarrays
        Middle and half the size of the control, (3,) each.

    Returns
    -------
    ndarray, shape (n, 3)
        Rows with NaN stay so. `ground` itself, no copy, is returned if it has no known place or the
        surface no known height.
    """
    known_places = ground[np.isfinite(ground).all(axis=1), :2]
    if not len(known_places):
        return ground
    # What hides a place may lie outside the known places and the control. The box around both is
    # enlarged by its own size on each side.
    centre, scale = box
    extent = np.vstack([known_places, centre[:2] - scale[:2], centre[:2] + scale[:2]])
    low, high = extent.min(axis=0), extent.max(axis=0)
    size = high - low
    x, y = np.stack([low - size, high + size]).T
    corners = np.array(list(product(x, y)))
    relief = surface if isinstance(surface, Relief) else _Sampled(surface, corners)
    highest = relief.highest(corners)
    if not np.isfinite(highest):
        return ground
    visible = visible_places(project, image, ground, surface, highest, relief.spacing(), scale)
    moved = np.flatnonzero((visible != ground).any(axis=1) & np.isfinite(ground[:, 0]))
    moved = moved[holds(visible[moved])]
    ground = ground.copy()
    ground[moved] = visible[moved]
    if moved.size:
        log.info("%s would be behind other ground: the visible place is given.",
                 count_in_words(len(moved), "point"))
    return ground
