"""The plugin in QGIS: qgis_process, and what a user does in its window, on a display of its own."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from termsel.testing import invoke

fcntl = pytest.importorskip("fcntl")  # QGIS is tested on Linux

PLUGIN = Path(__file__).parents[1]
SYSTEM = "/usr/bin:/bin"
PROGRAMS = [shutil.which("qgis", path=SYSTEM),
            # Debian's qgis_process is a script that is wrong in 3.22.
            shutil.which("qgis_process.bin", path=SYSTEM)
            or shutil.which("qgis_process", path=SYSTEM),
            shutil.which("Xvfb", path=SYSTEM)]
needs_qgis = pytest.mark.skipif(
    None in PROGRAMS and not os.environ.get("TERMSEL_QGIS"),
    reason="QGIS and Xvfb are not installed")
pytestmark = needs_qgis

Place = tuple[Path, dict[str, str]]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory, example_files: Path) -> Place:
    """Files of the example in a folder with a space, and an environment of QGIS without a user."""
    base = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        base = base.parent  # that of all workers
    folder = base / "of qgis" / "a place"
    with once(base / "of qgis files") as first:
        if first:
            write_files(folder, example_files)
    # With another Python first in the path, that of QGIS does not find its own modules.
    environment = {**os.environ, "PATH": SYSTEM, "QGIS_PLUGINPATH": str(PLUGIN),
                   "QGIS_CUSTOM_CONFIG_PATH": str(folder.parent), "TERMSEL_PLACE": str(folder),
                   "TERMSEL_EXECUTABLE": str(Path(sys.executable).with_name("termsel")),
                   "LANG": "C.UTF-8", "OMP_NUM_THREADS": "1"}
    for name in ("VIRTUAL_ENV", "PYTHONHOME", "PYTHONPATH", "QT_QPA_PLATFORM"):
        environment.pop(name, None)
    return folder, environment


def write_files(folder: Path, example_files: Path) -> None:
    """Write the files of the session and the settings of QGIS."""
    folder.parent.mkdir()
    shutil.copytree(example_files, folder)
    if find_spec("termsel_block"):
        assert invoke("block-example", folder / "block", "--images", 2).exit_code == 0
    stand_in(folder)
    settings = folder.parent / "profiles" / "default" / "QGIS" / "QGIS3.ini"
    settings.parent.mkdir(parents=True)
    settings.write_text("[PythonPlugins]\nqgis_termsel=true\nprocessing=true\n"
                        "[qgis]\ncheckVersion=false\n")


@contextmanager
def once(mark: Path) -> Iterator[bool]:
    """Say whether this is the first of all workers that comes here; the others wait for it."""
    with open(mark, "a+") as opened:
        fcntl.flock(opened, fcntl.LOCK_EX)
        yield opened.tell() == 0
        opened.write("done")


@pytest.fixture(scope="module")
def told(place: Place, display: str) -> dict[str, Any]:
    """What a session of a user came to."""
    folder, environment = place
    written = folder / "told.json"
    with once(folder.parent / "session") as first:
        if first:
            done = subprocess.run(
                [str(PROGRAMS[0]), "--nologo", "--noversioncheck", "--profiles-path",
                 str(folder.parent), "--code", str(Path(__file__).with_name("session.py"))],
                env={**environment, "DISPLAY": display}, capture_output=True, text=True,
                timeout=900)
            assert written.exists(), done.stdout + done.stderr
    answer: dict[str, Any] = json.loads(written.read_text())
    assert not answer["faults"], answer["faults"][0]
    return answer


@pytest.fixture(scope="module")
def display() -> Iterator[str]:
    """A display that nobody sees."""
    read, write = os.pipe()
    server = subprocess.Popen(
        [str(PROGRAMS[2]), "-displayfd", str(write), "-screen", "0", "1400x900x24", "-nolisten",
         "tcp"], pass_fds=[write], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    os.close(write)
    with os.fdopen(read) as said:
        number = said.readline().strip()
    yield f":{number}"
    server.terminate()
    server.wait()


def stand_in(folder: Path) -> None:
    """Write a wheel that has a command termsel and needs no package index."""
    about = "termsel-0.0.1.dist-info"
    with zipfile.ZipFile(folder / "termsel-0.0.1-py3-none-any.whl", "w") as packed:
        packed.writestr("standin.py", "def main():\n    print('termsel, stand-in')\n")
        packed.writestr(f"{about}/METADATA", "Metadata-Version: 2.1\nName: termsel\n"
                                             "Version: 0.0.1\n")
        packed.writestr(f"{about}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\n"
                                          "Tag: py3-none-any\n")
        packed.writestr(f"{about}/entry_points.txt",
                        "[console_scripts]\ntermsel = standin:main\n")
        packed.writestr(f"{about}/RECORD", "")


def record_of(folder: str | Path) -> dict[str, Any]:
    record: dict[str, Any] = json.loads((Path(folder) / "result.json").read_text())
    return record


def test_qgis_process_gives_the_result_of_the_command_line(place: Place) -> None:
    folder, environment = place
    files = {"points": folder / "scene.points", "dem": folder / "dem.tif"}
    done = subprocess.run(
        [str(PROGRAMS[1]), "run", "termsel:georeference", "--", f"FILE={files['points']}",
         f"DEM={files['dem']}", "MODEL=affine", f"OUTPUT={folder / 'result'}"],
        env={**environment, "QT_QPA_PLATFORM": "offscreen"}, capture_output=True, text=True,
        timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    same = invoke("run", "--points", files["points"], "--dem", files["dem"], "--problem",
                  "poly-terms", "--solver", "all-terms", "--strategy", "as-asked", "--model",
                  "affine", "--out", folder / "same")
    assert same.exit_code == 0, same.output
    records = [record_of(folder / name) for name in ("result", "same")]
    for record in records:
        for name in ("seconds", "checksums"):  # summary.txt has the time, too
            record.pop(name)
    assert records[0] == records[1]


def test_algorithms_are_there_with_help(told: dict[str, Any]) -> None:
    assert {f"termsel:{name}" for name in (
        "georeference", "selectlines", "rectify", "export", "report", "nextplaces", "match",
        "block", "setup", "sigma")} == set(told["algorithms"])
    assert told["helps"]
    assert told["unloaded"]


def test_an_edited_layer_in_memory_of_another_crs_is_georeferenced(told: dict[str, Any]) -> None:
    layer = told["layer"]
    assert layer["RMSE"] < 1
    assert layer["loaded"] == ["Blunders", "Residual vectors", "Residuals"]
    assert layer["valid"] == [True] * 3
    assert told["shares"]
    assert any("Accuracy" in line for line in told["said"])
    assert layer["OUTPUT"].endswith("of layer żółć 東京")
    record = record_of(layer["OUTPUT"])
    assert record["data"]["counts"]["control"] == 37
    assert record["data"]["crs"] == "EPSG:32639"
    assert "Accuracy" in Path(layer["SUMMARY"]).read_text(encoding="utf-8")


def test_a_model_is_fitted_to_few_points(told: dict[str, Any], place: Place) -> None:
    number, outputs = told["few"]
    assert number < 8
    assert "error" not in outputs
    assert record_of(place[0] / "few")["data"]["counts"]["control"] == number


def test_the_dialog_states_the_unit_of_heights(told: dict[str, Any], place: Place) -> None:
    assert "z may be in US survey feet" in told["unit open"]["error"]
    assert "error" not in told["in feet"]
    assert record_of(place[0] / "feet")["data"]["counts"]["control"] > 3


def test_a_model_takes_selected_features_and_makes_a_map(
        told: dict[str, Any], place: Place) -> None:
    record = record_of(place[0] / "of model")
    chosen, there = told["count"]
    assert 0 < chosen < there
    assert sum(record["data"]["counts"].values()) == chosen
    assert record["model"] == "affine"
    assert (place[0] / "map of model.tif").stat().st_size > 10_000


def test_a_batch_runs_its_rows(told: dict[str, Any], place: Place) -> None:
    records = [record_of(place[0] / name) for name in ("wrong", "quadratic")]
    assert [(record["model"], record["solver"]) for record in records] == [
        ("affine", "all-terms"), ("poly3d", "all-terms")]
    assert records[1]["options"]["model"]["degree"] == 2
    assert [one["id"] for one in records[0]["outliers"]] == ["C40"]
    assert told["looks"] == [
        ["Blunders", "singleSymbol"], ["Residual vectors", "categorizedSymbol"],
        ["Residuals", "categorizedSymbol"]]


@pytest.mark.parametrize(("case", "message"), [
    ("no fields", "no field that is known as line"), ("neither", "Give a layer or a file"),
    ("no number", "Feature 1 of the layer of points has 'twelve' in its field row"),
    ("two points", "has 2 points for one line and sample"), ("taken", "has a result already"),
    ("cancelled", "Cancelled"), ("no points", "dem.tif"),
    ("missing", "there is no command termsel"), ("no environment", "has no command termsel"),
    ("stopped setup", "Cancelled")])
def test_what_is_wrong_is_one_sentence(told: dict[str, Any], case: str, message: str) -> None:
    assert message in told[case]["error"]
    assert "Traceback" not in told[case]["error"]


def test_points_drawn_without_heights_have_none(told: dict[str, Any]) -> None:
    # QGIS stores NaN as their z, which termsel refuses as a height.
    assert told["without heights"][1].endswith(",48.5,34.8,")


def test_cancelling_ends_the_process_and_leaves_nothing(told: dict[str, Any], place: Place) -> None:
    assert told["seconds to cancel"] < 2.5  # starting it included
    assert not (place[0] / "cancelled").exists()
    # A command that is writing, and one that takes no notice of a request to end.
    assert "Cancelled" in told["stopped"]["error"]
    assert told["stubborn"]["seconds"] < 2
    assert told["left in maps"] == told["left"] == []


def test_a_result_becomes_places_a_report_and_an_rpc(told: dict[str, Any], place: Place) -> None:
    assert told["places"]["loaded"] or Path(told["places"]["OUTPUT"]).exists()
    assert "LINE_NUM_COEFF" in (place[0] / "scene_RPC.TXT").read_text()
    assert told["report"]["PAGE"].endswith("p ü.html")
    assert Path(told["report"]["PAGE"]).read_text(encoding="utf-8").startswith("<!DOCTYPE html>")


def test_the_dock_shows_a_result_and_runs_it_again(told: dict[str, Any], place: Place) -> None:
    dock = told["dock"]
    assert dock["rows"] == 97
    assert "independent check points" in dock["accuracy"]
    assert dock["first"] == ["C40", True]  # the blunder, and no check point
    assert {"residuals", "vectors", "blunders"} <= set(dock["layers"])
    assert dock["red"] > 5
    assert len(dock["left out"]) == 2
    again, rows, accuracy = dock["again"]
    assert again == str(place[0] / "again")
    assert rows in (95, 97)
    assert accuracy != dock["accuracy"]
    assert sorted(record_of(again)["data"]["roles"]["off"]) == sorted(dock["left out"])
    assert dock["log"]
    assert dock["export"] == "termsel:export"
    assert "has no result" in dock["none"]


def test_the_dock_has_the_words_of_the_page_and_its_map_tool(told: dict[str, Any]) -> None:
    dock = told["dock"]
    assert dock["heads"] == ["Leave out", "Id", "Role", "Residual, line [px]",
                             "Residual, sample [px]", "Residual [px]"]
    assert "left out as a blunder" in dock["roles"]
    assert dock["check"].startswith("Check these: C40 is off by ")
    assert "The model does without it." in dock["check"]
    assert "interval)" in dock["accuracy"] or "independent" in dock["accuracy"]
    assert dock["tool"]
    assert dock["chosen"] == dock["still chosen"] == "C40"
    assert dock["gone to"] == [True, True]


def test_the_folder_of_a_stranger_is_data_alone(told: dict[str, Any]) -> None:
    dock = told["dock"]
    assert "result.json is a link" in dock["link"]
    assert "result.json is a link, no file" in dock["pipe"]
    assert "has no result" in dock["text"]
    assert dock["crs"] == [True, True, False, False, False, False]
    assert dock["cells"] == "'=cmd(),P1,-1.5,' @x,2.5\n"


def test_the_dock_switches_between_candidates(told: dict[str, Any], place: Place) -> None:
    dock = told["dock"]
    candidates = {text.split(",")[0]: (model, taken) for text, model, taken in dock["candidates"]}
    assert candidates["quadratic"] == ("poly3d 2", True)
    assert candidates["regularised-cubic"] == ("", False)
    name, asked = dock["asked"]
    assert (name, asked["MODEL"]) == ("termsel:georeference", "poly3d 2")
    name, asked = dock["asked of lines"]
    assert (name, asked["LINES"]) == (
        "termsel:selectlines", str(place[0] / "of lines" / "lines.csv"))


def test_setting_up_makes_an_environment_and_shows_the_log(told: dict[str, Any]) -> None:
    assert told["setup"]["VERSION"] == told["stated"]["VERSION"] == "termsel, stand-in"
    assert any("Successfully installed termsel-0.0.1" in line for line in told["setup said"])
    assert not told["environment left"]
    assert "termsel-environment" in told["found"]
    assert told["found without setting"] == told["found"]


def test_lines_are_selected_and_blunders_named(told: dict[str, Any]) -> None:
    record = record_of(told["lines"]["OUTPUT"])
    assert record["problem"] == "owdis-lines"
    assert 0 < record["selection"]["n_features"] < record["data"]["counts"]["lines"]
    assert told["lines"]["RMSE"] < 2
    assert told["lines"]["BLUNDERS"].startswith("L")


def test_the_uncertainty_is_a_raster_in_shades(told: dict[str, Any]) -> None:
    pytest.importorskip("termsel_standards")
    band, largest = told["shades"]
    assert band == 4
    assert 0 < largest < 50


def test_an_image_is_matched_and_a_block_adjusted(told: dict[str, Any]) -> None:
    pytest.importorskip("termsel_match")
    pytest.importorskip("termsel_block")
    found = Path(told["match"]["OUTPUT"]).read_text().splitlines()
    assert sum(not line.startswith("#") for line in found) > 5
    assert (told["match"]["loaded"], told["match"]["valid"]) == (["Matches"], [True])
    assert "control" in Path(told["block"]["PAGE"]).read_text(encoding="utf-8")
