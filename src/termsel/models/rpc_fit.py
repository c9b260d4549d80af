"""RPCs from fitted models: taken over as they are, or fitted anew."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from termsel.errors import TermselError
from termsel.fits.fit import Fit, fit
from termsel.measurements.crs import WGS84, normalise, to_wgs84
from termsel.measurements.features import BoolArray, FeatureSet, FloatArray, Points
from termsel.measurements.scaling import scaling_of
from termsel.models.base import SensorModel
from termsel.models.monomials import RPC00B
from termsel.models.rational import RationalFunctions
from termsel.models.rpc import N_COEFFICIENTS, Rpc

log = logging.getLogger(__name__)

EXACT = 1e-6
"""Pixels by which an RPC that was taken over may differ from the model."""

GOOD = 0.05
"""Pixels of loss up to which the selected terms are kept rather than all."""

_TERM = re.compile(r"(?:(line|sample)\.)?(num|den):(1|(?:X\d?)?(?:Y\d?)?(?:Z\d?)?)")
_GRID, _LEVELS = 21, 7  # places along either side of the image, and heights


@dataclass(frozen=True)
class RpcFit:
    """An RPC and how far it is from the model it stands for.

    Parameters
    ----------
    rpc : Rpc
    how : str
        "exact" where it was taken over as it is; else the terms it was fitted anew with:
        "the selected", "all 78" or "all 40 polynomial".
    worst, rms : float
        Greatest and root mean square distance from the fitted model [pixel], over the image
        and the heights of the control, between the places the RPC was fitted to.
    """

    rpc: Rpc
    how: str
    worst: float
    rms: float


def rpc_of(fitted: Fit) -> RpcFit:
    """Return the RPC of a fitted model, and say what it costs.

    Parameters
    ----------
    fitted : Fit

    Raises
    ------
    TermselError
        If the ground coordinates cannot be turned into WGS84 longitude and latitude, the model
        cannot be inverted over the image, or no RPC comes near it.

    Notes
    -----
    A rational function of scaled WGS84 coordinates has the coefficients of an RPC: they are
    taken over. Another model may know its RPC itself (`SensorModel.as_rpc`). Otherwise an RPC
    is fitted to a grid of image places and heights, as RPCs are made from rigorous models
    (terrain-independent; Tao and Hu, "A comprehensive study of the rational function model for
    photogrammetric processing", PE&RS 67 (2001) 1347-1357): with the selected terms, and with
    all of them where that loses more than 0.05 pixel.
    """
    convert = to_wgs84(fitted.control.crs)
    model = fitted.model
    rpc = (model.as_rpc(fitted.adjustment.coefficients) if isinstance(model, SensorModel)
           else None)
    if rpc is None and normalise(fitted.control.fit_crs or fitted.control.crs) in WGS84:
        rpc = taken_over(fitted)
    if rpc is not None:
        places, seen = _seen(fitted)
        worst, rms = _loss(rpc, convert(places), seen)
        if worst <= EXACT:
            return RpcFit(rpc, "exact", worst, rms)
    image, ground = _grid(fitted, convert, _GRID, _LEVELS)
    between, ground_between = _grid(fitted, convert, _GRID - 1, _LEVELS - 1)
    candidates = []
    for how, terms in _term_sets(fitted):
        rpc = _fitted_anew(image, ground, terms)
        candidates.append(RpcFit(rpc, how, *_loss(rpc, ground_between, between)))
        if candidates[-1].worst <= GOOD:
            break
    best = min(candidates, key=lambda one: one.worst)
    if not np.isfinite(best.worst):
        raise TermselError("no RPC comes near this model",
                           hint="Export it as geolocation-vrt or gcp-grid-vrt.")
    log.log(logging.INFO if best.worst <= GOOD else logging.WARNING,
            "RPC: fitted anew to the model in longitude, latitude and height with %s terms. It "
            "differs from the model by at most %.2g px (rms %.2g px).", best.how, best.worst,
            best.rms)
    return best


def taken_over(fitted: Fit) -> Rpc | None:
    """Return the RPC with the coefficients of a fit, or None if its terms are not an RPC's.

    Parameters
    ----------
    fitted : Fit
        In longitude, latitude and height.
    """
    above, below = np.zeros((2, N_COEFFICIENTS)), np.zeros((2, N_COEFFICIENTS))
    below[:, 0] = 1.0
    for name, value in zip(fitted.model.terms, fitted.adjustment.coefficients, strict=True):
        if value == 0:
            continue
        place = _place(name)
        if place is None:
            return None
        axes, part, column = place
        for axis in axes:
            (above if part == "num" else below)[axis, column] += value
    scaling = fitted.scaling
    return Rpc(scaling.image_offset, (scaling.image_scale,) * 2, scaling.ground_offset,
               scaling.ground_scale, tuple(above[0]), tuple(below[0]), tuple(above[1]),
               tuple(below[1]))


def _place(name: str) -> tuple[tuple[int, ...], str, int] | None:
    """Return axes, part and column of a term's coefficient in an RPC; None if it has none."""
    match = _TERM.fullmatch(name)
    if match is None or not match[3]:
        return None
    exponent = tuple(int((re.search(rf"{letter}(\d?)", match[3]) or "00")[1] or 1)
                     for letter in "XYZ")
    if exponent not in RPC00B:
        return None
    axes = {"line": (0,), "sample": (1,), None: (0, 1)}[match[1]]
    return axes, match[2], RPC00B.index(exponent)


def _term_sets(fitted: Fit) -> Iterator[tuple[str, BoolArray]]:
    """Yield what to fit anew with: names and masks of terms of the full model."""
    terms = RationalFunctions().terms
    names = [name for name, on in zip(fitted.model.terms, fitted.terms, strict=True) if on]
    if all(_place(name) for name in names):
        # A shared denominator becomes one each, as it is in an RPC.
        wanted = {f"{axis}.{name}" if name.startswith("den:") else name
                  for name in names for axis in ("line", "sample")}
        yield "the selected", np.array([name in wanted for name in terms])
    yield "all 78", np.ones(len(terms), dtype=bool)
    # Without denominators there are no poles.
    yield "all 40 polynomial", np.array([".num:" in name for name in terms])


def _seen(fitted: Fit) -> tuple[FloatArray, FloatArray]:
    """Return places all over the ground of the control that lie in the image, and where."""
    share = np.random.default_rng(0).uniform(-1.0, 1.0, (1000, 3))
    middle, half = fitted.ground_box()
    ground = middle + share * half
    image = fitted.project(ground)
    low, high = fitted.image_box()
    inside = ((image >= low) & (image <= high)).all(axis=1)
    return ground[inside], image[inside]


def _grid(fitted: Fit, convert: Callable[[FloatArray], FloatArray], across: int, levels: int,
          ) -> tuple[FloatArray, FloatArray]:
    """Return image places and where they see the ground at several heights, in WGS84."""
    heights = fitted.control.ground_vertices()[:, 2]
    heights = heights[np.isfinite(heights)]
    low, high = (heights.min(), heights.max()) if heights.size else (0.0, 0.0)
    steps = np.linspace(low, high, levels) if high > low else [low]
    (top, left), (bottom, right) = fitted.image_box()
    image = np.stack([axis.ravel() for axis in np.meshgrid(
        np.linspace(top, bottom, across), np.linspace(left, right, across), steps)], axis=1)
    ground = fitted.locate(image[:, :2], image[:, 2])
    seen = np.isfinite(ground).all(axis=1)
    if seen.mean() < 0.8:
        raise TermselError(
            f"the fitted model says for {1 - seen.mean():.0%} of the image not what ground is "
            "seen there", hint="It is not fit for use: choose a plainer model, or fewer terms.")
    return image[seen, :2], convert(ground[seen])


def _fitted_anew(image: FloatArray, ground: FloatArray, terms: BoolArray) -> Rpc:
    model = RationalFunctions()
    if np.ptp(ground[:, 2]) < 1e-6:
        terms = terms & np.array(["Z" not in name.partition(":")[2] for name in model.terms])
    points = Points(tuple(map(str, range(len(image)))), image, ground)
    control = FeatureSet(points, crs="EPSG:4979")
    rpc = taken_over(fit(model, control, scaling_of(control), terms))
    assert rpc is not None  # the terms are those of an RPC
    return rpc


def _loss(rpc: Rpc, ground: FloatArray, image: FloatArray) -> tuple[float, float]:
    if not len(ground):
        return float("inf"), float("inf")
    with np.errstate(all="ignore"):
        distance = np.hypot(*(rpc.project(ground) - image).T)
    worst, rms = float(distance.max()), float(np.sqrt((distance**2).mean()))
    return (worst, rms) if np.isfinite(worst) else (float("inf"), float("inf"))
