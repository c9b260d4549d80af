"""Files for other programs: read back by termsel, and by GDAL where it reads them."""

from __future__ import annotations

import json
import logging
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("termsel_formats", reason="termsel-formats is not installed: "
                    "pip install -e plugins/termsel-formats")
pytest.importorskip("rasterio")

import rasterio

import termsel
from termsel import FeatureSet, Points, Result, TermselError, Writer, export
from termsel.testing import Check, checks
from termsel_formats.points.erdas import ErdasGcpsWriter
from termsel_formats.points.gdal_files import GcpTiff, PamGcpsWriter
from termsel_formats.points.mapinfo import MapInfoTabWriter
from termsel_formats.points.metashape import MetashapeMarkersWriter
from termsel_formats.points.ozi import OziMapWriter
from termsel_formats.points.pci import PciGcpWriter
from termsel_formats.points.pix4d import Pix4dMarksWriter
from termsel_formats.points.world import WorldFileWriter

IDS = ("Kreuzung 1, Süd", 'the "old" mill', *(f"P{i}" for i in range(3, 19)))


def fitted(crs: str = "EPSG:32631", *, heights: bool = True) -> Result:
    """A fit of points on an affine map with noise, in metres or in degrees."""
    rng = np.random.default_rng(7)
    image = rng.uniform(0, [2000, 3000], (18, 2))
    if crs == "EPSG:4979":
        xy = np.column_stack([-70.5 + image[:, 1] * 1e-5, -33.5 - image[:, 0] * 1e-5])
    else:
        xy = np.column_stack([500000 + 2 * image[:, 1], 4000000 - 2 * image[:, 0]])
    z = rng.uniform(100, 120, 18) if heights else np.full(18, np.nan)
    points = Points(IDS, image + rng.normal(0, 0.3, image.shape), np.column_stack([xy, z]),
                    roles=("control",) * 18)
    return termsel.run("poly-terms", features=FeatureSet(points, crs=crs, image_size=(2000, 3000)),
                       model="poly2d", solver="all-terms", criterion="press",
                       options={"degree": 1})


@pytest.fixture(scope="module")
def results() -> tuple[Result, ...]:
    return (fitted(), fitted("EPSG:4979"), fitted(heights=False))


def read_back(name: str, ids: bool, heights: bool, read: dict[str, Any]) -> Any:
    """What a file must hold: the control points of the result, as `termsel.read` reads them."""
    def verify(result: Result, path: Path) -> None:
        found = termsel.read(path, format=name, **(
            read if "crs" not in read else {**read, "crs": result.features.crs}))
        known = result.features.points
        if ids:
            assert found.points.ids == known.ids
        np.testing.assert_allclose(found.points.image, known.image, atol=1e-9)
        np.testing.assert_allclose(found.points.ground[:, :2], known.ground[:, :2], rtol=1e-13)
        if heights:
            np.testing.assert_array_equal(found.points.ground[:, 2], known.ground[:, 2])

    return verify


FORMATS: dict[str, tuple[type[Writer], str, bool, bool, dict[str, Any]]] = {
    "mapinfo-tab": (MapInfoTabWriter, "a.tab", False, False, {}),
    "ozi-map": (OziMapWriter, "a.map", False, False, {}),
    "metashape-markers": (MetashapeMarkersWriter, "a.xml", True, True, {}),
    "erdas-gcps": (ErdasGcpsWriter, "a.txt", True, True, {"crs": ""}),
    "pci-gcp": (PciGcpWriter, "a.gcp", False, True, {"crs": ""}),
    "pam-gcps": (PamGcpsWriter, "a.tif.aux.xml", True, True, {}),
    "gdal-gcps": (GcpTiff, "a.tif", False, True, {})}


@pytest.mark.parametrize("name", sorted(FORMATS))
def test_conforms_and_is_read_back(name: str, results: tuple[Result, ...]) -> None:
    writer, file, ids, heights, read = FORMATS[name]
    for check in checks(writer(), filename=file, results=results,
                        verify=read_back(name, ids, heights, read)):
        check.run()


def suite() -> Iterator[Check]:
    yield from checks(WorldFileWriter(), filename="a.tfw")
    yield from checks(Pix4dMarksWriter(), filename="a.csv")


@pytest.mark.parametrize("check", [pytest.param(one, id=one.name) for one in suite()])
def test_conforms(check: Check) -> None:
    check.run()


@pytest.mark.parametrize("crs", ["EPSG:32631", "EPSG:4979"])
def test_marks_of_pix4d_are_read_back(crs: str, tmp_path: Path) -> None:
    result = fitted(crs)
    export(result, "pix4d-marks", tmp_path / "a.csv", image="IMG_1.JPG")
    assert (tmp_path / "a.csv").read_text().startswith('IMG_1.JPG,"Kreuzung 1, Süd",')
    read = termsel.read(tmp_path / "a.csv", format="pix4d-marks", crs=crs,
                        latitude_first=crs == "EPSG:4979").points
    known = result.features.points
    order = [read.ids.index(name) for name in known.ids]
    np.testing.assert_allclose(read.image[order], known.image, atol=1e-9)
    np.testing.assert_array_equal(read.ground[order], known.ground)


@pytest.mark.parametrize(("name", "file"), [
    ("asp-gcp", "list.gcp"), ("mapinfo-tab", "list.tab"), ("metashape-markers", "list.xml"),
    ("micmac-xml", "list-S2D.xml"), ("odm-gcp-list", "list.txt"), ("ozi-map", "list.map"),
    ("pix4d-marks", "list_marks.csv")])
def test_a_name_of_the_image_that_nothing_states_is_said(
        name: str, file: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    result = fitted()
    export(result, name, tmp_path / file, image="photos/IMG_7.JPG")
    assert "IMG_7.JPG" in (tmp_path / file).read_text("utf-8")
    assert "as nothing states its name" not in caplog.text
    export(result, name, tmp_path / f"other_{file}")
    assert f"other_{file} calls the image other_list" in caplog.text
    assert "as nothing states its name: --image FILE does." in caplog.text


def gdal(path: Path) -> Any:
    if shutil.which("gdalinfo") is None:
        pytest.skip("gdalinfo is not installed")
    return json.loads(subprocess.run(["gdalinfo", "-json", path], check=True, capture_output=True,
                                     text=True).stdout)


def image_of(path: Path, pixels: Any = None) -> None:
    """Write an image of 2000 lines and 3000 samples without georeferencing."""
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning):
        raster = rasterio.open(path, "w", driver="GTiff", width=3000, height=2000, nodata=7,
                               count=1 if pixels is None else len(pixels), dtype="uint8",
                               sparse_ok=True)
    with raster:
        if pixels is not None:
            raster.write(pixels)


@pytest.mark.parametrize(("name", "file", "opened"), [
    ("mapinfo-tab", "scene.tab", "scene.tif"), ("ozi-map", "scene.map", "scene.map"),
    ("pam-gcps", "scene.tif.aux.xml", "scene.tif"), ("gcp-tiff", "gcps.tif", "gcps.tif")])
def test_gdal_reads_the_points(name: str, file: str, opened: str, tmp_path: Path) -> None:
    result = fitted()
    image_of(tmp_path / "scene.tif")
    options: dict[str, Any] = {} if name == "pam-gcps" else {"image": tmp_path / "scene.tif"}
    export(result, name, tmp_path / file, **options)
    gcps = gdal(tmp_path / opened)["gcps"]
    found = gcps["gcpList"]
    known = result.features.points
    np.testing.assert_allclose([[one["line"] - 0.5, one["pixel"] - 0.5] for one in found],
                               known.image, atol=1e-6)
    np.testing.assert_allclose([[one["x"], one["y"]] for one in found], known.ground[:, :2],
                               atol=1e-5)
    assert "UTM zone 31N" in gcps["coordinateSystem"]["wkt"]


def test_gdal_reads_the_world_file(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, logger="termsel")
    result = fitted()
    image_of(tmp_path / "scene.tif")
    export(result, "world-file", tmp_path / "scene.tfw")
    x, right, down_x, y, right_y, down = gdal(tmp_path / "scene.tif")["geoTransform"]
    at = np.array([[0.0, 0.0], [1999.0, 0.0], [0.0, 2999.0], [700.0, 900.0]])
    line, sample = at.T + 0.5
    there = np.column_stack([x + sample * right + line * down_x,
                             y + sample * right_y + line * down])
    np.testing.assert_allclose(there, result.locate(at, np.zeros(4))[:, :2], atol=1e-4)
    said = next(one for one in caplog.messages if one.startswith("world-file"))
    assert said.startswith("world-file: at most 0.001 px")
    assert "A world file does not name its CRS. It is EPSG:32631." in caplog.text


def test_a_world_file_says_how_far_it_is_from_a_model_that_bends(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    rng = np.random.default_rng(3)
    image = np.concatenate([[[0, 0], [2000, 2000]], rng.uniform(0, 2000, (28, 2))])
    ground = np.column_stack([500000 + image[:, 1] + 2e-5 * (image[:, 0] - 1000) ** 2,
                              4000000 - image[:, 0], np.full(30, np.nan)])
    points = Points(tuple(f"P{i}" for i in range(30)), image, ground, roles=("control",) * 30)
    result = termsel.run("poly-terms", features=FeatureSet(points, crs="EPSG:32631"),
                         model="poly2d", solver="all-terms", criterion="press",
                         options={"degree": 2})
    export(result, "world-file", tmp_path / "a.tfw")
    # A parabola of 20 m: at 15 places its best straight line is 12.4 m from either end.
    said = next(one for one in caplog.messages if one.startswith("Warning: world-file"))
    assert float(said.split("at most ")[1].split(" px")[0]) == pytest.approx(12.4, abs=0.5)


def test_the_copy_has_the_pixels_of_the_image(tmp_path: Path) -> None:
    result = fitted()
    pixels = np.random.default_rng(0).integers(0, 255, (2, 2000, 3000), np.uint8)
    image_of(tmp_path / "scene.tif", pixels)
    export(result, "gcp-tiff", tmp_path / "copy.tif", image=tmp_path / "scene.tif")
    with rasterio.open(tmp_path / "copy.tif") as raster:
        np.testing.assert_array_equal(raster.read(), pixels)
        assert raster.nodata == 7
        assert len(raster.gcps[0]) == 18


def test_what_formats_do_not_hold(tmp_path: Path) -> None:
    local = fitted("local")
    for name in ("mapinfo-tab", "ozi-map", "metashape-markers", "pix4d-marks", "pam-gcps",
                 "gcp-tiff"):
        with pytest.raises(TermselError, match=f"the format {name} cannot hold this result"):
            export(local, name, tmp_path / "a.x")
    many = fitted()
    points = many.features.points
    twice = replace(many.features, points=Points(
        points.ids + tuple(f"{name}b" for name in points.ids),
        np.tile(points.image, (2, 1)) + np.repeat([[0], [1]], 18, axis=0),
        np.tile(points.ground, (2, 1)) - np.repeat([[0, 0, 0], [0, 2, 0]], 18, axis=0),
        roles=("control",) * 36))
    result = termsel.run("poly-terms", features=twice, model="poly2d", solver="all-terms",
                         criterion="press", options={"degree": 1})
    with pytest.raises(TermselError, match="at most 30 control points"):
        export(result, "ozi-map", tmp_path / "a.map")
    assert not list(tmp_path.iterdir())
