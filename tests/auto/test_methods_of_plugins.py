"""Methods of plugins: their place in the choice, and what becomes of those that fail."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

import termsel
from termsel.auto.auto import Auto
from termsel.auto.methods import METHODS, Structure, named
from termsel.auto.rule import CLEAR_MARGIN, PRIOR_MARGIN, PROJECTION_MARGIN, best_of, method_of
from termsel.core.errors import TermselError
from termsel.data import fit_data as control_module
from termsel.data.features import BoolArray, FeatureSet, FloatArray, empty_lines
from termsel.data.fit_data import FitData
from termsel.data.scaling import Scaling
from termsel.fitting.fit import Estimator, Fit, HeldOut, Undetermined
from termsel.fitting.least_squares import LEAST_SQUARES
from termsel.fitting.method import Method
from termsel.models.base import SensorModel
from termsel.models.polynomial import Affine, Polynomial3D
from termsel.models.quotient import Blocks, RationalModel
from termsel.plugins.registry import registry
from termsel.testing import check, checks


class Crossed(RationalModel):
    """A model of this session: 1, X, Y, Z and XY."""

    name = "crossed"

    def blocks(self, ground: FloatArray) -> Blocks:
        columns = np.column_stack([np.ones(len(ground)), ground, ground[:, 0] * ground[:, 1]])
        return Blocks(line=columns, sample=columns)


@dataclass(frozen=True, eq=False)
class Known(Method):
    """A candidate with a model that it says is the true one."""

    known: SensorModel
    factor: float = 1.0

    def declines(self, control: FitData) -> str | None:
        return None if control.heights else "the known geometry needs heights"

    def fit(self, control: FitData) -> Fit:
        terms, used = (np.ones(n, dtype=bool) for n in (len(self.known.terms), len(control)))
        return LEAST_SQUARES.fit(self.known, control.features, control.scaling, terms, used)

    def held_out(self, fitted: Fit) -> HeldOut:
        return HeldOut(super().held_out(fitted).squares * self.factor)

    def describe(self, fitted: Fit) -> str:
        return f"The geometry of {fitted.model.name} is known."


class Broken(Known):
    """A candidate that fails wherever it is called."""

    def fit(self, control: FitData) -> Fit:
        raise ZeroDivisionError("nothing is known")


@pytest.fixture(scope="module")
def control() -> FitData:
    scene = termsel.simulate_scene("ikonos-hamedan", n_points=40, n_lines=0)
    return FitData.of(FeatureSet(replace(scene.points, roles=()), crs=scene.crs))


@pytest.fixture
def session() -> Iterator[Callable[[Method], None]]:
    """Register candidates in a registry of their own, unknown to other tests."""
    registry.cache_clear()
    yield lambda one: registry().register(one) and None
    registry.cache_clear()


def auto_with(*more: Method) -> Auto:
    return Auto(methods=(*METHODS, *more))


def fit_with(method: Method, control: FitData, squares: FloatArray) -> Fit:
    return replace(method.fit(control), method=method, stored_held_out=HeldOut(squares))


def chosen_of(fits: list[Fit]) -> tuple[str, str]:
    """Return which method is chosen by the rule, and why."""
    choice = best_of(fits, lambda fitted: method_of(fitted).describe(fitted))
    assert choice is not None
    return choice.method.name, choice.reason


@pytest.mark.parametrize(("of", "gain", "chosen"), [
    ("", CLEAR_MARGIN - 0.1, "regularised-quadratic"), ("", CLEAR_MARGIN + 0.1, "mine"),
    ("central", PROJECTION_MARGIN - 0.1, "regularised-quadratic"),
    ("central", PROJECTION_MARGIN + 0.1, "mine"),
    ("has_prior", PRIOR_MARGIN - 0.1, "regularised-quadratic"),
    ("has_prior", PRIOR_MARGIN + 0.1, "mine")])
def test_a_candidate_with_a_prior_or_a_central_one_needs_less(
        control: FitData, of: str, gain: float, chosen: str) -> None:
    noise = np.random.default_rng(1).normal(size=len(control))
    noise = (noise - noise.mean()) / noise.std(ddof=1)
    factor = np.exp(-0.1 * (gain / np.sqrt(len(control)) + noise))
    shrunken, mine = named("regularised-quadratic"), Known(
        "mine", "a known model", Polynomial3D(degree=2), has_prior=of == "has_prior",
        central=of == "central")
    name, reason = chosen_of([fit_with(shrunken, control, np.ones(len(control))),
                      fit_with(mine, control, factor)])
    assert name == chosen
    assert ("The geometry of poly3d is known." in reason) == (chosen == "mine")


@pytest.mark.parametrize("has_prior", [True, False])
@pytest.mark.parametrize(("count", "sure"), [(8, 4.53), (40, 3.2)])
def test_fewer_features_must_speak_more_clearly_against_what_is_known(
        control: FitData, has_prior: bool, count: int, sure: float) -> None:
    some = control.take(np.arange(len(control)) < count)
    noise = np.random.default_rng(1).normal(size=count)
    noise = (noise - noise.mean()) / noise.std(ddof=1)
    known = Known("known", "what is known", Affine(), has_prior=True, from_one=True)
    points = Known("points", "the points alone", Affine(), has_prior=has_prior)
    for gain in (sure - 0.1, sure + 0.1):
        squares = np.exp(-0.1 * (gain / np.sqrt(count) + noise))
        name, reason = chosen_of([fit_with(known, some, np.ones(count)),
                                  fit_with(points, some, squares)])
        assert name == ("points" if gain > sure else "known")
        assert f"(more than {sure:.2g} required)" in reason


def test_what_a_prior_contains_is_not_chosen_next_to_it(control: FitData) -> None:
    # Its own errors are ten times too large: it takes the place of what it contains all the same.
    mine = Known("mine", "a known model", Polynomial3D(degree=2), 100.0, has_prior=True,
                 contains=("affine", "quadratic", "cubic", "regularised-quadratic",
                           "regularised-cubic"))
    limit = Known("limit", "a limit", Affine())
    choice = Auto(methods=(*METHODS[3:4], *METHODS[12:14], mine)).choose(control)
    assert choice is not None
    assert choice.method.name == "mine"
    within = replace(mine, contains=("limit",))
    name, reason = chosen_of([fit_with(within, control, np.full(len(control), 9.0)),
                              fit_with(limit, control, np.full(len(control), 1e-9))])
    assert name == "mine"
    assert "a known model and its like contain it" in reason


def test_what_others_contain_is_judged_only_to_be_shown(control: FitData) -> None:
    for whole in (True, False):
        choice = Auto().choose(control, with_contained=whole)
        assert choice is not None
        assert ("cubic" in [method_of(fitted).name for fitted in choice.compared]) == whole


def test_one_that_declines_or_needs_another_is_not_judged(control: FitData) -> None:
    mine = Known("mine", "a known model", Affine())
    needy = replace(mine, name="needy", needs=("field",))
    flat = replace(control, heights=False)
    names = [one.name for one in auto_with(mine).offered(flat)]
    assert "mine" not in names
    assert "affine" in names
    choice = Auto(methods=(mine, needy)).choose(control)
    assert choice is not None
    assert [method_of(fitted).name for fitted in choice.compared] == ["mine"]
    with pytest.raises(TermselError, match="the known geometry needs heights"):
        termsel.fit(control.features.with_(points=replace(
            control.features.points,
            ground=control.features.points.ground * [1, 1, np.nan])), mine)


def test_one_for_few_features_is_not_tried_in_folds_of_more(control: FitData) -> None:
    mine = Known("mine", "a known model", Affine(), has_prior=True, max_features=len(control) - 1)
    auto = Auto(methods=(*METHODS[3:4], mine))
    seen = Counter[str]()

    def see(fitted: Fit | None) -> None:
        seen.update([method_of(fitted).name] if fitted else [])

    for some in (control, control.take(np.arange(len(control)) > 0)):
        seen.clear()
        auto.repeated(some, see)
        assert ("mine" in [one.name for one in auto.offered(some)]) == (seen["mine"] > 0)
        assert (seen["affine"] > 0) == (some is control)
    assert seen["mine"] > 0


@dataclass(frozen=True, eq=False)
class Uncalled(Known):
    """A candidate that features do not call for, though parts of them may."""

    near: Any = None

    def fit(self, control: FitData) -> Fit:
        TRIED[self.name, len(control)] += 1
        raise Undetermined("the features do not call for it", hint="Choose another model.")

    def nearly(self, control: FitData) -> bool:
        return super().nearly(control) if self.near is None else self.near


TRIED = Counter[tuple[str, int]]()


@pytest.mark.slow_cases("20-20", "39-20")
@pytest.mark.parametrize(("count", "folds"), [(19, 19), (20, 20), (39, 20), (40, 10)])
def test_folds_of_many_points_do_not_try_what_all_points_are_far_from(count: int, folds: int
                                                                      ) -> None:
    control = FitData.of(termsel.simulate_scene("spot-isfahan", roles=(count, 0, 0), n_lines=0))
    auto = auto_with(
        Known("good", "a known model", Polynomial3D(degree=2), factor=1e-6),
        Known("bad", "a known model", Affine(), factor=1e6),
        Uncalled("unasked", "a model", Affine()),
        Uncalled("in-parts", "a model", Affine(), near=np.bool_(True)),
        Uncalled("never", "a model", Affine(), near=np.bool_(False)),
        Known("needy", "a known model", Affine(), needs=("in-parts",)),
        Known("vain", "a known model", Affine(), needs=("never",)),
        Known("chicken", "a known model", Affine(), needs=("egg",)),
        Known("egg", "a known model", Affine(), needs=("chicken",)))
    seen = Counter[str]()

    def see(fitted: Fit | None) -> None:
        seen.update([method_of(fitted).name] if fitted else [])

    TRIED.clear()
    auto.repeated(control, see)
    of_few = folds if count < 20 else 0
    assert seen["good"] == seen["regularised-quadratic"] == folds
    assert seen["bad"] == of_few
    parts = Counter(name for name, n in TRIED.elements() if n < count)
    assert parts["unasked"] == parts["in-parts"] == folds
    assert parts["never"] == of_few
    assert not auto.faults
    choice = auto.choose(control)
    hopeless = auto.for_parts_of(control, choice).hopeless
    assert {"never", "bad"} <= hopeless
    assert not {"vain", "chicken", "egg"} & seen.keys()
    assert not {"unasked", "in-parts", "needy", "good", "cubic"} & hopeless


@pytest.mark.parametrize("most", [None, "12", 0, float("nan")])
def test_one_for_no_number_of_features_is_left_out_and_named(control: FitData, most: Any) -> None:
    auto = auto_with(Known("mine", "a known model", Affine(), max_features=most))
    assert auto.choose(control) is not None
    assert auto.repeated(control) is not None
    assert f"'mine' has max_features={most!r}, which is no number of features" in auto.notes[0]


def test_lines_left_out_of_a_choice_do_not_count_in_its_folds() -> None:
    """Displaced lines are left out whole: the folds must then try what few points alone call for.
    """
    scene = termsel.simulate_scene("spot-isfahan", seed=1, roles=(8, 0, 100), n_lines=12)
    moved = np.random.default_rng(1).normal(size=(len(scene.lines.image), 1, 2)) * 40
    features = scene.with_(lines=replace(scene.lines, image=scene.lines.image + moved))
    for some in (features, features.with_(lines=empty_lines())):
        result = termsel.run(features=some, strategy="auto")
        assert result.strategy.chosen == "physical-cubic"
        assert result.strategy.predicted < 3


def _hold_out_nothing(self: Method, fitted: Fit) -> str:
    return "good"


def _hold_out_one(self: Method, fitted: Fit) -> HeldOut:
    return HeldOut(np.ones(1))


@pytest.mark.slow_cases("fit-<lambda>-failed in fit.*ZeroDivisionError")
@pytest.mark.parametrize(("attribute", "value", "said"), [
    ("fit", lambda self, data: 1 / 0, "failed in fit.*ZeroDivisionError"),
    ("declines", lambda self, data: data.nothing, "failed in declines.*AttributeError"),
    ("held_out", _hold_out_nothing,
     "held_out.. returned an object of type str; expected HeldOut"),
    ("held_out", _hold_out_one, r"held_out.. returned an array of shape \(1,\); expected"),
    ("size", lambda self, heights: 1 / 0, "failed in size.*ZeroDivisionError")])
def test_one_that_fails_is_left_out_and_named(control: FitData, attribute: str, value: object,
                                              said: str) -> None:
    bad = type("Bad", (Known,), {attribute: value, "__module__": __name__})(
        "bad", "a bad one", Affine(), has_prior=True)
    auto = auto_with(bad)
    usual = Auto().choose(control)
    choice = auto.choose(control)
    assert choice is not None
    assert usual is not None
    assert (choice.method.name, choice.reason) == (usual.method.name, usual.reason)
    note, = auto.notes
    assert note.startswith("Left out of the choice: method 'bad' of ")
    np.testing.assert_equal(bool(__import__("re").search(said, note)), True)


def test_why_one_was_chosen_may_fail_and_nothing_else(control: FitData) -> None:
    bad = type("Bad", (Known,), {"describe": lambda self, fitted: 1 / 0,
                                 "__module__": __name__})("bad", "a bad one", Affine())
    auto = Auto(methods=(bad,))
    choice = auto.choose(control)
    assert choice is not None
    assert choice.method.name == "bad"
    undetermined = type("Few", (Known,), {
        "fit": lambda self, data: self.lacking(), "__module__": __name__,
        "lacking": lambda self: (_ for _ in ()).throw(Undetermined("too few"))})(
            "few", "one for more points", Affine())
    quiet = Auto(methods=(undetermined,))
    assert quiet.choose(control) is None
    assert quiet.notes == ()


@pytest.mark.slow
def test_auto_chooses_one_of_the_session_and_reads_it_back(
        session: Callable[[Method], None], tmp_path: Path) -> None:
    termsel.register(Crossed)
    session(Known("crossed-known", "a known model with a twist", Crossed(), 1e-6, has_prior=True))
    session(Broken("broken", "a broken model", Affine()))
    scene = termsel.simulate_scene("ikonos-hamedan", n_points=24, n_lines=0)
    result = termsel.run("rfm-terms", features=scene, strategy="auto", out=tmp_path / "r")
    assert result.strategy.chosen == "crossed-known"
    assert "The geometry of crossed is known." in result.strategy.reason
    assert "a known model with a twist" in result.judgement
    assert result.model == "crossed"
    assert result.plugins["method"].name == "session:crossed-known"
    assert sum(note.startswith("Left out of the choice: method 'broken'")
               for note in result.notes) == 1
    again = termsel.read_result(tmp_path / "r")
    assert again.fit.coefficients == pytest.approx(result.fit.coefficients)
    assert again.strategy.chosen == "crossed-known"
    assert termsel.fit(scene, "crossed-known").model.name == "crossed"


@dataclass(frozen=True)
class Shrinking(Estimator):
    """Least squares, its coefficients made smaller: an estimator of this session."""

    factor: float
    name: ClassVar[str] = "shrinking"

    def fit(self, model: SensorModel, control: FeatureSet, scaling: Scaling, terms: BoolArray,
            used: BoolArray) -> Fit:
        plain = LEAST_SQUARES.fit(model, control, scaling, terms, used)
        fitted = plain.with_coefficients(plain.adjustment.coefficients * self.factor, self, 8.0)
        errors = fitted.errors(control.points)
        return replace(fitted, stored_held_out=HeldOut.of(errors, control))


@pytest.mark.slow
def test_a_result_of_an_estimator_of_the_session_is_the_same_fit_again(
        session: Callable[[Method], None], tmp_path: Path) -> None:
    session(Structure("small", "a small model", Affine(), None, has_prior=True,
                      estimator=Shrinking(1.0 - 1e-6), contains=(
                          "regularised-quadratic", "regularised-cubic", "physical-cubic", "field")))
    scene = termsel.simulate_scene("ikonos-hamedan", n_points=24, n_lines=0)
    result = termsel.run("rfm-terms", features=scene, strategy="auto", out=tmp_path / "r")
    assert result.strategy.chosen == "small"
    again = termsel.read_result(tmp_path / "r")
    assert again.fit.original is not None
    assert again.fit.original.estimator == Shrinking(1.0 - 1e-6)
    assert again.fit.coefficients == result.fit.coefficients
    assert again.fit.effective == result.fit.effective == 8.0
    assert again.final is not None
    assert again.final.estimator == Shrinking(1.0 - 1e-6)


def test_a_name_that_is_taken_keeps_the_built_in(session: Callable[[Method], None],
                                                 control: FitData) -> None:
    from termsel.runs.request import auto_of_all

    session(Known("affine", "another affine model", Affine()))
    assert registry().known("methods", "affine") is named("affine")
    assert [one.title for one in auto_of_all().methods if one.name == "affine"] == [
        "an affine polynomial"]
    assert termsel.fit(control.features, "session:affine").model.name == "affine"


@pytest.mark.parametrize("candidate", METHODS[:4] + METHODS[12:13],
                         ids=lambda one: one.name)
def test_built_in_candidates_conform(candidate: Method) -> None:
    check(candidate)


class Boasting(Structure):
    """Says that its residuals are errors of points that took no part."""

    def held_out(self, fitted: Fit) -> HeldOut:
        return HeldOut((fitted.errors(fitted.control.points) ** 2).sum(axis=1))


class Mute(Structure):
    """Declines without a word."""

    def declines(self, control: FitData) -> str | None:
        return ""


class Vague(Structure):
    """Says in words whether parts of features may call for it."""

    def nearly(self, control: FitData) -> bool:
        return "perhaps"  # type: ignore[return-value]


@pytest.mark.parametrize(("candidate", "name", "said"), [
    (Vague("vague", "a vague one", Affine(), None), "nearly", "'perhaps'; expected a bool"),
    (Boasting("boast", "a cubic", Polynomial3D(degree=2), None), "holds_out",
     "too good to be true"),
    (Mute("mute", "a mute one", Affine(), None), "declines", "or a sentence"),
    (Structure("none", "one for nothing", None, None), "fits", "declines all features"),
    (Structure("bare", "Title", Affine(), None), "declaration", "begin it with an article"),
    (Structure("own", "a snake", Affine(), None, contains=("own",)), "declaration", "itself")])
def test_broken_candidates_are_told_why(candidate: Method, name: str, said: str) -> None:
    one, = (one for one in checks(candidate) if one.name == name)
    with pytest.raises(AssertionError, match=said):
        one.run()


@pytest.mark.slow
def test_what_follows_from_features_is_derived_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a run of auto each set of features is scaled once, and its heights are looked at once."""
    scaled, looked_at = Counter[tuple[str, ...]](), Counter[tuple[str, ...]]()
    make_scaling, heights_differ = control_module.make_scaling, control_module.heights_differ

    def counted_scaling(features: FeatureSet) -> object:
        scaled[features.ids] += 1
        return make_scaling(features)

    def counted_heights(control: FitData) -> bool:
        looked_at[control.features.ids] += 1
        return heights_differ(control)

    monkeypatch.setattr(control_module, "make_scaling", counted_scaling)
    monkeypatch.setattr(control_module, "heights_differ", counted_heights)
    scene = termsel.simulate_scene("ikonos-hamedan", n_points=60, n_lines=0)
    termsel.run("rfm-terms", features=scene, strategy="auto")
    most = max(map(len, scaled))
    whole = sum(count for ids, count in scaled.items() if len(ids) >= most - 3)
    assert sum(scaled.values()) - len(scaled) <= 5
    assert whole <= 25
    assert sum(looked_at.values()) == 1
