"""Tie points: places that two raw images or more show."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from time import monotonic

import numpy as np
from numpy.typing import NDArray

from termsel import TermselError, get, open_dem
from termsel.toolkit import csv_table, write_text
from termsel_match.images.masks import open_masked, warn_of_idle_masks
from termsel_match.images.rasters import FloatArray, spread_pixels
from termsel_match.images.starts import Start, start_of, transform_plane
from termsel_match.images.warps import COVERS, Reference
from termsel_match.matchers import Matcher
from termsel_match.points.calibration import smooth_part
from termsel_match.points.cells import Looking, match_cells

log = logging.getLogger("termsel.match")


@dataclass(frozen=True, eq=False)
class RawReference(Reference):
    """A raw image, seen by the start of another one."""

    own_start: Start

    def seen(self, image: FloatArray) -> FloatArray:
        """Return where places of the other image, (n, 2), are in this one; NaN for none."""
        ground = self.start.locate(image, self.heights)
        plane = transform_plane(ground[:, :2], self.start.crs, self.own_start.crs)
        positions = np.array(self.own_start.project(np.column_stack([plane, ground[:, 2]])))
        positions[~np.isfinite(positions).all(axis=1)] = np.nan
        return positions


@dataclass(frozen=True)
class PairOfImages:
    """What came of two images.

    Parameters
    ----------
    first, second : str
    n_matches, agree : int
        Matches, and those that agree with their neighbours, which are ties.
    """

    first: str
    second: str
    n_matches: int
    agree: int


@dataclass(frozen=True, eq=False)
class MatchedTies:
    """Ties between images.

    Parameters
    ----------
    rows : tuple of (str, str, float, float)
        Name of the tie and of the image, line and sample [px].
    pairs : tuple of PairOfImages
    """

    rows: tuple[tuple[str, str, float, float], ...]
    pairs: tuple[PairOfImages, ...]

    @property
    def count(self) -> int:
        """Number of ties."""
        return len({row[0] for row in self.rows})

    def write(self, path: Path | str) -> None:
        """Write a table id,image,line,sample, as `termsel block` reads it."""
        rows = [(name, image, f"{line:.3f}", f"{sample:.3f}")
                for name, image, line, sample in self.rows]
        write_text(Path(path), csv_table([("id", "image", "line", "sample"), *rows]))

    def text(self) -> str:
        """Return a table of the pairs of images, with the number of ties, as text."""
        names = [pair.first for pair in self.pairs] + [pair.second for pair in self.pairs]
        wide = max(map(len, names))
        lines = [f"{'image':{wide}}  {'image':{wide}}  matches  ties"]
        lines += [f"{pair.first:{wide}}  {pair.second:{wide}}  {pair.n_matches:7d}  {pair.agree:4d}"
                  for pair in self.pairs]
        several = len(self.rows) - 2 * self.count
        return "\n".join([*lines, f"{self.count} ties; {several} more measurements in third "
                                  "images"]) + "\n"


def match_ties(
    images: Sequence[Path | str],
    *,
    dem: Path | str,
    search: float = 100.0,
    count: int = 200,
    band: int | None = None,
    matcher: str | Matcher | None = None,
    seconds: float | None = None,
    masks: Sequence[Path | str] = (),
    progress: Callable[[float], None] | None = None,
) -> MatchedTies:
    """Return places that two raw images or more show.

    Of each pair, the second image is resampled as the first would see it, by the rough geometry of
    both and the heights. Matches that agree with their neighbours are ties. A tie of one place of
    an image with two others is one tie in three images.

    Parameters
    ----------
    images : sequence of path-like
        Two or more, each with an RPC, or another start that it states itself.
    dem : path-like
        Raster of heights of the area.
    search : float
        Largest distance of a match from where both geometries see it [px].
    count : int
        Ties wanted in each pair.
    band, matcher, seconds, masks, progress
        As for `match_points`.

    Raises
    ------
    TermselError
        If an image cannot be read or has no geometry, two have one name, or no pair has ties.
    """
    paths = [Path(image) for image in images]
    names = [path.stem for path in paths]
    if len(paths) < 2:
        raise TermselError("one image has no ties", hint="Give two images or more.")
    for name in names:
        if names.count(name) > 1:
            raise TermselError(f"two images are called {name!r}",
                               hint="Give files of different names, as a table of ties has them.")
    starts = [_start(path) for path in paths]
    starts[0].warn_if_dem_contradicts(dem)
    warn_of_idle_masks(masks, paths, [])
    matcher_class = get("matchers", matcher or "sift")
    until = None if seconds is None else monotonic() + seconds
    all_pairs = list(combinations(range(len(paths)), 2))
    ties = _Ties(names)
    pairs = []
    any_overlap = False
    for done, (i, j) in enumerate(all_pairs):
        def tell(share: float, done: int = done) -> None:
            """Report the share of all pairs that is done, from that of the present pair."""
            if progress is not None:
                progress((done + share) / len(all_pairs))

        looking = Looking(matcher_class() if isinstance(matcher_class, type) else matcher_class,
                          search, count, until, tell)
        with (open_masked(paths[i], band, masks) as picture,
              _open_reference(paths[j], starts[j], starts[i], dem, band, masks) as seen_image):
            in_second = seen_image.seen(spread_pixels(picture.size, (COVERS, COVERS)))
            any_overlap |= bool(np.isfinite(in_second).any())
            if not _is_any_inside(seen_image, in_second):
                pairs.append(PairOfImages(names[i], names[j], 0, 0))
                continue
            matches = match_cells(picture, seen_image, looking)[0]
            moved = matches.second - seen_image.seen(matches.first)
        agree = _agreeing(matches.first, moved)
        pairs.append(PairOfImages(names[i], names[j], len(moved), len(agree)))
        ties.add(i, matches.first[agree], j, matches.second[agree])
    if not any_overlap:
        raise TermselError("this raster has no heights where the images are", file=Path(dem),
                           hint="Give heights of the area by --dem.")
    rows = ties.rows()
    if not rows:
        raise _no_ties_error(paths[0], is_time_over=until is not None and monotonic() > until)
    _warn_of_untied(names, rows)
    return MatchedTies(tuple(rows), tuple(pairs))


class _Ties:
    """Places of images, each with its matches in later ones: all of these are one tie."""

    def __init__(self, names: Sequence[str]) -> None:
        """Begin without ties between the images of these names."""
        self._names = names
        # Image, line and sample of a keypoint, and the same of its matches.
        self._matches: dict[tuple[int, float, float], list[tuple[int, float, float]]] = {}

    def add(self, i: int, in_first: FloatArray, j: int, in_second: FloatArray) -> None:
        """Add the matches of two images: positions (n, 2) in image i and in the later image j."""
        for first, second in zip(in_first.tolist(), in_second.tolist(), strict=True):
            self._matches.setdefault((i, first[0], first[1]), []).append((j, second[0], second[1]))

    def rows(self) -> list[tuple[str, str, float, float]]:
        """Return a row for each image of each tie: names of tie and image, line and sample [px]."""
        rows = []
        for number, (first, further) in enumerate(self._matches.items(), 1):
            rows += [(f"T{number:04d}", self._names[image], line, sample)
                     for image, line, sample in (first, *further)]
        return rows


def _agreeing(positions: FloatArray, moved: FloatArray) -> NDArray[np.intp]:
    """Return the indices of the matches that agree with a smooth surface of displacements.

    Those of a true pair of images do. `positions` and `moved` are (n, 2) [px], and NaN where a
    match has no displacement. None agrees where there is no such surface.
    """
    finite = np.flatnonzero(np.isfinite(moved).all(axis=1))
    smooth = smooth_part(positions[finite], moved[finite])
    return finite[smooth[1]] if smooth is not None else finite[:0]


def _no_ties_error(first_image: Path, *, is_time_over: bool) -> TermselError:
    """Return the error for images without a tie, by whether there was no time left."""
    hint = ("Do they show the same ground? Give a larger --search, another --matcher, or the "
            "right --dem.")
    if is_time_over:
        hint = "There was no time. Give more --seconds."
    return TermselError("no ties were found between any two of the images", file=first_image,
                        hint=hint)


def _warn_of_untied(names: Sequence[str], rows: Sequence[tuple[str, str, float, float]]) -> None:
    """Log a warning for each image that is in no row of the ties."""
    tied = {row[1] for row in rows}
    for name in names:
        if name not in tied:
            log.warning("Warning: image %s has no tie with any other. Does it show the same "
                        "ground? Try --matcher structure, which other light and other sensors do "
                        "not disturb, or a larger --search, or leave the image out of the block.",
                        name)


def _start(path: Path) -> Start:
    """Return the start of a raw image by its RPC; raises TermselError if it has none."""
    start = start_of(None, path)
    if start is None:
        raise TermselError("this image has no RPC, so it is not known where it looks", file=path,
                           hint=f"Put its RPC beside it: {path.with_suffix('.RPB').name} or "
                                f"{path.stem}_RPC.TXT.")
    return start


@contextmanager
def _open_reference(path: Path, own_start: Start, start: Start, dem: Path | str, band: int | None,
                    masks: Sequence[Path | str]) -> Iterator[RawReference]:
    """Open an image as the reference of another one, whose start is `start`."""
    with open_masked(path, band, masks) as picture, open_dem(Path(dem), start.crs) as heights:
        yield RawReference(picture, own_start.crs, start, heights, own_start.height, to_map=None,
                           own_start=own_start)


def _is_any_inside(seen_image: RawReference, positions: FloatArray) -> bool:
    """Return whether any of the positions (n, 2) lies in an image; NaN is no position."""
    last = np.array(seen_image.picture.size) - 1
    # Comparisons with nan are false: what has no position is not inside.
    with np.errstate(invalid="ignore"):
        inside = ((positions >= 0) & (positions <= last)).all(axis=1)
    return bool(inside.any())
