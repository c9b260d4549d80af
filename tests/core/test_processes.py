"""Tasks and results in other processes: they pickle, and every executor gives the same."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

import termsel
from termsel.results.result import Result
from termsel.runs.task import Task

SEEDS = (1, 2)

CASES = [
    ("rfm-terms", {"solver": "ga"}), ("poly-terms", {"solver": "pso", "criterion": "press"}),
    ("owdis-lines", {"solver": "nsga2"})]


def found(task: Task, seed: int) -> dict[str, Any]:
    """Return what a run finds, without the time it takes."""
    record = termsel.run(task, seed=seed, generations=2).to_dict()
    return {key: record[key] for key in record if key not in ("seconds", "history", "checksum")}


def _task(problem: str, **given: Any) -> Task:
    return termsel.prepare(problem, options={"population": 12}, **given)


@pytest.mark.slow_cases("owdis-lines", "poly-terms")
@pytest.mark.parametrize(("problem", "given"), CASES, ids=[problem for problem, _ in CASES])
def test_a_task_pickles(problem: str, given: dict[str, Any]) -> None:
    task = _task(problem, **given)
    copy = pickle.loads(pickle.dumps(task))
    genes = task.problem.genome.random(np.random.default_rng(1), 20)
    one, other = task.problem.evaluate(genes), copy.problem.evaluate(genes)
    np.testing.assert_array_equal(one.objectives, other.objectives)
    np.testing.assert_array_equal(one.violation, other.violation)
    assert task.problem.decode(genes[0]) == copy.problem.decode(genes[0])
    assert found(copy, 1) == found(task, 1)


@pytest.mark.slow_cases("auto")
@pytest.mark.parametrize("strategy", ["auto", "as-asked"])
def test_a_result_pickles(strategy: str) -> None:
    budget = {} if strategy == "auto" else {"generations": 2}
    result = termsel.run("poly-terms", strategy=strategy, **budget)
    copy: Result = pickle.loads(pickle.dumps(result))
    assert copy.to_json() == result.to_json()
    assert copy.summary() == result.summary()
    ground = termsel.simulate_scene("ikonos-hamedan").points.ground
    np.testing.assert_array_equal(copy.project(ground), result.project(ground))


def _threads(task: Task) -> list[dict[str, Any]]:
    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(found, [task] * len(SEEDS), SEEDS))


def _spawn(task: Task) -> list[dict[str, Any]]:
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        return list(pool.map(found, [task] * len(SEEDS), SEEDS))


def _loky(task: Task) -> list[dict[str, Any]]:
    joblib = pytest.importorskip("joblib")
    return list(joblib.Parallel(2, backend="loky")(
        joblib.delayed(found)(task, seed) for seed in SEEDS))


def _dask(task: Task) -> list[dict[str, Any]]:
    distributed = pytest.importorskip("distributed")
    with distributed.Client(n_workers=1, threads_per_worker=2, processes=True,
                            dashboard_address=None) as client:
        return list(client.gather([client.submit(found, task, seed, pure=False)
                                   for seed in SEEDS]))


@pytest.mark.slow
@pytest.mark.parametrize("executor", [_threads, _spawn, _loky, _dask])
def test_every_executor_gives_the_same(
        executor: Callable[[Task], list[dict[str, Any]]]) -> None:
    task = _task("rfm-terms", solver="ga")
    assert executor(task) == [found(task, seed) for seed in SEEDS]


STARTS = """
import os
from termsel.core.isolation.helper import context_of_workers

if __name__ == "__main__":
    print(context_of_workers([]).get_start_method())
    os.environ["OMP_NUM_THREADS"] = "7"
    print(context_of_workers([]).get_start_method())
"""

DRAWS = """
import os
from concurrent.futures import ProcessPoolExecutor
import numpy as np
from termsel.core.isolation.helper import context_of_workers
from termsel.studies.execution.executors import begin_worker

def draw():
    return np.random.random()

def draw_in_worker():
    with ProcessPoolExecutor(1, context_of_workers(["numpy"]), initializer=begin_worker,
                             initargs=({}, dict(os.environ))) as pool:
        return pool.submit(draw).result()

if __name__ == "__main__":
    print(draw_in_worker(), draw_in_worker())
"""


def _output_of(script: str, temporary: Path) -> list[str]:
    """Return the words that a script prints where the temporary folder is `temporary`."""
    path = temporary / "script.py"
    path.write_text(script)
    return subprocess.run([sys.executable, path], env=os.environ | {"TMPDIR": str(temporary)},
                          check=True, text=True, stdout=subprocess.PIPE).stdout.split()


@pytest.mark.skipif(sys.platform != "linux", reason="workers are forked on Linux alone")
def test_workers_are_forked_unless_settings_changed_or_a_socket_has_no_place(tmp_path: Path,
                                                                             ) -> None:
    with TemporaryDirectory(dir="/tmp") as folder:
        assert _output_of(STARTS, Path(folder)) == ["forkserver", "spawn"]
    folder_of_job = tmp_path / ("x" * 90)
    folder_of_job.mkdir()
    assert _output_of(STARTS, folder_of_job) == ["spawn", "spawn"]


@pytest.mark.slow
def test_each_worker_draws_its_own_numbers(tmp_path: Path) -> None:
    first, second = _output_of(DRAWS, tmp_path)
    assert first != second
