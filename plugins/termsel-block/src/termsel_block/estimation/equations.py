"""The normal equations of a block, with the tie points eliminated.

Unknowns are the parameters of each image and the place of each tie point. Each tie point is seen in
a few images, so its 3 x 3 block is inverted by itself, and what is left couples images that share
ties (Schur complement; Triggs et al. 2000: Bundle adjustment, a modern synthesis, section 6.1).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import splu

from termsel_block.geometry.frame import FloatArray, IntArray

DENSE = 1500
"""Most image parameters for which the reduced matrix is factorised as a dense one."""

WHOLE = 10_000
"""Most of them for which its inverse is held as a whole: 800 MB."""

Shared = tuple[int, int, IntArray, IntArray]
"""Two images, and the rows of each at which they see the same ties."""

Solve = Callable[[FloatArray], FloatArray]

_CHUNK = 512  # right-hand sides solved at once


@dataclass(frozen=True, eq=False)
class Seen:
    """The tie points that one image sees, linearised: n of them, p parameters.

    Parameters
    ----------
    tie : ndarray, shape (n,)
        Index of each tie point.
    rows : ndarray, shape (n, 2, p)
        Derivatives of line and sample by the image's parameters.
    slopes : ndarray, shape (n, 2, 3)
        Derivatives of line and sample by the tie's place [px/m].
    residual : ndarray, shape (n, 2)
        Measured minus computed [px].
    weight : ndarray, shape (n,)
        Inverse variances [1/px2].
    """

    tie: IntArray
    rows: FloatArray
    slopes: FloatArray
    residual: FloatArray
    weight: FloatArray


@dataclass(frozen=True, eq=False)
class Solved:
    """Steps of parameters (one vector for each image, axis by axis) and ties, and covariances."""

    steps: tuple[FloatArray, ...]
    ties: FloatArray
    reduced: Reduced
    coupling: tuple[FloatArray, ...]
    of_ties: FloatArray
    seen: tuple[Seen, ...]

    @cached_property
    def own(self) -> list[FloatArray]:
        """Covariance of each image's parameters."""
        return self.reduced.own()

    def at(self, step: FloatArray, covariance: FloatArray) -> Solved:
        """Return this with another step and covariance of all parameters, and the ties' by them."""
        steps = tuple(step[part] for part in self.reduced.slices)
        left = np.zeros_like(self.ties)
        for part, coupling, new, old in zip(self.seen, self.coupling, steps, self.steps,
                                            strict=True):
            np.add.at(left, part.tie, np.einsum("tki,k->ti", coupling, old - new))
        return replace(self, steps=steps, reduced=self.reduced.with_inverse(covariance),
                       ties=self.ties + np.einsum("tij,tj->ti", self.of_ties, left))

    def covariance_of_ties(self) -> FloatArray:
        """Return the covariance of each tie's place (t, 3, 3) [m2], parameters' included.

        Beyond `WHOLE` parameters the covariance between images is not held: the ties' are then
        those with each image's own.
        """
        total = self.of_ties.copy()
        blocks = self.reduced.inverse
        slices = self.reduced.slices
        gains = [np.einsum("tij,tkj->tik", self.of_ties[part.tie], coupling)
                 for part, coupling in zip(self.seen, self.coupling, strict=True)]
        if blocks is None:
            for part, gain, own in zip(self.seen, gains, self.own, strict=True):
                np.add.at(total, part.tie, gain @ own @ gain.transpose(0, 2, 1))
            return total
        for i, j, at_i, at_j in pairs([part.tie for part in self.seen], len(total)):
            between = gains[i][at_i] @ blocks[slices[i], slices[j]] @ gains[j][at_j].transpose(
                0, 2, 1)
            ties = self.seen[i].tie[at_i]
            np.add.at(total, ties, between if i == j else between + between.transpose(0, 2, 1))
        return total


class Reduced:
    """The reduced normal matrix, factorised."""

    def __init__(self, matrix: sparse.csc_matrix | FloatArray, sizes: Sequence[int]) -> None:
        ends = np.cumsum(sizes)
        self.slices = [slice(int(end - size), int(end))
                       for end, size in zip(ends, sizes, strict=True)]
        self._matrix = matrix
        self._size = int(ends[-1])
        if isinstance(matrix, np.ndarray):
            factor = linalg.cho_factor(matrix)
            self.solve: Solve = lambda right: linalg.cho_solve(factor, right)
        else:
            self.solve = splu(matrix, permc_spec="MMD_AT_PLUS_A",
                              options={"SymmetricMode": True}).solve

    def whole(self) -> FloatArray:
        """Return the matrix itself."""
        matrix = self._matrix
        return np.asarray(matrix if isinstance(matrix, np.ndarray) else matrix.toarray())

    def with_inverse(self, covariance: FloatArray) -> Reduced:
        """Return this with a covariance that knows more than the matrix."""
        other = copy(self)
        other.inverse = covariance
        return other

    @cached_property
    def inverse(self) -> FloatArray | None:
        """The covariance of all parameters, or None where it is too large."""
        if self._size > WHOLE:
            return None
        if isinstance(self._matrix, np.ndarray):
            return np.asarray(self.solve(np.eye(self._size)))
        # Faster than as many solutions with the sparse factors.
        factor, failed = linalg.lapack.dpotrf(self._matrix.toarray(), overwrite_a=True)
        if failed:
            raise np.linalg.LinAlgError("the reduced matrix is not positive definite")
        half, _ = linalg.lapack.dpotri(factor, overwrite_c=True)
        return np.asarray(np.triu(half) + np.triu(half, 1).T)

    def own(self) -> list[FloatArray]:
        """Return the covariance of each image's parameters."""
        if self.inverse is not None:
            return [self.inverse[part, part] for part in self.slices]
        found = []
        for first in range(0, self._size, _CHUNK):
            found.append(self._diagonal(first, min(first + _CHUNK, self._size)))
        return [block for chunk in found for block in chunk]

    def _diagonal(self, first: int, end: int) -> list[FloatArray]:
        """Return the blocks of the inverse of images that begin in a range of columns."""
        mine = [part for part in self.slices if first <= part.start < end]
        if not mine:
            return []
        start = mine[0].start
        stop = mine[-1].stop
        right = np.zeros((self._size, stop - start))
        right[np.arange(start, stop), np.arange(stop - start)] = 1.0
        inverse = self.solve(right)
        return [inverse[part, part.start - start:part.stop - start] for part in mine]


def pairs(ties: Sequence[IntArray], count: int) -> list[Shared]:
    """Return which images share ties: (i, j, rows of i, rows of j) with i <= j.

    Rows are sorted alike: the k-th of each is the same tie.
    """
    image = np.repeat(np.arange(len(ties)), [len(tie) for tie in ties])
    row = np.concatenate([np.arange(len(tie)) for tie in ties])
    tie = np.concatenate(ties)
    order = np.lexsort((image, tie))
    image = image[order]
    row = row[order]
    tie = tie[order]
    starts = np.searchsorted(tie, np.arange(count + 1))
    degree = np.diff(starts)
    found: list[IntArray] = []
    for size in np.unique(degree[degree > 0]):
        first = starts[:-1][degree == size]
        at = first[:, None] + np.arange(size)
        for a in range(size):
            for b in range(a, size):
                found.append(np.stack([image[at[:, a]], image[at[:, b]], row[at[:, a]],
                                       row[at[:, b]]]))
    every = np.concatenate(found, axis=1)
    key = every[0] * len(ties) + every[1]
    order = np.argsort(key, kind="stable")
    every = every[:, order]
    key = key[order]
    cuts = np.flatnonzero(np.diff(key)) + 1
    return [(int(part[0, 0]), int(part[1, 0]), part[2], part[3])
            for part in np.split(every, cuts, axis=1)]


def solve(
    seen: Sequence[Seen],
    own: Sequence[FloatArray],
    own_right: Sequence[FloatArray],
    of_ties: FloatArray,
    right_of_ties: FloatArray,
    sharing: Sequence[Shared],
) -> Solved:
    """Solve the normal equations for one step.

    Parameters
    ----------
    seen : sequence of Seen
        Of each image.
    own, own_right : sequence of ndarray, shapes (p, p) and (p,)
        What priors and control add to each image's normal equations.
    of_ties, right_of_ties : ndarray, shapes (t, 3, 3) and (t, 3)
        What priors add to each tie's.
    sharing : sequence
        Of `pairs`.

    Raises
    ------
    numpy.linalg.LinAlgError
        If parameters are not determined.
    """
    of_ties = of_ties.copy()
    right_of_ties = right_of_ties.copy()
    coupling = []
    diagonal = []
    right = []
    for part, mine, aside in zip(seen, own, own_right, strict=True):
        w = part.weight[:, None]
        weighted = part.slopes * w[:, :, None]
        np.add.at(of_ties, part.tie, weighted.transpose(0, 2, 1) @ part.slopes)
        np.add.at(right_of_ties, part.tie, np.einsum("nai,na->ni", weighted, part.residual))
        coupling.append(part.rows.transpose(0, 2, 1) @ weighted)
        rows = part.rows.reshape(part.rows.shape[0] * part.rows.shape[1], part.rows.shape[2])
        heavy = rows * np.repeat(w, 2, axis=0)
        diagonal.append(mine + heavy.T @ rows)
        right.append(aside + heavy.T @ part.residual.ravel())
    root = np.linalg.inv(np.linalg.cholesky(of_ties)).transpose(0, 2, 1)
    inverse = root @ root.transpose(0, 2, 1)
    half = [np.einsum("tki,tij->tkj", c, root[part.tie])
            for c, part in zip(coupling, seen, strict=True)]
    steered = np.einsum("tji,tj->ti", root, right_of_ties)
    sizes = [len(block) for block in diagonal]
    for i, part in enumerate(seen):
        right[i] = right[i] - np.einsum("tkj,tj->k", half[i], steered[part.tie])
    matrix = _reduced(diagonal, half, sharing, sizes)
    reduced = Reduced(matrix, sizes)
    step = reduced.solve(np.concatenate(right))
    steps = tuple(step[part] for part in reduced.slices)
    left = right_of_ties.copy()
    for part, c, mine in zip(seen, coupling, steps, strict=True):
        np.add.at(left, part.tie, -np.einsum("tki,k->ti", c, mine))
    return Solved(steps, np.einsum("tij,tj->ti", inverse, left), reduced, tuple(coupling), inverse,
                  tuple(seen))


def _reduced(diagonal: Sequence[FloatArray], half: Sequence[FloatArray],
             sharing: Sequence[Shared], sizes: Sequence[int],
             ) -> FloatArray | sparse.csc_matrix:
    """Return the matrix of the images alone, dense where it is small."""
    total = sum(sizes)
    ends = np.cumsum(sizes)
    begin = ends - sizes
    blocks: dict[tuple[int, int], FloatArray] = {
        (i, i): block.copy() for i, block in enumerate(diagonal)}
    for i, j, at_i, at_j in sharing:
        left = half[i][at_i].transpose(1, 0, 2).reshape(sizes[i], 3 * len(at_i))
        other = half[j][at_j].transpose(1, 0, 2).reshape(sizes[j], 3 * len(at_j))
        product = left @ other.T
        blocks[i, j] = blocks[i, j] - product if (i, j) in blocks else -product
    if total <= DENSE:
        matrix = np.zeros((total, total))
        for (i, j), block in blocks.items():
            matrix[begin[i]:ends[i], begin[j]:ends[j]] = block
            if i != j:
                matrix[begin[j]:ends[j], begin[i]:ends[i]] = block.T
        return matrix
    rows = []
    columns = []
    values = []
    for (i, j), block in blocks.items():
        at = np.indices(block.shape)
        for first, second, part in ((at[0] + begin[i], at[1] + begin[j], True),
                                    (at[1] + begin[j], at[0] + begin[i], i != j)):
            if part:
                rows.append(first.ravel())
                columns.append(second.ravel())
                values.append(block.ravel())
    return sparse.csc_matrix(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))),
        shape=(total, total))
