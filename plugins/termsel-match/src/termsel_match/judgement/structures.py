"""How much of a correction the candidates call for: a shift, a drift, or more."""

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
_CAP = 4.0  # px beyond which all errors count alike: such candidates are wrong
_LEAST = 3  # candidates for each interval
_INTERVALS = (2, 4, 8, 16, 32)


@dataclass(frozen=True)
class Correction:
    """A model with its options, from plain to rich.

    Parameters
    ----------
    model : str
    options : mapping
    """

    model: str
    options: Mapping[str, Any]

    def fit(self, features: FeatureSet) -> Fit:
        """Fit it to features, whatever their roles."""
        used = replace(features.points, roles=())
        return termsel.fit(features.with_(points=used), self.model, **self.options)

    @property
    def text(self) -> str:
        """What it is called."""
        return self.model + (f" with {self.options['intervals']} intervals along the lines"
                             if "intervals" in self.options else "")


def corrections(model: str, options: Mapping[str, Any], count: int) -> list[Correction]:
    """Return what so many candidates may call for, the plainest first.

    Parameters
    ----------
    model : str
        With which the search began; one that corrects no RPC is the only one.
    options : mapping
    count : int
        Of candidates.
    """
    if not model.startswith("rpc-"):
        return [Correction(model, options)]
    plain = [Correction(name, options) for name in ("rpc-shift", "rpc-drift", "rpc-affine")]
    return plain + [Correction("rpc-jitter", {**options, "intervals": intervals})
                    for intervals in _INTERVALS if _LEAST * intervals <= count]


def called_for(several: list[Correction], features: FeatureSet, seed: int) -> Correction:
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
    judged = [(one, squares) for one in several
              if (squares := _held_out(one, features, fold)) is not None]
    if not judged:
        return several[0]
    best = min(judged, key=lambda one: float(one[1].mean()))[1]
    root = np.sqrt(len(best))
    return next(one for one, squares in judged
                if (squares - best).mean() <= (squares - best).std() / root)


def _held_out(one: Correction, features: FeatureSet, fold: NDArray[np.intp],
              ) -> FloatArray | None:
    """Return squared errors of points by fits without their fold; None where undetermined."""
    points = features.points
    squares = np.empty(len(fold))
    for number in range(_FOLDS):
        out = fold == number
        try:
            fitted = one.fit(features.with_(points=points.take(~out)))
        except TermselError:
            return None
        away = points.image[out] - fitted.project(points.ground[out])
        squares[out] = (away**2).sum(axis=1)
    return np.minimum(np.where(np.isfinite(squares), squares, np.inf), _CAP**2)
