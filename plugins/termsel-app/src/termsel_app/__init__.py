"""Control collected in the browser, with its quality at every click."""

from __future__ import annotations

from typing import TYPE_CHECKING

from termsel import hookimpl

if TYPE_CHECKING:
    import click


@hookimpl
def termsel_commands(cli: click.Group) -> None:
    """Add the command `termsel app` to the group."""
    from termsel_app.command import app

    cli.add_command(app)
