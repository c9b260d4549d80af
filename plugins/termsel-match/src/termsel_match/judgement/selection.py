"""The candidates that agree with one model, and what the others say of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np

import termsel
from termsel import FeatureSet, Fit, Points, Result, TermselError, write_result
from termsel_match.images.rasters import FloatArray, Mask
from termsel_match.images.starts import transform_plane
from termsel_match.judgement.structures import (
    ModelCorrection,
    model_by_relief,
    plainest_supported_correction,
    supported_corrections,
)
from termsel_match.searching import features_by_search

AGREEING_PX = 2.0
"""Distance from the model at which a candidate counts half in the search [px]."""

NEAR_PX = 2 * AGREEING_PX
"""Distance within which candidates show the spread of those that agree [px]."""

_LEAST_CHECK = 2
"""Fewest agreeing selection points by which a correction is chosen."""

_SIGMAS = 3.5
"""Distance, in standard deviations of one axis, up to which a candidate agrees."""

_MIN_AGREEMENT = 0.5
"""Least distance up to which candidates agree, however exact the matching is [px]."""

_MISSED = 0.35
"""RMS error of the model itself above which it is reported [px]; right models have 0.2."""

_FIT_ROUNDS = 20
"""Most rounds of fitting to the candidates that agree, and looking anew which those are."""

_CHOICES = 2
"""How often the correction may be chosen anew."""

_WORSE = 1.1
"""RMSE of the selection points with lines, divided by that without, above which lines contradict
the points."""

AGREEING = ("Independent RMSE, NSSDA and ASPRS figures are of the independent candidates that "
            "agree with the model, without the others. They may be too small.")

_RAYLEIGH_MEDIAN = 1.1774
"""Median of a distance in the plane, in standard deviations of one axis: sqrt(2 ln 2)."""


@dataclass(frozen=True, eq=False)
class SelectedCandidates:
    """A model, and the candidates that agree with it.

    Parameters
    ----------
    result : Result
        A fit to the agreeing control points; its selection and independent points agree as well.
    agrees : ndarray of bool, shape (n,)
        Which candidates agree.
    independent : ndarray of bool, shape (n,)
        Which candidates took no part in the choice or the fit.
    limit : float
        Largest distance from the model at which a candidate agrees [px].
    points : Points
        All candidates.
    correction : ModelCorrection
        The model and its options.
    called_for : ModelCorrection, optional
        A richer correction that held-out candidates support, but do not determine all over the map.
    missed : float
        RMS error of the model at selection and independent points, without the noise of matching as
        far as that is known [px]. 0 if it is small and no richer correction is supported.
    """

    result: Result
    agrees: Mask
    independent: Mask
    limit: float
    points: Points
    correction: ModelCorrection
    called_for: ModelCorrection | None = None
    missed: float = 0.0

    @property
    def share(self) -> float:
        """Share of the independent candidates that agree."""
        return float(self.agrees[self.independent].mean())

    @property
    def median(self) -> float:
        """Median error [px] of all independent candidates, right or wrong."""
        return float(np.median(self._independent_figures()))

    @property
    def ce90(self) -> float:
        """Error [px] that nine in ten of all independent candidates do not exceed."""
        return float(np.quantile(self._independent_figures(), 0.9, method="higher"))

    @property
    def rmse(self) -> float:
        """RMSE [px] of the independent candidates that agree; infinite where none does."""
        rmse = self.result.rmse["independent"]
        return float("inf") if rmse is None else rmse.total

    def sigma(self, ground: FloatArray) -> FloatArray:
        """Return the standard deviation of the model at ground positions (n, 3), (n,) [px].

        It is that of `Fit.sigma`, both axes together, and of what the model is known to miss.
        Infinite where it is not known.
        """
        sigma = np.hypot(np.linalg.norm(self.result.fit.sigma(ground), axis=1), self.missed)
        return np.asarray(np.where(np.isfinite(sigma), sigma, np.inf))

    def _independent_figures(self) -> FloatArray:
        return _distances_from_fit(self.result.fit, self.points)[self.independent]


def select_points(features: FeatureSet, model: str, options: Mapping[str, Any], *,
                  accept: float = AGREEING_PX, plainer_than: ModelCorrection | None = None,
                  seed: int = 1, folder: Path | str | None = None) -> SelectedCandidates:
    """Return the model with which most candidates agree.

    A quarter of the candidates is set aside as independent, unless some are so already. A
    steady-state GA selects as many of the others as the model has terms, or 6 if it has fewer, so
    that the model agrees with as many as possible (problem `rpc-gcps`, criterion `agreement`). The
    model is then fitted to all of them that agree, until they stay the same. Of an RPC, the
    correction is the plainest that held-out candidates support: a shift, a drift, affine, or smooth
    along the lines. An affine model has no heights where those of all candidates are on one plane.

    Parameters
    ----------
    features : FeatureSet
        Candidate points, with heights.
    model : str
        Name of a model.
    options : mapping
        Options of the model.
    accept : float
        Largest accepted error [px]. A candidate that is further off does not agree, unless the
        matching is less exact.
    plainer_than : ModelCorrection, optional
        A correction that is too rich: only plainer ones are chosen from.
    seed : int
        Seed by which roles are drawn and the search runs.
    folder : path-like, optional
        Folder for the result; with `plainer_than` it replaces the one that is there.

    Raises
    ------
    TermselError
        If too few agree to determine the model.
    """
    points = features.points
    # Independent candidates take no part in the search, the fits or the choice of the correction.
    roles = _draw_roles(points, seed)
    independent = roles == "independent"
    with_roles = features.with_(points=replace(points, roles=tuple(roles)))

    def fitted(correction: ModelCorrection, used: Mask) -> Fit:
        return correction.fit(FeatureSet(points.take(used), crs=features.crs))

    correction = model_by_relief(model, options, features)
    model, options = correction.model, correction.options
    n_terms = len(fitted(correction, ~independent).terms)
    _require_control(roles, n_terms)
    # The search finds a few candidates that determine a model with which many agree.
    picked = np.isin(points.ids, features_by_search(
        "rpc-gcps", with_roles, model, {
            **options, "half_at": AGREEING_PX, "max_uncovered": 0.9,
            "min_features": max(6, n_terms), "max_features": max(6, n_terms),
            # The fit to all that agree comes next, and needs no better place to begin.
            "polish": False}, seed=seed, criterion="agreement"))
    # A spread that a fault of the reference has made is not the spread of matching.
    max_limit = (
        accept if points.sigma is None else max(accept, _SIGMAS * float(np.median(points.sigma)))
    )
    fit = fitted(correction, picked)
    # Each round fits to all that agree, then looks whether these support another correction.
    for choice in range(_CHOICES + 1):
        agrees = np.zeros(0, dtype=bool)
        limit = 0.0
        for _ in range(_FIT_ROUNDS):
            before = agrees
            errors = _distances_from_fit(fit, points)
            agrees, limit = _agreeing_candidates(errors, ~independent, max_limit)
            _require_enough(agrees, roles, len(fit.terms) // 2 if choice else n_terms)
            if np.array_equal(agrees, before):
                break
            fit = fitted(correction, agrees)
        # Jitter moves good candidates beyond the limit: all that are near have a say.
        near = ~independent & (errors <= NEAR_PX)
        several = supported_corrections(model, options, int(near.sum()))
        plainer = list(takewhile(lambda correction: correction != plainer_than, several))
        close = FeatureSet(points.take(near), crs=features.crs)
        better = plainest_supported_correction(plainer, close, seed)
        if better == correction or choice == _CHOICES:
            break
        correction = better
        fit = fitted(correction, near)
    agrees = _distances_from_fit(fit, points) <= limit
    _require_enough(agrees, roles, len(fit.terms) // 2)
    agreeing = with_roles.with_(points=with_roles.points.take(agrees))
    result = _with_note(termsel.run(
        "owdis-points", features=agreeing, model=correction.model, solver="all-terms",
        options={**correction.options, **_options_for_all_control(agreeing)}, seed=seed, out=folder,
        overwrite=plainer_than is not None), folder)
    # Where nothing richer is supported, those that do not agree are wrong matches.
    missed = _rms_at_unused(result.fit, points.take(
        (roles != "control") & (agrees | (plainer_than is not None))))
    if plainer_than is None and missed <= (_MISSED if points.sigma is not None else accept / 2):
        missed = 0.0
    return SelectedCandidates(result=result, agrees=agrees, independent=independent, limit=limit,
                              points=points, correction=correction, called_for=plainer_than,
                              missed=missed)


def _options_for_all_control(features: FeatureSet) -> dict[str, Any]:
    """Return the options by which a run uses all control points and lines, without a selection."""
    control = features.points.take(np.array(features.points.roles, dtype=object) == "control")
    return {"min_features": len(features.with_(points=control)), "blunders": "keep"}


def _require_control(roles: Any, n_terms: int) -> None:
    """Raise TermselError unless enough candidates were drawn as control to search among them."""
    control = int((roles == "control").sum())
    if control < max(6, n_terms):
        raise TermselError(f"not enough candidates: {len(roles)} found, of which {control} can be "
                           f"control, and the correction needs at least {max(6, n_terms)}",
                           hint="Give a start that is nearer, a larger --search, or a reference "
                                "that looks more like the image.")


def _require_enough(agrees: Mask, roles: Any, n_terms: int) -> None:
    """Raise TermselError unless enough candidates agree to fit `n_terms` and to choose by others.

    `agrees` (n,) is which candidates agree, `roles` (n,) are their roles.
    """
    control, check = (int((agrees & (roles == role)).sum()) for role in ("control", "check"))
    if control < max(6, n_terms) or check < _LEAST_CHECK:
        raise TermselError(f"not enough candidates agree: {control + check} of "
                           f"{int((roles != 'independent').sum())}",
                           hint="Most matches are wrong. Give a start that is nearer, a larger "
                                "--search, or another reference: where fields or roofs are alike, "
                                "each place has many matches. Or measure points by hand.")


def with_lines(selected: SelectedCandidates, lines: FeatureSet, *, seed: int = 1,
               folder: Path | str | None = None) -> SelectedCandidates:
    """Return the model fitted to the points that agree and to lines together.

    Points and lines are weighted by their standard deviations. The selection points, which neither
    fit uses, must not be much further from this fit than from that to the points alone.

    Parameters
    ----------
    selected : SelectedCandidates
        The model by points alone.
    lines : FeatureSet
        Lines in the CRS of the points or in another one.
    seed, folder
        As for `select_points`; an earlier result in the folder is replaced.

    Raises
    ------
    TermselError
        If the lines contradict the points.
    """
    model = selected.correction.model
    options = selected.correction.options
    features = selected.result.features
    ground = lines.lines.ground.copy()
    ground[..., :2] = transform_plane(ground[..., :2], lines.crs, features.crs)
    with_both = features.with_(lines=replace(lines.lines, ground=ground))
    control = features.points.roles == np.array("control", dtype=object)
    used = with_both.with_(points=replace(features.points.take(control), roles=()))
    check = features.points.take(features.points.roles == np.array("check", dtype=object))
    # Selection points are in neither fit, and so can judge between both.
    rms_alone, rms_with_lines = (_rms_distance(fitted, check) for fitted in (
        selected.result.fit, termsel.fit(used, model, **options)))
    if rms_with_lines > _WORSE * rms_alone:
        raise TermselError(
            "points and lines contradict each other: selection points are "
            f"{rms_with_lines:.2f} px from the model of both, and {rms_alone:.2f} px from that of "
            "the points",
            hint="Give vectors that agree with the reference, or match points alone.")
    result = _with_note(termsel.run(
        "owdis-lines", features=with_both, model=model, solver="all-terms",
        options={**options, "mixed": True, **_options_for_all_control(with_both)},
        seed=seed, out=folder, overwrite=True), folder)
    return replace(selected, result=result)


def _with_note(result: Result, folder: Path | str | None) -> Result:
    """Return a result with a note that its independent figures are of agreeing candidates alone.

    With a folder, the result there is replaced by the one with the note.
    """
    noted = result.with_(notes=(*result.notes, AGREEING))
    if folder is not None:
        write_result(noted, Path(folder))
    return noted


def _draw_roles(points: Points, seed: int) -> Any:
    """Return roles (n,) of points, drawn by a seed.

    Of four neighbours in line one becomes a selection point and one independent, so that each role
    is found all along the image. If some points are independent already, no others become so.
    """
    roles = np.array(points.roles, dtype=object)
    free = np.flatnonzero(roles != "independent")
    drawn = ["check", "control", "control",
             "independent" if len(free) == len(roles) else "control"]
    free = free[np.argsort(points.image[free, 0], kind="stable")]
    rng = np.random.default_rng([seed, 1])
    for first in range(0, len(free), len(drawn)):
        neighbours = free[first:first + len(drawn)]
        roles[neighbours] = rng.permutation(np.array(drawn, dtype=object))[:len(neighbours)]
    return roles


def _distances_from_fit(fitted: Fit, points: Points) -> FloatArray:
    """Return the distances (n,) [px] of points from a fit; infinite where it does not project."""
    errors = np.linalg.norm(points.image - fitted.project(points.ground), axis=1)
    return np.asarray(np.where(np.isfinite(errors), errors, np.inf))


def _rms_distance(fitted: Fit, points: Points) -> float:
    """Return the root mean square distance [px] of points from a fit."""
    return float(np.sqrt((_distances_from_fit(fitted, points) ** 2).mean()))


def _rms_at_unused(fit: Fit, points: Points) -> float:
    """Return the RMS error of a fit at candidates that it does not use, without noise [px].

    Candidates that do not agree count as well, as they show best what the model misses; only those
    beyond 3.5 standard deviations, by the median, are left out as blunders. Noise is subtracted
    where standard deviations are stated: as much as they say, but not more than the differences of
    neighbours in line show. Infinite if there are too few candidates.
    """
    errors = (points.image - fit.project(points.ground))[np.argsort(points.image[:, 0])]
    squares = (errors**2).sum(axis=1)
    errors = errors[np.isfinite(squares)]
    squares = squares[np.isfinite(squares)]
    if len(squares) < _LEAST_CHECK:
        return float("inf")
    # The median distance is Rayleigh's median times the standard deviation of an axis.
    right = squares <= _SIGMAS**2 * np.median(squares) / _RAYLEIGH_MEDIAN**2
    noise = 0.0
    if points.sigma is not None:
        # Neighbours in line differ by noise alone, with 2 sigma^2 in each axis. That is also the
        # noise of both axes together, sigma^2 each, which is wanted here.
        steps = (np.diff(errors[right], axis=0)**2).sum(axis=1)
        noise = float(min(np.median((points.sigma**2).sum(axis=1)),
                          np.median(steps) / _RAYLEIGH_MEDIAN**2))
    return float(np.sqrt(max(squares[right].mean() - noise, 0.0)))


def _agreeing_candidates(errors: FloatArray, used: Mask, max_limit: float) -> tuple[Mask, float]:
    """Return which candidates in use agree, (n,), and the largest error that counts so [px].

    This limit is 3.5 standard deviations of the candidates near the model, but at most `max_limit`
    and at least 0.5 px.
    """
    # The median of those that are near is hardly changed by blunders.
    near = errors[used & (errors < NEAR_PX)]
    sigma = float(np.median(near)) / _RAYLEIGH_MEDIAN if len(near) else 0.0
    limit = max(min(_SIGMAS * sigma, max_limit), _MIN_AGREEMENT)
    return np.asarray(used & (errors <= limit)), limit

