"""Candidates of control points: places of an image and a reference that look alike."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import monotonic

import numpy as np

from termsel import FeatureSet, Points, TermselError, get
from termsel_match.images.masks import open_masked, tell_of_idle
from termsel_match.images.overview import start_by_overview
from termsel_match.images.rasters import GreyRaster
from termsel_match.images.starts import Start, start_of, turned
from termsel_match.images.warps import NotShown, Reference, open_reference, references_of
from termsel_match.matchers import Matcher, Matches
from termsel_match.points.calibration import calibrated
from termsel_match.points.cells import (
    FOUND,
    NO_DATA,
    NO_TEXTURE,
    NO_TIME,
    OUTSIDE,
    UNLIKE,
    Looking,
    in_cells,
)

log = logging.getLogger("termsel.match")

_USUAL = ("sift", "structure")
LEAST = 8  # candidates; fewer cannot be selected from
_FEW = 8  # part of those wanted, below which another matcher may find more

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
    seconds: float | None = None,
    masks: Sequence[Path | str] = (),
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
        Rasters of any size and type. The reference may be a folder of georeferenced images: tiles,
        or chips of ground control.
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
        By default "sift", and "structure" where that finds fewer than 8 candidates, or an eighth
        of those wanted: the one that finds more.
    seconds : float, optional
        Time for the matching, which then goes on with what it has.
    masks : sequence of path-like
        See `termsel_match.images.masks.open_masked`.
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
    until = None if seconds is None else monotonic() + seconds
    known = start_of(start, image)
    files = references_of(reference)
    tell_of_idle(masks, [image], files)
    with open_masked(image, band, masks) as picture:
        if known is None:
            if len(files) > 1:
                raise TermselError("a folder of references requires a start", file=image,
                                   hint="Give --start with an RPC, a result or points.")
            known = start_by_overview(picture, files[0], reference_band)
        known.say_dem(dem)
        tried = []
        for name in _USUAL if matcher is None else (matcher,):
            chosen = get("matchers", name)
            looking = Looking(chosen() if isinstance(chosen, type) else chosen, search, count,
                              until, progress)
            tried.append(_of_files(picture, files, known, dem, reference_band, masks, looking))
            found = len(tried[-1][0])
            if found >= max(LEAST, count / _FEW) or looking.is_over:
                break
            log.info("Note: the matcher %s finds %d candidates.", chosen.name, found)
        points, crs, cells = max(tried, key=lambda one: len(one[0]))
        size = picture.size
    if len(points) < LEAST:
        raise TermselError(f"not enough candidates: {len(points)} found, at least {LEAST} "
                           "needed", file=image, hint=_why(cells, search, dem))
    if dem is None:
        log.info("Note: the heights are unknown. Give --dem FILE for RPCs and 3D models.")
    return Candidates(_calibrated(points, known, crs), crs, size, dict(cells), known.what, known)


def _of_files(picture: GreyRaster, files: list[Path], known: Start, dem: Path | str | None,
              band: int | None, masks: Sequence[Path | str], looking: Looking,
              ) -> tuple[Points, str, Counter[str]]:
    """Return the points by all references, the CRS of the first, and how cells ended."""
    several = []
    crs = ""
    cells = Counter[str]()
    missed: TermselError | None = None
    for i, file in enumerate(files):
        def progress(share: float, i: int = i) -> None:
            if looking.progress is not None:
                looking.progress((i + share) / len(files))

        try:
            with open_reference(file, known, dem, picture.size, band, masks) as other:
                area = None if len(files) == 1 else other.footprint(picture.size)
                if len(files) > 1 and area is None:
                    continue
                found, ends = in_cells(picture, other, replace(looking, progress=progress), area)
                points = _points(found, other)
                own = other.crs
        except NotShown as error:  # a tile beyond the image
            missed = error
            continue
        crs = crs or own
        if own != crs:
            plane = turned(points.ground[:, :2], own, crs)
            points = replace(points, ground=np.column_stack([plane, points.ground[:, 2]]))
        several.append(points)
        cells += ends
    if not several:
        raise missed or TermselError("none of the references shows what the image shows",
                                     file=files[0].parent, hint="Give references of its place.")
    return _numbered(several), crs, cells


def _calibrated(points: Points, known: Start, crs: str) -> Points:
    """Return points with standard deviations by which those that agree differ from others."""
    assert points.sigma is not None
    z = points.ground[:, 2]
    ground = np.column_stack([turned(points.ground[:, :2], crs, known.crs),
                              np.where(np.isfinite(z), z, known.height)])
    moved = points.image - known.project(ground)
    seen = np.isfinite(moved).all(axis=1)
    if not seen.all():
        return points
    return replace(points, sigma=calibrated(points.image, moved, points.sigma))


def _numbered(several: list[Points]) -> Points:
    """Return all points, with numbers as their ids."""
    if len(several) == 1:
        return several[0]
    count = sum(map(len, several))
    image, ground, sigma = (np.concatenate([getattr(points, name) for points in several])
                            for name in ("image", "ground", "sigma"))
    score = np.concatenate([points.attributes["score"] for points in several])
    return Points(tuple(f"M{i + 1:03d}" for i in range(count)), image, ground, sigma,
                  attributes={"score": score})


def _points(found: Matches, reference: Reference) -> Points:
    """Return matches as points, those with a height if there is a DEM."""
    assert found.sigma is not None
    ground = reference.ground(found.second)
    kept = np.isfinite(ground[:, 2]) if callable(reference.map_heights) \
        else np.ones(len(ground), dtype=bool)
    ids = tuple(f"M{i + 1:03d}" for i in range(int(kept.sum())))
    shown = np.array([f"{value:.3f}" for value in found.score[kept]], dtype=object)
    return Points(ids, found.first[kept], ground[kept], found.sigma[kept],
                  attributes={"score": shown})


def _why(cells: Counter[str], search: float, dem: Path | str | None) -> str:
    """Return what to do where there are too few candidates."""
    total = sum(cells.values())
    worst = max((name for name in cells if name != FOUND), key=cells.__getitem__, default=UNLIKE)
    where = f"{cells.get(worst, 0)} of {total} cells"
    heights = " or heights" if dem is not None else ""
    return {
        NO_TIME: f"For {where} there was no time. Give more --seconds.",
        NO_DATA: f"In {where} the image has no data.",
        OUTSIDE: f"For {where} there is no reference{heights}. Give larger ones.",
        NO_TEXTURE: f"In {where} there is no texture, as on sea or in clouds.",
        UNLIKE: f"In {where} nothing looks alike. Are there clouds or sea, or another band? Is "
                f"the start off by more than --search {search:g} px?"}[worst]
