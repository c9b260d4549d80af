"""The command `termsel report`."""

from __future__ import annotations

from pathlib import Path

import click

from termsel.cli.messages import echo, refuse_stdout, say_written, show_messages
from termsel.cli.options.shared import remote_option
from termsel.core.errors import TermselError, first_names_in_words

REPORT = "report.html"
PAGES = (".html", ".htm")
"""Suffixes of a page."""


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option("--output", "-o", metavar="FILE", type=click.Path(path_type=Path),
              help="The page to write; report.html in DIR by default.")
@click.option("--image", metavar="FILE", help="The image, to be shown below the residuals.")
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
@remote_option
def report(folder: Path, output: Path | None, image: str | None, overwrite: bool) -> None:
    """Write a page about a result or a study that opens in any browser, without a connection.

    DIR is the folder that `termsel run` or `termsel compare` wrote with --out. The page of a result
    says how accurate it is, what conventional models reach, which features are bad, where the model
    is weak, what was selected, and how to repeat it. The page of a study has its tables and
    charts; of many images the worst first, each with a drawing of its residuals.

    \b
    Examples:
      termsel report result
      termsel report result -o report.html --image scene.tif
      termsel report study --overwrite
    """
    from termsel.core.files.names import is_there, path_inside

    output = path_inside(folder, REPORT) if output is None else output
    refuse_stdout(output)
    show_messages()
    is_study = _is_study(folder)
    # termsel compare writes the page of a study itself: it is there already, and no error.
    if is_study and not overwrite and is_there(folder / REPORT) and output == folder / REPORT:
        echo(f"There is a page already: {output}. Open it, or add --overwrite to write it again.")
        return
    _require_page(output, folder, image, overwrite=overwrite)
    if is_study:
        _write_study_page(folder, output, image)
    else:
        from termsel.io.result_folder import read_result

        read_result(folder).report(output, image=image, overwrite=True)
    say_written([output])


def _is_study(folder: Path) -> bool:
    """Return whether a folder has a study, and not a result; raises TermselError for neither."""
    from termsel.core.files.names import is_there
    from termsel.io.result_folder import files_of_result, results_within
    from termsel.studies.cells.folder import PLAN

    # The plan of a study is in its folder, whatever else is.
    if (folder / PLAN).is_file():
        return True
    if any(map(is_there, files_of_result(folder))):
        return False
    if folder.is_dir():
        reason = "there is neither a result nor a study in this folder"
    elif folder.exists():
        reason = "this is a file, expected the folder of a result or study"
    else:
        reason = "this folder does not exist"
    hint = "Give the folder that termsel run or termsel compare wrote with --out."
    if inner := results_within(folder):
        hint += f" Or one of these within it: {first_names_in_words(inner, 3)}."
    raise TermselError(reason, file=folder, hint=hint)


def _require_page(output: Path, folder: Path, image: str | None, *, overwrite: bool) -> None:
    """Raise TermselError if a page cannot be written here, or would replace what it is made of.

    It is made of the files of the run or study in `folder`, and of the `image`, if there is one.
    """
    from termsel.core.files.names import JOURNAL
    from termsel.io.replacing import require_replaceable
    from termsel.studies.cells.folder import PLAN
    from termsel.studies.cells.images import IMAGES

    study_files = [folder / PLAN, folder / JOURNAL, *(folder / IMAGES).glob("*")]
    require_replaceable([output], reads=[folder, image, *study_files], overwrite=overwrite)
    if output.suffix.lower() not in PAGES:
        raise TermselError(f"a page is HTML, not {output.suffix or 'without a suffix'}",
                           file=output, hint=f"Name it {output.with_suffix('.html').name}; a "
                                             "browser prints it as PDF.")


def _write_study_page(folder: Path, output: Path, image: str | None) -> None:
    """Write the page of a study; raises TermselError for an image, which is of one result."""
    from termsel.core.files.atomic import write_text
    from termsel.studies.cells.folder import read_study
    from termsel.studies.cells.images import IMAGES
    from termsel.studies.outputs import study_page

    if image is not None:
        raise TermselError("--image is for the page of one result, and this is a study",
                           file=folder, hint=f"Leave --image out, or give the folder of one "
                                             f"image in {folder / IMAGES}.")
    write_text(output, study_page(read_study(folder)))
