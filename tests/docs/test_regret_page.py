"""The page on proofs of other criteria: a row of it, run anew, and what its search rests on."""

from __future__ import annotations

from statistics import median

import numpy as np
import pytest

import termsel
from benchmarks import regret
from benchmarks.new_points import scene
from benchmarks.sets import rmse_of
from tests.docs.test_evidence_pages import row


@pytest.mark.slow
def test_a_row_of_the_page_is_what_a_fresh_run_gives() -> None:
    cells = row("regret", r"`press`, proven")
    found = [regret.judged(features, regret.proven(features, "press").selection.terms)
             for features in map(scene, regret.SEEDS)]
    assert f"{median(one[0] for one in found):.3f}" == cells[2]
    assert f"{median(one[1] for one in found):.0f}" == cells[1]


def test_selections_are_judged_by_control_and_check_points_together() -> None:
    features = scene(301)
    points = features.points
    roles = np.array(points.roles)
    terms = tuple(f"{axis}.num:{name}" for axis in ("line", "sample") for name in ("1", *"XYZ"))
    known = points.take(roles != "independent")
    fitted = termsel.fit(termsel.FeatureSet(
        termsel.Points(known.ids, known.image, known.ground), crs=features.crs), "affine")
    errors = fitted.errors(points.take(roles == "independent"))
    assert regret.judged(features, terms) == pytest.approx((rmse_of(errors), 8))


def test_joint_optima_are_no_worse_than_those_of_a_part() -> None:
    # Two subsets of features, three selections of terms; the last ones are all.
    check = np.array([[[4.0, 1.0, 2.0], [3.0, 2.0, 5.0]], [[1.0, 9.0, 2.0], [7.0, 0.5, 5.0]]])
    new = np.array([[[1.0, 8.0, 2.0], [2.0, 2.0, 2.0]], [[6.0, 1.0, 2.0], [3.0, 4.0, 2.0]]])
    whole = {"terms": np.array([False, False, True]), "features": np.array([False, True])}
    found = regret._optima(np.stack([check, new]), whole, 1.0, (1, 1))
    assert found["all terms, all features"] == pytest.approx((10**0.5, 2.0))
    assert found["terms, by check-rmse"] == pytest.approx((2.5**0.5, 6**0.5))
    assert found["features, by check-rmse"] == pytest.approx((2.0, 2.0))
    # Line takes its second selection, sample its first, under the first subset.
    assert found["terms and features, by check-rmse"] == pytest.approx((2**0.5, 14**0.5))
    assert found["the best in hindsight"] == pytest.approx((13**0.5, 2**0.5))
