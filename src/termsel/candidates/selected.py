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
from termsel.measurements.features import BoolArray, FeatureSet, FloatArray, IntArray
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
        sides = select_forward(columns * weights.T[:, :, None], (points.image * weights).T, affine)
        if sides is None:
            raise Undetermined(f"{len(points)} control points are too few to select terms by",
                               hint="Measure more control, or fit the model affine.")
        errors = np.stack([one.errors for one in sides], axis=1) / weights * scaling.image_scale
        chosen = np.concatenate([one.terms for one in sides])
        fitted = LEAST_SQUARES.fit(model, control, scaling, chosen, used)
        return replace(fitted, estimator=self,
                       held_out=HeldOut(errors, (errors**2).sum(axis=1)))


def select_forward(columns: FloatArray, target: FloatArray,
                   forced: BoolArray) -> list[AxisTerms] | None:
    """Select terms of some axes, each by itself.

    Parameters
    ----------
    columns : ndarray, shape (a, n, k)
    target : ndarray, shape (a, n)
    forced : ndarray of bool, shape (k,)
        Terms that are always in.

    Returns
    -------
    list of AxisTerms, or None
        None if the points without one leave no redundancy of a third of the equations with
        the forced terms alone.
    """
    axes, n, k = columns.shape
    most = (2 * (n - 1)) // 3 - int(forced.sum())
    if most < 0:
        return None
    folds = min(n, MAX_FOLDS)
    fold = np.arange(n) % folds
    augmented = np.concatenate([columns, target[:, :, None]], axis=2)
    systems = np.stack([_without_each(one, fold) for one in augmented])
    equations = np.tile(np.append(n - np.bincount(fold), n).astype(np.float64), axes)
    found = _chosen(systems.reshape(-1, *systems.shape[2:]), equations, forced, most)
    if found is None:
        return None
    best = found.reshape(axes, folds + 1, k)
    return [AxisTerms(chosen[folds], _errors(one, fold, system, chosen[:folds]))
            for one, system, chosen in zip(augmented, systems, best, strict=True)]


def _without_each(rows: FloatArray, fold: IntArray) -> FloatArray:
    """Return the triangular factors of all rows but those of each fold, and at the end of all.

    Folds are taken in groups, whose other rows are factored once.
    """
    folds = int(fold.max()) + 1
    found = np.empty((folds + 1, min(rows.shape), rows.shape[1]))
    found[folds] = _triangle(rows)
    for some in np.array_split(np.arange(folds), round(np.sqrt(folds))):
        mine = np.isin(fold, some)
        others, kept = _triangle(rows[~mine]), fold[mine] != some[:, None]
        found[some] = _triangle(np.concatenate([
            np.broadcast_to(others, (len(some), *others.shape)), rows[mine] * kept[:, :, None]],
            axis=1))
    return found


def _triangle(rows: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.qr(rows, mode="r"))


def _chosen(systems: FloatArray, equations: FloatArray, forced: BoolArray,
            most: int) -> BoolArray | None:
    """Return the terms that each of s systems selects, shape (s, k); None if the forced ones are
    dependent.

    Parameters
    ----------
    systems : ndarray, shape (s, r, k + 1)
        Columns and target, or their triangular factor.
    equations : ndarray, shape (s,)
        How many each system had.
    forced : ndarray of bool, shape (k,)
    most : int
        Terms that are selected at most, forced ones apart.
    """
    rest, left = systems[:, :, :-1].copy(), systems[:, :, -1]
    count, k = len(rest), len(forced)
    lengths = np.linalg.norm(rest, axis=1)
    chosen = np.zeros((count, k), dtype=bool)
    best, least = chosen.copy(), np.full(count, np.inf)
    rows, free = np.arange(count), int((~forced).sum())
    for step in range(k):
        norms = np.linalg.norm(rest, axis=1)
        usable = ~chosen & (norms > TOLERANCE * lengths)
        if step < k - free:
            entering = np.full(count, np.flatnonzero(forced)[step])
            if not usable[rows, entering].all():
                return None
        else:
            added = step - (k - free)
            least, best = _keep_best(left, equations, added, free, step, chosen, least, best)
            if added == min(most, free) or not usable.any(axis=1).all():
                break
            gain = np.einsum("bnk,bn->bk", rest, left) ** 2
            gain = np.where(usable, gain / np.where(usable, norms, 1.0) ** 2, -1.0)
            entering = gain.argmax(axis=1)
        q = rest[rows, :, entering] / norms[rows, entering, None]
        rest -= q[:, :, None] * np.einsum("bn,bnk->bk", q, rest)[:, None, :]
        left = left - q * np.einsum("bn,bn->b", q, left)[:, None]
        chosen[rows, entering] = True
    return best


def _errors(rows: FloatArray, fold: IntArray, systems: FloatArray, best: BoolArray) -> FloatArray:
    """Return the errors of rows, shape (n, k + 1), by what was selected without their fold."""
    errors = np.empty(len(rows))
    # Most folds select the same terms, and are solved together.
    masks, which = np.unique(best, axis=0, return_inverse=True)
    which = which.ravel()
    for one, mask in enumerate(masks):
        outs, count = np.flatnonzero(which == one), int(mask.sum())
        r = _triangle(systems[outs][:, :, np.append(mask, True)])
        place = np.empty(len(best), dtype=np.intp)
        place[outs] = np.arange(len(outs))
        x = np.linalg.solve(r[:, :count, :count], r[:, :count, count:])[:, :, 0]
        mine = which[fold] == one
        errors[mine] = rows[mine, -1] - np.einsum("nk,nk->n", rows[mine, :-1][:, mask],
                                                  x[place[fold[mine]]])
    return errors


def _keep_best(left: FloatArray, n: FloatArray, count: int, free: int, used: int,
               chosen: BoolArray, least: FloatArray, best: BoolArray,
               ) -> tuple[FloatArray, BoolArray]:
    """Return the least criteria so far and the selections they are of; n equations each."""
    rss = np.maximum((left**2).sum(axis=1), np.finfo(float).tiny)
    value = n * np.log(rss / n) + used * np.log(n) + 2 * np.log(comb(free, count))
    better = value < least
    return np.where(better, value, least), np.where(better[:, None], chosen, best)
