"""Splines of more points than have a kernel each, against those of all kernels."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

import termsel
from termsel import FeatureSet, Points
from termsel.adjustment.bayesian import kernels, thin_plate
from termsel.adjustment.bayesian.thin_plate import ThinPlates, thin_plates
from termsel.models import interpolating

UNITS = (1.0, 0.9)


def bent(n: int, *, sigma: bool = False, seed: int = 0) -> tuple[Points, np.ndarray]:
    """Return scaled points of an image that waves, and where they would be without noise."""
    rng = np.random.default_rng(seed)
    ground = np.column_stack([rng.uniform(-1, 1, (n, 2)), np.zeros(n)])
    true = ground[:, :2] @ [[0.9, -0.2], [0.1, 0.8]] + 0.02 * np.sin(9 * ground[:, 1::-1])
    deviation = rng.uniform(0.5, 2.0, (n, 2)) if sigma else None
    noise = 0.004 * rng.standard_normal((n, 2)) * (1.0 if deviation is None else deviation)
    return Points(tuple(map(str, range(n))), true + noise, ground, deviation), true


@pytest.fixture(autouse=True)
def nothing_kept() -> Iterator[None]:
    thin_plate._cached_splines.cache_clear()
    yield
    thin_plate._cached_splines.cache_clear()


def spline(points: Points, smoothing: float | None = None, criterion: str = "reml") -> ThinPlates:
    thin_plate._cached_splines.cache_clear()
    found = thin_plates(points, UNITS, smoothing, criterion)
    assert found is not None
    return found


@pytest.mark.parametrize("criterion", ["reml", "gcv"])
@pytest.mark.parametrize("smoothing", [None, 0.03])
@pytest.mark.parametrize("sigma", [False, True])
def test_knots_at_all_points_give_the_spline_of_all_kernels(
        monkeypatch: pytest.MonkeyPatch, criterion: str, smoothing: float | None, *,
        sigma: bool) -> None:
    points, _ = bent(70, sigma=sigma)
    at = np.column_stack([np.random.default_rng(1).uniform(-1.2, 1.2, (20, 2)), np.zeros(20)])
    exact = spline(points, smoothing, criterion)
    monkeypatch.setattr(kernels, "SPLINE_KNOTS", 60)
    monkeypatch.setattr(thin_plate, "NEARBY_SMOOTHINGS", len(thin_plate.SMOOTHINGS))
    monkeypatch.setattr(kernels, "GROUND_BATCH", 9)
    monkeypatch.setattr(kernels, "farthest_points", lambda places, count: places)
    found = spline(points, smoothing, criterion)
    assert found.field_columns.root is not None
    assert found.smoothing == exact.smoothing
    for mine, theirs in ((found.errors, exact.errors), (found.predict(at), exact.predict(at)),
                         (found.effective, exact.effective),
                         *zip(found.spread(at), exact.spread(at), strict=True)):
        np.testing.assert_allclose(mine, theirs, rtol=1e-7, atol=1e-10)


def test_few_knots_leave_out_points_as_splines_without_them_do(
        monkeypatch: pytest.MonkeyPatch) -> None:
    """The knots stay: what spans the field is no part of what is left out."""
    points, _ = bent(80)
    monkeypatch.setattr(kernels, "SPLINE_KNOTS", 40)
    found, knots = spline(points, 0.01), kernels.farthest_points(points.ground[:, :2] * UNITS, 40)
    monkeypatch.setattr(kernels, "farthest_points", lambda places, count: knots)
    for i in (0, 31):
        others = spline(points.take(np.arange(80) != i), 0.01)
        np.testing.assert_allclose(
            found.errors[i], (points.image - others.predict(points.ground))[i], atol=1e-10)


def test_many_points_are_predicted_nearly_as_by_all_kernels(
        monkeypatch: pytest.MonkeyPatch) -> None:
    (points, _), (others, true) = bent(900), bent(500, seed=1)
    whole = np.abs(spline(points).predict(others.ground) - true)
    monkeypatch.setattr(kernels, "SPLINE_KNOTS", 300)
    found = spline(points)
    error = found.predict(others.ground) - true
    assert np.sqrt((error**2).mean()) < 1.05 * np.sqrt((whole**2).mean())
    assert 0.6 < np.sqrt((error**2).mean() / found.spread(others.ground)[0].mean()) < 1.4
    assert np.sqrt((found.errors**2).mean()) == pytest.approx(0.004, rel=0.15)


def test_only_so_many_points_are_met_exactly(monkeypatch: pytest.MonkeyPatch) -> None:
    points, _ = bent(50)
    monkeypatch.setattr(interpolating, "MAX_EXACT_SPLINE", 49)
    with pytest.raises(termsel.TermselError, match="meets 50 points exactly takes too long"):
        termsel.fit(FeatureSet(points), "tps", smoothing=0.0).errors(points)
    assert termsel.fit(FeatureSet(points), "tps", smoothing=0.01).errors(points).any()
