"""A problem made ready for a search: observe, scale, build."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from termsel.core.display import Glance
from termsel.core.errors import TermselError
from termsel.core.isolation.faults import blamed
from termsel.data.control import Control, carriers
from termsel.data.datasets import DatasetSpec
from termsel.data.features import FeatureSet
from termsel.data.lattices import lattice_of
from termsel.data.roles import Observations, check_as_control, parsed_shares
from termsel.data.roles import observe as assign_roles
from termsel.data.scaling import Scaling, scaling_of
from termsel.models.base import SensorModel, require_heights
from termsel.plugins.registry import registry
from termsel.runs.task.enough import require_enough
from termsel.runs.task.fit_crs import with_fit_crs
from termsel.runs.task.given import objectives_of
from termsel.runs.task.request import ALIKE, FILE, Request, Setup, require_type, split_of
from termsel.selection.criteria import Criterion
from termsel.selection.problems.base import Inputs, Problem
from termsel.selection.problems.constraints import without_heights
from termsel.selection.problems.parameters import ParameterProblem
from termsel.selection.problems.recipes import Recipe
from termsel.selection.solvers.base import Solver
from termsel.selection.solvers.search import require_able

MIN_CONTROL = 3

FEW = 12
"""Number of points without any role below which all are control for a search that needs no check
points: leave-one-out then tells the accuracy."""

MANY = 60
"""Number of points from which on the strategy auto sets independent points aside. Below, held-out
features tell the accuracy better than the few points that could be spared, and the choice would
miss these: without a quarter of 60 points the RMSE is 4 % higher, without a quarter of 12, 30 and
40 13, 6 and 9 % (docs/explanation/roles.md)."""

ALL_CONTROL, SPARED = "1:0:0", "3:3:2"
"""Shares of control, check and independent points below `MANY` points, and from there on."""


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Task(Glance, Setup):
    """A problem made ready for a search, with the setup that it is made of.

    Parameters
    ----------
    recipe, model, criterion, solver, read, features, source, options, then, set_options, blank
        As for `Setup`; the model is prepared for the features.
    problem : Problem
    observations : Observations
        The features, each in its role.
    scaling : Scaling
        That of the control.
    """

    problem: Problem
    observations: Observations
    scaling: Scaling

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
    return prepared(Request(
        problem=problem, features=features, dataset=dataset, source=source, model=model,
        solver=solver, criterion=criterion, options=options).setup())


def prepared(setup: Setup) -> Task:
    """Return the task of a setup."""
    setup = with_shares(setup)
    observations = observe(setup)
    return build(setup, observations, *scale(setup, observations))


def observe(setup: Setup, least: int = MIN_CONTROL) -> Observations:
    """Return the features, each in its role, in the CRS of the fit; at least so many are control.
    """
    setup = with_shares(setup)
    recipe = setup.recipe
    criterion = setup.criterion
    of_data = setup.options["data"]
    observations = assign_roles(
        setup.features,
        control="both" if setup.options["problem"].get("mixed") else recipe.control,
        split=split_of(of_data),
        fractions=parsed_shares(of_data["fractions"], criterion.needs_check),
        rng=np.random.default_rng(of_data["split"]))
    if _check_as(setup, observations) == "control":
        observations = check_as_control(observations)
    together = observations.together
    require_heights(setup.model, together.with_(
        points=together.points.rejoin(observations.independent)))
    require_enough(observations, recipe, criterion, setup.model, least)
    if of_data["fit_crs"] is not None:
        observations = with_fit_crs(of_data["fit_crs"], observations, setup.model)
    return observations


def with_shares(setup: Setup, *, auto: bool = False) -> Setup:
    """Return a setup with the shares of the roles, where the option does not give them.

    A search keeps check and independent points, which judge it. The strategy `auto` holds control
    out instead, and sets independent points aside only where there are `MANY`.
    """
    of_data = setup.options["data"]
    if of_data["fractions"] is not None:
        return setup
    shares = _usual_shares(setup, auto=auto)
    return replace(setup, options={**setup.options, "data": {**of_data, "fractions": shares}})


def _usual_shares(setup: Setup, *, auto: bool) -> str:
    roles = [role for role in setup.features.points.roles if role != "off"]
    points_are_control = setup.recipe.control == "points" or setup.options["problem"].get("mixed")
    if setup.criterion.needs_check or not points_are_control \
            or setup.options["data"]["roles"] != FILE:
        return ALIKE
    if auto and lattice_of(setup.features.points) is not None:
        return ALL_CONTROL  # its lines and columns are held out
    if auto:
        return SPARED if len(roles) >= MANY and "independent" not in roles else ALL_CONTROL
    return ALL_CONTROL if len(roles) < FEW and not {"control", "check"} & set(roles) \
        and setup.recipe.control == "points" else ALIKE


def scale(setup: Setup, observations: Observations) -> tuple[Scaling, Inputs]:
    """Return the scaling of the control, and what a problem is made of in scaled coordinates."""
    scaling = scaling_of(observations.control)
    model = setup.model.prepared(scaling, setup.features.crs)
    options = dict(setup.options["problem"])
    # Check points with relief do not help control without.
    if model.uses_height and (not observations.heights or carriers(
            Control(observations.control, scaling, False))):
        options |= without_heights(model.terms, options)
    return scaling, Inputs(
        model, scaling.features(observations.control), scaling.points(observations.check),
        scaling.image_scale, setup.criterion, options,
        objectives_of(options.get("objectives"), setup.criterion))


def build(setup: Setup, observations: Observations, scaling: Scaling,
          inputs: Inputs) -> Task:
    """Return the task: the recipe's problem, for a solver that can handle it.

    The setup may be that of another task.
    """
    # Shrunk are coefficients towards zero; of such a model 0 is no camera, and gave 65 px.
    if inputs.options.get("shrink") and inputs.model.start(inputs.control) is not None:
        raise TermselError(f"the model {inputs.model.name!r} is not linear in its terms, so its "
                           "coefficients cannot be shrunk",
                           hint="Leave out shrink=true, or choose another model.")
    with blamed(setup.recipe.build, "build"):
        problem = setup.recipe.build(inputs)
    require_type(setup.recipe.build, "build", problem, Problem)
    if isinstance(problem, ParameterProblem):
        _refuse_searched(setup, problem)
    for solver in filter(None, (setup.solver, setup.then)):
        require_able(problem, solver, lambda: [
            entry.object for entry in registry().entries("solvers")])
    data = {**setup.options["data"], "check_as": _check_as(setup, observations)}
    return Task(**{**vars(setup), "model": inputs.model, "options": {
        **setup.options, "problem": inputs.options, "data": data},
        "problem": problem, "observations": observations, "scaling": scaling})


def _refuse_searched(setup: Setup, problem: ParameterProblem) -> None:
    """Refuse values for options of the model that the problem searches."""
    for name in problem.parameters:
        if name in setup.set_options:
            raise TermselError(
                f"problem {setup.recipe.name!r} searches the option {name!r} of model "
                f"{setup.model.name!r}, so it cannot be given",
                hint="Remove the option, or choose another problem.")


def _check_as(setup: Setup, observations: Observations) -> str:
    """Return what check points are, where the option does not say: judges or control."""
    judging = setup.criterion.needs_check or not len(observations.control.points)
    return setup.options["data"]["check_as"] or ("judge" if judging else "control")
