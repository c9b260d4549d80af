"""RANSAC: a polynomial of the points that the most others agree with."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass

import numpy as np

from termsel import (
    Fit,
    FitData,
    HeldOut,
    Method,
    Polynomial2D,
    Polynomial3D,
    RationalModel,
    Undetermined,
    held_out_by_refits,
)
from termsel_optimisers.arrays import BoolArray

QUADRATIC_FROM = 20
"""Points from which on the polynomial is quadratic: as few as it has terms leave nothing to vote.
"""


@dataclass(frozen=True, eq=False)
class Ransac(Method):
    """Polynomial of the points that agree best, affine or, from 20 points on, quadratic.

    So many times as `trials` says, as few points as the polynomial has terms an axis determine it,
    and all points within `threshold` of it vote for it. The points that vote for the best are
    fitted by least squares; the others take no part. Fischler and Bolles 1981, Communications of
    the ACM 24(6).

    Parameters
    ----------
    threshold : float
        Distance in the image up to which a point agrees [px].
    trials : int
    seed : int
        Of the draws: one object gives the same fit again.
    """

    name: str = "ransac"
    title: str = "a polynomial by RANSAC"
    _: KW_ONLY
    short: str = "RANSAC"
    on_request: bool = True
    threshold: float = 5.0
    trials: int = 2000
    seed: int = 1

    def declines(self, data: FitData) -> str | None:
        """Return that it takes points alone if there are lines; None otherwise."""
        return f"{self.title} takes points alone" if len(data.features.lines) else None

    def fit(self, data: FitData) -> Fit:
        """Return the fit of the polynomial to the points that agree.

        Raises Undetermined if too few do.
        """
        model = self.model(data.heights, len(data))
        ready = model.prepared(data.scaling, data.features.crs)
        terms = np.ones(len(model.terms), dtype=bool)
        return self.estimator.fit(model, data.features, data.scaling, terms,
                                  self._points_that_vote(ready, data))

    def model(self, heights: bool, points: int = 0) -> RationalModel:
        """Return the polynomial for a number of points: affine, or quadratic if they are many.

        It is of three coordinates with heights, else of two.
        """
        degree = 1 if points < QUADRATIC_FROM else 2
        return Polynomial3D(degree=degree) if heights else Polynomial2D(degree=degree)

    def held_out(self, fitted: Fit) -> HeldOut:
        """Return the errors of features where all is drawn again without them."""
        return held_out_by_refits(self.fit, fitted.control, heights=fitted.model.uses_height)

    def _points_that_vote(self, model: RationalModel, data: FitData) -> BoolArray:
        """Return which points vote for the polynomial that the most vote for, shape (n,).

        Raises Undetermined if points are too few, or no more agree than determine the polynomial.
        """
        scaled = data.scaled.points
        # Lines and samples have the same columns, as each polynomial has its own coefficients.
        design = model.blocks(scaled.ground).line
        count = design.shape[1]
        if len(scaled) <= count:
            raise Undetermined(f"{len(scaled)} points are too few for RANSAC with {count} terms an "
                               "axis", hint=f"Measure at least {count + 1}.")
        rng = np.random.default_rng(self.seed)
        drawn = rng.permuted(np.tile(np.arange(len(scaled)), (self.trials, 1)), axis=1)[:, :count]
        systems = design[drawn]
        # Points that do not determine the polynomial have no vote.
        is_determined = np.linalg.cond(systems) < 1e10
        if not is_determined.any():
            raise Undetermined("no draw of RANSAC determines the polynomial",
                               hint="Spread the control over the area and its heights.")
        coefficients = np.linalg.solve(systems[is_determined], scaled.image[drawn[is_determined]])
        errors = np.linalg.norm(design @ coefficients - scaled.image, axis=2)
        agrees = errors * data.scaling.image_scale <= self.threshold
        votes = agrees.sum(axis=1)
        if votes.max() <= count:
            raise Undetermined(f"no polynomial of RANSAC passes within {self.threshold:g} px of "
                               "more points than determine it",
                               hint="Choose a greater threshold.")
        best: BoolArray = agrees[int(np.argmax(votes))]
        # The polynomial of as few points as determine it has their errors, magnified; that of all
        # that agree has less, so that more may agree with it.
        while True:
            solution = np.linalg.lstsq(design[best], scaled.image[best], rcond=None)[0]
            errors = np.linalg.norm(design @ solution - scaled.image, axis=1)
            more = errors * data.scaling.image_scale <= self.threshold
            if more.sum() <= best.sum():
                return best
            best = more
