"""The choice of m of n control points for a refinement."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("termsel_rpc", reason="termsel-rpc is not installed: "
                    "pip install -e plugins/termsel-rpc")

import termsel
from termsel import (
    FeatureSet,
    Fits,
    Points,
    TermselError,
    read_result,
    read_rpc,
    uncovered_share,
    write_result,
)
from termsel.simulate import scene_truth, write_geometry
from termsel_rpc import Ce90, RpcShift, simulate_candidates
from termsel_rpc.simulated import DATASET_NAME, RPC_FILE, SCENE, candidate_quality, nominal_sensor

Call = Callable[..., SimpleNamespace]

pytestmark = pytest.mark.filterwarnings("ignore:Dataset has no geotransform")


@pytest.fixture(scope="module")
def run_by_name(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    termsel.run("rpc-gcps", out=folder)
    return folder


def kinds(ids: tuple[str, ...]) -> list[str]:
    of = dict(zip(simulate_candidates().points.ids, candidate_quality().tolist(), strict=True))
    return [of[name] for name in ids]


@pytest.mark.slow
def test_runs_by_its_name_and_drops_the_blunders(run_by_name: Path) -> None:
    record = json.loads((run_by_name / "result.json").read_text())
    assert (record["model"], record["solver"]) == ("rpc-drift", "ga-steady")
    chosen = tuple(record["selection"]["features"])
    assert len(chosen) == 6
    assert "wrong" not in kinds(chosen)
    out = tuple(one["id"] for one in record["outliers"] if one["certainty"] == "certain")
    assert set(kinds(out)) == {"wrong"}
    assert len(out) > 16  # of 24
    assert record["rmse"]["independent"]["total"] < 1.1


@pytest.mark.slow
def test_the_note_says_what_the_search_drove_down() -> None:
    notes = " ".join(termsel.run("rpc-gcps", generations=2,
                                 options={"blunders": "keep", "polish": False}).notes)
    assert "over the points that the problem judges by" in notes
    assert "first order" not in notes  # the equations of an RPC's refinement are exact
    alone = termsel.run("rpc-gcps", generations=2,
                        options={"judged_by": "check", "polish": False})
    assert "minimised an RMSE" not in " ".join(alone.notes)


def test_refined_rpc_serves_gdal(run_by_name: Path, tmp_path: Path, call: Call) -> None:
    pytest.importorskip("rasterio")
    done = call("export", run_by_name, "--to", "rpb", "--output", tmp_path / "scene.RPB")
    assert done.exit_code == 0, done.stderr
    refined, vendor = read_rpc(tmp_path / "scene.RPB"), read_rpc(RPC_FILE)
    ground = simulate_candidates().points.ground
    true = scene_truth(SCENE).sensor.project(ground)
    before, after = (np.linalg.norm(rpc.project(ground) - true, axis=1).mean()
                     for rpc in (vendor, refined))
    assert before > 10
    assert after < 0.8
    np.testing.assert_allclose(refined.project(ground), read_result(run_by_name).project(ground),
                               atol=1e-4)


@pytest.mark.slow
def test_chosen_points_cover_the_area_asked_for(run_by_name: Path) -> None:
    result = read_result(run_by_name)
    control = result.fit.control.points
    chosen = np.isin(control.ids, result.selection.features)
    assert uncovered_share(control.image, chosen[None])[0] <= 0.5
    wider = termsel.run("rpc-gcps", generations=30, options={"max_uncovered": 0.2})
    chosen = np.isin(control.ids, wider.selection.features)
    assert wider.feasible
    assert uncovered_share(control.image, chosen[None])[0] <= 0.2


@pytest.mark.parametrize("judged_by", ["all", "check"])
def test_the_figure_is_over_the_points_asked_for(judged_by: str) -> None:
    task = termsel.prepare("rpc-gcps", criterion="ce90",
                           options={"judged_by": judged_by, "max_uncovered": 1})
    genes = task.problem.genome.random(np.random.default_rng(0), 5)
    assert genes.shape == (5, 6)  # six numbers of features, as in the paper
    found = task.problem.evaluate(genes).objectives[:, 0]
    control, check = task.observations.control.points, task.observations.check
    for one, figure in zip(genes, found, strict=True):
        chosen = control.take(np.sort(one))
        seen = read_rpc(RPC_FILE).project(chosen.ground)
        columns = np.column_stack([np.ones(len(seen)), seen[:, 0]])
        correction = np.linalg.lstsq(columns, chosen.image - seen, rcond=None)[0]
        distances = []
        for points in (control, check) if judged_by == "all" else (check,):
            there = read_rpc(RPC_FILE).project(points.ground)
            away = there + np.column_stack([np.ones(len(there)), there[:, 0]]) @ correction
            distances.extend(np.linalg.norm(away - points.image, axis=1))
        assert figure == pytest.approx(np.quantile(distances, 0.9), rel=1e-9)


def test_ce90_of_known_distances() -> None:
    """Distances 0, 1, ... 10 px: nine of ten are within 9."""
    ground = np.arange(33.0).reshape(11, 3)
    shift = np.arange(11.0)[:, None] * [0.006, 0.008]
    check = Points(tuple("abcdefghijk"), shift, ground)
    model = termsel.Polynomial2D(degree=1)
    k = len(model.terms)
    fits = Fits(model, check, check, 100.0, np.ones((1, k), dtype=bool), np.zeros((1, k)))
    assert Ce90().score(fits)[0] == pytest.approx(9.0)


def number_of_points(solver: str | None = None, **options: int) -> int:
    """Return how many points a search selects."""
    task = termsel.prepare("rpc-gcps", solver=solver, options=options)
    found = termsel.search(task.problem, task.solver, generations=20)
    return len(task.problem.decode(found.genes).features)


@pytest.mark.parametrize("m", [3, 10])
def test_any_number_of_points(m: int) -> None:
    assert number_of_points(min_features=m, max_features=m, max_uncovered=1) == m


def test_a_solver_for_bits_alone_is_refused_for_m_of_n() -> None:
    with pytest.raises(TermselError, match="those of 'features' are Subset") as error:
        termsel.prepare("rpc-gcps", solver="ica")
    assert "ga-steady" in str(error.value.hint)
    # A range of numbers is no m of n.
    termsel.prepare("rpc-gcps", solver="ica", options={"max_features": 7})


@pytest.mark.parametrize("solver", [None, "ga"])
def test_a_range_of_numbers(solver: str | None) -> None:
    assert 6 <= number_of_points(solver, min_features=6, max_features=12) <= 12


def test_covered_area_as_an_objective() -> None:
    result = termsel.run("rpc-gcps", solver="nsga2", generations=10, options={"population": 24})
    assert list(result.objectives) == ["check-rmse", "uncovered"]
    assert len(result.front) > 1


@pytest.mark.parametrize("biases", ["attitude", "both"])
def test_points_for_a_rigorous_model(biases: str) -> None:
    result = termsel.run("rpc-gcps", model="pushbroom-refine", generations=15, options={
        "geometry": DATASET_NAME, "biases": biases, "polish": False})
    assert result.feasible
    rmse = result.rmse["independent"]
    assert rmse is not None
    assert rmse.total < 2.5
    assert len(result.selection.features) == 6


def test_terms_of_a_refinement_are_selected() -> None:
    """A shift, and a drift of the samples; the other terms only follow the noise."""
    rpc, rng = read_rpc(RPC_FILE), np.random.default_rng(0)
    ground = rng.uniform(-0.8, 0.8, (60, 3)) * rpc.ground_scale + rpc.ground_offset
    seen = rpc.project(ground)
    image = seen + rng.normal(0, 0.5, (60, 2)) + np.array([8.0, -5.0])
    image[:, 1] += 1e-3 * seen[:, 0]
    features = FeatureSet(Points(tuple(f"p{i}" for i in range(60)), image, ground),
                          crs="EPSG:4979")
    result = termsel.run("poly-terms", features=features, model="rpc-affine", criterion="ebic",
                         solver="swap", options={"rpc": DATASET_NAME})
    assert {"line.bias:1", "sample.bias:1", "sample.bias:line"} <= set(result.selection.terms)
    assert len(result.selection.terms) < 6


@pytest.mark.parametrize(("arguments", "said"), [
    (["--model", "rpc-affine"], "'rpc-affine' requires the RPC to refine"),
    (["--set", "rpc=no-such-file.RPB"], "this file does not exist"),
    (["--dataset", "spot-isfahan"], "is of another place (34.8 N, 48.5 E) than the control"),
    (["--model", "pushbroom-refine"], "requires the geometry to refine"),
    (["--set", "min_features=9"], "option 'min_features' is 9, more than 'max_features', 6"),
])
def test_bad_input_gives_one_message(arguments: list[str], said: str, call: Call) -> None:
    done = call("run", "--problem", "rpc-gcps", *arguments)
    assert done.exit_code == 2
    assert said in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr
    assert not done.stdout


@pytest.mark.slow
@pytest.mark.parametrize(("model", "option"), [("rpc-drift", "rpc"),
                                               ("pushbroom-refine", "geometry")])
def test_a_result_is_whole_without_the_vendors_file(
        model: str, option: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, ground = tmp_path / "vendor.scene", simulate_candidates().points.ground
    if option == "rpc":
        file.write_text(RPC_FILE.read_text())
    else:
        write_geometry(nominal_sensor(), file)
    monkeypatch.chdir(tmp_path)
    result = termsel.run("rpc-gcps", model=model, generations=2, out=tmp_path / "out",
                         options={option: file.name, "polish": False})
    file.unlink()
    (tmp_path / "out").rename(tmp_path / "elsewhere")
    monkeypatch.chdir(tmp_path.parent)
    again = read_result(tmp_path / "elsewhere")
    np.testing.assert_allclose(again.project(ground), result.project(ground), atol=1e-9)
    assert str(tmp_path) not in result.to_json()
    termsel.export(again, "rpc-txt", tmp_path / "scene_RPC.TXT")
    np.testing.assert_allclose(read_rpc(tmp_path / "scene_RPC.TXT").project(ground),
                               result.project(ground), atol=0.01)
    write_result(again, tmp_path / "elsewhere")  # and once more
    np.testing.assert_allclose(read_result(tmp_path / "elsewhere").project(ground),
                               result.project(ground), atol=1e-9)


@pytest.mark.parametrize(("model", "option"), [("rpc-shift", "rpc"),
                                               ("pushbroom-refine", "geometry")])
@pytest.mark.parametrize("text", ["{", "{}", '{"file": "a", "image_offset": [1, 2]}'])
def test_damaged_record_of_a_geometry(model: str, option: str, text: str) -> None:
    with pytest.raises(TermselError, match=r"Give the file|Expected JSON"):
        termsel.prepare("rpc-gcps", model=model, options={option: text})


def test_own_points_do_not_take_the_rpc_of_the_embedded_ones() -> None:
    with pytest.raises(TermselError, match="requires the RPC to refine") as caught:
        termsel.run("rpc-gcps", features=simulate_candidates())
    assert "rpc=FILE" in str(caught.value)


def test_embedded_points_are_as_stated() -> None:
    points, kind = simulate_candidates().points, candidate_quality()
    away = np.linalg.norm(points.image - scene_truth(SCENE).sensor.project(points.ground), axis=1)
    roles = np.array(points.roles)
    for role, counts in {"control": (48, 20, 12), "check": (48, 20, 12),
                         "independent": (80, 0, 0)}.items():
        found = [int(((roles == role) & (kind == one)).sum()) for one in ("good", "inexact",
                                                                          "wrong")]
        assert tuple(found) == counts
    assert away[kind == "good"].max() < 2.5
    assert away[kind == "wrong"].min() > 3
    assert np.sqrt((away[kind == "inexact"]**2).mean() / 2) == pytest.approx(2.0, rel=0.25)


def test_rpc_shift_has_a_term_for_each_axis() -> None:
    assert RpcShift(rpc=DATASET_NAME).terms == ("line.bias:1", "sample.bias:1")
