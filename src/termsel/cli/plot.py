"""The command `termsel plot`."""

from __future__ import annotations

from pathlib import Path
from shlex import quote

import click

from termsel.cli.messages import refuse_stdout, say_written, show_messages
from termsel.core.errors import TermselError

CHART_NAMES = ("residuals", "ground", "worst", "baselines", "candidates", "front", "convergence",
               "empires", "frequency", "terms", "correlations", "sigma")


class ChartName(click.Choice[str]):
    """The name of a chart, which comes after the folder."""

    def convert(self, value: str, param: click.Parameter | None,
                ctx: click.Context | None) -> str:
        """Return the name; raise TermselError where folder and name are exchanged."""
        folder = "" if ctx is None else str(ctx.params.get("folder", ""))
        if value not in self.choices and folder in self.choices:
            raise TermselError(f"DIR comes before KIND: termsel plot {value} {folder} "
                               f"-o {folder}.svg")
        return super().convert(value, param, ctx)


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.argument("kind", metavar="KIND", type=ChartName(CHART_NAMES))
@click.option("--output", "-o", metavar="FILE", type=click.Path(path_type=Path),
              help="The picture to write; its name ends in .svg, .png or .pdf.")
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
def plot(folder: Path, kind: str, output: Path | None, overwrite: bool) -> None:
    """Draw a chart of a result as SVG, PNG or PDF.

    DIR is the folder that a run wrote with --out. KIND is one of:

    \b
      residuals     arrows of residuals over the image
      ground        the same on the ground
      worst         the largest residuals, and where they are
      baselines     RMSE next to those of fits without a search
      candidates    what the strategy auto chose among
      front         RMSE against terms or features
      convergence   best and median of the search
      empires       empires of the ICA, the imperialist competitive algorithm
      frequency     how often terms are selected, in a front or by termsel stability
      terms         significance of terms
      correlations  correlations of coefficients
      sigma         standard deviation over the image

    \b
    Examples:
      termsel plot result residuals -o residuals.svg
      termsel plot result baselines -o baselines.png
    """
    if output is not None:
        refuse_stdout(output)
    show_messages()

    from termsel.io.replacing import require_replaceable
    from termsel.io.result_folder import read_result
    from termsel.results.plots import require_chart, require_picture, save, styled_chart
    from termsel.studies.cells.folder import PLAN

    if (folder / PLAN).is_file():
        raise TermselError("this is the folder of a study, and a picture is of one result",
                           file=folder, hint="Its own pictures are in figures; the folder of an "
                                             "image is in images.")
    if output is None:
        # Nobody needs a name for a chart that the result does not have.
        require_chart(read_result(folder).view, kind)
        raise TermselError("--output FILE is missing: the picture to write, .svg, .png or .pdf",
                           hint=f"Type termsel plot {quote(str(folder))} {kind} -o {kind}.svg")
    require_picture(output)
    # Whether it may be written is known before the charts are drawn, which takes seconds.
    require_replaceable([output], reads=[folder], overwrite=overwrite)
    save(styled_chart(read_result(folder).view, kind), output)
    say_written([output])
