"""Candidates of plugins: their place in the choice, and what becomes of those that fail."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

import termsel
from termsel.auto.base import Candidate, Judged
from termsel.auto.portfolio import BETTER, CLEARLY, EXPECTED, Portfolio, best_of, choose
from termsel.auto.repetition import repeated
from termsel.auto.structures import CANDIDATES, Structure, named
from termsel.core.errors import TermselError
from termsel.data import control as control_module
from termsel.data.control import Control
from termsel.data.features import BoolArray, FeatureSet, FloatArray, no_lines
from termsel.data.scaling import Scaling
from termsel.fitting.fit import Estimator, Fit, HeldOut, Undetermined
from termsel.fitting.fittable import Fittable
from termsel.fitting.least_squares import LEAST_SQUARES
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
class Known(Candidate):
    """A candidate with a model that it says is the true one."""

    known: SensorModel
    factor: float = 1.0

    def declines(self, control: Control) -> str | None:
        return None if control.heights else "the known geometry needs heights"

    def fit_control(self, control: Control) -> Fit:
        terms, used = (np.ones(n, dtype=bool) for n in (len(self.known.terms), len(control)))
        return LEAST_SQUARES.fit(self.known, control.features, control.scaling, terms, used)

    def judge(self, control: Control) -> Judged | None:
        judged = super().judge(control)
        return judged and replace(judged, squares=judged.squares * self.factor)

    def describe(self, fitted: Fit) -> str:
        return f"The geometry of {fitted.model.name} is known."


class Broken(Known):
    """A candidate that fails wherever it is called."""

    def fit_control(self, control: Control) -> Fit:
        raise ZeroDivisionError("nothing is known")


@pytest.fixture(scope="module")
def control() -> Control:
    scene = termsel.simulate_scene("ikonos-hamedan", n_points=40, n_lines=0)
    return Control.of(FeatureSet(replace(scene.points, roles=()), crs=scene.crs))


@pytest.fixture
def session() -> Iterator[Callable[[Candidate], None]]:
    """Register candidates in a registry of their own, unknown to other tests."""
    registry.cache_clear()
    yield lambda one: registry().register(one) and None
    registry.cache_clear()


def portfolio_with(*more: Candidate) -> Portfolio:
    return Portfolio((*CANDIDATES, *more))


def judged_as(candidate: Candidate, control: Control, squares: FloatArray) -> Judged:
    return Judged(candidate, candidate.fit_control(control), squares)


@pytest.mark.parametrize(("of", "gain", "chosen"), [
    ("", CLEARLY - 0.1, "shrunken-quadratic"), ("", CLEARLY + 0.1, "mine"),
    ("central", EXPECTED - 0.1, "shrunken-quadratic"), ("central", EXPECTED + 0.1, "mine"),
    ("has_prior", BETTER - 0.1, "shrunken-quadratic"), ("has_prior", BETTER + 0.1, "mine")])
def test_a_candidate_with_a_prior_or_a_central_one_needs_less(
        control: Control, of: str, gain: float, chosen: str) -> None:
    noise = np.random.default_rng(1).normal(size=len(control))
    noise = (noise - noise.mean()) / noise.std(ddof=1)
    factor = np.exp(-0.1 * (gain / np.sqrt(len(control)) + noise))
    shrunken, mine = named("shrunken-quadratic"), Known(
        "mine", "a known model", Polynomial3D(degree=2), has_prior=of == "has_prior",
        central=of == "central")
    assert shrunken is not None
    choice = best_of([judged_as(shrunken, control, np.ones(len(control))),
                      judged_as(mine, control, factor)])
    assert choice is not None
    assert choice.chosen.name == chosen
    assert ("The geometry of poly3d is known." in choice.reason) == (chosen == "mine")


@pytest.mark.parametrize("has_prior", [True, False])
@pytest.mark.parametrize(("count", "sure"), [(8, 4.53), (40, 3.2)])
def test_fewer_features_must_speak_more_clearly_against_what_is_known(
        control: Control, has_prior: bool, count: int, sure: float) -> None:
    some = control.take(np.arange(len(control)) < count)
    noise = np.random.default_rng(1).normal(size=count)
    noise = (noise - noise.mean()) / noise.std(ddof=1)
    known = Known("known", "what is known", Affine(), has_prior=True, from_one=True)
    points = Known("points", "the points alone", Affine(), has_prior=has_prior)
    for gain in (sure - 0.1, sure + 0.1):
        squares = np.exp(-0.1 * (gain / np.sqrt(count) + noise))
        choice = best_of([judged_as(known, some, np.ones(count)),
                          judged_as(points, some, squares)])
        assert choice is not None
        assert choice.chosen.name == ("points" if gain > sure else "known")
        assert f"it must be better by more than {sure:.2g}" in choice.reason


def test_what_a_prior_contains_is_not_chosen_next_to_it(control: Control) -> None:
    # Its own errors are ten times too large: it takes the place of what it contains all the same.
    mine = Known("mine", "a known model", Polynomial3D(degree=2), 100.0, has_prior=True,
                 contains=("affine", "quadratic", "cubic", "shrunken-quadratic",
                           "shrunken-cubic"))
    limit = Known("limit", "a limit", Affine())
    choice = choose(control, Portfolio((*CANDIDATES[3:4], *CANDIDATES[12:14], mine)))
    assert choice is not None
    assert choice.chosen.name == "mine"
    within = replace(mine, contains=("limit",))
    least = best_of([judged_as(within, control, np.full(len(control), 9.0)),
                     judged_as(limit, control, np.full(len(control), 1e-9))])
    assert least is not None
    assert least.chosen.name == "mine"
    assert "limit is a limit of a known model and its like" in least.reason


def test_what_others_contain_is_judged_only_to_be_shown(control: Control) -> None:
    for whole in (True, False):
        choice = choose(control, whole=whole)
        assert choice is not None
        assert ("cubic" in [one.name for one in choice.judged]) == whole


def test_one_that_declines_or_needs_another_is_not_judged(control: Control) -> None:
    mine = Known("mine", "a known model", Affine())
    needy = replace(mine, name="needy", needs=("field",))
    flat = replace(control, heights=False)
    names = [one.name for one in portfolio_with(mine).offered(flat)]
    assert "mine" not in names
    assert "affine" in names
    choice = choose(control, Portfolio((mine, needy)))
    assert choice is not None
    assert [one.name for one in choice.judged] == ["mine"]
    with pytest.raises(TermselError, match="the known geometry needs heights"):
        mine.fit(control.features.with_(points=replace(
            control.features.points, ground=control.features.points.ground * [1, 1, np.nan])))


def test_one_for_few_features_is_not_tried_in_folds_of_more(control: Control) -> None:
    mine = Known("mine", "a known model", Affine(), has_prior=True, most=len(control) - 1)
    portfolio, seen = Portfolio((*CANDIDATES[3:4], mine)), Counter[str]()

    def see(one: Judged | None) -> None:
        seen.update([one.name] if one else [])

    for some in (control, control.take(np.arange(len(control)) > 0)):
        seen.clear()
        repeated(some, portfolio, see)
        assert ("mine" in [one.name for one in portfolio.offered(some)]) == (seen["mine"] > 0)
        assert (seen["affine"] > 0) == (some is control)
    assert seen["mine"] > 0


@dataclass(frozen=True, eq=False)
class Uncalled(Known):
    """A candidate that features do not call for, though parts of them may."""

    near: Any = None

    def fit_control(self, control: Control) -> Fit:
        TRIED[self.name, len(control)] += 1
        raise Undetermined("the features do not call for it", hint="Choose another model.")

    def nearly(self, control: Control) -> bool:
        return super().nearly(control) if self.near is None else self.near


TRIED = Counter[tuple[str, int]]()


@pytest.mark.parametrize(("count", "folds"), [(19, 19), (20, 20), (39, 20), (40, 10)])
def test_folds_of_many_points_do_not_try_what_all_points_are_far_from(count: int, folds: int
                                                                      ) -> None:
    control = Control.of(termsel.simulate_scene("spot-isfahan", roles=(count, 0, 0), n_lines=0))
    portfolio = portfolio_with(
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

    def see(one: Judged | None) -> None:
        seen.update([one.name] if one else [])

    TRIED.clear()
    repeated(control, portfolio, see)
    of_few = folds if count < 20 else 0
    assert seen["good"] == seen["shrunken-quadratic"] == folds
    assert seen["bad"] == of_few
    parts = Counter(name for name, n in TRIED.elements() if n < count)
    assert parts["unasked"] == parts["in-parts"] == folds
    assert parts["never"] == of_few
    assert not portfolio.faults
    choice = choose(control, portfolio)
    hopeless = portfolio.for_parts_of(control, choice)._hopeless
    assert {"never", "bad"} <= hopeless
    assert not {"vain", "chicken", "egg"} & seen.keys()
    assert not {"unasked", "in-parts", "needy", "good", "cubic"} & hopeless


@pytest.mark.parametrize("most", [None, "12", 0, float("nan")])
def test_one_for_no_number_of_features_is_left_out_and_named(control: Control, most: Any) -> None:
    portfolio = portfolio_with(Known("mine", "a known model", Affine(), most=most))
    assert choose(control, portfolio) is not None
    assert repeated(control, portfolio) is not None
    assert f"'mine' has most={most!r}, which is no number of features" in portfolio.notes[0]


def test_lines_left_out_of_a_choice_do_not_count_in_its_folds() -> None:
    """Displaced lines are left out whole: the folds must then try what few points alone call for.
    """
    scene = termsel.simulate_scene("spot-isfahan", seed=1, roles=(8, 0, 100), n_lines=12)
    moved = np.random.default_rng(1).normal(size=(len(scene.lines.image), 1, 2)) * 40
    features = scene.with_(lines=replace(scene.lines, image=scene.lines.image + moved))
    for some in (features, features.with_(lines=no_lines())):
        result = termsel.run(features=some, strategy="auto")
        assert result.strategy.chosen == "physical-cubic"
        assert result.strategy.predicted < 3


def _judge_nothing(self: Candidate, control: Control) -> str:
    return "good"


def _judge_one(self: Candidate, control: Control) -> Judged:
    return Judged(self, self.fit_control(control), np.ones(1))


@pytest.mark.slow_cases("fit_control-<lambda>-failed in judge.*ZeroDivisionError")
@pytest.mark.parametrize(("attribute", "value", "said"), [
    ("fit_control", lambda self, control: 1 / 0, "failed in judge.*ZeroDivisionError"),
    ("declines", lambda self, control: control.nothing, "failed in declines.*AttributeError"),
    ("judge", _judge_nothing, "judge.. returned an object of type str; expected Judged"),
    ("judge", _judge_one, r"judge.. returned an array of shape \(1,\); expected"),
    ("size", lambda self, heights: 1 / 0, "failed in size.*ZeroDivisionError")])
def test_one_that_fails_is_left_out_and_named(control: Control, attribute: str, value: object,
                                              said: str) -> None:
    bad = type("Bad", (Known,), {attribute: value, "__module__": __name__})(
        "bad", "a bad one", Affine(), has_prior=True)
    portfolio, usual = portfolio_with(bad), choose(control)
    choice = choose(control, portfolio)
    assert choice is not None
    assert usual is not None
    assert (choice.chosen.name, choice.reason) == (usual.chosen.name, usual.reason)
    note, = portfolio.notes
    assert note.startswith("Left out of the choice: candidate 'bad' of ")
    np.testing.assert_equal(bool(__import__("re").search(said, note)), True)


def test_why_one_was_chosen_may_fail_and_nothing_else(control: Control) -> None:
    bad = type("Bad", (Known,), {"describe": lambda self, fitted: 1 / 0,
                                 "__module__": __name__})("bad", "a bad one", Affine())
    portfolio = Portfolio((bad,))
    choice = choose(control, portfolio)
    assert choice is not None
    assert choice.chosen.name == "bad"
    undetermined = type("Few", (Known,), {
        "judge": lambda self, control: self.lacking(), "__module__": __name__,
        "lacking": lambda self: (_ for _ in ()).throw(Undetermined("too few"))})(
            "few", "one for more points", Affine())
    quiet = Portfolio((undetermined,))
    assert choose(control, quiet) is None
    assert quiet.notes == ()


@pytest.mark.slow
def test_auto_chooses_one_of_the_session_and_reads_it_back(
        session: Callable[[Candidate], None], tmp_path: Path) -> None:
    termsel.register(Crossed)
    session(Known("crossed-known", "a known model with a twist", Crossed(), 1e-6, has_prior=True))
    session(Broken("broken", "a broken model", Affine()))
    scene = termsel.simulate_scene("ikonos-hamedan", n_points=24, n_lines=0)
    result = termsel.run("rfm-terms", features=scene, strategy="auto", out=tmp_path / "r")
    assert result.strategy.chosen == "crossed-known"
    assert "The geometry of crossed is known." in result.strategy.reason
    assert "a known model with a twist" in result.judgement
    assert result.model == "crossed"
    assert result.plugins["candidate"]["name"] == "session:crossed-known"
    assert sum(note.startswith("Left out of the choice: candidate 'broken'")
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

    def fit(self, model: Fittable, control: FeatureSet, scaling: Scaling, terms: BoolArray,
            used: BoolArray) -> Fit:
        plain = LEAST_SQUARES.fit(model, control, scaling, terms, used)
        fitted = plain.with_coefficients(plain.adjustment.coefficients * self.factor, self, 8.0)
        errors = fitted.errors(control.points)
        return replace(fitted, held_out=HeldOut.of(errors, control))


@pytest.mark.slow
def test_a_result_of_an_estimator_of_the_session_is_the_same_fit_again(
        session: Callable[[Candidate], None], tmp_path: Path) -> None:
    session(Structure("small", "a small model", Affine(), None, has_prior=True,
                      estimator=Shrinking(1.0 - 1e-6), contains=(
                          "shrunken-quadratic", "shrunken-cubic", "physical-cubic", "field")))
    scene = termsel.simulate_scene("ikonos-hamedan", n_points=24, n_lines=0)
    result = termsel.run("rfm-terms", features=scene, strategy="auto", out=tmp_path / "r")
    assert result.strategy.chosen == "small"
    again = termsel.read_result(tmp_path / "r")
    assert again.fit.made is not None
    assert again.fit.made.estimator == Shrinking(1.0 - 1e-6)
    assert again.fit.coefficients == result.fit.coefficients
    assert again.fit.effective == result.fit.effective == 8.0
    assert again.final is not None
    assert again.final.estimator == Shrinking(1.0 - 1e-6)


def test_a_name_that_is_taken_keeps_the_built_in(session: Callable[[Candidate], None],
                                                 control: Control) -> None:
    from termsel.runs.task.given import all_candidates

    session(Known("affine", "another affine model", Affine()))
    assert registry().known("candidates", "affine") is named("affine")
    assert [one.title for one in all_candidates().candidates if one.name == "affine"] == [
        "an affine polynomial"]
    assert termsel.fit(control.features, "session:affine").model.name == "affine"


@pytest.mark.parametrize("candidate", CANDIDATES[:4] + CANDIDATES[12:13],
                         ids=lambda one: one.name)
def test_built_in_candidates_conform(candidate: Candidate) -> None:
    check(candidate)


class Boasting(Structure):
    """Says that its residuals are errors of points that took no part."""

    def judge(self, control: Control) -> Judged | None:
        fitted = self.fit_control(control)
        return Judged(self, fitted, (fitted.errors(control.features.points) ** 2).sum(axis=1))


class Mute(Structure):
    """Declines without a word."""

    def declines(self, control: Control) -> str | None:
        return ""


class Vague(Structure):
    """Says in words whether parts of features may call for it."""

    def nearly(self, control: Control) -> bool:
        return "perhaps"  # type: ignore[return-value]


@pytest.mark.parametrize(("candidate", "name", "said"), [
    (Vague("vague", "a vague one", Affine(), None), "nearly", "'perhaps'; expected a bool"),
    (Boasting("boast", "a cubic", Polynomial3D(degree=2), None), "judges", "too good to be true"),
    (Mute("mute", "a mute one", Affine(), None), "declines", "or a sentence"),
    (Structure("none", "one for nothing", None, None), "fits", "declines all features"),
    (Structure("bare", "Title", Affine(), None), "declaration", "begin it with an article"),
    (Structure("own", "a snake", Affine(), None, contains=("own",)), "declaration", "itself")])
def test_broken_candidates_are_told_why(candidate: Candidate, name: str, said: str) -> None:
    one, = (one for one in checks(candidate) if one.name == name)
    with pytest.raises(AssertionError, match=said):
        one.run()


@pytest.mark.slow
def test_what_follows_from_features_is_derived_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a run of auto each set of features is scaled once, and its heights are looked at once."""
    scaled, looked_at = Counter[tuple[str, ...]](), Counter[tuple[str, ...]]()
    scaling_of, heights_differ = control_module.scaling_of, control_module.heights_differ

    def counted_scaling(features: FeatureSet) -> object:
        scaled[features.ids] += 1
        return scaling_of(features)

    def counted_heights(control: Control) -> bool:
        looked_at[control.features.ids] += 1
        return heights_differ(control)

    monkeypatch.setattr(control_module, "scaling_of", counted_scaling)
    monkeypatch.setattr(control_module, "heights_differ", counted_heights)
    scene = termsel.simulate_scene("ikonos-hamedan", n_points=60, n_lines=0)
    termsel.run("rfm-terms", features=scene, strategy="auto")
    most = max(map(len, scaled))
    whole = sum(count for ids, count in scaled.items() if len(ids) >= most - 3)
    assert sum(scaled.values()) - len(scaled) <= 5
    assert whole <= 25
    assert sum(looked_at.values()) == 1
