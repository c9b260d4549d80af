"""The bound of the enumeration, against subsets whose score is known."""

from __future__ import annotations

import numpy as np

from termsel.adjustment.subset_bounds import first_closed
from termsel.adjustment.subset_stack import stack
from termsel.adjustment.subset_system import Piece, SubsetSystem


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
        systems = stack(SubsetSystem(A, b[:, None], C, f[:, None], d, dc), "check", (), None)
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
            levels, limits, _ = systems._prepared(Piece(used, rest, len(rest)))
            first = int(np.flatnonzero(np.isin(rest, chosen))[0])
            upper = np.append(np.ones(c), 1 / (limits.margin * c))
            end = first_closed(levels.top[0, 0], levels.extra[0, 0], first, len(rest),
                               score * (1 + 1e-9), upper, True, systems._space(levels))
            assert end > first
            assert (np.append(below, 1) / below.sum() <= upper * (1 + 1e-9)).all()
            closed += end < len(rest)
            lowered += upper[:c].min() < 0.9
    assert closed > 50
    assert lowered > 200
