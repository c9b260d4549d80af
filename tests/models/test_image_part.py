"""An RPC of the uncut or of the full image: recognised by control, or stated."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import termsel
from termsel.core.errors import TermselError
from termsel.data.features import FeatureSet, FloatArray
from termsel.formats.readers.csv_tables import write_points_csv
from termsel.models.image_part import ImagePart, recognise_part
from tests.formats.test_vertical_datum import camera, control, needs_rpc

PARTS = {
    "cut": ImagePart((700.0, 900.0)),
    "padded": ImagePart((-1500.0, 0.0)),
    "halved": ImagePart(scale=2.0),
    "thirds of a cut": ImagePart((120.0, 2000.0), 3.0),
    "doubled": ImagePart(scale=0.5)}


def seen(part: ImagePart, features: FeatureSet) -> FeatureSet:
    """The same features, measured in a part of the image."""
    image = part.places(features.points.image)
    return replace(features, points=replace(features.points, image=image))


@pytest.mark.parametrize("name", PARTS)
def test_the_rpc_of_a_part_sees_what_is_in_the_part(name: str) -> None:
    features = control(20, sigma=0.0)
    expected = PARTS[name].places(camera().project(features.points.ground))
    found = PARTS[name].rpc(camera()).project(features.points.ground)
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_a_pixel_of_a_part_is_where_its_own_pixels_are() -> None:
    """The first pixel of a halved image covers lines 0 and 1, so its middle is at line 0.5."""
    halved = ImagePart(scale=2.0).places(np.array([[0.5, 2.5]]))
    np.testing.assert_allclose(halved, [[0.0, 1.0]])
    cut = ImagePart((700.0, 900.0)).places(np.array([[700.0, 905.0]]))
    np.testing.assert_allclose(cut, [[0.0, 5.0]])


@needs_rpc
@pytest.mark.parametrize("count", [3, 5])
@pytest.mark.parametrize("name", PARTS)
def test_a_run_recognises_a_part_and_says_so(name: str, count: int, tmp_path: Path) -> None:
    part = PARTS[name]
    result = termsel.run(features=seen(part, control(count)))
    said = " ".join(result.summary().split())
    assert "The control shows that the RPC is that of an image that" in said
    assert ("rpc_scale" in said) == (part.scale != 1.0)
    termsel.export(result, "rpb", tmp_path / "part.RPB")
    exact = seen(part, control(200, sigma=0.0)).points
    errors = termsel.read_rpc(tmp_path / "part.RPB").project(exact.ground) - exact.image
    assert np.sqrt((errors**2).sum(axis=1).mean()) < 0.5


@needs_rpc
def test_a_blunder_among_the_points_hides_no_part() -> None:
    features = seen(PARTS["cut"], control(8))
    image = features.points.image.copy()
    image[3] += [400.0, -250.0]
    result = termsel.run(features=replace(features, points=replace(features.points, image=image)))
    assert result.summary().count("--set rpc_offset=") == 1
    assert [one.id for one in result.outliers] == ["P3"]


@needs_rpc
def test_the_interval_knows_that_the_place_of_a_part_was_estimated() -> None:
    """The rest of a rounded offset is left to the correction, as if it had been stated."""
    told = termsel.run(features=seen(PARTS["cut"], control(5)))
    stated = termsel.run(features=control(5))
    assert told.predicted is not None
    assert stated.predicted is not None
    assert told.predicted.rmse == pytest.approx(stated.predicted.rmse, rel=0.15)


@pytest.mark.parametrize("move", [[0.0, 0.0], [17.0, -9.0], [60.0, 60.0]])
def test_a_shift_of_vendors_size_is_no_part(move: list[float]) -> None:
    whole = camera().project(control(12).points.ground)
    assert recognise_part(whole, whole + move) is None


def test_another_image_is_no_part() -> None:
    rng = np.random.default_rng(3)
    whole = camera().project(control(12).points.ground)
    others: dict[str, FloatArray] = {
        "exchanged": whole[:, ::-1], "of another place": rng.uniform(0, 2000, (12, 2)),
        "turned": 2000 - whole, "all at one place": np.zeros((12, 2))}
    for name, measured in others.items():
        assert recognise_part(whole, measured) is None, name
    assert recognise_part(whole[:2], whole[:2] - 700) is None


@needs_rpc
def test_what_is_stated_is_used(tmp_path: Path) -> None:
    features = seen(PARTS["thirds of a cut"], control(4))
    write_points_csv(features.points, tmp_path / "points.csv", "EPSG:4979")
    vendor = tmp_path / "vendor.RPB"
    termsel.write_rpc(camera(), vendor)
    read = termsel.read(tmp_path / "points.csv", rpc=vendor, rpc_offset="120,2000", rpc_scale=3)
    assert read.rpc == PARTS["thirds of a cut"].rpc(camera())
    result = termsel.run(features=read)
    assert "The control shows that the RPC" not in result.summary()
    for options, words in [({"rpc_offset": "120"}, "line and sample"),
                           ({"rpc_offset": "1,e"}, "line and sample"),
                           ({"rpc_scale": "0"}, "0.001 to 1000"),
                           ({"rpc_scale": "much"}, "0.001 to 1000")]:
        with pytest.raises(TermselError, match=words):
            termsel.read(tmp_path / "points.csv", rpc=vendor, **options)
    with pytest.raises(TermselError, match="none is given"):
        termsel.read(tmp_path / "points.csv", rpc_scale=2)


@needs_rpc
def test_heights_in_feet_are_no_part_of_an_image() -> None:
    """Longitude and latitude state no feet: the RPC tells them by the range of its heights."""
    features = control(5)
    ground = features.points.ground.copy()
    ground[:, 2] = (ground[:, 2] + 3 * camera().ground_scale[2]) / 0.3048
    raised = replace(camera(), ground_offset=(
        *camera().ground_offset[:2], camera().ground_offset[2] + 3 * camera().ground_scale[2]))
    typed = replace(features, rpc=raised, points=replace(features.points, ground=ground))
    with pytest.raises(TermselError, match="As feet they are inside") as no:
        termsel.run(features=typed)
    assert "z_unit='ft'" in str(no.value.hint)
    ground[:, 2] *= 0.3048
    termsel.run(features=replace(typed, points=replace(features.points, ground=ground)))
