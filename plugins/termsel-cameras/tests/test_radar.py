"""A radar by its Sentinel-1 annotation: against closest approach found by another minimiser."""

from __future__ import annotations

import os
from datetime import datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("termsel_cameras", reason="termsel-cameras is not installed: "
                    "pip install -e plugins/termsel-cameras")

from scipy.interpolate import BarycentricInterpolator
from scipy.optimize import brentq, minimize_scalar
from scipy.special import ndtri

import termsel
from termsel import FeatureSet, Points, TermselError
from termsel.testing import check
from termsel_cameras import Radar, SentinelLattice
from termsel_cameras.scanners.annotation import Annotation

FloatArray = NDArray[np.float64]
START = datetime(2021, 4, 1, 5, 26, 23, 794457)
LIGHT = 299792458.0
RADIUS, PERIOD = 7071000.0, 5924.0  # of the orbit [m], [s]
INTERVAL, SAMPLING = 1.5e-3, 6.4e7
LINES, SAMPLES = 8000, 20000
NEAR = 800e3  # slant range of the first sample [m]

DATA = Path(os.environ.get("TERMSEL_DATA", Path(__file__).parents[4] / "shared" / "data"))
REAL = sorted((DATA / "real/sentinel1").glob("*.xml"))


def station(time: float | FloatArray) -> FloatArray:
    """Return where the satellite is, Earth-fixed, (..., 3): a circle that turns with the Earth."""
    angle = 2 * np.pi * np.asarray(time) / PERIOD + 0.75
    tilt = np.radians(98.2)
    circle = np.stack([np.cos(angle), np.sin(angle) * np.cos(tilt), np.sin(angle) * np.sin(tilt)],
                      axis=-1) * RADIUS
    turn = -7.292115e-5 * np.asarray(time)
    x, y = circle[..., 0], circle[..., 1]
    return np.stack([np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y,
                     circle[..., 2]], axis=-1)


def velocity(time: float | FloatArray) -> FloatArray:
    return np.asarray((station(time + 1e-3) - station(time - 1e-3)) / 2e-3)


def ground_range(slant: FloatArray | float) -> FloatArray:
    """Return what the processor is made to call ground range [m]: a parabola of slant range."""
    aside = np.asarray(slant) - NEAR
    return 1.9 * aside - 1.2e-6 * aside**2


def written(path: Path, *, ground: bool, bursts: int = 0,
            lattice: list[tuple[float, ...]] | None = None) -> Path:
    """Write an annotation with the elements of the product specification that geometry needs."""
    def stamp(seconds: float) -> str:
        return (START + timedelta(seconds=seconds)).isoformat(timespec="microseconds")

    def vector(name: str, values: FloatArray) -> str:
        return f"<{name}>" + "".join(f"<{axis}>{value:.9e}</{axis}>" for axis, value in zip(
            "xyz", values, strict=True)) + f"</{name}>"

    times = np.arange(-50.0, 71.0, 10.0)
    orbit = "".join(
        f"<orbit><time>{stamp(moment)}</time><frame>Earth Fixed</frame>"
        + vector("position", station(moment)) + vector("velocity", velocity(moment)) + "</orbit>"
        for moment in times)
    polynomials = "".join(
        f"<coordinateConversion><azimuthTime>{stamp(moment)}</azimuthTime><sr0>{NEAR}</sr0>"
        f"<srgrCoefficients>{50.0 * moment} 1.9 -1.2e-6</srgrCoefficients></coordinateConversion>"
        for moment in (-1.0, 20.0)) if ground else ""
    listed = "".join(f"<burst><azimuthTime>{stamp(number * 2.0)}</azimuthTime></burst>"
                     for number in range(bursts))
    # Some points of a lattice that has many more in a product, unless others are given.
    points = [(line, 10 * line, 10 + line / 1000, 46 + line / 1000, line)
              for line in range(0, 800, 100)] if lattice is None else lattice
    listed_points = "".join(
        f"<geolocationGridPoint><line>{line}</line><pixel>{pixel}</pixel>"
        f"<latitude>{lat!r}</latitude><longitude>{lon!r}</longitude>"
        f"<height>{height!r}</height></geolocationGridPoint>"
        for line, pixel, lon, lat, height in points)
    projection = "Ground Range" if ground else "Slant Range"
    path.write_text(
        "<?xml version='1.0' encoding='UTF-8'?><product><adsHeader><missionId>S1A</missionId>"
        "<productType>GRD</productType><polarisation>VV</polarisation><swath>IW</swath>"
        f"</adsHeader><generalAnnotation><productInformation><rangeSamplingRate>{SAMPLING}"
        f"</rangeSamplingRate><projection>{projection}</projection></productInformation>"
        f"<orbitList>{orbit}</orbitList></generalAnnotation><imageAnnotation><imageInformation>"
        f"<productFirstLineUtcTime>{stamp(0.0)}</productFirstLineUtcTime><slantRangeTime>"
        f"{2 * NEAR / LIGHT!r}</slantRangeTime><rangePixelSpacing>10.0</rangePixelSpacing>"
        f"<azimuthPixelSpacing>10.0</azimuthPixelSpacing><azimuthTimeInterval>{INTERVAL}"
        f"</azimuthTimeInterval><numberOfSamples>{SAMPLES}</numberOfSamples><numberOfLines>{LINES}"
        "</numberOfLines></imageInformation></imageAnnotation><swathTiming><linesPerBurst>1500"
        f"</linesPerBurst><burstList>{listed}</burstList></swathTiming><geolocationGrid>"
        f"<geolocationGridPointList>{listed_points}</geolocationGridPointList></geolocationGrid>"
        f"<coordinateConversion><coordinateConversionList>{polynomials}"
        "</coordinateConversionList></coordinateConversion></product>", encoding="utf-8")
    return path


def geocentric(places: FloatArray) -> FloatArray:
    """Return Earth-fixed positions by PROJ, which the package does not use for them."""
    from pyproj import Transformer

    turn = Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    return np.stack(turn.transform(*places.T), axis=1)


def places_seen(count: int, seed: int = 0) -> FloatArray:
    """Return places (n, 3) to the right of the track, at distances and heights of all kinds."""
    from pyproj import Transformer

    rng = np.random.default_rng(seed)
    back = Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True)
    found = []
    for _ in range(count):
        time = rng.uniform(0.5, LINES * INTERVAL - 0.5)
        position, motion = station(time), velocity(time)
        down = -position / np.linalg.norm(position)
        right = np.cross(motion, position)
        right /= np.linalg.norm(right)
        look = np.radians(rng.uniform(31.0, 36.0))
        ray = np.cos(look) * down + np.sin(look) * right
        # Down the ray to the sphere of the Earth; its height is then replaced.
        along = -(position @ ray) - np.sqrt((position @ ray) ** 2 - position @ position
                                            + 6367e3**2)
        found.append(back.transform(*(position + along * ray)))
    places = np.array(found)
    places[:, 2] = rng.uniform(-100.0, 3000.0, count)
    return places


def closest(target: FloatArray) -> tuple[float, float]:
    """Return time and distance of closest approach, by Brent's method on the true circle."""
    found = minimize_scalar(lambda moment: float(np.linalg.norm(target - station(moment))),
                            bracket=(0.0, 6.0), options={"xtol": 1e-13})
    # About a minimum the distance is flat: one parabola through it gives the time to 1e-9 s.
    h = 0.05
    low, middle, high = (float(np.linalg.norm(target - station(found.x + d))) for d in (-h, 0, h))
    time = found.x + 0.5 * h * (low - high) / (low - 2 * middle + high)
    return time, float(np.linalg.norm(target - station(time)))


@pytest.mark.parametrize("ground", [False, True], ids=["slant range", "ground range"])
def test_a_place_is_seen_at_closest_approach(ground: bool, tmp_path: Path) -> None:
    model = Radar(metadata=str(written(tmp_path / "a.xml", ground=ground)))
    places = places_seen(12)
    image = model.unshifted(places)
    for target, (line, sample) in zip(geocentric(places), image, strict=True):
        time, distance = closest(target)
        expected = (ground_range(distance) + 50.0 * time) / 10.0 if ground else \
            (distance - NEAR) * 2 * SAMPLING / LIGHT
        # The orbit turns with the Earth: zero Doppler is the closest approach of its velocity.
        assert line == pytest.approx(time / INTERVAL, abs=0.02)
        assert sample == pytest.approx(expected, abs=0.02)


def test_what_is_left_of_the_track_or_before_the_orbit_is_not_seen(tmp_path: Path) -> None:
    model = Radar(metadata=str(written(tmp_path / "a.xml", ground=True)))
    seen = places_seen(1)
    assert np.isfinite(model.unshifted(seen)).all()
    for offset in ([-14.0, 0.0, 0.0], [0.0, -40.0, 0.0], [180.0, 0.0, 0.0]):
        assert np.isnan(model.unshifted(seen + np.array(offset))).all()


def test_a_position_without_ground_leaves_the_others_theirs(tmp_path: Path) -> None:
    model = Radar(metadata=str(written(tmp_path / "a.xml", ground=True)))
    known = places_seen(60)
    image = model.unshifted(known[:20]) + np.array([300.0, 0.0])
    located = model.on_ground(image, known)
    np.testing.assert_allclose(model.unshifted(located), image, atol=1e-6)
    # One and a half swaths beyond the last sample the polynomials of ground range say nothing.
    lost = np.array([[4000.0, 2.5 * SAMPLES]])
    with_lost = model.on_ground(np.concatenate([image, lost]), known)
    assert np.isnan(with_lost[-1]).all()
    np.testing.assert_allclose(with_lost[:-1], located, atol=1e-9)


def test_lines_of_a_burst_are_counted_from_its_own(tmp_path: Path) -> None:
    file = str(written(tmp_path / "a.xml", ground=False, bursts=4))
    places = places_seen(5)
    first, third = (Radar(metadata=file, burst=number).unshifted(places) for number in (1, 3))
    # The third begins 4 s after the first, and at line 3000.
    np.testing.assert_allclose(third - first, np.tile([3000 - 4.0 / INTERVAL, 0.0], (5, 1)),
                               atol=1e-6)


@pytest.mark.parametrize("count", [2, 3, 8])
def test_points_of_ones_own_correct_a_shift(count: int, tmp_path: Path) -> None:
    file = written(tmp_path / "a.xml", ground=True)
    places = places_seen(count + 40, seed=count)
    truth = Radar(metadata=str(file)).unshifted(places) + np.array([1.2, -0.7])
    rng = np.random.default_rng(count)
    points = Points(tuple(f"P{i}" for i in range(len(places))),
                    truth + rng.normal(0.0, 0.4, truth.shape), places, None,
                    ("control",) * count + ("independent",) * 40,
                    attributes={"sensor": np.array([str(file)] * len(places), dtype=object)})
    result = termsel.run(features=FeatureSet(points, crs="EPSG:4979", image_size=(LINES, SAMPLES)),
                         out=tmp_path / "out")
    assert result.strategy is not None
    assert result.strategy.chosen == "named-radar"
    error = result.fit.project(places[count:]) - truth[count:]
    assert np.sqrt((error**2).sum(axis=1).mean()) < 1.2
    file.unlink()
    again = termsel.read_result(tmp_path / "out").fit
    np.testing.assert_allclose(again.project(places), result.fit.project(places), atol=1e-6)
    # Places far beyond the control are not looked for.
    near = places[:count]
    back = again.locate(again.project(near), near[:, 2])
    np.testing.assert_allclose(back, near, atol=1e-7)


def timed(file: Path, middle: float) -> Path:
    """Say of the lattice's points when they were at zero Doppler, as a processor does."""
    root = ElementTree.parse(file).getroot()
    for point in root.iter("geolocationGridPoint"):
        line = float(point.findtext("line") or "")
        range_time = 2 * NEAR / LIGHT + float(point.findtext("pixel") or "") / SAMPLING
        moment = line * INTERVAL + (range_time - middle) / 2
        stamp = (START + timedelta(seconds=moment)).isoformat(timespec="microseconds")
        ElementTree.SubElement(point, "azimuthTime").text = stamp
        ElementTree.SubElement(point, "slantRangeTime").text = repr(range_time)
    file.write_bytes(ElementTree.tostring(root))
    return file


def test_lines_take_in_the_delay_of_echoes_where_that_is_asked_for(tmp_path: Path) -> None:
    middle = 5.45e-3
    file = timed(written(tmp_path / "a.xml", ground=False), middle)
    places = places_seen(20)
    plain = Radar(metadata=str(file)).unshifted(places)
    delayed = Radar(metadata=str(file), bistatic=True).unshifted(places)
    range_times = 2 * NEAR / LIGHT + plain[:, 1] / SAMPLING
    expected = plain[:, 0] - (range_times - middle) / 2 / INTERVAL
    np.testing.assert_allclose(delayed[:, 0], expected, atol=1e-3)
    np.testing.assert_array_equal(delayed[:, 1], plain[:, 1])
    # A product is read with it, too.
    points = termsel.read(file, bistatic=True).points
    assert set(points.attributes["bistatic"]) == {"true"}


def test_the_delay_is_refused_where_the_lattice_does_not_state_it(tmp_path: Path) -> None:
    file = written(tmp_path / "a.xml", ground=False)
    with pytest.raises(TermselError, match="by which echoes lines are timed"):
        Radar(metadata=str(file), bistatic=True)


@pytest.mark.skipif(not REAL, reason="no real annotations here")
@pytest.mark.parametrize("file", REAL, ids=lambda file: file.name[:20])
def test_with_the_delay_lines_are_those_of_real_lattices(file: Path) -> None:
    bursts = len(ElementTree.parse(file).findall("swathTiming/burstList/burst"))
    lattice = termsel.read(file).points
    # Of a burst the lattice has its first line alone.
    rows = lattice.image[:, 0] == 0 if bursts else np.ones(len(lattice.image), dtype=bool)
    image = lattice.image[rows]
    for delay, least, most in ((True, 0.0, 0.005), (False, 0.05, 0.12)):
        radar = Radar(metadata=str(file), bistatic=delay, burst=1 if bursts else 0)
        errors = (radar.unshifted(lattice.ground[rows]) - image)[:, 0]
        assert least <= np.sqrt((errors**2).mean()) < most


def share_within(file: Path, errors: FloatArray, *, sigma: float | None = None) -> float:
    """Return the share of places within the interval of 90 % of fits to points with errors.

    The errors are those of cases and of their points, (cases, points, 2).
    """
    model = Radar(metadata=str(file))
    cases, count = errors.shape[:2]
    places = places_seen(60)
    seen = model.unshifted(places)
    names = {"sensor": np.array([str(file)] * count, dtype=object)}
    stated = None if sigma is None else np.full((count, 2), sigma)
    within = []
    for case in range(cases):
        order = np.random.default_rng(case).permutation(60)[:count + 12]
        ground = places[order]
        truth = seen[order] + [0.8, -0.6]
        points = Points(tuple("ABC"[:count]), truth[:count] + errors[case], ground[:count], stated,
                        attributes=names)
        fitted = termsel.fit(FeatureSet(points, crs="EPSG:4979", image_size=(LINES, SAMPLES)),
                             "named-radar")
        off = np.abs(fitted.project(ground[count:]) - truth[count:])
        within.append((off < 1.645 * fitted.sigma(ground[count:])).mean())
    return float(np.mean(within))


@pytest.mark.parametrize(("noise", "sigma"), [(1.0, None), (0.5, 0.5)],
                         ids=["not stated", "stated"])
def test_what_one_point_promises_holds(noise: float, sigma: float | None, tmp_path: Path) -> None:
    file = written(tmp_path / "a.xml", ground=True)
    # Evenly many errors of each size, in both axes.
    quantiles = noise * ndtri((np.arange(20) + 0.5) / 20)
    errors = np.stack([quantiles, np.roll(quantiles, 7)], axis=-1)[:, None]
    assert 0.84 <= share_within(file, errors, sigma=sigma) <= 0.96


@pytest.mark.slow
@pytest.mark.parametrize(("count", "noise"), [(1, 1.0), (2, 0.7), (2, 1.0), (3, 0.7), (3, 1.0)])
def test_promises_hold_in_most_simulated_cases(count: int, noise: float, tmp_path: Path) -> None:
    file = written(tmp_path / "a.xml", ground=True)
    errors = np.random.default_rng(1).normal(0.0, noise, (200, count, 2))
    assert 0.84 <= share_within(file, errors) <= 0.96


def test_the_lattice_is_read_and_names_the_annotation(tmp_path: Path) -> None:
    file = written(tmp_path / "a.xml", ground=True)
    features = termsel.read(file)
    assert features.image_size == (LINES, SAMPLES)
    assert features.crs == "EPSG:4979"
    np.testing.assert_array_equal(features.points.image[3], [300.0, 3000.0])
    np.testing.assert_array_equal(features.points.ground[3], [10.3, 46.3, 300.0])
    assert set(features.points.attributes["sensor"]) == {str(file)}


def test_the_reader_conforms(tmp_path: Path) -> None:
    file = written(tmp_path / "a.xml", ground=True)
    check(SentinelLattice, content=file.read_bytes(), expected=termsel.read(file),
          expected_failures={})


@pytest.mark.parametrize(("before", "after", "words"), [
    ("<missionId>S1A", "<missionId>TSX", "no annotation of a Sentinel-1"),
    ("<product>", "<product><", "cannot be read as XML"),
    ("numberOfLines>8000", "numberOfLines>many", "'many', which is no number"),
    ("Earth Fixed", "Inertial", "the frame 'Inertial'"),
    ("azimuthTimeInterval>", "interval>", "azimuthTimeInterval is missing"),
    ("<time>2021", "<time>x", "no time"),
    ("<srgrCoefficients>-50.0 1.9", "<srgrCoefficients>-50.0 nan", "'nan', which is no number"),
    ("<coordinateConversion><azimuthTime>", "<coordinateConversion><azimuthTime>x", "no time"),
    ("<sr0>", "<sr0>no", "sr0 has 'no")])
def test_an_annotation_that_is_damaged_is_named(before: str, after: str, words: str,
                                                tmp_path: Path) -> None:
    file = written(tmp_path / "a.xml", ground=True)
    text = file.read_text()
    assert before in text
    file.write_text(text.replace(before, after))
    with pytest.raises(TermselError, match=words) as caught:
        Radar(metadata=str(file))
    assert "a.xml" in str(caught.value)
    assert caught.value.hint


def test_a_burst_must_be_named_where_there_are_several(tmp_path: Path) -> None:
    file = str(written(tmp_path / "a.xml", ground=False, bursts=4))
    with pytest.raises(TermselError, match="4 bursts that overlap in time"):
        Radar(metadata=file)
    with pytest.raises(TermselError, match="4 bursts that overlap in time"):
        Radar(metadata=file, burst=5)
    with pytest.raises(TermselError, match="has no bursts"):
        Radar(metadata=str(written(tmp_path / "b.xml", ground=True)), burst=1)
    with pytest.raises(TermselError, match="is no file"):
        Radar(metadata=str(tmp_path))


@pytest.mark.parametrize("seed", [0, 2, 3])
def test_simulated_radars_of_the_benchmark_are_judged_by_it(seed: int) -> None:
    """The benchmark's own orbit and search for zero Doppler, as an annotation states them."""
    cameras = pytest.importorskip("termsel_bench.scenes.cameras")
    from termsel.simulate import pushbroom_at

    ranges = SimpleNamespace(altitude=(5e5, 8e5), incline=(97.0, 99.0))
    size, pixel, scene = (4000, 5000), 5.0, (11.0, 46.0, 800.0)
    # The same numbers in the same order as the benchmark draws them.
    rng = np.random.default_rng(seed)
    tilt = float(rng.uniform(20.0, 42.0))
    look = rng.choice([90.0, 270.0])
    orbit = pushbroom_at(*scene[:2], height=scene[2], off_nadir=tilt, look_azimuth=look, gsd=pixel,
                         image_size=size, altitude=rng.uniform(*ranges.altitude),
                         inclination=rng.uniform(*ranges.incline), refraction=False)
    times = np.arange(-30.0, 31.0, 5.0)
    first = -size[0] / 2 * orbit.line_period
    stations = orbit.exposure(times + first)[0]
    velocities = (orbit.exposure(times + first + 1e-3)[0]
                  - orbit.exposure(times + first - 1e-3)[0]) / 2e-3
    middle = float(np.linalg.norm(geocentric(np.array([scene]))[0]
                                  - orbit.exposure(np.zeros(1))[0][0]))
    spacing = pixel * float(np.sin(np.radians(tilt)))
    annotation = Annotation(
        source="simulated", product="simulated", start="2021-04-01T05:26:23", size=size,
        line_interval=float(orbit.line_period), line_spacing=pixel, sample_spacing=spacing,
        first_range_time=2 * (middle - size[1] / 2 * spacing) / LIGHT,
        sampling_rate=LIGHT / 2 / spacing, times=tuple(times.tolist()),
        positions=tuple(map(tuple, stations.tolist())),
        velocities=tuple(map(tuple, velocities.tolist())), ground_ranges=(), bursts=(),
        lines_per_burst=0)
    places = np.random.default_rng(9).uniform([10.95, 45.95, 0], [11.05, 46.05, 2000], (50, 3))
    expected = cameras._radar_positions(np.random.default_rng(seed), ranges, size, pixel, scene,
                                        places)
    found = Radar(metadata=annotation.text()).unshifted(places)
    # Sentinel-1 looks to the right of its track; some of the benchmark's radars look to the left.
    if look == 90.0:
        np.testing.assert_allclose(found, expected, atol=0.02)
    else:
        assert np.isnan(found).all()


@pytest.mark.skipif(not REAL, reason="no real annotations here")
@pytest.mark.parametrize("file", REAL, ids=lambda file: file.name[:20])
def test_real_annotations_give_zero_doppler_by_other_means(file: Path) -> None:
    root = ElementTree.parse(file).getroot()
    bursts = len(root.findall("swathTiming/burstList/burst"))
    model = Radar(metadata=str(file), burst=1 if bursts else 0)
    stated = model.annotation
    lattice = termsel.read(file).points.ground
    rng = np.random.default_rng(5)
    # Places between the lattice's, at heights of their own.
    places = np.array([rng.dirichlet(np.ones(4)) @ lattice[rng.choice(len(lattice), 4)]
                       for _ in range(20)])
    places[:, 2] = rng.uniform(0.0, 3000.0, len(places))
    if bursts:
        places[:, :2] = lattice[:20, :2]
    image = model.unshifted(places)
    middle = int(np.searchsorted(stated.times, stated.size[0] * stated.line_interval / 2))
    near = slice(max(middle - 4, 0), middle + 4)
    times = np.array(stated.times)[near]
    orbit = BarycentricInterpolator(times, np.array(stated.positions)[near])
    motion = BarycentricInterpolator(times, np.array(stated.velocities)[near])
    first_time, first_line = model._first_line
    for target, (line, sample) in zip(geocentric(places), image, strict=True):
        guess = first_time + (line - first_line) * stated.line_interval
        time = brentq(lambda moment, place=target: float((place - orbit(moment)) @ motion(moment)),
                      guess - 1.0, guess + 1.0, xtol=1e-12)
        assert (time - guess) / stated.line_interval == pytest.approx(0.0, abs=0.01)
        distance = float(np.linalg.norm(target - orbit(time)))
        if not stated.ground_ranges:
            expected = (2 * distance / LIGHT - stated.first_range_time) * stated.sampling_rate
            assert sample == pytest.approx(expected, abs=0.01)
            continue
        moments = [record.time for record in stated.ground_ranges]
        ranges = [np.polyval(record.coefficients[::-1], distance - record.origin)
                  for record in stated.ground_ranges]
        assert sample == pytest.approx(np.interp(time, moments, ranges) / stated.sample_spacing,
                                       abs=0.02)
