"""What a study asks for: problems, data, models, solvers, seeds, budgets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from termsel.core.errors import is_printable
from termsel.core.options import MOST_RUNS, SEED, Configurable
from termsel.data.features import FeatureSet
from termsel.formats.toml_files import read_toml
from termsel.studies.plan.places import Path as Keys
from termsel.studies.plan.places import Places, places_of

PARTS = ("problems", "models", "solvers", "criteria")
KEYS = ("title", *PARTS, "strategies", "data", "seeds", "splits", "budget", "options", "exports",
        "measure", "measures")
FILES = ("points", "lines", "areas", "rpc")
READING = ("crs", "format", "dem", "columns")
DATA_KEYS = ("dataset", *FILES, *READING, "options")
BUDGETS = {"evaluations": int, "generations": int, "patience": int, "seconds": float,
           "timeout": float}
STRATEGIES = ("auto", "as-asked")
MEASURES = ("fitness", "check", "independent")

_LONGEST = 200  # characters of a label: charts have no room for more


@dataclass(frozen=True)
class Asked:
    """A problem, model, solver or criterion of a study."""

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
    problems: tuple[Asked, ...] = ()
    # Where no model, solver or criterion is named, each problem has its own.
    models: tuple[Asked, ...] = ()
    solvers: tuple[Asked, ...] = ()
    criteria: tuple[Asked, ...] = ()
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
    places: Places = field(default_factory=Places)


def read_spec(file: Path) -> Spec:
    """Return what a study file asks for; what is refused has its line and column."""
    table, text = read_toml(file, "a study file", "See how-to/compare in the documentation.")
    return spec_of(table, places_of(text, file))


def spec_of(table: Mapping[str, Any], places: Places | None = None) -> Spec:
    """Return what a table of names, options and budgets asks for, checked."""
    at = places or Places()
    table = {key: _as_in_a_file(value) for key, value in table.items()}
    for key in table:
        if key not in KEYS:
            raise at.unknown((key,), "key of a study", KEYS)
    strategies = _texts(at, ("strategies",), table.get("strategies", []), STRATEGIES)
    parts = {kind: _parts(at, kind, table.get(kind, [])) for kind in PARTS}
    budget = _budget(at, _table(at, ("budget",), table.get("budget", {})))
    named = [kind for kind in ("models", "solvers", "criteria") if parts[kind]]
    searched = named or {**budget, "timeout": None} != {"timeout": None}
    if strategies == ("auto",) and named:
        raise at.error((named[0],), f"the strategy auto chooses the method itself, and {named[0]} "
                       "are given", "Leave one of them out, or add the strategy as-asked.")
    measure = table.get("measure")
    measures = _texts(at, ("measures",), table.get("measures", []))
    if measure is not None and measure not in (*MEASURES, *measures):
        raise at.error(("measure",), f"there is no measure {measure!r}",
                       f"Choose one of: {', '.join((*MEASURES, *measures))}; "
                       "or add it to measures.")
    title = table.get("title", "")
    if not isinstance(title, str):
        raise at.error(("title",), "the title is not text")
    return Spec(
        title, parts["problems"], parts["models"], parts["solvers"], parts["criteria"],
        strategies=strategies or (("as-asked",) if searched else ("auto",)),
        data=tuple(_sources(at, table.get("data", []))),
        seeds=_numbers(at, "seeds", table.get("seeds", 1), first=1),
        splits=_numbers(at, "splits", table.get("splits", 1), first=0),
        budget=budget, options=_options(at, ("options",), table.get("options", {})),
        exports=_texts(at, ("exports",), table.get("exports", [])), measure=measure,
        measures=measures, places=at)


def _as_in_a_file(value: Any) -> Any:
    """Return a value from Python as a study file has it: paths as text, numbers without numpy."""
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {key: _as_in_a_file(one) for key, one in value.items()}
    if isinstance(value, list | tuple | range):
        return [_as_in_a_file(one) for one in value]
    return value


def _parts(at: Places, kind: str, given: Any) -> tuple[Asked, ...]:
    if not isinstance(given, Sequence) or isinstance(given, str):
        raise at.error((kind,), f"{kind} is not a list", f'Write {kind} = ["name", ...].')
    found: list[Asked] = []
    for i, one in enumerate(given):
        path: Keys = (kind, i)
        part = _part(at, path, one)
        if len(part.label) > _LONGEST or not is_printable(part.label):
            raise at.error(path, f"the label {part.label!r:.60} has control characters, or more "
                           f"than {_LONGEST}", "Give a short label of plain text.")
        if any(other.label == part.label for other in found):
            raise at.error(path, f"{kind} has {part.label!r} twice",
                           'Give each its own label: {name = "...", label = "..."}.')
        found.append(part)
    return tuple(found)


def _part(at: Places, path: Keys, given: Any) -> Asked:
    if isinstance(given, str):
        return Asked(given, given, path=path)
    if isinstance(given, Configurable):
        shown = {option.name: given.options[option.name] for option in given.declared_options
                 if given.options[option.name] != option.default}
        label = ", ".join([given.name, *(f"{key}={_plain(value)}" for key, value in shown.items())])
        return Asked(given.name, label, path=path, thing=given)
    if not isinstance(given, Mapping):
        name = getattr(given, "name", None)
        if not isinstance(name, str):
            raise at.error(path, f"{given!r} is neither a name nor a table",
                           'Write "name", or {name = "name", option = value}.')
        return Asked(name, name, path=path, thing=given)
    name = given.get("name")
    if not isinstance(name, str):
        raise at.error(path, "a table has no name", 'Write {name = "...", option = value}.')
    options = _options(at, path, {key: value for key, value in given.items()
                                  if key not in ("name", "label")})
    told = ", ".join([name, *(f"{key}={_plain(value)}" for key, value in options.items())])
    return Asked(name, str(given.get("label", told)), options, path=path)


def _plain(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _sources(at: Places, given: Any) -> list[Source]:
    if isinstance(given, Mapping) and given and all(
            isinstance(one, FeatureSet) for one in given.values()):
        return [Source(features=given, path=("data",))]  # from Python, by label
    if isinstance(given, Mapping) and any(isinstance(one, FeatureSet) for one in given.values()):
        label = next(key for key, one in given.items() if not isinstance(one, FeatureSet))
        raise at.error(("data",), f"data {label!r} is no feature set", "Read it with termsel.read.")
    if not isinstance(given, Sequence) or isinstance(given, str):
        raise at.error(("data",), "data is not a list", 'Write [[data]] and then points = "...".')
    found = []
    for i, one in enumerate(given):
        path: Keys = ("data", i)
        if isinstance(one, str):
            found.append(Source(dataset=one, path=path))
            continue
        if not isinstance(one, Mapping):
            raise at.error(path, "this is neither a data set's name nor a table",
                           'Write [[data]] and then points = "...".')
        for key in one:
            if key not in DATA_KEYS:
                raise at.unknown((*path, key), "key of data", DATA_KEYS)
        files = {kind: _texts(at, (*path, kind), one[kind]) for kind in FILES if kind in one}
        if ("dataset" in one) == bool(files):
            raise at.error(path, "data are either a dataset or files",
                           'Write dataset = "name", or points = "*.csv".')
        reading = {key: one[key] for key in READING if key in one}
        for key, value in reading.items():
            if not isinstance(value, str):
                raise at.error((*path, key), f"{key} is not text")
        options = _options(at, (*path, "options"), one.get("options", {}))
        found.append(Source(one.get("dataset"), files, {**reading, **options}, path=path))
    return found


def _texts(at: Places, path: Keys, given: Any,
           known: tuple[str, ...] | None = None) -> tuple[str, ...]:
    """Return one text or a list of texts as a tuple."""
    items = [given] if isinstance(given, str) else given
    if not isinstance(items, Sequence) or not all(isinstance(item, str) for item in items):
        raise at.error(path, f"{path[-1]} is neither text nor a list of texts")
    for i, one in enumerate(items):
        if known is not None and one not in known:
            raise at.error((*path, i), f"there is no {one!r} among the {path[-1]}",
                           f"Choose from: {', '.join(known)}.")
    return tuple(dict.fromkeys(items))


def _numbers(at: Places, key: str, given: Any, first: int) -> tuple[int, ...]:
    """Return seeds: a list, or how many there are from the first on."""
    if isinstance(given, int) and not isinstance(given, bool):
        if not 1 <= given <= MOST_RUNS:
            raise at.error((key,), f"{given} {key} is not from 1 to {MOST_RUNS:,}",
                           f"{key} = N stands for N of them; {key} = [N] for a single one.")
        return tuple(range(first, first + given))
    if (not isinstance(given, Sequence) or isinstance(given, str) or not given
            or not all(isinstance(one, int) and not isinstance(one, bool) and 0 <= one <= SEED
                       for one in given)):
        raise at.error((key,), f"{key} is neither a whole number nor a list of them",
                       f"Write {key} = 30, or {key} = [1, 2, 7].")
    return tuple(dict.fromkeys(given))


def _table(at: Places, path: Keys, given: Any) -> Mapping[str, Any]:
    if not isinstance(given, Mapping):
        raise at.error(path, f"{path[-1]} is not a table", f"Write [{path[-1]}] on its own line.")
    return given


def _options(at: Places, path: Keys, given: Any) -> dict[str, Any]:
    for key, value in _table(at, path, given).items():
        if not isinstance(value, str | int | float | bool):
            raise at.error((*path, key), f"the option {key} is neither text, number nor true or "
                           "false")
    return dict(given)


def _budget(at: Places, given: Mapping[str, Any]) -> dict[str, Any]:
    for key, value in given.items():
        path = ("budget", key)
        if key not in BUDGETS:
            raise at.unknown(path, "key of the budget", BUDGETS)
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not number or not 0 < value <= 1e12 or (BUDGETS[key] is int and value != int(value)):
            raise at.error(path, f"the budget of {value} {key} is not positive, or above 1e12"
                           if number
                           else f"{key} is not a number")
    return {key: BUDGETS[key](value) for key, value in given.items()}
