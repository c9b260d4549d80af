"""What every matcher must do: the checks that `termsel.testing.checks` runs for one."""

from __future__ import annotations

import cv2
import numpy as np

from termsel.toolkit.suites import (
    Case,
    Suite,
    declaration_check,
    label_with_options,
    make_instance,
    require,
    require_unchanged,
    through_pickle,
)
from termsel_match.matchers import Matcher, Matches, Window, fault_of_matches

SEARCH = 20.0
# Px of the first window, and of the second around it.
_WINDOW_SIDE, _WINDOW_BORDER = 160, 24
# How much further down and to the left the second shows the ground [px].
_TRUE_SHIFT = (7.0, -5.0)
# Distance from its true position up to which a match is right [px].
_NEAR = 2.0
_MIN_RIGHT = 8
# Least share of the matches that must be right.
_RIGHT_SHARE = 0.5
_SEEDS = 3


def declaration(matcher: Matcher) -> None:
    """It has a name and a docstring; its options are documented and parse."""
    declaration_check("matchers")(matcher)


def finds_a_shift(matcher: Matcher) -> None:
    """At least half of the matches of two windows that differ by noise and a shift are right."""
    for seed in range(_SEEDS):
        first, second = _window_pair(seed)
        matches = _valid_matches(matcher, first, second)
        # Errors [px]: where the second shows what the first has, less the shift that was made.
        errors = matches.second + second.origin - matches.first - first.origin - _TRUE_SHIFT
        right = np.linalg.norm(errors, axis=1) < _NEAR
        require(right.sum() >= _MIN_RIGHT and right.mean() >= _RIGHT_SHARE,
                f"of {len(right)} matches of two alike windows {int(right.sum())} are right; "
                f"expected {_MIN_RIGHT} and more, and at least half")


def stays_within_the_windows(matcher: Matcher) -> None:
    """Matches are within both windows, and not where a window has no data."""
    first, second = _window_pair(0)
    is_known = first.known.copy()
    is_known[:, :_WINDOW_SIDE // 2] = False
    matches = _valid_matches(matcher, Window(first.pixels, is_known, first.origin), second)
    for positions, window, name in ((matches.first, Window(first.pixels, is_known), "first"),
                                    (matches.second, second, "second")):
        pixels = np.round(positions).astype(int)
        require(((pixels >= 0) & (pixels < window.known.shape)).all(),
                f"places are beyond the {name} window")
        require(window.known[tuple(pixels.T)].all(), f"places of the {name} window have no data")


def nothing_where_nothing_is(matcher: Matcher) -> None:
    """Windows without texture or data give no fault, and those without data no match."""
    first, second = _window_pair(0)
    flat = Window(np.full_like(first.pixels, 100), first.known, first.origin)
    empty = Window(first.pixels, np.zeros_like(first.known), first.origin)
    _valid_matches(matcher, flat, second)
    _valid_matches(matcher, flat,
                   Window(np.full_like(second.pixels, 7), second.known, second.origin))
    n_matches = len(_valid_matches(matcher, empty, second).first)
    require(n_matches == 0, f"a window without data has {n_matches} matches")


def small_windows(matcher: Matcher) -> None:
    """Windows of a few pixels, as at the edge of an image, give no fault."""
    first, second = _window_pair(0)
    for extent in (1, 5, 30):
        _valid_matches(matcher,
                       Window(first.pixels[:extent, :extent], first.known[:extent, :extent]),
                       Window(second.pixels[:extent, :2 * extent],
                              second.known[:extent, :2 * extent]))


def repeats(matcher: Matcher) -> None:
    """The same windows give the same matches again, in another process too."""
    first, second = _window_pair(0)
    once = _valid_matches(matcher, first, second)
    for same_matcher in (matcher, through_pickle(matcher)):
        repeated = _valid_matches(same_matcher, first, second)
        require(np.array_equal(once.first, repeated.first)
                and np.array_equal(once.second, repeated.second),
                "match() of the same windows differs from one call or process to the next")


def leaves_windows(matcher: Matcher) -> None:
    """It does not change the arrays it is given."""
    first, second = _window_pair(0)
    arrays = {"first.pixels": first.pixels, "first.known": first.known,
              "second.pixels": second.pixels, "second.known": second.known}
    require_unchanged(arrays, "match", lambda: matcher.match(first, second, SEARCH))


def cases(thing: type[Matcher] | Matcher) -> list[Case]:
    """Return the one case of a matcher: with its options, or the defaults of a class."""
    return [Case(label_with_options(thing, {}), lambda: make_instance(thing))]


SUITE = Suite((declaration, finds_a_shift, stays_within_the_windows, nothing_where_nothing_is,
               small_windows, repeats, leaves_windows), cases)


def _valid_matches(matcher: Matcher, first: Window, second: Window) -> Matches:
    """Return what a matcher finds in two windows, once it is known to be valid."""
    matches = matcher.match(first, second, SEARCH)
    problem = fault_of_matches(matcher, matches)
    require(problem is None, f"match() {problem}")
    return matches


def _window_pair(seed: int) -> tuple[Window, Window]:
    """Return two windows of the same simulated ground, each with noise of its own.

    The second is larger by a border on all sides, and shows the ground shifted by `_TRUE_SHIFT`
    (line, sample) [px].
    """
    rng = np.random.default_rng(seed)
    extent = _WINDOW_SIDE + 2 * (_WINDOW_BORDER + 16)
    ground = cv2.GaussianBlur(rng.normal(0, 60, (extent, extent)).astype(np.float32), (0, 0), 2.0)
    for _ in range(60):
        first_line, first_sample = rng.integers(0, extent - 8, 2).tolist()
        high, wide = rng.integers(6, 30, 2).tolist()
        ground[first_line:first_line + high,
               first_sample:first_sample + wide] += float(rng.normal(0, 40))
    ground = cv2.GaussianBlur(ground, (0, 0), 0.8) + 500

    def seen(corner: tuple[int, int], size: int) -> Window:
        """Return a square window, `size` px wide, with its first line and sample at a corner."""
        first_line, first_sample = corner
        pixels = (ground[first_line:first_line + size, first_sample:first_sample + size]
                  + rng.normal(0, 2, (size, size)).astype(np.float32))
        return Window(pixels.astype(np.float32), np.ones((size, size), dtype=bool))

    inner = _WINDOW_BORDER + 16
    first = seen((inner, inner), _WINDOW_SIDE)
    # What is at p in the first is at p + border + shift in the second.
    second = seen((16 - int(_TRUE_SHIFT[0]), 16 - int(_TRUE_SHIFT[1])),
                  _WINDOW_SIDE + 2 * _WINDOW_BORDER)
    return first, Window(second.pixels, second.known,
                         (-float(_WINDOW_BORDER), -float(_WINDOW_BORDER)))
