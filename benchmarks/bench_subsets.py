"""Every subset proven: the enumeration compared with a fit of each subset through LAPACK.

Times are processor seconds per subset, on one core. The alternative fits a sample of the subsets
by `numpy.linalg.lstsq` and predicts the selection points, as a plain script does. The disagreement
is the largest relative difference between the best score of each size and that of the same
subset through LAPACK.
"""

from __future__ import annotations

import resource
import sys
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from time import process_time

import numpy as np

from benchmarks.bench_kernels import LSTSQ, Row
from termsel.data.features import BoolArray, FloatArray, IntArray
from termsel.data.monomials import RPC00B, evaluate_monomials
from termsel.selection.best_subsets.columns.system import SubsetSystem
from termsel.selection.best_subsets.subsets import SubsetResult, search

SAMPLE = 1 << 12
N_CONTROL, N_CHECK = 27, 47


def polynomial_2d(rng: np.random.Generator, degree: int = 5) -> SubsetSystem:
    """Return a polynomial of two coordinates; degree 5 is the published case of 21 terms."""
    x, y = rng.uniform(-1, 1, (2, N_CONTROL + N_CHECK))
    columns = np.stack([x**i * y**j for d in range(degree + 1) for i in range(d, -1, -1)
                        for j in [d - i]], axis=1)
    target = columns @ rng.normal(size=columns.shape[1]) * 0.3
    target = (target + rng.normal(size=len(target)) * 0.01)[:, None]
    return SubsetSystem(columns[:N_CONTROL], target[:N_CONTROL], columns[N_CONTROL:],
                        target[N_CONTROL:])


def rational(rng: np.random.Generator, terms: int = 10, n_control: int = N_CONTROL) -> SubsetSystem:
    """Return one axis of an RFM of so many terms above the line, whose poles are guarded."""
    above = evaluate_monomials(rng.uniform(-1, 1, (n_control + N_CHECK, 3)), RPC00B[:terms])
    below = above[:, 1:]
    sizes = 0.3 ** np.arange(1, terms + 1) + 1e-3
    target = above @ (rng.normal(size=terms) * sizes)
    target /= 1 + below @ (rng.normal(size=terms - 1) * sizes[1:] * 0.1)
    target = (target + rng.normal(size=len(target)) * 1e-3)[:, None]
    design = np.hstack([above, -target * below])
    denominator = np.hstack([0 * above, below])
    return SubsetSystem(design[:n_control], target[:n_control], design[n_control:],
                        target[n_control:], denominator[:n_control], denominator[n_control:],
                        denominator)


def finish(system: SubsetSystem, score: str, folds: tuple[IntArray, ...] = (),
           max_terms: int | None = None) -> tuple[SubsetResult, float]:
    """Return the complete result and its processor seconds."""
    start = process_time()
    result = deque(search(system, score, folds=folds, max_terms=max_terms), maxlen=1).pop()
    return result, process_time() - start


def lapack(system: SubsetSystem, score: str, columns: BoolArray,
           folds: tuple[IntArray, ...]) -> float:
    """Return the score of one subset."""
    A, t = system.design[:, columns], system.target
    if score == "rss":
        return float(((t - A @ _solve(A, t)) ** 2).sum())
    if score == "check":
        assert system.check_design is not None
        assert system.check_target is not None
        return _squares(system.check_target - system.check_design[:, columns] @ (x := _solve(A, t)),
                        system.check_denominator, columns, x)
    total = 0.0
    for fold in folds if score == "kfold" else np.arange(len(A))[:, None]:
        x = _solve(np.delete(A, fold, axis=0), np.delete(t, fold, axis=0))
        below = None if system.denominator is None else system.denominator[fold]
        total += _squares(t[fold] - A[fold] @ x, below, columns, x)
    return total


def _solve(A: FloatArray, t: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.lstsq(A, t, rcond=None)[0])


def _squares(errors: FloatArray, below: FloatArray | None, columns: BoolArray,
             x: FloatArray) -> float:
    if below is not None:
        errors = errors / (1 + below[:, columns] @ x)
    return float((errors**2).sum())


def compare(what: str, system: SubsetSystem, score: str, *, folds: tuple[IntArray, ...] = (),
            max_terms: int | None = None) -> Row:
    """Return times per subset."""
    finish(replace(system, forbidden=np.arange(system.design.shape[1]) > 2), score, folds)
    runs = [finish(system, score, folds, max_terms) for _ in range(3)]
    result, ours = runs[0][0], min(seconds for _, seconds in runs) / runs[0][0].total
    masks = np.random.default_rng(1).random((SAMPLE, system.design.shape[1])) < 0.5
    start = process_time()
    for columns in masks:
        lapack(system, score, columns, folds)
    theirs = (process_time() - start) / SAMPLE
    gaps = [abs(result.best[size] / lapack(system, score, result.columns(size), folds) - 1)
            for size in np.flatnonzero(np.isfinite(result.best)).tolist()]
    return what, ours, LSTSQ, theirs, theirs / ours, max(gaps)


def growth(rng: np.random.Generator) -> Iterator[Row]:
    """Yield the time of a larger space, and the growth of memory [MB]."""
    before = _peak()
    result, seconds = finish(polynomial_2d(rng, 6), "check", max_terms=8)
    grown = _peak() - before
    yield (f"2D, degree 6, <= 8 of 28 terms: {result.total:,} subsets, memory +{grown:.0f} MB",
           seconds, "", None, None, None)


def _peak() -> float:
    """Return the largest memory so far [MB]."""
    unit = 1 << 20 if sys.platform == "darwin" else 1 << 10
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


def rows() -> Iterator[Row]:
    """Yield the measurements."""
    rng = np.random.default_rng(21)
    plane, quotient = polynomial_2d(rng), rational(rng)
    folds = tuple(np.array_split(np.arange(N_CONTROL), 5))
    shared = replace(plane, target=np.hstack([plane.target, plane.target[:, ::-1] ** 2]),
                     check_target=np.repeat(np.asarray(plane.check_target), 2, axis=1))
    yield compare("2D, 21 terms, check, 2^21 subsets", plane, "check")
    yield compare("same, one mask for both axes", shared, "check")
    yield compare("RFM, 19 terms, check, guarded, 2^19", quotient, "check")
    yield compare("2D, 21 terms, press", plane, "press")
    yield compare("2D, 15 terms, 5 folds", polynomial_2d(rng, 4), "kfold", folds=folds)
    yield compare("2D, 21 terms, rss and its bound", plane, "rss")
    wide = rational(rng, 20, 74)
    yield compare("RFM, 39 terms, rss, 81 million of up to 8", wide, "rss", max_terms=8)
    yield compare("RFM, 39 terms, rss, 6.5e9 of up to 12", wide, "rss", max_terms=12)
    yield from growth(rng)
