"""All figures on what auto is worth on real and simulated data, each page from its own script.

``python -m benchmarks.honest`` runs the scripts below on two cores, each with as many splits as fit
in its share of ``--minutes``, and prints what is required next to what was measured. With
``--write`` they also renew their pages in docs/evidence.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time

PARTS = {"accuracy": ("--splits", 0.25), "blunders": ("--splits", 0.25),
         "coverage": ("--splits", 0.2), "old_maps": ("--splits", 0.1), "lines": ("--draws", 0.15),
         "plan": ("--splits", 0.05)}
"""By script, the option for the number of splits, and the share of the time."""

MOST = 20
"""Splits after which no more are made."""


def run(part: str, splits: int, processes: int, *, write: bool) -> str:
    """Run the script of a part and return what it prints."""
    option, _ = PARTS[part]
    done = subprocess.run(
        [sys.executable, "-m", f"benchmarks.{part}", option, str(splits), "--processes",
         str(processes), *["--write"] * write], stdout=subprocess.PIPE, text=True, check=True)
    return done.stdout


def requirements(page: str) -> str:
    """Return the table of a page that has the column "required"."""
    lines = page.splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith("|") and "required" in line)
    length = next((i for i, line in enumerate(lines[start:]) if not line.startswith("|")), None)
    return "\n".join(lines[start:None if length is None else start + length])


def main() -> None:
    """Run all parts."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], help="by default all")
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--write", action="store_true", help="renew the pages in docs/evidence")
    asked = parser.parse_args()
    for part in asked.parts or PARTS:
        start = time.perf_counter()
        page = run(part, 1, asked.processes, write=False)
        one = time.perf_counter() - start
        splits = min(MOST, int(60 * asked.minutes * PARTS[part][1] / one))
        if splits > 1 or asked.write:
            page = run(part, max(splits, 1), asked.processes, write=asked.write)
        sys.stdout.write(f"{part}, {max(splits, 1)} splits, "
                         f"{time.perf_counter() - start:.0f} s\n\n{requirements(page)}\n\n")


if __name__ == "__main__":
    main()
