"""The command `termsel sigma`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from termsel.toolkit import final_option, remote_option, say_written, share_bar, show_messages
from termsel.toolkit.commands import progress_option, refuse_stdout

_FILE = click.Path(path_type=Path)


@click.command("sigma")
@click.argument("folder", metavar="DIR", type=_FILE)
@click.option("--output", "-o", metavar="FILE", required=True, type=_FILE,
              help="The raster to write, a cloud-optimised GeoTIFF.")
@click.option("--image", metavar="FILE", type=_FILE,
              help="The image, if the result does not record its size; the raster covers what it "
                   "shows.")
@click.option("--bounds", metavar="W S E N", type=float, nargs=4,
              help="West, south, east and north in the CRS of the raster, instead of what the "
                   "image shows.")
@click.option("--map", "like_map", metavar="FILE", type=_FILE,
              help="A map whose extent and CRS the raster has, instead of --bounds and --crs.")
@click.option("--res", "resolution", type=click.FloatRange(min=0, min_open=True),
              help="Pixel size in units of the CRS; by default some 500 px along the longer "
                   "side.")
@click.option("--crs", metavar="CRS", help="CRS of the raster; by default that of the control if "
                                           "it is in metres, else UTM.")
@click.option("--dem", metavar="FILE", type=_FILE,
              help="Raster of heights; converted if it declares another vertical datum.")
@click.option("--height", type=float, help="Height of the ground, instead of a raster; by default "
                                           "that of the middle of the control.")
@final_option
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
@click.option("--quiet", is_flag=True, help="Show no progress bar.")
@progress_option
@remote_option
def sigma(folder: Path, output: Path, quiet: bool, **options: Any) -> None:
    """Write the uncertainty of a result as a raster, what the model does not fit included.

    DIR is the folder that a run wrote with --out. The bands are standard deviations of line and
    sample [px], of east and north [m], and 1 outside the hull of the control, where they show
    little.

    \b
    Examples:
      termsel sigma result --height 250 -o sigma.tif --res 10
      termsel sigma result --map map.tif --dem heights.tif -o sigma.tif
    """
    from termsel import TermselError, read_result, require_replaceable
    from termsel_standards.sigma import write_sigma

    for option, excluded in (("dem", "height"), ("like_map", "bounds"), ("like_map", "crs")):
        if options[option] is not None and options[excluded] is not None:
            raise TermselError(f"--{option.removeprefix('like_')} and --{excluded} exclude each "
                               "other",
                               hint="Give one of them.")
    # A GeoTIFF needs a file that can be read back, which stdout is not.
    refuse_stdout(output)
    show_messages()
    require_replaceable([output], reads=[folder, *(options[name] for name in (
        "image", "like_map", "dem"))], overwrite=options["overwrite"])
    result = read_result(folder)
    with share_bar("sigma", quiet) as progress:
        write_sigma(result, output, progress=progress, **options)
    say_written([output])
