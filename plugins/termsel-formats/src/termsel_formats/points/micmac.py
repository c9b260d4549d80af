"""Marks of MicMac in images (``Mesure``), and points on the ground (``Appuis``), as XML.

`SaisieAppuisInit` and its kin write two files: NAME-S2D.xml has a ``MesureAppuiFlottant1Im`` for
each image, with the column and row of each point; NAME-S3D.xml, and `GCPConvert`, have a
``OneAppuisDAF`` for each point, with its place and the standard deviations of that. Neither states
the CRS. Columns and rows are taken from the centre of the first pixel.

References
----------
MicMac, "MicMac, Apero, Pastis and Other Beverages in a Nutshell", sections on ground control
points; the names are those of the classes SetOfMesureAppuisFlottants and DicoAppuisFlottant.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar
from xml.etree import ElementTree

import numpy as np

from termsel import FeatureSet, Option, Points, Reader, Result, TermselError
from termsel.toolkit import write_text, xml_document
from termsel.toolkit.files import IMAGE_NAME, atomic_path, error_in_file, image_of, utf8_bytes
from termsel_formats.points.common import file_beside, xml_root
from termsel_formats.points.written import (
    IMAGE_OPTION,
    PointsWriter,
    image_name,
    points_for_others,
    require_points,
    say_checked,
)

_MEASURES_ELEMENT, _GROUND_ELEMENT = "SetOfMesureAppuisFlottants", "DicoAppuisFlottant"
_MICMAC_HINT = "Write it again with SaisieAppuisInit or GCPConvert."
_ENDINGS = {"-S2D.xml": "-S3D.xml", "-Mesures.xml": "-Appuis.xml", "_mesures.xml": "_appuis.xml"}
"""Endings of files of measures, and of the files of the ground next to them."""


class MicmacXml(Reader):
    """Marks of one image, with the places of the points from a file of their own."""

    name = "micmac-xml"
    summary = "marks of MicMac, NAME-S2D.xml; --set ground=FILE has the Appuis, NAME-S3D.xml"
    declared_options: ClassVar[tuple[Option, ...]] = (
        Option("ground", None, "The file of Appuis (DicoAppuisFlottant); by default NAME-S3D.xml "
                               "beside NAME-S2D.xml."), IMAGE_NAME)

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for XML with measures or with points on the ground."""
        # By the root elements; either file may be given.
        return head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<") and (
            _MEASURES_ELEMENT.encode() in head or _GROUND_ELEMENT.encode() in head)

    def read(self, path: Path) -> FeatureSet:
        """Return the points of one image; of several, the option `image_name` chooses one.

        Marks without ground coordinates are left out. Errors name the file, and the point if its
        numbers are wrong.
        """
        marks = _marks_by_image(path)
        ground = self._ground_by_name(path)
        # An image is named once for each of its points, which a message of `image_of` counts.
        images = [image for image, image_marks in marks.items() for _ in image_marks]
        image = image_of(path, images, self.options["image_name"], "image_name=NAME")
        ids = [name for name in marks[image] if name in ground]
        if not ids:
            raise TermselError(f"no point of the image {image} has ground coordinates",
                               file=path, hint="Give the file of the same points, "
                                               "--set ground=FILE.")
        # MicMac writes column and row, from the centre of the first pixel.
        line_sample = [marks[image][name][::-1] for name in ids]
        try:
            return FeatureSet(Points(tuple(ids), np.array(line_sample),
                                     np.array([ground[name] for name in ids])), crs="")
        except TermselError as error:
            raise error_in_file(error, path) from error

    def parts(self, path: Path) -> dict[str, dict[str, Any]]:
        """Return the options for each image of the file; {} if there is only one."""
        images = _marks_by_image(path)
        return {image: {"image_name": image} for image in images} if len(images) > 1 else {}

    def _ground_by_name(self, path: Path) -> dict[str, list[float]]:
        """Return x, y, z of points by name, from the file itself or the one that belongs to it.

        The option `ground` comes before both. Raises TermselError if there are none.
        """
        stated = self.options["ground"]
        root = xml_root(path, _MICMAC_HINT)
        # Some programs write both into one file.
        if stated is None and root.find(".//OneAppuisDAF") is not None:
            return _ground_of(root, path)
        ground = _ground_file(path) if stated is None else file_beside(path, stated)
        if not ground.is_file():
            raise TermselError("the measures have image coordinates only", file=path,
                               hint="Name the file of their ground coordinates (Appuis), "
                                    "--set ground=FILE.")
        return _ground_of(xml_root(ground, _MICMAC_HINT), ground)


def _ground_file(path: Path) -> Path:
    """Return the path that the file of ground coordinates to a file of measures should have.

    There need not be such a file.
    """
    for ending, ground_ending in _ENDINGS.items():
        # Some systems change the case of names.
        if path.name.lower().endswith(ending.lower()):
            return path.with_name(path.name[:-len(ending)] + ground_ending)
    return path.with_name(f"{path.stem}-S3D.xml")


def _marks_by_image(path: Path) -> dict[str, dict[str, list[float]]]:
    """Return the marks of a file of measures: by the name of the image, then by that of the point.

    Each is column and row, from the centre of the first pixel [px]. Raises TermselError without
    measures, or if a point is measured twice in an image.
    """
    root = xml_root(path, _MICMAC_HINT)
    marks: dict[str, dict[str, list[float]]] = {}
    for image in root.iter("MesureAppuiFlottant1Im"):
        image_marks = marks.setdefault((image.findtext("NameIm") or "").strip(), {})
        for mark in image.iter("OneMesureAF1I"):
            name = (mark.findtext("NamePt") or "").strip()
            if name in image_marks:
                raise TermselError(f"the point {name!r} is measured twice in one image", file=path,
                                   hint="Remove one of its measures.")
            image_marks[name] = _element_numbers(path, name, mark.findtext("PtIm"), 2)
    if not any(marks.values()):
        raise TermselError("this file has no measures in images", file=path,
                           hint="Give the file of measures (SetOfMesureAppuisFlottants), and this "
                                "one with --set ground=FILE.")
    return marks


def _ground_of(root: ElementTree.Element, path: Path) -> dict[str, list[float]]:
    """Return x, y, z of points on the ground by name.

    Raises TermselError, with `path`, if there are none, or if one has other than three numbers.
    """
    ground = {}
    for point in root.iter("OneAppuisDAF"):
        name = (point.findtext("NamePt") or "").strip()
        ground[name] = _element_numbers(path, name, point.findtext("Pt"), 3)
    if not ground:
        raise TermselError("this file has no points on the ground", file=path, hint=_MICMAC_HINT)
    return ground


def _element_numbers(path: Path, name: str, text: str | None, count: int) -> list[float]:
    """Return the numbers in the text of an element.

    Raises TermselError, with the name of its point, unless they are `count` finite numbers.
    """
    cells = (text or "").split()
    try:
        numbers = [float(cell) for cell in cells]
    except ValueError:
        numbers = []
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise TermselError(f"the point {name!r:.60} has {' '.join(cells)!r:.60}, expected {count} "
                           "numbers", file=path, hint=_MICMAC_HINT)
    return numbers


class MicmacXmlWriter(PointsWriter):
    """Control points without blunders as measures of MicMac, and NAME-S3D.xml with their places.

    Independent check points are not among them: MicMac distinguishes no control from check points.
    """

    name = "micmac-xml"
    summary = "points without blunders as measures of MicMac, and their coordinates in NAME-S3D.xml"
    needs = "control points with heights, in a CRS of the Earth"
    suffix = "-S2D.xml"
    declared_options: ClassVar[tuple[Option, ...]] = (
        IMAGE_OPTION,
        Option("ground_sigma", 1.0, "Standard deviation of the ground coordinates, in their unit.",
               float, 0.0, 1e6))

    def files(self, path: Path) -> tuple[Path, ...]:
        """Return the files of the measures and of the places on the ground."""
        return path, _ground_file(path)

    def write(self, result: Result, path: Path) -> None:
        """Write the file of measures in the image and, beside it, that of the ground.

        If one cannot be written, neither is. How many points there are, and which are left out, is
        logged. Raises TermselError if no control point with a height can be written.
        """
        self.require(result, path)
        checked = points_for_others(result, with_heights=True)
        require_points(checked, path, self.needs)
        # MicMac has no check points: they would become control.
        checked = checked.without_checks()
        control = checked.points
        if not len(control):
            raise TermselError("all points that can be written are independent check points, which "
                               "MicMac would take as control", file=path,
                               hint=f"The format requires {self.needs}.")
        measures = ElementTree.Element(_MEASURES_ELEMENT)
        image_measures = ElementTree.SubElement(measures, "MesureAppuiFlottant1Im")
        _add_text_element(image_measures, "NameIm", image_name(self.options["image"], path))
        ground = ElementTree.Element("Global")
        appuis = ElementTree.SubElement(ground, _GROUND_ELEMENT)
        sigma = float(self.options["ground_sigma"])
        for name, (line, sample), position in zip(control.ids, control.image.tolist(),
                                                  control.ground.tolist(), strict=True):
            mark = ElementTree.SubElement(image_measures, "OneMesureAF1I")
            _add_text_element(mark, "NamePt", name)
            _add_text_element(mark, "PtIm", f"{sample!r} {line!r}")
            point = ElementTree.SubElement(appuis, "OneAppuisDAF")
            _add_text_element(point, "Pt", " ".join(map(repr, position)))
            _add_text_element(point, "NamePt", name)
            _add_text_element(point, "Incertitude", f"{sigma!r} {sigma!r} {sigma!r}")
        # The first file gets its name once the second has been written.
        with atomic_path(path) as unfinished:
            unfinished.write_bytes(utf8_bytes(xml_document(measures)))
            write_text(_ground_file(path), xml_document(ground))
        say_checked(self.name, checked)


def _add_text_element(parent: ElementTree.Element, tag: str, text: str) -> None:
    """Append an element with a text to its parent."""
    ElementTree.SubElement(parent, tag).text = text
