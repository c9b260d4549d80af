"""Points and lines in an adjustment: their rows, positions of vertices, and weights."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np

from termsel.adjustment.equations import Equations, line_normals
from termsel.data.features import FeatureSet, FloatArray

# Each step of each fit to some features asks for the same; by whether heights are used.
_APPROXIMATE: WeakKeyDictionary[FeatureSet, dict[bool, FloatArray]] = WeakKeyDictionary()


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
    """Fit A x = b of points, dl and ds, and of lines, n'(l, s) = rho; return (l, s) of vertices."""
    def columns(ground: FloatArray, degree: int) -> FloatArray:
        x, y, z = ground.T if heights else (*ground.T[:2], np.zeros(len(ground)))
        linear = [np.ones_like(x), x, y, z]
        return np.stack(linear if degree == 1 else
                        [*linear, x * y, x * z, y * z, x * x, y * y, z * z], axis=1)

    points = features.points
    lines = features.lines
    degree = 2 if len(features) >= 20 else 1  # two equations of each; 20 unknowns
    vertices = lines.ground.reshape(-1, 3)
    normal, rho = line_normals(lines)
    normal = np.repeat(normal, 2, axis=0)
    rho = np.repeat(rho, 2)
    on_lines = columns(vertices, degree)
    on_points = columns(points.ground, degree)
    zeros = np.zeros_like(on_points)
    # A vertex lies on its image line; a point has its line and its sample.
    A = np.concatenate([
        np.concatenate([normal[:, :1] * on_lines, normal[:, 1:] * on_lines], axis=1),
        np.concatenate([on_points, zeros], axis=1),
        np.concatenate([zeros, on_points], axis=1)])
    b = np.concatenate([rho, points.image[:, 0], points.image[:, 1]])
    x = np.linalg.lstsq(A, b, rcond=1e-6)[0].reshape(2, -1)
    return np.asarray(on_lines @ x.T)


def relative_deviations(features: FeatureSet) -> FloatArray:
    """Return the standard deviations of points, then of lines, relative to the median one, (n, 2).

    They are of line and sample, of lines across them; 1 if none is given.
    """
    points = features.points
    lines = features.lines
    deviations = [sigma.ravel() for sigma in (points.sigma, lines.sigma) if sigma is not None]
    deviation = np.ones((len(points) + len(lines), 2))
    if deviations:
        unit = np.median(np.concatenate(deviations))
        if points.sigma is not None:
            deviation[:len(points)] = points.sigma / unit
        if lines.sigma is not None:
            deviation[len(points):] = lines.sigma[:, None] / unit
    return deviation


def row_weights(features: FeatureSet, *, heights: bool = True) -> FloatArray:
    """Return weights of the rows of points, then of lines, two each.

    Rows are weighted by standard deviations relative to the median one. That of a line is
    the standard deviation of its position at the vertex. With two end points measured to s, a
    distance of L apart, it is s sqrt(1/2 + 2 t^2 / L^2) at t from their middle: long lines have
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
    deviation = relative_deviations(features)
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
