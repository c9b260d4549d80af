"""Markers of Metashape, as it exports them in XML.

A marker has its place on the ground (``reference``), and a place in each camera (``location``,
columns and rows from the outer corner of the first pixel).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar, NamedTuple
from xml.etree import ElementTree

import numpy as np

from termsel import FeatureSet, Option, Points, Reader, Result, TermselError
from termsel.toolkit import write_text, xml_document
from termsel.toolkit.coordinates import horizontal_crs
from termsel.toolkit.files import IMAGE_NAME, error_in_file, image_of, wkt_in_one_line
from termsel_formats.points.common import CORNER, crs_or_blank, what_lacks, xml_root
from termsel_formats.points.written import (
    IMAGE_OPTION,
    PointsWriter,
    image_name,
    points_for_others,
    require_points,
    say_checked,
)

_METASHAPE_HINT = "Export the markers from Metashape again, as XML."


class MetashapeMarkers(Reader):
    """Markers of one camera, with their places on the ground."""

    name = "metashape-markers"
    summary = "markers of Metashape as XML; --set image_name=NAME of several cameras"
    declared_options = (IMAGE_NAME,)

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for a document with markers."""
        return b"<markers" in head and b"<document" in head

    def read(self, path: Path) -> FeatureSet:
        """Return the markers that one camera sees; of several, the option `image_name` chooses one.

        Markers without ground coordinates are left out. Those whose reference is not enabled have
        the role independent. Errors name the file, and no line, as Metashape may write just one.
        """
        root = xml_root(path, _METASHAPE_HINT)
        try:
            cameras = _labels_by_id(root, "camera")
            marks = _marker_positions(root)
            labels = _labels_by_id(root, "marker")
            ground = _reference_coordinates(root)
            # Markers whose reference is not enabled are check points in Metashape.
            disabled = {marker.get("id", "") for marker in root.iter("marker")
                        for reference in marker.findall("reference")
                        if reference.get("enabled", "true").lower() in ("false", "0")}
        except (KeyError, ValueError) as error:
            raise TermselError(f"a marker cannot be read: {what_lacks(error)}", file=path,
                               hint=_METASHAPE_HINT) from error
        marks = [mark for mark in marks if mark.marker in ground]
        if not marks:
            raise TermselError("this file has no markers with image and ground positions",
                               file=path, hint=_METASHAPE_HINT)
        camera = image_of(path, (cameras.get(mark.camera, mark.camera) for mark in marks),
                          self.options["image_name"], "image_name=NAME")
        used = [mark for mark in marks if cameras.get(mark.camera, mark.camera) == camera]
        image = np.array([[mark.row, mark.column] for mark in used]) - CORNER
        try:
            points = Points(tuple(labels[mark.marker] for mark in used), image,
                            np.array([ground[mark.marker] for mark in used]),
                            roles=tuple("independent" if mark.marker in disabled else ""
                                        for mark in used))
            return FeatureSet(points, crs=_reference_crs(root))
        except TermselError as error:
            raise error_in_file(error, path) from error

    def parts(self, path: Path) -> dict[str, dict[str, Any]]:
        """Return the options for each camera of the markers; {} if there is one, or none is read.
        """
        root = xml_root(path, _METASHAPE_HINT)
        # What is wrong with the file is an error of `read`.
        try:
            cameras = _labels_by_id(root, "camera")
            names = dict.fromkeys(cameras.get(mark.camera, mark.camera)
                                  for mark in _marker_positions(root))
        except (KeyError, ValueError):
            return {}
        return {name: {"image_name": name} for name in names} if len(names) > 1 else {}


class _Mark(NamedTuple):
    """A marker in the image of a camera, both by their ids; column and row from the corner."""

    marker: str
    camera: str
    column: float
    row: float


def _labels_by_id(root: ElementTree.Element, tag: str) -> dict[str, str]:
    """Return the labels of cameras or markers by their ids."""
    return {element.attrib["id"]: element.get("label", element.attrib["id"])
            for element in root.iter(tag) if "id" in element.attrib}


def _marker_positions(root: ElementTree.Element) -> list[_Mark]:
    """Return the positions of markers in images, but for those that are switched off.

    Raises KeyError or ValueError if one lacks a coordinate or the id of its camera.
    """
    marks = []
    for marker in root.iter("marker"):
        if "marker_id" not in marker.attrib:
            continue
        for location in marker.iter("location"):
            if location.get("valid", "true") != "false":
                marks.append(_Mark(marker.attrib["marker_id"], location.attrib["camera_id"],
                                   float(location.attrib["x"]), float(location.attrib["y"])))
    return marks


def _reference_coordinates(root: ElementTree.Element) -> dict[str, list[float]]:
    """Return the ground coordinates x, y, z of markers by their ids; z is NaN if it is missing."""
    ground = {}
    for marker in root.iter("marker"):
        if "id" not in marker.attrib:
            continue
        for reference in marker.findall("reference"):
            if reference.get("x") is not None:
                ground[marker.attrib["id"]] = [float(reference.get(axis, "nan"))
                                               for axis in "xyz"]
    return ground


def _reference_crs(root: ElementTree.Element) -> str:
    """Return the CRS of the references; "" if there is none, or a local one."""
    reference = root.find(".//chunk/reference")
    # Metashape calls coordinates without a CRS LOCAL_CS, which is none.
    return crs_or_blank("" if reference is None else reference.text or "")


class MetashapeMarkersWriter(PointsWriter):
    """Control and check points as markers of Metashape in one camera, without blunders.

    The references of independent check points are not enabled, so that Metashape takes them as
    check points.
    """

    name = "metashape-markers"
    summary = "points without blunders as markers of Metashape (XML), with check points"
    suffix = "_markers.xml"
    declared_options: ClassVar[tuple[Option, ...]] = (IMAGE_OPTION,)

    def write(self, result: Result, path: Path) -> None:
        """Write the points as markers of one camera, with the horizontal CRS.

        Independent check points have references that are not enabled. How many points there are,
        and which are left out, is logged. Raises TermselError for a result without control points
        in a CRS of the Earth, or if none can be written.
        """
        self.require(result, path)
        checked = points_for_others(result)
        require_points(checked, path, self.needs)
        points = checked.points
        # A marker is declared in the chunk, with its ground position; where it is in the image is
        # in the frame of the chunk, by the same id.
        root = ElementTree.Element("document", version="1.2.0")
        chunk = ElementTree.SubElement(root, "chunk", label="Chunk 1", enabled="true")
        cameras = ElementTree.SubElement(chunk, "cameras")
        ElementTree.SubElement(cameras, "camera", id="0",
                               label=image_name(self.options["image"], path))
        markers = ElementTree.SubElement(chunk, "markers")
        frame = ElementTree.SubElement(ElementTree.SubElement(chunk, "frames"), "frame", id="0")
        frame_markers = ElementTree.SubElement(frame, "markers")
        for i, (name, (line, sample), position, is_check) in enumerate(zip(
                points.ids, points.image.tolist(), points.ground.tolist(), checked.is_check,
                strict=True)):
            marker = ElementTree.SubElement(markers, "marker", id=str(i), label=name)
            # A height that is not known is left out.
            coordinates = {axis: repr(value) for axis, value in zip("xyz", position, strict=True)
                           if not np.isnan(value)}
            ElementTree.SubElement(marker, "reference", {
                **coordinates, "enabled": "false" if is_check else "true"})
            ElementTree.SubElement(
                ElementTree.SubElement(frame_markers, "marker", marker_id=str(i)), "location",
                camera_id="0", pinned="true", x=repr(sample + CORNER), y=repr(line + CORNER))
        reference = ElementTree.SubElement(chunk, "reference")
        reference.text = wkt_in_one_line(horizontal_crs(result.features.crs))
        write_text(path, xml_document(root))
        say_checked(self.name, checked)
