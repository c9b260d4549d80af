"""The coordinates models are fitted in: geodetic, projected, geocentric, or those given."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from termsel.auto.auto import Auto
from termsel.core.errors import TermselError
from termsel.core.options import Option
from termsel.core.remedies import Remedy
from termsel.data.coordinates.crs import (
    EARTH,
    LOCAL,
    WGS84,
    body_of,
    geodetic_of,
    horizontal_crs,
    is_geocentric,
    kind_of,
    normalise,
    transformation_between,
)
from termsel.data.coordinates.longitudes import unwrap_longitudes
from termsel.data.coordinates.metres import (
    POLAR_LATITUDE,
    is_in_degrees,
    is_polar,
    metric_crs,
    polar_crs,
)
from termsel.data.features import FeatureSet, FloatArray
from termsel.data.fit_data import FitData
from termsel.data.roles import Observations
from termsel.models.base import SensorModel

log = logging.getLogger(__name__)

AUTO = "auto"
MAX_CRS_NAME = 40
"""Characters from which on the name of a CRS does not fit into a sentence."""

POLAR = "polar"
SYSTEMS = ("geodetic", "projected", "geocentric", POLAR)
"""Kinds of coordinates."""

FIT_CRS = Option(
    "fit_crs", None, "CRS the model is fitted in; by default that of the ground coordinates. "
    "geodetic is WGS84 longitude, latitude and ellipsoidal height; projected is the UTM zone of "
    "the control (on another body than the Earth a transverse Mercator projection); geocentric is "
    "WGS84 X, Y, Z; polar a polar stereographic projection; EPSG:n is any other. auto takes the "
    "one of these that predicts best by leave-one-out, a polar one where the control lies around a "
    "pole. Coordinates of files and results stay in "
    "their own CRS.")


def with_fit_crs(choice: str, observations: Observations, model: SensorModel) -> Observations:
    """Return observations that say in which CRS a model is fitted, by the option `FIT_CRS`.

    Independent points take no part in the choice of a UTM zone or of a CRS. Refuses "local"
    coordinates, an unknown CRS, and coordinates that pyproj cannot transform or without pyproj; for
    geocentric ones a plane model, and features whose heights are unknown or all alike.
    """
    features = observations.features
    control = observations.control
    if normalise(features.crs) == LOCAL:
        raise TermselError(f"--fit-crs {choice}: plane coordinates without a CRS cannot be turned "
                           "into others", hint="State the CRS of the ground coordinates, or leave "
                                               "--fit-crs out.")
    # Geocentric axes mix plan and height, so that a plane model cannot use them.
    spatial = model.uses_height and observations.heights
    if choice == AUTO:
        fit_crs = _best_predicting_crs(observations, spatial)
    else:
        fit_crs = fit_crs_of(choice, control)
        if not spatial and is_geocentric(fit_crs):
            raise TermselError(
                f"geocentric coordinates need heights that are known and differ, and model "
                f"{model.name!r} " + ("finds none" if model.uses_height else "has none"),
                hint="Give heights and choose a model with heights, such as "
                     f"{Remedy('model', 'poly3d')}; or fit in geodetic or projected coordinates.")
    # What cannot be transformed is said now.
    for ground in (control.ground_vertices(), observations.check.ground,
                   observations.independent.ground):
        transformation_between(features.crs, fit_crs, for_fit=True)(ground)
    # 2D and 3D WGS84 are the same coordinates.
    if fit_crs == normalise(features.crs) or WGS84.issuperset((fit_crs, normalise(features.crs))):
        fit_crs = ""
    return observations.fitted_in(fit_crs)


def fit_crs_of(choice: str, control: FeatureSet) -> str:
    """Return the CRS in which to fit control that has a CRS, by its name or text.

    The choice is one of `SYSTEMS`, such as "projected", or a CRS by its own name. Raises
    TermselError if the choice is no CRS, or none for this control.
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
    if choice == "geodetic":
        return geodetic_of(control.crs)
    if choice == "projected":
        return _local_crs(control)
    if choice == POLAR:
        return polar_crs(control.crs, float(np.median(_control_on_globe(control)[:, 1])))
    if (body := body_of(control.crs)) != EARTH:
        raise TermselError(f"geocentric coordinates are for {EARTH} only, and the control is on "
                           f"{body}", hint="Fit in geodetic or projected coordinates.")
    return "EPSG:4978"


def _local_crs(control: FeatureSet) -> str:
    """Return the CRS in metres around the middle of the control."""
    angles = _control_on_globe(control)
    lon, lat = ((angles.min(axis=0) + angles.max(axis=0)) / 2).tolist()
    return metric_crs(control.crs, lon, lat)


def _control_on_globe(control: FeatureSet) -> FloatArray:
    """Return longitudes without a jump and latitudes [deg] of the control, (v, 2)."""
    source = normalise(control.crs)
    geodetic = geodetic_of(source)
    if not is_geocentric(source):
        # Heights of another datum may need a grid that is not there, and say nothing of the place.
        source, geodetic = horizontal_crs(source), horizontal_crs(geodetic)
    positions = transformation_between(source, geodetic)(control.ground_vertices())
    return np.column_stack([unwrap_longitudes(positions[:, 0]), positions[:, 1]])


def note_on_pole(features: FeatureSet, control: FeatureSet) -> str:
    """Return a note on control around a pole, with the option that fits it better.

    Returns "" for control elsewhere, for other coordinates than degrees, and where a CRS of the fit
    is chosen already.
    """
    crs = normalise(features.crs)
    if features.fit_crs or not is_in_degrees(features.crs) or kind_of(crs) != "geographic":
        return ""
    # Of another datum latitudes differ by far less than a degree.
    if np.abs(control.ground_vertices()[:, 1]).max(initial=0.0) < POLAR_LATITUDE - 1.0:
        return ""
    geodetic = _control_on_globe(control)
    if not is_polar(geodetic):
        return ""
    polar = polar_crs(features.crs, float(np.median(geodetic[:, 1])))
    name = f" ({polar})" if len(polar) < MAX_CRS_NAME else ""
    return ("The control lies around a pole, where degrees of longitude are no plane coordinates: "
            f"--fit-crs polar{name} or --fit-crs auto fits in metres.")


def with_polar(observations: Observations) -> Observations:
    """Return observations to be fitted in a polar projection where control is around a pole.

    Only where no CRS is asked for and no RPC given, and the best of the plain and regularised
    models predicts better there, by leave-one-out over control and check, than in the coordinates
    as they are. Else the same observations are returned.
    """
    features = observations.together
    if (features.fit_crs or features.rpc is not None
            or not note_on_pole(features, observations.control)):
        return observations
    # Around a pole degrees of longitude shrink to nothing, and so does what they explain.
    polar = fit_crs_of(POLAR, observations.control)
    try:
        transformation_between(features.crs, polar, for_fit=True)
    except TermselError:  # heights of another datum, whose grid is not there
        return observations
    # Both choices see control and selection points alone.
    as_given = Auto().choose(FitData.of(features, observations.heights))
    in_polar = Auto().choose(FitData.of(replace(features, fit_crs=polar), observations.heights))
    if in_polar is None or (as_given is not None
                            and as_given.chosen.held_out_rmse <= in_polar.chosen.held_out_rmse):
        return observations
    return observations.fitted_in(polar)


def _best_predicting_crs(observations: Observations, spatial: bool) -> str:
    """Return the CRS in which the best of the plain and regularised models predicts best.

    That is the least RMSE of held-out control [px]. The systems tried are `SYSTEMS`: geocentric
    coordinates only if the model is `spatial`, and polar ones only near a pole. If no model can be
    tested in any, it is the CRS of the features. What was left out, and the errors in each, are
    logged.
    """
    features = observations.together
    predicted: dict[str, float] = {}
    for system in SYSTEMS:
        # Not every system is possible for every model and body.
        if system == "geocentric" and not (spatial and body_of(features.crs) == EARTH):
            continue
        if system == POLAR and not is_polar(_control_on_globe(observations.control)):
            continue
        try:
            fit_crs = fit_crs_of(system, observations.control)
            choice = Auto().choose(FitData.of(
                replace(features, fit_crs=fit_crs), observations.heights))
        except TermselError as error:  # such as no zone of UTM: it is no candidate here
            log.info("%s coordinates are left out: %s.", system, error.what)
            continue
        # Held-out errors are in px in all of these systems, so that they compare.
        predicted[fit_crs] = np.inf if choice is None else choice.chosen.held_out_rmse
    if not predicted:
        return normalise(features.crs)
    best = min(predicted, key=lambda crs: predicted[crs])
    if not np.isfinite(predicted[best]):
        return normalise(features.crs)
    log.info("Fitted in %s; by leave-one-out %s pixel.", best, ", ".join(
        f"{crs} {value:.3f}" for crs, value in predicted.items()))
    return best

