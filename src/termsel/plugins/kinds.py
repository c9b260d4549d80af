"""The kinds of things plugins provide, and what makes one of each."""

from __future__ import annotations

import inspect
import re
from dataclasses import dataclass
from importlib import import_module
from typing import Any

_NAME = re.compile(r"[^\s:]+")


@dataclass(frozen=True)
class Kind:
    """A kind of things a hook returns.

    Parameters
    ----------
    word : str
        What one of them is called.
    home, base : str
        Module and name of the type; imported when things of the kind are wanted.
    classes : bool
        True if the hook returns subclasses of the type, False if it returns instances.
    """

    word: str
    home: str
    base: str
    classes: bool = False

    def made(self, thing: Any) -> Any:
        """Return a proper one of this kind from what a hook returned.

        Where instances are wanted, a class stands for the instance it makes without arguments.

        Raises
        ------
        TypeError
            If it is of another type, lacks methods or has no usable name.
        """
        base: type = getattr(import_module(self.home), self.base)
        wanted = f"a subclass of {self.base}" if self.classes else f"an instance of {self.base}"
        if isinstance(thing, type):
            if not issubclass(thing, base):
                raise TypeError(f"returned the class {thing.__name__}, not {wanted}")
            if inspect.isabstract(thing):
                missing = ", ".join(sorted(getattr(thing, "__abstractmethods__", ())))
                raise TypeError(f"returned the class {thing.__name__}, which lacks {missing}")
            made = thing if self.classes else thing()
        elif self.classes or not isinstance(thing, base):
            raise TypeError(f"returned an object of type {type(thing).__name__}, not {wanted}")
        else:
            made = thing
        name = getattr(made, "name", None)
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            cls = made if isinstance(made, type) else type(made)
            raise TypeError(f"returned {cls.__name__} with the name {name!r}; a name is text "
                            "without blanks and colons")
        return made


KINDS = {
    "problems": Kind("problem", "termsel.problems.recipes", "Recipe"),
    "models": Kind("model", "termsel.models", "SensorModel", classes=True),
    "solvers": Kind("solver", "termsel.solvers", "Solver", classes=True),
    "criteria": Kind("criterion", "termsel.criteria", "Criterion"),
    "datasets": Kind("data set", "termsel.measurements.datasets", "DatasetSpec"),
    "readers": Kind("reader", "termsel.formats.base", "Reader"),
    "writers": Kind("writer", "termsel.formats.base", "Writer"),
}
"""By the plural, which is also the last part of the hook's name."""


def summary(thing: Any) -> str:
    """Return what a thing says of itself in one line: its summary or its docstring's first."""
    declared = getattr(thing, "summary", None)
    if isinstance(declared, str):
        return declared
    # Not inspect.getdoc(), which would give an undocumented class the line of its base.
    text = (thing if isinstance(thing, type) else type(thing)).__doc__ or ""
    return text.strip().partition("\n")[0]
