"""Where to measure next: the places that take most of the doubt about a fit from the scene.

A measurement at a place lessens the variance of what is predicted elsewhere by the square of
their covariance, over the variance of the measurement. The place comes first after which the mean
variance over the scene is least; the next is the best together with it, and so on. Places keep a
distance, as errors of the model that its variances do not know are alike at neighbouring places.

References
----------
Krause, Singh and Guestrin 2008, J. Machine Learning Research 9, for the greedy choice of places.
The mean variance is that of V-optimal designs (Atkinson, Donev and Tobias 2007). The measurements
themselves are not known before, so that what they will say of the model's form is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from termsel.core.errors import TermselError, count_in_words
from termsel.data.features import BoolArray, FloatArray, IntArray
from termsel.fitting.fit import Fit
from termsel.fitting.uncertainty import Spread, believed_spread

MIN_DISTANCE = 0.2
"""Least distance of two places in the image, as a share of its longer side."""


MIN_VARIANCE_SHARE = 1e-3
"""Part of the largest variance of a misfit below which a direction is left out."""


@dataclass(frozen=True, eq=False)
class Ranking:
    """Places in the order in which they should be measured.

    `order` has numbers of candidates, `sigma` the root mean square uncertainty of a position over
    the scene after each of them [px], `sigma_before` the same before: the root mean square of
    `Fit.sigma`, but for the noise of heights. Errors of a spline or a field with heights, or of few
    points, are as alike as those of the regularised cubic polynomial of its control.
    """

    order: IntArray
    sigma: FloatArray
    sigma_before: float


def rank_places(fitted: Fit, candidates: FloatArray, scene: FloatArray, count: int,
                min_distance: float = MIN_DISTANCE) -> Ranking:
    """Return the best places to measure next, at most `count` of the candidates.

    Candidates (c, 3) and the scene where the model is to be good (m, 3) are on the ground. Two
    places are at least `min_distance` apart in the image, as a share of its longer side, or of that
    of the box around the features and the RPC where the size of the image is not known. Where no
    candidate is as far from all places before it, any may follow.

    Raises
    ------
    TermselError
        If the uncertainty of the fit is not known.
    """
    original = fitted.original or fitted
    # Where the candidates are the scene, its places count once: work grows with their square.
    everywhere = scene if candidates is scene else np.concatenate([candidates, scene])
    spread = error_covariances(original, everywhere)
    if spread is None or spread.factors is None:
        raise _not_known_error(original)
    # Doubt has d directions: the covariance of what is predicted at two places is F1 R F2', F the
    # factors of a place (2, d), and R (d, d) what measurements leave of the directions, at first I.
    candidate_factors = spread.factors[:len(candidates)]
    scene_factors = spread.factors[-len(scene):]
    n_directions = candidate_factors.shape[2]
    remaining = np.eye(n_directions)
    # The mean variance over the scene is tr(R G), G the mean of F'F.
    scene_rows = scene_factors.reshape(-1, n_directions)
    scene_products = scene_rows.T @ scene_rows / len(scene_factors)
    image = fitted.project(candidates)
    box = np.array(fitted.image_box())
    distance = min_distance * float(np.ptp(box, axis=0).max())
    free = np.ones(len(candidates), dtype=bool)
    too_near = np.zeros(len(candidates), dtype=bool)
    order: list[int] = []
    mean_variances: list[float] = []
    for _ in range(min(count, len(candidates))):
        gains = _variance_gains(candidate_factors, remaining, scene_products, spread.noise)
        gains[~free] = -np.inf
        if (free & ~too_near).any():
            gains[too_near] = -np.inf
        best = int(np.argmax(gains))
        free[best] = False
        too_near |= np.hypot(*(image - image[best]).T) < distance
        for axis in (0, 1):
            remaining = _variance_after_measuring(remaining, candidate_factors[best, axis],
                                                  spread.noise[axis])
        order.append(best)
        mean_variances.append(float(np.trace(remaining @ scene_products)))
    scale = original.scaling.image_scale
    return Ranking(np.array(order, dtype=np.intp), np.sqrt(mean_variances) * scale,
                   float(np.sqrt(np.trace(scene_products))) * scale)


def _not_known_error(original: Fit) -> TermselError:
    """Return the error for a fit whose uncertainty is not known, with what makes it known."""
    control = original.control
    if len(control.lines):
        return TermselError("the uncertainty of this model is not known: it was fitted to lines",
                            hint="Run again with the same files, --model poly3d and a new --out "
                                 "DIR, then termsel plan DIR.")
    points = count_in_words(len(control.points), "control point")
    return TermselError(f"the uncertainty of this model is not known: {points} leave too little "
                        "to judge it by",
                        hint="Measure one more, far from the others, and run again with it.")


def error_covariances(original: Fit, ground: FloatArray) -> Spread | None:
    """Return the mean square errors of a fit at places (m, 3), with factors; None if not known.

    They are those of `Fit.sigma`, without the noise of heights. With more than 200 points, errors
    at two places correlate as by 200 that are spread over them, over longer distances than by all.
    """
    scaled_ground = original.scaling.ground(ground)
    image = original.scaling.image(original.project(ground))
    visible = np.asarray(np.isfinite(image).all(axis=1))
    courses = original.local_courses
    if courses is not None:
        spans = [_covariance_factors(courses.covariance(scaled_ground[visible], image[visible],
                                                        axis), visible,
                                     axis) for axis in (0, 1)]
        spread_courses = _spread_of_spans(spans, np.full(2, courses.noise))
        variance = np.zeros(image.shape)
        variance[visible] = original.mean_square_errors(ground[visible])[0]
        return _with_variance(spread_courses, variance)
    spread: Spread | None = original.estimator.spread(original, scaled_ground)
    if spread is not None and spread.factors is None:  # a local model, which shows no covariances
        spread = _with_correlations_of_polynomial(spread, original, scaled_ground, image)
    if spread is None or spread.factors is None or not np.isfinite(spread.factors).all():
        return None
    spans = [spread.factors]
    if spread.offsets is not None:
        # That the fit is off, or not, is one doubt on each axis: E[e e'] = C + d d'.
        spans.append(spread.offsets[:, :, None] * np.eye(2))
    if original.misfit is not None:
        spans += [_covariance_factors(original.misfit.covariance(image[visible], axis), visible,
                                      axis)
                  for axis in (0, 1)]
    return _spread_of_spans(spans, spread.noise)


def _with_correlations_of_polynomial(spread: Spread, original: Fit, scaled_ground: FloatArray,
                                     image: FloatArray) -> Spread | None:
    """Return a spread whose errors correlate as those of the regularised cubic polynomial do.

    Returns None where the points do not support that polynomial.
    """
    believed = believed_spread(original.model, original.scaled_control.take(original.used),
                               scaled_ground, image)
    if believed is None or believed.factors is None:
        return None
    return _with_variance(replace(believed, noise=spread.noise), spread.variance)


def _with_variance(spread: Spread, variance: FloatArray) -> Spread:
    """Return a spread with other variances (m, 2), whose errors correlate as before."""
    assert spread.factors is not None
    squares = np.maximum((spread.factors**2).sum(axis=2), np.finfo(float).tiny)
    factors = spread.factors * np.sqrt(variance / squares)[:, :, None]
    return Spread(variance, spread.noise, factors)


def _spread_of_spans(spans: Sequence[FloatArray], noise: FloatArray) -> Spread:
    """Return the mean square errors of factors that add up, each (m, 2, d)."""
    factors = np.concatenate(spans, axis=2)
    return Spread((factors**2).sum(axis=2), noise, factors)


def _covariance_factors(covariance: FloatArray, visible: BoolArray, axis: int) -> FloatArray:
    """Return factors (m, 2, d) of a covariance of one axis among the places that are visible."""
    values, vectors = np.linalg.eigh(covariance)
    strong = values > MIN_VARIANCE_SHARE * max(float(values[-1]), np.finfo(float).tiny)
    span = np.zeros((len(visible), 2, int(strong.sum())))
    span[visible, axis] = vectors[:, strong] * np.sqrt(values[strong])
    return span


def share_left(fitted: Fit, ground: FloatArray) -> float:
    """Return the share of the error at a place that is left once the places around it are measured.

    Each of the places `ground` (m, 3) in its turn is the place, and the others are those around it.
    With C the covariance of all m measurements, the variance of one given the others is
    1 / (C^-1)_ii, and C_ii without them. The share is the root of their ratio, with both summed up
    over all places. It is 1 where the covariances are not known.
    """
    spread = error_covariances(fitted.original or fitted, ground)
    if spread is None or spread.factors is None or not (spread.noise > 0).all():
        return 1.0
    variance_alone = np.zeros(2)
    variance_among = np.zeros(2)
    for axis, noise in enumerate(spread.noise):
        factors = spread.factors[:, axis]                                          # (m, d)
        # C = F F' + s I, so that C^-1 = (I - F (s I + F' F)^-1 F') / s.
        inner = noise * np.eye(factors.shape[1]) + factors.T @ factors
        unexplained = 1.0 - (factors * np.linalg.solve(inner, factors.T).T).sum(axis=1)
        variance_alone[axis] = (noise + (factors**2).sum(axis=1)).mean()
        variance_among[axis] = (noise / np.maximum(unexplained, np.finfo(float).eps)).mean()
    return float(np.sqrt(min(variance_among.sum() / variance_alone.sum(), 1.0)))


def _variance_gains(factors: FloatArray, remaining: FloatArray, scene_products: FloatArray,
                    noise: FloatArray) -> FloatArray:
    """Return by how much a measurement at each candidate lessens the mean variance, shape (c,).

    `factors` (c, 2, d) are F of each candidate, `remaining` (d, d) is R, `scene_products` (d, d) is
    G, as in `rank_places`; `noise` (2,) are the variances of a measured line and sample.
    """
    # With the covariance M = F R F' + s of a measurement, the mean variance falls by
    # tr(M^-1 F R G R F'). Both axes of all candidates are rows of one product, which BLAS takes
    # at once; as c products of two rows it takes ten times as long.
    toward_rows = factors.reshape(-1, factors.shape[2]) @ remaining                   # (2 c, d)
    toward = toward_rows.reshape(factors.shape)
    through_scene = (toward_rows @ scene_products).reshape(factors.shape)
    measurement = np.einsum("cad,cbd->cab", toward, factors) + np.diag(noise)
    lessened = np.einsum("cae,cbe->cab", through_scene, toward)
    return np.asarray(np.einsum("cab,cba->c", np.linalg.inv(measurement), lessened))


def _variance_after_measuring(remaining: FloatArray, factor: FloatArray,
                              noise: float) -> FloatArray:
    """Return the covariance after one more measurement: R - R f f'R / (s + f'R f).

    R is `remaining` (n, n), f is `factor` (n,), and s the variance of the measurement's noise.
    """
    toward = remaining @ factor
    return np.asarray(remaining - np.outer(toward, toward) / (noise + factor @ toward))
