"""The command `termsel report`."""

from __future__ import annotations

from pathlib import Path

import click

from termsel.cli.messages import refuse_stdout, say_written, show_messages
from termsel.cli.remote import allow_remote
from termsel.errors import TermselError

REPORT = "report.html"


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option("--output", "-o", metavar="FILE", type=click.Path(path_type=Path),
              help="The page to write; report.html in DIR by default.")
@click.option("--image", metavar="FILE", help="The image, to be shown below the residuals.")
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
@allow_remote
def report(folder: Path, output: Path | None, image: str | None, overwrite: bool) -> None:
    """Write a page about a result that opens in any browser, without a connection.

    DIR is the folder that a run wrote with --out. The page says how accurate the result is, what
    plain structures reach, which features are bad, where the model is weak, what was selected, and
    how to repeat it.

    \b
    Examples:
      termsel report result
      termsel report result -o report.html --image scene.tif
    """
    output = folder / REPORT if output is None else output
    refuse_stdout(output)
    show_messages()

    from termsel.io.replacing import require_replaceable
    from termsel.io.result_folder import read_result
    from termsel.studies.plans import PLAN

    if (folder / PLAN).is_file():
        raise TermselError("this is the folder of a study, whose page termsel compare writes",
                           file=folder / REPORT,
                           hint="Open that page. The command of the study rewrites it.")
    require_replaceable([output], reads=[folder, image], overwrite=overwrite)
    read_result(folder).report(output, image=image, overwrite=True)
    say_written([output])
