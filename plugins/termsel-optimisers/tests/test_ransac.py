"""RANSAC as a method: it does what every method does, and wrong points do not move it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import termsel
from termsel import FeatureSet, TermselError
from termsel.testing import checks
from termsel_optimisers import Ransac


@pytest.mark.parametrize("check", checks(Ransac(trials=200)), ids=lambda check: check.name)
def test_it_does_what_every_method_does(check: object) -> None:
    check.run()  # type: ignore[attr-defined]


def scene(wrong: int) -> FeatureSet:
    """Return 30 points without roles of which some are 200 px off."""
    points = termsel.simulate_scene("ikonos-hamedan", n_points=30, n_lines=0).points
    image = points.image.copy()
    image[:wrong] += 200.0
    return FeatureSet(replace(points, image=image, roles=()), crs="EPSG:4979")


def test_points_far_from_all_others_take_no_part() -> None:
    clean, dirty = scene(0), scene(6)
    ransac = Ransac()
    fitted = termsel.fit(dirty, ransac)
    assert not fitted.used[:6].any()
    assert fitted.used[6:].sum() > 15
    np.testing.assert_allclose(fitted.project(clean.points.ground),
                               clean.points.image, atol=15.0)


def test_a_run_takes_it_by_its_name_and_auto_leaves_it_alone() -> None:
    result = termsel.run(features=scene(0), method="ransac")
    assert result.strategy is not None
    assert result.strategy.chosen == "ransac"
    assert "ransac" not in [method.name for method in termsel.Auto().methods]


def test_points_that_agree_on_nothing_are_refused() -> None:
    points = scene(0).points
    noise = np.random.default_rng(1).uniform(0.0, 1e4, points.image.shape)
    with pytest.raises(TermselError, match="no polynomial of RANSAC passes within 5 px"):
        termsel.fit(FeatureSet(replace(points, image=noise)), Ransac())
