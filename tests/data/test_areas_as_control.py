"""Areas as control: their edges as lines, their centroids as points."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay

import termsel
from termsel.cli.main import cli
from termsel.core.errors import TermselError
from termsel.data.areas import Area, boundary_lines, centroid_of_ring, centroid_points
from termsel.data.features import FloatArray, Points
from termsel.formats.readers.areas_table import AreasCsv
from termsel.formats.readers.csv_tables import table_text, write_lines_csv, write_points_csv
from termsel.simulate import scene_truth, simulate_scene
from termsel.testing import check

HEADER = "id,corner,line,sample,x,y,z\n"
SQUARE = "a,1,0,0,5,44,10\na,2,0,4,9,44,10\na,3,3,4,9,47,40\na,4,3,0,5,47,40\n"

# An L: a square of 2 by 2 without its upper right quarter. By hand: rectangles of 2 by 1 about
# (1, 0.5) and of 1 by 1 about (0.5, 1.5); their mean by area is (2.5 / 3, 2.5 / 3).
ELL = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2.0]])


def areas_from(path: Path, text: str, **options: str) -> termsel.FeatureSet:
    path.write_text(text)
    return termsel.read(areas=path, crs="local", **options)


# Pure functions


def test_centroid_by_hand() -> None:
    np.testing.assert_allclose(centroid_of_ring(ELL), [2.5 / 3, 2.5 / 3], rtol=1e-14)
    np.testing.assert_allclose(centroid_of_ring([[0, 0], [6, 0], [0, 3.0]]), [2, 1], rtol=1e-14)
    # The height of a plane at the centroid, far from the origin as in a UTM zone.
    away = ELL + np.array([500_000, 4_000_000])
    ground = np.column_stack([away, 300 + 10 * ELL[:, 0] - 4 * ELL[:, 1]])
    np.testing.assert_allclose(centroid_of_ring(ground),
                               [500_000 + 2.5 / 3, 4_000_000 + 2.5 / 3, 305],
                               rtol=0, atol=1e-9)


@settings(max_examples=50, deadline=None)
@given(st.integers(3, 12), st.integers(0, 2**32 - 1))
def test_centroid_keeps_with_affine_maps_directions_and_starts(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * (np.arange(n) + rng.uniform(0, 0.4, n)) / n
    ring = rng.uniform(1, 2, (n, 1)) * np.column_stack([np.cos(angle), np.sin(angle)])
    middle = centroid_of_ring(ring)
    map_, shift = rng.normal(size=(2, 2)) + 2 * np.eye(2), rng.normal(size=2)
    for other, expected in ((ring[::-1], middle), (np.roll(ring, 2, axis=0), middle),
                            (ring @ map_.T + shift, map_ @ middle + shift)):
        np.testing.assert_allclose(centroid_of_ring(other), expected, rtol=0, atol=1e-9)


def test_edges_by_hand() -> None:
    ground = np.column_stack([ELL, np.arange(6.0)])
    closed = Area("a", np.vstack([ELL, ELL[:1]]), np.vstack([ground, ground[:1]]))
    triangle = Area("b", ELL[:3] + 10, ground[:3] + 10)
    lines = boundary_lines([closed, triangle])
    assert lines.ids == ("a",) * 6 + ("b",) * 3
    assert lines.features == ("a", "b")
    np.testing.assert_array_equal(lines.image[0], [[0, 0], [2, 0]])
    np.testing.assert_array_equal(lines.image[5], [[0, 2], [0, 0]])
    np.testing.assert_array_equal(lines.ground[5], [[0, 2, 5], [0, 0, 0]])
    np.testing.assert_array_equal(lines.ground[8], [[12, 11, 12], [10, 10, 10]])


def squares(rows: int, columns: int) -> list[Area]:
    """Neighbouring unit squares; every second one is given the other way round."""
    ring = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    areas = []
    for i, (x, y) in enumerate(np.ndindex(columns, rows)):
        own = (ring + np.array([x, y]))[::-1 if i % 2 else 1]
        areas.append(Area(f"{x}{y}", own, np.column_stack([own, np.full(4, 10.0 * i)])))
    return areas


def test_edges_of_neighbours_are_taken_once() -> None:
    # By hand: of 3 by 3 squares with 36 edges, 12 are shared. The middle one has none of its own.
    lines = boundary_lines(squares(3, 3))
    assert len(lines) == 24
    assert len({frozenset(map(tuple, edge)) for edge in lines.ground[..., :2].tolist()}) == 24
    counts = [lines.ids.count(area.id) for area in squares(3, 3)]
    assert min(counts) >= 2
    # The image goes with the ground.
    np.testing.assert_array_equal(lines.image, lines.ground[..., :2])


@settings(max_examples=25, deadline=None)
@given(st.integers(3, 9), st.integers(0, 2**32 - 1))
def test_every_area_of_a_map_keeps_an_edge(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    corners = rng.uniform(0, 100, (n, 2))
    triangles = Delaunay(corners).simplices
    areas = [Area(str(i), corners[one], np.column_stack([corners[one], one]))
             for i, one in enumerate(triangles)]
    lines = boundary_lines(areas)
    assert set(lines.features) == {area.id for area in areas}
    edges = {frozenset(pair) for one in triangles.tolist() for pair in combinations(one, 2)}
    assert len(lines) == len(edges)


def test_an_area_twice_is_refused() -> None:
    one, = squares(1, 1)
    with pytest.raises(TermselError, match=r"all edges of area 'b' .*Remove one of these areas"):
        boundary_lines([one, replace(one, id="b")])


def test_roles() -> None:
    ground = np.column_stack([ELL, np.zeros(6)])
    some = [Area(role or "blank", ELL, ground + np.array([10 * i, 0, 0]), role)
            for i, role in enumerate(("", "off", "control"))]
    assert boundary_lines(some).features == ("blank", "control")
    assert centroid_points(some).roles == ("control", "off", "control")
    with pytest.raises(TermselError, match="cannot have the role 'check'"):
        boundary_lines([replace(some[0], role="check")])
    assert centroid_points([replace(some[0], role="check")]).roles == ("check",)
    assert len(centroid_points([])) == len(boundary_lines([])) == 0


def test_image_and_ground_of_different_numbers() -> None:
    with pytest.raises(TermselError, match=r"shapes \(6, 2\) in the image and \(5, 3\)"):
        Area("a", ELL, np.zeros((5, 3)))


def test_unknown_deviations_next_to_known_ones() -> None:
    known = Points(("a", "b"), [[0, 0], [1, 1]], [[0, 0, 0], [1, 1, 1]], [[1, 2], [3, 4]])
    both = known.join(Points(("c",), [[2, 2]], [[2, 2, 2]], roles=("check",)))
    np.testing.assert_array_equal(both.sigma, [[1, 2], [3, 4], [2.5, 2.5]])
    assert both.roles == ("", "", "check")


# The table


def test_table_of_corners(tmp_path: Path) -> None:
    # In any order, with the first corner repeated.
    rows = SQUARE.splitlines()
    text = "# crs: EPSG:32639\n" + HEADER + "\n".join([rows[2], rows[0], rows[3], rows[1]])
    text = text.replace("9,44", "9,45") + "\na,5,0,0,5,44,10\n"
    path = tmp_path / "areas.csv"
    path.write_text(text)
    lines = AreasCsv().read(path).lines
    assert lines.ids == ("a",) * 4
    np.testing.assert_array_equal(lines.image[:, 0], [[0, 0], [0, 4], [3, 4], [3, 0]])
    np.testing.assert_array_equal(lines.ground[1], [[9, 45, 10], [9, 47, 40]])
    check(AreasCsv(), content=text.encode(), expected=AreasCsv().read(path), filename="areas.csv")


def test_centroids_of_a_table(tmp_path: Path) -> None:
    points = areas_from(tmp_path / "a.csv", HEADER + SQUARE, areas_as="centroid").points
    assert (points.ids, points.roles) == (("a",), ("control",))
    np.testing.assert_allclose(points.image, [[1.5, 2]])
    np.testing.assert_allclose(points.ground, [[7, 45.5, 25]])


@pytest.mark.parametrize(("text", "line", "column", "words"), [
    (HEADER + "a,1,0,0,5,44,10\na,2,0,4,9,44,10\n", 3, "line", "area 'a' has 2 corners"),
    (HEADER + SQUARE.replace("a,2,0,4", "a,2,0,"), 3, "sample", "the cell is blank"),
    (HEADER + SQUARE.replace("9,44", ",44"), 3, "x", "the cell is blank"),
    (HEADER + SQUARE.replace("a,3,3,4", "a,3,0,4"), 4, "line",
     "corner 3 of area 'a' repeats corner 2 in the image"),
    (HEADER + SQUARE.replace("5,47", "5,44"), 5, "x",
     "corner 4 of area 'a' repeats corner 1 on the ground"),
    (HEADER + SQUARE.replace("a,2,", "a,1,"), 3, "corner",
     "corner 1 of area 'a' is also on line 2"),
    (HEADER + "b,1,0,0,1,1,1\nb,2,1,0,2,1,1\nb,3,0,1,1,2,1\n"
     + "a,1,0,0,5,44,10\na,2,0,4,6,45,10\na,3,3,4,7,46,10\n", 5, "x", "no extent on the ground"),
    (HEADER + "a,1,0,0,0,0,1\na,2,4,4,4,4,1\na,3,4,0,4,0,1\na,4,0,1,0,1,1\n", 4, "line",
     "the edges from corners 1 and 3 of area 'a' cross in the image"),
    (HEADER.replace("z", "z,role") + "a,1,0,0,5,44,1,\na,2,0,4,9,44,1,off\na,3,3,4,9,47,1,check\n",
     4, "role", "has the roles 'off' and 'check'"),
    (HEADER.replace("z", "z,role") + "a,1,0,0,5,44,1,check\na,2,0,4,9,44,1,\na,3,3,4,9,47,1,\n",
     2, None, "areas_as='centroid'"),
    ("id,corner,line,sample,x,z\n", 1, "y", "there is no column for y"),
])
def test_bad_tables(tmp_path: Path, text: str, line: int, column: str | None, words: str) -> None:
    path = tmp_path / "areas.csv"
    with pytest.raises(TermselError) as caught:
        areas_from(path, text)
    assert words in str(caught.value)
    assert (caught.value.file, caught.value.line, caught.value.column) == (path, line, column)


def test_files_of_other_kinds(tmp_path: Path) -> None:
    areas, points = tmp_path / "areas.csv", tmp_path / "points.csv"
    areas.write_text(HEADER + SQUARE)
    points.write_text("id,line,sample,x,y,z\na,1,2,3,4,5\n")
    for given_, words in (({"areas": points}, "a file of points or lines, not of areas"),
                          ({"points": areas}, "the file has areas. Give it as areas"),
                          ({"lines": areas, "areas": areas}, "Give it as areas, not as points"),
                          ({"points": points, "areas": areas}, "'a' is the id of an area and")):
        with pytest.raises(TermselError, match=words):
            termsel.read(**given_, crs="local")


# A run


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with points, lines and areas of the IKONOS scene: squares of 60 m, 0.5 px noise."""
    folder = tmp_path_factory.mktemp("areas")
    scene = simulate_scene("ikonos-hamedan", n_points=120, n_lines=12, wrong_lines=0)
    truth, rng = scene_truth("ikonos-hamedan"), np.random.default_rng(5)
    taken = np.flatnonzero(np.array(scene.points.roles) == "control")
    write_lines_csv(scene.lines, folder / "lines.csv", scene.crs)
    rows: list[FloatArray] = []
    texts = []
    for i in taken:
        lon, lat, _ = scene.points.ground[i]
        half = 30 / 111_000
        east = half / np.cos(np.radians(lat))
        ring = np.array([[lon - east, lat - half], [lon + east, lat - half],
                         [lon + east, lat + half], [lon - east, lat + half]])
        ground = np.column_stack([ring, truth.terrain(ring)])
        image = truth.sensor.project(ground) + rng.normal(0, 0.5, (4, 2))
        rows.append(np.column_stack([np.arange(4) + 1, image, ground]))
        texts += [[f"A{scene.points.ids[i]}"]] * 4
    (folder / "areas.csv").write_text(table_text(
        scene.crs, ["id", "corner", "line", "sample", "x", "y", "z"], texts, np.concatenate(rows)))
    others = np.delete(np.arange(len(scene.points)), taken)
    write_points_csv(scene.points.take(others), folder / "others.csv", scene.crs)
    return folder


def command(*words: object) -> dict[str, object]:
    done = CliRunner().invoke(cli, ["run", *map(str, words), "--solver", "all-terms", "--json"],
                              catch_exceptions=False)
    assert done.exit_code == 0, done.output
    record: dict[str, object] = json.loads(done.stdout)
    return record


@pytest.mark.slow
def test_areas_in_either_form_fit_alike(files: Path, tmp_path: Path) -> None:
    given_ = ("--points", files / "others.csv", "--areas", files / "areas.csv")
    points = command("--problem", "owdis-points", *given_, "--out", tmp_path)
    lines = command("--problem", "owdis-lines", *given_)
    n = len({row.split(",")[0] for row in (files / "areas.csv").read_text().splitlines()[2:]})
    assert points["data"]["counts"]["control"] == n  # type: ignore[index]
    assert lines["data"]["counts"]["lines"] == n  # type: ignore[index]
    accuracy = [found["rmse"]["independent"]["total"]  # type: ignore[index]
                for found in (points, lines)]
    # The points' own noise is 0.5 px in line and in sample.
    assert all(0.6 < value < 1.5 for value in accuracy)
    again = termsel.read_result(tmp_path)
    assert again.fit.control.points.ids[0].startswith("AP")


@pytest.mark.slow
def test_areas_together_with_lines(files: Path) -> None:
    found = command("--problem", "owdis-lines", "--points", files / "others.csv", "--lines",
                    files / "lines.csv", "--areas", files / "areas.csv")
    features = found["selection"]["features"]  # type: ignore[index]
    assert {name[0] for name in features} == {"A", "L"}
    assert str(files / "areas.csv") in found["data"]["source"]  # type: ignore[index]


@pytest.mark.slow
def test_areas_are_chosen_as_a_whole(files: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(cli, [
        "run", "--problem", "owdis-lines", "--points", str(files / "others.csv"), "--areas",
        str(files / "areas.csv"), "--model", "affine", "--generations", "3", "--set",
        "population=20", "--set", "max_features=8", "--json", "--out", str(tmp_path)],
        catch_exceptions=False)
    chosen = json.loads(done.stdout)["selection"]["features"]
    assert 2 <= len(chosen) <= 8
    uses: dict[str, list[bool]] = {}
    for residual in termsel.read_result(tmp_path).residuals:
        if residual.role == "control":
            uses.setdefault(residual.id, []).append(residual.used)
    assert {name: flags for name, flags in uses.items() if any(flags)} == {
        name: [True] * 8 for name in chosen}


@pytest.mark.slow
def test_the_form_can_be_chosen(files: Path) -> None:
    found = command("--problem", "owdis-points", "--points", files / "others.csv", "--areas",
                    files / "areas.csv", "--set", "areas_as=boundary", "--set", "mixed=true",
                    "--set", "roles=stratified")
    assert found["data"]["counts"]["lines"] > 30  # type: ignore[index]
