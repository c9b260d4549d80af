"""The physical scanner: against termsel's simulator, as a model and as a candidate."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("termsel_cameras", reason="termsel-cameras is not installed: "
                    "pip install -e plugins/termsel-cameras")

import termsel
from termsel import FeatureSet, Points, TermselError
from termsel.simulate import pushbroom_at
from termsel.toolkit import make_scaling
from termsel_cameras import SENSORS, Scanner


def spot(count: int, seed: int = 0, tilt: float = 18.0) -> FeatureSet:
    """Return points of a simulated SPOT scene; the last 60 are independent."""
    rng, size = np.random.default_rng(seed), (6000, 6000)
    place: dict[str, Any] = {"lon": 20.0, "lat": 45.0, "height": 500.0, "gsd": 10.0,
                             "image_size": size, "altitude": 822e3, "inclination": 98.7}
    down = pushbroom_at(**place)
    sensor = replace(pushbroom_at(off_nadir=tilt, **place), ifov=down.ifov,
                     line_period=down.line_period)
    image = rng.uniform(0.03, 0.97, (count + 60, 2)) * size
    height = rng.uniform(200.0, 1200.0, len(image))
    ground = np.column_stack([sensor.locate(image, height), height])
    return FeatureSet(Points(
        tuple(f"P{i}" for i in range(len(image))), image + rng.normal(0.0, 0.5, image.shape),
        ground, None, ("control",) * count + ("independent",) * 60,
        attributes={"sensor": np.array(["spot-1"] * len(image), dtype=object)}),
        crs="EPSG:4979", image_size=size)


def rmse(fitted: Any, features: FeatureSet) -> float:
    others = features.points.take([role == "independent" for role in features.points.roles])
    return float(np.sqrt((fitted.errors(others) ** 2).sum(axis=1).mean()))


@pytest.mark.parametrize(("count", "most"), [(4, 3.0), (6, 2.0)])
def test_few_points_and_a_name_are_enough(count: int, most: float) -> None:
    scene = spot(count)
    fitted = termsel.fit(scene, "named-scanner")
    assert rmse(fitted, scene) < most
    sigma = fitted.sigma(scene.points.ground[count:])
    assert 0.4 < np.sqrt((sigma**2).sum(axis=1).mean()) / rmse(fitted, scene) < 2.5
    assert fitted.adjustment.converged
    assert fitted.adjustment.steps


def test_a_fit_follows_the_bent_valley_to_its_end() -> None:
    """Altitude, pixel and period make up for each other: 100 steps were not enough from here."""
    scene = spot(40)
    control = scene.take(np.array([role == "control" for role in scene.points.roles]))
    scaling = make_scaling(control)
    model, scaled = Scanner().prepared(scaling, control.crs), scaling.features(control)
    ends = [model.descend(scaled, start) for start in model.starts(scaled)]
    assert all(end is not None and end.converged and end.steps < 40 for end in ends)
    costs = [end.cost for end in ends if end is not None]
    assert max(costs) < 1.02 * min(costs)


def test_a_class_defined_in_a_function_is_fitted_too() -> None:
    class Own(Scanner):
        """A scanner of a notebook."""

        name = "own-scanner"

    control = spot(4)
    control = replace(control, points=control.points.take(
        [role == "control" for role in control.points.roles]))
    own, scanner = termsel.fit(control, Own()), termsel.fit(control, Scanner())
    np.testing.assert_array_equal(own.project(control.points.ground),
                                  scanner.project(control.points.ground))


def test_one_blunder_hardly_moves_it() -> None:
    scene = spot(10)
    image = scene.points.image.copy()
    image[3] += 60.0
    bad = replace(scene, points=replace(scene.points, image=image))
    assert rmse(termsel.fit(bad, "named-scanner"), scene) < 6.0


@pytest.mark.slow
def test_errors_left_out_are_those_of_fits_without_the_point() -> None:
    scene = spot(8)
    held_out = termsel.fit(scene, "named-scanner").held_out().errors
    assert held_out is not None
    for out in (0, 5):
        kept = scene.take(np.arange(68) != out)
        one = scene.points.take(np.arange(68) == out)
        there = termsel.fit(kept, "named-scanner").errors(one)[0]
        assert np.abs(there - held_out[out]).max() < 0.3


@pytest.mark.slow
def test_auto_chooses_it_and_reads_it_back(tmp_path: Path) -> None:
    scene = spot(5)
    result = termsel.run(features=scene, out=tmp_path / "out")
    assert result.strategy is not None
    assert result.strategy.chosen == "named-scanner"
    assert "spot-1" in result.strategy.reason
    again = termsel.read_result(tmp_path / "out")
    places = scene.points.ground[5:]
    np.testing.assert_allclose(again.fit.project(places), result.fit.project(places), atol=1e-6)


def test_slopes_are_the_derivatives_and_heights_move_the_image() -> None:
    scene = spot(6)
    fitted = termsel.fit(scene, "named-scanner")
    ground = scene.points.ground[:3]
    higher = ground + np.array([0.0, 0.0, 100.0])
    moved = np.linalg.norm(fitted.project(higher) - fitted.project(ground), axis=1)
    # 100 m at an incidence of 18 to 23 degrees, in pixels of 10 to 12 m.
    assert ((moved > 100 * np.tan(np.radians(18.0)) / 12) & (
        moved < 100 * np.tan(np.radians(23.0)) / 10)).all()


@pytest.mark.parametrize(("content", "said"), [
    ("[", "cannot be read"), ("[]", "no JSON object"), ('{"altitude": 700}', "lacks"),
    ('{"speed": 1}', "no sensor has"),
    (json.dumps({"altitude": -1, "inclination": 98, "pixel": 5, "side": 9, "ahead": 1,
                 "source": "own"}), "no positive number"),
    (json.dumps({"altitude": 5, "inclination": 98, "pixel": 5, "side": 9, "ahead": 1,
                 "source": "own"}), "out of range")])
def test_bad_files_of_constants(tmp_path: Path, content: str, said: str) -> None:
    path = tmp_path / "own.json"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(TermselError, match=said):
        Scanner(sensor=str(path))


def test_unknown_names_and_files(tmp_path: Path) -> None:
    with pytest.raises(TermselError, match="no sensor"):
        Scanner(sensor="spot-9")
    with pytest.raises(TermselError, match="does not exist"):
        Scanner(sensor=str(tmp_path / "none.json"))
    bare = replace(spot(6).points, attributes={})
    with pytest.raises(TermselError, match="no column"):
        termsel.fit(replace(spot(6), points=bare), "named-scanner")
    own = tmp_path / "own.json"
    own.write_text(json.dumps({"altitude": 822, "inclination": 98.7, "pixel": 10, "side": 13,
                               "ahead": 1, "source": "own"}), encoding="utf-8")
    assert Scanner(sensor=str(own)).sensor.pixel == 10
    assert all(one.source and 300 < one.altitude < 1000 for one in SENSORS.values())
