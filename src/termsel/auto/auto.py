"""The method "auto": the best of several methods for the features, by what each predicts.

Nothing here knows of roles: what it is given are features it may use. A choice looks at all methods
for all features; to see what it is worth it is made again in folds, without some of the features
each time.
"""

from __future__ import annotations

import numbers
from collections.abc import Callable, Iterable
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cache, partial
from typing import Any

import numpy as np

from termsel.adjustment.equations import row_weights
from termsel.auto.memory import Memory
from termsel.auto.methods import METHODS, named
from termsel.auto.rule import (
    FOLDS_OF_LATTICE,
    PRIOR_MARGIN,
    Choice,
    best_of,
    fit_to_beat,
    fold_of_each,
    folds_along,
    folds_of,
    gain,
    gain_of,
    has_pole,
    held_out_lines,
    is_astray_between,
    is_contained,
    is_undecided,
    method_of,
    standard_errors,
)
from termsel.core.errors import TermselError
from termsel.core.isolation.arrays import difference_from_shape, difference_from_type
from termsel.core.isolation.faults import (
    HINT,
    PluginFault,
    attribute_errors_to,
    fault_of_method,
    is_own,
)
from termsel.data.coordinates.places import Lattice
from termsel.data.features import BoolArray, FeatureSet, FloatArray, IntArray, empty_lines
from termsel.data.fit_data import FitData, relief_carriers
from termsel.data.record.search import ALL_TERMS_IN_USE, NAMED_BY_USER
from termsel.fitting.fit import Fit, HeldOut, Undetermined
from termsel.fitting.method import Method, Suspects
from termsel.models.base import SensorModel

MAX_EXACT_POINTS = 3
"""Number of points up to which a model fits them exactly, and none is chosen."""

HOPELESS_MIN_POINTS = 20
"""Points from which on folds do not try what all points together come nowhere near to choosing."""

Watch = Callable[[Fit | None], None]
"""Called with the fit of each method as soon as it is held against the features; with None where
the features do not determine it."""

_HOOK_TYPES = {"declines": str, "describe": str, "doubt": str, "fit": Fit, "held_out": HeldOut,
               "model": SensorModel, "nearly": bool, "refit": Fit,
               "size": numbers.Real, "suspects": Suspects, "tried": bool}
"""Types of what hooks of a method return, if it is not None."""


@dataclass(frozen=True, eq=False)
class Auto(Method):
    """The method that chooses among methods. One of a plugin that fails is left out from then on.

    Parameters
    ----------
    methods : tuple of Method
        In the order of the tables that compare them; by default those that are built in.
    memory : Memory
        What was found of the last features, by this choice or another.
    faults : dict
        Why methods are left out, by name.
    all_features : FeatureSet, optional
        All features, where those to choose by are a part: then all of them count for
        `Method.max_features`.
    hopeless : frozenset of str
        Names of methods that are not tried on parts of the features.

    Examples
    --------
    >>> import termsel
    >>> auto = termsel.Auto()
    >>> fitted = auto.fit(termsel.FitData.of(termsel.simulate_scene("spot-isfahan")))
    >>> fitted.method.name in {method.name for method in auto.methods}
    True
    """

    name: str = "auto"
    title: str = "the best of all methods"
    _: KW_ONLY
    methods: tuple[Method, ...] = METHODS
    memory: Memory = field(default_factory=Memory)
    faults: dict[str, TermselError] = field(default_factory=dict)
    all_features: FeatureSet | None = None
    hopeless: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        # A class of a plugin may declare anything: what is no number would fail at each comparison.
        for method in self.methods:
            if not (isinstance(method.max_features, numbers.Real) and method.max_features > 0):
                limit = f"max_features={method.max_features!r:.40}"
                self.faults[method.name] = TermselError(
                    f"method {method.name!r} has {limit}, which is no number of features",
                    hint=HINT)

    # What it is as a method.

    def fit(self, data: FitData) -> Fit:
        """Return the fit of the method that is chosen (see `choose_features`).

        Raises
        ------
        Undetermined
            If the features are too few for a choice.
        """
        choice = self.choose_features(data)
        if choice is None:
            raise Undetermined(f"the features are too few for a choice: it takes "
                               f"{self.fewest(data)}", hint="Measure more.")
        return choice.chosen

    def held_out(self, fitted: Fit) -> HeldOut:
        """Return the error of each feature when the whole choice is made again without it.

        Many features are held out in folds.

        Raises
        ------
        Undetermined
            If the others are too few to choose by in some fold.
        """
        # The choice is repeated as a whole: errors under the chosen method alone are too small.
        data = FitData.of(fitted.control, fitted.model.uses_height)
        errors = self.repeated(data)
        if errors is None:
            raise Undetermined("the features are too few to repeat the choice without some of "
                               "them",
                               hint="Measure more.")
        return HeldOut.of(errors, fitted.control)

    # What methods say, and which fail.

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on the methods that are left out, with the reason for their authors."""
        return tuple(f"Left out of the choice: {fault.what}. {fault.hint or HINT}"
                     for fault in self.faults.values())

    def ask(self, method: Method, hook: str, *args: Any) -> Any:
        """Return the value of a method's hook.

        None where the features do not determine the method, and where it fails: then it is left out
        from now on, unless it is termsel's own.
        """
        return self._call(method, hook, lambda: getattr(method, hook)(*args))

    def _call(self, method: Method, hook: str, call: Callable[[], Any]) -> Any:
        """Return what a hook of a method returns; None if it fails or has nothing to say.

        A method that fails is remembered in `faults`, and not asked again.

        Raises TermselError only for a method of termsel's own, in which it is a mistake.
        """
        # What failed once is not asked again: it would slow the run and say the same.
        if method.name in self.faults:
            return None
        try:
            with attribute_errors_to(method, hook):
                answer = call()
            answer = bool(answer) if isinstance(answer, np.bool_) else answer
            fault = answer is not None and difference_from_type(answer, _HOOK_TYPES[hook])
            if fault:
                raise fault_of_method(method, hook, fault)
        # Not determined is an answer: the method has nothing to say of these features.
        except Undetermined:
            return None
        except TermselError as error:
            # An error of termsel's own is a mistake in termsel, and must be seen.
            if is_own(method):
                raise
            if not isinstance(error, PluginFault):
                error = TermselError(f"method {method.name!r} says: {error.what}", hint=error.hint)
            self.faults[method.name] = error
            return None
        return answer

    def offered(self, data: FitData, *, for_few: bool = False) -> list[Method]:
        """Return the methods to choose from for some features, the plainest first."""
        # Those are counted that these are a part of; points where there are no lines, as a line has
        # equations of its own kind.
        all_features = self.all_features or data.features
        count = len(all_features) if len(data.features.lines) else len(all_features.points)
        sizes: dict[Method, Any] = {}
        for method in self.methods:
            # One that is asked for is fitted whatever its place among others would be.
            if self.is_one_method:
                has_a_place = not for_few
            else:
                has_a_place = not method.only_shown and method.for_few == for_few
            if (has_a_place and method.name not in self.faults and count <= method.max_features
                    and self.ask(method, "declines", data) is None):
                sizes[method] = self.ask(method, "size", data.heights)
        # Again, as what was asked just now may have failed.
        sound = [method for method in sizes if method.name not in self.faults]
        return sorted(sound, key=lambda method: sizes[method])

    def suspects(self, data: FitData) -> Suspects | None:
        """Return the features that contradict the first method that knows of any; None without."""
        answers = (self.ask(method, "suspects", data) for method in self.offered(data))
        return next((suspects for suspects in answers if suspects is not None), None)

    def fewest(self, data: FitData) -> int:
        """Return the fewest features to choose by."""
        # The automatic choice needs one point more than a model that fits them exactly.
        return 1 if any(method.from_one for method in self.offered(data)) else MAX_EXACT_POINTS + 1

    def fit_of(self, method: Method, data: FitData) -> Fit | None:
        """Return the fit of a method, or None as of `ask`; that of all features is remembered."""
        if self.all_features is not None or not is_own(method):
            fitted: Fit | None = self.ask(method, "fit", data)
        else:
            fitted = self._call(method, "fit", lambda: self.memory.fit(method, data))
        return fitted

    def validated(self, method: Method, data: FitData) -> Fit | None:
        """Return a method fitted to features, with the errors of each held out.

        None where it is not tried on them, they do not determine it with redundancy, it has a pole,
        or it fails.
        """
        if method.name in self.hopeless or not self.ask(method, "tried", data):
            return None
        unnamed = self.fit_of(method, data)
        if unnamed is None:
            return None
        fitted = unnamed if unnamed.method is method else replace(unnamed, method=method)
        # An error without redundancy, or with a pole, would be one by chance.
        if fitted.stored_held_out is None and (
                fitted.adjustment.redundancy < 1 or has_pole(fitted)):
            return None
        held_out: HeldOut | None = self._call(method, "held_out", fitted.held_out)
        if held_out is None:
            return None
        if not is_own(method):
            fault = difference_from_shape(held_out.squares, (len(data),)) or (
                None if isinstance(getattr(fitted.estimator, "name", None), str) else
                "returned a fit by an estimator without a name, by which a result is read again")
            if fault is not None:
                self.faults[method.name] = fault_of_method(method, "held_out", fault)
                return None
        return fitted

    # The choice.

    def choose(self, data: FitData, watch: Watch | None = None, *,
               with_contained: bool = True) -> Choice | None:
        """Return the choice among the fitted methods by leave-one-out; None if none is determined.

        A regularised polynomial is averaged over all that lies between the plain ones, by a measure
        that needs no points to be left out. The rule is that of `termsel.auto.rule.best_of`: where
        the points support a random field, the regularised polynomial with it takes the place of
        those without. Where features are too few for any method with a prior, similarities and a
        plane affine polynomial are tried, too. `with_contained` has methods that others contain
        fitted all the same, and the reason stated, to be shown.
        """
        candidates = self.offered(data)
        # A method may say that nothing else is possible, as of a file that names its sensor.
        # The first method that the features support alone is the choice.
        for method in candidates:
            reason = self._settles(method, data)
            settled = self.validated(method, data) if reason else None
            if settled is not None:
                return Choice(settled, (settled,), str(reason))
        fits: dict[str, Fit] = {}
        # What contains others comes first where these need not be fitted then.
        # In folds, where the whole comparison is not needed, the largest come first.
        order = (
            candidates
            if with_contained
            else sorted(candidates, key=lambda method: -len(method.contains))
        )
        for method in order:
            called_for = fits.keys() >= set(method.needs) and (
                with_contained or not is_contained(method, fits.values()))
            fitted = self.validated(method, data) if called_for else None
            if fitted:
                fits[method.name] = fitted
            if watch:
                watch(fitted)
        # In the order of the offer, whatever the order of fitting.
        compared = [fits[method.name] for method in candidates if method.name in fits]
        has_prior = any(method_of(fitted).has_prior for fitted in compared)
        if not has_prior or is_undecided(data):
            compared = [*self.few(data), *compared]
        choice = self.best_of(compared, explained=with_contained)
        if choice is not None and self.is_one_method:
            return replace(choice, reason=_reason_of_only(choice.chosen))
        return choice

    @property
    def is_one_method(self) -> bool:
        """Whether only one method is offered, so that nothing is chosen."""
        return len(self.methods) == 1

    def _settles(self, method: Method, data: FitData) -> str | None:
        """Return why the features support a method alone; None if they do not, or the method fails.

        Raises TermselError where the method says what the user must say first.
        """
        try:
            with attribute_errors_to(method, "settles"):
                reason = method.settles(data)
            if reason is not None and (fault := difference_from_type(reason, str)):
                raise fault_of_method(method, "settles", fault)
        except PluginFault as fault:
            self.faults[method.name] = fault
            return None
        return reason

    def few(self, data: FitData) -> list[Fit]:
        """Return the fits of methods for few features that have redundancy."""
        fits = (self.validated(method, data) for method in self.offered(data, for_few=True))
        return [fitted for fitted in fits if fitted]

    def best_of(self, fits: Iterable[Fit], *, explained: bool = True) -> Choice | None:
        """Return the choice among fits by the rule; None if there is none.

        What would be chosen and runs away between the points is left out, unless all does. Only
        where it is to be `explained` are methods asked to describe what supports them.
        """
        remaining = list(fits)

        def describe(fitted: Fit) -> str | None:
            description: str | None = self.ask(method_of(fitted), "describe", fitted)
            return description

        first = choice = best_of(remaining, describe, explained=explained)
        while choice is not None and is_astray_between(choice.chosen):
            remaining.remove(choice.chosen)
            choice = best_of(remaining, describe, explained=explained)
        return choice or first

    def choose_features(self, data: FitData, watch: Watch | None = None, *,
                        with_contained: bool = True) -> Choice | None:
        """Return the choice of `choose`, from points with lines or from the points alone.

        Lines that add more error than redundancy are left out whole: where the points alone predict
        the points, each by the others, better by PRIOR_MARGIN standard errors. The control of the
        chosen fit then has no lines. `watch` is told of the choice from all features alone. None as
        for `choose`.
        """
        count = len(data.features.points)
        choice = self.choose(data, watch, with_contained=with_contained)
        if choice is None or not count or not len(data.features.lines):
            return choice
        points = FitData.of(data.features.with_(lines=empty_lines()), data.heights)
        points_choice = self.choose(points, with_contained=with_contained)
        if points_choice is None:
            return choice
        # Over the points, which both choices predict; lines are in one of them only.
        advantage = gain_of(points_choice.chosen.held_out().squares,
                            choice.chosen.held_out().squares[:count], choice.chosen.rounding)
        comparison = (
            f"Points alone predict the points {'better' if advantage > 0 else 'worse'} than points "
            f"with lines do, by {standard_errors(advantage)}")
        if advantage > PRIOR_MARGIN:
            return replace(points_choice,
                           reason=f"{points_choice.reason} {comparison}, so the lines are not "
                           "used.")
        return replace(choice, reason=f"{choice.reason} {comparison}; to be used alone they must "
                                      f"be better by more than {PRIOR_MARGIN:g}.")

    # The choice, repeated without some of the features.

    def for_parts_of(self, data: FitData, choice: Choice | None = None) -> Auto:
        """Return the choice for parts of features: of these all count for `Method.max_features`.

        With the choice from all of them, methods that it came nowhere near are not fitted: those
        without a prior that predict no better than the one to be beaten, and those that all
        features do not determine, or do not support, unless they say that parts may.
        """
        choice_for_parts = replace(self, all_features=data.features, hopeless=frozenset())
        priors = [] if choice is None else [
            fitted for fitted in choice.compared if method_of(fitted).has_prior]
        if choice is None or not priors:
            return choice_for_parts
        base = fit_to_beat(priors)[0]
        # Near is what gains on the fit to beat, or carries a prior that the choice rests on.
        is_near = {method_of(fitted).name: method_of(fitted).has_prior or gain(fitted, base) > 0.0
                   for fitted in choice.compared}

        def may_be_chosen(method: Method) -> bool:
            """Return whether a method can be the choice for some part of the features."""
            # What others contain, or what needs others, is fitted in parts only where these say so.
            if is_contained(method, priors) or not is_near.keys() >= set(method.needs):
                return True
            if method.name in is_near:
                return is_near[method.name]
            return bool(self.ask(method, "nearly", data))

        return replace(choice_for_parts, hopeless=frozenset(
            method.name for method in choice_for_parts.offered(data) if not may_be_chosen(method)))

    def repeated(self, data: FitData, watch: Watch | None = None,
                 choice: Choice | None = None) -> FloatArray | None:
        """Return the errors of features under choices made without them, (n_points + n_lines, 2).

        In each fold, spread over the scene, the choice is made again, so that its errors are not
        those that it was made by. They are measured minus predicted [px]: of a point its line and
        sample; of a line the distances of its two vertices, weighted by how well the image line is
        known there, so that they compare with two coordinates of a point. None if some fold leaves
        too little to choose by, or lines alone that are too few to shrink. `choice` is that from
        all features, if it is known.
        """
        count = 0
        folds = folds_of(data.features)

        def see(fitted: Fit | None) -> None:
            nonlocal count
            count += 1
            if watch:
                watch(fitted)

        def find() -> tuple[FloatArray | None, int]:
            return self._errors_in_folds(data, see, folds, choice), count

        errors: FloatArray | None
        errors, fits_tried = self.recall(("repeated", folds), data, find)
        # A progress bar was told how many fits there would be.
        for _ in range(fits_tried - count):  # what was found before is told, too
            see(None)
        return errors

    def recall(self, question: Any, data: FitData, find: Callable[[], Any]) -> Any:
        """Return the value that `find` gave for a question on equal features, or call it now."""
        key = question, self.methods, tuple(self.faults)
        return self.memory.recall(key, data, find, lambda: len(self.faults))

    def _errors_in_folds(self, data: FitData, watch: Watch, folds: int,
                         choice: Choice | None) -> FloatArray | None:
        """Return errors [px] of points and line vertices, (m, 2), by choices without their fold.

        None if the choice cannot be made without some fold. Errors of lines are multiplied by their
        weights in the adjustment.
        """
        features = data.features
        fold_of_feature = fold_of_each(features, folds)
        # Points first, then the vertices of lines.
        count = len(features.points)
        owner = features.feature
        errors = np.empty((len(owner), 2))
        fit_without = self._fitting_without(data, watch, choice)
        for fold in range(folds):
            in_fold = fold_of_feature == fold
            fold_features = features.take(in_fold)
            fitted = fit_without(in_fold)
            if fitted is None:
                return None
            distances = np.linalg.norm(fitted.line_errors(fold_features.lines), axis=2)
            errors[:count][in_fold[:count]] = fitted.errors(fold_features.points)
            errors[count:][in_fold[owner[count:]]] = distances
        if count < len(owner):
            # Errors of lines count by their length, as in the adjustment.
            weights = row_weights(data.scaled, heights=data.heights)
            errors[count:] *= weights[2 * count:].reshape(-1, 2)
        errors.setflags(write=False)  # whoever asks again gets the same
        return errors

    def _fitting_without(self, data: FitData, watch: Watch,
                         choice: Choice | None) -> Callable[[BoolArray], Fit | None]:
        """Return a function of a mask (n,) that makes the choice without these features.

        It returns the fit of the method chosen, None if too few features remain.
        """
        features = data.features
        if self.is_one_method:
            return partial(self._alone_without, data, watch)
        choice_of_all = cache(lambda: self.choose(data, with_contained=False))
        skips_hopeless = len(features.points) >= HOPELESS_MIN_POINTS and not len(features.lines)
        choice_for_parts = self.for_parts_of(
            data, (choice or choice_of_all()) if skips_hopeless else None)
        fewest = self.fewest(data)

        def fit_without(excluded: BoolArray) -> Fit | None:
            """Return the fit of the method that is chosen without some features; None if too few
            remain.
            """
            remaining = _features_without(data, excluded)
            if len(remaining) < fewest:
                chosen = None
            else:
                chosen = choice_for_parts.choose_features(remaining, watch, with_contained=False)
            fitted = None if chosen is None else chosen.chosen
            if chosen is None or not any(
                    method_of(compared).has_prior for compared in chosen.compared):
                if not len(features.points):
                    return None
                # Few features choose by luck: what all of them choose is fitted to these.
                if usual := choice_of_all():
                    fitted = self.ask(usual.method, "refit", usual.chosen,
                                      replace(remaining, heights=data.heights)) or fitted
            return fitted

        return fit_without

    def _alone_without(self, data: FitData, watch: Watch, out: BoolArray) -> Fit | None:
        """Return the fit of the only method without some features; None if it fails.

        There is nothing to choose by. `watch` is told of the fit.
        """
        fitted: Fit | None = self.ask(self.methods[0], "fit", _features_without(data, out))
        watch(fitted)
        return fitted

    def between_lines(self, data: FitData, lattice: Lattice, watch: Watch,
                      choice: Choice) -> tuple[FloatArray, IntArray] | None:
        """Return errors of points of a lattice without their line [px], (m, 2), and the lines.

        Or without their column, where that makes greater ones. The choice is made again without
        some lines, whose neighbours stay. The outermost ones always stay, as nothing is asked for
        beyond them, and so do those next to them where there are others: one line on a side is not
        enough to go on from. None if some part of the lattice leaves too little to choose by.
        """
        fit_without = self._fitting_without(data, watch, choice)
        directions = []
        for number in (lattice.line, lattice.column):
            errors = np.full((len(data), 2), np.nan)
            count = int(number.max()) + 1
            first, last = held_out_lines(count)
            inside = (number >= first) & (number <= last)
            for fold in range(folds_along(count)):
                in_fold = inside & ((number - first) % FOLDS_OF_LATTICE == fold)
                fitted = fit_without(in_fold)
                if fitted is None:
                    return None
                errors[in_fold] = fitted.errors(data.features.take(in_fold).points)
            directions.append((errors[inside], number[inside]))
        # The worse of both directions is the one that is stated.
        return max(directions,
                   key=lambda direction: float((direction[0]**2).sum(axis=1).mean()))


def _features_without(data: FitData, out: BoolArray) -> FitData:
    """Return the features that are not `out`, (n,).

    They count as plane where relief rested on one of those out: it shows nothing of these.
    """
    remaining = data.take(~out)
    return replace(remaining, heights=remaining.heights and not relief_carriers(remaining, limit=1))


# What so few features determine exactly, so that nothing can be chosen.

EXACT_PROJECTIVE_POINTS = 4
"""Number of points that a projective transformation fits exactly."""

OBLIQUE_RMSE = 0.02
"""RMSE of an affine transformation of four points, by the half extent of the image, from which on
they show an oblique view."""


def minimal_fit(data: FitData) -> Choice:
    """Return the exact fit to two features, a similarity, or to three, an affine polynomial.

    Raises Undetermined if three points lie on a line, or lines are parallel.
    """
    # Two points have the four equations of a similarity, three the six of an affine polynomial.
    plane = replace(data, heights=False)
    count = len(data)
    method = named("similarity" if count == 2 else "affine")
    chosen = _without_redundancy(method, method.fit(plane))
    return Choice(chosen, (*Auto().few(plane), chosen),
                  f"{count} {data.features.word} determine it exactly.")


def unjudged_fit(data: FitData, method: Method) -> Choice | None:
    """Return the fit of the only method where features determine it, and none can be left out.

    None where they do not determine it, or it has a pole at them.
    """
    if method.declines(data) is not None:
        return None
    try:
        fitted = method.fit(data)
    except Undetermined:
        return None
    unjudged = _without_redundancy(method, fitted)
    if not fitted.estimator.least_squares or has_pole(unjudged):
        return None
    return Choice(unjudged, (unjudged,), _reason_of_only(unjudged))


def _reason_of_only(fitted: Fit) -> str:
    """Return the reason of the choice of an only method, with what is said of its terms."""
    # An estimator may shrink or select terms, and a model that interpolates has more than terms.
    all_terms = (fitted.estimator.least_squares and fitted.terms.all()
                 and not fitted.model.corrects)
    return f"{NAMED_BY_USER} {ALL_TERMS_IN_USE}" if all_terms else NAMED_BY_USER


def minimal_view(data: FitData, choice: Choice, auto: Auto) -> Choice:
    """Return the projection that four points determine, where no other model fits.

    An affine transformation of four points leaves what a map or a vertical photo may leave; where
    it leaves more, and no point would be behind the camera, they show an oblique view. It is that
    of a camera without distortion where there is one, and else a projective transformation of the
    plane. Otherwise the choice is returned.
    """
    if len(data) != EXACT_PROJECTIVE_POINTS or len(
            data.features.points) != EXACT_PROJECTIVE_POINTS or choice.method.from_one:
        return choice
    # Four points have eight coordinates: as many as the terms of a projective transformation.
    plane = replace(data, heights=False)
    projective = named("projective")
    try:
        residuals = named("affine").fit(plane).control_rmse()
        fitted = projective.fit(plane)
    except Undetermined:
        return choice
    assert residuals is not None
    shows_oblique_view = residuals.total >= OBLIQUE_RMSE * data.scaling.image_scale
    camera = named("pinhole")
    camera_fit = auto.validated(camera, data) if camera in auto.offered(data) else None
    if camera_fit is not None and shows_oblique_view:
        return Choice(
            _without_redundancy(camera, camera_fit), choice.compared,
            f"{EXACT_PROJECTIVE_POINTS} points leave one equation of it. An affine polynomial "
            f"leaves {residuals.total:.3g} px of them, more than a map or a vertical photo does.")
    # A point with a denominator of the other sign would be behind the camera.
    denominators = fitted.model.denominators(fitted.adjustment.coefficients,
                                             fitted.scaled_control.points.ground)
    assert denominators is not None
    if not shows_oblique_view or (denominators <= 0.0).any():
        return choice
    return Choice(
        _without_redundancy(projective, fitted), choice.compared,
        f"{EXACT_PROJECTIVE_POINTS} points determine it exactly. An affine polynomial leaves "
        f"{residuals.total:.3g} px of them, more than a map or a vertical photo does.")


def _without_redundancy(method: Method, fitted: Fit) -> Fit:
    """Return the fit under its method, with NaN for each error of a feature held out."""
    unknown = HeldOut(np.full(len(fitted.control), np.nan))
    return replace(fitted, method=method, stored_held_out=unknown)
