"""Scanned photos and maps: models of lenses that distort, simulated scans, as a plugin."""

from __future__ import annotations

from collections.abc import Iterable

from termsel import DatasetSpec, Recipe, SensorModel, hookimpl
from termsel_photos.maps import MAP, simulate_map
from termsel_photos.photo import PHOTO
from termsel_photos.problem import RECIPE
from termsel_photos.radial import Radial2D, Radial3D

__all__ = ["Radial2D", "Radial3D", "simulate_map"]


@hookimpl
def termsel_models() -> Iterable[type[SensorModel]]:
    """Return the models with radial distortion."""
    return [Radial2D, Radial3D]


@hookimpl
def termsel_problems() -> Iterable[Recipe]:
    """Return the search for the centre of distortion."""
    return [RECIPE]


@hookimpl
def termsel_datasets() -> Iterable[DatasetSpec]:
    """Return the simulated photo and the simulated scan of an old map."""
    return [PHOTO, MAP]
