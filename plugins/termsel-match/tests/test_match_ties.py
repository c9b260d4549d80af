"""Tie points between raw images, and what a block makes of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

pytest.importorskip("termsel_match", reason="termsel-match is not installed: "
                    "pip install -e plugins/termsel-match")

from termsel import read_result, write_points_csv
from termsel_match.points.calibration import calibrate_deviations, smooth_part
from termsel_match.simulated.world import WORLD_CRS, World
from termsel_match.simulated.world_files import write_world


@dataclass(frozen=True, eq=False)
class View(World):
    """One of several images of a place, with a noise and an RPC of its own."""

    view: int = 0

    def _rng(self, stream: int) -> np.random.Generator:
        own = [self.view] if stream in (1, 4, 7) else []
        return np.random.default_rng([self.seed, stream, *own])


@pytest.fixture(scope="module")
def views(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, View]]:
    folder = tmp_path_factory.mktemp("views")
    made = {name: View(size=360, seed=4, off_nadir=nadir, off=off, view=i)
            for i, (name, nadir, off) in enumerate((("A", 4, 20), ("B", 12, 15), ("C", 20, 25)))}
    for name, world in made.items():
        write_world(world, folder / name)
        for file, new in (("image.tif", f"{name}.tif"), ("image.RPB", f"{name}.RPB"),
                          ("dem.tif", "dem.tif")):
            (folder / new).write_bytes((folder / name / file).read_bytes())
    return folder, made


@pytest.mark.slow
def test_ties_of_a_triplet_hold_a_block(views: tuple[Path, dict[str, View]], says: Any) -> None:
    folder, worlds = views
    code, text = says("match-ties", *(folder / f"{name}.tif" for name in "ABC"), "--dem",
                      folder / "dem.tif", "--count", 60, "-o", folder / "ties.csv", "--quiet")
    assert code == 0, text
    rows = [line.split(",") for line in (folder / "ties.csv").read_text().splitlines()[1:]]
    of: dict[str, dict[str, list[float]]] = {}
    for name, image, line, sample in rows:
        of.setdefault(name, {})[image] = [float(line), float(sample)]
    assert len(of) >= 60
    # The exact cameras see both places of a tie at one place on the ground.
    away = []
    for seen in of.values():
        first, second = list(seen)[:2]
        height = np.array([520.0])
        for _ in range(12):
            place = worlds[first].camera.locate(np.array([seen[first]]), height)
            height = worlds[first].terrain(place)
        there = worlds[second].camera.project(np.column_stack([place, height]))
        away.append(np.linalg.norm(there - seen[second]))
    assert np.median(away) < 0.5
    assert np.mean(np.array(away) < 2) > 0.9
    pytest.importorskip("termsel_block", reason="termsel-block is not installed")
    control = worlds["A"].independent(12)
    noise = np.random.default_rng(0).normal(0, 0.3, control.image.shape)
    points = type(control)(control.ids, control.image + noise, control.ground)
    write_points_csv(points, folder / "control.csv", WORLD_CRS)
    (folder / "block.toml").write_text(
        f'crs = "{WORLD_CRS}"\nties = "ties.csv"\ndem = "dem.tif"\n'
        + "".join(f'[[image]]\nname = "{name}"\nimage = "{name}.tif"\nmodel = "shift"\n'
                  + ('points = "control.csv"\n' if name == "A" else "") for name in "ABC"))
    code, text = says("block", folder / "block.toml", "--out", folder / "adjusted")
    assert code == 0, text
    for name in "BC":  # without any control: their RPCs are 15 and 25 px off
        result = read_result(folder / "adjusted" / name)
        exact = worlds[name].independent()
        off = result.project(exact.ground) - exact.image
        assert np.sqrt((off**2).sum(axis=1).mean()) < 1.5


@pytest.mark.parametrize(("words", "said"), [
    (["A.tif"], "Give two images or more"), (["A.tif", "A/../A.tif"], "two images are called 'A'"),
    (["A.tif", "missing.tif"], "missing.tif")])
def test_what_is_no_pair_is_refused(views: tuple[Path, dict[str, View]], says: Any, tmp_path: Path,
                                    words: list[str], said: str) -> None:
    folder, _ = views
    code, text = says("match-ties", *(folder / word for word in words), "--dem",
                      folder / "dem.tif", "--count", 12, "-o", tmp_path / "ties.csv", "--quiet")
    assert code == 2
    assert said in text
    assert not (tmp_path / "ties.csv").exists()


def test_too_little_time_is_said(views: tuple[Path, dict[str, View]], says: Any,
                                 tmp_path: Path) -> None:
    folder, _ = views
    code, text = says("match-ties", folder / "A.tif", folder / "B.tif", "--dem",
                      folder / "dem.tif", "--seconds", 1e-6, "-o", tmp_path / "ties.csv", "--quiet")
    assert code == 2
    assert "Give more --seconds" in text


def test_a_raster_without_heights_is_named(views: tuple[Path, dict[str, View]], says: Any,
                                           tmp_path: Path) -> None:
    folder, _ = views
    with rasterio.open(folder / "dem.tif") as dem, rasterio.open(
            tmp_path / "blank.tif", "w", **{**dem.profile, "nodata": -9999.0}) as blank:
        blank.write(np.full((1, *dem.shape), -9999.0, dem.dtypes[0]))
    code, text = says("match-ties", folder / "A.tif", folder / "B.tif", "--dem",
                      tmp_path / "blank.tif", "-o", tmp_path / "ties.csv", "--quiet")
    assert code == 2
    assert "blank.tif: this raster has no heights where the images are" in " ".join(text.split())
    assert not (tmp_path / "ties.csv").exists()


def test_standard_deviations_are_those_of_matches_that_agree() -> None:
    rng = np.random.default_rng(0)
    places = rng.uniform(0, 1000, (300, 2))
    noise = rng.normal(0, [0.3, 0.15], (300, 2))
    unit = places / 500 - 1
    moved = np.array([20.0, -9.0]) + unit * [1.5, -0.8] + unit[:, :1] ** 2 + noise
    moved[:80] += rng.uniform(-40, 40, (80, 2))  # wrong ones
    sigma = np.full((300, 2), 0.2)
    found = smooth_part(places, moved)
    assert found is not None
    assert np.abs(found[0] - (moved - noise))[80:].max() < 0.3
    out = calibrate_deviations(places, moved, sigma)
    assert np.allclose(np.median(out, axis=0), [0.3, 0.15], rtol=0.15)
    few = slice(0, 8)
    assert (calibrate_deviations(places[few], moved[few], sigma[few]) == 0.2).all()
    assert smooth_part(places, rng.uniform(-300, 300, (300, 2))) is None


@pytest.mark.slow
def test_an_image_without_any_tie_is_named(views: tuple[Path, dict[str, View]],
                                           tmp_path: Path, says: Any) -> None:
    folder, _ = views
    with rasterio.open(folder / "C.tif") as raster:
        pixels, profile = raster.read(), raster.profile
    # Nothing that a keypoint could be found by.
    with rasterio.open(tmp_path / "blank.tif", "w", **profile) as raster:
        raster.write(np.full_like(pixels, pixels.mean()))
    (tmp_path / "blank.RPB").write_bytes((folder / "C.RPB").read_bytes())
    code, text = says("match-ties", folder / "A.tif", tmp_path / "blank.tif", folder / "B.tif",
                      "--dem", folder / "dem.tif", "--count", 60, "-o", tmp_path / "ties.csv",
                      "--quiet")
    assert code == 0, text
    assert "Warning: image blank has no tie with any other" in text
    assert "--matcher structure" in text
    assert text.count("has no tie") == 1
