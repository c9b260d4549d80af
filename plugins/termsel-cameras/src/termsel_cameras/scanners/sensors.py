"""Published constants of line scanners in orbit, and those of a file.

A value that a source gives in round numbers has the uncertainty of these; see `Sensor`. Pixels are
on the ground, looking straight down. Altitude, inclination, pixel and the largest view to the side
were compared with the source of each sensor, but for the view to the side of OrbView-3 and
PlanetScope; the standard deviations are termsel's own, and so is the view to the side of those that
look straight down.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from pathlib import Path

from termsel import TermselError
from termsel.toolkit import read_text

SPOT = "Spot Image, Spot satellite technical data: 822 km at the equator, 98.7 deg; to 27 deg"
ESA_IRS = "ESA, IRS-1C mission: 817 km, 98.69 deg, to 26 deg; ISRO, 30 December 2005: 5.8 m"
IRS_1D = "ESA, IRS-1D mission: 98.6 deg; ISRO: 740 to 817 km; pixel of IRS-1C by altitude"
ASTER = ("Abrams, Hook and Ramachandran 2002, ASTER user handbook, and Geoimage, ASTER: 705 km, "
         "98.2 deg, 15 m, to 24 deg; band 3B looks 27.7 deg back")
INPE = "INPE, CBERS-1, 2 and 2B orbit: 778 km, 98.504 deg; CEOS, CCD: 20 m, to 32 deg"


@dataclass(frozen=True)
class Sensor:
    """What is known of a line scanner before its points are looked at.

    Parameters
    ----------
    altitude : float
        Height of the orbit above the equator [km].
    inclination : float
        Inclination of the orbit to the equator [deg].
    pixel : float
        Distance of neighbouring lines and samples on the ground, straight down [m]; 0 where not
        known.
    side, ahead : float
        Standard deviation of the view to the side and along the track [deg]: half of the largest.
    forward : float
        View along the track that is built in, ahead positive [deg].
    source : str
        Where the constants were published.
    altitude_sigma : float
        Standard deviation of the altitude [km]: orbits are 10 to 20 km higher over the poles.
    pixel_sigma : float
        Relative standard deviation of the pixel.
    heading_sigma : float
        Standard deviation of the heading [deg].
    """

    altitude: float
    inclination: float
    pixel: float
    side: float
    ahead: float
    source: str
    forward: float = 0.0
    altitude_sigma: float = 8.0
    pixel_sigma: float = 0.005
    heading_sigma: float = 1.0


UNKNOWN = Sensor(620.0, 97.9, 0.0, 15.0, 10.0, "none: wide enough for any scanner", 0.0, 120.0,
                 0.3, 20.0)

SENSORS: dict[str, Sensor] = {
    "spot-1": Sensor(822.0, 98.7, 10.0, 13.5, 0.5, SPOT),
    "spot-2": Sensor(822.0, 98.7, 10.0, 13.5, 0.5, SPOT),
    "spot-3": Sensor(822.0, 98.7, 10.0, 13.5, 0.5, SPOT),
    "spot-4": Sensor(822.0, 98.7, 10.0, 13.5, 0.5, SPOT),
    "spot-5": Sensor(822.0, 98.7, 5.0, 13.5, 0.5, SPOT),
    "irs-1c-pan": Sensor(817.0, 98.69, 5.8, 13.0, 0.5, ESA_IRS),
    "irs-1d-pan": Sensor(780.0, 98.6, 5.5, 13.0, 0.5, IRS_1D, altitude_sigma=30.0,
                         pixel_sigma=0.04),
    "aster-vnir": Sensor(705.0, 98.2, 15.0, 12.0, 0.5, ASTER),
    "aster-3b": Sensor(705.0, 98.2, 15.0, 12.0, 0.5, ASTER, forward=-27.7),
    "landsat-oli": Sensor(705.0, 98.2, 30.0, 4.0, 0.5,
                          "USGS, Landsat 8: 705 km, 98.2 deg, 30 m"),
    "orbview-3": Sensor(470.0, 97.25, 1.0, 20.0, 20.0,
                        "eoPortal, OrbView-3: 470 km, 97.25 deg, 1 m"),
    "cbers-ccd": Sensor(778.0, 98.504, 20.0, 16.0, 0.5, INPE),
    "planetscope": Sensor(499.0, 97.5, 4.0, 2.0, 1.0,
                          "USGS, Open-File Report 2021-1030-D: 474 to 524 km, 97 to 98 deg, about "
                          "4 m (frames of about 1 s; as a line scanner it is an approximation)",
                          altitude_sigma=25.0, pixel_sigma=0.1),
}
"""Sensors by name. The pixel is that of the panchromatic channel where there is one."""


def sensor_named(name: str) -> Sensor:
    """Return the sensor that the option `sensor` stands for.

    Parameters
    ----------
    name : str
        One of `SENSORS` in upper or lower case, or the path of a JSON file, ending in .json, with
        the fields of `Sensor`; "" gives `UNKNOWN`, whose constants fit any scanner.

    Returns
    -------
    Sensor
        Its constants, and how far each may be off.

    Raises
    ------
    TermselError
        If there is neither such a sensor nor such a file, or if a field of the file is not known,
        missing or no number.
    """
    if not name:
        return UNKNOWN
    if name.lower() in SENSORS:
        return SENSORS[name.lower()]
    # Only the suffix tells a file from a name, so that a misspelt name is not taken for a file.
    path = Path(name)
    if path.suffix != ".json":
        raise TermselError(f"there is no sensor {name!r}",
                           hint=f"Choose one of {', '.join(SENSORS)}, or name a JSON file.")
    try:
        content = json.loads(read_text(path))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise TermselError(f"{path} cannot be read as JSON: {error}",
                           hint="Give a file with the fields of a sensor.") from error
    return _check_sensor(content, path)


def _check_sensor(content: object, path: Path) -> Sensor:
    """Return the sensor that the JSON of a file describes.

    Fields are those of `Sensor`, of which the first six are required. Raises TermselError for a
    field that is missing or unknown, for one that is no number, or not positive though it has to
    be, and for one out of the range that satellites have.
    """
    names = [field.name for field in fields(Sensor)]
    hint = f"Fields are {', '.join(names)}; those after source may be left out."
    if not isinstance(content, dict):
        raise TermselError(f"{path} contains no JSON object", hint=hint)
    for name in content:
        if name not in names:
            raise TermselError(f"{path} has the field {name!r}, which no sensor has", hint=hint)
    for name in names[:6]:
        if name not in content:
            raise TermselError(f"{path} lacks the field {name!r}", hint=hint)
    for name, value in content.items():
        is_number = (isinstance(value, int | float) and not isinstance(value, bool)
                     and abs(value) < 1e5)
        if name != "source" and (not is_number or (
                value <= 0 and name not in ("pixel", "forward"))):
            raise TermselError(f"{path}: {name} is {value!r}, which is no positive number",
                               hint=hint)
    # The ranges show a wrong unit, such as metres for kilometres.
    if (not 300 <= content["altitude"] <= 1500 or not 0 < content["inclination"] < 180
            or content["pixel"] < 0 or abs(content.get("forward", 0.0)) > 60):
        raise TermselError(f"{path}: altitude, inclination, pixel or forward is out of range",
                           hint="They must be 300 to 1500 km, 0 to 180 deg, at least 0 m, and "
                                "-60 to 60 deg.")
    return Sensor(**{**content, "source": str(content["source"])})
