"""What is left at every feature once a model is fitted, and its root mean square."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field, fields
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from termsel.data.coordinates.crs import LOCAL
from termsel.data.features import FeatureSet, FloatArray, Points, select
from termsel.data.record.figures import Rmse
from termsel.data.tables.tabular import Framed


@dataclass(frozen=True)
class Residual:
    """What is left at one point, or at one ground vertex of a control line.

    Its kind is "point", or "vertex 1" and "vertex 2" of a line and of its further pieces from 3 on.
    Line and sample are measured minus computed [px], for a vertex from its projection to the image
    line; the distance is the length of that vector. Ground coordinates have NaN for a height that
    is not known. The blunder is "certain", "probable" or "possible" where the feature is one.
    """

    id: str
    kind: str
    role: str
    used: bool
    line: float
    sample: float
    x: float
    y: float
    z: float
    distance: float = field(init=False)
    blunder: str = ""

    def __post_init__(self) -> None:
        # The class is frozen; nobody has seen the object yet.
        object.__setattr__(self, "distance", float(np.hypot(self.line, self.sample)))


class Residuals(tuple[Residual, ...], Framed):
    """Residuals as a table.

    `to_pandas` gives a row for each, `to_geopandas` also its point on the ground.

    Parameters
    ----------
    rows : iterable of Residual
        A residual of each feature.
    crs : str
        Of the ground coordinates.
    """

    crs: str

    def __new__(cls, rows: Iterable[Residual] = (), crs: str = LOCAL) -> Self:
        """Return the residuals as a table."""
        table = super().__new__(cls, rows)
        table.crs = crs
        return table

    # For programs alone: a checker of types knows that a tuple has no names.
    if not TYPE_CHECKING:
        def __getitem__(self, index: object) -> object:
            """Return a residual, or several; raise TypeError for an id or a name of a column."""
            if isinstance(index, str):
                raise TypeError(f"Residuals has no [{index!r}]: it is a list. As a table: "
                                "residuals.to_pandas().set_index('id').")
            return super().__getitem__(index)

    def to_geopandas(self, crs: str | None = None) -> Any:
        """Return a geopandas GeoDataFrame with the place of each, in the CRS of the control."""
        return super().to_geopandas(self.crs if crs is None else crs)

    def __repr__(self) -> str:
        worst = max((r.distance for r in self), default=0.0)
        return f"<Residuals: {len(self)}, largest {worst:.3g} px>"

    @property
    def ground(self) -> FloatArray:
        """Ground coordinates of each, shape (n, 3)."""
        return np.array([(r.x, r.y, r.z) for r in self]).reshape(-1, 3)

    def _places(self) -> FloatArray:
        return self.ground

    def _columns(self) -> dict[str, list[Any]]:
        """Return the fields of all residuals as columns, by name."""
        columns: dict[str, list[Any]] = {}
        for member in fields(Residual):
            columns[member.name] = [getattr(residual, member.name) for residual in self]
        return columns

    @property
    def __geo_interface__(self) -> dict[str, Any]:
        """The residuals as a GeoJSON feature collection, in the CRS of the ground coordinates."""
        features = []
        for i, residual in enumerate(self):
            coordinates = [residual.x, residual.y]
            if not np.isnan(residual.z):  # GeoJSON has no NaN: an unknown height is left out
                coordinates.append(residual.z)
            features.append({"type": "Feature", "id": i, "properties": asdict(residual),
                             "geometry": {"type": "Point", "coordinates": coordinates}})
        return {"type": "FeatureCollection", "features": features}


def control_residuals(control: FeatureSet, used: Iterable[bool], errors: FloatArray,
                      line_errors: FloatArray) -> Residuals:
    """Return the errors [px] of control features as a table, points before lines.

    `errors` (n, 2) are those of points, `line_errors` (n_lines, 2, 2) those of both ground vertices
    of the lines. `used` says of each feature whether it is in use.
    """
    return Residuals(_control_rows(control, tuple(bool(on) for on in used), errors, line_errors),
                     control.crs)


def point_residuals(points: Points, errors: FloatArray, role: str,
                    used: Iterable[bool]) -> Residuals:
    """Return the errors of points [px], shape (n, 2), that all have one role, as a table."""
    return Residuals(_residual_rows(points.ids, errors, points.ground, role, used))


def _control_rows(control: FeatureSet, used: tuple[bool, ...], errors: FloatArray,
                  line_errors: FloatArray) -> Iterator[Residual]:
    """Yield the residuals of points, then of the vertices of lines, piece by piece.

    `errors` (n, 2) are of points and `line_errors` (m, 2, 2) of both vertices of lines [px]; `used`
    is of all features. The vertices of a line in several pieces are numbered through, as a reader
    counts them.
    """
    points = control.points
    lines = control.lines
    yield from _residual_rows(points.ids, errors, points.ground, "control", used[:len(points)])
    # First all first pieces of lines, then all second ones: a line of two pieces has 4 vertices.
    # Pieces of a line follow in any order, between those of others.
    count_by_id: Counter[str] = Counter()
    piece_numbers = np.empty(len(lines), dtype=np.intp)
    for i, name in enumerate(lines.ids):
        piece_numbers[i] = count_by_id[name]
        count_by_id[name] += 1
    for number in range(piece_numbers.max(initial=-1) + 1):
        has_number = piece_numbers == number
        # Features are numbered points first, then lines.
        used_lines = tuple(used[feature] for feature in len(points) + lines.feature[has_number])
        for vertex in (0, 1):
            yield from _residual_rows(select(lines.ids, has_number),
                                      line_errors[has_number, vertex],
                                      lines.ground[has_number, vertex], "control", used_lines,
                                      f"vertex {2 * number + vertex + 1}")


def _residual_rows(ids: tuple[str, ...], errors: FloatArray, ground: FloatArray, role: str,
                   used: Iterable[bool], kind: str = "point") -> Iterator[Residual]:
    """Yield the residuals of features of one role, in their order."""
    for name, on, error, position in zip(ids, used, errors.tolist(), ground.tolist(), strict=True):
        yield Residual(name, kind, role, on, *error, *position)


def rmse_of(errors: FloatArray, n: int) -> Rmse | None:
    """Return the RMSE of errors, shape (..., 2), of n features; None if n is 0."""
    if not n:
        return None
    with np.errstate(over="ignore"):  # beyond all numbers is infinite
        line, sample = np.sqrt((errors**2).mean(axis=0)).tolist()
    # The mean square of distances is the sum of those of the axes.
    return Rmse(line, sample, float(np.hypot(line, sample)), n, freedom_of(errors))


def freedom_of(errors: FloatArray) -> float | None:
    """Return the degrees of freedom of the sum of squared errors, shape (..., 2).

    The chi-squared distribution with so many degrees has the same relative variance as the sum
    (Satterthwaite 1946). That is the variance which normal errors have with the mean squares of
    line and of sample; or, if larger, the one which the squared distances show, as under heavy
    tails. Returns None if all errors are zero.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        squares = (errors**2).reshape(-1, 2)
        squares = squares / squares.mean(axis=0).sum()  # lest squares of squares overflow
        squared_distances = squares.sum(axis=1)
        count = len(squared_distances)
        # Satterthwaite: 2 mean^2 / variance of the squared distances, times their number; the mean
        # is 1 here. Both variances are divided by 2.
        if_normal = float((squares.mean(axis=0)**2).sum())
        observed = float(squared_distances.var(ddof=1)) / 2 if count > 1 else 0.0
        freedom = count / max(if_normal, observed)
    return float(freedom) if np.isfinite(freedom) else None
