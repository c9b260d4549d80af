"""Files that ended as "termsel has failed": each now ends with a message, or is read."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import termsel
from termsel import TermselError
from termsel.data.rpc import Rpc
from termsel.formats.base import parse_json
from termsel.formats.heights import open_dem
from termsel.formats.readers.qgis_points import QgisPoints
from termsel.simulate import read_geometry, scene_truth
from termsel.simulate.geometry_files import geometry_text

DEM = """<VRTDataset rasterXSize="60" rasterYSize="60"><SRS>{crs}</SRS><GeoTransform>{transform}
</GeoTransform><VRTRasterBand dataType="Float32" band="1"/></VRTDataset>"""
PLACED = "-56.3,0.01,0,-34.5,0,-0.01"
MOON = ('GEOGCS["Moon 2000",DATUM["D_Moon_2000",SPHEROID["Moon_2000_IAU_IAG",1737400,0]],'
        'PRIMEM["Reference_Meridian",0],UNIT["degree",0.0174532925199433]]')


@pytest.mark.parametrize(("crs", "transform", "message"), [
    ('LOCAL_CS["x",UNIT["metre",1]]', PLACED, "CRS of this raster"),
    (MOON, PLACED, "CRS of this raster cannot be used"),
    ("EPSG:5773", PLACED, "has no horizontal coordinates"),
    ("EPSG:4326", "-56.3,0,0,-34.5,0,-0.01", "pixels of this raster have no size")],
    ids=["local", "Moon", "vertical", "no size"])
def test_rasters_of_heights_that_are_not_on_the_ground(crs: str, transform: str, message: str,
                                                       tmp_path: Path) -> None:
    pytest.importorskip("rasterio")
    path = tmp_path / "dem.vrt"
    path.write_text(DEM.format(crs=crs.replace('"', "&quot;"), transform=transform))
    with (pytest.raises(TermselError, match=message),
          open_dem(path, "EPSG:4326") as heights):
        heights(np.array([[-56.0, -34.7]]))
    points = tmp_path / "a.points"
    points.write_text("mapX,mapY,sourceX,sourceY,enable\n1,2,3,-40,1\n2,3,40,-3,1\n")
    if message.startswith("pixels"):
        with pytest.raises(TermselError, match=message):
            QgisPoints(raster=str(path)).read(points)


@pytest.mark.parametrize("where", ['Id="T\xfcrm"', 'Id="a" \xfcber'])
def test_a_vrt_in_latin_1(where: str, tmp_path: Path, call) -> None:
    pytest.importorskip("rasterio")
    path = tmp_path / "gcps.vrt"
    path.write_bytes(f'<VRTDataset rasterXSize="9" rasterYSize="9"><GCPList><GCP {where} Pixel="1" '
                     'Line="2" X="3" Y="4" Z="5"/></GCPList><VRTRasterBand dataType="Byte" '
                     'band="1"/></VRTDataset>'.encode("latin-1"))
    with pytest.raises(TermselError, match="has text that is not UTF-8"):
        termsel.read(path, crs="local")
    done = call("run", "--problem", "poly-terms", "--points", path, "--crs", "local")
    assert done.exit_code == 2
    assert done.stderr.count("\n") == 1


def test_xml_in_chinese_and_in_no_encoding(tmp_path: Path) -> None:
    rpc = Rpc((1.0, 2.0), (3.0, 4.0), (5.0, 6.0, 7.0), (8.0, 9.0, 10.0), *4 * [tuple(range(1, 21))])
    texts = [f"<{name}>{value}</{name}>" for name, value in (
        ("LINEOFFSET", 1), ("SAMPOFFSET", 2), ("LINESCALE", 3), ("SAMPSCALE", 4),
        ("LONGOFFSET", 5), ("LATOFFSET", 6), ("HEIGHTOFFSET", 7), ("LONGSCALE", 8),
        ("LATSCALE", 9), ("HEIGHTSCALE", 10))]
    numbers = " ".join(map(str, range(1, 21)))
    texts += [f"<{name}>{numbers}</{name}>" for name in (
        "LINENUMCOEF", "LINEDENCOEF", "SAMPNUMCOEF", "SAMPDENCOEF")]
    body = "<isd><name>卫星</name><RPB>" + "".join(texts) + "</RPB></isd>"
    path = tmp_path / "rpc.xml"
    for encoding in ("gb2312", "GBK", "utf-8", "utf-16"):
        path.write_bytes(f'<?xml version="1.0" encoding="{encoding}"?>{body}'.encode(encoding))
        assert termsel.read_rpc(path) == rpc
    path.write_text('<?xml version="1.0" encoding="nope"?><isd/>')
    with pytest.raises(TermselError, match="line 1: the encoding of this XML cannot be read"):
        termsel.read_rpc(path)
    path.write_bytes(b'<?xml version="1.0" encoding="gb2312"?><isd>\xff\xff</isd>')
    with pytest.raises(TermselError, match="the encoding of this XML cannot be read"):
        termsel.read_rpc(path)


@pytest.mark.parametrize(("text", "message"), [
    ('{"a": ' + "[" * 100_000, "nested too deeply"),
    ('{"a": ' + "9" * 5000 + "}", "too many digits"), ("{", "line 1: this is not JSON")])
def test_json(text: str, message: str, tmp_path: Path, call) -> None:
    with pytest.raises(TermselError, match=message):
        parse_json(text, "")
    path = tmp_path / "geometry.json"
    path.write_text(text)
    with pytest.raises(TermselError, match=message):
        read_geometry(path)
    (tmp_path / "result.json").write_text(text)
    with pytest.raises(TermselError, match=message):
        termsel.read_result(tmp_path)
    whole = geometry_text(scene_truth("spot-isfahan").sensor)
    path.write_text(whole.replace('"roll": {', '"roll": {"\\ud800": 1,'))
    with pytest.raises(TermselError, match="a field of the geometry is invalid"):
        read_geometry(path)
    path.write_text('{"features": 1, "type": "FeatureCollection", "Point": ' + text[6:])
    with pytest.raises(TermselError):
        termsel.read(path, format="geojson-points")


@pytest.mark.parametrize(("setting", "text"), [
    ("rpc", '{"a": ' + "[" * 50_000), ("geometry", '{"a": ' + "[" * 50_000),
    ("rpc", '{"a": ' + "9" * 5000 + "}"), ("rpc", "{}"), ("rpc", '{"file": "x", "b": 1}')])
def test_json_in_a_setting(setting: str, text: str, call) -> None:
    pytest.importorskip("termsel_rpc")
    model = {"rpc": "rpc-shift", "geometry": "pushbroom-refine"}[setting]
    done = call("run", "--problem", "owdis-points", "--model", model, "--set", f"{setting}={text}")
    assert done.exit_code == 2
    assert len(done.stderr) < 3000


@pytest.mark.parametrize(("place", "said"), [
    ("x", "cannot be longitude"), ("z", "beyond any ground"), ("ji", ""), ("sigma", "")])
def test_whole_numbers_beyond_64_bits(place: str, said: str, tmp_path: Path) -> None:
    huge = 10**25
    path = tmp_path / "a.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [
        {"type": "Feature",
         "properties": {"ji": [huge if place == "ji" else 1, i],
                        "sigma_px": huge if place == "sigma" else 1},
         "geometry": {"type": "Point", "coordinates": [
             huge + i if place == "x" else i, i, huge if place == "z" else 5]}}
        for i in range(3)]}))
    if said:
        with pytest.raises(TermselError, match=said):
            termsel.read(path)
    else:
        assert termsel.read(path).points.image.dtype == np.float64


@pytest.mark.parametrize("number", ["1e200", "1e308", "-1e308"])
def test_coordinates_whose_squares_overflow(number: str, tmp_path: Path) -> None:
    rows = {"line": f"id,line,sample,x,y,z\nA,{number},2,3,4,5\nB,2,3,4,5,6\n",
            "x": f"id,line,sample,x,y,z\nA,1,2,{number},4,5\nB,2,3,4,5,6\n",
            "corner": f"id,corner,line,sample,x,y,z\nA,1,{number},2,3,4,5\nA,2,9,3,4,5,6\n"
                      "A,3,9,9,9,9,9\n",
            "line2": "id,line1,sample1,line2,sample2,x1,y1,z1,x2,y2,z2\n"
                     f"A,1,2,{number},4,5,6,7,8,9,1\n"}
    path = tmp_path / "a.csv"
    for place, text in rows.items():
        path.write_text(text)
        kind = {"corner": "areas", "line2": "lines"}.get(place, "points")
        with pytest.raises(TermselError, match="line 2"):
            termsel.read(**{kind: path}, crs="local")


@pytest.mark.slow_cases("owdis-points --model affine")
@pytest.mark.parametrize("words", [
    ("owdis-points", "--model", "affine"), ("poly-terms", "--set", "degree=2", "--solver", "swap"),
    ("poly-terms",)], ids=" ".join)
def test_measurements_without_noise(words: tuple[str, ...], tmp_path: Path, call) -> None:
    rng = np.random.default_rng(0)
    image = rng.integers(0, 1000, (36, 2)).astype(float)
    roles = [("control", "check", "independent")[i % 3] for i in range(36)]
    termsel.write_points_csv(termsel.Points(
        [f"P{i}" for i in range(36)], image, np.column_stack([image, rng.uniform(0, 100, 36)]),
        roles=roles), tmp_path / "a.csv", "local")
    done = call("run", "--problem", *words, "--points", tmp_path / "a.csv")
    assert done.exit_code == 0
    assert "inf" not in done.stdout
