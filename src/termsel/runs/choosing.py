"""Runs of the method "auto": the best model of the points, with an estimate of its accuracy."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from msgspec.structs import replace as changed

from termsel.auto.auto import MAX_EXACT_POINTS, Auto, minimal_fit, minimal_view, unjudged_fit
from termsel.auto.compare import compare
from termsel.auto.named_model import NamedModel, as_far_as_determined
from termsel.auto.rule import Choice, folds_of, gain, has_pole, method_of
from termsel.core.errors import TermselError, count_in_words, rounded_size_text
from termsel.core.interrupts import take_pending_interrupt
from termsel.core.remedies import Remedy
from termsel.data.coordinates.crs import LOCAL, normalise, to_wgs84
from termsel.data.features import FeatureSet, FloatArray, Points, empty_points, select
from termsel.data.fit_data import FitData
from termsel.data.record.figures import Predicted, is_determined_exactly
from termsel.data.record.search import RPC_UNUSED, CandidateRow, SearchLimits, Strategy
from termsel.data.roles import ASSIGNABLE, Observations, leave_out, with_lines, with_merged_twins
from termsel.fitting.accuracy import (
    pixel_on_ground,
    predict_rmse_between_lines,
    predict_rmse_of_all,
    predict_rmse_of_fit,
    weighted_rmse,
)
from termsel.fitting.extrapolation import warnings_of
from termsel.fitting.figures import Baseline, Rmses, finite_or_none, restrict_to_control
from termsel.fitting.fit import Fit, Undetermined
from termsel.fitting.method import Method
from termsel.models.base import SensorModel
from termsel.models.image_part import ImagePart
from termsel.plugins.registry import registry
from termsel.runs.between_points import uncertain_between_points
from termsel.runs.data_notes import (
    note_on_rounding,
    notes_on_data,
    notes_on_dem,
    uncertain_corners,
)
from termsel.runs.exported_rpc import doubt_of_rpc
from termsel.runs.finding import Finding, plugins_of
from termsel.runs.judgement import best_conventional, judge_choice
from termsel.runs.request import Request
from termsel.runs.slips import notes_on_slips
from termsel.runs.task import LEAST
from termsel.runs.verdict import Verdict, judge_features, judge_independent
from termsel.selection.problems.base import Evaluation, Selection
from termsel.selection.problems.recipes import Recipe
from termsel.selection.solvers.base import Generation
from termsel.selection.solvers.ledger import Progress
from termsel.selection.solvers.observers import Observer, Observers

INTERRUPTED = ("The run was interrupted when {0} of {1} candidates were judged. The choice was not "
               "repeated without some of the points, so it predicts no accuracy.")

NAMES = ("auto", "as-asked")

def uses_auto(strategy: str | None, recipe: Recipe, method: Sequence[str] = (), *,
              unnamed: bool = False) -> bool:
    """Return whether a run is to choose its method by itself.

    `strategy` is "auto", "as-asked" or None, where the user says nothing. `method` are the words
    for what is asked for of a method, such as "model". Without a strategy the run chooses if
    nothing of a method is asked for, and if methods without a search can answer the problem. A
    problem whose own search comes first is searched even so, unless nobody named it (`unnamed`).

    Raises TermselError for another strategy, for "auto" next to a method, and for "auto" of a
    problem that methods without a search cannot answer.
    """
    if strategy is not None and strategy not in NAMES:
        raise TermselError(f"there is no strategy {strategy!r}",
                           hint=f"Choose {' or '.join(NAMES)}.")
    if strategy != "auto":
        return (strategy is None and recipe.for_methods and (unnamed or not recipe.search_first)
                and not method)
    if not recipe.for_methods:
        raise TermselError(f"the strategy auto is not for the problem {recipe.name}",
                           hint="It chooses among models of points and lines: rfm-terms, "
                                "poly-terms, owdis-lines. To have a vendor's RPC corrected, leave "
                                "--problem out and add --rpc FILE.")
    if method:
        raise TermselError(
            f"{Remedy('strategy', 'auto')} chooses the method itself, so {method[0]} cannot be "
            "given",
            hint="Leave one of them out, or run the method with "
                 f"{Remedy('strategy', 'as-asked')}.")
    return True


class _Watch:
    """Tells observers how far a choice is, and keeps the fits to all points.

    `methods` and `folds` are how many there are: the choice tries all methods, and so does each
    fold. `fits` are those to all points, `count` is how many were tried, those of folds included.
    """

    def __init__(self, observers: Iterable[Observer], methods: int, folds: int) -> None:
        """Begin to count; without observers nothing is told."""
        all_observers = tuple(observers)
        self._observers = Observers(all_observers)
        self._is_observed = bool(all_observers)
        self._folds = folds
        self.methods = methods
        self.fits: list[Fit] = []
        self.count = 0

    def tell(self, activity: str, share: float | None = None) -> None:
        """Show observers the present step, and the share of the work that is done, 0 to 1."""
        if not self._is_observed:
            return
        best = min((fitted.held_out_rmse for fitted in self.fits), default=np.inf)
        generation = Generation(self.count, np.zeros((0, 0), dtype=bool),
                                Evaluation(np.zeros((0, 1)), np.zeros(0)))
        # No observer ends a choice: it is none before all candidates are judged.
        self._observers.tell(Progress(
            generation, self.count, share=share, best=best, violation=0.0,
            genes=np.zeros(0, dtype=bool), what=activity))

    def method(self, fitted: Fit | None) -> None:
        """Count a method that was tried, None for one without a fit, and tell the observers."""
        fold = self.count // self.methods
        self.count += 1
        if fitted and not fold:
            self.fits.append(fitted)
        self.tell("candidates" if not fold else f"fold {fold} of {self._folds}",
                  self.count / self.methods / (1 + self._folds))


@dataclass(frozen=True, eq=False)
class _Chosen:
    """A choice, and what its repetition in folds shows.

    `errors` are those of held-out features [px]; `exact` says that the features determine the model
    exactly; `between` what a lattice predicts of places between its lines.
    """

    choice: Choice
    errors: FloatArray | None = None
    exact: bool = False
    between: Predicted | None = None
    interrupted: bool = False


def choose_for(request: Request, observations: Observations, auto: Auto, seed: int,
               observers: Iterable[Observer] = (), note_on_projection: str = "") -> Finding:
    """Return the choice among methods, and the fits that it is compared with.

    The model and the solver of the request take no part in the choice. When methods are
    interrupted with Ctrl-C, the choice is the best of those that were fitted to all points by then.

    Parameters
    ----------
    request : Request
        What was asked for.
    observations : Observations
        The features in the roles that they play.
    auto : Auto
        The methods to choose among, or the one that is asked for.
    seed : int
        That of the search by OWDIS, where there are points and lines.
    observers : iterable of Observer
        Called with `Progress` after each method.
    note_on_projection : str
        A sentence on the projection in which the methods are fitted; "" for none.

    Raises
    ------
    TermselError
        If control and check points together determine no method.
    """
    start = time.perf_counter()
    watch = _Watch(observers, len(auto.offered(observations.pool)),
                   folds_of(observations.pool.features))
    # 1. Blunders, and points whose height alone is off a plane, take no part in the choice.
    watch.tell("blunders")
    verdict = judge_features(observations, auto, request.options["data"]["tested"])
    blunders = verdict.blunders | verdict.high
    clean = leave_out(observations, blunders) if blunders else observations
    data = clean.pool
    auto, note_on_terms = as_far_as_determined(auto, data)
    # 2. The choice, and its repetition without some features.
    outcome = _choose(clean, auto, watch, seed)
    choice = outcome.choice
    method = choice.method
    # A method that is asked for is held against those that are built in.
    if auto.is_one_method:
        comparison = compare(clean, Auto(memory=auto.memory))
    else:
        comparison = compare(clean, auto, choice)
    # 3. What the errors held out predict of new points: the RMSE with its interval.
    errors, predicted = _held_out_accuracy(outcome, clean, observations.independent)
    # 4. The fit in the roles that the points play, and the verdict on independent points. No
    # choice is made from here on.
    played = with_lines(clean, observations.control.lines)
    fitted = restrict_to_control(choice.chosen, played)
    contradicting, agreeing = judge_independent(clean, choice, auto, verdict)
    # 5. The same structure with independent points, for export; its figures are of the former.
    final = _final_fit(choice.chosen, played.features.points, data.heights, auto,
                       contradicting.blunders)
    predicted_final = None if final is None or predicted is None else predict_rmse_of_all(
        choice.chosen, predicted, agreeing.independent.ground)
    # 6. What the record says of the choice, and the notes for its reader.
    if data.features.rpc is None:
        rpc_notes = ("", "")
    else:
        rpc_notes = _notes_on_rpc(request, data, auto, choice.chosen)
    strategy = _strategy_record(choice, errors, predicted, data, clean, rpc_notes[0])
    notes = _Assessed(request, observations, clean, auto, outcome, verdict=verdict, fitted=fitted,
                      errors=errors, predicted=predicted, rpc_notes=rpc_notes,
                      note_on_projection=note_on_projection).notes(
        INTERRUPTED.format(min(watch.count, watch.methods), watch.methods)
        if outcome.interrupted else "", contradicting.notes, note_on_terms)
    if predicted is not None:
        outliers = (*verdict.outliers, *contradicting.outliers)
        notes = (*notes_on_slips(request.features, outliers, fitted, predicted.rmse), *notes)

    @cache  # they are asked for by who judges and by who writes
    def baselines(in_roles: Observations) -> tuple[Baseline, ...]:
        # The chosen one is the selection, and is not shown twice unless it is plain.
        return tuple(row for row in comparison.baselines(in_roles)
                     if row.name != method.name or method.is_plain)

    def judgement(rmse: Rmses, rivals: tuple[Baseline, ...]) -> str:
        rows = {row.name: row for row in strategy.candidates}
        held_out = rows[method.name].predicted if method.name in rows else None
        return judge_choice(method, None if predicted is None else predicted.rmse, rmse, rivals,
                            request.features.noise, held_out=held_out,
                            gains={name: row.gain for name, row in rows.items()},
                            is_asked_for=auto.is_one_method)

    stated = {
        **_stated_of_request(request, fitted, method, seed), **_stated_of_choice(outcome),
        "reference": best_conventional(method, baselines(clean)), "notes": notes,
        "predicted": predicted, "strategy": strategy,
        "evaluations": watch.count or len(choice.compared),
        "seconds": time.perf_counter() - start, **NO_SEARCH}
    return Finding(
        fit=fitted, final=final, predicted_final=predicted_final, observations=played,
        compared=clean, verdict=verdict, contradicting=contradicting, agreeing=agreeing,
        in_use=frozenset(clean.together.ids), check_used=True, baselines=baselines,
        judgement=judgement, stated=stated,
        selection=Selection(select(fitted.model.terms, fitted.terms),
                            select(played.control.ids, fitted.used)))


def _stated_of_request(request: Request, fitted: Fit, method: Method,
                       seed: int) -> dict[str, object]:
    """Return what the record says of the settings of a choice: options, seed, plugins.

    No option of a problem, a solver or a criterion takes part in a choice.
    """
    parts: dict[str, object] = {"model": type(fitted.model)}
    # A model that the user named is all that there is to be found again.
    if not isinstance(method, NamedModel):
        parts["method"] = method
    return {"solver": "auto", "criterion": "press", "seed": seed,
            "options": {"problem": {}, "data": request.options["data"],
                        "model": fitted.model.options, "solver": {}, "criterion": {}, "search": {}},
            "plugins": plugins_of(request, **parts)}


def _stated_of_choice(outcome: _Chosen) -> dict[str, object]:
    """Return what the record says of the figure of a choice, and of its end."""
    # The objective of the record is what the rule of the choice compares.
    rmse = outcome.choice.chosen.held_out_rmse
    return {"objectives": {"press": rmse} if np.isfinite(rmse) else {},
            "interrupted": outcome.interrupted}


def _held_out_accuracy(outcome: _Chosen, clean: Observations,
                       independent: Points) -> tuple[FloatArray | None, Predicted | None]:
    """Return the errors of a choice at held-out points (n, 2) [px], and the RMSE they predict.

    Where the choice is fitted to points alone, errors of lines do not count: it predicts points.
    The RMSE is predicted for the independent points, which may lie otherwise than the control, or
    without any for places like the control's. Both are None where nothing was held out.
    """
    chosen = outcome.choice.chosen
    errors = outcome.errors
    if errors is not None and not len(chosen.control.lines):
        errors = errors[:len(clean.pool.features.points)]
    # Of a lattice the figure is that between its lines; of other control it is from the errors.
    predicted = outcome.between
    if errors is not None and clean.lattice is None:
        predicted = predict_rmse_of_fit(chosen, errors, len(independent), independent.ground)
    if predicted is not None:
        predicted = changed(predicted, pixel=pixel_on_ground(chosen))
    return errors, predicted


@dataclass(frozen=True, eq=False)
class _Assessed:
    """All that is known of a choice when the notes for its reader are written.

    `clean` are the observations without blunders, `fitted` is the fit to control alone, `errors`
    (n, 2) are those held out and `predicted` is the RMSE that they predict; `rpc_notes` say why the
    RPC is not used, and how it was corrected; `note_on_projection` in which projection the methods
    are fitted.
    """

    request: Request
    observations: Observations
    clean: Observations
    auto: Auto
    outcome: _Chosen
    verdict: Verdict
    fitted: Fit
    errors: FloatArray | None
    predicted: Predicted | None
    rpc_notes: tuple[str, str]
    note_on_projection: str

    def notes(self, interrupted: str, on_independent: Iterable[str],
              on_terms: str = "") -> tuple[str, ...]:
        """Return the notes for the reader of the result, in the order in which he acts on them.

        `interrupted` is the note on a run that was interrupted, "" for others; `on_independent` are
        those on independent points that contradict the fit, and `on_terms` says that a degree was
        lowered, "" if it was not.
        """
        clean = self.clean
        fitted = self.fitted
        chosen = self.outcome.choice.chosen
        method = self.outcome.choice.method
        rpc_unused, rpc_correction = self.rpc_notes
        doubt = doubt_of_rpc(clean) if rpc_correction else ""
        # A camera that is known needs no heights of the control to use heights.
        heights_are_known = self.auto.fewest(self.observations.pool) == 1 or (
            fitted.model.uses_height and not clean.pool.heights)
        lattice = clean.lattice
        uncertain_places: list[str] = []
        if self.predicted is not None and not method.from_one and lattice is None:
            uncertain_places = [*uncertain_between_points(chosen, self.predicted),
                                *uncertain_corners(fitted, self.predicted.rmse)]
        rounded = "" if self.errors is None else note_on_rounding(clean.pool.features, self.errors)
        return (
            *filter(None, [doubt, on_terms, self.note_on_projection]),
            *_notes_on_stated_geometry(clean.pool, self.auto, chosen),
            *notes_on_dem(self.request.features, fitted),
            *filter(None, (rpc_unused, rpc_correction, rounded)),
            *notes_on_data(self.request.features, self.observations, heights=not heights_are_known,
                           blank=self.request.blank, clean=clean),
            *_notes_on_choice(self.request.model, clean, self.errors, interrupted,
                              plane=not fitted.model.uses_height, determined=self.outcome.exact,
                              has_geometry=method.from_one, is_named=self.auto.is_one_method),
            *uncertain_places,
            *([] if lattice is None else [lattice.sentence(known=method.from_one)]),
            *self._notes_on_left_out(), *on_independent, *self.auto.notes)

    def _notes_on_left_out(self) -> Iterator[str]:
        """Yield which points were left out for their heights, why others were, and unused lines."""
        # Heights off a plane are no blunders: a model with heights would use them.
        high = [f"{outlier.id} ({rounded_size_text(outlier.error)} px)"
                for outlier in self.verdict.outliers if outlier.id in self.verdict.high]
        if high:
            heights = "its height" if len(high) == 1 else "their heights"
            yield f"Left out for {heights}: {', '.join(high)}."
        yield from self.verdict.notes
        fitted = self.fitted
        lines = len(fitted.control.lines.features)
        if lines and not fitted.used[len(fitted.control.points):].any():
            yield (f"None of the {count_in_words(lines, 'line')} is used: the points alone predict "
                   "better.")


NO_SEARCH = {"feasible": True, "lookups": 0, "hit_rate": 0.0, "generations": 0, "history": (),
             "budget": SearchLimits(), "polish": None, "front": (), "certificate": None}
"""What the record of a choice says of a search: there was none."""


def _choose(clean: Observations, auto: Auto, watch: _Watch, seed: int) -> _Chosen:
    """Return the choice from control and check without blunders, and its repetition in folds.

    The steps are these: whether there are enough features; the choice by their held-out errors; a
    view, where the points determine nothing else; lines selected by OWDIS; and the whole choice
    repeated without each fold, whose errors are those of the procedure, not of the winner alone. An
    interrupted choice is the best method so far. Raises TermselError where no method is determined.
    """
    data = clean.pool
    features = data.features
    is_enough = auto.is_one_method or len(features) >= auto.fewest(data)
    choice: Choice | None = None
    try:
        if len(features) < LEAST and not is_enough:
            raise TermselError(
                f"one point is not enough for a model. {_why_rpc_unused(data, auto)}".strip(),
                hint="Measure more.")
        choice = auto.choose_features(data, watch.method) if is_enough else minimal_fit(data)
        if choice is None and auto.is_one_method:
            choice = unjudged_fit(data, auto.methods[0])
            is_enough = choice is None
        if choice and is_enough and len(features) > MAX_EXACT_POINTS and not auto.is_one_method:
            # An oblique view that the points determine exactly has no errors to be chosen by.
            view = minimal_view(data, choice, auto)
            is_enough = view is choice
            choice = view
        if choice is None:
            raise _no_choice_error(auto, data)
        errors: FloatArray | None = None
        if len(features.lines):
            from termsel.runs.owdis import with_selected_lines  # it searches

            watch.tell("OWDIS")
            choice, errors = with_selected_lines(data, choice, auto, seed)
        lattice = clean.lattice
        if lattice is not None and not choice.method.from_one:
            # Points of a lattice are computed and have no chance errors. What the model misses
            # between the lines of the lattice shows when neighbouring lines are left out in turn.
            errors_between_lines = auto.between_lines(data, lattice, watch.method, choice)
            if errors_between_lines is not None:
                return _Chosen(choice, errors_between_lines[0], exact=not is_enough,
                               between=predict_rmse_between_lines(*errors_between_lines))
        elif lattice is None and errors is None and is_enough and len(features) > 1:
            errors = auto.repeated(data, watch.method, choice)
            # A camera of few points may have one of them behind it, when it is left out: no error
            # of it is known, and the others alone would promise too much.
            if errors is not None and not np.isfinite(errors[:len(features.points) or None]).all():
                errors = None
        # A model that is asked for may leave redundancy and yet need every point.
        needs_all = auto.is_one_method and choice.chosen.adjustment.redundancy > 0
        return _Chosen(choice, errors, exact=not is_enough and not needs_all)
    except KeyboardInterrupt:
        # Of a choice that was cut short the best method so far is the result.
        best = choice or auto.best_of(watch.fits)
        if best is None:
            raise
        take_pending_interrupt()
        return _Chosen(best, exact=not is_enough, interrupted=True)


def _no_choice_error(auto: Auto, data: FitData) -> TermselError:
    """Return the error where no method can be chosen; for a single method with its own reason."""
    features = f"the {len(data)} control and selection {data.features.word}"
    more = "Measure more, spread over the scene"
    if not auto.is_one_method:
        return TermselError(f"{features} lie so that no model can be tested by them",
                            hint=f"{more}.")
    method = auto.methods[0]
    failure = f"{features} do not determine {method.title}"
    option = "--model" if isinstance(method, NamedModel) else "--method"
    otherwise = f"or leave {option} out: the program then chooses one"
    reason = method.declines(data)
    if reason is not None:
        return TermselError(f"{failure}: {reason}", hint=f"{otherwise[3:].capitalize()}.")
    reason = "it leaves no redundancy, or has a pole in the scene"
    try:
        method.fit(data)
    except Undetermined as error:
        reason = error.what
    return TermselError(f"{failure}: {reason}", hint=f"{more}, {otherwise}.")


def _strategy_record(choice: Choice, errors: FloatArray | None, predicted: Predicted | None,
                     data: FitData, clean: Observations, rpc_unused: str) -> Strategy:
    """Return the record of a choice among methods.

    `errors` (n, 2) are those of the features held out [px], and `predicted` is the RMSE that they
    predict; either is None if it is not known. `clean` are the observations without blunders, and
    `rpc_unused` says why an RPC was not used; "" if it was, or if there is none.
    """
    held_out = None
    if errors is not None:
        # Between the lines of a lattice the predicted figure is that of the interval's middle.
        if clean.lattice is not None and predicted is not None:
            held_out = predicted.rmse
        else:
            held_out = weighted_rmse(errors, data.features.points)
    candidates = tuple(
        CandidateRow(method_of(fitted).name, fitted.model.name, int(fitted.terms.sum()),
                     fitted.effective, finite_or_none(fitted.held_out_rmse),
                     finite_or_none(gain(fitted, choice.chosen)))
        for fitted in choice.compared)
    return Strategy(
        name="auto", chosen=choice.method.name, reason=choice.reason, predicted=held_out,
        folds=folds_of(data.features), fitted_to=("control", "check"), candidates=candidates,
        rpc=rpc_unused)


def _final_fit(fitted: Fit, points: Points, heights: bool, auto: Auto,
               blunders: Collection[str]) -> Fit | None:
    """Return the chosen structure fitted to all points, independent ones included.

    Selected terms stay those that were selected; what is shrunken is averaged again. Points named
    in `blunders` stay out. `heights` says whether `fitted` is a model with heights. `auto` refits
    it, and remembers the fit. Returns None where there is no further point, where a fit without
    heights would get points whose heights show, where the method cannot be fitted, and where its
    fit has a pole or is not determined.
    """
    control = fitted.control
    further = points.take([role in ASSIGNABLE and name not in blunders
                           for name, role in zip(points.ids, points.roles, strict=True)])
    # Twins count once, as in the choice.
    features = with_merged_twins(control.with_(points=further))
    # A plane model must not be fitted to points whose heights do show.
    with_height = features.take(~np.isin(features.ids, features.without_height()))
    if len(features) == len(control) or (
            not heights and len(with_height) and FitData.of(with_height).heights):
        return None
    final: Fit | None = auto.ask(method_of(fitted), "refit", fitted, FitData.of(features, heights))
    return final if final is not None and final.determined and not has_pole(final) else None


def _notes_on_rpc(request: Request, data: FitData, auto: Auto, fitted: Fit) -> tuple[str, str]:
    """Return a note on the RPC that is given, and a note on its correction.

    Either is "" where there is nothing to say.
    """
    method = method_of(fitted)
    if method.from_one:
        return ("" if request.rpc_part is None else request.rpc_part.sentence(),
                auto.ask(method, "describe", fitted) or "")
    return _why_rpc_unused(data, auto, fitted, request.rpc_part), ""


def _notes_on_stated_geometry(data: FitData, auto: Auto, fitted: Fit) -> list[str]:
    """Return why a camera or orbit that is stated is not used, or what of it; [] if all of it is.

    Methods that one point is enough for know such a geometry, and decline where none is stated.
    """
    chosen = method_of(fitted)
    if chosen.from_one:
        doubt = auto.ask(chosen, "doubt", fitted)
        return [doubt] if doubt else []
    notes = []
    for method in auto.methods:
        if (not method.from_one or method.family == RPC_CORRECTIONS
                or len(data) > method.max_features):
            continue
        declined = auto.ask(method, "declines", data)
        # Of what is stated, heights alone are missing: a DEM would give them.
        if declined is not None and LACKS_HEIGHTS in declined:
            notes.append(f"The {method.short or method.name} takes no part: the points have no "
                         "heights. --dem FILE gives them.")
        if declined is not None or method.name in auto.faults:
            continue
        remedy = ("Check what is stated of it, such as a focal length, and what is not, such as "
                  "the distortion of a lens.")
        reason = (f"{chosen.title} predicts the {data.features.word} better, by more than chance "
                  "explains")
        if auto.ask(method, "fit", data) is None and method.name not in auto.faults:
            try:
                method.fit(data)
            except Undetermined as error:
                reason = error.what
                remedy = error.hint or remedy
        notes.append(f"The {method.short or method.name} is not used: {reason}. {remedy}")
    return notes


LACKS_HEIGHTS = "--dem FILE"
"""What a method whose geometry is stated names if it declines features for their heights alone."""



RPC_CORRECTIONS = "corrections of the RPC"
"""Family of the methods that correct a vendor's RPC."""


def _why_rpc_unused(data: FitData, auto: Auto, fitted: Fit | None = None,
                    image_part: ImagePart | None = None) -> str:
    """Return why an RPC that is given is not used, as a sentence.

    It is "" without an RPC, and where a note says which method failed. `fitted` is the fit of the
    method that was chosen, None where there is none, and `image_part` the part of the RPC's image
    that the RPC of `data` is of, None for the whole.
    """
    if data.features.rpc is None:
        return ""
    # Other methods that one point is enough for know a camera or an orbit, and no RPC.
    able = [method for method in auto.methods if method.from_one
            and method.family == RPC_CORRECTIONS and len(data) <= method.max_features]
    reasons = list(filter(None, (auto.ask(method, "declines", data) for method in able)))
    if fitted is not None and auto.fewest(data) == 1:
        reason = (f"{method_of(fitted).title} predicts the {data.features.word} better, by more "
                  "than chance explains")
        reason = _with_distance(reason, data.features, image_part or ImagePart())
    elif missing := registry().missing("rpc-gcps"):
        reason = f"no installed package corrects an RPC. {missing}"
    elif reasons:
        reason = reasons[0]
    else:
        return ""
    return f"{RPC_UNUSED}: {reason.removeprefix('the RPC ')}."


_ANOTHER_IMAGE = 0.25
"""Distance of an RPC as delivered, by the extent of the points, beyond which it is doubted."""


def _with_distance(reason: str, features: FeatureSet, image_part: ImagePart) -> str:
    """Return why an RPC is not used, with how far it is off as delivered, where points show that.

    The distance is the median over the points, of line and sample each. One that is large against
    the extent of the points in the image is no error of an RPC of this image. The RPC of `features`
    is that of `image_part`, and as delivered that of the whole image.
    """
    rpc = features.rpc
    points = features.points.take(np.isfinite(features.points.ground).all(axis=1))
    if rpc is None or not len(points) or normalise(features.crs) == LOCAL:
        return reason
    with np.errstate(all="ignore"):
        seen = image_part.places_in_whole(rpc.project(to_wgs84(features.crs)(points.ground)))
    line, sample = np.median(points.image - seen, axis=0)
    distance = float(np.hypot(line, sample))
    if not np.isfinite(distance):
        return reason
    told = (f"as delivered it is {rounded_size_text(distance)} px off (median: {line:+,.0f} px in "
            f"line, {sample:+,.0f} px in sample)")
    if distance <= _ANOTHER_IMAGE * float(np.ptp(points.image, axis=0).max()):
        return f"{told}, and {reason}"
    return (f"{told}: is it of another image, or of a full scene of which this is a part? "
            "Give the RPC of this image, or leave it out")


def _notes_on_choice(model: SensorModel, observations: Observations, errors: FloatArray | None,
                     interrupted: str = "", *, plane: bool, determined: bool,
                     has_geometry: bool, is_named: bool = False) -> list[str]:
    """Return notes on the control and on the figures of a choice; [] if all is as usual.

    `model` is that of the request, which the user may compare; `plane` is whether the chosen one
    is, `determined` whether the features leave it no freedom, `has_geometry` whether it knows the
    view, and `is_named` whether the user named it. At most one note is on why no accuracy is known.
    """
    features = observations.together
    in_use = np.ones(len(features), dtype=bool)
    notes = [] if has_geometry else [*warnings_of(features, in_use, empty_points())]
    if interrupted:
        notes.append(interrupted)
    elif observations.lattice is not None:
        pass  # another note says what its points show
    elif determined:
        mirrored = " Nor do they show whether the image is mirrored." if len(features) == 2 else ""
        exactly = is_determined_exactly(len(features), features.word.removesuffix("s"))
        notes.append(f"{exactly}, so its accuracy is not known.{mirrored}")
    elif errors is None and is_named:
        notes.append(f"Without one of the {features.word} the model is not determined, so no "
                     "accuracy is predicted.")
    elif errors is None and len(features) == 1:
        notes.append("One point cannot be predicted by others, so no accuracy is predicted.")
    elif errors is None:
        notes.append(f"The {features.word} are too few to repeat the choice without some of them, "
                     "so it predicts no accuracy.")
    if not plane and observations.heights and not model.uses_height:
        notes.append(f"Heights are known and were used. --model {model.name} keeps to a plane "
                     "model.")
    return notes
