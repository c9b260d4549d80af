"""Parameters of images when nobody knows how far they scatter: the posterior over both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from termsel_block.evidence.variances import OWN, TAIL
from termsel_block.geometry.cameras import Camera
from termsel_block.geometry.frame import FloatArray, IntArray

MOST = 200
"""Parameters with unknown variances above which the variances are taken as estimated: many images
tell them, and the time grows with the cube."""

_FIRST, _KEPT = 100, 400
"""Draws until the chain has forgotten its start, and those after it."""

_GRID = np.geomspace(1e-3, 30.0, 101)
"""Standard deviations over the first guess."""

_LEAST, _MOST = 0.03, 30.0
"""Standard deviation of an image's own parameters over that of all images."""


_PRECISIONS = 1e-6, 1e6
"""Of priors, over those of the first guesses."""


@dataclass(frozen=True, eq=False)
class Integrated:
    """The posterior of all parameters, with their variances unknown.

    Parameters
    ----------
    mean : ndarray, shape (p,)
        What the parameters are more than at the place of linearisation.
    covariance : ndarray, shape (p, p)
    draws : ndarray, shape (d, p)
        Of what they are off from that mean.
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
        Of an image and a scale, each.
    scale : ndarray, shape (n,)
        Number of that scale.
    least : float
        Of the standard deviation that all images share; nan where that is 1 and known.
    """

    images: tuple[IntArray, ...]
    scale: IntArray
    least: float


def unknown(cameras: Sequence[Camera]) -> int:
    """Return how many parameters of images have unknown variances."""
    return sum(2 for camera in cameras for name in camera.groups if name not in camera.wide)


def integrate(normal: FloatArray, step: FloatArray, cameras: Sequence[Camera],
              parameters: Sequence[FloatArray], slices: Sequence[slice],
              of_offset: float | None = None) -> Integrated:
    """Return the posterior of parameters of which some have unknown variances.

    Parameters
    ----------
    normal, step : ndarray, shapes (p, p) and (p,)
        The normal equations with the first guesses as priors, and their solution.
    cameras, parameters : sequence of Camera and of ndarray, shape (m, 2)
    slices : sequence of slice
        Where the parameters of each image are, then the offset of heights.
    of_offset : float, optional
        Weight of the prior of that offset, if its standard deviation is a guess.

    Notes
    -----
    The model is that of `variances.estimated`: a group of columns has one standard deviation in all
    images, half t about a first guess. Each image's own follows it with `OWN` degrees of freedom.
    Taken as known they would make errors look smaller than they are, as 20 columns tell a variance
    to a third. So is that of a DEM's offset.

    Columns of a group may be unlike (`Camera.scales`). An attitude bends images along their lines
    alone, and one variance of all columns of degree 2 would be too small for that of lines. So each
    scale has a standard deviation in all images, which follows the group's as an image's own does.

    Draws are those of Gibbs: parameters by variances, variances by parameters. Where data hardly
    tell a parameter, its scale follows it, and neither would move. So a scale is drawn a second
    time together with its parameters, as Yu and Meng 2011 interweave them (To center or not to
    center, J. Comput. Graph. Stat. 20(3), 531-570).
    """
    at, scale, groups = _unknown(cameras, slices)
    now = np.concatenate([parameter.T.ravel() for parameter in parameters])[at]
    if of_offset is not None:
        groups.append(_Group((np.array([len(at)]),), np.zeros(1, np.intp), np.nan))
        at = np.append(at, slices[-1].start)
        scale = np.append(scale, of_offset**-0.5)
        now = np.append(now, 0.0)
    rest = np.setdiff1d(np.arange(len(normal)), at)
    # Without the priors, and about zero: what the measurements say of the unknown parameters.
    of_data = normal.copy()
    aim = normal @ step
    of_data[at, at] -= scale**-2
    aim[at] += now / scale**2
    inner = linalg.cho_factor(of_data[np.ix_(rest, rest)])
    gain = linalg.cho_solve(inner, of_data[np.ix_(rest, at)])
    matrix = (of_data[np.ix_(at, at)] - of_data[np.ix_(at, rest)] @ gain) * np.outer(scale, scale)
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    matrix = (vectors * np.maximum(values, 0.0)) @ vectors.T  # what ties cannot tell is zero
    right = (aim[at] - gain.T @ aim[rest]) * scale + matrix @ (now / scale)
    means, draws, covariance = _chain(matrix, right, groups)
    middle = means.mean(axis=0)
    # And what the others are by them.
    to_all = np.zeros((len(normal), len(at)))
    to_all[at] = np.diag(scale)
    to_all[rest] = -gain * scale
    alone = linalg.cho_solve(inner, np.eye(len(rest)))
    found = to_all @ covariance @ to_all.T
    found[np.ix_(rest, rest)] += alone
    mean = to_all @ (middle - now / scale)
    mean[rest] += alone @ aim[rest]
    away = (draws - middle) @ to_all.T
    noise = np.random.default_rng(1).standard_normal((len(draws), len(rest)))
    away[:, rest] += linalg.solve_triangular(inner[0], noise.T, lower=inner[1]).T
    # At the mean what the measurements pull with is what the prior does.
    pulled = right - matrix @ middle
    every = np.full(len(normal), np.nan)
    for columns in (image for group in groups for image in group.images):
        square = float(middle[columns] @ middle[columns])
        # Nothing is measured where nothing differs from what is expected: the guess stays.
        ratio = float(middle[columns] @ pulled[columns]) / square if square > 0 else 1.0
        every[at[columns]] = np.clip(ratio, *_PRECISIONS) / scale[columns] ** 2
    return Integrated(mean, found, away, every)


def _unknown(cameras: Sequence[Camera], slices: Sequence[slice],
             ) -> tuple[IntArray, FloatArray, list[_Group]]:
    """Return the parameters whose variances are unknown, their first guesses, and the groups."""
    at: list[int] = []
    scale: list[float] = []
    members: dict[str, list[IntArray]] = {}
    least: dict[str, float] = {}
    scales: dict[str, list[str]] = {}
    for camera, part in zip(cameras, slices, strict=False):
        names = np.tile(camera.scales, 2)
        spread = np.tile(camera.spread, 2)
        for scale_name, group in dict(zip(camera.scales, camera.groups, strict=True)).items():
            if group in camera.wide:
                continue
            mine = np.flatnonzero(names == scale_name)
            members.setdefault(group, []).append(len(at) + np.arange(len(mine)))
            scales.setdefault(group, []).append(scale_name)
            at += (part.start + mine).tolist()
            scale += spread[mine].tolist()
            ratio = float((np.tile(camera.least, 2)[mine] / spread[mine]).max())
            least[group] = max(least.get(group, _GRID[0]), ratio)
    groups = [_Group(tuple(images), np.unique(scales[name], return_inverse=True)[1], least[name])
              for name, images in members.items()]
    return np.array(at, np.intp), np.array(scale), groups


def _chain(matrix: FloatArray, right: FloatArray, groups: Sequence[_Group],
           ) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return means by variances (d, k), draws (d, k), and the covariance (k, k) of all.

    Units are the first guesses.
    """
    rng = np.random.default_rng(0)
    k = len(right)
    shared = [1.0 if np.isnan(group.least) else max(0.3, group.least) for group in groups]
    own = [np.ones(len(group.images)) for group in groups]
    of_scale = [np.ones(group.scale.max() + 1) for group in groups]
    means = np.empty((_KEPT, k))
    draws = np.empty((_KEPT, k))
    total = np.zeros((k, k))
    precision = np.empty(k)
    for round_ in range(-_FIRST, _KEPT):
        for group, common, mine, each in zip(groups, shared, own, of_scale, strict=True):
            for columns, ratio in zip(group.images, mine * each[group.scale], strict=True):
                precision[columns] = (common * ratio) ** -2
        lower = np.linalg.cholesky(matrix + np.diag(precision))
        mean = linalg.cho_solve((lower, True), right, check_finite=False)
        x = mean + linalg.solve_triangular(lower, rng.standard_normal(k), lower=True, trans=1,
                                           check_finite=False)
        if round_ >= 0:
            means[round_] = mean
            draws[round_] = x
            total += linalg.lapack.dpotri(lower, lower=1)[0]
        for number, group in enumerate(groups):
            shared[number], own[number], of_scale[number] = _scales(
                x, matrix, right, group, own[number], of_scale[number], rng)
    total = np.tril(total) / _KEPT
    away = means - means.mean(axis=0)
    return means, draws, total + np.tril(total, -1).T + away.T @ away / _KEPT


def _scales(x: FloatArray, matrix: FloatArray, right: FloatArray, group: _Group, own: FloatArray,
            each: FloatArray, rng: np.random.Generator) -> tuple[float, FloatArray, FloatArray]:
    """Return draws of a group's standard deviation, of its images' over that of their scale, and of
    its scales' over that of the group; and scale `x` with the first."""
    squares = np.array([float(x[columns] @ x[columns]) for columns in group.images])
    count = np.array([len(columns) for columns in group.images])

    def drawn(over: FloatArray, number: IntArray) -> FloatArray:
        square = (over + OWN) / rng.chisquare(OWN + number)
        return np.clip(np.sqrt(square), _LEAST, _MOST)

    if np.isnan(group.least):
        return 1.0, drawn(squares, count), each
    grid = _GRID[group.least * 0.999 <= _GRID]
    prior = np.log(grid) - (TAIL + 1) / 2 * np.log1p(grid**2 / TAIL)
    common = _drawn(grid, prior - count.sum() * np.log(grid)
                    - float((squares / (own * each[group.scale])**2).sum()) / 2 / grid**2, rng)
    if len(each) > 1:
        each = drawn(np.bincount(group.scale, squares / (common * own)**2).astype(float),
                     np.bincount(group.scale, count).astype(np.intp))
    own = drawn(squares / (common * each[group.scale])**2, count)
    every = np.concatenate(group.images)
    shape = x[every] / common
    pulled = matrix[:, every] @ shape
    bend = float(shape @ pulled[every])
    slope = float(shape @ right[every] - pulled @ x) + common * bend
    again = _drawn(grid, prior - grid**2 * bend / 2 + grid * slope, rng)
    x[every] = again * shape
    return again, own, each


def _drawn(grid: FloatArray, logarithm: FloatArray, rng: np.random.Generator) -> float:
    """Return a draw from a grid by the logarithm of the density."""
    sums = np.cumsum(np.exp(logarithm - logarithm.max()))
    return float(grid[np.searchsorted(sums, rng.random() * sums[-1])])
