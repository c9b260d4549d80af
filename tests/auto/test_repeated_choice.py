"""What the choice is repeated on in each fold."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from termsel.auto.auto import Auto
from termsel.data.features import FeatureSet, Points
from termsel.data.fit_data import FitData


def points(n: int, heights: dict[int, float]) -> FitData:
    """Return an affine image of a plain with a few heights."""
    rng = np.random.default_rng(2)
    ground = np.column_stack([rng.uniform(0, 8000, (n, 2)), np.zeros(n)])
    for i, height in heights.items():
        ground[i, 2] = height
    image = ground @ [[0.1, 0.02], [-0.02, 0.1], [0.03, 0.01]] + rng.normal(0, 0.3, (n, 2))
    return FitData.of(FeatureSet(Points(tuple(map(str, range(n))), image, ground), crs="local"))


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[FitData]:
    """The control that each fold chooses by."""
    seen: list[FitData] = []

    choose_features = Auto.choose_features

    def spying(auto: Auto, data: FitData, *more: Any, **options: Any) -> Any:
        seen.append(data)
        return choose_features(auto, data, *more, **options)

    monkeypatch.setattr(Auto, "choose_features", spying)
    return seen


def test_relief_that_one_point_of_the_others_carries_tells_nothing_of_those_held_out(
        asked: list[FitData]) -> None:
    assert Auto().repeated(points(14, {3: 300.0, 9: 250.0})) is not None
    known = {frozenset({"3", "9"}) - set(one.features.ids): one.heights for one in asked}
    assert len(asked) == 14
    assert known == {frozenset(): True, frozenset({"3"}): False, frozenset({"9"}): False}


def test_no_fold_chooses_by_fewer_features_than_a_choice_takes(asked: list[FitData]) -> None:
    few = points(6, {0: 50.0, 1: 200.0, 2: 120.0, 4: 80.0})
    least = Auto().fewest(few)
    for n in (least, least + 1):
        Auto().repeated(few.take(np.arange(6) < n))
    assert {len(one) for one in asked} == {least}
