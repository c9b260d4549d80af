"""Calls from Python that cannot be: arguments of another name, place or kind, names of modules.

Python's own message says only that there is none of that name. These say which one was meant.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import wraps
from inspect import Parameter, signature
from numbers import Real
from os import PathLike
from typing import TYPE_CHECKING, Any, ClassVar, ParamSpec, TypeVar

from termsel.core.errors import TermselError, count_in_words, likely_names
from termsel.core.kinds import Kind, kinds_of, remedy_for, wrong_kind_message
from termsel.core.remedies import called_in_python, in_python

log = logging.getLogger(__name__)

P = ParamSpec("P")
R = TypeVar("R")
C = TypeVar("C")

Meant = Callable[[str, object, Mapping[str, object]], str]
"""Returns a sentence on what an argument of a name and value should be; "" if that is unknown.

The third argument has the values by name that were given for arguments which the function takes."""


Remark = Callable[[Mapping[str, Any], Any], str]
"""Returns what is to be said of arguments and of what was returned for them; "" if nothing."""


Places = Callable[[tuple[object, ...]], str]
"""Returns a sentence on how values are given that were given by position; "" if unknown."""


def explains_arguments(
        meant: Meant = lambda _name, _value, _given: "", places: Places = lambda _values: "",
        checked_within: Collection[str] = (), remark: Remark = lambda _given, _returned: "",
        ) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Return a decorator of a function: arguments that it does not take are refused with a remedy.

    An argument that is not of the kind which the function declares raises TermselError, one of
    another name or place, or one that lacks, TypeError.

    Parameters
    ----------
    meant : callable, optional
        What the argument should be, where its name is one of the command line or of another
        function. By default the nearest name is proposed.
    places : callable, optional
        How the arguments should be given, where there are more of them by position than there are
        places. By default the arguments that have a place are named, and the others.
    checked_within : collection of str, optional
        Arguments whose kind the function checks itself, in words that say more.
    remark : callable, optional
        A warning on what is returned, logged for whoever calls the function from outside of
        termsel: within, functions are called for places that nobody asked for.
    """
    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        """Return a function that refuses wrong arguments before it calls this one."""
        parameters = {name: parameter for name, parameter in signature(function).parameters.items()
                      if parameter.kind is not Parameter.VAR_POSITIONAL}
        names = [name for name, parameter in parameters.items()
                 if parameter.kind is not Parameter.VAR_KEYWORD]
        # A function with **kwargs has names of its own choice, which only it can refuse.
        takes_any = len(names) < len(parameters)
        placed = [name for name in names
                  if parameters[name].kind is not Parameter.KEYWORD_ONLY]
        required = [name for name in names if parameters[name].default is Parameter.empty]
        kinds: dict[str, Kind] = {}

        @wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            """Call the function; refuse arguments of another number, name or kind first.

            Raises TypeError, or TermselError for one of another kind; errors of the function are in
            the words of Python.
            """
            if len(args) > len(placed):
                raise TypeError(_too_many_message(function.__name__, args, placed, names, places))
            given = {**dict(zip(placed, args, strict=False)), **kwargs}
            for name, value in {} if takes_any else kwargs.items():
                if name not in names:
                    message = f"{function.__name__}() has no argument {name!r}."
                    remedy = meant(name, value, given) or _near_names_in_words(name, names, given)
                    raise TypeError(f"{message} {remedy}")
            if lacking := [name for name in required if name not in given]:
                raise TypeError(_lacking_message(function.__name__, lacking, given, [
                    name for name in required if name != "self"]))
            if not kinds:
                # Hints are evaluated once, and not before the function is used.
                kinds.update(kinds_of(function, {"self", *checked_within}))
            _refuse_wrong_kinds(given, kinds, required)
            # Commands and packages of termsel show what is said to whoever typed an option.
            caller = sys._getframe(1).f_globals.get("__name__", "")
            if caller.startswith("termsel"):
                return function(*args, **kwargs)
            with called_in_python(function.__name__, names):
                try:
                    returned = function(*args, **kwargs)
                except TermselError as error:
                    error.what = in_python(error.what, names)
                    error.hint = error.hint and in_python(error.hint, names)
                    raise
                if said := remark(given, returned):
                    log.warning("Warning: %s.", said)
            return returned

        return call

    return decorate


def _refuse_wrong_kinds(given: Mapping[str, object], kinds: Mapping[str, Kind],
                        required: Collection[str]) -> None:
    """Raise TermselError for the first argument that is not of its kind."""
    for name, value in given.items():
        if name in kinds and not kinds[name].holds(value):
            remedy = remedy_for(name, value, kinds[name]) or (
                None if name in required else "Correct it, or leave it out.")
            raise TermselError(wrong_kind_message(name, value, kinds[name]), hint=remedy, name=name)


def _too_many_message(function: str, args: tuple[object, ...], placed: Sequence[str],
                      names: Sequence[str], places: Places) -> str:
    """Return the message for more arguments by position than a function has places."""
    # That of a method is its object, which nobody writes.
    own = int(placed[:1] == ["self"])
    count = count_in_words(len(placed) - own, "argument")
    remedy = (places(args) or _as_one_row(function, args[own:], placed[own:])
              or _places_in_words(placed[own:], names[own:]))
    return f"{function}() takes {count} by position, not {len(args) - own}. {remedy}"


_ROWS = ("ground", "image")
"""Arguments that hold a row of coordinates for each place."""


def _as_one_row(function: str, values: Sequence[object], placed: Sequence[str]) -> str:
    """Return how numbers that were given one by one are written as a place; "" for others."""
    n_further = len(placed) - 1
    if not placed or placed[0] not in _ROWS or not all(
            isinstance(value, Real) for value in values):
        return ""
    row = list(values[:len(values) - n_further])
    further = "".join(f", {value}" for value in values[len(values) - n_further:])
    return f"Give each place as a row: {function}([{row}]{further})."


_WRITTEN_AS = {"crs": "crs='EPSG:4979'"}
"""How arguments are given, where their name does not show it."""


def _lacking_message(function: str, lacking: Sequence[str], given: Mapping[str, object],
                     required: Sequence[str]) -> str:
    """Return the message for arguments that a function cannot do without, with a call to write.

    Names of files that were given are repeated in it.
    """
    shown = []
    for name in required:
        value = given.get(name)
        is_file = name == "path" and isinstance(value, str | PathLike)
        shown.append(repr(str(value)) if is_file else _WRITTEN_AS.get(name, name))
    return f"{function}() lacks {' and '.join(lacking)}: {function}({', '.join(shown)})."


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
    # That of a method is its object, which nobody writes.
    return f"Its arguments are {', '.join(full for full in names if full != 'self')}."


_MOST_BEGUN = 3
"""Names with the same beginning that are proposed."""


_ALSO_CALLED = {
    "load": "read_result", "open": "read_result", "load_result": "read_result",
    "open_result": "read_result", "result": "read_result", "results": "read_result",
    "read_points": "read", "read_lines": "read", "read_csv": "read", "read_gcps": "read",
    "read_file": "read", "read_table": "read", "load_points": "read", "from_file": "read",
    "predict": "Result.project", "locate": "Result.locate", "inverse": "Result.locate",
    "accuracy": "Result.accuracy", "residuals": "Result.residuals", "summary": "Result.summary",
    "georeference": "run", "auto": "run", "adjust": "fit", "transform": "Result.project",
    "project": "Result.project", "report": "Result.report", "plot": "Result.plot",
    "sigma": "Result.sigma"} | {
    name.replace("-", "_"): f"termsel {name} on the command line" for name in (
        "plan", "list", "describe", "check", "block", "app", "example", "match-points",
        "match-lines", "match-ties", "auto-georeference", "map-series", "flight-camera",
        "stability", "bench", "block-points", "block-select", "plugins", "new-plugin",
        "completion", "match-example", "block-example")}
"""Names of termsel by what other programs, or its own commands, call them."""


_IN_PACKAGES = {
    **{name: f"from termsel_sklearn import {name}" for name in (
        "SensorModelRegressor", "TermSelector", "regressor_method", "spatial_blocks")},
    **{name: f"import termsel_{name}" for name in (
        "sklearn", "rpc", "match", "standards", "cameras", "hybrids", "optimisers")}}
"""Names that are sought in termsel and are in packages of their own: how these are imported."""


CALLED_PROJECT = ("predict", "transform", "to_image", "to_pixel", "to_pixels", "ground_to_image",
                  "world_to_pixel", "rowcol", "index")
CALLED_LOCATE = ("inverse", "to_ground", "to_world", "image_to_ground", "pixel_to_world", "xy")
"""What other programs call `project` and `locate`, from the ground to the image and back."""


class Explained:
    """Base of objects whose attributes, where one is missing, are explained.

    `elsewhere` has what is meant by names that other programs would have there, or that a user of
    the command line expects: a sentence by name.
    """

    elsewhere: ClassVar[Mapping[str, str]] = {}

    # For programs alone: with it a checker of types would take any name.
    if not TYPE_CHECKING:
        def __getattr__(self, name: str) -> object:
            """Raise AttributeError with what is meant by a name, or the own error of a property."""
            cls = type(self)
            # An attribute that is there has failed itself; its own error says why.
            if hasattr(cls, name):
                return object.__getattribute__(self, name)
            message = f"{cls.__name__} has no {name!r}."
            if not name.startswith("_"):
                public = [known for known in dir(cls) if not known.startswith("_")]
                near = likely_names(name, public)
                question = f"Did you mean {' or '.join(near)}?" if near else ""
                message = f"{message} {cls.elsewhere.get(name) or question}".rstrip()
            # With a name of its own, Python adds no guess to that of the message.
            raise AttributeError(message, name=name)

        def __getitem__(self, key: object) -> object:
            """Raise TypeError with what is meant by a name in brackets, or that there are none."""
            cls = type(self)
            rows = cls.elsewhere.get("[]", "")
            meant = cls.elsewhere.get(key, rows) if isinstance(key, str) else rows
            if isinstance(key, str) and meant == rows and hasattr(cls, key):
                meant = f"Write .{key} in its place."
            raise TypeError(f"{cls.__name__} has no [{key!r}]. {meant}".rstrip())


def lacks_said(remedy: str) -> Callable[[type[C]], type[C]]:
    """Return a decorator of a class: where it is made of too little, a remedy says of what.

    For classes that are made of arrays, and that callers have other ways to get.
    """
    def decorate(cls: type[C]) -> type[C]:
        """Return the class, which counts its arguments before it takes them."""
        make = cls.__init__
        required = [name for name, parameter in signature(make).parameters.items()
                    if parameter.default is Parameter.empty and name != "self"]

        @wraps(make)
        def __init__(self: object, *args: object, **kwargs: object) -> None:
            """Make the object; raise TypeError where an argument lacks."""
            if len(args) + len(kwargs) < len(required):
                lacking = [name for name in required[len(args):] if name not in kwargs]
                raise TypeError(f"{cls.__name__}() lacks {' and '.join(lacking)}. {remedy}")
            make(self, *args, **kwargs)

        # A checker of types takes a class for what it was made as.
        cls.__init__ = __init__  # type: ignore[method-assign]
        return cls

    return decorate


def changes_said(remedy: str) -> Callable[[type[C]], type[C]]:
    """Return a decorator of a frozen class: who sets an attribute is told how to get another one.

    `remedy` has the name of the attribute as {name}.
    """
    def decorate(cls: type[C]) -> type[C]:
        """Return the class, whose attributes say why they cannot be set."""

        def __setattr__(_self: object, name: str, _value: object) -> None:
            """Raise AttributeError: values of the class do not change."""
            message = f"{cls.__name__} cannot be changed. {remedy.format(name=name)}"
            raise AttributeError(message, name=name)

        cls.__setattr__ = __setattr__  # type: ignore[method-assign]
        return cls

    return decorate


def missing_name_message(module: str, name: str, names: Iterable[str]) -> str:
    """Return the message for a name that a module does not have, with those that may be meant."""
    known = sorted(names)
    similar = likely_names(name, known)
    also_called: Mapping[str, str] = _ALSO_CALLED if module == "termsel" else {}
    if name in also_called:
        similar = [also_called[name]]
    elif module == "termsel" and name in _IN_PACKAGES:
        return f"{module} has no {name!r}. Write: {_IN_PACKAGES[name]}."
    question = f" Did you mean {' or '.join(similar)}?" if similar else ""
    return f"{module} has no {name!r}.{question}"
