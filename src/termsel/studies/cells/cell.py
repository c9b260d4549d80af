"""The cells of a study: one run each, identified by all that it depends on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

from termsel.core.errors import TermselError, unknown_name_error
from termsel.core.isolation.parts import canonical_name, own_packages
from termsel.core.options import Configurable, Option
from termsel.plugins.hookspecs import PROJECT
from termsel.plugins.registry import SESSION, registry
from termsel.results.extras import Measure
from termsel.runs.choosing import uses_auto
from termsel.runs.request import DATA_OPTIONS, Request, auto_of, problem_for, request_of
from termsel.runs.task import (
    LEAST,
    MIN_CONTROL,
    Task,
    observe,
    with_problem_built,
    with_shares,
)
from termsel.selection.solvers.base import Solver
from termsel.selection.solvers.budget import SEARCH_OPTIONS
from termsel.studies.cells.identity import checksum_of_code
from termsel.studies.cells.table import LABELS, columns_of
from termsel.studies.plan.data import Data, data_of_dataset
from termsel.studies.plan.spec import STRATEGIES, PartSpec, Spec

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
    # Times are estimated by kind: data of a study are mostly of one size.
    return tuple(labels[name] for name in LABELS if name not in ("data", "split", "seed"))


def cells_of(spec: Spec, data: list[Data]) -> list[Cell]:
    """Return all cells of a study, in the order of its tables.

    Where `data` is empty, each problem has a data set of its own. Raises TermselError, with line
    and column of a study file, for names and options that are not known, a solver that cannot
    handle the objectives, a kind of cell that none of the data allows, data of which none can be
    read, splits without effect, and two runs that are the same.
    """
    # Before anything is checked, as a few lines can ask for millions of cells.
    _require_few(spec, len(data) or 1)
    kinds = _Kinds(spec)
    cells: list[Cell] = []
    for problem in spec.problems or (None,):
        data_sets = list(data) or [_data_of_problem(spec, problem)]
        for data_set in data_sets:
            # Without a problem the features say what it is: points, or lines as well.
            if problem:
                name = problem.name
            elif data_set.features is None:
                name = None
            else:
                name = problem_for(data_set.features)
            for split in spec.splits:
                cells += _cells_of_data(spec, kinds, problem, name, data_set,
                                        alternatives=data_sets, split=split)
    _require_sound(spec, kinds, cells)
    return cells


def _require_sound(spec: Spec, kinds: _Kinds, cells: list[Cell]) -> None:
    """Raise TermselError for a study none of whose cells can run, or that says a thing in vain.

    These are options that no cell has, splits of data in which every point has a role, and cells
    that are listed twice.
    """
    if cells and all(cell.data.features is None for cell in cells):
        raise TermselError(cells[0].data.reason, hint=None if len(cells) == 1 else
                           f"None of the {len(cells)} cells can run; this is the first.")
    # A misspelt option would silently be without effect.
    kinds.require_used()
    if len(spec.splits) > 1 and len({cell.labels["split"] for cell in cells}) == 1:
        raise spec.places.error(("splits",), "every point has a role, so all splits are the same",
                                'Add roles = "random" to [options], or leave splits out.')
    # The key is of all that the result depends on: equal keys are one cell.
    if len({cell.key for cell in cells}) < len(cells):
        raise TermselError("two runs of the study are the same",
                           hint="Remove the problem, model or solver that is named twice.")


def _require_few(spec: Spec, data: int) -> None:
    """Refuse a study with too many cells to be planned, which has `data` data sets."""
    problems = len(spec.problems) or 1
    methods = len(spec.models or (None,)) * len(spec.criteria or (None,)) * len(
        spec.solvers or (None,))
    searched = "as-asked" in spec.strategies
    # An upper bound: cells without chance, and splits without effect, are left out later.
    alone = len(spec.methods or (None,)) * ("auto" in spec.strategies)
    kinds = problems * (methods * searched + alone)
    cells = problems * data * len(spec.splits) * (methods * searched * len(spec.seeds) + alone)
    for number, limit, plural in ((kinds, MOST_KINDS, "combinations of problems and methods"),
                                  (cells, MOST_CELLS, "runs")):
        if number > limit:
            raise TermselError(f"the study has {number:,} {plural}, and can have {limit:,}",
                               hint="Divide it into several studies.")


def _data_of_problem(spec: Spec, problem: PartSpec | None) -> Data:
    """Return the data set of a problem, for a study that names no data.

    Raises TermselError, with the place in the study, where there is no problem either, or none of
    this name.
    """
    if problem is None:
        raise spec.places.error(("data",), "the study names neither data nor a problem",
                                "Write [[data]] and points = \"*.csv\", or problems = [\"...\"].")
    try:
        recipe = registry().resolve("problems", problem.thing or problem.name)
    except TermselError as error:
        raise spec.places.error(problem.path, error.what, error.hint) from error
    return data_of_dataset(recipe.dataset)


def _cells_of_data(spec: Spec, kinds: _Kinds, problem: PartSpec | None, name: str | None,
                   data: Data, alternatives: list[Data], split: int) -> Iterator[Cell]:
    """Yield the cells of one problem and one data set, by strategy, parts and seed.

    `alternatives` are all data of the study that the problem could be run on, by which a kind of
    cell is checked once. Splits that would change nothing, and seeds of solvers without chance,
    give no further cells. Raises TermselError where a problem that the user names fits none of the
    data.
    """
    problem_spec: PartSpec | None = problem or (PartSpec(name, name) if name else None)
    for strategy in spec.strategies:
        # Auto, or a method in its place; else each model with each criterion and each solver.
        combinations: Iterable[tuple[PartSpec | None, PartSpec | None, PartSpec | None,
                                     PartSpec | None]]
        if strategy == "auto":
            combinations = [(None, None, None, method) for method in spec.methods or (None,)]
        else:
            combinations = product(spec.models or (None,), spec.criteria or (None,),
                                   spec.solvers or (None,), (None,))
        for model, criterion, solver, method in combinations:
            specs = {"problem": problem_spec, "model": model, "criterion": criterion,
                     "solver": solver}
            if method is not None:
                specs["method"] = method
            kind = kinds.kind(strategy, specs, data, alternatives)
            if kind.unfit is not None:
                if problem is not None:
                    raise kind.unfit
                # The files said what the problem is: these cannot be, others can.
                data = replace(data, features=None, reason=kind.reason)
            # Splits of data whose roles are all given would be the same run again.
            if split != spec.splits[0] and not _draws_roles(kind.options, data):
                continue
            # Without chance every seed has the same result.
            seeds = spec.seeds if kind.chance else spec.seeds[:1]
            for seed in seeds:
                yield _make_cell(spec, strategy, specs, kind, data, split=split, seed=seed)


def _draws_roles(options: Mapping[str, Any], data: Data) -> bool:
    """Return whether a split assigns any roles; if it does not, all splits are the same run."""
    # Keys may have the name of a part in front, "data.roles".
    roles_options = [value for key, value in options.items() if key.rpartition(".")[2] == "roles"]
    if roles_options and roles_options[0] != "file":
        return True
    # Of the roles in a file only blank ones are assigned.
    return data.features is not None and "" in data.features.points.roles


@dataclass(frozen=True)
class _Kind:
    """What cells of one kind have in common: options, names by default, and chance.

    Where none of the data allow the kind, `unfit` is the error with the place in the study file,
    and `reason` the same without the place.
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

    def kind(self, strategy: str, specs: Mapping[str, PartSpec | None], data: Data,
             alternatives: list[Data]) -> _Kind:
        """Return a kind, checked on these data or, where they do not serve, on others."""
        # Without the data: whether a kind can be is mostly the same for all of them.
        key = (strategy, *(spec and spec.label for spec in specs.values()))
        if key not in self._known:
            if specs["problem"] is None:  # the data cannot be read, so nothing is known
                return _Kind({}, {}, chance=False)
            self._known[key] = self._first_possible_kind(strategy, specs, [data, *alternatives])
        return self._known[key]

    def require_used(self) -> None:
        """Raise TermselError for an option for every cell that no cell has."""
        for key in self._spec.options:
            if key not in self._used and self._known:
                raise self._spec.places.error(
                    ("options", key), f"no run of the study has the option {key!r}",
                    "`termsel describe NAME` lists the options of a problem, model or solver.")

    def _first_possible_kind(self, strategy: str, specs: Mapping[str, PartSpec | None],
                             data: list[Data]) -> _Kind:
        """Return what all cells of a kind share, by the first of the data sets that allows it.

        A kind is a problem with its model, criterion and solver, or a method. Whether these go
        together depends on data, so the data sets are tried in their order; those that cannot be
        read are passed over. Where none allows the kind, its `unfit` is the error on the first.

        Raises TermselError for names and options that are not known.
        """
        measures = _measures_of(self._spec)
        first_error = None
        for data_set in data:
            if data_set.features is None:
                continue
            # First without options, to learn which parts there are and what they declare.
            without_options = self._request_of_run(strategy, specs, data_set, {})
            options = self._options_by_part(strategy, specs, without_options)
            request = self._request_of_run(strategy, specs, data_set, options)
            try:
                _require_possible(strategy, request)
            except TermselError as error:
                first_error = first_error or error
                continue
            solver: Solver = request.solver
            # A deterministic solver followed by a local search that draws has chance as well.
            draws = solver.uses_chance or bool(request.options["search"]["polish"])
            names = {"model": request.model.name, "solver": solver.name,
                     "criterion": request.criterion.name}
            return _Kind(options, names, chance=draws and strategy != "auto",
                         made_of=_checksums_of_parts(strategy, request, specs, measures),
                         others=_uses_foreign_parts(strategy, request, measures))
        assert first_error is not None  # some data can be read, or there would be no study
        return self._impossible_kind(specs, first_error)

    def _impossible_kind(self, specs: Mapping[str, PartSpec | None],
                         error: TermselError) -> _Kind:
        """Return the kind that no data allow, with the error at the part the study names."""
        path: tuple[Any, ...] = ()
        # The part that is most often at fault comes first.
        for role in ("solver", "model", "criterion", "problem"):
            part = specs[role]
            if part and part.path:
                path = part.path
                break
        return _Kind({}, {}, chance=False, reason=str(error),
                     unfit=self._spec.places.error(path, error.what, error.hint))

    def _request_of_run(self, strategy: str, specs: Mapping[str, PartSpec | None], data: Data,
                        options: Mapping[str, Any]) -> Request:
        """Return the request of the run of one cell.

        Parameters
        ----------
        strategy : str
            "auto" for the strategy of that name: then criterion and solver are fixed.
        specs : mapping
            What the study names for each role, such as "problem" and "solver"; None for nothing.
        data : Data
            The features of the cell, and where they are from.
        options : mapping
            Options of all parts, by name.

        Returns
        -------
        Request

        Raises
        ------
        TermselError
            If anything is unknown or does not fit; it names the place in the study's file.
        """
        problem = specs["problem"]
        assert problem is not None
        self._require_method(specs.get("method"))
        names: dict[str, Any] = {role: spec.thing or spec.name for role, spec in specs.items()
                                 if spec and role != "method"}
        method: dict[str, Any] = {}
        try:
            if strategy == "auto":
                recipe = registry().resolve("problems", problem.thing or problem.name)
                uses_auto("auto", recipe, [f"the option {key}" for key in problem.options])
                method = {"criterion": "press", "solver": "all-terms"}
            named_problem = names.pop("problem")
            return _require_no_certificate(request_of(
                named_problem, **{**names, **method}, features=data.features, source=data.source,
                options=options))
        except TermselError as error:
            raise self._locate_fault(specs, error) from error

    def _require_method(self, method: PartSpec | None) -> None:
        """Raise TermselError, with the place in the study, for a method that does not exist."""
        if method is None:
            return
        try:
            auto_of(_resolve_method(method))
        except TermselError as error:
            raise self._spec.places.error(method.path, error.what, error.hint) from error

    def _locate_fault(self, specs: Mapping[str, PartSpec | None],
                      error: TermselError) -> TermselError:
        """Return the error with the place of the part, or the option, that it is about."""
        for role, spec in specs.items():
            # An error names the option as "solver.population" or as "population".
            key = error.name.removeprefix(f"{role}.")
            if spec is not None and (error.name == spec.name or key in spec.options):
                path = (*spec.path, key) if key in spec.options else spec.path
                return self._spec.places.error(path, error.what, error.hint)
        if error.name in self._spec.options:
            return self._spec.places.error(("options", error.name), error.what, error.hint)
        problem = specs["problem"]
        return self._spec.places.error(problem.path if problem else (), error.what, error.hint)

    def _options_by_part(self, strategy: str, specs: Mapping[str, PartSpec | None],
                         request: Request) -> dict[str, Any]:
        """Return the options of each part, and those for every cell that some part has.

        An option in the study's own table is for every part that has one of that name; one next to
        a part is for this part first, else for all parts of its cells, as with --set, and wins. A
        part that is an object keeps its own. The study's options that some part has are added to
        `_used`: what no cell adds is for nobody.
        """
        declared: dict[str, tuple[Option, ...]] = {"data": DATA_OPTIONS}
        if strategy != "auto":
            declared |= {"problem": tuple(request.recipe.options),
                         "model": request.model.declared_options,
                         "criterion": request.criterion.declared_options,
                         "solver": request.solver.declared_options, "search": SEARCH_OPTIONS}
        # What stands next to a part and is no option of its own is for everything in its cells, as
        # with --set: next to a solver its local refinement, next to a problem a model's degree.
        chosen: dict[str, Any] = {}
        for role, spec in specs.items():
            if spec is None or role in ("problem", "method"):
                continue
            own_names = {option.name for option in declared.get(role, ())}
            for key, value in spec.options.items():
                chosen[f"{role}.{key}" if key in own_names else key] = value
        problem = specs["problem"]
        for key, value in (problem.options if problem else {}).items():
            # Options next to the problem are for all its parts, unless one of them has its own.
            if not any(name.rpartition(".")[2] == key for name in chosen):
                chosen[key] = value
        for key, value in self._spec.options.items():
            prefix, _, bare = key.rpartition(".")
            having = []
            for role, options in declared.items():
                if prefix in ("", role) and bare in {option.name for option in options}:
                    having.append(role)
            if having:
                self._used.add(key)
            for role in having:
                # An instance has its options already.
                spec = specs.get(role)
                if bare not in chosen and not (spec and isinstance(spec.thing, Configurable)):
                    chosen.setdefault(f"{role}.{bare}", value)
        # Every cell has one thread, so that cells at the same time do not wait for each other.
        if any(option.name == "workers" for option in declared.get("solver", ())):
            chosen.setdefault("solver.workers", 1)
        return chosen


def _require_possible(strategy: str, request: Request) -> None:
    """Raise TermselError where the data of a request are too few, or do not suit its parts."""
    is_auto = strategy == "auto"
    observations = observe(with_shares(request, auto=is_auto), LEAST if is_auto else MIN_CONTROL)
    if not is_auto:
        with_problem_built(Task(request, observations))


def _checksums_of_parts(strategy: str, request: Request, specs: Mapping[str, PartSpec | None],
                        measures: Sequence[Measure]) -> dict[str, str]:
    """Return checksums of the code that cells run, by role.

    The checksums are part of what identifies a cell: a plugin that has changed makes its cells run
    again.
    """
    checksums = {role: checksum_of_code(getattr(request, role))
                 for role in ("recipe", "model", "criterion", "solver", "then")}
    if strategy == "auto":
        method = _resolve_method(specs.get("method"))
        checksums["methods"] = checksum_of_code(list(auto_of(method).methods))
    # The code of a measure is part of what its column says.
    if measures:
        checksums["measures"] = checksum_of_code([measure.compute for measure in measures])
    return checksums


def _require_no_certificate(request: Request) -> Request:
    """Refuse a certificate: it is a file of the folder of a result, which cells have not."""
    if request.solver.options.get("certificate"):
        raise TermselError("runs of a study keep no certificates",
                           hint="Do the run alone: termsel run ... --out DIR.",
                           name="certificate")
    return request


def _resolve_method(method: PartSpec | None) -> Any:
    """Return the method of a study, by itself or by name; None for the automatic choice."""
    return None if method is None else method.thing or method.name


def _make_cell(spec: Spec, strategy: str, specs: Mapping[str, PartSpec | None], kind: _Kind,
               data: Data, split: int, seed: int) -> Cell:
    """Return a cell: its labels, its call, and the key by which the journal finds it.

    `split` and `seed` are those of the roles and of the search. The key is a checksum of all that
    the result depends on, so that a finished cell is found again; that of the instance leaves out
    the solver and its limits, as runs that differ in these alone have one optimum.
    """
    problem = specs["problem"]
    # What tables call the cell; of auto the method is not known before it has run.
    labels = {
        "problem": problem.label if problem else "", "data": data.label, "split": split,
        "strategy": strategy, **{
            role: spec_of_role.label if (spec_of_role := specs[role]) else kind.names.get(role, "")
            for role in ("model", "criterion", "solver")}, "seed": seed}
    if strategy == "auto":
        method = specs.get("method")
        labels |= {"model": "", "criterion": "press",
                   "solver": "auto" if method is None else method.label}
    options = {**kind.options}
    if spec.splits != (0,):
        options["data.split"] = split
    call = {**{role: part and part.name for role, part in specs.items()}, "strategy": strategy,
            "options": options, "seed": seed, **spec.budget}
    if spec.measures:
        call["measures"] = list(spec.measures)
    if strategy == "auto":
        call["exports"] = list(spec.exports)
    objects = {role: component.thing for role, component in specs.items()
               if component and component.thing}
    # All that the result depends on: the journal finds a finished cell by this checksum.
    identity = {**call, "labels": labels, "data": data.key, "made_of": kind.made_of}
    # Two runs of one instance can be compared: they have the same optimum.
    # The optimum depends on all of that but the solver, its seed and its limits.
    instance = {
        "data": data.key, "problem": call["problem"],
        "options": {name: value for name, value in options.items()
                    if not name.startswith(("solver.", "search.")) and name not in _OF_SEARCH},
        "made_of": {role: checksum for role, checksum in kind.made_of.items()
                    if role not in ("solver", "then")}}
    return Cell(_key_of_content(identity), labels, call, data, instance=_key_of_content(instance),
                things=objects,
                others=kind.others)


def _measures_of(spec: Spec) -> list[Measure]:
    """Return the measures that a study names; refuse one that a column of the table hides."""
    names = registry()
    for i, name in enumerate(spec.measures):
        if names.known("measures", name) is None:
            unknown = unknown_name_error("measure", name, names.names("measures"))
            raise spec.places.error(("measures", i), unknown.what, unknown.hint)
        if name in columns_of(STRATEGIES):
            raise spec.places.error(("measures", i), f"every study has a column {name!r}",
                                    "Give the measure another name.")
    return [names.get("measures", name) for name in spec.measures]


def _uses_foreign_parts(strategy: str, request: Request, measures: Iterable[Measure]) -> bool:
    """Return whether plugins that are not termsel's, or objects from Python, take part in cells."""
    own_distributions = {PROJECT, *own_packages()}
    # Which of its methods auto will fit is not known before.
    if strategy == "auto":  # its candidates are those of all plugins
        return any(slot.plugin.distribution not in own_distributions for slot in registry().slots)
    components = (request.model, request.criterion, request.solver, request.then)
    classes = [type(component) for component in components if component]
    entries = map(registry().origin, (request.recipe, *classes, *measures))
    if any(entry is not None and entry.provided_by == SESSION for entry in entries):
        return False  # what is registered in this process has a name in no other one
    code = (request.recipe.build, *classes, *(measure.compute for measure in measures))
    # A module's top-level package is its distribution, but for spelling.
    return not own_distributions.issuperset(
        canonical_name(component.__module__.partition(".")[0]) for component in code)


def _key_of_content(content: Mapping[str, Any]) -> str:
    """Return the checksum of content that can be JSON, the same for equal content."""
    # Sorted and without blanks, so that equal content is equal text.
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:24]
