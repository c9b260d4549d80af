"""Warn where a datum is changed less accurately than the control fits."""

from __future__ import annotations

import logging

from termsel.core.errors import rounded_size_text
from termsel.data.coordinates.crs import short_crs_name
from termsel.data.coordinates.datum_accuracy import stand_in_between
from termsel.data.coordinates.earth import degrees_of
from termsel.fitting.accuracy import pixel_on_ground
from termsel.fitting.fit import Fit

log = logging.getLogger(__name__)


def say_stand_in(fitted: Fit, target: str) -> None:
    """Warn if PROJ lacks a grid to a CRS, and what it has instead is worse than the control fits.

    Without a grid PROJ takes a transformation that may be metres off, silently. It matters only if
    that is more than the RMSE of the control on the ground. `target` is the CRS to which results
    are taken.
    """
    source = fitted.control.crs
    position = degrees_of(source, fitted.control.ground_vertices())
    stand_in = None if position is None else stand_in_between(source, target, position)
    if stand_in is None:
        return
    rmse = fitted.control_rmse()
    pixel = pixel_on_ground(fitted)
    fits = ""
    if rmse and pixel:
        # What the grid would gain is below what the control can show.
        on_ground = rmse.total * pixel
        if stand_in.accuracy <= on_ground:
            return
        fits = f"; the control fits to {rounded_size_text(on_ground)} m"
    log.warning(
        "Warning: PROJ does not have the grid %s. The transformation from %s to %s that it uses "
        "instead is accurate to %g m%s. Get the grid with pyproj sync --file %s, or set "
        "PROJ_NETWORK=ON.", stand_in.grid, short_crs_name(source), short_crs_name(target),
        stand_in.accuracy, fits, stand_in.grid)
