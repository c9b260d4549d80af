"""Georeference annotations: read, refused with their place, written, and read again."""

from __future__ import annotations

import json
import os
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("termsel_iiif", reason="termsel-iiif is not installed: "
                    "pip install -e plugins/termsel-iiif")

import termsel
from termsel import FeatureSet, Points, Result, TermselError, export, read
from termsel.testing import check, checks, invoke
from termsel.toolkit.coordinates import to_wgs84
from termsel_iiif.annotation import MASK, SOURCE, TRANSFORMATION, maps_of, polygon_corners
from termsel_iiif.reader import ALL_POINTS, AnnotationReader
from termsel_iiif.viewer import TRANSFORMATIONS, forward, from_mercator, kind_of, to_mercator
from termsel_iiif.writer import AnnotationWriter, _choose_transformation

MASK_OF_4 = '<svg width="3000" height="2000"><polygon points="5,5 5,1990 2990,1990 2990,5" /></svg>'


def annotation(n: int = 30, seed: int = 0, **transformation: Any) -> dict[str, Any]:
    """Return an annotation of version 1: a turned map with a little noise."""
    rng = np.random.default_rng(seed)
    image = rng.uniform(50, 1950, (n, 2)).round(3)
    lon = 2.2 + 1e-5 * image[:, 0] + 1e-6 * image[:, 1] + rng.normal(0, 5e-6, n)
    lat = 48.9 + 1e-6 * image[:, 0] - 7e-6 * image[:, 1] + rng.normal(0, 5e-6, n)
    return {
        "type": "Annotation", "id": "https://example.org/maps/1", "motivation": "georeferencing",
        "target": {"type": "SpecificResource", "source": {
            "id": "https://example.org/iiif/1", "type": "ImageService2", "width": 3000,
            "height": 2000}, "selector": {"type": "SvgSelector", "value": MASK_OF_4}},
        "body": {"type": "FeatureCollection", "transformation": transformation or {
            "type": "polynomial", "options": {"order": 1}}, "features": [{
                "type": "Feature", "properties": {"resourceCoords": list(place)},
                "geometry": {"type": "Point", "coordinates": [x, y]}}
                for place, x, y in zip(image.tolist(), lon.tolist(), lat.tolist(), strict=True)]}}


def version_0() -> dict[str, Any]:
    """Return an annotation of version 0."""
    old = annotation(3)
    old["target"] = {
        "type": "Image", "source": "https://example.org/iiif/1/full/full/0/default.jpg",
        "service": [{"@id": "https://example.org/iiif/1", "type": "ImageService2"}],
        "selector": old["target"]["selector"]}
    for feature in old["body"]["features"]:
        feature["properties"] = {"pixelCoords": feature["properties"]["resourceCoords"]}
    return old


def write(folder: Path, content: Any, name: str = "map.json") -> Path:
    path = folder / name
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


TWO = annotation(2)
TWO["body"]["features"][0]["properties"]["resourceCoords"] = [10, 20]
TWO["body"]["features"][0]["geometry"]["coordinates"] = [2.0, 48.0]
TWO["body"]["features"][1]["properties"]["resourceCoords"] = [30.5, 40]
TWO["body"]["features"][1]["geometry"]["coordinates"] = [2.1, 48.1]
KEPT = {SOURCE: json.dumps({
    "annotation": "https://example.org/maps/1", "id": "https://example.org/iiif/1",
    "type": "ImageService2", "width": 3000, "height": 2000}), MASK: MASK_OF_4,
    TRANSFORMATION: json.dumps({"type": "polynomial", "options": {"order": 1}})}
EXPECTED = FeatureSet(Points(
    ("P1", "P2"), np.array([[19.5, 9.5], [39.5, 30.0]]),
    np.array([[2.0, 48.0, np.nan], [2.1, 48.1, np.nan]]),
    attributes={name: np.array([text, ""], dtype=object) for name, text in KEPT.items()}),
    crs="EPSG:4326", image_size=(2000, 3000))


@pytest.mark.parametrize("check", checks(
    AnnotationReader, content=json.dumps(TWO).encode(), expected=EXPECTED, filename="map.json"),
    ids=lambda check: check.name)
def test_the_reader_conforms(check: Any) -> None:
    check.run()


def test_the_writer_conforms() -> None:
    check(AnnotationWriter(image_id="https://example.org/iiif/1"), filename="map.json")


def test_version_0_says_the_same(tmp_path: Path) -> None:
    old = read(write(tmp_path, version_0(), "old.json"))
    new = read(write(tmp_path, annotation(3), "new.json"))
    np.testing.assert_array_equal(old.points.image, new.points.image)
    np.testing.assert_array_equal(old.points.ground, new.points.ground)
    assert old.image_size == new.image_size == (2000, 3000)


def test_a_page_asks_for_the_map(tmp_path: Path) -> None:
    second = annotation(5, seed=1)
    second["id"] = "https://example.org/maps/2"
    page = write(tmp_path, {"type": "AnnotationPage", "items": [annotation(4), second]})
    with pytest.raises(TermselError, match=r"has 2 maps.*1 \(https://example.org/maps/1\), 2"):
        read(page)
    assert len(read(page, map="2").points) == 5
    assert len(read(page, map="https://example.org/maps/1").points) == 4
    with pytest.raises(TermselError, match="no map '3'"):
        read(page, map="3")
    with pytest.raises(TermselError, match="no maps"):
        read(write(tmp_path, {"type": "AnnotationPage", "items": []}, "none.json"))


@pytest.mark.parametrize(("path", "value", "where"), [
    (("target",), None, "$.target"),
    (("body",), None, "$.body"),
    (("target", "selector"), "text", "$.target.selector"),
    (("target", "selector", "value"), "text", "$.target.selector.value"),
    (("target", "selector", "value"), MASK_OF_4.replace("5,1990 2990,1990 2990,5", ""),
     "$.target.selector.value"),
    (("target", "selector", "value"), "<!DOCTYPE a>" + MASK_OF_4, "$.target.selector.value"),
    (("target", "source", "id"), "invalid", "$.target.source.id"),
    (("target", "source", "type"), "Picture", "$.target.source.type"),
    (("body", "features", 0, "type"), "Point", "$.body.features[0].type"),
    (("body", "features", 1, "geometry", "coordinates"), 7,
     "$.body.features[1].geometry.coordinates"),
    (("body", "features", 1, "properties"), {}, "$.body.features[1].properties"),
    (("body", "features", 1, "properties", "resourceCoords"), [1],
     "$.body.features[1].properties.resourceCoords")])
def test_what_is_invalid_is_refused_with_its_place(
        tmp_path: Path, path: tuple[Any, ...], value: Any, where: str) -> None:
    wrong = deepcopy(annotation(3))
    part = wrong
    for step in path[:-1]:
        part = part[step]
    part[path[-1]] = value
    with pytest.raises(TermselError) as raised:
        read(write(tmp_path, wrong), format="georeference-annotation")
    assert f"`{where}`" in str(raised.value)
    with pytest.raises(TermselError, match=r"items\[1\]"):
        read(write(tmp_path, {"type": "AnnotationPage", "items": [annotation(2), wrong]}))


def fitted(path: Path, model: str = "affine", **options: Any) -> Result:
    features = read(path)
    roles = ("control",) * len(features.points)
    features = replace(features, points=replace(features.points, roles=roles))
    return termsel.run("poly-terms", features=features, model=model, solver="all-terms",
                       criterion="press", options=options)


def test_written_points_are_those_that_were_read(tmp_path: Path) -> None:
    there = write(tmp_path, annotation())
    back = tmp_path / "back.json"
    export(fitted(there, "poly2d", degree=1), "georeference-annotation", back)
    before, after = (json.loads(path.read_text()) for path in (there, back))
    assert after["target"]["source"] == before["target"]["source"]
    assert after["target"]["selector"] == before["target"]["selector"]
    assert after["id"] == before["id"]

    def rows(one: dict[str, Any]) -> list[list[float]]:
        return sorted(feature["properties"]["resourceCoords"] + feature["geometry"]["coordinates"]
                      for feature in one["body"]["features"])

    np.testing.assert_allclose(rows(after), rows(before), atol=1e-9)
    np.testing.assert_array_equal(np.sort(read(back).points.image, axis=0),
                                  np.sort(read(there).points.image, axis=0))


@pytest.mark.parametrize("key", TRANSFORMATIONS)
def test_a_transformation_is_a_model_and_back(
        tmp_path: Path, key: str, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", logger="termsel")
    kind = TRANSFORMATIONS[key]
    there = write(tmp_path, annotation(**kind.statement))
    read(there)
    assert f"The map is drawn with {kind.label}; --model {kind.model}" in caplog.text
    back = tmp_path / "back.json"
    export(fitted(there, kind.model, **kind.options), "georeference-annotation", back)
    before, after = (json.loads(path.read_text())["body"] for path in (there, back))
    assert after["transformation"] == kind.statement == before["transformation"]
    assert f"by a viewer with {kind.label}" in caplog.text
    # And once more: what was written is read as it was.
    np.testing.assert_array_equal(np.sort(read(back).points.ground[:, :2], axis=0),
                                  np.sort(read(there).points.ground[:, :2], axis=0))


def test_another_transformation_than_the_model_is_not_kept(tmp_path: Path) -> None:
    there, back = write(tmp_path, annotation(type="thinPlateSpline")), tmp_path / "back.json"
    export(fitted(there, "projective2d"), "georeference-annotation", back)
    assert json.loads(back.read_text())["body"]["transformation"] == {"type": "projective"}


def test_what_an_annotation_says_of_its_own_comes_back(tmp_path: Path) -> None:
    own: dict[str, Any] = {"type": "polynomial", "options": {"order": 2, "by": "a viewer"}}
    there, back = write(tmp_path, annotation(**own)), tmp_path / "back.json"
    export(fitted(there, "poly2d", degree=2), "georeference-annotation", back)
    assert json.loads(back.read_text())["body"]["transformation"] == own


@pytest.mark.parametrize(("stated", "key"), [
    ({"type": "polynomial"}, "order 1"),
    ({"type": "polynomial", "options": {"order": 3}}, "order 3"),
    ({"type": "polynomial", "options": {"order": 4}}, None), ({"type": "straight"}, None),
    ({}, None), ("invalid", None), (None, None)])
def test_transformations_by_name(stated: Any, key: str | None) -> None:
    assert kind_of(stated) is (None if key is None else TRANSFORMATIONS[key])


def test_a_model_without_a_name_gets_the_nearest_transformation(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", logger="termsel")
    there, back = write(tmp_path, annotation()), tmp_path / "back.json"
    export(fitted(there, "dlt2d"), "georeference-annotation", back)
    stated = json.loads(back.read_text())["body"]["transformation"]
    kind = kind_of(stated)
    assert kind is not None
    assert f"by a viewer with {kind.label}" in caplog.text


def test_web_mercator_is_that_of_pyproj() -> None:
    pyproj = pytest.importorskip("pyproj")
    lonlat = np.array([[-179.0, -80.0], [2.3, 48.9], [0.0, 0.0], [120.0, 71.5]])
    known = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:3857", always_xy=True)
    np.testing.assert_allclose(to_mercator(lonlat), np.column_stack(known.transform(*lonlat.T)),
                               rtol=1e-12, atol=1e-6)
    np.testing.assert_allclose(from_mercator(to_mercator(lonlat)), lonlat, rtol=1e-12, atol=1e-12)


EXACT = {
    "similarity": lambda line, sample: (3 * sample + 4 * line, 4 * sample - 3 * line),
    "order 1": lambda line, sample: (3 * sample + 4 * line, sample - 3 * line),
    "projective": lambda line, sample: ((3 * sample + 4 * line) / (1 + 1e-4 * sample),
                                        (sample - 3 * line + 5) / (1 + 1e-4 * sample)),
    "order 2": lambda line, sample: (3 * sample + 1e-3 * line * sample, 1e-3 * line**2 - 3 * line),
    "order 3": lambda line, sample: (3 * sample + 1e-6 * line**3, 1e-6 * line * sample**2 - line)}


@pytest.mark.parametrize("key", EXACT)
def test_transformations_are_exact_where_the_points_are(key: str) -> None:
    rng = np.random.default_rng(4)
    image, other = rng.uniform(0, 2000, (2, 25, 2))
    made = forward(key, image, 250000 + np.column_stack(EXACT[key](*image.T)))
    assert made is not None
    np.testing.assert_allclose(made(other), 250000 + np.column_stack(EXACT[key](*other.T)),
                               rtol=1e-9)


def test_a_spline_goes_through_its_points_and_takes_up_an_affine_map() -> None:
    rng = np.random.default_rng(5)
    image, other = rng.uniform(0, 2000, (2, 25, 2))
    affine = np.array([[2.0, -1.0], [0.5, 3.0]])
    made = forward("spline", image, image @ affine)
    assert made is not None
    np.testing.assert_allclose(made(other), other @ affine, atol=1e-6)
    bent = forward("spline", image, image @ affine + rng.normal(0, 50, image.shape))
    assert bent is not None
    assert np.abs(bent(image) - image @ affine).max() > 50


@pytest.mark.parametrize(("key", "n"), [
    ("similarity", 1), ("order 1", 2), ("projective", 3), ("order 2", 5), ("order 3", 9),
    ("spline", 2)])
def test_too_few_points_determine_no_transformation(key: str, n: int) -> None:
    image = np.random.default_rng(6).uniform(0, 100, (n, 2))
    assert forward(key, image, image) is None
    line = np.column_stack([np.arange(12.0), 2 * np.arange(12.0)])
    assert key == "similarity" or forward(key, line, line) is None


def test_the_deviation_is_that_of_the_viewer(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    # The image is a similarity of Web Mercator times (1, 1.01): a viewer that turns and scales
    # alone is off by half of 1 % of the distance from the middle.
    caplog.set_level("INFO", logger="termsel")
    one = annotation(4)
    corners_of = np.array([[0.0, 0.0], [2000, 0], [0, 2000], [2000, 2000]])  # column, row
    plane = to_mercator(np.array([[2.2, 48.9]])) + corners_of * [1.0, -1.01]
    for feature, place, lonlat in zip(one["body"]["features"], corners_of.tolist(),
                                      from_mercator(plane).tolist(), strict=True):
        feature["properties"]["resourceCoords"] = place
        feature["geometry"]["coordinates"] = lonlat
    one["target"]["source"].update(width=2000, height=2000)
    path = write(tmp_path, one)
    export(fitted(path, "poly2d", degree=1), "georeference-annotation", tmp_path / "a.json")
    assert float(caplog.text.split("at most ")[1].split(" px")[0]) < 0.1
    caplog.clear()
    export(fitted(path, "helmert2d"), "georeference-annotation", tmp_path / "b.json")
    assert "viewer with helmert" in caplog.text


def test_the_sky_of_an_oblique_photo_is_not_asked_for(caplog: pytest.LogCaptureFixture) -> None:
    # A camera 600 m above the plain looks 10 degrees below the horizon, which is at line 559.
    rng = np.random.default_rng(10)
    right, ahead, up = rng.uniform([-0.3, 1500.0, 0.0], [0.3, 8000.0, 100.0], (20, 3)).T
    angle = np.radians(10.0)
    depth = ahead * np.cos(angle) + (600.0 - up) * np.sin(angle)
    down = (600.0 - up) * np.cos(angle) - ahead * np.sin(angle)
    image = np.column_stack([1000.0 + 2500.0 * down / depth,
                             1000.0 + 2500.0 * right * ahead / depth])
    ground = np.column_stack([5e5 + right * ahead, 5.2e6 + ahead, up])
    points = Points(tuple(map(str, range(20))), image + rng.normal(0.0, 0.3, image.shape), ground)
    fit = termsel.fit(FeatureSet(points, crs="EPSG:32632", image_size=(2000, 2000)), "dlt")
    stated = _choose_transformation(fit, points.image, to_wgs84("EPSG:32632")(ground)[:, :2], None)
    assert stated == {"type": "projective"}
    assert "viewer with projective" in caplog.text


def test_the_maps_of_a_page_are_data_of_a_study(tmp_path: Path) -> None:
    pages = [annotation(12, seed=seed) for seed in range(3)]
    for i, page in enumerate(pages):
        page["id"] = f"https://example.org/maps/{i}"
    pages[2]["body"]["features"] = []
    there = write(tmp_path, {"type": "AnnotationPage", "items": pages}, "page.json")
    assert AnnotationReader().parts(there) == {"1": {"map": "1"}, "2": {"map": "2"},
                                               "3": {"map": "3"}}
    assert AnnotationReader(map="2").parts(there) == {}
    study = termsel.compare(
        problems=["poly-terms"], models=[{"name": "poly2d", "degree": 1}], solvers=["all-terms"],
        criteria=["press"], data=[{"points": str(there)}], seeds=1)
    rows = study.to_pandas()
    labels = [Path(label).name for label in rows["data"]]
    assert labels == ["page.json#1", "page.json#2", "page.json#3"]
    assert [bool(reason) for reason in rows["reason"].fillna("")] == [False, False, True]
    # One map that is named is one.
    one = termsel.compare(
        problems=["poly-terms"], models=[{"name": "poly2d", "degree": 1}], solvers=["all-terms"],
        criteria=["press"], data=[{"points": str(there), "options": {"map": "2"}}], seeds=1)
    assert [Path(label).name for label in one.to_pandas()["data"]] == ["page.json"]


def test_an_image_without_an_address_is_asked_for(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    image = rng.uniform(0, 1000, (12, 2))
    features = FeatureSet(Points(tuple(f"P{i}" for i in range(12)), image, np.column_stack(
        [500000 + image[:, 1], 4000000 - image[:, 0], np.full(12, np.nan)])), crs="EPSG:32639")
    result = termsel.run("poly-terms", features=features, model="poly2d", solver="all-terms",
                         criterion="press", options={"degree": 1})
    with pytest.raises(TermselError, match="image_id"):
        export(result, "georeference-annotation", tmp_path / "no.json")
    assert not (tmp_path / "no.json").exists()
    export(result, "georeference-annotation", tmp_path / "map.json",
           image_id="https://example.org/iiif/9")
    again = read(tmp_path / "map.json")
    assert len(again.points) == 12
    assert 50 < again.points.ground[0, 0] < 52


@pytest.mark.parametrize(("count", "kind", "model"), [
    (4, {"type": "thinPlateSpline"}, ["tps"]),
    (30, {"type": "polynomial", "options": {"order": 2}}, ["poly2d", "--set", "degree=2"])])
def test_what_reading_says_of_a_map_is_a_command_that_fits_it_to_all_points(
        count: int, kind: dict[str, Any], model: list[str], tmp_path: Path,
        caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", logger="termsel")
    path = write(tmp_path, annotation(count, **kind))
    read(path)
    words = caplog.text.split("; ")[1].split(" fits that kind")[0].split()
    assert words == ["--model", *model, *ALL_POINTS.split()]
    done = invoke("run", "--points", path, *words, "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    result = termsel.read_result(tmp_path / "out")
    assert result.data.counts.control == count
    assert len(result.selection.features) == count
    assert result.fit.terms.all()
    assert result.fit.control.fit_crs == "EPSG:3857"


def test_corners_are_numbers_in_pairs() -> None:
    assert polygon_corners("1,2 3.5,-4e1  5 6") == [(1, 2), (3.5, -40), (5, 6)]
    assert polygon_corners("1,2 x,4") == []


def test_those_of_allmaps_are_read_or_refused_as_there() -> None:
    here = Path(__file__).resolve().parents[3]
    folder = Path(os.environ.get("TERMSEL_DATA", here.parent / "shared" / "data"),
                  "allmaps-annotations")
    if not folder.is_dir():
        pytest.skip("real data are not here; set TERMSEL_DATA to their folder")
    for file in sorted((folder / "input").glob("*.json")):
        expected = folder / "output" / f"{file.stem}.map.json"
        if not expected.exists():
            with pytest.raises(ValueError, match=r"\$"):
                maps_of(file.read_bytes())
            continue
        for one, known in zip(maps_of(file.read_bytes()), json.loads(expected.read_text()),
                              strict=True):
            assert [list(point) for point in one.features] == [
                gcp["resource"] + gcp["geo"] for gcp in known["gcps"]], file.name
            assert one.resource["id"] == known["resource"]["id"]
            assert (one.resource["width"], one.resource["height"]) == (
                known["resource"].get("width"), known["resource"].get("height"))
            assert one.transformation == known.get("transformation")


@pytest.mark.parametrize(("size", "is_said"), [((3000, 2000), True), ((6000, 3999), False)])
def test_a_selector_of_another_size_than_the_source_is_named(
        size: tuple[int, int], is_said: bool, tmp_path: Path,
        caplog: pytest.LogCaptureFixture) -> None:
    content = annotation()
    content["target"]["source"] |= {"width": 6000, "height": 4000}
    content["target"]["selector"]["value"] = (
        f'<svg width="{size[0]}" height="{size[1]}">'
        f'<polygon points="0,0 {size[0]},0 {size[0]},{size[1]}" /></svg>')
    termsel.read(write(tmp_path, content))
    said = "the selector is of an image of 3000 x 2000 px, and the source of 6000 x 4000 px"
    assert (said in caplog.text) == is_said
