"""The order of rows in a file decides nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import termsel
from termsel.data.features import FeatureSet, Points
from termsel.data.roles import sorted_by_id

SMALL = {"population": 30, "polish": False}


def shuffled(features: FeatureSet) -> FeatureSet:
    rng = np.random.default_rng(5)
    points = features.points.take(rng.permutation(len(features.points)))
    lines = features.lines
    if not len(lines):
        return features.with_(points=points)
    order = [row for name in rng.permutation(lines.features)
             for row, other in enumerate(lines.ids) if other == name]
    return features.with_(points=points, lines=lines.take(order))


@pytest.mark.slow_cases(
    "owdis-lines-{'generations': 5, 'options': {'population': 30, 'polish': False}}",
    "rfm-terms-{'options': {'roles': 'random'}}")
@pytest.mark.parametrize(("problem", "given"), [
    ("rfm-terms", {"solver": "ridge"}),
    ("rfm-terms", {"generations": 3, "criterion": "kfold", "options": {**SMALL, "how": "random"}}),
    ("owdis-points", {"generations": 5, "options": SMALL}),
    ("owdis-lines", {"generations": 5, "options": SMALL}),
    ("rfm-terms", {"options": {"roles": "random"}})], ids=str)
def test_the_order_of_rows_changes_no_digit(problem: str, given: dict[str, Any]) -> None:
    scene = termsel.simulate_scene("ikonos-hamedan", n_points=50)
    records = [termsel.run(problem, features=one, **given).to_dict()
               for one in (scene, shuffled(scene))]
    for record in records:
        record.pop("seconds")
        record["data"].pop("sha256")
        record["data"].pop("read")
    assert records[0] == records[1]


def test_numbers_in_ids_count_as_numbers() -> None:
    names = ("P10", "P2", "P02", "b", "P1", "9", "10", "P2b", "P1_10", "P1_9", f"P{'9' * 60}")
    points = Points(names, np.arange(22.0).reshape(11, 2), np.arange(33.0).reshape(11, 3))
    assert sorted_by_id(FeatureSet(points)).points.ids == (
        "9", "10", "P1", "P1_9", "P1_10", "P02", "P2", "P2b", "P10", f"P{'9' * 60}", "b")
