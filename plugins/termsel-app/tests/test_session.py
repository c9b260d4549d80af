"""Sessions: every change is kept, undone and repeated, and nothing is lost."""

from __future__ import annotations

import json
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio.transform import Affine

import termsel
from termsel import FeatureSet, Lines, TermselError
from termsel_app.control import Patch
from termsel_app.journal import JOURNAL_NAME, open_journal
from termsel_app.places import Places
from termsel_app.prediction import Prediction
from termsel_app.quality import prediction_errors
from termsel_app.session import Files, Session, open_session, records_of


def write_raster(path: Path, pixels: Any, crs: str | None = None, transform: Any = None,
                 **more: Any) -> Path:
    """Write pixels (bands, lines, samples) as GeoTIFF."""
    with rasterio.open(path, "w", driver="GTiff", count=len(pixels), height=pixels.shape[1],
                       width=pixels.shape[2], dtype=pixels.dtype, crs=crs,
                       transform=transform, **more) as raster:
        raster.write(pixels)
    return path


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    """Return an image of 200 lines and 300 samples."""
    pixels = np.random.default_rng(1).integers(0, 255, (1, 200, 300)).astype(np.uint8)
    return write_raster(tmp_path / "scan.tif", pixels)


@pytest.fixture
def ortho(tmp_path: Path) -> Path:
    """Return a map of 300 m by 200 m."""
    pixels = np.random.default_rng(2).integers(0, 255, (1, 200, 300)).astype(np.uint8)
    return write_raster(tmp_path / "ortho.tif", pixels, "EPSG:25832",
                        Affine(1, 0, 500000, 0, -1, 5200000))


@contextmanager
def session_of(folder: Path, *arguments: Any, **more: Any) -> Iterator[Session]:
    """Open a session without the process that judges."""
    with open_session(Files(*arguments, **more), folder) as session:
        worker = session.worker
        assert worker is not None
        worker.close()
        session.worker = None
        yield session


def test_every_change_is_there_again_at_the_next_start(
        scan: Path, ortho: Path, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    with session_of(folder, str(scan), (str(ortho),)) as session:
        name = session.put({"image": [10.0, 20.0]})
        session.put({"id": name, "map": [500020.5, 5199989.5]})
        second = session.put({"map": [500100.0, 5199900.0]})
        session.put({"id": second, "image": [99.0, 99.0], "role": "independent"})
        session.put({"id": name, "name": "corner of the church"})
        session.delete([second])
        session.undo()
        before = session.state()
    with session_of(folder, str(scan), (str(ortho),)) as session:
        assert session.state() == {**before, "version": 0}
        assert [record["id"] for record in session.control.records.values()] == [
            "corner of the church", second]
        session.redo()
        assert second not in session.control.records
        for _ in range(6):
            session.undo()
        assert not session.control.records
        with pytest.raises(TermselError, match="nothing to undo"):
            session.undo()


def test_a_line_that_was_cut_off_is_dropped_and_one_that_was_edited_is_named(
        scan: Path, ortho: Path, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    with session_of(folder, str(scan), (str(ortho),)) as session:
        session.put({"image": [10.0, 20.0]})
    journal = folder / JOURNAL_NAME
    whole = journal.read_bytes()
    journal.write_bytes(whole + b'{"change": [[null, {"id": "P0')
    with session_of(folder, str(scan), (str(ortho),)) as session:
        assert list(session.control.records) == ["P01"]
    assert journal.read_bytes() == whole
    for line in (b"[]", b'{"change": 3}', b'{"undo": 1}\n{"undo": 1}', b"nonsense",
                 b'{"change": [[null, {"id": "A", "kind": "point", "image": [1e999, 0]}]]}'):
        journal.write_bytes(whole + line + b"\n")
        with pytest.raises(TermselError) as refused, session_of(folder, str(scan), (str(ortho),)):
            pass
        assert refused.value.line in (3, 4), line


def test_nothing_is_lost_when_the_disk_is_full(
        scan: Path, ortho: Path, tmp_path: Path) -> None:
    resource = pytest.importorskip("resource")  # not on Windows
    folder = tmp_path / "out"
    with session_of(folder, str(scan), (str(ortho),)) as session:
        session.put({"image": [10.0, 20.0]})
        size = (folder / JOURNAL_NAME).stat().st_size
        limits = resource.getrlimit(resource.RLIMIT_FSIZE)
        handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size + 5, limits[1]))
        try:
            with pytest.raises(TermselError, match="could not be saved") as refused:
                session.put({"image": [30.0, 40.0]})
            with pytest.raises(TermselError, match="could not be saved"):
                session.undo()
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
            signal.signal(signal.SIGXFSZ, handler)
        assert "lost" in (refused.value.hint or "")
        assert list(session.control.records) == ["P01"]
        assert (folder / JOURNAL_NAME).stat().st_size == size
        session.put({"image": [30.0, 40.0]})
    with session_of(folder, str(scan), (str(ortho),)) as session:
        assert list(session.control.records) == ["P01", "P02"]


def test_one_process_at_a_time_has_a_session(scan: Path, ortho: Path, tmp_path: Path) -> None:
    import subprocess
    import sys

    with session_of(tmp_path / "out", str(scan), (str(ortho),)):
        done = subprocess.run(
            [sys.executable, "-m", "termsel", "app", str(scan), "--map", str(ortho), "--out",
             str(tmp_path / "out"), "--no-browser"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "at work in this folder" in done.stderr
    assert "Another `termsel app` has this session open" in " ".join(done.stderr.split())


def test_no_link_in_the_folder_of_a_session_is_followed(
        scan: Path, ortho: Path, tmp_path: Path) -> None:
    target = tmp_path / "target"
    target.write_text("kept")
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / JOURNAL_NAME).symlink_to(target)
    with pytest.raises(TermselError, match="link"), session_of(folder, str(scan), (str(ortho),)):
        pass
    assert target.read_text() == "kept"


def test_a_strangers_session_asks_no_server_and_names_no_output() -> None:
    kept = Files.of_header({"image": "scan.tif", "maps": [
        "https://example.org/{z}/{x}/{y}.png", "/vsicurl/http://127.0.0.1/a.tif", "ortho.tif"],
        "out": "/etc", "allow_remote": True, "command": "x"}, Path("place"))
    assert kept.maps == (str(Path("place", "ortho.tif")),)
    for header in ({"maps": "ortho.tif"}, {"image": 3}, {"maps": [1]}, {"size": [1, -1]}):
        with pytest.raises(TermselError):
            Files.of_header(header, Path("place"))


def test_a_session_of_another_image_or_crs_is_refused(
        scan: Path, ortho: Path, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    with session_of(folder, str(scan), (str(ortho),)):
        pass
    with pytest.raises(TermselError, match="of another image"), \
            session_of(folder, str(ortho), (str(ortho),)):
        pass
    with pytest.raises(TermselError, match="not in EPSG:4326"), \
            session_of(folder, str(scan), (str(ortho),), crs="EPSG:4326"):
        pass


def test_what_is_missing_is_said_before_a_page_opens(
        scan: Path, ortho: Path, tmp_path: Path) -> None:
    bare = write_raster(tmp_path / "bare.tif", np.zeros((1, 9, 9), dtype=np.uint8), None,
                        Affine(1, 0, 7, 0, -1, 9))
    cases: tuple[tuple[tuple[Any, ...], str], ...] = (
        ((str(scan),), "CRS of the ground coordinates is not known"),
        ((str(scan), (str(scan),)), "not georeferenced"),
        ((str(scan), (str(bare),)), "has no CRS"),
        ((str(tmp_path / "none.tif"), (str(ortho),)), "none.tif"))
    for arguments, said in cases:
        with pytest.raises(TermselError) as refused, \
                session_of(tmp_path / "out", *arguments):
            pass
        assert said in f"{refused.value.what} {refused.value.file}"
        assert not (tmp_path / "out").exists()


def test_a_map_elsewhere_is_told(scan: Path, ortho: Path, tmp_path: Path) -> None:
    far = write_raster(tmp_path / "far.tif", np.zeros((1, 9, 9), dtype=np.uint8), "EPSG:4326",
                       Affine(0.1, 0, -70, 0, -0.1, 10))
    with session_of(tmp_path / "out", str(scan), (str(ortho), str(far))) as session:
        assert len(session.notes) == 1
        assert "far.tif does not overlap ortho.tif" in session.notes[0]


def test_pasted_rows_become_points_or_complete_them(
        scan: Path, ortho: Path, tmp_path: Path) -> None:
    with session_of(tmp_path / "out", str(scan), (str(ortho),)) as session:
        first = session.put({"image": [10.0, 20.0]})
        assert session.paste(f"{first}\t500001.5\t5199990\nB 7\t500003\t5199991") == (2, [])
        assert session.control.records[first]["image"] == [10.0, 20.0]
        assert session.control.records[first]["ground"] == [500001.5, 5199990.0, None]
        assert session.control.records["B 7"]["image"] is None
        session.paste("role;id;y;x\nindependent;C;5199992;500009")
        assert session.control.records["C"]["role"] == "independent"
        assert session.control.records["C"]["ground"] == [500009.0, 5199992.0, None]
        version = session.version
        for text in ("", "a b", "D, 1, twelve", "D, 1, 2\nD, 3, 4", "id,role,x,y\nE,boss,1,2",
                     "E, 1, 2\nF, 1", "E, nan, 3"):
            with pytest.raises(TermselError):
                session.paste(text)
        assert session.version == version


@pytest.mark.parametrize("name", ["z", "height", "elev", "h", "Elevation [m]"])
@pytest.mark.parametrize("image", ["line,sample,", ""])
def test_a_paste_knows_the_names_that_a_run_knows(
        scan: Path, ortho: Path, tmp_path: Path, name: str, image: str) -> None:
    numbers = "10,20," if image else ""
    with session_of(tmp_path / "out", str(scan), (str(ortho),)) as session:
        session.paste(f"Point,{image}Easting,Northing,{name}\nA,{numbers}500020,5199990,210")
        assert session.control.records["A"]["ground"] == [500020.0, 5199990.0, 210.0]
        assert session.control.records["A"]["image"] == ([10.0, 20.0] if image else None)
        session.paste("A;500021,5;5199990,5")
        assert session.control.records["A"]["ground"] == [500021.5, 5199990.5, 210.0]
        session.paste("id,role,line,sample\nA,check,11,22")
        assert session.control.records["A"]["image"] == [11.0, 22.0]
        assert session.control.records["A"]["role"] == "check"
        session.paste("line,sample,x,y\n1,2,500001,5199999\n3,4,500004,5199996")
        session.paste("line,sample,x,y\n5,6,500006,5199994")
        assert [record["image"] for record in session.control.records.values()] == [
            [11.0, 22.0], [1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]


@pytest.mark.parametrize(("text", "said"), [
    ("203.2,116.9,500273.5,5199618.3\n10,20,500020,5199990\n150,200,500201,5199850\n",
     "names above the rows, if this is right: line,sample,x,y (the first point would be line"),
    ("203.2,116.9,500273.5,5199618.3", "no header"),
    ("203.2,116.9,500273.5,5199618.3,227\n10,20,500020,5199990,228", "no header"),
    ("500273.5,5199618.3,227", "no header"),
    ("A,9999,5,500000,5199999", "200 lines and 300 samples, but points extend to line 9999"),
    ("id,line,sample\nA,5,301.5\nB,5,9000", "points extend to line 5 and sample 9000"),
    ("A,41.55,15.01", "look like degrees, but EPSG:25832 is a projected CRS"),
    ("id,x,y,z [ft]\nA,500000,5199999,700", "z is in feet"),
    ("id,line,sample,x,y,z [ft]\nA,1,2,500000,5199999,700", "z is in feet"),
    ("# crs: EPSG:25833\nid,x,y\nA,500000,5199999", "in EPSG:25833, and this session in"),
    ("A,1,2,500000,5199999\nB,3,4,500000,5199999", "same ground coordinates"),
    ("id,x,y\nA,500000,5199999\nB,500001", "row 3")])
def test_a_paste_refuses_what_a_run_refuses(
        scan: Path, ortho: Path, tmp_path: Path, text: str, said: str) -> None:
    with session_of(tmp_path / "out", str(scan), (str(ortho),)) as session:
        with pytest.raises(TermselError) as refused:
            session.paste(text)
        message = f"{refused.value.what} {refused.value.hint}"
        assert said in message
        assert "--" not in message
        assert str(tmp_path) not in message
        assert not session.control.records


def test_pasted_points_far_from_the_map_are_told(scan: Path, tmp_path: Path) -> None:
    degrees = write_raster(tmp_path / "degrees.tif", np.zeros((1, 90, 90), dtype=np.uint8),
                           "EPSG:4326", Affine(0.01, 0, 15, 0, -0.01, 42))
    with session_of(tmp_path / "out", str(scan), (str(degrees),)) as session:
        assert session.paste("A1,15.01,41.55") == (1, [])
        _, notes = session.paste("A2,41.55,15.01")
        assert "far from the map" in notes[0]
        assert "Exchange x and y" in notes[0]
        _, notes = session.paste("A3,-70.5,10.5")
        assert "Check the coordinates" in notes[0]


@pytest.mark.parametrize("image", [[9999.0, 5.0], [5.0, 320.0], [-30.0, 5.0]])
def test_no_point_is_measured_outside_the_image(
        scan: Path, ortho: Path, tmp_path: Path, image: list[float]) -> None:
    with session_of(tmp_path / "out", str(scan), (str(ortho),)) as session:
        name = session.put({"image": [199.4, 0.0]})
        with pytest.raises(TermselError, match="outside the image, which has 200 lines and 300"):
            session.put({"id": name, "image": image})
        with pytest.raises(TermselError, match="outside the image"):
            session.put({"kind": "line", "image": [[1.0, 1.0], image]})
        assert session.control.records[name]["image"] == [199.4, 0.0]


@pytest.mark.parametrize("given", [
    {"image": [1.0]}, {"image": "here"}, {"image": [float("nan"), 1.0]}, {"map": [1.0, None]},
    {"role": "boss", "image": [1.0, 1.0]}, {"kind": "area", "image": [1.0, 1.0]},
    {"id": "none", "image": [1.0, 1.0]}, {"image": [1.0, 1.0], "name": "a\nb"},
    {"kind": "line", "image": [[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]]}])
def test_what_is_no_measurement_is_refused(
        scan: Path, ortho: Path, tmp_path: Path, given: dict[str, Any]) -> None:
    with session_of(tmp_path / "out", str(scan), (str(ortho),)) as session:
        with pytest.raises(TermselError):
            session.put(given)
        assert session.version == 0
        assert not session.control.records


def test_points_of_a_file_are_the_beginning_and_are_read_once(
        scan: Path, ortho: Path, tmp_path: Path) -> None:
    points = tmp_path / "points.csv"
    points.write_text("# crs: EPSG:25832\nid,role,line,sample,x,y,z\n"
                      "A,check,1,2,500001,5199999,\nB,,3,4,500004,5199990,7.5\n")
    folder = tmp_path / "out"
    given = {"maps": (str(ortho),), "points": str(points)}
    with session_of(folder, str(scan), **given) as session:
        assert session.control.records["B"]["ground"] == [500004.0, 5199990.0, 7.5]
        session.delete(["A"])
    with session_of(folder, str(scan), **given) as session:
        assert list(session.control.records) == ["B"]


def test_heights_come_from_the_dem(scan: Path, ortho: Path, tmp_path: Path) -> None:
    dem = write_raster(tmp_path / "dem.tif", np.full((1, 40, 60), 321.5, dtype=np.float32),
                       "EPSG:25832", Affine(10, 0, 499900, 0, -10, 5200100))
    with session_of(tmp_path / "out", str(scan), (str(ortho),), dem=str(dem)) as session:
        name = session.put({"map": [500010.0, 5199950.0]})
        assert session.control.records[name]["ground"][2] == 321.5
        typed = session.put({"ground": [500020.0, 5199950.0, None]})
        assert session.control.records[typed]["ground"][2] == 321.5
        stated = session.put({"ground": [500030.0, 5199950.0, 12.0]})
        assert session.control.records[stated]["ground"][2] == 12.0


def test_a_place_in_the_image_is_the_visible_one_on_the_dem(tmp_path: Path) -> None:
    # A wall of 60 m across the view of a camera in the west, 20 degrees above the horizon.
    heights = np.zeros((1, 100, 100), dtype=np.float32)
    heights[:, :, 50:54] = 60.0
    dem = write_raster(tmp_path / "dem.tif", heights, "EPSG:25832",
                       Affine(10, 0, 500000, 0, -10, 5200000))
    rng = np.random.default_rng(4)
    ground = np.column_stack([rng.uniform(500050, 500950, 30), rng.uniform(5199050, 5199950, 30),
                              rng.uniform(0, 60, 30)])

    def seen(places: np.ndarray) -> np.ndarray:
        east, north, up = (places - [498000.0, 5199500.0, 900.0]).T
        depth = 0.94 * east - 0.342 * up
        down_and_right = np.column_stack([-0.342 * east - 0.94 * up, -north])
        return np.asarray(3000.0 * down_and_right / depth[:, None])

    control = termsel.FeatureSet(
        termsel.Points(tuple(map(str, range(30))), seen(ground), ground), crs="EPSG:25832")
    places = Places("EPSG:25832", "EPSG:25832", dem)
    prediction = Prediction(termsel.fit(control, "dlt3d"), places)
    behind, before = prediction.to_map(seen(np.array([[500560.0, 5199500.0, 0.0],
                                                      [500300.0, 5199500.0, 0.0]])))
    places.close()
    assert 500490.0 < behind[0] < 500510.0
    assert before == pytest.approx([500300.0, 5199500.0], abs=0.1)


def test_a_point_that_moves_on_the_map_keeps_the_height_that_was_given(
        scan: Path, ortho: Path, tmp_path: Path) -> None:
    with session_of(tmp_path / "out", str(scan), (str(ortho),)) as session:
        point = session.put({"ground": [500020.0, 5199950.0, 242.73]})
        session.put({"id": point, "map": [500020.5, 5199950.0]})
        assert session.control.records[point]["ground"] == [500020.5, 5199950.0, 242.73]
        line = session.put({"kind": "line", "ground": [[500001.0, 5199999.0, 7.0]]})
        session.put({"id": line, "map": [[500002.0, 5199999.0], [500009.0, 5199990.0]]})
        assert session.control.records[line]["ground"] == [
            [500002.0, 5199999.0, 7.0], [500009.0, 5199990.0, None]]
        assert session.note_on_height(point) == session.note_on_height(line) == ""


def test_only_heights_of_the_dem_follow_the_dem(scan: Path, ortho: Path, tmp_path: Path) -> None:
    slope = np.tile(np.arange(60, dtype=np.float32) * 10, (1, 40, 1))
    dem = write_raster(tmp_path / "dem.tif", slope, "EPSG:25832",
                       Affine(10, 0, 499900, 0, -10, 5200100))
    with session_of(tmp_path / "out", str(scan), (str(ortho),), dem=str(dem)) as session:
        clicked = session.put({"map": [500015.0, 5199950.0]})
        assert session.control.records[clicked]["ground"][2] == 110.0
        session.put({"id": clicked, "map": [500025.0, 5199950.0]})
        assert session.control.records[clicked]["ground"][2] == 120.0
        assert session.note_on_height(clicked) == ""
        surveyed = session.put({"ground": [500015.0, 5199950.0, 64.9]})
        session.put({"id": surveyed, "map": [500025.0, 5199950.0]})
        assert session.control.records[surveyed]["ground"][2] == 64.9
        assert session.note_on_height(surveyed) == (
            f"The height of {surveyed} stays 64.90, as it was given; the DEM has 120.00 there.")
        outside = session.put({"ground": [500015.0, 5199950.0, 110.0]})
        session.put({"id": outside, "map": [400000.0, 5199950.0]})
        assert session.control.records[outside]["ground"][2] is None


def test_the_map_is_shown_in_a_plane_and_coordinates_are_those_of_the_control(
        scan: Path, tmp_path: Path) -> None:
    degrees = write_raster(tmp_path / "degrees.tif", np.zeros((1, 90, 90), dtype=np.uint8),
                           "EPSG:4326", Affine(0.01, 0, 11, 0, -0.01, 47))
    with session_of(tmp_path / "out", str(scan), (str(degrees),)) as session:
        assert session.places.shown == "EPSG:3857"
        assert session.places.crs == "EPSG:4326"
        name = session.put({"ground": [11.2, 46.5, None]})
        shown = session.state()["records"][0]["map"]
        moved = session.put({"id": name, "map": shown})
        assert session.control.records[moved]["ground"][:2] == pytest.approx([11.2, 46.5], abs=1e-9)


def test_changes_of_two_pages_at_once_are_all_kept(
        scan: Path, ortho: Path, tmp_path: Path) -> None:
    with session_of(tmp_path / "out", str(scan), (str(ortho),)) as session:
        threads = [threading.Thread(target=lambda i=i: session.put({"image": [float(i), 1.0]}))
                   for i in range(20)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(session.control.records) == session.version == 20
    with open_journal(tmp_path / "out") as (_, _, control):
        assert len(control.records) == 20


def test_the_journal_is_lines_of_json_with_the_files_first(
        scan: Path, ortho: Path, tmp_path: Path) -> None:
    with session_of(tmp_path / "out", str(scan), (str(ortho),)) as session:
        session.put({"image": [1.0, 2.0]})
    first, change = [json.loads(line) for line in
                     (tmp_path / "out" / JOURNAL_NAME).read_text("utf-8").splitlines()]
    assert first["schema"] == "termsel-app-1"
    assert first["crs"] == "EPSG:25832"
    assert first["image"] == str(Path("..", "scan.tif"))
    assert first["maps"] == [str(Path("..", "ortho.tif"))]
    assert change["change"][0][1]["image"] == [1.0, 2.0]


def test_control_is_written_as_termsel_reads_it(scan: Path, ortho: Path, tmp_path: Path) -> None:
    from termsel_app.quality import write_control_tables

    with session_of(tmp_path / "out", str(scan), (str(ortho),)) as session:
        rng = np.random.default_rng(3)
        for _ in range(5):
            session.put({"image": rng.uniform(0, 99, 2).tolist(),
                         "map": rng.uniform([500000, 5199900], [500099, 5199999]).tolist()})
        session.put({"image": [5.0, 5.0]})  # not measured on the ground yet
        line = session.put({"kind": "line", "image": [[1.0, 1.0], [9.0, 9.0]]})
        session.put({"id": line, "map": [[500001.0, 5199999.0], [500019.0, 5199980.0]]})
        features = session.control.features(session.places.crs)
        names = write_control_tables(features, tmp_path)
        again = termsel.read(names["points"], names["lines"])
    assert again.points.ids == features.points.ids == ("P01", "P02", "P03", "P04", "P05")
    np.testing.assert_array_equal(again.points.image, features.points.image)
    np.testing.assert_array_equal(again.points.ground, features.points.ground)
    np.testing.assert_array_equal(again.lines.image, features.lines.image)


def test_every_point_has_a_prediction_error_of_its_own() -> None:
    """Selection points join the fit of a choice, and are held out of it like control."""
    scene = termsel.simulate_scene("ikonos-hamedan", n_lines=0, roles=(20, 12, 10))
    result = termsel.run(features=scene)
    errors = prediction_errors(result)
    used = {row.id for row in result.residuals if row.used}
    assert errors.keys() == set(scene.ids)
    assert {"check"} == {row.role for row in result.residuals if row.used} - {"control"}
    residuals = {row.id: row.distance for row in result.residuals}
    assert np.mean([errors[name] > residuals[name] for name in used]) > 0.8


def test_a_list_of_places_is_sent_to_the_map(tmp_path: Path) -> None:
    table = tmp_path / "list.csv"
    table.write_text("Label,Easting,Northing,Elevation\n" + "".join(
        f"P{i},{270000 + i},{3850000 + i * i},9\n" for i in range(5)))
    files = Files(None, (), str(table), None, None, None, "EPSG:32639", (10, 10))
    with pytest.raises(TermselError) as error, open_session(files, tmp_path / "session"):
        pass
    assert "Give the list as a map" in str(error.value)


def test_lines_of_one_name_get_names_that_no_other_feature_has() -> None:
    image = np.arange(12.0).reshape(3, 2, 2)
    lines = Lines(("L", "L", "L.2"), image, np.concatenate(
        [image, np.zeros((3, 2, 1))], axis=2))
    records = records_of(FeatureSet(lines=lines, crs="EPSG:25832"))
    assert [record["id"] for record in records] == ["L", "L.3", "L.2"]
    assert [record["image"] for record in records] == image.tolist()


def test_a_full_session_lets_features_be_deleted(
        scan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record = {"id": "P1", "kind": "point", "role": "", "image": [1.0, 2.0],
              "ground": [500000.0, 5200000.0, None]}
    with session_of(tmp_path / "folder", image=str(scan), crs="EPSG:25832") as session:
        session.change([Patch(None, record)])
        monkeypatch.setattr("termsel_app.session.MAX_FEATURES", 1)
        with pytest.raises(TermselError, match="at most 1 feature"):
            session.change([Patch(None, {**record, "id": "P2"})])
        session.change([Patch(record, {**record, "role": "control"})])
        session.change([Patch({**record, "role": "control"}, None)])
        assert not session.control.records
