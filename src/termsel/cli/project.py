"""The command `termsel project`."""

from __future__ import annotations

from pathlib import Path
from shlex import quote

import click

from termsel.cli.messages import echo, echo_table, say_written, show_messages
from termsel.cli.options.run_options import COLUMNS_OPTION
from termsel.cli.options.shared import final_option, remote_option
from termsel.core.errors import TermselError


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.argument("file", metavar="[FILE]", required=False, type=click.Path(path_type=Path))
@click.option("--points", metavar="FILE", type=click.Path(path_type=Path),
              help="FILE, by a name: table id,x,y,z of ground points in the CRS of the control, "
                   "or GeoJSON and other vector files; with --inverse id,line,sample of image "
                   "points, and z.")
@COLUMNS_OPTION
@click.option("--layer", metavar="NAME",
              help="Layer of a vector file, or sheet of a spreadsheet; by default the first.")
@click.option("--inverse", is_flag=True,
              help="From the image to the ground: at --height, on --dem, or at the heights z of "
                   "the table.")
@click.option("--dem", metavar="FILE", type=click.Path(path_type=Path),
              help="Raster of heights of the ground, for points without heights and for "
                   "--inverse.")
@click.option("--height", type=float, help="Height of the ground, instead of a raster.")
@click.option("--output", "-o", metavar="FILE", type=click.Path(path_type=Path),
              help="Table to write; stdout by default, and for -.")
@final_option
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
@remote_option
def project(folder: Path, file: Path | None, points: Path | None, columns: str | None,
            layer: str | None, inverse: bool, dem: Path | None, height: float | None,
            output: Path | None, final: bool | None, overwrite: bool) -> None:
    """Compute image positions of ground points, or ground positions of image points.

    DIR is the folder that a run wrote with --out, and FILE the table of points. The output has
    the columns id,line,sample,x,y,z,uncertainty_line,uncertainty_sample,outside; cells are blank
    where a ray does not meet the ground. The uncertainties are standard deviations of the model's
    line and sample at the place [px]. The last column says how far the place is outside the
    control, by its extent: 0 is inside, and beyond 0.5 the model does not hold.

    \b
    Examples:
      termsel project result ground.csv
      termsel project result --points pixels.csv --inverse --dem heights.tif -o ground.csv
    """
    show_messages()
    if (file is None) == (points is None):
        given = "there are no points" if points is None else "points are given twice"
        raise TermselError(given, hint=f"Give one table: termsel project {quote(str(folder))} "
                                       "ground.csv")
    table = points or file
    assert table is not None

    from termsel.core.files.atomic import write_text
    from termsel.io.export import as_exported
    from termsel.io.project import project_table
    from termsel.io.replacing import require_no_source, require_replaceable
    from termsel.io.result_folder import read_result

    output = None if output == Path("-") else output
    # All is computed before the file is touched: a mistake in the table leaves no half of it.
    if output is not None:
        require_replaceable([output], reads=[folder, table, dem], overwrite=overwrite,
                            written_as="CSV")
    result = read_result(folder)
    if output is not None:
        require_no_source(output, result)
    text, warnings = project_table(as_exported(result, final), table,
                                   inverse=inverse, dem=dem, height=height,
                                   columns=columns or "", layer=layer)
    if output is None:
        echo_table(text)
    else:
        write_text(output, text)
        say_written([output])
    for warning in warnings:
        echo(f"Warning: {warning}", err=True)
