"""Runs that search: what was found, its front, and what it is compared with."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from msgspec import convert
from msgspec.structs import asdict

from termsel.auto.auto import Auto
from termsel.auto.compare import compare_robustly
from termsel.auto.memory import Memory
from termsel.auto.refits import held_out_by_refits
from termsel.auto.shrunken import RidgeByOrder
from termsel.core.errors import TermselError, shown_value, unknown_name_error
from termsel.core.files.names import CERTIFICATE
from termsel.core.isolation.faults import HINT, fault_of_method
from termsel.data.features import BoolArray, select
from termsel.data.fit_data import FitData
from termsel.data.record.figures import as_plain_data
from termsel.data.record.search import Certificate, Member, SearchLimits, SizeRow
from termsel.data.roles import Observations
from termsel.fitting.figures import Baseline, Rmses, baseline_figures, rmse_record
from termsel.fitting.fit import Fit, HeldOut
from termsel.fitting.least_squares import fit
from termsel.models.base import SensorModel
from termsel.results.result import Result, checksum_of_certificate
from termsel.results.same_fit import fit_of_selection, has_pole
from termsel.runs.data_notes import notes_on_data, notes_on_dem
from termsel.runs.exported_rpc import doubt_of_rpc, rpc_of_model
from termsel.runs.finding import Finding, data_record_of, notes_on_sessions, plugins_of, result_of
from termsel.runs.fit_crs import note_on_pole
from termsel.runs.judgement import judge, name_conventional, notes_on_search
from termsel.runs.request import Request, problem_for
from termsel.runs.task import Task, prepare
from termsel.runs.task_method import TaskMethod
from termsel.runs.verdict import Verdict, judge_features, judge_independent
from termsel.runs.without_blunders import search_without_blunders
from termsel.selection.problems.base import Selection
from termsel.selection.problems.recipes import Recipe
from termsel.selection.problems.segments import Genes
from termsel.selection.problems.selection import SelectionProblem
from termsel.selection.solvers.base import GIVEN
from termsel.selection.solvers.proofs.exact import gap_to_optimum
from termsel.selection.solvers.proofs.proof import SizeProof
from termsel.selection.solvers.search import SearchResult

ALL_TAKE_PART = "1:1:0"
"""Shares of control, selection and independent points where a search is fitted as a method."""


class Search(TaskMethod):
    """The method that searches a problem: a recipe, with a solver and a criterion.

    Parameters
    ----------
    problem : str or Recipe, optional
        By default that of the task; where there is none, the one that the features are for.
    settings : mapping, optional
        Model, solver, criterion and options of the problem, as for `termsel.prepare`.
    limits : mapping, optional
        Budgets, seed and observers, as for `termsel.search`.

    Examples
    --------
    >>> import termsel
    >>> task = termsel.prepare("poly-terms", solver="exact", options={"degree": 2})
    >>> certificate = termsel.assess(termsel.Search(), task).certificate
    >>> certificate.optimal, certificate.subsets  # proven, by so many selections
    (True, 128)
    """

    problem: str | Recipe | None
    settings: Mapping[str, Any]
    limits: Mapping[str, Any]

    def __init__(self, problem: str | Recipe | None = None,
                 settings: Mapping[str, Any] | None = None,
                 limits: Mapping[str, Any] | None = None) -> None:
        super().__init__("search", "a search")
        if settings is not None and not isinstance(settings, Mapping):
            raise TermselError(f"settings is {shown_value(settings)}, expected a dict",
                               hint="Such as {'solver': 'ga', 'options': {'degree': 2}}.")
        self.__dict__.update(problem=problem, settings=settings or {}, limits=limits or {})

    def fit(self, data: FitData) -> Fit:
        """Return the fit of the selection that a search makes.

        Where no point is a selection point some become such, by their places, as the search judges
        by them; none is independent.
        """
        features = data.features
        if "check" not in features.points.roles:
            features = features.with_(points=replace(features.points, roles=()))
        settings = {**self.settings, "options": {
            "fractions": ALL_TAKE_PART, **self.settings.get("options", {})}}
        task = prepare(self.problem or problem_for(features), features=features, **settings)
        searched, search = search_without_blunders(task, Auto(), **self.limits)
        fitted = estimated(searched, searched.problem.decode(search.genes), search)
        # Selection points judged, and are control of the method all the same.
        in_use = select(fitted.control.ids, fitted.used)
        return replace(fitted, control=replace(features, fit_crs=fitted.control.fit_crs),
                       used=np.isin(features.ids, in_use))

    def held_out(self, fitted: Fit) -> HeldOut:
        """Return the errors of features where the whole search is made again without them.

        It is repeated in as many folds as the strategy "auto" uses, so it takes so many times as
        long as `fit`. The errors are those of all features, selected or not.
        """
        return held_out_by_refits(self.fit, fitted.control, heights=fitted.model.uses_height)

    def find(self, task: Task, memory: Memory) -> tuple[Request, Finding]:
        """Return the request that was searched, and what the search found.

        What is searched is `task` or, where this search has a problem or settings of its own, a
        task of these with the features of `task`.
        """
        if self.problem is not None or self.settings:
            task = self._with_own_problem(task)
        # The outlier test comes before the search, which may leave blunders out.
        auto = Auto(memory=memory)
        verdict = judge_features(task.observations, auto, task.options["data"]["tested"])
        searched, search = search_without_blunders(task, auto, verdict, **self.limits)
        budget = convert({
            name: float(limit) if name == "seconds" else int(limit)
            for name, limit in self.limits.items()
            if name in BUDGETS and limit is not None and math.isfinite(limit)}, SearchLimits)
        finding = finding_of(searched, search, auto, verdict)
        return searched.request, replace(finding, stated={**finding.stated, "budget": budget})

    def _with_own_problem(self, task: Task) -> Task:
        """Return a task of this search's problem and settings, with the features of another task.

        Points keep the roles that they play in the other task, so that independent ones stay so.
        """
        features = task.features.with_(points=task.observations.features.points)
        return prepare(self.problem or task.recipe, features=features, source=task.source,
                       **self.settings)


class GivenGenes(TaskMethod):
    """The method that takes the genes that an optimiser of one's own has found.

    Independent points are looked at in `termsel.assess` alone: assess what the optimiser ends with,
    and nothing that it decides by.

    Parameters
    ----------
    genes : ndarray, shape (size,)
        Valid genes of ``task.problem.genome``; its `repair` makes such of any numbers.

    Examples
    --------
    >>> import numpy as np
    >>> import termsel
    >>> task = termsel.prepare("poly-terms", options={"degree": 2})
    >>> genes = np.ones(task.problem.genome.size, dtype=bool)
    >>> result = termsel.assess(termsel.GivenGenes(genes), task)
    >>> len(result.selection.terms)
    12
    """

    genes: Genes

    def __init__(self, genes: Genes) -> None:
        super().__init__(GIVEN, "the genes that are given")
        self.__dict__.update(genes=genes)

    def fit(self, data: FitData) -> Fit:
        """Raise TermselError: genes are of one task, with its features, and have no other fit.

        Returns
        -------
        Fit
            Never.
        """
        raise TermselError("genes are of a prepared task, and cannot be fitted to other features",
                           hint="Call termsel.assess(termsel.GivenGenes(genes), task).")

    def find(self, task: Task, memory: Memory) -> tuple[Request, Finding]:
        """Return what the genes are for a prepared task: their request, and the selection.

        The record is that of a search with one evaluation, by the solver "given". `memory` is what
        was found of the same features before. Raises TermselError for genes of another dtype, shape
        or range.
        """
        # One chromosome, evaluated as the population of one that a search ends with.
        population = np.asarray(self.genes)[None]
        if fault := task.problem.genome.fault(population):
            raise TermselError(
                f"termsel.assess got {fault}",
                hint="Give one chromosome, as task.problem.genome.repair returns them.")
        evaluation = task.problem.evaluate(population)
        search = SearchResult(
            population[0], evaluation.objectives[0], float(evaluation.violation[0]), seed=0,
            evaluations=1, generations=0, lookups=0, seconds=0.0, interrupted=False,
            notes=("The genes were given to termsel.assess; how they were found is not recorded.",))
        finding = finding_of(task, search, Auto(memory=memory))
        stated = finding.stated
        plugins = {role: plugin for role, plugin in stated["plugins"].items() if role != "solver"}
        return task.request, replace(finding, stated={
            **stated, "solver": GIVEN, "options": {**stated["options"], "solver": {}},
            "plugins": plugins})


BUDGETS = ("generations", "evaluations", "seconds", "patience")
"""Limits of a search that its record names."""


def result_of_search(task: Task, search: SearchResult) -> Result:
    """Return the result of a finished search."""
    return result_of(task.request, finding_of(task, search, Auto()))


def finding_of(task: Task, search: SearchResult, auto: Auto,
               verdict: Verdict | None = None) -> Finding:
    """Return the finding of a search, and the fits that it is compared with.

    `auto` chooses the method that the selection is compared with. `verdict` is that of
    `judge_features` before the search.
    """
    observations = task.observations
    selection = task.problem.decode(search.genes)
    fitted = estimated(task, selection, search)
    feasible = is_feasible(task, search, fitted)
    has_figure = feasible or not (isinstance(task.problem, SelectionProblem)
                                  and task.problem.lacks_figure(search.genes))
    verdict = verdict or judge_features(observations, auto, task.options["data"]["tested"])
    # The conventional fit: all terms, all control, no selection.
    all_terms = fit(task.model, observations.control, task.scaling)
    comparison = compare_robustly(observations, auto, verdict.blunders | verdict.high)
    contradicting, agreeing = judge_independent(observations, comparison.choice, auto,
                                                verdict)
    # In words, for the sentence on what the selection is worth.
    conventional = name_conventional(task.problem.genome, observations)
    plugins = plugins_of(task.request)
    # Members of the front and the best of each size share fits, by their genes.
    sizes = _proofs_by_size(task, search)
    members = {genes.tobytes(): _front_member(task, genes) for genes in search.front}
    for size in sizes:
        if size.genes.tobytes() not in members:
            members[size.genes.tobytes()] = _front_member(task, size.genes)

    def baselines(in_roles: Observations) -> tuple[Baseline, ...]:
        return (baseline_figures("all-terms", all_terms, None, in_roles, ("control",)),
                *comparison.baselines(in_roles))

    # Called twice where independent points contradict all others: with and without these.
    def judgement(rmse: Rmses, rivals: tuple[Baseline, ...]) -> str:
        return judge(conventional, task.criterion.name, rmse, rivals,
                     reference=comparison.reference, feasible=feasible,
                     noise=task.features.noise, converged=fitted.adjustment.converged,
                     method=comparison.method, blunders=comparison.blunders,
                     evaluations=None if task.solver.ends_by_itself else search.evaluations,
                     has_figure=has_figure)

    doubt = "" if rpc_of_model(task.model) is None else doubt_of_rpc(observations)
    notes = (*([doubt] if doubt else []),
             *notes_on_dem(task.features, fitted),
             *notes_on_data(task.features, observations, task.model.uses_height,
                            task.request.blank, observations.control),
             *filter(None, [note_on_pole(observations.features, observations.control)]),
             *verdict.notes, *contradicting.notes,
             *notes_on_search(agreeing, task.criterion, search, fitted),
             *_notes_on_replaced_options(task.model, selection), *notes_on_sessions(plugins))
    then = task.then
    # The objectives of least squares are not those of other coefficients.
    objectives = search.objectives.tolist() if fitted.estimator.least_squares else []
    stated = {
        "solver": task.solver.name, "criterion": task.criterion.name, "seed": search.seed,
        "options": {**task.options, "model": task.model.options, "solver": task.solver.options,
                    "criterion": task.criterion.options,
                    **({"then": then.options} if then else {})},
        "plugins": plugins, "reference": comparison.reference, "notes": notes,
        "objectives": dict(zip(task.problem.objectives, objectives, strict=False)),
        "feasible": feasible, "interrupted": search.interrupted,
        "evaluations": search.evaluations, "lookups": search.lookups,
        "hit_rate": search.lookups / max(search.evaluations, 1),
        "generations": search.generations, "seconds": search.seconds, "history": search.history,
        "budget": SearchLimits(), "polish": search.polish,
        "front": tuple(members[genes.tobytes()] for genes in search.front),
        "by_size": tuple(SizeRow(**asdict(members[size.genes.tobytes()]), better=size.better,
                                 optimal=size.optimal, bound=size.bound, gap=size.gap)
                         for size in sizes),
        "certificate": _certificate_or_gap(task, search,
                                           fitted), "predicted": None, "strategy": None}
    return Finding(
        fit=fitted, observations=observations, compared=observations, verdict=verdict,
        contradicting=contradicting, agreeing=agreeing,
        in_use=frozenset({*selection.features, *observations.check.ids}), check_used=False,
        baselines=baselines, judgement=judgement, selection=selection, stated=stated,
        files=_files_of_search(task, search, observations))


def _files_of_search(
        task: Task, search: SearchResult, observations: Observations) -> dict[str, str]:
    """Return the texts of further files of the result, by name; {} without a certificate.

    There is one, the certificate of the proof. The SHA-256 of the features that it holds for and
    that of the certificate itself are entered in it.
    """
    if search.certificate_content is None:
        return {}
    # Who checks the certificate compares this checksum with that in result.json.
    data = data_record_of(task.request, observations).sha256
    content = {**search.certificate_content, "data": data}
    content["sha256"] = checksum_of_certificate(content)
    return {CERTIFICATE: json.dumps(content) + "\n"}


def _notes_on_replaced_options(model: SensorModel, selection: Selection) -> Iterable[str]:
    """Yield which options of the model have other values than those they were given."""
    for option in model.declared_options:
        stated = model.options[option.name]
        name = option.name
        if stated not in (option.default, selection.parameters.get(name, stated)):
            yield (f"Option {name} of the model was {stated}; the problem chose "
                   f"{selection.parameters[name]} in its place.")


def is_feasible(task: Task, search: SearchResult, fitted: Fit) -> bool:
    """Return whether the fit of a selection, as `estimated` returns it, satisfies all conditions.

    The coefficients may be others than those the search saw, so poles are looked for again.
    """
    # Least squares satisfy what the search saw; other coefficients must be looked at themselves.
    satisfies = search.violation == 0 if fitted.estimator.least_squares else fitted.determined
    return (satisfies and fitted.adjustment.converged
            and not has_pole(fitted, task.observations.check))


def estimated(task: Task, selection: Selection, search: SearchResult) -> Fit:
    """Return the fit of a selection, by the estimator that the task or the solver asks for."""
    fitted = fit_of(task, selection)
    # Selected terms, shrunken: their coefficients are not those that the search judged.
    if task.options["problem"].get("shrink"):
        return RidgeByOrder().fit(fitted.model, fitted.control, task.scaling, fitted.terms,
                                  fitted.used)
    return fitted if search.coefficients is None else fitted.with_coefficients(search.coefficients)


def _certificate_or_gap(task: Task, search: SearchResult, fitted: Fit) -> Certificate | None:
    """Return the solver's proof, or how far it is from a proven optimum; None if neither is known.
    """
    # A certificate of the solver, or the gap to an optimum that enumeration proves quickly.
    content = _proof_or_gap(task, search, fitted)
    return None if content is None else convert(as_plain_data(content), Certificate)


def _proof_or_gap(task: Task, search: SearchResult, fitted: Fit) -> Mapping[str, Any] | None:
    """Return the certificate of a search, or its distance from the optimum, as the record has them.

    Returns None where neither is known.
    """
    # What a solver of a plugin proves is its claim, and named as such.
    claim = plugins_of(task.request).get("solver")
    if search.certificate is not None and claim:
        return {**_required_certificate(search.certificate, claim["name"]),
                "claimed_by": claim["name"]}
    if (search.certificate is not None or search.violation or search.interrupted
            or not fitted.estimator.least_squares or len(search.objectives) > 1):
        return search.certificate
    return gap_to_optimum(task.problem, float(search.objectives[0]))


def _required_certificate(certificate: Mapping[str, Any], solver: str) -> dict[str, Any]:
    """Return the keys that a certificate needs of a plugin's.

    Raises TermselError, naming the solver, if one is missing or of another type.
    """
    kinds = {"optimal": bool, "subsets": int, "of": int, "space": str}
    if not isinstance(certificate, Mapping) or any(
            not isinstance(certificate.get(key), kind) for key, kind in kinds.items()):
        raise TermselError(f"the certificate of solver {solver!r} lacks something or has it of "
                           f"another type: it needs {', '.join(kinds)}",
                           hint="This is a bug in the solver: tell its author.")
    return {key: certificate[key] for key in kinds}


def _proofs_by_size(task: Task, search: SearchResult) -> list[SizeProof]:
    """Return the solver's proofs of the selections of each size; [] of a plugin's solver."""
    if search.proof is None or "solver" in plugins_of(task.request):
        return []
    return search.proof.by_size(task.problem)


def _front_member(task: Task, genes: Genes) -> Member:
    """Return the record of a member of a front, given its genes (size,): objectives and RMSEs.

    The selection is fitted anew, and the RMSE is that of the points of each role.
    """
    observations = task.observations
    selection = task.problem.decode(genes)
    member = fit_of(task, selection)
    values = task.problem.evaluate(genes[None]).objectives[0].tolist()
    # The second objective of a front of one criterion is the size of its selections.
    size = len(selection.features if task.recipe.second == "n_features" else selection.terms)
    return Member(
        {task.recipe.second: size, **dict(zip(task.problem.objectives, values, strict=True))},
        selection.record(),
        rmse_record({"control": member.control_rmse(), "check": member.rmse(observations.check),
                     "independent": member.rmse(observations.independent)}),
        bool(member.estimator.options["iterated"]))


def fit_of(task: Task, selection: Selection) -> Fit:
    """Return the model fitted with the terms and features that a problem's genes stand for."""
    control = task.observations.control
    # Values that the genes chose for options of the model take the place of those given.
    model = task.model.with_parameters(selection.parameters)
    # Names, not places: a problem may select among some of the terms or features.
    terms = _mask_of_names(task, model.terms, selection.terms, "term")
    used = _mask_of_names(task, control.ids, selection.features, "control feature")
    return fit_of_selection(model, control, task.scaling, terms, used, task.observations.check)


def _mask_of_names(task: Task, names: tuple[str, ...], fitted: Iterable[str],
                   kind: str) -> BoolArray:
    """Return which of n names a problem's `decode` gives, (n,).

    Raises PluginFault for a name that is none of them.
    """
    names_fitted = set(fitted)
    if not names_fitted <= set(names):
        error = unknown_name_error(kind, min(names_fitted - set(names)), names)
        raise fault_of_method(task.problem, "decode", f"names an {error.what}",
                              f"{error.hint} {HINT}")
    return np.array([name in names_fitted for name in names], dtype=bool)
