"""Where tables count lines and samples from: the first pixel's centre or corner, up or down."""

from __future__ import annotations

import logging
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from termsel.core.errors import ONCE, TermselError
from termsel.core.options import Option
from termsel.core.remedies import ReadRemedy
from termsel.data.coordinates.earth import is_mirrored
from termsel.data.distant_rasters import with_dataset
from termsel.data.features import BoolArray, FeatureSet, FloatArray
from termsel.data.rasters import open_raster

log = logging.getLogger(__name__)

TOP, UP, BOTTOM = "top-left", "y-up", "bottom-left"
CORNER = "corner"

EDGE_MARGIN = 5.0
"""How far a feature may lie beyond the edge of the image it was measured in [px]."""

MAX_NAMED = 5
"""Features outside the image that are named; of more it is another image."""

_ORIGIN_WORDS = {
    TOP: "the centre of the upper-left pixel, lines downwards",
    f"{TOP}-{CORNER}": "the outer corner of the upper-left pixel, lines downwards",
    UP: "the centre of the upper-left pixel, y upwards",
    f"{UP}-{CORNER}": "the outer corner of the upper-left pixel, y upwards",
    BOTTOM: "the centre of the lower-left pixel, y upwards",
    f"{BOTTOM}-{CORNER}": "the outer corner of the lower-left pixel, y upwards"}

IMAGE_ORIGIN = Option(
    "image_origin", None, "Origin of lines and samples in a table: top-left, the centre of "
    "the upper-left pixel; corner or top-left-corner, its outer corner, as a GIS counts; "
    "y-up or y-up-corner, likewise with y negative downwards; bottom-left or bottom-left-corner, "
    "with y upwards. By default top-left, or y-up if no line is above 0 and all fit the known "
    "height of the image.", choices=(*_ORIGIN_WORDS, CORNER))


def image_size_of(image: Path | str) -> tuple[int, int]:
    """Return lines and samples of an image."""
    with open_raster(image) as raster:
        return int(raster.height), int(raster.width)


_SHOWN = {"2": "mirrored", "3": "turned by 180 degrees", "4": "mirrored upside down",
          "5": "mirrored and turned by 90 degrees", "6": "turned by 90 degrees",
          "7": "mirrored and turned by 90 degrees", "8": "turned by 90 degrees"}
"""How viewers show an image by the orientation in its EXIF, as GDAL gives it; 1 is as stored."""


def note_on_exif_orientation(image: Path | str) -> None:
    """Note that pixels count as they are stored, if viewers turn the image by its EXIF.

    After half a turn every point is still within the image, and its map is turned: nothing else
    would show that.
    """
    with open_raster(image) as raster:
        shown = _SHOWN.get(with_dataset(raster, _exif_orientation))
    if shown:
        log.warning("Note: by its EXIF viewers show %s %s. Lines and samples count in the pixels "
                    "as they are stored, as in a GIS. If the points were measured in such a "
                    "viewer, give a copy with turned pixels (convert -auto-orient).", image, shown,
                    extra={ONCE: "the orientation in EXIF"})


def _exif_orientation(dataset: Any) -> str:
    """Return the orientation in the EXIF of an open image, "1" to "8"; "" without one."""
    return str(dataset.tags().get("EXIF_Orientation", "")).strip()


def with_image_origin(features: FeatureSet, choice: str | None, states_own: bool,
                      size: tuple[int, int] | None = None, default: str = "") -> FeatureSet:
    """Return features whose image coordinates count from the centre of the upper-left pixel.

    Parameters
    ----------
    features : FeatureSet
    choice : str, optional
        One of the choices of `IMAGE_ORIGIN`.
    states_own : bool
        Whether the format of their file says where it counts from.
    size : tuple of int, optional
        Lines and samples of the image, where the features do not state them.
    default : str, optional
        The choice for the format of their file, where `choice` is None.

    Raises
    ------
    TermselError
        If the choice is not known, or not that of the format; if it needs the height of the image
        and that is not known; if lines are upwards by all signs, and nothing says so.
    """
    size = features.image_size or size
    choice = choice or default or None
    if not states_own:
        _refuse_fractions(features, size)
    if choice is not None:
        origin = str(IMAGE_ORIGIN.parse(choice))
        origin = f"{TOP}-{CORNER}" if origin == CORNER else origin
        if states_own:
            raise TermselError("the format of this file defines the origin of its lines and "
                               "samples", hint="Leave image_origin out.")
        return replace(_turn_to_upper_left(features, origin, size),
                       image_origin=_ORIGIN_WORDS[origin])
    # What follows guesses: a format that states its origin needs none.
    if states_own or not len(features):
        return features
    lines = features.image_vertices()[:, 0]
    # Lines above 0 count downwards; lines a few pixels below 0 are just beyond the upper edge.
    if lines.max() > 0 or lines.min() >= -EDGE_MARGIN:
        return features
    if size is None or lines.min() < -(size[0] - 0.5 + EDGE_MARGIN):
        if size is None:
            size_in_words = "the height of the image is not known"
        else:
            size_in_words = f"the image has {size[0]} lines"
        raise TermselError(
            f"all lines are at most 0, from {lines.min():g} to {lines.max():g}, as if y pointed "
            f"upwards, and {size_in_words}",
            hint="State their origin: --set image_origin=y-up or y-up-corner (QGIS, "
                 "ArcGIS), or top-left to keep them as they are. Or give the image with --image "
                 "FILE.")
    log.warning("Note: no line is above 0, so lines are read as y upwards from the upper-left "
                "pixel. If they count from its corner, give %s.",
                ReadRemedy("image_origin", "y-up-corner"))
    return replace(_turn_to_upper_left(features, UP, size),
                   image_origin=f"{_ORIGIN_WORDS[UP]}, as all lines are at most 0")


_LEAST_FRACTIONS = 3
"""Features from which on fractions of an image are told from places in its first pixel."""


def _refuse_fractions(features: FeatureSet, size: tuple[int, int] | None) -> None:
    """Raise TermselError for lines and samples that all are from 0 to 1, as fractions are.

    Fewer than _LEAST_FRACTIONS positions pass: they may be next to the first pixel. Without `size`
    the message does not say by what to multiply.
    """
    image = features.image_vertices()
    if len(image) < _LEAST_FRACTIONS or (image < 0.0).any() or (image > 1.0).any():
        return
    lines, samples = ("the number of its lines", "that of its samples") if size is None else size
    raise TermselError("all lines and samples are between 0 and 1, as fractions of the image are, "
                       "and image coordinates are pixels",
                       hint=f"Multiply line by {lines}, and sample by {samples}.")


def _turn_to_upper_left(features: FeatureSet, origin: str,
                        size: tuple[int, int] | None) -> FeatureSet:
    """Return features whose image coordinates are turned from an origin to that of termsel.

    `origin` is "y-up", lines that count upwards from 0 as negative numbers, or "bottom-left", with
    "-corner" where the edge and not the centre of a pixel is 0. Raises TermselError where the
    height of the image is needed and not known.
    """
    to_centre = 0.5 if origin.endswith(CORNER) else 0.0
    start = origin.removesuffix(f"-{CORNER}")
    if start == BOTTOM and size is None:
        raise TermselError(f"image_origin={origin} needs the height of the image",
                           hint="Give the image with --image FILE.")

    def turn(image: FloatArray) -> FloatArray:
        """Return line and sample, (..., 2), counted from the centre of the upper-left pixel."""
        line, sample = np.moveaxis(image, -1, 0)
        if start == UP:
            line = -line
        elif start == BOTTOM and size is not None:
            # The last line's centre is at size - 1; with corners its outer edge is at size.
            line = size[0] - 1 + 2 * to_centre - line
        return np.stack([line - to_centre, sample - to_centre], axis=-1)

    points = features.points
    lines = features.lines
    return features.with_(points=replace(points, image=turn(points.image)),
                          lines=replace(lines, image=turn(lines.image)))


def require_inside(features: FeatureSet, size: tuple[int, int] | None,
                   image: Path | str | None) -> None:
    """Raise TermselError for features before the first or after the last pixel of their image.

    Without a size only those before the first pixel are known to be outside. Points that are off
    take no part.
    """
    off = np.array([role == "off" for role in features.points.roles], dtype=bool)
    features = features.with_(points=features.points.take(~off))
    positions = features.image_vertices()
    if not len(positions):
        return
    first = positions.min(axis=0)
    last = positions.max(axis=0)
    before = positions < -0.5 - EDGE_MARGIN
    if size is not None and (last > np.array(size) - 0.5 + EDGE_MARGIN).any():
        beyond = positions > np.array(size) - 0.5 + EDGE_MARGIN
        if (last[::-1] <= np.array(size) - 0.5 + EDGE_MARGIN).all() and not before.any():
            # If the image does not mirror the ground, line and sample are not exchanged: then it is
            # the image that is turned.
            if is_mirrored(features) is False:
                raise TermselError(
                    f"the points fit an image of {size[1]} lines and {size[0]} samples: they "
                    f"extend to line {last[0]:g} and sample {last[1]:g}, and the image has "
                    f"{size[0]} lines and {size[1]} samples", file=image,
                    hint="Is this image turned by 90 degrees, as by its EXIF? Give it as it was "
                         "when the points were measured.")
            raise TermselError(
                f"line and sample look swapped: they extend to line {last[0]:g} and sample "
                f"{last[1]:g}, and the image has {size[0]} lines and {size[1]} samples",
                file=image, hint=f"Exchange them: {ReadRemedy('swapped', 'line-sample')}. Or give "
                                 f"the image in which the {features.word} were measured.")
        reason = (f"but {features.word} extend to line {last[0]:g} and sample {last[1]:g}"
                  f"{_ids_if_few(features, beyond)}")
        raise other_image_error(size, reason, image, _off_option(features, beyond))
    if before.any():
        remedy = f"or take the image in which the {features.word} were measured."
        if before[:, 0].any():
            remedy = f"run again with --set image_origin=y-up or bottom-left, {remedy}"
        raise TermselError(
            f"{features.word} extend to line {first[0]:g} and sample {first[1]:g}, before the "
            f"first pixel of the image{_ids_if_few(features, before)}", file=image,
            hint="Lines are counted downwards and samples to the right from the upper-left pixel: "
                 f"correct them, {remedy}{_off_option(features, before)}")


def _off_option(features: FeatureSet, outside: BoolArray) -> str:
    """Return how the features outside are left out, if only a few are; else ""."""
    ids = _ids_if_few(features, outside).removeprefix(": ")
    if not ids:
        return ""
    return f" Or leave {'them' if ',' in ids else 'it'} out: --off {ids.replace(', ', ',')}."


def _ids_if_few(features: FeatureSet, outside: BoolArray) -> str:
    """Return the ids of the features outside, if only a few are, a slip of the pen; else ""."""
    n = len(features.points)
    feature_of_vertex = np.concatenate([np.arange(n), n + np.repeat(features.lines.feature, 2)])
    ids = [features.ids[i] for i in np.unique(feature_of_vertex[outside.any(axis=1)])]
    return f": {', '.join(ids)}" if len(ids) <= min(MAX_NAMED, len(features) // 3) else ""


def say_other_number(tables: str, image: Path | str) -> None:
    """Warn where points and image have one name but for a number, as of another sheet of a series.

    Scans of a series often have one size, so that nothing else shows it. `tables` are the names of
    the files of features with commas between them.
    """
    stem = Path(tables.split(", ")[0]).name.partition(".")[0]
    image_stem = Path(image).name.partition(".")[0]
    pattern, image_pattern = (re.sub(r"\d+", "#", name.casefold()) for name in (stem, image_stem))
    if "#" in pattern and pattern == image_pattern and stem.casefold() != image_stem.casefold():
        log.warning("Warning: the points are of %s, and the image is %s. Were they measured in it?",
                    Path(tables.split(", ")[0]).name, Path(image).name)


def other_image_error(size: tuple[int, int], reason: str, image: Path | str | None,
                      hint: str = "") -> TermselError:
    """Return the error for an image that is not the one in which features were measured."""
    return TermselError(f"the image has {size[0]} lines and {size[1]} samples, {reason}",
                        file=image,
                        hint=f"Give the image in which the points were measured.{hint}")
