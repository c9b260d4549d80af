"""A file of a stranger asks no server, whatever it names; rasterio was imported before termsel."""

from __future__ import annotations

import shutil
from contextlib import suppress
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest

import termsel
from termsel import TermselError, open_raster
from tests.attacks.files import auxiliary, image, vrt, wms, zipped

rasterio = pytest.importorskip("rasterio")

HIDDEN = "/vsicurl?proxy=&max_retry=0&url=@URL/@N.tif"
NAMES = (HIDDEN, "/vsicurl/@URL/@N.tif", "@URL/@N.tif", "/vsicurl_streaming/@URL/@N.tif",
         "/vsicached?file=%2Fvsicurl%2F@URL%2F@N.tif", "/vsicached?file=/vsicurl/@URL/@N.tif",
         "/vsizip//vsicurl/@URL/@N.zip/a.tif", "/vsisubfile/0_9,/vsicurl/@URL/@N.tif",
         "/vsicurl?header_file=@KEPT&url=@URL/@N.tif", "/vsis3/bucket/@N.tif",
         "/vsiwebhdfs/@URL/@N.tif", "vrt:///vsicurl/@URL/@N.tif?bands=1",
         'NETCDF:"@URL/@N.nc":x', "GTIFF_DIR:1:/vsicurl/@URL/@N.tif", "WMS:@URL/@N?",
         "WCS:@URL/@N", "WMTS:@URL/@N", "/vsigzip//vsicurl/@URL/@N.gz",
         "DERIVED_SUBDATASET:AMPLITUDE:/vsicurl/@URL/@N.tif")
WRAPPED = {
    "plain": lambda name: vrt(name),
    "behind blanks": lambda name: vrt(name, before=" " * 9000),
    "behind a comment": lambda name: vrt(name, before=f"<!-- {'x' * 5000} -->"),
    "as characters": lambda name: vrt(name).replace("/vsi", "&#x2f;vsi").replace(
        "http", "&#104;ttp"),
    "as CDATA": lambda name: vrt("@").replace("@", f"<![CDATA[{name}]]>"),
    "inline": lambda name: vrt(vrt(name)),
    "not well-formed": lambda name: vrt(name, more="<a b>"),
    "entity": lambda name: vrt("@").replace("@", "&x;").join(
        [f'<!DOCTYPE VRTDataset [<!ENTITY x "{name.replace("&", "&amp;")}">]>', ""]),
    "kernel": lambda name: vrt(name, element="KernelFilteredSource"),
    "warped": lambda name: (
        '<VRTDataset subClass="VRTWarpedDataset" rasterXSize="60" rasterYSize="60"><VRTRasterBand '
        'dataType="Byte" band="1" subClass="VRTWarpedRasterBand"/><GDALWarpOptions><SourceDataset>'
        f"{name.replace('&', '&amp;')}</SourceDataset></GDALWarpOptions></VRTDataset>"),
}


def read(path: Path) -> None:
    """Read all of a raster that GDAL may open, overviews as well."""
    with open_raster(path) as raster:
        raster.overviews(1)
        raster.read(1, out_shape=(7, 7))
        raster.read(1)


def filled(text: str, server, victim: Path) -> str:
    """Put in an address that nobody was asked for before, and a file of somebody else."""
    for mark, value in (("@URL", server.url), ("@KEPT", str(victim / "kept.txt")),
                        ("@N", np.random.default_rng().bytes(6).hex())):
        text = text.replace(mark, value)
    return text


@pytest.mark.parametrize("wrapped", WRAPPED)
def test_a_virtual_raster(wrapped: str, folder: Path, server, victim: Path) -> None:
    for number, name in enumerate(NAMES):
        path = folder / f"{number}.vrt"
        path.write_text(filled(WRAPPED[wrapped](name), server, victim))
        with pytest.raises(TermselError):
            read(path)
    assert server.requests == []


@pytest.mark.parametrize("before", ["", " "])
@pytest.mark.parametrize("start", ["/vsicurl/@URL/@N.tif?", '<VRTDataset a="/vsicurl/@URL/@N.tif'])
def test_names_longer_than_those_of_files(start: str, before: str, folder: Path, server,
                                          victim: Path) -> None:
    """Of an attribute that is not known to name a file: any may be one in a later GDAL."""
    name = quoteattr(before + filled(start, server, victim) + "x" * 5000)
    path = folder / "long.vrt"
    path.write_text(f'<VRTDataset rasterXSize="60" rasterYSize="60"><VRTRasterBand dataType="Byte" '
                    f'band="1"><Pixels name={name}/></VRTRasterBand></VRTDataset>')
    with pytest.raises(TermselError):
        read(path)
    assert server.requests == []


@pytest.mark.parametrize("name", NAMES)
def test_chains(name: str, folder: Path, server, victim: Path) -> None:
    """Through further rasters, archives, overviews, masks and auxiliary files."""
    name = filled(name, server, victim)
    (folder / "inner.vrt").write_text(vrt(name))
    zipped(folder / "in.zip", "in.vrt", vrt(name))
    (folder / "nested.vrt").write_text(vrt("inner.vrt", 1))
    (folder / "zip.vrt").write_text(vrt(f"/vsizip/{folder}/in.zip/in.vrt"))
    (folder / "curly.vrt").write_text(vrt(f"/vsizip/{{{folder}/in.zip}}/in.vrt"))
    for near, text in (("a.tif.ovr", vrt(name)), ("b.tif.msk", vrt(name)),
                       ("c.tif.aux.xml", auxiliary(name.replace("&", "&amp;"))),
                       ("d.ovr", vrt(name)), ("e.tif.ovr", wms(server.url))):
        image(folder / f"{near[0]}.tif")
        (folder / near).write_text(text)
    (folder / "of-a.vrt").write_text(vrt("a.tif", 1))
    (folder / "of-c.vrt").write_text(vrt("c.tif", 1))
    with rasterio.open(image(folder / "f.tif"), "r+") as raster:
        raster.update_tags(ns="OVERVIEWS", OVERVIEW_FILE=name)
    for path in ("nested.vrt", "zip.vrt", "curly.vrt", "a.tif", "b.tif", "c.tif", "d.tif", "e.tif",
                 "f.tif", "of-a.vrt", "of-c.vrt"):
        with pytest.raises(TermselError):
            read(folder / path)
    assert server.requests == []


def test_an_index_of_tiles(folder: Path, server) -> None:
    pyogrio = pytest.importorskip("pyogrio")
    shapely = pytest.importorskip("shapely")
    for name in ("dem.gti.gpkg", "dem.gpkg"):
        pyogrio.raw.write(folder / name, np.array([shapely.to_wkb(shapely.box(-56, -35, -55, -34))],
                                                  object),
                          [np.array([f"/vsicurl/{server.url}/x.tif"], object)], ["location"],
                          geometry_type="Polygon", crs="EPSG:4326", driver="GPKG", layer="tiles")
        with pytest.raises(TermselError, match="GeoPackage"):
            read(folder / name)
    (folder / "dem.gti").write_text("<GDALTileIndexDataset><IndexDataset>dem.gpkg</IndexDataset>"
                                    "</GDALTileIndexDataset>")
    with pytest.raises(TermselError, match="GTI"):
        read(folder / "dem.gti")


@pytest.mark.slow_cases(
    "check plain.tif", "match-points plain.tif --reference x.vrt --start corners -o a.csv",
    "rectify @R plain.tif --dem x.vrt -o map.tif", "rectify @R x.vrt --height 3 -o map.tif",
    "report @R --image x.vrt -o page.html")
@pytest.mark.parametrize("words", [
    ("rectify", "@R", "plain.tif", "--dem", "x.vrt", "-o", "map.tif"),
    ("rectify", "@R", "x.vrt", "--height", "3", "-o", "map.tif"),
    ("report", "@R", "--image", "x.vrt", "-o", "page.html"),
    ("check", "x.vrt"), ("check", "blanks.vrt"), ("check", "plain.tif"),
    ("match-points", "plain.tif", "--reference", "x.vrt", "--start", "corners", "-o", "a.csv")],
    ids=" ".join)
def test_commands(words: tuple[str, ...], folder: Path, server, made_result: Path, typed) -> None:
    """Each in a process of its own, and with the programs that it starts."""
    image(folder / "plain.tif")
    (folder / "plain.tif.aux.xml").write_text(auxiliary(f"/vsicurl/{server.url}/c.ovr"))
    (folder / "x.vrt").write_text(vrt(HIDDEN.replace("@URL", server.url)))
    (folder / "blanks.vrt").write_text(vrt(f"/vsicurl/{server.url}/y.tif", before=" " * 80))
    done = typed(*(str(made_result) if word == "@R" else word for word in words))
    assert done.returncode == 2
    assert "which is refused" in done.stderr


@pytest.mark.parametrize("command", [
    ("gdalinfo", "-stats"), ("gdaltransform",), ("otbcli_ReadImageInfo", "-in")],
    ids=lambda command: command[0])
def test_programs_that_are_started_refuse_what_termsel_would_not_see(
        command: tuple[str, ...], folder: Path, server) -> None:
    """Each program itself, under the variables that `termsel check` gives to it."""
    if shutil.which(command[0]) is None:
        pytest.skip(f"{command[0]} is not installed")
    pytest.importorskip("termsel_formats")
    from termsel_formats.check.base import NoAnswer, answer

    for number, name in enumerate(NAMES[:6]):
        path = folder / f"{number}.vrt"
        path.write_text(vrt(name.replace("@URL", server.url)))
        with suppress(NoAnswer):
            answer([shutil.which(command[0]), *command[1:], str(path)], "1 1 1\n")


def test_names_that_a_user_types(folder: Path, server) -> None:
    """Archives are read as documented; what is on a server only where that is allowed."""
    image(folder / "a.tif")
    shutil.make_archive("packed", "zip", folder, "a.tif")
    read(Path(f"/vsizip/{folder}/packed.zip/a.tif"))
    read(Path("/vsizip/packed.zip/a.tif"))
    (folder / "in-zip.vrt").write_text(vrt(f"/vsizip/{folder}/packed.zip/a.tif"))
    read(folder / "in-zip.vrt")
    with pytest.raises(TermselError, match="--allow-remote"):
        read(Path(f"/vsicurl/{server.url}/a.tif"))


def test_addresses_that_a_user_types_reach_the_server(folder: Path, running) -> None:
    """Paths lose the second slash of an address."""
    running.forget()
    for name in ("/vsicurl/@U/typed.tif", "@U/typed-too.tif"):
        with termsel.allow_remote(), pytest.raises(TermselError):
            read(Path(name.replace("@U", running.url)))
    assert {name.rpartition("/")[2] for name in running.requests} >= {"typed.tif", "typed-too.tif"}


def test_requests_are_made_where_the_user_allows_them(folder: Path, running) -> None:
    running.forget()
    (folder / "x.vrt").write_text(vrt(f"/vsicurl/{running.url}/allowed.tif"))
    with termsel.allow_remote(), suppress(TermselError):
        read(folder / "x.vrt")
    assert running.requests
