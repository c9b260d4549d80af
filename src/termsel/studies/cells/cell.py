"""The cells of a study: one run each, identified by all that it depends on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from termsel.core.errors import TermselError, unknown_name
from termsel.core.isolation.parts import own_packages
from termsel.core.options import Configurable, Option
from termsel.plugins.hookspecs import PROJECT
from termsel.plugins.loading import canonical
from termsel.plugins.registry import SESSION, registry
from termsel.results.extras import Measure
from termsel.runs.auto.strategy import LEAST, wanted
from termsel.runs.run import problem_for
from termsel.runs.task.request import DATA_OPTIONS, Request, Setup
from termsel.runs.task.task import build, observe, scale, with_shares
from termsel.selection.solvers.base import Solver
from termsel.selection.solvers.budget import SEARCH_OPTIONS
from termsel.studies.cells.identity import made_of
from termsel.studies.cells.table import LABELS, columns_of
from termsel.studies.plan.data import Data, of_dataset
from termsel.studies.plan.spec import STRATEGIES, Asked, Spec

MOST_KINDS, MOST_CELLS = 1000, 500_000
"""Combinations and cells of a study. Each is checked before the first runs, in some 5 ms and 20 us.
"""

_OF_SEARCH = {option.name for option in SEARCH_OPTIONS}


@dataclass(frozen=True, eq=False)
class Cell:
    """One run of a study; see `works_of` for what of it workers are given."""

    key: str  # checksum of all that its result depends on
    labels: Mapping[str, Any]  # what tables call it, by LABELS
    call: Mapping[str, Any]  # arguments of the run, names and options, without the features
    data: Data
    instance: str = ""  # checksum of what its optimum depends on: all but solver, seed and budget
    # classes, instances and recipes in place of names, where Python gave them
    things: Mapping[str, Any] = field(default_factory=dict)
    others: bool = False  # whether it runs code that is not termsel's


def kind_of(labels: Mapping[str, Any]) -> tuple[str, ...]:
    """Return all labels but data, split and seed: cells of a kind take about the same time."""
    return tuple(labels[name] for name in LABELS if name not in ("data", "split", "seed"))


def cells_of(spec: Spec, data: list[Data]) -> list[Cell]:
    """Return all cells of a study, in the order of its tables.

    `data` is empty for each problem's own data set. Raises TermselError, with line and column of a
    study file, for names and options that are not known, a solver that cannot handle the
    objectives, or a kind of cell that none of the data allows.
    """
    _require_few(spec, len(data) or 1)
    kinds = _Kinds(spec)
    cells = []
    for problem in spec.problems or (None,):
        own = list(data) or [_own_data(spec, problem)]
        for one in own:
            name = problem.name if problem else None if one.features is None \
                else problem_for(one.features)
            for split in spec.splits:
                cells += list(_of_data(spec, kinds, problem, name, one, own, split))
    if cells and all(cell.data.features is None for cell in cells):
        raise TermselError(cells[0].data.reason, hint=None if len(cells) == 1 else
                           f"None of the {len(cells)} cells can run; this is the first.")
    kinds.require_used()
    if len(spec.splits) > 1 and len({cell.labels["split"] for cell in cells}) == 1:
        raise spec.places.error(("splits",), "every point has a role, so all splits are the same",
                                'Add roles = "random" to [options], or leave splits out.')
    if len({cell.key for cell in cells}) < len(cells):
        raise TermselError("two cells of the study are the same",
                           hint="Remove the problem, model or solver that is named twice.")
    return cells


def _require_few(spec: Spec, data: int) -> None:
    """Refuse a study that would take longer to plan than to think over; `data` are how many."""
    problems = len(spec.problems) or 1
    methods = len(spec.models or (None,)) * len(spec.criteria or (None,)) * len(
        spec.solvers or (None,))
    searched = "as-asked" in spec.strategies
    kinds = problems * (methods * searched + ("auto" in spec.strategies))
    cells = problems * data * len(spec.splits) * (
        methods * searched * len(spec.seeds) + ("auto" in spec.strategies))
    for number, most, what in ((kinds, MOST_KINDS, "combinations of problems and methods"),
                               (cells, MOST_CELLS, "cells")):
        if number > most:
            raise TermselError(f"the study has {number:,} {what}, and can have {most:,}",
                               hint="Divide it into several studies.")


def _own_data(spec: Spec, problem: Asked | None) -> Data:
    if problem is None:
        raise spec.places.error(("data",), "the study names neither data nor a problem",
                                "Write [[data]] and points = \"*.csv\", or problems = [\"...\"].")
    try:
        recipe = registry().taken("problems", problem.thing or problem.name)
    except TermselError as error:
        raise spec.places.error(problem.path, error.what, error.hint) from error
    return of_dataset(recipe.dataset)


def _of_data(spec: Spec, kinds: _Kinds, problem: Asked | None, name: str | None, data: Data,
             others: list[Data], split: int) -> Iterator[Cell]:
    asked: Asked | None = problem or (Asked(name, name) if name else None)
    for strategy in spec.strategies:
        methods = [(None, None, None)] if strategy == "auto" else [
            (model, criterion, solver) for model in spec.models or (None,)
            for criterion in spec.criteria or (None,) for solver in spec.solvers or (None,)]
        for model, criterion, solver in methods:
            parts = {"problem": asked, "model": model, "criterion": criterion, "solver": solver}
            kind = kinds.kind(strategy, parts, data, others)
            if kind.unfit is not None:
                if problem is not None:
                    raise kind.unfit
                # The files said what the problem is: these cannot be, others can.
                data = replace(data, features=None, reason=kind.reason)
            if split != spec.splits[0] and not _drawn(kind.options, data):
                continue
            seeds = spec.seeds if kind.chance else spec.seeds[:1]
            for seed in seeds:
                yield _cell(spec, strategy, parts, kind, data, split, seed)


def _drawn(options: Mapping[str, Any], data: Data) -> bool:
    """Return whether a split assigns any roles; without that all splits are one instance."""
    how = next((value for key, value in options.items()
                if key.rpartition(".")[2] == "roles"), "file")
    return how != "file" or (data.features is not None and "" in data.features.points.roles)


@dataclass(frozen=True)
class _Kind:
    """What cells of one kind have in common: options, names by default, and chance.

    Where none of the data allow it: the error with the place in the study file, and without.
    """

    options: Mapping[str, Any]
    names: Mapping[str, str]
    chance: bool
    made_of: Mapping[str, Any] = field(default_factory=dict)  # checksums by part
    others: bool = False  # whether code that is not termsel's takes part
    unfit: TermselError | None = None
    reason: str = ""


class _Kinds:
    """The kinds of cells met so far, each checked once."""

    def __init__(self, spec: Spec) -> None:
        self._spec = spec
        self._known: dict[Any, _Kind] = {}
        self._used: set[str] = set()

    def kind(self, strategy: str, parts: Mapping[str, Asked | None], data: Data,
             others: list[Data]) -> _Kind:
        """Return a kind, checked on these data or, where they do not serve, on others."""
        key = (strategy, *(part and part.label for part in parts.values()))
        if key not in self._known:
            if parts["problem"] is None:  # the data cannot be read, so nothing is known
                return _Kind({}, {}, chance=False)
            self._known[key] = self._checked(strategy, parts, [data, *others])
        return self._known[key]

    def require_used(self) -> None:
        """Refuse an option for every cell that no cell has."""
        for key in self._spec.options:
            if key not in self._used and self._known:
                raise self._spec.places.error(
                    ("options", key), f"no cell of the study has the option {key!r}",
                    "`termsel describe NAME` lists the options of a problem, model or solver.")

    def _checked(self, strategy: str, parts: Mapping[str, Asked | None],
                 data: list[Data]) -> _Kind:
        spec = self._spec
        first = None
        measures = _measures_of(spec)
        for one in data:
            if one.features is None:
                continue
            plain = self._asked(strategy, parts, one, {})
            options = self._options(strategy, parts, plain)
            request = self._asked(strategy, parts, one, options)
            made = {word: made_of(getattr(request, word))
                    for word in ("recipe", "model", "criterion", "solver", "then")}
            if strategy == "auto":
                made["candidates"] = made_of([entry.object
                                              for entry in registry().entries("candidates")])
            if measures:
                made["measures"] = made_of([measure.compute for measure in measures])
            chosen: Solver = request.solver
            try:
                observations = observe(with_shares(request, auto=strategy == "auto"),
                                       LEAST if strategy == "auto" else 3)
                if strategy != "auto":
                    build(request, observations, *scale(request, observations))
            except TermselError as error:
                first = first or error
                continue
            return _Kind(options, {"model": request.model.name, "solver": chosen.name,
                                   "criterion": request.criterion.name},
                         chance=strategy != "auto" and (
                             chosen.uses_chance or bool(request.options["search"]["polish"])),
                         made_of=made, others=_of_others(strategy, request, measures))
        assert first is not None  # some data can be read, or there would be no study
        named = next((part for word in ("solver", "model", "criterion", "problem")
                      if (part := parts[word]) and part.path), None)
        return _Kind({}, {}, chance=False, reason=str(first), unfit=spec.places.error(
            named.path if named else (), first.what, first.hint))

    def _asked(self, strategy: str, parts: Mapping[str, Asked | None], data: Data,
               options: Mapping[str, Any]) -> Setup:
        problem = parts["problem"]
        assert problem is not None
        names: dict[str, Any] = {word: part.thing or part.name for word, part in parts.items()
                                 if part}
        method: dict[str, Any] = {}
        try:
            if strategy == "auto":
                recipe = registry().taken("problems", problem.thing or problem.name)
                wanted("auto", recipe, [f"the option {key}" for key in problem.options])
                method = {"criterion": "press", "solver": "all-terms"}
            return _without_certificate(Request(
                **{**names, **method}, features=data.features, source=data.source,
                options=options).setup())
        except TermselError as error:
            raise self._at_fault(parts, error) from error

    def _at_fault(self, parts: Mapping[str, Asked | None], error: TermselError) -> TermselError:
        """Return the error with the place of the part, or the option, that it is about."""
        for word, part in parts.items():
            key = error.name.removeprefix(f"{word}.")
            if part is not None and (error.name == part.name or key in part.options):
                path = (*part.path, key) if key in part.options else part.path
                return self._spec.places.error(path, error.what, error.hint)
        if error.name in self._spec.options:
            return self._spec.places.error(("options", error.name), error.what, error.hint)
        problem = parts["problem"]
        return self._spec.places.error(problem.path if problem else (), error.what, error.hint)

    def _options(self, strategy: str, parts: Mapping[str, Asked | None],
                 request: Setup) -> dict[str, Any]:
        """Return the options of each part, and those for every cell that some part has."""
        declared: dict[str, tuple[Option, ...]] = {"data": DATA_OPTIONS}
        if strategy != "auto":
            declared |= {"problem": tuple(request.recipe.options),
                         "model": request.model.declared_options,
                         "criterion": request.criterion.declared_options,
                         "solver": request.solver.declared_options, "search": SEARCH_OPTIONS}
        # What stands next to a part and is no option of its own is for everything in its cells, as
        # with --set: next to a solver its local refinement, next to a problem a model's degree.
        chosen = {f"{word}.{key}" if any(option.name == key for option in declared.get(word, ()))
                  else key: value for word, part in parts.items() if part and word != "problem"
                  for key, value in part.options.items()}
        problem = parts["problem"]
        for key, value in (problem.options if problem else {}).items():
            if not any(name.rpartition(".")[2] == key for name in chosen):
                chosen[key] = value
        for key, value in self._spec.options.items():
            asked, _, bare = key.rpartition(".")
            having = [word for word, options in declared.items() if asked in ("", word)
                      and any(option.name == bare for option in options)]
            if having:
                self._used.add(key)
            for word in having:
                # An instance has its options already.
                part = parts.get(word)
                if bare not in chosen and not (part and isinstance(part.thing, Configurable)):
                    chosen.setdefault(f"{word}.{bare}", value)
        # Every cell has one thread, so that cells at the same time do not wait for each other.
        if any(option.name == "workers" for option in declared.get("solver", ())):
            chosen.setdefault("solver.workers", 1)
        return chosen


def _without_certificate(setup: Setup) -> Setup:
    """Refuse a certificate: it is a file of the folder of a result, which cells have not."""
    if setup.solver.options.get("certificate"):
        raise TermselError("cells of a study keep no certificates",
                           hint="Run the cell alone: termsel run ... --out DIR.",
                           name="certificate")
    return setup


def _cell(spec: Spec, strategy: str, parts: Mapping[str, Asked | None], kind: _Kind, data: Data,
          split: int, seed: int) -> Cell:
    problem = parts["problem"]
    labels = {
        "problem": problem.label if problem else "", "data": data.label, "split": split,
        "strategy": strategy, **{
            word: part.label if (part := parts[word]) else kind.names.get(word, "")
            for word in ("model", "criterion", "solver")}, "seed": seed}
    if strategy == "auto":
        labels |= {"model": "", "criterion": "press", "solver": "auto"}
    options = {**kind.options}
    if spec.splits != (0,):
        options["data.split"] = split
    call = {**{word: part and part.name for word, part in parts.items()}, "strategy": strategy,
            "options": options, "seed": seed, **spec.budget}
    if spec.measures:
        call["measures"] = list(spec.measures)
    if strategy == "auto":
        call["exports"] = list(spec.exports)
    things = {word: part.thing for word, part in parts.items() if part and part.thing}
    identity = {**call, "labels": labels, "data": data.key, "made_of": kind.made_of}
    instance = {
        "data": data.key, "problem": call["problem"],
        "options": {name: value for name, value in options.items()
                    if not name.startswith(("solver.", "search.")) and name not in _OF_SEARCH},
        "made_of": {word: told for word, told in kind.made_of.items()
                    if word not in ("solver", "then")}}
    return Cell(_sum(identity), labels, call, data, _sum(instance), things, kind.others)


def _measures_of(spec: Spec) -> list[Measure]:
    """Return the measures that a study names; refuse one that a column of the table hides."""
    names = registry()
    for i, name in enumerate(spec.measures):
        if names.known("measures", name) is None:
            unknown = unknown_name("measure", name, names.names("measures"))
            raise spec.places.error(("measures", i), unknown.what, unknown.hint)
        if name in columns_of(STRATEGIES):
            raise spec.places.error(("measures", i), f"every study has a column {name!r}",
                                    "Give the measure another name.")
    return [names.get("measures", name) for name in spec.measures]


def _of_others(strategy: str, setup: Setup, measures: Iterable[Measure]) -> bool:
    """Return whether plugins that are not termsel's, or objects from Python, take part in cells."""
    own = {PROJECT, *own_packages()}
    if strategy == "auto":  # its candidates are those of all plugins
        return any(slot.plugin.distribution not in own for slot in registry().slots)
    classes = [type(one) for one in (setup.model, setup.criterion, setup.solver, setup.then) if one]
    entries = map(registry().origin, (setup.recipe, *classes, *measures))
    if any(entry is not None and entry.provided_by == SESSION for entry in entries):
        return False  # what is registered in this process has a name in no other one
    code = (setup.recipe.build, *classes, *(measure.compute for measure in measures))
    return not own.issuperset(canonical(one.__module__.partition(".")[0]) for one in code)


def _sum(content: Mapping[str, Any]) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:24]
