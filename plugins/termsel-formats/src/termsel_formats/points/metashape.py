"""Markers of Metashape, as it exports them in XML.

A marker has its place on the ground (``reference``), and a place in each camera (``location``,
columns and rows from the outer corner of the first pixel).
"""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar
from xml.etree import ElementTree

import numpy as np

from termsel import FeatureSet, Option, Points, Reader, Result, TermselError
from termsel.toolkit import horizontal, normalise, write_text, xml_document
from termsel.toolkit.files import IMAGE_NAME, chosen_points, image_of, located, wkt
from termsel_formats.points.common import CORNER, what_lacks, xml_root
from termsel_formats.points.written import IMAGE, PointsWriter, image_name, say_points

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
        root = xml_root(path, _HINT)
        try:
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
        except (KeyError, ValueError) as error:
            raise TermselError(f"a marker cannot be read: {what_lacks(error)}", file=path,
                               hint=_HINT) from error
        if not places or not ground:
            raise TermselError("this file has no markers with image and ground positions",
                               file=path, hint=_HINT)
        camera = image_of(path, (cameras.get(one[1], one[1]) for one in places if one[0] in ground),
                          self.options["image_name"], "image_name=NAME")
        used = [one for one in places if cameras.get(one[1], one[1]) == camera and one[0] in ground]
        image = np.array([[row, column] for _, _, column, row in used]) - CORNER
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


class MetashapeMarkersWriter(PointsWriter):
    """The selected control points as markers of Metashape, with their places in one camera."""

    name = "metashape-markers"
    summary = "selected control points as markers of Metashape (XML), in one camera"
    suffix = "_markers.xml"
    declared_options: ClassVar[tuple[Option, ...]] = (IMAGE,)

    def write(self, result: Result, path: Path) -> None:
        """Write the markers."""
        self.require(result, path)
        points = chosen_points(result)
        root = ElementTree.Element("document", version="1.2.0")
        chunk = ElementTree.SubElement(root, "chunk", label="Chunk 1", enabled="true")
        cameras = ElementTree.SubElement(chunk, "cameras")
        ElementTree.SubElement(cameras, "camera", id="0",
                               label=image_name(self.options["image"], path))
        markers = ElementTree.SubElement(chunk, "markers")
        frame = ElementTree.SubElement(ElementTree.SubElement(chunk, "frames"), "frame", id="0")
        seen = ElementTree.SubElement(frame, "markers")
        for i, (name, (line, sample), place) in enumerate(zip(
                points.ids, points.image.tolist(), points.ground.tolist(), strict=True)):
            marker = ElementTree.SubElement(markers, "marker", id=str(i), label=name)
            known = {axis: repr(value) for axis, value in zip("xyz", place, strict=True)
                     if not np.isnan(value)}
            ElementTree.SubElement(marker, "reference", {**known, "enabled": "true"})
            ElementTree.SubElement(
                ElementTree.SubElement(seen, "marker", marker_id=str(i)), "location",
                camera_id="0", pinned="true", x=repr(sample + CORNER), y=repr(line + CORNER))
        ElementTree.SubElement(chunk, "reference").text = wkt(horizontal(result.features.crs))
        write_text(path, xml_document(root))
        say_points(self.name)
