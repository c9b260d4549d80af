"""Names of coordinate reference systems, and coordinates that cannot be in them."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from warnings import catch_warnings, simplefilter

import numpy as np
import pytest

import termsel
from termsel.core.errors import TermselError
from termsel.data.coordinates.crs import (
    height_reference,
    horizontal_crs,
    is_geographic,
    normalise,
    plane_transformer,
    short_crs_name,
    to_wgs84,
)
from termsel.data.coordinates.metres import ground_for_warping, offsets_in_metres
from termsel.data.coordinates.plausible import check_ground, note_on_wrong_coordinates
from termsel.data.features import FeatureSet, Lines, Points, empty_points


def ground(crs: str, *xy: tuple[float, float]) -> FeatureSet:
    n = len(xy)
    return FeatureSet(Points(tuple(f"p{i}" for i in range(n)), np.zeros((n, 2)),
                             np.reshape([(x, y, 0.0) for x, y in xy], (n, 3))), crs=crs)


@pytest.fixture
def _no_pyproj(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyproj", None)


@pytest.mark.parametrize(("given", "expected"), [
    ("EPSG:4979", "EPSG:4979"), (" epsg:4326 ", "EPSG:4326"), ("EPSG:04326", "EPSG:4326"),
    ("LOCAL", "local"), ("OGC:CRS84", "EPSG:4326"), ("ogc:crs84h", "EPSG:4979"),
    ("urn:ogc:def:crs:OGC:1.3:CRS84", "EPSG:4326"), ("urn:ogc:def:crs:EPSG::32631", "EPSG:32631"),
    ("EPSG:2100", "EPSG:2100")])
def test_normalise(given: str, expected: str) -> None:
    assert normalise(given) == expected
    assert normalise(expected) == expected


@pytest.mark.parametrize("given", ["", "WGS85", "EPSG:", "EPSG:abc", "4979", "UTM 31", "OGC:x",
                                   "EPSG:32735+", "POINT[3]", "[]"])
def test_unknown_names_come_with_examples(given: str) -> None:
    with pytest.raises(TermselError, match=r"unknown CRS .*EPSG:4979 .*EPSG:32631 .*local"):
        normalise(given)


def test_a_bare_number_is_guessed() -> None:
    with pytest.raises(TermselError, match=r"Did you mean EPSG:4979\?"):
        normalise("4979")


def test_pyproj_knows_which_codes_exist() -> None:
    pytest.importorskip("pyproj")
    with pytest.raises(TermselError, match="'EPSG:99999' does not exist"):
        normalise("EPSG:99999")
    with pytest.raises(TermselError, match=r"EGM96 height.*no horizontal coordinates"):
        normalise("EPSG:5773")
    with pytest.raises(TermselError, match="cannot be read"):
        normalise('PROJCS["half"]')


def test_a_long_crs_is_shortened_in_messages() -> None:
    assert short_crs_name("EPSG:4326+5773") == "EPSG:4326+5773"
    assert short_crs_name("x" * 41) == "x" * 40 + "..."


def test_offsets_in_metres_are_those_of_the_ellipsoid() -> None:
    pyproj = pytest.importorskip("pyproj")
    places = np.array([[10.0, 0.0, 0.0], [10.0, 50.0, 0.0], [179.9999, -70.0, 0.0]])
    offsets = np.array([[1e-4, 0.0], [0.0, 1e-4], [1e-4 - 360.0, 2e-4]])
    geod = pyproj.Geod(ellps="WGS84")
    for place, offset in zip(places, offsets, strict=True):
        azimuth, _, length = geod.inv(*place[:2], *(place[:2] + offset))
        expected = length * np.array([np.sin(np.radians(azimuth)), np.cos(np.radians(azimuth))])
        found = offsets_in_metres("EPSG:4979", place[None], offset[None])
        np.testing.assert_allclose(found, expected[None], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(("lon", "zone"), [(179.0, "EPSG:4326"), (181.0, "EPSG:32601"),
                                           (-181.0, "EPSG:32660")])
def test_what_goes_on_beyond_the_antimeridian_is_warped_in_its_zone(lon: float, zone: str) -> None:
    pytest.importorskip("pyproj")
    ground = np.array([[lon, 10.0, 5.0], [lon + 0.1, 10.1, np.nan]])
    there, crs = ground_for_warping(ground, "EPSG:4979")
    assert crs == zone
    np.testing.assert_array_equal(there[:, 2], [5.0, np.nan])
    assert (np.abs(there[:, :2]) > 1000).all() == (zone != "EPSG:4326")


def test_heights_of_their_own() -> None:
    pytest.importorskip("pyproj")
    assert normalise("epsg:4326+5773") == "EPSG:9707"  # which is these two
    assert normalise("EPSG:32639+05773") == "EPSG:32639+5773"
    assert height_reference("EPSG:32639+5773") == "EGM96 height"
    assert horizontal_crs("EPSG:32639+5773") == "EPSG:32639"
    with pytest.raises(TermselError, match="look like degrees"):
        check_ground(ground("EPSG:32639+5773", (5, 44)))
    assert height_reference("EPSG:32735+4326") == "ellipsoidal (WGS 84)"
    with pytest.raises(TermselError, match=r"'EPSG:5773\+32735' does not exist"):
        normalise("EPSG:5773+32735")


def test_the_grid_of_a_geoid_that_is_missing_is_named() -> None:
    pyproj = pytest.importorskip("pyproj")
    with catch_warnings():
        simplefilter("ignore")
        group = pyproj.transformer.TransformerGroup("EPSG:32639+5773", "EPSG:4979")
    if group.best_available:
        pytest.skip("PROJ has the grid here")
    with pytest.raises(TermselError, match=r"not have the grid us_nga_egm96_15.*pyproj sync"):
        to_wgs84("EPSG:32639+5773")


def test_wkt_becomes_its_code() -> None:
    pyproj = pytest.importorskip("pyproj")
    for code in ("EPSG:4979", "EPSG:32631", "EPSG:2100"):
        for version in ("WKT2_2019", "WKT1_GDAL"):
            if (code, version) != ("EPSG:4979", "WKT1_GDAL"):  # WKT1 has no such CRS
                text = pyproj.CRS(code).to_wkt(version, pretty=True)
                assert normalise(text) == code
    local = 'LOCAL_CS["site",UNIT["metre",1]]'
    assert normalise(local) == local
    assert not is_geographic(local)


@pytest.mark.usefixtures("_no_pyproj")
def test_without_pyproj_form_and_known_codes_are_checked() -> None:
    assert normalise("EPSG:99999") == "EPSG:99999"
    assert is_geographic("EPSG:4979")
    assert not is_geographic("EPSG:4258")
    geographic = 'GEOGCRS["of my own",DATUM["d",ELLIPSOID["e",6378137,298]]]'
    assert normalise(geographic) == geographic
    assert is_geographic(geographic)
    check_ground(ground("EPSG:4258", (5, 44)))
    with pytest.raises(TermselError, match="look like degrees"):
        check_ground(ground("EPSG:32631", (5, 44)))
    with pytest.raises(TermselError, match="unknown CRS"):
        normalise("Amersfoort / RD New")
    assert normalise("WGS84 UTM 31N") == "EPSG:32631"


def _at_heights(crs: str, heights: Sequence[float]) -> FeatureSet:
    x, y = (9e5, 4.4e6) if crs == "EPSG:32631" else (5.0, 44.0)
    names = tuple("abcdefghij"[:len(heights)])
    return FeatureSet(Points(names, np.arange(2.0 * len(names)).reshape(-1, 2),
                             np.array([(x, y, z) for z in heights])), crs=crs)


@pytest.mark.parametrize("crs", ["EPSG:4979", "EPSG:32631"])
@pytest.mark.parametrize(("heights", "unit"), [
    ((1_508_000.0, 2_176_000.0), "They look like millimetres, 1,508 to 2,176 m: divide them"),
    ((-150_800.0, 97_600.0), "They look like centimetres, -1,508 to 976 m: divide them by 100"),
    ((29_032.0, 12_100.0), "They look like feet, 3,688 to 8,849 m: state it: --set z_unit=ft"),
    ((1e25, 1e24), "Give heights in metres; or another column has the heights: --columns z=NAME."),
    ((900.0, 910.0, 905.0, 920.0, 903.0, 904.0, 272_692.3),
     "The other 6 are between 900 and 920 m: correct it, or leave it out: --off h.")])
def test_heights_of_no_ground_are_refused(heights: tuple[float, ...], unit: str, crs: str) -> None:
    features = _at_heights(crs, (np.nan, *heights))
    with pytest.raises(TermselError, match="beyond any ground: that of the Earth") as caught:
        check_ground(features)
    worst = next(i for i, height in enumerate(heights, 1) if abs(height) > 12_000)
    assert (caught.value.column, caught.value.ids) == ("z", ("abcdefghij"[worst],))
    assert f"the height {heights[worst - 1]:,.10g} of " in str(caught.value)
    assert unit in str(caught.value)
    check_ground(replace(features, crs="local"))


def test_heights_of_the_earth_are_taken() -> None:
    for crs, heights, unit in (("EPSG:4979", (8_849.0, -430.0), None),
                               ("EPSG:4979", (29_032.0, 100.0), "ft"),
                               ("EPSG:32631", (29_032.0, 100.0), "us-ft")):
        check_ground(_at_heights(crs, (np.nan, *heights)), unit)
        assert not note_on_wrong_coordinates(_at_heights(crs, heights[1:]))
    with pytest.raises(TermselError, match="beyond any ground"):
        check_ground(_at_heights("EPSG:32631", (60_000.0, 100.0)), "ft")


def test_heights_below_any_land_are_doubted() -> None:
    note = note_on_wrong_coordinates(_at_heights("EPSG:4979", (-1508.0, 20.0, -2176.0)))
    assert note.startswith("2 heights are below any land, such as -1,508 m at a.")
    assert "heights upwards" in note


def test_columns_name_the_unit_of_heights(tmp_path: Path) -> None:
    rows = [f"{i},{10 * i},{i * i},{5 + i / 100},{44 + i * i / 100},{1500 + i}"
            for i in range(4)]
    for name, factor in (("z [mm]", 1000), ("z [cm]", 100)):
        file = tmp_path / "a.csv"
        text = [",".join([*row.split(",")[:5], str(factor * float(row.split(",")[5]))])
                for row in rows]
        file.write_text("\n".join([f"id,line,sample,x,y,{name}", *text]) + "\n")
        assert termsel.read(file, crs="EPSG:4979").points.ground[3, 2] == pytest.approx(1503)


def test_is_geographic() -> None:
    assert is_geographic("OGC:CRS84")
    assert not is_geographic("EPSG:32631")
    assert not is_geographic("local")
    pytest.importorskip("pyproj")
    assert is_geographic("EPSG:4258")
    assert not is_geographic("EPSG:3857")
    assert not is_geographic("EPSG:4978")


@pytest.mark.parametrize(("crs", "xy"), [
    ("EPSG:4979", [(-180, -90), (180, 90)]), ("EPSG:4326", [(359, 10)]),
    ("EPSG:4258", [(5, 44)]), ("EPSG:32631", [(500_000, 4_880_000)]),
    ("EPSG:32621", [(560_000, -3_800_000)]), ("EPSG:32721", [(560_000, 6_130_000)]),
    ("EPSG:2100", [(268_968.6, 4_488_342.0)]), ("EPSG:3857", [(15_114_673.7, 4_155_984.2)]),
    ("EPSG:4978", [(6_340_000, 400_000)]), ("local", [(5, 44)]), ("local", [(1e9, -1e9)]),
    ("EPSG:3857", [(40, 60), (2000, 5000), (7000, 3000), (9000, 9000)]),
    ("EPSG:32631", []), ("EPSG:4979", [])])
def test_coordinates_that_fit(crs: str, xy: list[tuple[float, float]]) -> None:
    check_ground(ground(crs, *xy))


@pytest.mark.parametrize(("crs", "xy", "words"), [
    ("EPSG:4979", [(5, 44), (5, 91)], "'p1' with x = 5, y = 91"),
    ("EPSG:4979", [(5, 44), (5, 190)], "x and y look swapped"),
    ("EPSG:4979", [(5, 44), (-181, 9)], "'p1' with x = -181, y = 9"),
    ("EPSG:4326", [(-34.9, -56.2), (44.0, 145.5)],
     "x and y look swapped: --set swapped=xy exchanges them"),
    ("EPSG:4979", [(500_000, 4_880_000)], "look like metres: state the projected CRS with --crs"),
    ("EPSG:4258", [(500_000, 4_880_000)], "look like metres"),
    ("EPSG:4979", [(5, 44), (6, 45), (500_000, 45)], "'p2' with x = 500000, y = 45"),
    ("EPSG:32631", [(5.2, 44.1), (5.3, 44.2)], "In place of EPSG:32631 state --crs EPSG:4979"),
    ("EPSG:4978", [(5.2, 44.1)], "look like longitude, latitude and height: state --crs EPSG:4979"),
    ("EPSG:4978", [(4_000_000, 400_000)], "from the centre of the Earth"),
    ("EPSG:2100", [(21.2, 40.5)], "look like degrees"),
    ("EPSG:32631", [(4_880_000, 500_000)], "x and y look swapped: --set swapped=xy exchanges them"),
    ("EPSG:32731", [(6_130_000, 560_000)], "x and y look swapped: --set swapped=xy exchanges them"),
    ("EPSG:32631", [(500_000, 4_880_000), (1_500_000, 4_880_000)], "'p1' with x = 1500000"),
    ("EPSG:32631", [(3.1, 41.7), (500_000, 4_880_000), (507_000, 4_890_000)],
     "1 of 3 points looks like degrees, but EPSG:32631 is a projected CRS: 'p0' with"),
    ("EPSG:2100", [(268_968, 4_488_342), (21.2, 40.5), (21.3, 40.6)], "2 of 3 points look like"),
    ("EPSG:32631", [(500_000, 4_880_000), (4_880_000, 500_000)], "Perhaps x and y are swapped"),
    ("EPSG:32631", [(500_000, 12_000_000)], "easting and northing in EPSG:32631"),
    ("EPSG:32731", [(500_000, -3_800_000)], "easting and northing in EPSG:32731")])
def test_coordinates_that_cannot_be(crs: str, xy: list[tuple[float, float]], words: str) -> None:
    with pytest.raises(TermselError) as caught:
        check_ground(ground(crs, *xy))
    assert words in str(caught.value)
    assert caught.value.ids


def test_one_wild_value_is_not_called_metres() -> None:
    with pytest.raises(TermselError) as caught:
        check_ground(ground("EPSG:4979", (5, 44), (6, 45), (500_000, 45)))
    assert "metres" not in str(caught.value)


def test_vertices_of_lines_are_checked() -> None:
    lines = Lines(("l", "m"), [[[0, 0], [1, 1]]] * 2,
                  [[[5, 44, 0], [6, 44, 0]], [[5, 45, 0], [6, 145, 0]]])
    with pytest.raises(TermselError, match="'m' with x = 6, y = 145"):
        check_ground(FeatureSet(empty_points(), lines, crs="EPSG:4979"))


@pytest.mark.usefixtures("_no_pyproj")
def test_wkt_tells_its_code_without_pyproj() -> None:
    base = 'GEOGCRS["WGS 84",DATUM["x",ELLIPSOID["y",1,2]],ID["EPSG",4326]]'
    assert normalise(base) == "EPSG:4326"
    assert normalise(f'PROJCRS["a",{base},ID["EPSG",32631]]\n') == "EPSG:32631"
    assert normalise('GEOGCS["a",DATUM["x"],AUTHORITY["EPSG","4326"]]') == "EPSG:4326"
    with pytest.raises(TermselError, match="unknown CRS"):
        normalise("EPSG:" + "4" * 5000)
    for own in (f'PROJCRS["a",CS[Cartesian,2],{base}]', f'COMPOUNDCRS["a",PROJCRS["b"],{base}]'):
        assert normalise(own) == own


@pytest.mark.usefixtures("_no_pyproj")
def test_without_pyproj_a_code_that_nothing_checks_is_named_once(
        caplog: pytest.LogCaptureFixture) -> None:
    for name in ("EPSG:0", "EPSG:0", "EPSG:32639", "EPSG:4326", "local"):
        normalise(name)
    assert [record.message.partition(".")[0] for record in caplog.records] == [
        "Note: pyproj is not installed, so nothing checks that EPSG:0 exists"]


def test_planes_of_two_datums_are_never_copied_as_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    pyproj = pytest.importorskip("pyproj")
    asked = []
    real = pyproj.Transformer.from_crs

    def refuse(*ends: object, **options: object) -> object:
        asked.append(options["allow_ballpark"])
        if not options["allow_ballpark"]:
            raise pyproj.exceptions.ProjError("no operation")
        return real(*ends, **options)

    monkeypatch.setattr(pyproj.Transformer, "from_crs", refuse)
    with pytest.raises(TermselError, match=r"EPSG:26711 cannot be transformed to EPSG:26911: PROJ "
                                           r"does not have the grid ca_nrc_ntv2_0.tif") as error:
        plane_transformer("EPSG:26711", "EPSG:26911")
    assert "choose a CRS of the same datum" in str(error.value.hint)
    # Old maps state an ellipsoid alone, and the Moon has one datum.
    plane_transformer("+proj=longlat +a=6377397 +b=6356079 +type=crs", "EPSG:4326")
    plane_transformer("IAU_2015:30100", "IAU_2015:30110")
    assert asked == [False, True, True]


@pytest.mark.parametrize(("text", "meant"), [
    ("Gauss-Krueger zone 3", "EPSG:31467 (DHDN / 3-degree Gauss-Kruger zone 3)"),
    ("lambert 93", "EPSG:2154 (RGF93 v1 / Lambert-93)"),
    ("Lambert zone II", "EPSG:27572 (NTF (Paris) / Lambert zone II)")])
def test_a_crs_in_other_words_is_looked_up_by_them(text: str, meant: str) -> None:
    with pytest.raises(TermselError, match=re.escape(f"Did you mean {meant}")):
        normalise(text)
