"""Cases of a benchmark, kept in a file as they are done, so that a run resumes.

A line of the file is ``[job, figures]`` as JSON. Which code made them is not stated: name the file
by the commit, as ``python -m benchmarks all`` does.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

Job = tuple[Any, ...]


def resumed(work: Callable[..., Any], jobs: Sequence[Job], processes: int,
            file: Path | None) -> list[Any]:
    """Return the figures of jobs, numbers and texts as JSON has them; keep each as it is done."""
    done: dict[Job, Any] = {}
    if file and file.is_file():
        for line in file.read_text(encoding="utf-8").splitlines():
            try:
                job, figures = json.loads(line)
            except ValueError:  # the run was stopped while it wrote
                continue
            done[tuple(job)] = figures
    missing = [job for job in jobs if job not in done]
    if file:
        file.parent.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(processes) as pool:
        for job, figures in zip(missing, pool.map(work, *zip(*missing, strict=True))
                                if missing else (), strict=True):
            done[job] = figures
            if file:
                with file.open("a", encoding="utf-8") as kept:
                    kept.write("\n" * (not _ends(file)) + json.dumps([job, figures]) + "\n")
    return [done[job] for job in jobs]


def _ends(file: Path) -> bool:
    """Return whether the last line is whole."""
    text = file.read_bytes()
    return not text or text.endswith(b"\n")
