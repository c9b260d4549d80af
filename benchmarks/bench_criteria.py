"""Criteria that hold control features out: all at once, compared with one refit after another.

Times are seconds per individual, on one core, for a whole evaluation of term selections on the
embedded scene `ikonos-hamedan`: fit, guard against poles, and criterion. The alternative is the
loop one would write with numpy: hold the feature or fold out, `lstsq`, project, square. The
disagreement is the largest relative difference of the criterion.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from benchmarks.bench_kernels import Row, best_of
from termsel import prepare
from termsel.data.features import BoolArray, IntArray
from termsel.models.base import LINE, SAMPLE
from termsel.selection.criteria import KFold
from termsel.selection.problems.selection import SelectionProblem

POPULATION, SOME = 200, 5


def selections(problem: SelectionProblem, rng: np.random.Generator, each: int) -> BoolArray:
    """Return feasible selections of so many terms per axis."""
    axis = problem.inputs.model.axis
    found: list[BoolArray] = []
    while len(found) < POPULATION:
        genes = np.zeros((POPULATION, problem.genome.size), dtype=bool)
        for mask in genes:
            for side in (LINE, SAMPLE):
                mask[rng.choice(np.flatnonzero(axis == side), each, replace=False)] = True
        found.extend(genes[problem.evaluate(genes).violation == 0])
    return np.array(found[:POPULATION])


def refits(problem: SelectionProblem, genes: BoolArray,
           folds: Sequence[IntArray]) -> list[float]:
    """Return the criterion by one refit per axis and fold."""
    inputs, axis = problem.inputs, problem.inputs.model.axis
    A, b = problem.equations.A, problem.equations.b
    points = inputs.control.points
    row_axis = np.arange(len(b)) % 2
    values = []
    for mask in genes:
        total = 0.0
        for fold in folds:
            kept = ~np.isin(problem.equations.feature, fold)
            x = np.zeros(len(axis))
            for side in (LINE, SAMPLE):
                rows, columns = kept & (row_axis == side), mask & (axis == side)
                x[columns] = np.linalg.lstsq(A[np.ix_(rows, columns)], b[rows], rcond=None)[0]
            errors = inputs.model.project(x, points.ground[fold]) - points.image[fold]
            total += float((errors**2).sum())
        values.append(np.sqrt(total / len(points)) * inputs.pixels)
    return values


def rows() -> Iterator[Row]:
    """Yield press and k-fold for few and for many control points."""
    for fractions in ("1:1:1", "8:1:1"):
        options = {"roles": "stratified", "fractions": fractions}
        for criterion in ("press", "kfold"):
            problem = prepare("rfm-terms", criterion=criterion, options=options).problem
            assert isinstance(problem, SelectionProblem)
            points = problem.inputs.control.points
            n = len(points)
            each = n // 4
            genes = selections(problem, np.random.default_rng(6), each)
            folds = ([np.array([i]) for i in range(n)] if criterion == "press"
                     else KFold().folds(points, problem.inputs.control.lines))
            ours, theirs = best_of([lambda: problem.evaluate(genes),  # noqa: B023
                                    lambda: refits(problem, genes[:SOME], folds)])  # noqa: B023
            values = problem.evaluate(genes[:SOME]).objectives[:, 0]
            gap = np.abs(values / refits(problem, genes[:SOME], folds) - 1).max()
            yield (f"{criterion}, {n} points, {each} terms per axis", ours / POPULATION,
                   f"{len(folds)} refits with lstsq", theirs / SOME,
                   theirs / SOME / (ours / POPULATION), float(gap))
