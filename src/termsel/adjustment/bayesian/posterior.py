"""The posterior of a regularised polynomial: all solutions on a grid of scales, and their weights.

`termsel.auto.shrunken` says what the prior is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial

import numpy as np

from termsel.adjustment.bayesian.bidiagonal import eliminate, evidence_of
from termsel.adjustment.bayesian.held_out import (
    AxisErrors,
    HeldOutPredictions,
    WeightedCells,
    concatenate_batches,
    leave_each_point_out,
    mean_probability,
)
from termsel.adjustment.bayesian.shrinkage import (
    CANCELLATION,
    MIN_REDUNDANCY,
    AxisSolutions,
    Design,
    PointSelection,
    designs_of,
    shrinkage_of,
)
from termsel.adjustment.compiled import compile_lazily
from termsel.data.features import FloatArray, IntArray
from termsel.data.monomials import Exponents, evaluate_monomials

# Nothing is allocated, and sums are taken in the order in which they are written.
_compiled = partial(compile_lazily, _nrt=False)

PRIOR_SIZES = np.append(0.0, 10.0 ** np.arange(-0.5, 5.5, 0.5))
"""Standard deviations of quadratic coefficients by that of the noise: 0, which is the affine model,
and from where they cannot be distinguished from 0 to where they are as good as free."""

AFFINE_PROBABILITY = 0.25
"""Probability of an affine image before the points are looked at."""

TYPICAL_SIZE = 10.0
"""Size beyond which larger ones are ever less likely, in proportion: the tail of a half-Cauchy
prior. Where few points leave hardly any redundancy, the data do not exclude that there is no noise
and all sizes are huge; this does."""

FALLS = (0.01, 0.03, 0.1, 0.3)
"""Cubic coefficients by quadratic ones."""

SLOW_FALL = 0.6
"""Coefficients of a degree by those of the one below, where a series falls slowly: that of a
projection in latitudes up to 75 degrees, or of a half of the Earth."""

RELIEFS = (0.03, 0.1, 0.3, 1.0)
"""Coefficients of one power of Z more, by those without."""

N_DRAWS = 64
"""How often factors of single terms are drawn, apart from 1 for all, divided among all pairs of a
fall and a relief."""

DRAW_DEVIATION = 1.0
"""Standard deviation of these factors, in natural logarithms."""

NO_NOISE = 1e-11
"""Noise that counts as none, as a part of the image's half-range."""

POINTS_AT_ONCE = 1 << 13
"""Points that are left out in one go."""

MAX_LOG_RATIO = 30.0
"""Solutions less likely than the likeliest by this, in natural logarithms, are left out."""


@dataclass(frozen=True, eq=False)
class AxisEvidence:
    """How likely each solution of one axis is: g groups of scales by s sizes, a row of g s.

    Prior times marginal likelihood of a solution is S^(-nu/2) exp(log_factor), with nu degrees of
    freedom.
    """

    # (g s,): logarithm of the prior of the size times |I + s^2 M M'|^-1/2.
    log_factor: FloatArray
    # (g s,): S = y' (I + s^2 M M')^-1 y, with what no column explains; in squared image units.
    square: FloatArray


def scales_of(exponents: IntArray, draws: int | None = None,
              falls: tuple[float, ...] = FALLS) -> FloatArray:
    """Return standard deviations of the shrunken coefficients for size 1, shape (g, k).

    The standard deviation of the coefficient of X^a Y^b Z^c is fall^(a + b + c - 2) relief^c: for
    each fall and relief of the grid as it is, then each with factors of single terms, `draws` in
    all.
    """
    return _scales_of(tuple(map(tuple, exponents.tolist())), N_DRAWS if draws is None else draws,
                      falls)


@lru_cache(maxsize=32)  # a prior is the same for all data
def _scales_of(exponents_of_terms: Exponents, draws: int, falls: tuple[float, ...]) -> FloatArray:
    """Return scales (s, k) of the terms, from rules and from draws about them (see `scales_of`).

    Each rule is fall^(order - 2) relief^(power of Z); draws are its log-normal neighbours.
    """
    exponents = np.array(exponents_of_terms)
    order = exponents.sum(axis=1)
    height = exponents[:, 2]
    # Of terms without heights, or of one order, a further fall would say the same again.
    reliefs = RELIEFS if height.any() else (1.0,)
    rules = []
    for fall in falls if order.max() > 2 else (1.0,):
        for relief in reliefs:
            rules.append(fall ** (order - 2.0) * relief ** height)
    rule = np.array(rules)
    # Single terms may stand out from a rule: each draw has a factor for each term.
    rng = np.random.default_rng(0)
    factors = np.exp(DRAW_DEVIATION * rng.standard_normal((draws // len(rule), *rule.shape)))
    scales = np.concatenate([rule, (rule * factors).reshape(-1, rule.shape[1])])
    scales.setflags(write=False)
    return scales


def log_prior_of_sizes() -> FloatArray:
    """Return the logarithm of the prior weight of each of PRIOR_SIZES, of their shape.

    That of 0 is half of that of an affine image, as line and sample are affine together.
    """
    logs = -0.5 * np.log1p((PRIOR_SIZES / TYPICAL_SIZE) ** 2)
    positive = PRIOR_SIZES > 0.0
    affine_odds = AFFINE_PROBABILITY / (1.0 - AFFINE_PROBABILITY)
    logs[~positive] = np.log(np.exp(logs[positive]).sum()) + 0.5 * np.log(affine_odds)
    return np.asarray(logs)


def _axis_evidence(designs: Sequence[Design], targets: FloatArray) -> list[list[AxisEvidence]]:
    """Return how likely the solutions of each axis are, for all scales and sizes, of each design.
    """
    projections = np.array([design.basis.T @ targets for design in designs])          # (d, m, a)
    log_prior = log_prior_of_sizes()
    evidence = []
    for design, projected, shared in zip(
        designs, projections, _evidence_with_shared_scales(designs, projections), strict=True
    ):
        log_factor, squares = shared or evidence_of(design.forms, projected, PRIOR_SIZES)
        log_factor = (log_factor + log_prior).ravel()
        # What no column explains is in the sum of squares of every solution.
        unexplained_squares = (design.unexplained_part(targets) ** 2).sum(axis=0)
        evidence.append([AxisEvidence(log_factor, unexplained + square.ravel())
                         for unexplained, square in zip(unexplained_squares, squares, strict=True)])
    return evidence


def _evidence_with_shared_scales(designs: Sequence[Design], projections: FloatArray,
                                 ) -> list[tuple[FloatArray, FloatArray] | None]:
    """Return log factors (g, s) and sums of squares (a, g, s) of each design, in its own basis.

    `projections` (d, m, a) are the targets y of all axes in the bases of the d designs. One
    decomposition serves all groups: that of the columns which share one scale. With W what a
    size leaves along it, and C the few other columns times their scales, a sum of squares is
    y'W y - y'W C (I + C'W C)^-1 C'W y. A design has None in place of both where no columns share a
    scale, and where rounding errors matter, as hardly anything remains of that difference.
    """
    decompositions = [design.shared_decomposition for design in designs
                      if design.shared_decomposition is not None]
    if not decompositions:
        return [None] * len(designs)
    # All designs have the same scales.
    scales_of_designs = designs[0].scales
    n_own = designs[0].n_own
    groups = len(scales_of_designs)
    scales = _shared_scales(scales_of_designs[:, :n_own + 1].tobytes(), PRIOR_SIZES.tobytes(),
                            n_own, projections.shape[2])
    u, values = (np.array(factors) for factors in zip(*decompositions, strict=True))
    own = np.array([design.shrunken[:, :n_own] for design in designs])
    rotated = u.swapaxes(1, 2) @ np.concatenate([own, projections], axis=2)
    rows, columns = scales.pairs
    shrink = 1.0 / (1.0 + np.multiply.outer(values, scales.shared) ** 2)             # (d, m, r)
    grams = (rotated[..., rows] * rotated[..., columns]).swapaxes(1, 2) @ shrink     # (d, p, r)
    # I + C'W C with rows of y'W C and y'W y, for all groups and sizes.
    systems = grams.take(scales.number, axis=2)
    common_squares = systems[:, scales.target_pairs]
    systems *= scales.products
    systems[:, scales.diagonal_pairs] += 1.0
    for system in systems:
        eliminate(system, n_own)
    squares = systems[:, scales.target_pairs]
    is_exact = (squares > CANCELLATION * common_squares).all(axis=(1, 2))
    # The roots of the pivots are the diagonal of L, I + C'W C = L L'.
    logs = 0.5 * (np.log(shrink).sum(axis=1).take(scales.number, axis=1)
                  - np.log(systems[:, scales.diagonal_pairs]).sum(axis=1))
    return [(log.reshape(groups, -1), square.reshape(len(square), groups, -1)) if exact else None
            for log, square, exact in zip(logs, squares, is_exact, strict=True)]


@dataclass(frozen=True, eq=False)
class _SharedScales:
    """Scales of columns by size, of designs that have but few columns with scales of their own.

    Groups and sizes are l pairs, those of one group one after the other.
    """

    shared: FloatArray  # (r,): different scales of the other columns
    number: IntArray  # (l,): which of these a group and size has
    pairs: tuple[IntArray, IntArray]  # (p,): rows and columns of a lower triangle, row by row
    products: FloatArray  # (p, l): of the scales of both
    diagonal_pairs: IntArray  # which pairs are the diagonal of the own columns
    target_pairs: IntArray  # and which that of the targets


@lru_cache(maxsize=16)  # a prior is the same for all data
def _shared_scales(scales: bytes, sizes: bytes, n_own: int, targets: int) -> _SharedScales:
    """Return the scales of all solutions, with what they have in common for a fast solution.

    A solution has a size and a group. `scales` (g, n_own + 1) has those of n_own columns in each
    group, and last the one that all other columns share; `sizes` are all that a scale is multiplied
    by. Both arrays come as their bytes, as the cache needs a key. `targets` is the number of
    columns, scaled by 1, that follow the `n_own` ones.
    """
    scales_of_groups = np.frombuffer(scales).reshape(-1, n_own + 1)
    by_size = (np.frombuffer(sizes)[:, None] * scales_of_groups[:, None]).reshape(-1, n_own + 1)
    # Many solutions shrink the other columns alike; these then need one factorisation.
    shared, number = np.unique(by_size[:, n_own], return_inverse=True)
    columns = np.concatenate([by_size[:, :n_own], np.ones((len(by_size), targets))], axis=1).T
    rows_of_pairs, columns_of_pairs = np.tril_indices(n_own + targets)
    diagonal = np.flatnonzero(rows_of_pairs == columns_of_pairs)
    return _SharedScales(shared, number, (rows_of_pairs, columns_of_pairs),
                         columns[rows_of_pairs] * columns[columns_of_pairs],
                         diagonal[:n_own], diagonal[n_own:])


@dataclass(frozen=True, eq=False)
class GridCells:
    """The c cells of the grid that matter: each a group, a size of line and a size of sample."""

    solutions: tuple[IntArray, IntArray]  # (c,) each: which solution of line and which of sample
    share: FloatArray  # (c,): how likely
    log_evidence: float  # evidence of all, as a logarithm, up to what the measurements alone say


def _grid_cells(line: AxisEvidence, sample: AxisEvidence, freedom: int, noise: float, *,
                affine: bool) -> GridCells:
    """Return the likely cells of the grid of group, size of line and size of sample.

    Cells that are less likely than the likeliest by MAX_LOG_RATIO are left out. `noise` is the sum
    of squares that counts as none. An image is affine in both line and sample, or in neither;
    `affine` says whether it may be.
    """
    # Both axes have the same group of scales; each has a size of its own.
    count = len(PRIOR_SIZES)
    line_log, sample_log, line_square, sample_square = (
        values.reshape(-1, count) for values in (line.log_factor, sample.log_factor, line.square,
                                                 sample.square))
    log_posterior = line_square[:, :, None] + sample_square[:, None]                  # (g, s, s)
    log_posterior += noise
    np.log(log_posterior, out=log_posterior)
    # Without quadratic terms all groups are one: the first has the probability of all.
    log_affine = -np.inf
    if affine and PRIOR_SIZES[0] == 0.0:
        log_affine = (line_log[0, 0] + sample_log[0, 0] - freedom / 2 * log_posterior[0, 0, 0]
                      + np.log(len(log_posterior)))
    of_line, of_sample = np.empty((2, log_posterior.size), dtype=np.intp)
    logs = np.empty(log_posterior.size)
    n_cells = _fill_likely_cells(log_posterior, line_log, sample_log, freedom / 2, log_affine,
                                 PRIOR_SIZES, of_line, of_sample, logs)
    share, log_total = normalise_probabilities(logs[:n_cells])
    return GridCells((of_line[:n_cells].copy(), of_sample[:n_cells].copy()), share,
                     float(log_total))


@_compiled
def _fill_likely_cells(logs_of_squares: FloatArray, line_log: FloatArray, sample_log: FloatArray,
                       half: float, log_affine: float, sizes: FloatArray, of_line: IntArray,
                       of_sample: IntArray, logs: FloatArray) -> int:
    """Fill in solutions of line and sample, and logarithms, of the likely cells; return how many.

    The grid (g, s, s) has the logarithms of sums of squares, `logs_of_squares`, which are
    overwritten; `line_log` and `sample_log` (g, s) are what their power `half` is multiplied by.
    All cells without terms, those of a size in `sizes` (s,) of 0, are one, of `log_affine`.
    `of_line`, `of_sample` and `logs` are filled from the start, and have room for all cells;
    solutions are numbered g s + number of the size.
    """
    groups, count, _ = logs_of_squares.shape
    # The log evidence of a cell is the sum of what line and sample add, less half log(squares),
    # half being half of the degrees of freedom. A size of 0 is the affine cell, which comes once.
    highest = log_affine
    for g in range(groups):
        for i in range(count):
            row = logs_of_squares[g, i]
            for j in range(count):
                row[j] = line_log[g, i] + sample_log[g, j] - half * row[j]
            for j in range(count):
                if sizes[i] > 0.0 and sizes[j] > 0.0 and row[j] > highest:
                    highest = row[j]
    # Cells that much less likely than the best have no part in any mean.
    lowest = highest - MAX_LOG_RATIO
    n_cells = 0
    if log_affine > lowest:
        of_line[0] = 0
        of_sample[0] = 0
        logs[0] = log_affine
        n_cells = 1
    for g in range(groups):
        for i in range(count):
            for j in range(count):
                value = logs_of_squares[g, i, j]
                if sizes[i] > 0.0 and sizes[j] > 0.0 and value > lowest:
                    of_line[n_cells] = g * count + i
                    of_sample[n_cells] = g * count + j
                    logs[n_cells] = value
                    n_cells += 1
    return n_cells


def normalise_probabilities(logarithm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return probabilities (p, ...) from their logarithms up to a constant, and the log of the sum.

    The probabilities add up to 1 along the first axis. The sum (...), over that axis, is the one of
    the numbers whose logarithms are given.
    """
    highest = logarithm.max(axis=0)
    share = np.exp(logarithm - highest)
    total = share.sum(axis=0)
    share /= total
    return share, highest + np.log(total)


@dataclass(frozen=True, eq=False)
class Posterior:
    """The regularised polynomial of some points: all its solutions of both axes, by probability.

    Its prediction is the mean over the solutions of `cells`. A solution of line and one of sample
    have the same scales and sizes of their own.
    """

    evidence: tuple[AxisEvidence, AxisEvidence]  # of line and of sample
    cells: GridCells  # which solutions matter, and their probabilities
    freedom: int  # equations in use less the terms that are not shrunk
    noise: float  # sum of squares that counts as none
    designs: tuple[Design, Design]  # of line and of sample
    scales: FloatArray  # (g, k): of the shrunken coefficients for size 1
    targets: FloatArray  # (n, 2): weighted measurements
    in_use: int  # points whose weight matters; they come first

    @cached_property
    def solutions(self) -> tuple[AxisSolutions, AxisSolutions]:
        """The solutions of line and of sample that occur in a likely cell.

        Of many points these are few, and a model that is not chosen never needs them.
        """
        solutions_of_cells = np.stack(self.cells.solutions)
        occurs = np.bincount(solutions_of_cells.ravel()) > 0  # as np.unique, without sorting
        renumbered = (np.cumsum(occurs) - 1)[solutions_of_cells]
        group, size = np.divmod(np.flatnonzero(occurs), len(PRIOR_SIZES))
        line, sample = self.designs
        line_shrinkage = shrinkage_of(line, group, size, PRIOR_SIZES)
        sample_shrinkage = line_shrinkage
        if sample is not line:
            sample_shrinkage = shrinkage_of(sample, group, size, PRIOR_SIZES)
        return (line_shrinkage.solutions(self.targets[:, 0], renumbered[0]),
                sample_shrinkage.solutions(self.targets[:, 1], renumbered[1]))

    @property
    def square(self) -> FloatArray:
        """Sum of squares of each cell, shape (c,)."""
        line, sample = self.evidence
        line_solution, sample_solution = self.cells.solutions
        return np.asarray(line.square[line_solution] + sample.square[sample_solution] + self.noise)

    def mean(self, axis: int) -> tuple[FloatArray, float]:
        """Return the averaged shrunken coefficients of an axis, (k,), and its effective parameters.
        """
        solutions = self.solutions[axis]
        share = np.bincount(solutions.solution_of_cell, self.cells.share, len(solutions.effective))
        return share @ solutions.coefficients, float(solutions.effective @ share)

    def errors_of(self, points: PointSelection) -> tuple[AxisErrors, AxisErrors]:
        """Return the errors of some points under the solutions of line, and of sample."""
        line, sample = self.solutions
        line_redundancies = line.redundancies(points)
        same_design = self.designs[0] is self.designs[1]
        sample_redundancies = line_redundancies if same_design else sample.redundancies(points)
        return (AxisErrors(line_redundancies, line.errors(points), line.solution_of_cell),
                AxisErrors(sample_redundancies, sample.errors(points), sample.solution_of_cell))

    @property
    def batches(self) -> list[slice]:
        """Slices of the points in use, of as many as the memory holds all solutions of."""
        return [slice(start, min(start + POINTS_AT_ONCE, self.in_use))
                for start in range(0, self.in_use, POINTS_AT_ONCE)]

    @cached_property
    def held_out(self) -> HeldOutPredictions:
        """The prediction of each point in use by all others."""
        return concatenate_batches([self.held_out_of(batch) for batch in self.batches])

    def held_out_of(self, batch: slice) -> HeldOutPredictions:
        """Return the prediction of some of the points in use, each by all others in use."""
        square = self.square
        cells = WeightedCells(square, self.noise + MIN_REDUNDANCY * square, self.cells.share,
                              self.cells.log_evidence)
        # Without a point there are two equations less.
        return leave_each_point_out(*self.errors_of(batch), cells, self.freedom // 2 - 1)

    def predict_unused(self, weight: float) -> HeldOutPredictions:
        """Return the predictions of the points that are not in use by those in use.

        The former have the tiny `weight` w. With l, which is 1 less the leverage of such a point,
        its error is e / (l w), whose variance by the noise of a point in use is 1 + (1 - l) / w^2.
        """
        share = self.cells.share
        count = len(self.targets) - self.in_use
        strains = []
        errors = np.zeros((count, 2))
        spread = np.zeros((count, 2))
        statistic = np.zeros((count, 2))
        line, sample = self.errors_of(slice(self.in_use, None))
        for axis, solutions in enumerate((line, sample)):
            n_solutions = len(solutions.redundancies)
            error = solutions.errors / solutions.redundancies / weight                # (u, m)
            variance = 1.0 + (1.0 - solutions.redundancies) / weight**2
            strains.append(error**2 / variance / 2)
            # Sums over the cells that have a solution: its probability, and that over the noise.
            probability = np.bincount(solutions.solution_of_cell, share, n_solutions)
            precision = np.bincount(solutions.solution_of_cell, share * self.freedom / self.square,
                                    n_solutions)
            errors[:, axis] = probability @ error
            spread[:, axis] = probability @ variance
            statistic[:, axis] = precision @ strains[axis]
        probability_of_error = mean_probability(
            (strains[0], strains[1]), (line.solution_of_cell, sample.solution_of_cell),
            2.0 / self.square, share, self.freedom // 2)
        return HeldOutPredictions(errors, probability_of_error, statistic.sum(axis=1), spread,
                                  np.full(count, self.cells.log_evidence))


def solve_posterior(columns: FloatArray, image: FloatArray, order: IntArray,
                    weights: FloatArray | None,
                    scales: FloatArray, in_use: int, *, affine: bool = False) -> Posterior | None:
    """Return all solutions for n points; None if they are too few, or have dependent columns.

    `columns` (n, k) are monomials of the scaled ground positions, affine ones first, and `order`
    (k,) are their total powers. The image is (n, 2); the equations are multiplied by the weights
    (n, 2), if any. `scales` (g, j) are as `scales_of` gives them. Only the first `in_use` points
    have weights that matter. `affine` says whether the image may be affine, which a test for
    blunders must not rely on.
    """
    is_free = order < 2
    solutions = solve_posteriors(columns[:, is_free], columns[None, :, ~is_free], image, weights,
                                 scales, scales.shape[1], in_use=in_use, affine=affine)
    return None if solutions is None else solutions[0]


def solve_posteriors(free_columns: FloatArray, shrunken: FloatArray, image: FloatArray,
                     weights: FloatArray | None, scales: FloatArray, n_own: int, *,
                     in_use: int | None = None, affine: bool = False) -> list[Posterior] | None:
    """Return all solutions as `solve_posterior` does, for d systems with equal free columns (n, f).

    The shrunken columns are (d, n, k), with the `scales` (g, k). The first `n_own` of them, which
    may be all, have scales of their own; all further ones share one scale in each group. `image`
    (n, 2) has the targets, and rows are multiplied by the `weights` (n, 2), if any; `in_use` of
    them, by default all, have a weight that matters. `affine` is as for `_grid_cells`. Returns None
    for fewer than four degrees of freedom, and for dependent columns.
    """
    in_use = len(free_columns) if in_use is None else in_use
    freedom = 2 * (in_use - free_columns.shape[1])
    if freedom < 4:
        return None
    # (NO_NOISE times the half-range of the image)^2 for each of the equations in use.
    noise = 2 * in_use * (NO_NOISE * float(np.ptp(image, axis=0).max()) / 2) ** 2
    designs = []
    # Line and sample have one design unless their weights differ.
    weights_of_axes: list[FloatArray | None] = [None]
    if weights is not None:
        weights_differ = bool((weights[:, 0] != weights[:, 1]).any())
        weights_of_axes = list(weights.T if weights_differ else weights.T[:1])
    for axis_weights in weights_of_axes:
        if axis_weights is None:
            of_axis = designs_of(free_columns, shrunken, scales, n_own)
        else:
            of_axis = designs_of(free_columns * axis_weights[:, None],
                                 shrunken * axis_weights[:, None], scales, n_own)
        if of_axis is None:
            return None
        designs.append(of_axis)
    targets = image if weights is None else image * weights
    evidence = _axis_evidence(designs[0], targets)
    if len(designs) > 1:
        evidence = [[line[0], sample[1]] for line, sample in zip(
            evidence, _axis_evidence(designs[1], targets), strict=True)]
    return [Posterior(evidence=(line, sample),
                      cells=_grid_cells(line, sample, freedom, noise, affine=affine),
                      freedom=freedom,
                      noise=noise, designs=(of_line, of_sample), scales=scales, targets=targets,
                      in_use=in_use)
            for (line, sample), of_line, of_sample in zip(evidence, designs[0], designs[-1],
                                                          strict=True)]


def polynomial_posterior(ground: FloatArray, image: FloatArray, exponents: Exponents,
                         weights: FloatArray | None) -> Posterior | None:
    """Return all solutions of a polynomial for points that are all in use (see `solve_posterior`).

    The ground (n, 3) is scaled to [-1, 1], the image is (n, 2), of the k exponents affine ones come
    first; the equations are multiplied by the weights (n, 2), if any. Returns None as
    `solve_posterior` does.
    """
    return _cached_polynomial_posterior(ground.tobytes(), image.tobytes(), exponents,
                                        None if weights is None else weights.tobytes())


@lru_cache(maxsize=2)  # methods, blunders and spread ask about the same points
def _cached_polynomial_posterior(ground: bytes, image: bytes, exponents: Exponents,
                                 weights: bytes | None) -> Posterior | None:
    """Return what `polynomial_posterior` does, None included, of arrays as bytes, the cache's key.

    It is cached since a regularised polynomial and a field next to it ask for the same one.
    """
    powers = np.array(exponents)
    order = powers.sum(axis=1)
    measured = np.frombuffer(image).reshape(-1, 2)
    return solve_posterior(evaluate_monomials(np.frombuffer(ground).reshape(-1, 3), exponents),
                           measured, order,
                           None if weights is None else np.frombuffer(weights).reshape(-1, 2),
                           scales_of(powers[order > 1]), len(measured), affine=True)


# What a posterior foresees at any place: line and sample, and how uncertain they are.
#
# A prediction is linear in q, the free columns at a place reduced by their triangle, and in w, its
# shrunken columns less what those have in common with the free ones. Under one solution on the grid
# its variance is
#
#     sigma^2 (q'q + size^2 w'D (I - sum_i v_i v_i' s_i^2 size^2 / (1 + s_i^2 size^2)) D w),
#
# D the scales, s_i and v_i singular values and vectors. Over all solutions it is the mean of these
# and the variance of the predictions: a quadratic form in q and w again.

@dataclass(frozen=True, eq=False)
class PredictedPositions:
    """What is foreseen at m places."""

    image: FloatArray  # (m, 2): mean of line and sample
    variance: FloatArray  # (m, 2): of their errors, without the noise of a measurement there
    # (m, 2, d): their products are the covariances of the errors as far as columns span them: those
    # of a line and of a sample are independent.
    factors: FloatArray
    noise: float  # variance of a measurement of unit weight


def predict_positions(posterior: Posterior, free: FloatArray, shrunken: FloatArray,
                      unspanned: FloatArray | None = None) -> PredictedPositions:
    """Return the positions that a posterior predicts at m places.

    `free` (m, f) are the columns there that are not shrunken, `shrunken` (m, k) the shrunken ones.
    `unspanned` (g, m) is the variance of what no column spans, for the size 1 in each group of
    scales.
    """
    noise = float(posterior.cells.share @ _expected_noise_variances(posterior))
    count = free.shape[1] + shrunken.shape[1]
    image, variance = np.zeros((2, len(free), 2))
    factors = np.zeros((len(free), 2, 2 * count))
    for axis in (0, 1):
        solutions = posterior.solutions[axis]
        design = posterior.designs[axis]
        free_reduced = np.linalg.solve(design.free_triangle.T, free.T).T
        # The w of the text above; `free_reduced` is its q.
        shrunken_reduced = shrunken - free_reduced @ design.free_projections
        weight, mean, root = _coefficient_moments(posterior, axis)
        image[:, axis] = free_reduced @ solutions.free + shrunken_reduced @ mean
        factors[:, axis, axis * count:(axis + 1) * count] = np.concatenate(
            [free_reduced * np.sqrt(noise), shrunken_reduced @ root], axis=1)
        if unspanned is not None:
            variance[:, axis] = weight @ PRIOR_SIZES**2 @ unspanned
    return PredictedPositions(image, variance + (factors**2).sum(axis=2), factors, noise)


def _expected_noise_variances(posterior: Posterior) -> FloatArray:
    """Return the expected variance of the noise, which is inverse gamma distributed, (c,)."""
    return np.asarray(posterior.square / (posterior.freedom - 2))


@lru_cache(maxsize=2)  # line and sample mostly have one design, and weigh the same groups
def _decomposed(design: Design, groups: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
    """Return singular values (g, r) and right singular vectors (g, r, k) of the scaled columns."""
    _, values, vt = np.linalg.svd(design.shrunken * design.scales[list(groups), None],
                                  full_matrices=False)
    return values, vt


@lru_cache(maxsize=32)  # places come in batches
def _coefficient_moments(posterior: Posterior,
                         axis: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return moments of the shrunken coefficients of an axis.

    These are the noise of each solution times its probability, (g, s), the mean of the
    coefficients, (k,), and a root B of their covariance B B', (k, k).
    """
    solutions = posterior.solutions[axis]
    cells = posterior.cells
    weight = np.asarray(np.bincount(
        cells.solutions[axis], cells.share * _expected_noise_variances(posterior),
        len(posterior.evidence[axis].square)), dtype=np.float64).reshape(len(posterior.scales), -1)
    design = posterior.designs[axis]
    k = posterior.scales.shape[1]
    share = np.bincount(solutions.solution_of_cell, posterior.cells.share,
                        len(solutions.coefficients))
    mean = share @ solutions.coefficients
    # Between solutions their coefficients differ; within one they are uncertain.
    deviations = solutions.coefficients - mean
    covariance = (deviations * share[:, None]).T @ deviations
    groups = np.flatnonzero(weight.any(axis=1))  # the others are not decomposed for this
    values, vt = _decomposed(design, tuple(groups.tolist()))
    shrink = PRIOR_SIZES[:, None] ** 2 / (1.0 + (PRIOR_SIZES[:, None] * values[:, None, :]) ** 2)
    explained_weight = np.einsum("gs,gsp->gp", weight[groups], shrink)
    prior_weight = weight @ PRIOR_SIZES**2
    for g, directions, direction_weight in zip(groups, vt, explained_weight, strict=True):
        scaled = directions * posterior.scales[g]
        covariance += (scaled * direction_weight[:, None]).T @ scaled
        if len(scaled) < k:  # what no point reaches
            covariance += prior_weight[g] * (np.diag(posterior.scales[g] ** 2) - scaled.T @ scaled)
    # Cholesky's method would fail where coefficients are known but for rounding.
    spread, vectors = np.linalg.eigh(covariance)
    return weight, mean, vectors * np.sqrt(np.maximum(spread, 0.0))
