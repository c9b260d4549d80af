"""No hidden cache: what a module keeps between calls says beside it why, and for how long.

A value is kept by its arguments alone, so that nobody has to empty a cache to get another answer.
What is found of data for several runs is held by an object that is passed (`termsel.Memory`).
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

from tests.lint.violations import Violation, code_files

CACHES = ("cache", "lru_cache")
"""Decorators that keep values for as long as the module lives, or until others push them out."""


def _is_cache(decorator: ast.expr) -> bool:
    called = decorator.func if isinstance(decorator, ast.Call) else decorator
    return isinstance(called, ast.Name) and called.id in CACHES


def _cached_functions(tree: ast.Module) -> Iterator[ast.expr]:
    """Yield the decorators of functions and methods that outlive a call."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef):
            for function in node.body:
                if isinstance(function, ast.FunctionDef):
                    yield from filter(_is_cache, function.decorator_list)


def _weak_dictionaries(tree: ast.Module) -> Iterator[tuple[int, bool]]:
    """Yield the line of each dictionary of living objects, and whether a docstring follows it."""
    following_statements = [*tree.body[1:], None]
    for statement, following in zip(tree.body, following_statements, strict=False):
        if isinstance(statement, ast.AnnAssign) and statement.value is not None \
                and ast.unparse(statement.value).startswith("WeakKeyDictionary("):
            is_documented = isinstance(following, ast.Expr) \
                and isinstance(following.value, ast.Constant)
            yield statement.lineno, is_documented


def violations(root: Path) -> Iterator[Violation]:
    """Yield each cache of a module without its reason."""
    for path in code_files(root):
        # A benchmark ends with its process.
        if path.relative_to(root).parts[0] == "benchmarks":
            continue
        text = path.read_text(encoding="utf-8")
        tree = ast.parse(text)
        lines = text.splitlines()
        for decorator in _cached_functions(tree):
            if "#" not in lines[decorator.lineno - 1]:
                yield Violation(path, decorator.lineno, "a cache without a reason: say in a "
                                "comment on this line why, or hold it by an object")
        for line, is_documented in _weak_dictionaries(tree):
            if not is_documented:
                yield Violation(path, line, "values kept without a docstring below that says "
                                "for how long")
