"""All installed commands of termsel by name, for the reference: `commands.match_points`."""

from __future__ import annotations

import click

from termsel.cli.main import cli
from termsel.plugins.commands import GROUPS

NAMES = {name.replace("-", "_"): name for names in GROUPS.values() for name in names}
"""Names of commands by those of attributes."""


def __getattr__(name: str) -> click.Command:
    """Return a command, also that of a plugin."""
    command = cli.get_command(click.Context(cli), NAMES[name]) if name in NAMES else None
    if command is None:
        raise AttributeError(name)
    return command
