"""The plugin as a file for QGIS and its repository, and what it needs of Qt 6."""

from __future__ import annotations

import ast
import configparser
import json
import os
import subprocess
import sys
import zipfile
from importlib.util import find_spec
from pathlib import Path

import pytest

from termsel.testing import invoke

PLUGIN = Path(__file__).parents[1]
GIVEN = {"email": "someone@example.org", "repository": "https://example.org/termsel",
         "tracker": "https://example.org/termsel/issues", "homepage": "https://example.org"}


def package(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, str(PLUGIN / "package.py"), *map(str, arguments)],
                          capture_output=True, text=True)


@pytest.fixture(scope="module")
def packed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("packed") / "termsel.zip"
    options = [word for name, text in GIVEN.items() for word in (f"--{name}", text)]
    done = package(target, "--for-repository", *options)
    assert done.returncode == 0, done.stderr
    return target


def metadata(file: Path) -> dict[str, str]:
    """Read metadata.txt as the repository of plugins does."""
    parser = configparser.ConfigParser()
    parser.optionxform = str  # type: ignore[assignment]
    with zipfile.ZipFile(file) as opened:
        parser.read_string(opened.read("qgis_termsel/metadata.txt").decode("utf-8"))
    return dict(parser.items("general"))


def test_a_package_for_the_repository_has_what_its_validator_asks_for(packed: Path) -> None:
    stated = metadata(packed)
    assert all(stated[name] for name in (
        "name", "description", "version", "qgisMinimumVersion", "author", "about"))
    assert {name: stated[name] for name in GIVEN} == GIVEN
    assert stated["hasProcessingProvider"] == "yes"
    # QGIS 4 is the one of Qt 6; the field supportsQt6 is warned of as a thing of the past.
    assert stated["qgisMaximumVersion"].startswith("4.")
    assert "supportsQt6" not in stated
    assert "/" not in stated["author"]
    with zipfile.ZipFile(packed) as opened:
        names = opened.namelist()
        modes = [one.external_attr >> 16 for one in opened.infolist()]
    assert {name.split("/")[0] for name in names} == {"qgis_termsel"}
    assert {f"qgis_termsel/{name}" for name in ("__init__.py", "LICENSE", stated["icon"])} \
        <= set(names)
    assert not [name for name in names if ".pyc" in name or "__pycache__" in name
                or Path(name).name.startswith(".") or ".." in name]
    assert not [mode for mode in modes if mode & 0o111]
    assert packed.stat().st_size < 25_000_000


@pytest.mark.parametrize(("left_out", "replaced", "message"), [
    ("email", None, "email is missing"), ("tracker", None, "tracker is missing"),
    ("repository", None, "repository is missing"), ("homepage", None, "homepage is missing"),
    ("email", "nobody", "is no address"), ("tracker", "example.org", "is no address of a page"),
    ("homepage", "https://a b", "is no address of a page")])
def test_a_package_for_the_repository_is_refused_without_them(
        tmp_path: Path, left_out: str, replaced: str | None, message: str) -> None:
    given = {**GIVEN, left_out: replaced}
    target = tmp_path / "termsel.zip"
    done = package(target, "--for-repository", *(
        word for name, text in given.items() if text for word in (f"--{name}", text)))
    assert done.returncode == 2
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert not target.exists()


def test_a_package_for_oneself_needs_none_of_them(tmp_path: Path) -> None:
    done = package(tmp_path / "termsel.zip")
    assert done.returncode == 0, done.stderr
    assert metadata(tmp_path / "termsel.zip")["name"] == "termsel"
    done = package(tmp_path / "no folder" / "termsel.zip")
    assert done.returncode == 2
    assert "cannot be written" in done.stderr


@pytest.mark.parametrize("tool", ["flake8", "bandit", "detect_secrets"])
def test_the_tools_of_the_repository_find_nothing(tool: str, packed: Path, tmp_path: Path) -> None:
    pytest.importorskip(tool)
    with zipfile.ZipFile(packed) as opened:
        opened.extractall(tmp_path)
    words = {"flake8": ["--isolated", "--max-line-length=120"], "bandit": ["-q", "-r"],
             "detect_secrets": ["scan", "--all-files", "--exclude-files", r"metadata\.txt"]}[tool]
    done = subprocess.run([sys.executable, "-m", tool, *words, "qgis_termsel"], cwd=tmp_path,
                          capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    if tool == "detect_secrets":
        assert json.loads(done.stdout)["results"] == {}


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


def test_the_plugin_names_nothing_that_qt_6_has_not() -> None:
    for path in sorted((PLUGIN / "qgis_termsel").rglob("*.py")):
        assert not of_qt_5_alone(path.read_text(encoding="utf-8")), path


def python_with_qt_6() -> str | None:
    """Return a Python that has PyQt6: this one, or that of the system."""
    if find_spec("PyQt6"):
        return sys.executable
    system = "/usr/bin/python3"
    if Path(system).exists() and subprocess.run(
            [system, "-c", "import PyQt6.QtWidgets"], capture_output=True).returncode == 0:
        return system
    return None


def test_the_dock_works_in_qt_6(tmp_path: Path, example_files: Path) -> None:
    python = python_with_qt_6()
    if python is None:
        pytest.skip("PyQt6 is not installed")
    done = invoke("run", "--points", example_files / "gcps.csv", "--out", tmp_path / "result")
    assert done.exit_code == 0, done.output
    environment = {**os.environ, "PYTHONPATH": str(PLUGIN), "QT_QPA_PLATFORM": "offscreen"}
    ran = subprocess.run(
        [python, str(Path(__file__).with_name("qt6.py")), str(tmp_path / "result"),
         str(tmp_path / "dock.png")], env=environment, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    told = json.loads(ran.stdout)
    assert told["qt"].startswith("6.")
    assert told["rows"] == 97
    assert "independent check points" in told["accuracy"]
    assert told["candidates"] > 5
    assert (told["before"], told["left out"]) == ([], [told["first"]])
    name, asked = told["asked"]
    assert (name, asked["OFF"], asked["MODEL"]) == (
        "termsel:georeference", told["first"], "affine")
    assert told["picture"]
    assert (tmp_path / "dock.png").stat().st_size > 5000
