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
    advantage_in_words,
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
    requirement_in_words,
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
    >>> fitted.method.name
    'regularised-cubic'
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
        """Note a fault of each method whose `max_features` is no number; it is not asked."""
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
            If the features outside some fold are too few to choose by.
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
        """Return what a hook of a method returns for these arguments.

        Returns None where the features do not determine the method, and where the hook fails. A
        method of a plugin that fails is left out from then on; a failure of termsel's own methods
        is raised.
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
        """Return the methods to choose from for some features, the smallest first.

        With `for_few` only the methods for few features are offered, else only the other ones. Left
        out are methods that are only shown, that have failed, that decline the features, or that
        take fewer features than there are.
        """
        # Parts of the features have the methods of all of them. Without lines in use, the points
        # are counted alone.
        all_features = self.all_features or data.features
        count = len(all_features) if len(data.features.lines) else len(all_features.points)
        sizes: dict[Method, Any] = {}
        for method in self.methods:
            if method.name in self.faults:
                continue
            # A single method is fitted whatever its place among others would be.
            if self.is_one_method:
                has_a_place = not for_few
            else:
                has_a_place = (not method.only_shown and method.for_few == for_few
                               and count <= method.max_features)
            if has_a_place and self.ask(method, "declines", data) is None:
                sizes[method] = self.ask(method, "size", data.heights)
        # The questions just asked may have made a method fail.
        sound_methods = [method for method in sizes if method.name not in self.faults]
        return sorted(sound_methods, key=sizes.__getitem__)

    def suspects(self, data: FitData) -> Suspects | None:
        """Return what the first method that suspects any features says of them; None if none does.
        """
        answers = (self.ask(method, "suspects", data) for method in self.offered(data))
        return next((suspects for suspects in answers if suspects is not None), None)

    def fewest(self, data: FitData) -> int:
        """Return the fewest features to choose by."""
        # The automatic choice needs one point more than a model that fits them exactly.
        return 1 if any(method.from_one for method in self.offered(data)) else MAX_EXACT_POINTS + 1

    def fit_of(self, method: Method, data: FitData) -> Fit | None:
        """Return the fit of a method; None where `ask` returns none.

        Fits of termsel's own methods to all features are kept in `memory`; fits to parts are not.
        """
        if self.all_features is not None or not is_own(method):
            fitted: Fit | None = self.ask(method, "fit", data)
        else:
            fitted = self._call(method, "fit", lambda: self.memory.fit(method, data))
        return fitted

    def validated(self, method: Method, data: FitData) -> Fit | None:
        """Return a method fitted to features, whose error at each held-out feature is known.

        Returns None where the method is not tried on them, fails, has a pole, or is not determined
        by them with redundancy.
        """
        if method.name in self.hopeless or not self.ask(method, "tried", data):
            return None
        fitted = self.fit_of(method, data)
        if fitted is None:
            return None
        if fitted.method is not method:
            fitted = replace(fitted, method=method)
        # Without redundancy, or with a pole, held-out errors say nothing.
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
        the points support a random field, the regularised polynomial with it takes the place of the
        polynomials without one. Where features are too few for any method with a prior,
        similarities and a plane affine polynomial are tried, too. `with_contained` has methods that
        others contain fitted all the same, and the reason stated, to be shown.
        """
        candidates = self.offered(data)
        settled = self._settled_choice(candidates, data)
        if settled is not None:
            return settled
        compared = self._validated_fits(candidates, data, watch, with_contained=with_contained)
        # Few features: the simplest methods, which are fitted only then, may be the best.
        has_prior = any(method_of(fitted).has_prior for fitted in compared)
        if not has_prior or is_undecided(data):
            compared = [*self.few(data), *compared]
        choice = self.best_of(compared, explained=with_contained)
        if choice is not None and self.is_one_method:
            return replace(choice, reason=_reason_of_only(choice.chosen))
        return choice

    def _settled_choice(self, candidates: Iterable[Method], data: FitData) -> Choice | None:
        """Return the choice of the first method that says that no other one is possible.

        A method may say so where a file names its sensor, for example. Returns None if none does.
        """
        for method in candidates:
            reason = self._reason_for_only_method(method, data)
            fitted = self.validated(method, data) if reason else None
            if fitted is not None:
                return Choice(fitted, (fitted,), str(reason))
        return None

    def _validated_fits(self, candidates: Iterable[Method], data: FitData, watch: Watch | None, *,
                        with_contained: bool) -> list[Fit]:
        """Return the fits of the candidates that can be held against the features, in their order.

        Methods that a fitted one contains are left out unless `with_contained`, as are methods that
        need another one which has no fit. `watch` is told of each candidate.
        """
        fits: dict[str, Fit] = {}
        in_fitting_order = list(candidates)
        if not with_contained:
            # The widest first, as what they contain need not be fitted then.
            in_fitting_order.sort(key=lambda method: -len(method.contains))
        for method in in_fitting_order:
            is_wanted = fits.keys() >= set(method.needs) and (
                with_contained or not is_contained(method, fits.values()))
            fitted = self.validated(method, data) if is_wanted else None
            if fitted:
                fits[method.name] = fitted
            if watch:
                watch(fitted)
        return [fits[method.name] for method in candidates if method.name in fits]

    @property
    def is_one_method(self) -> bool:
        """Whether only one method is offered, so that nothing is chosen."""
        return len(self.methods) == 1

    def _reason_for_only_method(self, method: Method, data: FitData) -> str | None:
        """Return why the features support no method but this one; None if they do, or it fails.

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
        """Return the choice among fits by the rule; None if there are no fits.

        A fit that would be chosen but runs away between the points is left out, unless every choice
        does. Only where the choice is to be `explained` are methods asked what supports them.
        """
        remaining = list(fits)

        def describe(fitted: Fit) -> str | None:
            description: str | None = self.ask(method_of(fitted), "describe", fitted)
            return description

        choice_of_all = best_of(remaining, describe, explained=explained)
        choice = choice_of_all
        # Each round leaves one fit out, so that it ends with the choice or without fits.
        while choice is not None and is_astray_between(choice.chosen):
            remaining.remove(choice.chosen)
            choice = best_of(remaining, describe, explained=explained)
        return choice or choice_of_all

    def choose_features(self, data: FitData, watch: Watch | None = None, *,
                        with_contained: bool = True) -> Choice | None:
        """Return the choice from points with lines, or from the points alone if that is better.

        Lines that add more error than redundancy are left out as a whole: where the points alone
        predict the points, each by the others, better by more than PRIOR_MARGIN standard errors.
        The control of the chosen fit then has no lines. `watch` is told only of the choice from all
        features. Returns None where `choose` returns none for all features.
        """
        count = len(data.features.points)
        choice = self.choose(data, watch, with_contained=with_contained)
        if choice is None or not count or not len(data.features.lines):
            return choice
        points = FitData.of(data.features.with_(lines=empty_lines()), data.heights)
        points_choice = self.choose(points, with_contained=with_contained)
        if points_choice is None:
            return choice
        # By the points, which both choices predict; only one of them has lines.
        advantage = gain_of(points_choice.chosen.held_out().squares,
                            choice.chosen.held_out().squares[:count], choice.chosen.rounding)
        comparison = (
            "Points alone predict the points "
            f"{advantage_in_words(advantage, 'points with lines')}"
            f"{requirement_in_words(advantage, PRIOR_MARGIN)}")
        if advantage > PRIOR_MARGIN:
            return replace(points_choice,
                           reason=f"{points_choice.reason} {comparison}, so the lines are not "
                           "used.")
        return replace(choice, reason=f"{choice.reason} {comparison}.")

    # The choice, repeated without some of the features.

    def for_parts_of(self, data: FitData, choice: Choice | None = None) -> Auto:
        """Return the choice to be made from parts of these features, such as all but a fold.

        All features count for `Method.max_features`. Where the `choice` from all of them is given,
        methods that came nowhere near it are not fitted to parts. These are methods without a prior
        that predict no better than the fit to beat. They are also methods that all features do not
        determine or do not support; a method may say, though, that parts of the features may.
        """
        choice_for_parts = replace(self, all_features=data.features, hopeless=frozenset())
        priors = [] if choice is None else [
            fitted for fitted in choice.compared if method_of(fitted).has_prior]
        if choice is None or not priors:
            return choice_for_parts
        base = fit_to_beat(priors)[0]
        # Near the choice is a method that gains on the fit to beat, or has a prior.
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
        """Return the errors of features under choices made without them, (n_points + 2 n_lines, 2).

        The choice is made again without each of some folds, which are spread over the scene, so
        that the errors are not those that it was made by. They are measured minus predicted [px]:
        of a point its line and sample, then of each vertex of a line its distances, weighted by how
        well the image line is known there, so that they compare with the coordinates of points.

        Returns None if some fold leaves too little to choose by, or lines alone that are too few to
        shrink. `choice` is the choice from all features, if it is known.
        """
        fits_told = 0
        folds = folds_of(data.features)

        def tell(fitted: Fit | None) -> None:
            nonlocal fits_told
            fits_told += 1
            if watch:
                watch(fitted)

        def compute() -> tuple[FloatArray | None, int]:
            return self._errors_in_folds(data, tell, folds, choice), fits_told

        errors: FloatArray | None
        errors, fits_tried = self.recall(("repeated", folds), data, compute)
        # A progress bar was told how many fits there would be: those of an answer that is
        # remembered are told, too.
        for _ in range(fits_tried - fits_told):
            tell(None)
        return errors

    def recall(self, question: Any, data: FitData, find: Callable[[], Any]) -> Any:
        """Return the value that `find` gave for a question on equal features, or call it now."""
        key = question, self.methods, tuple(self.faults)
        return self.memory.recall(key, data, find, lambda: len(self.faults))

    def _errors_in_folds(self, data: FitData, watch: Watch, folds: int,
                         choice: Choice | None) -> FloatArray | None:
        """Return errors [px] of points, then line vertices, (m, 2), by choices without their fold.

        Returns None if the choice cannot be made without some fold. Errors of lines are multiplied
        by their weights in the adjustment.
        """
        features = data.features
        fold_of_feature = fold_of_each(features, folds)
        count = len(features.points)
        feature_of_row = features.feature
        errors = np.empty((len(feature_of_row), 2))
        fit_without = self._fitting_without(data, watch, choice)
        for fold in range(folds):
            in_fold = fold_of_feature == fold
            fold_features = features.take(in_fold)
            fitted = fit_without(in_fold)
            if fitted is None:
                return None
            distances = np.linalg.norm(fitted.line_errors(fold_features.lines), axis=2)
            errors[:count][in_fold[:count]] = fitted.errors(fold_features.points)
            errors[count:][in_fold[feature_of_row[count:]]] = distances
        if count < len(feature_of_row):
            # Errors of lines count by their length, as in the adjustment.
            weights = row_weights(data.scaled, heights=data.heights)
            errors[count:] *= weights[2 * count:].reshape(-1, 2)
        errors.setflags(write=False)  # whoever asks again gets the same
        return errors

    def _fitting_without(self, data: FitData, watch: Watch,
                         choice: Choice | None) -> Callable[[BoolArray], Fit | None]:
        """Return a function that makes the choice without the features of a mask (n,).

        That function returns the fit of the method that the remaining features choose. If none of
        those compared has a prior, it is the method that all features choose, fitted to those that
        remain: few of them choose by luck. Lines alone have no such second choice. None is returned
        if nothing can be fitted. `choice` is that of all features; if it is not given, it is made
        where it is needed.
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
            """Return the fit without the features of the mask `excluded` (n,).

            The rest chooses for itself if a method with a prior is compared; else the method that
            all features choose is fitted to it. None for lines alone in that case, and where
            nothing can be fitted.
            """
            remaining = _features_without(data, excluded)
            choice = None
            if len(remaining) >= fewest:
                choice = choice_for_parts.choose_features(remaining, watch, with_contained=False)
            if choice is not None and any(
                    method_of(compared).has_prior for compared in choice.compared):
                return choice.chosen
            if not len(features.points):
                return None
            # Few features choose by luck: the method that all of them choose is fitted to these.
            fitted = None if choice is None else choice.chosen
            if choice_from_all := choice_of_all():
                refitted: Fit | None = self.ask(choice_from_all.method, "refit",
                                                choice_from_all.chosen,
                                                replace(remaining, heights=data.heights))
                fitted = refitted or fitted
            return fitted

        return fit_without

    def _alone_without(self, data: FitData, watch: Watch, excluded: BoolArray) -> Fit | None:
        """Return the fit of the only method to features that are not excluded; None if it fails.

        `watch` is told of the fit.
        """
        fitted: Fit | None = self.ask(self.methods[0], "fit", _features_without(data, excluded))
        watch(fitted)
        return fitted

    def between_lines(self, data: FitData, lattice: Lattice, watch: Watch,
                      choice: Choice) -> tuple[FloatArray, IntArray] | None:
        """Return errors [px] of points of a lattice without their line, (m, 2), and their lines.

        The choice is made again without some lines, whose neighbours stay. The m points are those
        of lines that are held out. The outermost lines always stay, as nothing is asked for beyond
        them, and so do the lines next to them where enough lines remain to be held out: one line on
        a side is too little to go on from. The same is done with the columns of the lattice, and
        the errors are those in the direction in which they are larger. Returns None if some part of
        the lattice leaves too little to choose by.
        """
        fit_without = self._fitting_without(data, watch, choice)
        directions = []
        for line_numbers in (lattice.line, lattice.column):
            errors = np.full((len(data), 2), np.nan)
            count = int(line_numbers.max()) + 1
            first, last = held_out_lines(count)
            is_inside = (line_numbers >= first) & (line_numbers <= last)
            # Every FOLDS_OF_LATTICE-th line is held out at once, so that its neighbours stay.
            for fold in range(folds_along(count)):
                in_fold = is_inside & ((line_numbers - first) % FOLDS_OF_LATTICE == fold)
                fitted = fit_without(in_fold)
                if fitted is None:
                    return None
                errors[in_fold] = fitted.errors(data.features.take(in_fold).points)
            directions.append((errors[is_inside], line_numbers[is_inside]))
        return max(directions,
                   key=lambda direction: float((direction[0]**2).sum(axis=1).mean()))


def _features_without(data: FitData, excluded: BoolArray) -> FitData:
    """Return the features that are not excluded, a mask (n,).

    They count as plane where their heights show no relief by themselves, or where a single feature
    makes all of it.
    """
    remaining = data.take(~excluded)
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

    Returns None where the features do not determine the method, or its fit has a pole at them.
    """
    if method.declines(data) is not None:
        return None
    try:
        fitted = method.fit(data)
    except Undetermined:
        return None
    # Without redundancy the fit passes through all points, and no residual says how good it is.
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
    """Return the choice for four points, which is a projection where they show an oblique view.

    Four points show an oblique view where an affine transformation of them leaves more than a map
    or a vertical photo may, and no point would be behind the camera. The projection is that of a
    camera without distortion if the points support one, and else a projective transformation of the
    plane. In all other cases the `choice` is returned as it was given.
    """
    if len(data) != EXACT_PROJECTIVE_POINTS or len(
            data.features.points) != EXACT_PROJECTIVE_POINTS or choice.method.from_one:
        return choice
    # Four points have eight coordinates: as many as the terms of a projective transformation.
    plane = replace(data, heights=False)
    projective = named("projective")
    try:
        affine_rmse = named("affine").fit(plane).control_rmse()
        fitted = projective.fit(plane)
    except Undetermined:
        return choice
    assert affine_rmse is not None
    shows_oblique_view = affine_rmse.total >= OBLIQUE_RMSE * data.scaling.image_scale
    camera = named("pinhole")
    camera_fit = auto.validated(camera, data) if camera in auto.offered(data) else None
    if camera_fit is not None and shows_oblique_view:
        return Choice(
            _without_redundancy(camera, camera_fit), choice.compared,
            f"{EXACT_PROJECTIVE_POINTS} points leave one equation of it. An affine polynomial "
            f"leaves {affine_rmse.total:.3g} px of them, more than a map or a vertical photo does.")
    # A point with a denominator of the other sign would be behind the camera.
    denominators = fitted.model.denominators(fitted.adjustment.coefficients,
                                             fitted.scaled_control.points.ground)
    assert denominators is not None
    if not shows_oblique_view or (denominators <= 0.0).any():
        return choice
    return Choice(
        _without_redundancy(projective, fitted), choice.compared,
        f"{EXACT_PROJECTIVE_POINTS} points determine it exactly. An affine polynomial leaves "
        f"{affine_rmse.total:.3g} px of them, more than a map or a vertical photo does.")


def _without_redundancy(method: Method, fitted: Fit) -> Fit:
    """Return the fit under its method, with NaN for each error of a feature held out."""
    unknown = HeldOut(np.full(len(fitted.control), np.nan))
    return replace(fitted, method=method, stored_held_out=unknown)
