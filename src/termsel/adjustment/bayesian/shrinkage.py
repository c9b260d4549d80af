"""Solutions of least squares with shrunken columns, for many scales and sizes at once.

With the free columns taken out, and the others multiplied by their scales, U S V' is the singular
value decomposition of what remains. The solution of a size s leaves 1 / (1 + (s S)^2) of what is
measured along each column of U. A group is one set of scales, a solution a group and a size.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from termsel.adjustment.orthogonal import orthogonal
from termsel.adjustment.solve import TOLERANCE
from termsel.data.features import BoolArray, FloatArray, IntArray

Some = slice | IntArray
"""Which points."""

TINY = 1e-14
"""What is left of 1 by rounding error."""

CANCELLED = 1e-8
"""What remains of a number where rounding errors of a difference matter."""

AT_ONCE = 1 << 16
"""Numbers of several groups that are worked on together: fewer calls, as long as a cache holds
them."""


@dataclass(frozen=True, eq=False)
class Design:
    """Columns, those that are shrunken without the free ones."""

    basis: FloatArray  # (n, m): what some column, and no free one, explains
    # (n, l): what the columns explain, free ones with them; the rest is left by every solution.
    explained: FloatArray
    rest: FloatArray  # (m, k): the shrunken columns in the basis
    scales: FloatArray  # (g, k): of their coefficients for size 1
    lead: FloatArray  # (f, f): triangle of the free columns
    cross: FloatArray  # (f, k): what the shrunken columns have in common with them
    few: int  # shrunken columns after which all have one scale in each group

    @cached_property
    def many(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """U, shape (m, m), S, shape (m,), and S V' of all shrunken columns but the first few, bare.
        """
        # U is complete: the few columns are not within the span of the others.
        bare = self.rest[:, self.few:]
        values, u = np.linalg.eigh(bare @ bare.T)
        return u, np.sqrt(np.maximum(values, 0.0)), u.T @ bare

    @cached_property
    def unexplained(self) -> FloatArray:
        """What no column explains of each point, shape (n,)."""
        if self.explained.shape[1] == len(self.explained):
            return np.zeros(len(self.explained))
        return np.asarray(np.maximum(1.0 - (self.explained**2).sum(axis=1), 0.0))

    @cached_property
    def _known(self) -> tuple[BoolArray, FloatArray, FloatArray, FloatArray]:
        """Of which groups the decompositions are known, and these."""
        (count, k) = self.scales.shape
        m = len(self.rest)
        return (np.zeros(count, dtype=bool), np.empty((count, m, m)), np.empty((count, m)),
                np.empty((count, m, k)))

    def decomposed(self, groups: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return U, S and V' of some groups; each is found once."""
        known, *kept = self._known
        new = groups[~known[groups]]
        if new.size:
            parts = np.linalg.svd(self.rest * self.scales[new, None], full_matrices=False)
            for every, part in zip(kept, parts, strict=True):
                every[new] = part
            known[new] = True
        u, values, vt = (every[groups] for every in kept)
        return u, values, vt

    def beyond(self, target: FloatArray) -> FloatArray:
        """Return what no column explains, apart: nothing cancels where noise tends to 0."""
        if self.explained.shape[1] == len(target):
            return np.zeros_like(target)
        return np.asarray(target - self.explained @ (self.explained.T @ target))


def design_of(columns: FloatArray, free: BoolArray, scales: FloatArray,
              few: int) -> Design | None:
    """Return a design; None if all rows but any one do not determine the free columns.

    Of the columns (n, f + k) the free ones are not shrunken; the scales are (g, k). After the first
    few shrunken columns all have one scale in each group; few is k if there are none such.
    """
    lead = columns[:, free]
    f = lead.shape[1]
    if len(lead) <= f:
        return None
    # Free columns first: q of the others is then without them.
    q, r = orthogonal(columns if free[:f].all() else
                      np.concatenate([lead, columns[:, ~free]], axis=1))
    if (np.abs(np.diag(r))[:f] <= TOLERANCE * np.linalg.norm(lead, axis=0)).any() \
            or (1.0 - (q[:, :f]**2).sum(axis=1)).min() < TOLERANCE:
        return None
    return Design(q[:, f:], q, r[f:, f:], scales, r[:f, :f], r[:f, f:], few)


@dataclass(frozen=True, eq=False)
class Side:
    """The u solutions of one axis."""

    cell: IntArray  # (c,): that of each cell of the posterior
    effective: FloatArray  # (u,): effective parameters
    coefficients: FloatArray  # (u, k): the shrunken ones
    free: FloatArray  # (f,): what is measured along the free columns
    # Of some of the points, 1 minus the leverage and what the fit leaves, (u, m) each: solutions
    # are hundreds, which times all points may be more than the memory holds.
    left: Callable[[Some], FloatArray]
    errors: Callable[[Some], FloatArray]


class Shrinkage:
    """What solutions do, whatever is measured, by one decomposition for each group.

    Group and size (u,) are numbers, of each solution; `sizes` are all there are.
    """

    def __init__(self, design: Design, group: IntArray, size: IntArray,
                 sizes: FloatArray) -> None:
        groups, which = np.unique(group, return_inverse=True)
        least = int(size.min())
        most = int(size.max())
        # Where the solutions stand among all of these groups and sizes.
        self._place = which * (most + 1 - least) + size - least
        self._design = design
        self._scales = design.scales[groups]
        self._u, values, self._vt = design.decomposed(groups)
        some = sizes[least:most + 1, None]
        ratio = some * values[:, None]                                            # (g, s, m)
        self._keep = 1.0 / (1.0 + ratio**2)
        self._grown = some * ratio * self._keep  # of s^2 S / (1 + (s S)^2), for the coefficients
        self._effective = design.explained.shape[1] - self._mine(self._keep).sum(axis=1)

    def _mine(self, every: FloatArray) -> FloatArray:
        """Return the rows of the solutions, of those of all groups and sizes, shape (u, k)."""
        count, sizes, k = every.shape
        return np.asarray(every.reshape(count * sizes, k)[self._place])

    def left(self, points: Some) -> FloatArray:
        """Return 1 minus the leverage of points, shape (u, n)."""
        design = self._design
        (count, sizes, m) = self._keep.shape
        places = np.ascontiguousarray(design.basis[points].T)
        n = places.shape[1]
        left = np.empty((count, sizes, n))
        # (U' basis')^2 by what each direction leaves, and what no column explains.
        step = max(1, AT_ONCE // max(n * m, 1))
        for start in range(0, count, step):
            some = slice(start, start + step)
            along = self._u[some].swapaxes(1, 2) @ places
            along *= along
            np.matmul(self._keep[some], along, out=left[some])
        mine = self._mine(left)
        mine += design.unexplained[points]
        return np.maximum(mine, TINY, out=mine)

    def side(self, target: FloatArray, which: IntArray) -> Side:
        """Return the solutions for what is measured of one axis, `target` (n,).

        `which` (c,) is the solution of each cell of the posterior.
        """
        design = self._design
        along = ((design.basis.T @ target) @ self._u)[:, None]                    # (g, 1, m)
        kept = self._mine((self._keep * along) @ self._u.swapaxes(1, 2))
        beyond = design.beyond(target)
        coefficients = self._mine((self._grown * along) @ self._vt * self._scales[:, None])
        return Side(which, self._effective, coefficients,
                    design.explained[:, :len(design.lead)].T @ target, self.left,
                    lambda points: np.asarray(kept @ design.basis[points].T + beyond[points]))


class SharedShrinkage:
    """The same by one decomposition for all groups, that of the columns of one scale.

    With W what a size leaves along it, and the few other columns C by their scales, a solution
    leaves W - W C (I + C'W C)^-1 C'W of what is measured.

    It takes what `Shrinkage` takes; the design has few columns of scales of their own.
    """

    def __init__(self, design: Design, group: IntArray, size: IntArray,
                 sizes: FloatArray) -> None:
        few = design.few
        self._design = design
        self._own = sizes[size, None] * design.scales[group]
        u, values, self._bare = design.many
        self._keep = 1.0 / (1.0 + (self._own[:, few:few + 1] * values) ** 2)         # (u, m)
        self._columns = self._own[:, :few, None] * (design.rest[:, :few].T @ u)  # C', (u, f, m)
        weighted = self._columns * self._keep[:, None]
        # L^-1 of I + C'W C = L L'.
        self._inverse = np.linalg.inv(np.linalg.cholesky(
            np.eye(few) + weighted @ self._columns.swapaxes(1, 2)))
        self._turned = self._inverse @ weighted
        self._along = u.T @ design.basis.T                                           # (m, n)

    @cached_property
    def all_left(self) -> FloatArray | None:
        """1 minus the leverage of each point, shape (u, n); None where rounding errors matter."""
        # Diagonal of W less that of W C (I + C'W C)^-1 C'W, of which hardly anything may remain.
        whole = self._keep @ self._along**2 + self._design.unexplained
        count, few, m = self._turned.shape
        less = (self._turned.reshape(-1, m) @ self._along).reshape(count, few, -1)
        less *= less
        left = whole - less.sum(axis=1)
        return None if (left <= CANCELLED * whole).any() else np.maximum(left, TINY, out=left)

    def side(self, target: FloatArray, which: IntArray) -> Side:
        """Return the solutions for what is measured of one axis (see `Shrinkage.side`)."""
        design = self._design
        left = self.all_left
        assert left is not None
        along = self._along @ target
        mixed = self._turned @ along                                                 # (u, f)
        rest = self._keep * along - (mixed[:, None] @ self._turned)[:, 0]
        coefficients = self._own.copy()
        coefficients[:, :design.few] *= (mixed[:, None] @ self._inverse)[:, 0]
        coefficients[:, design.few:] *= self._own[:, design.few:design.few + 1] * (
            rest @ self._bare)
        effective = (design.explained.shape[1] - self._keep.sum(axis=1)
                     + (self._turned**2).sum(axis=(1, 2)))
        errors = rest @ self._along + design.beyond(target)
        return Side(which, effective, coefficients,
                    design.explained[:, :len(design.lead)].T @ target,
                    lambda points: left[:, points], lambda points: errors[:, points])


def shrinkage_of(design: Design, group: IntArray, size: IntArray,
                 sizes: FloatArray) -> Shrinkage | SharedShrinkage:
    """Return what solutions do, by one decomposition where the design and rounding errors allow.

    It takes what `Shrinkage` takes.
    """
    if design.few < design.rest.shape[1]:
        shared = SharedShrinkage(design, group, size, sizes)
        if shared.all_left is not None:
            return shared
    return Shrinkage(design, group, size, sizes)
