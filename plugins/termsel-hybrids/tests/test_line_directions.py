"""Line-based transformation models: directions of lines, and points for what these leave open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("termsel_hybrids", reason="termsel-hybrids is not installed: "
                    "pip install -e plugins/termsel-hybrids")

import termsel
from termsel import FeatureSet, Lines, Points, SensorModel
from termsel.testing import Check, checks
from termsel_hybrids import LineAffine, LineConformal

FloatArray = NDArray[np.float64]
MODELS = (LineAffine, LineConformal)


@pytest.mark.parametrize("check", [check for model in MODELS for check in checks(model)],
                         ids=lambda check: check.name)
def test_models_pass_the_suite(check: Check) -> None:
    check.run()


def _scene(turn: FloatArray, points: int, slid: float = 0.0) -> tuple[FeatureSet, Points]:
    """Return points and lines that a parallel projection sees, and points to judge by.

    `turn` has the rows of sample and minus line. Each image line is measured at other places than
    the ends of its ground line, and moved across itself by up to `slid` px.
    """
    rng = np.random.default_rng(4)
    ground = rng.uniform(-1000, 1000, (points + 30, 3)) * [1, 1, 0.2]
    ends = rng.uniform(-1000, 1000, (25, 2, 3)) * [1, 1, 0.2]

    def seen(places: FloatArray) -> FloatArray:
        sample, up = turn @ places.reshape(-1, 3).T
        return np.stack([3000 - up, 2000 + sample], axis=1).reshape(*places.shape[:-1], 2)

    image = seen(ends)
    along = image[:, 1] - image[:, 0]
    across = along[:, ::-1] * [1, -1] / np.linalg.norm(along, axis=1)[:, None]
    image = image + along[:, None] * [[0.3], [-0.2]]
    image += (slid * rng.uniform(-1, 1, 25))[:, None, None] * across[:, None]
    every = Points(tuple(f"P{i}" for i in range(len(ground))), seen(ground), ground)
    known = replace(every.take(np.arange(points)), roles=("control",) * points)
    lines = Lines(tuple(f"L{i}" for i in range(25)), image, ends)
    return FeatureSet(known, lines, crs="local"), every.take(np.arange(points, len(ground)))


def _turn() -> FloatArray:
    left, _, right = np.linalg.svd(np.array([[0.8, 0.5, 0.3], [-0.5, 0.9, 0.1]]),
                                   full_matrices=False)
    return np.asarray(0.7 * left @ right)


@pytest.mark.parametrize("model", MODELS)
def test_two_points_and_lines_determine_all(model: type[SensorModel]) -> None:
    features, others = _scene(_turn(), 2, slid=200.0)
    fitted = termsel.fit(features, model())
    assert np.abs(fitted.errors(others)).max() < 1e-6


def test_an_affine_projection_is_recovered_and_is_not_conformal() -> None:
    features, others = _scene(np.array([[0.9, 0.2, 0.3], [-0.1, 0.5, 0.1]]), 4)
    assert np.abs(termsel.fit(features, LineAffine()).errors(others)).max() < 1e-6
    assert np.abs(termsel.fit(features, LineConformal()).errors(others)).max() > 10


def test_places_of_lines_are_of_no_account() -> None:
    features, others = _scene(_turn(), 2, slid=200.0)
    assert np.abs(termsel.fit(features, termsel.Affine()).errors(others)).max() > 10
    assert np.abs(termsel.fit(features, LineAffine()).errors(others)).max() < 1e-6


def test_a_mirrored_image_is_one_seen_from_below() -> None:
    features, others = _scene(_turn() * [1, -1, 1], 3)
    assert np.abs(termsel.fit(features, LineConformal()).errors(others)).max() < 1e-6


@pytest.mark.parametrize("model", MODELS)
def test_lines_alone_are_refused(model: type[SensorModel]) -> None:
    features, _ = _scene(_turn(), 2)
    with pytest.raises(termsel.TermselError, match="determine"):
        termsel.fit(features.with_(points=features.points.take(np.arange(0))), model())


def test_a_line_with_a_large_deviation_counts_less() -> None:
    features, others = _scene(_turn(), 3)
    image = features.lines.image.copy()
    image[0, 1] += [60, 60]
    wrong = replace(features.lines, image=image)

    def off(sigma: float) -> float:
        lines = replace(wrong, sigma=np.array([sigma] + [1.0] * 24))
        fitted = termsel.fit(features.with_(lines=lines), LineAffine())
        return float(np.abs(fitted.errors(others)).max())

    assert off(100.0) < off(1.0) / 10


@pytest.mark.parametrize("name", ["lbtm-affine", "lbtm-conformal"])
def test_a_run_takes_points_and_lines_together(name: str) -> None:
    result = termsel.run("owdis-lines", model=name, solver="all-terms",
                         options={"mixed": True})
    assert result.accuracy is not None
    assert result.accuracy.image.total < 8
    assert result.fit.adjustment.converged in (None, True)
