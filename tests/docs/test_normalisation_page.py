"""The page on origin and scale: what it says of the theory holds, and its rows are of this code."""

from __future__ import annotations

import re

import pytest

from benchmarks.normalisation import SPACES, WAYS, by_hierarchy, optimum
from benchmarks.sets import ROOT


@pytest.mark.parametrize(("factor", "shift"), [(0.5, 0.0), (1.0, 1.0)])
def test_the_optimum_with_a_hierarchy_is_that_of_any_coordinates(
        factor: float, shift: float) -> None:
    _, name, model, options = SPACES[0]
    check, independent, terms = optimum(name, model, {**options, "hierarchy": True}, None,
                                        1.0, 0.0)
    moved = optimum(name, model, {**options, "hierarchy": True}, None, factor, shift)
    assert moved[:2] == pytest.approx((check, independent), rel=1e-8)
    assert moved[2] == terms


@pytest.mark.parametrize("space", range(len(SPACES)))
def test_a_row_of_the_page_is_what_a_fresh_run_gives(space: int) -> None:
    page = (ROOT / "docs" / "evidence" / "normalisation.md").read_text(encoding="utf-8")
    title, name, model, options = SPACES[space]
    way, factor, shift = WAYS[-1]
    table = page[page.index(title[1:]):]
    row = re.search(rf"^\| {re.escape(way)} \| ([\d.]+); .* \| ([\d.]+); ", table, re.MULTILINE)
    assert row is not None
    for hierarchy, stated in zip((False, True), row.groups(), strict=True):
        fresh = optimum(name, model, {**options, "hierarchy": hierarchy}, None, factor, shift)
        assert f"{fresh[0]:.4f}" == stated


@pytest.mark.slow
def test_a_row_of_iterated_adjustments_is_what_a_fresh_run_gives() -> None:
    page = (ROOT / "docs" / "evidence" / "normalisation.md").read_text(encoding="utf-8")
    table = page[page.index("## RFM of second order, each selection iterated"):]
    check, _, terms = by_hierarchy(None, 1.0, 1.0, iterated=True)
    row = re.search(rf"^\| {re.escape(WAYS[-1][0])} \|.*\| ([\d.]+); [^|]*\| (\d+) %", table,
                    re.MULTILINE)
    assert row is not None
    assert (f"{check:.4f}", row[2]) == (row[1], "100")
    assert terms == by_hierarchy(None, 1.0, 0.0, iterated=True)[2]


@pytest.mark.slow
def test_iterated_adjustments_of_a_scene_do_not_depend_on_the_origin() -> None:
    # The linear solution of this scene's optimum has a pole at the other origin.
    here, there = (by_hierarchy(102, 1.0, shift, iterated=True) for shift in (0.0, 0.5))
    assert there[:2] == pytest.approx(here[:2], rel=1e-4)
    assert there[2] == here[2]
