"""The plugin in QGIS without a window: qgis_process, layers, cancelling, and the dock."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from termsel.cli.main import cli

PLUGIN = Path(__file__).parents[1]
PROCESS = shutil.which("qgis_process.bin") or shutil.which("qgis_process")
PYTHON = "/usr/bin/python3"
needs_qgis = pytest.mark.skipif(
    PROCESS is None or not Path(PYTHON).exists(), reason="QGIS is not installed")

Place = tuple[Path, dict[str, str]]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Place:
    """Files of the example in a folder with a space, and an environment of QGIS without a user."""
    folder = tmp_path_factory.mktemp("qgis") / "a place"
    done = CliRunner().invoke(cli, ["example", str(folder)])
    assert done.exit_code == 0, done.output
    # With another Python first in the path, that of QGIS does not find its own modules.
    environment = {**os.environ, "PATH": "/usr/bin:/bin", "QT_QPA_PLATFORM": "offscreen",
                   "QGIS_PLUGINPATH": str(PLUGIN),
                   "QGIS_CUSTOM_CONFIG_PATH": str(folder.parent / "profile"),
                   "TERMSEL_EXECUTABLE": str(Path(sys.executable).with_name("termsel"))}
    for name in ("VIRTUAL_ENV", "PYTHONHOME", "PYTHONPATH"):
        environment.pop(name, None)
    return folder, environment


def qgis(place: Place, *arguments: str) -> str:
    """Return what qgis_process prints."""
    done = subprocess.run([str(PROCESS), *arguments], env=place[1], capture_output=True, text=True,
                          timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@needs_qgis
def test_qgis_process_gives_the_result_of_the_command_line(place: Place) -> None:
    folder = place[0]
    qgis(place, "plugins", "enable", "qgis_termsel")
    qgis(place, "run", "termsel:georeference", "--", f"FILE={folder / 'scene.points'}",
         f"DEM={folder / 'dem.tif'}", f"OUTPUT={folder / 'result'}")
    done = CliRunner().invoke(cli, [
        "run", "--points", str(folder / "scene.points"), "--dem", str(folder / "dem.tif"),
        "--out", str(folder / "same")])
    assert done.exit_code == 0, done.output
    ours, same = (json.loads((folder / name / "result.json").read_text())
                  for name in ("result", "same"))
    for record in (ours, same):
        for name in ("seconds", "checksums"):  # summary.txt has the time, too
            record.pop(name)
    assert ours == same
    qgis(place, "run", "termsel:rectify", "--", f"RESULT={folder / 'result'}",
         f"IMAGE={folder / 'scene.tif'}", f"DEM={folder / 'dem.tif'}",
         f"OUTPUT={folder / 'map.tif'}")
    assert (folder / "map.tif").stat().st_size > 10_000


@pytest.fixture(scope="module")
def told(place: Place) -> dict[str, Any]:
    """What a session of a user came to."""
    environment = {**place[1], "PYTHONPATH": str(PLUGIN)}
    done = subprocess.run([PYTHON, str(Path(__file__).with_name("session.py")), str(place[0])],
                          env=environment, capture_output=True, text=True, timeout=400)
    line = next((line for line in done.stdout.splitlines() if line.startswith("TOLD")), None)
    assert line, done.stdout + done.stderr
    answer: dict[str, Any] = json.loads(line.removeprefix("TOLD"))
    return answer


@needs_qgis
def test_algorithms_are_there_with_help(told: dict[str, Any]) -> None:
    assert {"termsel:georeference", "termsel:selectlines", "termsel:rectify", "termsel:export",
            "termsel:report", "termsel:nextplaces", "termsel:match", "termsel:block",
            "termsel:setup"} <= set(told["algorithms"])
    assert told["helps"]


@needs_qgis
def test_an_edited_layer_in_memory_is_georeferenced(told: dict[str, Any], place: Place) -> None:
    assert told["layer"]["RMSE"] < 1
    assert told["layer"]["loaded"] == ["Blunders", "Residual vectors", "Residuals"]
    assert told["shares"]
    assert any("Accuracy" in line for line in told["said"])
    record = json.loads((Path(told["layer"]["OUTPUT"]) / "result.json").read_text())
    assert record["data"]["counts"]["control"] == 33
    assert not list(place[0].glob("**/points.csv.tmp"))


@needs_qgis
def test_selected_features_only(told: dict[str, Any]) -> None:
    record = json.loads((Path(told["selected"]["OUTPUT"]) / "result.json").read_text())
    chosen, there = told["count"]
    assert 0 < chosen < there
    assert sum(record["data"]["counts"].values()) == chosen


@needs_qgis
@pytest.mark.parametrize(("case", "message"), [
    ("no fields", "no field that is known as line"), ("neither", "Give a layer or a file"),
    ("taken", "has a result already"), ("cancelled", "Cancelled"),
    ("missing", "cannot be run")])
def test_what_is_wrong_is_one_sentence(told: dict[str, Any], case: str, message: str) -> None:
    assert message in told[case]["error"]
    assert "Traceback" not in told[case]["error"]


@needs_qgis
def test_cancelling_ends_the_process_and_leaves_nothing(told: dict[str, Any], place: Place) -> None:
    assert told["seconds to cancel"] < 2.5  # starting it included
    assert not (place[0] / "cancelled").exists()


@needs_qgis
def test_a_result_becomes_places_and_an_rpc(told: dict[str, Any], place: Place) -> None:
    assert Path(told["places"]["OUTPUT"]).exists()
    assert "LINE_NUM_COEFF" in (place[0] / "scene_RPC.TXT").read_text()


@needs_qgis
def test_the_dock_shows_points_and_leaves_them_out(told: dict[str, Any]) -> None:
    dock = told["dock"]
    assert dock["rows"] == 97
    assert "independent points" in dock["accuracy"]
    assert dock["left out"] == [dock["first"]]
    assert "has no result" in dock["none"]


@needs_qgis
def test_blunders_are_red_on_the_map(told: dict[str, Any]) -> None:
    assert told["red"] > 5


def test_the_plugin_is_packed_by_one_command(tmp_path: Path) -> None:
    target = tmp_path / "termsel.zip"
    subprocess.run([sys.executable, str(PLUGIN / "package.py"), str(target)], check=True)
    with zipfile.ZipFile(target) as packed:
        names = packed.namelist()
    assert "qgis_termsel/metadata.txt" in names
    assert "qgis_termsel/LICENSE" in names
    assert not [name for name in names if "__pycache__" in name]


def test_metadata_has_what_qgis_reads() -> None:
    lines = (PLUGIN / "qgis_termsel" / "metadata.txt").read_text(encoding="utf-8").splitlines()
    stated = dict(line.split("=", 1) for line in lines if "=" in line)
    assert {"name", "qgisMinimumVersion", "description", "about", "version", "author",
            "hasProcessingProvider", "icon", "license"} <= {
                name for name, value in stated.items() if value}
    assert (PLUGIN / "qgis_termsel" / stated["icon"]).exists()
