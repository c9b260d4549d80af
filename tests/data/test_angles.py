"""Longitudes and latitudes in grads, from Greenwich and from elsewhere."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import termsel
from termsel.data.coordinates.earth import degrees_of
from termsel.data.coordinates.metres import offsets_in_metres

pyproj = pytest.importorskip("pyproj")


def table(folder: Path, crs: str, header: str = "x,y") -> Path:
    path = folder / "control.csv"
    rows = [[-4.25 + 0.01 * i, 53.9 - 0.003 * i * i, 5.0 * i, 7.0 * i * i] for i in range(5)]
    path.write_text("\n".join([f"# crs: {crs}", f"{header},line,sample", *(
        ",".join(map(str, row)) for row in rows)]))
    return path


# NTF, Voirol 1875 and Tananarive, all of Paris.
@pytest.mark.parametrize("crs", ["EPSG:4807", "EPSG:4811", "EPSG:4810"])
def test_grads_become_degrees_of_the_same_datum(crs: str, tmp_path: Path) -> None:
    path = table(tmp_path, crs)
    read = termsel.read(path)
    raw = np.loadtxt(path, delimiter=",", skiprows=2)[:, :2]
    np.testing.assert_allclose(read.points.ground[:, :2], 0.9 * raw, rtol=1e-14)
    before = pyproj.Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    after = pyproj.Transformer.from_crs(read.crs, "EPSG:4326", always_xy=True)
    np.testing.assert_allclose(after.transform(*read.points.ground[:, :2].T),
                               before.transform(*raw.T), rtol=0, atol=1e-11)


def test_a_grad_to_the_north_is_a_hundred_kilometres(tmp_path: Path) -> None:
    """The metre was once the ten millionth part of a quadrant of the meridian."""
    read = termsel.read(table(tmp_path, "EPSG:4807"))
    north = offsets_in_metres(read.crs, read.points.ground[:1, :2], np.array([[0.0, 0.9]]))
    assert north is not None
    assert north[0, 1] == pytest.approx(1e5, rel=0.005)


@pytest.mark.parametrize(("crs", "lon"), [
    ("EPSG:4807", 2.3372 - 0.9 * 4.23),     # Paris, in grads
    ("EPSG:4805", -17.6667 - 4.23),         # Ferro, in degrees
    ("EPSG:4326", -4.23)])
def test_the_place_counts_from_greenwich(crs: str, lon: float, tmp_path: Path) -> None:
    read = termsel.read(table(tmp_path, crs))
    place = degrees_of(read.crs, read.points.ground)
    assert place is not None
    assert place[0] == pytest.approx(lon, abs=0.01)


def test_columns_in_gons_by_their_names_are_converted_once(tmp_path: Path) -> None:
    by_crs = termsel.read(table(tmp_path, "EPSG:4807"))
    named = termsel.read(table(tmp_path, "EPSG:4807", "lon (gon),lat (gon)"))
    assert named.crs == by_crs.crs
    np.testing.assert_allclose(named.points.ground, by_crs.points.ground, rtol=1e-13)
