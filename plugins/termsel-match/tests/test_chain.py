"""From a raw image to a map, or to the reasons why there is none."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("termsel_match", reason="termsel-match is not installed: "
                    "pip install -e plugins/termsel-match")

import rasterio
import shapely
from pyogrio.raw import write

import termsel
from termsel import FeatureSet, Lines, TermselError, write_points_csv
from termsel.testing import checks
from termsel_match.chain import georeference_image, judge, model_for
from termsel_match.commands import NOT_GOOD_ENOUGH, auto_georeference
from termsel_match.judgement.criteria import Agreement
from termsel_match.judgement.picture import arrow_ends, scale_of
from termsel_match.judgement.selection import AGREEING, select_points, with_lines
from termsel_match.judgement.structures import heights_above_plane

CHECKS = (*checks(Agreement()), *checks(
    auto_georeference, words=["none.tif", "--reference", "none.tif", "-o", "none.tif"]))


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.name)
def test_conforms(check: Any) -> None:
    check.run()


def candidates(place: Any, wrong: float, turned: float = 1.0) -> FeatureSet:
    """Return exact places measured to 0.2 px, a part of them 5 to 100 px off.

    By default nearly to one side; `turned` is the range of their directions.
    """
    points, rng = place.world.independent(), np.random.default_rng(1)
    image = points.image + rng.normal(0, 0.2, points.image.shape)
    off = rng.permutation(len(points))[:round(wrong * len(points))]
    turn, far = rng.uniform(0, turned, len(off)), rng.uniform(5, 100, len(off))
    image[off] += np.stack([np.sin(turn), np.cos(turn)], axis=1) * far[:, None]
    return FeatureSet(replace(points, image=image, roles=()), crs="EPSG:32633",
                      image_size=(500, 500))


@pytest.mark.slow
def test_half_of_the_candidates_may_be_wrong(place: Any) -> None:
    true, errors = place.world.independent(), []
    for wrong in (0.0, 0.5):
        found = select_points(candidates(place, wrong), "rpc-drift",
                              {"rpc": str(place / "image.RPB")})
        away = found.result.project(true.ground) - true.image
        errors.append(np.sqrt((away**2).sum(axis=1).mean()))
        assert found.share == pytest.approx(1 - wrong, abs=0.2)
    assert errors[1] < max(1.2 * errors[0], 0.15)


@pytest.mark.slow_cases("0.0-0.0-poly2d", "0.0-0.5-affine")
@pytest.mark.parametrize(("slope", "hill", "model"), [
    (0.0, 0.0, "poly2d"), (0.02, 0.0, "poly2d"), (0.0, 0.5, "affine")])
def test_level_ground_needs_no_heights(place: Any, slope: float, hill: float, model: str) -> None:
    """Without relief no candidates determine the terms of heights of an affine model."""
    features = candidates(place, 0.2)
    ground = features.points.ground.copy()
    x, y = (ground[:, :2] - ground[:, :2].mean(axis=0)).T
    ground[:, 2] = 200.0 + slope * x + hill * np.sin(x / 40)
    image = np.column_stack([-y, x]) + 0.3 * ground[:, 2:] + 300
    image += np.random.default_rng(2).normal(0, 0.1, image.shape)
    wrong = np.arange(len(image)) % 6 == 0
    image[wrong] += 50.0
    level = features.with_(points=replace(features.points, ground=ground, image=image))
    found = select_points(level, "affine", {})
    assert found.correction.model == model
    np.testing.assert_array_equal(found.agrees, ~wrong)
    # A hill that no candidate shows is above the plane through them.
    above = heights_above_plane(ground, ground + np.array([0, 0, 30]))
    np.testing.assert_allclose(above, 30.0, atol=1.2)


def test_wrong_candidates_alone_are_no_success(place: Any) -> None:
    with pytest.raises(TermselError, match="not enough candidates agree"):
        select_points(candidates(place, 1.0, 2 * np.pi), "rpc-drift",
                      {"rpc": str(place / "image.RPB")})


def test_few_that_agree_by_chance_are_no_success(place: Any) -> None:
    with pytest.raises(TermselError, match="not enough candidates agree"):
        select_points(candidates(place, 1.0), "rpc-drift", {"rpc": str(place / "image.RPB")})


@pytest.mark.slow
def test_a_map_shows_the_ground_where_it_is(place: Any, says: Any, tmp_path: Path) -> None:
    output, folder = tmp_path / "map.tif", tmp_path / "out"
    words = ("auto-georeference", place / "image.tif", "--reference", place / "ortho.tif", "--dem",
             place / "dem.tif", "--vectors", place / "roads.gpkg", "--count", 100, "-o", output)
    code, text = says(*words, "--out", folder)
    assert code == 0, text
    assert "Not good enough" not in text
    assert (folder / "report.txt").read_text() in text
    record = json.loads((folder / "result" / "result.json").read_text())
    assert record["notes"][-1] == AGREEING
    assert AGREEING in text
    assert AGREEING in " ".join((folder / "result" / "summary.txt").read_text().split())
    assert {one.name for one in folder.iterdir()} == {
        "candidates.csv", "report.txt", "residuals.png", "result"}
    with rasterio.open(output) as raster, rasterio.open(place / "ortho.tif") as ortho:
        window = ortho.window(*raster.bounds)
        other = ortho.read(1, window=window, out_shape=raster.shape, boundless=True).astype(float)
        own = raster.read(1).astype(float)

    def likeness(down: int, right: int) -> float:
        moved = np.roll(other, (down, right), axis=(0, 1))
        both = (own > 0) & (moved > 0)
        return float(np.corrcoef(own[both], moved[both])[0, 1])

    assert likeness(0, 0) > 1.05 * max(likeness(2, 0), likeness(-2, 0), likeness(0, 2),
                                       likeness(0, -2))


@pytest.mark.slow
def test_a_result_that_is_not_good_enough_ends_with_three(place: Any, says: Any, tmp_path: Path,
                                                          altered: Callable[..., Path]) -> None:
    output = tmp_path / "map.tif"
    words = ("--reference", place / "ortho.tif", "--dem", place / "dem.tif", "--count", 60, "-o",
             output)
    code, text = says("auto-georeference", place / "image.tif", *words, "--accept", 0.01)
    assert code == NOT_GOOD_ENOUGH
    assert "accepted are 0.01 px" in text
    sea = altered("image.tif", lambda pixels: (300 + np.random.default_rng(0).normal(
        0, 5, pixels.shape)).astype(np.uint16))
    code, text = says("auto-georeference", sea, *words)
    assert code == 2
    assert "not enough candidates" in text
    assert not output.exists()


@pytest.mark.slow
def test_lines_that_cannot_be_used_lose_no_map(place: Any, says: Any, tmp_path: Path) -> None:
    words = ("auto-georeference", place / "image.tif", "--reference", place / "ortho.tif", "--dem",
             place / "dem.tif", "--count", 60, "--overwrite", "-o", tmp_path / "map.tif")
    for shift in (np.array([9.0, 5.0]), np.array([90000.0, 0.0])):  # beside the reference; far away
        moved = tmp_path / "moved.gpkg"
        write(moved, shapely.to_wkb(np.array([shapely.LineString(one + shift)
                                              for one in place.world.vectors()])), [], fields=[],
              geometry_type="LineString", crs="EPSG:32633")
        code, text = says(*words, "--vectors", moved)
        assert (code, "Lines are not used, the map is by points alone:" in text) == (0, True), text
        assert (tmp_path / "map.tif").exists()


@pytest.mark.slow
def test_lines_that_contradict_the_points_are_refused(place: Any) -> None:
    options = {"rpc": str(place / "image.RPB")}
    selected = select_points(candidates(place, 0.0), "rpc-drift", options)
    true = selected.result.features.points
    for far, refused in ((0.0, False), (9.0, True)):
        ends = np.stack([true.image[:20], true.image[20:40]], axis=1) + far
        lines = Lines(tuple(f"L{i}" for i in range(20)), ends,
                      np.stack([true.ground[:20], true.ground[20:40]], axis=1), np.full(20, 0.05))
        both = FeatureSet(lines=lines, crs="EPSG:32633", image_size=(500, 500))
        if refused:
            with pytest.raises(TermselError, match="points and lines contradict each other"):
                with_lines(selected, both)
        else:
            assert len(with_lines(selected, both)
                       .result.features.lines) == 20


@pytest.mark.slow
@pytest.mark.parametrize(("wrong", "made"), [(0.2, True), (0.7, False)])
def test_a_map_needs_half_of_all_independent_candidates(place: Any, tmp_path: Path, wrong: float,
                                                        made: bool) -> None:
    selected = select_points(candidates(place, wrong, 2 * np.pi), "rpc-drift",
                             {"rpc": str(place / "image.RPB")})
    assert selected.rmse < 1  # of those that agree: it does not tell
    assert (selected.median <= 2) == made
    table = tmp_path / "candidates.csv"
    write_points_csv(selected.points, table, "EPSG:32633")
    done = judge(place / "image.tif", None, dem=place / "dem.tif", points=table)
    assert (not done.reasons) == made


def test_the_rpc_of_a_result_is_refined_again(place: Any, tmp_path: Path) -> None:
    options = {"rpc": str(place / "image.RPB")}
    result = termsel.run("owdis-points", features=candidates(place, 0.0), model="rpc-shift",
                         solver="all-terms", options=options, out=tmp_path / "result")
    model, again = model_for(tmp_path / "result", place / "image.tif")
    assert model == "rpc-drift"
    true, fitted = place.world.independent(), termsel.fit(candidates(place, 0.0), model, **again)
    errors = [np.linalg.norm(one.project(true.ground) - true.image, axis=1).mean()
              for one in (result.fit, fitted)]
    assert errors[1] < 0.5 * errors[0]


def test_the_rpc_of_a_start_is_read_once_for_all_fits(place: Any) -> None:
    model, options = model_for(place / "image.RPB", place / "image.tif")
    made = termsel.get("models", model)
    by_file = made(rpc=str(place / "image.RPB"))
    assert options == {"rpc": by_file.options["rpc"]}
    assert made(**options).source == by_file.source


def test_a_folder_that_cannot_be_made_is_refused_at_once(place: Any, says: Any,
                                                         tmp_path: Path) -> None:
    code, text = says("auto-georeference", place / "image.tif", "--reference", place / "ortho.tif",
                      "--dem", place / "dem.tif", "-o", tmp_path / "map.tif", "--out",
                      place / "dem.tif" / "out")
    assert code == 2
    assert "cannot make this folder" in text
    assert "Start:" not in text


def test_vectors_that_cannot_be_read_are_refused_before_the_matching(place: Any,
                                                                     tmp_path: Path) -> None:
    with pytest.raises(TermselError, match="a table or other text, without lines of a map"):
        georeference_image(tmp_path / "none.tif", place / "ortho.tif", tmp_path / "map.tif",
                           dem=place / "dem.tif", vectors=place / "image.RPB")


def test_the_package_that_rpcs_require_is_asked_for_before_the_matching(
        place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("termsel_match.chain.find_spec", {}.get)
    with pytest.raises(TermselError, match=r"pip install \./plugins/termsel-rpc"):
        georeference_image(place / "image.tif", place / "ortho.tif", tmp_path / "map.tif",
                           dem=place / "dem.tif", folder=tmp_path / "out")
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("step", [1, 4])
def test_arrows_of_residuals_are_as_long_however_large_the_image_is(step: int) -> None:
    away = np.random.default_rng(1).normal(0, 0.1, (100, 2))
    times = scale_of(away, step)
    ends = np.array([arrow_ends(np.full(2, 400.0), one, times, step) for one in away]) / 16
    usual = np.quantile(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), 0.9)
    assert 15 < usual < 41
    assert np.allclose(ends[:, 0], (400.5 / step - 0.5), atol=0.1)
