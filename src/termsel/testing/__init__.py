"""Conformance suites: what termsel asks of models, solvers, criteria, readers and writers.

termsel's own are run through the same checks. In a test of a plugin, either all at once::

    from termsel.testing import check_model

    def test_model():
        check_model(DLT)

or each check as a test of its own::

    import pytest
    from termsel.testing import model_checks

    @pytest.mark.parametrize("check", model_checks(DLT), ids=lambda check: check.name)
    def test_model(check):
        check.run()

A check that cannot hold is named with the reason, ``expected_failures={"control_kinds": "needs
points"}``; it then fails if it does hold, so that the list stays true. pytest is not needed.
"""

from termsel.testing.checks import Check
from termsel.testing.criteria import check_criterion, criterion_checks
from termsel.testing.models import check_model, model_checks
from termsel.testing.readers import check_reader, reader_checks
from termsel.testing.solvers import check_solver, solver_checks
from termsel.testing.writers import check_writer, example_results, writer_checks

__all__ = [
    "Check",
    "check_criterion",
    "check_model",
    "check_reader",
    "check_solver",
    "check_writer",
    "criterion_checks",
    "example_results",
    "model_checks",
    "reader_checks",
    "solver_checks",
    "writer_checks",
]
