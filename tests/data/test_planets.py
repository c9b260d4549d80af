"""Ground coordinates of other bodies than the Earth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import termsel
from termsel import FeatureSet, Points, TermselError
from termsel.data.coordinates.crs import (
    body_of,
    ellipsoid_of,
    height_reference,
    normalise,
)
from termsel.data.coordinates.metres import offsets_in_metres

pyproj = pytest.importorskip("pyproj")

PIXEL, NOISE = 6.0, 0.3


def scene(crs: str, lon: float, lat: float, radius: float) -> FeatureSet:
    """Return points of a view from the side over hills, 20 km wide, lines to the south."""
    rng = np.random.default_rng(3)
    away = rng.uniform(-1e4, 1e4, (60, 2))
    z = 400.0 * np.sin(away[:, 0] / 4000) * np.cos(away[:, 1] / 5000)
    x = lon + np.degrees(away[:, 0] / (radius * np.cos(np.radians(lat))))
    y = lat + np.degrees(away[:, 1] / radius)
    image = np.column_stack([2000 - away[:, 1] / PIXEL, 2000 + (away[:, 0] + 0.3 * z) / PIXEL])
    roles = ("control", "check", "independent") * 20
    return FeatureSet(Points(tuple(f"P{i}" for i in range(60)),
                             image + rng.normal(0.0, NOISE, (60, 2)),
                             np.column_stack([x, y, z - 2500.0]), None, roles),
                      crs=crs, image_size=(4000, 4000))


BODIES = [("IAU_2015:49900", 137.4, -4.6, 3396190.0, "4.6 S, 137.4 E on Mars"),
          ("IAU_2015:49900", 222.6, -4.6, 3396190.0, "4.6 S, 137.4 W on Mars"),
          ("IAU_2015:30100", 23.4, 60.0, 1737400.0, "60.0 N, 23.5 E on the Moon"),
          ("ESRI:104905", 137.4, -4.6, 3396190.0, "4.6 S, 137.4 E on Mars")]


@pytest.mark.slow_cases(
    "ESRI:104905-137.4--4.6-3396190.0-4.6 S, 137.4 E on Mars",
    "IAU_2015:30100-23.4-60.0-1737400.0-60.0 N, 23.5 E on the Moon",
    "IAU_2015:49900-222.6--4.6-3396190.0-4.6 S, 137.4 W on Mars")
@pytest.mark.parametrize(("crs", "lon", "lat", "radius", "place"), BODIES)
def test_errors_in_metres_are_those_of_the_body(crs: str, lon: float, lat: float, radius: float,
                                                place: str) -> None:
    result = termsel.run("poly-terms", features=scene(crs, lon, lat, radius),
                         model="affine", solver="all-terms")
    rmse = result.rmse["independent"]
    assert rmse is not None
    assert rmse.total < 1.0
    assert place in result.summary()
    on_ground = result.to_dict()["accuracy"]["ground"]["total"]
    assert on_ground == pytest.approx(PIXEL * rmse.total, rel=0.03)


@settings(max_examples=40, deadline=None)
@given(st.sampled_from(["IAU_2015:49900", "IAU_2015:30100", "IAU_2015:19900", "EPSG:4267",
                        "EPSG:4979"]),
       st.floats(-80.0, 80.0), st.floats(-180.0, 180.0))
def test_metres_are_those_of_proj(crs: str, lat: float, lon: float) -> None:
    ellipsoid = pyproj.CRS(crs).ellipsoid
    geod = pyproj.Geod(a=ellipsoid.semi_major_metre, b=ellipsoid.semi_minor_metre)
    step = np.array([1e-4, -2e-4])
    found = offsets_in_metres(crs, np.array([[lon, lat, 0.0]]), step[None])
    assert found is not None
    distance = geod.inv(lon, lat, lon + step[0], lat + step[1])[2]
    assert np.linalg.norm(found) == pytest.approx(distance, rel=1e-5)


def test_bodies_have_names() -> None:
    names = {crs: body_of(crs) for crs in ("IAU_2015:19900", "IAU_2015:49910", "EPSG:3031", "local",
                                           "ESRI:104903", "")}
    assert names == {"IAU_2015:19900": "Mercury", "IAU_2015:49910": "Mars",
                     "EPSG:3031": "the Earth", "local": "the Earth", "ESRI:104903": "the Moon",
                     "": "the Earth"}
    own = pyproj.CRS.from_proj4("+proj=longlat +R=1000000 +no_defs").to_wkt()
    assert body_of(own) == "another body"
    assert ellipsoid_of("IAU_2015:30100") == (1737400.0, 0.0)
    assert height_reference("IAU_2015:30100").endswith("above the sphere or ellipsoid of the Moon")


def test_longitudes_to_the_west_are_refused() -> None:
    with pytest.raises(TermselError, match=r"counts to the west.*such as IAU_2015:49900"):
        normalise("IAU_2015:49901")
    with pytest.raises(TermselError, match="does not exist"):
        normalise("IAU_2015:99999")


@pytest.fixture(scope="module")
def result() -> termsel.Result:
    return termsel.run(features=scene(*BODIES[0][:4]), strategy="auto")  # type: ignore[arg-type]


@pytest.mark.parametrize("writer", ["rpb", "rpc-vrt", "orthority-geojson"])
def test_what_is_of_wgs84_is_refused_by_name(writer: str, result: termsel.Result, tmp_path: Path,
                                             ) -> None:
    with pytest.raises(TermselError, match="IAU_2015:49900 is on Mars, and EPSG:4979 on the Earth"):
        termsel.export(result, writer, tmp_path / "file")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_map_is_in_metres_of_the_body(result: termsel.Result, tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning), rasterio.open(
            tmp_path / "image.tif", "w", driver="GTiff", width=4000, height=4000, count=1,
            dtype="uint8", compress="deflate") as raster:
        raster.write(np.full((1, 4000, 4000), 200, dtype=np.uint8))
    termsel.rectify(result, tmp_path / "image.tif", tmp_path / "map.tif", height=-2500.0,
                    resolution=60.0)
    with rasterio.open(tmp_path / "map.tif") as made:
        assert made.crs.to_dict()["proj"] == "tmerc"
        assert pyproj.CRS(made.crs.to_wkt()).ellipsoid.semi_major_metre == 3396190.0
        assert (made.read(1) == 200).mean() > 0.9
        back = pyproj.Transformer.from_crs(pyproj.CRS(made.crs.to_wkt()), "IAU_2015:49900",
                                           always_xy=True).transform(*made.xy(*np.array(
                                               made.shape) // 2))
    assert back == pytest.approx((137.4, -4.6), abs=0.01)


@pytest.mark.slow_cases("projected")
@pytest.mark.parametrize("fit_crs", ["geodetic", "projected", "auto"])
def test_fits_in_other_coordinates(fit_crs: str) -> None:
    found = termsel.run("poly-terms", features=scene(*BODIES[0][:4]),  # type: ignore[arg-type]
                        model="poly3d", evaluations=200, options={"fit_crs": fit_crs})
    rmse = found.rmse["independent"]
    assert rmse is not None
    assert rmse.total < 1.5


def test_geocentric_coordinates_are_of_the_earth() -> None:
    with pytest.raises(TermselError, match="for the Earth only, and the control is on Mars"):
        termsel.prepare("poly-terms", features=scene(*BODIES[0][:4]),  # type: ignore[arg-type]
                        model="poly3d", options={"fit_crs": "geocentric"})
