"""Equations of control features: rows belong to features, columns to terms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from termsel.data.features import BoolArray, FloatArray, IntArray, Lines, Points
from termsel.data.record.chances import median


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
        Weights, as a factor of the row, of pseudo-observations that a coefficient is zero. They
        belong to no feature and are always in the adjustment. 0 for none.

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
        return Equations(np.ascontiguousarray(self.A[np.ix_(rows, columns)]),
                         np.ascontiguousarray(self.b[rows]),
                         np.ascontiguousarray(self.feature[rows]),
                         None if self.prior is None else self.prior[columns])

    def with_prior(self) -> tuple[FloatArray, FloatArray]:
        """Return design matrix and right-hand side with the pseudo-observations as last rows."""
        if self.prior is None:
            return self.A, self.b
        rows = np.diag(self.prior)[self.prior > 0]  # weight times coefficient is 0
        return np.concatenate([self.A, rows]), np.concatenate([self.b, np.zeros(len(rows))])


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
    """Return by what the equations of points are multiplied, shape (n, 2)."""
    return (np.ones_like(points.image) if points.sigma is None
            else np.asarray(median(points.sigma.ravel()) / points.sigma))
