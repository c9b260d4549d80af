"""Ground lines of a GIS, joined with image lines."""

from __future__ import annotations

import json
import logging
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import termsel
from termsel.core.errors import TermselError
from termsel.formats.readers.csv_tables import write_points_csv
from termsel.formats.readers.ground_lines import VectorLines
from termsel.simulate import simulate_scene
from termsel.testing import Check, checks

HEADER = "id,line1,sample1,line2,sample2\n"


def roads(folder: Path, *features: tuple[Any, str, Any], name: str = "roads.geojson",
          **members: Any) -> Path:
    """Write GeoJSON of (id, type, coordinates)."""
    path = folder / name
    path.write_text(json.dumps({"type": "FeatureCollection", **members, "features": [
        {"type": "Feature", "properties": {"name": id},
         "geometry": {"type": kind, "coordinates": coordinates}}
        for id, kind, coordinates in features]}))
    return path


def measured(folder: Path, rows: str) -> Path:
    path = folder / "image.csv"
    path.write_text(HEADER + rows)
    return path


def read(path: Path, image: Path | None = None, **options: Any) -> termsel.Lines:
    return termsel.read(lines=path, image_lines=image, **{"join": "name", **options}).lines


SQUARE = [[5, 44, 1], [5, 45, 2], [6, 45, 3], [6, 44, 4]]


def test_one_image_line_takes_every_vertex_once(tmp_path: Path) -> None:
    path = roads(tmp_path, ("a", "LineString", SQUARE))
    lines = read(path, measured(tmp_path, "a,10,20,30,40\n"))
    assert lines.ids == ("a", "a")
    np.testing.assert_array_equal(lines.image, [[[10, 20], [30, 40]]] * 2)
    np.testing.assert_array_equal(lines.ground, [SQUARE[:2], SQUARE[2:]])


def test_an_odd_vertex_shares_the_last_pair(tmp_path: Path) -> None:
    path = roads(tmp_path, ("a", "LineString", [*SQUARE, [7, 44, 5]]))
    lines = read(path, measured(tmp_path, "a,10,20,30,40\n"))
    np.testing.assert_array_equal(lines.ground,
                                  [SQUARE[:2], SQUARE[2:], [SQUARE[3], [7, 44, 5]]])


def test_image_pieces_are_those_of_the_segments(tmp_path: Path) -> None:
    path = roads(tmp_path, ("b", "LineString", [[1, 1], [2, 2]]), ("a", "LineString", SQUARE))
    lines = read(path, measured(tmp_path, "a,1,2,3,4\nb,0,0,9,9\na,3,4,5,8\na,5,8,1,0\n"))
    assert lines.ids == ("a", "a", "a", "b")
    np.testing.assert_array_equal(lines.image[:3, 0], [[1, 2], [3, 4], [5, 8]])
    np.testing.assert_array_equal(lines.ground[:3, 1], SQUARE[1:])
    assert np.isnan(lines.ground[3, :, 2]).all()


def test_parts_and_features_of_one_id_belong_together(tmp_path: Path) -> None:
    path = roads(tmp_path, (7, "MultiLineString", [SQUARE[:2], [[8, 44], [9, 44], [9, 44]]]),
                 (7, "LineString", [[10, 44], [11, 44]]))
    lines = read(path, measured(tmp_path, "7,1,2,3,4\n"))
    assert lines.features == ("7",)
    np.testing.assert_array_equal(lines.ground[:, 0, 0], [5, 8, 10])


def test_pieces_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    path = roads(tmp_path, ("a", "LineString", SQUARE))
    with pytest.raises(TermselError, match="'a' has 2 pieces in the image and 3 on the ground"):
        read(path, measured(tmp_path, "a,1,2,3,4\na,3,4,5,8\n"))


def test_lines_that_were_not_measured_stay_out(tmp_path: Path,
                                               caplog: pytest.LogCaptureFixture) -> None:
    path = roads(tmp_path, ("a", "LineString", SQUARE), ("b", "LineString", [[0, 0], [1, 1]]),
                 (None, "LineString", [[2, 0], [1, 1]]))
    with caplog.at_level(logging.INFO, "termsel"):
        assert read(path, measured(tmp_path, "a,1,2,3,4\n")).features == ("a",)
    assert "2 of roads.geojson are not used" in caplog.text


@pytest.mark.parametrize(("rows", "options", "words"), [
    ("a,1,2,3,4\nc,1,2,3,4\n", {}, "1 of 2 image lines have no ground line: c"),
    ("a,1,2,3,4\n", {"join": "id"},
     "no property 'id' that names each line. Their properties are name. Say which one does: "
     "join="),
    ("a,1,2,3,x\n", {}, r"image\.csv, line 2, column 'sample2'"),
    ("a,1,2,1,2\n", {}, "'a' has zero length in the image"),
    ("", {}, "a header and no row below it")])
def test_what_cannot_be_joined(tmp_path: Path, rows: str, options: dict[str, Any],
                               words: str) -> None:
    path = roads(tmp_path, ("a", "LineString", SQUARE))
    with pytest.raises(TermselError, match=words):
        read(path, measured(tmp_path, rows), **options)


def test_ground_lines_need_image_lines(tmp_path: Path) -> None:
    path = roads(tmp_path, ("a", "LineString", SQUARE))
    with pytest.raises(TermselError, match=r"lines on the ground alone.*image_lines=FILE\. Or"):
        read(path)
    with pytest.raises(TermselError, match=r"image_lines=FILE join='name'\. Or give each "):
        read(path, join="id")
    with pytest.raises(TermselError, match=r"missing\.csv: this file does not exist"):
        read(path, tmp_path / "missing.csv")
    dot = roads(tmp_path, ("a", "LineString", [[5, 44], [5, 44]]))
    with pytest.raises(TermselError, match="'a' has zero length on the ground"):
        read(dot, measured(tmp_path, "a,1,2,3,4\n"))


def layer(path: Path, **options: Any) -> Path:
    """Write two lines, one of them in two parts, as a GeoPackage or Shapefile."""
    pyogrio = pytest.importorskip("pyogrio")
    shapely = pytest.importorskip("shapely")
    shapes = [shapely.LineString([(500000, 5000000, 12), (500100, 5000000, 13)]),
              shapely.MultiLineString([[(500000, 5001000, 1), (500100, 5001000, 2)],
                                       [(500200, 5001000, 3), (500300, 5001000, 4)]])]
    pyogrio.raw.write(path, shapely.to_wkb(np.array(shapes), flavor="iso"),
                      [np.array([4, 12]), np.array(["[[1, 2], [3, 4]]", "[[5, 6], [7, 8]]"])],
                      ["nr", "ji"], crs="EPSG:32631",
                      geometry_type=options.pop("geometry_type", "Unknown"), **options)
    return path


@pytest.mark.parametrize("name", ["roads.gpkg", "roads.shp"])
def test_layers(tmp_path: Path, name: str) -> None:
    kind = "MultiLineString Z" if name.endswith("shp") else "Unknown"
    path = layer(tmp_path / name, geometry_type=kind)
    for image in (None, measured(tmp_path, "12,6,5,8,7\n4,2,1,4,3\n")):
        features = termsel.read(lines=path, image_lines=image, join="nr")
        order = sorted(range(3), key=lambda i: int(features.lines.ids[i]))
        lines = features.lines.take(order)
        assert features.crs == "EPSG:32631"
        assert lines.ids == ("4", "12", "12")
        np.testing.assert_array_equal(lines.image, [[[2, 1], [4, 3]], *[[[6, 5], [8, 7]]] * 2])
        np.testing.assert_array_equal(lines.ground[:, 0, 2], [12, 1, 3])


def test_a_folder_next_to_a_shapefile_is_left_alone(tmp_path: Path) -> None:
    """As of results, which people call by the file."""
    path = layer(tmp_path / "roads.shp", geometry_type="MultiLineString Z")
    (tmp_path / "roads.out").mkdir()
    assert len(termsel.read(lines=path, join="nr").lines) == 3


def test_layer_of_several(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = layer(tmp_path / "roads.gpkg", layer="streets")
    layer(path, layer="rivers", append=True)
    assert len(termsel.read(lines=path, join="nr", layer="rivers").lines) == 3
    with pytest.raises(TermselError, match=r"no layer 'canals'\. It has streets, rivers"):
        termsel.read(lines=path, join="nr", layer="canals")
    assert "layers" not in caplog.text
    caplog.set_level("INFO", logger="termsel")
    termsel.read(lines=path, join="nr")
    assert "has the layers streets, rivers; streets is read, and --set layer=NAME chooses " \
        "another" in caplog.text


@pytest.mark.parametrize(("wkt", "words"), [
    ("LINESTRING EMPTY", "feature 2: its geometry is missing"),
    ("POINT (1 2)", "feature 2: its geometry is Point, expected LineString or MultiLineString"),
    ("LINESTRING M (500000 5000900 7, 500900 5000900 8)", None)])
def test_geometries_of_layers(tmp_path: Path, wkt: str, words: str | None) -> None:
    pyogrio = pytest.importorskip("pyogrio")
    shapely = pytest.importorskip("shapely")
    shapes = np.array([shapely.LineString([(500000, 5000000), (500100, 5000000)]),
                       shapely.from_wkt(wkt)])
    path = tmp_path / "roads.gpkg"
    pyogrio.raw.write(path, shapely.to_wkb(shapes, flavor="iso"), [np.array([1.0, 2.0])], ["id"],
                      crs="EPSG:32631", geometry_type="Unknown")
    image = measured(tmp_path, "1,1,2,3,4\n2,5,6,7,8\n")
    if words is not None:
        with pytest.raises(TermselError, match=words):
            termsel.read(lines=path, image_lines=image)
        return
    lines = termsel.read(lines=path, image_lines=image).lines  # ids of whole floats, too
    assert lines.ids == ("1", "2")
    assert np.isnan(lines.ground[..., 2]).all()


def _vector_checks() -> list[Check]:
    """Return the checks of a reader, on a GeoPackage; none without the packages for them."""
    from tempfile import TemporaryDirectory

    try:
        with TemporaryDirectory() as folder:
            path = layer(Path(folder) / "roads.gpkg")
            content, expected = path.read_bytes(), VectorLines(join="nr").read(path)
    except pytest.skip.Exception:
        return []
    return list(checks(VectorLines(join="nr"), content=content, expected=expected,
                       filename="roads.gpkg"))


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # GDAL's words on files that are cut off
@pytest.mark.parametrize("check", _vector_checks(), ids=lambda check: str(check.name))
def test_reader_of_layers(check: Check) -> None:
    check.run()


def test_without_pyogrio_the_command_is_given(tmp_path: Path,
                                              monkeypatch: pytest.MonkeyPatch) -> None:
    path = layer(tmp_path / "roads.gpkg")
    monkeypatch.setitem(sys.modules, "pyogrio.errors", None)
    with pytest.raises(TermselError, match=r'pip install "termsel\[gis\]"'):
        termsel.read(lines=path)


@pytest.mark.slow
def test_run_over_polylines(tmp_path: Path) -> None:
    """On the command line: lines of a scene as polylines of three vertices."""
    scene = simulate_scene("ikonos-hamedan")
    lines = scene.lines.take(range(40))
    write_points_csv(scene.points, tmp_path / "points.csv", scene.crs)
    path = roads(tmp_path, *((name, "LineString", [ends[0].tolist(), ends.mean(axis=0).tolist(),
                                                   ends[1].tolist()])
                             for name, ends in zip(lines.ids, lines.ground, strict=True)))
    image = measured(tmp_path, "".join(
        f"{name},{a[0]!r},{a[1]!r},{b[0]!r},{b[1]!r}\n"
        for name, (a, b) in zip(lines.ids, lines.image.tolist(), strict=True)))
    command = [sys.executable, "-m", "termsel", "run", "--problem", "owdis-lines", "--points",
               str(tmp_path / "points.csv"), "--lines", str(path), "--crs", "EPSG:4979", "--json",
               "--set", "join=name", "--generations", "2", "--set", "population=20", "--set",
               "polish=false"]
    done = subprocess.run([*command, "--image-lines", str(image)], capture_output=True, text=True,
                          check=False)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["data"]["counts"]["lines"] == len(lines)
    assert 4 * result["selection"]["n_features"] == result["adjustment"]["equations"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert "--image-lines FILE" in done.stderr
