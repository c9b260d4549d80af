"""Studies, as a plugin: statistics, charts and their page; clusters; how stable terms are.

References
----------
Meinshausen and Bühlmann 2010, Stability selection, J. R. Stat. Soc. B 72(4).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import lazy_loader

from termsel import hookimpl

if TYPE_CHECKING:
    import click

    from termsel.toolkit import Part
    from termsel_studies.frequencies import Stability, selection_frequencies
    from termsel_studies.report import report, study_summary

# What only a finished study needs is not imported for `termsel run`.
__getattr__, _, _ = lazy_loader.attach(__name__, submod_attrs={
    "cluster": ["run_on_cluster"], "frequencies": ["Stability", "selection_frequencies"],
    "outlines": ["map_of"], "report": ["report", "study_summary"]})

__all__ = [
    "Stability",
    "map_of",
    "report",
    "run_on_cluster",
    "selection_frequencies",
    "study_summary",
]


@hookimpl
def termsel_commands(cli: click.Group) -> None:
    """Add the command `stability`."""
    from termsel_studies.stability_command import stability as command

    cli.add_command(command)


@hookimpl
def termsel_parts() -> Iterable[Part]:
    """Return what this package adds to the studies of termsel.

    It is what runs their cells on a cluster, what writes their tables, charts and data for
    IOHanalyzer, and what makes a map of their images.
    """
    from termsel.toolkit import Part
    from termsel.toolkit.studies import StudyOutput
    from termsel_studies import ioh
    from termsel_studies.cluster import run_on_cluster
    from termsel_studies.next_run import next_command
    from termsel_studies.outlines import map_of
    from termsel_studies.report import FILES, report, study_summary, write_tables_and_charts

    return [Part("scheduler", run_on_cluster),
            Part("study", StudyOutput((ioh.IOH_FOLDER,), ioh.write)),
            Part("study-map", map_of),
            Part("study", StudyOutput(FILES, write_tables_and_charts, study_summary, report,
                                       next_command))]
