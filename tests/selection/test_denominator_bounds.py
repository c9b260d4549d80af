"""Largest denominators that linear programs give."""

import numpy as np
import pytest

from termsel.selection.best_subsets.bounds.shares import largest_denominator_shares


def test_the_largest_denominators_of_one_term_by_hand() -> None:
    """1 + b x at x = -1, 1 is at least 0.1 for |b| <= 0.9, and at x = 2 for b >= -0.45, too."""
    at, further = np.array([[-1.0], [1.0]]), np.array([[2.0]])
    assert largest_denominator_shares(
        at, further[:0], 0.1) == pytest.approx([0.95, 0.95, 0.5], rel=2e-4)
    assert largest_denominator_shares(
        at, further, 0.1) == pytest.approx([0.725, 0.95, 0.5], rel=2e-4)


def test_no_coefficients_without_poles_exceed_the_largest_shares() -> None:
    rng = np.random.default_rng(8)
    near = 0
    for _ in range(20):
        k, c, g = rng.integers((1, 2, 0), (5, 9, 9))
        rows, margin = rng.normal(size=(c + g, k)), float(rng.uniform(0.05, 0.5))
        rows[:, rng.random(k) < 0.2] = 0.0  # terms that are not of the denominator
        largest = largest_denominator_shares(rows[:c], rows[c:], margin)
        b = rng.normal(size=(400, k))
        slope = -(rows @ b.T).min(axis=0)  # scaled by it, the least denominator is the margin
        b *= np.where(slope > 0, (1.0 - margin) / np.maximum(slope, 1e-9), 1.0)[:, None]
        below = 1.0 + rows @ b.T
        assert below.min() > margin - 1e-9
        shares = np.vstack([below[:c], np.ones(len(b))]) / below[:c].sum(axis=0)
        assert (shares <= largest[:, None]).all()
        near += (shares.max(axis=1) > 0.95 * largest).all()
    assert near > 3


def test_the_largest_shares_are_the_same_in_any_unit_of_the_coefficients() -> None:
    """Over flat ground the cubes of heights are tiny, and what may be large is their coefficients.
    """
    rng = np.random.default_rng(3)
    rows, units = rng.normal(size=(16, 5)), 10.0 ** np.array([0.0, -9.0, 3.0, -6.0, -12.0])
    largest, same = (
        largest_denominator_shares(one[:10], one[10:], 0.1) for one in (rows, rows * units))
    assert same == pytest.approx(largest, rel=1e-5)
