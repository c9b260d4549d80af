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

    Raises
    ------
    TermselError
        As `match_lines`; or if the model is wrong, as for fewer than half of the pieces the
        clearest band within 40 px is where the model projects the vector.
    """
    at = start if isinstance(start, Start) else start_of(start, Path(image))
    if at is None:
        raise without_start(Path(image))
    rounds: list[Round] = []
    first = search
    while True:
        candidates = match_lines(image, vectors, dem=dem, start=at, search=search, band=band,
                                 progress=progress)
        features = FeatureSet(lines=candidates.lines, crs=candidates.crs,
                              image_size=candidates.image_size)
        by_relief = model_by_relief(model, options, features)
        model, options = by_relief.model, by_relief.options
        half_at = _HALF_AT[bool(rounds)]
        selected = candidates.lines.take(np.isin(candidates.lines.ids, features_by_search(
            "matched-lines", features, model, {**options, "half_at": half_at}, seed=seed)))
        # All lines weigh alike: how well a band is measured does not say how far the vector is off.
        alike = replace(selected, sigma=np.ones(len(selected)))
        used, fitted = fit_lines_or_hold_by_start(
            features.with_(lines=alike), model, options, at, search)
        selected = used.lines
        n_pieces = len(set(candidates.lines.attributes["piece"]))
        rms = rms_distance(fitted, selected)
        vertices = selected.ground.reshape(-1, 3)
        position = fitted.project(vertices)
        plane = transform_plane(vertices[:, :2], candidates.crs, at.crs)
        position_before = at.project(np.column_stack([plane, vertices[:, 2]]))
        moved = float(np.sqrt(((position - position_before) ** 2).sum(axis=1).mean()))
        rounds.append(Round(search, n_pieces, len(candidates.lines), len(selected), rms, moved))
        settled = moved < _SETTLED_MOVE
        if settled or len(rounds) == _MAX_ROUNDS:
            break
        # The model is better now, and a narrower search finds fewer wrong bands.
        search = min(search, max(_NARROWEST, search / _NARROWER))
        at = _start(fitted, candidates.crs, selected)
    # A wide search from the model shows whether it is right: then the clearest bands are next to
    # it.
    confirmed = are_bands_in_place(image, vectors, _start(fitted, candidates.crs, selected),
                                   dem=dem, search=max(_PROOF, first), band=band)
    if confirmed.mean() < _LEAST_SHARE:
        raise TermselError(
            f"not enough lines agree: for {int(confirmed.sum())} of {len(confirmed)} pieces of "
            f"vectors the clearest band of the image is at its place", file=Path(image),
            hint="Give a larger --search, a start that is nearer, or vectors of what the image "
                 "shows.")
    lines = replace(selected, sigma=np.full(len(selected), rms))
    used = used.with_(lines=lines)
    mixed = {"mixed": True} if len(used.points) else {}
    result = termsel.run("owdis-lines", features=used, model=model, solver="all-terms",
                         criterion="press", options={**options, **mixed}, seed=seed, out=folder)
    tracing = Tracing()
    if not (isinstance(start, Start) or len(used.points)):
        problem = termsel.prepare("matched-lines", features=features, model=model,
                                  options={**options, "half_at": half_at}).problem
        assert isinstance(problem, MatchedLines)
        tracing = variance_of_tracing(problem, selected.ids, seed)
    return Matched(
        candidates=candidates,
        lines=lines,
        result=result,
        rounds=tuple(rounds),
        settled=settled,
        decisive=most_decisive_vector(used, model, options),
        tracing=tracing,
    )


def are_bands_in_place(image: Path | str, vectors: Path | str, at: Start, *, dem: Path | str | None,
                       search: float = _PROOF, band: int | None = None) -> NDArray[np.bool_]:
    """Return for each piece whether its clearest band is within 3 px of where a model projects it.

    `at` is the model. The answer (n,) has an entry for each piece with a band within `search` px.
    """
    lines = match_lines(image, vectors, dem=dem, start=at, search=search, band=band).lines
    # Candidates of a piece are numbered from the clearest on.
    clearest = np.array([name.endswith(".1") for name in lines.ids])
    return np.asarray(np.abs(lines.attributes["offset"][clearest].astype(float)) <= _AT)


def _start(fitted: Fit, crs: str, lines: Lines) -> Start:
    """Return the model of a round as the start of the next one, at the mean height of its lines."""
    return Start("the model of the last round", crs, float(np.nanmean(lines.ground[..., 2])),
                 fitted.project, fitted.locate)


def rms_distance(fitted: Fit, lines: Lines) -> float:
    """Return the RMS distance of projected vertices from measured lines [px]."""
    distances = np.linalg.norm(fitted.line_errors(lines), axis=2)
    return float(np.sqrt((distances**2).mean()))
