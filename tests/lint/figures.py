"""How plainly code is written, in figures: names, nesting, comments, constants of one name.

The figures are averages over the package and over the plugins, so that a single place may differ
where it reads better. Trees of fewer than `SMALLEST` lines of code are not judged.
"""

from __future__ import annotations

import ast
import io
import tokenize
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from tests.lint.violations import Violation, code_files

ROOTS = ("src/termsel", "plugins")

SMALLEST = 1000
"""Lines of code from which on a tree is judged."""

_WORDS = (
    "one ones found given some other others own every each there here mine kept left said asked "
    "told taken seen known wanted more less rest made now out back word what where which whole "
    "both gone good bad few many place places thing things again plain held called shown needed "
    "looked tried met spent judged chosen alone along beyond within apart together side sides "
    "piece pieces part parts so much most least enough like alike same still yet ever it them "
    "that this those these")
VAGUE = frozenset(_WORDS.split())
"""Words that do not say what a variable holds."""

MOST = {
    "vague names, by 100 names": 2.0,
    "tuples unpacked to tuples, by 1,000 lines": 4.0,
    "nested comprehensions, by 1,000 lines": 1.2,
    "calls with seven positional arguments, by 1,000 lines": 1.0,
    "texts times a truth value": 0.0,
}
"""The largest values of the figures."""

LEAST_COMMENTS = 5.8
"""Least comments by 100 lines of code."""

MOST_SHARED = {"src/termsel": 8, "plugins": 20}
"""Most names of constants that three modules or more have."""

_COMPREHENSIONS = (ast.ListComp, ast.GeneratorExp, ast.SetComp, ast.DictComp)


@dataclass
class Figures:
    """What is counted in a tree of modules."""

    code: int = 0
    comments: int = 0
    names: int = 0
    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(MOST, 0))
    modules_of_constant: dict[str, set[Path]] = field(default_factory=lambda: defaultdict(set))

    def count(self, path: Path) -> None:
        """Count what a module has."""
        text = path.read_text(encoding="utf-8")
        tree = ast.parse(text)
        self._count_lines(text, tree)
        for node in ast.walk(tree):
            self._count_node(node)
        for statement in tree.body:
            for target in _targets(statement):
                for name in ast.walk(target):
                    if isinstance(name, ast.Name) and name.id.isupper() and len(name.id) > 2:
                        self.modules_of_constant[name.id].add(path)

    def _count_lines(self, text: str, tree: ast.Module) -> None:
        lines = text.splitlines()
        # Docstrings are neither code nor comments.
        no_code: set[int] = set()
        for node in ast.walk(tree):
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) \
                    and isinstance(node.value.value, str):
                no_code.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
        # A comment after code is part of its line.
        comments = {token.start[0] for token in tokenize.generate_tokens(io.StringIO(text).readline)
                    if token.type == tokenize.COMMENT
                    and lines[token.start[0] - 1].lstrip().startswith("#")}
        no_code |= comments
        self.comments += len(comments)
        self.code += sum(1 for number, line in enumerate(lines, 1)
                         if line.strip() and number not in no_code)

    def _count_node(self, node: ast.AST) -> None:
        vague, packed, nested, positional, times_truth = MOST
        if isinstance(node, ast.arg) or (
                isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)):
            name = node.arg if isinstance(node, ast.arg) else node.id
            self.names += 1
            self.counts[vague] += name.strip("_") in VAGUE
        self.counts[packed] += _packs(node)
        self.counts[nested] += _nests(node)
        self.counts[positional] += isinstance(node, ast.Call) and len(node.args) >= 7
        self.counts[times_truth] += _multiplies_text(node)

    def values(self) -> Iterator[tuple[str, float]]:
        """Yield the figures of `MOST`, by what they are relative to."""
        bases = [self.names / 100, *[self.code / 1000] * 3, 1.0]
        for (name, count), base in zip(self.counts.items(), bases, strict=True):
            yield name, count / base


def _targets(statement: ast.stmt) -> list[ast.expr]:
    if isinstance(statement, ast.Assign):
        return statement.targets
    return [statement.target] if isinstance(statement, ast.AnnAssign) else []


def _packs(node: ast.AST) -> bool:
    """Return whether several values are assigned at once, other than constants."""
    return isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Tuple) \
        and isinstance(node.value, ast.Tuple) and len(node.value.elts) > 1 \
        and not all(isinstance(element, ast.Constant) for element in node.value.elts)


def _nests(node: ast.AST) -> bool:
    """Return whether a comprehension has several loops, or another one in it."""
    if not isinstance(node, _COMPREHENSIONS):
        return False
    return len(node.generators) > 1 or any(
        isinstance(inner, _COMPREHENSIONS) for inner in ast.walk(node) if inner is not node)


def _multiplies_text(node: ast.AST) -> bool:
    """Return whether a text is multiplied by a condition, to be there or not."""
    if not (isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult)):
        return False
    sides = (node.left, node.right)
    has_text = any(isinstance(side, ast.List | ast.JoinedStr) or (
        isinstance(side, ast.Constant) and isinstance(side.value, str)) for side in sides)
    has_truth = any(isinstance(side, ast.Compare | ast.BoolOp | ast.UnaryOp) or (
        isinstance(side, ast.Call) and getattr(side.func, "id", "") == "bool") for side in sides)
    return has_text and has_truth


def figures_of(root: Path, tree: str) -> Figures:
    """Return the figures of the modules below a folder of a repository, without tests."""
    figures = Figures()
    for path in code_files(root):
        if path.is_relative_to(root / tree):
            figures.count(path)
    return figures


def violations(root: Path) -> Iterator[Violation]:
    """Yield each figure that is beyond its limit."""
    for tree in ROOTS:
        figures = figures_of(root, tree)
        if figures.code < SMALLEST:
            continue
        for name, value in figures.values():
            if value > MOST[name]:
                yield Violation(root / tree, 1, f"{name}: {value:.1f}, at most {MOST[name]:g}")
        comments = 100 * figures.comments / figures.code
        if comments < LEAST_COMMENTS:
            yield Violation(root / tree, 1, f"{comments:.1f} comments by 100 lines of code, at "
                                            f"least {LEAST_COMMENTS:g}: say reasons and equations")
        shared = sorted(name for name, paths in figures.modules_of_constant.items()
                        if len(paths) > 2)
        if len(shared) > MOST_SHARED[tree]:
            yield Violation(root / tree, 1, f"{len(shared)} constants have one name in three "
                                            f"modules or more: {', '.join(shared)}")
