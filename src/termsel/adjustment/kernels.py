"""Many masked adjustments at once, by Householder QR in compiled code.

The work of an adjustment is the application of reflections to columns. Here the columns lie in
panels of eight, row by row, and a panel takes all earlier reflections, two at a time, before its
own columns are eliminated (left-looking). A panel stays in the first-level cache meanwhile, and
the sums of a scalar product run over rows in eight lanes, so that they vectorise without being
reordered: the result does not depend on the width of the machine's registers.

Term masks see the design matrix once. It is reduced to its k by k triangle first, which every
individual then shares: of its selected columns, the one of index c has c + 1 entries that are not
zero, and a reflection covers those alone.

Feature masks leave no such common factor, as a triangle of all rows cannot have rows taken out
without loss of accuracy (downdating squares the condition number, and designs reach 3e7). Every
individual is therefore factored from its own rows, gathered into the panels; those of many rows
are folded into their triangle block by block, so that panels never outgrow the cache. Of very
many rows `termsel.adjustment.blocks` makes k, where that is safe.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from termsel.adjustment.blocks import blocks_of, reduced_rows, where_blocks_pay
from termsel.adjustment.compiled import compile_lazily, is_compiled
from termsel.adjustment.equations import Equations
from termsel.adjustment.reflections import LANES, apply_one, apply_two
from termsel.adjustment.solve import TOLERANCE
from termsel.data.features import BoolArray, FloatArray, IntArray

# Twins in a population of masks.

def distinct_masks(columns: BoolArray, rows: BoolArray) -> tuple[IntArray, IntArray]:
    """Return the index of the first copy of each of d distinct masks, and an inverse of that.

    A mask is a row of `columns` (p, k) together with the same row of `rows` (p, n). The indices
    (d,) say where in the population each distinct mask first stands; the inverse (p,) says for each
    row of the population which of the d masks it has. Finding twins takes some hundredths of a
    solution's time, and a converging population is full of them.
    """
    bits = np.packbits(np.concatenate([columns, rows], axis=1), axis=1)
    masks = bits.view(f"V{bits.shape[1]}")[:, 0].tolist()
    numbers = np.arange(len(masks))
    if len(set(masks)) == len(masks):
        return numbers, numbers
    # Reversed, so that the first of equal masks is the one that stays.
    number_of_mask = dict(zip(reversed(masks), reversed(numbers.tolist()), strict=True))
    first_twin = np.fromiter(map(number_of_mask.__getitem__, masks), np.intp, len(masks))
    is_first = first_twin == numbers
    return numbers[is_first], (np.cumsum(is_first) - 1)[first_twin]


BLOCK = 192
"""Rows folded into a triangle at once."""

ALWAYS = -1
"""The last feature of a mask: that of pseudo-observations, if any."""

UintArray = NDArray[np.uintp]
Reflections = tuple[FloatArray, FloatArray, FloatArray, IntArray]
"""Of the reflections: vectors, factors, products of neighbours, and the rows they reach."""

# Without _nrt=False every slice would cost two atomic operations; hence nothing may be allocated.
_compiled = partial(compile_lazily, _nrt=False)


@_compiled
def _dot_product(u: FloatArray, v: FloatArray) -> float:
    """Return the scalar product of two vectors (n,)."""
    # In four sums: in a single one each addition would wait for the one before.
    a = b = c = d = 0.0
    quarter = len(v) // 4
    for i in range(quarter):
        a += u[4 * i] * v[4 * i]
        b += u[4 * i + 1] * v[4 * i + 1]
        c += u[4 * i + 2] * v[4 * i + 2]
        d += u[4 * i + 3] * v[4 * i + 3]
    for i in range(4 * quarter, len(v)):
        a += u[i] * v[i]
    return (a + b) + (c + d)


@_compiled
def _take(column: FloatArray, v: FloatArray) -> float:
    """Copy a column to `v` and return the sum of its squares."""
    for i in range(len(v)):
        v[i] = column[i]
    return _dot_product(v, v)


@_compiled
def _eliminate(panels: FloatArray, reflections: Reflections, heights: IntArray, n: int,
               tolerance: float, longest: float) -> int:
    """Bring n columns, and the right-hand side after them, to triangular form; return the rank.

    Column s has its entries in the first heights[s] rows, which do not decrease. A column that
    keeps no more than `tolerance` of its length orthogonal to those before it gets no reflection
    and no row of the triangle; with a negative tolerance none is tested. No column is longer
    than `longest`.
    """
    vectors, beta, gram, stop = reflections
    rank = 0
    for c in range(n // LANES + 1):
        # Left-looking: the panel takes all earlier reflections while it is in the cache.
        applied = rank
        for t in range(0, applied - 1, 2):
            apply_two(panels, reflections, c, t, stop[t + 1])
        if applied % 2:
            apply_one(panels, reflections, c, applied - 1, stop[applied - 1])
        for lane in range(min(LANES, n - LANES * c)):
            height = heights[LANES * c + lane]
            if rank >= height:  # no entry is left to eliminate: the column is dependent
                continue
            column = panels[c, :height, lane]
            v = vectors[rank, rank:height]
            square = _take(column[rank:], v)
            norm = np.sqrt(square)
            if tolerance >= 0.0 and norm <= tolerance * longest:
                # Reflections preserve a column's length, so that it is still known.
                for i in range(rank):
                    square += column[i] * column[i]
                if norm <= tolerance * np.sqrt(square):
                    continue
            # H = I - beta v v' with v = a -+ |a| e_1 and beta = 2 / v'v = 1 / (|a| (|a| + |a_1|)).
            # A column of one entry, or of none that is not zero, needs no reflection: beta = 0.
            diagonal = v[0]
            beta[rank] = 0.0
            if len(v) > 1 and norm > 0.0:
                beta[rank] = 1.0 / (norm * (norm + abs(diagonal)))
                norm = -norm if diagonal > 0.0 else norm  # so that nothing cancels in v[0]
                v[0] -= norm
                diagonal = norm
            stop[rank] = height
            if rank % 2:
                # Prepared to be applied together with the one before.
                before = vectors[rank - 1, rank:height]
                before[stop[rank - 1] - rank:] = 0.0
                vectors[rank, rank - 1] = 0.0
                gram[rank - 1] = _dot_product(before, v)
            if beta[rank] > 0.0 and lane < LANES - 1:
                apply_one(panels, reflections, c, rank, height)
            column[rank] = diagonal
            rank += 1
    return rank


@_compiled
def _gather(
    panels: FloatArray, source: FloatArray, rows: UintArray, columns: UintArray,
    heights: IntArray, n: int,
) -> None:
    """Copy n columns and the right-hand side after them into the panels, to their heights.

    Row i of the panels is row rows[i] of `source`, and their column s is its column columns[s].
    """
    for c in range(n // LANES + 1):
        # Heights do not decrease: the last column of a panel is the highest.
        panel_columns = columns[LANES * c:LANES * c + LANES]
        reach = min(len(rows), heights[min(LANES * c + LANES, n) - 1])
        for i in range(reach):
            target = panels[c, i]
            line = source[rows[i]]
            for lane in range(LANES):
                target[lane] = line[panel_columns[lane]]


@_compiled
def _shift_triangle_down(panels: FloatArray, n: int, shift: int) -> None:
    """Move the triangle of n columns down by `shift` rows, and clear what is below its diagonal."""
    for c in range(n // LANES + 1):
        for i in range(n - 1, -1, -1):
            for lane in range(LANES):
                # Reflections are kept apart: what is below the diagonal are remains.
                inside = LANES * c + lane >= i
                panels[c, i + shift, lane] = panels[c, i, lane] if inside else 0.0


@_compiled
def _triangularise(panels: FloatArray, reflections: Reflections, source: FloatArray,
                   triangular: bool, rows: UintArray, columns: UintArray, heights: IntArray,
                   n: int, tolerance: float, longest: float) -> int:
    """Triangularise the system of some rows and n columns of `source`; return its rank.

    More rows than the panels hold are folded in block by block, on top of the triangle of the
    rows before. Columns are then tested only when all rows are in, in a last round without a
    block of its own.
    """
    m = len(rows)
    start = 0
    triangle_rows = 0
    while True:
        block = min(m - start, panels.shape[1] - triangle_rows)
        if triangle_rows:
            _shift_triangle_down(panels, n, block)
        for s in range(n):
            # A shared triangle has zeros below the diagonal of each original column.
            reach = min(block, np.intp(columns[s]) + 1) if triangular else block
            heights[s] = reach + min(triangle_rows, s + 1)
        _gather(panels, source, rows[start:start + block], columns, heights, n)
        start += block
        # Complete if all rows were in one block, or if this round had none of its own.
        complete = start == m and (triangle_rows == 0 or block == 0)
        rank = _eliminate(panels, reflections, heights, n, tolerance if complete else -1.0, longest)
        if complete:
            return rank
        triangle_rows = n


@_compiled
def _substitute(
    panels: FloatArray, right: FloatArray, columns: UintArray, n: int, coefficients: FloatArray,
) -> None:
    """Solve the triangle of n columns for x, and write x[s] to coefficients[columns[s]].

    The triangle and, after its columns, the right-hand side lie in the panels; `right` (n,) is
    space.
    """
    for i in range(n):
        right[i] = panels[n // LANES, i, n % LANES]
    # R x = Q'b from the last row up, by columns as they lie in the panels.
    for s in range(n - 1, -1, -1):
        column = panels[s // LANES, :s + 1, s % LANES]
        x = right[s] / column[s]
        for i in range(s):
            right[i] -= x * column[i]
        coefficients[columns[s]] = x


@_compiled
def _solve_population(panels: FloatArray, reflections: Reflections, source: FloatArray,
                      triangular: bool, feature: IntArray, rows: UintArray, columns: UintArray,
                      heights: IntArray, terms: BoolArray, features: BoolArray, tolerance: float,
                      longest: float, coefficients: FloatArray, violation: IntArray) -> None:
    """Solve the systems that the p individuals of a population select.

    `source` (m, k + 2) has the columns, the right-hand side and zeros; row i is of the feature
    number `feature[i]`, and if `triangular` column j has zeros below row j. An individual selects
    columns by `terms` (p, k) and rows by the features of `features` (p, n). The selected system is
    copied into `panels` and factored by Householder `reflections`. `violation` (p,) receives how
    many terms are dependent, and where none is, `coefficients` (p, k) the solution. `tolerance` and
    `longest` are as for `_eliminate`. `rows`, `columns` and `heights` are work space, too.
    """
    k = terms.shape[1]
    for individual in range(len(terms)):
        n = 0
        for j in range(k):
            columns[n] = j  # overwritten unless selected: cheaper than a branch on chance
            n += terms[individual, j]
        if n == 0:
            continue
        columns[n] = k
        for j in range(n + 1, len(columns)):
            columns[j] = k + 1
        m = 0
        for i in range(len(feature)):  # the same for rows
            rows[m] = i
            m += features[individual, feature[i]]
        rank = _triangularise(panels, reflections, source, triangular=triangular, rows=rows[:m],
                              columns=columns, heights=heights, n=n, tolerance=tolerance,
                              longest=longest)
        violation[individual] = n - rank
        if violation[individual] == 0:
            # The factors of the reflections are needed no more: space for the right-hand side.
            _substitute(panels, reflections[1], columns, n, coefficients[individual])


def _allocate_workspace(k: int, m: int) -> tuple[FloatArray, Reflections, IntArray, UintArray]:
    """Return panels, reflections, heights and columns for up to k columns of m rows.

    The panels have the shape (width, rows, LANES): each holds LANES columns side by side, and k + 1
    columns are needed in all, one for the right-hand side. `columns` is at first in order.
    """
    width = k // LANES + 1
    rows = min(m, k + BLOCK)
    # Lanes after the last column copy the right-hand side: any column that there is will do.
    columns = np.full(width * LANES, k + 1, dtype=np.uintp)
    columns[:k + 1] = np.arange(k + 1)
    reflections = np.zeros((k, rows)), np.zeros(k), np.zeros(k), np.zeros(k, dtype=np.intp)
    # Panels begin on a cache line, as each of their rows fills one.
    size = width * rows * LANES
    space = np.zeros(size + LANES)
    start = -space.__array_interface__["data"][0] // space.itemsize % LANES
    panels = space[start:start + size].reshape(width, rows, LANES)
    return panels, reflections, np.zeros(k, dtype=np.intp), columns


def _reduce_to_triangle(source: FloatArray) -> FloatArray:
    """Return k rows (at most m) with the same solutions as the source, (m, k + 2), by reflections.

    Not by LAPACK, whose rounding varies from machine to machine.
    """
    m = source.shape[0]
    k = source.shape[1] - 2
    panels, reflections, heights, columns = _allocate_workspace(k, m)
    # One individual, which has all columns and all rows; no column is tested for dependence.
    _solve_population(panels, reflections, source, triangular=False,
                      feature=np.zeros(m, dtype=np.intp), rows=np.empty(m, dtype=np.uintp),
                      columns=columns, heights=heights, terms=np.ones((1, k), dtype=bool),
                      features=np.ones((1, 1), dtype=bool), tolerance=-1.0, longest=0.0,
                      coefficients=np.empty((1, k)), violation=np.empty(1, dtype=np.intp))
    triangle = np.zeros((min(m, k), k + 2))
    # Below the diagonal the panels still have what reflections left there.
    by_rows = panels.transpose(1, 0, 2).reshape(panels.shape[1], panels.shape[0] * LANES)
    triangle[:, :k + 1] = np.triu(by_rows[:len(triangle), :k + 1])
    return triangle


@dataclass(frozen=True, eq=False)
class _Prepared:
    """Data common to all populations over the same equations."""

    # (m, k + 2): design matrix, right-hand side, and zeros that fill up the last panel.
    source: FloatArray
    feature: IntArray  # (m,)
    triangle: FloatArray  # (min(m, k), k + 2): the same after reduction to a triangle by QR
    longest: float  # length of the longest column

    @cached_property
    def blocks(self) -> FloatArray | None:
        """Normal equations by feature (see `blocks_of`); None if they do not pay or are unsafe."""
        return blocks_of(self.source, self.feature, self.triangle)


_PREPARED: WeakKeyDictionary[Equations, _Prepared] = WeakKeyDictionary()
"""Held by the equations of a problem, which each generation of a search solves, and gone with them.
"""


def _kept_data_of(equations: Equations) -> _Prepared:
    """Return the data kept for the equations, computed the first time."""
    prepared = _PREPARED.get(equations)
    if prepared is None:
        A, b = equations.with_prior()
        source = np.column_stack([A, b, np.zeros(len(b))])
        source = np.ascontiguousarray(source, dtype=np.float64)
        feature = np.full(len(b), ALWAYS, dtype=np.intp)
        feature[:len(equations.feature)] = equations.feature  # pseudo-observations come last
        prepared = _Prepared(source, feature, _reduce_to_triangle(source),
                             float(np.linalg.norm(source[:, :-2], axis=0).max(initial=0.0)))
        _PREPARED[equations] = prepared
    return prepared


def solve_many(equations: Equations, terms: BoolArray | None, features: BoolArray | None,
               ) -> tuple[FloatArray, IntArray]:
    """Solve a population of masked least-squares systems.

    A term is dependent if it keeps no more than `termsel.adjustment.solve.TOLERANCE` of its length
    over the selected rows once the selected terms before it are removed. Masks that occur several
    times are solved once. The result of an individual does not depend on the others. What is
    computed from the equations alone is kept as long as the object lives, so its arrays must not be
    changed afterwards.

    Terms (p, k) and features (p, n_features) are masks of what is selected, None where everything
    is. Returns the coefficients (p, k), 0 where a term is not selected, and all 0 for a mask
    without a unique solution; and the violations (p,), selected terms minus rank.

    Raises ValueError for masks whose shapes do not fit the equations.
    """
    shared = _kept_data_of(equations)
    k = equations.A.shape[1]
    p = next((len(mask) for mask in (terms, features) if mask is not None), 1)
    columns = np.ones((p, k), dtype=bool) if terms is None else np.asarray(terms, dtype=bool)
    if features is None:
        # The triangle's rows belong to no feature: one feature with all of them is always on.
        source = shared.triangle
        feature = np.zeros(len(shared.triangle), dtype=np.intp)
        rows = np.ones((p, 1), dtype=bool)
    else:
        source = shared.source
        feature = shared.feature
        rows = np.asarray(features, dtype=bool)
        if equations.prior is not None:
            rows = np.concatenate([rows, np.ones((len(rows), 1), dtype=bool)], axis=1)
    if columns.shape != (p, k) or len(rows) != p or rows.shape[1] <= feature.max(initial=-1):
        raise ValueError(f"masks of shapes {columns.shape} and {rows.shape} do not fit {k} terms "
                         f"and {equations.n_features} features")
    # One memory layout for all, or code would be compiled for each.
    columns = np.require(columns, requirements=("C", "W"))
    rows = np.require(rows, requirements=("C", "W"))
    distinct, number_of_each = distinct_masks(columns, rows)
    if len(distinct) < p:
        columns = columns[distinct]
        rows = rows[distinct]
    coefficients = np.zeros(columns.shape)
    violation = np.zeros(len(distinct), dtype=np.intp)
    panels, reflections, heights, index = _allocate_workspace(k, len(source))
    order = np.zeros(len(source), dtype=np.uintp)

    def factor(individuals: slice, system: FloatArray, feature: IntArray, rows: BoolArray) -> None:
        # By position: keywords take some 2 us a call, and with blocks every individual is one.
        _solve_population(panels, reflections, system, system is not shared.source, feature, order,
                          index, heights, columns[individuals], rows, TOLERANCE, shared.longest,
                          coefficients[individuals], violation[individuals])

    # Rows are factored unless blocks of features pay, which `reduced` decides for each individual.
    if features is None or shared.blocks is None:
        factor(slice(None), source, feature, rows)
    else:
        single_feature = np.zeros(k, dtype=np.intp), np.ones((1, 1), dtype=bool)
        for individuals, small_system in reduced_rows(shared.blocks, shared.triangle[:, :k], rows,
                                                      where_blocks_pay(feature, columns, rows)):
            if small_system is None:
                factor(individuals, source, feature, rows[individuals])
            else:
                factor(individuals, small_system, *single_feature)
    if len(distinct) == p:
        return coefficients, violation
    return coefficients[number_of_each], violation[number_of_each]


def needs_compilation() -> bool:
    """Return True if the first evaluation will spend some seconds on compilation.

    It does so once per machine and version; later the machine code is read from disk.
    """
    return not is_compiled(_solve_population)
