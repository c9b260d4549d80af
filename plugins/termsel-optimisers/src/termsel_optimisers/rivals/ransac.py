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

MIN_QUADRATIC_POINTS = 20
"""Points from which on the polynomial is quadratic: as few as it has terms leave nothing to vote.
"""


@dataclass(frozen=True, eq=False)
class Ransac(Method):
    """Polynomial of the points that agree best, affine or, from 20 points on, quadratic.

    So many times as `trials` says, as few points as the polynomial has terms per image
    coordinate determine it, and all points within `threshold` of it vote for it. The points that
    vote for the best are fitted by least squares, without the others. Fischler and Bolles 1981,
    Communications of the ACM 24(6).

    Parameters
    ----------
    threshold : float
        Distance in the image up to which a point agrees [px].
    trials : int
    seed : int
        Seed of the draws: one object gives the same fit again.
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
        """Return the fit of the polynomial to the points that agree with the best draw.

        Raises Undetermined if there are too few points, if no draw determines a polynomial, or if
        no more points agree than determine it.
        """
        model = self.model(data.heights, len(data))
        ready = model.prepared(data.scaling, data.features.crs)
        terms = np.ones(len(model.terms), dtype=bool)
        return self.estimator.fit(model, data.features, data.scaling, terms,
                                  self._points_that_vote(ready, data))

    def model(self, heights: bool, points: int = 0) -> RationalModel:
        """Return the polynomial for a number of points, in space with heights, else in the plane.

        It is affine, or quadratic from `MIN_QUADRATIC_POINTS` points on.
        """
        degree = 1 if points < MIN_QUADRATIC_POINTS else 2
        return Polynomial3D(degree=degree) if heights else Polynomial2D(degree=degree)

    def held_out(self, fitted: Fit) -> HeldOut:
        """Return the errors of features by fits without them, for which all is drawn again."""
        return held_out_by_refits(self.fit, fitted.control, heights=fitted.model.uses_height)

    def _points_that_vote(self, model: RationalModel, data: FitData) -> BoolArray:
        """Return which points agree with the polynomial that most points agree with, shape (n,).

        Raises Undetermined as `fit` does.
        """
        scaled = data.scaled.points
        # Line and sample have the same columns, with coefficients of their own.
        design = model.blocks(scaled.ground).line
        n_terms = design.shape[1]
        if len(scaled) <= n_terms:
            raise Undetermined(f"{len(scaled)} points are too few for RANSAC with {n_terms} terms "
                               "per image coordinate", hint=f"Measure at least {n_terms + 1}.")
        rng = np.random.default_rng(self.seed)
        draws = rng.permuted(
            np.tile(np.arange(len(scaled)), (self.trials, 1)), axis=1)[:, :n_terms]
        systems = design[draws]
        # Draws of points that do not determine the polynomial are left out.
        is_determined = np.linalg.cond(systems) < 1e10
        if not is_determined.any():
            raise Undetermined("no draw of RANSAC determines the polynomial",
                               hint="Spread the control over the area and its heights.")
        coefficients = np.linalg.solve(systems[is_determined], scaled.image[draws[is_determined]])
        errors = np.linalg.norm(design @ coefficients - scaled.image, axis=2)
        agrees = errors * data.scaling.image_scale <= self.threshold
        votes = agrees.sum(axis=1)
        if votes.max() <= n_terms:
            raise Undetermined(f"no polynomial of RANSAC passes within {self.threshold:g} px of "
                               "more points than determine it",
                               hint="Choose a greater threshold.")
        best: BoolArray = agrees[int(np.argmax(votes))]
        # A polynomial of as few points as determine it has their errors, magnified. That of all
        # which agree has smaller errors, so that more points may agree with it.
        while True:
            solution = np.linalg.lstsq(design[best], scaled.image[best], rcond=None)[0]
            errors = np.linalg.norm(design @ solution - scaled.image, axis=1)
            agreeing = errors * data.scaling.image_scale <= self.threshold
            if agreeing.sum() <= best.sum():
                return best
            best = agreeing
