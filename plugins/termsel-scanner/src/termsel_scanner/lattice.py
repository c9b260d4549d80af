"""The lattice of points in a Sentinel-1 annotation, read as control."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from termsel import FeatureSet, Points, Reader
from termsel_scanner.annotation import annotation_of, is_annotation, lattice_of


class SentinelLattice(Reader):
    """The lattice of points in the annotation of a Sentinel-1 image.

    The points were computed by the processor, not measured: line and pixel, longitude, latitude and
    height above the ellipsoid. Lines and samples count from the centre of the first pixel. The
    column `sensor` names the annotation.
    """

    name = "sentinel-1"
    summary = "Sentinel-1 annotation: XML, its geolocationGrid has line, pixel and place"

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for an annotation of Sentinel-1, by its first elements."""
        return is_annotation(path, head)

    def read(self, path: Path) -> FeatureSet:
        """Return the points; errors name the file and the element."""
        annotation = annotation_of(str(path))
        lattice = lattice_of(path)
        image = np.array([[point.line, point.sample] for point in lattice])
        ground = np.array([[point.longitude, point.latitude, point.height] for point in lattice])
        names = tuple(f"L{point.line:g}P{point.sample:g}" for point in lattice)
        sensor = np.array([str(path)] * len(lattice), dtype=object)
        return FeatureSet(Points(names, image, ground, attributes={"sensor": sensor}),
                          crs="EPSG:4979", image_size=annotation.size)
