"""The command `termsel rectify`."""

from __future__ import annotations

from pathlib import Path

import click

from termsel.cli.bars import share_bar
from termsel.cli.messages import refuse_stdout, say_written, show_messages
from termsel.cli.options.shared import final_option, progress_option, remote_option
from termsel.cli.rectify_batch import rectify_batch
from termsel.core.errors import TermselError


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.argument("image", metavar="IMAGE", type=click.Path(path_type=Path))
@click.option("--output", "-o", metavar="FILE", required=True, type=click.Path(path_type=Path),
              help="The map to write, a cloud-optimised GeoTIFF; of a batch the folder of maps.")
@click.option("--dem", metavar="FILE", type=click.Path(path_type=Path),
              help="Raster of heights; converted if it declares another vertical datum.")
@click.option("--height", type=float, help="Height of the ground, instead of a raster.")
@click.option("--crs", metavar="CRS", help="CRS of the map; by default that of the control if "
                                           "it is in metres, else UTM.")
@click.option("--res", "resolution", type=click.FloatRange(min=0, min_open=True),
              help="Pixel size in units of the CRS; by default that of the image.")
@click.option("--resampling", metavar="METHOD",
              help="nearest, bilinear, cubic, cubic_spline, lanczos or average. By default "
                   "nearest if pixels are categories (a colour table, bits, classes), otherwise "
                   "bilinear.")
@click.option("--nodata", type=float,
              help="Value outside the image; by default that of the image. Without one the alpha "
                   "band of the image, or a mask inside the file, marks the outside; "
                   "a colour table gets an index that the image does not use, and floating-point "
                   "images NaN.")
@click.option("--sigma", metavar="FILE", type=click.Path(path_type=Path),
              help="Raster of the uncertainty to write, too (termsel-standards).")
@final_option
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
@click.option("--doubtful", is_flag=True,
              help="Of a batch, make maps of doubtful images, too.")
@click.option("--dry-run", is_flag=True, help="Of a batch, show which maps would be written.")
@click.option("--quiet", is_flag=True, help="Show no progress bar.")
@progress_option
@remote_option
@click.pass_context
def rectify(context: click.Context, folder: Path, image: Path, output: Path, dem: Path | None,
            height: float | None, crs: str | None, resolution: float | None,
            resampling: str | None, nodata: float | None, sigma: Path | None, final: bool | None,
            overwrite: bool, doubtful: bool, dry_run: bool, quiet: bool) -> None:
    """Resample an image to a map, or all images of a batch.

    DIR is the folder that a run wrote with --out. It may be that of termsel compare: IMAGE is then
    the folder of the images, which are named like their files of points. Those that are fit for use
    get a map in the folder --output; a table says why others do not. The exit code is 1 if a map
    could not be made.

    \b
    Examples:
      termsel rectify result scene.tif --dem heights.tif -o map.tif --crs EPSG:32639 --res 1
      termsel rectify result scene.tif --height 250 -o map.tif
      termsel rectify sheets scans --output maps --dry-run
    """
    if dem is not None and height is not None:
        raise TermselError("--dem and --height exclude each other", hint="Give one of them.")
    refuse_stdout(output)
    show_messages()

    from termsel.data.cog import require_tiff_name
    from termsel.io.rectify import rectify as warp
    from termsel.io.replacing import require_replaceable
    from termsel.io.result_folder import read_result
    from termsel.studies.maps import is_batch

    if is_batch(folder):
        if sigma is not None:
            raise TermselError("--sigma is for one image, and this is a batch", file=folder,
                               hint="Leave it out, or give the folder of one result.")
        rectify_batch(folder, image, output, doubtful=doubtful, dry_run=dry_run, quiet=quiet,
                      dem=dem, height=height, crs=crs, resolution=resolution,
                      resampling=resampling, nodata=nodata, overwrite=overwrite, final=final)
        return
    if doubtful or dry_run:
        raise TermselError(f"--{'doubtful' if doubtful else 'dry-run'} is for a batch, and this "
                           "is no folder of termsel compare", file=folder, hint="Leave it out.")
    uncertainty = None
    if sigma is not None:
        refuse_stdout(sigma)
        require_tiff_name(sigma)
        # The command of a plugin. It is looked up before the map is made, which may take an hour:
        # without the plugin this raises an error that says what to install.
        group = context.find_root().command
        assert isinstance(group, click.Group)
        uncertainty = group.resolve_command(context, ["sigma"])[1]
        if sigma.absolute() == output.absolute():
            raise TermselError("--sigma and --output name the same file", file=sigma,
                               hint="Give two names.")
    require_replaceable([output] if sigma is None else [output, sigma],
                        reads=[folder, image, dem], overwrite=overwrite)
    result = read_result(folder)
    with share_bar("rectify", quiet) as progress:
        warp(result, image, output, dem=dem, height=height, crs=crs, resolution=resolution,
             resampling=resampling, nodata=nodata, overwrite=overwrite, final=final,
             progress=progress)
    say_written([output])
    if uncertainty is not None:
        context.invoke(uncertainty, folder=folder, output=sigma, like_map=output, dem=dem,
                       height=height, final=final, overwrite=overwrite, quiet=quiet)
