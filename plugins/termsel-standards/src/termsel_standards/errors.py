"""Errors of check points on the ground: of a result, or from a table."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isclose
from pathlib import Path
from typing import Any

import numpy as np

from termsel import Points, Result, TermselError
from termsel.toolkit import FloatArray, count_in_words, read_text
from termsel.toolkit.coordinates import offsets_in_metres
from termsel.toolkit.models import OnGround, distance_figures

AXES = ("x", "y", "z")
SIGMAS = tuple(f"sigma_{axis}" for axis in AXES)
"""Columns with the standard deviations of the check points' survey [m]."""


@dataclass(frozen=True, eq=False)
class GroundErrors:
    """Errors of points that took no part in any choice.

    Parameters
    ----------
    ids : tuple of str
    errors : array_like, shape (n, 2) or (n, 3)
        Computed minus surveyed position, to east, to north and up [m].
    survey : array_like, shape (n, 2) or (n, 3)
        Standard deviations of the survey [m]; NaN where they are not known.
    positions : array_like, shape (n, 2)
        Where the points are, to east and to north of any origin [m]; NaN where that is not known.
    area : array_like, shape (k, 2), optional
        Corners of what the points stand for, with the same origin [m]. By default the rectangle
        around the points.
    source : str
        Where the errors are from.
    blunders : tuple of str
        Those that all other features contradict.
    """

    ids: tuple[str, ...]
    errors: FloatArray
    survey: FloatArray
    positions: FloatArray
    area: FloatArray | None = None
    source: str = ""
    blunders: tuple[str, ...] = ()

    def surveyed(self, horizontal: float | None, vertical: float | None = None) -> GroundErrors:
        """Return the errors with a standard deviation of the survey where none is known.

        Parameters
        ----------
        horizontal, vertical : float, optional
            Standard deviation of each horizontal coordinate, and of the height [m].
        """
        stated = [np.nan if sigma is None else sigma
                  for sigma in (horizontal, horizontal, vertical)]
        default = np.array(stated[:self.errors.shape[1]])
        return replace(self, survey=np.where(np.isnan(self.survey), default, self.survey))


def errors_of(result: Result) -> GroundErrors:
    """Return the errors on the ground of a result's independent points.

    Their positions are computed from the image at their surveyed heights, as a map has them, or at
    0 if the model uses no heights and they are not known.

    Parameters
    ----------
    result : Result
        Its features may have columns sigma_x, sigma_y [m], the standard deviations of the survey.

    Returns
    -------
    GroundErrors
        Computed minus surveyed positions, to east, to north and up [m].

    Raises
    ------
    TermselError
        If there are no independent points, if the fit has used them, if the model gives one of them
        no ground position, or if their errors are not known in metres.

    Examples
    --------
    >>> import termsel
    >>> from termsel_standards import errors_of
    >>> result = termsel.run("poly-terms", evaluations=200, options={"degree": 2})
    >>> ground_errors = errors_of(result)
    >>> len(ground_errors.ids), ground_errors.errors.std(axis=0).round(1)  # to east and north [m]
    (26, array([9.3, 3.1]))
    """
    points = result.features.points
    points = points.take([role == "independent" for role in points.roles])
    if not len(points):
        raise TermselError("the result has no independent points, so its accuracy is not known",
                           hint="Measure further points and give them the role independent.")
    fit = result.fit
    ground = points.ground
    # A plane model needs no heights: those of its points may be unknown.
    heights = ground[:, 2] if fit.model.uses_height else np.nan_to_num(ground[:, 2])
    offsets = (fit.locate(points.image, heights) - ground)[:, :2]
    crs = result.features.crs
    metres = offsets_in_metres(crs, ground, offsets)
    if metres is not None and not np.isfinite(metres).all():
        ids_without_ground = [name for name, offset in zip(points.ids, metres, strict=True)
                              if not np.isfinite(offset).all()]
        count = count_in_words(len(ids_without_ground), "independent point")
        raise TermselError(f"the model gives no ground position for {count}, such as "
                           f"{ids_without_ground[0]}",
                           ids=ids_without_ground,
                           hint="It is not valid there: choose another model, or measure more "
                                "control.")
    if metres is None:
        raise TermselError("the errors on the ground are not known in metres",
                           hint="State the CRS of the ground coordinates when you run termsel.")
    # An exported fit may use the independent points. Its errors then differ from those that the
    # run recorded; the tolerance is for rounding.
    recorded = result.accuracy.ground if result.accuracy else None
    if recorded and not isclose(
            recorded.total, distance_figures(OnGround, metres).total, rel_tol=1e-6):
        raise TermselError("the fit has used the independent points, so they do not test it",
                           hint="Give the result as it was run, not as it is exported.")
    origin = ground[0, :2]
    positions = offsets_in_metres(crs, ground, ground[:, :2] - origin)
    area = None
    if result.features.image_size is not None:
        # The corners of the image, at the mean height of the points.
        lines, samples = (float(extent) - 1.0 for extent in result.features.image_size)
        corners = np.array([[0.0, 0.0], [0.0, samples], [lines, samples], [lines, 0.0]])
        corner_ground = fit.locate(corners, np.full(4, float(np.nan_to_num(heights).mean())))
        area = offsets_in_metres(crs, corner_ground, corner_ground[:, :2] - origin)
        area = area if area is not None and np.isfinite(area).all() else None
    if positions is None:
        positions = np.full_like(metres, np.nan)
    blunders = tuple(outlier.id for outlier in result.outliers if outlier.role == "independent")
    return GroundErrors(points.ids, metres, _survey_of(points), positions, area,
                        source=result.data.source, blunders=blunders)


def _survey_of(points: Points) -> FloatArray:
    """Return the standard deviations of the survey [m] in x and y, shape (n, 2).

    They are NaN where a column is missing or a cell is blank. Raises TermselError for a cell that
    is negative or no number.
    """
    columns = [_parse_sigmas(points.attributes.get(name, [""] * len(points)), name, points.ids)
               for name in SIGMAS[:2]]
    return np.column_stack(columns)


def _parse_sigmas(cells: Iterable[Any], name: str, ids: Sequence[str], file: Path | None = None,
                  ) -> FloatArray:
    """Return the standard deviations [m] of the cells of a column, NaN for blank ones, shape (n,).

    `name` is that of the column, `file` the table, if there is one: the messages name them. Raises
    TermselError for a cell that is negative or no number.
    """
    # Line 1 of a table is its header.
    sigma = np.array([_parse_number(str(cell), name, file, line)
                      for line, cell in enumerate(cells, 2)])
    for value, point in zip(sigma.tolist(), ids, strict=True):
        if value < 0:
            raise TermselError(f"{name} of {point} is {value:g}", file=file,
                               hint="A standard deviation is a positive number of metres.")
    return sigma


def _parse_number(cell: str, name: str, file: Path | None, line: int) -> float:
    """Return the number in a cell, NaN for a blank one.

    Raises TermselError with column and line for another text, and for what is not finite.
    """
    if not cell.strip():
        return np.nan
    try:
        value = float(cell)
    except ValueError:
        value = np.inf
    if not np.isfinite(value):
        raise TermselError(f"{cell.strip()!r:.40} is not a number", file=file,
                           line=line if file else None, column=name,
                           hint="Give metres, with a decimal point.")
    return value


def _refuse_repeated_ids(ids: Sequence[str], path: Path) -> None:
    """Raise TermselError if an id is in a table twice: the point would count twice.

    `ids` are those of the rows, "" for a row without one.
    """
    lines: dict[str, int] = {}
    for line, name in enumerate(ids, 2):
        if name and name in lines:
            raise TermselError(f"the id {name!r} is that of line {lines[name]} as well", file=path,
                               line=line, column="id", hint="Remove the row that repeats a point, "
                               "or give each point an id of its own.")
        lines[name] = line


def _refuse_repeated_places(positions: FloatArray, ids: Sequence[str], path: Path) -> None:
    """Raise TermselError if two points of a table are at one place, which test the same thing.

    `positions` (n, 2) are x and y; rows where either is not known are no places.
    """
    lines: dict[tuple[float, ...], int] = {}
    for line, place in enumerate(map(tuple, positions.tolist()), 2):
        if np.isfinite(place).all() and place in lines:
            raise TermselError(
                f"{ids[lines[place] - 2]!r} of line {lines[place]} and {ids[line - 2]!r} are at "
                "the same x and y", file=path, line=line,
                hint="Remove one of them: measured twice, a point is one check point.")
        lines[place] = line


def read_errors(path: Path | str) -> GroundErrors:
    """Return the errors in a table.

    Parameters
    ----------
    path : path-like
        CSV headed id,dx,dy and, where they are known, dz, x, y, sigma_x, sigma_y, sigma_z, all in
        metres.

    Returns
    -------
    GroundErrors
        The errors dx and dy, and dz where the table has it [m].

    Raises
    ------
    TermselError
        If the file cannot be read, is empty, has no rows or no columns dx and dy, has a cell that
        is no number, a blank error or a negative standard deviation, or has an id or place twice.

    Examples
    --------
    >>> from pathlib import Path
    >>> from termsel_standards import read_errors
    >>> text = "id,dx,dy\\nA,0.4,-0.1\\nB,-0.2,0.3\\nC,0.1,0.2\\n"
    >>> size = Path("errors.csv").write_text(text)
    >>> read_errors("errors.csv").ids
    ('A', 'B', 'C')
    """
    path = Path(path)
    try:
        text = read_text(path).splitlines()
        rows = list(csv.DictReader(text, restval="", delimiter=_delimiter_of(text)))
    except csv.Error as error:
        raise TermselError(f"this table cannot be read: {error}", file=path,
                           hint="Save it again as CSV.") from None
    if not path.stat().st_size:
        raise TermselError("the file is empty", file=path,
                           hint="Give a table headed id,dx,dy, or the folder of a run.")
    if not rows or not {"dx", "dy"} <= set(rows[0]):
        names = [name for name in rows[0] if name and not name.startswith("#")] if rows else []
        header = f"The columns here are: {', '.join(names)}. " if names else ""
        if any(_OTHER_UNIT.search(name) for name in names):
            header += "Convert them to metres, and name them without the unit. "
        raise TermselError("this is no table of errors: it has no columns dx and dy", file=path,
                           hint=f"{header}dx and dy are computed minus surveyed positions [m]: "
                                "id,dx,dy or id,dx,dy,dz,x,y,sigma_x,sigma_y,sigma_z. For the "
                                "accuracy of a run give its folder: termsel accuracy DIR.")
    ids = tuple(row.get("id", "").strip() or str(i) for i, row in enumerate(rows, 1))
    _refuse_repeated_ids([row.get("id", "").strip() for row in rows], path)
    # A column dz without any number counts as missing.
    axes = AXES if any(row.get("dz", "").strip() for row in rows) else AXES[:2]
    errors = _parse_columns(path, rows, [f"d{axis}" for axis in axes])
    if np.isnan(errors).any():
        row, column = np.argwhere(np.isnan(errors))[0].tolist()
        raise TermselError("this cell is blank", file=path, line=row + 2,
                           column=f"d{axes[column]}",
                           hint="Give every point all its errors, or leave out its row.")
    survey = []
    for axis in axes:
        name = f"sigma_{axis}"
        survey.append(_parse_sigmas([row.get(name, "") for row in rows], name, ids, path))
    positions = _parse_columns(path, rows, ["x", "y"])
    _refuse_repeated_places(positions, ids, path)
    return GroundErrors(ids, errors, np.column_stack(survey), positions, source=str(path))


_OTHER_UNIT = re.compile(r"[\[(](mm|cm|dm|km|ft|us-ft)[\])]\s*$", re.IGNORECASE)
"""End of the name of a column whose unit is not the metre."""


def _delimiter_of(lines: Sequence[str]) -> str:
    """Return what separates the columns of a table: what its header has most of."""
    header = lines[0] if lines else ""
    return max(",;\t", key=header.count)


def _parse_columns(path: Path, rows: Sequence[Mapping[str, str]],
                   names: Sequence[str]) -> FloatArray:
    """Return the numbers in columns of a table, shape (rows, columns).

    They are NaN for blank cells and missing columns. Raises TermselError for a cell that is no
    number; `path` is the table that it names.
    """
    values = []
    for line, row in enumerate(rows, 2):
        values.append([_parse_number(row.get(name, ""), name, path, line) for name in names])
    return np.array(values)
