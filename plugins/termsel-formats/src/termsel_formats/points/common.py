"""What readers of several programs share: where pixels begin, UTM on WGS 84, and XML."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from termsel import TermselError
from termsel.toolkit import read_text

CORNER = 0.5
"""From the centre of the first pixel to its outer corner, where GDAL and others count from."""


def utm(zone: int, south: bool) -> str:
    """Return the CRS of a zone of UTM on WGS 84, "" for a zone that there is not."""
    return f"EPSG:32{7 if south else 6}{zone:02d}" if 1 <= zone <= 60 else ""


def xml_root(path: Path, hint: str) -> ElementTree.Element:
    """Return the root of an XML file.

    Raises
    ------
    TermselError
        If it is no XML, or has a document type, whose entities can make a text of any length.
    """
    text = read_text(path)
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise TermselError("an XML file with a document type is not read", file=path, hint=hint)
    try:
        return ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise TermselError(f"this is not XML: {error}", file=path, hint=hint) from error


def what_lacks(error: KeyError | ValueError) -> str:
    """Return what a KeyError or a ValueError of reading attributes says, for users."""
    return f"it has no {error.args[0]}" if isinstance(error, KeyError) else str(error)
