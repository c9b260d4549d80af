"""The strategy auto: what it chooses, what it promises, and what it never looks at."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import termsel
from termsel.auto.auto import Auto
from termsel.auto.methods import METHODS
from termsel.auto.rule import advantage_in_words, requirement_in_words
from termsel.auto.selected import select_forward
from termsel.auto.shrunken import fit_average
from termsel.data.features import FeatureSet, Points
from termsel.data.fit_data import FitData
from termsel.data.monomials import evaluate_monomials, graded_exponents
from termsel.io.result_folder import read_result
from termsel.simulate import simulate_scene

CUBIC = graded_exponents(3, 3)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of `result`."""
    return tmp_path_factory.mktemp("auto")


@pytest.fixture(scope="module")
def result(folder: Path) -> termsel.Result:
    return termsel.run("rfm-terms", out=folder)


def scene(count: int, seed: int = 0, **more: object) -> FeatureSet:
    return simulate_scene("ikonos-hamedan", seed=seed, n_points=count, n_lines=0, **more)


def drawn(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Ground points, and image points of a known polynomial with noise."""
    rng = np.random.default_rng(seed)
    ground = rng.uniform(-1, 1, (n, 3))
    truth = rng.normal(size=(20, 2)) * np.array(
        [1000.0 if sum(e) < 2 else 5.0 if sum(e) == 2 else 0.3 for e in CUBIC])[:, None]
    return ground, evaluate_monomials(ground, CUBIC) @ truth + rng.normal(0, 0.5, (n, 2))


def frame_camera(n: int, seed: int = 1) -> FeatureSet:
    """An oblique aerial photograph, of which the DLT is the exact model."""
    rng = np.random.default_rng(seed)
    ground = rng.uniform(-1, 1, (n, 3)) * [1000, 800, 120]
    turn = np.radians(35)
    seen = (ground - [0, -1500, 2500]) @ np.array(
        [[1, 0, 0], [0, np.cos(turn), -np.sin(turn)], [0, np.sin(turn), np.cos(turn)]]).T
    image = np.column_stack([-seen[:, 1], seen[:, 0]]) / -seen[:, 2:] * 6000
    roles = ("control", "control", "check", "independent") * (n // 4)
    return FeatureSet(Points(tuple(f"P{i}" for i in range(n)),
                             image + rng.normal(0, 0.5, (n, 2)), ground, None, roles))


def test_auto_is_the_default_where_only_points_are_given(result: termsel.Result) -> None:
    assert result.strategy is not None
    assert result.strategy.name == "auto"
    names = [one.name for one in result.strategy.candidates]
    assert result.strategy.chosen in names
    assert {"affine", "dlt", "quadratic", "cubic", "selected", "regularised-quadratic",
            "regularised-cubic"} <= set(names)
    quadratic = next(b for b in result.baselines if b.name == "quadratic")
    assert result.rmse["independent"].total < quadratic.rmse["independent"].total
    # Check points are fitted to, and yet shown by themselves.
    assert result.strategy.fitted_to == ("control", "check")
    assert result.rmse["control"].n == result.data.counts.control == 24
    assert result.rmse["check"].n == result.data.counts.check == 24


def example() -> FeatureSet:
    """Control and check points of the embedded scene."""
    points = simulate_scene("ikonos-hamedan").points
    return FeatureSet(points.take(np.array(points.roles) != "independent"), crs="EPSG:4979")


def by_shrunken(one: str, other: str, judged: dict) -> float:
    """Return by how many standard errors the logarithms of squared errors of one are smaller."""
    gain = np.log(judged[other].held_out().squares) - np.log(judged[one].held_out().squares)
    return float(gain.mean() / gain.std(ddof=1) * np.sqrt(len(gain)))


@pytest.mark.parametrize(("features", "heights", "chosen"), [
    (scene(48), True, "regularised-quadratic"), (example(), True, "regularised-cubic"),
    (frame_camera(40), True, "dlt")])
def test_the_reason_states_the_figures_that_decided(
        features: FeatureSet, heights: bool, chosen: str) -> None:
    found = Auto().choose(FitData.of(features, heights))
    assert found is not None
    judged = {one.method.name: one for one in found.compared}
    assert found.method.name == chosen
    cubic = by_shrunken("regularised-cubic", "regularised-quadratic", judged)
    assert found.reason.startswith(
        "Regularised cubic predicts left-out points "
        f"{advantage_in_words(cubic, 'regularised quadratic')}{requirement_in_words(cubic, 1)}. ")
    against = "regularised-cubic" if cubic > 1 else "regularised-quadratic"
    rival, gain = max(((name, by_shrunken(name, against, judged)) for name in judged
                      if name in ("dlt", "rfm-2", "rfm-3", "selected")), key=lambda one: one[1])
    # A central projection needs one standard error where points call for an oblique view.
    asked = {"dlt": 1 if chosen == "dlt" else 2}.get(rival, 3)
    assert (gain > asked) == (chosen == "dlt")
    label = against.replace("regularised-", "regularised ")
    assert (f"predicts left-out points {advantage_in_words(gain, label)}"
            f"{requirement_in_words(gain, asked)}.") in found.reason
    least = min(judged, key=lambda name: judged[name].held_out_rmse)
    assert ("the regularised polynomials contain it" in found.reason) == (
        least in ("affine", "quadratic", "cubic"))


def test_an_advantage_says_whether_it_may_be_chance() -> None:
    """A surveyor asks why a model with a smaller figure was not taken."""
    assert advantage_in_words(0.19, "b") == "better than b, by 0.19 times the uncertainty of the " \
        "difference"
    assert advantage_in_words(-2.0, "b") == advantage_in_words(np.nan, "b") == "no better than b"
    assert requirement_in_words(0.19, 3) == ", which may be chance (more than 3 required)"
    assert requirement_in_words(3.1, 3) == ", more than chance explains (more than 3 required)"
    assert requirement_in_words(9.0, np.inf) == ", which so few points cannot tell from chance"
    assert requirement_in_words(-1.0, 3) == ""


def test_the_page_states_the_reason_of_the_choice(result: termsel.Result) -> None:
    assert result.strategy is not None
    assert result.strategy.reason in " ".join(result.summary(verbose=True).split())


def test_without_shrunken_polynomials_the_least_error_is_the_reason() -> None:
    features = simulate_scene("ikonos-hamedan", n_points=0, n_lines=5, wrong_lines=0)
    found = Auto().choose(FitData.of(features, True))
    assert found is not None
    assert found.chosen.held_out_rmse == min(one.held_out_rmse for one in found.compared)
    assert found.reason == "It has the smallest leave-one-out RMSE."


@pytest.mark.parametrize("asked", [
    {"solver": "ridge"}, {"criterion": "press", "generations": 1},
    {"model": "affine", "generations": 1}, {"generations": 1}, {"evaluations": 100},
    {"options": {"order": 1}, "evaluations": 100}, {"strategy": "as-asked", "evaluations": 100}])
def test_a_method_asked_for_runs_as_it_is(asked: dict) -> None:
    found = termsel.run("rfm-terms", **asked)
    assert found.strategy is None
    assert found.solver == asked.get("solver", "ga")
    assert found.reference in {row.name for row in found.baselines}


def test_options_of_the_data_leave_the_strategy() -> None:
    features = scene(20)
    other = termsel.run("rfm-terms", features=features, options={"roles": "random", "split": 3})
    assert other.strategy is not None
    given = dict(zip(features.points.ids, features.points.roles, strict=True))
    assert any(given[name] != role for role in ("control", "check", "independent")
               for name in getattr(other.data.roles, role))


@pytest.mark.parametrize(("problem", "more", "message"), [
    ("rfm-terms", {"solver": "ga"}, "chooses the method itself, so solver cannot be given"),
    ("rfm-terms", {"options": {"order": 2}}, "the option order cannot be given"),
    ("rfm-terms", {"seconds": 3}, "a budget cannot be given"),
    ("hybrid-2", {}, "not for the problem hybrid-2"),
    ("owdis-lines", {"options": {"max_features": 20}}, "the option max_features cannot be given")])
def test_auto_and_a_method_exclude_each_other(problem: str, more: dict, message: str) -> None:
    with pytest.raises(termsel.TermselError, match=message):
        termsel.run(problem, strategy="auto", **more)


def test_an_unknown_strategy_is_refused() -> None:
    with pytest.raises(termsel.TermselError, match="no strategy 'best'"):
        termsel.run("rfm-terms", strategy="best")


def test_one_independent_point_that_contradicts_is_told_in_the_singular() -> None:
    features = simulate_scene("ikonos-hamedan", roles=(24, 24, 1), n_lines=0)
    alone = (np.array(features.points.roles) == "independent")[:, None]
    other = termsel.run("rfm-terms", features=features.with_(
        points=replace(features.points, image=features.points.image + 50.0 * alone)))
    assert other.notes[0].startswith("The independent check point contradicts control and check. "
                                     "Either it was measured differently")


@pytest.mark.slow
def test_independent_points_are_touched_once(result: termsel.Result) -> None:
    features = simulate_scene("ikonos-hamedan")
    independent = np.array(features.points.roles) == "independent"
    moved = features.points.image + 7.0 * independent[:, None]
    other = termsel.run("rfm-terms", features=features.with_(
        points=replace(features.points, image=moved)), source=result.data.source)
    first, second = result.to_dict(), other.to_dict()
    assert first["rmse"].pop("independent") != second["rmse"].pop("independent")
    note, = other.notes
    assert note.startswith("26 of 26 independent check points contradict control and check.")
    for record in (first, second):
        for changing in ("judgement", "seconds", "notes", "accuracy", "final"):
            record.pop(changing)
        record["data"].pop("sha256")
        for one in record["baselines"]:
            one["rmse"].pop("independent")
    assert first == second


def test_what_a_search_does_never_depends_on_independent_points() -> None:
    features = scene(48)
    independent = np.array(features.points.roles) == "independent"
    moved = features.points.image + 7.0 * independent[:, None]
    other = features.with_(points=replace(features.points, image=moved))
    first, second = (termsel.run("rfm-terms", features=one, generations=2).to_dict()
                     for one in (features, other))
    for key in ("selection", "coefficients", "objectives", "options"):
        assert first[key] == second[key]
    for one, two in zip(first["baselines"], second["baselines"], strict=True):
        assert one["predicted"] == two["predicted"]
        assert one["rmse"]["check"] == two["rmse"]["check"]


def test_leave_one_out_is_that_of_the_whole_procedure() -> None:
    ground, image = drawn(15)
    found = fit_average(ground, image, CUBIC)
    assert found is not None
    for i in range(15):
        others = np.arange(15) != i
        without = fit_average(ground[others], image[others], CUBIC)
        assert without is not None
        error = image[i] - evaluate_monomials(ground[i:i + 1], CUBIC)[0] @ without.coefficients
        np.testing.assert_allclose(found.errors[i], error, rtol=1e-3, atol=1e-3)


def test_with_many_points_the_average_is_as_good_as_least_squares() -> None:
    ground, image = drawn(400)
    found = fit_average(ground, image, CUBIC)
    assert found is not None
    free = np.linalg.lstsq(evaluate_monomials(ground, CUBIC), image)[0]
    places = np.random.default_rng(5).uniform(-1, 1, (100, 3))
    difference = evaluate_monomials(places, CUBIC) @ (found.coefficients - free)
    assert np.sqrt((difference**2).mean()) < 0.1
    assert 20 < found.effective < 40


def test_units_do_not_matter_to_the_average() -> None:
    ground, image = drawn(20)
    one, other = fit_average(ground, image, CUBIC), fit_average(ground, 1e-4 * image + 3.0, CUBIC)
    assert one is not None
    assert other is not None
    np.testing.assert_allclose(other.errors, 1e-4 * one.errors, rtol=1e-4, atol=1e-9)


def test_a_measurement_without_weight_does_not_matter() -> None:
    ground, image = drawn(20)
    wrong = image.copy()
    wrong[3] += 50.0
    weights = np.ones((20, 2))
    weights[3] = 1e-4
    one, other = (fit_average(ground, values, CUBIC, weights) for values in (image, wrong))
    assert one is not None
    assert other is not None
    difference = evaluate_monomials(ground, CUBIC) @ (one.coefficients - other.coefficients)
    assert np.abs(difference).max() < 0.5


def test_exact_data_are_fitted_exactly() -> None:
    ground, _ = drawn(60)
    truth = np.random.default_rng(2).normal(size=(20, 2))
    found = fit_average(ground, evaluate_monomials(ground, CUBIC) @ truth, CUBIC)
    assert found is not None
    np.testing.assert_allclose(found.coefficients, truth, atol=1e-5)


def test_too_few_points_give_no_average() -> None:
    ground, image = drawn(5)
    assert fit_average(ground, image, CUBIC) is None


@pytest.mark.parametrize("n", [40, 120])  # of more than 100, folds of two are left out
def test_forward_selection_finds_the_terms_and_leaves_out_honestly(n: int) -> None:
    rng = np.random.default_rng(4)
    ground = rng.uniform(-1, 1, (n, 3))
    columns = evaluate_monomials(ground, CUBIC)
    affine = np.array([sum(e) < 2 for e in CUBIC])
    wanted = affine.copy()
    wanted[[5, 12]] = True
    target = columns[:, wanted] @ np.array([3.0, 4.0, 5.0, 6.0, 2.0, -2.0])
    target += rng.normal(0, 0.05, n)
    both = select_forward(np.stack([columns, columns]), np.stack([target, columns[:, 7]]), affine)
    assert both is not None
    found, other = both
    np.testing.assert_array_equal(np.flatnonzero(other.terms & ~affine), [7])
    np.testing.assert_array_equal(found.terms, wanted)
    for i in (0, 17):
        others = np.arange(n) % 100 != i
        alone = select_forward(columns[None, others], target[None, others], affine)
        assert alone is not None
        again, = alone
        x = np.linalg.lstsq(columns[others][:, again.terms], target[others])[0]
        assert found.errors[i] == pytest.approx(target[i] - columns[i, again.terms] @ x, abs=1e-9)


@pytest.mark.slow
def test_the_dlt_is_chosen_for_a_photograph() -> None:
    found = termsel.run("rfm-terms", features=frame_camera(40))
    assert found.strategy is not None
    assert found.strategy.chosen == "dlt"
    assert found.model == "dlt3d"


@pytest.mark.slow
def test_predictions_come_true() -> None:
    ratios = []
    for seed in range(5):
        features = scene(100, seed)
        order = np.random.default_rng(seed).permutation(100)
        mine = FeatureSet(features.points.take(order[:40]))
        data = FitData.of(mine, True)
        choice = Auto().choose(data)
        errors = Auto().repeated(data)
        assert choice is not None
        assert errors is not None
        found = choice.chosen.errors(features.points.take(order[40:]))
        ratios.append(np.sqrt((found**2).sum(axis=1).mean() / (errors**2).sum(axis=1).mean()))
    assert 0.8 < np.median(ratios) < 1.25


def test_the_full_rfm_is_chosen_where_it_is_the_truth_and_can_be_named() -> None:
    rng = np.random.default_rng(0)
    ground = rng.uniform(-1, 1, (90, 3))
    columns = evaluate_monomials(ground, CUBIC)
    numerators = rng.normal(size=(20, 2)) * np.array(
        [1000.0 if sum(e) < 2 else 20.0 for e in CUBIC])[:, None]
    denominators = rng.uniform(-0.03, 0.03, (20, 2))
    denominators[0] = 1.0
    image = (columns @ numerators) / (columns @ denominators) + rng.normal(0, 0.01, (90, 2))
    points = Points(tuple(f"P{i}" for i in range(90)), image, ground)
    choice = Auto().choose(FitData.of(FeatureSet(points), True))
    assert choice is not None
    assert choice.method.name == "rfm-3"
    assert {one.method.name for one in choice.compared} <= {method.name for method in METHODS}


def test_plane_points_get_plane_models() -> None:
    points = simulate_scene("ikonos-hamedan").points
    flat = points.ground.copy()
    flat[:, 2] = np.nan
    found = termsel.run("poly-terms", features=FeatureSet(replace(points, ground=flat)))
    assert found.strategy is not None
    assert "projective" in {one.name for one in found.strategy.candidates}
    assert not found.fit.model.uses_height


@pytest.mark.slow
def test_check_points_are_not_needed() -> None:
    points = scene(30).points
    roles = tuple("control" if role == "check" else role for role in points.roles)
    found = termsel.run("rfm-terms", features=FeatureSet(replace(points, roles=roles)))
    assert found.strategy is not None
    assert found.rmse["check"] is None


def test_too_few_points_are_said_to_be() -> None:
    points = simulate_scene("ikonos-hamedan").points.take(np.arange(6))
    roles = ("control",) * 4 + ("independent",) * 2
    lying = points.ground.copy()
    lying[:4, :2] = lying[0, :2] + np.arange(4)[:, None] * [0.01, 0.005]
    with pytest.raises(termsel.TermselError, match="on one straight line"):
        termsel.run("rfm-terms", features=FeatureSet(replace(points, roles=roles, ground=lying)))
    result = termsel.run("rfm-terms", features=FeatureSet(replace(points, roles=roles)))
    assert any("nothing distinguishes what a height does" in note for note in result.notes)


def test_the_result_is_whole_in_its_folder(result: termsel.Result, folder: Path) -> None:
    found, again = result, read_result(folder)
    assert again.strategy == found.strategy
    assert again.to_dict() == found.to_dict()
    np.testing.assert_allclose(again.project(found.features.points.ground),
                               found.project(found.features.points.ground))
    used = {r.role for r in found.residuals if r.used}
    assert used == {"control", "check"} == {r.role for r in again.residuals if r.used}
    text = (folder / "summary.txt").read_text()
    assert "strategy auto" in text
    assert "predicted by cross-validation" in text


def test_every_result_has_the_baselines(result: termsel.Result) -> None:
    searched = termsel.run("owdis-lines", generations=1, options={"polish": False})
    for found in (result, searched):
        rows = {b.name: b for b in found.baselines}
        assert {"affine", "dlt", "quadratic", "cubic", "rfm-2", "rfm-3", "ridge"} <= set(rows)
        assert all(b.rmse["independent"] or not b.determined for b in found.baselines)
        text = found.to_dict()["baselines"]
        assert [one["name"] for one in text] == list(rows)


def test_heights_on_a_plane_are_no_heights() -> None:
    points = simulate_scene("ikonos-hamedan").points
    tilted = points.ground.copy()
    tilted[:, 2] = 1800 + 500 * (tilted[:, 0] - 48.5) - 300 * (tilted[:, 1] - 34.8)
    found = termsel.run("rfm-terms", features=FeatureSet(replace(points, ground=tilted)))
    assert found.strategy is not None
    assert not found.fit.model.uses_height
