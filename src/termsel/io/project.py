"""Tables of points, projected by a fitted model in either direction."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from termsel.core.errors import TermselError, count_in_words, first_names_in_words
from termsel.core.files.names import is_there, no_such_file_error
from termsel.data.coordinates.crs import (
    IN_DEGREES,
    WGS84,
    horizontal_crs,
    normalise,
    short_crs_name,
    with_stated_heights,
)
from termsel.data.coordinates.earth import place_of
from termsel.data.coordinates.plausible import check_ground
from termsel.data.features import BoolArray, FeatureSet, FloatArray, Points, select
from termsel.data.tables.columns import COORDINATES, LINES, parse_columns
from termsel.fitting.extrapolation import (
    FAR_OUTSIDE,
    distance_beside_control,
    distance_outside_control,
    far_places_in_words,
)
from termsel.formats.base import error_in_file, read_once
from termsel.formats.heights import Dem, refuse_void, say_difference, surface_of, with_heights
from termsel.formats.readers.csv_tables import table_text
from termsel.formats.readers.geojson_points import table_of_places
from termsel.formats.readers.tables import Table, read_table
from termsel.formats.z_unit import refuse_other_units

if TYPE_CHECKING:
    from termsel.results.result import Result

GIVE_HEIGHTS = "Give heights by --dem FILE or --height H, or in the file."
"""What to do about ground positions without a height."""

log = logging.getLogger(__name__)

_ID = {"id": ("id", "name")}
_OF_QGIS = {"x": ("mapx",), "y": ("mapy",)}
"""What the points of QGIS call the ground, whose image positions are read otherwise."""


def project_table(
    result: Result,
    path: Path,
    *,
    inverse: bool = False,
    dem: Path | None = None,
    height: float | None = None,
    columns: str = "",
    layer: str | None = None,
) -> tuple[str, list[str]]:
    """Return a CSV of points with both their image and ground coordinates, and warnings.

    The table at `path` has x, y and, for models with height, z, or is a vector file of points;
    blank and missing heights are those of the raster `dem` or the one `height`. With `inverse`,
    from the image to the ground, it has line and sample, and `dem` or `height` is the ground, or
    else the heights z of the table; models without height need none of them. `layer` names a layer
    of a vector file or a sheet of a spreadsheet.

    The CSV is headed id,line,sample,x,y,z,uncertainty_line,uncertainty_sample,outside: standard
    deviations of what the model predicts (`termsel.Fit.sigma`), and how far a place is outside the
    control that the model was fitted to (`termsel.fitting.extrapolation.distance_outside_control`).
    The warnings name points without a place, with the reason where it is known, and those far
    outside the control. Raises TermselError for tables that cannot be read, a CRS other than that
    of the control, and heights that are missing.
    """
    crs = result.fit.control.crs
    if dem is not None and height is not None:
        raise TermselError("--dem and --height exclude each other", hint="Give one of them.")
    if height is not None and not np.isfinite(height):
        raise TermselError(f"the height of the ground cannot be {height}",
                           hint="Give a finite number.")
    to_other_positions = _locate_points if inverse else _project_points
    ids, image, ground = to_other_positions(result, path, columns, dem, height, layer)
    with np.errstate(all="ignore"):
        sigma = result.sigma(ground)
    sigma[~np.isfinite(sigma)] = np.nan
    control = result.exported.control_ground()
    distances = distance_beside_control(control, ground, result.fit.control)
    # Two points, or points in a line, enclose no area.
    encloses = bool(np.isfinite(distance_outside_control(control, control[:1])[0]))
    if not encloses:
        distances[:] = np.nan
    values = np.column_stack([image, ground, sigma, distances])
    # Line, sample, x and y; heights may be unknown.
    missed: BoolArray = np.asarray(np.isnan(values[:, :4]).any(axis=1))
    header = ["id", "line", "sample", "x", "y", "z", "uncertainty_line",
              "uncertainty_sample", "outside"]
    text = table_text(crs, header, [[name] for name in ids], values)
    # The view itself, and not a fault of the model, is why there is no position.
    hidden = missed & (result.exported.above_horizon(image) if inverse else
                       np.isfinite(ground[:, :2]).all(axis=1) & result.exported.unseen(ground))
    off_image = _are_off_image(result, image) & missed & ~hidden if inverse else missed & False
    known = result.exported.model.known_image()
    has_other_lines = known is not None and known.lines is not None
    warnings = list(_projection_warnings(
        select(ids, missed & ~hidden & ~off_image), select(ids, hidden), select(ids, off_image),
        encloses=encloses, inverse=inverse, has_other_lines=has_other_lines))
    is_far = ~missed & (distances > FAR_OUTSIDE)
    if is_far.any():
        warnings.append(far_places_in_words(control, ground[is_far], select(ids, is_far)))
    if known is not None and has_other_lines and missed.any():
        warnings.append(known.sentence())
    return text, warnings


def _locate_points(result: Result, path: Path, columns: str, dem: Path | None,
                   height: float | None, layer: str | None,
                   ) -> tuple[list[str], FloatArray, FloatArray]:
    """Return ids, image positions (n, 2) of a table, and the ground positions (n, 3) seen there.

    The ground is the raster `dem`, level at `height`, or at the heights z of the table; without any
    of these, as for a model without heights, it is level at 0, and its heights are returned as NaN.
    A note says if the table has heights that are not used. Arguments and errors are those of
    `project_table`.
    """
    model = result.fit.model
    crs = result.fit.control.crs
    by_table = model.uses_height and dem is None and height is None
    names = ["line", "sample", "z"] if by_table else ["line", "sample"]
    try:
        table = _read_table(path, columns, *names, layer=layer, flat=by_table)
    except TermselError as error:
        if error.code == "column-missing" and _has_columns(path, columns, "x", "y", layer=layer):
            error.hint = ("These are ground positions: leave --inverse out for their positions "
                          "in the image.")
        raise
    image = table.stack("line", "sample")
    heights = _heights_on_ground(table, crs, path) if by_table else None
    # A stated surface goes before the heights of the table; who has both should know.
    if model.uses_height and not by_table and _has_columns(path, columns, "z", layer=layer):
        log.warning("Note: the heights z of %s are not used, as %s is given.", path.name,
                    "--height" if dem is None else "--dem")
    with surface_of(dem, crs, 0.0 if height is None else height) as surface:
        if heights is None:
            say_difference(result.features, result.project, surface)
        ground = result.locate(image, surface if heights is None else heights)
        if (isinstance(surface, Dem) and not np.isfinite(ground).any()
                and _is_elsewhere(surface, result.fit.control.ground_vertices())):
            raise TermselError("this raster of heights does not cover the control, which is "
                               f"around {place_of(result.fit.control)}", file=dem,
                               hint="Give a raster of that area.")
    if dem is None and height is None and heights is None:
        ground[:, 2] = np.nan
    return table.ids(), image, ground


def _project_points(result: Result, path: Path, columns: str, dem: Path | None,
                    height: float | None, layer: str | None,
                    ) -> tuple[list[str], FloatArray, FloatArray]:
    """Return ids, image positions (n, 2), and the ground positions (n, 3) of a table.

    Returns NaN for image positions that the model does not compute. Arguments and errors are those
    of `project_table`.
    """
    try:
        ids, ground = read_ground(result, path, columns, dem, height, layer)
    except TermselError as error:
        if error.code == "image-alone":
            error.hint = ("These are image positions: add --inverse, with --dem FILE or "
                          "--height H, for ground positions.")
        elif error.code == "column-missing" and result.fit.model.uses_height:
            error.hint = f"{error.hint} Without z: --dem FILE or --height H."
        elif error.code == "height-missing" and error.line is None:
            error.hint = f"{error.hint} Name a column of heights: --columns z=NAME."
        raise
    with np.errstate(all="ignore"):
        image = result.project(ground)
    # At a pole of the model a position is infinite, and no more use than an unknown one.
    image[~np.isfinite(image)] = np.nan
    return ids, image, ground


def _heights_on_ground(table: Table, crs: str, path: Path) -> FloatArray:
    """Return the heights z (n,) of image positions of a table.

    Raises TermselError where there are none, some are blank, or they are of another CRS or unit
    than the control's.
    """
    if not any(cell.strip() for cell in table.columns.get("z", ())):
        raise TermselError("the ground position depends on the height",
                           hint="Give --dem FILE or --height H, or a column z.")
    _require_crs_and_heights(table, crs, path, True, True)
    try:
        refuse_other_units(table.named_units(), crs)
    except TermselError as error:
        raise error_in_file(error, path) from error
    heights = table.stack("z")[:, 0]
    blank = np.flatnonzero(np.isnan(heights))
    if blank.size:
        raise table.error("the height is blank, and the ground position depends on it",
                          int(blank[0]), "z", "Give it, or --dem FILE or --height H for all.")
    return heights


def _is_elsewhere(surface: Dem, control: FloatArray) -> bool:
    """Return whether a raster has no ground in common with the box around control (v, 3)."""
    corners = surface.extent()
    low, high = control[:, :2].min(axis=0), control[:, :2].max(axis=0)
    return bool(((corners.max(axis=0) < low) | (corners.min(axis=0) > high)).any())


def _are_off_image(result: Result, image: FloatArray) -> BoolArray:
    """Return which image positions (n, 2) are outside the image, (n,)."""
    first, last = np.array(result.fit.image_box())
    return np.asarray(((image < first - 1.0) | (image > last + 1.0)).any(axis=1))


def _projection_warnings(missed: Sequence[str], hidden: Sequence[str], off_image: Sequence[str],
                         *, encloses: bool, inverse: bool,
                         has_other_lines: bool) -> Iterator[str]:
    """Yield clauses on points that were not projected or located.

    Parameters
    ----------
    missed, hidden, off_image : sequence of str
        Ids of points: without a position for no known reason; that the image cannot show; outside
        the image, and without a position.
    encloses : bool
        Whether the control encloses an area.
    inverse : bool
        Whether image positions were located on the ground.
    has_other_lines : bool
        Whether the model is of some lines of the image alone.
    """
    if not encloses:
        yield "the control encloses no area, so `outside` cannot be computed"
    # What the view itself explains comes before what nobody can explain.
    if hidden:
        where = ("in other lines than those of the model" if has_other_lines
                 else "behind the camera or beyond the horizon")
        show, lie, them = (("shows", "lies", "it") if len(hidden) == 1 else
                           ("show", "lie", "them"))
        if inverse:
            reason = f"{show} no ground, as above the horizon"
        else:
            reason = f"{lie} {where}, and no image shows {them}"
        yield (f"{count_in_words(len(hidden), 'point')} {reason}: "
               f"{first_names_in_words(hidden)}")
    if missed:
        yield (f"no position was found for {count_in_words(len(missed), 'point')}: "
               f"{first_names_in_words(missed)}")
    if off_image:
        yield (f"no position was found for {count_in_words(len(off_image), 'point')} outside the "
               f"image: {first_names_in_words(off_image)}. Check the lines and samples")


def read_ground(result: Result, path: Path, columns: str = "", dem: Path | None = None,
                height: float | None = None, layer: str | None = None,
                ) -> tuple[list[str], FloatArray]:
    """Return ids and ground positions, shape (n, 3), of a table in the CRS of a result's control.

    Parameters
    ----------
    result : Result
        Its model says whether heights are needed, its control the CRS.
    path, columns, layer
        The arguments of `project_table`.
    dem, height : optional
        The raster or the number from which blank heights are taken.

    Raises
    ------
    TermselError
        For a table without ground positions, of another CRS or unit, or lacking heights.
    """
    model = result.fit.model
    crs = result.fit.control.crs
    names = ("x", "y", "z") if model.uses_height else ("x", "y")
    fills_heights = dem is not None or height is not None
    if height is not None:
        refuse_void(height)
    # A raster that is missing is refused even where no height is blank.
    if dem is not None and not is_there(dem):
        raise no_such_file_error(dem)
    try:
        table = _read_table(path, columns, *names, layer=layer, flat=model.uses_height)
    except TermselError as error:
        if error.code != "column-missing":
            raise
        if _has_columns(path, columns, "line", "sample", layer=layer):
            error.code = "image-alone"
            error.hint = (f"These are image positions; ground positions {','.join(names)} are "
                          "needed. termsel project --inverse computes them.")
        elif _has_columns(path, columns, "x1", "y1", "x2", "y2", layer=layer):
            error.code = "lines"
            error.hint = f"These are lines, and points are needed: a table id,{','.join(names)}."
        raise
    _require_crs_and_heights(table, crs, path, model.uses_height, fills_heights)
    try:
        refuse_other_units(table.named_units(), crs)
    except TermselError as error:
        raise error_in_file(error, path) from error
    ground = np.full((len(table.lines), 3), np.nan)
    if IN_DEGREES in crs and not table.crs and not table.named_units():
        log.warning("Warning: the control was not in degrees, but this table is read as degrees. "
                    "If it is in gons (grads), name its columns x_gon and y_gon.")
    # There may be no column of heights.
    present = [name for name in names if name in table.columns]
    ground[:, :len(present)] = table.stack(*present)
    ids = table.ids()
    _require_crs_of_control(ids, ground, crs, path)
    if not model.uses_height:
        if fills_heights:
            log.warning("Note: the model does not use heights, so %s is not used.",
                        "--height" if dem is None else "--dem")
        return ids, ground
    blank = np.flatnonzero(np.isnan(ground[:, 2]))
    if fills_heights and not blank.size:
        log.warning("Note: all points have heights, so %s is not used.",
                    "--height" if dem is None else "--dem")
    elif blank.size and dem is not None:
        places = FeatureSet(Points(tuple(ids), np.zeros((len(ids), 2)), ground), crs=crs)
        ground = with_heights(places, dem).points.ground
    elif height is not None:
        ground[blank, 2] = height
    elif blank.size:
        missing = table.error("the height is blank, but the model requires it", int(blank[0]), "z",
                              GIVE_HEIGHTS)
        missing.code = "height-missing"
        raise missing
    return ids, ground


def _require_crs_and_heights(table: Table, crs: str, path: Path, uses_height: bool,
                             fills_heights: bool) -> None:
    """Raise TermselError for a table in another CRS than the control, without heights, or both.

    A model that `uses_height` needs a column of them, unless a raster or a number
    `fills_heights`.
    """
    problems = []
    remedies = []
    if table.crs and not _is_crs_of_control(table.crs, normalise(crs), uses_height):
        names = short_crs_name(table.crs), short_crs_name(crs)
        problems.append(f"the file declares the CRS {names[0]}, but the control is in {names[1]}")
        remedies.append("Transform the points to the CRS of the control" + (
            f": gdaltransform -s_srs {names[0]} -t_srs {names[1]} takes and prints lines of x y z, "
            "without a header."
            if all(name.startswith("EPSG:") for name in names) else "."))
    # Both faults in one message, so that the user need not try twice.
    lacks_heights = uses_height and not fills_heights and "z" not in table.columns
    if lacks_heights:
        problems.append("there is no column for z, and the model requires heights")
        remedies.append(GIVE_HEIGHTS)
    if problems:
        raise TermselError("; and ".join(problems), file=path, hint=" ".join(remedies),
                           column=None if len(problems) > 1 or table.crs else "z",
                           code="height-missing" if lacks_heights else "")


def _is_crs_of_control(crs: str, control: str, uses_height: bool) -> bool:
    """Return whether a CRS is that of the control, but for what either does not say of heights."""
    if control in (crs, with_stated_heights(crs, control)) or WGS84.issuperset((crs, control)):
        return True
    return not uses_height and horizontal_crs(crs) == horizontal_crs(control)


def _require_crs_of_control(ids: Sequence[str], ground: FloatArray, crs: str, path: Path) -> None:
    """Raise TermselError for ground positions that cannot be in the CRS of the control.

    `ids` and `ground` (n, 3) are of the points of the file `path`, which the error names.
    """
    # Ranges and swapped columns are checked as those of features, with any image positions.
    try:
        places = FeatureSet(Points(tuple(ids), np.zeros((len(ids), 2)), ground), crs=crs)
    except TermselError as error:
        raise error_in_file(error, path) from error
    try:
        check_ground(places)
    except TermselError as error:
        error.file = path
        if error.column == "z":
            raise
        swapped = "The columns look swapped. " if "swapped" in (error.hint or "") else ""
        error.hint = (f"{swapped}The points must be in the CRS of the control, "
                      f"{short_crs_name(crs)}: transform them to it.")
        raise


def _has_columns(path: Path, columns: str, *coordinates: str, layer: str | None) -> bool:
    """Return whether a table has columns of some coordinates, such as "line" and "sample"."""
    try:
        _read_table(path, columns, *coordinates, layer=layer)
    except TermselError:
        return False
    return True


def _read_table(path: Path, columns: str, *coordinates: str, layer: str | None,
                flat: bool = False) -> Table:
    """Return the table of a file of text, of a spreadsheet, or of the points of a vector file.

    Parameters
    ----------
    path : Path
    columns : str
        The value of --columns, which says which heading stands for which coordinate.
    *coordinates : str
        The coordinates whose columns the table must have: "x", "y", "z", "line", "sample", or
        those of a table of lines, such as "x1".
    layer : str or None
        The layer of a vector file or sheet of a spreadsheet; None for the first that has points.
    flat : bool
        Whether heights may be missing.

    Raises
    ------
    TermselError
        If the file cannot be read, or lacks the column of a coordinate.
    """
    accepted = LINES | COORDINATES
    aliases = _ID | {name: (*accepted[name], *_OF_QGIS.get(name, ())) for name in coordinates}
    table = table_of_places(path, aliases, parse_columns(columns), layer=layer, flat=flat)
    if table is not None:
        return table
    # The file is no vector file, but text or a spreadsheet.
    with read_once(path) as file:
        return replace(read_table(file, aliases, columns=columns, layer=layer, flat=flat),
                       path=path)
