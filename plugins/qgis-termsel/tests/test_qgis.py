"""The plugin in QGIS without a window: qgis_process, layers, cancelling, and the dock."""

from __future__ import annotations

import ast
import json
import os
import shutil
import subprocess
import sys
import zipfile
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from termsel.cli.main import cli

PLUGIN = Path(__file__).parents[1]
PROCESS = shutil.which("qgis_process.bin") or shutil.which("qgis_process")
PYTHON = "/usr/bin/python3"
needs_qgis = pytest.mark.skipif(
    (PROCESS is None or not Path(PYTHON).exists()) and not os.environ.get("TERMSEL_QGIS"),
    reason="QGIS is not installed")

Place = tuple[Path, dict[str, str]]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Place:
    """Files of the example in a folder with a space, and an environment of QGIS without a user."""
    folder = tmp_path_factory.mktemp("qgis") / "a place"
    done = CliRunner().invoke(cli, ["example", str(folder)])
    assert done.exit_code == 0, done.output
    if find_spec("termsel_block"):
        done = CliRunner().invoke(cli, ["block-example", str(folder / "block")])
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
            "termsel:setup", "termsel:sigma"} <= set(told["algorithms"])
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
    # A command that is writing, and one that takes no notice of a request to end.
    assert "Cancelled" in told["stopped"]["error"]
    assert told["stubborn"]["seconds"] < 2
    assert told["left in maps"] == told["left"] == []


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


    candidates = {text.split(",")[0]: (model, taken) for text, model, taken in dock["candidates"]}
    assert candidates["quadratic"] == ("poly3d 2", True)
    assert candidates["shrunken-cubic"] == ("", False)
    (name, asked), = dock["asked"]
    assert (name, asked["MODEL"], asked["OFF"]) == (
        "termsel:georeference", "poly3d 2", dock["first"])


@needs_qgis
def test_a_model_is_taken_instead_of_the_choice(told: dict[str, Any]) -> None:
    record = json.loads((Path(told["model"]["OUTPUT"]) / "result.json").read_text())
    assert (record["model"], record["solver"]) == ("poly3d", "all-terms")
    assert record["options"]["model"]["degree"] == 2


@needs_qgis
def test_the_report_is_a_page(told: dict[str, Any]) -> None:
    assert told["report"]["PAGE"].endswith("p ü.html")
    assert Path(told["report"]["PAGE"]).read_text(encoding="utf-8").startswith("<!DOCTYPE html>")


@needs_qgis
def test_lines_are_selected_and_blunders_named(told: dict[str, Any]) -> None:
    record = json.loads((Path(told["lines"]["OUTPUT"]) / "result.json").read_text())
    assert record["problem"] == "owdis-lines"
    assert 0 < record["selection"]["n_features"] < record["data"]["counts"]["lines"]
    assert told["lines"]["RMSE"] < 2
    assert told["lines"]["BLUNDERS"].startswith("L")


@needs_qgis
def test_the_uncertainty_is_a_raster_in_shades(told: dict[str, Any]) -> None:
    pytest.importorskip("termsel_standards")
    band, largest = told["shades"]
    assert band == 4
    assert 0 < largest < 50


@needs_qgis
def test_an_image_is_matched_and_a_block_adjusted(told: dict[str, Any]) -> None:
    pytest.importorskip("termsel_match")
    pytest.importorskip("termsel_block")
    found = Path(told["match"]["OUTPUT"]).read_text().splitlines()
    assert sum(not line.startswith("#") for line in found) > 5
    page = Path(told["block"]["PAGE"]).read_text(encoding="utf-8")
    assert "control" in page


@needs_qgis
def test_blunders_are_red_on_the_map(told: dict[str, Any]) -> None:
    assert told["red"] > 5


def sources() -> list[Path]:
    return sorted((PLUGIN / "qgis_termsel").rglob("*.py"))


def of_qt_5_alone(source: str) -> list[str]:
    """Return what Qt 6 has not: its bindings by name, and members of enumerations without them."""
    found, tree = [], ast.parse(source)
    allowed = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
    allowed |= {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else \
                [one.name for one in node.names]
            found += [name for name in names if name.startswith(("PyQt", "PySide", "sip"))]
        # Qt.Checked, QgsProcessing.TypeFile; not Qt.CheckState.Checked, QgsProject.instance().
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) \
                and node.value.id[:2] in ("Qt", "Qg", "QV") and node.attr[0].isupper() \
                and id(node) not in allowed:
            found.append(f"{node.value.id}.{node.attr}")
        if isinstance(node, ast.Attribute) and node.attr == "exec_":
            found.append("exec_")
    return found


@pytest.mark.parametrize(("source", "found"), [
    ("from PyQt5.QtCore import Qt", ["PyQt5.QtCore"]), ("x = Qt.Checked", ["Qt.Checked"]),
    ("x = Qt.CheckState.Checked", []), ("QgsVectorFileWriter.SaveVectorOptions()", []),
    ("f(QgsProcessing.TypeFile)", ["QgsProcessing.TypeFile"]), ("d.exec_()", ["exec_"])])
def test_the_check_for_qt_6_finds_what_it_is_for(source: str, found: list[str]) -> None:
    assert of_qt_5_alone(source) == found


@pytest.mark.parametrize("path", sources(), ids=lambda path: path.name)
def test_the_plugin_is_ready_for_qt_6(path: Path) -> None:
    assert not of_qt_5_alone(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("tool", ["flake8", "bandit", "detect_secrets"])
def test_the_tools_of_the_plugin_repository_find_nothing(tool: str) -> None:
    pytest.importorskip(tool)
    words = {"flake8": ["--max-line-length=100"], "bandit": ["-q", "-ll", "-r"],
             "detect_secrets": ["scan", "--all-files"]}[tool]
    done = subprocess.run([sys.executable, "-m", tool, *words, "qgis_termsel"], cwd=PLUGIN,
                          capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    if tool == "detect_secrets":
        assert json.loads(done.stdout)["results"] == {}


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
