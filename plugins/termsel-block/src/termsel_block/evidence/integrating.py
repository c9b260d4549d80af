"""Parameters of images when nobody knows how far they scatter: the posterior over both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from scipy import linalg

from termsel_block.evidence.variances import OWN_WEIGHT, TAIL
from termsel_block.geometry.cameras import Camera
from termsel_block.geometry.frame import FloatArray, IntArray

MAX_INTEGRATED = 200
"""Parameters with unknown variances above which the variances are taken as estimated: many images
show them, and the time grows with the cube."""

_BURN_IN, _N_DRAWS = 100, 400
"""Draws until the chain has forgotten its start, and draws after that, which count."""

_SIGMA_GRID = np.geomspace(1e-3, 30.0, 101)
"""Standard deviations over the first guess."""

_MIN_IMAGE_RATIO, _MAX_IMAGE_RATIO = 0.03, 30.0
"""Standard deviation of an image's own parameters over that of all images."""


_PRECISION_RANGE = 1e-6, 1e6
"""Range of the precisions of priors, divided by those of the first guesses."""


@dataclass(frozen=True, eq=False)
class Integrated:
    """The posterior of all parameters, with their variances unknown.

    Parameters
    ----------
    mean : ndarray, shape (p,)
        What the parameters are more than at the place of linearisation.
    covariance : ndarray, shape (p, p)
    draws : ndarray, shape (d, p)
        Draws of their differences from that mean.
    precision : ndarray, shape (p,)
        Inverse variances of priors that, as known ones, have that mean; nan where they are known.
    """

    mean: FloatArray
    covariance: FloatArray
    draws: FloatArray
    precision: FloatArray


@dataclass(frozen=True, eq=False)
class _Group:
    """Parameters whose standard deviation is unknown, of each image.

    Parameters
    ----------
    images : tuple of ndarray
        Numbers of the parameters of an image that share a scale, for each such pair.
    scale : ndarray, shape (n,)
        Number of the scale of each of these arrays.
    min_ratio : float
        Least ratio of the standard deviation that all images share; NaN where that is 1 and known.
    """

    images: tuple[IntArray, ...]
    scale: IntArray
    min_ratio: float


def count_unknown_variances(cameras: Sequence[Camera]) -> int:
    """Return the number of parameters of all images whose variances are unknown."""
    return sum(name not in camera.fixed_variance
               for camera in cameras for name in camera.groups)


def integrate(normal: FloatArray, step: FloatArray, cameras: Sequence[Camera],
              parameters: Sequence[FloatArray], slices: Sequence[slice],
              of_offset: float | None = None) -> Integrated:
    """Return the posterior of parameters of which some have unknown variances.

    Parameters
    ----------
    normal, step : ndarray, shapes (p, p) and (p,)
        The normal equations with the first guesses as priors, and their solution.
    cameras, parameters : sequence of Camera and of ndarray, shape (p,)
        The model of each image, and its parameters as they are now.
    slices : sequence of slice
        Where the parameters of each image are, then the offset of heights.
    of_offset : float, optional
        Weight of the prior of that offset, if its standard deviation is a guess.

    Notes
    -----
    The model is that of `variances.estimate_variances`: a group has one standard deviation in all
    images, half t about a first guess. Each image's own follows it with `OWN_WEIGHT` degrees of
    freedom. Taken as known they would make errors look smaller than they are, as 20 columns show a
    variance to a third. So is that of a DEM's offset.

    Columns of a group may be unlike (`Camera.scales`). An attitude bends images along their lines
    alone, and one variance of all columns of degree 2 would be too small for that of lines. So each
    scale has a standard deviation in all images, which follows the group's as an image's own does.

    Draws are those of Gibbs: parameters by variances, variances by parameters. Where data hardly
    show a parameter, its scale follows it, and neither would move. So a scale is drawn a second
    time together with its parameters, as Yu and Meng 2011 interweave them (To center or not to
    center, J. Comput. Graph. Stat. 20(3), 531-570).
    """
    at, scale, groups = _unknown_variances(cameras, slices)
    current = np.concatenate(parameters)[at]
    if of_offset is not None:
        groups.append(_Group((np.array([len(at)]),), np.zeros(1, np.intp), np.nan))
        at = np.append(at, slices[-1].start)
        scale = np.append(scale, of_offset**-0.5)
        current = np.append(current, 0.0)
    # Given the parameters with unknown variances all others are normal, and are eliminated.
    eliminated = np.setdiff1d(np.arange(len(normal)), at)
    # The equations of the data alone: the priors of the first guesses are taken off.
    data_normal = normal.copy()
    aim = normal @ step
    data_normal[at, at] -= scale**-2
    aim[at] += current / scale**2
    inner = linalg.cho_factor(data_normal[np.ix_(eliminated, eliminated)])
    gain = linalg.cho_solve(inner, data_normal[np.ix_(eliminated, at)])
    # The Schur complement of the eliminated ones, in units of the first guesses.
    complement = data_normal[np.ix_(at, at)] - data_normal[np.ix_(at, eliminated)] @ gain
    matrix = complement * np.outer(scale, scale)
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    # Rounding may leave eigenvalues below zero for what ties cannot show.
    matrix = (vectors * np.maximum(values, 0.0)) @ vectors.T
    # matrix @ x = right is what the data alone say of the parameters x, counted from zero.
    right = (aim[at] - gain.T @ aim[eliminated]) * scale + matrix @ (current / scale)
    means, draws, covariance = _sample_variances(matrix, right, groups)
    middle = means.mean(axis=0)
    # The matrix from these parameters to all, with the eliminated ones as they follow.
    to_all = np.zeros((len(normal), len(at)))
    to_all[at] = np.diag(scale)
    to_all[eliminated] = -gain * scale
    inverse_inner = linalg.cho_solve(inner, np.eye(len(eliminated)))
    full_covariance = to_all @ covariance @ to_all.T
    full_covariance[np.ix_(eliminated, eliminated)] += inverse_inner
    mean = to_all @ (middle - current / scale)
    mean[eliminated] += inverse_inner @ aim[eliminated]
    # Draws of the errors of all: those of the chain, and noise of the eliminated ones given these.
    errors = (draws - middle) @ to_all.T
    noise = np.random.default_rng(1).standard_normal((len(draws), len(eliminated)))
    errors[:, eliminated] += linalg.solve_triangular(inner[0], noise.T, lower=inner[1]).T
    # A known precision q of the prior has the same mean x if right - matrix @ x = q x.
    pull_of_data = right - matrix @ middle
    precision = np.full(len(normal), np.nan)
    for columns in chain.from_iterable(group.images for group in groups):
        square = float(middle[columns] @ middle[columns])
        # If the mean is zero the first guess stays.
        ratio = float(middle[columns] @ pull_of_data[columns]) / square if square > 0 else 1.0
        precision[at[columns]] = np.clip(ratio, *_PRECISION_RANGE) / scale[columns] ** 2
    return Integrated(mean, full_covariance, errors, precision)


def _unknown_variances(cameras: Sequence[Camera], slices: Sequence[slice],
                       ) -> tuple[IntArray, FloatArray, list[_Group]]:
    """Return which parameters have an unknown prior variance, first guesses of it, and groups.

    Returns
    -------
    indices : ndarray, shape (k,)
        Of the parameters among those of all images, by `slices`.
    guesses : ndarray, shape (k,)
        Their standard deviations as the cameras state them.
    groups : list of _Group
        Parameters that share a standard deviation, by their numbers among the k.
    """
    indices: list[int] = []
    guesses: list[float] = []
    members: dict[str, list[IntArray]] = {}
    min_ratio: dict[str, float] = {}
    scales: dict[str, list[str]] = {}
    # Behind the parameters of the images, `slices` has the offset of heights.
    for camera, columns in zip(cameras, slices, strict=False):
        names = np.array(camera.scales)
        sigma = np.array(camera.prior_sigma)
        least_sigma = np.array(camera.min_sigma)
        # Columns of one scale share a standard deviation, and several scales are one group.
        for scale_name, group in dict(zip(camera.scales, camera.groups, strict=True)).items():
            if group in camera.fixed_variance:
                continue
            in_scale = np.flatnonzero(names == scale_name)
            members.setdefault(group, []).append(len(indices) + np.arange(len(in_scale)))
            scales.setdefault(group, []).append(scale_name)
            indices += (columns.start + in_scale).tolist()
            guesses += sigma[in_scale].tolist()
            # The standard deviation of a group is at least the least one that its cameras state.
            ratio = float((least_sigma[in_scale] / sigma[in_scale]).max())
            min_ratio[group] = max(min_ratio.get(group, _SIGMA_GRID[0]), ratio)
    groups = [_Group(tuple(images), np.unique(scales[name], return_inverse=True)[1],
                     min_ratio[name])
              for name, images in members.items()]
    return np.array(indices, np.intp), np.array(guesses), groups


def _sample_variances(matrix: FloatArray, right: FloatArray, groups: Sequence[_Group],
                      ) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return means (d, k) and draws (d, k) of parameters, and their covariance (k, k).

    The data say matrix @ x = right. In each of d rounds of Gibbs' sampler variances are drawn by
    parameters, and parameters, of which the mean is kept, by variances. Units are the first
    guesses.
    """
    rng = np.random.default_rng(0)
    k = len(right)
    shared = [1.0 if np.isnan(group.min_ratio) else max(0.3, group.min_ratio) for group in groups]
    of_images = [np.ones(len(group.images)) for group in groups]
    of_scale = [np.ones(group.scale.max() + 1) for group in groups]
    means = np.empty((_N_DRAWS, k))
    draws = np.empty((_N_DRAWS, k))
    total = np.zeros((k, k))
    precision = np.empty(k)
    for round_ in range(-_BURN_IN, _N_DRAWS):
        for group, common, image_ratios, scale_ratios in zip(groups, shared, of_images, of_scale,
                                                             strict=True):
            for columns, ratio in zip(group.images, image_ratios * scale_ratios[group.scale],
                                      strict=True):
                precision[columns] = (common * ratio) ** -2
        # Parameters by variances: normal with precision M + D and mean (M + D)^-1 right.
        lower = np.linalg.cholesky(matrix + np.diag(precision))
        mean = linalg.cho_solve((lower, True), right, check_finite=False)
        x = mean + linalg.solve_triangular(lower, rng.standard_normal(k), lower=True, trans=1,
                                           check_finite=False)
        if round_ >= 0:
            means[round_] = mean
            draws[round_] = x
            total += linalg.lapack.dpotri(lower, lower=1)[0]
        # Variances by parameters, for each group by itself.
        for number, group in enumerate(groups):
            shared[number], of_images[number], of_scale[number] = _draw_scales(
                x, (matrix, right), group, of_images[number], of_scale[number], rng)
    total = np.tril(total) / _N_DRAWS
    deviations = means - means.mean(axis=0)
    # Law of total variance: the mean of covariances plus the covariance of means.
    return means, draws, total + np.tril(total, -1).T + deviations.T @ deviations / _N_DRAWS


def _draw_scales(x: FloatArray, equations: tuple[FloatArray, FloatArray], group: _Group,
                 of_images: FloatArray, of_scale: FloatArray, rng: np.random.Generator,
                 ) -> tuple[float, FloatArray, FloatArray]:
    """Return draws of a group's standard deviations, and scale its parameters in `x` with them.

    Returned are that of the group itself, those of its images over that of their scale, and those
    of its scales over that of the group; `of_images` and `of_scale` are the last draws of the
    latter two. `equations` are those of the data, a matrix (k, k) and a right side (k,).
    """
    matrix, right = equations
    squares = np.array([float(x[columns] @ x[columns]) for columns in group.images])
    count = np.array([len(columns) for columns in group.images])

    def draw_ratios(squares_by_shared: FloatArray, number: IntArray) -> FloatArray:
        """Return draws of ratios, whose squares are scaled inverse chi-squared.

        The sums of squares are of `number` parameters, divided by the shared variance.
        """
        square = (squares_by_shared + OWN_WEIGHT) / rng.chisquare(OWN_WEIGHT + number)
        return np.clip(np.sqrt(square), _MIN_IMAGE_RATIO, _MAX_IMAGE_RATIO)

    if np.isnan(group.min_ratio):
        return 1.0, draw_ratios(squares, count), of_scale
    grid = _SIGMA_GRID[group.min_ratio * 0.999 <= _SIGMA_GRID]
    # Half t with TAIL degrees of freedom, on a grid of logarithms.
    prior = np.log(grid) - (TAIL + 1) / 2 * np.log1p(grid**2 / TAIL)
    strain = float((squares / (of_images * of_scale[group.scale])**2).sum())
    common = _draw_from_grid(grid, prior - count.sum() * np.log(grid) - strain / 2 / grid**2, rng)
    # Scales of a group follow it as images follow their scale.
    if len(of_scale) > 1:
        of_scale = draw_ratios(
            np.bincount(group.scale, squares / (common * of_images)**2).astype(float),
            np.bincount(group.scale, count).astype(np.intp))
    of_images = draw_ratios(squares / (common * of_scale[group.scale])**2, count)
    columns = np.concatenate(group.images)
    # Interweaving: x / common is kept, and common is drawn again, by the data that x has to fit.
    shape = x[columns] / common
    product = matrix[:, columns] @ shape
    # The logarithm of the likelihood is a quadratic polynomial of the common standard deviation.
    bend = float(shape @ product[columns])
    slope = float(shape @ right[columns] - product @ x) + common * bend
    rescaled = _draw_from_grid(grid, prior - grid**2 * bend / 2 + grid * slope, rng)
    x[columns] = rescaled * shape
    return rescaled, of_images, of_scale


def _draw_from_grid(grid: FloatArray, logarithm: FloatArray, rng: np.random.Generator) -> float:
    """Return a value of a grid (g,), drawn by the logarithm of its density there, up to a constant.
    """
    sums = np.cumsum(np.exp(logarithm - logarithm.max()))
    return float(grid[np.searchsorted(sums, rng.random() * sums[-1])])
