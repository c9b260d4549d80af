"""One masked adjustment through LAPACK, with all its quality figures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from termsel.adjustment.equations import Equations
from termsel.data.features import BoolArray, FloatArray, IntArray

TOLERANCE = 1e-8
"""A column is dependent if this fraction of its length or less is left once the columns before
it are removed; predictions from a system nearer to singular would be rounding error."""

ROWS_AT_ONCE = 512
"""Rows of a tall matrix that are decomposed together: a cache holds them."""


def upper_triangle(columns: FloatArray) -> FloatArray:
    """Return R of the decomposition QR of a matrix (m, k), (min(m, k), k), up to signs of its rows.

    Of very many rows each block is decomposed, and then the triangles of all blocks, which is as
    exact (Demmel, Grigori, Hoemmen and Langou 2012, SIAM J. Sci. Comput. 34(1), A206).
    """
    k = columns.shape[1]
    # [A; B] = diag(Q_A, Q_B) [R_A; R_B], whose triangles are a matrix of far fewer rows.
    while len(columns) >= 8 * ROWS_AT_ONCE and 4 * k <= ROWS_AT_ONCE:
        end = len(columns) // ROWS_AT_ONCE * ROWS_AT_ONCE
        triangles = np.asarray(np.linalg.qr(columns[:end].reshape(-1, ROWS_AT_ONCE, k), mode="r"))
        columns = np.concatenate([triangles.reshape(-1, k), columns[end:]])
    return np.asarray(np.linalg.qr(columns, mode="r"))


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
        return self.rank == self.n_terms


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
    # R and Q'b, (n, n + 1), where each column keeps more than TOLERANCE of its length orthogonal
    # to those before it. By this rule of the kernels a column may depend where pivoting has none.
    triangle = None
    if 0 < n_terms <= len(A):
        upper = upper_triangle(np.column_stack([scaled, b]))[:n_terms]
        if (np.abs(np.diag(upper)) > TOLERANCE).all():
            triangle = upper
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


def _lower_rank(scaled: FloatArray) -> int:
    """Return how many columns (m, n) are independent, where not all are; their lengths are 1 or 0.
    """
    # QR with pivoting: the longest column a is taken out of all others, c - a (a'c) / (a'a), until
    # nothing is left. SciPy has it, but most runs import no other part of SciPy, which takes 0.2 s.
    remaining = scaled.copy()
    rank = 0
    while rank < min(len(scaled), scaled.shape[1] - 1):
        squares = np.einsum("ij,ij->j", remaining, remaining)
        longest = int(squares.argmax())
        if squares[longest] <= TOLERANCE**2:
            break
        direction = remaining[:, longest] / np.sqrt(squares[longest])
        remaining -= np.outer(direction, direction @ remaining)
        rank += 1
    return rank


# What is rounding of a computation, so that no choice is made by it.
#
# Residuals of points that a model fits exactly are rounding, and other processors round otherwise.
# A choice by them would differ from machine to machine, and add terms without any meaning.

ROUNDING = 1e-9
"""Share of the size of data below which errors are rounding.

Double precision has 2e-16, columns that nearly depend on each other lose six digits of it, and
files hold hardly more digits than this. Of an image of 10,000 px it is 5e-6 px.
"""


def replace_rounding_by_size(
        figures: FloatArray, floor: FloatArray | float, share: FloatArray) -> FloatArray:
    """Return figures of selections, of which mere rounding is replaced by the selection's size.

    Figures up to `floor` become that times the selection's share of what may be selected, 0 to 1:
    they stay below all others, and the smaller selection is the better one. The shape is that of
    the figures.
    """
    return np.asarray(np.where(figures <= floor, floor * share, figures))


def index_of_largest(values: FloatArray) -> IntArray:
    """Return the index of the largest of k values (..., k); the first one if several are equal.

    Values that differ from the largest by no more than its share `ROUNDING` are equal to it. Where
    any value is not negative, a negative one cannot be chosen.
    """
    maxima = values.max(axis=-1, keepdims=True)
    return np.asarray((values >= maxima - ROUNDING * np.abs(maxima)).argmax(axis=-1))


_SIGNIFICANT_BITS = 30
"""Binary digits of a figure that searches compare: 30 are a relative difference of 1e-9."""


def round_to_nine_digits(figures: FloatArray | float) -> FloatArray:
    """Return figures to nine significant digits, so that processors agree which are equal.

    A figure is m 2^e with 0.5 <= m < 1; m is rounded to 30 binary digits. Selections whose figures
    differ by the rounding of their computation alone then compare as equal, and a search takes the
    first of them on every processor.

    Examples
    --------
    >>> 0.1 + 0.2 == 0.3, round_to_nine_digits(0.1 + 0.2) == round_to_nine_digits(0.3)
    (False, True)
    """
    mantissa, exponent = np.frexp(figures)
    scale = 2.0 ** _SIGNIFICANT_BITS
    return np.asarray(np.ldexp(np.rint(mantissa * scale) / scale, exponent))


# Penalised least squares along the singular values of a design matrix.

PENALTIES = 401
"""Penalties that are tried: over eight decades a step is 5 %, finer than any choice shows."""

EQUAL_FIGURES = 1e-6
"""Figures that differ relatively by less than this are taken as equal."""


@dataclass(frozen=True, eq=False)
class Spectrum:
    """A regression in terms of its singular values."""

    values: FloatArray  # (p,): singular values that are not rounding error, from the largest
    # (p,): length of the target, over all its right-hand sides, along each left singular vector.
    inner: FloatArray
    outside: float  # square of the target's part that no column reaches
    freedom: int  # rows less unpenalised columns

    def penalties(self, smallest: float) -> FloatArray:
        """Return PENALTIES penalties from the largest singular value down to `smallest` times it.
        """
        return np.asarray(self.values[0] * np.geomspace(1.0, smallest, PENALTIES))

    def _residual_share(self, penalty: FloatArray) -> FloatArray:
        """Return 1 - s^2 / (s^2 + penalty^2), shape (n, p)."""
        square = penalty[:, None] ** 2
        return np.asarray(square / (self.values**2 + square))

    def gcv(self, penalty: FloatArray) -> FloatArray:
        """Return the generalised cross-validation (n,) of each penalty (n,), up to a factor.

        It is eq. 1.4 of Golub et al. (1979).
        """
        residual_share = self._residual_share(penalty)
        square = ((residual_share * self.inner) ** 2).sum(axis=1) + self.outside
        freedom = residual_share.sum(axis=1) + (self.freedom - len(self.values))
        return np.asarray(square / freedom**2)

    def curvature(self, penalty: FloatArray) -> FloatArray:
        """Return the curvature (n,) of the L-curve (log |residuals|, log |x|) at each penalty (n,).

        It is positive in a corner. With rho and eta, the sums of squares of residuals and
        coefficients, it needs only the slope of eta, since d rho = -penalty^2 d eta (Hansen 2001,
        section 3).
        """
        residual_share = self._residual_share(penalty)
        squares = ((1.0 - residual_share) * self.inner / self.values) ** 2
        eta = squares.sum(axis=1)
        rho = ((residual_share * self.inner) ** 2).sum(axis=1) + self.outside
        slope = -4.0 / penalty * (residual_share * squares).sum(axis=1)
        square = penalty**2
        return np.asarray(
            -2.0 * eta * rho / slope
            * (square * slope * rho + 2.0 * penalty * eta * rho + square**2 * eta * slope)
            / (square**2 * eta**2 + rho**2) ** 1.5)


def choose_penalty(spectrum: Spectrum, choice: str) -> float:
    """Return the penalty of the least GCV ("gcv"), or at the corner of the L-curve ("l-curve")."""
    if choice == "gcv":
        penalties = spectrum.penalties(TOLERANCE)
        gcv = spectrum.gcv(penalties)
        # GCV is often flat towards no penalty; the first of its least values is reproducible.
        return float(penalties[np.argmax(gcv <= gcv.min() * (1 + EQUAL_FIGURES))])
    # Below the least singular value the L-curve does not move (Hansen, O'Leary 1993).
    penalties = spectrum.penalties(spectrum.values[-1] / spectrum.values[0])
    curvature = spectrum.curvature(penalties)
    return float(penalties[curvature.argmax() if curvature.max() > 0.0 else -1])
