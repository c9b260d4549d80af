"""How an image was taken: cameras, scanners and radars, lenses, paper of maps, as a plugin."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from termsel import DatasetSpec, Method, Reader, Recipe, SensorModel, hookimpl
from termsel.toolkit import Part
from termsel_cameras.known.method import KNOWN_CAMERA
from termsel_cameras.known.model import KnownFrame
from termsel_cameras.known.reading import CameraOptions
from termsel_cameras.maps import MAP, simulate_map
from termsel_cameras.photo import PHOTO
from termsel_cameras.problem import RECIPE
from termsel_cameras.radial import Radial2D, Radial3D
from termsel_cameras.scanners.candidate import RADAR, SCANNER
from termsel_cameras.scanners.lattice import SentinelLattice
from termsel_cameras.scanners.photos import PHOTO_METHODS as PHOTO_CAMERAS
from termsel_cameras.scanners.photos import FrameCamera, Panoramic
from termsel_cameras.scanners.radar import Radar
from termsel_cameras.scanners.scanner import Scanner
from termsel_cameras.scanners.sensors import SENSORS, Sensor
from termsel_cameras.scanners.tracked import TrackedScanner
from termsel_cameras.sheets.reading import SheetOptions
from termsel_cameras.sheets.series import SHEET_OF_SERIES, SeriesSheet

if TYPE_CHECKING:
    import click

__all__ = ["SENSORS", "FrameCamera", "KnownFrame", "Panoramic", "Radar", "Radial2D", "Radial3D",
           "Scanner", "Sensor", "SentinelLattice", "SeriesSheet", "TrackedScanner",
           "simulate_map"]


@hookimpl
def termsel_models() -> Iterable[type[SensorModel]]:
    """Return the models of cameras, scanners and radar, of radial distortion and of the sheet."""
    return [Radial2D, Radial3D, KnownFrame, SeriesSheet,
            Scanner, TrackedScanner, Radar, FrameCamera, Panoramic]


@hookimpl
def termsel_readers() -> Iterable[type[Reader]]:
    """Return the reader of Sentinel-1's lattices."""
    return [SentinelLattice]


@hookimpl
def termsel_methods() -> Iterable[Method]:
    """Return the photo whose camera is known, the sheet whose series is, and what points name."""
    return [KNOWN_CAMERA, SHEET_OF_SERIES, SCANNER, RADAR, *PHOTO_CAMERAS]


@hookimpl
def termsel_parts() -> Iterable[Part]:
    """Return the options of reading that say what is known of a camera, or of an old map."""
    return [Part("reading", CameraOptions()), Part("reading", SheetOptions())]


@hookimpl
def termsel_commands(cli: click.Group) -> None:
    """Add the commands of a series of sheets and of a flight."""
    from termsel_cameras.commands import flight_camera, map_series

    cli.add_command(map_series)
    cli.add_command(flight_camera)


@hookimpl
def termsel_problems() -> Iterable[Recipe]:
    """Return the search for the centre of distortion."""
    return [RECIPE]


@hookimpl
def termsel_datasets() -> Iterable[DatasetSpec]:
    """Return the simulated photo and the simulated scan of an old map."""
    return [PHOTO, MAP]
