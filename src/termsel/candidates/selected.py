"""Forward selection of few terms, with errors by repeating the whole of it without each point.

Affine terms are always in; the term enters that explains most of what is left, and the number
of terms is that of the least extended Bayesian information criterion (see
`termsel.criteria.Ebic`). All is done once with all points and once without each of them (of many,
without each of some folds), as one batch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import comb

import numpy as np

from termsel.adjustment.equations import weights_of
from termsel.adjustment.monomials import monomials
from termsel.adjustment.solve import TOLERANCE
from termsel.candidates.points import points_alone
from termsel.fits.fit import Estimator, Fit, HeldOut, Undetermined
from termsel.fits.fittable import Fittable
from termsel.fits.least_squares import LEAST_SQUARES
from termsel.measurements.features import BoolArray, FeatureSet, FloatArray
from termsel.measurements.scaling import Scaling
from termsel.models.polynomial import Polynomial

MAX_FOLDS = 100


@dataclass(frozen=True, eq=False)
class AxisTerms:
    """Terms selected for one axis.

    Parameters
    ----------
    terms : ndarray of bool, shape (k,)
    errors : ndarray, shape (n,)
        Measured minus predicted by a selection that was made without that point, or without its
        fold where there are more than MAX_FOLDS points.
    """

    terms: BoolArray
    errors: FloatArray


class ForwardSelection(Estimator):
    """Least squares with the terms of a polynomial that forward selection chooses for each axis."""

    least_squares = True

    def fit(self, model: Fittable, control: FeatureSet, scaling: Scaling, terms: BoolArray,
            used: BoolArray) -> Fit:
        """Fit a polynomial (see `Estimator.fit`), offering all its terms."""
        assert isinstance(model, Polynomial)
        given = points_alone(control, used, "a selection of terms")
        points, weights = scaling.points(given), weights_of(given)
        columns = monomials(points.ground, model.exponents)
        affine = np.array(model.exponents).sum(axis=1) < 2
        sides = [select_forward(columns * w[:, None], image * w, affine)
                 for image, w in zip(points.image.T, weights.T, strict=True)]
        line, sample = sides
        if line is None or sample is None:
            raise Undetermined(f"{len(points)} control points are too few to select terms by",
                               hint="Measure more control, or fit the model affine.")
        errors = np.stack([line.errors, sample.errors], axis=1) / weights * scaling.image_scale
        chosen = np.concatenate([line.terms, sample.terms])
        fitted = LEAST_SQUARES.fit(model, control, scaling, chosen, used)
        return replace(fitted, estimator=self,
                       held_out=HeldOut(errors, (errors**2).sum(axis=1)))


def select_forward(columns: FloatArray, target: FloatArray, forced: BoolArray) -> AxisTerms | None:
    """Select terms of one axis.

    Parameters
    ----------
    columns : ndarray, shape (n, k)
    target : ndarray, shape (n,)
    forced : ndarray of bool, shape (k,)
        Terms that are always in.

    Returns
    -------
    AxisTerms or None
        None if the points without one leave no redundancy of a third of the equations with
        the forced terms alone.
    """
    n, k = columns.shape
    most = (2 * (n - 1)) // 3 - int(forced.sum())
    if most < 0:
        return None
    # The last system of the batch has all points, the others are without one fold each.
    folds = min(n, MAX_FOLDS)
    fold = np.arange(n) % folds
    present = np.ones((folds + 1, n))
    present[fold, np.arange(n)] = 0.0
    # Triangular factors stand for the systems: as long as the rows are many, they are not.
    augmented = np.concatenate([columns, target[:, None]], axis=1)
    systems = np.asarray(np.linalg.qr(augmented * present[:, :, None], mode="r"))
    rest, left = systems[:, :, :k], systems[:, :, k]
    lengths = np.linalg.norm(rest, axis=1)
    chosen = np.zeros((folds + 1, k), dtype=bool)
    best, least = chosen.copy(), np.full(folds + 1, np.inf)
    rows = np.arange(folds + 1)
    free = int((~forced).sum())
    for step in range(k):
        norms = np.linalg.norm(rest, axis=1)
        usable = ~chosen & (norms > TOLERANCE * lengths)
        if step < forced.sum():
            entering = np.full(folds + 1, np.flatnonzero(forced)[step])
            if not usable[rows, entering].all():
                return None
        else:
            count = step - int(forced.sum())
            least, best = _keep_best(left, present.sum(axis=1), count, free, step, chosen, least,
                                     best)
            if count == min(most, free) or not usable.any(axis=1).all():
                break
            gain = np.einsum("bnk,bn->bk", rest, left) ** 2
            gain = np.where(usable, gain / np.where(usable, norms, 1.0) ** 2, -1.0)
            entering = gain.argmax(axis=1)
        q = rest[rows, :, entering] / norms[rows, entering, None]
        rest = rest - q[:, :, None] * np.einsum("bn,bnk->bk", q, rest)[:, None, :]
        left = left - q * np.einsum("bn,bn->b", q, left)[:, None]
        chosen[rows, entering] = True
    errors = np.empty(n)
    # Most folds select the same terms, and are solved together.
    masks, which = np.unique(best[:folds], axis=0, return_inverse=True)
    for one, mask in enumerate(masks):
        outs = np.flatnonzero(which.ravel() == one)
        q, r = np.linalg.qr(systems[outs][:, :, :k][:, :, mask])
        x = np.linalg.solve(r, q.transpose(0, 2, 1) @ systems[outs][:, :, k, None])[:, :, 0]
        place = np.full(folds, -1)
        place[outs] = np.arange(len(outs))
        mine = place[fold] >= 0
        errors[mine] = target[mine] - np.einsum("nk,nk->n", columns[mine][:, mask],
                                                x[place[fold[mine]]])
    return AxisTerms(best[folds], errors)


def _keep_best(left: FloatArray, n: FloatArray, count: int, free: int, used: int,
               chosen: BoolArray, least: FloatArray, best: BoolArray,
               ) -> tuple[FloatArray, BoolArray]:
    """Return the least criteria so far and the selections they are of; n equations each."""
    rss = np.maximum((left**2).sum(axis=1), np.finfo(float).tiny)
    value = n * np.log(rss / n) + used * np.log(n) + 2 * np.log(comb(free, count))
    better = value < least
    return np.where(better, value, least), np.where(better[:, None], chosen, best)
