"""From the image to the ground where hills hide ground behind them."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import termsel
from termsel import FeatureSet, Points
from termsel.data.arrays import BoolArray, FloatArray
from termsel.data.locate import locate, visible_places

CAMERA = np.array([-1500.0, 0.0, 900.0])
UNIT = np.array([800.0, 800.0, 100.0])


def hill(xy: FloatArray) -> FloatArray:
    """Return heights: a hill of 260 m around the origin, on 300 m."""
    return np.asarray(300.0 + 260.0 * np.exp(-((xy / 180.0) ** 2).sum(axis=1)))


def oblique(ground: FloatArray) -> FloatArray:
    """Return line and sample by a camera that looks along x, 20 degrees down; NaN behind it."""
    forward, down = np.array([0.94, 0.0, -0.342]), np.array([-0.342, 0.0, -0.94])
    rays = ground - CAMERA
    depth = np.where(rays @ forward > 0.0, rays @ forward, np.nan)
    return np.stack([rays @ down, rays[:, 1]], axis=1) * 2000.0 / depth[:, None]


def from_above(ground: FloatArray) -> FloatArray:
    return np.stack([-ground[:, 1], ground[:, 0] + 0.1 * ground[:, 2]], axis=1)


def is_hidden(ground: FloatArray, above: float = 1.0) -> BoolArray:
    """Return which places (n, 3) have ground so far above their ray, in metres, (n,)."""
    shares = np.linspace(0.05, 0.999, 2000)[:, None]
    return np.array([(hill((ray := CAMERA + (place - CAMERA) * shares)[:, :2]) - ray[:, 2]).max()
                     > above for place in ground])


@pytest.mark.parametrize("highest", [560.0, 580.0, 3000.0])  # the last one is above the camera
def test_the_ground_before_a_hill_is_given_and_not_that_behind_it(highest: float) -> None:
    plan = np.random.default_rng(1).uniform(-700.0, 700.0, (150, 2))
    image = oblique(np.column_stack([plan, hill(plan)]))
    ground = locate(oblique, image, hill, centre=(0.0, 0.0, 350.0), scale=UNIT)
    # Rays to the back of the hill, which meet it twice more.
    behind = np.column_stack([plan, hill(plan)])
    for start in (ground, behind):
        visible = visible_places(oblique, image, start, hill, highest, 5.0, UNIT)
        known = np.isfinite(start).all(axis=1)
        assert oblique(visible[known]) == pytest.approx(image[known], abs=1e-5)
        assert hill(visible[known, :2]) == pytest.approx(visible[known, 2], abs=2e-3)
        assert not is_hidden(visible[known]).any()
        # Rays that graze a hill apart.
        stays = known.copy()
        stays[known] = ~is_hidden(start[known], 0.01)
        assert visible[stays] == pytest.approx(start[stays], abs=1.0)
    assert is_hidden(behind).sum() > 5


def test_views_from_above_and_blanks_stay_as_they_are() -> None:
    plan = np.random.default_rng(2).uniform(-700.0, 700.0, (50, 2))
    image = from_above(np.column_stack([plan, hill(plan)]))
    ground = locate(from_above, image, hill, centre=(0.0, 0.0, 350.0), scale=UNIT)
    ground[3] = np.nan
    found = visible_places(from_above, image, ground, hill, 580.0, 30.0, UNIT)
    assert np.array_equal(found, ground, equal_nan=True)


class Raster:
    """The hill as a raster of heights gives it."""

    def __call__(self, xy: FloatArray) -> FloatArray:
        return hill(xy)

    def highest(self, _: FloatArray) -> float:
        return 560.0

    def spacing(self) -> float:
        return 5.0


@pytest.mark.parametrize("is_raster", [False, True])
def test_fits_and_results_give_the_visible_place_on_a_surface(is_raster: bool) -> None:
    rng = np.random.default_rng(3)
    plan = rng.uniform(-700.0, 700.0, (160, 2))
    ground = np.column_stack([plan, hill(plan)])
    hidden = is_hidden(ground)
    control = ground[~hidden][:60]
    points = Points(tuple(map(str, range(len(control)))), oblique(control), control)
    result = termsel.run(features=FeatureSet(points, crs="local"), method="dlt")
    surface = Raster() if is_raster else hill
    behind = ground[hidden]
    assert len(behind) > 5
    for fit in (result, result.exported):
        visible = fit.locate(oblique(behind), surface)
        assert not is_hidden(visible).any()
        assert hill(visible[:, :2]) == pytest.approx(visible[:, 2], abs=2e-3)
        # Seen places stay where they are.
        assert fit.locate(oblique(control), surface) == pytest.approx(control, abs=2e-2)


def test_a_raster_that_is_not_opened_is_told_how(tmp_path: Path) -> None:
    result = termsel.run(features=termsel.simulate_scene("spot-isfahan", n_points=12))
    raster = tmp_path / "dem.tif"
    for height in ("dem.tif", raster, termsel.open_dem(raster, "EPSG:4979")):
        for either in (result.locate, result.fit.locate):
            with pytest.raises(termsel.TermselError) as caught:
                either([[200.0, 200.0]], height)
            assert re.search(r"with termsel\.open_dem\(('[^']+'|FILE), 'EPSG:4979'\) as dem: ",
                             str(caught.value.hint))
    with pytest.raises(termsel.TermselError, match="expected numbers, or a function"):
        result.locate([[200.0, 200.0]], {"a": 1})
    assert result.locate([[200.0, 200.0]], [0.0]).shape == (1, 3)
