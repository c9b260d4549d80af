"""The estimators for scikit-learn: its own checks, a grid search by blocks, a pipeline."""

from __future__ import annotations

import pickle
from itertools import combinations
from unittest import SkipTest

import numpy as np
import pytest
from sklearn.base import BaseEstimator, clone
from sklearn.linear_model import LinearRegression
from sklearn.model_selection import GridSearchCV, GroupKFold
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures
from sklearn.utils.estimator_checks import estimator_checks_generator

import termsel
from termsel.sklearn import SensorModelRegressor, TermSelector, spatial_blocks

OTHER_COLUMNS = {
    "check_n_features_in_after_fitting", "check_positive_only_tag_during_fit",
    "check_estimators_dtypes", "check_dtype_object", "check_regressors_train",
    "check_regressor_data_not_an_array", "check_regressor_multioutput",
    "check_regressors_no_decision_function", "check_regressors_int"}
"""Checks on data of 4, 5 or 10 columns, or 5 outputs, which no sensor model takes."""


@pytest.mark.slow
@pytest.mark.parametrize(("estimator", "excused"), [
    (SensorModelRegressor(degree=1), OTHER_COLUMNS), (TermSelector(), set())],
    ids=["regressor", "selector"])
@pytest.mark.filterwarnings("ignore")
def test_checks_of_scikit_learn(estimator: BaseEstimator, excused: set[str]) -> None:
    failed = set()
    for subject, check in estimator_checks_generator(estimator, legacy=True):
        name = check.func.__name__
        try:
            check(subject)
        except SkipTest:
            continue
        except (ValueError, AssertionError) as error:
            of_columns = "ground coordinates have 2 or 3" in f"{error} {error.__cause__}"
            failed.add(name if of_columns else f"{name}: {error}")
    assert failed == excused


def _scene() -> tuple[np.ndarray, np.ndarray]:
    points = termsel.simulate_scene("ikonos-hamedan").points
    return points.ground, points.image


def test_it_predicts_as_the_model_does() -> None:
    X, y = _scene()
    fitted = SensorModelRegressor("rfm", options={"order": 1}).fit(X[::2], y[::2])
    features = termsel.FeatureSet(termsel.Points(
        tuple(f"p{i}" for i in range(len(X[::2]))), y[::2], X[::2]), crs="local")
    expected = termsel.fit(features, "rfm", order=1).project(X)
    np.testing.assert_allclose(fitted.predict(X), expected, rtol=1e-12)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(fitted)).predict(X), fitted.predict(X))
    assert fitted.score(X, y) > 0.999


def test_two_columns_and_one_image_coordinate() -> None:
    X, y = _scene()
    flat = SensorModelRegressor(degree=2).fit(X[:, :2], y)
    assert type(flat.fit_.model).__name__ == "Polynomial2D"
    one = SensorModelRegressor(degree=2).fit(X[:, :2], y[:, 0])
    np.testing.assert_allclose(one.predict(X[:, :2]), flat.predict(X[:, :2])[:, 0], rtol=1e-9)


def test_grid_search_over_degree_and_strategy_by_blocks() -> None:
    X, y = _scene()
    groups = spatial_blocks(X, across=3)
    search = GridSearchCV(
        SensorModelRegressor(), {"degree": [2, 3], "strategy": ["least-squares", "shrunken"]},
        cv=GroupKFold(3), scoring="neg_root_mean_squared_error", error_score="raise")
    search.fit(X, y, groups=groups)
    mean = search.cv_results_["mean_test_score"]
    assert np.isfinite(mean).all()
    assert search.best_score_ == mean.max()
    # Points outside a block predict it badly by a cubic polynomial with 20 terms an axis.
    assert search.best_params_ != {"degree": 3, "strategy": "least-squares"}


def test_blocks_have_as_many_points() -> None:
    X, _ = _scene()
    counts = np.bincount(spatial_blocks(X, across=3))
    assert len(counts) == 9
    assert np.ptp(counts) <= 1
    for places, across in ((X, 1), (X[:, :1], 2)):
        with pytest.raises(ValueError, match="blocks need x and y"):
            spatial_blocks(places, across)


@pytest.mark.parametrize(("given", "said"), [
    ({"model": "rmf"}, "unknown model 'rmf'"), ({"strategy": "best"}, "strategy is 'best'"),
    ({"degree": 99}, "option 'degree' does not accept 99"),
    ({"model": "rfm"}, "control"), ({"degree": 1, "strategy": "shrunken"}, "degree 2"),
    ({"model": "dlt3d", "strategy": "selected"}, "degree 2")])
def test_wrong_parameters_are_value_errors(given: dict[str, object], said: str) -> None:
    X, y = _scene()
    with pytest.raises(ValueError, match=said):
        SensorModelRegressor(**given).fit(X[:30], y[:30])


def _ebic(X: np.ndarray, y: np.ndarray, columns: tuple[int, ...]) -> float:
    from math import comb

    A = np.column_stack([np.ones(len(X)), X[:, columns]])
    rss = np.linalg.lstsq(A, y, rcond=None)[1].sum()
    return (len(X) * np.log(rss / len(X)) + len(columns) * np.log(len(X))
            + 2 * np.log(comb(X.shape[1], len(columns))))


@pytest.mark.parametrize("outputs", [1, 2])
def test_the_selector_finds_the_best_of_all_subsets(outputs: int) -> None:
    rng = np.random.default_rng(3)
    X = rng.normal(size=(40, 7)) + 5.0
    y = (X[:, [1, 4]] @ np.array([[1.0, 0.3], [-0.6, 0.5]]))[:, :outputs] \
        + rng.normal(0, 0.5, (40, outputs))
    best = min((columns for size in range(1, 8) for columns in combinations(range(7), size)),
               key=lambda columns: _ebic(X, y, columns))
    found = TermSelector().fit(X, y if outputs > 1 else y[:, 0])
    assert tuple(found.get_support(indices=True)) == best
    assert found.search_.objectives[0] == pytest.approx(_ebic(X, y, best))


def test_the_selector_in_a_pipeline() -> None:
    X, y = _scene()
    scaled = (X - X.mean(axis=0)) / X.std(axis=0)
    line = make_pipeline(PolynomialFeatures(2, include_bias=False), TermSelector(max_terms=5),
                         LinearRegression()).fit(scaled, y)
    assert 1 <= line[1].get_support().sum() <= 5
    assert line.score(scaled, y) > 0.999
    names = line[:2].get_feature_names_out(["x", "y", "z"])
    assert {"x", "y"} <= set(names)
    again = clone(line).fit(scaled, y)
    np.testing.assert_array_equal(again[1].support_, line[1].support_)
    with pytest.raises(ValueError, match="unknown solver 'no'"):
        TermSelector(solver="no").fit(X, y)
