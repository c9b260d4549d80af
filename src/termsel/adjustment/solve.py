"""One masked adjustment through LAPACK, with all its quality figures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from termsel.adjustment.equations import Equations
from termsel.measurements.features import BoolArray, FloatArray

TOLERANCE = 1e-8
"""A column is dependent if this fraction of its length or less is left once the columns before
it are removed; predictions from a system nearer to singular would be rounding error."""


@dataclass(frozen=True, eq=False)
class Adjustment:
    """A least-squares solution.

    Parameters
    ----------
    coefficients : ndarray, shape (k,)
        All terms; 0 where a term is not selected.
    residuals : ndarray, shape (m,)
        b - A x of all rows, selected or not.
    deviations : ndarray, shape (k,)
        Standard deviations of the coefficients; NaN where they are not determined or there is
        no redundancy, 0 where a term is not selected.
    n_terms, n_equations, rank : int
        Of the selected system.
    condition : float
        Ratio of the extreme singular values of the selected design matrix, its columns scaled
        to unit length.
    sigma0 : float
        Standard deviation of unit weight; NaN without redundancy.
    correlations : ndarray, shape (n_terms, n_terms), optional
        Correlations of the coefficients of the selected terms; None where they are not
        determined, or not known.
    """

    coefficients: FloatArray
    residuals: FloatArray
    deviations: FloatArray
    n_terms: int
    n_equations: int
    rank: int
    condition: float
    sigma0: float
    correlations: FloatArray | None = None

    @property
    def redundancy(self) -> int:
        """Degrees of freedom: equations minus terms."""
        return self.n_equations - self.n_terms

    @property
    def violation(self) -> int:
        """Number of terms beyond a unique solution; 0 is feasible."""
        return self.n_terms - self.rank

    @property
    def feasible(self) -> bool:
        """True if the selected terms are determined."""
        return self.violation == 0


def solve(
    equations: Equations,
    terms: BoolArray | None = None,
    features: BoolArray | None = None,
) -> Adjustment:
    """Solve a masked least-squares system.

    An under-determined or rank-deficient mask is not an error: its violation is its
    rank defect, and its coefficients are those of the least-norm solution.

    Parameters
    ----------
    equations : Equations
    terms : ndarray of bool, shape (k,), optional
        Selected columns; all by default.
    features : ndarray of bool, shape (n_features,), optional
        Selected features, each with all of its rows; all by default.

    Returns
    -------
    Adjustment
    """
    m, k = equations.A.shape
    columns = np.ones(k, dtype=bool) if terms is None else np.asarray(terms, dtype=bool)
    rows = np.ones(m, dtype=bool) if features is None else np.asarray(features)[equations.feature]
    used = equations.take(rows, columns)
    n_equations, n_terms = used.A.shape
    A, b = used.held()
    rank = _rank(A)
    coefficients, deviations = np.zeros(k), np.zeros(k)
    condition, sigma0 = float("inf"), float("nan")
    correlations = None
    if n_terms and n_equations:
        # Columns of one length: the solution is the same and the condition is that of the
        # problem, not of the units.
        lengths = np.linalg.norm(A, axis=0)
        lengths[lengths == 0] = 1.0
        if rank == n_terms:
            q, r = linalg.qr(A / lengths, mode="economic")
            x = linalg.solve_triangular(r, q.T @ b)
            inverse = linalg.solve_triangular(r, np.eye(n_terms))
            condition = float(np.linalg.cond(r))
            if n_equations > n_terms:
                v = b - A @ (x / lengths)
                sigma0 = float(np.sqrt(v @ v / (len(b) - n_terms)))
            norms = np.sqrt((inverse**2).sum(axis=1))
            correlations = inverse @ inverse.T / np.outer(norms, norms)
            deviations[columns] = sigma0 * norms / lengths
        else:
            x = linalg.lstsq(A / lengths, b, cond=TOLERANCE)[0]
            deviations[columns] = np.nan
        coefficients[columns] = x / lengths
    return Adjustment(coefficients, equations.b - equations.A @ coefficients, deviations,
                      n_terms, n_equations, rank, condition, sigma0, correlations)


def _rank(A: FloatArray) -> int:
    """Return the rank by the rule of the compiled kernels.

    Full rank means that each column keeps more than TOLERANCE of its length orthogonal to
    those before it. If one does not, pivoting counts the independent ones.
    """
    if 0 in A.shape:
        return 0
    lengths = np.linalg.norm(A, axis=0)
    live = A[:, lengths > 0] / lengths[lengths > 0]
    n_terms = A.shape[1]
    if not live.size:
        return 0
    if live.shape[1] == n_terms <= A.shape[0]:
        r = linalg.qr(live, mode="r")[0]
        if (np.abs(np.diag(r)) > TOLERANCE).all():
            return int(n_terms)
    r = linalg.qr(live, mode="r", pivoting=True)[0]
    return min(int((np.abs(np.diag(r)) > TOLERANCE).sum()), int(n_terms) - 1)
