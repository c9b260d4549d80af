"""Which projection predicts the points of a map, or of a series of sheets, best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from termsel import FeatureSet, FitData, TermselError
from termsel.toolkit.models import Auto
from termsel_cameras.roles import without_independent
from termsel_cameras.sheets.candidates import Projection
from termsel_cameras.sheets.paper import Sheet, evidence_of, marks_of, sheet_of
from termsel_cameras.sheets.series import SHEET_OF_SERIES
from termsel_cameras.sheets.series_file import Series, with_series_columns
from termsel_cameras.sheets.sound import blunders_in

NEARLY_BEST = 1.1
"""RMSE by that of the best, up to which the first of several projections is taken: they predict
alike."""

MIN_SHEETS = 4
"""Sheets from which on their differences show what chance does."""

SIGNIFICANT_ERRORS = 2.0
"""Standard errors beyond which a difference over all sheets is not chance."""

NEGLIGIBLE = 0.005
"""Difference of two logarithms of RMSEs that matters to nobody."""

MIN_POINTS_OF_SHEET = 4
"""Points from which on a sheet distinguishes projections."""

AS_PROBABLE = 3.0
"""Difference of the logarithms of the evidence up to which a projection is as probable as the best:
odds of 20 to 1."""

MIN_SHEETS_OF_SERIES = 2
"""Sheets from which on their paper can be compared."""

MAJORITY_OF_PROJECTIONS = 0.5
"""Share of the projections beyond which a point that is a blunder in them is one of the map."""


@dataclass(frozen=True)
class Tried:
    """A projection that was tried.

    Parameters
    ----------
    name, crs : str
    rmse : float
        Of points held out of the choice of the model in this projection [px]: of several sheets
        the geometric mean. Infinite where no model is determined.
    sheet_rmses : tuple of float
        The RMSE of each sheet [px].
    evidence : float
        Logarithm of how probable the series makes all points, but for a constant; NaN where no
        series is compared.
    """

    name: str
    crs: str
    rmse: float
    sheet_rmses: tuple[float, ...] = ()
    evidence: float = np.nan


def rank_projections(sheets: Sequence[FeatureSet], candidates: Sequence[Projection]) -> list[Tried]:
    """Return how well each projection predicts the points of all sheets, the best first.

    All sheets of a series were drawn in one projection, so that each projection has one figure: the
    geometric mean of the sheets' RMSEs [px], weighted by their numbers of points. Independent
    points and blunders (see `_without_blunders`) take no part, nor do sheets that have fewer than
    `MIN_POINTS_OF_SHEET` points before blunders are left out. Raises TermselError if no sheet has
    enough.
    """
    used_sheets = [without_independent(sheet) for sheet in sheets]
    used_sheets = [_without_blunders(sheet, candidates) for sheet in used_sheets
                   if len(sheet.points) >= MIN_POINTS_OF_SHEET]
    if not used_sheets:
        raise TermselError(f"no map has the {MIN_POINTS_OF_SHEET} points that a choice of its "
                           "projection requires",
                           hint="Measure more points, or state the projection.")
    counts = [len(sheet.points) for sheet in used_sheets]
    ranked = []
    for candidate in candidates:
        sheet_rmses = [_predicted_rmse(sheet, candidate.crs) for sheet in used_sheets]
        rmse = float(np.exp(np.average(np.log(sheet_rmses), weights=counts)))
        ranked.append(Tried(candidate.name, candidate.crs, rmse, tuple(sheet_rmses)))
    return sorted(ranked, key=lambda projection: projection.rmse)


def rank_by_series(sheets: Sequence[FeatureSet], candidates: Sequence[Projection]) -> list[Tried]:
    """Return how probable each projection makes the points of all sheets, the most probable first.

    The sheets share their paper: in their own projection its scale, turn, stretch and shear differ
    little from sheet to sheet, in another one they follow the place. Few points of a sheet by
    itself may fit any projection by chance. The RMSE is that of all points together, each held out
    and predicted by the others of its sheet and the paper of the other sheets. Empty where fewer
    than two sheets show their paper.
    """
    used_sheets = [_without_blunders(sheet, candidates)
                   for sheet in _different(sheets) if len(sheet.points) >= MIN_POINTS_OF_SHEET]
    shown = {candidate.crs: of_all for candidate in candidates
             if (of_all := _papers_of(used_sheets, candidate.crs))}
    # All projections are judged by the same sheets.
    places = [i for i in range(len(used_sheets)) if all(of_all[i] for of_all in shown.values())]
    if not shown or len(places) < MIN_SHEETS_OF_SERIES:
        return []
    telling_sheets = [used_sheets[i] for i in places]
    ranked = []
    for candidate in candidates:
        if candidate.crs not in shown:
            ranked.append(Tried(candidate.name, candidate.crs, np.inf, evidence=-np.inf))
            continue
        papers = [paper for i in places if (paper := shown[candidate.crs][i]) is not None]
        rmse = _rmse_by_series(telling_sheets, Series(candidate.crs, tuple(papers)))
        ranked.append(Tried(candidate.name, candidate.crs, rmse, evidence=evidence_of(papers)))
    return sorted(ranked, key=lambda projection: -projection.evidence)


def as_probable_as_the_best(
        ranked: Sequence[Tried], candidates: Sequence[Projection]) -> list[Tried]:
    """Return the projections that the sheets of a series do not tell apart, in their given order.

    They are `ranked` by their evidence; the first of the candidates is the one to take.
    """
    as_probable = {projection.crs: projection for projection in ranked
                   if projection.evidence >= ranked[0].evidence - AS_PROBABLE}
    return [as_probable[candidate.crs] for candidate in candidates
            if candidate.crs in as_probable]


def first_of_the_best(
        ranked: Sequence[Tried], candidates: Sequence[Projection], nearly: float = NEARLY_BEST,
) -> Tried:
    """Return the first of the candidates that predicts about as well as the best projection.

    Its RMSE is up to `nearly` times the least and, in a series, the sheets do not show that it is
    worse (`_is_worse_on_sheets`). Raises TermselError if in no projection a model is determined.
    """
    best = ranked[0].rmse
    if not np.isfinite(best):
        raise TermselError("in no projection the points determine a model",
                           hint="Measure more points, spread over the map.")
    nearly_best = {projection.crs: projection for projection in ranked
                   if projection.rmse <= nearly * best
                   and not _is_worse_on_sheets(projection, ranked[0])}
    return next(nearly_best[candidate.crs] for candidate in candidates
                if candidate.crs in nearly_best)


def _is_worse_on_sheets(projection: Tried, best: Tried) -> bool:
    """Return whether the sheets of a series show that a projection is worse than the best one.

    They do if the logarithms of the ratios of their RMSEs have a mean above `SIGNIFICANT_ERRORS`
    standard errors. Fewer than `MIN_SHEETS` sheets show nothing.
    """
    if len(best.sheet_rmses) < MIN_SHEETS:
        return False
    logs = np.log(projection.sheet_rmses) - np.log(best.sheet_rmses)
    standard_error = logs.std(ddof=1) / np.sqrt(len(logs))
    return bool(logs.mean() > max(SIGNIFICANT_ERRORS * standard_error, NEGLIGIBLE))


def _different(sheets: Sequence[FeatureSet]) -> list[FeatureSet]:
    """Return sheets without their independent points, and each that is given twice once."""
    seen: set[str] = set()
    different = []
    for sheet in map(without_independent, sheets):
        marks = set(marks_of(sheet))
        if seen.isdisjoint(marks):
            different.append(sheet)
        seen |= marks
    return different


def _papers_of(sheets: Sequence[FeatureSet], crs: str) -> list[Sheet | None]:
    """Return what each sheet shows of its paper in a projection.

    Empty where the projection has not all of their places.
    """
    try:
        return [sheet_of(replace(sheet, fit_crs=crs)) for sheet in sheets]
    except TermselError:
        return []


def _rmse_by_series(sheets: Sequence[FeatureSet], series: Series) -> float:
    """Return the RMSE of the points of all sheets [px], each by others and by the other sheets."""
    squares = []
    for sheet in sheets:
        fitted = SHEET_OF_SERIES.fit(FitData.of(with_series_columns(sheet, series)))
        squares.append(len(sheet.points) * fitted.held_out_rmse**2)
    return float(np.sqrt(sum(squares) / sum(len(sheet.points) for sheet in sheets)))


def _without_blunders(sheet: FeatureSet, candidates: Sequence[Projection]) -> FeatureSet:
    """Return a sheet without the points that are or may be blunders in most of the projections.

    A projection has no vote where the sheet has too few points for a test, or where a point has no
    coordinates in it. The sheet is returned as it is if no projection has a vote.
    """
    # All projections must be compared by the same points. A right point may look like a blunder in
    # a projection that is not the map's, but hardly in most of them.
    votes = [vote for candidate in candidates
             if (vote := blunders_in(sheet, candidate.crs)) is not None]
    if not votes:
        return sheet
    is_blunder = np.mean(votes, axis=0) > MAJORITY_OF_PROJECTIONS
    return sheet.with_(points=sheet.points.take(~is_blunder))


def _predicted_rmse(features: FeatureSet, crs: str) -> float:
    """Return the RMSE of held-out points [px] of the model that auto chooses in a projection.

    It is infinite if no model is determined, and 1e-9 px at least, as its logarithm is taken.
    """
    try:
        choice = Auto().choose(FitData.of(replace(features, fit_crs=crs)))
    except TermselError:
        return np.inf
    return np.inf if choice is None else max(choice.chosen.held_out_rmse, 1e-9)
