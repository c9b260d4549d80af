"""The kernels agree with LAPACK on every kind of mask and system."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from termsel.adjustment import Equations, solve
from termsel.adjustment.blocks import reduced_rows, where_blocks_pay
from termsel.adjustment.kernels import BLOCK, _kept_data_of, needs_compilation, solve_many
from termsel.data.features import FeatureSet, Points
from termsel.models.quotient import RationalFunctions

SYSTEMS = st.tuples(
    st.integers(0, 2**32 - 1),  # seed
    st.integers(1, 60),  # features
    st.integers(1, 2),  # rows a feature
    st.integers(1, 45))  # terms
few = settings(max_examples=60, deadline=None)


def system(rng, n_features, per_feature, k, condition=10.0):
    """Return equations with singular values down to 1 / condition."""
    m = n_features * per_feature
    left = np.linalg.qr(rng.normal(size=(m, min(m, k))))[0]
    right = np.linalg.qr(rng.normal(size=(k, min(m, k))))[0]
    A = left * np.geomspace(1.0, 1.0 / condition, min(m, k)) @ right.T
    return Equations(A, rng.normal(size=m), np.repeat(np.arange(n_features), per_feature))


def masks(rng, p, n):
    """Return masks of every density, with none, one and all of n switched on among them."""
    mask = rng.random((p, n)) < rng.random((p, 1))
    mask[0], mask[1] = False, True
    mask[2] = np.arange(n) == rng.integers(n)
    return mask


def agrees(equations, terms, features, clear=1e7):
    """Compare with LAPACK wherever the system is determined beyond doubt."""
    coefficients, violation = solve_many(equations, terms, features)
    assert np.isfinite(coefficients).all()
    compared = 0
    for i, x in enumerate(coefficients):
        on = np.ones(equations.A.shape[1], bool) if terms is None else terms[i]
        rows = (np.ones(len(equations.b), bool) if features is None
                else features[i][equations.feature])
        reference = solve(equations, on, None if features is None else features[i])
        if violation[i]:
            assert not x.any()
        assert violation[i] >= on.sum() - min(on.sum(), rows.sum())
        if not on.any():
            assert violation[i] == 0
        if reference.feasible and reference.condition < clear:
            A, b = equations.A[rows], equations.b[rows]
            assert violation[i] == 0
            assert not x[~on].any()
            fitted = A @ x
            scale = max(np.linalg.norm(b), 1e-300)
            assert np.linalg.norm(fitted - A @ reference.coefficients) <= 1e-8 * scale
            by_numpy = np.linalg.lstsq(A[:, on], b, rcond=None)[0] if on.any() else np.zeros(0)
            assert np.linalg.norm(fitted - A[:, on] @ by_numpy) <= 1e-8 * scale
            compared += 1
    return compared


@few
@given(SYSTEMS, st.sampled_from([1.0, 1e3, 1e6]), st.sampled_from(["terms", "features", "both"]))
def test_agrees_with_lapack(shape, condition, kind):
    seed, n_features, per_feature, k = shape
    rng = np.random.default_rng(seed)
    equations = system(rng, n_features, per_feature, k, condition)
    agrees(equations, masks(rng, 8, k) if kind != "features" else None,
           masks(rng, 8, n_features) if kind != "terms" else None)


@few
@given(SYSTEMS, st.booleans())
def test_pseudo_observations_are_always_in(shape, all_features):
    seed, n_features, per_feature, k = shape
    rng = np.random.default_rng(seed)
    plain = system(rng, n_features, per_feature, k)
    prior = rng.uniform(0.1, 1.0, k) * (rng.random(k) < 0.7)
    equations = Equations(plain.A, plain.b, plain.feature, prior)
    terms, features = masks(rng, 8, k), None if all_features else masks(rng, 8, n_features)
    coefficients, violation = solve_many(equations, terms, features)
    for i, on in enumerate(terms):
        rows = features[i][plain.feature] if features is not None else np.ones(len(plain.b), bool)
        A = np.concatenate([plain.A[rows], np.diag(prior)])[:, on]
        if violation[i] or (on.any() and np.linalg.cond(A) > 1e7):
            continue
        x = np.linalg.lstsq(A, np.concatenate([plain.b[rows], np.zeros(k)]), rcond=None)[0]
        np.testing.assert_allclose(coefficients[i, on], x, atol=1e-7)
        one = solve(equations, on, None if features is None else features[i])
        np.testing.assert_allclose(one.coefficients[on], x, atol=1e-7)
        assert one.n_equations == rows.sum()


@few
@given(SYSTEMS, st.integers(0, 12), st.sampled_from(["terms", "features", "both"]))
def test_counts_the_dependent_terms(shape, rank, kind):
    seed, n_features, per_feature, k = shape
    rng = np.random.default_rng(seed)
    equations = system(rng, n_features, per_feature, k)
    # Some columns repeat, scale, add up or vanish; the others are independent.
    A = equations.A.copy()
    for j in range(min(rank, k), k):
        choice = rng.integers(4)
        if choice == 0:
            A[:, j] = 0.0
        elif choice == 1:
            A[:, j] = A[:, rng.integers(k)] * 1e3
        elif choice == 2:
            A[:, j] = A[:, :max(rank, 1)] @ rng.normal(size=min(max(rank, 1), k))
    equations = Equations(A, equations.b, equations.feature)
    terms = masks(rng, 8, k) if kind != "features" else None
    features = masks(rng, 8, n_features) if kind != "terms" else None
    coefficients, violation = solve_many(equations, terms, features)
    for i in range(8):
        on = np.ones(k, bool) if terms is None else terms[i]
        rows = np.ones(n_features, bool) if features is None else features[i]
        some = A[np.ix_(np.repeat(rows, per_feature), on)]
        values = np.linalg.svd(some / np.maximum(np.linalg.norm(some, axis=0), 1e-300),
                               compute_uv=False)
        if ((values > 1e-13) & (values < 1e-5)).any():
            continue  # near the tolerance, where the order of the columns may decide
        assert violation[i] == on.sum() - (values > 1e-9).sum()
        assert (violation[i] == 0) or not coefficients[i].any()


@pytest.mark.parametrize("m", [39 + BLOCK, 40 + BLOCK, 39 + 2 * BLOCK, 1200])
def test_many_rows_are_folded_in(m):
    rng = np.random.default_rng(m)
    equations = system(rng, m, 1, 39, condition=1e6)
    assert agrees(equations, masks(rng, 6, 39), None) >= 3
    assert agrees(equations, None, masks(rng, 6, m)) >= 1
    assert agrees(equations, masks(rng, 6, 39), masks(rng, 6, m)) >= 1


def test_dependent_only_in_the_first_rows_of_many():
    rng = np.random.default_rng(1)
    m = 3 * BLOCK
    A = rng.normal(size=(m, 10))
    A[:2 * BLOCK, 3] = A[:2 * BLOCK, 1]
    A[:2 * BLOCK, 7] = 0.0
    equations = Equations(A, rng.normal(size=m), np.arange(m))
    assert agrees(equations, None, np.ones((1, m), bool)) == 1
    first = (np.arange(m) < 2 * BLOCK)[None]
    assert solve_many(equations, None, first)[1] == [2]


def scene(n, seed=0):
    """Return points of a mildly nonlinear image of rough ground, scaled."""
    rng = np.random.default_rng(seed)
    ground = rng.uniform(-1, 1, size=(n, 3))
    x, y, z = ground.T
    image = np.stack([0.9 * x - 0.2 * y + 0.1 * z + 0.02 * x * y - 0.01 * y**3,
                      0.2 * x + 0.9 * y - 0.05 * z + 0.02 * x * x], axis=1)
    image = image / (1 + 0.02 * x - 0.01 * z)[:, None] + rng.normal(scale=1e-4, size=(n, 2))
    return FeatureSet(Points(tuple(map(str, range(n))), image, ground))


def test_rational_functions_of_real_size():
    model = RationalFunctions(order=3)
    whole = model.equations(scene(60))
    axis = whole.take(np.arange(120) % 2 == 0, model.axis == 0)
    assert axis.A.shape == (60, 39)
    rng = np.random.default_rng(2)
    assert agrees(axis, rng.random((20, 39)) < 0.5, None, clear=1e8) == 20
    assert agrees(axis, None, rng.random((20, 60)) < 0.85, clear=1e8) == 20
    assert agrees(whole, rng.random((10, 78)) < 0.5, None, clear=1e8) == 10


def test_nothing_but_the_mask_decides():
    rng = np.random.default_rng(3)
    equations = system(rng, 50, 2, 39, condition=1e5)
    terms, features = masks(rng, 40, 39), masks(rng, 40, 50)
    for some in ((terms, None), (None, features), (terms, features)):
        x, violation = solve_many(equations, *some)
        order = rng.permutation(np.repeat(np.arange(40), 2))
        mixed = solve_many(equations, *(None if mask is None else mask[order] for mask in some))
        np.testing.assert_array_equal(mixed[0], x[order])
        np.testing.assert_array_equal(mixed[1], violation[order])


def test_any_memory_layout_is_taken():
    rng = np.random.default_rng(4)
    equations = system(rng, 30, 2, 12)
    terms, features = masks(rng, 9, 12), masks(rng, 9, 30)
    expected = solve_many(equations, terms, features)
    wide = np.zeros((120, 24))
    wide[::2, ::2] = equations.A
    strided = Equations(wide[::2, ::2], np.repeat(equations.b, 2)[::2],
                        np.repeat(equations.feature, 2)[::2])
    columnwise = Equations(np.asfortranarray(equations.A), equations.b,
                           equations.feature.astype(np.int32))
    terms.setflags(write=False)
    for one in (strided, columnwise):
        for some in ((terms, features), (np.asfortranarray(terms), np.asfortranarray(features)),
                     (terms.astype(np.int8), features[:, ::-1][:, ::-1])):
            for ours, theirs in zip(solve_many(one, *some), expected, strict=True):
                np.testing.assert_array_equal(ours, theirs)


def test_empty_cases():
    rng = np.random.default_rng(5)
    equations = system(rng, 5, 1, 3)
    x, violation = solve_many(equations, np.zeros((0, 3), bool), None)
    assert x.shape == (0, 3)
    assert violation.shape == (0,)
    x, violation = solve_many(equations, None, None)
    np.testing.assert_allclose(x[0], solve(equations).coefficients)
    nothing = Equations(np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.intp))
    for terms, features in ((None, None), (np.ones((2, 3), bool), np.zeros((2, 0), bool))):
        x, violation = solve_many(nothing, terms, features)
        assert not x.any()
        assert (violation == 3).all()


def test_masks_that_do_not_fit_are_refused():
    equations = system(np.random.default_rng(6), 5, 1, 3)
    for terms, features in ((np.ones((2, 4), bool), None), (None, np.ones((2, 4), bool)),
                            (np.ones((2, 3), bool), np.ones((3, 5), bool))):
        with pytest.raises(ValueError, match="do not fit"):
            solve_many(equations, terms, features)


def test_compilation_is_announced_and_not_part_of_the_import():
    solve_many(system(np.random.default_rng(7), 5, 1, 3), None, None)
    assert not needs_compilation()
    code = "import sys, termsel.adjustment; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize("prior", [False, True])
def test_many_rows_are_solved_as_lapack_does(prior: bool) -> None:
    """Their normal equations are used where that is safe, and only there."""
    rng = np.random.default_rng(4)
    k, n = 7, 200
    A = rng.normal(size=(2 * n, k))
    A[:, 3] = A[:, 2] + 1e-4 * A[:, 3]  # correlated as columns of a rational model are
    A[::7, 5] = 0.0
    A[60:, 6] *= 1e-6  # so that few features determine the last term
    A *= 10.0 ** rng.integers(-4, 5, k)
    equations = Equations(A, A @ rng.normal(size=k) + rng.normal(size=2 * n),
                          np.repeat(np.arange(n), 2), np.full(k, 1e-9) if prior else None)
    features = rng.random((40, n)) < rng.random((40, 1))
    features[0] = True
    features[1] = np.arange(n) < 3  # too few
    features[2] = np.arange(n) >= 30  # of no use for the last term
    features[3] = np.arange(n) < 5
    found, violation = solve_many(equations, None, features)
    assert _kept_data_of(equations).blocks is not None
    unsafe = 0
    for mask, x, lacking in zip(features, found, violation, strict=True):
        one = solve(equations, None, mask)
        assert (lacking == 0) == one.feasible
        if one.feasible:
            rows = mask[equations.feature]
            b = equations.b[rows]
            gap = np.linalg.norm(A[rows] @ (x - one.coefficients))
            assert gap <= 1e-10 * np.linalg.norm(b)
        system = next(reduced_rows(_kept_data_of(equations).blocks,
                                   _kept_data_of(equations).triangle[:, :k],
                                   mask[None], np.array([True])))[1]
        unsafe += system is None
    assert 1 <= unsafe <= 20
    # With terms of their own, too, where that is faster: of many terms, and for many features.
    terms = rng.random((40, k)) < np.linspace(0.2, 1.0, 40)[:, None]
    terms[5], features[5] = True, np.arange(n) % 6 == 0
    found, violation = solve_many(equations, None, features)
    those = where_blocks_pay(_kept_data_of(equations).feature, terms, features)
    assert 5 <= those.sum() <= 35
    own = solve_many(equations, terms, features)
    for on, mask, x, lacking in zip(terms, features, *own, strict=True):
        one = solve(equations, on, mask)
        assert (lacking == 0) == one.feasible
        if one.feasible:
            rows = mask[equations.feature]
            gap = np.linalg.norm(A[rows] @ (x - one.coefficients))
            assert gap <= 1e-10 * np.linalg.norm(equations.b[rows])
    # The other individuals change nothing.
    alone = np.concatenate([solve_many(equations, None, features[i:i + 1])[0]
                            for i in range(len(features))])
    np.testing.assert_array_equal(alone, found)
    np.testing.assert_array_equal(own[0], np.concatenate([
        solve_many(equations, terms[i:i + 1], features[i:i + 1])[0] for i in range(40)]))
