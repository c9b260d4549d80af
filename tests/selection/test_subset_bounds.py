"""The bound of the enumeration, against subsets whose score is known."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

import numpy as np
import pytest

from termsel.data.features import FloatArray
from termsel.selection.best_subsets import rising_bound, subsets
from termsel.selection.best_subsets.bounds import held_out as subset_held_out
from termsel.selection.best_subsets.bounds.closed import first_closed_by_parts
from termsel.selection.best_subsets.columns.kernels import LINEAR, RATIONAL
from termsel.selection.best_subsets.columns.system import SCORES, Masks, SubsetSystem, SubtreeNode
from termsel.selection.best_subsets.score_systems import ScoreSystems, score_systems

pytestmark = pytest.mark.usefixtures("bounds_of_few")


def test_a_limit_that_a_subset_scores_never_rules_it_out() -> None:
    """The least limit at which a bound must let a subset pass is its own score."""
    rng = np.random.default_rng(19)
    closed = lowered = 0
    for _ in range(150):
        k, c = rng.integers(4, 26), rng.integers(1, 20)
        m = int(rng.integers(3, k + 8))
        A, d = rng.normal(size=(2, m, k)) * np.array([1, 0.1])[:, None, None]
        C, dc = rng.normal(size=(2, c, k)) * np.array([1, 0.1])[:, None, None]
        x = rng.normal(size=k) * (rng.random(k) < 0.4)
        b, f = A @ x + rng.normal(size=m) / 100, C @ x + rng.normal(size=c) / 100
        systems = score_systems(SubsetSystem(A, b[:, None], C, f[:, None], d, dc), "check", (),
                                None)
        for _ in range(8):
            size = int(rng.integers(1, min(m, k) + 1))
            chosen = rng.permutation(k)[:size]
            x = np.linalg.lstsq(A[:, chosen], b, rcond=None)[0]
            below = 1 + dc[:, chosen] @ x
            if below.min() < 0.1 or np.linalg.cond(A[:, chosen]) > 1e4:
                continue
            score = float((((f - C[:, chosen] @ x) / below) ** 2).sum())
            used = chosen[:rng.integers(0, size)]
            rest = rng.permutation(np.setdiff1d(np.arange(k), used))
            vectors, limits, _ = systems._vectors_of_node(SubtreeNode(used, rest, len(rest)))
            first = int(np.flatnonzero(np.isin(rest, chosen))[0])
            upper = np.append(np.ones(c), 1 / (limits.margin * c))
            end = first_closed_by_parts(
                vectors.top[0, 0], vectors.extra[0, 0], first, len(rest), score * (1 + 1e-9), upper,
                True, systems._space(vectors).bound)
            assert end > first
            assert (np.append(below, 1) / below.sum() <= upper * (1 + 1e-9)).all()
            closed += end < len(rest)
            lowered += upper[:c].min() < 0.9
    assert closed > 50
    assert lowered > 200


def test_a_held_out_bound_keeps_its_digits_where_targets_are_long() -> None:
    """Residuals of 1e-5 of the target or less, and columns alike: the minimum is theirs."""
    rng = np.random.default_rng(20)
    for _ in range(300):
        n, r = int(rng.integers(4, 14)), int(rng.integers(1, 3))
        m = n + int(rng.integers(4, 25))
        A = rng.normal(size=(m, 1)) + 10.0 ** rng.uniform(-3, -1) * rng.normal(size=(m, n))
        b = A @ rng.normal(size=(n, r)) + 10.0 ** rng.uniform(-7, -5) * rng.normal(size=(m, r))
        leverage = rng.uniform(0.0, 0.9, m)
        q = np.linalg.qr(A / (1 - leverage)[:, None])[0]
        least = b / (1 - leverage)[:, None]
        for _ in range(2):
            least -= q @ (q.T @ least)
        top, work = np.ascontiguousarray(np.hstack([A, b]).T), np.empty((n + r, m))
        for limit, end in ((1 + 1e-7, 1), (1 - 1e-5, 0)):
            assert subset_held_out.first_prunable_column(
                top, leverage, 0, n, limit * float((least**2).sum()), work) == end


@pytest.mark.parametrize("score", ["rss", "press", "check"])
def test_subsets_of_few_columns_are_decided_before_all_others(
        score: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is decided of them holds, though the rest is walked without a look at their sizes."""
    def nothing(systems: ScoreSystems) -> Iterator[tuple[FloatArray, Masks]]:
        yield np.full(systems.k + 1, np.inf), np.zeros(systems.k + 1, dtype=np.uint64)

    rng = np.random.default_rng(3)
    A, b = rng.normal(size=(18, 9)), rng.normal(size=(18, 1))
    system = SubsetSystem(A[:12], b[:12], A[12:], b[12:])
    *_, plain = subsets.search(system, score)
    monkeypatch.setattr(subsets, "descend_through_subsets", nothing)
    for name in ("_SMALL_SIZES", "_NODE_SUBSETS", "_BOUNDED_SUBSETS"):
        monkeypatch.setattr(subsets, name, 100)
    monkeypatch.setattr(subsets, "_DESCEND_FROM", 1)
    states = list(subsets.search(system, score))
    final = states[-1].best
    assert final == pytest.approx(plain.best)
    assert (states[-1].masks == plain.masks).all()
    few = next(state for state in states if state.subsets).floor[:3]
    assert few == pytest.approx(final[:3])  # 1 + 9 + 36 of at most 2, and 84 of 3
    for state in states:
        assert (state.floor <= final * (1 + 1e-9)).all()


@pytest.mark.parametrize("rational", [False, True])
def test_a_bound_of_all_scores_comes_before_any_is_decided(
        rational: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where no good subset is known: a rung then finds those below it."""
    monkeypatch.setattr(rising_bound, "_SHARES", dict.fromkeys((LINEAR, RATIONAL), (0.5, 0.9)))
    rng = np.random.default_rng(5)
    for _ in range(20):
        A, C = rng.normal(size=(2, 14, 9))
        b, f = A[:, :3].sum(axis=1) + rng.normal(size=14), C[:, :3].sum(axis=1)
        below = rng.normal(size=(2, 14, 9)) / 50 if rational else (None, None)
        system = SubsetSystem(A, b[:, None], C, f[:, None], *below)
        *_, proof = subsets.search(system, "check", max_terms=6)
        systems = score_systems(system, "check", (), 6)
        for share, least in ((1.0, 0.81), (8.0, 2.0)):  # of the optimum, as the best known
            known = np.full(10, share * proof.best.min())
            *_, (best, masks, level) = rising_bound.raise_bound(
                systems, known, np.zeros(10, dtype=np.uint64), 1 << 6, 1)
            assert level == pytest.approx(least * proof.best.min())
            assert (proof.best >= np.minimum(best, level) * (1 - 1e-9)).all()
            lower = best < known
            assert lower.any() == (share > 1.0)
            assert best[lower] == pytest.approx(proof.best[lower])
            assert (masks[lower] == proof.masks[lower]).all()


@pytest.mark.parametrize("score", SCORES)
def test_few_subsets_are_enumerated_without_bounds(score: str,
                                                   monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    rows = rng.normal(size=(40, 14))
    rows[:, 13] += rows[:, :4] @ [20.0, 10.0, 5.0, 2.0]  # of noise alone bounds rule out nothing
    system = SubsetSystem(rows[:24, :13], rows[:24, 13:], rows[24:, :13], rows[24:, 13:])
    folds = [np.arange(i, 24, 5) for i in range(5)] if score == "kfold" else ()
    bounded = deque(subsets.search(system, score, folds=folds), maxlen=1).pop()
    monkeypatch.setattr("termsel.selection.best_subsets.score_systems.WALKED", 1 << 13)
    walked = deque(subsets.search(system, score, folds=folds), maxlen=1).pop()
    assert walked.pruned == 0 < bounded.pruned
    np.testing.assert_allclose(walked.best, bounded.best, rtol=1e-9)
    np.testing.assert_array_equal(walked.masks, bounded.masks)
