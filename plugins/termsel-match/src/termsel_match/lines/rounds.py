"""Lines matched again and again, each time from the model that the last ones gave."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import termsel
from termsel import FeatureSet, Fit, Lines, Result, TermselError
from termsel_match.images.starts import Start, start_of, transform_plane
from termsel_match.judgement.structures import model_by_relief
from termsel_match.lines.candidates import LineCandidates, match_lines, without_start
from termsel_match.lines.certainty import (
    Decisive,
    fit_lines_or_hold_by_start,
    most_decisive_vector,
    sentences_on_certainty,
)
from termsel_match.lines.problem import MatchedLines
from termsel_match.lines.tracing import Tracing, variance_of_tracing
from termsel_match.searching import features_by_search

_MAX_ROUNDS = 6

_NARROWER = 4.0
"""Factor by which each round searches less far than the one before."""

_NARROWEST = 8.0
"""Least distance that a round searches [px]."""

_HALF_AT = 2.0, 1.0
"""Distance at which a piece counts half, in the first round and in later ones [px]."""

_SETTLED_MOVE = 0.1
"""Movement of the image by a round below which rounds end [px]."""

_PROOF, _AT = 40.0, 3.0
"""In the end, the clearest band within the first distance from a vector must be within the second
[px]."""

_LEAST_SHARE = 0.5
"""Least share of the pieces for which this must be so. It is 0.68 or more for true models of ten
scenes, and at most 0.12 for models that are 20 px off (docs/evidence/matching.md)."""


@dataclass(frozen=True)
class Round:
    """One round of matching lines, and what it changed.

    Parameters
    ----------
    search : float
        Largest distance of a band from the model of the round before [px].
    pieces, candidates, agreeing : int
        Number of pieces with candidates, of candidates, and of pieces that agree with the new
        model.
    rms : float
        RMS distance of the agreeing lines from the new model [px].
    moved : float
        RMS movement of the agreeing lines in the image, from the model before to the new one [px].
    """

    search: float
    pieces: int
    candidates: int
    agreeing: int
    rms: float
    moved: float


@dataclass(frozen=True, eq=False)
class Matched:
    """The lines and the model with which rounds of matching ended.

    Parameters
    ----------
    candidates : LineCandidates
        The candidates of the last round.
    lines : Lines
        The lines that agree. As their standard deviation, all have the RMS distance from the model.
    result : Result
        The result of a run with these lines.
    rounds : tuple of Round
        All rounds.
    settled : bool
        Whether the last round moved the image by less than 0.1 px.
    decisive : Decisive
        The vector without which the image moves most.
    tracing : Tracing
        What errors of the vectors leave in the image. It is not estimated if the start holds the
        image, or is a model by points, which show more of it.
    """

    candidates: LineCandidates
    lines: Lines
    result: Result
    rounds: tuple[Round, ...]
    settled: bool
    decisive: Decisive
    tracing: Tracing

    @property
    def features(self) -> FeatureSet:
        """The lines that agree, as control."""
        return FeatureSet(lines=self.lines, crs=self.candidates.crs,
                          image_size=self.candidates.image_size)

    def text(self) -> str:
        """Return the report: a table with a row for each round, and sentences on the lines.

        They say whether the model still changes, how well the lines determine it, which vector
        decides most, and what errors of the vectors leave in the image. Distances are in px.
        """
        table = ["round  search  pieces  candidates  agree    rms  moved"]
        table += [f"{i + 1:5d} {round_.search:7.0f} {round_.pieces:7d} {round_.candidates:11d} "
                  f"{round_.agreeing:6d} {round_.rms:6.2f} {round_.moved:6.2f}"
                  for i, round_ in enumerate(self.rounds)]
        if not self.settled:
            table.append("The last round still changed the model.")
        table += [sentences_on_certainty(self.lines), self.decisive.text()]
        if self.tracing.vectors:
            table.append(self.tracing.text())
        return "\n".join(table) + "\n"


def iterate_lines(
    image: Path | str,
    vectors: Path | str,
    model: str,
    options: Mapping[str, Any],
    *,
    dem: Path | str | None = None,
    start: Path | str | Start | None = None,
    search: float = 60.0,
    band: int | None = None,
    seed: int = 1,
    folder: Path | str | None = None,
    progress: Callable[[float], None] | None = None,
) -> Matched:
    """Match lines, select those that agree, and match again from their model until it settles.

    Parameters
    ----------
    image, vectors, dem, start, search, band
        As for `match_lines`. Each further round searches a fourth as far, but at least 8 px.
    model : str
        Name of the model.
    options : mapping
        Options of the model.
    seed : int
        Seed of each selection.
    folder : path-like, optional
        Folder for the last result.
    progress : callable, optional
        Called with the share of a round that is done, 0 to 1.

    Returns
    -------
    Matched
        The lines that agree, their model, and whether the rounds settled.

    Raises
    ------
    TermselError
        As `match_lines`; or if the model is wrong, as for fewer than half of the pieces the
        clearest band within 40 px is where the model projects the vector.
    """
    start_of_round = start if isinstance(start, Start) else start_of(start, Path(image))
    if start_of_round is None:
        raise without_start(Path(image))
    rounds: list[Round] = []
    reach = search
    while True:
        candidates = match_lines(image, vectors, dem=dem, start=start_of_round, search=reach,
                                 band=band, progress=progress)
        agreement = _agreement_among(candidates, model, options, start_of_round, search=reach,
                                     half_at=_HALF_AT[bool(rounds)], seed=seed)
        # A model that the relief has replaced is replaced for all further rounds.
        model, options = agreement.model, agreement.options
        rounds.append(agreement.round_from(start_of_round, reach))
        settled = rounds[-1].moved < _SETTLED_MOVE
        if settled or len(rounds) == _MAX_ROUNDS:
            break
        # The model is better now, and a narrower search finds fewer wrong bands.
        reach = min(reach, max(_NARROWEST, reach / _NARROWER))
        start_of_round = agreement.start
    # A wide search from the model shows whether it is right: then the clearest bands are next to
    # it.
    confirmed = are_bands_in_place(image, vectors, agreement.start, dem=dem,
                                   search=max(_PROOF, search), band=band)
    if confirmed.mean() < _LEAST_SHARE:
        raise TermselError(
            f"not enough lines agree: for {int(confirmed.sum())} of {len(confirmed)} pieces of "
            f"vectors the clearest band of the image is at its place", file=Path(image),
            hint="Give a larger --search, a start that is nearer, or vectors of what the image "
                 "shows.")
    # What the lines miss by is the standard deviation of each.
    used = agreement.used
    used = used.with_(lines=replace(used.lines, sigma=np.full(len(used.lines), rounds[-1].rms)))
    mixed = {"mixed": True} if len(used.points) else {}
    result = termsel.run("owdis-lines", features=used, model=model, solver="all-terms",
                         criterion="press", options={**options, **mixed}, seed=seed, out=folder)
    # Not of an image that points or its start hold: these show more of what the vectors leave.
    is_by_lines = not (isinstance(start, Start) or len(used.points))
    return Matched(
        candidates=candidates,
        lines=used.lines,
        result=result,
        rounds=tuple(rounds),
        settled=settled,
        decisive=most_decisive_vector(used, model, options),
        tracing=agreement.tracing(seed) if is_by_lines else Tracing(),
    )


@dataclass(frozen=True, eq=False)
class _Agreement:
    """The candidates of a round, those that agree, and the model that these give."""

    candidates: LineCandidates
    features: FeatureSet  # all candidates
    used: FeatureSet  # the lines that agree, and points of the start where it has to hold the image
    fitted: Fit
    model: str
    options: Mapping[str, Any]  # of the model
    half_at: float  # distance at which a piece counts half [px]

    @property
    def start(self) -> Start:
        """The model as the start of the next round, at the mean height of its lines."""
        height = float(np.nanmean(self.used.lines.ground[..., 2]))
        return Start("the model of the last round", self.candidates.crs, height,
                     self.fitted.project, self.fitted.locate)

    def round_from(self, before: Start, search: float) -> Round:
        """Return what the round changed: `before` is its start, `search` its distance [px]."""
        lines = self.used.lines
        vertices = lines.ground.reshape(-1, 3)
        plane = transform_plane(vertices[:, :2], self.candidates.crs, before.crs)
        moves = self.fitted.project(vertices) - before.project(
            np.column_stack([plane, vertices[:, 2]]))
        return Round(search, len(set(self.candidates.lines.attributes["piece"])),
                     len(self.candidates.lines), len(lines), rms_distance(self.fitted, lines),
                     moved=float(np.sqrt((moves**2).sum(axis=1).mean())))

    def tracing(self, seed: int) -> Tracing:
        """Return what errors of the vectors leave in the image (see `variance_of_tracing`)."""
        problem = termsel.prepare("matched-lines", features=self.features, model=self.model,
                                  options={**self.options, "half_at": self.half_at}).problem
        assert isinstance(problem, MatchedLines)
        return variance_of_tracing(problem, self.used.lines.ids, seed)


def _agreement_among(candidates: LineCandidates, model: str, options: Mapping[str, Any], at: Start,
                     *, search: float, half_at: float, seed: int) -> _Agreement:
    """Select the candidates that agree, and return them with the model that they give.

    Over ground that is a plane an affine `model` loses its terms of heights. A piece at a distance
    of `half_at` [px] counts half. Where the lines alone do not hold the image, the start
    `at` does, as far as a search of `search` px could be wrong. Raises TermselError if too few
    lines agree.
    """
    features = FeatureSet(lines=candidates.lines, crs=candidates.crs,
                          image_size=candidates.image_size)
    by_relief = model_by_relief(model, options, features)
    selected = candidates.lines.take(np.isin(candidates.lines.ids, features_by_search(
        "matched-lines", features, by_relief.model, {**by_relief.options, "half_at": half_at},
        seed=seed)))
    # All lines weigh alike: how well a band is measured does not say how far the vector is off.
    alike = replace(selected, sigma=np.ones(len(selected)))
    used, fitted = fit_lines_or_hold_by_start(
        features.with_(lines=alike), by_relief.model, by_relief.options, at, search)
    return _Agreement(candidates, features, used, fitted, by_relief.model, by_relief.options,
                      half_at=half_at)


def are_bands_in_place(image: Path | str, vectors: Path | str, at: Start, *, dem: Path | str | None,
                       search: float = _PROOF, band: int | None = None) -> NDArray[np.bool_]:
    """Return for each piece whether its clearest band is within 3 px of where a model projects it.

    `at` is the model. The answer (n,) has an entry for each piece with a band within `search` px.
    """
    lines = match_lines(image, vectors, dem=dem, start=at, search=search, band=band).lines
    # Candidates of a piece are numbered from the clearest on.
    clearest = np.array([name.endswith(".1") for name in lines.ids])
    return np.asarray(np.abs(lines.attributes["offset"][clearest].astype(float)) <= _AT)


def rms_distance(fitted: Fit, lines: Lines) -> float:
    """Return the RMS distance of projected vertices from measured lines [px]."""
    distances = np.linalg.norm(fitted.line_errors(lines), axis=2)
    return float(np.sqrt((distances**2).mean()))
