"""No false success and no false refusal: what is said of good and of bad references."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("termsel_match", reason="termsel-match is not installed: "
                    "pip install -e plugins/termsel-match")

import rasterio
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterio.windows import Window

from benchmarks.verdicts import BAD, PASSED, REFUSED, Repeated, verdict
from termsel import FeatureSet, Points, TermselError, read, read_result, write_points_csv
from termsel.toolkit import free_name
from termsel_match import chain
from termsel_match.chain import georeference_image, judge
from termsel_match.images.rasters import GreyRaster, open_picture
from termsel_match.judgement.along import Along, drift_along
from termsel_match.judgement.evidence import (
    OtherPlace,
    find_other_place,
    residual_structure,
    unsupported_share,
)
from termsel_match.judgement.repeats import repetition_distance
from termsel_match.judgement.selection import SelectedCandidates, _rms_at_unused, select_points
from termsel_match.judgement.verdict import reasons_to_reject
from termsel_match.simulated.world import WORLD_CRS, World
from termsel_match.simulated.world_files import write_world

SIZE = (1000, 1000)


@pytest.mark.slow_cases(
    "31-seam", "32-half replaced", "33-another place", "34-wrong heights", "36-clouds")
@pytest.mark.parametrize(("seed", "kind"), list(enumerate(BAD, 31)))
def test_a_bad_reference_does_not_pass_without_a_remark(tmp_path: Path, seed: int,
                                                        kind: str) -> None:
    assert verdict(kind, seed, 300, tmp_path).end != PASSED


@pytest.mark.slow
def test_a_good_reference_is_not_refused(tmp_path: Path) -> None:
    case = verdict("good", 41, 400, tmp_path)
    assert case.end != REFUSED
    assert case.true < 0.5


def measured(place: Any, seam: float = 0.0, noise: float = 0.2) -> FeatureSet:
    """Return exact places, those of the lower two fifths moved as by a seam."""
    points, rng = place.world.independent(), np.random.default_rng(2)
    image = points.image + rng.normal(0, noise, points.image.shape)
    image[points.image[:, 0] > 300] += seam * np.array([0.77, 0.64])
    return FeatureSet(replace(points, image=image, roles=()), crs="EPSG:32633",
                      image_size=(500, 500))


@pytest.mark.slow
def test_the_limit_does_not_grow_with_a_fault_of_the_reference(place: Any) -> None:
    for accept in (2.0, 1.5):
        limit = select_points(measured(place, 5.0), "rpc-drift",
                              {"rpc": str(place / "image.RPB")}, accept=accept).limit
        assert limit <= accept


@pytest.fixture(scope="module")
def straight(place: Any) -> SelectedCandidates:
    """Return the selection of places without a seam."""
    return select_points(measured(place), "rpc-drift", {"rpc": str(place / "image.RPB")})


@pytest.mark.slow_cases("4.0-400")
@pytest.mark.parametrize(("seam", "before"), [(1.0, 300), (4.0, 400)])
def test_a_smooth_correction_that_follows_a_seam_is_remarked(
        place: Any, seam: float, before: int) -> None:
    points, rng = place.world.independent(), np.random.default_rng(2)
    image = points.image + rng.normal(0, 0.15, points.image.shape)
    image[points.image[:, 0] > before] += seam * np.array([0.6, -0.8])
    features = FeatureSet(
        replace(points, image=image, roles=()), crs=WORLD_CRS, image_size=(500, 500))
    chosen = select_points(features, "rpc-drift", {"rpc": str(place / "image.RPB")})
    change = drift_along(chosen, chosen.points.take(chosen.agrees), 500)
    assert change.matters(2.0)
    certificate = chosen.result.certificate
    assert certificate is None or certificate.of == 1  # all are used: nothing to prove
    # By the correction alone: it leaves few residuals.
    assert chosen.correction.model == "rpc-jitter"
    assert abs(change.line - before) < 60
    assert change.away @ np.array([0.6, -0.8]) > 0.4 * seam


@pytest.mark.slow
@pytest.mark.parametrize("seam", [2.0, 7.8])
def test_a_seam_is_seen_and_named(place: Any, tmp_path: Path, seam: float) -> None:
    table = tmp_path / "candidates.csv"
    write_points_csv(measured(place, seam).points, table, "EPSG:32633")
    done = judge(place / "image.tif", place / "ortho.tif", dem=place / "dem.tif", points=table)
    said = " ".join((*done.remarks, *done.reasons))
    assert any(words in said for words in (
        "Residuals of neighbours are alike", "agree on another position",
        "changes along the lines"))
    assert "Look at this:" in done.text()


@pytest.mark.slow
def test_jitter_is_corrected_as_far_as_candidates_call_for_it() -> None:
    quiet, shaken = (World(size=500, seed=3, jitter=jitter) for jitter in (0.0, 1.2))
    for world, most in ((quiet, 0.2), (shaken, 0.5)):
        points, exact = world.independent(260), world.independent(460).take(np.arange(260, 460))
        image = points.image + np.random.default_rng(2).normal(0, 0.2, points.image.shape)
        image[:60] += np.random.default_rng(3).uniform(-30, 30, (60, 2))  # wrong ones
        features = FeatureSet(replace(points, image=image, roles=()), crs=WORLD_CRS,
                              image_size=(500, 500))
        chosen = select_points(features, "rpc-drift", {"rpc": json.dumps(asdict(world.rpc))})
        away = chosen.result.project(exact.ground) - exact.image
        assert np.sqrt((away**2).sum(axis=1).mean()) < most
    assert chosen.correction.model == "rpc-jitter"


@pytest.mark.slow_cases("1.2-3-False", "2.0-3-True")
@pytest.mark.parametrize(("jitter", "seed", "refused"), [(1.2, 3, False), (2.0, 3, True)])
def test_a_smooth_correction_is_not_taken_where_no_candidate_holds_it(
        tmp_path: Path, jitter: float, seed: int, refused: bool) -> None:
    world = World(size=400, seed=seed, jitter=jitter)
    write_world(world, tmp_path / "place")
    points, rng = world.independent(260), np.random.default_rng(2)
    points = points.take(points.image[:, 0] > 80)  # the first lines have none
    image = points.image + rng.normal(0, 0.2, points.image.shape)
    write_points_csv(replace(points, image=image, roles=()), tmp_path / "c.csv", WORLD_CRS)
    done = judge(tmp_path / "place" / "image.tif", None, dem=tmp_path / "place" / "dem.tif",
                 points=tmp_path / "c.csv")
    assert done.selected.called_for is not None
    assert done.selected.called_for.model == "rpc-jitter"
    assert "at held-out candidates it misses" in " ".join(done.remarks)
    exact = world.independent(400)
    away = np.linalg.norm(done.selected.result.project(exact.ground) - exact.image, axis=1)
    # What it misses is in its standard deviation.
    assert done.evidence.sigma > done.selected.missed > 0.1
    assert 0.7 < np.sqrt((away**2).mean()) / done.evidence.sigma < 1.5
    assert bool(done.reasons) == refused


@pytest.mark.parametrize("away", [0.0, 1.5])
def test_what_no_correction_can_follow_is_said_and_in_sigma(place: Any, tmp_path: Path,
                                                            away: float) -> None:
    points, rng = place.world.independent(120), np.random.default_rng(2)
    image = points.image + rng.normal(0, 0.2, points.image.shape)
    image[:, 0] += away * np.sin(points.image[:, 1] / 80)  # across the lines
    table = tmp_path / "c.csv"
    write_points_csv(replace(points, image=image, sigma=np.full(image.shape, 0.2), roles=()),
                     table, WORLD_CRS)
    done = judge(place / "image.tif", None, dem=place / "dem.tif", points=table)
    assert any("the model misses" in one for one in done.remarks) == (away > 0.0)
    assert away or not done.reasons
    assert ("Look at this:" in done.text()) == bool(done.remarks)
    assert (done.selected.missed > 0.5) == (away > 0.0)
    assert done.evidence.sigma > done.selected.missed


def test_what_a_correction_misses_is_neither_noise_nor_wrong_candidates() -> None:
    rng = np.random.default_rng(4)
    line = np.sort(rng.uniform(0, 500, 400))
    image = np.column_stack([line, rng.uniform(0, 500, 400)])
    jitter = np.column_stack([3 * np.sin(line / 20), 0 * line])
    seen: Any = SimpleNamespace(project=lambda ground: ground[:, :2])
    for missed in (0.0, 1.0):
        moved = missed * jitter + rng.normal(0, 0.5, (400, 2))
        moved[::5] += rng.uniform(-60, 60, (80, 2))
        ground = np.column_stack([image - moved, np.zeros(400)])
        for sigma, noise in ((None, 0.5), (0.5, 0.0), (5.0, 0.0)):  # the last is overstated
            stated = None if sigma is None else np.full((400, 2), sigma)
            told = _rms_at_unused(seen, Points(tuple(map(str, range(400))), image, ground, stated))
            true = np.hypot(missed * 3 / 2**0.5, noise * 2**0.5)
            assert abs(told - true) < 0.35


@pytest.mark.slow
def test_where_no_plainer_correction_is_possible_the_richer_one_stays(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(size=400, seed=3, jitter=1.2)
    write_world(world, tmp_path / "place")
    points = world.independent(260)
    points = points.take(points.image[:, 0] > 80)
    write_points_csv(replace(points, roles=()), tmp_path / "c.csv", WORLD_CRS)

    def once(*args: Any, plainer_than: Any = None, **options: Any) -> Any:
        if plainer_than is not None:
            raise TermselError("not enough candidates agree")
        return select_points(*args, **options)

    monkeypatch.setattr(chain, "select_points", once)
    done = judge(tmp_path / "place" / "image.tif", None, dem=tmp_path / "place" / "dem.tif",
                 points=tmp_path / "c.csv", folder=tmp_path / "out")
    assert done.selected.correction.model == "rpc-jitter"
    assert any("standard deviation" in reason for reason in done.reasons)
    assert read_result(tmp_path / "out" / "result").model == "rpc-jitter"


def test_roles_are_all_along_the_lines(straight: SelectedCandidates) -> None:
    line = straight.points.image[:, 0]
    for part in (straight.independent, ~straight.independent):
        spread = np.sort(line[part])
        assert np.diff(spread).max() < 8 * len(line) / part.sum() * np.ptp(line) / len(line)
    assert straight.independent.sum() == 50


def test_a_correction_without_a_seam_changes_nowhere(straight: SelectedCandidates) -> None:
    assert not drift_along(straight, straight.points.take(straight.agrees), 500).matters(2.0)
    certificate = straight.result.certificate
    assert certificate is None or certificate.of == 1  # all are used: nothing to prove


@pytest.mark.slow
def test_large_corrections_and_strange_heights_are_remarked(place: Any, tmp_path: Path) -> None:
    for above, said in ((0.0, False), (300.0, True)):
        features = measured(place)
        ground = features.points.ground + np.array([0, 0, above])
        table = tmp_path / f"{above}.csv"
        write_points_csv(replace(features.points, ground=ground), table, "EPSG:32633")
        done = judge(place / "image.tif", None, dem=place / "dem.tif", points=table)
        text = done.text()
        assert ("The correction of" in text) == said
        assert ("the RPC is made for" in text) == said
        assert done.evidence.correction is not None
        moved = np.linalg.norm(done.evidence.correction, axis=1)
        assert f"Correction to the start: {np.median(moved):.1f} px" in text


@pytest.mark.slow
def test_a_reference_of_a_part_is_no_reason_to_refuse(place: Any, altered: Callable[..., Path],
                                                      tmp_path: Path) -> None:
    def quarter(pixels: Any) -> Any:
        pixels[:, pixels.shape[1] * 11 // 20:] = pixels[:, :, pixels.shape[2] * 11 // 20:] = 0
        return pixels

    ortho = altered("ortho.tif", quarter, nodata=0)
    maps = []
    for extent in ("image", "reference"):
        maps.append(tmp_path / f"{extent}.tif")
        done = georeference_image(
            place / "image.tif", ortho, maps[-1], dem=place / "dem.tif", extent=extent, count=150)
        assert not done.reasons
        assert done.evidence.covered > 0.4  # of a third of the image
        exact = place.world.independent()
        away = done.selected.result.project(exact.ground) - exact.image
        assert np.sqrt((away**2).sum(axis=1).mean()) < 1
    with rasterio.open(maps[0]) as whole, rasterio.open(maps[1]) as part, \
            rasterio.open(place / "ortho.tif") as reference:
        assert part.bounds.left >= reference.bounds.left
        assert part.bounds.right <= reference.bounds.right
        assert whole.shape >= part.shape


@pytest.mark.parametrize("words", [("match-points", "a.tif", "--reference", "b.tif"),
                                   ("match-lines", "a.tif", "--vectors", "roads.gpkg"),
                                   ("match-ties", "a.tif", "b.tif")])
def test_tables_of_matches_are_not_named_as_workbooks(words: tuple[str, ...], says: Any) -> None:
    code, text = says(*words, "--dem", "dem.tif", "-o", "candidates.xlsx")
    assert code == 2
    assert "this file is written as CSV, not as .xlsx. Name it candidates.csv." in text


@pytest.mark.slow
def test_the_recommended_run_is_the_run_of_the_chain(place: Any, says: Any,
                                                     tmp_path: Path) -> None:
    common = ("--reference", place / "ortho.tif", "--dem", place / "dem.tif")
    table = tmp_path / "candidates.csv"
    code, text = says("match-points", place / "image.tif", *common, "--count", 80, "-o", table)
    assert code == 0
    words = text.split("Next: termsel ")[1].split()
    assert words[:4] == ["auto-georeference", str(place / "image.tif"), "--points", str(table)]
    assert words[-4:] == ["-o", free_name("map.tif"), "--out", free_name("result")]
    reports = []
    for name, extra in (("one", ("--points", table)), ("two", ("--count", 80))):
        code, text = says("auto-georeference", place / "image.tif", *common, *extra, "-o",
                          tmp_path / f"{name}.tif", "--out", tmp_path / name)
        assert code == 0
        report = (tmp_path / name / "report.txt").read_text().splitlines()
        reports.append([line for line in report if not line.startswith("Candidates:")])
    assert reports[0] == reports[1]
    with rasterio.open(tmp_path / "one.tif") as one, rasterio.open(tmp_path / "two.tif") as two:
        assert one.transform == two.transform
        assert (one.read() == two.read()).all()


@pytest.mark.slow
def test_independent_points_of_a_table_stay_so(place: Any, tmp_path: Path) -> None:
    points, table = measured(place).points, tmp_path / "points.csv"
    roles = tuple("independent" if i < 40 else "off" if i < 50 else "control" for i in range(200))
    write_points_csv(replace(points, roles=roles), table, "EPSG:32633")
    done = judge(place / "image.tif", None, dem=place / "dem.tif", points=table)
    chosen = done.selected
    assert {name for name, one in zip(chosen.points.ids, chosen.independent, strict=True)
            if one} == set(points.ids[:40])
    assert len(chosen.points) == 190


def test_what_is_missing_is_said(place: Any, tmp_path: Path, says: Any) -> None:
    words = ("auto-georeference", place / "image.tif", "--dem", place / "dem.tif", "-o",
             tmp_path / "map.tif")
    assert "the reference is not given" in says(*words)[1]
    few = tmp_path / "few.csv"
    write_points_csv(measured(place).points.take(range(5)), few, "EPSG:32633")
    assert "not enough candidates: 5" in says(*words, "--points", few)[1]
    assert "the reference is not given" in says(*words, "--points", few, "--extent",
                                                "reference")[1]
    pixels, arosics = tmp_path / "pixels.csv", tmp_path / "arosics.csv"
    pixels.write_text("y1,x1,y2,x2\n1,2,3,4\n")
    arosics.write_text("POINT_ID,X_IM,Y_IM,X_MAP,Y_MAP,X_SHIFT_M,Y_SHIFT_M\n1,2,3,4,5,6,7\n")
    for table in (pixels, arosics):
        text = says(*words, "--points", table)[1]
        assert "Give the georeferenced image by --reference" in text
        assert "--set" not in text
    pixels.write_text("y1,x1,y2,x2\n1,2,abc,4\n")
    for more in ((), ("--reference", place / "ortho.tif")):
        text = says(*words, "--points", pixels, *more)[1]
        assert "line 2" in text
        assert "y2" in text
        assert "--reference" not in text
    assert read(few).points.ids[0] == "T001"


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.0, 0.3))
def test_structure_is_seen_where_there_is_some(seed: int, noise: float) -> None:
    rng = np.random.default_rng(seed)
    image = rng.uniform(0, 1000, (80, 2))
    step = np.where(image[:, :1] > 500, 1.0, -1.0) * [0.6, 0.8]
    found = residual_structure(image, step + rng.normal(0, noise, (80, 2)), 2.0, SIZE, rng)
    assert found is not None
    assert found.level <= 0.01
    assert 0.6 < found.size < 1.2


@pytest.mark.slow
def test_structure_of_noise_is_rarely_seen() -> None:
    rng, seen = np.random.default_rng(5), 0
    for _ in range(100):
        found = residual_structure(
            rng.uniform(0, 1000, (60, 2)), rng.normal(0, 1, (60, 2)), 3.5, SIZE, rng)
        assert found is not None
        seen += found.level <= 0.01
    assert seen <= 4


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6))
def test_another_place_is_told_from_chance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    image, wrong = rng.uniform(0, 1000, (40, 2)), rng.uniform(-70, 70, (40, 2))
    alike = np.array([40.0, -12.0]) + rng.normal(0, 0.3, (12, 2))
    found = find_other_place(image, np.concatenate([wrong[:28], alike]), 2.0, SIZE)
    assert found is not None
    assert found.count >= 12
    assert np.allclose(found.away, [40, -12], atol=0.6)
    assert find_other_place(image[:3], alike[:3], 2.0, SIZE) is None


@pytest.mark.parametrize(("change", "said"), [
    ({}, ()), ({"median": 2.1}, ("Half of the independent candidates",)),
    ({"rmse": 2.1}, ("The RMSE of those that agree is 2.10 px; accepted are 2 px.",)),
    ({"sigma": np.nan}, ("The predicted standard deviation",)),
    ({"agrees": np.arange(60) < 3}, ("Only 3 of 60 independent candidates agree",)),
    ({"along_lines": Along(1.0, 581.0, (-4.0, -5.0)),
      "other_place": OtherPlace(13, (4.5, 5.5), "the middle")},
     ("Near line 581 the correction changes by (-4.0, -5.0) px in line and sample, and",)),
    ({"along_lines": Along(1.0, 581.0, (-4.0, -5.0)),
      "other_place": OtherPlace(13, (30, 5), "the middle")},
     ()),
    ({"along_lines": Along(1.0, 581.0, (-1.0, -1.5)),
      "other_place": OtherPlace(13, (1, 1.5), "the middle")},
     ())])
def test_each_limit_is_a_reason(change: dict[str, Any], said: tuple[str, ...]) -> None:
    found: Any = SimpleNamespace(**{
        "independent": np.ones(60, dtype=bool), "agrees": np.ones(60, dtype=bool), "median": 2.0,
        "rmse": 2.0, "sigma": 2.0, "structure": None, "other_place": None, "along_lines": Along(),
        **change})
    refused = reasons_to_reject(found, found, 2.0)
    assert len(refused) == len(said)
    assert all(reason.startswith(word) for reason, word in zip(refused, said, strict=True))


def test_parts_without_candidates_are_named() -> None:
    rng, shown = np.random.default_rng(1), np.ones((33, 33), dtype=bool)
    image = rng.uniform(0, 1000, (100, 2))
    assert unsupported_share(image, shown, SIZE)[0] < 0.05
    share, where = unsupported_share(image[image[:, 0] < 500], shown, SIZE)
    assert 0.25 < share < 0.5
    assert where == "the lower part"
    shown[17:] = False  # the reference ends there, so none is expected
    assert unsupported_share(image[image[:, 0] < 500], shown, SIZE)[0] < 0.1


def test_ground_that_repeats_is_told_from_other_ground(tmp_path: Path) -> None:
    for own, least, most in ((World, 0.0, 0.4), (Repeated, 0.8, 1.0)):
        pixels, path = own(size=300, seed=5).ortho(), tmp_path / f"{own.__name__}.tif"
        with rasterio.open(path, "w", driver="GTiff", dtype=pixels.dtype, count=1,
                           height=len(pixels), width=pixels.shape[1]) as raster:
            raster.write(pixels, 1)
        with open_picture(path) as picture:
            distance, alike = repetition_distance(picture, np.array([[0, 0], picture.size]))
            assert repetition_distance(picture, np.full((3, 2), np.nan)) == (0, 0)
        assert least <= alike <= most
    assert distance == 59  # the tile has 118 px of 0.5 m


@pytest.mark.slow
def test_a_large_reference_is_read_by_windows(place: Any, tmp_path: Path,
                                              monkeypatch: pytest.MonkeyPatch) -> None:
    side, away, path = 8704, (4100, 3000), tmp_path / "large.tif"
    with rasterio.open(place / "ortho.tif") as ortho:
        pixels, transform = ortho.read(1), ortho.transform
        moved = transform * transform.translation(-away[0], -away[1])
        with rasterio.open(path, "w", driver="GTiff", width=side, height=side, count=1,
                           dtype="uint8", crs=ortho.crs, tiled=True, sparse_ok=True,
                           transform=moved) as raster:
            raster.write(pixels, 1, window=Window(*away, *pixels.shape[::-1]))
    windows, read_window = [], GreyRaster.read

    def counted(self: GreyRaster, top: int, left: int, lines: int, samples: int,
                step: int = 1) -> Any:
        if self.path == path:
            windows.append((top, left, lines, samples))
        return read_window(self, top, left, lines, samples, step)

    monkeypatch.setattr(GreyRaster, "read", counted)
    done = judge(place / "image.tif", path, dem=place / "dem.tif", count=80)
    assert not done.reasons
    assert windows
    # None is larger than what the image shows, and all are where that is.
    for top, left, lines, samples in windows:
        assert max(lines, samples) < 1.5 * max(pixels.shape)
        assert away[1] - 200 < top < top + lines < away[1] + pixels.shape[0] + 200
        assert away[0] - 200 < left < left + samples < away[0] + pixels.shape[1] + 200


def test_a_file_that_is_no_table_is_refused(place: Any, tmp_path: Path) -> None:
    with pytest.raises(TermselError):
        judge(place / "image.tif", place / "ortho.tif", dem=place / "dem.tif",
              points=tmp_path / "none.csv")
    assert isinstance(measured(place).points, Points)
