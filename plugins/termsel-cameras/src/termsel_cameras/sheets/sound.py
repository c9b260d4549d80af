"""Blunders among the points of a sheet, judged on the plane that the sheet was drawn on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from termsel import FeatureSet, FitData, TermselError
from termsel.toolkit import BoolArray
from termsel.toolkit.coordinates import LOCAL, horizontal_crs, transformation_between
from termsel.toolkit.models import find_blunders


def blunders_in(sheet: FeatureSet, projection: str) -> BoolArray | None:
    """Return which points are blunders on the plane of a projection, (n,), "" for their own CRS.

    On its plane a sheet is nearly affine, so that ten points show what they do not in degrees.
    None where they are too few for a test, or the projection has not all of their places.
    """
    points = sheet.points
    ground = points.ground
    if projection and sheet.crs not in ("", LOCAL):
        try:
            to_plane = transformation_between(horizontal_crs(sheet.crs), projection, for_fit=True)
            plan = to_plane(np.column_stack([ground[:, :2], np.zeros(len(points))]))[:, :2]
        except TermselError:  # places that the projection has not
            return None
        ground = np.column_stack([plan, ground[:, 2]])
    on_plane = FeatureSet(replace(points, ground=ground), crs=projection or sheet.crs)
    suspects = find_blunders(FitData.of(on_plane))
    # Who cannot be decided about must not decide either.
    return None if suspects is None else suspects.blunders | suspects.undecided
