"""Do the tests notice? Small changes of the code by Cosmic Ray, each run through the tests.

``python tests/mutants.py models tests/models tests/fitting`` copies the repository, draws changes
of the room ``models`` (an operator, a comparison, a number, a decorator, a condition), makes one at
a time in the copy, and runs the given tests until one fails. It prints the changes that no test
notices as diffs, and ends with code 1 if they are more than one in ten of those drawn. A folder of
a package is a room, too: ``plugins/termsel-rpc/src/termsel_rpc plugins/termsel-rpc/tests``.

Changes are drawn from the code there is, so that a new name or a moved line needs nothing here.
Some changes are no faults (a tolerance of 1e-9 that becomes 2e-9): read what survives.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]

SURVIVORS = 0.1
"""Share of the changes that tests may miss: about as many as change nothing that matters."""

CONFIG = """\
[cosmic-ray]
module-path = {room!r}
timeout = {timeout}
test-command = {command!r}
excluded-modules = []

[cosmic-ray.distributor]
name = "local"
"""


def copy_repository(folder: Path) -> Path:
    """Copy the files that git knows, with their present content, and return the copy."""
    copy = folder / "copy"
    names = subprocess.run(["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
                           cwd=ROOT, check=True, capture_output=True).stdout.decode().split("\0")
    for name in filter(None, names):
        if (ROOT / name).is_file():
            target = copy / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target)
    return copy


Span = tuple[tuple[int, int], tuple[int, int]]
"""Line and column where a piece of code begins and ends."""


def annotation_spans(module: Path) -> list[Span]:
    """Return where the annotations of a module stand: nothing evaluates them."""
    spans = []
    for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))):
        for name in ("annotation", "returns"):
            annotation = getattr(node, name, None)
            if isinstance(annotation, ast.expr):
                spans.append(((annotation.lineno, annotation.col_offset),
                              (annotation.end_lineno or 0, annotation.end_col_offset or 0)))
    return spans


def draw(session: Path, copy: Path, count: int, seed: int) -> int:
    """Leave so many changes of a session to be made, at random; return how many are left."""
    from cosmic_ray.work_db import use_db
    from cosmic_ray.work_item import WorkerOutcome, WorkResult

    with use_db(session) as database:
        changes = {item.job_id: item.mutations[0] for item in database.work_items}
        silent = {path: annotation_spans(copy / path)
                  for path in {change.module_path for change in changes.values()}}
        # Jobs have random names: the order is that of the code, so that a seed draws the same.
        jobs = sorted((change.module_path.as_posix(), change.start_pos, change.operator_name, job)
                      for job, change in changes.items()
                      if not any(start <= change.start_pos < end
                                 for start, end in silent[change.module_path]))
        random.Random(seed).shuffle(jobs)
        drawn = {job for *_, job in jobs[:count]}
        for job in changes.keys() - drawn:
            database.set_result(job, WorkResult(WorkerOutcome.SKIPPED))
    return len(drawn)


def survivors(session: Path) -> list[str]:
    """Return the diffs of the changes that no test noticed."""
    from cosmic_ray.work_db import use_db
    from cosmic_ray.work_item import WorkerOutcome

    with use_db(session) as database:
        return [result.diff or "" for _, result in database.results
                if result.worker_outcome is not WorkerOutcome.SKIPPED and not result.is_killed]


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw changes of a room, run the tests on each, and print what survives."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("room", help="a room of src/termsel, or the folder of a package's code")
    parser.add_argument("tests", nargs="+", help="tests that should notice: files and folders")
    parser.add_argument("--count", type=int, default=40, help="how many changes (default 40)")
    parser.add_argument("--seed", type=int, default=1, help="which ones are drawn (default 1)")
    parser.add_argument("--timeout", type=float, default=300.0, help="seconds of the tests")
    options = parser.parse_args(arguments)
    room = options.room if "/" in options.room else f"src/termsel/{options.room}"
    if not (ROOT / room).is_dir():
        parser.error(f"there is no folder {room}")
    if shutil.which("cosmic-ray") is None:
        parser.error("Cosmic Ray is not installed: pip install cosmic-ray")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        copy = copy_repository(folder)
        # One process for each change, and the compiled kernels of the copy stay in its folder.
        command = " ".join([sys.executable, "-m pytest -x -n 0 -p no:cacheprovider",
                            *options.tests])
        config = folder / "session.toml"
        config.write_text(CONFIG.format(room=room, timeout=options.timeout, command=command))
        session = folder / "session.sqlite"
        packages = [str(path) for path in sorted(copy.glob("plugins/*/src"))]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(copy / "src"), *packages])}

        def cosmic_ray(*words: object) -> int:
            return subprocess.run(["cosmic-ray", *map(str, words)], cwd=copy, check=False,
                                  env=environment).returncode

        if cosmic_ray("baseline", config):
            print("the tests fail without any change", file=sys.stderr)
            return 2
        if cosmic_ray("init", config, session):
            return 2
        drawn = draw(session, copy, options.count, options.seed)
        cosmic_ray("exec", config, session)
        unnoticed = survivors(session)
    for diff in unnoticed:
        print(diff)
    print(f"{drawn - len(unnoticed)} of {drawn} changes were noticed")
    return int(len(unnoticed) > SURVIVORS * drawn)


if __name__ == "__main__":
    sys.exit(main())
