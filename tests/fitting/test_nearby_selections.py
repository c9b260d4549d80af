"""Selections of features next to a known one are solved as on their own."""

from __future__ import annotations

import numpy as np
import pytest

from termsel import prepare
from termsel.adjustment import Equations, nearby
from termsel.adjustment.kernels import solve_many
from termsel.data.features import BoolArray
from termsel.selection.solvers.heuristics.swap import neighbour_batches
from termsel.selection.solvers.ledger import Ledger


def near(start: BoolArray, rng: np.random.Generator) -> BoolArray:
    """Return features next to those of a start, and some that are not."""
    n = len(start)
    features = np.repeat(start[None], 60, axis=0)
    for one in features[:20]:
        one[rng.integers(n)] ^= True
    for one in features[20:50]:
        one[rng.choice(np.flatnonzero(start))] = False
        one[rng.choice(np.flatnonzero(~start))] = True
    features[50:54] ^= rng.random((4, n)) < 0.1
    features[54:58] = rng.random((4, n)) < 0.5
    features[58:, 8] ^= True
    return features


@pytest.mark.parametrize("prior", [False, True])
@pytest.mark.parametrize("rows", [1, 2, 5])
def test_neighbours_are_solved_as_alone(rows: int, prior: bool,
                                        monkeypatch: pytest.MonkeyPatch) -> None:
    rng, n, k = np.random.default_rng(rows), 60, 12
    feature = np.sort(np.concatenate([np.arange(n), rng.integers(0, n, (rows - 1) * n)]))
    A = rng.normal(size=(len(feature), k)) @ np.diag(10.0 ** rng.integers(-3, 4, k))
    A[feature == 7] *= 1e4  # one feature that outweighs all others
    A[:, -1] *= feature < 9  # and a term that few features determine
    equations = Equations(A, rng.normal(size=len(feature)), feature,
                          np.full(k, 0.1) if prior else None)
    asked = []
    monkeypatch.setattr(nearby, "solve_many", lambda *args: asked.append(len(args[2]))
                        or solve_many(*args))
    monkeypatch.setattr(nearby, "MAX_FEATURE_ROWS", 12)
    for start in (np.arange(n) % 2 == 0, np.arange(n) != 7, np.arange(n) >= 8,
                  np.arange(n) > 8):
        features = near(start, rng)
        x, violation = nearby.solve_near(equations, start, features)
        expected, lacking = solve_many(equations, None, features)
        np.testing.assert_array_equal(violation, lacking)
        gap = np.linalg.norm((x - expected) @ A.T, axis=1)
        assert (gap <= 1e-8 * np.linalg.norm(expected @ A.T, axis=1)).all()
    assert all(count >= 8 for count in asked)
    assert min(asked) < 30


def test_a_start_that_determines_nothing_has_neighbours_all_the_same() -> None:
    rng = np.random.default_rng(1)
    equations = Equations(rng.normal(size=(40, 12)), rng.normal(size=40), np.arange(40))
    for start in (np.arange(40) < 11, np.arange(40) < 12, np.arange(40) < 0):
        features = np.repeat(start[None], 40, axis=0) ^ np.eye(40, dtype=bool)
        for ours, theirs in zip(nearby.solve_near(equations, start, features),
                                solve_many(equations, None, features), strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize("name", ["owdis-lines", "owdis-points", "owdis-points-terms"])
def test_a_search_sees_the_same_neighbours(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = prepare(name).problem
    monkeypatch.setattr(nearby, "MIN_WORK", 0)
    start = problem.genome.random(np.random.default_rng(3), 1)[0]
    ledger, around = Ledger(problem), next(neighbour_batches(start, problem.genome))
    found, expected = ledger.evaluate_near(around, start), problem.evaluate(around)
    np.testing.assert_allclose(found.objectives, expected.objectives, rtol=1e-8)
    np.testing.assert_allclose(found.violation, expected.violation, rtol=1e-8)
    again = ledger.evaluate(around)
    np.testing.assert_array_equal(again.objectives, found.objectives)
    assert (ledger.count, ledger.lookups) == (2 * len(around), len(around))
