"""What a rule reports, and the files that the rules read."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple


class Violation(NamedTuple):
    """A place that breaks a rule.

    Parameters
    ----------
    path : Path
        Below the root of the repository.
    line : int
        From 1.
    message : str
        What is wrong there.
    """

    path: Path
    line: int
    message: str


def code_files(root: Path) -> list[Path]:
    """Return the modules of the package, the plugins and the benchmarks, without tests."""
    return sorted(path for folder in ("src", "plugins", "benchmarks")
                  for path in (root / folder).rglob("*.py")
                  if "tests" not in path.relative_to(root).parts)


def pages(root: Path) -> Iterator[Path]:
    """Yield the pages that users and contributors read, without built ones."""
    for path in sorted([*root.glob("*.md"), *(root / "docs").rglob("*.md"),
                        *(root / "plugins").rglob("*.md")]):
        if "_build" not in path.relative_to(root).parts:
            yield path


SHOWN = ("*.html", "*.js", "*.ipynb", "*.svg", "*.cff", "metadata.txt")
"""Files next to modules and pages whose words people read: in a browser, a chart or QGIS."""


def shown_files(root: Path) -> Iterator[Path]:
    """Yield the files with words for a browser, a chart or QGIS, without tests and built ones."""
    yield from sorted(root.glob("*.cff"))
    for folder in ("src", "plugins", "docs", "paper"):
        for pattern in SHOWN:
            for path in sorted((root / folder).rglob(pattern)):
                if not {"tests", "_build", "vendor"} & {*path.relative_to(root).parts}:
                    yield path


def line_at(text: str, position: int) -> int:
    """Return the number of the line that holds a position of a text."""
    return text.count("\n", 0, position) + 1
