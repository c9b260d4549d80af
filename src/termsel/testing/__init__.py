"""Conformance suites: what each kind of thing that a plugin provides must do.

termsel's own pass the same checks. In the test of a plugin, either all at once::

    from termsel.testing import check_model

    def test_model():
        check_model(DLT)

or each check as a separate test::

    import pytest
    from termsel.testing import model_checks

    @pytest.mark.parametrize("check", model_checks(DLT), ids=lambda check: check.name)
    def test_model(check):
        check.run()

Name a check that must fail, with the reason: ``expected_failures={"control_kinds": "requires
points"}``. It then fails if it passes, so that the list stays correct. pytest is not required.
A check that takes more than two minutes with one object fails. `check_plugin` checks an installed
package, whatever it provides.
"""

from termsel.testing.checks import Check
from termsel.testing.commands import check_command, command_checks
from termsel.testing.criteria import check_criterion, criterion_checks
from termsel.testing.datasets import check_dataset, dataset_checks
from termsel.testing.models import check_model, model_checks
from termsel.testing.plugins import check_plugin, plugin_checks
from termsel.testing.problem_checks import check_problem, problem_checks
from termsel.testing.readers import check_reader, reader_checks
from termsel.testing.solvers import check_solver, solver_checks
from termsel.testing.writers import check_writer, example_results, writer_checks

__all__ = [
    "Check",
    "check_command",
    "check_criterion",
    "check_dataset",
    "check_model",
    "check_plugin",
    "check_problem",
    "check_reader",
    "check_solver",
    "check_writer",
    "command_checks",
    "criterion_checks",
    "dataset_checks",
    "example_results",
    "model_checks",
    "plugin_checks",
    "problem_checks",
    "reader_checks",
    "solver_checks",
    "writer_checks",
]
