"""Equations of control features: rows belong to features, columns to terms."""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np

from termsel.core.arguments import explains_arguments
from termsel.data.features import BoolArray, FeatureSet, FloatArray, IntArray, Lines, Points
from termsel.data.record.chances import median_of


@dataclass(frozen=True, eq=False)
class Equations:
    """A linear system A x = b over all terms and all control features.

    Parameters
    ----------
    A : ndarray, shape (m, k)
        Design matrix.
    b : ndarray, shape (m,)
        Observations, in the scaled image unit.
    feature : ndarray of int, shape (m,)
        The control feature each row belongs to: points from 0, then lines.
    prior : ndarray, shape (k,), optional
        Weights of pseudo-observations that a coefficient is zero, as factors of their rows; 0 for
        a coefficient without one. They belong to no feature and are always in the adjustment.

    Examples
    --------
    >>> import numpy as np
    >>> import termsel
    >>> equations = termsel.Equations(np.eye(2), np.ones(2), np.array([0, 0]))
    >>> equations.A.shape
    (2, 2)
    """

    A: FloatArray
    b: FloatArray
    feature: IntArray
    prior: FloatArray | None = None

    @property
    def n_features(self) -> int:
        """Number of features with equations."""
        return int(self.feature.max()) + 1 if len(self.feature) else 0

    def take(self, rows: BoolArray, columns: BoolArray) -> Equations:
        """Return the system of some rows and columns."""
        if rows.all() and columns.all():
            return Equations(np.ascontiguousarray(self.A), np.ascontiguousarray(self.b),
                             np.ascontiguousarray(self.feature), self.prior)
        return Equations(np.ascontiguousarray(self.A[np.ix_(rows, columns)]),
                         np.ascontiguousarray(self.b[rows]),
                         np.ascontiguousarray(self.feature[rows]),
                         None if self.prior is None else self.prior[columns])

    def with_prior(self) -> tuple[FloatArray, FloatArray]:
        """Return design matrix (m + q, k) and right-hand side (m + q,), pseudo-observations last.

        There are q of them, one for each term that has a prior.
        """
        if self.prior is None:
            return self.A, self.b
        rows = np.diag(self.prior)[self.prior > 0]  # weight times coefficient is 0
        return np.concatenate([self.A, rows]), np.concatenate([self.b, np.zeros(len(rows))])


@explains_arguments()
def line_normals(lines: Lines) -> tuple[FloatArray, FloatArray]:
    """Return the Hesse normal form of image lines.

    The line through both image points is the set of (l, s) with nl * l + ns * s = rho.

    Parameters
    ----------
    lines : Lines
        n of them; their ground plays no part.

    Returns
    -------
    normal : ndarray, shape (n, 2)
        Unit normals (nl, ns).
    rho : ndarray, shape (n,)
        Signed distances from the origin.

    Examples
    --------
    >>> import termsel
    >>> lines = termsel.Lines(["L"], [[[2.0, 0.0], [2.0, 5.0]]], [[[0, 0, 0], [0, 1, 0]]])
    >>> normal, rho = termsel.line_normals(lines)
    >>> abs(normal).tolist(), abs(rho).tolist()
    ([[1.0, 0.0]], [2.0])
    """
    if not len(lines):
        return np.empty((0, 2)), np.empty(0)
    direction = lines.image[:, 1] - lines.image[:, 0]
    normal = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return normal, np.einsum("ij,ij->i", normal, lines.image.mean(axis=1))


def row_axes(A: FloatArray, axis: IntArray) -> IntArray:
    """Return the image axis of each row of A (m, k), given that of each term (k,).

    0 is line, 1 sample, 2 both.
    """
    # A term of both axes counts for each of them.
    line = (A[:, axis != 1] != 0).any(axis=1)
    sample = (A[:, axis != 0] != 0).any(axis=1)
    return np.where(line & sample, 2, np.where(sample, 1, 0)).astype(np.intp)


def weights_of(points: Points) -> FloatArray:
    """Return the factors of the points' equations, (n, 2).

    They are the median standard deviation divided by that of the coordinate; 1 where none are
    stated.
    """
    if points.sigma is None:
        return np.ones_like(points.image)
    return np.asarray(median_of(points.sigma.ravel()) / points.sigma)


def has_unlike_weights(points: Points) -> bool:
    """Return whether points state standard deviations that differ from point to point."""
    return (points.sigma is not None and len(points) > 0
            and bool((np.ptp(points.sigma, axis=0) > 0.0).any()))


# Points and lines in an adjustment: their rows, positions of vertices, and weights.

QUADRATIC_FEATURES = 20
"""Features that determine a quadratic polynomial twice over: two equations each, for 20 unknowns.
"""

ROUGH_RANK = 1e-6
"""Singular values, by the largest, below which rough image positions do without a direction."""

_APPROXIMATE: WeakKeyDictionary[FeatureSet, dict[bool, FloatArray]] = WeakKeyDictionary()
"""Held by the features, for each step of each fit to them, and gone with them; by whether heights
are used."""


def approximate_image(features: FeatureSet, *, heights: bool = True) -> FloatArray:
    """Return approximate image positions of the ground vertices of control lines, (2 n_lines, 2).

    A polynomial without denominators (quadratic if the features determine it twice over, else
    affine), of heights or not, is fitted to all control features and evaluated at the vertices. All
    coordinates are scaled. They are kept as long as the features live, read-only.
    """
    positions = _APPROXIMATE.setdefault(features, {})
    if heights not in positions:
        positions[heights] = _approximate_image(features, heights)
        positions[heights].setflags(write=False)
    return positions[heights]


def _approximate_image(features: FeatureSet, heights: bool) -> FloatArray:
    """Return what `approximate_image` does; `heights` says whether z takes part.

    Terms of an RFM are weighted by the denominator, which needs image coordinates, and a line has
    none along itself. So a polynomial is fitted to points and lines together, A x = b: a point has
    its line and its sample, a vertex lies on its image line, n'(l, s) = rho.
    """
    def monomials(ground: FloatArray, degree: int) -> FloatArray:
        """Return the monomials up to degree 1, (n, 4), or 2, (n, 10), at places (n, 3)."""
        x, y, z = ground.T if heights else (*ground.T[:2], np.zeros(len(ground)))
        linear = [np.ones_like(x), x, y, z]
        if degree == 1:
            return np.stack(linear, axis=1)
        return np.stack([*linear, x * y, x * z, y * z, x * x, y * y, z * z], axis=1)

    points = features.points
    lines = features.lines
    degree = 2 if len(features) >= QUADRATIC_FEATURES else 1
    normal, rho = line_normals(lines)
    # Both vertices of a line have its normal.
    normal = np.repeat(normal, 2, axis=0)
    rho = np.repeat(rho, 2)
    of_vertices = monomials(lines.ground.reshape(-1, 3), degree)
    of_points = monomials(points.ground, degree)
    zeros = np.zeros_like(of_points)
    A = np.concatenate([
        np.concatenate([normal[:, :1] * of_vertices, normal[:, 1:] * of_vertices], axis=1),
        np.concatenate([of_points, zeros], axis=1),
        np.concatenate([zeros, of_points], axis=1)])
    b = np.concatenate([rho, points.image[:, 0], points.image[:, 1]])
    # Of terms that the features do not determine, the smallest solution is rough enough.
    x = np.linalg.lstsq(A, b, rcond=ROUGH_RANK)[0].reshape(2, -1)
    return np.asarray(of_vertices @ x.T)


@explains_arguments()
def row_weights(features: FeatureSet, *, heights: bool = True) -> FloatArray:
    """Return weights of the rows of points, then of lines, two each.

    Rows are weighted by standard deviations relative to the median one. The standard deviation of a
    line's row is that of the image line at the vertex: with two end points measured to s, a
    distance of L apart, it is s sqrt(1/2 + 2 t^2 / L^2) at t from their middle. So long lines have
    more weight outside their measured piece. The correlation of both vertices of a line, through
    these end points, is neglected.

    Parameters
    ----------
    features : FeatureSet
        In scaled coordinates.
    heights : bool
        Whether the model uses heights.

    Returns
    -------
    ndarray, shape (2 n_points + 2 n_lines,)
        The median standard deviation, or 1 where none is given, over that of the row.

    Examples
    --------
    >>> import termsel
    >>> points = termsel.Points(["A", "B"], [[0, 0], [1, 1]], [[0, 0, 0], [1, 1, 0]],
    ...                         [[1.0, 1.0], [2.0, 2.0]])
    >>> termsel.row_weights(termsel.FeatureSet(points)).tolist()
    [1.5, 1.5, 0.75, 0.75]
    """
    points = features.points
    lines = features.lines
    # Of line and sample of a point, and of a line across it, relative to the median of all.
    deviations = [sigma.ravel() for sigma in (points.sigma, lines.sigma) if sigma is not None]
    deviation = np.ones((len(points) + len(lines), 2))
    if deviations:
        unit = np.median(np.concatenate(deviations))
        if points.sigma is not None:
            deviation[:len(points)] = points.sigma / unit
        if lines.sigma is not None:
            deviation[len(points):] = lines.sigma[:, None] / unit
    if len(lines):
        direction = lines.image[:, 1] - lines.image[:, 0]
        length = np.linalg.norm(direction, axis=1)[:, None]
        vertices = approximate_image(features, heights=heights).reshape(-1, 2, 2)
        # t of each vertex, in image units along the line.
        offset = np.einsum("ia,iva->iv", direction / length,
                           vertices - lines.image.mean(axis=1)[:, None])
        # s sqrt(1/2 + 2 t^2 / L^2): both end points to s, and t from their middle.
        deviation[len(points):] *= np.sqrt(0.5 + 2.0 * (offset / length) ** 2)
    return np.asarray(1.0 / deviation.ravel())


@explains_arguments()
def image_equations(features: FeatureSet, of_points: FloatArray, of_vertices: FloatArray,
                    at_points: FloatArray | float = 0.0, at_vertices: FloatArray | float = 0.0, *,
                    heights: bool = True) -> Equations:
    """Return weighted equations from image coordinates that are linear in the terms.

    The image position of a ground point is a constant plus rows times coefficients. That of a
    control point is measured; those of a line's vertices lie on the image line.

    Parameters
    ----------
    features : FeatureSet
        In scaled coordinates.
    of_points, of_vertices : ndarray, shape (n, 2, k)
        Rows of line and sample of the control points, and of both vertices of each line.
    at_points, at_vertices : ndarray, shape (n, 2), or 0
        The constants.
    heights : bool
        Whether the model uses heights.

    Returns
    -------
    Equations
        Two rows per point, then two per line, weighted by `row_weights`.

    Examples
    --------
    >>> import numpy as np
    >>> import termsel
    >>> points = termsel.Points(["A"], [[0.1, 0.2]], [[0.0, 0.0, 0.0]])
    >>> shift = np.array([[[1.0, 0.0], [0.0, 1.0]]])  # a model of two constants
    >>> equations = termsel.image_equations(
    ...     termsel.FeatureSet(points), shift, np.empty((0, 2, 2)))
    >>> equations.A.shape, equations.b.tolist()
    ((2, 2), [0.1, 0.2])
    """
    points = features.points
    lines = features.lines
    A = of_points.reshape(2 * len(points), of_points.shape[2])
    b = (points.image - at_points).ravel()
    if len(lines):
        # Each of the two vertices of a line lies on it: n'(l, s) = rho.
        normal, rho = line_normals(lines)
        normal = np.repeat(normal, 2, axis=0)
        rho = np.repeat(rho, 2)
        constant = np.broadcast_to(at_vertices, (len(rho), 2))
        A = np.concatenate([A, np.einsum("na,nak->nk", normal, of_vertices)])
        b = np.concatenate([b, rho - np.einsum("na,na->n", normal, constant)])
    weight = row_weights(features, heights=heights)
    return Equations(A * weight[:, None], b * weight, np.repeat(features.feature, 2))
