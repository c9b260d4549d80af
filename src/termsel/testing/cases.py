"""Named checks: how they are made, run and excepted."""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from termsel.core.errors import TermselError, unknown_name_error
from termsel.core.isolation.calls import without_guards
from termsel.core.isolation.faults import TooSlow, call_within
from termsel.core.options import Configurable
from termsel.plugins.kinds import KINDS, summary_line

LIMIT = 120.0
"""Seconds that a check may take with one object."""

Subject = TypeVar("Subject")
Made = TypeVar("Made", bound=Configurable)


@dataclass(frozen=True)
class Check:
    """One requirement on a plugin.

    Parameters
    ----------
    name : str
        As in `expected_failures` and in the ids of tests.
    run : callable
        Takes no arguments; raises AssertionError that begins with the check's name.
    """

    name: str
    run: Callable[[], None]


@dataclass(frozen=True)
class Case:
    """One object on which the checks are run: its name and options, and what makes it."""

    label: str
    make: Callable[[], Any]


@dataclass(frozen=True)
class Suite:
    """The checks of one kind of thing.

    Each function takes the object of a case, and raises AssertionError; its name is that of the
    check. `cases` takes a thing and, by keyword, what else its checks need.
    """

    functions: tuple[Callable[[Any], None], ...]
    cases: Callable[..., list[Case]]


def require(condition: object, message: str) -> None:
    """Raise AssertionError with `message` unless `condition` holds."""
    # Unlike the statement `assert`, also under ``python -O``.
    if not condition:
        raise AssertionError(message)


def require_refused(call: Callable[[], object], path: Path, content: str, unnoticed: str) -> None:
    """Require that a call raises a TermselError that names a file.

    The message of the AssertionError, where it does not, has `content`, what is wrong with the
    file, and where nothing is raised `unnoticed`, what happens instead.
    """
    try:
        call()
    except TermselError as error:
        require(str(path) in str(error), f"the error on {content} does not name the file: {error}; "
                                         "raise TermselError(..., file=path)")
        return
    except Exception as error:
        raise AssertionError(f"{content} raises {type(error).__name__}: {error}; the user can "
                             "correct it, so raise TermselError(..., file=path)") from error
    raise AssertionError(f"{content} {unnoticed}; raise TermselError(..., file=path)")


def assemble(
    functions: Iterable[Callable[[Subject], None]],
    cases: Iterable[Case],
    expected_failures: Mapping[str, str] | None,
) -> tuple[Check, ...]:
    """Return one check for each function; it runs the function on every case.

    A check has the name of its function. Expected failures are the names of checks that are known
    to fail, with the reason. Such a check succeeds if the plugin fails as predicted, and fails if
    it does not, so that the list stays correct. Raises TermselError for the name of no check.
    """
    named = {function.__name__: function for function in functions}
    reasons = dict(expected_failures or {})
    for name in reasons:
        if name not in named:
            raise unknown_name_error("check", name, named)
    # A generator of cases is used up by the first check, and there are many.
    listed = tuple(cases)
    return tuple(Check(name, partial(_run, name, function, listed, reasons.get(name)))
                 for name, function in named.items())


def run_all(checks: Iterable[Check]) -> None:
    """Run all checks; the AssertionError has one paragraph for each that fails."""
    failures = []
    for check in checks:
        try:
            check.run()
        except AssertionError as failure:
            failures.append(failure)
    if failures:
        raise AssertionError("\n".join(str(failure) for failure in failures)) from failures[0]


def _run(name: str, function: Callable[[Any], None], cases: tuple[Case, ...],
         reason: str | None) -> None:
    """Run a check with its cases, until one fails.

    Raises AssertionError where the check fails, or where it was expected to fail, for a `reason`,
    and does not.
    """
    try:
        for case in cases:
            _run_case(name, function, case)
    except AssertionError:
        if reason is None:
            raise
        return
    # An expected failure that no longer happens must not stay in the list, and hide a later one.
    if reason is not None:
        raise AssertionError(f"{name}: this check passes and was expected to fail ({reason}); "
                             "remove it from expected_failures")


def _run_case(name: str, function: Callable[[Any], None], case: Case) -> None:
    """Run a check with one case, made anew; an AssertionError names both.

    A check fails by any exception, by a RuntimeWarning, and if it takes more than LIMIT seconds.
    """
    try:
        # The user of the plugin would see a warning such as "divide by zero".
        with warnings.catch_warnings(), without_guards():
            warnings.simplefilter("error", RuntimeWarning)
            # What one check leaves behind in an object is not held against it in the next check.
            call_within(LIMIT, lambda: function(case.make()))
    except AssertionError as failure:
        raise AssertionError(f"{name}: {case.label}: {failure}") from failure
    except TooSlow as end:
        raise AssertionError(f"{name}: {case.label}: it takes more than {LIMIT:.0f} s") from end
    except Exception as error:
        raise AssertionError(f"{name}: {case.label}: {type(error).__name__} was raised: {error}"
                             ) from error


def make_instance(item: type[Made] | Made) -> Made:
    """Return an object of a class with its default options; an object as it is."""
    return item() if isinstance(item, type) else item


def label_with_options(item: type[Configurable] | Configurable, options: Mapping[str, Any]) -> str:
    """Return a name with its options, such as "rfm with order=3"."""
    name = getattr(item, "name", None) or getattr(item, "__name__", type(item).__name__)
    settings = ", ".join(f"{key}={value}" for key, value in options.items())
    return f"{name} with {settings}" if settings else str(name)


def declaration_check(kind: str, item_of: Callable[[Any], Any] = lambda subject: subject,
                      ) -> Callable[[Any], None]:
    """Return the check of a thing's declaration; `item_of` gets the thing from a case's subject."""
    def declaration(subject: Any) -> None:
        """It has a name and a docstring or summary; its options are documented and parse."""
        check_declaration(kind, item_of(subject))

    return declaration


def check_declaration(kind: str, item: Any) -> None:
    """Require what the hooks require, a one-line summary, and options that parse.

    `kind` is a plural, such as "models", and `item` a class, as a hook returns it, or an object.
    Raises AssertionError for a declaration that lacks something.
    """
    try:
        # The same test by which a hook is refused, so that what passes here is accepted there.
        KINDS[kind].require_returned(type(item) if isinstance(item, Configurable) else item)
    except TypeError as error:
        raise AssertionError(f"the hook termsel_{kind} would be refused: it {error}") from error
    require(summary_line(item).strip(), "it says nothing of itself; give it a docstring (or a "
            f"summary), whose first line `termsel list {kind}` shows")
    options = getattr(item, "declared_options", ())
    names = [option.name for option in options]
    # --set could reach only one of two options of a name.
    require(len(set(names)) == len(names), f"an option is declared twice: {', '.join(names)}")
    for option in options:
        require(option.doc.strip(), f"option {option.name!r} has no doc; `termsel describe` "
                                    "shows it")
        # On the command line a default is text: it must come back as the same value.
        parsed = option.parse(option.default)
        require(parsed == option.default,
                f"the default {option.default!r} of option {option.name!r} is read as {parsed!r}; "
                f"declare it as {option.type.__name__}")
        # A choice that the option itself refuses could never be set.
        for choice in option.choices:
            option.parse(choice)


def require_unchanged(arrays: Mapping[str, NDArray[Any]], method: str,
                      call: Callable[[], object]) -> None:
    """Require that a call of a method leaves arrays as they are.

    `arrays` are given by their names in the message of the AssertionError.
    """
    before = {name: array.copy() for name, array in arrays.items()}
    call()
    for name, array in arrays.items():
        require(np.array_equal(array, before[name]), f"{method} changes {name}; work on a copy")


def through_pickle(item: Subject) -> Subject:
    """Return a copy through pickle, as studies send what they run to other processes.

    Raises
    ------
    AssertionError
        If the thing cannot be pickled.
    """
    try:
        copy: Subject = pickle.loads(pickle.dumps(item))
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise AssertionError(f"it cannot be sent to another process: {error}; define the class or "
                             "function in a module, and keep no open files in it") from error
    return copy
