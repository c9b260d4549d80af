"""What heights of ties are known by: control, a DEM, and how rough the ground is."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("termsel_block", reason="termsel-block is not installed: "
                    "pip install -e plugins/termsel-block")

from termsel import TermselError
from termsel.testing import invoke
from termsel.toolkit.coordinates import normalise, to_wgs84, transformation_between
from termsel_block.accuracy import independent_points, predicted_errors, rms_length
from termsel_block.block import Block
from termsel_block.example import write_example
from termsel_block.files.block_file import read_block
from termsel_block.geometry.frame import FloatArray, Frame
from termsel_block.geometry.heights import ControlHeights, Heights
from termsel_block.joint import BlockResult, adjust, heights_of
from termsel_block.shown.record import record_of
from termsel_block.shown.summary import read_in
from termsel_block.simulated import LAT, LON, Hills, Simulated, ground_heights, simulate_block


def error(result: BlockResult, i: int) -> float:
    """Return the RMSE of the independent points of an image [px]."""
    points = independent_points(result, i)
    assert points is not None
    return rms_length(points.image - result.project(i, points.ground))


def dem(path: Path, hills: Hills, off: float, unit: float = 1.0) -> Path:
    """Write the heights of the simulated ground, off by so many metres, in a unit [m]."""
    rasterio = pytest.importorskip("rasterio")
    n, half = 400, 0.3
    step = 2 * half / n
    lon, lat = LON - half + step * (np.arange(n) + 0.5), LAT + half - step * (np.arange(n) + 0.5)
    places = np.stack(np.meshgrid(lon, lat), axis=-1).reshape(-1, 2)
    with rasterio.open(
            path, "w", driver="GTiff", width=n, height=n, count=1, dtype="float32",
            crs="EPSG:4979",
            transform=rasterio.transform.from_origin(LON - half, LAT + half, step, step)) as raster:
        heights = (ground_heights(places, hills) + off) / unit
        raster.write(heights.reshape(n, n).astype(np.float32), 1)
    return path


def pair(**keywords: Any) -> Simulated:
    """Return a pair whose second image has no control, and an RPC tens of pixels off."""
    return simulate_block(2, rpcs=True, control=(12, 0), bias=30.0, seed=5, independent=40,
                          **keywords)


def misstated(block: Block, off: float, role: str = "control") -> Block:
    """Return a block with another height, or another role, of the first image's first control."""
    image = block.images[0]
    assert image.features is not None
    points = image.features.points
    assert points.roles[0] == "control"
    ground = points.ground.copy()
    ground[0, 2] += off
    changed = replace(points, ground=ground, roles=(role, *points.roles[1:]))
    return replace(block, images=(
        replace(image, features=replace(image.features, points=changed)), *block.images[1:]))


def test_control_of_the_other_image_tells_how_high_a_plain_is() -> None:
    flat = adjust(pair(hills=Hills(0.02), vendor_height=80.0).block)
    assert flat.adjusted.offset == pytest.approx(-80, abs=4)
    assert flat.adjusted.roughness < 10
    hilly = adjust(pair(vendor_height=80.0).block)
    assert hilly.adjusted.roughness == pytest.approx(130, rel=0.4)
    # Rays tell nothing of the height, so that the ground does, the better the plainer it is.
    assert predicted_errors(flat, 1).rmse < 0.3 * predicted_errors(hilly, 1).rmse
    assert error(flat, 1) < 1.5


@pytest.mark.slow
def test_a_dem_holds_a_pair_even_if_it_refers_to_another_surface(tmp_path: Path) -> None:
    simulated = pair()
    without = adjust(simulated.block)
    result = adjust(replace(simulated.block, dem=dem(tmp_path / "dem.tif", Hills(), -28.0)))
    assert result.adjusted.offset == pytest.approx(28, abs=3)
    assert error(result, 1) < 1.2
    assert predicted_errors(result, 1).rmse < 0.5 * predicted_errors(without, 1).rmse
    assert any(note.startswith("The DEM is 2") and "m below the ground" in note
               for note in record_of(result).notes)


@pytest.mark.slow_cases("0.02--1700.0")
@pytest.mark.parametrize(("relief", "off"), [(0.02, -1700.0), (1.0, -300.0)])
def test_a_wrong_height_of_control_does_not_move_the_block(relief: float, off: float) -> None:
    # The second is no more than hills may be: its row tells, which does not fit.
    block = pair(hills=Hills(relief)).block
    wrong = adjust(misstated(block, off))
    assert [control.id for control in record_of(wrong).wrong_control] == ["G0"]
    without = adjust(misstated(block, 0.0, "off"))
    assert wrong.adjusted.offset == pytest.approx(without.adjusted.offset, abs=0.5)
    assert error(wrong, 1) == pytest.approx(error(without, 1), abs=0.05)


def test_a_wrong_height_of_control_does_not_doubt_a_dem(tmp_path: Path) -> None:
    block = replace(pair().block, dem=dem(tmp_path / "dem.tif", Hills(), 0.0))
    wrong = adjust(misstated(block, -1700.0))
    assert [control.id for control in record_of(wrong).wrong_control] == ["G0"]
    assert not record_of(wrong).notes
    assert wrong.adjusted.offset == pytest.approx(0, abs=1)
    assert error(wrong, 1) < 0.9


FEET = normalise("+proj=utm +zone=39 +datum=WGS84 +units=us-ft +vunits=us-ft +type=crs")


def moved_to(block: Block, crs: str) -> Block:
    """Return the block in another CRS."""
    to_crs = transformation_between(block.crs, crs)
    images = []
    for image in block.images:
        assert image.features is not None
        points = image.features.points
        images.append(replace(image, features=replace(
            image.features, crs=crs, points=replace(points, ground=to_crs(points.ground)))))
    return replace(block, crs=crs, images=tuple(images))


@pytest.mark.slow_cases("control-dem", "control-level", "without control-dem")
@pytest.mark.parametrize("with_dem", [False, True], ids=["level", "dem"])
@pytest.mark.parametrize("control", [(6, 6), ()], ids=["control", "without control"])
def test_a_block_is_the_same_in_feet(
        control: tuple[int, ...], with_dem: bool, tmp_path: Path) -> None:
    block = simulate_block(3, n_ties=60, rpcs=True, control=control, wrong=0.1, seed=2,
                           vendor_height=50.0, independent=10).block
    if with_dem:
        block = replace(block, dem=dem(tmp_path / "dem.tif", Hills(), 28.0))
    in_metres = record_of(adjust(block))
    in_feet = record_of(adjust(moved_to(block, FEET)))
    assert in_feet.notes == in_metres.notes
    assert [(tie.id, tie.image) for tie in in_feet.wrong_ties] == [
        (tie.id, tie.image) for tie in in_metres.wrong_ties]
    np.testing.assert_allclose([tie.error for tie in in_feet.wrong_ties],
                               [tie.error for tie in in_metres.wrong_ties], atol=0.05)
    np.testing.assert_allclose([image.predicted for image in in_feet.images],
                               [image.predicted for image in in_metres.images], rtol=0.02)
    assert read_in(in_feet).endswith(
        "observations), custom Transverse Mercator; z in US survey feet")


def test_a_height_counts_while_most_of_its_rows_are_in_use() -> None:
    frame = Frame("local", np.zeros(3), np.eye(3))
    rows = tuple(np.array(of, np.intp) for of in ([0, 0, 1, 1], [0, 0, -1, -1], [0, 0]))
    heights = Heights(frame, 0.0, 100.0, control_heights=ControlHeights(np.array([3.0, 5.0]), rows))
    heights.keep([np.array([True, True, False, False]), np.zeros(4, bool), np.ones(2, bool)])
    assert heights.control.tolist() == [3.0]
    heights.keep([np.array([False, False, True, True]), np.zeros(4, bool), np.ones(2, bool)])
    assert heights.control.tolist() == [5.0]


def example_without_heights(folder: Path, off: float, ids: Collection[str]) -> Path:
    """Write the example with a DEM that is `off` [m], from which these points have their heights.
    """
    write_example(folder)
    dem(folder / "dem.tif", Hills(), off)
    for name in "AB":
        file = folder / f"{name}_points.csv"
        rows = [line.split(",") for line in file.read_text().splitlines()]
        assert rows[1][-1] == "z"
        file.write_text("".join(",".join(
            [*row[:-1], ""] if row[0] in ids else row) + "\n" for row in rows))
    stated = folder / "block.toml"
    stated.write_text('dem = "dem.tif"\n' + stated.read_text())
    return stated


@pytest.mark.slow_cases("0.0")
@pytest.mark.parametrize("off", [0.0, 30.0])
def test_independent_heights_contradict_a_dem_that_control_follows(
        off: float, tmp_path: Path) -> None:
    stated = example_without_heights(tmp_path / "block", off, [f"G{i}" for i in range(6)])
    done = invoke("block", stated, "--out", tmp_path / "adjusted", "--quiet")
    assert done.exit_code == 0
    screen = " ".join(done.stdout.split())
    assert ("The DEM is 30 m above the independent check points (median of 30 heights, standard "
            "deviation " in screen) == (off != 0.0)
    assert ("Independent check points contradict what is predicted (A " in screen) == (off != 0.0)


@pytest.mark.slow
def test_a_dem_in_feet_is_left_out_where_ties_contradict_it(tmp_path: Path) -> None:
    """Ties are tens of pixels off under it, and may not be blamed for that."""
    block = simulate_block(3, rpcs=True, control=(), n_ties=60, seed=1, independent=5).block
    result = adjust(replace(block, dem=dem(tmp_path / "dem.tif", Hills(), 0.0, unit=0.3048)))
    assert result.block.dem is None
    assert "and the block is adjusted without it: are the heights of the DEM in feet?" in (
        result.block.notes[0])
    without = adjust(block)
    for i in range(3):
        assert error(result, i) == pytest.approx(error(without, i), abs=0.01)


def test_points_that_judge_a_selection_are_said_to_be_control() -> None:
    block = simulate_block(3, rpcs=True, control=(6, 6), n_ties=60, seed=1, independent=10,
                           check=5).block
    (note,) = record_of(adjust(block)).notes
    assert note.startswith("15 observations with the role check are adjusted as control")


def test_heights_that_are_the_dems_do_not_confirm_it(tmp_path: Path) -> None:
    block = read_block(example_without_heights(tmp_path / "block", -28.0, ("G0", "G1", "G2")))
    assert [sorted(image.of_dem) for image in block.images] == [["G0", "G1", "G2"]] * 2 + [[]]
    known = heights_of(block, Frame.at(np.array([[LON, LAT, 1700.0]]), block.crs),
                       lambda xy: ground_heights(xy) - 28.0)
    np.testing.assert_allclose(known.control, [28.0] * 3, atol=0.01)


def test_heights_are_linearised_as_they_are() -> None:
    def slope(xy: FloatArray) -> FloatArray:
        return np.asarray(0.1 * xy[:, 0] - 0.02 * xy[:, 1])

    frame = Frame("local", np.zeros(3), np.eye(3))
    heights = Heights(frame, 0.0, 100.0, slope, offset=3.0)
    ties = np.array([[10.0, 20.0, 5.0], [-300.0, 40.0, 7.0]])
    seen = heights.tie_observations(ties)
    for axis in range(3):
        there = ties.copy()
        there[:, axis] += 0.5
        moved = heights.tie_observations(there).away - seen.away
        np.testing.assert_allclose(-moved / 0.5, seen.row[:, axis], atol=1e-9)
    # Two ties without any error, and the usual one of a DEM counts as two.
    heights.offset = 0.0
    ties[:, 2] = slope(ties[:, :2])
    heights.estimate(ties, np.tile(np.eye(3) * 1e-6, (2, 1, 1)), np.ones(2, bool))
    assert heights.sigma == pytest.approx(5 / np.sqrt(2), rel=1e-3)


def test_what_the_prior_alone_holds_is_as_uncertain_as_the_prior() -> None:
    block = simulate_block(3, n_ties=60, rpcs=True, control=(4, 4), seed=1, independent=10).block
    ties, keep = block.ties, block.ties.image != 2
    keep &= (np.bincount(ties.tie[keep], minlength=len(ties.names)) > 1)[ties.tie]
    spread = predicted_errors(adjust(replace(block, ties=replace(
        ties, tie=ties.tie[keep], image=ties.image[keep], position=ties.position[keep]))), 2)
    # Of a shift in line and in sample, were its variance known: 0.23 and 1.73.
    assert spread.low < 0.21 * spread.rmse
    assert spread.high > 1.85 * spread.rmse


def test_the_rpc_of_another_image_of_the_place_is_doubted() -> None:
    block = simulate_block(3, rpcs=True, control=(6, 6, 0), seed=1, independent=5).block
    assert not record_of(adjust(block)).notes
    images = (*block.images[:2], replace(block.images[2], rpc=block.images[0].rpc))
    notes = record_of(adjust(replace(block, images=images))).notes
    assert any("I3" in note and "another image" in note for note in notes)


@pytest.mark.slow_cases("300.0")
@pytest.mark.parametrize("off", [300.0, -1500.0])
def test_a_dem_hundreds_of_metres_off_moves_nothing(off: float, tmp_path: Path) -> None:
    simulated = pair()
    with_truth, with_other = (adjust(replace(
        simulated.block, dem=dem(tmp_path / f"{by}.tif", Hills(), by))) for by in (0.0, off))
    assert error(with_other, 1) < 1.1 * error(with_truth, 1)  # 3 and 21 px instead of 1
    (note,) = record_of(with_other).notes
    assert f"{abs(off):,.0f} m {'above' if off > 0 else 'below'} the ground" in note


@pytest.mark.slow_cases("1500.0-True")
@pytest.mark.parametrize(("off", "said"), [(0.0, False), (300.0, True), (1500.0, True)])
def test_without_control_a_block_says_that_the_dem_is_another(
        off: float, said: bool, tmp_path: Path) -> None:
    """The RPCs follow it, so that nothing else would show it: images would be 50 and 200 px off."""
    block = simulate_block(3, rpcs=True, control=(), n_ties=60, seed=1, independent=5).block
    result = adjust(replace(block, dem=dem(tmp_path / "dem.tif", Hills(), off)))
    note = result.block.notes[0]
    assert ("m below it by the RPCs" if said
            else "For each 100 m that it is off, images are up to 17 px off") in note
    of_independent = [f"The DEM is {off:,.0f} m above the independent" in note
                      for note in result.block.notes[1:]]
    assert of_independent == [True] * said
    for i in range(3):
        assert error(result, i) < predicted_errors(result, i).high


PLANE_IN_FEET = "+proj=utm +zone=39 +datum=WGS84 +units=us-ft +type=crs"


def in_plane_feet(folder: Path, metres_per_z: float, name_of_z: str = "z") -> tuple[Path, Block]:
    """Write the example with x and y in US survey feet, z in a unit; return it in degrees, too."""
    write_example(folder)
    in_degrees = read_block(folder / "block.toml")
    for image in in_degrees.images:
        assert image.features is not None
        points = image.features.points
        ground = transformation_between(in_degrees.crs, PLANE_IN_FEET)(points.ground)
        rows = [f"id,line,sample,x,y,{name_of_z},role"]
        for name, (line, sample), (x, y, z), role in zip(
                points.ids, points.image.tolist(), ground.tolist(), points.roles, strict=True):
            rows.append(f"{name},{line},{sample},{x},{y},{z / metres_per_z},{role}")
        (folder / f"{image.name}_points.csv").write_text("\n".join(rows) + "\n")
    file = folder / "block.toml"
    file.write_text(file.read_text().replace("EPSG:4979", PLANE_IN_FEET))
    return file, in_degrees


@pytest.mark.slow_cases(
    "crs-0.3048006096012192-US survey feet", "metre-1.0-metres",
    "us-ft-0.3048006096012192-US survey feet")
@pytest.mark.parametrize(("unit", "metres", "words"), [
    ("us-ft", 1200 / 3937, "US survey feet"), ("crs", 1200 / 3937, "US survey feet"),
    ("ft", 0.3048, "feet"), ("metre", 1.0, "metres")])
def test_a_block_states_the_unit_of_its_heights(
        tmp_path: Path, unit: str, metres: float, words: str) -> None:
    file, in_degrees = in_plane_feet(tmp_path / "place", metres)
    file.write_text(f'z_unit = "{unit}"\n{file.read_text()}')
    block = read_block(file)
    for image, expected in zip(block.images, in_degrees.images, strict=True):
        assert image.features is not None
        assert expected.features is not None
        geodetic = to_wgs84(block.crs)(image.features.points.ground)
        np.testing.assert_allclose(geodetic, expected.features.points.ground, atol=1e-4)
    done = invoke("block", file, "--out", tmp_path / "adjusted", "--quiet")
    assert done.exit_code == 0, done.output
    assert done.output.partition("\n")[0].endswith(f"; z in {words}")


def test_an_open_unit_of_heights_is_asked_for_in_words_of_the_file(tmp_path: Path) -> None:
    file, _ = in_plane_feet(tmp_path / "place", 1.0)
    with pytest.raises(TermselError, match="z may be in US survey feet") as raised:
        read_block(file)
    assert raised.value.hint == 'State it: z_unit = "us-ft" or z_unit = "metre".'


def test_a_unit_of_heights_that_one_image_shows_is_asked_for(tmp_path: Path) -> None:
    """Its column has a name; ties have none."""
    file, _ = in_plane_feet(tmp_path / "place", 0.3048, "z_ft")
    with pytest.raises(TermselError, match="the block does not state its unit") as raised:
        read_block(file)
    assert raised.value.hint == 'Add z_unit = "ft" below the CRS.'


@pytest.mark.parametrize(("crs", "unit", "message"), [
    ("EPSG:4979", "fathom", "option 'z_unit' does not take 'fathom'"),
    ("local", "ft", "plane coordinates without a CRS have z in their own unit")])
def test_a_unit_that_heights_cannot_have_is_refused(
        tmp_path: Path, crs: str, unit: str, message: str) -> None:
    write_example(tmp_path / "place")
    file = tmp_path / "place" / "block.toml"
    file.write_text(file.read_text().replace('"EPSG:4979"', f'"{crs}"\nz_unit = "{unit}"'))
    with pytest.raises(TermselError, match=message) as raised:
        read_block(file)
    assert raised.value.line == 2
