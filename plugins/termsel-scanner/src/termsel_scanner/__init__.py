"""A physical model of line scanners in orbit, as a plugin of termsel."""

from __future__ import annotations

from collections.abc import Iterable

from termsel import Candidate, SensorModel, hookimpl
from termsel_scanner.candidate import SCANNER
from termsel_scanner.photos import CANDIDATES as PHOTOS
from termsel_scanner.photos import Frame, Panoramic
from termsel_scanner.scanner import Scanner
from termsel_scanner.sensors import SENSORS, Sensor
from termsel_scanner.tracked import TrackedScanner

__all__ = ["SENSORS", "Frame", "Panoramic", "Scanner", "Sensor", "TrackedScanner"]


@hookimpl
def termsel_models() -> Iterable[type[SensorModel]]:
    """Return the scanners, the frame and the panoramic camera."""
    return [Scanner, TrackedScanner, Frame, Panoramic]


@hookimpl
def termsel_candidates() -> Iterable[Candidate]:
    """Return the scanner that points name, and the cameras of photos."""
    return [SCANNER, *PHOTOS]
