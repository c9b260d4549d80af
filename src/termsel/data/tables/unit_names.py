"""Units, and the side from which angles count, that names of columns state."""

from __future__ import annotations

import math
import re

from termsel.data.coordinates.height_units import FOOT, US_FOOT, WORDS, unit_of_word

_SUFFIX = re.compile(
    r"\s*[\[({<【].*$|[\s_.-]+(px|pix|pixels?|m|km|ft|feet|us[_-]?ft|gon|rad|deg|degrees?|dms|wgs84|utm)$")
_STATED = re.compile(r"[\[({<【]\s*(.*?)\s*[\])}>】]|[\s_.-](km|ft|feet|us[_-]?ft|gon|rad)$",
                     re.IGNORECASE)
_IN_BRACKETS = re.compile(r"[\[({<【]\s*(.*?)\s*[\])}>】]")

KILOMETRE, DECIMETRE, CENTIMETRE, MILLIMETRE = "km", "dm", "cm", "mm"
GON, RADIAN, ARC_MINUTE, ARC_SECOND = "gon", "rad", "arcmin", "arcsec"
ANGLES = (GON, RADIAN, ARC_MINUTE, ARC_SECOND)
LENGTHS = (KILOMETRE, DECIMETRE, CENTIMETRE, MILLIMETRE)

FACTORS = {KILOMETRE: 1000.0, DECIMETRE: 0.1, CENTIMETRE: 0.01, MILLIMETRE: 0.001,
           GON: 0.9, RADIAN: 180.0 / math.pi, ARC_MINUTE: 1.0 / 60.0, ARC_SECOND: 1.0 / 3600.0}
"""By what numbers in a unit are multiplied: to metres, or to degrees."""

UNIT_WORDS = {**WORDS, KILOMETRE: "kilometres", DECIMETRE: "decimetres",
              CENTIMETRE: "centimetres", MILLIMETRE: "millimetres", GON: "gons",
              RADIAN: "radians", ARC_MINUTE: "minutes of arc", ARC_SECOND: "seconds of arc"}
"""What messages call the units that names of columns state."""

# Not "grad", which is a degree in German.
_SPELLINGS = {
    KILOMETRE: "km kilometre kilometres kilometer kilometers",
    DECIMETRE: "dm decimetre decimetres decimeter decimeters",
    CENTIMETRE: "cm centimetre centimetres centimeter centimeters",
    MILLIMETRE: "mm millimetre millimetres millimeter millimeters",
    GON: "gon gons grads grades",
    RADIAN: "rad radian radians",
    ARC_MINUTE: "arcmin arcmins arcminute arcminutes ' ′",
    ARC_SECOND: "arcsec arcsecs arcsecond arcseconds \" ″ ”"}
_BY_WORD = {word: unit for unit, words in _SPELLINGS.items() for word in words.split()}

_NO_PIXELS = {"µm": "micrometres", "um": "micrometres", "μm": "micrometres",
              "micron": "micrometres", "microns": "micrometres", "%": "per cent",
              "percent": "per cent", "in": "inches", "inch": "inches", "inches": "inches"}
"""Units of image coordinates, besides lengths, that are no pixels."""

_KNOWN_REMARKS = re.compile(
    r"|px|pix|pixels?|m|met(re|er)s?|deg|degrees?|°|º|dd|dms|dezimalgrad|grad|decimal degrees|"
    r"wgs[ _-]?84|utm|[nesw]|north|south|east|west|.*(ellips|ortho|geoid|egm|nhn|nn|asl|msl).*",
    re.IGNORECASE)
"""What needs no word in brackets: units that are the usual ones, and what heights count from."""

_ANGLE_WITH_SIDE = re.compile(
    r"^((?:lat|lon|lng|long|latitude|longitude))[\s_.-]+([nsew]|north|south|east|west)$")
_DIRECTIONS = {"w": ("x", -1), "west": ("x", -1), "e": ("x", 1), "east": ("x", 1),
               "s": ("y", -1), "south": ("y", -1), "n": ("y", 1), "north": ("y", 1)}
"""Axis and sign of the directions that names state."""


def without_unit(name: str) -> str:
    """Return the name of a column, in lower case, without its unit or direction: lat of lat (S)."""
    return _ANGLE_WITH_SIDE.sub(r"\1", _SUFFIX.sub("", name))


def unit_in_name(name: str) -> str:
    """Return the unit that the name of a column states, as E [km], z_ft and lon (gon) do.

    It is one of `FACTORS`, or a foot of `termsel.data.coordinates.height_units`. Metres, degrees
    and all other units give "", as does a name without a unit.
    """
    match = _STATED.search(name.strip())
    if match is None:
        return ""
    word = next(group for group in match.groups() if group is not None)
    return unit_of_text(word)


def unit_of_text(word: str) -> str:
    """Return the unit that a word states, as `unit_in_name`."""
    foot = unit_of_word(word)
    return str(foot) if foot in (FOOT, US_FOOT) else _BY_WORD.get(word.strip().lower(), "")


def unit_of_image_in_name(name: str) -> str:
    """Return in words the unit that the name of a column of the image states, such as mm.

    Pixels give "", as does a name that states no unit.
    """
    match = _IN_BRACKETS.search(name) or re.search(r"[\s_.-](mm|cm|um|µm|μm)$", name.lower())
    if match is None:
        return ""
    word = match[1].strip().lower()
    unit = unit_of_text(word)
    return _NO_PIXELS.get(word, UNIT_WORDS.get(unit, "") if unit not in (FOOT, US_FOOT) else "")


def counts_against_axis(name: str, axis: str) -> bool:
    """Return whether the name of a column says that its numbers count to the west or south.

    `axis` is "x" or "y": only the direction against this axis counts.
    """
    lower = name.strip().lower()
    match = _IN_BRACKETS.search(lower)
    word = match[1].strip("°º +") if match else ""
    if not match and (suffix := _ANGLE_WITH_SIDE.fullmatch(lower)):
        word = suffix[2]
    return _DIRECTIONS.get(word) == (axis, -1)


def remark_in_brackets(name: str) -> str:
    """Return what stands in brackets in the name of a column; "" without brackets."""
    match = _IN_BRACKETS.search(name)
    return match[1] if match else ""


def unknown_remark(name: str) -> str:
    """Return the remark in brackets in the name of a column, if it is neither known nor a unit.

    All other names give "".
    """
    text = remark_in_brackets(name)
    is_known = _KNOWN_REMARKS.fullmatch(text.strip("°º +")) or unit_of_text(text)
    return "" if is_known else text
