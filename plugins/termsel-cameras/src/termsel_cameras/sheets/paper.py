"""What the sheets of a series have in common: scale, turn, stretch and shear of paper and scan.

An affine map takes the ground of a sheet, in the projection of the series, to its scan. Its matrix
is exp(scale) S R: a rotation R by the turn, and a symmetric S of determinant 1 along the edges of
the scan, by which paper shrinks more along the sheet than across. The four numbers of a sheet
differ from those of others by chance; how much, the sheets with many points show. What an affine
map leaves is measurement and local deformation together.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from termsel import FeatureSet, FitData, Scaling, TermselError
from termsel.toolkit import FloatArray

PAPER_NAMES = ("scale", "turn", "stretch", "shear")
SCALE, TURN, STRETCH, SHEAR = range(4)
"""Places of the four numbers; the turn is an angle."""

MIN_POINTS_OF_PAPER = 4
"""Points from which on a sheet shows its paper, and what an affine map leaves."""

USUAL_SPREADS = np.array([0.003, 0.01, 0.003, 0.003])
"""Scales of the priors of the standard deviations among sheets, with long tails: paper shrinks by
some parts in a thousand, sheets lie on a scanner to half a degree."""

SIZES_OF_A_MAP = (0.005, 0.003)
"""Scales of the priors of stretch and shear of a single map, with long tails: paper shrinks by up
to some per cent, along its fibres less than across."""

NOISE_OF_A_MAP = 2.0
"""What a model usually leaves of lines, or of samples, of a single map [px]; it counts as
`MIN_FREEDOM` degrees of freedom."""

FREEDOM_OF_CHANCE = 12.0
"""Degrees of freedom of points at which the error of held-out points, by a model that they choose
themselves, says as much of a projection as what an affine map leaves: measured on simulated maps.
"""

SPREADS_TRIED = np.geomspace(1e-5, 10.0, 61)
"""Standard deviations among sheets that are averaged over."""

MAX_SCALE_SPREAD = 0.1
"""Largest standard deviation of the logarithms of scales of one series' sheets, scanned alike:
paper shrinks by few per cent."""

MIN_FREEDOM, MAX_FREEDOM = 2.0, 40.0
"""Bounds of the degrees of freedom that the usual noise of a series counts as."""

MIN_NOISE = 0.1
"""Least standard deviation of what an affine map leaves of a sheet [px]."""


@dataclass(frozen=True)
class Sheet:
    """What one sheet shows of the series.

    Parameters
    ----------
    values, variances : tuple of 4 floats
        The numbers of `PAPER_NAMES`, and their variances for a noise of 1 px.
    noise : float
        Standard deviation of what the affine map leaves of lines, or of samples [px].
    freedom : int
        Its degrees of freedom.
    points : tuple of str
        A mark of each point, by which the sheet is known again.
    """

    values: tuple[float, ...]
    variances: tuple[float, ...]
    noise: float
    freedom: int
    points: tuple[str, ...]


@dataclass(frozen=True)
class Paper:
    """What is known of a sheet by others of its series.

    Parameters
    ----------
    means, spreads : tuple of 4 floats
        Expected values of `PAPER_NAMES` and their standard deviations.
    noise, freedom : float
        Standard deviation of what an affine map leaves of lines, or of samples [px], and the
        degrees of freedom that it counts as.
    sheets : int
        How many sheets told it.
    """

    means: tuple[float, ...]
    spreads: tuple[float, ...]
    noise: float
    freedom: float
    sheets: int


def matrix_of(values: FloatArray) -> FloatArray:
    """Return the matrix (2, 2) from ground x, y to sample and minus line [px].

    `values` are log scale, turn [rad], stretch and shear.
    """
    scale, turn, stretch, shear = values
    # S = [[h e^r, k], [k, h e^-r]] has the determinant h^2 - k^2 = 1.
    h = np.hypot(1.0, shear)
    paper = np.array([[h * np.exp(stretch), shear], [shear, h * np.exp(-stretch)]])
    return np.asarray(np.exp(scale) * paper @ rotation_by(turn))


def rotation_by(turn: float) -> FloatArray:
    """Return the rotation (2, 2) by an angle [rad]."""
    return np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])


def values_of(matrix: FloatArray) -> FloatArray:
    """Return log scale, turn [rad], stretch and shear of a matrix (2, 2) of positive determinant.

    It is the inverse of `matrix_of`.
    """
    # The polar decomposition: a rotation U V', and a symmetric part U S U' of determinant 1 once
    # the scale is divided out.
    u, singular, v = np.linalg.svd(matrix)
    rotation = u @ v
    paper = (u * singular) @ u.T / np.sqrt(singular.prod())
    turn = np.arctan2(rotation[1, 0], rotation[0, 0])
    return np.array([np.log(singular.prod()) / 2.0, turn,
                     np.log(paper[0, 0] / paper[1, 1]) / 2.0, paper[0, 1]])


def sheet_of(features: FeatureSet) -> Sheet | None:
    """Return what a sheet shows of its paper, with the ground in its CRS of the fit.

    None if it has lines, fewer than `MIN_POINTS_OF_PAPER` points, points on a line, or a mirrored
    scan.
    """
    points = features.points
    count = len(points)
    if count < MIN_POINTS_OF_PAPER or len(features.lines):
        return None
    plan = plan_of(features, FitData.of(features).scaling)
    columns = np.column_stack([np.ones(count), plan - plan.mean(axis=0)])
    measured = to_upright(points.image)
    if np.linalg.matrix_rank(columns / np.linalg.norm(columns, axis=0), 1e-6) < 3:
        return None
    coefficients = np.linalg.lstsq(columns, measured)[0]
    matrix = coefficients[1:].T
    if np.linalg.det(matrix) <= 0.0:
        return None
    # Two equations a point, less the six coefficients of an affine transformation.
    freedom = 2 * count - 6
    residuals = measured - columns @ coefficients
    noise = max(float(np.sqrt((residuals**2).sum() / freedom)), MIN_NOISE)
    covariance = np.kron(np.eye(2), np.linalg.inv(columns.T @ columns)[1:, 1:])
    # Propagation of variances, J C J', for a noise of 1 px.
    slopes = _matrix_derivatives(matrix)
    variances = np.diag(slopes @ covariance @ slopes.T)
    return Sheet(tuple(values_of(matrix).tolist()), tuple(variances.tolist()), noise, freedom,
                 marks_of(features))


def plan_of(features: FeatureSet, scaling: Scaling) -> FloatArray:
    """Return x and y (n, 2) of points in the CRS of the fit, to which the scaling belongs."""
    scaled = scaling.ground(features.points.ground)[:, :2]
    return np.asarray(scaled * scaling.ground_scale[:2] + scaling.ground_offset[:2])


def to_upright(image: FloatArray) -> FloatArray:
    """Return samples and minus lines (n, 2), which run to the right and upwards."""
    return np.asarray(image[:, ::-1] * [1.0, -1.0])


def marks_of(features: FeatureSet) -> tuple[str, ...]:
    """Return a mark of each point by its coordinates, so that the same point is known in two files.
    """
    points = features.points
    rows = np.column_stack([points.image.round(3), points.ground[:, :2].round(6)])
    return tuple(hashlib.sha256(repr(row.tolist()).encode()).hexdigest()[:12] for row in rows)


def _matrix_derivatives(matrix: FloatArray) -> FloatArray:
    """Return the derivatives of the four numbers by the entries of a matrix, (4, 4)."""
    step = 1e-6 * float(np.linalg.norm(matrix))
    columns = []
    for entry in range(4):
        change = np.zeros((2, 2))
        change.flat[entry] = step
        difference = values_of(matrix + change) - values_of(matrix - change)
        difference[TURN] = wrap_angle(difference[TURN])
        columns.append(difference / (2.0 * step))
    return np.column_stack(columns)


def wrap_angle(angle: float) -> float:
    """Return an angle in [-pi, pi)."""
    return float((angle + np.pi) % (2.0 * np.pi) - np.pi)


def paper_of(sheets: Sequence[Sheet]) -> Paper:
    """Return what sheets let expect of the paper of another sheet of their series.

    Each of the four numbers is a random effect: normal among sheets, with a standard deviation that
    is averaged over (Gelman 2006, Bayesian Analysis 1(3), for the prior of that).

    Raises
    ------
    TermselError
        If there is no sheet.
    """
    if not sheets:
        raise TermselError(f"no other sheet of the series has {MIN_POINTS_OF_PAPER} points",
                           hint="Measure more points on some sheets, or leave series out.")
    noise, freedom = usual_noise(sheets)
    values, variances = _values_and_variances(sheets, noise, freedom)
    # Turns are counted from that of the first sheet, to which it is added again.
    first_turn = sheets[0].values[TURN]
    expected = np.array([_expected_value(*column) for column in zip(
        values.T, variances.T, USUAL_SPREADS, strict=True)])
    expected[TURN, 0] = wrap_angle(expected[TURN, 0] + first_turn)
    return Paper(tuple(expected[:, 0].tolist()), tuple(expected[:, 1].tolist()), noise, freedom,
                 len(sheets))


def evidence_of(sheets: Sequence[Sheet]) -> float:
    """Return the logarithm of how probable the points of all sheets are, but for a constant.

    The constant is the same in every projection. What counts is how little affine maps leave, and
    how alike the paper of the sheets is: numbers that differ less are predicted better.
    """
    noise, freedom = usual_noise(sheets)
    own = np.array([sheet.freedom for sheet in sheets])
    squares = own * np.array([sheet.noise for sheet in sheets]) ** 2
    of_residuals = _log_evidence_of_residuals(squares, own, noise, freedom)
    values, variances = _values_and_variances(sheets, noise, freedom)
    of_paper = [_log_evidence_of_number(*column) for column in zip(
        values.T, variances.T, USUAL_SPREADS, strict=True)]
    # From the density of the four numbers to that of the points: the root of their variances.
    of_units = 0.5 * np.log([sheet.variances for sheet in sheets])
    return float(of_residuals.sum() + sum(of_paper) + of_units.sum())


def evidence_of_map(count: int, held_out_rmse: float, shown: Sheet | None) -> float:
    """Return the logarithm of how probable the points of one map are, but for a constant.

    What counts is how little a model leaves of them, and how little stretch and shear it gives the
    paper, whose scale and turn may be any. An affine map of `count` points leaves the noise of
    `shown`, and shows the paper; None is a map that does not. The model that auto chooses may
    follow what no affine map does, but by its RMSE of held-out points [px], which chance rules
    where they are few. So the logarithm of the squares that are left is the mean of both, in which
    the one counts as `FREEDOM_OF_CHANCE`, the other as the degrees of freedom of the points.
    """
    freedom = max(2 * count - 6, 0)
    # Squares of lines and samples together are twice those of either.
    log_square = 2.0 * float(np.log(held_out_rmse)) - float(np.log(2.0))
    if shown is not None:
        log_square = (FREEDOM_OF_CHANCE * 2.0 * float(np.log(shown.noise)) + freedom * log_square
                      ) / (FREEDOM_OF_CHANCE + freedom)
    squares = np.array(freedom * np.exp(log_square))
    evidence = float(_log_evidence_of_residuals(
        squares, np.array(freedom), NOISE_OF_A_MAP, MIN_FREEDOM))
    if shown is None:
        return evidence
    # The variance of the noise by the usual one and by this map, each by its degrees of freedom.
    squared_noise = ((MIN_FREEDOM * NOISE_OF_A_MAP**2 + shown.freedom * shown.noise**2)
                     / (MIN_FREEDOM + shown.freedom))
    for number, usual_size in zip((STRETCH, SHEAR), SIZES_OF_A_MAP, strict=True):
        variance = shown.variances[number]
        # From the density of the number to that of the points: the root of its variance.
        evidence += 0.5 * float(np.log(variance)) + _log_evidence_about_zero(
            shown.values[number], variance * squared_noise, usual_size)
    return evidence


def _log_evidence_of_residuals(squares: FloatArray, own: NDArray[np.int_], noise: float,
                               freedom: float) -> FloatArray:
    """Return the logarithm of the density of residuals, but for a constant; shaped like `squares`.

    `squares` are the sums of their squares, of `own` degrees of freedom each. The variance, usually
    the square of `noise` with `freedom` degrees, is integrated out: residuals are of a multivariate
    t distribution.
    """
    from scipy.special import gammaln  # which all other commands need not import

    usual_square = freedom * noise**2
    return np.asarray(gammaln((freedom + own) / 2.0) - gammaln(freedom / 2.0)
                      + freedom / 2.0 * np.log(usual_square)
                      - (freedom + own) / 2.0 * np.log(usual_square + squares))


def _values_and_variances(sheets: Sequence[Sheet], noise: float,
                          freedom: float) -> tuple[FloatArray, FloatArray]:
    """Return the four numbers of each sheet (n, 4), and the variances of their errors.

    The noise of a sheet is that of its residuals and of the series, each by its degrees of freedom.
    Turns are counted from that of the first sheet, lest 359 and 1 degrees have the mean 180.
    """
    squares = np.array([(freedom * noise**2 + sheet.freedom * sheet.noise**2)
                        / (freedom + sheet.freedom) for sheet in sheets])
    values = np.array([sheet.values for sheet in sheets])
    variances = np.array([sheet.variances for sheet in sheets]) * squares[:, None]
    values[:, TURN] = [wrap_angle(turn - values[0, TURN]) for turn in values[:, TURN]]
    return values, variances


def _expected_value(values: FloatArray, variances: FloatArray,
                    usual_spread: float) -> tuple[float, float]:
    """Return the expected value of another sheet, and its standard deviation.

    `values` and `variances` (s,) are those of the sheets. The spread among sheets is averaged over;
    its prior is half a Cauchy distribution of the scale `usual_spread`.
    """
    log_joint, means, mean_variances = _by_spread(values, variances, usual_spread)
    posterior = np.exp(log_joint - log_joint.max())
    posterior /= posterior.sum()
    mean = float(posterior @ means)
    # With few sheets the tail of the prior alone determines the arithmetic mean of the squares, so
    # that the geometric one is taken.
    squares = SPREADS_TRIED**2 + mean_variances
    usual_square = float(np.exp(posterior @ np.log(squares)))
    return mean, float(np.sqrt(usual_square + posterior @ (means - mean) ** 2))


def _log_evidence_of_number(values: FloatArray, variances: FloatArray,
                            usual_spread: float) -> float:
    """Return the logarithm of the density of one number of all sheets, their mean and spread open.
    """
    log_joint, _, _ = _by_spread(values, variances, usual_spread)
    return float(np.logaddexp.reduce(log_joint))


def _log_evidence_about_zero(value: float, variance: float, usual_size: float) -> float:
    """Return the logarithm of the density of a number whose mean is zero, its spread open.
    """
    # The number is normal with the variance of its error and of its spread together.
    totals = variance + SPREADS_TRIED**2
    log_likelihoods = -0.5 * (np.log(totals) + value**2 / totals)
    return float(np.logaddexp.reduce(log_likelihoods + _log_priors(usual_size)))


def _log_priors(usual_spread: float) -> FloatArray:
    """Return the prior of each spread that is tried, by its logarithm, but for a constant."""
    return np.log(SPREADS_TRIED / (1.0 + (SPREADS_TRIED / usual_spread) ** 2))


def _by_spread(values: FloatArray, variances: FloatArray,
               usual_spread: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return how probable each spread of a number among sheets is, and its mean with that spread.

    `values` and `variances` (s,) are those of the sheets; the spreads are `SPREADS_TRIED` (k,).

    Returns
    -------
    log_joint : ndarray, shape (k,)
        Logarithm of likelihood times prior of each spread, but for a constant.
    means, mean_variances : ndarray, shape (k,)
        The mean over the sheets with that spread, and its variance.
    """
    # A sheet differs from the mean by its own error and by the spread: their variances add up.
    totals = variances + SPREADS_TRIED[:, None] ** 2
    weights = 1.0 / totals
    sums = weights.sum(axis=1)
    means = (weights * values).sum(axis=1) / sums
    # The likelihood of a spread, with the mean integrated out.
    log_likelihoods = -0.5 * (np.log(totals).sum(axis=1) + np.log(sums)
                              + (weights * (values - means[:, None]) ** 2).sum(axis=1))
    return log_likelihoods + _log_priors(usual_spread), means, 1.0 / sums


def reason_against(paper: Paper) -> str:
    """Return why sheets are no series from which another one could borrow; "" if they may be one.

    A single sheet may be one.
    """
    spread = paper.spreads[SCALE]
    if paper.sheets < 2 or spread <= MAX_SCALE_SPREAD:
        return ""
    return (f"the scales of the {paper.sheets} other sheets differ by {100 * spread:.0f} %, and "
            "those of one series, scanned alike, by a few per cent at most")


def usual_noise(sheets: Sequence[Sheet]) -> tuple[float, float]:
    """Return the noise of a series [px], and the degrees of freedom that it counts as.

    The variances of sheets are taken to have a scaled inverse chi-squared distribution, whose
    parameters are by the mean and the variance of their logarithms (Smyth 2004, Stat. Appl. Genet.
    Mol. Biol. 3(1), 3). A single sheet has the noise that it shows, with `MIN_FREEDOM`.
    """
    from scipy.special import digamma, polygamma  # which all other commands need not import

    halves = np.array([sheet.freedom for sheet in sheets]) / 2.0
    logs = np.log([sheet.noise**2 for sheet in sheets]) - digamma(halves) + np.log(halves)
    log_square = float(np.mean(logs))
    freedom = MIN_FREEDOM
    if len(sheets) > 1:
        excess = float(np.var(logs, ddof=1) - polygamma(1, halves).mean())
        # trigamma(x) is about 1 / x + 1 / (2 x^2), which is solved for x = freedom / 2.
        freedom = MAX_FREEDOM if excess <= 0.0 else (1.0 + np.sqrt(1.0 + 2.0 * excess)) / excess
        # Sheets cannot tell the noise with more degrees of freedom than they have together.
        freedom = float(np.clip(freedom, MIN_FREEDOM, min(MAX_FREEDOM, 2.0 * halves.sum())))
    log_square += float(digamma(freedom / 2.0) - np.log(freedom / 2.0))
    return float(np.exp(log_square / 2.0)), freedom
