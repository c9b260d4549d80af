"""Names that do not exist in Python: arguments of functions, and names of modules.

Python's own message says only that there is none of that name. These say which one was meant.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import wraps
from inspect import signature
from typing import ParamSpec, TypeVar

from termsel.core.errors import likely_names

P = ParamSpec("P")
R = TypeVar("R")

Meant = Callable[[str, object], str]
"""Returns a sentence on what an argument of a name and value should be; "" if that is unknown."""


def explains_arguments(meant: Meant = lambda _name, _value: "") -> Callable[
        [Callable[P, R]], Callable[P, R]]:
    """Return a decorator of a function: an argument of an unknown name is refused with a remedy.

    Parameters
    ----------
    meant : callable, optional
        What the argument should be, where its name is one of the command line or of another
        function. By default the nearest name is proposed.
    """
    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        names = list(signature(function).parameters)

        @wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            for name, value in kwargs.items():
                if name not in names:
                    message = f"{function.__name__}() has no argument {name!r}."
                    remedy = meant(name, value) or _near_names_in_words(name, names)
                    raise TypeError(f"{message} {remedy}")
            return function(*args, **kwargs)

        return call

    return decorate


def _near_names_in_words(name: str, names: Iterable[str]) -> str:
    """Return the question whether a similar name is meant, or else all names."""
    known = list(names)
    similar = likely_names(name, known)
    if similar:
        return f"Did you mean {' or '.join(similar)}?"
    return f"Its arguments are {', '.join(known)}."


_ALSO_CALLED = {
    "load": "read_result", "open": "read_result", "load_result": "read_result",
    "open_result": "read_result", "result": "read_result", "results": "read_result",
    "georeference": "run", "auto": "run", "adjust": "fit", "transform": "Result.project",
    "project": "Result.project", "report": "Result.report", "plot": "Result.plot",
    "sigma": "Result.sigma", "plan": "termsel plan on the command line",
    "list": "termsel list on the command line", "describe": "termsel describe on the command line"}
"""Names of termsel by what other programs, or its own commands, call them."""


def missing_name_message(module: str, name: str, names: Iterable[str]) -> str:
    """Return the message for a name that a module does not have, with the one that is meant."""
    known = sorted(names)
    similar = likely_names(name, known)
    also_called: Mapping[str, str] = _ALSO_CALLED if module == "termsel" else {}
    if name in also_called:
        similar = [also_called[name]]
    question = f" Did you mean {' or '.join(similar)}?" if similar else ""
    return f"{module} has no {name!r}.{question}"
