"""Statistics of studies against published examples, other libraries and counting by hand."""

from __future__ import annotations

import json
import math
import subprocess
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs

import termsel
from termsel.toolkit import FloatArray
from termsel.toolkit.studies import CellRecord
from termsel_studies.claims import size_in_words, valid_claims
from termsel_studies.fronts import front_figures, front_indicators, non_dominated
from termsel_studies.groups import Groups, Runs, group
from termsel_studies.ioh import INFEASIBLE_VALUE, ioh_files
from termsel_studies.ioh import write as write_ioh
from termsel_studies.pages import study_as_latex, study_as_markdown, tables_of
from termsel_studies.report import write_tables_and_charts as write_report
from termsel_studies.significance import (
    compare_methods,
    critical_difference,
    effect_size,
    effect_size_interval,
    holm_correction,
    may_be_chance,
    performance_profile,
    signed_rank_test,
)
from termsel_studies.summaries import (
    effort_to_target,
    expected_running_time,
    quantiles_with_infinity,
    quartiles_by_budget,
    success_curve,
    summarise_runs,
    targets_of,
    wilson_interval,
)

# Demšar 2006, table 6: AUC of C4.5, C4.5+m, C4.5+cf and C4.5+m+cf on 14 data sets. The paper ranks
# the two that it prints as 0.975 as if they differed.
DEMSAR = np.array([
    [.763, .768, .771, .798], [.599, .591, .590, .569], [.954, .971, .968, .967],
    [.628, .661, .654, .657], [.882, .888, .886, .898], [.936, .931, .916, .931],
    [.661, .668, .609, .685], [.583, .583, .563, .625], [.775, .838, .866, .875],
    [1.00, 1.00, 1.00, 1.00], [.940, .962, .965, .962], [.619, .666, .614, .669],
    [.972, .981, .97501, .975], [.957, .978, .946, .970]])
NO_RECORD = CellRecord("c", "done", "", {}, [], [])
NAMES = ("C4.5", "C4.5+m", "C4.5+cf", "C4.5+m+cf")


def test_methods_are_the_solvers_where_each_problem_has_its_own_model() -> None:
    study = termsel.compare(problems=["poly-terms", "rfm-terms"], solvers=["random", "swap"],
                            seeds=1, budget={"evaluations": 20})
    groups = group(study.rows, study.records)
    assert groups.methods == ("random", "swap")
    assert groups.common == ["poly-terms", "rfm-terms"]


def test_ranks_and_critical_difference_are_those_of_demsar() -> None:
    found = compare_methods(NAMES, -DEMSAR)
    assert found is not None
    assert found.ranks == pytest.approx((3.143, 2.000, 2.893, 1.964), abs=5e-4)
    assert found.difference == pytest.approx(1.25, abs=0.005)
    # The paper's 9.28 is without the correction for ties.
    ranks, n, k = np.array(found.ranks), 14, 4
    plain = 12 * n / (k * (k + 1)) * ((ranks**2).sum() - k * (k + 1) ** 2 / 4)
    assert plain == pytest.approx(9.28, abs=0.01)
    assert found.statistic is not None
    assert found.statistic > plain
    assert found.p is not None
    assert found.p < 0.05


def test_friedman_and_nemenyi_agree_with_scikit_posthocs() -> None:
    posthocs = pytest.importorskip("scikit_posthocs")
    found = compare_methods(NAMES, -DEMSAR)
    assert found is not None
    assert found.difference is not None
    p = posthocs.posthoc_nemenyi_friedman(-DEMSAR).to_numpy()
    for i in range(4):
        for j in range(i):
            apart = abs(found.ranks[i] - found.ranks[j]) > found.difference
            assert apart == (p[i, j] < 0.05)


def test_critical_values_are_those_of_demsar() -> None:
    # Table 5a: q of Nemenyi's test at 0.05 for 2 to 10 methods.
    table = [1.960, 2.343, 2.569, 2.728, 2.850, 2.949, 3.031, 3.102, 3.164]
    for k, q in enumerate(table, 2):
        assert critical_difference(k, 6) == pytest.approx(q * math.sqrt(k * (k + 1) / 36), abs=2e-3)


def test_holm_corrects_step_by_step() -> None:
    assert holm_correction([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm_correction([0.9, 0.8]) == pytest.approx([1.0, 1.0])
    assert holm_correction([]) == []


def test_holm_agrees_with_statsmodels() -> None:
    multitest = pytest.importorskip("statsmodels.stats.multitest")
    p = np.random.default_rng(1).uniform(size=12) ** 3
    assert holm_correction(
        p.tolist()) == pytest.approx(multitest.multipletests(p, method="holm")[1])


def test_signed_rank_counts_a_method_without_result_as_worst() -> None:
    # Six differences of one sign: p = 2 / 2^6.
    one = np.array([1.0, 2, 3, 4, 5, 6])
    other = one + np.arange(1, 7)
    for lower, pair in ((True, (one, other)), (False, (other, one))):
        p, is_lower = signed_rank_test(*pair)
        assert p == pytest.approx(2 / 64)
        assert is_lower is lower
    assert signed_rank_test(one, np.full(6, np.inf))[0] < 0.05
    assert signed_rank_test(one, one)[0] == 1.0
    both = np.full(6, np.inf)
    assert signed_rank_test(both, both)[0] == 1.0


def test_effect_size_counts_pairs() -> None:
    # 1 < 2, 1 < 3, 2 = 2, 2 < 3, 4 > 2, 4 > 3
    assert effect_size([1, 2, 4], [2, 3]) == pytest.approx((3 + 0.5) / 6)
    assert effect_size([1], [2]) == 1.0
    assert effect_size([math.inf], [math.inf]) == 0.5
    assert [size_in_words(value) for value in (0.5, 0.57, 0.35, 0.2, 0.72)] == [
        "negligible", "small", "medium", "large", "large"]


def test_wilson_is_the_published_interval() -> None:
    # Newcombe 1998, Stat. Med. 17, table I, method 3: 81 of 263, 15 of 148, 0 of 20, 1 of 29.
    for successes, runs, low, high in ((81, 263, .2553, .3662), (15, 148, .0624, .1605),
                                       (0, 20, 0.0, .1611), (1, 29, .0061, .1718)):
        assert wilson_interval(successes, runs) == pytest.approx((low, high), abs=5e-5)


def test_expected_running_time_counts_the_runs_that_failed() -> None:
    assert expected_running_time([100, math.inf, 300], [500, 1000, 600]) == (100 + 1000 + 300) / 2
    assert expected_running_time([math.inf], [1000]) == math.inf
    assert expected_running_time([10, 20], [50, 50]) == 15


TRACES = [[[10, 5.0, 0.1], [20, 3.0, 0.2]], [[15, 4.0, 0.3]], []]


def test_traces_give_hits_distributions_and_bands() -> None:
    assert effort_to_target(TRACES[0], 4.0) == 20
    assert effort_to_target(TRACES[0], 4.0, 2) == 0.2
    assert effort_to_target(TRACES[1], 3.9) == math.inf
    budgets, shares = success_curve(
        [effort_to_target(trace, target) for trace in TRACES for target in (4.5, 3.0)])
    assert budgets == [15, 20]
    assert shares == pytest.approx([1 / 6, 3 / 6])
    assert success_curve([math.inf]) == ([], [])
    assert targets_of(2.0, [], 3) == pytest.approx([4.0, 2.02, 2.0002])
    assert targets_of(None, [Runs([], [3.0, math.inf])], 2) == pytest.approx([6.0, 3.0003])
    assert quartiles_by_budget(TRACES[:2], [5, 10, 20]) == [
        (5, math.inf, math.inf, math.inf), (10, math.inf, math.inf, math.inf),
        (20, 3.25, 3.5, 3.75)]


def test_quantiles_accept_what_is_infinite() -> None:
    assert quantiles_with_infinity([1, 2, math.inf], (0, 0.25, 0.5, 1)) == [1, 1.5, 2, math.inf]
    assert quantiles_with_infinity([math.inf] * 3, (0.5,)) == [math.inf]


def test_an_optimum_of_the_smaller_selections_alone_is_none_of_the_problem() -> None:
    study = termsel.compare(
        problems=["rfm-terms"], budget={"evaluations": 400},
        solvers=[{"name": "exact", "max_terms": 2}, "swap"])
    exact = study.rows[0]
    assert (exact["proven"], exact["optimum"]) == (False, None)
    assert "proven optimum" not in study_as_markdown(study)


def test_no_optimum_is_reached_by_a_run_that_ends_elsewhere() -> None:
    # Both found 1.0; the second recommends another member of its front.
    row = {"optimum": 1.0, "state": "done", "evaluations": 100}
    runs = Runs([row] * 2, [1.0, 2.0], [
        CellRecord("k", "done", "", {"evaluations": 100}, [[40, 1.0, 0.1]], [])] * 2)
    (found,) = summarise_runs(Groups("fitness", {"one": {"ga": runs}}, ("ga",)))
    assert (found.optimum, found.reached, found.expected) == (1.0, 1, 40 + 100)


def test_a_performance_profile_is_that_of_its_definition() -> None:
    values = np.array([[1.0, 2.0], [4.0, 1.0], [3.0, 3.0], [2.0, np.inf]])
    profile = performance_profile(values, [1, 2, 4])
    assert profile.tolist() == [[0.75, 0.5], [0.75, 0.75], [1.0, 0.75]]


def test_indicators_of_fronts_by_hand() -> None:
    reference = np.array([[0.0, 10.0], [1.0, 0.0]])
    volume, distance = front_indicators(reference, reference)
    # Two corners, (0, 1) and (1, 0), below the reference point (1.1, 1.1).
    assert volume == pytest.approx(1.1 * 0.1 + 1.0 * 0.1)
    assert distance == 0
    volume, distance = front_indicators(np.array([[0.5, 5.0]]), reference)
    assert volume == pytest.approx(0.36)
    assert distance == pytest.approx(0.5)  # each target is missed by 0.5 in one objective
    points = np.array([[1.0, 2.0], [2.0, 1.0], [2.0, 2.0], [1.0, 2.0]])
    assert non_dominated(points).tolist() == [[1.0, 2.0], [2.0, 1.0]]


def test_the_reference_is_the_front_that_was_proven_whichever_run_it_was() -> None:
    def runs(*fronts: tuple[bool, list[list[float]]]) -> Runs:
        return Runs([{"proven": proven} for proven, _ in fronts], [0.0] * len(fronts),
                    [CellRecord("k", "done", "", {}, [], front) for _, front in fronts])

    best, worse = [[0.0, 10.0], [1.0, 0.0]], [[0.5, 10.0], [1.0, 5.0]]
    found = front_figures(Groups("fitness", {"one": {
        "exact": runs((False, []), (True, best)), "ga": runs((False, worse))}}, ("exact", "ga")))
    assert [(one.method, one.reference) for one in found] == [("exact", "proven"), ("ga", "proven")]
    assert found[0].igd_plus == 0 < found[1].igd_plus


def _groups(medians: FloatArray) -> Groups:
    names = [f"m{i}" for i in range(medians.shape[1])]
    return Groups("independent", {
        f"i{j}": {name: Runs([], [value]) for name, value in zip(names, row, strict=True)}
        for j, row in enumerate(medians)}, tuple(names))


def _row(state: str = "done", **given: object) -> dict[str, object]:
    return {"state": state, "cell": "c", "strategy": "as-asked", "model": "rfm",
            "criterion": "press", "solver": "ga", "problem": "p", "data": "d", "split": 1,
            "fitness": 1.0, **given}


def test_what_failed_is_counted_as_worst_and_what_waits_is_not_counted() -> None:
    rows = [_row(), _row("failed", fitness=None), _row("infeasible", fitness=None),
            _row("waiting", fitness=None)]
    groups = group(rows, {"c": NO_RECORD})
    runs = groups.instances["p"]["ga"]
    assert runs.values == [1.0, np.inf, np.inf]
    assert "Without a result, and counted as worst: 2 of 4 runs." in valid_claims(
        groups, None, rows)


@pytest.mark.parametrize(("proven", "optimum", "n"), [(False, None, 1), (True, 1.0, 0),
                                                      (False, 1.0, 0)])
def test_an_optimum_that_exact_did_not_prove_is_said(proven: bool, optimum: float | None,
                                                     n: int) -> None:
    rows = [_row(), _row(solver="exact", proven=proven, optimum=optimum)]
    said = valid_claims(group(rows, {"c": NO_RECORD}), None, rows)
    assert sum(sentence.startswith("Not proven: 1 run of exact") for sentence in said) == n


def test_problems_with_models_of_their_own_are_compared_by_their_fitness() -> None:
    own = {"a": ("poly2d", "check-rmse"), "b": ("rfm", "press"), "c": ("rfm", "press")}
    rows = [_row(problem=name, model=model, criterion=criterion, objective=criterion, solver=solver)
            for name, (model, criterion) in own.items() for solver in ("ga", "swap", "ga", "swap")]
    groups = group(rows, {"c": NO_RECORD})
    assert groups.measure == "fitness"
    assert groups.methods == ("ga", "swap")
    assert list(groups.instances) == list(own)
    said = valid_claims(groups, None, rows)
    assert said[0] == ("Compared by the fitness (selection RMSE or leave-one-out RMSE); lower is "
                       "better.")
    assert said[1].startswith("All methods ran on 3 instances")
    # Models that are named are methods, and their fitness is not the accuracy.
    named = [_row(model=model, solver=solver, independent=1.0)
             for model in ("poly2d", "rfm") for solver in ("ga", "swap")]
    groups = group(named, {"c": NO_RECORD})
    assert groups.measure == "independent"
    assert groups.methods == ("poly2d, ga", "poly2d, swap", "rfm, ga", "rfm, swap")


def test_claims_say_what_the_tests_allow() -> None:
    rng = np.random.default_rng(3)
    base = rng.uniform(1, 2, (20, 1))
    clear = np.hstack([base, base + rng.uniform(0.5, 1, (20, 1)), base + rng.uniform(
        0.5, 1, (20, 1))])
    said = " ".join(valid_claims(_groups(clear), compare_methods(["m0", "m1", "m2"], clear), []))
    assert "It may be claimed that m0 is better than m1: on 20 of 20 instances" in said
    assert "Of 1 pair no difference may be claimed" in said
    assert "Splits" not in said
    rows = [{"state": "done", "split": split} for split in (0, 1)]
    said = " ".join(valid_claims(_groups(clear), compare_methods(["m0", "m1", "m2"], clear), rows))
    assert "Splits of the same data are not independent" in said
    chance = rng.uniform(1, 2, (20, 3))
    said = " ".join(valid_claims(_groups(chance), compare_methods(["m0", "m1", "m2"], chance), []))
    assert "cannot be distinguished" in said
    assert "It may be claimed" not in said
    few = clear[:4]
    assert compare_methods(["m0", "m1", "m2"], few) is None
    assert "needs at least 5" in " ".join(valid_claims(_groups(few), None, []))


def test_methods_that_were_not_run_on_an_instance_are_named() -> None:
    run = Runs([], [1.0, 2.0])
    apart = Groups("fitness", {"a": {"ga": run}, "b": {"pso": run}}, ("ga", "pso"))
    said = " ".join(valid_claims(apart, None, []))
    assert "No instance was run with all methods, so nothing is compared." in said
    assert "There are no runs of pso on a, ga on b." in said
    partly = Groups("fitness", {"a": {"ga": run, "pso": run}, "b": {"pso": run}}, ("ga", "pso"))
    said = " ".join(valid_claims(partly, None, []))
    assert "All methods ran on 1 of 2 instances" in said
    assert "There are no runs of ga on b." in said
    assert "On a, ga and pso have the same lowest median" in said
    assert "A12 is the share of pairs of runs in which one method is better" in said
    assert "negligible over pso (0.50 [" in said
    assert "] of 2 runs, may be chance)" in said


def test_three_runs_each_claim_nothing_for_certain() -> None:
    values, of_rival = [1.0, 2.0, 3.0], [4.0, 5.0, 6.0]
    low, high = effect_size_interval(effect_size(values, of_rival), 3, 3)
    assert (round(low, 2), high) == (0.5, 1.0)
    assert may_be_chance(values, of_rival)
    assert not may_be_chance(range(6), range(10, 16))
    # An interval of 95 % holds the true size: 0.76 of two normal distributions 1 apart.
    rng = np.random.default_rng(1)
    held = 0
    for _ in range(200):
        first, second = rng.normal(0, 1, 8).tolist(), rng.normal(1, 1, 8).tolist()
        low, high = effect_size_interval(effect_size(first, second), 8, 8)
        held += low <= 0.760 <= high
    assert held >= 180


def test_a_claim_has_the_direction_of_the_ranks_that_were_tested() -> None:
    # m0 is lower by much on 19 instances, and higher by little on 21.
    difference = np.concatenate([-np.linspace(1, 2, 19), np.linspace(0.01, 0.02, 21)])
    values = np.stack([5 + difference, np.full(40, 5.0)], axis=1)
    said = " ".join(valid_claims(_groups(values), compare_methods(["m0", "m1"], values), []))
    assert "It may be claimed that m0 is better than m1: on 19 of 40 instances" in said


def test_ratios_of_what_is_below_zero_are_not_drawn(study: termsel.Study) -> None:
    pytest.importorskip("altair")
    from termsel_studies.figures import figures_of

    records = {key: structs.replace(one, figures={**one.figures, "fitness": -1.0})
               for key, one in study.records.items()}
    below = termsel.Study(study.spec, study.cells, records, None)
    assert "performance-profile" in {one.name for one in figures_of(study)}
    assert "performance-profile" not in {one.name for one in figures_of(below)}


@pytest.fixture(scope="module")
def study() -> termsel.Study:
    return termsel.compare(
        title="Two & three", problems=[{"name": "poly-terms", "degree": 3}],
        solvers=["random", "nsga2", "exact"], seeds=3, splits=2, budget={"evaluations": 150},
        options={"polish": False, "roles": "random"})


def test_tables_have_optimum_success_and_fronts(study: termsel.Study) -> None:
    page = study_as_markdown(study)
    assert page.count("proven optimum") == page.count("expected evaluations")
    assert "| exact | 1 |" in page
    assert "## Fronts" in page
    figures = [line.split(" | ") for line in page.splitlines() if line.endswith("| proven |")]
    by_method = {(row[0], row[1]): float(row[3]) for row in figures}
    assert all(distance == 0 for (_, method), distance in by_method.items() if method == "exact")
    assert all(distance > 0 for (_, method), distance in by_method.items() if method == "nsga2")
    text = study_as_latex(study)
    assert text.count(r"\begin{table}") == text.count(r"\end{table}") == page.count("\n## ") - 1
    assert "_" not in text.replace(r"\_", "")


def test_ioh_data_have_the_runs(study: termsel.Study, tmp_path: Path) -> None:
    groups = group(study.rows, study.records)
    for name, content in ioh_files(groups):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(content)
    described = [json.loads(path.read_text()) for path in tmp_path.rglob("*.json")]
    assert len(described) == len(groups.methods) * len(groups.instances)
    # Methods of one function are compared only where they have one dimension.
    assert len({(one["function_id"], one["scenarios"][0]["dimension"]) for one in described}
               ) == len(groups.instances)
    for path in tmp_path.rglob("*.json"):
        record = json.loads(path.read_text())
        # The files of an instance have its number in their name and inside.
        assert path.name.startswith(f"IOHprofiler_f{record['function_id']}_")
        scenario = record["scenarios"][0]
        lines = (path.parent / scenario["path"]).read_text().splitlines()
        assert lines[0].split() == record["attributes"] == ["evaluations", "raw_y"]
        rows = [(int(a), float(b)) for a, b in (line.split() for line in lines[1:])]
        starts = [i for i, row in enumerate(rows) if row[0] == 1]
        ends = [*starts[1:], len(rows)]
        assert len(starts) == len(scenario["runs"])
        for start, end, run in zip(starts, ends, scenario["runs"], strict=True):
            mine = rows[start:end]
            assert [row[0] for row in mine] == sorted(row[0] for row in mine)
            assert mine[-1] == (run["evals"], run["best"]["y"])


def test_what_an_earlier_form_of_a_study_drew_and_logged_is_removed(
        study: termsel.Study, tmp_path: Path) -> None:
    (tmp_path / "figures").mkdir()
    own = tmp_path / "figures" / "mine.svg"
    own.write_text("<svg/>")
    for of in (study, termsel.compare(problems=["poly-terms"], solvers=["random"], seeds=1,
                                      budget={"evaluations": 20})):
        written = [*write_report(of, tmp_path), *write_ioh(of, tmp_path)]
    charts = {path.name for path in written if path.suffix == ".svg"}
    assert {path.name for path in (tmp_path / "figures").iterdir()} == {*charts, own.name}
    assert "performance-profile.svg" not in charts
    logs = list((tmp_path / "ioh").rglob("IOHprofiler_f*"))
    assert {path.relative_to(tmp_path / "ioh").parts[0] for path in logs} == {"random"}
    assert sorted(path.suffix for path in logs) == [".dat", ".json"]


def test_failed_runs_are_among_the_ioh_data(tmp_path: Path) -> None:
    traced = CellRecord("a", "done", "", {"evaluations": 50, "n_genes": 78},
                        [[3, 2.5, 0.1], [41, 1.5, 0.2]], [])
    infeasible = CellRecord("b", "infeasible", "none", {"evaluations": 50, "n_genes": 78}, [], [])
    failed = CellRecord("c", "failed", "an error", {}, [], [])
    groups = Groups("fitness", {"one": {"ga": Runs([], [], [traced, infeasible, failed])}},
                    ("ga",))
    files = dict(ioh_files(groups))
    [described] = [json.loads(text) for name, text in files.items() if name.endswith(".json")]
    [scenario] = described["scenarios"]
    assert scenario["dimension"] == 78
    assert [(run["evals"], run["best"]["evals"], run["best"]["y"]) for run in scenario["runs"]] \
        == [(50, 41, 1.5), (50, 50, 1e9 + 1), (1, 1, 1e9 + 2)]
    [rows] = [text.split() for name, text in files.items() if name.endswith(".dat")]
    assert rows[2:] == ["1", "1000000000", "3", "2.5", "41", "1.5", "50", "1.5",
                        "1", "1000000001", "50", "1000000001", "1", "1000000002"]
    iohinspector = pytest.importorskip("iohinspector")
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    manager = iohinspector.DataManager()
    manager.add_folder(str(tmp_path))
    assert manager.overview["dimension"].to_list() == [78] * 3
    assert sorted(manager.overview["evals"].to_list()) == [1, 50, 50]
    table = manager.load(monotonic=True)
    assert len(table.partition_by("data_id")) == 3
    assert table["raw_y"].max() == 1e9 + 2


def test_methods_of_like_names_have_ioh_data_of_their_own() -> None:
    record = CellRecord("k", "done", "", {"evaluations": 10}, [[10, 0.5, 0.1]], [])
    methods = ("ga p=1", "ga p 1", "GA_p_1", "ga_p=1-2")
    groups = Groups("fitness", {"one": {name: Runs([], [0.5], [record]) for name in methods}},
                    methods)
    files = [json.loads(content) | {"folder": name.partition("/")[0].lower()}
             for name, content in ioh_files(groups) if name.endswith(".json")]
    assert [one["algorithm"]["name"] for one in files] == list(methods)
    assert len({one["folder"] for one in files}) == len(methods)


def test_iohinspector_reads_the_data(study: termsel.Study, tmp_path: Path) -> None:
    # No extra installs it: with it comes a package named tests, which hides this folder.
    iohinspector = pytest.importorskip("iohinspector")
    groups = group(study.rows, study.records)
    for name, content in ioh_files(groups):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(content)
    manager = iohinspector.DataManager()
    manager.add_folder(str(tmp_path))
    best = sorted(manager.overview["best_y"].to_list())
    # Of a front the run may recommend another member than that of least fitness.
    assert best == sorted(record.trace[-1][1] if record.trace else INFEASIBLE_VALUE
                          for record in study.records.values())
    table = manager.load(monotonic=True)
    assert table["raw_y"].min() == best[0]


def test_parquet_and_csv_hold_the_same(study: termsel.Study, tmp_path: Path) -> None:
    pd = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    from termsel.toolkit.studies import write_outputs

    written = write_outputs(study, tmp_path)
    assert [path.name for path in written if path.suffix != ".svg"] == [
        "study.csv", "study.parquet", "ioh", "summary.md", "summary.tex", "report.html"]
    csv, parquet = pd.read_csv(tmp_path / "study.csv"), pd.read_parquet(tmp_path / "study.parquet")
    assert list(csv.columns) == list(parquet.columns) == list(study.columns)
    assert len(csv) == len(parquet) == len(study.cells)
    assert csv.fitness.tolist() == parquet.fitness.tolist()


def test_figures_are_those_that_the_runs_allow(study: termsel.Study) -> None:
    pytest.importorskip("altair")
    from termsel_studies.figures import critical_differences, figures_of, runs_of_alike_ranks

    found = {one.name: one.chart for one in figures_of(study)}
    assert set(found) == {"ecdf-evaluations", "ecdf-cpu-seconds", "convergence",
                          "performance-profile"}
    (rows,) = found["ecdf-evaluations"].to_dict()["datasets"].values()
    # The solver that proves the optimum reaches every target.
    assert max(row["share"] for row in rows if row["method"] == "exact") == 1
    comparison = compare_methods(NAMES, -DEMSAR)
    assert comparison is not None
    assert critical_differences(comparison).chart.to_dict()["layer"]
    # Figure 1 of Demšar 2006 has the same shape: two bars that overlap.
    assert runs_of_alike_ranks([1.0, 1.5, 2.4, 3.0], 1.6) == [(1.0, 2.4), (1.5, 3.0)]
    assert runs_of_alike_ranks([1.0, 4.0], 1.0) == []


def test_the_page_of_a_study_says_what_its_summary_says(study: termsel.Study,
                                                        tmp_path: Path) -> None:
    pytest.importorskip("vl_convert")
    from termsel.toolkit.studies import write_outputs

    write_outputs(study, tmp_path)
    page = unescape((tmp_path / "report.html").read_text())
    tables, said = tables_of(study)
    assert all(f"<p>{sentence}</p>" in page for sentence in said)
    assert tables
    for table in tables:
        for name, *cells in table.rows:
            assert f'<th scope="row">{name}</th>' in page
            assert all(f">{cell}</td>" in page for cell in cells)
    assert "default-src 'none'" in page


@pytest.mark.parametrize("command", ["pdflatex", "tectonic"])
def test_latex_compiles(command: str, study: termsel.Study, tmp_path: Path) -> None:
    import shutil

    if shutil.which(command) is None:
        pytest.skip(f"{command} is not here")
    (tmp_path / "study.tex").write_text(
        "\\documentclass{article}\\usepackage{booktabs}\\begin{document}\n" + study_as_latex(study)
        + "\\end{document}\n")
    subprocess.run([command, "study.tex"], cwd=tmp_path, check=True, stdout=subprocess.DEVNULL)
