"""Geolocation arrays as bands, as files and in metadata, thinned to what the geometry needs."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import termsel
from termsel import TermselError

pytest.importorskip("termsel_formats", reason="termsel-formats is not installed")
rasterio = pytest.importorskip("rasterio")

FloatArray = NDArray[np.float64]
LINES, SAMPLES = 240, 300


def places(lines: FloatArray, samples: FloatArray, bend: float = 0.0) -> FloatArray:
    """Return longitude, latitude and height (3, ...) of image places; a bend is of 40 px."""
    height = 400.0 + 300.0 * np.sin(samples / 23.0) * np.cos(lines / 31.0)
    aside = samples + height / 40.0 + bend * np.sin(samples / 6.4)
    return np.stack([7.0 + 2e-4 * aside + 3e-5 * lines, 46.0 - 2e-4 * lines + 4e-5 * aside,
                     height])


def written(path: Path, bands: FloatArray, names: tuple[str, ...] = (), **tags: str) -> Path:
    with rasterio.open(path, "w", driver="GTiff", height=bands.shape[1], width=bands.shape[2],
                       count=len(bands), dtype="float64", nodata=-9999.0) as raster:
        raster.write(np.nan_to_num(bands, nan=-9999.0))
        for number, name in enumerate(names, 1):
            raster.set_band_description(number, name)
        if tags:
            raster.update_tags(ns="GEOLOCATION", **tags)
    return path


def whole() -> FloatArray:
    return places(*np.indices((LINES, SAMPLES)).astype(np.float64))


def require_places(features: termsel.FeatureSet, bend: float = 0.0) -> None:
    """Require points at places of the array, each at its own line and sample."""
    lines, samples = features.points.image.T
    expected = places(lines, samples, bend).T
    np.testing.assert_allclose(features.points.ground, expected, atol=1e-9)
    assert len(features.points) < 1200
    assert features.points.image.min(axis=0).max() < 20
    assert "lattice" in termsel.run(features=features).summary()


@pytest.mark.parametrize("names", [("longitude", "latitude", "height"), ("Lon", "Lat", "Altitude")])
def test_bands_of_one_raster(names: tuple[str, ...], tmp_path: Path) -> None:
    features = termsel.read(written(tmp_path / "xyz.tif", whole(), names))
    assert features.crs == "EPSG:4979"
    assert features.image_size == (LINES, SAMPLES)
    require_places(features)


@pytest.mark.parametrize("east", [0.0, 172.98])
def test_arrays_that_mirror_the_ground_are_said(east: float, tmp_path: Path,
                                                caplog: pytest.LogCaptureFixture) -> None:
    """GDAL takes arrays out of netCDF upside down; at 180 degrees longitudes begin anew."""
    bands = whole()
    bands[0] = (bands[0] + east + 180.0) % 360.0 - 180.0
    for array, is_mirrored in ((bands, False), (bands[:, ::-1], True)):
        caplog.clear()
        with caplog.at_level(logging.INFO, logger="termsel"):
            termsel.read(written(tmp_path / "xyz.tif", array, ("longitude", "latitude", "height")))
        assert ("mirrors the ground" in caplog.text) == is_mirrored


def test_files_of_their_own(tmp_path: Path) -> None:
    files = [written(tmp_path / f"{name}.tif", band[None])
             for name, band in zip(("lon", "lat", "h"), whole(), strict=True)]
    features = termsel.read(files[0], latitude=str(files[1]), height=str(files[2]))
    require_places(features)
    plane = termsel.read(files[0], latitude=str(files[1]))
    assert plane.crs == "EPSG:4326"
    assert np.isnan(plane.points.ground[:, 2]).all()


@pytest.mark.parametrize("convention", ["TOP_LEFT_CORNER", "PIXEL_CENTER"])
def test_metadata_that_name_an_array(convention: str, tmp_path: Path) -> None:
    """A place for every fifth line and sample."""
    step = 5.0
    first = 0.5 if convention == "TOP_LEFT_CORNER" else 0.0  # from the outer corner
    shift = first - 0.5 if convention == "TOP_LEFT_CORNER" else step / 2.0 - 0.5
    lines, samples = np.indices((LINES // 5, SAMPLES // 5)) * step + shift
    written(tmp_path / "xyz.tif", places(lines, samples))
    image = tmp_path / "scene.vrt"
    items = {"X_DATASET": "xyz.tif", "X_BAND": "1", "Y_DATASET": "xyz.tif", "Y_BAND": "2",
             "Z_DATASET": "xyz.tif", "Z_BAND": "3", "LINE_OFFSET": str(first),
             "PIXEL_OFFSET": str(first), "LINE_STEP": "5", "PIXEL_STEP": "5",
             "GEOREFERENCING_CONVENTION": convention, "SRS": "EPSG:4326",
             **{f"{axis}_DATASET_RELATIVE_TO_SOURCE": "YES" for axis in "XYZ"}}
    text = "".join(f'<MDI key="{key}">{value}</MDI>' for key, value in items.items())
    image.write_text(f'<VRTDataset rasterXSize="{SAMPLES}" rasterYSize="{LINES}"><Metadata '
                     f'domain="GEOLOCATION">{text}</Metadata><VRTRasterBand dataType="Byte" '
                     'band="1"/></VRTDataset>')
    features = termsel.read(image)
    assert features.image_size == (LINES, SAMPLES)
    require_places(features)


def test_an_array_in_metres_keeps_its_eastings(tmp_path: Path) -> None:
    lines, samples = np.indices((40, 50)).astype(np.float64)
    array = np.stack([4.4e5 + 30.0 * samples, 5.2e6 - 30.0 * lines])
    written(tmp_path / "xy.tif", array)
    path = written(tmp_path / "scene.tif", np.zeros((1, 40, 50)), X_DATASET="xy.tif", X_BAND="1",
                   Y_DATASET="xy.tif", Y_BAND="2", X_DATASET_RELATIVE_TO_SOURCE="YES",
                   Y_DATASET_RELATIVE_TO_SOURCE="YES", SRS="EPSG:32633",
                   GEOREFERENCING_CONVENTION="PIXEL_CENTER")
    features = termsel.read(path, format="geolocation-array")
    assert features.crs == "EPSG:32633"
    lines, samples = features.points.image.T
    np.testing.assert_allclose(features.points.ground[:, 0], 4.4e5 + 30.0 * samples)


def test_a_tie_point_grid_with_its_steps(tmp_path: Path) -> None:
    lines, samples = np.indices((16, 20)) * 16.0 + 8.0
    file = written(tmp_path / "tie.tif", places(lines, samples), ("lon", "lat", "height"))
    require_places(termsel.read(file, array_step="16,16", array_first="8,8"))


def test_a_bent_geometry_takes_more_places_than_a_smooth_one(tmp_path: Path) -> None:
    lines, samples = np.indices((LINES, SAMPLES)).astype(np.float64)
    names = ("longitude", "latitude", "height")
    smooth = termsel.read(written(tmp_path / "smooth.tif", places(lines, samples), names))
    bent = termsel.read(written(tmp_path / "bent.tif", places(lines, samples, 4.0), names))
    assert len(bent.points) > 2 * len(smooth.points)
    assert len(termsel.read(tmp_path / "bent.tif", meshes=5).points) == 36


def test_holes_of_an_array_are_left_out(tmp_path: Path) -> None:
    bands = whole()
    bands[:, :60, :80] = np.nan
    features = termsel.read(written(tmp_path / "a.tif", bands, ("lon", "lat", "height")))
    assert not (features.points.image < [60, 80]).all(axis=1).any()
    np.testing.assert_allclose(features.points.ground, places(*features.points.image.T).T)


@pytest.mark.parametrize(("options", "words"), [
    ({"latitude": "small.tif"}, "other than the array of longitudes"),
    ({"array_step": "16"}, "cannot be '16'"), ({"array_step": "0,1"}, "cannot be '0,1'"),
    ({"array_first": "a,b"}, "cannot be 'a,b'")])
def test_what_does_not_fit_is_refused(options: dict[str, str], words: str, tmp_path: Path,
                                      monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    written(tmp_path / "small.tif", whole()[:1, :10, :10])
    written(tmp_path / "a.tif", whole(), ("lon", "lat", "height"))
    with pytest.raises(TermselError, match=words):
        termsel.read(tmp_path / "a.tif", **options)


def test_arrays_on_a_server_are_not_asked_for(tmp_path: Path) -> None:
    file = written(tmp_path / "a.tif", whole()[:1], X_DATASET="/vsicurl/http://localhost:9/x.tif",
                   X_BAND="1", Y_DATASET="y.tif", Y_BAND="1")
    with pytest.raises(TermselError):
        termsel.read(file, format="geolocation-array")
