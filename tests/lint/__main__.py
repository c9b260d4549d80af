"""Print each place that breaks a rule of the project: ``python -m tests.lint``.

It ends with code 1 if there is any. The rules: words (`words`), the order of the rooms (`house`),
what packages import (`public`), what modules keep (`caches`) and how plainly code is written
(`figures`). What ruff can hold is in pyproject.toml instead.
"""

from __future__ import annotations

import sys
from pathlib import Path

from tests.lint import caches, figures, house, public, words

ROOT = Path(__file__).parents[2]


def main(root: Path = ROOT) -> int:
    """Print the violations below a root, and return the exit code."""
    found = [violation for rules in (words, house, public, caches, figures)
             for violation in rules.violations(root)]
    for path, line, message in found:
        print(f"{path.relative_to(root).as_posix()}:{line}: {message}")
    print(f"{len(found)} violations" if found else "words and rooms are in order")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
