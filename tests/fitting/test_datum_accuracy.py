"""What stands in for a missing grid is said where it is worse than the control fits."""

from __future__ import annotations

import logging
import os

import numpy as np
import pytest

import termsel
from termsel.data.coordinates.datum_accuracy import stand_in_between
from termsel.fitting.datum_accuracy import say_stand_in

pyproj = pytest.importorskip("pyproj")

pytestmark = pytest.mark.skipif(
    os.environ.get("PROJ_NETWORK", "").upper() == "ON", reason="all grids are within reach")


def has_grid(name: str) -> bool:
    """Return whether PROJ has a grid here."""
    from pathlib import Path

    return any((Path(folder) / name).exists() for folder in
               (*pyproj.datadir.get_data_dir().split(os.pathsep),
                pyproj.datadir.get_user_data_dir()))


def photo(crs: str, east: float, north: float, pixel: float, noise: float) -> termsel.FeatureSet:
    """Return points of a photo from above, with pixels and a noise of so many metres."""
    rng = np.random.default_rng(7)
    plan = rng.uniform(-1000.0, 1000.0, (40, 2)) * pixel
    heights = rng.uniform(0.0, 300.0, 40) * pixel
    image = plan[:, ::-1] * [-1.0, 1.0] / pixel * (1.0 + heights / 4000.0 / pixel)[:, None]
    image = image + 2000.0 + rng.normal(0.0, noise / pixel, (40, 2))
    ground = np.column_stack([plan[:, 0] + east, plan[:, 1] + north, heights])
    return termsel.FeatureSet(termsel.Points(tuple(map(str, range(40))), image, ground), crs=crs)


@pytest.mark.parametrize(("crs", "east", "north", "target", "grid", "accuracy"), [
    ("EPSG:31467", 3_500_000.0, 5_500_000.0, "EPSG:32632", "de_adv_BETA2007.tif", "3 m"),
    ("EPSG:27700", 400_000.0, 300_000.0, "EPSG:4326", "uk_os_OSTN15_NTv2_OSGBtoETRS.tif", "2 m")])
def test_a_coarse_transformation_is_said_with_its_accuracy(
        crs: str, east: float, north: float, target: str, grid: str, accuracy: str,
        caplog: pytest.LogCaptureFixture) -> None:
    if has_grid(grid):
        pytest.skip(f"PROJ has {grid}")
    precise = termsel.fit(photo(crs, east, north, 0.5, 0.2), "dlt3d")
    say_stand_in(precise, target)
    assert f"does not have the grid {grid}" in caplog.text
    assert f"is accurate to {accuracy}; the control fits to 0.2" in caplog.text
    assert f"pyproj sync --file {grid}" in caplog.text
    caplog.clear()
    # Nobody needs a grid for a map that is good to ten metres.
    say_stand_in(termsel.fit(photo(crs, east, north, 20.0, 10.0), "dlt3d"), target)
    assert not caplog.records


def test_an_rpc_of_such_control_says_it(caplog: pytest.LogCaptureFixture) -> None:
    if has_grid("de_adv_BETA2007.tif"):
        pytest.skip("PROJ has the grid")
    fitted = termsel.fit(photo("EPSG:31467", 3_500_000.0, 5_500_000.0, 0.5, 0.2), "dlt3d")
    with caplog.at_level(logging.WARNING):
        termsel.rpc_of(fitted)
    assert "de_adv_BETA2007.tif" in caplog.text


@pytest.mark.parametrize(("source", "target", "position"), [
    ("EPSG:25832", "EPSG:4326", (9.0, 48.0)), ("EPSG:2056", "EPSG:4326", (8.0, 47.0)),
    ("EPSG:32632", "EPSG:32633", (12.0, 48.0)), ("local", "EPSG:4326", (0.0, 0.0)),
    ("EPSG:4979", "EPSG:4326", (9.0, 48.0)),
    ("EPSG:31467", "EPSG:31468", (10.0, 50.0))])  # of one datum
def test_nothing_stands_in_where_the_best_operation_is_at_hand(
        source: str, target: str, position: tuple[float, float]) -> None:
    assert stand_in_between(source, target, position) is None
