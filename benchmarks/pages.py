"""Every evidence page by one command: ``python -m benchmarks all [--state] [PAGE ...]``.

Pages are made one after another, each by its own script. made-by.json next to them says for each
which commit made it, by which command, and in how many seconds. A page that the present commit has
made is left alone, so that the command resumes after an interruption. ``--state`` only says so.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks.sets import ROOT

KEPT = "build/evidence/{page}-{commit}.jsonl"
"""Where cases of a page are kept, so that it resumes in its midst."""

PAGES: dict[str, tuple[str, ...]] = {
    "normalisation": ("normalisation",),
    "intervals": ("intervals",),
    "overfitting": ("overfitting",),
    "regret": ("regret",),
    "coordinates": ("coordinates",),
    "paper-valadan-zoej": ("paper_tables", "valadan-zoej"),
    "paper-zakaryaie": ("paper_tables", "zakaryaie"),
    "paper-akhoundi": ("paper_tables", "akhoundi"),
    "paper-yavari": ("paper_tables", "yavari"),
    "paper-konugurthi": ("paper_tables", "konugurthi"),
    "control-features": ("control_features",),
    "solver-table": ("solver_table", "--out", "build/evidence/solver-table-{commit}"),
    "benchmark": ("open_benchmark", "--kept", KEPT),
    "measured": ("measured_benchmark", "--kept", KEPT),
    "short-budgets": ("short_budgets", "--kept", KEPT),
    "best-subsets": ("best_subsets", "--kept", KEPT),
    "flat-control": ("flat_control",),
    "known-cameras": ("known_cameras", "--kept", KEPT),
    "map-series": ("sheet_series", "--kept", KEPT),
    "few-points": ("few_points", "--processes", "2", "--kept", KEPT),
    "plan": ("plan", "--processes", "2"),
    "lines": ("lines", "--processes", "2"),
    "old-maps": ("old_maps", "--processes", "2"),
    "rpc-few-points": ("rpc_few_points", "--workers", "2", "--cases", "40"),
    "oblique": ("oblique", "--processes", "2", "--kept", KEPT),
    "blocks": ("blocks",),
    "hyperspectral": ("hyperspectral",),
    "sentinel-1": ("sentinel", "--whole", "0.2"),
    "matching": ("matching", "--large"),
    "verdicts": ("verdicts", "--jobs", "2", "--kept", KEPT),
    "scanners": ("scanners", "--processes", "2", "--images", "24", "--splits", "6"),
    "uncertainty": ("uncertainty", "--processes", "2", "--kept", KEPT),
    "coverage": ("coverage", "--processes", "2", "--kept", KEPT),
    "blunders": ("blunders", "--processes", "2"),
    "gap-to-optimum": ("gap", "--out", "build/evidence/gap-{commit}", "--workers", "2"),
    "honest-accuracy": ("honest", "accuracy", "--minutes", "45"),
}
"""Script and arguments of each page, the shortest first; each gets ``--write`` as well."""

BY_HAND = ("clients", "paper-tables", "index")
"""Pages that this command does not make: `benchmarks.clients` needs GDAL, OTB, Orthority and QGIS,
without which its page would lose its rows; the others sum up what the pages say."""
STATE = ROOT / "docs" / "evidence" / "made-by.json"

CODE = ("src", "plugins", "benchmarks", ":(exclude)plugins/termsel-bench/results")
"""What pages are made by. The page of the open benchmark writes its results into the last."""


def main(arguments: Sequence[str]) -> None:
    """Make the pages named, or all, that the present commit has not made."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks all",
                                     description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("pages", nargs="*", choices=[*PAGES, []], help="by default all")
    parser.add_argument("--state", action="store_true", help="say which commit made each page")
    asked = parser.parse_args(arguments)
    if asked.state:
        made = read(STATE)
        for page in PAGES:
            by = made.get(page)
            print(f"{page}: " + (f"{by['commit']}, {by['seconds']:.0f} s" if by else
                                 "not made by this command yet"))
        return
    make(asked.pages or list(PAGES), commit(), STATE, run)


def make(pages: Sequence[str], at: str, state: Path, runs: Callable[[list[str]], None]) -> None:
    """Make pages that no entry of the state says to be of this commit; keep each as it ends."""
    for page in pages:
        made = read(state)
        if made.get(page, {}).get("commit") == at:
            print(f"{page}: made by {at} already")
            continue
        arguments = [one.format(page=page, commit=at) for one in PAGES[page][1:]]
        command = ["python", "-m", f"benchmarks.{PAGES[page][0]}", *arguments, "--write"]
        start = time.monotonic()
        runs(command)
        made[page] = {"commit": at, "command": " ".join(command),
                      "seconds": round(time.monotonic() - start)}
        new = state.with_suffix(".new")
        new.write_text(json.dumps(made, indent=1, sort_keys=True) + "\n", encoding="utf-8")
        new.replace(state)
        print(f"{page}: made by {at}")


def read(state: Path) -> dict[str, dict[str, str | float]]:
    """Return what the state says of each page; nothing where there is none."""
    if not state.is_file():
        return {}
    found: dict[str, dict[str, str | float]] = json.loads(state.read_text(encoding="utf-8"))
    return found


def commit() -> str:
    """Return the present commit; refuse changes to the code, of which no commit could tell."""
    def git(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=ROOT, check=True, capture_output=True,
                              text=True).stdout.strip()

    if git("status", "--porcelain", "--", *CODE):
        sys.exit("src, plugins or benchmarks have changes: commit them first, so that the pages "
                 "can say what made them")
    # That of the code: pages themselves are committed after it.
    return git("log", "-1", "--format=%h", "--", *CODE)


def run(command: list[str]) -> None:
    """Run a script; end with its code where it fails."""
    done = subprocess.run([sys.executable, *command[1:]], cwd=ROOT, check=False)
    if done.returncode:
        sys.exit(done.returncode)
