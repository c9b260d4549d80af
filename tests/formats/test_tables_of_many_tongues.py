"""Tables as people of many countries and programs have them: read right, or said what is open."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import termsel
from termsel import TermselError

N = 8
_rng = np.random.default_rng(7)
SAMPLE = np.round(_rng.uniform(50, 3950, N), 1)
LINE = np.round(_rng.uniform(50, 2950, N), 1)
COLUMNS = {
    "id": [f"P{i + 1}" for i in range(N)], "line": LINE, "sample": SAMPLE,
    "x": np.round(560_000 + 0.5 * SAMPLE + _rng.normal(0, 0.2, N), 2),
    "y": np.round(5_200_000 - 0.5 * LINE + _rng.normal(0, 0.2, N), 2),
    "lon": np.round(15.8 + 5e-6 * SAMPLE + _rng.normal(0, 2e-6, N), 7),
    "lat": np.round(46.9 - 5e-6 * LINE + _rng.normal(0, 2e-6, N), 7),
    "z": np.round(_rng.uniform(200, 260, N), 1),
    "rmse": np.round(_rng.uniform(0.1, 2.0, N), 2), "photo": ["DJI_0012.JPG"] * N}


def written(path: Path, header: str, meanings: str, *, sign: str = ".", end: str = "\n",
            encoding: str = "utf-8", separator: str = ";") -> Path:
    """Write a table with the columns of some meanings."""
    rows = zip(*(COLUMNS[name] for name in meanings.split()), strict=True)
    texts = [header.replace(";", separator), *(
        separator.join(cell if isinstance(cell, str) else f"{cell:.10g}".replace(".", sign)
                       for cell in row) for row in rows)]
    path.write_bytes((end.join(texts) + end).encode(encoding))
    return path


READ = {
    "French": ("Point;Ligne;Colonne;X_L93;Y_L93;Altitude", "id line sample x y z"),
    "French degrees": ("N°;Colonne (px);Ligne (px);Longitude (°);Latitude (°);Altitude (m)",
                       "id sample line lon lat z"),
    "German": ("Passpunkt;Bildspalte;Bildzeile;Ostwert [m];Nordwert [m];Höhe [m]",
               "id sample line x y z"),
    "German degrees": ("Pkt-Nr.;Bild x [px];Bild y [px];Länge;Breite;Höhe ü. NN",
                       "id sample line lon lat z"),
    "Spanish": ("Punto;Columna;Fila;Este;Norte;Cota", "id sample line x y z"),
    "Portuguese": ("Ponto;Coluna;Linha;Leste;Norte;Altitude", "id sample line x y z"),
    "Italian": ("nome;colonna;riga;longitudine;latitudine;quota", "id sample line lon lat z"),
    "Polish": ("Punkt;Wiersz;Kolumna;Wschód;Północ;Wysokość", "id line sample x y z"),
    "Polish degrees": ("Nr;kolumna;wiersz;długość;szerokość;wysokość", "id sample line lon lat z"),
    "Dutch": ("Punt;Rij;Kolom;Oost;Noord;Hoogte", "id line sample x y z"),
    "Dutch degrees": ("naam;kolom;regel;lengtegraad;breedtegraad;hoogte",
                      "id sample line lon lat z"),
    "ArcGIS": ("GCP;POINT_X;POINT_Y;POINT_Z;IMG_X;IMG_Y", "id x y z sample line"),
    "a drone's": ("GCP Label;Image;Pixel X;Pixel Y;Longitude;Latitude;Height",
                  "id photo sample line lon lat z"),
    "pixels": ("id;lat;lon;px;py", "id lat lon sample line"),
}


@pytest.mark.parametrize("name", READ)
def test_a_table_of_another_country_is_read(name: str, tmp_path: Path) -> None:
    header, meanings = READ[name]
    degrees = "lon" in meanings
    path = written(tmp_path / "points.csv", header, meanings, sign=",", end="\r\n",
                   encoding="utf-8-sig")
    points = termsel.read(path, crs="EPSG:4326" if degrees else "EPSG:32633").points
    assert points.ids == tuple(COLUMNS["id"])
    np.testing.assert_array_equal(points.image, np.column_stack([LINE, SAMPLE]))
    names = ("lon", "lat") if degrees else ("x", "y")
    np.testing.assert_array_equal(points.ground[:, :2],
                                  np.column_stack([COLUMNS[name] for name in names]))
    if "z" in meanings.split():
        np.testing.assert_array_equal(points.ground[:, 2], COLUMNS["z"])


@pytest.mark.parametrize(("name", "encoding"), [("Polish", "cp1250"), ("Polish", "iso8859-2"),
                                                ("German", "cp1252"), ("French", "cp1252"),
                                                ("Polish degrees", "cp1250")])
def test_names_tell_the_encoding(name: str, encoding: str, tmp_path: Path) -> None:
    header, meanings = READ[name]
    path = written(tmp_path / "points.csv", header, meanings, encoding=encoding)
    assert len(termsel.read(path, crs="local").points) == N


@pytest.mark.parametrize(("header", "meanings", "guess"), [
    ("gcp;i;j;easting;northing;elev;rmse", "id line sample x y z rmse",
     "id=gcp,line=i,sample=j,x=easting,y=northing,z=elev"),
    ("id;u;v;easting;northing;what", "id sample line x y z",
     "id=id,line=v,sample=u,x=easting,y=northing,z=what"),
    ("id;height?;u;v;easting;northing", "id z sample line x y",
     "id=id,line=v,sample=u,x=easting,y=northing,z=height?"),
    ("id;line;sample;a;b;c", "id line sample y x z", "id=id,line=line,sample=sample,x=b,y=a,z=c"),
    ("id;line;sample;rmse;a;b;c", "id line sample rmse x y z",
     "id=id,line=line,sample=sample,x=a,y=b,z=c"),
])
def test_a_pair_that_the_other_explains_is_guessed(header: str, meanings: str, guess: str,
                                                   tmp_path: Path) -> None:
    path = written(tmp_path / "points.csv", header, meanings)
    with pytest.raises(TermselError, match="This mapping is a guess") as caught:
        termsel.read(path, crs="EPSG:32633")
    assert caught.value.guesses[0] == guess
    # What is shown fits the CRS: exchanged, the ground would be in no zone of UTM.
    for shown in caught.value.guesses:
        termsel.read(path, crs="EPSG:32633", columns=shown)
    assert len(caught.value.guesses) == (1 if ";a;b" in header else 2)


def test_two_pairs_of_ground_are_both_shown(tmp_path: Path) -> None:
    path = written(tmp_path / "points.csv", "id;line;sample;x;y;z;lat;lon",
                   "id line sample x y z lat lon")
    with pytest.raises(TermselError, match="both mean x") as caught:
        termsel.read(path, crs="EPSG:32633")
    assert caught.value.guesses == ["id=id,line=line,sample=sample,x=x,y=y,z=z"]
    with pytest.raises(TermselError, match="both mean x") as caught:
        termsel.read(path)
    assert caught.value.guesses == ["id=id,line=line,sample=sample,x=x,y=y,z=z",
                                    "id=id,line=line,sample=sample,x=lon,y=lat,z=z"]


@pytest.mark.parametrize("separator", [" ", ",", "\t"])
def test_a_header_in_a_comment_is_a_header(separator: str, tmp_path: Path) -> None:
    path = written(tmp_path / "points.txt", "# id;sample;line;x;y;z", "id sample line x y z",
                   separator=separator)
    path.write_text(f"# crs: EPSG:32633\n# by Ana\n{path.read_text()}")
    features = termsel.read(path)
    assert features.crs == "EPSG:32633"
    np.testing.assert_array_equal(features.points.image, np.column_stack([LINE, SAMPLE]))
    assert features.points.ids == tuple(COLUMNS["id"])


@pytest.mark.parametrize("header", ["Photo", "map_id", "Scan No", "SceneID"])
def test_points_of_several_images_are_not_one_image(header: str, tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text(f"Label,{header},line,sample,x,y,z\n" + "".join(
        f"G{i // 2},{'ab'[i % 2]}.jpg,{LINE[i]},{SAMPLE[i]},{COLUMNS['x'][i]},{COLUMNS['y'][i]},9\n"
        for i in range(N)))
    with pytest.raises(TermselError, match=r"points of the images a\.jpg \(4\), b\.jpg \(4\)"):
        termsel.read(path, crs="EPSG:32633")
    points = termsel.read(path, crs="EPSG:32633", image_name="b.jpg").points
    assert points.ids == ("G0", "G1", "G2", "G3")
    with pytest.raises(TermselError, match=r"points of the images a\.jpg \(4\), b\.jpg \(4\)"):
        termsel.read(path, crs="EPSG:32633", image_name="c.jpg")


def test_an_image_of_a_table_that_names_none(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text("id,line,sample,x,y,z\na,1,2,3,4,5\nb,2,3,4,5,6\n")
    with pytest.raises(TermselError, match="no point of this file names its image") as caught:
        termsel.read(path, crs="local", image_name="a.jpg")
    assert caught.value.file == path
    assert "Leave image_name=NAME out" in str(caught.value.hint)


@pytest.mark.parametrize(("scale", "shift", "hint"), [
    (1.0, 33e6, "x begins with the zone, 33: take these digits off, or state the CRS"),
    (1 / 0.3048, 0.0, "In feet they would be within the zone"),
])
def test_coordinates_outside_a_zone_are_explained(scale: float, shift: float, hint: str) -> None:
    table = {"line": LINE, "sample": SAMPLE, "x": COLUMNS["x"] * scale + shift,
             "y": COLUMNS["y"] * scale}
    with pytest.raises(TermselError, match="cannot be easting and northing") as caught:
        termsel.read(table, crs="EPSG:32633")
    assert hint in str(caught.value.hint)
