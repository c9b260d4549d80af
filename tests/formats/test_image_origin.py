"""Where tables count lines and samples from, told by an option or by signs."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import termsel
from termsel.cli.main import cli

LINES, SAMPLES = 300, 400


def table(folder: Path, turned: object = lambda line, sample: (line, sample)) -> Path:
    """Return control of an image with north up, as a table that counts in some way."""
    rng = np.random.default_rng(5)
    rows = ["# crs: EPSG:32632", "id,line,sample,x,y"]
    for number, (line, sample) in enumerate(rng.uniform(0, (LINES - 1, SAMPLES - 1), (14, 2))):
        there = turned(line, sample)  # type: ignore[operator]
        rows.append(f"p{number},{there[0]:.6f},{there[1]:.6f},{600_000 + 2 * sample:.6f},"
                    f"{5_400_000 - 2 * line:.6f}")
    path = folder / "control.csv"
    path.write_text("\n".join(rows))
    return path


def image(folder: Path, lines: int = LINES) -> Path:
    rasterio = pytest.importorskip("rasterio")
    path = folder / "sheet.tif"
    with rasterio.open(path, "w", driver="GTiff", height=lines, width=SAMPLES, count=1,
                       dtype="uint8") as raster:
        raster.write(np.full((lines, SAMPLES), 9, np.uint8), 1)
    return path


def expected(folder: Path) -> np.ndarray:
    return termsel.read(table(folder)).points.image


@pytest.mark.filterwarnings("ignore:Dataset has no geotransform")
@pytest.mark.parametrize(("origin", "turned"), [
    ("top-left", lambda line, sample: (line, sample)),
    ("corner", lambda line, sample: (line + 0.5, sample + 0.5)),
    ("top-left-corner", lambda line, sample: (line + 0.5, sample + 0.5)),
    ("y-up", lambda line, sample: (-line, sample)),
    ("y-up-corner", lambda line, sample: (-line - 0.5, sample + 0.5)),
    ("bottom-left", lambda line, sample: (LINES - 1 - line, sample)),
    ("bottom-left-corner", lambda line, sample: (LINES - line - 0.5, sample + 0.5))])
def test_each_origin_is_that_of_termsel(origin: str, turned: object, tmp_path: Path) -> None:
    true = expected(tmp_path)
    features = termsel.read(table(tmp_path, turned), image=image(tmp_path), image_origin=origin)
    np.testing.assert_allclose(features.points.image, true, atol=1e-5)
    assert features.image_origin
    assert features.image_size == (LINES, SAMPLES)


@pytest.mark.filterwarnings("ignore:Dataset has no geotransform")
def test_lines_that_are_all_negative_are_upwards_in_an_image_that_holds_them(
        tmp_path: Path) -> None:
    true = expected(tmp_path)
    path = table(tmp_path, lambda line, sample: (-line, sample))
    done = CliRunner().invoke(cli, ["run", "--points", str(path), "--image",
                                     str(image(tmp_path)), "--out", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    assert "lines are read as y upwards from the upper-left pixel" in done.output
    assert "image coordinates from the centre of the upper-left pixel, y upwards" in " ".join(
        done.output.split())
    result = termsel.read_result(tmp_path / "out")
    np.testing.assert_allclose(result.features.points.image, true, atol=1e-5)
    record = json.loads((tmp_path / "out" / "result.json").read_text())
    assert "y upwards, as all lines" in record["data"]["read"]["image_origin"]
    termsel.rectify(result, image(tmp_path), tmp_path / "map.tif")


@pytest.mark.parametrize("lines", [None, 100])
@pytest.mark.filterwarnings("ignore:Dataset has no geotransform")
def test_lines_that_are_all_negative_are_named_with_the_switch_elsewhere(
        lines: int | None, tmp_path: Path) -> None:
    path = table(tmp_path, lambda line, sample: (-line, sample))
    given = [] if lines is None else ["--image", str(image(tmp_path, lines))]
    done = CliRunner().invoke(cli, ["run", "--points", str(path), *given])
    assert done.exit_code == 2
    assert "all lines are at most 0" in done.output
    assert "--set image_origin=y-up" in done.output
    assert str(path) in done.output
    for origin in ("y-up", "top-left"):
        assert CliRunner().invoke(cli, ["run", "--points", str(path), "--set",
                                         f"image_origin={origin}"]).exit_code == 0


def test_lines_upwards_from_the_bottom_need_the_height_of_the_image(tmp_path: Path) -> None:
    with pytest.raises(termsel.TermselError, match="needs the height of the image") as error:
        termsel.read(table(tmp_path), image_origin="bottom-left")
    assert error.value.file == tmp_path / "control.csv"


def test_points_of_qgis_keep_their_own_rule(tmp_path: Path) -> None:
    path = tmp_path / "sheet.points"
    path.write_text("#CRS: EPSG:32632\nmapX,mapY,sourceX,sourceY,enable\n" + "\n".join(
        f"{600_000 + x},{5_400_000 - y},{x},{-y},1" for x, y in ((10, 20), (90, 30), (50, 80))))
    np.testing.assert_allclose(termsel.read(path).points.image[0], [19.5, 9.5])
    with pytest.raises(termsel.TermselError, match="defines the origin of its lines and samples"):
        termsel.read(path, image_origin="corner")


def test_a_table_of_python_is_counted_the_same_way() -> None:
    rows = [{"id": f"p{i}", "line": -10.0 * i, "sample": 7.0 * i, "x": 1.0 * i, "y": i * i}
            for i in range(1, 5)]
    with pytest.raises(termsel.TermselError, match="all lines are at most 0"):
        termsel.read(rows, crs="local")
    features = termsel.read(rows, crs="local", image_origin="y-up-corner")
    np.testing.assert_allclose(features.points.image[0], [9.5, 6.5])
    assert termsel.read(rows, crs="local", image_origin="top-left").points.image[0, 0] == -10.0


@pytest.mark.filterwarnings("ignore:Dataset has no geotransform")
def test_every_map_and_export_with_the_image_refuses_lines_before_it(tmp_path: Path) -> None:
    path = table(tmp_path, lambda line, sample: (line - 100, sample))
    result = termsel.run(features=termsel.read(path))
    sheet = image(tmp_path)
    with pytest.raises(termsel.TermselError, match="before the first pixel of the image"):
        termsel.rectify(result, sheet, tmp_path / "map.tif")
    for writer in ("rpc-vrt", "rpb", "gcp-vrt", "geolocation-vrt", "gcp-grid-vrt"):
        with pytest.raises(termsel.TermselError, match="before the first pixel of the image"):
            termsel.export(result, writer, tmp_path / "scene.vrt", image=str(sheet))
    # A format without the image is of it, too, where it is named.
    with pytest.raises(termsel.TermselError, match="before the first pixel of the image"):
        termsel.export(result, "world-file", tmp_path / "scene.tfw", image=str(sheet))
    assert not (tmp_path / "map.tif").exists()
    assert not (tmp_path / "scene.tfw").exists()


@pytest.mark.parametrize(("line", "sample"), [(LINES + 40, 10), (10, SAMPLES + 40), (-40, 10)])
def test_a_run_with_the_image_refuses_points_beyond_it_as_exports_do(
        line: float, sample: float, tmp_path: Path) -> None:
    path = table(tmp_path)
    path.write_text(f"{path.read_text()}\nfar,{line},{sample},600000,5400000\n")
    with pytest.raises(termsel.TermselError, match="points extend to"):
        termsel.read(path, image=image(tmp_path))
    done = CliRunner().invoke(cli, ["run", "--points", str(path), "--image", str(image(tmp_path))])
    assert done.exit_code == 2
    assert "points extend to" in done.stderr
    assert ": far. " in done.stderr
    assert ("image_origin=y-up" in done.stderr) == (line < 0)
    header, columns, *rows = path.read_text().splitlines()
    roles = ["off" if row.startswith("far") else "" for row in rows]
    path.write_text("\n".join([header, f"{columns},role", *(
        f"{row},{role}" for row, role in zip(rows, roles, strict=True))]))
    assert termsel.read(path, image=image(tmp_path)).image_size == (LINES, SAMPLES)


def photo(folder: Path, orientation: int) -> Path:
    """Write a JPEG whose EXIF has nothing but an orientation."""
    rasterio = pytest.importorskip("rasterio")
    path = folder / "photo.jpg"
    with rasterio.open(path, "w", driver="JPEG", height=LINES, width=SAMPLES, count=1,
                       dtype="uint8") as raster:
        raster.write(np.full((LINES, SAMPLES), 9, np.uint8), 1)
    # TIFF's header, then a directory of one entry: tag 274, a short (3), one of them.
    directory = struct.pack("<HHHIHHI", 1, 274, 3, 1, orientation, 0, 0)
    exif = b"Exif\0\0II*\0" + struct.pack("<I", 8) + directory
    start, rest = path.read_bytes()[:2], path.read_bytes()[2:]
    path.write_bytes(start + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + rest)
    return path


@pytest.mark.filterwarnings("ignore:Dataset has no geotransform")
@pytest.mark.parametrize(("orientation", "words"), [
    (1, ""), (3, "turned by 180 degrees"), (2, "mirrored"), (6, "turned by 90 degrees")])
def test_a_photo_that_viewers_turn_is_named(orientation: int, words: str, tmp_path: Path,
                                            caplog: pytest.LogCaptureFixture) -> None:
    """Points of a viewer that turns it by half a turn lie in the image all the same."""
    features = termsel.read(table(tmp_path), image=photo(tmp_path, orientation))
    assert ("as they are stored" in caplog.text) == bool(words)
    assert words in caplog.text
    caplog.clear()
    result = termsel.run(features=features, model="poly2d", solver="all-terms",
                         options={"degree": 1})
    termsel.rectify(result, tmp_path / "photo.jpg", tmp_path / "map.tif")
    assert words in caplog.text
