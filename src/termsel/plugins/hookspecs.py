"""The hooks a plugin may implement.

A plugin is a module named by an entry point of the group ``termsel``::

    [project.entry-points.termsel]
    demo = "termsel_demo"

Its functions have the name of a hook and the decorator `hookimpl`, and return what the plugin
adds::

    from termsel import hookimpl

    @hookimpl
    def termsel_models():
        return [DLT]

What has options of its own (models, solvers, criteria, readers, writers) is returned as its class.
What is a plain description (problems as `Recipe`, data sets as `DatasetSpec`) is returned as an
instance.

A function may omit arguments it does not need. termsel calls each function once per process, when
something of its kind is needed.
"""

# Specifications are never called: they have no bodies.
# mypy: disable-error-code="empty-body"

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

import pluggy

if TYPE_CHECKING:
    import click

    from termsel.core.isolation.parts import Part
    from termsel.core.options import Configurable
    from termsel.data.datasets import DatasetSpec
    from termsel.data.roles import Split
    from termsel.fitting.method import Method
    from termsel.formats.base import Reader, Writer
    from termsel.models import SensorModel
    from termsel.results.extras import Measure, ReportSection
    from termsel.results.result import Result
    from termsel.selection.criteria import Criterion
    from termsel.selection.problems.objectives import Objective
    from termsel.selection.problems.recipes import Recipe
    from termsel.selection.solvers import Solver
    from termsel.selection.solvers.ledger import Progress

PROJECT = "termsel"
"""Name of the entry-point group, and prefix of the hooks."""

hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)


@hookspec
def termsel_models() -> Iterable[type[SensorModel]]:
    """Return sensor models.

    Returns
    -------
    iterable of type
        Subclasses of `SensorModel` or `RationalModel`, each with a `name` as in ``--model``,
        and a docstring whose first line is shown by ``termsel list models``.
    """


@hookspec
def termsel_problems() -> Iterable[Recipe]:
    """Return problems.

    Returns
    -------
    iterable of Recipe
        Each names the model, data set, criterion and solver to use by default, so that
        ``termsel run --problem NAME`` alone runs.
    """


@hookspec
def termsel_criteria() -> Iterable[type[Criterion]]:
    """Return criteria, the figures of merit that a search minimises.

    Returns
    -------
    iterable of type
        Subclasses of `Criterion`, each with a `name` as in ``--criterion``.
    """


@hookspec
def termsel_objectives() -> Iterable[Objective]:
    """Return objectives next to the criterion, for problems that select terms or features.

    Returns
    -------
    iterable of Objective
        Each with a `name` as in ``--set objectives=NAME``.
    """


@hookspec
def termsel_solvers() -> Iterable[type[Solver]]:
    """Return solvers.

    Returns
    -------
    iterable of type
        Subclasses of `Solver`, each with a `name` as in ``--solver``.
    """


@hookspec
def termsel_methods() -> Iterable[Method]:
    """Return candidates of the strategy auto, next to those that are built in.

    Returns
    -------
    iterable of Method
        Each with a `name` as in `termsel.fit`. One that fails is left out of the choice, and a note
        names it.
    """


@hookspec
def termsel_matchers() -> Iterable[type[Configurable]]:
    """Return matchers, which termsel-match asks for places of two images that look alike.

    Returns
    -------
    iterable of type
        Subclasses of `termsel_match.matchers.Matcher`, each with a `name` as in ``--matcher``.
    """


@hookspec
def termsel_datasets() -> Iterable[DatasetSpec]:
    """Return named data sets.

    Returns
    -------
    iterable of DatasetSpec
        Each with a `name` as in ``--dataset``; its `load` is called when the data are needed.
    """


@hookspec
def termsel_splits() -> Iterable[Split]:
    """Return ways to assign the roles control, check and independent.

    Returns
    -------
    iterable of Split
        Each with a `name` as in ``--set roles=NAME``.
    """


@hookspec
def termsel_sections() -> Iterable[ReportSection]:
    """Return sections of reports, which follow those of termsel.

    Returns
    -------
    iterable of ReportSection
        If a section fails, the report says so in its place, and is otherwise the same.
    """


@hookspec
def termsel_measures() -> Iterable[Measure]:
    """Return figures of results, which studies have as columns.

    Returns
    -------
    iterable of Measure
        Each with a `name` as in ``termsel compare --measures NAME``.
    """


@hookspec
def termsel_readers() -> Iterable[type[Reader]]:
    """Return readers of files of ground control features.

    Returns
    -------
    iterable of type
        Subclasses of `Reader`. A built-in one whose `sniff` recognises a file reads it, else the
        one of a plugin that does; of several, one that is not `general`. If that leaves no single
        one that does not recognise noise, the user has to choose.
    """


@hookspec
def termsel_writers() -> Iterable[type[Writer]]:
    """Return writers of results.

    Returns
    -------
    iterable of type
        Subclasses of `Writer`, each with a `name` as in ``termsel export --to``.
    """


@hookspec
def termsel_commands(cli: click.Group) -> None:
    """Add commands to the command line.

    The hook is called for a command that is not built in, and for ``termsel plugins``. It is not
    called for ``termsel --help``, which must be quick.

    Parameters
    ----------
    cli : click.Group
        Takes the commands: ``cli.add_command(command)`` or ``@cli.command()``. Each plugin has
        its own group; its commands are added to those of termsel afterwards.
    """


@hookspec
def termsel_observers() -> Iterable[Callable[[Progress], None]]:
    """Return observers of every run, for a log or a display of progress.

    Returns
    -------
    iterable of callable
        Each takes the `Progress` of a search, as the `observers` of `termsel.run` do: after each
        generation, and in the local refinement. One that fails is named, and not called any more.
    """


@hookspec
def termsel_parts() -> Iterable[Part]:
    """Return parts that termsel asks for at one place, and does without where there are none.

    Returns
    -------
    iterable of Part
        Of the places that `termsel.toolkit.Part` lists.
    """


@hookspec
def termsel_run_finished(result: Result) -> None:
    """Receive a finished run, for a log or a database of runs.

    Parameters
    ----------
    result : Result
        As written to ``result.json``.
    """
