"""The command `termsel export`."""

from __future__ import annotations

from pathlib import Path

import click

from termsel.cli.completion import complete
from termsel.cli.messages import refuse_stdout, say_written, show_messages
from termsel.cli.options.run_options import parse_settings
from termsel.cli.options.shared import final_option, remote_option


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option("--to", metavar="FORMAT", required=True, shell_complete=complete("writers"),
              help="The format; see `termsel list writers`.")
@click.option("--output", "-o", metavar="FILE", required=True, type=click.Path(path_type=Path),
              help="The file to write.")
@click.option("--image", metavar="FILE", help="The image, for formats that refer to it.")
@click.option("--dem", metavar="FILE", help="Raster of heights, for grids on the ground.")
@click.option("--set", "settings", metavar="KEY=VALUE", multiple=True,
              help="An option of the format; `termsel describe FORMAT` lists them.")
@final_option
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
@remote_option
def export(folder: Path, to: str, output: Path, image: str | None, dem: str | None,
           settings: tuple[str, ...], final: bool | None, overwrite: bool) -> None:
    """Write a result for GDAL, QGIS, OTB, Orthority and others.

    DIR is the folder that a run wrote with --out. RPCs are read back through GDAL and compared
    with the fitted model before they are put in place. Where auto chose the model, the fit to all
    points is written, independent ones included; all figures of the result are those of the fit
    without them, which --no-final writes.

    \b
    Examples:
      termsel export result --to rpc-txt --output scene_RPC.TXT --image scene.tif
      termsel export result --to rpc-vrt --output scene.vrt --image scene.tif
      termsel export result --to qgis-points --output scene.tif.points --no-final
      termsel export result --to geolocation-vrt --output scene.vrt --image scene.tif \\
          --dem heights.tif
    """
    options = parse_settings(settings, image=image, dem=dem)
    refuse_stdout(output)
    show_messages()

    from termsel.core.files.names import is_there
    from termsel.io.export import export as write
    from termsel.io.export import writer_of
    from termsel.io.replacing import require_replaceable
    from termsel.io.result_folder import read_result

    # A mistake in the format and its options is reported before the folder is read.
    writer = writer_of(to, **options)
    files = writer.files(output)
    is_table = (writer.suffix or to).endswith("csv")  # as of points-csv
    # Without the file itself, those next to it are of an export that was killed, and are replaced.
    if not is_there(output):
        files = (output,)
    # All files of a format are looked at before anything is written: one that exists refuses all.
    require_replaceable(files, reads=[folder, *options.values()], overwrite=overwrite,
                        written_as="CSV" if is_table else None, beside=False)
    say_written(write(read_result(folder), to, output, overwrite=overwrite, final=final,
                      **options))
