"""Call a hook by pluggy, wrappers and order included, so that a broken plugin harms no other."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial, wraps
from types import SimpleNamespace
from typing import Any

import pluggy

from termsel.plugins.hookspecs import PROJECT
from termsel.plugins.loading import Plugin, Slot, new_manager

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


def call(hook: str, slots: Iterable[Slot], accept: Taken, arguments: Arguments | None = None,
         seconds: float | None = None) -> Answers:
    """Call a hook of all plugins that implement it, the slots, through pluggy.

    `accept` raises TypeError for what a plugin may not return. Each plugin may take so many
    seconds, by default as long as an import.
    """
    answers = Answers()
    givers = _Givers()
    arguments = arguments or {}
    # ``tryfirst``, ``trylast`` and wrappers work as pluggy documents them. Without them the
    # built-in plugin is called first, and others follow by distribution and name.
    manager = new_manager()
    # pluggy calls first what is registered last.
    for slot in reversed(list(slots)):
        guard = _wrapper if slot.hooks[hook].wrapper or slot.hooks[hook].hookwrapper else _plain
        function = guard(slot, slot.hooks[hook], arguments, accept, answers=answers,
                         givers=givers, seconds=seconds)
        manager.register(SimpleNamespace(**{hook: function}), _key(slot))
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


def listed(value: Any) -> list[Any]:
    """Return what a hook returned as a list; TypeError if it is none, or has no end."""
    if isinstance(value, str | type) or not isinstance(value, Iterable):
        raise TypeError(f"returned {value!r}, not a list")
    items: list[Any] = []
    for item in value:
        items.append(item)
        if len(items) > MAX_RETURNED:
            raise TypeError(f"returned more than {MAX_RETURNED:,} things; the list must end")
    return items


def _plain(slot: Slot, implementation: pluggy.HookImpl, arguments: Arguments, accept: Taken,
           answers: Answers, givers: _Givers, seconds: float | None) -> Callable[..., Any]:
    """Return an implementation that never raises; what it returns is a list of things."""
    @wraps(implementation.function)
    def answer(*_args: Any, **_keywords: Any) -> list[Any] | None:
        """Return what one plugin gives for the hook; note its fault if it fails."""
        items, reason = slot.attempt(
            lambda: accept(_called(implementation, slot.plugin, arguments)), seconds)
        if reason is not None:
            answers.faults.append((slot.plugin, reason))
        givers.gave(slot.plugin, items or ())
        return items or None

    return answer


def _wrapper(slot: Slot, implementation: pluggy.HookImpl, arguments: Arguments, _accept: Taken,
             answers: Answers, givers: _Givers, seconds: float | None) -> Callable[..., Any]:
    """Return a wrapper that never raises; if it fails, what it wraps is the result."""
    @wraps(implementation.function)
    def wrap(*_args: Any, **_keywords: Any) -> Generator[None, Any, Any]:
        """Run a plugin's wrapper around the others; if it fails, their answers stand."""
        def begin() -> Generator[None, Any, Any]:
            running: Generator[None, Any, Any] = _called(implementation, slot.plugin, arguments)
            next(running)
            return running

        running, reason = slot.attempt(begin, seconds)
        inner = yield
        # An old wrapper gets a pluggy.Result, and changes it.
        before = inner if implementation.wrapper else inner.get_result()
        outcome = None
        if running is not None:
            outcome, reason = slot.attempt(partial(_ended, running, inner), seconds)
        if reason is not None:
            answers.faults.append((slot.plugin, f"as a wrapper: {reason}"))
        for items in outcome or ():
            givers.gave(slot.plugin, items)
        final = before if outcome is None else outcome
        if implementation.hookwrapper:
            inner.force_result(final)
        return final

    return wrap


def _ended(running: Generator[None, Any, Any], inner: Any) -> list[list[Any]] | None:
    """Send a wrapper what it wraps; return what it makes of it, None where that is nothing."""
    old = not isinstance(inner, list)
    try:
        running.send(inner if old else list(inner))
    except StopIteration as end:
        outcome = inner.get_result() if old else end.value
        if outcome is None and inner:
            raise TypeError("returned nothing; a wrapper returns the lists that it gets") from None
        return None if outcome is None else [listed(items) for items in listed(outcome)]
    # A wrapper yields once: what it does after that is not defined.
    running.close()
    raise RuntimeError("it yields twice")


def _called(implementation: pluggy.HookImpl, plugin: Plugin, arguments: Arguments) -> Any:
    # Made for each plugin by itself, so that none changes what another one gets.
    return implementation.function(
        *(arguments[name](plugin) for name in implementation.argnames),
        **{name: arguments[name](plugin) for name in implementation.kwargnames
           if name in arguments})


def _key(slot: Slot) -> str:
    return f"{PROJECT}:{slot.plugin.distribution}:{slot.plugin.name}"
