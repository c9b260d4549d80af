"""Find plugins and load them one at a time, so that a broken one harms nothing else."""

from __future__ import annotations

import logging
import os
import re
import time
import traceback
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import cache, partial, wraps
from importlib.machinery import PathFinder
from importlib.metadata import Distribution, EntryPoint, distributions
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeVar

import pluggy

from termsel.core.errors import exception_in_words, unknown_name_error
from termsel.core.isolation.faults import (
    OWN,
    TooSlow,
    call_within,
    code_of,
    distribution_of,
    remember,
    surroundings_kept,
)
from termsel.core.isolation.parts import PLUGINS_VARIABLE, canonical_name, chosen_packages
from termsel.core.version import PLUGIN_API, __version__
from termsel.plugins import builtin, hookspecs
from termsel.plugins.hookspecs import PROJECT
from termsel.plugins.requirements import version_fits

log = logging.getLogger(__name__)

T = TypeVar("T")

LIMIT = 30.0
"""Seconds that an import, or a hook, may take; a plugin that takes longer is left out."""

SOON = 10.0
"""Seconds after which a message names the plugin that is waited for."""

LISTENER = f"{PROJECT}_run_finished"
OF_EVERY_RUN = (LISTENER, f"{PROJECT}_observers", f"{PROJECT}_sections")
"""Hooks that are called in every run."""

HOOKS = tuple(name for name in vars(hookspecs) if name.startswith(f"{PROJECT}_"))
"""Names of all hooks."""


@dataclass(frozen=True)
class Plugin:
    """An installed plugin: its entry point, the package it comes in, and its hooks once loaded.

    `requires` are the versions of termsel that the package states to need; empty if none.
    """

    name: str
    distribution: str
    version: str
    hooks: tuple[str, ...] = ()
    requires: str = ""

    def remark(self, text: str) -> Remark:
        """Return a remark on the plugin."""
        return Remark(self.name, self.distribution, self.version, text)


@dataclass(frozen=True)
class Remark:
    """What a plugin's author should know: something that does not work, after its hook if any."""

    plugin: str
    distribution: str
    version: str
    what: str

    def __str__(self) -> str:
        package = f"{self.distribution} {self.version}".strip()
        plugin = f"plugin {self.plugin!r} of " if self.plugin else ""
        return f"{plugin}{package}: {self.what}"


def run_plugin_code(call: Callable[[], T], package: str = OWN, seconds: float | None = None,
                    ) -> tuple[T, None] | tuple[None, str]:
    """Return the value of a call into a plugin and None, or None and why it failed, in words.

    The call has a thread of its own, and so many `seconds`, by default `LIMIT`. Working folder and
    filters of warnings are put back after it. ``TERMSEL_DEBUG=1`` shows the traceback of what it
    raises. `package` is the top-level module of the plugin; code of termsel is called as it is.
    """
    def contained() -> tuple[T, None] | tuple[None, str]:
        """Return the value of a call and None, or None and why it failed."""
        try:
            return call(), None
        # A plugin may raise anything at all, even leave the program while it is imported, and
        # must not take termsel or another plugin with it. This is the one place for that.
        except BaseException as error:
            # Ctrl-C interrupts the thread that waits, never that of a plugin.
            if package == OWN and isinstance(error, KeyboardInterrupt):
                raise
            if os.environ.get("TERMSEL_DEBUG") == "1":
                traceback.print_exc()
            return None, exception_in_words(error)

    limit = LIMIT if seconds is None else seconds
    try:
        with surroundings_kept(), code_of(package):
            return contained() if package == OWN else call_within(
                limit, contained, soon=SOON, tell=partial(_warn_of_slow_loading, package))
    except TooSlow:
        return None, f"it takes more than {limit:g} s"


def _warn_of_slow_loading(package: str) -> None:
    """Say once that loading a package takes long, and what follows."""
    log.warning("Note: loading the package %s has taken %g s so far; the machine may be busy. "
                "After %g s it is left out. Ctrl-C ends the command.",
                distribution_of(package), SOON, LIMIT)


@dataclass
class Slot:
    """A plugin and its code, which is imported when something needs it."""

    plugin: Plugin
    load: Callable[[], Any]
    module: str  # whose import `load` is
    may_have: Callable[[str], bool]  # False for hooks that it certainly does not implement
    hooks: dict[str, pluggy.HookImpl] = field(default_factory=dict)  # once it is loaded
    loaded: bool = False
    seconds: float = 0.0  # of its import and its hooks
    left_out: str = ""  # why it is not asked any more: it took too long

    @property
    def package(self) -> str:
        """The top-level module."""
        return self.module.partition(".")[0]

    def attempt(self, call: Callable[[], T], seconds: float | None = None,
                ) -> tuple[T, None] | tuple[None, str]:
        """Run code of the plugin as `run_plugin_code` does, and note how long it takes.

        Returned are its value and None, or None and the reason why it failed or was not called.
        """
        if self.left_out:
            return None, self.left_out
        # Import and hooks of a plugin count together, for `termsel plugins`.
        start = time.perf_counter()
        value, reason = run_plugin_code(call, self.package, seconds)
        seconds_taken = time.perf_counter() - start
        self.seconds += seconds_taken
        if reason is not None and seconds_taken > (seconds or LIMIT):
            self.left_out = "it is not called, as it took too long before"
        return value, reason  # type: ignore[return-value]


class Loader:
    """The plugins and their hooks, of entry points as in `termsel.plugins.registry.Registry`."""

    def __init__(self, entry_points: Iterable[EntryPoint] | None = None) -> None:
        """List the plugins, what is built in first, without importing any of them."""
        self.failures: list[Remark] = []
        self._missing: list[Plugin] = []
        # Metadata alone: a plugin is imported when something needs it.
        points = self._usable_entry_points() if entry_points is None else entry_points
        external = [Slot(_plugin_of(point), point.load, point.module, hooks_in_source(point))
                    for point in points]
        self.slots = [
            Slot(Plugin("builtin", PROJECT, __version__), lambda: builtin, builtin.__name__,
                 lambda _hook: True),
            *sorted(external, key=lambda slot: (slot.plugin.distribution, slot.plugin.name))]

    @property
    def plugins(self) -> list[Plugin]:
        """All plugins so far, the built-in one first; those that are not loaded are known by name.
        """
        return [*(slot.plugin for slot in self.slots), *self._missing]

    def load_all(self) -> None:
        """Import every plugin."""
        for slot in self.slots:
            if not slot.loaded:
                self._load(slot)

    def slots_of(self, hook: str) -> list[Slot]:
        """Return the plugins that implement a hook, the built-in one first; import no others."""
        for slot in self.slots:
            if not slot.loaded and slot.may_have(hook):
                self._load(slot)
        return [slot for slot in self.slots if hook in slot.hooks]

    def _usable_entry_points(self) -> list[EntryPoint]:
        """Return the entry points of the installed plugins that may be used.

        The variable TERMSEL_PLUGINS may name those that count. A distribution whose metadata cannot
        be read, or that is named and not installed, is noted as missing, with the reason; the
        others go on.
        """
        chosen_names = chosen_packages()
        # termsel's own entry point serves other programs; `builtin` is loaded without it, so
        # that termsel works from a source folder that is not installed.
        names_seen = {PROJECT}
        points: list[EntryPoint] = []
        # Not entry_points(): one package with unreadable metadata would hide all plugins.
        for distribution in distributions():
            of_plugins, fault = _plugin_entry_points(distribution)
            if not of_plugins and not fault:
                continue
            name = _name_of(distribution)
            # Of a distribution that is found twice, Python imports the first.
            if name not in names_seen and (chosen_names is None or name in chosen_names):
                points += of_plugins
                if fault:
                    self._missing.append(Plugin("", name, ""))
                    self.failures.append(self._missing[-1].remark(fault))
            names_seen.add(name)
        for name in sorted((chosen_names or set()) - names_seen):
            self._missing.append(Plugin("", name, ""))
            near = get_close_matches(name, names_seen - {PROJECT}, n=1)
            question = f". Did you mean {near[0]}?" if near else ""
            self.failures.append(self._missing[-1].remark(
                f"named in {PLUGINS_VARIABLE}, but not installed{question}"))
        return points

    def _load(self, slot: Slot) -> None:
        """Import a plugin and register its hooks, once; note why that fails.

        A plugin that fails counts as loaded, without hooks: nothing is tried twice.
        """
        slot.loaded = True
        plugin = slot.plugin
        manager = new_manager()
        remember(slot.package, f"{plugin.distribution} {plugin.version}".strip())
        if not version_fits(plugin.requires, __version__):
            self.failures.append(plugin.remark(
                f"not loaded: it is for termsel{plugin.requires}, and this is {__version__}; "
                f"install a version of it for termsel {PLUGIN_API}"))
            return
        module, reason = slot.attempt(slot.load)
        if reason is not None:
            self.failures.append(plugin.remark(f"cannot be imported: {reason}"))
            return
        _, reason = slot.attempt(lambda: manager.register(module, _cache_key(plugin)))
        if reason is not None:
            self.failures.append(plugin.remark(f"does not fit the hooks: {reason}"))
            return
        hooks = {}
        for caller in manager.get_hookcallers(module) or ():
            for implementation in caller.get_hookimpls():
                hooks[caller.name] = implementation
        if not hooks:
            self.failures.append(plugin.remark(
                "no hooks; its functions need the decorator termsel.hookimpl"))
        # Its other hooks count: it may be written for a later termsel that has more of them.
        for hook in sorted(hooks.keys() - set(HOOKS)):
            self.failures.append(plugin.remark(str(unknown_name_error("hook", hook, HOOKS))))
        slot.hooks = {hook: hooks[hook] for hook in sorted(hooks.keys() & set(HOOKS))}
        slot.plugin = replace(plugin, hooks=tuple(slot.hooks))


def new_manager() -> pluggy.PluginManager:
    """Return a manager that knows the hooks, and no plugins."""
    manager = pluggy.PluginManager(PROJECT)
    manager.add_hookspecs(hookspecs)
    return manager


def hooks_in_source(point: EntryPoint) -> Callable[[str], bool]:
    """Return a function that shows whether a plugin may implement a hook, without importing it."""
    @cache
    def source() -> str:
        return "" if point.attr else _module_source(point.module)

    def may_have(hook: str) -> bool:
        """Return whether a module may implement a hook, judged by its source without an import."""
        # A hook can only be left out where the source of the module is there and takes no names
        # from elsewhere by ``*``. A source without names of hooks may make them, yet only those
        # that are asked for by name: every run would wait for the others.
        text = source()
        return (hook in text or "import *" in text or not text
                or (hook not in OF_EVERY_RUN and not any(name in text for name in HOOKS)))

    return may_have


def _module_source(module: str) -> str:
    """Return the text of a module, found without an import; "" if it cannot be found."""
    # Package by package, as an import would go, but without running any code.
    spec = None
    path = None
    names = module.split(".")
    for i in range(len(names)):
        spec = PathFinder.find_spec(".".join(names[:i + 1]), path)
        if spec is None:
            return ""
        path = spec.submodule_search_locations
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        return ""
    try:
        return Path(spec.origin).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return ""


def _cache_key(plugin: Plugin) -> str:
    """Return the key of a plugin: distribution and name."""
    return f"{plugin.distribution}:{plugin.name}"


def _plugin_entry_points(distribution: Distribution) -> tuple[list[EntryPoint], str]:
    """Return the entry points of a distribution's plugins, and what is wrong with its metadata.

    The second is a clause such as "its entry_points.txt cannot be read: ..."; "" if nothing is
    wrong.
    """
    points, reason = run_plugin_code(lambda: [
        point for point in distribution.entry_points.select(group=PROJECT) if point.module])
    if points is None:
        _spare_numba()
        return [], f"its entry_points.txt cannot be read: {reason}"
    if points and run_plugin_code(lambda: _distribution_names(distribution))[1]:
        return [], "its METADATA is missing or cannot be read; install it again"
    # Reversed, so that of two with a name the first is kept.
    first = {point.name: point for point in reversed(points)}
    if len(first) < len(points):
        twice = next(point.name for point in points if first[point.name] is not point)
        return list(first.values()), (f"its entry_points.txt names {twice!r} twice; only the first "
                                      "is used")
    return points, ""


def _spare_numba() -> None:
    """Let numba look for its extensions now, where metadata cannot be read: it fails only once."""
    from termsel.adjustment.numba_settings import import_numba

    import_numba()
    from numba.core.entrypoints import init_all

    run_plugin_code(init_all)


def _name_of(distribution: Distribution) -> str:
    """Return the name of a distribution: by its folder where it has no readable metadata."""
    name, _ = run_plugin_code(lambda: _distribution_names(distribution)[0])
    folder = Path(str(getattr(distribution, "_path", "unknown"))).name
    return name or canonical_name(folder.partition("-")[0])


def _plugin_of(point: EntryPoint) -> Plugin:
    """Return the plugin of an entry point, with its distribution and version if it has one."""
    if point.dist is None:  # made by hand, not found in a distribution
        return Plugin(point.name, canonical_name(point.module), "")
    name, version, requires = _distribution_names(point.dist)
    return Plugin(point.name, name, version, requires=requires)


@cache  # metadata are parsed whenever they are asked for
def _distribution_names(distribution: Distribution) -> tuple[str, str, str]:
    """Return name, version and required termsel: metadata are parsed whenever they are asked for.
    """
    metadata = distribution.metadata
    # Extras may follow the name, and a condition the versions: "termsel[gis]>=0.3 ; ...".
    stated = (re.match(r"termsel\s*(?:\[[^]]*])?\s*\(?([<>=!~][^;)]*)", requirement, re.IGNORECASE)
              for requirement in metadata.get_all("Requires-Dist") or ())
    requires = next((match[1].replace(" ", "") for match in stated if match), "")
    return canonical_name(metadata["Name"]), metadata["Version"] or "", requires


# Call a hook by pluggy, wrappers and order included, so that a broken plugin harms no other.

MAX_RETURNED = 10_000
"""Things that a plugin may return from a hook: a generator without an end is no list."""


@dataclass
class Answers:
    """What plugins answered to a hook."""

    # each thing with its plugin, in pluggy's order
    items: list[tuple[Plugin, Any]] = field(default_factory=list)
    # plugins that failed, with the reason
    faults: list[tuple[Plugin, str]] = field(default_factory=list)


Arguments = Mapping[str, Callable[[Plugin], Any]]
"""What makes each argument of a hook, a new one for each plugin."""

Taken = Callable[[Any], list[Any]]
"""Takes what a plugin returned; returns the things that it gives."""


def call(hook: str, slots: Sequence[Slot], accept: Taken, arguments: Arguments | None = None,
         seconds: float | None = None) -> Answers:
    """Return what the plugins of `slots`, which implement a hook, answer to it, through pluggy.

    `arguments` are those of the hook, by name. `accept` makes a list of a plugin's answer, and
    raises TypeError for what a plugin may not return. Each plugin may take so many seconds, by
    default as long as an import. Plugins that fail are among the faults of the answers.
    """
    answers = Answers()
    if not slots:
        return answers
    givers = _Givers()
    arguments = arguments or {}
    # ``tryfirst``, ``trylast`` and wrappers work as pluggy documents them. Without them the
    # built-in plugin is called first, and others follow by distribution and name.
    manager = new_manager()
    # pluggy calls first what is registered last.
    for slot in reversed(slots):
        is_wrapper = slot.hooks[hook].wrapper or slot.hooks[hook].hookwrapper
        guard = _guard_wrapper if is_wrapper else _guard_implementation
        function = guard(slot, slot.hooks[hook], arguments, accept, answers=answers,
                         givers=givers, seconds=seconds)
        manager.register(SimpleNamespace(**{hook: function}), _slot_key(slot))
    # pluggy passes arguments by name; each guard replaces them by its plugin's own.
    results = getattr(manager.hook, hook)(**dict.fromkeys(arguments))
    for items in results:
        answers.items += [(givers.of(item), item) for item in items]
    return answers


class _Givers:
    """Which plugin gave a thing: wrappers pass on the things of others."""

    def __init__(self) -> None:
        self._plugins: dict[int, tuple[Plugin, Any]] = {}  # with the thing, so that its id stays

    def gave(self, plugin: Plugin, items: Iterable[Any]) -> None:
        for item in items:
            self._plugins.setdefault(id(item), (plugin, item))

    def of(self, item: Any) -> Plugin:
        return self._plugins[id(item)][0]


def list_hook_values(value: Any) -> list[Any]:
    """Return the value of a hook as a list.

    Raises TypeError if it is no iterable, or has more than MAX_RETURNED items.
    """
    if isinstance(value, str | type) or not isinstance(value, Iterable):
        raise TypeError(f"returned {value!r}, not a list")
    items: list[Any] = []
    for item in value:
        items.append(item)
        if len(items) > MAX_RETURNED:
            raise TypeError(f"returned more than {MAX_RETURNED:,} things; the list must end")
    return items


def _guard_implementation(
    slot: Slot,
    implementation: pluggy.HookImpl,
    arguments: Arguments,
    accept: Taken,
    answers: Answers,
    givers: _Givers,
    seconds: float | None,
) -> Callable[..., Any]:
    """Return the implementation of a hook by one plugin, guarded so that it never raises.

    It returns the list of things that `accept` takes of the plugin's answer, None for none. A fault
    is noted in `answers`, and which plugin gave what in `givers`. The plugin has so many seconds.
    """
    @wraps(implementation.function)
    def answer(*_args: Any, **_keywords: Any) -> list[Any] | None:
        """Return the things that one plugin gives for the hook, None for none; note its fault."""
        items, reason = slot.attempt(
            lambda: accept(_call_hook(implementation, slot.plugin, arguments)), seconds)
        if reason is not None:
            answers.faults.append((slot.plugin, reason))
        givers.gave(slot.plugin, items or ())
        return items or None

    return answer


def _guard_wrapper(slot: Slot, implementation: pluggy.HookImpl, arguments: Arguments,
                   _accept: Taken, answers: Answers, givers: _Givers,
                   seconds: float | None) -> Callable[..., Any]:
    """Return a wrapper that never raises; if it fails, the inner answers stand.

    pluggy runs a wrapper up to its `yield`, then the others, then the rest of it. Each part is
    attempted by itself, so that an exception, or a wait of more than `seconds`, is noted as a fault
    of the plugin and costs the others nothing. Wrappers of the old kind (`hookwrapper`) get a
    result object. The parameters are those of `_guard_implementation`.
    """
    @wraps(implementation.function)
    def wrap(*_args: Any, **_keywords: Any) -> Generator[None, Any, Any]:
        """Run a plugin's wrapper around the others; if it fails, their answers stand."""
        def begin() -> Generator[None, Any, Any]:
            running: Generator[None, Any, Any] = _call_hook(implementation, slot.plugin, arguments)
            next(running)
            return running

        running, reason = slot.attempt(begin, seconds)
        inner = yield
        # An old wrapper gets a pluggy.Result, and changes it.
        before = inner if implementation.wrapper else inner.get_result()
        outcome = None
        if running is not None:
            outcome, reason = slot.attempt(partial(_finish_wrapper, running, inner), seconds)
        if reason is not None:
            answers.faults.append((slot.plugin, f"as a wrapper: {reason}"))
        for items in outcome or ():
            givers.gave(slot.plugin, items)
        final = before if outcome is None else outcome
        if implementation.hookwrapper:
            inner.force_result(final)
        return final

    return wrap


def _finish_wrapper(running: Generator[None, Any, Any], inner: Any) -> list[list[Any]] | None:
    """Send a wrapper the inner lists; return the lists that it returns, None for none.

    Raises TypeError or RuntimeError if it returns none of the lists that it got, or yields twice.
    """
    old = not isinstance(inner, list)
    try:
        running.send(inner if old else list(inner))
    except StopIteration as end:
        outcome = inner.get_result() if old else end.value
        if outcome is None and inner:
            raise TypeError("returned nothing; a wrapper returns the lists that it gets") from None
        return None if outcome is None else [list_hook_values(items)
                                             for items in list_hook_values(outcome)]
    # A wrapper yields once: what it does after that is not defined.
    running.close()
    raise RuntimeError("it yields twice")


def _call_hook(implementation: pluggy.HookImpl, plugin: Plugin, arguments: Arguments) -> Any:
    """Return the value of a hook, called with the arguments it names, made for this plugin."""
    # Made for each plugin by itself, so that none changes what another one gets.
    return implementation.function(
        *(arguments[name](plugin) for name in implementation.argnames),
        **{name: arguments[name](plugin) for name in implementation.kwargnames
           if name in arguments})


def _slot_key(slot: Slot) -> str:
    """Return the key of a slot of termsel's plugins."""
    return f"{PROJECT}:{slot.plugin.distribution}:{slot.plugin.name}"
