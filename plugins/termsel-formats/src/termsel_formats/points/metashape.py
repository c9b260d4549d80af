"""Markers of Metashape, as it exports them in XML.

A marker has its place on the ground (``reference``), and a place in each camera (``location``,
columns and rows from the outer corner of the first pixel).
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from termsel import FeatureSet, Points, Reader, TermselError
from termsel.formats.base import IMAGE_NAME, image_of, located, read_text
from termsel.measurements.coordinates.crs import normalise

_CORNER = 0.5
_HINT = "Export the markers from Metashape again, as XML."


class MetashapeMarkers(Reader):
    """Markers of one camera, with their places on the ground."""

    name = "metashape-markers"
    summary = "markers of Metashape as XML; --set image_name=NAME of several cameras"
    declared_options = (IMAGE_NAME,)

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for a document with markers."""
        return b"<markers" in head and b"<document" in head

    def read(self, path: Path) -> FeatureSet:
        """Return the markers that a camera sees; errors name file and marker."""
        text = read_text(path)
        if "<!DOCTYPE" in text or "<!ENTITY" in text:
            raise TermselError("an XML file with a document type is not read", file=path,
                               hint=_HINT)
        try:
            root = ElementTree.fromstring(text)
            cameras = {one.attrib["id"]: one.get("label", one.attrib["id"])
                       for one in root.iter("camera") if "id" in one.attrib}
            places = [(one.attrib["marker_id"], seen.attrib["camera_id"],
                       float(seen.attrib["x"]), float(seen.attrib["y"]))
                      for one in root.iter("marker") if "marker_id" in one.attrib
                      for seen in one.iter("location") if seen.get("valid", "true") != "false"]
            labels = {one.attrib["id"]: one.get("label", one.attrib["id"])
                      for one in root.iter("marker") if "id" in one.attrib}
            ground = {one.attrib["id"]: [float(known.get(axis, "nan")) for axis in "xyz"]
                      for one in root.iter("marker") if "id" in one.attrib
                      for known in one.findall("reference") if known.get("x") is not None}
        except ElementTree.ParseError as error:
            raise TermselError(f"this is not XML: {error}", file=path, hint=_HINT) from error
        except (KeyError, ValueError) as error:
            raise TermselError(f"a marker cannot be read: {error}", file=path,
                               hint=_HINT) from error
        if not places or not ground:
            raise TermselError("this file has no markers with places in images and on the ground",
                               file=path, hint=_HINT)
        camera = image_of(path, (cameras.get(one[1], one[1]) for one in places if one[0] in ground),
                          self.options["image_name"], "image_name=NAME")
        used = [one for one in places if cameras.get(one[1], one[1]) == camera and one[0] in ground]
        image = np.array([[row, column] for _, _, column, row in used]) - _CORNER
        try:
            return FeatureSet(Points(tuple(labels[one[0]] for one in used), image,
                                     np.array([ground[one[0]] for one in used])), crs=_crs(root))
        except TermselError as error:
            raise located(error, path) from error


def _crs(root: ElementTree.Element) -> str:
    """Return the CRS of the references, "" for none."""
    found = root.find(".//chunk/reference")
    try:
        return normalise("" if found is None else found.text or "")
    except TermselError:  # "LOCAL_CS" of Metashape, or nothing
        return ""
