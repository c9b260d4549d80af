"""Details of the papers against a second derivation, which shares no code with the first."""

from __future__ import annotations

import math
from collections import Counter
from itertools import combinations, pairwise

import numpy as np
import pytest

import termsel
from termsel.selection.solvers.genetic.operators import replace_one, set_crossover


def by_particle(problem: termsel.Problem, seed: int, particles: int, steps: int,
                neighbours: int) -> list[np.ndarray]:
    """Return the genes of each step of a binary swarm (Kennedy, Eberhart 1997), one at a time.

    v <- v + 2 r1 (own best - x) + 2 r2 (leader - x), within 4; x is 1 with chance 1 / (1 + e^-v).
    """
    rng = np.random.default_rng(seed)
    x = problem.genome.random(rng, particles).astype(int)
    size = x.shape[1]
    first = rng.random((particles, size))
    v = [[(4.0 if x[i, j] else -4.0) * first[i, j] for j in range(size)] for i in range(particles)]
    best = [(rank(problem, row), row.copy()) for row in x]
    steps_of_genes = [x.copy()]
    for _ in range(steps):
        # All draws of a step come before it is made, as of a whole swarm.
        own, social = rng.random((particles, size)), rng.random((particles, size))
        leaders = [min((best[(i + d) % particles] for d in range(-neighbours, neighbours + 1)),
                       key=lambda each: each[0])[1] for i in range(particles)]
        for i in range(particles):
            for j in range(size):
                pull = 2 * own[i, j] * (best[i][1][j] - x[i, j])
                pull += 2 * social[i, j] * (leaders[i][j] - x[i, j])
                v[i][j] = min(4.0, max(-4.0, v[i][j] + pull))
        chance = rng.random((particles, size))
        x = np.array([[int(chance[i, j] < 1 / (1 + math.exp(-v[i][j]))) for j in range(size)]
                      for i in range(particles)])
        for i, row in enumerate(x):
            found = rank(problem, row)
            if found < best[i][0]:
                best[i] = (found, row.copy())
        steps_of_genes.append(x.copy())
    return steps_of_genes


def rank(problem: termsel.Problem, row: np.ndarray) -> tuple[float, float]:
    evaluation = problem.evaluate(row.astype(bool)[None])
    return float(evaluation.violation[0]), round(float(evaluation.objectives[0, 0]), 9)


def test_the_swarm_moves_as_its_equations_say() -> None:
    task = termsel.prepare("poly-terms", options={"degree": 2, "max_share": 1})
    steps = []
    termsel.search(task.problem, termsel.get("solver", "pso")(population=8, neighbours=2), seed=5,
                   generations=6, observers=[
                       lambda progress: steps.append(progress.generation.genes)])
    expected = by_particle(task.problem, 5, 8, 6, 2)
    assert len(steps) == len(expected) == 7
    for found, own in zip(steps, expected, strict=True):
        assert (found == own.astype(bool)).all()


def test_hybrid_3_judges_a_selection_by_its_interpolated_residuals() -> None:
    pytest.importorskip("termsel_hybrids")
    task = termsel.prepare("poly-terms", model="hybrid-3", options={"degree": 2, "max_share": 1})
    control, check = task.observations.control.points, task.observations.check
    lowest = control.ground[:, :2].min(axis=0)
    highest = control.ground[:, :2].max(axis=0)

    def scaled(ground: np.ndarray) -> np.ndarray:
        return 2 * (ground[:, :2] - lowest) / (highest - lowest) - 1

    def columns(ground: np.ndarray) -> np.ndarray:
        x, y = scaled(ground).T
        return np.column_stack([np.ones(len(x)), x, y, x * y, x * x, y * y])

    def distances(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.array([[math.dist(p, q) for q in scaled(b)] for p in scaled(a)])

    # The same terms of both axes: 1, X, Y and XY.
    names = ("1", "X", "Y", "XY")
    genes = np.isin([label.partition("num:")[2] for label in task.problem.genome.labels], names)
    errors = np.empty((len(check), 2))
    for axis in (0, 1):
        design, target = columns(control.ground)[:, :4], control.image[:, axis]
        solved = np.linalg.lstsq(design, target, rcond=None)[0]
        weights = np.linalg.solve(distances(control.ground, control.ground),
                                  target - design @ solved)
        predicted = columns(check.ground)[:, :4] @ solved \
            + distances(check.ground, control.ground) @ weights
        errors[:, axis] = predicted - check.image[:, axis]
    expected = math.sqrt((errors**2).sum(axis=1).mean())
    assert task.problem.evaluate(genes[None]).objectives[0, 0] == pytest.approx(expected, rel=1e-6)


def test_the_median_error_by_area_is_that_of_hull_and_median() -> None:
    spatial = pytest.importorskip("scipy.spatial")
    pytest.importorskip("termsel_rpc")
    task = termsel.prepare("owdis-points", model="affine", criterion="e50-area",
                           options={"min_features": 9, "max_features": 9, "check_as": "judge"})
    control, check = task.observations.control.points, task.observations.check
    genes = task.problem.genome.random(np.random.default_rng(3), 5)
    image = control.image
    extent = image.max(axis=0) - image.min(axis=0)
    expected = []
    for row in genes:
        columns = np.column_stack([np.ones(len(image)), control.ground])
        solved = np.linalg.lstsq(columns[row], image[row], rcond=None)[0]
        errors = np.column_stack([np.ones(len(check)), check.ground]) @ solved - check.image
        # The area of a hull in the plane is its volume.
        covered = spatial.ConvexHull(image[row]).volume / extent.prod()
        expected.append(np.median(np.hypot(*errors.T)) / covered)
    found = task.problem.evaluate(genes).objectives[:, 0]
    assert found == pytest.approx(expected, rel=1e-6)


def test_a_mutant_of_the_steady_state_has_any_one_feature_replaced_by_any_other() -> None:
    member, n, repetitions = [0, 2, 5], 7, 24_000
    mutants = replace_one(np.tile(member, (repetitions, 1)), n, 1.0, np.random.default_rng(1))
    counts = Counter(map(tuple, mutants.tolist()))
    # By hand: each of three members leaves, and each of four outsiders comes in its place.
    expected = {tuple(sorted(set(member) - {gone} | {new}))
                for gone in member for new in set(range(n)) - set(member)}
    assert set(counts) == expected
    # Twelve mutants are equally likely: 2,000 of each, with a standard deviation of 43.
    assert all(abs(count - repetitions / 12) < 5 * 43 for count in counts.values())


def test_a_child_of_the_steady_state_keeps_what_is_shared_and_draws_the_rest_evenly() -> None:
    parents, repetitions = ([0, 1, 2, 6], [0, 3, 5, 6]), 8_000
    pairs = np.tile(np.array(parents), (repetitions, 1))
    children = set_crossover(pairs, 1.0, np.random.default_rng(2))
    counts = Counter(map(tuple, children.tolist()))
    # By hand: 0 and 6 are of both; two of the four others are drawn, which are six pairs.
    expected = {tuple(sorted({0, 6, *rest})) for rest in combinations((1, 2, 3, 5), 2)}
    assert set(counts) == expected
    # Of 16,000 children a sixth, with a standard deviation of 47.
    assert all(abs(count - 2 * repetitions / 6) < 5 * 47 for count in counts.values())
    assert (set_crossover(pairs, 0.0, np.random.default_rng(2)) == pairs).all()


def test_the_steady_state_keeps_the_best_half_of_different_chromosomes() -> None:
    task = termsel.prepare("owdis-points", model="affine",
                           options={"min_features": 6, "max_features": 6, "check_as": "judge"})
    generations = []
    termsel.search(task.problem, termsel.get("solver", "ga-steady")(population=10), seed=4,
                   generations=5, observers=[
                       lambda progress: generations.append(progress.generation)])
    for earlier, later in pairwise(generations):
        ranked = sorted(zip(earlier.evaluation.violation.tolist(),
                            earlier.evaluation.objectives[:, 0].tolist(),
                            map(bytes, earlier.genes.astype(np.uint8)), strict=True))
        best = list(dict.fromkeys(genes for _, _, genes in ranked))[:5]
        assert set(best) <= set(map(bytes, later.genes.astype(np.uint8)))
