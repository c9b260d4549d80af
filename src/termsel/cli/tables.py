"""Tables and records on stdout: drawn on a terminal, aligned text in a pipe."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from termsel.cli.messages import echo, stdout_has, stream_of_results
from termsel.core.errors import make_printable


def print_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table: drawn by rich on a terminal, as plain columns elsewhere."""
    if stream_of_results().isatty():
        _print_with_rich(header, rows)
        return
    # A pipe or file has no width that rows must fit into.
    widths = [max(len(row[i]) for row in (header, *rows)) for i in range(len(header))]
    for row in (header, *rows):
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        echo("  ".join(cells).rstrip())


def _print_with_rich(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table for people, with rich."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for i, title in enumerate(header):
        table.add_column(title, no_wrap=i == 0, overflow="fold")
    for row in rows:
        # As Text, so that "[...]" in a summary is not taken for markup.
        table.add_row(*(Text(make_printable(cell)) for cell in row))
    Console(file=stream_of_results()).print(table)


def json_text(value: Any) -> str:
    """Return a value as JSON with a line end; in ASCII if a terminal cannot show its text."""
    text = json.dumps(value, indent=2, ensure_ascii=False)
    # Characters that would control a terminal are escaped as JSON has it, not as Python does.
    is_printable = make_printable(text) == text
    return (text if is_printable else json.dumps(value, indent=2)) + "\n"


def print_json(value: Any) -> None:
    """Print a value as JSON."""
    text = json_text(value)
    echo(text if stdout_has(text) else json.dumps(value, indent=2) + "\n", nl=False)
