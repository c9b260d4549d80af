"""Do the tests notice? One-line mutants of the code, each run through the tests that should fail.

``python tests/mutants.py`` copies the repository and runs all named tests on the unchanged copy.
Then it changes one line of the copy at a time as tests/mutants.toml lists, runs the tests named
there and prints which mutants survived. It ends with code 1 if more than one in twenty did, and
with 2 if a test fails without any mutant. ``--only TEXT`` takes the mutants whose file or change
holds the text; ``--jobs N`` runs as many at once.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import Queue

ROOT = Path(__file__).parents[1]
ENOUGH = 0.95
"""Share of the mutants that the tests must notice."""

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


def pytest_on(copy: Path, tests: Iterable[str], seconds: float | None = None, jobs: int = 0,
              ) -> subprocess.CompletedProcess[str]:
    """Run tests on a copy until the first fails."""
    sources = (copy / "src", *copy.glob("plugins/*/src"))
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-x", "-q", "-n", str(jobs), "-p", "no:cacheprovider",
         *tests], cwd=copy, capture_output=True, text=True, timeout=seconds,
        # Without files of bytecode, which a change within a second may leave in place.
        env={**os.environ, "PYTHONPATH": os.pathsep.join(map(str, sources)),
             "PYTHONDONTWRITEBYTECODE": "1"})


def noticed(mutant: Mutant, copy: Path, seconds: float) -> bool:
    """Return whether a test fails, or never ends, on a copy with the mutant."""
    path = copy / mutant.file
    text = path.read_text()
    path.write_text(mutant.applied(text))
    try:
        done = pytest_on(copy, mutant.tests, seconds)
    except subprocess.TimeoutExpired:
        return True
    finally:
        path.write_text(text)
    # 1 is a failed test, 2 an error while collecting; others mean that no test was run.
    if done.returncode not in (0, 1, 2):
        raise RuntimeError(f"{mutant.file}: {done.stdout[-2000:]}{done.stderr[-2000:]}")
    return done.returncode != 0


def run(mutants: list[Mutant], jobs: int, seconds: float) -> Iterator[tuple[Mutant, bool]]:
    """Yield each mutant and whether it was noticed."""
    with tempfile.TemporaryDirectory() as folder:
        copies: Queue[Path] = Queue()
        for job in range(jobs):
            copies.put(copied(Path(folder) / str(job)))

        def one(mutant: Mutant) -> bool:
            copy = copies.get()
            try:
                return noticed(mutant, copy, seconds)
            finally:
                copies.put(copy)

        with ThreadPoolExecutor(jobs) as pool:
            yield from zip(mutants, pool.map(one, mutants), strict=True)


def main() -> int:
    """Run the mutants and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--only", default="", help="mutants whose file or change holds this text")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--seconds", type=float, default=300.0, help="most time for one mutant")
    given = parser.parse_args()
    mutants = [one for one in listed() if given.only in f"{one.file} {one.old} {one.new}"]
    for one in mutants:  # before any test is run
        one.applied((ROOT / one.file).read_text())
    with tempfile.TemporaryDirectory() as folder:
        tests = sorted({test for one in mutants for test in one.tests})
        done = pytest_on(copied(Path(folder) / "plain"), tests, jobs=given.jobs)
    if done.returncode:
        print(f"the tests do not pass without any mutant:\n{done.stdout}{done.stderr}")
        return 2
    killed = 0
    for one, found in run(mutants, given.jobs, given.seconds):
        killed += found
        print(f"{'killed  ' if found else 'SURVIVED'}  {one.file}: {one.old}  ->  {one.new}",
              flush=True)
    print(f"{killed} of {len(mutants)} mutants killed")
    return 0 if killed >= ENOUGH * len(mutants) else 1


if __name__ == "__main__":
    sys.exit(main())
