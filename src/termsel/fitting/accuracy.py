"""Figures of accuracy: of points that took no part, by standards, and as it is predicted.

References
----------
FGDC-STD-007.3-1998, National Standard for Spatial Data Accuracy, section 3.2 and appendix 3-A.
ASPRS Positional Accuracy Standards for Digital Geospatial Data, edition 2 (2023, version 2 of
2024): at least 30 check points, accuracy as RMSE without a level of confidence.
"""

from __future__ import annotations

from collections.abc import Callable
from statistics import NormalDist
from typing import TypeVar

import numpy as np
from msgspec import UNSET

from termsel.adjustment.equations import has_unlike_weights, weights_of
from termsel.core.arguments import explains_arguments
from termsel.core.errors import TermselError, count_in_words
from termsel.data.coordinates.metres import offsets_in_metres
from termsel.data.features import FeatureSet, FloatArray, IntArray, Points
from termsel.data.fit_data import FitData, distance_off_plane, with_usual_heights
from termsel.data.record.chances import quantile_of, t_quantile
from termsel.data.record.figures import (
    CONFIDENCE,
    Accuracy,
    InImage,
    OnGround,
    Predicted,
    StandardFigure,
    rmse_interval,
)
from termsel.fitting.fit import Fit
from termsel.fitting.next_places import share_left
from termsel.fitting.residuals import freedom_of
from termsel.fitting.uncertainty import Experience, shared_variance, widening_of_projections

# The test of normality by Shapiro and Wilk: that of SciPy takes half a second to import.
#
# References
# ----------
# Shapiro, Wilk 1965: An analysis of variance test for normality. Biometrika 52, 591-611.
# Royston 1995: Remark AS R94. Applied Statistics 44, 547-551: the coefficients for any number.

NUMBERS = range(8, 5001)  # fewer errors show nothing, and for more the test has no table


def chances_if_normal(errors: FloatArray) -> tuple[float, float] | None:
    """Return the chance that normal errors look so little normal, for each column of (n, 2).

    It is that of the test of Shapiro and Wilk 1965, as Royston 1995 computes it (Applied Statistics
    44(4), algorithm AS R94). Returns None for a number that is not one of NUMBERS, and where the
    errors of a column are equal.
    """
    n = len(errors)
    if n not in NUMBERS or not np.ptp(errors, axis=0).all():
        return None
    normal = NormalDist()
    # Blom (1958): about the expected order statistics of n normal numbers.
    expected = np.array([normal.inv_cdf((i - 0.375) / (n + 0.25)) for i in range(1, n + 1)])
    # Royston (1995), equation for the two outermost weights by polynomials in u = 1 / sqrt(n); the
    # inner ones keep their ratios, so that the squares of all add up to one.
    u = n**-0.5
    inner = expected[2:-2]
    ends = expected[-2:] / np.sqrt(expected @ expected) + (
        np.polyval([-3.582633, 5.682633, -1.752461, -0.293762, 0.042981, 0.0], u),
        np.polyval([-2.706056, 4.434685, -2.071190, -0.147981, 0.221157, 0.0], u))
    inner = inner * np.sqrt((1 - 2 * ends @ ends) / (inner @ inner))
    # log(1 - W): W is the squared correlation of sorted errors with their weights.
    central = np.sort(errors, axis=0) - errors.mean(axis=0)
    log_unexplained = np.log1p(-(np.concatenate([-ends[::-1], inner, ends]) @ central) ** 2
                               / (central**2).sum(axis=0))
    # Normal after a transformation whose constants depend on n; small samples have another one.
    if n < 12:
        statistic = -np.log(0.459 * n - 2.273 - log_unexplained)
        mean = np.polyval([-6.714e-4, 0.025054, -0.39978, 0.5440], n)
        deviation = np.exp(np.polyval([-0.0020322, 0.062767, -0.77857, 1.3822], n))
    else:
        statistic = log_unexplained
        log = np.log(n)
        mean = np.polyval([0.0038915, -0.083751, -0.31082, -1.5861], log)
        deviation = np.exp(np.polyval([0.0030302, -0.082676, -0.4803], log))
    first_column, second_column = ((mean - statistic) / deviation).tolist()
    return normal.cdf(first_column), normal.cdf(second_column)


LATTICE_RATIO = 1 / 3
"""Least part that an error between lines of a lattice is of that between lines twice as far apart;
of the square, where lines walk at random."""

NSSDA_POINTS = 20
"""Fewest check points of NSSDA."""

NSSDA_FACTOR = 2.4477
"""Radius of the circle that holds 95 % of errors, by the standard deviation of an axis."""

ASPRS_POINTS = 30
"""Fewest check points of ASPRS 2024."""

MAX_LEVERAGE = 0.999
"""Leverage that a point has at most."""

PIXEL_POINTS = 100
"""Most points at which the size of a pixel on the ground is computed."""
MAX_PIXEL_RATIO = 50.0
"""Largest pixel on the ground by the median one: beyond it a model is not plausible."""

MIN_AXIS_RATIO = 0.6
"""Least ratio of the RMSE of x and y for which NSSDA has a figure."""

NO_EXPERIENCE = Experience(0.0, 0)


@explains_arguments()
def ce90(errors: FloatArray) -> FloatArray:
    """Return the circular error of nine in ten points: the 90 % quantile of the distances.

    Of errors (..., n, 2) it has the shape (...). It is interpolated linearly between the distances;
    no distribution is assumed.

    Parameters
    ----------
    errors : ndarray, shape (..., n, 2)
        Errors of n points, such as line and sample [px].

    Returns
    -------
    ndarray, shape (...)
        In the unit of the errors.

    Raises
    ------
    TermselError
        If there are no points, or not two numbers of each.

    Examples
    --------
    >>> import termsel
    >>> round(float(termsel.ce90([[0.0, 0.1 * i] for i in range(11)])), 3)
    0.9
    """
    shape = np.shape(errors)
    if len(shape) < 2 or shape[-1] != 2 or shape[-2] == 0:
        raise TermselError(f"the errors have the shape {shape}, expected (n, 2)",
                           hint="Give a row for each point, with two numbers, such as those of "
                                "line and sample.")
    return quantile_of(np.linalg.norm(errors, axis=-1), 0.9)


def predict_rmse(errors: FloatArray, effective: float, points: int,
                 shared: float | None = None,
                 experience: Experience = NO_EXPERIENCE) -> Predicted:
    """Return the RMSE that held-out errors predict, with an interval.

    `errors` [px] (n, 2) are those of points under choices made without them, `effective` the
    parameters of both axes together, `points` the number of independent points, 0 for places
    without number. `shared` is the relative variance of the mean square error that all places have
    in common; by default that of `effective` equally uncertain coefficients. `experience` counts
    next to the redundancy. The interval follows from these alone, without a constant of its own.
    """
    n = len(errors)
    freedom = freedom_of(errors)
    rmse = float(np.sqrt((errors**2).sum(axis=1).mean()))
    if freedom is None:
        return Predicted(rmse, rmse, rmse, points=points or None)
    # Relative variance of a squared distance. Few errors hardly show that their tails are long.
    spread = max(2 * n / freedom, experience.spread)
    redundancy = max(2 * n - effective + experience.freedom, 2.0)
    shared = effective / 2 / n**2 if shared is None else shared
    quantile = t_quantile((1 + CONFIDENCE) / 2, redundancy)
    # Variance of the logarithm of the RMSE: a mean of so many squares, those held out and those to
    # come; and what all places have in common, coefficients that few points determine and the doubt
    # which solution is right.
    variance = min(spread / redundancy / 2 + (spread / points if points else 0.0) / 4 + shared / 4,
                   quantile**2)
    # The prediction is the mean of a log-normal RMSE.
    middle = np.log(rmse) - variance / 2
    half = quantile * np.sqrt(variance)
    return Predicted(rmse, float(np.exp(middle - half)), float(np.exp(middle + half)),
                     points=points or None)


def predict_rmse_of_fit(fitted: Fit, errors: FloatArray, points: int,
                        ground: FloatArray | None = None) -> Predicted:
    """Return the RMSE that held-out errors [px] (n, 2) predict for a fit (see `predict_rmse`).

    `points` is the number of independent points, 0 for places without number. Where the `ground`
    (m, 3) of the points to come is given, it is the RMSE at their heights, even if these are unlike
    the control's. Where points state unlike standard deviations, squares are averaged by their
    weights.
    """
    in_use = fitted.control.take(fitted.used)
    is_weighted = has_unlike_weights(in_use.points) and len(in_use.points) == len(errors)
    ratio = 1.0
    if is_weighted:
        # Of unit weight: what all of them say of one variance, each by its own standard deviation.
        weighted = weighted_rmse(errors, in_use.points)
        errors = errors * weights_of(in_use.points)
        ratio = weighted / max(_plain_rmse(errors), np.finfo(float).tiny)
    experience = fitted.estimator.experience(fitted)
    if experience is None or not errors.any():
        shared = shared_variance(fitted.model, fitted.scaling.features(in_use))
        at_control = predict_rmse(
            _errors_with_all_points(fitted, errors), fitted.effective, points, shared)
    else:
        at_control = _predict_with_experience(fitted, errors, points, experience)
    if is_weighted:
        at_control = Predicted(at_control.rmse * ratio, at_control.low * ratio,
                               at_control.high * ratio)
    height_square = 0.0
    if ground is not None:
        height_square = _square_of_unlike_heights(fitted, in_use, ground)
    # What a metre of height does is one normal vector for all places, so that its square by the
    # mean of that is exponentially distributed: its quantile at p is -ln(1 - p).
    tails = -np.log1p([-(1 - CONFIDENCE) / 2, -(1 + CONFIDENCE) / 2])
    low, high = np.sqrt(height_square * tails)
    rmse, low, high = np.hypot([at_control.rmse, at_control.low, at_control.high],
                               [height_square**0.5, low, high]).tolist()
    return Predicted(rmse, low, high, points=points or None,
                     weighted=True if is_weighted else UNSET)


def weighted_rmse(errors: FloatArray, points: Points) -> float:
    """Return the RMSE of errors (n, 2) [px], weighted by the standard deviations of their points.

    Without standard deviations, and where errors of lines are among them, all errors count alike.
    """
    if not has_unlike_weights(points) or len(points) != len(errors):
        return _plain_rmse(errors)
    # sum(w^2 e^2) / sum(w^2) of each axis, as one may be measured better than the other: the error
    # of the model counts whole, whatever the weights are.
    precisions = weights_of(points)**2
    return float(np.sqrt(((precisions * errors**2).sum(axis=0) / precisions.sum(axis=0)).sum()))


def _plain_rmse(errors: FloatArray) -> float:
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


def predict_rmse_between_lines(errors: FloatArray, lines: IntArray) -> Predicted:
    """Return the RMSE between the lines of a lattice that errors without whole lines predict.

    Parameters
    ----------
    errors : ndarray, shape (m, 2)
        Of points under choices made without their lines [px].
    lines : ndarray of int, shape (m,)
        The line of each. Errors of one line are one observation.

    Notes
    -----
    Without a line its neighbours are twice as far apart. Where lines differ by chance, the true
    error is as large as that without the line. Where they walk at random, its square is a third:
    that of a Brownian bridge of length h is h/6 on the average, and that in the middle of 2h is
    h/2. Where they are smooth, it is less, some third. The interval goes from that third to all of
    it, by the chi-squared distribution of so many lines; its middle is the random walk.
    """
    count = len(np.unique(lines))
    held_out_rmse = float(np.sqrt((errors**2).sum(axis=1).mean()))
    low, high = rmse_interval(held_out_rmse, count)
    return Predicted(held_out_rmse * float(np.sqrt(LATTICE_RATIO)), LATTICE_RATIO * low, high)


def _errors_with_all_points(fitted: Fit, errors: FloatArray) -> FloatArray:
    """Return held-out errors of a projection, (n, 2), as they would be with all points in use.

    A point of the leverage h is predicted by the others with the variance s^2 / (1 - h), and a new
    measurement at its place by all of them with s^2 (1 + h). These are alike where h is small; but
    a projection of five or six points is hardly determined without one of them.

    How much smaller is not known better than the noise is (see `widening_of_projections`), and
    errors are no larger than those held out.

    That holds where noise is all that the model leaves. What a polynomial does not fit of a view,
    as of a camera that turns while it scans, is no noise: its held-out errors stand.
    """
    if fitted.view is None or len(fitted.control.lines) or len(errors) != fitted.used.sum():
        return errors
    # A projection is a quotient by the distance from a camera whose view the points show.
    ground = fitted.scaled_control.ground_vertices()
    if fitted.model.denominators(fitted.adjustment.coefficients, ground) is None:
        return errors
    points = fitted.scaled_control.points.take(fitted.used)
    spread = fitted.estimator.spread(fitted, points.ground)
    leverage = spread.variance * weights_of(points)**2 / spread.noise
    if not np.isfinite(leverage).all():
        return errors
    # Leverages add up to the number of parameters. Where these have a larger sum, the spread has
    # what the model does not fit as well, as of relief under a projection without heights.
    leverage = leverage * min(1.0, fitted.effective / float(leverage.sum()))
    widening = widening_of_projections(2 * len(errors) - fitted.effective)
    squares = widening * (1.0 - np.minimum(leverage, MAX_LEVERAGE)**2)
    return np.asarray(errors * np.sqrt(np.minimum(squares, 1.0)))


def _predict_with_experience(fitted: Fit, errors: FloatArray, points: int,
                             experience: Experience) -> Predicted:
    """Return the RMSE that held-out errors and what was known before them predict.

    Its logarithm is that of both, each by its degrees of freedom. Those of held-out errors are of
    fits with one point less: a camera of three points has none, and its errors say nothing.

    The errors (n, 2) are in px. Raises TermselError where the estimator's spread has no factors.
    """
    n = len(errors)
    spread = fitted.estimator.spread(fitted, fitted.scaled_control.take(fitted.used).points.ground)
    if spread.factors is None:
        raise TermselError(f"the estimator {fitted.estimator.name!r} has experience, but its spread"
                           " has no factors",
                           hint="Report this to the author of the estimator.")
    noise = float(spread.noise.sum())
    inside, outside = _squares_of_places(spread.factors, float(spread.noise.mean()))
    # A new point is less certain than one that the fit has seen, and more than one without which it
    # was fitted. Of least squares with points at random places, the geometric mean of both is that
    # of a new one within 1 % (from four points of an affine map on).
    total = float(np.sqrt((inside + noise) * (outside + noise)))
    freedom = experience.freedom + max(2 * n - experience.unknowns, 0)
    # The mean of a variance of v degrees of freedom is v / (v - 2) times its scale.
    widened = freedom / max(freedom - 2.0, 1.0)
    expected_square = total * widened * fitted.scaling.image_scale**2
    held_out_square = float((errors**2).sum(axis=1).mean())
    redundancy = max(2 * (n - 1) - experience.unknowns, 0)
    share = experience.freedom / (experience.freedom + redundancy)
    square_at_new = total / (outside + noise) * held_out_square
    square = square_at_new**(1.0 - share) * expected_square**share
    # The sum of squares of normal errors with the covariance C has the mean tr C and the variance
    # 2 tr C^2, of which noise has no part in common.
    factors = spread.factors.reshape(-1, spread.factors.shape[2])
    alike = float(((factors.T @ factors)**2).sum()) / (n * inside)**2
    shared = 2.0 * alike * ((total - noise) / total)**2
    return predict_rmse(errors * np.sqrt(square / held_out_square),
                        min(fitted.effective, experience.unknowns), points, shared, experience)


def _squares_of_places(factors: FloatArray, noise: float) -> tuple[float, float]:
    """Return the mean square errors at control, with and without the point at each place.

    Factors (n, 2, d) are those of the covariance A of both axes, and `noise` is the variance s^2 of
    a measurement. Without one it is A (1 - A / s^2)^-1.
    """
    covariances = factors @ factors.transpose(0, 2, 1)
    leverages = np.minimum(np.linalg.eigvalsh(covariances) / noise, MAX_LEVERAGE)
    inside = np.einsum("nii->n", covariances).mean()
    outside = noise * (leverages / (1.0 - leverages)).sum(axis=1).mean()
    return float(inside), float(outside)


def predict_rmse_of_all(fitted: Fit, expected: Predicted, ground: FloatArray) -> Predicted:
    """Return the RMSE predicted for the same structure once places (m, 3) are control, too.

    `expected` is that of the fit without them. By what the error falls follows from the places
    alone, so that their measurements stay unseen.
    """
    share = share_left(fitted, ground)
    return Predicted(expected.rmse * share, expected.low * share, expected.high * share,
                     pixel=expected.pixel, weighted=expected.weighted)


def pixel_on_ground(fitted: Fit) -> float | None:
    """Return how far a pixel is on the ground [m]: root of the mean square at the control.

    Returns None without control points, and where the CRS does not show metres, or the model has no
    inverse, or is not plausible: pixels of one image differ too much.
    """
    points = fitted.control.points
    if not len(points):
        return None
    evenly = np.linspace(0, len(points) - 1, min(len(points), PIXEL_POINTS)).astype(int)
    points = points.take(evenly)
    heights = np.nan_to_num(points.ground[:, 2])
    image = fitted.project(np.column_stack([points.ground[:, :2], heights]))
    squares = []
    try:
        here = fitted.locate(image, heights)
        for step in np.eye(2):
            offsets = (fitted.locate(image + step, heights) - here)[:, :2]
            metres = offsets_in_metres(fitted.control.crs, points.ground, offsets)
            if metres is None:
                return None
            squares.append((metres**2).sum(axis=1))
    except TermselError:  # a model that sees all places at one point, say
        return None
    finite = np.concatenate(squares)
    finite = finite[np.isfinite(finite)]
    # Where pixels of one image differ so much, a model is bent through an outlier.
    if not len(finite) or finite.max() > MAX_PIXEL_RATIO**2 * np.median(finite):
        return None
    return float(np.sqrt(finite.mean()))


def _square_of_unlike_heights(fitted: Fit, control: FeatureSet, ground: FloatArray) -> float:
    """Return the mean square error that places (m, 3) add by heights unlike the control's [px^2].
    """
    flat = FitData(control, fitted.scaling, False)
    usual = with_usual_heights(flat, ground)
    if usual is ground:
        return 0.0
    excess = (fitted.sigma(ground)**2 - fitted.sigma(usual)**2).sum(axis=1)
    excess = np.where(np.isfinite(excess), excess, distance_off_plane(flat, ground)[1]**2)
    return float(max(excess.mean(), 0.0))


_Distances = TypeVar("_Distances", InImage, OnGround)


def distance_figures(kind: Callable[..., _Distances], errors: FloatArray) -> _Distances:
    """Return the figures of errors (n, 2), of line and sample [px], or of x and y [m]."""
    axes = dict(zip(("line", "sample") if kind is InImage else ("x", "y"),
                    np.sqrt((errors**2).mean(axis=0)).tolist(), strict=True))
    return kind(**axes, n=len(errors), total=float(np.hypot(*axes.values())),
                maximum=float(np.linalg.norm(errors, axis=1).max()),
                ce90=float(ce90(errors)),
                mean=tuple(errors.mean(axis=0).tolist()), normal=chances_if_normal(errors),
                freedom=freedom_of(errors))


def accuracy_of(fitted: Fit, independent: Points) -> Accuracy | None:
    """Return the accuracy on independent points.

    Errors in the image are measured minus computed [px]. On the ground the measured position is
    located at the point's own height and compared with its coordinates, in metres where the CRS
    tells these. NSSDA and ASPRS figures follow where there are enough points. Returns None without
    points, and where the model has no image of some point.
    """
    if not len(independent):
        return None
    errors = fitted.errors(independent)
    if not np.isfinite(errors).all():
        return None
    # Computed minus given ground positions, (n, 2), where they are all known in metres.
    heights = independent.ground[:, 2]
    if not fitted.model.uses_height:
        heights = np.nan_to_num(heights)
    offsets = (fitted.locate(independent.image, heights) - independent.ground)[:, :2]
    metres = offsets_in_metres(fitted.control.crs, independent.ground, offsets)
    if metres is None or not np.isfinite(metres).all():
        ground = None
    else:
        ground = distance_figures(OnGround, metres)
    return Accuracy(distance_figures(InImage, errors), ground,
                    nssda_accuracy(len(independent), ground),
                    asprs_rmse(len(independent), ground))


def nssda_accuracy(points: int, ground: OnGround | None) -> StandardFigure:
    """Return the horizontal accuracy at 95 % confidence by NSSDA (appendix 3-A).

    It is NSSDA_FACTOR times the mean of the RMSEs of x and y, in the unit of `ground`. There is no
    figure, but the reason why, for fewer than NSSDA_POINTS points, and where the RMSEs of x and y
    differ too much.
    """
    missing = _why_missing(points, ground, NSSDA_POINTS)
    if ground is None or missing:
        return StandardFigure(None, missing)
    low, high = sorted((ground.x, ground.y))
    # The approximation by the mean holds for a ratio of at least 0.6.
    if high > 0 and low < MIN_AXIS_RATIO * high:
        return StandardFigure(None,
                              f"the RMSE of one axis is below {MIN_AXIS_RATIO:g} of the other")
    return StandardFigure(NSSDA_FACTOR * (low + high) / 2)


def asprs_rmse(points: int, ground: OnGround | None) -> StandardFigure:
    """Return the horizontal RMSE by ASPRS 2024 [m], or why there is none, as with too few points.
    """
    missing = _why_missing(points, ground, ASPRS_POINTS, "; for fewer run termsel accuracy")
    return StandardFigure(None if ground is None or missing else ground.total, missing)


def _why_missing(points: int, ground: OnGround | None, fewest: int, remedy: str = "") -> str | None:
    """Return why a figure of a standard is missing, as a clause; None if it is not missing.

    It is missing if the number of `points` is below `fewest`, or there is no figure on the ground.
    """
    if points < fewest:
        return (f"{count_in_words(points, 'independent check point')}, at least {fewest} "
                f"needed{remedy}")
    if ground is None:
        return "the errors on the ground are not known in metres"
    return None
