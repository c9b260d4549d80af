"""Scanned photos and maps: models of lenses that distort, simulated scans, as a plugin."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from termsel import DatasetSpec, Method, Recipe, SensorModel, hookimpl
from termsel.toolkit import Part
from termsel_photos.known.method import KNOWN_CAMERA
from termsel_photos.known.model import KnownFrame
from termsel_photos.known.reading import CameraOptions
from termsel_photos.maps import MAP, simulate_map
from termsel_photos.photo import PHOTO
from termsel_photos.problem import RECIPE
from termsel_photos.radial import Radial2D, Radial3D
from termsel_photos.sheets.reading import SheetOptions
from termsel_photos.sheets.series import SHEET_OF_SERIES, SeriesSheet

if TYPE_CHECKING:
    import click

__all__ = ["KnownFrame", "Radial2D", "Radial3D", "SeriesSheet", "simulate_map"]


@hookimpl
def termsel_models() -> Iterable[type[SensorModel]]:
    """Return the models with radial distortion, the camera of known interior, and the sheet."""
    return [Radial2D, Radial3D, KnownFrame, SeriesSheet]


@hookimpl
def termsel_methods() -> Iterable[Method]:
    """Return the photo whose camera is known, and the sheet whose series is."""
    return [KNOWN_CAMERA, SHEET_OF_SERIES]


@hookimpl
def termsel_parts() -> Iterable[Part]:
    """Return the options of reading that say what is known of a camera, or of an old map."""
    return [Part("reading", CameraOptions()), Part("reading", SheetOptions())]


@hookimpl
def termsel_commands(cli: click.Group) -> None:
    """Add the commands of a series of sheets and of a flight."""
    from termsel_photos.commands import flight_camera, map_series

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
