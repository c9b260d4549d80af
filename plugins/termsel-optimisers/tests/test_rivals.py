"""The solvers of termsel-optimisers, as installed."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("termsel_optimisers", reason="termsel-optimisers is not installed: "
                    "pip install -e plugins/termsel-optimisers")

import termsel
from termsel import TermselError, write_result
from termsel.testing import Check, checks
from termsel.toolkit import registry
from termsel_optimisers import AntColony, Lasso, NestedRegression, Stepwise, TransgenicGA, TTest

NEEDS_COLUMNS = {"any_problem": "it needs the columns of an adjustment",
                 "optimum_found": "it does not search"}
CHECKS = {
    "aco": checks(AntColony, options=[{}, {"population": 21, "restart": 0.0}]),
    "ga-transgenic": checks(TransgenicGA, options=[{}, {"population": 21}]),
    **{one.name: checks(one, expected_failures=NEEDS_COLUMNS)
       for one in (Lasso, NestedRegression, Stepwise, TTest)},
}


@pytest.mark.parametrize("check", [
    pytest.param(check, id=f"{name}-{i}-{check.name}")
    for name, suite in CHECKS.items() for i, check in enumerate(suite)])
def test_conforms(check: Check) -> None:
    check.run()


@pytest.mark.parametrize("name", CHECKS)
def test_is_registered_and_runs(name: str) -> None:
    entry = next(e for e in registry().entries("solvers") if e.name == name)
    assert entry.provided_by == "termsel-optimisers"
    result = termsel.run("poly-terms", solver=name, seed=1, evaluations=60,
                         options={"degree": 2})
    assert result.feasible
    assert result.to_dict()["plugins"]["solver"]["name"] == f"termsel-optimisers:{name}"


@pytest.mark.parametrize("name", CHECKS)
def test_without_the_package_its_name_is_said(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERMSEL_PLUGINS", "")
    message = r"package termsel-optimisers, which is installed, but left out by .* TERMSEL_PLUGINS"
    with pytest.raises(TermselError, match=message):
        type(registry())().get("solvers", name)


@pytest.mark.parametrize(("name", "options"), [
    ("rfm-terms", {}), ("poly-terms", {"degree": 5, "mask": "shared"})])
def test_nested_regression_of_embedded_scenes(name: str, options: dict[str, object]) -> None:
    result = termsel.run(name, solver="nested-regression", options=options)
    assert result.feasible
    assert result.evaluations == 1


@pytest.mark.parametrize("solver", CHECKS)
def test_what_is_read_again_is_what_the_run_returned(solver: str, tmp_path: Path) -> None:
    result = termsel.run("poly-terms", solver=solver, seed=1, evaluations=60,
                         options={"degree": 2})
    write_result(result, tmp_path)
    again = termsel.read_result(tmp_path)
    assert again.to_json() == result.to_json()
    assert again.to_dict() == result.to_dict()
    assert again.fit.coefficients == result.fit.coefficients
