"""The structure of the code: the order of the rooms, no circles, small files."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from termsel.rooms import ROOMS

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src/termsel"
ORDER = list(ROOMS)


def _name(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts).removesuffix(".__init__")


MODULES = {_name(path): path for path in sorted(PACKAGE.rglob("*.py"))}


def _imports(module: str) -> Iterator[str]:
    """Yield every module of termsel that a module imports, wherever in it."""
    for node in ast.walk(ast.parse(MODULES[module].read_text())):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{module} imports by dots: write the whole name"
            # "from termsel.a import b" names the module a.b, or something in a.
            inner = [f"{node.module}.{alias.name}" for alias in node.names]
            names = [name if name in MODULES else str(node.module) for name in inner]
        else:
            continue
        yield from {name for name in names if name in MODULES and name != module}


def _room(module: str) -> str:
    return module.split(".")[1] if "." in module else "termsel"


def test_every_room_is_in_the_list_and_every_listed_room_exists() -> None:
    assert {_room(module) for module in MODULES} - {"termsel"} == set(ORDER)


@pytest.mark.parametrize("module", [name for name in MODULES if name != "termsel"])
def test_no_import_runs_upwards(module: str) -> None:
    mine = ORDER.index(_room(module))
    above = sorted(name for name in _imports(module)
                   if name == "termsel" or ORDER.index(_room(name)) < mine)
    assert above == [], f"{module} imports from a room above it"


def test_no_modules_import_each_other_in_a_circle() -> None:
    graph = {module: set(_imports(module)) for module in MODULES if module != "termsel"}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(f"a circle: {' -> '.join(error.args[1])}")


def test_few_small_modules_stand_at_the_top() -> None:
    top = [path.stem for path in PACKAGE.glob("*.py") if not path.stem.startswith("__")]
    assert len(top) <= 6, top
    assert not [path for path in PACKAGE.iterdir() if path.suffix not in ("", ".py", ".typed")]


@pytest.mark.parametrize("path", MODULES.values(), ids=MODULES)
def test_no_file_is_long(path: Path) -> None:
    assert len(path.read_text().splitlines()) <= 400


def test_contributing_shows_the_same_list() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text()
    shown = re.findall(r"^\| `(\w+)` \| (.+) \|$", text, re.MULTILINE)
    assert shown == list(ROOMS.items())
