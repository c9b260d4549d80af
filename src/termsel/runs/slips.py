"""Outliers that are slips of the pen: the value that would make the point fit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress

import numpy as np

from termsel.core.errors import TermselError, rounded_size_text
from termsel.data.features import FeatureSet, FloatArray
from termsel.data.record.cautions import SLIP
from termsel.data.record.figures import Outlier
from termsel.data.slips import VALUES_OF_POINT, Slip, slips_of_row
from termsel.fitting.fit import Fit

_FITS = 3.0
"""Errors up to this many RMSE are those of points that fit."""

_CHANCE_OF_ONE = 0.1
"""Largest chance that a slip fits an error along one axis that has another cause."""

_NAMED = 3
"""Slips that are named."""


def notes_on_slips(read: FeatureSet, outliers: Sequence[Outlier], fitted: Fit,
                   rmse: float) -> Iterator[str]:
    """Yield which outliers would fit without one slip of the pen, with the value to correct.

    Parameters
    ----------
    read : FeatureSet
        The features as read.
    outliers : sequence of Outlier
        Those of the run, the worst first.
    fitted : Fit
        A model that was fitted without them.
    rmse : float
        Of points that fit [px].

    Yields
    ------
    str
        A sentence for each point of which exactly one value explains the error.
    """
    points = read.points
    rows = {name: row for row, name in enumerate(points.ids)}
    named = 0
    for outlier in outliers:
        if outlier.kind != "point" or outlier.id not in rows or named == _NAMED:
            continue
        index = rows[outlier.id]
        row = np.concatenate([points.image[index], points.ground[index]])
        slip, error = _slip_that_fits(row, outlier, fitted, rmse)
        # A height of a raster was not typed.
        if slip is not None and not (read.heights and "z" in slip.columns):
            named += 1
            yield (f"{outlier.id}{SLIP}{rounded_size_text(error)} px with "
                   f"{_values_in_words(read, row, slip)}: {slip.reason}? Compare it with its "
                   "source, and correct it in the file.")


def _slip_that_fits(row: FloatArray, outlier: Outlier, fitted: Fit,
                    rmse: float) -> tuple[Slip | None, float]:
    """Return the only slip without which a row (5,) fits, and its error then [px]; or None.

    An error e of any size from e / 2 to 2 e along one axis lies within t of one of n slips, which
    move the row as far, with a chance of about n t / e. Where that is large, none is named.
    """
    slips = [*slips_of_row(row)]
    corrected = np.array([slip.row for slip in slips])
    # A plane model says nothing of heights, and no height explains its errors.
    projected = _positions_where_possible(fitted, np.vstack([row[None, 2:], corrected[:, 2:]]))
    off = projected - np.vstack([row[None, :2], corrected[:, :2]])
    errors = np.abs(off[1:]).max(axis=1)
    moved = np.abs(off[1:] - off[0]).max(axis=1)
    limit = _FITS * rmse
    comparable = np.count_nonzero((moved >= outlier.error / 2.0) & (moved <= 2.0 * outlier.error))
    if comparable * limit > _CHANCE_OF_ONE * outlier.error:
        return None, np.inf
    fitting = np.flatnonzero(np.isfinite(errors) & (errors <= limit))
    if not len(fitting) or len({slips[i].columns for i in fitting}) > 1:
        return None, np.inf
    best = int(fitting[np.argmin(errors[fitting])])
    return slips[best], float(errors[best])


def _positions_where_possible(fitted: Fit, ground: FloatArray) -> FloatArray:
    """Return the positions (n, 2) [px] of places (n, 3), NaN of those that the model refuses.

    A camera refuses what lies outside the CRS, as ten times an easting may.
    """
    with suppress(TermselError):
        return fitted.project(ground)
    # One of them is refused with all others.
    positions = np.full((len(ground), 2), np.nan)
    for i, place in enumerate(ground):
        with suppress(TermselError):
            positions[i] = fitted.project(place[None])[0]
    return positions


def _values_in_words(read: FeatureSet, row: FloatArray, slip: Slip) -> str:
    """Return the columns of a slip, and the values that would fit where they are as in the file.

    Lines and samples may count from elsewhere in the file, and other units may be stated there.
    """
    is_as_typed = not (read.named_units or (read.z_unit and "z" in slip.columns))
    if not is_as_typed or "line" in slip.columns or "sample" in slip.columns:
        return f"another {' and '.join(slip.columns)}"
    return " and ".join(
        f"{name} = {fits:.12g} in place of {typed:.12g}"
        for name, fits, typed in zip(VALUES_OF_POINT, slip.row, row, strict=True)
        if name in slip.columns)
