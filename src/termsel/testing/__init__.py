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

from termsel.testing.cases import Check
from termsel.testing.commands import invoke
from termsel.testing.suites import check, checks
from termsel.testing.trial import global_states
from termsel.testing.writers import example_results

__all__ = ["Check", "check", "checks", "example_results", "global_states", "invoke"]
