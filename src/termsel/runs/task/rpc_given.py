"""The RPC that is given with the features: of which image it is, and whether it can be used."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from termsel.errors import TermselError
from termsel.measurements.coordinates.crs import LOCAL, normalise, to_wgs84
from termsel.measurements.features import FeatureSet
from termsel.models.image_part import ImagePart, recognised
from termsel.models.rpc import Rpc
from termsel.runs.task.request import Setup


def part_of_rpc(control: FeatureSet) -> ImagePart | None:
    """Return what the image of control is of that of its RPC, if this is another one.

    Raises TermselError if the heights of control refer to another surface than the ellipsoid, and
    PROJ cannot convert them.
    """
    rpc = control.rpc
    if not isinstance(rpc, Rpc) or normalise(control.crs) == LOCAL:
        return None
    points = control.points.take(np.isfinite(control.points.ground).all(axis=1))
    try:
        places = to_wgs84(control.crs)(points.ground)
    except TermselError as error:
        raise TermselError(f"the RPC takes ellipsoidal heights, and {error.what}",
                           hint=error.hint) from error
    with np.errstate(all="ignore"):
        return recognised(rpc.project(places), points.image)


def with_part(setup: Setup, part: ImagePart) -> Setup:
    """Return a setup whose RPC is that of the part."""
    rpc = setup.features.rpc
    assert isinstance(rpc, Rpc)
    return replace(setup, features=replace(setup.features, rpc=part.rpc(rpc)), rpc_part=part)
