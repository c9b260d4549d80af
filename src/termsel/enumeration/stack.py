"""A system of equations, arranged for the enumeration of all subsets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from termsel.adjustment.compiled import is_compiled
from termsel.adjustment.solve import TOLERANCE
from termsel.enumeration.bounds.branch import branch
from termsel.enumeration.bounds.check_errors import decide_block
from termsel.enumeration.bounds.closed import first_closed
from termsel.enumeration.bounds.held_out import least_held_out
from termsel.enumeration.bounds.poles import node_bound
from termsel.enumeration.bounds.residuals import branch_residuals
from termsel.enumeration.bounds.shares import largest_shares
from termsel.enumeration.bounds.trees import ROUNDING, Tree, tree_of
from termsel.enumeration.columns.arrays import (
    CheckSpace,
    Limits,
    Records,
    Vectors,
    check_space,
    place_of,
    vectors_of,
)
from termsel.enumeration.columns.kernels import LINEAR, PRESS, RATIONAL, RSS, walk
from termsel.enumeration.columns.reduction import by_gain, by_halves, fewer_rows, triangle_of
from termsel.enumeration.columns.system import BITS, SCORES, Masks, Piece, SubsetSystem, Walked
from termsel.errors import TermselError, unknown_name
from termsel.measurements.features import FloatArray, IntArray

WALKED = 1 << 18
"""Subsets that are enumerated in some hundredths of a second: bounds take longer to compile."""

PROGRAMMED = 1 << 24
"""Subsets for which linear programs pay, which take some milliseconds a check point."""

_ENUMERATED = 300  # subsets that cost less than bounds of their residuals
_PROGRAMS = 100  # most check points with linear programs: each takes one, of all points
_HALVINGS = 7  # of the interval in which a bound lies: less than a per cent of the RMSE is left


@dataclass(frozen=True, eq=False)
class ScoreRows:
    """Rows of one system, by column and, at the end, target."""

    control: FloatArray  # (m, k + r): rows of the adjustment
    extra: FloatArray  # (e, k + r): rows that take part, as in `Vectors`
    guard: FloatArray  # (g, k + r): denominators at the guard points

    @cached_property
    def lengths(self) -> FloatArray:
        """Lengths of the control columns, shape (k + r,)."""
        return np.asarray(np.linalg.norm(self.control, axis=0))


@dataclass(frozen=True, eq=False)
class Stack:
    """The systems of a score, in lockstep, and the columns to choose from."""

    kind: int  # of score: see `columns.kernels`
    k: int  # columns
    systems: list[ScoreRows]  # the first has all rows of the adjustment
    margin: float  # least denominator
    some_of: np.uint64  # as in `Records`
    parents: Masks  # as in `Records`
    everything: Piece
    times: int = 1  # that each row is held out, or more

    @property
    def branches(self) -> bool:
        """Whether subsets are decided by branch and bound."""
        return self.holds_out or (self._bounded and (self.kind == RSS or (
            self.kind != PRESS and len(self.systems) == 1
            and (self.kind != RATIONAL or self.margin > 0.0)
            and self.systems[0].control.shape[1] == self.k + 1)))

    @cached_property
    def holds_out(self) -> bool:
        """Whether bounds decide scores that are held-out errors without denominators, of every row.
        """
        return self._bounded and (
            (self.kind == LINEAR and len(self.systems) > 1 and self.times > 0)
            or (self.kind == PRESS and not self.systems[0].extra[:, :self.k].any()))

    @property
    def _bounded(self) -> bool:
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
    def starts(self) -> list[Piece]:
        """Single subsets, each a candidate for the best of its size: bounds need some."""
        if self.kind != RSS:
            return []
        used, rest, room = self.everything.used, self.everything.rest, self.everything.room
        return [Piece(np.concatenate([used, rest[:n]]), rest[:0], 0) for n in range(room + 1)]

    def trimmed(self, piece: Piece, best: FloatArray) -> Piece:
        """Return the part of a piece that may still have a best subset, if any."""
        if self.kind != RSS:
            return piece
        size, room = len(piece.used), min(piece.room, len(piece.rest))
        open_ = piece.least <= best[size:size + room + 1] * (1.0 + 1e-9) + self._slack
        return replace(piece, room=int(np.append(-1, np.flatnonzero(open_))[-1]))

    def walk(self, piece: Piece, best: FloatArray, masks: Masks) -> Walked:
        """Decide the subsets of a piece, given the best ones so far."""
        if self.kind == RSS and self.branches and piece.count > _ENUMERATED:
            return self._walk_residuals(piece, best.copy(), masks.copy())
        prepared = self._prepared(piece)
        if prepared is None:
            return Walked(best, masks, 0)
        vectors, limits, guard = prepared
        depths, _, height, rows = vectors.top.shape
        n = len(piece.rest)
        best, masks = best.copy(), masks.copy()
        records = Records(best, masks, np.append(BITS[piece.rest], np.uint64(0)),
                          np.array([self.some_of]), self.parents, guard, np.empty(depths),
                          np.empty(guard.shape[1]))
        place = place_of(depths, BITS[piece.used].sum(), _counts(n, limits.room))
        pruned = 0
        if self.holds_out:
            pruned = branch(self.kind, vectors, limits, records, place, None,
                            np.empty((height, rows)))
        elif self.branches and self.kind != RSS:
            pruned = branch(self.kind, vectors, limits, records, place, self._space(vectors), None)
        else:
            walk(self.kind, vectors, limits, records, place,
                 None if vectors.share[0].size == n + 1 else False,
                 True if self.kind == PRESS else None)
        return Walked(best, masks, pruned)

    def _walk_residuals(self, piece: Piece, best: FloatArray, masks: Masks) -> Walked:
        columns = np.concatenate([piece.used, piece.rest])
        k, used, rows = len(columns), len(piece.used), self.systems[0]
        tree, guard = self._tree(piece)
        records = Records(best, masks, BITS[columns], np.array([self.some_of]), self.parents,
                          guard, np.empty(k + 1), np.empty(len(rows.guard)))
        limits = Limits(self.margin, TOLERANCE, 0.0, self._slack, used, min(piece.room, k - used))
        enumerated = branch_residuals(tree, limits, records, _counts(k, k), _ENUMERATED,
                                      None if len(self._targets) == 1 else False)
        return Walked(best, masks, piece.count - enumerated)

    def _tree(self, piece: Piece) -> tuple[Tree, FloatArray]:
        """Return the root of a piece, and the guard's denominators of its columns and target."""
        columns, rows = np.concatenate([piece.used, piece.rest]), self.systems[0]
        return tree_of(rows.control[:, np.concatenate([columns, self._targets])],
                       rows.guard[:, np.append(columns, self._targets[0])], rows.lengths[columns],
                       self.margin, len(piece.used))

    def bounded(self, piece: Piece, best: FloatArray) -> Piece:
        """Return a piece with a lower bound of the scores of its subsets.

        The bound is not below the piece's own. If not of residuals, it is at most the best score so
        far; a piece without any subset that has a score has that best score too.
        """
        lowest = float(best.min())
        if not self.branches or not 0.0 < lowest < np.inf or (
                piece.least >= lowest and self.kind != RSS):
            return piece
        if self.kind == RSS:
            size = len(piece.used)
            of_sizes = best[size:size + min(piece.room, len(piece.rest)) + 1]
            limit = float(of_sizes[np.isfinite(of_sizes)].max(initial=0.0))
            return replace(piece, least=max(piece.least, node_bound(
                self._tree(piece)[0], 0, limit) * (1.0 - ROUNDING) - self._slack))
        prepared = self._prepared(piece)
        if prepared is None:
            return replace(piece, least=lowest)
        vectors, limits, _ = prepared
        if self.holds_out:
            return replace(piece, least=max(piece.least, min(lowest, least_held_out(vectors))))
        n, space = len(piece.rest), self._space(vectors)
        errors = vectors.extra[0, 0]
        largest = space.upper[0].copy()

        def above(value: float) -> bool:
            """Return whether all subsets with more columns score more."""
            limit = value + limits.slack - limits.offset
            return limit <= 0.0 or first_closed(
                vectors.top[0, 0], errors, 0, n, limit, largest.copy(), self.kind == RATIONAL,
                space.bound) == 0

        low, high = piece.least, lowest
        if not n or above(lowest):
            low = lowest
        # Halved by its root, which is an RMSE but for a factor.
        for _ in range(_HALVINGS if low < lowest else 0):
            middle = ((low**0.5 + high**0.5) / 2)**2
            low, high = (middle, high) if above(middle) else (low, middle)
        # The bound is of subsets with more columns; that of those in use alone is known.
        half = len(largest) - 1
        below = -errors[n, half:] if self.kind == RATIONAL else np.ones(half)
        own = limits.offset + float(((errors[n, :half] / below) ** 2).sum())
        if (below < self.margin).any():
            own = np.inf
        return replace(piece, least=max(piece.least, min(low, own)))

    def _space(self, vectors: Vectors) -> CheckSpace:
        depths, _, height, _ = vectors.top.shape
        largest = self._largest if self.kind == RATIONAL else np.ones(vectors.extra.shape[3] + 1)
        return check_space(depths, height - 1, largest)

    @cached_property
    def _largest(self) -> FloatArray:
        """U and tau of `bounds.closed` for all subsets."""
        rows, open_ = self.systems[0], np.concatenate([self.everything.used, self.everything.rest])
        c = len(rows.extra) // 2
        if self.everything.count > PROGRAMMED and c <= _PROGRAMS:
            return largest_shares(rows.extra[c:, open_], rows.guard[:, open_], self.margin)
        # No positive denominator is above its sum with the others, and that not below the least.
        return np.append(np.ones(c), 1.0 / (self.margin * c))

    def _prepared(self, piece: Piece) -> tuple[Vectors, Limits, FloatArray] | None:
        """Return the vectors of a piece, or None if the columns in use are dependent.

        They are taken out here, by LAPACK; what is left needs fewer rows.
        """
        n, used, p = len(piece.rest), piece.used, len(piece.used)
        room = min(n, piece.room)
        kept = np.concatenate([piece.rest, self._targets])
        tops: list[FloatArray] = []
        extras, guards = [], []
        floor = np.zeros((len(self.systems), n + 1))
        leverage = cross = np.zeros(0)
        offset = 0.0
        for rows, least in zip(self.systems, floor, strict=True):
            # Column n, which is none, keeps the floor 0: it is never dependent.
            least[:n] = (TOLERANCE * rows.lengths[piece.rest]) ** 2
            q, triangle = np.linalg.qr(rows.control[:, np.concatenate([used, kept])])
            if len(triangle) < p or (
                    np.abs(np.diag(triangle)[:p]) <= TOLERANCE * rows.lengths[used]).any():
                return None
            # Other rows are freed of the columns in use by the same coefficients.
            share = np.linalg.solve(triangle[:p, :p], triangle[:p, p:])
            extra, guard = (part[:, kept] - part[:, used] @ share
                            for part in (rows.extra, rows.guard))
            if self.kind == PRESS:  # not rotated, as each row is held out
                top, q = q[:, p:] @ triangle[p:, p:], q[:, :p]
                leverage = (q**2).sum(axis=1)
                cross = (q * np.linalg.solve(triangle[:p, :p].T, rows.extra[:, used].T).T).sum(
                    axis=1)
            else:
                # Bounds of held-out errors are of all residuals, those of no column included.
                whole = self.holds_out and not tops
                top = triangle[p:, p:] if whole else triangle[p:p + n, p:]
                if whole:
                    leverage = cross = np.zeros(len(top))
            # Below the triangle of all columns are targets alone: that part no subset changes.
            if self.kind == RSS:
                offset += float((triangle[p + n:, p + n:] ** 2).sum())
            if self.kind == LINEAR:
                extra, rest = triangle_of(extra, n)
                offset += rest
            tops.append(top)
            extras.append(extra[:0] if self.kind == PRESS and self.holds_out else extra)
            guards.append(guard)
        vectors = vectors_of(tops, extras, floor, leverage, cross, max(room, 1))
        limits = Limits(self.margin, TOLERANCE, offset, self._slack, len(used), room)
        return vectors, limits, np.ascontiguousarray(guards[0].T)


@cache
def _counts(columns: int, room: int) -> IntArray:
    """Return the number of subsets of 0 to `columns` with at most 0 to `room` members."""
    counts = np.ones((columns + 1, room + 1), dtype=np.intp)
    for n in range(1, columns + 1):
        counts[n, 1:] = counts[n - 1, 1:] + counts[n - 1, :-1]
    return counts


def stack(system: SubsetSystem, score: str, folds: Sequence[IntArray],
          max_terms: int | None) -> Stack:
    """Return the systems of a score (see `subsets.search` for what it raises)."""
    if score not in SCORES:
        raise unknown_name("score", score, SCORES)
    k = system.design.shape[1]
    forced, barred, some_of = (
        np.zeros(k, dtype=bool) if mask is None else np.asarray(mask, dtype=bool)
        for mask in (system.forced, system.forbidden, system.some_of))
    if (forced & barred).any():
        raise TermselError(f"{int((forced & barred).sum())} terms are both forced and forbidden")
    used, free = np.flatnonzero(forced), np.flatnonzero(~forced & ~barred)
    if max_terms is not None and max_terms < len(used):
        raise TermselError(f"{len(used)} terms are forced, but at most {max_terms} may be in use",
                           hint="Force fewer terms or increase the limit.")
    control, times = np.column_stack([system.design, system.target]), 1
    guard = _below(system.guard_denominator, control[:0], k)
    below = _below(system.denominator, control, k)
    rational = (system.check_denominator if score == "check" else system.denominator) is not None
    kind = {"rss": RSS, "press": PRESS}.get(score, RATIONAL if rational else LINEAR)
    everyone = np.ones(len(control), dtype=bool)
    if score == "check":
        if system.check_design is None or system.check_target is None:
            raise ValueError("score 'check' requires check_design and check_target")
        errors = np.column_stack([system.check_design, system.check_target])
        held = [(everyone, errors, _below(system.check_denominator, errors, k))]
    elif score == "kfold":
        if not len(folds):
            raise ValueError("score 'kfold' requires folds")
        # The whole system takes part: for its rank and its coefficients at the guard points. The
        # squares of its residuals count as often as each row is held out.
        times = int(np.bincount(np.concatenate(folds), minlength=len(control)).min())
        held = [(everyone, control[:0], below[:0])]
        for fold in folds:
            kept = everyone.copy()
            kept[fold] = False
            held.append((kept, control[~kept], below[~kept]))
    else:
        held = [(everyone, control[:0], below[:0])]
    height = max(len(errors) for _, errors, _ in held)
    systems = []
    for kept, errors, denominators in held:
        if kind == RATIONAL:  # made equally high by rows without error
            blank = np.zeros((height - len(errors), control.shape[1]))
            extra = np.concatenate([errors, blank, denominators, _below(None, blank, k)])
        else:
            extra = below if kind == PRESS else errors
        # A scaled system has the same solutions; its residuals are those of the bound.
        weight = times**0.5 if kept is everyone and times else 1.0
        systems.append(ScoreRows(
            control if kind == PRESS else fewer_rows(weight * control[kept]),
            fewer_rows(extra) if kind == LINEAR else extra,
            guard if kept is everyone else guard[:0]))
    if score != "check":
        free = by_gain(control, used, free, k)
    elif rational:
        free = by_halves(free, np.asarray(below[:, :k].any(axis=0)))
    room = len(free) if max_terms is None else min(len(free), max_terms - len(used))
    parents = np.zeros((0, k), dtype=bool) if system.parents is None else system.parents
    return Stack(kind, k, systems, float(system.margin), BITS[:k][some_of].sum(),
                 np.where(parents, BITS[:k], np.uint64(0)).sum(axis=1, dtype=np.uint64),
                 Piece(used, free, room), times)


def _below(linear: FloatArray | None, rows: FloatArray, k: int) -> FloatArray:
    """Return rows [denominator, -1 of each target]; the denominator is 1 if none is given."""
    below = np.zeros((len(rows) if linear is None else len(linear), rows.shape[1]))
    below[:, k:] = -1.0
    if linear is not None:
        below[:, :k] = linear
    return below
