"""A scanner by its DIMAP file: against termsel's simulator, which writes such files here."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("termsel_cameras", reason="termsel-cameras is not installed: "
                    "pip install -e plugins/termsel-cameras")

import termsel
from termsel import FeatureSet, Points, TermselError
from termsel.simulate import Angle, Pushbroom, pushbroom_at
from termsel_cameras import TrackedScanner

FloatArray = NDArray[np.float64]
START = datetime(2008, 3, 4, 12, 31, 3, 81912)


def spot(tilt: float = 15.0, size: tuple[int, int] = (6000, 3000)) -> Pushbroom:
    """Return a scanner like SPOT, whose attitude changes a little."""
    sensor = pushbroom_at(20.0, 45.0, height=500.0, off_nadir=tilt, look_azimuth=90.0, gsd=10.0,
                          image_size=size, altitude=822e3, inclination=98.7, refraction=False)
    roll, pitch, yaw = (Angle((*one.drift, drift), ((1e-5, 0.3, 1.0),)) for one, drift in (
        (sensor.roll, 3e-6), (sensor.pitch, -4e-6), (sensor.yaw, 2e-5)))
    return replace(sensor, roll=roll, pitch=pitch, yaw=yaw)


def turns_of(sensor: Pushbroom, time: FloatArray) -> FloatArray:
    """Return rotations to orbital axes from those of the camera, (n, 3, 3), by the handbook."""
    station, rotation = sensor.exposure(time)
    ahead = (sensor.exposure(time + 0.01)[0] - sensor.exposure(time - 0.01)[0]) / 0.02
    up = station / np.linalg.norm(station, axis=1, keepdims=True)
    right = np.cross(ahead, up)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    orbital = np.stack([right, np.cross(up, right), up], axis=2)
    # The camera looks along its z; its x is ahead and its y to starboard.
    turns: FloatArray = orbital.transpose(0, 2, 1) @ rotation[:, :, [1, 0, 2]] * [1.0, 1.0, -1.0]
    return turns


def angles_of(m: FloatArray) -> FloatArray:
    """Return yaw, pitch and roll of rotations, (n, 3): pitch after roll after yaw."""
    return np.stack([np.arctan2(-m[:, 0, 1], m[:, 0, 0]), np.arctan2(m[:, 1, 2], m[:, 2, 2]),
                     np.arcsin(-m[:, 0, 2])], axis=1)


def tag(name: str, *content: Any) -> str:
    return f"<{name}>{''.join(map(str, content))}</{name}>"


def moment(seconds: float) -> str:
    return tag("TIME", (START + timedelta(seconds=seconds)).isoformat(timespec="microseconds"))


def written(sensor: Pushbroom, path: Path, *, raw: bool = False, level: str = "1A") -> Path:
    """Write the geometry as the DIMAP file of a SPOT scene, in the elements of the format.

    Raw angular speeds leave the attitude in the middle to the look angles, as the mirror does.
    """
    def axes(name: str, values: FloatArray) -> str:
        return tag(name, *(tag(one, f"{value:.6f}") for one, value in zip(
            "XYZ", values, strict=True)))

    times, step = np.arange(-120.0, 121.0, 30.0), 0.125
    station = sensor.exposure(times)[0]
    speed = (sensor.exposure(times + 0.01)[0] - sensor.exposure(times - 0.01)[0]) / 0.02
    points = [tag("Point", axes("Location", p), axes("Velocity", v), moment(t))
              for t, p, v in zip(times, station, speed, strict=True)]
    when = np.arange(-8.0, 8.0 + step, step)
    still = turns_of(sensor, np.zeros(1))[0] if raw else np.eye(3)
    early, now, late = (angles_of(turns_of(sensor, when + dt) @ still.T) for dt in (-0.01, 0, 0.01))
    values = (late - early) / 0.02 if raw else now
    rows = ["".join([moment(t), *(tag(name, f"{value:.12f}") for name, value in zip(
        ("YAW", "PITCH", "ROLL"), row, strict=True)), tag("OUT_OF_RANGE", "N")])
        for t, row in zip(when, values, strict=True)]
    attitude = tag("Raw_Attitudes", tag("Aocs_Attitude", tag("Angular_Speeds_List", *(
        tag("Angular_Speeds", one) for one in rows)))) if raw else tag(
        "Corrected_Attitudes", tag("STAR_TRACKER_USED", "Y"),
        tag("Corrected_Attitude", *(tag("Angles", one) for one in rows)))
    middle = (sensor.n_samples - 1) / 2
    across = -(np.arange(sensor.n_samples) - middle) * sensor.ifov
    x, y, z = still @ [across, np.zeros_like(across), -np.ones_like(across)]
    looks = [tag("Look_Angles", tag("DETECTOR_ID", i + 1), tag("PSI_X", f"{along:.12f}"),
                 tag("PSI_Y", f"{aside:.12f}"))
             for i, (along, aside) in enumerate(zip(np.arctan(y / -z), np.arctan(x / z),
                                                    strict=True))]
    path.write_text('<?xml version="1.0" encoding="ISO-8859-1"?>' + tag(
        "Dimap_Document",
        tag("Raster_Dimensions", tag("NCOLS", sensor.n_samples), tag("NROWS", sensor.n_lines)),
        tag("Dataset_Sources", tag("Source_Information", tag("Scene_Source", tag(
            "SCENE_PROCESSING_LEVEL", level)))),
        tag("Data_Strip", tag("Ephemeris", tag("Points", *points)),
            tag("Satellite_Attitudes", attitude),
            tag("Sensor_Configuration",
                tag("Time_Stamp", tag("LINE_PERIOD", sensor.line_period),
                    tag("SCENE_CENTER_TIME", START.isoformat()),
                    tag("SCENE_CENTER_LINE", sensor.centre[0] + 1)),
                tag("Instrument_Look_Angles_List", tag("Instrument_Look_Angles", tag(
                    "Look_Angles_List", *looks)))))), encoding="utf-8")
    return path


def scene(sensor: Pushbroom, file: Path, count: int, seed: int = 0) -> FeatureSet:
    """Return so many control points and 60 independent ones; a column names the file."""
    rng, size = np.random.default_rng(seed), (sensor.n_lines, sensor.n_samples)
    image = rng.uniform(0.03, 0.97, (count + 60, 2)) * size
    height = rng.uniform(200.0, 1200.0, len(image))
    ground = np.column_stack([sensor.locate(image, height), height])
    return FeatureSet(Points(
        tuple(f"P{i}" for i in range(len(image))), image + rng.normal(0.0, 0.5, image.shape),
        ground, None, ("control",) * count + ("independent",) * 60,
        attributes={"sensor": np.array([str(file)] * len(image), dtype=object)}),
        crs="EPSG:4979", image_size=size)


def rmse(fitted: Any, features: FeatureSet) -> float:
    others = features.points.take([role == "independent" for role in features.points.roles])
    return float(np.sqrt((fitted.errors(others) ** 2).sum(axis=1).mean()))


@pytest.mark.parametrize("tilt", [0.0, 20.0])
def test_the_file_alone_has_the_geometry(tilt: float, tmp_path: Path) -> None:
    sensor = spot(tilt)
    features = scene(sensor, tmp_path, 8)
    ready = termsel.fit(scene(sensor, written(sensor, tmp_path / "m.dim"), 8), "named-scanner")
    model = ready.model
    places = features.points.ground
    found = model.project(np.zeros(8), ready.scaling.ground(places))
    image = ready.scaling.pixels(found)
    assert np.abs(image - sensor.project(places)).max() < 0.05
    beyond = ready.project(places * [1.0, 1.0, 1.0] + [0.6, 0.0, 0.0])
    assert np.isfinite(beyond).all()


@pytest.mark.parametrize(("raw", "count", "most"), [
    (False, 3, 1.8), (False, 6, 1.3), (True, 4, 1.6), (True, 8, 1.3)])
def test_biases_are_corrected_by_few_points(raw: bool, count: int, most: float,
                                            tmp_path: Path) -> None:
    sensor = spot()
    file = written(sensor, tmp_path / "m.dim", raw=raw)
    size = 3e-4 if raw else 6e-5
    moved = replace(sensor, roll=Angle((sensor.roll.drift[0] + size, *sensor.roll.drift[1:])),
                    pitch=Angle((sensor.pitch.drift[0] - size, *sensor.pitch.drift[1:])))
    features = scene(moved, file, count)
    fitted = termsel.fit(features, "named-scanner")
    assert rmse(fitted, features) < most
    sigma = fitted.sigma(features.points.ground[count:], measured=True)
    assert 0.5 < np.sqrt((sigma**2).sum(axis=1).mean()) / rmse(fitted, features) < 2.0


def test_auto_chooses_it_and_a_result_needs_no_file(tmp_path: Path) -> None:
    file = written(spot(), tmp_path / "m.dim")
    features = scene(spot(), file, 5)
    result = termsel.run(features=features, out=tmp_path / "out")
    assert result.strategy is not None
    assert result.strategy.chosen == "named-scanner"
    assert "m.dim" in result.strategy.reason
    file.unlink()
    again = termsel.read_result(tmp_path / "out")
    places = features.points.ground[5:]
    np.testing.assert_allclose(again.fit.project(places), result.fit.project(places), atol=1e-6)


@pytest.mark.parametrize(("before", "after", "said"), [
    ("Dimap_Document", "Other", "no DIMAP"), (">1A<", ">1B<", "level 1B"),
    ("LINE_PERIOD", "PERIOD", "LINE_PERIOD is missing"), ("<X>", "<X>a", "no number"),
    ("Corrected_Attitude>", "Else>", "neither corrected"), ("PSI_Y>", "Y>", "PSI_Y is missing"),
    ("SCENE_CENTER_TIME>2008", "SCENE_CENTER_TIME>x", "no time"),
    ("SCENE_CENTER_TIME>2008", "SCENE_CENTER_TIME>2009", "does not cover the time of the scene"),
    ("</Dimap_Document>", "", "cannot be read"), ("DETECTOR_ID>2<", "DETECTOR_ID>1<", "in a row")])
def test_bad_files(before: str, after: str, said: str, tmp_path: Path) -> None:
    file = written(spot(), tmp_path / "m.dim")
    file.write_text(file.read_text().replace(before, after))
    with pytest.raises(TermselError, match=said):
        TrackedScanner(metadata=str(file))


def test_a_model_without_a_file_says_what_it_requires() -> None:
    with pytest.raises(TermselError, match="requires the metadata"):
        assert TrackedScanner().source
    with pytest.raises(TermselError, match="cannot be read"):
        TrackedScanner(metadata="none.dim")


@pytest.mark.parametrize("text", ["{", '{"source": 5}', '{"source": "a", "size": [2, "b"]}',
                                  '{"source": ' + "[" * 100_000], ids=range(4))
def test_damaged_metadata_of_a_result_are_refused(text: str) -> None:
    with pytest.raises(TermselError, match="the metadata of the result cannot be read"):
        TrackedScanner(metadata=text)
