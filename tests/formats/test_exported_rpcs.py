"""An RPC that termsel fitted to control is recognised, and never tested by that control."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import termsel
from termsel.core.errors import TermselError
from termsel.data.features import FeatureSet, Lines, Points
from termsel.data.fingerprints import KEPT, makers_of, with_control_record
from termsel.data.roles import Observations
from termsel.formats.rpc_control import read_errors
from termsel.formats.rpc_files import (
    from_items,
    read_delivered_rpc,
    read_rpc,
    rpb_text,
    rpc_txt_text,
    with_rpc,
)
from termsel.runs.exported_rpc import _is_taken_away, doubt_of_fitted_rpc, refuse_makers
from termsel.simulate.example import SENSOR, SIZE, ground_of_corners, vendor_rpc
from termsel.toolkit.files import rpc_items

pytest.importorskip("rasterio")

pytestmark = pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")

NOISE = 0.3


def points(count: int, seed: int = 0) -> FeatureSet:
    """Return points of the example's scene, measured with noise."""
    rng = np.random.default_rng(seed)
    ground = np.asarray(
        ground_of_corners())[rng.choice(len(ground_of_corners()), count, replace=False)]
    image = SENSOR.project(ground) + rng.normal(0.0, NOISE, (count, 2))
    ids = tuple(f"P{i}" for i in range(count))
    return FeatureSet(Points(ids, image, ground), crs="EPSG:4979", image_size=SIZE)


def fitted_rpc(features: FeatureSet) -> termsel.Rpc:
    return termsel.rpc_of(termsel.fit(features, "poly3d", degree=1)).rpc


@pytest.fixture
def image(tmp_path: Path) -> Path:
    """An image of the example's size, without an RPC."""
    import rasterio

    path = tmp_path / "scene.tif"
    with rasterio.open(path, "w", driver="GTiff", width=SIZE[1], height=SIZE[0], count=1,
                       dtype="uint8"):
        pass
    return path


def test_an_rpc_carries_the_points_it_was_fitted_to() -> None:
    features = points(9)
    rpc = fitted_rpc(features)
    assert rpc.control_count == 9
    assert makers_of(rpc, features) == list(features.ids)
    assert makers_of(vendor_rpc(), features) == []


def test_points_measured_anew_or_converted_are_recognised() -> None:
    features = points(9)
    rpc = fitted_rpc(features)
    moved = replace(features.points, image=features.points.image + 0.4)
    converted = replace(features.points, ground=features.points.ground * 1e5)
    assert len(makers_of(rpc, features.with_(points=moved))) == 9
    assert len(makers_of(rpc, features.with_(points=converted))) == 9
    both = replace(moved, ground=converted.ground)
    assert makers_of(rpc, features.with_(points=both)) == []


def test_of_very_many_points_some_are_recognised() -> None:
    many = scattered(2000)
    rpc = with_control_record(vendor_rpc(), many)
    assert len(rpc.control_digests) == KEPT
    assert len(makers_of(rpc, many)) > KEPT / 3


def test_control_of_a_large_set_is_refused_without_what_is_recognised(
        caplog: pytest.LogCaptureFixture) -> None:
    many = scattered(1000)
    rpc = replace(with_control_record(vendor_rpc(), many), source="scene.RPB")
    with pytest.raises(TermselError, match=r"termsel to at least 2\d\d of these") as error:
        refuse_makers(rpc, all_control(many))
    assert "role off" not in str(error.value.hint)
    rest = many.take(~np.isin(many.ids, error.value.ids))
    assert makers_of(rpc, rest) == []
    with pytest.raises(TermselError, match="seem to be the rest of them"):
        refuse_makers(rpc, all_control(rest))
    refuse_makers(rpc, all_control(scattered(500, 2)))
    with_rpc(scattered(500, 2), rpc)
    assert not caplog.messages


def test_any_piece_of_a_line_is_recognised() -> None:
    rng = np.random.default_rng(3)
    features = points(12)
    lines = Lines(("L1", "L1", "L1", "L2"), rng.uniform(0, 900, (4, 2, 2)),
                  rng.uniform(0, 1, (4, 2, 3)))
    with_lines = features.with_(lines=lines)
    assert makers_of(fitted_rpc(features), with_lines) == list(features.ids)
    moved = replace(lines, image=lines.image + 9.0, ground=lines.ground + np.array(
        [1.0, 1.0, 0.0, 1.0])[:, None, None])
    rpc = with_control_record(vendor_rpc(), with_lines)
    assert makers_of(rpc, features.with_(lines=moved)) == [*features.ids, "L1"]


def scattered(count: int, seed: int = 1) -> FeatureSet:
    rng = np.random.default_rng(seed)
    ids = tuple(map(str, range(count)))
    return FeatureSet(Points(ids, rng.uniform(0, 5000, (count, 2)),
                             rng.uniform(0, 1e6, (count, 3))), crs="EPSG:32639")


@pytest.mark.parametrize("ending", [".RPB", "_RPC.TXT"])
def test_files_carry_the_mark(image: Path, ending: str) -> None:
    rpc = with_control_record(fitted_rpc(points(9)), points(150, 3))
    beside = image.with_name(f"scene{ending}")
    text = rpb_text(rpc) if ending == ".RPB" else rpc_txt_text(rpc)
    beside.write_text(text)
    for path in (beside, image):
        again = read_rpc(path)
        assert again == rpc
        assert again.control_digests == rpc.control_digests
        assert again.control_count == rpc.control_count == 159
    # GDAL stops at longer lines, and at the 200th, of a _RPC.TXT.
    if ending == "_RPC.TXT":
        lines = text.splitlines()
        assert max(map(len, lines)) < 100
        assert len(lines) < 200


def test_vendors_files_have_no_mark() -> None:
    assert "TERMSEL" not in rpb_text(vendor_rpc())
    assert "TERMSEL" not in rpc_txt_text(vendor_rpc())
    assert "TERMSEL" not in rpb_text(fitted_rpc(points(9)).as_delivered())


def test_an_exported_rpc_is_not_taken_for_the_vendors(
        image: Path, caplog: pytest.LogCaptureFixture) -> None:
    features = points(12)
    beside = image.with_name("scene.RPB")
    beside.write_text(rpb_text(fitted_rpc(features)))
    rows = [{"id": name, "line": line, "sample": sample, "x": x, "y": y, "z": z}
            for name, (line, sample), (x, y, z) in zip(
                features.ids, features.points.image.tolist(), features.points.ground.tolist(),
                strict=True)]
    assert termsel.read(rows, crs="EPSG:4979", image=image).rpc is None
    assert len(caplog.messages) == 1
    assert "scene.RPB was fitted by termsel to 12 control features" in caplog.text
    assert f"--rpc {beside}" in caplog.text
    assert termsel.read(rows, crs="EPSG:4979", image=image, rpc=beside).rpc is not None


def test_the_vendors_rpc_is_found_behind_an_exported_one(
        image: Path, caplog: pytest.LogCaptureFixture) -> None:
    vendor = vendor_rpc()
    image.with_name("scene.RPB").write_text(rpb_text(fitted_rpc(points(12))))
    image.with_name("scene_RPC.TXT").write_text(rpc_txt_text(vendor))
    assert read_delivered_rpc(image) == vendor
    assert "That of scene_RPC.TXT is used." in caplog.text


def test_the_vendors_rpc_within_the_image_is_found(tmp_path: Path) -> None:
    import rasterio
    from rasterio.rpc import RPC

    path = tmp_path / "tagged.tif"
    with rasterio.open(path, "w", driver="GTiff", width=5, height=6, count=1, dtype="uint8",
                       rpcs=RPC.from_gdal(rpc_items(vendor_rpc()))):
        pass
    path.with_name("tagged.RPB").write_text(rpb_text(fitted_rpc(points(12))))
    delivered = read_delivered_rpc(path)
    assert delivered is not None
    assert not delivered.control_count
    assert np.abs(delivered.project(ground_of_corners())
                  - vendor_rpc().project(ground_of_corners())).max() < 1e-6


def test_a_vrt_and_its_copy_carry_the_mark(image: Path) -> None:
    from rasterio.shutil import copy

    result = termsel.run(features=points(12), method="dlt")
    vrt = image.with_name("scene_rpc.vrt")
    termsel.export(result, "rpc-vrt", vrt, image=image)
    tiff = image.with_name("copy.tif")
    copy(vrt, tiff, driver="GTiff")
    for path in (vrt, tiff):
        assert read_rpc(path).control_count == 12
        assert read_delivered_rpc(path) is None


@pytest.mark.parametrize("ending", [".RPB", "_RPC.TXT"])
def test_gdals_copies_say_that_termsel_fitted_the_rpc(
        image: Path, ending: str, caplog: pytest.LogCaptureFixture) -> None:
    from rasterio.shutil import copy

    rpc = replace(fitted_rpc(points(12)), error_random=0.25)
    text = rpb_text(rpc) if ending == ".RPB" else rpc_txt_text(rpc)
    image.with_name(f"scene{ending}").write_text(text)
    # A file beside an image, then tags, then a file again, and tags of that.
    tags = image.with_name("tags.tif")
    again = image.with_name("again.tif")
    vrt = image.with_name("again.vrt")
    copy(image, tags, driver="GTiff")
    copy(tags, again, driver="GTiff", RPB=True, RPCTXT=True, PROFILE="BASELINE")
    copy(tags, vrt, driver="VRT")
    for path in (tags, again, vrt, image.with_name("again.RPB"),
                 image.with_name("again_RPC.TXT")):
        read = read_rpc(path)
        assert read.control_count == 12
        assert not read.control_digests
        assert (read.error_bias, read.error_random) == (None, 0.25)
        assert read_delivered_rpc(path) is None if path.suffix in (".tif", ".vrt") else True
    assert f"--rpc {tags}" in caplog.text


@pytest.mark.parametrize(("bias", "random"), [
    (None, None), (0.0, 3.0), (3.94, 0.12), (1 / 3, 2e-7), (1234567.0, 1e12)])
def test_errors_that_an_rpc_states_are_kept_beside_the_mark(
        bias: float | None, random: float | None) -> None:
    stated = replace(vendor_rpc(), error_bias=bias, error_random=random)
    for control in (points(7), scattered(1000)):
        rpc = with_control_record(stated, control)
        again = from_items(rpc_items(rpc))
        assert again == rpc
        assert again.control_count == len(control)
        for error, original in ((again.error_bias, bias), (again.error_random, random)):
            assert error == (pytest.approx(original, rel=1e-5) if original else None)
    many = replace(rpc, control_count=100_001)
    assert from_items(rpc_items(many)).control_count == 99_999


def test_errors_of_vendors_have_no_mark() -> None:
    rng = np.random.default_rng(0)
    for bias, random in rng.uniform(0, 30, (3000, 2)).tolist():
        assert read_errors(bias, random) == (bias, random, 0)
    for errors in ((None, None), (0.0, 0.0), (3.94, 0.12), (-1.0, -1.0), (None, 0.3)):
        assert read_errors(*errors) == (*errors, 0)


@pytest.mark.slow_cases("None")
@pytest.mark.parametrize("problem", [None, "rpc-gcps"])
def test_what_its_own_points_say_of_an_rpc_without_its_record_is_cautioned(
        problem: str | None) -> None:
    pytest.importorskip("termsel_rpc")
    features = points(16)
    own = fitted_rpc(features.take(np.arange(16) < 12))
    copied = from_items(rpc_items(own))
    budget = {} if problem is None else {"evaluations": 200}
    result = termsel.run(problem, features=replace(features, rpc=copied), **budget)
    assert "fitted by termsel to 12 control points that its file no longer" in result.notes[0]
    screen = " ".join(result.summary().split())
    assert "Caution The RPC was fitted by termsel to 12 control points" in screen
    assert "if these points are among them, the accuracy stated is too good" in screen


@pytest.mark.parametrize("problem", [None, "rpc-gcps"])
def test_the_points_of_an_rpc_are_refused(problem: str | None) -> None:
    pytest.importorskip("termsel_rpc")
    features = points(12)
    rpc = fitted_rpc(features.take(np.arange(12) < 7))
    with pytest.raises(TermselError, match="fitted by termsel to 7 of these 12 points") as error:
        termsel.run(problem, features=replace(features, rpc=rpc))
    assert set(error.value.ids) == {f"P{i}" for i in range(7)}
    others = features.take(np.arange(12) >= 7)
    if problem is None:
        result = termsel.run(features=replace(others, rpc=rpc))
        assert result.strategy is not None
        assert result.strategy.chosen == "rpc"


def test_a_correction_of_a_marked_rpc_names_all_control() -> None:
    pytest.importorskip("termsel_rpc")
    first = points(12)
    rest = points(50, 9).take(np.arange(50) >= 42)
    rest = rest.take(~np.isin(np.round(rest.points.ground[:, 0], 6),
                              np.round(first.points.ground[:, 0], 6)))
    result = termsel.run(features=replace(rest, rpc=fitted_rpc(first)))
    assert result.to_rpc().control_count == 12 + len(rest)
    assert makers_of(result.to_rpc(), first) == list(first.ids)


def test_a_result_keeps_what_its_rpc_was_fitted_to() -> None:
    rpc = fitted_rpc(points(9))
    assert type(rpc).from_numbers(rpc.numbers()).control_digests == rpc.control_digests


@pytest.mark.parametrize(("model", "options"), [("affine", {}), ("poly3d", {"degree": 2}),
                                                ("rfm", {"order": 1})])
def test_an_rpc_of_another_program_is_doubted_by_its_errors(
        model: str, options: dict[str, Any]) -> None:
    features = points(24)
    rpc = termsel.rpc_of(termsel.fit(features, model, **options)).rpc.as_delivered()
    assert "as if it had been fitted to them" in doubt(features, rpc)


def test_the_rpc_of_a_vendor_is_not_doubted() -> None:
    vendor = vendor_rpc()
    exact = replace(vendor, image_offset=(vendor.image_offset[0] - 14, vendor.image_offset[1] + 9))
    for seed in range(20):
        assert not doubt(points(14, seed), vendor)
        assert not doubt(points(14, seed), exact)


def doubt(features: FeatureSet, rpc: termsel.Rpc) -> str:
    """Return what is said of an RPC, by points that are all control."""
    return doubt_of_fitted_rpc(all_control(replace(features, rpc=rpc)))


def all_control(features: FeatureSet) -> Observations:
    empty = features.points.take(np.zeros(len(features), dtype=bool))
    return Observations(features, features, empty, empty)


def test_errors_that_a_correction_takes_away_wholly_are_no_doubt() -> None:
    shift = np.ones((8, 1))
    with np.errstate(all="raise"):
        assert not _is_taken_away(shift, np.full((8, 2), 2.0))
        assert not _is_taken_away(shift, np.zeros((8, 2)))


def test_an_rpc_is_only_said_to_be_used_where_it_is_not_refused(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    features = points(12)
    path = tmp_path / "scene.RPB"
    path.write_text(rpb_text(fitted_rpc(features.take(np.arange(12) < 4))))
    again = with_rpc(features, path)
    with pytest.raises(TermselError, match="to 4 of these 12 points"):
        refuse_makers(again.rpc, all_control(again))
    assert not caplog.messages
    rest = again.take(np.arange(12) >= 4)
    refuse_makers(again.rpc, replace(all_control(rest), features=again))
    assert "scene.RPB was fitted by termsel to 4 control features, and is used" in caplog.text
    caplog.clear()
    with_rpc(rest, path)
    assert "is used as a vendor's" in caplog.text


def test_the_record_of_a_result_is_no_rpc(tmp_path: Path) -> None:
    record = tmp_path / "result.json"
    record.write_text('{"schema": "termsel-result-1", "problem": "rfm-terms"}')
    with pytest.raises(TermselError, match="whose run was given no RPC") as error:
        read_rpc(record)
    assert "--to rpb" in str(error.value)
