"""What is asked of a run: one value, from the command line, Python and studies."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

import numpy as np
from msgspec import json

from termsel.auto.auto import Auto
from termsel.auto.function import FunctionMethod
from termsel.auto.memory import Memory
from termsel.auto.named_model import named_model
from termsel.core.errors import TermselError, count_in_words, first_names_in_words, make_printable
from termsel.core.isolation.arrays import difference_from_type
from termsel.core.isolation.faults import attribute_errors_to, fault_of_method
from termsel.core.options import SEED, Configurable, Option, options_by_part, resolve
from termsel.core.remedies import Remedy
from termsel.data.datasets import DatasetSpec
from termsel.data.features import FeatureSet
from termsel.data.fit_data import FitData, relief_carriers
from termsel.data.roles import Split, asked_roles, with_roles
from termsel.fitting.method import Method
from termsel.models.base import SensorModel
from termsel.models.image_part import ImagePart
from termsel.models.interpolating import Interpolating
from termsel.plugins.kinds import KINDS
from termsel.plugins.registry import registry
from termsel.runs.fit_crs import FIT_CRS
from termsel.selection.criteria import Criterion
from termsel.selection.problems.constraints import MAX_SHARE, split_names
from termsel.selection.problems.objectives import Objective
from termsel.selection.problems.recipes import OBJECTIVES, Recipe, undeclared_options
from termsel.selection.solvers.base import Solver
from termsel.selection.solvers.budget import SEARCH_OPTIONS

log = logging.getLogger(__name__)

# What a run is given: parts by their class or as an instance, objectives by their names.

def auto_of(method: str | Method | Callable[[FeatureSet], Any] | None,
            memory: Memory | None = None) -> Auto:
    """Return the choice by a method: its name, a Method or a function; by default among all.

    Raises TermselError for anything else, and for an unknown name.
    """
    if method is None or method == "auto":
        return auto_of_all(memory)
    if isinstance(method, Auto):
        return method
    # A plain function gets its own name in tables.
    if callable(method) and not isinstance(method, Method | type):
        name = getattr(method, "__name__", "function")
        method = FunctionMethod(name, f"the function {name}", function=method)
    if not isinstance(method, str | Method):
        raise TermselError(f"{method!r:.60} is no method",
                           hint="Give the name of one (termsel list methods), or a termsel.Method.")
    methods = (registry().get("methods", method) if isinstance(method, str) else method,)
    return Auto(methods=methods, memory=memory or Memory())


def auto_of_all(memory: Memory | None = None) -> Auto:
    """Return the choice among all methods but those on request.

    Of two with one name it takes termsel's own, or the first.
    """
    methods = tuple(entry.object for entry in registry().entries("methods")
                    if entry.name == entry.object.name and not entry.object.on_request)
    return Auto(methods=methods, memory=memory or Memory())


def class_of(component: type[Configurable] | Configurable) -> type[Configurable]:
    """Return a class, or that of an instance."""
    return component if isinstance(component, type) else type(component)


def with_options(role: str, component: type[Configurable] | Configurable,
                 options: Mapping[str, Any]) -> Any:
    """Return an instance of a class with its options, or the instance that is given.

    `role`, such as "model", names it in messages. Raises TermselError for unknown options, and for
    any if an instance is given.
    """
    # A class gets the options; an instance has been made with its own.
    if isinstance(component, type):
        try:
            return component(**options)
        except TermselError as error:
            error.name = error.name or str(component.name)
            raise
    if options:
        raise TermselError(f"option {next(iter(options))!r} is for the {role} {component.name!r}, "
                           "which has its options already",
                           hint=f"Give them with the name or the class of the {role}.",
                           name=next(iter(options)))
    return component


def second_solver(recipe: Recipe, settings: Mapping[str, Any]) -> Any:
    """Return the solver of the second step of a search, as asked for, or else the problem's.

    Returns None where there is no second step, and where it has no solver of its own. `settings`
    are the options of all parts as the user gave them. Raises TermselError for a second solver, or
    options of one, where there is no second step, or none with a solver of its own.
    """
    defaults = {option.name: option.default
                for option in (*recipe.options, *undeclared_options(recipe))}
    second_solver_keys = [key for key in settings if key.startswith("then.")]
    stated = next((settings[key] for key in ("then", "problem.then") if key in settings), None)
    if "then" not in defaults:
        if stated is not None or second_solver_keys:
            raise TermselError(
                f"problem {recipe.name!r} has no steps, so no second step has a solver (--then)",
                hint="Leave it out, or choose a problem of terms and features, such as "
                     "owdis-lines-terms.")
        return None
    # A key is plain, or has the name of its part in front: steps, problem.steps.
    steps = next((settings[key] for key in ("steps", "problem.steps") if key in settings),
                 defaults.get("steps"))
    if steps == "joint":
        if stated is not None or second_solver_keys:
            raise TermselError(
                f"{second_solver_keys[0] if stated is None else '--then'} is for the solver of the "
                "second of two steps, and steps=joint has one",
                hint="Add --set steps=features-first or --set steps=terms-first.")
        return None
    # None where the second step has the solver of the first.
    solver = defaults["then"] if stated is None else stated
    if second_solver_keys and solver is None:
        raise TermselError(f"{second_solver_keys[0]} is for the solver of the second step, and "
                           "--then names none",
                           hint=f"Add {Remedy('then', 'NAME')}, such as {Remedy('then', 'pso')}.")
    return solver


def objectives_of(names_listed: str | None, criterion: Criterion) -> tuple[Objective, ...]:
    """Return the objectives that an option names, each once, without the criterion.

    The names are separated by commas; one that no objective has is refused.
    """
    # The criterion is the first objective already.
    names = [name for name in dict.fromkeys(split_names(names_listed)) if name != criterion.name]
    return tuple(registry().get("objectives", name) for name in names)


# Features without a height among others that have one: left out of models that use heights.

def to_leave_out(features: FeatureSet) -> tuple[str, ...]:
    """Return the ids of features without a height, if a model of heights is possible without them.

    Empty if all features have heights, if most have none, or if the image shows no effect of the
    heights. Features that are off take no part, and independent points do not decide.
    """
    off = {name for name, role in zip(features.points.ids, features.points.roles, strict=True)
           if role == "off"}
    missing = [name for name in features.without_height() if name not in off]
    if not missing:
        return ()
    # What remains must show what a height does, or leaving others out gains nothing.
    with_heights = features.take(~np.isin(features.ids, [*missing, *off]))
    # Independent points must not decide what is fitted.
    deciding = with_heights.with_(points=with_heights.points.take(
        [role != "independent" for role in with_heights.points.roles]))
    are_most_known = len(with_heights) > len(missing) and len(deciding) > 0
    if are_most_known and not relief_carriers(FitData.of(deciding, heights=False)):
        return tuple(missing)
    return ()


def note_on_blank(ids: Sequence[str], features: FeatureSet) -> str:
    """Return the note on features, of those as read, that were left out for want of a height."""
    named = first_names_in_words(ids)
    is_one = len(ids) == 1
    takes, heights, them = ("takes", "its height", "it") if is_one else (
        "take", "their heights", "them")
    return (f"{count_in_words(len(ids), features.word[:-1])} without a height {takes} no part, as "
            f"the model uses heights: {named}. Give {heights}, or take {them} from a raster "
            f"({Remedy('dem', 'FILE')}).")


FILE = "file"
"""The roles of the file, in place of a split."""

EQUAL_SHARES = "1:1:1"
"""Shares of control, selection and independent check points for a search."""

SEVERAL_OBJECTIVES = "nsga2"
"""The solver where several objectives are asked for and no solver is."""

DATA_OPTIONS = (
    Option("roles", FILE, "Roles of points: those of the file, with blank ones assigned by "
           "place; or all assigned by a split: stratified (by place), random, or one of a plugin "
           "(termsel list splits)."),
    Option("off", None, "Ids of features to leave out, with commas between them (--off)."),
    Option("role", None, "Roles of single points, whatever the file says, as ID=ROLE with commas "
           "between them (--role)."),
    Option("fractions", None, "Shares of control, selection and independent check points among "
           "those that are assigned a role, such as 2:1:1. By default 1:1:1; the strategy auto "
           "makes all control below 60 points, and takes 3:3:2 from there."),
    Option("split", 0, "Seed by which roles are assigned.", int, 0, SEED),
    Option("check_as", None, "What becomes of selection points: judge compares selections by them, "
           "control fits the model to them, too. By default judge; where points are the control "
           "and the criterion needs no selection points, control.", choices=("judge", "control")),
    Option("tested", None, "Whether blunders among control and selection points were looked for "
           "before, as in a block of images: then they are not here.", bool),
    FIT_CRS,
)

@dataclass(frozen=True, eq=False)
class Request:
    """What is asked of a run: every name resolved, every option checked, the features read.

    Parameters
    ----------
    recipe : Recipe
        Of the problem.
    model, criterion, solver : SensorModel, Criterion, Solver
    read : FeatureSet
        The features as read.
    features : FeatureSet
        With the roles asked for, all together; without lines that are left out.
    source : str
        Where the features come from, for the record.
    options : mapping
        By part: problem, data and search.
    then : Solver, optional
        Of the second of two steps, if it is another one.
    set_options : tuple of str
        Names of the options of the model that are given.
    undeclared : tuple of str
        Names of given options that the recipe does not declare: its problem has to.
    blank : tuple of str
        Ids of features that are left out as they have no height.
    rpc_part : ImagePart, optional
        What the image is of that of the RPC, as control shows.
    """

    recipe: Recipe
    model: SensorModel
    criterion: Criterion
    solver: Solver
    read: FeatureSet
    features: FeatureSet
    source: str
    options: Mapping[str, Mapping[str, Any]]
    then: Solver | None = None
    set_options: tuple[str, ...] = ()
    blank: tuple[str, ...] = ()
    rpc_part: ImagePart | None = None
    undeclared: tuple[str, ...] = ()


def method_words(model: Any = None, solver: Any = None, criterion: Any = None,
                 options: Mapping[str, Any] | None = None) -> list[str]:
    """Return the words for parts and options of a method, which "auto" would choose itself.

    They are those that the user gave, such as "model" or "the option degree"; [] without any.
    """
    # Plain, or with the part they are of before a dot.
    of_data = {option.name for option in DATA_OPTIONS}
    of_data |= {f"data.{name}" for name in of_data}
    named = [role for role, component in (
        ("model", model), ("solver", solver), ("criterion", criterion)) if component]
    return [*named, *(f"the option {key}" for key in options or () if key not in of_data)]


def is_model_alone(words: Sequence[str], model: Any, options: Mapping[str, Any] | None) -> bool:
    """Return whether a model is all that is asked for of a method, with options of its own.

    `words` are those of `method_words` and others for parts of a search.
    """
    if model is None:
        return False
    model_class = class_of(registry().resolve("models", model))
    of_model = {option.name for option in model_class.declared_options}
    of_model |= {f"model.{name}" for name in of_model}
    return set(words) <= {"model", *(f"the option {key}" for key in options or ()
                                     if key in of_model)}


def method_of_model(request: Request) -> Method:
    """Return the method that fits all terms of the model of a request."""
    return named_model(request.model, request.set_options)


def request_of(
    problem: str | Recipe | None,
    *,
    features: FeatureSet | None = None,
    dataset: str | DatasetSpec | None = None,
    source: str | None = None,
    model: str | type[SensorModel] | SensorModel | None = None,
    solver: str | type[Solver] | Solver | None = None,
    criterion: str | type[Criterion] | Criterion | None = None,
    options: Mapping[str, Any] | None = None,
) -> Request:
    """Return the request that the arguments of `termsel.prepare` make.

    Parts are given by name, as classes or as instances; None stands for what the problem has by
    default. Raises TermselError for unknown names and options, and for options that exclude each
    other.
    """
    names = registry()
    settings = options or {}
    recipe: Recipe = names.resolve("problems", problem)
    # 1. Which model, criterion and solver: those named, else the problem's.
    components = _named_parts(recipe, model, solver, criterion, settings)
    # 2. Whose option each setting is; unknown ones are refused here.
    by_parts = _options_by_parts(recipe, components, settings)
    model_part = components["model"]
    set_options = tuple(by_parts["model"]) if isinstance(model_part, type) else tuple(
        option.name for option in model_part.declared_options
        if model_part.options[option.name] != option.default)
    # 3. Instances, with what the problem has by default.
    usual = _usual_options(recipe, components, model, features)
    instances = {}
    for role, component in components.items():
        instances[role] = with_options(
            role, component, {**usual.get(role, {}), **by_parts[role]})
    # 4. Options of problem, search and data, those decided that depend on the rest.
    of_problem = _options_of_problem(
        recipe, by_parts["problem"], instances["criterion"], instances["solver"])
    polished = recipe.refined and solver is None and not instances["solver"].ends_by_itself
    of_search = resolve(SEARCH_OPTIONS, {"polish": polished, **by_parts["search"]})
    of_data = resolve(DATA_OPTIONS, by_parts["data"])
    roles = asked_roles(of_data["off"], of_data["role"])
    if split_of(of_data) is not None and of_data["role"]:
        raise TermselError(f"the options role and roles={of_data['roles']} exclude each other",
                           hint="Leave one of them out; off goes with both.")
    # 5. The features, in the roles asked for.
    if features is None:
        spec = names.resolve("datasets", recipe.dataset if dataset is None else dataset)
        features = load_dataset(spec)
        source = f"{spec.name} (simulated)" if spec.simulated else spec.name
    in_roles = with_roles(features, roles)
    # Features without a height take no part where the others have one and the model needs it.
    blank = to_leave_out(in_roles) if instances["model"].uses_height else ()
    return Request(
        recipe=recipe, model=instances["model"], criterion=instances["criterion"],
        solver=instances["solver"], read=features,
        features=with_roles(in_roles, dict.fromkeys(blank, "off")),
        source=make_printable(source or "given in Python"),
        options={"problem": of_problem, "data": of_data, "search": of_search},
        then=instances.get("then"), set_options=set_options, blank=blank,
        undeclared=tuple(option.name for option in undeclared_options(recipe)
                         if option.name in by_parts["problem"]))


def _options_by_parts(recipe: Recipe, components: Mapping[str, Any],
                      settings: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the given options by part of the run."""
    declared = {"data": DATA_OPTIONS, "search": SEARCH_OPTIONS,
                **{role: component.declared_options for role, component in components.items()}}
    elsewhere: set[str] = set()
    for options in declared.values():
        elsewhere |= {option.name for option in options}
    of_problem = [*recipe.options, *(option for option in undeclared_options(recipe)
                                     if option.name not in elsewhere)]
    _refuse_of_others(settings, elsewhere | {option.name for option in of_problem})
    return options_by_part(settings, {"problem": of_problem, **declared})


def _refuse_of_others(settings: Mapping[str, Any], names: Collection[str]) -> None:
    """Raise TermselError for an option of a model, solver or criterion that is not used.

    Also for a misspelling of one. `names` are those of the options of the parts that are used.
    Other unknown options pass.
    """
    for key in settings:
        if key in names or "." in key:
            continue
        owners = owners_of_options()
        if key in owners:
            role, first, *others = owners[key]
            raise TermselError(
                f"{key!r} is an option of the {role} {' or '.join([first, *others[:2]])}, which "
                "this run does not use",
                hint=f"{_option_of_files(key)}{_choice_of(role, [first, *others])}, or leave {key} "
                     "out.",
                name=key)
        near = get_close_matches(key, [*names, *owners], n=1, cutoff=_MISSPELT)
        if near and near[0] not in names:
            role, first, *others = owners[near[0]]
            # Which of several suits the points, such as poly2d without heights, is not known here.
            choice = first if not others else "NAME"
            raise TermselError(
                f"unknown option {key!r}",
                hint=f"Did you mean {near[0]!r}? It is an option of the {role} "
                     f"{' or '.join([first, *others[:2]])}: add --{role} {choice}.", name=key)


def _option_of_files(key: str) -> str:
    """Return the question whether an option of the data is meant, such as camera_focal for focal.
    """
    from termsel.io.read import read_options  # it reads files, which a call from Python may not

    meant = next((option.name for option in read_options() if option.name == f"camera_{key}"), "")
    return f"Did you mean {meant}? " if meant else ""


_MISSPELT = 0.8
"""Share of matching characters from which on an option of another part is taken for misspelt."""


def _choice_of(role: str, names: Sequence[str]) -> str:
    """Return which of the criteria, models or solvers `names` to choose, as it has an option."""
    first, *without_heights = first_choices(role, names)
    others = f", or {without_heights[0]} for points without heights" if without_heights else ""
    return f"Choose --{role} {first}{others}"


def first_choices(role: str, names: Sequence[str]) -> list[str]:
    """Return the first of some criteria, models or solvers.

    Of models with and without heights one of each is named, as they differ in what the points show;
    that with heights comes first.
    """
    if role == "model":
        entries = {entry.name: entry.object for entry in registry().entries("models")}
        with_heights = [name for name in names if entries[name].uses_height]
        without = [name for name in names if name not in with_heights]
        return [*with_heights[:1], *without[:1]]
    return [names[0]]


def owners_of_options() -> dict[str, list[str]]:
    """Return the kind, and the names, of the criteria, models or solvers that have each option."""
    owners: dict[str, list[str]] = {}
    for kind in ("criteria", "models", "solvers"):
        word = KINDS[kind].word
        for entry in registry().entries(kind):
            for option in entry.object.declared_options:
                of_option = owners.setdefault(option.name, [word])
                # The first kind that has an option is named.
                if of_option[0] == word:
                    of_option.append(entry.name)
    return owners


def problem_for(features: FeatureSet | None, dataset: str | DatasetSpec | None = None) -> str:
    """Return the problem that features, or else a data set, are for where none is named.

    Raises
    ------
    TermselError
        If there are neither features nor a data set.
    """
    if features is None and dataset is not None:
        features = load_dataset(registry().resolve("datasets", dataset))
    if features is None:
        raise TermselError("there is nothing to run",
                           hint="Give points or lines, or name a problem.")
    # Lines are what OWDIS was made for; without heights a model has no use for Z.
    if len(features.lines):
        return "owdis-lines"
    plane = features.without_height() and not to_leave_out(features)
    return "poly-terms" if plane else "rfm-terms"


def _named_parts(recipe: Recipe, model: Any, solver: Any, criterion: Any,
                 settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return model, criterion and solvers, asked for or the problem's own, by class or instance.

    A model that interpolates has no terms to select, so that its solver is "all-terms"; several
    objectives need a solver that can handle them. Keys are "model", "criterion", "solver", and
    "then" where a second step has its own solver. A rational model of poly-terms is noted. Raises
    TermselError for a name that is not known, and as `second_solver` does.
    """
    names = registry()
    model_part = names.resolve("models", recipe.model if model is None else model)
    if recipe.name == "poly-terms" and class_of(model_part).name == "rfm":
        log.info("Note: poly-terms selects terms of polynomials. With %s it selects those of "
                 "a rational function, as rfm-terms does.", Remedy("model", "rfm"))
    # Where terms have no influence there is nothing to search.
    usual_solver = recipe.solver
    if issubclass(class_of(model_part), Interpolating):
        usual_solver = "all-terms"
    else:
        stated = settings.get("objectives", settings.get("problem.objectives"))
        # Solvers are loaded only where several objectives are asked for: a choice needs none.
        if (split_names(OBJECTIVES.parse(stated))
                and names.get("solvers", recipe.solver).max_objectives == 1):
            usual_solver = SEVERAL_OBJECTIVES
    components = {
        "model": model_part,
        "criterion": names.resolve("criteria",
                                   recipe.criterion if criterion is None else criterion),
        "solver": names.resolve("solvers", usual_solver if solver is None else solver)}
    then = second_solver(recipe, settings)
    if then is not None:
        components["then"] = names.get("solvers", then)
    return components


def _usual_options(recipe: Recipe, components: Mapping[str, Any], model: Any,
                   features: FeatureSet | None) -> dict[str, dict[str, Any]]:
    """Return the options of model and solvers that hold unless others are given, by part.

    The model of the recipe has the recipe's options, and every model that refines an RPC has the
    RPC of the features. Solvers have the options that the recipe states for them. `model` is as
    the user gave it, None where the recipe chooses it; `components` are the parts in use. Objects,
    which have their options already, are left out.
    """
    usual_options: dict[str, dict[str, Any]] = {}
    model_component = components["model"]
    takes_rpc = any(option.name == "rpc" for option in model_component.declared_options)
    rpc_option = {}
    if features is not None and features.rpc is not None and takes_rpc:
        rpc_option = {"rpc": json.encode(features.rpc.numbers()).decode()}
    if model in (None, recipe.model):
        # The RPC of a recipe is that of its data set, and of no other points.
        recipe_options = {name: value for name, value in recipe.model_options.items()
                          if features is None or name != "rpc"}
        usual_options["model"] = {**recipe_options, **rpc_option}
    elif isinstance(model_component, type):
        usual_options["model"] = rpc_option
    for role in ("solver", "then"):
        component = components.get(role)
        if isinstance(component, type) and issubclass(component, Solver):
            usual_options[role] = dict(recipe.solver_options.get(component.name, {}))
    return usual_options


def split_of(of_data: Mapping[str, Any]) -> Split | None:
    """Return the split that the options of the data name; None for the roles of the file."""
    name: str = of_data["roles"]
    split: Split | None = None if name == FILE else registry().get("splits", name)
    return split


def load_dataset(spec: DatasetSpec) -> FeatureSet:
    """Return the features of a data set; an error names the plugin it is of."""
    with attribute_errors_to(spec.load, "load"):
        features = spec.load()
    require_type(spec.load, "load", features, FeatureSet)
    return features


def require_type(function: Callable[..., Any], name: str, value: Any, expected: type) -> None:
    """Raise PluginFault if a plugin's function returned another type than expected."""
    fault = difference_from_type(value, expected)
    if fault is not None:
        raise fault_of_method(function, name, fault)


def _options_of_problem(recipe: Recipe, settings: Mapping[str, Any], criterion: Criterion,
                        solver: Solver) -> dict[str, Any]:
    """Return the options of a problem, those decided that depend on criterion and solver.

    `settings` are those given. Defaults that depend on the criterion or the solver, such as the
    rule by which one of a front is recommended, are decided here, so that the record states what
    was used. Raises TermselError for a rule that the criterion does not allow.
    """
    undeclared = {option.name: option for option in undeclared_options(recipe)}
    options = resolve([*recipe.options, *(option for name, option in undeclared.items()
                                          if name in settings)], settings)
    # A solver of fronts needs a second objective: the size of the selection.
    if solver.max_objectives > 1 and "objectives" in {*options, *undeclared}:
        options["objectives"] = options.get("objectives") or recipe.second
    if "max_share" in options and options["max_share"] is None:
        options["max_share"] = 1.0 if solver.uses_all else MAX_SHARE
    # One step has one solver.
    if options.get("steps") == "joint" and "then" in options:
        options["then"] = None
    if "recommend" in options:
        rule = options["recommend"]
        if rule == "one-standard-error" and not criterion.is_rmse:
            raise TermselError(f"criterion {criterion.name!r} is no RMSE, so it has no standard "
                               "error to recommend a selection by",
                               hint=f"Choose {Remedy('set', 'recommend=knee')} or best, or "
                                    f"{Remedy('criterion', 'check-rmse')}, press or kfold, these "
                                    "with loss=squares.")
        has_standard_error = solver.max_objectives > 1 and criterion.is_rmse
        options["recommend"] = rule or ("one-standard-error" if has_standard_error else "best")
    return options
