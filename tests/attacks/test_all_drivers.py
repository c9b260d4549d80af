"""In a program that keeps all of GDAL's drivers, the list alone reads a stranger's files."""

from __future__ import annotations

import multiprocessing
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import termsel
from termsel import TermselError, open_raster
from termsel.core.files.drivers import RASTER_DRIVERS, VECTOR_DRIVERS
from termsel.data import distant_rasters
from termsel.data.distant_rasters import DistantRaster
from termsel.toolkit import with_dataset
from tests.attacks.conftest import SECRET
from tests.attacks.files import auxiliary, image, isis, vrt

rasterio = pytest.importorskip("rasterio")


@pytest.fixture
def importable(monkeypatch: pytest.MonkeyPatch) -> None:
    """The functions of this module can be called in the other process, too."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1]))
    distant_rasters._raster_helper.cache_clear()


def drivers_there(_dataset: Any) -> set[str]:
    with rasterio.Env() as env:
        return set(env.drivers())


def pictures(folder: Path) -> dict[str, Path]:
    """Return rasters of several files."""
    from rasterio.shutil import copy

    for name in "abc":
        image(folder / f"{name}.tif")
    image(folder / "a.tif.ovr", 30)
    (folder / "b.tif.aux.xml").write_text("<PAMDataset></PAMDataset>")
    (folder / "c.vrt").write_text(vrt("c.tif", 1))
    (folder / "d.vrt").write_text(vrt("c.vrt", 1))
    copy(folder / "c.tif", folder / "e.bil", driver="ENVI")
    return {"overviews": folder / "a.tif", "auxiliary": folder / "b.tif", "vrt": folder / "c.vrt",
            "nested": folder / "d.vrt", "header": folder / "e.bil"}


@pytest.mark.usefixtures("importable")
@pytest.mark.parametrize("kind", ["overviews", "auxiliary", "vrt", "nested", "header"])
def test_several_files_are_read_where_the_other_drivers_are_off(kind: str, folder: Path) -> None:
    assert {"MRF", "ISIS3", "netCDF"} <= drivers_there(None)
    with open_raster(pictures(folder)[kind]) as raster:
        assert drivers_there(None) > with_dataset(raster, drivers_there)
        assert with_dataset(raster, drivers_there) <= {*RASTER_DRIVERS, *VECTOR_DRIVERS, "MEM",
                                                       "Memory"}
        with rasterio.open(raster.name) as expected:
            assert (raster.read() == expected.read()).all()
            assert (raster.shape, raster.crs, raster.transform, raster.dtypes) == (
                expected.shape, expected.crs, expected.transform, expected.dtypes)
            assert list(raster.block_windows(1)) == list(expected.block_windows(1))
            masked = raster.read(1, masked=True, out_shape=(7, 7))
            assert (masked == expected.read(1, masked=True, out_shape=(7, 7))).all()
    assert {"MRF", "ISIS3", "netCDF"} <= drivers_there(None)


def test_one_file_is_read_here_by_a_driver_of_the_list(folder: Path, victim: Path) -> None:
    with open_raster(image(folder / "a.tif")) as raster:
        assert isinstance(raster, rasterio.io.DatasetReader)
    (folder / "b.bmp").write_text("BM = 1\n" + isis("../victim/kept.txt"))
    with pytest.raises(TermselError):
        open_raster(folder / "b.bmp").__enter__()


LABELS = {
    # Labels and headers that name other bytes, or lie next to them, none of them on a list of
    # texts that termsel knows.
    "eir": "IMAGINE_RAW_FILE\nPIXEL_FILES @V\nWIDTH 60\nHEIGHT 60\nNUM_LAYERS 1\nDATATYPE U8\n",
    "snodas": "Format version: NOHRSC GIS/RS raster file v1.1\nData file pathname: @V\n"
              "Number of columns: 60\nNumber of rows: 60\n",
    "ndf": "NDF_REVISION=2;\nPIXELS_PER_LINE=60;\nLINES_PER_DATA_FILE=60;\nNUMBER_OF_BANDS_IN_"
           "VOLUME=1;\nBITS_PER_PIXEL=8;\nBAND1_FILENAME=@V;\nEND_OF_HDR;\n",
    "vicar": "LBLSIZE=120 FORMAT='BYTE' TYPE='IMAGE' ORG='BSQ' NL=6 NS=6 NB=1 RECSIZE=6 NBB=0 ",
    "isce": "<imageFile><property name='WIDTH'><value>60</value></property></imageFile>"}


@pytest.mark.parametrize("label", sorted(LABELS))
@pytest.mark.parametrize("magic", ["", "BM", "GIF8", "II*\0", "MM\0*", "NITF", "ncols 6\n"])
def test_labels_of_other_formats(label: str, magic: str, folder: Path, victim: Path) -> None:
    """Whatever they begin with, and as a source, overview or mask: no byte of the file leaves."""
    text = magic + LABELS[label].replace("@V", str(victim / "kept.txt"))
    for name in ("a.lbl", "b.tif.ovr", "c.tif.msk", "e.hdr", "N34E048.hgt"):
        (folder / name).write_text(text)
    image(folder / "b.tif")
    image(folder / "c.tif")
    (folder / "a.vrt").write_text(vrt("a.lbl", 1))
    (folder / "h.vrt").write_text(vrt("N34E048.hgt", 1))
    for name in ("a.lbl", "a.vrt", "b.tif", "c.tif", "h.vrt", "N34E048.hgt"):
        try:
            with open_raster(folder / name) as raster:
                pixels = [raster.read(1), raster.read_masks(1, out_shape=(7, 7))]
        except TermselError:
            continue
        for values in pixels:
            assert SECRET[:12].encode() not in np.ascontiguousarray(values).tobytes()


@pytest.mark.skipif(sys.platform == "win32", reason="there are no such files")
@pytest.mark.parametrize("named", ["/dev/zero", ":::BASE:::pipe", "@F/pipe"])
def test_overviews_without_end(named: str, folder: Path, typed) -> None:
    """A TIFF in a mosaic says that its overviews are in a pipe, which GDAL would wait for."""
    os.mkfifo(folder / "pipe")
    path = image(folder / "a.tif")
    with rasterio.open(path, "r+") as raster:
        raster.update_tags(ns="OVERVIEWX", OVERVIEW_FILE=named.replace("@F", str(folder)))
    path.write_bytes(path.read_bytes().replace(b'domain="OVERVIEWX"', b'domain="OVERVIEWS" '))
    (folder / "a.vrt").write_text(vrt(path))
    with pytest.raises(TermselError, match="pipe or a device"):
        open_raster(folder / "a.vrt").__enter__()
    if named == "/dev/zero":  # the same in a process of termsel
        done = typed("check", "a.vrt")
        assert done.returncode == 2
        assert "pipe or a device" in done.stderr
    (folder / "a.vrt").unlink()
    path.unlink()


@pytest.mark.skipif(sys.platform == "win32", reason="there are no such files")
@pytest.mark.parametrize("argument", ["gain_dataset_filename_1", "offset_dataset_filename_1"])
def test_steps_of_a_virtual_raster_that_wait_for_a_pipe(argument: str, folder: Path) -> None:
    os.mkfifo(folder / "pipe")
    image(folder / "a.tif")
    (folder / "a.vrt").write_text(
        '<VRTDataset subClass="VRTProcessedDataset"><Input><SourceFilename relativeToVRT="1">a.tif'
        '</SourceFilename></Input><ProcessingSteps><Step name="s"><Algorithm>LocalScaleOffset'
        f'</Algorithm><Argument name="{argument}">{folder / "pipe"}</Argument></Step>'
        "</ProcessingSteps></VRTDataset>")
    with pytest.raises(TermselError, match="pipe or a device"):
        open_raster(folder / "a.vrt").__enter__()


def test_a_raster_apart_says_what_is_wrong_with_it(folder: Path) -> None:
    path = image(folder / "a.tif", 600, compress="deflate")
    content = path.read_bytes()
    path.write_bytes(content[:len(content) // 2] + b"\0" * (len(content) - len(content) // 2))
    (folder / "a.vrt").write_text(vrt("a.tif", 1).replace('"60"', '"600"'))
    with pytest.raises(TermselError, match="cannot be read: it is incomplete or damaged"), \
            open_raster(folder / "a.vrt") as raster:
        raster.read(1)
    image(folder / "b.tif")
    (folder / "b.vrt").write_text(vrt("b.tif", 1))
    with open_raster(folder / "b.vrt") as raster:
        with pytest.raises(AttributeError):
            raster.nothing_of_the_kind  # noqa: B018
        with pytest.raises(IndexError):
            raster.read(9)
        with open_raster("b.vrt") as another:
            assert (another.read(1) == raster.read(1)).all()
        assert raster.read(1).any()
    with pytest.raises(rasterio.errors.RasterioIOError):
        raster.read(1)


def test_relative_names_count_from_where_the_raster_was_opened(
        folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    image(folder / "a.tif")
    (folder / "a.vrt").write_text(vrt("a.tif", 1))
    with open_raster("a.vrt") as raster:
        monkeypatch.chdir(folder.parent)
        assert isinstance(raster, DistantRaster)
        assert raster.read(1).any()


def _read_in_a_fork(path: Path, answers: Any) -> None:
    with open_raster(path) as raster:
        answers.put(int(raster.read(1).sum()))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_process_that_is_forked_has_a_helper_of_its_own(folder: Path) -> None:
    image(folder / "a.tif")
    (folder / "a.vrt").write_text(vrt("a.tif", 1))
    with open_raster(folder / "a.vrt") as raster:
        total = int(raster.read(1).sum())
        context = multiprocessing.get_context("fork")
        answers = context.Queue()
        child = context.Process(target=_read_in_a_fork, args=(folder / "a.vrt", answers))
        child.start()
        assert answers.get(timeout=60) == total
        child.join(60)
        assert int(raster.read(1).sum()) == total


def test_auxiliary_xml_that_names_overviews(folder: Path, victim: Path) -> None:
    """Through a link they lead elsewhere, and only a raster of the list is read there."""
    path = image(folder / "a.tif")
    Path(f"{path}.aux.xml").write_text(auxiliary(victim / "kept.txt"))
    with pytest.raises(TermselError):
        open_raster(path).__enter__()


def test_a_map_is_made_by_the_drivers_of_the_list(folder: Path, made_result: Path) -> None:
    """Warping, too, takes place where the other drivers are off, and gives the same map."""
    result = termsel.read_result(made_result)
    path = image(folder / "scene.tif")
    termsel.rectify(result, path, folder / "map.tif", height=30.0)
    (folder / "scene.tif.aux.xml").write_text("<PAMDataset></PAMDataset>")
    termsel.rectify(result, path, folder / "same.tif", height=30.0)
    with rasterio.open(folder / "map.tif") as expected, rasterio.open(folder / "same.tif") as made:
        assert expected.read(1).any()
        assert (made.read() == expected.read()).all()
