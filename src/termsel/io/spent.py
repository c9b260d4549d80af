"""Independent points that are spent: an earlier result showed their errors under another fit."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import structs

from termsel.core.errors import TermselError, first_names_in_words
from termsel.core.files.names import RECORD
from termsel.data.features import Points
from termsel.data.record.figures import as_plain_data
from termsel.data.record.record import Record
from termsel.formats.base import parse_json, read_utf8
from termsel.formats.readers.csv_tables import PointsCsv
from termsel.io.result_folder import POINTS
from termsel.io.result_of_record import AGAIN, record_from
from termsel.results.result import Result


def with_spent(result: Result, folder: Path) -> Result:
    """Return a result that says which earlier results showed its independent points.

    These are the result in the folder, which is about to be replaced, and those in the folders
    next to it, which are usually of the same data. A result with the same fit spends no points; one
    that was never written leaves no trace. The result is returned as it is if it has no accuracy,
    or if none of its points were shown.
    """
    if result.accuracy is None:
        return result
    independent = _independent_points(result.features.points)
    this_fit = _fit_of(result)
    shown_points = set[str]()
    names = set[str]()
    for file in sorted(folder.resolve().parent.glob(f"*/{RECORD}")):
        # A file of this name may be another program's, or be damaged.
        with suppress(TermselError):
            record = record_from(parse_json(read_utf8(file), AGAIN))
            another_fit = _fit_of(record) != this_fit
            earlier = _spent_before(record)
            if not another_fit and not earlier:
                continue
            # By id and coordinates, as other points may have the same id.
            points = PointsCsv().read(file.with_name(POINTS)).points
            shared = independent & _independent_points(points)
            ids = {name for name, *_ in shared}
            # An earlier result names results before it, which may be gone by now.
            if before := ids & earlier.keys():
                shown_points |= before
                names.update(*(earlier[point] for point in before))
            if another_fit and ids:
                shown_points |= ids
                names.add(file.parent.name)
    if not shown_points:
        return result
    results_named = tuple(sorted(names))
    is_single = len(shown_points) == 1
    of_all = "" if len(shown_points) == len(independent) else f" of {len(independent)}"
    plural = "s" if len(independent) > 1 else ""
    note = (f"{len(shown_points)}{of_all} independent check point{plural} "
            f"{'is' if is_single else 'are'} no longer independent: "
            f"{'it' if is_single else 'they'} already assessed another fit, in "
            f"{first_names_in_words(results_named)}. A fit that is chosen by them looks better "
            "than it is. Compare fits by selection points or by the predicted RMSE, or measure new "
            "independent check points.")
    spent = tuple(name for name in result.features.points.ids if name in shown_points)
    accuracy = structs.replace(result.accuracy, spent_by=results_named, spent=spent)
    return result.with_(notes=(*result.notes, note), accuracy=accuracy)


def _spent_before(record: Record) -> dict[str, tuple[str, ...]]:
    """Return the independent points that were spent for an earlier result, with those that did it.
    """
    accuracy = record.accuracy
    if accuracy is None or not accuracy.spent or not accuracy.spent_by:
        return {}
    return dict.fromkeys(accuracy.spent, accuracy.spent_by)


def _independent_points(points: Points) -> set[tuple[Any, ...]]:
    """Return id, image and ground coordinates of the independent points, as a set."""
    ground = np.nan_to_num(points.ground)
    return {(name, *image, *position) for name, role, image, position in zip(
        points.ids, points.roles, points.image.tolist(), ground.tolist(), strict=True)
        if role == "independent"}


def _fit_of(record: Record) -> tuple[Any, ...]:
    """Return a key that distinguishes a fit from another one over the same points.

    The strategy auto selects no features, so that a point which was corrected, or left out, makes
    no other fit: nobody chose it by the independent points.
    """
    selection = record.selection
    if record.strategy is not None:
        selection = structs.replace(selection, features=(), n_features=0)
    return (record.model, as_plain_data(selection), record.estimation.estimator,
            record.estimation.options,
            sorted(record.coefficients))
