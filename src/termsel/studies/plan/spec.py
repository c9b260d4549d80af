"""What a study asks for: problems, data, models, solvers, seeds, budgets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from shlex import join
from typing import Any

import numpy as np

from termsel.core.errors import TermselError, is_printable
from termsel.core.files.names import free_name
from termsel.core.options import MOST_RUNS, SEED, Configurable
from termsel.data.features import FeatureSet
from termsel.formats.toml_files import read_toml
from termsel.studies.cells.verdicts import Accept
from termsel.studies.plan.places import Path as Keys
from termsel.studies.plan.places import Places, places_of

PARTS = ("problems", "models", "solvers", "criteria", "methods")
KEYS = ("title", *PARTS, "strategies", "data", "seeds", "splits", "budget", "options", "exports",
        "measure", "measures", "accept")
FILE_KEYS = ("points", "lines", "areas", "rpc")
READING = ("crs", "format", "dem", "columns")
DATA_KEYS = ("dataset", *FILE_KEYS, *READING, "options")
BUDGETS = {"evaluations": int, "generations": int, "patience": int, "seconds": float,
           "timeout": float}
STRATEGIES = ("auto", "as-asked")
MEASURES = ("fitness", "check", "independent")

_MAX_LABEL_LENGTH = 200  # characters of a label: charts have no room for more


@dataclass(frozen=True)
class PartSpec:
    """A problem, model, solver, criterion or method of a study."""

    name: str
    label: str  # what tables call it
    options: Mapping[str, Any] = field(default_factory=dict)
    path: Keys = ()  # where the study file names it
    thing: Any = None  # the class, instance or recipe that Python gave in place of a name


@dataclass(frozen=True)
class Source:
    """Where data of a study come from: a data set, files, or feature sets from Python by label."""

    dataset: str | None = None
    # patterns of names by kind: points, lines, areas, rpc
    files: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    reading: Mapping[str, Any] = field(default_factory=dict)  # arguments of `termsel.read`
    features: Mapping[str, Any] = field(default_factory=dict)
    path: Keys = ()  # where the study file names it


@dataclass(frozen=True)
class Spec:
    """What a study asks for."""

    title: str = ""
    problems: tuple[PartSpec, ...] = ()
    # Where no model, solver or criterion is named, each problem has its own.
    models: tuple[PartSpec, ...] = ()
    solvers: tuple[PartSpec, ...] = ()
    criteria: tuple[PartSpec, ...] = ()
    methods: tuple[PartSpec, ...] = ()  # in place of the automatic choice
    strategies: tuple[str, ...] = ()
    data: tuple[Source, ...] = ()  # none: the data set of each problem
    seeds: tuple[int, ...] = (1,)
    splits: tuple[int, ...] = (0,)
    # of BUDGETS; after "timeout" seconds a cell fails
    budget: Mapping[str, Any] = field(default_factory=dict)
    options: Mapping[str, Any] = field(default_factory=dict)  # for every cell that has them
    exports: tuple[str, ...] = ()  # formats of the models of auto
    measure: str | None = None  # what methods are compared by
    measures: tuple[str, ...] = ()  # figures of plugins, a column each
    accept: Accept | None = None  # the largest RMSE with which an image is fit for use
    places: Places = field(default_factory=Places)


def read_spec(file: Path) -> Spec:
    """Return the spec of a study file.

    Raises TermselError, which names line and column, for what is wrong in it, and for the file of a
    block.
    """
    table, text = read_toml(file, "a study file",
                            "termsel example DIR writes a study.toml to begin with.")
    # The file of a block lists its images, and is another kind of file.
    if "image" in table:
        command = join(["termsel", "block", str(file), "--out",
                        free_name(file.parent / "adjusted")])
        raise TermselError("this describes a block of images, not a study", file=file,
                           hint=f"Adjust it: {command}")
    return spec_of(table, places_of(text, file))


def spec_of(table: Mapping[str, Any], places: Places | None = None) -> Spec:
    """Return the checked spec of a table of names, options and budgets.

    Parameters
    ----------
    table : mapping
        The keys of a study file (`KEYS`), or the same from Python with objects in place of names.
    places : Places, optional
        Where each key stands in the file, for errors.

    Returns
    -------
    Spec
        With usual values where keys are missing: searches where one of their parts is named,
        else auto.

    Raises
    ------
    TermselError
        For unknown keys, values that are none, and parts that nobody would use, at their line of
        the file.
    """
    # From Python there are no lines to name.
    at = places or Places()
    # From here on a study from Python is as one from a file.
    table = {key: _as_study_file_has_it(value) for key, value in table.items()}
    for key in table:
        if key not in KEYS:
            raise at.unknown((key,), "key of a study", KEYS)
    strategies = _parse_texts(at, ("strategies",), table.get("strategies", []), STRATEGIES)
    components = {kind: _parts_of_kind(at, kind, table.get(kind, [])) for kind in PARTS}
    budget = _parse_budget(at, _require_table(at, ("budget",), table.get("budget", {})))
    named = [kind for kind in ("models", "solvers", "criteria") if components[kind]]
    # Who names methods or limits of a search asks for one; a timeout is of auto, too.
    searched = named or {**budget, "timeout": None} != {"timeout": None}
    # What nobody uses is refused, lest a study seems to compare it.
    if strategies == ("auto",) and named:
        raise at.error((named[0],), f"the strategy auto chooses the method itself, and {named[0]} "
                       "are given", "Leave one of them out, or add the strategy as-asked.")
    methods = components["methods"]
    if methods and strategies == ("as-asked",):
        raise at.error(("methods",), "the strategy as-asked runs solvers, and methods are given",
                       "Leave one of them out, or add the strategy auto.")
    for method in methods:
        if method.options:
            raise at.error(method.path, f"the method {method.name!r} takes no options",
                           "In Python, give the object with its options.")
    # Searches where something of them is named, methods where they are; else the choice by auto.
    usual: tuple[str, ...] = ("auto",)
    if searched:
        usual = ("as-asked", "auto") if methods else ("as-asked",)
    measure = table.get("measure")
    measures = _parse_texts(at, ("measures",), table.get("measures", []))
    if measure is not None and measure not in (*MEASURES, *measures):
        raise at.error(("measure",), f"there is no measure {measure!r}",
                       f"Choose one of: {', '.join((*MEASURES, *measures))}; "
                       "or add it to measures.")
    title = table.get("title", "")
    if not isinstance(title, str):
        raise at.error(("title",), "the title is not text")
    accept = table.get("accept")
    if accept is not None:
        try:
            accept = Accept.of(str(accept))
        except TermselError as error:
            raise at.error(("accept",), error.what, error.hint) from error
    return Spec(
        title, components["problems"], components["models"], components["solvers"],
        components["criteria"], methods, strategies=strategies or usual,
        data=tuple(_parse_sources(at, table.get("data", []))),
        seeds=_parse_seeds(at, "seeds", table.get("seeds", 1), first=1),
        splits=_parse_seeds(at, "splits", table.get("splits", 1), first=0),
        budget=budget, options=_parse_options(at, ("options",), table.get("options", {})),
        exports=_parse_texts(at, ("exports",), table.get("exports", [])), measure=measure,
        measures=measures, accept=accept, places=at)


def _as_study_file_has_it(value: Any) -> Any:
    """Return a value from Python as a study file has it: paths as text, numbers without numpy."""
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {key: _as_study_file_has_it(item) for key, item in value.items()}
    if isinstance(value, list | tuple | range):
        return [_as_study_file_has_it(item) for item in value]
    return value


def _parts_of_kind(at: Places, kind: str, listed: Any) -> tuple[PartSpec, ...]:
    """Return the parts of a kind that a study lists, each with a label of its own.

    Raises TermselError, with the place in the study, for what is no list, and for a label that is
    too long, has control characters or is given twice.
    """
    if not isinstance(listed, Sequence) or isinstance(listed, str):
        raise at.error((kind,), f"{kind} is not a list", f'Write {kind} = ["name", ...].')
    components: list[PartSpec] = []
    for i, item in enumerate(listed):
        path: Keys = (kind, i)
        component = _part_of_study(at, path, item)
        if len(component.label) > _MAX_LABEL_LENGTH or not is_printable(component.label):
            raise at.error(path, f"the label {component.label!r:.60} has control characters, or "
                           f"more than {_MAX_LABEL_LENGTH}", "Give a short label of plain text.")
        # Tables name a cell by its labels.
        if any(earlier.label == component.label for earlier in components):
            raise at.error(path, f"{kind} has {component.label!r} twice",
                           'Give each its own label: {name = "...", label = "..."}.')
        components.append(component)
    return tuple(components)


def _part_of_study(at: Places, path: Keys, declared: Any) -> PartSpec:
    """Return a part by its name, by a table with options, or by an object from Python.

    `path` says where it stands in the study, for errors. The label, which tables of the study show,
    has the options that are not at their defaults, unless the table gives one.

    Raises TermselError, with `path`, for what has no name.
    """
    if isinstance(declared, str):
        return PartSpec(declared, declared, path=path)
    if isinstance(declared, Configurable):
        # The label says which options differ from their defaults.
        settings = [f"{option.name}={_value_text(declared.options[option.name])}"
                    for option in declared.declared_options
                    if declared.options[option.name] != option.default]
        label = ", ".join([declared.name, *settings])
        return PartSpec(declared.name, label, path=path, thing=declared)
    if not isinstance(declared, Mapping):
        # Classes, recipes and methods have names, too.
        name = getattr(declared, "name", None)
        if not isinstance(name, str):
            raise at.error(path, f"{declared!r} is neither a name nor a table",
                           'Write "name", or {name = "name", option = value}.')
        return PartSpec(name, name, path=path, thing=declared)
    name = declared.get("name")
    if not isinstance(name, str):
        raise at.error(path, "a table has no name", 'Write {name = "...", option = value}.')
    options = _parse_options(
        at, path, {key: value for key, value in declared.items() if key not in ("name", "label")})
    description = ", ".join([name,
                             *(f"{key}={_value_text(value)}" for key, value in options.items())])
    return PartSpec(name, str(declared.get("label", description)), options, path=path)


def _value_text(value: Any) -> str:
    """Return a value as it is typed: true and false in small letters."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def _parse_sources(at: Places, listed: Any) -> list[Source]:
    """Return the sources of data that a study lists.

    Each is a data set by its name, files by patterns with the options of reading them, or, from
    Python alone, features by their label. Raises TermselError at the line of what is neither, or of
    unknown keys.
    """
    if isinstance(listed, Mapping) and listed and all(
            isinstance(item, FeatureSet) for item in listed.values()):
        return [Source(features=listed, path=("data",))]  # from Python, by label
    if isinstance(listed, Mapping) and any(
            isinstance(item, FeatureSet) for item in listed.values()):
        label = next(key for key, item in listed.items() if not isinstance(item, FeatureSet))
        raise at.error(("data",), f"data {label!r} is no feature set", "Read it with termsel.read.")
    if not isinstance(listed, Sequence) or isinstance(listed, str):
        raise at.error(("data",), "data is not a list", 'Write [[data]] and then points = "...".')
    sources = []
    for i, item in enumerate(listed):
        path: Keys = ("data", i)
        if isinstance(item, str):
            sources.append(Source(dataset=item, path=path))
            continue
        if not isinstance(item, Mapping):
            raise at.error(path, "this is neither a data set's name nor a table",
                           'Write [[data]] and then points = "...".')
        for key in item:
            if key not in DATA_KEYS:
                raise at.unknown((*path, key), "key of data", DATA_KEYS)
        files = {kind: _parse_texts(at, (*path, kind), item[kind]) for kind in FILE_KEYS
                 if kind in item}
        if ("dataset" in item) == bool(files):
            raise at.error(path, "data are either a dataset or files",
                           'Write dataset = "name", or points = "*.csv".')
        # Arguments of `termsel.read`, its further options among them.
        reading = {key: item[key] for key in READING if key in item}
        for key, value in reading.items():
            if not isinstance(value, str):
                raise at.error((*path, key), f"{key} is not text")
        options = _parse_options(at, (*path, "options"), item.get("options", {}))
        sources.append(Source(item.get("dataset"), files, {**reading, **options}, path=path))
    return sources


def _parse_texts(at: Places, path: Keys, value: Any,
                 choices: tuple[str, ...] | None = None) -> tuple[str, ...]:
    """Return a text, or a list of texts, as a tuple of texts.

    Raises TermselError, with the place in the study, for anything else, and for a text that is not
    among the `choices`, if there are any.
    """
    items = [value] if isinstance(value, str) else value
    if not isinstance(items, Sequence) or not all(isinstance(item, str) for item in items):
        raise at.error(path, f"{path[-1]} is neither text nor a list of texts")
    for i, text in enumerate(items):
        if choices is not None and text not in choices:
            raise at.error((*path, i), f"there is no {text!r} among the {path[-1]}",
                           f"Choose from: {', '.join(choices)}.")
    return tuple(dict.fromkeys(items))


def _parse_seeds(at: Places, key: str, value: Any, first: int) -> tuple[int, ...]:
    """Return seeds: a list, or how many there are from the first on.

    Raises TermselError for what is no such number or list.
    """
    if isinstance(value, int) and not isinstance(value, bool):
        if not 1 <= value <= MOST_RUNS:
            raise at.error((key,), f"{value} {key} is not from 1 to {MOST_RUNS:,}",
                           f"{key} = N stands for N of them; {key} = [N] for a single one.")
        return tuple(range(first, first + value))
    if (not isinstance(value, Sequence) or isinstance(value, str) or not value
            or not all(isinstance(seed, int) and not isinstance(seed, bool) and 0 <= seed <= SEED
                       for seed in value)):
        raise at.error((key,), f"{key} is neither a whole number nor a list of them",
                       f"Write {key} = 30, or {key} = [1, 2, 7].")
    return tuple(dict.fromkeys(value))


def _require_table(at: Places, path: Keys, value: Any) -> Mapping[str, Any]:
    """Return a table; raises TermselError, with its place, for any other value."""
    if not isinstance(value, Mapping):
        raise at.error(path, f"{path[-1]} is not a table", f"Write [{path[-1]}] on its own line.")
    return value


def _parse_options(at: Places, path: Keys, table: Any) -> dict[str, Any]:
    """Return the options in a table; raises TermselError for one that is a list or a table."""
    for key, value in _require_table(at, path, table).items():
        if not isinstance(value, str | int | float | bool):
            raise at.error((*path, key), f"the option {key} is neither text, number nor true or "
                           "false", "Give it one value. Several are compared as problems or models "
                           f"of their own: [{{name = \"poly2d\", {key} = ...}}, ...].")
    return dict(table)


def _parse_budget(at: Places, limits: Mapping[str, Any]) -> dict[str, Any]:
    """Return the limits of a study's searches, by name.

    Raises TermselError, with the place in the study, for a limit that is not known, and for a value
    that is not positive, above 1e12 or, for a count, not whole.
    """
    for key, value in limits.items():
        path = ("budget", key)
        if key not in BUDGETS:
            raise at.unknown(path, "key of the budget", BUDGETS)
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not number or not 0 < value <= 1e12 or (BUDGETS[key] is int and value != int(value)):
            raise at.error(path, f"the budget of {value} {key} is not positive, or above 1e12"
                           if number
                           else f"{key} is {value!r}, expected a number above 0")
    return {key: BUDGETS[key](value) for key, value in limits.items()}
