"""What packages of the repository import from termsel: public names alone."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

from tests.lint.violations import Violation

TOOLKIT = "toolkit/*.pyi"
"""Stubs of the modules for packages; that of `termsel` stands above."""

LISTED = ("simulate/__init__", "testing/__init__", "testing/problems", "check")
"""Modules whose names stand in ``__all__``."""


def public_names(package: Path) -> dict[str, set[str]]:
    """Return the public names of the public modules of termsel."""
    names: dict[str, set[str]] = {}
    for stub in sorted([*package.glob("__init__.pyi"), *package.glob(TOOLKIT)]):
        place = stub.relative_to(package.parent).with_suffix("")
        names[".".join(place.parts).removesuffix(".__init__")] = {
            alias.name for node in _parsed(stub).body
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
                                    + "; take a name of termsel, or add it to its toolkit")


def users_of_toolkit(root: Path) -> dict[tuple[str, str], set[str]]:
    """Return which packages import each name of the toolkit, by module and name."""
    public = public_names(root / "src/termsel")
    users: dict[tuple[str, str], set[str]] = {
        (module, name): set() for module, names in public.items()
        if module.startswith("termsel.toolkit") for name in names
        if f"{module}.{name}" not in public}
    for path in sorted((root / "plugins").rglob("*.py")):
        package = path.relative_to(root / "plugins").parts[0]
        for node in ast.walk(_parsed(path)):
            if isinstance(node, ast.ImportFrom):
                for alias in node.names:
                    users.get((str(node.module), alias.name), set()).add(package)
            elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                # Such as `toolkit.plan`, or `charts.save` of an imported module of the toolkit.
                for module in ("termsel.toolkit", f"termsel.toolkit.{node.value.id}"):
                    users.get((module, node.attr), set()).add(package)
    return users


def _parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))
