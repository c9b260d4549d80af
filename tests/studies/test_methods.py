"""Studies of methods that need no search, next to the automatic choice and to searches."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import termsel
from termsel.core.errors import TermselError
from termsel.data.features import FeatureSet
from termsel.studies.plan.spec import spec_of


@pytest.fixture(scope="module")
def scene() -> FeatureSet:
    scene = termsel.simulate_scene("ikonos-hamedan", n_points=14, n_lines=0)
    return FeatureSet(replace(scene.points, roles=()), crs=scene.crs)



def middle(features: FeatureSet) -> object:
    """Project every place into the middle of the control."""
    return lambda ground: np.tile(features.points.image.mean(axis=0), (len(ground), 1))


def test_methods_by_name_and_as_objects_are_cells(scene: FeatureSet, tmp_path: Path) -> None:
    mine = termsel.FunctionMethod("middle", "the middle of the control", function=middle)
    study = termsel.compare(methods=["affine", mine], data={"a": scene}, out=tmp_path / "study")
    rows = {row["solver"]: row for row in study.rows}
    assert rows.keys() == {"affine", "middle"}
    assert {row["state"] for row in study.rows} == {"done"}
    assert rows["affine"]["chosen"] == "affine"
    assert rows["affine"]["predicted"] < rows["middle"]["predicted"]


def test_methods_go_with_searches() -> None:
    spec = spec_of({"methods": ["affine"], "solvers": ["ga"], "problems": ["poly-terms"]})
    assert spec.strategies == ("as-asked", "auto")


@pytest.mark.parametrize(("table", "words"), [
    ({"methods": ["affine"], "strategies": ["as-asked"]}, "as-asked runs solvers"),
    ({"methods": [{"name": "affine", "degree": 2}]}, "takes no options")])
def test_methods_that_fit_with_nothing_are_refused(table: dict[str, object], words: str) -> None:
    with pytest.raises(TermselError, match=words):
        spec_of(table)


def test_a_name_that_no_method_has_is_refused(scene: FeatureSet, tmp_path: Path) -> None:
    with pytest.raises(TermselError, match="unknown method 'nonsense'"):
        termsel.compare(methods=["nonsense"], data={"a": scene}, out=tmp_path / "study")
