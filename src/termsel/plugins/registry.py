"""The registry: everything built in and everything plugins provide, by kind and name."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import cache, partial
from importlib.metadata import EntryPoint
from itertools import chain, product
from typing import TYPE_CHECKING, Any

from termsel.core.errors import TermselError, make_printable, unknown_name_error
from termsel.core.isolation import parts
from termsel.core.isolation.faults import package_of
from termsel.core.isolation.parts import canonical_name
from termsel.core.options import Configurable
from termsel.plugins.commands import COMMANDS
from termsel.plugins.hookspecs import PROJECT
from termsel.plugins.kinds import KINDS, summary_line
from termsel.plugins.loading import (
    LISTENER,
    Loader,
    Plugin,
    Remark,
    Slot,
    Taken,
    call,
    list_hook_values,
    run_plugin_code,
)
from termsel.results.extras import sources

if TYPE_CHECKING:
    import click

    from termsel.results.result import Result
    from termsel.selection.solvers.ledger import Progress

HEARD = 600.0
"""Seconds that a plugin may take for a finished run, such as to send it somewhere."""

_OPTIONS_OF_KINDS = {"problems": "--problem", "models": "--model", "solvers": "--solver",
                     "methods": "--method", "criteria": "--criterion"}
"""Options of the command line that take the names of a kind."""

_MADE_OF = {"models": "a subclass of termsel.SensorModel: of termsel.RationalModel it needs name "
                      "and blocks(ground) alone",
            "solvers": "a subclass of termsel.Solver with name and generations(problem, rng)",
            "methods": "a termsel.Method, such as FunctionMethod(NAME, TITLE, function=FUNCTION)"}
"""What may stand for the name of a thing, by its kind."""

SESSION = "session"
"""What stands for a distribution with things that are registered in this process."""


@dataclass(frozen=True)
class Entry:
    """Something that has a name."""

    name: str  # ``distribution:name`` where another thing has the bare name
    summary: str  # one line
    provided_by: str  # distribution
    object: Any  # a class; of problems and data sets the description

    @property
    def full_name(self) -> str:
        """Its name as ``distribution:name``."""
        return f"{self.provided_by}:{self.name.rpartition(':')[2]}"

    def answers_to(self, name: str) -> bool:
        """Return True for the entry's name, bare or with its distribution before it."""
        distribution, _, bare = name.rpartition(":")
        # Distributions are named without regard to case, hyphens and underscores.
        return name == self.name or (canonical_name(distribution) == self.provided_by
                                     and bare == self.name.rpartition(":")[2])


@dataclass(frozen=True)
class Provided:
    """All that plugins provide of a kind, and what does not work."""

    entries: list[Entry] = field(default_factory=list)
    failures: list[Remark] = field(default_factory=list)


class Registry:
    """Everything that has a name.

    Plugins are loaded, and their hooks called, when a kind is needed that they may provide. Those
    of `entry_points` come after termsel's own: by default the installed ones; if the environment
    variable ``TERMSEL_PLUGINS`` is set, those of the distributions it lists, separated by commas.
    """

    def __init__(self, entry_points: Iterable[EntryPoint] | None = None) -> None:
        self._loader = Loader(entry_points)
        self._provided: dict[str, Provided] = {}
        self._parts: list[parts.Part] | None = None

    @property
    def plugins(self) -> tuple[Plugin, ...]:
        """All plugins, loaded now, the built-in one first, also those that could not be loaded."""
        self._loader.load_all()
        return tuple(self._loader.plugins)

    @property
    def slots(self) -> tuple[Slot, ...]:
        """All plugins with their modules, the built-in one first; not imported by this."""
        return tuple(self._loader.slots)

    def seconds(self) -> dict[Plugin, float]:
        """Return how long each plugin took: its import, and the hooks that were called [s]."""
        return {slot.plugin: slot.seconds for slot in self._loader.slots}

    def entries(self, kind: str) -> list[Entry]:
        """Return everything of a kind: one of `KINDS`, or "commands", those that plugins add."""
        return list(self._collect(kind).entries)

    def names(self, kind: str) -> list[str]:
        """Return the names of everything of a kind."""
        return [entry.name for entry in self.entries(kind)]

    def get(self, kind: str, name: str) -> Any:
        """Return the thing of a kind of `KINDS` that has a name, or ``distribution:name``.

        Raises TermselError, with the nearest names, where there is none.
        """
        if (item := self.known(kind, name)) is not None:
            return item
        raise unknown_name_error(
            KINDS[kind].in_words, name, self.names(kind), self.hint(name, kind),
            {entry.name: entry.summary for entry in self.entries(kind)})

    def known(self, kind: str, name: str) -> Any:
        """Return the thing of a kind by its name, as for `get`; None if nothing has the name."""
        # Built-in things first: no plugin takes a built-in name, nor is one imported to look it up.
        for source in (built_in(), self):
            for entry in source.entries(kind):
                if entry.answers_to(name):
                    return entry.object
        return None

    def resolve(self, kind: str, value: Any) -> Any:
        """Return what a name stands for among those of a kind of `KINDS`, or the value itself.

        A class whose objects must start without options is made one as a trial. Raises TermselError
        for an unknown name, or a value that is not of the kind.
        """
        if isinstance(value, str):
            return self.get(kind, value)
        try:
            # A class or an object: either is checked as what a hook returns.
            KINDS[kind].require_valid(value)
            if KINDS[kind].must_start and isinstance(value, type):
                value()
        except TypeError as error:
            why = str(error).removeprefix("returned ")  # as is said of what a hook returns
            # Of a class of the kind the reason says what is to be corrected.
            remedy = "Correct the class." if KINDS[kind].is_of(value) else (
                f"Give a name (termsel list {kind}), or "
                f"{_MADE_OF.get(kind, 'an object as a plugin returns it')}.")
            raise TermselError(f"{value!r} is no {KINDS[kind].word}: {why}",
                               hint=remedy) from error
        return value

    def register(self, item: Any) -> Any:
        """Make a thing known by its name in this process (see `termsel.register`).

        Raises TermselError for a thing of no kind.
        """
        for kind in KINDS:
            # Classes are registered, not objects with options.
            if not KINDS[kind].is_of(item) or isinstance(item, Configurable):
                continue
            item = self.resolve(kind, item)
            provided = self._collect(kind)
            entry = _entry_of(kind, Plugin(SESSION, SESSION, ""), item)
            # A thing registered again replaces the earlier one, as cells of a notebook are run
            # again.
            provided.entries[:] = [other_entry for other_entry in provided.entries
                                   if other_entry.full_name != entry.full_name]
            _add(provided.entries, entry, kind,
                 {other_entry.name: other_entry.provided_by for other_entry in provided.entries})
            return item
        raise TermselError(f"{item!r:.100} is nothing that termsel has names for",
                           hint="Register a class, such as a subclass of termsel.RationalModel "
                                "with name and blocks(ground), or an object such as "
                                "termsel.FunctionMethod(NAME, TITLE, function=FUNCTION). Kinds are "
                                f"{', '.join(KINDS)}.")

    def find(self, name: str) -> list[tuple[str, Entry]]:
        """Return kind and entry of everything that has a name."""
        matching = []
        for kind in KINDS:
            matching += [(kind, entry) for entry in self.entries(kind) if entry.answers_to(name)]
        return matching

    def origin(self, item: Any) -> Entry | None:
        """Return the entry of a class, `Recipe` or `DatasetSpec`; None if nothing provides it."""
        kinds = [kind for kind in KINDS if KINDS[kind].is_of(item)]
        # Equality: a recipe that comes from another process is not the same object.
        for names, kind in product((built_in(), self), kinds):
            for entry in names.entries(kind):
                if entry.object == item:
                    return entry
        return None

    def version(self, distribution: str) -> str:
        """Return the version of a distribution that provides a plugin; none of this session."""
        return next((plugin.version for plugin in self._loader.plugins
                     if plugin.distribution == distribution), "")

    def failures(self, *kinds: str) -> list[Remark]:
        """Return the remarks on plugins that cannot be loaded, then on things of the kinds.

        Kinds are those of `entries`; by default all of them, and every plugin is loaded.
        """
        if not kinds:
            self._loader.load_all()
        of_kinds = [self._collect(kind).failures for kind in kinds or (*KINDS, "commands")]
        return [*self._loader.failures, *chain.from_iterable(of_kinds)]

    def hint(self, name: str, *kinds: str) -> str:
        """Return a sentence on where an unknown name may come from; "" if nothing is known.

        Kinds are those of `entries` that were asked for the name; by default all.
        """
        if name == "auto":
            return "auto is a strategy: ask for --strategy auto, the default of rfm-terms."
        if missing := self.missing(name):
            return missing
        # A camera may be sought among the models, and is a method. What writes a file takes no such
        # options.
        others = [kind for kind, _ in self.find(name) if kind in _OPTIONS_OF_KINDS]
        if kinds and others and "writers" not in kinds:
            return f"{name} is a {KINDS[others[0]].word}: {_OPTIONS_OF_KINDS[others[0]]} {name}."
        if kinds == ("writers",) and "tif" in name.lower():
            return "A rectified image is written by termsel rectify."
        # A name may be unknown because its plugin fails. The names of termsel's own packages are
        # listed; any other that fails may be the one, hence the default [name].
        listed = parts.own_packages()
        broken = sorted({failure.distribution for failure in self.failures(*kinds)
                         if name in listed.get(canonical_name(failure.distribution), [name])})
        if not broken:
            return ""
        return (f"It may come from a plugin that does not work ({', '.join(broken)}): "
                "see termsel plugins.")

    def missing(self, name: str) -> str:
        """Return a sentence on the package that a name comes with, and how to install it.

        It is "" if the package is installed, or no package of termsel has the name.
        """
        # "distribution:name" says the package; else the list of the packages' names.
        package = canonical_name(name.rpartition(":")[0])
        if not package:
            package = parts.package_of_name(name)
        if package in ("", *(plugin.distribution for plugin in self._loader.plugins)):
            return ""
        if parts.is_left_out(package):
            return f"It comes with the package {package}, which {parts.LEFT_OUT}: unset it."
        return (f"It comes with the package {package}, which is not installed. "
                f"{parts.install_hint(package)}")

    def observers(self) -> list[Callable[[Progress], None]]:
        """Return the observers of runs that plugins provide.

        One that fails is left out, with a warning.
        """
        provided = self._provided_without_names("observers", list_hook_values)
        return [_failsafe_observer(plugin, observe) for plugin, observe in provided]

    def parts(self) -> list[parts.Part]:
        """Return the parts that plugins have; a plugin that fails is told."""
        # Asked once: plugins are imported for it.
        if self._parts is None:
            provided = self._provided_without_names("parts", _require_parts)
            self._parts = [extension for _, extension in provided]
        return self._parts

    def _provided_without_names(self, plural: str, accept: Taken) -> list[tuple[Plugin, Any]]:
        """Return the things without names that a hook gives, each with its plugin.

        Plugins that fail are left out, with a warning.
        """
        hook = f"{PROJECT}_{plural}"
        answers = call(hook, self._loader.slots_of(hook), accept)
        for plugin, reason in answers.faults:
            _warn(plugin, f"{hook}: {reason}")
        return answers.items

    def notify_run_finished(self, result: Result) -> None:
        """Give every plugin that asks for it a copy of a finished run; warn of those that fail."""
        answers = call(LISTENER, self._loader.slots_of(LISTENER), _accept_nothing,
                       # A copy for each: no plugin may change what another one, or the user, gets.
                       {"result": lambda _plugin: deepcopy(result)}, HEARD)
        for plugin, reason in answers.faults:
            _warn(plugin, f"{LISTENER}: {reason}")

    def _collect(self, kind: str) -> Provided:
        """Return the entries and failures of a kind; plugins are asked once."""
        if kind not in self._provided:
            hook = f"{PROJECT}_{kind}"
            if kind in KINDS:
                entries, faults = self._entries_of_kind(kind)
            else:
                entries, faults = self._plugin_commands()
            owners = dict.fromkeys(COMMANDS, PROJECT) if kind == "commands" else {}
            # Whoever is called first, a built-in thing keeps its name.
            owners |= {entry.name: PROJECT for _, entry in entries if entry.provided_by == PROJECT}
            provided = Provided()
            for plugin, entry in entries:
                clash = _add(provided.entries, entry, kind, owners)
                if clash is not None:
                    faults.append((plugin, clash))
            provided.failures.extend(plugin.remark(f"{hook}: {fault}") for plugin, fault in faults)
            self._provided[kind] = provided
        return self._provided[kind]

    def _entries_of_kind(self, kind: str) -> Offered:
        """Return the entries of a kind, each with its plugin, and the faults of all other things.
        """
        hook = f"{PROJECT}_{kind}"
        answers = call(hook, self._loader.slots_of(hook), list_hook_values)
        entries = []
        for plugin, item in answers.items:
            entry, reason = run_plugin_code(partial(_entry_of, kind, plugin, item))
            if entry is not None:
                entries.append((plugin, entry))
            if reason is not None:
                answers.faults.append((plugin, reason))
        return entries, answers.faults

    def _plugin_commands(self) -> Offered:
        """Return the commands that plugins add, each with its plugin, and the faults of the others.
        """
        import click

        # Each plugin has its own group, so that none replaces a command of another.
        # Commands come as click groups that the hooks fill.
        groups: dict[Plugin, click.Group] = {}
        hook = f"{PROJECT}_commands"
        answers = call(hook, self._loader.slots_of(hook), _accept_nothing,
                       {"cli": lambda plugin: groups.setdefault(plugin, click.Group())})
        entries = []
        for plugin, group in groups.items():
            for name, command in group.commands.items():
                line = command.get_short_help_str()
                entries.append((plugin, Entry(name, line, plugin.distribution, command)))
        return entries, answers.faults


Offered = tuple[list[tuple[Plugin, Entry]], list[tuple[Plugin, str]]]
"""Entries with their plugins, and plugins with their faults."""


@cache  # the plugins of this process: who needs others makes a Registry
def registry() -> Registry:
    """Return the registry of this process, with all installed plugins."""
    return Registry()


@cache  # termsel's own things, which are the same in every process
def built_in() -> Registry:
    """Return the registry of termsel's own things, which needs no plugin."""
    return Registry([])


sources.append(lambda: [entry.object for entry in registry().entries("sections")])
parts.sources.append(lambda: registry().parts())


def _warn(plugin: Plugin, text: str) -> None:
    """Print a warning on a plugin to stderr."""
    print(make_printable(f"Warning: {plugin.remark(text)}"), file=sys.stderr)


def _failsafe_observer(
    plugin: Plugin, observe: Callable[[Progress], None]
) -> Callable[[Progress], None]:
    """Return an observer of a plugin that ends with its first failure, and not the run."""
    failed = False

    def observed(progress: Progress) -> None:
        """Tell the plugin's observer, until it fails for the first time."""
        nonlocal failed
        # After its first failure it is not called again: it would fail every generation.
        reason = None if failed else run_plugin_code(
            lambda: observe(progress), package_of(observe))[1]
        if reason is not None:
            failed = True
            _warn(plugin, f"an observer failed: {reason}")

    return observed


def _accept_nothing(_value: Any) -> list[Any]:
    """Return [], whatever the hook returned: one that is called for its effect."""
    return []


def _require_parts(value: Any) -> list[Any]:
    """Return a list of parts; TypeError for anything else."""
    extensions = list_hook_values(value)
    if wrong := [extension for extension in extensions if not isinstance(extension, parts.Part)]:
        raise TypeError(f"returned an object of type {type(wrong[0]).__name__}, not a Part")
    return extensions


def _entry_of(kind: str, plugin: Plugin, item: Any) -> Entry:
    """Return the entry of a thing that a plugin gave; raises TermselError if it is at fault."""
    KINDS[kind].require_returned(item)
    return Entry(item.name, summary_line(item), plugin.distribution, item)


def _add(entries: list[Entry], entry: Entry, kind: str, owners: dict[str, str]) -> str | None:
    """Append an entry, by its full name if its name is taken.

    Returned is a clause on the clash, None without one.
    """
    full = f"{entry.provided_by}:{entry.name}"
    names = {existing.name for existing in entries}
    # Whoever has the name first keeps it; a second one is known by its full name.
    owner = owners.setdefault(entry.name, entry.provided_by)
    if owner == entry.provided_by and entry.name not in names:
        entries.append(entry)
        return None
    kind_name = KINDS[kind].word if kind in KINDS else "command"
    if owner == entry.provided_by or full in names:
        return f"provides the {kind_name} {entry.name!r} twice; only the first is kept"
    entries.append(replace(entry, name=full))
    return (f"provides the {kind_name} {entry.name!r}, a name that {owner} has too; "
            f"{full!r} selects this one")
