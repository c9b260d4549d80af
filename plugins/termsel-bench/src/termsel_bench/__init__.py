"""An open benchmark, certificates of proofs, and files of studies for IOHprofiler, for termsel."""

from __future__ import annotations

from typing import TYPE_CHECKING

from termsel import hookimpl

if TYPE_CHECKING:
    import click


@hookimpl
def termsel_commands(cli: click.Group) -> None:
    """Add the command."""
    from termsel_bench.command import bench

    cli.add_command(bench)
