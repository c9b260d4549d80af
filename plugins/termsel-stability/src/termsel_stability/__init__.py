"""How often each term is selected as control and selection points change, as a plugin.

References
----------
Meinshausen and Bühlmann 2010, Stability selection, J. R. Stat. Soc. B 72(4).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import lazy_loader

from termsel import hookimpl

if TYPE_CHECKING:
    import click

    from termsel_stability.frequencies import Stability, stability

# What is not needed for `termsel run` is not imported for it.
__getattr__, _, _ = lazy_loader.attach(__name__, submod_attrs={
    "frequencies": ["Stability", "stability"]})

__all__ = ["Stability", "stability"]


@hookimpl
def termsel_commands(cli: click.Group) -> None:
    """Add the command."""
    from termsel_stability.command import stability as command

    cli.add_command(command)
