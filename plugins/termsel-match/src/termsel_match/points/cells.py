"""An image looked at cell by cell, so that matches are spread over it."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain, product
from time import monotonic

import numpy as np
from numpy.typing import NDArray

from termsel_match.images.rasters import GreyRaster, stretch_to_bytes
from termsel_match.images.warps import Reference
from termsel_match.matchers import Matcher, Matches, Window
from termsel_match.matchers.refinement import Layers, refine_matches

log = logging.getLogger("termsel.match")

# Candidates wanted in a cell.
_EACH = 3
# Keypoints of a cell that are refined.
_TRIED = 8
# In px, reduced, between candidates.
_MATCH_DISTANCE = 12.0
# In px, reduced: the largest block of cells that is looked at once.
_WINDOW = 480
# In px, reduced: of a cell that is larger, the part that is looked at once.
_PART = 256
# In px, reduced, around a window, where keypoints have no descriptor.
_BORDER = 24
# Where in such a cell.
_WINDOW_PLACES = ((0.5, 0.5), (0.0, 0.0), (1.0, 1.0), (0.0, 1.0), (1.0, 0.0))

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


def match_cells(picture: GreyRaster, reference: Reference, looking: Looking,
                area: Area | None = None) -> tuple[Matches, Counter[str]]:
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
    first_line, first_sample, *extents = area or (0, 0, *picture.size)
    share = extents[0] * extents[1] / (picture.size[0] * picture.size[1])
    # As many cells as wanted matches, a few each; blocks of them are not larger than a window.
    across = max(2 if area is None else 1, round((share * looking.count / _EACH) ** 0.5))
    blocks = min(across, -(-max(extents) // (_WINDOW * step)))
    # Several small cells are looked at together.
    inner = -(-across // blocks)
    all_blocks = list(product(range(blocks), range(blocks)))
    order = np.arange(len(all_blocks))
    # What there is no time for is all over the image.
    if looking.until is not None:
        order = np.random.default_rng(0).permutation(order)
    of_cells: dict[int, list[Matches]] = {}
    ends = Counter[str]()
    for done, number in enumerate(order.tolist()):
        if looking.is_over:
            ends[NO_TIME] += inner**2 * (len(order) - done)
            break
        matches_of_cells: list[Matches] = []
        # A large block is looked at in several places, until one has enough.
        for window in _windows_of_block((extents[0], extents[1]), blocks, all_blocks[number], step):
            in_image = (window[0] + first_line, window[1] + first_sample, *window[2:])
            matches, end = _best_in_window(picture, reference, looking, in_image, inner, step)
            matches_of_cells = max(matches_of_cells, matches, key=_count_matches)
            if _count_matches(matches_of_cells) >= _EACH:
                break
        of_cells[number] = matches_of_cells
        ends[FOUND] += len(matches_of_cells)
        ends[end] += inner**2 - len(matches_of_cells)
        if looking.progress is not None:
            looking.progress((done + 1) / blocks**2)
    in_order = chain.from_iterable(of_cells[number] for number in sorted(of_cells))
    return join_matches(list(in_order)), ends


def join_matches(several: list[Matches]) -> Matches:
    """Return the matches of several parts as one; all have standard deviations. Empty for []."""
    none = np.empty((0, 2))
    first = np.concatenate([none, *(matches.first for matches in several)])
    second = np.concatenate([none, *(matches.second for matches in several)])
    sigma = np.concatenate([none, *(matches.sigma for matches in several
                                    if matches.sigma is not None)])
    score = np.concatenate([np.empty(0), *(matches.score for matches in several)])
    return Matches(first, second, score, sigma)


def _windows_of_block(size: tuple[int, int], across: int, block: tuple[int, int], step: int,
                      ) -> list[tuple[int, int, int, int]]:
    """Return first line and sample, lines and samples [px] of the windows of a block, in turn.

    `block` is its row and column of `across` in either direction; one window if it is small.
    """
    low = [total * i // across for total, i in zip(size, block, strict=True)]
    extents = [total * (i + 1) // across - start
               for total, i, start in zip(size, block, low, strict=True)]
    largest = (_WINDOW if max(extents) <= _WINDOW * step else _PART) * step
    window_size = [min(extent, largest) for extent in extents]
    windows = []
    for share in _WINDOW_PLACES if extents != window_size else _WINDOW_PLACES[:1]:
        # Along either axis, a share of what the window leaves free comes before it.
        first_line, first_sample = (
            start + int((extent - window_extent) * fraction)
            for start, extent, window_extent, fraction in zip(
                low, extents, window_size, share, strict=True))
        windows.append((first_line, first_sample, window_size[0], window_size[1]))
    return windows


def _best_in_window(picture: GreyRaster, reference: Reference, looking: Looking, window: Area,
                    inner: int, step: int) -> tuple[list[Matches], str]:
    """Return the best matches of each cell of a window, in px of image and reference.

    And why the other cells have none.
    """
    (first_line, first_sample, lines, samples) = window
    search = looking.search / step
    # The window of the reference is larger by the search, in which a match may be.
    border = _BORDER * step
    reach = (_BORDER + int(np.ceil(search))) * step
    grey = picture.read(first_line - border, first_sample - border, lines + 2 * border,
                        samples + 2 * border, step)
    if not grey[1].any():
        return [], NO_DATA
    if stretch_to_bytes(*grey) is None:
        return [], NO_TEXTURE
    shape = (lines + 2 * reach) // step, (samples + 2 * reach) // step
    patch = reference.patch(first_line - reach, first_sample - reach, shape, step)
    if not patch.known.any():
        return [], OUTSIDE
    # Between the origins of the two.
    moved = (reach - border) // step
    first = Window(*grey)
    second = Window(patch.pixels, patch.known, (-moved, -moved))
    matches = looking.matcher.match(first, second, search)
    if not len(matches.first):
        return [], UNLIKE
    inner_size = np.array(grey[0].shape) - 2 * _BORDER
    # Which cell each match is in; those in the border are of no cell.
    cell = np.floor((matches.first - _BORDER) / inner_size * inner).astype(int)
    away = np.linalg.norm(matches.second - moved - matches.first, axis=1)
    used = ((cell >= 0) & (cell < inner)).all(axis=1) & (away <= search)
    of_cells = []
    for number in product(range(inner), repeat=2):
        in_cell = np.flatnonzero(used & (cell == number).all(axis=1))[:_TRIED]
        best = _best_spread_matches(
            _place_matches(looking.matcher, matches, in_cell, first, second))
        if best.sigma is not None and len(best.score):
            # From reduced pixels of the window to pixels of the image, and to those of the
            # reference.
            of_cells.append(Matches((best.first + 0.5) * step - 0.5
                                    + [first_line - border, first_sample - border],
                                    patch.in_reference(best.second), best.score,
                                    best.sigma * step))
    return of_cells, UNLIKE


def _place_matches(matcher: Matcher, matches: Matches, numbers: NDArray[np.intp], first: Window,
                   second: Window) -> Matches:
    """Return the matches of these numbers, refined to sub-pixel unless the matcher has done that.
    """
    if matcher.places_exactly:
        return matches.take(numbers)
    return refine_matches(Layers(first.pixels[None], first.known), Layers(second.pixels[None],
                   second.known), matches.first[numbers], matches.second[numbers])


def _count_matches(several: list[Matches]) -> int:
    """Return the number of matches in all parts."""
    return sum(len(matches.score) for matches in several)


def _best_spread_matches(matches: Matches) -> Matches:
    """Return the matches with the best scores that are apart in both images, at most `_EACH`."""
    best: list[int] = []
    # From the best on; a match too near to a better one says the same again.
    for i in np.argsort(-matches.score, kind="stable"):
        if len(best) < _EACH and all(
                min(np.linalg.norm(matches.first[i] - matches.first[j]),
                    np.linalg.norm(matches.second[i] - matches.second[j])) >= _MATCH_DISTANCE
                for j in best):
            best.append(int(i))
    return matches.take(np.array(best, dtype=np.intp))
