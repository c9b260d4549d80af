"""The lattice of points of a Sentinel-1 product, read as control."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from termsel import FeatureSet, Option, Points, Reader, TermselError, open_raster
from termsel_cameras.scanners.annotation import (
    Annotation,
    FloatArray,
    annotation_file,
    annotation_of,
    is_annotation,
    lattice_of,
)
from termsel_cameras.scanners.product import HINT, Image, choose_images, images_of, is_image
from termsel_cameras.scanners.radar import BISTATIC, Radar

log = logging.getLogger(__name__)

BURST_LINES = 6
"""Lines of the lattice that is computed for a burst."""

NO_ANNOTATION_NOTE = (
    "Note: %s has no annotation beside it. With that (annotation/s1...xml of its product) "
    "the orbit and the timing would be known, and positions between the lattice's points "
    "exact; without it they are interpolated.")


class SentinelLattice(Reader):
    """The lattice of points of a Sentinel-1 image, from its product or its annotation.

    The points were computed by the processor, not measured: line and pixel, longitude, latitude and
    height above the ellipsoid. Lines and samples count from the centre of the first pixel, in the
    tags of an image, too, which GDAL takes as counted from its corner. The column `sensor` names
    the annotation, by which the model `radar` knows orbit and timing.

    Polarisations of one swath have the same geometry, so that any of them is read.
    """

    name = "sentinel-1"
    summary = "Sentinel-1 product: .SAFE folder, its zip, an annotation (XML) or an image (TIFF)"
    folders = True
    declared_options = (
        Option("swath", None, "Swath of a product that has several, such as IW2."),
        Option("polarisation", None, "Polarisation of a product that has several, such as VV."),
        Option("burst", None, "Number of the burst, from 1, of an SLC image of the modes IW and "
                              "EW; lines are those of the whole image.",
               type=int, minimum=1, maximum=1000),
        BISTATIC)

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for an annotation, a product's folder or zip, or an image of one."""
        return is_annotation(path, head) or is_image(path, head) or bool(images_of(path))

    def read(self, path: Path) -> FeatureSet:
        """Return the points of a product's lattice; with `burst`, of one computed over that burst.

        `path` is an annotation, a product's folder or zip, or an image. The options `swath` and
        `polarisation` choose among several images of a product. An image without its annotation
        gives the GCPs in its tags, with a warning; the options do not count there. Raises
        TermselError, which names the file.
        """
        images = images_of(path)
        if not images and is_image(path, _read_head(path)):
            log.warning(NO_ANNOTATION_NOTE, path.name)
            return self._points_of_tags(path)
        swath = self.options["swath"] or ""
        polarisation = self.options["polarisation"] or ""
        annotation_path = annotation_file(path, swath, polarisation)
        if images:
            _log_polarisation(choose_images(images, path, swath, polarisation))
        annotation = annotation_of(str(annotation_path))
        # Columns of the points carry the options of reading to the model of the radar.
        columns = {"bistatic": "true"} if self.options["bistatic"] else {}
        if self.options["burst"] is not None:
            columns["burst"] = str(self.options["burst"])
            return _lattice_of_burst(annotation, annotation_path, columns)
        points = lattice_of(annotation_path)
        image = np.array([[point.line, point.sample] for point in points])
        ground = np.array([[point.longitude, point.latitude, point.height] for point in points])
        return _lattice_points(annotation, image, ground, str(annotation_path), columns)

    def _points_of_tags(self, path: Path) -> FeatureSet:
        """Return the GCPs in the tags of an image as points, in longitude, latitude and height.

        Raises TermselError if it has none.
        """
        with open_raster(path) as raster:
            gcps = raster.gcps[0]
            size = raster.shape
        if not gcps:
            raise TermselError("this image has no ground control points, and no annotation "
                               "beside it", file=path, hint=HINT)
        # Sentinel-1 counts from the centre of the first pixel, so that no half pixel is taken off.
        image = np.array([[gcp.row, gcp.col] for gcp in gcps], dtype=np.float64)
        ground = np.array([[gcp.x, gcp.y, np.nan if gcp.z is None else gcp.z] for gcp in gcps],
                          dtype=np.float64)
        return FeatureSet(
            Points(_name_points(image), image, ground), crs="EPSG:4979", image_size=size)


def _read_head(path: Path) -> bytes:
    """Return the first 64 KiB of a file; b"" if it cannot be read, or is a folder."""
    try:
        with path.open("rb") as file:
            return file.read(1 << 16)
    except OSError:
        return b""


def _log_polarisation(images: tuple[Image, ...]) -> None:
    """Log that the first of several polarisations is read; nothing if there is one."""
    names = [image.polarisation for image in images]
    if len(names) > 1:
        log.warning("Note: the polarisations %s have one geometry; that of %s is read. --set "
                    "polarisation=... chooses another.", ", ".join(names), names[0])


def _name_points(image: FloatArray) -> tuple[str, ...]:
    """Return names such as L0P512, of line and pixel, for image places (n, 2)."""
    return tuple(f"L{line:g}P{sample:g}" for line, sample in image)


def _lattice_points(annotation: Annotation, image: FloatArray, ground: FloatArray, sensor: str,
                    columns: Mapping[str, str]) -> FeatureSet:
    """Return points of image (n, 2) and ground (n, 3) positions in EPSG:4979.

    Each has `sensor`, the annotation's path, and the options of its radar, `columns`, as columns.
    """
    attributes = {name: np.array([value] * len(image), dtype=object)
                  for name, value in {"sensor": sensor, **columns}.items()}
    return FeatureSet(Points(_name_points(image), image, ground, attributes=attributes),
                      crs="EPSG:4979", image_size=annotation.size)


def _lattice_of_burst(annotation: Annotation, annotation_path: Path,
                      options: Mapping[str, str]) -> FeatureSet:
    """Return a lattice of `BURST_LINES` lines over one burst, by the model `radar`.

    Its heights are interpolated in the product's lattice, and its samples are those of that
    lattice. Points whose range does not meet the ground are left out.
    """
    radar = Radar(metadata=str(annotation_path), **options)
    points = lattice_of(annotation_path)
    # The product's lattice has one line for each burst, on which neighbouring bursts overlap.
    first_line = annotation.bursts[radar.options["burst"] - 1].line
    lines = np.linspace(
        first_line, first_line + annotation.lines_per_burst - 1, BURST_LINES).round()
    samples = np.unique([point.sample for point in points])
    image = np.stack(np.meshgrid(lines, samples, indexing="ij"), axis=-1).reshape(-1, 2)
    ground = radar.on_ground(image, np.array([
        [point.longitude, point.latitude, point.height] for point in points]))
    is_located = np.isfinite(ground).all(axis=1)
    return _lattice_points(
        annotation, image[is_located], ground[is_located], str(annotation_path), options)
