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
from itertools import chain

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import splu

from termsel_block.geometry.frame import FloatArray, IntArray

MAX_DENSE = 1500
"""Most image parameters for which the reduced matrix is factorised as a dense one."""

MAX_INVERSE = 10_000
"""Most of them for which its inverse is held as a whole: 800 MB."""

Shared = tuple[int, int, IntArray, IntArray]
"""Two images, and the rows of each at which they see the same ties."""

Solve = Callable[[FloatArray], FloatArray]

# Right-hand sides solved at once.
_CHUNK = 512


@dataclass(frozen=True, eq=False)
class TieRows:
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
    """Steps of parameters (one vector for each image) and ties, and covariances."""

    steps: tuple[FloatArray, ...]
    ties: FloatArray
    reduced: Reduced
    coupling: tuple[FloatArray, ...]
    of_ties: FloatArray
    tie_rows: tuple[TieRows, ...]

    @cached_property
    def image_covariances(self) -> list[FloatArray]:
        """Covariance (p, p) of each image's parameters, in the order of the images."""
        return self.reduced.image_covariances()

    def at(self, step: FloatArray, covariance: FloatArray) -> Solved:
        """Return this solution with another step of all parameters (p,) and their covariance."""
        steps = tuple(step[columns] for columns in self.reduced.slices)
        # Steps of ties are x = H^-1 (b - B^T p), so that they change by H^-1 B^T (old - new).
        change = np.zeros_like(self.ties)
        for rows, coupling, new, old in zip(self.tie_rows, self.coupling, steps, self.steps,
                                            strict=True):
            np.add.at(change, rows.tie, np.einsum("tki,k->ti", coupling, old - new))
        return replace(self, steps=steps, reduced=self.reduced.with_inverse(covariance),
                       ties=self.ties + np.einsum("tij,tj->ti", self.of_ties, change))

    def covariance_of_ties(self) -> FloatArray:
        """Return the covariances (t, 3, 3) of the ties' positions [m2].

        Beyond `MAX_INVERSE` parameters covariances between images are not known, and count as 0.
        """
        # The covariance is H^-1 + H^-1 B^T C B H^-1, with H of each tie alone, the covariance C of
        # all images, and B between images and ties.
        total = self.of_ties.copy()
        blocks = self.reduced.inverse
        slices = self.reduced.slices
        gains = [np.einsum("tij,tkj->tik", self.of_ties[rows.tie], coupling)
                 for rows, coupling in zip(self.tie_rows, self.coupling, strict=True)]
        if blocks is None:
            for rows, gain, covariance in zip(self.tie_rows, gains, self.image_covariances,
                                              strict=True):
                np.add.at(total, rows.tie, gain @ covariance @ gain.transpose(0, 2, 1))
            return total
        for i, j, at_i, at_j in image_pairs([rows.tie for rows in self.tie_rows], len(total)):
            between = gains[i][at_i] @ blocks[slices[i], slices[j]] @ gains[j][at_j].transpose(
                0, 2, 1)
            ties = self.tie_rows[i].tie[at_i]
            # A pair of images comes once; the other way round its contribution is the transpose.
            np.add.at(total, ties, between if i == j else between + between.transpose(0, 2, 1))
        return total


class Reduced:
    """The normal matrix of all images' parameters, without the ties, factorised.

    Parameters
    ----------
    matrix : ndarray or sparse matrix, shape (size, size)
        The reduced normal matrix; a dense one is positive definite.
    sizes : sequence of int
        Number of parameters of each image, in the order of the matrix.
    """

    def __init__(self, matrix: sparse.csc_matrix | FloatArray, sizes: Sequence[int]) -> None:
        ends = np.cumsum(sizes)
        self.slices = [slice(int(end - size), int(end))
                       for end, size in zip(ends, sizes, strict=True)]
        self._matrix = matrix
        self._size = int(ends[-1])
        if isinstance(matrix, np.ndarray):
            # Small systems are dense: Cholesky's factors, as the matrix is positive definite.
            factor = linalg.cho_factor(matrix)
            self.solve: Solve = lambda right: linalg.cho_solve(factor, right)
        else:
            self.solve = splu(matrix, permc_spec="MMD_AT_PLUS_A",
                              options={"SymmetricMode": True}).solve

    def whole(self) -> FloatArray:
        """Return the reduced matrix as a dense one, (size, size)."""
        matrix = self._matrix
        return np.asarray(matrix if isinstance(matrix, np.ndarray) else matrix.toarray())

    def with_inverse(self, covariance: FloatArray) -> Reduced:
        """Return a copy whose `inverse` is the covariance (size, size) of a posterior.

        It is that over all variances, which is wider than with the estimated ones.
        """
        copied = copy(self)
        copied.inverse = covariance
        return copied

    @cached_property
    def inverse(self) -> FloatArray | None:
        """The covariance of all parameters (size, size); None if they are more than `MAX_INVERSE`.

        Raises numpy.linalg.LinAlgError if the matrix is not positive definite.
        """
        if self._size > MAX_INVERSE:
            return None
        if isinstance(self._matrix, np.ndarray):
            return np.asarray(self.solve(np.eye(self._size)))
        # LAPACK inverts a dense matrix faster than the sparse factors solve for all columns.
        factor, failed = linalg.lapack.dpotrf(self._matrix.toarray(), overwrite_a=True)
        if failed:
            raise np.linalg.LinAlgError("the reduced matrix is not positive definite")
        half, _ = linalg.lapack.dpotri(factor, overwrite_c=True)
        return np.asarray(np.triu(half) + np.triu(half, 1).T)

    def image_covariances(self) -> list[FloatArray]:
        """Return the covariance (p, p) of each image's parameters.

        If the whole inverse is too large, its columns are computed in chunks.
        """
        if self.inverse is not None:
            return [self.inverse[columns, columns] for columns in self.slices]
        blocks = []
        for first in range(0, self._size, _CHUNK):
            blocks.append(self._diagonal_blocks(first, min(first + _CHUNK, self._size)))
        return list(chain.from_iterable(blocks))

    def _diagonal_blocks(self, first: int, end: int) -> list[FloatArray]:
        """Return the covariances (p, p) of the images whose parameters begin in a range of columns.

        The range is from `first` to `end` - 1. The covariances are diagonal blocks of the inverse
        of the matrix.
        """
        in_range = [columns for columns in self.slices if first <= columns.start < end]
        if not in_range:
            return []
        start = in_range[0].start
        stop = in_range[-1].stop
        # Unit vectors of these columns, whose solutions are columns of the inverse.
        right = np.zeros((self._size, stop - start))
        right[np.arange(start, stop), np.arange(stop - start)] = 1.0
        inverse = self.solve(right)
        return [inverse[columns, columns.start - start:columns.stop - start]
                for columns in in_range]


def image_pairs(ties: Sequence[IntArray], count: int) -> list[Shared]:
    """Return each pair of images that share ties, as (i, j, rows of i, rows of j) with i <= j.

    `ties` has the indices of the ties that each image sees, below `count`. The k-th rows of both
    images are those of the same tie. An image is paired with itself, too.
    """
    # All measurements in one list, sorted by tie, then by image.
    image = np.repeat(np.arange(len(ties)), [len(tie) for tie in ties])
    row = np.concatenate([np.arange(len(tie)) for tie in ties])
    tie = np.concatenate(ties)
    order = np.lexsort((image, tie))
    image = image[order]
    row = row[order]
    tie = tie[order]
    starts = np.searchsorted(tie, np.arange(count + 1))
    degree = np.diff(starts)
    combinations: list[IntArray] = []
    # Ties that are seen equally often are treated at once.
    for size in np.unique(degree[degree > 0]):
        first = starts[:-1][degree == size]
        at = first[:, None] + np.arange(size)
        for a in range(size):
            for b in range(a, size):
                combinations.append(np.stack([image[at[:, a]], image[at[:, b]], row[at[:, a]],
                                              row[at[:, b]]]))
    shared = np.concatenate(combinations, axis=1)
    # One number for each pair of images, by which the measurements are grouped.
    key = shared[0] * len(ties) + shared[1]
    order = np.argsort(key, kind="stable")
    shared = shared[:, order]
    key = key[order]
    cuts = np.flatnonzero(np.diff(key)) + 1
    return [(int(pair[0, 0]), int(pair[1, 0]), pair[2], pair[3])
            for pair in np.split(shared, cuts, axis=1)]


def solve(
    tie_rows: Sequence[TieRows],
    of_images: Sequence[FloatArray],
    right_of_images: Sequence[FloatArray],
    of_ties: FloatArray,
    right_of_ties: FloatArray,
    sharing: Sequence[Shared],
) -> Solved:
    """Solve the normal equations for one step.

    Parameters
    ----------
    tie_rows : sequence of TieRows
        Rows of the ties of each image.
    of_images, right_of_images : sequence of ndarray, shapes (p, p) and (p,)
        What priors and control add to each image's normal equations.
    of_ties, right_of_ties : ndarray, shapes (t, 3, 3) and (t, 3)
        What priors add to each tie's.
    sharing : sequence
        Pairs of images, as `image_pairs` returns them.

    Raises
    ------
    numpy.linalg.LinAlgError
        If parameters are not determined; RuntimeError where the system is sparse.
    """
    of_ties = of_ties.copy()
    right_of_ties = right_of_ties.copy()
    coupling = []
    diagonal = []
    right = []
    for rows, of_image, right_of_image in zip(tie_rows, of_images, right_of_images, strict=True):
        # Normal equations [A B; B^T H]: A of an image, H of each tie (3 x 3), B between both.
        weight = rows.weight[:, None]
        weighted = rows.slopes * weight[:, :, None]
        np.add.at(of_ties, rows.tie, weighted.transpose(0, 2, 1) @ rows.slopes)
        np.add.at(right_of_ties, rows.tie, np.einsum("nai,na->ni", weighted, rows.residual))
        coupling.append(rows.rows.transpose(0, 2, 1) @ weighted)
        design = rows.rows.reshape(rows.rows.shape[0] * rows.rows.shape[1], rows.rows.shape[2])
        weighted_design = design * np.repeat(weight, 2, axis=0)
        diagonal.append(of_image + weighted_design.T @ design)
        right.append(right_of_image + weighted_design.T @ rows.residual.ravel())
    # H^-1 = L^-T L^-1 by Cholesky's factor of each tie, so that the Schur complement is symmetric.
    root = np.linalg.inv(np.linalg.cholesky(of_ties)).transpose(0, 2, 1)
    inverse = root @ root.transpose(0, 2, 1)
    # B L^-T of each measurement, and L^-1 b of each tie.
    half = [np.einsum("tki,tij->tkj", c, root[rows.tie])
            for c, rows in zip(coupling, tie_rows, strict=True)]
    half_right = np.einsum("tji,tj->ti", root, right_of_ties)
    sizes = [len(block) for block in diagonal]
    for i, rows in enumerate(tie_rows):
        right[i] = right[i] - np.einsum("tkj,tj->k", half[i], half_right[rows.tie])
    # The Schur complement A - B H^-1 B^T.
    matrix = _reduced_matrix(diagonal, half, sharing, sizes)
    reduced = Reduced(matrix, sizes)
    step = reduced.solve(np.concatenate(right))
    steps = tuple(step[columns] for columns in reduced.slices)
    # The steps of the ties follow from those of the images: x = H^-1 (b - B^T p).
    change = right_of_ties.copy()
    for rows, c, of_image in zip(tie_rows, coupling, steps, strict=True):
        np.add.at(change, rows.tie, -np.einsum("tki,k->ti", c, of_image))
    return Solved(steps, np.einsum("tij,tj->ti", inverse, change), reduced, tuple(coupling),
                  inverse,
                  tuple(tie_rows))


def _reduced_matrix(diagonal: Sequence[FloatArray], half: Sequence[FloatArray],
                    sharing: Sequence[Shared], sizes: Sequence[int],
                    ) -> FloatArray | sparse.csc_matrix:
    """Return the matrix of the images alone, with blocks A_ij - B_i H^-1 B_j^T.

    `diagonal` are the A_ii (p, p) of the images, and other A_ij are 0; `sizes` are their p. `half`
    has B_i L^-T of each measurement (n, p, 3) of an image, where H = L L^T, and `sharing` the pairs
    of images with common ties. The matrix is dense up to `MAX_DENSE` parameters, else sparse.
    """
    total = sum(sizes)
    ends = np.cumsum(sizes)
    begin = ends - sizes
    blocks: dict[tuple[int, int], FloatArray] = {
        (i, i): block.copy() for i, block in enumerate(diagonal)}
    for i, j, at_i, at_j in sharing:
        half_i = half[i][at_i].transpose(1, 0, 2).reshape(sizes[i], 3 * len(at_i))
        half_j = half[j][at_j].transpose(1, 0, 2).reshape(sizes[j], 3 * len(at_j))
        product = half_i @ half_j.T
        blocks[i, j] = blocks[i, j] - product if (i, j) in blocks else -product
    if total <= MAX_DENSE:
        matrix = np.zeros((total, total))
        for (i, j), block in blocks.items():
            matrix[begin[i]:ends[i], begin[j]:ends[j]] = block
            if i != j:
                matrix[begin[j]:ends[j], begin[i]:ends[i]] = block.T
        return matrix
    # Large systems are sparse: blocks of images that share no tie are left out.
    rows = []
    columns = []
    values = []
    for (i, j), block in blocks.items():
        at = np.indices(block.shape)
        # A block off the diagonal is entered a second time, transposed.
        for first, second, is_entered in ((at[0] + begin[i], at[1] + begin[j], True),
                                          (at[1] + begin[j], at[0] + begin[i], i != j)):
            if is_entered:
                rows.append(first.ravel())
                columns.append(second.ravel())
                values.append(block.ravel())
    return sparse.csc_matrix(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))),
        shape=(total, total))
