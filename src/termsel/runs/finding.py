"""What a method found on the features of a run, and the result that is made of it.

This is the one place where a `Result` is made from a run.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from msgspec import convert

from termsel.auto.compare import Comparison
from termsel.data.record.base import plain
from termsel.data.record.figures import Predicted
from termsel.data.record.record import SCHEMA, Options, PluginRecord, Record
from termsel.data.record.search import (
    Certificate,
    HistoryRow,
    Member,
    Polish,
    SearchLimits,
    SizeRow,
    Strategy,
)
from termsel.data.roles import Observations
from termsel.fitting.accuracy import accuracy_of
from termsel.fitting.figures import Baseline, Rmses, figures, residuals_of, rmse_record
from termsel.fitting.fit import Fit
from termsel.results.result import Result
from termsel.results.same_fit import final_fit, numbers_of
from termsel.runs.provenance import data_of, versions
from termsel.runs.request import Request
from termsel.runs.verdict import Verdict
from termsel.selection.problems.base import Selection


@dataclass(frozen=True, eq=False, kw_only=True)
class Finding:
    """What a method found, and all that the result says of it beyond its figures.

    Parameters
    ----------
    fit : Fit
        Its control is that of the observations.
    observations : Observations
        The features, in the roles they played.
    compared : Observations
        Those that the baselines are compared by: with all lines, where a choice left some out.
    comparison : Comparison
        The methods that need no search.
    verdict, contradicting : Verdict
        On control and check features before the run, and on independent points after it.
    in_use : frozenset of str
        Ids of features that took part.
    check_used : bool
        Whether the model was fitted to the check points, too.
    agreeing : Observations
        The features without independent points that contradict all others.
    baselines : callable
        The fits that the figures are compared with, by observations.
    judgement : callable
        The sentence on what the selection is worth, by RMSE of roles and baselines.
    reference : str
        Name of the baseline that the result is compared with first; "" for none.
    notes : tuple of str
    selection : Selection
    solver, criterion : str
    seed : int
    options, plugins, objectives : mapping
        As for `Result`.
    feasible, interrupted : bool
    evaluations, lookups, generations : int
    seconds : float
    """

    fit: Fit
    observations: Observations
    compared: Observations
    comparison: Comparison
    verdict: Verdict
    contradicting: Verdict
    agreeing: Observations
    in_use: frozenset[str]
    check_used: bool
    baselines: Callable[[Observations], tuple[Baseline, ...]]
    judgement: Callable[[Rmses, tuple[Baseline, ...]], str]
    reference: str
    notes: tuple[str, ...]
    selection: Selection
    solver: str
    criterion: str
    seed: int
    options: Mapping[str, Any]
    plugins: Mapping[str, Mapping[str, str]]
    objectives: Mapping[str, float]
    feasible: bool
    interrupted: bool
    evaluations: int
    lookups: int
    generations: int
    seconds: float
    polish: Polish | None = None
    history: tuple[HistoryRow, ...] = ()
    budget: SearchLimits = field(default_factory=SearchLimits)
    predicted: Predicted | None = None
    predicted_final: Predicted | None = None
    final: Fit | None = None
    strategy: Strategy | None = None
    front: tuple[Member, ...] = ()
    by_size: tuple[SizeRow, ...] = ()
    certificate: Certificate | None = None
    files: Mapping[str, str] = field(default_factory=dict)


def result_of(request: Request, finding: Finding) -> Result:
    """Return the result of what a method found.

    Here independent points are looked at, for the first and only time: their figures, and those
    without the ones that contradict all others.
    """
    fitted = finding.fit
    observations = finding.observations
    agreeing = finding.agreeing
    contradicting = finding.contradicting.outliers
    # Of control and selection points those found before, of independent points afterwards.
    outliers = (*finding.verdict.without(finding.in_use), *contradicting)
    # The one place where figures of independent points are computed.
    rmse = figures(fitted, observations)
    baselines = finding.baselines(finding.compared)
    # The sentence on what the selection is worth leaves out points that contradict all others.
    if contradicting:
        judgement = finding.judgement(figures(fitted, agreeing), finding.baselines(agreeing))
    else:
        judgement = finding.judgement(rmse, baselines)
    record = Record(
        schema=SCHEMA, problem=request.recipe.name, model=fitted.model.name,
        solver=finding.solver, criterion=finding.criterion, seed=finding.seed,
        options=convert(plain(finding.options), Options), data=data_of(request, observations),
        selection=finding.selection.record(), feasible=finding.feasible,
        objectives=finding.objectives, rmse=rmse_record(rmse),
        baselines=tuple(row.row() for row in baselines), judgement=judgement,
        notes=finding.notes, reference=finding.reference, outliers=outliers,
        blunder_test=finding.verdict.test, predicted=finding.predicted,
        accuracy=accuracy_of(fitted, observations.independent),
        accuracy_without=accuracy_of(fitted, agreeing.independent) if contradicting else None,
        final_fit=final_fit(finding.final, finding.predicted_final),
        exports="selection" if finding.final is None else "final",
        front=finding.front, certificate=finding.certificate, strategy=finding.strategy,
        evaluations=finding.evaluations, lookups=finding.lookups,
        hit_rate=finding.lookups / max(finding.evaluations, 1),
        generations=finding.generations, seconds=finding.seconds, history=finding.history,
        budget=finding.budget, by_size=finding.by_size, interrupted=finding.interrupted,
        polish=finding.polish, versions=versions(),
        plugins=convert(plain(finding.plugins), dict[str, PluginRecord]), **numbers_of(fitted))
    residuals = residuals_of(fitted, observations, outliers, check_used=finding.check_used)
    return Result.of(record, fit=fitted, final=finding.final, features=observations.features,
                     residuals=residuals, files=finding.files)
