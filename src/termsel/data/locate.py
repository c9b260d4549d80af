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

    Heights are (n,), one number, or a surface that gives them for x and y; the search starts in the
    middle, `centre` and half-range `scale` of the ground (3,). NaN where the ray meets no ground
    point, or the surface has no height there. Where a ray meets a steep surface several times, one
    of the places is returned; `visible_places` moves it to the visible one. Raises TermselError for
    other shapes.
    """
    image = np.asarray(image, dtype=np.float64)
    if image.ndim != 2 or image.shape[1] != 2:
        raise TermselError(f"image points have shape {image.shape}, expected (n, 2)")
    middle = np.asarray(centre, dtype=np.float64)
    unit = np.asarray(scale, dtype=np.float64)
    ground = np.tile(middle, (len(image), 1))
    if not callable(height):
        heights = np.asarray(height, dtype=np.float64)
        if heights.shape not in ((), (len(image),)):
            raise TermselError(f"heights have shape {heights.shape}, expected ({len(image)},) or "
                               "one number for all image points")
        ground[:, 2] = heights
    # Newton's method at fixed heights, then the secant method for that of the surface.
    inverse = _inverse_derivatives(project, ground, unit)
    ground = _iterate_newton(project, image, ground, unit, inverse)
    if callable(height):
        ground = _intersect_surface(project, image, height, ground, unit, inverse)
    # Higher polynomials map places far away to the same image point.
    if not _is_affine(project, middle, unit):
        ground[(np.abs(ground[:, :2] - middle[:2]) > _FAR_RANGES * unit[:2]).any(axis=1)] = np.nan
    return ground


def _is_affine(project: Projection, middle: FloatArray, unit: FloatArray) -> bool:
    """Return whether a projection is affine in x and y, so that it sees each place only once.

    It is if two equal steps on the ground move the image by the same, in four directions.
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
    image : ndarray, shape (n, 2)
        Line and sample [px].
    ground : ndarray, shape (n, 3)
        Where the rays meet the surface, as `locate` returns it; NaN stays.
    surface : callable
    highest : float
        Height that the surface is nowhere above.
    spacing : float
        Of heights of the surface, in the plane.
    unit : ndarray, shape (3,)
        Half-range of the ground.

    Returns
    -------
    ndarray, shape (n, 3)
    """
    ground = ground.copy()
    rays = np.flatnonzero(np.isfinite(ground).all(axis=1) & (ground[:, 2] < highest - _CLOSE))
    inverse = _inverse_derivatives(project, ground, unit)

    def at_height(rays: IntArray, height: FloatArray) -> FloatArray:
        """Return the places (r, 3) of rays at heights (r,)."""
        places = ground[rays]
        places[:, 2] = height
        return _iterate_newton(project, image[rays], places, unit, inverse[rays])

    # Two places of each ray above the first one: a camera may be below the highest ground.
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
    # A ray that stays within a pixel of the surface, as in views from above, cannot leave it again.
    distance = np.linalg.norm(upper[:, :2] - ground[rays, :2], axis=1)
    going = np.flatnonzero((distance > spacing) & np.isfinite(middle[:, 0]))
    for i in range(0, len(going), _RAYS_AT_ONCE):
        batch = going[i:i + _RAYS_AT_ONCE]
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
    """Return the heights between which rays go first below a surface, (r,) each; NaN for none.

    `curves` are places of the rays above, half-way and at a crossing, shape (3, r, 3).
    """
    # Lagrange's polynomials through t = 0, 1/2 and 1; the last step ends above the known crossing.
    t = np.linspace(0.0, 1.0, steps + 1)[:-1, None]
    weights = np.stack([(2 * t - 1) * (t - 1), 4 * t * (1 - t), t * (2 * t - 1)])
    places = np.einsum("kti,krc->trc", weights, curves)
    heights = surface(places[..., :2].reshape(-1, 2)).reshape(places.shape[:2])
    is_below = heights - places[..., 2] > _CLOSE
    # At the top itself a ray is above all of the surface, or the camera is inside of it.
    first = np.argmax(is_below, axis=0)
    rays = np.arange(places.shape[1])
    start = np.where(first > 0, places[np.maximum(first - 1, 0), rays, 2], np.nan)
    return start, places[first, rays, 2]


def _bisect(at_height: Callable[[FloatArray], FloatArray], surface: Surface, below: FloatArray,
            over: FloatArray) -> FloatArray:
    """Return the places (r, 3) where rays cross a surface, between heights under and above it."""
    for _ in range(_BISECTIONS):
        middle = (below + over) / 2
        places = at_height(middle)
        rises = surface(places[:, :2]) > places[:, 2]
        below = np.where(rises, middle, below)
        over = np.where(rises, over, middle)
    return places


def _iterate_newton(project: Projection, image: FloatArray, ground: FloatArray, unit: FloatArray,
                    inverse: FloatArray) -> FloatArray:
    """Return ground points (n, 3) at their heights, moved until they project to the image points.

    `inverse`, the moves on the ground for 1 px, hardly changes over an image. It is renewed only
    for points that do not converge. In an oblique view it does change, and a step may end behind
    the camera. Such a step is made again from where it began, by half of it where need be, and so
    are all further ones of the point.
    """
    ground, oblique = ground.copy(), np.zeros(len(ground), dtype=bool)
    with np.errstate(all="ignore"):
        error = image - project(ground)
        for step in range(_NEWTON_STEPS):
            going = np.flatnonzero(np.abs(error).max(axis=1) > LOCATE_TOLERANCE / 100)
            if not going.size:
                break
            before = error[going]
            at = ground[going]
            # Newton's step d = (dp/dx)^-1 (image - p(x)); derivatives are renewed now and then.
            moves = (_inverse_derivatives(project, at, unit) if step and not step % _STARTS_KEPT
                     else inverse[going])
            ground[going, :2] += np.einsum("nij,nj->ni", moves, before)
            error[going] = image[going] - project(ground[going])
            # A step that makes things worse, or ends where nothing projects (NaN), was too long.
            oblique[going] |= ~(np.abs(error[going]).max(axis=1)
                                <= _WORSE * np.abs(before).max(axis=1))
            wrong = oblique[going]
            if wrong.any():
                again = going[wrong]
                ground[again] = _take_shortened_steps(
                    project, image[again], at[wrong], before[wrong], unit)
                error[again] = image[again] - project(ground[again])
    ground[~(np.abs(error).max(axis=1) <= LOCATE_TOLERANCE)] = np.nan
    return ground


def _take_shortened_steps(project: Projection, image: FloatArray, ground: FloatArray,
                          error: FloatArray, unit: FloatArray) -> FloatArray:
    """Return ground points (n, 3) moved by their own Newton steps, or by shares that help.

    A step is halved until it makes the error smaller; a point that no share helps stays.
    """
    full = np.einsum("nij,nj->ni", _inverse_derivatives(project, ground, unit), error)
    moved = ground.copy()
    todo = np.arange(len(ground))
    for halving in range(_SHORTER):
        stepped = ground[todo]
        stepped[:, :2] += 0.5**halving * full[todo]
        distances = np.abs(image[todo] - project(stepped)).max(axis=1)
        better = distances < np.abs(error[todo]).max(axis=1)
        moved[todo[better]] = stepped[better]
        todo = todo[~better]
        if not todo.size:
            break
    return moved


def _inverse_derivatives(project: Projection, ground: FloatArray, unit: FloatArray) -> FloatArray:
    """Return the moves in x and y for 1 px of line and of sample, shape (n, 2, 2)."""
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

    The height h of a ray and the surface above it, s(h), meet where s(h) - h = 0. The secant method
    finds the root on usual ground. Where the surface is steeper than the ray, it jumps over it, and
    the interval of all heights tried is halved instead.

    Parameters
    ----------
    project : ground to image, scaled
    image : positions (n, 2), whose rays are followed
    surface : heights at x and y (n, 2), NaN outside
    ground : places on the rays (n, 3) to begin with; they are changed
    unit : steps for derivatives (3,)
    inverse : derivatives of the plane by the image at these places (n, 2, 2)

    Returns
    -------
    ground : (n, 3), NaN where the ray does not meet the surface
    """
    def moved(rays: IntArray, height: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return places of rays at heights, (r, 3), and how far the surface lies above them, (r,).
        """
        places = ground[rays]
        places[:, 2] = height
        places = _iterate_newton(project, image[rays], places, unit, inverse[rays])
        return places, surface(places[:, :2]) - places[:, 2]

    above = surface(ground[:, :2]) - ground[:, 2]
    low = ground[:, 2].copy()
    high = ground[:, 2].copy()
    slope = np.zeros(len(ground))  # of the surface's height over the height of the ray
    for _ in range(_SECANTS):
        going = np.flatnonzero(np.abs(above) > _AT_SURFACE)
        if not going.size:
            break
        before = above[going]
        step = before / (1.0 - np.clip(slope[going], -3.0, 0.7))
        ground[going], above[going] = moved(going, ground[going, 2] + step)
        low = np.fmin(low, ground[:, 2])
        high = np.fmax(high, ground[:, 2])
        with np.errstate(all="ignore"):
            slope[going] = np.nan_to_num(1.0 + (above[going] - before) / step)
    # The rest is too steep for that: halve the interval of heights where the ray meets the surface.
    going = np.flatnonzero(~(np.abs(above) <= _AT_SURFACE))
    below = np.full(len(going), np.fmin.reduce(low, initial=np.nan))
    over = np.full(len(going), np.fmax.reduce(high, initial=np.nan))
    for _ in range(_BISECTIONS if going.size else 0):
        middle = (below + over) / 2
        ground[going], above[going] = moved(going, middle)
        rises = above[going] > 0
        below = np.where(rises, middle, below)
        over = np.where(rises, over, middle)
    ground[~(np.abs(above) <= _CLOSE)] = np.nan
    return ground
