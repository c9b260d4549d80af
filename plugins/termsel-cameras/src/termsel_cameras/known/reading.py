"""Where a camera is read from: options, and the EXIF of the image."""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from termsel import FeatureSet, TermselError, open_raster
from termsel.toolkit import ONCE, with_dataset
from termsel.toolkit.coordinates import LOCAL, transformation_between
from termsel_cameras.known.cameras import CAMERAS
from termsel_cameras.known.interior import (
    FROM_EXIF,
    INTERIOR_NAMES,
    INTERIOR_OPTIONS,
    Interior,
    interior_of,
)

log = logging.getLogger("termsel.cameras")

DIAGONAL = float(np.hypot(36.0, 24.0))
"""Diagonal of film of 36 mm by 24, to which equivalent focal lengths refer [mm]."""

EXIF_POSITION_SPREAD, EXIF_HEIGHT_SPREAD = 30.0, 500.0
"""Standard deviations of a position in EXIF in plan and in height [m]. Heights of drones count from
the take-off, and others from the sea or from the ellipsoid; nothing in the EXIF says which."""

_DIGITS = re.compile(r"\d+(?:\.\d+)?")


class CameraOptions:
    """Options of reading that say what is known of the camera of a photo."""

    options = INTERIOR_OPTIONS

    def read(self, features: FeatureSet, options_given: Mapping[str, Any],
             image: Path | str | None) -> FeatureSet:
        """Return features with what is stated of the camera as columns of the points.

        The EXIF of the image states it where neither options nor columns name a camera or a focal
        length. The features are returned as they are if nothing states anything. Notes are logged
        on what the EXIF stated, and if nothing shows the principal point. Raises TermselError for
        options that cannot be understood, or that are of no use without points or a focal length.
        """
        stated = self._stated_options(features, options_given, image)
        if not stated:
            return features
        if not len(features.points):
            raise TermselError("the camera of a photo is for control points, and there are none",
                               hint="Leave the options of the camera out.")
        columns = {name: np.array([value] * len(features.points), dtype=object)
                   for name, value in stated.items()}
        described = replace(features, points=replace(
            features.points, attributes={**features.points.attributes, **columns}))
        # Options are refused here if they cannot be understood, as the choice of a model would pass
        # over the camera in silence.
        typed_names = [name for name in INTERIOR_NAMES if options_given.get(name) is not None]
        interior = interior_of(described)
        if typed_names and interior is None:
            raise TermselError(
                f"{', '.join(typed_names)} {'is' if len(typed_names) == 1 else 'are'} of a camera "
                "whose focal length nothing states",
                hint="Add camera_focal, or camera with its name or file; or leave "
                     f"{'it' if len(typed_names) == 1 else 'them'} out.", name=typed_names[0])
        if interior is not None and not np.isfinite(interior.line):
            log.warning("Note: nothing shows the size of the image, so the principal point is "
                        "taken to be somewhere about the middle of the points, and a photo of few "
                        "points is less accurate. --image FILE or --set "
                        "camera_principal_point=LINE,SAMPLE shows it.",
                        extra={ONCE: "the size of the image"})
        if interior is not None and interior.from_exif:
            log.warning("Note: %s", _exif_in_words(interior), extra={ONCE: "the camera in EXIF"})
        return described

    @staticmethod
    def _stated_options(features: FeatureSet, options_given: Mapping[str, Any],
                        image: Path | str | None) -> dict[str, str]:
        """Return the options of the camera that the user or the EXIF of the image states, as texts.

        Options of the user come before the EXIF, which is read only if a camera or a focal length
        is stated neither by them nor by columns. `FROM_EXIF` then names the options of the EXIF. A
        focal length in mm gets the size of a pixel from the EXIF, too.
        """
        stated = {name: str(options_given[name]) for name in INTERIOR_NAMES
                  if options_given.get(name) is not None}
        if image is None:
            return stated
        # Either of these two says which camera it is.
        sources = {"camera", "camera_focal"}
        if not sources & stated.keys() and not sources & features.points.attributes.keys():
            exif = options_of_exif(Path(image), features)
            from_exif = " ".join(name for name in exif if name not in stated)
            stated = {**exif, **stated, **({FROM_EXIF: from_exif} if exif else {})}
        in_mm = stated.get("camera_focal", "").lower().rstrip().endswith("mm")
        if in_mm and not {"camera", "camera_pixel"} & stated.keys():
            stated = _with_pixel(stated, Path(image))
        return stated


def _exif_in_words(interior: Interior) -> str:
    """Return a sentence on what the EXIF states of the camera, how well, and how to state another.
    """
    focal = (f"the focal length of the camera, {interior.focal:,.0f} px to "
             f"{100.0 * interior.focal_spread:.2g} %,")
    source = "taken from the EXIF of the image (one standard deviation each)"
    if not interior.has_exif_position:
        return f"{focal} is {source}. --set camera_focal=PIXELS states another."
    return (f"{focal} and its position, to {interior.position_spread:g} m in plan and "
            f"{interior.position_height_spread:g} m in height, are {source}. "
            "--set camera_focal=PIXELS and --set camera_position=X,Y,Z state others.")


def options_of_exif(image: Path, features: FeatureSet) -> dict[str, str]:
    """Return what the EXIF of an image states of its camera, by the names of options.

    {} if it states neither a known camera nor a focal length.
    """
    size, tags = _size_and_tags(image)
    focal = _focal_of(tags, size)
    if not focal:
        return {}
    return {**focal, **_position_of(tags, features.crs)}


def exif_tags(dataset: Any) -> dict[str, str]:
    """Return the EXIF tags of an open image, as GDAL names them, without its prefix."""
    return {name.removeprefix("EXIF_"): value for name, value in dataset.tags().items()
            if name.startswith("EXIF_")}


def _focal_of(tags: Mapping[str, str], size: tuple[int, int]) -> dict[str, str]:
    """Return the option `camera` if the camera is known, or else `camera_focal` [px].

    {} if the tags show neither. `size` is lines and samples of the image.
    """
    # Cameras of the list are named by make and model, such as dji-fc6310.
    model = " ".join((tags.get("Make", ""), tags.get("Model", ""))).strip().lower()
    name = model.replace(" ", "-")
    if name in CAMERAS:
        return {"camera": name}
    # An equivalent focal length is for a frame of 36 by 24 mm: f / diagonal is the same in both.
    diagonal_pixels = float(np.hypot(*size))
    equivalent = _number(tags.get("FocalLengthIn35mmFilm", ""))
    if equivalent > 0.0:
        return {"camera_focal": f"{equivalent / DIAGONAL * diagonal_pixels:.1f}"}
    focal = _number(tags.get("FocalLength", ""))
    pixel = _pixel_of(tags, size)
    return {"camera_focal": f"{focal / pixel:.1f}"} if focal > 0.0 and pixel > 0.0 else {}


def _pixel_of(tags: Mapping[str, str], size: tuple[int, int]) -> float:
    """Return the size of a pixel [mm] by EXIF, its resolution or its focal lengths; 0 without both.
    """
    per_unit = _number(tags.get("FocalPlaneXResolution", ""))
    # Millimetres of EXIF's units of resolution: 2 is an inch, 3 a centimetre.
    unit = {2: 25.4, 3: 10.0}.get(round(_number(tags.get("FocalPlaneResolutionUnit", "2"))), 0.0)
    if per_unit > 0.0 and unit > 0.0:
        # The resolution is of the sensor, of which the image may be a smaller copy.
        full_width = _number(tags.get("PixelXDimension", "")) or max(size)
        return unit / per_unit * full_width / max(size)
    focal = _number(tags.get("FocalLength", ""))
    equivalent = _number(tags.get("FocalLengthIn35mmFilm", ""))
    # The equivalent focal length is by DIAGONAL as the real one is by the diagonal of the sensor.
    return DIAGONAL * focal / (equivalent * float(np.hypot(*size))) if equivalent > 0.0 else 0.0


def _with_pixel(stated: Mapping[str, str], image: Path) -> dict[str, str]:
    """Return options with `camera_pixel` by EXIF, which a focal length in mm requires.

    Raises TermselError if the image does not state it.
    """
    size, tags = _size_and_tags(image)
    pixel = _pixel_of(tags, size)
    # Numbers too long for a float make it NaN, which is refused too.
    if not pixel > 0.0:
        raise TermselError(
            f"camera_focal={stated['camera_focal']} is in mm, and the image has no EXIF that says "
            "how large its pixels are", file=image, name="camera_focal",
            hint="Add their size in micrometres, such as --set camera_pixel=4.4, or the name of "
                 "the camera, or give camera_focal in px.")
    return {**stated, "camera_pixel": f"{1e3 * pixel:.6g}"}


def _size_and_tags(image: Path) -> tuple[tuple[int, int], dict[str, str]]:
    """Return lines and samples of an image, and its EXIF tags."""
    with open_raster(image) as raster:
        return (int(raster.height), int(raster.width)), with_dataset(raster, exif_tags)


def _position_of(tags: Mapping[str, str], crs: str) -> dict[str, str]:
    """Return the option `camera_position` in a CRS, with its standard deviations.

    {} if the tags have no position or height, if there is no CRS of the Earth, or if the position
    has no coordinates in it.
    """
    latitude, longitude = (
        _parse_degrees(tags.get(f"GPS{name}", "")) for name in ("Latitude", "Longitude"))
    if crs in ("", LOCAL) or latitude is None or longitude is None or "GPSAltitude" not in tags:
        return {}
    # EXIF states degrees without signs, and the hemispheres apart.
    south = tags.get("GPSLatitudeRef", "N").strip().upper() == "S"
    west = tags.get("GPSLongitudeRef", "E").strip().upper() == "W"
    position = np.array([[-longitude if west else longitude, -latitude if south else latitude,
                          _number(tags["GPSAltitude"])]])
    in_crs = transformation_between("EPSG:4979", crs)(position)[0]
    if not np.isfinite(in_crs).all():
        return {}
    x, y, z = in_crs.tolist()
    return {"camera_position": f"{x!r},{y!r},{z!r},{EXIF_POSITION_SPREAD:g},"
                               f"{EXIF_HEIGHT_SPREAD:g}"}


def _number(text: str) -> float:
    """Return the first number of a tag such as "(8.8)"; 0 without one."""
    match = _DIGITS.search(text)
    return float(match.group()) if match else 0.0


def _parse_degrees(text: str) -> float | None:
    """Return degrees of "(46) (30) (12.3)"; None of another text."""
    numbers = [float(number) for number in _DIGITS.findall(text)]
    if len(numbers) != 3:
        return None
    degrees, minutes, seconds = numbers
    return degrees + minutes / 60.0 + seconds / 3600.0
