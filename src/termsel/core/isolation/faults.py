"""Faults of plugins: which plugin, where in its code, and what was expected."""

from __future__ import annotations

import inspect
import os
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, wait
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from types import TracebackType
from typing import Any, TypeVar

from termsel.core.errors import TermselError, exception_in_words

# Whose code is running: a plugin's calls of its own code are not guarded again.

T = TypeVar("T")

_package: ContextVar[str | None] = ContextVar("package", default=None)


def running_package() -> str | None:
    """Return the package whose code is being run, None outside any plugin."""
    return _package.get()


@contextmanager
def code_of(package: str) -> Iterator[None]:
    """Run a block as the code of a package, a top-level module."""
    token = _package.set(package)
    try:
        yield
    finally:
        _package.reset(token)


@contextmanager
def mark_own_errors() -> Iterator[None]:
    """Run a block of termsel's own code; errors of it are marked as termsel's if a plugin calls it.
    """
    caller = _package.get()
    token = _package.set(None)
    try:
        yield
    except BaseException as error:
        if caller is not None:
            error.of_termsel = True  # type: ignore[attr-defined]
        raise
    finally:
        _package.reset(token)


def is_marked(error: BaseException) -> bool:
    """Return True for an exception of termsel's own code that a plugin called."""
    return getattr(error, "of_termsel", False)


@contextmanager
def surroundings_kept() -> Iterator[None]:
    """Put the working folder and the filters of warnings back after a block."""
    folder = _working_folder()
    filters = list(warnings.filters)
    try:
        yield
    finally:
        # Else an import that changes them would send the files of a result elsewhere, or turn
        # warnings of termsel into errors.
        if folder is not None and _working_folder() != folder:
            os.chdir(folder)
        if warnings.filters != filters:
            warnings.resetwarnings()  # shows Python that they changed
            warnings.filters[:] = filters  # type: ignore[index]


def _working_folder() -> str | None:
    """Return the working folder; None if it was deleted."""
    try:
        return os.getcwd()
    except OSError:  # it was deleted
        return None


class TooSlow(Exception):
    """Code was not done in its time; its thread goes on until the program ends."""


def call_within(seconds: float, call: Callable[[], T], *, soon: float = 0.0,
                tell: Callable[[], None] = lambda: None) -> T:
    """Return the value of a call in a thread of its own; raise TooSlow after `seconds`.

    Exceptions of the call are raised here. Ctrl-C ends the waiting, and the thread goes on. If the
    call takes longer than `soon` seconds, `tell` is called once; never if `soon` is 0.
    """
    done: Future[T] = Future()

    def work() -> None:
        """Call, and hand the value or the error over to the thread that waits."""
        try:
            value = call()
        except BaseException as error:  # noqa: BLE001 - raised again in the thread that waits
            done.set_exception(error)
        else:
            done.set_result(value)

    threading.Thread(target=copy_context().run, args=(work,), daemon=True).start()
    # Two waits, the first until `tell` is called.
    first = min(soon, seconds)
    if first and not wait([done], first).done:
        tell()
    if not wait([done], seconds - first).done:
        raise TooSlow
    return done.result()


OWN = "termsel"

HINT = "This is a bug in the plugin, not your mistake: report it to its author."

_SESSION = "__main__"
"""Module of what is typed into a notebook or a script."""

_OWN_HINT = "It is defined in this session: correct it there, and run its cell again."

_packages: dict[str, str] = {}


class PluginFault(TermselError):
    """Code of a plugin failed, or returned what it must not; the command ends with exit code 2."""


def remember(package: str, distribution: str) -> None:
    """Remember the distribution, such as "termsel-demo 1.0", that a top-level module comes with."""
    _packages[package] = distribution


def package_of(definition: Any) -> str:
    """Return the top-level module in which a class, function or object is defined."""
    # Objects mostly have no module of their own: that of their class counts.
    named = definition if hasattr(definition, "__module__") else type(definition)
    return str(named.__module__).partition(".")[0]


def is_own(definition: Any) -> bool:
    """Return True for a class, function or object that is defined in termsel itself."""
    return package_of(definition) == OWN


def distribution_of(package: str) -> str:
    """Return the distribution and version of a top-level module, such as "termsel-demo 1.0".

    "this session" for __main__; "the module NAME" if no distribution has it.
    """
    if package in _packages:
        return _packages[package]
    for name in _distributions_by_module(tuple(sys.path)).get(package, ()):
        try:
            return f"{name} {version(name)}"
        except PackageNotFoundError:
            continue
    return "this session" if package == _SESSION else f"the module {package}"


@lru_cache(maxsize=1)  # opens every installed distribution
def _distributions_by_module(_path: tuple[str, ...]) -> Mapping[str, list[str]]:
    """Return distributions by top-level module; all of them are opened to find that out."""
    return packages_distributions()


def name_of(definition: Any) -> str:
    """Return the name of a class, function or object in messages: kind, name and distribution."""
    cls = definition if isinstance(definition, type) else type(definition)
    declared_name = getattr(definition, "name", None)
    # An object of a class that declares no name is called by its class.
    shown_name = getattr(definition, "__name__", cls.__name__)
    if isinstance(declared_name, str):
        shown_name = repr(declared_name)
    distribution = distribution_of(package_of(definition))
    return f"{getattr(cls, 'kind', '')} {shown_name} of {distribution}".strip()


def function_in_words(kind: str, function: Any) -> str:
    """Return the name of a function in messages, such as "objective 'spread' of termsel-demo 1.0".
    """
    return f"{kind} of {distribution_of(package_of(function))}"


def fault_of_method(definition: Any, method: str, fault: str, hint: str = HINT,
                    name: str = "") -> PluginFault:
    """Return the fault of a method, such as "score": what it returned, and what was expected.

    `fault` follows the name of the method in the message, such as "returned None". `name`, if any,
    is shown instead of the name of the definition. `hint` is what the reader of the message can do.
    """
    file, line = _where_defined(definition, method)
    hint = _hint_for(package_of(definition), hint)
    return PluginFault(f"{name or name_of(definition)}: {method}() {fault}", file=file,
                       line=line, hint=hint)


@contextmanager
def attribute_errors_to(definition: Any, method: str, hint: str = HINT,
                        name: str = "") -> Iterator[None]:
    """Run code of a plugin; an exception of it becomes a PluginFault that names the method.

    termsel's own errors pass, such as a `TermselError` on a file that the user can correct, and so
    do KeyboardInterrupt and MemoryError. All exceptions pass where the definition, a class,
    function or object, is termsel's own. `hint` says what to do, where it may be the user's own
    mistake; `name`, if any, is shown instead of the name of the definition.
    """
    package = package_of(definition)
    if package == OWN:
        yield
        return
    try:
        with code_of(package):
            yield
    # A plugin may raise anything at all, even leave the program.
    except BaseException as error:
        # Memory that is too small is no fault of the plugin.
        if (isinstance(error, KeyboardInterrupt | MemoryError) or is_own(type(error))
                or is_marked(error)):
            raise
        raise fault_of_error(error, f"{name or name_of(definition)} failed in {method}()", package,
                             hint) from error


def fault_of_error(error: BaseException, activity: str, package: str,
                   hint: str = HINT) -> PluginFault:
    """Return the fault of code that raised an exception, at the package's innermost line."""
    if os.environ.get("TERMSEL_DEBUG") == "1":
        traceback.print_exc()
    file, line = _innermost_line_of(error.__traceback__, package)
    return PluginFault(f"{activity}: {exception_in_words(error)}", file=file, line=line,
                       hint=_hint_for(package, hint))


def _hint_for(package: str, hint: str) -> str:
    """Return a hint: what the user has defined is no plugin of anybody else."""
    return _OWN_HINT if hint == HINT and package == _SESSION else hint


def _innermost_line_of(trace: TracebackType | None, package: str) -> tuple[str | None, int | None]:
    """Return file and line of the package's innermost code in a traceback; None if it has none."""
    # A traceback goes from the outermost call inwards, so that the last of the package counts.
    location: tuple[str | None, int | None] = (None, None)
    while trace is not None:
        module = str(trace.tb_frame.f_globals.get("__name__", ""))
        if module.partition(".")[0] == package:
            location = trace.tb_frame.f_code.co_filename, trace.tb_lineno
        trace = trace.tb_next
    return location


def _where_defined(definition: Any, method: str) -> tuple[str | None, int | None]:
    """Return file and line where a method is defined; None for each that is not known."""
    function = getattr(definition if isinstance(definition, type) else type(definition), method,
                       definition)
    # A property has its code in its getter, a cached one in its function.
    function = getattr(function, "fget", None) or getattr(function, "func", function)
    code = getattr(inspect.unwrap(function), "__code__", None)
    # Compiled functions and callable objects have no code: the file of their module must do.
    if code is None:
        module = sys.modules.get(str(getattr(function, "__module__", "")))
        return getattr(module, "__file__", None), None
    return code.co_filename, code.co_firstlineno
