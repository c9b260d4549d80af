"""Few points, and heights that rest on one or two of them, are answered."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import termsel
from termsel.auto.auto import Auto
from termsel.auto.methods import named
from termsel.data.coordinates.crs import transformation_between
from termsel.data.features import FeatureSet, FloatArray, Points
from termsel.data.fit_data import FitData, relief_carriers
from termsel.formats.readers.csv_tables import write_points_csv
from termsel.runs import data_notes
from termsel.simulate import pushbroom_at, simulate_scene

Call = Callable[..., SimpleNamespace]


def some(n: int, heights: bool = True) -> FeatureSet:
    """The first points of a scene, without roles."""
    given = termsel.simulate_scene("ikonos-hamedan", n_points=30)
    points = given.points.take(range(n))
    ground = points.ground.copy()
    if not heights:
        ground[:, 2] = np.nan
    return FeatureSet(Points(points.ids, points.image, ground), crs=given.crs)


def plane(n: int, mirrored: bool) -> FeatureSet:
    """Points of a similarity, with noise of 0.3 px."""
    turn = 0.3
    rng = np.random.default_rng(n)
    ground = np.column_stack([rng.uniform(0, 1000, (n, 2)), np.full(n, np.nan)])
    x, y = ground[:, 0], ground[:, 1] * (-1 if mirrored else 1)
    image = np.column_stack([500 - np.sin(turn) * x - np.cos(turn) * y,
                             200 + np.cos(turn) * x - np.sin(turn) * y])
    return FeatureSet(Points(tuple(f"P{i}" for i in range(n)),
                             image + rng.normal(0, 0.3, (n, 2)), ground), crs="local")


def drawn(n: int, seed: int, error: float = 20.0) -> tuple[FeatureSet, FloatArray, FloatArray]:
    """Points of a town plan drawn to scale, and further ones: their places and line and sample."""
    rng = np.random.default_rng([n, seed])
    ground = np.column_stack([rng.uniform(0, 1000, (n + 40, 2)), np.full(n + 40, np.nan)])
    turn = rng.uniform(-0.2, 0.2)
    x, y = 2.5 * ground[:, :2].T
    image = np.column_stack([2500 - np.sin(turn) * x - np.cos(turn) * y,
                             np.cos(turn) * x - np.sin(turn) * y])
    # The surveyor's errors are those of places, and stand in the image.
    image += rng.normal(0, error, image.shape)
    points = Points(tuple(f"P{i}" for i in range(n)), image[:n], ground[:n])
    return FeatureSet(points, crs="local"), ground[n:], image[n:]


def rms_at(fitted: termsel.Fit, ground: FloatArray, image: FloatArray) -> float:
    return float(np.sqrt(((fitted.project(ground) - image)**2).sum(axis=1).mean()))


@pytest.mark.parametrize("n", [6, 9])
def test_few_points_of_a_map_to_scale_are_almost_those_of_a_similarity(n: int) -> None:
    by_polynomial = []
    by_similarity = []
    for seed in range(12):
        features, ground, image = drawn(n, seed)
        data = FitData.of(features)
        error = rms_at(Auto().fit(data), ground, image)
        by_polynomial.append(error / rms_at(named("regularised-cubic").fit(data), ground, image))
        by_similarity.append(error / rms_at(named("similarity").fit(data), ground, image))
    assert np.exp(np.mean(np.log(by_polynomial))) < 0.95
    assert np.exp(np.mean(np.log(by_similarity))) < 1.15


def test_few_points_of_shrunken_paper_are_not() -> None:
    ratios = []
    for seed in range(8):
        features, ground, image = drawn(9, seed, error=1.0)
        points = features.points
        shrunken = features.with_(points=replace(points, image=points.image * [1.0, 0.97]))
        data = FitData.of(shrunken)
        shown = image * [1.0, 0.97]
        error = rms_at(Auto().fit(data), ground, shown)
        ratios.append([error / rms_at(named(name).fit(data), ground, shown)
                       for name in ("affine", "similarity")])
    by_affine, by_similarity = np.exp(np.mean(np.log(ratios), axis=0))
    assert by_affine < 1.1
    assert by_similarity < 0.2


@pytest.mark.parametrize(("kept", "n", "told"), [(True, 7, ""), (False, 7, "some 5 s longer"),
                                                 (False, 4, "")])
def test_auto_announces_only_what_it_compiles_itself(
        kept: bool, n: int, told: str, monkeypatch: pytest.MonkeyPatch,
        caplog: pytest.LogCaptureFixture) -> None:
    """Not what a search compiles, which would be announced at each of its runs."""
    monkeypatch.setattr("termsel.adjustment.kernels.needs_compilation", lambda: True)
    monkeypatch.setattr("termsel.adjustment.bayesian.held_out.is_compiled", lambda _: kept)
    with caplog.at_level("INFO", logger="termsel"):
        termsel.run(features=some(n))
    assert told in caplog.text
    assert bool(told) == ("Compiling" in caplog.text)


@pytest.mark.slow_cases(
    "10-False", "10-True", "11-False", "11-True", "12-True", "6-True", "7-False", "7-True",
    "8-False", "9-False", "9-True")
@pytest.mark.parametrize("heights", [True, False])
@pytest.mark.parametrize("n", range(2, 13))
def test_two_and_more_points_are_answered(n: int, heights: bool, call: Call,
                                          tmp_path: Path) -> None:
    features = some(n, heights)
    write_points_csv(features.points, tmp_path / "p.csv", crs=features.crs)
    done = call("run", "--points", tmp_path / "p.csv", "--out", tmp_path / "r", "--quiet")
    assert done.exit_code == 0, done.stderr
    result = termsel.read_result(tmp_path / "r")
    assert done.stdout.startswith(result.summary())
    assert result.strategy is not None
    told = any("determine the model exactly" in note for note in result.notes)
    if n <= 3:
        assert result.fit.model.name == ("helmert2d" if n == 2 else "poly2d")
        assert result.fit.adjustment.redundancy == 0
        assert result.strategy.predicted is None
        assert result.predicted is None
        assert told
    else:
        assert not told
        assert result.predicted is not None
        assert 0 < result.predicted.low < result.predicted.rmse < result.predicted.high
    if n < 12:
        assert result.data.counts.control == n


@pytest.mark.parametrize(("mirrored", "chosen"), [(False, "similarity"),
                                                  (True, "mirrored-similarity")])
def test_a_similarity_is_chosen_where_it_predicts_best(mirrored: bool, chosen: str) -> None:
    result = termsel.run("poly-terms", features=plane(4, mirrored))
    assert result.strategy is not None
    of = {one.name: one.predicted for one in result.strategy.candidates}
    assert result.strategy.chosen == chosen == min(of, key=of.__getitem__)
    assert set(of) == {"similarity", "mirrored-similarity", "affine"}
    assert result.strategy.predicted == pytest.approx(of[chosen], rel=1e-6)
    assert of[chosen] < 3.0


@pytest.mark.parametrize(("n", "heights"), [(4, False), (5, True)])
def test_so_few_points_are_held_out_from_what_all_choose(n: int, heights: bool) -> None:
    """Four of them would choose by luck, and may take a model that all refuse."""
    features = some(n)
    choice = Auto().choose(FitData.of(features, heights))
    errors = Auto().repeated(FitData.of(features, heights))
    assert choice is not None
    assert errors is not None
    expected: FloatArray = np.array(choice.chosen.held_out().squares)
    np.testing.assert_allclose((errors**2).sum(axis=1), expected, rtol=1e-6)


@pytest.mark.parametrize(("rows", "words"), [
    (["a,10,10,0,0,5"],
     "only 1 control point; at least 2 control points are needed. Measure more."),
    (["a,10,10,0,0,5", "b,20,20,10,20,6", "c,30,30,20,40,5"], "on one straight line"),
    (["a,10,10,0,0,5", "b,10,10,10,10,6"], "the same place in the image"),
    (["a,10,10,0,0,5", "b,20,20,0,0,5"], "have the same ground coordinates"),
    (["a,10,10,0,0,5", "b,20,20,0,0,5", "c,30,20,0,0,5"], "all points have the same ground"),
    (["a,10,10,0,0,5", "b,20,20,0,0,6"], "the same place on the ground")])
def test_points_that_determine_nothing(rows: list[str], words: str, call: Call,
                                       tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text("\n".join(["id,line,sample,x,y,z", *rows]) + "\n")
    done = call("run", "--points", tmp_path / "p.csv", "--crs", "local", "--quiet")
    assert done.exit_code == 2
    assert words in done.stderr


@pytest.mark.parametrize(("width", "enough"), [(1e-7, False), (1e-5, True), (1e-3, True)])
def test_control_close_to_one_line_is_enough_where_it_has_a_width(width: float,
                                                                  enough: bool) -> None:
    along = np.linspace(0, 10_000, 12)
    across = 10_000 * width * np.resize([1.0, -1.0, 0.0], 12)
    ground = np.column_stack([along + across, along - across, np.full(12, 5.0)])
    features = FeatureSet(Points(tuple(f"P{i}" for i in range(12)), ground[:, :2] / 10, ground,
                                 roles=("control",) * 12), crs="local")
    if enough:
        assert len(termsel.prepare("rfm-terms", features=features, model="affine",
                                   criterion="press").observations.control) == 12
        return
    with pytest.raises(termsel.TermselError, match="one straight line on the ground"):
        termsel.prepare("rfm-terms", features=features, model="affine", criterion="press")


def coast(hills: tuple[int, ...], n: int = 24) -> FeatureSet:
    """Points at sea level but for some hills, which are displaced by their heights."""
    rng = np.random.default_rng(4)
    ground = np.column_stack([rng.uniform(0, 10_000, (n, 2)), np.zeros(n)])
    ground[list(hills), 2] = 300.0
    image = np.column_stack([9000 - ground[:, 1] + 0.2 * ground[:, 2],
                             ground[:, 0] - 0.1 * ground[:, 2]]) + rng.normal(0, 0.4, (n, 2))
    return FeatureSet(Points(tuple(f"P{i}" for i in range(n)), image, ground), crs="local")


@pytest.mark.parametrize("hills", [(5,), (5, 17)])
def test_heights_that_rest_on_one_point_or_two(hills: tuple[int, ...]) -> None:
    features = coast(hills)
    names = tuple(features.points.ids[i] for i in hills)
    assert sorted(relief_carriers(FitData.of(features))) == sorted(names)
    result = termsel.run("rfm-terms", features=features.with_(
        points=replace(features.points, roles=("control",) * 24)))
    note, = (note for note in result.notes if "lie on a plane" in note)
    for name in names:
        assert f"that of {name}" in note
    assert not result.fit.model.uses_height
    assert result.predicted is not None
    assert result.predicted.rmse < 1.0
    assert {one.id for one in result.outliers if one.excluded} == set(names)


def flat_coast(kind: str, n: int = 12) -> FeatureSet:
    """Control at sea level with heights of some kind, and 40 independent points on land."""
    features, rng = coast((), n + 40), np.random.default_rng(8)
    ground, image = features.points.ground.copy(), features.points.image.copy()
    dust = rng.standard_normal(n)
    ground[:n, 2] = {"zeros": 0.0 * dust, "dust": -3e-5 + 1e-6 * dust, "waves": 0.02 * dust,
                     "slope": 1e-2 * ground[:n, 0], "800 m": 800.0 + 0.0 * dust,
                     "land": np.where(np.arange(n) < 2, 60.0, -3e-5 + 1e-8 * dust)}[kind]
    ground[n:, 2] = rng.uniform(0, 300, 40)
    image += ground[:, 2:] * [0.2, -0.1]
    roles = ("control",) * n + ("independent",) * 40
    return features.with_(points=Points(features.points.ids, image, ground, roles=roles))


@pytest.mark.slow_cases("800 m", "land", "waves", "zeros")
@pytest.mark.parametrize("kind", ["zeros", "dust", "waves", "slope", "800 m", "land"])
def test_heights_that_tell_nothing_have_no_terms_and_their_effect_is_known(kind: str) -> None:
    features = flat_coast(kind)
    result = termsel.run("rfm-terms", features=features)
    assert not result.fit.model.uses_height
    land = features.points.take(np.arange(12, 52))
    errors, sigma = result.fit.errors(land), result.fit.sigma(land.ground)
    assert np.abs(errors).max() < 200.0
    assert ((errors / sigma) ** 2).mean() < 3.0
    assert any("not known: some" in note for note in result.notes)
    assert not any("blunder" in note for note in result.notes if "Left out" in note)
    figures = re.findall(r"\d[\d,]*", result.summary())
    assert max(len(one.replace(",", "")) for one in figures) <= 6
    assert {one.id for one in result.outliers if one.excluded} == (
        {"P0", "P1"} if kind == "land" else set())


@pytest.mark.slow_cases("dust-owdis-points", "dust-rfm-terms", "slope-rfm-terms")
@pytest.mark.parametrize("problem", ["rfm-terms", "owdis-points"])
@pytest.mark.parametrize("kind", ["dust", "slope"])
def test_a_search_from_flat_control_takes_no_term_with_heights(problem: str, kind: str) -> None:
    features = flat_coast(kind, 24)
    roles = np.array(features.points.roles)
    roles[:24:3] = "check"
    roles[30:34] = "check"  # check points with relief do not tell it either
    features = features.with_(points=replace(features.points, roles=tuple(roles)))
    result = termsel.run(problem, features=features, strategy="as-asked", generations=5)
    assert not any("Z" in name for name in result.selection.terms)
    land = features.points.take(np.arange(34, 64))
    errors = result.fit.errors(land)
    assert ((errors / result.fit.sigma(land.ground)) ** 2).mean() < 4.0
    assert any("not known: some" in note for note in result.notes)


def test_a_term_with_heights_that_is_asked_for_stays() -> None:
    result = termsel.run("rfm-terms", features=flat_coast("waves", 24), strategy="as-asked",
                         criterion="press", generations=5, options={"force_on": "line.num:Z"})
    high = {name for name in result.selection.terms if "Z" in name}
    assert "line.num:Z" in high
    assert high <= {"line.num:Z", "sample.num:Z"}


def test_a_hill_far_from_all_others_carries_the_heights() -> None:
    # The plane leans on it, so that little is left there and more at the points near by.
    features = coast((5,))
    ground = features.points.ground.copy()
    ground[5] = 60_000.0, 60_000.0, 300.0
    ground[:5, 2] = 0.4
    rough = features.with_(points=replace(features.points, ground=ground))
    assert relief_carriers(FitData.of(rough), limit=1) == ("P5",)


@pytest.mark.slow
def test_heights_that_rest_on_more_are_used() -> None:
    features = coast((2, 5, 9, 13, 17, 20))
    assert relief_carriers(FitData.of(features)) == ()
    result = termsel.run("rfm-terms", features=features.with_(
        points=replace(features.points, roles=("control",) * 24)))
    assert result.fit.model.uses_height
    assert not any("lie on a plane" in note for note in result.notes)
    assert result.predicted is not None
    assert result.predicted.rmse < 1.0


@pytest.mark.parametrize("hills", [(5, 17), (2, 5, 9)])
def test_the_choice_is_repeated_where_a_fold_takes_the_hills(hills: tuple[int, ...]) -> None:
    errors = Auto().repeated(FitData.of(coast(hills), True))
    assert errors is not None
    assert np.isfinite(errors).all()


@pytest.mark.slow_cases("0.0-All heights are 0, so")
@pytest.mark.parametrize(("height", "said"), [(0.0, "All heights are 0, so"),
                                              (250.0, "All heights are 250, so")])
def test_heights_that_are_all_equal_are_told(height: float, said: str) -> None:
    features = coast(())
    ground = features.points.ground.copy()
    ground[:, 2] = height
    level = features.with_(points=replace(features.points, ground=ground))
    auto = termsel.run("rfm-terms", features=level)
    assert any(note.startswith(said) for note in auto.notes)
    asked = termsel.run("rfm-terms", features=level, solver="all-terms", model="poly2d")
    assert not any(note.startswith(said) for note in asked.notes)


def test_what_heights_may_do_is_said_without_an_exponent() -> None:
    """Some pixels less than a hundred are rounded to a hundred."""
    plan = np.random.default_rng(0).uniform(0, 5000, (20, 2))
    ground = np.column_stack([plan, np.zeros(20)])
    both = FitData.of(FeatureSet(Points(tuple(map(str, range(20))), plan / 2, ground)), False)
    for height in np.arange(390.0, 410.0, 0.5):  # half of it is what it does, half of that in px
        other = Points(("hill",), plan[:1] / 2, np.array([[*plan[0], height]]))
        notes = list(data_notes._note_on_flat(both, other))
        assert re.search(r"some (9\d|1\d\d) px", notes[-1])


@pytest.mark.parametrize(("side", "said"), [
    ("image", "in the image."), ("ground", "on the ground."),
    ("both", "in the image and on the ground.")])
def test_points_on_one_line_are_told(side: str, said: str) -> None:
    features = coast((2, 5, 9, 13, 17, 20))
    ground, image = features.points.ground.copy(), features.points.image.copy()
    if side != "image":
        ground[:, 1] = 0.5 * ground[:, 0] + 1e-4 * ground[:, 1]
    if side != "ground":
        image[:, 1] = 3.0 * image[:, 0] + 0.01 * image[:, 1]
    row = features.with_(points=replace(features.points, ground=ground, image=image))
    found = termsel.run("rfm-terms", features=row, solver="all-terms", model="poly3d",
                        options={"degree": 1})
    notes = [note for note in found.notes if "one straight line" in note]
    assert len(notes) == 1
    assert notes[0].startswith(f"All points lie close to one straight line {said}")


@pytest.mark.parametrize("crs", ["EPSG:4979", "EPSG:4978"])
@pytest.mark.parametrize(("width", "narrow"), [(0.01, True), (0.04, False)])
def test_what_is_narrow_is_so_in_metres(crs: str, width: float, narrow: bool) -> None:
    """A strip of three degrees in the far north; in x and y a scene at the equator is a line."""
    rng = np.random.default_rng(0)
    image = rng.uniform(0, 1000, (20, 2))
    ground = np.column_stack([20 + 3 * rng.random(20), 72 + width * 3 * rng.random(20) / 3.24,
                              np.zeros(20)])
    if crs == "EPSG:4978":
        ground[:, :2] -= 20, 72
        ground[:, 1] *= 3.24
        ground = transformation_between("EPSG:4979", crs)(ground)
        ground[0, 2] = np.nan
    both = FeatureSet(Points(tuple(map(str, range(20))), image, ground), crs=crs)
    assert bool(list(data_notes._note_on_one_line(both))) == narrow


def test_points_all_over_a_scene_lie_on_no_line() -> None:
    found = termsel.run("rfm-terms", features=coast((2, 5, 9)), solver="all-terms", model="poly3d",
                        options={"degree": 1})
    assert not any("one straight line" in note for note in found.notes)


def test_two_points_do_not_call_every_place_far_outside(
        tmp_path: Path, call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "two.csv").write_text("id,line,sample,x,y,z\na,1,2,10,20,\nb,3,4,12,22,\n")
    (tmp_path / "at.csv").write_text("id,x,y\nm,11,21\n")
    found = [call(*command) for command in (
        ("run", "--points", "two.csv", "--crs", "local", "--out", "r"),
        ("project", "r", "--points", "at.csv"))]
    assert [done.exit_code for done in found] == [0, 0]
    assert found[1].stdout.endswith("m,2.0,3.0,11.0,21.0,,,,\n")
    assert "the control encloses no area" in found[1].stderr
    assert "far outside" not in found[1].stderr


def test_five_lines_predict_no_accuracy() -> None:
    scene = simulate_scene("ikonos-hamedan", n_points=20, n_lines=5, wrong_lines=0, seed=2)
    points = replace(scene.points, roles=("independent",) * 20)
    result = termsel.run("owdis-lines", features=scene.with_(points=points), strategy="auto")
    assert result.predicted is None
    assert result.strategy is not None
    assert result.strategy.predicted is None
    assert any(note.startswith("The lines are too few to repeat") for note in result.notes)


def test_an_affine_image_has_a_probability_of_its_own() -> None:
    """Few points of an affine image are predicted nearly as well as by an affine model."""
    ratios = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        ground = rng.uniform(0, 10_000, (208, 3)) * [1.0, 1.0, 0.03]
        image = ground @ np.array([[0.1, 0.02], [-0.02, 0.1], [0.04, 0.01]]) \
            + 0.5 * rng.standard_normal((208, 2))
        points = Points(tuple(map(str, range(208))), image, ground)
        control, others = FitData.of(FeatureSet(points.take(np.arange(208) < 8))), points.take(
            np.arange(208) >= 8)
        choice, affine = Auto().choose(control), named("affine")
        assert choice is not None
        assert affine is not None
        fits = choice.chosen, affine.fit(control)
        ratios.append(np.divide(*(np.linalg.norm(fit.errors(others)) for fit in fits)))
    assert np.median(ratios) < 1.05


@pytest.mark.parametrize("n", [6, 9, 12])
def test_few_points_of_a_map_are_averaged_over_what_they_do_not_tell_apart(n: int) -> None:
    """A scanner in orbit is no likelier than any other image there, and noise is no deformation."""
    ratios, reasons = [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        ground = np.column_stack([rng.uniform(0, 9e3, (n + 60, 2)), np.full(n + 60, np.nan)])
        image = ground[:, 1::-1] * [-0.2, 0.21] + rng.normal(0, 2.0, (n + 60, 2))
        every = Points(tuple(map(str, range(n + 60))), image, ground)
        first = np.arange(n + 60) < n
        control = FitData.of(FeatureSet(every.take(first), crs="local"))
        choice = Auto().choose(control)
        affine = named("affine")
        assert choice is not None
        assert affine is not None
        reasons.append(choice.reason)
        errors, best = (np.hypot(*fit.errors(every.take(~first)).T) for fit in (
            choice.chosen, affine.fit(control)))
        ratios.append(float(np.sqrt((errors**2).mean() / (best**2).mean())))
    assert np.median(ratios) < 1.1
    # Another candidate may be far better by luck.
    assert sum("So few points cannot decide between a similarity" in one for one in reasons) >= 6


def test_few_points_without_heights_that_a_scanner_saw_keep_its_prior() -> None:
    rng = np.random.default_rng(1)
    sensor = pushbroom_at(20.0, 45.0, off_nadir=25.0, gsd=10.0, image_size=(4000, 4000),
                          altitude=700e3, inclination=98.0)
    ground = np.column_stack([rng.uniform(19.8, 20.2, 9), rng.uniform(44.85, 45.15, 9),
                              np.zeros(9)])
    image = sensor.project(ground) + rng.normal(0, 0.3, (9, 2))
    ground[:, 2] = np.nan
    choice = Auto().choose(FitData.of(FeatureSet(Points(
        tuple("ABCDEFGHI"), image, ground), crs="EPSG:4979")), with_contained=False)
    assert choice is not None
    assert choice.method.name == "physical-cubic"


@pytest.mark.parametrize(("n", "models"), [
    (12, "a similarity, polynomials and a spline"),
    (13, "polynomials, a spline and local deformation")])
def test_what_is_an_average_of_models_is_called_one(n: int, models: str) -> None:
    rng = np.random.default_rng(2)
    ground = np.column_stack([rng.uniform(0, 1000, (n, 2)), np.full(n, np.nan)])
    bent = 10.0 * np.sin(ground[:, :2] / 120.0)
    image = ground[:, [1, 0]] @ np.array([[-2.0, 0.3], [0.4, 1.7]]) + 3000.0 + bent
    points = Points(tuple(f"P{i}" for i in range(n)), image, ground)
    result = termsel.run(features=FeatureSet(points, crs="local"))
    assert result.strategy is not None
    assert result.strategy.chosen == "field"
    assert f"Model     average of {models}" in result.summary()


def test_a_projection_is_not_taken_where_a_similarity_fits_as_well_by_chance() -> None:
    """Errors held out of a model that spends eight of ten equations may be small by chance."""
    rows = np.array([
        [1713.0, 1978.4, -41.2, 805.9],
        [1606.5, 1885.5, -356.9, 1121.2],
        [2051.3, 2668.1, 1923.3, -135.6],
        [2176.6, 2646.1, 1875.9, -430.7],
        [2699.0, 2897.1, 2589.3, -2038.0],
    ])
    ground = np.column_stack([rows[:, 2:] + 5e5, np.full(5, np.nan)])
    choice = Auto().choose(FitData.of(FeatureSet(Points(tuple("ABCDE"), rows[:, :2], ground),
                                                 crs="EPSG:32632")))
    assert choice is not None
    assert choice.method.name == "field"
    assert "pinhole camera is not taken: it would fit points of a similarity" in choice.reason


@pytest.mark.parametrize("seed", [1, 12, 36])
def test_a_projection_that_no_chance_explains_is_taken_though_four_points_hardly_predict(
        seed: int) -> None:
    """A photo from far above, tilted, of five points whose heights hardly move them."""
    rng = np.random.default_rng(seed)
    corners = np.array([[1100.0, 2050.0], [2700.0, 3100.0], [2080.0, 150.0], [1090.0, 4050.0],
                        [980.0, 200.0]]) + rng.uniform(-150.0, 150.0, (5, 2))
    tilt, focal, height = np.radians(20.0), 9000.0, 400e3
    camera_x, camera_y = (corners[:, 1] - 2100.0) / focal, (1500.0 - corners[:, 0]) / focal
    forward = np.sin(tilt) + camera_y * np.cos(tilt)
    down = np.cos(tilt) - camera_y * np.sin(tilt)
    ground = np.column_stack([5e5 + height * camera_x / down, 5e6 + height * forward / down,
                              rng.uniform(300.0, 1500.0, 5)])
    features = FeatureSet(Points(tuple("ABCDE"), corners + rng.normal(0.0, 2.0, (5, 2)), ground),
                          crs="EPSG:32632")
    choice = Auto().choose(FitData.of(features))
    assert choice is not None
    assert choice.method.name == "projective"
    assert "projective would fit points of it as well in" in choice.reason


def test_heights_count_where_residuals_say_so_though_four_points_hardly_predict() -> None:
    """A satellite's image of five points in mountains: without heights 34 px are left."""
    rows = np.array([
        [410.772, 2535.867, 80.486474421, -32.120083192, 1560.6370],
        [5805.365, 3007.968, 80.480818545, -32.159008240, 1132.6061],
        [1905.972, 5713.435, 80.512461934, -32.133958705, 1543.6967],
        [3779.023, 156.245, 80.458717485, -32.141657226, 1211.4388],
        [2789.733, 2394.603, 80.481592446, -32.136761519, 1562.1808],
    ])
    choice = Auto().choose(FitData.of(FeatureSet(
        Points(tuple("ABCDE"), rows[:, :2], rows[:, 2:]), crs="EPSG:4979")))
    assert choice is not None
    assert choice.method.name == "affine"
    assert "affine would fit points of it as well in" in choice.reason


@pytest.mark.parametrize("n", [8, 10])
def test_few_points_of_a_photographed_map_are_those_of_a_projection(n: int) -> None:
    chosen = []
    for seed in range(8):
        rng = np.random.default_rng([n, seed])
        plan = rng.uniform(-1.0, 1.0, (n, 2))
        depth = 1.0 + plan @ rng.normal(0.0, 0.15, (2, 1))
        image = 2000.0 + 1800.0 * plan[:, ::-1] * [-1.0, 1.0] / depth + rng.normal(0, 1.0, (n, 2))
        ground = np.column_stack([1000.0 * plan, np.full(n, np.nan)])
        points = Points(tuple(map(str, range(n))), image, ground)
        chosen.append(Auto().fit(FitData.of(FeatureSet(points, crs="local"))).method)
    assert sum(method.central for method in chosen) >= 7
