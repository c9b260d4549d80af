"""Distributions of termsel's own against those of scipy.special."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import chdtri, fdtrc, stdtr, stdtrit

from termsel.data.record.chances import (
    chance_of_better_fit,
    chi_squared_quantile,
    median_of,
    quantile_of,
    t_beyond,
    t_quantile,
)

FREEDOM = [1, 2, 3.5, 48.4, 999, 1000, 1001, 34319, 65328, 195718, 3e6]
"""Secants to the quantile of some of the last ones once met no end."""


@pytest.mark.parametrize("freedom", FREEDOM)
def test_quantiles_are_those_of_scipy(freedom: float) -> None:
    for share in (0.01, 0.05, 0.5, 0.95, 0.999):
        assert chi_squared_quantile(share, freedom) == pytest.approx(chdtri(freedom, 1 - share),
                                                                     rel=1e-8)
    for share in (0.6, 0.95, 0.975, 0.999):
        assert t_quantile(share, freedom) == pytest.approx(stdtrit(freedom, share), rel=1e-8)


@pytest.mark.parametrize("count", [1, 2, 3, 10, 101])
def test_quantiles_of_values_are_those_of_numpy(count: int) -> None:
    values = np.random.default_rng(count).normal(size=(4, 3, count))
    values[0, 0, count // 2] = np.nan
    for share in (0.0, 0.25, 0.7, 0.75, 0.9, 1.0):
        np.testing.assert_array_equal(quantile_of(values, share),
                                      np.quantile(values, share, axis=-1))
    np.testing.assert_array_equal(median_of(values), np.median(values, axis=-1))


@pytest.mark.parametrize("freedom", FREEDOM)
def test_chances_of_t_are_those_of_scipy(freedom: float) -> None:
    for t in (0.0, 1e-9, 0.3, 1.0, 1.7, 2.0, 3.0, 9.0, 30.0, 1e8, np.inf):
        assert t_beyond(t, freedom) == pytest.approx(2 * stdtr(freedom, -t), rel=1e-8, abs=1e-300)


def test_quantiles_of_all_small_freedoms_are_those_of_scipy() -> None:
    freedom = np.arange(1, 1001)
    mine = [[t_quantile(0.95, n), t_quantile(0.975, n), chi_squared_quantile(0.05, n),
             chi_squared_quantile(0.95, n)] for n in freedom.tolist()]
    np.testing.assert_allclose(mine, np.transpose([
        stdtrit(freedom, 0.95), stdtrit(freedom, 0.975), chdtri(freedom, 0.95),
        chdtri(freedom, 0.05)]), rtol=1e-8)


@pytest.mark.parametrize("freedom", [0.3, 1, 2, 2.67, 40])
@pytest.mark.parametrize("unknowns", [0.1, 1, 3.97, 12])
def test_chances_of_needless_unknowns_are_those_of_f(freedom: float, unknowns: float) -> None:
    for share in (1e-9, 0.01, 0.3, 0.7, 0.999, 1.0):
        f = (1 - share) / unknowns * freedom / share
        assert chance_of_better_fit(share, freedom, unknowns) == pytest.approx(
            fdtrc(unknowns, freedom, f), rel=1e-8)
    assert chance_of_better_fit(1.1, freedom, unknowns) == 1.0
    assert chance_of_better_fit(0.0, freedom, unknowns) == 0.0
