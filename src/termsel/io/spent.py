"""Independent points that are spent: an earlier result showed their errors under another fit."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from termsel.errors import TermselError, counted, first_of
from termsel.formats.base import parse_json, read_text
from termsel.formats.readers.csv_tables import PointsCsv
from termsel.io.result_folder import POINTS, RECORD
from termsel.io.result_of_record import AGAIN, record_from
from termsel.measurements.features import Points
from termsel.record.base import plain
from termsel.record.record import Record
from termsel.results.result import Result


def with_spent(result: Result, folder: Path) -> Result:
    """Return a result that says which earlier results showed its independent points.

    These are the result in the folder, which is about to be replaced, and those in the folders
    next to it. A result with the same fit spends nothing. A result that was never written leaves
    no trace.
    """
    if result.accuracy is None:
        return result
    mine, this = _independent(result.features.points), _fit_of(result.record)
    shared, names = set[tuple[Any, ...]](), set[str]()
    for file in sorted(folder.resolve().parent.glob(f"*/{RECORD}")):
        with suppress(TermselError):  # another program's, or damaged
            record = record_from(parse_json(read_text(file), AGAIN))
            # What an earlier result knew of its points holds for these, even if that one is gone.
            known = {*((record.accuracy and record.accuracy.spent_by) or ()),
                     *[file.parent.name] * (_fit_of(record) != this)}
            if known and (both := mine & _independent(
                    PointsCsv().read(file.with_name(POINTS)).points)):
                shared |= both
                names |= known
    if not names:
        return result
    named, one = tuple(sorted(names)), len(shared) == 1
    note = (f"{counted(len(shared), 'independent point')} {'is' if one else 'are'} spent: "
            f"{first_of(named)} showed {'its error' if one else 'their errors'} under another "
            "fit. A fit that is chosen by them looks better than it is. Compare fits by check "
            "points or by the predicted RMSE, or measure new independent points.")
    return replace(result, notes=(*result.notes, note), accuracy=msgspec.structs.replace(
        result.accuracy, spent_by=named))


def _independent(points: Points) -> set[tuple[Any, ...]]:
    """Return the independent points by id and coordinates, whatever else is known of them."""
    ground = np.nan_to_num(points.ground)
    return {(name, *image, *place) for name, role, image, place in zip(
        points.ids, points.roles, points.image.tolist(), ground.tolist(), strict=True)
        if role == "independent"}


def _fit_of(record: Record) -> tuple[Any, ...]:
    """Return what tells a fit from another one over the same points."""
    return (record.model, plain(record.selection), record.fit.estimator, record.fit.options,
            sorted(record.coefficients))
