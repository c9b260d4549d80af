"""The kinds of things plugins provide, and what makes one of each.

What has options of its own (models, solvers, criteria, readers and writers: subclasses of
`Configurable`) is returned as its class. What is a plain description (`Recipe`, `DatasetSpec`)
is returned as an instance.

Before version 0.2 criteria, readers and writers were returned as instances. Their class is taken
instead, with their options as its defaults, and ``termsel plugins`` says so.
"""

from __future__ import annotations

import inspect
import re
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any

from termsel.guard.faults import is_own
from termsel.options import Configurable, Option

_NAME = re.compile(r"[^\s:]+")


@dataclass(frozen=True)
class Kind:
    """A kind of things a hook returns.

    Parameters
    ----------
    word : str
        What one of them is called.
    home, base : str
        Module and name of the type; imported when needed. A hook returns
        subclasses of a `Configurable` type, and instances of another.
    tried : bool
        Whether a class is refused that cannot be made without options. Every reader is asked
        about a file and every writer about a result; models may need options.
    """

    word: str
    home: str
    base: str
    tried: bool = False

    def is_of(self, thing: Any) -> bool:
        """Return whether a thing is a class or an instance of the kind."""
        base: type = getattr(import_module(self.home), self.base)
        return issubclass(thing, base) if isinstance(thing, type) else isinstance(thing, base)

    def made(self, thing: Any) -> Any:
        """Return what a hook returned in the form the registry keeps.

        Where classes are wanted, an instance stands for its class (see `class_of`).

        Raises
        ------
        TypeError
            If it is of another type, lacks methods, has no usable name or cannot be made.
        """
        base: type = getattr(import_module(self.home), self.base)
        classes = issubclass(base, Configurable)
        wanted = f"a subclass of {self.base}" if classes else f"an instance of {self.base}"
        if isinstance(thing, type):
            if not classes or not issubclass(thing, base):
                raise TypeError(f"returned the class {thing.__name__}, not {wanted}")
            if inspect.isabstract(thing):
                missing = ", ".join(sorted(getattr(thing, "__abstractmethods__", ())))
                raise TypeError(f"returned the class {thing.__name__}, which lacks {missing}")
        elif not isinstance(thing, base):
            raise TypeError(f"returned an object of type {type(thing).__name__}, not {wanted}")
        made = class_of(thing) if isinstance(thing, Configurable) else thing
        name = getattr(made, "name", None)
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            cls = made if isinstance(made, type) else type(made)
            raise TypeError(f"returned {cls.__name__} with the name {name!r}; a name is text "
                            "without blanks and colons")
        if isinstance(made, type) and (fault := _attribute_fault(made)):
            raise TypeError(f"returned {made.__name__} with {fault}")
        if self.tried:
            made()
        return made


def _attribute_fault(cls: type) -> str | None:
    """Return which attribute of a class is of another type than where termsel declares it."""
    for base in cls.__mro__:
        for name, usual in vars(base).items() if is_own(base) else ():
            found = getattr(cls, name)
            kind = next((kind for kind in _PLAIN if isinstance(usual, kind)), None)
            if name.startswith("_") or kind is None or isinstance(found, property):
                continue
            accepted = (list, tuple) if kind is tuple else kind
            if not isinstance(found, accepted):
                return f"{name} = {found!r:.100}, which is no {kind.__name__}"
    for name, wanted in (("declared_options", Option), ("segments", type)):
        for one in getattr(cls, name, ()):
            if not isinstance(one, wanted):
                return f"{name} that hold {one!r:.100}, which is no {wanted.__name__}"
    return None


_PLAIN = (bool, int, str, tuple, dict)
"""Types of the attributes by which a class says what it is."""

KINDS = {
    "problems": Kind("problem", "termsel.problems.recipes", "Recipe"),
    "models": Kind("model", "termsel.models", "SensorModel"),
    "solvers": Kind("solver", "termsel.solvers", "Solver"),
    "criteria": Kind("criterion", "termsel.criteria", "Criterion", tried=True),
    "objectives": Kind("objective", "termsel.problems.objectives", "Objective"),
    "candidates": Kind("candidate", "termsel.candidates.base", "Candidate"),
    "datasets": Kind("data set", "termsel.measurements.datasets", "DatasetSpec"),
    "readers": Kind("reader", "termsel.formats.base", "Reader", tried=True),
    "writers": Kind("writer", "termsel.formats.base", "Writer", tried=True),
}
"""By the plural, which is also the last part of the hook's name."""


def class_of(thing: Configurable) -> type[Configurable]:
    """Return the class of an instance, with what the instance was given as its defaults.

    Parameters
    ----------
    thing : Configurable
        As hooks returned it before version 0.2.

    Returns
    -------
    type
        The class itself where the instance has default options and nothing else. Otherwise a
        subclass: without options it makes the same as `thing`; with options it makes the class's
        own with these and those of `thing`.
    """
    own = type(thing)
    state, options = dict(vars(thing)), thing.options
    defaults = tuple(replace(option, default=options.get(option.name, option.default))
                     for option in own.declared_options)
    if state.keys() == {"options"} and defaults == own.declared_options:
        return own

    def __init__(self: Configurable, **given: Any) -> None:
        if given:
            own.__init__(self, **{**options, **given})
        else:
            vars(self).update(state, options=dict(options))

    members: dict[str, Any] = {
        "__init__": __init__, "__doc__": own.__doc__, "__module__": own.__module__,
        "declared_options": defaults}
    members |= {name: state[name] for name in ("name", "summary") if name in state}
    return type(own.__name__, (own,), members)


def summary(thing: Any) -> str:
    """Return one line on a thing: its summary, or the first line of its docstring."""
    declared = getattr(thing, "summary", None)
    if isinstance(declared, str):
        return declared
    # Not inspect.getdoc(), which would give an undocumented class the line of its base.
    text = (thing if isinstance(thing, type) else type(thing)).__doc__ or ""
    return text.strip().partition("\n")[0]
