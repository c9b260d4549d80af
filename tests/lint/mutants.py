"""The list of mutants fits the code and the tests there are; tests/mutants.py runs them."""

from __future__ import annotations

import re
import runpy
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from tests.lint.violations import Violation
from tests.mutants import Mutant, listed

WITHOUT = {"version", "rooms"}
"""Rooms without logic of their own."""


@cache
def _read(path: Path) -> str:
    return path.read_text(encoding="utf-8") if path.is_file() else ""


def _fault(mutant: Mutant, root: Path) -> str | None:
    """Return why a mutant cannot be run, if so."""
    try:
        mutant.applied(_read(root / mutant.file))
    except ValueError as error:
        return str(error)
    for test in mutant.tests:
        file, _, name = test.partition("::")
        pattern = rf"^def {name.partition('[')[0]}\b" if name else "^def test_"
        if not re.search(pattern, _read(root / file), re.MULTILINE):
            return f"there is no test {test}"
    return None


def violations(root: Path) -> Iterator[Violation]:
    """Yield the mutants that cannot be run, and the rooms and plugins without any."""
    path = root / "tests/mutants.toml"
    lines = [number for number, line in enumerate(_read(path).splitlines(), 1)
             if line == "[[mutant]]"]
    mutants = listed(root)
    times = Counter((one.file, one.old, one.new) for one in mutants)
    for line, one in zip(lines, mutants, strict=True):
        if times[one.file, one.old, one.new] > 1:
            yield Violation(path, line, f"{one.file}: {one.new!r} is listed twice")
        if fault := _fault(one, root):
            yield Violation(path, line, fault)
    places = {Path(one.file).parts[:3] for one in mutants}
    rooms = runpy.run_path(str(root / "src/termsel/rooms.py"))["ROOMS"]
    for room in rooms:
        if room not in WITHOUT and not places & {("src", "termsel", room),
                                                 ("src", "termsel", f"{room}.py")}:
            yield Violation(path, 1, f"the room {room!r} has no mutant")
    for package in {source.parts[-4] for source in root.glob("plugins/*/src/*/__init__.py")}:
        if not any(parts[:2] == ("plugins", package) for parts in places):
            yield Violation(path, 1, f"the plugin {package!r} has no mutant")
