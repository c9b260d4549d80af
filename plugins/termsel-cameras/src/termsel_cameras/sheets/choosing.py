"""Which projection the points of a map, or of a series of sheets, show to be theirs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from termsel import FeatureSet, FitData, TermselError
from termsel.toolkit import FloatArray
from termsel.toolkit.coordinates import transformation_between
from termsel.toolkit.models import Auto
from termsel_cameras.roles import without_independent
from termsel_cameras.sheets.candidates import Projection, corners_of_sheets
from termsel_cameras.sheets.paper import (
    Sheet,
    evidence_of,
    evidence_of_map,
    marks_of,
    sheet_of,
)
from termsel_cameras.sheets.series import SHEET_OF_SERIES
from termsel_cameras.sheets.series_file import Series, with_series_columns
from termsel_cameras.sheets.sound import blunders_in

MIN_POINTS_OF_SHEET = 4
"""Points from which on a sheet distinguishes projections."""

LATTICE = 5
"""Places along each side of a map at which projections are compared."""

AS_PROBABLE = 3.0
"""Difference of the logarithms of the evidence up to which a projection is as probable as the best:
odds of 20 to 1."""

CONTRADICTED = 10.0
"""Difference of the logarithms of the evidence from which on the sheets of a series contradict a
projection: odds of 20,000 to 1. Of sheets that are deformed locally smaller ones are chance, as
evidence counts each point for itself."""

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
    evidence : float
        Logarithm of how probable the projection makes all points, but for a constant.
    """

    name: str
    crs: str
    rmse: float
    evidence: float


@dataclass(frozen=True)
class Choice:
    """The projection that the points of maps choose.

    Parameters
    ----------
    ranked : tuple of Tried
        All projections, the most probable first.
    chosen : Tried
    as_probable : tuple of Tried
        Those that the points do not tell from the most probable one, as their list has them.
    apart : float
        Distance of the maps in the chosen projection from those in all others [px], RMS by how
        probable these are.
    """

    ranked: tuple[Tried, ...]
    chosen: Tried
    as_probable: tuple[Tried, ...]
    apart: float


@dataclass(frozen=True)
class _Shown:
    """A map in a projection.

    `rmse` is that of held-out points of the model of auto [px], infinite where none is determined;
    `positions` (k, 2) are where that model has the places of a lattice [px]; `paper` is what an
    affine map shows, None where there is none.
    """

    rmse: float
    positions: FloatArray
    paper: Sheet | None


def choose_by_points(sheets: Sequence[FeatureSet], candidates: Sequence[Projection]) -> Choice:
    """Return the projection from which those that the points find probable differ least.

    How probable a projection is follows from what a model leaves of the points, and from the
    stretch and shear that it would give the paper (see `evidence_of_map`). Of few points the most
    probable one, or that of the least held-out error, is one of several by chance, and may be far
    from all others. So the one is taken whose maps have the least expected squared distance from
    those in the true projection; where points tell, that is the most probable one. Independent
    points and blunders (see `_without_blunders`) take no part, nor do sheets that have fewer than
    `MIN_POINTS_OF_SHEET` points before blunders are left out.

    Raises TermselError if no sheet has enough, or if in no projection a model is determined.
    """
    used_sheets = [without_independent(sheet) for sheet in sheets]
    used_sheets = [_without_blunders(sheet, candidates) for sheet in used_sheets
                   if len(sheet.points) >= MIN_POINTS_OF_SHEET]
    if not used_sheets:
        raise TermselError(f"no map has the {MIN_POINTS_OF_SHEET} points that a choice of its "
                           "projection requires",
                           hint="Measure more points, or state the projection.")
    # Each sheet is fitted in each projection once; figures and positions come from the same fits.
    shown = [[_shown_in(sheet, candidate.crs) for candidate in candidates]
             for sheet in used_sheets]
    counts = [len(sheet.points) for sheet in used_sheets]
    # rmse = exp(sum(n_i log(rmse_i)) / sum(n_i)): a sheet of large errors does not decide alone.
    log_rmses = np.log([[one.rmse for one in of_sheet] for of_sheet in shown])
    rmses = np.exp(np.average(log_rmses, axis=0, weights=counts))
    evidences = np.sum([_evidences(*of_sheet) for of_sheet in zip(used_sheets, shown, strict=True)],
                       axis=0)
    if not np.isfinite(evidences).any():
        raise TermselError("in no projection the points determine a model",
                           hint="Measure more points, spread over the map.")
    # Bayes' theorem with the same prior for all; the largest is subtracted lest all round to zero.
    probabilities = np.exp(evidences - evidences.max())
    probabilities /= probabilities.sum()
    squares = np.average([_squared_distances(of_sheet) for of_sheet in shown], axis=0,
                         weights=counts)
    # The expected squared distance from the map in the true projection: sum_j p_j d_ij^2.
    expected = np.where(np.isfinite(evidences), squares @ probabilities, np.inf)
    tried = [Tried(candidate.name, candidate.crs, rmse, evidence) for candidate, rmse, evidence
             in zip(candidates, rmses.tolist(), evidences.tolist(), strict=True)]
    chosen = tried[int(expected.argmin())]
    ranked = sorted(tried, key=lambda projection: -projection.evidence)
    as_probable = [projection for projection in tried if projection is chosen
                   or projection.evidence >= ranked[0].evidence - AS_PROBABLE]
    return Choice(tuple(ranked), chosen, tuple(as_probable), float(np.sqrt(expected.min())))


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


def contradicting(
        ranked: Sequence[Tried], candidates: Sequence[Projection]) -> Tried | None:
    """Return the projection by which the sheets of a series contradict all candidates, or None.

    They are `ranked` by their evidence, with others.
    """
    crss = {candidate.crs for candidate in candidates}
    best_candidate = next(projection for projection in ranked if projection.crs in crss)
    is_contradicted = ranked[0].evidence - best_candidate.evidence > CONTRADICTED
    return ranked[0] if is_contradicted else None


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


def _shown_in(sheet: FeatureSet, crs: str) -> _Shown:
    """Return a map in a projection, with the model that auto chooses there.

    The RMSE is 1e-9 px at least, as its logarithm is taken.
    """
    projected = replace(sheet, fit_crs=crs)
    try:
        choice = Auto().choose(FitData.of(projected))
        if choice is not None:
            positions = choice.chosen.project(_lattice_of(sheet))
            if np.isfinite(positions).all():
                return _Shown(max(choice.chosen.held_out_rmse, 1e-9), positions,
                              sheet_of(projected))
    except TermselError:  # places that the projection does not show
        pass
    return _Shown(np.inf, np.zeros((LATTICE**2, 2)), None)


def _lattice_of(sheet: FeatureSet) -> FloatArray:
    """Return places (k, 3) in a lattice over the rectangle around the points of a sheet."""
    south_west, north_east = corners_of_sheets([sheet])
    axes = np.linspace(south_west, north_east, LATTICE)
    degrees = np.stack(np.meshgrid(*axes.T), axis=-1).reshape(-1, 2)
    flat = np.column_stack([degrees, np.zeros(len(degrees))])
    return transformation_between("EPSG:4326", sheet.crs)(flat)


def _evidences(sheet: FeatureSet, shown: Sequence[_Shown]) -> FloatArray:
    """Return the logarithm (p,) of how probable each of p projections makes a sheet's points.

    Minus infinity where no model is determined. Paper counts where each projection shows it.
    """
    # A density of paper and one without it have unlike units, which must not decide.
    determined = [one for one in shown if np.isfinite(one.rmse)]
    shows_paper = all(one.paper is not None for one in determined)
    evidences = np.full(len(shown), -np.inf)
    for i, one in enumerate(shown):
        if np.isfinite(one.rmse):
            evidences[i] = evidence_of_map(len(sheet.points), one.rmse,
                                           one.paper if shows_paper else None)
    return evidences


def _squared_distances(shown: Sequence[_Shown]) -> FloatArray:
    """Return the mean squared distances between the positions in all projections, (n, n) [px^2]."""
    # Positions, not coefficients, are compared: models differ from projection to projection.
    positions = np.array([one.positions for one in shown])
    return np.array([((positions - of_one)**2).sum(axis=2).mean(axis=1) for of_one in positions])
