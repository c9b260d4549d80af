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

_CAP = 4.0
"""Error [px] beyond which all errors count alike, as such candidates are wrong."""

_INTERVALS = (2, 4, 8, 16, 32)
"""Numbers of intervals along the lines that a smooth correction may have."""

_PER_INTERVAL = 3
"""Fewest candidates for each interval of a smooth correction."""

_LEVEL = 0.01
"""Range of heights above their plane, in their unit, below which they determine no term."""


@dataclass(frozen=True)
class ModelCorrection:
    """A model that corrects the start of an image, by its name, with its options."""

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
    """Return how far places (m, 3) are above a plane, (m,); `ground` (n, 3) defines the plane.

    It is the plane z = a + b x + c y with the least squares of the differences in height.
    """
    middle = ground.mean(axis=0)
    # Coordinates divided by their range: the solution then loses no digits.
    size = np.maximum(np.ptp(ground, axis=0), np.finfo(np.float64).tiny)
    known, asked = ((positions - middle) / [*size[:2], 1.0] for positions in (ground, places))
    plane = np.linalg.lstsq(np.insert(known[:, :2], 0, 1.0, axis=1), known[:, 2])[0]
    return np.asarray(asked[:, 2] - np.insert(asked[:, :2], 0, 1.0, axis=1) @ plane)


def model_by_relief(
        model: str, options: Mapping[str, Any], features: FeatureSet) -> ModelCorrection:
    """Return the correction that a model and its options stand for.

    An affine model of ground that is a plane becomes the affine one without heights: there heights
    depend on x and y, so that the terms of all three are not determined.
    """
    ground = features.ground_vertices()
    if model == "affine" and np.ptp(heights_above_plane(ground, ground)) < _LEVEL:
        return ModelCorrection("poly2d", {**options, "degree": 1})
    return ModelCorrection(model, options)


def supported_corrections(model: str, options: Mapping[str, Any],
                          count: int) -> list[ModelCorrection]:
    """Return the corrections that a number of candidates may determine, the plainest first.

    Parameters
    ----------
    model : str
        The model with which the search began. One that does not correct an RPC is the only one to
        come back.
    options : mapping
        Options of that model.
    count : int
        Number of candidates.
    """
    if not model.startswith("rpc-"):
        return [ModelCorrection(model, options)]
    # A shift, a drift along the lines, an affine transformation; then splines along the lines with
    # more and more intervals.
    polynomials = [ModelCorrection(name, options)
                   for name in ("rpc-shift", "rpc-drift", "rpc-affine")]
    return polynomials + [ModelCorrection("rpc-jitter", {**options, "intervals": intervals})
                          for intervals in _INTERVALS if _PER_INTERVAL * intervals <= count]


def plainest_supported_correction(
        several: list[ModelCorrection], features: FeatureSet, seed: int) -> ModelCorrection:
    """Return the plainest correction within one standard error of the best, by held-out candidates.

    Candidates are drawn into five folds, and those of a fold are predicted by a fit to the others.

    Parameters
    ----------
    several : list of ModelCorrection
        Corrections to choose from, the plainest first.
    features : FeatureSet
        Candidate points near the model found so far; some may be wrong.
    seed : int
        Seed by which the folds are drawn.

    Returns
    -------
    ModelCorrection
        The first if the candidates determine none of them in all folds.

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
    # The standard error is that of the differences, candidate by candidate, in which the errors
    # that both corrections share cancel.
    root_of_count = np.sqrt(len(best))
    return next(correction for correction, squares in errors_of
                if (squares - best).mean() <= (squares - best).std() / root_of_count)


def _held_out_squares(correction: ModelCorrection, features: FeatureSet, fold: NDArray[np.intp],
                      ) -> FloatArray | None:
    """Return the squared error of each point by the fit without its fold, capped, (n,) [px^2].

    `fold` (n,) has the number of each point's fold. None if a fit fails, as where the other points
    do not determine it.
    """
    points = features.points
    squares = np.empty(len(fold))
    for number in range(_FOLDS):
        held_out = fold == number
        try:
            fitted = correction.fit(features.with_(points=points.take(~held_out)))
        except TermselError:
            return None
        errors = points.image[held_out] - fitted.project(points.ground[held_out])
        squares[held_out] = (errors**2).sum(axis=1)
    return np.minimum(np.where(np.isfinite(squares), squares, np.inf), _CAP**2)
