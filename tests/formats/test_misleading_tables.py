"""Tables whose columns mislead: no wrong reading without a word.

Units, directions and factors in names and below them, angles in several columns, zones and codes
that contradict the CRS, and names in many languages.
"""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest

import termsel
from termsel import TermselError

N = 8
_rng = np.random.default_rng(60)
SAMPLE = np.round(_rng.uniform(50, 5900, N), 1)
LINE = np.round(_rng.uniform(50, 3900, N), 1)
Z = np.round(_rng.uniform(300, 900, N), 1)
EAST = np.round(412000 + 2.0 * SAMPLE, 2)
NORTH = np.round(5312000 - 2.0 * LINE, 2)
LON = np.round(13.85 + 2.7e-5 * SAMPLE, 7)
LAT = np.round(47.96 - 1.8e-5 * LINE, 7)
METRES, DEGREES = "EPSG:32633", "EPSG:4326"


def write(folder: Path, header: str, *columns: object, encoding: str = "utf-8") -> Path:
    """Write a table whose columns are arrays, lists or one cell for all rows; return its path."""
    cells = [[str(column)] * N if isinstance(column, str) else list(map(str, column))
             for column in columns]
    rows = [";".join(row) for row in zip(*cells, strict=True)]
    path = folder / "table.csv"
    path.write_text("\n".join([header, *rows]), encoding=encoding)
    return path


def parts(angle: float) -> tuple[int, int, float]:
    """Return degrees, minutes and seconds of an angle."""
    degrees = int(angle)
    minutes = int((angle - degrees) * 60)
    return degrees, minutes, round((angle - degrees - minutes / 60) * 3600, 5)


LAT_D, LAT_M, LAT_S = zip(*map(parts, LAT), strict=True)
LON_D, LON_M, LON_S = zip(*map(parts, LON), strict=True)

READ = {
    "hemispheres in columns": ("row;col;lat;ns;lon;ew", (LINE, SAMPLE, LAT, "S", LON, "W"),
                               DEGREES, -LON, -LAT, None),
    "hemispheres beside signs": ("row;col;lat;lat_ref;lon;lon_ref",
                                 (LINE, SAMPLE, -LAT, "S", LON, "E"), DEGREES, LON, -LAT, None),
    "a direction in brackets": ("row;col;lat (S);Longitude [°W]", (LINE, SAMPLE, LAT, LON),
                                DEGREES, -LON, -LAT, None),
    "a direction as a suffix": ("row;col;lat N;lon W", (LINE, SAMPLE, LAT, LON),
                                DEGREES, -LON, LAT, None),
    "a direction beside signs": ("row;col;lat (N);lon (W)", (LINE, SAMPLE, LAT, -LON),
                                 DEGREES, -LON, LAT, None),
    "degrees, minutes, seconds": ("lat_d;lat_m;lat_s;lon_d;lon_m;lon_s;row;col",
                                  (LAT_D, LAT_M, LAT_S, LON_D, LON_M, LON_S, LINE, SAMPLE),
                                  DEGREES, LON, LAT, None),
    "parts without names": ("lat;min;sec;lon;min;sec;row;col",
                            (LAT_D, LAT_M, LAT_S, LON_D, LON_M, LON_S, LINE, SAMPLE),
                            DEGREES, LON, LAT, None),
    "parts and a side": ("lat deg;lat min;lat sec;lon deg;lon min;lon sec;side;row;col",
                         (LAT_D, LAT_M, LAT_S, LON_D, LON_M, LON_S, "W", LINE, SAMPLE),
                         DEGREES, -LON, LAT, None),
    "seconds of arc": ("row;col;lat [arcsec];lon [arcsec]",
                       (LINE, SAMPLE, np.round(LAT * 3600, 3), np.round(LON * 3600, 3)),
                       DEGREES, LON, LAT, None),
    "heights in centimetres": ("row;col;E;N;H [cm]",
                               (LINE, SAMPLE, EAST, NORTH, np.round(Z * 100)), METRES, EAST, NORTH,
                               Z),
    "millimetres": ("row;col;E [mm];N [mm]",
                    (LINE, SAMPLE, np.round(EAST * 1000), np.round(NORTH * 1000)), METRES, EAST,
                    NORTH, None),
}


@pytest.mark.parametrize("kind", READ)
def test_names_say_what_numbers_are(kind: str, tmp_path: Path,
                                    caplog: pytest.LogCaptureFixture) -> None:
    header, columns, crs, x, y, z = READ[kind]
    with caplog.at_level(logging.INFO, logger="termsel"):
        points = termsel.read(write(tmp_path, header, *columns), crs=crs).points
    np.testing.assert_allclose(points.image, np.column_stack([LINE, SAMPLE]), atol=1e-9)
    within = 2e-7 if crs == DEGREES else 1e-6
    np.testing.assert_allclose(points.ground[:, :2], np.column_stack([x, y]), atol=within)
    if z is not None:
        np.testing.assert_allclose(points.ground[:, 2], z, atol=1e-6)
    # What was changed is said, but for numbers that have their sign already.
    if "beside signs" not in kind:
        assert any(words in caplog.text for words in ("by its name", "on which side", "one angle"))


@pytest.mark.parametrize(("header", "cells"), [
    ("row;col;lat;lon;status", ["N", "S"] * (N // 2)), ("row;col;lat;lon;quality", "E"),
    ("row;col;lat;lon;note;seen", "O")])
def test_letters_of_other_columns_are_no_sides(header: str, cells: str | list[str],
                                               tmp_path: Path) -> None:
    columns = [LINE, SAMPLE, LAT, LON, *(["ok"] if "note" in header else []), cells]
    ground = termsel.read(write(tmp_path, header, *columns), crs=DEGREES).points.ground
    np.testing.assert_array_equal(ground[:, :2], np.column_stack([LON, LAT]))


def test_points_on_both_sides_of_the_equator(tmp_path: Path) -> None:
    north = np.arange(N) % 2 == 0
    latitude = np.where(north, 0.1, 0.2) + LAT - 47.9
    path = write(tmp_path, "row;col;lat;ns;lon", LINE, SAMPLE, latitude,
                 ["N" if is_north else "S" for is_north in north], LON)
    ground = termsel.read(path, crs=DEGREES).points.ground
    np.testing.assert_allclose(ground[:, 1], np.where(north, latitude, -latitude))


def test_an_o_beside_longitudes_is_asked(tmp_path: Path) -> None:
    path = write(tmp_path, "fila;columna;latitud;longitud;hemisferio", LINE, SAMPLE, LAT, LON, "O")
    with pytest.raises(TermselError, match="east in German and west in Romance"):
        termsel.read(path, crs=DEGREES)


def test_a_row_of_units_counts(tmp_path: Path) -> None:
    path = write(tmp_path, "row;col;E;N;H\npx;px;km;km;m", LINE, SAMPLE,
                 np.round(EAST / 1000, 5), np.round(NORTH / 1000, 5), Z)
    ground = termsel.read(path, crs=METRES).points.ground
    np.testing.assert_allclose(ground, np.column_stack([EAST, NORTH, Z]), atol=1e-6)


@pytest.mark.parametrize(("header", "words"), [
    ("row (1-based);col (1-based);E;N", "'1-based'"), ("row;col;E (+400000);N", r"'\+400000'"),
    ("row;col;E (x 10);N", "'x 10'")])
def test_what_brackets_say_and_nobody_knows_is_said(header: str, words: str, tmp_path: Path,
                                                    caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO, logger="termsel"):
        termsel.read(write(tmp_path, header, LINE, SAMPLE, EAST, NORTH), crs=METRES)
    assert f"what {words}".replace("\\", "") in caplog.text


@pytest.mark.parametrize("unit", ["mm", "µm", "%", "inch"])
def test_image_coordinates_are_pixels(unit: str, tmp_path: Path) -> None:
    path = write(tmp_path, f"row ({unit});col ({unit});E;N", LINE, SAMPLE, EAST, NORTH)
    with pytest.raises(TermselError, match="image coordinates are pixels"):
        termsel.read(path, crs=METRES)


def test_angles_of_two_signs_have_no_direction_in_the_name(tmp_path: Path) -> None:
    mixed = np.where(np.arange(N) == 3, -LON, LON)
    with pytest.raises(TermselError, match="negative here, and not in other rows") as caught:
        termsel.read(write(tmp_path, "row;col;lat;lon (W)", LINE, SAMPLE, LAT, mixed), crs=DEGREES)
    assert caught.value.line == 5


@pytest.mark.parametrize(("name", "cells", "words"), [
    ("zone", "32N", "says 32N"), ("UTM zone", "32", "says 32,"), ("epsg", "32632", "says 32632"),
    ("zone", ["32N", "33N"] * (N // 2), "32N and 33N"), ("zone", "33N", ""), ("zone", "east", ""),
    ("crs", "EPSG:32633", "")])
def test_a_column_of_another_crs_is_said(name: str, cells: str | list[str], words: str,
                                         tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write(tmp_path, f"{name};row;col;E;N", cells, LINE, SAMPLE, EAST, NORTH)
    termsel.read(path, crs=METRES)
    assert words in caplog.text
    assert bool(words) == (f"Column {name!r}" in caplog.text)


@pytest.mark.parametrize(("name", "cells"), [("zone", "33N"), ("srid", "32633")])
def test_a_column_tells_the_crs_that_nobody_states(name: str, cells: str, tmp_path: Path) -> None:
    path = write(tmp_path, f"{name};row;col;E;N", cells, LINE, SAMPLE, EAST, NORTH)
    with pytest.raises(TermselError, match=f"column '{name}' says EPSG:32633") as caught:
        termsel.read(path)
    assert caught.value.options["--crs"] == METRES


@pytest.mark.parametrize(("factor", "form"), [(100, "DDMM.mm"), (10_000, "DDMMSS.ss")])
def test_minutes_in_one_number_with_degrees_are_no_metres(factor: int, form: str,
                                                          tmp_path: Path) -> None:
    joined = [[d * factor + (m + s / 60 if factor == 100 else m * 100 + s)
               for d, m, s in map(parts, angles)] for angles in (LAT, LON)]
    path = write(tmp_path, "row;col;lat;lon", LINE, SAMPLE, *joined)
    with pytest.raises(TermselError, match=form):
        termsel.read(path, crs=DEGREES)


@pytest.mark.parametrize(("header", "encoding"), [
    ("bod;řádek;sloupec;zeměpisná šířka;zeměpisná délka;výška", "utf-8"),
    ("точка;строка;столбец;широта;долгота;высота", "utf-8"),
    ("точка;строка;столбец;широта;долгота;высота", "cp1251"),
    ("点番号;行;列;緯度;経度;標高", "utf-8"), ("점;행;열;위도;경도;고도", "utf-8"),
    ("nokta;satır;sütun;enlem;boylam;yükseklik", "utf-8"),
    ("pont;sor;oszlop;szélesség;hosszúság;magasság", "utf-8"),
    ("punkt;rad;kolumn;latitud;longitud;höjd", "utf-8"),
    ("σημείο;γραμμή;στήλη;γεωγραφικό πλάτος;γεωγραφικό μήκος;υψόμετρο", "utf-8"),
    ("точка;ряд;колонка;север;восток;высота", "cp1251"),
    ("Точка;Y пикс;X пикс;Северная (м);Восточная (м);Высота", "utf-8"),
    ("точка;строка;столбец;широта;долгота;высота", "koi8-r"),
    ("точка;строка;столбец;широта;долгота;высота", "cp866"),
    ("点番号;行;列;緯度;経度;標高", "shift_jis"), ("점;행;열;위도;경도;고도", "euc-kr"),
    ("點號;行;列;緯度;經度;高程", "big5"), ("nokta;satır;sütun;enlem;boylam;yükseklik", "cp1254"),
    ("σημείο;γραμμή;στήλη;γεωγραφικό πλάτος;γεωγραφικό μήκος;υψόμετρο", "cp1253"),
    ("点号;行;列;北;东;高程", "gb18030"), ("点号;行;列;北向;东向;高程", "utf-8"),
    ("punto;renglón;columna;Y terreno;X terreno;cota", "utf-8"),
    ("punto;Y imagen;X imagen;Norte;Este;cota", "cp1252"), ("punto;fil;col;Norte;Este;h", "utf-8"),
    ("точка;строка;столбец;X (север);Y (восток);H", "utf-8"),
    ("id;Y (row);X (col);X [North];Y [East];h", "utf-8"),
    ("点号;影像行;影像列;X（北）;Y（东）;高程", "gb18030"),
    ("nazwa;wiersz;kolumna;szerokość;długość;wysokość", "cp1250")])
def test_names_are_known_in_many_languages(header: str, encoding: str, tmp_path: Path) -> None:
    ids = [f"K{i}" for i in range(N)]
    path = write(tmp_path, header, ids, LINE, SAMPLE, LAT, LON, Z, encoding=encoding)
    points = termsel.read(path, crs="EPSG:4979").points
    assert points.ids == tuple(ids)
    np.testing.assert_array_equal(points.image, np.column_stack([LINE, SAMPLE]))
    np.testing.assert_array_equal(points.ground, np.column_stack([LON, LAT, Z]))


def test_a_guess_keeps_to_the_names_that_are_known(tmp_path: Path) -> None:
    path = write(tmp_path, "Север;Восток;coord1;coord2", NORTH, EAST, SAMPLE, LINE)
    with pytest.raises(TermselError) as caught:
        termsel.read(path, crs=METRES)
    assert caught.value.guesses
    assert all("x=Восток,y=Север" in guess for guess in caught.value.guesses)


@pytest.mark.parametrize("header", ["B;A;px1;px2", "px1;px2;B;A"])
def test_a_guess_beyond_the_area_of_the_crs_is_left_out(header: str, tmp_path: Path) -> None:
    ground, image = (NORTH, EAST), (LINE, SAMPLE)
    path = write(tmp_path, header, *(ground + image if header.startswith("B") else image + ground))
    with pytest.raises(TermselError) as caught:
        termsel.read(path, crs="EPSG:25833")
    assert caught.value.guesses
    assert all("x=A,y=B" in guess for guess in caught.value.guesses)
    # Where no guess lies in the area, the CRS may be another one.
    with pytest.raises(TermselError) as caught:
        termsel.read(path, crs="EPSG:31983")
    assert caught.value.guesses


def test_a_mirrored_plane_without_a_crs_is_said(tmp_path: Path,
                                                caplog: pytest.LogCaptureFixture) -> None:
    """Its y may point down as lines do; or the names of two columns are exchanged."""
    for header, is_mirrored in (("col;row;x;y", True), ("row;col;x;y", False)):
        caplog.clear()
        termsel.read(write(tmp_path, header, LINE, SAMPLE, EAST, NORTH), crs="local")
        assert ("the image mirrors the plane of x and y" in caplog.text) == is_mirrored


@pytest.mark.parametrize("header", [
    "im_y;im_x;geo_x;geo_y", "imgRow;imgCol;utm_e;utm_n", "Y_img;X_img;X_map;Y_map",
    "image row;image col;UTM East;UTM North"])
def test_prefixes_of_programs_are_known(header: str, tmp_path: Path) -> None:
    points = termsel.read(write(tmp_path, header, LINE, SAMPLE, EAST, NORTH), crs=METRES).points
    np.testing.assert_array_equal(points.image, np.column_stack([LINE, SAMPLE]))
    np.testing.assert_array_equal(points.ground[:, :2], np.column_stack([EAST, NORTH]))
