"""An image looked at cell by cell, so that matches are spread over it."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from time import monotonic

import numpy as np
from numpy.typing import NDArray

from termsel_match.images.rasters import GreyRaster, stretched
from termsel_match.images.warps import Reference
from termsel_match.matchers import Matcher, Matches, Window
from termsel_match.matchers.refinement import Layers, refined

log = logging.getLogger("termsel.match")

_EACH = 3  # candidates wanted in a cell
_TRIED = 8  # keypoints of a cell that are refined
_APART = 12.0  # px, reduced, between candidates
_WINDOW = 480  # px, reduced: the largest block of cells that is looked at once
_PART = 256  # px, reduced: of a cell that is larger, the part that is looked at once
_BORDER = 24  # px, reduced, around a window, where keypoints have no descriptor
_TRIES = ((0.5, 0.5), (0.0, 0.0), (1.0, 1.0), (0.0, 1.0), (1.0, 0.0))  # where in such a cell

FOUND, NO_DATA, OUTSIDE, NO_TEXTURE, UNLIKE, NO_TIME = (
    "found", "no data", "outside", "no texture", "unlike", "no time")


@dataclass(frozen=True, eq=False)
class Looking:
    """How a picture is looked at.

    Parameters
    ----------
    matcher : Matcher
    search : float
        Largest distance from the start [px].
    count : int
        Matches wanted in the whole image.
    until : float, optional
        When to end, by `time.monotonic` [s].
    progress : callable, optional
        Called with the fraction that is done, 0 to 1.
    """

    matcher: Matcher
    search: float
    count: int
    until: float | None = None
    progress: Callable[[float], None] | None = None

    @property
    def is_over(self) -> bool:
        """Whether the time is over."""
        return self.until is not None and monotonic() > self.until


Area = tuple[int, int, int, int]
"""Line and sample of the first pixel, lines and samples."""


def in_cells(picture: GreyRaster, reference: Reference, looking: Looking, area: Area | None = None,
             ) -> tuple[Matches, Counter[str]]:
    """Return matches, first in the image and second in the reference [px], and how cells ended.

    Parameters
    ----------
    picture : GreyRaster
    reference : Reference
    looking : Looking
    area : tuple of int, optional
        Of the image, to look at; by default all of it.
    """
    step = reference.reduction(picture.size)
    if step > 1:
        log.info("Note: the image is matched at 1/%d of its resolution, that of the reference.",
                 step)
    top, left, *sides = area or (0, 0, *picture.size)
    share = sides[0] * sides[1] / (picture.size[0] * picture.size[1])
    across = max(2 if area is None else 1, round((share * looking.count / _EACH) ** 0.5))
    blocks = min(across, -(-max(sides) // (_WINDOW * step)))
    inner = -(-across // blocks)  # several small cells are looked at together
    all_blocks = list(product(range(blocks), range(blocks)))
    order = np.arange(len(all_blocks))
    if looking.until is not None:  # what there is no time for is all over the image
        order = np.random.default_rng(0).permutation(order)
    of_cells: dict[int, list[Matches]] = {}
    ends = Counter[str]()
    for done, number in enumerate(order.tolist()):
        if looking.is_over:
            ends[NO_TIME] += inner**2 * (len(order) - done)
            break
        parts: list[Matches] = []
        for window in _windows((sides[0], sides[1]), blocks, all_blocks[number], step):
            here = (window[0] + top, window[1] + left, *window[2:])
            more, end = _in_window(picture, reference, looking, here, inner, step)
            parts = max(parts, more, key=_count)
            if _count(parts) >= _EACH:
                break
        of_cells[number] = parts
        ends[FOUND] += len(parts)
        ends[end] += inner**2 - len(parts)
        if looking.progress is not None:
            looking.progress((done + 1) / blocks**2)
    return joined([part for number in sorted(of_cells) for part in of_cells[number]]), ends


def joined(parts: list[Matches]) -> Matches:
    """Return all matches of several parts, which have standard deviations."""
    none = np.empty((0, 2))
    first, second, sigma = (np.concatenate([none, *(getattr(part, name) for part in parts)])
                            for name in ("first", "second", "sigma"))
    return Matches(first, second, np.concatenate([np.empty(0), *(part.score for part in parts)]),
                   sigma)


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


def _in_window(picture: GreyRaster, reference: Reference, looking: Looking, window: Area,
               inner: int, step: int) -> tuple[list[Matches], str]:
    """Return the best matches of each cell of a window, in px of image and reference.

    And why the other cells have none.
    """
    (top, left, lines, samples) = window
    search = looking.search / step
    border = _BORDER * step
    reach = (_BORDER + int(np.ceil(search))) * step
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
    first = Window(*own)
    second = Window(patch.pixels, patch.known, (-moved, -moved))
    found = looking.matcher.match(first, second, search)
    if not len(found.first):
        return [], UNLIKE
    sides = np.array(own[0].shape) - 2 * _BORDER
    cell = np.floor((found.first - _BORDER) / sides * inner).astype(int)
    away = np.linalg.norm(found.second - moved - found.first, axis=1)
    used = ((cell >= 0) & (cell < inner)).all(axis=1) & (away <= search)
    parts = []
    for wanted in product(range(inner), repeat=2):
        some = np.flatnonzero(used & (cell == wanted).all(axis=1))[:_TRIED]
        matches = _apart(_placed(looking.matcher, found, some, first, second))
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
