"""Which projection predicts the points of a map, or of a series of sheets, best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from termsel import FeatureSet, FitData, TermselError
from termsel.toolkit.models import Auto
from termsel_photos.sheets.candidates import Projection

NEARLY = 1.02
"""RMSE by that of the best, up to which the first of several projections is taken: they predict
alike."""

FEWEST = 4
"""Points from which on a sheet tells projections apart."""


@dataclass(frozen=True)
class Tried:
    """A projection that was tried.

    Parameters
    ----------
    name, crs : str
    rmse : float
        Of points held out of the choice of the model in this projection [px]: of several sheets
        the geometric mean. Infinite where no model is determined.
    """

    name: str
    crs: str
    rmse: float


def tried_projections(sheets: Sequence[FeatureSet],
                      candidates: Sequence[Projection]) -> list[Tried]:
    """Return how well each projection predicts the points of all sheets, the best first.

    Each candidate has a `name` and a `crs`. Independent points take no part. Sheets of a series
    were drawn in one projection, so that the product of their squared errors counts, each to the
    power of its number of points: a sheet of few points borrows from the others.
    """
    parts = [_choosing_part(sheet) for sheet in sheets]
    parts = [part for part in parts if len(part.points) >= FEWEST]
    if not parts:
        raise TermselError(f"no map has the {FEWEST} points that tell projections apart",
                           hint="Measure more points, or state the projection.")
    tried = []
    for candidate in candidates:
        name, crs = candidate.name, candidate.crs
        logs = [(len(part.points), np.log(_predicted(part, crs))) for part in parts]
        weights, values = zip(*logs, strict=True)
        tried.append(Tried(name, crs, float(np.exp(np.average(values, weights=weights)))))
    return sorted(tried, key=lambda one: one.rmse)


def chosen_of(tried: Sequence[Tried], candidates: Sequence[Projection]) -> Tried:
    """Return the projection that is taken: of those that predict alike the first candidate."""
    best = tried[0].rmse
    if not np.isfinite(best):
        raise TermselError("in no projection the points determine a model",
                           hint="Measure more points, spread over the map.")
    alike = {one.crs: one for one in tried if one.rmse <= NEARLY * best}
    return next(alike[candidate.crs] for candidate in candidates
                if candidate.crs in alike)


def _choosing_part(features: FeatureSet) -> FeatureSet:
    points = features.points
    roles = points.roles or ("",) * len(points)
    return features.with_(points=points.take(
        [role not in ("independent", "off") for role in roles]))


def _predicted(features: FeatureSet, crs: str) -> float:
    """Return the RMSE of held-out points [px] in a projection; infinite where there is none."""
    try:
        choice = Auto().choose(FitData.of(replace(features, fit_crs=crs)))
    except TermselError:
        return np.inf
    return np.inf if choice is None else max(choice.chosen.held_out_rmse, 1e-9)
