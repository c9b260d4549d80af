"""Benchmarks use names of the package that exist: nobody runs all of them at every change."""

from __future__ import annotations

import ast
import importlib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from benchmarks import accuracy, blunders, old_maps
from benchmarks.sets import ROOT

FILES = sorted((ROOT / "benchmarks").rglob("*.py"))


def names_not_found(tree: ast.Module) -> Iterator[str]:
    """Yield what a benchmark imports from the package or its plugins, and what is not there."""
    modules: dict[str, ModuleType] = {}
    for node in ast.walk(tree):
        if not isinstance(node, ast.ImportFrom) or not (node.module or "").startswith("termsel"):
            continue
        assert node.module is not None
        module = importlib.import_module(node.module)
        for alias in node.names:
            try:
                value = getattr(module, alias.name)
            except AttributeError:
                yield f"{node.module}.{alias.name}"
                continue
            if isinstance(value, ModuleType):
                modules[alias.asname or alias.name] = value
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            of = modules.get(node.value.id)
            if of is not None and not hasattr(of, node.attr):
                yield f"{of.__name__}.{node.attr}"


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(ROOT / "benchmarks")))
def test_a_benchmark_uses_names_that_exist(file: Path) -> None:
    tree = ast.parse(file.read_text(encoding="utf-8"))
    assert list(names_not_found(tree)) == []


def test_a_name_that_is_gone_is_found() -> None:
    tree = ast.parse("from termsel.auto import blunders\n"
                     "from termsel.auto.rule import no_such_rule\n"
                     "blunders.NO_SUCH_CONSTANT")
    assert list(names_not_found(tree)) == ["termsel.auto.rule.no_such_rule",
                                           "termsel.auto.blunders.NO_SUCH_CONSTANT"]


def test_constants_whose_influence_is_measured_exist() -> None:
    named = [*accuracy.CONSTANTS, *old_maps.ODDS,
             *((old_maps.field, name) for name in old_maps.CONSTANTS),
             *((module, name) for name, modules in blunders.CONSTANTS.items()
               for module in modules)]
    assert [f"{module.__name__}.{name}" for module, name in named
            if not hasattr(module, name)] == []
