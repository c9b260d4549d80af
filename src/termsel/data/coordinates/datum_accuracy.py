"""How accurate a change of datum is where PROJ lacks the grid of the best operation."""

from __future__ import annotations

from dataclasses import dataclass
from warnings import catch_warnings, simplefilter

from termsel.data.coordinates.crs import WGS84, horizontal_crs

_AROUND_PLACE = 0.01
"""Degrees around a place in which an operation must hold."""


@dataclass(frozen=True)
class StandIn:
    """An operation that stands in for a better one.

    Parameters
    ----------
    accuracy : float
        Of the operation, as PROJ states it [m].
    grid : str
        Name of the missing grid, with which there is a better one.
    """

    accuracy: float
    grid: str


def stand_in_between(source: str, target: str, position: tuple[float, float]) -> StandIn | None:
    """Return what stands in for a missing grid between two CRSs at longitude and latitude [deg].

    None is returned if no grid is missing for a better operation, if PROJ states no accuracy of
    that which it has, or if it has none; and for one CRS twice, for two of WGS84, and for "local".
    """
    ends = [horizontal_crs(crs) for crs in (source, target)]
    if ends[0] == ends[1] or not all(ends) or WGS84.issuperset(ends):
        return None
    from pyproj.aoi import AreaOfInterest
    from pyproj.transformer import TransformerGroup

    lon, lat = position
    west = lon - _AROUND_PLACE
    south = lat - _AROUND_PLACE
    area = AreaOfInterest(west, south, lon + _AROUND_PLACE, lat + _AROUND_PLACE)
    with catch_warnings():
        simplefilter("ignore")  # warnings of missing grids
        group = TransformerGroup(*ends, always_xy=True, area_of_interest=area,
                                 allow_ballpark=False)
    if not group.transformers:
        return None
    accuracy = float(group.transformers[0].accuracy)
    # PROJ states -1 where it knows no accuracy.
    grids = [grid.short_name for operation in group.unavailable_operations
             if 0.0 <= operation.accuracy < accuracy
             for grid in operation.grids if not grid.available]
    return StandIn(accuracy, grids[0]) if grids else None
