"""The list of slow tests names tests that are there."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from tests.lint.violations import Violation


def violations(root: Path) -> Iterator[Violation]:
    """Yield each entry of tests/slow.txt whose test is not in its file, or out of order."""
    listed = root / "tests" / "slow.txt"
    entries = listed.read_text(encoding="utf-8").splitlines()
    for number, (entry, before) in enumerate(zip(entries, ["", *entries], strict=False), start=1):
        file, _, name = entry.partition("[")[0].partition("::")
        if name not in _tests(root / file):
            yield Violation(listed, number, f"there is no test {name} in {file}")
        if entry <= before:
            yield Violation(listed, number, "entries are in alphabetical order, each once")


@cache
def _tests(path: Path) -> frozenset[str]:
    """Return the names of the functions of a file; none if there is no such file."""
    if not path.is_file():
        return frozenset()
    return frozenset(node.name for node in ast.parse(path.read_text(encoding="utf-8")).body
                     if isinstance(node, ast.FunctionDef))
