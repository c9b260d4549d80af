"""Blocks of photos whose camera is known, against photos whose geometry is written out here."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("termsel_block", reason="termsel-block is not installed")
pytest.importorskip("termsel_cameras", reason="termsel-cameras is not installed")

from scipy.spatial.transform import Rotation

from termsel.testing import invoke
from termsel_block import adjust, read_block
from termsel_block.shown.record import record_of

FloatArray = NDArray[np.float64]

FOCAL, HIGH, SIZE = 3500.0, 1200.0, np.array([3000.0, 4000.0])
ORIGIN = np.array([400_000.0, 5_000_000.0, 300.0])
NORTH_UP = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
CONTROL = (4, 3, 0, 4)  # of each photo


def flight(folder: Path, seed: int, noise: float = 0.7,
           n_control: tuple[int, ...] = CONTROL) -> Path:
    """Write a block of four photos of one flight, the third without control; return its file."""
    rng = np.random.default_rng(seed)
    places = [np.array([550.0 * i, 0.0, HIGH]) + rng.normal(0, 15, 3) for i in range(4)]
    turns = [NORTH_UP @ Rotation.from_rotvec(rng.normal(0, 0.04, 3)).as_matrix() for _ in places]

    def seen(i: int, ground: FloatArray) -> tuple[FloatArray, list[int]]:
        in_camera = (ground - places[i]) @ turns[i].T
        image = FOCAL * in_camera[:, :2] / in_camera[:, 2:] + (SIZE - 1) / 2
        inside = np.flatnonzero((image > 30).all(axis=1) & (image < SIZE - 30).all(axis=1))
        return image + noise * rng.standard_normal(image.shape), inside.tolist()

    def hills(count: int) -> FloatArray:
        plan = np.column_stack([rng.uniform(-700, 2400, count), rng.uniform(-550, 550, count)])
        return np.column_stack([plan, 40 * (np.sin(plan[:, 0] / 200) + np.cos(plan[:, 1] / 250))])

    ties = hills(90)
    control = hills(14)
    independent = hills(60)
    tie_rows = ["id,image,line,sample"]
    block = ['crs = "EPSG:32633"', 'ties = "ties.csv"']
    for i in range(4):
        image, inside = seen(i, ties)
        tie_rows += [f"T{k},I{i},{image[k, 0]:.3f},{image[k, 1]:.3f}" for k in inside]
        rows = ["id,role,line,sample,x,y,z"]
        for role, ground, count in (("control", control, n_control[i]),
                                    ("independent", independent, 15)):
            image, inside = seen(i, ground)
            rows += [f"{role[0]}{k},{role},{image[k, 0]:.3f},{image[k, 1]:.3f},"
                     + ",".join(f"{value:.3f}" for value in ground[k] + ORIGIN)
                     for k in inside[:count]]
        (folder / f"I{i}.csv").write_text("\n".join(rows))
        block += ["[[image]]", f'name = "I{i}"', f'points = "I{i}.csv"', 'model = "known-frame"',
                  'options = { camera = "camera.json" }']
    (folder / "camera.json").write_text(json.dumps({
        "focal": FOCAL * 1.001, "focal_spread": 0.003, "principal_point": [1499.5, 1999.5]}))
    (folder / "ties.csv").write_text("\n".join(tie_rows))
    (folder / "block.toml").write_text("\n".join(block))
    return folder / "block.toml"


@pytest.mark.slow
def test_photos_of_a_known_camera_hold_one_without_control(tmp_path: Path) -> None:
    holds = []
    for seed in range(4):
        folder = tmp_path / str(seed)
        folder.mkdir()
        record = record_of(adjust(read_block(flight(folder, seed))))
        for image in record.images:
            assert image.independent is not None
            assert image.independent < 8.0
            holds.append(image.low <= image.independent <= image.high)
    assert np.mean(holds) >= 12 / 16


@pytest.mark.slow
def test_the_accuracy_of_each_image_of_a_block_is_stated(tmp_path: Path) -> None:
    pytest.importorskip("termsel_standards", reason="termsel-standards is not installed")
    file = flight(tmp_path, 1)
    for points in tmp_path.glob("I?.csv"):
        points.write_text(points.read_text().replace("independent", "off"))
    assert invoke("block", file, "--out", tmp_path / "out").exit_code == 0
    stated = invoke("accuracy", tmp_path / "out")
    assert stated.exit_code == 0, stated.stderr
    assert stated.stdout.count("image I2 of a block: no independent check points") == 1
    assert stated.stdout.count("Predicted, not tested by independent check points") == 4
    listed = json.loads(invoke("accuracy", tmp_path / "out", "--json").stdout)
    assert [one["source"] for one in listed] == [f"image I{i} of a block" for i in range(4)]


@pytest.mark.slow
def test_photos_without_a_stated_model_are_found_to_be_photos(tmp_path: Path) -> None:
    path = flight(tmp_path, 0, n_control=(9, 9, 9, 9))
    path.write_text("\n".join(line for line in path.read_text().splitlines()
                              if not line.startswith(("model", "options"))))
    result = adjust(read_block(path))
    assert any("4 images have no RPC and no model, and are taken for photos" in note
               for note in result.block.notes)
    for image in record_of(result).images:
        assert image.independent is not None
        # By polynomials it is a hundred times as large.
        assert image.independent < 20.0
