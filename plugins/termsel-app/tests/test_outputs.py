"""What a session gives away is what the command line gives, file by file."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import termsel
from termsel import TermselError
from termsel_app.outputs import OUTPUTS, command_line, save
from termsel_app.quality import Question, judge_control, split_lines_by_owdis
from termsel_app.session import Files, open_session

TIMES = frozenset(("seconds", "checksums"))
"""What differs between two runs of the same: how long they took, and the checksum of that."""


@pytest.fixture(scope="module")
def scene(example_files: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of the tutorial, with twelve of its points."""
    folder = Path(shutil.copytree(example_files, tmp_path_factory.mktemp("scene") / "files"))
    features = termsel.read(folder / "gcps.csv", dem=folder / "dem.tif")
    chosen = np.random.default_rng(1).choice(len(features.points), 12, replace=False)
    termsel.write_points_csv(features.points.take(chosen), folder / "twelve.csv", features.crs)
    return folder


def without_times(value: Any) -> Any:
    """Return a record without what differs between two runs."""
    if isinstance(value, dict):
        return {key: without_times(item) for key, item in value.items() if key not in TIMES}
    if isinstance(value, list):
        return [without_times(item) for item in value]
    return value


def contents(folder: Path) -> dict[str, Any]:
    """Return the files of a result, without times."""
    return {file.name: without_times(json.loads(file.read_text("utf-8")))
            if file.suffix == ".json" else re.sub(r"[\d.]+ s\b", "", file.read_text("utf-8"))
            for file in folder.iterdir() if file.is_file()}


@pytest.mark.slow
def test_the_result_is_that_of_the_command_line_file_by_file(scene: Path, tmp_path: Path) -> None:
    """The line that the page shows is run in a folder that has the points alone."""
    given = Files(str(scene / "scene.tif"), (str(scene / "ortho.tif"),),
                  str(scene / "twelve.csv"), dem=str(scene / "dem.tif"))
    with open_session(given, tmp_path / "session") as session:
        line = command_line(session)
        (saved,) = save(session, "result")
        assert {*OUTPUTS} >= {"points", "result", "map", "report", "annotation", "gpkg"}
        (points,) = save(session, "points")
    again = tmp_path / "again"
    again.mkdir()
    shutil.copy(points, again)
    place, _, words = line.partition(" && termsel ")
    assert place == f"cd {tmp_path / 'session'}"
    done = subprocess.run(
        f'"{sys.executable}" -P -m termsel {words}', shell=True, cwd=again, check=False,
        capture_output=True, text=True, env={**os.environ, "COLUMNS": "100"})
    assert done.returncode == 0, done.stderr
    made = contents(saved)
    repeated = contents(again / "result")
    assert made.keys() == repeated.keys() >= {"result.json", "points.csv", "residuals.csv"}
    for name, content in made.items():
        assert content == repeated[name], name


@pytest.mark.slow
def test_of_lines_the_choice_of_owdis_is_told(scene: Path) -> None:
    features = termsel.read(lines=scene / "lines.csv")
    few = features.with_(lines=features.lines.take(np.arange(12)))
    answer = split_lines_by_owdis(few)
    expected = termsel.run("owdis-lines", features=few, criterion="press", strategy="as-asked")
    assert answer["chosen"] == list(expected.selection.features)
    assert f"OWDIS uses {len(answer['chosen'])} of 12 lines" in answer["text"]
    flat = few.with_(lines=termsel.Lines(few.lines.ids, few.lines.image, np.concatenate(
        [few.lines.ground[..., :2], np.full((12, 2, 1), np.nan)], axis=2)))
    assert split_lines_by_owdis(flat)["text"].startswith("OWDIS ")


def test_lines_are_chosen_from_six_on(scene: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stages(count: int) -> list[str]:
        lines = features.with_(lines=features.lines.take(np.arange(count)))
        return [str(answer["stage"]) for answer in judge_control(Question(1, lines, None))]

    features = termsel.read(lines=scene / "lines.csv")
    monkeypatch.setattr("termsel_app.quality.split_lines_by_owdis",
                        lambda _: {"chosen": None, "text": ""})
    assert "lines" not in stages(5)
    assert "lines" in stages(8)


def test_a_result_of_the_same_control_is_not_computed_again(
        scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def run(arguments: Sequence[str], folder: Path) -> None:
        calls.append(arguments[0])
        if arguments[0] == "run":
            (folder / "result").mkdir(exist_ok=True)
            (folder / "result" / "result.json").write_text("{}")

    calls: list[str] = []
    monkeypatch.setattr("termsel_app.outputs.run_command", run)
    given = Files(str(scene / "scene.tif"), points=str(scene / "twelve.csv"))
    with open_session(given, tmp_path / "s") as session:
        for name in ("map", "rpc", "result"):
            save(session, name)
        assert calls == ["run", "rectify", "export"]
        session.put({"id": next(iter(session.control.records)), "role": "off"})
        save(session, "report")
        assert calls[3:] == ["run", "report"]
        (tmp_path / "s" / "result" / "result.json").write_text("another")
        save(session, "result")
        assert calls[5:] == ["run"]


def test_only_what_is_listed_is_saved(tmp_path: Path) -> None:
    with open_session(Files(None, crs="local"), tmp_path / "s") as session:
        for name in ("../points", "", "points.csv", "exec"):
            with pytest.raises(TermselError, match="no output"):
                save(session, name)
