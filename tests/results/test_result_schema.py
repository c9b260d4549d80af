"""result.json is what its schema says, whatever the run."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import pytest
from jsonschema import Draft202012Validator

import termsel
from termsel.data.record.record import RESULT_SCHEMA
from termsel.data.record.schema import json_schema

Record = dict[str, Any]

SCHEMA_FILE = json_schema()
VALIDATOR = Draft202012Validator(SCHEMA_FILE)

QUICK = {"population": 30, "polish": False}
RUNS: dict[str, tuple[str, dict[str, Any]]] = {
    "terms by search": ("rfm-terms", {"solver": "ga", "generations": 3}),
    "lines by search": ("owdis-lines", {"generations": 3, "options": QUICK}),
    "lines and terms, one after the other": (
        "owdis-lines-terms", {"generations": 2, "options": {**QUICK, "steps": "terms-first"}}),
    "front": ("rfm-terms", {"solver": "nsga2", "evaluations": 400}),
    "auto": ("rfm-terms", {}),
    "auto without heights": ("poly-terms", {"strategy": "auto"}),
    "exact": ("poly-terms", {"solver": "exact"}),
    "exact, ended early": ("poly-terms", {"solver": "exact", "seconds": 0.1,
                                          "options": {"degree": 6}}),
    "exact of features": ("owdis-points", {"solver": "exact", "seconds": 0.1,
                                           "model": "affine"}),
    "gap to the optimum": ("poly-terms", {"solver": "random", "evaluations": 50}),
    "undetermined": ("rfm-terms", {"solver": "all-terms"}),
    "criterion with options": (
        "poly-terms", {"solver": "ga", "criterion": "press", "generations": 2,
                       "options": {"loss": "huber"}}),
    "given features": ("owdis-points", {
        "generations": 2, "options": {"force_on": "P002", "max_features": 15}}),
}
PLUGGED = {
    "refined RPC": ("termsel_rpc", "rpc-gcps", {"evaluations": 400}),
    "corrected by control": (
        "termsel_hybrids", "poly-terms", {"model": "multiquadric", "solver": "all-terms"}),
}


FEW = termsel.simulate_scene("ikonos-hamedan", roles=(16, 12, 10), n_lines=0)


def _record(problem: str, settings: dict[str, Any]) -> Record:
    # Few points make a run quicker; where features are selected, they are those of the example.
    features = FEW if problem in ("rfm-terms", "poly-terms") else None
    return dict(json.loads(termsel.run(problem, seed=1, features=features, **settings).to_json()))


def _faults(record: Record) -> list[str]:
    return [f"{error.json_path}: {error.message}" for error in VALIDATOR.iter_errors(record)]


@pytest.fixture(scope="module")
def record() -> Record:
    return _record("owdis-lines", {"generations": 3, "options": QUICK})


def test_schema_is_a_schema() -> None:
    Draft202012Validator.check_schema(SCHEMA_FILE)
    assert SCHEMA_FILE["properties"]["schema"]["enum"] == [SCHEMA_FILE["$id"]] == [RESULT_SCHEMA]


def test_every_key_has_a_description() -> None:
    def look(part: Any, path: str) -> None:
        if isinstance(part, dict):
            for key, value in part.get("properties", {}).items():
                assert value.get("description"), f"{path}.{key}"
            for key, value in part.items():
                look(value, f"{path}.{key}")

    look(SCHEMA_FILE, "$")


@pytest.mark.slow_cases(
    "auto without heights", "lines and terms, one after the other", "lines by search")
@pytest.mark.parametrize(("problem", "settings"), RUNS.values(), ids=RUNS)
def test_record_of_a_run(problem: str, settings: dict[str, Any]) -> None:
    assert _faults(_record(problem, settings)) == []


@pytest.mark.parametrize(("package", "problem", "settings"), PLUGGED.values(), ids=PLUGGED)
def test_record_under_a_plugin(package: str, problem: str, settings: dict[str, Any]) -> None:
    if find_spec(package) is None:
        pytest.skip(f"{package} is not installed")
    assert _faults(_record(problem, settings)) == []


@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")
def test_record_of_a_fit_in_other_coordinates() -> None:
    pytest.importorskip("pyproj")
    record = _record("poly-terms", {"model": "poly3d", "solver": "random", "evaluations": 40,
                                    "options": {"fit_crs": "geocentric"}})
    assert "fit_crs" in record["scaling"]
    assert _faults(record) == []


def _set(*path: Any, value: Any) -> Callable[[Record], None]:
    def change(record: Record) -> None:
        part: Any = record
        for key in path[:-1]:
            part = part[key]
        part[path[-1]] = value

    return change


BROKEN: dict[str, Callable[[Record], None]] = {
    "a key is missing": lambda record: record.pop("judgement"),
    "a key is unknown": _set("precision", value=1.0),
    "another layout": _set("schema", value="termsel-result-2"),
    "a number as text": _set("rmse", "check", "total", value="0.83"),
    "a role that is none": _set("rmse", "off", value={"line": 1, "sample": 1, "total": 1, "n": 1}),
    "an unknown role of a baseline": _set("baselines", 0, "fitted_to", value=["off"]),
    "a negative count": _set("evaluations", value=-1),
    "a share above 1": _set("hit_rate", value=1.5),
    "a checksum cut short": _set("checksums", "record", value="abc"),
    "a feature selected twice": _set("selection", "features", value=["L001", "L001"]),
    "a scale of 0": _set("scaling", "x_scale", value=0),
    "a certificate without proof": _set("certificate", value={"optimal": True}),
}


@pytest.mark.parametrize("change", BROKEN.values(), ids=BROKEN)
def test_broken_record_is_refused(record: Record, change: Callable[[Record], None]) -> None:
    broken = copy.deepcopy(record)
    change(broken)
    assert _faults(broken)
