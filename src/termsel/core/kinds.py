"""Kinds of arguments, by what a function declares: whether a value is of one, and its words.

Python refuses an argument of another type only where it is used, in words of its own. These name
the argument and say what is expected.
"""

from __future__ import annotations

import types
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import ArrayLike

from termsel.core.errors import shown_value

_NUMERIC = "biuf"
"""Kinds of numpy's types that hold numbers."""

_ARRAY = "an array of numbers"

_FOLDERS = ("out", "folder")
"""Arguments that name a folder; other names are those of files."""

_NAMES = ("problem", "model", "solver", "criterion", "method", "strategy", "dataset", "kind",
          "name", "to", "scheduler", "resampling")
"""Arguments whose text is a name of something that is known."""

_EXAMPLES = {"columns": ", such as {'x': 'east', 'y': 'north'}",
             "options": ", such as {'degree': 2}"}
"""What follows "a dict", by the name of the argument."""


@dataclass(frozen=True)
class Kind:
    """A kind of value: its name in words, and what tells whether a value is of it."""

    words: str
    holds: Callable[[object], bool]


def kinds_of(function: Callable[..., Any], unchecked: Collection[str]) -> dict[str, Kind]:
    """Return the kinds of the arguments of a function, but for those that may be anything."""
    hints = get_type_hints(function)
    kinds = {name: kind_of(name, hint) for name, hint in hints.items()
             if name != "return" and name not in unchecked}
    return {name: kind for name, kind in kinds.items() if kind is not None}


def kind_of(name: str, hint: Any) -> Kind | None:
    """Return the kind of values of a type hint; None where it takes anything, or cannot be told."""
    if hint is Any:
        return None
    if hint is ArrayLike:
        return Kind(_ARRAY, _is_numeric)
    origin = get_origin(hint)
    if origin in (Union, types.UnionType):
        return _kind_of_union(name, get_args(hint))
    if origin is np.ndarray:
        return Kind(_ARRAY, _is_numeric)
    if origin is type:
        return Kind("a class", lambda value: isinstance(value, type))
    if origin is tuple:
        return _kind_of_tuple(get_args(hint))
    if isinstance(origin, type):
        return _kind_of_collection(name, origin, get_args(hint))
    if hint is str and name in _NAMES:
        return Kind("a name", _SIMPLE[str].holds)
    return _SIMPLE.get(hint) or _kind_of_class(name, hint)


def _kind_of_union(name: str, hints: Sequence[Any]) -> Kind | None:
    """Return the kind of values that are of one of several types; None if one of these has none.

    A value that may also be None is not said to be: nobody has to give it.
    """
    named = [hint for hint in hints if hint is not types.NoneType]
    # A union within a union is dissolved in it.
    of_arrays = get_args(ArrayLike)
    if set(of_arrays) <= set(named):
        named = [ArrayLike, *(hint for hint in named if hint not in of_arrays)]
    # The name of a file is a text or a path.
    is_file = Path in named and str in named
    if is_file:
        named = [Path, *(hint for hint in named if hint not in (Path, str))]
    kinds = [kind_of(name, hint) for hint in named]
    if None in kinds:
        return None
    # A name is the commonest form, and stands first.
    words = [kind.words for kind in kinds if kind is not None]
    holds = [kind.holds for kind in kinds if kind is not None]
    if is_file:
        holds.append(_SIMPLE[str].holds)
    if types.NoneType in hints:
        holds.append(lambda value: value is None)
    listed = " or ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else words[0]
    return Kind(listed, lambda value: any(held(value) for held in holds))


def _kind_of_tuple(hints: Sequence[Any]) -> Kind | None:
    """Return the kind of several numbers in their order, such as the bounds of a map.

    `hints` are the types of all places; None is returned if one of them is no number.
    """
    if not set(hints) <= {int, float}:
        return None

    def holds(value: object) -> bool:
        """Return whether a value has so many numbers."""
        if isinstance(value, str) or not isinstance(value, Sequence | np.ndarray):
            return False
        return len(value) == len(hints) and all(map(_SIMPLE[float].holds, value))

    noun = "whole numbers" if set(hints) == {int} else "numbers"
    return Kind(f"{len(hints)} {noun}", holds)


def _kind_of_collection(name: str, origin: type, contained: Sequence[Any]) -> Kind:
    """Return the kind of a mapping, a list or a function."""
    if issubclass(origin, Mapping):
        return Kind(f"a dict{_EXAMPLES.get(name, '')}", lambda value: isinstance(value, Mapping))
    if not issubclass(origin, Iterable):
        return Kind("a function", callable)
    of_functions = get_origin(next(iter(contained), None)) is Callable

    def holds(value: object) -> bool:
        """Return whether a value is a list: not a text, which is one of characters."""
        if isinstance(value, str) or not isinstance(value, origin | np.ndarray):
            return False
        # What can be gone through once only is not looked into.
        return not of_functions or not isinstance(value, Sequence) or all(map(callable, value))

    return Kind(f"a list{' of functions' * of_functions}", holds)


def _kind_of_class(name: str, hint: Any) -> Kind | None:
    """Return the kind of objects of a class; None for what is no class to ask for."""
    if hint is Path:
        noun = "folder" if name in _FOLDERS else "file"
        return Kind(f"the name of a {noun}", lambda value: isinstance(value, PathLike))
    if not isinstance(hint, type) or getattr(hint, "_is_protocol", False) or hint is object:
        return None
    return Kind(f"a termsel.{hint.__name__}", lambda value: isinstance(value, hint))


def _is_numeric(value: object) -> bool:
    """Return whether a value is an array of numbers, or numpy makes one of it; None is not."""
    if isinstance(value, np.ndarray) and value.dtype.kind in _NUMERIC:
        return True
    try:
        # Of complex numbers numpy would take the real part.
        if value is None or np.iscomplexobj(np.asarray(value)):
            return False
        np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):  # no numbers, or rows of several lengths
        return False
    return True


def _first_no_number(value: object) -> str:
    """Return where an array has something that is no number, and what; "" if that is not known."""
    try:
        cells = np.asarray(value, dtype=object)
    except (TypeError, ValueError):  # no rows, or rows of several lengths
        return ""
    for place, cell in np.ndenumerate(cells):
        if not _is_numeric(cell):
            row = f" in row {place[0]}" if place else ""
            column = f", column {place[1]}" if len(place) > 1 else ""
            return f"{cell!r:.60}{row}{column}" if np.ndim(cell) == 0 else ""
    return ""


def _is_number(value: object, kind: type = Real) -> bool:
    return isinstance(value, kind) and not isinstance(value, bool)


_SIMPLE: Mapping[Any, Kind] = {
    str: Kind("a text", lambda value: isinstance(value, str)),
    bool: Kind("True or False", lambda value: isinstance(value, bool | np.bool_)),
    int: Kind("a whole number", lambda value: _is_number(value, Integral)),
    float: Kind("a number", _is_number)}


MADE_BY = {
    _ARRAY: "Give a row of numbers for each place, such as [[1.0, 2.0, 3.0]].",
    "a termsel.Points": "termsel.read(FILE).points makes one, of a table as well as of a file.",
    "a termsel.FeatureSet": "termsel.read(FILE) makes one, of a table as well as of a file.",
    "a termsel.Rpc": "termsel.read_rpc(FILE) makes one, and result.to_rpc().",
    "a termsel.Problem": "termsel.prepare('poly-terms', features=FEATURES).problem is one.",
    "a termsel.Solver": "termsel.GeneticAlgorithm() is one; termsel.get('solvers', NAME)() makes "
                        "one by its name.",
    "a termsel.Method": "termsel.get('methods', NAME) is one by its name, termsel.Auto() another.",
    "a termsel.Task": "termsel.prepare('poly-terms', features=FEATURES) makes one.",
    "a termsel.Lines": "termsel.read(lines=FILE).lines makes one.",
    "a termsel.Result": "termsel.run(features=FEATURES) or termsel.read_result(DIR) makes one.",
    "a termsel.Fit": "termsel.fit(FEATURES) makes one, and the fit of a result is one."}
"""Where a value of a kind comes from, by the words of the kind."""


_COLUMNS = {"ground": ["x", "y", "z"], "image": ["line", "sample"]}
"""Columns of a table that are an array of places, by the name of the argument."""


def remedy_for(name: str, value: object, kind: Kind) -> str:
    """Return what to write in place of a value that is not of its kind; "" if nothing is known."""
    if name == "crs" and isinstance(value, Integral):
        return f"Write crs='EPSG:{value}'."
    # Those of pyproj and rasterio.
    if name == "crs" and hasattr(value, "to_wkt"):
        return "Write crs=CRS.to_wkt(), with this object as CRS."
    if name in _COLUMNS and hasattr(value, "columns"):
        return f"Give its columns, such as {name}=TABLE[{_COLUMNS[name]}]."
    if name in _COLUMNS and (remedy := _as_places(name, value)):
        return remedy
    if isinstance(value, Enum):
        return f"Write {name}={value.name!r}."
    if name == "problem" and (hasattr(value, "points") or hasattr(value, "columns")):
        return "Points and lines are features=FEATURES."
    if name in _COLUMNS and isinstance(value, str | PathLike):
        return (f"Read the file first: {name}=pandas.read_csv({str(value)!r}, "
                f"comment='#')[{_COLUMNS[name]}].")
    if name == "image" and type(value).__name__ == "Result":
        return "The result comes before the image."
    if "the name of a file" in kind.words and (remedy := _as_file(name, value)):
        return remedy
    if name in ("model", "method") and (remedy := _as_model(name, value)):
        return remedy
    return MADE_BY.get(kind.words, "")


def _as_places(name: str, value: object) -> str:
    """Return how features, geometries or a dict are given as an array of places; "" for others."""
    if hasattr(value, "points"):
        return f"Give their coordinates: {name}=features.points.{name}."
    if hasattr(value, "image") and hasattr(value, "ground"):
        return f"Give their coordinates: {name}=points.{name}."
    first = next(iter(value), None) if isinstance(value, Iterable) else value
    if hasattr(first, "geom_type"):
        return f"Give their coordinates: {name}=shapely.get_coordinates(SHAPES, include_z=True)."
    if isinstance(value, Mapping):
        return f"Give its columns: {name}=pandas.DataFrame(DICT)[{_COLUMNS[name]}]."
    return ""


def _as_file(name: str, value: object) -> str:
    """Return how what is in memory is given to an argument that names a file; "" if not known."""
    # An open raster of rasterio or layer of fiona.
    if isinstance(getattr(value, "name", None), str) and hasattr(value, "close"):
        return f"Give its name in place of the open file: {name}={value.name!r}."  # type: ignore[attr-defined]
    if hasattr(value, "to_file"):
        return (f"Write the table to a file first: TABLE.to_file('{name}.gpkg'), then "
                f"{name}='{name}.gpkg'.")
    if hasattr(value, "__array__"):
        return f"Write the array to a file first, such as a GeoTIFF of rasterio: {name}=FILE."
    return ""


def _as_model(name: str, value: object) -> str:
    """Return how a function, an estimator or a table is used where a model is asked for, or ""."""
    if hasattr(value, "fit") and hasattr(value, "predict"):
        return ("A regressor of scikit-learn is a method by termsel_sklearn: "
                f"{name}=regressor_method({type(value).__name__}()).")
    if hasattr(value, "columns") or isinstance(value, np.ndarray):
        return ("Image and ground coordinates are columns of one table: line, sample, x, y and z. "
                "Join them: pandas.concat([X, Y], axis=1).")
    if callable(value):
        return ("A function of features that returns a projection is a method: "
                "termsel.FunctionMethod(NAME, TITLE, function=FUNCTION). A model is a subclass of "
                "termsel.RationalModel with name and blocks(ground).")
    return ""


def wrong_kind_message(name: str, value: object, kind: Kind) -> str:
    """Return what is wrong with an argument that is not of its kind."""
    shown = "None" if value is None else shown_value(value)
    if kind.words == _ARRAY and not isinstance(value, str) and (
            wrong := _first_no_number(value)):
        return f"{name} has {wrong}, expected numbers"
    return f"{name} is {shown}, expected {kind.words}"
