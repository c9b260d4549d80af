"""Points of ENVI, of the Ames Stereo Pipeline and of rasters: what is read, and what is refused."""

from __future__ import annotations

import math
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("termsel_formats", reason="termsel-formats is not installed: "
                    "pip install -e plugins/termsel-formats")

import termsel
from termsel import FeatureSet, Points, TermselError
from termsel.testing import Check, check, checks
from termsel.toolkit import registry
from termsel_formats.points.asp import AspGcp
from termsel_formats.points.envi import EnviPoints
from termsel_formats.points.rasters import GdalGcps

UTM = ('PROJCRS["WGS 84 / UTM zone 31N",BASEGEOGCRS["WGS 84",DATUM["World Geodetic System 1984",'
       'ELLIPSOID["WGS 84",6378137,298.257223563,LENGTHUNIT["metre",1]]],PRIMEM["Greenwich",0,'
       'ANGLEUNIT["degree",0.0174532925199433]],ID["EPSG",4326]],CONVERSION["UTM zone 31N",METHOD'
       '["Transverse Mercator",ID["EPSG",9807]],PARAMETER["Latitude of natural origin",0,ANGLEUNIT'
       '["degree",0.0174532925199433],ID["EPSG",8801]],PARAMETER["Longitude of natural origin",3,'
       'ANGLEUNIT["degree",0.0174532925199433],ID["EPSG",8802]],PARAMETER["Scale factor at natural '
       'origin",0.9996,SCALEUNIT["unity",1],ID["EPSG",8805]],PARAMETER["False easting",500000,'
       'LENGTHUNIT["metre",1],ID["EPSG",8806]],PARAMETER["False northing",0,LENGTHUNIT["metre",1],'
       'ID["EPSG",8807]]],CS[Cartesian,2],AXIS["(E)",east,ORDER[1],LENGTHUNIT["metre",1]],AXIS'
       '["(N)",north,ORDER[2],LENGTHUNIT["metre",1]],ID["EPSG",32631]]')
ENVI = ("; ENVI Orthorectification Ground Control Points File\n"
        "; projection info = {UTM, 12, North, WGS-84, units=Meters}\n"
        "; Map (x,y,elev), Image (x,y)\n;\n"
        "408620.653090  3698080.965069  314.977000  4366.000000  447.000000\n"
        "406652.054304  3698011.485774  311.083000  3569.500000  479.000000\n")
ENVI_READ = FeatureSet(Points(("P1", "P2"), np.array([[445.5, 4364.5], [477.5, 3568]]),
                              np.array([[408620.65309, 3698080.965069, 314.977],
                                        [406652.054304, 3698011.485774, 311.083]])),
                       crs="EPSG:32612")
ASP = ("# made by hand\n"
       "5 23.7 160.1 427.1 1.0 1.0 1.0 image1.tif 124.5 19.7 1.0 0.5 image2.tif 254 73 1 1\n"
       "6, 23.8, 160.2, 430, 1, 1, 1, image2.tif, 11, 12, 1, 1\n"
       "7, 23.9, 160.3, 431, 1, 1, 1, image1.tif, 21, 22, 1, 1\n")
ASP_READ = FeatureSet(Points(("5", "7"), np.array([[19.7, 124.5], [22, 21]]),
                             np.array([[160.1, 23.7, 427.1], [160.3, 23.9, 431]]),
                             np.array([[0.5, 1], [1, 1]])),
                      crs="")
VRT = ('<VRTDataset rasterXSize="300" rasterYSize="200">\n'
       f'  <GCPList Projection="{UTM.replace(chr(34), "&quot;")}">\n'
       '    <GCP Id="west" Info="" Pixel="10.5" Line="20.5" X="500100" Y="5000200" Z="12.5"/>\n'
       '    <GCP Id="east" Info="" Pixel="99.5" Line="140.25" X="500900" Y="5000900" Z="0"/>\n'
       '  </GCPList>\n'
       '  <VRTRasterBand dataType="Byte" band="1"/>\n'
       '</VRTDataset>\n')
VRT_READ = FeatureSet(Points(("west", "east"), np.array([[20, 10], [139.75, 99]]),
                             np.array([[500100, 5000200, 12.5], [500900, 5000900, 0]])),
                      crs="EPSG:32631", image_size=(200, 300))

CONTENT = {"envi-pts": ENVI, "asp-gcp": ASP, "gdal-gcps": VRT}
TEXTS = ["asp-gcp", "envi-pts"]


def put(folder: Path, content: str | bytes, name: str = "file") -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize("check", [
    *checks(EnviPoints, content=ENVI.encode(), expected=ENVI_READ, filename="i.pts"),
    *checks(AspGcp(image_name="image1.tif"), content=ASP.encode(), expected=ASP_READ,
            filename="i.gcp")], ids=lambda one: str(one.name))
def test_conforms(check: Check) -> None:
    check.run()


@pytest.mark.parametrize("check", checks(GdalGcps, content=VRT.encode(), expected=VRT_READ,
                                         filename="i.vrt"), ids=lambda c: str(c.name))
def test_reader_of_rasters(check: Check) -> None:
    pytest.importorskip("rasterio")
    check.run()


def test_reader_of_geotiffs(tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    from rasterio.control import GroundControlPoint

    path = tmp_path / "image.tif"
    gcps = [GroundControlPoint(row=20.5 + i, col=10.5 + 2 * i, x=5.0 + i, y=44.0 - i, z=1.5 * i)
            for i in range(5)]
    with rasterio.open(path, "w", driver="GTiff", width=60, height=40, count=1, dtype="uint8",
                       crs="EPSG:4326", gcps=gcps, compress="deflate") as raster:
        raster.write(np.random.default_rng(1).integers(0, 255, (1, 40, 60), dtype=np.uint8))
    i = np.arange(5)
    expected = FeatureSet(
        Points(tuple("12345"), np.column_stack([20.0 + i, 10.0 + 2 * i]),
               np.column_stack([5.0 + i, 44.0 - i, 1.5 * i])), crs="EPSG:4326",
        image_size=(40, 60))
    check(GdalGcps(), content=path.read_bytes(), expected=expected, filename="image.tif")


@pytest.mark.parametrize("name", CONTENT)
def test_one_reader_alone_recognises_a_file(name: str) -> None:
    readers = [entry.object() for entry in registry().entries("readers")]
    for content in (CONTENT[name].encode(), b"\xef\xbb\xbf" + CONTENT[name].encode()):
        assert [one.name for one in readers if one.sniff(Path("any"), content[:65536])] == [name]


@pytest.mark.parametrize("name", TEXTS)
def test_text_in_no_encoding_is_refused(tmp_path: Path, name: str) -> None:
    path = put(tmp_path, CONTENT[name].encode() + b"\n# \x81;\n")
    with pytest.raises(TermselError, match="the text of this file is not UTF-8") as caught:
        termsel.read(path, format=name)
    assert str(path) in str(caught.value)


@settings(max_examples=200, deadline=None)
@given(st.sampled_from(TEXTS), st.data())
def test_any_damage_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, name: str,
                                       data: st.DataObject) -> None:
    text = CONTENT[name]
    start = data.draw(st.integers(0, len(text)))
    stop = data.draw(st.integers(start, min(len(text), start + 40)))
    new = data.draw(st.text('ab,;\t"#\r\n 0123456789.-e[]{}:nulNaI\x1cé', max_size=12))
    path = put(tmp_path_factory.mktemp("any"), text[:start] + new + text[stop:])
    with suppress(TermselError):
        termsel.read(path, format=name, crs="local")


@pytest.mark.parametrize(("name", "old", "words"), [
    ("envi-pts", "447.000000", ", line 6"), ("asp-gcp", "23.7", ", line 2")])
def test_a_number_that_is_missing_is_named_with_its_line(tmp_path: Path, name: str, old: str,
                                                         words: str) -> None:
    path = put(tmp_path, CONTENT[name].replace(old, "", 1))
    with pytest.raises(TermselError) as caught:
        termsel.read(path, format=name, crs="EPSG:4979")
    assert f"{path}{words}" in str(caught.value)


# GDAL


def test_gcps_of_a_geotiff(tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    from rasterio.control import GroundControlPoint

    path = tmp_path / "image.tif"
    gcps = [GroundControlPoint(row=20.5, col=10.5, x=5.0, y=44.0, z=0.0, id="a"),
            GroundControlPoint(row=0, col=30, x=5.5, y=44.5, z=0.0, id="b")]
    with rasterio.open(path, "w", driver="GTiff", width=50, height=40, count=1, dtype="uint8",
                       crs="EPSG:4326", gcps=gcps):
        pass
    features = termsel.read(path)
    np.testing.assert_allclose(features.points.image, [[20.0, 10.0], [-0.5, 29.5]])
    assert np.isnan(features.points.ground[:, 2]).all()
    assert (features.crs, features.image_size) == ("EPSG:4326", (40, 50))
    centre = termsel.read(path, gcp_origin="centre")
    np.testing.assert_allclose(centre.points.image, [[20.5, 10.5], [0.0, 30.0]])


def test_raster_without_gcps(tmp_path: Path) -> None:
    pytest.importorskip("rasterio")
    path = put(tmp_path, VRT[:VRT.index("<GCPList")] + VRT[VRT.index("</GCPList>") + 10:])
    with pytest.raises(TermselError, match="has no ground control points"):
        termsel.read(path)


def test_without_rasterio_the_command_is_given(tmp_path: Path,
                                               monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rasterio", None)
    with pytest.raises(TermselError, match=r'pip install "termsel\[gis\]"'):
        termsel.read(put(tmp_path, VRT))
    with pytest.raises(TermselError, match=r'pip install "termsel\[gis\]"'):
        termsel.read(put(tmp_path, ENVI), dem=put(tmp_path, "", "dem.tif"))
    assert len(termsel.read(put(tmp_path, ENVI)).points) == 2


# ENVI


@pytest.mark.parametrize(("text", "image", "ground"), [
    ("; ENVI Image to Map GCP File\n; Map (x,y), Image (x,y)\n;\n 5.5 6.5  2.5  4.5\n",
     [3, 1], [5.5, 6.5, math.nan]),
    ("; ENVI Ground Control Points File\n; Map (x,y,elev), Image (x,y)\n;\n5.5 6.5 7 2.5 4.5\n",
     [3, 1], [5.5, 6.5, 7]),
    ("; ENVI Rigorous Orthorectification GCP File\n; FileName0=a.tif\n; FileName1=b.tif\n"
     "; ImageFile#, Map (x,y,elev), Image (x,y)\n;\n1\t5.5\t6.5\t7\t2.5\t4.5\n", [3, 1],
     [5.5, 6.5, 7]),
    ("; ENVI Stereo Pair GCP File\n;\n2.5 4.5 9 9 -1.17410984e+002 4.77035482e+001 628.363\n",
     [3, 1], [-117.410984, 47.7035482, 628.363])])
def test_kinds_of_envi(tmp_path: Path, text: str, image: list[float], ground: list[float]) -> None:
    features = termsel.read(put(tmp_path, text), crs="local")
    np.testing.assert_allclose(features.points.image, [image])
    np.testing.assert_allclose(features.points.ground, [ground])


@pytest.mark.parametrize(("projection", "crs"), [
    ("Geographic Lat/Lon, WGS-84, units=Degrees", "EPSG:4326"),
    ("UTM, 7, South, WGS-84, units=Meters", "EPSG:32707"),
    ("UTM, 7, North, North America 1927", ""), ("UTM, 77, North, WGS-84", ""),
    ("Arbitrary, WGS-84", "")])
def test_projections_of_envi(tmp_path: Path, projection: str, crs: str) -> None:
    text = f"; ENVI GCP File\n; projection info = {{{projection}}}\n5.5 6.5 7 2.5 4.5\n"
    assert EnviPoints().read(put(tmp_path, text)).crs == crs


def test_several_images_of_envi(tmp_path: Path) -> None:
    head = "; ENVI Rigorous Orthorectification GCP File\n;\n"
    path = put(tmp_path, head + "0 1 2 3 4 5\n2 6 7 8 9 10\n")
    with pytest.raises(TermselError, match=r"images 0, 2. Choose one with image_number=N"):
        termsel.read(path, crs="local")
    assert termsel.read(path, crs="local", image_number=2).points.image.tolist() == [[8.5, 7.5]]


@pytest.mark.parametrize(("text", "line", "words"), [
    (ENVI.replace("4366.000000", "4366,0"), 5, "not a number"),
    (ENVI.replace("  447.000000\n", "\n"), 6, "5 numbers, expected 4 as in the first"),
    (ENVI + "1 2 3\n", 7, "3 numbers"),
    (ENVI[:ENVI.index("408620")], None, "the file has no points"),
    ("; ENVI Image to Image GCP File\n; Base Image (x,y), Warp Image (x,y)\n;\n1 2 3 4\n", 1,
     "these points relate two images")])
def test_bad_envi_files(tmp_path: Path, text: str, line: int | None, words: str) -> None:
    with pytest.raises(TermselError, match=words) as caught:
        termsel.read(put(tmp_path, text), crs="local")
    assert caught.value.line == line


# Ames Stereo Pipeline


def test_several_images_of_asp(tmp_path: Path) -> None:
    path = put(tmp_path, ASP)
    with pytest.raises(TermselError, match=r"images image1\.tif \(2\), image2.*Choose one"):
        termsel.read(path, crs="EPSG:4979")
    features = termsel.read(path, crs="EPSG:4979", image_name="image2.tif")
    assert features.points.ids == ("5", "6")
    assert features.points.ground[1].tolist() == [160.2, 23.8, 430]


@pytest.mark.parametrize(("old", "new", "line", "column"), [
    ("23.8", "north", 3, "lat"), (" 1, 1\n7", " 1\n7", 3, None), ("21, 22", "21, x", 4, "row"),
    ("6, 23.8", "5, 23.8", 3, "id")])
def test_bad_asp_files(tmp_path: Path, old: str, new: str, line: int, column: str | None) -> None:
    text = ASP.replace("image1", "image2").replace(" image2.tif 254 73 1 1", "").replace(old, new)
    with pytest.raises(TermselError) as caught:
        termsel.read(put(tmp_path, text), format="asp-gcp", crs="local")
    assert (caught.value.line, caught.value.column) == (line, column)


@pytest.mark.slow
def test_many_points(tmp_path: Path) -> None:
    n = 20_000
    values = np.random.default_rng(1).random((n, 5)) * 1000
    texts = {
        "envi-pts": "; ENVI GCP File\n" + "".join(
            f"{a!r} {b!r} {e!r} {c!r} {d!r}\n" for a, b, c, d, e in values.tolist()),
        "asp-gcp": "".join(f"{i} {b!r} {a!r} {e!r} 1 1 1 i {c!r} {d!r} 1 1\n"
                           for i, (a, b, c, d, e) in enumerate(values.tolist()))}
    for name, text in texts.items():
        points = termsel.read(put(tmp_path, text), crs="local").points
        assert len(points) == n, name
        np.testing.assert_array_equal(points.ground[:, :2], values[:, :2])
