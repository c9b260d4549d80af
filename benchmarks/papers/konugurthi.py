"""Konugurthi, Kune, Nooka, Sarma 2016: figure 6, product error by the share of blunders."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from benchmarks.papers.trial import px
from termsel import Equations, Task, prepare, search
from termsel.fitting.least_squares import fit
from termsel.runs.searching import fit_of
from termsel_rpc import simulate_matches

RUNS = 20
"""Scenes drawn for each share."""
PUBLISHED_RUNS = 1

SHARES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)
GSD = 2.5
"""Of Cartosat-1 [m]."""

DRAWS, THRESHOLD = 200, 3.0
"""Of RANSAC: minimal samples of two points, and largest error of a point that agrees [px]."""
LARGEST = 2.5
"""Of the iterative least squares: residuals above so many times their RMS are rejected."""

Mask = np.ndarray[tuple[int], np.dtype[np.bool_]]


def page(runs: int) -> Iterator[str]:
    """Yield the lines of the page."""
    yield HEAD.format(scenes=runs, draws=DRAWS, threshold=THRESHOLD, largest=LARGEST)
    yield ("| blunders | GA | GA, ten times the population | RANSAC | "
           "iterative least squares | all points | blunders used by the GA | "
           "CPU s of GA, RANSAC, least squares |\n"
           "|---:|---:|---:|---:|---:|---:|---:|---|")
    for share in SHARES:
        found = np.array([one_scene(share, seed) for seed in range(1, runs + 1)])
        middle = np.median(found, axis=0)
        worst = GSD * found[:, :5].max(axis=0)
        cells = [f"{GSD * value:.1f} ({px(most, 1)})"
                 for value, most in zip(middle[:5], worst, strict=True)]
        yield (f"| {100 * share:.0f} % | " + " | ".join(cells)
               + f" | {found[:, 5].mean():.1f} of 9 | {middle[6]:.2f}, {middle[7]:.3f}, "
               f"{middle[8]:.3f} |")
    yield ""
    yield WORDS


def one_scene(share: float, seed: int) -> tuple[float, ...]:
    """Return RMSE of independent check points by five methods [px], blunders used, and CPU times.
    """
    features = simulate_matches(share, seed)
    exact = simulate_matches(0.0, seed).points.image
    task = prepare("konugurthi-2016", features=features)
    start = time.process_time()
    small = _searched(task, seed)
    of_ga = time.process_time() - start
    large = _searched(prepare("konugurthi-2016", features=features,
                              options={"population": 100}), seed)
    points = task.observations.control.points
    far = np.linalg.norm(points.image - exact[:len(features.points)][
        [features.points.ids.index(name) for name in points.ids]], axis=1) > 4.0
    equations = task.model.equations(task.scaling.features(task.observations.control))
    pixels = task.scaling.image_scale
    start = time.process_time()
    agreeing = ransac(equations, len(points), pixels, np.random.default_rng(seed))
    of_ransac = time.process_time() - start
    start = time.process_time()
    kept = iterated(equations, len(points))
    of_squares = time.process_time() - start
    return (_error(task, small), _error(task, large), _error(task, agreeing), _error(task, kept),
            _error(task, np.ones(len(points), dtype=bool)), float((far & small).sum()),
            of_ga, of_ransac, of_squares)


def _searched(task: Task, seed: int) -> Mask:
    found = search(task.problem, task.solver, seed=seed, generations=task.recipe.generations)
    return fit_of(task, task.problem.decode(found.genes)).used


def _error(task: Task, used: Mask) -> float:
    fitted = fit(task.model, task.observations.control, task.scaling, used=used)
    rmse = fitted.rmse(task.observations.independent)
    return rmse.total if rmse else np.inf


def _residuals(equations: Equations, used: Mask) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return the error of each point under the adjustment of some of them."""
    rows = used[equations.feature]
    solution = np.linalg.lstsq(equations.A[rows], equations.b[rows], rcond=None)[0]
    squares = (equations.b - equations.A @ solution) ** 2
    return np.sqrt(np.bincount(equations.feature, weights=squares, minlength=len(used)))


def ransac(equations: Equations, n: int, pixels: float, rng: np.random.Generator) -> Mask:
    """Return the points that agree with the best of many samples of two (Fischler, Bolles 1981)."""
    best = np.zeros(n, dtype=bool)
    for _ in range(DRAWS):
        sample = np.zeros(n, dtype=bool)
        sample[rng.permutation(n)[:2]] = True
        agreeing = _residuals(equations, sample) * pixels < THRESHOLD
        if agreeing.sum() > best.sum():
            best = agreeing
    return best


def iterated(equations: Equations, n: int) -> Mask:
    """Return the points that are left after those of large residuals are rejected repeatedly."""
    used = np.ones(n, dtype=bool)
    while True:
        errors = _residuals(equations, used)
        kept = used & (errors <= LARGEST * np.sqrt((errors[used] ** 2).mean()))
        if kept.sum() == used.sum() or kept.sum() < 3:
            return used
        used = kept


HEAD = """# Konugurthi et al. 2016

Made by `python -m benchmarks.paper_tables konugurthi --write`, with the package termsel-rpc. **All
data here are simulated**: a Cartosat-1 scene of 2.5 m with 100 matched points, of which a share is
wrong by 5 to 40 px, and 100 independent ones. A rigorous model with errors of attitude is refined.
Product error: the RMSE of independent check points [m], median of {scenes} scenes, in brackets the
worst.

- **GA**: `konugurthi-2016`, 9 of 100 points, 10 chromosomes, 20 generations, fitness A/E50.
- **RANSAC**: {draws} samples of two points; points within {threshold:g} px agree.
- **Iterative least squares**: residuals above {largest} times their RMS are rejected until none is.

**Published** (figure 6): the GA keeps the product error near 10 m, while RANSAC and iterative least
squares reach 35 m at 40 % blunders. The figure is read from page 383. The parameters of the
rivals are on no page that could be consulted; those here are termsel's own.
"""
WORDS = """## What agrees, what does not, and why

- **Agrees: the GA keeps the product error low up to 40 % blunders**, where iterative least squares
  break down: 3 m instead of 4 m in the median, and 5 m instead of 11 m in the worst scene. Up to
  30 % it uses hardly any blunder.
- **Does not agree: the GA does not hold at 50 %.** The median error over all points is then that of
  a blunder as often as not. Ten times the chromosomes help at 40 %, but not at 50 %.
- **Does not agree: RANSAC is as good as the GA or better at all shares**, and 20 times as fast.
  Two points determine the three biases of attitude, so that many of the 200 samples are free
  of blunders; and blunders here agree with no one. Matches that are wrong in the same way, which
  repeated patterns produce, would agree with each other. The paper does not say which model RANSAC
  fits there, or what counts as agreement.
- **The level differs**: 3 m instead of 10 m. The reference of the simulated points is exact, the
  paper's has pixels of 15 m.
"""

