"""What a part of a cell is made of: recipes, options of instances and code, as one checksum."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import cache, partial
from itertools import chain
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np

from termsel.core.options import Configurable

_VERSIONED = {*sys.stdlib_module_names, "termsel", "numpy", "scipy", "numba", "deap", "pymoo"} - {
    "__main__"}
"""Packages whose version the journal keeps, so that their code needs no checksum."""

_ATOMS = (str, int, float, complex, bool, bytes, type(None), type(...))


def checksum_of_code(value: Any) -> str:
    """Return a checksum of all that decides what a recipe, class or instance does.

    Of classes and functions that is their code, with what it encloses, and the source of their
    package; of instances of options also these and their plain attributes. Where objects hold more
    than that, as a model that was fitted, it takes no part.
    """
    checksum = hashlib.sha256()
    for text in _identifying_words(value, set()):
        # The length in front keeps neighbouring texts apart.
        checksum.update(f"{len(text)}:{text}".encode(errors="surrogatepass"))
    return checksum.hexdigest()[:24]


def _identifying_words(value: Any, above: set[int]) -> Iterator[str]:
    """Yield the words that distinguish a value from others, the same in every process."""
    if isinstance(value, _ATOMS):
        yield f"{type(value).__name__} {value!r}"
        return
    if isinstance(value, np.ndarray | np.generic) and value.dtype != object:
        yield f"{value.dtype.str} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}"
        return
    if id(value) in above:  # what holds itself
        return
    # The values that hold this one, so that a cycle ends.
    above.add(id(value))
    yield type(value).__name__
    for component in _parts_of_value(value):
        yield from _identifying_words(component, above)
    yield "."
    above.remove(id(value))


def _parts_of_value(value: Any) -> Iterator[Any]:
    """Yield the values that a value consists of, in an order that lasts.

    The checksum of a cell must be the same in another process and on another day: mappings and sets
    are sorted, functions stand for their code and what they close over, objects for their options
    or fields. Caches of an object are left out.
    """
    if isinstance(value, Mapping):
        # Sets and mappings have no order that lasts.
        yield from sorted(value.items(), key=str)
    elif isinstance(value, list | tuple):
        yield from value
    elif isinstance(value, set | frozenset):
        yield from sorted(value, key=str)
    elif isinstance(value, type):
        yield from _parts_of_class(value)
    elif isinstance(value, FunctionType):
        yield from _parts_of_function(value)
    elif isinstance(value, CodeType):
        yield from (value.co_code, value.co_names, value.co_consts, value.co_varnames)
    elif isinstance(value, MethodType):
        yield from (value.__func__, value.__self__)
    elif isinstance(value, partial):
        yield from (value.func, value.args, value.keywords)
    elif isinstance(value, staticmethod | classmethod):
        yield value.__func__
    elif isinstance(value, property):
        yield value.fget
    elif isinstance(value, ModuleType | BuiltinFunctionType):
        yield value.__name__
    # Caches in an object are no part of what it does.
    elif isinstance(value, Configurable):
        yield from (type(value), value.options, _plain_attributes(vars(value)))
    elif is_dataclass(value):
        yield from (type(value),
                    {column.name: getattr(value, column.name) for column in fields(value)})
    else:
        yield from (type(value), _plain_attributes(getattr(value, "__dict__", {})))


def _plain_attributes(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the attributes whose values are plain data."""
    return {name: value for name, value in attributes.items() if isinstance(value, _ATOMS)}


def _parts_of_class(kind: type) -> Iterator[Any]:
    """Yield the parts that decide what a class does: its code and that of its bases."""
    # A class does what its bases do, so their code counts as well.
    for base in kind.__mro__:
        yield f"{base.__module__}.{base.__qualname__}"
        if _root_package(base) not in _VERSIONED:
            yield _source_checksum(_root_package(base))
            # Memory of abstract classes, and what Python adds, say nothing of what a class does.
            yield {name: value for name, value in vars(base).items() if name != "_abc_impl" and
                   (not name.startswith("__") or isinstance(value, FunctionType))}


def _parts_of_function(function: FunctionType) -> Iterator[Any]:
    """Yield the parts that decide what a function does: code, defaults and enclosed values."""
    yield f"{function.__module__}.{function.__qualname__}"
    for cell in function.__closure__ or ():
        try:
            yield cell.cell_contents
        except ValueError:  # a name that is not bound yet
            yield None
    if _root_package(function) in _VERSIONED:
        return
    yield from (_source_checksum(_root_package(function)), function.__code__, function.__defaults__,
                function.__kwdefaults__)
    if _root_package(function) == "__main__":  # no package shows what its names stand for
        for name in function.__code__.co_names:
            used = function.__globals__.get(name)
            # One step far: what those names use in turn is not looked at.
            if isinstance(used, (*_ATOMS, FunctionType, type)):
                yield used


def _root_package(definition: Any) -> str:
    """Return the package that a definition is in."""
    return str(definition.__module__).partition(".")[0]


@cache  # the source on disk does not change under a running study
def _source_checksum(root: str) -> str:
    """Return the checksum of the source of a module, or of all modules of a package."""
    file = getattr(sys.modules.get(root), "__file__", None)
    folders = [Path(name) for name in getattr(sys.modules.get(root), "__path__", ())]
    checksum = hashlib.sha256()
    if root != "__main__":  # a script that is edited elsewhere has the same classes
        paths = [Path(file)] if file and not folders else []
        paths += sorted(chain.from_iterable(folder.rglob("*.py") for folder in folders))
        for path in paths:
            try:
                checksum.update(path.read_bytes())
            except OSError:  # gone since it was imported: its code in memory is told as well
                continue
    return checksum.hexdigest()
