"""What a short command costs, warm and at first, and what its processor time goes to.

    python -m benchmarks.startup                    the table
    python -m benchmarks.startup --profile COMMAND  imports of one: run --problem rfm-terms

Seconds are of the processor, of processes of their own; warm is the least of some runs. The ratio
is to a process that imports NumPy, scipy.linalg and numba alone: it depends little on the machine
and on what else runs there. Modules are kept compiled, as pip leaves them. POINTS is a table of 50.
"""

from __future__ import annotations

import os
import re
import resource
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

import termsel

COMMANDS = ("--help", "list models", "run --problem rfm-terms", "run --problem owdis-lines",
            "run --points POINTS --crs EPSG:4979",
            "run --problem rfm-terms --strategy as-asked --generations 2",
            "run --problem poly-terms --strategy as-asked --solver exact --set degree=3",
            "run --problem poly-terms --strategy as-asked --solver exact --criterion ebic "
            "--set degree=3")
FLOOR = ("-c", "import numpy, scipy.linalg, numba")


def seconds(words: tuple[str, ...], cache: Path) -> float:
    """Return the time of the processor [s] that a Python process takes."""
    known = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *words], check=True, stdout=subprocess.DEVNULL,
                   stderr=subprocess.DEVNULL, env={**known, "NUMBA_CACHE_DIR": str(cache)})
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def table(repeats: int = 3) -> None:
    """Print a row per command: the first run with nothing compiled, and warm ones."""
    print(f"{'termsel':<60} {'first [s]':>9} {'warm [s]':>9} {'ratio':>6}")
    for command in COMMANDS:
        with tempfile.TemporaryDirectory() as folder:
            points, cache = Path(folder, "points.csv"), Path(folder, "cache")
            termsel.write_points_csv(termsel.simulate_scene(
                "ikonos-hamedan", roles=(50, 0, 0), n_lines=0).points, points)
            words = ("-m", "termsel", *command.replace("POINTS", str(points)).split())
            first, *warm = (seconds(words, cache) for _ in range(1 + repeats))
            floor = min(seconds(FLOOR, cache) for _ in range(repeats))
        print(f"{command[:60]:<60} {first:9.2f} {min(warm):9.2f} {min(warm) / floor:6.2f}")


def profile(words: list[str]) -> None:
    """Print how long the modules of each package take to import."""
    done = subprocess.run([sys.executable, "-X", "importtime", "-m", "termsel", *words],
                          check=True, text=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    taken: Counter[str] = Counter()
    modules: Counter[str] = Counter()
    for own, package in re.findall(r"^import time:\s+(\d+) \|\s+\d+ \|\s+(\w+)", done.stderr,
                                   re.MULTILINE):
        taken[package] += int(own)
        modules[package] += 1
    for package, micro in taken.most_common(20):
        print(f"{package:<24} {modules[package]:4} modules {micro / 1e6:7.3f} s")


if __name__ == "__main__":
    profile(sys.argv[2:]) if "--profile" in sys.argv[1:2] else table()
