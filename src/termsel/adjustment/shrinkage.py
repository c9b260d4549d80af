"""Solutions of least squares with shrunken columns, for many scales and sizes at once.

With the free columns taken out, and the others multiplied by their scales, U S V' is the singular
value decomposition of what remains. The solution of a size s leaves 1 / (1 + (s S)^2) of what is
measured along each column of U. A group is one set of scales.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from termsel.adjustment.solve import TOLERANCE
from termsel.measurements.features import BoolArray, FloatArray, IntArray

TINY = 1e-14
"""What is left of 1 by rounding error."""

AT_ONCE = 1 << 16
"""Numbers of several groups that are worked on together: fewer calls, as long as a cache holds
them."""


@dataclass(frozen=True, eq=False)
class Design:
    """Columns, those that are shrunken without the free ones.

    Parameters
    ----------
    basis : ndarray, shape (n, m)
        What some column, and no free one, explains.
    explained : ndarray, shape (n, l)
        What the columns explain, free ones with them; the rest is left by every solution.
    rest : ndarray, shape (m, k)
        The shrunken columns in the basis.
    scales : ndarray, shape (g, k)
        Of their coefficients for size 1.
    lead : ndarray, shape (f, f)
        Triangle of the free columns.
    cross : ndarray, shape (f, k)
        What the shrunken columns have in common with them.
    few : int
        Shrunken columns after which all have one scale in each group.
    """

    basis: FloatArray
    explained: FloatArray
    rest: FloatArray
    scales: FloatArray
    lead: FloatArray
    cross: FloatArray
    few: int

    @cached_property
    def many(self) -> tuple[FloatArray, FloatArray]:
        """U, shape (m, m), and S, shape (m,), of all shrunken columns but the first few, bare."""
        u, values, _ = np.linalg.svd(self.rest[:, self.few:])
        strength = np.zeros(len(u))
        strength[:len(values)] = values
        return u, strength

    @cached_property
    def _known(self) -> tuple[BoolArray, FloatArray, FloatArray, FloatArray]:
        """Of which groups the decompositions are known, and these."""
        (count, k), m = self.scales.shape, len(self.rest)
        return (np.zeros(count, dtype=bool), np.empty((count, m, m)), np.empty((count, m)),
                np.empty((count, m, k)))

    def decomposed(self, groups: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return U, S and V' of some groups; each is found once."""
        known, *found = self._known
        new = groups[~known[groups]]
        if new.size:
            parts = np.linalg.svd(self.rest * self.scales[new, None], full_matrices=False)
            for every, part in zip(found, parts, strict=True):
                every[new] = part
            known[new] = True
        u, values, vt = (every[groups] for every in found)
        return u, values, vt

    def beyond(self, target: FloatArray) -> FloatArray:
        """Return what no column explains, apart: nothing cancels where noise tends to 0."""
        if self.explained.shape[1] == len(target):
            return np.zeros_like(target)
        return np.asarray(target - self.explained @ (self.explained.T @ target))


def design_of(columns: FloatArray, free: BoolArray, scales: FloatArray,
              few: int) -> Design | None:
    """Return a design.

    Parameters
    ----------
    columns : ndarray, shape (n, f + k)
    free : ndarray of bool, shape (f + k,)
        Columns that are not shrunken.
    scales : ndarray, shape (g, k)
    few : int
        Shrunken columns after which all have one scale in each group; k if there are none such.

    Returns
    -------
    Design or None
        None if all rows but any one do not determine the free columns.
    """
    return _design(columns.tobytes(), free.tobytes(), scales.tobytes(), *columns.shape, few)


@lru_cache(maxsize=4)
def _design(columns_of: bytes, free_of: bytes, scales_of: bytes, n: int,
            count: int, few: int) -> Design | None:
    """Return the same; line and sample, and a field of no size, ask for one."""
    columns = np.frombuffer(columns_of).reshape(n, count)
    free = np.frombuffer(free_of, dtype=bool)
    scales = np.frombuffer(scales_of).reshape(-1, int((~free).sum()))
    lead = columns[:, free]
    f = lead.shape[1]
    if len(lead) <= f:
        return None
    q, r = np.linalg.qr(np.concatenate([lead, columns[:, ~free]], axis=1))
    if (np.abs(np.diag(r))[:f] <= TOLERANCE * np.linalg.norm(lead, axis=0)).any() \
            or (1.0 - (q[:, :f]**2).sum(axis=1)).min() < TOLERANCE:
        return None
    return Design(q[:, f:], q, r[f:, f:], scales, r[:f, :f], r[:f, f:], few)


@dataclass(frozen=True, eq=False)
class Side:
    """The u solutions of one axis, those of some groups by some sizes.

    `cell`, shape (c,), is that of each cell of the posterior. `left` is 1 minus the leverage of
    each point, `errors` are what the fit leaves, shape (n, u); `effective`, shape (u,), are
    effective parameters. `coefficients` are the shrunken ones, shape (u, k), and `free` what is
    measured along the free columns.
    """

    cell: IntArray
    left: FloatArray
    errors: FloatArray
    effective: FloatArray
    coefficients: FloatArray
    free: FloatArray


class Shrinkage:
    """What the solutions of some groups by some sizes do, whatever is measured.

    Parameters
    ----------
    design : Design
    groups : ndarray of int, shape (g,)
    sizes : ndarray, shape (s,)
    """

    def __init__(self, design: Design, groups: IntArray, sizes: FloatArray) -> None:
        self._design, self._scales = design, design.scales[groups]
        self._u, values, self._vt = design.decomposed(groups)
        ratio = sizes[:, None] * values[:, None]                                  # (g, s, m)
        self._keep = 1.0 / (1.0 + ratio**2)
        self._grown = sizes[:, None] * ratio * self._keep
        self._effective = (design.explained.shape[1] - self._keep.sum(axis=2)).ravel()

    @cached_property
    def _left(self) -> FloatArray:
        """1 minus the leverage of each point, shape (n, g s)."""
        design, (count, sizes, m) = self._design, self._keep.shape
        places = np.ascontiguousarray(design.basis.T)
        n = places.shape[1]
        left = np.empty((count, sizes, n))
        step = max(1, AT_ONCE // max(n * m, 1))
        for start in range(0, count, step):
            some = slice(start, start + step)
            along = self._u[some].swapaxes(1, 2) @ places
            along *= along
            np.matmul(self._keep[some], along, out=left[some])
        if design.explained.shape[1] < n:
            left += np.maximum(1.0 - (design.explained**2).sum(axis=1), 0.0)
        return np.maximum(left.reshape(-1, n).T, TINY, order="C")

    def side(self, target: FloatArray, cell: IntArray) -> Side:
        """Return the solutions for what is measured of one axis, shape (n,)."""
        design = self._design
        along = ((design.basis.T @ target) @ self._u)[:, None]                    # (g, 1, m)
        turned = (self._keep * along) @ self._u.swapaxes(1, 2)
        errors = design.basis @ turned.reshape(-1, turned.shape[2]).T
        errors += design.beyond(target)[:, None]
        coefficients = (self._grown * along) @ self._vt * self._scales[:, None]
        return Side(cell, self._left, errors, self._effective,
                    coefficients.reshape(-1, coefficients.shape[2]),
                    design.explained[:, :len(design.lead)].T @ target)
