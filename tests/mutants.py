"""Do the tests notice? One-line mutants of the code, each run through the tests that should fail.

``python tests/mutants.py`` copies the repository and runs all named tests on the unchanged copy.
Then it changes one line of the copy at a time as tests/mutants.toml lists, runs the tests named
there until one fails, and prints which mutants survived. It ends with code 1 if more than one in
twenty did, and with 2 if a test fails without any mutant. ``--only TEXT`` takes the mutants whose
file or change holds the text; ``--jobs N`` runs as many at once. ``--passed`` spares the run on the
unchanged copy, where the suite has just passed. ``--kept FILE`` writes down what became of each
mutant as soon as it is known; the same command later begins where it was stopped.

Each run is a fork of a process that has the libraries already, as importing them takes longer than
most tests: POSIX alone.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

ROOT = Path(__file__).parents[1]
ENOUGH = 0.95
"""Share of the mutants that the tests must notice."""

LIBRARIES = ("pytest", "hypothesis", "numpy", "scipy.optimize", "scipy.spatial", "scipy.special",
             "scipy.stats", "numba", "pymoo.core.algorithm", "deap.tools", "click.testing",
             "rich.progress", "msgspec", "rasterio", "pyproj", "shapely")
"""What most tests import; nothing of termsel, whose modules are those of the copy."""

COPIED = ("src", "plugins", "tests", "docs", "benchmarks", "conftest.py", "pyproject.toml",
          "README.md", "CHANGELOG.md", "CONTRIBUTING.md")


@dataclass(frozen=True)
class Mutant:
    """A change of one line.

    Parameters
    ----------
    file : str
        Below the root.
    old, new : str
        A part of a line that stands once in the file, and what replaces it.
    tests : tuple of str
        Arguments of pytest: files, or one of their tests.
    """

    file: str
    old: str
    new: str
    tests: tuple[str, ...]

    def applied(self, text: str) -> str:
        """Return the text with the change.

        Raises
        ------
        ValueError
            If the old part does not stand in it just once, or is more than a part of a line.
        """
        if text.count(self.old) != 1 or "\n" in self.old + self.new or self.old == self.new:
            raise ValueError(f"{self.file}: {self.old!r} stands {text.count(self.old)} times, "
                             "or is no part of one line")
        return text.replace(self.old, self.new)


def listed(root: Path = ROOT) -> list[Mutant]:
    """Return the mutants of tests/mutants.toml."""
    table = tomllib.loads((root / "tests/mutants.toml").read_text())
    return [Mutant(one["file"], one["old"], one["new"], tuple(one["tests"]))
            for one in table["mutant"]]


def copied(folder: Path) -> Path:
    """Return a new copy of what tests need."""
    folder.mkdir()
    for name in COPIED:
        take = shutil.copytree if (ROOT / name).is_dir() else shutil.copy2
        take(ROOT / name, folder / name)
    return folder


@dataclass(frozen=True)
class Started:
    """Tests that run on a copy, perhaps with a mutant."""

    process: int
    copy: Path
    output: Path
    until: float
    mutant: Mutant | None = None
    source: str = ""  # the text of the file without the mutant


def started(copy: Path, tests: Iterable[str], seconds: float, mutant: Mutant | None = None,
            fresh: bool = False) -> Started:
    """Begin to run tests on a copy until the first fails; `fresh` compiles all kernels again."""
    source = ""
    if mutant is not None:
        path = copy / mutant.file
        source = path.read_text()
        path.write_text(mutant.applied(source))
    output = copy.with_suffix(".txt")
    process = os.fork()
    if process == 0:
        os.setsid()
        to = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(to, 1)
        os.dup2(to, 2)
        os.chdir(copy)
        sources = [str(copy / "src"), *map(str, copy.glob("plugins/*/src"))]
        # Without files of bytecode, which a change within a second may leave in place.
        sys.dont_write_bytecode = True
        os.environ |= {"PYTHONPATH": os.pathsep.join(sources), "PYTHONDONTWRITEBYTECODE": "1"}
        if fresh:
            os.environ["NUMBA_CACHE_DIR"] = tempfile.mkdtemp(dir=copy.parent)
            import_module("numba").config.reload_config()
        sys.path[:0] = [str(copy), *sources]
        code = 4
        with suppress(BaseException):
            code = int(import_module("pytest").main(
                ["-x", "-q", "-n", "0", "-p", "no:cacheprovider", "-m", "", *tests]))
        os._exit(code)
    return Started(process, copy, output, time.monotonic() + seconds, mutant, source)


def ended(run: Started) -> int | None:
    """Return the exit code of pytest, 1 for tests that never end, None for tests that run on."""
    process, status = os.waitpid(run.process, os.WNOHANG)
    if not process and time.monotonic() < run.until:
        return None
    with suppress(ProcessLookupError):  # what a test started and left
        os.killpg(run.process, signal.SIGKILL)
    if not process:
        os.waitpid(run.process, 0)
    if run.mutant is not None:
        (run.copy / run.mutant.file).write_text(run.source)
    # A process that is killed, as for want of memory, did not pass either.
    code = os.waitstatus_to_exitcode(status) if process else 1
    return 1 if code < 0 else code


def run(mutants: list[Mutant], jobs: int, seconds: float) -> Iterator[tuple[Mutant, bool]]:
    """Yield each mutant and whether it was noticed, as they end."""
    with tempfile.TemporaryDirectory() as folder:
        free = [copied(Path(folder) / str(job)) for job in range(min(jobs, len(mutants)))]
        waiting = list(reversed(mutants))
        running: list[Started] = []
        again: set[Mutant] = set()
        try:
            while waiting or running:
                while waiting and free:
                    mutant = waiting.pop()
                    running.append(started(free.pop(), mutant.tests, seconds, mutant,
                                           mutant in again))
                time.sleep(0.02)
                for one in list(running):
                    if (code := ended(one)) is None:
                        continue
                    running.remove(one)
                    free.append(one.copy)
                    assert one.mutant is not None
                    # 1 is a failed test, 2 an error while collecting; others: none was run.
                    if code not in (0, 1, 2):
                        raise RuntimeError(f"{one.mutant.file}: {one.output.read_text()[-4000:]}")
                    # Kernels that call a changed one are kept on disk as they were.
                    if code == 0 and one.mutant not in again and "compiled" in one.source:
                        again.add(one.mutant)
                        waiting.append(one.mutant)
                    else:
                        yield one.mutant, code != 0
        finally:
            for one in running:
                with suppress(ProcessLookupError):
                    os.killpg(one.process, signal.SIGKILL)


def main() -> int:
    """Run the mutants and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--only", default="", help="mutants whose file or change holds this text")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--seconds", type=float, default=300.0, help="most time for one mutant")
    parser.add_argument("--passed", action="store_true", help="the tests pass without any mutant")
    parser.add_argument("--kept", type=Path, help="file of what is known, to be continued")
    given = parser.parse_args()
    mutants = [one for one in listed() if given.only in f"{one.file} {one.old} {one.new}"]
    for one in mutants:  # before any test is run
        one.applied((ROOT / one.file).read_text())
    for name in LIBRARIES:
        import_module(name)
    if not given.passed and not passes(mutants):
        return 2
    known: dict[str, bool] = {}
    if given.kept and given.kept.exists():
        for line in given.kept.read_text().splitlines():
            known |= json.loads(line)
    for one, seen in run([one for one in mutants if f"{one}" not in known], given.jobs,
                         given.seconds):
        known[f"{one}"] = seen
        if given.kept:
            with given.kept.open("a") as kept:
                kept.write(json.dumps({f"{one}": seen}) + "\n")
        print("killed  " if seen else "SURVIVED", one.file, one.old, "->", one.new, flush=True)
    killed = sum(known[f"{one}"] for one in mutants)
    print(f"{killed} of {len(mutants)} mutants killed")
    return 0 if killed >= ENOUGH * len(mutants) else 1


def passes(mutants: list[Mutant]) -> bool:
    """Return whether the tests of mutants pass without any; print why not."""
    with tempfile.TemporaryDirectory() as folder:
        plain = started(copied(Path(folder) / "plain"),
                        sorted({test for one in mutants for test in one.tests}), float("inf"))
        while (code := ended(plain)) is None:
            time.sleep(0.2)
        if code:
            print(f"the tests do not pass without any mutant:\n{plain.output.read_text()}")
        return code == 0


if __name__ == "__main__":
    sys.exit(main())
