"""Matches of the Ames Stereo Pipeline, binary and as text: public, for other packages, too."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from struct import Struct

import numpy as np

from termsel import FeatureSet, Reader, TermselError
from termsel.toolkit import read_text
from termsel_match.images.rasters import FloatArray
from termsel_match.points.readers import (
    RASTER_OPTION,
    REFERENCE,
    are_in_image,
    bytes_of,
    with_ground,
)

__all__ = ["AspMatches", "is_matches", "read_matches"]

_DIGITS = 19
"""Number of digits of a count that are read: Python refuses numbers of thousands of digits."""

_POINT_CELLS = 11
"""Number of cells of an interest point as text, before its descriptor."""

_COUNTS = 16
"""Bytes of the two counts at the beginning of a binary file."""

_RECORD = Struct("<2f2i3f?2IQ")
"""An interest point as VisionWorkbench writes it, without gaps: x, y, both as whole numbers,
orientation, scale, interest, polarity, octave, level, and the length of the descriptor."""

_MAX_MATCHES = 10_000_000
"""Number of matches, or numbers of a descriptor, that no real file exceeds."""


class AspMatches(Reader):
    """Matches of the Ames Stereo Pipeline: a .match file, or text of its parse_match_file.py.

    The first image is the one to georeference, the second the reference.
    """

    name = "asp-match"
    summary = ("ASP's .match files, and text from its parse_match_file.py: two counts, then the "
               "interest points")
    declared_options = (REFERENCE, RASTER_OPTION)

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True if two equal counts are followed by an interest point."""
        return is_matches(head)

    def read(self, path: Path) -> FeatureSet:
        """Return the points; errors name file and line."""
        first, second = read_matches(path)
        inside = are_in_image(first, self.options["raster"],
                              [f"match {i + 1}" for i in range(len(first))])
        return with_ground(path, [f"M{i + 1:03d}" for i in np.flatnonzero(inside)], first[inside],
                           second[inside], self.options["reference"], None)


def is_matches(head: bytes) -> bool:
    """Return whether a file with this beginning has matches of ASP, as binary or as text."""
    if _parse_counts(head) is not None:
        return True
    lines = head.decode("utf-8", errors="replace").splitlines()
    counts = lines[0].split() if lines else []
    return (len(counts) == 2 and counts[0].isdigit() and counts[0] == counts[1]
            and len(lines) > 1 and _is_interest_point(lines[1].split()))


def read_matches(path: Path) -> tuple[FloatArray, FloatArray]:
    """Return line and sample (n, 2) of the matches in the first and in the second image [px].

    Raises
    ------
    TermselError
        Naming file and line of what is no match file.
    """
    content = bytes_of(path)
    # Binary files begin with two counts of 8 bytes, text with two numbers.
    if (counts := _parse_counts(content[:_COUNTS + _RECORD.size])) is not None:
        return _parse_binary(content, counts[0], path)
    lines = read_text(path).splitlines()
    first_word = next(iter((lines or [""])[0].split()), "")
    count = int(first_word[:_DIGITS]) if first_word.isdecimal() else 0
    if count == 0 or len(lines) < 1 + 2 * count:
        raise TermselError(
            f"the file announces {count} matches and has {max(len(lines) - 1, 0)} rows",
            file=path, line=1, hint="Each point of either image needs a row. The "
                                    "file is incomplete: run ASP again.")
    positions = []
    for number, text in enumerate(lines[1:1 + 2 * count], 2):
        cells = text.split()
        if not _is_interest_point(cells):
            raise TermselError("this row is not an interest point", file=path, line=number,
                               hint="Expected x, y and nine further numbers. The file is cut or "
                                    "damaged: copy it again, or run ASP again.")
        # The text has x before y; positions are line and sample.
        positions.append([float(cells[1]), float(cells[0])])
    of_images = np.array(positions)
    return of_images[:count], of_images[count:]


def _parse_counts(head: bytes) -> tuple[int, int] | None:
    """Return the two counts at the beginning of a binary match file; None if it is no such file.

    They are the numbers of points in the first and in the second image, which are equal.
    """
    if len(head) < _COUNTS + _RECORD.size:
        return None
    counts = int.from_bytes(head[:8], "little"), int.from_bytes(head[8:_COUNTS], "little")
    # The whole numbers after x and y are x and y rounded, which no other kind of file has.
    x, y, column, row, *_, size = _RECORD.unpack_from(head, _COUNTS)
    is_rounded = isfinite(x) and isfinite(y) and abs(x - column) <= 1 and abs(y - row) <= 1
    is_plausible = 0 < counts[0] == counts[1] < _MAX_MATCHES and size < _MAX_MATCHES
    return counts if is_rounded and is_plausible else None


def _parse_binary(content: bytes, count: int, path: Path) -> tuple[FloatArray, FloatArray]:
    """Return line and sample of the points of a binary file in both images, (n, 2) each [px].

    Raises TermselError if the file is shorter or longer than its counts say.
    """
    # Numbers of a descriptor have 4 or 8 bytes, by the version of ASP, and no field says which: the
    # size is right if the last record ends with the file.
    for width in (4, 8):
        positions: list[tuple[float, float]] = []
        # Each descriptor has its own length, so that records are read one after another.
        at = _COUNTS
        while len(positions) < 2 * count and at + _RECORD.size <= len(content):
            x, y, *_, size = _RECORD.unpack_from(content, at)
            if not (isfinite(x) and isfinite(y) and size < _MAX_MATCHES):
                break
            positions.append((y, x))
            at += _RECORD.size + width * size
        if len(positions) == 2 * count and at == len(content):
            of_images = np.array(positions, dtype=np.float64)
            return of_images[:count], of_images[count:]
    raise TermselError(f"the file announces {count} matches and is cut off, or is no match file of "
                       "ASP", file=path, hint="The file is incomplete or damaged: get it again.")


def _is_interest_point(cells: Sequence[str]) -> bool:
    """Return whether the cells of a line of text are those of an interest point.

    It has at least 11 cells, of which the first two, x and y, are finite numbers.
    """
    try:
        return len(cells) >= _POINT_CELLS and all(isfinite(float(cell)) for cell in cells[:2])
    except ValueError:
        return False
