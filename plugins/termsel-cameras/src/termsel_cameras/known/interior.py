"""What is known of a camera before its points are looked at, as columns of the points state it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from termsel import FeatureSet, Option, TermselError
from termsel_cameras.known.cameras import SurveyCamera, camera_named

FOCAL_SPREAD = 0.01
"""Relative standard deviation of a focal length that is stated in px: film shrinks and scans are
enlarged by some parts in a thousand."""

SCANNED_SPREAD = 0.03
"""The same where the scale of a scan is told by its width, which margins enlarge."""

_STATED_PIXEL_SPREAD = 0.003
"""Relative standard deviation of the size of a pixel that is stated."""

_SENSOR_SPREAD = 0.002
"""The same where it follows from the width and the pixels of a sensor."""

_SAME_SHAPE = 0.01
"""Relative difference of the shorter sides below which an image has the shape of a sensor."""

REACH = 0.002
"""Scale of the prior of the principal point about the middle of the image, by its half diagonal."""

STATED_REACH = 0.0005
"""The same about a principal point that is stated."""

POSITION_SPREAD = 50.0
"""Standard deviation of a position without one [m]: a navigator's, or a phone's at worst."""

MAX_SPREAD = 0.5
"""Relative standard deviation at which a focal length is not known: a slip in the unit."""

FIXED = "fixed"
"""What is said of a figure that the points must not change."""

FIXED_SPREAD = 1e-6
"""Relative standard deviation of a focal length that is fixed."""

FIXED_REACH = 1e-3
"""Scale of the prior of a principal point that is fixed [px]."""

HEIGHT_SPREAD = 0.1
"""Relative standard deviation of a flying height: as flight plans were kept."""

INTERIOR_OPTIONS = (
    Option("camera", None, "Name of the photo's camera, such as wild-rc30-153, or a camera file "
                           "NAME.json."),
    Option("camera_focal", None, "Focal length: 3131.8 [px], or 153.2mm with camera_pixel or the "
                                 "name of a camera."),
    Option("camera_focal_spread", None, "How well the focal length is known, as a standard "
                                        "deviation: 0.3%, 5px, or fixed. By default 1% where it is "
                                        "stated in px, 0.32% where it is stated in mm with "
                                        "camera_pixel, and of a camera by name as its type "
                                        "varies."),
    Option("camera_pixel", None, "Size of a pixel on the film or sensor [um], such as 21."),
    Option("camera_principal_point", None, "Line and sample of the principal point [px]: "
                                           "703,749.5. By default the middle of the image."),
    Option("camera_principal_point_spread", None, "How well the principal point is known [px], or "
                                                  "fixed. By default 0.2% of half the diagonal of "
                                                  "the image, and 0.05% where it is stated."),
    Option("camera_distortion", None, "k1,k2,p1,p2,k3 of the lens, as OpenCV and OpenDroneMap "
                                      "state them; fewer are the first of these."),
    Option("camera_position", None, "Rough position of the camera in the CRS of the points: x,y,z, "
                                    "or x,y,z,s with its standard deviation [m], or x,y,z,s,h "
                                    "with another one of the height."),
    Option("camera_height", None, "Rough flying height above the ground [m], known to 10%."))
"""Options of reading; columns of the points have the same names."""

INTERIOR_NAMES = tuple(option.name for option in INTERIOR_OPTIONS)

FROM_EXIF = "camera_from_exif"
"""Column that names those of the columns above which nobody stated: the EXIF of the image did."""


@dataclass(frozen=True)
class Interior:
    """What is known of a camera and of its place.

    Parameters
    ----------
    focal : float
        [px].
    focal_spread : float
        Relative standard deviation of it.
    line, sample : float
        Principal point [px]; NaN where nothing shows it.
    reach : float
        Scale of its prior [px].
    distortion : tuple of 5 floats
        See `Lens`.
    position : tuple of 3 floats
        Rough place in the CRS of the points; NaN where it is not known.
    position_spread : float
        Its standard deviation [m].
    position_height_spread : float
        Standard deviation of its height [m], if it differs from that in plan; else NaN.
    height : float
        Flying height above the ground [m]; NaN where it is not known.
    source : str
        What told it.
    from_exif : tuple of str
        Names of the options that the EXIF of the image told.
    """

    focal: float
    focal_spread: float = FOCAL_SPREAD
    line: float = np.nan
    sample: float = np.nan
    reach: float = np.nan
    distortion: tuple[float, ...] = (0.0,) * 5
    position: tuple[float, ...] = (np.nan,) * 3
    position_spread: float = POSITION_SPREAD
    position_height_spread: float = np.nan
    height: float = np.nan
    source: str = "the focal length that is stated"
    from_exif: tuple[str, ...] = ()

    @property
    def has_exif_position(self) -> bool:
        """Whether the EXIF of the image told the position."""
        return "camera_position" in self.from_exif

    def without_position(self) -> Interior:
        """Return the same with a position that is not known."""
        return replace(self, position=(np.nan,) * 3)


def interior_of(features: FeatureSet) -> Interior | None:
    """Return what columns of the points state of their camera.

    None if they state neither a camera nor a focal length, whatever else they state.

    Raises
    ------
    TermselError
        If a column cannot be understood, or if they do not suffice for a focal length in px.
    """
    stated = {name: value for name in INTERIOR_NAMES if (value := _stated_value(features, name))}
    if "camera" not in stated and "camera_focal" not in stated:
        return None
    size = features.image_size
    named = camera_named(stated["camera"]) if "camera" in stated else None
    if isinstance(named, SurveyCamera):
        interior = _interior_of_type(named, stated, size)
    elif named is not None:
        interior = _interior_of_content(named, stated["camera"])
        # An image tells its own size.
        size = size or _size_of_file(named, stated["camera"])
    else:
        interior = _interior_of_focal(stated, None, size)
    interior = _with_spreads(_with_principal_point(interior, stated, size), stated)
    if "camera_distortion" in stated:
        interior = replace(interior,
                           distortion=_parse_numbers(stated, "camera_distortion", range(1, 6)))
    interior = _with_position(interior, stated)
    return _with_source_in_exif(interior, _stated_value(features, FROM_EXIF))


def _with_source_in_exif(interior: Interior, from_exif: str) -> Interior:
    """Return an interior whose `source` and `from_exif` say what of it is from the EXIF.

    `from_exif` has the names of those options, with blanks between; "" if there are none.
    """
    names = tuple(from_exif.split())
    if "camera_focal" in names:
        return replace(interior, from_exif=names,
                       source="the focal length in the EXIF of the image")
    if "camera" in names:
        return replace(interior, from_exif=names,
                       source=f"{interior.source}, which the EXIF of the image names")
    return interior


def _stated_value(features: FeatureSet, name: str) -> str:
    """Return the value that a column of the points has; "" if it is blank or missing.

    Raises TermselError if it has several values.
    """
    values = {str(value).strip() for value in features.points.attributes.get(name, ())} - {""}
    if len(values) > 1:
        raise TermselError(f"the column {name!r} has {len(values)} values, and an image one camera",
                           hint="Read the points of each image by themselves.")
    return values.pop() if values else ""


def _interior_of_focal(stated: Mapping[str, str], named: SurveyCamera | None,
                       size: tuple[int, int] | None) -> Interior:
    """Return an interior with the focal length that is stated in px or mm, and its spread.

    Millimetres require the size of a pixel: that which is stated, or that by the type `named` of
    the camera and the `size` of the image. Raises TermselError if it is not known.
    """
    text = stated["camera_focal"].lower().replace(" ", "")
    if not text.endswith("mm"):
        (focal,) = _parse_numbers({"camera_focal": text.removesuffix("px")}, "camera_focal", (1,))
        return Interior(_require_positive(focal, "camera_focal"))
    (mm,) = _parse_numbers({"camera_focal": text.removesuffix("mm")}, "camera_focal", (1,))
    pixel, spread = _pixel_size(stated, named, size)
    # A focal length in mm is stated to a part in a thousand; the size of a pixel is less certain.
    return Interior(_require_positive(mm, "camera_focal") / pixel, np.hypot(spread, 0.001),
                    source=f"the focal length of {mm:g} mm")


def _interior_of_type(named: SurveyCamera, stated: Mapping[str, str],
                      size: tuple[int, int] | None) -> Interior:
    """Return the interior of a type of camera; a focal length that is stated comes before its own.
    """
    if "camera_focal" in stated:
        interior = _interior_of_focal(stated, named, size)
    else:
        pixel, spread = _pixel_size(stated, named, size)
        interior = Interior(named.focal / pixel, float(np.hypot(spread, named.spread)))
    return replace(interior, distortion=tuple(named.distortion),
                   source=f"the camera {stated['camera']} ({named.source})")


def interior_of_file(path: str) -> Interior:
    """Return the interior that a camera file states.

    Raises
    ------
    TermselError
        If there is no such file, if it is wrong, or if `path` is the name of a type of camera,
        whose pixels are known only with an image.
    """
    content = camera_named(path)
    if isinstance(content, SurveyCamera):
        raise TermselError(f"the camera {path!r} is a type, whose focal length in px is not known",
                           hint="State focal in px, or a camera file NAME.json.")
    return _interior_of_content(content, path)


def _interior_of_content(content: Mapping[str, Any], path: str) -> Interior:
    """Return the interior that the content of a camera file states.

    The focal length is required. Raises TermselError, which names `path`, for a focal length or
    spread that is not positive, and for values that are not as many numbers as expected.
    """
    # Options are texts, so that numbers of a file are checked by the same functions.
    values = {name: _numbers_as_text(content.get(name)) for name in (
        "focal", "focal_spread", "principal_point", "distortion")}
    (focal,) = _parse_numbers({f"focal of {path}": values["focal"]}, f"focal of {path}", (1,))
    interior = Interior(
        _require_positive(focal, f"focal of {path}"), source=f"the camera file {path}")
    if values["focal_spread"]:
        interior = replace(interior, focal_spread=_parse_focal_spread(
            values["focal_spread"], f"focal_spread of {path}", interior.focal, is_relative=True))
    if values["principal_point"]:
        line, sample = _parse_numbers(values, "principal_point", (2,))
        interior = replace(interior, line=line, sample=sample)
    if values["distortion"]:
        interior = replace(interior, distortion=_parse_numbers(values, "distortion", range(1, 6)))
    return interior


def _size_of_file(content: Mapping[str, Any], path: str) -> tuple[int, int] | None:
    """Return lines and samples that the content of a camera file states; None if it does not.

    Raises TermselError if they are not two positive numbers.
    """
    name = f"size of {path}"
    text = _numbers_as_text(content.get("size"))
    if not text:
        return None
    lines, samples = (_require_positive(number, name)
                      for number in _parse_numbers({name: text}, name, (2,)))
    return round(lines), round(samples)


def _numbers_as_text(value: Any) -> str:
    """Return a number or a list of them as the text that options have; "" for None."""
    if value is None:
        return ""
    return ",".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def _pixel_size(stated: Mapping[str, str], named: SurveyCamera | None,
                size: tuple[int, int] | None) -> tuple[float, float]:
    """Return the size of a pixel [mm], and its relative standard deviation.

    It is the size that the options `stated` have, or else the longer side of the format of the type
    `named` [mm] divided by that of the image, of which `size` has the lines and samples. Raises
    TermselError if neither can be had, and for a stated size that is no positive number.
    """
    if "camera_pixel" in stated:
        return _stated_pixel_size(stated["camera_pixel"]), _STATED_PIXEL_SPREAD
    if named is None:
        raise TermselError(
            "a focal length in mm does not give that in px without the size of a pixel",
            hint="Add the size of a pixel in micrometres, such as --set camera_pixel=4.4. --image "
                 "FILE takes it from an image with EXIF.")
    if size is None:
        raise TermselError(
            "a focal length in mm does not give that in px without the size of the image",
            hint="Give the image: --image FILE. Or add the size of a pixel in micrometres, such as "
                 "--set camera_pixel=4.4.")
    # The longer sides belong together, whichever way the photo was turned.
    pixel = max(named.width, named.height) / max(size)
    return pixel, _SENSOR_SPREAD if _is_from_sensor(named, size) else SCANNED_SPREAD


def _stated_pixel_size(text: str) -> float:
    """Return a size stated in micrometres, such as "4.4" or "4.4 um", in mm.

    Raises TermselError if the text is no positive number.
    """
    text = text.lower().removesuffix("um").strip()
    (pixel,) = _parse_numbers({"camera_pixel": text}, "camera_pixel", (1,))
    return _require_positive(pixel, "camera_pixel") / 1e3


def _is_from_sensor(named: SurveyCamera, size: tuple[int, int]) -> bool:
    """Return whether an image has the shape of the camera's sensor, at whatever resolution.

    An image of another shape is a scan, and so is every image of a camera for film.
    """
    if named.pixels == (0, 0):
        return False
    # Longer and shorter sides are compared, as a photo may be turned for display.
    enlargement = max(size) / max(named.pixels)
    expected = min(named.pixels) * enlargement
    difference = abs(min(size) - expected)
    return bool(difference < _SAME_SHAPE * min(size))


def _with_principal_point(interior: Interior, stated: Mapping[str, str],
                          size: tuple[int, int] | None) -> Interior:
    """Return an interior with the principal point [px] and the scale of its prior.

    It is the point that is stated, or that of the interior, or the middle of an image of known
    size. If there is none of these the interior is returned as it is.
    """
    half_diagonal = np.nan if size is None else float(np.hypot(*size)) / 2
    if "camera_principal_point" in stated:
        line, sample = _parse_numbers(stated, "camera_principal_point", (2,))
        interior = replace(interior, line=line, sample=sample)
    if np.isfinite(interior.line):
        # The focal length stands for half the diagonal of an image of unknown size.
        return replace(
            interior, reach=STATED_REACH * (interior.focal if size is None else half_diagonal))
    if size is None:
        return interior
    line, sample = (np.array(size) - 1.0) / 2.0
    return replace(interior, line=float(line), sample=float(sample), reach=REACH * half_diagonal)


def _with_spreads(interior: Interior, stated: Mapping[str, str]) -> Interior:
    """Return an interior with the stated spreads of focal length and principal point.

    A spread that is not stated stays as it is. Raises TermselError for the spread of a principal
    point that is not known.
    """
    if "camera_focal_spread" in stated:
        interior = replace(interior, focal_spread=_parse_focal_spread(
            stated["camera_focal_spread"], "camera_focal_spread", interior.focal))
    if "camera_principal_point_spread" in stated:
        name = "camera_principal_point_spread"
        if not np.isfinite(interior.line):
            raise TermselError(f"{name} is of a principal point that nothing tells",
                               hint="State camera_principal_point, or the image: --image FILE.")
        if stated[name].lower() == FIXED:
            return replace(interior, reach=FIXED_REACH)
        (reach,) = _parse_numbers({name: stated[name].lower().removesuffix("px")}, name, (1,))
        interior = replace(interior, reach=max(_require_positive(reach, name), FIXED_REACH))
    return interior


def _parse_focal_spread(text: str, name: str, focal: float, *, is_relative: bool = False) -> float:
    """Return the relative standard deviation that a text such as "0.3%" or "5px" states.

    `focal` [px] is the focal length that it is of, and `name` that of the option, for messages. A
    number without a unit is relative if `is_relative`, as in camera files. Raises TermselError for
    any other number without a unit, as 0.3 may mean 0.3%, and from `MAX_SPREAD` on.
    """
    text = text.lower().replace(" ", "")
    if text == FIXED:
        return FIXED_SPREAD
    unit = next((unit for unit in ("%", "px") if text.endswith(unit)), "")
    try:
        (number,) = _parse_numbers({name: text.removesuffix(unit)}, name, (1,))
    except TermselError as error:
        error.hint = f"Write 0.3% or 5px, or {FIXED}."
        raise
    # People state 0 of a calibrated camera; a variance of 0 would make the adjustment singular.
    if number == 0.0:
        return FIXED_SPREAD
    if not unit and not is_relative:
        raise TermselError(f"{name}={text} has no unit",
                           hint=f"Write {text}% or {text}px, or {FIXED}.")
    spread = _require_positive(number, name) / {"%": 100.0, "px": focal, "": 1.0}[unit]
    if spread >= MAX_SPREAD:
        raise TermselError(f"{name}={text} is {spread:.0%} of the focal length",
                           hint=f"Write 0.3% or 5px, or {FIXED}.")
    return max(spread, FIXED_SPREAD)


def _with_position(interior: Interior, stated: Mapping[str, str]) -> Interior:
    """Return an interior with the camera's position and flying height, as far as they are stated.
    """
    if "camera_position" in stated:
        x, y, z, *stated_spreads = _parse_numbers(stated, "camera_position", (3, 4, 5))
        spreads = [_require_positive(spread, "camera_position") for spread in stated_spreads]
        interior = replace(interior, position=(x, y, z),
                           position_spread=spreads[0] if spreads else POSITION_SPREAD,
                           position_height_spread=spreads[1] if len(spreads) > 1 else np.nan)
    if "camera_height" in stated:
        (height,) = _parse_numbers(stated, "camera_height", (1,))
        interior = replace(interior, height=_require_positive(height, "camera_height"))
    return interior


_NUMBERS_OF = {
    "camera_position": "x, y and z in the CRS of the points, then the standard deviations of the "
                       "position and of z, if they are known"}
"""What the numbers of an option are."""


def _parse_numbers(stated: Mapping[str, str], name: str, counts: Any) -> tuple[float, ...]:
    """Return the numbers of the text `stated[name]`, such as "1,2,3".

    Raises TermselError, which names it, unless they are finite and their count is among `counts`.
    """
    try:
        numbers = tuple(float(number) for number in stated[name].replace(";", ",").split(","))
    except ValueError:
        numbers = ()
    if len(numbers) not in counts or not np.isfinite(numbers).all():
        hint = f"It takes {' or '.join(map(str, counts))} numbers with commas between"
        hint = f"{hint}: {_NUMBERS_OF[name]}." if name in _NUMBERS_OF else f"{hint}."
        if list(counts) == [1]:
            hint = "It takes a number."
        raise TermselError(f"{name} does not accept {stated[name]!r:.80}", hint=hint)
    return numbers


def _require_positive(number: float, name: str) -> float:
    """Return the number; raises TermselError if it is not positive."""
    is_positive = number > 0.0
    if not is_positive:
        raise TermselError(f"{name} is {number:g}, which is not positive",
                           hint="Give a number above 0.")
    return number
