"""Simulated scenes: a rigorous pushbroom scanner over analytic terrain."""

import warnings
from typing import Any

from termsel.errors import requires
from termsel.simulate.catalogue import SCENES
from termsel.simulate.geometry_files import (
    geometry_from,
    geometry_text,
    read_geometry,
    write_geometry,
)
from termsel.simulate.orbit import pushbroom_at
from termsel.simulate.pushbroom import Angle, Pushbroom
from termsel.simulate.scenes import DATASETS, SceneTruth, scene_truth, simulate_scene
from termsel.simulate.terrain import Terrain

__all__ = [
    "DATASETS",
    "SCENES",
    "Angle",
    "Pushbroom",
    "SceneTruth",
    "Terrain",
    "geometry_from",
    "geometry_text",
    "pushbroom_at",
    "read_geometry",
    "scene_truth",
    "simulate_scene",
    "write_geometry",
]


def __getattr__(name: str) -> Any:
    """Return `simulate_map`, which has moved to a package, with a warning until 0.4."""
    if name != "simulate_map":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    with requires("simulate_map requires", "termsel_photos", "./plugins/termsel-photos"):
        import termsel_photos
    warnings.warn("termsel.simulate.simulate_map is called termsel_photos.simulate_map; the old "
                  "name goes away in 0.4", DeprecationWarning, stacklevel=2)
    return termsel_photos.simulate_map
