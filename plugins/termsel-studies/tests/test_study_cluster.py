"""Studies on a cluster: a real scheduler and real workers, some of which are lost."""

# mypy: disable-error-code="arg-type"
from __future__ import annotations

import contextlib
import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

import termsel
from termsel import TermselError
from termsel.toolkit.studies import TIMES, StudyProgress

pytest.importorskip("distributed")

ASKED = {"problems": [{"name": "poly-terms", "degree": 3}], "solvers": ["random", "ga"],
         "options": {"polish": False}}


def _free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


@dataclass
class Cluster:
    """A scheduler and workers, each a process started by dask's own command."""

    folder: Path
    port: int = field(default_factory=_free_port)
    scheduler: subprocess.Popen[bytes] | None = None
    workers: list[subprocess.Popen[bytes]] = field(default_factory=list)

    @property
    def address(self) -> str:
        return f"tcp://127.0.0.1:{self.port}"

    def _start(self, name: str, *words: str) -> subprocess.Popen[bytes]:
        with (self.folder / f"{name}.log").open("ab") as log:
            return subprocess.Popen([sys.executable, "-m", "dask", name, *words], stdout=log,
                                    stderr=log, env={**os.environ, "OMP_NUM_THREADS": "1"})

    def start_scheduler(self) -> None:
        self.scheduler = self._start("scheduler", "--host", "127.0.0.1", "--port", str(self.port),
                                     "--no-dashboard")

    def start_worker(self) -> None:
        self.workers.append(self._start(
            "worker", self.address, "--nthreads", "1", "--no-dashboard", "--no-nanny",
            "--local-directory", str(self.folder), "--death-timeout", "60"))

    def end(self) -> None:
        for process in (*self.workers, self.scheduler):
            if process is not None:
                process.kill()
                process.wait()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    made = Cluster(tmp_path_factory.mktemp("cluster"))
    made.start_scheduler()
    for _ in range(4):
        made.start_worker()
    yield made
    made.end()


def _plain(study: termsel.Study) -> list[dict[str, object]]:
    return [{key: value for key, value in row.items() if key not in TIMES} for row in study.rows]


@pytest.mark.slow
def test_a_cluster_gives_what_one_process_gives_whatever_is_lost(cluster: Cluster) -> None:
    asked = {**ASKED, "seeds": 10, "budget": {"evaluations": 1000}}
    alone = termsel.compare(**asked)
    lost: list[str] = []

    def interfere(progress: StudyProgress) -> None:
        if progress.finished == 4 and "worker" not in lost:
            lost.append("worker")
            cluster.workers[0].kill()
        if progress.finished == 10 and "scheduler" not in lost:
            lost.append("scheduler")
            assert cluster.scheduler is not None
            cluster.scheduler.kill()
            cluster.scheduler.wait()
            # Workers of a lost scheduler end; a cluster's queue starts others.
            cluster.start_scheduler()
            for _ in range(2):
                cluster.start_worker()

    found = termsel.compare(**asked, scheduler=cluster.address, observers=(interfere,))
    assert lost == ["worker", "scheduler"]
    assert found.complete
    assert _plain(found) == _plain(alone)


@pytest.mark.slow
def test_workers_without_a_plugin_are_named_before_anything_runs(
        cluster: Cluster, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:

    asked = {**ASKED, "budget": {"evaluations": 50}}
    for needed, said in ({"termsel-other": "1.0"}, "lacks termsel-other, which the study needs"), (
            {"numpy": "0.1"}, "has numpy .*, this machine 0.1"):
        monkeypatch.setattr("termsel.studies.compare._plugin_versions",
                            lambda _cells, _spec, needed=needed: needed)
        out = tmp_path / next(iter(needed))
        with pytest.raises(TermselError, match=rf"worker tcp://127\.0\.0\.1:\d+ {said}"):
            termsel.compare(**asked, scheduler=cluster.address, out=out)
        assert not termsel.read_study(out).records


SBATCH = """#!/bin/sh
cp "$1" {folder}/job.sh
sh {folder}/job.sh > {folder}/job.log 2>&1 &
echo $! > {folder}/job.pid
echo Submitted batch job 1
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs a shell")
def test_the_page_on_clusters_starts_workers_through_a_queue(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("dask_jobqueue")
    page = (Path(__file__).parents[3] / "docs" / "how-to" / "cluster.md").read_text()
    (snippet,) = re.findall(r"```python\n(import time\n\nfrom dask_jobqueue.*?)```", page, re.S)
    # The queue takes the job and runs it here: one worker in place of 64.
    for name, text in (("sbatch", SBATCH.format(folder=tmp_path)), ("scancel", "#!/bin/sh\n")):
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    for old, new in (("cores=16, processes=16", "cores=1, processes=1"), ("jobs=4", "jobs=1"),
                     ("8786", str(_free_port())), ("source ~/venv/bin/activate", "set -e")):
        assert old in snippet
        snippet = snippet.replace(old, new)
    names: dict[str, Any] = {}
    exec(compile(snippet.partition("while True")[0], "cluster.md", "exec"), names)
    try:
        asked = {**ASKED, "budget": {"evaluations": 100}}
        found = termsel.compare(**asked, scheduler=names["cluster"].scheduler_address)
    finally:
        names["cluster"].close()
        job = tmp_path / "job.pid"
        if job.exists():
            with contextlib.suppress(ProcessLookupError):
                os.kill(int(job.read_text()), signal.SIGTERM)
    script = (tmp_path / "job.sh").read_text()
    for line in ("#SBATCH -p normal", "#SBATCH -t 04:00:00", "export NUMBA_CACHE_DIR="):
        assert line in script
    assert _plain(found) == _plain(termsel.compare(**asked))


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    from termsel_studies import cluster

    monkeypatch.setattr(cluster, "PATIENCE", 1.0)
    asked = {**ASKED, "budget": {"evaluations": 50}}
    with pytest.raises(TermselError, match="does not answer or has no workers"):
        termsel.compare(**asked, scheduler=f"tcp://127.0.0.1:{_free_port()}")
    with pytest.raises(TermselError, match="no address of a scheduler"):
        termsel.compare(**asked, scheduler="nonsense://x")


@pytest.mark.parametrize("address", ["tcp://127.0.0.1", "head", "tcp://head:many", ""])
def test_what_has_no_port_is_no_address(address: str) -> None:
    with pytest.raises(TermselError, match="no address of a scheduler"):
        termsel.compare(**ASKED, budget={"evaluations": 50}, scheduler=address)


def test_a_worker_that_differs_is_named_with_its_address() -> None:
    from termsel_studies.cluster import installed_versions, require_same_versions

    here = installed_versions(("termsel", "numpy"))
    assert here["termsel"] == termsel.__version__
    require_same_versions({"termsel": termsel.__version__}, here, "tcp://10.0.0.7:1")
    with pytest.raises(TermselError, match=r"worker tcp://10.0.0.7:1 lacks termsel-other"):
        require_same_versions({"termsel-other": "1.0"}, installed_versions(("termsel-other",)),
                      "tcp://10.0.0.7:1")
    with pytest.raises(TermselError, match=r"tcp://10.0.0.7:1 has numpy .*, this machine 1.0"):
        require_same_versions({"numpy": "1.0"}, here, "tcp://10.0.0.7:1")
