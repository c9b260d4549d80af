"""What strangers rely on: one version everywhere, and the same checks wherever they run."""

from __future__ import annotations

import importlib
import json
import os
import pkgutil
import re
import subprocess
import sys
import tomllib
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

import pytest
import yaml

import termsel
from termsel import toolkit
from termsel.cli.new_plugin import package_files
from termsel.core import version
from termsel.plugins import registry as manager
from termsel.plugins.registry import Registry
from termsel.rooms import ROOMS
from tests.lint.public import users_of_toolkit

ROOT = Path(__file__).parents[2]
PACKAGES = sorted(ROOT.glob("plugins/*/pyproject.toml"))
RELEASED = re.compile(r"^## \[(\d+\.\d+\.\d+)\] - (\d{4}-\d\d-\d\d)$", re.MULTILINE)


def _text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def _project(path: Path) -> dict[str, Any]:
    return tomllib.loads(path.read_text(encoding="utf-8"))["project"]


def _workflow() -> dict[str, Any]:
    return yaml.safe_load(_text(".github/workflows/ci.yml"))


@pytest.mark.parametrize("path", PACKAGES, ids=lambda path: path.parent.name)
def test_packages_of_the_repository_have_one_version_and_its_bounds(path: Path) -> None:
    project = _project(path)
    assert project["version"] == version.__version__
    own = [need for need in project.get("dependencies", ()) if need.startswith("termsel")]
    # Nothing else of this repository: each package installs alone from a clone with termsel. The
    # plugin of QGIS runs termsel as a process of its own.
    bound = [] if path.parent.name == "qgis-termsel" else [f"termsel{version.plugin_bound()}"]
    assert [re.sub(r"\[.*\]", "", need) for need in own] == bound
    assert all(need.endswith(version.plugin_bound())
               for needs in project.get("optional-dependencies", {}).values() for need in needs
               if need.startswith("termsel"))


@pytest.mark.parametrize(("named", "api", "bound"), [
    ("0.3.0.dev0", "0.3", ">=0.3.0.dev0,<0.4"), ("0.3.0", "0.3", ">=0.3,<0.4"),
    ("0.3.7", "0.3", ">=0.3,<0.4"), ("0.9.1", "0.9", ">=0.9,<0.10"),
    ("0.10.0.dev0", "0.10", ">=0.10.0.dev0,<0.11")])
def test_bound_of_a_plugin_follows_from_the_version(named: str, api: str, bound: str) -> None:
    scope: dict[str, Any] = {}
    source = Path(version.__file__).read_text(encoding="utf-8")
    exec(source.replace(f'"{version.__version__}"', f'"{named}"'), scope)
    assert scope["PLUGIN_API"] == api
    assert scope["plugin_bound"]() == bound


def test_new_packages_and_that_of_the_readme_state_the_bound() -> None:
    needed = f'dependencies = ["termsel{version.plugin_bound()}"]'
    assert needed in package_files("termsel-demo", "model")["pyproject.toml"].splitlines()
    assert needed in _text("README.md").splitlines()


def test_citation_names_the_last_release_or_the_next() -> None:
    releases = RELEASED.findall(_text("CHANGELOG.md"))
    citation = yaml.safe_load(_text("CITATION.cff"))
    stated = citation["version"], str(citation.get("date-released", ""))
    assert stated == (releases[0] if releases else (version.__version__, ""))
    # Between releases main is called after the next one.
    if not releases or releases[0][0] != version.__version__:
        assert "## [Unreleased]" in _text("CHANGELOG.md")
        assert ".dev" in version.__version__


def test_hosted_tests_run_every_python_that_the_package_names() -> None:
    classifiers = "\n".join(_project(ROOT / "pyproject.toml")["classifiers"])
    stated = set(re.findall(r":: (3\.\d+)$", classifiers, re.MULTILINE))
    matrix = _workflow()["jobs"]["tests"]["strategy"]["matrix"]
    assert set(matrix["python"]) == stated
    assert {system.partition("-")[0] for system in matrix["system"]} == {
        "ubuntu", "macos", "windows"}


def test_hosted_checks_run_what_the_script_runs() -> None:
    script = re.sub(r"\\\n\s*", "", _text(".ci/run"))
    tools = r"ruff|mypy|check-jsonschema|sphinx-build|twine|python (?:-m tests|\.ci/)"
    commands = set(re.findall(rf"^\s*((?:{tools}).*)", script, re.MULTILINE))
    assert len(commands) >= 7
    steps = [step["run"] for job in _workflow()["jobs"].values() for step in job["steps"]
             if "run" in step]
    hooks = yaml.safe_load(_text(".pre-commit-config.yaml"))["repos"][0]["hooks"]
    assert any("pre-commit run --all-files" in step for step in steps)
    run = "\n".join([*steps, *(hook["entry"] for hook in hooks)]).replace(" --quiet", "")
    for command in commands:  # up to the files, which differ
        assert re.split(r' (?:"\$|\.)', command.replace(" --quiet", ""))[0] in run
    tests = re.search(r"^\$ (.+)$", _text("README.md")[_text("README.md").index("<!-- tests -->"):],
                      re.MULTILINE)
    assert tests is not None
    assert all(part in run for part in tests[1].split(" && "))


@pytest.mark.skipif(sys.platform == "win32", reason="the script is for bash")
@pytest.mark.parametrize(("tests", "beside", "status"), [
    ("exit 0", "exit 0", 0), ("exit 1", "exit 0", 1), ("exit 0", "exit 3", 3),
    ("exit 2", "(sleep 30; echo lived >&$held) & wait", 2)])
def test_what_runs_beside_the_tests_is_shown_and_ends(tests: str, beside: str, status: int,
                                                      tmp_path: Path) -> None:
    """The end of the script, with other tests and other work beside them."""
    end = _text(".ci/run").partition("\nbeside() {")[2].partition("\n}\n")[2]
    assert end
    ends, held = os.pipe()
    log = tmp_path / "made" / "beside.log"
    script = (f"set -euo pipefail; folder={log.parent}; mkdir $folder; held={held}\n"
              "step() { echo \"== $1\"; }; browser() { false; }; qgis() { false; }\n"
              "installing=; install='x && [ ! -e $folder/installed ]'; export folder\n"
              f"tests='x && echo 3 passed; until [ -s {log} ]; do sleep 0.1; done; {tests}'\n"
              f"beside() {{ echo linted; {beside}; }}\n{end}")
    done = subprocess.run(["bash", "-c", script], pass_fds=[held], capture_output=True, text=True,
                          check=False)
    os.close(held)
    with os.fdopen(ends) as pipe:
        assert pipe.read() == ""  # as soon as none is left that could write
    assert done.returncode == status
    assert done.stdout.count("linted") == 1, done.stderr
    assert not log.parent.exists()


def test_commit_checks_download_nothing() -> None:
    repos = yaml.safe_load(_text(".pre-commit-config.yaml"))["repos"]
    assert [repo["repo"] for repo in repos] == ["local"]
    assert {hook["language"] for hook in repos[0]["hooks"]} == {"system"}
    extra = " ".join(_project(ROOT / "pyproject.toml")["optional-dependencies"]["dev"])
    programs = {hook["entry"].split()[0] for hook in repos[0]["hooks"]} - {"python"}
    assert programs == {program for program in programs if program in extra}


@pytest.mark.parametrize(("metadata", "shown"), [
    ("Requires-Dist: numpy>=2\nRequires-Dist: termsel<0.4,>=0.3\n", "<0.4,>=0.3"),
    ("Requires-Dist: termsel[gis] (>=0.3, <0.4) ; python_version > '3'\n", ">=0.3,<0.4"),
    ("Requires-Dist: termsel\n", ""), ("Requires-Dist: termsel-rpc>=0.3\n", ""), ("", "")])
def test_plugins_are_listed_with_the_termsel_that_they_state(
        metadata: str, shown: str, tmp_path: Path, call: Any,
        monkeypatch: pytest.MonkeyPatch) -> None:
    info = tmp_path / "polite-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: polite\nVersion: 1.0\n{metadata}")
    (info / "entry_points.txt").write_text("[termsel]\npolite = json\n")
    monkeypatch.syspath_prepend(tmp_path)
    names = Registry([point for found in distributions(path=[str(tmp_path)])
                      for point in found.entry_points])
    monkeypatch.setattr(manager, "registry", lambda: names)
    ours, polite = json.loads(call("plugins", "--json").stdout)
    assert ours["api"] == polite["api"] == version.PLUGIN_API
    assert (ours["requires"], polite["requires"]) == ("", shown)
    text = call("plugins").stdout
    assert text.startswith(f"Plugin API {version.PLUGIN_API}: ")
    assert f"termsel{version.plugin_bound()}\n" in text
    assert re.search(rf"^polite +polite +1\.0 +{re.escape(shown)} *broken", text, re.MULTILINE)


TOOLKIT = ["termsel.toolkit", *(f"termsel.toolkit.{module.name}" for module in pkgutil.iter_modules(
    toolkit.__path__))]


@pytest.mark.parametrize("module", TOOLKIT)
def test_every_name_of_the_toolkit_is_there(module: str) -> None:
    names = importlib.import_module(module)
    assert names.__all__
    for name in names.__all__:
        assert getattr(names, name) is not None, name


def test_the_toolkit_holds_what_several_packages_need_and_its_modules_what_one_does() -> None:
    users = users_of_toolkit(ROOT)
    assert not [name for name, packages in users.items() if not packages]
    by_topic = {"termsel.toolkit.coordinates", "termsel.toolkit.charts"}
    shared = {name for (module, name), packages in users.items()
              if len(packages) > 1 and module not in by_topic}
    assert shared == set(toolkit.__all__)
    assert len(shared) <= 55


def test_at_most_fifteen_rooms_stand_on_the_road() -> None:
    package = ROOT / "src/termsel"
    rooms = [name for name in ROOMS if (package / name).is_dir()]
    assert rooms[:2] == ["toolkit", "testing"]
    assert len(rooms[2:]) <= 15


def test_no_public_name_is_a_room() -> None:
    # `termsel.data` would be the function or the room, by what was imported first.
    names = {*termsel.__all__, *toolkit.__all__}
    rooms = set(ROOMS) - {"toolkit"}
    assert not names & rooms


def test_each_claim_names_a_test_that_there_is() -> None:
    named = re.findall(r"`((?:tests|plugins)/[^`]+\.py)::(\w+)`", _text("docs/reference/claims.md"))
    assert len(named) >= 8
    for file, function in named:
        assert f"def {function}(" in _text(file), f"{file}::{function}"


def test_the_recipe_of_conda_forge_has_the_requirements_of_the_package() -> None:
    text = _text(".ci/conda-forge/recipe.yaml")
    recipe = yaml.safe_load(text)
    listed = {need.replace(" ", "") for need in recipe["requirements"]["run"]}
    needed = set(_project(ROOT / "pyproject.toml")["dependencies"])
    assert listed - {"python>=${{python_min}}"} == needed
    assert recipe["context"]["version"] == version.__version__.partition(".dev")[0]


def test_the_file_of_the_archive_says_what_the_citation_says() -> None:
    archived = json.loads(_text(".zenodo.json"))
    cited = yaml.safe_load(_text("CITATION.cff"))
    assert (archived["title"], archived["license"]) == (cited["title"], cited["license"])
    assert archived["keywords"] == cited["keywords"]
    assert cited["abstract"] in re.sub("<[^>]+>", "", archived["description"])


def test_a_release_is_published_without_a_token_and_only_where_it_is_switched_on() -> None:
    publish = yaml.safe_load(_text(".github/workflows/release.yml"))["jobs"]["publish"]
    assert publish["if"] == "vars.PUBLISH == 'true'"
    assert publish["permissions"] == {"id-token": "write"}
    assert "secrets." not in _text(".github/workflows/release.yml")
