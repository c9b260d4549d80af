"""The command `termsel run`."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import click

from termsel.cli.bars import search_bar
from termsel.cli.messages import echo, say_written, show_messages
from termsel.cli.options.run_options import Asked, run_options
from termsel.core.interrupts import INTERRUPTED


@click.command()
@run_options
@click.option("--out", metavar="DIR", type=click.Path(path_type=Path),
              help="Folder for result.json, residuals.csv, summary.txt and the features.")
@click.option("--verbose", is_flag=True,
              help="Print all of the summary, as in summary.txt: every table, term and proof.")
def run(verbose: bool, **given: Any) -> None:
    """Search for the terms or control features that serve best.

    Check points judge each selection. Independent points judge the result and take no part in any
    choice. Ctrl-C ends the search and keeps the best selection so far.

    \b
    Examples:
      termsel run --points gcp.csv --crs EPSG:4979 --out result
      termsel run --points gcp.txt --crs EPSG:4979 --columns id=1,x=2,y=3,z=4,sample=5,line=6
      termsel run --points gcp.csv --crs EPSG:4979 --off P07,P12 --role P03=independent
      termsel run --points gcp.csv --rpc vendor.RPB --out result
      termsel run --problem owdis-lines
      termsel run --problem poly-terms --points gcp.csv --crs local --set degree=5
      termsel run --problem rfm-terms --points image.points --dem heights.tif
      termsel run --problem owdis-lines --points points.csv --lines roads.csv \\
          --crs EPSG:32639 --model poly3d --seed 7 --json > result.json
    """
    asked = Asked(**given)
    show_messages()

    from termsel.io.replacing import require_replaceable
    from termsel.io.result_folder import RECORD, files_of_result, names_of
    from termsel.runs import run as running

    out = asked.out
    if out is not None:
        require_replaceable(files_of_result(out), reads=asked.reads, overwrite=True,
                            makes_folder=True)
    # A name that is not known is said before a long search.
    exported = asked.exported()
    page = asked.page()
    features, options = asked.read()
    with search_bar(asked.problem or asked.solver or "auto", asked.quiet) as observe:
        result = running.run(
            asked.problem, strategy=asked.strategy, features=features, dataset=asked.dataset,
            source=asked.source, model=asked.model, solver=asked.solver,
            criterion=asked.criterion, options=options, **asked.budget,
            observers=[observe] if observe else [], out=out, overwrite=asked.overwrite)
    echo(result.to_json() if asked.as_json else result.summary(verbose=verbose), nl=False)
    if out is not None:
        asked.write(result, exported, page)
    if not asked.as_json:
        saved = f"Saved     {out}{os.sep}    " if out is not None else ""
        echo(f"{saved}{result.next_step(out or '')}")
    elif out is not None:
        say_written([f"{out}/{RECORD}", *names_of(result.features)[1:]])
    if result.interrupted:
        echo("Interrupted: this is the best so far. The same command"
             f"{' with --overwrite' if out else ''} repeats the whole run.", err=True)
        sys.exit(INTERRUPTED)
