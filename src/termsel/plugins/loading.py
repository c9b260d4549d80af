"""Find plugins and load them one at a time, so that a broken one harms nothing else."""

from __future__ import annotations

import os
import re
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import Distribution, EntryPoint, distributions
from typing import Any, TypeVar

import pluggy

from termsel.errors import unknown_name
from termsel.plugins import builtin, hookspecs
from termsel.plugins.hookspecs import PROJECT
from termsel.version import __version__

T = TypeVar("T")

HOOKS = tuple(name for name in vars(hookspecs) if name.startswith(f"{PROJECT}_"))
"""Names of all hooks."""


@dataclass(frozen=True)
class Plugin:
    """An installed plugin.

    Parameters
    ----------
    name : str
        Name of its entry point.
    distribution, version : str
        The package it comes in.
    hooks : tuple of str
        The hooks it implements; none where it could not be loaded.
    """

    name: str
    distribution: str
    version: str
    hooks: tuple[str, ...] = ()

    def remark(self, what: str) -> Remark:
        """Return a remark on the plugin."""
        return Remark(self.name, self.distribution, self.version, what)


@dataclass(frozen=True)
class Remark:
    """What a plugin's author should know: something that does not work, or is deprecated.

    Parameters
    ----------
    plugin, distribution, version : str
        As in `Plugin`.
    what : str
        What it is, after the hook concerned if there is one.
    """

    plugin: str
    distribution: str
    version: str
    what: str

    def __str__(self) -> str:
        package = f"{self.distribution} {self.version}".strip()
        return f"plugin {self.plugin!r} of {package}: {self.what}"


def attempt(call: Callable[[], T]) -> tuple[T, None] | tuple[None, str]:
    """Run code of a plugin.

    What it prints goes to stderr, as stdout belongs to results. ``TERMSEL_DEBUG=1`` shows
    the traceback of what it raises.

    Parameters
    ----------
    call : callable
        Without arguments.

    Returns
    -------
    value, reason
        The value and None, or None and what was raised.
    """
    try:
        with redirect_stdout(sys.stderr):
            return call(), None
    # A plugin may raise anything at all, even leave the program while it is imported, and
    # must not take termsel or another plugin with it. This is the one place for that.
    except (Exception, SystemExit) as error:  # noqa: BLE001
        if os.environ.get("TERMSEL_DEBUG") == "1":
            traceback.print_exc()
        return None, f"{type(error).__name__}: {' '.join(str(error).split())}"


def canonical(distribution: str) -> str:
    """Return the one spelling of a distribution's name for "A.B", "a-b" and "a_b"."""
    return re.sub(r"[-_.]+", "-", distribution.strip()).lower()


class Loader:
    """The plugins and their hooks.

    Parameters
    ----------
    entry_points : iterable of importlib.metadata.EntryPoint, optional
        As in `termsel.plugins.registry.Registry`.
    """

    def __init__(self, entry_points: Iterable[EntryPoint] | None = None) -> None:
        self._manager = pluggy.PluginManager(PROJECT)
        self._manager.add_hookspecs(hookspecs)
        self.plugins: list[Plugin] = []
        self.failures: list[Remark] = []
        self._load(Plugin("builtin", PROJECT, __version__), lambda: builtin)
        points = self._installed() if entry_points is None else entry_points
        external = [(_plugin_of(point), point) for point in points]
        for plugin, point in sorted(external, key=lambda x: (x[0].distribution, x[0].name)):
            self._load(plugin, point.load)

    def implementations(self, hook: str) -> Iterator[tuple[Plugin, Callable[..., Any]]]:
        """Yield each plugin that implements a hook, and its implementation.

        The implementation takes all arguments of the hook by keyword. The built-in plugin is
        the first, others follow by distribution and name.
        """
        found = {implementation.plugin_name: implementation
                 for implementation in getattr(self._manager.hook, hook).get_hookimpls()}
        for plugin in self.plugins:
            implementation = found.get(_key(plugin))
            if implementation is not None:
                yield plugin, partial(_call, implementation)

    def _installed(self) -> list[EntryPoint]:
        """Return the entry points of the installed plugins that may be used."""
        allowed = os.environ.get("TERMSEL_PLUGINS")
        wanted = {canonical(name) for name in (allowed or "").split(",") if name.strip()}
        # termsel's own entry point serves other programs; `builtin` is loaded without it, so
        # that termsel works from a source folder that is not installed.
        seen = {PROJECT}
        points: list[EntryPoint] = []
        # Not entry_points(): one package with unreadable metadata would hide all plugins.
        for distribution in distributions():
            found, _ = attempt(partial(_points_of, distribution))
            if not found:
                continue
            name = canonical(distribution.name)
            # Of a distribution that is found twice, Python imports the first.
            if name not in seen and (allowed is None or name in wanted):
                points += found
            seen.add(name)
        for name in sorted(wanted - seen):
            self._fail(Plugin("", name, ""), "named in TERMSEL_PLUGINS, but not installed")
        return points

    def _load(self, plugin: Plugin, load: Callable[[], Any]) -> None:
        module, reason = attempt(load)
        if reason is not None:
            self._fail(plugin, f"cannot be imported: {reason}")
            return
        _, reason = attempt(lambda: self._manager.register(module, _key(plugin)))
        if reason is not None:
            # Some versions of pluggy leave the hooks before the wrong one registered.
            self._manager.unregister(name=_key(plugin))
            self._fail(plugin, f"does not fit the hooks: {reason}")
            return
        hooks = sorted(caller.name for caller in self._manager.get_hookcallers(module) or ())
        if not hooks:
            self._fail(plugin, "no hooks; its functions need the decorator termsel.hookimpl")
            return
        self.plugins.append(replace(plugin, hooks=tuple(h for h in hooks if h in HOOKS)))
        # Its other hooks count: it may be written for a later termsel that has more of them.
        for hook in hooks:
            if hook not in HOOKS:
                self.failures.append(plugin.remark(str(unknown_name("hook", hook, HOOKS))))

    def _fail(self, plugin: Plugin, what: str) -> None:
        self.plugins.append(plugin)
        self.failures.append(plugin.remark(what))


def _key(plugin: Plugin) -> str:
    return f"{plugin.distribution}:{plugin.name}"


def _points_of(distribution: Distribution) -> list[EntryPoint]:
    return list(distribution.entry_points.select(group=PROJECT))


def _plugin_of(point: EntryPoint) -> Plugin:
    if point.dist is None:  # made by hand, not found in a distribution
        return Plugin(point.name, canonical(point.module), "")
    return Plugin(point.name, canonical(point.dist.name), point.dist.version or "")


def _call(implementation: pluggy.HookImpl, **arguments: Any) -> Any:
    return implementation.function(*(arguments[name] for name in implementation.argnames))
