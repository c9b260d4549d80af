"""Terms that are forced, capped, or kept with their parents."""

from __future__ import annotations

import re

import numpy as np
import pytest

import termsel
from termsel.models.polynomial import Polynomial3D
from termsel.problems.wishes import parents


def run(problem: str = "poly-terms", **options: object) -> termsel.Result:
    solver = options.pop("solver", None)
    if solver == "exact":
        return termsel.run(problem, solver="exact", options=options)
    return termsel.run(problem, solver=solver, generations=6,
                       options={"population": 40, **options})


@pytest.mark.parametrize("solver", ["ga", "exact"])
def test_forced_terms_are_in_every_selection(solver: str) -> None:
    options = {"degree": 3, "force_on": "num:1, X", "force_off": "line.num:Y2,X2Y"}
    found = run(solver=solver, **options)
    terms = set(found.selection.terms)
    assert {"line.num:1", "sample.num:1", "line.num:X", "sample.num:X"} <= terms
    assert not {"line.num:Y2", "line.num:X2Y", "sample.num:X2Y"} & terms


def test_forced_terms_of_a_mask_for_both_axes() -> None:
    found = run(degree=3, mask="shared", force_on="num:X3", force_off="Y3")
    assert {"line.num:X3", "sample.num:X3"} <= set(found.selection.terms)
    assert not {"line.num:Y3", "sample.num:Y3"} & set(found.selection.terms)


@pytest.mark.parametrize(("options", "message"), [
    ({"force_on": "W"}, "unknown term 'W'"),
    ({"force_on": "X", "force_off": "line.num:X"}, "always on and always off"),
    ({"max_share": 2}, "0 to 1"), ({"max_share": 0.0, "force_on": "X"}, "forced genes")])
def test_wishes_that_cannot_be_are_refused(options: dict, message: str) -> None:
    with pytest.raises(termsel.TermselError, match=message):
        run(**options)


def test_a_term_has_its_parents() -> None:
    terms = Polynomial3D(degree=3).terms
    pairs = {(terms[c], terms[p]) for c, p in zip(*parents(terms), strict=True)}
    assert ("line.num:X2Y", "line.num:XY") in pairs
    assert ("line.num:X2Y", "line.num:X2") in pairs
    assert ("line.num:X", "line.num:1") in pairs
    assert ("line.num:XYZ", "line.num:YZ") in pairs
    assert not any(child.endswith(":1") for child, _ in pairs)
    assert all(child.split(":")[0] == parent.split(":")[0] for child, parent in pairs)


def test_hierarchy_leaves_no_orphans() -> None:
    found = run("rfm-terms", hierarchy=True)
    assert found.feasible
    names = found.fit.model.terms
    chosen = np.isin(names, found.selection.terms)
    child, parent = parents(names)
    assert not (chosen[child] & ~chosen[parent]).any()


def test_hierarchy_cannot_be_walked() -> None:
    with pytest.raises(termsel.TermselError, match="this solver needs"):
        run(solver="exact", degree=2, hierarchy=True)


@pytest.mark.parametrize("solver", ["ga", "exact"])
def test_no_more_terms_than_the_share(solver: str) -> None:
    found = run(solver=solver, degree=4, max_share=0.25)
    counts = [sum(term.startswith(axis) for term in found.selection.terms)
              for axis in ("line", "sample")]
    assert max(counts) <= 24 // 4


def test_coefficients_are_shrunk_after_the_selection() -> None:
    given = {"model": "poly3d", "solver": "all-terms"}
    plain, shrunk = (termsel.run("rfm-terms", options={"degree": 3, "shrink": shrink}, **given)
                     for shrink in (False, True))
    assert plain.selection == shrunk.selection
    order = np.array([sum(int(power or 1) for power in re.findall(r"[XYZ](\d?)", name))
                      for name in plain.fit.model.terms])
    one, other = (found.fit.adjustment.coefficients for found in (plain, shrunk))
    assert np.linalg.norm(other[order == 3]) < np.linalg.norm(one[order == 3])
    np.testing.assert_allclose(other[order == 1], one[order == 1], rtol=0.02, atol=5e-3)
    assert shrunk.rmse["independent"].total < plain.rmse["independent"].total
    assert not shrunk.objectives


def test_with_nothing_to_shrink_it_is_least_squares() -> None:
    given = {"model": "affine", "solver": "all-terms"}
    plain, shrunk = (termsel.run("rfm-terms", options={"shrink": shrink}, **given)
                     for shrink in (False, True))
    np.testing.assert_allclose(shrunk.fit.adjustment.coefficients,
                               plain.fit.adjustment.coefficients, atol=1e-10)
