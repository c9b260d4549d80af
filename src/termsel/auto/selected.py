"""Forward selection of few terms, with errors by repeating the whole of it without each point.

Affine terms are always in; the term enters that explains most of what is left, and the number
of terms is that of the least extended Bayesian information criterion (see
`termsel.selection.criteria.Ebic`). None enters where what is left is rounding. All is done once
with all points and once without each of them (of many, without each of some folds), as one batch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import comb

import numpy as np

from termsel.adjustment.equations import weights_of
from termsel.adjustment.rounding import ROUNDING, largest
from termsel.adjustment.solve import TOLERANCE
from termsel.auto.local import points_alone
from termsel.data.features import BoolArray, FeatureSet, FloatArray, IntArray
from termsel.data.monomials import monomials
from termsel.data.scaling import Scaling
from termsel.fitting.fit import Estimator, Fit, HeldOut, Undetermined
from termsel.fitting.least_squares import LEAST_SQUARES
from termsel.models.base import SensorModel
from termsel.models.polynomial import Polynomial

MAX_FOLDS = 100


@dataclass(frozen=True, eq=False)
class AxisTerms:
    """Terms selected for one axis."""

    terms: BoolArray  # (k,)
    # (n,): measured minus predicted by a selection that was made without that point, or without its
    # fold where there are more than MAX_FOLDS points.
    errors: FloatArray


class ForwardSelection(Estimator):
    """Least squares with the terms of a polynomial that forward selection chooses for each axis."""

    name = "forward-selection"
    least_squares = True

    def fit(self, model: SensorModel, control: FeatureSet, scaling: Scaling, terms: BoolArray,
            used: BoolArray) -> Fit:
        """Fit a polynomial (see `Estimator.fit`), offering all its terms."""
        assert isinstance(model, Polynomial)
        given = points_alone(control, used, "a selection of terms")
        points = scaling.points(given)
        weights = weights_of(given)
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
                       stored_held_out=HeldOut.of(errors, control.take(used)))


def select_forward(columns: FloatArray, target: FloatArray,
                   forced: BoolArray) -> list[AxisTerms] | None:
    """Select terms for each of the a axes by itself, from columns (a, n, k) for targets (a, n).

    Forced terms (k,) are always in. None if the points without one leave no redundancy of a third
    of the equations with the forced terms alone.
    """
    axes, n, k = columns.shape
    most = (2 * (n - 1)) // 3 - int(forced.sum())
    if most < 0:
        return None
    folds = min(n, MAX_FOLDS)
    fold = np.arange(n) % folds
    order = np.argsort(~forced, kind="stable")
    columns = columns[:, :, order]
    # Line and sample have the same columns unless their weights differ.
    if (columns == columns[0]).all():
        rows = np.concatenate([columns[0], target.T], axis=1)
        augmented = [rows] * axes
        factors = [_without_each(rows, fold)] * axes
        own = range(k, k + axes)
    else:
        augmented = [np.concatenate([one, aim[:, None]], axis=1)
                     for one, aim in zip(columns, target, strict=True)]
        factors = [_without_each(rows, fold) for rows in augmented]
        own = range(k, k + 1)
    which = [np.append(np.arange(k), own[axis % len(own)]) for axis in range(axes)]
    systems = np.concatenate([one[:, :, some] for one, some in zip(factors, which, strict=True)])
    equations = np.tile(np.append(n - np.bincount(fold), n).astype(np.float64), axes)
    found = _chosen(systems, equations, int(forced.sum()), most)
    if found is None:
        return None
    best = found.reshape(axes, folds + 1, k)
    each = np.split(systems, axes)
    return [AxisTerms(chosen[folds][np.argsort(order)],
                      _errors(rows[:, some], fold, system, chosen[:folds]))
            for rows, some, system, chosen in zip(augmented, which, each, best, strict=True)]


def _without_each(rows: FloatArray, fold: IntArray) -> FloatArray:
    """Return the triangular factors of all rows but those of each fold, and at the end of all.

    Of many rows, folds are taken in groups, each of which is factored once.
    """
    folds = int(fold.max()) + 1
    if len(rows) == folds:  # few: one call is faster
        return _triangle(rows * (fold != np.arange(folds + 1)[:, None])[:, :, None])
    found = np.empty((folds + 1, min(rows.shape), rows.shape[1]))
    groups = np.array_split(np.arange(folds), round(np.sqrt(folds)))
    each = [_triangle(rows[np.isin(fold, some)]) for some in groups]
    found[folds] = _triangle(np.concatenate(each))
    for group, some in enumerate(groups):
        mine = np.isin(fold, some)
        others = _triangle(np.concatenate([rows[:0], *each[:group], *each[group + 1:]]))
        kept = fold[mine] != some[:, None]
        found[some] = _triangle(np.concatenate([
            np.broadcast_to(others, (len(some), *others.shape)), rows[mine] * kept[:, :, None]],
            axis=1))
    return found


def _triangle(rows: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.qr(rows, mode="r"))


def _chosen(systems: FloatArray, equations: FloatArray, forced: int,
            most: int) -> BoolArray | None:
    """Return the terms that each of s systems selects, (s, k); None if forced ones are dependent.

    The systems (s, r, k + 1) are triangular factors of columns and target, of so many equations
    (s,). Forced terms come first and are always in; at most so many others are selected.
    """
    count = len(systems)
    free = systems.shape[2] - 1 - forced
    lengths = np.linalg.norm(systems[:, :, :-1], axis=1)
    lead = np.abs(np.diagonal(systems, axis1=1, axis2=2)[:, :forced])
    if (lead <= TOLERANCE * lengths[:, :forced]).any():
        return None
    # The forced terms are taken out: their rows of the triangle are.
    rest = systems[:, forced:, forced:-1].copy()
    left = systems[:, forced:, -1]
    lengths = lengths[:, forced:]
    chosen = np.zeros((count, free), dtype=bool)
    best = chosen.copy()
    least = np.full(count, np.inf)
    rows = np.arange(count)
    # All terms are a candidate of their own. No selection leaves less than they do.
    counts = range(max(min(most, free - 1), 0) + 1)
    rounding = (ROUNDING * np.linalg.norm(systems[:, :, -1], axis=1)) ** 2
    bounds = np.array([_criterion(systems[:, forced + free:, -1], rounding, equations, more, free,
                                  forced + more) for more in counts])
    for added in counts:
        value = _criterion(left, rounding, equations, added, free, forced + added)
        better = value < least
        least = np.where(better, value, least)
        best = np.where(better[:, None], chosen, best)
        squares = np.einsum("bnk,bnk->bk", rest, rest)
        usable = ~chosen & (squares > (TOLERANCE * lengths) ** 2)
        if (not usable.any(axis=1).all()
                or (least < bounds[added + 1:].min(axis=0, initial=np.inf)).all()):
            break
        gain = np.einsum("bnk,bn->bk", rest, left) ** 2
        entering = largest(np.where(usable, gain / np.where(usable, squares, 1.0), -1.0))
        q = rest[rows, :, entering] / np.sqrt(squares[rows, entering])[:, None]
        rest -= q[:, :, None] * np.einsum("bn,bnk->bk", q, rest)[:, None, :]
        left = left - q * np.einsum("bn,bn->b", q, left)[:, None]
        chosen[rows, entering] = True
    return np.concatenate([np.ones((count, forced), dtype=bool), best], axis=1)


def _errors(rows: FloatArray, fold: IntArray, systems: FloatArray, best: BoolArray) -> FloatArray:
    """Return the errors of rows, shape (n, k + 1), by what was selected without their fold."""
    errors = np.empty(len(rows))
    # Most folds select the same terms, and are solved together.
    masks, which = np.unique(best, axis=0, return_inverse=True)
    which = which.ravel()
    for one, mask in enumerate(masks):
        outs = np.flatnonzero(which == one)
        count = int(mask.sum())
        r = _triangle(systems[outs][:, :, np.append(mask, True)])
        place = np.empty(len(best), dtype=np.intp)
        place[outs] = np.arange(len(outs))
        x = np.linalg.solve(r[:, :count, :count], r[:, :count, count:])[:, :, 0]
        mine = which[fold] == one
        errors[mine] = rows[mine, -1] - np.einsum("nk,nk->n", rows[mine, :-1][:, mask],
                                                  x[place[fold[mine]]])
    return errors


def _criterion(left: FloatArray, rounding: FloatArray, n: FloatArray, count: int, free: int,
               used: int) -> FloatArray:
    """Return the criterion of some of the free terms, of n equations each.

    A sum of squares is at least that of rounding (s,): its logarithm has no meaning below.
    """
    rss = np.maximum((left**2).sum(axis=1), np.maximum(rounding, np.finfo(float).tiny))
    return np.asarray(n * np.log(rss / n) + used * np.log(n) + 2 * np.log(comb(free, count)))
