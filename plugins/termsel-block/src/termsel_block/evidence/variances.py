"""How far corrections of images scatter: the variances of their priors, from the block itself."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from termsel_block.geometry.cameras import Camera
from termsel_block.geometry.frame import FloatArray

OWN_WEIGHT = 4.0
"""Weight of what all images say of a variance, as so many parameters of the image's own.

Termsel's own choice: the variance of an image with as many parameters is the mean of both.
"""

_RATIO_GRID = np.geomspace(1e-4, 1e2, 121)
"""Standard deviations over the first guess that are weighed."""

TAIL = 4.0
"""Degrees of freedom of the prior: without data the mean of the variance is twice the guess's."""


def estimate_variances(cameras: Sequence[Camera], parameters: Sequence[FloatArray],
                       covariances: Sequence[FloatArray], variances: Sequence[FloatArray],
                       ) -> list[FloatArray]:
    """Return the new variance of the prior of each parameter of each image [px2].

    Parameters
    ----------
    cameras : sequence of Camera
        The model of each image.
    parameters, covariances : sequence of ndarray, shapes (p,) and (p, p)
        Mean and covariance of the posterior of each image, with the present variances.
    variances : sequence of ndarray, shape (p,)
        The present variances. Those of groups that a camera fixes stay.

    Notes
    -----
    A group of columns has one variance in all images, drawn to what each image says of its own.
    The common one is its posterior mean and not its most likely value, which is near zero whenever
    few images leave open whether there is any effect: the standard deviation has the prior that
    Gelman 2006 (Prior distributions for variance parameters in hierarchical models, Bayesian
    Analysis 1(3), section 6) recommends, half Cauchy with the scale of a first guess.
    """
    pooled: dict[str, list[FloatArray]] = {}
    for camera, mean, covariance, variance in zip(
            cameras, parameters, covariances, variances, strict=True):
        # Mean and variance of the posterior, variance of the prior, and first guess of each
        # parameter.
        values = np.stack([mean, np.diag(covariance), variance, camera.prior_sigma])
        names = np.array(camera.groups)
        for name in dict.fromkeys(camera.groups):
            if name not in camera.fixed_variance:
                pooled.setdefault(name, []).append(values[:, names == name])
    common = {name: posterior_mean(*np.concatenate(blocks, axis=1))
              for name, blocks in pooled.items()}
    result = []
    for camera, mean, covariance, variance in zip(
            cameras, parameters, covariances, variances, strict=True):
        new = variance.copy()
        groups = np.array(camera.groups)
        # E[x^2] of the posterior: mean^2 + variance.
        moments = mean**2 + np.diag(covariance)
        for name in dict.fromkeys(camera.groups):
            if name not in camera.fixed_variance:
                in_group = groups == name
                # The posterior mean of a variance about the common one, which has OWN_WEIGHT
                # degrees of freedom.
                new[in_group] = ((moments[in_group].sum() + OWN_WEIGHT * common[name])
                                 / (in_group.sum() + OWN_WEIGHT))
        result.append(np.maximum(new, np.square(camera.min_sigma)))
    return result


def loosening_factors(cameras: Sequence[Camera], parameters: Sequence[FloatArray],
                      covariances: Sequence[FloatArray]) -> dict[str, float]:
    """Return the factors by which to multiply the standard deviations that a model states.

    All images of the model are taken together, as a sensor may turn faster than most in all of
    them.

    Parameters
    ----------
    cameras : sequence of Camera
        The model of each image.
    parameters, covariances : sequence of ndarray, shapes (p,) and (p, p)
        Mean and covariance of the posterior of each image, in units of the present standard
        deviations.

    Returns
    -------
    dict of float
        By name of each term of `Camera.stated_terms`. A factor is about 1 if the images show the
        term as the model states it, or not at all.
    """
    squares: dict[str, list[float]] = {}
    for camera, mean, covariance in zip(cameras, parameters, covariances, strict=True):
        # E[x^2] of the posterior: mean^2 + variance.
        moments = mean**2 + np.diag(covariance)
        for name, index in camera.stated_terms.items():
            # Earlier rounds may have loosened the prior: back to units of what the model states.
            stated_moment = moments[index] * camera.sigma_factors[index] ** 2
            squares.setdefault(name, []).append(float(stated_moment))
    # The model's statement, 1, counts as OWN_WEIGHT images do: (sum x^2 + w 1) / (n + w).
    return {name: float(np.sqrt((sum(image_squares) + OWN_WEIGHT)
                                / (len(image_squares) + OWN_WEIGHT)))
            for name, image_squares in squares.items()}


def posterior_mean(mean: FloatArray, variance: FloatArray, prior: FloatArray,
                   guess: FloatArray) -> float:
    """Return the posterior mean of the variance that k values have in common.

    `mean`, `variance` and `prior` (k,) are the posterior mean and variance of each value and the
    variance of its present prior. The common standard deviation has a half t distribution as its
    prior, whose scale is the geometric mean of `guess` (k,).
    """
    sigma = float(np.exp(np.log(guess).mean())) * _RATIO_GRID[:, None]
    # The posterior of each value without its prior is what the measurements alone say.
    precision = np.maximum(1 / variance - 1 / prior, 0.0)
    right = mean / variance
    # Marginal likelihood of normal values under each variance, times the prior of half t.
    spread = 1 + sigma**2 * precision
    logarithm = 0.5 * (right**2 * sigma**2 / spread - np.log(spread)).sum(axis=1)
    # On a logarithmic grid a density is multiplied by the standard deviation itself.
    weight = np.exp(logarithm - logarithm.max()) * _RATIO_GRID / (1 + _RATIO_GRID**2 / TAIL) ** (
        (TAIL + 1) / 2)
    return float((weight * sigma[:, 0] ** 2).sum() / weight.sum())
