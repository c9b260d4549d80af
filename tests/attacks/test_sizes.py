"""Small files cost at most 1 GiB of memory and 10 s before they are refused; pipes are no files."""

from __future__ import annotations

import os
import sqlite3
import subprocess
import sys
import zipfile
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import termsel
from termsel import TermselError
from termsel.data import rasters
from termsel.data.rasters import open_raster, refuse_empty_giant
from tests.attacks.files import image, vrt

if sys.platform != "linux":
    pytest.skip("limits memory as Linux does", allow_module_level=True)

MOST_SECONDS, MOST_MEMORY = 10.0, 1 << 30
MAIN = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
OFFICE = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
PACKAGE = "http://schemas.openxmlformats.org/package/2006"

MEASURED = """
import os, resource, sys, time
from termsel.cli.main import cli
from termsel.core.files.drivers import claim_process
claim_process()
try:
    cli.main(sys.argv[1:], prog_name="termsel")
finally:
    use = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    from termsel.core.files import apart
    for helper in list(getattr(apart, "HELPERS", ())):
        helper.end()
    use[1] = resource.getrusage(resource.RUSAGE_CHILDREN)
    print("USED", sum(one.ru_utime + one.ru_stime for one in use),
          max(one.ru_maxrss for one in use) * 1024, file=sys.stderr)
"""


@pytest.fixture
def refused() -> Callable[..., str]:
    """Run a command that must be refused, within the limits; return what it says.

    `before` is code that the process runs first.
    """
    def run(*words: object, before: str = "") -> str:
        done = subprocess.run([sys.executable, "-c", before + MEASURED, *map(str, words)],
                              check=False, capture_output=True, text=True, timeout=60)
        message, _, used = done.stderr.partition("USED ")
        seconds, memory = map(float, used.split()[:2])
        assert done.returncode == 2, done.stderr
        assert "Traceback" not in message
        assert "has failed" not in message
        assert seconds < MOST_SECONDS
        assert memory < MOST_MEMORY
        return message
    return run


def sheet(path: Path, rows: str, extra: str = "") -> Path:
    """Write a spreadsheet with a sheet of such rows."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("[Content_Types].xml", (
            f'<?xml version="1.0"?><Types xmlns="{PACKAGE}/content-types"><Default Extension='
            '"rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
            '<Default Extension="xml" ContentType="application/xml"/><Override PartName='
            '"/xl/workbook.xml" ContentType="application/vnd.openxmlformats-officedocument.'
            'spreadsheetml.sheet.main+xml"/></Types>'))
        archive.writestr("_rels/.rels", (
            f'<?xml version="1.0"?><Relationships xmlns="{PACKAGE}/relationships"><Relationship '
            f'Id="r1" Type="{OFFICE}/officeDocument" Target="xl/workbook.xml"/></Relationships>'))
        archive.writestr("xl/workbook.xml", (
            f'<?xml version="1.0"?><workbook xmlns="{MAIN}" xmlns:r="{OFFICE}"><sheets><sheet '
            'name="a" sheetId="1" r:id="r1"/></sheets></workbook>'))
        archive.writestr("xl/_rels/workbook.xml.rels", (
            f'<?xml version="1.0"?><Relationships xmlns="{PACKAGE}/relationships"><Relationship '
            f'Id="r1" Type="{OFFICE}/worksheet" Target="worksheets/sheet1.xml"/></Relationships>'))
        archive.writestr("xl/worksheets/sheet1.xml", (
            f'<?xml version="1.0"?><worksheet xmlns="{MAIN}"><sheetData>{rows}</sheetData>{extra}'
            "</worksheet>"))
    return path


@pytest.mark.slow_cases("long and wide")
@pytest.mark.parametrize("rows", [
    '<row r="1"><c r="A1"><v>1</v></c></row><row r="1048576"><c r="XFD1048576"><v>1</v></c></row>',
    '<row r="1"><c r="A1"><v>1</v></c></row><row r="9"><c r="A1048576"><v>1</v></c>'
    '<c r="XFD2"><v>1</v></c></row>'], ids=["corners", "long and wide"])
def test_a_sheet_of_billions_of_cells(rows: str, folder: Path, refused) -> None:
    sheet(folder / "a.xlsx", rows)
    refused("run", "--points", "a.xlsx", "--crs", "EPSG:4979")


@pytest.mark.slow
def test_an_archive_that_grows(folder: Path, refused) -> None:
    sheet(folder / "a.xlsx", "<row><c><v>1</v></c></row>" * 2_000_000)
    refused("run", "--points", "a.xlsx", "--crs", "EPSG:4979")


def test_an_open_document_that_repeats(folder: Path, refused) -> None:
    with zipfile.ZipFile(folder / "a.ods", "w") as archive:
        archive.writestr("mimetype", "application/vnd.oasis.opendocument.spreadsheet")
        archive.writestr("META-INF/manifest.xml", "<manifest/>")
        archive.writestr("content.xml", (
            '<office:document-content xmlns:office="o" xmlns:table="t" xmlns:text="x"><office:body>'
            '<office:spreadsheet><table:table table:name="a"><table:table-row '
            'table:number-rows-repeated="1048576"><table:table-cell '
            'table:number-columns-repeated="16384" office:value-type="float" office:value="1"/>'
            "</table:table-row></table:table></office:spreadsheet></office:body>"
            "</office:document-content>"))
    refused("run", "--points", "a.ods", "--crs", "EPSG:4979")


@pytest.mark.slow_cases("rows", "sum")
@pytest.mark.parametrize("view", [
    "WITH RECURSIVE n(fid) AS (SELECT 1 UNION ALL SELECT fid + 1 FROM n) SELECT fid, "
    "(SELECT geom FROM x) AS geom FROM n",
    "SELECT max(a.n) AS fid, x.geom FROM x, (WITH RECURSIVE m(n) AS (SELECT 1 UNION ALL SELECT "
    "n + 1 FROM m) SELECT n FROM m) AS a",
    "SELECT fid, geom, zeroblob(900000000) AS big FROM x"], ids=["rows", "sum", "cell"])
def test_a_view_without_end(view: str, folder: Path, refused, made_result: Path) -> None:
    pyogrio, shapely = pytest.importorskip("pyogrio"), pytest.importorskip("shapely")
    line = shapely.to_wkb(shapely.LineString([[0, 0], [1, 1]]))
    pyogrio.raw.write(folder / "a.gpkg", np.array([line], object), [], [], layer="x",
                      geometry_type="LineString", crs="EPSG:4326", driver="GPKG")
    with closing(sqlite3.connect(folder / "a.gpkg")) as database:
        database.execute(f"CREATE VIEW v AS {view}")
        database.execute("UPDATE gpkg_contents SET table_name = 'v', identifier = 'v'")
        database.execute("UPDATE gpkg_geometry_columns SET table_name = 'v'")
        database.execute("DELETE FROM gpkg_extensions WHERE table_name = 'x'")
        database.commit()
    (folder / "image.csv").write_text("id,line1,sample1,line2,sample2\n1,1,2,3,4\n")
    # Whatever the limit of a small file is, the view has reached it.
    refused("run", "--problem", "owdis-lines", "--lines", "a.gpkg", "--image-lines", "image.csv",
            before="from termsel.core.files import apart; apart._SECONDS = 0.5\n")


def test_virtual_rasters_that_multiply(folder: Path, refused, made_result: Path) -> None:
    image(folder / "0.tif", 8)
    for number in range(1, 9):
        text = vrt("0.tif" if number == 1 else f"{number - 1}.vrt", 1)
        source = text[text.index("<SimpleSource>"):text.index("</VRTRasterBand>")]
        (folder / f"{number}.vrt").write_text(text.replace(source, source * 10))
    assert "multiply" in refused("report", made_result, "--image", "8.vrt", "-o", "a.html")
    deep = folder / "deep"
    deep.mkdir()
    image(deep / "0.tif", 8)
    for number in range(1, 40):
        (deep / f"{number}.vrt").write_text(
            vrt("0.tif" if number == 1 else f"{number - 1}.vrt", 1))
    with pytest.raises(TermselError, match="nested too deeply"), open_raster(deep / "39.vrt"):
        pass


@pytest.mark.slow_cases("sparse", "strip")
@pytest.mark.parametrize("how", ["sparse", "strip", "header"])
def test_a_small_image_of_any_size(how: str, folder: Path, refused, made_result: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    if how == "header":
        (folder / "a.asc").write_text("ncols 2000000000\nnrows 9\nxllcorner 0\nyllcorner 0\n"
                                      "cellsize 1\n1 2 3\n")
    else:
        size = {"sparse": {"width": 200_000, "height": 200_000, "tiled": True},
                "strip": {"width": 40_000, "height": 40_000, "blockysize": 40_000}}[how]
        with rasterio.open(folder / "a.asc", "w", driver="GTiff", count=1, dtype="uint8",
                           sparse_ok=True, compress="deflate", **size):
            pass
    refused("report", made_result, "--image", "a.asc", "-o", "a.html")
    assert not (folder / "a.html").exists()


@pytest.mark.parametrize(("driver", "options"), [
    ("GTiff", {"compress": "deflate", "tiled": True, "count": 3, "interleave": "pixel"}),
    ("GTiff", {"compress": "zstd", "tiled": True, "blockxsize": 1024, "blockysize": 1024}),
    ("GTiff", {"compress": "deflate", "count": 3, "interleave": "band", "blockysize": 500}),
    ("PNG", {}),
])
@pytest.mark.parametrize("value", [0, 255])
def test_constant_images_are_read_whatever_their_size(
        value: int, driver: str, options: dict[str, Any], folder: Path,
        monkeypatch: pytest.MonkeyPatch) -> None:
    rasterio = pytest.importorskip("rasterio")
    # As with images of a gigabyte, which take seconds to write.
    monkeypatch.setattr(rasters, "SMALL", 2**20)
    options = {"count": 1, "dtype": "uint8", "width": 5000, "height": 4000} | options
    with rasterio.open(folder / "a.tif", "w", driver=driver, **options) as raster:
        shape = (options["count"], options["height"], options["width"])
        raster.write(np.full(shape, value, dtype=np.uint8))
    pixels = 4000 * 5000 * options["count"]
    assert pixels > 500 * (folder / "a.tif").stat().st_size
    with open_raster(folder / "a.tif") as raster:
        refuse_empty_giant(raster)


def test_an_image_with_few_of_its_blocks_is_refused(folder: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    with rasterio.open(folder / "a.tif", "w", driver="GTiff", count=1, dtype="uint8",
                       width=200_000, height=100_000, sparse_ok=True, tiled=True,
                       blockxsize=2048, blockysize=2048, compress="deflate") as raster:
        raster.write(np.full((1, 2048, 2048), 7, dtype=np.uint8),
                     window=rasterio.windows.Window(0, 0, 2048, 2048))
    with open_raster(folder / "a.tif") as raster, \
            pytest.raises(TermselError, match="of 100,000 lines and 200,000 samples has only"):
        refuse_empty_giant(raster)


def test_a_damaged_image_of_many_pixels_is_refused(
        folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rasterio = pytest.importorskip("rasterio")
    monkeypatch.setattr(rasters, "SMALL", 2**20)
    with rasterio.open(folder / "a.png", "w", driver="PNG", count=1, dtype="uint8", width=5000,
                       height=4000) as raster:
        raster.write(np.zeros((1, 4000, 5000), dtype=np.uint8))
    whole = (folder / "a.png").read_bytes()
    (folder / "a.png").write_bytes(whole[:len(whole) // 2])
    with open_raster(folder / "a.png") as raster, \
            pytest.raises(TermselError, match="has only"):
        refuse_empty_giant(raster)


READING = {
    "points": ("run", "--problem", "poly-terms", "--points", "@F", "--crs", "local"),
    "lines": ("run", "--problem", "owdis-lines", "--lines", "@F", "--crs", "local"),
    "areas": ("run", "--points", "points.csv", "--areas", "@F", "--crs", "local"),
    "rpc": ("run", "--points", "points.csv", "--crs", "EPSG:4979", "--rpc", "@F"),
    "dem": ("run", "--points", "points.csv", "--crs", "EPSG:4326", "--dem", "@F"),
    "study": ("compare", "@F", "--dry-run"),
    "image": ("report", "@R", "--image", "@F", "-o", "a.html"),
    "certificate": ("check", "@F"),
    "ties": ("block", "block.toml", "--out", "o"),
    "block": ("block", "@F", "--out", "o"),
    "vectors": ("match-lines", "a.tif", "--vectors", "@F", "--dem", "a.tif", "-o", "a.csv"),
    "start": ("match-points", "a.tif", "--reference", "a.tif", "--start", "@F", "-o", "a.csv"),
    "metadata": ("run", "--points", "points.csv", "--crs", "EPSG:4979", "--model", "scanner",
                 "--set", "metadata=@F"),
    "accuracy": ("accuracy", "@F"),
}


@pytest.mark.parametrize("kind", ["pipe", "device", "link to a device"])
@pytest.mark.parametrize("what", READING)
def test_pipes_and_devices(what: str, kind: str, folder: Path, made_result: Path, call) -> None:
    """Nobody ever writes to the pipe: what waits for it waits for ever."""
    image(folder / "a.tif")
    (folder / "points.csv").write_text("id,line,sample,x,y,z\n" + "".join(
        f"P{i},{i},{i * i % 7},{i / 100},{i * i % 7 / 100},0\n" for i in range(20)))
    place = folder / "given"
    if kind == "pipe":
        os.mkfifo(place)
    elif kind == "device":
        place = Path("/dev/zero")
    else:
        place.symlink_to("/dev/zero")
    (folder / "block.toml").write_text(
        f'crs = "local"\nties = "{place}"\n' + "".join(
            f'[[image]]\nname = "{name}"\npoints = "points.csv"\n' for name in "ab"))
    words = [{"@F": str(place), "@R": str(made_result)}.get(word, word.replace("@F", str(place)))
             for word in READING[what]]
    done = call(*words)
    assert done.exit_code == 2, done.output
    if what != "metadata":
        assert "pipe or a device" in done.stderr or "no such file" in done.stderr \
            or "there is no result here" in done.stderr, done.stderr


@pytest.mark.slow_cases("DIM_a.XML", "a.IMD", "a.RPB", "a.tfw", "a.tif.aux.xml", "a.tif.ovr")
@pytest.mark.parametrize("name", ["a.tif.aux.xml", "a_RPC.TXT", "a.RPB", "a.tfw", "a.tif.ovr",
                                  "a.IMD", "DIM_a.XML", "a.aux"])
def test_pipes_next_to_a_raster(name: str, folder: Path, made_result: Path, typed) -> None:
    image(folder / "a.tif")
    os.mkfifo(folder / name)
    done = typed("report", made_result, "--image", "a.tif", "-o", "a.html")
    assert done.returncode == 2
    assert "pipe or a device" in done.stderr


def test_a_pipe_that_a_virtual_raster_names(folder: Path, made_result: Path, typed) -> None:
    os.mkfifo(folder / "pipe")
    (folder / "a.vrt").write_text(vrt("pipe", 1))
    assert typed("report", made_result, "--image", "a.vrt", "-o", "a.html").returncode == 2
    (folder / "b.vrt").write_text(vrt("/dev/zero"))
    assert typed("report", made_result, "--image", "b.vrt", "-o", "a.html").returncode == 2


@pytest.mark.parametrize("name", ["a.csv", "a.RPB", "a.json", "a.toml"])
def test_a_file_of_any_size_without_content(name: str, folder: Path) -> None:
    with (folder / name).open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(TermselError):
        termsel.read(folder / name, crs="local", format="points-csv")
    with pytest.raises(TermselError):
        termsel.read_rpc(folder / name)


@pytest.mark.parametrize("crs", ["a" * 100_000, "(" * 100_000, "+proj=tmerc " + "+lon_0=1 " * 9000])
def test_a_first_line_longer_than_what_is_looked_at(crs: str, folder: Path) -> None:
    path = folder / "a.points"
    rows = "".join(f"{48 + i / 10},{34 + i * 7 % 11},{i}0,-{i * 7 % 11}0,1\n" for i in range(12))
    path.write_text(f"#CRS: {crs}\nmapX,mapY,sourceX,sourceY,enable\n{rows}")
    with pytest.raises(TermselError):
        termsel.read(path)
