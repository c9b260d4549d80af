"""Tables of points, projected by a fitted model in either direction."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from termsel.errors import TermselError
from termsel.formats.heights import surface_of
from termsel.formats.readers.csv_tables import COORDINATES, table_text
from termsel.formats.readers.tables import Table, read_table
from termsel.measurements.crs import normalise

if TYPE_CHECKING:
    from termsel.results.result import Result

_ID = {"id": ("id", "name")}


def project_table(
    result: Result,
    path: Path,
    *,
    inverse: bool = False,
    dem: Path | None = None,
    height: float | None = None,
) -> tuple[str, tuple[str, ...]]:
    """Return a table of points with image and ground coordinates.

    Parameters
    ----------
    result : Result
    path : pathlib.Path
        Table of x, y and, for models with height, z; with `inverse` of line and sample.
    inverse : bool
        From the image to the ground.
    dem : pathlib.Path, optional
        With `inverse`: raster of heights.
    height : float, optional
        With `inverse`: height of the ground. Models without height need neither.

    Returns
    -------
    text : str
        CSV headed id,line,sample,x,y,z,uncertainty_line,uncertainty_sample. The last two are
        the standard deviations of what the model predicts there (see `termsel.Fit.sigma`).
    missed : tuple of str
        Ids of points without a place.

    Raises
    ------
    TermselError
        Naming file, line and column, for tables that cannot be read; for a CRS other than that
        of the control; for heights that are missing.
    """
    model, crs = result.fit.model, result.fit.control.crs
    if inverse:
        table = _table(path, "line", "sample")
        image = table.stack("line", "sample")
        if dem is not None and height is not None:
            raise TermselError("--dem and --height exclude each other", hint="Give one of them.")
        if height is not None and not np.isfinite(height):
            raise TermselError(f"the height of the ground cannot be {height}",
                               hint="Give a finite number.")
        if dem is None and height is None and model.uses_height:
            raise TermselError("the ground position depends on the height",
                               hint="Give --dem FILE or --height H.")
        with surface_of(dem, crs, 0.0 if height is None else height) as surface:
            ground = result.locate(image, surface)
        if dem is None and height is None:
            ground[:, 2] = np.nan
    else:
        if dem is not None or height is not None:
            raise TermselError("--dem and --height require --inverse",
                               hint="Add --inverse, or remove them.")
        names = ("x", "y", "z") if model.uses_height else ("x", "y")
        table = _table(path, *names)
        if table.crs and table.crs != normalise(crs):
            raise TermselError(f"the file declares the CRS {table.crs}, but the control is in "
                               f"{crs}",
                               file=path, hint="Transform the points to the CRS of the control.")
        ground = np.full((len(table.lines), 3), np.nan)
        ground[:, :len(names)] = table.stack(*names)
        blank = np.flatnonzero(np.isnan(ground[:, len(names) - 1]))
        if blank.size:
            raise table.error("the height is blank, but the model requires it", int(blank[0]), "z")
        with np.errstate(all="ignore"):
            image = result.project(ground)
        image[~np.isfinite(image)] = np.nan
    with np.errstate(all="ignore"):
        sigma = result.sigma(ground)
    sigma[~np.isfinite(sigma)] = np.nan
    values = np.concatenate([image, ground, sigma], axis=1)
    # Heights may be unknown; line, sample, x and y of what was found are not.
    missed = np.isnan(values[:, :4]).any(axis=1)
    ids = table.ids()
    header = ["id", "line", "sample", "x", "y", "z", "uncertainty_line",
              "uncertainty_sample"]
    text = table_text(crs, header, [[name] for name in ids], values)
    return text, tuple(name for name, gone in zip(ids, missed, strict=True) if gone)


def _table(path: Path, *meanings: str) -> Table:
    if not path.is_file():
        raise TermselError("this file does not exist", file=path)
    return read_table(path, _ID | {meaning: COORDINATES[meaning] for meaning in meanings})
