"""An open benchmark, certificates of proofs, and files of studies for IOHprofiler, for termsel."""

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
    """Return what writes certificates of proofs, and studies for IOHprofiler."""
    from termsel.toolkit import Part, StudyOutput
    from termsel_bench.certificate import certifier
    from termsel_bench.ioh import FOLDER, write

    return [Part("certificate", certifier), Part("study", StudyOutput((FOLDER,), write))]
