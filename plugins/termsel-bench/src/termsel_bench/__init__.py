"""An open benchmark, and certificates of proofs, for termsel."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from termsel import hookimpl

if TYPE_CHECKING:
    import click

    from termsel.toolkit import Part


@hookimpl
def termsel_commands(cli: click.Group) -> None:
    """Add the command."""
    from termsel_bench.command import bench

    cli.add_command(bench)


@hookimpl
def termsel_parts() -> Iterable[Part]:
    """Return the part of termsel that writes certificates of proofs."""
    from termsel.toolkit import Part
    from termsel_bench.certificate import certificate_maker

    return [Part("certificate", certificate_maker)]
