"""What very many points cost: the run, its page and an export.

    python -m benchmarks.many_points [--counts 1000 10000 100000]

Seconds are of the processor, of processes of their own, with all kernels compiled before; memory is
the most that each held. The page is that of ``termsel report``, the export is ``rpc-txt``.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import termsel

PARTS = (("run", ("run", "--points", "points.csv", "--crs", "EPSG:4979", "--out", "result")),
         ("page", ("report", "result")),
         ("export", ("export", "result", "--to", "rpc-txt", "--output", "scene_RPC.TXT")))


def spent(words: tuple[str, ...], folder: Path) -> tuple[float, float]:
    """Return the time of the processor [s] and the most memory [GB] of a command."""
    # As an installed termsel: modules are compiled once, not in each process.
    environment = {name: value for name, value in os.environ.items()
                   if name != "PYTHONDONTWRITEBYTECODE"}
    process = subprocess.Popen([sys.executable, "-m", "termsel", *words], cwd=folder,
                               stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                               env=environment)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, words)
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1e6


def main() -> None:
    """Print a row for each number of points."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--counts", type=int, nargs="+", default=[50, 1000, 10_000, 100_000])
    asked = parser.parse_args()
    print(f"{'points':>8}" + "".join(f"{name + ' [s]':>12}{'[GB]':>7}" for name, _ in PARTS)
          + f"{'page [MB]':>11}")
    for count in asked.counts:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            termsel.write_points_csv(termsel.simulate_scene(
                "ikonos-hamedan", roles=(count, 0, 0), n_lines=0).points, folder / "points.csv")
            row = "".join("{:12.1f}{:7.2f}".format(*spent(words, folder)) for _, words in PARTS)
            size = (folder / "result" / "report.html").stat().st_size / 1e6
            print(f"{count:8}{row}{size:11.1f}", flush=True)


if __name__ == "__main__":
    main()
