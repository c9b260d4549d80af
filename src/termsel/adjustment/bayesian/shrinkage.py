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

PointSelection = slice | IntArray
"""Which points."""

MIN_REDUNDANCY = 1e-14
"""What is left of 1 by rounding error."""

CANCELLATION = 1e-8
"""What remains of a number where rounding errors of a difference matter."""

NUMBERS_AT_ONCE = 1 << 16
"""Numbers of several groups that are worked on together: fewer calls, as long as a cache holds
them."""


@dataclass(frozen=True, eq=False)
class Design:
    """Columns, those that are shrunken without the free ones."""

    basis: FloatArray  # (n, m): what some column, and no free one, explains
    # (n, l): what the columns explain, free ones with them; the rest is left by every solution.
    explained: FloatArray
    shrunken: FloatArray  # (m, k): the shrunken columns in the basis
    scales: FloatArray  # (g, k): of their coefficients for size 1
    lead: FloatArray  # (f, f): triangle of the free columns
    free_projections: FloatArray  # (f, k): what the shrunken columns have in common with them
    n_own: int  # shrunken columns after which all have one scale in each group

    @cached_property
    def shared_decomposition(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """U, shape (m, m), S, shape (m,), and S V' of all shrunken columns but the first few, bare.
        """
        # U is complete: the few columns are not within the span of the others.
        shared = self.shrunken[:, self.n_own:]
        values, u = np.linalg.eigh(shared @ shared.T)
        return u, np.sqrt(np.maximum(values, 0.0)), u.T @ shared

    @cached_property
    def unexplained_share(self) -> FloatArray:
        """What no column explains of each point, shape (n,)."""
        if self.explained.shape[1] == len(self.explained):
            return np.zeros(len(self.explained))
        return np.asarray(np.maximum(1.0 - (self.explained**2).sum(axis=1), 0.0))

    @cached_property
    def _decompositions(self) -> tuple[BoolArray, FloatArray, FloatArray, FloatArray]:
        """Of which groups the decompositions are known, and these."""
        (count, k) = self.scales.shape
        m = len(self.shrunken)
        return (np.zeros(count, dtype=bool), np.empty((count, m, m)), np.empty((count, m)),
                np.empty((count, m, k)))

    def decomposed(self, groups: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return U, S and V' of some groups; each is found once."""
        is_decomposed, *stored = self._decompositions
        new = groups[~is_decomposed[groups]]
        if new.size:
            decomposition = np.linalg.svd(self.shrunken * self.scales[new, None],
                                          full_matrices=False)
            for factor, new_factor in zip(stored, decomposition, strict=True):
                factor[new] = new_factor
            is_decomposed[new] = True
        # All of them are the arrays that are stored, in their order.
        u, values, vt = stored if len(groups) == len(is_decomposed) else (
            factor[groups] for factor in stored)
        return u, values, vt

    def unexplained_part(self, target: FloatArray) -> FloatArray:
        """Return what no column explains, apart: nothing cancels where noise tends to 0."""
        if self.explained.shape[1] == len(target):
            return np.zeros_like(target)
        return np.asarray(target - self.explained @ (self.explained.T @ target))


def design_of(columns: FloatArray, free: BoolArray, scales: FloatArray,
              n_own: int) -> Design | None:
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
    return Design(q[:, f:], q, r[f:, f:], scales, r[:f, :f], r[:f, f:], n_own)


@dataclass(frozen=True, eq=False)
class AxisSolutions:
    """The u solutions of one axis."""

    solution_of_cell: IntArray  # (c,): that of each cell of the posterior
    effective: FloatArray  # (u,): effective parameters
    coefficients: FloatArray  # (u, k): the shrunken ones
    free: FloatArray  # (f,): what is measured along the free columns
    # Of some of the points, 1 minus the leverage and what the fit leaves, (u, m) each: solutions
    # are hundreds, which times all points may be more than the memory holds.
    redundancies: Callable[[PointSelection], FloatArray]
    errors: Callable[[PointSelection], FloatArray]


class Shrinkage:
    """What solutions do, whatever is measured, by one decomposition for each group.

    Group and size (u,) are numbers, of each solution, in order; `sizes` are all there are.
    """

    def __init__(self, design: Design, group: IntArray, size: IntArray,
                 sizes: FloatArray) -> None:
        # As np.unique of groups in order, without sorting.
        is_first = np.diff(group, prepend=-1) > 0
        groups = group[is_first]
        group_index = np.cumsum(is_first) - 1
        first_size = int(size.min())
        last_size = int(size.max())
        # Where the solutions stand among all of these groups and sizes.
        self._index = group_index * (last_size + 1 - first_size) + size - first_size
        self._design = design
        self._scales = design.scales[groups]
        self._u, values, self._vt = design.decomposed(groups)
        size_column = sizes[first_size:last_size + 1, None]
        ratio = size_column * values[:, None]                                            # (g, s, m)
        self._shrink = 1.0 / (1.0 + ratio**2)
        # Of s^2 S / (1 + (s S)^2), for the coefficients.
        self._gain = size_column * ratio * self._shrink
        self._effective = design.explained.shape[1] - self._of_solutions(self._shrink).sum(axis=1)

    def _of_solutions(self, grid: FloatArray) -> FloatArray:
        """Return the rows of the solutions, of those of all groups and sizes, shape (u, k)."""
        count, sizes, k = grid.shape
        return np.asarray(grid.reshape(count * sizes, k)[self._index])

    def redundancies(self, points: PointSelection) -> FloatArray:
        """Return 1 minus the leverage of points, shape (u, n)."""
        design = self._design
        (count, sizes, m) = self._shrink.shape
        directions = np.ascontiguousarray(design.basis[points].T)
        n = directions.shape[1]
        grid = np.empty((count, sizes, n))
        # (U' basis')^2 by what each direction leaves, and what no column explains.
        step = max(1, NUMBERS_AT_ONCE // max(n * m, 1))
        for start in range(0, count, step):
            batch = slice(start, start + step)
            projections = self._u[batch].swapaxes(1, 2) @ directions
            projections *= projections
            np.matmul(self._shrink[batch], projections, out=grid[batch])
        redundancies = self._of_solutions(grid)
        redundancies += design.unexplained_share[points]
        return np.maximum(redundancies, MIN_REDUNDANCY, out=redundancies)

    def solutions(self, target: FloatArray, solution_of_cell: IntArray) -> AxisSolutions:
        """Return the solutions for what is measured of one axis, `target` (n,).

        `solution_of_cell` (c,) is the solution of each cell of the posterior.
        """
        design = self._design
        projections = ((design.basis.T @ target) @ self._u)[:, None]                    # (g, 1, m)
        fit_errors = self._of_solutions((self._shrink * projections) @ self._u.swapaxes(1, 2))
        unexplained = design.unexplained_part(target)
        coefficients = self._of_solutions(
            (self._gain * projections) @ self._vt * self._scales[:, None])
        return AxisSolutions(
            solution_of_cell, self._effective, coefficients,
            design.explained[:, :len(design.lead)].T @ target, self.redundancies,
            lambda points: np.asarray(fit_errors @ design.basis[points].T + unexplained[points]))


class SharedShrinkage:
    """The same by one decomposition for all groups, that of the columns of one scale.

    With W what a size leaves along it, and the few other columns C by their scales, a solution
    leaves W - W C (I + C'W C)^-1 C'W of what is measured.

    It takes what `Shrinkage` takes; the design has few columns of scales of their own.
    """

    def __init__(self, design: Design, group: IntArray, size: IntArray,
                 sizes: FloatArray) -> None:
        n_own = design.n_own
        self._design = design
        self._column_scales = sizes[size, None] * design.scales[group]
        u, values, self._shared_vt = design.shared_decomposition
        # (u, m).
        self._shrink = 1.0 / (1.0 + (self._column_scales[:, n_own:n_own + 1] * values) ** 2)
        # C', (u, f, m).
        self._columns = self._column_scales[:, :n_own, None] * (design.shrunken[:, :n_own].T @ u)
        weighted = self._columns * self._shrink[:, None]
        # L^-1 of I + C'W C = L L'.
        self._inverse = np.linalg.inv(np.linalg.cholesky(
            np.eye(n_own) + weighted @ self._columns.swapaxes(1, 2)))
        self._correction = self._inverse @ weighted
        self._directions = u.T @ design.basis.T                                           # (m, n)

    @cached_property
    def all_redundancies(self) -> FloatArray | None:
        """1 minus the leverage of each point, shape (u, n); None where rounding errors matter."""
        # Diagonal of W less that of W C (I + C'W C)^-1 C'W, of which hardly anything may remain.
        shared_part = self._shrink @ self._directions**2 + self._design.unexplained_share
        count, n_own, m = self._correction.shape
        correction = (self._correction.reshape(-1, m) @ self._directions).reshape(count, n_own, -1)
        correction *= correction
        redundancies = shared_part - correction.sum(axis=1)
        return None if (redundancies <= CANCELLATION * shared_part).any() else np.maximum(
            redundancies, MIN_REDUNDANCY, out=redundancies)

    def solutions(self, target: FloatArray, solution_of_cell: IntArray) -> AxisSolutions:
        """Return the solutions for what is measured of one axis (see `Shrinkage.side`)."""
        design = self._design
        redundancies = self.all_redundancies
        assert redundancies is not None
        projections = self._directions @ target
        # (u, f).
        mixed = self._correction @ projections
        shrunken_projections = self._shrink * projections - (mixed[:, None] @ self._correction)[:,
                                                                                                0]
        coefficients = self._column_scales.copy()
        coefficients[:, :design.n_own] *= (mixed[:, None] @ self._inverse)[:, 0]
        coefficients[:, design.n_own:] *= self._column_scales[:, design.n_own:design.n_own + 1] * (
            shrunken_projections @ self._shared_vt)
        effective = (design.explained.shape[1] - self._shrink.sum(axis=1)
                     + (self._correction**2).sum(axis=(1, 2)))
        errors = shrunken_projections @ self._directions + design.unexplained_part(target)
        return AxisSolutions(solution_of_cell, effective, coefficients,
                             design.explained[:, :len(design.lead)].T @ target,
                             lambda points: redundancies[:, points],
                             lambda points: errors[:, points])


def shrinkage_of(design: Design, group: IntArray, size: IntArray,
                 sizes: FloatArray) -> Shrinkage | SharedShrinkage:
    """Return what solutions do, by one decomposition where the design and rounding errors allow.

    It takes what `Shrinkage` takes.
    """
    if design.n_own < design.shrunken.shape[1]:
        shared = SharedShrinkage(design, group, size, sizes)
        if shared.all_redundancies is not None:
            return shared
    return Shrinkage(design, group, size, sizes)
