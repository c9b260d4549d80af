"""The command `termsel plan`."""

from __future__ import annotations

from pathlib import Path

import click

from termsel.cli.messages import echo, say_written, show_messages
from termsel.cli.options.shared import final_option
from termsel.cli.tables import print_table


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option("--candidates", metavar="FILE", type=click.Path(path_type=Path),
              help="Table id,x,y,z of candidate positions, in the CRS of the control; by default "
                   "a grid over the image.")
@click.option("-n", "--number", "count", type=click.IntRange(min=1), default=5, show_default=True,
              help="Number of positions.")
@click.option("--output", "-o", metavar="FILE", type=click.Path(path_type=Path),
              help="Also write the positions to this CSV file.")
@final_option
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
def plan(folder: Path, candidates: Path | None, count: int, output: Path | None,
         final: bool | None, overwrite: bool) -> None:
    """Rank positions at which further control points help most.

    DIR is the folder that a run wrote with --out. The first place is the one after which the mean
    uncertainty over the image is least, the second the best together with the first, and so on.
    `uncertainty_px` is that mean once the place, and those above it, are measured [px].

    \b
    Examples:
      termsel plan result
      termsel plan result -n 10 -o next.csv
      termsel plan result --candidates crossroads.csv -n 3
    """
    show_messages()

    from termsel.core.errors import rounded_size_text
    from termsel.core.files.atomic import write_text
    from termsel.io.export import as_exported
    from termsel.io.plan import COLUMNS
    from termsel.io.plan import plan as ranked
    from termsel.io.replacing import require_no_source, require_replaceable
    from termsel.io.result_folder import read_result

    if output is not None:
        require_replaceable([output], reads=[folder, candidates], overwrite=overwrite,
                            written_as="CSV")
    result = read_result(folder)
    if output is not None:
        require_no_source(output, result)
    positions = ranked(as_exported(result, final), count, candidates)
    rows = [(name, f"{line:.1f}", f"{sample:.1f}", f"{x:.8g}", f"{y:.8g}",
             "" if z != z else f"{z:.1f}", rounded_size_text(sigma))
            for name, (line, sample, x, y, z, sigma) in zip(
                positions.ids, positions.values.tolist(), strict=True)]
    print_table(COLUMNS, rows)
    # The last row has the uncertainty after all positions above it were measured.
    measured = "this place" if len(rows) == 1 else f"these {len(rows)} places"
    echo(f"Mean uncertainty over the image: {rounded_size_text(positions.sigma_before)} px now, "
         f"{rows[-1][-1]} px with {measured}", err=True)
    if output is not None:
        write_text(output, positions.to_csv())
        say_written([output])
