"""The annotation of a Sentinel-1 product: orbit, timing, ranges, bursts and lattice of points.

Each image of a product has one XML file in the folder ``annotation``. It states where the satellite
was, when the first line was seen and how lines and samples follow in time, and for products in
ground range the polynomials that lead there from slant range.

References
----------
Sentinel-1 Product Specification, S1-RS-MDA-52-7441, issue 3 (2020), section 6.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import msgspec
import numpy as np
from numpy.typing import NDArray

from termsel import TermselError
from termsel_cameras.scanners.elements import as_number, number_of, seconds_of, text_of
from termsel_cameras.scanners.product import HINT as _HINT
from termsel_cameras.scanners.product import (
    archive_of,
    choose_images,
    content_of,
    images_of,
    time_of_change,
)

FloatArray = NDArray[np.float64]

ORBIT_MARGIN = 60.0
"""Time before and after the image of which state vectors are kept [s]."""

MAX_TIME_RESIDUAL = 1e-5
"""Largest part of the times of a lattice that the delay of echoes does not explain [s]: they are
rounded to 1e-6 s."""

LATTICE = "geolocationGrid/geolocationGridPointList/geolocationGridPoint"

HEAD = 4096
"""Bytes in which an annotation shows what it is."""


@dataclass(frozen=True)
class GroundRange:
    """The polynomial from slant range to ground range at one time."""

    time: float  # from the first line [s]
    origin: float  # slant range of the polynomial's origin [m]
    coefficients: tuple[float, ...]  # ground range [m] by powers of slant range minus origin [m]


@dataclass(frozen=True)
class Burst:
    """One burst of a TOPS image: its lines follow each other in time, those of two overlap."""

    time: float  # of its first line, from the first line of the image [s]
    line: int  # its first line in the image


@dataclass(frozen=True)
class LatticePoint:
    """A point of the lattice that the processor computed, not measured."""

    line: float  # from the centre of the first pixel
    sample: float
    longitude: float  # [deg]
    latitude: float
    height: float  # above the ellipsoid [m]


@dataclass(frozen=True)
class Annotation:
    """What the geometry of a Sentinel-1 image needs; times are from its first line [s]."""

    source: str
    product: str  # such as "S1B IW GRD VH"
    start: str  # time of the first line, UTC
    size: tuple[int, int]  # lines and samples
    line_interval: float  # [s]
    line_spacing: float  # on the ground [m]
    sample_spacing: float  # in slant or ground range [m]
    first_range_time: float  # two-way time to the first sample [s]
    sampling_rate: float  # of slant range [Hz]
    times: tuple[float, ...]  # of the state vectors
    positions: tuple[tuple[float, ...], ...]  # Earth-fixed [m]
    velocities: tuple[tuple[float, ...], ...]  # Earth-fixed [m/s]
    ground_ranges: tuple[GroundRange, ...]  # empty for images in slant range
    bursts: tuple[Burst, ...]  # empty but for TOPS images in slant range
    lines_per_burst: int
    area: tuple[tuple[float, ...], ...] = ()  # least and largest longitude, latitude, height
    middle_range_time: float | None = None  # two-way time of echoes that lines are timed for [s]

    def text(self) -> str:
        """Return the annotation as JSON, from which `annotation_of` reads it again."""
        return msgspec.json.encode(self).decode()


def annotation_of(given: str, swath: str = "") -> Annotation:
    """Return the annotation of a file or product, or of a text by `Annotation.text`.

    Parameters
    ----------
    given : str
        The path of an annotation, of its image or its product, or a text by `Annotation.text`,
        which begins with a brace.
    swath : str
        The swath of a product that has several.

    Raises
    ------
    TermselError
        If the file cannot be read, is no annotation of Sentinel-1, or lacks something.
    """
    # A result contains the text of its annotation, so that it can be read without the product.
    if given.startswith("{"):
        try:
            return msgspec.json.decode(given, type=Annotation)
        except (msgspec.MsgspecError, RecursionError) as error:
            raise TermselError(f"the annotation in the result cannot be read: {error}",
                               hint="Run the fit again.") from error
    path = annotation_file(Path(given), swath)
    try:
        return _read(path, time_of_change(path))
    except OSError as error:
        raise TermselError(f"{path} cannot be read: {error.strerror}", hint=_HINT) from error


def annotation_file(path: Path, swath: str = "", polarisation: str = "") -> Path:
    """Return the path of the annotation of an image or product; any other file is returned itself.

    Raises
    ------
    TermselError
        If there is no file, if no image of the product has that swath and polarisation, or if
        several have, and their geometries differ.
    """
    images = images_of(path)
    if not images:
        if not path.is_file() and archive_of(path) is None:
            raise TermselError(f"{path} is no file, and no product with annotations", hint=_HINT)
        return path
    # Polarisations of a swath are recorded together, so that mostly any of them will do.
    fitting = choose_images(images, path, swath, polarisation)
    if len({_geometry_text(image.annotation) for image in fitting}) > 1:
        names = ", ".join(image.name for image in fitting)
        raise TermselError(f"the geometry of the images {names} differs", file=path,
                           hint="Choose one with --set polarisation="
                                f"{fitting[0].polarisation}.")
    return fitting[0].annotation


def _geometry_text(path: Path) -> str:
    """Return the geometry of an annotation as text, which all its polarisations have in common."""
    return replace(_read(path, time_of_change(path)), source="", product="").text()


@lru_cache(maxsize=8)  # a file is read by format, image and model; its time of change is a key
def _read(path: Path, _changed: int) -> Annotation:
    """Return the annotation of a file; `_changed`, its time of change, only renews the cache.

    Raises TermselError if the file is no annotation of Sentinel-1, or lacks something.
    """
    root = _root_of_file(path)
    try:
        return _annotation_from_xml(root, path.name)
    except TermselError as error:
        raise TermselError(f"{path}: {error.what}", hint=_HINT) from error


def _root_of_file(path: Path) -> ElementTree.Element:
    """Return the root element of an XML file; raises TermselError if it is none."""
    try:
        return ElementTree.fromstring(content_of(path))
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise TermselError(f"{path} cannot be read as XML: {error}", hint=_HINT) from error


def is_annotation(path: Path, head: bytes | None = None) -> bool:
    """Return whether a file is an annotation of Sentinel-1, by its first elements.

    `head` is its beginning, if it has been read. False if it cannot be read.
    """
    try:
        if head is None:
            head = content_of(path)[:HEAD]
    except (OSError, TermselError):
        return False
    return all(mark in head for mark in (b"<product>", b"<adsHeader>", b"<missionId>S1"))


def lattice_of(path: Path) -> tuple[LatticePoint, ...]:
    """Return the points of the lattice in an annotation, in its order.

    Raises
    ------
    TermselError
        If the file cannot be read, or has no lattice.
    """
    root = _root_of_file(path)
    points = root.findall(LATTICE)
    if not points:
        raise TermselError(f"{path}: geolocationGridPointList has no points", hint=_HINT)
    try:
        return tuple(LatticePoint(*(number_of(point, name) for name in (
            "line", "pixel", "longitude", "latitude", "height"))) for point in points)
    except TermselError as error:
        raise TermselError(f"{path}: {error.what}", hint=_HINT) from error


def _annotation_from_xml(root: ElementTree.Element, name: str) -> Annotation:
    """Return the annotation with the root `root` of its XML, in the file `name`.

    Images in ground range (GRD) have polynomials from slant range, those in slant range (SLC) may
    have bursts. Raises TermselError for other XML, if an element is missing or wrong, and if the
    orbit does not cover the image.
    """
    mission = (root.findtext("adsHeader/missionId") or "").strip()
    if root.tag != "product" or not mission.startswith("S1"):
        raise TermselError("it is no annotation of a Sentinel-1 product")
    image = "imageAnnotation/imageInformation"
    start = seconds_of(text_of(root, f"{image}/productFirstLineUtcTime"))
    lines = int(number_of(root, f"{image}/numberOfLines"))
    samples = int(number_of(root, f"{image}/numberOfSamples"))
    interval = number_of(root, f"{image}/azimuthTimeInterval")
    if not interval > 0 or min(lines, samples) < 1:
        raise TermselError("the interval of lines or the size of the image is not positive")
    times, states = _parse_orbit(root, start, lines * interval)
    # "Ground Range" or "Slant Range"; only images in slant range are made of bursts.
    in_ground_range = "ground" in text_of(
        root, "generalAnnotation/productInformation/projection").lower()
    ground_ranges = _ground_ranges(root, start) if in_ground_range else ()
    lines_per_burst = int(float(root.findtext("swathTiming/linesPerBurst") or 0))
    bursts = () if in_ground_range else _parse_bursts(root, start, lines_per_burst)
    parts = [mission, *((root.findtext(f"adsHeader/{key}") or "").strip()
                        for key in ("swath", "productType", "polarisation"))]
    return Annotation(
        source=name, product=" ".join(filter(None, parts)),
        start=text_of(root, f"{image}/productFirstLineUtcTime"), size=(lines, samples),
        line_interval=interval, line_spacing=number_of(root, f"{image}/azimuthPixelSpacing"),
        sample_spacing=number_of(root, f"{image}/rangePixelSpacing"),
        first_range_time=number_of(root, f"{image}/slantRangeTime"),
        sampling_rate=number_of(root, "generalAnnotation/productInformation/rangeSamplingRate"),
        times=_to_nested_tuples(times), positions=_to_nested_tuples(states[:, :3]),
        velocities=_to_nested_tuples(states[:, 3:]), ground_ranges=ground_ranges,
        bursts=bursts, lines_per_burst=lines_per_burst, area=_lattice_area(root),
        middle_range_time=_middle_range_time(root, start, interval, bursts))


def _middle_range_time(root: ElementTree.Element, start: float, interval: float,
                       bursts: tuple[Burst, ...]) -> float | None:
    """Return the two-way time [s] of the echoes by whose arrival the lines are counted.

    They are those from the middle of the swath. None if the lattice does not state the line, the
    two-way time and the time of zero Doppler of its points, or if these follow another rule.
    """
    # Echoes with the two-way time r are at zero Doppler (r - middle) / 2 after the time of their
    # line. Each point of the lattice shows the middle so.
    points = root.findall(LATTICE)
    names = ("line", "slantRangeTime", "azimuthTime")
    if not points or any(point.find(name) is None for point in points for name in names):
        return None
    lines = np.array([number_of(point, "line") for point in points])
    range_times = np.array([number_of(point, "slantRangeTime") for point in points])
    times = np.array([seconds_of(text_of(point, "azimuthTime")) - start for point in points])
    origins = bursts or (Burst(time=0.0, line=0),)
    number = np.searchsorted([burst.line for burst in origins], lines, side="right") - 1
    first_lines = np.array([burst.line for burst in origins])[number]
    first_times = np.array([burst.time for burst in origins])[number]
    line_times = first_times + (lines - first_lines) * interval
    middles = range_times - 2.0 * (times - line_times)
    middle = float(np.median(middles))
    return round(middle, 7) if np.abs(middles - middle).max() < 2.0 * MAX_TIME_RESIDUAL else None


def _lattice_area(root: ElementTree.Element) -> tuple[tuple[float, ...], ...]:
    """Return least, then largest longitude, latitude [deg] and height [m] of the lattice.

    () if there is no lattice. Across the date line longitudes count from 0 to 360.
    """
    points = root.findall(LATTICE)
    if not points:
        return ()
    ground = np.array([[number_of(point, name) for name in ("longitude", "latitude", "height")]
                       for point in points])
    # No image is half as wide as the Earth: such longitudes jump from 180 to -180.
    if np.ptp(ground[:, 0]) > 180.0:
        ground[:, 0] %= 360.0
    return tuple(map(tuple, np.stack([ground.min(axis=0), ground.max(axis=0)]).tolist()))


def _parse_orbit(root: ElementTree.Element, start: float, duration: float,
                 ) -> tuple[FloatArray, FloatArray]:
    """Return times (m,) [s] and states (m, 6) of the satellite: positions [m], velocities [m/s].

    Times count from `start`, the first line; states more than `ORBIT_MARGIN` before it or after
    `duration` [s] are left out. Raises TermselError if they do not cover the image, or are not
    Earth-fixed.
    """
    vectors = root.findall("generalAnnotation/orbitList/orbit")
    frames = {(vector.findtext("frame") or "Earth Fixed").strip() for vector in vectors}
    if frames - {"Earth Fixed"}:
        raise TermselError(f"its orbit is in the frame {sorted(frames)[0]!r}, not Earth Fixed")
    times = np.array([seconds_of(text_of(vector, "time")) - start for vector in vectors])
    states = np.array([[number_of(vector, f"{part}/{axis}")
                        for part in ("position", "velocity") for axis in "xyz"]
                       for vector in vectors]).reshape(-1, 6)
    # An annotation has state vectors of minutes, of which a spline needs some around the image.
    near = (times > -ORBIT_MARGIN) & (times < duration + ORBIT_MARGIN)
    times = times[near]
    states = states[near]
    if len(times) < 2 or (np.diff(times) <= 0).any() or times[0] > 0 or times[-1] < duration:
        raise TermselError("the state vectors of orbitList do not cover all lines of the image",
                           hint="Give the annotation of this image, as the agency delivers it.")
    return times, states


def _ground_ranges(root: ElementTree.Element, start: float) -> tuple[GroundRange, ...]:
    """Return the polynomials from slant to ground range, in the order of time.

    Their times count from `start` [s]. Raises TermselError if there are none, if one has no
    coefficients, or if they are not in the order of time.
    """
    records = root.findall("coordinateConversion/coordinateConversionList/coordinateConversion")
    ranges = []
    for record in records:
        words = text_of(record, "srgrCoefficients").split()
        ranges.append(GroundRange(
            time=seconds_of(text_of(record, "azimuthTime")) - start,
            origin=number_of(record, "sr0"),
            coefficients=tuple(as_number("srgrCoefficients", word) for word in words)))
    times = np.array([polynomial.time for polynomial in ranges])
    if not ranges or (np.diff(times) <= 0).any() or any(
            not polynomial.coefficients for polynomial in ranges):
        raise TermselError("coordinateConversionList has no polynomials in the order of time")
    return tuple(ranges)


def _parse_bursts(root: ElementTree.Element, start: float, lines: int) -> tuple[Burst, ...]:
    """Return the bursts of a TOPS image of `lines` lines each; () if the image has no bursts.

    Their times count from `start` [s].
    """
    return tuple(Burst(time=seconds_of(text_of(burst, "azimuthTime")) - start, line=number * lines)
                 for number, burst in enumerate(root.findall("swathTiming/burstList/burst")))


def _to_nested_tuples(values: FloatArray) -> Any:
    """Return an array as nested tuples of numbers, which can be compared and hashed."""

    def frozen(value: float | Sequence[Any]) -> Any:
        return tuple(frozen(part) for part in value) if isinstance(value, list) else value

    return frozen(np.asarray(values).tolist())
