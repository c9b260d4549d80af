"""How much of a correction the candidates support: a shift, a drift, or more."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import termsel
from termsel import FeatureSet, Fit, TermselError
from termsel_match.images.rasters import FloatArray

_FOLDS = 5
# Px beyond which all errors count alike: such candidates are wrong.
_CAP = 4.0
# Candidates for each interval.
_PER_INTERVAL = 3
_INTERVALS = (2, 4, 8, 16, 32)
# Heights that differ less from a plane [of their unit] determine no term of a model.
_LEVEL = 0.01


@dataclass(frozen=True)
class ModelCorrection:
    """A model with its options, from plain to rich.

    Parameters
    ----------
    model : str
    options : mapping
    """

    model: str
    options: Mapping[str, Any]

    def fit(self, features: FeatureSet) -> Fit:
        """Return the fit of the correction to all features, whatever their roles."""
        used = replace(features.points, roles=())
        return termsel.fit(features.with_(points=used), self.model, **self.options)

    @property
    def text(self) -> str:
        """Name of the model, with the number of intervals if it has some."""
        return self.model + (f" with {self.options['intervals']} intervals along the lines"
                             if "intervals" in self.options else "")


def heights_above_plane(ground: FloatArray, places: FloatArray) -> FloatArray:
    """Return how far places (m, 3) are above the plane nearest to ground positions (n, 3), (m,)."""
    middle = ground.mean(axis=0)
    size = np.maximum(np.ptp(ground, axis=0), np.finfo(np.float64).tiny)
    known, asked = ((positions - middle) / [*size[:2], 1.0] for positions in (ground, places))
    # z = a + b x + c y
    slopes = np.linalg.lstsq(np.insert(known[:, :2], 0, 1.0, axis=1), known[:, 2])[0]
    return np.asarray(asked[:, 2] - np.insert(asked[:, :2], 0, 1.0, axis=1) @ slopes)


def model_by_relief(
        model: str, options: Mapping[str, Any], features: FeatureSet) -> ModelCorrection:
    """Return a model, or where it is affine and the ground a plane, the affine one without heights.

    On a plane, heights say the same as x and y, and the terms of both are not determined.
    """
    ground = features.ground_vertices()
    if model == "affine" and np.ptp(heights_above_plane(ground, ground)) < _LEVEL:
        return ModelCorrection("poly2d", {**options, "degree": 1})
    return ModelCorrection(model, options)


def supported_corrections(model: str, options: Mapping[str, Any],
                          count: int) -> list[ModelCorrection]:
    """Return what so many candidates may support, the plainest first.

    Parameters
    ----------
    model : str
        With which the search began; one that corrects no RPC is the only one.
    options : mapping
    count : int
        Of candidates.
    """
    if not model.startswith("rpc-"):
        return [ModelCorrection(model, options)]
    polynomials = [ModelCorrection(name, options)
                   for name in ("rpc-shift", "rpc-drift", "rpc-affine")]
    return polynomials + [ModelCorrection("rpc-jitter", {**options, "intervals": intervals})
                          for intervals in _INTERVALS if _PER_INTERVAL * intervals <= count]


def plainest_supported_correction(
        several: list[ModelCorrection], features: FeatureSet, seed: int) -> ModelCorrection:
    """Return the plainest correction within one standard error of the best, by held-out candidates.

    Candidates are drawn into five folds; each is predicted by a fit to the others.

    Parameters
    ----------
    several : list of Correction
        The plainest first.
    features : FeatureSet
        Candidate points that are near the model so far; some may be wrong.
    seed : int

    References
    ----------
    Breiman, Friedman, Olshen, Stone 1984: Classification and regression trees, section 3.4.3: the
    rule of one standard error.
    """
    if len(several) == 1:
        return several[0]
    fold = np.random.default_rng([seed, 4]).permutation(len(features.points)) % _FOLDS
    errors_of = [(correction, squares) for correction in several
                 if (squares := _held_out_squares(correction, features, fold)) is not None]
    if not errors_of:
        return several[0]
    best = min((squares for _, squares in errors_of), key=np.mean)
    # One standard error of the difference, point by point: most of what is common cancels.
    root = np.sqrt(len(best))
    return next(correction for correction, squares in errors_of
                if (squares - best).mean() <= (squares - best).std() / root)


def _held_out_squares(correction: ModelCorrection, features: FeatureSet, fold: NDArray[np.intp],
                      ) -> FloatArray | None:
    """Return the squared errors [px2] of points (n,) by fits without their fold, capped.

    `fold` (n,) has the number of each point's fold. None if a fit is undetermined.
    """
    points = features.points
    squares = np.empty(len(fold))
    for number in range(_FOLDS):
        held_out = fold == number
        try:
            fitted = correction.fit(features.with_(points=points.take(~held_out)))
        except TermselError:
            return None
        away = points.image[held_out] - fitted.project(points.ground[held_out])
        squares[held_out] = (away**2).sum(axis=1)
    # Wrong candidates count alike however far they are.
    return np.minimum(np.where(np.isfinite(squares), squares, np.inf), _CAP**2)
