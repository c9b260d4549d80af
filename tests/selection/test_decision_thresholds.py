"""Criteria, candidates, problems and solvers on either side of the numbers they decide by."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

import termsel
from termsel.auto.auto import Auto
from termsel.auto.compare import compare
from termsel.auto.methods import Structure, named
from termsel.auto.rule import validated
from termsel.auto.selected import select_forward
from termsel.auto.shrunken import fit_average
from termsel.data.coordinates.places import spatial_order
from termsel.data.features import BoolArray, FeatureSet, FloatArray, Points, empty_points
from termsel.data.fit_data import FitData
from termsel.data.monomials import evaluate_monomials, graded_exponents
from termsel.data.roles import observations_by_role
from termsel.fitting.fit import HeldOut
from termsel.fitting.method import Method
from termsel.fitting.population import Fits
from termsel.models.projective import DLT3D
from termsel.results.result import checksum_of_features
from termsel.runs.recommend import with_recommended_member
from termsel.runs.request import request_of
from termsel.runs.task import observe, prepare
from termsel.selection.criteria import Ebic, KFold
from termsel.selection.problems.base import Evaluation, Problem, Selection
from termsel.selection.problems.genome import Genome
from termsel.selection.problems.segments import Bits
from termsel.selection.solvers.base import Generation
from termsel.selection.solvers.budget import Budget
from termsel.selection.solvers.ledger import Ledger
from termsel.selection.solvers.proofs.proof import limits_of
from termsel.selection.solvers.refinement import POLISH_SHARE
from termsel.selection.solvers.search import SearchResult, search

CUBIC = graded_exponents(3, 3)


def places(n: int, seed: int = 0) -> FloatArray:
    """Ground in a cube, its corners first, so that the scaling of the points is known."""
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    return np.concatenate([corners, np.random.default_rng(seed).uniform(-1, 1, (n - 8, 3))])


def set_of(ground: FloatArray, image: FloatArray, roles: tuple[str, ...] = ()) -> FeatureSet:
    return FeatureSet(Points(tuple(f"P{i}" for i in range(len(ground))), image, ground, None,
                             roles))


def photograph(slope: float, n: int = 24) -> FeatureSet:
    """Exact points of a DLT whose denominator falls to 1 - slope at the edge of the control."""
    ground = places(n)
    x, y, z = ground.T
    below = 1 - slope * x
    return set_of(ground, 1000 * np.column_stack([(y + 0.1 * z) / below,
                                                  (x + 0.2 * z - 0.1 * y) / below]))


def bent(slope: float, n: int = 60) -> FeatureSet:
    """Exact points of a second-order RFM, no view: its denominator falls to 1 - slope on two sides.
    """
    ground = places(n)
    x, y, z = ground.T
    below = 1 - slope * x**2
    return set_of(ground, 1000 * np.column_stack([(y + 0.1 * z) / below, (x + 0.2 * z) / below]))


@pytest.mark.parametrize(("slope", "kept"), [(0.38, True), (0.42, False)])
def test_a_pole_in_a_box_half_as_wide_again_excludes_a_candidate(slope: float, kept: bool) -> None:
    control, rfm = bent(slope), named("rfm-2")
    assert rfm is not None
    assert rfm.fit(FitData.of(control)).determined
    assert (validated(rfm, FitData.of(control)) is not None) == kept


@pytest.mark.parametrize("slope", [0.5, 0.7, 0.95])
def test_a_pole_below_the_camera_excludes_no_candidate(slope: float) -> None:
    control, dlt = photograph(slope), named("dlt")
    assert dlt is not None
    assert validated(dlt, FitData.of(control)) is not None


def gain_of(standard_errors: float, n: int = 40) -> FloatArray:
    """Factors of squared errors whose logarithms fall by so many standard errors."""
    noise = np.random.default_rng(1).normal(size=n)
    noise = (noise - noise.mean()) / noise.std(ddof=1)
    return np.exp(-0.1 * (standard_errors / np.sqrt(n) + noise))


@pytest.mark.parametrize(("noise", "cubic", "dlt", "chosen"), [
    (20.0, 0.9, -9.0, "regularised-quadratic"), (20.0, 1.02, -9.0, "regularised-cubic"),
    (20.0, 0.0, 1.9, "regularised-quadratic"), (20.0, 0.0, 2.1, "dlt"),
    (0.0, 0.0, 0.9, "regularised-quadratic"), (0.0, 0.0, 1.02, "dlt")])
def test_what_must_be_better_by_how_much(noise: float, cubic: float, dlt: float, chosen: str,
                                         monkeypatch: pytest.MonkeyPatch) -> None:
    # From nearly above, as an oblique view asks less of the DLT. With noise that is not much less
    # than what an affine transformation leaves, the points do not call for a camera near by.
    control = photograph(0.1, 40)
    image = control.points.image + np.random.default_rng(4).normal(0, noise, (40, 2))
    control = control.with_(points=replace(control.points, image=image))
    one = np.random.default_rng(2).uniform(1, 2, 40)
    squares = {"regularised-quadratic": one, "regularised-cubic": one * gain_of(cubic),
               "dlt": one * gain_of(dlt), "quadratic": 0.1 * one}
    # The quadratic one is contained in the shrunken one, so that it cannot win.
    for kind in (Method, Structure):
        monkeypatch.setattr(kind, "tried", lambda method, _: method.name in squares)
    fit = Structure.fit
    monkeypatch.setattr(Structure, "fit", lambda method, data: replace(
        fit(method, data), stored_held_out=HeldOut(squares[method.name])))
    found = Auto().choose(FitData.of(control, True))
    assert found is not None
    assert found.method.name == chosen
    assert ("by 1.02 times the uncertainty" in found.reason) == (1.02 in (cubic, dlt))


@pytest.mark.slow
def test_every_point_is_in_one_fold_and_predicted_by_the_others() -> None:
    rng = np.random.default_rng(3)
    ground = places(23)
    control = set_of(ground, 100 * ground[:, :2] + rng.normal(0, 1, (23, 2)))
    errors = Auto().repeated(FitData.of(control, True))
    assert errors is not None
    order = spatial_order(ground[:, :2])
    for out in ([order[0], order[20]], [order[2], order[22]], [order[3]]):
        others = ~np.isin(np.arange(23), out)
        choice = Auto().choose(FitData.of(control.with_(points=control.points.take(others)), True))
        assert choice is not None
        np.testing.assert_allclose(
            errors[out], choice.chosen.errors(control.points.take(out)), rtol=1e-9)


def test_forward_selection_keeps_a_third_of_the_equations() -> None:
    ground = places(13)
    columns = evaluate_monomials(ground, CUBIC)
    affine = np.array([sum(e) < 2 for e in CUBIC])
    target = columns @ np.random.default_rng(4).normal(size=20)
    columns, target = columns[None], target[None]
    found = select_forward(columns, target, affine)
    assert found is not None
    assert found[0].terms.sum() <= 2 * 12 // 3
    assert select_forward(columns[:, :6], target[:, :6], affine) is None  # 3 of 5 are no 4
    assert select_forward(columns[:, :8], target[:, :8], affine) is not None


def test_errors_of_weighted_points_are_those_of_the_others() -> None:
    rng = np.random.default_rng(5)
    ground = places(24)
    image = evaluate_monomials(ground, CUBIC)[:, 1:3] * 100 + rng.normal(0, 1, (24, 2))
    weights = np.ones((24, 2))
    weights[[9, 15]] = 0.25
    found = fit_average(ground, image, CUBIC, weights)
    assert found is not None
    for out in (9, 10, 15):
        others = np.arange(24) != out
        rest = fit_average(ground[others], image[others], CUBIC, weights[others])
        assert rest is not None
        error = image[out] - evaluate_monomials(ground[[out]], CUBIC)[0] @ rest.coefficients
        np.testing.assert_allclose(found.errors[out], error, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize(("n", "determined"), [(19, False), (20, True)])
def test_a_baseline_without_redundancy_has_no_figures(n: int, determined: bool) -> None:
    rng = np.random.default_rng(6)
    ground = places(n)
    image = 1000 * ground[:, :2] + 100 * ground[:, [2, 2]] + rng.normal(0, 1, (n, 2))
    observations = observations_by_role(set_of(ground, image, ("control",) * n))
    baselines = compare(observations, Auto()).baselines(observations)
    baseline = next(one for one in baselines if one.name == "rfm-2")
    assert baseline.n_terms == 38
    assert baseline.determined == determined
    assert (baseline.rmse["control"] is not None) == determined


def test_ebic_keeps_a_third_of_the_equations() -> None:
    rss, k, one = np.ones(4), np.array([1, 20, 21, 30]), np.ones(4, dtype=np.intp)
    usual = Ebic()._criterion_of_system(rss, 30, k, 5, one)
    assert np.isfinite(usual).tolist() == [True, True, False, False]
    nearly_all = np.array([1, 28, 29, 30])
    kept = Ebic(min_redundancy=1)._criterion_of_system(rss, 30, nearly_all, 5, one)
    assert np.isfinite(kept).tolist() == [True, True, True, False]


def test_the_same_folds_again_change_no_figure() -> None:
    figures = []
    for repeats in (1, 3):
        task = prepare("rfm-terms", criterion="kfold", model="poly3d",
                       options={"folds": 1000, "repeats": repeats, "degree": 2})
        genes = np.ones((1, task.problem.genome.size), dtype=bool)
        assert isinstance(task.criterion, KFold)
        figures.append(task.problem.evaluate(genes).objectives[0, 0])
    assert figures[1] == pytest.approx(figures[0], rel=1e-12)


@pytest.mark.parametrize(("below", "counts"), [(0.11, True), (0.09, False), (-0.5, False)])
def test_errors_near_a_pole_are_infinite(below: float, counts: bool) -> None:
    model = DLT3D()
    coefficients = np.zeros((1, len(model.terms)))
    coefficients[0, model.terms.index("den:X")] = below - 1.0
    points = Points(("A", "B"), np.zeros((2, 2)), np.array([(1.0, 0.0, 0.0), (0.0, 1.0, 0.0)]))
    fits = Fits(model, points, empty_points(), 1.0, np.ones((1, 11), dtype=bool), coefficients)
    assert np.isfinite(fits.held_out(coefficients, np.arange(2))).tolist() == [[counts, True]]


def test_the_share_of_a_budget_is_that_of_what_is_spent_first() -> None:
    task = prepare("poly-terms", solver="random", options={"population": 80})
    ledger = Ledger(task.problem)
    generation = next(task.solver.generations(ledger, np.random.default_rng(0)))
    now = time.perf_counter()
    fifth = Generation(5, generation.genes, generation.evaluation)
    assert ledger.count == 80
    assert Budget(10, 100, None, now).share(fifth, ledger) == 0.8
    assert Budget(6, 1000, 1e6, now).share(fifth, ledger) == pytest.approx(5 / 6)
    assert Budget(4, 1000, None, now).share(fifth, ledger) == 1.0
    assert Budget(None, None, None, now).share(fifth, ledger) is None


@pytest.mark.slow
def test_local_refinement_spends_its_share_and_the_hits_are_counted_with_it() -> None:
    task = prepare("rfm-terms", solver="ga")
    found = search(task.problem, task.solver, generations=9, polish=True)
    assert found.polish is not None
    before = found.evaluations - found.polish.evaluations
    assert before == 200 + 9 * 198
    assert found.polish.evaluations >= POLISH_SHARE * before
    small = prepare("poly-terms", solver="ga", options={"degree": 3})
    found = search(small.problem, small.solver, generations=9, polish=True)
    assert found.polish is not None  # its climbs are short, so that it ends near its share
    before = found.evaluations - found.polish.evaluations
    assert POLISH_SHARE * before <= found.polish.evaluations < (POLISH_SHARE + 0.5) * before
    result = termsel.run("poly-terms", evaluations=500)
    assert result.evaluations == 500
    assert result.polish is not None
    assert result.polish.evaluations == 375
    assert result.hit_rate == result.lookups / 500


def test_a_proof_stops_one_short_of_the_equations() -> None:
    points = termsel.simulate_scene("irs1c-mashad").points.take(np.arange(12))
    features = FeatureSet(replace(points, roles=("control",) * 9 + ("check",) * 3),
                          crs="EPSG:4979")
    task = prepare("poly-terms", solver="exact", features=features,
                   options={"degree": 4, "max_share": 1.0})
    for part in task.problem.parts():
        assert len(part.system.design) == 9
        assert len(part.genes) == 15
        assert limits_of(task.problem, part, None) == (0, 8)
        assert limits_of(task.problem, part, 3) == (0, 3)


def test_checksums_of_features_cover_roles_and_deviations() -> None:
    features = photograph(0.2, 9)
    sums = {checksum_of_features(one) for one in (
        features, features.with_(points=replace(features.points, roles=("check",) * 9)),
        features.with_(points=replace(features.points, sigma=np.ones((9, 2)))),
        replace(features, crs="EPSG:4979"))}
    assert len(sums) == 4
    lines = termsel.simulate_scene("ikonos-hamedan", n_lines=6).lines
    sums = {checksum_of_features(features.with_(lines=replace(lines, sigma=sigma)))
            for sigma in (None, np.full(6, 0.5), np.full(6, 1.0))}
    assert len(sums) == 3


def test_errors_of_points_without_noise_are_rounding() -> None:
    control, affine = photograph(0.0), named("affine")
    assert affine is not None
    fitted = validated(affine, FitData.of(control))
    assert fitted is not None
    assert fitted.held_out_rmse < 1e-6


class Listed(Problem):
    """A problem of two objectives with a value of each for every number of genes."""

    def __init__(self, first: list[float], second: list[float]) -> None:
        self.genome = Genome([Bits("terms", tuple(map(str, range(len(first)))))])
        self.objectives = ("rmse", "size")
        self.values = np.column_stack([first, second])

    def evaluate(self, genes: BoolArray) -> Evaluation:
        return Evaluation(self.values[genes.sum(axis=1) - 1], np.zeros(len(genes)))

    def decode(self, genes: BoolArray) -> Selection:
        raise NotImplementedError

    def found(self) -> SearchResult:
        n = self.genome.size
        front = tuple(np.arange(n) < size for size in range(1, n + 1))
        return SearchResult(front[0], self.values[0], 0.0, 1, n, 1, 0, 0.0, False, front=front)


def recommended_size(rule: str, first: list[float], second: list[float], n_check: int = 25) -> int:
    task = prepare("rfm-terms", criterion="check-rmse")
    options = {**task.request.options, "problem": {"recommend": rule}}
    ruled = replace(task, narrowed=Listed(first, second),
                    request=replace(task.request, options=options),
                    observations=replace(task.observations,
                                         check=photograph(0.0, n_check).points))
    return int(with_recommended_member(ruled, ruled.problem.found()).genes.sum())  # type: ignore[attr-defined]


@pytest.mark.parametrize(("value", "n_check", "size"), [
    (1.099, 25, 2), (1.101, 25, 3), (1.049, 100, 2), (1.051, 100, 3)])
def test_one_standard_error_is_that_of_the_check_points(value: float, n_check: int,
                                                        size: int) -> None:
    # RMSE / sqrt(2 f) with f = 2 n: a tenth of the RMSE with 25 points, a twentieth with 100.
    assert recommended_size("one-standard-error", [2.0, value, 1.0], [1, 2, 3], n_check) == size
    assert recommended_size("best", [2.0, value, 1.0], [1, 2, 3], n_check) == 3


def test_the_knee_is_below_the_line_between_the_ends() -> None:
    assert recommended_size("knee", [100.0, 2.0, 1.5, 1.0], [1, 2, 3, 4]) == 2
    assert recommended_size("knee", [100.0, 90.0, 1.5, 1.0], [1, 2, 3, 4]) == 3


@pytest.mark.parametrize(("n_control", "n_check", "message"), [
    (3, 2, None),
    (3, 1, "only 1 selection point (role check), and a search by check-rmse chooses by at least 2. "
           "Give more points the role check. Or choose by leave-one-out, which needs no "
           "selection points: --criterion press."),
    (2, 2, "only 2 control points beside 2 selection points and 10 independent check points; "
           "at least 3 control points are needed. Give more points the role control, in the column "
           "role or by --role ID=control, or measure more. Or choose by leave-one-out, without "
           "selection points: --criterion press.")])
def test_how_many_points_a_search_needs(n_control: int, n_check: int, message: str | None) -> None:
    roles = ("control",) * n_control + ("check",) * n_check
    away = photograph(0.2, 14).points.take(np.arange(13, -1, -1))  # no corners, which are in line
    features = set_of(away.ground, away.image,
                      (*roles, *("independent",) * (14 - len(roles))))
    request = request_of("owdis-points", features=features, model="affine",
                         criterion="check-rmse")
    if message is None:
        assert len(observe(request).check) == n_check
        return
    with pytest.raises(termsel.TermselError) as refused:
        observe(request)
    assert str(refused.value) == message
