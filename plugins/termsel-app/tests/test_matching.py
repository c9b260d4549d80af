"""Matching refines a click to a part of a pixel, and proposes; the user decides."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.transform import Affine
from scipy.ndimage import gaussian_filter, map_coordinates

from termsel import TermselError
from termsel_app.matching import refine_point
from termsel_app.prediction import Prediction
from termsel_app.quality import Question, judge_control
from termsel_app.session import Files, Session, open_session

pytest.importorskip("termsel_match")
SCALE, LINE, SAMPLE = 1.05, 12.4, -7.3
"""Pixels of the map in one of the image, and where its first pixel is."""


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Session]:
    """Return a session of five exact points between an image and a map of the same texture."""
    folder = tmp_path_factory.mktemp("match")
    ground = gaussian_filter(np.random.default_rng(1).normal(size=(700, 700)), 2.0) * 400 + 128
    at = np.mgrid[0:500, 0:500] * SCALE
    image = map_coordinates(ground, [at[0] + LINE, at[1] + SAMPLE + 20], order=3)
    for name, pixels, more in (
            ("scan.tif", image, {}),
            ("ortho.tif", ground, {"crs": "EPSG:25832",
                                   "transform": Affine(2, 0, 600000, 0, -2, 5300000)})):
        with rasterio.open(folder / name, "w", driver="GTiff", count=1, dtype="uint8",
                           height=pixels.shape[0], width=pixels.shape[1], **more) as raster:
            raster.write(np.clip(pixels, 0, 255).astype(np.uint8)[None])
    with open_session(Files(str(folder / "scan.tif"), (str(folder / "ortho.tif"),)),
                      folder / "out") as begun:
        assert begun.worker is not None
        begun.worker.close()
        begun.worker = None
        for line, sample in ((60, 60), (70, 430), (420, 80), (430, 440), (250, 250)):
            begun.put({"image": [float(line), float(sample)], "map": place(line, sample)})
        begun.asked = begun.version
        for answer in judge_control(
                Question(begun.version, begun.control.features("EPSG:25832"), begun.size)):
            begun.keep_answer(answer)
            if begun.prediction is not None:
                break
        yield begun


def place(line: float, sample: float) -> list[float]:
    """Return where a place of the image is on the map."""
    return [600000 + 2 * (sample * SCALE + SAMPLE + 20.5),
            5300000 - 2 * (line * SCALE + LINE + 0.5)]


@pytest.mark.parametrize("off", [(3.3, -2.6), (-6.0, 7.5), (0.4, 0.3)])
def test_a_click_is_refined_to_a_part_of_a_pixel(
        session: Session, off: tuple[float, float]) -> None:
    true = np.array([200.0, 310.0])
    before = session.version
    name = session.put({"image": (true + off).tolist(), "map": place(*true)})
    proposal = refine_point(session, name)
    assert np.hypot(*(np.array(proposal["image"]) - true)) < 0.15
    assert proposal["distance"] == pytest.approx(np.hypot(*off), abs=0.2)
    assert session.version == before + 1  # nothing is taken before the user says so
    session.delete([name])


def test_what_does_not_look_alike_is_left(session: Session) -> None:
    name = session.put({"image": [300.0, 150.0], "map": place(120, 400)})
    with pytest.raises(TermselError, match="do not look alike"):
        refine_point(session, name)
    session.delete([name])
    half = session.put({"image": [300.0, 150.0]})
    with pytest.raises(TermselError, match="both positions"):
        refine_point(session, half)
    session.delete([half])


def test_the_prediction_is_where_the_place_is_and_its_ring_is_around_it(session: Session) -> None:
    assert isinstance(session.prediction, Prediction)
    there = session.predict(image=[333.0, 222.0])
    assert there is not None
    assert np.hypot(*np.subtract(there["place"], place(333, 222))) < 0.1
    back = session.predict(xy=there["place"])
    assert back is not None
    assert back["place"] == pytest.approx([333, 222], abs=1e-3)
    ring = np.array(back["ring"])
    assert (ring.min(axis=0) < back["place"]).all()
    assert (ring.max(axis=0) > back["place"]).all()


def test_three_points_predict_with_an_uncertainty(session: Session, tmp_path: Path) -> None:
    with open_session(session.files, tmp_path / "three") as begun:
        assert begun.worker is not None
        begun.worker.close()
        begun.worker = None
        for line, sample in ((60, 60), (70, 430), (420, 80)):
            begun.put({"image": [float(line), sample + 0.5], "map": place(line, sample)})
        begun.asked = begun.version
        begun.keep_answer(next(iter(judge_control(Question(
            begun.version, begun.control.features("EPSG:25832"), begun.size)))))
        there = begun.predict(image=[300.0, 300.0])
    assert there is not None
    assert there["sigma"] is not None
    assert there["ring"]
