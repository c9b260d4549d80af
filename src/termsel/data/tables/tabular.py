"""Tables of features: their checks, parts of them, several as one, frames of pandas."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from functools import cache
from types import MappingProxyType
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from termsel.core.display import Glance
from termsel.core.errors import TermselError, requires
from termsel.data.coordinates.crs import horizontal
from termsel.data.tables.attributes import Attributes, as_attributes, joined, rows_at
from termsel.data.values import (
    check_deviations,
    check_finite,
    check_heights,
    check_ids,
    frozen,
)

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
        with requires("tables require", "pandas", "pandas"):
            from pandas import DataFrame
        return DataFrame(dict(self._columns()))

    def to_geopandas(self, crs: str = "local") -> Any:
        """Return a geopandas GeoDataFrame with the place of each on the ground, in that CRS."""
        with requires("maps of features require", "geopandas", "geopandas"):
            import shapely
            from geopandas import GeoDataFrame
        # Without all heights the shapes are plane ones: GIS programs take NaN for no geometry.
        positions = self._places()
        flat = bool(np.isnan(positions[..., 2]).any())
        at = positions[..., :2] if flat else positions
        shapes = shapely.points(at) if positions.ndim == 2 else shapely.linestrings(at)
        return GeoDataFrame(dict(self._columns()), geometry=shapes, crs=horizontal(crs) or None)


class Tabular(Glance, Framed):
    """Base of points and lines, as tables with a row for each; image and ground are of each row."""

    ids: tuple[str, ...]
    image: NDArray[np.float64]
    ground: NDArray[np.float64]
    sigma: NDArray[np.float64] | None
    attributes: Attributes

    def _check(self, kind: str, ends: tuple[int, ...], *reserved: str) -> None:
        """Make arrays of what was given, and refuse what is no feature.

        `ends` is the shape of the places of one feature, (2,) of lines; no attributes can have the
        names `taken`.
        """
        ids = tuple(str(name).strip() for name in self.ids)  # as files hold them
        n = len(ids)
        checked: dict[str, Any] = {
            "ids": ids, "image": frozen(self.image, (n, *ends, 2), f"image of {kind}s"),
            "ground": frozen(self.ground, (n, *ends, 3), f"ground of {kind}s"),
            "attributes": as_attributes(self.attributes, n, *reserved)}
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        check_ids(ids, kind, unique=not ends)
        if n:
            check_finite(self.image, ids, kind, "image coordinates")
            check_finite(self.ground[..., :2], ids, kind, "ground coordinates")
            check_heights(self.ground[..., 2], ids, kind)
        if n and self.sigma is not None:
            # Line and sample of a point have deviations of their own, a line has one across it.
            sigma = frozen(self.sigma, (n,) if ends else (n, 2), f"sigma of {kind}s")
            object.__setattr__(self, "sigma", sigma)
            check_deviations(sigma, ids, kind)

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
        """Return the rows at `index` (integers or a mask)."""
        rows = rows_of(self.ids, index)
        return unchecked(self, **{name: _rows_at(value, rows) for name, value in _own(self)})

    def join(self, further: Self) -> Self:
        """Return the rows of both; unknown standard deviations are the median of the known."""
        table: Any = self  # a dataclass, which this base is not
        joint: Self = replace(table, **self._with_rows_of(further))
        return joint

    def join_unchecked(self, further: Self) -> Self:
        """Return the rows of both, which are parts of one table.

        What was checked of that table holds for both together, so no value is checked again.
        """
        if not len(further):
            return self
        fields = self._with_rows_of(further)
        # All rows, as arrays that nobody can write to: a table that is checked makes these itself.
        fields["attributes"] = rows_at(fields["attributes"], slice(None))
        return unchecked(self, **fields)

    def _with_rows_of(self, further: Self) -> dict[str, Any]:
        """Return the fields of the rows of both."""
        sigmas = [table.sigma for table in (self, further) if table.sigma is not None]
        # Features without a standard deviation have this weight in an adjustment.
        sigma = np.concatenate([
            np.full((len(table), *sigmas[0].shape[1:]), np.median(sigmas[0]))
            if table.sigma is None else table.sigma
            for table in (self, further)]) if sigmas else None
        texts = {name: value + getattr(further, name) for name, value in _own(self)
                 if isinstance(value, tuple)}  # ids and roles
        return {
            "image": np.concatenate([self.image, further.image]),
            "ground": np.concatenate([self.ground, further.ground]), "sigma": sigma,
            "attributes": joined(self.attributes, len(self), further.attributes, len(further)),
            **texts}


def _own(table: Any) -> list[tuple[str, Any]]:
    """Return the fields of points or lines; all else that they keep is derived."""
    return [(name, getattr(table, name)) for name in _names(table.__class__)]


@cache
def _names(kind: type) -> tuple[str, ...]:
    return tuple(column.name for column in fields(kind))


def _rows_at(value: Any, rows: NDArray[np.intp]) -> Any:
    if isinstance(value, tuple):  # of a thousand points names are asked for many times
        return tuple(map(value.__getitem__, rows.tolist()))
    return rows_at(value, rows) if isinstance(value, Mapping) else \
        None if value is None else value[rows]


def rows_of(ids: Sequence[str], index: ArrayLike) -> NDArray[np.intp]:
    """Return the rows that an index of integers or a mask names, each at most once."""
    array = np.asarray(index)
    rows = np.arange(len(ids))[array if array.size else np.zeros(0, dtype=np.intp)]
    # A point that is taken twice would count twice in every fit.
    times = np.bincount(rows, minlength=1)
    if times.max() > 1:
        raise TermselError(f"{ids[int(times.argmax())]!r} is asked for {times.max()} times",
                           hint="Give the index of every point and line once.")
    return np.asarray(rows)


def unchecked(table: _Table, **changes: Any) -> _Table:
    """Return points or lines with some fields changed, without the checks of new ones."""
    # What was checked once holds for a part of them, and in other units. Fits make so many of these
    # that the checks took a quarter of their time.
    changed = object.__new__(type(table))
    for name, value in _own(table):
        value = changes.get(name, value)
        if isinstance(value, np.ndarray):
            value.setflags(write=False)
        object.__setattr__(changed, name, value)
    return changed
