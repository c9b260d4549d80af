"""Candidates that were matched already, by `match-points` or by another program."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np

from termsel import Points, TermselError, open_raster, read
from termsel.toolkit import require_regular
from termsel_match.asp import AspMatches
from termsel_match.images.rasters import crs_of, open_picture
from termsel_match.images.starts import start_of
from termsel_match.images.warps import references_of
from termsel_match.points.candidates import LEAST_CANDIDATES, Candidates
from termsel_match.points.readers import MatchesCsv

log = logging.getLogger("termsel.match")

_HEAD = 4096
"""Number of bytes by which readers recognise a file."""


def read_candidates(path: Path | str, image: Path | str, reference: Path | str | None, *,
                    dem: Path | str, start: Path | str | None = None) -> Candidates:
    """Return the points of a file as candidates.

    Points with the role off are left out. Those with the role independent stay so; other roles
    are drawn by the selection.

    Parameters
    ----------
    path : path-like
        In any format that `termsel.read` knows, such as the table of `match-points`, AROSICS or
        ASP.
    image, dem, start
        As for `match_points`.
    reference : path-like, optional
        The georeferenced image. It gives ground coordinates to matches that are in px of two
        images, and its CRS to a file that states none.

    Raises
    ------
    TermselError
        If a file cannot be read, or has fewer than 8 points.
    """
    path = Path(path)
    options = {}
    crs = None
    if reference is not None:
        if _is_in_pixels(path):
            options["reference"] = str(reference)
        with open_picture(references_of(reference)[0]) as picture:
            crs = crs_of(picture)
    try:
        features = read(path, dem=dem, **options)
    except TermselError as error:
        unplaced = error.code == "crs-unknown"
        if crs is None and (unplaced or error.code == "reference-missing"):
            raise TermselError(error.what, file=path,
                               hint="Give the georeferenced image by --reference.") from error
        if crs is None or not unplaced:
            raise
        features = read(path, dem=dem, crs=crs, **options)
    # The start takes no part in matching any more. It is reported, and compared with the DEM.
    rough = start_of(start, Path(image))
    if rough is not None:
        rough.warn_if_dem_contradicts(dem)
    difference = features.dem_difference
    if difference is not None and difference.contradicts:
        log.warning("Warning: %s", difference.sentence())
    points = features.points
    points = points.take(np.isfinite(points.ground).all(axis=1)
                         & np.array([role != "off" for role in points.roles], dtype=bool))
    if len(points) < LEAST_CANDIDATES:
        raise TermselError(f"not enough candidates: {len(points)} of them have a place and a "
                           f"height, at least {LEAST_CANDIDATES} needed", file=path,
                           hint="Give a table with more points, and a --dem that covers them.")
    with open_raster(Path(image)) as raster:
        size = int(raster.height), int(raster.width)
    return Candidates(_as_candidates(points), features.crs, size, {},
                      "none" if rough is None else rough.description, rough,
                      features.heights)


def _is_in_pixels(path: Path) -> bool:
    """Return whether a file has matches in px of two images, without ground coordinates.

    False if it cannot be read.
    """
    try:
        require_regular(path)
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except OSError:
        # `read`, which comes next, reports why.
        return False
    return any(reader().sniff(path, head) for reader in (AspMatches, MatchesCsv))


def _as_candidates(points: Points) -> Points:
    """Return points without any role but "independent": the selection draws the others."""
    return replace(points, roles=tuple(role if role == "independent" else ""
                                       for role in points.roles))
