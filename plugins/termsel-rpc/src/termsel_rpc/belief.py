"""What points say of the error of a vendor's RPC: all corrections on a grid, and their weights.

The prior: with (l, s) the RPC position of a ground point, from -1 to 1 over the RPC's image, the
correction of each axis is b0 + b1 l + b2 s. Coefficients are normal with the mean 0 and

    kind          b0       b1             b2
    as delivered  0        0              0
    shift         size     0              0
    drift         size     share size     0
    affine        size     share size     share size

as standard deviations [px]. A shift is as likely as all else, as it is what vendors' errors mostly
are. Neither size nor share are known, nor the noise of a measurement: all on a grid are averaged
with their posterior probabilities. Sizes are equally likely on a logarithmic scale, from half a
pixel to a thousand. A share is at most 1: attitude drifts by no more over a
scene than it is off. Noise is half a pixel or what the file says, within a factor of 2 as a rule:
its logarithm has Student's distribution, as some points are clicked in a web map. It is normal for
an RPC as delivered, lest rough points show that it has no error, and with one or two points, which
a drift fits exactly: what they differ by could be noise of any size else.

Every solution on the grid is linear in the measurements, so that errors of features that are left
out are in closed form those of the whole procedure repeated without them.

References
----------
Grodecki, Dial 2003, PE&RS 69(1), for the correction with a prior on its coefficients; Hoeting et
al. 1999, Statistical Science 14(4), for averaging. The prior's form is termsel's own.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from termsel_rpc.refinement import FloatArray

CORRECTION_KINDS = ("as delivered", "shift", "drift", "affine")

PRIOR = (0.25, 0.5, 0.125, 0.125)
"""How likely each kind is before anything is measured."""

USUAL_PX = 0.5
"""Usual standard deviation of a measurement [px]."""

SIZES = 2.0 ** np.arange(-1.0, 11.0)
"""Standard deviations of a shift [px]."""

SHARES = 10.0 ** np.arange(-2.0, 0.1, 0.5)
"""Standard deviations of the effect of a drift at the edge of the image, by that of the shift."""

NOISES = 10.0 ** np.arange(-1.5, 2.1, 0.25)
"""Standard deviations of a measurement, by the usual one."""

NOISE_SPREAD = np.log(2.0)
"""Scale of the natural logarithm of the noise before anything is measured."""

NOISE_FREEDOM = 4.0
"""Degrees of freedom of the distribution of that logarithm."""

NEGLIGIBLE = 50.0
"""Solutions less likely than the likeliest by this, in natural logarithms, are left out."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Solutions before anything is measured: standard deviations of coefficients, and of noise."""

    kind: FloatArray  # (c,): number in `CORRECTION_KINDS`
    scales: FloatArray  # (c, 6): of line, then of sample [px]
    noise: FloatArray  # (c,) [px]
    log: FloatArray  # (c,): logarithm of the prior probability


def correction_grid(kinds: Iterable[int], usual: float = USUAL_PX, *,
                    scattered: bool = True) -> Grid:
    """Return all corrections of some kinds on a grid of size, share and noise, with their priors.

    `kinds` are numbers in `CORRECTION_KINDS`; `usual` [px] is the noise that `NOISES` multiply.
    `scattered` says whether points show the noise by their scatter. If not all kinds are given, the
    probabilities do not sum to 1; `Belief` normalises them.
    """
    parts = []
    for kind in kinds:
        log_noise_prior = _log_prior_of_noise(has_tails=scattered and kind > 0)
        sizes = SIZES if kind else np.zeros(1)
        shares = SHARES if kind > 1 else np.zeros(1)
        # All combinations of size, share and noise; a kind without a size has the noise alone.
        size, share, noise = (axis.ravel() for axis in np.meshgrid(
            sizes, shares, np.arange(len(NOISES)), indexing="ij"))
        # Coefficients are normalised to the edge of the image: b1 and b2 are share times size
        # there.
        drift = size * share
        # Kind 3, affine, is the only one with a term of the sample.
        axis = np.stack([size, drift, drift * (kind > 2)], axis=1)
        parts.append((np.full(len(size), float(kind)), np.tile(axis, 2), NOISES[noise] * usual,
                      log_noise_prior[noise] + np.log(PRIOR[kind] / len(sizes) / len(shares))))
    return Grid(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def _log_prior_of_noise(*, has_tails: bool) -> FloatArray:
    """Return the logarithms of the probabilities of `NOISES`: Student's or the normal distribution.
    """
    squares = (np.log(NOISES) / NOISE_SPREAD) ** 2
    log = -0.5 * squares
    if has_tails:
        log = -0.5 * (NOISE_FREEDOM + 1.0) * np.log1p(squares / NOISE_FREEDOM)
    # Normalised over the grid.
    return np.asarray(log - np.logaddexp.reduce(log))


class _ProbableSolutions(NamedTuple):
    """Solutions that are not negligible next to the likeliest, given the measurements.

    `covariances` (c, 6, 6) are those of the coefficients divided by the variance of the noise;
    `log_evidence` is the logarithm of the sum of what all solutions explain, but for a constant.
    """

    solutions: Grid
    probabilities: FloatArray
    covariances: FloatArray
    log_evidence: float


@dataclass(frozen=True, eq=False)
class Belief:
    """All solutions for some features, with their probabilities.

    Parameters
    ----------
    rows : ndarray, shape (m, 6)
        Effect of each coefficient on each measurement.
    right : ndarray, shape (m,)
        Measured minus what the RPC says [px].
    feature : ndarray of int, shape (m,)
        The feature each row belongs to, counted from 0.
    """

    rows: FloatArray
    right: FloatArray
    feature: NDArray[np.intp]
    grid: Grid

    @cached_property
    def _posterior(self) -> _ProbableSolutions:
        """The solutions that are not negligible, with their probabilities after the measurements.
        """
        # With x = S u and u ~ N(0, I): the posterior of u has the precision I + S A^T A S / s^2.
        cells = self.grid
        by_noise = cells.scales / cells.noise[:, None]
        gram = by_noise[:, :, None] * (self.rows.T @ self.rows) * by_noise[:, None, :]
        precision = gram + np.eye(gram.shape[1])
        projected = by_noise * (self.rows.T @ self.right)
        solved = np.linalg.solve(precision, projected[..., None])[..., 0]
        # Residual sum of squares of the posterior mean, with the prior's part: b^T b - p^T M^-1 p.
        square = (self.right @ self.right
                  - np.einsum("ck,ck->c", projected, solved)) / cells.noise**2
        # Evidence of each solution: log p - (log det M + square) / 2 - m log s.
        log = (cells.log - 0.5 * (np.linalg.slogdet(precision)[1] + square)
               - len(self.right) * np.log(cells.noise))
        # Solutions less likely than e^-50 times the best change no figure.
        matters = log > log.max() - NEGLIGIBLE
        solutions = Grid(*(value[matters] for value in vars(cells).values()))
        scaled = by_noise[matters]
        covariance = scaled[:, :, None] * np.linalg.inv(precision[matters]) * scaled[:, None, :]
        total = np.logaddexp.reduce(log[matters])
        return _ProbableSolutions(solutions, np.exp(log[matters] - total), covariance, float(total))

    @property
    def log(self) -> float:
        """Logarithm of the evidence of all solutions."""
        # The constant that `_posterior` leaves out, as it is the same for all solutions.
        return float(self._posterior.log_evidence - 0.5 * len(self.right) * np.log(2 * np.pi))

    @cached_property
    def kinds(self) -> FloatArray:
        """Probability of each kind, shape (4,)."""
        posterior = self._posterior
        kinds = posterior.solutions.kind.astype(int)
        return np.bincount(
            kinds, posterior.probabilities, len(CORRECTION_KINDS)).astype(np.float64)

    @cached_property
    def _solutions(self) -> FloatArray:
        """Coefficients of each solution, shape (c, 6)."""
        # x = C A^T b, in which the variance of the noise cancels.
        return self._posterior.covariances @ (self.rows.T @ self.right)

    @cached_property
    def coefficients(self) -> FloatArray:
        """Coefficients [px], shape (6,): the mean of all solutions by their probabilities."""
        return np.asarray(self._posterior.probabilities @ self._solutions)

    @cached_property
    def covariance(self) -> FloatArray:
        """Covariance of the coefficients [px^2], shape (6, 6), with the spread between solutions.
        """
        solutions, probabilities, covariances, _ = self._posterior
        # Law of total variance: mean of covariances plus covariance of means.
        deviations = self._solutions - self.coefficients
        mean_covariance = np.einsum("c,cjk->jk", probabilities * solutions.noise**2, covariances)
        return np.asarray(
            mean_covariance + (probabilities[:, None] * deviations).T @ deviations)

    @cached_property
    def noise(self) -> float:
        """Mean variance of a measurement [px^2]."""
        return float(self._posterior.probabilities @ self._posterior.solutions.noise**2)

    def variance(self, rows: FloatArray) -> FloatArray:
        """Return the variances of further measurements [px^2], shape (m,), noise included.

        `rows` (m, 6) has the effect of each coefficient on each.
        """
        return np.asarray(np.einsum("mj,jk,mk->m", rows, self.covariance, rows) + self.noise)

    @cached_property
    def effective(self) -> float:
        """Number of effective parameters: the mean trace of the hat matrices A C A^T."""
        return float(np.einsum("c,cjk,jk->", self._posterior.probabilities,
                               self._posterior.covariances, self.rows.T @ self.rows))

    @cached_property
    def without_each(self) -> tuple[FloatArray, FloatArray]:
        """Errors of measurements (m,) [px] without their feature, and densities of features (n,).

        Each feature is left out of the whole procedure, in closed form. Its density is the
        logarithm of that of its measurements, given all other features.
        """
        solutions, probabilities, covariances, _ = self._posterior
        errors = np.empty(len(self.right))
        densities = np.empty(int(self.feature.max()) + 1)
        residuals = self.right - self._solutions @ self.rows.T
        for number in range(len(densities)):
            rows = np.flatnonzero(self.feature == number)
            # Errors without the feature are R^-1 r with R = I - A C A^T, for each solution.
            redundancy = np.eye(len(rows)) - self.rows[rows] @ covariances @ self.rows[rows].T
            solution_errors = np.linalg.solve(redundancy, residuals[:, rows, None])[..., 0]
            # The density of the feature by each solution: those errors are normal with the
            # covariance s^2 R^-1.
            square = np.einsum("cm,cm->c", residuals[:, rows], solution_errors) / solutions.noise**2
            log_density = (0.5 * (np.linalg.slogdet(redundancy)[1] - square)
                           - len(rows) * (np.log(solutions.noise) + 0.5 * np.log(2 * np.pi)))
            # Without the feature a solution has its probability divided by that density.
            log_weight = np.log(probabilities) - log_density
            densities[number] = -np.logaddexp.reduce(log_weight)
            errors[rows] = np.exp(log_weight + densities[number]) @ solution_errors
        return errors, densities
