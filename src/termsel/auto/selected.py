"""Forward selection of few terms, with errors by repeating the whole of it without each point.

Affine terms are always in; the term enters that explains most of what is left, and the number
of terms is that of the least extended Bayesian information criterion (see
`termsel.selection.criteria.Ebic`). None enters where what is left is rounding. All is done once
with all points and once without each of them (of many, without each of some folds), as one batch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from math import comb

import numpy as np

from termsel.adjustment.compiled import compile_lazily
from termsel.adjustment.equations import weights_of
from termsel.adjustment.solve import ROUNDING, TOLERANCE
from termsel.auto.shrunken import points_alone
from termsel.data.features import BoolArray, FeatureSet, FloatArray, IntArray
from termsel.data.monomials import evaluate_monomials
from termsel.data.scaling import Scaling
from termsel.fitting.fit import Estimator, Fit, HeldOut, Undetermined
from termsel.fitting.least_squares import LEAST_SQUARES
from termsel.models.base import SensorModel
from termsel.models.polynomial import Polynomial

MAX_FOLDS = 100

# Nothing is allocated, and sums are taken in the order in which they are written.
_compiled = partial(compile_lazily, _nrt=False)


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
        """Fit a polynomial with the terms that cross-validation selects, one after another.

        Arguments are those of `Estimator.fit`; all terms are on offer, affine ones are always in.
        Held-out errors are those of the selection repeated without each point. Raises Undetermined
        for lines and for too few points.
        """
        assert isinstance(model, Polynomial)
        points_in_use = points_alone(control, used, "a selection of terms")
        points = scaling.points(points_in_use)
        weights = weights_of(points_in_use)
        columns = evaluate_monomials(points.ground, model.exponents)
        affine = np.array(model.exponents).sum(axis=1) < 2
        # Weighted columns (2, n, k) and measurements (2, n): line and sample choose for themselves.
        selections = select_forward(columns * weights.T[:, :, None], (points.image * weights).T,
                                    affine)
        if selections is None:
            raise Undetermined(f"{len(points)} control points are too few to select terms by",
                               hint="Measure more control, or fit the model affine.")
        # Errors of weighted equations are divided by the weights, and in px again.
        errors = np.stack([selection.errors
                           for selection in selections], axis=1) / weights * scaling.image_scale
        chosen = np.concatenate([selection.terms for selection in selections])
        fitted = LEAST_SQUARES.fit(model, control, scaling, chosen, used)
        return replace(fitted, estimator=self,
                       stored_held_out=HeldOut.of(errors, control.take(used)))


def select_forward(columns: FloatArray, target: FloatArray,
                   forced: BoolArray) -> list[AxisTerms] | None:
    """Select terms for each axis by itself, with all points and without each fold of them.

    Parameters
    ----------
    columns : ndarray, shape (a, n, k)
        The terms of each of the a axes, multiplied by the weights of the points.
    target : ndarray, shape (a, n)
        The measured image, likewise.
    forced : ndarray, shape (k,)
        Terms that are always in.

    Returns
    -------
    list of AxisTerms or None
        One for each axis; None if the forced terms alone leave less redundancy than a third of the
        equations, once a point is left out, or if they depend on each other without some fold.
    """
    axes, n, k = columns.shape
    max_selected = (2 * (n - 1)) // 3 - int(forced.sum())
    if max_selected < 0:
        return None
    folds = min(n, MAX_FOLDS)
    fold = np.arange(n) % folds
    # Forced terms first, as the triangular factors need them.
    order = np.argsort(~forced, kind="stable")
    columns = columns[:, :, order]
    rows_of_axes, systems = _rows_and_systems(columns, target, fold)
    equations = np.tile(np.append(n - np.bincount(fold), n).astype(np.float64), axes)
    selected = _selected_terms(systems, equations, int(forced.sum()), max_selected)
    if selected is None:
        return None
    # Of each axis: the terms selected without each fold, and last those of all points.
    selected_of_axes = selected.reshape(axes, folds + 1, k)
    result = []
    for rows, systems_of_axis, selected_of_axis in zip(
            rows_of_axes, np.split(systems, axes), selected_of_axes, strict=True):
        errors = _errors_of_folds(rows, fold, systems_of_axis, selected_of_axis[:folds])
        result.append(AxisTerms(selected_of_axis[folds][np.argsort(order)], errors))
    return result


def _rows_and_systems(columns: FloatArray, target: FloatArray,
                      fold: IntArray) -> tuple[list[FloatArray], FloatArray]:
    """Return the rows (n, k + 1) of each of a axes, and their triangular factors without folds.

    The last column of both is the axis's target (a, n), the others are its terms (a, n, k). The
    factors (a (folds + 1), r, k + 1) are those of the first axis, then of the next; of each axis
    without each fold, then of all rows. Where all axes have the same terms, as line and sample do
    unless their weights differ, rows with all targets are factored once.
    """
    axes, _, k = columns.shape
    if (columns == columns[0]).all():
        rows = [np.concatenate([columns[0], target.T], axis=1)] * axes
        factors = [_factors_without_folds(rows[0], fold)] * axes
        target_columns = [k + axis for axis in range(axes)]
    else:
        rows = [np.concatenate([terms_of_axis, target_of_axis[:, None]], axis=1)
                for terms_of_axis, target_of_axis in zip(columns, target, strict=True)]
        factors = [_factors_without_folds(rows_of_axis, fold) for rows_of_axis in rows]
        target_columns = [k] * axes
    # Of rows with the targets of all axes an axis takes its own.
    columns_of_axes = [np.append(np.arange(k), target_column) for target_column in target_columns]
    return ([rows_of_axis[:, columns_of_axis]
             for rows_of_axis, columns_of_axis in zip(rows, columns_of_axes, strict=True)],
            np.concatenate([factors_of_axis[:, :, columns_of_axis] for
                            factors_of_axis, columns_of_axis in
                            zip(factors, columns_of_axes, strict=True)]))


def _factors_without_folds(rows: FloatArray, fold: IntArray) -> FloatArray:
    """Return the triangular factors of the rows without each fold, (folds + 1, r, columns).

    The last factor is that of all rows. `fold` (n,) is the number of each row's fold.
    """
    # R of stacked triangles is R of all their rows: R'R = sum of R_g'R_g. So of many rows, groups
    # of about sqrt(folds) folds are factored once, and a fold needs its group and the other R_g.
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
        repeated = np.broadcast_to(triangle_of_others,
                                   (len(group_folds), *triangle_of_others.shape))
        # Rows of the fold that is left out become zeros.
        stays = fold[in_group] != group_folds[:, None]
        rows_of_group = rows[in_group] * stays[:, :, None]
        triangles[group_folds] = _triangle(np.concatenate([repeated, rows_of_group], axis=1))
    return triangles


def _triangle(rows: FloatArray) -> FloatArray:
    """Return R (..., min(m, k), k) of the decomposition QR of each system of rows (..., m, k)."""
    return np.asarray(np.linalg.qr(rows, mode="r"))


def _selected_terms(systems: FloatArray, equations: FloatArray, forced: int,
                    max_selected: int) -> BoolArray | None:
    """Return masks (s, k) of the terms that s systems select; None if forced ones are dependent.

    The systems (s, r, k + 1) are triangular factors of terms and target; `equations` (s,) is how
    many rows each was made of. The first `forced` terms are always in; at most `max_selected`
    others are selected.
    """
    count = len(systems)
    free = systems.shape[2] - 1 - forced
    lengths = np.linalg.norm(systems[:, :, :-1], axis=1)
    forced_diagonal = np.abs(np.diagonal(systems, axis1=1, axis2=2)[:, :forced])
    if (forced_diagonal <= TOLERANCE * lengths[:, :forced]).any():
        return None
    # No selection leaves less than all terms do, which bounds the criterion for each number of
    # terms.
    counts = np.arange(max(min(max_selected, free - 1), 0) + 1)
    rounding = (ROUNDING * np.linalg.norm(systems[:, :, -1], axis=1)) ** 2
    smallest = np.maximum(rounding, np.finfo(float).tiny)
    # What the criterion adds for the number of terms, (counts, s).
    penalties = np.multiply.outer(forced + counts, np.log(equations)) + np.array(
        [2 * np.log(comb(free, added)) for added in counts.tolist()])[:, None]
    unexplained = np.maximum((systems[:, forced + free:, -1]**2).sum(axis=1), smallest)
    bounds = equations * np.log(unexplained / equations) + penalties
    best = np.zeros((count, free), dtype=bool)
    # What forced terms explain is taken out with the first rows of the triangle.
    _select_terms(systems[:, forced:, forced:].copy(), lengths[:, forced:].copy(), equations,
                  smallest, penalties, bounds, np.zeros_like(best), best, np.empty((2, free)),
                  np.full(count, np.inf))
    return np.concatenate([np.ones((count, forced), dtype=bool), best], axis=1)


@_compiled
def _select_terms(rows: FloatArray, lengths: FloatArray, equations: FloatArray,
                  smallest: FloatArray, penalties: FloatArray, bounds: FloatArray,
                  chosen: BoolArray, best: BoolArray, work: FloatArray,
                  best_value: FloatArray) -> None:
    """Mark in `best` (s, k) the terms of the least criterion on the way of forward selection.

    s systems are worked on side by side, and end together. `rows` (s, r, k + 1) are columns and
    targets without what the forced terms explain; what further terms explain is taken from them, in
    place, as these enter. `lengths` (s, k) are those of the columns before that, `equations` (s,)
    the numbers of equations. `penalties` and `bounds` (counts, s) are by the number of terms added:
    what the criterion adds, and a value that it cannot fall below, as if all terms were in. Sums of
    squares are at least the `smallest` (s,).

    `best` and `chosen` (s, k), the terms that have entered, begin as False, and `best_value` (s,),
    the least criterion, as infinity; `work` (2, k) is scratch.
    """
    # The criterion of n equations with the sum of squares S is n log(S / n) + penalty.
    count, m, width = rows.shape
    k = width - 1
    squares, products = work
    for added in range(len(penalties)):
        settled = True  # whether no more terms can lower any criterion
        exhausted = False  # whether some system has no more terms that are independent
        for s in range(count):
            unexplained = 0.0
            for i in range(m):
                unexplained += rows[s, i, k] * rows[s, i, k]
            unexplained = unexplained if unexplained > smallest[s] else smallest[s]
            value = equations[s] * np.log(unexplained / equations[s]) + penalties[added, s]
            if value < best_value[s]:
                best_value[s] = value
                for j in range(k):
                    best[s, j] = chosen[s, j]
            for later in range(added + 1, len(bounds)):
                settled = settled and best_value[s] < bounds[later, s]
        if settled:
            return
        for s in range(count):
            entering = _entering_term(rows[s], lengths[s], chosen[s], squares, products)
            exhausted = exhausted or entering < 0
            if entering < 0:
                continue
            chosen[s, entering] = True
            _take_out(rows[s], entering, squares[entering], products)
        if exhausted:
            return


@_compiled
def _entering_term(rows: FloatArray, lengths: FloatArray, chosen: BoolArray, squares: FloatArray,
                   gains: FloatArray) -> int:
    """Return the index of the term that explains most of the target of `rows` (r, k + 1), or -1.

    -1 is returned where no term is left that is not in the mask `chosen` (k,) and not dependent on
    those chosen. Among equals, but for rounding, it is the first. `lengths` (k,) are those of the
    columns before any was chosen; `squares` (k,) becomes the sums of squares of the columns as they
    are now; `gains` (k,) is scratch.
    """
    m, width = rows.shape
    k = width - 1
    squares[:] = 0.0
    gains[:] = 0.0
    for i in range(m):
        for j in range(k):
            squares[j] += rows[i, j] * rows[i, j]
            gains[j] += rows[i, j] * rows[i, k]
    # A column c lessens the squares of the target y by (c'y)^2 / c'c. A column of which rounding
    # alone is left depends on the terms that are in.
    most = -1.0
    for j in range(k):
        smallest = TOLERANCE * lengths[j]
        usable = not chosen[j] and squares[j] > smallest * smallest
        gains[j] = gains[j] * gains[j] / squares[j] if usable else -1.0
        most = gains[j] if gains[j] > most else most
    for j in range(k):
        if gains[j] >= 0.0 and gains[j] >= most - ROUNDING * most:
            return j
    return -1


@_compiled
def _take_out(rows: FloatArray, column: int, square: float, products: FloatArray) -> None:
    """Take what a column explains from all columns of `rows` (r, k + 1), in place.

    `square` is its sum of squares; `products` (k,) is scratch.
    """
    # Gram-Schmidt: each column a becomes a - c (c'a) / (c'c), with the column c that enters.
    m, width = rows.shape
    k = width - 1
    products[:] = 0.0
    of_target = 0.0
    for i in range(m):
        for j in range(k):
            products[j] += rows[i, column] * rows[i, j]
        of_target += rows[i, column] * rows[i, k]
    for i in range(m):
        share = rows[i, column] / square
        for j in range(k):
            rows[i, j] -= share * products[j]
        rows[i, k] -= share * of_target


def _errors_of_folds(rows: FloatArray, fold: IntArray, systems: FloatArray,
                     best: BoolArray) -> FloatArray:
    """Return the error of each row (n, k + 1), shape (n,), by the terms selected without its fold.

    Fold f selected the terms `best[f]` from the triangular factors `systems[f]` of all other rows.
    """
    errors = np.empty(len(rows))
    work = np.empty((systems.shape[2], systems.shape[1]))
    _fill_errors_of_folds(rows, fold, systems, best, work, np.empty(systems.shape[2]), errors)
    return errors


@_compiled
def _fill_errors_of_folds(rows: FloatArray, fold: IntArray, systems: FloatArray, best: BoolArray,
                          work: FloatArray, solution: FloatArray, errors: FloatArray) -> None:
    """Fill in the errors (n,) of `_errors_of_folds`; `work` (k + 1, r), `solution` are scratch.

    The least-squares solution of a fold is that of R x = Q'y, with the columns that it selected.
    """
    m = systems.shape[1]
    k = systems.shape[2] - 1
    for f in range(len(best)):
        # The columns selected, and the target after them, as rows.
        count = 0
        for j in range(k + 1):
            if j == k or best[f, j]:
                for i in range(m):
                    work[count, i] = systems[f, i, j]
                count += 1
        count -= 1
        # Reflections make R of them again, as columns between them are missing.
        for j in range(count):
            _reflect_rows(work, j, count + 1)
        # Back substitution.
        for j in range(count - 1, -1, -1):
            solution[j] = work[count, j]
            for later in range(j + 1, count):
                solution[j] -= work[later, j] * solution[later]
            solution[j] /= work[j, j]
        for i in range(len(rows)):
            if fold[i] == f:
                error = rows[i, k]
                number = 0
                for j in range(k):
                    if best[f, j]:
                        error -= rows[i, j] * solution[number]
                        number += 1
                errors[i] = error


@_compiled
def _reflect_rows(vectors: FloatArray, column: int, count: int) -> None:
    """Reflect vectors so that one of them ends at its diagonal entry: a Householder step.

    The vectors are the rows of `vectors`, changed in place. The vector of the number `column` keeps
    the entries before the diagonal; the diagonal becomes its remaining length, and what is after it
    has no meaning. The vectors after it, up to `count`, are reflected with it.
    """
    # w becomes w - f (v'w) v, with f = 2 / v'v for the vector v to be mirrored at.
    v = vectors[column, column:]
    square = 0.0
    for i in range(len(v)):
        square += v[i] * v[i]
    length = -np.sqrt(square) if v[0] > 0.0 else np.sqrt(square)
    v[0] -= length  # away from 0, so that nothing cancels
    factor = -1.0 / (length * v[0]) if square > 0.0 else 0.0
    for later_column in range(column + 1, count):
        w = vectors[later_column, column:]
        total = 0.0
        for i in range(len(v)):
            total += v[i] * w[i]
        for i in range(len(v)):
            w[i] -= factor * total * v[i]
    v[0] = length
