"""Files of other programs: what is read of them, and what is refused."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import termsel
from termsel.core.errors import TermselError
from termsel.data.features import FeatureSet, Lines, Points
from termsel.fitting.residuals import Residual, Residuals
from termsel.formats.readers.geojson_points import GeoJsonPoints
from termsel.formats.readers.ground_lines import GeoJsonLines
from termsel.formats.readers.qgis_points import QgisPoints
from termsel.plugins.registry import registry
from termsel.testing import Check, checks
from tests.csv_texts import read_file

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
QGIS = (f"#CRS: {UTM}\n"
        "mapX,mapY,sourceX,sourceY,enable,dX,dY,residual\n"
        "500100.5,5000200.25,10.5,-20.5,1,0.1,-0.2,0.22\n"
        "500900,5000300,200,-30.25,0,0,0,0\n"
        "500400,5000900,99.5,-140.5,1,0,0,0\n")
QGIS_READ = FeatureSet(Points(("P1", "P2", "P3"), [[20, 10], [29.75, 199.5], [140, 99]],
                              [[500100.5, 5000200.25, np.nan], [500900, 5000300, np.nan],
                               [500400, 5000900, np.nan]], roles=("", "off", "")),
                       crs="EPSG:32631")
def collection(*features: tuple[dict[str, Any], str, Any], **members: Any) -> str:
    """Return GeoJSON of (properties, type, coordinates)."""
    return json.dumps({"type": "FeatureCollection", **members, "features": [
        {"type": "Feature", "properties": properties,
         "geometry": {"type": kind, "coordinates": coordinates}}
        for properties, kind, coordinates in features]}, indent=1) + "\n"


ORTHORITY = collection(
    ({"ji": [821.3, 62.3], "filename": "q.tif", "id": "plinth", "info": ""}, "Point",
     [24.4194, -33.6542, 214.75]),
    ({"ji": [1131.9, -36.4], "filename": "q.tif", "id": "house", "info": "", "role": "check"},
     "Point", [24.4415, -33.649, 208.75]))
ORTHORITY_READ = FeatureSet(
    Points(("plinth", "house"), [[62.3, 821.3], [-36.4, 1131.9]],
           [[24.4194, -33.6542, 214.75], [24.4415, -33.649, 208.75]], roles=("", "check")),
    crs="EPSG:4979")
ROADS = collection(
    ({"id": "a", "ji": [[10, 20], [30, 45]]}, "LineString", [[5, 44, 10], [5.1, 44.1, 20]]),
    ({"id": 7, "ji": [[1, 2], [3, 4], [8, 6]]}, "LineString", [[6, 44, 1], [6.1, 44, 2],
                                                                  [6.2, 45, 3]]))
ROADS_READ = FeatureSet(
    lines=Lines(("a", "7", "7"),
                [[[20, 10], [45, 30]], [[2, 1], [4, 3]], [[4, 3], [6, 8]]],
                [[[5, 44, 10], [5.1, 44.1, 20]], [[6, 44, 1], [6.1, 44, 2]],
                 [[6.1, 44, 2], [6.2, 45, 3]]]), crs="EPSG:4979")
SUITES = {
    "qgis-points": checks(QgisPoints, content=QGIS.encode(), expected=QGIS_READ,
                          filename="i.points"),
    "geojson-points": checks(GeoJsonPoints, content=ORTHORITY.encode(), expected=ORTHORITY_READ,
                                    filename="i.geojson"),
    "geojson-lines": checks(GeoJsonLines, content=ROADS.encode(), expected=ROADS_READ,
                                   filename="roads.geojson")}
CONTENT = {"qgis-points": QGIS, "geojson-points": ORTHORITY, "geojson-lines": ROADS}


@pytest.mark.parametrize("check", [
    pytest.param(check, id=f"{name}-{check.name}")
    for name, checks in SUITES.items() for check in checks])
def test_readers(check: Check) -> None:
    check.run()


def readers() -> list[type[termsel.Reader]]:
    return [entry.object for entry in registry().entries("readers")]


def put(folder: Path, content: str | bytes, name: str = "file") -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize("name", CONTENT)
def test_one_reader_alone_recognises_a_file(name: str) -> None:
    for content in (CONTENT[name].encode(), b"\xef\xbb\xbf" + CONTENT[name].encode()):
        assert [r.name for r in readers() if r().sniff(Path("any"), content[:65536])] == [name]


@pytest.mark.parametrize("name", CONTENT)
def test_other_encodings_are_read(tmp_path: Path, name: str) -> None:
    text = CONTENT[name]
    expected = read_file(put(tmp_path, text), readers())
    for encoding in ("utf-16", "utf-16-le", "cp1252"):
        path = put(tmp_path, text.replace("\n", "\r\n").encode(encoding), encoding)
        features = read_file(path, readers())
        assert (features.points.ids, features.lines.ids) == (expected.points.ids,
                                                             expected.lines.ids)
        np.testing.assert_array_equal(features.points.ground, expected.points.ground)
    bad = put(tmp_path, text.encode() + b"\n\x81\n", "bad")
    with pytest.raises(TermselError, match="the text of this file is not UTF-8") as caught:
        read_file(bad, readers(), name)
    assert str(bad) in str(caught.value)


@settings(max_examples=300, deadline=None)
@given(st.sampled_from(sorted(CONTENT)), st.data())
def test_any_damage_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, name: str,
                                       data: st.DataObject) -> None:
    text = CONTENT[name]
    start = data.draw(st.integers(0, len(text)))
    stop = data.draw(st.integers(start, min(len(text), start + 40)))
    new = data.draw(st.text('ab,;\t"#\r\n 0123456789.-e[]{}:nulNaI\x1cé', max_size=12))
    path = put(tmp_path_factory.mktemp("any"), text[:start] + new + text[stop:])
    with suppress(TermselError):
        read_file(path, readers(), name)


# QGIS


@pytest.mark.parametrize("text", [
    QGIS.split("\n", 1)[1],
    QGIS.split("\n", 1)[1].replace("source", "pixel"),
    "mapX,mapY,pixelX,pixelY,enable\n500100.5,5000200.25,10.5,-20.5,1\n500900,5000300,200,-30.25,0\n"
    "500400,5000900,99.5,-140.5,1\n",
    "mapX\tmapY\tpixelX\tpixelY\n500100.5\t5000200.25\t10.5\t-20.5\n500900\t5000300\t200\t-30.25\n"
    "500400\t5000900\t99.5\t-140.5\n"])
def test_headers_of_qgis(tmp_path: Path, text: str) -> None:
    features = read_file(put(tmp_path, text), readers())
    np.testing.assert_array_equal(features.points.image, QGIS_READ.points.image)
    np.testing.assert_array_equal(features.points.ground, QGIS_READ.points.ground)
    assert features.points.roles == (("", "off", "") if "enable" in text else ("", "", ""))
    assert features.crs == ""


def test_disabled_points_may_check(tmp_path: Path) -> None:
    features = termsel.read(put(tmp_path, QGIS), disabled="check")
    assert features.points.roles == ("", "check", "")
    with pytest.raises(TermselError, match="option 'disabled' does not accept 'gone'"):
        termsel.read(put(tmp_path, QGIS), disabled="gone")


def rows(*sources: tuple[float, float]) -> str:
    return "mapX,mapY,sourceX,sourceY,enable\n" + "".join(
        f"{500000 + 10 * i},{5000000 + 7 * i * i},{x},{y},1\n" for i, (x, y) in enumerate(sources))


@pytest.mark.parametrize("text", [
    rows((500100, 5000200), (500300, 5000100)), rows((18.4, -34.5), (18.9, -34.1)),
    rows((500100, -3800000), (509900, -3801000)), rows((-70.5, 3.5), (-70, 3.2))])
def test_coordinates_of_a_layer_need_the_raster(tmp_path: Path, text: str) -> None:
    with pytest.raises(TermselError, match="Give the image in which they were measured") as caught:
        termsel.read(put(tmp_path, text), crs="local")
    assert (caught.value.line, caught.value.column) == (2, "sourceX")


def test_raster_turns_coordinates_of_a_layer_into_pixels(tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    from rasterio.transform import from_origin

    image = tmp_path / "image.tif"
    with rasterio.open(image, "w", driver="GTiff", width=50, height=40, count=1, dtype="uint8",
                       crs="EPSG:32631", transform=from_origin(500000, 5000400, 10, 10)):
        pass
    # The centre of the pixel in line 3, sample 7.
    path = put(tmp_path, rows((500075, 5000365), (500100, 5000400)))
    features = termsel.read(path, crs="EPSG:32631", raster=image)
    np.testing.assert_allclose(features.points.image, [[3, 7], [-0.5, 9.5]])
    assert features.image_size == (40, 50)
    far = put(tmp_path, rows((700000, 5000365), (700010, 5000400)))
    with pytest.raises(TermselError, match="no point lies in the image"):
        termsel.read(far, crs="local", raster=image)
    with pytest.raises(TermselError, match="geojson-points has no option 'raster'"):
        termsel.read(put(tmp_path, ORTHORITY), raster=image)


def test_raster_without_georeference_leaves_pixels(tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    image = tmp_path / "image.tif"
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning), \
            rasterio.open(image, "w", driver="GTiff", width=18, height=15, count=1, dtype="uint8"):
        pass
    path = put(tmp_path, rows((3.5, -2.5), (12, -9)))
    with pytest.raises(TermselError, match="they may be map coordinates of a raster that was"):
        termsel.read(path, crs="local")
    for how in ("raster", "image"):
        features = termsel.read(path, crs="local", **{how: image})
        np.testing.assert_allclose(features.points.image, [[2, 3], [8.5, 11.5]])


def test_rows_that_other_programs_count_downwards(
    tmp_path: Path, caplog: pytest.LogCaptureFixture,
) -> None:
    rasterio = pytest.importorskip("rasterio")
    image = tmp_path / "image.tif"
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning), \
            rasterio.open(image, "w", driver="GTiff", width=900, height=700, count=1,
                          dtype="uint8"):
        pass
    path = put(tmp_path, rows((30.5, 20.5), (800, 90), (100, 650)))
    expected = [[20, 30], [89.5, 799.5], [649.5, 99.5]]
    with pytest.raises(TermselError, match="add downwards='true'"):
        termsel.read(path, crs="local")
    asked = termsel.read(path, crs="local", downwards=True)
    np.testing.assert_allclose(asked.points.image, expected)
    assert "counted downwards" not in caplog.text
    seen = termsel.read(path, crs="local", image=image)
    np.testing.assert_allclose(seen.points.image, expected)
    assert "is read as counted downwards from the top of the image" in caplog.text


# Rasters


@pytest.fixture
def core_alone(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("TERMSEL_PLUGINS", "")
    registry.cache_clear()
    yield
    registry.cache_clear()


@pytest.mark.usefixtures("core_alone")
@pytest.mark.parametrize("head", [b"<VRTDataset rasterXSize='3'>\n<GCPList/>", b"II*\0\x08\0"])
def test_a_raster_names_the_package_that_reads_it(tmp_path: Path, head: bytes) -> None:
    path = put(tmp_path, head, "scene.tif")
    with pytest.raises(TermselError, match=r"in no format that termsel knows\. .*gdal-gcps reads it"
                                           r"\. It comes with the package termsel-formats"):
        termsel.read(path)


@pytest.mark.usefixtures("core_alone")
def test_a_writer_names_its_package(tmp_path: Path) -> None:
    with pytest.raises(TermselError, match="comes with the package termsel-formats"):
        termsel.export(termsel.run("poly-terms", solver="all-terms"), "orthority-geojson",
                       tmp_path / "gcps.geojson")


# GeoJSON


@pytest.mark.parametrize(("properties", "coordinates", "column"), [
    ({}, [1, 2, 3], "ji"), ({"ji": [1]}, [1, 2, 3], "ji"), ({"ji": [1, True]}, [1, 2], "ji"),
    ({"ji": "[1, 2"}, [1, 2], "ji"), ({"ji": [1, 2]}, [1], "coordinates"),
    ({"ji": [1, 2]}, [1, None, 3], "coordinates"), ({"ji": [1, 2]}, None, "coordinates"),
    ({"ji": [1, 2]}, [1, 10**400], "coordinates"),
    ({"ji": [1, 2], "role": "best"}, [1, 2], "role"),
    ({"ji": [1, 2], "sigma_px": "x"}, [1, 2], "sigma_px")])
def test_bad_features(tmp_path: Path, properties: dict[str, Any], coordinates: Any,
                      column: str) -> None:
    good: tuple[dict[str, Any], str, Any] = ({"ji": [5, 6]}, "Point", [7, 8])
    text = collection(good, (properties, "Point", coordinates))
    with pytest.raises(TermselError, match=r"feature [12]: ") as caught:
        read_file(put(tmp_path, text), readers())
    assert caught.value.column == column or column == "sigma_px"


def test_members_of_geojson(tmp_path: Path) -> None:
    text = collection(
        ({"ji": "[3, 4]", "enabled": False, "sigma_px": 0.5}, "Point", [500000, 5000000]),
        ({"ji": [5, 6.5], "id": 12, "sigma_px": [1, 2]}, "Point", [500010, 5000900]),
        crs={"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::32631"}})
    features = termsel.read(put(tmp_path, text))
    assert features.crs == "EPSG:32631"
    assert features.points.ids == ("P1", "12")
    assert features.points.roles == ("off", "")
    assert features.points.image.tolist() == [[4, 3], [6.5, 5]]
    assert features.points.sigma is not None
    assert features.points.sigma.tolist() == [[0.5, 0.5], [2, 1]]
    assert np.isnan(features.points.ground[:, 2]).all()


@pytest.mark.parametrize(("text", "words"), [
    ('{"type": "FeatureCollection", "features": [\n\n', "not JSON"),
    ('{"type": "FeatureCollection", "features": []}', "no features"),
    ('{"type": "Feature"}', "this is not a GeoJSON FeatureCollection"),
    ("[" * 200_000, "nested too deeply"),
    (ORTHORITY.replace("821.3", "8" * 5000), "a number of too many digits"),
    (ORTHORITY.replace('"Point"', '"Polygon"'), "geometry is Polygon, expected Point")])
def test_what_is_no_geojson_of_points(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(TermselError, match=words):
        read_file(put(tmp_path, text), readers(), "geojson-points")


def test_images_of_orthority(tmp_path: Path) -> None:
    path = put(tmp_path, ORTHORITY.replace("q.tif", "r.tif", 1))
    with pytest.raises(TermselError, match=r"images q\.tif, r\.tif"):
        termsel.read(path)
    assert termsel.read(path, image_name="r.tif").points.ids == ("plinth",)


# Round trips through the writers of results

pixels = st.floats(-0.5, 999.5, allow_subnormal=False)
degrees = st.floats(-80, 80, allow_subnormal=False)


@pytest.fixture(scope="module")
def result() -> termsel.Result:
    return termsel.run("poly-terms", generations=1, options={"population": 20, "polish": False})


def write(result: termsel.Result, name: str, path: Path) -> None:
    registry().get("writers", name)().write(result, path)


@pytest.mark.slow
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(st.tuples(pixels, pixels, degrees, degrees), max_size=6,
                unique_by=lambda row: row[2:]), st.data())
def test_points_of_qgis_come_back(tmp_path_factory: pytest.TempPathFactory, result: termsel.Result,
                                  drawn: list[tuple[float, ...]], data: st.DataObject) -> None:
    # Corners, so that no draw looks like coordinates of a layer.
    values = np.array([(0, 0, 90, 90), (999, 999, -90, -90), *drawn], dtype=float)
    ids = tuple(f"P{i + 1}" for i in range(len(values)))
    roles = data.draw(st.lists(st.sampled_from(["control", "check"]), min_size=len(ids),
                               max_size=len(ids)))
    points = Points(ids, values[:, :2], np.column_stack([values[:, 2:], np.zeros(len(ids))]),
                    roles=tuple(roles))
    used = Residuals(Residual(name, "point", role, role == "control", 0.0, 0.0, *ground)
                     for name, role, ground in zip(ids, roles, points.ground.tolist(), strict=True))
    chosen = result.with_(features=FeatureSet(points, crs="EPSG:4979"), residuals=used)
    path = tmp_path_factory.mktemp("qgis") / "image.points"
    write(chosen, "qgis-points", path)
    found = termsel.read(path)
    np.testing.assert_allclose(found.points.image, points.image, atol=1e-12)
    np.testing.assert_array_equal(found.points.ground[:, :2], points.ground[:, :2])
    assert found.points.roles == tuple("" if role == "control" else "off" for role in roles)
    assert found.crs == "EPSG:4326"


@pytest.mark.parametrize(("writer", "crs"), [
    ("orthority-geojson", "EPSG:4979"), ("points-csv", "EPSG:4979"), ("gcp-vrt", "EPSG:4326")])
def test_what_is_written_is_read(tmp_path: Path, result: termsel.Result, writer: str,
                                 crs: str) -> None:
    if writer == "gcp-vrt":
        pytest.importorskip("rasterio")
    path = tmp_path / "out"
    write(result, writer, path)
    found = termsel.read(path)
    assert found.crs == crs
    points = result.features.points
    if writer != "points-csv":
        points = points.take([name in result.selection.features for name in points.ids])
    assert found.points.ids == points.ids
    np.testing.assert_allclose(found.points.image, points.image, rtol=1e-14, atol=1e-9)
    np.testing.assert_allclose(found.points.ground, points.ground, rtol=1e-14)


# Formats by name, in Python and on the command line


def test_format_is_forced(tmp_path: Path) -> None:
    path = put(tmp_path, ORTHORITY)
    with pytest.raises(TermselError, match="there are no columns for x, y, source_x"):
        termsel.read(path, format="qgis-points")
    with pytest.raises(TermselError, match="Did you mean 'geojson-points'"):
        termsel.read(path, format="geojson-point")
    with pytest.raises(TermselError, match=r"2 formats are given for 1 file\."):
        termsel.read(path, format=["geojson-points", "geojson-points"])
    assert len(termsel.read(path, format="geojson-points").points) == 2


@pytest.mark.parametrize(("name", "old", "words"), [
    ("qgis-points", "-20.5", ", line 3, column 'sourceY': the cell is blank"),
    ("geojson-points", "]", ", line 11: this is not JSON")])
def test_command_refuses_in_one_line(tmp_path: Path, name: str, old: str, words: str,
                                     call: Callable[..., SimpleNamespace]) -> None:
    path = put(tmp_path, CONTENT[name].replace(old, "", 1))
    done = call("run", "--problem", "poly-terms", "--points", path, "--crs", "EPSG:4979", "--out",
                tmp_path / "out", "--format", name)
    assert (done.exit_code, done.stdout) == (2, "")
    assert f"{path}{words}" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


PAGES = Path(__file__).parents[2] / "docs" / "reference" / "formats"


@pytest.mark.parametrize("page", sorted(PAGES.glob("*.md")), ids=lambda page: page.stem)
def test_examples_of_the_pages_are_read(page: Path, tmp_path: Path) -> None:
    text = page.read_text(encoding="utf-8")
    name = re.search(r"^Readers? `([\w-]+)`", text, re.MULTILINE)
    if name is None:
        return  # a page of something else
    if name[1] == "gdal-gcps":
        pytest.importorskip("rasterio")
    blocks = re.findall(r"^```(?:text|xml|json)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    example = re.sub(r'PROJCRS\[.*"EPSG",(\d+)\]\]', r"EPSG:\1", blocks[0])
    options: dict[str, Any] = {"asp-gcp": {"image_name": "image1.tif"}}.get(name[1], {})
    if name[1] == "geojson-lines":
        options = {"join": "name", "image_lines": put(tmp_path, blocks[1], "image.csv")}
    features = read_file(put(tmp_path, example), readers(), None, options)
    expected = {"asp-gcp": "", "geojson-points": "EPSG:4979", "envi-pts": "EPSG:32612",
                "points-csv": "EPSG:4979", "lines-csv": "EPSG:4979", "geojson-lines": "EPSG:4979",
                "areas-csv": "EPSG:4979"}
    assert features.crs == expected.get(name[1], "EPSG:32631")
    assert len(features) == (1 if name[1] in ("lines-csv", "areas-csv") else 2)


@pytest.mark.slow
def test_many_points_of_qgis(tmp_path: Path) -> None:
    values = np.random.default_rng(1).random((20_000, 4)) * 1000
    text = "mapX,mapY,sourceX,sourceY,enable\n" + "".join(
        f"{a!r},{b!r},{c!r},{-d!r},1\n" for a, b, c, d in values.tolist())
    features = read_file(put(tmp_path, text), readers())
    np.testing.assert_array_equal(features.points.ground[:, :2], values[:, :2])
