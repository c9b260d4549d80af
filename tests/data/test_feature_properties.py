"""Properties of measured features, of their scaling and of their roles."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from termsel.core.errors import TermselError
from termsel.data.coordinates.places import spatial_order
from termsel.data.features import ROLES, FeatureSet, FloatArray, Lines, Points
from termsel.data.roles import ASSIGNABLE, SPLITS, assign_roles
from termsel.data.scaling import make_scaling

# The same examples every time: a failure in a test of figures must not depend on luck.
settings.register_profile("core", deadline=None, derandomize=True, max_examples=40)
settings.load_profile("core")

seeds = st.integers(0, 2**32 - 1)
pixels = st.floats(-1e6, 1e6)
metres = st.floats(-1e7, 1e7)


# Measured features


def make_points(n: int, rng: np.random.Generator, **changed: Any) -> Points:
    values: dict[str, Any] = {
        "ids": [f"p{i}" for i in range(n)], "image": rng.uniform(0, 1e4, (n, 2)),
        "ground": rng.uniform(0, 1e5, (n, 3)), "sigma": rng.uniform(0.1, 2, (n, 2)),
        "roles": rng.choice([*ROLES, ""], n).tolist()}
    return Points(**(values | changed))


def make_lines(n: int, rng: np.random.Generator, **changed: Any) -> Lines:
    values: dict[str, Any] = {
        "ids": [f"l{i}" for i in range(n)], "image": rng.uniform(0, 1e4, (n, 2, 2)),
        "ground": rng.uniform(0, 1e5, (n, 2, 3))}
    return Lines(**(values | changed))


def with_value(array: FloatArray, place: tuple[int, ...], value: float) -> FloatArray:
    changed = array.copy()
    changed[place] = value
    return changed


@given(st.integers(1, 12), seeds)
def test_sound_features_are_kept_and_cannot_be_changed(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    image = rng.uniform(0, 1e4, (n, 2))
    points, lines = make_points(n, rng, image=image), make_lines(n, rng)
    np.testing.assert_array_equal(points.image, image)
    image[0] = -1.0
    assert not (points.image == -1.0).any()
    for array in (points.image, points.ground, points.sigma, lines.image, lines.ground):
        assert array is not None
        assert not array.flags.writeable
    mask = rng.random(n) < 0.5
    taken, some = points.take(mask), lines.take(np.flatnonzero(mask))
    assert taken.ids == tuple(np.array(points.ids)[mask])
    assert some.ids == tuple(np.array(lines.ids)[mask])
    np.testing.assert_array_equal(taken.ground, points.ground[mask])
    np.testing.assert_array_equal(some.ground, lines.ground[mask])
    both = FeatureSet(points, lines)
    assert both.ids == points.ids + lines.ids
    assert both.ground_vertices().shape == (3 * n, 3)
    assert both.image_vertices().shape == (3 * n, 2)


@given(st.integers(1, 12), seeds, st.sampled_from([np.nan, np.inf, -np.inf]), st.data())
def test_points_that_are_not_finite(n: int, seed: int, bad: float, data: st.DataObject) -> None:
    rng = np.random.default_rng(seed)
    row = data.draw(st.integers(0, n - 1))
    what = data.draw(st.sampled_from(["image", "ground", "sigma"]))
    column = data.draw(st.integers(0, 1))
    array = with_value(getattr(make_points(n, rng), what), (row, column), bad)
    with pytest.raises(TermselError, match=f"point 'p{row}' has") as caught:
        make_points(n, rng, **{what: array})
    assert caught.value.ids == (f"p{row}",)


@given(st.integers(1, 12), seeds, st.sampled_from([np.nan, np.inf, -np.inf]), st.data())
def test_lines_that_are_not_finite(n: int, seed: int, bad: float, data: st.DataObject) -> None:
    rng = np.random.default_rng(seed)
    row = data.draw(st.integers(0, n - 1))
    what = data.draw(st.sampled_from(["image", "ground"]))
    place = (row, data.draw(st.integers(0, 1)), data.draw(st.integers(0, 1)))
    array = with_value(getattr(make_lines(n, rng), what), place, bad)
    with pytest.raises(TermselError, match=f"line 'l{row}' has") as caught:
        make_lines(n, rng, **{what: array})
    assert caught.value.ids == (f"l{row}",)


@given(st.integers(1, 12), seeds, st.data())
def test_heights_may_be_unknown_but_not_infinite(n: int, seed: int, data: st.DataObject) -> None:
    rng = np.random.default_rng(seed)
    row, end = data.draw(st.integers(0, n - 1)), data.draw(st.integers(0, 1))
    ground, vertices = rng.uniform(0, 9, (n, 3)), rng.uniform(0, 9, (n, 2, 3))
    unknown = FeatureSet(
        make_points(n, rng, ground=with_value(ground, (row, 2), np.nan)),
        make_lines(n, rng, ground=with_value(vertices, (row, end, 2), np.nan)))
    assert unknown.without_height() == (f"p{row}", f"l{row}")
    with pytest.raises(TermselError, match=f"point 'p{row}' has an infinite height"):
        make_points(n, rng, ground=with_value(ground, (row, 2), np.inf))
    with pytest.raises(TermselError, match=f"line 'l{row}' has an infinite height"):
        make_lines(n, rng, ground=with_value(vertices, (row, end, 2), -np.inf))


@given(st.integers(2, 12), seeds, st.data())
def test_what_occurs_twice(n: int, seed: int, data: st.DataObject) -> None:
    rng = np.random.default_rng(seed)
    first, second = sorted(data.draw(st.permutations(range(n)))[:2])
    points, lines = make_points(n, rng), make_lines(n, rng)
    ids = list(points.ids)
    ids[second] = ids[first]
    with pytest.raises(TermselError, match=f"id 'p{first}' is used 2 times"):
        make_points(n, rng, ids=ids)
    assert make_lines(n, rng, ids=ids).features == tuple(dict.fromkeys(ids))
    ground = points.ground.copy()
    ground[second] = ground[first]
    with pytest.raises(TermselError, match=f"'p{first}' and 'p{second}' have the same ground"):
        make_points(n, rng, ground=ground, roles=[""] * n)
    vertices = lines.ground.copy()
    vertices[second] = vertices[first][::data.draw(st.sampled_from([1, -1]))]
    with pytest.raises(TermselError, match=f"'l{first}' and 'l{second}' have the same ground"):
        make_lines(n, rng, ground=vertices)
    with pytest.raises(TermselError, match=f"'p{first}' is the id of a point and of a line"):
        FeatureSet(points, make_lines(1, rng, ids=[f"p{first}"]))


@given(st.integers(1, 12), seeds, st.data())
def test_lines_of_zero_length(n: int, seed: int, data: st.DataObject) -> None:
    rng = np.random.default_rng(seed)
    row = data.draw(st.integers(0, n - 1))
    what = data.draw(st.sampled_from(["image", "ground"]))
    array = getattr(make_lines(n, rng), what).copy()
    array[row, 1, :2] = array[row, 0, :2]
    with pytest.raises(TermselError, match=f"line 'l{row}' has zero length"):
        make_lines(n, rng, **{what: array})


@given(st.integers(1, 12), seeds, st.text("abcefhkln O,", min_size=1), st.data())
def test_unknown_roles(n: int, seed: int, role: str, data: st.DataObject) -> None:
    assume(role not in ROLES)
    rng = np.random.default_rng(seed)
    roles = list(make_points(n, rng).roles)
    roles[data.draw(st.integers(0, n - 1))] = role
    with pytest.raises(TermselError, match="has the unknown role"):
        make_points(n, rng, roles=roles)


@given(st.integers(1, 12), st.integers(0, 12), seeds)
def test_shapes_that_do_not_fit(n: int, other: int, seed: int) -> None:
    assume(other != n)
    rng = np.random.default_rng(seed)
    for what in ("image", "ground", "sigma"):
        with pytest.raises(TermselError, match=rf"^{what} of points has shape \({other}, [23]\)"):
            make_points(n, rng, **{what: np.zeros((other, 3 if what == "ground" else 2))})
    if other:
        with pytest.raises(TermselError, match=f"{other} roles for {n} points"):
            make_points(n, rng, roles=["check"] * other)


# Scaling


@given(st.integers(1, 20), st.integers(0, 20), seeds, arrays(np.float64, 5, elements=metres),
       st.floats(1e-3, 1e6))
def test_scaling_there_and_back(n: int, m: int, seed: int, offset: FloatArray, size: float) -> None:
    rng = np.random.default_rng(seed)
    features = FeatureSet(
        make_points(n, rng, image=offset[:2] + rng.uniform(-size, size, (n, 2)),
                    ground=offset[2:] + rng.uniform(-size, size, (n, 3))),
        make_lines(m, rng, image=offset[:2] + rng.uniform(-size, size, (m, 2, 2)),
                   ground=offset[2:] + rng.uniform(-size, size, (m, 2, 3))))
    scaling = make_scaling(features)
    scaled = scaling.features(features)
    # Large offsets leave fewer digits.
    rounding = 1e-12 * (1 + np.abs(offset).max() / size)
    assert np.abs(scaled.ground_vertices()).max() <= 1 + rounding
    assert np.abs(scaled.image_vertices()).max() <= 1 + rounding
    magnitude = np.abs(features.image_vertices()).max()
    np.testing.assert_allclose(scaling.pixels(scaled.image_vertices()), features.image_vertices(),
                               rtol=0, atol=1e-14 * (magnitude + size))
    np.testing.assert_allclose(
        scaled.ground_vertices() * scaling.ground_scale + scaling.ground_offset,
        features.ground_vertices(), rtol=0,
        atol=1e-14 * (np.abs(features.ground_vertices()).max() + size))
    assert scaled.points.sigma is not None
    assert features.points.sigma is not None
    np.testing.assert_allclose(scaled.points.sigma * scaling.image_scale, features.points.sigma)


@given(st.integers(1, 10), seeds)
def test_scaling_without_heights(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    ground = rng.uniform(0, 9, (n, 3))
    ground[:, 2] = np.nan
    points = make_points(n, rng, ground=ground)
    scaled = make_scaling(FeatureSet(points)).points(points)
    np.testing.assert_array_equal(scaled.ground[:, 2], 0.0)
    assert np.isfinite(scaled.image).all()


# Roles


BY_NAME = {one.name: one for one in SPLITS}


def _somewhere(xy: FloatArray) -> Points:
    n = len(xy)
    return Points(tuple(f"P{i}" for i in range(n)), np.zeros((n, 2)),
                  np.column_stack([xy, np.zeros(n)]))


@given(st.integers(0, 150), seeds, st.sampled_from(["stratified", "random"]),
       st.tuples(st.floats(0.05, 1), st.floats(0, 1), st.floats(0, 1)))
def test_every_point_gets_a_role_by_share(n: int, seed: int, how: str,
                                          fractions: tuple[float, float, float]) -> None:
    some, split = _somewhere(np.random.default_rng(seed).uniform(0, 1e4, (n, 2))), BY_NAME[how]
    roles = assign_roles(some, split=split, fractions=fractions, rng=np.random.default_rng(seed))
    assert len(roles) == n
    assert set(roles) <= set(ASSIGNABLE)
    for role, share in zip(ASSIGNABLE, np.array(fractions) / sum(fractions), strict=True):
        assert abs(roles.count(role) - share * n) < 1 + 1e-9
    assert roles == assign_roles(some, split=split, fractions=fractions,
                                 rng=np.random.default_rng(seed))


@given(st.integers(6, 12), seeds)
def test_each_role_covers_all_quadrants(side: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    xy = np.stack(np.meshgrid(np.arange(side), np.arange(side)), -1).reshape(-1, 2) + 0.5
    xy = xy + rng.uniform(-0.4, 0.4, xy.shape)
    roles = np.array(assign_roles(_somewhere(xy), rng=rng))
    quadrant = (xy > side / 2) @ [1, 2]
    for role in ASSIGNABLE:
        assert set(quadrant[roles == role]) == {0, 1, 2, 3}


@given(arrays(np.float64, st.tuples(st.integers(0, 60), st.just(2)), elements=pixels))
def test_spatial_order_names_every_point_once(xy: FloatArray) -> None:
    assert sorted(spatial_order(xy)) == list(range(len(xy)))


@given(st.tuples(*[st.sampled_from([-1.0, 0.0, np.nan, np.inf])] * 3))
def test_fractions_that_share_nothing_out(fractions: tuple[float, float, float]) -> None:
    with pytest.raises(TermselError, match="do not assign the points"):
        assign_roles(_somewhere(np.eye(3, 2)), fractions=fractions, rng=np.random.default_rng(1))
