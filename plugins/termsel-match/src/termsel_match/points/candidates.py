"""Candidates of control points: places of an image and a reference that look alike."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import monotonic

import numpy as np

from termsel import FeatureSet, Points, TermselError, get, open_dem
from termsel.toolkit import count_in_words
from termsel_match.images.masks import open_masked, warn_of_idle_masks
from termsel_match.images.overview import start_by_overview
from termsel_match.images.positions import require_same_area
from termsel_match.images.rasters import GreyRaster
from termsel_match.images.starts import Start, start_of, transform_plane
from termsel_match.images.warps import NotShown, Reference, open_reference, references_of
from termsel_match.matchers import Matcher, Matches
from termsel_match.points.calibration import calibrate_deviations
from termsel_match.points.cells import (
    FOUND,
    NO_DATA,
    NO_TEXTURE,
    NO_TIME,
    OUTSIDE,
    UNLIKE,
    Looking,
    match_cells,
)

log = logging.getLogger("termsel.match")

_USUAL = ("sift", "structure")
"""Matchers that are tried in turn if none is named."""

LEAST_CANDIDATES = 8
"""Fewest candidates among which a selection is possible."""

_SMALL_PART = 8
"""The second matcher is tried if the first finds less than the wanted number divided by this."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """Candidates of control points, many of which may be wrong.

    Parameters
    ----------
    points : Points
        The candidates, with standard deviations. Their attribute `score` is the correlation of what
        both images show around them, at most 1.
    crs : str
        CRS of their ground coordinates.
    image_size : tuple of int
        Lines and samples of the image.
    cells : dict of str to int
        Number of cells of the image that have candidates ("found"), and of those that have none, by
        the reason.
    start : str
        The rough geometry from which matching started, in words.
    rough : Start, optional
        That geometry; None if there was none.
    heights : str
        Source and vertical datum of the heights in words; "" if no raster gave them.
    """

    points: Points
    crs: str
    image_size: tuple[int, int]
    cells: dict[str, int]
    start: str
    rough: Start | None = None
    heights: str = ""

    @property
    def features(self) -> FeatureSet:
        """The candidates as features of the image."""
        return FeatureSet(self.points, crs=self.crs, image_size=self.image_size,
                          heights=self.heights)


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

    For each cell of the image, the reference is resampled as the image should show it by the start.
    A matcher finds places that look alike, whose positions are then refined to sub-pixel by least
    squares. They need only be within `search` of the start: which of them are right is decided
    later, by the selection.

    Parameters
    ----------
    image, reference : path-like
        Rasters of any size and type. The reference may be a folder of georeferenced images: tiles,
        or chips of ground control.
    dem : path-like, optional
        Raster of heights; without it, the heights of the points are unknown.
    start : path-like or str, optional
        Rough geometry of the image, as for `termsel_match.images.starts.start_of`.
    search : float
        Largest distance of a match from the start [px].
    count : int
        Number of candidates wanted, spread over the image.
    band, reference_band : int, optional
        Numbers of a band, from 1; by default the mean of all bands.
    matcher : str or Matcher, optional
        The method that finds places that look alike. By default "sift"; if that finds fewer than 8
        candidates, or less than an eighth of those wanted, "structure" is tried as well, and the
        one that finds more is taken.
    seconds : float, optional
        Time for the matching [s], after which it ends with the candidates found so far.
    masks : sequence of path-like
        See `termsel_match.images.masks.open_masked`.
    progress : callable, optional
        Called with the share that is done, 0 to 1.

    Returns
    -------
    Candidates
        At least 8 candidates.

    Raises
    ------
    TermselError
        If a raster cannot be read, the reference has no CRS, image and reference show different
        places, or fewer than 8 candidates are found, with the reason.

    Notes
    -----
    P.K. Konugurthi et al., "Autonomous ortho-rectification of very high resolution imagery using
    SIFT and genetic algorithm", PE&RS 82(5), 2016, 377-388: matches with a reference and heights
    of a DEM as candidates of which a search selects.
    """
    image = Path(image)
    until = None if seconds is None else monotonic() + seconds
    rough = start_of(start, image)
    files = references_of(reference)
    warn_of_idle_masks(masks, [image], files)
    require_same_area(files, dem)
    with open_masked(image, band, masks) as picture:
        if rough is None:
            if len(files) > 1:
                raise TermselError("a folder of references requires a start", file=image,
                                   hint="Give --start with an RPC, a result or points.")
            rough = start_by_overview(picture, files[0], reference_band)
        rough.warn_if_dem_contradicts(dem)
        attempts = []
        for name in _USUAL if matcher is None else (matcher,):
            matcher_class = get("matchers", name)
            looking = Looking(matcher_class() if isinstance(matcher_class, type) else matcher_class,
                              search, count, until, progress)
            with_start = partial(open_reference, start=rough, dem=dem, size=picture.size,
                                 band=reference_band, masks=masks)
            attempts.append(_points_of_files(picture, files, with_start, looking))
            n_found = len(attempts[-1][0])
            if n_found >= max(LEAST_CANDIDATES, count / _SMALL_PART) or looking.is_over:
                break
            log.info("Note: the matcher %s finds %s.", matcher_class.name,
                     count_in_words(n_found, "candidate") if n_found else "no candidates")
        # The matcher that finds more is the one to take.
        points, crs, cells = max(attempts, key=lambda attempt: len(attempt[0]))
        size = picture.size
    if len(points) < LEAST_CANDIDATES:
        raise TermselError(f"not enough candidates: {len(points)} found, at least "
                           f"{LEAST_CANDIDATES} needed", file=image,
                           hint=_advice_on_cells(cells, search, dem))
    if dem is None:
        log.info("Note: the heights are unknown. Give --dem FILE for RPCs and 3D models.")
    return Candidates(_calibrate_sigma(points, rough, crs), crs, size, dict(cells),
                      rough.description,
                      rough, "" if dem is None else _said_heights(Path(dem), crs))


def _said_heights(dem: Path, crs: str) -> str:
    """Return the source and the vertical datum of a DEM in words, and log a line on them."""
    with open_dem(dem, crs) as surface:
        said = f"heights from {dem.name}, bilinear; vertical datum: {surface.datum}"
    log.info("Heights: %s.", said.removeprefix("heights "))
    return said


def _points_of_files(picture: GreyRaster, files: list[Path],
                     opened: Callable[[Path], AbstractContextManager[Reference]], looking: Looking,
                     ) -> tuple[Points, str, Counter[str]]:
    """Match an image with each of its references.

    Returns
    -------
    points : Points
        The matches with all references.
    crs : str
        CRS of their ground coordinates: that of the first reference that shows the image.
    cells : Counter
        How many cells of the image have matches, and how many have none for which reason.

    Raises
    ------
    TermselError
        If no reference shows what the image shows.
    """
    several = []
    crs = ""
    cells = Counter[str]()
    missed: TermselError | None = None
    for i, file in enumerate(files):
        def progress(share: float, i: int = i) -> None:
            """Report the share of all references that is done, from that of the present one."""
            if looking.progress is not None:
                looking.progress((i + share) / len(files))

        try:
            with opened(file) as seen_reference:
                area = None if len(files) == 1 else seen_reference.footprint(picture.size)
                if len(files) > 1 and area is None:
                    continue
                matches, ends = match_cells(picture, seen_reference,
                                            replace(looking, progress=progress), area)
                points = _points_of_matches(matches, seen_reference)
                own_crs = seen_reference.crs
        except NotShown as error:
            # A tile beyond the image.
            missed = error
            continue
        crs = crs or own_crs
        if own_crs != crs:
            # Tiles may be in two zones: all points are in the CRS of the first.
            plane = transform_plane(points.ground[:, :2], own_crs, crs)
            points = replace(points, ground=np.column_stack([plane, points.ground[:, 2]]))
        several.append(points)
        cells += ends
    if not several:
        raise missed or TermselError("none of the references shows what the image shows",
                                     file=files[0].parent, hint="Give references of its area.")
    return _number_points(several), crs, cells


def _calibrate_sigma(points: Points, rough: Start, crs: str) -> Points:
    """Return points with standard deviations calibrated by their neighbours' displacements.

    They come back unchanged if the start does not project all of them.
    """
    assert points.sigma is not None
    z = points.ground[:, 2]
    ground = np.column_stack([transform_plane(points.ground[:, :2], crs, rough.crs),
                              np.where(np.isfinite(z), z, rough.height)])
    moved = points.image - rough.project(ground)
    is_finite = np.isfinite(moved).all(axis=1)
    if not is_finite.all():
        return points
    return replace(points, sigma=calibrate_deviations(points.image, moved, points.sigma))


def _number_points(several: list[Points]) -> Points:
    """Return several sets of points as one, renumbered from M001; a single set comes back as it is.
    """
    if len(several) == 1:
        return several[0]
    count = sum(map(len, several))
    image = np.concatenate([points.image for points in several])
    ground = np.concatenate([points.ground for points in several])
    sigma = np.concatenate([points.sigma for points in several if points.sigma is not None])
    score = np.concatenate([points.attributes["score"] for points in several])
    return Points(tuple(f"M{i + 1:03d}" for i in range(count)), image, ground, sigma,
                  attributes={"score": score})


def _points_of_matches(matches: Matches, reference: Reference) -> Points:
    """Return matches as points, whose ground coordinates are those of their pixels in a reference.

    They are called M001, M002 and so on, and their attribute `score` has the correlation. With a
    DEM, matches where it has no height are left out.
    """
    assert matches.sigma is not None
    ground = reference.ground(matches.second)
    if callable(reference.map_heights):
        has_height = np.isfinite(ground[:, 2])
    else:
        has_height = np.ones(len(ground), dtype=bool)
    ids = tuple(f"M{i + 1:03d}" for i in range(int(has_height.sum())))
    scores = np.array([f"{value:.3f}" for value in matches.score[has_height]], dtype=object)
    return Points(ids, matches.first[has_height], ground[has_height], matches.sigma[has_height],
                  attributes={"score": scores})


def _advice_on_cells(cells: Counter[str], search: float, dem: Path | str | None) -> str:
    """Return a sentence on why most cells have no candidates, and what to do.

    `cells` are the numbers of cells by what came of them, `search` is the radius of the search
    [px], and `dem` the raster of heights, if there is one.
    """
    total = sum(cells.values())
    worst = max((name for name in cells if name != FOUND), key=cells.__getitem__, default=UNLIKE)
    cells_at_fault = f"{cells.get(worst, 0)} of {total} cells"
    heights = " or heights" if dem is not None else ""
    return {
        NO_TIME: f"For {cells_at_fault} there was no time. Give more --seconds.",
        NO_DATA: f"In {cells_at_fault} the image has no data.",
        OUTSIDE: f"For {cells_at_fault} there is no reference{heights}. Give larger ones.",
        NO_TEXTURE: f"In {cells_at_fault} there is no texture, as on sea or in clouds.",
        UNLIKE: f"In {cells_at_fault} nothing looks alike. Are there clouds or sea, or another "
                f"band? Is the start off by more than --search {search:g} px?"}[worst]
