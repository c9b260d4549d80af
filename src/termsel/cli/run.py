"""The command `termsel run`."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import click

from termsel.cli.bars import search_bar
from termsel.cli.messages import echo, say_written, show_messages, take_pending
from termsel.cli.options.run_options import RunOptions, run_options, with_files
from termsel.cli.topics import ByTopic
from termsel.cli.typed import command_with
from termsel.core.interrupts import INTERRUPTED


@click.command(cls=ByTopic)
@click.argument("files", nargs=-1, type=click.Path(path_type=Path), metavar="[FILES]...")
@run_options
@click.option("--out", metavar="DIR", type=click.Path(path_type=Path),
              help="Folder for result.json, residuals.csv, summary.txt and the features.")
@click.option("--checkpoint", metavar="FILE", type=click.Path(path_type=Path),
              help="Keep what a search has evaluated in FILE. The same command goes on from there "
                   "after a stop, to the same end.")
@click.option("--verbose", is_flag=True,
              help="Print all of the summary, as in summary.txt: every table, term and proof.")
def run(verbose: bool, checkpoint: Path | None, files: tuple[Path, ...], **arguments: Any) -> None:
    """Fit a model to control points or lines, and report its accuracy.

    FILES are points, lines, the image and the RPC, distinguished by their names. Independent check
    points take no part in any choice.

    \b
    Examples:
      termsel run map.points map.tif --out result
      termsel run --points gcp.csv --crs EPSG:4979 --out result
      termsel run --points gcp.csv --rpc vendor.RPB --out result
      termsel run --problem owdis-lines --points points.csv --lines lines.csv
    """
    settings = RunOptions(**with_files(files, arguments))
    show_messages()

    from termsel.core.files.names import RECORD
    from termsel.io.replacing import require_replaceable
    from termsel.io.result_folder import files_of_result, names_of
    from termsel.results.first_screen import next_step_for_user, options_of_next_run
    from termsel.runs import run as running

    folder = settings.out
    # A folder that holds anything else is refused before the search, which may take hours.
    if folder is not None:
        require_replaceable(files_of_result(folder), reads=settings.reads, overwrite=True,
                            makes_folder=True)
    # Formats that are not known, and files that may not be replaced, are refused now, too.
    export_files, page = settings.further_files()
    features, options = settings.read()
    title = settings.problem or settings.solver or settings.method or "auto"
    with search_bar(title, settings.quiet) as observe:
        result = running.run(
            settings.problem, strategy=settings.strategy, method=settings.method,
            features=features, dataset=settings.dataset, source=settings.source,
            model=settings.model,
            solver=settings.solver, criterion=settings.criterion, options=options,
            **settings.budget,
            observers=[observe] if observe else [], out=folder, overwrite=settings.overwrite,
            checkpoint=checkpoint)
    # The doubts that are pending are not printed by themselves: the summary states them.
    if not settings.as_json:
        take_pending()
    echo(result.to_json() if settings.as_json else result.summary(verbose=verbose), nl=False)
    if folder is not None:
        settings.write(result, export_files, page)
    if not settings.as_json:
        saved = f"Saved     {folder}{os.sep}    " if folder is not None else ""
        options = options_of_next_run(result)
        again = command_with(options, ["--overwrite"] if folder else []) if options else ""
        echo(f"{saved}{next_step_for_user(result, str(folder or ''), again, str(page or ''))}")
    elif folder is not None:
        say_written([f"{folder}/{RECORD}", *names_of(result.features)[1:]])
    if result.interrupted:
        # A checkpoint holds what was evaluated; without one a seed repeats the run from its start.
        then = "repeats the whole run" if checkpoint is None else f"goes on from {checkpoint}"
        echo("Interrupted: this is the best so far. The same command"
             f"{' with --overwrite' if folder else ''} {then}.", err=True)
        sys.exit(INTERRUPTED)
