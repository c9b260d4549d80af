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

from dataclasses import dataclass

import numpy as np

from termsel.core.errors import TermselError
from termsel.data.features import FloatArray, IntArray
from termsel.fitting.fit import Fit
from termsel.fitting.uncertainty import Spread, believed_spread

APART = 0.2
"""Least distance of two places in the image, as a share of its longer side."""


FAINT = 1e-3
"""Part of the largest variance of a misfit below which a direction is left out."""


@dataclass(frozen=True, eq=False)
class Ranking:
    """Places in the order in which they should be measured.

    `order` has numbers of candidates, `sigma` the root mean square uncertainty of a position over
    the scene after each of them [px], `now` the same before.
    """

    order: IntArray
    sigma: FloatArray
    now: float


def rank_places(fitted: Fit, candidates: FloatArray, scene: FloatArray, count: int,
                apart: float = APART, *, misfit: bool = False) -> Ranking:
    """Return the best places to measure next, at most `count` of the candidates.

    Candidates (c, 3) and the scene where the model is to be good (m, 3) are on the ground. A spline
    or a field is taken for the shrunken cubic polynomial of its control. Two places are `apart` in
    the image, as a share of its longer side; where no candidate is as far from all places before
    it, any may follow. With `misfit` the uncertainty holds what the model does not fit, too, as
    that of `Fit.sigma` does. Raises TermselError if the uncertainty of the fit is not known.
    """
    made = fitted.made or fitted
    # Where the candidates are the scene, its places count once: work grows with their square.
    everywhere = scene if candidates is scene else np.concatenate([candidates, scene])
    both = covariances(made, everywhere, misfit=misfit)
    if both is None or both.factors is None:
        raise TermselError("the uncertainty of this model is not known",
                           hint="Plan with 4 or more control points alone; with lines, by a model "
                                "of least squares, such as --model poly3d.")
    at = both.factors[:len(candidates)]
    there = both.factors[-len(scene):]
    left = np.eye(at.shape[2])  # what measurements leave of the directions of doubt
    over = np.einsum("mad,mae->de", there, there) / len(there)
    image = fitted.project(candidates)
    box = np.array(fitted.image_box())
    distance = apart * float(np.ptp(box, axis=0).max())
    free = np.ones(len(candidates), dtype=bool)
    near = np.zeros(len(candidates), dtype=bool)
    chosen: list[int] = []
    after: list[float] = []
    for _ in range(min(count, len(candidates))):
        gains = _gains(at, left, over, both.noise)
        gains[~free] = -np.inf
        if (free & ~near).any():
            gains[near] = -np.inf
        best = int(np.argmax(gains))
        free[best] = False
        near |= np.hypot(*(image - image[best]).T) < distance
        for axis in (0, 1):
            left = _measured(left, at[best, axis], both.noise[axis])
        chosen.append(best)
        after.append(float(np.trace(left @ over)))
    scale = made.scaling.image_scale
    return Ranking(np.array(chosen, dtype=np.intp), np.sqrt(after) * scale,
                   float(np.sqrt(np.trace(over))) * scale)


def covariances(made: Fit, ground: FloatArray, *, misfit: bool) -> Spread | None:
    """Return the mean square errors of a fit at places (m, 3), with factors; None if not known.

    With `misfit` they hold what the model does not fit.
    """
    places = made.scaling.ground(ground)
    spread: Spread | None = made.estimator.spread(made, places)
    if spread is not None and spread.factors is None:  # a local model, which tells no covariances
        spread = believed_spread(made.model, made.scaled_control.take(made.used), places,
                                 np.zeros((len(places), 2)))
    if spread is None or spread.factors is None or not np.isfinite(spread.factors).all():
        return None
    return _with_misfit(spread, made, ground) if misfit and made.misfit is not None else spread


def _with_misfit(spread: Spread, made: Fit, ground: FloatArray) -> Spread:
    """Return a spread whose factors span what the model does not fit, too (see `Misfit`)."""
    assert made.misfit is not None
    assert spread.factors is not None
    image = made.scaling.image(made.project(ground))
    spans = [spread.factors]
    seen = np.isfinite(image).all(axis=1)
    for axis in (0, 1):
        values, vectors = np.linalg.eigh(made.misfit.covariance(image[seen], axis))
        strong = values > FAINT * max(float(values[-1]), np.finfo(float).tiny)
        span = np.zeros((len(ground), 2, int(strong.sum())))
        span[seen, axis] = vectors[:, strong] * np.sqrt(values[strong])
        spans.append(span)
    factors = np.concatenate(spans, axis=2)
    return Spread(spread.variance + made.missed_at(ground), spread.noise, factors)


def share_left(fitted: Fit, ground: FloatArray) -> float:
    """Return by how much the error at a place falls once those around it are measured: a ratio.

    Of measured places (m, 3), each in its turn is the place, and the others are those around it.
    With C the covariance of all m measurements, the variance of one given the others is
    1 / (C^-1)_ii, and C_ii without them. The measurements themselves are not looked at. 1 where the
    covariances are not known.
    """
    spread = covariances(fitted.made or fitted, ground, misfit=True)
    if spread is None or spread.factors is None or not (spread.noise > 0).all():
        return 1.0
    alone = np.zeros(2)
    among = np.zeros(2)
    for axis, noise in enumerate(spread.noise):
        factors = spread.factors[:, axis]                                          # (m, d)
        # C = F F' + s I, so that C^-1 = (I - F (s I + F' F)^-1 F') / s.
        inner = noise * np.eye(factors.shape[1]) + factors.T @ factors
        kept = 1.0 - (factors * np.linalg.solve(inner, factors.T).T).sum(axis=1)
        alone[axis] = (noise + (factors**2).sum(axis=1)).mean()
        among[axis] = (noise / np.maximum(kept, np.finfo(float).eps)).mean()
    return float(np.sqrt(min(among.sum() / alone.sum(), 1.0)))


def _gains(at: FloatArray, left: FloatArray, over: FloatArray, noise: FloatArray) -> FloatArray:
    """Return by how much a measurement at each candidate lessens the mean variance, shape (c,)."""
    toward = at @ left                                                       # (c, 2, d)
    own = np.einsum("cad,cbd->cab", toward, at) + np.diag(noise)             # (c, 2, 2)
    seen = np.einsum("cae,cbe->cab", toward @ over, toward)
    return np.asarray(np.einsum("cab,cba->c", np.linalg.inv(own), seen))


def _measured(left: FloatArray, at: FloatArray, noise: float) -> FloatArray:
    """Return what a further measurement leaves."""
    toward = left @ at
    return np.asarray(left - np.outer(toward, toward) / (noise + at @ toward))
