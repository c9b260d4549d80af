"""From the image to the ground: where the rays of image points meet heights or terrain."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from termsel.core.errors import TermselError
from termsel.data.arrays import FloatArray, IntArray

Projection = Callable[[FloatArray], FloatArray]
"""Line and sample, shape (n, 2), of ground points, shape (n, 3)."""

Surface = Callable[[FloatArray], FloatArray]
"""Heights, shape (n,), of plane ground coordinates, shape (n, 2); NaN where there are none."""

LOCATE_TOLERANCE = 1e-6
"""Largest distance [px] between the image point and the projection of its ground point."""

_NEWTON_STEPS, _STARTS_KEPT = 24, 3
_WORSE, _SHORTER = 2.0, 8
_SECANTS, _BISECTIONS = 20, 40
_LOWER_TOPS = 6
_MOST_STEPS, _RAYS_AT_ONCE = 2000, 500
_AT_SURFACE, _CLOSE = 1e-6, 1e-3  # in the unit of height; both far less than 1 px
_FAR_RANGES = 5.0  # half-ranges
_DIFFERENCE = 1e-4  # of the half-range: central differences leave about 1e-8 of a derivative


def locate(
    project: Projection,
    image: ArrayLike,
    height: ArrayLike | Surface,
    *,
    centre: ArrayLike,
    scale: ArrayLike,
) -> FloatArray:
    """Return where the rays of image points [px] (n, 2) reach heights or a surface, shape (n, 3).

    `height` is an array (n,), one number, or a surface that gives heights for x and y. The search
    starts at `centre` (3,), the middle of the ground; `scale` (3,) is half the ground's size. A row
    is NaN if its ray meets no ground, meets it very far from the middle, or if the surface has no
    height there. Where a ray meets a steep surface several times, one of the places is returned;
    `visible_places` moves it to the visible one. Raises TermselError for other shapes.
    """
    image = np.asarray(image, dtype=np.float64)
    if image.ndim != 2 or image.shape[1] != 2:
        raise TermselError(f"image points have shape {image.shape}, expected (n, 2)",
                           hint="Give line and sample of each place, [[line, sample]].")
    middle = np.asarray(centre, dtype=np.float64)
    unit = np.asarray(scale, dtype=np.float64)
    ground = np.tile(middle, (len(image), 1))
    if not callable(height):
        heights = np.asarray(height, dtype=np.float64)
        if heights.shape not in ((), (len(image),)):
            raise TermselError(f"heights have shape {heights.shape}, expected ({len(image)},) or "
                               "one number for all image points")
        ground[:, 2] = heights
    # Newton's method finds places at fixed heights, the secant method then the surface's height.
    inverse = _inverse_derivatives(project, ground, unit)
    ground = _iterate_newton(project, image, ground, unit, inverse)
    if callable(height):
        ground = _intersect_surface(project, image, height, ground, unit, inverse)
    # Polynomials of higher degree map places far away to the same image point, too; affine models
    # do not.
    if not _is_affine(project, middle, unit):
        ground[(np.abs(ground[:, :2] - middle[:2]) > _FAR_RANGES * unit[:2]).any(axis=1)] = np.nan
    return ground


def _is_affine(project: Projection, middle: FloatArray, unit: FloatArray) -> bool:
    """Return whether a projection is affine in x and y, so that it sees each place only once.

    It is if two equal steps on the ground, of the size `unit` (3,) from `middle` (3,), move the
    image by the same, in four directions.
    """
    directions = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0]])
    with np.errstate(all="ignore"):
        start, once, twice = (project(middle + steps * directions * unit) for steps in range(3))
        bend = np.abs(twice - 2.0 * once + start).max()
    return bool(bend <= LOCATE_TOLERANCE)


def visible_places(
    project: Projection,
    image: FloatArray,
    ground: FloatArray,
    surface: Surface,
    highest: float,
    spacing: float,
    unit: FloatArray,
) -> FloatArray:
    """Return where rays meet a surface first on their way down, shape (n, 3).

    Parameters
    ----------
    project : callable
        Returns line and sample [px] (n, 2) of ground points (n, 3).
    image : ndarray, shape (n, 2)
        Line and sample [px].
    ground : ndarray, shape (n, 3)
        Where the rays meet the surface, as `locate` returns it.
    surface : callable
        Returns heights (n,) of places (n, 2); NaN where it has none.
    highest : float
        Height that the surface is nowhere above.
    spacing : float
        Distance between neighbouring heights of the surface, in units of x and y.
    unit : ndarray, shape (3,)
        Half the size of the ground.

    Returns
    -------
    ndarray, shape (n, 3)
        A copy of `ground`, in which hidden places are replaced by the visible ones. NaN stays.
    """
    ground = ground.copy()
    rays = np.flatnonzero(np.isfinite(ground).all(axis=1) & (ground[:, 2] < highest - _CLOSE))
    inverse = _inverse_derivatives(project, ground, unit)

    def at_height(rays: IntArray, height: FloatArray) -> FloatArray:
        """Return the places (r, 3) of rays at heights (r,)."""
        places = ground[rays]
        places[:, 2] = height
        return _iterate_newton(project, image[rays], places, unit, inverse[rays])

    # Each ray is a curve through three places: the known one, the highest, and one half-way up. A
    # camera may be below the highest ground; the top of its rays is lowered until it is found.
    low = ground[rays, 2]
    top = np.full(len(rays), highest)
    upper = at_height(rays, top)
    for _ in range(_LOWER_TOPS):
        lost = np.isnan(upper[:, 0])
        if not lost.any():
            break
        top[lost] = (top[lost] + low[lost]) / 2
        upper[lost] = at_height(rays[lost], top[lost])
    middle = at_height(rays, (top + low) / 2)
    # A ray that moves by less than the spacing, as in views from above, meets the surface once.
    distance = np.linalg.norm(upper[:, :2] - ground[rays, :2], axis=1)
    slanted = np.flatnonzero((distance > spacing) & np.isfinite(middle[:, 0]))
    for i in range(0, len(slanted), _RAYS_AT_ONCE):
        batch = slanted[i:i + _RAYS_AT_ONCE]
        steps = int(min(np.ceil(2 * distance[batch].max() / spacing), _MOST_STEPS))
        curves = np.stack([upper[batch], middle[batch], ground[rays[batch]]])
        start, end = _first_crossings(curves, surface, steps)
        crossing = np.flatnonzero(np.isfinite(start))
        if not crossing.size:
            continue
        hidden = rays[batch[crossing]]
        places = _bisect(partial(at_height, hidden), surface, end[crossing], start[crossing])
        is_crossing = np.abs(surface(places[:, :2]) - places[:, 2]) <= _CLOSE
        ground[hidden[is_crossing]] = places[is_crossing]
    return ground


def _first_crossings(curves: FloatArray, surface: Surface, steps: int,
                     ) -> tuple[FloatArray, FloatArray]:
    """Return heights (r,) above and below the surface, between which rays first cross it.

    The first are NaN for rays that do not cross it before the known place, and for those that begin
    below it. `curves` (3, r, 3) are places of the rays at the top, half-way and at the known place.
    """
    # Lagrange's polynomials go through the places at t = 0, 1/2 and 1. The last step ends before
    # t = 1, the known place.
    t = np.linspace(0.0, 1.0, steps + 1)[:-1, None]
    weights = np.stack([(2 * t - 1) * (t - 1), 4 * t * (1 - t), t * (2 * t - 1)])
    places = np.einsum("kti,krc->trc", weights, curves)
    heights = surface(places[..., :2].reshape(-1, 2)).reshape(places.shape[:2])
    is_below = heights - places[..., 2] > _CLOSE
    # A ray that is below the surface at its top begins inside of the ground: no crossing counts.
    first = np.argmax(is_below, axis=0)
    rays = np.arange(places.shape[1])
    start = np.where(first > 0, places[np.maximum(first - 1, 0), rays, 2], np.nan)
    return start, places[first, rays, 2]


def _bisect(at_height: Callable[[FloatArray], FloatArray], surface: Surface, below: FloatArray,
            above: FloatArray) -> FloatArray:
    """Return the places (r, 3) where rays cross a surface, between heights below and above it."""
    for _ in range(_BISECTIONS):
        middle = (below + above) / 2
        places = at_height(middle)
        is_below = surface(places[:, :2]) > places[:, 2]
        below = np.where(is_below, middle, below)
        above = np.where(is_below, above, middle)
    return places


def _iterate_newton(project: Projection, image: FloatArray, ground: FloatArray, unit: FloatArray,
                    inverse: FloatArray) -> FloatArray:
    """Return ground points (n, 3) at their heights, moved until they project to the image points.

    `inverse`, the moves on the ground for 1 px, hardly changes over an image, so that it is used
    for several steps. In an oblique view it does change, and a step may end behind the camera. Such
    a step is made again from where it began, with derivatives of that place and shortened as need
    be; so are all further steps of the point. Points that do not converge become NaN.
    """
    ground = ground.copy()
    is_oblique = np.zeros(len(ground), dtype=bool)
    with np.errstate(all="ignore"):
        error = image - project(ground)
        for step in range(_NEWTON_STEPS):
            active = np.flatnonzero(np.abs(error).max(axis=1) > LOCATE_TOLERANCE / 100)
            if not active.size:
                break
            error_before = error[active]
            ground_before = ground[active]
            # Newton's step is d = (dp/dx)^-1 (image - p(x)).
            if step and not step % _STARTS_KEPT:
                moves = _inverse_derivatives(project, ground_before, unit)
            else:
                moves = inverse[active]
            ground[active, :2] += np.einsum("nij,nj->ni", moves, error_before)
            error[active] = image[active] - project(ground[active])
            # A step that makes the error larger, or NaN where nothing projects, was too long; "not
            # less or equal" is true of NaN.
            is_oblique[active] |= ~(np.abs(error[active]).max(axis=1)
                                    <= _WORSE * np.abs(error_before).max(axis=1))
            is_repeated = is_oblique[active]
            if is_repeated.any():
                repeated = active[is_repeated]
                ground[repeated] = _take_shortened_steps(
                    project, image[repeated], ground_before[is_repeated],
                    error_before[is_repeated], unit)
                error[repeated] = image[repeated] - project(ground[repeated])
    ground[~(np.abs(error).max(axis=1) <= LOCATE_TOLERANCE)] = np.nan
    return ground


def _take_shortened_steps(project: Projection, image: FloatArray, ground: FloatArray,
                          error: FloatArray, unit: FloatArray) -> FloatArray:
    """Return ground points (n, 3) moved by their own Newton steps, shortened where need be.

    A step is halved until it makes the error (n, 2) smaller. A point for which no step of
    `_SHORTER` does so stays where it is.
    """
    full_steps = np.einsum("nij,nj->ni", _inverse_derivatives(project, ground, unit), error)
    moved = ground.copy()
    # Each point has its own length of step: those that got better are done.
    remaining = np.arange(len(ground))
    for halving in range(_SHORTER):
        tried = ground[remaining]
        tried[:, :2] += 0.5**halving * full_steps[remaining]
        distances = np.abs(image[remaining] - project(tried)).max(axis=1)
        is_better = distances < np.abs(error[remaining]).max(axis=1)
        moved[remaining[is_better]] = tried[is_better]
        remaining = remaining[~is_better]
        if not remaining.size:
            break
    return moved


def _inverse_derivatives(project: Projection, ground: FloatArray, unit: FloatArray) -> FloatArray:
    """Return the moves in x and y for 1 px of line and of sample, shape (n, 2, 2).

    The derivatives are central differences over `_DIFFERENCE` of `unit`. Where the image does not
    change, or nothing projects, the moves are not finite.
    """
    with np.errstate(all="ignore"):
        steps = np.diag(_DIFFERENCE * unit)[:2]
        (lx, sx), (ly, sy) = (((project(ground + step) - project(ground - step)) / 2).T
                              for step in steps)
        moves = np.stack([np.stack([sy, -ly], axis=-1), np.stack([-sx, lx], axis=-1)], axis=-2)
        moves /= (lx * sy - ly * sx)[:, None, None]
    return np.asarray(moves * (_DIFFERENCE * unit[:2])[:, None])


def _intersect_surface(project: Projection, image: FloatArray, surface: Surface, ground: FloatArray,
                       unit: FloatArray, inverse: FloatArray) -> FloatArray:
    """Return ground points (n, 3) moved along their rays onto the surface.

    At height h a ray is below or above a point of the surface with the height s(h); they meet where
    s(h) - h = 0. The secant method finds this root on usual ground. Where the surface is steeper
    than the ray, the method does not converge, and the interval of all heights that were tried is
    halved instead.

    Parameters
    ----------
    project : callable, ground (n, 3) to image (n, 2)
    image : positions (n, 2) whose rays are followed
    surface : callable, x and y (n, 2) to heights (n,), NaN outside
    ground : places on the rays (n, 3) to begin with; the array is changed
    unit : half the size of the ground (3,), the unit of steps for derivatives
    inverse : moves in x and y for 1 px at these places (n, 2, 2)

    Returns
    -------
    The places (n, 3), NaN where the ray does not meet the surface.
    """
    def at_height(rays: IntArray, height: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return places of rays at heights, (r, 3), and how far the surface is above them, (r,)."""
        places = ground[rays]
        places[:, 2] = height
        places = _iterate_newton(project, image[rays], places, unit, inverse[rays])
        return places, surface(places[:, :2]) - places[:, 2]

    above = surface(ground[:, :2]) - ground[:, 2]
    low = ground[:, 2].copy()
    high = ground[:, 2].copy()
    slope = np.zeros(len(ground))  # ds / dh, how the surface's height changes with the ray's
    for _ in range(_SECANTS):
        active = np.flatnonzero(np.abs(above) > _AT_SURFACE)
        if not active.size:
            break
        above_before = above[active]
        # The slope is limited, so that a wrong one makes no step of the wrong sign or a huge one.
        step = above_before / (1.0 - np.clip(slope[active], -3.0, 0.7))
        ground[active], above[active] = at_height(active, ground[active, 2] + step)
        low = np.fmin(low, ground[:, 2])
        high = np.fmax(high, ground[:, 2])
        with np.errstate(all="ignore"):
            slope[active] = np.nan_to_num(1.0 + (above[active] - above_before) / step)
    # The surface is too steep for the secant method where it has not converged.
    active = np.flatnonzero(~(np.abs(above) <= _AT_SURFACE))
    bottom = np.full(len(active), np.fmin.reduce(low, initial=np.nan))
    top = np.full(len(active), np.fmax.reduce(high, initial=np.nan))
    for _ in range(_BISECTIONS if active.size else 0):
        middle = (bottom + top) / 2
        ground[active], above[active] = at_height(active, middle)
        is_below = above[active] > 0
        bottom = np.where(is_below, middle, bottom)
        top = np.where(is_below, top, middle)
    ground[~(np.abs(above) <= _CLOSE)] = np.nan
    return ground
