"""Tables of features: their checks, parts of them, several as one, frames of pandas."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import fields, replace
from functools import cache
from itertools import chain
from types import MappingProxyType
from typing import Any, Self, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from termsel.core.arguments import explains_arguments
from termsel.core.display import Glance
from termsel.core.errors import (
    TermselError,
    cut,
    is_printable,
    make_printable,
    require_import,
    unknown_name_error,
)
from termsel.data.arrays import FloatArray, numbers_or_nan
from termsel.data.coordinates.crs import horizontal_crs
from termsel.data.tables.columns import TAKEN

# Ids, coordinates and deviations that every reader, plugin and program takes.

FARTHEST = 1e50
"""Coordinates from which on squares and products of some of them overflow."""

MAX_ID = 200
"""Characters of an id."""

_MAX_NAMED = 8
"""Places that a message names."""
_MAX_IN_PLACE = 3
"""Points of one place that a message names."""

_CORRECT = "Correct the values or remove the feature."


def read_only_array(values: ArrayLike, shape: tuple[int, ...], content: str) -> FloatArray:
    """Return values as an array that cannot be written to; refuse another shape."""
    array = np.array(numbers_or_nan(values))  # a copy, which nobody else can change
    if array.shape != shape:
        raise TermselError(f"{content} has shape {array.shape}, expected {shape}",
                           hint=_shape_in_words(array.shape, shape))
    array.setflags(write=False)
    return array


def _shape_in_words(shape: tuple[int, ...], expected: tuple[int, ...]) -> str:
    """Return what to give where an array of a feature's values has another shape."""
    if shape[1:] != expected[1:] and shape == (*expected[:-1], expected[-1] - 1) and (
            expected[-1] == 3):
        return "Give x, y and z of each, with NaN for a height that is not known."
    if shape == expected[:1] and expected[1:] == (2,):
        return "Give two values of each, of line and of sample, also where they are the same."
    return f"There are {expected[0]} ids: give the values of each, in their order."


def check_finite(values: FloatArray, ids: Sequence[str], kind: str, content: str) -> None:
    """Raise TermselError for coordinates that are not finite, or too far."""
    _refuse_bad_values(~np.isfinite(values), ids, kind, f"{content} that are not finite numbers",
                       _CORRECT)
    check_near(values, ids, kind, content)


def check_near(values: FloatArray, ids: Sequence[str], kind: str, content: str) -> None:
    """Raise TermselError for coordinates that are too far."""
    _refuse_bad_values(np.abs(values) >= FARTHEST, ids, kind, f"{content} of {FARTHEST:g} or more",
                       _CORRECT)


def check_heights(z: FloatArray, ids: Sequence[str], kind: str) -> None:
    """Raise TermselError for infinite heights; blank ones are NaN and suit models without height.
    """
    _refuse_bad_values(np.isinf(z), ids, kind, "an infinite height")
    check_near(z, ids, kind, "a height")


def refuse_bad_deviations(sigma: FloatArray, ids: Sequence[str], kind: str) -> None:
    """Raise TermselError for deviations that are not positive numbers of a usual size.

    Their squares, and those of their inverses, the weights, must not overflow.
    """
    # "not between" is true of NaN, too.
    is_bad = ~((sigma > 1 / FARTHEST) & (sigma < FARTHEST))
    if not is_bad.any():
        return
    value = sigma[is_bad][0]
    fault = "beyond what can be computed with" if value > 0 else "not positive"
    # A point has one deviation for each axis; a line has one alone, and so no axis here.
    axes = np.argwhere(is_bad)[0, 1:]
    name = ("sigma_line", "sigma_sample")[axes[0]] if len(axes) else "sigma"
    _refuse_bad_values(is_bad, ids, kind, f"{name} {value:g}, a standard deviation that is {fault}",
                       "Correct it, or leave the columns of standard deviations out.")


def _refuse_bad_values(is_bad: NDArray[np.bool_], ids: Sequence[str], kind: str, problem: str,
                       hint: str | None = None) -> None:
    """Raise TermselError for the first feature with a bad value, given which are bad, (n, ...)."""
    features = is_bad.reshape(len(ids), -1).any(axis=1)
    if features.any():
        name = ids[int(np.argmax(features))]
        raise TermselError(f"{kind} {name!r} has {problem}", hint=hint, ids=[name])


def refuse_repeated_places(ground: FloatArray, ids: Sequence[str]) -> None:
    """Raise TermselError for points with the same ground coordinates (n, 3), naming them.

    One image position with several ground points is a line of sight through several heights; but
    one ground point cannot be seen at two image positions.
    """
    repeated = repeated_places(ground)
    if not repeated:
        return
    earlier, later, *_ = repeated[0]
    if len(repeated[0]) == len(ids) > 2:
        raise TermselError("all points have the same ground coordinates",
                           ids=[ids[later], ids[earlier]],
                           hint="Was one position filled down the columns x and y? Give each "
                                "point its own.")
    at_zero = next((rows for rows in repeated if not ground[rows, :2].any()), None)
    if at_zero is not None:
        # Averaging, which the hint below suggests for others, would keep a false point here.
        earlier, later, *_ = at_zero
        raise TermselError(f"{places_in_words(ids, [at_zero])}, x = 0 and y = 0",
                           ids=[ids[later], ids[earlier]],
                           hint="Zeros stand for places that are not known: remove these "
                                "points. In a raster of coordinates state 0 as its nodata "
                                "value.")
    is_pair = len(repeated) == 1 and len(repeated[0]) == 2
    surplus = "one of them" if is_pair else "all but one of each"
    raise TermselError(places_in_words(ids, repeated), ids=[ids[later], ids[earlier]],
                       hint=f"Remove {surplus}, or average their image coordinates: --set "
                            "repeated=average.")


def repeated_places(ground: FloatArray, *, with_single: bool = False) -> list[list[int]]:
    """Return the rows of the points at each place on the ground (n, 3) that has several points.

    `with_single` adds the places that have a single point. Unknown heights count as 0.
    """
    _, labels = np.unique(np.nan_to_num(ground, nan=0.0), axis=0, return_inverse=True)
    rows: dict[int, list[int]] = {}
    for row, number in enumerate(labels.ravel().tolist()):
        rows.setdefault(number, []).append(row)
    return [group for group in rows.values() if with_single or len(group) > 1]


def places_in_words(ids: Sequence[str], groups: Sequence[Sequence[int]]) -> str:
    """Return a clause that says which points have the same ground coordinates.

    Each of `groups` has the rows of the points at one place.
    """
    groups_in_words = []
    for rows in groups[:_MAX_NAMED]:
        names = [repr(ids[row]) for row in rows[:_MAX_IN_PLACE]]
        if len(rows) > _MAX_IN_PLACE:
            names.append(f"{len(rows) - _MAX_IN_PLACE} more")
        groups_in_words.append(f"{', '.join(names[:-1])} and {names[-1]}")
    named = "; ".join(groups_in_words)
    unnamed = ""
    if len(groups) > _MAX_NAMED:
        unnamed = f"; and those of {len(groups) - _MAX_NAMED} more positions"
    each_group = " each" if len(groups) > 1 else ""
    return f"points {named}{unnamed}{each_group} have the same ground coordinates"


def refuse_repeated_lines(ground: FloatArray, ids: Sequence[str]) -> None:
    """Raise TermselError for two lines with the same ground vertices (n, 2, 3), in any order.

    Unknown heights count as 0.
    """
    ends = np.nan_to_num(ground, nan=0.0)
    # The ends of each line are put in one order: that with the smaller first differing coordinate
    # comes first.
    differs = ends[:, 0] != ends[:, 1]
    first_difference = np.argmax(differs, axis=1)
    index = np.arange(len(ends))
    swap = ends[index, 0, first_difference] > ends[index, 1, first_difference]
    ends[swap] = ends[swap][:, ::-1]
    pair = _first_repeated_row(ends.reshape(len(ids), -1))
    if pair:
        earlier, later = (ids[i] for i in pair)
        raise TermselError(f"lines {earlier!r} and {later!r} have the same ground vertices",
                           hint="Remove one of them.", ids=[later, earlier])


def _first_repeated_row(rows: FloatArray) -> tuple[int, int] | None:
    """Return an earlier row, and the first row that repeats it; None if all differ."""
    _, first, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    earlier = first[inverse.ravel()]
    repeated = np.flatnonzero(earlier != np.arange(len(rows)))
    return (int(earlier[repeated[0]]), int(repeated[0])) if repeated.size else None


def reason_to_refuse_id(name: str) -> str:
    """Return what is wrong with an id, as the end of a sentence; "" if nothing is.

    An id with nothing wrong can be written to a table of text and shown on a terminal.
    """
    if not name:
        return "is blank"
    if len(name) > MAX_ID:
        return f"has {len(name):,} characters, more than {MAX_ID}"
    return "" if is_printable(name) else "has a line break or a character that cannot be printed"


def refuse_bad_ids(ids: Sequence[str], kind: str, *, unique: bool) -> None:
    """Raise TermselError for ids that `reason_to_refuse_id` objects to.

    `kind` is "point" or "line", for messages. If ids have to be `unique`, one that occurs twice is
    refused, too.
    """
    for name in ids:
        if wrong := reason_to_refuse_id(name):
            raise TermselError(f"the id {cut(name, 40)!r} of a {kind} {wrong}", ids=[name],
                               hint=f"Give every {kind} a short id of letters, digits and signs.")
    twice = [name for name, count in Counter(ids).items() if count > 1] if unique else []
    if twice:
        raise TermselError(f"{kind} id {twice[0]!r} is used {Counter(ids)[twice[0]]} times",
                           hint=f"Give every {kind} a different id.", ids=twice[:1])


# Attributes of features: further columns of their file, such as source or date, as text.

TextArray = NDArray[np.object_]
Attributes = Mapping[str, TextArray]
"""Text by the name of the column, one for each row, "" where it is not known."""

_UNKNOWN = frozenset({"None", "nan", "NaT", "<NA>"})
"""How Python, numpy and pandas write what is not known."""

MAX_TEXT = 10_000
"""Characters of a text; Python's reader of tables takes no cells of more than 131,072."""


def is_free(name: str) -> bool:
    """Return whether a column of attributes can have this name."""
    return (isinstance(name, str) and bool(name) and name == name.strip() and is_printable(name)
            and len(name) <= 200 and name.casefold() not in TAKEN)


def as_attributes(attributes: Mapping[str, Iterable[Any]], n: int, *reserved: str) -> Attributes:
    """Return columns of n rows as features hold them: stripped text that cannot be changed.

    None, NaN and what pandas has in their place become "", an unknown value. Raises TermselError
    for a column whose name is `reserved`, has a meaning of its own in tables, cannot be printed, or
    is used twice, and for a column that does not have n values.
    """
    columns: dict[str, TextArray] = {}
    for name, values in attributes.items():
        if not is_free(name) or name.casefold() in reserved:
            raise TermselError(f"a column of attributes cannot have the name {name!r}",
                               hint="Tables use it otherwise, or it is no short printable text.")
        # Upper and lower case count as the same, as programs change it when they write files.
        if name.casefold() in map(str.casefold, columns):
            raise TermselError(f"two columns of attributes have the name {name!r}",
                               hint="Upper and lower case count as the same.")
        if isinstance(values, str) or not isinstance(values, Iterable):
            rows = []
        else:
            rows = list(map(_cell_text, values))
        if len(rows) != n:
            raise TermselError(f"the attributes {name!r} have {len(rows)} values for {n} rows",
                               hint="Give a list with a value for each.")
        cells = text_array(rows)
        cells.setflags(write=False)
        columns[name] = cells
    return MappingProxyType(columns)


def text_array(cells: Sequence[str]) -> TextArray:
    """Return text as an array (n,) of objects: one long cell makes the others no longer."""
    array = np.empty(len(cells), dtype=object)
    array[:] = cells
    return array


def _cell_text(value: Any) -> str:
    """Return a value as the text of a table's cell; "" for what stands for an unknown one."""
    if not isinstance(value, str) and str(value) in _UNKNOWN:
        return ""
    return cut(make_printable(str(value).replace("\r\n", "\n")).strip(), MAX_TEXT)


def rows_at(attributes: Attributes, index: NDArray[Any] | slice) -> Attributes:
    """Return the rows at an index, which cannot be written to."""
    rows = {name: cells[index] for name, cells in attributes.items()}
    for cells in rows.values():
        cells.setflags(write=False)
    return MappingProxyType(rows)


def join_attributes(first: Attributes, n: int, second: Attributes, m: int) -> dict[str, TextArray]:
    """Return the columns of both tables, (n + m,), "" where one of them has no such column."""
    return {name: np.concatenate([_column_text(first, name, n), _column_text(second, name, m)])
            for name in distinct_names([*first, *second])}


def distinct_names(names: Iterable[str]) -> list[str]:
    """Return names without repetitions in upper or lower case; the first spelling stays."""
    first_spelling: dict[str, str] = {}
    for name in names:
        first_spelling.setdefault(name.casefold(), name)
    return list(first_spelling.values())


def _column_text(table: Attributes, name: str, rows: int) -> TextArray:
    """Return a column of a table, (rows,), whatever its case; "" in each row if there is none."""
    return next((cells for key, cells in table.items() if key.casefold() == name.casefold()),
                np.full(rows, "", dtype=object))


def common_attributes(rows: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """Return the text that all rows have in a column, by column; "" if their texts differ.

    Columns that the first row does not have are left out. Without rows there are none.
    """
    common = dict(rows[0]) if rows else {}
    for row in rows:
        common = {name: value if row.get(name, "") == value else ""
                  for name, value in common.items()}
    return common


def columns_of(rows: Sequence[Mapping[str, str]]) -> dict[str, TextArray]:
    """Return the attributes of n rows by column, (n,) each, "" where a row has none.

    For names that differ in upper and lower case alone there is one column, with the first
    spelling.
    """
    columns = {}
    for name in distinct_names(chain.from_iterable(rows)):
        columns[name] = text_array([row.get(name, "") for row in rows])
    return columns


def stack_columns(tables: Sequence[Attributes], rows: Sequence[int], name: str) -> TextArray:
    """Return a column of several tables one after another, (n,).

    `rows` are the numbers of rows of the tables. A table without the column has "" in its rows.
    Raises TermselError if no table has it.
    """
    names = distinct_names(chain.from_iterable(tables))
    if name.casefold() not in map(str.casefold, names):
        raise unknown_name_error("column of attributes", name, names,
                                 "It is a further column of the file of the features.")
    return np.concatenate([_column_text(table, name, n)
                           for table, n in zip(tables, rows, strict=True)])


def as_numbers(cells: TextArray, ids: Sequence[str], name: str) -> FloatArray:
    """Return cells as numbers, (n,), NaN where they are blank.

    Raises TermselError for a cell that is no finite number. It says the id, in `ids`, of its
    feature, and the column's `name`.
    """
    numbers = np.empty(len(cells))
    for row, cell in enumerate(cells):
        try:
            numbers[row] = float(cell or "nan")
        except ValueError:
            numbers[row] = math.inf
        # Python reads 1_000 as a number, which no table means.
        if cell and ("_" in cell or not math.isfinite(numbers[row])):
            raise TermselError(f"{ids[row]!r} has {cell!r} in this column, expected a number",
                               column=name, ids=[ids[row]],
                               hint="Correct the cell, or leave it blank; texts() returns it as "
                                    "text.")
    return numbers


_Table = TypeVar("_Table", bound=Any)


class Framed:
    """Base of what frames of pandas can show: subclasses return columns and places."""

    __slots__ = ()

    def _columns(self) -> Mapping[str, Any]:
        raise NotImplementedError

    def _places(self) -> NDArray[np.float64]:
        """Return points (n, 3), or the two ends of lines (n, 2, 3)."""
        raise NotImplementedError

    def to_pandas(self) -> Any:
        """Return a pandas DataFrame with a row for each."""
        with require_import("tables require", "pandas", "pandas"):
            from pandas import DataFrame
        return DataFrame(dict(self._columns()))

    @explains_arguments()
    def to_geopandas(self, crs: str = "local") -> Any:
        """Return a geopandas GeoDataFrame with a point or line on the ground for each feature.

        `crs` is that of the features. If a height is unknown, the shapes have x and y alone, as GIS
        programs take NaN for no geometry. Raises TermselError if geopandas is not installed.
        """
        with require_import("maps of features require", "geopandas", "geopandas"):
            import shapely
            from geopandas import GeoDataFrame
        positions = self._places()
        if np.isnan(positions[..., 2]).any():
            positions = positions[..., :2]
        shapes = (shapely.points(positions) if positions.ndim == 2
                  else shapely.linestrings(positions))
        return GeoDataFrame(dict(self._columns()), geometry=shapes, crs=horizontal_crs(crs) or None)


class Tabular(Glance, Framed):
    """Base of points and lines, as tables with a row for each; image and ground are of each row."""

    ids: tuple[str, ...]
    image: NDArray[np.float64]
    ground: NDArray[np.float64]
    sigma: NDArray[np.float64] | None
    attributes: Attributes

    def _check(self, kind: str, ends: tuple[int, ...], *reserved: str) -> None:
        """Make frozen arrays of the fields, and raise TermselError for values no feature can have.

        `ends` is the shape of the places of one feature, (2,) of lines; no attributes can have the
        names `reserved`.
        """
        if isinstance(self.ids, str):
            raise TermselError(f"ids is {self.ids!r:.60}, expected a list of texts",
                               hint=f"Give one for each {kind}, such as ['P1', 'P2'].")
        ids = tuple(str(name).strip() for name in self.ids)  # as files hold them
        n = len(ids)
        checked: dict[str, Any] = {
            "ids": ids, "image": read_only_array(self.image, (n, *ends, 2), f"image of {kind}s"),
            "ground": read_only_array(self.ground, (n, *ends, 3), f"ground of {kind}s"),
            "attributes": as_attributes(self.attributes, n, *reserved)}
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        refuse_bad_ids(ids, kind, unique=not ends)
        if n:
            check_finite(self.image, ids, kind, "image coordinates")
            check_finite(self.ground[..., :2], ids, kind, "ground coordinates")
            check_heights(self.ground[..., 2], ids, kind)
        if n and self.sigma is not None:
            # Line and sample of a point have deviations of their own, a line has one across it.
            sigma = read_only_array(self.sigma, (n,) if ends else (n, 2), f"sigma of {kind}s")
            object.__setattr__(self, "sigma", sigma)
            refuse_bad_deviations(sigma, ids, kind)

    def __len__(self) -> int:
        return len(self.ids)

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "attributes": dict(self.attributes)}  # a read-only view has no pickle

    def __setstate__(self, state: dict[str, Any]) -> None:
        columns = state["attributes"]
        for value in (*state.values(), *columns.values()):
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
        vars(self).update(state, attributes=MappingProxyType(columns))

    def _places(self) -> NDArray[np.float64]:
        return self.ground

    def take(self, index: ArrayLike) -> Self:
        """Return the points or lines at `index`, integers or a mask (n,).

        Raises TermselError if an index names one more than once.
        """
        rows = rows_of(self.ids, index)
        row_numbers = rows.tolist()
        fields_at_rows: dict[str, Any] = {}
        for name in _given_fields(type(self)):  # type: ignore[arg-type]
            value = getattr(self, name)
            if isinstance(value, tuple):
                value = tuple(map(value.__getitem__, row_numbers))
            elif isinstance(value, Mapping):
                value = rows_at(value, rows)
            elif value is not None:
                value = value[rows]
            fields_at_rows[name] = value
        return replace_unchecked(self, **fields_at_rows)

    def join(self, further: Self) -> Self:
        """Return the rows of both; unknown standard deviations are the median of the known."""
        table: Any = self  # a dataclass, which this base is not
        joint: Self = replace(table, **self._with_rows_of(further))
        return joint

    def join_unchecked(self, further: Self) -> Self:
        """Return the rows of this table, then those of `further`, which are parts of one table.

        No value is checked again: what was checked of that table holds for its parts together.
        """
        if not len(further):
            return self
        fields = self._with_rows_of(further)
        # All rows, as arrays that nobody can write to: a table that is checked makes these itself.
        fields["attributes"] = rows_at(fields["attributes"], slice(None))
        return replace_unchecked(self, **fields)

    def _with_rows_of(self, further: Self) -> dict[str, Any]:
        """Return the fields, by name, of a table with the rows of this one and then of `further`.

        Where only one of them states standard deviations, the rows of the other get their median.
        """
        known_sigmas = [table.sigma for table in (self, further) if table.sigma is not None]
        sigma = None
        if known_sigmas:
            # An adjustment gives a row the weight median / sigma, or 1 if no row has a sigma. The
            # median keeps this weight of 1.
            usual_sigma = np.median(known_sigmas[0])
            sigma = np.concatenate([
                np.full((len(table), *known_sigmas[0].shape[1:]), usual_sigma)
                if table.sigma is None else table.sigma for table in (self, further)])
        texts = {name: getattr(self, name) + getattr(further, name)
                 for name in _given_fields(type(self))  # type: ignore[arg-type]
                 if isinstance(getattr(self, name), tuple)}  # ids and roles
        return {
            "image": np.concatenate([self.image, further.image]),
            "ground": np.concatenate([self.ground, further.ground]), "sigma": sigma,
            "attributes": join_attributes(self.attributes, len(self), further.attributes,
                                          len(further)),
            **texts}


@cache  # a fact of a class, asked for with each new table
def _given_fields(kind: Hashable) -> tuple[str, ...]:
    """Return the names of the fields of a table or features; all else they keep is derived."""
    return tuple(column.name for column in fields(cast(type, kind)))


def rows_of(ids: Sequence[str], index: ArrayLike) -> NDArray[np.intp]:
    """Return the numbers of the rows, (r,), that an index of integers or a mask names.

    Raises TermselError if it names one more than once, as such a point would count twice in each
    fit; for another length of the mask, for rows that are not there, and for ids.
    """
    array = np.asarray(index)
    _refuse_other_index(array, ids)
    rows = np.arange(len(ids))[array if array.size else np.zeros(0, dtype=np.intp)]
    times = np.bincount(rows, minlength=1)
    if times.max() > 1:
        raise TermselError(f"{ids[int(times.argmax())]!r} is asked for {times.max()} times",
                           hint="Give the index of every point and line once.")
    return np.asarray(rows)


def _refuse_other_index(index: NDArray[Any], ids: Sequence[str]) -> None:
    """Raise TermselError for what is no mask of the rows with `ids`, and no numbers of rows."""
    n = len(ids)
    if index.dtype.kind == "b" and index.shape != (n,):
        raise TermselError(f"the mask has shape {index.shape}, expected ({n},)",
                           hint="Give True or False for each row, in the order of ids.")
    if index.dtype.kind in "UO":
        raise TermselError(f"{index.tolist()[0]!r:.60} is no row; these are numbers from 0 to "
                           f"{n - 1}",
                           hint="Of ids: take([name in IDS for name in points.ids]).")
    if index.dtype.kind in "iu" and index.size and (index.min() < -n or index.max() >= n):
        wrong = index[(index < -n) | (index >= n)][0]
        raise TermselError(f"there is no row {wrong}: {n} rows count from 0 to {n - 1}")
    if index.dtype.kind == "f" and index.size:
        raise TermselError(f"{index.flat[0]} is no row, which has a whole number",
                           hint="Give whole numbers, or a mask of True and False for each row.")


def replace_unchecked(table: _Table, **changes: Any) -> _Table:
    """Return points, lines or features with some fields changed, without the checks of new ones.

    It is for changes that keep what was checked, such as a choice of rows or other units. Fits make
    so many of these objects that the checks took a quarter of their time. Arrays among the changes
    become read-only.
    """
    changed = object.__new__(type(table))
    for name in _given_fields(type(table)):  # type: ignore[arg-type]
        value = changes[name] if name in changes else getattr(table, name)
        if isinstance(value, np.ndarray):
            value.setflags(write=False)
        object.__setattr__(changed, name, value)
    return changed
