"""The command `termsel list`."""

from __future__ import annotations

import click

from termsel.cli.messages import echo
from termsel.cli.tables import print_json, print_table
from termsel.plugins.kinds import KINDS


@click.command("list")
@click.argument("kind", metavar="KIND", type=click.Choice(list(KINDS)))
@click.option("--json", "as_json", is_flag=True, help="Print a JSON array.")
def list_(kind: str, as_json: bool) -> None:
    """List what can be asked for by name.

    KIND is problems, models, solvers, criteria, objectives, candidates, datasets, splits, sections,
    measures, readers or writers.

    \b
    Examples:
      termsel list problems
      termsel list models --json
    """
    from termsel.plugins.registry import registry

    names = registry()
    entries = names.entries(kind)
    if as_json:
        print_json([{"name": entry.name, "summary": entry.summary,
                     "provided_by": entry.provided_by} for entry in entries])
    else:
        print_table(("name", "summary", "provided by"),
                    [(entry.name, entry.summary, entry.provided_by) for entry in entries])
    for failure in names.failures(kind):
        echo(f"Warning: {failure}", err=True)
