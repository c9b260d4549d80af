"""Branch and bound of residual sums of squares, against every subset."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np
import pytest

from termsel.data.features import FloatArray
from termsel.selection.best_subsets import score_systems as score_systems_module
from termsel.selection.best_subsets import subsets
from termsel.selection.best_subsets.bounds.poles import node_bound, order_columns
from termsel.selection.best_subsets.columns.system import SubsetSystem, SubtreeNode
from termsel.selection.best_subsets.descents import _single_changes
from termsel.selection.best_subsets.score_systems import ScoreSystems, score_systems
from termsel.selection.best_subsets.splicing import find_best_by_splicing, tells_changes
from termsel.selection.best_subsets.subsets import SubsetResult, search

pytestmark = pytest.mark.usefixtures("bounds_of_few")


def last(system: SubsetSystem, **options: object) -> SubsetResult:
    return deque(search(system, "rss", **options), maxlen=1).pop()


def one_by_one(system: SubsetSystem, most: int | None,
               monkeypatch: pytest.MonkeyPatch) -> SubsetResult:
    with monkeypatch.context() as patch:
        patch.setattr(ScoreSystems, "branches", False)
        patch.setattr(ScoreSystems, "holds_out", False)
        return last(system, max_terms=most)


def quotient(rng: np.random.Generator, k: int) -> SubsetSystem:
    """Return a quotient that was multiplied out: columns alike, and poles between the points."""
    m, g = int(rng.integers(6, 20)), int(rng.integers(1, 12))
    x = rng.uniform(-1, 1, size=(m + g, 2))
    powers = np.stack([x[:, 0] ** i * x[:, 1] ** j for i in range(4) for j in range(4)],
                              axis=1)
    above, below = powers[:, :k // 2], powers[:, 1:1 + k - k // 2]
    with np.errstate(divide="ignore"):
        target = (above @ rng.normal(size=k // 2)
                  / (1 + below @ rng.normal(size=below.shape[1]) * 0.3))[:, None]
    target += 10.0 ** rng.uniform(-6, 0) * rng.normal(size=target.shape)
    return SubsetSystem(np.hstack([above, -target * below])[:m], target[:m], guard_denominator=
                        np.hstack([0 * above, below]), margin=float(rng.uniform(0.05, 0.9)))


def problem(rng: np.random.Generator) -> SubsetSystem:
    """Return 8 to 11 columns with poles or two targets or ties, and rules on the subsets."""
    k = int(rng.integers(8, 12))
    kind = rng.integers(4)
    if kind < 2:
        system = quotient(rng, k)
    else:
        m = int(rng.integers(5, 18))
        design = rng.normal(size=(m, k)) if kind == 2 else rng.integers(-1, 2, (m, k)).astype(float)
        target = design[:, :3] @ rng.normal(size=(3, 1 + kind % 2))
        system = SubsetSystem(design, target + 0.1 * rng.normal(size=target.shape))
    forced, forbidden = np.zeros((2, k), dtype=bool)
    if rng.random() < 0.3:
        forced[rng.integers(k)] = True
    if rng.random() < 0.3:
        forbidden[rng.integers(k)] = True
    parents = rng.random((k, k)) < 0.1
    return replace(system, forced=forced, forbidden=forbidden & ~forced,
                   some_of=rng.random(k) < 0.5 if rng.random() < 0.3 else None,
                   parents=parents & ~np.eye(k, dtype=bool) if rng.random() < 0.3 else None)


@pytest.mark.slow
@pytest.mark.parametrize("problems", [120, 5000])
def test_no_best_subset_is_lost(problems: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(score_systems_module, "_ENUMERATED", 3)
    pruned = poles = 0
    for seed in range(problems):
        rng = np.random.default_rng([seed, problems])
        system = problem(rng)
        most = None if rng.random() < 0.5 else int(rng.integers(2, 9))
        plain, found = one_by_one(system, most, monkeypatch), last(system, max_terms=most)
        np.testing.assert_allclose(found.best, plain.best, rtol=1e-6,
                                   atol=1e-13 * (system.target**2).sum(), err_msg=str(seed))
        assert found.complete
        pruned += found.pruned
        free = replace(system, guard_denominator=None)
        poles += (last(free, max_terms=most).best < 0.9 * found.best).sum()
    assert pruned > 100 * problems
    assert poles > problems / 4  # bounds had poles to see


def test_guard_points_raise_the_bound() -> None:
    """Never above the best of a piece, and often above the residuals of all its columns."""
    raised = 0
    for seed in range(150):
        rng = np.random.default_rng([seed, 7])
        system = quotient(rng, 8)
        ready = score_systems(system, "rss", (), None)
        order = rng.permutation(8)
        used, rest = order[:rng.integers(0, 3)], order[3:]
        piece = SubtreeNode(used, rest, len(rest))
        inside = ready.walk(piece, np.full(9, np.inf), np.zeros(9, dtype=np.uint64)).best.min()
        columns = np.concatenate([used, rest])
        fit = np.linalg.lstsq(system.design[:, columns], system.target)[0]
        least = float(((system.target - system.design[:, columns] @ fit) ** 2).sum())
        bound = node_bound(ready._tree(piece)[0], 0, inside if inside < np.inf else 1.0)
        slack = 1e-12 * (system.target**2).sum()
        assert bound <= inside * (1 + 1e-6) + slack
        raised += bound > 1.1 * least + slack
    assert raised > 30


def test_bounds_without_a_column_hold_whatever_weights_a_node_inherits() -> None:
    lowered = 0
    for seed in range(60):
        rng = np.random.default_rng([seed, 8])
        system, k = quotient(rng, 8), 8
        ready = score_systems(system, "rss", (), None)
        tree = ready._tree(SubtreeNode(np.arange(0), np.arange(k), k))[0]
        m = min(len(tree.required), 12)
        tree.weights[0], tree.point[0, :m] = m, np.arange(m)
        tree.weight[0, :m] = tree.rss[0] * 10.0 ** rng.uniform(-2, 3, size=m)
        bound = node_bound(tree, 0, 1.0)
        assert bound >= tree.rss[0]
        lowered += tree.weights[0] == 0
        order_columns(tree, 0, bound)
        for i, value in zip(tree.order[0, :k], tree.bound[0, :k], strict=True):
            piece = SubtreeNode(np.arange(0), np.delete(np.arange(k), i), k - 1)
            least = ready.walk(piece, np.full(9, np.inf), np.zeros(9, dtype=np.uint64)).best.min()
            assert value <= least * (1 + 1e-6) + 1e-12 * (system.target**2).sum(), seed
    assert lowered > 5


def test_a_bound_is_not_below_what_all_columns_leave_after_few_sweeps() -> None:
    """A limit that is far off ends the sweeps early, so that inherited weights stay too high."""
    columns = np.arange(8)
    for seed in range(60):
        ready = score_systems(quotient(np.random.default_rng([seed, 8]), 8), "rss", (), None)
        for limit in (1.0, 1e9):
            for scale in (0.1, 1.0, 10.0):
                tree = ready._tree(SubtreeNode(columns[:0], columns, 8))[0]
                m = min(len(tree.required), 12)
                tree.weights[0], tree.point[0, :m] = m, np.arange(m)
                tree.weight[0, :m] = tree.rss[0] * scale * np.linspace(0.5, 1.0, m)
                assert node_bound(tree, 0, limit) >= tree.rss[0]


def test_what_few_columns_can_do_stays_proven(monkeypatch: pytest.MonkeyPatch) -> None:
    beaten = 0
    for name, value in (("_DESCEND_FROM", 1), ("_SMALL_SIZES", 600)):
        monkeypatch.setattr(subsets, name, value)
    for seed in range(10):
        system = quotient(np.random.default_rng([seed, 9]), 11)
        *_, found = search(system, "rss", cost=lambda scores: scores + np.arange(12.0))
        settled = slice(0, 5)
        assert (found.floor[settled] == found.best[settled]).all()
        figures = found.best[settled] + np.arange(5)
        beaten += (figures > np.minimum.accumulate(figures)).sum()
    assert beaten > 5


@pytest.mark.slow
def test_with_figures_the_sizes_that_smaller_ones_beat_stay_unknown(
        monkeypatch: pytest.MonkeyPatch) -> None:
    spared = 0
    for name, value in (("_DESCEND_FROM", 1), ("_SMALL_SIZES", 1), ("_BOUNDED_SUBSETS", 64)):
        monkeypatch.setattr(subsets, name, value)
    for seed in range(25):
        rng = np.random.default_rng([seed, 9])
        system = quotient(rng, 11)
        sizes, m = np.arange(12), len(system.design)

        def cost(scores: FloatArray, m: int = m, sizes: FloatArray = sizes) -> FloatArray:
            with np.errstate(divide="ignore"):
                return np.where(sizes < m - 1, m * np.log(scores / m) + np.log(m) * sizes, np.inf)

        whole = last(system)
        runs = [list(search(system, "rss", workers=w, cost=cost)) for w in (1, 2)]
        for one, two in zip(*runs, strict=True):
            assert (one.best == two.best).all()
            assert (one.masks == two.masks).all()
        found, known = runs[0][-1], cost(whole.best)
        front = known < np.minimum.accumulate(np.append(np.inf, known))[:-1]
        assert found.complete
        assert (found.masks[front] == whole.masks[front]).all()
        assert found.floor[front] == pytest.approx(whole.best[front], rel=1e-9)
        for state in runs[0]:
            assert (state.floor <= np.minimum(whole.best, state.best) * (1 + 1e-9)).all()
        beaten = ~front & np.isfinite(known)
        assert (cost(found.floor)[beaten] >= np.minimum.accumulate(known)[beaten] - 1e-9).all()
        spared += (found.floor < whole.best)[beaten].sum()
    assert spared > 25


def with_check_points(rng: np.random.Generator, system: SubsetSystem) -> SubsetSystem:
    """Return a quotient, or a polynomial, that is judged at as many check points as control."""
    rows = rng.permutation(len(system.design))
    half = len(rows) // 2
    check, control = rows[:half], rows[half:]
    is_quotient = rng.integers(2) and system.target.shape[1] == 1
    below = rng.uniform(-0.3, 0.3, system.design.shape) if is_quotient else None
    return replace(system, design=system.design[control], target=system.target[control],
                   check_design=system.design[check], check_target=system.target[check],
                   denominator=None if below is None else below[control],
                   check_denominator=None if below is None else below[check])


@pytest.mark.parametrize("score", ["rss", "check"])
def test_splicing_finds_the_best_of_all_changes_by_a_column(score: str) -> None:
    rng = np.random.default_rng(11)
    compared = 0
    for _ in range(120):
        system = problem(rng)
        if score == "check":
            system = with_check_points(rng, system)
        systems = score_systems(system, score, (), int(rng.integers(3, 7)))
        if not tells_changes(systems):
            continue
        everything = systems.everything
        count = int(rng.integers(0, everything.room + 1))
        members = rng.permutation(everything.candidates)[:count]
        mask = int(sum(1 << int(column) for column in (*everything.used, *members)))
        nothing = (np.full(systems.k + 1, np.inf), np.zeros(systems.k + 1, dtype=np.uint64))
        found = find_best_by_splicing(systems, mask, *nothing, set())
        best, masks = nothing
        for node in _single_changes(systems, mask):
            walked = systems.walk(node, best, masks)
            best, masks = walked.best, walked.masks
        if found is None:
            continue
        sizes = np.flatnonzero(np.isfinite(found[0]))
        np.testing.assert_allclose(found[0][sizes], best[sizes], rtol=1e-7, atol=1e-12)
        compared += len(sizes)
    assert compared > 100
