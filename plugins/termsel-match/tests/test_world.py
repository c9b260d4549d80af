"""The simulated place is what its documentation says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from termsel import TermselError, read, read_rpc
from termsel.simulate import read_geometry
from termsel_match.simulated.world import World


def test_the_camera_sees_the_independent_places_where_they_are(place: Any) -> None:
    points = read(place / "independent.csv").points
    assert len(points) == 200
    assert set(points.roles) == {"independent"}
    camera = read_geometry(place / "camera.json")
    assert np.abs(camera.project(place.geographic(points.ground)) - points.image).max() < 1e-5


@pytest.mark.parametrize("off", [10.0, 60.0])
def test_the_rpc_is_off_as_asked_and_drifts(place: Any, off: float) -> None:
    world = World(size=500, seed=5, off=off)
    points = world.independent()
    away = world.rpc.project(place.geographic(points.ground)) - points.image
    assert np.linalg.norm(away.mean(axis=0)) == pytest.approx(off, rel=0.1)
    assert 0.02 * off < np.ptp(away, axis=0).max() < 0.4 * off


def test_it_is_the_same_every_time_and_another_by_another_seed(place: Any) -> None:
    again = World(size=500, seed=3)
    assert np.array_equal(again.ortho(), place.world.ortho())
    assert again.rpc == place.world.rpc == read_rpc(place / "image.RPB")
    assert not np.array_equal(World(size=500, seed=4).ortho(), again.ortho())


def test_part_of_the_ground_and_of_the_roads_differs(place: Any) -> None:
    ground = place.world.ground
    assert 0.1 < ground.changed <= 0.15
    mapped, real = place.world.vectors(), [place.world.corner + road.vertices * [1, -1]
                                           for road in ground.roads]
    assert len(mapped) < len(real)
    moved = [min(np.abs(one - other).max() for other in real if one.shape == other.shape)
             for one in mapped]
    assert sum(shift > 2 for shift in moved) >= 1
    assert np.median(moved) < 1


def test_bad_sizes_and_folders_are_refused(place: Any, says: Any, tmp_path: Path) -> None:
    for wrong in ({"size": 10}, {"off": -1.0}, {"seed": -1}):
        with pytest.raises(TermselError, match="Give"):
            World(**wrong)
    code, text = says("match-example", place.folder, "--size", 200)
    assert code == 2
    assert f"{place.folder}: this folder exists already. Name a new folder." in text
    code, text = says("match-example", tmp_path / "none/such", "--size", 200)
    assert code == 2
    assert "the folder above this one does not exist" in text
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("command", "output"), [
    (("match-points", "image.tif", "--reference", "ortho.tif"), "image.tif"),
    (("match-points", "image.tif", "--reference", "ortho.tif"), "image.RPB"),
    (("match-points", "image.tif", "--reference", "ortho.tif", "--dem", "dem.tif"), "dem.tif"),
    (("match-lines", "image.tif", "--vectors", "roads.gpkg", "--dem", "dem.tif"), "roads.gpkg"),
    (("auto-georeference", "image.tif", "--reference", "ortho.tif", "--dem", "dem.tif"),
     "ortho.tif"),
    (("auto-georeference", "image.tif", "--reference", "ortho.tif", "--dem", "dem.tif",
      "--vectors", "roads.gpkg"), "image.tif"),
])
def test_no_command_replaces_what_it_reads(place: Any, says: Any, command: tuple[str, ...],
                                           output: str) -> None:
    before = (place / output).read_bytes()
    named = [str(place / word) if "." in word else word for word in command]
    # However the name is spelt.
    code, text = says(*named, "-o", place.folder / ".." / place.folder.name / output,
                      "--overwrite")
    assert code == 2
    assert "reads this file" in text
    assert (place / output).read_bytes() == before
