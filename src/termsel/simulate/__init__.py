"""Simulated scenes: a rigorous pushbroom scanner over analytic terrain."""

from termsel.simulate.catalogue import SCENES
from termsel.simulate.geometry_files import (
    geometry_from,
    geometry_text,
    read_geometry,
    write_geometry,
)
from termsel.simulate.kept import kept_features
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
    "kept_features",
    "pushbroom_at",
    "read_geometry",
    "scene_truth",
    "simulate_scene",
    "write_geometry",
]
