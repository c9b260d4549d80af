"""Images without RPC by a model of their sensor, whose terms have priors."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("termsel_block", reason="termsel-block is not installed: "
                    "pip install -e plugins/termsel-block")
pytest.importorskip("termsel_cameras", reason="termsel-cameras is not installed: "
                    "pip install -e plugins/termsel-cameras")

from termsel import TermselError, read_result, write_result
from termsel.testing import invoke
from termsel_block import contradictions, joint
from termsel_block.accuracy import independent_points, rms_length
from termsel_block.block import Block
from termsel_block.files.block_file import read_block
from termsel_block.files.folders import image_result
from termsel_block.geometry.control import control_equations
from termsel_block.geometry.frame import Frame
from termsel_block.geometry.physical import Contradiction, PhysicalModel
from termsel_block.joint import BlockResult, adjust
from termsel_block.shown.record import record_of
from termsel_block.simulated import Simulated, simulate_block


def modelled(block: Block, name: str) -> Block:
    """Return the block with one model of all images."""
    return replace(block, images=tuple(replace(image, model=name) for image in block.images))


@pytest.fixture(scope="module")
def simulated() -> Simulated:
    return simulate_block(3, n_ties=100, control=(6, 6, 0), seed=1, independent=30)


@pytest.fixture(scope="module")
def scanners(simulated: Simulated) -> BlockResult:
    return adjust(modelled(simulated.block, "scanner"))


def errors(result: BlockResult) -> list[float]:
    found = []
    for i in range(3):
        points = independent_points(result, i)
        assert points is not None
        found.append(rms_length(points.image - result.project(i, points.ground)))
    return found


@pytest.mark.slow
def test_scanners_see_more_than_polynomials(simulated: Simulated, scanners: BlockResult) -> None:
    assert scanners.adjusted.converged
    assert max(errors(scanners)) < 1.2
    assert np.sum(errors(scanners)) < np.sum(errors(adjust(simulated.block)))


def test_standard_deviations_of_scanners_are_true(simulated: Simulated,
                                                  scanners: BlockResult) -> None:
    away = scanners.adjusted.state.ties - scanners.frame.local(simulated.ties)
    covariance = scanners.adjusted.solved.covariance_of_ties()
    of_each = np.einsum("ti,tij,tj->t", away, np.linalg.inv(covariance), away)
    assert 0.2 < of_each.mean() / 3 < 2.5


def test_a_scanner_has_its_derivatives(scanners: BlockResult) -> None:
    camera, parameters = scanners.camera(0), scanners.adjusted.state.parameters[0]
    local = scanners.control[0].local[::2]
    rows = scanners.rows(0, local)
    for at in range(parameters.size):
        step = np.zeros(parameters.size)
        step[at] = 1e-3
        ahead, back = (camera.project(parameters + sign * step, local)
                       for sign in (1, -1))
        np.testing.assert_allclose(rows[:, :, at], (ahead - back) / 2e-3, rtol=1e-3, atol=0.05)


@pytest.mark.slow
def test_the_result_of_a_scanner_is_its_model(scanners: BlockResult, tmp_path: Path) -> None:
    record = record_of(scanners)
    assert [image.model for image in record.images] == ["scanner"] * 3
    (tmp_path / "out").mkdir()
    write_result(image_result(scanners, 0, record), tmp_path / "out")
    alone, points = read_result(tmp_path / "out"), independent_points(scanners, 0)
    assert alone.model == "scanner"
    assert points is not None
    away = alone.fit.project(points.ground) - scanners.project(0, points.ground)
    assert np.abs(away).max() < 1.5


@pytest.mark.parametrize(("model", "options", "said"), [
    ("scaner", "", "block.toml: image 'A': unknown model 'scaner'"),
    ("scanner", "{ sensor = 'SPOT-77' }", "SPOT-77"),
    ("scanner", "{ colour = 'red' }", "colour"),
    ("auto", "{ sensor = 'SPOT-4' }", "options, which 'auto' does not take"),
    ("shift", "", "A correction requires an RPC"),
    ("affine", "", "A correction requires an RPC"),
    ("dlt3d", "", "have no priors"),
    ("rpc-shift", "", "Name the RPC as rpc of the image"),
    ("scanner-dimap", "", 'options = { metadata = "FILE" }'),
])
def test_a_wrong_model_is_named(model: str, options: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "ties.csv").write_text("id,image,line,sample\n" + "".join(
        f"{k},{name},{10 * k},{7 * k % 11 + (name == 'B')}\n" for k in range(9) for name in "AB"))
    (tmp_path / "a.csv").write_text("id,line,sample,lon,lat,height\n" + "".join(
        f"{k},{900 * (k % 3)},{700 * (k // 3)},{20 + k % 3 / 100},{40 + k // 3 / 100},{k * 37 % 90}"
        "\n" for k in range(9)))
    (tmp_path / "block.toml").write_text(
        'crs = "EPSG:4979"\nties = "ties.csv"\n[[image]]\nname = "A"\npoints = "a.csv"\n'
        f'model = "{model}"\n' + (f"options = {options}\n" if options else "")
        + '[[image]]\nname = "B"\npoints = "a.csv"\n')
    done = invoke("block", tmp_path / "block.toml", "--out", tmp_path / "out")
    assert done.exit_code == 2
    told = " ".join(done.output.split())
    assert said in told
    assert "--" not in told  # options of other commands
    assert "poly2d" not in told  # models that a block cannot take
    assert not (tmp_path / "out").exists()


def test_a_sensor_that_is_right_hides_no_other(
        simulated: Simulated, monkeypatch: pytest.MonkeyPatch) -> None:
    sensors = ("aster", "planetscope", "aster")
    block = replace(simulated.block, images=tuple(
        replace(image, model="scanner", options={"sensor": sensor})
        for image, sensor in zip(simulated.block.images, sensors, strict=True)))
    severity = {"aster": 9.0, "planetscope": 5.0}

    def contradicted(adjusted: Block) -> dict[int, Contradiction]:
        return {i: Contradiction(1e-9, severity[image.options["sensor"]], ())
                for i, image in enumerate(adjusted.images) if "sensor" in image.options}

    monkeypatch.setattr(joint, "_adjust_as_stated", lambda block, *_: SimpleNamespace(
        block=block, adjusted=block))
    monkeypatch.setattr(joint, "_with_notes_on_dem", lambda result: result)
    monkeypatch.setattr(joint, "_without_harmful_sensors", lambda result, *_: result)
    monkeypatch.setattr(joint, "agrees_better", lambda *given: sensors[given[-1]] != "aster")
    monkeypatch.setattr(contradictions, "contradictions_of", contradicted)
    found = adjust(block).block
    assert [image.options.get("sensor") for image in found.images] == ["aster", None, "aster"]
    assert sum("'planetscope'" in note for note in found.notes) == 1
    assert not any("'aster'" in note for note in found.notes)


@dataclass(frozen=True)
class Outcome:
    """What `adjust` needs of a block as adjusted."""

    block: Block
    adjusted: SimpleNamespace
    frame: None = None


@pytest.mark.parametrize(("of_unknown", "score", "converged", "said"), [
    (100.0, 0.0, True, "the ground is 300 m rough, with an unknown one 100 m"),
    (300.0, 25.0, True,
     "the block predicts its own control points far worse than with an unknown one"),
    (280.0, 0.0, True, ""), (300.0, 3.0, True, ""),
    (100.0, -25.0, True, ""),  # control says that the sensor is right
    (100.0, 25.0, False, "")])
def test_a_sensor_that_bends_the_ground_or_control_is_not_taken(
        simulated: Simulated, monkeypatch: pytest.MonkeyPatch, of_unknown: float,
        score: float, converged: bool, said: str) -> None:
    block = replace(simulated.block, images=tuple(
        replace(image, model="scanner", options={"sensor": "aster", "track": "descending"})
        for image in simulated.block.images))
    tried = []

    def rough(block: Block, *_: object) -> Outcome:
        tried.append(block)
        stated = "sensor" in block.images[0].options
        return Outcome(block, SimpleNamespace(
            roughness=300.0 if stated else of_unknown, converged=stated or converged,
            # The other features are predicted in one of both alone.
            score={(0, "G1"): 0.0, (0, "G2"): -90.0} if stated else {
                (0, "G1"): score, (1, "G1"): -90.0},
            state=SimpleNamespace(cameras=())))

    monkeypatch.setattr(joint, "_adjust_as_stated", rough)
    monkeypatch.setattr(joint, "_with_notes_on_dem", lambda result: result)
    found = adjust(block).block
    assert len(tried) == 2
    if not said:
        assert found == block
        return
    assert [image.options for image in found.images] == [{"track": "descending"}] * 3
    assert found.notes == (
        f"With the sensor 'aster' of I1, I2, I3 {said}. The unknown one is taken.",)


def test_a_block_without_a_sensor_is_adjusted_once(
        simulated: Simulated, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its terms contradict it, an unknown one agrees no better, and the ground is compared, too."""
    block = replace(simulated.block, images=tuple(
        replace(image, model="scanner", options={"sensor": "aster"})
        for image in simulated.block.images))
    tried = []

    def flat(block: Block, *_: object) -> Outcome:
        stated = "sensor" in block.images[0].options
        tried.append(stated)
        return Outcome(block, SimpleNamespace(
            roughness=300.0 if stated else 100.0, converged=True, score={}, stated=stated))

    monkeypatch.setattr(joint, "_adjust_as_stated", flat)
    monkeypatch.setattr(joint, "_with_notes_on_dem", lambda result: result)
    monkeypatch.setattr(joint, "agrees_better", lambda *_: False)
    monkeypatch.setattr(contradictions, "contradictions_of", lambda adjusted: {
        0: Contradiction(1e-9, 9.0, ())} if adjusted.stated else {})
    (note,) = adjust(block).block.notes
    assert tried == [True, False]
    assert "the ground is 300 m rough" in note


@pytest.mark.parametrize("spelled", ["aster", "ASTER"])
def test_a_sensor_is_one_claim_of_all_images_that_state_it(
        simulated: Simulated, monkeypatch: pytest.MonkeyPatch, spelled: str) -> None:
    """Where terms of one image contradict it, it is not held in the other, however spelled."""
    sensors = ("Aster", "planetscope", spelled)
    block = replace(simulated.block, images=tuple(
        replace(image, model="scanner", options={"sensor": sensor})
        for image, sensor in zip(simulated.block.images, sensors, strict=True)))
    monkeypatch.setattr(contradictions, "contradictions_of", lambda _: {
        2: Contradiction(1e-9, 9.0, ("look-2 by 5.0",))})
    found = contradictions.without_wrong_sensor(block, SimpleNamespace(), ())  # type: ignore[arg-type]
    assert found is not None
    assert [image.options.get("sensor") for image in found[0].images] == [None, "planetscope", None]
    assert found[0].notes == (
        "Points and ties of I3 (look-2 by 5.0 standard deviations) contradict the sensor 'Aster'. "
        "The 2 images that state it are adjusted as those of an unknown sensor.",)


@pytest.mark.slow
def test_a_view_straight_down_that_is_not_is_seen(
        simulated: Simulated, tmp_path: Path) -> None:
    """Views are 20 degrees off: terms say so, or agree with what is known as the ground bends."""
    (tmp_path / "mine.json").write_text(json.dumps({
        "altitude": 690.0, "inclination": 98.1, "pixel": 2.37, "pixel_sigma": 0.06, "side": 0.5,
        "altitude_sigma": 15.0, "ahead": 0.5, "source": "simulated"}))
    result = adjust(replace(simulated.block, images=tuple(
        replace(image, model="scanner", options={"sensor": str(tmp_path / "mine.json")})
        for image in simulated.block.images)))
    (note,) = result.block.notes
    assert "the sensor 'mine.json'" in note
    assert all("sensor" not in image.options for image in result.block.images)
    assert max(errors(result)) < 1.2


def test_options_are_read(tmp_path: Path) -> None:
    (tmp_path / "ties.csv").write_text("id,image,line,sample\n" + "".join(
        f"{k},{name},{k},{k + (name == 'B')}\n" for k in range(5) for name in "AB"))
    (tmp_path / "block.toml").write_text(
        'crs = "EPSG:4979"\nties = "ties.csv"\n[[image]]\nname = "A"\nmodel = "scanner"\n'
        'options = { track = "ascending" }\n[[image]]\nname = "B"\n')
    first, second = read_block(tmp_path / "block.toml").images
    assert (first.model, first.options) == ("scanner", {"track": "ascending"})
    assert second.options == {}


@pytest.mark.slow
def test_a_scanner_begins_with_ties_where_it_has_no_control(simulated: Simulated) -> None:
    images = list(modelled(simulated.block, "scanner").images)
    images[:2] = simulated.block.images[:2]
    mixed = adjust(replace(simulated.block, images=tuple(images)))
    assert errors(mixed)[2] < 1.2


def test_a_model_without_a_start_is_refused(simulated: Simulated) -> None:
    features = simulated.block.images[0].features
    assert features is not None
    frame = Frame.at(features.points.ground, simulated.block.crs)
    with pytest.raises(TermselError, match="have no priors"):
        PhysicalModel("poly3d", {"degree": 1}).fitted(
            frame, *control_equations(features, frame).points(), "A")


def test_a_scanner_without_ties_is_held_by_its_control() -> None:
    block = simulate_block(3, n_ties=60, control=(6, 6, 0), rpcs=True, seed=1,
                           independent=30).block
    images = (replace(block.images[0], rpc=None, model="scanner",
                      options={"track": "descending"}), *block.images[1:])
    ties = block.ties
    use = ties.image > 0
    alone = replace(block, images=images, ties=replace(
        ties, tie=ties.tie[use], image=ties.image[use], position=ties.position[use]))
    result = adjust(alone)
    assert errors(result)[0] < 20.0  # six points of a scanner of which nothing is known
    assert record_of(result).images[0].options == {"track": "descending"}


def test_a_sensor_is_read_from_the_folder_of_the_block(tmp_path: Path) -> None:
    (tmp_path / "m").mkdir()
    (tmp_path / "m/mine.json").write_text("{")
    (tmp_path / "m/ties.csv").write_text("id,image,line,sample\n" + "".join(
        f"{k},{name},{k},{k + (name == 'B')}\n" for k in range(5) for name in "AB"))
    (tmp_path / "m/block.toml").write_text(
        'crs = "EPSG:4979"\nties = "ties.csv"\n[[image]]\nname = "A"\nmodel = "scanner"\n'
        'options = { sensor = "mine.json" }\n[[image]]\nname = "B"\n')
    with pytest.raises(TermselError, match=r"image 'A'.*JSON"):
        read_block(tmp_path / "m/block.toml")


@pytest.mark.slow
def test_a_sensor_that_is_nearly_right_is_said_and_not_used(simulated: Simulated) -> None:
    """A field of 4 m seen straight down meets six points of a view of 2.5 m to the side."""
    images = list(simulated.block.images)
    images[0] = replace(images[0], model="scanner",
                        options={"sensor": "planetscope", "track": "descending"})
    result = adjust(replace(simulated.block, images=tuple(images)))
    (note,) = result.block.notes
    assert note.startswith("Points and ties of I1 (period by 4")
    assert record_of(result).images[0].options == {"track": "descending"}
    assert errors(result)[0] < 2.0  # 13 px, and a predicted 4


@pytest.mark.slow
def test_a_sensor_that_is_right_stays(simulated: Simulated, tmp_path: Path) -> None:
    """As the simulated scanner is: 680 km high, whose pixel is 2.2 m straight down."""
    (tmp_path / "mine.json").write_text(json.dumps({
        "altitude": 690.0, "inclination": 98.1, "pixel": 2.37, "pixel_sigma": 0.06, "side": 12.0,
        "altitude_sigma": 15.0, "ahead": 10.0, "source": "simulated"}))
    options = {"sensor": str(tmp_path / "mine.json")}
    images = (replace(simulated.block.images[0], model="scanner", options=options),
              *simulated.block.images[1:])
    result = adjust(replace(simulated.block, images=images))
    assert not result.block.notes
    assert result.block.images[0].options == options
    assert errors(result)[0] < 2.0


@pytest.mark.slow
@pytest.mark.parametrize("i", [0, 2])
def test_a_camera_of_another_kind_is_said(simulated: Simulated, i: int) -> None:
    """As a frame a scanner is 26 to 48 px off under a predicted 7 to 10."""
    images = list(simulated.block.images)
    images[i] = replace(images[i], model="frame")
    notes = record_of(adjust(replace(simulated.block, images=tuple(images)))).notes
    assert any(f"I{i + 1} contradict what the model 'frame' knows of cameras (" in one
               for one in notes)


def test_scanners_with_few_ties_converge() -> None:
    """Rows of control elsewhere than those of the covariance seemed to use up all of it."""
    block = simulate_block(3, n_ties=20, control=(6, 6, 0), seed=301, independent=10).block
    result = adjust(modelled(block, "scanner"))
    assert result.adjusted.converged  # not in 40 steps
    assert result.adjusted.state.freedom_control > 5.0  # 4 is that of no control


def test_a_wrong_sensor_is_named(simulated: Simulated, recwarn: pytest.WarningsRecorder) -> None:
    images = (replace(simulated.block.images[0], model="scanner", options={"sensor": "spot-4"}),
              *simulated.block.images[1:])
    with pytest.raises(TermselError, match="image 'I1': model 'scanner' misses half of its points"):
        adjust(replace(simulated.block, images=images))
    assert not recwarn.list
