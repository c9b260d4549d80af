"""Independent points that are spent: an earlier result showed their errors under another fit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from termsel.errors import TermselError, counted
from termsel.formats.readers.csv_tables import PointsCsv
from termsel.io.result_folder import POINTS, RECORD
from termsel.measurements.features import Points
from termsel.record.base import plain
from termsel.results.result import Result


def with_spent(result: Result, folder: Path) -> Result:
    """Return a result that says which earlier results showed its independent points.

    These are the result in the folder, which is about to be replaced, and those in the folders
    next to it. A result with the same fit spends nothing. A result that was never written leaves
    no trace.
    """
    if result.accuracy is None:
        return result
    mine, this = _independent(result.features.points), _fit_of(plain(result.record))
    shared, names = set[tuple[Any, ...]](), set[str]()
    for place, content in _results_near(folder):
        try:
            both = mine & _independent(PointsCsv().read(place / POINTS).points)
        except TermselError:  # not the points of a result, or none
            continue
        # What an earlier result knew of its points holds for these, even if that folder is gone.
        known = set((content.get("accuracy") or {}).get("spent_by", ()))
        known |= {place.name} if _fit_of(content) != this else set()
        if both and known:
            shared |= both
            names |= known
    if not names:
        return result
    named, one = tuple(sorted(names)), len(shared) == 1
    note = (f"{counted(len(shared), 'independent point')} {'is' if one else 'are'} spent: "
            f"{', '.join(named)} showed {'its error' if one else 'their errors'} under another "
            "fit. A fit that is chosen by them looks better than it is. Compare fits by check "
            "points or by the predicted RMSE, or measure new independent points.")
    return replace(result, notes=(*result.notes, note), accuracy=msgspec.structs.replace(
        result.accuracy, spent_by=named))


def _results_near(folder: Path) -> Iterator[tuple[Path, Mapping[str, Any]]]:
    """Yield the folders of results, this one and those next to it, with their records."""
    for file in sorted(folder.resolve().parent.glob(f"*/{RECORD}")):
        try:
            content = msgspec.json.decode(file.read_bytes())
        except (OSError, msgspec.DecodeError, RecursionError):  # another program's, or damaged
            continue
        if isinstance(content, dict) and str(content.get("schema", "")).startswith("termsel-"):
            yield file.parent, content


def _independent(points: Points) -> set[tuple[Any, ...]]:
    """Return the independent points by id and coordinates, whatever else is known of them."""
    ground = np.nan_to_num(points.ground)
    return {(name, *image, *place) for name, role, image, place in zip(
        points.ids, points.roles, points.image.tolist(), ground.tolist(), strict=True)
        if role == "independent"}


def _fit_of(content: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return what tells a fit from another one over the same points."""
    how = content.get("fit") or {}
    return (content.get("model"), content.get("selection"), how.get("estimator"),
            how.get("options"), sorted(content.get("coefficients", ())))
