"""Populations of masks: the compiled kernels compared with LAPACK, one individual at a time.

Times are processor seconds per individual. The disagreement is that of the fitted values,
relative to the length of the observations, at the worst individual that both can solve.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from time import perf_counter, process_time

import numpy as np

from termsel.adjustment import Equations
from termsel.adjustment.kernels import solve_many
from termsel.data.features import BoolArray, FeatureSet, FloatArray, Lines, Points
from termsel.models.base import LINE, SAMPLE
from termsel.models.polynomial import Polynomial3D
from termsel.models.quotient import RationalFunctions

Row = tuple[str, float, str, float | None, float | None, float | None]
Mask = BoolArray | None
System = tuple[Equations, Mask, Mask]

LSTSQ = "numpy.linalg.lstsq each"


def image_of(ground: FloatArray) -> FloatArray:
    """Return scaled image positions of scaled ground positions, mildly nonlinear."""
    x, y, z = np.moveaxis(ground, -1, 0)
    line = 0.9 * x - 0.2 * y + 0.1 * z + 0.02 * x * y - 0.01 * y**3 + 0.003 * x * x * z
    sample = 0.2 * x + 0.9 * y - 0.05 * z + 0.02 * x * x - 0.004 * y * z
    return np.stack([line, sample], axis=-1) / (1 + 0.02 * x - 0.01 * z)[..., None]


def scene(rng: np.random.Generator, n_points: int, n_lines: int) -> FeatureSet:
    """Return points and lines, measured to 1e-4 of the half-range: some tenths of a px."""
    ground = rng.uniform(-1, 1, size=(n_points, 3))
    points = Points(tuple(f"p{i}" for i in range(n_points)), ground=ground,
                    image=image_of(ground) + rng.normal(scale=1e-4, size=(n_points, 2)))
    start = rng.uniform(-0.9, 0.9, size=(n_lines, 1, 3))
    ends = start + rng.uniform(-0.1, 0.1, size=(n_lines, 2, 3))
    ends[..., 2] = start[..., 2]
    # The measured image points are not the images of the vertices of the line.
    measured = image_of(ends[:, :1] + np.array([0.2, 0.7])[:, None] * (ends[:, 1:] - ends[:, :1]))
    measured += rng.normal(scale=1e-4, size=measured.shape)
    return FeatureSet(points, Lines(tuple(f"l{i}" for i in range(n_lines)), measured, ends))


def axes_of(model: RationalFunctions | Polynomial3D, points: FeatureSet) -> list[Equations]:
    """Return the equations of line and of sample, one row per point each."""
    whole = model.equations(points)
    rows = np.arange(len(whole.b)) % 2
    return [whole.take(rows == axis, model.axis == axis) for axis in (LINE, SAMPLE)]


def lstsq_each(equations: Equations, terms: Mask, features: Mask, some: int) -> list[FloatArray]:
    """Solve the first individuals as one would without the kernels."""
    solutions = []
    for i in range(some):
        A, b = equations.A, equations.b
        if features is not None:
            rows = features[i][equations.feature]
            A, b = A[rows], b[rows]
        x = np.zeros(A.shape[1])
        if terms is None:
            x = np.linalg.lstsq(A, b, rcond=None)[0]
        else:
            x[terms[i]] = np.linalg.lstsq(A[:, terms[i]], b, rcond=None)[0]
        solutions.append(x)
    return solutions


def normal_equations(equations: Equations, terms: BoolArray) -> FloatArray:
    """Solve a whole population by masked normal equations, unselected terms fixed to 0."""
    A = equations.A
    both = terms[:, :, None] & terms[:, None, :]
    N = np.where(both, A.T @ A, 0.0) + np.eye(A.shape[1]) * ~terms[:, None, :]
    return np.linalg.solve(N, (terms * (A.T @ equations.b))[..., None])[..., 0]


def best_of(calls: list[Callable[[], object]], seconds: float = 1.0) -> list[float]:
    """Return the least time of each call; they take turns, so that load affects all equally.

    Processor time excludes other work on the machine.
    """
    best = [np.inf] * len(calls)
    until = perf_counter() + seconds
    rounds = 0
    while rounds < 3 or perf_counter() < until:
        for i, call in enumerate(calls):
            start = process_time()
            call()
            best[i] = min(best[i], process_time() - start)
        rounds += 1
    return best


def disagreement(
    equations: Equations, features: Mask, ours: tuple[FloatArray, np.ndarray],
    theirs: list[FloatArray] | FloatArray,
) -> float:
    """Return the largest relative difference of fitted values."""
    worst = 0.0
    for i, other in enumerate(theirs):
        rows = slice(None) if features is None else features[i][equations.feature]
        if ours[1][i] == 0:
            gap = equations.A[rows] @ (ours[0][i] - other)
            worst = max(worst, float(np.linalg.norm(gap) / np.linalg.norm(equations.b[rows])))
    return worst


def compare(what: str, systems: list[System], some: int = 30, joint: System | None = None,
            normal: bool = False) -> Iterator[Row]:
    """Compare over all systems of an individual, which are its axes.

    Parameters
    ----------
    what : str
    systems : list of (equations, terms, features)
    some : int
        How many individuals the slow alternative solves.
    joint : (equations, terms, features), optional
        The same with both axes in one, as a further alternative.
    normal : bool
        Whether masked normal equations are a further alternative.
    """
    p = len(next(mask for mask in systems[0][1:] if mask is not None))
    some = min(some, p)
    calls: dict[str, tuple[Callable[[], object], int]] = {
        "": (lambda: [solve_many(*one) for one in systems], p)}
    if joint is not None:
        calls[f"{LSTSQ}, both axes in one"] = lambda: lstsq_each(*joint, some), some
    name = f"{LSTSQ} axis" if len(systems) > 1 else LSTSQ
    calls[name] = lambda: [lstsq_each(*one, some) for one in systems], some
    if normal:
        calls["normal equations, batched"] = (
            lambda: [normal_equations(*one[:2]) for one in systems], p)
    times = best_of([call for call, _ in calls.values()])
    ours, *others = (time / count for time, (_, count) in zip(times, calls.values(), strict=True))
    gap = max(disagreement(*one[::2], solve_many(*one), lstsq_each(*one, some))
              for one in systems)
    for name, other in zip(list(calls)[1:], others, strict=True):
        if name.startswith("normal"):
            gap = max(disagreement(*one[::2], solve_many(*one), normal_equations(*one[:2]))
                      for one in systems)
        yield what, ours, name, other, other / ours, gap


def rows() -> Iterator[Row]:
    """Yield the measurements."""
    rng = np.random.default_rng(20)
    yield from _term_masks(rng)
    yield from _feature_masks(rng)
    yield from _growth(rng)


def _term_masks(rng: np.random.Generator) -> Iterator[Row]:
    model, p = RationalFunctions(order=3), 200
    for n in (24, 48, 74):
        points = scene(rng, n, 0)
        # As many terms as a search considers: few enough for the points to determine.
        terms = rng.random((p, 78)) < min(0.5, 0.3 * n / 24)
        yield from compare(
            f"terms of 78, {n} points",
            [(one, terms[:, model.axis == axis], None)
             for axis, one in zip((LINE, SAMPLE), axes_of(model, points), strict=True)],
            joint=(model.equations(points), terms, None), normal=n == 74)


def _feature_masks(rng: np.random.Generator) -> Iterator[Row]:
    for order, denominators, n, share in ((3, "separate", 74, 0.8), (3, "separate", 120, 0.5),
                                          (3, "none", 74, 0.5), (2, "separate", 74, 0.5)):
        model = RationalFunctions(order=order, denominators=denominators)
        systems = axes_of(model, scene(rng, n, 0))
        masks = rng.random((200, n)) < share
        yield from compare(f"points, {share:.0%} of {n}, {len(model.terms)} terms",
                      [(one, None, masks) for one in systems])
    for order, n in ((2, 120), (3, 120), (3, 200)):
        model = RationalFunctions(order=order, ridge=0.0)
        equations = model.equations(scene(rng, 0, n))
        k = len(model.terms)
        masks = rng.random((100, n)) < 0.5
        yield from compare(f"lines, half of {n}, {k} terms", [(equations, None, masks)])
        yield from compare(f"lines, half of {n}, half of {k} terms",
                      [(equations, rng.random((100, k)) < 0.5, masks)])


def _growth(rng: np.random.Generator) -> Iterator[Row]:
    model = RationalFunctions(order=3)
    for n in (50, 500, 5000, 50_000, 100_000):
        line = axes_of(model, scene(rng, n, 0))[LINE]
        everything = np.ones((1, 39), bool)
        once, = best_of([lambda: solve_many(replace(line), everything, None)])  # noqa: B023
        yield f"growth: {n} points, 39 terms, reduced once", once, "", None, None, None
        terms = rng.random((200, 39)) < 0.5
        yield from compare(f"growth: {n} points, half of 39 terms", [(line, terms, None)],
                      3 if n > 1000 else 30)
    for degree in (1, 2, 3, 4, 5):
        line = axes_of(Polynomial3D(degree=degree), scene(rng, 200, 0))[LINE]
        k = line.A.shape[1]
        yield from compare(f"growth: half of {k} terms, 200 points",
                      [(line, rng.random((200, k)) < 0.5, None)])
    for n in (50, 500, 5000):
        equations = RationalFunctions(order=2, ridge=0.0).equations(scene(rng, 0, n))
        yield from compare(f"growth: half of {n} lines, 38 terms",
                      [(equations, None, rng.random((50, n)) < 0.5)],
                      5 if n > 1000 else 30)
        yield from compare(f"growth: half of {n} lines, three quarters of 38 terms",
                      [(equations, rng.random((50, 38)) < 0.75, rng.random((50, n)) < 0.5)],
                      5 if n > 1000 else 30)
    line = axes_of(model, scene(rng, 74, 0))[LINE]
    for p in (1, 10, 100, 1000, 10_000):
        yield from compare(f"growth: population {p}, half of 39 terms",
                      [(line, rng.random((p, 39)) < 0.5, None)])
