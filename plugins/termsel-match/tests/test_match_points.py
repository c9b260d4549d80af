"""Candidate points by matching an image with a reference."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("termsel_match", reason="termsel-match is not installed: "
                    "pip install -e plugins/termsel-match")

import cv2
from rasterio.transform import from_origin

import termsel
from termsel import TermselError
from termsel.testing import checks
from termsel.toolkit import free_name
from termsel_match.commands import match_example, match_points, next_map_command
from termsel_match.images import overview
from termsel_match.points.candidates import Candidates
from termsel_match.points.candidates import match_points as match
from termsel_match.simulated.scenery import Scenery
from termsel_match.simulated.world import World
from termsel_match.simulated.world_files import write_world

CHECKS = (*checks(match_points, words=["none.tif", "--reference", "none.tif"]),
          *checks(match_example, words=["/dev/null"]))


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.name)
def test_conforms(check: Any) -> None:
    check.run()


def test_places_of_a_reduced_image_are_those_of_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    class Picture:
        size = (3000, 4000)

        def read(self, *window: int) -> tuple[int, ...]:
            assert window == (0, 0, 3000, 4000, 4)
            return window[:2]

    places = np.array([[0.0, 0.0], [10.0, 2.5]])
    monkeypatch.setattr(overview, "describe_keypoints", lambda *_: (places, "vectors"))
    found, vectors = overview._describe_whole(Picture())  # type: ignore[arg-type]
    # The middle of a pixel made of four by four lies between the second and the third.
    assert found.tolist() == [[1.5, 1.5], [41.5, 11.5]]
    assert vectors == "vectors"



@pytest.fixture(scope="module")
def found(place: Any) -> Candidates:
    return match(place / "image.tif", place / "ortho.tif", dem=place / "dem.tif", count=120)


def test_most_candidates_are_right_to_a_third_of_a_pixel(place: Any, found: Candidates) -> None:
    errors = place.errors(found.points, found.crs)
    assert len(errors) >= 60
    assert (errors < 1).mean() > 0.85
    assert np.sqrt((errors[errors < 1] ** 2).mean()) < 0.35
    assert found.start == "the RPC of image.tif"


def chi_squares(place: Any, found: Candidates) -> Any:
    """Return the mean squared errors of lines and of samples by their variances, of right ones."""
    points = found.points
    assert points.sigma is not None
    errors = points.image - place.world.camera.project(place.geographic(points.ground, found.crs))
    away = np.linalg.norm(errors, axis=1)
    right = away <= 3.5 * np.median(away[away < 2]) / 1.1774
    assert right.mean() > 0.75
    return (errors[right] ** 2 / points.sigma[right] ** 2).mean(axis=0)


def test_their_standard_deviations_hold(place: Any, found: Candidates) -> None:
    assert (np.abs(np.log(chi_squares(place, found))) < np.log(1.6)).all()


@pytest.mark.slow
@pytest.mark.parametrize("texture", ["moon", "gravel"])
def test_their_standard_deviations_hold_on_photographs(place: Any, texture: str,
                                                       tmp_path: Path) -> None:
    photographs = pytest.importorskip("skimage.data", reason="needs photographs of scikit-image")

    class Covered(World):
        @cached_property
        def ground(self) -> Scenery:
            own = super().ground
            pixels = cv2.resize(getattr(photographs, texture)().astype(np.float32),
                                own.buildings.shape[::-1], interpolation=cv2.INTER_CUBIC)
            bright = np.clip(120 + 35 * (pixels - pixels.mean()) / pixels.std(), 10, 245)
            return replace(own, days=(bright.astype(np.uint8),) * 2,
                           buildings=np.zeros_like(own.buildings))

    covered = replace(place, world=Covered(size=500, seed=3), folder=tmp_path / "place")
    write_world(covered.world, covered.folder)
    found = match(covered / "image.tif", covered / "ortho.tif", dem=covered / "dem.tif", count=150)
    assert (np.abs(np.log(chi_squares(covered, found))) < np.log(1.6)).all()


def test_they_are_spread_over_the_image_and_have_scores(found: Candidates) -> None:
    corner = (found.points.image > 250) @ [1, 2]
    assert np.bincount(corner, minlength=4).min() >= 8
    score = found.points.attributes["score"].astype(float)
    assert ((score >= 0.5) & (score <= 1)).all()
    assert sum(found.cells.values()) >= found.cells["found"] > 15


@pytest.mark.slow
def test_without_a_start_the_place_is_found(place: Any) -> None:
    other = match(place / "image.tif", place / "ortho.tif", dem=place / "dem.tif", count=60,
                  start="none")
    assert "affine" in other.start
    assert (place.errors(other.points, other.crs) < 1).mean() > 0.8


@pytest.mark.slow
def test_what_takes_long_is_said_before(
        place: Any, altered: Callable[..., Path], caplog: pytest.LogCaptureFixture,
        monkeypatch: pytest.MonkeyPatch) -> None:
    caplog.set_level("INFO", logger="termsel")
    monkeypatch.setattr(overview, "_MANY_PIXELS", 1e5)
    many = altered("image.tif", lambda pixels: np.repeat(pixels, 40, axis=0))
    many.with_suffix(".RPB").unlink()  # a start
    found = match(many, place / "ortho.tif", dem=place / "dem.tif", count=40)
    assert (place.errors(found.points, found.crs) < 1).mean() > 0.8
    assert "the mean of 16 of the 40 bands" in caplog.text
    assert f"px of {many} are read to find the image" in caplog.text
    assert "A --start saves it" in caplog.text


@pytest.mark.slow
def test_three_corners_are_a_start(place: Any, tmp_path: Path) -> None:
    points = place.world.independent().take([0, 40, 80, 120])
    rough = termsel.Points(points.ids, points.image + np.array([9, -7]), points.ground)
    termsel.write_points_csv(rough, tmp_path / "rough.csv", "EPSG:32633")
    other = match(place / "image.tif", place / "ortho.tif", dem=place / "dem.tif", count=60,
                  start=tmp_path / "rough.csv")
    assert (place.errors(other.points, other.crs) < 1).mean() > 0.8
    table = (tmp_path / "rough.csv").read_text()
    (tmp_path / "unknown.csv").write_text(table.removeprefix("# crs: EPSG:32633\n"))
    with pytest.raises(TermselError, match="is unknown") as error:
        match(place / "image.tif", place / "ortho.tif", start=tmp_path / "unknown.csv")
    assert "# crs: EPSG:32633" in (error.value.hint or "")


@pytest.mark.slow
def test_bands_and_types_do_not_matter(place: Any, altered: Callable[..., Path]) -> None:
    image = altered("image.tif", lambda pixels: np.concatenate(
        [pixels * 7, pixels * 0 + 5, pixels * 3]).astype(np.float32))
    other = match(image, place / "ortho.tif", dem=place / "dem.tif", count=60)
    assert (place.errors(other.points, other.crs) < 1).mean() > 0.8
    with pytest.raises(TermselError, match="no band 4"):
        match(image, place / "ortho.tif", band=4)


@pytest.mark.slow
def test_a_coarser_reference_is_matched_at_its_resolution(place: Any,
                                                          altered: Callable[..., Path]) -> None:
    west, north = place.world.corner
    ortho = altered("ortho.tif", lambda pixels: cv2.resize(
        pixels[0], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)[None],
        transform=from_origin(west, north, 2, 2))
    other = match(place / "image.tif", ortho, dem=place / "dem.tif", count=60)
    errors = place.errors(other.points, other.crs)
    assert (errors < 2).mean() > 0.8
    assert np.median(errors) < 0.7


def test_the_next_command_names_a_map_and_a_folder_that_are_new(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert (free_name("map.tif"), free_name("result")) == ("map.tif", "result")
    Path("map.tif").touch()
    for name in ("result", "result-2"):
        Path(name).mkdir()
    words = (Path("a.tif"), Path("b.tif"), Path("c.csv"), Path("d.tif"), None)
    assert next_map_command(*words).endswith(" --dem d.tif -o map-2.tif --out result-3")


def test_the_command_writes_candidates_for_a_run(place: Any, says: Any, tmp_path: Path) -> None:
    table = tmp_path / "c.csv"
    words = ("match-points", place / "image.tif", "--reference", place / "ortho.tif", "--dem",
             place / "dem.tif", "--count", 60, "--output", table)
    code, text = says(*words)
    assert code == 0
    assert "candidates in" in text
    assert "Next: termsel auto-georeference " in text
    assert "Choose another name, or add --overwrite." in says(*words)[1]
    features = termsel.read(table)
    assert table.read_text().splitlines()[1].endswith(",score")
    result = termsel.run("rpc-gcps", features=features, criterion="median", generations=10,
                         options={"rpc": str(place / "image.RPB")})
    independent = place.world.independent()
    errors = np.linalg.norm(result.project(independent.ground) - independent.image, axis=1)
    assert np.sqrt((errors**2).mean()) < 0.7


def _cloud(pixels: Any) -> Any:
    rng = np.random.default_rng(0)
    soft = cv2.resize(rng.standard_normal((8, 8)).astype(np.float32), pixels.shape[1:],
                      interpolation=cv2.INTER_CUBIC)
    return (1700 + 60 * soft + rng.normal(0, 10, soft.shape)).round().astype(np.uint16)[None]


@pytest.mark.slow_cases("cloud")
@pytest.mark.parametrize(("change", "reason"), [
    (_cloud, "not enough candidates"),
    (lambda pixels: np.full_like(pixels, 100), "no texture"),
], ids=["cloud", "flat"])
def test_an_image_without_likeness_ends_with_the_reason(
        place: Any, altered: Callable[..., Path], change: Any, reason: str) -> None:
    with pytest.raises(TermselError, match="not enough candidates") as caught:
        match(altered("image.tif", change), place / "ortho.tif", dem=place / "dem.tif", count=60)
    assert reason in str(caught.value)


@pytest.mark.slow
def test_a_reference_elsewhere_or_nowhere_is_refused(place: Any,
                                                     altered: Callable[..., Path]) -> None:
    west, north = place.world.corner
    dem = place / "dem.tif"
    for profile, reason in (({"crs": None, "transform": None}, "the reference has no CRS"),
                            ({"transform": from_origin(west + 9000, north, 1, 1)},
                             "do not overlap"),
                            ({"transform": from_origin(west + 300, north, 1, 1)},
                             "more than --search")):
        with pytest.raises(TermselError, match=reason):
            match(place / "image.tif", altered("ortho.tif", **profile), dem=dem, count=60)
    far = altered("dem.tif", transform=from_origin(west + 90000, north, 8, 8))
    with pytest.raises(TermselError, match="do not overlap"):
        match(place / "image.tif", place / "ortho.tif", dem=far)


@pytest.mark.slow
def test_without_heights_it_is_said(place: Any, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("INFO", logger="termsel.match"):
        other = match(place / "image.tif", place / "ortho.tif", count=60)
    assert np.isnan(other.points.ground[:, 2]).all()
    assert "the heights are unknown" in caplog.text


@pytest.mark.parametrize(("start", "reason"), [
    ("corners", "neither GCPs nor a geotransform"), ("nowhere", "does not exist")])
def test_a_start_that_is_none_is_refused(place: Any, start: str, reason: str) -> None:
    with pytest.raises(TermselError, match=reason):
        match(place / "image.tif", place / "ortho.tif", start=start)


def test_the_file_that_is_cut_off_is_named(place: Any, says: Any, tmp_path: Path) -> None:
    cut = tmp_path / "cut.tif"
    cut.write_bytes((place / "image.tif").read_bytes()[:3000])
    (tmp_path / "cut.RPB").write_bytes((place / "image.RPB").read_bytes())
    code, text = says("match-points", cut, "--reference", place / "ortho.tif", "--dem",
                      place / "dem.tif", "-o", tmp_path / "c.csv")
    assert code == 2
    assert "cut.tif" in text
    assert "ortho.tif" not in text


@pytest.mark.parametrize("option", ["--search", "--seconds"])
def test_nan_is_no_number(place: Any, says: Any, tmp_path: Path, option: str) -> None:
    code, text = says("match-points", place / "image.tif", "--reference", place / "ortho.tif",
                      option, "nan", "-o", tmp_path / "c.csv")
    assert code == 2
    assert "'nan' is no number" in text
