"""Options of many commands: fit of a result, form of progress, and whether servers are asked."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

final_option = click.option(
    "--final/--no-final", default=None,
    help="Use the fit to all points, independent check points included, or the fit without them. "
         "By default the first if auto chose the model.")

PROGRESS = "termsel.progress"
"""Where a context keeps the form in which its command shows progress."""


def _keep(context: click.Context, parameter: click.Parameter, form: str) -> None:  # noqa: ARG001
    # Kept in the context, as the function of the command need not know of it.
    context.meta[PROGRESS] = form


progress_option = click.option(
    "--progress", type=click.Choice(["bar", "json"]), default="bar", show_default=True,
    expose_value=False, callback=_keep,
    help="Show progress as a bar, or, for programs, as lines of JSON on stderr.")

Command = TypeVar("Command", bound=Callable[..., Any])


def remote_option(command: Command) -> Command:
    """Return the command with ``--allow-remote`` and ``--allow-driver``, for all that it reads."""
    command = click.option(
        "--allow-driver", metavar="NAME", multiple=True, expose_value=False,
        callback=_allow_drivers,
        help="Let this driver of GDAL open files, such as netCDF. Only for files that you trust: "
             "some drivers write files or run programs.")(command)
    return click.option(
        "--allow-remote", is_flag=True, expose_value=False, callback=_allow,
        help="Let rasters and vector files refer to servers; refused otherwise.")(command)


def _allow(context: click.Context, parameter: click.Parameter, is_given: bool) -> None:  # noqa: ARG001
    """Allow remote files for the time of the command, if the option is given."""
    # While a shell completes words nothing is run, and nothing need be allowed.
    if is_given and not context.resilient_parsing:
        from termsel.core.files.drivers import allow_remote as allowed

        context.with_resource(allowed())


def _allow_drivers(context: click.Context, parameter: click.Parameter,  # noqa: ARG001
                   names: tuple[str, ...]) -> None:
    """Allow further drivers of GDAL for the time of the command, if any are named."""
    if names and not context.resilient_parsing:
        from termsel.core.files.drivers import allow_driver as allowed

        context.with_resource(allowed(*names))
