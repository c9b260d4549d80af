"""Formats of the report on the quality of a georeference."""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path
from typing import ClassVar

import msgspec

from termsel import Option, Result, Writer
from termsel.toolkit import write_text
from termsel.toolkit.coordinates import LOCAL
from termsel_standards.quality.fgdc import fgdc_xml
from termsel_standards.quality.iso import iso_xml
from termsel_standards.quality.report import QUALITY_OPTIONS, Quality, quality_of

QUALITY_SCHEMA = "termsel-quality-1"
"""Name of the schema of the report as JSON."""


class _Report(Writer):
    """A report on the quality; what formats of it share."""

    needs = "a CRS of the Earth; independent points for figures"
    declared_options: ClassVar[tuple[Option, ...]] = QUALITY_OPTIONS

    def accepts(self, result: Result) -> bool:
        """Return True if the ground coordinates have a CRS of the Earth."""
        return result.features.crs != LOCAL

    def write(self, result: Result, path: Path) -> None:
        """Write the quality report of a result; raises TermselError without a CRS of the Earth."""
        write_text(path, self.text(quality_of(
            result, str(self.options["title"]), str(self.options["organisation"]),
            self.options["image"])))

    @abstractmethod
    def text(self, report: Quality) -> str:
        """Return the report in this format."""


class Iso19157Xml(_Report):
    """Metadata by ISO 19115-1 with data quality by ISO 19157 and lineage, as XML.

    The accuracy is the absolute external positional accuracy on independent points, each figure
    with measure, method, scope and date. Lineage names files, checksums, versions and settings.
    Without independent points it states why there are no figures.
    """

    name = "iso19157-xml"
    summary = "quality report by ISO 19157 in metadata by ISO 19115, as XML for archives"
    suffix = "_iso19157.xml"

    def text(self, report: Quality) -> str:
        """Return the report as XML of ISO 19115-3 and 19157-2."""
        return iso_xml(report)


class Iso19157Json(_Report):
    """What `iso19157-xml` states, as JSON for programs."""

    name = "iso19157-json"
    summary = "quality report by ISO 19157 as JSON for programs"
    suffix = "_iso19157.json"

    def text(self, report: Quality) -> str:
        """Return the report as JSON."""
        # The fields of `Quality` are those of the JSON, with the name of its schema first.
        content = {"schema": QUALITY_SCHEMA, **msgspec.to_builtins(report)}
        return msgspec.json.format(msgspec.json.encode(content), indent=2).decode() + "\n"


class FgdcXml(_Report):
    """Metadata by the Content Standard of the FGDC (CSDGM), with accuracy and lineage, as XML."""

    name = "fgdc-xml"
    summary = "metadata by FGDC CSDGM with positional accuracy and lineage, as XML"
    suffix = "_fgdc.xml"

    def text(self, report: Quality) -> str:
        """Return the report as XML of FGDC-STD-001-1998."""
        return fgdc_xml(report)
