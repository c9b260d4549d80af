"""Notes on the data themselves, whatever method they are used by."""

from __future__ import annotations

from collections.abc import Iterator

from termsel.measurements.features import FeatureSet, Points, join_points
from termsel.measurements.longitudes import jumps
from termsel.measurements.roles import Observations, together
from termsel.measurements.twins import groups, twins

NAMED = 5
"""Groups of points that a note names."""


def notes_on_data(read: FeatureSet, observations: Observations, heights: bool) -> Iterator[str]:
    """Yield what the reader of a result must know of the data.

    Parameters
    ----------
    read : FeatureSet
        As read.
    observations : Observations
        The same features, each in its role.
    heights : bool
        Whether heights would be used.
    """
    if jumps(read):
        yield ("The longitudes jump by a full turn between points. They were made continuous: on "
               "one side they go on beyond 180 degrees.")
    both, independent = together(observations), observations.independent
    yield from _on_twins(both.points, independent)
    z = both.ground_vertices()[:, 2]
    if heights and len(z) > 1 and (z == z[0]).all():
        yield (f"All heights are {z[0]:g}, so they were not used. If they are not known, leave "
               "them blank or take them from a raster (--dem FILE).")


def _on_twins(both: Points, independent: Points) -> Iterator[str]:
    """Yield what is to be said of points that repeat each other."""
    found = groups(both.ids, twins(both.ground))
    if found:
        yield (f"Points too close to each other to tell anything apart share a role and a fold: "
               f"{_listed(found)}.")
    every = join_points(both, independent)
    apart = set(independent.ids)
    shared = [group for group in groups(every.ids, twins(every.ground, both.ground))
              if 0 < len(apart.intersection(group)) < len(group)]
    if shared:
        yield (f"Independent points at the places of control or check points do not test the "
               f"model: {_listed(shared)}.")


def _listed(found: list[tuple[str, ...]]) -> str:
    named = ", ".join(" and ".join(group) for group in found[:NAMED])
    return f"{named} and {len(found) - NAMED} more groups" if len(found) > NAMED else named
