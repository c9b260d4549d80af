"""Every best subset against brute force through LAPACK, one subset at a time."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from termsel.adjustment.equations import Equations
from termsel.adjustment.solve import solve
from termsel.core.errors import TermselError
from termsel.selection.best_subsets import subsets
from termsel.selection.best_subsets.columns.system import (
    SCORES,
    SubsetSystem,
    SubtreeNode,
    better_of_each_size,
    count_subsets,
)
from termsel.selection.best_subsets.score_systems import ScoreSystems, score_systems
from termsel.selection.best_subsets.subsets import SubsetResult, estimate_seconds, search

pytestmark = pytest.mark.usefixtures("bounds_of_few")


def last(system: SubsetSystem, score: str, **options: object) -> SubsetResult:
    return deque(search(system, score, **options), maxlen=1).pop()


def coefficients(design: np.ndarray, target: np.ndarray, columns: np.ndarray) -> np.ndarray | None:
    """All right-hand sides' solution for some columns; None if they are dependent."""
    x = np.zeros((design.shape[1], target.shape[1]))
    if columns.any():
        lengths = np.linalg.norm(design[:, columns], axis=0)
        if (lengths == 0).any():
            return None
        found, _, rank, _ = np.linalg.lstsq(design[:, columns] / lengths, target, rcond=1e-9)
        if rank < columns.sum():
            return None
        x[columns] = found / lengths[:, None]
    return x


def squares(errors: np.ndarray, below: np.ndarray | None, margin: float) -> float:
    """Sum of squared errors; infinite below the margin."""
    if below is None:
        return float((errors**2).sum())
    return float(((errors / below) ** 2).sum()) if (below >= margin).all() else np.inf


def score_of(system: SubsetSystem, score: str, columns: np.ndarray,
             folds: Sequence[np.ndarray]) -> float:
    """Score of one subset; infinite where it is infeasible."""
    A, t = system.design, system.target
    x = coefficients(A, t, columns)
    if x is None:
        return np.inf
    if score == "rss":
        return float(((t - A @ x) ** 2).sum())
    if score == "check":
        below = None if system.check_denominator is None else 1 + system.check_denominator @ x
        return squares(system.check_target - system.check_design @ x, below, system.margin)
    if score == "press":
        folds = [np.array([i]) for i in range(len(A))]
    total = 0.0
    for fold in folds:
        kept = np.delete(np.arange(len(A)), fold)
        x = coefficients(A[kept], t[kept], columns)
        if x is None:
            return np.inf
        below = None if system.denominator is None else (1 + system.denominator @ x)[fold]
        total += squares((t - A @ x)[fold], below, system.margin)
    return total


def masks_of(system: SubsetSystem, max_terms: int | None) -> Iterator[np.ndarray]:
    k = system.design.shape[1]
    for number in range(2**k):
        columns = np.array([number >> j & 1 for j in range(k)], dtype=bool)
        if (
            (system.forced is None or columns[system.forced].all())
            and (system.forbidden is None or not columns[system.forbidden].any())
            and (max_terms is None or columns.sum() <= max_terms)
        ):
            yield columns


def accepted(system: SubsetSystem, columns: np.ndarray) -> bool:
    if system.some_of is not None and not (columns & system.some_of).any():
        return False
    if system.guard_denominator is None:
        return True
    x = coefficients(system.design, system.target, columns)
    return bool((1 + system.guard_denominator @ x >= system.margin).all())


def assert_proven(system: SubsetSystem, score: str, folds: Sequence[np.ndarray] = (),
                  max_terms: int | None = None, rtol: float = 1e-8) -> SubsetResult:
    """Compare with brute force; tiny scores are rounding error and count as equal."""
    k = system.design.shape[1]
    best, n = np.full(k + 1, np.inf), 0
    for columns in masks_of(system, max_terms):
        n += 1
        value = score_of(system, score, columns, folds)
        if value < best[columns.sum()] and accepted(system, columns):
            best[columns.sum()] = value
    result = last(system, score, folds=folds, max_terms=max_terms)
    tiny = 1e-18 * (1 + (system.target**2).sum())
    np.testing.assert_allclose(result.best, best, rtol=rtol, atol=tiny)
    assert result.complete
    assert result.subsets == result.total == n
    np.testing.assert_array_equal(result.floor, result.best)
    for size in np.flatnonzero(np.isfinite(best)):
        columns = result.columns(size)
        assert columns.sum() == size
        assert accepted(system, columns)
        np.testing.assert_allclose(score_of(system, score, columns, folds), best[size],
                                   rtol=rtol, atol=tiny)
    return result


def polynomial(rng: np.random.Generator, k: int = 6, m: int = 9, c: int = 7,
               r: int = 1) -> SubsetSystem:
    return SubsetSystem(rng.normal(size=(m, k)), rng.normal(size=(m, r)),
                        rng.normal(size=(c, k)), rng.normal(size=(c, r)))


def rational(rng: np.random.Generator, m: int = 10, c: int = 8) -> SubsetSystem:
    """A quotient of 1, x, y and 1 + (x, y, xy) b, multiplied out."""
    x, y = rng.uniform(-1, 1, (2, m + c + 4))
    above, below = np.stack([0 * x + 1, x, y], 1), np.stack([x, y, x * y], 1)
    target = (above @ [0.2, 1, 0.3] / (1 + below @ [0.3, -0.5, 0.4]))[:, None]
    target += rng.normal(size=target.shape) * 0.05
    design, denominator = np.hstack([above, -target * below]), np.hstack([0 * above, below])
    train, check, guard = np.split(np.arange(m + c + 4), [m, m + c])
    return SubsetSystem(design[train], target[train], design[check], target[check],
                        denominator[train], denominator[check], denominator[guard], margin=0.4)


def folds_of(m: int) -> list[np.ndarray]:
    return np.array_split(np.arange(m), 3)


@pytest.mark.parametrize("score", SCORES)
@pytest.mark.parametrize("r", [1, 2])
def test_best_of_every_size(score: str, r: int) -> None:
    rng = np.random.default_rng(r)
    system = polynomial(rng, r=r)
    result = assert_proven(system, score, folds_of(9) if score == "kfold" else ())
    assert np.isfinite(result.best).all()


@pytest.mark.parametrize("score", SCORES)
@pytest.mark.parametrize("seed", [1, 2])
def test_denominators_and_guard(score: str, seed: int) -> None:
    system = rational(np.random.default_rng(seed))
    folds = folds_of(10) if score == "kfold" else ()
    assert_proven(system, score, folds)
    assert score == "rss" or any(score_of(system, score, columns, folds) == np.inf  # poles
                                 for columns in masks_of(system, None))
    free = replace(system, guard_denominator=None)
    assert_proven(free, score, folds)


@pytest.mark.parametrize("score", SCORES)
def test_forced_forbidden_some_of_and_max_terms(score: str) -> None:
    rng = np.random.default_rng(5)
    k = 7
    system = replace(polynomial(rng, k=k), forced=np.arange(k) == 2, forbidden=np.arange(k) == 4,
                     some_of=np.isin(np.arange(k), [0, 6]))
    for max_terms in (None, 1, 3):
        result = assert_proven(system, score, folds_of(9) if score == "kfold" else (), max_terms)
        assert result.best[0] == np.inf
        assert result.best[1] == np.inf  # the forced column is not one of those demanded
        assert result.total == count_subsets(5, None if max_terms is None else max_terms - 1)


@pytest.mark.parametrize("score", SCORES)
def test_more_columns_than_rows(score: str) -> None:
    system = polynomial(np.random.default_rng(6), k=6, m=4)
    folds = [np.array([0]), np.array([2])] if score == "kfold" else ()
    result = assert_proven(system, score, folds)
    assert np.isinf(result.best[5:]).all()


@given(data=st.data(), score=st.sampled_from(SCORES))
@settings(max_examples=60, deadline=None)
def test_small_integers_with_dependent_columns_and_ties(data: st.DataObject, score: str) -> None:
    m, k, c = (data.draw(st.integers(1, high)) for high in (6, 4, 4))
    numbers = data.draw(st.lists(st.integers(-2, 2), min_size=(m + c) * (k + 1),
                                 max_size=(m + c) * (k + 1)))
    rows = np.array(numbers, dtype=float).reshape(m + c, k + 1)
    system = SubsetSystem(rows[:m, :k], rows[:m, k:], rows[m:, :k], rows[m:, k:])
    assert_proven(system, score, [np.arange(m // 2), np.arange(m // 2, m)]
                  if score == "kfold" else ())


@given(numbers=st.lists(st.integers(-2, 2), min_size=20, max_size=20))
@example(numbers=[0] * 12 + [1, 0, 0, 0, 1, 0, 1, 1])  # twins, one left of the other by rounding
@settings(max_examples=15, deadline=None)
def test_the_verdict_is_that_of_the_adjustment(numbers: list[int]) -> None:
    design = np.array(numbers, dtype=float).reshape(5, 4)
    system = SubsetSystem(design, np.ones((5, 1)), design, np.ones((5, 1)))
    equations = Equations(design, system.target[:, 0], np.arange(5))
    for columns in masks_of(system, None):
        best = last(replace(system, forced=columns, forbidden=~columns), "check").best
        assert np.isfinite(best[columns.sum()]) == solve(equations, columns).feasible


def test_the_better_subset_of_a_tie_is_the_smaller_mask() -> None:
    one, other = np.array([1.0, 2.0, 3.0, np.inf]), np.array([1.0, 2.0, 2.5, 7.0])
    masks, at = np.array([6, 3, 1, 0], dtype=np.uint64), np.array([5, 12, 9, 2], dtype=np.uint64)
    for pair in ((one, masks, other, at), (other, at, one, masks)):
        best, kept = better_of_each_size(*pair)
        np.testing.assert_array_equal(best, [1.0, 2.0, 2.5, 7.0])
        np.testing.assert_array_equal(kept, [5, 3, 9, 2])


def test_equal_scores_keep_the_smallest_mask() -> None:
    """Columns that are twins in every way but their place."""
    design = np.eye(6)[:, :4]
    system = SubsetSystem(design, np.ones((6, 1)), design, np.ones((6, 1)))
    for score in ("check", "rss"):
        np.testing.assert_array_equal(last(system, score).masks[:2], [0, 1])


@pytest.mark.parametrize("score", SCORES)
def test_ill_conditioned_columns(score: str) -> None:
    rng = np.random.default_rng(7)
    k = 7
    basis = np.linalg.qr(rng.normal(size=(k, k)))[0] * np.logspace(0, -6, k)[:, None]
    rows = np.linalg.qr(rng.normal(size=(40, k)))[0] @ basis
    target = rows @ rng.normal(size=(k, 1)) + 1e-4 * rng.normal(size=(40, 1))
    assert np.linalg.cond(rows[:20]) > 5e5
    system = SubsetSystem(rows[:20], target[:20], rows[20:], target[20:])
    assert_proven(system, score, folds_of(20) if score == "kfold" else ())


@pytest.mark.slow_cases("kfold", "press", "rss")
@pytest.mark.parametrize("score", SCORES)
def test_workers_and_pieces_do_not_matter(score: str, monkeypatch: pytest.MonkeyPatch) -> None:
    system = polynomial(np.random.default_rng(8), k=11, m=16)
    folds = folds_of(16) if score == "kfold" else ()
    whole = last(system, score, folds=folds, max_terms=9)
    for name in ("_NODE_SUBSETS", "_BOUNDED_SUBSETS"):
        monkeypatch.setattr(subsets, name, 20)
    one, two = (list(search(system, score, folds=folds, max_terms=9, workers=w)) for w in (1, 2))
    assert len(one) == len(two) > 50
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a.best, b.best)
        np.testing.assert_array_equal(a.masks, b.masks)
        assert (a.subsets, a.pruned) == (b.subsets, b.pruned)
    np.testing.assert_allclose(one[-1].best, whole.best, rtol=1e-12)
    np.testing.assert_array_equal(one[-1].masks, whole.masks)
    assert whole.complete
    assert whole.total == one[-1].subsets == count_subsets(11, 9)


@pytest.mark.slow
def test_the_bound_never_exceeds_what_it_bounds() -> None:
    """All columns in use or to come leave the least residuals of any selection of them."""
    rng = np.random.default_rng(9)
    k = 8
    system = polynomial(rng, k=k, m=12)
    ready = score_systems(system, "rss", (), None)
    exact = last(system, "rss").best
    all_masks = np.array(list(masks_of(system, None)))
    residuals = np.array([score_of(system, "rss", columns, ()) for columns in all_masks])
    for _ in range(100):
        order = rng.permutation(k)
        used, rest = np.split(order[:rng.integers(3, k + 1)], [rng.integers(0, 4)])
        everything = np.isin(np.arange(k), [*used, *rest])
        inside = all_masks[:, used].all(axis=1) & ~(all_masks & ~everything).any(axis=1)
        bound = score_of(system, "rss", everything, ())
        assert bound <= residuals[inside].min() * (1 + 1e-12)
        # What is trimmed off holds nothing as good as the best.
        piece = ready.bounded(SubtreeNode(used, rest, len(rest)), exact)
        assert piece.lower_bound == pytest.approx(bound, rel=1e-5)
        largest = len(used) + ready.trimmed(piece, exact).room
        sizes = all_masks[inside].sum(axis=1)
        beyond = sizes > largest
        assert (residuals[inside][beyond] > exact[sizes[beyond]]).all()


@pytest.mark.parametrize("max_terms", [None, 6])
def test_the_bound_spares_work_and_changes_nothing(max_terms: int | None) -> None:
    rng = np.random.default_rng(10)
    system = polynomial(rng, k=18, m=30)
    system = replace(system, target=system.design[:, 3:7].sum(axis=1, keepdims=True)
                     + 0.3 * system.target)
    bounded = last(system, "rss", max_terms=max_terms)
    # Two equal right-hand sides: twice the same sums, without a bound if they are check points'.
    twice = np.repeat(system.target, 2, axis=1)
    plain = last(replace(system, target=twice, check_design=system.design, check_target=twice),
                 "check", max_terms=max_terms)
    np.testing.assert_allclose(bounded.best, plain.best / 2, rtol=1e-9)
    np.testing.assert_array_equal(bounded.masks, plain.masks)
    assert bounded.complete
    assert bounded.pruned > 0.9 * bounded.total
    assert plain.pruned == 0


def test_interrupted_search_leaves_the_best_so_far(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subsets, "_BOUNDED_SUBSETS", 64)
    system = polynomial(np.random.default_rng(11), k=12, m=14)
    running = search(system, "check", workers=2)
    states = [next(running) for _ in range(3)]
    with pytest.raises(KeyboardInterrupt):
        running.throw(KeyboardInterrupt)
    assert not states[-1].complete
    assert 0 < states[-1].subsets < states[-1].total == 2**12
    found = np.isfinite(states[-1].best)
    assert found.any()
    for size in np.flatnonzero(found):
        np.testing.assert_allclose(
            score_of(system, "check", states[-1].columns(size), ()), states[-1].best[size])


@pytest.mark.usefixtures("clock")
def test_counts_and_estimate() -> None:
    assert count_subsets(21) == 2**21
    assert count_subsets(5, 2) == 1 + 5 + 10
    assert count_subsets(3, 7) == 8
    system = polynomial(np.random.default_rng(12), k=14, m=20)
    # Either piece, of all 2^14 subsets, takes a millisecond by this clock.
    assert estimate_seconds(system, "check", workers=2) == pytest.approx(0.001 / 2)
    large = polynomial(np.random.default_rng(12), k=18, m=20)
    assert estimate_seconds(large, "check") == pytest.approx(0.001 * 2**18 / 2**16)


def test_what_the_user_can_correct() -> None:
    system = polynomial(np.random.default_rng(13))
    one = np.arange(6) == 1
    with pytest.raises(TermselError, match="unknown score 'rmse'"):
        last(system, "rmse")
    with pytest.raises(TermselError, match="both forced and forbidden"):
        last(replace(system, forced=one, forbidden=one), "check")
    with pytest.raises(TermselError, match="1 terms are forced, but at most 0 may be in use"):
        last(replace(system, forced=one), "check", max_terms=0)
    with pytest.raises(TermselError, match="subsets of 63 terms"):
        SubsetSystem(np.ones((3, 63)), np.ones((3, 1)))


def test_what_a_developer_can_correct() -> None:
    system = polynomial(np.random.default_rng(14))
    with pytest.raises(ValueError, match="check_target has shape"):
        replace(system, check_target=np.ones((2, 1)))
    with pytest.raises(ValueError, match="design is not finite"):
        replace(system, design=np.full((9, 6), np.nan))
    with pytest.raises(ValueError, match="single right-hand side"):
        replace(system, target=np.ones((9, 2)), check_target=np.ones((7, 2)),
                denominator=np.ones((9, 6)))
    with pytest.raises(ValueError, match="requires check_design"):
        last(SubsetSystem(system.design, system.target), "check")
    with pytest.raises(ValueError, match="score 'kfold' requires folds"):
        last(system, "kfold")


def decided_without_bounds(system: SubsetSystem, score: str, max_terms: int | None,
                           monkeypatch: pytest.MonkeyPatch,
                           folds: Sequence[np.ndarray]) -> SubsetResult:
    """Look at every subset, as for scores that have no bound."""
    with monkeypatch.context() as patch:
        patch.setattr(ScoreSystems, "branches", False)
        patch.setattr(ScoreSystems, "holds_out", False)
        return last(system, score, max_terms=max_terms, folds=folds)


def random_system(rng: np.random.Generator, rational: bool) -> SubsetSystem:
    """Return 9 to 12 columns, some nearly dependent, whose fit leaves little or much."""
    k, m, c = rng.integers((9, 6, 5), (13, 16, 14))
    rows = rng.normal(size=(m + c, k)) * 10.0 ** rng.uniform(-2, 1, size=k)
    rows[:, -1] = rows[:, 0] + 10.0 ** rng.uniform(-6, 0) * rows[:, -1]
    target = rows[:, :3].sum(axis=1, keepdims=True) + 10.0 ** rng.uniform(-4, 0) * rng.normal(
        size=(m + c, 1))
    linear = SubsetSystem(rows[:m], target[:m], rows[m:], target[m:])
    if not rational:
        return linear
    below = np.where(np.arange(k) < k // 2, 0.0, rng.normal(size=(m + c, k)))
    design = np.where(np.arange(k) < k // 2, rows, -target * below)
    return replace(linear, design=design[:m], check_design=design[m:], denominator=below[:m],
                   check_denominator=below[m:], margin=float(rng.uniform(0.05, 0.9)),
                   guard_denominator=below[:3] if rng.random() < 0.3 else None)


def left_out(system: SubsetSystem, rng: np.random.Generator, dependent: bool) -> SubsetSystem:
    """Return a system for held-out errors, of one or two targets, with all rows as control.

    With nearly dependent columns rounding decides whether as many columns as rows are dependent.
    """
    assert system.check_design is not None
    assert system.check_target is not None
    design = np.concatenate([system.design, system.check_design])
    target = np.concatenate([system.target, system.check_target])
    if not dependent:
        design[:, -1] = rng.normal(size=len(design))
    if rng.random() < 0.3:
        target = np.column_stack([target, design[:, 1:4] @ rng.normal(size=3)])
        target[:, 1] += 10.0 ** rng.uniform(-4, 0) * rng.normal(size=len(target))
    return SubsetSystem(design, target)


@pytest.mark.slow_cases(
    "check-4000", "kfold-150", "kfold-4000", "press-150", "press-4000", "rational-4000", "rss-150",
    "rss-4000")
@pytest.mark.parametrize(("kind", "problems"), [
    (kind, n) for kind in ("check", "rational", "rss", "press", "kfold") for n in (150, 4000)])
def test_bounds_lose_no_best_subset(kind: str, problems: int,
                                    monkeypatch: pytest.MonkeyPatch) -> None:
    """Scores, masks and poles of random problems, some with caps or programs, against every one."""
    pruned = 0
    for seed in range(problems):
        rng = np.random.default_rng([seed, problems])
        system = random_system(rng, kind == "rational")
        score = kind if kind in ("rss", "press", "kfold") else "check"
        folds: list[np.ndarray] = []
        if kind in ("press", "kfold"):
            system = left_out(system, rng, kind == "press")
            folds = [fold for _ in range(rng.integers(1, 3)) for fold in np.array_split(
                rng.permutation(len(system.design)), rng.integers(2, 6))] * (kind == "kfold")
        most = None if rng.random() < 0.5 else int(rng.integers(1, 8))
        monkeypatch.setattr("termsel.selection.best_subsets.score_systems.PROGRAMMED",
                            1 << 62 if seed % 8 else 0)
        plain = decided_without_bounds(system, score, most, monkeypatch, folds)
        bounded = last(system, score, max_terms=most, folds=folds)
        # A score of rounding error alone is anyone's; held-out errors of nearly dependent columns
        # lose digits. Of more columns than rows rounding decides which are dependent.
        rows = len(system.design) + 1
        np.testing.assert_allclose(bounded.best[:rows], plain.best[:rows], atol=1e-11,
                                   rtol={"press": 1e-4, "kfold": 1e-4, "rss": 1e-5}.get(kind, 1e-6),
                                   err_msg=seed)
        assert bounded.complete
        pruned += bounded.pruned
    assert pruned > 100 * problems  # the bounds had something to lose


def test_a_bound_holds_for_every_piece_and_rises() -> None:
    rng = np.random.default_rng(12)
    found = wide = 0
    for _ in range(40):
        system = random_system(rng, True)
        ready = score_systems(system, "check", (), None)
        best = last(system, "check").best
        if not 0 < best.min() < np.inf:
            continue
        order = rng.permutation(system.design.shape[1])
        used, rest = order[:rng.integers(1, 4)], order[4:]
        piece = ready.bounded(SubtreeNode(used, rest, len(rest)), best)
        half = ready.bounded(piece.halves()[0], best)
        k = len(order)
        inside = ready.walk(piece, np.full(k + 1, np.inf), np.zeros(k + 1, dtype=np.uint64))
        assert piece.lower_bound <= inside.best.min() * (1 + 1e-9)
        assert piece.lower_bound <= half.lower_bound <= best.min()
        found += piece.lower_bound > 0
        wide += piece.lower_bound > 0 and len(rest) > len(system.design) - len(used)
    assert found > 10
    assert wide > 2  # denominators are bounded where columns are more than rows
