"""The estimators for scikit-learn: its own checks, a grid search by blocks, a pipeline."""

# mypy: disable-error-code="arg-type,no-any-return"
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
from termsel_sklearn import (
    EXPECTED_FAILED_CHECKS,
    SensorModelRegressor,
    TermSelector,
    regressor_method,
    spatial_blocks,
)


@pytest.mark.slow
@pytest.mark.parametrize(("estimator", "excused"), [
    (SensorModelRegressor(degree=1), set(EXPECTED_FAILED_CHECKS)), (TermSelector(), set())],
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
        SensorModelRegressor(), {"degree": [2, 3], "strategy": ["least-squares", "regularised"]},
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
    ({"model": "rfm"}, "control"), ({"degree": 1, "strategy": "regularised"}, "degree 2"),
    ({"model": "dlt3d", "strategy": "selected"}, "degree 2")])
def test_wrong_parameters_are_value_errors(given: dict[str, object], said: str) -> None:
    X, y = _scene()
    with pytest.raises(ValueError, match=said):
        SensorModelRegressor(**given).fit(X[:30], y[:30])


def test_named_columns_are_not_taken_in_another_order() -> None:
    pandas = pytest.importorskip("pandas")
    X, y = _scene()
    ground = pandas.DataFrame(X, columns=["x", "y", "z"])
    image = pandas.DataFrame(y, columns=["line", "sample"])
    fitted = SensorModelRegressor(degree=1).fit(ground, image)
    assert fitted.score(ground, image) > 0.99
    # Other names say nothing, and one image coordinate has no order.
    SensorModelRegressor(degree=1).fit(ground.set_axis(["a", "x", "b"], axis=1), image[["sample"]])
    for wrong, of_image in ((ground[["z", "y", "x"]], image), (ground[["y", "x"]], image),
                            (ground[["x", "z"]], image), (ground, image[["sample", "line"]])):
        with pytest.raises(ValueError, match=r"expected \['(x|line)', .* Give TABLE\["):
            SensorModelRegressor(degree=1).fit(wrong, of_image)


@pytest.mark.parametrize("model", ["polynomial", "poly3d"])
def test_options_that_are_no_dict_are_told(model: str) -> None:
    X, y = _scene()
    with pytest.raises(ValueError, match="options is 'degree=2', expected a dict"):
        SensorModelRegressor(model=model, options="degree=2").fit(X, y)


def _ebic(X: np.ndarray, y: np.ndarray, columns: tuple[int, ...]) -> float:
    from math import comb

    A = np.column_stack([np.ones(len(X)), X[:, columns]])
    y = y / y.std(axis=0)
    rss = np.linalg.lstsq(A, y, rcond=None)[1].sum()
    return (len(X) * np.log(rss / len(X)) + len(columns) * np.log(len(X))
            + 2 * np.log(comb(X.shape[1], min(len(columns), X.shape[1] // 2))))


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


@pytest.mark.parametrize(("n", "k"), [(40, 5), (100, 5), (20, 6), (40, 9)])
def test_columns_of_noise_among_few_are_left_out(n: int, k: int) -> None:
    """There is one selection of all columns: it must not be the cheapest for that."""
    sizes = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        X = rng.normal(size=(n, k))
        y = X[:, :3] @ np.array([1.0, -0.7, 0.5]) + rng.normal(0, 0.5, n)
        sizes.append(int(TermSelector(solver="exact").fit(X, y).get_support().sum()))
    assert sizes.count(k) <= 1
    assert sizes.count(3) >= 8


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


def _columns(seed: int = 3, n: int = 40, k: int = 7) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(n, k)) + 5.0
    return X, X[:, 1] - 0.6 * X[:, 4] + rng.normal(0, 0.5, n)


def test_exact_proves_the_selection_that_a_search_finds() -> None:
    for seed in range(4):
        X, y = _columns(seed)
        exact, swap = (TermSelector(solver=solver).fit(X, y) for solver in ("exact", "swap"))
        best = min((columns for size in range(1, 8) for columns in combinations(range(7), size)),
                   key=lambda columns: _ebic(X, y, columns))
        assert tuple(exact.get_support(indices=True)) == best
        assert exact.search_.objectives[0] == pytest.approx(swap.search_.objectives[0])


@pytest.mark.parametrize("solver", ["stepwise", "lasso", "t-test", "nested-regression"])
def test_regressions_select_columns(solver: str) -> None:
    pytest.importorskip("termsel_optimisers")
    X, y = _columns()
    assert set(TermSelector(solver=solver).fit(X, y).get_support(indices=True)) >= {1, 4}


@pytest.mark.slow_cases("0.0125-swap", "0.1-swap", "10000.0-swap", "4.0-swap")
@pytest.mark.parametrize("solver", ["swap", "exact", "stepwise"])
@pytest.mark.parametrize("scale", [1e-9, 1 / 80, 0.1, 4.0, 1e4])
def test_only_the_ratio_of_weights_counts(solver: str, scale: float) -> None:
    pytest.importorskip("termsel_optimisers")
    rng = np.random.default_rng(1)
    X = rng.normal(size=(80, 20))
    deviation = rng.choice([0.2, 2.0], size=80)
    y = 3.0 + 2.0 * X[:, 2] - X[:, 7] + 0.5 * X[:, 11] + deviation * rng.normal(size=80)
    weights = deviation**-2
    weights[:5] = 0.0
    scaled = TermSelector(solver).fit(X, y, sample_weight=scale * weights)
    # A row of weight 0 is none.
    without = TermSelector(solver).fit(X[5:], y[5:], sample_weight=weights[5:])
    assert scaled.support_.tolist() == without.support_.tolist()
    assert {2, 7, 11} <= set(scaled.get_support(indices=True))
    assert scaled.search_.objectives == pytest.approx(without.search_.objectives)
    equal = TermSelector(solver).fit(X, y, sample_weight=np.full(80, scale))
    assert equal.search_.objectives == pytest.approx(TermSelector(solver).fit(X, y)
                                                     .search_.objectives)


@pytest.mark.parametrize("units", [[1.0, 1e9], [1e-9, 1.0], [1e6, 1e-6]])
def test_targets_of_any_unit_count_alike(units: list[float]) -> None:
    rng = np.random.default_rng(2)
    X = rng.normal(size=(80, 20))
    y = X[:, [2, 15]] + X[:, [7, 15]] + rng.normal(0.0, 0.3, (80, 2))
    # A target that is constant has nothing to explain.
    y = np.column_stack([y * units, np.full(80, 0.1)])
    found = TermSelector().fit(X, y)
    assert found.get_support(indices=True).tolist() == [2, 7, 15]


@pytest.mark.parametrize(("y", "most", "said"), [
    (np.full(40, 0.1), None, "^y is constant"), (np.full((40, 2), [3.0, 1e9]), None, "^y is const"),
    (np.arange(40.0), 0, "^max_terms is 0: give a whole number of at least 1"),
    (np.arange(40.0), -1, "^max_terms is -1"), (np.arange(40.0), 2.5, "^max_terms is 2.5"),
    (np.arange(40.0), "3", "^max_terms is '3'")])
def test_the_selector_says_what_it_cannot_use(y: np.ndarray, most: object, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        TermSelector(max_terms=most).fit(_columns()[0], y)


def test_weights_count_as_repeated_rows() -> None:
    ground, image = _scene()
    times = np.random.default_rng(6).integers(0, 4, len(ground))
    one, other = (SensorModelRegressor(degree=2).fit(*given) for given in (
        (ground, image, times),
        (np.repeat(ground, times, axis=0), np.repeat(image, times, axis=0))))
    np.testing.assert_allclose(one.predict(ground), other.predict(ground), rtol=1e-8)
    for wrong, said in ((-times, "has negative values"), (0 * times, "non-zero")):
        with pytest.raises(ValueError, match=said):
            TermSelector().fit(ground, image, wrong)


def test_options_are_parameters() -> None:
    X, y = _scene()
    model = SensorModelRegressor("rfm").set_params(order=1)
    assert model.get_params()["order"] == 1
    assert model.fit(X, y).fit_.model.options["order"] == 1
    assert clone(model).get_params() == model.get_params()
    search = GridSearchCV(SensorModelRegressor("rfm"), {"order": [1, 2]},
                          cv=GroupKFold(3)).fit(X, y, groups=spatial_blocks(X))
    assert search.best_params_["order"] in (1, 2)
    selector = TermSelector("ga").set_params(population=20, generations=3)
    assert (selector.options, selector.generations) == ({"population": 20}, 3)
    selector.fit(*_columns())
    with pytest.raises(ValueError, match=r"Invalid parameter 'populations'.*population"):
        TermSelector("ga").set_params(populations=20)


@pytest.mark.parametrize("solver", ["swap", "exact", "ga"])
@pytest.mark.parametrize("units", [
    [1e12, 1, 1, 1, 1, 1, 1, 1], [1, 1e-14, 1, 1, 1e14, 1, 1, 1],
    [1e-100, 1e100, 1, 1, 1, 1, 1, 1]])
def test_the_selection_does_not_depend_on_units_of_columns(
        solver: str, units: list[float]) -> None:
    X = np.random.default_rng(3).normal(size=(80, 8))
    X[:, 6] = 0.1  # a constant in any unit
    y = 2.0 * X[:, 1] - X[:, 4] + np.random.default_rng(4).normal(0.0, 0.1, 80)
    selected = TermSelector(solver).fit(X * units, y).get_support(indices=True).tolist()
    assert selected == [1, 4]
    # A column next to a large offset varies all the same.
    shifted = TermSelector(solver).fit(X * units + 1e6 * np.array(units), y)
    assert shifted.get_support(indices=True).tolist() == [1, 4]


def test_classes_and_instances_are_taken_as_names_are() -> None:
    X, y = _scene()
    by_name, by_class, by_instance = (
        SensorModelRegressor(model, options=options).fit(X, y).predict(X) for model, options in (
            ("rfm", {"order": 1}), (termsel.RationalFunctions, {"order": 1}),
            (termsel.RationalFunctions(order=1), None)))
    np.testing.assert_array_equal(by_name, by_class)
    np.testing.assert_array_equal(by_name, by_instance)
    X, y = _columns()
    found = [TermSelector(solver, options=options).fit(X, y).support_ for solver, options in (
        ("ga", {"population": 20}), (termsel.GeneticAlgorithm, {"population": 20}),
        (termsel.GeneticAlgorithm(population=20), None))]
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_array_equal(found[0], found[2])
    with pytest.raises(ValueError, match="every column of X is constant"):
        TermSelector().fit(np.ones((20, 3)), np.arange(20.0))


def test_slips_of_users_of_scikit_learn_are_explained() -> None:
    points = termsel.simulate_scene("ikonos-hamedan", n_points=20, n_lines=0).points
    fitted = SensorModelRegressor(degree=1).fit(points.ground, points.image)
    with pytest.raises(AttributeError, match=r"They are fit_\.coefficients"):
        _ = fitted.coef_
    with pytest.raises(AttributeError, match="It is not fitted yet"):
        _ = SensorModelRegressor().fit_
    with pytest.raises(AttributeError, match="A selector predicts nothing"):
        _ = TermSelector().predict
    with pytest.raises(ValueError, match="Valid are: degree, model, options, strategy\\."):
        SensorModelRegressor().set_params(degre=2)
    with pytest.raises(ValueError, match="without PolynomialFeatures"):
        SensorModelRegressor().fit(np.ones((9, 10)), np.ones((9, 2)))
    with pytest.raises(ValueError, match="strategy='ridge'"):
        SensorModelRegressor(model="ridge").fit(points.ground, points.image)
    with pytest.raises(TypeError, match="across is 'five'"):
        spatial_blocks(points.ground, "five")
    with pytest.raises(termsel.TermselError, match=r"regressor_method\(LinearRegression\(\)\)"):
        regressor_method(LinearRegression)


def test_places_far_outside_the_control_are_told() -> None:
    points = termsel.simulate_scene("ikonos-hamedan", n_points=20, n_lines=0).points
    fitted = SensorModelRegressor(degree=1).fit(points.ground, points.image)
    fitted.predict(points.ground)
    with pytest.warns(UserWarning, match="Their x and y look exchanged"):
        fitted.predict(points.ground[:, [1, 0, 2]])
