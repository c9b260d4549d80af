"""Ties from match files of the Ames Stereo Pipeline: pairs of images, joined where they meet."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from termsel import TermselError
from termsel.toolkit import require_regular

# Bytes by which a file is known.
_HEAD = 4096

Place = tuple[str, float, float]
"""Image, line and sample of a measurement."""


def is_asp(file: Path) -> bool:
    """Return whether a file is a match file, binary or as text; False if it cannot be opened.

    Without the package termsel-match, which reads such files, only those with the suffix .match are
    known.

    Raises
    ------
    TermselError
        If the suffix is .match, and termsel-match is not installed.
    """
    if find_spec("termsel_match") is None:
        if file.suffix == ".match":
            raise TermselError("a match file of ASP requires the package termsel-match, which is "
                               "not installed", file=file,
                               hint="In a clone of termsel: pip install ./plugins/termsel-match.")
        return False
    from termsel_match.asp import is_matches

    try:
        require_regular(file)
        with file.open("rb") as opened:
            return file.suffix == ".match" or is_matches(opened.read(_HEAD))
    except OSError:
        # It is read as a table then, which raises an error that says why it cannot be.
        return False


def asp_rows(files: Sequence[Path], images: Sequence[str]) -> list[tuple[Path, int, str, Place]]:
    """Return file, number in it, id of the tie and position of each measurement of match files.

    A position in an image that two files state is one measurement, so that pairs become ties of
    many images. If a tie would have two positions in one image, its pairs stay ties of their own.
    """
    pairs: list[tuple[Path, int, Place, Place]] = []
    for file in files:
        first_image, second_image = _images_of_match_file(file, images)
        from termsel_match.asp import read_matches

        for number, (a, b) in enumerate(zip(*read_matches(file), strict=True), 1):
            pairs.append((file, number, (first_image, float(a[0]), float(a[1])),
                          (second_image, float(b[0]), float(b[1]))))
    # Union-find: positions that matches join, directly or by others, have one root.
    parent: dict[Place, Place] = {}

    def root(position: Place) -> Place:
        """Return the root of a position; the way to it is halved for the next time."""
        while parent.setdefault(position, position) != position:
            parent[position] = position = parent[parent[position]]
        return position

    for _, _, a, b in pairs:
        parent[root(a)] = root(b)
    members: dict[Place, set[Place]] = {}
    for position in list(parent):
        members.setdefault(root(position), set()).add(position)
    rows = []
    written = set()
    for k, (file, number, a, b) in enumerate(pairs, 1):
        tie = members[root(a)]
        is_unambiguous = len({image for image, _, _ in tie}) == len(tie)
        name = "-".join(map(str, ("asp", *min(tie)))) if is_unambiguous else f"asp-pair-{k}"
        for position in (a, b):
            if (name, position) not in written:
                written.add((name, position))
                rows.append((file, number, name, position))
    return rows


def _images_of_match_file(file: Path, images: Sequence[str]) -> tuple[str, str]:
    """Return the names of both images of a match file, by its own name.

    Raises TermselError if that names no two images of the block.
    """
    # ASP names it prefix-A__B.match: the first image may have a prefix, the second has none.
    first, _, second = file.name.removesuffix(".txt").removesuffix(".match").rpartition("__")
    matching = [name for name in images if first == name or first.endswith(f"-{name}")]
    if not matching or second not in images or second in matching:
        raise TermselError("the name of this match file states no two images of the block",
                           file=file, hint="Name it as ASP does: run-A__B.match for A and B. "
                                           f"The block has {', '.join(images[:8])}.")
    # If several names of images end alike, the longest leaves the shortest prefix.
    return max(matching, key=len), second
