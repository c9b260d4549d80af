"""The kinds of things plugins provide, and what makes one of each.

What has options of its own (models, solvers, criteria, readers and writers: subclasses of
`Configurable`) is returned as its class. What is a plain description (`Recipe`, `DatasetSpec`)
is returned as an instance.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable
from dataclasses import dataclass
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import Any

from termsel.core.errors import TermselError
from termsel.core.isolation.faults import OWN, package_of
from termsel.core.options import Configurable, Option

_NAME = re.compile(r"[^\s:]+")


@dataclass(frozen=True)
class Kind:
    """A kind of things a hook returns, called by a word.

    The type `base` is imported from its module `home` when needed; without a home it belongs to a
    package, and is the class that says which `kind` it is and where its `suite` of conformance is.
    A hook returns subclasses of a `Configurable` type, and instances of another. Where
    `must_start`, a class is refused that cannot be made without options: every reader is asked
    about a file and every writer about a result; models may need options.
    """

    word: str
    home: str
    base: str
    must_start: bool = False

    @property
    def in_words(self) -> str:
        """What people call such a thing: who reads or writes a file names its format."""
        return {"reader": "format to read", "writer": "format to write"}.get(self.word, self.word)

    def base_of(self, item: Any) -> type | None:
        """Return the type that a thing must be of; None if it is of no type of this kind."""
        if self.home:
            return getattr(import_module(self.home), self.base)  # type: ignore[no-any-return]
        # A kind of a package is known by the class that states it, wherever that is.
        classes = (item if isinstance(item, type) else type(item)).__mro__
        return next((cls for cls in classes if vars(cls).get("kind") == self.word), None)

    def is_of(self, item: Any) -> bool:
        """Return whether a thing is a class or an instance of the kind."""
        base = self.base_of(item)
        return base is not None and (
            issubclass(item, base) if isinstance(item, type) else isinstance(item, base))

    def require_returned(self, item: Any) -> None:
        """Refuse as `require_valid`, and an instance where classes are wanted, by TypeError."""
        if isinstance(item, Configurable):
            raise TypeError(f"returned an object of type {type(item).__name__}, not a subclass of "
                            f"{self.base}; return the class")
        self.require_valid(item)
        if self.must_start:
            item()

    def require_valid(self, item: Any) -> None:
        """Raise TypeError for an item of another kind, without its methods or a usable name.

        Also for a class whose attributes are of other types than where termsel declares them.
        """
        base = self.base_of(item)
        wants_class = base is None or issubclass(base, Configurable)
        expected = f"a subclass of {self.base}" if wants_class else f"an instance of {self.base}"
        if isinstance(item, type):
            if not wants_class or base is None or not issubclass(item, base):
                raise TypeError(f"returned the class {item.__name__}, not {expected}")
            if inspect.isabstract(item):
                missing = ", ".join(sorted(getattr(item, "__abstractmethods__", ())))
                raise TypeError(f"returned the class {item.__name__}, which lacks {missing}")
        elif base is None or not isinstance(item, base):
            raise TypeError(f"returned an object of type {type(item).__name__}, not {expected}")
        name = getattr(item, "name", None)
        cls = item if isinstance(item, type) else type(item)
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            raise TypeError(f"returned {cls.__name__} with the name {name!r}; a name is text "
                            "without blanks and colons")
        if wants_class:
            _require_attribute_types(cls)
        # Classes declare options; descriptions such as those of problems have them.
        _require_usable_defaults(cls if wants_class else name, (
            *getattr(item, "declared_options", ()), *getattr(item, "options", ()))
            if not isinstance(item, Configurable) else item.declared_options)


def _require_attribute_types(cls: type) -> None:
    """Raise TypeError for a class with attributes of other types than those of their defaults."""
    # Defaults are what termsel's own base classes declare.
    own_bases = [base for base in cls.__mro__ if package_of(base) == OWN]
    for attribute, default in chain.from_iterable(vars(base).items() for base in own_bases):
        value = getattr(cls, attribute)
        expected_type = next((plain for plain in _PLAIN_TYPES if isinstance(default, plain)), None)
        if attribute.startswith("_") or expected_type is None or isinstance(value, property):
            continue
        if not isinstance(value, (list, tuple) if expected_type is tuple else expected_type):
            raise TypeError(f"returned {cls.__name__} with {attribute} = {value!r:.100}, "
                            f"which is no {expected_type.__name__}")
    # Tuples are checked by what they hold.
    for attribute, element_type in (("declared_options", Option), ("segments", type)):
        for element in getattr(cls, attribute, ()):
            if not isinstance(element, element_type):
                raise TypeError(f"returned {cls.__name__} with {attribute} that hold "
                                f"{element!r:.100}, which is no {element_type.__name__}")


def _place_of(cls: type) -> str:
    """Return the file and the line of a class, in brackets; "" where there is no source."""
    try:
        return f" ({Path(inspect.getfile(cls)).name}, line {inspect.getsourcelines(cls)[1]})"
    except (OSError, TypeError):  # typed into a notebook, or compiled
        return ""


def _require_usable_defaults(owner: type | str, options: Iterable[Option]) -> None:
    """Raise TypeError for an option, of a class or of a name, that refuses its own default."""
    for option in options:
        try:
            option.parse(option.default)
        except TermselError:
            # The line of a class takes long to find: most of what a start of termsel would take.
            place = owner if isinstance(owner, str) else f"{owner.__name__}{_place_of(owner)}"
            raise TypeError(f"returned {place}, whose option {option.name!r} has the default "
                            f"{option.default!r:.100} and accepts: {option.accepts}") from None


_PLAIN_TYPES = (bool, int, str, tuple, dict)
"""Types of the attributes by which a class says what it is."""

KINDS = {
    "problems": Kind("problem", "termsel.selection.problems.recipes", "Recipe"),
    "models": Kind("model", "termsel.models", "SensorModel"),
    "solvers": Kind("solver", "termsel.selection.solvers", "Solver"),
    "criteria": Kind("criterion", "termsel.selection.criteria", "Criterion", must_start=True),
    "objectives": Kind("objective", "termsel.selection.problems.objectives", "Objective"),
    "methods": Kind("method", "termsel.fitting.method", "Method"),
    "matchers": Kind("matcher", "", "Matcher", must_start=True),
    "datasets": Kind("data set", "termsel.data.datasets", "DatasetSpec"),
    "splits": Kind("split", "termsel.data.roles", "Split"),
    "sections": Kind("section", "termsel.results.extras", "ReportSection"),
    "measures": Kind("measure", "termsel.results.extras", "Measure"),
    "readers": Kind("reader", "termsel.formats.base", "Reader", must_start=True),
    "writers": Kind("writer", "termsel.formats.base", "Writer", must_start=True),
}
"""By the plural, which is also the last part of the hook's name."""


def summary_line(item: Any) -> str:
    """Return one line on a thing: its summary, or the first line of its docstring."""
    declared = getattr(item, "summary", None)
    if isinstance(declared, str):
        return declared
    # Not inspect.getdoc(), which would give an undocumented class the line of its base.
    text = (item if isinstance(item, type) else type(item)).__doc__ or ""
    return text.strip().partition("\n")[0]
