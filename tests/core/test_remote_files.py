"""Files that refer to servers make no request unless that is allowed; a server on loopback counts.

The server is a process of its own, as GDAL holds Python's lock while it waits for an answer.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
import pytest

import termsel
from termsel.core.errors import TermselError
from termsel.core.files import drivers, sources
from termsel.data import rasters
from termsel.data.rasters import open_raster, tiff_bytes
from termsel.formats.heights import open_dem
from tests.counting_server import SERVER

rasterio = pytest.importorskip("rasterio")


def vrt(source: str, relative: int = 0, more: str = "") -> str:
    return f"""<VRTDataset rasterXSize="60" rasterYSize="60">{more}<SRS>EPSG:4326</SRS>
<GeoTransform>-56.3,0.01,0,-34.5,0,-0.01</GeoTransform>
<VRTRasterBand dataType="Float32" band="1"><SimpleSource>
<SourceFilename relativeToVRT="{relative}">{escape(source)}</SourceFilename>
<SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>"""


WMS = """<GDAL_WMS><Service name="TMS"><ServerUrl>@URL/${z}/${x}/${y}.png</ServerUrl></Service>
<DataWindow><UpperLeftX>0</UpperLeftX><UpperLeftY>0</UpperLeftY><LowerRightX>10</LowerRightX>
<LowerRightY>10</LowerRightY><SizeX>9</SizeX><SizeY>9</SizeY><TileLevel>1</TileLevel></DataWindow>
<BlockSizeX>9</BlockSizeX><BlockSizeY>9</BlockSizeY><BandsCount>1</BandsCount></GDAL_WMS>"""
FILES = {
    "vsicurl.vrt": vrt("/vsicurl/@URL/a.tif"), "url.vrt": vrt("@URL/b.tif"),
    "streaming.vrt": vrt("/vsicurl_streaming/@URL/c.tif"),
    "question.vrt": vrt("/vsicurl?max_retry=0&url=@URL/d.tif"),
    "zip.vrt": vrt("/vsizip//vsicurl/@URL/e.zip/e.tif"), "s3.vrt": vrt("/vsis3/bucket/f.tif"),
    "netcdf.vrt": vrt('NETCDF:"@URL/g.nc":x'), "inline.vrt": vrt(WMS), "wms.xml": WMS,
    "wcs.xml": "<WCS_GDAL><ServiceURL>@URL/wcs</ServiceURL></WCS_GDAL>",
    "not-xml.vrt": vrt("/vsicurl/@URL/h.tif", more="<a b>"), "nested.vrt": vrt("inner.vrt", 1),
    "inner.vrt": vrt("/vsicurl/@URL/i.tif"),
    "warped.vrt": """<VRTDataset subClass="VRTWarpedDataset" rasterXSize="9" rasterYSize="9">
<GDALWarpOptions><SourceDataset>/vsicurl/@URL/j.tif</SourceDataset></GDALWarpOptions></VRTDataset>
""",
    "geolocated.vrt": vrt("plain.tif", 1, more='<Metadata domain="GEOLOCATION"><MDI '
                          'key="X_DATASET">/vsicurl/@URL/k.tif</MDI></Metadata>'),
    "pam.tif.aux.xml": """<PAMDataset><Metadata domain="OVERVIEWS"><MDI key="OVERVIEW_FILE">
/vsicurl/@URL/l.ovr</MDI></Metadata></PAMDataset>"""}
NAMES = [name.removesuffix(".aux.xml") for name in FILES]


@pytest.fixture
def folder(tmp_path: Path, server: Counted) -> Path:
    """A folder of all files, with an image that they refer to."""
    for name, text in FILES.items():
        (tmp_path / name).write_text(text.replace("@URL", server.url))
    image = tiff_bytes(np.zeros((1, 60, 60), dtype=np.float32), crs="EPSG:4326",
                       transform=rasterio.transform.from_origin(-56.3, -34.5, 0.01, 0.01))
    for name in ("plain.tif", "pam.tif"):
        (tmp_path / name).write_bytes(image)
    return tmp_path


class Counted:
    """The server's address, and what was asked of it."""

    def __init__(self, url: str, log: Path) -> None:
        self.url, self.log = url, log

    def count(self) -> int:
        return len(self.log.read_text().splitlines())


@pytest.fixture(scope="module")
def running(tmp_path_factory) -> Iterator[Counted]:
    log = tmp_path_factory.mktemp("server") / "log"
    log.touch()
    with subprocess.Popen([sys.executable, "-c", SERVER, str(log)], stdout=subprocess.PIPE,
                          text=True) as process:
        yield Counted(f"http://127.0.0.1:{process.stdout.readline().strip()}", log)
        process.kill()


@pytest.fixture
def server(running: Counted, monkeypatch) -> Counted:
    """The server, with hosts of clouds there too and nothing that is remembered."""
    for key, value in {
            "AWS_S3_ENDPOINT": running.url[7:], "AWS_HTTPS": "NO", "AWS_VIRTUAL_HOSTING": "FALSE",
            "AWS_NO_SIGN_REQUEST": "YES", "GDAL_HTTP_TIMEOUT": "5"}.items():
        monkeypatch.setenv(key, value)
    running.log.write_text("")
    return running


def read_all(path: Path) -> None:
    with open_raster(path) as raster:
        raster.overviews(1)
        raster.read(1, out_shape=(5, 5))


NAMED = {"wms.xml": "format WMS",
         "wcs.xml": "format WCS", "inline.vrt": "remote source", "not-xml.vrt": "not well-formed"}
REFUSED = r"remote source .* which is refused.*--allow-remote"


@pytest.mark.parametrize("name", NAMES)
def test_remote_sources_are_refused_before_gdal_sees_them(name: str, folder, server) -> None:
    with pytest.raises(TermselError, match=NAMED.get(name, REFUSED)):
        read_all(folder / name)
    assert server.count() == 0


@pytest.mark.parametrize("name", [name for name in NAMES if name != "netcdf.vrt"])
@pytest.mark.parametrize("exceptions", ["", "*"])
def test_gdal_makes_no_request_whatever_a_file_hides(name: str, exceptions: str, folder, server,
                                                     monkeypatch) -> None:
    monkeypatch.setattr(rasters, "refuse_foreign", lambda path: [])
    monkeypatch.setattr(rasters, "refuse_named", lambda path, names: None)
    monkeypatch.setenv("no_proxy", exceptions)
    for key, text in FILES.items():  # GDAL remembers what it has asked for
        text = text.replace(".tif<", f"{len(exceptions)}.tif<")
        (folder / key).write_text(text.replace("@URL", server.url))
    with suppress(TermselError):  # GDAL passes over a remote overview, for one
        read_all(folder / name)
    assert server.count() == 0
    assert drivers.os.environ["no_proxy"] == exceptions


@pytest.mark.parametrize("name", ["url.vrt", "nested.vrt", "pam.tif"])
def test_they_are_asked_for_where_that_is_allowed(name: str, folder, server) -> None:
    for key, text in FILES.items():
        text = text.replace(".tif<", "-allowed.tif<").replace(".ovr", "-allowed.ovr")
        (folder / key).write_text(text.replace("@URL", server.url))
    with termsel.allow_remote(), suppress(TermselError):
        read_all(folder / name)
    assert server.count() > 0


@pytest.mark.parametrize("name", ["/vsicurl/@URL/n.tif", "@URL/n.tif", "/vsis3/bucket/n.tif",
                                  "/vsizip/vsicurl/@URL/n.zip/n.tif"])
def test_names_of_remote_sources_are_refused(name: str, server) -> None:
    with (pytest.raises(TermselError, match="which is refused"),
          open_dem(Path(name.replace("@URL", server.url)), "EPSG:4326")):
        pass
    assert server.count() == 0


@pytest.mark.parametrize("text", [
    vrt("plain.tif", 1, more="<Metadata><MDI key='TIFFTAG_SOFTWARE'>see https://example.org</MDI>"
        "</Metadata><Metadata domain='xml:XMP' format='xml'><x xmlns='http://ns.example.org/'>"
        "<url>http://example.org</url></x></Metadata>"),
    vrt("plain.tif", 1).replace("<VRTDataset", '<VRTDataset xmlns:xsi="http://www.w3.org/2001/'
                                'XMLSchema-instance" xsi:schemaLocation="https://a/b"'),
    vrt("../vsicurlews/plain.tif", 1), vrt("self.vrt", 1), vrt("../vsicurl.tif", 1)])
def test_addresses_that_no_file_is_read_from_do_no_harm(text: str, folder) -> None:
    (folder / "self.vrt").write_text(text)
    (folder.parent / "vsicurlews").mkdir(exist_ok=True)
    (folder.parent / "vsicurlews" / "plain.tif").write_bytes((folder / "plain.tif").read_bytes())
    sources.refuse_foreign(folder / "self.vrt")


def test_vector_files(folder, server) -> None:
    pytest.importorskip("pyogrio")
    path = folder / "lines.vrt"
    path.write_text(f"""<OGRVRTDataSource><OGRVRTLayer name="x"><SrcDataSource>/vsicurl/{server.url}
/x.gpkg</SrcDataSource></OGRVRTLayer></OGRVRTDataSource>""")
    with pytest.raises(TermselError, match="format OGR_VRT, which termsel does not open"):
        termsel.read(lines=path, format="vector-lines", crs="local")
    assert server.count() == 0


@pytest.fixture(scope="module")
def result(tmp_path_factory) -> Path:
    """Return the folder of a result."""
    rng = np.random.default_rng(0)
    image = rng.uniform(0, 59, (40, 2))
    ground = np.column_stack([image[:, 1] / 100 - 56.3, -34.5 - image[:, 0] / 100, image[:, 0]])
    points = termsel.Points([f"P{i}" for i in range(40)], image, ground)
    made = tmp_path_factory.mktemp("result") / "result"
    termsel.run("poly-terms", features=termsel.FeatureSet(points, crs="EPSG:4979"), out=made,
                options={"degree": 1}, evaluations=20)
    return made


RUN = ("run", "--problem", "poly-terms", "--points")
POINTS = "id,line,sample,x,y,z\nA,1,2,-56,-34.9,\nB,3,2,-56.1,-34.8,\nC,1,4,-56.2,-34.7,\n"


@pytest.mark.parametrize("words", [
    (*RUN, "gcps.vrt"), (*RUN, "p.csv", "--crs", "EPSG:4326", "--dem", "vsicurl.vrt"),
    (*RUN, "p.points", "--crs", "EPSG:4326", "--raster", "vsicurl.vrt"),
    ("stability", "--problem", "poly-terms", "--points", "gcps.vrt"),
    ("export", "result", "--to", "gcp-vrt", "-o", "x.vrt", "--image", "vsicurl.vrt"),
    ("project", "result", "--points", "pixels.csv", "--inverse", "--dem", "vsicurl.vrt"),
    ("rectify", "result", "vsicurl.vrt", "-o", "map.tif", "--height", "3"),
    ("rectify", "result", "plain.tif", "-o", "map.tif", "--dem", "url.vrt")],
    ids=lambda words: " ".join(words))
def test_commands(words: tuple[str, ...], folder, server, call, result, monkeypatch) -> None:
    monkeypatch.chdir(folder)
    shutil.copytree(result, "result")
    Path("p.csv").write_text(POINTS)
    Path("pixels.csv").write_text("id,line,sample\nA,1,2\n")
    Path("p.points").write_text("mapX,mapY,sourceX,sourceY,enable\n1,2,30,-40,1\n2,3,400,-3,1\n")
    gcps = "".join(f'<GCP Id="{i}" Pixel="{i}" Line="{i * i}" X="{i / 9}" Y="2" Z="3"/>'
                   for i in range(9))
    Path("gcps.vrt").write_text(vrt(f"/vsicurl/{server.url}/m.tif").replace(
        "<SRS>EPSG:4326</SRS>", f'<GCPList Projection="EPSG:4326">{gcps}</GCPList>'))
    done = call(*words)
    assert done.exit_code == 2
    assert "which is refused" in done.stderr
    assert "--allow-remote" in done.stderr
    assert server.count() == 0
    assert not Path("map.tif").exists()
    allowed = call(*words, "--allow-remote")
    assert "refused" not in allowed.stderr
