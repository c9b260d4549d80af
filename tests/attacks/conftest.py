"""A server that must see nothing, files that must not change, and commands in a process apart."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

import termsel
from tests.counting_server import SERVER

SECRET = "This stays as it is, and nobody reads it. " * 100


class Server:
    """A server on this machine, and what was asked of it."""

    def __init__(self, url: str, log: Path) -> None:
        self.url, self._log = url, log

    @property
    def requests(self) -> list[str]:
        return self._log.read_text().splitlines()

    def forget(self) -> None:
        self._log.write_text("")


@pytest.fixture(scope="session")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    log = tmp_path_factory.mktemp("server") / "log"
    log.touch()
    with subprocess.Popen([sys.executable, "-c", SERVER, str(log)], stdout=subprocess.PIPE,
                          text=True) as process:
        assert process.stdout is not None
        yield Server(f"http://127.0.0.1:{process.stdout.readline().strip()}", log)
        process.kill()


@pytest.fixture
def server(running: Server) -> Iterator[Server]:
    """The server; at the end of the test nobody may have asked it."""
    running.forget()
    yield running
    assert running.requests == []


@pytest.fixture
def victim(tmp_path: Path) -> Iterator[Path]:
    """A folder of somebody else; at the end of the test it is as it was."""
    folder = tmp_path / "victim"
    folder.mkdir()
    (folder / "kept.txt").write_text(SECRET)
    (folder / "empty").mkdir()
    before = _state(folder)
    yield folder
    assert _state(folder) == before


def _state(folder: Path) -> dict[str, str]:
    return {str(path): sha256(path.read_bytes()).hexdigest() if path.is_file() else "folder"
            for path in folder.rglob("*")}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the stranger's files, which is the current one."""
    place = tmp_path / "stranger"
    place.mkdir()
    monkeypatch.chdir(place)
    return place


@pytest.fixture(scope="session")
def made_result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a result, for commands that ask for one."""
    rng = np.random.default_rng(0)
    image = rng.uniform(0, 59, (40, 2))
    ground = np.column_stack([image[:, 1] / 100 - 56.3, -34.5 - image[:, 0] / 100, image[:, 0]])
    points = termsel.Points([f"P{i}" for i in range(40)], image, ground)
    made = tmp_path_factory.mktemp("result") / "result"
    termsel.run("poly-terms", features=termsel.FeatureSet(points, crs="EPSG:4979"), out=made,
                options={"degree": 1}, evaluations=20)
    return made


Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def typed() -> Run:
    """Run the command line in a process of its own, as a user does."""
    def run(*words: object) -> subprocess.CompletedProcess[str]:
        done = subprocess.run([sys.executable, "-m", "termsel", *map(str, words)], timeout=60,
                              capture_output=True, text=True, check=False, env={**os.environ})
        assert "Traceback" not in done.stderr, done.stderr
        return done
    return run
