"""Blocks: the adjustment against truth and LAPACK, what it names, and its command."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

pytest.importorskip("termsel_block", reason="termsel-block is not installed: "
                    "pip install -e plugins/termsel-block")

import jsonschema  # type: ignore[import-untyped]

from termsel import FeatureSet, Points, Rpc, TermselError, read_result, read_rpc
from termsel.testing import invoke
from termsel_block.accuracy import (
    Spread,
    errors_in_space,
    independent_points,
    predicted_errors,
    rms_length,
)
from termsel_block.block import Block, BlockImage, Ties
from termsel_block.estimation.equations import TieRows, image_pairs, solve
from termsel_block.evidence.factors import log_bayes_factor
from termsel_block.files.block_file import read_block
from termsel_block.geometry.frame import FloatArray, IntArray
from termsel_block.joint import BlockResult, adjust
from termsel_block.shown import page
from termsel_block.shown.record import connected_images, record_of, times_seen
from termsel_block.shown.summary import LINES, first_screen, text_of
from termsel_block.simulated import Simulated, simulate_block

Example = tuple[Path, dict[str, Any]]


def own(image: BlockImage) -> FeatureSet:
    """Return the features of an image that has some."""
    assert image.features is not None
    return image.features


def vendor(image: BlockImage) -> Rpc:
    """Return the RPC of an image that has one."""
    assert image.rpc is not None
    return image.rpc


def judging(result: BlockResult, i: int) -> Points:
    """Return the independent points of an image that has some."""
    points = independent_points(result, i)
    assert points is not None
    return points


@pytest.fixture(scope="module")
def vendors() -> Simulated:
    """Three images with RPCs; four control points in the first two, a twentieth of ties wrong."""
    return simulate_block(3, rpcs=True, control=(4, 4), wrong=0.05, seed=1, independent=40)


@pytest.fixture(scope="module")
def adjusted(vendors: Simulated) -> BlockResult:
    return adjust(vendors.block)


def errors(result: BlockResult, i: int) -> float:
    points = judging(result, i)
    return rms_length(points.image - result.project(i, points.ground))


def test_an_image_without_control_is_held_by_its_ties(
        vendors: Simulated, adjusted: BlockResult) -> None:
    image = vendors.block.images[2]
    points = judging(adjusted, 2)
    delivered = rms_length(points.image - vendor(image).project(points.ground))
    assert errors(adjusted, 2) < 0.6 * delivered
    assert adjusted.adjusted.converged


def test_wrong_ties_are_named_and_cost_little(vendors: Simulated, adjusted: BlockResult) -> None:
    clean = adjust(simulate_block(3, rpcs=True, control=(4, 4), seed=1, independent=40).block)
    assert not record_of(clean).wrong_ties
    record = record_of(adjusted)
    far = [np.hypot(*(vendors.block.ties.position - sensor_places(vendors))[k])
           for k in range(len(vendors.block.ties.tie))]
    wrong = {(vendors.block.ties.names[vendors.block.ties.tie[k]],
              vendors.block.images[vendors.block.ties.image[k]].name)
             for k in np.flatnonzero(np.array(far) > 15)}
    named = {(one.id, one.image) for one in record.wrong_ties}
    assert len(wrong - named) <= 0.1 * len(wrong)  # along the other ray nothing shows
    assert np.mean([errors(adjusted, i) for i in range(3)]) < 1.3 * np.mean(
        [errors(clean, i) for i in range(3)])


def sensor_places(simulated: Simulated) -> FloatArray:
    """Return where the exact scanners see the ties."""
    ties, places = simulated.block.ties, np.empty((len(simulated.block.ties.tie), 2))
    for i, sensor in enumerate(simulated.sensors):
        mine = ties.image == i
        places[mine] = sensor.project(simulated.ties[ties.tie[mine]])
    return places


def test_standard_deviations_are_true(vendors: Simulated, adjusted: BlockResult) -> None:
    assert adjusted.adjusted.state.sigma_ties == pytest.approx(0.4, rel=0.15)
    away = adjusted.adjusted.state.ties - adjusted.frame.local(vendors.ties)
    seen = np.bincount(vendors.block.ties.tie) > 1
    ratio = np.median((away / adjusted.sigma_ties)[seen] ** 2, axis=0)
    assert (ratio > 0.02).all()
    assert (ratio < 5).all()
    for i in range(3):
        expected = predicted_errors(adjusted, i)
        assert expected.low < expected.rmse < 1.2 * expected.high
        assert errors(adjusted, i) < 2.5 * expected.high


def test_an_interval_is_for_the_independent_points_of_the_image(adjusted: BlockResult) -> None:
    """For so many, where they are; where there are none, for the area of the ties."""
    def of(keep: IntArray) -> Spread:
        image, points = adjusted.block.images[2], judging(adjusted, 2).take(keep)
        images = (*adjusted.block.images[:2], replace(image, features=replace(
            own(image), points=points)))
        return predicted_errors(replace(adjusted, block=replace(adjusted.block, images=images)), 2)

    points = judging(adjusted, 2)
    away = np.hypot(*(points.image - points.image.mean(axis=0)).T)
    near, few = np.argsort(away)[:len(away) // 3], np.argsort(away)[:2]
    every, middle, two, ties = map(of, (np.arange(len(away)), near, few, np.empty(0, np.intp)))
    assert middle.rmse < every.rmse < ties.rmse
    assert two.high / two.low > 1.3 * middle.high / middle.low


def test_the_step_is_that_of_lapack() -> None:
    """Against all unknowns at once by a dense solver."""
    rng = np.random.default_rng(0)
    ties, images, m = 7, 3, 2
    seen, rows, aim = [], [], []
    for i in range(images):
        tie = np.sort(rng.choice(ties, 5, replace=False))
        part = TieRows(tie, rng.normal(size=(5, 2, 2 * m)), rng.normal(size=(5, 2, 3)),
                       rng.normal(size=(5, 2)), rng.uniform(0.5, 2, 5))
        seen.append(part)
        for n in range(5):
            for axis in range(2):
                row = np.zeros(images * 2 * m + 3 * ties)
                row[i * 2 * m:(i + 1) * 2 * m] = part.rows[n, axis]
                row[images * 2 * m + 3 * tie[n]:images * 2 * m + 3 * tie[n] + 3] = \
                    part.slopes[n, axis]
                rows.append(np.sqrt(part.weight[n]) * row)
                aim.append(np.sqrt(part.weight[n]) * part.residual[n, axis])
    prior = [np.eye(2 * m) * 0.3] * images
    of_ties = np.tile(np.eye(3) * 0.2, (ties, 1, 1))
    A = np.array(rows)
    ridge = np.diag([0.3] * images * 2 * m + [0.2] * 3 * ties)
    normal = A.T @ A + ridge
    expected = np.linalg.solve(normal, A.T @ np.array(aim))
    got = solve(seen, prior, [np.zeros(2 * m)] * images, of_ties, np.zeros((ties, 3)),
                image_pairs([part.tie for part in seen], ties))
    np.testing.assert_allclose(np.concatenate(got.steps), expected[:images * 2 * m], rtol=1e-9)
    np.testing.assert_allclose(got.ties.ravel(), expected[images * 2 * m:], rtol=1e-9)
    covariance = np.linalg.inv(normal)
    for i, own in enumerate(got.reduced.image_covariances()):
        at = slice(i * 2 * m, (i + 1) * 2 * m)
        np.testing.assert_allclose(own, covariance[at, at], rtol=1e-8, atol=1e-12)
    for k, block in enumerate(got.covariance_of_ties()):
        at = slice(images * 2 * m + 3 * k, images * 2 * m + 3 * k + 3)
        np.testing.assert_allclose(block, covariance[at, at], rtol=1e-8, atol=1e-12)


@pytest.mark.slow_cases("0")
@pytest.mark.parametrize("whole", [0, 10_000])
def test_a_large_block_is_solved_as_a_small_one(
        monkeypatch: pytest.MonkeyPatch, whole: int) -> None:
    block = simulate_block(6, n_ties=60, rpcs=True, control=(3,), seed=3, independent=5).block
    dense = adjust(block)
    monkeypatch.setattr("termsel_block.estimation.equations.MAX_DENSE", 0)
    monkeypatch.setattr("termsel_block.estimation.equations.MAX_INVERSE", whole)
    sparse = adjust(block)
    for i in range(6):
        np.testing.assert_allclose(sparse.adjusted.state.parameters[i],
                                   dense.adjusted.state.parameters[i], atol=1e-3)


def test_the_evidence_is_that_of_two_marginal_likelihoods() -> None:
    """One measurement y = p + e: N(y; 0, s2 + v) against N(y; 0, s2)."""
    y, s2, v = 1.3, 0.4, 2.0
    posterior = 1 / (1 / s2 + 1 / v)
    expected = 0.5 * (y**2 / s2 - y**2 / (s2 + v) + np.log(s2 / (s2 + v)))
    assert log_bayes_factor(np.array([posterior * y / s2]), np.array([[posterior]]),
                            np.array([v])) == pytest.approx(expected)


def test_independent_points_take_no_part(vendors: Simulated, adjusted: BlockResult) -> None:
    images = tuple(replace(image, features=FeatureSet(
        own(image).points.take([role != "independent" for role in own(image).points.roles]),
        crs=own(image).crs, image_size=image.size)) for image in vendors.block.images)
    # What the frame is at does not matter, and the rest must be the same.
    without = adjust(replace(vendors.block, images=images))
    for i, image in enumerate(vendors.block.images):
        ground = own(image).points.ground
        np.testing.assert_allclose(without.project(i, ground), adjusted.project(i, ground),
                                   atol=2e-3)


def test_without_any_control_the_vendors_hold_the_block() -> None:
    simulated = simulate_block(3, rpcs=True, control=(), seed=2, independent=20)
    record = record_of(adjust(simulated.block))
    assert "vendor" in record.datum
    assert all(image.predicted > 3 for image in record.images)  # biases of 20 px are not known


def test_a_point_is_enough_for_the_bias_of_a_pair() -> None:
    simulated = simulate_block(2, rpcs=True, control=(1, 1), drift=0.0, noise=0.05, seed=4,
                               independent=30)
    result = adjust(simulated.block)
    assert max(errors(result, i) for i in range(2)) < 1.0


def test_images_without_geometry_are_held_by_control_and_ties() -> None:
    simulated = simulate_block(3, n_ties=100, control=(6, 6, 0), seed=2, independent=40)
    result = adjust(simulated.block)
    assert record_of(result).images[2].model == "polynomial"
    assert errors(result, 2) < 12
    space = errors_in_space(result)
    assert space is not None
    assert space.up < 60


def test_a_wrong_control_point_is_named(vendors: Simulated) -> None:
    image = vendors.block.images[0]
    points = own(image).points
    place = points.image.copy()
    place[1] += [40.0, -30.0]
    images = (replace(image, features=replace(own(image), points=replace(
        points, image=place))), *vendors.block.images[1:])
    record = record_of(adjust(replace(vendors.block, images=images)))
    assert [one.id for one in record.wrong_control] == [points.ids[1]]
    assert points.ids[1] in text_of(record)


@pytest.mark.parametrize("images", [3, 40])
def test_the_first_screen_of_a_block_has_twelve_lines(images: int, vendors: Simulated) -> None:
    record = record_of(adjust(vendors.block))
    least_certain = max(record.images, key=lambda image: image.uncertainty)
    many = (record.images * images)[:images]
    lines = first_screen(msgspec.structs.replace(record, images=many), "adjusted").splitlines()
    assert len(lines) <= LINES == 12
    assert max(map(len, lines)) <= 88
    others = f"{images - 2} image{'s' if images != 3 else ''} more, with less uncertainty: "
    assert (f"{others}summary.txt has all." in lines) == (images > 3)
    assert lines[-1].startswith(f"Saved     adjusted/    Next: termsel plan adjusted/"
                                f"{least_certain.name} ")


def test_what_nothing_holds_is_named() -> None:
    simulated = simulate_block(3, control=(6, 0, 0), seed=0, independent=5)
    with pytest.raises(TermselError, match=r"'I2'.*'I3'"):
        adjust(simulated.block)


def test_an_rpc_of_another_place_is_named(vendors: Simulated) -> None:
    images = list(vendors.block.images)
    moved = replace(vendor(images[2]), ground_offset=(20.0, 10.0, 300.0))
    images[2] = replace(images[2], rpc=moved, features=None)
    with pytest.raises(TermselError, match="the ties of 'I3' are"):
        adjust(replace(vendors.block, images=tuple(images)))
    images[2] = replace(vendors.block.images[2], rpc=vendors.block.images[2].rpc)
    images[0] = replace(images[0], rpc=moved)
    with pytest.raises(TermselError, match="'I1' is of another area"):
        adjust(replace(vendors.block, images=tuple(images)))


@pytest.mark.slow
def test_one_wrong_tie_does_not_doubt_two_rpcs() -> None:
    block = simulate_block(21, n_ties=48, rpcs=True, control=(4, 4), seed=3, independent=2).block
    ties, wrong = block.ties, len(block.ties.names)
    found = record_of(adjust(replace(block, ties=Ties(
        (*ties.names, "wrong"), np.append(ties.tie, [wrong, wrong]),
        np.append(ties.image, [0, 20]), np.vstack([ties.position, [[6000.0, 6000.0]] * 2])))))
    assert {(tie.id, tie.image) for tie in found.wrong_ties if tie.id == "wrong"} == {
        ("wrong", "I1"), ("wrong", "I21")}


def test_independent_points_alone_hold_nothing(
        vendors: Simulated, recwarn: pytest.WarningsRecorder) -> None:
    images = tuple(replace(image, rpc=None, features=replace(own(image), points=replace(
        own(image).points, roles=("independent",) * len(own(image).points))))
        for image in vendors.block.images)
    with pytest.raises(TermselError, match="no image of the block has control or an RPC"):
        adjust(replace(vendors.block, images=images))
    assert not recwarn.list


def test_ties_that_contradict_are_refused() -> None:
    block = simulate_block(2, n_ties=40, rpcs=True, control=(4,), seed=0, independent=5).block
    place = np.random.default_rng(0).permutation(block.ties.position)
    with pytest.raises(TermselError, match="contradict one another"):
        adjust(replace(block, ties=replace(block.ties, position=place)))


def test_parts_are_what_ties_join() -> None:
    tie, image = np.array([0, 0, 1, 1, 2, 2]), np.array([0, 1, 1, 2, 3, 4])
    assert connected_images(tie, image, 6) == [[0, 1, 2], [3, 4], [5]]


@pytest.fixture(scope="module")
def example(tmp_path_factory: pytest.TempPathFactory) -> Example:
    folder = tmp_path_factory.mktemp("block") / "place"
    done = invoke("block-example", folder)
    assert done.exit_code == 0, done.output
    done = invoke("block", folder / "block.toml", "--out",
                  folder / "adjusted", "--json", "--quiet")
    assert done.exit_code == 0, done.output
    return folder, json.loads(done.stdout)


def test_every_image_becomes_a_result(example: Example) -> None:
    folder, record = example
    jsonschema.validate(record, json.loads((folder / "adjusted/block.schema.json").read_text()))
    block = read_block(folder / "block.toml")
    result = adjust(block)
    for i, image in enumerate(record["images"]):
        alone = read_result(folder / "adjusted" / image["name"])
        assert alone.model == f"rpc-{image['model']}"
        assert "block of 3 images" in alone.notes[0]
        ground = own(block.images[i]).points.ground
        assert np.abs(alone.fit.project(ground) - result.project(i, ground)).max() < 0.3
    done = invoke("export", folder / "adjusted/C", "--to", "rpb",
                  "--output", folder / "refined.RPB")
    assert done.exit_code == 0, done.output
    alone = read_result(folder / "adjusted/C")
    points = own(block.images[2]).points
    np.testing.assert_allclose(read_rpc(folder / "refined.RPB").project(points.ground),
                               alone.fit.project(points.ground), atol=0.05)


def test_the_block_is_shown(example: Example) -> None:
    folder, record = example
    text = (folder / "adjusted/summary.txt").read_text()
    for image in record["images"]:
        assert f"{image['predicted']:.2f}" in text
    page = (folder / "adjusted/report.html").read_text()
    assert page.count('data-chart="') == 3
    for wrong in record["wrong_ties"]:
        assert f'<th scope="row">{wrong["id"]}</th>' in page
        line = f"{wrong['id']} in {wrong['image']}: {wrong['error']:.1f} px"
        assert line in text
        assert (f"{line} (its images contradict one another" in text) == wrong["any_ray"]
    assert "default-src 'none'" in page
    table = (folder / "adjusted/ties.csv").read_text().splitlines()
    assert len(table) > 100


def test_heights_of_another_unit_are_said(vendors: Simulated) -> None:
    """Kilometres, where the RPC says metres."""
    images = list(vendors.block.images)
    features = own(images[0])
    ground = features.points.ground * [1.0, 1.0, 1e-3]
    images[0] = replace(images[0], features=replace(
        features, points=replace(features.points, ground=ground)))
    notes = record_of(adjust(replace(vendors.block, images=tuple(images)))).notes
    assert any(note.startswith("The control of I1 is 1") and "below the mean height" in note
               for note in notes)


@pytest.mark.slow
def test_good_control_stays_and_its_precision_is_true() -> None:
    """Weights that fall made the standard deviation 0.74 times as large in the first stage.

    Then a point that many terms follow was compared with its error when they no longer did.
    """
    left_out, ratios = 0, []
    for seed in range(2):
        block = simulate_block(3, n_ties=60, control=(20, 20, 0), noise=0.4, seed=400 + seed,
                               independent=4).block
        state = adjust(block).adjusted.state
        left_out += sum(int((~used).sum()) for used in state.control_in_use)
        ratios.append((state.sigma_control / 0.4) ** 2)
    assert left_out == 0
    assert 0.85 < np.mean(ratios) < 1.2


def test_a_map_has_one_scale() -> None:
    """A strip is not drawn as a square, nor one of a single row of ties as a line."""
    (x, width), (y, height) = page._equal_scales(np.array([[0.0, 0.0], [10.0, 100.0]]))
    assert (x[1] - x[0]) / width == pytest.approx((y[1] - y[0]) / height)
    assert height == pytest.approx(560.0)
    assert width == pytest.approx(220.0)
    assert x[0] < 0.0
    assert x[1] > 10.0


def test_a_page_says_how_much_of_a_large_block_it_shows(
        adjusted: BlockResult, monkeypatch: pytest.MonkeyPatch) -> None:
    """Some of the ties, but the outlines of all images."""
    monkeypatch.setattr(page, "_MAX_TIES", 20)
    monkeypatch.setattr(page, "_MAX_IMAGES", 1)
    shown = page.page_of(adjusted, record_of(adjusted))
    count = int((times_seen(adjusted) > 1).sum())
    assert f"height; 20 of {count} are shown. Triangles" in shown
    assert "; 1 of 3 are shown." in shown
    outlines = json.dumps(page._ground_chart(adjusted).to_dict())
    assert all(image.name in outlines for image in adjusted.block.images)


def test_a_folder_that_is_taken_is_refused(example: Example) -> None:
    folder, _ = example
    done = invoke("block", folder / "block.toml", "--out",
                  folder / "adjusted", "--quiet")
    assert done.exit_code == 2
    assert "there is a block in this folder already" in done.output


@pytest.mark.slow
def test_a_block_in_plane_coordinates() -> None:
    """Aerial views without a CRS: two affine images and their ties."""
    rng = np.random.default_rng(0)
    maps = [rng.normal(size=(3, 2)) for _ in range(3)]

    def seen(i: int, ground: FloatArray) -> FloatArray:
        model = 0.2 * maps[i] / np.linalg.norm(maps[i]) + 0.5 * np.eye(3)[:, :2]
        return np.asarray(500 + ground @ model)

    ground = rng.uniform(-800, 800, (60, 3)) * [1, 1, 0.1]
    ties = Ties(tuple(f"T{k}" for k in range(60)), np.tile(np.arange(60), 3),
                np.repeat(np.arange(3), 60), np.concatenate([seen(i, ground) for i in range(3)]))
    known = rng.uniform(-800, 800, (8, 3)) * [1, 1, 0.1]
    images = tuple(BlockImage(f"I{i}", FeatureSet(Points(
        tuple(f"P{k}" for k in range(8)), seen(i, known), known), crs="local") if i < 2 else None)
        for i in range(3))
    result = adjust(Block("local", images, ties))
    assert rms_length(seen(2, known) - result.project(2, known)) < 0.05


def test_places_of_a_block_in_plane_coordinates_are_written_without_a_warning(
        tmp_path: Path) -> None:
    pytest.importorskip("pyogrio")
    (tmp_path / "block.json").write_text('{"crs": "local"}')
    (tmp_path / "ties.csv").write_text("id,x,y,z,sigma_east,sigma_north,sigma_up,images\n"
                                       "T1,1,2,3,0.1,0.1,0.2,2\n")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        done = invoke("block-points", tmp_path, "-o", tmp_path / "places.gpkg")
    assert done.exit_code == 0, done.output


def test_what_is_read_is_not_replaced(example: Example) -> None:
    folder, _ = example
    before = (folder / "ties.csv").read_bytes()
    done = invoke("block", folder / "block.toml", "--out", folder,
                  "--overwrite", "--quiet")
    assert done.exit_code == 2
    assert "reads this file" in done.output
    assert (folder / "ties.csv").read_bytes() == before
