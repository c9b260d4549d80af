"""Candidates of control points: places of an image and a reference that look alike."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from termsel import FeatureSet, Points, TermselError, get
from termsel_match.images.overview import start_by_overview
from termsel_match.images.rasters import GreyRaster, open_picture, stretched
from termsel_match.images.starts import Start, start_of
from termsel_match.images.warps import Reference, open_reference
from termsel_match.matchers import Matcher, Matches, Window
from termsel_match.matchers.refinement import Layers, refined

log = logging.getLogger("termsel.match")

_USUAL = ("sift", "structure")
LEAST = 8  # candidates; fewer cannot be selected from
_EACH = 3  # candidates wanted in a cell
_TRIED = 8  # keypoints of a cell that are refined
_APART = 12.0  # px, reduced, between candidates
_WINDOW = 480  # px, reduced: the largest block of cells that is looked at once
_PART = 256  # px, reduced: of a cell that is larger, the part that is looked at once
_BORDER = 24  # px, reduced, around a window, where keypoints have no descriptor
_TRIES = ((0.5, 0.5), (0.0, 0.0), (1.0, 1.0), (0.0, 1.0), (1.0, 0.0))  # where in such a cell

FOUND, NO_DATA, OUTSIDE, NO_TEXTURE, UNLIKE = ("found", "no data", "outside", "no texture",
                                               "unlike")


@dataclass(frozen=True, eq=False)
class Candidates:
    """Candidates of control points, many of which may be wrong.

    Parameters
    ----------
    points : Points
        With standard deviations and, as the attribute `score`, the correlation of the surroundings,
        at most 1. Ground coordinates are in the CRS.
    crs : str
    image_size : tuple of int
        Lines and samples of the image.
    cells : dict of str to int
        How many cells of the image have candidates ("found"), or why they have none.
    start : str
        What was started from, in words.
    rough : Start, optional
        What was started from.
    """

    points: Points
    crs: str
    image_size: tuple[int, int]
    cells: dict[str, int]
    start: str
    rough: Start | None = None

    @property
    def features(self) -> FeatureSet:
        """The candidates as features of the image."""
        return FeatureSet(self.points, crs=self.crs, image_size=self.image_size)


def match_points(
    image: Path | str,
    reference: Path | str,
    *,
    dem: Path | str | None = None,
    start: Path | str | None = None,
    search: float = 100.0,
    count: int = 200,
    band: int | None = None,
    reference_band: int | None = None,
    matcher: str | Matcher | None = None,
    progress: Callable[[float], None] | None = None,
) -> Candidates:
    """Return places of an image and of a georeferenced image that look alike.

    In each cell of the image, the reference is resampled as the start says that the image shows
    it. A matcher finds places that are alike, which are then placed to sub-pixel by least squares.
    Nothing else is asked of them than to be within `search` of the start: which of them are right,
    the selection decides.

    Parameters
    ----------
    image, reference : path-like
        Rasters of any size and type.
    dem : path-like, optional
        Raster of heights; without it, those of the points are unknown.
    start : path-like or str, optional
        See `termsel_match.images.starts.start_of`.
    search : float
        Largest distance from the start [px].
    count : int
        Candidates wanted, some in each cell.
    band, reference_band : int, optional
        Counted from 1; by default the mean of all.
    matcher : str or Matcher, optional
        By default "sift", and "structure" where that finds fewer than 8 candidates.
    progress : callable, optional
        Called with the fraction that is done, 0 to 1.

    Returns
    -------
    Candidates
        At least 8.

    Raises
    ------
    TermselError
        If a raster cannot be read, the reference has no CRS, they show different places, or there
        are fewer candidates, with the reason.

    Notes
    -----
    P.K. Konugurthi et al., "Autonomous ortho-rectification of very high resolution imagery using
    SIFT and genetic algorithm", PE&RS 82(5), 2016, 377-388: matches with a reference and heights
    of a DEM as candidates of which a search selects.
    """
    image = Path(image)
    known = start_of(start, image)
    with open_picture(image, band) as picture:
        if known is None:
            known = start_by_overview(picture, reference, reference_band)
        with open_reference(reference, known, dem, picture.size, reference_band) as other:
            for name in _USUAL if matcher is None else (matcher,):
                chosen = get("matchers", name)
                found, cells = _in_cells(picture, other, chosen() if isinstance(chosen, type)
                                         else chosen, search, count, progress)
                points = _points(found, other)
                if len(points) >= LEAST:
                    break
                log.info("Note: the matcher %s finds %d candidates.", chosen.name, len(points))
        size = picture.size
    if len(points) < LEAST:
        raise TermselError(f"not enough candidates: {len(points)} found, at least {LEAST} "
                           "needed", file=image, hint=_why(cells, search, dem))
    if dem is None:
        log.info("Note: the heights are unknown. Give --dem FILE for RPCs and 3D models.")
    return Candidates(points, other.crs, size, cells, known.what, known)


def _in_cells(picture: GreyRaster, reference: Reference, matcher: Matcher, search: float,
              count: int, progress: Callable[[float], None] | None,
              ) -> tuple[list[Matches], dict[str, int]]:
    """Return matches, first in the image and second in the reference [px], and how cells ended."""
    step = reference.reduction(picture.size)
    if step > 1:
        log.info("Note: the image is matched at 1/%d of its resolution, that of the reference.",
                 step)
    across = max(2, round((count / _EACH) ** 0.5))
    blocks = min(across, -(-max(picture.size) // (_WINDOW * step)))
    inner = -(-across // blocks)  # several small cells are looked at together
    of_cells, ends = [], Counter[str]()
    for done, block in enumerate(product(range(blocks), range(blocks))):
        parts: list[Matches] = []
        for window in _windows(picture.size, blocks, block, step):
            more, end = _in_window(picture, reference, matcher, window, inner, step, search / step)
            parts = max(parts, more, key=_count)
            if _count(parts) >= _EACH:
                break
        of_cells += parts
        ends[FOUND] += len(parts)
        ends[end] += inner**2 - len(parts)
        if progress is not None:
            progress((done + 1) / blocks**2)
    return of_cells, dict(ends)


def _windows(size: tuple[int, int], across: int, block: tuple[int, int], step: int,
             ) -> list[tuple[int, int, int, int]]:
    """Return line, sample, lines and samples of the parts of a block to look at, in turn."""
    low = [extent * i // across for extent, i in zip(size, block, strict=True)]
    sides = [extent * (i + 1) // across - start
             for extent, i, start in zip(size, block, low, strict=True)]
    largest = (_WINDOW if max(sides) <= _WINDOW * step else _PART) * step
    wanted = [min(side, largest) for side in sides]
    windows = []
    for share in _TRIES if sides != wanted else _TRIES[:1]:
        top, left = (start + int((side - want) * part)
                     for start, side, want, part in zip(low, sides, wanted, share, strict=True))
        windows.append((top, left, wanted[0], wanted[1]))
    return windows


def _in_window(picture: GreyRaster, reference: Reference, matcher: Matcher,
               window: tuple[int, int, int, int], inner: int, step: int, search: float,
               ) -> tuple[list[Matches], str]:
    """Return the best matches of each cell of a window, in px of image and reference.

    And why the other cells have none.
    """
    top, left, lines, samples = window
    border, reach = _BORDER * step, (_BORDER + int(np.ceil(search))) * step
    own = picture.read(top - border, left - border, lines + 2 * border, samples + 2 * border, step)
    if not own[1].any():
        return [], NO_DATA
    if stretched(*own) is None:
        return [], NO_TEXTURE
    shape = (lines + 2 * reach) // step, (samples + 2 * reach) // step
    patch = reference.patch(top - reach, left - reach, shape, step)
    if not patch.known.any():
        return [], OUTSIDE
    moved = (reach - border) // step  # between the origins of the two
    first, second = Window(*own), Window(patch.pixels, patch.known, (-moved, -moved))
    found = matcher.match(first, second, search)
    if not len(found.first):
        return [], UNLIKE
    sides = np.array(own[0].shape) - 2 * _BORDER
    cell = np.floor((found.first - _BORDER) / sides * inner).astype(int)
    away = np.linalg.norm(found.second - moved - found.first, axis=1)
    used = ((cell >= 0) & (cell < inner)).all(axis=1) & (away <= search)
    parts = []
    for wanted in product(range(inner), repeat=2):
        some = np.flatnonzero(used & (cell == wanted).all(axis=1))[:_TRIED]
        matches = _apart(_placed(matcher, found, some, first, second))
        if matches.sigma is not None and len(matches.score):
            parts.append(Matches((matches.first + 0.5) * step - 0.5 + [top - border, left - border],
                                 patch.in_reference(matches.second), matches.score,
                                 matches.sigma * step))
    return parts, UNLIKE


def _placed(matcher: Matcher, found: Matches, some: NDArray[np.intp], first: Window,
            second: Window) -> Matches:
    """Return some matches with their standard deviations."""
    if matcher.places_exactly:
        return found.take(some)
    return refined(Layers(first.pixels[None], first.known), Layers(second.pixels[None],
                   second.known), found.first[some], found.second[some])


def _count(parts: list[Matches]) -> int:
    return sum(len(part.score) for part in parts)


def _apart(matches: Matches) -> Matches:
    """Return the matches with the best scores that are apart, at most those wanted in a cell."""
    best: list[int] = []
    for i in np.argsort(-matches.score, kind="stable"):
        if len(best) < _EACH and all(
                min(np.linalg.norm(matches.first[i] - matches.first[j]),
                    np.linalg.norm(matches.second[i] - matches.second[j])) >= _APART
                for j in best):
            best.append(int(i))
    return matches.take(np.array(best, dtype=np.intp))


def _points(of_cells: list[Matches], reference: Reference) -> Points:
    """Return the pairs as points, those with a height if there is a DEM."""
    none = np.empty((0, 2))
    image, other, sigma = (np.concatenate([none, *(getattr(pairs, name) for pairs in of_cells)])
                           for name in ("first", "second", "sigma"))
    score = np.concatenate([np.empty(0), *(pairs.score for pairs in of_cells)])
    ground = reference.ground(other)
    kept = np.isfinite(ground[:, 2]) if callable(reference.map_heights) \
        else np.ones(len(ground), dtype=bool)
    ids = tuple(f"M{i + 1:03d}" for i in range(int(kept.sum())))
    shown = np.array([f"{value:.3f}" for value in score[kept]], dtype=object)
    return Points(ids, image[kept], ground[kept], sigma[kept], attributes={"score": shown})


def _why(cells: dict[str, int], search: float, dem: Path | str | None) -> str:
    """Return what to do where there are too few candidates."""
    total = sum(cells.values())
    worst = max((name for name in cells if name != FOUND), key=cells.__getitem__, default=UNLIKE)
    where = f"{cells.get(worst, 0)} of {total} cells"
    heights = " or heights" if dem is not None else ""
    return {
        NO_DATA: f"In {where} the image has no data.",
        OUTSIDE: f"For {where} there is no reference{heights}. Give larger ones.",
        NO_TEXTURE: f"In {where} there is no texture, as on sea or in clouds.",
        UNLIKE: f"In {where} nothing looks alike. Are there clouds or sea, or another band? Is "
                f"the start off by more than --search {search:g} px?"}[worst]
