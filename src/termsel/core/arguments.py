"""Calls from Python that cannot be: arguments of another name, place or kind, names of modules.

Python's own message says only that there is none of that name. These say which one was meant.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import wraps
from inspect import Parameter, signature
from typing import ParamSpec, TypeVar

from termsel.core.errors import count_in_words, likely_names

P = ParamSpec("P")
R = TypeVar("R")

Meant = Callable[[str, object], str]
"""Returns a sentence on what an argument of a name and value should be; "" if that is unknown."""


Places = Callable[[tuple[object, ...]], str]
"""Returns a sentence on how values are given that were given by position; "" if unknown."""


def explains_arguments(
        meant: Meant = lambda _name, _value: "", places: Places = lambda _values: "",
        ) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Return a decorator of a function: arguments that it does not take are refused with a remedy.

    Parameters
    ----------
    meant : callable, optional
        What the argument should be, where its name is one of the command line or of another
        function. By default the nearest name is proposed.
    places : callable, optional
        How the arguments should be given, where there are more of them by position than there are
        places. By default the arguments that have a place are named, and the others.
    """
    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        """Return a function that refuses wrong arguments before it calls this one."""
        parameters = signature(function).parameters
        names = [name for name, parameter in parameters.items()
                 if parameter.kind is not Parameter.VAR_KEYWORD]
        # A function with **kwargs has names of its own choice, which only it can refuse.
        takes_any = len(names) < len(parameters)
        placed = [name for name in names
                  if parameters[name].kind is Parameter.POSITIONAL_OR_KEYWORD]

        @wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            """Call the function; raise TypeError for too many arguments, or one of another name."""
            if len(args) > len(placed):
                count = count_in_words(len(placed), "argument")
                message = f"{function.__name__}() takes {count} by position, not {len(args)}."
                remedy = places(args) or _places_in_words(placed, names)
                raise TypeError(f"{message} {remedy}")
            for name, value in {} if takes_any else kwargs.items():
                if name not in names:
                    message = f"{function.__name__}() has no argument {name!r}."
                    given = {*placed[:len(args)], *kwargs}
                    remedy = meant(name, value) or _near_names_in_words(name, names, given)
                    raise TypeError(f"{message} {remedy}")
            return function(*args, **kwargs)

        return call

    return decorate


def _places_in_words(placed: Sequence[str], names: Sequence[str]) -> str:
    """Return which arguments are given by position, and which by name."""
    others = [f"{name}=" for name in names if name not in placed]
    by_name = f" Give others by name: {', '.join(others)}." if others else ""
    return f"By position: {', '.join(placed)}.{by_name}"


def _near_names_in_words(name: str, names: Sequence[str], given: Collection[object]) -> str:
    """Return the question whether a similar name is meant, of those not given, or all names."""
    free = [full for full in names if full not in given]
    # Names that begin so are meant by res rather than those which look alike.
    begun = [full for full in free if full.startswith(name)] if len(name) > 1 else []
    similar = begun[:_MOST_BEGUN] or likely_names(name, free)
    if similar:
        return f"Did you mean {' or '.join(similar)}?"
    return f"Its arguments are {', '.join(names)}."


_MOST_BEGUN = 3
"""Names with the same beginning that are proposed."""


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
