"""Files whose x and y, or line and sample, are exchanged: one option mends them in any format."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import termsel
from termsel import TermselError
from tests.fuzz.readers import _exported

rng = np.random.default_rng(3)
SEEN = rng.uniform(100, 4000, (12, 2)).round(2)
EAST, NORTH = 11 + 1e-5 * SEEN[:, 1], 47 - 1e-5 * SEEN[:, 0]
IDS = [f"P{i}" for i in range(12)]


def text(header: str, *columns: object) -> str:
    return "\n".join([header, *(",".join(map(str, row)) for row in zip(*columns, strict=True))])


def geojson(x: np.ndarray, y: np.ndarray, line: np.ndarray, sample: np.ndarray) -> str:
    points = [{"type": "Feature", "id": IDS[i],
               "properties": {"line": line[i], "sample": sample[i]},
               "geometry": {"type": "Point", "coordinates": [x[i], y[i]]}} for i in range(12)]
    return json.dumps({"type": "FeatureCollection", "features": points})


LINE, SAMPLE = SEEN.T
FILES = {
    "qgis.points": (text("mapX,mapY,sourceX,sourceY,enable", NORTH, EAST, SAMPLE + 0.5,
                         -LINE - 0.5, [1] * 12), "xy"),
    "own names.csv": (text("Nr,Rechtswert,Hochwert,Zeile,Spalte", IDS, NORTH, EAST, LINE, SAMPLE),
                      "xy"),
    "image.csv": (text("id,x,y,line,sample", IDS, EAST, NORTH, SAMPLE, LINE), "line-sample"),
    "points.geojson": (geojson(NORTH, EAST, LINE, SAMPLE), "xy"),
    "image.geojson": (geojson(EAST, NORTH, SAMPLE, LINE), "line-sample")}


@pytest.mark.parametrize("name", FILES)
def test_the_warning_names_an_option_that_mends_the_file(
        name: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    content, choice = FILES[name]
    path = tmp_path / name
    path.write_text(content)
    termsel.read(path, crs="EPSG:4326")
    assert f"swapped={choice!r} exchanges them" in caplog.text
    caplog.clear()
    features = termsel.read(path, crs="EPSG:4326", swapped=choice)
    assert "swapped" not in caplog.text
    np.testing.assert_allclose(features.points.image, SEEN)
    np.testing.assert_allclose(features.points.ground[:, :2], np.column_stack([EAST, NORTH]))


@pytest.mark.parametrize("name", sorted(_exported()))
def test_every_reader_takes_it(name: str, tmp_path: Path) -> None:
    files = _exported()[name]
    for file, content in files.items():
        (tmp_path / file).write_bytes(content)
    path = tmp_path / ("a.txt" if "a.txt" in files else min(files))
    crs = None if _states_crs(path, name) else "local"
    as_it_stands = termsel.read(path, format=name, crs=crs)
    points, lines = as_it_stands.points, as_it_stands.lines
    exchanged = termsel.read(path, format=name, crs=crs, swapped="xy")
    np.testing.assert_array_equal(exchanged.points.ground, points.ground[:, [1, 0, 2]])
    np.testing.assert_array_equal(exchanged.lines.ground, lines.ground[..., [1, 0, 2]])
    np.testing.assert_array_equal(exchanged.points.image, points.image)


def _states_crs(path: Path, reader: str) -> bool:
    try:
        termsel.read(path, format=reader)
    except TermselError:
        return False
    return True


def test_an_own_table_and_lines_take_it() -> None:
    rows = {"id": IDS, "x": EAST, "y": NORTH, "line": SAMPLE, "sample": LINE,
            "sigma_line": [0.5] * 12, "sigma_sample": [2.0] * 12}
    features = termsel.read(rows, crs="EPSG:4326", swapped="line-sample")
    np.testing.assert_allclose(features.points.image, SEEN)
    assert features.points.sigma is not None
    assert features.points.sigma[0].tolist() == [2.0, 0.5]


def test_another_word_is_refused(tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text(FILES["image.csv"][0])
    with pytest.raises(TermselError, match="swapped"):
        termsel.read(tmp_path / "p.csv", crs="EPSG:4326", swapped="yes")
