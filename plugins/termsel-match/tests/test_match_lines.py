"""Candidate lines by matching an image with vectors, and the selection of those that agree."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("termsel_match", reason="termsel-match is not installed: "
                    "pip install -e plugins/termsel-match")

import shapely
from pyogrio.raw import write
from rasterio.transform import from_origin

import termsel
from termsel import FeatureSet, Lines, TermselError
from termsel.testing import checks
from termsel_match.commands import match_lines
from termsel_match.images.starts import Start, start_of, transform_plane
from termsel_match.lines import ridges
from termsel_match.lines.candidates import LineCandidates
from termsel_match.lines.candidates import match_lines as match
from termsel_match.lines.certainty import (
    fit_lines_or_hold_by_start,
    most_decisive_vector,
    sentences_on_certainty,
)
from termsel_match.lines.problem import RECIPE, MatchedLines
from termsel_match.lines.rounds import iterate_lines
from termsel_match.lines.tracing import Tracing, _bootstrap_units, variance_of_tracing
from termsel_match.lines.vectors import pieces_of
from termsel_match.simulated.world import WORLD_CRS

CHECKS = (*checks(match_lines, words=["none.tif", "--vectors", "none.gpkg"]),
          *checks(RECIPE))


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.name)
def test_conforms(check: Any) -> None:
    check.run()


def band_at(middle: float, width: float) -> tuple[np.ndarray, np.ndarray]:
    """Return offsets across, every half pixel, and a row of pixels with a bright band."""
    offset = np.arange(-20.0, 20.25, 0.5)
    return offset, np.where(np.abs(offset - middle) <= width / 2, 110.0, 10.0)[None]


def test_the_response_to_a_band_is_how_much_brighter_it_is() -> None:
    offset, row = band_at(1.0, 6.0)
    response = ridges._band_response(row, 6.0)[0]
    assert response[offset == 1.0] == pytest.approx(100.0)
    assert np.nanmax(response) == pytest.approx(100.0)
    assert ridges._band_response(-row, 6.0)[0][offset == 1.0] == pytest.approx(-100.0)
    # Than the brighter of its sides.
    for side in (offset < -2.0, offset > 4.0):
        brighter = np.where(side, 50.0, row)
        assert ridges._band_response(brighter, 6.0)[0][offset == 1.0] == pytest.approx(60.0)


def test_a_band_lies_in_the_middle_of_its_edges() -> None:
    offset, row = band_at(1.0, 6.0)
    assert ridges._middles_between_edges(
        row, offset, np.array([0.4]), 6.0) == pytest.approx(1.0, abs=0.05)



@pytest.fixture(scope="module")
def found(place: Any) -> LineCandidates:
    return match(place / "image.tif", place / "roads.gpkg", dem=place / "dem.tif")


def _away(place: Any, lines: Lines) -> Any:
    """Return the largest distance of both ground vertices from each image line."""
    ground = lines.ground.reshape(-1, 3)
    seen = place.world.camera.project(place.geographic(ground)).reshape(-1, 2, 2)
    run = lines.image[:, 1] - lines.image[:, 0]
    normal = np.stack([-run[:, 1], run[:, 0]], axis=1) / np.linalg.norm(run, axis=1)[:, None]
    return np.abs(np.einsum("nva,na->nv", seen - lines.image[:, :1], normal)).max(axis=1)


def test_most_candidates_are_wrong_and_many_pieces_have_a_right_one(
        place: Any, found: LineCandidates) -> None:
    right, piece = _away(place, found.lines) < 2, found.lines.attributes["piece"]
    assert right.mean() < 0.6
    with_right = [right[piece == one].any() for one in set(piece)]
    assert len(with_right) >= 10
    assert np.mean(with_right) > 0.35
    assert np.abs(found.lines.attributes["offset"].astype(float)).max() <= 63


@pytest.mark.slow
def test_rounds_find_the_camera_from_thirty_px_off(place: Any, tmp_path: Path) -> None:
    done = iterate_lines(place / "image.tif", place / "roads.gpkg", "rpc-drift",
                         {"rpc": str(place / "image.RPB")}, dem=place / "dem.tif",
                         folder=tmp_path / "result")
    true = place.world.independent()
    errors = np.linalg.norm(done.result.project(true.ground) - true.image, axis=1)
    assert np.sqrt((errors**2).mean()) < 0.6
    assert done.settled
    assert done.rounds[0].moved > 15 > 1 > done.rounds[-1].moved
    assert "round  search" in done.text()
    assert "in all directions" in done.text()
    assert 0.05 < done.tracing.sigma < 0.5
    assert "errors of the vectors leave" in done.text()
    assert "errors of the vectors leave" not in replace(done, tracing=Tracing()).text()
    assert termsel.read_result(tmp_path / "result").selection.features == done.lines.ids


def traced(sigma: float, seed: int, count: int) -> tuple[MatchedLines, Any, float]:
    """Return lines of vectors of which each is traced with one error, with those that agree.

    And by how much the model of these is off [px]. It is an affine transformation in a plane. Each
    vector has six pieces, and each of these a wrong candidate, too.
    """
    rng = np.random.default_rng(seed)
    of = np.repeat(np.arange(count), 6)
    middle, turn = rng.uniform(50, 950, (len(of), 2)), np.repeat(rng.uniform(0, np.pi, count), 6)
    along = 40 * np.stack([np.sin(turn), np.cos(turn)], axis=1)
    ends = np.stack([middle - along, middle + along], axis=1)
    image = ends + rng.normal(0, sigma, (count, 2))[of, None] + rng.normal(0, 0.2, ends.shape)
    wrong = image + rng.uniform(-30, 30, (len(of), 1, 2))
    ground = np.dstack([ends, np.full(ends.shape[:2], 0.0)])
    numbers = np.arange(len(of)).astype(str)
    lines = Lines(
        tuple(f"{name}.{k}" for k in (1, 2) for name in numbers), np.concatenate([image, wrong]),
        np.concatenate([ground, 0.99 * ground + 0.01 * ground[:, ::-1]]), attributes={
            "vector": np.tile(of.astype(str), 2).astype(object),
            "piece": np.tile(numbers, 2).astype(object)})
    features = FeatureSet(lines=lines, crs="local", image_size=(1000, 1000))
    problem: Any = termsel.prepare("matched-lines", features=features, model="poly2d",
                                   options={"degree": 1, "half_at": 1.0}).problem
    ids = np.array(problem.inputs.control.ids)
    right = np.flatnonzero(np.char.endswith(ids, ".1"))
    chosen = ids[problem.agreeing(problem.refined(problem.fitted(right)))]
    fitted = termsel.fit(features.with_(lines=lines.take(np.isin(lines.ids, chosen))), "poly2d",
                         degree=1)
    away = fitted.project(ground.reshape(-1, 3)) - ends.reshape(-1, 2)
    return problem, chosen, float(np.sqrt((away**2).sum(axis=1).mean()))


@pytest.mark.slow_cases("1.0", "2.5")
@pytest.mark.parametrize("sigma", [0.0, 1.0, 2.5])
def test_what_errors_of_tracing_leave_is_told(sigma: float) -> None:
    told, true = [], []
    for seed in range(6):
        problem, chosen, away = traced(sigma, seed, 14)
        found = variance_of_tracing(problem, chosen, 1)
        assert found.vectors == 14
        assert "a whole vector" not in found.text()
        told.append(found.sigma)
        true.append(away)
    ratio = np.sqrt(np.mean(np.square(told)) / np.mean(np.square(true)))
    assert 1 / 1.5 < ratio < 1.5


def test_few_vectors_do_not_show_errors_of_whole_ones() -> None:
    problem, chosen, _ = traced(2.0, 1, 4)
    text = variance_of_tracing(problem, chosen, 1).text()
    assert "apart from errors that a whole vector has" in text
    assert "Fewer than 6 vectors" in text


def test_stretches_of_few_vectors_are_contiguous() -> None:
    problem, _, _ = traced(0.0, 1, 8)  # 48 pieces, "0" to "47"
    one = problem.inputs.control.lines
    features = problem.inputs.control.with_(lines=replace(one, attributes={
        **one.attributes, "vector": np.full(len(one), "1", dtype=object)}))
    single: Any = termsel.prepare("matched-lines", features=features, model="poly2d",
                                  options={"degree": 1, "half_at": 1.0}).problem
    assert (np.diff(_bootstrap_units(single.vector)) >= 0).all()
    pieces = [str(one.attributes["piece"][own[0]]) for own in single.candidates_of_pieces()]
    assert pieces == [str(number) for number in range(48)]


def test_it_is_said_why_tracing_cannot_be_told() -> None:
    few: Any = SimpleNamespace(vector=np.zeros(3, dtype=int))
    found = variance_of_tracing(few, (), 1)
    assert "so few pieces" in found.text()
    assert found.vectors == 1


@pytest.mark.slow
def test_the_table_runs_as_a_problem(place: Any, found: LineCandidates, tmp_path: Path) -> None:
    termsel.write_lines_csv(found.lines, tmp_path / "lines.csv", found.crs)
    features = termsel.read(lines=tmp_path / "lines.csv")
    result = termsel.run("matched-lines", features=features, model="rpc-shift",
                         options={"rpc": str(place / "image.RPB")}, generations=30)
    chosen = features.lines.take(np.isin(features.lines.ids, result.selection.features))
    assert len(set(chosen.attributes["piece"])) == len(chosen)
    assert (_away(place, chosen) < 3).mean() > 0.6


def test_lines_of_one_direction_leave_the_other_undetermined() -> None:
    along = np.array([[0.0, 0], [0, 100]])  # along the samples: only the line is fixed
    image = np.stack([along + np.array([shift, 0]) for shift in (10, 200, 400)])
    ground = np.dstack([image, np.zeros((3, 2))])
    lines = Lines(("a", "b", "c"), image, ground, np.full(3, 0.5))
    assert "along it not at all" in sentences_on_certainty(lines)
    crossing = image[:1, :, ::-1] + 5
    more = Lines(("a", "b", "c", "d"), np.concatenate([image, crossing]),
                 np.dstack([np.concatenate([image, crossing]), np.zeros((4, 2))]),
                 np.full(4, 0.5))
    assert "in all directions" in sentences_on_certainty(more)


@pytest.fixture
def street(place: Any) -> FeatureSet:
    """Ten exact pieces of one street along the lines of the image, at the line 250."""
    samples = np.linspace(60, 440, 11)
    image = np.stack([np.column_stack([np.full(10, 250.0), ends])
                      for ends in (samples[:-1], samples[1:])], axis=1)
    seen = image.reshape(-1, 2) + np.array([0.0, 3.0])  # along it, the ends are elsewhere
    lonlat = place.world.camera.locate(seen, 520.0)
    ground = np.column_stack(
        [transform_plane(lonlat, "EPSG:4326", "EPSG:32633"), np.full(20, 520.0)])
    lines = Lines(tuple(f"L{i}" for i in range(10)), image, ground.reshape(10, 2, 3),
                  np.full(10, 0.3), attributes={"vector": np.array(["7"] * 10, dtype=object)})
    return FeatureSet(lines=lines, crs="EPSG:32633", image_size=(500, 500))


def test_one_street_fixes_the_image_across_it_and_the_start_holds_it_along(
        place: Any, street: FeatureSet) -> None:
    options = {"rpc": str(place / "image.RPB")}
    start = start_of(None, place / "image.tif")
    assert start is not None
    used, fitted = fit_lines_or_hold_by_start(street, "rpc-drift", options, start, 60.0)
    assert len(used.points) == 4
    result = termsel.run("owdis-lines", features=used, model="rpc-drift", solver="all-terms",
                         criterion="press", options={**options, "mixed": True})
    assert set(used.points.ids) < set(result.selection.features)  # none tells an accuracy
    middle = street.lines.ground.reshape(-1, 3)
    true = place.world.camera.project(place.geographic(middle))
    error = np.abs(fitted.project(middle) - true).max(axis=0)
    assert error[0] < 0.3 < 5 < error[1]
    sigma = fitted.sigma(middle)
    assert (sigma[:, 1] > 20 * sigma[:, 0]).all()
    assert "along it not at all: there the start holds it" in sentences_on_certainty(street.lines)
    assert "Uncertain: without vector 7" in most_decisive_vector(used, "rpc-drift", options).text()


@pytest.fixture
def vectors(tmp_path: Path) -> Callable[..., Path]:
    def save(lines: Any, crs: str | None = "EPSG:32633") -> Path:
        path = tmp_path / "vectors.gpkg"
        write(path, shapely.to_wkb(np.array([shapely.LineString(one) for one in lines])), [],
              fields=[], geometry_type="LineString", crs=crs)
        return path

    return save


def test_vectors_in_another_crs_give_the_same(place: Any, found: LineCandidates,
                                              vectors: Callable[..., Path]) -> None:
    other = match(place / "image.tif", vectors(
        [place.geographic(np.column_stack([one, one[:, 0] * 0]))[:, :2]
         for one in place.world.vectors()], "EPSG:4326"), dem=place / "dem.tif")
    middles, others = (one.lines.image.mean(axis=1) for one in (found, other))
    apart = np.linalg.norm(others[:, None] - middles, axis=2).min(axis=1)
    assert abs(other.pieces - found.pieces) <= 3
    assert (apart < 12).mean() > 0.9


def test_what_cannot_be_matched_is_refused(place: Any, vectors: Callable[..., Path], says: Any,
                                           tmp_path: Path, altered: Callable[..., Path]) -> None:
    west, north = place.world.corner
    elsewhere = altered("dem.tif", transform=from_origin(west + 90000, north, 8, 8))
    far = [one + 90000 for one in place.world.vectors()]
    image, dem = place / "image.tif", place / "dem.tif"
    for path, heights, reason in (
            (vectors(far), dem, "no straight piece"),
            (place / "roads.gpkg", elsewhere, "does not cover"),
            (tmp_path / "none.gpkg", dem, "does not exist"),
            (place / "image.RPB", dem, "table or other text, without lines of a map")):
        with pytest.raises(TermselError, match=reason):
            match(image, path, dem=heights)
    ways = tmp_path / "ways.geojson"
    ways.write_bytes(b'{"type": "FeatureCollection", "features": [\xff\xfe]}')
    far_away = tmp_path / "ways.vrt"
    far_away.write_text("<OGRVRTDataSource><OGRVRTLayer name='a'><SrcDataSource>/vsicurl/"
                        "http://127.0.0.1:9/a.gpkg</SrcDataSource></OGRVRTLayer></OGRVRTDataSource>")
    for path, reason in ((ways, "UTF-8"), (far_away, "OGR_VRT, which termsel does not open")):
        with pytest.raises(TermselError, match=reason):
            match(image, path, dem=dem)
    with pytest.raises(TermselError, match="have no CRS"):
        match(image, vectors(place.world.vectors(), None), dem=dem)
    code, text = says("match-lines", image, "--vectors", place / "roads.gpkg", "--out",
                      tmp_path / "r", "--output", tmp_path / "l.csv")
    assert code == 2
    assert "--out requires --iterate" in text
    with pytest.raises(TermselError, match="without a start"):
        match(image, place / "roads.gpkg", start="none")


def test_the_command_names_the_run_that_selects(place: Any, says: Any, tmp_path: Path) -> None:
    table = tmp_path / "the lines.csv"
    image = place / "image.tif"
    code, text = says("match-lines", image, "--vectors", place / "roads.gpkg",
                      "--dem", place / "dem.tif", "--output", table)
    assert code == 0
    assert f"Next: termsel run --problem matched-lines --model rpc-drift --set rpc={image}" in text
    assert f"--lines '{table}' --out result" in text


def test_the_run_that_it_names_is_determined_on_level_ground(
        place: Any, says: Any, tmp_path: Path, altered: Callable[..., Path]) -> None:
    start = tmp_path / "start.csv"
    termsel.write_points_csv(place.world.independent(20), start, WORLD_CRS)
    level = altered("dem.tif", lambda heights: np.full_like(heights, 200.0))
    code, text = says("match-lines", place / "image.tif", "--vectors", place / "roads.gpkg",
                      "--dem", level, "--start", start, "--output", tmp_path / "lines.csv")
    assert code == 0, text
    # Vectors lead beyond the DEM, and this start sees them without heights.
    found = termsel.read(lines=tmp_path / "lines.csv")
    assert np.isfinite(found.lines.ground).all()
    words = shlex.split(text.split("Next: termsel ")[1].splitlines()[0])
    assert words[words.index("--model"):][:4] == ["--model", "poly2d", "--set", "degree=1"]
    # Without the search, whose generations take seconds: all candidates, wrong ones included.
    assert termsel.fit(found, "poly2d", degree=1).determined


@pytest.mark.slow
def test_a_start_beyond_the_search_is_no_success(place: Any) -> None:
    rpc = place.world.rpc
    far = Start("a wrong RPC", "EPSG:4979", 520.0, lambda ground: rpc.project(ground) + 70,
                rpc.locate)
    with pytest.raises(TermselError, match="not enough"):
        iterate_lines(place / "image.tif", place / "roads.gpkg", "rpc-drift",
                      {"rpc": str(place / "image.RPB")}, dem=place / "dem.tif", start=far,
                      search=30)


def test_a_damaged_rpc_to_start_from_is_named(place: Any, tmp_path: Path) -> None:
    damaged = tmp_path / "damaged.RPB"
    damaged.write_text(re.sub(r"lineOffset = [^;]*;", "lineOffset = abc;",
                              (place / "image.RPB").read_text()))
    with pytest.raises(TermselError, match="lineOffset is 'abc'"):
        start_of(damaged, place / "image.tif")


def test_an_image_of_one_pixel_shows_no_lines(place: Any) -> None:
    start = start_of(place / "image.RPB", place / "image.tif")
    assert start is not None
    with pytest.raises(TermselError, match="1 x 1 px shows no lines"):
        pieces_of(place / "roads.gpkg", start, place / "dem.tif", (1, 1))


def test_points_are_refused(place: Any) -> None:
    points = place.world.independent()
    lines = Lines(("a",), np.array([[[0.0, 0], [9, 9]]]), points.ground[None, :2])
    with pytest.raises(TermselError, match="only 1 control line beside"):
        termsel.run("matched-lines", features=FeatureSet(
            replace(points, roles=()), lines, "EPSG:32633"))
