"""A problem made ready for a search: observe, scale, build."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from termsel.criteria import Criterion
from termsel.errors import TermselError, unknown_name
from termsel.fits.diagnosis import orientation_spread
from termsel.measurements.features import FeatureSet, Points, no_points
from termsel.measurements.roles import Observations, observe, together
from termsel.measurements.scaling import Scaling, scaling_of
from termsel.models.base import SensorModel, require_heights
from termsel.options import Option, resolve
from termsel.plugins.registry import registry
from termsel.problems.base import Inputs, Problem
from termsel.problems.constraints import MAX_SHARE
from termsel.problems.recipes import Recipe
from termsel.runs.fit_crs import FIT_CRS, with_fit_crs
from termsel.solvers.base import Solver
from termsel.solvers.search import require_able

DATA_OPTIONS = (
    Option("roles", "file", "Roles of points: as in the file, with blank ones shared out by "
           "place; or shared out anew by place or at random.",
           choices=("file", "stratified", "random")),
    Option("fractions", "1:1:1", "Shares of control, check and independent points among those "
           "shared out."),
    Option("split", 0, "Seed of the sharing out of roles.", int, 0),
    Option("check_as", None, "What check points are: judges of each selection, or further control. "
           "By default judges; where points are the control and the criterion needs no check "
           "points, control.", choices=("judge", "control")),
    FIT_CRS,
)


MIN_CONTROL, MIN_CHECK = 3, 2


ALL_PARALLEL = 1e-4
"""Orientation spread below which control lines are taken for parallel: within half a degree."""


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
    criterion_type: type[Criterion] = names.get("criteria", criterion or recipe.criterion)
    solver_type = names.get("solvers", solver or recipe.solver)
    own = {**recipe.model_options} if model is None or model == recipe.model else {}
    declared = {
        "problem": recipe.options, "data": DATA_OPTIONS,
        "model": model_type.declared_options, "criterion": criterion_type.declared_options,
        "solver": solver_type.declared_options}
    _refuse_unknown(given, declared)
    chosen = {part: {o.name: given[o.name] for o in known if o.name in given}
              for part, known in declared.items()}
    of_problem = resolve(recipe.options, chosen["problem"])
    of_data = resolve(DATA_OPTIONS, chosen["data"])
    if solver_type.max_objectives > 1 and "objectives" in of_problem:
        of_problem["objectives"] = of_problem["objectives"] or recipe.second
    if "max_share" in of_problem and of_problem["max_share"] is None:
        of_problem["max_share"] = 1.0 if solver and solver_type.as_published else MAX_SHARE
    the_model = model_type(**{**own, **chosen["model"]})
    the_criterion = criterion_type(**chosen["criterion"])
    if "recommend" in of_problem:
        of_problem["recommend"] = _rule(of_problem["recommend"], the_criterion, solver_type)
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
    if of_data["check_as"] is None:
        judging = the_criterion.needs_check or not len(observations.control.points)
        of_data["check_as"] = "judge" if judging else "control"
    if of_data["check_as"] == "control":
        observations = replace(observations, control=together(observations), check=no_points())
    require_heights(the_model, _taking_part(observations))
    _require_enough(observations, recipe, the_criterion)
    if of_data["fit_crs"] is not None:
        features, observations = with_fit_crs(of_data["fit_crs"], features, observations,
                                              the_model)
    scaling = scaling_of(observations.control)
    the_model = the_model.prepared(scaling, features.crs)
    inputs = Inputs(the_model, scaling.features(observations.control),
                    scaling.points(observations.check), scaling.image_scale, the_criterion,
                    of_problem)
    the_problem = recipe.build(inputs)
    require_able(the_problem, the_solver,
                 [entry.object for entry in names.entries("solvers")])
    return Task(recipe, the_problem, the_model, the_solver, the_criterion, observations,
                scaling, features, source or "given in Python",
                {"problem": of_problem, "data": of_data})


def _rule(asked: str | None, criterion: Criterion, solver: type[Solver]) -> str:
    """Return the rule by which a member of a front is recommended."""
    if asked == "one-standard-error" and not criterion.is_rmse:
        raise TermselError(f"criterion {criterion.name!r} is no RMSE, so it has no standard error "
                           "to recommend a selection by",
                           hint="Choose --set recommend=knee or best, or --criterion check-rmse, "
                                "press or kfold, these with loss=squares.")
    return asked or ("one-standard-error" if solver.max_objectives > 1 and criterion.is_rmse
                     else "best")


def _refuse_unknown(given: Mapping[str, Any], declared: Mapping[str, Iterable[Option]]) -> None:
    known = {option.name for part in declared.values() for option in part}
    for key in given:
        if key not in known:
            raise unknown_name("option", key, known)


def _taking_part(observations: Observations) -> FeatureSet:
    """Return all features that have a role, together."""
    control = observations.control
    points = (control.points, observations.check, observations.independent)
    return control.with_(points=Points(
        tuple(name for part in points for name in part.ids),
        np.concatenate([part.image for part in points]),
        np.concatenate([part.ground for part in points])))


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
    if not np.ptp(control.image_vertices(), axis=0).any():
        raise TermselError("all control features have the same place in the image",
                           hint="Look whether the columns line and sample are what they say.")
    flat = np.ptp(control.ground_vertices()[:, :2], axis=0)
    spread = np.linalg.svd(control.ground_vertices()[:, :2]
                           - control.ground_vertices()[:, :2].mean(axis=0), compute_uv=False)
    if not flat.any() or spread[1] < 1e-6 * spread[0]:
        raise TermselError("all control features lie on one straight line on the ground",
                           hint="Control must spread over an area to fix a model.")
    if not len(control.points) and orientation_spread(control.lines) < ALL_PARALLEL:
        raise TermselError(
            "all control lines are parallel in the image: along them nothing is measured",
            hint="Add lines of another direction, or control points with --set mixed=true.")
