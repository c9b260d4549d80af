"""The commands of this package."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from shlex import quote
from time import monotonic
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from termsel import TermselError, get, require_replaceable
from termsel.toolkit import count_in_words, free_name, make_printable, refuse_link, remote_option

if TYPE_CHECKING:
    from termsel import FeatureSet
    from termsel_match.matchers import Matcher

_FILE = click.Path(path_type=Path)
EVERY = 10.0
"""Seconds between lines of progress where there is no terminal."""
NOT_GOOD_ENOUGH = 3
"""Exit code of `auto-georeference` without a map."""

_START = ("Rough geometry: a file with an RPC, a folder with a result, a file of three points or "
          "more, 'corners' or 'none'. By default that of the image itself.")


class Number(click.FloatRange):
    """A number within limits; nan is none, though no limit excludes it."""

    def convert(self, value: Any, param: click.Parameter | None,
                ctx: click.Context | None) -> float:
        """Return the number of an option's text; NaN fails as any other text does."""
        number = float(super().convert(value, param, ctx))
        # nan is the only number that is not itself, and no limit excludes it.
        return number if number == number else self.fail(f"{value!r} is no number.", param, ctx)


def add_commands(cli: click.Group) -> None:
    """Add the commands to a group."""
    for command in (auto_georeference, match_example, match_lines, match_points, match_ties):
        cli.add_command(command)


def reference_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of commands that look at a reference.

    It is a decorator, shared by all commands that match an image with a map or with another image,
    so that one option has one meaning and one text.
    """
    # click shows options in the opposite order of their decorators.
    for option in reversed((
            click.option("--dem", metavar="FILE", type=_FILE, help="Raster of heights of the "
                                                                   "area."),
            click.option("--start", metavar="START", help=_START),
            click.option("--search", metavar="PX", default=100.0, show_default=True,
                         type=Number(4, 2000),
                         help="Largest distance of a match from the start."),
            click.option("--count", metavar="N", default=200, show_default=True,
                         type=click.IntRange(12, 20000), help="Number of candidates wanted."),
            click.option("--seconds", metavar="S", type=Number(0, min_open=True),
                         help="Time for the matching, which then goes on with what it has."),
            click.option("--mask", "masks", metavar="FILE", multiple=True,
                         help="Polygons in which nothing is matched, on the ground, or in px of "
                              "the image if they have no CRS. By default clouds and water, if "
                              "the bands show them; 'none' for nothing."),
            click.option("--band", type=int, help="Band of the image, from 1; by default the mean "
                                                  "of all."),
            click.option("--reference-band", type=int, help="Band of the reference."),
            click.option("--matcher", metavar="NAME", help="Method that finds similar patches "
                                                           "(termsel list matchers). By default "
                                                           "sift, and structure in cells in "
                                                           "which that finds none."),
            click.option("--set", "settings", metavar="KEY=VALUE", multiple=True,
                         help="Option of the matcher, such as weights=FILE."))):
        command = option(command)
    return command


def matcher_of(name: str | None, settings: tuple[str, ...]) -> Matcher | None:
    """Return the matcher of a name with its options; None, for the usual ones, without a name.

    Raises TermselError for options without a name, or that are not KEY=VALUE.
    """
    if name is None and settings:
        raise TermselError("--set is for options of a matcher, and none is named",
                           hint="Add --matcher NAME.")
    if name is None:
        return None
    pairs = [text.partition("=") for text in settings]
    for text, (key, sign, _) in zip(settings, pairs, strict=True):
        if not (key and sign):
            raise TermselError(f"--set {text!r} is not KEY=VALUE",
                               hint="Give an option and its value, such as weights=FILE.")
    # The matcher itself checks what its options may be.
    matcher: Matcher = get("matchers", name)(**{key: value for key, _, value in pairs})
    return matcher


@click.command("match-points")
@click.argument("image", metavar="IMAGE", type=_FILE)
@click.option("--reference", metavar="FILE", required=True, type=_FILE,
              help="Georeferenced image of the same area, such as an orthophoto.")
@reference_options
@click.option("--output", "-o", metavar="FILE", default="candidates.csv", show_default=True,
              type=_FILE, help="Table of candidate points to write.")
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
@click.option("--quiet", is_flag=True, help="Show no progress.")
@remote_option
def match_points(image: Path, reference: Path, output: Path, overwrite: bool, quiet: bool,
                 matcher: str | None, settings: tuple[str, ...], **options: Any) -> None:
    """Find candidates of control points: places of an image and a map that look alike.

    Some candidates are wrong; `auto-georeference` selects those that agree.

    \b
    Examples:
      termsel match-points scene.tif --reference ortho.tif --dem dem.tif
      termsel auto-georeference scene.tif --points candidates.csv --reference ortho.tif \\
          --dem dem.tif -o map.tif --out result
    """
    from termsel import write_points_csv
    from termsel_match.points.candidates import match_points as match

    # Before minutes of matching, not after.
    refuse_output(output, overwrite, image, reference, *options.values(), written_as="CSV")
    show_log()
    with progress_bar("match-points", quiet) as progress:
        candidates = match(image, reference, progress=progress,
                           matcher=matcher_of(matcher, settings), **options)
    write_points_csv(candidates.points, output, candidates.crs)
    click.echo(f"Start: {candidates.start}")
    # By what was found in each cell: candidates, clouds or nothing.
    cells = sum(candidates.cells.values())
    # A CRS without a code is a text of many lines.
    crs = candidates.crs if len(candidates.crs) < 40 else "of the reference"
    click.echo(f"{len(candidates.points)} candidates in {candidates.cells.get('found', 0)} of "
               f"{cells} cells of the image, CRS {crs}")
    click.echo(f"Written: {output}", err=True)
    next_command = next_map_command(
        image, reference, output, options["dem"], options["start"], options["masks"])
    click.echo(f"Next: {next_command}", err=True)


@click.command("match-lines")
@click.argument("image", metavar="IMAGE", type=_FILE)
@click.option("--vectors", metavar="FILE", required=True, type=_FILE,
              help="Lines of a map, such as roads, in any CRS.")
@click.option("--dem", metavar="FILE", type=_FILE, help="Raster of heights of the area.")
@click.option("--start", metavar="START", help=_START)
@click.option("--search", metavar="PX", default=60.0, show_default=True,
              type=Number(4, 2000), help="Largest distance of a line from the start.")
@click.option("--band", type=int, help="Band of the image, from 1; by default the mean of all.")
@click.option("--iterate", is_flag=True, help="Select, and match again from the new model, until "
                                              "it stays the same.")
@click.option("--out", "folder", metavar="DIR", type=_FILE,
              help="With --iterate, new folder for the result.")
@click.option("--output", "-o", metavar="FILE", default="lines.csv", show_default=True,
              type=_FILE, help="Table of candidate lines to write.")
@click.option("--overwrite", is_flag=True, help="Replace an existing table.")
@click.option("--quiet", is_flag=True, help="Show no progress.")
@remote_option
def match_lines(image: Path, vectors: Path, iterate: bool, folder: Path | None, output: Path,
                overwrite: bool, quiet: bool, **options: Any) -> None:
    """Find candidates of control lines: bands of an image near projected vectors.

    Each straight piece of a vector has up to four candidates, so most are wrong; `termsel run`
    selects those that agree. With --iterate, the table has only those.

    \b
    Examples:
      termsel match-lines scene.tif --vectors roads.gpkg --dem dem.tif
      termsel run --problem matched-lines --model rpc-drift --set rpc=scene.RPB --lines lines.csv
      termsel match-lines scene.tif --vectors roads.gpkg --dem dem.tif --iterate --out result
    """
    from termsel import FeatureSet, write_lines_csv
    from termsel_match.chain import model_for
    from termsel_match.lines.candidates import match_lines as match
    from termsel_match.lines.rounds import iterate_lines

    refuse_output(output, overwrite, image, vectors, *options.values(), written_as="CSV")
    # Only an iteration has a result to keep.
    if folder is not None and not iterate:
        raise TermselError("--out requires --iterate", hint="Add --iterate, or leave --out out.")
    refuse_folder(folder)
    show_log()
    with progress_bar("match-lines", quiet) as progress:
        if iterate:
            # The model of the lines is that which the start allows: an RPC's correction, or affine.
            done = iterate_lines(image, vectors, *model_for(options["start"], image), folder=folder,
                                 progress=progress, **options)
            lines = done.lines
            crs = done.candidates.crs
            text = done.text()
        else:
            candidates = match(image, vectors, progress=progress, **options)
            lines = candidates.lines
            crs = candidates.crs
            text = (f"Start: {candidates.start}\n"
                    f"{len(lines)} candidates for {candidates.pieces} straight "
                    "pieces of vectors\n")
    write_lines_csv(lines, output, crs)
    click.echo(text, nl=False)
    click.echo(f"Written: {output}" + (f", {folder}" if folder is not None else ""), err=True)
    if not iterate:
        features = FeatureSet(lines=lines, crs=crs)
        next_command = next_run_command(options["start"], image, features, output)
        click.echo(f"Next: {next_command}", err=True)


@click.command("match-ties")
@click.argument("images", metavar="IMAGE...", nargs=-1, required=True, type=_FILE)
@click.option("--dem", metavar="FILE", type=_FILE, required=True,
              help="Raster of heights of the area.")
@click.option("--search", metavar="PX", default=100.0, show_default=True,
              type=Number(4, 2000),
              help="Largest distance of a tie from where both geometries see it.")
@click.option("--count", metavar="N", default=200, show_default=True,
              type=click.IntRange(12, 20000), help="Number of ties wanted in each pair of images.")
@click.option("--seconds", metavar="S", type=Number(0, min_open=True),
              help="Time for the matching, which then goes on with what it has.")
@click.option("--mask", "masks", metavar="FILE", multiple=True,
              help="Polygons in px of the images where nothing is matched; see match-points.")
@click.option("--band", type=int, help="Band of all images, from 1; by default the mean of all.")
@click.option("--matcher", metavar="NAME", help="Method that finds similar patches; by default "
                                                "sift.")
@click.option("--set", "settings", metavar="KEY=VALUE", multiple=True,
              help="Option of the matcher, such as weights=FILE.")
@click.option("--output", "-o", metavar="FILE", default="ties.csv", show_default=True,
              type=_FILE, help="Table of ties to write.")
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
@click.option("--quiet", is_flag=True, help="Show no progress.")
@remote_option
def match_ties(images: tuple[Path, ...], dem: Path, output: Path, overwrite: bool, quiet: bool,
               matcher: str | None, settings: tuple[str, ...], **options: Any) -> None:
    """Find tie points: places that two raw images or more show.

    The table id,image,line,sample is what `termsel block` takes. Images are called as their files,
    without the extension. Each needs an RPC.

    \b
    Example:
      termsel match-ties A.tif B.tif C.tif --dem dem.tif -o ties.csv
    """
    from termsel_match.ties.matching import match_ties as match

    refuse_output(output, overwrite, *images, dem, *options["masks"], written_as="CSV")
    show_log()
    with progress_bar("match-ties", quiet) as progress:
        ties = match(images, dem=dem, progress=progress, matcher=matcher_of(matcher, settings),
                     **options)
    ties.write(output)
    click.echo(ties.text(), nl=False)
    click.echo(f"Written: {output}", err=True)
    click.echo("Next: name this file as ties in block.toml, then: termsel block block.toml "
               "--out DIR", err=True)


@click.command("auto-georeference")
@click.argument("image", metavar="IMAGE", type=_FILE)
@click.option("--reference", metavar="FILE", type=_FILE,
              help="Georeferenced image of the same area, such as an orthophoto.")
@click.option("--points", metavar="FILE", type=_FILE,
              help="Candidates that are matched already, by match-points or another program.")
@click.option("--vectors", metavar="FILE", type=_FILE,
              help="Lines of a map, such as roads, to use together with the points.")
@reference_options
@click.option("--output", "-o", metavar="FILE", required=True, type=_FILE,
              help="The map to write, a cloud-optimised GeoTIFF.")
@click.option("--accept", metavar="PX", default=2.0, show_default=True,
              type=Number(0, 1000, min_open=True),
              help="Largest error with which a map is made: the median of all independent "
                   "candidates, the RMSE of those that agree, and the predicted standard "
                   "deviation.")
@click.option("--extent", type=click.Choice(["image", "reference"]), default="image",
              show_default=True, help="What is mapped: all of the image, or what the reference "
                                      "shows.")
@click.option("--out", "folder", metavar="DIR", type=_FILE,
              help="New folder for candidates, result and report.")
@click.option("--seed", default=1, show_default=True, type=click.IntRange(0),
              help="Seed of the selection.")
@click.option("--overwrite", is_flag=True, help="Replace an existing map.")
@click.option("--quiet", is_flag=True, help="Show no progress.")
@click.pass_context
@remote_option
def auto_georeference(context: click.Context, /, image: Path, output: Path, folder: Path | None,
                      dem: Path | None, quiet: bool, matcher: str | None,
                      settings: tuple[str, ...], **options: Any) -> None:
    """Make a map of a raw image: match it, select candidates, judge and rectify.

    Ends with exit code 3 and the reasons, and without a map, if the result is not good enough.

    \b
    Examples:
      termsel auto-georeference scene.tif --reference ortho.tif --dem dem.tif -o map.tif
      termsel auto-georeference scene.tif --reference ortho.tif --dem dem.tif -o map.tif --accept 1
      termsel auto-georeference scene.tif --points candidates.csv --reference ortho.tif \\
          --dem dem.tif -o map.tif --out result
    """
    from termsel_match.chain import georeference_image

    # Before minutes of matching.
    if output.suffix.lower() not in (".tif", ".tiff"):
        raise TermselError(f"a map is written as GeoTIFF, not as {output.suffix or 'a file'}",
                           file=output, hint=f"Name it {output.with_suffix('.tif').name}.")
    refuse_output(output, options["overwrite"], image, dem, *options.values())
    # Required only here: other commands share the option.
    if dem is None:
        raise TermselError("auto-georeference needs the heights of the ground: no DEM is given",
                           hint="Give a raster of heights: --dem FILE.")
    refuse_folder(folder)
    show_log()
    with progress_bar("match", quiet) as progress:
        done = georeference_image(image, output=output, dem=dem, folder=folder, progress=progress,
                                  matcher=matcher_of(matcher, settings), **options)
    click.echo(done.text(), nl=False)
    # A bad map is worse than none: the reasons are in the text above.
    if done.reasons:
        click.echo("No map was written.", err=True)
        context.exit(NOT_GOOD_ENOUGH)
    remarks = count_in_words(len(done.remarks), "remark")
    advice = f"; look at {remarks} above" if done.remarks else ""
    click.echo(f"Written: {output}{advice}", err=True)


@click.command("match-example")
@click.argument("folder", metavar="DIR", type=_FILE)
@click.option("--size", default=1000, show_default=True, type=click.IntRange(200, 4000),
              help="Lines and samples of the image.")
@click.option("--seed", default=1, show_default=True, type=click.IntRange(0),
              help="Draws the place, the image and the RPC.")
@click.option("--off", default=30.0, show_default=True, type=Number(0, 200),
              help="Distance of the vendor's RPC from the truth in px.")
def match_example(folder: Path, size: int, seed: int, off: float) -> None:
    """Render a simulated place: a satellite image, an orthoimage, heights and roads.

    DIR is a new folder. It gets image.tif with the vendor's RPC image.RPB, ortho.tif, dem.tif
    and roads.gpkg. camera.json is the exact camera, and independent.csv has 200 exact places.

    \b
    Example:
      termsel match-example place
    """
    from termsel_match.simulated.world import World
    from termsel_match.simulated.world_files import NAMES, write_world

    world = World(size=size, seed=seed, off=off)
    write_world(world, folder)
    click.echo(f"A simulated place of {world.side / 1000:.1f} km; the RPC is {off:g} px off.")
    click.echo(f"Written: {', '.join(str(folder / name) for name in NAMES)}", err=True)


def next_map_command(image: Path, reference: Path, points: Path, dem: Path | None,
                     start: str | None, masks: Sequence[str] = ()) -> str:
    """Return the command line that makes a map by the candidates in the file `points`.

    `start` and `masks` are those that the candidates were matched with. Without a `dem` the line
    has the word DEM in its place.
    """
    words = ["termsel auto-georeference", quote(str(image)), "--points", quote(str(points)),
             "--reference", quote(str(reference)),
             "--dem", "DEM" if dem is None else quote(str(dem))]
    # The start is needed again: the image itself may state none.
    words += [] if start is None else ["--start", quote(start)]
    for mask in masks:
        words += ["--mask", quote(mask)]
    return " ".join([*words, "-o", free_name("map.tif"), "--out", free_name("result")])


def next_run_command(start: str | None, image: Path, features: FeatureSet, lines: Path) -> str:
    """Return the command line that selects among candidate lines, of which most may be wrong.

    `features` are the candidates, and `lines` is the file that they are in.
    """
    from termsel_match.chain import model_for
    from termsel_match.judgement.structures import model_by_relief

    model, options = model_for(start, image)
    if model == "rpc-drift":
        # A result keeps its RPC in its own files, whose name the user has to give.
        of_result = start is not None and Path(start).is_dir()
        settings = f" --set rpc={'RPC_FILE' if of_result else quote(str(start or image))}"
    else:
        by_relief = model_by_relief(model, options, features)
        model = by_relief.model
        settings = "".join(f" --set {name}={value}" for name, value in by_relief.options.items())
    return (f"termsel run --problem matched-lines --model {model}{settings} "
            f"--lines {quote(str(lines))} --out {free_name('result')}")


def refuse_output(output: Path, overwrite: bool, *reads: object,
                  written_as: str | None = None) -> None:
    """Raise TermselError for an output that may not be written, before any long computation.

    It may not replace a file that is read, nor any other file unless `overwrite`. `written_as` is
    the format in words (see `require_replaceable`). A link is followed if the user typed its name.
    """
    # Nobody has asked for the default name: a link of that name may lead anywhere.
    if click.get_current_context().get_parameter_source("output") is ParameterSource.DEFAULT:
        refuse_link(output)
    require_replaceable([output], reads=reads, overwrite=overwrite, written_as=written_as)


def refuse_folder(folder: Path | None) -> None:
    """Raise TermselError if a folder exists or cannot be made, before any long computation.

    None, for no folder, is accepted.
    """
    if folder is None:
        return
    if folder.exists():
        raise TermselError("this folder exists already", file=folder, hint="Name a new one.")
    # The nearest folder above that exists must allow new ones.
    above = next(parent for parent in folder.absolute().parents if parent.exists())
    if not above.is_dir() or not os.access(above, os.W_OK):
        raise TermselError(f"cannot make this folder: {above} is no folder to write to",
                           file=folder, hint="Choose another --out.")


class _OnStderr(logging.Handler):
    """Writes to what is stderr at the time, as a program may run several commands."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print a message."""
        with suppress(OSError):
            print(make_printable(self.format(record)), file=sys.stderr)


def show_log() -> None:
    """Let the messages that this package logs be printed on stderr from now on."""
    logger = logging.getLogger("termsel.match")
    # A program may run several commands: one handler is enough.
    if not logger.handlers:
        logger.addHandler(_OnStderr())
        logger.setLevel(logging.INFO)
        logger.propagate = False


@contextmanager
def progress_bar(title: str, quiet: bool) -> Iterator[Callable[[float], None] | None]:
    """Yield a function that shows the share that is done (0 to 1); None if `quiet`.

    It draws a bar on a terminal, and writes a line every ten seconds to a log.
    """
    if quiet:
        yield None
        return
    # A bar in a log file would be thousands of lines.
    if sys.stderr.isatty():
        with click.progressbar(length=1000, label=title, file=sys.stderr) as progress_bar:
            # click counts steps, not shares.
            yield lambda share: progress_bar.update(round(1000 * share) - progress_bar.pos)
        return
    last_report = monotonic()

    def say(share: float) -> None:
        """Print the share that is done, unless that was printed less than `EVERY` seconds ago."""
        nonlocal last_report
        if monotonic() - last_report >= EVERY:
            last_report = monotonic()
            click.echo(f"{title}: {100 * share:.0f} %", err=True)

    yield say
