"""What is made of a result that no model fits says so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import termsel
from termsel.results.first_screen import next_step_for_user


@pytest.mark.parametrize("is_random", [True, False])
def test_an_export_of_random_points_says_that_no_model_fits(
        is_random: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    features = termsel.simulate_scene("ikonos-hamedan", seed=1, roles=(24, 0, 0), n_lines=0)
    if is_random:
        image = np.random.default_rng(0).uniform(0, 5000, (24, 2))
        features = features.with_(points=replace(features.points, image=image))
    result = termsel.run(features=features)
    caplog.clear()
    termsel.export(result, "rpc-txt", tmp_path / "scene_RPC.TXT")
    assert ("no model fits these points" in caplog.text) == is_random


def test_an_export_of_a_model_that_another_one_beats_blames_the_model(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Points whose image bends are at fault of no affine model, as a polynomial fits them."""
    places = np.random.default_rng(5).uniform(-1, 1, (40, 2))
    x, y = places.T
    image = np.column_stack([500 - 400 * y + 90 * x * y, 500 + 400 * x + 120 * x**2])
    image += np.random.default_rng(6).normal(0, 0.1, image.shape)
    ground = np.column_stack([1000 * places, np.full(40, np.nan)])
    features = termsel.FeatureSet(termsel.Points(tuple(f"P{i}" for i in range(40)), image, ground),
                                  crs="EPSG:32633")
    result = termsel.run(features=features, model="poly2d", options={"degree": 1})
    caplog.clear()
    termsel.export(result, "points-csv", tmp_path / "points.csv")
    assert "this model does not fit these points, which a quadratic polynomial fits" in caplog.text
    assert "no model fits" not in caplog.text + result.summary()


@pytest.mark.parametrize("heights", [True, False])
def test_degrees_that_no_model_fits_may_be_those_of_a_map_in_a_projection(heights: bool) -> None:
    rng = np.random.default_rng(3)
    ground = np.column_stack([rng.uniform(-95, -65, 21), rng.uniform(8, 30, 21),
                              rng.uniform(0, 900, 21) if heights else np.full(21, np.nan)])
    points = termsel.Points(tuple(f"P{i}" for i in range(21)), rng.uniform(0, 3000, (21, 2)),
                            ground)
    result = termsel.run(features=termsel.FeatureSet(points, crs="EPSG:4326"))
    assert "no model fits" in result.summary()
    told = "--crs auto   (finds the projection, if this is a map)" in next_step_for_user(result)
    assert told != heights


@pytest.mark.parametrize(("extent", "is_told"), [(0.5, False), (12.0, True), (40.0, True)])
def test_degrees_of_a_country_without_a_crs_may_be_those_of_a_map(
        extent: float, is_told: bool, tmp_path: Path) -> None:
    rows = [f"P{i},{100 * i % 700},{37 * i % 900},{-87 + extent * (i % 5) / 4},"
            f"{15 + extent * (i % 3) / 4}" for i in range(12)]
    table = tmp_path / "map.csv"
    table.write_text("\n".join(["id,line,sample,lon,lat", *rows]), encoding="utf-8")
    with pytest.raises(termsel.TermselError) as caught:
        termsel.read(table)
    assert ("crs='auto' finds its projection" in str(caught.value)) == is_told
