"""No file runs code: names of modules in files, and modules of the current folder."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

import termsel
from termsel.cli.main import cli
from termsel.core.isolation.helper import Helper, modules_here, safe_path
from termsel.core.options import Option, options_of_file

STUDY = """\
problems = [{{name = "poly-terms", degree = 2}}]
solvers = [{solver}]
budget = {{evaluations = 20}}
{more}
"""

SHADOWING = ("json", "pickle", "multiprocessing", "logging", "hashlib", "numba", "lazy_loader",
             "msgspec", "yaml", "sitecustomize")
"""Modules that termsel, its workers or libraries import, by a stranger's files of these names."""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder whose modules leave a mark when they run; the current one."""
    for name in (*SHADOWING, "mine"):
        (tmp_path / f"{name}.py").write_text(
            f"open({str(tmp_path / 'ran')!r}, 'w').close()\ndef f(*a, **k): raise SystemExit\n")
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    assert not (tmp_path / "ran").exists(), "code of a stranger ran"


def _refused(*arguments: str) -> str:
    done = CliRunner().invoke(cli, list(arguments))
    assert done.exit_code == 2, done.output
    return done.output


@pytest.mark.parametrize("more", [
    "", '[options]\nalgorithm = "mine:f"', '[options]\n"solver.algorithm" = "mine:f"'])
@pytest.mark.parametrize("run", [["--dry-run"], ["--out", "out"]])
def test_a_study_names_no_code(folder: Path, more: str, run: list[str]) -> None:
    pytest.importorskip("termsel_optimisers")
    solver = '"deap"' if more else '{name = "deap", algorithm = "mine:f"}'
    (folder / "study.toml").write_text(STUDY.format(solver=solver, more=more))
    text = _refused("compare", "study.toml", *run)
    assert "study.toml, line" in text
    assert "a file may not set the option 'algorithm'" in text
    assert not (folder / "out").exists()


def test_a_study_chooses_among_known_algorithms(folder: Path) -> None:
    pytest.importorskip("termsel_optimisers")
    solver = '{name = "deap", algorithm = "eaMuPlusLambda", population = 10}'
    (folder / "study.toml").write_text(STUDY.format(solver=solver, more=""))
    assert len(termsel.compare("study.toml").rows) == 1


def test_results_of_the_benchmark_name_no_code(folder: Path) -> None:
    pytest.importorskip("termsel_bench")
    from termsel_bench.scenes.catalogue import frozen_checksums

    (folder / "results").mkdir()
    for method in ({"kind": "package", "name": "mine:f", "options": {}},
                   {"kind": "solver", "name": "deap", "options": {"algorithm": "mine:f"}},
                   {"kind": "solver", "name": "deap", "options": {"solver.algorithm": "mine:f"}}):
        (folder / "results" / "x.json").write_text(json.dumps({
            "schema": "termsel-bench-1", "method": {**method, "problem": ""},
            "sets": {"frame-1": {"sha256": frozen_checksums()["frame-1.csv"], "rmse": 1.0}}}))
        text = _refused("bench", "--check", "results")
        assert "names code" in text or "may not set the option 'algorithm'" in text


def test_an_option_says_what_files_may_set() -> None:
    free = Option("a", 1, "Any.", int)
    none = Option("b", "x", "None.", from_files=False)
    some = Option("c", "x", "Some.", from_files=("x", "y"))
    with options_of_file("study.toml"):
        assert free.parse(2) == 2
        assert none.parse("x") == "x"  # its default
        assert some.parse("y") == "y"
        for option in (none, some):
            with pytest.raises(termsel.TermselError, match="may not set") as caught:
                option.parse("mine:f")
            assert caught.value.file is not None
    assert none.parse("mine:f") == some.parse("mine:f") == "mine:f"
    with options_of_file(None):  # typed, or given in Python
        assert none.parse("mine:f") == "mine:f"


def test_describe_says_what_files_may_not_set() -> None:
    pytest.importorskip("termsel_optimisers")
    text = CliRunner().invoke(cli, ["describe", "deap"]).output
    assert "from files only eaSimple" in text


def test_no_option_names_an_output() -> None:
    text = CliRunner().invoke(cli, ["describe", "exact"]).output
    (row,) = [line for line in text.splitlines() if line.strip().startswith("certificate")]
    assert "true | false (not from files)" in row


@pytest.mark.parametrize("arguments", [
    ["-m", "termsel", "list", "criteria"], ["-m", "termsel.check", "nothing.json"]])
def test_modules_of_the_current_folder_do_not_run(folder: Path, arguments: list[str]) -> None:
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True,
                          check=False, cwd=folder, env=_environment())
    assert "check-rmse" in done.stdout or "there is no such file" in done.stderr, done.stderr


def _environment() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}


def test_helpers_and_workers_do_not_run_them_either(folder: Path) -> None:
    """Neither a helper nor the workers of a study, of a session that looks for modules here."""
    script = """
import sys
sys.path.remove("")
import termsel
from termsel.core.isolation.helper import Helper
study = dict(problems=["poly-terms"], solvers=["random"], seeds=2, budget={"evaluations": 20},
             options={"degree": 2})
termsel.compare(**study)  # imports what this session itself needs
sys.path.insert(0, "")
print(Helper("import json, pickle, sys; pickle.load(sys.stdin.buffer); "
             "pickle.dump(json.__file__, sys.stdout.buffer); sys.stdout.flush()").ask(1))
print(len(termsel.compare(**study, workers=2).rows))
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True,
                          check=False, cwd=folder, env=_environment())
    assert done.stdout.splitlines()[-1:] == ["2"], done.stderr
    assert str(folder) not in done.stdout


def test_the_current_folder_comes_last(
        folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", ["", "/elsewhere", str(folder), "/last"])
    assert safe_path() == ["/elsewhere", "/last", str(folder.resolve())]
    monkeypatch.setattr(sys, "path", ["/elsewhere", "/last"])
    assert safe_path() == ["/elsewhere", "/last"]
    with modules_here():
        assert sys.path == ["/elsewhere", "/last", str(folder)]
    assert sys.path == ["/elsewhere", "/last"]


def test_a_helper_starts_without_the_current_folder(folder: Path) -> None:
    helper = Helper("import pickle, sys; pickle.load(sys.stdin.buffer)\n"
                    "pickle.dump((sys.flags.safe_path, sys.path), sys.stdout.buffer)")
    safe, path = helper.ask(1)
    helper.end()
    assert safe
    assert "" not in path
    assert str(folder) not in path


def test_no_settings_of_the_current_folder_reach_numba(folder: Path) -> None:
    (folder / ".numba_config.yaml").write_text(f"cache_dir: {folder}/forged\ndisable_jit: 1\n")
    script = ("import termsel\n"
              "termsel.run('poly-terms', options={'degree': 2}, generations=1)\n"
              "import numba; print(numba.config.CACHE_DIR == '', numba.config.DISABLE_JIT)")
    for first in ("", "import numba.core.config\n"):
        for module in folder.glob("*.py"):
            module.unlink()
        done = subprocess.run([sys.executable, "-P", "-c", first + script], capture_output=True,
                              text=True, check=False, cwd=folder, env=_environment())
        assert done.stdout.split() == ["True", "0"], done.stderr
    assert not (folder / "forged").exists()


def test_programs_of_the_current_folder_are_not_started(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows looks there first, other systems where the path of programs has a dot or a blank."""
    pytest.importorskip("termsel_formats")
    from termsel_formats.check.base import find_program

    elsewhere = tmp_path / "bin"
    elsewhere.mkdir()
    for place in (tmp_path, elsewhere):
        (place / "gdalinfo").write_text("#!/bin/sh\n")
        (place / "gdalinfo").chmod(0o755)
    monkeypatch.chdir(tmp_path)
    for path in (".", str(tmp_path), os.curdir + os.pathsep):
        monkeypatch.setenv("PATH", path)
        assert find_program("gdalinfo") is None
    monkeypatch.setenv("PATH", str(elsewhere))
    assert sys.platform == "win32" or find_program("gdalinfo") == str(elsewhere / "gdalinfo")


@pytest.mark.parametrize("key", [
    "scheduler", "workers", "out", "plugins", "allow_driver", "remote"])
def test_a_study_names_no_machines_and_no_permissions(folder: Path, key: str) -> None:
    """A scheduler would be sent code and data, and send code back."""
    (folder / "study.toml").write_text(f'{key} = "tcp://127.0.0.1:9"\n'
                                       'problems = ["poly-terms"]\nsolvers = ["random"]\n')
    assert f"unknown key of a study '{key}'" in _refused("compare", "study.toml", "--dry-run")
