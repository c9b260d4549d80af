"""The notes of a result: each one, when it appears and when not, word by word."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from termsel.auto.contradictions import Suspects
from termsel.data.features import FeatureSet, FloatArray, Lines, Points, empty_lines
from termsel.data.roles import Observations, observations_by_role
from termsel.data.scaling import make_scaling
from termsel.fitting.extrapolation import warnings_of
from termsel.fitting.figures import PARALLEL, orientation_spread
from termsel.fitting.fit import Fit
from termsel.fitting.least_squares import LEAST_SQUARES, LeastSquares
from termsel.models.base import SensorModel
from termsel.models.polynomial import Affine, Polynomial2D
from termsel.models.quotient import RationalFunctions
from termsel.runs import choosing as auto
from termsel.runs import verdict
from termsel.runs.judgement import notes_on_search
from termsel.selection.criteria import CheckRmse, Criterion, Press
from termsel.selection.solvers.search import SearchResult

GRID = np.array([(x, y, 0.3 * (x - y) ** 2) for x in range(5) for y in range(5)], dtype=float)
"""Ground of 25 points; heights are no plane."""


def imaged(ground: FloatArray) -> FloatArray:
    """Image of an affine model, 400 px wide."""
    x, y, z = ground.T
    return np.column_stack([100 * y + 5 * x + z, 100 * x - 5 * y - 2 * z])


SHIFT = {"C": 0.0, "K": 0.2, "I": 0.3, "O": 0.4}
"""By the first letter of their names, as no two points may have one place."""


def points(prefix: str, role: str, ground: FloatArray, error: float = 0.0) -> Points:
    """Points whose lines are measured wrongly by an error [px]."""
    ground = ground + SHIFT[prefix]
    return Points(tuple(f"{prefix}{i}" for i in range(len(ground))),
                  imaged(ground) + np.array([error, 0.0]), ground, None, (role,) * len(ground))


def joined(*parts: Points) -> Points:
    return Points(tuple(name for one in parts for name in one.ids),
                  np.concatenate([one.image for one in parts]),
                  np.concatenate([one.ground for one in parts]), None,
                  tuple(role for one in parts for role in one.roles))


def lines(directions: FloatArray) -> Lines:
    """Lines over the scene, each of a direction on the ground [radians]."""
    middles = GRID[:len(directions)]
    along = np.column_stack([np.cos(directions), np.sin(directions), 0 * directions])
    ground = np.stack([middles - along, middles + along], axis=1)
    return Lines(tuple(f"L{i}" for i in range(len(directions))),
                 np.stack([imaged(ground[:, 0]), imaged(ground[:, 1])], axis=1), ground)


def observed(*, check: float = 1.0, independent: float = 1.0, n_control: int = 25) -> Observations:
    """Exact control, selection and independent check points with constant errors [px]."""
    middle = GRID[[6, 7, 8, 11, 12, 13]]
    return observations_by_role(FeatureSet(joined(points("C", "control", GRID[:n_control]),
                                                  points("K", "check", middle, check),
                                                  points("I", "independent", middle, independent))))


def fitted(observations: Observations, model: SensorModel | None = None,
           used: np.ndarray | None = None) -> Fit:
    control = observations.control
    model = model or Affine()
    return LEAST_SQUARES.fit(model, control, make_scaling(control),
                             np.ones(len(model.terms), dtype=bool),
                             np.ones(len(control), dtype=bool) if used is None else used)


def found(value: float = 1.0, **more: object) -> SearchResult:
    """A search that ended with a value of its objective."""
    return SearchResult(**{  # type: ignore[arg-type]  # values of several kinds
        "genes": np.ones(8, dtype=bool), "objectives": np.array([value]), "violation": 0.0,
        "seed": 1, "evaluations": 10, "generations": 1, "lookups": 0, "seconds": 0.1,
        "interrupted": False, **more})


def notes(observations: Observations, search: SearchResult | None = None,
          chosen: Fit | None = None, criterion: Criterion | None = None) -> list[str]:
    return list(notes_on_search(observations, criterion or CheckRmse(), search or found(),
                         chosen or fitted(observations)))


def test_an_ordinary_result_has_no_note() -> None:
    assert notes(observed()) == []


def test_the_notes_of_the_search_come_first() -> None:
    assert notes(observed(), found(notes=("One.", "Two."), interrupted=True)) == [
        "One.", "Two.", "The search was interrupted; this is the best selection so far."]


FITTED_TO_CHECK = ("The independent RMSE is {} times that at the selection points: the selection "
                   "is fitted to them.")


@pytest.mark.parametrize(("check", "independent", "times"), [
    (1.0, 1.49, None), (1.0, 1.51, "1.5"), (2.0, 5.0, "2.5"), (5.0, 2.0, None)])
def test_a_selection_fitted_to_the_check_points(check: float, independent: float,
                                                times: str | None) -> None:
    observations = observed(check=check, independent=independent)
    expected = [FITTED_TO_CHECK.format(times)] if times else []
    assert notes(observations, found(check)) == expected
    assert notes(observations, found(check), criterion=Press()) == []


@pytest.mark.parametrize(("role", "named"), [("check", []), ("independent", [])])
def test_without_points_of_a_role_they_are_not_compared(role: str, named: list[str]) -> None:
    observations = observed(check=1.0, independent=5.0)
    assert notes(replace(observations, **{role: observations.control.points.take(
        np.zeros(25, dtype=bool))})) == named


OTHER_POINTS = ("The search minimised an RMSE of {} px over the points that the problem judges "
                "by, which are not the selection points alone.")


@pytest.mark.parametrize(("seen", "named"), [
    (1.004, False), (1.006, True), (0.996, False), (0.994, True)])
def test_a_search_that_judged_by_other_points(seen: float, named: bool) -> None:
    expected = [OTHER_POINTS.format(seen)] if named else []
    assert notes(observed(), found(seen)) == expected
    assert notes(observed(), found(seen, violation=1.0)) == []
    assert notes(observed(), found(seen), criterion=Press()) == []
    chosen = fitted(observed())
    given = chosen.with_coefficients(chosen.adjustment.coefficients)
    assert notes(observed(), found(seen), given) == []


def curved(noise: float) -> Observations:
    """Lines of a rational model, measured with noise [px], and check points."""
    rng = np.random.default_rng(0)
    model = RationalFunctions(order=1)
    names = model.terms
    values = {"line.num:X": 0.9, "sample.num:Y": 0.9}
    coefficients = np.array([values.get(name, rng.uniform(-0.25, 0.25)) for name in names])

    def seen(ground: FloatArray) -> FloatArray:
        return 4000 + 4000 * model.predict(coefficients, FeatureSet(), ground)

    start = rng.uniform(-1, 1, (40, 3))
    end = start + rng.uniform(-0.3, 0.3, (40, 3))
    image = np.stack([seen(start), seen(end)], axis=1) + rng.normal(0, noise, (40, 2, 2))
    ground = rng.uniform(-1, 1, (20, 3))
    return observations_by_role(FeatureSet(
        Points(tuple(f"P{i}" for i in range(20)), seen(ground), ground, None, ("check",) * 20),
        Lines(tuple(f"L{i}" for i in range(40)), image, np.stack([start, end], axis=1))))


def test_a_search_that_saw_equations_to_first_order() -> None:
    observations = curved(5.0)
    chosen = fitted(observations, RationalFunctions(order=1, ridge=0.0))
    first = LeastSquares(iterated=False).fit(
        chosen.model, chosen.control, chosen.scaling, chosen.terms, chosen.used)
    iterated, seen = chosen.rmse(observations.check), first.rmse(observations.check)
    assert iterated is not None
    assert seen is not None
    assert abs(iterated.total - seen.total) > 0.01 * seen.total
    assert notes(observations, found(seen.total), chosen) == [
        f"The search saw an RMSE of {seen.total:.4g} px at selection points, with equations to "
        "first order; the fit was then iterated."]
    assert notes(observations, found(iterated.total), chosen) == []
    assert notes(observations, found(3 * seen.total), chosen) == [
        OTHER_POINTS.format(f"{3 * seen.total:.4g}")]


def test_an_adjustment_without_redundancy() -> None:
    four, five = observed(n_control=25), observed(n_control=25)
    used = np.zeros(25, dtype=bool)
    used[[0, 4, 20, 24]] = True
    assert notes(four, chosen=fitted(four, used=used)) == [
        "The adjustment has no redundancy: its residuals are no measure of accuracy."]
    used[12] = True
    assert notes(five, chosen=fitted(five, used=used)) == []


def of_lines(directions: FloatArray, off: int = 0, control: int = 0) -> Observations:
    """Control lines, check points, and points that take no part or are control too."""
    parts = [points("K", "check", GRID[[6, 7, 8, 11, 12, 13]], 1.0)]
    parts += [points("O", "off", GRID[:off])] * bool(off)
    parts += [points("C", "control", GRID[-control:])] * bool(control)
    return observations_by_role(FeatureSet(joined(*parts), lines(directions)))


WIDE = np.linspace(0, np.pi, 25, endpoint=False)


@pytest.mark.parametrize(("off", "text"), [
    (0, []),
    (1, ["1 control point of the file is unused: lines are the control; --set mixed=true "
         "uses both."]),
    (7, ["7 control points of the file are unused: lines are the control; --set mixed=true "
         "uses both."])])
def test_points_that_stay_out_where_lines_are_the_control(off: int, text: list[str]) -> None:
    assert notes(of_lines(WIDE, off)) == text
    assert notes(of_lines(WIDE, off, control=3)) == []


def test_points_that_are_off_are_not_named_where_points_are_the_control() -> None:
    observations = observations_by_role(
        FeatureSet(joined(points("C", "control", GRID), points("O", "off", GRID[:4]))))
    assert notes(observations, criterion=Press()) == []


def spread_by(spread: float) -> FloatArray:
    """Directions of 24 lines by turns on either side of one, whose orientation spread is given."""
    # Angles of t and -t about one direction: the smaller eigenvalue of the mean of n n^T is
    # sin^2 t.
    t = np.arcsin(np.sqrt(spread / 2))
    return np.tile([t, -t], 12)


@pytest.mark.parametrize(("spread", "text"), [
    (0.055, []),
    (0.045, ["The lines in use run nearly alike (orientation spread 0.045 of 1): the model "
             "is hardly determined along them."])])
def test_lines_that_run_nearly_alike(spread: float, text: list[str]) -> None:
    observations = of_lines(spread_by(spread))
    # The image is the ground turned and scaled, but for heights, of which these lines have one.
    assert orientation_spread(observations.control.lines) == pytest.approx(spread, rel=0.01)
    assert (spread < PARALLEL) == bool(text)
    assert [one for one in notes(observations) if "Extrapolation" not in one] == text


def test_lines_that_run_alike_next_to_control_points_are_not_named() -> None:
    observations = of_lines(spread_by(0.01), control=5)
    assert [one for one in notes(observations) if "lines in use" in one] == []


def test_only_the_lines_in_use_are_judged() -> None:
    observations = of_lines(np.concatenate([spread_by(0.01), [np.pi / 2]]))
    assert not any("nearly alike" in one for one in notes(observations))
    used = np.arange(25) < 24
    assert any("The lines in use run nearly alike (orientation spread 0.01 of 1)" in one
               for one in notes(observations, chosen=fitted(observations, used=used)))


def test_pseudo_observations_are_named_where_they_hold_a_term_in_use() -> None:
    observations = observed()
    model = RationalFunctions(order=1, ridge=0.01)
    chosen = fitted(observations, model)
    text = ("Pseudo-observations of weight 0.01 hold coefficients of denominators near zero "
            "(--set ridge=...); they do not count as redundancy.")
    check = chosen.rmse(observations.check)
    assert check is not None
    seen = found(check.total)
    assert notes(observations, seen, chosen) == [text]
    without = fitted(observations, RationalFunctions(order=1, ridge=0.0))
    assert notes(observations, seen, without) == []
    numerators = np.array([".num:" in name for name in model.terms])
    assert 0 < numerators.sum() < len(model.terms)
    plain = LEAST_SQUARES.fit(model, observations.control, chosen.scaling, numerators, chosen.used)
    assert text not in notes(observations, seen, plain)
    given = chosen.with_coefficients(chosen.adjustment.coefficients)
    assert notes(observations, seen, given) == []


SQUARE = np.array([(0.0, 0.0, 0.0), (0.0, 10.0, 10.0), (10.0, 0.0, 10.0), (10.0, 10.0, 0.0)])
ALL = np.ones(4, dtype=bool)


def at(ground: FloatArray, image: FloatArray | None = None) -> Points:
    ground = np.asarray(ground, dtype=float)
    return Points(tuple(f"P{i}" for i in range(len(ground))),
                  ground[:, :2] if image is None else np.asarray(image, dtype=float), ground)


OUTSIDE = "Extrapolation: {} far outside the control in use. The RMSE does not apply there."


@pytest.mark.parametrize(("image", "text"), [
    ([(15.0, 5.0)], []),
    ([(15.1, 5.0)], [OUTSIDE.format("1 of 1 selection point lies")]),
    ([(5.0, 5.0), (5.0, -5.1), (5.0, 15.1)], [OUTSIDE.format("2 of 3 selection points lie")])])
def test_check_points_beyond_half_the_side_of_the_control(
        image: FloatArray, text: list[str]) -> None:
    ground = np.array([(i, 5.0, 5.0) for i in range(len(image))])
    assert list(warnings_of(FeatureSet(at(SQUARE)), ALL, at(ground, image))) == text


@pytest.mark.parametrize(("size", "text"), [
    ((16, 16), []),
    ((16, 17), [OUTSIDE.format("2 of 4 corners of the image lie")]),
    # The corners are middles of px: a row of 17 ends at 16.
    ((17, 11), [OUTSIDE.format("2 of 4 corners of the image lie")]),
    ((11, 17), [OUTSIDE.format("2 of 4 corners of the image lie")]),
    ((17, 17), [OUTSIDE.format("3 of 4 corners of the image lie")])])
def test_corners_of_the_image_beyond_half_the_side_of_the_control(
        size: tuple[int, int], text: list[str]) -> None:
    control = FeatureSet(at(SQUARE), image_size=size)
    assert list(warnings_of(control, ALL, at(np.empty((0, 3))))) == text


def test_both_are_told_in_one_note() -> None:
    control = FeatureSet(at(SQUARE), image_size=(17, 11))
    check = at([(5, 5, 5.0)], [(15.1, 5.0)])
    assert list(warnings_of(control, ALL, check)) == [
        OUTSIDE.format("1 of 1 selection point and 2 of 4 corners of the image lie")]


def test_only_control_in_use_reaches_anywhere() -> None:
    control = FeatureSet(at(np.concatenate([SQUARE, [(30, 30, 5)]])))
    check = at([(16, 16, 5.0)])
    assert list(warnings_of(control, np.ones(5, dtype=bool), check)) == []
    assert list(warnings_of(control, np.arange(5) < 4, check)) == [
        OUTSIDE.format("1 of 1 selection point lies")]


@pytest.mark.parametrize(("heights", "text"), [
    ([15.0, -5.0], []),
    ([15.1], ["Extrapolation: 1 selection point lies far above or below the control."]),
    ([-5.1, 5.0, 15.1], ["Extrapolation: 2 selection points lie far above or below the control."])])
def test_check_points_beyond_half_the_relief_of_the_control(
        heights: list[float], text: list[str]) -> None:
    check = at(np.array([(5.0, 5.0, z) for z in heights]))
    assert list(warnings_of(FeatureSet(at(SQUARE)), ALL, check)) == text
    flat = SQUARE * [1, 1, 0]
    assert list(warnings_of(FeatureSet(at(flat)), ALL, check)) == []


def limits(n: int, scale: float = 1.0) -> list[str]:
    points = at(np.random.default_rng(0).uniform(0, 10, (n, 3)))
    none = np.zeros(n, dtype=bool)
    found = Suspects(none, none, none, 10.0 + np.arange(n), scale * (1.0 + np.arange(n)))
    return list(verdict._limits_of_detection(FeatureSet(points), found))


def test_few_points_are_told_what_cannot_be_found() -> None:
    assert limits(17) == []
    last = at(np.random.default_rng(0).uniform(0, 10, (16, 3))).ids[15]
    assert limits(16) == ["With 16 points an error must exceed 8.5 px to be found for certain at "
                          f"half of them, and at {last} none can be found for certain."]
    assert limits(16, scale=100.0) == [
        "With 16 points no blunder can be found for certain: any may be one."]


def of_auto(model: SensorModel, errors: FloatArray | None, *, flat: bool = False) -> list[str]:
    ground = np.random.default_rng(0).uniform(0, 10, (30, 3)) * [1, 1, not flat]
    roles = ("control", "check") * 15
    return auto._notes_on_choice(model, observations_by_role(FeatureSet(Points(
        tuple(f"P{i}" for i in range(30)), imaged(ground), ground, None, roles))), errors,
        plane=False, determined=False, has_geometry=False)


def test_notes_of_a_choice_that_predicts_nothing() -> None:
    assert of_auto(Affine(), np.zeros((30, 2))) == []
    assert of_auto(Affine(), None) == [
        "The points are too few to repeat the choice without some of them, so it predicts no "
        "accuracy."]


def test_notes_of_a_choice_with_heights_for_a_plane_problem() -> None:
    text = "Heights are known and were used. --model poly2d keeps to a plane model."
    assert of_auto(Polynomial2D(degree=2), np.zeros((30, 2))) == [text]
    assert of_auto(Polynomial2D(degree=2), np.zeros((30, 2)), flat=True) == []


def test_an_image_far_beyond_all_points_is_a_note_of_a_choice() -> None:
    ground = np.random.default_rng(0).uniform(0, 10, (30, 3))
    of_points = Points(tuple(f"P{i}" for i in range(30)), imaged(ground), ground, None,
                       ("control", "check") * 15)
    features = FeatureSet(of_points, empty_lines(), "local", (900, 9000))
    assert auto._notes_on_choice(Affine(), observations_by_role(features), np.zeros((30, 2)),
                                 plane=False,
                                 determined=False, has_geometry=False) == [
        OUTSIDE.format("2 of 4 corners of the image lie")]
