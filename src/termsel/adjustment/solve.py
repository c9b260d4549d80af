"""One masked adjustment through LAPACK, with all its quality figures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from termsel.adjustment.equations import Equations
from termsel.data.features import BoolArray, FloatArray

TOLERANCE = 1e-8
"""A column is dependent if this fraction of its length or less is left once the columns before
it are removed; predictions from a system nearer to singular would be rounding error."""


@dataclass(frozen=True, eq=False)
class Adjustment:
    """A least-squares solution.

    Attributes
    ----------
    coefficients, deviations : ndarray, shape (k,)
        Of all terms, and their standard deviations; 0 where a term is not selected. Deviations are
        NaN where coefficients are not determined or there is no redundancy.
    n_terms, n_equations, rank : int
        Of the selected system.
    condition : float
        Ratio of the extreme singular values of its design matrix, with columns of length 1.
    sigma0 : float
        Standard deviation of unit weight; NaN without redundancy.
    correlations : ndarray, shape (n_terms, n_terms), or None
        Of the selected coefficients; None where they are not determined, or not known.
    steps, converged
        Gauss-Newton steps, None where equations are exact, and whether they converged.

    Examples
    --------
    >>> import termsel
    >>> fit = termsel.fit(termsel.simulate_scene("ikonos-hamedan"), "poly3d")
    >>> fit.adjustment.n_terms, fit.adjustment.rank
    (20, 20)
    """

    coefficients: FloatArray
    deviations: FloatArray
    n_terms: int
    n_equations: int
    rank: int
    condition: float
    sigma0: float
    correlations: FloatArray | None = None
    steps: int | None = None
    converged: bool = True

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
    """Solve a masked least-squares system, of selected terms (k,) and features (n,), None for all.

    A feature has all of its rows. An under-determined or rank-deficient mask is not an error: its
    violation is its rank defect, and its coefficients are those of the least-norm solution.
    """
    m, k = equations.A.shape
    columns = np.ones(k, dtype=bool) if terms is None else np.asarray(terms, dtype=bool)
    rows = np.ones(m, dtype=bool) if features is None else np.asarray(features)[equations.feature]
    used = equations.take(rows, columns)
    n_equations, n_terms = used.A.shape
    A, b = used.with_prior()
    # Columns of one length: the solution is the same and the condition is that of the problem,
    # not of the units.
    lengths = np.linalg.norm(A, axis=0)
    scaled = A / np.where(lengths > 0, lengths, 1.0)
    triangle = _triangle(scaled, b)
    # A column is dependent by the rule of the kernels, even if by pivoting none is.
    rank = n_terms if triangle is not None else _lower_rank(scaled)
    coefficients = np.zeros(k)
    deviations = np.zeros(k)
    condition = float("inf")
    sigma0 = float("nan")
    correlations = None
    if n_terms and n_equations:
        lengths[lengths == 0] = 1.0
        if triangle is not None:
            r = triangle[:, :n_terms]
            solved = np.linalg.solve(r, np.column_stack([triangle[:, n_terms], np.eye(n_terms)]))
            x = solved[:, 0]
            inverse = solved[:, 1:]
            condition = float(np.linalg.cond(r))
            if n_equations > n_terms:
                v = b - A @ (x / lengths)
                sigma0 = float(np.sqrt(v @ v / (len(b) - n_terms)))
            # R^-1 R^-T is the cofactor matrix.
            norms = np.sqrt((inverse**2).sum(axis=1))
            correlations = inverse @ inverse.T / np.outer(norms, norms)
            deviations[columns] = sigma0 * norms / lengths
        else:
            # Of least norm in columns of one length: not in those that were given.
            x = np.linalg.lstsq(scaled, b, rcond=TOLERANCE)[0]
            deviations[columns] = np.nan
        coefficients[columns] = x / lengths
    return Adjustment(coefficients=coefficients, deviations=deviations, n_terms=n_terms,
                      n_equations=n_equations, rank=rank, condition=condition, sigma0=sigma0,
                      correlations=correlations)


def _triangle(scaled: FloatArray, b: FloatArray) -> FloatArray | None:
    """Return R and Q'b of columns of one length, shape (n, n + 1); None without full rank.

    By the rule of the compiled kernels: each column keeps more than TOLERANCE of its length
    orthogonal to those before it.
    """
    m, n = scaled.shape
    if not n or m < n:
        return None
    r = np.asarray(np.linalg.qr(np.column_stack([scaled, b]), mode="r"))[:n]
    return r if (np.abs(np.diag(r)) > TOLERANCE).all() else None


def _lower_rank(scaled: FloatArray) -> int:
    """Return how many columns of one length, or 0, are independent, less than all; by pivoting."""
    live = scaled[:, scaled.any(axis=0)]
    if not live.size:
        return 0
    from scipy import linalg  # which systems of full rank need not import

    r = linalg.qr(live, mode="r", pivoting=True)[0]
    return min(int((np.abs(np.diag(r)) > TOLERANCE).sum()), int(scaled.shape[1]) - 1)
