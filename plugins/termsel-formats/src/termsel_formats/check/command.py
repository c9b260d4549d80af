"""The command `termsel check`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

import click

from termsel import TermselError
from termsel.toolkit import (
    echo,
    final_option,
    print_json,
    print_table,
    remote_option,
    show_messages,
)
from termsel.toolkit.charts import rounded_size_text
from termsel.toolkit.coordinates import LOCAL

if TYPE_CHECKING:
    from termsel_formats.check.comparison import Apart, Deviation

WARNING_PX = 1.0
"""Px from which on a deviation is told as a warning."""

HALF_PIXEL_SCATTER = 0.05
"""By how much distances may differ from that of half a pixel and still be told as one [px]."""


@click.command("check")
@click.argument("file", metavar="FILE", type=click.Path(path_type=Path))
@click.option("--result", "folder", metavar="DIR", type=click.Path(path_type=Path),
              help="Folder of a run: how far is what programs take from its model?")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@final_option
@remote_option
def check(file: Path, folder: Path | None, as_json: bool, final: bool | None) -> None:
    """Say which transformation other programs take from a file, and how far it is off.

    FILE is a raster, or a file next to one, such as a world file, an RPC or an .aux.xml. GDAL,
    rasterio, QGIS and the Orfeo ToolBox are asked, as far as they are installed. Or it is the
    certificate of a proof, as termsel run --set certificate=yes writes it: what is claimed, and
    what of it is proved.

    \b
    Examples:
      termsel check map.vrt --result result
      termsel check scene_RPC.TXT --result result
      termsel check scene.tif
      termsel check result/certificate.json
    """
    from termsel import read_result
    from termsel.check import is_certificate, main
    from termsel_formats.check.base import NONE
    from termsel_formats.check.comparison import compare_programs

    show_messages()
    # A certificate is no raster: it is checked by integers, and no program is asked.
    if is_certificate(file):
        if folder is not None or as_json or final is not None:
            raise TermselError("a certificate is checked by itself", file=file,
                               hint="Leave the options out.")
        sys.exit(main([str(file)]))
    result = None if folder is None else read_result(folder)
    try:
        deviations, answers = compare_programs(file, result, final=final)
    except TermselError as error:
        if error.code == "text":
            error.hint = ("Give an image, or a file beside one, such as a world file, an RPC or an "
                          ".aux.xml. Points are for termsel run.")
        raise
    if as_json:
        print_json({"programs": [asdict(deviation) for deviation in deviations],
                    "absent": list(answers.absent), "failed": list(answers.failed)})
        return
    if result is None:
        print_table(("program", "takes"), [(deviation.program, deviation.transformation)
                                           for deviation in deviations])
        echo("Give --result DIR, the folder of a run, to learn how far that is from its model.")
    else:
        echo("Largest distance from the model, at the points with their own heights and over the "
             "image:")
        print_table(("program", "takes", "points [px]", "image [px]", "image [m]"),
                    [_program_row(deviation) for deviation in deviations])
        if {deviation.said or deviation.transformation for deviation in deviations} == {NONE}:
            echo(_ungeoreferenced_warning(file, str(folder), by_rpc=result.fit.model.uses_height))
            deviations = ()
        for deviation in deviations:
            _warn_of_deviation(deviation)
        if _is_without_crs(deviations) and result.features.crs != LOCAL:
            echo(f"Note: {file} states no CRS. Its coordinates are compared as ones of "
                 f"{result.features.crs}, that of the result; programs place it nowhere until they "
                 "are told so.")
    for name in answers.absent:
        echo(f"Not tested: {name}, which is not installed.")
    for message in answers.failed:
        echo(f"No answer: {message}.")


def _ungeoreferenced_warning(file: Path, folder: str, *, by_rpc: bool) -> str:
    """Return the warning that a file is georeferenced for no program, with a command to type.

    The command exports what programs read: an RPC with `by_rpc`, for a model that follows the
    heights, else GCPs.
    """
    to, ending = ("rpc-vrt", ".vrt") if by_rpc else ("gcp-tiff", "-gcps.tif")
    output = file.with_name(f"{file.stem}{ending}")
    return (f"Warning: {file} is georeferenced for none of these programs. What they read is "
            f"written by: termsel export {quote(folder)} --to {to} --image {quote(str(file))} "
            f"-o {quote(str(output))}")


def _program_row(deviation: Deviation) -> tuple[str, ...]:
    """Return a row of the table: program, what it takes or answers, and its largest deviations.

    These are at the points [px] and over the image [px, m]; "" where none is known.
    """
    metres = deviation.over_image.metres if deviation.over_image else None
    return (deviation.program, deviation.said or deviation.transformation,
            _largest_distance_text(deviation.at_points),
            _largest_distance_text(deviation.over_image),
            "" if metres is None else rounded_size_text(metres))


def _largest_distance_text(distances: Apart | None) -> str:
    """Return the largest distance; "" if none is known."""
    return "" if distances is None else rounded_size_text(distances.largest)


def _warn_of_deviation(deviation: Deviation) -> None:
    """Print warnings about what a program takes by default; nothing about what an option asks for.

    A warning is printed if it deviates from the model by more than WARNING_PX at the points or over
    the image, or if no distance is known at all. Where some positions were compared, a note says
    for how many others the program has no ground position, or one that the model cannot project.
    """
    if not deviation.by_default:
        return
    compared = [distances for distances in (deviation.at_points, deviation.over_image)
                if distances is not None]
    worst = max(compared, key=lambda distances: distances.largest, default=None)
    if worst is None:
        echo(f"Warning: {deviation.program.strip()}: no distance from the model is known "
             f"({deviation.said or deviation.transformation}).")
        return
    if worst.largest > WARNING_PX:
        metres = "" if worst.metres is None else f" ({rounded_size_text(worst.metres)} m)"
        echo(f"Warning: {deviation.program} is up to {rounded_size_text(worst.largest)} px{metres} "
             "off the model, near "
             f"line {worst.line:,.1f}, sample {worst.sample:,.1f}: {deviation.transformation}.")
    elif _is_half_a_pixel(worst):
        echo(f"Note: {deviation.program} is half a pixel in line and in sample off the model "
             "everywhere: does the file count from the corner of the first pixel where its centre "
             "is meant, or the other way round?")
    lacking = sum(distances.lacking for distances in compared)
    if lacking:
        echo(f"Note: {deviation.program} has no place for {lacking} of the places asked for.")


def _is_half_a_pixel(distances: Apart) -> bool:
    """Return whether all places are as far off as half a pixel in line and in sample makes."""
    half = 0.5 * 2**0.5  # [px], the diagonal of half a pixel
    return max(abs(distances.rms - half), abs(distances.largest - half)) < HALF_PIXEL_SCATTER


def _is_without_crs(deviations: Sequence[Deviation]) -> bool:
    """Return whether what programs take by default was compared, and none of it has a CRS."""
    taken = [deviation for deviation in deviations
             if deviation.by_default and (deviation.at_points or deviation.over_image)]
    return bool(taken) and not any(deviation.crs for deviation in taken)
