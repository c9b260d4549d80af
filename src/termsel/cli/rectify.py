"""The command `termsel rectify`."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from termsel.cli.messages import show_messages
from termsel.errors import TermselError


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.argument("image", metavar="IMAGE", type=click.Path(path_type=Path))
@click.option("--output", "-o", metavar="FILE", required=True, type=click.Path(path_type=Path),
              help="The map to write, a cloud-optimised GeoTIFF.")
@click.option("--dem", metavar="FILE", type=click.Path(path_type=Path),
              help="Raster of heights, of the kind the control has.")
@click.option("--height", type=float, help="Height of the ground, where there is no raster.")
@click.option("--crs", metavar="CRS", help="CRS of the map; that of the control by default.")
@click.option("--res", "resolution", type=click.FloatRange(min=0, min_open=True),
              help="Size of a pixel in units of the CRS; that of the image by default.")
@click.option("--resampling", default="bilinear", show_default=True, metavar="METHOD",
              help="nearest, bilinear, cubic, cubic_spline, lanczos or average.")
@click.option("--nodata", type=float, help="Value where the image shows nothing; that of the "
                                           "image by default, else 0.")
@click.option("--overwrite", is_flag=True, help="Replace a file that is there.")
@click.option("--quiet", is_flag=True, help="No progress bar.")
def rectify(folder: Path, image: Path, output: Path, dem: Path | None, height: float | None,
            crs: str | None, resolution: float | None, resampling: str, nodata: float | None,
            overwrite: bool, quiet: bool) -> None:
    """Resample an image to a map, by GDAL's warper through the fitted model.

    DIR is the folder a run has written with --out.

    \b
    Examples:
      termsel rectify result scene.tif --dem heights.tif -o map.tif --crs EPSG:32639 --res 1
      termsel rectify result scene.tif --height 250 -o map.tif
    """
    if dem is not None and height is not None:
        raise TermselError("--dem and --height exclude each other", hint="Give one of them.")
    show_messages()

    from termsel.io.rectify import rectify as warp
    from termsel.io.result_folder import read_result

    result = read_result(folder)
    if dem is None and height is None and result.fit.model.uses_height:
        raise TermselError("where the image lies on the map depends on the height of the ground",
                           hint="Give --dem FILE or --height H.")
    with _bar(quiet) as progress:
        warp(result, image, output, dem=dem, height=height, crs=crs, resolution=resolution,
             resampling=resampling, nodata=nodata, overwrite=overwrite, progress=progress)
    click.echo(f"Written: {output}", err=True)


@contextmanager
def _bar(quiet: bool) -> Iterator[Callable[[float], None] | None]:
    """Yield what shows the share that is done, None where nobody would see it."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("rectify", total=1.0)
        yield lambda share: bar.update(task, completed=share)
