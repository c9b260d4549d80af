"""Run many cases: ``python -m tests.fuzz --cases 50000``; exit code 1 if one is at fault."""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from ast import literal_eval
from collections import Counter
from pathlib import Path

from tests.fuzz.cases import SECONDS, Outcome, run_case, unseen

_CHUNK = 2500  # cases of a process, which a crash of a library would end
_SHORT = 500
"""Cases of a process where time is limited."""
_START = 120.0  # s to import and to make the files


def _work(first: int, count: int) -> int:
    """Run cases in this process, with a line for each on stdout."""
    stdout = sys.stdout
    unseen()
    for seed in range(first, first + count):
        print("start", seed, file=stdout, flush=True)
        outcome = run_case(seed)
        print("done", seed, outcome.code, f"{outcome.seconds:.3f}", outcome.name,
              repr(outcome.fault), file=stdout, flush=True)
    return 0


def _chunk(first: int, count: int) -> list[Outcome]:
    """Return the outcomes of cases that run in a process of their own."""
    found: list[Outcome] = []
    while count > 0:
        start, waiting = time.perf_counter(), None
        words = [sys.executable, "-m", "tests.fuzz", "--work", str(first), str(count)]
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True,
                              cwd=Path(__file__).parents[2]) as process:
            try:
                out, _ = process.communicate(timeout=_START + SECONDS * 4 + count)
            except subprocess.TimeoutExpired:
                process.kill()
                out, _ = process.communicate()
        for line in out.splitlines():
            word, *rest = line.split(" ", 5)
            if word == "start":
                waiting = int(rest[0])
            elif word == "done":
                waiting = None
                found.append(Outcome(int(rest[0]), rest[3], int(rest[1]), literal_eval(rest[4]),
                                     float(rest[2])))
        done = len(found)
        if waiting is not None:
            found.append(Outcome(waiting, "?", 1, f"ended the process ({process.returncode})",
                                 time.perf_counter() - start))
        elif done == 0 or process.returncode:
            raise SystemExit(f"the worker does not start: exit code {process.returncode}")
        last = found[-1].seed + 1
        count, first = first + count - last, last
    return found


def main() -> int:
    """Run the cases and print what was found."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--cases", type=int, default=1000, help="how many cases to run")
    parser.add_argument("--seconds", type=float, default=float("inf"),
                        help="begin no further cases after this time")
    parser.add_argument("--first", type=int, default=0, help="the number of the first case")
    parser.add_argument("--work", type=int, nargs=2, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.work:
        return _work(*given.work)
    start, found = time.perf_counter(), []
    size = _CHUNK if given.seconds == float("inf") else _SHORT
    for first in range(given.first, given.first + given.cases, size):
        if time.perf_counter() - start > given.seconds:
            break
        count = min(size, given.first + given.cases - first)
        for outcome in _chunk(first, count):
            found.append(outcome)
            if outcome.fault:
                print(f"case {outcome.seed}, {outcome.name}: {outcome.fault}", flush=True)
        print(f"{len(found)} cases, {time.perf_counter() - start:.0f} s", file=sys.stderr,
              flush=True)
    kinds = Counter(outcome.name.partition(":")[0] for outcome in found)
    print(", ".join(f"{kind} {count}" for kind, count in sorted(kinds.items())))
    codes = Counter(outcome.code for outcome in found)
    slowest = max(found, key=lambda outcome: outcome.seconds)
    faults = sum(bool(outcome.fault) for outcome in found)
    print(f"{len(found)} cases in {time.perf_counter() - start:.0f} s: {codes[0]} with exit code "
          f"0, {codes[2]} with 2; {faults} at fault; slowest {slowest.seconds:.2f} s (case "
          f"{slowest.seed}, {slowest.name})")
    return int(faults > 0)


if __name__ == "__main__":
    sys.exit(main())
