"""One run from names to a Result: prepare the problem, search it, assess what was found."""

from __future__ import annotations

import hashlib
import logging
import platform
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from termsel.adjustment.kernels import needs_compilation
from termsel.criteria import Criterion
from termsel.errors import TermselError, unknown_name
from termsel.features import BoolArray, FeatureSet
from termsel.fitting import Fit, fit, plain_fits
from termsel.judging import judge, name_conventional, notes_on
from termsel.models.base import SensorModel, require_heights
from termsel.options import Option, resolve
from termsel.plugins.manager import registry
from termsel.problems.base import Problem, Selection
from termsel.problems.recipes import Recipe
from termsel.problems.selection import Inputs, guard_points, pole_violation
from termsel.result import Baseline, Residual, Result, plain_rmse, residuals_of
from termsel.roles import Observations, observe
from termsel.scaling import Scaling, scaling_of
from termsel.searching import Observer, Search, search
from termsel.solvers.base import Solver
from termsel.solvers.exact import gap

log = logging.getLogger(__name__)

DATA_OPTIONS = (
    Option("roles", "file", "Roles of points: as in the file, with blank ones shared out by "
           "place; or shared out anew by place or at random.",
           choices=("file", "stratified", "random")),
    Option("fractions", "1:1:1", "Shares of control, check and independent points among those "
           "shared out."),
    Option("split", 0, "Seed of the sharing out of roles.", int, 0),
)

MIN_CONTROL, MIN_CHECK = 3, 2


@dataclass(frozen=True, eq=False)
class Task:
    """A problem made ready for a search.

    Parameters
    ----------
    recipe : Recipe
    problem : Problem
    model : SensorModel
    solver : Solver
    criterion : Criterion
    observations : Observations
    scaling : Scaling
    features : FeatureSet
        As read, all roles together.
    source : str
        Where the features come from.
    options : mapping
        Options by part: problem, data.
    """

    recipe: Recipe
    problem: Problem
    model: SensorModel
    solver: Solver
    criterion: Criterion
    observations: Observations
    scaling: Scaling
    features: FeatureSet
    source: str
    options: Mapping[str, Mapping[str, Any]]


def prepare(
    problem: str,
    *,
    features: FeatureSet | None = None,
    dataset: str | None = None,
    source: str | None = None,
    model: str | None = None,
    solver: str | None = None,
    criterion: str | None = None,
    options: Mapping[str, Any] | None = None,
) -> Task:
    """Make a problem ready from names.

    Parameters
    ----------
    problem : str
        Name of a recipe, such as "owdis-lines".
    features : FeatureSet, optional
        Measured features; without them those of `dataset`, or of the recipe's data set.
    dataset : str, optional
        Name of a data set.
    source : str, optional
        Where `features` come from, for the record.
    model, solver, criterion : str, optional
        Names; the recipe's own by default.
    options : mapping, optional
        Options of problem, data, model, criterion and solver together, as with ``--set``.

    Returns
    -------
    Task

    Raises
    ------
    TermselError
        For unknown names or options, and for data the problem cannot be run on.
    """
    names = registry()
    recipe: Recipe = names.get("problems", problem)
    given = dict(options or {})
    model_type = names.get("models", model or recipe.model)
    the_criterion: Criterion = names.get("criteria", criterion or recipe.criterion)
    solver_type = names.get("solvers", solver or recipe.solver)
    own = {**recipe.model_options} if model is None or model == recipe.model else {}
    declared = {
        "problem": recipe.options, "data": DATA_OPTIONS,
        "model": model_type.declared_options, "criterion": the_criterion.declared_options,
        "solver": solver_type.declared_options}
    _refuse_unknown(given, declared)
    chosen = {part: {o.name: given[o.name] for o in known if o.name in given}
              for part, known in declared.items()}
    of_problem = resolve(recipe.options, chosen["problem"])
    of_data = resolve(DATA_OPTIONS, chosen["data"])
    if solver_type.max_objectives > 1 and "objectives" in of_problem:
        of_problem["objectives"] = of_problem["objectives"] or recipe.second
    the_model = model_type(**{**own, **chosen["model"]})
    the_criterion = type(the_criterion)(**{**the_criterion.options, **chosen["criterion"]})
    the_solver = solver_type(**chosen["solver"])
    if features is None:
        spec = names.get("datasets", dataset or recipe.dataset)
        features = spec.load()
        source = f"{spec.name} (simulated)" if spec.simulated else spec.name
    observations = observe(
        features, control="both" if of_problem.get("mixed") else recipe.control,
        how=of_data["roles"],
        fractions=_fractions(of_data["fractions"], the_criterion.needs_check),
        rng=np.random.default_rng(of_data["split"]))
    require_heights(the_model, features)
    _require_enough(observations, recipe, the_criterion)
    scaling = scaling_of(observations.control)
    inputs = Inputs(the_model, scaling.features(observations.control),
                    scaling.points(observations.check), scaling.image_scale, the_criterion,
                    of_problem)
    the_problem = recipe.build(inputs)
    _require_able(the_solver, the_problem)
    return Task(recipe, the_problem, the_model, the_solver, the_criterion, observations,
                scaling, features, source or "given in Python",
                {"problem": of_problem, "data": of_data})


def _refuse_unknown(given: Mapping[str, Any], declared: Mapping[str, Iterable[Option]]) -> None:
    known = {option.name for part in declared.values() for option in part}
    for key in given:
        if key not in known:
            raise unknown_name("option", key, known)


def _require_able(solver: Solver, problem: Problem) -> None:
    """Refuse a solver for fewer objectives than the problem has, naming those that can."""
    wanted = len(problem.objectives)
    if wanted > solver.max_objectives:
        able = [entry.name for entry in registry().entries("solvers")
                if entry.object.max_objectives >= wanted]
        raise TermselError(
            f"solver {solver.name!r} cannot minimise {wanted} objectives together: "
            f"{', '.join(problem.objectives)}",
            hint=f"Solvers that can: {', '.join(able) or 'none is installed'}.")


def _fractions(text: str, needs_check: bool) -> tuple[float, ...]:
    try:
        shares = tuple(float(part) for part in text.replace(",", ":").split(":"))
    except ValueError:
        shares = ()
    if len(shares) != 3 or not np.isfinite(shares).all() or min(shares) < 0 \
            or (needs_check and not shares[1]):
        raise TermselError(f"option 'fractions' does not take {text!r}",
                           hint="It takes three numbers for control, check and independent, "
                                "such as 1:1:1 or 0.4:0.3:0.3; check must be above 0 "
                                "for a criterion that needs check points.")
    return shares


def _require_enough(observations: Observations, recipe: Recipe, criterion: Criterion) -> None:
    control, check = observations.control, observations.check
    if len(control) < MIN_CONTROL:
        raise TermselError(
            f"{len(control)} control features are too few: {recipe.name} needs at least "
            f"{MIN_CONTROL}", hint="Measure more, or give more of them the role control.")
    if criterion.needs_check and len(check) < MIN_CHECK:
        raise TermselError(
            f"{len(check)} check points are too few: criterion {criterion.name} needs at least "
            f"{MIN_CHECK}", hint="Give more points the role check; they judge the fitness of a "
            "selection. --criterion press does without.")
    flat = np.ptp(control.ground_vertices()[:, :2], axis=0)
    spread = np.linalg.svd(control.ground_vertices()[:, :2]
                           - control.ground_vertices()[:, :2].mean(axis=0), compute_uv=False)
    if not flat.any() or spread[1] < 1e-6 * spread[0]:
        raise TermselError("all control features lie on one straight line on the ground",
                           hint="Control must spread over an area to fix a model.")


def run(
    problem: str | Task,
    *,
    seed: int = 1,
    generations: int | None = None,
    evaluations: int | None = None,
    seconds: float | None = None,
    observers: Iterable[Observer] = (),
    out: Path | str | None = None,
    **prepared: Any,
) -> Result:
    """Search a problem and assess the selection.

    Parameters
    ----------
    problem : str or Task
        A recipe's name, or what `prepare` made of it.
    seed : int
        Seed of the search.
    generations, evaluations : int, optional
        Budgets; see `termsel.search`.
    seconds : float, optional
        Budget of time.
    observers : iterable of callable
        Called after each generation.
    out : path, optional
        Folder for result.json, residuals.csv and summary.txt.
    **prepared
        Arguments of `prepare`, where `problem` is a name.

    Returns
    -------
    Result

    Raises
    ------
    TermselError
        As `prepare` and `termsel.search`; or if `out` cannot be written.

    Examples
    --------
    >>> import termsel
    >>> result = termsel.run("poly-terms", seed=1, generations=5)
    >>> round(result.rmse["independent"].total, 1) > 0
    True
    """
    from termsel.io.result_files import claim_folder, write_result

    if isinstance(problem, Task):
        if prepared:
            raise TermselError(f"a prepared task takes no {', '.join(sorted(prepared))}",
                               hint="Give them to termsel.prepare.")
        task = problem
    else:
        task = prepare(problem, **prepared)
    if out is not None:
        claim_folder(Path(out))
    if needs_compilation():
        log.info("Compiling: the first run on this machine takes some 10 s longer.")
    found = search(task.problem, task.solver, seed=seed, generations=generations,
                   evaluations=evaluations, seconds=seconds, observers=observers)
    result = assess(task, recommended(task, found))
    if out is not None:
        write_result(result, Path(out))
    registry().notify_run_finished(result)
    return result


def assess(task: Task, found: Search) -> Result:
    """Return the figures of what a search found.

    This is where independent points are looked at, for the first and only time.

    Parameters
    ----------
    task : Task
    found : Search
    """
    observations = task.observations
    selection = task.problem.decode(found.genes)
    chosen = fit_of(task, selection)
    objectives, feasible = found.objectives.tolist(), found.violation == 0
    if found.coefficients is not None:
        chosen = chosen.with_coefficients(found.coefficients)
        guard = guard_points(task.scaling.features(observations.control),
                             task.scaling.points(observations.check))
        feasible = not pole_violation(task.model, found.coefficients[None], guard).any()
        objectives = []  # those of least squares are not those of these coefficients
    rmse = {"control": chosen.control_rmse(), "check": chosen.rmse(observations.check),
            "independent": chosen.rmse(observations.independent)}
    baselines = tuple(_baselines(task))
    return Result(
        problem=task.recipe.name, model=task.model.name, solver=task.solver.name,
        criterion=task.criterion.name, seed=found.seed,
        options={**task.options, "model": task.model.options, "solver": task.solver.options,
                 "criterion": task.criterion.options},
        data=_data(task), selection=selection, feasible=feasible, rmse=rmse,
        baselines=baselines,
        judgement=judge(name_conventional(task.problem.genome, observations),
                        task.criterion.name, rmse, baselines, feasible, task.features.noise),
        notes=tuple(notes_on(observations, task.criterion, found, chosen)),
        objectives=dict(zip(task.problem.objectives, objectives, strict=False)),
        evaluations=found.evaluations, lookups=found.lookups, generations=found.generations,
        seconds=found.seconds, interrupted=found.interrupted,
        polish=asdict(found.polish) if found.polish else None, fit=chosen,
        residuals=tuple(_residuals(chosen, observations)), versions=_versions(),
        front=tuple(_front(task, found)), certificate=_certificate(task, found))


def recommended(task: Task, found: Search) -> Search:
    """Return the search with the recommended member of its front as its selection.

    The rule is the problem's option "recommend". The standard error of the best criterion is
    taken as that of an RMSE of normal errors, RMSE / sqrt(2 f), with f = 2 n coordinates of n
    check points. The knee is the member farthest below the straight line between the front's
    ends, in the logarithm of the criterion, which spans orders of magnitude, and the second
    objective, both scaled to [0, 1].

    Parameters
    ----------
    task : Task
    found : Search
        Of a problem with several objectives; any other is returned as it is.
    """
    if len(task.problem.objectives) < 2 or not found.front:
        return found
    evaluation = task.problem.evaluate(np.array(found.front))
    first, second = evaluation.objectives[:, 0], evaluation.objectives[:, 1]
    rule = task.options["problem"]["recommend"]
    index = int(np.argmin(first))
    if rule == "one-standard-error" and first[index] > 0:  # an information criterion has none
        bound = first[index] * (1 + 1 / np.sqrt(4 * max(len(task.observations.check), 1)))
        within = np.flatnonzero(first <= bound)
        index = int(within[np.lexsort((first[within], second[within]))[0]])
    elif rule == "knee" and np.ptp(first) > 0 and np.ptp(second) > 0:
        height = np.log(first) if first.min() > 0 else first
        below = (height - height.min()) / np.ptp(height) + (second - second.min()) / np.ptp(second)
        index = int(np.argmin(below))
    return replace(found, genes=found.front[index], objectives=evaluation.objectives[index],
                   violation=float(evaluation.violation[index]))


def _certificate(task: Task, found: Search) -> Mapping[str, Any] | None:
    """Return what the solver proved, or how far its find is from the proven optimum."""
    if (found.certificate is not None or found.violation or found.interrupted
            or found.coefficients is not None
            or len(found.objectives) > 1):
        return found.certificate
    return gap(task.problem, float(found.objectives[0]))


def _front(task: Task, found: Search) -> Iterable[Mapping[str, Any]]:
    """Yield the members of a front with their RMSE on all roles."""
    observations = task.observations
    for genes in found.front:
        selection = task.problem.decode(genes)
        member = fit_of(task, selection)
        values = task.problem.evaluate(genes[None]).objectives[0].tolist()
        size = len(selection.features if task.recipe.second == "n_features" else selection.terms)
        yield {"objectives": {task.recipe.second: size,
                              **dict(zip(task.problem.objectives, values, strict=True))},
               "selection": {"terms": list(selection.terms),
                             "features": list(selection.features),
                             "n_terms": len(selection.terms),
                             "n_features": len(selection.features)},
               "rmse": plain_rmse({"control": member.control_rmse(),
                                 "check": member.rmse(observations.check),
                                 "independent": member.rmse(observations.independent)})}


def fit_of(task: Task, selection: Selection) -> Fit:
    """Return the model fitted with the terms and features of a selection."""
    control = task.observations.control
    return fit(task.model, control, task.scaling, _mask(task.model.terms, selection.terms),
               _mask(control.ids, selection.features))


def _mask(names: tuple[str, ...], chosen: Iterable[str]) -> BoolArray:
    wanted = set(chosen)
    return np.array([name in wanted for name in names], dtype=bool)


def _baselines(task: Task) -> Iterable[Baseline]:
    """Yield the conventional fit and plain polynomials."""
    observations = task.observations
    everything = fit(task.model, observations.control, task.scaling)
    yield _baseline("all-terms", everything, observations, ("control",))
    for name, fitted in plain_fits(observations.control, observations.check):
        yield _baseline(name, fitted, observations, ("control", "check"))


def _baseline(name: str, fitted: Fit, observations: Observations,
              roles: tuple[str, ...]) -> Baseline:
    if observations.control is fitted.control:
        control = fitted.control_rmse()
    else:
        # The check points served as control; the figure of control is of control alone.
        control = _control_alone(fitted, observations)
    return Baseline(name, int(fitted.terms.sum()), roles, fitted.adjustment.feasible,
                    {"control": control, "check": fitted.rmse(observations.check),
                     "independent": fitted.rmse(observations.independent)})


def _control_alone(fitted: Fit, observations: Observations) -> Any:
    alone = Fit(fitted.model, fitted.scaling, observations.control, fitted.terms,
                np.ones(len(observations.control), dtype=bool), fitted.adjustment)
    return alone.control_rmse()


def _residuals(chosen: Fit, observations: Observations) -> Iterable[Residual]:
    points, lines = observations.control.points, observations.control.lines
    used = tuple(bool(on) for on in chosen.used)
    yield from residuals_of(points.ids, chosen.errors(points), "control", used[:len(points)])
    for vertex in (0, 1):
        yield from residuals_of(lines.ids, chosen.line_errors()[:, vertex], "control",
                                used[len(points):], f"vertex {vertex + 1}")
    for role, others in (("check", observations.check), ("independent", observations.independent)):
        yield from residuals_of(others.ids, chosen.errors(others), role, (False,) * len(others))


def _data(task: Task) -> dict[str, Any]:
    observations = task.observations
    return {
        "source": task.source, "sha256": _checksum(task.features), "crs": task.features.crs,
        "noise": task.features.noise,
        "counts": {"control": len(observations.control.points), "check": len(observations.check),
                   "independent": len(observations.independent),
                   "lines": len(observations.control.lines), "off": len(observations.off)},
        "roles": {"check": list(observations.check.ids),
                  "independent": list(observations.independent.ids)}}


def _checksum(features: FeatureSet) -> str:
    """Return a checksum of ids and coordinates, whatever file they came in."""
    digest = hashlib.sha256()
    for part in (features.points, features.lines):
        digest.update("\n".join(part.ids).encode())
        digest.update(part.image.tobytes())
        digest.update(part.ground.tobytes())
    return digest.hexdigest()


def _versions() -> dict[str, str]:
    packages = ("termsel", "numpy", "scipy", "numba", "deap")
    return {"python": platform.python_version(), **{name: version(name) for name in packages}}
