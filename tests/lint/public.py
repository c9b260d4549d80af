"""What packages of the repository import from termsel: public names alone."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

from tests.lint.violations import Violation

STUBS = {"termsel": "__init__.pyi", "termsel.toolkit": "toolkit.pyi"}
"""Modules whose names stand in a stub."""

LISTED = ("simulate/__init__", "testing/__init__", "testing/problems", "check/__init__")
"""Modules whose names stand in ``__all__``."""


def public_names(package: Path) -> dict[str, set[str]]:
    """Return the public names of the public modules of termsel."""
    names: dict[str, set[str]] = {}
    for module, stub in STUBS.items():
        if (package / stub).exists():
            names[module] = {alias.name for node in _parsed(package / stub).body
                             if isinstance(node, ast.ImportFrom) for alias in node.names}
    for module in LISTED:
        path = package / f"{module}.py"
        name = f"termsel.{module.removesuffix('/__init__').replace('/', '.')}"
        for node in _parsed(path).body if path.exists() else ():
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
                names[name] = set(ast.literal_eval(node.value))
    for module in [name for name in names if "." in name]:
        above, _, name = module.rpartition(".")
        names.setdefault(above, set()).add(name)
    return names


def violations(root: Path) -> Iterator[Violation]:
    """Yield each import of a plugin or its tests of what is not public."""
    public = public_names(root / "src/termsel")
    for path in sorted((root / "plugins").rglob("*.py")):
        for node in ast.walk(_parsed(path)):
            if isinstance(node, ast.Import):
                wanted = [(alias.name, "") for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and not node.level:
                wanted = [(str(node.module), alias.name) for alias in node.names]
            else:
                continue
            for module, name in wanted:
                if module.partition(".")[0] == "termsel" and (
                        module not in public or (name and name not in public[module])):
                    yield Violation(path, node.lineno, f"not public: {module} {name}".rstrip()
                                    + "; take a name of termsel, or add it to termsel.toolkit")


def _parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))
