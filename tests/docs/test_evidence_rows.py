"""A sampled row of the pages on accuracy, maps, intervals, lines, blunders and matches, run anew.

Rows are of simulated sets, so that no data from elsewhere are needed. Figures have the digits of
their pages; the last one may differ between machines.
"""

from __future__ import annotations

import re
from statistics import median

import numpy as np
import pytest

import termsel
from benchmarks import accuracy, blunders, coverage, lines, old_maps
from benchmarks.papers import konugurthi
from benchmarks.sets import rmse_of, split
from termsel.auto.auto import Auto
from termsel.auto.rule import FitData
from termsel.data.features import FeatureSet
from tests.docs.test_evidence_pages import PAGES, row


def agrees(value: float, said: str) -> bool:
    """Return whether a figure is that of a page, but for one in its last digit."""
    digits = len(said.partition(".")[2])
    return abs(value - float(said)) <= 1.01 * 10.0**-digits


def splits(page: str) -> int:
    """Return of how many splits a page is made."""
    said = re.search(r"(\d+) splits of each set", (PAGES / f"{page}.md").read_text())
    assert said is not None
    return int(said[1])


def test_auto_and_the_best_plain_structure_of_a_scene() -> None:
    cells = row("honest-accuracy", r"ikonos-hamedan \| 20 \|")
    auto, quadratic = [], []
    for seed in range(splits("honest-accuracy")):
        mine, others = split("ikonos-hamedan", 20, seed)
        choice = Auto().choose(FitData.of(FeatureSet(mine)))
        assert choice is not None
        auto.append(rmse_of(choice.chosen.errors(others)))
        quadratic.append(rmse_of(termsel.fit(FeatureSet(mine), "poly3d", degree=2)
                                 .errors(others)))
    assert cells[2] == "quadratic, space"
    assert agrees(median(quadratic), cells[3])
    assert agrees(median(auto), cells[4])
    assert len(others) >= accuracy.FEWEST


def test_an_old_map_with_twenty_points() -> None:
    cells = row("old-maps", r"old-map \| 20 \|")
    count = splits("old-maps")
    each = [old_maps.measure("old-map", 20, seed) for seed in range(count)]
    fresh = old_maps.Row("old-map", 20, tuple(one for one in each if one is not None))
    assert len(fresh.splits) == count
    assert fresh.best[0] == cells[2]
    assert agrees(fresh.best[1], cells[3])
    assert agrees(median(one.auto for one in fresh.splits), cells[4])


@pytest.mark.slow
def test_intervals_of_an_agile_scanner() -> None:
    cells = row("coverage", r"camera: agile \|")
    held, count = 0, splits("coverage")
    for seed in range(coverage.FIRST_SPLIT, coverage.FIRST_SPLIT + count):
        one = coverage.case("camera: agile", 12, seed)
        assert one is not None
        held += one["predicted"]["low"] <= one["rmse"] <= one["predicted"]["high"]
    assert cells[2] == f"{held} of {count}"


@pytest.mark.slow
def test_the_best_structure_of_a_scene_with_lines() -> None:
    cells = row("lines", r"spot-plain \|")
    best = []
    for seed in range(5):
        features, wrong = lines.load("spot-plain", seed)
        observations = lines.observe(features, control="both", rng=np.random.default_rng(0))
        best.append(min(lines._told(observations, wrong).values()))
    assert agrees(median(best), cells[1])


@pytest.mark.slow
def test_peers_with_one_blunder_in_fifteen() -> None:
    cells = row("blunders", r"ikonos-hamedan \| 24 \|")
    found = [blunders.measure(("ikonos-hamedan", 24, seed, 1 / 15)) for seed in range(2)]
    for peer, said in zip(blunders.PEERS, cells[8:12], strict=True):
        assert agrees(median(one.peers[peer] for one in found if one is not None), said)


@pytest.mark.slow
def test_matches_without_blunders() -> None:
    cells = row("paper-konugurthi", r"0 % \|")
    found = konugurthi.GSD * np.array([konugurthi.one_scene(0.0, seed)[:5]
                                       for seed in range(1, konugurthi.RUNS + 1)])
    for value, worst, said in zip(np.median(found, axis=0), found.max(axis=0), cells[1:6],
                                  strict=True):
        assert agrees(value, said.split(" ")[0])
        assert agrees(worst, said.split(" ")[1].strip("()"))


