"""Functions that numba compiles when they are first called.

Numba takes long to import, and much of what termsel does calls no kernel.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial, update_wrapper
from typing import Any, TypeVar, cast

_Function = TypeVar("_Function", bound=Callable[..., Any])


class LazyKernel:
    """What stands for a kernel, or a part of kernels, until it is called or compiled.

    A kernel that Python calls and one that only other kernels call are compiled apart: the wrapper
    for Python takes long.
    """

    def __init__(self, make: Callable[[], Any],
                 make_inner: Callable[[], Any] | None = None) -> None:
        self._make = make
        self._make_inner = make_inner

    @cached_property
    def dispatcher(self) -> Any:
        """Numba's dispatcher of the function, made when first needed: it imports numba."""
        return self._make()

    @cached_property
    def inner_dispatcher(self) -> Any:
        """The dispatcher that other kernels use, without a wrapper for Python."""
        return self._make_inner() if self._make_inner else self.dispatcher

    @cached_property
    def _numba_type_(self) -> Any:
        """The numba type of this function, which numba asks for where another kernel calls it."""
        from termsel.adjustment.dispatchers import type_of

        return type_of(self.inner_dispatcher)

    def __call__(self, *args: Any, **keywords: Any) -> Any:
        return self.dispatcher(*args, **keywords)


def compile_lazily(function: _Function, **flags: Any) -> _Function:
    """Compile on first call, and keep the machine code on disk if a folder allows it.

    Flags are those of `numba.njit`. The first call raises TermselError where numba is to compile
    nothing.
    """
    kernel = LazyKernel(partial(_make_dispatcher, function, flags),
                        partial(_make_dispatcher, function, {**flags, "no_cpython_wrapper": True}))
    return cast(_Function, update_wrapper(kernel, function))


def _make_dispatcher(function: Callable[..., Any], flags: dict[str, Any]) -> Any:
    """Return what compiles a function; numba is imported when the first one is made."""
    from termsel.adjustment.dispatchers import dispatcher_of

    return dispatcher_of(function, flags)


def is_compiled(function: Callable[..., Any]) -> bool:
    """Return whether a function that `compile_lazily` returned can be called at once."""
    from termsel.adjustment.dispatchers import has_code

    return has_code(cast(LazyKernel, function).dispatcher)
