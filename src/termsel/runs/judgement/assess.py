"""What a search found: its figures, its front, and what it is compared with."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from msgspec import convert
from msgspec.structs import asdict

from termsel.auto.compare import compare_robustly
from termsel.auto.portfolio import Portfolio
from termsel.auto.ridge import RidgeByOrder
from termsel.core.errors import TermselError, unknown_name
from termsel.core.files.names import CERTIFICATE
from termsel.core.isolation.faults import HINT, wrong
from termsel.data.features import BoolArray
from termsel.data.record.base import plain
from termsel.data.record.search import Certificate, Member, SizeRow
from termsel.data.roles import Observations
from termsel.fitting.accuracy import accuracy_of
from termsel.fitting.diagnosis import diagnose
from termsel.fitting.figures import Baseline, Rmses, baseline, figures, residuals_of, rmse_record
from termsel.fitting.fit import Fit
from termsel.fitting.least_squares import fit
from termsel.models.base import SensorModel
from termsel.results.checksums import of_certificate
from termsel.results.result import Result
from termsel.results.same_fit import has_pole, least_squares_of
from termsel.runs.judgement.judge import judge, name_conventional, notes_on
from termsel.runs.task.data_notes import notes_on_data, notes_on_dem
from termsel.runs.task.fit_crs import note_on_pole
from termsel.runs.task.provenance import data_of, notes_on_sessions, plugins_of, versions
from termsel.runs.task.task import Task
from termsel.runs.task.verdict import Verdict, judge_features, judge_independent
from termsel.selection.problems.base import Selection
from termsel.selection.problems.segments import Genes
from termsel.selection.solvers.base import GIVEN
from termsel.selection.solvers.proofs.exact import gap
from termsel.selection.solvers.proofs.proof import SizeProof
from termsel.selection.solvers.search import Search


def assess(task: Task, genes: Genes) -> Result:
    """Return the result of genes that an optimiser of one's own has found.

    Independent points are looked at here alone: assess what the optimiser ends with, and nothing
    that it decides by.

    Parameters
    ----------
    task : Task
        As `termsel.prepare` returns it; the optimiser minimises ``task.problem.evaluate``.
    genes : ndarray, shape (size,)
        Valid genes of ``task.problem.genome``; its `repair` makes such of any numbers.

    Returns
    -------
    Result
        With "given" as its solver.

    Raises
    ------
    TermselError
        For genes of another dtype or shape, or out of bounds.

    Examples
    --------
    >>> import numpy as np
    >>> import termsel
    >>> task = termsel.prepare("poly-terms", options={"degree": 2})
    >>> genes = task.problem.genome.random(np.random.default_rng(1), 100)
    >>> order = task.problem.evaluate(genes).order()
    >>> result = termsel.assess(task, genes[order[0]])
    >>> result.solver
    'given'
    """
    one = np.asarray(genes)[None]
    if fault := task.problem.genome.fault(one):
        raise TermselError(f"termsel.assess got {fault}",
                           hint="Give one chromosome, as task.problem.genome.repair returns them.")
    found = task.problem.evaluate(one)
    result = assessed(task, Search(
        one[0], found.objectives[0], float(found.violation[0]), seed=0, evaluations=1,
        generations=0, lookups=0, seconds=0.0, interrupted=False,
        notes=("The genes were given to termsel.assess; how they were found is not recorded.",)))
    return replace(result, solver=GIVEN, options={**result.options, "solver": {}},
                   plugins={part: one for part, one in result.plugins.items()
                            if part != "solver"})


def assessed(task: Task, found: Search, verdict: Verdict | None = None) -> Result:
    """Return the figures of what a search found.

    This is where independent points are looked at, for the first and only time. `verdict` is that
    of `judge_features` before the search.
    """
    observations = task.observations
    selection = task.problem.decode(found.genes)
    chosen = estimated(task, selection, found)
    judged = chosen.estimator.least_squares
    feasible = is_feasible(task, found, chosen)
    # The objectives of least squares are not those of other coefficients.
    objectives = found.objectives.tolist() if judged else []
    verdict = verdict or judge_features(
        observations, Portfolio(), task.options["data"]["tested"])
    everything = fit(task.model, observations.control, task.scaling)
    comparison = compare_robustly(observations, verdict.blunders | verdict.high)
    contradicting, agreeing = judge_independent(observations, comparison.choice)
    outliers = (*verdict.without({*selection.features, *observations.check.ids}),
                *contradicting.outliers)

    def compared(seen: Observations) -> tuple[Rmses, tuple[Baseline, ...]]:
        return figures(chosen, seen), (baseline("all-terms", everything, None, seen, ("control",)),
                                       *comparison.baselines(seen))

    rmse, baselines = compared(observations)
    judged_by = compared(agreeing) if contradicting.outliers else (rmse, baselines)
    sizes = _sizes(task, found)
    members = {genes.tobytes(): _member(task, genes)
               for genes in (*found.front, *(size.genes for size in sizes))}
    return Result(
        problem=task.recipe.name, model=task.model.name, solver=task.solver.name,
        criterion=task.criterion.name, seed=found.seed,
        options={**task.options, "model": task.model.options, "solver": task.solver.options,
                 "criterion": task.criterion.options,
                 **({"then": task.then.options} if task.then else {})},
        data=data_of(task, observations), selection=selection,
        feasible=feasible, rmse=rmse,
        baselines=baselines,
        judgement=judge(name_conventional(task.problem.genome, observations),
                        task.criterion.name, *judged_by, comparison.reference, feasible,
                        task.features.noise, converged=chosen.adjustment.converged,
                        candidate=comparison.candidate,
                        blunders=comparison.blunders),
        reference=comparison.reference,
        notes=(*notes_on_dem(task.features, chosen),
               *notes_on_data(task.features, observations, task.model.uses_height,
                              task.blank, observations.control),
               *filter(None, [note_on_pole(observations.features, observations.control)]),
               *verdict.notes, *contradicting.notes,
               *notes_on(agreeing, task.criterion, found, chosen),
               *_on_replaced(task.model, selection), *notes_on_sessions(plugins_of(task))),
        objectives=dict(zip(task.problem.objectives, objectives, strict=False)),
        evaluations=found.evaluations, lookups=found.lookups, generations=found.generations,
        seconds=found.seconds, interrupted=found.interrupted,
        polish=found.polish, history=found.history, fit=chosen,
        residuals=residuals_of(chosen, observations, outliers),
        diagnosis=diagnose(chosen), outliers=outliers, blunder_test=verdict.test,
        accuracy=accuracy_of(chosen, observations.independent),
        accuracy_without=accuracy_of(chosen, agreeing.independent)
        if contradicting.outliers else None,
        features=observations.features, versions=versions(),
        plugins=plugins_of(task),
        front=tuple(members[genes.tobytes()] for genes in found.front),
        by_size=tuple(SizeRow(**asdict(members[size.genes.tobytes()]), better=size.better,
                              optimal=size.optimal, bound=size.bound, gap=size.gap)
                      for size in sizes),
        certificate=_certificate(task, found, chosen),
        files=_files(task, found, observations))


def _files(task: Task, found: Search, observations: Observations) -> dict[str, str]:
    """Return further files of the result: the certificate of a proof, with the data it is of."""
    if found.certificate_content is None:
        return {}
    data = data_of(task, observations).sha256
    content = {**found.certificate_content, "data": data}
    content["sha256"] = of_certificate(content)
    return {CERTIFICATE: json.dumps(content) + "\n"}


def _on_replaced(model: SensorModel, selection: Selection) -> Iterable[str]:
    """Yield which options of the model have other values than those they were given."""
    for option in model.declared_options:
        asked = model.options[option.name]
        name = option.name
        if asked not in (option.default, selection.parameters.get(name, asked)):
            yield (f"Option {name} of the model was {asked}; the problem chose "
                   f"{selection.parameters[name]} in its place.")


def is_feasible(task: Task, found: Search, chosen: Fit) -> bool:
    """Return whether the fit of a selection, as `estimated` returns it, satisfies all conditions.

    The coefficients may be others than those the search saw, so poles are looked for again.
    """
    return (found.violation == 0 if chosen.estimator.least_squares else chosen.determined) \
        and chosen.adjustment.converged and not has_pole(chosen, task.observations.check)


def estimated(task: Task, selection: Selection, found: Search) -> Fit:
    """Return the fit of a selection, by the estimator that the task or the solver asks for."""
    chosen = fit_of(task, selection)
    if task.options["problem"].get("shrink"):
        return RidgeByOrder().fit(chosen.model, chosen.control, task.scaling, chosen.terms,
                                  chosen.used)
    return chosen if found.coefficients is None else chosen.with_coefficients(found.coefficients)


def _certificate(task: Task, found: Search, chosen: Fit) -> Certificate | None:
    """Return what the solver proved, or how far its find is from the proven optimum."""
    content = _proven(task, found, chosen)
    return None if content is None else convert(plain(content), Certificate)


def _proven(task: Task, found: Search, chosen: Fit) -> Mapping[str, Any] | None:
    claim = plugins_of(task).get("solver")
    if found.certificate is not None and claim:
        return {**_required(found.certificate, claim["name"]), "claimed_by": claim["name"]}
    if (found.certificate is not None or found.violation or found.interrupted
            or not chosen.estimator.least_squares or len(found.objectives) > 1):
        return found.certificate
    return gap(task.problem, float(found.objectives[0]))


def _required(certificate: Mapping[str, Any], solver: str) -> dict[str, Any]:
    """Return what a plugin's certificate must say; refuse one that does not."""
    kinds = {"optimal": bool, "subsets": int, "of": int, "space": str}
    if not isinstance(certificate, Mapping) or any(
            not isinstance(certificate.get(key), kind) for key, kind in kinds.items()):
        raise TermselError(f"the certificate of solver {solver!r} lacks something or has it of "
                           f"another type: it needs {', '.join(kinds)}",
                           hint="This is a bug in the solver: tell its author.")
    return {key: certificate[key] for key in kinds}


def _sizes(task: Task, found: Search) -> list[SizeProof]:
    """Return what the solver proved of the selections of each size; nothing of a plugin's."""
    return [] if found.proof is None or "solver" in plugins_of(task) \
        else found.proof.by_size(task.problem)


def _member(task: Task, genes: Genes) -> Member:
    """Return the member of a front, with its RMSE on all roles."""
    observations = task.observations
    selection = task.problem.decode(genes)
    member = fit_of(task, selection)
    values = task.problem.evaluate(genes[None]).objectives[0].tolist()
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
    model = task.model.with_parameters(selection.parameters)
    terms = _mask(task, model.terms, selection.terms, "term")
    used = _mask(task, control.ids, selection.features, "control feature")
    return least_squares_of(model, control, task.scaling, terms, used, task.observations.check)


def _mask(task: Task, names: tuple[str, ...], chosen: Iterable[str], what: str) -> BoolArray:
    """Return which names a problem's `decode` gives; refuse one that there is not."""
    wanted = set(chosen)
    if not wanted <= set(names):
        known = unknown_name(what, min(wanted - set(names)), names)
        raise wrong(task.problem, "decode", f"names an {known.what}", f"{known.hint} {HINT}")
    return np.array([name in wanted for name in names], dtype=bool)
