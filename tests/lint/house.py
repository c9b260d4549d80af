"""The structure of the code: the order of the rooms, no circles, nothing loose at the top."""

from __future__ import annotations

import ast
import re
import runpy
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import NamedTuple

from tests.lint.violations import Violation, line_at

TOP = 7
"""Most modules that stand next to the rooms that are folders."""


class Import(NamedTuple):
    """An import of one module of termsel by another."""

    module: str
    line: int
    imported: str


def _modules(package: Path) -> dict[str, Path]:
    """Return the modules of a package by their full names."""
    return {".".join(path.relative_to(package.parent).with_suffix("").parts)
            .removesuffix(".__init__"): path for path in sorted(package.rglob("*.py"))}


def _imports(modules: dict[str, Path]) -> Iterator[Import]:
    """Yield every import of one listed module by another, wherever in it."""
    for module, path in modules.items():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and not node.level:
                # "from termsel.a import b" names the module a.b, or something in a.
                inner = [f"{node.module}.{alias.name}" for alias in node.names]
                names = [name if name in modules else str(node.module) for name in inner]
            elif isinstance(node, ast.ImportFrom):
                yield Import(module, node.lineno, "." * node.level)
                continue
            else:
                continue
            for name in {name for name in names if name in modules and name != module}:
                yield Import(module, node.lineno, name)


def _room(module: str) -> str:
    return module.split(".")[1] if "." in module else "termsel"


def violations(root: Path) -> Iterator[Violation]:
    """Yield what breaks the order of the rooms below a root, and what is no room."""
    package = root / "src/termsel"
    listed = package / "rooms.py"
    # Of this checkout, whichever termsel is installed.
    rooms: dict[str, str] = runpy.run_path(str(listed))["ROOMS"]
    order = ["termsel", *rooms]  # the package itself imports from every room, and no room from it
    modules = _modules(package)
    there = {_room(module) for module in modules}
    for room in sorted(there.symmetric_difference(order)):
        what = "is not listed in ROOMS" if room in there else "is listed and does not exist"
        yield Violation(listed, 1, f"the room {room!r} {what}")
    imports = list(_imports(modules))
    for module, line, imported in imports:
        if imported.startswith("."):
            yield Violation(modules[module], line, "an import by dots: write the whole name")
        elif {_room(module), _room(imported)} <= set(order) and \
                order.index(_room(imported)) < order.index(_room(module)):
            yield Violation(modules[module], line, f"imports from a room above it: {imported}")
    yield from _circle(modules, imports)
    yield from _top(package)
    page = root / "CONTRIBUTING.md"
    text = page.read_text(encoding="utf-8")
    shown = re.findall(r"^\| `(\w+)` \| (.+) \|$", text, re.MULTILINE)
    if shown != list(rooms.items()):
        yield Violation(page, line_at(text, max(text.find("| room"), 0)),
                        "the table of rooms is not the list of src/termsel/rooms.py")


def _circle(modules: dict[str, Path], imports: list[Import]) -> Iterator[Violation]:
    graph: dict[str, set[str]] = {}
    for module, _, imported in imports:
        if module != "termsel":
            graph.setdefault(module, set()).add(imported)
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        circle: list[str] = error.args[1]
        # The sorter names each module after one that it imports.
        line = next(one.line for one in imports
                    if (one.module, one.imported) == (circle[1], circle[0]))
        yield Violation(modules[circle[1]], line, f"a circle: {' <- '.join(circle)}")


def _top(package: Path) -> Iterator[Violation]:
    """Yield what stands next to the rooms and is none."""
    top = [path for path in package.glob("*.py") if not path.stem.startswith("__")]
    if len(top) > TOP:
        yield Violation(package, 1, f"{len(top)} modules at the top, more than {TOP}")
    for path in package.iterdir():
        if path.suffix not in ("", ".py", ".pyi", ".typed"):
            yield Violation(path, 1, "no module stands here")
