"""What a block is worth: each image and the places of ties, by points that took no part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from termsel import FeatureSet, Points
from termsel_block.estimation.adjustment import MEDIAN
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
    """Return the independent points of an image, or None."""
    features = result.block.images[i].features
    if features is None:
        return None
    points = features.points.take([role == "independent" for role in features.points.roles])
    return points if len(points) else None


def rmse(errors: FloatArray) -> float:
    """Return the root mean square of distances (n, 2)."""
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


def predicted(result: BlockResult, i: int, seed: int = 0, *, anywhere: bool = False) -> Spread:
    """Return what points of an image, measured as its control is, will miss the model by.

    Over as many points as the image has independent ones, at their places; where it has none, or
    `anywhere`, over its ties, which compares images. By draws from the posterior of its parameters
    and of the precision of control: what all its points have in common makes the interval wide.
    """
    state = result.adjusted.state
    points = None if anywhere else independent_points(result, i)
    mine = result.block.ties.image == i
    places = state.ties[result.block.ties.tie[mine]]
    features = result.block.images[i].features
    if points is not None:
        places = result.frame.local(points.ground)
    elif not len(places):
        assert features is not None  # an image without ties has control
        places = result.frame.local(features.points.ground)
    rows = result.rows(i, places)
    rng = np.random.default_rng([seed, i])
    draws = _drawn(result, i, rng)
    squares = ((rows @ draws) ** 2).sum(axis=1).mean(axis=0)
    # The variance of control is known from few measurements; the state has its median.
    known = state.freedom_control
    noise = state.sigma_control**2 * (known - MEDIAN) / rng.chisquare(known, draws.shape[1])
    if points is not None:  # few of them have more noise than that, or less
        noise = noise * rng.chisquare(2 * len(points), draws.shape[1]) / (2 * len(points))
    errors = np.sqrt(squares + 2 * noise)
    low, high = np.quantile(errors, [(1 - _LEVEL) / 2, (1 + _LEVEL) / 2])
    return Spread(float(np.sqrt((errors**2).mean())), float(low), float(high))


def shared_sigma(result: BlockResult, i: int, features: FeatureSet, own: FloatArray,
                 seed: int = 0) -> tuple[float, float]:
    """Return what the block knows an image's model to be off by, beyond what its own fit tells.

    Standard deviations of line and sample [px], over places of features: the mean squares of the
    block's draws, less the squares `own` (n, 2) of the image's own fit there. Places of ties are
    off together, which no fit to them alone can see.
    """
    rows = result.rows(i, result.frame.local(features.points.ground))
    draws = _drawn(result, i, np.random.default_rng([seed, i]))
    squares = ((rows @ draws) ** 2).mean(axis=2)
    known = np.isfinite(own).all(axis=1)
    beyond = (squares - own**2)[known].mean(axis=0) if known.any() else squares.mean(axis=0)
    line, sample = np.sqrt(np.maximum(beyond, 0.0)).tolist()
    return line, sample


def _drawn(result: BlockResult, i: int, rng: np.random.Generator) -> FloatArray:
    """Return draws (2m, draws) of an image's errors from the posterior of its parameters."""
    drawn = result.adjusted.draws
    return drawn[i].T if drawn else _normal(result, i, rng)


def _normal(result: BlockResult, i: int, rng: np.random.Generator) -> FloatArray:
    """Return draws (2m, draws) of an image's errors by its covariance alone."""
    covariance = result.covariances[i]
    root = np.linalg.cholesky(covariance + 1e-12 * np.eye(len(covariance)))
    return np.asarray(root @ rng.standard_normal((len(root), _DRAWS))
                      * np.sqrt(_unsure(result, i, rng)))


def _unsure(result: BlockResult, i: int, rng: np.random.Generator) -> FloatArray:
    """Return draws (2m, draws) of what variances of parameters are over what is stated.

    What the prior alone holds is as uncertain as the variance of the prior, which all columns of a
    group share. What measurements hold is not, nor a prior that the block does not estimate.
    """
    camera = result.camera(i)
    state = result.adjusted.state
    groups = np.array(camera.groups)
    by_prior = np.diag(result.covariances[i]).reshape(2, -1) / state.variances[i]
    factor = np.ones((len(groups), _DRAWS))
    for name in dict.fromkeys(camera.groups):
        if name in camera.wide:
            continue
        factor[groups == name] = (TAIL - 2) / rng.chisquare(TAIL, _DRAWS)
    return np.asarray(1 + np.clip(by_prior, 0, 1)[:, :, None] * (factor - 1)).reshape(-1, _DRAWS)


def in_space(result: BlockResult) -> InSpace | None:
    """Return the errors of independent points that two images or more see, by intersection."""
    known: dict[str, FloatArray] = {}
    seen: dict[str, list[tuple[int, FloatArray]]] = {}
    for i in range(len(result.block.images)):
        points = independent_points(result, i)
        if points is None:
            continue
        for name, ground, image in zip(points.ids, points.ground, points.image, strict=True):
            known[name] = ground
            seen.setdefault(name, []).append((i, image))
    names = [name for name, rays in seen.items() if len(rays) > 1]
    if not names:
        return None
    truth = result.frame.local(np.array([known[name] for name in names]))
    found = _intersected(result, [seen[name] for name in names], truth)
    east, north, up = np.sqrt(((found - truth) ** 2).mean(axis=0))
    return InSpace(float(east), float(north), float(up), len(names))


def _intersected(result: BlockResult, rays: Sequence[Sequence[tuple[int, FloatArray]]],
                 near: FloatArray) -> FloatArray:
    """Return where rays meet; the search begins at the middle of the places, not at each."""
    state = result.adjusted.state
    by_image: dict[int, list[tuple[int, FloatArray]]] = {}
    for k, some in enumerate(rays):
        for i, image in some:
            by_image.setdefault(i, []).append((k, image))
    start = np.broadcast_to(near.mean(axis=0), near.shape).copy()
    return intersect(
        start, [(state.cameras[i], state.parameters[i], np.array([k for k, _ in some]),
                 np.array([image for _, image in some])) for i, some in by_image.items()])
