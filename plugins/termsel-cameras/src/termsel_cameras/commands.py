"""Commands of this package: what a series of sheets shares, the camera of a flight."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from termsel import FeatureSet, TermselError, read, require_replaceable
from termsel.toolkit import (
    count_in_words,
    echo,
    parse_settings,
    print_table,
    quiet_logger,
    require_inside,
    say_written,
    show_messages,
    write_text,
)
from termsel.toolkit.commands import COLUMNS_OPTION, say_once, take_reading
from termsel.toolkit.coordinates import LOCAL

if TYPE_CHECKING:
    from termsel_cameras.sheets.choosing import Tried
    from termsel_cameras.sheets.series_file import Series

_PATH = click.Path(path_type=Path)

_OVERWRITE = click.option("--overwrite", is_flag=True, help="Replace an existing file.")


@click.command("map-series")
@click.argument("sheets", nargs=-1, required=True, type=_PATH, metavar="SHEETS...")
@click.option("--crs", metavar="CRS",
              help="CRS of the points of all sheets; by default what they declare, else EPSG:4326.")
@click.option("--prime-meridian", metavar="NAME", help="Meridian that their longitudes count from.")
@click.option("--candidates", type=_PATH, metavar="FILE",
              help="Projections to choose from, a CRS a line.")
@click.option("--century", type=click.IntRange(15, 21), help="Century of the maps.")
@click.option("--output", "-o", type=_PATH, metavar="FILE.json",
              help="File of the series to write; the option series takes it.")
@_OVERWRITE
def map_series(sheets: tuple[Path, ...], crs: str | None, prime_meridian: str | None,
               candidates: Path | None, century: int | None, output: Path | None,
               overwrite: bool) -> None:
    """Find what all sheets of a series share: their projection, and what their paper is like.

    SHEETS are files of points, a sheet each. The projection is chosen in which the points of all of
    them are most probable: an affine map leaves little, and their paper is alike. Scale, turn,
    stretch and shear of the sheets with many points, how much they differ, and what an affine map
    leaves, are what a sheet of few points borrows.

    \b
    Examples:
      termsel map-series sheets/*.csv --prime-meridian ferro
      termsel map-series sheets/*.csv --candidates mine.txt -o series.json
      termsel compare --points 'sheets/*.csv' --crs EPSG:4326 --set series=series.json --out result
    """
    from termsel_cameras.sheets.meridians import meridian_of
    from termsel_cameras.sheets.series_file import series_of

    # Before the sheets are read, as nobody should learn it after the work.
    if output is not None:
        require_replaceable([output], reads=[*sheets, candidates], overwrite=overwrite,
                            written_as="JSON")
    meridian = {}
    if prime_meridian is not None:
        meridian_of(prime_meridian)  # refused before any sheet is
        meridian["prime_meridian"] = prime_meridian
    show_messages()
    with say_once("sheet"):
        read_sheets = [_read_sheet(sheet, crs, meridian) for sheet in sheets]
    if all(sheet.crs in ("", LOCAL) for sheet in read_sheets):
        projection, contradicted_by = "", ""
    else:
        projection, contradicted_by = _choose_projection(read_sheets, candidates, century)
    series = replace(series_of(read_sheets, projection), contradicted_by=contradicted_by)
    _say_paper(series)
    if output is not None:
        write_text(output, series.text())
        say_written([output])


def _read_sheet(sheet: Path, crs: str | None, meridian: dict[str, str]) -> FeatureSet:
    """Return the points of a sheet in `crs`, or else in the CRS that it declares.

    If it declares none, its coordinates are longitudes and latitudes on WGS84. `meridian` has the
    option of the prime meridian, if that is given. Raises TermselError if the file cannot be read,
    or has a CRS that is not known and no longitudes and latitudes.
    """
    try:
        return read(sheet, crs=crs, **meridian)
    except TermselError as error:
        if crs is not None or error.code != "crs-unknown":
            raise
        without_crs = error
    try:
        return read(sheet, crs="EPSG:4326", **meridian)
    except TermselError:
        raise without_crs from None  # they are no longitudes and latitudes


_MAX_LISTED = 3
"""Projections with the same figure that a table lists."""


def _choose_projection(sheets: list[FeatureSet], candidates: Path | None,
                       century: int | None) -> tuple[str, str]:
    """Choose the projection of sheets, print the ranking and the choice, and return two texts.

    These are the CRS of the chosen projection, and the name of a usual projection that is no
    candidate and far more probable than all of them, "" if there is none. `candidates` is a file of
    projections to choose from, and `century` that of the map, if they are given. Raises
    TermselError if no sheet has enough points, or none determines a model.
    """
    ranking = _rank_projections(sheets, candidates, century)
    _print_projections(ranking)
    _print_choice(ranking, len(sheets), "--century" if candidates is None else "--candidates")
    return ranking.best.crs, "" if ranking.better is None else ranking.better.name


@dataclass(frozen=True)
class _Ranking:
    """Projections that were tried: candidates, the most probable first, and the one chosen.

    Those of `as_probable`, with the chosen one, cannot be told apart. `better` is a usual
    projection that is no candidate and contradicts all of them, if there is one.
    """

    ranked: Sequence[Tried]
    best: Tried
    as_probable: Sequence[Tried]
    better: Tried | None = None


def _rank_projections(sheets: list[FeatureSet], candidates: Path | None,
                      century: int | None) -> _Ranking:
    """Return the ranking of the candidates (see `_choose_projection` for arguments and errors).

    It is by the paper that the sheets share, or if too few of them show it, by each for itself;
    then no other projection is compared.
    """
    from termsel_cameras.sheets.candidates import candidates_of
    from termsel_cameras.sheets.choosing import (
        as_probable_as_the_best,
        choose_by_points,
        contradicting,
        rank_by_series,
    )

    projections = candidates_of(sheets, None if candidates is None else str(candidates), century)
    stated = {projection.crs for projection in projections}
    # What no candidate is, is ranked as well: it may be far more probable than all of them.
    others = [usual for usual in candidates_of(sheets, None, None) if usual.crs not in stated]
    # One ranking of all, as blunders, and so the points that count, depend on what is ranked.
    with_others = rank_by_series(sheets, [*projections, *others])
    if not with_others:
        choice = choose_by_points(sheets, projections)
        return _Ranking(choice.ranked, choice.chosen, choice.as_probable)
    ranked = [projection for projection in with_others if projection.crs in stated]
    as_probable = as_probable_as_the_best(ranked, projections)
    return _Ranking(ranked, as_probable[0], as_probable, contradicting(with_others, projections))


def _print_choice(ranking: _Ranking, n_sheets: int, restriction: str) -> None:
    """Print the chosen projection and what is uncertain about it, or that one sheet shows none.

    `restriction` is the option that says which projections are candidates.
    """
    best = ranking.best
    if n_sheets == 1 and len(ranking.ranked) > 1:
        echo("\nOne sheet is no series, and its points show little of a projection: none is "
             "chosen. Give all sheets, or the projection that the map names, in a file of "
             f"--candidates. What follows is in one of the likeliest, {best.name}.")
        return
    echo(f"\nChosen for {count_in_words(n_sheets, 'sheet')}: {best.name}. "
         f"--set projection='{best.crs}'")
    as_good = [projection.name for projection in ranking.as_probable if projection is not best]
    if as_good:
        echo(f"The sheets do not show whether it is this one or another: {', '.join(as_good)}. If "
             "the map names its projection, state that in a file of --candidates.")
    if ranking.better is not None:
        better = ranking.better
        echo(f"Caution: the sheets contradict the projections of {restriction}: in another one, "
             f"{better.name}, they are far more probable, and predicted within {_figure(better)} "
             f"px. Borrowing in {best.name} would make sheets of few points worse, so --set series "
             f"will lend nothing. Leave {restriction} out, or give the projection of the map.")


def _print_projections(ranking: _Ranking) -> None:
    """Print a table of projections, the most probable first.

    Of neighbours with the same printed figure at most `_MAX_LISTED` are listed, the chosen one
    first, and the others counted.
    """
    rows = [(projection.name, _figure(projection), projection.crs)
            for projection in ranking.ranked]
    listed: list[tuple[str, str, str]] = []
    for figure, group in groupby(rows, key=lambda row: row[1]):
        # The chosen one comes first, so that it is always listed.
        equal_rows = sorted(group, key=lambda row: row[0] != ranking.best.name)
        listed += equal_rows[:_MAX_LISTED]
        if len(equal_rows) > _MAX_LISTED:
            listed.append((f"{len(equal_rows) - _MAX_LISTED} more", figure, ""))
    print_table(("projection", "predicted px", "CRS"), listed)


def _figure(projection: Tried) -> str:
    """Return the RMSE that a projection predicts as a table shows it."""
    return f"{projection.rmse:.3g}"


def _say_paper(series: Series) -> None:
    """Print the paper of a series: means and spreads of its scale, turn, stretch and shear.

    The noise follows, which is what an affine map leaves of a sheet, and a warning if the scales
    differ more than those of one series do.
    """
    from termsel_cameras.sheets.paper import paper_of, reason_against

    if not series.sheets:
        echo("No sheet has the 4 points that an estimate of its paper requires.")
        return
    paper = paper_of(series.sheets)
    # Scales are logarithms, so that their spread is a relative one.
    scale, turn, stretch, shear = paper.spreads
    echo(f"Paper by {count_in_words(len(series.sheets), 'sheet')}: {math.exp(paper.means[0]):.5g} "
         f"px per unit of ground (standard deviation {100 * scale:,.2f} %), turn "
         f"{math.degrees(paper.means[1]):.3g} deg ({math.degrees(turn):.2g}), stretch "
         f"{100 * paper.means[2]:.2g} % ({100 * stretch:.2g}), shear {100 * paper.means[3]:.2g} % "
         f"({100 * shear:.2g}); an affine map leaves {paper.noise:.3g} px.")
    if reason_against(paper):
        echo("Caution: the scales of these sheets differ more than those of one series do. Is one "
             "of them of another map, or scanned at another resolution? Then leave it out.")


def _read_photo(photo: Path, size: tuple[int, int], reading: Mapping[str, Any]) -> FeatureSet:
    """Return the points of a photo; raises TermselError if one lies outside its `size`.

    `reading` are arguments of `termsel.read`, such as a CRS and a raster of heights.
    """
    features = read(photo, **reading)
    try:
        require_inside(features, size, photo)
    except TermselError as error:
        error.hint = f"{error.hint} The size is that of --size, lines first."
        raise
    return features


def _reading_of(settings: tuple[str, ...]) -> dict[str, str]:
    """Return the options of reading that --set states.

    Raises TermselError for others, and for those of a camera, which is what is looked for.
    """
    options = parse_settings(settings)
    reading = take_reading(options)
    for name in (*options, *(name for name in reading if name.startswith("camera"))):
        raise TermselError(f"flight-camera has no option {name!r}",
                           hint="--set takes options of reading, such as z_unit=ft; a rough focal "
                                "length is that of --focal.")
    return reading


@click.command("flight-camera")
@click.argument("photos", nargs=-1, required=True, type=_PATH, metavar="PHOTOS...")
@click.option("--crs", metavar="CRS", help="CRS of the points of all photos.")
@click.option("--dem", metavar="FILE", help="Raster of heights for the points of all photos.")
@COLUMNS_OPTION
@click.option("--set", "settings", metavar="KEY=VALUE", multiple=True,
              help="An option of reading, such as z_unit=ft; may be repeated.")
@click.option("--size", nargs=2, type=int, metavar="LINES SAMPLES", required=True,
              help="Size of the photos [px].")
@click.option("--focal", type=click.FloatRange(0, min_open=True), metavar="PX",
              help="Rough focal length, where it is known.")
@click.option("--output", "-o", type=_PATH, required=True, metavar="FILE.json",
              help="Camera file to write; the option camera takes it.")
@_OVERWRITE
def flight_camera(photos: tuple[Path, ...], settings: tuple[str, ...], size: tuple[int, int],
                  focal: float | None, output: Path, overwrite: bool, **reading: str | None,
                  ) -> None:
    """Find the camera that all photos of one flight share, from their control points.

    PHOTOS are files of points, a photo each, with heights of their own or of --dem. Focal length
    and radial distortion are those that the points of all photos together support.

    \b
    Examples:
      termsel flight-camera photos/*.csv --crs EPSG:32633 --size 3648 5472 -o camera.json
      termsel flight-camera photos/*.csv --crs EPSG:32633 --dem dem.tif --size 3648 5472 \\
          -o camera.json
      termsel compare --points 'photos/*.csv' --crs EPSG:32633 --set camera=camera.json --out result
    """
    import json

    from termsel_cameras.known.sharing import shared_camera, unlike_photos

    dem = reading["dem"]
    require_replaceable([output], reads=[*photos, *([Path(dem)] if dem else [])],
                        overwrite=overwrite, written_as="JSON")
    options = {**reading, **_reading_of(settings)}
    show_messages()
    # All photos of a flight have the same notes.
    with say_once("photo"), quiet_logger("termsel.formats.heights", logging.WARNING):
        read_photos = [_read_photo(photo, size, options) for photo in photos]
    camera = shared_camera(read_photos, size, focal)
    content = {"focal": round(camera.focal, 3), "focal_spread": round(camera.spread, 6),
               "distortion": [round(camera.k1, 8)], "size": list(size),
               "source": f"{camera.photos} photos, {camera.points} control points"}
    write_text(output, json.dumps(content, indent=2) + "\n")
    echo(f"Focal length {camera.focal:,.1f} px, standard deviation {100 * camera.spread:.2g} %; "
         f"radial distortion k1 {camera.k1:.3g}; residuals {camera.sigma:.2g} px at "
         f"{count_in_words(camera.points, 'point')} in {count_in_words(camera.photos, 'photo')}.")
    if unlike := unlike_photos(photos, camera.residuals):
        echo(f"Warning: much larger residuals with this camera than in the other photos: "
             f"{', '.join(unlike)}. Check their points, and whether they are of this flight.",
             err=True)
    if camera.photos == 1:
        echo("Note: one photo hardly distinguishes focal length from height of flight. Give the "
             "photos of the whole flight.", err=True)
    say_written([output])
