"""The guard of methods: every class of a plugin has it, and no class of termsel pays for it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cached_property, wraps
from typing import Any, ClassVar

from termsel.core.isolation.faults import (
    OWN,
    attribute_errors_to,
    fault_of_method,
    package_of,
    running_package,
)

Check = Callable[..., str | None]
"""Takes the object, what a method returned and the method's arguments; returns what is wrong with
it and what was expected, after the name of the method, or None."""

_off: ContextVar[bool] = ContextVar("off", default=False)


@contextmanager
def without_guards() -> Iterator[None]:
    """Call plugins as they are, as the conformance suites do, which find more than the guard."""
    token = _off.set(True)
    try:
        yield
    finally:
        _off.reset(token)


class Guarded:
    """Base of what plugins derive from: methods of theirs that termsel calls are guarded.

    A subclass that is defined outside termsel gets each of its `guards` wrapped when it is made.
    What the method raises becomes a `termsel.core.isolation.faults.PluginFault`, which names the
    plugin and the line; what it returns is checked. Calls from within the same package are not
    guarded again.
    """

    kind: ClassVar[str] = ""
    """What one of them is called in messages."""

    guards: ClassVar[Mapping[str, Check | None]] = {}
    """The methods, with a check of what they return. A subclass adds to those of its base."""

    def __init_subclass__(cls, **options: Any) -> None:
        """Wrap the guarded methods and the properties of a subclass from outside termsel."""
        super().__init_subclass__(**options)
        if package_of(cls) == OWN:
            return
        # Properties that termsel reads, although it declares no check of them.
        guards = dict.fromkeys(name for name, value in vars(cls).items()
                               if isinstance(value, property) and _is_own(cls, name))
        for name, check in {**guards, **_guards_by_method(cls)}.items():
            method = cls.__dict__.get(name)
            if isinstance(method, property) and method.fget is not None:
                setattr(cls, name, property(_guard_of(name, method.fget, check), method.fset,
                                            method.fdel, method.__doc__))
            # A cached property must know its name again, under which it keeps its value.
            elif isinstance(method, cached_property):
                cached = cached_property(_guard_of(name, method.func, check))
                cached.__set_name__(cls, name)
                setattr(cls, name, cached)
            elif callable(method) and not isinstance(method, type):
                wrapped = _guard_of_iterator if name in ("generations", "moves",
                                                         "steps") else _guard_of
                setattr(cls, name, wrapped(name, method, check))


def _is_own(cls: type, name: str) -> bool:
    """Return whether termsel declares an attribute, which a plugin may compute."""
    return any(name in vars(base) or name in vars(base).get("__annotations__", {})
               for base in cls.__mro__ if package_of(base) == OWN)


def _guards_by_method(cls: type) -> dict[str, Check | None]:
    """Return the checks of a class and all its bases by method; None for one without a check."""
    guards: dict[str, Check | None] = {}
    # From the most general class on: a subclass may replace a check.
    for base in reversed(cls.__mro__):
        guards.update(base.__dict__.get("guards", {}))
    return guards


def _guard_of(name: str, function: Callable[..., Any], check: Check | None) -> Callable[..., Any]:
    """Return the guard of a method or of a property's function.

    Exceptions become PluginFaults that name the method `name`, and `check` looks at its value.
    Calls from the plugin's own package pass as they are: the outermost call names the plugin.
    """
    @wraps(function)
    def call(self: Any, *args: Any, **options: Any) -> Any:
        # A method that another one of the plugin calls is within the guard of that.
        if _off.get() or running_package() == package_of(type(self)):
            return function(self, *args, **options)
        with attribute_errors_to(self, name):
            value = function(self, *args, **options)
        return _check_returned(check, self, name, value, *args, **options)

    return call


def _check_returned(check: Check | None, plugin_object: Any, name: str, value: Any, *args: Any,
                    **options: Any) -> Any:
    """Return what a method returned or yielded; raise PluginFault if the check finds a fault."""
    fault = check(plugin_object, value, *args, **options) if check is not None else None
    if fault is not None:
        raise fault_of_method(plugin_object, name, fault)
    return value


def _guard_of_iterator(name: str, function: Callable[..., Any],
                       check: Check | None) -> Callable[..., Any]:
    """Return the guard of a method that returns an iterator, each step of which is guarded.

    A generator runs between its steps as well, so that each `next` is guarded by itself: exceptions
    become PluginFaults that name the method `name`, and `check` looks at each value. Calls from the
    plugin's own package pass as they are.
    """
    @wraps(function)
    def call(self: Any, *args: Any, **options: Any) -> Any:
        needs_no_guard = _off.get() or running_package() == package_of(type(self))
        return (function if needs_no_guard else steps)(self, *args, **options)

    def steps(self: Any, *args: Any, **options: Any) -> Iterator[Any]:
        """Yield the values of a plugin's generator, each checked; its errors become PluginFaults.
        """
        with attribute_errors_to(self, name):
            iterator = iter(function(self, *args, **options))
        try:
            while True:
                with attribute_errors_to(self, name):
                    try:
                        value = next(iterator)
                    except StopIteration:
                        return
                yield _check_returned(check, self, name, value, *args, **options)
        finally:
            # A generator that is not run to its end frees what it holds; this may fail as well.
            with attribute_errors_to(self, name):
                getattr(iterator, "close", lambda: None)()

    return call
