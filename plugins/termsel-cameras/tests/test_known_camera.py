"""Photos whose camera is known, against photos whose geometry is written out here."""

from __future__ import annotations

import json
import os
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from rasterio.transform import from_origin

pytest.importorskip("termsel_cameras", reason="termsel-cameras is not installed: "
                    "pip install -e plugins/termsel-cameras")

import termsel
from termsel import FeatureSet, FitData, Points, TermselError
from termsel.testing import checks, invoke
from termsel_cameras.known.cameras import CAMERAS
from termsel_cameras.known.interior import interior_of, interior_of_file
from termsel_cameras.known.lens import Lens
from termsel_cameras.known.method import KNOWN_CAMERA
from termsel_cameras.known.sharing import SharedCamera, shared_camera, unlike_photos

SIZE, FOCAL, HIGH = (3000, 4000), 3500.0, 1200.0
CRS = "EPSG:32633"
DATA = Path(os.environ.get("TERMSEL_DATA", "nowhere")) / "real"

FloatArray = NDArray[np.float64]


def photo(count: int, *, down: float = 88.0, seed: int = 0, noise: float = 0.5,
          lens: Lens | None = None, mirrored: bool = False,
          **columns: object) -> tuple[FeatureSet, FloatArray, FloatArray]:
    """Return control of a camera over hills, other ground, and where that is seen."""
    rng = np.random.default_rng(seed)
    angle = np.radians(down)
    ahead = np.array([0.6, 0.8, 0.0])
    right = np.array([0.8, -0.6, 0.0])
    view = np.cos(angle) * ahead - np.sin(angle) * np.array([0.0, 0.0, 1.0])
    axes = np.stack([np.cross(view, right), right, view])
    plan = rng.uniform(-0.35, 0.35, (8000, 2)) * HIGH
    far = plan[:, :1] * 3 + (HIGH / np.tan(angle) if down < 80.0 else 0.0)
    ground = far * ahead + plan[:, 1:] * right * (3.0 if down < 80.0 else 1.0)
    ground[:, 2] = 40.0 * (np.sin(ground[:, 0] / 200.0) + np.cos(ground[:, 1] / 250.0))
    seen = (ground - [0.0, 0.0, HIGH]) @ axes.T
    away = seen[:, 1::-1] / seen[:, 2:]
    away = (lens or Lens()).distorted(away)[:, ::-1]
    image = FOCAL * away + (np.array(SIZE) - 1.0) / 2.0
    if mirrored:
        image[:, 1] = SIZE[1] - 1.0 - image[:, 1]
    inside = (seen[:, 2] > 0) & (image > 0).all(axis=1) & (image < np.array(SIZE) - 1.0).all(axis=1)
    ground = ground[inside] + [400_000.0, 5_000_000.0, 300.0]
    image = image[inside]
    points = Points(
        tuple(f"P{i}" for i in range(count)),
        image[:count] + noise * rng.standard_normal((count, 2)), ground[:count],
        attributes={name: np.array([str(value)] * count, dtype=object)
                    for name, value in columns.items()})
    return FeatureSet(points, crs=CRS, image_size=SIZE), ground[count:], image[count:]


def rmse(fitted: termsel.Fit, ground: FloatArray, image: FloatArray) -> float:
    return float(np.sqrt(((fitted.project(ground) - image) ** 2).sum(axis=1).mean()))


@pytest.mark.parametrize("down", [88.0, 25.0])
@pytest.mark.parametrize("count", [3, 4, 8])
def test_few_points_are_enough_for_a_known_camera(count: int, down: float) -> None:
    errors = []
    for seed in range(5):
        control, ground, image = photo(count, down=down, seed=seed, camera_focal=FOCAL,
                                       camera_height=1200)
        errors.append(rmse(KNOWN_CAMERA.fit(FitData.of(control)), ground, image))
    assert np.median(errors) < {3: 8.0, 4: 5.0, 8: 2.0}[count]


def test_three_points_that_two_cameras_see_alike_are_refused() -> None:
    control, _, _ = photo(3, down=40.0, seed=5, camera_focal=FOCAL)
    with pytest.raises(TermselError, match="two cameras see") as refused:
        KNOWN_CAMERA.fit(FitData.of(control))
    assert "camera_height" in str(refused.value.hint)


def test_a_lens_is_taken_off_and_put_on_again() -> None:
    lens = Lens(-0.05, 0.02, 1e-3, -5e-4, 0.001)
    control, ground, image = photo(
        8, lens=lens, camera_focal=FOCAL, camera_distortion="-0.05,0.02,0.001,-0.0005,0.001")
    fitted = KNOWN_CAMERA.fit(FitData.of(control))
    assert rmse(fitted, ground, image) < 2.0
    sigma = fitted.sigma(ground)
    assert 0.2 < rmse(fitted, ground, image) / np.sqrt((sigma**2).sum(axis=1).mean()) < 3.0
    places = np.random.default_rng(0).uniform(-0.4, 0.4, (50, 2))
    np.testing.assert_allclose(lens.ideal(lens.distorted(places)), places, atol=1e-9)


def test_a_mirrored_scan_is_seen_as_one() -> None:
    control, ground, image = photo(6, mirrored=True, camera_focal=FOCAL)
    assert rmse(KNOWN_CAMERA.fit(FitData.of(control)), ground, image) < 4.0


def test_the_principal_point_of_a_photo_of_unknown_size_is_an_unknown(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    control, _, _ = photo(5, noise=6.0, camera_focal=FOCAL)
    for size, unknowns in ((SIZE, 6), (None, 8)):
        fitted = KNOWN_CAMERA.fit(FitData.of(replace(control, image_size=size)))
        experience = KNOWN_CAMERA.estimator.experience(fitted)
        assert experience is not None
        assert experience.unknowns == unknowns
        # Residuals tell the noise by what the unknowns leave of them.
        assert fitted.effective == pytest.approx(unknowns, abs=1.5)
    rows = [",".join(map(str, (name, *place, *where))) for name, place, where in zip(
        control.points.ids, control.points.image, control.points.ground, strict=True)]
    table = tmp_path / "photo.csv"
    table.write_text("\n".join(["id,line,sample,x,y,z", *rows]), encoding="utf-8")
    termsel.read(table, crs=CRS, camera_focal="3500")
    assert "nothing shows the size of the image" in caplog.text
    caplog.clear()
    termsel.read(table, crs=CRS, camera_focal="3500", camera_principal_point="1499.5,1999.5")
    assert "the size of the image" not in caplog.text


def test_one_wild_point_hardly_moves_the_camera() -> None:
    control, ground, image = photo(8, camera_focal=FOCAL)
    measured = control.points.image.copy()
    measured[2] += 150.0
    wild = replace(control, points=replace(control.points, image=measured))
    assert rmse(KNOWN_CAMERA.fit(FitData.of(wild)), ground, image) < 8.0


def test_auto_chooses_the_camera_and_reads_it_back(tmp_path: Path) -> None:
    control, ground, image = photo(6, down=30.0, camera_focal=FOCAL)
    result = termsel.run(features=control, out=tmp_path / "out")
    assert result.strategy is not None
    assert result.strategy.chosen == "known-camera"
    assert "60 deg off the vertical" in result.strategy.reason
    again = termsel.read_result(tmp_path / "out").fit
    np.testing.assert_allclose(again.project(ground), result.fit.project(ground), atol=1e-6)
    assert rmse(again, ground, image) < 4.0
    behind = np.array([[400_000.0 - 2000.0 * 0.6, 5_000_000.0 - 2000.0 * 0.8, 300.0]])
    assert np.isnan(again.project(behind)).all()


@pytest.mark.slow_cases("50.0")
@pytest.mark.parametrize("down", [88.0, 50.0])
def test_auto_chooses_the_camera_of_four_points(down: float) -> None:
    """An affine map meets four points whatever they are, so that it shows no departure."""
    for seed in range(3):
        control, ground, image = photo(4, down=down, seed=seed, camera_focal=FOCAL)
        result = termsel.run(features=control)
        assert result.strategy is not None
        assert result.strategy.chosen == "known-camera"
        assert not any("not used" in note for note in result.notes)
        assert rmse(result.fit, ground, image) < 15.0


def test_a_result_states_where_the_camera_was_and_how_it_looked(tmp_path: Path) -> None:
    control, _, _ = photo(12, down=60.0, camera_focal=FOCAL, noise=0.0)
    result = termsel.run(features=replace(control, crs="local"), method="known-camera",
                         out=tmp_path / "out")
    figures = {figure.name: figure.value for figure in result.sensor}
    for axis, place in zip("xyz", (400_000.0, 5_000_000.0, 1500.0), strict=True):
        assert figures[f"projection centre {axis}"] == pytest.approx(place, abs=0.5)
    assert figures["focal length"] == pytest.approx(FOCAL, abs=2.0)
    # It looks along 0.6, 0.8 and 60 deg downwards; m31 = sin(phi), m21 / m11 = -tan(kappa).
    angles = [np.radians(figures[name]) for name in ("omega", "phi", "kappa")]
    view = [0.6 * 0.5, 0.8 * 0.5, -np.sqrt(0.75)]
    assert np.sin(angles[1]) == pytest.approx(-view[0], abs=1e-3)
    assert -np.sin(angles[0]) * np.cos(angles[1]) == pytest.approx(-view[1], abs=1e-3)
    assert np.cos(angles[1]) * np.cos(angles[2]) == pytest.approx(0.8, abs=1e-3)
    written = (tmp_path / "out" / "summary.txt").read_text("utf-8")
    assert "projection centre x" in written
    assert termsel.read_result(tmp_path / "out").sensor == result.sensor


def test_options_of_reading_say_the_camera(tmp_path: Path) -> None:
    table = tmp_path / "gcps.csv"
    control, _, _ = photo(4)
    rows = [f"{name},{line},{sample},{x},{y},{z}" for name, (line, sample), (x, y, z) in zip(
        control.points.ids, control.points.image, control.points.ground, strict=True)]
    table.write_text("\n".join(["id,line,sample,x,y,z", *rows]), encoding="utf-8")
    camera = tmp_path / "mine.json"
    camera.write_text(json.dumps({"focal": 3500, "principal_point": [1499.5, 1999.5],
                                  "distortion": [0.01]}), encoding="utf-8")
    read = termsel.read(table, crs=CRS, camera=str(camera), camera_position="400000,5000000,1500,9")
    known = interior_of(read)
    assert known is not None
    assert (known.focal, known.line, known.distortion) == (3500.0, 1499.5, (0.01,))
    assert known.position_spread == 9.0
    with pytest.raises(TermselError, match="unknown camera 'wild-rc31'"):
        interior_of(termsel.read(table, crs=CRS, camera="wild-rc31"))
    with pytest.raises(TermselError, match="without the size of a pixel"):
        interior_of(termsel.read(table, crs=CRS, camera_focal="153 mm"))
    with pytest.raises(TermselError, match="camera_position does not accept"):
        interior_of(termsel.read(table, crs=CRS, camera_focal=1, camera_position="7,8"))
    in_px = interior_of(termsel.read(table, crs=CRS, camera_focal="153 mm", camera_pixel="21"))
    assert in_px is not None
    assert in_px.focal == pytest.approx(153.0 / 0.021)


@pytest.mark.parametrize("name", CAMERAS)
def test_cameras_by_name_tell_a_focal_length(name: str) -> None:
    camera = CAMERAS[name]
    pixels = camera.pixels if camera.pixels[0] else (11_500, 11_500)
    control, _, _ = photo(3, camera=name)
    known = interior_of(replace(control, image_size=pixels[::-1]))
    assert known is not None
    assert known.focal == pytest.approx(camera.focal / camera.width * pixels[0], rel=1e-3)
    assert camera.source in known.source


def save_photo(path: Path, *, latitude: float, longitude: float, altitude: float) -> None:
    """Write an image whose EXIF has an equivalent focal length of 24 mm and a position."""
    image = pytest.importorskip("PIL.Image")

    def sexagesimal(degrees: float) -> tuple[float, float, float]:
        minutes = degrees % 1.0 * 60.0
        return float(int(degrees)), float(int(minutes)), round(minutes % 1.0 * 60.0, 4)

    exif = image.Exif()
    exif.get_ifd(0x8769)[0xA405] = 24  # FocalLengthIn35mmFilm
    exif.get_ifd(0x8825).update({1: "N", 2: sexagesimal(latitude), 3: "E",
                                 4: sexagesimal(longitude), 5: b"\0", 6: altitude})
    image.new("L", (SIZE[1], SIZE[0])).save(path, exif=exif)


def rows_of(control: FeatureSet) -> list[dict[str, Any]]:
    """Return control as rows of a table."""
    points = control.points
    return [{"id": name, "line": line, "sample": sample, "x": x, "y": y, "z": z}
            for name, (line, sample), (x, y, z) in zip(
                points.ids, points.image, points.ground, strict=True)]


# Where `photo` stands, and its focal length in EXIF.
LATITUDE, LONGITUDE, ALTITUDE = 45.146393, 13.727967, 1500.0
FOCAL_IN_EXIF = 24.0 / np.hypot(36.0, 24.0) * 5000.0


@pytest.mark.slow_cases("4-0.0-1500.0-None", "7-0.0-1500.0-None")
@pytest.mark.parametrize(("east", "altitude", "off"), [
    (0.0, ALTITUDE, None),
    (0.0, ALTITUDE - 900.0, None),  # counted from the take-off
    (0.0075, ALTITUDE, "5[89][0-9] m away from it in plan and [0-9] m in height")])
@pytest.mark.parametrize("count", [4, 7])
def test_a_wrong_position_in_exif_does_not_spoil_the_points(
        count: int, east: float, altitude: float, off: str | None, tmp_path: Path,
        caplog: pytest.LogCaptureFixture) -> None:
    save_photo(tmp_path / "photo.jpg", latitude=LATITUDE, longitude=LONGITUDE + east,
               altitude=altitude)
    control, ground, image = photo(count, seed=5)
    middle = (np.array(SIZE) - 1.0) / 2.0
    as_in_exif = (control.points.image - middle) * FOCAL_IN_EXIF / FOCAL + middle
    control = replace(control, points=replace(control.points, image=as_in_exif))
    features = termsel.read(rows_of(control), crs=CRS, image=tmp_path / "photo.jpg")
    result = termsel.run(features=features, method="known-camera")
    assert rmse(result.fit, ground, (image - middle) * FOCAL_IN_EXIF / FOCAL + middle) < 3.0
    assert "to 30 m in plan and 500 m in height, are taken from the EXIF" in caplog.text
    described = KNOWN_CAMERA.describe(result.fit)
    assert "known by the focal length in the EXIF of the image" in described
    assert ("as known to 30 m in plan and 500 m in height" in described) == (off is None)
    said = [note for note in result.record.notes if "position in the EXIF is not used" in note]
    assert len(said) == (off is not None)
    assert off is None or re.search(off, said[0])


def test_the_exif_of_an_image_says_the_camera(tmp_path: Path) -> None:
    save_photo(tmp_path / "photo.jpg", latitude=45.15, longitude=13.725, altitude=1500.0)
    control, _, _ = photo(4)
    table = rows_of(control)
    known = interior_of(termsel.read(table, crs=CRS, image=tmp_path / "photo.jpg"))
    assert known is not None
    assert known.focal == pytest.approx(FOCAL_IN_EXIF, rel=1e-4)
    assert known.position[2] == 1500.0
    # What is stated comes before what the image says.
    stated = interior_of(termsel.read(table, crs=CRS, image=tmp_path / "photo.jpg",
                                      camera_focal="3500"))
    assert stated is not None
    assert stated.focal == 3500.0


@pytest.mark.slow_cases("88.0")
@pytest.mark.parametrize("down", [88.0, 35.0])
def test_blunders_are_judged_by_the_camera(down: float) -> None:
    """A cubic polynomial follows an oblique view of hills too badly to tell a blunder."""
    control, ground, image = photo(22, down=down, seed=3, camera_focal=FOCAL)
    measured = control.points.image.copy()
    measured[[4, 13, 17]] += [[25.0, -14.0], [-9.0, 18.0], [40.0, 30.0]]
    wrong = control.with_(points=replace(control.points, image=measured))
    result = termsel.run(features=wrong)
    assert {outlier.id for outlier in result.outliers} == {"P4", "P13", "P17"}
    assert rmse(result.fit, ground, image) < 1.5


def test_the_method_keeps_the_rules() -> None:
    for check in checks(KNOWN_CAMERA, features=[photo(10, camera_focal=FOCAL)[0], photo(3)[0]]):
        check.run()


@pytest.mark.slow
@pytest.mark.skipif(not (DATA / "smapshot_nadir").is_dir(), reason="needs TERMSEL_DATA")
def test_real_photos_are_resected() -> None:
    """Photos of the years 1920 to 2000, measured by volunteers: some 7 px each by the others."""
    folder = DATA / "smapshot_nadir"
    rows = (folder / "photos.csv").read_text("utf-8").splitlines()[1:40:3]
    errors = []
    for name, width, height, focal, *_ in (row.split(",") for row in rows):
        features = termsel.read(folder / f"{name}.csv", crs="EPSG:4979", camera_focal=focal)
        features = replace(features, image_size=(int(height), int(width)))
        fitted = KNOWN_CAMERA.fit(FitData.of(features))
        errors.append(fitted.held_out_rmse)
    assert np.median(errors) < 9.0


@pytest.mark.slow
def test_photos_of_one_flight_share_their_camera(tmp_path: Path) -> None:
    files = []
    for seed in range(4):
        control, _, _ = photo(8, seed=seed, lens=Lens(-0.03))
        rows = [f"{name},{'independent' if name == 'P7' else ''},{line},{sample},{x},{y},{z}"
                for name, (line, sample), (x, y, z) in zip(
                    control.points.ids, control.points.image, control.points.ground, strict=True)]
        files.append(tmp_path / f"{seed}.csv")
        files[-1].write_text("\n".join(["id,role,line,sample,x,y,z", *rows]), encoding="utf-8")
    done = invoke("flight-camera", *files, "--crs", CRS, "--size", *SIZE, "--focal", "3600", "-o",
                  tmp_path / "camera.json")
    assert done.exit_code == 0, done.stderr
    other = invoke("flight-camera", *files, "--crs", CRS, "--size", 500, 600, "-o",
                   tmp_path / "other.json")
    assert other.exit_code == 2
    assert "0.csv: the image has 500 lines and 600 samples" in other.stderr
    camera = json.loads((tmp_path / "camera.json").read_text("utf-8"))
    assert camera["source"] == "4 photos, 28 control points"
    assert abs(camera["focal"] / FOCAL - 1.0) < max(3.0 * camera["focal_spread"], 0.01)
    assert abs(camera["distortion"][0] + 0.03) < 0.03
    assert camera["size"] == list(SIZE)


def test_photos_of_a_flight_are_read_as_those_of_a_batch(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[FeatureSet] = []

    def of_stand_in(photos: list[FeatureSet], *_: object) -> SharedCamera:
        taken.extend(photos)
        return SharedCamera(FOCAL, 0.01, 0.0, 1.0, photos=1, points=4, residuals=(1.0,))

    monkeypatch.setattr("termsel_cameras.known.sharing.shared_camera", of_stand_in)
    dem = tmp_path / "dem.tif"
    with rasterio.open(dem, "w", driver="GTiff", width=30, height=30, count=1, dtype="float32",
                       crs=CRS, transform=from_origin(399_000, 5_001_500, 100, 100)) as raster:
        raster.write(np.full((30, 30), 250.0, np.float32), 1)
    path = tmp_path / "photo.csv"
    path.write_text("nombre,fila,columna,este,norte\nA,10,20,400010,5000020\n"
                    "B,900,40,400030,4999100\nC,20,800,400900,5000010\nD,950,980,401000,4999000\n")
    words = ["flight-camera", path, "--crs", CRS, "--size", *SIZE, "-o", tmp_path / "camera.json"]
    columns = "id=nombre,line=columna,sample=fila,x=este,y=norte"
    done = invoke(*words, "--dem", dem, "--columns", columns, "--set", "swapped=line-sample")
    assert done.exit_code == 0, done.stderr
    assert taken[0].points.ids == ("A", "B", "C", "D")
    assert taken[0].points.image.tolist()[1] == [900.0, 40.0]
    assert taken[0].points.ground[:, 2].tolist() == [250.0] * 4


@pytest.mark.parametrize(("setting", "message"), [
    ("camera_focal=3500", "flight-camera has no option 'camera_focal'"),
    ("degree=2", "flight-camera has no option 'degree'"),
    ("z_unti=ft", "z_unti"), ("z_unit", "not of the form KEY=VALUE")])
def test_options_that_a_flight_has_not_are_refused(
        setting: str, message: str, tmp_path: Path) -> None:
    done = invoke("flight-camera", tmp_path / "a.csv", "--size", 100, 100, "--set", setting, "-o",
                  tmp_path / "camera.json")
    assert done.exit_code == 2
    assert message in done.stderr


@pytest.mark.slow
def test_a_flight_of_strong_distortion_shows_its_camera_and_a_photo_that_is_not_of_it() -> None:
    photos = [photo(8, seed=seed, lens=Lens(-0.05))[0] for seed in range(4)]
    wild = photos[0].points.image + 60.0 * np.random.default_rng(1).standard_normal((8, 2))
    photos.append(replace(photos[0], points=replace(photos[0].points, image=wild)))
    camera = shared_camera(photos, SIZE)
    assert abs(np.log(camera.focal / FOCAL)) < 3.0 * camera.spread < 0.1
    assert abs(camera.k1 + 0.05) < 0.02
    assert unlike_photos("abcde", camera.residuals)[0].startswith("e (")


@pytest.mark.slow
@pytest.mark.parametrize(("focal", "remedy"), [
    (None, "give --focal PX"), (3000.0, "check --focal")])
def test_points_that_show_no_focal_length_are_said_to(focal: float | None, remedy: str) -> None:
    """An image by parallel rays, such as of a satellite, is that of an endless focal length."""
    control, _, _ = photo(8)
    ground = control.points.ground
    rays = np.array([[0.1, -0.6], [0.6, 0.1], [0.2, -0.1]])
    image = (ground - ground.mean(axis=0)) @ rays + np.array(SIZE) / 2.0
    parallel = replace(control, points=replace(control.points, image=image))
    with pytest.raises(TermselError, match="do not determine a focal length") as refused:
        shared_camera([parallel], SIZE, focal)
    assert remedy in str(refused.value)


@pytest.mark.slow
def test_the_rmse_predicted_of_four_points_is_of_the_size_of_the_true_one() -> None:
    """Without one of four points a camera is hardly determined, so that held-out errors run wild.
    """
    ratios, holds = [], []
    for seed in range(6):
        control, ground, image = photo(4, down=40.0, seed=seed, noise=4.0, camera_focal=FOCAL)
        result = termsel.run(features=control)
        measured = image + 4.0 * np.random.default_rng(seed).standard_normal(image.shape)
        true = np.sqrt(((result.project(ground) - measured) ** 2).sum(axis=1).mean())
        predicted = result.predicted
        assert predicted is not None
        ratios.append(predicted.rmse / true)
        holds.append(predicted.low <= true <= predicted.high)
        assert predicted.high / predicted.low < 30.0
    assert 0.7 < np.median(ratios) < 1.5
    assert sum(holds) >= 5


@pytest.mark.parametrize(("stated", "spread"), [
    ("0.3%", 0.003), ("7px", 0.002), ("fixed", 1e-6), ("0", 1e-6), ("0.0", 1e-6), ("0%", 1e-6)])
def test_how_well_a_focal_length_is_known_can_be_stated(stated: str, spread: float) -> None:
    control, _, _ = photo(8, camera_focal=FOCAL, camera_focal_spread=stated)
    interior = interior_of(control)
    assert interior is not None
    assert interior.focal_spread == pytest.approx(spread)


def test_the_size_in_a_camera_file_shows_the_middle_of_the_photo(tmp_path: Path) -> None:
    camera = tmp_path / "camera.json"
    control = replace(photo(8, camera=str(camera))[0], image_size=None)
    camera.write_text(json.dumps({"focal": FOCAL, "size": [2000, 3001]}))
    interior = interior_of(control)
    assert interior is not None
    assert (interior.line, interior.sample) == (999.5, 1500.0)
    # The image itself tells its size better.
    of_image = interior_of(replace(control, image_size=(4000, 4000)))
    assert of_image is not None
    assert of_image.line == 1999.5
    camera.write_text(json.dumps({"focal": FOCAL, "size": [2000, -1]}))
    with pytest.raises(TermselError, match=r"camera\.json is -1, which is not positive"):
        interior_of(control)


def test_what_all_photos_lack_is_said_once(tmp_path: Path) -> None:
    for seed in range(3):
        control, _, _ = photo(8, seed=seed)
        rows = [f"{name},{line},{sample},{x},{y},{z}" for name, (line, sample), (x, y, z) in zip(
            control.points.ids, control.points.image, control.points.ground, strict=True)]
        (tmp_path / f"{seed}.csv").write_text("\n".join(["id,line,sample,x,y,z", *rows]))
    done = invoke("compare", "--points", tmp_path / "*.csv", "--crs", CRS, "--method", "affine",
                  "--set", "camera_focal=3500", "--out", tmp_path / "out", "--quiet")
    assert done.exit_code == 0, done.stderr
    assert done.stderr.count("nothing shows the size of the image") == 1
    assert "that on the size of the image concerns 2 further images as well" in done.stderr


@pytest.mark.parametrize(("focal_spread", "expected"), [(0.3, 0.3), (0.0, 1e-6), ("0.3%", 0.003)])
def test_the_focal_spread_of_a_camera_file_is_relative(
        tmp_path: Path, focal_spread: object, expected: float) -> None:
    camera = tmp_path / "camera.json"
    camera.write_text(json.dumps({"focal": FOCAL, "focal_spread": focal_spread}))
    assert interior_of_file(str(camera)).focal_spread == pytest.approx(expected)


@pytest.mark.parametrize("stated", [
    {"camera_focal_spread": "fixed", "camera_pixel": "banana"}, {"camera_height": 1500}])
def test_options_of_a_camera_without_a_focal_length_are_refused(stated: dict[str, Any]) -> None:
    table = [{"id": "A", "line": 1.0, "sample": 2.0, "x": 4e5, "y": 5e6, "z": 5.0}]
    with pytest.raises(TermselError, match="camera whose focal length nothing states") as refused:
        termsel.read(table, crs=CRS, **stated)
    assert all(name in refused.value.what for name in stated)
    assert "camera_focal" in str(refused.value.hint)


def test_a_number_without_a_unit_is_no_focal_spread() -> None:
    control, _, _ = photo(8, camera_focal=FOCAL, camera_focal_spread="0.3")
    with pytest.raises(TermselError, match=r"camera_focal_spread=0\.3 has no unit") as refused:
        interior_of(control)
    assert refused.value.hint == "Write 0.3% or 0.3px, or fixed."


@pytest.mark.parametrize("stated", ["3500", "-1%", "much"])
def test_a_focal_length_known_to_nothing_is_refused(stated: str) -> None:
    control, _, _ = photo(8, camera_focal=FOCAL, camera_focal_spread=stated)
    with pytest.raises(TermselError, match="camera_focal_spread"):
        interior_of(control)


def test_a_fixed_interior_stays_as_it_is_stated() -> None:
    control, _, _ = photo(12, camera_focal=FOCAL * 1.005, camera_focal_spread="fixed",
                          camera_principal_point="1499.5,1999.5",
                          camera_principal_point_spread="fixed")
    figures = {figure.name: figure.value for figure in termsel.run(
        features=control, method="known-camera").sensor}
    fitted = KNOWN_CAMERA.fit(FitData.of(control))
    assert figures["focal length"] == pytest.approx(FOCAL * 1.005, abs=0.01)
    assert figures["principal point, line"] == pytest.approx(1499.5, abs=0.01)
    assert "It is fixed, as stated." in KNOWN_CAMERA.describe(fitted)
    free, _, _ = photo(12, camera_focal=FOCAL * 1.005)
    said = KNOWN_CAMERA.describe(KNOWN_CAMERA.fit(FitData.of(free)))
    assert "taken to be known to 1 % (35 px" in said


@pytest.mark.slow
def test_standard_deviations_of_the_pose_hold() -> None:
    errors = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        control, _, _ = photo(14, seed=seed, noise=2.0, camera_focal=FOCAL * (
            1.0 + 0.01 * rng.standard_normal()))
        figures = termsel.run(features=control, method="known-camera").sensor
        truth = [400_000.0, 5_000_000.0, 300.0 + HIGH]
        for figure, value in zip(figures[:3], truth, strict=True):
            assert figure.standard_deviation is not None
            errors.append((figure.value - value) / figure.standard_deviation)
        focal = figures[6]
        assert focal.standard_deviation is not None
        errors.append((focal.value - FOCAL) / focal.standard_deviation)
    assert 0.7 < float(np.sqrt(np.mean(np.square(errors)))) < 1.4


def test_options_of_a_camera_are_listed_and_misspelt_ones_refused(tmp_path: Path) -> None:
    file = tmp_path / "gcps.csv"
    file.write_text("id,line,sample,x,y,z\nA,1,2,3,4,5\n")
    done = invoke("run", file, "--crs", CRS, "--set", "camera_focal_sprea=1%")
    assert done.exit_code == 2
    assert "unknown option 'camera_focal_sprea'. Did you mean 'camera_focal_spread'?" in done.stderr
    listed = invoke("describe", "data").stdout
    assert "camera_focal_spread" in listed
    assert "camera_position" in listed


@pytest.mark.parametrize("stated", [0.5, 0.8, 1.15, 2.0])
def test_a_focal_length_that_the_points_contradict_is_refused(stated: float) -> None:
    """One of the points is a blunder: it must not hide the others' focal length."""
    control = with_blunder(photo(8, down=55.0, seed=4, camera_focal=FOCAL * stated)[0])
    message = f"the points show 3,[45].. px, not {FOCAL * stated:,.0f}"
    with pytest.raises(TermselError, match=message):
        KNOWN_CAMERA.fit(FitData.of(control))


@pytest.mark.parametrize("seed", range(4))
def test_a_right_focal_length_is_kept_next_to_a_blunder(seed: int) -> None:
    control = with_blunder(photo(8, down=55.0, seed=seed, camera_focal=FOCAL)[0])
    assert KNOWN_CAMERA.fit(FitData.of(control)).model.name == "known-frame"


def with_blunder(control: FeatureSet) -> FeatureSet:
    """Return control whose third point is off by 23 px."""
    image = control.points.image.copy()
    image[2] += [18.0, -14.0]
    return control.with_(points=replace(control.points, image=image))


def test_points_that_cannot_show_the_focal_length_say_so() -> None:
    data = FitData.of(photo(6, down=88.0, noise=6.0, camera_focal=FOCAL)[0])
    assert "cannot show whether it is right" in KNOWN_CAMERA.describe(KNOWN_CAMERA.fit(data))
    few = FitData.of(photo(4, down=55.0, camera_focal=FOCAL)[0])
    assert "So few points cannot show" in KNOWN_CAMERA.describe(KNOWN_CAMERA.fit(few))


def test_a_run_says_that_the_camera_needs_heights() -> None:
    control = photo(5, down=55.0, camera_focal=FOCAL)[0]
    ground = control.points.ground.copy()
    ground[:, 2] = np.nan
    flat = control.with_(points=replace(control.points, ground=ground))
    assert any("the points have no heights. --dem FILE" in note
               for note in termsel.run(features=flat).notes)


@pytest.mark.slow
def test_the_focal_length_of_an_oblique_photo_is_no_place_of_the_grid() -> None:
    found = shared_camera([photo(20, down=50.0)[0]], SIZE)
    assert found.focal == pytest.approx(FOCAL, rel=0.005)
    assert found.sigma < 1.0


def test_a_focal_length_in_mm_takes_the_pixel_from_the_image(tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    control, _, _ = photo(4)
    table = [{"id": name, "line": line, "sample": sample, "x": x, "y": y, "z": z}
             for name, (line, sample), (x, y, z) in zip(
                 control.points.ids, control.points.image, control.points.ground, strict=True)]
    picture = image.new("L", (SIZE[1], SIZE[0]))
    exif = image.Exif()
    # 35 mm and 24 mm of a sensor of 10 um: a resolution of 2,540 pixels an inch.
    exif.get_ifd(0x8769).update({0x920A: 35.0, 0xA20E: 2540.0, 0xA210: 2})
    picture.save(tmp_path / "photo.jpg", exif=exif)
    known = interior_of(termsel.read(table, crs=CRS, image=tmp_path / "photo.jpg",
                                     camera_focal="24mm"))
    assert known is not None
    assert known.focal == pytest.approx(2400.0)
    picture.save(tmp_path / "plain.tif")
    with pytest.raises(TermselError, match="no EXIF that says how large its pixels are") as caught:
        termsel.read(table, crs=CRS, image=tmp_path / "plain.tif", camera_focal="24mm")
    assert str(caught.value.file).endswith("plain.tif")
    assert "camera_pixel=4.4" in str(caught.value)
    # The remedy is followed.
    known = interior_of(termsel.read(table, crs=CRS, image=tmp_path / "plain.tif",
                                     camera_focal="24mm", camera_pixel="10"))
    assert known is not None
    assert known.focal == pytest.approx(2400.0)
