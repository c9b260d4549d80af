"""Physical models of scanners and radars in orbit and of photos, as a plugin of termsel."""

from __future__ import annotations

from collections.abc import Iterable

from termsel import Method, Reader, SensorModel, hookimpl
from termsel_scanner.candidate import RADAR, SCANNER
from termsel_scanner.lattice import SentinelLattice
from termsel_scanner.photos import CANDIDATES as PHOTOS
from termsel_scanner.photos import Frame, Panoramic
from termsel_scanner.radar import Radar
from termsel_scanner.scanner import Scanner
from termsel_scanner.sensors import SENSORS, Sensor
from termsel_scanner.tracked import TrackedScanner

__all__ = ["SENSORS", "Frame", "Panoramic", "Radar", "Scanner", "Sensor", "SentinelLattice",
           "TrackedScanner"]


@hookimpl
def termsel_models() -> Iterable[type[SensorModel]]:
    """Return the scanners, the radar, the frame and the panoramic camera."""
    return [Scanner, TrackedScanner, Radar, Frame, Panoramic]


@hookimpl
def termsel_readers() -> Iterable[type[Reader]]:
    """Return the reader of Sentinel-1's lattices."""
    return [SentinelLattice]


@hookimpl
def termsel_methods() -> Iterable[Method]:
    """Return the scanner and the radar that points name, and the cameras of photos."""
    return [SCANNER, RADAR, *PHOTOS]
