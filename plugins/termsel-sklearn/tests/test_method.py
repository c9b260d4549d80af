"""Regressors of scikit-learn as methods of termsel."""

from __future__ import annotations

from dataclasses import replace

import pytest
from sklearn.linear_model import LinearRegression, Ridge
from sklearn.neighbors import KNeighborsRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures

import termsel
from termsel import FeatureSet, Method
from termsel.testing import checks
from termsel_sklearn import SensorModelRegressor, regressor_method

LINEAR = regressor_method(LinearRegression())
QUADRATIC = make_pipeline(PolynomialFeatures(2), Ridge(alpha=1e-6))


@pytest.fixture(scope="module")
def scene() -> FeatureSet:
    points = termsel.simulate_scene("ikonos-hamedan", n_points=24, n_lines=0).points
    return FeatureSet(replace(points, roles=()), crs="EPSG:4979")


def few_points() -> FeatureSet:
    points = termsel.simulate_scene("ikonos-hamedan", n_points=12, n_lines=0).points
    return FeatureSet(replace(points, roles=()), crs="EPSG:4979")


@pytest.mark.parametrize("check", checks(regressor_method(QUADRATIC, "ridge-2"),
                                         features=[few_points()]), ids=lambda check: check.name)
def test_it_does_what_every_method_does(check: object) -> None:
    check.run()  # type: ignore[attr-defined]


def test_linear_regression_is_the_affine_polynomial(scene: FeatureSet) -> None:
    ours = termsel.run(features=scene, method="affine")
    theirs = termsel.run(features=scene, method=regressor_method(LinearRegression()))
    assert ours.predicted is not None
    assert theirs.predicted is not None
    assert theirs.predicted.rmse == pytest.approx(ours.predicted.rmse, rel=1e-6)
    # Effective parameters of what is not known are those that held-out errors tell.
    assert theirs.fit.effective == pytest.approx(8.0, abs=2.0)


def test_it_is_chosen_among_methods_by_what_it_predicts(scene: FeatureSet) -> None:
    neighbours = regressor_method(KNeighborsRegressor(3), "neighbours", "the nearest neighbours")
    auto = termsel.Auto(methods=(neighbours, *termsel.Auto().methods))
    result = termsel.run(features=scene, method=auto)
    assert result.strategy is not None
    rows = {row.name: row.predicted for row in result.strategy.candidates}
    assert (rows["neighbours"] or 0.0) > 10.0
    assert result.strategy.chosen != "neighbours"


@pytest.mark.parametrize("strategy", ["auto", "quadratic", LINEAR])
def test_a_regressor_takes_any_method(scene: FeatureSet, strategy: str | Method) -> None:
    points = scene.points
    regressor = SensorModelRegressor(strategy=strategy).fit(points.ground, points.image)
    expected = termsel.fit(replace(scene, crs="local"), termsel.Auto() if strategy == "auto"
                           else strategy)
    assert regressor.predict(points.ground) == pytest.approx(expected.project(points.ground))
