"""The strategy "auto": the best model of the points, with an estimate of its accuracy."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable, Sequence

import numpy as np

from termsel.auto.base import Judged, has_pole
from termsel.auto.compare import compare
from termsel.auto.portfolio import (
    EXACT,
    Portfolio,
    best_of,
    choose_features,
    exact,
    exact_view,
)
from termsel.auto.repetition import between_lines, folds_of, repeated
from termsel.core.errors import TermselError, counted
from termsel.core.interrupts import answered
from termsel.data.control import Control
from termsel.data.features import FloatArray, Points, no_points, select
from termsel.data.record.search import CandidateRow, Strategy
from termsel.data.roles import ASSIGNABLE, Observations, leave_out, with_lines
from termsel.data.twins import merged
from termsel.fitting.accuracy import (
    accuracy_of,
    predicted_between,
    predicted_by,
    predicted_of_all,
)
from termsel.fitting.diagnosis import diagnose
from termsel.fitting.extrapolation import warnings_of
from termsel.fitting.figures import Baseline, figures, finite_or_none, in_role, residuals_of
from termsel.fitting.fit import Fit
from termsel.models.base import SensorModel
from termsel.plugins.registry import registry
from termsel.results.result import Result
from termsel.runs.judgement.judge import best_conventional, judge_choice
from termsel.runs.task.data_notes import notes_on_data, notes_on_dem
from termsel.runs.task.given import all_candidates
from termsel.runs.task.provenance import data_of, plugins_of, versions
from termsel.runs.task.request import Setup
from termsel.runs.task.verdict import Verdict, judge_features, judge_independent
from termsel.selection.problems.base import Evaluation, Selection
from termsel.selection.problems.recipes import Recipe
from termsel.selection.solvers.base import Generation
from termsel.selection.solvers.ledger import Progress
from termsel.selection.solvers.search import Observer

INTERRUPTED = ("The run was interrupted when {0} of {1} candidates were judged. The choice was not "
               "repeated without some of the points, so it predicts no accuracy.")

NAMES = ("auto", "as-asked")

LEAST = 2
"""Control points without which there is no answer."""


def wanted(strategy: str | None, recipe: Recipe, method: Sequence[str] = (), *,
           unnamed: bool = False) -> bool:
    """Return whether a run is to choose its method by itself.

    Without a strategy, "auto" or "as-asked", it does so for problems that a portfolio can answer,
    but for those whose search comes first, where nothing of a method is asked for: `method` has
    what is, in words. If nobody named the problem, "auto" comes before its own search. Refuses
    "auto" next to a method, and for a problem that is not one for it.
    """
    if strategy is not None and strategy not in NAMES:
        raise TermselError(f"there is no strategy {strategy!r}",
                           hint=f"Choose {' or '.join(NAMES)}.")
    if strategy != "auto":
        return (strategy is None and recipe.portfolio and (unnamed or not recipe.search_first)
                and not method)
    if not recipe.portfolio:
        raise TermselError(f"the strategy auto is not for the problem {recipe.name}",
                           hint="It chooses among models of points and lines: rfm-terms, "
                                "poly-terms, owdis-lines. To have a vendor's RPC corrected, leave "
                                "--problem out and add --rpc FILE.")
    if method:
        raise TermselError(
            f"the strategy auto chooses the method itself, and {method[0]} is asked for",
            hint="Leave one of them out; --strategy as-asked runs a method as it is.")
    return True


class _Watch:
    """Tells observers how far a choice is, and keeps the candidates judged for all points.

    There are so many candidates and folds; each fold judges all candidates, as the choice itself
    does. `judged` are those of all points, `count` is how many were judged, those of folds
    included.
    """

    def __init__(self, observers: Iterable[Observer], candidates: int, folds: int) -> None:
        self._observers = tuple(observers)
        self.candidates, self._folds = candidates, folds
        self.judged: list[Judged] = []
        self.count = 0

    def tell(self, what: str, share: float | None = None) -> None:
        """Tell what is being done, and the share of it that is done."""
        best = min((one.predicted for one in self.judged), default=np.inf)
        generation = Generation(self.count, np.zeros((0, 0), dtype=bool),
                                Evaluation(np.zeros((0, 1)), np.zeros(0)))
        for observe in self._observers:
            observe(Progress(generation, self.count, share, best, 0.0,
                             np.zeros(0, dtype=bool), what))

    def candidate(self, one: Judged | None) -> None:
        """Count a candidate that was judged, and tell."""
        fold = self.count // self.candidates
        self.count += 1
        if one and not fold:
            self.judged.append(one)
        self.tell("candidates" if not fold else f"fold {fold} of {self._folds}",
                  self.count / self.candidates / (1 + self._folds))


def choose_for(setup: Setup, observations: Observations, seed: int,
               observers: Iterable[Observer] = ()) -> Result:
    """Return the choice from the portfolio as a result.

    The model and the solver of the setup take no part. The seed is that of the search by OWDIS,
    where there are points and lines. Observers are called with `Progress` after each candidate.
    When interrupted with Ctrl-C there is a result if any candidate was judged. Refuses control and
    check points that together determine no candidate.
    """
    start = time.perf_counter()
    portfolio = all_candidates()
    watch = _Watch(observers, len(portfolio.offered(observations.pool)),
                   folds_of(observations.pool.features))
    watch.tell("blunders")
    known = portfolio.least(observations.pool) == 1
    verdict = judge_features(observations, portfolio, setup.options["data"]["tested"])
    out = verdict.blunders | verdict.high
    clean = leave_out(observations, out) if out else observations
    control, both = clean.pool, clean.pool.features
    lattice = clean.lattice
    choice, errors, expected, interrupted = None, None, None, False
    enough = len(both) >= portfolio.least(control)
    try:
        if len(both) < LEAST and not enough:
            raise TermselError(
                f"one point is not enough for a model. {_unused_rpc(control, portfolio)}".strip(),
                hint="Measure more.")
        choice = choose_features(control, portfolio, watch.candidate) if enough else exact(control)
        if choice and enough and len(both) > EXACT:
            view = exact_view(control, choice, portfolio)
            enough, choice = view is choice, view
        if choice and len(both.lines):
            from termsel.runs.auto.owdis import with_selected_lines  # it searches

            watch.tell("OWDIS")
            choice, errors = with_selected_lines(control, choice, portfolio, seed)
        if choice and lattice is not None and not choice.chosen.candidate.from_one:
            without = between_lines(control, lattice, portfolio, watch.candidate, choice)
            if without is not None:
                errors = without[0]
                expected = predicted_between(*without)
        elif choice and errors is None and enough and len(both) > 1 and lattice is None:
            errors = repeated(control, portfolio, watch.candidate, choice)
    except KeyboardInterrupt:
        choice, errors, interrupted = choice or best_of(watch.judged, portfolio), None, True
        if choice is None:
            raise
        answered()
    if choice is None:
        raise TermselError(
            f"the {len(both)} control and check {both.word} lie so that no model can be held "
            "against them", hint="Measure more, spread over the scene.")
    chosen, comparison = choice.chosen, compare(clean, choice, portfolio)
    known |= chosen.fit.model.uses_height and not control.heights
    of_data = tuple(notes_on_data(setup.features, observations, heights=not known,
                                  blank=setup.blank))
    if errors is not None and not len(chosen.fit.control.lines):
        errors = errors[:len(both.points)]  # what lines were predicted to be says nothing
    if errors is not None and lattice is None:
        expected = predicted_by(chosen.fit, errors, len(observations.independent),
                                observations.independent.ground)
    held_out = None if errors is None else float(np.sqrt((errors**2).sum(axis=1).mean())) \
        if lattice is None or expected is None else expected.rmse
    observations = with_lines(clean, observations.control.lines)
    fitted = in_role(chosen.fit, observations)
    model = fitted.model
    contradicting, agreeing = judge_independent(clean, choice, portfolio)
    outliers = (*verdict.without({*clean.together.ids}), *contradicting.outliers)
    final = _final_fit(chosen, observations.features.points, control.heights, portfolio,
                       contradicting.blunders)

    expected_of_final = None if final is None or expected is None else predicted_of_all(
        chosen.fit, expected, agreeing.independent.ground)

    def others(seen: Observations) -> tuple[Baseline, ...]:
        # The chosen one is the selection, and is not shown twice unless it is plain.
        return tuple(b for b in comparison.baselines(seen)
                     if b.name != chosen.name or chosen.candidate.is_plain)

    rpc, correction = _on_rpc(setup, control, portfolio, chosen)
    said = INTERRUPTED.format(min(watch.count, watch.candidates), watch.candidates) \
        if interrupted else ""
    return Result(
        problem=setup.recipe.name, model=model.name, solver="auto", criterion="press", seed=seed,
        options={"problem": {}, "data": setup.options["data"], "model": model.options,
                 "solver": {}, "criterion": {}, "search": {}},
        data=data_of(setup, observations),
        selection=Selection(select(model.terms, fitted.terms),
                            select(observations.control.ids, fitted.used)),
        feasible=True, rmse=figures(fitted, observations), baselines=others(clean),
        judgement=judge_choice(chosen.candidate, None if expected is None else expected.rmse,
                               figures(fitted, agreeing), others(agreeing), setup.features.noise),
        reference=best_conventional(chosen.candidate, others(clean)),
        notes=(*notes_on_dem(setup.features, fitted), *filter(None, (rpc, correction)), *of_data,
               *_notes(setup.model, clean, errors, said, plane=not model.uses_height,
                       determined=not enough, known=chosen.candidate.from_one),
               *([] if lattice is None else [lattice.sentence(known=chosen.candidate.from_one)]),
               *_high(verdict), *verdict.notes, *_lines(fitted), *contradicting.notes,
               *portfolio.notes),
        outliers=outliers, blunder_test=verdict.test, predicted=expected,
        predicted_final=expected_of_final,
        accuracy=accuracy_of(fitted, observations.independent), final=final,
        accuracy_without=accuracy_of(fitted, agreeing.independent)
        if contradicting.outliers else None,
        objectives={"press": chosen.predicted} if np.isfinite(chosen.predicted) else {},
        evaluations=watch.count or len(choice.judged), lookups=0, generations=0,
        seconds=time.perf_counter() - start, interrupted=interrupted, polish=None, fit=fitted,
        residuals=residuals_of(fitted, observations, outliers, check_used=True),
        diagnosis=diagnose(fitted),
        features=observations.features, versions=versions(),
        plugins=plugins_of(setup, model=type(model), candidate=chosen.candidate),
        strategy=Strategy("auto", chosen.name, choice.reason, held_out, folds_of(both),
                          ("control", "check"), tuple(CandidateRow(
                              one.name, one.fit.model.name, int(one.fit.terms.sum()),
                              one.fit.effective, finite_or_none(one.predicted))
                              for one in choice.judged), rpc))


def _final_fit(chosen: Judged, points: Points, heights: bool, portfolio: Portfolio,
              blunders: Collection[str]) -> Fit | None:
    """Return the chosen structure fitted to all points, independent ones included.

    Selected terms stay those that were selected; what is shrunken is averaged again. Blunders among
    independent points stay out. None where there is no further point, and where the fit has a pole
    or is not determined.
    """
    control = chosen.fit.control
    more = points.take([role in ASSIGNABLE and name not in blunders
                        for name, role in zip(points.ids, points.roles, strict=True)])
    every = merged(control.with_(points=more))
    # A plane model must not be fitted to points whose heights do tell.
    known = every.take(~np.isin(every.ids, every.without_height()))
    if len(every) == len(control) or (not heights and len(known) and Control.of(known).heights):
        return None
    final = portfolio.ask(chosen.candidate, "refit", chosen.fit, Control.of(every, heights))
    return final if final is not None and final.determined and not has_pole(final) else None


def _high(verdict: Verdict) -> list[str]:
    some = [f"{one.id} ({one.error:.3g} px)" for one in verdict.outliers if one.id in verdict.high]
    return [f"Left out for {'its height' if len(some) == 1 else 'their heights'}: "
            f"{', '.join(some)}."] * bool(some)


def _lines(fitted: Fit) -> list[str]:
    lines = len(fitted.control.lines.features)
    if not lines or fitted.used[len(fitted.control.points):].any():
        return []
    return [f"None of the {counted(lines, 'line')} is used: the points alone predict better."]


def _on_rpc(setup: Setup, control: Control, portfolio: Portfolio, chosen: Judged,
            ) -> tuple[str, str]:
    """Return what is to be said first of an RPC that is given, and how it is corrected."""
    if control.features.rpc is None:
        return "", ""
    if chosen.candidate.from_one:
        return ("" if setup.rpc_part is None else setup.rpc_part.sentence(),
                portfolio.ask(chosen.candidate, "describe", chosen.fit) or "")
    return _unused_rpc(control, portfolio, chosen), ""


def _unused_rpc(control: Control, portfolio: Portfolio, chosen: Judged | None = None) -> str:
    """Return why an RPC that is given is not used; "" where a note says which candidate failed."""
    if control.features.rpc is None:
        return ""
    able = [one for one in portfolio.candidates if one.from_one and len(control) <= one.most]
    reasons = list(filter(None, (portfolio.ask(one, "declines", control) for one in able)))
    if chosen is not None and portfolio.least(control) == 1:
        reason = (f"{chosen.candidate.title} predicts the {control.features.word} better, beyond "
                  "chance")
    elif missing := registry().missing("rpc-gcps"):
        reason = f"no installed package corrects an RPC. {missing}"
    elif reasons:
        reason = reasons[0]
    else:
        return ""
    return f"The RPC is not used: {reason}."


def _notes(model: SensorModel, observations: Observations, errors: FloatArray | None,
           interrupted: str = "", *, plane: bool, determined: bool, known: bool) -> list[str]:
    both = observations.together
    notes = [] if known else [*warnings_of(both, np.ones(len(both), dtype=bool), no_points())]
    if interrupted:
        notes.append(interrupted)
    elif observations.lattice is not None:
        pass  # another note says what its points tell
    elif determined:
        notes.append(f"{len(both)} {both.word} determine the model exactly, so nothing tells its "
                     "accuracy." + " They do not tell either whether the image is mirrored."
                     * (len(both) == 2))
    elif errors is None:
        notes.append("One point cannot be predicted by others, so no accuracy is predicted."
                     if len(both) == 1 else
                     f"The {both.word} are too few to repeat the choice without some of them, so "
                     "it predicts no accuracy.")
    if not plane and observations.heights and not model.uses_height:
        notes.append(f"Heights are known and were used. --model {model.name} keeps to a plane "
                     "model.")
    return notes
