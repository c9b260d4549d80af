"""What studies cost and survive: overhead and memory of cells, kills, executors, many images.

``python -m benchmarks.studies WHAT [--number N] [--workers N]``, where WHAT is overhead, cluster,
kills, executors or images, prints a few lines. `kills` ends a study with SIGKILL at random moments,
again and again, and compares its final table with that of an undisturbed one.
"""

from __future__ import annotations

import argparse
import csv
import os
import pickle
import random
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import termsel
from termsel.formats.readers.csv_tables import write_points_csv
from termsel.studies.cells.journal import JOURNAL, read_journal
from termsel.studies.cells.table import TIMES
from termsel.studies.compare import plan_cells, requested_study, works_of
from termsel.studies.execution.progress import StudyProgress

STUDY = """problems = [{name = "poly-terms", degree = 3}]
solvers = ["random", "ga"]
seeds = 40
[budget]
evaluations = 2000
[options]
polish=false
"""


def memory() -> float:
    """Return the memory that this process has in use [MB]; NaN where the system does not tell."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return float("nan")
    return pages * 4096 / 1e6


SMALLEST: dict[str, Any] = {"problems": [{"name": "poly-terms", "degree": 1}],
                            "solvers": ["random"], "budget": {"evaluations": 1}}
"""A study of cells that take a few milliseconds."""


def overhead(cells: int, workers: int) -> None:
    """Print CPU time and memory of a study of very small cells, next to those of its runs."""
    marks: dict[int, float] = {}

    def watch(progress: StudyProgress) -> None:
        if progress.finished % max(cells // 10, 1) == 0:
            marks[progress.finished] = memory()

    with tempfile.TemporaryDirectory() as folder:
        start, cpu = time.perf_counter(), time.process_time()
        study = termsel.compare(**SMALLEST, seeds=cells, workers=workers,
                                out=Path(folder) / "out", observers=(watch,))
        seconds, cpu = time.perf_counter() - start, time.process_time() - cpu
        size = (Path(folder) / "out" / JOURNAL).stat().st_size
    alone = sum(row["cpu_seconds"] for row in study.rows) if workers == 1 else 0.0
    print(f"{cells} cells, {workers} workers: {seconds:.1f} s; CPU of this process {cpu:.1f} s, "
          f"of which runs {alone:.1f} s")
    print(f"overhead {1000 * (cpu - alone) / cells:.2f} ms CPU a cell; journal "
          f"{size / cells:.0f} bytes a cell")
    print("memory [MB] by finished cells: "
          + ", ".join(f"{count}: {used:.0f}" for count, used in marks.items()))


def cluster(cells: int, workers: int) -> None:
    """Print what a dask scheduler and the command cost a cell: CPU time, and bytes sent."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{one.getsockname()[1]}"
    with tempfile.TemporaryDirectory() as folder:
        quiet: dict[str, Any] = {"stderr": subprocess.DEVNULL, "cwd": folder}
        scheduler = subprocess.Popen(
            [sys.executable, "-m", "dask", "scheduler", "--host", "127.0.0.1", "--port",
             address.rpartition(":")[2], "--no-dashboard"], **quiet)
        others = [subprocess.Popen(
            [sys.executable, "-m", "dask", "worker", address, "--nthreads", "1", "--no-nanny",
             "--no-dashboard"], **quiet) for _ in range(workers)]
        try:
            termsel.compare(**SMALLEST, seeds=10, scheduler=address)  # imports and compiles
            before, cpu = cpu_of(scheduler.pid), time.process_time()
            termsel.compare(**SMALLEST, seeds=cells, scheduler=address)
            spent, cpu = cpu_of(scheduler.pid) - before, time.process_time() - cpu
        finally:
            for process in (*others, scheduler):
                process.kill()
    spec, place = requested_study(None, {**SMALLEST, "seeds": 1})
    works, features = works_of(plan_cells(spec, place))
    sizes = [len(pickle.dumps(one)) for one in features.values()]
    print(f"{cells} cells, {workers} workers: scheduler {1000 * spent / cells:.2f} ms CPU a cell, "
          f"command {1000 * cpu / cells:.2f} ms; a cell is sent as {len(pickle.dumps(works[0]))} "
          f"bytes, its data once a worker as {sum(sizes)}")


def cpu_of(process: int) -> float:
    """Return the CPU seconds that a process has used."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def table_of(folder: Path) -> list[list[str]]:
    """Return study.csv without what differs from run to run."""
    with (folder / "study.csv").open(newline="") as file:
        return [[value for key, value in row.items() if key not in TIMES]
                for row in csv.DictReader(file)]


def kills(number: int, workers: int) -> None:
    """Kill studies at random moments, and compare what they end with."""
    rng = random.Random(1)
    with tempfile.TemporaryDirectory() as place:
        file = Path(place) / "study.toml"
        file.write_text(STUDY)

        def command(out: str) -> list[str]:
            return [sys.executable, "-m", "termsel", "compare", str(file), "--out",
                    str(Path(place) / out), "--workers", str(workers), "--quiet"]

        quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        start = time.perf_counter()
        subprocess.run(command("whole"), check=True, **quiet)
        whole, length = table_of(Path(place) / "whole"), time.perf_counter() - start
        done, studies, torn, equal = 0, 0, 0, 0
        while done < number:
            studies += 1
            out = f"out{studies}"
            while done < number:
                running = subprocess.Popen(command(out), **quiet)
                try:
                    running.wait(rng.uniform(0, 0.6 * length))
                    break
                except subprocess.TimeoutExpired:
                    running.kill()
                    running.wait()
                    done += 1
                    torn += bool(read_journal(Path(place) / out).remarks)
            subprocess.run(command(out), check=True, **quiet)
            equal += table_of(Path(place) / out) == whole
            print(f"{done} kills, {studies} studies, {torn} torn lines, {equal} tables equal",
                  flush=True)


def executors(cells: int, workers: int) -> None:
    """Print how much faster several processes are than one, and how much CPU time they take.

    The wall times are worth something on a quiet machine alone. The CPU times say what is lost to
    further processes, their start and what they send, on any machine.
    """
    asked: dict[str, Any] = {
        "problems": [{"name": "rfm-terms"}], "solvers": ["ga"], "seeds": cells,
        "budget": {"evaluations": 150_000}, "options": {"polish": False}}
    termsel.compare(**{**asked, "seeds": 1, "budget": {"evaluations": 200}})  # loads what it needs
    walls, cpus, rows = [], [], []
    for count in (1, workers):
        start, cpu = time.perf_counter(), cpu_of_all()
        study = termsel.compare(**asked, workers=count)
        walls.append(time.perf_counter() - start)
        cpus.append(cpu_of_all() - cpu)
        rows.append([{key: value for key, value in row.items() if key not in TIMES}
                     for row in study.rows])
    print(f"{cells} cells: 1 process {walls[0]:.1f} s, {workers} processes {walls[1]:.1f} s: "
          f"{walls[0] / walls[1]:.2f} times; the same rows: {rows[0] == rows[1]}")
    print(f"CPU: 1 process {cpus[0]:.1f} s, {workers} processes {cpus[1]:.1f} s, "
          f"{cpus[1] / cpus[0]:.3f} times as much; so at most "
          f"{workers * cpus[0] / cpus[1]:.2f} times as fast on {workers} free cores")


def cpu_of_all() -> float:
    """Return the CPU seconds of this process and of those it started that have ended."""
    now = os.times()
    return now.user + now.system + now.children_user + now.children_system


def images(number: int, workers: int) -> None:
    """Print how long the strategy auto takes for images of 50 simulated points each."""
    with tempfile.TemporaryDirectory() as folder:
        for i in range(number):
            scene = termsel.simulate_scene("ikonos-hamedan")
            chosen = np.sort(np.random.default_rng(i).permutation(len(scene.points))[:50])
            write_points_csv(scene.points.take(chosen), Path(folder) / f"image{i:03}.csv",
                             crs=scene.crs)
        start, cpu = time.perf_counter(), 0.0
        study = termsel.compare(data=[{"points": f"{folder}/*.csv"}], workers=workers,
                                out=Path(folder) / "out")
        seconds = time.perf_counter() - start
        cpu = sum(row["cpu_seconds"] or 0.0 for row in study.rows)
    print(f"{number} images of 50 points, {workers} workers: {seconds:.0f} s, CPU {cpu:.0f} s, "
          f"{cpu / number:.2f} s an image")


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("what", choices=["overhead", "cluster", "kills", "executors", "images"])
    parser.add_argument("--number", type=int, default=100, help="cells, kills or images; for "
                        "executors 100 cells are a bit more than a minute of one core")
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args()
    {"overhead": overhead, "cluster": cluster, "kills": kills, "executors": executors,
     "images": images}[asked.what](asked.number, asked.workers)


if __name__ == "__main__":
    main()
