"""A pushbroom scanner in orbit over a place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from termsel.core.errors import TermselError
from termsel.data.coordinates.wgs84 import to_ecef
from termsel.data.features import FloatArray
from termsel.simulate.pushbroom import ITERATIONS, Angle, Pushbroom


def pushbroom_at(
    lon: float,
    lat: float,
    *,
    height: float = 0.0,
    off_nadir: float = 0.0,
    look_azimuth: float = 90.0,
    gsd: float,
    image_size: tuple[int, int],
    altitude: float,
    inclination: float,
    refraction: bool = True,
) -> Pushbroom:
    """Return a pushbroom whose image is centred at a place, on a descending pass.

    Parameters
    ----------
    lon, lat, height : float
        Centre of the image: WGS84 longitude, latitude [deg], ellipsoidal height [m].
    off_nadir : float
        Angle at the satellite between the Earth's centre and the ray to that place [deg].
    look_azimuth : float
        Direction of the ray relative to the flight direction [deg]: 0 ahead, 90 to starboard.
    gsd : float
        Distance on the ground between neighbouring pixels at the centre, both ways [m].
    image_size : tuple of int
        Lines and samples [px].
    altitude : float
        Radius of the orbit above the WGS84 semi-major axis [m].
    inclination : float
        Inclination of the orbit [deg].
    refraction : bool
        Whether rays are bent by the atmosphere.

    Returns
    -------
    Pushbroom
        With constant attitude; give it drift and jitter with `dataclasses.replace`.

    Raises
    ------
    TermselError
        If no such orbit reaches the latitude, or none whose view is so oblique.

    Examples
    --------
    >>> from termsel.simulate import pushbroom_at
    >>> scanner = pushbroom_at(48.5, 34.8, off_nadir=20.0, gsd=1.0, image_size=(1000, 800),
    ...                        altitude=681_000.0, inclination=98.1)
    >>> middle = scanner.project([[48.5, 34.8, 0.0]])
    >>> middle.round(1).tolist()
    [[499.5, 399.5]]
    """
    tilt = np.radians(off_nadir)
    turn = np.radians(look_azimuth)
    # The ray (sin(tilt) cos(turn), sin(tilt) sin(turn), cos(tilt)) in the orbital frame.
    roll = -np.arctan2(np.sin(tilt) * np.sin(turn), np.cos(tilt))
    pitch = np.arcsin(np.sin(tilt) * np.cos(turn))
    ratio = np.sin(np.radians(lat)) / np.sin(np.radians(inclination))
    if abs(ratio) >= 1:
        raise TermselError(f"an orbit of {inclination:g} deg does not reach latitude {lat:g} deg",
                           hint="Choose an inclination nearer to 90 deg.")
    # sin(latitude) = sin(inclination) sin(argument); past 90 deg the pass descends.
    argument = 180 - float(np.degrees(np.arcsin(ratio)))
    # Both scales are approximate, with 7000 m/s over the ground; they are made exact at the end.
    sensor = Pushbroom(altitude, inclination, 0.0, argument, *image_size,
                       ifov=gsd / altitude, line_period=gsd / 7000,
                       roll=Angle((float(roll),)), pitch=Angle((float(pitch),)),
                       refraction=refraction)

    def positions_seen(candidate: Pushbroom) -> FloatArray:
        """Return longitude and latitude of the centre, and of the next pixels below and beside it.
        """
        line, sample = candidate.centre
        return candidate.locate([[line, sample], [line + 1, sample], [line, sample + 1]], height)

    # Relative to the node the scene is the same for every longitude of the node: find the
    # argument that gives the latitude (descending: a larger argument lies further south),
    # then turn the orbit.
    for _ in range(ITERATIONS):
        error = float(positions_seen(sensor)[0, 1]) - lat
        if abs(error) < 1e-12:
            break
        sensor = replace(sensor, argument=sensor.argument + error)
    else:
        raise TermselError(f"no view {off_nadir:g} deg off nadir reaches latitude {lat:g} deg",
                           hint="Choose a smaller off-nadir angle.")
    sensor = replace(sensor, node=(lon - float(positions_seen(sensor)[0, 0]) + 180) % 360 - 180)
    pixel_corners = to_ecef(np.column_stack([positions_seen(sensor), np.full(3, height)]))
    line_spacing, sample_spacing = np.linalg.norm(pixel_corners[1:] - pixel_corners[0], axis=1)
    return replace(sensor, line_period=sensor.line_period * gsd / float(line_spacing),
                   ifov=sensor.ifov * gsd / float(sample_spacing))
