"""Base of solvers that choose terms by regression on the control rows, without a search."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from termsel.adjustment.solve import ROUNDING, TOLERANCE, index_of_largest
from termsel.core.errors import TermselError
from termsel.core.remedies import Remedy
from termsel.data.features import BoolArray, FloatArray, IntArray
from termsel.selection.best_subsets.columns.system import SubsetSystem
from termsel.selection.problems.base import EnumerablePart, Problem
from termsel.selection.solvers.base import Generation, Solver
from termsel.selection.solvers.proofs.proof import segment_of


@dataclass(frozen=True, eq=False)
class Standardised:
    """A regression without the columns that are not penalised, the others at unit length."""

    # (m, j): orthogonal to the unpenalised ones; 0 for columns that depend on those.
    columns: FloatArray
    target: FloatArray  # (m, r): orthogonal to the unpenalised ones as well
    lengths: FloatArray  # (j,): lengths of the columns before they were brought to unit length


@dataclass(frozen=True, eq=False)
class Regression:
    """The control rows of one part: columns to choose from, and their targets.

    With one mask for line and sample there are two targets; their sums of squares and
    degrees of freedom are pooled, as for one adjustment of both.

    Attributes
    ----------
    genes : ndarray of int, shape (k,)
        The genes that switch the columns.
    columns, target : ndarray, shapes (m, k) and (m, r)
        As in the adjustment.
    denominator : ndarray, shape (m, k), or None
        Its linear form without its 1: the error of the image coordinate is
        (target - columns x) / (1 + denominator x).
    constant, kept, free : ndarray of bool, shape (k,)
        The constant's column, if any; those that are always chosen; those to choose from.
    least, most : int
        Fewest and most columns; the most leave a redundancy of at least 1.
    pixels : float
        Size of the target's unit [px].

    Examples
    --------
    >>> import termsel
    >>> class First(termsel.TermRegression):
    ...     "All columns, those that are always chosen included."
    ...     name = "first-demo"
    ...
    ...     def choose(self, regression):
    ...         return regression.free | regression.kept
    >>> First().name
    'first-demo'
    """

    genes: IntArray
    columns: FloatArray
    target: FloatArray
    denominator: FloatArray | None
    constant: BoolArray
    kept: BoolArray
    free: BoolArray
    least: int
    most: int
    pixels: float

    @cached_property
    def unit(self) -> FloatArray:
        """Columns (m, k) of length 1, or 0 if they are all zeros."""
        lengths = np.linalg.norm(self.columns, axis=0)
        return np.asarray(self.columns / np.where(lengths > 0, lengths, 1.0))

    @cached_property
    def rounding(self) -> float:
        """Residual sum of squares up to which it is rounding error."""
        return float((ROUNDING * np.linalg.norm(self.target)) ** 2)

    def explained(self, square: float) -> bool:
        """Return whether a residual sum of squares is rounding error."""
        return bool(square <= self.rounding)

    def without_surplus(self, selection: BoolArray) -> BoolArray:
        """Return a selection (k,) without columns of which only rounding is explained.

        Where columns explain the target, all but for rounding, those that a penalty chose further
        would differ from processor to processor. The weakest goes first.
        """
        selection = selection.copy()
        while selection.sum() > self.least:
            # Columns have one length, so that the smallest coefficient is of the weakest column.
            x = np.linalg.lstsq(self.unit[:, selection], self.target)[0]
            weakness = np.full(len(selection), np.inf)
            weakness[selection] = np.linalg.norm(x, axis=1)
            weakness[~self.free] = np.inf
            fewer = selection.copy()
            fewer[weakness.argmin()] = False
            if fewer.sum() == selection.sum() or not np.isfinite(weakness.min()):
                break
            left = self.target - self.unit[:, fewer] @ np.linalg.lstsq(
                self.unit[:, fewer], self.target)[0]
            if not self.explained(float((left**2).sum())):
                break
            selection = fewer
        return selection

    @staticmethod
    def largest(values: FloatArray) -> int:
        """Return the index of the largest value (k,), of those equal but for rounding the first."""
        return int(index_of_largest(values))

    def standardised(self, penalised: BoolArray, removed: BoolArray, rows: BoolArray | None = None,
                     ) -> Standardised:
        """Return the columns of the mask `penalised` (k,), of length 1, and the target.

        Both are made orthogonal to the columns of the mask `removed` (k,), which are independent,
        such as the constant. A column that depends on those becomes 0. With the mask `rows` (m,)
        only these rows count.
        """
        selected_rows = slice(None) if rows is None else rows
        columns = self.columns[selected_rows][:, penalised]
        target = self.target[selected_rows]
        # With Q of the columns removed: (1 - Q Q') a, and the same of the target.
        q = np.linalg.qr(self.columns[selected_rows][:, removed])[0]
        orthogonal = columns - q @ (q.T @ columns)
        lengths = np.linalg.norm(orthogonal, axis=0)
        live = lengths > TOLERANCE * np.linalg.norm(columns, axis=0)
        lengths = np.where(live, lengths, np.inf)  # a column that depends on those becomes 0
        return Standardised(orthogonal / lengths, target - q @ (q.T @ target), lengths)

    def freedom(self, selection: BoolArray) -> int:
        """Return the degrees of freedom of the adjustment with the chosen columns."""
        m, r = self.target.shape
        return int(r * (m - selection.sum()))


def regressions_of_problem(problem: Problem) -> list[Regression]:
    """Return the parts of a term selection as regressions over their control rows.

    The constant is kept unless it is forbidden, like the intercept in textbooks and in Long et al.
    2014. Raises TermselError if the space cannot be enumerated (see `Problem.parts`), or terms need
    parents.
    """
    if any(subproblem.system.parents is not None for subproblem in problem.parts()):
        raise TermselError("regression adds and drops single terms and cannot keep a hierarchy",
                           hint=f"Choose another solver, such as {Remedy('solver', 'ga')} or "
                                "exact, or remove hierarchy=true.")
    return [_regression_of_axes(problem, subproblem) for subproblem in problem.parts()]


def _regression_of_axes(problem: Problem, subproblem: EnumerablePart) -> Regression:
    """Return the control rows of one axis, or of both, as a regression."""
    rows = subproblem.system
    m, k = rows.design.shape
    none = np.zeros(k, dtype=bool)
    forced = none if rows.forced is None else rows.forced
    forbidden = none if rows.forbidden is None else rows.forbidden
    constant = _constant_column(rows) & ~forbidden
    segment = segment_of(problem, subproblem)
    always = forced | constant
    # A redundancy of 1 remains: m rows, m - 1 columns.
    max_columns = min(k if segment.maximum is None else segment.maximum, m - 1)
    return Regression(genes=subproblem.genes, columns=rows.design, target=rows.target,
                      denominator=rows.denominator, constant=constant, kept=always,
                      free=~(always | forbidden), least=max(1, segment.minimum), most=max_columns,
                      pixels=subproblem.pixels)


def _constant_column(system: SubsetSystem) -> BoolArray:
    """Return the mask, (k,), of the constant: the first column that is the same in every row.

    No column is in it if there is none. If standard deviations weight the control rows, only check
    rows reveal it, if there are any. Nothing else is taken from those.
    """
    constant = np.zeros(system.design.shape[1], dtype=bool)
    for rows in (system.design, system.check_design):
        if rows is not None and not constant.any():
            is_constant = (np.ptp(rows, axis=0) == 0) & (rows[0] != 0)
            constant = is_constant & (np.cumsum(is_constant) == 1)  # the first of them alone
    return constant


def generation_of(problem: Problem, regressions: list[Regression], selections: list[BoolArray],
                  rng: np.random.Generator) -> Generation:
    """Return the one selection of a method, evaluated, from the chosen columns of each part.

    Chance is used only if a method could not keep the genome's cardinality.
    """
    genes = np.zeros((1, problem.genome.size), dtype=bool)
    for regression, columns in zip(regressions, selections, strict=True):
        genes[0, regression.genes] = columns
    genes = problem.genome.repair(genes, rng)
    return Generation(0, genes, problem.evaluate(genes))


class TermRegression(Solver):
    """Base of solvers that choose the columns of each part only from its control rows.

    Examples
    --------
    >>> import termsel
    >>> class AllColumns(termsel.TermRegression):
    ...     "All columns that are free."
    ...     name = "all-demo"
    ...
    ...     def choose(self, regression):
    ...         return regression.free | regression.kept
    >>> result = termsel.run("poly-terms", solver=AllColumns, options={"degree": 2})
    >>> result.selection.n_terms
    12
    """

    ends_by_itself = True
    uses_chance = False

    @abstractmethod
    def choose(self, regression: Regression) -> BoolArray:
        """Return the chosen columns, shape (k,)."""

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        """Yield the one selection (see `Solver.generations`)."""
        of_axes = regressions_of_problem(problem)
        # Each axis, where they are independent, is chosen by itself.
        selections = [self.choose(regression) for regression in of_axes]
        yield generation_of(problem, of_axes, selections, rng)
