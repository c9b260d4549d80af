"""`termsel new-plugin`: what it writes installs offline, passes its tests and shows up."""

from __future__ import annotations

import importlib.metadata
import json
import os
import re
import subprocess
import sys
import sysconfig
import venv
import zipfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from termsel.cli.new_plugin import NEW_KINDS, package_files
from termsel.plugins.registry import Registry

LISTED = {"model": "models", "solver": "solvers", "problem": "problems", "criterion": "criteria",
          "objective": "objectives", "method": "methods", "dataset": "datasets",
          "split": "splits", "section": "sections", "measure": "measures",
          "reader": "readers", "writer": "writers"}


def environment(folder: Path) -> Path:
    """Make an environment that has termsel and what it needs, and return its interpreter."""
    builder = venv.EnvBuilder(with_pip=False, symlinks=os.name != "nt")
    builder.create(folder)
    at = {"base": str(folder), "platbase": str(folder)}
    packages = Path(sysconfig.get_path("purelib", "venv", at))
    # termsel may be installed by a .pth file, which only addsitedir reads from another folder.
    (packages / "termsel.pth").write_text("".join(
        f"import site; site.addsitedir({path!r})\n" for path in sys.path
        if path.endswith("site-packages")))
    return Path(builder.ensure_directories(folder).env_exe)


def _python(folder: Path, *words: object, by: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([by, *map(str, words)], cwd=folder, text=True, capture_output=True,
                          check=False, env={**os.environ, "PIP_NO_INDEX": "1",
                                            "PIP_DISABLE_PIP_VERSION_CHECK": "1"})


@pytest.mark.slow
@pytest.mark.parametrize("kind", NEW_KINDS)
def test_a_new_package_installs_passes_its_tests_and_shows_up(
        kind: str, tmp_path: Path, call: Callable[..., SimpleNamespace]) -> None:
    name, python = f"termsel-my-{kind}", environment(tmp_path / "env")
    done = call("new-plugin", name, "--kind", kind, "--into", tmp_path)
    assert done.exit_code == 0
    folder = tmp_path / name
    done = _python(tmp_path, "-m", "pip", "--python", python, "install", "--no-build-isolation",
                   folder, by=Path(sys.executable))
    assert done.returncode == 0, done.stderr
    assert list((tmp_path / "env").rglob(f"termsel_my_{kind}.py"))
    command = "python -m unittest discover tests "
    assert command in (folder / "README.md").read_text()
    tests = _python(folder, *command.split()[1:], "-v", by=python)
    assert tests.returncode == 0, tests.stderr
    assert "Ran 2 tests" in tests.stderr
    if kind == "command":
        shown = _python(tmp_path, "-m", "termsel", f"my-{kind}", "--help", by=python)
        assert "Print the RMSE of a result" in shown.stdout
        return
    shown = _python(tmp_path, "-m", "termsel", "list", LISTED[kind], "--json", by=python)
    (found,) = [one for one in json.loads(shown.stdout) if one["provided_by"] == name]
    assert found["name"] == f"my-{kind}"


@pytest.mark.parametrize("kind", NEW_KINDS)
def test_all_marks_are_filled_in(kind: str) -> None:
    files = package_files("Termsel.Demo_x", kind)
    assert sorted(Path(file).name for file in files) == [
        "README.md", "build_wheel.py", "pyproject.toml", "termsel_demo_x.py",
        "test_termsel_demo_x.py"]
    for file, text in files.items():
        assert "@DIST" not in text
        assert "@NAME" not in text
        if file.endswith(".py"):
            compile(text, file, "exec")
            assert max(map(len, text.splitlines())) <= 100


@pytest.mark.parametrize(("name", "kind", "said"), [
    ("rfm", "model", "termsel has a model 'rfm' itself"),
    ("termsel-ga", "solver", "termsel has a solver 'ga' itself"),
    ("run", "command", "termsel has a command 'run' itself"),
    ("termsel-ikonos-hamedan", "dataset", "termsel has a data set 'ikonos-hamedan' itself"),
    ("numpy", "model", "Python already has a module 'numpy'"),
    ("json", "model", "Python already has a module 'json'"),
    ("two words", "model", "'two words' cannot be the name of a package.* such as two-words"),
    ("../up", "model", "cannot be the name of a package.* such as up"),
    ("-x", "model", "there is no option -x"),
    ("class", "model", "'class' cannot be the name of a package.* such as termsel-demo"),
    ("termsel", "model", "the name of termsel itself"),
    ("1st", "reader", "cannot be the name of a package")])
def test_names_that_cannot_be_are_refused(
        name: str, kind: str, said: str, tmp_path: Path, call: Callable[..., SimpleNamespace],
        ) -> None:
    done = call("new-plugin", name, "--kind", kind, "--into", tmp_path)
    assert done.exit_code == 2
    assert re.search(said, done.stderr)
    assert not list(tmp_path.iterdir())


def test_nothing_is_replaced(tmp_path: Path, call: Callable[..., SimpleNamespace]) -> None:
    assert call("new-plugin", "mine", "--kind", "model", "--into", tmp_path).exit_code == 0
    done = call("new-plugin", "mine", "--kind", "solver", "--into", tmp_path)
    assert done.exit_code == 2
    assert "this folder exists, and nothing in it is replaced" in done.stderr
    done = call("new-plugin", "mine", "--kind", "model", "--into", tmp_path / "no")
    assert done.exit_code == 2
    assert "this folder does not exist" in done.stderr


def test_a_package_of_several_kinds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                    call: Callable[..., SimpleNamespace]) -> None:
    done = call("new-plugin", "termsel-two", "--kind", "solver, criterion", "--into", tmp_path)
    assert done.exit_code == 0, done.stderr
    folder = tmp_path / "termsel-two"
    assert sorted(file.name for file in folder.rglob("*.py")) == [
        "build_wheel.py", "termsel_two_criterion.py", "termsel_two_solver.py",
        "test_termsel_two_criterion.py", "test_termsel_two_solver.py"]
    monkeypatch.syspath_prepend(folder)
    build: Any = importlib.import_module("build_wheel")
    with zipfile.ZipFile(tmp_path / build.build_wheel(tmp_path)) as wheel:
        wheel.extractall(tmp_path / "site")
    monkeypatch.delitem(sys.modules, "build_wheel")
    monkeypatch.syspath_prepend(tmp_path / "site")
    names = Registry([point for point in importlib.metadata.entry_points(group="termsel")
                      if point.dist.name == "termsel-two"])
    assert "two-solver" in names.names("solvers")
    assert "two-criterion" in names.names("criteria")
    assert names.failures() == []


@pytest.mark.parametrize(("kinds", "said"), [
    ("solver,solver", "names a kind twice"), ("solver,modle", "unknown kind of plugin 'modle'"),
    ("", "leaves a kind blank"), ("solver,", "leaves a kind blank")])
def test_kinds_that_there_are_not_are_refused(kinds: str, said: str, tmp_path: Path,
                                              call: Callable[..., SimpleNamespace]) -> None:
    done = call("new-plugin", "termsel-two", "--kind", kinds, "--into", tmp_path)
    assert done.exit_code == 2
    assert said in done.stderr
    assert not list(tmp_path.iterdir())
