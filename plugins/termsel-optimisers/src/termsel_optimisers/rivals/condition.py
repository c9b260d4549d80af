"""The predicted error over the whole image as a criterion."""

from __future__ import annotations

import numpy as np

from termsel import Criterion, FeatureSet, Fits, Option, Points, TermselError
from termsel.toolkit import Remedy
from termsel_optimisers.arrays import FloatArray

SIDE = 9
"""Places along either side of the area of the control."""


class FigureCondition(Criterion):
    """Predicted error over the image by the covariance of the coefficients [px].

    Moghaddam, Mokhtarzade, Alizadeh Naeini and Amiri-Simkooei 2018, "Optimization of RFM's
    structure based on PSO algorithm and figure condition analysis", IEEE GRSL 15(8), p. 1179. Only
    a summary could be consulted: the cost is the sum of the predicted errors over all pixels, so
    that selections with a bad condition cost more than they fit better. The formulation here is
    termsel's own: the root mean square over places of sigma^2 a' (A'A)^-1 a of line and sample,
    with sigma^2 of the residuals of the control, A the equations of the chosen terms and a the
    equation of a place.

    The places are a grid over the area of the control, with the height of the nearest control
    point. As the terms near the equations in number, the residuals vanish and so does sigma:
    selections with less redundancy than `min_redundancy` have no figure. It needs no check points.
    """

    name = "figure-condition"
    needs_check = False
    is_rmse = False
    declared_options = (
        Option("min_redundancy", None, "Least number of equations minus terms, for line and for "
                                       "sample; by default a third of the equations, and at least "
                                       "1.", int, 1, 1_000_000),)

    def score(self, fits: Fits) -> FloatArray:
        """Return the predicted error over the image [px] of each model, (p,).

        It is the root of twice the mean variance over a grid, and infinite without terms, without
        enough redundancy, and for terms that depend on each other. Raises TermselError for a model
        that corrects its predictions by the control.
        """
        if fits.model.corrects:
            raise TermselError(f"criterion {self.name!r} cannot judge model {fits.model.name!r}, "
                               "which corrects its predictions by the control",
                               hint=f"Choose {Remedy('criterion', 'check-rmse')}.")
        grid = places_of(fits)
        image = fits.model.project(fits.coefficients, grid)
        denominators = fits.model.denominators(fits.coefficients, grid)
        # Columns of denominators have the image position as a factor, so that equations are linear
        # in it: two positions are enough.
        at_zero, at_one = (fits.model.equations(FeatureSet(Points(
            tuple(map(str, range(len(grid)))), np.full((len(grid), 2), value), grid))).A
            for value in (0.0, 1.0))
        figures = np.empty(len(fits.terms))
        for i, terms in enumerate(fits.terms):
            rows = at_zero + image[i].reshape(-1, 1) * (at_one - at_zero)
            variance = self._prediction_variance(fits, i, rows)
            if denominators is not None:
                variance = variance / denominators[i].reshape(-1) ** 2
            figures[i] = np.sqrt(2 * variance.mean()) * fits.pixels if terms.any() else np.inf
        return figures

    def _prediction_variance(self, fits: Fits, i: int, rows: FloatArray) -> FloatArray:
        """Return the variance (2 n,) of the i-th model's predictions at equations `rows` (2 n, k).

        It is in scaled units, and infinite if the model has too little redundancy, or its terms
        depend on each other.
        """
        total = np.zeros(len(rows))
        for system in fits.parts:
            is_chosen = fits.terms[i, system.columns]
            is_used = fits.in_use[i][system.equations.feature]
            A = system.equations.A[is_used][:, is_chosen]
            b = system.equations.b[is_used]
            redundancy = len(b) - int(is_chosen.sum())
            min_redundancy = self.options["min_redundancy"]
            if min_redundancy is None:
                min_redundancy = max(1, round(len(b) / 3))
            if redundancy < min_redundancy:
                return np.full(len(rows), np.inf)
            x = fits.coefficients[i, system.columns][is_chosen]
            unit_variance = float(((b - A @ x) ** 2).sum()) / redundancy
            _, values, right = np.linalg.svd(A, full_matrices=False)
            if not len(values) or values[-1] <= 1e-12 * values[0]:
                return np.full(len(rows), np.inf)
            # With A = U S V' the variance of a row a is sigma^2 |S^-1 V'a|^2.
            factors = rows[:, system.columns][:, is_chosen] @ right.T / values
            total += unit_variance * (factors**2).sum(axis=1)
        return total


def places_of(fits: Fits) -> FloatArray:
    """Return a grid over the area of the control, in scaled coordinates, shape (n, 3)."""
    ground = np.concatenate([fits.control.ground, fits.lines.ground.reshape(-1, 3)])
    low = ground[:, :2].min(axis=0)
    high = ground[:, :2].max(axis=0)
    x, y = np.meshgrid(*(np.linspace(low[j], high[j], SIDE) for j in (0, 1)))
    plan = np.column_stack([x.ravel(), y.ravel()])
    # The terrain between control is not known, so that the height is that of the nearest one.
    nearest = np.linalg.norm(plan[:, None] - ground[:, :2], axis=2).argmin(axis=1)
    return np.column_stack([plan, ground[nearest, 2]])
