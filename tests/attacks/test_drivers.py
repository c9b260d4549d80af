"""Reading writes nothing and reads nothing else: a list of drivers, to the end of the chain."""

from __future__ import annotations

import json
import os
import sqlite3
import subprocess
import sys
import zipfile
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

import termsel
from termsel import TermselError, open_raster
from termsel.core.files.drivers import (
    RASTER_DRIVERS,
    VECTOR_DRIVERS,
    drivers_are_off,
    skipped_drivers,
)
from termsel.core.isolation.helper import context_of_workers
from termsel.studies.execution.executors import begin_worker
from termsel.toolkit import open_layer
from tests.attacks.files import (
    auxiliary,
    ers,
    image,
    isis,
    mrf,
    ogr_vrt,
    pds,
    pipeline,
    raw,
    vrt,
    wms,
)

rasterio = pytest.importorskip("rasterio")
pyogrio = pytest.importorskip("pyogrio")

POINT = json.dumps({"type": "FeatureCollection", "features": [
    {"type": "Feature", "properties": {"f": "x"},
     "geometry": {"type": "LineString", "coordinates": [[48.5, 34.8], [48.51, 34.81]]}}]})


def read(path: Path) -> None:
    with open_raster(path) as raster:
        raster.overviews(1)
        raster.read(1, out_shape=(7, 7))
        raster.read(1)


def files_of(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


@pytest.fixture
def rasters(folder: Path, victim: Path, server) -> dict[str, str]:
    """Texts of rasters that write elsewhere, or that read the bytes of any file."""
    source = image(folder / "source.tif")
    return {
        "mrf": mrf(source, victim / "made.bin"), "wms": wms(server.url, victim / "cache"),
        "raw": raw(victim / "kept.txt"), "ers": ers(victim / "kept.txt"),
        "pds": pds(victim / "kept.txt"),
        "indented mrf": "  " + mrf(source, victim / "made.bin"),
        "commented mrf": "<!-- a -->" + mrf(source, victim / "made.bin"),
        "raw in another case": raw(victim / "kept.txt").replace("subClass", "SUBCLASS"),
        "python": vrt(source).replace(
            '<VRTRasterBand dataType="Byte" band="1">', '<VRTRasterBand dataType="Byte" band="1" '
            'subClass="VRTDerivedRasterBand"><PixelFunctionType>f</PixelFunctionType>'
            "<PixelFunctionLanguage>Python</PixelFunctionLanguage><PixelFunctionCode><![CDATA[\n"
            f"open({str(victim / 'made')!r}, 'w')\n]]></PixelFunctionCode>")}


def test_rasters_alone(rasters, folder: Path, victim: Path) -> None:
    for number, text in enumerate(rasters.values()):
        for ending in ("tif", "vrt", "mrf", "ers", "lbl", "img"):
            path = folder / f"{number}.{ending}"
            path.write_text(text)
            before = files_of(folder)
            with pytest.raises(TermselError, match=r"does not open|not opened|that termsel opens"
                                                   r"|not well-formed|remote source"):
                read(path)
            assert files_of(folder) == before


def test_as_part_of_others(rasters, folder: Path, victim: Path) -> None:
    """As source, inline source, overview, mask, or from auxiliary XML."""
    for number, text in enumerate(rasters.values()):
        folder = folder.parent / f"parts {number}"
        folder.mkdir()
        part = folder / "part.dat"
        part.write_text(text)
        whole = {"s.vrt": vrt(part), "i.vrt": vrt(text), "o.tif.ovr": text, "m.tif.msk": text,
                 "x.tif.aux.xml": auxiliary(part), "deep.vrt": vrt("s.vrt", 1),
                 "w.vrt": '<VRTDataset subClass="VRTWarpedDataset" rasterXSize="60" rasterYSize='
                          '"60"><VRTRasterBand dataType="Byte" band="1" subClass='
                          '"VRTWarpedRasterBand"/><GDALWarpOptions><SourceDataset>'
                          f"{part}</SourceDataset></GDALWarpOptions></VRTDataset>"}
        for name, content in whole.items():
            if ".tif" in name:
                image(folder / f"{name[0]}.tif")
            (folder / name).write_text(content)
        before = files_of(folder)
        for name in ("s.vrt", "i.vrt", "o.tif", "m.tif", "x.tif", "deep.vrt", "w.vrt"):
            with pytest.raises(TermselError):
                read(folder / name)
        assert files_of(folder) == before


@pytest.mark.parametrize(("name", "before"), [
    ("a.bmp", "BM = 1\n"), ("a.gif", "GIF8 = 1\n"), ("N34E048.hgt", ""), ("a.bil", ""),
    ("a.dt0", " " * 80 + "UHL1 = 1\n")])
def test_a_label_that_looks_like_pixels(name: str, before: str, folder: Path,
                                        victim: Path) -> None:
    """GDAL asks its drivers in turn, and one that names other files may come before a raw one."""
    (folder / name).write_text(before + isis("../victim/kept.txt"))
    (folder / "a.hdr").write_text("ENVI\nsamples = 60\nlines = 60\nbands = 1\ndata type = 1\n")
    (folder / "a.vrt").write_text(vrt(folder / name))
    with pytest.raises(TermselError, match=r"does not open|that termsel opens"):
        read(folder / "a.vrt")


@pytest.mark.parametrize("named", ["@F/part.mrf", ":::BASE:::part.mrf", ":::BASE:::../stranger/"
                                   "part.mrf"])
@pytest.mark.parametrize("how", ["inside", "next to it"])
def test_overviews_that_a_source_names(how: str, named: str, folder: Path, victim: Path) -> None:
    (folder / "part.mrf").write_text(mrf(image(folder / "source.tif"), victim / "made.bin"))
    named = named.replace("@F", str(folder))
    path = image(folder / "a.tif")
    if how == "inside":
        with rasterio.open(path, "r+") as raster:
            raster.update_tags(ns="OVERVIEWX", OVERVIEW_FILE=named)
        path.write_bytes(path.read_bytes().replace(b'domain="OVERVIEWX"', b'domain="OVERVIEWS" '))
        assert not Path(f"{path}.aux.xml").exists()
    else:
        Path(f"{path}.aux.xml").write_text(auxiliary(named))
    (folder / "a.vrt").write_text(vrt(path))
    for name in ("a.vrt", "a.tif"):
        with pytest.raises(TermselError, match="MRF"):
            read(folder / name)


@pytest.mark.parametrize("kind", ["two of one name", "a.tif.ovr", "a.tif.msk", "a.tif.aux.xml",
                                  "a.tif.OVR", "sub"])
def test_members_of_an_archive(kind: str, folder: Path, victim: Path) -> None:
    source = image(folder / "source.tif")
    part = mrf(source, victim / "made.bin")
    (folder / "part.mrf").write_text(part)
    inner = "sub/a.tif" if kind == "sub" else "a.tif"
    others = {"two of one name": ("./a.tif", part), "sub": ("sub/a.tif.ovr", part),
              "a.tif.aux.xml": (kind, auxiliary(folder / "part.mrf"))}
    with zipfile.ZipFile(folder / "in.zip", "w") as archive:
        archive.writestr(*others.get(kind, (kind, part)))
        archive.write(source, inner)
    name = f"/vsizip/{folder}/in.zip/{inner}"
    (folder / "a.vrt").write_text(vrt(name))
    for path in (folder / "a.vrt", Path(name)):
        with pytest.raises(TermselError, match=r"MRF|two files of one name"):
            read(path)


def test_an_archive_with_overviews_is_read(folder: Path) -> None:
    source = image(folder / "source.tif")
    with rasterio.open(source, "r+") as raster:
        raster.update_tags(note="kept")
    with zipfile.ZipFile(folder / "in.zip", "w") as archive:
        archive.write(source, "maps/a.tif")
        archive.write(image(folder / "half.tif", 30), "maps/a.tif.ovr")
        archive.writestr("maps/a.tif.aux.xml", "<PAMDataset></PAMDataset>")
        archive.writestr("maps/a.vrt", vrt("a.tif", 1))
    (folder / "a.vrt").write_text(vrt(f"/vsizip/{folder}/in.zip/maps/a.vrt"))
    for name in (f"/vsizip/{folder}/in.zip/maps/a.tif", str(folder / "a.vrt")):
        with open_raster(Path(name)) as raster:
            assert raster.read(1).any()


@pytest.mark.parametrize("name", ["CSV:@V", "ENVI:@V", "RAW:@V", "MRF:@V", "ISIS3:@V", "PDF:1:@V",
                                  "DERIVED_SUBDATASET:AMPLITUDE:@V", "HDF5:@V://a", "/vsistdin/",
                                  "/vsisparse/@V", "/vsicrypt/@V", "MEM:::DATAPOINTER=1,PIXELS=9,"
                                  "LINES=9", '{"type": "gdal_streamed_alg"}', "/etc/passwd",
                                  "/dev/zero", "/proc/self/environ", "@V"])
def test_names_of_what_is_no_raster(name: str, folder: Path, victim: Path) -> None:
    (folder / "a.vrt").write_text(vrt(name.replace("@V", str(victim / "kept.txt"))))
    with pytest.raises(TermselError):
        read(folder / "a.vrt")


def test_a_header_beside_a_link_to_another_file(folder: Path, victim: Path) -> None:
    (folder / "a.bil").symlink_to(victim / "kept.txt")
    (folder / "a.hdr").write_text("ncols 60\nnrows 60\nnbits 8\nlayout bil\n")
    with pytest.raises(TermselError):
        read(folder / "a.bil")


@pytest.mark.slow_cases("raw", "wms")
@pytest.mark.parametrize("kind", ["mrf", "wms", "raw"])
def test_in_a_process_of_termsel(kind: str, rasters, folder: Path, made_result: Path, typed,
                                 ) -> None:
    (folder / "a.tif").write_text(rasters[kind])
    done = typed("report", made_result, "--image", "a.tif", "-o", "page.html")
    assert done.returncode == 2
    assert not (folder / "page.html").exists()


def test_gdal_itself_has_no_other_drivers_in_a_process_of_termsel() -> None:
    """Even what no look at the file would see, GDAL cannot do there."""
    code = ("from termsel.core.files.drivers import claim_process; claim_process()\n"
            "from termsel.data.rasters import require_rasterio\n"
            "with require_rasterio().Env() as env: print('|'.join(env.drivers()))")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    known = set(done.stdout.strip().split("|"))
    assert {"GTiff", "VRT", "MEM"} <= known <= {*RASTER_DRIVERS, *VECTOR_DRIVERS, "MEM", "Memory"}


def test_drivers_of_a_program_that_imports_termsel_stay() -> None:
    code = ("import termsel, rasterio\n"
            "from termsel.data.rasters import require_rasterio; require_rasterio()\n"
            "with rasterio.Env() as env: assert {'MRF', 'netCDF'} <= set(env.drivers())\n"
            "import os; assert 'GDAL_SKIP' not in os.environ")
    subprocess.run([sys.executable, "-c", code], check=True)


def test_every_driver_of_gdal_is_on_one_of_the_lists() -> None:
    """One that is not would be on in a process of termsel."""
    with rasterio.Env() as env:
        there = {*env.drivers(), *pyogrio.list_drivers()}
    assert there - {*RASTER_DRIVERS, *VECTOR_DRIVERS, "MEM",
                    "Memory"} <= set(skipped_drivers().split(","))


def test_vector_files(folder: Path, victim: Path) -> None:
    (folder / "source.geojson").write_text(POINT)
    kept = victim / "kept.txt"
    texts = {"pipeline": pipeline(folder / "source.geojson", victim / "made"),
             "csv": ogr_vrt(f"CSV:{kept}"), "any": ogr_vrt(kept),
             "indented": "  " + ogr_vrt(f"CSV:{kept}")}
    for text in texts.values():
        for ending in ("geojson", "json", "vrt", "gpkg", "gdalg.json", "shp", "kml"):
            path = folder / f"a.{ending}"
            path.write_text(text)
            before = files_of(folder)
            with pytest.raises(TermselError):
                open_layer(path, None, ("LineString",))
            with pytest.raises(TermselError):
                termsel.read(lines=path, format="vector-lines", crs="local")
            assert files_of(folder) == before
            path.unlink()


def test_a_virtual_table_of_a_geopackage(folder: Path, victim: Path) -> None:
    shapely = pytest.importorskip("shapely")
    path = folder / "a.gpkg"
    line = shapely.to_wkb(shapely.LineString([[0, 0], [1, 1]]))
    pyogrio.raw.write(path, np.array([line], object),
                      [np.array(["x"], object)], ["id"], geometry_type="LineString",
                      crs="EPSG:4326", driver="GPKG")
    _, shapes, _ = open_layer(path, None, ("LineString",))
    assert len(shapes) == 1
    for hidden in ("v", "v /* USING rtree(a) */", '"v USING rtree"', "v -- USING fts3\n"):
        with closing(sqlite3.connect(path)) as database:
            database.execute("PRAGMA writable_schema = 1")
            database.execute("DELETE FROM sqlite_master WHERE name = 'v'")
            database.execute(
                "INSERT INTO sqlite_master VALUES ('table', 'v', 'v', 0, ?)",
                (f"CREATE VIRTUAL TABLE {hidden} USING VirtualOGR('{victim}/kept.txt')",))
            database.commit()
        with pytest.raises(TermselError, match=r"virtual table|malformed"):
            open_layer(path, None, ("LineString",))


def test_gml_leaves_nothing(folder: Path) -> None:
    path = folder / "roads.gml"
    path.write_text(
        '<ogr:FeatureCollection xmlns:ogr="http://ogr.maptools.org/" '
        'xmlns:gml="http://www.opengis.net/gml"><gml:featureMember><ogr:roads fid="1">'
        '<ogr:geometryProperty><gml:LineString srsName="EPSG:4326"><gml:coordinates>48,34 49,35'
        "</gml:coordinates></gml:LineString></ogr:geometryProperty></ogr:roads>"
        "</gml:featureMember></ogr:FeatureCollection>")
    _, shapes, _ = open_layer(path, None, ("LineString",))
    assert len(shapes) == 1
    assert files_of(folder) == {"roads.gml"}


def test_a_geopackage_with_a_log_leaves_nothing(folder: Path) -> None:
    shapely = pytest.importorskip("shapely")
    path = folder / "a.gpkg"
    line = shapely.to_wkb(shapely.LineString([[0, 0], [1, 1]]))
    pyogrio.raw.write(path, np.array([line], object),
                      [], [], geometry_type="LineString", crs="EPSG:4326", driver="GPKG")
    with closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA journal_mode = WAL")
    before = files_of(folder)
    open_layer(path, None, ("LineString",))
    assert files_of(folder) == before


def test_what_the_user_trusts(folder: Path, victim: Path, call, made_result: Path) -> None:
    """A driver that the user names opens files; none that a file names does."""
    path = folder / "a.xyz"
    path.write_text("".join(f"{x} {y} {x + y}\n" for y in range(3) for x in range(4)))
    with pytest.raises(TermselError, match="a file of text, not a raster"):
        read(path)
    with termsel.allow_driver("xyz"):
        read(path)
    with pytest.raises(TermselError, match="no driver 'nope'"), termsel.allow_driver("nope"):
        pass
    done = call("report", made_result, "--image", path, "-o", "a.html", "--allow-driver", "XYZ")
    assert "termsel does not open" not in done.stderr
    (folder / "study.toml").write_text('problems = ["poly-terms"]\nsolvers = ["swap"]\n'
                                       '[options]\nallow_driver = "MRF"\n')
    assert call("compare", "study.toml", "--dry-run").exit_code == 2


def test_formats_that_the_pages_promise(folder: Path) -> None:
    """Mosaics of rasters elsewhere, pyramids, masks, auxiliary files; Shapefiles in archives."""
    from rasterio.shutil import copy

    (folder / "tiles").mkdir()
    image(folder / "tiles" / "a.tif")
    (folder / "mosaic.vrt").write_text(vrt("tiles/a.tif", 1))
    (folder / "absolute.vrt").write_text(vrt(folder / "tiles" / "a.tif"))
    (folder / "of-mosaic.vrt").write_text(vrt("mosaic.vrt", 1))
    with rasterio.open(folder / "tiles" / "a.tif", "r+") as raster:
        raster.build_overviews([2, 4])
    image(folder / "tiles" / "a.tif.ovr", 30)
    (folder / "tiles" / "a.tif.aux.xml").write_text("<PAMDataset/>")
    for name in ("mosaic.vrt", "absolute.vrt", "of-mosaic.vrt", "tiles/a.tif"):
        read(folder / name)
    with open_raster(folder / "tiles" / "a.tif") as raster:
        pixels = raster.read()
    for driver, ending in (("PNG", "png"), ("HFA", "img"), ("ENVI", "bil"), ("EHdr", "flt"),
                           ("AAIGrid", "asc"), ("NITF", "ntf"), ("JPEG", "jpg"), ("BMP", "bmp"),
                           ("GIF", "gif"), ("JP2OpenJPEG", "jp2")):
        path = folder / f"made.{ending}"
        copy(folder / "tiles" / "a.tif", path, driver=driver, strict=False)
        read(path)
        (folder / "of.vrt").write_text(vrt(path))
        read(folder / "of.vrt")
    assert pixels.shape == (1, 60, 60)


@pytest.mark.parametrize(("driver", "ending"), [
    ("GPKG", "gpkg"), ("ESRI Shapefile", "shp"), ("FlatGeobuf", "fgb"), ("GeoJSON", "geojson"),
    ("KML", "kml"), ("GML", "gml"), ("GPX", "gpx"), ("ESRI Shapefile", "shz")])
def test_vector_formats(driver: str, ending: str, folder: Path) -> None:
    shapely = pytest.importorskip("shapely")
    line = shapely.to_wkb(shapely.LineString([[48, 34], [49, 35]]))
    options = {"layer": "tracks"} if driver == "GPX" else {}
    kind = "MultiLineString" if driver == "GPX" else "LineString"
    if driver == "GPX":
        line = shapely.to_wkb(shapely.MultiLineString([[[48, 34], [49, 35]]]))
    try:
        pyogrio.raw.write(folder / f"a.{ending}", np.array([line], object), [], [], driver=driver,
                          geometry_type=kind, crs="EPSG:4326", **options)
    except pyogrio.errors.DataSourceError as error:
        pytest.skip(str(error))
    _, shapes, _ = open_layer(folder / f"a.{ending}", options.get("layer"),
                              ("LineString", "MultiLineString"))
    assert len(shapes) == 1


def test_workers_of_a_study_have_no_other_drivers() -> None:
    with ProcessPoolExecutor(1, context_of_workers([]), initializer=begin_worker,
                             initargs=({}, dict(os.environ))) as workers:
        assert workers.submit(drivers_are_off).result()
