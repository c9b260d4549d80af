"""From a raw image to a map: candidates, selection, judgement, rectification."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from termsel import TermselError, open_dem, read_result, read_rpc, rectify, write_points_csv
from termsel.toolkit import make_folder, write_text
from termsel_match.images.masks import open_masked, warn_of_idle_masks
from termsel_match.images.rasters import FloatArray, GreyRaster, Mask, spread_pixels
from termsel_match.images.starts import Start
from termsel_match.images.warps import COVERS, NotShown, open_reference, references_of
from termsel_match.judgement.picture import draw
from termsel_match.judgement.repeats import repetition_distance
from termsel_match.judgement.selection import SelectedCandidates, select_points, with_lines
from termsel_match.judgement.structures import ModelCorrection
from termsel_match.judgement.verdict import (
    Evidence,
    Georeferenced,
    evidence_of,
    reasons_to_reject,
    remarks_for_user,
)
from termsel_match.lines.rounds import Matched, iterate_lines
from termsel_match.lines.vectors import read_vectors
from termsel_match.points.candidates import Candidates, match_points
from termsel_match.points.given import read_candidates

Bounds = tuple[float, float, float, float]

CANDIDATES, REPORT, PICTURE, RESULT = ("candidates.csv", "report.txt", "residuals.png",
                                       "result")

# Px for lines, from the model of the points.
_SEARCH = 12.0


def georeference_image(
    image: Path | str,
    reference: Path | str | None,
    output: Path | str,
    *,
    dem: Path | str,
    folder: Path | str | None = None,
    overwrite: bool = False,
    **judging: Any,
) -> Georeferenced:
    """Make a map of an image, if the result is good enough.

    Parameters
    ----------
    image, reference, dem
        As for `judge`.
    output : path-like
        The map, a cloud-optimised GeoTIFF. It is written only if the result is good enough.
    folder : path-like, optional
        For candidates, result, report and a picture of the residuals.
    overwrite : bool
        Whether the map may replace a file.
    **judging
        Further arguments of `judge`.

    Returns
    -------
    Georeferenced
        The model, the evidence on it, and why no map was written, if none was.

    Raises
    ------
    TermselError
        As `judge`.
    """
    done = judge(image, reference, dem=dem, folder=folder, **judging)
    if folder is not None:
        write_text(Path(folder) / REPORT, done.text())
        draw(image, done.selected, Path(folder) / PICTURE)
    if not done.reasons:
        rectify(done.selected.result, image, output, dem=dem, bounds=done.bounds,
                overwrite=overwrite)
    return done


def judge(
    image: Path | str,
    reference: Path | str | None,
    *,
    dem: Path | str,
    start: Path | str | None = None,
    points: Path | str | None = None,
    vectors: Path | str | None = None,
    accept: float = 2.0,
    extent: str = "image",
    folder: Path | str | None = None,
    seed: int = 1,
    progress: Callable[[float], None] | None = None,
    **matching: Any,
) -> Georeferenced:
    """Return the model of an image, fitted to candidates that agree, and whether it is good enough.

    An RPC, also that of a result, is refined by the plainest correction that held-out candidates
    support: `rpc-shift`, `rpc-drift`, `rpc-affine` or `rpc-jitter`. Where candidates do not
    determine the last all over the map, a plainer one is taken. Without an RPC, the model is an
    affine transformation of the ground coordinates. Where the vectors cannot be used, the model is
    by points alone.

    Parameters
    ----------
    image, reference, dem, start
        As for `match_points`. With `points`, the reference may be None; it then says nothing of
        where candidates could be.
    points : path-like, optional
        Candidates that are matched already, in any format that `termsel.read` knows.
    vectors : path-like, optional
        Lines of a map, such as roads. The bands of the image that agree with them are control
        together with the points.
    accept : float
        Largest accepted error [px]: the median of all independent candidates, right or wrong, the
        RMSE of those that agree, and the predicted standard deviation where the map is. No
        candidate agrees that is further off.
    extent : str
        What is mapped: "image", or "reference" for only what the reference shows.
    folder : path-like, optional
        For candidates and result.
    seed : int
        Seed of the selection.
    progress : callable, optional
        Called with the fraction of the matching that is done.
    **matching
        Further arguments of `match_points`.

    Returns
    -------
    Georeferenced
        The model, the evidence on it, and why it is not good enough, if it is not.

    Raises
    ------
    TermselError
        As `match_points`; if too few candidates agree; if there is neither a reference nor
        candidates; if vectors cannot be read; or if an RPC is to be corrected and termsel-rpc is
        not installed.

    Notes
    -----
    P.K. Konugurthi et al., PE&RS 82(5), 2016, 377-388: matching, selection by a GA, and the
    decision by the error that is accepted. That at least half of the independent candidates must
    have it, and all that `evidence_of` looks at, are termsel's.
    """
    # Whatever is wrong with the arguments is said before the matching, which takes minutes.
    if reference is None and (points is None or extent == "reference"):
        raise TermselError("the reference is not given",
                           hint="Give --reference ORTHO; only --points FILE with --extent image "
                                "does without.")
    if vectors is not None:
        read_vectors(Path(vectors))
    model, options = model_for(start, Path(image))
    if model == "rpc-drift" and find_spec("termsel_rpc") is None:
        raise TermselError("an image with an RPC requires the package termsel-rpc, which is not "
                           "installed", file=image,
                           hint="In a clone of termsel: pip install ./plugins/termsel-rpc.")
    if points is not None:
        candidates = read_candidates(points, image, reference, dem=dem, start=start)
        warn_of_idle_masks(matching.get("masks", ()), [image],
                           [] if reference is None else references_of(reference))
    else:
        assert reference is not None
        candidates = match_points(image, reference, dem=dem, start=start, progress=progress,
                                  **matching)
    if folder is not None:
        make_folder(Path(folder))
        write_points_csv(candidates.points, Path(folder) / CANDIDATES, candidates.crs)

    chain = _Chain(
        image, reference, candidates, model, options, dem=dem, vectors=vectors, accept=accept,
        extent=extent, seed=seed, folder=None if folder is None else Path(folder) / RESULT,
        band=matching.get("band"), masks=matching.get("masks", ()))
    selected, lines, unused = chain.select_and_fit()
    evidence, bounds = chain.evidence_on(selected)
    # A smooth correction may take any value beyond the candidates that determine it, where no
    # held-out candidate tests it. What a plainer one misses is in its standard deviation.
    while evidence.sigma > accept and selected.correction.model == "rpc-jitter":
        richest = selected.called_for or selected.correction
        try:
            selected, lines, unused = chain.select_and_fit(selected.correction)
        # Too few candidates agree with a plainer one: the smooth one is kept, and refused below.
        except TermselError:
            break
        selected = replace(selected, called_for=richest)
        evidence, bounds = chain.evidence_on(selected)
    return Georeferenced(
        candidates=candidates, selected=selected, evidence=evidence, accept=accept,
        reasons=reasons_to_reject(selected, evidence, accept),
        remarks=remarks_for_user(candidates, selected, evidence, accept),
        lines=lines, unused=unused, bounds=bounds)


@dataclass(frozen=True, eq=False)
class _Chain:
    """What selection, fit and evidence are made from; the same for every correction tried.

    The fields are the arguments of `judge`; `model` with its `options` is that of the search, and
    `folder` that of the result.
    """

    image: Path | str
    reference: Path | str | None
    candidates: Candidates
    model: str
    options: Mapping[str, Any]
    dem: Path | str
    vectors: Path | str | None
    accept: float  # [px]
    extent: str
    seed: int
    folder: Path | None
    band: int | None
    masks: Sequence[Path | str]

    def select_and_fit(self, plainer_than: ModelCorrection | None = None) -> tuple[
            SelectedCandidates, Matched | None, str]:
        """Return the selected candidates with their model, and the lines that are control as well.

        The third is why given vectors are not used, "" if they are or there are none. Corrections
        are tried up to the one before `plainer_than`, in the order of `supported_corrections`.
        Raises TermselError if too few candidates agree.
        """
        selected = select_points(
            self.candidates.features, self.model, self.options, accept=self.accept,
            plainer_than=plainer_than, seed=self.seed, folder=self.folder)
        if self.vectors is None:
            return selected, None, ""
        at = Start("the model of the points", self.candidates.crs, 0.0, selected.result.project,
                   selected.result.locate)
        try:
            lines = iterate_lines(self.image, self.vectors, self.model, self.options, dem=self.dem,
                                  start=at, search=_SEARCH, band=self.band, seed=self.seed)
            with_both = with_lines(selected, lines.features, seed=self.seed, folder=self.folder)
        # The points suffice for a model: lines that do not agree with them are left out.
        except TermselError as error:
            return selected, None, error.what
        return with_both, lines, ""

    def evidence_on(self, selected: SelectedCandidates) -> tuple[Evidence, Bounds | None]:
        """Return what the candidates say of a model, and the bounds of the map."""
        return _judge_candidates(
            self.image, self.reference, self.candidates, selected, dem=self.dem,
            extent=self.extent, seed=self.seed, masks=self.masks)


def model_for(start: Path | str | None, image: Path) -> tuple[str, dict[str, Any]]:
    """Return the name of the model that candidates are searched with, and its options.

    It corrects the RPC by a drift if the start has one, or the image where no start is given. It
    is an affine transformation of the ground coordinates otherwise.
    """
    path = image if start is None else Path(start)
    # The start is a result, which keeps the RPC it corrects.
    if path.is_dir():
        options = read_result(path).options.model
        return ("rpc-drift", {"rpc": options["rpc"]}) if "rpc" in options else ("affine", {})
    # A file without an RPC is a start of another kind, which match_points reads.
    with suppress(TermselError):
        if path.is_file():
            # The RPC itself and not its path, which each of dozens of fits would read again.
            return "rpc-drift", {"rpc": json.dumps(asdict(read_rpc(path)))}
    return "affine", {}


def _judge_candidates(image: Path | str, reference: Path | str | None, candidates: Candidates,
                      selected: SelectedCandidates, *, dem: Path | str, extent: str, seed: int,
                      masks: Sequence[Path | str]) -> tuple[Evidence, Bounds | None]:
    """Return what candidates say of the model, and the bounds of the map.

    The bounds are least x and y and largest x and y in the CRS of the candidates, or None for a map
    of all the image: without a reference, and unless `extent` is "reference".
    """
    result = selected.result
    bounds = None
    repeats = (0.0, 0.0)
    # Areas are masks of 33 by 33 positions that are spread evenly over the image.
    everywhere = np.ones((COVERS, COVERS), dtype=bool)
    with (open_masked(image, None, masks) as picture,
          open_dem(Path(dem), candidates.crs) as heights):
        if reference is None:
            overlap = picture.known_at(spread_pixels(picture.size,
                                                     everywhere.shape)).reshape(everywhere.shape)
        else:
            model = Start("the model", candidates.crs, 0.0, result.project, result.locate)
            overlap, outline, repeats = _ground_shown(
                references_of(reference), picture, model, dem, masks, candidates.crs)
            # Chips of ground control may lie between all of these positions. Those nearest to
            # candidates then stand for what the chips show.
            if not overlap.any():
                overlap = _overlap_or_near(candidates.points.image, picture.size, overlap)
            if extent == "reference":
                bounds = outline
        mapped = everywhere if bounds is None else overlap
        evidence = evidence_of(candidates, selected, heights, (overlap, mapped), seed, repeats)
    return evidence, bounds


def _ground_shown(
    files: list[Path],
    picture: GreyRaster,
    model: Start,
    dem: Path | str,
    masks: Sequence[Path | str],
    crs: str,
) -> tuple[Mask, Bounds, tuple[float, float]]:
    """Return where both an image and any of its references show the ground.

    Returns
    -------
    overlap : ndarray of bool, shape (33, 33)
        At positions spread evenly over the image, whether it and any reference have data.
    bounds : tuple of float
        Least x and y and largest x and y of all references that show the image, in `crs`.
    repeats : tuple of float
        What `repetition_distance` returns for the reference that repeats itself most.
    """
    overlap = np.zeros((COVERS, COVERS), dtype=bool)
    bounds = []
    repeats = (0.0, 0.0)
    for file in files:
        # Some tiles may be away from the image; that one of them shows it was tested by matching.
        with suppress(NotShown), open_reference(file, model, dem, picture.size,
                                                masks=masks) as opened:
            overlap |= opened.shown(picture)
            bounds.append(opened.bounds(crs))
            at_reference = opened.seen(spread_pixels(picture.size, (COVERS, COVERS)))
            repeats = max(repeats, repetition_distance(opened.picture, at_reference),
                          key=lambda candidate: candidate[1])
    low = np.min(bounds, axis=0)
    high = np.max(bounds, axis=0)
    return overlap, (float(low[0]), float(low[1]), float(high[2]), float(high[3])), repeats


def _overlap_or_near(positions: FloatArray, size: tuple[int, int], overlap: Mask) -> Mask:
    """Return the mask `overlap` with the nodes nearest to positions (n, 2) [px] added.

    The mask (a, b) is of nodes that are spread evenly over an image of `size` lines and samples.
    """
    near = overlap.copy()
    # The first and the last node are at the centres of the first and the last pixel.
    at = np.round(positions / (np.array(size) - 1) * (np.array(overlap.shape) - 1)).astype(int)
    near[tuple(np.clip(at, 0, np.array(overlap.shape) - 1).T)] = True
    return near
