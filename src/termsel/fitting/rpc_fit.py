"""RPCs from fitted models: taken over as they are, or fitted to a grid."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from termsel.core.arguments import CALLED_LOCATE, CALLED_PROJECT, Explained, explains_arguments
from termsel.core.errors import TermselError
from termsel.data.coordinates.crs import WGS84, normalise, to_wgs84
from termsel.data.coordinates.longitudes import nearest_longitudes
from termsel.data.features import BoolArray, FeatureSet, FloatArray, Points, select
from termsel.data.fingerprints import with_control_record
from termsel.data.monomials import RPC00B
from termsel.data.rpc import N_COEFFICIENTS, Rpc
from termsel.data.scaling import make_scaling
from termsel.fitting.datum_accuracy import say_stand_in
from termsel.fitting.fit import Fit
from termsel.fitting.least_squares import fit
from termsel.fitting.sky import part_said, refuse_sky
from termsel.models.base import SensorModel
from termsel.models.quotient import RationalFunctions
from termsel.models.terms import AXES, Term

log = logging.getLogger(__name__)

EXACT_PX = 1e-6
"""Largest difference [px] between the model and an RPC that is taken over."""

GOOD = 0.05
"""Largest loss [px] at which the selected terms are kept rather than all."""

_GRID_SIDE = 21  # places along either side of the image
_N_LEVELS = 7  # heights
_RIDGES = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)  # weights that hold denominators, of equations in scale
_POLE_BOX = 1.1  # half side of the box in which denominators are looked at, by that of the ground
_N_POLE_PLACES = 5000  # drawn in it
_MIN_DENOMINATOR = 0.05  # of a denominator, which is 1 in the middle


@dataclass(frozen=True)
class RpcFit(Explained):
    """An RPC and its distance from the model it replaces.

    `how` is "exact" if it was taken over as it is, "its own" if the model knows it; else the terms
    it was refitted with: "the selected", "all 78", "all 78 (small denominators)" or "all 40
    polynomial". Greatest and root mean square distance from the fitted model [px] are over the
    image and the heights, between the places the RPC was fitted to. `excluded_part` says which part
    of an oblique image the RPC does not follow; `heights` are the least and the largest that it was
    refitted to, None where it was taken over.
    """

    elsewhere: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("project", *CALLED_PROJECT), "The RPC does it: .rpc.project(places)."),
        **dict.fromkeys(("locate", *CALLED_LOCATE), "The fit does it: fit.locate(image, heights)."),
        "[]": "Its RPC is .rpc."}

    rpc: Rpc
    how: str
    worst: float
    rms: float
    excluded_part: str = ""
    heights: tuple[float, float] | None = None


@explains_arguments()
def rpc_of(fitted: Fit, heights: tuple[float, float] | None = None) -> RpcFit:
    """Return the RPC of a fitted model, and its deviation from the model.

    Parameters
    ----------
    fitted : Fit
        A fit of any model, in any CRS that can be converted to WGS84.
    heights : tuple of float, optional
        Least and largest height that the RPC is for, by default those of the control.

    Returns
    -------
    RpcFit
        With the RPC, which carries what its control is recognised by, and its largest distance from
        the model [px].

    Raises
    ------
    TermselError
        If the ground coordinates cannot be converted to WGS84 longitude and latitude, the model
        cannot be inverted over the image, no RPC comes near it, or the image shows the sky.

    Notes
    -----
    A rational function of scaled WGS84 coordinates has the coefficients of an RPC: they are
    taken over. Another model may know its RPC itself (`SensorModel.as_rpc`). Otherwise an RPC
    is fitted to a grid of image places and heights, as RPCs are made from rigorous models
    (terrain-independent; Tao and Hu, "A comprehensive study of the rational function model for
    photogrammetric processing", PE&RS 67 (2001) 1347-1357): with the selected terms, and with
    all of them where that loses more than 0.05 px. Where no cubic follows the image, as in ground
    range, denominators follow its noise up to a pole; there their coefficients are held near zero.
    How far a fitted RPC is from the model is logged, as a warning above 0.05 px, and so is a part
    of the image that it leaves out.

    Examples
    --------
    >>> import termsel
    >>> features = termsel.simulate_scene("ikonos-hamedan")
    >>> fitted = termsel.fit(features, "poly3d", degree=2)
    >>> termsel.rpc_of(fitted).rpc.project([[48.5, 34.8, 1850.0]]).shape
    (1, 2)
    """
    best = closest_rpc(fitted, heights)
    say_stand_in(fitted, "EPSG:4979")
    # Without heights of its own it is the model itself, and there is nothing to tell.
    if best.heights is not None:
        low, high = best.heights
        log.log(logging.INFO if best.worst <= GOOD else logging.WARNING,
                "RPC: refitted to the model in longitude, latitude and height with %s terms. It "
                "differs from the model by at most %.2g px (rms %.2g px), over the image%s.",
                best.how, best.worst, best.rms,
                "; the points have no heights, so it ignores relief" if low == high
                else f" and heights from {low:.0f} to {high:.0f} m")
        if best.excluded_part:
            log.warning("Warning: %s. The RPC follows the model in the rest alone.",
                        best.excluded_part)
    return replace(best, rpc=with_control_record(best.rpc, fitted.control))


def closest_rpc(fitted: Fit, heights: tuple[float, float] | None = None) -> RpcFit:
    """Return the RPC of a fitted model as `rpc_of`, but without warnings of what it loses.

    A map needs an RPC on the way, for which nobody asked.

    Heights are the lowest and the highest [m] at which it has to hold. Raises TermselError where no
    RPC comes near the model, and where the model has no ground position for over a fifth of the
    image.
    """
    convert = to_wgs84(fitted.control.crs)
    refuse_sky(fitted, "an RPC")
    excluded_part = part_said(fitted)
    model = fitted.model
    # In the order of their worth: the model's own RPC, coefficients taken over, a refit.
    rpc = declared = (model.as_rpc(fitted.adjustment.coefficients)
                      if isinstance(model, SensorModel) else None)
    if rpc is None and normalise(fitted.control.fit_crs or fitted.control.crs) in WGS84:
        rpc = with_coefficients(fitted)
    if rpc is not None:
        control_ground, expected = _places_in_image(fitted, heights)
        if declared is not None and not len(control_ground):
            control_ground = fitted.control.ground_vertices()
            expected = fitted.project(control_ground)
        worst, rms = _distance_from_model(rpc, convert(control_ground), expected)
        if worst <= (EXACT_PX if declared is None else GOOD):
            kind = "exact" if worst <= EXACT_PX else "its own"
            return RpcFit(rpc, kind, worst, rms, excluded_part)
    low, high = heights or _range_of_heights(fitted)
    image, ground = _grid_on_ground(fitted, convert, _GRID_SIDE, np.linspace(low, high, _N_LEVELS))
    # One place and one level fewer, so that the check lies between the places of the fit.
    between, ground_between = _grid_on_ground(fitted, convert, _GRID_SIDE - 1,
                                              np.linspace(low, high, _N_LEVELS - 1))
    if low == high:
        # A level of another datum is no level in WGS84. Positions at a single height say nothing
        # of the effect of heights: an RPC that followed these small differences would invent one.
        level = ground[:, 2].mean()
        ground[:, 2] = ground_between[:, 2] = level
    candidates = []
    for how, terms, ridge in _term_sets(fitted):
        rpc = _refit_rpc(image, ground, terms, ridge)
        loss = (np.inf, np.inf) if _has_pole(rpc, ground) else _distance_from_model(rpc,
                                                                                    ground_between,
                                                                                    between)
        candidates.append(RpcFit(rpc, how, *loss, excluded_part))
        if candidates[-1].worst <= GOOD:
            break
    best = min(candidates, key=lambda candidate: candidate.worst)
    if not np.isfinite(best.worst):
        raise TermselError("no RPC comes near this model",
                           hint="Export it as geolocation-vrt or gcp-grid-vrt.")
    return replace(best, heights=(low, high))


def with_coefficients(fitted: Fit) -> Rpc | None:
    """Return the RPC with the coefficients of a fit in longitude, latitude and height.

    Returns None if the model's terms are not those of an RPC.
    """
    above = np.zeros((2, N_COEFFICIENTS))
    below = np.zeros((2, N_COEFFICIENTS))
    below[:, 0] = 1.0
    for name, value in zip(fitted.model.terms, fitted.adjustment.coefficients, strict=True):
        if value == 0:
            continue
        # Each coefficient goes to its place in RPC00B order; one of both axes to both.
        term = Term.parse(name)
        column = _column_of_term(term)
        if column is None:
            return None
        axis = slice(None) if term.axis == "both" else AXES.index(term.axis)
        (below if term.is_denominator else above)[axis, column] += value
    scaling = fitted.scaling
    lon, lat, height = scaling.ground_offset
    # Longitudes may go on beyond 180 degrees; an RPC's offset does not.
    return Rpc(image_offset=scaling.image_offset, image_scale=(scaling.image_scale,) * 2,
               ground_offset=(float(nearest_longitudes(np.array(lon), 0.0)), lat, height),
               ground_scale=scaling.ground_scale,
               line_numerator=tuple(above[0]), line_denominator=tuple(below[0]),
               sample_numerator=tuple(above[1]), sample_denominator=tuple(below[1]))


def _column_of_term(term: Term) -> int | None:
    """Return the place of a term's coefficient in RPC00B order; None if an RPC has none."""
    if term.part not in ("numerator", "denominator") or isinstance(term.exponents, str):
        return None
    return RPC00B.index(term.exponents) if term.exponents in RPC00B else None


def _term_sets(fitted: Fit) -> Iterator[tuple[str, BoolArray, float]]:
    """Yield the ways to refit, best first: a name, the mask of terms (78,), and a ridge parameter.
    """
    terms = [Term.parse(name) for name in RationalFunctions().terms]
    selected = [Term.parse(name) for name in select(fitted.model.terms, fitted.terms)]
    if all(_column_of_term(term) is not None for term in selected):
        # A shared denominator becomes one each, as it is in an RPC.
        yield "the selected", np.array([term in selected or term.shared in selected
                                        for term in terms]), 0.0
    all_terms = np.ones(len(terms), dtype=bool)
    yield "all 78", all_terms, 0.0
    for ridge in _RIDGES:
        yield "all 78 (small denominators)", all_terms, ridge
    # Without denominators there are no poles.
    yield "all 40 polynomial", np.array([not term.is_denominator for term in terms]), 0.0


def _range_of_heights(fitted: Fit) -> tuple[float, float]:
    """Return the least and the largest height of the control and of the known image; 0, 0 without.
    """
    heights = fitted.control.ground_vertices()[:, 2]
    heights = heights[np.isfinite(heights)]
    known_image = fitted.model.known_image()
    if known_image is not None:
        heights = np.concatenate([heights, known_image.area[:, 2]])
    return (float(heights.min()), float(heights.max())) if heights.size else (0.0, 0.0)


def _places_in_image(fitted: Fit,
                     heights: tuple[float, float] | None) -> tuple[FloatArray, FloatArray]:
    """Return places (n, 3) all over the ground of the control, and where they are in the image.

    The image positions are (n, 2) [px]; places outside the image are left out. `heights` are the
    least and the largest height, None for those of the control.
    """
    # A fixed seed: the same fit has the same RPC.
    share = np.random.default_rng(0).uniform(-1.0, 1.0, (1000, 3))
    middle, half = fitted.ground_box()
    if heights is not None:
        middle[2] = (heights[0] + heights[1]) / 2.0
        half[2] = (heights[1] - heights[0]) / 2.0
    ground = middle + share * half
    image = fitted.project(ground)
    low, high = fitted.image_box()
    inside = ((image >= low) & (image <= high)).all(axis=1) & fitted.holds(ground)
    return ground[inside], image[inside]


_LEAST_SEEN = 0.8
"""Share of the image for which a model must have ground positions to be written as an RPC."""


def _grid_on_ground(fitted: Fit, convert: Callable[[FloatArray], FloatArray], across: int,
                    levels: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a grid of image positions (n, 2) and their ground positions in WGS84, (n, 3).

    The grid has `across` lines and as many samples at each of the heights `levels`. `convert` takes
    ground positions from the CRS of the fit to WGS84. Places where the model does not hold are left
    out.

    Raises TermselError where the model has no ground position for more than a fifth of the grid,
    before those are left out.
    """
    steps = np.unique(levels)
    (first_line, first_sample), (last_line, last_sample) = fitted.image_box()
    lines = np.linspace(first_line, last_line, across)
    samples = np.linspace(first_sample, last_sample, across)
    # Every line with every sample at every height: three columns.
    image = np.stack([axis.ravel() for axis in np.meshgrid(lines, samples, steps)], axis=1)
    ground = fitted.locate(image[:, :2], image[:, 2])
    is_seen = np.isfinite(ground).all(axis=1)
    if is_seen.mean() < _LEAST_SEEN:
        raise TermselError(
            f"the model has no ground position for {1 - is_seen.mean():.0%} of the image",
            hint="Do not use it: choose a simpler model or fewer terms, or measure more points.")
    is_seen &= fitted.holds(ground)
    return image[is_seen, :2], convert(ground[is_seen])


def _refit_rpc(image: FloatArray, ground: FloatArray, terms: BoolArray, ridge: float = 0.0) -> Rpc:
    """Return an RPC with the terms of a mask (78,), fitted to positions of the model.

    These are `image` (n, 2) [px] of `ground` (n, 3), longitude, latitude [deg] and height [m]. The
    coefficients of denominators are held near zero by `ridge`, unless it is 0.
    """
    model = RationalFunctions(ridge=ridge)
    if np.ptp(ground[:, 2]) < 1e-6:
        # At a single height all terms with Z are constants times others.
        terms = terms & np.array(["Z" not in Term.parse(name).column for name in model.terms])
    points = Points(tuple(map(str, range(len(image)))), image, ground)
    control = FeatureSet(points, crs="EPSG:4979")
    rpc = with_coefficients(fit(model, control, make_scaling(control), terms))
    assert rpc is not None  # the terms are those of an RPC
    return rpc


def _has_pole(rpc: Rpc, ground: FloatArray) -> bool:
    """Return whether a denominator comes near zero in a box wider than that of some ground."""
    share = np.random.default_rng(0).uniform(-_POLE_BOX, _POLE_BOX, (_N_POLE_PLACES, 3))
    low = ground.min(axis=0)
    high = ground.max(axis=0)
    below = rpc.denominators((low + high) / 2.0 + share * (high - low) / 2.0)
    return bool((below < _MIN_DENOMINATOR).any())


def _distance_from_model(rpc: Rpc, ground: FloatArray, image: FloatArray) -> tuple[float, float]:
    """Return the largest distance [px] between RPC and model, and its root mean square.

    The model has the places `ground` (n, 3), as the RPC takes them, at `image` (n, 2) [px].
    """
    if not len(ground):
        return float("inf"), float("inf")
    # A pole gives an infinite distance, which refuses the RPC.
    with np.errstate(all="ignore"):
        distance = np.hypot(*(rpc.project(ground) - image).T)
    worst = float(distance.max())
    rms = float(np.sqrt((distance**2).mean()))
    return (worst, rms) if np.isfinite(worst) else (float("inf"), float("inf"))
