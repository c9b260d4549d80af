"""Blunders among the points of a sheet, judged on the plane that the sheet was drawn on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from termsel import FeatureSet, FitData, TermselError
from termsel.toolkit import BoolArray
from termsel.toolkit.coordinates import LOCAL, horizontal_crs, transformation_between
from termsel.toolkit.models import find_blunders


def blunders_in(sheet: FeatureSet, projection: str) -> BoolArray | None:
    """Return which points of a sheet are blunders on the plane of a projection, (n,).

    `projection` is a CRS, "" for that of the points. Points that cannot be decided about count as
    blunders. None if there are too few points for a test, or if one has no coordinates in the
    projection.
    """
    # On the plane of its projection a sheet is nearly affine, so that few points show a blunder.
    points = sheet.points
    ground = points.ground
    if projection and sheet.crs not in ("", LOCAL):
        try:
            to_plane = transformation_between(horizontal_crs(sheet.crs), projection, for_fit=True)
            plan = to_plane(np.column_stack([ground[:, :2], np.zeros(len(points))]))[:, :2]
        except TermselError:
            return None
        ground = np.column_stack([plan, ground[:, 2]])
    on_plane = FeatureSet(replace(points, ground=ground), crs=projection or sheet.crs)
    suspects = find_blunders(FitData.of(on_plane))
    # A point that may be a blunder must not influence the choice of a projection.
    return None if suspects is None else suspects.blunders | suspects.undecided
