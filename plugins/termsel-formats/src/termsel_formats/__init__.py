"""Files of other programs, and what these programs make of them, as a plugin."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import lazy_loader

from termsel import hookimpl

if TYPE_CHECKING:
    import click

    from termsel import Reader, Writer
    from termsel_formats.check.comparison import Deviation, compare_programs
    from termsel_formats.check.programs import Taken, taken_by_programs

# What is not needed for `termsel run` is not imported for it.
__getattr__, _, _ = lazy_loader.attach(__name__, submod_attrs={
    "check.comparison": ["Deviation", "compare_programs"],
    "check.programs": ["Taken", "taken_by_programs"]})

__all__ = ["Deviation", "Taken", "compare_programs", "taken_by_programs"]


@hookimpl
def termsel_commands(cli: click.Group) -> None:
    """Add the command `termsel check`."""
    from termsel_formats.check.command import check

    cli.add_command(check)


@hookimpl
def termsel_readers() -> Iterable[type[Reader]]:
    """Return the readers of points that other programs write."""
    from termsel_formats.points.asp import AspGcp
    from termsel_formats.points.envi import EnviPoints
    from termsel_formats.points.erdas import ErdasGcps
    from termsel_formats.points.gdal_files import PamGcps
    from termsel_formats.points.gdal_text import GdalinfoText, GdalOptions
    from termsel_formats.points.geolocation import GeolocationArray
    from termsel_formats.points.grass import GrassPoints
    from termsel_formats.points.links import ArcgisLinks
    from termsel_formats.points.mapinfo import MapInfoTab
    from termsel_formats.points.metashape import MetashapeMarkers
    from termsel_formats.points.micmac import MicmacXml
    from termsel_formats.points.odm import OdmGcpList
    from termsel_formats.points.ozi import OziMap
    from termsel_formats.points.pci import PciGcp
    from termsel_formats.points.pix4d import Pix4dMarks
    from termsel_formats.points.rasters import GdalGcps
    from termsel_formats.points.world import WorldFile

    return [EnviPoints, AspGcp, MapInfoTab, OziMap, MetashapeMarkers, Pix4dMarks, ErdasGcps,
            PciGcp, PamGcps, WorldFile, GeolocationArray, GdalGcps, OdmGcpList, MicmacXml,
            GrassPoints, GdalOptions, GdalinfoText, ArcgisLinks]


@hookimpl
def termsel_writers() -> Iterable[type[Writer]]:
    """Return the writers of a map of residuals, of points for other programs, and of world files.
    """
    from termsel_formats.maps.residuals import ResidualsGeopackage
    from termsel_formats.points.asp import AspGcpWriter
    from termsel_formats.points.erdas import ErdasGcpsWriter
    from termsel_formats.points.gdal_files import GcpTiff, PamGcpsWriter
    from termsel_formats.points.gdal_text import GdalOptionsWriter
    from termsel_formats.points.mapinfo import MapInfoTabWriter
    from termsel_formats.points.metashape import MetashapeMarkersWriter
    from termsel_formats.points.micmac import MicmacXmlWriter
    from termsel_formats.points.odm import OdmGcpListWriter
    from termsel_formats.points.orthority import OrthorityGeojson
    from termsel_formats.points.ozi import OziMapWriter
    from termsel_formats.points.pci import PciGcpWriter
    from termsel_formats.points.pix4d import Pix4dMarksWriter
    from termsel_formats.points.world import WorldFileWriter

    return [ResidualsGeopackage, GcpTiff, PamGcpsWriter, WorldFileWriter, MapInfoTabWriter,
            OziMapWriter, MetashapeMarkersWriter, Pix4dMarksWriter, ErdasGcpsWriter, PciGcpWriter,
            OrthorityGeojson, AspGcpWriter, OdmGcpListWriter, MicmacXmlWriter, GdalOptionsWriter]
