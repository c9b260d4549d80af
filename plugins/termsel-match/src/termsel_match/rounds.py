"""Lines matched again and again, each time from the model that the last ones gave."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import termsel
from termsel import FeatureSet, Fit, Lines, Result, TermselError
from termsel_match.lines import LineCandidates, match_lines
from termsel_match.selection import searched
from termsel_match.starts import Start, start_of

_MOST = 6  # rounds
_NARROWER = 4.0  # the search of a round is that of the last by this
_NARROWEST = 8.0  # px
_HALF_AT = 2.0, 1.0  # px at which a piece counts half, in the first round and later
_SETTLED = 0.1  # px by which the last round moves the image
_PROOF, _AT = 40.0, 3.0  # px: in the end the clearest band within the one must be within the other
_LEAST_SHARE = 0.6  # for this part of the pieces: 0.9 of a true model, 0.3 of a wrong one
_WEAK = 3.0  # ratio of standard deviations across and along


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
    """

    candidates: LineCandidates
    lines: Lines
    result: Result
    rounds: tuple[Round, ...]
    settled: bool

    @property
    def features(self) -> FeatureSet:
        """The lines that agree, as control."""
        return FeatureSet(lines=self.lines, crs=self.candidates.crs,
                          image_size=self.candidates.image_size)

    def text(self) -> str:
        """Return a table of the rounds, and what the lines leave undetermined."""
        table = ["round  search  pieces  candidates  agree    rms  moved"]
        table += [f"{i + 1:5d} {one.search:7.0f} {one.pieces:7d} {one.candidates:11d} "
                  f"{one.agreeing:6d} {one.rms:6.2f} {one.moved:6.2f}"
                  for i, one in enumerate(self.rounds)]
        if not self.settled:
            table.append("The last round still changed the model.")
        return "\n".join([*table, undetermined(self.lines)]) + "\n"


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
        As `match_lines`; or if the model is wrong: for fewer than three in five pieces the clearest
        band within 40 px is where the model sees the vector.
    """
    at = start if isinstance(start, Start) else start_of(start, Path(image))
    rounds: list[Round] = []
    first = search
    while True:
        found = match_lines(image, vectors, dem=dem, start=at, search=search, band=band,
                            progress=progress)
        features = FeatureSet(lines=found.lines, crs=found.crs, image_size=found.image_size)
        chosen = found.lines.take(np.isin(found.lines.ids, searched(
            "matched-lines", features, model, {**options, "half_at": _HALF_AT[bool(rounds)]},
            seed=seed)))
        fitted = termsel.fit(features.with_(lines=replace(chosen, sigma=None)), model, **options)
        pieces = len(set(found.lines.attributes["piece"]))
        rms = rms_distance(fitted, chosen)
        now = fitted.project(chosen.ground.reshape(-1, 3))
        before = now if at is None else _in(at, chosen.ground.reshape(-1, 3), found.crs)
        moved = float(np.sqrt(((now - before) ** 2).sum(axis=1).mean()))
        rounds.append(Round(search, pieces, len(found.lines), len(chosen), rms, moved))
        settled = moved < _SETTLED
        if settled or len(rounds) == _MOST:
            break
        search = min(search, max(_NARROWEST, search / _NARROWER))
        at = _start(fitted, found.crs, chosen)
    seen = match_lines(image, vectors, dem=dem, start=_start(fitted, found.crs, chosen),
                       search=max(_PROOF, first), band=band).lines
    clearest = np.array([name.endswith(".1") for name in seen.ids])
    there = np.abs(seen.attributes["offset"][clearest].astype(float)) <= _AT
    if there.mean() < _LEAST_SHARE:
        raise TermselError(
            f"not enough lines agree: for {int(there.sum())} of {len(there)} pieces of vectors the "
            f"clearest band of the image is at its place", file=Path(image),
            hint="Is the start off by more than --search? Do the vectors show what can be seen?")
    lines = Lines(chosen.ids, chosen.image, chosen.ground, np.full(len(chosen), rms),
                  attributes=chosen.attributes)
    result = termsel.run("owdis-lines", features=features.with_(lines=lines), model=model,
                         solver="all-terms", criterion="press", options=dict(options), seed=seed,
                         out=out)
    return Matched(found, lines, result, tuple(rounds), settled)


def _start(fitted: Fit, crs: str, lines: Lines) -> Start:
    return Start("the model of the last round", crs, float(np.nanmean(lines.ground[..., 2])),
                 fitted.project, fitted.locate)


def undetermined(lines: Lines) -> str:
    """Return in words how well lines fix the image, across them and along."""
    assert lines.sigma is not None
    run = lines.image[:, 1] - lines.image[:, 0]
    normal = np.stack([-run[:, 1], run[:, 0]], axis=1) / np.linalg.norm(run, axis=1)[:, None]
    information = (normal[:, :, None] * normal[:, None] / lines.sigma[:, None, None] ** 2).sum(
        axis=0)
    (weak, strong), axes = np.linalg.eigh(information)
    sigmas = [float(1 / np.sqrt(one)) if one > 1e-9 * strong else float("inf")
              for one in (weak, strong)]
    towards = float(np.degrees(np.arctan2(axes[1, 0], axes[0, 0]))) % 180
    if sigmas[0] < _WEAK * sigmas[1]:
        return (f"The lines fix the position of the image in all directions: standard deviation "
                f"{max(sigmas):.2f} px.")
    known = "not at all" if sigmas[0] == float("inf") else f"only to {sigmas[0]:.2f} px"
    return (f"The lines run in nearly one direction. Across it they fix the image to "
            f"{sigmas[1]:.2f} px, along it {known}. It is at {towards:.0f} degrees from the "
            "direction of lines towards that of samples.")


def _in(start: Start, ground: Any, crs: str) -> Any:
    """Return where a start sees places of another CRS."""
    from pyproj import CRS, Transformer

    turn = Transformer.from_crs(CRS.from_user_input(crs).to_2d(),
                                CRS.from_user_input(start.crs).to_2d(), always_xy=True)
    return start.project(np.column_stack([*turn.transform(ground[:, 0], ground[:, 1]),
                                          ground[:, 2]]))


def rms_distance(fitted: Fit, lines: Lines) -> float:
    """Return the RMS distance of projected vertices from measured lines [px]."""
    distances = np.linalg.norm(fitted.line_errors(lines), axis=2)
    return float(np.sqrt((distances**2).mean()))
