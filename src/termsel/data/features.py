"""What was measured: points and lines in the image and on the ground."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from termsel.core.arguments import changes_said, explains_arguments, lacks_said
from termsel.core.display import Glance
from termsel.core.errors import TermselError, count_in_words, shown_value
from termsel.data.arrays import BoolArray as BoolArray
from termsel.data.arrays import FloatArray as FloatArray
from termsel.data.arrays import IntArray as IntArray
from termsel.data.coordinates.crs import crs_text
from termsel.data.dem_difference import DemDifference
from termsel.data.rpc import Rpc
from termsel.data.tables.tabular import (
    Attributes,
    Tabular,
    TextArray,
    as_numbers,
    refuse_repeated_lines,
    refuse_repeated_places,
    replace_unchecked,
    rows_at,
    stack_columns,
)

if TYPE_CHECKING:
    from termsel.data.record.record import ImageFile

ROLES = ("control", "check", "independent", "off")


_OF_POINTS: Mapping[str, str] = {
    "x": "It is points.ground[:, 0].", "y": "It is points.ground[:, 1].",
    "z": "It is points.ground[:, 2].", "height": "It is points.ground[:, 2].",
    "lon": "It is points.ground[:, 0].", "lat": "It is points.ground[:, 1].",
    "longitude": "It is points.ground[:, 0].", "latitude": "It is points.ground[:, 1].",
    "line": "It is points.image[:, 0].", "sample": "It is points.image[:, 1].",
    "row": "It is points.image[:, 0].", "column": "It is points.image[:, 1].",
    "xy": "They are points.ground[:, :2].", "xyz": "They are points.ground.",
    "names": "They are points.ids.", "shape": "len(points) counts them.",
    **dict.fromkeys(("iloc", "loc", "head", "columns", "values", "describe", "index"),
                    "As a table: points.to_pandas()."),
    **dict.fromkeys(("geometry", "to_file", "explore", "plot", "total_bounds", "bounds"),
                    "As a table with geometries: points.to_geopandas(CRS)."),
    "to_crs": "termsel transforms no coordinates: geopandas does, TABLE.to_crs(CRS), before "
              "termsel.read(TABLE).",
    "[]": "Each row is of points.ids, points.image and points.ground; as a table: "
          "points.to_pandas()."}
"""Where the coordinates of points are, by what they are called elsewhere."""


@lacks_said("termsel.read(TABLE).points makes it of a table or a file.")
@changes_said("dataclasses.replace(points, {name}=VALUE) makes others.")
@dataclass(frozen=True, eq=False, repr=False)
class Points(Tabular):
    """Conjugate points.

    Parameters
    ----------
    ids : sequence of str, length n
        Unique names: printable, without line breaks, of at most 200 characters.
    image : array_like, shape (n, 2)
        Line and sample [px]; the centre of the upper-left pixel is (0, 0).
    ground : array_like, shape (n, 3)
        X, Y, Z in the units of the feature set's CRS; NaN for a height that is not known.
    sigma : array_like, shape (n, 2), optional
        Standard deviations of line and sample [px].
    roles : sequence of str, length n, optional
        Role given in the file: "control", "check", "independent", "off" or "" for none.
    attributes : mapping, optional
        Further columns of the file by name, n values each, such as source or date. They are kept as
        text, "" for what is not known.

    Raises
    ------
    TermselError
        For shapes that do not fit, values that are not finite, ids used twice or not printable,
        two points at one place on the ground, or a role that does not exist.

    Examples
    --------
    >>> import numpy as np
    >>> import termsel
    >>> points = termsel.Points(("P1", "P2"), np.array([[10.0, 20.0], [300.0, 400.0]]),
    ...                         np.array([[5e5, 4e6, 120.0], [5.01e5, 4e6, 130.0]]))
    >>> len(points), points.roles
    (2, ('', ''))
    """

    elsewhere = _OF_POINTS

    ids: tuple[str, ...]
    image: FloatArray
    ground: FloatArray
    sigma: FloatArray | None = None
    roles: tuple[str, ...] = ()
    attributes: Attributes = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the points, and give each a blank role if there are no roles.

        Raises TermselError as the class says.
        """
        self._check("point", ())
        n = len(self.ids)
        roles = tuple(self.roles) or ("",) * n
        # The class is frozen; nobody has seen the object yet.
        object.__setattr__(self, "roles", roles)
        if n == 0:
            return
        if len(roles) != n:
            raise TermselError(f"{len(roles)} roles for {n} points",
                               hint="Give each a role, or '' for none, in the order of ids.")
        for name, role in zip(self.ids, roles, strict=True):
            if role and role not in ROLES:
                raise TermselError(f"point {name!r} has the unknown role {role!r}",
                                   hint=f"Roles are {', '.join(ROLES)}, or blank.", ids=[name])
        # This check comes last, as it takes ids and shapes for granted. A point that takes no part
        # contradicts no other.
        in_use = [role != "off" for role in self.roles]
        refuse_repeated_places(self.ground[in_use], select(self.ids, in_use))

    def _glance(self) -> tuple[str, Mapping[str, str]]:
        """Return a title and the rows, by their heads, by which points show themselves."""
        roles = Counter(role or "no role" for role in self.roles)
        return f"Points: {len(self)}", {
            "ids": ", ".join(self.ids[:5]) + (", ..." if len(self) > 5 else ""),
            "roles": ", ".join(f"{count} {role}" for role, count in roles.items())}

    def _columns(self) -> dict[str, object]:
        sigma = {} if self.sigma is None else {
            "sigma_line": self.sigma[:, 0], "sigma_sample": self.sigma[:, 1]}
        x, y, z = self.ground.T
        return {"id": self.ids, "role": self.roles, "line": self.image[:, 0],
                "sample": self.image[:, 1], "x": x, "y": y, "z": z, **sigma, **self.attributes}


@lacks_said("termsel.read(lines=TABLE).lines makes it of a table or a file.")
@changes_said("dataclasses.replace(lines, {name}=VALUE) makes others.")
@dataclass(frozen=True, eq=False, repr=False)
class Lines(Tabular):
    """Conjugate straight lines, whose end points are not conjugate.

    Lines with one id are pieces of one feature, such as a polyline: they are selected and held
    out together.

    Parameters
    ----------
    ids : sequence of str, length n
        Name of the feature each line is, or is a piece of.
    image : array_like, shape (n, 2, 2)
        Two measured image points per line, each as line and sample [px].
    ground : array_like, shape (n, 2, 3)
        Two ground vertices per line, X, Y, Z; NaN for heights that are not known.
    sigma : array_like, shape (n,), optional
        Standard deviation of the measured image points across the line [px].
    attributes : mapping, optional
        Further columns of the file by name, n values each; as of `Points`.

    Raises
    ------
    TermselError
        For shapes that do not fit, values that are not finite, lines of zero length, or two
        lines with the same ground vertices.

    Examples
    --------
    >>> import numpy as np
    >>> import termsel
    >>> lines = termsel.Lines(("L1",), np.array([[[10.0, 20.0], [10.0, 90.0]]]),
    ...                       np.array([[[5e5, 4e6, 120.0], [5.01e5, 4e6, 120.0]]]))
    >>> lines.ids
    ('L1',)
    """

    ids: tuple[str, ...]
    image: FloatArray
    ground: FloatArray
    sigma: FloatArray | None = None
    attributes: Attributes = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the lines; raises TermselError as the class says."""
        self._check("line", (2,), "sigma")
        if not self.ids:
            return
        for values, in_words in ((self.image, "in the image"),
                                 (self.ground[..., :2], "on the ground")):
            # A line of zero length has no direction, so that it gives no equation.
            has_no_length = (values[:, 0] == values[:, 1]).all(axis=1)
            if has_no_length.any():
                name = self.ids[int(np.argmax(has_no_length))]
                raise TermselError(f"line {name!r} has zero length {in_words}",
                                   hint="A control line needs two different points.", ids=[name])
        refuse_repeated_lines(self.ground, self.ids)

    def _glance(self) -> tuple[str, Mapping[str, str]]:
        """Return a title and the rows, by their heads, by which lines show themselves."""
        return f"Lines: {len(self)}", {
            "ids": ", ".join(self.features[:5]) + (", ..." if len(self.features) > 5 else "")}

    def _columns(self) -> dict[str, object]:
        (l1, s1), (l2, s2) = self.image.transpose(1, 2, 0)
        (x1, y1, z1), (x2, y2, z2) = self.ground.transpose(1, 2, 0)
        # One number of a line: only the distance across it is measured.
        sigma = {} if self.sigma is None else {"sigma": self.sigma}
        return {"id": self.ids, "line1": l1, "sample1": s1, "line2": l2, "sample2": s2, "x1": x1,
                "y1": y1, "z1": z1, "x2": x2, "y2": y2, "z2": z2, **sigma, **self.attributes}

    @cached_property
    def features(self) -> tuple[str, ...]:
        """Names of the features, each once, in the order of their first lines."""
        return tuple(dict.fromkeys(self.ids))

    @cached_property
    def feature(self) -> IntArray:
        """The feature each line is a piece of, counted from 0; shape (n,)."""
        # Numbers in the order of first appearance, the same as in `features`.
        number = {name: i for i, name in enumerate(self.features)}
        return np.array([number[name] for name in self.ids], dtype=np.intp)

    def by_feature(self, values: FloatArray) -> FloatArray:
        """Return the mean of values over the pieces of each feature.

        Parameters
        ----------
        values : ndarray, shape (n, ...)
            A number, or an array, for each piece of a line.

        Returns
        -------
        ndarray, shape (len(features), ...)
            The means, in the order of `features`.
        """
        total = np.zeros((len(self.features), *values.shape[1:]))
        np.add.at(total, self.feature, values)
        # The count has an axis of length 1 for each further axis of the values.
        count = np.bincount(self.feature, minlength=len(total))
        return np.asarray(total / count.reshape(-1, *[1] * (values.ndim - 1)))


_POINTS = Points((), np.empty((0, 2)), np.empty((0, 3)))
_LINES = Lines((), np.empty((0, 2, 2)), np.empty((0, 2, 3)))


def empty_points() -> Points:
    """Return an empty set of points."""
    return _POINTS


def empty_lines() -> Lines:
    """Return an empty set of lines."""
    return _LINES


@changes_said("dataclasses.replace(features, {name}=VALUE) makes others, and transforms nothing.")
@dataclass(frozen=True, eq=False, repr=False)
class FeatureSet(Glance):
    """Points and lines of one image.

    Parameters
    ----------
    points : Points
        Points with image and ground coordinates, and their roles.
    lines : Lines
        Lines with two image points and two ground vertices each.
    crs : str
        Coordinate reference system of the ground coordinates, such as "EPSG:4979", or
        "local" for plane coordinates without one.
    image_size : tuple of int, optional
        Lines and samples of the image [px].
    noise : float, optional
        Standard deviation of the image measurements [px], if it is known, as for
        simulated data.
    heights : str
        Source and vertical datum of the heights, if a raster gave them.
    fit_crs : str, optional
        CRS of the fit, if it differs from `crs`.
    rpc : Rpc, optional
        The vendor's RPC of the image.
    dem_difference : DemDifference, optional
        How far a raster of heights is above those of control, where both are there.
    z_unit : str
        Unit of z and what shows it, where that was open.
    image_origin : str
        Where the file counted lines and samples from, where that is not the centre of the
        upper-left pixel by the format; they count from there here.
    image_file : ImageFile, optional
        What the file of the image is recognised by.
    named_units : mapping
        Units that names of columns state of x, y and z: "km", "ft", "us-ft", "gon" or "rad". Here
        kilometres are metres, gons and radians degrees.
    x_start : float, optional
        Longitude, or x, at which a map of more than half of the world begins: all places on it are
        within a full turn from there.

    Raises
    ------
    TermselError
        If a point and a line have the same id.

    Examples
    --------
    >>> import termsel
    >>> scene = termsel.simulate_scene("ikonos-hamedan")
    >>> len(scene.points), len(scene.lines), scene.crs
    (74, 120, 'EPSG:4979')
    """

    elsewhere: ClassVar[Mapping[str, str]] = {
        **{name: text.replace("points.", "features.points.", 1)
           for name, text in _OF_POINTS.items()},
        "gcps": "Points are features.points.", "control": "Points are features.points.",
        "image": "Image positions are features.points.image, lines and samples.",
        "ground": "Ground positions are features.points.ground, x, y and z.",
        "roles": "The roles of points are features.points.roles.",
        "to_pandas": "Points are a table: features.points.to_pandas()."}

    points: Points = field(default_factory=empty_points)
    lines: Lines = field(default_factory=empty_lines)
    crs: str = "local"
    image_size: tuple[int, int] | None = None
    noise: float | None = None
    heights: str = ""
    fit_crs: str = ""
    rpc: Rpc | None = None
    dem_difference: DemDifference | None = None
    z_unit: str = ""
    image_origin: str = ""
    image_file: ImageFile | None = None
    named_units: Mapping[str, str] = field(default_factory=dict)
    x_start: float | None = None

    def __post_init__(self) -> None:
        """Store the CRS as text, and refuse a point and a line with the same id.

        Raises TermselError for these, and for what is no CRS.
        """
        for name, kind in (("points", Points), ("lines", Lines)):
            value = getattr(self, name)
            if not isinstance(value, kind):
                raise TermselError(f"{name} is {shown_value(value)}, expected a "
                                   f"termsel.{kind.__name__}",
                                   hint="termsel.read(TABLE, crs='EPSG:4979') makes features of a "
                                        "table; FeatureSet(points, crs='EPSG:4979') of points.")
        # The class is frozen; nobody has seen the object yet.
        object.__setattr__(self, "crs", crs_text(self.crs))
        # Selections, results and messages name a feature by its id alone.
        shared_ids = set(self.points.ids) & set(self.lines.ids)
        if shared_ids:
            name = min(shared_ids)
            raise TermselError(f"{name!r} is the id of a point and of a line",
                               hint="Give one of them another id.", ids=[name])

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of all features, points first."""
        return self.points.ids + self.lines.features

    def __len__(self) -> int:
        return len(self.points) + len(self.lines.features)

    def _glance(self) -> tuple[str, Mapping[str, str]]:
        """Return a title and the rows, by their heads, by which features show themselves."""
        roles = Counter(role or "no role" for role in self.points.roles)
        size = self.image_size
        return (f"FeatureSet: {count_in_words(len(self.points), 'point')}, "
                f"{count_in_words(len(self.lines.features), 'line')}"), {
            "CRS": self.crs,
            "image": "size not known" if size is None else f"{size[0]} lines, {size[1]} samples",
            "roles of points": ", ".join(f"{n} {role}" for role, n in roles.items()) or "-",
            **({"RPC": self.rpc.source or "given"} if self.rpc is not None else {})}

    @property
    def word(self) -> str:
        """The word that messages use: "points", "lines", or "features" if there are both."""
        if not len(self.lines):
            return "points"
        return "features" if len(self.points) else "lines"

    @property
    def feature(self) -> IntArray:
        """The feature of each point, then of each line, (n + m,); counted from 0, points first."""
        n = len(self.points)
        if not len(self.lines):
            return np.arange(n)
        # A point is a feature of its own; lines go on counting after the points.
        return np.concatenate([np.arange(n), n + self.lines.feature])

    @property
    def vertex_feature(self) -> IntArray:
        """The feature of each point, then of each vertex of the lines, (n + 2 m,)."""
        n = len(self.points)
        return np.concatenate([np.arange(n), n + np.repeat(self.lines.feature, 2)])

    def with_(self, *, points: Points | None = None, lines: Lines | None = None) -> FeatureSet:
        """Return a copy with other points or lines."""
        return replace(self, points=self.points if points is None else points,
                       lines=self.lines if lines is None else lines)

    def take(self, mask: BoolArray) -> FeatureSet:
        """Return the features that a mask (n_features,) is True for, lines with all their pieces.

        The mask is in the order of `ids`: points, then lines.

        Raises TermselError for what is no such mask.
        """
        mask = np.asarray(mask)
        if mask.dtype != np.bool_ or mask.shape != (len(self),):
            raise TermselError(f"{len(self)} features need a mask of shape ({len(self)},), not an "
                               f"array of {mask.dtype} of shape {mask.shape}",
                               hint="Of ids: features.take([name in IDS for name in "
                                    "features.ids]); of rows: features.points.take(ROWS).")
        n = len(self.points)
        points = self.points.take(mask[:n])
        lines = self.lines
        if len(lines):
            lines = lines.take(mask[n:][lines.feature])
        return replace_unchecked(self, points=points, lines=lines)

    @explains_arguments()
    def texts(self, name: str) -> TextArray:
        """Return a column of attributes of all features.

        Parameters
        ----------
        name : str
            The name in the header of the file, such as "source". Upper and lower case count as the
            same.

        Returns
        -------
        ndarray of str, shape (n_features,)
            The texts in the order of `ids`; "" for a feature without one.

        Raises
        ------
        TermselError
            If neither points nor lines have the column.
        """
        # All pieces of a line have its attributes, so the first one's are enough.
        _, first = np.unique(self.lines.feature, return_index=True)
        tables = (self.points.attributes, rows_at(self.lines.attributes, first))
        return stack_columns(tables, (len(self.points), len(first)), name)

    @explains_arguments()
    def numbers(self, name: str) -> FloatArray:
        """Return a column of attributes of all features as numbers.

        Parameters
        ----------
        name : str
            The name in the header of the file, such as "sigma". Upper and lower case count as the
            same.

        Returns
        -------
        ndarray, shape (n_features,)
            The numbers in the order of `ids`; NaN for a feature without one.

        Raises
        ------
        TermselError
            If neither points nor lines have the column, or a cell is no finite number.
        """
        return as_numbers(self.texts(name), self.ids, name)

    def without_height(self) -> tuple[str, ...]:
        """Return the ids of features with an unknown height."""
        is_point_without = np.isnan(self.points.ground[:, 2])
        # A line is without height if one of its vertices is.
        is_piece_without: BoolArray = np.any(np.isnan(self.lines.ground[..., 2]), axis=1)
        if not is_point_without.any() and not is_piece_without.any():
            return ()
        return select(self.points.ids, is_point_without) + tuple(
            dict.fromkeys(select(self.lines.ids, is_piece_without)))

    def ground_vertices(self) -> FloatArray:
        """Return ground points and line vertices together, shape (n_points + 2 n, 3) of n lines."""
        return np.concatenate([self.points.ground, self.lines.ground.reshape(-1, 3)])

    def image_vertices(self) -> FloatArray:
        """Return image points and line ends together, shape (n_points + 2 n, 2) of n lines."""
        return np.concatenate([self.points.image, self.lines.image.reshape(-1, 2)])


def select(names: Sequence[str], mask: Iterable[bool]) -> tuple[str, ...]:
    """Return the names whose mask is set."""
    return tuple(name for name, on in zip(names, mask, strict=True) if on)
