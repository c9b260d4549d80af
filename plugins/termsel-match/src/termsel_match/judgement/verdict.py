"""What came of an image: whether it is good enough, and what else must be known of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from termsel import Points
from termsel.toolkit.coordinates import height_unit
from termsel_match.images.rasters import FloatArray, Mask, spread_pixels
from termsel_match.images.starts import Heights, transform_plane
from termsel_match.judgement.along import Along, drift_along, steady_model
from termsel_match.judgement.evidence import (
    LEVEL,
    OtherPlace,
    ResidualStructure,
    find_other_place,
    residual_structure,
    unsupported_share,
)
from termsel_match.judgement.repeats import ALIKE
from termsel_match.judgement.selection import AGREEING, AGREEING_PX, NEAR_PX, SelectedCandidates
from termsel_match.judgement.structures import heights_above_plane
from termsel_match.lines.rounds import Matched, rms_distance
from termsel_match.points.candidates import Candidates

_LEAST_INDEPENDENT = 5
"""Fewest independent candidates that must agree: the RMSE of fewer says little."""

_BARE = 0.15
"""Share of the image without agreeing candidates above which the report remarks on it."""

_RIVAL = 0.5
"""Candidates that agree on another position, divided by those that agree with the model, from which
on the other position may be the right one."""

_STRUCTURE = 0.125
"""What residuals of neighbours have in common, divided by the accepted error, above which it
matters."""

_OUTSIDE = 0.1
"""Share of the candidates outside the range of heights of the RPC above which the report asks about
the heights."""

_USUAL_BIAS = 50.0
"""Largest usual error of an RPC whose vendor states none [m]: twice the CE90 of QuickBird (23 m).
Later vendors state 3 to 15 m."""

_STATED = 3.0
"""Correction, divided by the bias that an RPC states, above which the report asks about the RPC."""

_MAX_NAMED = 12
"""How many of the candidates that disagree the report names."""

_EARTH = 6.371e6
"""Mean radius of the Earth [m]."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """What the candidates say of a model.

    Parameters
    ----------
    sigma : float
        Largest standard deviation of the model within the map [px].
    covered : float
        Share of the area that image and reference both show which lies in the hull of the agreeing
        candidates.
    bare : tuple of float and str
        Share of that area which has no agreeing candidate nearby, and the part of the image that
        its median position is in ("" if the share is 0).
    structure : ResidualStructure, optional
        What residuals of neighbours have in common; None of too few residuals.
    other_place : OtherPlace, optional
        The position on which candidates that disagree with the model agree; None without one.
    correction : ndarray, shape (n, 2), optional
        Differences of the agreeing candidates from the start, line and sample [px]; None without a
        rough start.
    pixel : float
        Size of a pixel on the ground [m].
    along_lines : Along
        How much a correction that is smooth along the lines differs from a drift.
    repetition : tuple of float
        Distance at which the reference repeats itself [px of the reference], and the correlation
        there (see `repetition_distance`).
    """

    sigma: float
    covered: float
    bare: tuple[float, str]
    structure: ResidualStructure | None
    other_place: OtherPlace | None
    correction: FloatArray | None
    pixel: float
    along_lines: Along
    repetition: tuple[float, float]


def evidence_of(candidates: Candidates, selected: SelectedCandidates, heights: Heights,
                areas: tuple[Mask, Mask], seed: int, repetition: tuple[float, float]) -> Evidence:
    """Return what the candidates say of the model that is fitted to some of them.

    Parameters
    ----------
    candidates : Candidates
        All candidates, whether they agree with the model or not.
    selected : SelectedCandidates
        The model, and which candidates agree with it.
    heights : float or callable
        One height of the ground, or a function that gives those of positions (n, 2).
    areas : tuple of ndarray of bool, shape (a, b)
        Two masks of positions spread evenly over the image: where both image and reference show the
        ground, and what is to be mapped.
    seed : int
        Seed of the permutations that judge the structure of the residuals.
    repetition : tuple of float
        As the attribute of `Evidence`.
    """
    overlap, mapped = areas
    points = candidates.points
    size = candidates.image_size
    fit = selected.result.fit
    residuals = points.image - fit.project(points.ground)
    distances = np.linalg.norm(residuals, axis=1)
    # Inexact matching has a wider limit: what agrees within it is not on another position.
    reach = max(NEAR_PX, selected.limit)
    near = distances <= reach
    far = (distances > reach) & np.isfinite(distances)
    # Ground of the map, by a model that stays close to the candidates' beyond them.
    ground = steady_model(
        selected).locate(spread_pixels(size, mapped.shape)[mapped.ravel()], heights)
    ground = ground[np.isfinite(ground).all(axis=1)]
    sigma = selected.sigma(ground) if len(ground) else np.array([np.inf])
    agree = points.take(selected.agrees)
    pixel = _pixel_size(agree, candidates.crs)
    if len(ground) and not fit.model.uses_height:
        # A model without heights ignores relief. A view from 45 degrees displaces a place by as
        # much as it is above the plane of the candidates.
        above = heights_above_plane(agree.ground, ground) * height_unit(candidates.crs) / pixel
        sigma = np.hypot(sigma, above)
    start = candidates.rough
    correction = None
    if start is not None:
        correction = agree.image - start.project(_ground_for_start(agree, candidates))
    return Evidence(
        sigma=float(sigma.max()), covered=_share_covered(agree.image, overlap, size),
        bare=unsupported_share(agree.image, overlap, size),
        structure=residual_structure(points.image[near], residuals[near], 2 * selected.limit, size,
                                     np.random.default_rng([seed, 2])),
        other_place=find_other_place(points.image[far], residuals[far], AGREEING_PX, size),
        correction=correction, pixel=pixel,
        along_lines=drift_along(selected, agree, size[0]), repetition=repetition)


def remarks_for_user(candidates: Candidates, selected: SelectedCandidates, evidence: Evidence,
                     accept: float) -> tuple[str, ...]:
    """Return sentences on what the user should check, though the map may be right; () if none.

    `accept` is the largest acceptable error [px].
    """
    notes = []
    if _structure_matters(evidence, accept):
        common = evidence.structure
        assert common is not None
        notes.append(f"Residuals of neighbours are alike: {common.size:.2f} px (permutation level "
                     f"{common.level:.3f}). They are largest in {common.image_part} of the image, "
                     f"{_vector_text(common.away)}. Is the reference a mosaic, or the model too "
                     "simple?")
    if evidence.other_place is not None:
        found_there = evidence.other_place
        notes.append(f"{found_there.count} candidates, most in {found_there.image_part} of the "
                     f"image, agree on another position, {_vector_text(found_there.away)} from the "
                     "position that the model predicts. Does the reference have a seam, or the "
                     "ground repeat?")
    distance, correlation = evidence.repetition
    if correlation >= ALIKE:
        notes.append(f"The reference repeats itself at a distance of {distance:.0f} of its pixels "
                     f"(correlation {correlation:.2f}). If the start is off by half of that, the "
                     "map may be of another area.")
    if evidence.along_lines.matters(accept):
        notes.append(f"The correction changes along the lines by {evidence.along_lines.size:.2f} "
                     "px (RMS, compared with a drift). It changes most near line "
                     f"{evidence.along_lines.line:.0f}, {_vector_text(evidence.along_lines.away)}. "
                     "Jitter of the attitude does so, and so do seams of the reference.")
    if selected.called_for is not None:
        notes.append(f"Candidates support {selected.called_for.text}, and do not determine it all "
                     f"over the map. {selected.correction.text} is taken instead; at held-out "
                     f"candidates it misses {selected.missed:.2f} px (RMS).")
    elif selected.missed:
        notes.append(f"At held-out candidates the model misses {selected.missed:.2f} px (RMS), "
                     "more than matching is off. Does the reference have a seam, or is the model "
                     "too simple?")
    bare, image_part = evidence.bare
    if bare > _BARE:
        notes.append(f"No candidate agrees in {100 * bare:.0f} % of what image and reference show, "
                     f"most in {image_part} of the image. Are there clouds or changes?")
    start = candidates.rough
    # An RPC that is right needs only a small correction: its vendor says how small.
    if evidence.correction is not None and start is not None and start.heights is not None:
        moved = float(np.median(np.linalg.norm(evidence.correction, axis=1))) * evidence.pixel
        usual = _STATED * start.bias if start.bias else _USUAL_BIAS
        if moved > usual:
            usual_source = "its vendor states" if start.bias else "RPCs are usually wrong by"
            notes.append(f"The correction of {moved:.0f} m is larger than {usual_source} "
                         f"({usual:.0f} m at most). Are the heights right, and is it the RPC of "
                         "this image?")
        low, high = start.heights
        z = candidates.points.ground[selected.agrees, 2]
        # Heights beyond those that an RPC is made for are often feet, or of another datum.
        if ((z < low) | (z > high)).mean() > _OUTSIDE:
            notes.append(f"Heights of the DEM are {z.min():.0f} to {z.max():.0f} m, and the RPC is "
                         f"made for {low:.0f} to {high:.0f} m. Are they in metres, and of the "
                         "same vertical datum?")
    return tuple(notes)


def reasons_to_reject(
        selected: SelectedCandidates, evidence: Evidence, accept: float) -> tuple[str, ...]:
    """Return sentences on why a result is not good enough; () if it is good enough.

    `accept` is the largest acceptable error [px].
    """
    refusals = []
    total = int(selected.independent.sum())
    agree = int((selected.agrees & selected.independent).sum())
    if agree < _LEAST_INDEPENDENT:
        refusals.append(f"Only {agree} of {total} independent candidates agree with the model; at "
                        f"least {_LEAST_INDEPENDENT} must.")
    # The median of all, right or wrong, shows when most of them are wrong.
    if selected.median > accept:
        refusals.append("Half of the independent candidates are more than "
                        f"{selected.median:.2f} px from the model; accepted are {accept:g} px.")
    if selected.rmse > accept:
        refusals.append(f"The RMSE of those that agree is {selected.rmse:.2f} px; accepted are "
                        f"{accept:g} px.")
    # Not `sigma > accept`: an unknown deviation (NaN) must be a refusal, too.
    if not evidence.sigma <= accept:
        refusals.append(f"The predicted standard deviation is up to {evidence.sigma:.2f} px where "
                        f"the map would be; accepted are {accept:g} px. Give a larger reference, "
                        "or --extent reference.")
    common = evidence.structure
    if common is not None and common.level <= LEVEL and np.linalg.norm(common.away) > accept:
        refusals.append(f"In {common.image_part} of the image all candidates are off, "
                        f"{_vector_text(common.away)}; accepted are {accept:g} px.")
    rival = evidence.other_place
    if rival is not None and rival.count >= _RIVAL * selected.agrees.sum():
        refusals.append(f"{rival.count} candidates agree on another position, and only "
                        f"{int(selected.agrees.sum())} on this one.")
    if _is_seam(evidence, accept):
        refusals.append(f"Near line {evidence.along_lines.line:.0f} the correction changes "
                        f"{_vector_text(evidence.along_lines.away)}, and candidates there agree on "
                        "both positions: the reference has a seam.")
    return tuple(refusals)


def _is_seam(evidence: Evidence, accept: float) -> bool:
    """Return whether a correction along the lines follows a seam of the reference.

    Jitter of the attitude displaces a whole line of the image. At a seam of the reference, however,
    candidates of the same lines agree on two positions, whose difference is the step.
    """
    step = np.array(evidence.along_lines.away)
    if evidence.other_place is None or np.linalg.norm(step) <= accept:
        return False
    other_step = np.array(evidence.other_place.away)
    return bool(min(np.linalg.norm(other_step - step),
                    np.linalg.norm(other_step + step)) <= AGREEING_PX)


@dataclass(frozen=True, eq=False)
class Georeferenced:
    """The model found for an image, the evidence on it, and whether it is good enough for a map.

    Parameters
    ----------
    candidates : Candidates
        All candidates that were matched or given.
    selected : SelectedCandidates
        The model, and which candidates agree with it.
    evidence : Evidence
        What the candidates say of the model.
    accept : float
        Largest accepted error [px].
    reasons : tuple of str
        Why the result is not good enough; empty if it is.
    remarks : tuple of str
        What the user should check, though the map may be right.
    lines : Matched, optional
        Lines that are control as well; None if the model is by points alone.
    unused : str
        Why given vectors are not used; "" if they are, or none are given.
    bounds : tuple of float, optional
        Least x and y and largest x and y of the map, in the CRS of the candidates. None if all of
        the image is mapped.
    """

    candidates: Candidates
    selected: SelectedCandidates
    evidence: Evidence
    accept: float
    reasons: tuple[str, ...]
    remarks: tuple[str, ...]
    lines: Matched | None = None
    unused: str = ""
    bounds: tuple[float, float, float, float] | None = None

    def text(self) -> str:
        """Return the report as text: start, candidates, model, accuracy, remarks and reasons.

        Distances are in px of the image unless another unit is named.
        """
        selected = self.selected
        points = self.candidates.points
        agree = self.selected.agrees
        result = selected.result
        evidence = self.evidence
        lines = [f"Start: {self.candidates.start}"]
        if evidence.correction is not None:
            moved = np.linalg.norm(evidence.correction, axis=1)
            lines.append(f"Correction to the start: {np.median(moved):.1f} px "
                         f"({np.median(moved) * evidence.pixel:.1f} m) in the median, up to "
                         f"{moved.max():.1f} px")
        n_found = self.candidates.cells.get("found", 0)
        cells = sum(self.candidates.cells.values())
        lines += [
            f"Candidates: {len(points)}" + (f" in {n_found} of {cells} cells of the image" if cells
                                            else ""),
            f"Agreeing within {selected.limit:.2f} px: "
            f"{int((agree & ~selected.independent).sum())} of "
            f"{int((~selected.independent).sum())} candidates for control and check",
            f"Model: {selected.correction.text}, fitted to the "
            f"{result.features.points.roles.count('control')} for control",
            f"Covered by candidates that agree: {100 * evidence.covered:.0f} % of what image and "
            "reference show",
            f"Predicted standard deviation on the map: at most {evidence.sigma:.2f} px",
            f"Independent candidates: {int((agree & selected.independent).sum())} of "
            f"{int(selected.independent.sum())} agree, with an RMSE of {selected.rmse:.2f} px",
            f"Error of all of them, right or wrong: median {selected.median:.2f} px, CE90 "
            f"{selected.ce90:.2f} px; accepted: {self.accept:g} px",
            AGREEING]
        if evidence.structure is not None:
            lines.append(f"Residuals of neighbours have {evidence.structure.size:.2f} px in common "
                         f"(permutation level {evidence.structure.level:.3f})")
        names = [name for name, is_agreeing in zip(points.ids, agree, strict=True)
                 if not is_agreeing]
        if names:
            further = f" and {len(names) - _MAX_NAMED} more" if len(names) > _MAX_NAMED else ""
            lines.append(f"Candidates that disagree: {', '.join(names[:_MAX_NAMED])}{further}")
        if self.lines is not None:
            last = self.lines.rounds[-1]
            away = rms_distance(result.fit, result.features.lines)
            lines.append(f"Lines: {last.agreeing} of {last.pieces} straight pieces of vectors "
                         f"agree, with an RMS distance of {away:.2f} px")
        if self.unused:
            lines.append(f"Lines are not used, the map is by points alone: {self.unused}")
        for title, lines_of in (("Look at this:", self.remarks),
                                ("Not good enough:", self.reasons)):
            if lines_of:
                lines += [title, *(f"  {line}" for line in lines_of)]
        return "\n".join(lines) + "\n"


def _structure_matters(evidence: Evidence, accept: float) -> bool:
    """Return whether residuals of neighbours are alike beyond chance, and by enough to matter."""
    common = evidence.structure
    return common is not None and common.level <= LEVEL and common.size > _STRUCTURE * accept


def _vector_text(vector: tuple[float, float]) -> str:
    """Return a displacement (line, sample) [px] in words, with signs."""
    return f"by ({vector[0]:+.1f}, {vector[1]:+.1f}) px in line and sample"


def _ground_for_start(points: Points, candidates: Candidates) -> FloatArray:
    """Return ground positions (n, 3) of points in the CRS of the start.

    Where the height of a point is unknown it gets that of the start.
    """
    assert candidates.rough is not None
    z = points.ground[:, 2]
    return np.column_stack([transform_plane(points.ground[:, :2], candidates.crs,
                                            candidates.rough.crs),
                            np.where(np.isfinite(z), z, candidates.rough.height)])


def _share_covered(image: FloatArray, overlap: Mask, size: tuple[int, int]) -> float:
    """Return which share of an overlap lies in the convex hull of image positions (n, 2) [px].

    `overlap` (a, b) is a mask of positions spread evenly over an image, of which `size` has the
    lines and samples.
    """
    hull = shapely.convex_hull(shapely.MultiPoint(image))
    positions = spread_pixels(size, overlap.shape)[overlap.ravel()]
    return float(shapely.contains_xy(hull, positions[:, 0], positions[:, 1]).mean())


def _pixel_size(points: Points, crs: str) -> float:
    """Return the size of a pixel on the ground [m], by the areas that points span.

    It is the root of the area of their convex hull on the ground, divided by that of their hull in
    the image; NaN if the latter has no area. Ground coordinates are in `crs`.
    """
    lonlat = np.radians(transform_plane(points.ground[:, :2], crs, "EPSG:4326"))
    # Metres on a sphere about the middle: east is narrower by the cosine of the latitude.
    plane = _EARTH * (lonlat - lonlat.mean(axis=0)) * [np.cos(lonlat[:, 1].mean()), 1.0]
    ground_area, image_area = (shapely.convex_hull(shapely.MultiPoint(positions)).area
                               for positions in (plane, points.image))
    return float((ground_area / image_area) ** 0.5) if image_area > 0 else float("nan")
