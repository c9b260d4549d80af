"""Functions that numba compiles when they are first called.

Numba takes long to import, and much of what termsel does calls no kernel.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial, update_wrapper
from typing import Any, TypeVar, cast

_Function = TypeVar("_Function", bound=Callable[..., Any])


class Later:
    """What stands for a kernel, or a part of kernels, until it is called or compiled."""

    def __init__(self, made: Callable[[], Any], part: Callable[[], Any] | None = None) -> None:
        self._make, self._make_part = made, part

    @cached_property
    def made(self) -> Any:
        """What numba knows."""
        return self._make()

    @cached_property
    def part(self) -> Any:
        """The same as a part of kernels, without what Python calls it by: that takes long."""
        return self._make_part() if self._make_part else self.made

    @cached_property
    def _numba_type_(self) -> Any:
        """What numba asks for where a kernel that it compiles uses this."""
        from termsel.adjustment.dispatchers import type_of

        return type_of(self.part)

    def __call__(self, *args: Any) -> Any:
        return self.made(*args)


def compiled(function: _Function, **flags: Any) -> _Function:
    """Compile on first call and keep the machine code on disk, where there is a place for it.

    Flags are those of `numba.njit`. The first call raises TermselError where numba is to compile
    nothing.
    """
    made = Later(partial(_dispatcher, function, flags),
                 partial(_dispatcher, function, {**flags, "no_cpython_wrapper": True}))
    return cast(_Function, update_wrapper(made, function))


def _dispatcher(function: Callable[..., Any], flags: dict[str, Any]) -> Any:
    from termsel.adjustment.dispatchers import dispatcher_of

    return dispatcher_of(function, flags)


def is_compiled(function: Callable[..., Any]) -> bool:
    """Return whether a function that `compiled` returned can be called at once."""
    from termsel.adjustment.dispatchers import has_code

    return has_code(cast(Later, function).made)
