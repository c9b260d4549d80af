"""Products of Sentinel-1: folder, zip, annotation and image, with the choice among their images."""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("termsel_cameras", reason="termsel-cameras is not installed: "
                    "pip install -e plugins/termsel-cameras")

sys.path.insert(0, str(Path(__file__).parent))

from test_radar import LINES, SAMPLES, places_seen, written

import termsel
from termsel import TermselError
from termsel_cameras import Radar

STEM = "s1a-{swath}-{kind}-{pol}-20210401t052623-20210401t052648-026269-032297-00{number}"


def grid_of(file: Path, lines: int = 6, columns: int = 9, burst: int = 0,
            ) -> list[tuple[float, ...]]:
    """Return the lattice that a processor would write: computed places of whole pixels."""
    radar = Radar(metadata=str(file), burst=burst)
    places = places_seen(400)
    inside = radar.unshifted(places)
    near = places[np.isfinite(inside).all(axis=1)]
    image = np.stack(np.meshgrid(np.linspace(1000, LINES - 1000, lines).round(),
                                 np.linspace(4000, SAMPLES - 4000, columns).round(),
                                 indexing="ij"), axis=-1).reshape(-1, 2)
    ground: NDArray[np.float64] = radar.on_ground(image, near)
    return [(*at, *place) for at, place in zip(image.tolist(), ground.tolist(), strict=True)
            if np.isfinite(place).all()]


def product(folder: Path, images: list[tuple[str, str]], *, kind: str = "grd", bursts: int = 0,
            ) -> Path:
    """Make a product with an annotation for each swath and polarisation."""
    safe = folder / "S1A_IW_GRDH_1SDV_20210401T052623.SAFE"
    (safe / "annotation" / "calibration").mkdir(parents=True)
    (safe / "measurement").mkdir()
    (safe / "annotation" / "calibration" / "calibration-s1a.xml").write_text("<calibration/>")
    ground = kind == "grd"
    plain = written(folder / "plain.xml", ground=ground)
    lattice = grid_of(plain)
    for number, (swath, pol) in enumerate(images, 1):
        name = STEM.format(swath=swath, kind=kind, pol=pol, number=number)
        written(safe / "annotation" / f"{name}.xml", ground=ground, bursts=bursts,
                lattice=lattice)
    return safe


def image_in(safe: Path, name: str, *, corner: float = 0.0) -> Path:
    """Write the image of an annotation, with its lattice in its tags as products have it."""
    rasterio = pytest.importorskip("rasterio")
    from rasterio.control import GroundControlPoint

    features = termsel.read(safe / "annotation" / f"{name}.xml")
    gcps = [GroundControlPoint(row=line + corner, col=sample + corner, x=x, y=y, z=z)
            for (line, sample), (x, y, z) in zip(features.points.image.tolist(),
                                                 features.points.ground.tolist(), strict=True)]
    path = safe / "measurement" / f"{name}.tiff"
    with rasterio.open(path, "w", driver="GTiff", width=SAMPLES, height=LINES, count=1,
                       dtype="uint16", sparse_ok=True, tiled=True, gcps=gcps, crs="EPSG:4326"):
        pass
    return path


def zipped(safe: Path) -> Path:
    path = safe.parent / "product.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in safe.rglob("*"):
            archive.write(file, file.relative_to(safe.parent))
    return path


@pytest.mark.parametrize("form", ["folder", "folder around it", "zip", "manifest", "annotation",
                                  "image"])
def test_every_form_of_a_product_gives_its_radar(form: str, tmp_path: Path) -> None:
    safe = product(tmp_path, [("iw", "vv")])
    name = STEM.format(swath="iw", kind="grd", pol="vv", number=1)
    (safe / "manifest.safe").write_text("<xfdu/>")
    path = {"folder": lambda: safe, "folder around it": lambda: tmp_path,
            "zip": lambda: zipped(safe), "manifest": lambda: safe / "manifest.safe",
            "annotation": lambda: safe / "annotation" / f"{name}.xml",
            "image": lambda: image_in(safe, name)}[form]()
    result = termsel.run(features=path, out=tmp_path / "out")
    assert result.strategy is not None
    assert result.strategy.chosen == "named-radar"
    places = places_seen(30, seed=3)
    stated = Radar(metadata=str(path)).unshifted(places)
    np.testing.assert_allclose(result.fit.project(places), stated, atol=1e-6)
    again = termsel.read_result(tmp_path / "out")
    np.testing.assert_allclose(again.fit.project(places), stated, atol=1e-6)
    assert result.outliers == ()
    assert result.accuracy is None


def test_an_image_alone_is_a_lattice_and_says_what_the_annotation_adds(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    safe = product(tmp_path, [("iw", "vv")])
    name = STEM.format(swath="iw", kind="grd", pol="vv", number=1)
    path = image_in(safe, name)
    stated = termsel.read(safe / "annotation" / f"{name}.xml")
    (safe / "annotation" / f"{name}.xml").unlink()
    features = termsel.read(path)
    assert "With that" in caplog.text
    # The tags count from the centre of the first pixel, whatever GDAL makes of them.
    np.testing.assert_allclose(features.points.image, stated.points.image)
    assert features.image_size == (LINES, SAMPLES)
    result = termsel.run(features=features)
    assert result.strategy is not None
    assert result.strategy.chosen != "named-radar"
    assert "computed, not measured" in " ".join(result.summary().split())


def test_swaths_are_named_and_chosen(tmp_path: Path) -> None:
    safe = product(tmp_path, [("iw1", "vv"), ("iw2", "vv")], kind="slc")
    with pytest.raises(TermselError, match="IW1 VV, IW2 VV") as caught:
        termsel.read(safe)
    assert "swath=IW1" in str(caught.value.hint)
    features = termsel.read(safe, swath="iw2")
    assert "iw2" in str(features.points.attributes["sensor"][0])
    with pytest.raises(TermselError, match="no image 'IW3'"):
        termsel.read(safe, swath="IW3")


def test_polarisations_have_one_geometry_and_are_named(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    safe = product(tmp_path, [("iw", "vv"), ("iw", "vh")])
    features = termsel.read(safe)
    assert "VH, VV" in caplog.text
    again = termsel.read(safe, polarisation="VV")
    np.testing.assert_array_equal(features.points.ground, again.points.ground)
    assert "-vv-" in str(again.points.attributes["sensor"][0])
    with pytest.raises(TermselError, match="no image 'HH'"):
        termsel.read(safe, polarisation="HH")


def test_bursts_are_chosen_or_refused_with_the_remedy(tmp_path: Path) -> None:
    safe = product(tmp_path, [("iw1", "vv")], kind="slc", bursts=4)
    with pytest.raises(TermselError, match="4 bursts that overlap in time") as caught:
        termsel.run(features=safe)
    assert "burst=N" in str(caught.value.hint)
    features = termsel.read(safe, burst=2)
    assert features.points.image[:, 0].min() == 1500
    assert features.points.image[:, 0].max() == 2999
    result = termsel.run(features=features)
    places = features.points.ground[::7]
    stated = Radar(metadata=str(safe), burst=2).unshifted(places)
    np.testing.assert_allclose(result.fit.project(places), stated, atol=1e-6)


def test_lines_of_other_bursts_have_no_ground(tmp_path: Path,
                                              caplog: pytest.LogCaptureFixture) -> None:
    """They overlap in time, so that the clock of one burst puts them kilometres off."""
    safe = product(tmp_path, [("iw1", "vv")], kind="slc", bursts=4)
    result = termsel.run(features=termsel.read(safe, burst=2))
    fitted = result.fit
    height = float(fitted.ground_box()[0][2])
    image = np.array([[1500.0, 9000.0], [2250.0, 9000.0], [2999.0, 9000.0], [1400.0, 9000.0],
                      [3100.0, 9000.0], [200.0, 9000.0]])
    ground = fitted.locate(image, height)
    np.testing.assert_array_equal(np.isnan(ground[:, 0]), [False] * 3 + [True] * 3)
    np.testing.assert_allclose(fitted.project(ground[:3]), image[:3], atol=1e-4)
    # Ground that the neighbours show: a step of 800 lines from the middle, either way.
    step = (ground[2] - ground[0]) * 800.0 / 1499.0
    beyond = np.array([ground[1] + step, ground[1] - step])
    assert np.isnan(fitted.project(beyond)).all()
    assert not fitted.holds(beyond).any()
    (low, _), (high, _) = fitted.image_box()
    assert (low, high) == (1500.0, 2999.0)
    termsel.export(result, "rpc-txt", tmp_path / "burst_RPC.TXT")
    assert "of the lines 1500 to 2999 of the image alone" in caplog.text


@pytest.mark.parametrize("content", ["an empty zip", "no zip at all", "another zip", "a bad name"])
def test_what_is_no_product_is_refused_by_name(content: str, tmp_path: Path) -> None:
    path = tmp_path / "product.zip"
    if content == "no zip at all":
        path.write_bytes(b"PK\x03\x04" + bytes(100))
    else:
        with zipfile.ZipFile(path, "w") as archive:
            name = STEM.format(swath="iw", kind="grd", pol="vv", number=1)
            if content == "another zip":
                archive.writestr("a.txt", "text")
            if content == "a bad name":
                archive.writestr(f"/annotation/{name}.xml", "<product/>")
                archive.writestr(f"../annotation/{name}.xml", "<product/>")
    with pytest.raises(TermselError) as caught:
        termsel.read(path)
    assert "product.zip" in str(caught.value)


def test_a_folder_without_annotations_is_refused(tmp_path: Path) -> None:
    (tmp_path / "X.SAFE" / "annotation").mkdir(parents=True)
    with pytest.raises(TermselError, match="this is a folder"):
        termsel.read(tmp_path / "X.SAFE")


@pytest.mark.parametrize("given", ["folder", "zip"])
def test_one_point_of_ones_own_corrects_a_shift(given: str, tmp_path: Path) -> None:
    safe = product(tmp_path, [("iw", "vv")])
    path = safe if given == "folder" else zipped(safe)
    place = places_seen(31, seed=8)
    truth = Radar(metadata=str(path)).unshifted(place) + np.array([1.5, -0.8])
    numbers = ",".join(map(repr, [*truth[0].tolist(), *place[0].tolist()]))
    table = tmp_path / "own.csv"
    table.write_text(f"id,line,sample,x,y,z,sensor\nP1,{numbers},{path}\n")
    result = termsel.run(features=table, crs="EPSG:4979", out=tmp_path / "out")
    assert result.strategy is not None
    assert result.strategy.chosen == "named-radar"
    unshifted = Radar(metadata=str(path)).unshifted(place[1:])
    before = np.linalg.norm(truth[1:] - unshifted, axis=1).mean()
    after = np.linalg.norm(truth[1:] - result.fit.project(place[1:]), axis=1).mean()
    assert after < 0.25 * before
    assert "sigma_line" in result.strategy.reason
    again = termsel.read_result(tmp_path / "out").fit
    np.testing.assert_allclose(again.project(place), result.fit.project(place), atol=1e-6)


def test_the_rpc_of_a_radar_holds_over_the_heights_that_are_asked_for(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    result = termsel.run(features=product(tmp_path, [("s3", "vv")], kind="slc"))
    with caplog.at_level("INFO"):
        termsel.export(result, "rpb", tmp_path / "scene.RPB", heights="-200,4000")
    assert "heights from -200 to 4000" in caplog.text
    rpc = termsel.read_rpc(tmp_path / "scene.RPB")
    places = places_seen(300, seed=5)
    places[:, 2] = np.random.default_rng(0).uniform(-200.0, 4000.0, len(places))
    seen = result.fit.project(places)
    low, high = result.fit.image_box()
    inside = ((seen >= low) & (seen <= high)).all(axis=1)
    assert inside.sum() > 30
    away = np.linalg.norm(rpc.project(places[inside]) - seen[inside], axis=1)
    assert np.sqrt((away**2).mean()) < 0.05


def test_the_rpc_of_a_jumping_ground_range_has_no_pole(tmp_path: Path) -> None:
    """No cubic follows ground range that changes every second; denominators would try."""
    safe = product(tmp_path, [("iw", "vv")])
    file = next((safe / "annotation").glob("*.xml"))
    text = file.read_text()
    start = text.index("<coordinateConversionList>")
    end = text.index("</coordinateConversionList>")
    rng = np.random.default_rng(2)
    stamps = [f"2021-04-01T05:26:{23 + second:02d}.794457" for second in range(14)]
    records = "".join(
        f"<coordinateConversion><azimuthTime>{stamp}</azimuthTime><sr0>800000.0</sr0>"
        f"<srgrCoefficients>{rng.normal(0.0, 30.0)} {1.9 + rng.normal(0.0, 1e-4)} -1.2e-6"
        "</srgrCoefficients></coordinateConversion>" for stamp in stamps)
    file.write_text(f"{text[:start]}<coordinateConversionList>{records}{text[end:]}")
    radar = Radar(metadata=str(file))
    lattice = termsel.read(file).points
    features = termsel.FeatureSet(
        termsel.Points(lattice.ids, radar.unshifted(lattice.ground), lattice.ground,
                       attributes=lattice.attributes), crs="EPSG:4979",
        image_size=(LINES, SAMPLES))
    fitted = termsel.fit(features, "named-radar")
    found = termsel.rpc_of(fitted)
    assert found.rms < 6.0
    # At the edges, and some way beyond them, it stays near the model.
    places = places_seen(400, seed=6)
    away = np.linalg.norm(found.rpc.project(places) - fitted.project(places), axis=1)
    assert np.nanmax(away) < 40.0


def test_one_point_is_enough_for_a_map_of_the_whole_image(tmp_path: Path) -> None:
    """Where the image is and how large it is, the annotation says."""
    safe = product(tmp_path, [("iw", "vv")])
    radar = Radar(metadata=str(safe))
    place = places_seen(1, seed=9)
    seen = radar.unshifted(place)
    points = termsel.Points(("P1",), seen, place,
                            attributes={"sensor": np.array([str(safe)], dtype=object)})
    fitted = termsel.fit(termsel.FeatureSet(points, crs="EPSG:4979"), "named-radar")
    assert fitted.image_box() == ((0.0, 0.0), (LINES - 1.0, SAMPLES - 1.0))
    corners = np.array([[0.0, 3000.0], [LINES - 1.0, SAMPLES - 3000.0]])
    back = fitted.locate(corners, 500.0)
    np.testing.assert_allclose(fitted.project(back), corners, atol=1e-5)
