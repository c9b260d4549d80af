"""Cameras that are known by name, and camera files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from termsel import TermselError
from termsel.toolkit import parse_json, read_text, unknown_name_error

USGS = ("USGS reports of calibration OSL/2985, OSL/3030 and OSL/3221 of Wild RC30 cameras: 153 mm "
        "nominal, 153.25 to 153.74 mm calibrated")
REPORTS = ("makers' reports of calibration: pixels and sizes of the virtual image; the nominal "
           "focal length")


@dataclass(frozen=True)
class SurveyCamera:
    """What is known of all cameras of one type.

    Parameters
    ----------
    focal : float
        Focal length [mm].
    spread : float
        Relative standard deviation of the focal length among cameras of the type.
    width, height : float
        Format, across and along [mm].
    pixels : tuple of int
        Size of the image, across and along; (0, 0) of film.
    source : str
        Where this was published.
    distortion : tuple of 5 floats
        k1, k2, p1, p2, k3 (see `Lens`).
    """

    focal: float
    spread: float
    width: float
    height: float
    pixels: tuple[int, int]
    source: str
    distortion: tuple[float, ...] = (0.0,) * 5


def _square_film_camera(focal: float, spread: float, size: float, source: str) -> SurveyCamera:
    """Return a camera of focal length [mm], with its spread, and a square film of `size` [mm]."""
    return SurveyCamera(focal, spread, size, size, (0, 0), source)


def _digital_camera(focal: float, pixel: float, width: int, height: int) -> SurveyCamera:
    """Return a large-format camera: focal length [mm], size of a pixel [um], and pixels either way.
    """
    return SurveyCamera(focal, 0.003, width * pixel / 1e3, height * pixel / 1e3, (width, height),
                        REPORTS)


CAMERAS: dict[str, SurveyCamera] = {
    "wild-rc30-153": _square_film_camera(153.0, 0.004, 230.0, USGS),
    "wild-rc20-153": _square_film_camera(153.0, 0.005, 230.0, USGS),
    "wild-rc10-153": _square_film_camera(153.0, 0.005, 230.0, USGS),
    "wild-rc8-152": _square_film_camera(
        152.4, 0.005, 230.0, "National Report of Canada to the ISP, Commission I, 1960: 6 in"),
    "metrogon-6in": _square_film_camera(
        152.4, 0.008, 228.6, "Report of the United States to the ISP, 1952: Fairchild and other "
        "cameras with Metrogon lenses of 6 in, 9 by 9 in"),
    "dmc": _digital_camera(120.0, 12.0, 7680, 13824),
    "dmc-ii-230": _digital_camera(92.0, 5.6, 15552, 14144),
    "dmc-iii": _digital_camera(92.0, 3.9, 25728, 14592),
    "ultracam-x": _digital_camera(100.5, 7.2, 14430, 9420),
    "ultracam-xp": _digital_camera(100.5, 6.0, 17310, 11310),
    "ultracam-eagle-80": _digital_camera(79.8, 5.2, 20010, 13080),
    "leica-rcd39": SurveyCamera(60.0, 0.01, 49.07, 36.80, (7216, 5412), "NERC Airborne Research "
                                "Facility, RCD CH39: 60 mm, 6.8 um; up to 2 % distortion"),
    "dji-fc300s": SurveyCamera(3.7, 0.01, 6.239, 4.679, (4000, 3000), "OpenSfM, "
                               "camera_calibration.yaml: 0.593 of the width",
                               (-0.012137, 0.016199, 0.0, 0.0, 0.0)),
    "dji-fc6310": SurveyCamera(8.8, 0.02, 13.2, 8.8, (5472, 3648),
                               "IPGP, waypoints_generator, drones.json: 8.8 mm, 13.2 by 8.8 mm"),
}
"""Cameras by name. Of a type the focal length differs from camera to camera, which the spread
states; a report of calibration shows that of one."""

FIELDS = ("focal", "focal_spread", "principal_point", "distortion", "size", "source")


def camera_named(name: str) -> SurveyCamera | dict[str, Any]:
    """Return the type of camera of a name, or the content of a camera file NAME.json.

    A camera file has ``focal`` [px], and may have ``focal_spread``, relative, ``principal_point``,
    line and sample [px], ``distortion``, k1, k2, p1, p2, k3, ``size``, lines and samples of the
    photos [px], and ``source``.

    Raises
    ------
    TermselError
        If there is neither a type nor a file of that name, or if the file is no JSON, lacks
        ``focal`` or has another field.
    """
    key = name.strip().lower().replace(" ", "-").replace("_", "-")
    if key in CAMERAS:
        return CAMERAS[key]
    path = Path(name)
    if path.suffix.lower() != ".json":
        raise unknown_name_error("camera", name, [*CAMERAS, "a file NAME.json"])
    try:
        content = parse_json(read_text(path), 'Give a camera file, such as {"focal": 3131.8}.')
    except TermselError as error:
        error.file = path
        raise
    fields = f"Fields of a camera file are {', '.join(FIELDS)}."
    if not isinstance(content, dict) or "focal" not in content:
        raise TermselError("this camera file has no field 'focal', the focal length [px]",
                           file=path, hint=fields)
    # A misspelt field would be left out in silence, and the camera be another one.
    for name_of_field in content:
        if name_of_field not in FIELDS:
            raise TermselError(f"the field {name_of_field!r} is unknown in camera files",
                               file=path, hint=fields)
    return content
