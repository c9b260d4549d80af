"""The central projection that control supports: the view of a camera, be it oblique.

Line and sample are linear in X, Y (and Z) over one denominator, which is the distance from the
camera along its view. It is zero in the plane of the camera: below it, and beyond the horizon of
the image. Such places are never in the image, whatever the fit says there.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from termsel.data.coordinates.places import spatial_order
from termsel.data.features import BoolArray, FloatArray, IntArray, Points, empty_points
from termsel.data.record.chances import chance_of_better_fit
from termsel.data.tables.tabular import replace_unchecked

# Points as the key of what is kept of them: equal measurements are one, whatever their names.

@dataclass(frozen=True)
class Measurements:
    """Image and ground coordinates of points and their standard deviations, as bytes."""

    image: bytes
    ground: bytes
    sigma: bytes | None

    @classmethod
    def of(cls, points: Points) -> Measurements:
        """Return the measurements of points alone, without ids and roles."""
        return cls(points.image.tobytes(), points.ground.tobytes(),
                   None if points.sigma is None else points.sigma.tobytes())

    @property
    def points(self) -> Points:
        """The measurements as points with numbers for ids, and without roles or attributes.

        They are not checked again, as they were taken from checked points.
        """
        image = _measured_rows(self.image, 2)
        return replace_unchecked(
            empty_points(),
            ids=tuple(map(str, range(len(image)))),
            image=image,
            ground=_measured_rows(self.ground, 3),
            roles=("",) * len(image),
            sigma=None if self.sigma is None else _measured_rows(self.sigma, 2),
        )


def _measured_rows(numbers: bytes, columns: int) -> FloatArray:
    """Return the array (n, columns) whose bytes are given, so that they can be a key."""
    return np.frombuffer(numbers).reshape(-1, columns)


CLEARER = 0.5
"""What a central projection leaves of the image coordinates, by what an affine transformation
leaves, from which on down the points support it."""

NEARER = 0.5
"""Places nearer to the camera than this part of the distance of the nearest point are outside the
image."""

FARTHER = 1.5
"""A map shows no places farther from the camera than this many times the farthest point."""

PIXEL_TOLERANCE = 0.15
"""Logarithm of the ratio of two focal lengths, and cosine of the angle between two axes, up to
which few points show square pixels."""

LEAST_RELIEF = 1e-4
"""Scaled distance from a plane up to which no height shows in a view: a hundredth of a pixel."""

HEIGHT_CONFIDENCE = 0.99
"""Level of the F test by which heights count in a view."""

MAX_VIEW_POINTS = 200
"""Points by which a view is found; more are thinned out evenly."""

BEST = 5 / 6
"""Part of the points, those that fit best, that show how well they are measured."""

_PROJECTION_STEPS, _HALVINGS, _GAIN = 30, 8, 1e-6
_DETERMINED = 1e-9


@dataclass(frozen=True, eq=False)
class Sightings:
    """Measured coordinates of the images of ground places, each along one direction.

    Of a point the line and the sample are measured, of a vertex of a line its distance across the
    line alone: n'(l, s) = rho, with the unit normal n of the image line and its offset rho.

    Parameters
    ----------
    normals : ndarray, shape (m, 2)
        Directions n, multiplied by the weights of the sightings.
    offsets : ndarray, shape (m,)
        Measured coordinates rho along them, likewise.
    ground : ndarray, shape (m, 3)
        Scaled places.
    place : ndarray of int, shape (m,)
        Number of the place of each sighting: both sightings of a point have one.
    """

    normals: FloatArray
    offsets: FloatArray
    ground: FloatArray
    place: IntArray

    @classmethod
    def of_points(cls, points: Points) -> Sightings:
        """Return those of scaled points: all lines, then all samples."""
        count = len(points)
        return cls(np.repeat(np.eye(2), count, axis=0), points.image.T.ravel(),
                   np.tile(points.ground, (2, 1)), np.tile(np.arange(count), 2))

    def __len__(self) -> int:
        return len(self.offsets)

    def take(self, chosen: BoolArray) -> Sightings:
        """Return the sightings of a mask (m,)."""
        return Sightings(self.normals[chosen], self.offsets[chosen], self.ground[chosen],
                         self.place[chosen])

    def along(self, image: FloatArray) -> FloatArray:
        """Return image positions of the places (m, 2) along the directions, (m,)."""
        return np.asarray((self.normals * image).sum(axis=1))


@dataclass(frozen=True, eq=False)
class CentralView:
    """A central projection of scaled places.

    Parameters
    ----------
    matrix : ndarray, shape (3, 3) or (3, 4)
        Of 1, X, Y and perhaps Z: the numerators of line and sample, and the denominator.
    ground : ndarray, shape (n, 3)
        Places that it was fitted to.
    sigma : float
        Standard deviation of an image coordinate [scaled].
    noise : float
        Likewise, of the points that fit best.
    affine_share : float
        `sigma` by that of an affine transformation of the same points.
    """

    matrix: FloatArray
    ground: FloatArray
    sigma: float
    noise: float
    affine_share: float = 1.0

    def distances(self, ground: FloatArray) -> FloatArray:
        """Return the distances of places from the camera along its view, (n,)."""
        return np.asarray(_projection_columns(ground, self.matrix.shape[1]) @ self.matrix[2])

    def has_square_pixels(self, metres: FloatArray) -> bool:
        """Return whether a camera with square pixels could see this view, within PIXEL_TOLERANCE.

        `metres` (3,) are the size of a unit of the scaled ground. Without their constants, the
        numerators p and q are the focal lengths along lines and samples times axes of the camera,
        plus the principal point times the denominator d (Abdel-Aziz and Karara 1971). Heights that
        are all wrong in the same way fit a projection, too, but seldom one of a camera.
        """
        line, sample, denominator = self.matrix[:, 1:] / metres
        # The products with d do not depend on the principal point.
        across_line = np.cross(line, denominator)
        across_sample = np.cross(sample, denominator)
        focal_line = float(np.linalg.norm(across_line))
        focal_sample = float(np.linalg.norm(across_sample))
        ratio = focal_line / focal_sample
        skew = float(across_line @ across_sample) / (focal_line * focal_sample)
        return abs(np.log(ratio)) < PIXEL_TOLERANCE and abs(skew) < PIXEL_TOLERANCE

    @cached_property
    def nearest(self) -> float:
        """Distance of the nearest point."""
        return float(self.distances(self.ground).min())

    @cached_property
    def depth(self) -> float:
        """Distance of the nearest point by that of the middle of the points' box.

        Denominators of models are in units of the latter.
        """
        middle = float(self.matrix[2, 0])
        return self.nearest / middle if middle > 0.0 else 0.0

    def shows(self, ground: FloatArray) -> BoolArray:
        """Return which places (m, 3) are in front of the camera and not far too near it, (m,)."""
        return np.asarray(self.distances(ground) >= NEARER * self.nearest)

    def holds(self, ground: FloatArray) -> BoolArray:
        """Return which places (m, 3) are about as far from the camera as some points, (m,)."""
        far = self.distances(ground) <= FARTHER * self.distances(self.ground).max()
        return np.asarray(self.shows(ground) & far)

    def above_horizon(self, image: FloatArray) -> BoolArray:
        """Return a mask (n,) of scaled image places (n, 2) whose rays do not meet level ground.

        A level place X, Y seen at an image place is that of the homogeneous solution of H (1, X, Y)
        = t (line, sample, 1), whose first coordinate has the sign of 1 / t: the place is in front
        of the camera where t, its distance, is positive.
        """
        level = self.matrix[:, :3].copy()
        # "not above 0" is true of NaN, too: a place that is no place is not on the ground.
        homogeneous = np.column_stack([image, np.ones(len(image))]) @ np.linalg.inv(level).T
        return np.asarray(~(homogeneous[:, 0] > 0.0))

    def magnification(self, ground: FloatArray) -> FloatArray:
        """Return how far places (n, 3) move in the image by a unit of X and by one of Y, (n, 2).

        Places nearer to the camera than any that the image shows count as the nearest that it
        shows.
        """
        columns = _projection_columns(ground, self.matrix.shape[1])
        numerators = columns @ self.matrix[:2].T
        denominator = np.maximum(columns @ self.matrix[2], NEARER * self.nearest)[:, None]
        # The image f = a / d has the derivative df/dX = (da/dX - f dd/dX) / d.
        moves = [(self.matrix[:2, axis] - numerators / denominator * self.matrix[2, axis])
                 / denominator for axis in (1, 2)]
        return np.stack([np.linalg.norm(move, axis=1) for move in moves], axis=1)


def view_of(points: Points) -> CentralView | None:
    """Return the central projection that scaled points support; None if they support none.

    It is a DLT, or a projective transformation of the plane where heights are not known or show
    nothing.
    """
    return _view_of(Measurements.of(points))


@lru_cache(maxsize=16)  # each method asks about the same points
def _view_of(measurements: Measurements) -> CentralView | None:
    """Return the central view of the points; None if it does not fit them clearly better.

    Many points are represented by MAX_VIEW_POINTS that are spread over all.
    """
    points = measurements.points
    # In spatial order neighbours follow each other: every m-th point is spread over the scene.
    if len(points) > MAX_VIEW_POINTS:
        even = np.linspace(0, len(points) - 1, MAX_VIEW_POINTS).astype(int)
        points = points.take(spatial_order(points.ground[:, :2])[even])
    return view_of_sightings(Sightings.of_points(points), points)


def view_of_sightings(sightings: Sightings, points: Points | None = None) -> CentralView | None:
    """Return the central projection that sightings support; None if they support none.

    It has heights if they show their effect, else it is that of a plane. Where the sightings are
    those of `points`, a bound that is quick to compute spares most searches in vain.
    """
    if np.isfinite(sightings.ground).all():
        view = _clearly_better_view(sightings, 4, points)
        if view is not None and _heights_show(view, sightings):
            return view
    return _clearly_better_view(sightings, 3, points)


def _heights_show(view: CentralView, sightings: Sightings) -> bool:
    """Return whether heights explain more of the image than their three unknowns do by chance.

    On a plane, a projection would be fitted to the rounding of heights, and could not tell how any
    other height is seen. Let S be the sum of squares of the projection with f degrees of freedom,
    and S0 that of the one without heights with f + 3. If heights have no effect, (S0 - S) / 3 over
    S / f has an F distribution.
    """
    plane = _projection_columns(sightings.ground, 3)
    # What of the heights a plane explains, the other columns of a projection do.
    heights = sightings.ground[:, 2]
    off_plane = heights - plane @ np.linalg.lstsq(plane, heights)[0]
    if np.abs(off_plane).max() <= LEAST_RELIEF:
        return False
    matrix = _least_distance_matrix(sightings, 3)
    if matrix is None:
        return True
    plane_squares = float((_distances(sightings, matrix) ** 2).sum())
    freedom = len(sightings) - _unknowns(4)
    squares = view.sigma**2 * freedom
    if squares >= plane_squares:
        return False
    chance = chance_of_better_fit(squares / plane_squares, freedom, 3)
    return chance < 1.0 - HEIGHT_CONFIDENCE


def _clearly_better_view(sightings: Sightings, size: int,
                         points: Points | None) -> CentralView | None:
    """Return the view by 1, X, Y (and Z: size 4) if it is clearly better than an affine one.

    None if it is not, or if the sightings leave nothing over to tell by.
    """
    affine_sigma = _affine_deviation(sightings, size)
    if affine_sigma is None:
        return None
    if points is not None and not _may_be_clearly_better(
            _projection_columns(points.ground, size), points.image, affine_sigma):
        return None
    return _fit_projection(sightings, size, affine_sigma)


def _unknowns(size: int) -> int:
    """Return the number of unknowns of a projection: 8 of the plane (size 3), 11 of the DLT (4)."""
    return 3 * size - 1


def _projection_columns(ground: FloatArray, size: int) -> FloatArray:
    """Return 1, X, Y (and Z) of places, (n, size)."""
    return np.column_stack([np.ones(len(ground)), ground[:, :size - 1]])


def _affine_deviation(sightings: Sightings, size: int) -> float | None:
    """Return the standard deviation of sightings about an affine transformation.

    None is returned if there are not more of them than parameters.
    """
    freedom = len(sightings) - 2 * size
    if freedom <= 0:
        return None
    columns = _projection_columns(sightings.ground, size)
    design = _along_normals(sightings, columns)
    residuals = sightings.offsets - design @ np.linalg.lstsq(design, sightings.offsets)[0]
    return float(np.sqrt((residuals**2).sum() / freedom))


def _along_normals(sightings: Sightings, columns: FloatArray) -> FloatArray:
    """Return the columns (m, k) of line, then of sample, along the directions, (m, 2 k)."""
    return np.concatenate([sightings.normals[:, :1] * columns, sightings.normals[:, 1:] * columns],
                          axis=1)


def _may_be_clearly_better(columns: FloatArray, image: FloatArray, affine_sigma: float) -> bool:
    """Return False where no projection of points in front of the camera is clearly better.

    `columns` (n, c) are those of the projection's numerators, `image` (n, 2) the measured positions
    and `affine_sigma` the sigma0 of the affine model that it is compared with, in the same unit.

    Let p be the columns of a point, the first of them 1, with its image f, and let d be the
    denominator, a linear function of p. It is positive at each point and so in their centroid,
    where it is made 1. With the other columns centred and divided so that they are at most 1, let
    e be their coefficients in d, and r = |e|_1. Then all d are at most 1 + r, so that

        sum |f - a p / d|^2 >= sum |d f - a p|^2 / (1 + r)^2.

    The least value of the sum on the right for any numerators a is S + (e - e0)'B (e - e0). S, e0
    and B are those of the adjustment of f by the products of f and the other columns, all without
    their parts that p explains. It is at least S + w (r - |e0|_1)^2, where w is the least
    eigenvalue of B over the number of the other columns. By Cauchy's inequality no r then brings
    the quotient below 1 / ((1 + |e0|_1)^2 / S + 1 / w).
    """
    n, size = columns.shape
    centred_columns = columns[:, 1:] - columns[:, 1:].mean(axis=0)
    extents = np.abs(centred_columns).max(axis=0)
    freedom = 2 * n - (3 * size - 1)
    # Too few points, or points on a line, determine no projection.
    if freedom <= 0 or not extents.all():
        return False
    # The letters are those of the docstring: `least` is S, `centre` |e0|_1 and the rest of `gram`
    # B.
    terms = np.concatenate([columns[:, :1], centred_columns / extents], axis=1)
    products = (image[:, :, None] * terms[:, None]).reshape(n, -1)
    q = np.linalg.qr(columns)[0]
    remainders = (products - q @ (q.T @ products)).reshape(-1, size)
    gram = remainders.T @ remainders
    values, vectors = np.linalg.eigh(gram[1:, 1:])
    # A singular B bounds nothing.
    if values[0] <= _DETERMINED * values[-1]:
        return True
    along = vectors.T @ gram[1:, 0]
    least = gram[0, 0] - float(along**2 @ (1.0 / values))
    if least <= 0.0:
        return True
    centre = np.abs(vectors @ (along / values)).sum()
    bound = 1.0 / ((1.0 + centre) ** 2 / least + (size - 1) / values[0])
    return bool(bound < (CLEARER * affine_sigma) ** 2 * freedom)


def _fit_projection(sightings: Sightings, size: int, affine_sigma: float) -> CentralView | None:
    """Return the projection with the least squares of distances in the image.

    `size` is that of the view, 3 or 4 columns, and `affine_sigma` (scaled) the noise that an affine
    transformation leaves. None is returned if it is not clearly better than that, if the sightings
    do not determine it, and if some would be behind the camera.
    """
    matrix = _least_distance_matrix(sightings, size)
    if matrix is None:
        return None
    unknown = _unknowns(size)
    squares = _distances(sightings, matrix) ** 2
    sigma = float(np.sqrt(squares.sum() / (len(sightings) - unknown)))
    if not sigma < CLEARER * affine_sigma:
        return None
    # The noise is that of the places that fit best, which blunders do not reach; it is never more
    # than that of all places.
    noise = np.inf
    squares_of_places = np.bincount(sightings.place, squares)
    best = np.argsort(squares_of_places)[:round(BEST * len(squares_of_places))]
    closest = sightings.take(np.isin(sightings.place, best))
    best_matrix = _least_distance_matrix(closest, size)
    if best_matrix is not None:
        least = _distances(closest, best_matrix)
        noise = float(np.sqrt((least**2).sum() / (len(closest) - unknown)))
    ground = sightings.ground[np.unique(sightings.place, return_index=True)[1]]
    return CentralView(matrix, ground, sigma, min(noise, sigma), sigma / affine_sigma)


def _least_distance_matrix(sightings: Sightings, size: int) -> FloatArray | None:
    """Return the matrix (3, size) of the projection of least distances, by Gauss-Newton.

    None is returned if there are not more sightings than unknowns, if they do not determine the
    projection, and if the first solution has places behind the camera.
    """
    if len(sightings) <= _unknowns(size):
        return None
    # With p = (1, X, Y, Z) and rows a, b, d of the matrix, n1 a p + n2 b p - rho d p = 0. These
    # equations are linear in the matrix and leave its size free: the last right singular vector is
    # the solution.
    columns = _projection_columns(sightings.ground, size)
    system = np.concatenate([_along_normals(sightings, columns),
                             -sightings.offsets[:, None] * columns], axis=1)
    *_, values, vectors = np.linalg.svd(system, full_matrices=False)
    if values[-2] <= _DETERMINED * values[0]:
        return None
    matrix = vectors[-1].reshape(3, size)
    # The sign is free, too: denominators are positive in front of the camera.
    matrix = matrix * np.sign((columns @ matrix[2]).sum())
    if not (columns @ matrix[2] > 0.0).all():
        return None
    residuals = _distances(sightings, matrix)
    # Steps from there to the least distances are halved until they bring a gain.
    for _ in range(_PROJECTION_STEPS):
        step = _gauss_newton_step(matrix, sightings, columns, residuals)
        for halving in range(_HALVINGS):
            trial = matrix + 0.5**halving * step
            trial_residuals = _distances(sightings, trial)
            squares = (trial_residuals**2).sum()
            if (columns @ trial[2] > 0.0).all() and squares < (residuals**2).sum():
                break
        else:
            break
        gain = 1.0 - squares / (residuals**2).sum()
        matrix = trial / np.linalg.norm(trial)
        residuals = trial_residuals
        if gain < _GAIN:
            break
    return np.asarray(matrix)


def _gauss_newton_step(matrix: FloatArray, sightings: Sightings, columns: FloatArray,
                       residuals: FloatArray) -> FloatArray:
    """Return the Gauss-Newton step (3, k) of a matrix (3, k), at right angles to it.

    Its size is free. `columns` (m, k) are those of the places, and `residuals` (m,) the sightings
    less those by the matrix.
    """
    projected = sightings.along(_project_with_matrix(matrix, columns))
    denominators = columns @ matrix[2]
    # The derivatives of a p / d p are p / (d p) by a and -(a p / d p) p / (d p) by d.
    quotients = columns / denominators[:, None]
    design = np.concatenate([
        np.concatenate([_along_normals(sightings, quotients), -projected[:, None] * quotients],
                       axis=1),
        matrix.reshape(1, -1)])
    right = np.append(residuals, 0.0)
    return np.asarray(np.linalg.lstsq(design, right)[0].reshape(matrix.shape))


def _distances(sightings: Sightings, matrix: FloatArray) -> FloatArray:
    """Return the sightings minus those by a projective matrix (3, k), (m,)."""
    columns = _projection_columns(sightings.ground, matrix.shape[1])
    return np.asarray(sightings.offsets - sightings.along(_project_with_matrix(matrix, columns)))


def _project_with_matrix(matrix: FloatArray, columns: FloatArray) -> FloatArray:
    """Return line and sample (n, 2) by a projective matrix (3, k) of columns (n, k)."""
    line, sample, below = matrix @ columns.T
    return np.asarray(np.column_stack([line, sample]) / below[:, None])
