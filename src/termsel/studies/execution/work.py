"""One cell done: a run, its figures, and how it went, as plain data."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final

from termsel.auto.auto import Auto
from termsel.auto.memory import Memory
from termsel.core.display.quiet import quiet_logger
from termsel.core.errors import TermselError
from termsel.core.files.atomic import private_folder
from termsel.core.threads import one_blas_thread
from termsel.data.features import BoolArray, FeatureSet
from termsel.data.record.figures import Rmse
from termsel.fitting.figures import finite_or_none
from termsel.io.accuracy_tags import prediction_of
from termsel.io.export import export, writer_of
from termsel.io.result_folder import write_result
from termsel.plugins.loading import run_plugin_code
from termsel.plugins.registry import registry
from termsel.results.extras import figure_of_result
from termsel.results.result import Result
from termsel.runs.run import run
from termsel.runs.searching import estimated, is_feasible, result_of_search
from termsel.runs.task import Task, prepare
from termsel.runs.without_blunders import search_without_blunders
from termsel.selection.solvers.ledger import Progress
from termsel.selection.solvers.proofs.exact import gap_to_optimum
from termsel.selection.solvers.proofs.proof import TIE, count
from termsel.selection.solvers.search import SearchResult
from termsel.studies.cells.cell import Cell
from termsel.studies.cells.journal import CellRecord, State
from termsel.studies.cells.neighbours import location_figures
from termsel.studies.execution.naming import name_image_in_log

DONE: Final = "done"
INFEASIBLE: Final = "infeasible"
FAILED: Final = "failed"
STATES = (DONE, INFEASIBLE, FAILED)

_MOST = 256
_optima: dict[str, float | None] = {}
"""Proven optima by instance, up to `_MOST`: the same for all seeds and most solvers."""


@dataclass(frozen=True)
class Outcome:
    """What came of a cell: its record for the journal, and the files of a result of auto by name.
    """

    record: CellRecord
    files: Mapping[str, bytes] = field(default_factory=dict)


OUT_OF_TIME = "out of time: more than {:g} s"
"""Why a cell was ended, with the seconds that it was allowed."""


class _OutOfTime(TermselError):
    """The cell took longer than the study allows."""


def failed_outcome(key: str, reason: str, features: FeatureSet | None = None) -> Outcome:
    """Return the outcome of a cell that has no result.

    Its figures say where the features are, so that the other images of a batch can be compared.
    """
    figures = {} if features is None else location_figures(features)
    return Outcome(CellRecord(key, FAILED, reason, figures, [], []))


MEMORY = Memory()
"""What this process found of the features of its cells: many cells have the same."""


@one_blas_thread
# The plans that solvers announce, of thousands of runs.
@quiet_logger("termsel.selection.solvers", logging.WARNING)
def do(cell: Cell, features: FeatureSet) -> Outcome:
    """Run a cell, and return its outcome; where the run fails, with the reason."""
    with name_image_in_log(cell.data.source):
        outcome, reason = run_plugin_code(partial(_outcome_of_cell, cell, features))
    return outcome if outcome is not None else failed_outcome(cell.key, str(reason), features)


def _outcome_of_cell(cell: Cell, features: FeatureSet) -> Outcome:
    """Return the outcome of a cell; of a run that fails, the outcome has the reason."""
    trace = _Trace(cell.call.get("timeout"))
    try:
        if cell.call["strategy"] == "auto":
            state, figures, front, files = _figures_of_auto(cell, features, trace)
        else:
            state, figures, front, files = _search_as_asked(cell, features, trace)
    except TermselError as error:
        return failed_outcome(cell.key, str(error), features)
    figures |= location_figures(features)
    reason = "no selection satisfies all conditions" if state == INFEASIBLE else ""
    return Outcome(CellRecord(cell.key, state, reason, figures, trace.points, front), files)


class _Trace:
    """Observes a search: its gains, with evaluations and CPU seconds; `timeout` [s] ends it."""

    def __init__(self, timeout: float | None) -> None:
        self.points: list[list[float]] = []
        self._timeout = timeout
        self._start = time.perf_counter()
        self._cpu = time.process_time()
        self._before, self._last = 0, 0
        self._ticks: list[tuple[int, float]] = []

    def times(self) -> dict[str, float]:
        """Return the seconds since the cell began: by the clock, and of CPU of all threads."""
        return {"seconds": time.perf_counter() - self._start,
                "cpu_seconds": time.process_time() - self._cpu}

    def end(self, search: SearchResult) -> None:
        """Note the gains of the finished search, each with the evaluation that found it.

        Its CPU seconds are those of the end of its generation.
        """
        cpu = self.times()["cpu_seconds"]
        # An earlier search of the cell, which found nothing feasible, has cost its evaluations.
        earlier = max(0, self._before + self._last - search.evaluations)
        self.points = []
        for evaluation, best in search.gains:
            count = earlier + evaluation
            seconds = next((tick for ended, tick in self._ticks if ended >= count), cpu)
            self.points.append([count, best, seconds])

    def __call__(self, progress: Progress) -> None:
        """Note the progress of a search. Raises `_OutOfTime` after more than `timeout`."""
        if self._timeout is not None and time.perf_counter() - self._start > self._timeout:
            raise _OutOfTime(OUT_OF_TIME.format(self._timeout))
        if progress.evaluations < self._last:
            # The search begins again, as of a second step: what was found before does not count.
            self._before += self._last
            self.points.clear()
            self._ticks.clear()
        # Evaluations of this search; those of earlier ones are in `_before`.
        self._last = progress.evaluations
        self._ticks.append((self._before + self._last, time.process_time() - self._cpu))
        if progress.violation == 0 and math.isfinite(progress.best):
            self._add(progress.best)

    def _add(self, best: float) -> None:
        """Add the best value after the last evaluation that is known of, if it is better."""
        if not self.points or best < self.points[-1][1]:
            self.points.append([self._before + self._last, best, time.process_time() - self._cpu])


def _search_as_asked(cell: Cell, features: FeatureSet, trace: _Trace) -> tuple[
        State, dict[str, Any], list[list[float]], dict[str, bytes]]:
    """Return state, figures, front and files of a cell's search.

    Blunders are left out before the search, as in a run; what a run does besides, such as comparing
    with plain models, is not, as it is the same for all seeds and takes longer than most searches.
    The fitness is None for a selection that is not feasible and for coefficients that are not those
    of least squares. The `trace` is ended by the search. Raises KeyboardInterrupt for an
    interrupted search, which is no result of a study.
    """
    call = cell.call
    names = {role: cell.things.get(role, call[role])
             for role in ("problem", "model", "criterion", "solver") if call[role] is not None}
    task = prepare(**names, features=features, source=cell.data.source, options=call["options"])
    task, search = search_without_blunders(
        task, Auto(memory=MEMORY), seed=call["seed"], observers=[trace],
        **{name: call.get(name) for name in ("generations", "evaluations", "seconds",
                                             "patience")})
    if search.interrupted:
        raise KeyboardInterrupt  # half a search is no result of a study
    selection = task.problem.decode(search.genes)
    fitted = estimated(task, selection, search)
    feasible = is_feasible(task, search, fitted)
    # The objectives of least squares are not those of other coefficients.
    is_judged = feasible and fitted.estimator.least_squares
    fitness = float(search.objectives[0]) if is_judged else None
    trace.end(search)
    times = trace.times()  # what follows shows about the study, and takes no part in the run
    # Only the figures of a table. A run also compares its selection with all plain models, which
    # takes longer than most searches and is the same for all seeds.
    figures: dict[str, Any] = {
        "objective": task.problem.objectives[0],
        "proven": _is_proven(task, search),
        "fitness": fitness,
        "optimum": _proven_optimum(cell, task, search) if is_judged else None,
        **_rmse_by_role({"control": fitted.control_rmse(),
                         "check": fitted.rmse(task.observations.check),
                         "independent": fitted.rmse(task.observations.independent)}),
        "n_terms": len(selection.terms), "n_features": len(selection.features),
        "n_genes": task.problem.genome.size,
        "evaluations": search.evaluations,
        "refinement_evaluations": search.polish.evaluations if search.polish else 0,
        "generations": search.generations,
        "notes": [*search.notes, *cell.data.warnings], **times}
    if call.get("measures"):
        result = result_of_search(task, search)
        figures["measures"] = _measures_by_name(cell, result, figures["notes"])
    front = [_member_objectives(task, genes) for genes in search.front]
    return DONE if feasible else INFEASIBLE, figures, front, {}


def _member_objectives(task: Task, genes: BoolArray) -> list[float]:
    """Return the objectives of a member of a front, given its genes (size,).

    Of a problem with a single objective the second one is the number of features or terms that the
    member selects, as the recipe says.
    """
    objectives: list[float] = task.problem.evaluate(genes[None]).objectives[0].tolist()
    if len(objectives) > 1:
        return objectives
    selection = task.problem.decode(genes)
    counts_features = task.recipe.second == "n_features"
    return [*objectives, float(len(selection.features if counts_features else selection.terms))]


def _rmse_by_role(by_role: Mapping[str, Rmse | None]) -> dict[str, float | int | None]:
    """Return RMSE [px] by role, None where a role has none, and the number of points of each."""
    return {**{role: None if rmse is None else finite_or_none(rmse.total)
               for role, rmse in by_role.items()},
            **{f"n_{role}": 0 if rmse is None else rmse.n for role, rmse in by_role.items()}}


def _is_proven(task: Task, search: SearchResult) -> bool:
    """Return whether a search proved the optimum of all selections, not of the smaller ones."""
    certificate = search.certificate or {}
    if not certificate.get("optimal"):
        return False
    try:
        return bool(certificate["of"] == count(task.problem))
    except TermselError:  # features, or what a plugin proves, are enumerated otherwise
        return True


def _proven_optimum(cell: Cell, task: Task, search: SearchResult) -> float | None:
    """Return the proven optimum of the problem; None if it is not known quickly."""
    value = float(search.objectives[0])
    if _is_proven(task, search):
        return value
    if len(task.problem.objectives) > 1:
        return None
    # An enumeration is worth its time once for all seeds and solvers.
    if cell.instance not in _optima:
        if len(_optima) >= _MOST:
            _optima.clear()
        proof = gap_to_optimum(task.problem, math.inf)
        _optima[cell.instance] = None if proof is None else proof["optimum"]
    optimum = _optima[cell.instance]
    # What is below it shows that the enumeration is not of this criterion.
    return None if optimum is None or value < optimum - TIE * abs(optimum) else optimum


def _figures_of_auto(cell: Cell, features: FeatureSet, trace: _Trace) -> tuple[
        State, dict[str, Any], list[list[float]], dict[str, bytes]]:
    """Return state, figures, front and files of a cell that auto or a method runs; no front.

    The files are those of its result folder by name, with the exports that the study asks for.
    Raises KeyboardInterrupt for an interrupted run, which is no result of a study.
    """
    with private_folder() as folder:
        result_folder = folder / "result"
        method = cell.things.get("method", cell.call.get("method"))
        result = run(cell.things.get("problem", cell.call["problem"]), features=features,
                     source=cell.data.source, strategy="auto" if method is None else None,
                     method=method, options=cell.call["options"], seed=cell.call["seed"],
                     observers=[trace], out=result_folder)
        if result.interrupted:
            raise KeyboardInterrupt
        warnings = [warning for warning in cell.data.warnings if warning not in result.notes]
        if warnings:  # of reading the file, which the run knows nothing of
            result = result.with_(notes=(*result.notes, *warnings))
            write_result(result, result_folder)
        for to in cell.call["exports"]:
            # The model in every format the study asks for, next to result.json.
            suffix = writer_of(to).suffix or f".{to}"
            export(result, to, result_folder / f"result{suffix}")
        files = {path.relative_to(result_folder).as_posix(): path.read_bytes()
                 for path in sorted(result_folder.rglob("*")) if path.is_file()}
    figures = {**_figures_of(result), **trace.times()}
    if cell.call.get("measures"):
        figures["measures"] = _measures_by_name(cell, result, figures["notes"])
    return DONE, figures, [], files


def _measures_by_name(cell: Cell, result: Result, notes: list[str]) -> dict[str, float | None]:
    """Return the measures of a result by name, None for one that fails, which adds a note."""
    values: dict[str, float | None] = {}
    for name in cell.call["measures"]:
        try:
            values[name] = figure_of_result(registry().get("measures", name), result)
        except TermselError as error:  # its fault is no failure of the run
            values[name] = None
            notes.append(str(error))
    return values


def _figures_of(result: Result) -> dict[str, Any]:
    """Return the figures of a choice by auto for the table of the study.

    They are those that rank and judge the images of a batch. The size of a pixel turns px into
    metres: that of the prediction, or else of the independent points. What is not known is None.
    """
    predicted = result.predicted
    selection = result.selection
    prediction = prediction_of(result)
    # How large a pixel is on the ground [m]: as predicted, else as the independent points show.
    pixel = None if prediction is None else prediction.pixel
    on_ground = result.accuracy and result.accuracy.ground
    if pixel is None and on_ground and result.accuracy:
        pixel = on_ground.total / max(result.accuracy.image.total, 1e-12)
    excluded = sum(outlier.excluded for outlier in result.outliers)
    return {
        "chosen": result.strategy and result.strategy.chosen,
        **_rmse_by_role({role: result.rmse[role] for role in result.rmse}),
        "predicted": predicted and finite_or_none(predicted.rmse),
        "predicted_low": predicted and finite_or_none(predicted.low),
        "predicted_high": predicted and finite_or_none(predicted.high),
        "predicted_m": prediction and prediction.metres and prediction.metres[0],
        "independent_m": on_ground and on_ground.total, "pixel": pixel,
        "without_height": len(result.features.without_height()),
        "n_terms": len(selection.terms), "n_features": len(selection.features),
        "evaluations": result.evaluations, "excluded": excluded,
        "blunders": [outlier.id for outlier in result.outliers], "notes": list(result.notes)}

