"""What an export says of its deviation from the model, held against what GDAL makes of the file."""

from __future__ import annotations

import logging
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import termsel
from termsel.data.features import FeatureSet, Points
from termsel.formats import deviation
from termsel.formats.deviation import places_of
from termsel.plugins.registry import registry
from termsel.simulate import scene_truth, simulate_scene

MEASURED = ("orthority-geojson", "points-csv", "residuals-gpkg", "lines-csv")
POINTS = ("erdas-gcps", "pci-gcp")
CHECKED = ("asp-gcp", "odm-gcp-list", "micmac-xml", "gdal-options", "metashape-markers",
           "pix4d-marks")
"""Formats of termsel-formats that hold points alone."""


@pytest.fixture(scope="module")
def relief() -> termsel.Result:
    """A scene with some 700 m of relief."""
    return termsel.run("rfm-terms", features=simulate_scene("ikonos-hamedan", n_lines=0),
                       model="poly3d", solver="all-terms", criterion="press")


def said(result: termsel.Result, to: str, path: Path, caplog: pytest.LogCaptureFixture,
         **options: object) -> list[tuple[int, float, float]]:
    """Return level, px and metres of the deviations that an export logs."""
    caplog.clear()
    with caplog.at_level(logging.INFO, logger="termsel"):
        termsel.export(result, to, path, overwrite=True, **options)
    found = []
    for record in caplog.records:
        match = re.search(rf"{to}: at most (\S+) px \((\S+) m on the ground\) from the model",
                          record.getMessage())
        if match:
            found.append((record.levelno, *(float(one.replace(",", "")) for one in match.groups())))
    return found


def by_gdal(path: Path, ground: np.ndarray, tps: bool = True) -> np.ndarray:
    """Return line and sample that GDAL's spline or polynomial gives, from pixel centres."""
    rasterio = pytest.importorskip("rasterio")
    from rasterio.transform import GCPTransformer

    with rasterio.open(path) as raster, GCPTransformer(raster.gcps[0], tps=tps) as transformer:
        rows, columns = transformer.rowcol(ground[:, 0], ground[:, 1], op=np.asarray)
    return np.column_stack([rows, columns]) - 0.5


def flat(degree: int = 2, noise: float = 0.3, along: float = 1800.0) -> FeatureSet:
    """Return control of a scanned sheet that is bent as a polynomial of this degree.

    It is stretched along the lines, but for ``along=1400``.
    """
    rng = np.random.default_rng(degree)
    east, north = u = rng.uniform(-1.0, 1.0, (2, 30))
    bent = sum(rng.normal(0.0, 40.0, (2, 1)) * east**i * north ** (degree - i)
               for i in range(degree + 1))
    image = (np.array([[2000.0], [1500.0]]) + [-along * north, 1400.0 * east]
             + (bent if degree > 1 else 0.0) + noise * rng.standard_normal((2, 30)))
    ground = np.column_stack([*(600_000.0 + 1500.0 * u), np.full(30, np.nan)])
    return FeatureSet(Points(tuple(map(str, range(30))), image.T, ground, None,
                             ("control",) * 30), crs="EPSG:32633", image_size=(4000, 3000))


@pytest.mark.parametrize(("model", "options", "to", "label"), [
    ("poly2d", {"degree": 2}, "gcp-vrt", "by gdalwarp -order 2."),
    ("poly2d", {"degree": 2}, "qgis-points", "has the transformation type Polynomial 2."),
    ("poly2d", {"degree": 1}, "qgis-points", "has the transformation type Polynomial 1."),
    ("poly2d", {"degree": 3}, "qgis-points", "has the transformation type Polynomial 3."),
    ("helmert2d", {}, "qgis-points", "has the transformation type Helmert."),
    ("projective2d", {}, "qgis-points", "has the transformation type Projective."),
    ("tps", {"smoothing": 0.0}, "qgis-points", "has the transformation type Thin Plate Spline."),
    ("tps", {"smoothing": 0.0}, "gcp-vrt", "by gdalwarp -tps.")])
def test_the_transformation_that_makes_the_model_again_is_named(
        model: str, options: dict[str, object], to: str, label: str, tmp_path: Path,
        caplog: pytest.LogCaptureFixture) -> None:
    features = flat()
    if model == "projective2d":
        features = flat(1, noise=0.5)
    elif model == "helmert2d" or options.get("degree") == 1:
        features = flat(1, noise=2.0, along=1400.0 if model == "helmert2d" else 1800.0)
    result = termsel.run("poly-terms", features=features, model=model, options=options,
                         solver="all-terms", criterion="press")
    (level, px, _), = said(result, to, tmp_path / "s.points", caplog)
    assert label in caplog.text
    assert level == logging.INFO
    assert px < 0.2


@pytest.mark.parametrize("model", ["helmert2d", "projective2d"])
def test_qgis_fits_from_the_image_to_the_map_and_comes_as_near(
        model: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    features = flat(1, along=1400.0 if model == "helmert2d" else 1800.0)
    result = termsel.run("poly-terms", features=features, model=model, solver="all-terms",
                         criterion="press")
    (_, px, _), = said(result, "qgis-points", tmp_path / "s.points", caplog)
    rows = np.genfromtxt(tmp_path / "s.points", delimiter=",", skip_header=2)
    rows = rows[rows[:, 4] == 1]
    middle = rows[:, :2].mean(axis=0)
    x, y = ((rows[:, :2] - middle) / 1e3).T
    u, v = rows[:, 2:4].T / 1e3
    one, none = np.ones(len(u)), np.zeros(len(u))
    if model == "helmert2d":  # x = a u - b v + c, y = b u + a v + d
        a, b, c, d = np.linalg.lstsq(np.concatenate([
            np.column_stack([u, -v, one, none]), np.column_stack([v, u, none, one])]),
            np.concatenate([x, y]), rcond=None)[0]
        to_map = np.array([[a, -b, c], [b, a, d], [0.0, 0.0, 1.0]])
    else:
        rows = np.concatenate([
            np.column_stack([u, v, one, none, none, none, -x * u, -x * v, -x]),
            np.column_stack([none, none, none, u, v, one, -y * u, -y * v, -y])])
        to_map = np.linalg.svd(rows)[2][-1].reshape(3, 3)
    places = places_of(result.fit)
    source = np.linalg.inv(to_map) @ np.column_stack(
        [(places[:, :2] - middle) / 1e3, np.ones(len(places))]).T
    across, up = 1e3 * source[:2] / source[2]
    apart = np.column_stack([-up - 0.5, across - 0.5]) - result.project(places)
    assert px == pytest.approx(np.hypot(*apart.T).max(), rel=0.05, abs=0.01)
    assert px < 0.2


@pytest.mark.parametrize(("model", "options", "tps"), [
    ("projective2d", {}, False), ("tps", {"smoothing": 0.05}, True)])
def test_the_deviation_of_gcps_is_that_of_gdal(
        model: str, options: dict[str, object], tps: bool, tmp_path: Path,
        caplog: pytest.LogCaptureFixture) -> None:
    features = flat(3)
    if not tps:  # nine points of a tilted photo are too few for the order 3
        points = flat(1, noise=0.0).points.take(np.arange(9))
        east = (points.ground[:, :1] - 600_000.0) / 1500.0
        features = features.with_(points=replace(points, image=points.image / (1 + 0.06 * east)))
    result = termsel.run("poly-terms", features=features, model=model, options=options,
                         solver="all-terms", criterion="press")
    (_, px, metres), = said(result, "gcp-vrt", tmp_path / "s.vrt", caplog)
    assert ("-tps." if tps else "-order 2.") in caplog.text
    places = places_of(result.fit)
    near, far = (np.hypot(*(by_gdal(tmp_path / "s.vrt", places, one) - result.project(places)).T)
                 for one in (tps, not tps))  # GDAL's polynomial is of the order 2
    assert px == pytest.approx(near.max(), rel=0.06)
    assert far.max() > px > 0.05
    assert metres == pytest.approx(px, rel=0.4)  # a pixel of about 1 m


def test_heights_that_a_transformation_ignores_are_told(
        relief: termsel.Result, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    for to in ("gcp-vrt", "qgis-points"):
        (level, px, metres), = said(relief, to, tmp_path / to, caplog)
        assert level == logging.WARNING
        assert px > 10
        assert metres == pytest.approx(px, rel=0.2)  # a pixel of 1 m
        assert ", and ignores heights." in caplog.text


def test_the_deviation_of_a_grid_is_that_of_gdal(relief: termsel.Result, tmp_path: Path,
                                                 caplog: pytest.LogCaptureFixture) -> None:
    height = float(relief.fit.ground_box()[0][2])
    for across, warns in ((1, True), (20, False)):
        (level, px, _), = said(relief, "gcp-grid-vrt", tmp_path / "s.vrt", caplog, height=height,
                               across=across)
        lines, samples = ((np.arange(across) + 0.5) * (size - 1) / across
                          for size in relief.features.image_size)
        image = np.stack(np.meshgrid(lines, samples, indexing="ij"), axis=-1).reshape(-1, 2)
        ground = relief.locate(image, height)
        apart = np.hypot(*(by_gdal(tmp_path / "s.vrt", ground) - image).T)
        assert px == pytest.approx(apart.max(), rel=0.05)
        assert (level == logging.WARNING) == warns == (px > 1)


def test_level_ground_costs_what_is_said(relief: termsel.Result, tmp_path: Path,
                                         caplog: pytest.LogCaptureFixture) -> None:
    first, second = said(relief, "geolocation-vrt", tmp_path / "s.vrt", caplog)
    assert first[0] == logging.WARNING
    places = places_of(relief.fit)
    level = places * [1, 1, 0] + [0, 0, relief.fit.ground_box()[0][2]]
    apart = np.hypot(*(relief.project(level) - relief.project(places)).T)
    assert first[1] == pytest.approx(apart.max(), rel=0.05)
    assert second[:2] == (logging.INFO, pytest.approx(0, abs=0.1))


@pytest.mark.slow
def test_an_rpc_that_is_far_from_the_model_warns(tmp_path: Path, caplog: pytest.LogCaptureFixture,
                                                 ) -> None:
    exact = termsel.run("rfm-terms", model="poly3d", solver="all-terms", criterion="press")
    for to in ("rpb", "rpc-txt", "rpc-vrt"):
        (level, px, metres), = said(exact, to, tmp_path / "s.RPB", caplog)
        assert level == logging.INFO
        assert max(px, metres) < 1e-5
    # A polynomial of the sixth degree bends more than an RPC can.
    bent = termsel.run("poly-terms", model="poly2d", solver="all-terms", criterion="press",
                       options={"degree": 6, "max_share": 1.0})
    (level, px, _), = said(bent, "rpc-txt", tmp_path / "s_RPC.TXT", caplog)
    rpc = termsel.read_rpc(tmp_path / "s_RPC.TXT")
    places = places_of(bent.fit)
    apart = np.hypot(*(rpc.project(places) - bent.project(places)).T)
    assert px == pytest.approx(apart.max(), rel=0.05)
    assert (level == logging.WARNING) == (px > 1)


def test_a_vrt_without_an_image_holds_all_features(tmp_path: Path,
                                                   caplog: pytest.LogCaptureFixture) -> None:
    features = replace(simulate_scene("ikonos-hamedan", n_lines=0), image_size=None)
    result = termsel.run("rfm-terms", features=features, model="affine", solver="all-terms",
                         criterion="press")
    lines, samples = (int(value) + 1 for value in features.points.image.max(axis=0))
    with caplog.at_level(logging.WARNING, logger="termsel"):
        termsel.export(result, "rpc-vrt", tmp_path / "s.vrt")
    assert ("Warning: the size of the image is not known. The file says "
            f"{lines} lines and {samples} samples, which hold all points; image=FILE"
            ) in caplog.text
    assert f'rasterXSize="{samples}" rasterYSize="{lines}"' in (tmp_path / "s.vrt").read_text()


def test_a_format_that_cannot_hold_a_result_says_what_it_needs(relief: termsel.Result,
                                                               tmp_path: Path) -> None:
    with pytest.raises(termsel.TermselError, match=r"needs control lines\. Formats that do: rpb"):
        termsel.export(relief, "lines-csv", tmp_path / "s.csv")


def test_an_rpc_is_not_a_file_of_features(relief: termsel.Result, tmp_path: Path) -> None:
    for to in ("rpb", "rpc-txt"):
        termsel.export(relief, to, tmp_path / "s.x", overwrite=True)
        with pytest.raises(termsel.TermselError, match="contains an RPC and no control points"):
            termsel.read(tmp_path / "s.x")


@pytest.mark.slow
def test_every_format_says_its_deviation_or_that_it_holds_measurements(
        relief: termsel.Result, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    names = [entry.name for entry in registry().entries("writers")]
    for name in names:
        if not registry().get("writers", name)().accepts(relief):
            assert name in ("lines-csv", "georeference-annotation", "ozi-map")
            continue
        if name in ("stac-item", "iso19157-xml", "iso19157-json", "fgdc-xml"):
            # They say where the image lies and how accurately, not how it is transformed.
            continue
        if name in MEASURED:
            assert said(relief, name, tmp_path / f"{name}.x", caplog) == []
            assert f"{name} contains the measurements and their residuals, not" in caplog.text
        elif name in POINTS:
            assert said(relief, name, tmp_path / f"{name}.x", caplog) == []
            assert f"{name} contains the control points, not the model" in caplog.text
        elif name in CHECKED:
            assert said(relief, name, tmp_path / f"{name}.x", caplog) == []
            assert f"{name} holds 48 control and" in caplog.text
        else:
            assert said(relief, name, tmp_path / f"{name}.vrt", caplog)


@pytest.mark.slow
def test_points_above_each_other_have_no_spline(tmp_path: Path,
                                                caplog: pytest.LogCaptureFixture) -> None:
    scene = simulate_scene("ikonos-hamedan", n_points=12).points
    ground, image = scene.ground.copy(), scene.image.copy()
    ground[1] = ground[0] + [0, 0, 30]
    image[1] = scene_truth("ikonos-hamedan").sensor.project(ground[1:2])[0]
    features = FeatureSet(replace(scene, ground=ground, image=image, roles=("control",) * 12),
                          crs="EPSG:4979")
    result = termsel.run(features=features)
    for to in ("qgis-points", "gcp-vrt"):
        termsel.export(result, to, tmp_path / to)
        assert (tmp_path / to).exists()
        assert f"{to}: no thin plate spline goes through these GCPs" in caplog.text


def test_very_many_gcps_do_not_fill_the_memory(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    assert deviation._SPLINED == 5000
    monkeypatch.setattr(deviation, "_SPLINED", 1000)  # so many take a second to fit
    rng = np.random.default_rng(1)
    image = rng.uniform(0, 8000, (1001, 2))
    ground = np.column_stack([6e5 + image[:, 1], 4e6 - image[:, 0], np.full(len(image), np.nan)])
    points = Points(tuple(map(str, range(len(image)))), image + rng.normal(0, 0.3, image.shape),
                    ground, None, ("control",) * len(image))
    many = termsel.run("poly-terms", features=FeatureSet(
        points, crs="EPSG:32633", image_size=(8000, 8000)), model="poly2d",
        options={"degree": 1}, solver="all-terms", criterion="press")
    for to in ("gcp-vrt", "qgis-points"):
        assert said(many, to, tmp_path / "many", caplog)[0][1] < 0.02
        assert "through more than 1,000 GCPs is not tried" in caplog.text
