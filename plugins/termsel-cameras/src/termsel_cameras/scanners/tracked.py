"""The scanner whose orbit and attitude a file of metadata has."""

from __future__ import annotations

from typing import Any

import numpy as np

from termsel import FeatureSet, Option, TermselError
from termsel_cameras.scanners.metadata import FloatArray, Metadata, metadata_of
from termsel_cameras.scanners.orbit import to_geocentric
from termsel_cameras.scanners.physical import Physical, require_scaling

SUFFIXES = (".dim", ".xml")
"""Names of files of metadata end so."""

TRACKED_TERMS = ("roll", "pitch", "yaw", "roll-rate", "pitch-rate", "yaw-rate", "period", "pixel")

ANGLE, TRACKED = 4e-4, 1e-4
"""Standard deviation of a bias of roll and pitch [rad], without and with a star tracker: Spot Image
states 350 m and 50 m on the ground, of which twice the latter is taken."""

YAW_SIGMA, RATE_SIGMA, PERIOD, PIXEL = 5e-4, 5e-6, 2e-5, 2e-4
"""Standard deviations of a bias of yaw [rad], of rates [rad/s], and of line period and pixel, as
parts of these."""

SECANT_STEPS, FIRST_STEP, ZERO_SLOPE = 20, 0.5, 1e-9
"""Steps of the secant method to the time at which a place is seen, the first one's length [s], and
the slope along the track that counts as none."""


class TrackedScanner(Physical):
    """Line scanner with orbit, attitude and look angles of a DIMAP file; biases have priors.

    Terms are in standard deviations of what is known beforehand. There are 8: biases of roll, pitch
    and yaw, their rates, line period and pixel. A term that is not selected is 0.

    Notes
    -----
    The geometry is that of the SPOT 123-4-5 Geometry Handbook, GAEL-P135-DOC-001 (2004). Positions
    are cubic Hermite polynomials between those of the file, angles are linear. The priors are
    termsel's own. Not modelled: refraction, jitter that the file does not have.
    """

    name = "scanner-dimap"
    declared_options = (
        Option("metadata", "", "Required: the DIMAP file of version 1 of a SPOT scene of level 1A. "
                               "A result contains what was read."),)
    terms_ = TRACKED_TERMS

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        metadata = self.options["metadata"]
        self._metadata = metadata_of(metadata) if metadata else None
        # A result must be readable without the file, so that its options have what the file says.
        if self._metadata is not None:
            self.options["metadata"] = self._metadata.text()

    @property
    def metadata(self) -> Metadata:
        """The metadata of the image: orbit, attitude and look angles.

        Raises
        ------
        TermselError
            If the option `metadata` names none.
        """
        if self._metadata is None:
            raise TermselError(f"model {self.name!r} requires the metadata of the image",
                               hint="Give the DIMAP file with --set metadata=FILE.")
        return self._metadata

    @property
    def source(self) -> str:
        """The file of metadata."""
        return self.metadata.source

    def starts(self, features: FeatureSet) -> FloatArray:
        """Return the values of terms from which a fit begins, (1, k): no correction."""
        return np.zeros((1, len(TRACKED_TERMS)))

    def image_of(self, values: FloatArray, ground: FloatArray) -> FloatArray:
        """Return scaled image positions (p, n, 2) of scaled ground positions by terms (p, k).

        The secant method finds the time at which a point is in the scan line; its look angle then
        gives the sample. NaN where no time is found.
        """
        metadata = self.metadata
        target = to_geocentric(self.geographic(ground))
        # Values of each term as (p, 1), so that they combine with times (p, n).
        x = dict(zip(TRACKED_TERMS, values.T[..., None], strict=True))
        angle = TRACKED if metadata.tracked else ANGLE
        bias = [YAW_SIGMA * x["yaw"], angle * x["pitch"], angle * x["roll"]]
        rate = [RATE_SIGMA * x[f"{name}-rate"] for name in ("yaw", "pitch", "roll")]
        samples = np.array(metadata.detectors)
        looks = np.tan(metadata.looks)
        # np.interp needs ascending look angles, which detectors may have from right to left.
        order = np.argsort(looks[:, 1])
        across = looks[order, 1]
        ahead = looks[order, 0]
        samples = samples[order]
        pixel_factor = 1.0 + PIXEL * x["pixel"]

        def view(time: FloatArray) -> tuple[FloatArray, FloatArray]:
            """Return the slopes of points ahead of the scan line and across the track, (p, n) each.

            `time` is (p, n) [s]. A point is seen when the first slope is 0.
            """
            station, axes = _interpolate_state(metadata, time)
            from_station = np.einsum("...ij,...i->...j", axes, target - station)
            attitude = [np.interp(time, metadata.moments, angles) + offset + time * drift
                        for angles, offset, drift in zip(
                            np.array(metadata.angles).T, bias, rate, strict=True)]
            in_camera = _turn_into_camera(from_station, attitude)
            # The look is (-tan PSI_Y, tan PSI_X, -1): to starboard, ahead and up.
            slope = in_camera[..., 0] / in_camera[..., 2] / pixel_factor
            ahead_of_camera = -in_camera[..., 1] / in_camera[..., 2]
            return ahead_of_camera - np.interp(slope, across, ahead), slope

        time = np.zeros((len(values), len(target)))
        step = np.full_like(time, FIRST_STEP)
        with np.errstate(all="ignore"):
            ahead_slope = view(time)[0]
            for _ in range(SECANT_STEPS):
                time = time + step
                last_slope = ahead_slope
                ahead_slope = view(time)[0]
                change = ahead_slope - last_slope
                step = np.where(np.abs(change) > 1e-14, -ahead_slope * step / change, 0.0)
                if np.abs(ahead_slope).max(initial=0.0) < ZERO_SLOPE:
                    break
            slope = view(time)[1]
        line = metadata.line + time / (metadata.period * (1.0 + PERIOD * x["period"]))
        sample = np.interp(slope, across, samples)
        # Beyond the detectors samples go on along a straight line.
        for end, neighbour in ((0, 1), (-1, -2)):
            is_beyond = slope < across[0] if end == 0 else slope > across[-1]
            rate = (samples[end] - samples[neighbour]) / (across[end] - across[neighbour])
            sample = np.where(is_beyond, samples[end] + rate * (slope - across[end]), sample)
        image = np.stack([line, sample], axis=-1)
        # A slope that is NaN is none of a point that is seen, either.
        is_seen = np.abs(ahead_slope) < 1e-6
        image[~is_seen] = np.nan
        return np.asarray(
            require_scaling(self.scaling).image(image.reshape(-1, 2)).reshape(image.shape))


def _interpolate_state(metadata: Metadata, time: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the satellite's positions (..., 3) [m] and axes (..., 3, 3) at times (...) [s].

    The axes are the columns of the matrices: to starboard, ahead and up. All are Earth-fixed.
    """
    # Other models need not wait for this import.
    from scipy.interpolate import CubicHermiteSpline

    # Positions and velocities of the state vectors determine a cubic between each two.
    orbit = CubicHermiteSpline(metadata.times, metadata.positions, metadata.velocities)
    station = orbit(time)
    motion = orbit(time, 1)
    up = station / np.linalg.norm(station, axis=-1, keepdims=True)
    right = np.cross(motion, up)
    right /= np.linalg.norm(right, axis=-1, keepdims=True)
    return station, np.stack([right, np.cross(up, right), up], axis=-1)


def _turn_into_camera(vectors: FloatArray, angles: list[FloatArray]) -> FloatArray:
    """Return vectors (..., 3), given in the orbital axes, in the axes of the camera.

    `angles` are yaw, pitch and roll, (...) each [rad].
    """
    yaw, pitch, roll = angles
    x, y, z = np.moveaxis(vectors, -1, 0)
    # The handbook turns looks by yaw, then roll, then pitch, which is undone in the other order.
    y, z = np.cos(pitch) * y - np.sin(pitch) * z, np.sin(pitch) * y + np.cos(pitch) * z
    x, z = np.cos(roll) * x + np.sin(roll) * z, -np.sin(roll) * x + np.cos(roll) * z
    x, y = np.cos(yaw) * x + np.sin(yaw) * y, -np.sin(yaw) * x + np.cos(yaw) * y
    return np.stack([x, y, z], axis=-1)
