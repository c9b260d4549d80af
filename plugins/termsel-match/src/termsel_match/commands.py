"""The commands of this package."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from termsel import TermselError

_FILE = click.Path(path_type=Path)
_START = ("Rough geometry: a file with an RPC, a folder with a result, a file of three points or "
          "more, 'corners' or 'none'. By default what the image says of itself.")


def add_commands(cli: click.Group) -> None:
    """Add the commands to a group."""
    for command in (match_example, match_points):
        cli.add_command(command)


def reference_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of commands that look at a reference."""
    for option in reversed((
            click.option("--dem", metavar="FILE", type=_FILE, help="Raster of heights of the "
                                                                   "place."),
            click.option("--start", metavar="START", help=_START),
            click.option("--search", metavar="PX", default=100.0, show_default=True,
                         type=click.FloatRange(4, 2000),
                         help="Largest distance of a match from the start."),
            click.option("--count", metavar="N", default=200, show_default=True,
                         type=click.IntRange(12, 20000), help="Number of candidates wanted."),
            click.option("--band", type=int, help="Band of the image, from 1; by default the mean "
                                                  "of all."),
            click.option("--reference-band", type=int, help="Band of the reference."))):
        command = option(command)
    return command


@click.command("match-points")
@click.argument("image", metavar="IMAGE", type=_FILE)
@click.option("--reference", metavar="FILE", required=True, type=_FILE,
              help="Georeferenced image of the place, such as an orthophoto.")
@reference_options
@click.option("--output", "-o", metavar="FILE", default="candidates.csv", show_default=True,
              type=_FILE, help="Table of candidate points to write.")
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
@click.option("--quiet", is_flag=True, help="Show no progress.")
def match_points(image: Path, reference: Path, output: Path, overwrite: bool, quiet: bool,
                 **options: Any) -> None:
    """Find candidates of control points: places of an image and a map that look alike.

    Some candidates are wrong; `termsel run` selects those that agree.

    \b
    Examples:
      termsel match-points scene.tif --reference ortho.tif --dem dem.tif
      termsel run --problem rpc-gcps --set rpc=scene.RPB --points candidates.csv --out result
    """
    from termsel import write_points_csv
    from termsel_match.points import match_points as match

    refuse_existing(output, overwrite)
    show_log()
    with bar("match-points", quiet) as progress:
        found = match(image, reference, progress=progress, **options)
    write_points_csv(found.points, output, found.crs)
    cells = sum(found.cells.values())
    click.echo(f"{len(found.points)} candidates in {found.cells.get('found', 0)} of {cells} cells "
               f"of the image, CRS {found.crs if len(found.crs) < 40 else 'of the reference'}")
    click.echo(f"Written: {output}", err=True)


@click.command("match-example")
@click.argument("folder", metavar="DIR", type=_FILE)
@click.option("--size", default=1000, show_default=True, type=click.IntRange(200, 4000),
              help="Lines and samples of the image.")
@click.option("--seed", default=1, show_default=True, type=click.IntRange(0),
              help="Draws the place, the image and the RPC.")
@click.option("--off", default=30.0, show_default=True, type=click.FloatRange(0, 200),
              help="Distance of the vendor's RPC from the truth in px.")
def match_example(folder: Path, size: int, seed: int, off: float) -> None:
    """Render a simulated place: a satellite image, an orthoimage, heights and roads.

    DIR is a new folder. It gets image.tif with the vendor's RPC image.RPB, ortho.tif, dem.tif
    and roads.gpkg. camera.json is the exact camera, and independent.csv has 200 exact places.

    \b
    Example:
      termsel match-example place
    """
    from termsel_match.world import World
    from termsel_match.world_files import NAMES, write_world

    world = World(size=size, seed=seed, off=off)
    write_world(world, folder)
    click.echo(f"A simulated place of {world.side / 1000:.1f} km; the RPC is {off:g} px off.")
    click.echo(f"Written: {', '.join(str(folder / name) for name in NAMES)}", err=True)


def refuse_existing(output: Path, overwrite: bool) -> None:
    """Refuse to replace a file without permission, before any long computation."""
    if output.exists() and not overwrite:
        raise TermselError("this file exists already", file=output,
                           hint="Give --overwrite to replace it, or another --output.")
    if not output.absolute().parent.is_dir():
        raise TermselError("the folder of this file does not exist", file=output,
                           hint="Make the folder, or give another --output.")


def show_log() -> None:
    """Print what this package logs on stderr."""
    logger = logging.getLogger("termsel.match")
    if not logger.handlers:
        handler = logging.StreamHandler(sys.stderr)
        handler.setFormatter(logging.Formatter("%(message)s"))
        logger.addHandler(handler)
        logger.setLevel(logging.INFO)
        logger.propagate = False


@contextmanager
def bar(title: str, quiet: bool) -> Iterator[Callable[[float], None] | None]:
    """Yield what shows the share that is done, or None where nobody would see it."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    with click.progressbar(length=1000, label=title, file=sys.stderr) as shown:
        yield lambda share: shown.update(round(1000 * share) - shown.pos)
