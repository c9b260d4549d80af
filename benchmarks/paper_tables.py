"""Tables of the papers, each by one command, next to the published ones.

``python -m benchmarks.paper_tables NAME --write`` makes the page of a paper in docs/evidence. Names
are valadan-zoej, zakaryaie, akhoundi, yavari and konugurthi; without a name all are made. With
``--runs N`` there are N runs or scenes, with ``--runs published`` those of the paper. Without
``--write`` the pages go to stdout. They require the packages termsel-hybrids and termsel-rpc.

The sentences on a page were written for what its tables showed; read them again with new tables.
"""

from __future__ import annotations

import argparse
import sys
from importlib import import_module
from pathlib import Path

NAMES = {"valadan-zoej": "valadan_zoej", "zakaryaie": "zakaryaie", "akhoundi": "akhoundi",
         "yavari": "yavari", "konugurthi": "konugurthi"}
DOCS = Path(__file__).parents[1] / "docs" / "evidence"


def main() -> None:
    """Print or write the pages."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="papers; by default all")
    parser.add_argument("--runs", help="runs of each setting, or `published`")
    parser.add_argument("--write", action="store_true", help="write the pages in docs/evidence")
    asked = parser.parse_args()
    if unknown := set(asked.names) - set(NAMES):
        parser.error(f"there is no paper {min(unknown)!r}; known are {', '.join(NAMES)}")
    if asked.runs and asked.runs != "published" and not (
            asked.runs.isdecimal() and int(asked.runs)):
        parser.error(f"--runs takes a number or `published`, not {asked.runs!r}")
    for name in asked.names or NAMES:
        module = import_module(f"benchmarks.papers.{NAMES[name]}")
        runs = module.PUBLISHED_RUNS if asked.runs == "published" else (
            int(asked.runs) if asked.runs else module.RUNS)
        text = "\n".join(module.page(runs)).rstrip() + "\n"
        if asked.write:
            (DOCS / f"paper-{name}.md").write_text(text)
        else:
            sys.stdout.write(text)


if __name__ == "__main__":
    main()
