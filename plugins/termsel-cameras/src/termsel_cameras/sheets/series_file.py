"""The file of a series of sheets: its projection, and what each sheet shows of the paper."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from termsel import FeatureSet, TermselError
from termsel.toolkit import read_text
from termsel.toolkit.coordinates import normalise
from termsel_cameras.roles import without_independent
from termsel_cameras.sheets.paper import PAPER_NAMES, Paper, Sheet, marks_of, paper_of, sheet_of
from termsel_cameras.sheets.series import with_paper
from termsel_cameras.sheets.sound import blunders_in


@dataclass(frozen=True)
class Series:
    """A series of sheets.

    Parameters
    ----------
    projection : str
        In which all sheets were drawn; "" where points have no CRS.
    sheets : tuple of Sheet
        Those with points enough to show the paper.
    contradicted_by : str
        Name of a projection that the sheets find far more probable; "" where there is none.
    """

    projection: str
    sheets: tuple[Sheet, ...]
    contradicted_by: str = ""

    def text(self) -> str:
        """Return the content of the file."""
        return json.dumps({"projection": self.projection, "contradicted_by": self.contradicted_by,
                           "sheets": [asdict(sheet) for sheet in self.sheets]}, indent=1) + "\n"

    def paper_for(self, features: FeatureSet) -> Paper:
        """Return what the other sheets show of the paper of a sheet.

        A sheet that shares a point with `features` is taken to be the same one. Raises TermselError
        if there is no other.
        """
        marks = set(marks_of(features))
        return paper_of([sheet for sheet in self.sheets if marks.isdisjoint(sheet.points)])


def series_of(sheets: Sequence[FeatureSet], projection: str) -> Series:
    """Return the series of some sheets in their projection, or in their own CRS if that is "".

    Sheets that do not show their paper (see `sheet_of`) are left out; independent check points and
    blunders take no part.
    """
    without_blunders = [
        _without_blunders(without_independent(sheet), projection) for sheet in sheets]
    projected = [replace(sheet, fit_crs=projection) if projection else sheet
                 for sheet in without_blunders]
    described = [sheet_of(sheet) for sheet in projected]
    return Series(projection, tuple(sheet for sheet in described if sheet is not None))


def _without_blunders(sheet: FeatureSet, projection: str) -> FeatureSet:
    """Return a sheet without the points that are blunders in the projection of its series.

    It is returned as it is if it has too few points for a test.
    """
    is_blunder = blunders_in(sheet, projection)
    if is_blunder is None:
        return sheet
    return sheet.with_(points=sheet.points.take(~is_blunder))


def read_series(path: Path | str) -> Series:
    """Return the series of a file that `termsel map-series` wrote.

    Raises
    ------
    TermselError
        If it is none.
    """
    try:
        content = json.loads(read_text(Path(path)))
        sheets = tuple(_parse_sheet(item) for item in content["sheets"])
        projection = str(content["projection"])
        contradicted_by = str(content.get("contradicted_by", ""))
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise TermselError(
            f"{path} is no file of a series of sheets",
            hint="Write one: termsel map-series SHEETS... -o series.json.") from error
    return Series(normalise(projection) if projection else "", sheets, contradicted_by)


def _parse_sheet(item: Any) -> Sheet:
    """Return a sheet that an item of a JSON file describes.

    Raises ValueError, KeyError or TypeError if the item is no sheet.
    """
    values = tuple(float(value) for value in item["values"])
    variances = tuple(float(value) for value in item["variances"])
    noise = float(item["noise"])
    freedom = int(item["freedom"])
    numbers = np.array([*values, *variances, noise])
    if (len(values) != len(PAPER_NAMES) or len(variances) != len(PAPER_NAMES) or freedom < 1
            or not np.isfinite(numbers).all() or min(*variances, noise) <= 0.0):
        raise ValueError
    return Sheet(values, variances, noise, freedom, tuple(str(mark) for mark in item["points"]))


def with_series_columns(features: FeatureSet, series: Series) -> FeatureSet:
    """Return the points of a sheet with the projection and the paper that its series shows."""
    if series.projection:
        features = replace(features, fit_crs=series.projection)
    return with_paper(features, series.paper_for(features))
