"""Notes on the data themselves, whatever method they are used by."""

from __future__ import annotations

from collections.abc import Iterator

from termsel.measurements.features import FeatureSet
from termsel.measurements.longitudes import jumps
from termsel.measurements.roles import Observations, together


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
    z = together(observations).ground_vertices()[:, 2]
    if heights and len(z) > 1 and (z == z[0]).all():
        yield (f"All heights are {z[0]:g}, so they were not used. If they are not known, leave "
               "them blank or take them from a raster (--dem FILE).")
