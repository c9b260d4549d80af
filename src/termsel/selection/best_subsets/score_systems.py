"""A system of equations, arranged for the enumeration of all subsets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from termsel.adjustment.compiled import is_compiled
from termsel.adjustment.solve import TOLERANCE
from termsel.core.errors import TermselError, unknown_name_error
from termsel.data.features import BoolArray, FloatArray, IntArray
from termsel.selection.best_subsets.bounds.branch import decide_branch
from termsel.selection.best_subsets.bounds.check_errors import decide_block
from termsel.selection.best_subsets.bounds.closed import first_closed_by_parts
from termsel.selection.best_subsets.bounds.held_out import held_out_lower_bound
from termsel.selection.best_subsets.bounds.poles import node_bound
from termsel.selection.best_subsets.bounds.residuals import branch_residuals
from termsel.selection.best_subsets.bounds.shares import largest_denominator_shares
from termsel.selection.best_subsets.bounds.trees import BOUND_ROUNDING, Tree, tree_of
from termsel.selection.best_subsets.columns.arrays import (
    CheckSpace,
    Limits,
    Records,
    Vectors,
    allocate_check_space,
    position_of,
    vectors_of,
)
from termsel.selection.best_subsets.columns.kernels import (
    LINEAR,
    PRESS,
    RATIONAL,
    RSS,
    enumerate_subsets,
)
from termsel.selection.best_subsets.columns.reduction import (
    fewer_rows,
    order_by_gain,
    order_by_halves,
    triangle_of,
)
from termsel.selection.best_subsets.columns.system import (
    BITS,
    SCORES,
    Masks,
    NodeResult,
    SubsetSystem,
    SubtreeNode,
)

WALKED = 1 << 18
"""Subsets that are enumerated in some hundredths of a second: bounds take longer to compile."""

PROGRAMMED = 1 << 24
"""Subsets for which linear programs pay, which take some milliseconds a check point."""

_ENUMERATED = 300  # subsets that cost less than bounds of their residuals
_PROGRAMS = 100  # most check points with linear programs: each takes one, of all points
_BOUND_HALVINGS = 7  # of the interval in which a bound lies: less than a per cent is left
_TIE = 1e-9  # relative difference of scores that may be equal but for rounding


@dataclass(frozen=True, eq=False)
class ScoreRows:
    """The rows of one least-squares system: a column for each of k terms, then r targets.

    All are scaled coordinates, without a unit.
    """

    control: FloatArray  # (m, k + r): rows of the adjustment
    extra: FloatArray  # (e, k + r): rows that take part, as in `Vectors`
    guard: FloatArray  # (g, k + r): denominators at the guard points

    @cached_property
    def lengths(self) -> FloatArray:
        """Lengths of the control columns, shape (k + r,)."""
        return np.asarray(np.linalg.norm(self.control, axis=0))


@dataclass(frozen=True, eq=False)
class ScoreSystems:
    """What scores a subset of k columns: one system, or one for each fold, solved in lockstep.

    The score of a subset is a sum of squares over all systems; branch and bound asks for a lower
    bound of it over all subsets of a node.
    """

    kind: int  # of score: see `columns.kernels`
    k: int  # columns
    systems: list[ScoreRows]  # the first has all rows of the adjustment
    margin: float  # least denominator
    some_of: np.uint64  # as in `Records`
    parents: Masks  # as in `Records`
    everything: SubtreeNode
    times_held_out: int = 1  # of each row, or more

    @property
    def branches(self) -> bool:
        """Whether subsets are decided by branch and bound."""
        if self.holds_out:
            return True
        if not self._has_bounds or self.kind == PRESS:
            return False
        if self.kind == RSS:
            return True
        # Bounds of check points' errors are of one system with one target. With denominators they
        # need a positive margin: it is what keeps t = 1 / (sum of denominators) finite.
        one_target = self.systems[0].control.shape[1] == self.k + 1
        return (len(self.systems) == 1 and one_target
                and (self.kind != RATIONAL or self.margin > 0.0))

    @cached_property
    def holds_out(self) -> bool:
        """Whether bounds decide scores that are held-out errors without denominators, of every row.
        """
        if not self._has_bounds:
            return False
        if self.kind == PRESS:
            # Rows [denominator, -1]: all zero but for the targets where there is no denominator.
            return not self.systems[0].extra[:, :self.k].any()
        # A row that is in no fold is never held out: its residual must not count in the bound.
        return self.kind == LINEAR and len(self.systems) > 1 and self.times_held_out > 0

    @property
    def _has_bounds(self) -> bool:
        return self.everything.count > WALKED

    @property
    def needs_compilation(self) -> bool:
        """Whether the first branch spends a while on compilation, once per machine and version."""
        return self.branches and not self.holds_out and not is_compiled(
            branch_residuals if self.kind == RSS else decide_block)

    @cached_property
    def _targets(self) -> IntArray:
        return np.arange(self.k, self.systems[0].control.shape[1])

    @cached_property
    def _slack(self) -> float:
        """Rounding error to allow in a residual sum of squares."""
        return 1e-13 * self.largest

    @property
    def largest(self) -> float:
        """No residual sum of squares is larger."""
        return float((self.systems[0].control[:, self.k:] ** 2).sum())

    @property
    def starts(self) -> list[SubtreeNode]:
        """Nodes of one subset each, of every size: first incumbents, without which no bound prunes.
        """
        if self.kind != RSS:
            return []
        used = self.everything.used
        candidates = self.everything.candidates
        return [SubtreeNode(np.concatenate([used, candidates[:n]]), candidates[:0], 0)
                for n in range(self.everything.room + 1)]

    def trimmed(self, node: SubtreeNode, best: FloatArray) -> SubtreeNode:
        """Return a node with only as much room as a best subset of it may need; -1 if it has none.

        `best` (k + 1,) are the least scores so far of each size.
        """
        if self.kind != RSS:
            return node
        smallest = len(node.used)
        room = min(node.room, len(node.candidates))
        # Residuals fall as columns join: only the largest sizes can be cut off. Ties within
        # rounding stay, as of two equal scores the smaller mask counts.
        reachable = best[smallest:smallest + room + 1] * (1.0 + _TIE) + self._slack
        open_rooms = np.flatnonzero(node.lower_bound <= reachable)
        return replace(node, room=int(np.append(-1, open_rooms)[-1]))

    def walk(self, node: SubtreeNode, best: FloatArray, masks: Masks) -> NodeResult:
        """Decide the subsets of a node, given the best ones so far.

        `best` (s,) are the least scores so far of each size, `masks` their subsets, both copied.
        Which kernel walks the subtree depends on the criterion and on whether branches may be cut
        by bounds. Returns the scores and masks after it, and how many subsets were excluded without
        being fitted. If the columns in use depend on each other, no subset has a score: they are
        those given, and the number is 0.
        """
        if self.kind == RSS and self.branches and node.count > _ENUMERATED:
            return self._walk_residuals(node, best.copy(), masks.copy())
        prepared = self._vectors_of_node(node)
        if prepared is None:
            return NodeResult(best, masks, 0)
        vectors, limits, guard = prepared
        depths, _, height, rows = vectors.top.shape
        n = len(node.candidates)
        best = best.copy()
        masks = masks.copy()
        # The bit of each candidate, and none for column n, which stands for no column.
        bits = np.append(BITS[node.candidates], np.uint64(0))
        records = Records(best=best, masks=masks, bits=bits, some_of=np.array([self.some_of]),
                          parents=self.parents, guard=guard, x=np.empty(depths),
                          sums=np.empty(guard.shape[1]))
        position = position_of(depths, BITS[node.used].sum(), _counts_of_subsets(n, limits.room))
        # Which kernel: bounds of held-out errors, bounds of check errors, or each subset by itself.
        pruned = 0
        if self.holds_out:
            pruned = decide_branch(self.kind, vectors, limits, records, position, check=None,
                                   work=np.empty((height, rows)))
        elif self.branches and self.kind != RSS:
            pruned = decide_branch(self.kind, vectors, limits, records, position,
                                   check=self._space(vectors), work=None)
        else:
            one_target = vectors.share[0].size == n + 1
            enumerate_subsets(self.kind, vectors, limits, records, position,
                              single=None if one_target else False,
                              press=True if self.kind == PRESS else None)
        return NodeResult(best, masks, pruned)

    def _walk_residuals(self, node: SubtreeNode, best: FloatArray, masks: Masks) -> NodeResult:
        """Decide the subsets of a node by branch and bound of residuals.

        `best` (k + 1,) are the least scores found so far of each size, and `masks` their subsets;
        both are overwritten by what is better. The result counts the subsets that bounds ruled out.
        """
        columns = np.concatenate([node.used, node.candidates])
        k = len(columns)
        used = len(node.used)
        tree, guard = self._tree(node)
        records = Records(best=best, masks=masks, bits=BITS[columns],
                          some_of=np.array([self.some_of]), parents=self.parents, guard=guard,
                          x=np.empty(k + 1), sums=np.empty(len(self.systems[0].guard)))
        limits = Limits(self.margin, TOLERANCE, 0.0, self._slack, used, min(node.room, k - used))
        enumerated = branch_residuals(tree, limits, records, _counts_of_subsets(k, k), _ENUMERATED,
                                      None if len(self._targets) == 1 else False)
        return NodeResult(best, masks, node.count - enumerated)

    def _tree(self, node: SubtreeNode) -> tuple[Tree, FloatArray]:
        """Return the root of a node, and the guard's denominators of its columns and target."""
        columns = np.concatenate([node.used, node.candidates])
        rows = self.systems[0]
        return tree_of(rows.control[:, np.concatenate([columns, self._targets])],
                       rows.guard[:, np.append(columns, self._targets[0])], rows.lengths[columns],
                       self.margin, len(node.used))

    def bounded(self, node: SubtreeNode, best: FloatArray) -> SubtreeNode:
        """Return a node with a lower bound of the scores of its subsets, not below the one it has.

        `best` (k + 1,) are the least scores so far of each size. A bound of other scores than
        residuals is at most the least of them, which a node without any feasible subset has, too.
        """
        incumbent = float(best.min())
        if not self.branches or not 0.0 < incumbent < np.inf or (
                node.lower_bound >= incumbent and self.kind != RSS):
            return node
        if self.kind == RSS:
            return replace(node, lower_bound=max(node.lower_bound, self._rss_bound(node, best)))
        # Columns in use that depend on each other are part of every subset, which has no score.
        prepared = self._vectors_of_node(node)
        if prepared is None:
            return replace(node, lower_bound=incumbent)
        vectors, limits, _ = prepared
        if self.holds_out:
            bound = min(incumbent, held_out_lower_bound(vectors))
        else:
            bound = min(self._descendants_bound(node, vectors, limits, incumbent),
                        self._score_of_used_columns(node, vectors, limits))
        return replace(node, lower_bound=max(node.lower_bound, bound))

    def _rss_bound(self, node: SubtreeNode, best: FloatArray) -> float:
        """Return a lower bound of the residual sums of squares of all subsets of a node."""
        smallest = len(node.used)
        # A bound above the worst of the best sums of squares prunes every size: more is not worth
        # its time. BOUND_ROUNDING (relative) and _slack (absolute) are above its rounding.
        best_of_sizes = best[smallest:smallest + min(node.room, len(node.candidates)) + 1]
        limit = float(best_of_sizes[np.isfinite(best_of_sizes)].max(initial=0.0))
        tree, _ = self._tree(node)
        bound = node_bound(tree, 0, limit)
        return bound * (1.0 - BOUND_ROUNDING) - self._slack

    def _descendants_bound(self, node: SubtreeNode, vectors: Vectors, limits: Limits,
                           incumbent: float) -> float:
        """Return a lower bound of the scores of all subsets with more columns than those in use.

        `first_closed_by_parts` shows only whether all of them score more than some value: bisection
        finds the largest such value, at most the incumbent's score.
        """
        n = len(node.candidates)
        space = self._space(vectors)
        upper = space.upper[0].copy()

        def all_score_more(value: float) -> bool:
            limit = value + limits.slack - limits.offset
            return limit <= 0.0 or first_closed_by_parts(
                vectors.top[0, 0], vectors.extra[0, 0], 0, n, limit=limit, upper=upper.copy(),
                rational=self.kind == RATIONAL, space=space.bound) == 0

        if not n or all_score_more(incumbent):
            return incumbent
        low = node.lower_bound
        high = incumbent
        # Halved by its root, which is an RMSE but for a factor.
        for _ in range(_BOUND_HALVINGS):
            middle = ((low**0.5 + high**0.5) / 2)**2
            if all_score_more(middle):
                low = middle
            else:
                high = middle
        return low

    def _score_of_used_columns(self, node: SubtreeNode, vectors: Vectors, limits: Limits) -> float:
        """Return the score of the columns in use alone; infinite with a denominator too small."""
        # Row n is the target: the errors of the check points without more columns.
        target = vectors.extra[0, 0, len(node.candidates)]
        return limits.offset + float(self.score_of_errors(target))

    def score_of_errors(self, errors: FloatArray) -> FloatArray:
        """Return the scores (...) of models by their errors at the e check points.

        Parameters
        ----------
        errors : ndarray, shape (..., e) or (..., 2 e)
            Of a linear model e errors r: its score is sum r_i^2. Of a rational one the numerators r
            of its e errors, then their denominators d with the sign turned: its score is
            sum (r_i / d_i)^2, infinite if any d_i is below the margin.
        """
        if self.kind != RATIONAL:
            return np.asarray((errors**2).sum(axis=-1))
        e = errors.shape[-1] // 2
        # d = 1 + sum x_j d_j is solved for like an error: of the target -1 the columns leave -d.
        denominators = -errors[..., e:]
        too_small = denominators < self.margin
        quotients = errors[..., :e] / np.where(too_small, 1.0, denominators)
        return np.where(too_small.any(axis=-1), np.inf, (quotients**2).sum(axis=-1))

    def _space(self, vectors: Vectors) -> CheckSpace:
        """Return the work space of vectors at check points."""
        depths, _, height, _ = vectors.top.shape
        # Without denominators U and tau are 1.
        upper = self._largest if self.kind == RATIONAL else np.ones(vectors.extra.shape[3] + 1)
        return allocate_check_space(depths, height - 1, upper)

    @cached_property
    def _largest(self) -> FloatArray:
        """U and tau of `bounds.closed` for all subsets, (c + 1,)."""
        rows = self.systems[0]
        columns = np.concatenate([self.everything.used, self.everything.candidates])
        c = len(rows.extra) // 2
        if self.everything.count > PROGRAMMED and c <= _PROGRAMS:
            return largest_denominator_shares(
                rows.extra[c:, columns], rows.guard[:, columns], self.margin)
        # No positive denominator is above its sum with the others, and that not below the least.
        return np.append(np.ones(c), 1.0 / (self.margin * c))

    def _vectors_of_node(self, node: SubtreeNode) -> tuple[Vectors, Limits, FloatArray] | None:
        """Return a node's vectors, its limits, and the denominators (n + r, g) at guard points.

        Returns None if the columns in use depend on each other. What they explain is taken out of
        the later ones, the n candidates and r targets, by LAPACK. With the factor R of
        [used, later] in blocks [[R_uu, R_ul], [0, R_ll]], the later columns without it have the
        inner products of R_ll, which has fewer rows.
        """
        used = node.used
        n = len(node.candidates)
        p = len(used)
        room = min(n, node.room)
        later = np.concatenate([node.candidates, self._targets])
        # Column n, which is none, keeps the floor 0: it is never dependent.
        floor = np.zeros((len(self.systems), n + 1))
        for f, rows in enumerate(self.systems):
            floor[f, :n] = (TOLERANCE * rows.lengths[node.candidates]) ** 2
        tops: list[FloatArray] = []
        extras = []
        guards = []
        leverage = cross = np.zeros(0)
        offset = 0.0
        for rows in self.systems:
            q, R = np.linalg.qr(rows.control[:, np.concatenate([used, later])])
            R_uu = R[:p, :p]
            if len(R) < p or (np.abs(np.diag(R)[:p]) <= TOLERANCE * rows.lengths[used]).any():
                return None
            # Other rows are freed of the columns in use by the same coefficients, R_uu^-1 R_ul.
            coefficients = np.linalg.solve(R_uu, R[:p, p:])
            extra = rows.extra[:, later] - rows.extra[:, used] @ coefficients
            guard = rows.guard[:, later] - rows.guard[:, used] @ coefficients
            if self.kind == PRESS:  # not rotated, as each row is held out
                top = q[:, p:] @ R[p:, p:]
                q_u = q[:, :p]
                # h_i = |q_i|^2, and g_i = q_i' R_uu^-T d_i with the denominator's row d.
                leverage = (q_u**2).sum(axis=1)
                cross = (q_u * np.linalg.solve(R_uu.T, rows.extra[:, used].T).T).sum(axis=1)
            elif self.holds_out and not tops:
                # Bounds of held-out errors are of all residuals, those of no column included.
                top = R[p:, p:]
                leverage = cross = np.zeros(len(top))
            else:
                top = R[p:p + n, p:]
            # Below the triangle of all columns are targets alone: that part no subset changes.
            if self.kind == RSS:
                offset += float((R[p + n:, p + n:] ** 2).sum())
            if self.kind == LINEAR:
                extra, squares_below = triangle_of(extra, n)
                offset += squares_below
            tops.append(top)
            extras.append(extra[:0] if self.kind == PRESS and self.holds_out else extra)
            guards.append(guard)
        vectors = vectors_of(tops, extras, floor, leverage, cross, max(room, 1))
        limits = Limits(self.margin, TOLERANCE, offset, self._slack, p, room)
        return vectors, limits, np.ascontiguousarray(guards[0].T)


@cache  # a table without data
def _counts_of_subsets(columns: int, room: int) -> IntArray:
    """Return the number of subsets of 0 to `columns` with at most 0 to `room` members.

    Either the last column is in a subset or it is not: N(n, m) = N(n - 1, m) + N(n - 1, m - 1).
    """
    counts = np.ones((columns + 1, room + 1), dtype=np.intp)
    for n in range(1, columns + 1):
        counts[n, 1:] = counts[n - 1, 1:] + counts[n - 1, :-1]
    return counts


def score_systems(system: SubsetSystem, score: str, folds: Sequence[IntArray],
                  max_terms: int | None) -> ScoreSystems:
    """Return the systems of rows by which a walk scores the subsets of a system's columns.

    `score` is one of SCORES, such as "press". `folds` are the indices of the rows that "kfold"
    holds out together. `max_terms` is the most columns in use, None for all. Raises TermselError
    for an unknown score, where terms are both forced and forbidden, and where more are forced than
    `max_terms`; ValueError for the score check without rows of selection points, and for kfold
    without folds.
    """
    if score not in SCORES:
        raise unknown_name_error("score", score, SCORES)
    k = system.design.shape[1]
    forced = _mask_or_no_column(system.forced, k)
    forbidden = _mask_or_no_column(system.forbidden, k)
    some_of = _mask_or_no_column(system.some_of, k)
    if (forced & forbidden).any():
        raise TermselError(f"{int((forced & forbidden).sum())} terms are both forced and forbidden")
    used = np.flatnonzero(forced)
    candidates = np.flatnonzero(~forced & ~forbidden)
    if max_terms is not None and max_terms < len(used):
        raise TermselError(f"{len(used)} terms are forced, but at most {max_terms} may be in use",
                           hint="Force fewer terms or increase the limit.")
    rational = (system.check_denominator if score == "check" else system.denominator) is not None
    kind = {"rss": RSS, "press": PRESS}.get(score, RATIONAL if rational else LINEAR)
    systems, times_held_out = _rows_of_systems(system, score, kind, folds)
    # Bounds close a branch at its first column, so that the order decides how soon.
    if score != "check":
        control = np.column_stack([system.design, system.target])
        candidates = order_by_gain(control, used, candidates, k)
    elif rational:
        below = _denominator_rows(system.denominator, system.design, k)
        candidates = order_by_halves(candidates, np.asarray(below[:, :k].any(axis=0)))
    room = len(candidates)
    if max_terms is not None:
        room = min(room, max_terms - len(used))
    parents = np.zeros((0, k), dtype=bool) if system.parents is None else system.parents
    parent_masks = np.where(parents, BITS[:k], np.uint64(0)).sum(axis=1, dtype=np.uint64)
    return ScoreSystems(kind, k, systems, margin=float(system.margin),
                        some_of=BITS[:k][some_of].sum(), parents=parent_masks,
                        everything=SubtreeNode(used, candidates, room),
                        times_held_out=times_held_out)


def _mask_or_no_column(mask: BoolArray | None, k: int) -> BoolArray:
    """Return a mask of k columns, (k,); without one, no column is in it."""
    return np.zeros(k, dtype=bool) if mask is None else np.asarray(mask, dtype=bool)


def _rows_of_systems(system: SubsetSystem, score: str, kind: int,
                     folds: Sequence[IntArray]) -> tuple[list[ScoreRows], int]:
    """Return the rows of all systems of a score, and how often each row is held out at least.

    The first system has all rows of control. For "kfold" each fold has a further system, of the
    rows that are not in the fold. `kind` is how errors follow from coefficients (RSS, PRESS, LINEAR
    or RATIONAL). The number is 1 for scores other than "kfold".

    Raises ValueError for the score check without rows of selection points, and for kfold without
    folds.
    """
    k = system.design.shape[1]
    control = np.column_stack([system.design, system.target])
    guard = _denominator_rows(system.guard_denominator, control[:0], k)
    denominators = _denominator_rows(system.denominator, control, k)
    times_held_out = 1
    every_row = np.ones(len(control), dtype=bool)
    # Of each system: its rows of control, rows of errors, and their denominators.
    adjustments = [(every_row, control[:0], denominators[:0])]
    if score == "check":
        if system.check_design is None or system.check_target is None:
            raise ValueError("score 'check' requires check_design and check_target")
        errors = np.column_stack([system.check_design, system.check_target])
        adjustments = [(every_row, errors, _denominator_rows(system.check_denominator, errors, k))]
    elif score == "kfold":
        if not len(folds):
            raise ValueError("score 'kfold' requires folds")
        # The whole system takes part: for its rank and its coefficients at the guard points. The
        # squares of its residuals count as often as each row is held out.
        times_held_out = int(np.bincount(np.concatenate(folds), minlength=len(control)).min())
        for fold in folds:
            in_use = every_row.copy()
            in_use[fold] = False
            adjustments.append((in_use, control[~in_use], denominators[~in_use]))
    height = max(len(errors) for _, errors, _ in adjustments)
    systems = []
    for in_use, errors, error_denominators in adjustments:
        if kind == RATIONAL:  # made equally high by rows without error
            blank = np.zeros((height - len(errors), control.shape[1]))
            extra = np.concatenate([errors, blank, error_denominators,
                                    _denominator_rows(None, blank, k)])
        else:
            extra = denominators if kind == PRESS else errors
        # A scaled system has the same solutions; its residuals are those of the bound.
        weight = times_held_out**0.5 if in_use is every_row and times_held_out else 1.0
        systems.append(ScoreRows(
            control if kind == PRESS else fewer_rows(weight * control[in_use]),
            fewer_rows(extra) if kind == LINEAR else extra,
            guard if in_use is every_row else guard[:0]))
    return systems, times_held_out


def _denominator_rows(linear: FloatArray | None, rows: FloatArray, k: int) -> FloatArray:
    """Return rows [denominator, -1 of each target] (m, k + r) for the k columns and r targets.

    The target's entry less those of the columns times their coefficients x is -(1 + `linear` x),
    minus the denominator. Without `linear` (m, k) there are as many rows as `rows` (m, k + r) has,
    of the constant denominator 1.
    """
    if linear is None:
        denominators = np.zeros((len(rows), rows.shape[1]))
    else:
        denominators = np.zeros((len(linear), rows.shape[1]))
        denominators[:, :k] = linear
    denominators[:, k:] = -1.0
    return denominators
