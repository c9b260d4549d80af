"""The benchmark: frozen sets, one protocol for all, results that are repeated."""

from __future__ import annotations

import hashlib
import json
import math
import sys
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

pytest.importorskip("termsel_bench", reason="termsel-bench is not installed: "
                    "pip install -e plugins/termsel-bench")

import termsel
from termsel import TermselError, simulate_scene
from termsel.testing import invoke
from termsel_bench.methods.base import AUTO, PEERS, Method
from termsel_bench.methods.scripts import Cubic
from termsel_bench.protocol import Score, Work, score_work
from termsel_bench.scenes import catalogue
from termsel_bench.scenes.base import INDEPENDENT, BenchSet
from termsel_bench.scenes.catalogue import QUICK, SETS, simulated_set
from termsel_bench.scenes.real import real_set
from termsel_bench.submitted import check, read_submitted
from termsel_bench.tables import least_error_by_set, losses, ratio_to_best

MINE = """
import numpy as np

def georeference(features):
    assert "independent" not in features.points.roles
    ground, image = features.points.ground, features.points.image
    middle = ground.mean(axis=0)
    def columns(at):
        return np.column_stack([np.ones(len(at)), at - middle])
    x = np.linalg.lstsq(columns(ground), image, rcond=None)[0]
    return lambda at: columns(at) @ x

def broken(features):
    return features.nothing

def nowhere(features):
    return lambda at: np.full((len(at), 2), np.nan)

def short(features):
    return lambda at: np.zeros((3, 2))
"""


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A stranger's module in the folder of the command."""
    (tmp_path / "stranger.py").write_text(MINE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    return "stranger"


def run(*words: object, code: int = 0) -> str:
    """Return what the command prints."""
    result = invoke("bench", *map(str, words))
    assert result.exit_code == code, result.output
    return result.output


def test_forty_sets_of_nine_kinds() -> None:
    assert len(SETS) == 40
    assert {one.kind for one in SETS.values()} == {SETS[name].kind for name in QUICK}
    assert len({one.kind for one in SETS.values()}) == len(QUICK) == 9


@pytest.mark.slow_cases("lines-1")
@pytest.mark.parametrize("name", ["steady-1", "radar-1", "old-map-1", "vendor-rpc-1", "lines-1"])
def test_a_set_is_the_frozen_one(name: str) -> None:
    one = simulated_set(name)
    asked = SETS[name]
    assert len(one.features.points) == asked.count
    assert len(one.independent) == INDEPENDENT
    assert set(one.features.points.roles) == {"control", "check"}
    assert set(one.independent.roles) == {"independent"}
    assert len(one.features.lines) == asked.settings.get("n_lines", 0)
    assert (one.features.rpc is not None) == (one.kind == "vendor-rpc")


@pytest.mark.parametrize(("points", "by", "frozen"), [
    (1, 0.001, True), (1, 0.2, False), (1000, 0.001, False)])
def test_a_set_is_refused_that_differs_by_more_than_the_rounding_of_few_numbers(
        points: int, by: float, frozen: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    def moved(name: str) -> BenchSet:
        one = made(name)
        image = one.independent.image.copy()
        image[:points, 1] += by
        return type(one)(one.name, one.kind, one.features, type(one.independent)(
            one.independent.ids, image, one.independent.ground, None, one.independent.roles))

    made = catalogue.simulate_set
    monkeypatch.setattr(catalogue, "simulate_set", moved)
    simulated_set.cache_clear()
    with nullcontext() if frozen else pytest.raises(
            TermselError, match=r"not the frozen one: frame-1\.csv differs"):
        simulated_set("frame-1")
    simulated_set.cache_clear()


def test_radar_sees_heights_by_range_alone() -> None:
    one = simulated_set("radar-3")
    at = (one.independent.ground - one.independent.ground.mean(axis=0)) \
        / np.ptp(one.independent.ground, axis=0)
    plane = np.column_stack([at[:, 0]**i * at[:, 1]**j for i in range(4) for j in range(4 - i)])
    three = np.column_stack([one.independent.image, at[:, 2]])
    line, sample, height = (three - plane @ np.linalg.lstsq(plane, three)[0]).T
    # A higher place is nearer: its range is shorter. The line of zero Doppler stays.
    assert abs(np.corrcoef(sample, height)[0, 1]) > 0.99
    assert np.std(line) < 0.02 * np.std(sample)


def test_written_files_are_those_of_the_metadata_and_are_read(tmp_path: Path) -> None:
    run("--files", tmp_path, "--sets", "vendor-rpc-2")
    said = json.loads((tmp_path / "croissant.json").read_text())
    assert {one["name"] for one in said["distribution"]} == {
        "vendor-rpc-2.csv", "vendor-rpc-2.prj", "vendor-rpc-2_RPC.TXT"}
    for one in said["distribution"]:
        assert hashlib.sha256((tmp_path / one["name"]).read_bytes()).hexdigest() == one["sha256"]
    features = termsel.read(tmp_path / "vendor-rpc-2.csv")
    points = features.points
    one = simulated_set("vendor-rpc-2")
    assert features.crs == one.features.crs
    np.testing.assert_array_equal(points.image[:4], one.features.points.image)
    np.testing.assert_array_equal(points.ground[4:], one.independent.ground)
    assert one.features.rpc is not None
    rpc = termsel.read_rpc(tmp_path / "vendor-rpc-2_RPC.TXT")
    np.testing.assert_allclose(rpc.project(points.ground),
                               one.features.rpc.project(points.ground), atol=1e-6)


@pytest.mark.parametrize("name", ["old-map-1", "lines-1"])
def test_tables_are_read_by_their_description_alone(tmp_path: Path, name: str) -> None:
    # Readers of Croissant take the first line of a file for the names of its columns.
    run("--files", tmp_path, "--sets", name)
    said = json.loads((tmp_path / "croissant.json").read_text())
    files = {one["@id"]: tmp_path / one["contentUrl"] for one in said["distribution"]}
    tables = set()
    for records in said["recordSet"]:
        sources = [field["source"] for field in records["field"]]
        (file,) = {source["fileObject"]["@id"] for source in sources}
        table = pd.read_csv(files[file])
        assert list(table) == [source["extract"]["column"] for source in sources]
        numbers = [field["name"] for field in records["field"] if field["dataType"] == "sc:Float"]
        assert all(pd.api.types.is_numeric_dtype(table[number]) for number in numbers)
        assert simulated_set(name).features.crs in records["description"]
        tables.add(file)
    assert tables == {file for file in files if file.endswith(".csv")}


def test_metadata_name_each_file_once() -> None:
    names = list(catalogue.frozen_checksums())
    assert len(names) == len(set(names)) == 40 + 4 + 4 + 44  # points, lines, RPCs and CRSs
    means = json.loads(Path(catalogue.__file__).parents[1].joinpath(catalogue.MEANS).read_text())
    assert list(means) == [name for name in names if not name.endswith(".prj")]


def test_a_score_is_the_rmse_of_independent_points(package: str) -> None:
    found = score_work(Work(Method("package", package), "steady-3"))
    one = simulated_set("steady-3")
    at = one.features.points.ground
    middle = at.mean(axis=0)
    x = np.linalg.lstsq(np.column_stack([np.ones(len(at)), at - middle]),
                        one.features.points.image)[0]
    there = one.independent.ground
    errors = np.column_stack([np.ones(len(there)), there - middle]) @ x - one.independent.image
    assert found.rmse == pytest.approx(np.sqrt((errors**2).sum(axis=1).mean()))
    assert found.low < found.rmse < found.high < 1.2 * found.low


def test_an_affine_package_is_the_affine_model(package: str) -> None:
    model, mine = (score_work(Work(method, "steady-3")) for method in (
        Method("model", "affine"), Method("package", f"{package}:georeference")))
    assert mine.rmse == pytest.approx(model.rmse, rel=1e-6)


@pytest.mark.parametrize(("function", "why"), [
    ("broken", "failed in georeference"), ("nowhere", "no position for 1000 of 1000 places"),
    ("short", "positions of the shape (3, 2)")])
def test_a_faulty_package_has_no_result(package: str, function: str, why: str) -> None:
    found = score_work(Work(Method("package", f"{package}:{function}"), "frame-1"))
    assert np.isinf(found.rmse)
    assert why in found.why


@pytest.mark.slow_cases("pymoo-script", "scikit-learn")
@pytest.mark.parametrize("peer", [*PEERS])
def test_peers_do_what_they_say(peer: str) -> None:
    sets = {"orthority": "vendor-rpc-4", "opencv": "measured-photo-037"}
    name = sets.get(peer, "steady-4")
    modules = {"gdal-polynomial": "rasterio", "gdal-tps": "rasterio", "ransac": "sklearn",
               "scikit-learn": "sklearn", "orthority": "orthority", "opencv": "cv2"}
    pytest.importorskip(modules.get(peer, "numpy"))
    found = score_work(Work(Method("peer", peer), name))
    assert not found.why
    assert found.rmse < 20
    assert found.rmse == score_work(Work(Method("peer", peer), name)).rmse


def test_a_spline_of_gdal_is_exact_at_its_points() -> None:
    pytest.importorskip("rasterio")
    one = simulated_set("steady-3")
    seen = Method("peer", "gdal-tps").positions(one.features, one.features.points, 1)
    np.testing.assert_allclose(seen, one.features.points.image, atol=1e-4)


def test_the_fitness_of_the_scripts_is_termsels() -> None:
    scene = simulate_scene("irs1c-mashad", n_lines=0)
    points = scene.points.take(np.array(scene.points.roles) != "independent")
    problem = Cubic(scene.with_(points=points))
    genes = np.random.default_rng(3).random(problem.size) < 0.4
    genes[[0, len(problem.powers)]] = True
    project = problem.projection(genes)
    check = points.take(np.array(points.roles) == "check")
    errors = project(check.ground) - check.image
    assert problem.fitness(genes) == pytest.approx(np.sqrt((errors**2).sum(axis=1).mean()))
    assert problem.fitness(np.ones(problem.size, dtype=bool)) > 1e5 or len(points) > 40


def test_losses_and_ratios() -> None:
    def one(method: Method, name: str, rmse: float) -> Score:
        return Score(method, name, "steady", 10, 1000, rmse)

    other = Method("model", "affine")
    found = [one(AUTO, "a", 2.0), one(other, "a", 1.0), one(AUTO, "b", 1.0),
             one(other, "b", float("inf")), one(AUTO, "c", 1.01), one(other, "c", 1.0)]
    best = least_error_by_set(found)
    assert [ratio_to_best(row, best) for row in found[:4]] == [2.0, 1.0, 1.0, float("inf")]
    lost = losses(found, "auto")
    assert [(mine.set_name, rival.method) for mine, rival in lost] == [("a", other)]


def test_out_is_checked_by_recomputation(package: str, tmp_path: Path) -> None:
    out = tmp_path / "out"
    text = run("--package", package, "--alone", "--sets", "frame", "--out", out)
    assert "package stranger" in text
    rows = (out / "table.csv").read_text().splitlines()
    assert len(rows) == 1 + 4
    assert rows[0].startswith("set,kind,method,points,independent,rmse,low,high,ratio")
    assert "Which method is best" in (out / "index.html").read_text()
    checked = tmp_path / "checked"
    checked.mkdir()
    file = checked / "mine.json"
    file.write_bytes((out / "package-stranger.json").read_bytes())
    refused = run("--check", checked, code=2)
    assert "names code to run: 'stranger'" in refused
    assert "--package" in refused
    trusted = ("--check", checked, "--package", "stranger")
    assert "confirmed" in run(*trusted)
    said = json.loads(file.read_text())
    said["sets"]["frame-3"]["rmse"] *= 0.9
    file.write_text(json.dumps(said))
    assert "refuted: frame-3" in run(*trusted, code=2)
    assert "confirmed" in run(*trusted, "--sets", "frame-1")


@pytest.mark.parametrize(("change", "message"), [
    (lambda said: said.pop("sets"), "is no file of results of a benchmark"),
    (lambda said: said.update(schema="other"), "its schema is 'other'"),
    (lambda said: said["sets"]["frame-1"].update(sha256="0"), "another version of the set"),
    (lambda said: said["sets"].update(moon={"sha256": "0", "rmse": 1}), "names the set 'moon'"),
    (lambda said: said["method"].update(kind="magic"), "a method of the kind 'magic'"),
    (lambda said: said.update(sets={}), "has no sets"),
    (lambda said: said["sets"]["frame-1"].update(rmse="low"), "is no file of results")])
def test_bad_files_of_results_are_refused(
        tmp_path: Path, change: Callable[[dict[str, Any]], None], message: str) -> None:
    said = {"schema": "termsel-bench-1",
            "method": {"kind": "model", "name": "affine", "options": {}, "problem": ""},
            "sets": {"frame-1": {"sha256": catalogue.frozen_checksums()["frame-1.csv"],
                                 "rmse": 3.0}}}
    change(said)
    (tmp_path / "mine.json").write_text(json.dumps(said))
    with pytest.raises(TermselError, match=message):
        read_submitted(tmp_path)


def test_the_folder_of_a_run_is_no_submission(tmp_path: Path) -> None:
    (tmp_path / "result.json").write_text('{"schema": "termsel-result-1"}')
    text = run("--check", tmp_path, code=2)
    assert "is the record of a run, not of a benchmark. Give what `termsel bench --out" in text


@pytest.mark.parametrize("rmse", [math.nan, math.inf, 0.0, -1.0])
def test_an_rmse_that_no_method_has_is_refuted(tmp_path: Path, rmse: float) -> None:
    said = {"schema": "termsel-bench-1",
            "method": {"kind": "model", "name": "affine", "options": {}, "problem": ""},
            "sets": {"frame-1": {"sha256": catalogue.frozen_checksums()["frame-1.csv"],
                                 "rmse": rmse}}}
    (tmp_path / "mine.json").write_text(json.dumps(said))
    (submitted,) = read_submitted(tmp_path)
    assert check(submitted).refuted == ("frame-1",)


def test_what_is_not_installed_is_not_refuted(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said = {"schema": "termsel-bench-1",
            "method": {"kind": "peer", "name": "ransac", "options": {}, "problem": ""},
            "sets": {"frame-1": {"sha256": catalogue.frozen_checksums()["frame-1.csv"],
                                 "rmse": 3.0}}}
    (tmp_path / "ransac.json").write_text(json.dumps(said))
    monkeypatch.setitem(sys.modules, "sklearn.linear_model", None)
    text = run("--check", tmp_path, code=2)
    assert "ransac.json cannot be repeated here: the peer requires scikit-learn" in text
    assert "refuted" not in text


def test_published_results_are_of_these_sets() -> None:
    found = read_submitted(Path(__file__).parents[1] / "results")
    # OpenCV needs a focal length, which no simulated set states.
    assert {one.method.title for one in found} >= {"auto", *PEERS} - {"opencv"}
    assert all(set(one.rmse) == set(SETS) for one in found)


def real(folder: Path, **changes: str | None) -> Path:
    """Write a real set, with some of its declaration changed or left out."""
    scene = simulate_scene("irs1c-mashad", n_lines=0)
    one = folder / "mashad"
    one.mkdir(parents=True)
    termsel.write_points_csv(scene.points, one / "points.csv", crs=scene.crs)
    (one / "LICENSE").write_text("Permission is hereby granted, free of charge, " * 4)
    said = {"title": "Mashad", "kind": "steady", "crs": scene.crs, "points": "points.csv",
            "sha256": hashlib.sha256((one / "points.csv").read_bytes()).hexdigest(),
            "licence": "MIT", "licence_file": "LICENSE", "source": "https://example.org/mashad",
            "commit": "3acac23f4ef1f2d5fb6fe782ef5208cd0b3af802", **changes}
    (one / "set.json").write_text(json.dumps({k: v for k, v in said.items() if v is not None}))
    return one


def test_a_real_set_is_run_next_to_the_others(tmp_path: Path) -> None:
    one = real_set(real(tmp_path))
    assert (len(one.features.points), len(one.independent)) == (40, 22)
    text = run("--model", "affine", "--alone", "--sets", "frame-1", "--real", tmp_path)
    assert "2 of 2: mashad" in text


@pytest.mark.parametrize(("changes", "message"), [
    ({"licence": None}, "does not say its licence"),
    ({"licence_file": "COPYING"}, "no file COPYING"),
    ({"licence_file": "../../LICENSE"}, "no file"),
    ({"source": "a friend"}, "is no address"),
    ({"commit": "3acac23f"}, "the commit '3acac23f' is none"),
    ({"commit": None}, "does not say its commit"),
    ({"sha256": "0" * 64}, "not the declared one")])
def test_a_real_set_without_licence_or_origin_is_refused(
        tmp_path: Path, changes: dict[str, str | None], message: str) -> None:
    real(tmp_path, **changes)
    text = run("--model", "affine", "--alone", "--sets", "frame-1", "--real", tmp_path, code=2)
    assert message in text


def test_a_name_is_no_text_of_a_licence(tmp_path: Path) -> None:
    (real(tmp_path) / "LICENSE").write_text("MIT")
    with pytest.raises(TermselError, match="not the text of a licence"):
        real_set(tmp_path / "mashad")


@pytest.mark.parametrize(("words", "message"), [
    (["--solver", "gaa"], "unknown solver 'gaa'"), (["--model", "afine"], "unknown model 'afine'"),
    (["--package", "no_such_module"], "cannot be imported"),
    (["--package", "json:nothing"], "no function 'nothing'"),
    (["--sets", "moon"], "unknown set 'moon'"), (["--alone"], "no method to run"),
    (["--set", "degree=2"], "--set has no method to set options of"),
    (["--problem", "rfm-terms"], "--problem is for solvers"),
    (["--check", ".", "--alone", "--model", "affine"], "goes with no method")])
def test_bad_requests_are_refused_at_once(
        words: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    text = run(*words, code=2)
    assert message in text
    assert "Traceback" not in text
