"""The RPC that is given with the features: of which image it is, and whether it can be used."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from termsel.core.errors import TermselError
from termsel.data.coordinates.crs import LOCAL, normalise, to_wgs84
from termsel.data.coordinates.height_units import FOOT, UNITS
from termsel.data.features import FeatureSet, FloatArray
from termsel.data.rpc import Rpc
from termsel.models.image_part import ImagePart, recognised
from termsel.runs.request import Request

_OUTSIDE = 2.0
"""Half ranges of the RPC's heights from their middle beyond which heights are surely outside."""
_NEARER = 0.5
"""Part of the distance to the measured places that feet must leave."""


def part_of_rpc(control: FeatureSet) -> ImagePart | None:
    """Return what the image of control is of that of its RPC, if this is another one.

    Raises TermselError if the heights of control refer to another surface than the ellipsoid, and
    PROJ cannot convert them.
    """
    rpc = control.rpc
    if rpc is None or normalise(control.crs) == LOCAL:
        return None
    # Heights that are not known say nothing of the place in the RPC.
    points = control.points.take(np.isfinite(control.points.ground).all(axis=1))
    try:
        positions = to_wgs84(control.crs)(points.ground)
    except TermselError as error:
        raise TermselError(f"the RPC takes ellipsoidal heights, and {error.what}",
                           hint=error.hint) from error
    # Before the part is recognised: wrong units look like another part.
    _refuse_feet(rpc, positions, points.image)
    with np.errstate(all="ignore"):
        return recognised(rpc.project(positions), points.image)


def _refuse_feet(rpc: Rpc, positions: FloatArray, image: FloatArray) -> None:
    """Refuse heights that the RPC holds as feet alone, and sees the points by much better.

    As metres they move the points, and another part of the image would seem to explain that.
    """
    if not len(positions):
        return
    # The range of an RPC is its offset plus and minus its scale.
    middle = rpc.ground_offset[2]
    half = rpc.ground_scale[2]
    in_metres = positions * [1.0, 1.0, UNITS[FOOT]]
    metres, feet = (float(np.median(heights)) for heights in (in_metres[:, 2], positions[:, 2]))
    # Plausible as metres, or implausible as feet: then there is nothing to refuse.
    if abs(feet - middle) <= _OUTSIDE * half or abs(metres - middle) > half:
        return
    with np.errstate(all="ignore"):
        distances = [np.linalg.norm(rpc.project(ground) - image, axis=1)
                     for ground in (positions, in_metres)]
        as_read, converted = (float(np.nanmedian(lengths)) for lengths in distances)
    # Feet must explain at least half of the distance, or something else is wrong.
    if converted < as_read * _NEARER:
        raise TermselError(
            f"the heights of the control, {feet:,.0f} m (median), are outside those of the RPC, "
            f"{middle - half:,.0f} to {middle + half:,.0f} m. As feet they are inside, and the RPC "
            f"sees the points {converted:,.0f} px from where they were measured, in place of "
            f"{as_read:,.0f} px", hint="State the unit of z: --set z_unit=ft (or us-ft).")


def with_part(request: Request, image_part: ImagePart) -> Request:
    """Return a request whose RPC is that of the part."""
    rpc = request.features.rpc
    assert rpc is not None
    features = replace(request.features, rpc=image_part.rpc(rpc))
    return replace(request, features=features, rpc_part=image_part)
