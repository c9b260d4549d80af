"""Places of features in the image and on the ground."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from termsel.data.coordinates.longitudes import without_jump
from termsel.data.features import FeatureSet, FloatArray, IntArray, Points

AREA_ROUNDING = 1e-14
"""Twice the area of a triangle in a box of side 1 whose corners lie on one line. Large coordinates
are rounded more."""


def spatial_order(xy: ArrayLike) -> IntArray:
    """Return an order (n,) of points (n, 2) in which neighbours are neighbours in the plane, too.

    It is the order of the leaves of a k-d tree: points are halved at the median of their longer
    side until one or two are left in each part. So consecutive points of it lie close together, and
    every k-th point makes a sample that is spread over all points.
    """
    xy = np.asarray(xy, dtype=np.float64)
    order = np.arange(len(xy))
    # Part i begins at starts[i] in the order.
    starts = np.zeros(1, dtype=np.intp)
    while (sizes := np.diff(starts, append=len(xy))).max(initial=0) > 2:
        group = np.repeat(np.arange(len(starts)), sizes)
        ordered = xy[order]
        longer_axis = np.argmax(np.maximum.reduceat(ordered, starts)
                                - np.minimum.reduceat(ordered, starts), axis=1)
        # Parts of one or two points keep their order, as the sort below is stable.
        coordinate = np.where(sizes[group] > 2,
                              ordered[np.arange(len(xy)), longer_axis[group]], 0.0)
        order = order[np.lexsort((coordinate, group))]
        # A new part begins in the middle of each larger one.
        is_halved = sizes > 2
        starts = np.sort(np.concatenate([starts, (starts + sizes // 2)[is_halved]]))
    return order


def feature_centres(control: FeatureSet) -> FloatArray:
    """Return the image position of each feature, the middle for lines, shape (f, 2)."""
    lines = control.lines
    return np.concatenate([control.points.image, lines.by_feature(lines.image.mean(axis=1))])


def ground_centres(control: FeatureSet) -> FloatArray:
    """Return the plane ground position of each feature, the middle for lines, shape (f, 2)."""
    lines = control.lines
    return np.concatenate([control.points.ground[:, :2],
                           lines.by_feature(lines.ground[..., :2].mean(axis=1))])


def distance_beyond_hull(control: FloatArray, positions: FloatArray) -> FloatArray:
    """Return how far, (m,), positions (m, 2) are outside the convex hull of the control (n, 2).

    That is the largest distance from a side of the hull, divided by the longer side of the
    control's box. It is 0 inside, and infinite if the control has no hull.
    """
    corners = control[convex_hull(control)]
    if not len(corners):
        return np.full(len(positions), np.inf)
    sides = np.roll(corners, -1, axis=0) - corners
    # Corners run anticlockwise, so that the outward unit normals are to the right of each side.
    normals = np.column_stack([sides[:, 1], -sides[:, 0]]) / np.linalg.norm(sides, axis=1)[:, None]
    with np.errstate(over="ignore"):  # places near the largest number are infinitely far
        outside = (positions @ normals.T - (corners * normals).sum(axis=1)).max(axis=1)
        return np.asarray(np.maximum(outside, 0.0) / np.ptp(control, axis=0).max())


def convex_hull(positions: FloatArray) -> list[int]:
    """Return the indices of the corners of the convex hull of positions (n, 2), anticlockwise.

    The list is empty for fewer than three positions, for positions on one line, and if one is not
    finite. The algorithm is by A.M. Andrew, Information Processing Letters 9 (1979) 216-219; to
    import SciPy's would take long.
    """
    size = np.ptp(positions, axis=0).max(initial=0.0) if len(positions) > 2 else 0.0
    if not 0.0 < size < np.inf:
        return []
    scaled = (positions - positions.mean(axis=0)) / size
    # Below this double area three corners count as one line: rounding of coordinates far from 0 is
    # larger, in units of the box.
    rounding = max(AREA_ROUNDING, 8 * np.finfo(float).eps * float(np.abs(positions).max()) / size)
    order = np.lexsort(scaled.T[::-1]).tolist()
    (x, y) = scaled.T.tolist()
    corners: list[int] = []
    # The lower chain of corners goes from left to right, the upper one back.
    for sweep in (order, order[::-1]):
        chain: list[int] = []
        for i in sweep:
            # A corner at which the chain does not turn to the left is none of the hull.
            while len(chain) > 1:
                a, b = chain[-2:]
                if (x[b] - x[a]) * (y[i] - y[a]) - (y[b] - y[a]) * (x[i] - x[a]) > rounding:
                    break
                chain.pop()
            chain.append(i)
        corners += chain[:-1]
    return corners if len(corners) > 2 else []


# Lattices: points on regular lines and columns of an image, which were computed and not measured.
#
# Processors of satellite images put such lattices into their files: the line and sample of each
# point are round, its place on the ground follows from the geometry of the image and a DEM. They
# have no blunders, and what neighbours on a line predict of each other says nothing of the places
# between two lines. Somebody may measure points at regular places of an image, too, as matching
# does; such points have errors, which lattices have not: along a line the ground of a lattice is
# smooth, but for what its heights do.

MIN_LATTICE_LINES = 4
"""Lines, and columns, of the smallest lattice."""

FILLED = 0.5
"""Least part of the places of a lattice that have a point."""

ROUND = 1e-3
"""Distance up to which image coordinates are those of one line or column [px]."""

SMOOTH = 0.05
"""Noise of the ground along lines up to which it was computed [px]: nobody measures so well."""

_MARGIN = 1.5
"""By which noise may be larger than that of rounding alone."""

_RUN = 5
"""Neighbours by which noise is told: a cubic polynomial goes through all but one of them."""

_TERMS = 19
"""Smooth columns, which show what curvature and heights do."""

_ENOUGH = 3 * _TERMS
"""Runs from which on they show the noise; with fewer, being regular is enough."""


@dataclass(frozen=True, eq=False)
class Lattice:
    """Which line and which column of a lattice each of n points is on, counted from 0."""

    line: IntArray
    column: IntArray

    @property
    def lines(self) -> int:
        """Number of lines."""
        return int(self.line.max()) + 1

    @property
    def columns(self) -> int:
        """Number of columns."""
        return int(self.column.max()) + 1

    def take(self, rows: IntArray) -> Lattice:
        """Return the lines and columns of some of the points, by their numbers."""
        return Lattice(self.line[rows], self.column[rows])

    def sentence(self, *, known: bool = False) -> str:
        """Return a sentence on the lattice.

        If the geometry by which its points were computed is not `known`, the text also says what
        the accuracy means, and which data would be better.
        """
        description = (f"The {len(self.line)} points are a lattice of {self.lines} lines and "
                       f"{self.columns} columns of the image: computed, not measured.")
        if known:
            return description
        return (f"{description} The accuracy is that of interpolation between them, found without "
                "whole lines and columns, and not that of the product. The geometry that they were "
                "computed by, as in the annotation of a radar image or an RPC, would be exact "
                "between them, too: give it if you have it.")


def lattice_of(features: FeatureSet) -> Lattice | None:
    """Return the lattice that the features form; None if they form none, or have lines."""
    if len(features.lines):
        return None
    # A jump of longitudes at 180 degrees is no noise.
    return _lattice_of_points(without_jump(features).points)


@lru_cache(maxsize=8)  # roles, folds and verdict ask about the same points
def _lattice_of_points(points: Points) -> Lattice | None:
    """Return the lattice that points make, or None if they make none.

    They make none if they are few, or if they have standard deviations, as measured points have.
    Nor do they if crossings of lines and columns are empty or taken twice, or if the ground is
    noisy along lines. The points must have no longitudes that jump.
    """
    if len(points) < MIN_LATTICE_LINES**2 or points.sigma is not None:
        return None
    # Lines and columns are the values that occur; nearly every crossing has to have one point.
    line = _ranks_of_values(points.image[:, 0])
    column = _ranks_of_values(points.image[:, 1])
    lines = int(line.max()) + 1
    columns = int(column.max()) + 1
    if (min(lines, columns) < MIN_LATTICE_LINES or len(points) < FILLED * lines * columns
            or len(np.unique(line * columns + column)) < len(points)):
        return None
    # Measured points on a grid are noisy; computed ones are as smooth as their numbers are stored.
    lattice = Lattice(line, column)
    noise = _noise_along_lines(points, lattice)
    return lattice if noise is None or noise <= np.hypot(SMOOTH, _storage_noise(points)) else None


def _ranks_of_values(values: FloatArray) -> IntArray:
    """Return the rank of each value (n,) among the distinct values, counted from 0, (n,).

    Values count as one if each is within `ROUND` of the next.
    """
    order = np.argsort(values, kind="stable")
    ranks = np.empty(len(values), dtype=np.intp)
    ranks[order] = np.concatenate([[0], np.cumsum(np.diff(values[order]) > ROUND)])
    return ranks


def _noise_along_lines(points: Points, lattice: Lattice) -> float | None:
    """Return the noise of the ground along lines [px]; None if too few neighbours show it.

    None is returned, too, for points on a line. In each run of neighbours on a line, weights take
    out a cubic polynomial of the sample. If the geometry is smooth, what they leave of x and y is a
    linear function of what they leave of `_smooth_columns`; the rest is noise.
    """
    runs = np.array(list(_runs_of_neighbours(lattice)), dtype=np.intp).reshape(-1, _RUN)
    if len(runs) < _ENOUGH:
        return None
    weights = _without_cubic(points.image[runs, 1])
    columns = np.einsum("rn,rnk->rk", weights, _smooth_columns(points)[runs])
    plan = points.ground[:, :2] - points.ground[:, :2].mean(axis=0)
    residuals = np.einsum("rn,rnk->rk", weights, plan[runs])
    residuals -= columns @ np.linalg.lstsq(columns, residuals)[0]
    freedom = len(runs) - np.linalg.matrix_rank(columns)
    # The squares of the weights sum to 1, so that they leave independent noise as large as it is.
    noise = np.sqrt((residuals**2).sum(axis=0) / freedom)
    return _ground_noise_in_pixels(points, noise)


def _storage_noise(points: Points) -> float:
    """Return the noise [px] of x and y that are stored in 32 bits; 0 if they are in 64.

    Degrees stored in 32 bits are decimetres off. The noise is multiplied by `_MARGIN`.
    """
    plan = points.ground[:, :2]
    single = plan.astype(np.float32)
    if not np.array_equal(single.astype(np.float64), plan):
        return 0.0
    # Rounding errors are uniform between -1/2 and 1/2 step, which has the variance step^2 / 12.
    steps = np.spacing(np.abs(single).max(axis=0)).astype(np.float64)
    return (_ground_noise_in_pixels(points, steps / np.sqrt(12.0)) or 0.0) * _MARGIN


def _ground_noise_in_pixels(points: Points, noise: FloatArray) -> float | None:
    """Return noise of x and of y on the ground (2,) as one noise in the image [px].

    It is the root mean square of that in line and in sample. None is returned for points on a line,
    which show no affine map from the image to the ground.
    """
    columns = np.column_stack([np.ones(len(points)), points.image])
    ground_per_pixel = np.linalg.lstsq(columns, points.ground[:, :2])[0][1:]
    if abs(np.linalg.det(ground_per_pixel)) == 0.0:
        return None
    return float(np.linalg.norm(np.linalg.solve(ground_per_pixel.T, noise)) / np.sqrt(2.0))


def _smooth_columns(points: Points) -> FloatArray:
    """Return columns of a smooth geometry at places, beyond cubic polynomials, (n, k).

    They are higher powers of the sample, alone and times the line, and heights and their squares
    times factors that change slowly across the image: in all _TERMS columns.
    """
    line, sample = ((points.image - points.image.mean(axis=0))
                    / np.ptp(points.image, axis=0)).T
    height = np.nan_to_num(points.ground[:, 2])
    height = (height - height.mean()) / max(float(np.ptp(height)), 1.0)
    # Six powers; the height times the ten monomials of line and sample up to the third degree; its
    # square times three.
    powers = [sample**power * line**i for power, i in product((4, 5, 6), (0, 1))]
    slow_factors = [line**i * sample**j for i, j in product(range(4), range(4)) if i + j < 4]
    with_heights = [height * factor for factor in slow_factors]
    with_squares = [height**2 * factor for factor in (1.0, line, sample)]
    return np.stack([*powers, *with_heights, *with_squares], axis=1)


def _runs_of_neighbours(lattice: Lattice) -> Iterator[IntArray]:
    """Yield the indices (r,) of points that are neighbours on a line, one run after the other."""
    order = np.lexsort((lattice.column, lattice.line))
    for start in range(len(order) - _RUN + 1):
        run = order[start:start + _RUN]
        if lattice.line[run[0]] == lattice.line[run[-1]]:
            yield run


def _without_cubic(positions: FloatArray) -> FloatArray:
    """Return weights (r, 5) whose sums over values at positions (r, 5) are 0 for any cubic.

    They are divided differences, w_i = 1 / product over j of (x_i - x_j), scaled so that their
    squares sum to 1.
    """
    unit = np.ptp(positions, axis=1, keepdims=True)
    differences = (positions[:, :, None] - positions[:, None, :]) / unit[:, :, None]
    differences += np.eye(_RUN)
    weights = 1.0 / differences.prod(axis=2)
    return np.asarray(weights / np.linalg.norm(weights, axis=1, keepdims=True))
