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
    """Return the RMSE [px] of new points of an image, measured as its control is, and its interval.

    Over as many points as the image has independent ones, at their places; where it has none, or
    `anywhere`, over its ties, which compares images. With J the derivatives at a place, draws d of
    the errors of parameters and s^2 of the variance of control, the mean square over the places is

        e^2 = mean |J d|^2 + 2 s^2.

    What all its points have in common makes the interval, of the level 0.9, wide.
    """
    points = None if anywhere else independent_points(result, i)
    rows = result.rows(i, _local_places(result, i, points))
    # A generator of its own for each image: the figures do not depend on which others are asked
    # for.
    rng = np.random.default_rng([seed, i])
    draws = _draw_errors(result, i, rng)
    squares = ((rows @ draws) ** 2).sum(axis=1).mean(axis=0)
    noise = _draw_noise_variances(result, draws.shape[1], rng)
    # So few measurements have more noise than that, or less.
    if points is not None:
        noise = noise * rng.chisquare(2 * len(points), draws.shape[1]) / (2 * len(points))
    errors = np.sqrt(squares + 2 * noise)
    low, high = np.quantile(errors, [(1 - _LEVEL) / 2, (1 + _LEVEL) / 2])
    return Spread(float(np.sqrt((errors**2).mean())), float(low), float(high))


def _local_places(result: BlockResult, i: int, points: Points | None) -> FloatArray:
    """Return the places (n, 3) of points of an image; without any of its ties, or else control."""
    if points is not None:
        return result.frame.local(points.ground)
    in_image = result.block.ties.image == i
    if in_image.any():
        return np.asarray(result.adjusted.state.ties[result.block.ties.tie[in_image]])
    # An image without ties has control.
    features = result.block.images[i].features
    assert features is not None
    return result.frame.local(features.points.ground)


def _draw_noise_variances(result: BlockResult, count: int, rng: np.random.Generator) -> FloatArray:
    """Return draws (count,) of the variance of control [px^2], scaled inverse chi-square.

    It is known from few measurements, and the state has the median of its posterior.
    """
    state = result.adjusted.state
    freedom = state.freedom_control
    scale = state.sigma_control**2 * (freedom - CHI2_MEDIAN_OFFSET)
    return np.asarray(scale / rng.chisquare(freedom, count))


def shared_sigma(result: BlockResult, i: int, features: FeatureSet, own_sigma: FloatArray,
                 seed: int = 0) -> tuple[float, float]:
    """Return what the block knows an image's model to be off by, beyond what its own fit shows.

    Standard deviations of line and sample [px], over places of features: the mean squares of the
    block's draws, less the squares `own` (n, 2) of the image's own fit there. Places of ties are
    off together, which no fit to them alone can see.
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
    # A negative excess says that the image's own fit is the less certain one: nothing is shared
    # then.
    line, sample = np.sqrt(np.maximum(excess, 0.0)).tolist()
    return line, sample


def _draw_errors(result: BlockResult, i: int, rng: np.random.Generator) -> FloatArray:
    """Return draws (p, draws) of an image's errors from the posterior of its parameters."""
    drawn = result.adjusted.draws
    return drawn[i].T if drawn else _draw_normal_errors(result, i, rng)


def _draw_normal_errors(result: BlockResult, i: int, rng: np.random.Generator) -> FloatArray:
    """Return draws (p, draws) of an image's errors by its covariance alone."""
    covariance = result.covariances[i]
    # The small number on the diagonal keeps parameters without any variance factorisable.
    root = np.linalg.cholesky(covariance + 1e-12 * np.eye(len(covariance)))
    return np.asarray(root @ rng.standard_normal((len(root), _DRAWS))
                      * np.sqrt(_draw_variance_ratios(result, i, rng)))


def _draw_variance_ratios(result: BlockResult, i: int, rng: np.random.Generator) -> FloatArray:
    """Return draws (p, draws) of what variances of parameters are over what is stated.

    What the prior alone holds is as uncertain as the variance of the prior, which all of a group
    share. What measurements hold is not, nor a prior that the block does not estimate.
    """
    camera = result.camera(i)
    state = result.adjusted.state
    groups = np.array(camera.groups)
    by_prior = np.diag(result.covariances[i]) / state.variances[i]
    # A scaled inverse chi-square of TAIL degrees of freedom, whose mean is 1.
    factor = np.ones((len(groups), _DRAWS))
    for name in dict.fromkeys(camera.groups):
        if name in camera.fixed_variance:
            continue
        factor[groups == name] = (TAIL - 2) / rng.chisquare(TAIL, _DRAWS)
    # Of each parameter the share by_prior of its variance scales with the prior's.
    return np.asarray(1 + np.clip(by_prior, 0, 1)[:, None] * (factor - 1))


def errors_in_space(result: BlockResult) -> InSpace | None:
    """Return the errors [m] of independent points that two images or more see, by intersection.

    None if there are no such points.
    """
    truth_of: dict[str, FloatArray] = {}
    rays_of: dict[str, list[tuple[int, FloatArray]]] = {}
    for i in range(len(result.block.images)):
        points = independent_points(result, i)
        if points is None:
            continue
        for name, ground, image in zip(points.ids, points.ground, points.image, strict=True):
            truth_of[name] = ground
            rays_of.setdefault(name, []).append((i, image))
    # One ray alone meets nothing: at least two images must see a point.
    names = [name for name, rays in rays_of.items() if len(rays) > 1]
    if not names:
        return None
    actual = result.frame.local(np.array([truth_of[name] for name in names]))
    intersected = _intersect_rays(result, [rays_of[name] for name in names], actual)
    east, north, up = np.sqrt(((intersected - actual) ** 2).mean(axis=0))
    return InSpace(float(east), float(north), float(up), len(names))


def _intersect_rays(result: BlockResult, rays: Sequence[Sequence[tuple[int, FloatArray]]],
                    near: FloatArray) -> FloatArray:
    """Return where the rays of each point meet, shape (n, 3) [m].

    `rays` holds for each of n points the number of each image and the point's position there;
    `near` (n, 3) are the true places.
    """
    state = result.adjusted.state
    # `intersect` takes all rays of one image at once: index of each point, and where it is seen.
    by_image: dict[int, list[tuple[int, FloatArray]]] = {}
    for k, image_rays in enumerate(rays):
        for i, image in image_rays:
            by_image.setdefault(i, []).append((k, image))
    # All searches begin at the middle of the true places: a start at each would disclose the truth
    # to rays that hardly determine a place, and so make them look accurate.
    start = np.broadcast_to(near.mean(axis=0), near.shape).copy()
    all_rays = []
    for i, image_rays in by_image.items():
        points = np.array([k for k, _ in image_rays])
        positions = np.array([image for _, image in image_rays])
        all_rays.append((state.cameras[i], state.parameters[i], points, positions))
    return intersect(start, all_rays)
