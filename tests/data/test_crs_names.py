"""CRSs as people have them: by name, as a string of PROJ, and in files next to the points."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("pyproj")

import pyproj

import termsel
from termsel import TermselError
from termsel.data.coordinates.crs import is_crs, normalise, short_crs_name

BONNE = "+proj=bonne +lat_1=45 +lon_0=0 +ellps=clrk66 +units=m"
TABLE = "id,line,sample,x,y\nP1,10,20,5000,6000\nP2,900,40,5050,1000\nP3,40,800,9000,5900\n"


@pytest.mark.parametrize(("given", "code"), [
    ("WGS84", "EPSG:4326"), ("GCS_WGS_1984", "EPSG:4326"), ("WGS84 UTM 16N", "EPSG:32616"),
    ("WGS 84 / UTM zone 33S", "EPSG:32733"), ("UTM 5 north", "EPSG:32605"),
    ("+proj=longlat +datum=WGS84 +no_defs", "EPSG:4326"),
    ("+proj=utm +zone=11 +ellps=WGS84 +datum=WGS84 +units=m +no_defs", "EPSG:32611"),
    ("+proj=utm +zone=30 +south +datum=WGS84", "EPSG:32730"),
    ("NAD_1983_UTM_Zone_11N", "EPSG:26911"), ("ETRS89", "EPSG:4258"),
    ("EPSG 32633", "EPSG:32633"), ("epsg-25833", "EPSG:25833"), ("+init=epsg:32633", "EPSG:32633"),
    ("http://www.opengis.net/def/crs/EPSG/0/32633", "EPSG:32633"),
    ("http://www.opengis.net/gml/srs/epsg.xml#32633", "EPSG:32633"),
    ("ETRS89 UTM 33N", "EPSG:25833"), ("NAD27 / UTM 10 N", "EPSG:26710"),
    ("SIRGAS 2000 UTM 23S", "EPSG:31983"), ("EPSG: 32633", "EPSG:32633"),
    # Former names, which old programs and projects keep.
    ("OSGB 1936 / British National Grid", "EPSG:27700"), ("RGF93 / Lambert-93", "EPSG:2154")])
def test_names_of_a_crs(given: str, code: str, tmp_path: Path) -> None:
    degrees = code in ("EPSG:4326", "EPSG:4258")
    (tmp_path / "a.csv").write_text(
        "id,line,sample,x,y\nP1,10,20,8.5,4\nP2,90,40,8.6,5\n" if degrees else
        "id,line,sample,x,y\nP1,10,20,500100,4000000\nP2,90,40,500400,4000500\n")
    assert termsel.read(tmp_path / "a.csv", crs=given).crs == code


@pytest.mark.parametrize("given", [
    "+proj=pipeline +step +proj=utm +zone=33", "+proj=nothing", "UTM 61N", "hello world", "lon",
    "+proj=longlat +ellps=bessel +nadgrids=/etc/hostname"])
def test_what_is_no_crs(given: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(TABLE)
    with pytest.raises(TermselError, match=r"unknown CRS|does not exist"):
        termsel.read(tmp_path / "a.csv", crs=given)


@pytest.mark.parametrize("name", [
    "ETRS89 / TM35FIN(E,N)", "ETRS_1989_UTM_Zone_32N", "etrs89_utm_zone_32n", "wgs 84 utm zone 33n",
    "S-JTSK / Krovak East North", "SJTSK Krovak East North", "OSGB 1936 / British National Grid",
    "ETRS89 / UTM zone 32N + DHHN2016 height"])
def test_listed_names_are_those_that_proj_takes(name: str) -> None:
    assert is_crs(name)
    assert pyproj.CRS(normalise(name)).is_projected


def test_no_header_is_looked_up_among_the_names_of_crss(tmp_path: Path,
                                                        monkeypatch: pytest.MonkeyPatch) -> None:
    """Each look-up of a name that is near none takes PROJ a fifth of a second."""
    look_up_in_proj = pyproj.CRS.from_user_input

    def look_up(text: str, **options: object) -> pyproj.CRS:
        assert "line" not in text
        return look_up_in_proj(text, **options)

    monkeypatch.setattr(pyproj.CRS, "from_user_input", look_up)
    (tmp_path / "a.csv").write_text(TABLE)
    assert len(termsel.read(tmp_path / "a.csv", crs="local").points) == 3
    assert not is_crs("id,line,sample,x,y")


@pytest.mark.parametrize(("given", "meant"), [
    ("UTM33", r"EPSG:32633 \(north\) or EPSG:32733 \(south"), ("WGS84 UTM zone 5", "EPSG:32605"),
    ("lat/lon", "EPSG:4326"), ("degrees", "EPSG:4326"), ("32633", "EPSG:32633")])
def test_what_a_crs_may_mean_is_asked(given: str, meant: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(TABLE)
    with pytest.raises(TermselError, match=f"Did you mean {meant}"):
        termsel.read(tmp_path / "a.csv", crs=given)


def test_a_projection_without_a_code_in_every_form(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(TABLE)
    (tmp_path / "bonne.wkt").write_text(pyproj.CRS(BONNE).to_wkt(pretty=True))
    (tmp_path / "bonne.crs").write_text(BONNE)
    (tmp_path / "b.csv").write_text(TABLE)
    (tmp_path / "b.prj").write_text(pyproj.CRS(BONNE).to_wkt("WKT1_ESRI"))
    (tmp_path / "c.csv").write_text(f"# crs: {BONNE}\n{TABLE}")
    read = [termsel.read(tmp_path / "a.csv", crs=BONNE),
            termsel.read(tmp_path / "a.csv", crs=str(tmp_path / "bonne.wkt")),
            termsel.read(tmp_path / "a.csv", crs=str(tmp_path / "bonne.crs")),
            termsel.read(tmp_path / "a.csv", crs=pyproj.CRS(BONNE).to_wkt()),
            termsel.read(tmp_path / "b.csv"), termsel.read(tmp_path / "c.csv")]
    for features in read:
        operation = pyproj.CRS(features.crs).coordinate_operation
        assert operation is not None
        assert operation.method_name.startswith("Bonne")
        # Neither name says more than "unknown".
        assert short_crs_name(features.crs) == "custom Bonne"


@pytest.mark.parametrize("name", ["a.prj", "a.csv.prj", "a.qpj"])
def test_a_file_next_to_a_table_has_its_crs(name: str, tmp_path: Path,
                                            caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "a.csv").write_text(TABLE)
    (tmp_path / name).write_text(pyproj.CRS(3857).to_wkt())
    assert termsel.read(tmp_path / "a.csv").crs == "EPSG:3857"
    assert "Warning" not in caplog.text
    assert termsel.read(tmp_path / "a.csv", crs="EPSG:2056").crs == "EPSG:2056"
    assert f"{name} has the CRS EPSG:3857, but crs='EPSG:2056' is used" in caplog.text


def test_a_file_without_a_crs_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(TABLE)
    (tmp_path / "a.wkt").write_text("nothing")
    with pytest.raises(TermselError, match=r"a\.wkt: unknown CRS 'nothing'"):
        termsel.read(tmp_path / "a.csv", crs=str(tmp_path / "a.wkt"))


def test_a_file_that_is_not_there_is_no_name_of_a_crs(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(TABLE)
    with pytest.raises(TermselError, match=r"a\.prj: this file does not exist"):
        termsel.read(tmp_path / "a.csv", crs=str(tmp_path / "a.prj"))


def test_the_crs_beside_the_image_is_proposed(tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    (tmp_path / "a.csv").write_text(TABLE)
    (tmp_path / "scan.prj").write_text(pyproj.CRS(3857).to_wkt("WKT1_ESRI"))
    with rasterio.open(tmp_path / "scan.tif", "w", driver="GTiff", width=900, height=950, count=1,
                       dtype="uint8", sparse_ok=True):
        pass
    with pytest.raises(TermselError, match=r"beside the image: crs='.*scan\.prj'"):
        termsel.read(tmp_path / "a.csv", image=tmp_path / "scan.tif")


@pytest.mark.parametrize(("declared", "x", "y", "stated"), [
    ("EPSG:32639", 48.0, 34.0, "EPSG:4326"), ("EPSG:4326", 430_000.0, 5_200_000.0, "EPSG:32633")])
def test_a_crs_that_coordinates_contradict_gives_way_to_the_stated_one(
        declared: str, x: float, y: float, stated: str, tmp_path: Path,
        caplog: pytest.LogCaptureFixture) -> None:
    table = tmp_path / "a.csv"
    rows = [f"P{i},{10 * i},{7 * i * i},{x + i / 100},{y + i * i / 100}" for i in range(5)]
    table.write_text("\n".join([f"# crs: {declared}", "id,line,sample,x,y", *rows]))
    with pytest.raises(termsel.TermselError):
        termsel.read(table)
    assert termsel.read(table, crs=stated).crs == stated
    assert f"declares the CRS {declared}, in which its coordinates are not possible" in caplog.text
    # One that they do not contradict is no slip.
    table.write_text("\n".join([f"# crs: {stated}", "id,line,sample,x,y", *rows]))
    other = "EPSG:32632" if stated == "EPSG:32633" else "EPSG:4258"
    with pytest.raises(termsel.TermselError, match="declares the CRS"):
        termsel.read(table, crs=other)
