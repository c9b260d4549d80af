"""The checks of anything that a plugin provides: which suite is for what, and how it is run."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from inspect import signature
from typing import Any

from termsel.core.errors import TermselError
from termsel.plugins.kinds import KINDS
from termsel.selection.problems.base import Problem
from termsel.testing import (
    commands,
    criteria,
    datasets,
    methods,
    models,
    objectives,
    of_results,
    plugins,
    problem_suite,
    readers,
    solvers,
    splits,
    writers,
)
from termsel.testing.cases import Check, Suite, assemble, run_all

SUITES: dict[str, Suite] = {
    "models": models.SUITE,
    "solvers": solvers.SUITE,
    "criteria": criteria.SUITE,
    "objectives": objectives.SUITE,
    "problems": problem_suite.SUITE,
    "methods": methods.SUITE,
    "datasets": datasets.SUITE,
    "splits": splits.SUITE,
    "sections": of_results.SECTIONS,
    "measures": of_results.MEASURES,
    "readers": readers.SUITE,
    "writers": writers.SUITE,
    "commands": commands.SUITE,
    "plugins": plugins.SUITE,
}
"""By the plural, as the hooks are called; "plugins" is for an installed package."""


def checks(thing: Any, *, expected_failures: Mapping[str, str] | None = None,
           **about: Any) -> tuple[Check, ...]:
    """Return the checks of what a plugin provides, for ``pytest.mark.parametrize``.

    Parameters
    ----------
    thing : object
        What a hook returns: a class of models, solvers, criteria, readers or writers, or an object
        of one with the options to check it with; a `Recipe`, `DatasetSpec`, `Objective`,
        `Split`, `ReportSection`, `Measure` or `Method`. Or a `Problem`, or what makes one; a
        ``click.Command``; the name of an installed package.
    expected_failures : mapping, optional
        Checks that it is known to fail, by name, with the reason.
    **about
        What the checks of its kind need:

        - model: `options`, an iterable of mappings, the options to check it with (by default its
          defaults, and every other choice of each option that has choices); `place`, a `Scaling`
          and a CRS to prepare it for, if it depends on the place. With small coefficients it must
          then map scaled ground within [-1, 1] to image positions within [-1, 1].
        - solver: `options`, as for a model (by default its defaults); `problem`, what makes the
          problem of most checks (by default a selection among 12 terms). Give one with about as
          many genes for a solver that is made for other problems.
        - reader: `content`, the bytes of a file of its format with several features; `expected`,
          its features as a `FeatureSet`; `filename`, a typical name of such files.
        - writer: `filename`, as for a reader; `results`, those to write (by default
          `example_results`); `verify`, which takes a result and the path it was written to, and
          raises AssertionError if they do not agree.
        - method: `features`, an iterable of `FeatureSet`, where it is not for any points.
        - command: `words`, what a user types after its name.

    Returns
    -------
    tuple of Check
        Functions without arguments, each of which raises AssertionError where it fails.

    Raises
    ------
    TermselError
        For a thing that no suite is for, an argument that its suite does not take, or an expected
        failure of a check that does not exist.

    Examples
    --------
    >>> from termsel.models.polynomial import Affine
    >>> from termsel.testing import checks
    >>> checks(Affine)[0].name
    'declaration'
    """
    kind = _plural_of_kind(thing)
    suite: Suite = SUITES[kind] if kind in SUITES else import_module(thing.suite).SUITE
    try:
        # A mistake in the arguments is told now, and not when the first check makes its cases.
        signature(suite.cases).bind(thing, **about)
    except TypeError as error:
        raise TermselError(f"the checks of {_plural_of_kind(thing)}: {error}",
                           hint="See the arguments of termsel.testing.checks.") from error
    return assemble(suite.functions, suite.cases(thing, **about), expected_failures)


def check(thing: Any, *, expected_failures: Mapping[str, str] | None = None, **about: Any) -> None:
    """Run all checks of what a plugin provides.

    Parameters
    ----------
    thing, expected_failures, **about
        As for `checks`.

    Raises
    ------
    AssertionError
        If a check fails. The message has a paragraph for each that does: its name, and what is
        wrong.
    TermselError
        As `checks` raises it.

    Examples
    --------
    >>> from termsel.selection.criteria import CheckRmse
    >>> from termsel.testing import check
    >>> check(CheckRmse)
    """
    run_all(checks(thing, expected_failures=expected_failures, **about))


def _plural_of_kind(item: Any) -> str:
    """Return the plural of what a thing is; TermselError if nothing has checks of it."""
    import click

    if isinstance(item, str):
        return "plugins"
    if isinstance(item, click.Command):
        return "commands"
    for kind, declared in KINDS.items():
        if declared.is_of(item):
            return kind
    # Last, as models and solvers are classes, which can be called, too.
    if isinstance(item, Problem) or callable(item):
        return "problems"
    raise TermselError(f"there are no checks of {item!r:.100}",
                       hint="Give what a hook returns, a command, or the name of a package.")
