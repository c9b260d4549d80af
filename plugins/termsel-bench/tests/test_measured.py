"""The measured sets: their files, their folds, and how a method is judged on them."""

from __future__ import annotations

import hashlib
import json
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("termsel_bench", reason="termsel-bench is not installed: "
                    "pip install -e plugins/termsel-bench")

from termsel import TermselError
from termsel.testing import invoke
from termsel_bench.methods.base import Method
from termsel_bench.protocol import Work, score_work
from termsel_bench.scenes import measured as suite
from termsel_bench.scenes.measured import SOURCES, draw_folds, measured_names, read_measured_set

ALLOWED = {"CC0-1.0", "BSD-3-Clause", "Unlicense"}


def run(*words: object, code: int = 0) -> str:
    """Return what the command prints."""
    result = invoke("bench", *map(str, words))
    assert result.exit_code == code, result.output
    return result.output


def test_all_files_are_the_published_ones_under_a_licence() -> None:
    assert len(measured_names()) == 133
    for source in SOURCES:
        folder = files("termsel_bench") / "measured" / source.folder
        meta = json.loads((folder / "meta.json").read_bytes())
        assert meta["licence"] in ALLOWED
        assert len(meta["commit"]) == 40
        assert len((folder / "LICENSE").read_bytes()) > 1000
        for name, checksum in meta["sha256"].items():
            assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == checksum


def test_folds_are_frozen() -> None:
    text = (files("termsel_bench") / "measured" / "folds.json").read_bytes()
    assert json.loads(text) == draw_folds()


@pytest.mark.parametrize("name", ["measured-map-001", "measured-photo-042"])
def test_each_point_is_hidden_once(name: str) -> None:
    one = read_measured_set(name)
    hidden_ids: list[str] = []
    for fold in range(one.trials):
        seen, hidden = one.trial(fold)
        assert not set(seen.points.ids) & set(hidden.ids)
        assert len(seen.points) + len(hidden) == len(one.features.points)
        hidden_ids += hidden.ids
    assert sorted(hidden_ids) == sorted(one.features.points.ids)


def test_of_matches_a_method_sees_one_fold() -> None:
    one = read_measured_set("measured-matches-001")
    sizes = {len(one.trial(fold)[0].points) for fold in range(one.trials)}
    assert sizes == {86, 87}


def test_a_score_is_the_median_distance_of_all_hidden_points() -> None:
    method = Method("model", "helmert2d")
    one = read_measured_set("measured-map-003")
    distances: list[float] = []
    for fold in range(one.trials):
        seen, hidden = one.trial(fold)
        errors = method.positions(seen, hidden, 1) - hidden.image
        distances += np.hypot(*errors.T).tolist()
    found = score_work(Work(method, one.name))
    assert found.rmse == pytest.approx(np.median(distances))
    assert found.low <= found.rmse <= found.high
    assert found.independent == len(one.features.points)


def test_a_method_that_fails_in_a_fold_has_no_result() -> None:
    found = score_work(Work(Method("peer", "ransac"), "measured-photo-002"))
    assert found.rmse == float("inf")
    assert "requires more than" in found.why


def test_a_search_of_terms_makes_check_points_where_there_are_no_roles() -> None:
    assert score_work(Work(Method("peer", "deap-script"), "measured-map-017")).rmse < 1000
    of_photo = score_work(Work(Method("peer", "deap-script"), "measured-photo-002"))
    assert "fewer terms than its 3 control points" in of_photo.why


def test_a_method_is_told_the_focal_length_of_a_photo() -> None:
    photo = read_measured_set("measured-photo-001")
    seen, _hidden = photo.trial(0)
    assert set(seen.points.attributes[suite.FOCAL_COLUMN]) == {"3131.847740584272"}
    assert photo.features.image_size == (1407, 1500)
    with pytest.raises(TermselError, match="the set states none"):
        Method("peer", "opencv").positions(read_measured_set("measured-map-001").features,
                                           seen.points, 1)


def test_the_suite_is_run_and_its_results_are_repeated(tmp_path: Path) -> None:
    words = ("--suite", "measured", "--sets", "measured-map-001", "--model", "helmert2d", "--alone",
             "--out", tmp_path)
    text = run(*words)
    assert "median error of hidden points" in text
    content = json.loads((tmp_path / "model-helmert2d.json").read_text())
    assert list(content["sets"]) == ["measured-map-001"]
    assert "confirmed" in run("--check", tmp_path)
    # Sets may be named as in the run that made the file; the suite is that of the file.
    assert "confirmed" in run("--suite", "measured", "--sets", "map-001", "--check", tmp_path)
    assert "confirmed" in run("--quick", "--sets", "measured-map", "--check", tmp_path)
    content["sets"]["measured-map-001"]["rmse"] *= 1.1
    (tmp_path / "model-helmert2d.json").write_text(json.dumps(content))
    assert "refuted: measured-map-001" in run("--check", tmp_path, code=2)


def test_files_of_the_suite_have_licences_folds_and_a_description(tmp_path: Path) -> None:
    run("--suite", "measured", "--quick", "--files", tmp_path)
    described = json.loads((tmp_path / "croissant.json").read_text())
    for file in described["distribution"]:
        content = (tmp_path / file["contentUrl"]).read_bytes()
        assert hashlib.sha256(content).hexdigest() == file["sha256"]
    names = {file["name"] for file in described["distribution"]}
    assert {f"{source.folder}/LICENSE" for source in SOURCES} <= names
    assert "folds.json" in names
    assert len(described["recordSet"]) == 3
    formats = {file["@id"]: file["encodingFormat"] for file in described["distribution"]}
    for records in described["recordSet"]:
        for field in records["field"]:
            assert formats[field["source"]["fileObject"]["@id"]] == "text/csv"


def test_another_file_and_an_unknown_set_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(TermselError, match="unknown set"):
        read_measured_set("measured-map-099")
    with pytest.raises(TermselError, match="no measured set 'radar'"):
        measured_names("radar")
    changed = dict(suite._read_meta("slv_maps"))
    changed["sha256"] = dict.fromkeys(changed["sha256"], "0" * 64)
    monkeypatch.setattr(suite, "_read_meta", lambda _folder: changed)
    read_measured_set.cache_clear()
    with pytest.raises(TermselError, match="not that of the published file"):
        read_measured_set("measured-map-002")
