"""The projection in which plane control is fitted, where its own coordinates bend a map."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from termsel.auto.auto import Auto
from termsel.auto.rule import Choice
from termsel.core.errors import TermselError
from termsel.data.coordinates.crs import (
    LOCAL,
    axes_of_degrees,
    longitudes_and_latitudes_of,
    normalise,
    short_crs_name,
    transformation_between,
)
from termsel.data.coordinates.longitudes import TURN, turn_of, unwrap_longitudes
from termsel.data.coordinates.metres import (
    azimuthal_crs,
    crss_of_the_world,
    is_in_degrees,
    mercator_crs,
    scales_at,
)
from termsel.data.features import FeatureSet, FloatArray
from termsel.data.record.search import FITTED_IN
from termsel.data.roles import Observations

FEW = 5
"""Points from which on held-out errors tell projections apart."""

LATTICE = 5
"""Places along each side of the rectangle around the points, where the bend is computed."""

PERCEPTIBLE = 0.5
"""Bend [px] from which on fewer points are fitted in Lambert's projection: what is less is hardly
measured."""

NOTICEABLE = 0.2
"""Bend of one projection in another, by the error of held-out points, from which on it is tried:
what is less adds two hundredths to that error, as squares do."""

CLEARLY = 1.1
"""How many times as large the error of held-out points must be in the coordinates as they are: of
few points a smaller difference is chance."""

WORST_PART = 0.1
"""Part of ten held-out points and more, the worst, that decides nothing: one blunder is more than
all that projections differ by."""


WIDE = np.radians(120.0)
"""Range of longitudes from which on a map may be one of the world, in Robinson's, Winkel's or
Mollweide's projection."""

NEAR_GREENWICH = 30
"""Longitude of the middle of control [deg] up to which a map of the world is taken to have the
meridian of Greenwich in its middle: control is seldom at both edges."""


def with_map_projection(observations: Observations, auto: Auto) -> tuple[Observations, str]:
    """Return observations to be fitted in the projection that predicts best, and a note on it.

    A map of a country is bent in degrees, as meridians meet, and one in Web Mercator, whose scale
    grows to the poles; most were drawn in neither. Lambert's azimuthal projection about the middle
    of the control stands for all that are nearly true to scale there: they differ from each other
    by less than each from degrees. Mercator's stands for maps of the world. One of them is taken
    where points held out of the choice of a model are predicted better in it than in the
    coordinates as they are. Fewer than `FEW` points cannot tell; they are fitted in Lambert's
    projection, as more maps are true to scale than show degrees as squares. The note is "" where
    the coordinates stay as they are. Independent points take no part.

    A projection is tried only where heights play no part, where nothing states the geometry (a CRS
    of the fit, an RPC, a method that is asked for), and where the coordinates differ from the
    projection by what could matter.
    """
    features = observations.together
    as_given = observations, ""
    if (features.fit_crs or features.rpc is not None or observations.heights
            or auto.is_one_method or len(features.points) < 2):
        return as_given
    angles_of = _longitudes_and_latitudes_of(features)
    if angles_of is None:
        return as_given
    plan = _plan(features)
    bend = _nonlinearity(plan, features.points.image, angles_of)
    choice = None
    # Few points cannot tell by their errors: what anybody would see decides.
    if len(features.points) < FEW:
        least_bend = PERCEPTIBLE
    else:
        choice = auto.choose(observations.pool)
        least_bend = np.inf if choice is None else NOTICEABLE * _typical_error(choice)
    if bend < least_bend:
        return as_given
    middle_lon, middle_lat = _middle(angles_of(plan)).tolist()
    lon, lat = _whole_degrees(middle_lon), round(np.degrees(middle_lat))
    given = "degrees" if is_in_degrees(features.crs) else short_crs_name(features.crs)
    bent = f"{given} would bend a map that is true to scale by {bend:.2g} px"
    try:
        azimuthal = azimuthal_crs(features.crs, lon, lat)
        transformation_between(features.crs, azimuthal, for_fit=True)
    except TermselError as error:  # pyproj, or the grid of a vertical datum, is not there
        remedy = f" {error.hint}" if error.hint else ""
        return observations, f"No projection was tried, though {bent}: {error.what}.{remedy}"
    if choice is None:
        in_azimuthal = observations.fitted_in(azimuthal)
        return in_azimuthal, _note(in_azimuthal, bent)
    # A projection must be clearly better than the coordinates as they are.
    error_as_given = _typical_error(choice)
    best, best_error = None, error_as_given / CLEARLY
    for crs in (azimuthal, *_projections_of_the_world(features, plan, angles_of)):
        projected = observations.fitted_in(crs)
        held_out_error = _held_out_error_in(projected, auto)
        if held_out_error < best_error:
            best, best_error = projected, held_out_error
    if best is None:
        return as_given
    return best, _note(
        best, f"there held-out points are predicted within {best_error:.3g} px, in {given} within "
              f"{error_as_given:.3g} px (RMSE; of ten points and more without the worst tenth)")


def _projections_of_the_world(
        features: FeatureSet, plan: FloatArray,
        angles_of: Callable[[FloatArray], FloatArray]) -> tuple[str, ...]:
    """Return the projections to try for maps of the world.

    `angles_of` takes x and y, such as those of the control, `plan` (n, 2), to longitudes and
    latitudes [rad].
    """
    crs = features.crs
    angles = angles_of(plan)
    lon = _whole_degrees(_middle(angles)[0])
    if np.ptp(angles[:, 0]) < WIDE:
        return (mercator_crs(crs, lon),)
    # Mercator's projection is the same about any meridian, but for where it is cut. A map of more
    # than half of the world is cut at its edges, both of which are its places.
    meridian_of_map = lon
    if features.x_start is not None:
        middle = [features.x_start + turn_of(crs) / 2.0, plan[:, 1].mean()]
        meridian_of_map = _whole_degrees(angles_of(np.array([middle]))[0, 0])
    # x is the longitude times a function of the latitude, and bends about another meridian. That of
    # Greenwich may be in the middle of 360 degrees that hold the control.
    widest = (360.0 - np.degrees(np.ptp(angles[:, 0]))) / 2.0
    meridians = [0] if abs(lon) <= max(widest, NEAR_GREENWICH) else []
    if abs(lon) > NEAR_GREENWICH:
        meridians.append(lon)
    ovals = [crs_of_oval for meridian in meridians
             for crs_of_oval in crss_of_the_world(crs, meridian)]
    return (mercator_crs(crs, meridian_of_map), *ovals)


def _whole_degrees(longitude: float) -> int:
    """Return a longitude [rad] in whole degrees from -180 up to 180."""
    return (round(float(np.degrees(longitude))) + 180) % 360 - 180


def _note(observations: Observations, reason: str) -> str:
    """Return the note on the projection of the fit, and why it is taken."""
    features = observations.features
    return (f"{FITTED_IN}{short_crs_name(features.fit_crs)}: {reason}. Coordinates stay in "
            f"{short_crs_name(features.crs)}; --fit-crs takes a CRS of yours.")


def _plan(features: FeatureSet) -> FloatArray:
    """Return x and y of points, (n, 2); longitudes go on beyond 180 degrees."""
    plan = features.points.ground[:, :2]
    # Those of a map of more than half of the world go on as they are.
    if not is_in_degrees(features.crs) or features.x_start is not None:
        return plan
    unit, _ = axes_of_degrees(normalise(features.crs))
    return np.column_stack([unwrap_longitudes(plan[:, 0], TURN / unit), plan[:, 1]])


def _longitudes_and_latitudes_of(
        features: FeatureSet) -> Callable[[FloatArray], FloatArray] | None:
    """Return a function from x and y (n, 2) to longitudes and latitudes [rad].

    Returns None where x and y are nearly true to scale, as those of UTM and of national grids are,
    and where nobody knows what they are.
    """
    if normalise(features.crs) == LOCAL:
        return None
    if is_in_degrees(features.crs):
        # Features made in Python may count in gons, as CRSs of France do.
        unit, _ = axes_of_degrees(normalise(features.crs))
        return lambda plan: np.radians(plan * unit)
    if scales_at(features.crs, features.points.ground) is None:
        return None
    return longitudes_and_latitudes_of(features.crs)


def _middle(angles: FloatArray) -> FloatArray:
    """Return the middle of longitudes and latitudes (n, 2)."""
    return np.asarray((angles.min(axis=0) + angles.max(axis=0)) / 2.0)


def _lambert_azimuthal(angles: FloatArray) -> FloatArray:
    """Return Lambert's azimuthal projection of a sphere about the middle, (n, 2) [radii].

    Snyder (1987, Map Projections: A Working Manual, eq. 22-4, 22-5 and 24-2): with
    k^2 = 2 / (1 + cos c), c the distance from the middle, x = k cos(lat) sin(lon) and
    y = k (cos(lat0) sin(lat) - sin(lat0) cos(lat) cos(lon)), longitudes from the middle.
    """
    middle_lon, middle_lat = _middle(angles)
    lon = angles[:, 0] - middle_lon
    lat = angles[:, 1]
    cos_distance = (np.sin(middle_lat) * np.sin(lat)
                    + np.cos(middle_lat) * np.cos(lat) * np.cos(lon))
    # Opposite of the middle there is no projection; a floor keeps it finite.
    k = np.sqrt(2.0 / np.maximum(1.0 + cos_distance, 1e-9))
    return np.column_stack([
        k * np.cos(lat) * np.sin(lon),
        k * (np.cos(middle_lat) * np.sin(lat) - np.sin(middle_lat) * np.cos(lat) * np.cos(lon))])


def _nonlinearity(plan: FloatArray, image: FloatArray,
                  angles_of: Callable[[FloatArray], FloatArray]) -> float:
    """Return how far Lambert's projection differs from x and y as they are, in the image [px].

    It is the RMS of what no affine map of x and y explains of the projection, over a lattice on the
    rectangle around the points: of three points nothing would be left. 0 where there are places
    that have no longitude and latitude.

    Parameters
    ----------
    plan, image : ndarray, shape (n, 2)
        x and y of points, and their lines and samples [px].
    angles_of : callable
        From x and y to longitudes and latitudes [rad].
    """
    axes = np.linspace(plan.min(axis=0), plan.max(axis=0), LATTICE)
    lattice = np.stack(np.meshgrid(*axes.T), axis=-1).reshape(-1, 2)
    angles = angles_of(np.vstack([lattice, plan]))
    if not np.isfinite(angles).all():
        return 0.0
    projected = _lambert_azimuthal(angles)
    on_lattice, of_points = projected[:len(lattice)], projected[len(lattice):]
    design = _affine_columns(lattice)
    bent = on_lattice - design @ np.linalg.lstsq(design, on_lattice, rcond=None)[0]
    # How many px a step in the projection is: the linear part of an affine fit of the image.
    to_image = np.linalg.lstsq(_affine_columns(of_points), image, rcond=None)[0][1:]
    return float(np.sqrt(((bent @ to_image) ** 2).sum(axis=1).mean()))


def _affine_columns(plan: FloatArray) -> FloatArray:
    """Return the columns 1, x and y of an affine map, (n, 3), from the middle of the positions."""
    return np.hstack([np.ones((len(plan), 1)), plan - plan.mean(axis=0)])


def _held_out_error_in(projected: Observations, auto: Auto) -> float:
    """Return the typical error of held-out points [px] where models are fitted in a projection.

    `projected` are the observations with that projection as the CRS of their fit. The error is
    infinite where no model can be chosen.
    """
    try:
        choice = auto.choose(projected.pool)
    except TermselError:  # places that the projection does not show
        return np.inf
    return np.inf if choice is None else _typical_error(choice)


def _typical_error(choice: Choice) -> float:
    """Return the RMSE of held-out features [px], of ten and more without the worst of them."""
    squares = np.sort(choice.chosen.held_out().squares)
    if not len(squares):
        return np.inf
    kept = len(squares) - int(WORST_PART * len(squares))
    return float(np.sqrt(squares[:kept].mean()))
