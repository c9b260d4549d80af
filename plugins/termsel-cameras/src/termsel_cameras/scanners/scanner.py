"""The physical model of a line scanner in orbit."""

from __future__ import annotations

from typing import Any

import numpy as np

from termsel import FeatureSet, Option
from termsel_cameras.scanners.orbit import (
    Cameras,
    FloatArray,
    axes_at,
    heading_of,
    observe_targets,
    to_geocentric,
)
from termsel_cameras.scanners.physical import Physical, require_scaling
from termsel_cameras.scanners.sensors import SENSORS, Sensor, sensor_named

RATE, CHANGE = 5e-5, 1e-6
"""Standard deviations of rates of attitude [rad/s], and of how these change [rad/s^2]."""

YAW_DEGREES = 3.0
"""Standard deviation of the angle between track and scan [deg]: yaw steering takes up to 4."""

EARTH_RADIUS = 6371e3
"""Radius of the Earth, which the motion of a satellite over the ground goes by [m]."""

SCANNER_TERMS = ("line", "sample", "heading", "side", "ahead", "altitude", "period", "pixel", "yaw",
                 "roll-rate", "pitch-rate", "yaw-rate", "roll-change", "pitch-change", "yaw-change",
                 "look-2", "look-3")


class Scanner(Physical):
    """Line scanner on a circular orbit: view, attitude with rates, interior; each with a prior.

    Terms are in standard deviations of what is known of the sensor beforehand; ``line`` and
    ``sample`` are the place where the middle of the control is seen, in scaled units, of which
    nothing is known. There are 17: the heading, the view to the side and ahead, the altitude, the
    line period and the pixel, yaw, rates and changes of attitude, and a polynomial of look
    angles. A term that is not selected has the value that is expected of it.

    Notes
    -----
    Circular orbit and attitude that is a polynomial of time as in V. Kratky, ISPRS J. Photogramm.
    Remote Sens. 44 (1989) 53-71. The prior is termsel's own. Not modelled: refraction, jitter.
    """

    name = "scanner"
    declared_options = (
        Option("sensor", "", "Sensor by name: " + ", ".join(SENSORS) + "; or a JSON file with its "
                             "constants. By default nothing is known of it."),
        Option("track", "descending", "Direction of the track.",
               choices=("descending", "ascending")))
    terms_ = SCANNER_TERMS
    free = 2

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.sensor: Sensor = sensor_named(self.options["sensor"])

    @property
    def source(self) -> str:
        """Where the constants of the sensor were published."""
        return self.sensor.source

    def starts(self, features: FeatureSet) -> FloatArray:
        """Return the values of terms from which fits begin, (5, k): views to either side."""
        starts = np.zeros((5, len(SCANNER_TERMS)))
        starts[:, SCANNER_TERMS.index("side")] = np.linspace(-1.6, 1.6, 5)
        return starts

    def image_of(self, values: FloatArray, ground: FloatArray) -> FloatArray:
        """Return scaled image positions (p, n, 2) of scaled ground positions by terms (p, k).

        The line is the time at which a point passes the plane of view, divided by the period of a
        line; the sample is the slope across the track, divided by the field of view of a pixel. NaN
        where a point is not seen.
        """
        scaling = require_scaling(self.scaling)
        sensor = self.sensor
        middle = self.geographic(np.zeros((1, 3)))
        axes = axes_at(*middle[0, :2])
        origin = to_geocentric(middle)[0]
        x = dict(zip(SCANNER_TERMS, values.T, strict=True))
        altitude = 1e3 * (sensor.altitude + sensor.altitude_sigma * x["altitude"])
        view = {name: np.tan(np.radians(getattr(sensor, name))) * x[name]
                for name in ("side", "ahead")}
        cameras = Cameras(
            heading_of(sensor.inclination, middle[0, 1],
                       ascending=self.options["track"] == "ascending")
            + np.radians(sensor.heading_sigma) * x["heading"],
            view["side"], view["ahead"] - np.tan(np.radians(sensor.forward)), altitude,
            np.radians(YAW_DEGREES) * x["yaw"],
            RATE * values[:, 9:12], CHANGE * values[:, 12:15])
        time_and_slope = observe_targets(
            cameras, to_geocentric(self.geographic(ground)), origin, axes)
        # An unknown sensor has the pixel that the extents of the control show.
        pixel = sensor.pixel or self._half_extent() / scaling.image_scale
        pixel_sigma = sensor.pixel_sigma
        ifov = pixel / (1e3 * sensor.altitude) * np.exp(pixel_sigma * x["pixel"])
        # A circular orbit has the angular speed sqrt(GM / r^3); lines follow as the point below
        # the satellite moves by a pixel.
        motion = np.sqrt(3.986004418e14 / (6378137.0 + altitude) ** 3)
        period = pixel / (motion * EARTH_RADIUS) * np.exp(pixel_sigma * x["period"])
        line = time_and_slope[..., 0] / period[:, None] / scaling.image_scale
        # Samples run to port. The terms of look angles move the ends of the control by 1 px each.
        sample = time_and_slope[..., 1] / ifov[:, None] / scaling.image_scale
        look_shift = ((x["look-2"][:, None] * sample**2 + x["look-3"][:, None] * sample**3)
                / scaling.image_scale)
        return np.stack([line + x["line"][:, None],
                         sample + look_shift + x["sample"][:, None]], axis=-1)

    def _half_extent(self) -> float:
        """Return the longer half extent of the control on the ground [m]."""
        corners = to_geocentric(self.geographic(np.array(
            [[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 1.0, 0.0]])))
        return float(max(np.linalg.norm(corners[1] - corners[0]),
                         np.linalg.norm(corners[3] - corners[2]))) / 2
