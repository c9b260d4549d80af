"""A DEM held against heights of control: what is a shift, and what is none."""

from __future__ import annotations

import numpy as np
import pytest

from termsel.data.dem_difference import dem_difference
from termsel.data.features import FloatArray

RNG = np.random.default_rng(7)


def heights(count: int) -> FloatArray:
    return RNG.uniform(200.0, 900.0, count)


@pytest.mark.parametrize("shift", [-48.6, 48.6, 30.0, -20.0])
@pytest.mark.parametrize("count", [2, 3, 4, 40])
def test_a_geoid_is_told_with_its_sign(shift: float, count: int) -> None:
    control = heights(count)
    found = dem_difference(control, control + shift + RNG.normal(0.0, 1.0, count), "dem.tif")
    assert found is not None
    assert found.contradicts
    assert not found.in_feet
    assert found.above == pytest.approx(shift, abs=2.0)
    side = "above" if shift > 0 else "below"
    assert f"m {side} the control" in found.sentence()
    assert found.sentence(18.04).endswith(": 18 px on a map; geoid and ellipsoid?")


@pytest.mark.parametrize(("shift", "scatter"), [(0.3, 0.01), (0.3, 3.0), (0.0, 8.0), (-1.0, 4.0)])
@pytest.mark.parametrize("count", [1, 2, 3, 4, 40])
def test_what_dems_are_off_anyway_is_none(shift: float, scatter: float, count: int) -> None:
    control = heights(count)
    found = dem_difference(control, control + shift + RNG.normal(0.0, scatter, count))
    assert found is not None
    assert not found.contradicts


@pytest.mark.parametrize("count", [3, 5, 30])
@pytest.mark.parametrize("typo", [1000.0, -1000.0, 99999.0])
def test_a_typo_among_the_heights_spoils_nothing(count: int, typo: float) -> None:
    control = heights(count)
    surface = control + RNG.normal(0.0, 1.0, count)
    control[0] += typo
    found = dem_difference(control, surface)
    assert found is not None
    assert not found.contradicts
    shifted = dem_difference(control, surface - 48.6)
    assert shifted is not None
    assert shifted.contradicts
    assert shifted.above == pytest.approx(-48.6, abs=2.5)


def test_heights_that_were_taken_from_the_dem_tell_nothing() -> None:
    control, surface = heights(6), heights(6)
    control[:4] = surface[:4]
    control[4:] = surface[4:] + 48.6
    found = dem_difference(control, surface)
    assert found is not None
    assert (found.count, found.contradicts) == (2, True)
    assert dem_difference(surface, surface) is None


def test_heights_that_are_unknown_tell_nothing() -> None:
    assert dem_difference(np.array([np.nan, 5.0]), np.array([7.0, np.nan])) is None


@pytest.mark.parametrize("foot", [0.3048, 1200 / 3937, 1 / 0.3048])
def test_feet_are_told_from_a_geoid(foot: float) -> None:
    control = heights(8)
    found = dem_difference(control / foot, control + RNG.normal(0.0, 1.0, 8))
    assert found is not None
    assert found.contradicts
    if foot < 1.0:
        assert found.sentence().endswith("are the points in feet? Run again with --set z_unit=ft")
    else:
        assert "is the DEM in feet? gdal_translate " in found.sentence()


def test_kilometres_are_told_whichever_side_they_are() -> None:
    control = heights(8)
    dem = control + RNG.normal(0.0, 1.0, 8)
    for found in (dem_difference(control / 1000, dem), dem_difference(dem, control / 1000)):
        assert found is not None
        assert found.contradicts
        assert not found.in_feet
        assert found.sentence().endswith("is one of them in kilometres?")
    # Low ground that the DEM knows nothing of is in no unit.
    other = dem_difference(RNG.uniform(0.0, 4.0, 8), np.full(8, 700.0))
    assert other is not None
    assert not other.in_kilometres


def test_a_geoid_at_the_sea_is_not_taken_for_feet() -> None:
    control = RNG.uniform(0.0, 4.0, 10)
    for undulation in (-48.6, -30.0, 48.6):
        found = dem_difference(control, control + undulation)
        assert found is not None
        assert found.contradicts
        assert not found.in_feet
