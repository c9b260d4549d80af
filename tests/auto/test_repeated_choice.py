"""What the choice is repeated on in each fold."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from termsel.auto import repetition
from termsel.auto.portfolio import Portfolio, choose_features
from termsel.data.control import Control
from termsel.data.features import FeatureSet, Points


def points(n: int, heights: dict[int, float]) -> Control:
    """Return an affine image of a plain with a few heights."""
    rng = np.random.default_rng(2)
    ground = np.column_stack([rng.uniform(0, 8000, (n, 2)), np.zeros(n)])
    for i, height in heights.items():
        ground[i, 2] = height
    image = ground @ [[0.1, 0.02], [-0.02, 0.1], [0.03, 0.01]] + rng.normal(0, 0.3, (n, 2))
    return Control.of(FeatureSet(Points(tuple(map(str, range(n))), image, ground), crs="local"))


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[Control]:
    """The control that each fold chooses by."""
    seen: list[Control] = []

    def spying(control: Control, *more: Any, **options: Any) -> Any:
        seen.append(control)
        return choose_features(control, *more, **options)

    monkeypatch.setattr(repetition, "choose_features", spying)
    return seen


def test_relief_that_one_point_of_the_others_carries_tells_nothing_of_those_held_out(
        asked: list[Control]) -> None:
    assert repetition.repeated(points(14, {3: 300.0, 9: 250.0})) is not None
    known = {frozenset({"3", "9"}) - set(one.features.ids): one.heights for one in asked}
    assert len(asked) == 14
    assert known == {frozenset(): True, frozenset({"3"}): False, frozenset({"9"}): False}


def test_no_fold_chooses_by_fewer_features_than_a_choice_takes(asked: list[Control]) -> None:
    few = points(6, {0: 50.0, 1: 200.0, 2: 120.0, 4: 80.0})
    least = Portfolio().least(few)
    for n in (least, least + 1):
        repetition.repeated(few.take(np.arange(6) < n))
    assert {len(one) for one in asked} == {least}
