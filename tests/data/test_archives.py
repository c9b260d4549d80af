"""Which raster a zip, a folder, or a place in a zip means."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rasterio")

import rasterio

import termsel
from termsel import FeatureSet, Points, TermselError
from termsel.data.archives import raster_in
from termsel.formats.pictures import picture_of
from termsel.formats.vrt import vrt_text

pytestmark = pytest.mark.filterwarnings("ignore:Dataset has no geotransform")


def image(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    lines, samples = np.mgrid[:60, :80]
    with rasterio.open(path, "w", driver="GTiff", width=80, height=60, count=1,
                       dtype="uint8") as raster:
        raster.write((lines + samples).astype(np.uint8), 1)
    return path


def product(folder: Path, *names: str) -> Path:
    safe = folder / "S1A_IW_GRDH.SAFE"
    (safe / "preview").mkdir(parents=True)
    for name in names:
        image(safe / "measurement" / name)
    return safe


def zipped(folder: Path, archive: Path) -> Path:
    with zipfile.ZipFile(archive, "w") as packed:
        for file in sorted(folder.rglob("*")):
            packed.write(file, file.relative_to(folder.parent))
    return archive


def test_the_only_raster_of_a_folder_or_zip_is_meant(tmp_path: Path) -> None:
    safe = product(tmp_path, "vv.tiff")
    assert raster_in(safe) == safe / "measurement/vv.tiff"
    archive = zipped(safe, tmp_path / "a.zip")
    for given in (archive, archive / safe.name / "measurement/vv.tiff"):
        with termsel.open_raster(raster_in(given)) as raster:
            assert raster.shape == (60, 80)


def test_of_several_rasters_one_must_be_named(tmp_path: Path) -> None:
    safe = product(tmp_path, "vh.tiff", "vv.tiff")
    archive = zipped(safe, tmp_path / "a.zip")
    for given in (safe, archive):
        with pytest.raises(TermselError, match=r"2 rasters in it: .*vh\.tiff, .*vv\.tiff") as said:
            raster_in(given)
        assert str(given) in str(said.value.hint)


def test_what_has_no_raster_is_refused(tmp_path: Path) -> None:
    archive = zipped(product(tmp_path), tmp_path / "a.zip")
    with pytest.raises(TermselError, match="no TIFF"):
        raster_in(archive)
    other = tmp_path / "b.tif"
    assert raster_in(other) == other
    with zipfile.ZipFile(tmp_path / "up.zip", "w") as packed:
        packed.writestr("../a.tif", b"")
    with pytest.raises(TermselError, match="no TIFF"):
        raster_in(tmp_path / "up.zip")


def test_a_virtual_raster_of_an_image_in_a_zip_has_its_pixels(tmp_path: Path) -> None:
    safe = product(tmp_path, "vv.tiff")
    picture = picture_of(raster_in(zipped(safe, tmp_path / "a.zip")))
    (tmp_path / "a.vrt").write_text(vrt_text(picture, tmp_path))
    with termsel.open_raster(tmp_path / "a.vrt") as raster:
        assert raster.read(1)[3, 4] == 7


@pytest.mark.slow
def test_an_image_in_a_zip_is_rectified_as_on_disk(tmp_path: Path) -> None:
    safe = product(tmp_path, "vv.tiff")
    archive = zipped(safe, tmp_path / "a.zip")
    rng = np.random.default_rng(0)
    places = rng.uniform(0, [59, 79], (12, 2))
    ground = np.column_stack([5e5 + 10 * places[:, 1], 4e6 - 10 * places[:, 0], np.zeros(12)])
    result = termsel.run("poly-terms", model="poly2d", solver="all-terms", criterion="press",
                         options={"degree": 1}, features=FeatureSet(
                             Points(tuple(map(str, range(12))), places, ground),
                             crs="EPSG:32631", image_size=(60, 80)))
    maps = []
    for given in (safe / "measurement/vv.tiff", archive):
        termsel.rectify(result, given, tmp_path / "map.tif", height=0.0, overwrite=True)
        with rasterio.open(tmp_path / "map.tif") as made:
            maps.append(made.read())
    np.testing.assert_array_equal(*maps)
