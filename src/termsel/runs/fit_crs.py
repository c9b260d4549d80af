"""The coordinates models are fitted in: geodetic, projected, geocentric, or those given."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from termsel.candidates.compare import has_heights
from termsel.candidates.portfolio import choose
from termsel.errors import TermselError
from termsel.measurements.crs import (
    LOCAL,
    WGS84,
    is_geocentric,
    normalise,
    to_wgs84,
    transformation,
)
from termsel.measurements.features import FeatureSet
from termsel.measurements.roles import Observations, together
from termsel.models.base import SensorModel
from termsel.options import Option

log = logging.getLogger(__name__)

AUTO = "auto"
SYSTEMS = {"geodetic": "EPSG:4979", "projected": "", "geocentric": "EPSG:4978"}
"""CRS of each kind of coordinates; the UTM zone of projected ones is that of the features."""

FIT_CRS = Option(
    "fit_crs", None, "CRS the model is fitted in; by default that of the ground coordinates. "
    "geodetic is WGS84 longitude, latitude and ellipsoidal height; projected is the UTM zone of "
    "the features; geocentric is WGS84 X, Y, Z; EPSG:n is any other. auto takes the one of the "
    "first three that predicts best by leave-one-out. Coordinates of files and results stay in "
    "their own CRS.")


def with_fit_crs(choice: str, features: FeatureSet, observations: Observations,
                 model: SensorModel) -> Observations:
    """Return observations that say in which CRS a model is fitted.

    Parameters
    ----------
    choice : str
        As the option `FIT_CRS` takes it.
    features : FeatureSet
    observations : Observations
        Made of the features.
    model : SensorModel

    Raises
    ------
    TermselError
        For "local" coordinates, an unknown CRS, coordinates that pyproj cannot transform or
        without pyproj; for geocentric coordinates under a plane model, or of features whose
        heights are unknown or all alike.
    """
    if normalise(features.crs) == LOCAL:
        raise TermselError(f"--fit-crs {choice}: plane coordinates without a CRS cannot be turned "
                           "into others", hint="State the CRS of the ground coordinates, or leave "
                                               "--fit-crs out.")
    spatial = model.uses_height and has_heights(observations)
    if choice == AUTO:
        fit_crs = _best(features, observations, spatial)
    else:
        fit_crs = fit_crs_of(choice, features)
        if not spatial and is_geocentric(fit_crs):
            raise TermselError(
                f"geocentric coordinates need heights that are known and differ, and model "
                f"{model.name!r} " + ("finds none" if model.uses_height else "has none"),
                hint="Give heights and choose a model with heights, such as --model poly3d; or "
                     "fit in geodetic or projected coordinates.")
    known = features.ground_vertices()
    transformation(features.crs, fit_crs)(known)  # what cannot be transformed is said now
    if fit_crs == normalise(features.crs) or WGS84.issuperset((fit_crs, normalise(features.crs))):
        fit_crs = ""
    return observations.fitted_in(fit_crs)


def fit_crs_of(choice: str, features: FeatureSet) -> str:
    """Return the name of a CRS.

    Parameters
    ----------
    choice : str
        "geodetic", "projected", "geocentric", or a CRS by its own name.
    features : FeatureSet
        In a CRS.

    Raises
    ------
    TermselError
        As `with_fit_crs`.
    """
    if choice not in SYSTEMS:
        try:
            name = normalise(choice)
        except TermselError as error:
            raise TermselError(
                f"option 'fit_crs' does not take {choice!r}: {error.what}",
                hint=f"It takes: {AUTO} | {' | '.join(SYSTEMS)} | EPSG:n.") from error
        if name == LOCAL:
            raise TermselError("option 'fit_crs' does not take 'local'",
                               hint="Leave it out to fit in the coordinates as they are.")
        return name
    return SYSTEMS[choice] or _utm_zone(features)


def _utm_zone(features: FeatureSet) -> str:
    """Return the UTM zone, on WGS84, of the middle of the features."""
    place = to_wgs84(features.crs)(features.ground_vertices())[:, :2]
    # Longitudes may go on beyond 180 degrees.
    lon, lat = (place.min(axis=0) + place.max(axis=0)) / 2
    lon = (lon + 180) % 360 - 180
    try:
        from pyproj.aoi import AreaOfInterest
        from pyproj.database import query_utm_crs_info
    except ImportError:
        raise TermselError("the UTM zone of the features needs the package pyproj, which is not "
                           "installed", hint='Install it: pip install "termsel[gis]".') from None
    zones = query_utm_crs_info("WGS 84", AreaOfInterest(lon, lat, lon, lat))
    if not zones:
        raise TermselError(f"no UTM zone holds longitude {lon:.6g}, latitude {lat:.6g}",
                           hint="UTM goes from 80 S to 84 N: name a projected CRS, --fit-crs "
                                "EPSG:n, such as EPSG:3031 or EPSG:3413.")
    return f"EPSG:{zones[0].code}"


def _best(features: FeatureSet, observations: Observations, spatial: bool) -> str:
    """Return the CRS in which the best of the plain and shrunken models predicts best."""
    both, heights = together(observations), has_heights(observations)
    predicted: dict[str, float] = {}
    for system in SYSTEMS:
        fit_crs = fit_crs_of(system, features)
        if is_geocentric(fit_crs) and not spatial:
            continue
        choice = choose(replace(both, fit_crs=fit_crs), heights)
        predicted[fit_crs] = np.inf if choice is None else choice.chosen.predicted
    best = min(predicted, key=lambda crs: predicted[crs])
    if not np.isfinite(predicted[best]):
        return normalise(features.crs)
    log.info("Fitted in %s; by leave-one-out %s pixel.", best, ", ".join(
        f"{crs} {value:.3f}" for crs, value in predicted.items()))
    return best

