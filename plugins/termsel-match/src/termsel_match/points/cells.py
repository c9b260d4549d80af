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

_EACH = 3
"""Number of matches wanted in a cell."""

_TRIED = 8
"""Most matches of a cell that are refined to sub-pixel."""

_MATCH_DISTANCE = 12.0
"""Least distance of matches from each other, in both images [reduced px]."""

_WINDOW = 480
"""Longest side of a block of cells that is matched as one window [reduced px]."""

_PART = 256
"""Longest side of a window in a larger block [reduced px]."""

_BORDER = 24
"""Width of the rim of a window in which keypoints have no descriptor [reduced px]."""

_WINDOW_PLACES = ((0.5, 0.5), (0.0, 0.0), (1.0, 1.0), (0.0, 1.0), (1.0, 0.0))
"""Positions of such windows in a larger block, tried in turn: which shares of the free lines and
samples come before them. The first is in the middle."""

FOUND, NO_DATA, OUTSIDE, NO_TEXTURE, UNLIKE, NO_TIME = (
    "found", "no data", "outside", "no texture", "unlike", "no time")
"""How a cell may end: with matches, or the reason why it has none."""


@dataclass(frozen=True, eq=False)
class Looking:
    """How an image is searched for matches.

    Parameters
    ----------
    matcher : Matcher
        The method that finds places that look alike.
    search : float
        Largest distance of a match from the start [px].
    count : int
        Number of matches wanted in the whole image.
    until : float, optional
        When to stop, as `time.monotonic` counts [s].
    progress : callable, optional
        Called with the share that is done, 0 to 1.
    """

    matcher: Matcher
    search: float
    count: int
    until: float | None = None
    progress: Callable[[float], None] | None = None

    @property
    def is_over(self) -> bool:
        """Whether the time for the search is over."""
        return self.until is not None and monotonic() > self.until


Area = tuple[int, int, int, int]
"""First line, first sample, number of lines and number of samples of an area [px]."""


def match_cells(picture: GreyRaster, reference: Reference, looking: Looking,
                area: Area | None = None) -> tuple[Matches, Counter[str]]:
    """Return the matches of an image, searched cell by cell, and how many cells ended how.

    Parameters
    ----------
    picture : GreyRaster
        The image.
    reference : Reference
        What it is matched with, and where it is to be looked for.
    looking : Looking
        How it is searched.
    area : tuple of int, optional
        The part of the image that is searched; by default all of it.

    Returns
    -------
    matches : Matches
        First positions are in the image, second ones in the reference [px].
    ends : Counter
        Number of cells by how they ended: "found", or why they have no matches.
    """
    step = reference.reduction(picture.size)
    if step > 1:
        log.info("Note: the image is matched at 1/%d of its resolution, that of the reference.",
                 step)
    first_line, first_sample, *extents = area or (0, 0, *picture.size)
    share = extents[0] * extents[1] / (picture.size[0] * picture.size[1])
    # As many cells, along either side, as give the wanted matches at three in each. Small cells are
    # matched together, as a block that is not larger than a window.
    across = max(2 if area is None else 1, round((share * looking.count / _EACH) ** 0.5))
    blocks = min(across, -(-max(extents) // (_WINDOW * step)))
    inner = -(-across // blocks)
    all_blocks = list(product(range(blocks), range(blocks)))
    order = np.arange(len(all_blocks))
    # In random order, what is left when the time is over is spread over the image.
    if looking.until is not None:
        order = np.random.default_rng(0).permutation(order)
    of_cells: dict[int, list[Matches]] = {}
    ends = Counter[str]()
    for done, number in enumerate(order.tolist()):
        if looking.is_over:
            ends[NO_TIME] += inner**2 * (len(order) - done)
            break
        matches_of_cells: list[Matches] = []
        # Of a large block several windows are tried, until one has enough matches.
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
    """Return several sets of matches as one, which is empty if there are none.

    All of them have standard deviations.
    """
    none = np.empty((0, 2))
    first = np.concatenate([none, *(matches.first for matches in several)])
    second = np.concatenate([none, *(matches.second for matches in several)])
    sigma = np.concatenate([none, *(matches.sigma for matches in several
                                    if matches.sigma is not None)])
    score = np.concatenate([np.empty(0), *(matches.score for matches in several)])
    return Matches(first, second, score, sigma)


def _windows_of_block(size: tuple[int, int], across: int, block: tuple[int, int], step: int,
                      ) -> list[tuple[int, int, int, int]]:
    """Return the windows of a block of the image, in the order in which they are tried.

    `size` has the lines and samples of all blocks, of which there are `across` in either direction;
    `block` is the row and the column of this one. Each window is its first line and sample and its
    lines and samples [px]. A small block is one window.
    """
    # Edges are rounded as a whole, so that the blocks of uneven sizes leave no pixel out.
    low = [total * i // across for total, i in zip(size, block, strict=True)]
    extents = [total * (i + 1) // across - start
               for total, i, start in zip(size, block, low, strict=True)]
    largest = (_WINDOW if max(extents) <= _WINDOW * step else _PART) * step
    window_size = [min(extent, largest) for extent in extents]
    windows = []
    # Shares of what a window leaves of the block: where its first line and sample may be.
    for share in _WINDOW_PLACES if extents != window_size else _WINDOW_PLACES[:1]:
        first_line, first_sample = (
            start + int((extent - window_extent) * fraction)
            for start, extent, window_extent, fraction in zip(
                low, extents, window_size, share, strict=True))
        windows.append((first_line, first_sample, window_size[0], window_size[1]))
    return windows


def _best_in_window(picture: GreyRaster, reference: Reference, looking: Looking, window: Area,
                    inner: int, step: int) -> tuple[list[Matches], str]:
    """Return the best matches of each cell of a window that has some, and why others have none.

    The window has `inner` cells in either direction, and is matched with pixels of `step` px of the
    image. Matches are in px of the image and of the reference.
    """
    (first_line, first_sample, lines, samples) = window
    search = looking.search / step
    # The window of the reference is wider by the search: a match may be as far from the start.
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
    # The first pixel of the reference's window is so many reduced pixels before that of the image.
    moved = (reach - border) // step
    first = Window(*grey)
    second = Window(patch.pixels, patch.known, (-moved, -moved))
    matches = looking.matcher.match(first, second, search)
    if not len(matches.first):
        return [], UNLIKE
    inner_size = np.array(grey[0].shape) - 2 * _BORDER
    # Row and column of each match's cell; those in the border are beyond all cells.
    cell = np.floor((matches.first - _BORDER) / inner_size * inner).astype(int)
    distances = np.linalg.norm(matches.second - moved - matches.first, axis=1)
    used = ((cell >= 0) & (cell < inner)).all(axis=1) & (distances <= search)
    of_cells = []
    for number in product(range(inner), repeat=2):
        in_cell = np.flatnonzero(used & (cell == number).all(axis=1))[:_TRIED]
        best = _best_spread_matches(
            _place_matches(looking.matcher, matches, in_cell, first, second))
        if best.sigma is not None and len(best.score):
            # From reduced pixels of the windows to pixels of the image and of the reference.
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
    return refine_matches(Layers(first.pixels[None], first.known),
                          Layers(second.pixels[None], second.known),
                          matches.first[numbers], matches.second[numbers])


def _count_matches(several: list[Matches]) -> int:
    """Return the number of matches in all parts."""
    return sum(len(matches.score) for matches in several)


def _best_spread_matches(matches: Matches) -> Matches:
    """Return at most three matches with the best scores, 12 px or more apart in both images."""
    best: list[int] = []
    # A match near a better one says nothing new.
    for i in np.argsort(-matches.score, kind="stable"):
        if len(best) < _EACH and all(
                min(np.linalg.norm(matches.first[i] - matches.first[j]),
                    np.linalg.norm(matches.second[i] - matches.second[j])) >= _MATCH_DISTANCE
                for j in best):
            best.append(int(i))
    return matches.take(np.array(best, dtype=np.intp))
