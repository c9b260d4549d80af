"""What came of an image: whether it is good enough, and what else must be known of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from termsel import Points
from termsel_match.images.rasters import FloatArray, Mask, grid
from termsel_match.images.starts import Heights, turned
from termsel_match.judgement.along import Along, along, steady
from termsel_match.judgement.evidence import (
    LEVEL,
    OtherPlace,
    Structure,
    other_place,
    structure,
    unsupported,
)
from termsel_match.judgement.repeats import ALIKE
from termsel_match.judgement.selection import AGREEING, NEAR, TOLERANCE, Selected
from termsel_match.lines.rounds import Matched, rms_distance
from termsel_match.points.candidates import Candidates

_LEAST_INDEPENDENT = 5  # candidates that agree; of fewer the RMSE says little
_BARE = 0.15  # part of the image, without candidates that agree, that is worth a remark
_RIVAL = 0.5  # of the number that agree: so many that agree on another place may be the right ones
_STRUCTURE = 0.125  # of the accepted error: less structure does not matter
_OUTSIDE = 0.1  # part of the candidates whose heights may be outside those of the RPC
_USUAL_BIAS = 50.0  # m: twice the CE90 of QuickBird (23 m); later vendors state 3 to 15 m
_STATED = 3.0  # times the bias that an RPC states
_NAMED = 12  # candidates that disagree, by name
_EARTH = 6.371e6  # m


@dataclass(frozen=True, eq=False)
class Evidence:
    """What the candidates say of a model.

    Parameters
    ----------
    sigma : float
        Largest standard deviation of the model where the map is [px].
    covered : float
        Part of what image and reference show that is in the hull of the control.
    bare : tuple of float and str
        Part that has no candidate near that agrees, and where.
    structure : Structure, optional
        Of the residuals.
    other : OtherPlace, optional
        Where candidates agree that disagree with the model.
    correction : ndarray, shape (n, 2), optional
        From the start to the candidates that agree, line and sample [px].
    pixel : float
        Size of a pixel on the ground [m].
    along : Along
        By how much a correction that is smooth along the lines differs from a drift.
    repetition : tuple of float
        Distance at which the reference is like itself [px of it], and how much (`repetition`).
    """

    sigma: float
    covered: float
    bare: tuple[float, str]
    structure: Structure | None
    other: OtherPlace | None
    correction: FloatArray | None
    pixel: float
    along: Along
    repetition: tuple[float, float]


def evidence_of(candidates: Candidates, selected: Selected, heights: Heights, shown: Mask,
                mapped: Mask, seed: int, repetition: tuple[float, float]) -> Evidence:
    """Return what candidates say of the model that is fitted to some of them.

    Parameters
    ----------
    candidates : Candidates
    selected : Selected
    heights : float or callable
        Heights of ground places.
    shown, mapped : ndarray of bool, shape (a, b)
        Where, at places spread evenly over the image, it and the reference show the ground; and
        which of them are to be mapped.
    seed : int
        Of the permutations.
    repetition : tuple of float
        As the attribute of `Evidence`.
    """
    points = candidates.points
    size = candidates.image_size
    fit = selected.result.fit
    residuals = points.image - fit.project(points.ground)
    away = np.linalg.norm(residuals, axis=1)
    reach = max(NEAR, selected.limit)  # of less exact matching: what agrees is no other place
    near = away <= reach
    far = (away > reach) & np.isfinite(away)
    places = steady(selected).locate(grid(size, mapped.shape)[mapped.ravel()], heights)
    places = places[np.isfinite(places).all(axis=1)]
    sigma = selected.sigma(places) if len(places) else np.array([np.inf])
    agree = points.take(selected.agrees)
    start = candidates.rough
    correction = None
    if start is not None:
        correction = agree.image - start.project(_for_start(agree, candidates))
    return Evidence(
        float(sigma.max()), _covered(agree.image, shown, size),
        unsupported(agree.image, shown, size),
        structure(points.image[near], residuals[near], 2 * selected.limit, size,
                  np.random.default_rng([seed, 2])),
        other_place(points.image[far], residuals[far], TOLERANCE, size), correction,
        _pixel(agree, candidates.crs), along(selected, agree, size[0]), repetition)


def remarks(candidates: Candidates, selected: Selected, evidence: Evidence,
            accept: float) -> tuple[str, ...]:
    """Return what a user must look at, though the map may be right."""
    said = []
    if _matters(evidence, accept):
        found = evidence.structure
        assert found is not None
        said.append(f"Residuals of neighbours are alike: {found.size:.2f} px (permutation level "
                    f"{found.level:.3f}). They are largest in {found.where} of the image, "
                    f"{_vector(found.away)}. Is the reference a mosaic, or the model too simple?")
    if evidence.other is not None:
        found_there = evidence.other
        said.append(f"{found_there.count} candidates, most in {found_there.where} of the image, "
                    f"agree on another place, {_vector(found_there.away)} from where the model "
                    "sees them. Does the reference have a seam, or the ground repeat?")
    distance, alike = evidence.repetition
    if alike >= ALIKE:
        said.append(f"The reference repeats itself at a distance of {distance:.0f} of its pixels "
                    f"(correlation {alike:.2f}). If the start is off by half of that, the map may "
                    "be of another place.")
    if evidence.along.matters(accept):
        said.append(f"The correction changes along the lines by {evidence.along.size:.2f} px (RMS, "
                    "compared with a drift). It changes most near line "
                    f"{evidence.along.line:.0f}, {_vector(evidence.along.away)}. Jitter of the "
                    "attitude does so, and so do seams of the reference.")
    if selected.called_for is not None:
        said.append(f"Candidates call for {selected.called_for.text}, and do not determine it all "
                    f"over the map. {selected.correction.text} is taken instead; at held-out "
                    f"candidates it misses {selected.missed:.2f} px (RMS).")
    elif selected.missed:
        said.append(f"At held-out candidates the model misses {selected.missed:.2f} px (RMS), more "
                    "than matching is off. Does the reference have a seam, or is the model too "
                    "simple?")
    bare, where = evidence.bare
    if bare > _BARE:
        said.append(f"No candidate agrees in {100 * bare:.0f} % of what image and reference show, "
                    f"most in {where} of the image. Are there clouds or changes?")
    start = candidates.rough
    if evidence.correction is not None and start is not None and start.heights is not None:
        moved = float(np.median(np.linalg.norm(evidence.correction, axis=1))) * evidence.pixel
        usual = _STATED * start.bias if start.bias else _USUAL_BIAS
        if moved > usual:
            known = "its vendor states" if start.bias else "RPCs are usually wrong by"
            said.append(f"The correction of {moved:.0f} m is larger than {known} "
                        f"({usual:.0f} m at most). Are the heights right, and is it the RPC of "
                        "this image?")
        low, high = start.heights
        z = candidates.points.ground[selected.agrees, 2]
        if ((z < low) | (z > high)).mean() > _OUTSIDE:
            said.append(f"Heights of the DEM are {z.min():.0f} to {z.max():.0f} m, and the RPC is "
                        f"made for {low:.0f} to {high:.0f} m. Are they in metres, and of the "
                        "same vertical datum?")
    return tuple(said)


def reasons(selected: Selected, evidence: Evidence, accept: float) -> tuple[str, ...]:
    """Return why a result is not good enough."""
    refusals = []
    there = int(selected.independent.sum())
    agree = int(
        (selected.agrees & selected.independent).sum())
    if agree < _LEAST_INDEPENDENT:
        refusals.append(f"Only {agree} of {there} independent candidates agree with the model; at "
                        f"least {_LEAST_INDEPENDENT} must.")
    if selected.median > accept:
        refusals.append("Half of the independent candidates are more than "
                        f"{selected.median:.2f} px from the model; accepted are {accept:g} px.")
    if selected.rmse > accept:
        refusals.append(f"The RMSE of those that agree is {selected.rmse:.2f} px; accepted are "
                        f"{accept:g} px.")
    if not evidence.sigma <= accept:
        refusals.append(f"The predicted standard deviation is up to {evidence.sigma:.2f} px where "
                        f"the map would be; accepted are {accept:g} px. Give a larger reference, "
                        "or --extent reference.")
    found = evidence.structure
    if found is not None and found.level <= LEVEL and np.linalg.norm(found.away) > accept:
        refusals.append(f"In {found.where} of the image all candidates are off, "
                        f"{_vector(found.away)}; accepted are {accept:g} px.")
    if evidence.other is not None and evidence.other.count >= _RIVAL * selected.agrees.sum():
        refusals.append(f"{evidence.other.count} candidates agree on another place, and only "
                        f"{int(selected.agrees.sum())} on this one.")
    if _is_seam(evidence, accept):
        refusals.append(f"Near line {evidence.along.line:.0f} the correction changes "
                        f"{_vector(evidence.along.away)}, and candidates there agree on both "
                        "places: the reference has a seam.")
    return tuple(refusals)


def _is_seam(evidence: Evidence, accept: float) -> bool:
    """Return whether a correction along the lines follows a step of the reference.

    Jitter moves all that a line shows. At a seam candidates agree on two places, which differ by
    the step.
    """
    step = np.array(evidence.along.away)
    if evidence.other is None or np.linalg.norm(step) <= accept:
        return False
    other = np.array(evidence.other.away)
    return bool(min(np.linalg.norm(other - step), np.linalg.norm(other + step)) <= TOLERANCE)


@dataclass(frozen=True, eq=False)
class Georeferenced:
    """What came of an image.

    Parameters
    ----------
    candidates : Candidates
    selected : Selected
    evidence : Evidence
    accept : float
        Largest accepted error [px].
    reasons : tuple of str
        Why the result is not good enough; empty where it is.
    remarks : tuple of str
        What must be looked at.
    lines : Matched, optional
        The lines that are control too.
    unused : str
        Why vectors that were given are not used.
    bounds : tuple of float, optional
        Of the map in the CRS of the candidates, where it is not of all of the image.
    """

    candidates: Candidates
    selected: Selected
    evidence: Evidence
    accept: float
    reasons: tuple[str, ...]
    remarks: tuple[str, ...]
    lines: Matched | None = None
    unused: str = ""
    bounds: tuple[float, float, float, float] | None = None

    def text(self) -> str:
        """Return the report."""
        chosen = self.selected
        points = self.candidates.points
        agree = self.selected.agrees
        result = chosen.result
        evidence = self.evidence
        lines = [f"Start: {self.candidates.start}"]
        if evidence.correction is not None:
            moved = np.linalg.norm(evidence.correction, axis=1)
            lines.append(f"Correction to the start: {np.median(moved):.1f} px "
                         f"({np.median(moved) * evidence.pixel:.1f} m) in the median, up to "
                         f"{moved.max():.1f} px")
        found = self.candidates.cells.get("found", 0)
        cells = sum(self.candidates.cells.values())
        lines += [
            f"Candidates: {len(points)}" + (f" in {found} of {cells} cells of the image" if cells
                                            else ""),
            f"Agreeing within {chosen.limit:.2f} px: {int((agree & ~chosen.independent).sum())} of "
            f"{int((~chosen.independent).sum())} candidates for control and check",
            f"Model: {chosen.correction.text}, fitted to the "
            f"{result.features.points.roles.count('control')} for control",
            f"Covered by candidates that agree: {100 * evidence.covered:.0f} % of what image and "
            "reference show",
            f"Predicted standard deviation where the map is: at most {evidence.sigma:.2f} px",
            f"Independent candidates: {int((agree & chosen.independent).sum())} of "
            f"{int(chosen.independent.sum())} agree, with an RMSE of {chosen.rmse:.2f} px",
            f"Error of all of them, right or wrong: median {chosen.median:.2f} px, CE90 "
            f"{chosen.ce90:.2f} px; accepted: {self.accept:g} px",
            AGREEING]
        if evidence.structure is not None:
            lines.append(f"Residuals of neighbours have {evidence.structure.size:.2f} px in common "
                         f"(permutation level {evidence.structure.level:.3f})")
        names = [name for name, good in zip(points.ids, agree, strict=True) if not good]
        if names:
            more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
            lines.append(f"Candidates that disagree: {', '.join(names[:_NAMED])}{more}")
        if self.lines is not None:
            last = self.lines.rounds[-1]
            away = rms_distance(result.fit, result.features.lines)
            lines.append(f"Lines: {last.agreeing} of {last.pieces} straight pieces of vectors "
                         f"agree, with an RMS distance of {away:.2f} px")
        if self.unused:
            lines.append(f"Lines are not used, the map is by points alone: {self.unused}")
        for title, some in (("Look at this:", self.remarks), ("Not good enough:", self.reasons)):
            if some:
                lines += [title, *(f"  {one}" for one in some)]
        return "\n".join(lines) + "\n"


def _matters(evidence: Evidence, accept: float) -> bool:
    """Return whether the structure of residuals is neither by chance nor too small to matter."""
    found = evidence.structure
    return found is not None and found.level <= LEVEL and found.size > _STRUCTURE * accept


def _vector(away: tuple[float, float]) -> str:
    return f"by ({away[0]:+.1f}, {away[1]:+.1f}) px in line and sample"


def _for_start(points: Points, candidates: Candidates) -> FloatArray:
    """Return ground places in the CRS of the start, with its height where theirs is unknown."""
    assert candidates.rough is not None
    z = points.ground[:, 2]
    return np.column_stack([turned(points.ground[:, :2], candidates.crs, candidates.rough.crs),
                            np.where(np.isfinite(z), z, candidates.rough.height)])


def _covered(image: FloatArray, shown: Mask, size: tuple[int, int]) -> float:
    """Return the part of what image and reference show that is in the hull of points."""
    hull = shapely.convex_hull(shapely.MultiPoint(image))
    places = grid(size, shown.shape)[shown.ravel()]
    return float(shapely.contains_xy(hull, places[:, 0], places[:, 1]).mean())


def _pixel(points: Points, crs: str) -> float:
    """Return the size of a pixel on the ground [m], by the areas of the hulls of points."""
    lonlat = np.radians(turned(points.ground[:, :2], crs, "EPSG:4326"))
    plane = _EARTH * (lonlat - lonlat.mean(axis=0)) * [np.cos(lonlat[:, 1].mean()), 1.0]
    there, seen = (shapely.convex_hull(shapely.MultiPoint(places)).area
                   for places in (plane, points.image))
    return float((there / seen) ** 0.5) if seen > 0 else float("nan")
