"""Hybrid model 1: a global polynomial, then the improved 2D projective on its output."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from termsel import FeatureSet, Option, Polynomial2D, line_normals, row_weights

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_MIN_DENOMINATOR = 0.1
"""Denominator at or below which a position counts as at a pole; it is 1 for the identity."""
_IDENTITY = np.concatenate([[0.0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0]])
"""Coefficients of x' = x, y' = y: of 1, x, y, xy for line and sample, and of the denominator."""


class Hybrid1(Polynomial2D):
    """2-D polynomial, overcorrected by an improved 2D projective transformation.

    The polynomial computes image coordinates (x, y). A second adjustment to the same control
    then maps them to the measured ones,

        x' = (a3 + a0 x + a1 y + a2 xy) / (1 + c0 x + c1 y + c2 xy),

    y' with b: 11 unknowns, solved as `dlt2d` is, from points and lines. Unknowns that the
    control does not determine stay those of x' = x, y' = y. They are not terms: only the terms of
    the polynomial can be selected, but the prediction after the second step counts. There is no
    prediction where the denominator of the second step is 0.1 or less, and none at all if that
    happens anywhere in the rectangle around the control in the image.

    References
    ----------
    Valadan Zoej et al. 2002, section 3.1, eq. 5. The paper's polynomial has 8 or 5 terms.
    """

    name = "hybrid-1"
    declared_options = (
        Option("degree", 3, "Total degree of the polynomial; 3 gives 10 terms per axis.",
               int, 1, 8),)

    def predict(self, coefficients: FloatArray, control: FeatureSet,
                ground: FloatArray) -> FloatArray:
        """Return scaled image positions after both steps.

        Parameters
        ----------
        coefficients : ndarray, shape (..., k)
            Coefficients of the polynomial; one set or many.
        control : FeatureSet
            Scaled control, by which the second step is fitted.
        ground : ndarray, shape (n, 3)
            Scaled positions on the ground.

        Returns
        -------
        ndarray, shape (..., n, 2)
            Infinite at poles of the second step; all infinite for a set of coefficients with a
            pole in the box around the control.
        """
        second = _fit_second_step(self.project(coefficients, control.ground_vertices()), control)
        image = _map_by_second_step(second, self.project(coefficients, ground))
        if len(control):
            image[_has_pole(second, control)] = np.inf
        return image


def _fit_second_step(computed: FloatArray, control: FeatureSet) -> FloatArray:
    """Return the coefficients of the second step, shape (..., 11), by least squares.

    It maps the image positions of the polynomial to the measured ones by a quotient of bilinear
    functions. Every row states that a vertex lies on an image line n x' = rho; a measured point is
    two such lines, one along each axis.

    Parameters
    ----------
    computed : ndarray, shape (..., n, 2)
        Image positions of the control's ground vertices by the polynomial.
    control : FeatureSet
        Scaled control.
    """
    points = control.points
    n = len(points)
    normals_of_lines, offset = line_normals(control.lines)
    normal = np.concatenate([np.tile(np.eye(2), (n, 1)), np.repeat(normals_of_lines, 2, axis=0)])
    rho = np.concatenate([points.image.ravel(), np.repeat(offset, 2)])
    weight = row_weights(control, heights=False)
    # A point is its own vertex twice, once a row; a line has two vertices with a row each.
    vertex = np.concatenate([np.repeat(np.arange(n), 2), np.arange(n, computed.shape[-2])])
    columns = _bilinear_columns(computed[..., vertex, :])
    # n x' = rho times the denominator is linear in the unknowns, as a direct linear transformation.
    A = weight[:, None] * np.concatenate(
        [normal[:, :1] * columns, normal[:, 1:] * columns, -rho[:, None] * columns[..., 1:]],
        axis=-1)
    # The pseudoinverse gives the smallest change of the identity that fits, so that unknowns that
    # the control does not determine keep their value there.
    change = np.linalg.pinv(A, rcond=1e-8) @ (weight * rho - A @ _IDENTITY)[..., None]
    return np.asarray(_IDENTITY + change[..., 0])


def _map_by_second_step(second: FloatArray, image: FloatArray) -> FloatArray:
    """Return image positions (..., n, 2) of the polynomial, `image`, mapped by the second step.

    `second` (..., 11) are its coefficients. Positions are infinite where the denominator is
    `_MIN_DENOMINATOR` or less.
    """
    # Coefficients 0 to 3 are the numerator of the line, 4 to 7 that of the sample.
    columns = _bilinear_columns(image)
    above = np.stack([np.einsum("...nk,...k->...n", columns, second[..., columns_of])
                      for columns_of in (slice(0, 4), slice(4, 8))], axis=-1)
    below = _denominator_values(second, columns)[..., None]
    return np.asarray(np.divide(above, below, out=np.full_like(above, np.inf),
                                where=below > _MIN_DENOMINATOR))


def _has_pole(second: FloatArray, control: FeatureSet) -> BoolArray:
    """Return whether the second step has a pole in the box around the control, shape (...).

    `second` (..., 11) are its coefficients; the box is that of the measured image positions.
    """
    image = control.image_vertices()
    (first_line, first_sample) = image.min(axis=0)
    (last_line, last_sample) = image.max(axis=0)
    # A bilinear function has its least value over a rectangle in a corner.
    corners = np.array([(first_line, first_sample), (first_line, last_sample),
                        (last_line, first_sample), (last_line, last_sample)])
    below = _denominator_values(second, _bilinear_columns(corners))
    return np.asarray((below <= _MIN_DENOMINATOR).any(axis=-1))


def _denominator_values(second: FloatArray, columns: FloatArray) -> FloatArray:
    """Return the denominators of the second step, shape (..., n).

    `second` are its coefficients (..., 11), `columns` those of the positions (..., n, 4).
    """
    return np.asarray(1 + np.einsum("...nk,...k->...n", columns[..., 1:], second[..., 8:]))


def _bilinear_columns(image: FloatArray) -> FloatArray:
    """Return 1, x, y, xy of image positions (..., n, 2), shape (..., n, 4)."""
    x = image[..., 0]
    y = image[..., 1]
    return np.stack([np.ones_like(x), x, y, x * y], axis=-1)
