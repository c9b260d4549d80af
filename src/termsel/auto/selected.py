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
from termsel.adjustment.solve import ROUNDING, TOLERANCE, index_of_largest
from termsel.auto.shrunken import points_alone
from termsel.data.features import BoolArray, FeatureSet, FloatArray, IntArray
from termsel.data.monomials import evaluate_monomials
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
        points_in_use = points_alone(control, used, "a selection of terms")
        points = scaling.points(points_in_use)
        weights = weights_of(points_in_use)
        columns = evaluate_monomials(points.ground, model.exponents)
        affine = np.array(model.exponents).sum(axis=1) < 2
        selections = select_forward(columns * weights.T[:, :, None], (points.image * weights).T,
                                    affine)
        if selections is None:
            raise Undetermined(f"{len(points)} control points are too few to select terms by",
                               hint="Measure more control, or fit the model affine.")
        errors = np.stack([selection.errors
                           for selection in selections], axis=1) / weights * scaling.image_scale
        chosen = np.concatenate([selection.terms for selection in selections])
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
    max_selected = (2 * (n - 1)) // 3 - int(forced.sum())
    if max_selected < 0:
        return None
    folds = min(n, MAX_FOLDS)
    fold = np.arange(n) % folds
    order = np.argsort(~forced, kind="stable")
    columns = columns[:, :, order]
    # Line and sample have the same columns unless their weights differ.
    if (columns == columns[0]).all():
        rows = np.concatenate([columns[0], target.T], axis=1)
        augmented = [rows] * axes
        factors = [_factors_without_folds(rows, fold)] * axes
        target_columns = range(k, k + axes)
    else:
        augmented = [np.concatenate([rows_of_axis, axis_target[:, None]], axis=1)
                     for rows_of_axis, axis_target in zip(columns, target, strict=True)]
        factors = [_factors_without_folds(rows, fold) for rows in augmented]
        target_columns = range(k, k + 1)
    system_columns = [
        np.append(np.arange(k), target_columns[axis % len(target_columns)]) for axis in range(axes)
    ]
    systems = np.concatenate([
        rows_of_axis[:, :, columns_of_axis]
        for rows_of_axis, columns_of_axis in zip(factors, system_columns, strict=True)
    ])
    equations = np.tile(np.append(n - np.bincount(fold), n).astype(np.float64), axes)
    selected = _selected_terms(systems, equations, int(forced.sum()), max_selected)
    if selected is None:
        return None
    best = selected.reshape(axes, folds + 1, k)
    systems_of_axes = np.split(systems, axes)
    return [
        AxisTerms(chosen[folds][np.argsort(order)],
                  _errors_of_folds(rows[:, columns_of_axis], fold, system, chosen[:folds]))
        for rows, columns_of_axis, system, chosen in zip(
            augmented, system_columns, systems_of_axes, best, strict=True)
    ]


def _factors_without_folds(rows: FloatArray, fold: IntArray) -> FloatArray:
    """Return the triangular factors of all rows but those of each fold, (folds + 1, r, k + 1).

    The last one is of all rows. Of many rows, folds are taken in groups, each of which is factored
    once.
    """
    folds = int(fold.max()) + 1
    if len(rows) == folds:  # few: one call is faster
        return _triangle(rows * (fold != np.arange(folds + 1)[:, None])[:, :, None])
    triangles = np.empty((folds + 1, min(rows.shape), rows.shape[1]))
    groups = np.array_split(np.arange(folds), round(np.sqrt(folds)))
    group_triangles = [_triangle(rows[np.isin(fold, group_folds)]) for group_folds in groups]
    triangles[folds] = _triangle(np.concatenate(group_triangles))
    for group, group_folds in enumerate(groups):
        in_group = np.isin(fold, group_folds)
        triangle_of_others = _triangle(
            np.concatenate([rows[:0], *group_triangles[:group], *group_triangles[group + 1:]]))
        stays = fold[in_group] != group_folds[:, None]
        triangles[group_folds] = _triangle(
            np.concatenate([
                np.broadcast_to(triangle_of_others, (len(group_folds), *triangle_of_others.shape)),
                rows[in_group] * stays[:, :, None]
            ],
                           axis=1))
    return triangles


def _triangle(rows: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.qr(rows, mode="r"))


def _selected_terms(systems: FloatArray, equations: FloatArray, forced: int,
                    max_selected: int) -> BoolArray | None:
    """Return the terms that each of s systems selects, (s, k); None if forced ones are dependent.

    The systems (s, r, k + 1) are triangular factors of columns and target, of so many equations
    (s,). Forced terms come first and are always in; at most so many others are selected.
    """
    count = len(systems)
    free = systems.shape[2] - 1 - forced
    lengths = np.linalg.norm(systems[:, :, :-1], axis=1)
    forced_diagonal = np.abs(np.diagonal(systems, axis1=1, axis2=2)[:, :forced])
    if (forced_diagonal <= TOLERANCE * lengths[:, :forced]).any():
        return None
    # The forced terms are taken out: their rows of the triangle are.
    free_rows = systems[:, forced:, forced:-1].copy()
    targets = systems[:, forced:, -1]
    lengths = lengths[:, forced:]
    chosen = np.zeros((count, free), dtype=bool)
    best = chosen.copy()
    best_value = np.full(count, np.inf)
    rows = np.arange(count)
    # All terms are a candidate of their own. No selection leaves less than they do.
    counts = range(max(min(max_selected, free - 1), 0) + 1)
    rounding = (ROUNDING * np.linalg.norm(systems[:, :, -1], axis=1)) ** 2
    bounds = np.array([_criterion(systems[:, forced + free:, -1], rounding, equations, n_more, free,
                                  forced + n_more) for n_more in counts])
    for added in counts:
        value = _criterion(targets, rounding, equations, added, free, forced + added)
        better = value < best_value
        best_value = np.where(better, value, best_value)
        best = np.where(better[:, None], chosen, best)
        squares = np.einsum("bnk,bnk->bk", free_rows, free_rows)
        usable = ~chosen & (squares > (TOLERANCE * lengths) ** 2)
        if (not usable.any(axis=1).all()
                or (best_value < bounds[added + 1:].min(axis=0, initial=np.inf)).all()):
            break
        gain = np.einsum("bnk,bn->bk", free_rows, targets) ** 2
        entering = index_of_largest(np.where(usable, gain / np.where(usable, squares, 1.0), -1.0))
        q = free_rows[rows, :, entering] / np.sqrt(squares[rows, entering])[:, None]
        free_rows -= q[:, :, None] * np.einsum("bn,bnk->bk", q, free_rows)[:, None, :]
        targets = targets - q * np.einsum("bn,bn->b", q, targets)[:, None]
        chosen[rows, entering] = True
    return np.concatenate([np.ones((count, forced), dtype=bool), best], axis=1)


def _errors_of_folds(rows: FloatArray, fold: IntArray, systems: FloatArray,
                     best: BoolArray) -> FloatArray:
    """Return the error of each row (n, k + 1), shape (n,), by the terms selected without its fold.
    """
    errors = np.empty(len(rows))
    # Most folds select the same terms, and are solved together.
    masks, mask_of_fold = np.unique(best, axis=0, return_inverse=True)
    mask_of_fold = mask_of_fold.ravel()
    for mask_index, mask in enumerate(masks):
        folds_of_mask = np.flatnonzero(mask_of_fold == mask_index)
        count = int(mask.sum())
        r = _triangle(systems[folds_of_mask][:, :, np.append(mask, True)])
        position = np.empty(len(best), dtype=np.intp)
        position[folds_of_mask] = np.arange(len(folds_of_mask))
        x = np.linalg.solve(r[:, :count, :count], r[:, :count, count:])[:, :, 0]
        rows_of_mask = mask_of_fold[fold] == mask_index
        errors[rows_of_mask] = rows[rows_of_mask, -1] - np.einsum(
            "nk,nk->n", rows[rows_of_mask, :-1][:, mask], x[position[fold[rows_of_mask]]])
    return errors


def _criterion(residuals: FloatArray, rounding: FloatArray, n: FloatArray, count: int, free: int,
               used: int) -> FloatArray:
    """Return the criterion of some of the free terms, of n equations each.

    A sum of squares is at least that of rounding (s,): its logarithm has no meaning below.
    """
    rss = np.maximum((residuals**2).sum(axis=1), np.maximum(rounding, np.finfo(float).tiny))
    return np.asarray(n * np.log(rss / n) + used * np.log(n) + 2 * np.log(comb(free, count)))
