"""Public modules whose names are imported when first used: their stubs say from where."""

from __future__ import annotations

import ast
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lazy_loader

from termsel.core.arguments import missing_name_message


def lazily(file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` of a module with a stub next to it.

    Parameters
    ----------
    file : str
        The module's ``__file__``. Its stub imports every name from where it is defined.
    """
    # Type checkers and this function read the same stub, so that a name has one place.
    names: dict[str, list[str]] = {}
    for node in ast.parse(Path(file).with_suffix(".pyi").read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom):
            module = str(node.module).removeprefix("termsel.")
            names.setdefault(module, []).extend(alias.name for alias in node.names)
    imported, listed, public = lazy_loader.attach("termsel", submod_attrs=names)

    def attribute(name: str) -> Any:
        """Return a public name, imported when it is first used.

        Raises AttributeError, with what may be meant, for a name that is not public.
        """
        if name in public or name.startswith("_"):
            return imported(name)
        module = ".".join(Path(file).with_suffix("").parts[-3:]).removesuffix(".__init__")
        raise AttributeError(missing_name_message(module, name, public), name=name)

    return attribute, listed, public
