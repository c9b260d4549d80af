"""A model that is named alone is fitted to all control, with all its terms, and held out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import termsel
from termsel.data.features import FeatureSet
from termsel.plugins.registry import registry

Call = Callable[..., SimpleNamespace]


def satellite(count: int) -> FeatureSet:
    """Points of a satellite image, without roles."""
    scene = termsel.simulate_scene("ikonos-hamedan", n_points=count, n_lines=0)
    return FeatureSet(replace(scene.points, roles=()), crs=scene.crs)


@pytest.mark.parametrize(("model", "options", "terms"), [
    ("affine", {}, 8), ("dlt3d", {}, 11), ("poly3d", {"degree": 2}, 20),
    ("poly2d", {"degree": 3}, 20), ("poly2d", {"degree": 1, "powers": "each"}, 8),
    ("rfm", {"order": 1}, 14), ("helmert2d", {}, 4), ("dlt3d", {"weighted": False}, 11)])
def test_all_terms_are_fitted_to_all_points(model: str, options: dict[str, Any],
                                            terms: int) -> None:
    features = satellite(24)
    result = termsel.run(features=features, model=model, options=options)
    assert result.model == model
    assert result.solver == "auto"  # no search
    assert (result.data.counts.control, result.data.counts.check) == (24, 0)
    assert result.selection.n_terms == result.offered.n_terms == terms
    assert result.selection.n_features == 24
    assert f", all {terms} terms" in result.summary()
    assert "24 points to fit the model" in result.summary()
    # The leave-one-out figure is that of the same fit by the verb of Python.
    assert result.strategy is not None
    (row,) = result.strategy.candidates
    if model == "dlt3d" and not options:  # the distances of the built-in method, not the equations
        options = {"weighted": True}
    fitted = termsel.fit(features, model, **options)
    assert row.predicted == pytest.approx(fitted.leave_one_out_rmse().total, rel=1e-4)
    assert result.predicted is not None


@pytest.mark.parametrize(("model", "count", "size", "terms"), [
    ("poly2d", 10, ("degree", 2), 12), ("poly2d", 18, ("degree", 4), 30),
    ("poly3d", 8, ("degree", 1), 8), ("poly3d", 4, ("degree", 1), 8),
    ("rfm", 12, ("order", 1), 14)])
def test_a_degree_that_nobody_gave_is_as_high_as_the_points_determine(
        model: str, count: int, size: tuple[str, int], terms: int) -> None:
    name, value = size
    result = termsel.run(features=satellite(count), model=model)
    assert result.options.model[name] == value
    assert result.selection.n_terms == terms
    default = next(option.default for option in registry().get("models", model).declared_options
                   if option.name == name)
    notes = [note for note in result.notes if f"--set {name}=N" in note]
    assert len(notes) == (value < default)
    if notes:
        assert notes[0].startswith(f"{count} points are too few for {name} {default} of {model}, "
                                   f"so {name} {value} was fitted.")
        assert f"too few for {name} {default}" in result.summary().split("\n\n")[1]


def test_a_degree_that_was_given_is_not_lowered() -> None:
    with pytest.raises(termsel.TermselError,
                       match="8 control features give 16 equations for the 40 terms") as caught:
        termsel.run(features=satellite(8), model="poly3d", options={"degree": 3})
    assert "leave model out" in str(caught.value.hint)


@pytest.mark.parametrize("seed", range(4))
def test_names_of_one_model_have_one_prediction(seed: int) -> None:
    """Of five points any four leave heights that a plane nearly explains, but the model has them.
    """
    rng = np.random.default_rng(seed)
    ground = rng.uniform([5e5, 5e6, 0.0], [509e3, 5009e3, 400.0], (5, 3))
    image = ground @ np.array([[0.01, 0.3], [-0.3, 0.01], [0.1, 0.2]]) + [1.5e6, -2e5]
    features = FeatureSet(termsel.Points(tuple("ABCDE"), image + rng.normal(0.0, 2.0, (5, 2)),
                                         ground), crs="EPSG:32633")
    first = termsel.run(features=features, model="affine").predicted
    second = termsel.run(features=features, model="poly3d", options={"degree": 1}).predicted
    assert first is not None
    assert second is not None
    assert (second.rmse, second.low, second.high) == pytest.approx(
        (first.rmse, first.low, first.high), rel=1e-6)
    # As without a repeated choice: all terms are fitted to each four points.
    fitted = termsel.fit(features, "affine").leave_one_out_rmse()
    assert fitted is not None
    assert first.rmse == pytest.approx(fitted.total, rel=1e-3)


@pytest.mark.parametrize(("model", "count", "says"), [
    ("affine", 4, "4 points determine the model exactly"),
    ("helmert2d", 2, "2 points determine the model exactly"),
    ("dlt3d", 6, "Without one of the points the model is not determined")])
def test_points_that_leave_nothing_to_be_held_out_are_fitted_all_the_same(
        model: str, count: int, says: str) -> None:
    result = termsel.run(features=satellite(count), model=model)
    assert result.predicted is None
    assert says in " ".join(result.summary().split())


@pytest.mark.parametrize("name", ["similarity", "affine"])
def test_a_method_that_is_named_is_fitted_to_three_points_too(name: str) -> None:
    result = termsel.run(features=satellite(3), method=name)
    assert result.strategy is not None
    assert result.strategy.chosen == name


@pytest.mark.parametrize("further", [
    {"problem": "rfm-terms"}, {"solver": "all-terms"}, {"criterion": "press"}, {"generations": 2},
    {"strategy": "as-asked"}, {"options": {"max_share": 0.5}}])
def test_with_anything_of_a_search_the_terms_are_searched(further: dict[str, Any]) -> None:
    further = {"generations": 2, **further}
    result = termsel.run(**{"features": satellite(40), "model": "poly3d", **further})
    assert result.strategy is None
    assert result.solver in {"ga", "all-terms"}


def test_points_of_other_roles_keep_them() -> None:
    features = satellite(20)
    roles = ("control",) * 8 + ("check",) * 6 + ("independent",) * 4 + ("off",) * 2
    result = termsel.run(features=features.with_(points=replace(features.points, roles=roles)),
                         model="affine")
    counts = result.data.counts
    assert (counts.control, counts.check, counts.independent, counts.off) == (8, 6, 4, 2)
    # Selection points are control where nothing is selected.
    assert result.strategy is not None
    assert result.strategy.fitted_to == ("control", "check")


def test_lines_are_fitted_by_a_named_model_too() -> None:
    scene = termsel.simulate_scene("ikonos-hamedan")
    lines = FeatureSet(lines=scene.lines, crs=scene.crs)
    result = termsel.run(features=lines, model="poly3d", options={"degree": 1})
    assert result.selection.n_features > 100
    assert result.selection.n_terms == 8


def test_the_result_of_a_named_model_is_read_and_used_again(tmp_path: Path) -> None:
    features = satellite(30)
    result = termsel.run(features=features, model="rfm-legendre", options={"order": 1},
                         out=tmp_path / "result")
    again = termsel.read_result(tmp_path / "result")
    places = features.points.ground[:5]
    np.testing.assert_allclose(again.fit.project(places), result.fit.project(places))
    assert again.summary() == result.summary()


def test_a_list_of_drone_points_is_fitted_by_the_model_that_is_named(tmp_path: Path,
                                                                     call: Call) -> None:
    points = satellite(14).points
    names = [f"GCP{i}" for i in range(11)] + ["CHK-1", "CHK-2", "CHK-3"]
    rows = [f"{x} {y} {z} {sample} {line} DJI_1.JPG {name}"
            for (x, y, z), (line, sample), name in zip(points.ground, points.image, names,
                                                       strict=True)]
    path = tmp_path / "gcp_list.txt"
    path.write_text("\n".join(["EPSG:4979", *rows]) + "\n")
    done = call("run", path, "--model", "dlt3d")
    assert done.exit_code == 0
    assert "11 points to fit the model, 3 independent check points" in done.stdout
    assert "Note:" not in done.stderr
