"""Read georeference annotations as control points."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import ClassVar

import numpy as np

from termsel import FeatureSet, Option, Points, Reader, TermselError
from termsel.toolkit import read_text
from termsel_iiif.annotation import (
    FORMAT_NAME,
    Map,
    attributes_of_map,
    maps_of,
    selector_of_other_size,
)
from termsel_iiif.viewer import kind_of

log = logging.getLogger("termsel.iiif")

CENTRE = 0.5
"""Column and row by the IIIF of the place that is sample and line 0 of termsel: the IIIF counts
from the corner of the first pixel, termsel from its centre."""

ALL_POINTS = "--solver all-terms --criterion press --set fractions=1:0:0 --fit-crs EPSG:3857"
"""Options by which a model has all its terms and all points, in the coordinates of viewers."""

_MAP = Option("map", "", "Which map of a page: its number, from 1, or its id.")


class AnnotationReader(Reader):
    """Georeference annotations of the IIIF, versions 0 and 1, alone or in a page.

    Points are in WGS84 without heights. Image, mask and transformation are attributes of the first
    point, which the writer `georeference-annotation` takes back.
    """

    name = FORMAT_NAME
    summary = "georeference annotation of a IIIF image, as of Allmaps; --set map=2 of a page"
    declared_options: ClassVar[tuple[Option, ...]] = (_MAP,)

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for an annotation with a body of features, or a page of annotations."""
        text = head.lstrip()
        if not text.startswith(b"{"):
            return False
        # Annotations that are no maps have no target or no body.
        return b'"AnnotationPage"' in head or (
            b'"Annotation"' in head and b'"target"' in head and b'"body"' in head)

    def read(self, path: Path) -> FeatureSet:
        """Return the points of a map.

        What else the annotation says, such as its mask, transformation and id, is kept as
        attributes of the first point, so that it can be written again. If the annotation states a
        known transformation, the log says which model of termsel is of that kind. Raises
        TermselError for a map without points, and for a page of several maps without the option
        `map`.
        """
        map_ = self._choose_map(self._read_maps(path), path)
        if not map_.features:
            raise TermselError("this map has no control points", file=path,
                               hint="Add some, for example in Allmaps Editor.")
        table = np.array(map_.features)
        n = len(table)
        # The IIIF has columns before rows; termsel has lines before samples.
        image = table[:, 1::-1] - CENTRE
        ground = np.column_stack([table[:, 2:], np.full(n, np.nan)])
        attributes = {name: np.array([text] + [""] * (n - 1), dtype=object)
                      for name, text in attributes_of_map(map_).items()}
        points = Points(tuple(f"P{i}" for i in range(1, n + 1)), image, ground,
                        attributes=attributes)
        kind = kind_of(map_.transformation)
        if kind is not None:
            options = "".join(f" --set {name}={value}" for name, value in kind.options.items()
                              if value)
            log.info("The map is drawn with %s; --model %s%s %s fits that kind to all points in "
                     "Web Mercator, as viewers do, but from the ground to the image.", kind.label,
                     kind.model, options, ALL_POINTS)
        width = map_.resource["width"]
        height = map_.resource["height"]
        size = (height, width) if width and height else None
        if size_of_selector := selector_of_other_size(map_):
            log.warning("Warning: %s: the selector is of an image of %d x %d px, and the source of "
                        "%d x %d px. Positions are taken as those of the source: compare them with "
                        "its edges, and correct the size that is wrong.", path.name,
                        *size_of_selector, width, height)
        return FeatureSet(points, crs="EPSG:4326", image_size=size)

    def parts(self, path: Path) -> dict[str, dict[str, str]]:
        """Return the options that choose each map of a page, by its number.

        {} if there is one map alone, or the option `map` chooses one. Raises TermselError if the
        file is no annotation.
        """
        if self.options["map"]:
            return {}
        maps = self._read_maps(path)
        return {str(i): {"map": str(i)} for i in range(1, len(maps) + 1)} if len(maps) > 1 else {}

    def _read_maps(self, path: Path) -> list[Map]:
        """Return the maps of an annotation; raises TermselError if the file is none."""
        text = read_text(path)
        try:
            return maps_of(text.encode())
        except (ValueError, RecursionError) as error:
            raise TermselError(f"this is not a georeference annotation: {error}", file=path,
                               hint="Correct it, or export it again.") from error

    def _choose_map(self, maps: list[Map], path: Path) -> Map:
        """Return the map that the option `map` names, by its number from 1 or its id.

        Without the option it is the only one. Raises TermselError if there are several then, if
        there are none, or none of that name.
        """
        wanted_map = str(self.options["map"])
        listed = ", ".join(f"{i} ({map_.id})" if map_.id else str(i)
                           for i, map_ in enumerate(maps[:8], 1))
        if not maps:
            raise TermselError("this page has no maps", file=path, hint="Add a map to it.")
        if not wanted_map:
            if len(maps) > 1:
                raise TermselError(f"this page has {len(maps)} maps", file=path,
                                   hint=f"Choose one with --set map=N: {listed}.")
            return maps[0]
        # A number counts the maps of the page; ids are mostly addresses.
        if wanted_map.isdigit() and 1 <= int(wanted_map) <= len(maps):
            return maps[int(wanted_map) - 1]
        for map_ in maps:
            if map_.id == wanted_map:
                return map_
        raise TermselError(f"this page has no map {wanted_map!r}", file=path,
                           hint=f"Its maps: {listed}.")
