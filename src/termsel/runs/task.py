"""What a run is prepared from: the features in their roles, and the problem built of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from termsel.auto.auto import Auto
from termsel.core.arguments import explains_arguments
from termsel.core.display import Glance
from termsel.core.errors import TermselError, count_in_words, unknown_name_error
from termsel.core.isolation.faults import attribute_errors_to
from termsel.core.remedies import Remedy
from termsel.data.coordinates.crs import LOCAL, CrsLike, normalise, to_wgs84
from termsel.data.coordinates.height_units import FOOT, UNITS
from termsel.data.coordinates.places import lattice_of
from termsel.data.datasets import DatasetSpec
from termsel.data.features import FeatureSet, FloatArray
from termsel.data.fit_data import FitData, relief_carriers
from termsel.data.roles import Observations, check_as_control, parse_shares
from termsel.data.roles import observe as assign_roles
from termsel.data.rpc import Rpc
from termsel.data.scaling import Scaling, make_scaling
from termsel.fitting.figures import orientation_spread
from termsel.formats.rpc_files import with_rpc
from termsel.io.read import features_of
from termsel.models.base import SensorModel, require_heights
from termsel.models.image_part import ImagePart, recognise_part
from termsel.plugins.registry import registry
from termsel.runs.arguments import argument_meant
from termsel.runs.exported_rpc import refuse_makers, rpc_of_model
from termsel.runs.fit_crs import with_fit_crs, with_polar
from termsel.runs.map_projection import with_map_projection
from termsel.runs.request import (
    EQUAL_SHARES,
    FILE,
    Request,
    objectives_of,
    request_of,
    require_type,
    split_of,
)
from termsel.selection.criteria import Criterion
from termsel.selection.problems.base import Problem, ProblemData
from termsel.selection.problems.constraints import without_heights
from termsel.selection.problems.parameters import ParameterProblem
from termsel.selection.problems.recipes import Recipe, options_of
from termsel.selection.solvers.base import Solver
from termsel.selection.solvers.heuristics.yardsticks import AllTerms
from termsel.selection.solvers.search import require_able

# Whether the features of a run are enough for its problem.

MIN_CHECK = 2

ALL_PARALLEL = 1e-4
"""Orientation spread below which control lines are taken for parallel: within half a degree."""


def require_enough(observations: Observations, criterion: Criterion, model: SensorModel,
                   fewest: int, named_off: str | None = None) -> None:
    """Refuse data for a problem, unless there are enough features and they can determine a model.

    `fewest` is the fewest control features; `named_off` are ids that the option off leaves out.
    Raises TermselError for fewer, for too few selection points where the criterion needs them, and
    for a column that holds one number. Where more than one feature is needed, it is raised as well
    for control in one place, on one straight line of the ground, with x equal to y, or of lines
    that are all parallel.
    """
    control = observations.control
    check = observations.check
    if len(control) < fewest:
        noun = f"control {control.word.removesuffix('s')}"
        others = _others_in_words(observations)
        without_selection = ""
        if criterion.needs_check and len(observations.together) >= fewest:
            without_selection = (" Or choose by leave-one-out, without selection points: "
                                 f"{Remedy('criterion', 'press')}.")
        raise TermselError(
            f"{_count_of_control(control)}{others}; at least {count_in_words(fewest, noun)} "
            f"{'is' if fewest == 1 else 'are'} needed",
            hint=_remedy_for_few(observations, fewest, named_off)
                 + without_selection
                 + _offer_of_correction(observations, fewest, model))
    if criterion.needs_check and len(check) < MIN_CHECK:
        raise TermselError(
            f"{_too_few_in_words(len(check), 'selection point')} (role check), and a search by "
            f"{criterion.name} chooses by at least {MIN_CHECK}",
            hint="Give more points the role check. Or choose by leave-one-out, which needs no "
                 f"selection points: {Remedy('criterion', 'press')}.")
    _refuse_one_number(observations)
    # The geometry of control matters where nothing else determines the model.
    if fewest == 1:
        return  # what is known of the image makes up for what they do not determine
    if not np.ptp(control.image_vertices(), axis=0).any():
        raise TermselError(f"all control {control.word} have the same place in the image",
                           hint="Check that the columns line and sample hold image coordinates.")
    if not np.ptp(control.ground_vertices()[:, :2], axis=0).any():
        raise TermselError(
            f"all {len(control)} control {control.word} have the same place on the ground",
            hint="Check that the columns x and y hold the position of each of them.")
    xy = control.ground_vertices()[:, :2]
    if len(control) > 2 and (xy[:, 0] == xy[:, 1]).all():
        raise TermselError("x and y are the same at all points", column="y",
                           hint="Is that the right column? Name the one that holds it: --columns "
                                "y=NAME.")
    # The singular values of centred plan coordinates: the second is 0 on one straight line.
    spread = np.linalg.svd(control.ground_vertices()[:, :2]
                           - control.ground_vertices()[:, :2].mean(axis=0), compute_uv=False)
    if len(control) > 2 and spread[1] < 1e-6 * spread[0]:
        raise TermselError(f"all control {control.word} lie on one straight line on the ground",
                           hint="Add control away from that line: a model needs an area.")
    # Lines measure across themselves alone.
    if not len(control.points) and orientation_spread(control.lines) < ALL_PARALLEL:
        raise TermselError(
            "all control lines are parallel in the image, so nothing is measured along them",
            hint="Add lines of another direction, or control points with --set mixed=true.")


_ALL_ALIKE = 5
"""Points from which on the same line or sample at all of them is that of a wrong column."""


def _refuse_one_number(observations: Observations) -> None:
    """Raise TermselError where all points have the same line, or the same sample."""
    points = observations.together.points
    image = points.image
    if len(points) < _ALL_ALIKE:
        return
    is_one_number = np.ptp(image, axis=0) == 0.0
    if is_one_number.sum() != 1:  # both: all are at one place, which is said by itself
        return
    axis = int(np.argmax(is_one_number))
    name = ("line", "sample")[axis]
    raise TermselError(
        f"all points have {name} {image[0, axis]:g}", column=name,
        hint=f"Is that the right column? Name the one that holds it: --columns {name}=NAME.")


def _count_of_control(control: FeatureSet) -> str:
    """Return how many control features there are, such as "1 control point"."""
    noun = control.word.removesuffix("s")
    return _too_few_in_words(len(control), f"control {noun}")


def _others_in_words(observations: Observations) -> str:
    """Return how many points are not control, such as " beside 1 selection point"; "" if none."""
    kinds = ((observations.check, "selection point"),
             (observations.independent, "independent check point"))
    others = [count_in_words(len(features), noun) for features, noun in kinds if len(features)]
    if observations.off:
        noun = observations.features.word.removesuffix("s")
        others.append(f"{count_in_words(len(observations.off), noun)} that {OFF_IN_WORDS}")
    return f" beside {' and '.join(others)}" if others else ""


OFF_IN_WORDS = "take no part (role off, or switched off in QGIS)"
"""What points of the role off do, and why."""


def _remedy_for_few(observations: Observations, fewest: int, named_off: str | None) -> str:
    """Return what helps against too few control points or lines: those that have another role.

    `fewest` are needed, and `named_off` are the ids that --off names, None for none.
    """
    total = len(observations.features)
    if total < fewest:
        return "Measure more."
    # A role given besides would contradict the option.
    if named_off and observations.off:
        return f"Leave fewer out: --off is {named_off}."
    if len(observations.off) >= fewest:
        return ("Switch points on in the file, such as in QGIS's georeferencer, or give them the "
                "role control: --role ID=control.")
    return ("Give more points the role control, in the column role or by --role ID=control, or "
            "measure more.")


def _offer_of_correction(observations: Observations, fewest: int, model: SensorModel) -> str:
    """Return that fewer points correct an RPC, if one may be given, or is."""
    points = observations.features.points
    # An RPC relates an image to the Earth.
    is_on_earth = len(points) > 0 and normalise(observations.features.crs) != LOCAL
    if "rpc" in model.options or (is_on_earth and len(observations.features) < fewest):
        return (f" Or give the vendor's RPC, {Remedy('rpc', 'FILE')}, and no model, problem or "
                "solver: one point or more corrects it.")
    return ""


def _too_few_in_words(number: int, noun: str) -> str:
    """Return a number with its noun, as too few: "only 2 points", or "no points"."""
    return f"only {count_in_words(number, noun)}" if number else f"no {noun}s"


MIN_CONTROL = 3

MIN_POINTS_TO_DIVIDE = 12
"""Number of points without any role below which all are control for a search that needs no check
points: leave-one-out then shows the accuracy."""

MANY = 60
"""Number of points from which on the strategy auto sets independent points aside. Below, held-out
features show the accuracy better than the few points that could be spared, and the choice would
miss these: without a quarter of 60 points the RMSE is 4 % higher, without a quarter of 12, 30 and
40 13, 6 and 9 % (docs/explanation/roles.md)."""

ALL_CONTROL, SPARED = "1:0:0", "3:3:2"
"""Shares of control, selection and independent check points below `MANY` points, and above."""


@dataclass(frozen=True, eq=False, repr=False)
class Task(Glance):
    """What a run is prepared from: what is asked, and the features in their roles.

    Parameters
    ----------
    request : Request
    observations : Observations
        The features, each in its role.
    narrowed : Problem, optional
        The problem, where it is another than the request's recipe builds: with genes held.
    note_on_projection : str
        In which projection methods are fitted, where nobody asked for it; else "".

    Examples
    --------
    >>> import termsel
    >>> task = termsel.prepare("poly-terms")
    >>> task.problem.genome.size
    30
    """

    request: Request
    observations: Observations
    narrowed: Problem | None = None
    note_on_projection: str = ""

    @property
    def recipe(self) -> Recipe:
        """The recipe of the problem."""
        return self.request.recipe

    @property
    def solver(self) -> Solver:
        """The solver that is asked for."""
        return self.request.solver

    @property
    def criterion(self) -> Criterion:
        """The criterion that is asked for."""
        return self.request.criterion

    @property
    def then(self) -> Solver | None:
        """The solver of the second of two steps; None if there is one step."""
        return self.request.then

    @property
    def source(self) -> str:
        """Where the features come from."""
        return self.request.source

    @property
    def features(self) -> FeatureSet:
        """The features with the roles asked for."""
        return self.request.features

    @cached_property
    def scaling(self) -> Scaling:
        """The scaling of the control."""
        return make_scaling(self.observations.control)

    @cached_property
    def model(self) -> SensorModel:
        """The model, prepared for the features."""
        return self.request.model.prepared(self.scaling, self.features.crs)

    @cached_property
    def inputs(self) -> ProblemData:
        """The data of the problem, in scaled coordinates."""
        control = self.observations.control
        options = dict(self.request.options["problem"])
        # Check points with relief do not help control without.
        if self.model.uses_height and (not self.observations.heights or relief_carriers(
                FitData(control, self.scaling, False))):
            options |= without_heights(self.model.terms, options)
        return ProblemData(
            model=self.model, control=self.scaling.features(control),
            check=self.scaling.points(self.observations.check), pixels=self.scaling.image_scale,
            criterion=self.request.criterion, options=options,
            objectives=objectives_of(options.get("objectives"), self.request.criterion))

    @cached_property
    def problem(self) -> Problem:
        """The recipe's problem.

        Raises
        ------
        TermselError
            If the recipe fails, or the solver cannot handle its problem.
        """
        return self.narrowed or _build_problem(self.request, self.inputs)

    @cached_property
    def options(self) -> Mapping[str, Mapping[str, Any]]:
        """Options of problem, data and search, those decided that depend on the features."""
        data = {**self.request.options["data"],
                "check_as": _check_as(self.request, self.observations)}
        return {**self.request.options, "problem": self.inputs.options, "data": data}

    def _glance(self) -> tuple[str, Mapping[str, str]]:
        method = f"{self.model.name}, {self.solver.name}, {self.criterion.name}"
        return f"Task: {self.recipe.name}", {"method": method, "data": self.request.source}


@explains_arguments(argument_meant)
def prepare(
    problem: str | Recipe,
    *,
    features: Any = None,
    crs: CrsLike | None = None,
    columns: str | Mapping[str, Any] | None = None,
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
    features : FeatureSet, path-like or table, optional
        Measured features, or what `termsel.read` reads them from; without them those of `dataset`,
        or of the recipe's data set.
    crs, columns : optional
        As for `termsel.read`, where features are read.
    dataset : str or DatasetSpec, optional
        A data set or its name.
    source : str, optional
        Where `features` come from, for the record.
    model, solver, criterion : str, class or instance, optional
        The recipe's own by default; with the option ``objectives`` the solver "nsga2". Instances
        have their options already.
    options : mapping, optional
        Options of problem, data, model, criterion and solver together, as with ``--set``.

    Returns
    -------
    Task
        The problem with its data, model, criterion and solver, ready for a search.

    Raises
    ------
    TermselError
        For unknown names or options, and for data the problem cannot be run on.

    Examples
    --------
    >>> import termsel
    >>> task = termsel.prepare("poly-terms", options={"degree": 3})
    >>> task.problem.genome.size, task.problem.objectives
    (20, ('check-rmse',))
    """
    features, source = find_features(features, source, crs, columns)
    return task_of(request_of(
        problem, features=features, dataset=dataset, source=source, model=model,
        solver=solver, criterion=criterion, options=options))


def find_features(features: Any, source: str | None, crs: CrsLike | None,
                  columns: str | Mapping[str, Any] | None, rpc: Rpc | Path | str | None = None,
                  ) -> tuple[FeatureSet | None, str | None]:
    """Return the features given or read, with their RPC, and the name of where they come from.

    That name is `source`, or else the file; it is None if neither is known. The features are None
    if none are given. Raises TermselError if only crs, columns or rpc are given.
    """
    if features is None:
        if crs is not None or columns is not None or rpc is not None:
            raise TermselError("crs, columns and rpc are for features that are given",
                               hint="Give features, such as the name of a file.")
        return None, source
    file = str(features) if isinstance(features, str | Path) else None
    read = features_of(features, crs, columns)
    return read if rpc is None else with_rpc(read, rpc), source or file


def task_of(request: Request) -> Task:
    """Return the task of a request, its problem built.

    Raises TermselError if the problem cannot be built from the features.
    """
    # A problem is built at once, so that what is wrong is said before a search begins.
    request = with_shares(request)
    task = Task(request, observe(request))
    _ = task.problem
    return task


def with_problem_built(task: Task) -> Task:
    """Return a task after its problem has been built, whose errors are raised here."""
    _ = task.problem
    return task


def observe(request: Request, fewest: int = MIN_CONTROL) -> Observations:
    """Return the features, each in its role, in the CRS of the fit.

    Blank roles are assigned by place. Raises TermselError if fewer than `fewest` are control, if a
    model lacks heights, if the RPC was made from these points, and as `with_fit_crs` does.
    """
    request = with_shares(request)
    recipe = request.recipe
    # Roles of the file first; blank ones are assigned by place, with the seed of the option.
    criterion = request.criterion
    of_data = request.options["data"]
    observations = assign_roles(
        request.features,
        control="both" if request.options["problem"].get("mixed") else recipe.control,
        split=split_of(of_data),
        fractions=parse_shares(of_data["fractions"], criterion.needs_check),
        rng=np.random.default_rng(of_data["split"]))
    rpc = request.features.rpc or rpc_of_model(request.model)
    if rpc is not None:
        refuse_makers(rpc, observations)
    # Where no criterion needs judges, selection points are control as well.
    if _check_as(request, observations) == "control":
        observations = check_as_control(observations)
    features = observations.together
    # Independent points need heights, too: the model must see them in the end.
    require_heights(request.model, features.with_(
        points=features.points.join_unchecked(observations.independent)))
    require_enough(observations, criterion, request.model, fewest, of_data["off"])
    if of_data["fit_crs"] is not None:
        observations = with_fit_crs(of_data["fit_crs"], observations, request.model)
    return observations


def with_shares(request: Request, *, auto: bool = False) -> Request:
    """Return a request with the shares of the roles, where the option does not give them.

    A search keeps selection and independent check points, which judge it. The strategy `auto`
    holds control out instead, and sets independent points aside only where there are `MANY`.
    """
    of_data = request.options["data"]
    if of_data["fractions"] is not None:
        return request
    # Points that are off take no part, nor do they count.
    roles = [role for role in request.features.points.roles if role != "off"]
    points_are_control = (request.recipe.control == "points"
                          or request.options["problem"].get("mixed"))
    has_few = len(roles) < MIN_POINTS_TO_DIVIDE and not {"control", "check"} & set(roles)
    can_hold_out = (points_are_control and of_data["roles"] == FILE
                    and not request.criterion.needs_check)
    if not can_hold_out:
        # A search that judges by selection points needs a third for these, a third for the verdict.
        shares = EQUAL_SHARES
    elif auto and lattice_of(request.features) is not None:
        shares = ALL_CONTROL  # whole lines and columns of a lattice are held out
    elif auto:
        shares = SPARED if len(roles) >= MANY and "independent" not in roles else ALL_CONTROL
    else:
        shares = ALL_CONTROL if has_few and request.recipe.control == "points" else EQUAL_SHARES
    return replace(request, options={**request.options, "data": {**of_data, "fractions": shares}})


def _build_problem(request: Request, inputs: ProblemData) -> Problem:
    """Return the recipe's problem, for solvers that can handle it.

    Raises TermselError where coefficients of a model that is not linear are to be shrunk, for
    options that the problem does not have, and for solvers that cannot handle it; PluginFault where
    the recipe builds no problem.
    """
    # Shrunk are coefficients towards zero; of such a model 0 is no camera, and gave 65 px.
    if inputs.options.get("shrink") and inputs.model.start(inputs.control) is not None:
        raise TermselError(f"the model {inputs.model.name!r} is not linear in its terms, so its "
                           "coefficients cannot be shrunk",
                           hint="Leave out shrink=true, or choose another model.")
    build = request.recipe.build
    with attribute_errors_to(build, "build"):
        problem = build(inputs)
    require_type(build, "build", problem, Problem)
    _refuse_foreign(request, problem)
    # A value given for an option that is searched would be overwritten in silence.
    if isinstance(problem, ParameterProblem):
        _refuse_searched(request, problem)
    # Both steps search the same problem. Of several objectives there are no two steps, which the
    # search says; whoever searches the problem otherwise needs none.
    then = request.then if len(problem.objectives) == 1 else None
    for solver in filter(None, (request.solver, then)):
        require_able(problem, solver, lambda: [
            entry.object for entry in registry().entries("solvers")])
    return problem


def _refuse_foreign(request: Request, problem: Problem) -> None:
    """Raise TermselError for options of other problems, which the recipe does not declare."""
    declared_options = options_of(problem)
    for name in request.undeclared:
        if name not in declared_options:
            raise unknown_name_error("option", name, {
                *declared_options, *(option.name for option in request.recipe.options)})


def _refuse_searched(request: Request, problem: ParameterProblem) -> None:
    """Raise TermselError for values for options of the model that the problem searches."""
    for name in problem.parameters:
        if name in request.set_options:
            raise TermselError(
                f"problem {request.recipe.name!r} searches the option {name!r} of model "
                f"{request.model.name!r}, so it cannot be given",
                hint="Remove the option, or choose another problem.")


def _check_as(request: Request, observations: Observations) -> str:
    """Return the use of selection points, "judge" or "control": as the option says, or as needed.
    """
    judging = request.criterion.needs_check or not len(observations.control.points)
    return request.options["data"]["check_as"] or ("judge" if judging else "control")


# The RPC that is given with the features: of which image it is, and whether it can be used.

_NEARER = 0.5
"""Part of the distance to the measured places that feet must leave."""


def part_of_rpc(control: FeatureSet) -> ImagePart | None:
    """Return which part of its RPC's image the image of control is; None if it is the whole.

    None also without an RPC or a CRS, and where heights are outside the range of the RPC, which
    moves the points. Raises TermselError if the heights of control refer to another surface than
    the ellipsoid and PROJ cannot convert them, and if they seem to be feet.
    """
    rpc = control.rpc
    if rpc is None or normalise(control.crs) == LOCAL:
        return None
    # Heights that are not known say nothing of the place in the RPC.
    points = control.points.take(np.isfinite(control.points.ground).all(axis=1))
    try:
        positions = to_wgs84(control.crs)(points.ground)
    except TermselError as error:
        raise TermselError(f"the RPC takes ellipsoidal heights, and {error.what}",
                           hint=error.hint) from error
    # Before the part is recognised: wrong units look like another part.
    _refuse_feet(rpc, positions, points.image)
    # Wrong heights move the points, which would look like another part, too.
    if rpc.heights_outside(positions[:, 2]):
        return None
    with np.errstate(all="ignore"):
        return recognise_part(rpc.project(positions), points.image)


def _refuse_feet(rpc: Rpc, positions: FloatArray, image: FloatArray) -> None:
    """Raise TermselError for heights that are feet, as the RPC shows.

    `positions` (n, 3) are longitude, latitude and height, and `image` (n, 2) the points as
    measured. The heights must be outside the range of the RPC as metres, inside it as feet, and the
    RPC must see the points much nearer to where they were measured then. As metres they move the
    points, and another part of the image would seem to explain that.
    """
    height_doubt = rpc.heights_outside(positions[:, 2])
    if not height_doubt:
        return
    from_feet = positions * [1.0, 1.0, UNITS[FOOT]]
    if abs(np.median(from_feet[:, 2]) - rpc.ground_offset[2]) > rpc.ground_scale[2]:
        return
    with np.errstate(all="ignore"):
        distances = [np.linalg.norm(rpc.project(ground) - image, axis=1)
                     for ground in (positions, from_feet)]
        distance_as_metres, distance_as_feet = (float(np.nanmedian(lengths))
                                                for lengths in distances)
    # Feet must explain at least half of the distance, or something else is wrong.
    if distance_as_feet < distance_as_metres * _NEARER:
        raise TermselError(
            f"{height_doubt}. As feet they are inside, and the RPC sees the points "
            f"{distance_as_feet:,.0f} px from where they were measured, in place of "
            f"{distance_as_metres:,.0f} px",
            hint="State the unit of z: --set z_unit=ft (or us-ft).")


def with_part(request: Request, image_part: ImagePart) -> Request:
    """Return a request whose RPC is that of the part."""
    rpc = request.features.rpc
    assert rpc is not None
    features = replace(request.features, rpc=image_part.rpc(rpc))
    return replace(request, features=features, rpc_part=image_part)


# The task of a method that needs no search: all control and selection points, in their roles.

LEAST = 2
"""Control points without which there is no answer."""


def request_of_method(problem: str | Recipe, *, options: Any = None, **arguments: Any) -> Request:
    """Return the request where a method answers a problem, in place of its search.

    `arguments` are features, data set, source and model, as for `request_of`. The criterion needs
    no selection points, as the method is fitted to them as to control, and yet shows their figures;
    points go together with lines.

    Raises
    ------
    TermselError
        As `request_of`.
    """
    options = {"check_as": "judge", **(options or {})}
    if registry().resolve("problems", problem).control == "lines":
        options["mixed"] = True
    request = request_of(problem, **{
        **arguments, "criterion": "press", "solver": AllTerms, "options": options})
    is_named = arguments.get("model") is not None
    if request.recipe.search_first and not is_named and request.features.without_height():
        # The model of the search is not asked for, so that it asks for no heights.
        request = replace(request, model=registry().get("models", "poly2d")())
    return with_shares(request, auto=True)


def task_of_method(request: Request, auto: Auto) -> Task:
    """Return the task of a method: features in their roles, and the part of an image an RPC is of.

    Parameters
    ----------
    request : Request
        As `request_of_method` returns it.
    auto : Auto
        The choice among the methods that are to be fitted.

    Raises
    ------
    TermselError
        If the features are too few, or their heights not those of the RPC.
    """
    # One feature is enough where something is known of the image.
    features = request.features
    fewest = LEAST if features.rpc is None else 1
    # Independent points must not decide whether the others are enough.
    in_use = np.array([role not in ("independent", "off") for role in features.points.roles]
                      + [True] * len(features.lines.features), dtype=bool)
    if features.rpc is None and 0 < in_use.sum() < LEAST:
        fewest = min(LEAST, auto.fewest(FitData.of(features.take(in_use))))
    observations = observe(request, fewest)
    # The image may be a part, or a coarser copy, of that of its RPC, as control shows; roles are
    # assigned again then, as the RPC has moved.
    image_part = part_of_rpc(observations.together)
    if image_part is not None:
        request = with_part(request, image_part)
        observations = observe(request, fewest)
    if request.options["data"]["fit_crs"] is not None:
        return Task(request, observations)
    observations, note = with_map_projection(with_polar(observations), auto)
    return Task(request, observations, note_on_projection=note)


def require_alone(words: Sequence[str]) -> None:
    """Raise TermselError if parts or options of a search are given beside a method, in words.

    The message is about the first of them, such as "model" or "a budget".
    """
    if words and words[0] == "model":
        raise TermselError("a method brings its own model, so that both exclude each other",
                           hint=f"Leave out {Remedy('model')}, or {Remedy('method')}.")
    if words:
        raise TermselError(f"a method is fitted without a search, and {words[0]} is for a search",
                           hint=f"To fit the method leave out {words[0]}. To search leave out the "
                                "method.")
