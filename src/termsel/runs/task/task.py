"""A problem made ready for a search: observe, scale, build."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from termsel.criteria import Criterion
from termsel.display import Glance
from termsel.errors import TermselError, printable
from termsel.guard.arrays import of_type
from termsel.guard.faults import blamed, wrong
from termsel.measurements.datasets import DatasetSpec
from termsel.measurements.features import FeatureSet, Points
from termsel.measurements.roles import (
    Observations,
    asked_roles,
    check_as_control,
    parsed_shares,
    with_roles,
)
from termsel.measurements.roles import observe as assign_roles
from termsel.measurements.scaling import Scaling, scaling_of
from termsel.models.base import SensorModel, require_heights
from termsel.models.interpolating import Interpolating
from termsel.options import SEED, Option, by_part, resolve
from termsel.plugins.registry import registry
from termsel.problems.base import Inputs, Problem
from termsel.problems.constraints import MAX_SHARE
from termsel.problems.parameters import ParameterProblem
from termsel.problems.recipes import Recipe
from termsel.runs.task.blank_heights import to_leave_out
from termsel.runs.task.enough import require_enough
from termsel.runs.task.fit_crs import FIT_CRS, with_fit_crs
from termsel.runs.task.given import class_of, objectives_of, second_solver, with_options
from termsel.solvers.base import Solver
from termsel.solvers.budget import SEARCH_OPTIONS
from termsel.solvers.search import require_able

ALIKE = "1:1:1"
"""Shares of control, check and independent points by default."""

DATA_OPTIONS = (
    Option("roles", "file", "Roles of points: those of the file, with blank ones assigned by "
           "place; or all assigned by place or at random.",
           choices=("file", "stratified", "random")),
    Option("off", None, "Ids of features that take no part, with commas between them (--off)."),
    Option("role", None, "Roles of single points, whatever the file says, as ID=ROLE with commas "
           "between them (--role)."),
    Option("fractions", ALIKE, "Shares of control, check and independent points among those "
           "that are assigned a role."),
    Option("split", 0, "Seed by which roles are assigned.", int, 0, SEED),
    Option("check_as", None, "What check points are: judges of each selection, or further control. "
           "By default judges; where points are the control and the criterion needs no check "
           "points, control.", choices=("judge", "control")),
    FIT_CRS,
)

MIN_CONTROL = 3

FEW = 12
"""Number of points without any role below which all are control, where nothing needs check points:
leave-one-out then tells the accuracy."""


@dataclass(frozen=True, eq=False)
class Request:
    """What is asked for: names resolved, options checked, features read.

    Parameters
    ----------
    recipe : Recipe
    model : SensorModel
        Not yet prepared for the features.
    criterion : Criterion
    solver : Solver
    features : FeatureSet
        As read, all roles together.
    source : str
        Where the features come from.
    options : mapping
        Options by part: problem, data, search.
    then : Solver, optional
        Of the second of two steps, if it is another one.
    set_options : tuple of str
        Names of the options of the model that are given.
    blank : tuple of str
        Features that are left out as they have no height.
    """

    recipe: Recipe
    model: SensorModel
    criterion: Criterion
    solver: Solver
    features: FeatureSet
    source: str
    options: Mapping[str, Mapping[str, Any]]
    then: Solver | None = None
    set_options: tuple[str, ...] = ()
    blank: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False, repr=False)
class Task(Glance):
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
    options, then, blank
        As of `Request`.
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
    then: Solver | None = None
    blank: tuple[str, ...] = ()

    def _glance(self) -> tuple[str, Mapping[str, str]]:
        method = ", ".join(part.name for part in (self.model, self.solver, self.criterion))
        return f"Task: {self.recipe.name}", {"method": method, "data": self.source}


def prepare(
    problem: str | Recipe,
    *,
    features: FeatureSet | None = None,
    dataset: str | DatasetSpec | None = None,
    source: str | None = None,
    model: str | type[SensorModel] | SensorModel | None = None,
    solver: str | type[Solver] | Solver | None = None,
    criterion: str | type[Criterion] | Criterion | None = None,
    options: Mapping[str, Any] | None = None,
) -> Task:
    """Make a problem ready from names, or from the things themselves.

    Parameters
    ----------
    problem : str or Recipe
        A recipe or its name, such as "owdis-lines".
    features : FeatureSet, optional
        Measured features; without them those of `dataset`, or of the recipe's data set.
    dataset : str or DatasetSpec, optional
        A data set or its name.
    source : str, optional
        Where `features` come from, for the record.
    model, solver, criterion : str, class or instance, optional
        The recipe's own by default. Instances have their options already.
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
    request = ask(problem, features=features, dataset=dataset, source=source, model=model,
                  solver=solver, criterion=criterion, options=options)
    observations = observe(request)
    return build(request, observations, *scale(request, observations))


def ask(
    problem: str | Recipe,
    *,
    features: FeatureSet | None = None,
    dataset: str | DatasetSpec | None = None,
    source: str | None = None,
    model: str | type[SensorModel] | SensorModel | None = None,
    solver: str | type[Solver] | Solver | None = None,
    criterion: str | type[Criterion] | Criterion | None = None,
    options: Mapping[str, Any] | None = None,
) -> Request:
    """Return what is asked for, with every name resolved and every option checked.

    Parameters
    ----------
    problem, features, dataset, source, model, solver, criterion, options
        As for `prepare`.
    """
    names = registry()
    recipe: Recipe = names.taken("problems", problem)
    the_model = names.taken("models", recipe.model if model is None else model)
    # Where terms have no influence there is nothing to search.
    usual = "all-terms" if issubclass(class_of(the_model), Interpolating) else recipe.solver
    parts = {"model": the_model,
             "criterion": names.taken("criteria",
                                      recipe.criterion if criterion is None else criterion),
             "solver": names.taken("solvers", usual if solver is None else solver)}
    given = options or {}
    if (then := second_solver(recipe, given)) is not None:
        parts["then"] = names.get("solvers", then)
    chosen = by_part(given, {
        "problem": recipe.options, "data": DATA_OPTIONS, "search": SEARCH_OPTIONS,
        **{word: part.declared_options for word, part in parts.items()}})
    set_options = tuple(chosen["model"]) if isinstance(the_model, type) else tuple(
        one.name for one in the_model.declared_options
        if the_model.options[one.name] != one.default)
    if model in (None, recipe.model):
        chosen["model"] = {**recipe.model_options, **chosen["model"]}
    # As the recipe has a solver, or else, where it is named, as its paper does.
    for word, is_named in (("solver", solver is not None), ("then", True)):
        if isinstance(part := parts.get(word), type) and issubclass(part, Solver):
            usual_options = recipe.solver_options.get(
                part.name, part.published if is_named else {})
            chosen[word] = {**usual_options, **chosen[word]}
    made = {word: with_options(word, part, chosen[word]) for word, part in parts.items()}
    of_problem = _of_problem(recipe, chosen["problem"], made["criterion"], made["solver"])
    own_run = recipe.refined and solver is None and not made["solver"].ends_by_itself
    of_search = resolve(SEARCH_OPTIONS, {"polish": own_run, **chosen["search"]})
    of_data = resolve(DATA_OPTIONS, chosen["data"])
    named = asked_roles(of_data["off"], of_data["role"])
    if of_data["roles"] != "file" and of_data["role"]:
        raise TermselError(f"the options role and roles={of_data['roles']} exclude each other",
                           hint="Leave one of them out; off goes with both.")
    if features is None:
        spec = names.taken("datasets", recipe.dataset if dataset is None else dataset)
        features = loaded(spec)
        source = f"{spec.name} (simulated)" if spec.simulated else spec.name
    features = with_roles(features, named)
    blank = to_leave_out(features) if made["model"].uses_height else ()
    features = with_roles(features, dict.fromkeys(blank, "off"))
    return Request(recipe, made["model"], made["criterion"], made["solver"], features,
                   printable(source or "given in Python"),
                   {"problem": of_problem, "data": of_data, "search": of_search},
                   made.get("then"), set_options, blank)


def loaded(spec: DatasetSpec) -> FeatureSet:
    """Return the features of a data set; an error names the plugin it is of."""
    with blamed(spec.load, "load"):
        features = spec.load()
    _require_type(spec.load, "load", features, FeatureSet)
    return features


def observe(request: Request, least: int = MIN_CONTROL) -> Observations:
    """Return the features, each in its role, with the CRS that the model is fitted in.

    Parameters
    ----------
    request : Request
    least : int
        Fewest control features.
    """
    recipe, criterion, of_data = request.recipe, request.criterion, request.options["data"]
    observations = assign_roles(
        request.features,
        control="both" if request.options["problem"].get("mixed") else recipe.control,
        how=of_data["roles"], fractions=(1.0, 0.0, 0.0) if all_control(request) else
        parsed_shares(of_data["fractions"], criterion.needs_check),
        rng=np.random.default_rng(of_data["split"]))
    if _check_as(request, observations) == "control":
        observations = check_as_control(observations)
    require_heights(request.model, _taking_part(observations))
    require_enough(observations, recipe, criterion, least)
    if of_data["fit_crs"] is not None:
        observations = with_fit_crs(of_data["fit_crs"], observations, request.model)
    return observations


def all_control(request: Request) -> bool:
    """Return whether the points are too few to give any away, and nobody asks for it."""
    of_data = request.options["data"]
    roles = [role for role in request.features.points.roles if role != "off"]
    return (len(roles) < FEW and not {"control", "check"} & set(roles)
            and request.recipe.control == "points"
            and not request.criterion.needs_check and of_data["roles"] == "file"
            and of_data["fractions"] == ALIKE)


def scale(request: Request, observations: Observations) -> tuple[Scaling, Inputs]:
    """Return the scaling of the control, and what a problem is made of in scaled coordinates."""
    scaling = scaling_of(observations.control)
    return scaling, Inputs(
        request.model.prepared(scaling, request.features.crs),
        scaling.features(observations.control), scaling.points(observations.check),
        scaling.image_scale, request.criterion, dict(request.options["problem"]),
        objectives_of(request.options["problem"].get("objectives"), request.criterion))


def build(request: Request, observations: Observations, scaling: Scaling,
          inputs: Inputs) -> Task:
    """Return the task: the recipe's problem, for a solver that can handle it."""
    with blamed(request.recipe.build, "build"):
        problem = request.recipe.build(inputs)
    _require_type(request.recipe.build, "build", problem, Problem)
    if isinstance(problem, ParameterProblem):
        _refuse_searched(request, problem)
    for solver in filter(None, (request.solver, request.then)):
        require_able(problem, solver, lambda: [
            entry.object for entry in registry().entries("solvers")])
    data = {**request.options["data"], "check_as": _check_as(request, observations)}
    return Task(request.recipe, problem, inputs.model, request.solver, request.criterion,
                observations, scaling, request.features, request.source,
                {**request.options, "problem": inputs.options, "data": data}, request.then,
                request.blank)


def _refuse_searched(request: Request, problem: ParameterProblem) -> None:
    """Refuse values for options of the model that the problem searches."""
    for name in problem.parameters:
        if name in request.set_options:
            raise TermselError(
                f"problem {request.recipe.name!r} searches the option {name!r} of model "
                f"{request.model.name!r}, so it cannot be given",
                hint="Remove the option, or choose another problem.")


def _require_type(function: Callable[..., Any], name: str, value: Any, wanted: type) -> None:
    """Refuse what a function of a plugin must not return."""
    what = of_type(value, wanted)
    if what is not None:
        raise wrong(function, name, what)


def _of_problem(recipe: Recipe, given: Mapping[str, Any], criterion: Criterion,
                solver: Solver) -> dict[str, Any]:
    """Return the options of a problem, those decided that depend on criterion and solver."""
    options = resolve(recipe.options, given)
    if solver.max_objectives > 1 and "objectives" in options:
        options["objectives"] = options["objectives"] or recipe.second
    if "max_share" in options and options["max_share"] is None:
        options["max_share"] = 1.0 if solver.uses_all else MAX_SHARE
    if options.get("steps") == "joint" and "then" in options:
        options["then"] = None
    if "recommend" in options:
        options["recommend"] = _rule(options["recommend"], criterion, solver)
    return options


def _check_as(request: Request, observations: Observations) -> str:
    """Return what check points are, where the option does not say: judges or control."""
    judging = request.criterion.needs_check or not len(observations.control.points)
    return request.options["data"]["check_as"] or ("judge" if judging else "control")


def _rule(asked: str | None, criterion: Criterion, solver: Solver) -> str:
    """Return the rule by which a member of a front is recommended."""
    if asked == "one-standard-error" and not criterion.is_rmse:
        raise TermselError(f"criterion {criterion.name!r} is no RMSE, so it has no standard error "
                           "to recommend a selection by",
                           hint="Choose --set recommend=knee or best, or --criterion check-rmse, "
                                "press or kfold, these with loss=squares.")
    return asked or ("one-standard-error" if solver.max_objectives > 1 and criterion.is_rmse
                     else "best")


def _taking_part(observations: Observations) -> FeatureSet:
    """Return all features that have a role, together."""
    control = observations.control
    points = (control.points, observations.check, observations.independent)
    return control.with_(points=Points(
        tuple(name for part in points for name in part.ids),
        np.concatenate([part.image for part in points]),
        np.concatenate([part.ground for part in points])))
