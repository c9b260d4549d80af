"""What a block is worth: each image and the places of ties, by points that took no part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from termsel import FeatureSet, Points
from termsel_block.estimation.adjustment import CHI2_MEDIAN_OFFSET
from termsel_block.estimation.starts import intersect
from termsel_block.evidence.variances import TAIL
from termsel_block.geometry.frame import FloatArray
from termsel_block.joint import BlockResult

_DRAWS = 400
_LEVEL = 0.9


@dataclass(frozen=True)
class Spread:
    """A predicted RMSE [px], and the interval that holds the actual one in 9 of 10 cases."""

    rmse: float
    low: float
    high: float


@dataclass(frozen=True)
class InSpace:
    """RMSE of places that independent points get by intersection [m], and of how many."""

    east: float
    north: float
    up: float
    n: int


def independent_points(result: BlockResult, i: int) -> Points | None:
    """Return the points of an image with the role independent; None if it has none."""
    features = result.block.images[i].features
    if features is None:
        return None
    points = features.points.take([role == "independent" for role in features.points.roles])
    return points if len(points) else None


def rms_length(errors: FloatArray) -> float:
    """Return the root mean square of the lengths of differences (n, 2); n is at least 1."""
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


def predicted_errors(
        result: BlockResult, i: int, seed: int = 0, *, anywhere: bool = False) -> Spread:
    """Return the predicted RMSE [px] of new points of an image, and its interval of the level 0.9.

    The points are measured as its control is, at the positions of its independent points. If it has
    none, or with `anywhere`, they are at those of its ties, so that images can be compared. Draws d
    are of the errors of its parameters, s^2 of the variance of control; with J the derivatives at a
    point, the mean square over the points is

        e^2 = mean |J d|^2 + 2 s^2.
    """
    points = None if anywhere else independent_points(result, i)
    rows = result.rows(i, _local_positions(result, i, points))
    # Each image has its own generator, so that its figures do not depend on other images'.
    rng = np.random.default_rng([seed, i])
    draws = _draw_errors(result, i, rng)
    squares = ((rows @ draws) ** 2).sum(axis=1).mean(axis=0)
    noise = _draw_noise_variances(result, draws.shape[1], rng)
    # The RMSE of few points scatters by chance; without independent points it is that of many.
    if points is not None:
        noise = noise * rng.chisquare(2 * len(points), draws.shape[1]) / (2 * len(points))
    errors = np.sqrt(squares + 2 * noise)
    low, high = np.quantile(errors, [(1 - _LEVEL) / 2, (1 + _LEVEL) / 2])
    return Spread(float(np.sqrt((errors**2).mean())), float(low), float(high))


def _local_positions(result: BlockResult, i: int, points: Points | None) -> FloatArray:
    """Return the positions (n, 3) of points in the frame of the block [m].

    If `points` is None they are those of the image's ties or, if it has none, of its control.
    """
    if points is not None:
        return result.frame.local(points.ground)
    in_image = result.block.ties.image == i
    if in_image.any():
        return np.asarray(result.adjusted.state.ties[result.block.ties.tie[in_image]])
    # Without ties an image is determined by its control.
    features = result.block.images[i].features
    assert features is not None
    return result.frame.local(features.points.ground)


def _draw_noise_variances(result: BlockResult, count: int, rng: np.random.Generator) -> FloatArray:
    """Return draws (count,) of the variance of control [px^2].

    Its posterior is a scaled inverse chi-squared distribution.
    """
    state = result.adjusted.state
    freedom = state.freedom_control
    # `sigma_control` is about the median of the posterior; the scale follows from that.
    scale = state.sigma_control**2 * (freedom - CHI2_MEDIAN_OFFSET)
    return np.asarray(scale / rng.chisquare(freedom, count))


def shared_sigma(result: BlockResult, i: int, features: FeatureSet, own_sigma: FloatArray,
                 seed: int = 0) -> tuple[float, float]:
    """Return the part of an image's error that its own fit does not show, for line and sample [px].

    They are standard deviations: the squares are the mean squares of the block's draws at the
    features, less those of `own_sigma` (n, 2), the deviations of the image's own fit there. Ties of
    a block may be off together, which a fit to them cannot show.
    """
    rows = result.rows(i, result.frame.local(features.points.ground))
    draws = _draw_errors(result, i, np.random.default_rng([seed, i]))
    # E[(J d)^2] over draws d of the parameters, for line and for sample of each place.
    squares = ((rows @ draws) ** 2).mean(axis=2)
    is_finite = np.isfinite(own_sigma).all(axis=1)
    if is_finite.any():
        excess = (squares - own_sigma**2)[is_finite].mean(axis=0)
    else:
        excess = squares.mean(axis=0)
    # The excess is negative if the image's own fit is the less certain one.
    line, sample = np.sqrt(np.maximum(excess, 0.0)).tolist()
    return line, sample


def _draw_errors(result: BlockResult, i: int, rng: np.random.Generator) -> FloatArray:
    """Return draws (p, d) of the errors of an image's parameters, from their posterior.

    They are those of the adjustment if it drew any.
    """
    draws = result.adjusted.draws
    return draws[i].T if draws else _draw_normal_errors(result, i, rng)


def _draw_normal_errors(result: BlockResult, i: int, rng: np.random.Generator) -> FloatArray:
    """Return draws (p, d) of an image's errors by its covariance and draws of prior variances."""
    covariance = result.covariances[i]
    # A parameter without variance would make the factorisation fail.
    root = np.linalg.cholesky(covariance + 1e-12 * np.eye(len(covariance)))
    return np.asarray(root @ rng.standard_normal((len(root), _DRAWS))
                      * np.sqrt(_draw_variance_ratios(result, i, rng)))


def _draw_variance_ratios(result: BlockResult, i: int, rng: np.random.Generator) -> FloatArray:
    """Return draws (p, d) of the ratio of parameters' variances to those in the covariance.

    The share of a variance that the prior determines scatters as the variance of the prior does,
    which the parameters of a group have in common. The share that measurements determine does not
    scatter, nor do priors that the block does not estimate.
    """
    camera = result.camera(i)
    state = result.adjusted.state
    groups = np.array(camera.groups)
    prior_share = np.diag(result.covariances[i]) / state.variances[i]
    # A scaled inverse chi-square of TAIL degrees of freedom, whose mean is 1.
    factor = np.ones((len(groups), _DRAWS))
    for name in dict.fromkeys(camera.groups):
        if name in camera.fixed_variance:
            continue
        factor[groups == name] = (TAIL - 2) / rng.chisquare(TAIL, _DRAWS)
    return np.asarray(1 + np.clip(prior_share, 0, 1)[:, None] * (factor - 1))


def errors_in_space(result: BlockResult) -> InSpace | None:
    """Return the RMSE [m] of the positions where the rays of independent points meet.

    The points are those that two images or more see; None if there are none.
    """
    truth_of: dict[str, FloatArray] = {}
    # Pairs of the number of an image and the position in it, by the point's name.
    rays_of: dict[str, list[tuple[int, FloatArray]]] = {}
    for i in range(len(result.block.images)):
        points = independent_points(result, i)
        if points is None:
            continue
        for name, ground, image in zip(points.ids, points.ground, points.image, strict=True):
            truth_of[name] = ground
            rays_of.setdefault(name, []).append((i, image))
    names = [name for name, rays in rays_of.items() if len(rays) > 1]
    if not names:
        return None
    actual = result.frame.local(np.array([truth_of[name] for name in names]))
    intersected = _intersect_rays(result, [rays_of[name] for name in names], actual)
    east, north, up = np.sqrt(((intersected - actual) ** 2).mean(axis=0))
    return InSpace(float(east), float(north), float(up), len(names))


def _intersect_rays(result: BlockResult, rays: Sequence[Sequence[tuple[int, FloatArray]]],
                    actual: FloatArray) -> FloatArray:
    """Return the positions (n, 3) [m] where the rays of n points meet.

    `rays` has for each point pairs of the number of an image and the point's position in it;
    `actual` (n, 3) are the true positions.
    """
    state = result.adjusted.state
    # `intersect` takes all rays of one image at once: index of each point, and where it is seen.
    by_image: dict[int, list[tuple[int, FloatArray]]] = {}
    for k, image_rays in enumerate(rays):
        for i, image in image_rays:
            by_image.setdefault(i, []).append((k, image))
    # All searches begin at the middle of the points. From its true position a point whose rays
    # hardly determine it would not move, and so look accurate.
    start = np.broadcast_to(actual.mean(axis=0), actual.shape).copy()
    all_rays = []
    for i, image_rays in by_image.items():
        points = np.array([k for k, _ in image_rays])
        positions = np.array([image for _, image in image_rays])
        all_rays.append((state.cameras[i], state.parameters[i], points, positions))
    return intersect(start, all_rays)
