"""Shrunken solutions of many sets of scales at once, without singular values.

Of a matrix M = U B V', B lower bidiagonal with diagonal d and c below it, the inverse of
I + s^2 M M' = U (I + s^2 B B') U' takes no more than B: with R upper bidiagonal and
R'R = I + s^2 B B',

    r_i^2 = s^2 d_i^2 + rest_i,    upper_i = s^2 d_i c_i / r_i,
    rest_1 = 1,    rest_(i+1) = 1 + rest_i s^2 c_i^2 / r_i^2,

nothing of which cancels. So one bidiagonal form, a fifth of the work of singular values, serves
solutions of all sizes s. Matrices lie side by side, so that each step is one for all of them:
sums are taken in one order whatever the width of the machine's registers.

References
----------
Golub and Kahan 1965, SIAM J. Numer. Anal. B 2(2), for the bidiagonal form; Elden 1977, BIT 17, for
regularised solutions by it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from termsel.adjustment.compiled import compile_lazily
from termsel.data.features import FloatArray, IntArray

ROWS_PER_LOG = 8
"""Rows whose squares are multiplied before a logarithm is taken: they do not overflow."""

POINTS_PER_REFLECTION = 128
"""Points that are worked on together: what is read again stays in a cache."""

# Nothing is allocated, and sums are taken in the order in which they are written.
_compiled = partial(compile_lazily, _nrt=False)


@dataclass(frozen=True, eq=False)
class Bidiagonal:
    """The bidiagonal forms of g matrices of m rows."""

    rotation: FloatArray  # (g, m, m): U'
    diagonal: FloatArray  # (m, g)
    below: FloatArray  # (m, g): below the diagonal, and a last number of no meaning


def bidiagonal_forms(matrix: FloatArray, scales: FloatArray) -> Bidiagonal:
    """Return the bidiagonal forms of a matrix (m, k), m <= k, under several scales of its columns.

    There is one form for each row of `scales` (g, k), by which the columns are multiplied.
    """
    m = len(matrix)
    count = len(scales)
    # The forms lie side by side, last, so that each step is one loop over all of them.
    matrices = np.multiply(matrix[:, :, None], scales.T, order="C")
    rotation = np.zeros((m, m, count))
    rotation[np.arange(m), np.arange(m)] = 1.0
    diagonal, below = np.zeros((2, m, count))
    _bidiagonalise(matrices, rotation, diagonal, below, np.empty((2, count)))
    return Bidiagonal(np.ascontiguousarray(rotation.transpose(2, 1, 0)), diagonal, below)


def evidence_of(forms: Bidiagonal, targets: FloatArray,
                sizes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return log factors, (g, s), and sums of squares, (a, g, s), of the solutions of all sizes.

    There are g forms M and s sizes, which are the numbers of `sizes` (s,). Of a form M and a size t
    the log factor is log |I + t^2 M M'|^-1/2, and the sum of squares y' (I + t^2 M M')^-1 y, for
    each of the a columns y of `targets` (m, a).
    """
    _, count = forms.diagonal.shape
    # (a, m, g): U'y, the targets along the columns of U.
    along = np.ascontiguousarray((forms.rotation @ targets).transpose(2, 1, 0))
    logs = np.zeros((len(sizes), count))
    squares = np.zeros((len(sizes), len(along), count))
    _add_evidence(forms.diagonal, forms.below, along, sizes**2, logs, squares,
                  np.empty((4, count)), np.empty((len(along), count)))
    return logs.T, squares.transpose(1, 2, 0)


class BidiagonalSolutions:
    """Residuals and redundancies of u solutions.

    Each is of one of the forms, by its number in `form` (u,), and of one s^2 of `squared_sizes`.
    """

    def __init__(self, forms: Bidiagonal, form: IntArray, squared_sizes: FloatArray) -> None:
        """Factor the system of each solution, R'R, and sum up the trace of its inverse."""
        self._rotation = forms.rotation
        self._form = form
        diagonal = forms.diagonal[:, form]
        self._root, self._upper = np.empty((2, *diagonal.shape))
        self.traces = np.zeros(len(form))  # of (I + s^2 M M')^-1
        _fill_factors(diagonal, forms.below[:, form], squared_sizes, self._root, self._upper,
                      self.traces, np.empty(len(form)))

    def residuals(self, target: FloatArray) -> FloatArray:
        """Return the residuals of every solution for a target (m,), shape (u, m)."""
        along = (self._rotation @ target).T.take(self._form, axis=1)              # (m, u): U'y
        residuals = np.zeros((len(self._form), len(target)))
        _add_shrunken_residuals(self._root, self._upper, along, self._rotation, self._form,
                                residuals)
        return residuals

    def redundancies(self, directions: FloatArray) -> FloatArray:
        """Return b' (I + s^2 M M')^-1 b for u solutions and n directions b, shape (u, n).

        The directions are the columns of `directions` (m, n); M is the form of a solution, s its
        size.
        """
        n = directions.shape[1]
        quadratic_forms = np.empty((len(self._form), n))
        for start in range(0, n, POINTS_PER_REFLECTION):
            points = slice(start, min(start + POINTS_PER_REFLECTION, n))
            along = self._rotation @ directions[:, points]                    # (g, m, points): U'b
            sums = np.zeros((len(self._form), along.shape[2]))
            z = np.empty(along.shape[2])  # scratch: R'z = U'b, whose |z|^2 is the form
            _add_redundancies(self._root, self._upper, along, self._form, sums, z)
            quadratic_forms[:, points] = sums
        return quadratic_forms


@_compiled
def eliminate(systems: FloatArray, count: int) -> None:
    """Eliminate the first `count` rows of symmetric matrices, in place.

    `systems` (p, l) has the p entries of the lower triangles of l matrices, row by row. On the
    diagonal stand the pivots afterwards, and behind the eliminated rows the Schur complements.
    """
    size = 0
    while size * (size + 1) // 2 < len(systems):
        size += 1
    # S = L D L': with the column s below the pivot d, the factor is f = s / d, and what is left of
    # the rows below becomes S - f d f'.
    for j in range(count):
        pivot = systems[j * (j + 1) // 2 + j]
        for i in range(size - 1, j, -1):
            factor = systems[i * (i + 1) // 2 + j]
            for lane in range(len(pivot)):
                factor[lane] /= pivot[lane]
            # Columns up to the diagonal: of the rows above, the entries are not divided yet.
            for k in range(j + 1, i):
                _subtract_products(factor, systems[k * (k + 1) // 2 + j],
                                   systems[i * (i + 1) // 2 + k])
            target = systems[i * (i + 1) // 2 + i]
            for lane in range(len(pivot)):
                target[lane] -= factor[lane] * factor[lane] * pivot[lane]


@_compiled
def _subtract_products(x: FloatArray, y: FloatArray, target: FloatArray) -> None:
    """Subtract x y from the target, lane by lane."""
    for lane in range(len(target)):
        target[lane] -= x[lane] * y[lane]


@_compiled
def sweep(systems: FloatArray, count: int, work: FloatArray) -> None:
    """Sweep the first `count` rows of symmetric matrices [[A, B'], [B, C]], in place.

    Of A, which is positive definite, the result is -A^-1, of B it is B A^-1, and of C the Schur
    complement C - B A^-1 B'. `systems` (p, l) has the p entries of the lower triangles of l
    matrices, row by row; `work` (size, l) is scratch. An infinite entry on the diagonal of A leaves
    its row and column out.
    """
    size = len(work)
    for k in range(count):
        pivot = systems[k * (k + 1) // 2 + k]
        # Column k by the pivot: the row of the lower triangle up to it, and its column below.
        for i in range(size):
            if i != k:
                high = max(i, k)
                column = systems[high * (high + 1) // 2 + min(i, k)]
                for lane in range(len(pivot)):
                    work[i, lane] = column[lane] / pivot[lane]
        # a_ij becomes a_ij - a_ik a_jk / a_kk.
        for i in range(size):
            for j in range(i + 1):
                if i != k and j != k:
                    high = max(j, k)
                    _subtract_products(work[i], systems[high * (high + 1) // 2 + min(j, k)],
                                       systems[i * (i + 1) // 2 + j])
        for i in range(size):
            if i != k:
                high = max(i, k)
                column = systems[high * (high + 1) // 2 + min(i, k)]
                for lane in range(len(pivot)):
                    column[lane] = work[i, lane]
        for lane in range(len(pivot)):
            pivot[lane] = -1.0 / pivot[lane]


@_compiled
def _sum_squares(rows: FloatArray, first: int, step: int, count: int, total: FloatArray) -> None:
    """Sum the squares of `count` rows (., g), each `step`-th from `first` on, into `total` (g,)."""
    total[:] = 0.0
    for i in range(count):
        x = rows[first + i * step]
        for lane in range(len(total)):
            total[lane] += x[lane] * x[lane]


@_compiled
def _reflect(vectors: FloatArray, first: int, step: int, factor: FloatArray, rows: FloatArray,
             first_row: int, row_step: int, count: int, total: FloatArray) -> None:
    """Apply reflections I - factor v v', one for each of g matrices, to `count` entries in place.

    The entries of v are every `step`-th row (g,) of `vectors` from `first` on, and those that are
    reflected every `row_step`-th of `rows` from `first_row` on. `factor` (g,); `total` (g,) is
    scratch.
    """
    # x becomes x - factor (v'x) v: first v'x of all matrices, then what it takes from each entry.
    total[:] = 0.0
    for i in range(count):
        v = vectors[first + i * step]
        row = rows[first_row + i * row_step]
        for lane in range(len(total)):
            total[lane] += v[lane] * row[lane]
    for lane in range(len(total)):
        total[lane] *= factor[lane]
    for i in range(count):
        v = vectors[first + i * step]
        row = rows[first_row + i * row_step]
        for lane in range(len(total)):
            row[lane] -= total[lane] * v[lane]


@_compiled
def _make_reflection(head: FloatArray, squares: FloatArray, factor: FloatArray,
                     image: FloatArray) -> None:
    """Make the reflections I - factor v v' that bring g vectors into their first direction.

    `head` (g,), the first entries of the vectors, become those of v; all further entries are those
    of v already. `squares` (g,) are the sums of squares of the vectors. Filled in are `factor`
    (g,), and `image` (g,), the only entry of each reflected vector that is not 0, of such a sign
    that nothing cancels.
    """
    for lane in range(len(head)):
        length = np.sqrt(squares[lane])
        image[lane] = -length if head[lane] > 0.0 else length
        head[lane] -= image[lane]
        factor[lane] = -1.0 / (image[lane] * head[lane]) if length > 0.0 else 0.0


@_compiled
def _bidiagonalise(matrices: FloatArray, rotation: FloatArray, diagonal: FloatArray,
                   below: FloatArray, work: FloatArray) -> None:
    """Bring g matrices (m, k, g), which are overwritten, into bidiagonal form.

    Filled in are `diagonal` and `below` (m, g). U' is applied to the c columns of `rotation`
    (c, m, g), in place; `work` (2, g) is scratch. Reflections of columns and of rows alternate, and
    keep each other's zeros.
    """
    m, k, lanes = matrices.shape
    entries = matrices.reshape(m * k, lanes)  # row by row
    turned = rotation.reshape(len(rotation) * m, lanes)
    factor, total = work
    for i in range(m):
        # Row i: its entries right of the diagonal are brought to 0, for all matrices at once.
        head = i * k + i
        _sum_squares(entries, head, 1, k - i, total)
        _make_reflection(entries[head], total, factor, diagonal[i])
        for row in range(i + 1, m):
            _reflect(entries, head, 1, factor, entries, row * k + i, 1, k - i, total)
        if i + 1 == m:
            break
        # Column i: its entries below the one next to the diagonal are brought to 0.
        head += k
        rows = m - i - 1
        _sum_squares(entries, head, k, rows, total)
        _make_reflection(entries[head], total, factor, below[i])
        for column in range(i + 1, k):
            _reflect(entries, head, k, factor, entries, (i + 1) * k + column, k, rows, total)
        for column in range(len(rotation)):
            _reflect(entries, head, k, factor, turned, column * m + i + 1, 1, rows, total)


@_compiled
def _add_evidence(diagonal: FloatArray, below: FloatArray, along: FloatArray,
                  squared_sizes: FloatArray, logs: FloatArray, squares: FloatArray,
                  work: FloatArray, solved: FloatArray) -> None:
    """Add to `logs` (s, g) -log |I + s^2 B B'| / 2, and to `squares` (s, a, g) |R'^-1 U'y|^2.

    B of each of the g groups is lower bidiagonal, with `diagonal` and `below` (m, g); R is
    Cholesky's factor of I + s^2 B B'. `along` (a, m, g) is U'y of a axes, `squared_sizes` (s,) are
    s^2; `work` (4, g) and `solved` (a, g) are scratch.
    """
    m, count = diagonal.shape
    rest, root, upper, product = work
    for size in range(len(squared_sizes)):
        square = squared_sizes[size]
        rest[:] = 1.0
        upper[:] = 0.0
        product[:] = 1.0
        solved[:] = 0.0
        # Row i of Cholesky's R of I + s^2 B B', which is tridiagonal: its diagonal is `root`, and
        # `upper` is the entry beside that of the row before.
        for i in range(m):
            for g in range(count):
                along_diagonal = square * diagonal[i, g] * diagonal[i, g]
                product[g] *= along_diagonal + rest[g]
                root[g] = np.sqrt(along_diagonal + rest[g])
            # R'z = U'y, one row after the other.
            for axis in range(len(along)):
                z = solved[axis]
                y = along[axis, i]
                total = squares[size, axis]
                for g in range(count):
                    z[g] = (y[g] - upper[g] * z[g]) / root[g]
                    total[g] += z[g] * z[g]
            for g in range(count):
                ratio = below[i, g] / root[g]
                upper[g] = square * diagonal[i, g] * ratio
                rest[g] = 1.0 + rest[g] * square * ratio * ratio
            # One logarithm for several rows: their product does not overflow yet.
            if (i + 1) % ROWS_PER_LOG == 0 or i + 1 == m:
                for g in range(count):
                    logs[size, g] -= 0.5 * np.log(product[g])
                product[:] = 1.0


@_compiled
def _fill_factors(diagonal: FloatArray, below: FloatArray, squared_sizes: FloatArray,
                  root: FloatArray, upper: FloatArray, traces: FloatArray,
                  rest: FloatArray) -> None:
    """Fill in R, as `root` (its diagonal) and `upper` (m, u), and traces (u,) of (R'R)^-1.

    `diagonal` and `below` (m, u) are of each solution's form; `rest` (u,) is scratch.
    """
    m, count = diagonal.shape
    rest[:] = 1.0
    for i in range(m):
        for u in range(count):
            along_diagonal = squared_sizes[u] * diagonal[i, u]
            root[i, u] = np.sqrt(along_diagonal * diagonal[i, u] + rest[u])
            ratio = below[i, u] / root[i, u]
            upper[i, u] = along_diagonal * ratio
            rest[u] = 1.0 + rest[u] * squared_sizes[u] * ratio * ratio
    # A row of R^-1 is (unit vector - upper_i row below) / r_i, so that the square of its length,
    # which the trace sums, is (1 + upper_i^2 that of the row below) / r_i^2.
    rest[:] = 0.0
    for i in range(m - 1, -1, -1):
        for u in range(count):
            next_square = upper[i, u] * upper[i, u] * rest[u] if i + 1 < m else 0.0
            rest[u] = (1.0 + next_square) / (root[i, u] * root[i, u])
            traces[u] += rest[u]


@_compiled
def _add_shrunken_residuals(root: FloatArray, upper: FloatArray, along: FloatArray,
                            rotation: FloatArray, form: IntArray, residuals: FloatArray) -> None:
    """Add U w, where R'R w = U'y, to `residuals` (u, m).

    R is `root` (its diagonal) and `upper` (m, u); `along` (m, u) is U'y and is overwritten by w;
    `rotation` (g, m, m) is U', and `form` (u,) the number of each solution's form in it.
    """
    m, count = root.shape
    # Down R', which has one diagonal below its own, and up R.
    for i in range(m):
        for u in range(count):
            solved = upper[i - 1, u] * along[i - 1, u] if i > 0 else 0.0
            along[i, u] = (along[i, u] - solved) / root[i, u]
    for i in range(m - 1, -1, -1):
        for u in range(count):
            solved = upper[i, u] * along[i + 1, u] if i + 1 < m else 0.0
            along[i, u] = (along[i, u] - solved) / root[i, u]
    for u in range(count):
        for i in range(m):
            for c in range(m):
                residuals[u, c] += along[i, u] * rotation[form[u], i, c]


@_compiled
def _add_redundancies(root: FloatArray, upper: FloatArray, along: FloatArray, form: IntArray,
                      redundancies: FloatArray, z: FloatArray) -> None:
    """Add |z|^2, where R'z = U'b, to `redundancies` (u, n) of n directions b.

    R is `root` (its diagonal) and `upper` (m, u); `along` (g, m, n) is U'b of all forms, `form`
    (u,) the number of each solution's form in it; `z` (n,) is scratch.
    """
    m = len(root)
    # Forward substitution: z_i = (y_i - upper_(i-1) z_(i-1)) / root_i, of which one is kept.
    for u in range(len(form)):
        total = redundancies[u]
        z[:] = 0.0
        for i in range(m):
            inverse = 1.0 / root[i, u]
            factor = upper[i - 1, u] if i > 0 else 0.0
            y = along[form[u], i]
            for point in range(len(z)):
                z[point] = (y[point] - factor * z[point]) * inverse
                total[point] += z[point] * z[point]
