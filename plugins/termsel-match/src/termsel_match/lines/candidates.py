"""Candidates of control lines: vectors, and bands of the image that may show them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from termsel import Lines, TermselError
from termsel.toolkit import count_in_words
from termsel_match.images.rasters import FloatArray, open_picture
from termsel_match.images.starts import Start, start_of
from termsel_match.lines.ridges import clearest_bands
from termsel_match.lines.vectors import pieces_of

LEAST_PIECES = 6
"""Fewest pieces that must have a band."""

BANDS_PER_PIECE = 4
"""Most bands that are candidates for a piece."""


@dataclass(frozen=True, eq=False)
class LineCandidates:
    """Candidates of control lines, most of which are wrong, as each piece has several.

    Parameters
    ----------
    lines : Lines
        The candidates, with standard deviations, and the attributes `vector`, `piece`, `offset`
        [px] and `score`.
    crs : str
        CRS of their ground coordinates.
    image_size : tuple of int
        Lines and samples of the image.
    pieces : int
        Number of straight pieces of vectors in the image.
    start : str
        The rough geometry from which matching started, in words.
    """

    lines: Lines
    crs: str
    image_size: tuple[int, int]
    pieces: int
    start: str


def match_lines(
    image: Path | str,
    vectors: Path | str,
    *,
    dem: Path | str | None = None,
    start: Path | str | Start | None = None,
    search: float = 60.0,
    band: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> LineCandidates:
    """Return the bands of an image that may show vectors such as roads.

    Vectors are projected by the start and cut into straight pieces. On both sides of each, as far
    as the search goes, bright and dark bands are looked for. The clearest four are its candidates,
    whose positions are measured to sub-pixel.

    Parameters
    ----------
    image, vectors : path-like
        The image; and lines, or areas for their boundaries, in any format of GDAL and any CRS.
    dem : path-like, optional
        Raster of heights; without it, the height that the start states holds everywhere.
    start : path-like, str or Start, optional
        Rough geometry of the image, as for `termsel_match.images.starts.start_of`.
    search : float
        Largest distance of a band from the projected vector [px].
    band : int, optional
        Number of a band, from 1; by default the mean of all bands.
    progress : callable, optional
        Called with the share that is done, 0 to 1.

    Returns
    -------
    LineCandidates
        Up to four lines for each piece, with scores and standard deviations.

    Raises
    ------
    TermselError
        If a file cannot be read, there is no start, or fewer than six pieces have a band.
    """
    image = Path(image)
    rough = start if isinstance(start, Start) else start_of(start, image)
    if rough is None:
        raise without_start(image)
    rough.warn_if_dem_contradicts(dem)
    with open_picture(image, band) as picture:
        size = picture.size
        straight_pieces = pieces_of(vectors, rough, dem, size)
        of_pieces = []
        for i, ends in enumerate(straight_pieces.image):
            of_pieces.append(clearest_bands(picture, ends, search, BANDS_PER_PIECE))
            if progress is not None:
                progress((i + 1) / len(straight_pieces.image))
    n_with_band = sum(map(bool, of_pieces))
    if n_with_band < LEAST_PIECES:
        raise TermselError(f"not enough candidates: {count_in_words(n_with_band, 'piece')} of the "
                           f"vectors {'was' if n_with_band == 1 else 'were'} found in the image, "
                           f"at least {LEAST_PIECES} are needed", file=image,
                           hint="Give vectors of what the image shows, a start that is nearer, or "
                                "a larger --search.")
    rows = []
    for i, several in enumerate(of_pieces):
        rows += [(i, k, ridge) for k, ridge in enumerate(several)]
    # `termsel run --problem matched-lines` groups the candidates by these attributes.
    attributes = {
        "vector": [straight_pieces.vector[i] for i, _, _ in rows],
        "piece": [str(i + 1) for i, _, _ in rows],
        "offset": [f"{ridge.offset:.2f}" for _, _, ridge in rows],
        "score": [f"{ridge.score:.2f}" for _, _, ridge in rows]}
    lines = Lines(tuple(f"L{i + 1:03d}.{k + 1}" for i, k, _ in rows),
                  np.array([ridge.image for _, _, ridge in rows]),
                  np.array([_shorten_line(straight_pieces.ground[i], k) for i, k, _ in rows]),
                  np.array([ridge.sigma for _, _, ridge in rows]),
                  attributes={name: np.array(cells, dtype=object)
                              for name, cells in attributes.items()})
    return LineCandidates(lines, straight_pieces.crs, size, len(of_pieces), rough.description)


def without_start(image: Path) -> TermselError:
    """Return the error that lines cannot be matched without a start, with what to give."""
    return TermselError("lines cannot be matched without a start", file=image,
                        hint="Give --start with an RPC, a result or points.")


def _shorten_line(ends: FloatArray, k: int) -> FloatArray:
    """Return two vertices (2, 3) of the ground line of a piece that differ for each band k.

    Candidates of one piece have one ground line, but features must not have the same coordinates.
    So its ends move by a hundredth of its length for each further band, along the line.
    """
    share = np.array([[0.01 * k], [1 - 0.01 * k]])
    return np.asarray(ends[0] + share * (ends[1] - ends[0]))
