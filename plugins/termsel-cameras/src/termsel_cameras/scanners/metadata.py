"""Orbit, attitude and look angles of a SPOT scene, as its DIMAP file of version 1 has them.

The file is that of a scene of level 1A: `Ephemeris` has Earth-fixed positions and velocities,
`Satellite_Attitudes` corrected angles (SPOT 5, with a star tracker) or raw angular speeds (SPOT 1
to 4), `Sensor_Configuration` the time of a line and the look angles of the detectors.

References
----------
Spot Image, SPOT 123-4-5 Geometry Handbook, GAEL-P135-DOC-001, issue 1 (2004), sections 3 to 5.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import msgspec
import numpy as np
from numpy.typing import NDArray

from termsel import TermselError
from termsel.toolkit import read_data
from termsel_cameras.scanners.elements import number_of, seconds_of, text_of

FloatArray = NDArray[np.float64]

ANGLES = ("YAW", "PITCH", "ROLL")

NODES = 241
"""Most detectors whose look angles are kept: between them these are straight to a thousandth px."""

MARGIN = 60.0
"""Time before and after the scene of which ephemeris and attitude are kept [s]."""

_DIMAP_HINT = "Give the DIMAP file of a SPOT scene of level 1A (METADATA.DIM), as it was delivered."


@dataclass(frozen=True)
class Metadata:
    """What the file says; times are from the middle line [s]."""

    source: str
    size: tuple[int, int]  # lines and samples
    line: float  # the middle line, of which the first is 0
    period: float  # from line to line [s]
    tracked: bool  # whether a star tracker was used
    times: tuple[float, ...]  # of positions
    positions: tuple[tuple[float, ...], ...]  # Earth-fixed [m]
    velocities: tuple[tuple[float, ...], ...]  # [m/s]
    moments: tuple[float, ...]  # of angles
    angles: tuple[tuple[float, ...], ...]  # yaw, pitch and roll [rad]
    detectors: tuple[float, ...]  # samples, of which the first is 0
    looks: tuple[tuple[float, ...], ...]  # PSI_X along and PSI_Y across the track there [rad]

    def text(self) -> str:
        """Return the metadata as JSON, from which `metadata_of` reads them again."""
        return msgspec.json.encode(self).decode()


def metadata_of(given: str) -> Metadata:
    """Return the metadata of a DIMAP file, or of a text by `Metadata.text`.

    Raises
    ------
    TermselError
        If the file cannot be read, is not of a SPOT scene of level 1A, or lacks something.
    """
    if given.startswith("{"):
        try:
            return msgspec.json.decode(given, type=Metadata)
        except (msgspec.MsgspecError, RecursionError) as error:
            raise TermselError(f"the metadata of the result cannot be read: {error}",
                               hint="Run the fit again.") from error
    path = Path(given)
    try:
        return _read(path, path.stat().st_mtime_ns)
    except OSError as error:
        raise TermselError(f"{path} cannot be read: {error.strerror}", hint=_DIMAP_HINT) from error


@lru_cache(maxsize=2)  # a file is read by format, image and model; its time of change is a key
def _read(path: Path, _changed: int) -> Metadata:
    """Return the metadata of a file; `_changed`, its time of change, only renews the cache.

    Raises TermselError for a file that is no XML or does not describe such a scene.
    """
    try:
        root = ElementTree.fromstring(read_data(path))
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise TermselError(f"{path} cannot be read as XML: {error}", hint=_DIMAP_HINT) from error
    try:
        return _metadata_of_dimap(root, path.name)
    except TermselError as error:
        raise TermselError(f"{path}: {error.what}", hint=_DIMAP_HINT) from error


def _metadata_of_dimap(root: ElementTree.Element, name: str) -> Metadata:
    """Return the metadata of a SPOT scene of level 1A, in the file `name`.

    Times count from that of the centre line. Orbit and attitude are those within `MARGIN` of the
    scene, and look angles those of `NODES` detectors. Raises TermselError for other files and
    levels, and if orbit or attitude do not cover the scene.
    """
    strip = root.find("Data_Strip")
    if root.tag != "Dimap_Document" or strip is None:
        raise TermselError("it is no DIMAP file with a Data_Strip",
                           hint="Give METADATA.DIM of a SPOT scene of level 1A.")
    level = root.findtext(".//Scene_Source/SCENE_PROCESSING_LEVEL", "1A").strip()
    if level != "1A":
        raise TermselError(f"it is of level {level}, whose lines are no longer those of the camera")
    stamp = "Sensor_Configuration/Time_Stamp"
    start = seconds_of(text_of(strip, f"{stamp}/SCENE_CENTER_TIME"))
    points = strip.findall("Ephemeris/Points/Point")
    times = np.array([seconds_of(text_of(point, "TIME")) - start for point in points])
    states = np.array([[number_of(point, f"{part}/{axis}") for part in ("Location", "Velocity")
                        for axis in "XYZ"] for point in points]).reshape(-1, 6)
    period = number_of(strip, f"{stamp}/LINE_PERIOD")
    lines, samples = (int(number_of(root, f"Raster_Dimensions/{name}"))
                      for name in ("NROWS", "NCOLS"))
    moments, angles = _parse_attitude(strip, start)
    line = number_of(strip, f"{stamp}/SCENE_CENTER_LINE") - 1.0
    ends = np.array([-line, lines - 1.0 - line]) * period
    if not period > 0 or min(lines, samples) < 1:
        raise TermselError("the line period or the size of the image is not positive")
    for block, when in (("Ephemeris/Points", times), ("Satellite_Attitudes", moments)):
        # Both are interpolated between two times, and angles go straight on beyond the last ones.
        if len(when) < 2 or (np.diff(when) <= 0).any() or when[0] > ends[1] or when[-1] < ends[0]:
            raise TermselError(f"{block} does not cover the time of the scene",
                               hint="Give METADATA.DIM of this scene, as the vendor delivers it.")
    orbit_slice, attitude_slice = (_slice_about_scene(when, ends) for when in (times, moments))
    looks = _parse_look_angles(strip)
    # Look angles vary smoothly, so that some of the thousands are enough.
    keep = np.unique(np.linspace(0, len(looks) - 1, min(NODES, len(looks))).round().astype(int))
    return Metadata(
        name, (lines, samples), line, period,
        (strip.findtext(".//STAR_TRACKER_USED") or "").strip().upper() == "Y",
        _numbers_in_tuples(times[orbit_slice]),
        _numbers_in_tuples(states[orbit_slice, :3]),  # positions
        _numbers_in_tuples(states[orbit_slice, 3:]),  # velocities
        _numbers_in_tuples(moments[attitude_slice]), _numbers_in_tuples(angles[attitude_slice]),
        _numbers_in_tuples(looks[keep, 0] - 1.0),
        _numbers_in_tuples(looks[keep, 1:]))


def _slice_about_scene(times: FloatArray, ends: FloatArray) -> slice:
    """Return the slice of sorted times (m,) [s] from `MARGIN` before the scene to as much after it.

    `ends` (2,) are the times of the first and last line [s]. If there is one, one more time is in
    it at either end, by which values there are interpolated.
    """
    first, last = np.searchsorted(times, ends + np.array([-MARGIN, MARGIN]))
    return slice(max(int(first) - 1, 0), int(last) + 1)


def _parse_attitude(strip: ElementTree.Element, start: float) -> tuple[FloatArray, FloatArray]:
    """Return times (m,) [s from `start`] and yaw, pitch and roll (m, 3) [rad] of the satellite.

    They are the corrected angles, or else the integrals of the angular speeds, which are 0 at
    `start`. Values that the file calls out of range are left out. Raises TermselError if there are
    neither.
    """
    below = "Satellite_Attitudes"
    for where in (f"{below}/Corrected_Attitudes/Corrected_Attitude/Angles",
                  f"{below}/Raw_Attitudes/Aocs_Attitude/Angular_Speeds_List/Angular_Speeds"):
        elements = [element for element in strip.findall(where)
                    if (element.findtext("OUT_OF_RANGE") or "N").strip().upper() != "Y"]
        if not elements:
            continue
        times = np.array([seconds_of(text_of(element, "TIME")) - start for element in elements])
        values = np.array([[number_of(element, name) for name in ANGLES] for element in elements])
        if where.endswith("Speeds"):
            # The integral by trapezia; the biases of the model take its unknown constant.
            steps = np.diff(times)[:, None] * (values[1:] + values[:-1]) / 2
            values = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
            values -= [np.interp(0.0, times, element) for element in values.T]
        return times, values
    raise TermselError("Satellite_Attitudes has neither corrected angles nor angular speeds")


def _parse_look_angles(strip: ElementTree.Element) -> FloatArray:
    """Return the number of each detector, from 1, with its angles PSI_X and PSI_Y [rad], (m, 3).

    Raises TermselError if there are fewer than two, or if numbers or PSI_Y are not in order.
    """
    first = strip.find("Sensor_Configuration/Instrument_Look_Angles_List/Instrument_Look_Angles")
    elements = [] if first is None else first.findall("Look_Angles_List/Look_Angles")
    looks = np.array([[number_of(element, name) for name in ("DETECTOR_ID", "PSI_X", "PSI_Y")]
                      for element in elements]).reshape(-1, 3)
    if len(looks) < 2 or (np.diff(looks[:, 0]) <= 0).any() or not (
            (np.diff(looks[:, 2]) > 0).all() or (np.diff(looks[:, 2]) < 0).all()):
        raise TermselError("Instrument_Look_Angles_List has no two detectors in a row")
    return looks


def _nest_in_tuples(value: Any) -> Any:
    """Return nested lists as nested tuples, which can be hashed."""
    return tuple(map(_nest_in_tuples, value)) if isinstance(value, list) else value


def _numbers_in_tuples(values: Iterable[Any]) -> Any:
    """Return an array, or what makes one, as nested tuples of numbers."""
    return _nest_in_tuples(np.asarray(values).tolist())

