"""The command `termsel list`."""

from __future__ import annotations

import click

from termsel.cli.messages import echo
from termsel.cli.tables import print_json, print_table
from termsel.plugins.kinds import KINDS


@click.command("list")
@click.argument("kind", metavar="[KIND]", required=False, type=click.Choice(list(KINDS)))
@click.option("--json", "as_json", is_flag=True, help="Print a JSON array.")
def list_(kind: str | None, as_json: bool) -> None:
    """List available models, solvers, readers and so on.

    Without KIND it says how many of each there are.

    KIND is problems, models, solvers, criteria, objectives, methods, datasets, splits, sections,
    measures, matchers, readers or writers.

    \b
    Examples:
      termsel list problems
      termsel list models --json
    """
    from termsel.plugins.registry import registry

    names = registry()
    if kind is None:
        counts = {name: len(names.entries(name)) for name in KINDS}
        if as_json:
            print_json([{"kind": name, "count": count} for name, count in counts.items()])
        else:
            print_table(("kind", "how many", "list them with"), [
                (name, str(count), f"termsel list {name}") for name, count in counts.items()])
        return
    entries = names.entries(kind)
    if as_json:
        print_json([{"name": entry.name, "summary": entry.summary,
                     "provided_by": entry.provided_by} for entry in entries])
    else:
        print_table(("name", "summary", "provided by"),
                    [(entry.name, entry.summary, entry.provided_by) for entry in entries])
    # A broken plugin hides nothing of others; what it would have provided is said to be missing.
    for failure in names.failures(kind):
        echo(f"Warning: {failure}", err=True)
