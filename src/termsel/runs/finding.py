"""What a method found on the features of a run, and the result that is made of it.

This is the one place where a `Result` is made from a run.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from termsel.data.record.figures import Predicted
from termsel.data.record.record import SCHEMA, Record
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
    """What a method found, and by whom the result has it judged.

    Parameters
    ----------
    fit : Fit
        Its control is that of the observations.
    final : Fit, optional
        The same structure fitted to all points.
    predicted_final : Predicted, optional
        The RMSE that is predicted for it.
    observations : Observations
        The features, in the roles they played.
    compared : Observations
        Those that the baselines are compared by: with all lines, where a choice left some out.
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
    selection : Selection
    stated : mapping of str to object
        Fields of the `Record` that need no figures of a role: solver, seed, options, objectives,
        evaluations, notes and so on, by name.
    files : mapping of str to str
        Further files of the result, by name.
    """

    fit: Fit
    observations: Observations
    compared: Observations
    verdict: Verdict
    contradicting: Verdict
    agreeing: Observations
    in_use: frozenset[str]
    check_used: bool
    baselines: Callable[[Observations], tuple[Baseline, ...]]
    judgement: Callable[[Rmses, tuple[Baseline, ...]], str]
    selection: Selection
    stated: Mapping[str, Any]
    final: Fit | None = None
    predicted_final: Predicted | None = None
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
        data=data_of(request, observations), selection=finding.selection.record(),
        rmse=rmse_record(rmse), baselines=tuple(row.row() for row in baselines),
        judgement=judgement, outliers=outliers, blunder_test=finding.verdict.test,
        accuracy=accuracy_of(fitted, observations.independent),
        accuracy_without=accuracy_of(fitted, agreeing.independent) if contradicting else None,
        final_fit=final_fit(finding.final, finding.predicted_final),
        exports="selection" if finding.final is None else "final", versions=versions(),
        **numbers_of(fitted), **finding.stated)
    residuals = residuals_of(fitted, observations, outliers, check_used=finding.check_used)
    return Result.of(record, fit=fitted, final=finding.final, features=observations.features,
                     residuals=residuals, files=finding.files)
