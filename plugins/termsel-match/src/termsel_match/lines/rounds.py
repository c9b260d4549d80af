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
from termsel_match.images.starts import Start, start_of, turned
from termsel_match.lines.candidates import LineCandidates, match_lines, without_start
from termsel_match.lines.certainty import (
    Decisive,
    fitted_to,
    most_decisive,
    undetermined,
)
from termsel_match.lines.problem import MatchedLines
from termsel_match.lines.tracing import Tracing, left_by_tracing
from termsel_match.searching import searched

_MOST = 6  # rounds
_NARROWER = 4.0  # the search of a round is that of the last by this
_NARROWEST = 8.0  # px
_HALF_AT = 2.0, 1.0  # px at which a piece counts half, in the first round and later
_SETTLED = 0.1  # px by which the last round moves the image
_PROOF, _AT = 40.0, 3.0  # px: in the end the clearest band within the one must be within the other
_LEAST_SHARE = 0.5  # for this part of the pieces: at least 0.68 of true models in ten scenes, and
# at most 0.12 of models that are 20 px off (docs/evidence/matching.md)


@dataclass(frozen=True)
class Round:
    """One round: its search, its counts, and what it changed.

    Parameters
    ----------
    search : float
        Largest distance from the model before [px].
    pieces, candidates, agreeing : int
        Pieces with candidates, candidates, and pieces that agree with the new model.
    rms : float
        Of the distances of those that agree [px].
    moved : float
        Rms by which the lines that agree have moved in the image [px].
    """

    search: float
    pieces: int
    candidates: int
    agreeing: int
    rms: float
    moved: float


@dataclass(frozen=True, eq=False)
class Matched:
    """What rounds of matching ended with.

    Parameters
    ----------
    candidates : LineCandidates
        Of the last round.
    lines : Lines
        Those that agree; their standard deviations are those of their distances.
    result : Result
    rounds : tuple of Round
    settled : bool
        Whether the last round changed next to nothing.
    decisive : Decisive
        The vector without which the image moves most.
    tracing : Tracing
        What errors of the vectors leave in the image. Where the start holds the image, or is a
        model of points, which tell more, it is not told.
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
        """Return a table of the rounds, and what the lines leave undetermined."""
        table = ["round  search  pieces  candidates  agree    rms  moved"]
        table += [f"{i + 1:5d} {each.search:7.0f} {each.pieces:7d} {each.candidates:11d} "
                  f"{each.agreeing:6d} {each.rms:6.2f} {each.moved:6.2f}"
                  for i, each in enumerate(self.rounds)]
        if not self.settled:
            table.append("The last round still changed the model.")
        table += [undetermined(self.lines), self.decisive.text()]
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
    out: Path | str | None = None,
    progress: Callable[[float], None] | None = None,
) -> Matched:
    """Match lines, select those that agree, and match again from their model until it stays.

    Parameters
    ----------
    image, vectors, dem, start, search, band
        As for `match_lines`; each round searches a fourth as far, at least 8 px.
    model : str
    options : mapping
        Options of the model.
    seed : int
        Of each selection.
    out : path-like, optional
        Folder for the last result.
    progress : callable, optional
        Called with the fraction of the round that is done.

    Raises
    ------
    TermselError
        As `match_lines`; or if the model is wrong: for fewer than half of the pieces the clearest
        band within 40 px is where the model sees the vector.
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

        half_at = _HALF_AT[bool(rounds)]
        chosen = candidates.lines.take(np.isin(candidates.lines.ids, searched(
            "matched-lines", features, model, {**options, "half_at": half_at}, seed=seed)))
        used, fitted = fitted_to(
            features.with_(lines=replace(chosen, sigma=np.ones(len(chosen)))), model, options, at,
            search)
        chosen = used.lines
        pieces = len(set(candidates.lines.attributes["piece"]))
        rms = rms_distance(fitted, chosen)
        there = chosen.ground.reshape(-1, 3)
        now = fitted.project(there)
        before = at.project(np.column_stack([turned(there[:, :2], candidates.crs, at.crs),
                                             there[:, 2]]))
        moved = float(np.sqrt(((now - before) ** 2).sum(axis=1).mean()))
        rounds.append(Round(search, pieces, len(candidates.lines), len(chosen), rms, moved))
        settled = moved < _SETTLED
        if settled or len(rounds) == _MOST:
            break
        search = min(search, max(_NARROWEST, search / _NARROWER))
        at = _start(fitted, candidates.crs, chosen)
    seen = in_place(image, vectors, _start(fitted, candidates.crs, chosen), dem=dem,
                    search=max(_PROOF, first), band=band)
    if seen.mean() < _LEAST_SHARE:
        raise TermselError(
            f"not enough lines agree: for {int(seen.sum())} of {len(seen)} pieces of vectors the "
            f"clearest band of the image is at its place", file=Path(image),
            hint="Is the start off by more than --search? Do the vectors show what can be seen?")
    lines = replace(chosen, sigma=np.full(len(chosen), rms))
    used = used.with_(lines=lines)
    mixed = {"mixed": True} if len(used.points) else {}
    result = termsel.run("owdis-lines", features=used, model=model, solver="all-terms",
                         criterion="press", options={**options, **mixed}, seed=seed, out=out)
    tracing = Tracing()
    if not (isinstance(start, Start) or len(used.points)):
        problem = termsel.prepare("matched-lines", features=features, model=model,
                                  options={**options, "half_at": half_at}).problem
        assert isinstance(problem, MatchedLines)
        tracing = left_by_tracing(problem, chosen.ids, seed)
    return Matched(candidates, lines, result, tuple(rounds), settled,
                   most_decisive(used, model, options), tracing)


def in_place(image: Path | str, vectors: Path | str, at: Start, *, dem: Path | str | None,
             search: float = _PROOF, band: int | None = None) -> NDArray[np.bool_]:
    """Return for each piece whether its clearest band is within 3 px of where a model sees it."""
    seen = match_lines(image, vectors, dem=dem, start=at, search=search, band=band).lines
    clearest = np.array([name.endswith(".1") for name in seen.ids])
    return np.asarray(np.abs(seen.attributes["offset"][clearest].astype(float)) <= _AT)


def _start(fitted: Fit, crs: str, lines: Lines) -> Start:
    return Start("the model of the last round", crs, float(np.nanmean(lines.ground[..., 2])),
                 fitted.project, fitted.locate)


def rms_distance(fitted: Fit, lines: Lines) -> float:
    """Return the RMS distance of projected vertices from measured lines [px]."""
    distances = np.linalg.norm(fitted.line_errors(lines), axis=2)
    return float(np.sqrt((distances**2).mean()))
