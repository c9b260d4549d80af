"""Tables that are written and read again, and any content that is read or refused."""

from __future__ import annotations

import sys
from collections import Counter
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from termsel.core.errors import TermselError
from termsel.data.features import ROLES, Lines, Points
from termsel.formats.readers.csv_tables import (
    write_lines_csv,
    write_points_csv,
)
from termsel.formats.readers.tables import VOID_HEIGHTS
from tests.csv_texts import LINES, POINTS, READERS, put, read_file

# Round trips

names = st.text(st.characters(exclude_categories=["C", "Z"]), min_size=1, max_size=6)
numbers = st.floats(-1e12, 1e12, allow_subnormal=False)
heights = st.one_of(numbers.filter(lambda z: z not in VOID_HEIGHTS), st.just(np.nan))


@st.composite
def points(draw: st.DrawFn) -> Points:
    ids = draw(st.lists(names, min_size=1, max_size=6, unique=True))
    n = len(ids)
    ground = np.column_stack([
        draw(arrays(float, (n, 2), elements=numbers, unique=True)),
        draw(arrays(float, n, elements=heights))])
    sigma = draw(st.none() | arrays(float, (n, 2), elements=st.floats(1e-9, 1e9)))
    roles = draw(st.lists(st.sampled_from(("", *ROLES)), min_size=n, max_size=n))
    return Points(tuple(ids), draw(arrays(float, (n, 2), elements=numbers)), ground, sigma,
                  tuple(roles))


@st.composite
def lines(draw: st.DrawFn) -> Lines:
    ids = draw(st.lists(names, min_size=1, max_size=6))
    n = len(ids)
    xy = draw(arrays(float, (n, 2, 2), elements=numbers, unique=True))
    z = draw(arrays(float, (n, 2, 1), elements=heights))
    image = draw(arrays(float, (n, 2, 2), elements=numbers, unique=True))
    sigma = draw(st.none() | arrays(float, n, elements=st.floats(1e-9, 1e9)))
    return Lines(tuple(ids), image, np.concatenate([xy, z], axis=2), sigma)


@settings(max_examples=60, deadline=None)
@given(points())
def test_points_round_trip(tmp_path_factory: pytest.TempPathFactory, written: Points) -> None:
    path = tmp_path_factory.mktemp("points") / "points.csv"
    write_points_csv(written, path, "EPSG:4979")
    features = read_file(path, READERS)
    assert features.crs == "EPSG:4979"
    assert features.points.ids == written.ids
    assert features.points.roles == written.roles
    np.testing.assert_array_equal(features.points.image, written.image)
    np.testing.assert_array_equal(features.points.ground, written.ground)
    if written.sigma is None:
        assert features.points.sigma is None
    else:
        np.testing.assert_array_equal(features.points.sigma, written.sigma)


@settings(max_examples=60, deadline=None)
@given(lines())
def test_lines_round_trip(tmp_path_factory: pytest.TempPathFactory, written: Lines) -> None:
    path = tmp_path_factory.mktemp("lines") / "lines.csv"
    write_lines_csv(written, path)
    features = read_file(path, READERS)
    assert features.crs == ""
    assert features.lines.ids == written.ids
    np.testing.assert_array_equal(features.lines.image, written.image)
    np.testing.assert_array_equal(features.lines.ground, written.ground)
    if written.sigma is None:
        assert features.lines.sigma is None
    else:
        np.testing.assert_array_equal(features.lines.sigma, written.sigma)


@settings(max_examples=200, deadline=None)
@given(st.sampled_from((POINTS, LINES, "", "# crs: EPSG:4979\n" + POINTS)),
       st.text('ab,;\t"#\r\n 0123456789.-e\x1cé:', max_size=80) | st.binary(max_size=40),
       st.sampled_from((None, "points-csv", "lines-csv")))
def test_any_content_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, head: str,
                                        rest: str | bytes, format: str | None) -> None:
    content = head.encode() + (rest if isinstance(rest, bytes) else rest.encode())
    path = put(tmp_path_factory.mktemp("any"), content)
    with suppress(TermselError):
        read_file(path, READERS, format)


def test_ids_that_look_like_comments_and_quotations(tmp_path: Path) -> None:
    ids = ("#1", 'say "a"', "b;c", "d,e", "f#")
    written = Points(ids, np.arange(10.0).reshape(5, 2), np.arange(15.0).reshape(5, 3))
    write_points_csv(written, tmp_path / "p.csv")
    assert read_file(tmp_path / "p.csv", READERS).points.ids == ids


@pytest.mark.slow
def test_many_points_are_not_read_cell_by_cell(tmp_path: Path) -> None:
    n = 20_000
    values = np.random.default_rng(1).random((n, 5)) * 1000
    path = tmp_path / "many.csv"
    write_points_csv(Points(tuple(map(str, range(n))), values[:, :2], values[:, 2:]), path)
    calls = Counter[str]()
    sys.setprofile(lambda frame, event, _: calls.update(
        [event] if event == "call" and "readers" in frame.f_code.co_filename else []))
    try:
        points = read_file(path, READERS)
    finally:
        sys.setprofile(None)
    assert len(points) == n
    assert calls["call"] < 3 * n, "calls of functions of readers"
