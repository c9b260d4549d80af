"""Conformance suites: what each kind of thing that a plugin provides must do.

termsel's own pass the same checks. In the test of a plugin, either all at once::

    from termsel.testing import check

    def test_model():
        check(DLT)

or each check as a separate test::

    import pytest
    from termsel.testing import checks

    @pytest.mark.parametrize("check", checks(DLT), ids=lambda check: check.name)
    def test_model(check):
        check.run()

Both recognise what they are given: a model, solver, criterion, objective, candidate, problem, data
set, reader, writer or command. Given the name of a package, they check the installed plugin,
whatever it provides.

`invoke` runs a command line, and `termsel.testing.problems` has small problems for searches.

Name a check that must fail, with the reason: ``expected_failures={"control_kinds": "requires
points"}``. It then fails if it passes, so that the list stays correct. pytest is not required.
A check that takes more than two minutes with one object fails.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

from termsel.testing.cases import Check
from termsel.testing.commands import invoke
from termsel.testing.suites import check, checks
from termsel.testing.trial import global_states
from termsel.testing.writers import example_results

__all__ = ["Check", "check", "checks", "example_results", "global_states", "invoke"]

_POSITIONAL: dict[str, tuple[str, ...]] = {
    "model": (), "solver": (), "criterion": (), "problem": (), "dataset": (), "plugin": (),
    "writer": (), "reader": ("content", "expected"), "command": ("words",)}
"""What the suites of 0.2 took by position after the thing itself."""


def __getattr__(name: str) -> Callable[..., Any]:
    """Return `check` or `checks` by their names of 0.2, such as `check_model`, until 0.4."""
    kind = name.removeprefix("check_").removesuffix("_checks")
    if kind == name or kind not in _POSITIONAL:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    one = check if name.startswith("check_") else checks
    warnings.warn(f"termsel.testing.{name} is called {one.__name__} now, for all kinds of things; "
                  "termsel 0.4 will not have the old name", DeprecationWarning, stacklevel=2)

    def renamed(thing: Any, *args: Any, **about: Any) -> Any:
        return one(thing, **dict(zip(_POSITIONAL[kind], args, strict=True)), **about)

    return renamed
