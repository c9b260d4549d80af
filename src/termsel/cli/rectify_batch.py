"""Maps of all images of a batch, for the command `termsel rectify`."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from termsel.cli.bars import share_bar
from termsel.cli.messages import echo, say_once, say_written
from termsel.cli.tables import print_table
from termsel.cli.usage import without_set
from termsel.core.errors import TermselError, unknown_name_error
from termsel.core.files.atomic import make_folder, write_text
from termsel.core.files.names import is_there, no_such_file_error

if TYPE_CHECKING:
    from termsel.results.result import Result
    from termsel.studies.maps import ImageMap

_FAILED = 1
"""Exit code where a map could not be made; all others are there."""
_MOST_REASONS = 20
"""Images whose reasons a terminal shows."""


def rectify_batch(folder: Path, pictures: Path, out: Path, *, doubtful: bool, dry_run: bool,
                  quiet: bool, **options: Any) -> None:
    """Write a map of every image of a batch whose verdict allows it, and a table of all.

    `options` are those of `termsel.rectify`. With `dry_run` the maps are only listed. Raises
    TermselError, before the first map, where one depends on heights and `options` have none. The
    program ends with the exit code `_FAILED` where a map could not be written.
    """
    from termsel.data.rasters import require_rasterio
    from termsel.studies.maps import (
        FAILED,
        TABLE,
        dem_of_batch,
        first_map_needing_heights,
        plan_maps,
        table_of_maps,
    )

    require_rasterio()
    _require_options(options)
    maps = plan_maps(folder, pictures, out, with_doubtful=doubtful,
                     overwrite=options["overwrite"])
    if options["dem"] is None and options["height"] is None and (
            planned := first_map_needing_heights(maps)) is not None:
        dem = dem_of_batch(folder)
        raise TermselError(f"the position of {planned.image} on the map depends on the height of "
                           "the ground", hint="Give --dem FILE or --height H." if dem is None else
                           f"Give --dem {dem}, as the batch had, or --height H.")
    if not dry_run:
        make_folder(out, "Choose another --output.")
        maps = _write_maps(maps, quiet, options)
    _print_maps(maps)
    if not dry_run:
        write_text(out / TABLE, table_of_maps(maps))
        say_written([out / TABLE])
    # The others are written all the same; scripts see by the exit code that some are not.
    if any(item.state == FAILED for item in maps):
        sys.exit(_FAILED)


def _require_options(options: Mapping[str, Any]) -> None:
    """Raise TermselError for an option with which the map of every image would fail."""
    from termsel.data.coordinates.crs import normalise
    from termsel.io.map_pixels import RESAMPLING

    # It raises for a CRS that is unknown.
    if options["crs"] is not None:
        normalise(options["crs"])
    resampling = options["resampling"]
    if resampling is not None and resampling not in RESAMPLING:
        raise unknown_name_error("resampling", resampling, RESAMPLING)
    dem = options["dem"]
    if dem is not None and not is_there(dem):
        raise no_such_file_error(dem)


def _write_maps(maps: list[ImageMap], quiet: bool, options: Mapping[str, Any]) -> list[ImageMap]:
    """Write maps as planned, under one bar; return the maps with their new states."""
    from termsel.io.rectify import rectify
    from termsel.studies.maps import PLANNED, write_maps

    total = max(sum(item.state == PLANNED for item in maps), 1)
    with say_once(), share_bar("rectify", quiet) as progress:
        finished = 0

        def show_share(share: float) -> None:
            """Show the part of all maps that is finished, given the share of the current one."""
            if progress is not None:
                progress((finished + share) / total)

        def write(result: Result, image: Path, output: Path) -> None:
            nonlocal finished
            rectify(result, image, output, **options, progress=show_share)
            finished += 1

        return list(write_maps(maps, write))


def _print_maps(maps: list[ImageMap]) -> None:
    """Print what comes of the map of each image, and why some have none.

    The table has one row an image, and reasons follow it, as they are too long for a column. Of
    very many reasons the first are printed, and the rest is in the table of the folder.
    """
    from termsel.studies.cells.verdicts import UNFIT
    from termsel.studies.maps import (
        FAILED,
        KEPT,
        LEFT_OUT,
        OUTDATED,
        PLANNED,
        WRITTEN,
        count_of_maps,
    )

    echo(count_of_maps(maps))
    with_map = (PLANNED, WRITTEN, KEPT, OUTDATED)
    rows = [(item.image, item.verdict or "-", item.state,
             str(item.output) if item.state in with_map else "") for item in maps]
    print_table(("image", "verdict", "state", "map"), rows)
    # A message on a file of points begins with its name.
    reasons = [item.why if item.why.startswith(item.image) else f"{item.image}: {item.why}"
               for item in maps if item.state in (OUTDATED, LEFT_OUT, FAILED)]
    for reason in reasons[:_MOST_REASONS]:
        echo(without_set(reason))
    if maps and all(item.state == LEFT_OUT and item.verdict == UNFIT for item in maps):
        echo("No image is fit for use: repeat termsel compare with a larger --accept, or measure "
             "more points")
    if len(reasons) > _MOST_REASONS:
        echo(f"{len(reasons) - _MOST_REASONS} more: the table in the folder of the maps has all "
             "reasons")
