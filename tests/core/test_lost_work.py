"""Work is not lost: outputs that cannot be written are told first, and exports go on."""

from __future__ import annotations

import errno
import itertools
import os
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

import termsel
from termsel.cli.main import cli
from termsel.core.files.reasons import reason_of


def invoke(*arguments: object) -> Result:
    return CliRunner().invoke(cli, list(map(str, arguments)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("lost") / "result"
    termsel.run("rfm-terms", dataset="spot-isfahan", solver="all-terms", criterion="press",
                model="affine", out=out)
    return out


@pytest.mark.parametrize("command", [
    ["report", "RESULT", "-o"], ["plot", "RESULT", "residuals", "-o"],
    ["export", "RESULT", "--to", "points-csv", "--output"], ["plan", "RESULT", "-n", "3", "-o"]])
@pytest.mark.parametrize(("output", "said"), [
    ("missing/FILE", "there is no such folder"), ("afile/FILE", "afile is a file, not a folder"),
    ("adir.FILE", "this is a folder, expected a file")])
def test_an_output_that_cannot_be_written_is_told_before_the_work(
        folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: list[str],
        output: str, said: str) -> None:
    name = {"report": "page.html", "plot": "plot.svg"}.get(command[0], "table.csv")
    (tmp_path / "afile").write_text("")
    (tmp_path / f"adir.{name}").mkdir()

    def worked(*_: Any, **__: Any) -> None:
        pytest.fail("it worked first")

    monkeypatch.setattr("termsel.io.result_folder.result_from", worked)
    done = invoke(*[word.replace("RESULT", str(folder)) for word in command],
                  tmp_path / output.replace("FILE", name))
    assert done.exit_code == 2, done.output
    assert said in done.output


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_permission_is_told_before_the_work(folder: Path, tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    done = invoke("report", folder, "-o", tmp_path / "page.html")
    tmp_path.chmod(0o700)
    assert done.exit_code == 2
    assert "no permission" in done.output


def test_an_export_that_was_killed_between_its_files_can_be_repeated(
        folder: Path, tmp_path: Path) -> None:
    pytest.importorskip("rasterio")
    whole = tmp_path / "whole" / "scene.vrt"
    whole.parent.mkdir()
    arguments = ("export", folder, "--to", "geolocation-vrt", "--set", "step=200", "--output")
    assert invoke(*arguments, whole).exit_code == 0
    array = whole.with_name("scene_xy.tif")
    target = tmp_path / "scene.vrt"
    (tmp_path / array.name).write_bytes(array.read_bytes())  # the VRT comes last
    assert invoke(*arguments, target).exit_code == 0
    assert target.read_bytes() == whole.read_bytes()
    # What is there otherwise is somebody's own.
    target.unlink()
    (tmp_path / array.name).write_bytes(b"mine")
    done = invoke(*arguments, target)
    assert done.exit_code == 2
    assert "already exists" in done.output
    assert (tmp_path / array.name).read_bytes() == b"mine"


def test_the_reason_of_a_library_is_told_and_not_that_there_was_one(tmp_path: Path) -> None:
    def chained(*errors: Exception) -> Exception:
        for error, cause in itertools.pairwise(errors):
            error.__cause__ = cause
        return errors[0]

    vague = "Read or write failed. See previous exception for details."
    assert reason_of(chained(ValueError(vague), ValueError("TIFFReadEncodedStrip failed"))) == \
        "TIFFReadEncodedStrip failed"
    assert reason_of(ValueError(vague)) == "Read or write failed"
    assert reason_of(chained(ValueError(vague), OSError(errno.ENOSPC, "No space left"))) == \
        "the disk is full"
    assert reason_of(ValueError("sqlite3: database or disk is full")) == "the disk is full"
    assert reason_of(ValueError("no such band"), tmp_path) == "no such band"
